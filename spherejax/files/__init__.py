"""Scene files: mechanisms described in TOML or URDF, read with their units checked, and written back."""

import lazy_loader

# Loaded when it is asked for: the command line reads numbers and units with what stands here, without JAX.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

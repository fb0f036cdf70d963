"""The equations of motion as functions, and the compiled system that they are evaluated on.

`sj.ode(scene)` returns them for integrators of your own; `sj.start` and `sj.advance` step by hand.
"""

from spherejax.namespaces import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)

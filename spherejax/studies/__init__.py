"""Studies of many runs: samples and grids, fits, cycles, uncertainty, linear analysis, costs and accuracy.

    sj.sweep(build, sj.studies.sobol_samples(ranges, 256), ts)

The studies themselves stand in `sj.` (`sj.sweep`, `sj.fit`, `sj.compare`, `sj.effects`, `sj.sensitivity`, `sj.wear`,
...). Here are the samples and grids that they take, methods and losses of fits, sensors and filters, further studies
(`continuation`, `swept_sine`, `sobol_indices`, `tolerance_budget`, `dynamic_stiffness`), and what they return.
"""

import lazy_loader as _lazy_loader

# Loaded when it is asked for: the command reads numbers and units without JAX.
__getattr__, __dir__, __all__ = _lazy_loader.attach_stub(__name__, __file__)

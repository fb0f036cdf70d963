"""What is returned about one motion: the trajectory, its accuracy, peaks, modes, start and equilibrium.

Results of studies (`Fit`, `Cycle`, ...) stand in `sj.studies`.
"""

from spherejax.namespaces import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)

"""Every error and every warning of the library, and the status of a run.

    warnings.simplefilter("error", sj.errors.StartWarning)

`SceneError`, `SimulationError`, `SimulationWarning` and `Status` stand in `sj.` too.
"""

from spherejax.namespaces import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)

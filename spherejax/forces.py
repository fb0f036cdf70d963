"""Force elements: springs, dampers, stops, actuators, controllers, couplers, tyres, applied forces.

The usual ones stand in `sj.` too. Here are also stops, shock absorbers, sampled controllers, and the abstract classes
of forces of your own with what these return (`Wrench`, `ForceAction`).
"""

from spherejax.namespaces import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)

from .model.drift import AbstractDriftControl, Baumgarte, NoDriftControl, PostStabilization, Projection
from .motion.integration.lanes import Block
from .motion.solvers.dop853 import Dop853
from .motion.solvers.rosenbrock import Rodas4P, Rodas5P, Ros34PW2

__all__ = [
    "AbstractDriftControl",
    "Baumgarte",
    "Block",
    "Dop853",
    "NoDriftControl",
    "PostStabilization",
    "Projection",
    "Rodas4P",
    "Rodas5P",
    "Ros34PW2",
]

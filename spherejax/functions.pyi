from .physics.functions.base import AbstractFunction, Network, UserFunction
from .physics.functions.integral import Integral
from .physics.functions.pieces import Piecewise, Sum
from .physics.functions.roads import RandomRoad
from .physics.functions.shapes import Bump, Constant, Linear, Polynomial, PowerTail, Sine, SmoothStep, Step
from .physics.functions.tables import SmoothTable, Table

__all__ = [
    "AbstractFunction",
    "Bump",
    "Constant",
    "Integral",
    "Linear",
    "Network",
    "Piecewise",
    "Polynomial",
    "PowerTail",
    "RandomRoad",
    "Sine",
    "SmoothStep",
    "SmoothTable",
    "Step",
    "Sum",
    "Table",
    "UserFunction",
]

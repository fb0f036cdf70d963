"""Functions of one variable: laws of springs and dampers, road profiles, prescribed motions."""

from spherejax.physics.functions.base import (
    AbstractFunction,
    Given,
    UserFunction,
    as_function,
    function_requirements,
)
from spherejax.physics.functions.pieces import Piecewise, Sum
from spherejax.physics.functions.shapes import Bump, Constant, Linear, Polynomial, PowerTail, Sine, SmoothStep, Step
from spherejax.physics.functions.tables import SmoothTable, Table

__all__ = [
    "AbstractFunction",
    "Bump",
    "Constant",
    "Given",
    "Linear",
    "Piecewise",
    "Polynomial",
    "PowerTail",
    "Sine",
    "SmoothStep",
    "SmoothTable",
    "Step",
    "Sum",
    "Table",
    "UserFunction",
    "as_function",
    "function_requirements",
]

"""Moments of inertia of the simple bodies that the published problems are made of."""

from collections.abc import Sequence

from spherejax.foundations.types import Number

Moments = tuple[Number, Number, Number]
"""Principal moments of inertia about the center of mass [kg m^2]."""


def box_inertia(mass: Number, sides: Sequence[Number]) -> Moments:
    """Moments of a uniform box, m (b^2 + c^2) / 12 about the side a, and so on [kg m^2].

    Args:
        mass: mass [kg].
        sides: lengths of the sides along the body's axes [m], shape (3,).
    """
    a, b, c = (side * side / 12 for side in sides)
    return mass * (b + c), mass * (c + a), mass * (a + b)


def rod_inertia(mass: Number, length: Number, width: Number, along: int) -> Moments:
    """Moments of a rod that is thin for bending, m l^2 / 12 across, and a square bar about its own axis, m w^2 / 6.

    Args:
        mass: mass [kg].
        length: length [m].
        width: side of the square section [m]; it enters the moment about the rod's own axis only.
        along: the body's axis along the rod, 0, 1 or 2 (static).
    """
    across, axial = mass * length * length / 12, mass * width * width / 6
    x, y, z = (axial if axis == along else across for axis in range(3))
    return x, y, z

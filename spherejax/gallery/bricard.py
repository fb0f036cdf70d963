"""Bricard's mechanism of the IFToMM library of benchmark problems (A04)."""

from spherejax.foundations.types import Number
from spherejax.gallery.rods import rod_inertia
from spherejax.model.drift import AbstractDriftControl, PostStabilization
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.joints.axial import Revolute

CORNERS = ((0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1))
"""The joints, on six edges of a cube that form a loop; the sixth edge is the ground."""


def bricard(
    *, length: Number = 1.0, mass: Number = 1.0, width: Number = 0.1, drift: AbstractDriftControl | None = None
) -> Scene:
    """Five rods and the ground in a loop of six revolutes, each across its two rods; from rest under gravity -y.

    Counting says that it cannot move: 30 equations for 30 coordinates. Owing to its geometry one equation is redundant
    at every place and one degree of freedom is left. Which equation can be left out changes on the way, and
    whatever is off the geometry locks it.

    Args:
        length: length of each rod `"rod_1"` ... `"rod_5"` [m].
        mass: mass of each rod [kg].
        width: side of the rods' square section [m].
        drift: drift control; `PostStabilization()` by default.

    Source: IFToMM library of computational benchmark problems, A04 (1 m, 1 kg, 0.1 m, 10 s). The rod's moments are
    m l^2 / 12 across and m w^2 / 6 along.
    """
    names = ["rod_1", "rod_2", "rod_3", "rod_4", "rod_5"]
    edges = [_direction(i) for i in range(6)]
    bodies = {
        name: Body(mass, rod_inertia(mass, length, width, along=_axis(edges[i])), _middle(i, length))
        for i, name in enumerate(names)
    }
    chain = [GROUND, *names, GROUND]
    joints = {
        f"hinge_{i}": Revolute((chain[i], chain[i + 1]), _scaled(CORNERS[i], length), _across(edges[i - 1], edges[i]))
        for i in range(6)
    }
    return Scene(bodies, joints, gravity=(0.0, -9.81, 0.0), drift=PostStabilization() if drift is None else drift)


def _direction(edge: int) -> tuple[int, ...]:
    start, end = CORNERS[edge], CORNERS[(edge + 1) % 6]
    return tuple(b - a for a, b in zip(start, end, strict=True))


def _middle(edge: int, length: Number) -> tuple:
    start, end = CORNERS[edge], CORNERS[(edge + 1) % 6]
    return tuple(0.5 * (a + b) * length for a, b in zip(start, end, strict=True))


def _scaled(corner: tuple[int, ...], length: Number) -> tuple:
    return tuple(a * length for a in corner)


def _axis(direction: tuple[int, ...]) -> int:
    return next(axis for axis in range(3) if direction[axis])


def _across(first: tuple[int, ...], second: tuple[int, ...]) -> tuple[float, ...]:
    """The coordinate direction that neither edge has."""
    return tuple(0.0 if a or b else 1.0 for a, b in zip(first, second, strict=True))

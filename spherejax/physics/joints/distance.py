"""Two points at a given distance: a massless link with spherical ends, or a prescribed length."""

from collections.abc import Callable, Mapping
from typing import Annotated

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement, is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Function, Named, Number, Numeric, Single, Unit
from spherejax.physics.bodies import Body, numbers
from spherejax.physics.functions.base import AbstractFunction
from spherejax.physics.joints.body_axes import in_world
from spherejax.physics.joints.joint import AbstractJoint, AbstractPlacedAtPoints
from spherejax.physics.joints.prescribed import prescribed, time_requirements
from spherejax.physics.joints.rows import ConstraintRows, differentiated_rows
from spherejax.physics.kinematics import centripetal_acceleration, point_motion


class Distance(AbstractJoint):
    """A massless rod with spherical ends keeps two points at a distance: one constraint equation.

        Phi = (d.d/L - L)/2 [m]

    with d from the first to the second point; near Phi = 0 it is |d| - L. The reaction is along d.

    Attributes:
        first: `"body.point"`.
        second: `"body.point"`.
        length: L [m]; None for the distance at the start.

    The rod has no inertia and no weight; a rod that has is a `Body` with two `Spherical` joints.
    """

    first: str = eqx.field(static=True)
    second: str = eqx.field(static=True)
    length: Single | None

    def __init__(
        self,
        first: Annotated[str, Named.POINT],
        second: Annotated[str, Named.POINT],
        length: Annotated[Number | None, Unit("m")] = None,
    ):
        self.first = first
        self.second = second
        self.length = None if length is None else numbers(length)

    def joined(self, find):
        """The bodies of the two points."""
        return find(self.first)[0], find(self.second)[0]

    def requirements(self) -> list[Requirement]:
        """A positive length."""
        return [] if self.length is None else [_length_requirement(self.length, "Give the length of the rod.")]

    def placed(self, bodies, find):
        """The points on their bodies, and the length."""
        (one, place), (other, other_place) = find(self.first), find(self.second)
        length = self.length
        if length is None:
            length = _distance_at_start(bodies, (one, place), (other, other_place))
            if is_concrete(length) and not length > 0:
                raise SceneError(
                    f"points {self.first!r} and {self.second!r} coincide at the start, which leaves the rod between "
                    "them no length. Give length=, move a point, or join them by Spherical"
                )
        return PlacedDistance((one, other), (place, other_place), length)


class PlacedDistance(AbstractPlacedAtPoints):
    """A massless rod between two points in body axes.

    Attributes:
        bodies: names of the two bodies.
        places: its ends on the bodies, body axes [m].
        length: L [m].
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    places: tuple[Numeric, Numeric]
    length: Numeric

    @property
    def n_rows(self) -> int:
        """One."""
        return 1

    def constraint_rows(self, t, motions):
        """Phi_dot = d.d_dot/L, gamma = -(d_dot.d_dot + d.(w_j x (w_j x s_j) - w_i x (w_i x s_i)))/L."""
        del t
        first, second = motions[self.bodies[0]], motions[self.bodies[1]]
        start, end = (point_motion(body, p) for body, p in zip((first, second), self.places, strict=True))
        d, d_rate = end.position - start.position, end.velocity - start.velocity
        u = d / self.length
        drawn = centripetal_acceleration(second, end.arm) - centripetal_acceleration(first, start.arm)
        return ConstraintRows(
            jnp.stack([(d @ u - self.length) / 2]),
            (
                -jnp.concatenate([u, jnp.cross(start.arm, u)])[None],
                jnp.concatenate([u, jnp.cross(end.arm, u)])[None],
            ),
            -jnp.stack([(d_rate @ d_rate) / self.length + u @ drawn]),
            jnp.zeros(1),
        )


class DistanceDriver(AbstractJoint):
    """The distance of two points is prescribed, L(t) [m]: one constraint equation, and an actuator's force.

    Attributes:
        first: `"body.point"`.
        second: `"body.point"`.
        length: L, a function of time t [s] in jnp; positive, smooth to the second derivative.

    The driving force [N] is positive where it pushes the points apart.
    """

    first: str = eqx.field(static=True)
    second: str = eqx.field(static=True)
    length: AbstractFunction

    def __init__(
        self,
        first: Annotated[str, Named.POINT],
        second: Annotated[str, Named.POINT],
        length: Annotated[Callable, Function("s", "m")],
    ):
        self.first = first
        self.second = second
        self.length = prescribed(length, "length")

    def joined(self, find):
        """The bodies of the two points."""
        return find(self.first)[0], find(self.second)[0]

    def requirements(self) -> list[Requirement]:
        """A function that gives one number, positive at t = 0."""
        found = time_requirements(self.length, "length")
        if found[0].satisfied is True:
            found.append(_length_requirement(self.length(jnp.zeros(())), "The points must stay apart.", "length(0)"))
        return found

    def placed(self, bodies, find):
        """The points on their bodies."""
        (one, place), (other, other_place) = find(self.first), find(self.second)
        return PlacedDistanceDriver((one, other), (place, other_place), self.length)


class PlacedDistanceDriver(AbstractPlacedAtPoints):
    """A prescribed distance of two points in body axes.

    Attributes:
        bodies: names of the two bodies.
        places: the points on the bodies, body axes [m].
        length: L [m] by time.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    places: tuple[Numeric, Numeric]
    length: AbstractFunction
    is_driven = True

    @property
    def functions_of_time(self):
        """The length."""
        return (self.length,)

    @property
    def n_rows(self) -> int:
        """One."""
        return 1

    def constraint_rows(self, t, motions):
        """Phi = (d.d/L - L)/2."""

        def residual(t, first, second):
            d = point_motion(second, self.places[1]).position - point_motion(first, self.places[0]).position
            length = self.length(t)
            return jnp.stack([(d @ d / length - length) / 2])

        return differentiated_rows(residual, t, motions[self.bodies[0]], motions[self.bodies[1]])


def _length_requirement(length, remedy: str, field: str = "length") -> Requirement:
    return Requirement(field, length, (length > 0) & (length < np.inf), "be positive [m]", remedy)


def _distance_at_start(bodies: Mapping[str, Body], *ends: tuple[str, Numeric]):
    start, end = (in_world(bodies, body, place) for body, place in ends)
    return ((end - start) ** 2).sum() ** 0.5

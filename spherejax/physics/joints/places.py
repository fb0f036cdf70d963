"""Places: which two bodies meet, and where. The place is a joint's geometry; a spherical place also has a model.

A joint as the user describes it names points and gives axes in world axes at the start; a *placed* joint carries
the same geometry in body axes, ready for the equations of motion.
"""

import abc
from collections.abc import Callable, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement, concretely, is_concrete
from spherejax.foundations.rotation import conjugate, normalized, quaternion_product, rotation_matrix
from spherejax.foundations.types import Numeric
from spherejax.physics.bodies import GROUND, Body, numbers
from spherejax.physics.joints.base import AbstractSphericalModel, Response
from spherejax.physics.joints.ideal import (
    ConstraintRows,
    Ideal,
    coincidence_rows,
    perpendicularity_row,
    stacked,
)
from spherejax.physics.kinematics import BodyMotion, PointMotion, RelativeMotion, point_motion

Motions = Mapping[str, BodyMotion]
"""The motion of every body by name, the ground included."""

FindPlace = Callable[[str], tuple[str, Numeric]]
"""Resolves `"body.point"` to the body's name and the point in body axes [m]."""


class AbstractPlacedJoint(eqx.Module):
    """A joint between two named bodies, with its geometry in body axes."""

    bodies: eqx.AbstractVar[tuple[str, str]]

    @property
    @abc.abstractmethod
    def points(self) -> tuple[Numeric, Numeric]:
        """The joint's point on each body, body axes [m]."""

    @abc.abstractmethod
    def constraint_rows(self, motions: Motions) -> ConstraintRows | None:
        """The joint's constraint equations, or None."""

    @abc.abstractmethod
    def assembly_rows(self, motions: Motions) -> ConstraintRows | None:
        """The equations that a consistent start satisfies, or None."""


class AbstractJoint(eqx.Module):
    """A joint as the user describes it."""

    @abc.abstractmethod
    def placed(self, bodies: Mapping[str, Body], find: FindPlace) -> AbstractPlacedJoint:
        """The same joint with its geometry in body axes."""

    @abc.abstractmethod
    def requirements(self) -> list[Requirement]:
        """What the joint's numbers must satisfy."""


class Spherical(AbstractJoint):
    """A ball in a socket, with a model of how they resist.

    Attributes:
        socket: `"body.point"` of the socket's center (body i).
        ball: `"body.point"` of the ball's center (body j).
        model: `Ideal()`, `Dry(...)`, `Lubricated(...)`, `Bushing(...)`.
        starts_concentric: whether the start is assembled so that the two centers coincide and move together, as if
            the joint were ideal; False leaves the ball where the bodies' initial positions put it.
    """

    socket: str = eqx.field(static=True)
    ball: str = eqx.field(static=True)
    model: AbstractSphericalModel = eqx.field(default_factory=Ideal)
    starts_concentric: bool = eqx.field(static=True, default=True)

    def requirements(self) -> list[Requirement]:
        """What the model requires."""
        return self.model.requirements()

    def placed(self, bodies, find):
        """The centers in body axes, and the relative orientation at the start."""
        (socket_body, socket_place), (ball_body, ball_place) = find(self.socket), find(self.ball)
        start = concretely(
            _relative_start, _start_quaternion(bodies, socket_body), _start_quaternion(bodies, ball_body)
        )
        return PlacedSpherical(
            (socket_body, ball_body), socket_place, ball_place, start, self.model, self.starts_concentric
        )


class PlacedSpherical(AbstractPlacedJoint):
    """A ball in a socket, in body axes.

    Attributes:
        bodies: names of the socket's and the ball's body.
        socket_place: socket center on its body, body axes [m].
        ball_place: ball center on its body, body axes [m].
        start_quaternion: ball's body against socket's body at the start.
        model: how the joint resists.
        starts_concentric: whether the start is assembled as if the joint were ideal.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    socket_place: Numeric
    ball_place: Numeric
    start_quaternion: Numeric
    model: AbstractSphericalModel
    starts_concentric: bool = eqx.field(static=True)

    @property
    def points(self) -> tuple[Numeric, Numeric]:
        """The centers of socket and ball, on their bodies."""
        return self.socket_place, self.ball_place

    def constraint_rows(self, motions):
        """Three equations for an ideal joint, none for the others."""
        return self.coincidence(motions) if self.model.is_ideal else None

    def assembly_rows(self, motions):
        """The centers coincide at the start, unless the user placed the ball elsewhere."""
        return self.coincidence(motions) if self.model.is_ideal or self.starts_concentric else None

    def coincidence(self, motions: Motions) -> ConstraintRows:
        """The equations of the ideal joint, whatever the model."""
        socket, ball = self.bodies
        return coincidence_rows(motions[socket], motions[ball], self.socket_place, self.ball_place)

    def centers(self, motions: Motions) -> tuple[PointMotion, PointMotion]:
        """Motion of the socket's and of the ball's center."""
        socket, ball = self.bodies
        return point_motion(motions[socket], self.socket_place), point_motion(motions[ball], self.ball_place)

    def relative_motion(self, motions: Motions) -> RelativeMotion:
        """Motion of the ball in the socket (Eqs 12 to 14)."""
        socket, ball = motions[self.bodies[0]], motions[self.bodies[1]]
        socket_center, ball_center = self.centers(motions)
        now = quaternion_product(conjugate(socket.quaternion), ball.quaternion)
        # Turned back by the start, in socket axes: zero rotation at the start whatever the bodies' axes are.
        relative = quaternion_product(now, conjugate(self.start_quaternion))
        return RelativeMotion(
            ball_center.position - socket_center.position,
            ball_center.velocity - socket_center.velocity,
            socket.rotation,
            relative,
            socket.angular_velocity,
            ball.angular_velocity,
        )

    def respond(self, motions: Motions, memory: Float[Array, " n_memory"]) -> Response:
        """Force and moments at the centers."""
        return self.model.respond(self.relative_motion(motions), memory)


class Revolute(AbstractJoint):
    """Two bodies turn against each other about one axis: five constraint equations.

    Attributes:
        bodies: names of the two bodies.
        point: a point on the axis, world axes at the start [m], shape (3,).
        axis: direction of the axis, world axes at the start, any length, shape (3,).
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    point: Numeric
    axis: Numeric

    def __init__(self, bodies: tuple[str, str], point, axis):
        self.bodies = (bodies[0], bodies[1])
        self.point = numbers(point)
        self.axis = numbers(axis)

    def requirements(self) -> list[Requirement]:
        """A finite point and a direction."""
        length = (self.axis**2).sum()
        return [
            Requirement("point", self.point, abs(self.point) < np.inf, "be finite [m]", "Give three numbers."),
            Requirement(
                "axis", self.axis, (length > 0) & (length < np.inf), "be a direction", "Give a non-zero vector."
            ),
        ]

    def placed(self, bodies, find):
        """The axis in body axes; on the first body by two perpendicular directions."""
        del find
        first, second = self.bodies
        axis = self.axis / (self.axis**2).sum() ** 0.5
        perpendicular = _perpendicular(axis)
        other = _cross(axis, perpendicular)
        return PlacedRevolute(
            self.bodies,
            (_in_body(bodies, first, self.point), _in_body(bodies, second, self.point)),
            (_turned(bodies, first, perpendicular), _turned(bodies, first, other)),
            _turned(bodies, second, axis),
        )


class PlacedRevolute(AbstractPlacedJoint):
    """A revolute joint in body axes.

    Attributes:
        bodies: names of the two bodies.
        places: the point on each body, body axes [m].
        perpendiculars: two directions on the first body that stay perpendicular to the axis.
        axis: the axis on the second body, body axes, unit length.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    places: tuple[Numeric, Numeric]
    perpendiculars: tuple[Numeric, Numeric]
    axis: Numeric

    @property
    def points(self) -> tuple[Numeric, Numeric]:
        """The joint's point on each body."""
        return self.places

    def constraint_rows(self, motions):
        """The points coincide and the axis stays perpendicular to two directions."""
        return self.assembly_rows(motions)

    def assembly_rows(self, motions):
        """The same five equations."""
        first, second = motions[self.bodies[0]], motions[self.bodies[1]]
        return stacked(
            coincidence_rows(first, second, *self.places),
            *(perpendicularity_row(first, second, b, self.axis) for b in self.perpendiculars),
        )


_ROUNDING = 1e-14
"""Entries of turned unit vectors below this are rounding, not geometry: they are made exact zeros when concrete."""


# Compiled once: scenes are built again and again, and a handful of single operations costs milliseconds.
@jax.jit
def _relative_start(socket: Numeric, ball: Numeric):
    return quaternion_product(conjugate(normalized(socket)), normalized(ball))


@jax.jit
def _in_turned_axes(quaternion: Numeric, vector: Numeric):
    return rotation_matrix(normalized(quaternion)).T @ vector


def _start_quaternion(bodies: Mapping[str, Body], name: str):
    return np.array([1.0, 0.0, 0.0, 0.0]) if name == GROUND else bodies[name].quaternion


def _turned(bodies: Mapping[str, Body], name: str, vector):
    """A world vector in the axes that the body has at the start."""
    if name == GROUND:
        return vector
    turned = concretely(_in_turned_axes, _start_quaternion(bodies, name), vector)
    return _without_rounding(turned)


def _in_body(bodies: Mapping[str, Body], name: str, point):
    """A world point in the axes that the body has at the start, from its center of mass [m]."""
    if name == GROUND:
        return point
    return _turned(bodies, name, point - bodies[name].position)


def _without_rounding(vector):
    if not is_concrete(vector):
        return vector
    array = np.array(vector)
    array[np.abs(array) < _ROUNDING] = 0.0
    return array


def _perpendicular(axis):
    """A unit vector perpendicular to `axis`, along the coordinate direction that is farthest from it."""
    xp = np if is_concrete(axis) else jnp
    a = abs(axis)
    # Nested choices instead of argmin: they work on traced values.
    x, y, z = xp.eye(3)
    helper = xp.where((a[0] <= a[1]) & (a[0] <= a[2]), x, xp.where(a[1] <= a[2], y, z))
    vector = _cross(axis, helper)
    return vector / (vector**2).sum() ** 0.5


def _cross(a, b):
    return np.cross(a, b) if is_concrete(a) and is_concrete(b) else jnp.cross(a, b)

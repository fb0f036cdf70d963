"""Elements that pull along a line: what they share, whatever their law.

Along the line between two points, or, where a direction is given, along that direction fixed in the first body:

    length = |r_2 - r_1|    or    n . (r_2 - r_1)

The force f n acts on the first body and -f n on the second, both at the second point, so that they balance and the
power is -f times the length's rate. f is the tension: positive while the element pulls the points together.
"""

import abc
from collections.abc import Mapping
from typing import NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from spherejax.foundations.checks import Requirement, concretely, is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.legal import numeric
from spherejax.foundations.numerics import CONCENTRIC_RADIUS
from spherejax.foundations.rotation import normalized, rotation_matrix
from spherejax.foundations.types import Number, Numeric, Scalar, Vector3
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.forces.base import (
    AbstractForce,
    FindPlace,
    Motions,
    Wrench,
    body_of,
    place_of,
)
from spherejax.physics.kinematics import point_motion


class Stretch(NamedTuple):
    """How long an element is.

    Attributes:
        length: [m].
        rate: [m/s].
        direction: unit vector from the first to the second point, world axes.
    """

    length: Scalar
    rate: Scalar
    direction: Vector3


class Pull(NamedTuple):
    """What an element answers.

    Attributes:
        force: tension [N].
        elastic: the part of it that `energy` accounts for [N].
        energy: stored [J].
    """

    force: Scalar
    elastic: Scalar
    energy: Scalar


class Attachment(eqx.Module):
    """Where an element is attached.

    Attributes:
        bodies: names of the two bodies.
        places: the points, body axes [m].
        direction: fixed direction, unit vector in the first body's axes, or None.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    places: tuple[Numeric, Numeric]
    direction: Numeric | None

    def stretch(self, motions: Motions) -> Stretch:
        """Length, rate and direction.

        Limits: for coinciding points the line has no direction; lengths are blurred over `CONCENTRIC_RADIUS`
        (1e-12 m), so that value and derivatives stay finite and a spring without free length is smooth there.
        """
        first, second = (motions[body] for body in self.bodies)
        start = point_motion(first, jnp.asarray(self.places[0]))
        end = point_motion(second, jnp.asarray(self.places[1]))
        distance, velocity = end.position - start.position, end.velocity - start.velocity
        if self.direction is None:
            length = jnp.sqrt(distance @ distance + CONCENTRIC_RADIUS**2)
            direction = distance / length
            return Stretch(length, direction @ velocity, direction)
        direction = first.rotation @ jnp.asarray(self.direction)
        seen_from_first = velocity - jnp.cross(first.angular_velocity, distance)
        return Stretch(direction @ distance, direction @ seen_from_first, direction)

    def wrenches(self, motions: Motions, pull: Vector3) -> dict[str, Wrench]:
        """The wrenches of a force on the first body, and its opposite on the second, at the second point."""
        first, second = (motions[body] for body in self.bodies)
        end = point_motion(second, jnp.asarray(self.places[1]))
        return {
            self.bodies[0]: Wrench(pull, jnp.cross(end.position - first.position, pull)),
            self.bodies[1]: Wrench(-pull, -jnp.cross(end.arm, pull)),
        }


class AbstractLineForce(AbstractForce):
    """An element between two points with a tension by length and rate; a member gives `pull`.

    Attributes:
        ends: `"body.point"` of the two points; `"body"` alone is its center of mass.
        direction: world axes at the start, any length, or None for the line between the points; it turns with the
            first body.
        attachment: the same in body axes; None until the scene is compiled.
    """

    ends: eqx.AbstractVar[tuple[str, str]]
    direction: eqx.AbstractVar[Numeric | None]
    attachment: eqx.AbstractVar[Attachment | None]

    @abc.abstractmethod
    def pull(self, length: Scalar, rate: Scalar, t: Scalar) -> Pull:
        """Tension and stored energy.

        Args:
            length: [m].
            rate: its time derivative [m/s].
            t: time [s].
        """

    def stretch(self, motions: Motions) -> Stretch:
        """Length, rate and direction of the placed element."""
        return self._attached.stretch(motions)

    def wrenches(self, t, motions):
        """The tension on both bodies."""
        length, rate, direction = self.stretch(motions)
        return self._attached.wrenches(motions, self.pull(length, rate, t).force * direction)

    def potential_energy(self, t, motions):
        """Energy stored [J]."""
        length, rate, _ = self.stretch(motions)
        return self.pull(length, rate, t).energy

    def parts(self, t, motions) -> dict[str, Array]:
        """`length` [m], `rate` [m/s], `force` (tension) [N], `dissipated_power` [W]."""
        length, rate, _ = self.stretch(motions)
        force, elastic, _ = self.pull(length, rate, t)
        return {"length": length, "rate": rate, "force": force, "dissipated_power": (force - elastic) * rate}

    def placed(self, bodies: Mapping[str, Body], find: FindPlace) -> Self:
        """The points and the direction in body axes."""
        first, second = self.ends
        direction = None
        if self.direction is not None:
            direction = concretely(direction_on, self.direction, start_quaternion(bodies, body_of(first)))
        attachment = Attachment(self.body_names, (place_of(first, find), place_of(second, find)), direction)
        return eqx.tree_at(
            lambda force: (force.attachment, force.direction), self, (attachment, None), is_leaf=lambda x: x is None
        )

    @property
    def body_names(self) -> tuple[str, str]:
        """The two bodies."""
        return body_of(self.ends[0]), body_of(self.ends[1])

    @property
    def _attached(self) -> Attachment:
        if self.attachment is None:
            raise SceneError("the element is not in a scene yet: its points are known once the scene is compiled")
        return self.attachment


def line_requirements(ends: tuple[str, str], direction: Numeric | None) -> list[Requirement]:
    """Two bodies, and a direction that is one."""
    remedy = "Name points of two different bodies; 'ground' is one."
    rows = [Requirement("ends", ends, body_of(ends[0]) != body_of(ends[1]), "lie on two bodies", remedy)]
    return rows if direction is None else [*rows, is_direction("direction", direction)]


def is_direction(field: str, value: Numeric) -> Requirement:
    """`value` is a vector that is not zero."""
    x = numeric(value)
    if x.shape != (3,):
        return Requirement(field, value, False, "be a vector of three numbers", "Give x, y and z in world axes.")
    square = (x**2).sum()
    return Requirement(field, value, (square > 0) & (square < np.inf), "be a direction", "Give a non-zero vector.")


def start_quaternion(bodies: Mapping[str, Body], name: str) -> Numeric:
    """Orientation of a body at the start."""
    return np.array([1.0, 0.0, 0.0, 0.0]) if name == GROUND else bodies[name].quaternion


def direction_on(direction: Vector3, quaternion) -> Vector3:
    """A direction in world axes as a unit vector in the axes of a body."""
    return rotation_matrix(normalized(quaternion)).T @ (direction / jnp.sqrt(direction @ direction))


def two_ends(ends) -> tuple[str, str]:
    """`ends` as a pair of names.

    Raises:
        SceneError: for anything else.
    """
    if isinstance(ends, str) or len(ends) != 2:
        raise SceneError(f"ends = {ends!r} must name two points, e.g. ('ground.tower', 'wheel.hub')")
    return ends[0], ends[1]


def stores_all(spring, damper) -> bool:
    """Whether the work of both functions is known not to add energy: a spring with an integral, and no damper."""
    return damper is None and (spring is None or spring.knows_primitive)


def is_without_damping(damping) -> bool:
    """Whether a damping constant is known to be zero; one that is traced may have any value."""
    return is_concrete(damping) and bool(np.all(np.asarray(damping) == 0))


def elastic_part(function, x: Number) -> tuple[Scalar, Scalar, Scalar]:
    """f(x), the part of it that has a potential, and the energy counted from x = 0; zeros without a function."""
    if function is None:
        return jnp.zeros(()), jnp.zeros(()), jnp.zeros(())
    value = function(x)
    if not function.knows_primitive:
        return value, jnp.zeros(()), jnp.zeros(())
    return value, value, function.primitive(x) - function.primitive(jnp.zeros(()))

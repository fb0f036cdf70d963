"""Torsion springs and dampers about an axis between two bodies.

The angle is that of the twist: with the relative orientation (c, q) since the start, in the first body's axes, and the
axis n,

    angle = 2 atan2(s, c),    s = n . q
    d angle/dt = g . (w_2 - w_1),    g = (c^2 n + c q x n + s q)/(c^2 + s^2)

and g, which is n while the bodies turn about the axis alone, is what the torque acts along: so the torque derives from
the energy however the axes tilt.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from spherejax.foundations.checks import Requirement, concretely
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import two_names
from spherejax.foundations.legal import non_negative
from spherejax.foundations.rotation import conjugate, normalized, quaternion_product
from spherejax.foundations.types import Function, Named, Number, Numeric, Scalar, Triple, Unit, Vector3
from spherejax.physics.bodies import Body, numbers
from spherejax.physics.forces.base import AbstractForce, FindPlace, Motions, Wrench
from spherejax.physics.forces.line import Pull, direction_on, elastic_part, is_direction, start_quaternion, stores_all
from spherejax.physics.functions.base import AbstractFunction, as_function, function_requirements
from spherejax.physics.functions.shapes import finite
from spherejax.physics.kinematics import BodyMotion

SMALLEST_TWIST_SQUARE = 1e-12
"""Of c^2 + s^2, below which the axis is tilted by pi to 2e-6 and no twist is defined; there g is held finite."""


class Twist(NamedTuple):
    """How far an element is twisted.

    Attributes:
        angle: [rad].
        rate: [rad/s].
        direction: g, world axes.
    """

    angle: Scalar
    rate: Scalar
    direction: Vector3


class TorsionalAttachment(eqx.Module):
    """A torsion spring's geometry in body axes.

    Attributes:
        axis: n, unit vector in the first body's axes.
        start_quaternion: second body against the first at the start.
    """

    axis: Numeric
    start_quaternion: Numeric

    def twist(self, first: BodyMotion, second: BodyMotion) -> Twist:
        """Angle, rate and direction of the second body's turn against the first."""
        axis = jnp.asarray(self.axis)
        now = quaternion_product(conjugate(first.quaternion), second.quaternion)
        relative = quaternion_product(now, conjugate(jnp.asarray(self.start_quaternion)))
        c, q = relative[0], relative[1:]
        s = axis @ q
        square = c * c + s * s
        defined = square > SMALLEST_TWIST_SQUARE
        angle = 2.0 * jnp.arctan2(jnp.where(defined, s, 0.0), jnp.where(defined, c, 1.0))
        g = (c * c * axis + c * jnp.cross(q, axis) + s * q) / jnp.where(defined, square, SMALLEST_TWIST_SQUARE)
        direction = first.rotation @ g
        return Twist(angle, direction @ (second.angular_velocity - first.angular_velocity), direction)


def attached(bodies: Mapping[str, Body], names: tuple[str, str], axis: Numeric) -> TorsionalAttachment:
    """An axis, world axes at the start, and the two bodies' orientations as geometry in body axes."""
    first, second = (start_quaternion(bodies, name) for name in names)
    return TorsionalAttachment(concretely(direction_on, axis, first), concretely(_relative, first, second))


class TorsionalSpring(AbstractForce):
    """A spring and a damper about an axis between two bodies.

        torque = k u + c angle_rate + spring(u) + damper(angle_rate),    u = angle - free_angle

    The torque turns the second body back, and the first one forward.

    Attributes:
        bodies: names of the two bodies; `"ground"` is one.
        axis: world axes at the start, any length; it turns with the first body.
        stiffness: k [N m/rad].
        damping: c [N m s/rad].
        free_angle: angle at which u = 0 [rad]; angles are counted from the start of the motion.
        spring: torque [N m] by u [rad]; any function of one number.
        damper: torque [N m] by rate [rad/s]; any function of one number.
        attachment: the geometry in body axes, once the scene is compiled.

    Limits: the angle is continuous within one full turn to either side of the start, (-2 pi, 2 pi), and jumps by 4 pi
    at the end of it: a spring that is wound up further needs an element of its own. Where the axes of the two bodies
    are tilted by pi against each other there is no twist; values and derivatives stay finite.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    axis: Triple
    stiffness: Number
    damping: Number
    free_angle: Number
    spring: AbstractFunction | None
    damper: AbstractFunction | None
    attachment: TorsionalAttachment | None

    def __init__(
        self,
        bodies: Annotated[tuple[str, str], Named.BODIES],
        axis: Annotated[Triple, Unit("1")],
        stiffness: Annotated[Number, Unit("N m/rad")] = 0.0,
        damping: Annotated[Number, Unit("N m s/rad")] = 0.0,
        free_angle: Annotated[Number, Unit("rad")] = 0.0,
        *,
        spring: Annotated[Callable | None, Function("rad", "N m")] = None,
        damper: Annotated[Callable | None, Function("rad/s", "N m")] = None,
    ):
        self.bodies = two_names("bodies", bodies, '("ground", "arm")')
        self.axis = numbers(axis)
        self.stiffness = stiffness
        self.damping = damping
        self.free_angle = free_angle
        self.spring = as_function(spring)
        self.damper = as_function(damper)
        self.attachment = None

    @property
    def never_adds_energy(self) -> bool:
        """With numbers for damping, and a spring that knows its integral."""
        return stores_all(self.spring, self.damper)

    def twist(self, motions: Motions) -> Twist:
        """Angle, rate and direction of the placed element."""
        if self.attachment is None:
            raise SceneError("the element is not in a scene yet: its axis is known once the scene is compiled")
        first, second = (motions[body] for body in self.bodies)
        return self.attachment.twist(first, second)

    def torque(self, angle: Scalar, rate: Scalar) -> Pull:
        """Torque [N m], its elastic part, and the energy stored [J]."""
        u = angle - self.free_angle
        value, elastic, energy = elastic_part(self.spring, u)
        linear = self.stiffness * u
        total = linear + self.damping * rate + value
        if self.damper is not None:
            total = total + self.damper(rate)
        return Pull(total, linear + elastic, 0.5 * linear * u + energy)

    def wrenches(self, t, motions):
        """The torque on both bodies."""
        del t
        angle, rate, direction = self.twist(motions)
        moment = self.torque(angle, rate).force * direction
        return {self.bodies[0]: Wrench(jnp.zeros(3), moment), self.bodies[1]: Wrench(jnp.zeros(3), -moment)}

    def potential_energy(self, t, motions):
        """Energy stored [J]."""
        del t
        angle, rate, _ = self.twist(motions)
        return self.torque(angle, rate).energy

    def parts(self, t, motions) -> dict[str, Array]:
        """`angle` [rad], `angular_rate` [rad/s], `torque` [N m], `dissipated_power` [W]."""
        del t
        angle, rate, _ = self.twist(motions)
        torque, elastic, _ = self.torque(angle, rate)
        return {
            "angle": angle,
            "angular_rate": rate,
            "torque": torque,
            "dissipated_power": (torque - elastic) * rate,
        }

    def placed(self, bodies: Mapping[str, Body], find: FindPlace) -> Self:
        """The axis in the first body's axes, and the relative orientation at the start."""
        del find
        attachment = attached(bodies, self.bodies, self.axis)
        return eqx.tree_at(lambda force: force.attachment, self, attachment, is_leaf=lambda x: x is None)

    def requirements(self) -> list[Requirement]:
        """Two bodies, an axis, k >= 0, c >= 0, and what the functions require."""
        remedy = "Name two different bodies; 'ground' is one."
        return [
            Requirement("bodies", self.bodies, self.bodies[0] != self.bodies[1], "be two bodies", remedy),
            is_direction("axis", self.axis),
            non_negative("stiffness", self.stiffness, "N m/rad"),
            non_negative("damping", self.damping, "N m s/rad"),
            finite("free_angle", self.free_angle),
            *function_requirements("spring", self.spring),
            *function_requirements("damper", self.damper),
        ]

    @property
    def body_names(self) -> tuple[str, str]:
        """The two bodies."""
        return self.bodies


def _relative(first, second):
    return quaternion_product(conjugate(normalized(first)), normalized(second))

"""Torsion springs and dampers about an axis between two bodies.

The angle, through any number of turns, and the direction along which the torque acts are those of the module `turns`.
"""

import abc
from collections.abc import Callable, Mapping
from typing import Annotated, Self

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from spherejax.foundations.checks import Requirement
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import two_names
from spherejax.foundations.legal import non_negative
from spherejax.foundations.types import Function, Named, Number, Scalar, Triple, Unit
from spherejax.physics.bodies import Body, numbers
from spherejax.physics.forces.base import AbstractForce, FindPlace, Motions, Wrench
from spherejax.physics.forces.line import Pull, elastic_part, is_direction, is_without_damping, stores_all
from spherejax.physics.forces.turns import TorsionalAttachment, Twist, attached
from spherejax.physics.functions.base import AbstractFunction, as_function, function_requirements
from spherejax.physics.functions.shapes import finite


class AbstractTorsionalForce(AbstractForce):
    """An element about an axis between two bodies with a torque by angle and rate; a member gives `torque`.

    The torque turns the second body back, and the first one forward.

    Attributes:
        bodies: names of the two bodies; `"ground"` is one.
        axis: world axes at the start, any length; it turns with the first body.
        attachment: the same in body axes; None until the scene is compiled.
    """

    bodies: eqx.AbstractVar[tuple[str, str]]
    axis: eqx.AbstractVar[Triple]
    attachment: eqx.AbstractVar[TorsionalAttachment | None]

    @abc.abstractmethod
    def torque(self, angle: Scalar, rate: Scalar) -> Pull:
        """Torque [N m], its elastic part, and the energy stored [J].

        Args:
            angle: since the start, through any number of turns [rad].
            rate: its time derivative [rad/s].
        """

    def twist(self, motions: Motions) -> Twist:
        """Angle, rate and direction of the placed element."""
        if self.attachment is None:
            raise SceneError("the element is not in a scene yet: its axis is known once the scene is compiled")
        return self.attachment.twist(motions)

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

    @property
    def body_names(self) -> tuple[str, str]:
        """The two bodies."""
        return self.bodies

    def axis_requirements(self) -> list[Requirement]:
        """Two bodies and an axis."""
        remedy = "Name two different bodies; 'ground' is one."
        return [
            Requirement("bodies", self.bodies, self.bodies[0] != self.bodies[1], "be two bodies", remedy),
            is_direction("axis", self.axis),
        ]


class TorsionalSpring(AbstractTorsionalForce):
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

    The angle goes through any number of turns; how far the element has `turned` [rad] is an entry of the state, which
    `run.memory(name)` shows.

    Limits: where the axes of the two bodies are tilted by pi against each other there is no angle: values and
    derivatives stay finite, and a run with a tilt beyond 170 degrees warns (`sj.errors.OutOfRangeWarning`).
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

    @property
    def conserves_energy(self) -> bool:
        """Without damping."""
        return self.never_adds_energy and is_without_damping(self.damping)

    def torque(self, angle: Scalar, rate: Scalar) -> Pull:
        """Torque [N m], its elastic part, and the energy stored [J]."""
        u = angle - self.free_angle
        value, elastic, energy = elastic_part(self.spring, u)
        linear = self.stiffness * u
        total = linear + self.damping * rate + value
        if self.damper is not None:
            total = total + self.damper(rate)
        return Pull(total, linear + elastic, 0.5 * linear * u + energy)

    def requirements(self) -> list[Requirement]:
        """Two bodies, an axis, k >= 0, c >= 0, and what the functions require."""
        return [
            *self.axis_requirements(),
            non_negative("stiffness", self.stiffness, "N m/rad"),
            non_negative("damping", self.damping, "N m s/rad"),
            finite("free_angle", self.free_angle),
            *function_requirements("spring", self.spring),
            *function_requirements("damper", self.damper),
        ]

"""Stops about an axis between two bodies."""

from collections.abc import Callable
from typing import Annotated, Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from spherejax.foundations.checks import Requirement
from spherejax.foundations.forms import two_names
from spherejax.foundations.legal import positive
from spherejax.foundations.types import Function, Named, Number, Scalar, Triple, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.forces.line import Pull
from spherejax.physics.forces.one_sided import TRANSITION, AbstractStop
from spherejax.physics.forces.torsional import AbstractTorsionalForce
from spherejax.physics.forces.turns import TorsionalAttachment
from spherejax.physics.functions.base import AbstractFunction, as_function


class TorsionalStop(AbstractStop, AbstractTorsionalForce):
    """A stop that turns two bodies back beyond an angle about an axis, and never holds them: a limit, or backlash.

    How it resists, for a depth p = smallest - angle or p = angle - largest above 0, is the law of
    `spherejax.physics.forces.one_sided`: torque = max(0, k ramp(p) + spring(p) + rise(p) (c p_rate + damper(p_rate)));
    with a restitution e, torque = (k ramp(p) + spring(p)) (1 + h s(p_rate)) with h = (1 - e^2)/(1 + e^2) and s the
    smooth sign. The torque turns the second body back, and the first one forward; beyond `smallest` it is negative.

    Attributes:
        bodies: names of the two bodies; `"ground"` is one.
        axis: world axes at the start, any length; it turns with the first body.
        smallest: the stop acts below this angle [rad], counted from the start, through any number of turns; None: it
            does not.
        largest: the stop acts beyond this angle [rad]; None: it does not.
        stiffness: k [N m/rad].
        damping: c [N m s/rad]; it needs an onset.
        onset: depth over which stiffness and damping build up, with continuous slope [rad]; with 0, the default, the
            stiffness is there at once and the torque has a kink.
        spring: torque [N m] by depth [rad]; any function of one number.
        damper: torque [N m] by the depth's rate [rad/s]; any function of one number.
        restitution: e, the speed after an impact by that before [-], in (0, 1], at any speed and inertia; instead of
            damping. None: nothing is lost but by damping.
        transition: rate within which the sign is smooth [rad/s]; impacts much slower lose less.
        attachment: the geometry in body axes, once the scene is compiled.

    Backlash between a shaft and what it drives is a stop with both limits between these two bodies.

    Limits: those of the angle are in `TorsionalSpring`, those of the law, with its source, in
    `spherejax.physics.forces.one_sided`.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    axis: Triple
    smallest: Number | None
    largest: Number | None
    stiffness: Number
    damping: Number
    onset: Number
    spring: AbstractFunction | None
    damper: AbstractFunction | None
    restitution: Number | None
    transition: Number
    attachment: TorsionalAttachment | None

    def __init__(
        self,
        bodies: Annotated[tuple[str, str], Named.BODIES],
        axis: Annotated[Triple, Unit("1")],
        smallest: Annotated[Number | None, Unit("rad")] = None,
        largest: Annotated[Number | None, Unit("rad")] = None,
        stiffness: Annotated[Number, Unit("N m/rad")] = 0.0,
        damping: Annotated[Number, Unit("N m s/rad")] = 0.0,
        onset: Annotated[Number, Unit("rad")] = 0.0,
        *,
        spring: Annotated[Callable | None, Function("rad", "N m")] = None,
        damper: Annotated[Callable | None, Function("rad/s", "N m")] = None,
        restitution: Annotated[Number | None, Unit("1")] = None,
        transition: Annotated[Number, Unit("rad/s")] = TRANSITION,
    ):
        if smallest is None and largest is None:
            raise TypeError("a torsional stop needs smallest= or largest=: the angle at which it begins to act")
        self.bodies = two_names("bodies", bodies, '("ground", "arm")')
        self.axis = numbers(axis)
        self.smallest = smallest
        self.largest = largest
        self.stiffness = stiffness
        self.damping = damping
        self.onset = onset
        self.spring = as_function(spring)
        self.damper = as_function(damper)
        self.restitution = restitution
        self.transition = transition
        self.attachment = None

    def torque(self, angle: Scalar, rate: Scalar) -> Pull:
        """Torque [N m], its elastic part, and the energy stored [J]."""
        return self.stops.pull(angle, rate)

    def parts(self, t, motions) -> dict[str, Array]:
        """`angle` [rad], `angular_rate` [rad/s], `torque` [N m], `dissipated_power` [W], `depth` [rad], 0 when free."""
        depth = jnp.zeros(())
        for touch in self.touches(t, motions):
            depth = jnp.maximum(depth, touch.depth)
        return {**super().parts(t, motions), "depth": depth}

    @property
    def limits(self) -> tuple[Number | None, Number | None]:
        """`smallest` and `largest`."""
        return self.smallest, self.largest

    def coordinate_and_rate(self, motions: Any) -> tuple[Scalar, Scalar]:
        """The angle [rad] and its rate."""
        value, rate, _ = self.twist(motions)
        return value, rate

    def requirements(self) -> list[Requirement]:
        """Two bodies, an axis, smallest below largest, a stiffness or a spring, and the law's own requirements."""
        rows = [*self.axis_requirements(), *self.stops.requirements("smallest", "largest", "N m", "rad")]
        # Without either the stop would be passed through in silence.
        return [positive("stiffness", self.stiffness, "N m/rad"), *rows] if self.spring is None else rows

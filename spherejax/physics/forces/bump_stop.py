"""Stops: springs that act beyond a travel only."""

from collections.abc import Callable
from typing import Annotated, Any

import equinox as eqx

from spherejax.foundations.checks import Requirement
from spherejax.foundations.types import Function, Named, Number, Scalar, Triple, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.forces.line import AbstractLineForce, Attachment, Pull, line_requirements, two_ends
from spherejax.physics.forces.one_sided import TRANSITION, AbstractStop
from spherejax.physics.functions.base import AbstractFunction, as_function


class BumpStop(AbstractStop, AbstractLineForce):
    """A stop that presses two points apart below a length, or together beyond one, and never holds them.

    How it resists, for a depth p = shortest - length or p = length - longest above 0, is the law of
    `spherejax.physics.forces.one_sided`: f = max(0, k ramp(p) + spring(p) + rise(p) (c p_rate + damper(p_rate))); with
    a restitution e, f = (k ramp(p) + spring(p)) (1 + h s(p_rate)) with h = (1 - e^2)/(1 + e^2) and s the smooth sign.

    Attributes:
        ends: `"body.point"` of the two points; `"body"` alone is its center of mass.
        shortest: the stop acts below this length [m]; None: it does not.
        longest: the stop acts beyond this length [m]; None: it does not.
        stiffness: k [N/m].
        damping: c [N s/m]; it needs an onset.
        onset: depth over which stiffness and damping build up, with continuous slope [m]; with 0, the default, the
            stiffness is there at once and the force has a kink.
        spring: force [N] by depth [m]; any function of one number.
        damper: force [N] by the depth's rate [m/s]; any function of one number.
        direction: as in `SpringDamper`; length is then the distance along it, and may be negative.
        restitution: e, the speed after an impact by that before [-], in (0, 1], at any speed and inertia; instead of
            damping. None: nothing is lost but by damping.
        transition: rate within which the sign is smooth [m/s]; impacts much slower lose less.
        attachment: the geometry in body axes, once the scene is compiled.

    Limits and source of the law: `spherejax.physics.forces.one_sided`.
    """

    ends: tuple[str, str] = eqx.field(static=True)
    shortest: Number | None
    longest: Number | None
    stiffness: Number
    damping: Number
    onset: Number
    spring: AbstractFunction | None
    damper: AbstractFunction | None
    direction: Triple | None
    restitution: Number | None
    transition: Number
    attachment: Attachment | None

    def __init__(
        self,
        ends: Annotated[tuple[str, str], Named.ENDS],
        shortest: Annotated[Number | None, Unit("m")] = None,
        longest: Annotated[Number | None, Unit("m")] = None,
        stiffness: Annotated[Number, Unit("N/m")] = 0.0,
        damping: Annotated[Number, Unit("N s/m")] = 0.0,
        onset: Annotated[Number, Unit("m")] = 0.0,
        *,
        spring: Annotated[Callable | None, Function("m", "N")] = None,
        damper: Annotated[Callable | None, Function("m/s", "N")] = None,
        direction: Annotated[Triple, Unit("1")] = None,
        restitution: Annotated[Number | None, Unit("1")] = None,
        transition: Annotated[Number, Unit("m/s")] = TRANSITION,
    ):
        if shortest is None and longest is None:
            raise TypeError("a bump stop needs shortest= or longest=: the length at which it begins to act")
        self.ends = two_ends(ends)
        self.shortest = shortest
        self.longest = longest
        self.stiffness = stiffness
        self.damping = damping
        self.onset = onset
        self.spring = as_function(spring)
        self.damper = as_function(damper)
        self.direction = None if direction is None else numbers(direction)
        self.restitution = restitution
        self.transition = transition
        self.attachment = None

    def pull(self, length: Scalar, rate: Scalar, t: Scalar) -> Pull:
        """Tension and stored energy; a stop at the shortest length answers with a negative tension."""
        del t
        return self.stops.pull(length, rate)

    @property
    def limits(self) -> tuple[Number | None, Number | None]:
        """`shortest` and `longest`."""
        return self.shortest, self.longest

    def coordinate_and_rate(self, motions: Any) -> tuple[Scalar, Scalar]:
        """The length [m] and its rate."""
        value, rate, _ = self.stretch(motions)
        return value, rate

    def requirements(self) -> list[Requirement]:
        """Two bodies, shortest below longest, and the law's own requirements."""
        return [*line_requirements(self.ends, self.direction), *self.stops.requirements("shortest", "longest")]

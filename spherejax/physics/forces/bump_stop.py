"""Stops: springs that act beyond a travel only."""

from collections.abc import Callable
from typing import Annotated

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement
from spherejax.foundations.errors import SceneError
from spherejax.foundations.legal import numeric
from spherejax.foundations.types import Function, Named, Number, Scalar, Triple, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.forces.base import Touch
from spherejax.physics.forces.line import (
    AbstractLineForce,
    Attachment,
    Pull,
    is_without_damping,
    line_requirements,
    stores_all,
    two_ends,
)
from spherejax.physics.forces.one_sided import OneSided
from spherejax.physics.functions.base import AbstractFunction, as_function
from spherejax.physics.functions.shapes import finite


class BumpStop(AbstractLineForce):
    """A stop that presses two points apart below a length, or together beyond one, and never holds them.

    How it resists, for a depth p = shortest - length or p = length - longest above 0, is the law of
    `spherejax.physics.forces.one_sided`: f = max(0, k ramp(p) + spring(p) + rise(p) (c p_rate + damper(p_rate))).

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
        attachment: the geometry in body axes, once the scene is compiled.
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
        self.attachment = None

    def pull(self, length: Scalar, rate: Scalar, t: Scalar) -> Pull:
        """Tension and stored energy; a stop at the shortest length answers with a negative tension."""
        del t
        total = Pull(jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))
        for limit, side in self._limits:
            press = self._law.press(side * (length - limit), side * rate)
            total = Pull(
                total.force + side * press.force,
                total.elastic + side * press.elastic,
                total.energy + press.energy,
            )
        return total

    @property
    def never_adds_energy(self) -> bool:
        """With numbers for damping, and a spring that knows its integral."""
        return stores_all(self.spring, self.damper)

    @property
    def conserves_energy(self) -> bool:
        """Without damping, and without a spring function, which may pull: a stop only presses."""
        return self.never_adds_energy and self.spring is None and is_without_damping(self.damping)

    @property
    def n_touches(self) -> int:
        """One for each limit."""
        return len(self._limits)

    def touches(self, t, motions):
        """How far the length is beyond each limit."""
        del t
        if self.attachment is None:
            raise SceneError("the stop is not in a scene yet: its ends are known once the scene is compiled")
        stretch = self.attachment.stretch(motions)
        return tuple(Touch(side * (stretch.length - limit), side * stretch.rate) for limit, side in self._limits)

    def requirements(self) -> list[Requirement]:
        """Two bodies, shortest below longest, and the law's own requirements."""
        rows = line_requirements(self.ends, self.direction)
        rows += [
            finite(name, limit)
            for name, limit in (("shortest", self.shortest), ("longest", self.longest))
            if limit is not None
        ]
        if self.shortest is not None and self.longest is not None:
            ordered = (numeric(self.longest) > numeric(self.shortest)) & (numeric(self.longest) < np.inf)
            remedy = "Between the two the stop is free."
            rows.append(Requirement("longest", self.longest, ordered, "be above shortest", remedy))
        return [*rows, *self._law.requirements()]

    @property
    def _limits(self) -> tuple[tuple[Number, float], ...]:
        """Each limit, and the direction in which the length passes it."""
        both = ((self.shortest, -1.0), (self.longest, 1.0))
        return tuple((limit, side) for limit, side in both if limit is not None)

    @property
    def _law(self) -> OneSided:
        return OneSided(self.stiffness, self.damping, self.spring, self.damper, self.onset)

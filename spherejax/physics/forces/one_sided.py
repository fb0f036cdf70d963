"""A contact that presses and never pulls: what stops and tyres share.

    f = max(0, E(depth) (1 + h s(rate)) + rise(depth) (c rate + damper(rate)))    for depth > 0, else 0
    E(depth) = k ramp(depth) + spring(depth)

ramp starts with slope 0 and has slope 1 from the depth `onset` on; rise goes from 0 to 1 on the same way. With
onset = 0 ramp is the depth itself.

Restitution. Without one, h = 0. With the restitution e, h = (1 - e^2)/(1 + e^2), and s(rate) is the sign of the rate,
smooth within +-w, w the `transition`. Why so: pressed in, the contact takes (1 + h) times the energy that E stores; it
gives back (1 - h) times as much, so the speed squared comes back as the fraction (1 - h)/(1 + h) = e^2, whatever the
spring, the inertia and the speed. No other law of depth and rate alone does this: to be the same for every inertia the
factor on E must not change when the rate is scaled. (c rate gives a restitution that depends on the inertia, and the
laws of impact in `laws.normal` one that needs the rate at the onset as a memory.)

Limits. An impact with the speed v comes back with v'^2 = e^2 v^2 + q w^2, as long as v' > w, where q depends on e alone
and is below 1 - e^2: with e = 0.7, q = 0.114, and the realised restitution is e to one per mille for v > 11 w. Impacts
slower than w lose less and less. What rests on the contact under a load F meets viscous damping, 1.5 h F/w.

Source: derived here, from the energy of one impact.
"""

import abc
from contextlib import nullcontext
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement, is_concrete
from spherejax.foundations.legal import non_negative, numeric, positive
from spherejax.foundations.types import Number, Scalar
from spherejax.physics.forces.base import AbstractForce, Touch
from spherejax.physics.forces.line import Pull, elastic_part, is_without_damping, stores_all
from spherejax.physics.functions.base import AbstractFunction, function_requirements
from spherejax.physics.functions.shapes import finite

TRANSITION = 1e-2
"""Rate [m/s or rad/s] within which a restitution is smooth, unless another is given: far below the rates of impacts,
and wide enough that the step control has few steps to take through a reversal."""


USUAL_DEPTH, ROUNDING = 1e-3, 1e-9
"""A force at a depth of zero counts from this share of that at a usual depth [m or rad] on: what is less is the
rounding of the user's function."""


class Press(NamedTuple):
    """What a one-sided contact answers.

    Attributes:
        force: never negative [N].
        elastic: the part of it that `energy` accounts for [N].
        energy: stored [J].
    """

    force: Scalar
    elastic: Scalar
    energy: Scalar


class OneSided(eqx.Module):
    """A law of a contact that presses and never pulls.

    Attributes:
        stiffness: k [N/m].
        damping: c [N s/m].
        spring: force [N] by depth [m], or None.
        damper: force [N] by the depth's rate [m/s], or None.
        onset: depth over which stiffness and damping build up [m].
        restitution: e [-], or None for none of the loss that it means.
        transition: w [m/s].
    """

    stiffness: Number
    damping: Number
    spring: AbstractFunction | None
    damper: AbstractFunction | None
    onset: Number
    restitution: Number | None = None
    transition: Number = TRANSITION

    def press(self, depth: Scalar, rate: Scalar) -> Press:
        """Force and energy; zero, with derivatives of zero, for depth <= 0.

        Args:
            depth: how far the contact is pressed in [m], negative without contact.
            rate: its time derivative [m/s].
        """
        touching = depth > 0
        p = jnp.where(touching, depth, 0.0)
        value, elastic, energy = elastic_part(self.spring, p)
        ramp, area = _ramp(p, jnp.asarray(self.onset))
        linear = self.stiffness * ramp
        resisting = self.damping * rate
        if self.damper is not None:
            resisting = resisting + self.damper(rate)
        holding = linear + value
        if self.restitution is not None:
            holding = holding * (1.0 + _hysteresis(self.restitution) * smooth_sign(rate, jnp.asarray(self.transition)))
        total = holding + smooth_rise(p, jnp.asarray(self.onset)) * resisting
        return Press(
            jnp.where(touching & (total > 0), total, 0.0),
            jnp.where(touching, linear + elastic, 0.0),
            jnp.where(touching, self.stiffness * area + energy, 0.0),
        )

    @property
    def force_at_touch(self) -> Scalar | None:
        """The force that is there at a depth of zero already [N]; None without a spring function: there is none."""
        if self.spring is None:
            return None
        # Numbers that are known stay so within `jax.jit`.
        is_known = all(map(is_concrete, jax.tree.leaves(self.spring)))
        with jax.ensure_compile_time_eval() if is_known else nullcontext():
            at_once, pressed = (jnp.asarray(self.spring(jnp.asarray(depth))) for depth in (0.0, USUAL_DEPTH))
            return jnp.where(at_once > ROUNDING * jnp.abs(pressed), at_once, 0.0)

    @property
    def never_adds_energy(self) -> bool:
        """With numbers for damping, and a spring that knows its integral."""
        return stores_all(self.spring, self.damper)

    @property
    def conserves_energy(self) -> bool:
        """Without damping, with the restitution 1, and without a spring function, which may pull."""
        one = self.restitution
        elastic = one is None or (is_concrete(one) and bool(np.all(np.asarray(one) == 1)))
        return self.never_adds_energy and self.spring is None and is_without_damping(self.damping) and elastic

    def requirements(self, force: str = "N", depth: str = "m") -> list[Requirement]:
        """k, c, onset >= 0; damping needs an onset, without which the force would jump at the touch; 0 < e <= 1.

        Args:
            force: unit of the force.
            depth: unit of the depth.
        """
        rows = [
            non_negative("stiffness", self.stiffness, f"{force}/{depth}"),
            non_negative("damping", self.damping, f"{force} s/{depth}"),
            non_negative("onset", self.onset, depth),
            *function_requirements("spring", self.spring),
            *function_requirements("damper", self.damper),
        ]
        undamped = (numeric(self.damping) == 0) & (self.damper is None)
        remedy = "Give a depth over which the damping builds up, e.g. 1e-3, or no damping."
        rows.append(
            Requirement("onset", self.onset, undamped | (numeric(self.onset) > 0), "be positive with damping", remedy)
        )
        if self.restitution is None:
            return rows
        e = numeric(self.restitution)
        remedy = "1 gives all energy back, 0.5 a quarter of it."
        rows.append(Requirement("restitution", self.restitution, (e > 0) & (e <= 1), "lie in (0, 1]", remedy))
        remedy = "The restitution says what an impact loses: leave damping and damper out, or the restitution."
        rows.append(Requirement("restitution", self.restitution, undamped, "stand without damping", remedy))
        return [*rows, positive("transition", self.transition, f"{depth}/s")]


class Stops(eqx.Module):
    """A coordinate that is free between two limits, and meets the same law beyond each of them.

    Attributes:
        law: how it resists.
        lowest: the law acts below [m or rad], or None.
        highest: the law acts above, or None.
    """

    law: OneSided
    lowest: Number | None
    highest: Number | None

    @property
    def limits(self) -> tuple[tuple[Number, float], ...]:
        """Each limit, and the direction in which the coordinate passes it."""
        both = ((self.lowest, -1.0), (self.highest, 1.0))
        return tuple((limit, side) for limit, side in both if limit is not None)

    def pull(self, value: Scalar, rate: Scalar) -> Pull:
        """What draws the coordinate back from above, negative where it presses from below, and the energy stored."""
        total = Pull(jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))
        for limit, side in self.limits:
            press = self.law.press(side * (value - limit), side * rate)
            total = Pull(
                total.force + side * press.force,
                total.elastic + side * press.elastic,
                total.energy + press.energy,
            )
        return total

    def touches(self, value: Scalar, rate: Scalar) -> tuple[Touch, ...]:
        """How far the coordinate is beyond each limit."""
        return tuple(Touch(side * (value - limit), side * rate) for limit, side in self.limits)

    def requirements(self, lowest: str, highest: str, force: str = "N", depth: str = "m") -> list[Requirement]:
        """The lowest below the highest, and the law's own requirements.

        Args:
            lowest: name of the field.
            highest: name of the field.
            force: unit of the force.
            depth: unit of the coordinate.
        """
        given = ((lowest, self.lowest), (highest, self.highest))
        rows = [finite(name, limit) for name, limit in given if limit is not None]
        if self.lowest is not None and self.highest is not None:
            ordered = (numeric(self.highest) > numeric(self.lowest)) & (numeric(self.highest) < np.inf)
            remedy = "Between the two the stop is free."
            rows.append(Requirement(highest, self.highest, ordered, f"be above {lowest}", remedy))
        return [*rows, *self.law.requirements(force, depth)]


class AbstractStop(AbstractForce):
    """A force element that resists by `Stops`; a member says which coordinate it is, and where the limits are.

    Attributes:
        stiffness, damping, onset, spring, damper, restitution, transition: of the law, as of `OneSided`.
    """

    stiffness: eqx.AbstractVar[Number]
    damping: eqx.AbstractVar[Number]
    onset: eqx.AbstractVar[Number]
    spring: eqx.AbstractVar[AbstractFunction | None]
    damper: eqx.AbstractVar[AbstractFunction | None]
    restitution: eqx.AbstractVar[Number | None]
    transition: eqx.AbstractVar[Number]

    @property
    @abc.abstractmethod
    def limits(self) -> tuple[Number | None, Number | None]:
        """The coordinate is free from the first to the second [m or rad]; None for no limit on that side."""

    @abc.abstractmethod
    def coordinate_and_rate(self, motions: Any) -> tuple[Scalar, Scalar]:
        """What is limited [m or rad], and its time derivative [m/s or rad/s]."""

    @property
    def never_adds_energy(self) -> bool:
        """With numbers for damping, and a spring that knows its integral."""
        return self.stops.law.never_adds_energy

    @property
    def conserves_energy(self) -> bool:
        """Without damping, with no restitution below 1, and without a spring function, which may pull."""
        return self.stops.law.conserves_energy

    @property
    def force_at_touch(self) -> Scalar | None:
        """That of the law [N or N m]."""
        return self.stops.law.force_at_touch

    @property
    def n_touches(self) -> int:
        """One for each limit."""
        return len(self.stops.limits)

    def touches(self, t: Scalar, motions: Any) -> tuple[Touch, ...]:
        """How far the coordinate is beyond each limit."""
        del t
        return self.stops.touches(*self.coordinate_and_rate(motions))

    @property
    def stops(self) -> Stops:
        """The law and the limits."""
        law = OneSided(
            self.stiffness, self.damping, self.spring, self.damper, self.onset, self.restitution, self.transition
        )
        return Stops(law, *self.limits)


def _hysteresis(restitution: Number) -> Scalar:
    """h = (1 - e^2)/(1 + e^2)."""
    square = jnp.square(jnp.asarray(restitution))
    return (1.0 - square) / (1.0 + square)


def smooth_sign(rate: Scalar, width: Scalar) -> Scalar:
    """-1 below -width, 1 above width, u (3 - u^2)/2 with u = rate/width between."""
    return 2.0 * smooth_rise(rate + width, 2.0 * width) - 1.0


def _ramp(p: Scalar, onset: Scalar) -> tuple[Scalar, Scalar]:
    """p^2/(2 onset) up to onset, then p - onset/2; and its integral."""
    building_up = p < onset
    width = jnp.where(onset > 0, onset, 1.0)
    ramp = jnp.where(building_up, 0.5 * p * p / width, p - 0.5 * onset)
    area = jnp.where(building_up, p * p * p / (6.0 * width), 0.5 * p * (p - onset) + onset * onset / 6.0)
    return ramp, area


def smooth_rise(x: Scalar, width: Scalar) -> Scalar:
    """From 0 at x = 0 to 1 at x = width: u^2 (3 - 2 u), u = x/width; with width 0, 1 for x > 0."""
    u = x / jnp.where(width > 0, width, 1.0)
    rising = (u > 0) & (x < width)
    u = jnp.where(rising, u, 0.0)
    return jnp.where(rising, u * u * (3.0 - 2.0 * u), jnp.where(x > 0, 1.0, 0.0))

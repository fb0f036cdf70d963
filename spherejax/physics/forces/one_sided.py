"""A contact that presses and never pulls: what bump stops and tyres share.

    f = max(0, k ramp(depth) + spring(depth) + rise(depth) (c rate + damper(rate)))    for depth > 0, else 0

ramp starts with slope 0 and has slope 1 from the depth `onset` on; rise goes from 0 to 1 on the same way. With
onset = 0 ramp is the depth itself.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import non_negative, numeric
from spherejax.foundations.types import Number, Scalar
from spherejax.physics.forces.line import elastic_part
from spherejax.physics.functions.base import AbstractFunction, function_requirements


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
    """

    stiffness: Number
    damping: Number
    spring: AbstractFunction | None
    damper: AbstractFunction | None
    onset: Number

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
        total = linear + value + smooth_rise(p, jnp.asarray(self.onset)) * resisting
        return Press(
            jnp.where(touching & (total > 0), total, 0.0),
            jnp.where(touching, linear + elastic, 0.0),
            jnp.where(touching, self.stiffness * area + energy, 0.0),
        )

    def requirements(self) -> list[Requirement]:
        """k, c, onset >= 0; damping needs an onset, without which the force would jump at the touch."""
        rows = [
            non_negative("stiffness", self.stiffness, "N/m"),
            non_negative("damping", self.damping, "N s/m"),
            non_negative("onset", self.onset, "m"),
            *function_requirements("spring", self.spring),
            *function_requirements("damper", self.damper),
        ]
        undamped = (numeric(self.damping) == 0) & (self.damper is None)
        remedy = "Give a depth over which the damping builds up, e.g. 1e-3, or no damping."
        rows.append(
            Requirement("onset", self.onset, undamped | (numeric(self.onset) > 0), "be positive with damping", remedy)
        )
        return rows


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

"""How hard a journal presses back in its bearing: line contact of cylinders that nearly fit.

A line contact has no stiffness of its own surfaces alone: how far two bodies approach depends on their depth, by a
logarithm. The published laws give the penetration by the load,

    delta = f (ln(4 c/f) + s),    f = (sigma_i + sigma_j) F/(pi L)

and differ in s. They turn back where the logarithm has fallen to 1 - s: a load beyond which more load would press the
surfaces apart. Before that, where the slope d(delta)/df is 1, they go on straight here.
"""

import math
from typing import Annotated, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import positive
from spherejax.foundations.types import Number, Scalar, Unit
from spherejax.physics.laws.conformity import AbstractConformity, Pair

_NEWTON_STEPS = 6
"""In l = ln(4 c/f), whose equation l = ln(4 c/delta) + ln(l + s) is nearly straight; from its first iterate on, six
steps reach rounding."""

_LEAST_RATIO = 1e-300
"""Of penetration to clearance: below, ln would leave the range of numbers."""


class AbstractCylinder(AbstractConformity):
    """A law of a line contact.

    Attributes:
        length: L, of the bearing [m].
    """

    length: eqx.AbstractVar[Number]
    shift: eqx.AbstractClassVar[float]
    is_line_contact: ClassVar[bool] = True

    @property
    def largest_ratio(self) -> float:
        """delta/c up to which the law is used as published."""
        return 2.0 * self._turning

    @property
    def _turning(self) -> float:
        """f/c where the straight line begins: the logarithm is 2 - s there."""
        return 4.0 * math.exp(self.shift - 2.0)

    def force(self, penetration: Number, pair: Pair) -> Scalar:
        """F [N]. Limits: value and derivative 0 for delta <= 0; the derivative rises from 0 as 1/ln(c/delta)."""
        return self._scale(pair) * self._loading(penetration, pair)[0]

    def energy(self, penetration: Number, pair: Pair) -> Scalar:
        """The integral of F [J]: f^2 ((l + s - 1)/2 + 1/4) pi L/(sigma_i + sigma_j), and of the straight line."""
        return self._scale(pair) * self._loading(penetration, pair)[1]

    def requirements(self) -> list[Requirement]:
        """A length."""
        return [positive("length", self.length, "m")]

    def _scale(self, pair: Pair) -> Number:
        return jnp.pi * self.length / pair.compliance

    def _loading(self, penetration: Number, pair: Pair) -> tuple[Scalar, Scalar]:
        """f [m] and its integral [m^2]."""
        c, s = pair.clearance, self.shift
        turning = self._turning
        ratio = jnp.maximum(penetration, 0.0) / c
        is_pressed = ratio > _LEAST_RATIO
        is_straight = ratio > 2.0 * turning
        inside = jnp.where(is_pressed & ~is_straight, ratio, turning)
        wanted = jnp.log(4.0 / inside)
        level = wanted + jnp.log(jnp.maximum(wanted + s, 1.0))
        for i in range(_NEWTON_STEPS):
            # The derivatives come from the last two steps: one gives the first, the other the second.
            level = jax.lax.stop_gradient(level) if i == _NEWTON_STEPS - 2 else level
            level = level - (level - jnp.log(level + s) - wanted) / (1.0 - 1.0 / (level + s))
            level = jnp.maximum(level, 1.5 - s)
        g = 4.0 * jnp.exp(-level)
        stored = g * g * (0.5 * (level + s - 1.0) + 0.25)
        beyond = ratio - 2.0 * turning
        straight = turning + beyond
        more = 0.75 * turning**2 + turning * beyond + 0.5 * beyond**2
        load = jnp.where(is_straight, straight, g)
        energy = jnp.where(is_straight, more, stored)
        return jnp.where(is_pressed, c * load, 0.0), jnp.where(is_pressed, c * c * energy, 0.0)


class JohnsonCylinder(AbstractCylinder):
    """delta = f (ln(4 c/f) - 1): two elastic cylinders, one inside the other.

    Attributes:
        length: L, of the bearing [m].

    Limits: published up to delta = 0.54 c, where more load would press the surfaces apart; straight from 0.40 c on.

    Source: Johnson (1985), Contact Mechanics, as compared by Pereira, Ramalho and Ambrosio (2011), Nonlinear Dyn.
    63:681-697.
    """

    length: Annotated[Number, Unit("m")]
    shift: ClassVar[float] = -1.0


class EsduCylinder(AbstractCylinder):
    """delta = f (ln(4 c/f) + 1): the formula of ESDU 78035.

    Attributes:
        length: L, of the bearing [m].

    Limits: published up to delta = 4 c; straight from 2.9 c on.

    Source: ESDU 78035 (1978), as compared by Pereira, Ramalho and Ambrosio (2011), Nonlinear Dyn. 63:681-697.
    """

    length: Annotated[Number, Unit("m")]
    shift: ClassVar[float] = 1.0

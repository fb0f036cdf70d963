"""Short steps of explicit methods over a surface at which the rates of sensitivities jump (`landing.Landing`).

The step is Heun's of the third order, whose last stage is at two thirds of its way, so that none lies beyond the
surface:

    k_0 = f(t, y),   k_1 = f(t + h/3, y + h k_0 / 3),   k_2 = f(t + 2h/3, y + 2h k_1 / 3),
    y' = y + h (k_0 + 3 k_2) / 4.

It ends by a time epsilon' behind the surface. For that time the rates are those behind it: with the slope (3 k_2 - k_0)
/ 2 that the stages have at the end,

    y' := y' + epsilon' (f(t + h, y') - (3 k_2 - k_0) / 2).

h and epsilon' are held fixed where it is differentiated, which is the derivative: the force is continuous.

Arrays may have their lanes on the last axis.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from spherejax.foundations.types import Scalar
from spherejax.motion.solvers.landing import ContactFunctions
from spherejax.physics.joints.base import Crossing

STAGES_OVER_KINK = (0.0, 1 / 3, 2 / 3)
"""Instants of the three stages, as shares of the step."""


def end_over_kink(y: Array, size: Array, first: Array, last: Array) -> Array:
    """The end of the step, by the rates of its first and last stage."""
    return y + size * (first + 3 * last) / 4


def slope_over_kink(first: Array, last: Array) -> Array:
    """The rate at the end of the step, as its first and last stage have it."""
    return 1.5 * last - 0.5 * first


class NearestKink(NamedTuple):
    """The kink that comes first.

    Attributes:
        sign: for each kink, 1 where its surface is approached from below, -1 from above, shape (n_kinks, ...).
        speed: at which each is approached [1/s].
        comes: whether it comes.
        delay: how soon the first one comes [s]; infinite without.
        is_it: which that is.
    """

    sign: Float[Array, "n_kinks *lanes"]
    speed: Float[Array, "n_kinks *lanes"]
    comes: Bool[Array, "n_kinks *lanes"]
    delay: Float[Array, " *lanes"]
    is_it: Bool[Array, "n_kinks *lanes"]

    def of_it(self, values: Array | np.ndarray) -> Array:
        """Its value, of one for each kink."""
        # No index: machine code has none that depends on the lane.
        return jnp.sum(jnp.where(self.is_it, values, 0.0), axis=0)

    def passed(self, there: Float[Array, "n_kinks *lanes"], rate: Float[Array, "n_kinks *lanes"]) -> tuple:
        """How far a state lies behind its surface, and how fast it goes on, by the crossing functions of all kinks."""
        return self.of_it(self.sign * there), self.of_it(self.sign * rate)


def side_of_kinks(values: Float[Array, "n_kinks *lanes"]) -> Float[Array, "n_kinks *lanes"]:
    """From which side each surface is approached: the sign of its crossing function, with the sign changed."""
    return jnp.where(values > 0, -1.0, 1.0)


def nearest_kink(contacts: ContactFunctions, y: Array, crossing: Crossing) -> NearestKink:
    """The kink that comes first after a state, at the speed of the moment; the crossing functions are those there."""
    kinks = np.array(contacts.kinks)
    way, sign = crossing.value[kinks], side_of_kinks(crossing.value[kinks])
    speed = sign * crossing.rate[kinks]
    # What does not come is divided by one: a quotient of zero by zero would make derivatives NaN.
    comes = (speed > 0) & (sign * way <= 0) & contacts.may_kink(y)
    delays = jnp.where(comes, -sign * way / jnp.where(comes, speed, 1.0), jnp.inf)
    delay, is_it, taken = jnp.min(delays, axis=0), [], jnp.zeros(delays.shape[1:], bool)
    for one in delays:  # of several that come at the same time the first
        is_it.append((one == delay) & ~taken)
        taken = taken | is_it[-1]
    return NearestKink(sign, speed, comes, delay, jnp.stack(is_it))


def gone_over_kink(
    contacts: ContactFunctions, rate: Callable, parameters: Any, t: Scalar, size: Scalar, y: Float[Array, " size"]
) -> Float[Array, " size"]:
    """The end of such a step that a run has made, to be differentiated; not in lanes.

    Args:
        contacts: of the state alone.
        rate: right-hand side (t, y).
        parameters: what crossing functions are given.
        t: where it begins [s].
        size: how long it is [s].
        y: the state there.
    """
    fixed = jax.lax.stop_gradient
    nearest = nearest_kink(contacts, fixed(y), fixed(contacts.crossings(parameters, t, y)))
    first, second, third = STAGES_OVER_KINK
    k = rate(t + first * size, y)
    last = rate(t + third * size, y + third * size * rate(t + second * size, y + second * size * k))
    end = end_over_kink(y, size, k, last)
    there = fixed(contacts.crossings(parameters, t + size, end))
    kinks = np.array(contacts.kinks)
    beyond, speed = nearest.passed(there.value[kinks], there.rate[kinks])
    late = jnp.where((speed > 0) & (beyond > 0), beyond / jnp.where(speed > 0, speed, 1.0), 0.0)
    return end + late * (rate(t + size, end) - slope_over_kink(k, last))

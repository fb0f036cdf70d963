"""The first contact event inside a trial step, found by a few looks at the crossing functions inside the step.

The crossing functions and their rates are known at both ends of a step. Where the cubic between them crosses, the state
inside the step is looked at. That narrows the bounds, and the next cubic is better by far. Arrays have their lanes on
the last axis.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from spherejax.motion.solvers.landing import LANDING_WINDOW, crossing_fraction, fraction_of_maximum
from spherejax.physics.joints.base import Crossing

WINDOW = 0.1 * LANDING_WINDOW
"""An event inside a step is exact when the crossing function is within this beyond zero."""

_LOOKS = 4
"""States inside a step that are looked at in search of a crossing, at most."""


class Found(NamedTuple):
    """A contact event inside a step.

    Attributes:
        crosses: whether there is one.
        is_exact: whether x is at it, within the window, and no other contact has changed.
        x: fraction of the step [-], in the variable in which the step is made.
    """

    crosses: Bool[Array, " n_lanes"]
    is_exact: Bool[Array, " n_lanes"]
    x: Float[Array, " n_lanes"]


class _Bound(NamedTuple):
    """Crossing functions (positive beyond the event) and their slopes at a fraction of a step."""

    x: Array
    value: Array
    slope: Array


def first_event(start: Crossing, end: Crossing, inside: Callable, was_touching, passes) -> Found:
    """The first contact event inside a step.

    Args:
        start: crossing functions at the start of the step and their derivatives by the fraction of the step, shapes
            (n_contacts, n_lanes).
        end: the same at its end.
        inside: the same at a fraction of the step.
        was_touching: contacts that are in contact mode in the step, shape (n_contacts, n_lanes).
        passes: whether the error of the step is small enough. A step that was too long says where it crosses by its
            ends alone.
    """
    sign = jnp.where(was_touching, -1.0, 1.0)

    def beyond(x, crossing: Crossing) -> _Bound:
        return _Bound(x, sign * crossing.value, sign * crossing.rate)

    low, high = beyond(jnp.zeros(passes.shape), start), beyond(jnp.ones(passes.shape), end)
    fractions = crossing_fraction(low.value, low.slope, high.value, high.slope, WINDOW)
    tops = fraction_of_maximum(low.value, low.slope, high.value, high.slope)
    # A contact whose crossing function rises first and falls last may have crossed in between.
    guesses = jnp.where(fractions < 1, fractions, 1 + jnp.where(tops < 1, -high.value, jnp.inf))
    is_first = jnp.arange(guesses.shape[0])[:, None] == jnp.argmin(guesses, axis=0)

    def of_first(bound: _Bound) -> _Bound:
        return _Bound(bound.x, *(jnp.sum(jnp.where(is_first, each, 0.0), axis=0) for each in bound[1:]))

    low, high = of_first(low), of_first(high)
    x0 = _guess(low, high)
    searches = passes & (x0 < 1)

    def is_open(search):
        n_looks, _, _, _, is_exact = search
        return (n_looks < _LOOKS) & jnp.any(searches & ~is_exact)

    def look(search):
        n_looks, low, high, x, _ = search
        everywhere = beyond(x, inside(x))
        here = of_first(everywhere)
        is_below = here.value <= 0
        is_exact = searches & ~is_below & jnp.all(everywhere.value <= WINDOW, axis=0)
        is_low = is_below & ((high.value > 0) | (here.slope > 0))
        # Lanes that do not search stay as they are: how long the others look must not matter to them.
        low = jax.tree.map(lambda new, old: jnp.where(searches & is_low, new, old), here, low)
        high = jax.tree.map(lambda new, old: jnp.where(searches & ~is_low, new, old), here, high)
        return n_looks + 1, low, high, jnp.where(is_exact, x, _guess(low, high)), is_exact

    search = jnp.array(0), low, high, x0, jnp.zeros(passes.shape, bool)
    _, _, high, x, is_exact = jax.lax.while_loop(is_open, look, search)
    crosses = jnp.where(passes, is_exact | (high.value > WINDOW), jnp.min(fractions, axis=0) < 1)
    return Found(crosses, is_exact, jnp.where(passes, x, x0))


def _guess(low: _Bound, high: _Bound) -> Float[Array, " n_lanes"]:
    """Where the cubic between the bounds crosses; where it is highest, if it does not."""
    width = high.x - low.x
    cubic = low.value, low.slope * width, high.value, high.slope * width
    fraction = jnp.where(high.value > 0, crossing_fraction(*cubic, WINDOW), fraction_of_maximum(*cubic))
    return low.x + fraction * width

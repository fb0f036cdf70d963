"""The first contact event inside a trial step, and the proof that there is none before it.

A step may end on an event, or have none. Both ends of a step do not tell: between them a ball can leave its socket and
come back. So the step is certified, from its start on, piece by piece. With g a crossing function (negative before the
event, positive beyond), bounds

    -g'' <= K,    g'' <= L

between two looks bound g itself, by parabolas through both looks or tangent to it at each of them; a piece in which one
of these stays below the window holds no event. Inside a socket g = (|p|^2 - 1) / 2 with p = e / c, so

    g'' = |p'|^2 + p . p'' >= -|p''|.

A ball that flies straight has K = 0: it is inside a socket, which is convex, where both ends are. Only acceleration
bends a path out and back. |p''| is bounded by `SPREAD` times the largest change of p' between neighboring looks over
their distance, in this step and the one before. Where that one was in another mode, a step with a ball in flight is
looked into at least once, so that a bend there and back shows.

A piece that cannot be certified is cut: where the cubic between its ends crosses or is highest, else in the middle. A
search that finds no end after `MOST_LOOKS` says how far it is certain, and the step is made again up to there.

Arrays may have lanes on their last axis.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from spherejax.physics.joints.base import Crossing

SPREAD = 3.0
"""The largest acceleration in a piece, over the mean ones between looks. 2 is exact for an acceleration that changes
its sign linearly over a step that was looked into once; a step within which it turns more often than that does not pass
its error test. The rest is reserve."""

MOST_LOOKS = 40
"""Looks into a step, at most."""

LEAST_PROGRESS = 0.1
"""The share of a step that is tried again where not even that much is certain."""

_NEWTON_STEPS = 6
_SMALLEST_FRACTION = 1e-6
_FROM_ENDS = 0.05
"""A cut in the middle of a piece stays this far from its ends."""


class FoundCrossings(NamedTuple):
    """What a step holds.

    Attributes:
        crosses: whether the step must not be kept whole.
        is_exact: whether x is at the first event, within the window.
        x: fraction of the step's time [-]: the event, or how far the step is certain to have none; 1 without an event.
        bend: largest change of the crossing's velocity over the step, of each contact.
        beyond: which functions are beyond their event there.
    """

    crosses: Bool[Array, " *lanes"]
    is_exact: Bool[Array, " *lanes"]
    x: Float[Array, " *lanes"]
    bend: Float[Array, "n_contacts *lanes"]
    beyond: Bool[Array, "n_contacts *lanes"]


class _Look(NamedTuple):
    """Crossing functions (positive beyond the event) and their slopes at a fraction of a step."""

    x: Array
    value: Array
    slope: Array
    velocity: Array


class _Search(NamedTuple):
    """State of a search: certified up to `low`; `stop` is the nearest place known to be beyond, or the step's end."""

    n_looks: Array
    low: _Look
    stop: _Look
    x: Array
    bend: Array
    is_open: Array
    found: Array


def first_event(
    start: Crossing,
    end: Crossing,
    inside: Callable[[Array], Crossing],
    was_touching: Bool[Array, "n_contacts *lanes"],
    passes: Bool[Array, " *lanes"],
    window: float | np.ndarray,
    n_round: int,
    bend_before: Float[Array, "n_contacts *lanes"],
) -> FoundCrossings:
    """The first contact event inside a step.

    Args:
        start: crossing functions at the start of the step; rates and velocities are derivatives by the fraction of the
            step.
        end: the same at its end.
        inside: the same at a fraction of the step.
        was_touching: contacts that are in contact mode in the step.
        passes: whether the error of the step is small enough. A step that was too long says where it crosses by its
            ends alone.
        window: an event is met when the crossing function is within this beyond zero; one number, or one for each, of
            shape (n_contacts, 1). At the end of a step it is none.
        n_round: the first functions are those of balls in sockets; the others have the second derivative u', u being
            their velocity.
        bend_before: the bend of the step before, in fractions of this one; negative where it is not known.
    """
    # A contact that lasts ends where its function becomes negative; with its sign turned every event is a rise.
    sign = jnp.where(was_touching, -1.0, 1.0)
    is_round = np.arange(was_touching.shape[0]).reshape(-1, *(1 for _ in passes.shape)) < n_round

    def seen(x, crossing: Crossing) -> _Look:
        return _Look(x, sign * crossing.value, sign * crossing.rate, crossing.velocity)

    def is_certain(low: _Look, high: _Look, bend) -> Array:
        # Two looks may miss a bend between them that the step before has had.
        bend = jnp.maximum(bend, bend_before)
        return jnp.all(_is_certain(low, high, bend, is_round, was_touching, window), axis=0)

    low, high = seen(jnp.zeros(passes.shape), start), seen(jnp.ones(passes.shape), end)
    bend = _bend(low, high)
    cubic = low.value, low.slope, high.value, high.slope
    fractions = crossing_fraction(*cubic, window)
    by_ends = jnp.min(fractions, axis=0)
    # Of a flight whose accelerations are not known yet the ends say too little.
    is_known = is_certain(low, high, bend) & jnp.all(was_touching | (bend_before >= 0), axis=0)
    is_open = passes & ~is_known

    def look(search: _Search) -> _Search:
        n_looks, low, stop, x, bend, is_open, found = search
        here = seen(x, inside(x))
        bend_now = jnp.maximum(bend, jnp.maximum(_bend(low, here), _bend(here, stop)))
        reached = is_certain(low, here, bend_now)
        is_beyond = jnp.any(here.value > 0, axis=0)
        is_event = reached & is_beyond
        # The first crossing is sought: what is beyond bounds it from above, what is certain from below.
        stop_now = _chosen(is_beyond, here, stop)
        low_now = _chosen(reached, here, low)
        # What is left may be certain at once, with the end of the step or what is known to be beyond.
        is_rest_certain = reached & ~is_event & is_certain(here, stop_now, bend_now)
        is_done = is_event | is_rest_certain
        goes_on = is_open & ~is_done
        # Most searches end with their first look: the next place is sought only where there is one.
        x_next = jax.lax.cond(
            jnp.any(goes_on), _guess, lambda low, here, stop, _: stop.x, low_now, here, stop_now, window
        )
        x_now = jnp.where(is_event, x, jnp.where(is_rest_certain, stop_now.x, x_next))
        now = _Search(n_looks, low_now, stop_now, x_now, bend_now, goes_on, found | is_done)
        # Lanes that do not search stay as they are: how long the others look must not matter to them.
        kept = jax.tree.map(lambda new, old: _where(is_open, new, old), now, search)
        return kept._replace(n_looks=n_looks + 1)

    def goes_on(search: _Search) -> Array:
        return (search.n_looks < MOST_LOOKS) & jnp.any(search.is_open)

    none = jnp.zeros(passes.shape, bool)
    # The first look is where the cubic through both ends crosses, or where it comes nearest to it.
    x0 = jnp.where(by_ends < 1, by_ends, _highest(cubic))
    begun = _Search(jnp.array(0), low, high, x0, bend, is_open, none)
    search = jax.lax.while_loop(goes_on, look, begun)
    # A search that has used up its looks ends the step where it is certain, and makes some progress.
    x = jnp.where(search.found, search.x, jnp.maximum(search.low.x, LEAST_PROGRESS))
    x = jnp.where(passes, jnp.where(is_open, x, 1.0), by_ends)
    beyond = jnp.where(passes, search.stop.value > 0, fractions < 1)
    return FoundCrossings(x < 1, passes & search.found & (x < 1), x, search.bend, beyond)


def _where(condition, new, old):
    """Chosen by lane; arrays have their lanes on the last axes."""
    return jnp.where(condition, new, old) if jnp.ndim(new) >= jnp.ndim(condition) else new


def _chosen(condition, new: _Look, old: _Look) -> _Look:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), new, old)


def _bend(low: _Look, high: _Look) -> Float[Array, "n_contacts *lanes"]:
    """Mean size of p'' between two looks, from the change of p'."""
    change = high.velocity - low.velocity
    width = high.x - low.x
    return jnp.sqrt(jnp.sum(change * change, axis=1)) / jnp.where(width > 0, width, jnp.inf)


def _is_certain(
    low: _Look, high: _Look, bend, is_round, was_touching, window: float | np.ndarray
) -> Bool[Array, "n_contacts *lanes"]:
    """Whether the crossing functions cannot be beyond the window between two looks.

    With -g'' <= K and g'' <= L. By K the parabola through both looks is an upper bound; by L the parabolas that touch g
    at each of them are, which cover a straight way from wall to wall. For a ball in flight K = |p''| and
    L = |p'|^2 + |p| |p''|; where the event is a release, g turns over.
    """
    width = high.x - low.x
    sharpest = SPREAD * bend
    speed = jnp.sqrt(jnp.maximum(_square(low), _square(high))) + sharpest * width / 2
    reach = jnp.sqrt(1 + 2 * jnp.maximum(0.0, -jnp.minimum(low.value, high.value)))
    wide = jnp.where(is_round, speed * speed + reach * sharpest, sharpest)
    bent = jnp.where(is_round & was_touching, reach * sharpest, sharpest)
    K, L = jnp.where(was_touching, wide, bent), jnp.where(was_touching, bent, wide)
    rise, bulge = high.value - low.value, K * width * width / 2
    top = low.value + (rise + bulge) ** 2 / (4 * jnp.where(bulge > 0, bulge, 1.0))
    larger = jnp.maximum(low.value, high.value)
    by_chord = jnp.where(jnp.abs(rise) < bulge, top, larger) <= window
    covered = _reach_of_tangent(low.value, low.slope, L, window) + _reach_of_tangent(high.value, -high.slope, L, window)
    return by_chord | ((larger <= window) & (covered >= width))


def _reach_of_tangent(value, slope, L, window: float | np.ndarray) -> Float[Array, "n_contacts *lanes"]:
    """How far from a look the parabola that touches g there stays below the window: value + slope x + L x^2 / 2."""
    room = jnp.maximum(window - value, 0.0)
    root = jnp.sqrt(slope * slope + 2 * L * room)
    # The root that does not cancel, on either side.
    rising = 2 * room / jnp.where(slope + root > 0, slope + root, jnp.inf)
    falling = (root - slope) / jnp.where(L > 0, L, 1.0)
    return jnp.where(slope > 0, rising, jnp.where(L > 0, falling, jnp.inf))


def _square(look: _Look) -> Float[Array, "n_contacts *lanes"]:
    return jnp.sum(look.velocity * look.velocity, axis=1)


def _guess(low: _Look, here: _Look, stop: _Look, window: float | np.ndarray) -> Float[Array, " *lanes"]:
    """Where to look next: between what is certain and the latest look, or beyond that, if it is what is certain."""
    high = jax.tree.map(lambda a, b: jnp.where(here.x > low.x, a, b), here, stop)
    width = high.x - low.x
    cubic = low.value, low.slope * width, high.value, high.slope * width
    crossing = jnp.min(crossing_fraction(*cubic, window), axis=0)
    return low.x + width * jnp.where(crossing < 1, crossing, _highest(cubic))


def _highest(cubic) -> Float[Array, " *lanes"]:
    """Where the cubic between two looks is highest, if that is between them; else the middle."""
    top = jnp.min(fraction_of_maximum(*cubic), axis=0)
    return jnp.where(top < 1, jnp.clip(top, _FROM_ENDS, 1 - _FROM_ENDS), 0.5)


def crossing_fraction(g0, slope0, g1, slope1, window: float | np.ndarray):
    """Where in (0, 1) a function first becomes positive, by its cubic Hermite interpolant.

    Args:
        g0: value at the start, not positive (a positive one counts as zero).
        slope0: derivative by the fraction at the start.
        g1: value at the end.
        slope1: derivative by the fraction at the end.
        window: values up to this count as landed.

    Returns:
        The fraction at which the interpolant reaches half the landing window; 1 where it stays negative, or where the
        end is within the window. A hump inside the step is found as well.
    """
    top = fraction_of_maximum(g0, slope0, g1, slope1)
    has_hump = (g1 <= 0) & (top < 1) & (_hermite(top, g0, slope0, g1, slope1)[0] > window)
    crosses = (g1 > window) | has_hump
    low, high = jnp.zeros_like(g0), jnp.where(has_hump, top, 1.0)
    rise = _hermite(high, g0, slope0, g1, slope1)[0] - g0
    x = high * jnp.clip(-g0 / jnp.where(rise > 0, rise, 1.0), 0.05, 0.95)

    def safeguarded_newton_step(_, bracket):
        low, high, x = bracket
        value, slope = _hermite(x, g0, slope0, g1, slope1)
        value = value - window / 2
        low, high = jnp.where(value < 0, x, low), jnp.where(value < 0, high, x)
        newton = x - value / jnp.where(slope == 0, 1.0, slope)
        # An iteration that has converged stays on its bound: halving the bracket would throw it away.
        return low, high, jnp.where((newton >= low) & (newton <= high), newton, (low + high) / 2)

    # A loop, not unrolled steps: XLA evaluates what several consumers read once for each, and nested steps multiply.
    _, _, x = jax.lax.fori_loop(0, _NEWTON_STEPS, safeguarded_newton_step, (low, high, x))
    return jnp.where(crosses, jnp.clip(x, _SMALLEST_FRACTION, 1 - _SMALLEST_FRACTION), 1.0)


def _hermite(x, g0, slope0, g1, slope1):
    """Value and derivative of the cubic Hermite interpolant at a fraction x."""
    c2 = 3 * (g1 - g0) - 2 * slope0 - slope1
    c3 = 2 * (g0 - g1) + slope0 + slope1
    return g0 + x * (slope0 + x * (c2 + x * c3)), slope0 + x * (2 * c2 + x * 3 * c3)


def fraction_of_maximum(g0, slope0, g1, slope1):
    """Fraction of the interpolant's maximum when it rises at the start and falls at the end, else 1."""
    c2 = 3 * (g1 - g0) - 2 * slope0 - slope1
    c3 = 2 * (g0 - g1) + slope0 + slope1
    is_hump = (slope0 > 0) & (slope1 < 0)
    # Root of slope0 + 2 c2 x + 3 c3 x^2 in the form that does not cancel; slope changes sign, so it is real.
    discriminant = jnp.where(is_hump, c2 * c2 - 3 * c3 * slope0, 1.0)
    denominator = -c2 + jnp.sqrt(jnp.maximum(discriminant, 0.0))
    x = slope0 / jnp.where(is_hump & (denominator > 0), denominator, 1.0)
    return jnp.where(is_hump, jnp.clip(x, 0.0, 1.0), 1.0)

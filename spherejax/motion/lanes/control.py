"""How a lane goes on after a trial step: kept whole, kept up to a contact event inside it, or to be repeated.

`Repeating` leaves that to the `LandingController` of single runs, and serves every solver. `Landing` is for explicit
Runge-Kutta methods, whose stages give a state at any instant inside the step; it needs half of the steps:

* A flight is smooth far beyond the contact surface. So a trial step may go far beyond it, and ends on it: the crossing
  is found on the states inside the step, and one of them is the step's end where that is accurate enough.
* Contact begins like the power 3/2 of time, which no method's order survives. In the root of time it is smooth, and the
  first step in contact is made in it: with t = t0 + h x^2 the same stages integrate dy/dx = 2 h x f.
* Contact ends with the same power. Where the motion of the last step says that a contact will end within the next one,
  that one is made to end just behind; a trial step that was rejected because it went further is shortened likewise.
* After an event the first two steps are of the sizes that suited the last time.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from spherejax.motion.solvers.landing import (
    LANDING_WINDOW,
    Contacts,
    LandingController,
    crossing_fraction,
    fraction_of_maximum,
    shortest_step,
)

SAFETY, SMALLEST_FACTOR, LARGEST_FACTOR = 0.9, 0.2, 10.0
"""Of the change of a step's size, as in diffrax."""

_WINDOW = 0.1 * LANDING_WINDOW
_LOOKS = 4
"""States inside a step that are looked at in search of a crossing."""

_ACCURATE_INSIDE = 1e-6
"""States inside a step are as accurate as its end where the scaled error is below this..."""

_NEAR_END = 0.95
"""... or behind this fraction of the step."""

_LIKE_LAST_FLIGHT = 1.5
"""The first step of a flight is at most this much longer than the last flight was."""

_BEYOND = 1.005
"""A step that is to end on a release is made this much longer: an event can be found inside, not ahead."""


class Judgment(NamedTuple):
    """What becomes of a trial step.

    Attributes:
        keep: whether it is kept, whole or up to an event.
        t: where the coming step starts [s].
        t_next: where it ends [s].
        y: the state at t, if the step is kept.
        state: the control's.
        made_jump: whether the state jumps at t.
        verdict: `diffrax.RESULTS`.
        began: contacts that began in the step.
    """

    keep: Bool[Array, ""]
    t: Float[Array, ""]
    t_next: Float[Array, ""]
    y: Array
    state: Any
    made_jump: Bool[Array, ""]
    verdict: Any
    began: Bool[Array, " n_contacts"]


class Step(NamedTuple):
    """A trial step of one lane.

    Attributes:
        t0, t1: its start and its end [s].
        y0, y1: states there.
        error: estimate of the error of y1.
        k: increments of its stages, shape (n_stages, ...).
        parameters: what the right-hand side is given.
    """

    t0: Array
    t1: Array
    y0: Array
    y1: Array
    error: Array
    k: Array | None
    parameters: Any


class Repeating:
    """The control of single runs: a step that crosses a contact surface is taken again to end there."""

    def __init__(self, problem, order):
        self.problem, self.order = problem, order

    def _controller(self, parameters) -> LandingController:
        problem = self.problem
        return LandingController(problem.controller_of(parameters), problem.contacts, problem.longest_step)  # pyright: ignore[reportCallIssue]

    def init(self, term, t0, t_end, y0, parameters):
        """The end of the first step [s], and the control's state."""
        func = self.problem.solver.func
        return self._controller(parameters).init(term, t0, t_end, y0, None, parameters, func, self.order)

    def in_root_of_time(self, state) -> Array:
        """Whether the coming step is made in the root of time."""
        return jnp.zeros(state.is_first.shape, bool)

    def judge(self, step: Step, state, was_jump) -> Judgment:
        """What becomes of a trial step."""
        contacts, y = self.problem.contacts, step.y1
        began = jnp.zeros(0, bool)
        if self.problem.correct is not None:
            y = self.problem.correct(step.parameters, step.t1, y)
        if contacts is not None:
            y = contacts.update(step.parameters, step.t1, step.y0, y)
            began = ~contacts.is_touching(step.y0) & contacts.is_touching(y)
        keep, t, t_next, made_jump, state, verdict = self._controller(step.parameters).adapt_step_size(
            step.t0, step.t1, step.y0, y, step.parameters, step.error, self.order, state
        )
        return Judgment(keep, t, t_next, y, state, jnp.where(keep, made_jump, was_jump), verdict, began)


class Pace(NamedTuple):
    """State of `Landing`.

    Attributes:
        value, rate: crossing functions at the start of the coming step, and their rates [1/s].
        expected: sizes [s] of the first and second step after a release (first row) and after an onset; 0 if unknown.
        n_since: steps since the latest event.
        duration: time since the latest event [s].
        was_rejected: whether the last trial step was too long.
        in_root: whether the coming step is made in the root of time.
    """

    value: Float[Array, " n_contacts"]
    rate: Float[Array, " n_contacts"]
    expected: Float[Array, "2 2"]
    n_since: Int[Array, ""]
    duration: Float[Array, ""]
    was_rejected: Bool[Array, ""]
    in_root: Bool[Array, ""]


class Found(NamedTuple):
    """A contact event inside a step.

    Attributes:
        crosses: whether there is one.
        is_exact: whether x is at it, within the landing window, and no other contact has changed.
        x: fraction of the step [-], in the variable in which the step is made.
        y: state there.
    """

    crosses: Bool[Array, ""]
    is_exact: Bool[Array, ""]
    x: Float[Array, ""]
    y: Array


class Landing:
    """Steps that end on contact events inside them; see the module's docstring.

    Args:
        problem: what is integrated.
        order: of the error estimate.
        inside: coefficients of the states inside a step, see `lanes.inside`.
    """

    def __init__(self, problem, order, inside: np.ndarray):
        self.problem, self.order, self.inside = problem, order, inside
        self.contacts: Contacts | None = problem.contacts
        self.correct: Callable | None = problem.correct

    def init(self, term, t0, t_end, y0, parameters):
        """The end of the first step [s], and the control's state."""
        problem = self.problem
        t1, _ = problem.controller_of(parameters).init(
            term, t0, t_end, y0, None, parameters, problem.solver.func, self.order
        )
        value = rate = jnp.zeros(0)
        if self.contacts is not None:
            value, rate = self.contacts.crossings(parameters, t0, y0)
        no = jnp.array(False)
        pace = Pace(value, rate, jnp.zeros((2, 2)), jnp.array(2, jnp.int64), jnp.array(0.0), no, no)
        return t0 + self._limited(t1 - t0), pace

    def in_root_of_time(self, state: Pace) -> Array:
        """Whether the coming step is made in the root of time."""
        return state.in_root

    def judge(self, step: Step, state: Pace, was_jump) -> Judgment:
        """What becomes of a trial step."""
        size, shortest = step.t1 - step.t0, shortest_step(step.t0, step.t1)
        error = self._scaled_error(step)
        passes = error < 1
        largest = jnp.where(passes, jnp.where(state.was_rejected, 1.0, LARGEST_FACTOR), SAFETY)
        longer = size * jnp.clip(SAFETY * jnp.maximum(error, 1e-30) ** (-1 / self.order), SMALLEST_FACTOR, largest)
        step = step._replace(y1=self._corrected(step.parameters, step.t1, step.y1))
        if self.contacts is None:
            state = state._replace(was_rejected=~passes)
            judgment = Judgment(passes, step.t1, longer, step.y1, state, jnp.array(False), None, jnp.zeros(0, bool))
        else:
            judgment = self._with_contacts(self.contacts, step, state, error, longer, shortest)
        keep = judgment.keep
        has_stalled = ~keep & (size <= shortest)
        t = jnp.where(keep, judgment.t, step.t0)
        return judgment._replace(
            t=t,
            t_next=t + self._limited(judgment.t_next),
            made_jump=jnp.where(keep, judgment.made_jump, was_jump),
            verdict=diffrax.RESULTS.where(has_stalled, diffrax.RESULTS.dt_min_reached, diffrax.RESULTS.successful),
        )

    def _with_contacts(self, contacts: Contacts, step: Step, state: Pace, error, longer, shortest) -> Judgment:
        """The judgment, with the coming step's size [s] in place of its end."""
        size, passes = step.t1 - step.t0, error < 1
        was_touching = contacts.is_touching(step.y0)
        found = self._event(contacts, step, state, was_touching, passes)
        share = jnp.where(state.in_root, found.x**2, found.x)
        is_accurate = (error < _ACCURATE_INSIDE) | (share > _NEAR_END)
        up_to_event = size * jnp.minimum(share * _BEYOND, 0.999)
        # Where the rounding of time leaves no instant between start and end, the end is the event.
        can_repeat = jnp.maximum(up_to_event, shortest) < size
        lands = passes & found.crosses & found.is_exact & is_accurate
        repeats = passes & found.crosses & ~lands & can_repeat
        keep = passes & ~repeats
        t = jnp.where(lands, step.t0 + size * share, step.t1)
        y = contacts.update(step.parameters, t, step.y0, jnp.where(lands, found.y, step.y1))
        end = contacts.crossings(step.parameters, t, y)
        is_touching = contacts.is_touching(y)
        began = ~was_touching & is_touching
        is_event = keep & jnp.any(was_touching != is_touching)
        is_second = state.n_since == 0
        mode, mode_now = (jnp.any(each).astype(jnp.int64) for each in (was_touching, is_touching))
        # What this step should have been is what such a step is to be the next time.
        place = (jnp.arange(2)[:, None] == mode) & (jnp.arange(2) == state.n_since)
        expected = jnp.where(keep & place, longer, state.expected)
        duration = state.duration + jnp.where(keep, t - step.t0, 0.0)
        has_flown = is_event & ~jnp.any(was_touching)
        as_long = jnp.where(has_flown, _LIKE_LAST_FLIGHT * duration, jnp.inf)
        expected = expected.at[0, 0].min(as_long)
        first, second = expected[mode_now, 0], expected[mode_now, 1]
        following = jnp.where(
            is_event & (first > 0), first, jnp.where(is_second & ~is_event, jnp.maximum(longer, second), longer)
        )
        following = following * self._share_to_release(
            state, end, t - step.t0, following, was_touching & is_touching & ~is_event
        )
        # A step that was too long only because it went far beyond the event is right up to there.
        is_event_to_blame = found.crosses & (share * _BEYOND < _NEAR_END)
        again = jnp.where(passes | is_event_to_blame, up_to_event, longer)
        coming = jnp.where(keep, following, jnp.maximum(again, shortest))
        state = Pace(
            jnp.where(keep, end.value, state.value),
            jnp.where(keep, end.rate, state.rate),
            expected,
            jnp.where(is_event, 0, state.n_since + keep),
            jnp.where(is_event, 0.0, duration),
            ~passes | (state.was_rejected & ~keep),
            jnp.where(keep, jnp.any(began), state.in_root),
        )
        return Judgment(keep, t, coming, y, state, is_event, None, began & keep)

    def _event(self, contacts: Contacts, step: Step, state: Pace, was_touching, passes) -> Found:
        """The first contact event inside a step, on the states inside it."""
        size = step.t1 - step.t0
        sign = jnp.where(was_touching, -1.0, 1.0)

        def slopes(rate, x):
            return sign * rate * size * jnp.where(state.in_root, 2 * x, 1.0)

        end = contacts.crossings(step.parameters, step.t1, step.y1)
        low = _Bound(jnp.array(0.0), sign * state.value, slopes(state.rate, 0.0))
        high = _Bound(jnp.array(1.0), sign * end.value, slopes(end.rate, 1.0))
        fractions = crossing_fraction(low.value, low.slope, high.value, high.slope, _WINDOW)
        tops = fraction_of_maximum(low.value, low.slope, high.value, high.slope)
        # A contact whose crossing function rises first and falls last may have crossed in between.
        guesses = jnp.where(fractions < 1, fractions, 1 + jnp.where(tops < 1, -high.value, jnp.inf))
        is_first = jnp.arange(guesses.shape[0]) == jnp.argmin(guesses)

        def of_first(bound: _Bound) -> _Bound:
            return _Bound(bound.x, *(jnp.sum(jnp.where(is_first, each, 0.0)) for each in (bound.value, bound.slope)))

        def look(_, search):
            low, high, x, *_ = search
            t = step.t0 + size * jnp.where(state.in_root, x**2, x)
            y = self._corrected(step.parameters, t, self._inside(step, x))
            crossing = contacts.crossings(step.parameters, t, y)
            here = _Bound(x, sign * crossing.value, slopes(crossing.rate, x))
            is_exact = jnp.all(here.value <= _WINDOW)
            here = of_first(here)
            is_below = here.value <= 0
            is_low = is_below & ((high.value > 0) | (here.slope > 0))
            low, high = (
                jax.tree.map(lambda new, old, chosen=chosen: jnp.where(chosen, new, old), here, bound)
                for bound, chosen in ((low, is_low), (high, ~is_low))
            )
            is_exact = is_exact & ~is_below
            return low, high, jnp.where(is_exact, x, guess(low, high)), is_exact, y

        def guess(low: _Bound, high: _Bound):
            """Where the cubic between the bounds crosses; where it is highest, if it does not."""
            width = high.x - low.x
            cubic = low.value, low.slope * width, high.value, high.slope * width
            fraction = jnp.where(high.value > 0, crossing_fraction(*cubic, _WINDOW), fraction_of_maximum(*cubic))
            return low.x + fraction * width

        low, high = of_first(low), of_first(high)
        x0 = guess(low, high)
        search = low, high, x0, jnp.array(False), step.y1
        _, high, x, is_exact, y = jax.lax.fori_loop(0, _LOOKS, look, search)
        # A step that was too long says where it crosses by its ends alone.
        crosses = jnp.where(passes, is_exact | (high.value > _WINDOW), jnp.min(fractions) < 1)
        return Found(crosses, is_exact, jax.lax.stop_gradient(jnp.where(passes, x, x0)), y)

    def _share_to_release(self, state: Pace, end, size, following, may_release) -> Array:
        """The share of the following step that ends just behind a release, as the motion of the last one has it."""
        ratio = following / size
        slope0, slope1 = state.rate * size, end.rate * size
        c3 = 2 * (state.value - end.value) + slope0 + slope1
        c2 = 3 * (end.value - state.value) - 2 * slope0 - slope1 + 3 * c3
        value = end.value + ratio * (slope1 + ratio * (c2 + ratio * c3))
        slope = slope1 + ratio * (2 * c2 + ratio * 3 * c3)
        fractions = crossing_fraction(-end.value, -slope1 * ratio, -value, -slope * ratio, _WINDOW)
        return jnp.min(jnp.where(may_release & (fractions < 1), jnp.minimum(fractions * _BEYOND, 1.0), 1.0))

    def _inside(self, step: Step, x) -> Array:
        """The state at a fraction of the step."""
        n, degree = self.inside.shape
        weights = jnp.zeros(n)
        for m in reversed(range(degree)):
            weights = (weights + self.inside[:, m]) * x
        return step.y0 + sum(weights[i] * step.k[i] for i in range(n) if self.inside[i].any())  # pyright: ignore[reportOptionalSubscript]

    def _corrected(self, parameters, t, y) -> Array:
        return y if self.correct is None else self.correct(parameters, t, y)

    def _scaled_error(self, step: Step) -> Float[Array, ""]:
        controller = self.problem.controller_of(step.parameters)
        scale = controller.atol + jnp.maximum(jnp.abs(step.y0), jnp.abs(step.y1)) * controller.rtol
        error = controller.norm(step.error / scale)
        return jax.lax.stop_gradient(jnp.where(jnp.isnan(error), jnp.inf, error))

    def _limited(self, size) -> Float[Array, ""]:
        longest = self.problem.longest_step
        return size if longest is None else jnp.minimum(size, longest)


class _Bound(NamedTuple):
    """Crossing functions (positive beyond the event) and their slopes at a fraction of a step."""

    x: Array
    value: Array
    slope: Array

"""Steps of explicit Runge-Kutta methods that end on contact events inside them; a run needs half of the steps so.

* A flight is smooth far beyond the contact surface. So a trial step may go far beyond it, and ends on it: the crossing
  is found on the states inside the step, and one of them is the step's end where that is accurate enough. A step
  without an event is certified to have none (`solvers.crossing_search`).
* Contact begins like the power 3/2 of time, which no method's order survives, and sensitivities like the power 1/2. In
  the root of the time since then both are smooth, and steps in contact are made in it: with t = t0 + h ((1 - b) x +
  b x^2) the same stages integrate dy/dx = h (1 - b + 2 b x) f. The first step has b = 1, those long after none.
* Contact ends with the same powers. Where the motion of the last step says that a contact will end within the next few,
  these are made in the root of the time that is left, and one that would go beyond the end is made to end there
  (b = -1). That one has a limit: its last stages are so near to the surface that what is small beside the way of the
  step is not small beside theirs. With sensitivities such steps fail from some size on, and are made in two.
* The error of a step says how long it is to be in the time that it is made in.
* After an event the first two steps are of the sizes that suited the last time.
* A touch (of a stop, a tyre) has no memory: beyond its surface the stages of a step feel it, and where its stiffness is
  there at once the derivatives of the state (`sensitivity_rows`) have rates that jump there. A stage on the wrong side
  is an error of the size of the jump, however near to the surface the step ends. So with sensitivities a step ends
  short of a touch, and a step whose stages all lie before its end goes over the surface (`_over_the_kink`). Contacts
  whose stiffness is there at once end in the same way; they begin in the mode of flight, which has no such jump.

Arrays have their lanes on the last axis.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from spherejax.foundations.lanes import in_lanes
from spherejax.motion.integration.lanes.control import BlockSteps, Judgment
from spherejax.motion.integration.lanes.first_step import InitialStepProbe, first_look, first_size, looked_along
from spherejax.motion.integration.lanes.over_kinks import (
    STAGES_OVER_KINK,
    end_over_kink,
    nearest_kink,
    side_of_kinks,
    slope_over_kink,
)
from spherejax.motion.integration.lanes.stages import ExplicitStages, own_time
from spherejax.motion.integration.sampling import SampledElements
from spherejax.motion.integration.sensitivity_rows import share_of_own_size
from spherejax.motion.solvers.crossing_search import FoundCrossings, crossing_fraction, first_event
from spherejax.motion.solvers.landing import (
    LANDING_WINDOW,
    NOT_FINITE_RESULT,
    ContactFunctions,
    finite_size,
    holds_together,
    longest_ball_step,
    shortest_step,
    windows_of,
)
from spherejax.physics.joints.base import Crossing

SAFETY, SMALLEST_FACTOR, LARGEST_FACTOR = 0.9, 0.2, 10.0
"""Of the change of a step's size, as in diffrax."""

_ACCURATE_INSIDE = 1e-6
"""States inside a step are as accurate as its end where the scaled error is below this..."""

_NEAR_END = 0.95
"""... or behind this fraction of the step."""

_FORESIGHT = 4.0
"""So many steps ahead the end of a contact is looked for."""

_FIRST_PART = 0.91
"""Of the time until the end of a contact, where it is too long for one step: in its root seven tenths of the way."""

_AIM_ORDER = 3
"""With what power of its size the error of a step grows that ends with its contact and was too long (2.6 to 3 with
sensitivities of a dry four-bar)."""

_CAUTION = 0.9
"""The first steps after an event are this much shorter than those that suited the last time: impacts differ."""

_LIKE_LAST_FLIGHT = 1.5
"""The first step of a flight is at most this much longer than the last flight was."""

_BEYOND = 1.005
"""A step that is made again to end on an event is made this much longer: one can be found inside it, not ahead."""

_SHORT = 1e-3
"""A step whose sensitivities are integrated ends by this share of its size short of a touch. Its stages stray from the
motion by less, or its error is too large."""

_NEAR = 1e-2
"""From this share of the last step on before a touch the step over it is made: its error is of the fourth order."""

BEHIND = 2 * _NEAR
"""States so far behind a step, by its size, are states inside it too: that step over a touch is not one of its own."""

_TOUCH_TURNS = 3
"""Newton's method finds the end of that step; each turn squares an error that is a thousandth at first."""


class Pace(NamedTuple):
    """State of `Landing`.

    Attributes:
        start: crossing functions at the start of the coming step.
        acceleration: how fast their velocities changed in the step before [1/s^2]; negative where that says nothing.
        expected: sizes [s] of the first and second step after a release (first row) and after an onset; 0 if unknown.
        n_since: steps since the latest event.
        duration: time since the latest event [s].
        was_rejected: whether the last trial step was too long.
        since: time since contact began [s], if that was the latest event; else infinite.
        until: time until it ends [s], as the last step's motion has it; infinite where it does not.
        longest_last: how long the last step of a contact may be [s].
    """

    start: Crossing
    acceleration: Float[Array, "n n_lanes"]
    expected: Float[Array, "2 2 n_lanes"]
    n_since: Int[Array, " n_lanes"]
    duration: Float[Array, " n_lanes"]
    was_rejected: Bool[Array, " n_lanes"]
    since: Float[Array, " n_lanes"]
    until: Float[Array, " n_lanes"]
    longest_last: Float[Array, " n_lanes"]


class Landing:
    """Steps that end on contact events inside them; see the module's docstring.

    Args:
        problem: what is integrated.
        order: of the error estimate.
        steps: the method's stages.
    """

    def __init__(self, problem, order, steps: ExplicitStages):
        self.problem, self.order = problem, order
        self.inside, self.instants = steps.inside, steps.instants
        self.contacts: ContactFunctions | None = problem.contacts
        self.correct: Callable | None = problem.correct
        self.samples: SampledElements | None = problem.samples

    def init(self, term, t0, t_end, y0, parameters):
        """The end of the first step [s], and the control's state, of one lane."""
        t1, _ = self.problem.controller_of(parameters).init(
            term, t0, t_end, y0, None, parameters, self.problem.solver.func, self.order
        )
        # diffrax's guess is infinite, or not a number, where the rate at the start is zero.
        size = finite_size(t1 - t0, t_end - t0)
        return self._first(t0, size, y0, parameters), self._pace(t0, y0, parameters)

    def init_with_looks(self, t0, t_end, y0, parameters):
        """As `init`, with the end of the first look in place of the first step."""
        return first_look(t0, t_end, shortest_step(t0, t_end)), self._pace(t0, y0, parameters)

    def looked(
        self, looks: InitialStepProbe, t0, t_end, y0, size, k, parameters
    ) -> tuple[InitialStepProbe, Float[Array, " n_lanes"]]:
        """What is known after a look, and where the next one, or the first step, ends.

        Args:
            looks: before it.
            t0, y0: the start.
            t_end: where the run ends [s].
            size: of the look [s].
            k: increments of its stages.
            parameters: what the right-hand side is given.
        """

        def next_end(slope, slope_along, y0, size, parameters):
            controller = self.problem.controller_of(parameters)
            # The first look gives the rate at the start, the second the rate a small step along it: Hairer's two
            # evaluations, made as steps of the loop so that the program holds the stages once.
            along = looked_along(controller, y0, slope)
            again = t0 + finite_size(along, span) / self.instants[1]
            along = size * self.instants[1]
            size = finite_size(first_size(controller, self.order, y0, slope, along, slope_along), span)
            return jnp.where(looks.turn == 0, again, self._first(t0, size, y0, parameters))

        span = t_end - t0
        slope = jnp.where(looks.turn == 0, k[0] / size, looks.slope)
        end = in_lanes(next_end)(slope, k[1] / size, y0, size, parameters)
        return InitialStepProbe(looks.turn + 1, slope, jnp.array(False)), end

    def _first(self, t0, size, y0, parameters):
        room = jnp.inf if self.problem.room is None else self.problem.room(parameters, t0, y0)
        return t0 + self._limited(size, room, shortest_step(t0, t0 + size))

    def _pace(self, t0, y0, parameters) -> Pace:
        # Without contacts the control carries arrays of nothing, so that its state has one form.
        start = Crossing(jnp.zeros(0), jnp.zeros(0), jnp.zeros((0, 3)))
        if self.contacts is not None:
            start = self.contacts.crossings(parameters, t0, y0)
        no, far = jnp.array(False), jnp.array(jnp.inf)
        unknown, none = -jnp.ones_like(start.value), jnp.zeros((2, 2))
        return Pace(start, unknown, none, jnp.array(2, jnp.int64), jnp.array(0.0), no, far, far, far)

    def time_warp(self, state: Pace, size) -> Float[Array, " n_lanes"]:
        """Of the time that the coming steps are made in: the root of the time since the onset, or until the release.

        With t = t_onset + (x0 + (x1 - x0) x)^2 the bend is (x1 - x0) / (x1 + x0); before a release it is the negative.
        Of both together it is what leaves each as it is where its own step begins, or ends, at the event: 1 or -1.
        """
        after, before = _bend(state.since, state.since + size), _bend(state.until - size, state.until)
        both = after * before
        return (after - before) / jnp.where(both < 1, 1 - both, 1.0)

    def judge(self, step: BlockSteps, state: Pace, was_jump) -> Judgment:
        """What becomes of the trial steps."""
        size, shortest = step.t1 - step.t0, shortest_step(step.t0, step.t1)
        error, is_finite = self._scaled_error(step)
        # As in diffrax, a step passes whose scaled error is below one.
        passes, unseen = error < 1, None
        if self.problem.unseen is not None and self.problem.longest_step is not None:
            # A step that its error lets pass may still leap over a signal that no stage has sampled, such as a narrow
            # pulse. Rejected steps are not looked at: the look costs evaluations.
            bend, looked = self.time_warp(state, size), jnp.where(passes, size, 0.0)
            shortened = partial(self.problem.unseen.shortened, self.problem.longest_step)
            seen = in_lanes(shortened)(step.parameters, step.t0, looked, step.y1, bend)
            unseen = passes & (seen < looked)
            passes, error = passes & ~unseen, jnp.where(unseen, jnp.maximum(error, 1.0), error)
        # A step behind a rejected one does not grow: it would be rejected as well.
        largest = jnp.where(passes, jnp.where(state.was_rejected, 1.0, LARGEST_FACTOR), SAFETY)
        factor = jnp.clip(SAFETY * jnp.maximum(error, 1e-30) ** (-1 / self.order), SMALLEST_FACTOR, largest)
        longer = size * factor
        # A signal that was not seen says by itself how long the next attempt may be.
        longer = longer if unseen is None else jnp.where(unseen, jnp.minimum(longer, seen), longer)
        # Drift is corrected before contacts are looked at: the crossing functions are those of the closed mechanism.
        step = step._replace(y1=self._corrected(step.parameters, step.t1, step.y1))
        if self.contacts is None:
            state = state._replace(was_rejected=~passes)
            began = jnp.zeros((0, *passes.shape), bool)
            judgment = Judgment(passes, step.t1, longer, step.y1, state, jnp.zeros_like(passes), None, began)
        else:
            judgment = self._with_contacts(self.contacts, step, state, error, longer, factor, shortest)
        keep = judgment.keep
        # A rejected step that cannot be shorter would be tried for ever.
        has_stalled = (~keep & ~(size > shortest)) | (size == 0)
        t, y = jnp.where(keep, judgment.t, step.t0), jnp.where(keep, judgment.y, step.y0)
        made_jump = jnp.where(keep, judgment.made_jump, was_jump)
        if self.samples is not None:
            y, made_jump, judgment = self._with_samples(self.samples, step.parameters, t, y, made_jump, judgment)
        return judgment._replace(
            t=t,
            t_next=t + self._limited(judgment.t_next, self._room(step.parameters, t, y), shortest),
            made_jump=made_jump,
            verdict=in_lanes(_verdict)(has_stalled, is_finite),
        )

    def _with_samples(self, samples: SampledElements, parameters, t, y, made_jump, judgment: Judgment):
        """The states behind the samples that are due; what accelerations were says nothing of those behind them."""
        after = samples.update_lanes(parameters, t, y)
        were_taken = judgment.keep & samples.were_taken(y, after)
        y = jnp.where(judgment.keep, after, y)
        state: Pace = judgment.state
        # A controller that holds its output lets accelerations jump at a sample: those before it predict nothing.
        state = state._replace(acceleration=jnp.where(were_taken, -1.0, state.acceleration))
        return y, made_jump | were_taken, judgment._replace(y=jnp.where(judgment.keep, y, judgment.y), state=state)

    def _with_contacts(
        self, contacts: ContactFunctions, step: BlockSteps, state: Pace, error, longer, factor, shortest
    ) -> Judgment:
        """The judgment, with the coming step's size [s] in place of its end.

        Args:
            contacts, step, state, error: of the trial steps.
            longer: sizes [s] that the errors allow.
            factor: the same by the size of the steps, for those behind them.
            shortest: of a step [s].
        """
        size, passes = step.t1 - step.t0, error < 1
        # A ball touches by its memory and presses by its force: a contact that has begun may not press yet.
        was_touching = contacts.is_touching(step.y0)
        was_pressing = contacts.is_pressing(step.y0, state.start)
        found = self._event(contacts, step, state, was_pressing, passes)
        share = found.x
        # States inside a step are of a lower order than its end. They are taken for the end of a step only where the
        # step was much better than it had to be, or where the event lies near its end.
        is_accurate = (error < _ACCURATE_INSIDE) | (share > _NEAR_END)
        up_to_event = size * jnp.minimum(share * _BEYOND, 0.999)
        # Where the rounding of time leaves no instant between start and end, the end is the event.
        can_repeat = jnp.maximum(up_to_event, shortest) < size
        # A crossing that the search has bracketed and not yet met is made again, as one that is inaccurate.
        lands = passes & found.crosses & found.is_exact & is_accurate
        ends_short = jnp.zeros_like(lands)
        if self.has_rates_that_jump:
            # With derivatives no stage may lie beyond a surface at which their rates jump: the step ends short of it.
            is_kink = found.beyond[np.array(contacts.kinks)] & contacts.may_kink(step.y0)
            # Where the rounding of time leaves room for the step over the kink.
            ends_short = found.crosses & jnp.any(is_kink, axis=0) & (size > shortest / _SHORT)
            up_to_event = jnp.where(ends_short, size * share * (1 - _SHORT), up_to_event)
            lands = lands & ~ends_short
        # Made again, the step is a little longer than up to the event, which then is inside it and near its end.
        repeats = passes & found.crosses & ~lands & can_repeat
        keep = passes & ~repeats
        t = jnp.where(lands, step.t0 + size * share, step.t1)
        # Most turns land in no lane, and are spared the polynomials of all stages.
        y = jax.lax.cond(jnp.any(lands), self._landed, lambda step, *_: step.y1, step, state, lands, share)
        # What a contact remembers is the speed of its onset, taken where it began, not where the trial step went.
        y = contacts.update_lanes(step.parameters, t, step.y0, y)
        end = in_lanes(contacts.crossings)(step.parameters, t, y)
        touched = jnp.zeros_like(lands)
        if self.has_rates_that_jump:
            # A step that ends with an event does not go over a surface as well; the next one does. In a log of steps
            # (`pullback`) a row is one or the other.
            changes = jnp.any(was_touching != contacts.is_touching(y), axis=0)
            t, y, end, touched = self._over_the_kink(contacts, step, t, y, end, keep & ~lands & ~changes)
        is_touching = contacts.is_touching(y)
        began = ~was_touching & is_touching
        # An event is a change of mode, however it came about: by landing, or by a step that ended there by chance.
        is_event = keep & jnp.any(was_touching != is_touching, axis=0)
        mode, mode_now = (jnp.any(each, axis=0).astype(jnp.int64) for each in (was_touching, is_touching))
        duration = state.duration + jnp.where(keep, t - step.t0, 0.0)
        # Impacts of one joint resemble each other: the sizes that suited the first steps after the last event are tried
        # at once, in place of finding them by rejections.
        expected = self._expected(state, keep, mode, longer, is_event & (mode == 0), duration)
        # Only a contact that has pressed through the whole step can be extrapolated to its release.
        may_release = was_pressing & contacts.is_pressing(y, end) & ~is_event
        longest_last = self._longest_last(state, size, error)
        if self.has_rates_that_jump:
            # The kink of a contact is its release, and steps towards it are made in bent time as towards any release.
            # Towards a touch they are not: it only has to end them.
            may_release = may_release.at[np.array(contacts.touches, int)].set(False)
        # Towards a release steps get shorter, as the root of the time that is left does. Behind it, and behind what was
        # taken for it, the time is straight again.
        by_root = jnp.minimum(factor, _time_behind(factor, self.time_warp(state, size)))
        behind = size * jnp.where(_is_last(state, size), factor, by_root)
        following, until = self._following(
            state, end, expected, mode_now, t - step.t0, behind, is_event, may_release, longest_last
        )
        if self.has_rates_that_jump:
            is_like = ~is_event & ~touched & contacts.may_kink(y)
            following = following * self._share_to_kink(state, end, t - step.t0, following, is_like)
        acceleration = found.bend / size**2
        # A ball in flight may not pass through its socket and back within a step, which the search could not see.
        longest = longest_ball_step(end, acceleration, is_touching)
        following = jnp.minimum(following, longest)
        # A step that was too long only because it went far beyond the event is right up to there.
        is_event_to_blame = found.crosses & ((share * _BEYOND < _NEAR_END) | ends_short)
        again = jnp.where(passes | is_event_to_blame, up_to_event, longer)
        # A step that was rejected for its own error is shortened by that, one that went beyond an event up to there.
        coming = jnp.where(keep, following, jnp.maximum(again, shortest))
        # What a rejected step has found of the future is forgotten: its end is not where the run goes.
        elapsed = state.since + (t - step.t0)
        state = Pace(
            jax.tree.map(lambda new, old: jnp.where(keep, new, old), end, state.start),
            jnp.where(keep, jnp.where(is_event | touched, -1.0, acceleration), state.acceleration),
            expected,
            jnp.where(is_event, 0, state.n_since + keep),
            jnp.where(is_event, 0.0, duration),
            ~passes | (state.was_rejected & ~keep),
            jnp.where(keep, jnp.where(is_event, jnp.where(jnp.any(began, axis=0), 0.0, jnp.inf), elapsed), state.since),
            jnp.where(keep, until, state.until),
            longest_last,
        )
        return Judgment(keep, t, coming, y, state, is_event, None, began & keep)

    @property
    def _window(self) -> float | Float[np.ndarray, "n 1"]:
        """How far behind zero each crossing function may be where a step ends on its event."""
        if self.contacts is None or not self.has_rates_that_jump:
            return LANDING_WINDOW
        return windows_of(self.contacts)[:, None]

    @property
    def has_rates_that_jump(self) -> bool:
        """Whether there are sensitivities, and surfaces at which their rates may jump."""
        return self.contacts is not None and self.contacts.has_rates_that_jump

    def _over_the_kink(self, contacts: ContactFunctions, step: BlockSteps, t, y, end: Crossing, may_cross):
        """The time, the rows and the crossings behind a kink that the kept steps have come near to, and whose it was.

        The step over it is that of `over_kinks`.
        """
        kinks, room = np.array(contacts.kinks), self._room(step.parameters, t, y)

        def over(t, y, end):
            nearest = nearest_kink(contacts, y, end)
            delay = nearest.delay
            is_near = may_cross & (delay <= _NEAR * (step.t1 - step.t0)) & (delay < room)
            # The run's own end stays that of a usual step, and so does what a controller or a road asks to be stopped
            # for.
            is_near = is_near & (t + 2 * delay < step.t_end)
            behind_by = nearest.of_it(windows_of(contacts)[kinks, None] / 2 + 0 * nearest.speed)
            approach = nearest.of_it(jnp.where(nearest.comes, nearest.speed, 1.0))
            first_try = jnp.where(is_near, delay + behind_by / approach, 0.0)
            rate, crossings = in_lanes(self.problem.rate), in_lanes(contacts.crossings)

            def turn(_, found):
                size, *_ = found
                # A loop over three stages: the right-hand side stands once in the program.
                shares = jnp.array(STAGES_OVER_KINK)

                def stage(i, k):
                    before = y + size * shares[i] * jax.lax.dynamic_index_in_dim(k, jnp.maximum(i - 1, 0), 0, False)
                    slope = rate(t + shares[i] * size, before, step.parameters)
                    return jax.lax.dynamic_update_index_in_dim(k, slope, i, 0)

                k = jax.lax.fori_loop(0, 3, stage, jnp.zeros((3, *y.shape)))
                after = end_over_kink(y, size, k[0], k[2])
                there = crossings(step.parameters, t + size, after)
                beyond, speed = nearest.passed(there.value[kinks], there.rate[kinks])
                is_over = (speed > 0) & (beyond > 0)
                late = beyond / jnp.where(speed > 0, speed, 1.0)
                aim = behind_by / jnp.where(speed > 0, speed, 1.0)
                # Newton's step in the size, towards half a window behind the surface: sure to be behind it, and not to
                # be an event of its own.
                better = jnp.where(is_near & (speed > 0), jnp.maximum(size + aim - late, 0.0), size)
                return better, size, after, slope_over_kink(k[0], k[2]), late, is_over, there

            nothing = first_try, first_try, y, y, first_try, is_near, end
            _, size, after, slope, late, is_over, there = jax.lax.fori_loop(0, _TOUCH_TURNS, turn, nothing)
            # A step that did not get over, or went beyond by more than its way there, is not made; the loop goes on as
            # usual.
            touched = is_near & is_over & (late <= delay)
            behind = rate(t + size, after, step.parameters)
            after = after + jnp.where(touched, late, 0.0) * (behind - slope)
            # Contacts come before touches among the surfaces, and only they have a memory.
            if kinks[0] < contacts.n_contacts:
                after = contacts.update_lanes(step.parameters, t + size, y, after)
            chosen = jax.tree.map(lambda new, old: jnp.where(touched, new, old), (t + size, after, there), (t, y, end))
            return (*chosen, touched)

        # The branch is taken by the whole block where one lane needs it, and by none in most turns.
        sign = side_of_kinks(end.value[kinks])
        near = (-sign * end.value[kinks]) <= _NEAR * (step.t1 - step.t0) * sign * end.rate[kinks]
        is_any = jnp.any(may_cross & jnp.any(near, axis=0))
        none = jnp.zeros_like(may_cross)
        return jax.lax.cond(is_any, over, lambda t, y, end: (t, y, end, none), t, y, end)

    def _landed(self, step: BlockSteps, state: Pace, lands, share) -> Float[Array, "... n_lanes"]:
        """The states inside the steps that end there, those at the ends of the others."""
        return jnp.where(lands, self._state_inside(step, state, share), step.y1)

    def _expected(self, state: Pace, keep, mode, longer, has_flown, duration) -> Float[Array, "2 2 n_lanes"]:
        """Sizes of the first steps after an event: what this step should have been, such a step is to be next time."""
        modes, places = jnp.arange(2)[:, None, None], jnp.arange(2)[:, None]
        is_place = (modes == mode) & (places == state.n_since)
        is_first_of_flight = (modes == 0) & (places == 0)
        # Of the first flight nobody knows where it began.
        is_place = is_place | (has_flown & is_first_of_flight & (state.expected == 0))
        expected = jnp.where(keep & is_place, _CAUTION * longer, state.expected)
        # Flights of a ball that comes to rest get shorter and shorter; the last one bounds the next.
        as_long = jnp.where(has_flown, _LIKE_LAST_FLIGHT * duration, jnp.inf)
        return jnp.where(is_first_of_flight, jnp.minimum(expected, as_long), expected)

    def _following(self, state: Pace, end, expected, mode, size, longer, is_event, may_release, longest_last):
        """The size of the step [s] that follows a kept one, and the time until a release that is foreseen."""
        first, second = (jnp.where(mode == 0, expected[0, i], expected[1, i]) for i in (0, 1))
        # The first step after an event is short by design, so its error says little of the second one's size.
        is_second = (state.n_since == 0) & ~is_event
        by_error = jnp.where(is_second & (second > 0), second, longer)
        following = jnp.where(is_event & (first > 0), first, by_error)
        until = self._until_release(state, end, size, following, may_release)
        return jnp.minimum(following, jnp.where(until > longest_last, _FIRST_PART * until, until)), until

    def _longest_last(self, state: Pace, size, error) -> Float[Array, " n_lanes"]:
        """How long the last step of a contact may be [s], after steps of which some were such."""
        was_last = _is_last(state, size)
        shorter = size * jnp.clip(SAFETY * jnp.maximum(error, 1.0) ** (-1 / _AIM_ORDER), 0.02, SAFETY)
        longest = jnp.where(error < 1, jnp.maximum(2 * size, state.longest_last), shorter)
        return jnp.where(was_last, longest, state.longest_last)

    def _event(self, contacts: ContactFunctions, step: BlockSteps, state: Pace, was_pressing, passes) -> FoundCrossings:
        """The first contact event inside the steps, on the states inside them."""
        size = step.t1 - step.t0

        def by_fraction(crossing: Crossing) -> Crossing:
            return crossing._replace(rate=crossing.rate * size, velocity=crossing.velocity * size)

        # A search that looks at the state alone, and not at rows of sensitivities below it, takes a fifth of the time.
        is_first = contacts.first_row is not None and self.correct is None
        crossings_at = in_lanes(contacts.crossings_of_state if is_first else contacts.crossings)

        def inside(share) -> Crossing:
            y = self._state_inside(step, state, share, is_first)
            return by_fraction(crossings_at(step.parameters, step.t0 + size * share, y))

        end = in_lanes(contacts.crossings)(step.parameters, step.t1, step.y1)
        numbers = by_fraction(state.start), by_fraction(end)
        # The search works in shares of the step: rates are per step, accelerations per step squared.
        before = state.acceleration * size**2
        found = first_event(*numbers, inside, was_pressing, passes, self._window, contacts.n_contacts, before)
        # Where a step ends is no function of the numbers: derivatives of event times come from the rows.
        return found._replace(x=jax.lax.stop_gradient(found.x))

    def _until_release(self, state: Pace, end, size, following, may_release) -> Float[Array, " n_lanes"]:
        """The time [s] until just behind a release, as the motion of the last step has it; infinite without one ahead.

        Towards a kink the motion does not change as a root does, and it is looked for in the following step alone. In a
        run with sensitivities, contacts whose exponent is traced count as kinks. Most of them do end as a root, and are
        looked for as early as the others.
        """
        assert self.contacts is not None
        n_steps = np.full((may_release.shape[0], 1), _FORESIGHT)
        are_no_roots = self.contacts.touches if self.has_rates_that_jump else self.contacts.kinks
        n_steps[list(are_no_roots)] = 1.0
        reach = n_steps * following
        # A release is a crossing function that becomes negative.
        fractions = _fractions_ahead(state.start, end, size, reach, -1.0, LANDING_WINDOW)
        return jnp.min(jnp.where(may_release & (fractions < 1), fractions * reach, jnp.inf), axis=0)

    def _share_to_kink(self, state: Pace, end, size, following, is_like) -> Float[Array, " n_lanes"]:
        """The share of the following step that ends short of a kink, as the motion of the last one has it."""
        assert self.contacts is not None
        kinks = np.array(self.contacts.kinks)
        start, end = jax.tree.map(lambda values: values[kinks], (state.start, end))
        sign = jnp.where(end.value > 0, -1.0, 1.0)
        windows = windows_of(self.contacts)[kinks, None]
        fractions = _fractions_ahead(start, end, size, following, sign, windows)
        shares = jnp.where(is_like & (fractions < 1), fractions * (1 - _SHORT), 1.0)
        return jnp.min(shares, axis=0)

    def _state_inside(self, step: BlockSteps, state: Pace, share, is_first=False) -> Float[Array, "... n_lanes"]:
        """The states after a share of the steps' time; with all rows below them, or the first row alone."""
        x = own_time(share, self.time_warp(state, step.t1 - step.t0))
        n, degree = self.inside.shape
        coefficients = jnp.asarray(self.inside.T[::-1])
        # A loop: XLA would evaluate the polynomials again for every entry of the state.
        weights = jax.lax.fori_loop(
            0, degree, lambda m, weights: (weights + coefficients[m, :, None]) * x, jnp.zeros((n, *x.shape))
        )
        k, row = step.dense_info["k"], (0,) if is_first else ()
        y = step.y0[row] + sum(weights[i] * k[(i, *row)] for i in range(n) if self.inside[i].any())
        return self._corrected(step.parameters, step.t0 + (step.t1 - step.t0) * share, y)

    def _corrected(self, parameters, t, y) -> Float[Array, "... n_lanes"]:
        return y if self.correct is None else in_lanes(self.correct)(parameters, t, y)

    def _scaled_error(self, step: BlockSteps) -> tuple[Float[Array, " n_lanes"], Bool[Array, " n_lanes"]]:
        """The root mean square of the errors by what is tolerated; of rows (`sensitivity_rows`) the worst.

        And whether it is finite: it is infinite, too, of a step whose stages do not hold together.
        """

        factor_of = self.problem.tangent_tolerance_factor

        def tolerances(parameters):
            controller = self.problem.controller_of(parameters)
            return controller.atol, controller.rtol, jnp.asarray(factor_of(parameters) if factor_of else 1.0)

        atol, rtol, factor = in_lanes(tolerances)(step.parameters)
        # diffrax's scale: of the larger of both ends.
        scale = atol + jnp.maximum(jnp.abs(step.y0), jnp.abs(step.y1)) * rtol
        by_row = self._by_row(step.error / scale)
        if self.problem.judges_by_own_size:
            share = share_of_own_size(step.y0, step.y1, atol, rtol)
            by_row = jnp.concatenate([by_row[:1], by_row[1:] / share[1:]])
        # Each row of derivatives is judged by itself: a mean would let one bad derivative hide among many good ones.
        error = jnp.maximum(by_row[0], jnp.max(by_row[1:], axis=0, initial=0.0) / factor)
        is_right = jnp.logical_not(jnp.isnan(error))
        if step.stage_defect is not None:
            is_right = is_right & self._holds_together(step.stage_defect, step, scale)
        return jax.lax.stop_gradient((jnp.where(is_right, error, jnp.inf), error < jnp.inf))

    def _holds_together(self, stage_defect: Array, step: BlockSteps, scale) -> Bool[Array, " n_lanes"]:
        """`holds_together`, of the state alone."""
        strayed, moved = (self._by_row(each / scale)[0] for each in (stage_defect, step.y1 - step.y0))
        return holds_together(strayed, moved)

    def _by_row(self, by_scale) -> Float[Array, "n_rows n_lanes"]:
        """The root mean square of what is judged, of the state and of each row below it (`sensitivity_rows`)."""
        judged = by_scale[..., : self.problem.n_judged, :]
        rows = judged.reshape(-1, *judged.shape[-2:])
        return jnp.sqrt(jnp.mean(rows * rows, axis=1))

    def _room(self, parameters, t, y) -> Float[Array, " n_lanes"] | float:
        """How soon something comes that the coming steps must not pass over."""
        return jnp.inf if self.problem.room is None else in_lanes(self.problem.room)(parameters, t, y)

    def _limited(self, size, room, shortest) -> Float[Array, " n_lanes"]:
        # What must not be passed over may be nearer than the rounding of time allows a step to be.
        size = jnp.minimum(size, jnp.maximum(room, shortest))
        longest = self.problem.longest_step
        return size if longest is None else jnp.minimum(size, longest)


def _fractions_ahead(start: Crossing, end: Crossing, size, following, sign, window) -> Float[Array, "n n_lanes"]:
    """Where in a step that follows one of a size `sign` times a crossing function becomes positive; 1 where not.

    As the cubic has it that the last step had.
    """
    ratio = following / size
    slope0, slope1 = start.rate * size, end.rate * size
    # Hermite's cubic through values and slopes at both ends, in powers of the time behind the end.
    c3 = 2 * (start.value - end.value) + slope0 + slope1
    c2 = 3 * (end.value - start.value) - 2 * slope0 - slope1 + 3 * c3
    value = end.value + ratio * (slope1 + ratio * (c2 + ratio * c3))
    slope = slope1 + ratio * (2 * c2 + ratio * 3 * c3)
    return crossing_fraction(sign * end.value, sign * slope1 * ratio, sign * value, sign * slope * ratio, window)


def _bend(near, far) -> Float[Array, " n_lanes"]:
    """(x1 - x0) / (x1 + x0) with the roots of two times to an event; 0 for one that is not expected."""
    is_known = far < jnp.inf
    near, far = (jnp.sqrt(jnp.where(is_known, jnp.maximum(each, 0.0), 1.0)) for each in (near, far))
    return (far - near) / jnp.maximum(far + near, 1e-300)


def _is_last(state: Pace, size) -> Bool[Array, " n_lanes"]:
    """Whether a step was to end with a contact."""
    return size > (1 - 1e-6) * state.until


def _time_behind(x, bend) -> Float[Array, " n_lanes"]:
    """The time of a step behind one, by the size of that, that goes on in its own time by x; at most to the release."""
    to_release = (1 + bend) / (-2 * jnp.where(bend < 0, bend, -1.0))
    x = jnp.where(bend < 0, jnp.minimum(x, to_release), x)
    return x * (1 + bend + bend * x)


def _verdict(has_stalled, is_finite):
    stalled = diffrax.RESULTS.where(is_finite, diffrax.RESULTS.dt_min_reached, NOT_FINITE_RESULT)
    return diffrax.RESULTS.where(has_stalled, stalled, diffrax.RESULTS.successful)

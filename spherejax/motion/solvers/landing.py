"""Landing on contact onsets and releases: a step-size controller, around any of diffrax, that ends a step on them.

Within a step the contact's mode (flight or contact) is frozen: a trial step from flight feels no contact force even
beyond the surface. So the motion is smooth up to the onset, which is found on the states inside the step
(`crossing_search`); the step is then taken again to end just behind it. A step without an event is one that the search
has certified to have none.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from spherejax.motion.solvers.crossing_search import FoundCrossings, first_event
from spherejax.motion.solvers.wrapping import AbstractForwardingController
from spherejax.physics.joints.base import Crossing

LANDING_WINDOW = 1e-9
"""A step has landed when the crossing function is within this of zero, on the far side: for a clearance of 0.1 mm
a penetration of 1e-13 m, at which the contact force is some nanonewtons."""

TOUCH_WINDOW = 1e-12
"""The same of a touch [m] where derivatives are integrated; positions of meters are rounded to 1e-16 of them."""

LONGEST_FLIGHT_STEP = 4.0
"""A step in flight is as long as the ball takes to this many clearances, at most. Free flight has no error that would
bound its steps; a way across the socket and back again is as long."""

LONGEST_CONTACT_STEP = 0.05
"""... and in contact, into the wall, to this many. A wall is met within far less, and a first step of fifty times the
duration of a contact can go wrong unseen: stages without weight in the end and in the error throw those that have
one out of contact, where there is no force (Flores' law at a restitution of 0.2: a ball went through the wall)."""

DEEPER = 3.0
"""Balls that are deeper than that already, in soft walls or tight sockets, get so many times deeper in a step."""


NOT_FINITE_RESULT: Any = diffrax.RESULTS.nonfinite
"""What a controller says where steps that have shrunk to the rounding of time still end in NaN or infinity."""

SHORT_OF_KINK = 1e-2
"""A step ends by this share of its size short of a kink. Stages of the first one stray from the motion by less; after
it steps are so short that nothing strays."""

APPROACH = 0.1
"""From this share of a step on before a kink the following step is made to end short of it, without a trial."""

SLOWEST_KINK = 1e-6
"""Kinks that are met more slowly [m/s], or by contacts [1/s], are landed on like others: a time has no derivative."""

SHORTEST = 1e-30
"""No step [s] is shorter, wherever zero of time is; light goes 3e-22 m in it."""


class ContactFunctions(NamedTuple):
    """What the integrator must know of a system's contacts, and of what presses from one side without a memory (stops,
    tyres: "touches"); functions take (parameters, t, y).

    Attributes:
        crossings: the crossing functions, contacts first, then touches.
        update: the flat state at the end of a step with its memory updated; takes (parameters, t, y_start, y_end).
        update_lanes: the same of a block of lanes, all arguments and results with their lanes on the last axis.
        onset_entries: index in the state of each contact's onset rate, which is zero in flight (static).
        kinks: indices of the crossing functions at which the slope df/dy of the right-hand side may jump (static): of
            every touch, and of a contact where it ends; where it begins, the frozen mode keeps the slope of the flight.
        first_row: picks, from arrays whose last axes are those of what is integrated, what belongs to the state: its
            first row, where sensitivities are rows below it. With it come the crossing functions of the state alone.
    """

    crossings: Callable
    update: Callable
    update_lanes: Callable
    onset_entries: tuple[Any, ...]
    first_row: tuple[Callable, Callable] | None = None
    kinks: tuple[int, ...] = ()

    @property
    def has_rates_that_jump(self) -> bool:
        """Whether there are sensitivities, whose rates jump where a slope of the right-hand side does."""
        return self.first_row is not None and bool(self.kinks)

    @property
    def touches(self) -> tuple[int, ...]:
        """Those of the kinks that are no contacts with a memory: stops, tyres and the like."""
        return tuple(kink for kink in self.kinks if kink >= self.n_contacts)

    def may_kink(self, y: Float[Array, " ..."]) -> Bool[Array, "n_kinks *lanes"]:
        """Which of the kinks can come next: all touches, and those contacts that are in contact mode."""
        n, is_touching = self.n_contacts, self.is_touching(y)
        always = jnp.ones(y.shape[self.n_axes :], bool)
        return jnp.stack([is_touching[i] if i < n else always for i in self.kinks])

    def at_kinks(self, values: Any) -> Any:
        """Those of values, one for each crossing function, that belong to kinks.

        By slices: XLA (JAX 0.7) aborts on some programs in which they are gathered and transposed.
        """
        return jnp.stack([values[i] for i in self.kinks])

    def of_state(self, array: Array) -> Array:
        """What of an array belongs to the state alone."""
        return array if self.first_row is None else self.first_row[0](array)

    def crossings_of_state(self, parameters: Any, t, y) -> Crossing:
        """The crossing functions of a state without rows below it."""
        return (self.crossings if self.first_row is None else self.first_row[1])(parameters, t, y)

    def is_touching(self, y: Float[Array, " ..."]) -> Bool[Array, "n_contacts *lanes"]:
        """Which contacts are in contact mode."""
        if not self.onset_entries:
            return jnp.zeros((0, *y.shape[self.n_axes :]), bool)
        return jnp.stack([y[entry] > 0 for entry in self.onset_entries])

    def is_pressing(self, y: Float[Array, " ..."], crossing: Crossing) -> Bool[Array, "n *lanes"]:
        """Which contacts are in contact mode, and which touches press."""
        return jnp.concatenate([self.is_touching(y), crossing.value[self.n_contacts :] > 0])

    @property
    def n_contacts(self) -> int:
        """Number of contacts, which remember; touches of one-sided forces come behind them."""
        return len(self.onset_entries)

    @property
    def n_axes(self) -> int:
        """Number of axes of what is integrated."""
        return 1 if self.first_row is None else 2


def windows_of(contacts: ContactFunctions) -> Float[np.ndarray, " n"]:
    """How far behind zero each crossing function may be at a step's end, where derivatives are integrated."""
    n_touches = sum(kink >= contacts.n_contacts for kink in contacts.kinks)
    return np.array([LANDING_WINDOW] * contacts.n_contacts + [TOUCH_WINDOW] * n_touches)


def is_short_of_kink(contacts: ContactFunctions, crossing: Crossing, y, t) -> Bool[Array, " n_kinks"]:
    """Which kinks the coming step begins by going over: those within their window, or the rounding of time, ahead.

    Args:
        contacts: with sensitivities or without; not in lanes.
        crossing: crossing functions at the state.
        y: the state, with sensitivities or without.
        t: its time [s].
    """
    value = contacts.at_kinks(crossing.value)
    sign = jnp.where(value > 0, -1.0, 1.0)
    way, speed = -sign * value, sign * contacts.at_kinks(crossing.rate)
    window = jnp.maximum(contacts.at_kinks(windows_of(contacts)), 16 * shortest_step(t, t) * speed)
    return contacts.may_kink(y) & (speed > SLOWEST_KINK) & (way <= window)


def start_of_step(contacts: ContactFunctions, crossing: Crossing, y, t) -> tuple[Crossing, Array]:
    """Crossing functions and state at the start of a step, behind the kink that it begins by going over (`OverKinks`).

    Of the state only what says in which mode a contact is. Unchanged where nothing kinks. Arguments as of
    `is_short_of_kink`.
    """
    if not contacts.has_rates_that_jump:
        return crossing, y
    is_short = is_short_of_kink(contacts, crossing, y, t)
    windows, value = windows_of(contacts), crossing.value
    for i, kink in enumerate(contacts.kinks):
        behind = jnp.where(value[kink] > 0, -0.5, 0.5) * windows[kink]
        value = value.at[kink].set(jnp.where(is_short[i], behind, value[kink]))
        if kink < contacts.n_contacts:
            entry = contacts.onset_entries[kink]
            y = y.at[entry].set(jnp.where(is_short[i], 0.0, y[entry]))
    return crossing._replace(value=value), y


def state_at_start(contacts: ContactFunctions, parameters: Any, t, y) -> Array:
    """The state of `start_of_step`; without what costs where no contact ends by a kink."""
    if not (contacts.has_rates_that_jump and contacts.kinks[0] < contacts.n_contacts):
        return y
    return start_of_step(contacts, contacts.crossings(parameters, t, y), y, t)[1]


def without_memory(crossings: Callable, kinks: tuple[int, ...]) -> ContactFunctions:
    """Touches of one-sided forces alone: nothing happens to the state where they begin or end."""

    def unchanged(parameters, t, start, end):
        del parameters, t, start
        return end

    return ContactFunctions(crossings, unchanged, unchanged, (), kinks=kinks)


class ErrorAndInside(NamedTuple):
    """What a solver with contacts reports of a step.

    Attributes:
        error: estimate of its error; None of a method that makes none.
        dense_info: what the states inside it are made from.
        stage_defect: see `traits.stage_defect`.
    """

    error: Any
    dense_info: Any
    stage_defect: Any = None


class LandingState(NamedTuple):
    """State of `LandingController`.

    Attributes:
        inner: state of the wrapped controller.
        first_steps: size of the first step after the latest release and after the latest onset [s]; 0 when unknown.
        is_first: whether the coming step is the first after a landing.
        is_landing: whether the coming step was shortened to land.
        start: crossing functions at the start of the coming step.
        acceleration: how fast their velocities changed in the step before [1/s^2]; negative where that says nothing.
        resumes: size of the step [s] that was shortened to end short of a kink; 0 while none is ahead.
    """

    inner: object
    first_steps: Float[Array, "2"]
    is_first: Bool[Array, ""]
    is_landing: Bool[Array, ""]
    start: Crossing | None
    acceleration: Float[Array, " n"]
    resumes: Float[Array, ""]


class LandingController(AbstractForwardingController):
    """A step-size controller that ends steps on contact onsets and releases.

    A step that the wrapped controller would keep, but that crosses a contact surface, is rejected; the next one ends
    just behind the crossing. Rejections by the wrapped controller stand. A step that has shrunk to the rounding of
    time ends the integration with `diffrax.RESULTS.dt_min_reached`.

    Attributes:
        controller: the controller that judges errors.
        contacts: the system's contacts, or None for a system without.
        interpolation: the solver's `interpolation_cls`.
        longest: the longest step [s], whatever the wrapped controller says, or None; see `motion.longest_step`.
        room: how soon [s] something comes that no step may pass over, a function of (parameters, t, y), or None.
        were_taken: whether samples were taken at the end of a step, a function of the states at its start and its end,
            or None; the state jumps there.
        unseen: looks between the stages for pulses of functions of time, or None; see `integration.unseen`.
    """

    controller: Any  # diffrax.AbstractAdaptiveStepSizeController
    contacts: ContactFunctions | None = eqx.field(static=True)
    interpolation: Callable = eqx.field(static=True)
    longest: Float[Array, ""] | None = None
    room: Callable | None = eqx.field(static=True, default=None)
    were_taken: Callable | None = eqx.field(static=True, default=None)
    unseen: Any = eqx.field(static=True, default=None)

    def wrap(self, direction):
        """Wrap the wrapped controller."""
        return eqx.tree_at(lambda own: own.controller, self, self.controller.wrap(direction))

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        """The wrapped controller's first step, by Hairer's trial where it is a `PIDController`.

        diffrax (0.7) wraps the term, to turn time around, before it asks for a first step; `PIDController` then knows
        no `ODETerm`, and would begin every run with 0.01 s. An L-stable method keeps such a step over whatever is too
        fast for it, oscillations that last included, and its error estimate says nothing: a ball that circles in a
        bushing of 1e10 N/m was at rest after it. Time never goes back here, and the wrapped term is asked.
        """
        # diffrax's wrapper of a term holds the term itself.
        terms = getattr(terms, "term", terms)
        first, inner = self.controller.init(terms, t0, t1, y0, dt0, args, func, error_order)
        first = t0 + finite_size(first - t0, t1 - t0)
        # Where steps end is no function of the numbers that has a derivative here.
        start = None if self.contacts is None else jax.lax.stop_gradient(self.contacts.crossings(args, t0, y0))
        unknown = jnp.zeros(0) if start is None else -jnp.ones_like(start.value)
        state = LandingState(inner, jnp.zeros(2), jnp.array(False), jnp.array(False), start, unknown, jnp.array(0.0))
        return self._limited(t0, first, args, y0), state

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state):
        """Judge the step's error, then whether it may end where it ends."""
        error, inside, defect = y_error if isinstance(y_error, ErrorAndInside) else (y_error, None, None)
        # A trial step that overflows has an error of infinity over infinity, and the next step would be not a number.
        overflows = ~jnp.all(jnp.isfinite(y1_candidate))
        is_wrong = overflows if defect is None else overflows | ~self._holds_together(y0, y1_candidate, defect)
        keep, next_t0, next_t1, made_jump, inner, result = self.controller.adapt_step_size(
            t0,
            t1,
            y0,
            # The controller scales errors by the state: one that overflows is hidden from it, and its error is
            # infinite.
            jnp.where(overflows, y0, y1_candidate),
            args,
            None if error is None else jnp.where(is_wrong, jnp.inf, error),
            error_order,
            controller_state.inner,
        )
        if self.unseen is not None and self.longest is not None:
            looked = jnp.where(keep, t1 - t0, 0.0)
            # Only steps that are kept are looked at for what no stage has sampled.
            seen = self.unseen.shortened(self.longest, args, t0, looked, y1_candidate)
            passes_over = keep & (seen < looked)
            keep, next_t0 = keep & ~passes_over, jnp.where(passes_over, t0, next_t0)
            next_t1 = jnp.where(passes_over, t0 + seen, next_t1)
        # From the state at which the next step starts: the end of a kept step, else the start.
        next_t1 = self._limited(next_t0, next_t1, args, jnp.where(keep, y1_candidate, y0))
        # A sample changes the rate at once: a method that would reuse its last stage must not.
        jumps = jnp.array(False) if self.were_taken is None else self.were_taken(y0, y1_candidate)
        made_jump = made_jump if self.were_taken is None else made_jump | (keep & jumps)
        size, shortest = t1 - t0, shortest_step(t0, t1)
        # A step that the rounding of time has made nothing has no error either, and would be kept for ever.
        has_stalled = (~keep & ~(jnp.abs(size) > shortest)) | (size == 0)
        is_finite = ~overflows & (True if error is None else jnp.all(jnp.isfinite(error)))
        stalled = diffrax.RESULTS.where(is_finite, diffrax.RESULTS.dt_min_reached, NOT_FINITE_RESULT)
        result = diffrax.RESULTS.where(has_stalled & (result == diffrax.RESULTS.successful), stalled, result)
        if self.contacts is None:
            state = controller_state._replace(inner=inner)
            return keep, next_t0, next_t1, made_jump, state, result
        contacts = self.contacts
        # A kink that was gone over may have changed the state at the start of the step.
        start, y0 = start_of_step(contacts, controller_state.start, y0, t0)
        was_touching = contacts.is_touching(y0)
        end = contacts.crossings(args, t1, y1_candidate)
        # In shares of this step, as all that the search works with.
        bend_before = controller_state.acceleration * size**2
        found = self._event(t0, t1, start, end, inside, args, contacts.is_pressing(y0, start), keep, bend_before)
        # Where the rounding of time leaves no instant between the start and the end, the step has landed.
        landing = t0 + jnp.maximum(found.x * size, shortest)
        ends_short = jnp.array(False)
        if contacts.has_rates_that_jump:
            is_kink = found.crosses & jnp.any(contacts.at_kinks(found.beyond) & contacts.may_kink(y0))
            ends_short = is_kink & (found.x * size > 8 * shortest)
            landing = jnp.where(ends_short, t0 + _short_of(found.x * size, shortest), landing)
        # A step whose error was too large is repeated for that, and searched when it is made again.
        must_land = keep & found.crosses & (landing < t1)
        keep = keep & ~must_land
        is_touching = contacts.is_touching(y1_candidate)
        # Landed is what has changed its mode, whether the step was shortened for it or not.
        has_landed = keep & jnp.any(was_touching != is_touching)
        state = controller_state
        mode_now = jnp.any(was_touching).astype(jnp.int64)
        # The first whole step after an event says which size suits; one that was shortened to land says nothing.
        records = keep & state.is_first & ~state.is_landing
        first_steps = jnp.where(records & (jnp.arange(2) == mode_now), size, state.first_steps)
        # Contact and flight have time scales that differ by a thousand: each has its own first step.
        first_after = jnp.where(jnp.any(is_touching), first_steps[1], first_steps[0])
        next_t1 = jnp.where(has_landed & (first_after != 0), t1 + first_after, next_t1)
        acceleration = found.bend / size**2
        longest = longest_ball_step(end, acceleration, is_touching)
        next_t0 = jnp.where(must_land, t0, next_t0)
        next_t1 = jnp.where(must_land, landing, jnp.where(keep, jnp.minimum(next_t1, t1 + longest), next_t1))
        resumes, goes_over = state.resumes, jnp.array(False)
        if contacts.has_rates_that_jump:
            # A step that has ended short of a kink is followed by one that `OverKinks` begins behind it.
            goes_over = keep & jnp.any(is_short_of_kink(contacts, end, y1_candidate, t1))
            delay = _time_to_kink(contacts, end, y1_candidate)
            # The next step is made to end short of a kink that lies within it, so that it need not be rejected.
            approaches = keep & ~goes_over & (delay <= APPROACH * size)
            next_t1 = jnp.where(approaches, jnp.minimum(next_t1, t1 + _short_of(delay, shortest)), next_t1)
            # Behind the kink the step has the size that it had before it was shortened.
            next_t1 = jnp.where(goes_over, t1 + jnp.maximum(resumes, next_t1 - t1), next_t1)
            shortened = jnp.where(must_land & ends_short & (resumes == 0), size, resumes)
            resumes = jnp.where(keep & ~goes_over & ~approaches, 0.0, shortened)
        state = LandingState(
            inner,
            first_steps,
            is_first=has_landed | (state.is_first & ~records),
            is_landing=jnp.asarray(must_land),
            start=jax.tree.map(lambda new, old: jnp.where(keep, new, old), end, state.start),
            acceleration=jnp.where(
                keep, jnp.where(has_landed | jumps | goes_over, -1.0, acceleration), state.acceleration
            ),
            resumes=resumes,
        )
        return keep, next_t0, next_t1, made_jump | has_landed, state, result

    def _event(
        self, t0, t1, start: Crossing, end: Crossing, dense_info, args, was_pressing, keep, before
    ) -> FoundCrossings:
        """The first contact event inside the step, on the states inside it."""
        contacts = self.contacts
        assert contacts is not None
        # Of the state alone: rows of derivatives below it have no part in the search.
        states = self.interpolation(t0=t0, t1=t1, **jax.tree.map(contacts.of_state, dense_info))

        def by_fraction(crossing: Crossing) -> Crossing:
            return crossing._replace(rate=crossing.rate * (t1 - t0), velocity=crossing.velocity * (t1 - t0))

        def inside(x) -> Crossing:
            t = t0 + x * (t1 - t0)
            return by_fraction(contacts.crossings_of_state(args, t, states.evaluate(t)))

        numbers = by_fraction(start), by_fraction(end)
        window = windows_of(contacts) if contacts.has_rates_that_jump else LANDING_WINDOW
        return first_event(*numbers, inside, was_pressing, keep, window, contacts.n_contacts, before)

    def _holds_together(self, y0, y1, defect) -> Bool[Array, ""]:
        """`holds_together`, with the root mean square of all that is integrated for the state; prescribed steps do."""
        rtol, atol = self.rtol, self.atol
        if isinstance(rtol, float) and math.isinf(rtol):
            return jnp.array(True)
        scale = atol + jnp.maximum(jnp.abs(y0), jnp.abs(y1)) * rtol

        def size(x):
            x = x / scale if self.contacts is None else self.contacts.of_state(x / scale)
            return jnp.sqrt(jnp.mean(x * x))

        return jax.lax.stop_gradient(holds_together(size(defect), size(y1 - y0)))

    def _limited(self, t0, t1, args, y):
        """The end of a step from the state y, no later than the longest step and what comes next allow."""
        if self.room is not None:
            # As near as it may be, a step is never shorter than the rounding of time allows.
            room = jax.lax.stop_gradient(self.room(args, t0, y))
            t1 = jnp.minimum(t1, t0 + jnp.maximum(room, shortest_step(t0, t1)))
        return t1 if self.longest is None else jnp.minimum(t1, t0 + self.longest)


NO_STRAY = 10.0
"""Stages within so many tolerances of a step's end have not strayed from it, however short the way."""


def holds_together(strayed, moved) -> Bool[Array, " *lanes"]:
    """Whether the last stage that has a step's end for its instant is nearer to it than the start is.

    The check of the error's estimate, which knows only stages that have a weight in it. A first step in contact of
    25 times the duration of the impact (a ball at 0.03 m/s in a socket of 3.5 mm) sent those that have none into
    the wall, and the others flew out of it at 300 m/s, where no force is: an error of nothing, and an end as if
    there were no wall; 75 of 3,600 balls fell through stops in that way. There the stage strayed 5,000 times as
    far as the step went. In steps that are right it does by 0.8 times at most at an rtol of 1e-3, 0.3 at 1e-4 and
    0.01 at 1e-8 (impacts of a four-bar and of balls in sockets).

    Args:
        strayed: how far that stage is from the end, in tolerances.
        moved: how far the end is from the start, in tolerances.
    """
    return strayed <= jnp.maximum(moved, NO_STRAY)


def _short_of(way, shortest) -> Float[Array, ""]:
    """The size of a step [s] that ends short of a kink so far ahead [s]."""
    return jnp.maximum(way - jnp.maximum(SHORT_OF_KINK * way, 4 * shortest), shortest)


def _time_to_kink(contacts: ContactFunctions, crossing: Crossing, y) -> Float[Array, ""]:
    """How soon the next kink comes [s] at the speed of the moment; infinite where none does."""
    value = contacts.at_kinks(crossing.value)
    sign = jnp.where(value > 0, -1.0, 1.0)
    speed = sign * contacts.at_kinks(crossing.rate)
    comes = contacts.may_kink(y) & (speed > SLOWEST_KINK)
    return jnp.min(jnp.where(comes, -sign * value / jnp.where(comes, speed, 1.0), jnp.inf))


def longest_ball_step(crossing: Crossing, acceleration, is_touching) -> Float[Array, " *lanes"]:
    """The longest step [s] from a state, as far as balls in sockets are concerned; infinite without one.

    In flight U h + A h^2 / 2 = `LONGEST_FLIGHT_STEP`; in contact a ball that moves into the wall gets deeper by
    `LONGEST_CONTACT_STEP` clearances, or by `DEEPER` times what it is deep already.

    Args:
        crossing: where the step starts; U = |velocity| [1/s]. Touches behind the contacts limit nothing.
        acceleration: A [1/s^2], as the last step had it.
        is_touching: contacts that are no flight.
    """
    n = is_touching.shape[0]
    square, acceleration = jnp.sum(crossing.velocity[:n] ** 2, axis=1), acceleration[:n]
    # Crossing functions of balls are (|p|^2 - 1) / 2, with p the ball's place in clearances.
    distance = jnp.sqrt(jnp.maximum(1 + 2 * crossing.value[:n], 1e-300))
    deeper = jnp.maximum(LONGEST_CONTACT_STEP, DEEPER * (distance - 1))
    way = jnp.where(is_touching, deeper, 2 * LONGEST_FLIGHT_STEP)
    rate = jnp.where(
        is_touching, crossing.rate[:n] / distance, jnp.sqrt(square) + jnp.sqrt(square + acceleration * way)
    )
    longest = jnp.where(rate > 0, way / jnp.where(rate > 0, rate, 1.0), jnp.inf)
    return jnp.min(longest, axis=0, initial=jnp.inf)


def shortest_step(t0, t1) -> Float[Array, ""]:
    """Steps of at most this [s] are lost in the rounding of time: four units in the last place, no less than 1e-30 s.

    Time has no last place at zero: without the least length a force of NaN at t = 0 took all 20,000,000 steps.
    """
    return jnp.maximum(4 * jnp.finfo(jnp.float64).eps * jnp.maximum(jnp.abs(t0), jnp.abs(t1)), SHORTEST)


def finite_size(size, span) -> Float[Array, ""]:
    """The size of a first step [s]; a millionth of the run where its trial met what is not finite.

    Steps of the size NaN would follow each other without end; from here they shrink until they are none.
    """
    return jnp.where(jnp.isfinite(size), size, 1e-6 * span)

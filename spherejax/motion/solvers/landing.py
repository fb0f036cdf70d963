"""Landing on contact onsets and releases: a step-size controller that ends a step on them, and a solver that updates
the contact memory there. Both wrap any diffrax controller and solver; `diffrax.diffeqsolve` is used as it is.

Within a step the contact's mode (flight or contact) is frozen: a trial step from flight feels no contact force even
beyond the surface. So the motion is smooth up to the onset, which is found on the cubic Hermite interpolant of the
crossing function; the step is then taken again to end just behind it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from spherejax.motion.solvers.wrapping import AbstractForwardingController, AbstractForwardingSolver

LANDING_WINDOW = 1e-8
"""A step has landed when the crossing function is within this of zero, on the far side: for a clearance of 0.1 mm
a penetration of 1e-12 m, at which the contact force is below a micronewton."""

_NEWTON_STEPS = 6
_SMALLEST_FRACTION = 1e-6


class Contacts(NamedTuple):
    """What the integrator must know of a system's contacts; functions take (parameters, t, y).

    Attributes:
        crossings: values and rates of the crossing functions, each of shape (n_contacts,).
        update: the flat state at the end of a step with its memory updated; takes (parameters, t, y_start, y_end).
        update_lanes: the same of a block of lanes, all arguments and results with their lanes on the last axis.
        onset_entries: index in the state of each contact's onset rate, which is zero in flight (static).
    """

    crossings: Callable
    update: Callable
    update_lanes: Callable
    onset_entries: tuple[Any, ...]

    def is_touching(self, y: Float[Array, " size"]) -> Bool[Array, " n_contacts"]:
        """Which contacts are in contact mode."""
        return jnp.stack([y[entry] > 0 for entry in self.onset_entries])


class MemorySolver(AbstractForwardingSolver):
    """A solver that updates the contact memory after each step and counts onsets.

    Attributes:
        solver: the solver that makes the steps.
        contacts: the system's contacts.
    """

    solver: diffrax.AbstractSolver
    contacts: Contacts = eqx.field(static=True)

    def init(self, terms, t0, t1, y0, args):
        """The wrapped solver's state, and no onset yet."""
        n_onsets = jnp.zeros(len(self.contacts.onset_entries), jnp.int64)
        return self.solver.init(terms, t0, t1, y0, args), n_onsets

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """A step of the wrapped solver, then the events at its end."""
        inner_state, n_onsets = solver_state
        y1, error, dense_info, inner_state, result = self.solver.step(terms, t0, t1, y0, args, inner_state, made_jump)
        updated = self.contacts.update(args, t1, y0, y1)
        began = ~self.contacts.is_touching(y0) & self.contacts.is_touching(updated)
        return updated, error, dense_info, (inner_state, n_onsets + began), result


class LandingState(NamedTuple):
    """State of `LandingController`.

    Attributes:
        inner: state of the wrapped controller.
        first_steps: size of the first step after the latest release and after the latest onset [s]; 0 when unknown.
        is_first: whether the coming step is the first after a landing.
        is_landing: whether the coming step was shortened to land.
    """

    inner: object
    first_steps: Float[Array, "2"]
    is_first: Bool[Array, ""]
    is_landing: Bool[Array, ""]


class LandingController(AbstractForwardingController):
    """A step-size controller that ends steps on contact onsets and releases.

    A step that the wrapped controller would keep, but that crosses a contact surface, is rejected; the next one ends
    just behind the crossing. Rejections by the wrapped controller stand. A step that has shrunk to the rounding of
    time ends the integration with `diffrax.RESULTS.dt_min_reached`.

    Attributes:
        controller: the controller that judges errors.
        contacts: the system's contacts, or None for a system without.
        longest: the longest step [s], whatever the wrapped controller says, or None; see `motion.longest_step`.
    """

    controller: Any  # diffrax.AbstractAdaptiveStepSizeController
    contacts: Contacts | None = eqx.field(static=True)
    longest: Float[Array, ""] | None = None

    def wrap(self, direction):
        """Wrap the wrapped controller."""
        controller = self.controller.wrap(direction)
        return LandingController(controller, self.contacts, self.longest)  # pyright: ignore[reportCallIssue]

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        """The wrapped controller's first step."""
        first, inner = self.controller.init(terms, t0, t1, y0, dt0, args, func, error_order)
        return self._limited(t0, first), LandingState(inner, jnp.zeros(2), jnp.array(False), jnp.array(False))

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state):
        """Judge the step's error, then whether it may end where it ends."""
        keep, next_t0, next_t1, made_jump, inner, result = self.controller.adapt_step_size(
            t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state.inner
        )
        next_t1 = self._limited(next_t0, next_t1)
        size, shortest = t1 - t0, shortest_step(t0, t1)
        has_stalled = ~keep & (jnp.abs(size) <= shortest)
        result = diffrax.RESULTS.where(
            has_stalled & (result == diffrax.RESULTS.successful), diffrax.RESULTS.dt_min_reached, result
        )
        if self.contacts is None:
            state = controller_state._replace(inner=inner)
            return keep, next_t0, next_t1, made_jump, state, result
        was_touching = self.contacts.is_touching(y0)
        fraction = _fraction_to_crossing(self.contacts, t0, t1, y0, y1_candidate, args, was_touching)
        # Where the rounding of time leaves no instant between the start and the end, the step has landed.
        landing = t0 + jnp.maximum(fraction * size, shortest)
        must_land = keep & (fraction < 1) & (landing < t1)
        keep = keep & ~must_land
        is_touching = self.contacts.is_touching(y1_candidate)
        has_landed = keep & jnp.any(was_touching != is_touching)
        state = controller_state
        mode_now = jnp.any(was_touching).astype(jnp.int64)
        records = keep & state.is_first & ~state.is_landing
        first_steps = jnp.where(records & (jnp.arange(2) == mode_now), size, state.first_steps)
        first_after = jnp.where(jnp.any(is_touching), first_steps[1], first_steps[0])
        next_t0 = jnp.where(must_land, t0, next_t0)
        next_t1 = jnp.where(
            must_land,
            landing,
            jnp.where(has_landed & (first_after != 0), t1 + first_after, next_t1),
        )
        state = LandingState(
            inner,
            first_steps,
            is_first=has_landed | (state.is_first & ~records),
            is_landing=jnp.asarray(must_land),
        )
        return keep, next_t0, next_t1, made_jump | has_landed, state, result

    def _limited(self, t0, t1):
        """The end of a step, no later than the longest step allows."""
        return t1 if self.longest is None else jnp.minimum(t1, t0 + self.longest)


def shortest_step(t0, t1) -> Float[Array, ""]:
    """Steps of at most this [s] are lost in the rounding of time: four units in the last place."""
    return 4 * jnp.finfo(jnp.float64).eps * jnp.maximum(jnp.abs(t0), jnp.abs(t1))


def _fraction_to_crossing(contacts: Contacts, t0, t1, y0, y1, args, was_touching) -> Float[Array, ""]:
    """The fraction of the step at which the first contact changes mode; 1 when none does, or when it has landed."""
    start, end = contacts.crossings(args, t0, y0), contacts.crossings(args, t1, y1)
    sign = jnp.where(was_touching, -1.0, 1.0)
    fractions = crossing_fraction(
        sign * start.value, sign * start.rate * (t1 - t0), sign * end.value, sign * end.rate * (t1 - t0)
    )
    return jax.lax.stop_gradient(jnp.min(fractions))


def crossing_fraction(g0, slope0, g1, slope1, window: float = LANDING_WINDOW):
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
        return low, high, jnp.where((newton > low) & (newton < high), newton, (low + high) / 2)

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


def count_of(solver_state) -> Int[Array, " n_contacts"]:
    """Number of onsets of each contact, from the final state of a `MemorySolver`."""
    return solver_state[1]

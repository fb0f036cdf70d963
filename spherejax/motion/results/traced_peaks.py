"""Peaks within `jax.jit`, `jax.vmap` and `jax.grad`: a fixed number of steps is kept, and the peak has derivatives.

Which step has the peak is looked for without derivatives, at the steps of the repeated run, as `impacts.peak` does it.
The state is then taken at eight instants of that step (`between.states_at`), with its derivatives by the numbers of the
scene. The polynomial through the quantity there has its maximum at a share x* of the step, and its value there is

    P(x*) = sum_j L_j(x*) g_j,    dP(x*)/dp = sum_j L_j(x*) dg_j/dp,

the partial derivative at the instant of the peak: where dg/dt = 0, a shift of that instant changes nothing. A peak at
the start or at the end of the run has the derivative at that time. Elsewhere the largest value may be that at the end
of a step where the quantity jumps (a damper that is there at once when contact begins). Its instant moves with the
numbers, and so does the value along the flank: the derivative is refused there, while the program runs.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Flag, Scalar
from spherejax.motion.equations.programs import program_for
from spherejax.motion.equations.quantities import quantity
from spherejax.motion.integration.problem import Plan
from spherejax.motion.results.between import states_at
from spherejax.motion.results.impacts import Peak, magnitudes_of
from spherejax.motion.results.steps import SHARES, Repetition, repeated_in_steps
from spherejax.motion.results.traced_steps import largest_within, refusing, repetition_of, seen_at_steps
from spherejax.motion.results.within_steps import COEFFICIENTS, NODES, place_of_maximum

FLAT = 1e-3
"""The largest value of a step at one of its ends counts as a maximum where the quantity changes by less than this share
of its size, over a whole step with the slope that it has there."""

JUMPS = (
    "the largest {name} of the run is where it jumps, or has a kink: at the beginning or the end of a contact, or "
    "where a function of time turns. That instant moves with the numbers, and the value along with it, which the "
    "derivative of the peak does not contain. Take differences of runs, or a law without a jump (an exponent of 1.5 of "
    "the damping, as Lankarani and Nikravesh have)"
)

TOO_MANY = "the run has more than {steps} steps, so its peak is not known; give more: run.peak({name!r}, steps=...)"


class _Step(NamedTuple):
    """Where the peak is.

    Attributes:
        begin: of the step with the largest values within [s].
        length: of that step [s].
        at_end: an end of a step, or the start of the run, with the largest value of all of these [s].
        is_at_end: whether that value is larger than all within steps.
        n: steps of the run.
    """

    begin: Scalar
    length: Scalar
    at_end: Scalar
    is_at_end: Flag
    n: Array


def traced_peak(run: Any, name: str, steps: int) -> Peak:
    """The largest magnitude of a quantity, and when, of a single run whose numbers are traced.

    Args:
        run: a `Trajectory`.
        name: of the quantity.
        steps: largest number of steps that the run may have.
    """
    interval = _where(run, name, steps)
    inside = interval.begin + jnp.asarray(NODES) * interval.length
    states = states_at(run, jnp.append(inside, interval.at_end))
    values = states.value(name)
    values = jax.vmap(safe_norm)(values) if values.ndim > 1 else jnp.abs(values)
    coefficients = jnp.asarray(COEFFICIENTS) @ values[:-1]
    s, is_smooth = _largest(jax.lax.stop_gradient(coefficients))
    within, share = jnp.polyval(coefficients, s), (s + 1) / 2
    time = jnp.where(interval.is_at_end, interval.at_end, interval.begin + share * interval.length)
    ends = jnp.asarray(run.ts)[jnp.array([0, -1])]
    # An end of a step that is an end of the run stays where it is.
    is_fixed = jnp.any(time == ends)
    value = jnp.where(interval.is_at_end, values[-1], within)
    value = refusing(JUMPS.format(name=name), value, is_fixed | (~interval.is_at_end & is_smooth))
    return Peak(eqx.error_if(value, interval.n > steps, TOO_MANY.format(steps=steps, name=name)), time)  # pyright: ignore


def _largest(coefficients: Float[Array, " 8"]) -> tuple[Scalar, Flag]:
    """Where from -1 to 1 the polynomial is largest, and whether that is a maximum."""
    s, slopes = place_of_maximum(coefficients), jnp.polyder(coefficients)
    values = jnp.polyval(coefficients, jnp.linspace(-1.0, 1.0, 101))
    is_flat = 2 * jnp.abs(jnp.polyval(slopes, s)) <= FLAT * jnp.max(jnp.abs(values))
    return s, (jnp.abs(s) < 1) | is_flat


def _where(run: Any, name: str, steps: int) -> _Step:
    """The step that has the peak; no derivative passes, and `jax.vmap` of it is a loop."""
    if not isinstance(steps, int) or steps < 1:
        raise SceneError(f"steps = {steps!r} must be a whole number, the largest number of steps that the run may have")
    plan, again = repetition_of(run)
    look = jax.custom_batching.sequential_vmap(partial(_looked, plan, quantity(name, run.system).name, steps))
    return look(jax.lax.stop_gradient(jax.tree.map(jnp.asarray, again)))


def _looked(plan: Plan, name: str, steps: int, again: Repetition) -> _Step:
    theta, y0, ends = again.theta, again.y0, again.ends
    begin = ends[0]
    times = jnp.stack([begin, (begin + ends[1]) / 2, ends[1]])  # a run of two samples has no states within steps
    outcome, log = repeated_in_steps(plan, steps, again, times)
    n = outcome.n_accepted[0]
    times, states = log.times[0], log.states[0]
    k = len(SHARES) + 1
    program = program_for(magnitudes_of((name,)), plan.structure, plan.scalar, is_quiet=True)

    def see(t, y):
        return program(theta, t, y)

    seen = seen_at_steps(see, 1, times.ravel(), states.reshape(-1, y0.shape[0]), n * k).reshape(steps, k)
    first = see(begin, y0)[0]
    lengths = times[:, -1] - jnp.concatenate([begin[None], times[:-1, -1]])
    best = jnp.where(jnp.arange(steps) < n, largest_within(seen[:, :-1]), -jnp.inf)
    step = jnp.argmax(best)
    at_ends = jnp.concatenate([first[None], seen[:, -1]])
    end = jnp.argmax(at_ends)
    at_end = jnp.concatenate([begin[None], times[:, -1]])[end]
    # The cubic is wrong by 1e-5 or so; of a peak beside the end of a step the octic says more.
    is_at_end = at_ends[end] > best[step] * (1 + 1e-4)
    length = jnp.where(n > 0, lengths[step], 0.0)
    return _Step(jnp.where(n > 0, times[step, -1] - length, begin), length, at_end, is_at_end, n)

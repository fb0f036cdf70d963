"""The state of a run at any time: the run is made once more, from the same start, and sampled there.

A run keeps its samples, not its steps. Repeated by the same method and tolerances it makes the same steps, and has the
states within them by the method's own interpolation, as samples have them: between impacts as within them.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.behind_tracers import shared_behind
from spherejax.foundations.checks import is_concrete, is_tracing, shown
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import is_numeric, visible
from spherejax.foundations.lanes import rows_at
from spherejax.model.system import flatten_system, split, with_laws_by_factor
from spherejax.motion.derivatives.sensitivities import integrate_with_sensitivities
from spherejax.motion.equations.contacts import abrupt_contacts
from spherejax.motion.integration.problem import Plan, RunInputs, RunMethod
from spherejax.motion.integration.status import SimulationError, Status
from spherejax.motion.results.global_error import repeated
from spherejax.motion.results.motion_state import MotionState
from spherejax.motion.results.steps import compared_samples, warn_where_they_part
from spherejax.motion.settings import RunSettings
from spherejax.motion.solvers.automatic import choose_solver

ROUNDING = 4 * np.finfo(np.float64).eps
"""A time beyond an end of the run by this share of its times is that end: sums of steps are rounded."""


def states_at(run: Any, t: Any) -> MotionState:
    """The state of a run at a time, or the states at many.

    Args:
        run: a `Trajectory`, a single one.
        t: a time [s], or many of shape (k,), in any order.

    Raises:
        SceneError: for times that are none or that lie outside of the run, for many runs, and for a run that cannot be
            repeated.
        SimulationError: for a time that a failed run has not reached.
    """
    if np.ndim(run.ended):
        raise SceneError(
            "at() is of a single run; of many, jax.vmap(lambda run: run.at(t))(runs), or take one lane of them first"
        )
    times = _checked_times(t)
    if is_concrete(times) and is_concrete(run.ts):
        times = _within(times, np.asarray(run.ts))
    numbers = run.ts, run.ys, run.ended, run.t_reached, run.system, run.assembly, times
    are_known = all(map(is_concrete, jax.tree.leaves(numbers))) and not is_tracing()
    return _of_numbers(run, times) if are_known else _of_traced(run, times)


def _checked_times(t: Any) -> Any:
    """Times as an array of shape () or (k,)."""
    if not is_numeric(visible(t)):
        raise SceneError(f"t = {shown(t)} is no time and no list of times; give numbers [s]")
    are_known = all(map(is_concrete, jax.tree.leaves(t)))
    times: Any = np.asarray(visible(t), np.float64) if are_known else jnp.asarray(t, jnp.float64)
    if times.ndim > 1 or times.size == 0:
        raise SceneError(f"t must be a time or a list of times of shape (k,), k >= 1; it has the shape {times.shape}")
    return times


def _within(times: Float[np.ndarray, "*k"], ts: Float[np.ndarray, " n"]) -> Float[np.ndarray, "*k"]:
    """The times, where they are known, within the run."""
    if not np.all(np.isfinite(times)):
        raise SceneError("t must be finite; it has NaN or infinity")
    rounding = ROUNDING * np.max(np.abs(ts[[0, -1]]))
    outside = times[(times < ts[0] - rounding) | (times > ts[-1] + rounding)]
    if outside.size:
        raise SceneError(
            f"t = {outside.flat[0]:.9g} s is outside of the run, which goes from {ts[0]:.9g} s to {ts[-1]:.9g} s. "
            "sj.continue_from(run, ts) goes on from its end"
        )
    return np.clip(times, ts[0], ts[-1])


def _settings_of(run: Any) -> RunSettings:
    """RunMethod and tolerances of the run."""
    if run.settings is None:
        raise SceneError(
            "the run cannot be repeated to see its state at another time: its tolerances were traced, or a step-size "
            "controller of its own judged its steps. Simulate it once more with rtol= as a number and without "
            "stepsize_controller=, or add the time to ts"
        )
    return run.settings


# Of a run of numbers -------------------------------------------------------------------------------------------------


def _of_numbers(run: Any, times: Float[np.ndarray, "*k"]) -> MotionState:
    ts, ys = np.asarray(run.ts), np.asarray(run.ys)
    last = float(np.max(times))
    if not bool(run.succeeded) and last > float(run.t_reached):
        raise SimulationError(f"the run did not come to t = {last:.9g} s: it {run.diagnosis}")
    at_times = ys[np.searchsorted(ts, times)] if np.isin(times, ts).all() else _repeated_at(run, ts, ys, times)
    status = np.full(times.shape, int(Status.SUCCEEDED))
    return MotionState.of(
        run.system, jnp.asarray(times), jnp.asarray(at_times), jnp.asarray(status), run.settings, run.scalar
    )


def _repeated_at(run: Any, ts: np.ndarray, ys: np.ndarray, times: np.ndarray) -> Float[np.ndarray, "*k size"]:
    """The flat states at the times, of the repeated run."""
    settings = _settings_of(run)
    last = float(np.max(times))
    # The repeated run goes to the same end, and so makes the same steps: its last step ends there, and where time
    # enters the equations its longest step is a share of its length.
    end = ts[-1] if bool(run.succeeded) else float(run.t_reached)
    own = compared_samples(ts)
    own = own[ts[own] <= end]
    sampled = np.unique(np.concatenate([ts[:1], ts[own], times.ravel(), [end]]))
    again = repeated(run, settings.rtol, ts=sampled)
    places = np.searchsorted(sampled, times)
    states = np.asarray(again.ys)
    if not np.all(np.isfinite(states[places])):
        raise SceneError(f"the run could not be repeated up to t = {last:.9g} s: the repeated run {again.diagnosis}")
    what = "the run was repeated to see its state at other times"
    warn_where_they_part(run.system, ts[own], ys[own], states[np.searchsorted(sampled, ts[own])], what)
    return states[places]


# Of a traced run -----------------------------------------------------------------------------------------------------


def _of_traced(run: Any, times: Any) -> MotionState:
    """By the road of derivatives; a time outside of the run has the status `BAD_VALUE`, one that a failed run did not
    reach the status of the run."""
    shared = shared_behind(times)
    wanted = jnp.ravel(jnp.asarray(times if shared is None else shared))
    shared = shared_behind(run.ts)  # runs with the same times go on side by side
    ts = jnp.asarray(run.ts if shared is None else shared)
    rounding = ROUNDING * jnp.max(jnp.abs(ts[jnp.array([0, -1])]))
    is_inside = (wanted >= ts[0] - rounding) & (wanted <= ts[-1] + rounding)
    clipped = jnp.where(is_inside, jnp.clip(wanted, ts[0], ts[-1]), ts[0])  # NaN is not inside
    sampled = jnp.concatenate([ts[:1], jnp.sort(clipped)])
    outcome_ys, outcome_status = _sampled(run, jnp.append(sampled, ts[-1]))  # the same end, and so the same steps
    ys = outcome_ys[1:-1][jnp.argsort(jnp.argsort(jax.lax.stop_gradient(clipped)))]
    has_come = (run.ended == Status.SUCCEEDED) | (wanted <= run.t_reached)
    ended = jnp.where(has_come, jnp.where(jnp.isfinite(ys).all(axis=-1), Status.SUCCEEDED, outcome_status), run.ended)
    ended = jnp.where(is_inside, ended, Status.BAD_VALUE)
    ys = jnp.where((ended == Status.SUCCEEDED)[:, None], ys, jnp.nan)
    states = MotionState.of(run.system, wanted, ys, ended, run.settings, run.scalar)
    if not np.ndim(times):
        return MotionState.of(run.system, wanted[0], ys[0], ended[0], run.settings, run.scalar)
    # As many motions, each with its own numbers: `jax.vmap` then goes over all of them.
    k = wanted.shape[0]
    traced = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (k, *jnp.shape(leaf))), states.traced)
    return MotionState(wanted, ys, ended, traced, states.known, states.settings, states.scalar)


def _sampled(run: Any, sampled: Float[Array, " n"]) -> tuple[Float[Array, "n size"], Array]:
    """The flat states of the repeated run at sample times that begin with its start, and its status."""
    settings = _settings_of(run)
    seen = with_laws_by_factor(run.system)
    structure, theta = flatten_system(seen)
    known, unknown = (theta, ()) if is_concrete(theta) else split(seen)
    solver, at_start = settings.solver, None
    if unknown and not settings.is_solver_named:
        choice = choose_solver(seen, settings.rtol, explicit_only=run.scalar is False and settings.scalar is None)
        solver, at_start = choice.solver, choice.at_start
    method = RunMethod.of_settings(run.system, structure, settings.replaced(solver=solver), at_start)
    values = rows_at(jnp.asarray(theta), unknown) if unknown else np.zeros(0)
    start, from_state = run.assembly, False
    if not is_concrete(start.y):
        if run.is_continued:
            from_state = True
            values = jnp.concatenate([jnp.asarray(values), start.y])
            start = start._replace(y=np.zeros(start.y.shape))
        else:
            start = None  # assembled as the run's own start was
    plan = Plan(structure, unknown, run.scalar, from_state)
    is_made = (run.ended == Status.SUCCEEDED) | (run.t_reached > sampled[0])
    inputs = RunInputs(values, known, sampled, start, is_made)
    outcome = integrate_with_sensitivities(plan, method, inputs, abrupt_contacts(run.system))
    return outcome.ys, outcome.status

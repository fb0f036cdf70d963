"""Derivatives of a run in reverse: back along the steps that it kept, for any count of parameters at one price.

What an adaptive integrator did is not to be differentiated: its rejected steps and its choice of steps have derivatives
without bound or meaning. The run is therefore made first, and the states y_n at the ends of its kept steps are stored.
Then the derivatives lambda_n of a number by y_n follow one from the other, from the last to the first,

    lambda_n = (dy_n+1/dy_n)^T lambda_n+1 + sum over samples in the step of (dy_s/dy_n)^T dnumber/dy_s,

and those by the parameters are summed beside them. Nothing has to be integrated again, so that growing errors of a
second run cannot miss an impact that the first one had. A sample within a step counts as the end of a shorter step
from the same start.

This is the transpose of what `sensitivities` does in forward mode. The run carries one sensitivity along, by a random
mixture of all parameters, whose error is controlled: the steps are then short enough for derivatives, behind contact
onsets as well (see `sensitivity_rows`). At an onset the state jumps by its delay, as there, and steps of stiff methods
are those of Ros34PW2 with its matrix held fixed (see `implicit_rows`).

It costs about as much as two or three sensitivities in forward mode. Limit: the errors of the derivatives are
controlled along the mixture, not one by one.
"""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.types import Flag
from spherejax.motion.derivatives.pullback import event_of, mixture_of
from spherejax.motion.derivatives.sensitivities import names_of_kinks
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import Program, program_for
from spherejax.motion.integration.compiling import options_for
from spherejax.motion.integration.implicit_rows import slack_of, solver_with_fixed_matrix
from spherejax.motion.integration.integrate import (
    Options,
    Parameters,
    Plan,
    contacts_of,
    correction_for,
    parameters_from,
)
from spherejax.motion.integration.jobs import JobKind, with_slopes
from spherejax.motion.integration.lanes import Block, steps_in_lanes
from spherejax.motion.integration.lanes.stages import explicit_tableau
from spherejax.motion.integration.one_run import RunRequest
from spherejax.motion.integration.sampling import samples_of
from spherejax.motion.integration.status import SimulationWarning
from spherejax.motion.solvers.kinks import over_kink
from spherejax.motion.solvers.rosenbrock import Ros34PW2
from spherejax.motion.solvers.traits import is_explicit, is_linearly_implicit
from spherejax.motion.start.assembly import Assembly
from spherejax.program_cache import cached_jit

UNSURE_THROUGH_KINKS = (
    "derivatives in reverse are not sure through {names}: where it begins to press, its stiffness may be there at "
    "once, and the errors of derivatives are controlled along one mixture of all parameters. Of a ball that bounced "
    "three times between stops of 1e8 N/m they were wrong by 7e-4. Forward sensitivities are right there: "
    "mode='forward' of sj.sensitivity, and sj.fit without sj.Descent"
)

FIRST_ROOM, MORE_ROOM = 4096, 16
"""Steps that there is room for at first, and the factor by which the room grows until it suffices."""


class KeptRun(NamedTuple):
    """A run with the steps that it kept.

    Attributes:
        ys: flat states at the sample times; NaN where a failed run did not reach a sample.
        t0: start of the motion [s].
        ends: ends of the kept steps [s]; infinite behind the last one.
        states: flat states at the start and at these ends.
        start_slopes: derivatives of the first state along the directions.
        assembly: how the start was made consistent.
        status: integer of `Status`.
        t_reached: time reached [s].
        n_steps: steps tried.
    """

    ys: Float[Array, "n size"]
    t0: Float[Array, ""]
    ends: Float[Array, " room"]
    states: Float[Array, "room+1 size"]
    start_slopes: Float[Array, "k size"]
    assembly: Assembly
    status: Int[Array, ""]
    t_reached: Float[Array, ""]
    n_steps: Int[Array, ""]


def kept_run(
    plan: Plan,
    options: Options,
    values: Float[Array, " p"],
    directions: Float[Array, "k p"],
    known: Float[Array, " n_numbers"],
    ts: Float[Array, " n"],
    start: Assembly | None,
    values_are_legal: Flag,
) -> KeptRun:
    """Make a run, and keep its steps; arguments as for `integrate_along`. Computed now."""
    names = names_of_kinks(plan)
    if names:
        warnings.warn(SimulationWarning(UNSURE_THROUGH_KINKS.format(names=names)), stacklevel=2)
    room = min(FIRST_ROOM, options.max_steps)
    request = RunRequest.of(plan.structure, replace(options, solver=_differentiable(options.solver)))
    while True:
        run, n_kept = _kept_run(plan, request, room, values, directions, known, ts, start, values_are_legal)
        if int(n_kept) <= room:
            return run
        room = min(MORE_ROOM * room, options.max_steps)


def gradients(
    plan: Plan,
    options: Options,
    values: Float[Array, " p"],
    known: Float[Array, " n_numbers"],
    ts: Float[Array, " n"],
    run: KeptRun,
    by_ys: Float[Array, "n size"],
) -> tuple[Float[Array, " p"], Float[Array, " size"]]:
    """The derivatives of a number by the traced numbers and by the first state, from those by the sampled states.

    Args:
        plan, options, values, known, ts: as for `kept_run`.
        run: a run that has succeeded.
        by_ys: derivatives of the number by the states at the samples.
    """
    legs = _legs_of(float(run.t0), np.asarray(run.ends), np.asarray(ts), np.any(np.asarray(by_ys) != 0, 1))
    return _gradients(plan, _differentiable(options.solver), values, known, run.states, legs, by_ys)


def _differentiable(solver: Any) -> diffrax.AbstractSolver:
    """The method of a run whose steps are to be differentiated; for one that has no explicit stages, Ros34PW2."""
    return solver if is_explicit(solver) or is_linearly_implicit(solver) else Ros34PW2()


@cached_jit(what="a run that keeps its steps", options=options_for)
def _kept_run(
    plan: Plan, request: RunRequest, room: int, values, directions, known, ts, start, values_are_legal
) -> tuple[KeptRun, Int[Array, ""]]:
    """The run, with room for so many steps, and how many it kept."""

    def job_of_values(values):
        return request.job(plan, values, known, ts, start, values_are_legal)

    job, _ = with_slopes(job_of_values, values, directions)
    mixture = mixture_of(directions.shape[0])
    slopes = jax.tree.map(lambda leaf: jnp.tensordot(mixture, leaf, 1), job.numbers.slopes)
    numbers = job.numbers._replace(slopes=slopes)
    rows = jnp.concatenate([job.y0[:1], mixture @ job.y0[1:]])
    # As the state's; through kinks those of a W-method less.
    solver = request.rest if is_explicit(request.rest) else Ros34PW2()
    slack = min(1.0, slack_of(solver, plan.structure))
    kind = JobKind(plan.structure, plan.scalar, request.rest, True, slack=slack, control=request.control, by_steps=True)
    problem = kind.problem(ts, request.of_all)
    own = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], (numbers, rows, job.may_run, job.status))
    numbers, first, may_run, status = own
    made, log = steps_in_lanes(problem, numbers, first, ts, may_run, status, Block(), room, ())
    made = jax.tree.map(lambda leaf: leaf[0], made._replace(n_lane_steps=made.n_lane_steps[None]))
    times, states = log.times[0, :, -1], log.states[0, :, -1, 0]
    is_kept = jnp.arange(room) < made.n_accepted
    run = KeptRun(
        made.ys[:, 0],
        ts[0],
        jnp.where(is_kept, times, jnp.inf),
        jnp.concatenate([job.y0[:1], states]),
        job.y0[1:],
        job.assembly,
        made.status,
        made.t_reached,
        made.n_accepted + made.n_rejected,
    )
    return run, made.n_accepted


# Backward -----------------------------------------------------------------------------------------------------------


class _Legs(NamedTuple):
    """Stretches from the start of a kept step to its end or to a sample within it, in the order of time.

    Attributes:
        t: starts [s].
        t_next: ends [s].
        state: number of the state at the start.
        sample: number of the sample at the end; -1 for the end of the step.
        n: how many there are; the rest fills up.
    """

    t: Float[np.ndarray, " m"]
    t_next: Float[np.ndarray, " m"]
    state: Int[np.ndarray, " m"]
    sample: Int[np.ndarray, " m"]
    n: Int[np.ndarray, ""]


def _legs_of(t0: float, ends: np.ndarray, ts: np.ndarray, is_needed: np.ndarray) -> _Legs:
    """The legs up to the last sample that is needed; samples lie behind those steps' starts, the first one on it."""
    starts = np.concatenate([[t0], ends])
    samples = np.flatnonzero(is_needed)
    steps_of_samples = np.searchsorted(ends, ts[samples], side="left")
    steps = np.arange(steps_of_samples.max(initial=0))
    state = np.concatenate([steps_of_samples, steps])
    t_next = np.concatenate([ts[samples], ends[steps]])
    sample = np.concatenate([samples, np.full(steps.size, -1)])
    order = np.lexsort((sample < 0, state))
    room = ends.size + ts.size

    def filled(array):
        return np.concatenate([array[order], np.zeros(room - order.size, array.dtype)])

    return _Legs(filled(starts[state]), filled(t_next), filled(state), filled(sample), np.asarray(order.size))


@cached_jit(what="the gradient of a run")
def _gradients(plan: Plan, solver, values, known, states, legs: _Legs, by_ys):
    rate = program_for(state_rate, plan.structure, plan.scalar)
    step, event, begun = _step_of(plan, solver, rate), event_of(plan, rate), _start_of(plan, rate)
    taken = samples_of(plan.structure, plan.scalar)

    parameters, to_values = jax.vjp(partial(parameters_from, plan, rate, known), values)

    def back(turn, found):
        by_parameters, by_state = found
        i = legs.n - 1 - turn
        t, t_next, number, sample = legs.t[i], legs.t_next[i], legs.state[i], legs.sample[i]
        is_step = sample < 0
        y, y_next = states[number], states[number + 1]

        def end_of_leg(parameters, y):
            begins, y = begun(parameters, t, y)
            end = step(parameters, begins, t_next, y)
            end = end if event is None else event(parameters, t_next, y, end, y_next, is_step)
            return end if taken is None else taken.update(parameters, t_next, end)

        _, transposed = jax.vjp(end_of_leg, parameters, y)
        more, before = transposed(jnp.where(is_step, by_state, by_ys[jnp.maximum(sample, 0)]))
        by_parameters = jax.tree.map(jnp.add, by_parameters, more)
        return by_parameters, jnp.where(is_step, before, by_state + before)

    nothing = jax.tree.map(jnp.zeros_like, parameters), jnp.zeros_like(states[0])
    by_parameters, by_start = jax.lax.fori_loop(0, legs.n, back, nothing)
    return to_values(by_parameters)[0], by_start


def _step_of(plan: Plan, solver: Any, rate: Program) -> Callable:
    """The state at the end of a step from t to t_next, with the drift control's correction; differentiable."""
    correct = correction_for(plan)
    by_solver = _rosenbrock_step if is_linearly_implicit(solver) else _explicit_step
    of_state = by_solver(plan, solver, rate)

    def step(parameters: Parameters, t, t_next, y):
        y = of_state(parameters, t, t_next, y)
        return y if correct is None else correct(parameters, t_next, y)

    return step


def _evaluated_again(rate: Program) -> Callable:
    """The right-hand side as a function of (t, y, parameters): on the way back evaluated again, not remembered."""

    @partial(jax.checkpoint, prevent_cse=False)
    def evaluated(t, y, parameters):
        return rate.inside(parameters.theta, parameters.ahead, t, y)

    return evaluated


def _explicit_step(plan: Plan, solver: Any, rate: Program) -> Callable:
    del plan
    weights = np.asarray(solver.tableau.b_sol)
    n = 1 + int(np.flatnonzero(weights)[-1])  # those behind are for estimates of the error and states inside
    tableau = explicit_tableau(solver.tableau, n, [weights])
    at_stage = _evaluated_again(rate)

    def step(parameters: Parameters, t, t_next, y):
        h = t_next - t
        k = tableau.stages(lambda t, y: at_stage(t, y, parameters), t, h, h, y)
        return y + tableau.sums_of(k)[0]

    return step


def _rosenbrock_step(plan: Plan, solver: Any, rate: Program) -> Callable:
    own = solver_with_fixed_matrix(solver, plan.structure, rate)
    term = diffrax.ODETerm(_evaluated_again(rate))

    def step(parameters: Parameters, t, t_next, y):
        return own.step(term, t, t_next, y, parameters, None, jnp.array(False))[0]

    return step


def _start_of(plan: Plan, rate: Program) -> Callable:
    """Time and state from which a step is made: behind the kink that it begins by going over; see `solvers.kinks`."""
    contacts = contacts_of(plan.structure, plan.scalar)
    if contacts is None or not contacts.kinks:
        return lambda parameters, t, y: (t, y)

    def begun(parameters: Parameters, t, y):
        return over_kink(contacts, _evaluated_again(rate), t, y, parameters)[:2]

    return begun

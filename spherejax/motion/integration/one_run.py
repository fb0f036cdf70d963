"""Runs of `simulate`: each is a lane of its own, and `jax.vmap` of it a queue of runs.

A run of numbers is two programs, its start and its windows of samples, which serve any number of samples. A run within
`jax.jit`, and one with its derivatives, is a program for its samples.
"""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete, is_tracing
from spherejax.model.system import Structure, example_of
from spherejax.motion.equations.contacts import crossings
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.equations.sampling import initial_force_memory
from spherejax.motion.integration.audit import Limits
from spherejax.motion.integration.compiling import OF_START, in_machine_code, options_for
from spherejax.motion.integration.implicit_rows import slack_of
from spherejax.motion.integration.integrate import (
    Options,
    Outcome,
    Plan,
    stages_of,
)
from spherejax.motion.integration.jobs import Job, JobKind, audit_limits, job_of, statistics, with_slopes
from spherejax.motion.integration.lanes import Block, LaneOutcome, LaneProblem, run_in_lanes
from spherejax.motion.integration.lanes.operation import runs
from spherejax.motion.integration.lanes.windows import (
    RunCheckpoint,
    WindowPace,
    WindowProgress,
    begun,
    run_loop,
    window_at,
)
from spherejax.motion.integration.row_blocks import as_numbers, placed_rows
from spherejax.motion.integration.widths import block_for
from spherejax.motion.solvers.joint_rates import fastest_in_clearance
from spherejax.motion.solvers.rosenbrock import Ros34PW2
from spherejax.motion.solvers.traits import is_explicit
from spherejax.motion.start.assembly import Assembly
from spherejax.motion.start.tolerances import controller_for
from spherejax.program_cache import cached_jit
from spherejax.program_cache.disk_cache import is_debugging


@lru_cache(maxsize=64)
def _own_rest(structure: Structure) -> Any:
    return _rest(controller_for(structure, 1.0, 1.0))


def _rest(controller) -> Any:
    """What there is to a controller besides tolerances."""
    if type(controller) is not diffrax.PIDController:
        return controller
    return tuple(value for name, value in vars(controller).items() if name not in ("rtol", "atol"))


def _numbers_apart(controller: Any) -> Any:
    """A controller whose tolerances and times are arrays: other ones need no other program."""
    numbers = [name for name in ("rtol", "atol") if isinstance(getattr(controller, name, None), int | float)]
    if type(controller) is diffrax.PIDController and numbers:
        values = [jnp.asarray(getattr(controller, name), jnp.float64) for name in numbers]
        controller = eqx.tree_at(lambda c: [getattr(c, name) for name in numbers], controller, values)
    return jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, np.ndarray) else leaf, controller)


def run_of(plan: Plan, options: Options, values, known, ts, start, values_are_legal) -> Outcome:
    """A run in a lane; arguments as of `integrated`. `jax.vmap` of a lane is a queue of runs."""
    return bound_run(plan, options, values, known, ts, start, values_are_legal)()


def bound_run(plan: Plan, options: Options, values, known, ts, start, values_are_legal) -> Callable[[], Outcome]:
    """`run_of` these arguments, to be called again and again."""
    request = RunRequest.of(plan.structure, options)
    given = plan, request, values, known, ts, start, values_are_legal
    return _in_windows(*given) if ts.shape[0] > 2 and _are_known(given) else integrated.bound(*given)


def _are_known(given: tuple) -> bool:
    """Whether a run is made now, from numbers, by a method that is known.

    Not where JAX looks for NaN and infinity in whatever a program returns: windows that are not full have both.
    """
    is_known = all(map(is_concrete, jax.tree.leaves(given))) and not is_tracing()
    return is_known and given[1].stiff_rest is None and not is_debugging()


def _in_windows(plan: Plan, request: "RunRequest", values, known, ts, start, values_are_legal) -> Callable[[], Outcome]:
    """A run of numbers, by programs that are the same for any number of samples."""
    times = np.asarray(ts)
    ends = jnp.asarray(times[[0, -1]])
    pace = _pace(plan.structure, request.rest)
    theta = np.array(known)
    theta[list(plan.unknown)] = values[: len(plan.unknown)]
    described = None if start is None else jnp.asarray(start.y)
    start = _as_flying(plan, theta, times[0], start)
    begin = started.bound(plan, request, values, known, ends, start, values_are_legal)
    known_how: list[Callable] = []

    def run() -> Outcome:
        with as_numbers():  # a run that is known is remembered, and may be asked for within a trace
            (vectors, forms), assembly = begin()
        if not known_how:  # the forms are known now
            window, n_turns = window_at(times, 0), np.asarray(pace.n_turns)
            known_how.append(advance_window.bound_but(3, plan, request, ends, forms, vectors, window, n_turns))
        (go_on,) = known_how
        found: Any = None

        def samples() -> Iterator[tuple[int, Array]]:
            nonlocal vectors, found
            first, n_turns_before = 0, 0
            while True:
                began = time.perf_counter()
                ys, found, vectors, numbers = go_on(vectors, window_at(times, first), np.asarray(pace.n_turns))
                progress = WindowProgress.of(numbers)  # waits for the program
                pace.note(progress.n_turns - n_turns_before, time.perf_counter() - began)
                n_turns_before = progress.n_turns
                yield first, ys
                first += progress.n_written - 1
                is_full = progress.n_written == len(ys) and first + 1 < len(times)
                if not (progress.is_busy or is_full):
                    return

        try:
            ys = placed_rows(samples(), len(times))
        except KeyboardInterrupt as interrupt:
            if found is not None:
                interrupt.add_note(_where_it_stopped(times, found))
            raise
        t_reached, y_reached, status, stats = found
        assembly = assembly if described is None else assembly._replace(y=described)
        return Outcome(ys, t_reached, y_reached, status, stats, assembly)

    return run


@lru_cache(maxsize=64)
def _pace(structure: Structure, rest: Any) -> WindowPace:
    """Of runs of one program; the arguments are what its turns depend on."""
    del structure, rest
    return WindowPace()


def _where_it_stopped(times: Float[np.ndarray, " n"], found: tuple) -> str:
    t_reached, _, _, stats = found
    return (
        f"simulate: stopped at t = {float(t_reached):.6g} s of {times[-1]:.6g} s, after {int(stats.n_steps):,} steps; "
        "with a ts that ends there the run succeeds"
    )


def _as_flying(plan: Plan, theta: Float[np.ndarray, " p"], t: float, start: Assembly | None) -> Assembly | None:
    """A start whose state has the memory of balls that fly, where all do: its program then need not find it.

    With what leads a ball to a place beyond its socket's surface the program has twice as many operations.
    """
    system = example_of(plan.structure)
    if start is None or not system.contact_joints or system.force_states or len(start.y) == system.layout.size:
        return start
    crossing = program_for(crossings, plan.structure, plan.scalar, is_quiet=True)  # which the run needs as well
    if crossing.scalar is None:
        return start
    y = np.concatenate([start.y, np.zeros(system.layout.size - len(start.y))])
    if system.force_slots:
        turned = program_for(initial_force_memory, plan.structure, plan.scalar, is_quiet=True)
        if turned.scalar is None:
            return start
        first = system.layout.memory_start + system.force_slots[0].start
        y[first : system.layout.work_start] = np.asarray(turned.compute(theta, t, y))
    values = crossing.compute(theta, t, y).value[: len(system.contact_joints)]
    return start._replace(y=y) if np.all(values <= 0) else start


class JobWithSlopes(NamedTuple):
    """A run and its derivatives along directions in the traced numbers.

    Attributes:
        outcome: of the run.
        ys: derivatives of its samples.
        assembly: of its assembled start, with a leading axis of directions.
    """

    outcome: Outcome
    ys: Float[Array, "k n size"]
    assembly: Assembly


def slopes_as_job(
    plan: Plan, options: Options, values, directions, known, ts, start, values_are_legal, by_start: bool = False
) -> JobWithSlopes:
    """A run and its derivatives in a lane; arguments as for `sensitivities.integrate_along`.

    With `by_start` the directions have the first sample time as their last entry.
    """
    request = RunRequest.of(plan.structure, options)
    return _with_slopes(plan, request, values, directions, known, ts, start, values_are_legal, by_start)


class RunRequest(eqx.Module):
    """How to integrate in a lane.

    Attributes:
        solver: its arrays.
        shared: tolerances that are known, which all runs of a queue share, or None; of a controller of a user's all of
            its arrays.
        own: tolerances of a run, or None.
        budget: largest number of steps.
        rest: the solver without its arrays (static).
        slack: how much larger the errors of sensitivities may be than the state's.
        stiff: arrays of the solver of a run whose joints act faster than the limit when it starts.
        stiff_rest: that solver without its arrays (static); None where there is no choice left.
        limit: a rate [1/s] (static).
        control: a step-size controller of a user's, without its arrays (static); None for that of this package.
    """

    solver: Any
    shared: Any
    own: Any
    budget: Any
    rest: Any = eqx.field(static=True)
    slack: Any = None
    stiff: Any = None
    stiff_rest: Any = eqx.field(static=True, default=None)
    limit: float = eqx.field(static=True, default=math.inf)
    control: Any = eqx.field(static=True, default=None)

    @classmethod
    def of(cls, structure: Structure, options: Options) -> "RunRequest":
        """From the options of a run."""
        solver, rest = eqx.partition(options.solver, eqx.is_array)
        controller, control = _numbers_apart(options.controller), None
        if _rest(controller) == _own_rest(structure):
            tolerances = controller.rtol, controller.atol
        else:
            tolerances, control = eqx.partition(controller, eqx.is_array)
        budget = np.asarray(options.max_steps, np.int64) if options.budget is None else options.budget
        alike = all(is_concrete(each) for each in jax.tree.leaves(tolerances))
        shared, own = (tolerances, None) if alike else (None, tolerances)
        usual = slack_of(options.solver, structure)
        slack = np.asarray(usual) if options.slack is None else options.slack
        given = solver, shared, own, budget, rest, slack
        if options.at_start is None:
            return cls(*given, control=control)
        return cls(*given, *eqx.partition(options.at_start.solver, eqx.is_array), options.at_start.limit)

    @property
    def of_stiff(self) -> "RunRequest":
        """The same with the other solver."""
        return RunRequest(self.stiff, self.shared, self.own, self.budget, self.stiff_rest, self.slack)

    def job(self, plan: Plan, values, known, ts, start, values_are_legal, is_differentiated: bool = False) -> Job:
        """The run as a job, from the traced numbers; in array code where it is differentiated itself."""
        theta, start = plan.theta(values, known), plan.start(values, start)
        limits, is_native = self.limits(plan, theta), not is_differentiated and in_machine_code(plan)
        return job_of(plan, theta, ts, start, values_are_legal, limits, self.own, is_native)

    def limits(self, plan: Plan, theta) -> Limits:
        """Of the audit."""
        tolerances = self.own if self.shared is None else self.shared
        if self.control is None:
            rtol, _ = tolerances
        else:
            rtol = getattr(eqx.combine(tolerances, self.control), "rtol", None)
        return audit_limits(plan.structure.system(theta), rtol, self.rest)

    @property
    def of_all(self) -> Any:
        """What all runs of a queue share."""
        return self.solver, self.shared, self.budget

    def problem(self, plan: Plan, ts) -> LaneProblem:
        """What is integrated, without rows."""
        return JobKind(plan.structure, plan.scalar, self.rest, control=self.control).problem(ts, self.of_all)

    def made(self, plan: Plan, job: Job, ts, with_rows: bool) -> LaneOutcome:
        """What comes of the job."""
        moving = plan.unknown if with_rows else None
        kind = JobKind(plan.structure, plan.scalar, self.rest, with_rows, moving=moving, control=self.control)
        job = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], job)
        found = runs(kind, job.numbers, job.y0, ts, job.may_run, job.status, self.of_all, block_for())
        return jax.tree.map(lambda leaf: leaf[0], found._replace(n_lane_steps=found.n_lane_steps[None]))


@cached_jit(what="a run", many="runs in lanes", options=options_for)
def integrated(plan: Plan, request: RunRequest, values, known, ts, start, values_are_legal) -> Outcome:
    """As `integrate`, in a lane.

    Where the method is chosen by numbers that are seen only now, both are compiled, and the run is made by one: a lane
    that may not run makes no step. So it is with many lanes, where `jax.lax.cond` would make each run twice.
    """
    job = request.job(plan, values, known, ts, start, values_are_legal)
    if request.stiff_rest is None:
        return _outcome(request, job, request.made(plan, job, ts, False))
    is_stiff = fastest_in_clearance(plan.structure, plan.scalar, job.numbers.theta) > request.limit
    outcomes = []
    for each, is_taken in ((request, ~is_stiff), (request.of_stiff, is_stiff)):
        numbers = job.numbers._replace(limits=each.limits(plan, job.numbers.theta))
        taken = job._replace(numbers=numbers, may_run=job.may_run & is_taken)
        outcomes.append(_outcome(each, taken, each.made(plan, taken, ts, False)))
    return jax.tree.map(lambda usual, stiff: jnp.where(is_stiff, stiff, usual), *outcomes)


@cached_jit(what="the start of a run", options=OF_START)
def started(
    plan: Plan, request: RunRequest, values, known, ends, start, values_are_legal
) -> tuple[RunCheckpoint, Assembly]:
    """A run from `ends[0]` to `ends[1]` [s] before its first window of samples, and how its start was assembled."""
    job = request.job(plan, values, known, ends, start, values_are_legal)
    run = begun(request.problem(plan, ends), job.numbers, job.y0, ends, job.may_run, job.status)
    return run, job.assembly


@cached_jit(what="a run", options=options_for)
def advance_window(plan: Plan, request: RunRequest, ends, forms: Any, vectors, window, n_turns) -> tuple:
    """Samples of the next window, what else an `Outcome` says at its end but for the assembly, the run's vectors, and
    the numbers of a `WindowProgress`.

    Args:
        plan, request, ends: as of `started`.
        forms, vectors: of the run that is under way.
        window: sample times [s].
        n_turns: turns of the loop after which the window ends, whatever is written of it.
    """
    made, vectors, progress = run_loop(
        request.problem(plan, ends), RunCheckpoint(vectors, forms), ends, window, n_turns
    )
    ys, t_reached, y_reached, status = (each[0] for each in (made.ys, made.t_reached, made.y_reached, made.status))
    of_it = jax.tree.map(lambda leaf: leaf[0], made._replace(n_lane_steps=made.n_lane_steps[None]))
    return ys, (t_reached, y_reached, status, statistics(of_it, stages_of(request.rest))), vectors, progress


def differentiable_slopes(
    plan: Plan, options: Options, values, directions, known, ts, start, values_are_legal
) -> JobWithSlopes:
    """As `slopes_as_job`, to be differentiated in forward mode: the loop over the run's steps, and no operation of JAX.

    Of methods that are not explicit, by Ros34PW2.
    """
    solver = options.solver if is_explicit(options.solver) else Ros34PW2()
    request = RunRequest.of(plan.structure, replace(options, solver=solver))

    def job_of_values(values):
        return request.job(plan, values, known, ts, start, values_are_legal, is_differentiated=True)

    job, assembly = with_slopes(job_of_values, values, directions)
    slack = min(1.0, slack_of(solver, plan.structure))
    kind = JobKind(plan.structure, plan.scalar, request.rest, True, slack=slack, control=request.control, by_steps=True)
    problem = kind.problem(ts, request.of_all)._replace(in_machine_code=False, program=None)
    job = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], job)
    made = run_in_lanes(problem, job.numbers, job.y0, ts, job.may_run, job.status, Block())
    made = jax.tree.map(lambda leaf: leaf[0], made._replace(n_lane_steps=made.n_lane_steps[None]))
    slopes = jnp.moveaxis(made.ys[:, 1:], 1, 0)
    made = made._replace(ys=made.ys[:, 0], y_reached=made.y_reached[0])
    first = jax.tree.map(lambda leaf: leaf[0], job)
    return JobWithSlopes(_outcome(request, first, made), slopes, assembly)


@cached_jit(what="a run and its derivatives", many="runs and their derivatives in lanes", options=options_for)
def _with_slopes(
    plan: Plan, request: RunRequest, values, directions, known, ts, start, values_are_legal, by_start: bool
):
    n = values.shape[0]

    def job_of_values(values):
        times = ts.at[0].set(values[n]) if by_start else ts
        return request.job(plan, values[:n], known, times, start, values_are_legal)

    def first_rate(job: Job):
        rate = program_for(state_rate, plan.structure, plan.scalar)
        return rate(job.numbers.theta, ts[0], job.y0)

    numbers = jnp.append(values, ts[0]) if by_start else values
    job, assembly = with_slopes(job_of_values, numbers, directions, first_rate if by_start else None)
    job = job._replace(numbers=job.numbers._replace(slack=request.slack))
    made = request.made(plan, job, ts, True)
    slopes = jnp.moveaxis(made.ys[:, 1:], 1, 0)
    made = made._replace(ys=made.ys[:, 0], y_reached=made.y_reached[0])
    return JobWithSlopes(_outcome(request, job, made), slopes, assembly)


def _outcome(request: RunRequest, job: Job, made: LaneOutcome) -> Outcome:
    stats = statistics(made, stages_of(request.rest))
    return Outcome(made.ys, made.t_reached, made.y_reached, made.status, stats, job.assembly)

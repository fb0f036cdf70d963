"""Runs of `simulate`: each is a lane of its own, and `jax.vmap` of it a queue of runs.

A run of numbers is a program that makes a window of samples, the first with the start, which serves any number of
samples. A run within `jax.jit`, and one with its derivatives, is a program for its samples.
"""

import time
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete, is_tracing
from spherejax.model.system import Structure, example_of
from spherejax.motion.equations.contacts import crossings
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import Program, program_for
from spherejax.motion.equations.sampling import initial_force_memory
from spherejax.motion.integration.compiling import (
    arrays_in_machine_code,
    for_one_run,
    in_machine_code,
    in_one_call,
    native_run,
    options_for,
)
from spherejax.motion.integration.implicit_rows import usual_tangent_factor
from spherejax.motion.integration.jobs import Job, JobKind, job_of, statistics, with_slopes
from spherejax.motion.integration.lanes import Block, LaneOutcome, run_in_lanes, windows
from spherejax.motion.integration.lanes.operation import runs
from spherejax.motion.integration.lanes.windows import (
    RunCheckpoint,
    RunUnderWay,
    WindowPace,
    WindowProgress,
    begun,
    run_loop,
    window_at,
)
from spherejax.motion.integration.problem import Outcome, Plan, RunInputs, RunMethod, stages_of
from spherejax.motion.integration.row_blocks import as_numbers, placed_rows
from spherejax.motion.integration.widths import block_for
from spherejax.motion.solvers.joint_rates import fastest_in_clearance
from spherejax.motion.solvers.rosenbrock import Ros34PW2
from spherejax.motion.solvers.traits import is_explicit
from spherejax.motion.start.assembly import Assembly
from spherejax.physics.state import Layout
from spherejax.program_cache import cached_jit
from spherejax.program_cache.disk_cache import is_debugging
from spherejax.program_cache.keys import ArrayKind, LruCache, lru_get
from spherejax.program_cache.user_code import user_code_fingerprint


def run_of(plan: Plan, method: RunMethod, inputs: RunInputs) -> Outcome:
    """A run in a lane; arguments as of `integrated`. `jax.vmap` of a lane is a queue of runs."""
    return bound_run(plan, method, inputs)()


def bound_run(plan: Plan, method: RunMethod, inputs: RunInputs) -> Callable[[], Outcome]:
    """`run_of` these arguments, to be called again and again."""
    if method.stiff_rest is None:
        plan = for_one_run(plan, method.rest)
    if inputs.ts.shape[0] > 2 and _are_known(method, inputs):
        return _in_windows(plan, method, inputs)
    return integrated.bound(plan, method, inputs)


def _are_known(method: RunMethod, inputs: RunInputs) -> bool:
    """Whether a run is made now, from numbers, by a method that is known.

    Not where JAX looks for NaN and infinity in whatever a program returns: windows that are not full have both.
    """
    is_known = all(map(is_concrete, jax.tree.leaves((method, inputs)))) and not is_tracing()
    return is_known and method.stiff_rest is None and not is_debugging()


def _in_windows(plan: Plan, method: RunMethod, inputs: RunInputs) -> Callable[[], Outcome]:
    """A run of numbers, by a program that is the same for any number of samples."""
    times = np.asarray(inputs.ts)
    ends = times[[0, -1]]
    pace = _pace(plan.structure, method.rest)
    theta = np.array(inputs.known)
    theta[list(plan.unknown)] = inputs.values[: len(plan.unknown)]
    described = None if inputs.start is None else inputs.start.y
    start = _as_flying(plan, theta, float(times[0]), inputs.start)
    advance, of_run, nothing = _window_program(plan, method, inputs._replace(ts=ends, start=start))

    def run() -> Outcome:
        outcome: Outcome | None = None

        def samples() -> Iterator[tuple[int, int, Array]]:
            nonlocal outcome
            vectors, first, n_turns_before = nothing, 0, 0
            while True:
                began = time.perf_counter()
                window, n_turns = window_at(times, first), np.array([outcome is None, pace.n_turns])
                outcome, vectors, numbers = advance([*of_run, *jax.tree.leaves(vectors), window, n_turns])
                assert outcome is not None
                progress = WindowProgress.of(numbers)  # waits for the program
                pace.note(progress.n_turns - n_turns_before, time.perf_counter() - began)
                n_turns_before = progress.n_turns
                yield first, progress.n_written, outcome.ys
                first += progress.n_written - 1
                is_full = progress.n_written == windows.WINDOW and first + 1 < len(times)
                if not (progress.is_busy or is_full):
                    return

        try:
            ys = placed_rows(samples(), len(times))
        except KeyboardInterrupt as interrupt:
            if outcome is not None:
                interrupt.add_note(_where_it_stopped(times, outcome))
            raise
        assert outcome is not None
        assembly = outcome.assembly if described is None else outcome.assembly._replace(y=described)
        return outcome._replace(ys=ys, assembly=assembly)

    return run


def _window_program(plan: Plan, method: RunMethod, inputs: RunInputs) -> tuple[Callable[[list], Any], list, dict]:
    """`advance_window` as a function of its arrays, those of the method and the inputs, and the vectors that its first
    window is given. To find a program by its arguments takes 0.1 ms: it is looked up by the forms of the arrays."""
    leaves, tree = jax.tree.flatten((method, inputs))
    key = None
    if all(isinstance(leaf, np.ndarray | np.generic | jax.Array) for leaf in leaves):
        key = plan, tree, user_code_fingerprint(tree), (*map(ArrayKind.of, leaves), windows.WINDOW)

    def made() -> tuple[Callable[[list], Any], dict]:
        with as_numbers():  # a run that is known is remembered, and may be asked for within a trace
            vectors, forms = before_first_window(plan, method, inputs)
        window, n_turns = np.zeros(windows.WINDOW), np.zeros(2, np.int64)
        return advance_window.bound_form(plan, method, inputs, forms, vectors, window, n_turns), vectors

    advance, nothing = lru_get(_programs, key, made)
    return advance, leaves, nothing


_programs = LruCache(64)


@lru_cache(maxsize=64)
def _pace(structure: Structure, rest: Any) -> WindowPace:
    """Of runs of one program; the arguments are what its turns depend on."""
    del structure, rest
    return WindowPace()


def _where_it_stopped(times: Float[np.ndarray, " n"], outcome: Outcome) -> str:
    return (
        f"simulate: stopped at t = {float(outcome.t_reached):.6g} s of {times[-1]:.6g} s, after "
        f"{int(outcome.stats.n_steps):,} steps; with a ts that ends there the run succeeds"
    )


def _as_flying(plan: Plan, theta: Float[np.ndarray, " p"], t: float, start: Assembly | None) -> Assembly | None:
    """A start whose state has the memory of balls that fly, where all do: its program then need not find it.

    With what leads a ball to a place beyond its socket's surface the program has twice as many operations.
    """
    n_contacts, layout, _ = _flight_of(plan.structure)
    if start is None or not n_contacts or len(start.y) == layout.size:
        return start
    programs = _flight_programs(plan.structure, plan.scalar)
    if programs is None:
        return start
    numbers = tuple(theta[program.numbers_read].tobytes() for program in programs)
    y = _flying(plan.structure, plan.scalar, numbers, start.y.tobytes(), t)
    return start if y is None else start._replace(y=y)


@lru_cache(maxsize=64)
def _flight_programs(structure: Structure, scalar: bool | None) -> tuple[Program, ...] | None:
    """What says whether balls fly, which the run needs as well, and the memory of force elements, where they have one;
    None where one of these is array code."""
    *_, first_of_forces = _flight_of(structure)
    functions = (crossings,) if first_of_forces is None else (crossings, initial_force_memory)
    programs = tuple(program_for(function, structure, scalar, is_quiet=True) for function in functions)
    return None if any(program.scalar is None for program in programs) else programs


@lru_cache(maxsize=256)
def _flying(
    structure: Structure, scalar: bool | None, numbers: tuple[bytes, ...], start: bytes, t: float
) -> Float[np.ndarray, " size"] | None:
    """The whole state of a start whose balls fly, by the numbers that these programs read; None where one touches."""
    n_contacts, layout, first_of_forces = _flight_of(structure)
    programs = _flight_programs(structure, scalar)
    assert programs is not None
    y = np.zeros(layout.size)
    y[: len(start) // y.itemsize] = np.frombuffer(start)

    def evaluated(i: int) -> Any:
        theta = np.zeros(structure.starts[-1])
        theta[programs[i].numbers_read] = np.frombuffer(numbers[i])
        return programs[i].compute(theta, t, y)

    if first_of_forces is not None:
        y[layout.memory_start + first_of_forces : layout.work_start] = np.asarray(evaluated(1))
    return y if np.all(evaluated(0).value[:n_contacts] <= 0) else None


@lru_cache(maxsize=64)
def _flight_of(structure: Structure) -> tuple[int, Layout, int | None]:
    """The number of contacts whose balls may fly, the layout of the state, and where entries of force elements begin in
    the memory; no contacts where force elements remember more than turns."""
    system = example_of(structure)
    n_contacts = 0 if system.force_states else len(system.contact_joints)
    return n_contacts, system.layout, system.force_slots[0].start if system.force_slots else None


class RunAndSlopes(NamedTuple):
    """A run and its derivatives along directions in the traced numbers.

    Attributes:
        outcome: of the run.
        slopes: derivatives of its samples; NaN at those that they did not reach.
        assembly_slopes: of its assembled start, with a leading axis of directions.
    """

    outcome: Outcome
    slopes: Float[Array, "k n size"]
    assembly_slopes: Assembly


def run_and_slopes(
    plan: Plan, method: RunMethod, inputs: RunInputs, directions, by_start: bool = False
) -> RunAndSlopes:
    """A run and its derivatives along directions in the traced numbers, shape (k, p), in a lane.

    Directions are of length |p| or so, for all sensitivities to be in the units of the state. With `by_start` they have
    the first sample time as their last entry. The errors of the sensitivities are controlled as the state's.
    """
    method = method.decided
    plan = for_one_run(plan, method.rest, directions.shape[0])
    return _with_slopes(plan, method, inputs, directions, by_start)


def lane_job(plan: Plan, method: RunMethod, inputs: RunInputs, is_differentiated: bool = False) -> Job:
    """The run as a job, from the traced numbers; in array code where it is differentiated itself."""
    theta, start = plan.theta_of(inputs), plan.start_of(inputs)
    becomes_machine_code = in_machine_code(plan) or arrays_in_machine_code(plan, method.rest)
    limits, is_native = method.limits(plan, theta), not is_differentiated and becomes_machine_code
    own = method.own_tolerances
    return job_of(plan, theta, inputs.ts, start, inputs.values_are_legal, limits, own, is_native)


def _made(plan: Plan, method: RunMethod, job: Job, ts, with_rows: bool) -> LaneOutcome:
    """What comes of the job."""
    kind = JobKind.of(plan, method, with_rows=with_rows, moving=plan.unknown if with_rows else None)
    job = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], job)
    found = runs(kind, job.numbers, job.y0, ts, job.may_run, job.status, method.shared, block_for())
    return jax.tree.map(lambda leaf: leaf[0], found._replace(n_lane_steps=found.n_lane_steps[None]))


@cached_jit(what="a run", many="runs in lanes", options=options_for)
def integrated(plan: Plan, method: RunMethod, inputs: RunInputs) -> Outcome:
    """A run in a lane: its start is assembled if need be, and its outcome gathered.

    Where the method is chosen by numbers that are seen only now, both are compiled, and the run is made by one: a lane
    that may not run makes no step. So it is with many lanes, where `jax.lax.cond` would make each run twice.
    """
    job, ts = lane_job(plan, method, inputs), inputs.ts
    if method.stiff_rest is None:
        return _outcome(method, job, _made(plan, method, job, ts, False))
    is_stiff = fastest_in_clearance(plan.structure, plan.scalar, job.numbers.theta) > method.limit
    outcomes = []
    for each, is_taken in ((method.decided, ~is_stiff), (method.of_stiff, is_stiff)):
        numbers = job.numbers._replace(limits=each.limits(plan, job.numbers.theta))
        taken = job._replace(numbers=numbers, may_run=job.may_run & is_taken)
        outcomes.append(_outcome(each, taken, _made(plan, each, taken, ts, False)))
    return jax.tree.map(lambda usual, stiff: jnp.where(is_stiff, stiff, usual), *outcomes)


def made_alone(plan: Plan, method: RunMethod, job: Job, ts) -> Outcome:
    """What comes of a job by a loop of its own; under `jax.vmap` it is not for lanes, as `integrated` is."""
    problem = JobKind.of(plan, method).problem(ts, method.shared)
    lane = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], job)
    made = run_in_lanes(problem, lane.numbers, lane.y0, ts, lane.may_run, lane.status, Block())
    return _outcome(
        method, job, jax.tree.map(lambda leaf: leaf[0], made._replace(n_lane_steps=made.n_lane_steps[None]))
    )


class _UnderWay(NamedTuple):
    """A run between two windows, and how its start was assembled."""

    run: RunUnderWay
    assembly: Assembly


def _started(plan: Plan, method: RunMethod, inputs: RunInputs) -> _UnderWay:
    """A run before its first window of samples; its times are those of its ends."""
    job, ends = lane_job(plan, method, inputs), inputs.ts
    problem = JobKind.of(plan, method).problem(ends, method.shared)
    return _UnderWay(begun(problem, job.numbers, job.y0, ends, job.may_run, job.status), job.assembly)


@cached_jit(what="the start of a run")
def before_first_window(plan: Plan, method: RunMethod, inputs: RunInputs) -> RunCheckpoint:
    """What stands in place of the run under way where a run begins: zeros, and their forms."""
    nothing = jax.tree.map(jnp.zeros_like, jax.eval_shape(lambda: _started(plan, method, inputs)))
    return RunCheckpoint.of(nothing)


@cached_jit(what="a run", options=options_for)
def advance_window(plan: Plan, method: RunMethod, inputs: RunInputs, forms: Any, vectors, window, n_turns) -> tuple:
    """The outcome at the end of the next window, with its samples, the run's vectors, and the numbers of a
    `WindowProgress`.

    Args:
        plan, method: what is run.
        inputs: its numbers; the times are those of its ends.
        forms, vectors: of the run that is under way; before the first window of `before_first_window`.
        window: sample times [s].
        n_turns: whether the run begins, and after how many turns of the loop the window ends, whatever is written of
            it.
    """
    problem = JobKind.of(plan, method).problem(inputs.ts, method.shared)

    def begin() -> _UnderWay:
        started = _started(plan, method, inputs)
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.result_type(leaf)), started)

    def window_made() -> tuple:
        run, assembly = jax.lax.cond(n_turns[0] != 0, begin, RunCheckpoint(vectors, forms).whole)
        made, run, progress = run_loop(problem, run, inputs.ts, window, n_turns[1])
        return made, RunCheckpoint.of(_UnderWay(run, assembly)).vectors, progress, assembly

    # Loops around array code are long. To find that out of what is around them as well takes a second.
    native = in_one_call if in_machine_code(plan) else native_run
    made, vectors, progress, assembly = native(window_made, problem.in_machine_code)
    ys, t_reached, y_reached, status = (each[0] for each in (made.ys, made.t_reached, made.y_reached, made.status))
    of_it = jax.tree.map(lambda leaf: leaf[0], made._replace(n_lane_steps=made.n_lane_steps[None]))
    stats = statistics(of_it, stages_of(method.rest))
    return Outcome(ys, t_reached, y_reached, status, stats, assembly), vectors, progress


def differentiable_slopes(plan: Plan, method: RunMethod, inputs: RunInputs, directions) -> RunAndSlopes:
    """As `run_and_slopes`, to be differentiated in forward mode: the loop over the run's steps, no operation of JAX.

    Of methods that are not explicit, by Ros34PW2.
    """
    solver = method.solver if is_explicit(method.rest) else Ros34PW2()
    method = method.with_solver(solver)

    def job_of_values(values):
        return lane_job(plan, method, inputs._replace(values=values), is_differentiated=True)

    job, assembly = with_slopes(job_of_values, inputs.values, directions)
    factor = min(1.0, usual_tangent_factor(solver, plan.structure))
    kind = JobKind.of(plan, method, with_rows=True, tangent_tolerance_factor=factor, by_steps=True)
    problem = kind.problem(inputs.ts, method.shared)._replace(in_machine_code=False, program=None)
    job = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], job)
    made = run_in_lanes(problem, job.numbers, job.y0, inputs.ts, job.may_run, job.status, Block())
    made = jax.tree.map(lambda leaf: leaf[0], made._replace(n_lane_steps=made.n_lane_steps[None]))
    return _split(method, jax.tree.map(lambda leaf: leaf[0], job), made, assembly)


@cached_jit(what="a run and its derivatives", many="runs and their derivatives in lanes", options=options_for)
def _with_slopes(plan: Plan, method: RunMethod, inputs: RunInputs, directions, by_start: bool) -> RunAndSlopes:
    values, ts = inputs.values, inputs.ts
    n = values.shape[0]

    def job_of_values(values):
        times = ts.at[0].set(values[n]) if by_start else ts
        return lane_job(plan, method, inputs._replace(values=values[:n], ts=times))

    def first_rate(job: Job):
        rate = program_for(state_rate, plan.structure, plan.scalar)
        return rate(job.numbers.theta, ts[0], job.y0)

    numbers = jnp.append(values, ts[0]) if by_start else values
    job, assembly = with_slopes(job_of_values, numbers, directions, first_rate if by_start else None)
    factor = jnp.asarray(method.factor(plan.structure))
    job = job._replace(numbers=job.numbers._replace(tangent_tolerance_factor=factor))
    return _split(method, job, _made(plan, method, job, ts, True), assembly)


def _split(method: RunMethod, job: Job, made: LaneOutcome, assembly: Assembly) -> RunAndSlopes:
    """A run and its derivatives, from the rows of its lane."""
    slopes = jnp.moveaxis(made.ys[:, 1:], 1, 0)
    return RunAndSlopes(outcome_of_first_row(method, job, made), slopes, assembly)


def outcome_of_first_row(method: RunMethod, job: Job, made: LaneOutcome) -> Outcome:
    """The outcome of the state, from a lane with rows below it."""
    return _outcome(method, job, made._replace(ys=made.ys[:, 0], y_reached=made.y_reached[0]))


def _outcome(method: RunMethod, job: Job, made: LaneOutcome) -> Outcome:
    stats = statistics(made, stages_of(method.rest))
    return Outcome(made.ys, made.t_reached, made.y_reached, made.status, stats, job.assembly)

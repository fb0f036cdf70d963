"""A prepared run as a job for the lanes: what its lane is given, what is integrated, and what comes of it.

With sensitivities as rows below the state, or without; see `sensitivity_rows` for their equations.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.kept.bounded_jit import bounded_jit
from spherejax.foundations.machine import code as machine_code
from spherejax.foundations.types import Flag
from spherejax.model.system import Structure, System, example_of
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.equations.quantities import magnitudes
from spherejax.motion.integration.audit import Limits, limits_of
from spherejax.motion.integration.compiling import in_machine_code, options_for
from spherejax.motion.integration.implicit_rows import slack_of, solver_of_rows
from spherejax.motion.integration.integrate import (
    Options,
    Outcome,
    Parameters,
    Plan,
    audit_of,
    beginning,
    contacts_of,
    correction_for,
    integrate,
    room_of,
    stages_of,
)
from spherejax.motion.integration.lanes import LaneOutcome, LaneProblem
from spherejax.motion.integration.lanes.operation import runs
from spherejax.motion.integration.longest_step import longest_step
from spherejax.motion.integration.sampling import samples_of
from spherejax.motion.integration.sensitivity_rows import (
    correcting_rows,
    judging_rows,
    linearized,
    of_first_row,
    rows_rate,
    with_rows,
)
from spherejax.motion.integration.statistics import Statistics
from spherejax.motion.integration.status import Status
from spherejax.motion.integration.widths import block_for
from spherejax.motion.solvers.implicit import with_structure
from spherejax.motion.solvers.joint_rates import fastest_in_clearance
from spherejax.motion.solvers.traits import can_step_in_lanes
from spherejax.motion.start.assembly import CLOSING_TOLERANCE, Assembly
from spherejax.motion.start.tolerances import controller_for


class RunNumbers(NamedTuple):
    """What the right-hand side of one run is given.

    Attributes:
        value: numbers of the system, and what follows from them alone.
        slopes: their scaled derivatives by the numbers asked for; None without.
        tolerances: relative and absolute, where they depend on the run; None where all share them.
        limits: of the audit.
        slack: how much larger the errors of sensitivities may be than the state's; None for what the method has.
    """

    value: Parameters
    slopes: Any
    tolerances: Any
    limits: Any
    slack: Any = None

    @property
    def theta(self) -> Float[Array, " p"]:
        """All numbers of the system."""
        return self.value.theta

    @property
    def ahead(self) -> Any:
        """What follows from them alone."""
        return self.value.ahead


class Job(NamedTuple):
    """A run, ready to go.

    Attributes:
        numbers: what the right-hand side is given.
        y0: flat state, with its sensitivities as rows below it where they are asked for.
        may_run: whether it can be run.
        status: what is reported otherwise.
        assembly: how the start was made consistent.
    """

    numbers: RunNumbers
    y0: Float[Array, " ..."]
    may_run: Flag
    status: Int[Array, ""]
    assembly: Assembly


@dataclass(frozen=True)
class JobKind:
    """What the lanes integrate (static).

    Attributes:
        structure: of the system.
        scalar: whether on scalar programs.
        solver: a diffrax solver, without its arrays.
        with_rows: whether sensitivities are integrated beside the state.
        watch: names of quantities whose largest magnitudes are kept.
        slack: how much larger the errors of sensitivities may be than the state's, where a run does not say; None for
            what the method has.
    """

    structure: Structure
    scalar: bool | None
    solver: diffrax.AbstractSolver
    with_rows: bool = False
    watch: tuple[str, ...] = ()
    slack: float | None = None

    @property
    def n_contacts(self) -> int:
        """Contacts whose onsets are counted."""
        return len(example_of(self.structure).contact_joints)

    def problem(self, ts: Float[Array, " n"], shared: Any) -> LaneProblem:
        """What every lane integrates.

        Args:
            ts: sample times [s].
            shared: arrays of the solver, the tolerances where all runs share them, and the largest number of steps.
        """
        arrays, tolerances, budget = shared
        plan = Plan(self.structure, (), self.scalar)
        rate = program_for(state_rate, self.structure, self.scalar)

        def controller_of(numbers: RunNumbers):
            return controller_for(self.structure, *(tolerances if numbers.tolerances is None else numbers.tolerances))

        solver = eqx.combine(arrays, self.solver)
        problem = LaneProblem(
            with_structure(solver, self.structure),
            controller_of,
            lambda t, y, numbers: rate.inside(numbers.theta, numbers.ahead, t, y),
            correction_for(plan),
            contacts_of(self.structure, self.scalar),
            budget,
            watching(self.structure, self.watch),
            longest_step(self.structure, ts, scalar=self.scalar),
            audit_of(plan),
            room_of(plan),
            example_of(self.structure).layout.work_start,
            samples_of(self.structure, self.scalar),
            in_machine_code=in_machine_code(plan, self.solver),
            program=rate.scalar,
        )
        return self._of_rows(problem, solver, rate) if self.with_rows else problem

    def _of_rows(self, problem: LaneProblem, solver: Any, rate) -> LaneProblem:
        """The same for the state and its sensitivities."""
        watch, usual = problem.watch, slack_of(self.solver) if self.slack is None else self.slack

        def slack(numbers):
            return usual if numbers.slack is None else numbers.slack

        return problem._replace(
            solver=solver_of_rows(solver, self.structure, rate),
            controller_of=lambda numbers: judging_rows(problem.controller_of(numbers), slack(numbers)),
            slack_of=slack,
            rate=lambda t, rows, numbers: rows_rate(rate, numbers, t, rows),
            correct=correcting_rows(problem.correct),
            contacts=None if problem.contacts is None else with_rows(problem.contacts, rate),
            watch=None if watch is None else lambda t, rows, numbers: watch(t, rows[0], numbers),
            audit=None if problem.audit is None else problem.audit.of_rows(),
            room=of_first_row(problem.room),
            samples=None if problem.samples is None else problem.samples.of_rows(),
        )


def watching(structure: Structure, names: tuple[str, ...]) -> Callable | None:
    """The magnitudes of quantities as a function (t, y, numbers) of one lane; None without names."""
    if not names:
        return None
    program = program_for(_magnitudes_of(names), structure)
    return lambda t, y, numbers: program(numbers.theta, t, y)


@lru_cache(maxsize=64)
def _magnitudes_of(names: tuple[str, ...]):
    """One function for the same names: programs are kept by function."""

    def watched(system, t, y):
        return magnitudes(system, t, y, names)

    return watched


def job_of(
    plan: Plan, solver: Any, theta: Float[Array, " p"], ts: Float[Array, " n"], start: Assembly | None,
    values_are_legal: Flag, limits: Any, tolerances: Any,
) -> Job:  # fmt: skip
    """A run without rows as a job.

    Args:
        plan: what it is compiled for.
        solver: that integrates it.
        theta: all numbers of the system.
        ts: sample times [s].
        start: the consistent start; None to assemble it.
        values_are_legal: whether the scene's conditions hold.
        limits: of the audit.
        tolerances: relative and absolute, where they depend on the run.
    """
    assembly, y0 = beginning(plan, theta, ts[0], start)
    is_closed = assembly.residual_after < CLOSING_TOLERANCE
    may_run, status = _permitted(values_are_legal, is_closed, y0)
    rate = program_for(state_rate, plan.structure, plan.scalar)
    with machine_code.wanted(in_machine_code(plan, solver)):  # in vectors, if it is read by machine code
        ahead = rate.ahead(theta)
    numbers = RunNumbers(Parameters(theta, ahead), None, tolerances, limits)
    return Job(numbers, y0, may_run, status, assembly)


def audit_limits(system: System, rtol, solver: Any) -> Limits:
    """From where on a run is wrong; constant where it is differentiated."""
    return jax.lax.stop_gradient(jax.tree.map(jnp.asarray, limits_of(system, rtol, solver)))


def _permitted(values_are_legal, is_closed, y0) -> tuple[Flag, Int[Array, ""]]:
    status = jnp.where(
        values_are_legal, jnp.where(is_closed, Status.SUCCEEDED, Status.START_NOT_CLOSED), Status.BAD_VALUE
    )
    return values_are_legal & is_closed & jnp.all(jnp.isfinite(y0)), jnp.asarray(status, jnp.int64)


def with_slopes(
    job_of_values: Callable, values: Float[Array, " p"], directions: Float[Array, "k p"]
) -> tuple[Job, Assembly]:
    """The job with rows of sensitivities below its state, and the derivatives of its assembly.

    Args:
        job_of_values: the job without rows, from the numbers.
        values: the numbers.
        directions: of the sensitivities, in the numbers.
    """
    job, slopes = linearized(job_of_values, values, directions)
    numbers = job.numbers._replace(slopes=slopes.numbers.value)
    return job._replace(numbers=numbers, y0=jnp.concatenate([job.y0[None], slopes.y0])), slopes.assembly


# Runs of `simulate` ---------------------------------------------------------------------------------------------------


def can_be_a_job(structure: Structure, options: Options) -> bool:
    """Whether the lanes can make a run: with the step-size control that they have themselves."""
    solver: Any = options.solver
    return can_step_in_lanes(solver) and _rest(options.controller) == _own_rest(structure)


@lru_cache(maxsize=64)
def _own_rest(structure: Structure) -> Any:
    return _rest(controller_for(structure, 1.0, 1.0))


def _rest(controller) -> Any:
    """What there is to a controller besides tolerances."""
    if type(controller) is not diffrax.PIDController:
        return controller
    return tuple(value for name, value in vars(controller).items() if name not in ("rtol", "atol"))


def run_of(plan: Plan, options: Options, values, known, ts, start, values_are_legal) -> Outcome:
    """As `integrate`: in a lane where it can be, else by diffrax. `jax.vmap` of a lane is a queue of runs."""
    return bound_run(plan, options, values, known, ts, start, values_are_legal)()


def bound_run(plan: Plan, options: Options, values, known, ts, start, values_are_legal) -> Callable[[], Outcome]:
    """`run_of` these arguments, to be called again and again."""
    if can_be_a_job(plan.structure, options):
        return integrated.bound(plan, _Request.of(options), values, known, ts, start, values_are_legal)
    return integrate.bound(plan, options, values, known, ts, start, values_are_legal)


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
    plan: Plan, options: Options, values, directions, known, ts, start, values_are_legal
) -> JobWithSlopes:
    """A run and its derivatives in a lane; arguments as for `sensitivities.integrate_along`."""
    return _with_slopes(plan, _Request.of(options), values, directions, known, ts, start, values_are_legal)


class _Request(eqx.Module):
    """How to integrate in a lane.

    Attributes:
        solver: its arrays.
        shared: tolerances that are known, which all runs of a queue share, or None.
        own: tolerances of a run, or None.
        budget: largest number of steps.
        rest: the solver without its arrays (static).
        slack: how much larger the errors of sensitivities may be than the state's.
        stiff: arrays of the solver of a run whose joints act faster than the limit when it starts.
        stiff_rest: that solver without its arrays (static); None where there is no choice left.
        limit: a rate [1/s] (static).
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

    @classmethod
    def of(cls, options: Options) -> "_Request":
        """From the options of a run that can be a job."""
        solver, rest = eqx.partition(options.solver, eqx.is_array)
        controller: Any = options.controller
        tolerances = controller.rtol, controller.atol
        budget = np.asarray(options.max_steps, np.int64) if options.budget is None else options.budget
        alike = all(is_concrete(each) for each in tolerances)
        shared, own = (tolerances, None) if alike else (None, tolerances)
        slack = np.asarray(slack_of(options.solver)) if options.slack is None else options.slack
        given = solver, shared, own, budget, rest, slack
        if options.at_start is None:
            return cls(*given)
        return cls(*given, *eqx.partition(options.at_start.solver, eqx.is_array), options.at_start.limit)

    @property
    def of_stiff(self) -> "_Request":
        """The same with the other solver."""
        return _Request(self.stiff, self.shared, self.own, self.budget, self.stiff_rest, self.slack)

    def job(self, plan: Plan, values, known, ts, start, values_are_legal) -> Job:
        """The run as a job, from the traced numbers."""
        theta = plan.theta(values, known)
        return job_of(plan, self.rest, theta, ts, start, values_are_legal, self.limits(plan, theta), self.own)

    def limits(self, plan: Plan, theta) -> Limits:
        """Of the audit."""
        rtol, _ = self.own if self.shared is None else self.shared
        return audit_limits(plan.structure.system(theta), rtol, self.rest)

    def made(self, plan: Plan, job: Job, ts, with_rows: bool) -> LaneOutcome:
        """What comes of the job."""
        kind = JobKind(plan.structure, plan.scalar, self.rest, with_rows)
        job = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], job)
        shared = self.solver, self.shared, self.budget
        found = runs(kind, job.numbers, job.y0, ts, job.may_run, job.status, shared, block_for())
        return jax.tree.map(lambda leaf: leaf[0], found._replace(n_lane_steps=found.n_lane_steps[None]))


@bounded_jit(what="a run", options=options_for)
def integrated(plan: Plan, request: _Request, values, known, ts, start, values_are_legal) -> Outcome:
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


@bounded_jit(what="a run and its derivatives", options=options_for)
def _with_slopes(plan: Plan, request: _Request, values, directions, known, ts, start, values_are_legal):
    def job_of_values(values):
        return request.job(plan, values, known, ts, start, values_are_legal)

    job, assembly = with_slopes(job_of_values, values, directions)
    job = job._replace(numbers=job.numbers._replace(slack=request.slack))
    made = request.made(plan, job, ts, True)
    slopes = jnp.moveaxis(made.ys[:, 1:], 1, 0)
    made = made._replace(ys=made.ys[:, 0], y_reached=made.y_reached[0])
    return JobWithSlopes(_outcome(request, job, made), slopes, assembly)


def _outcome(request: _Request, job: Job, made: LaneOutcome) -> Outcome:
    stats = statistics(made, stages_of(request.rest))
    return Outcome(made.ys, made.t_reached, made.y_reached, made.status, stats, job.assembly)


def statistics(made: LaneOutcome, n_stages: int, explanation: str = "") -> Statistics:
    """What a run cost."""
    n_steps = made.n_accepted + made.n_rejected
    return Statistics(
        n_steps, made.n_accepted, made.n_rejected, n_steps * n_stages, made.n_onsets, made.audit, explanation
    )

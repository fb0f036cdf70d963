"""A prepared run as a job for the lanes: what its lane is given, what is integrated, and what comes of it.

With sensitivities as rows below the state, or without; see `sensitivity_rows` for their equations.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from spherejax.foundations.types import Flag
from spherejax.model.system import Structure, example_of
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import Program, program_for
from spherejax.motion.equations.quantities import magnitudes
from spherejax.motion.integration.compiling import arrays_in_machine_code, in_machine_code
from spherejax.motion.integration.implicit_rows import rows_with_fixed_matrix, solver_of_rows, usual_tangent_factor
from spherejax.motion.integration.lanes import LaneOutcome, LaneProblem
from spherejax.motion.integration.longest_step import longest_step
from spherejax.motion.integration.problem import (
    Parameters,
    Plan,
    RunMethod,
    audit_of,
    beginning,
    contacts_of,
    correction_for,
    room_of,
)
from spherejax.motion.integration.sampling import samples_of
from spherejax.motion.integration.sensitivity_rows import (
    correcting_rows,
    judging_rows,
    linearized,
    of_first_row,
    rows_rate,
    unseen_of_first_row,
    with_rows,
)
from spherejax.motion.integration.statistics import Statistics
from spherejax.motion.integration.status import Status, start_status
from spherejax.motion.integration.unseen import unseen_of
from spherejax.motion.solvers.diagonally_implicit import with_structured_stages
from spherejax.motion.solvers.implicit import with_structure
from spherejax.motion.solvers.kinks import OverKinks
from spherejax.motion.solvers.landing import ContactFunctions
from spherejax.motion.solvers.traits import is_explicit
from spherejax.motion.start.assembly import Assembly
from spherejax.motion.start.tolerances import controller_for


class RunNumbers(NamedTuple):
    """What the right-hand side of one run is given.

    Attributes:
        value: numbers of the system, and what follows from them alone.
        slopes: their scaled derivatives by the numbers asked for; None without.
        tolerances: relative and absolute, where they depend on the run; None where all share them.
        limits: of the audit.
        tangent_tolerance_factor: how much larger the errors of sensitivities may be than the state's; None for what the
            method has.
    """

    value: Parameters
    slopes: Any
    tolerances: Any
    limits: Any
    tangent_tolerance_factor: Any = None

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
        tangent_tolerance_factor: how much larger the errors of sensitivities may be than the state's, where a run does
            not say; None for what the method has.
        moving: numbers of the system that the sensitivities are by; None for all.
        control: a step-size controller of a user's, without its arrays, which then stand for the tolerances; None for
            that of this package.
        by_steps: whether the steps that are made are differentiated once more: explicit ones are made in straight time
            then, and those of Rosenbrock methods with the state's matrix for all rows.
        is_mixture: whether one row stands for the sensitivities by all numbers: then it is judged by its own size,
            with explicit methods. Those of Rosenbrock methods have error estimates far above their errors.
        is_alone: as of a `Plan`.
    """

    structure: Structure
    scalar: bool | None
    solver: diffrax.AbstractSolver
    with_rows: bool = False
    watch: tuple[str, ...] = ()
    tangent_tolerance_factor: float | None = None
    moving: tuple[int, ...] | None = None
    control: Any = None
    by_steps: bool = False
    is_mixture: bool = False
    is_alone: bool = False

    @classmethod
    def of(cls, plan: Plan, method: RunMethod, **others: Any) -> "JobKind":
        """That of a plan and a method; `others` as the attributes."""
        return cls(plan.structure, plan.scalar, method.rest, control=method.control, is_alone=plan.is_alone, **others)

    def of_many(self, numbers: RunNumbers) -> tuple["JobKind", RunNumbers]:
        """The kind of many runs at once and their numbers, from those of a single one with a leading axis of runs."""
        if not self.is_alone:
            return self, numbers
        kind = replace(self, scalar=None, is_alone=False)
        rate = program_for(state_rate, kind.structure, kind.scalar)

        def parameters(theta):
            return Parameters(theta, rate.ahead(theta))

        def of_one(own: RunNumbers) -> RunNumbers:
            if own.slopes is None:
                return own._replace(value=parameters(own.theta))
            value, slopes = linearized(parameters, own.theta, own.slopes.theta)
            return own._replace(value=value, slopes=slopes)

        with rate.native_code():
            return kind, jax.vmap(of_one)(numbers)

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
            given = tolerances if numbers.tolerances is None else numbers.tolerances
            return controller_for(self.structure, *given) if self.control is None else eqx.combine(given, self.control)

        def tolerances_of(numbers: RunNumbers):
            controller = controller_of(numbers)
            relative, absolute = (getattr(controller, name, None) for name in ("rtol", "atol"))
            return None if relative is None or absolute is None else (relative, absolute)

        solver = with_structured_stages(eqx.combine(arrays, self.solver), self.structure, rate, tolerances_of)
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
            in_machine_code=in_machine_code(plan) or arrays_in_machine_code(plan, self.solver),
            program=rate.scalar,
            unseen=unseen_of(self.structure, self.scalar, self.solver),
            lands_inside=self._lands_inside,
        )
        return self._of_rows(problem, solver, rate) if self.with_rows else problem

    def _of_rows(self, problem: LaneProblem, solver: Any, rate) -> LaneProblem:
        """The same for the state and its sensitivities."""
        watch, usual = problem.watch, self.tangent_tolerance_factor
        if usual is None:
            usual = usual_tangent_factor(self.solver, self.structure)

        def factor(numbers):
            return usual if numbers.tangent_tolerance_factor is None else numbers.tangent_tolerance_factor

        contacts = None if problem.contacts is None else with_rows(problem.contacts, rate)
        by_own_size = self.is_mixture and is_explicit(self.solver)
        return problem._replace(
            solver=self._over_kinks(self._solver_of_rows(solver, rate), contacts),
            controller_of=lambda numbers: judging_rows(problem.controller_of(numbers), factor(numbers), by_own_size),
            judges_by_own_size=by_own_size,
            tangent_tolerance_factor=factor,
            rate=lambda t, rows, numbers: rows_rate(rate, numbers, t, rows),
            correct=correcting_rows(problem.correct),
            contacts=contacts,
            watch=None if watch is None else lambda t, rows, numbers: watch(t, rows[0], numbers),
            audit=None if problem.audit is None else problem.audit.of_rows(),
            room=of_first_row(problem.room),
            unseen=unseen_of_first_row(problem.unseen),
            samples=None if problem.samples is None else problem.samples.of_rows(),
            moving=self.moving,
        )

    @property
    def _lands_inside(self) -> bool:
        return self.control is None and not self.by_steps

    def _solver_of_rows(self, solver: Any, rate: Program) -> Any:
        if self.by_steps:
            return rows_with_fixed_matrix(solver, self.structure, rate)
        return solver_of_rows(solver, self.structure, rate, self.moving)

    def _over_kinks(self, solver: Any, contacts: ContactFunctions | None) -> Any:
        """The solver, going over kinks; an explicit one whose steps land inside leaves that to `lanes.landing`."""
        if contacts is None or not contacts.has_rates_that_jump:
            return solver
        if is_explicit(solver) and self._lands_inside:
            return solver
        made: Any = OverKinks  # pyright takes its fields for those of diffrax's base class
        return made(solver, contacts)


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
    plan: Plan, theta: Float[Array, " p"], ts: Float[Array, " n"], start: Assembly | None, values_are_legal: Flag,
    limits: Any, tolerances: Any, is_native: bool,
) -> Job:  # fmt: skip
    """A run without rows as a job.

    Args:
        plan: what it is compiled for.
        theta: all numbers of the system.
        ts: sample times [s].
        start: the consistent start; None to assemble it.
        values_are_legal: whether the scene's conditions hold.
        limits: of the audit.
        tolerances: relative and absolute, where they depend on the run.
        is_native: whether its programs become machine code of their own.
    """
    rate = program_for(state_rate, plan.structure, plan.scalar)
    # The start is assembled by programs as large as the rate, which XLA would compile for longer than the run. What the
    # rate has ahead is read by machine code as vectors.
    with rate.native_code(is_native):
        assembly, y0 = beginning(plan, theta, ts[0], start)
        ahead = rate.ahead(theta)
    status = start_status(values_are_legal, assembly.residual_after, y0)
    numbers = RunNumbers(Parameters(theta, ahead), None, tolerances, limits)
    return Job(numbers, y0, status == Status.SUCCEEDED, status, assembly)


def with_slopes(
    job_of_values: Callable,
    values: Float[Array, " p"],
    directions: Float[Array, "k p"],
    first_rate: Callable | None = None,
) -> tuple[Job, Assembly]:
    """The job with rows of sensitivities below its state, and the derivatives of its assembly.

    Args:
        job_of_values: the job without rows, from the numbers.
        values: the numbers.
        directions: of the sensitivities, in the numbers.
        first_rate: the rate of the state at the start, a function of the job, where the last number is the time at
            which it starts; None where that is known.
    """
    job, slopes = linearized(job_of_values, values, directions)
    rows = slopes.y0
    if first_rate is not None:
        rows = rows - directions[:, -1, None] * first_rate(job)
    numbers = job.numbers._replace(slopes=slopes.numbers.value)
    return job._replace(numbers=numbers, y0=jnp.concatenate([job.y0[None], rows])), slopes.assembly


def statistics(made: LaneOutcome, n_stages: int, explanation: str = "") -> Statistics:
    """What a run cost."""
    n_steps = made.n_accepted + made.n_rejected
    return Statistics(
        n_steps, made.n_accepted, made.n_rejected, n_steps * n_stages, made.n_onsets, made.audit, explanation
    )

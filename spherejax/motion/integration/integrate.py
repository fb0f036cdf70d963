"""Integrate a compiled system: assemble the start, run diffrax, gather the outcome."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from spherejax.foundations.lanes import in_lanes
from spherejax.foundations.types import Flag, Number, Scalar
from spherejax.model.system import Structure, System, example_of, flatten_system
from spherejax.motion.equations.contacts import crossings, initial_memory, kinks_of, memory_after_step, onset_slopes
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import Program, program_for
from spherejax.motion.equations.projection import correction_of
from spherejax.motion.equations.sampling import initial_force_memory
from spherejax.motion.integration.audit import Audit, Limits, limits_of, look_of
from spherejax.motion.integration.auditing import AuditingSolver, of_audited, watch_of
from spherejax.motion.integration.compiling import in_machine_code, native_run, options_for_stiff
from spherejax.motion.integration.diffrax_integration import diffeqsolve
from spherejax.motion.integration.longest_step import longest_step, room_for
from spherejax.motion.integration.sampling import SampledElements, SamplingSolver, samples_of
from spherejax.motion.integration.sensitivity_rows import scales_of
from spherejax.motion.integration.statistics import Statistics
from spherejax.motion.integration.status import Status, end_status, start_status, status_of
from spherejax.motion.integration.unseen import Unseen, unseen_of
from spherejax.motion.solvers.automatic import AtStart
from spherejax.motion.solvers.correcting import CorrectingSolver
from spherejax.motion.solvers.implicit import with_structure
from spherejax.motion.solvers.kinks import OverKinks
from spherejax.motion.solvers.landing import (
    ContactFunctions,
    LandingController,
    MemorySolver,
    count_of,
    without_memory,
)
from spherejax.motion.solvers.traits import is_explicit, is_linearly_implicit, n_stages_of_end
from spherejax.motion.solvers.wrapping import StepBudget
from spherejax.motion.start.assembly import Assembly, as_ideal, assemble
from spherejax.program_cache import cached_jit


@dataclass(frozen=True)
class Plan:
    """What a run is compiled for (static).

    Attributes:
        structure: structure of the system.
        unknown: indices in theta of the numbers that are traced by the caller.
        scalar: whether to run on scalar programs; None: on those that are not too large.
        from_state: whether the run starts from a flat state that the caller traces: it stands behind the traced
            numbers, so that derivatives by it are found like those by numbers.
    """

    structure: Structure
    unknown: tuple[int, ...]
    scalar: bool | None
    from_state: bool = False

    def theta(self, values: Float[Array, " n_unknown"], known: Float[Array, " p"]) -> Float[Array, " p"]:
        """All numbers of the system, from those that are traced and those that are known."""
        # Picked, not scattered: XLA:CPU (jax 0.10) aborts when it compiles the derivative of a scatter that it fuses.
        source = np.arange(known.shape[0])
        source[list(self.unknown)] = known.shape[0] + np.arange(len(self.unknown))
        return jnp.concatenate([known, values])[source]

    def start(self, values: Float[Array, " n_values"], start: Assembly | None) -> Assembly | None:
        """The start of the run, from what is traced: of one that starts from a traced state, with that state."""
        if not self.from_state:
            return start
        assert start is not None
        return start._replace(y=values[len(self.unknown) :])

    def scales(self, values: Any) -> Any:
        """What derivatives by the traced numbers are multiplied by while they are integrated, shape (n_values,).

        Entries of a state that are nothing but for rounding must not be judged by their size: each has at least 1.
        """
        n = len(self.unknown)
        if not self.from_state:
            return scales_of(values)
        return jnp.concatenate([jnp.asarray(scales_of(values[:n])), jnp.maximum(jnp.abs(values[n:]), 1.0)])


class Options(eqx.Module):
    """How to integrate.

    Attributes:
        solver: diffrax solver.
        controller: diffrax step-size controller.
        adjoint: diffrax adjoint.
        max_steps: largest number of steps.
        budget: the same as a number that may be traced, so that one program serves all, or None.
        at_start: another solver, for a run whose numbers call for it when it starts, or None.
        slack: how much larger the errors of sensitivities may be than the state's; None for what the method has.
    """

    solver: diffrax.AbstractSolver
    controller: diffrax.AbstractAdaptiveStepSizeController
    adjoint: diffrax.AbstractAdjoint
    max_steps: int = eqx.field(static=True)
    budget: Int[Array, ""] | None = None
    at_start: AtStart | None = None
    slack: Float[Array, ""] | None = None

    @property
    def decided(self) -> "Options":
        """The same with the solver alone."""
        return replace(self, at_start=None)


class Parameters(NamedTuple):
    """What the right-hand side is given besides time and state (diffrax's `args`).

    Attributes:
        theta: all numbers of the system.
        ahead: what follows from them alone, evaluated once before the integration.
        limits: of the audit; None where nothing is audited with them.
    """

    theta: Float[Array, " p"]
    ahead: Any
    limits: Any = None


def parameters_from(plan: Plan, rate: Program, known, values) -> Parameters:
    """What the right-hand side is given, from the traced numbers and the known ones."""
    theta = plan.theta(values, known)
    return Parameters(theta, rate.ahead(theta))


class Outcome(eqx.Module):
    """What an integration returns.

    Attributes:
        ys: flat states at the sample times.
        t_reached: time reached [s].
        y_reached: flat state there.
        status: integer of `Status`.
        stats: counts.
        assembly: how the start was made consistent.
    """

    ys: Float[Array, "n size"]
    t_reached: Float[Array, ""]
    y_reached: Float[Array, " size"]
    status: Array
    stats: Statistics
    assembly: Assembly


@cached_jit(what="a run", options=options_for_stiff)
def integrate(
    plan: Plan,
    options: Options,
    values: Float[Array, " n_unknown"],
    known: Float[Array, " p"],
    ts: Float[Array, " n"],
    start: Assembly | None,
    values_are_legal: Flag,
) -> Outcome:
    """Assemble the start if need be, integrate with diffrax, and gather the outcome."""
    # A derivative is taken beside the run, except with an adjoint of the caller's, which goes through it.
    alone = is_linearly_implicit(options.solver) and isinstance(options.adjoint, diffrax.ForwardMode)
    is_native = alone and in_machine_code(plan, options.solver)
    return native_run(lambda: _integrated(plan, options, values, known, ts, start, values_are_legal), is_native)


def _integrated(plan, options, values, known, ts, start, values_are_legal) -> Outcome:
    theta = plan.theta(values, known)
    assembly, y0 = beginning(plan, theta, ts[0], plan.start(values, start))
    began = start_status(values_are_legal, assembly.residual_after, y0)
    may_run = began == Status.SUCCEEDED
    # A lane that cannot run must not hold up the others: it gets an interval of length zero.
    t1 = jnp.where(may_run, ts[-1], ts[0])
    rate = program_for(state_rate, plan.structure, plan.scalar)
    contacts = contacts_of(plan.structure, plan.scalar)
    correct = correction_for(plan)
    taken = samples_of(plan.structure, plan.scalar)
    solver = with_structure(options.solver, plan.structure) if plan.scalar is not False else options.solver
    solver = with_loop_of(options.adjoint, solver)
    solution = diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: rate.inside(args.theta, args.ahead, t, y)),
        wrapped(solver, correct, contacts, taken, audit_of(plan)),
        t0=ts[0],
        t1=t1,
        dt0=None,
        y0=y0,
        args=Parameters(theta, rate.ahead(theta), audit_limits(plan, options, theta)),
        saveat=diffrax.SaveAt(
            subs=[samples(jnp.minimum(ts, t1), correct, taken), diffrax.SubSaveAt(t1=True)], solver_state=True
        ),
        stepsize_controller=landing_controller(
            options, solver, contacts, taken, plan, ts, room_of(plan), unseen_of(plan.structure, plan.scalar, solver)
        ),
        adjoint=options.adjoint,
        max_steps=options.max_steps,
        throw=False,
    )
    sampled: Any = solution.ys
    times: Any = solution.ts
    reached = times[1][0]
    ys = samples_reached(sampled[0], (ts <= reached) & may_run)
    y_reached = jax.lax.stop_gradient(sampled[1][0])
    status = status_at_end(began, solution.result, reached, ts[-1], ys, y_reached)
    return Outcome(ys, reached, y_reached, status, _statistics(solution, options.solver, contacts), assembly)


def samples_reached(ys: Float[Array, "n ..."], is_reached: Bool[Array, " n"]) -> Float[Array, "n ..."]:
    """Samples of diffrax, NaN where a run did not come: what diffrax did not write is infinite."""
    is_reached = is_reached.reshape(-1, *(1 for _ in ys.shape[1:])) & jnp.isfinite(jax.lax.stop_gradient(ys))
    return jnp.where(is_reached, ys, jnp.nan)


def status_at_end(began, result: diffrax.RESULTS, t_reached, t_end, *states) -> Int[Array, ""]:
    """The status of a run by diffrax, from that at its start, and what came of it; see `end_status`."""
    are_finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(jax.lax.stop_gradient(each))) for each in states]))
    status = jnp.where(began == Status.SUCCEEDED, status_of(result), began)
    return end_status(status, t_reached, t_end, are_finite)


def with_loop_of(adjoint: diffrax.AbstractAdjoint, solver: Any) -> Any:
    """A Runge-Kutta method with the loop over its stages that an adjoint can differentiate.

    diffrax does so itself, to solvers that are not wrapped: without, there is no forward mode.
    """
    kinds = {diffrax.ForwardMode: "lax", diffrax.DirectAdjoint: "bounded"}
    kind = next((kind for each, kind in kinds.items() if isinstance(adjoint, each)), None)
    if kind is None or not isinstance(solver, diffrax.AbstractRungeKutta) or solver.scan_kind is not None:
        return solver
    return eqx.tree_at(lambda s: s.scan_kind, solver, kind, is_leaf=lambda x: x is None)


def landing_controller(
    options: Options,
    solver: diffrax.AbstractSolver,
    contacts: ContactFunctions | None,
    taken: SampledElements | None,
    plan: Plan,
    ts: Float[Array, " n"],
    room: Callable | None,
    unseen: Unseen | None,
) -> LandingController:
    """The controller that judges errors, with what else ends a step: contacts, and the longest step of a road."""
    longest = longest_step(plan.structure, ts, scalar=plan.scalar)
    interpolation: Any = solver.interpolation_cls
    controller: Any = options.controller
    if options.budget is not None:
        controller = StepBudget(controller, options.budget)  # pyright: ignore[reportCallIssue]
    were_taken = None if taken is None else taken.were_taken
    made: Any = LandingController  # pyright takes its fields for those of diffrax's base class
    return made(controller, contacts, interpolation, longest, room, were_taken, unseen)


def room_of(plan: Plan) -> Callable | None:
    """How soon something comes that a step must not pass over, a function of (parameters, t, y)."""
    program = room_for(plan.structure, plan.scalar)
    return None if program is None else lambda parameters, t, y: program(parameters.theta, t, y)


def audit_of(plan: Plan) -> Audit:
    """What is looked at, at the end of each step."""
    look = look_of(plan.structure, plan.scalar)
    return Audit(lambda parameters, t, y: look(parameters.theta, t, y), lambda parameters: parameters.limits)


def audit_limits(plan: Plan, options: Options, theta: Float[Array, " p"]) -> Limits:
    """From where on a run is wrong."""
    limits = limits_of(plan.structure.system(theta), getattr(options.controller, "rtol", None), options.solver)
    return jax.lax.stop_gradient(jax.tree.map(jnp.asarray, limits))


def correction_for(plan: Plan) -> Callable | None:
    """The drift control's correction of a state, a function of (parameters, t, y); None where it corrects nothing."""
    n_corrections = example_of(plan.structure).drift.n_corrections
    return correction_of(plan.structure, plan.scalar, n_corrections) if n_corrections else None


def wrapped(
    solver: diffrax.AbstractSolver,
    correct: Callable | None,
    contacts: ContactFunctions | None,
    taken: SampledElements | None,
    audit: Audit,
) -> AuditingSolver:
    """The solver with what happens at the end of each step: correction of drift, contact events, samples, the audit."""
    solver = solver if correct is None else CorrectingSolver(solver, correct)
    solver = solver if contacts is None or not contacts.has_rates_that_jump else OverKinks(solver, contacts)
    solver = solver if contacts is None else MemorySolver(solver, contacts)
    solver = solver if taken is None else SamplingSolver(solver, taken)
    return AuditingSolver(solver, audit)


def samples(ts: Float[Array, " n"], correct: Callable | None, taken: SampledElements | None) -> diffrax.SubSaveAt:
    """The states at the sample times; they lie within steps, and are corrected, and sampled, like their ends."""
    if correct is None and taken is None:
        return diffrax.SubSaveAt(ts=ts)

    def at_end(t, y, args):
        y = y if correct is None else correct(args, t, y)
        return y if taken is None else taken.update(args, t, y)

    return diffrax.SubSaveAt(ts=ts, fn=at_end)


def beginning(
    plan: Plan, theta: Float[Array, " p"], t: Scalar, start: Assembly | None
) -> tuple[Assembly, Float[Array, " size"]]:
    """The consistent start at time t [s], assembled unless it is given, and the flat state there."""
    system = plan.structure.system(theta)
    assembly = assemble(*flatten_system(as_ideal(system)), t) if start is None else start
    return assembly, initial_state(system, assembly, t)


@lru_cache(maxsize=64)
def contacts_of(structure: Structure, scalar: bool | None) -> ContactFunctions | None:
    """The contacts and touches of a system as programs, for the integrator; None for a system without."""
    example = example_of(structure)
    if not example.contact_joints and not example.touching_forces:
        return None
    crossing = program_for(crossings, structure, scalar, is_quiet=True)

    def crossing_at(args, t, y):
        return crossing(args.theta, t, y)

    if not example.contact_joints:
        return without_memory(crossing_at, kinks_of(structure))
    layout, n_contacts = example.layout, len(example.contact_joints)
    update = program_for(memory_after_step, structure, scalar, (layout.size, layout.size, n_contacts))

    @jax.custom_jvp
    def memory(theta, t, y_start, y_end):
        return update(theta, t, (y_start, y_end, jnp.zeros(n_contacts)))

    @memory.defjvp
    def memory_jvp(primals, tangents):
        slopes = program_for(onset_slopes, structure, scalar)  # here, for most runs have no use for it
        slope = jax.lax.stop_gradient(slopes(primals[0], primals[1], primals[3]))

        def with_slope(theta, t, y_start, y_end):
            return update(theta, t, (y_start, y_end, slope))

        return memory(*primals), jax.jvp(with_slope, primals, tangents)[1]

    def updated(args, t, y_start, y_end):
        now = memory(args.theta, jnp.asarray(t, jnp.float64), y_start, y_end)
        return jnp.concatenate([y_end[: layout.memory_start], now, y_end[layout.work_start :]])

    def updated_lanes(args, t, y_start, y_end):
        now = in_lanes(memory)(args.theta, t, y_start, y_end)
        return jnp.concatenate([y_end[: layout.memory_start], now, y_end[layout.work_start :]])

    slots = {slot.joint: slot for slot in example.memory_slots}
    entries = tuple(layout.memory_start + slots[name].start for name in example.contact_joints)
    return ContactFunctions(crossing_at, updated, updated_lanes, entries, kinks=kinks_of(structure))


def initial_state(system: System, assembly: Assembly, t: Number = 0.0) -> Float[Array, " size"]:
    """The flat state at the start: the assembled motion, the memory of contacts and forces at t [s], and no work.

    A motion that goes on, whose state has memory and work already, begins with these.
    """
    layout = system.layout
    if assembly.y.shape[0] == layout.size:
        return jnp.asarray(assembly.y)
    without_memory = jnp.concatenate([assembly.y, jnp.zeros(layout.n_memory + layout.n_work)])
    memory = initial_memory(system, without_memory)
    if system.force_slots:
        memory = jnp.concatenate([memory, initial_force_memory(system, jnp.asarray(t), without_memory)])
    return jnp.concatenate([assembly.y, memory, jnp.zeros(layout.n_work)])


def _statistics(solution: diffrax.Solution, solver, contacts: ContactFunctions | None) -> Statistics:
    n_steps = solution.stats["num_steps"]
    inner: Any = of_audited(solution.solver_state)
    n_onsets = jnp.zeros(0, jnp.int64) if contacts is None else count_of(inner)
    return Statistics(
        n_steps,
        solution.stats["num_accepted_steps"],
        solution.stats["num_rejected_steps"],
        n_steps * stages_of(solver),
        n_onsets,
        watch_of(solution.solver_state).worst,
    )


def stages_of(solver: diffrax.AbstractSolver) -> int:
    """Evaluations of the right-hand side in a step; of an explicit one without those for states inside it."""
    tableau: Any = getattr(solver, "tableau", None)
    if is_explicit(solver):
        return n_stages_of_end(tableau)
    n_stages = getattr(tableau, "num_stages", None) or getattr(tableau, "n_stages", 1)
    return n_stages - 1 if getattr(tableau, "fsal", False) else n_stages

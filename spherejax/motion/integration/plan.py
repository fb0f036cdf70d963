"""What a run is compiled for, its numbers, and what a program of it needs of the system."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.lanes import in_lanes
from spherejax.foundations.types import Number, Scalar
from spherejax.model.system import Structure, System, example_of, flatten_system
from spherejax.motion.equations.contacts import crossings, initial_memory, kinks_of, memory_after_step, onset_slopes
from spherejax.motion.equations.programs import Program, program_for
from spherejax.motion.equations.projection import correction_of
from spherejax.motion.equations.sampling import initial_force_memory
from spherejax.motion.integration.audit import Audit, look_of
from spherejax.motion.integration.longest_step import room_for
from spherejax.motion.integration.sensitivity_rows import scales_of
from spherejax.motion.integration.statistics import Statistics
from spherejax.motion.solvers.landing import ContactFunctions, without_memory
from spherejax.motion.solvers.traits import is_explicit, n_stages_of_end
from spherejax.motion.start.assembly import Assembly, as_ideal, assemble


class RunInputs(NamedTuple):
    """The numbers of a run.

    Attributes:
        values: those that the caller traces; of a run that starts from a traced state with that state behind them.
        known: the others, with zeros for these.
        ts: sample times [s].
        start: the consistent start, where it is known; None to assemble it.
        values_are_legal: whether the scene's conditions hold.
    """

    values: Any
    known: Any
    ts: Any
    start: Assembly | None
    values_are_legal: Any


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

    def start_of(self, inputs: RunInputs) -> Assembly | None:
        """The start of the run: of one that starts from a traced state, with that state."""
        if not self.from_state:
            return inputs.start
        assert inputs.start is not None
        return inputs.start._replace(y=inputs.values[len(self.unknown) :])

    def theta_of(self, inputs: RunInputs) -> Float[Array, " p"]:
        """All numbers of the system."""
        return self.theta(inputs.values, inputs.known)

    def scales(self, values: Any) -> Any:
        """What derivatives by the traced numbers are multiplied by while they are integrated, shape (n_values,).

        Entries of a state that are nothing but for rounding must not be judged by their size: each has at least 1.
        """
        n = len(self.unknown)
        if not self.from_state:
            return scales_of(values)
        return jnp.concatenate([jnp.asarray(scales_of(values[:n])), jnp.maximum(jnp.abs(values[n:]), 1.0)])


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


def room_of(plan: Plan) -> Callable | None:
    """How soon something comes that a step must not pass over, a function of (parameters, t, y)."""
    program = room_for(plan.structure, plan.scalar)
    return None if program is None else lambda parameters, t, y: program(parameters.theta, t, y)


def audit_of(plan: Plan) -> Audit:
    """What is looked at, at the end of each step."""
    look = look_of(plan.structure, plan.scalar)
    return Audit(lambda parameters, t, y: look(parameters.theta, t, y), lambda parameters: parameters.limits)


def correction_for(plan: Plan) -> Callable | None:
    """The drift control's correction of a state, a function of (parameters, t, y); None where it corrects nothing."""
    n_corrections = example_of(plan.structure).drift.n_corrections
    return correction_of(plan.structure, plan.scalar, n_corrections) if n_corrections else None


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


def stages_of(solver: diffrax.AbstractSolver) -> int:
    """Evaluations of the right-hand side in a step; of an explicit one without those for states inside it."""
    tableau: Any = getattr(solver, "tableau", None)
    if is_explicit(solver):
        return n_stages_of_end(tableau)
    n_stages = getattr(tableau, "num_stages", None) or getattr(tableau, "n_stages", 1)
    return n_stages - 1 if getattr(tableau, "fsal", False) else n_stages

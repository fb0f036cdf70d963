"""What a run is compiled for, how it is integrated, and its numbers: all that follows is given these three.

`Plan` is static: another one is another program. `RunMethod` is a decided method, solver and step-size control and how
many steps at most. `RunInputs` are numbers. Below them is what a program of the run needs of its system.
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
from spherejax.foundations.lanes import in_lanes
from spherejax.foundations.remembering.same import Same
from spherejax.foundations.types import Number, Scalar
from spherejax.model.numbers import Number as SceneNumber
from spherejax.model.numbers import numbers_of
from spherejax.model.system import Structure, System, example_of
from spherejax.motion.equations.contacts import crossings, initial_memory, kinks_of, memory_after_step, onset_slopes
from spherejax.motion.equations.programs import Program, program_for
from spherejax.motion.equations.projection import correction_of
from spherejax.motion.equations.sampling import initial_force_memory
from spherejax.motion.integration.audit import Audit, Limits, limits_of, look_of
from spherejax.motion.integration.implicit_rows import usual_tangent_factor
from spherejax.motion.integration.longest_step import room_for
from spherejax.motion.integration.sensitivity_rows import scales_of
from spherejax.motion.integration.statistics import Statistics
from spherejax.motion.settings import RunSettings
from spherejax.motion.solvers.automatic import AtStart
from spherejax.motion.solvers.landing import ContactFunctions, without_memory
from spherejax.motion.solvers.root_finder import with_converging_root_finder
from spherejax.motion.solvers.traits import is_explicit, n_stages_of_end
from spherejax.motion.start.assembly import Assembly, assemble, ideal_numbers
from spherejax.motion.start.tolerances import Tolerances, controller_for, length_and_energy, tolerances_of


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
        is_alone: whether it is on array code because the run is a single one; many are on scalar programs.
    """

    structure: Structure
    unknown: tuple[int, ...]
    scalar: bool | None
    from_state: bool = False
    is_alone: bool = False

    @property
    def traced(self) -> tuple[SceneNumber, ...]:
        """What the traced numbers are, in the order of `unknown`."""
        numbers = numbers_of(self.structure)
        return tuple(numbers[i] for i in self.unknown)

    def theta(self, values: Float[Array, " n_unknown"], known: Float[Array, " p"]) -> Float[Array, " p"]:
        """All numbers of the system, from those that are traced and those that are known."""
        if not self.unknown:
            return jnp.asarray(known)
        runs = _runs_of(self.unknown)
        if len(runs) <= FEW_RUNS:
            # Piece by piece, as the weights of a network: to pick 4,417 one by one took a seventh of their gradient.
            # Split, not sliced: the derivative of a slice is a vector of its own, nearly all of it zeros.
            sizes = [n for _, n in runs]
            pieces = jax.lax.split(values, [*sizes, values.shape[0] - sum(sizes)])
            parts, end = [], 0
            for (first, n), piece in zip(runs, pieces, strict=False):  # behind them is the rest of the values
                parts += [known[end:first], piece]
                end = first + n
            return jnp.concatenate([part for part in (*parts, known[end:]) if part.shape[0]])
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
            return scales_of(values, self._arrays)
        return jnp.concatenate(
            [jnp.asarray(scales_of(values[:n], self._arrays)), jnp.maximum(jnp.abs(values[n:]), 1.0)]
        )

    @property
    def _arrays(self) -> Int[np.ndarray, " n_unknown"]:
        """Indices of the arrays that the traced numbers belong to, ascending from 0."""
        return _arrays_of(self.structure, self.unknown)


FEW_RUNS = 16
"""Runs of numbers that are traced, up to which these are put between the known ones piece by piece."""


@lru_cache(maxsize=64)
def _runs_of(unknown: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """Where numbers stand side by side: the first of each run, and how many."""
    at = np.asarray(unknown)
    begins = np.flatnonzero(np.diff(at, prepend=at[0] - 2) != 1)
    return tuple(zip(at[begins].tolist(), np.diff(begins, append=at.size).tolist(), strict=True))


@lru_cache(maxsize=64)
def _arrays_of(structure: Structure, unknown: tuple[int, ...]) -> Int[np.ndarray, " n_unknown"]:
    leaves = np.searchsorted(structure.starts, unknown, side="right")
    return np.unique(leaves, return_inverse=True)[1]


class RunMethod(eqx.Module):
    """How a run is integrated. What is static makes another program; arrays and numbers may be traced.

    Attributes:
        arrays: those of the solver.
        rest: the solver without them (static).
        tolerances: relative and absolute; of a step-size controller of the user's all of its arrays.
        control: that controller without them (static); None for that of this package.
        are_shared: whether all runs of a queue have the same tolerances (static).
        max_steps: largest number of steps.
        tangent_tolerance_factor: how much larger the errors of derivatives may be than the state's; None for what the
            method has.
        stiff_arrays: arrays of the solver of a run whose joints act faster than the limit when it starts.
        stiff_rest: that solver without them (static); None where there is no choice left.
        limit: a rate [1/s] (static).
    """

    arrays: Any
    rest: Any = eqx.field(static=True)
    tolerances: Any
    control: Any = eqx.field(static=True)
    are_shared: bool = eqx.field(static=True)
    max_steps: Any
    tangent_tolerance_factor: Any = None
    stiff_arrays: Any = None
    stiff_rest: Any = eqx.field(static=True, default=None)
    limit: float = eqx.field(static=True, default=math.inf)

    @classmethod
    def of(
        cls,
        structure: Structure,
        solver: diffrax.AbstractSolver,
        controller: Any,
        max_steps: Any,
        at_start: AtStart | None = None,
        tangent_tolerance_factor: Any = None,
    ) -> "RunMethod":
        """From diffrax objects: the controller is that of this package, `controller_for`, or one of the user's."""
        arrays, rest = eqx.partition(solver, eqx.is_array)
        controller, control = _numbers_apart(controller), None
        if _rest(controller) == _own_rest(structure):
            tolerances = controller.rtol, controller.atol
        else:
            tolerances, control = eqx.partition(controller, eqx.is_array)
        are_shared = all(is_concrete(each) for each in jax.tree.leaves(tolerances))
        steps = np.asarray(max_steps, np.int64) if is_concrete(max_steps) else max_steps
        method = cls(arrays, rest, tolerances, control, are_shared, steps, tangent_tolerance_factor)
        if at_start is None:
            return method
        stiff_arrays, stiff_rest = eqx.partition(at_start.solver, eqx.is_array)
        return method._replaced(stiff_arrays=stiff_arrays, stiff_rest=stiff_rest, limit=at_start.limit)

    @classmethod
    def of_own_control(
        cls,
        structure: Structure,
        solver: diffrax.AbstractSolver,
        tolerances: Tolerances,
        max_steps: Any,
        at_start: AtStart | None = None,
        tangent_tolerance_factor: Any = None,
    ) -> "RunMethod":
        """`of` with this package's step-size control."""
        numbers = tolerances.rtol, tolerances.atol
        are_arrays = all(type(each) is np.ndarray for each in numbers)
        if not (are_arrays and type(max_steps) is int and at_start is None and tangent_tolerance_factor is None):
            controller = controller_for(structure, *numbers)
            return cls.of(structure, solver, controller, max_steps, at_start, tangent_tolerance_factor)
        return _with_tolerances(structure, Same(solver), Same(tolerances), max_steps)

    @classmethod
    def by_tolerances(
        cls,
        structure: Structure,
        solver: diffrax.AbstractSolver,
        tolerances: Tolerances,
        rtol: Any,
        max_steps: Any,
        at_start: AtStart | None = None,
    ) -> "RunMethod":
        """That of this package's step-size control; `rtol` is what a root finder has to converge below."""
        controller = controller_for(structure, tolerances.rtol, tolerances.atol)
        return cls.of(structure, with_converging_root_finder(solver, rtol), controller, max_steps, at_start)

    @classmethod
    def of_settings(
        cls, system: System, structure: Structure, settings: RunSettings, at_start: AtStart | None = None
    ) -> "RunMethod":
        """That of settings whose solver is decided; `structure` may be that of the system with traced numbers."""
        tolerances = tolerances_of(system, settings.rtol, settings.atol)
        rtol, max_steps = settings.rtol, settings.max_steps
        return cls.by_tolerances(structure, settings.solver, tolerances, rtol, max_steps, at_start)

    def _replaced(self, **fields: Any) -> "RunMethod":
        return RunMethod(**{**vars(self), **fields})

    @property
    def solver(self) -> Any:
        """The solver, whole."""
        return eqx.combine(self.arrays, self.rest)

    def controller(self, structure: Structure) -> Any:
        """The step-size controller, whole."""
        if self.control is None:
            return controller_for(structure, *self.tolerances)
        return eqx.combine(self.tolerances, self.control)

    def with_solver(self, solver: Any) -> "RunMethod":
        """The same with another solver, and no choice left."""
        arrays, rest = eqx.partition(solver, eqx.is_array)
        return self._replaced(arrays=arrays, rest=rest, stiff_arrays=None, stiff_rest=None, limit=math.inf)

    @property
    def decided(self) -> "RunMethod":
        """The same with the usual solver alone."""
        return self if self.stiff_rest is None else self.with_solver(self.solver)

    @property
    def of_stiff(self) -> "RunMethod":
        """The same with the other solver."""
        return self.with_solver(eqx.combine(self.stiff_arrays, self.stiff_rest))

    def factor(self, structure: Structure) -> Any:
        """How much larger the errors of derivatives may be than the state's."""
        if self.tangent_tolerance_factor is None:
            return usual_tangent_factor(self.rest, structure)
        return self.tangent_tolerance_factor

    @property
    def own_tolerances(self) -> Any:
        """Of a run whose tolerances are its own; None where all runs of a queue share them."""
        return None if self.are_shared else self.tolerances

    @property
    def shared(self) -> Any:
        """What all runs of a queue share: arrays of the solver, tolerances, and the largest number of steps."""
        return self.arrays, self.tolerances if self.are_shared else None, self.max_steps

    def limits(self, plan: Plan, theta: Any) -> Limits:
        """Of the audit."""
        if self.control is None:
            rtol, _ = self.tolerances
        else:
            rtol = getattr(eqx.combine(self.tolerances, self.control), "rtol", None)
        return audit_limits(plan.structure, theta, rtol, self.rest)


@lru_cache(maxsize=64)
def _with_tolerances(structure: Structure, solver: Same, tolerances: Same, max_steps: int) -> RunMethod:
    """A method with this package's step-size control."""
    numbers = tolerances.value.rtol, tolerances.value.atol
    # By another scene's tolerances it is the same but for these: to make it takes fourteen times as long.
    leaves, tree, places = _taken_apart(structure, solver, max_steps, *map(np.shape, numbers))
    leaves = list(leaves)
    for place, number in zip(places, numbers, strict=True):
        leaves[place] = number
    return jax.tree.unflatten(tree, leaves)


@lru_cache(maxsize=64)
def _taken_apart(structure: Structure, solver: Same, max_steps: int, *shapes: tuple[int, ...]) -> tuple:
    """A method with this package's step-size control, taken apart, and where tolerances of these shapes are in it."""
    controller = controller_for(structure, *map(np.ones, shapes))
    method = RunMethod.of(structure, solver.value, controller, max_steps)
    leaves, tree = jax.tree.flatten(method)
    return leaves, tree, [next(i for i, leaf in enumerate(leaves) if leaf is each) for each in method.tolerances]


def audit_limits(structure: Structure, theta: Any, rtol, solver: Any) -> Limits:
    """From where on a run is wrong; constant where it is differentiated."""
    theta, rtol = jax.lax.stop_gradient((theta, rtol))
    limits = limits_of(example_of(structure), rtol, solver, length_and_energy(structure, theta))
    return jax.lax.stop_gradient(jax.tree.map(jnp.asarray, limits))


@lru_cache(maxsize=64)
def _own_rest(structure: Structure) -> Any:
    return _rest(controller_for(structure, 1.0, 1.0))


def _rest(controller: Any) -> Any:
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


class Outcome(NamedTuple):
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
    assembly = assemble(*ideal_numbers(plan.structure, theta), t) if start is None else start
    remembers = bool(example_of(plan.structure).all_slots)
    system = plan.structure.system(theta) if remembers else example_of(plan.structure)
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
    memory = initial_memory(system, without_memory) if system.memory_slots else jnp.zeros(0)
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

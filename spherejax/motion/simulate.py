"""Simulate a scene: the adapter between the equations of motion and diffrax."""

import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import SceneError, is_concrete
from spherejax.foundations.types import Flag, Numeric
from spherejax.model.scene import Scene
from spherejax.model.system import Structure, System, compile_scene, flatten_system
from spherejax.motion.assembly import CLOSING_TOLERANCE, Assembly, assemble, assemble_now
from spherejax.motion.contacts import crossings, initial_memory, memory_after_step, onset_slopes
from spherejax.motion.dynamics import state_rate
from spherejax.motion.programs import program_for
from spherejax.motion.solvers.automatic import Choice, choose_solver
from spherejax.motion.solvers.landing import Contacts, LandingController, MemorySolver, count_of
from spherejax.motion.status import SimulationError, SimulationWarning, Status, status_of
from spherejax.motion.trajectory import Statistics, Trajectory
from spherejax.physics.joints import Ideal, PlacedSpherical
from spherejax.runtime import require_float64

SMALLEST_TOLERANCE = 1e-14
"""Relative tolerances below this ask for digits that float64 does not carry (its resolution is 2.2e-16)."""


def simulate(
    scene: Scene,
    ts: Float[Array, " n"],
    *,
    rtol: float = 1e-8,
    atol: float = 1e-10,
    solver: diffrax.AbstractSolver | None = None,
    stepsize_controller: diffrax.AbstractAdaptiveStepSizeController | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    max_steps: int = 20_000_000,
    track_work: bool = False,
    scalar: bool = True,
    throw: bool = False,
) -> Trajectory:
    """Simulate a scene.

    Args:
        scene: the mechanism.
        ts: sample times [s], increasing; the motion starts at the first and ends at the last.

    Other args:
        rtol: relative tolerance of a step.
        atol: absolute tolerance of a step, in the units of the state (m, m/s, rad/s, 1).
        solver: a diffrax solver; chosen by the scene when None (`run.choice` says which and why).
        stepsize_controller: a diffrax controller; `PIDController(rtol, atol)` when None. Contact onsets and releases
            are landed on whichever controller judges the errors.
        adjoint: a diffrax adjoint. With None (or `diffrax.ForwardMode()`) derivatives are forward sensitivities by the
            traced numbers, which serve forward and reverse mode alike and cost about one run for each number. For
            hundreds of numbers `diffrax.RecursiveCheckpointAdjoint()` is cheaper; it serves reverse mode only, and
            takes minutes to compile for a stiff scene.
        max_steps: largest number of steps.
        track_work: integrate the work that each non-ideal joint absorbs.
        scalar: run on the scalar program; False runs on the array code, which is slower.
        throw: raise `SimulationError` when the run fails; otherwise a failed run carries its status, and a
            `SimulationWarning` is given where the outcome is known at once.

    Returns:
        The motion at the sample times.

    Raises:
        SceneError: for a scene or a request that cannot be simulated, before anything is computed.
        SimulationError: with `throw=True`, for a run that did not reach its end.
    """
    require_float64()
    ts = _checked_times(ts)
    _check_tolerances(rtol, atol)
    compiled = compile_scene(scene, track_work=track_work)
    system = compiled.system
    choice = Choice(solver, f"{type(solver).__name__}: as asked for") if solver is not None else choose_solver(system)
    if stepsize_controller is None:
        stepsize_controller = diffrax.PIDController(rtol=jnp.asarray(rtol), atol=jnp.asarray(atol))
    structure, theta = flatten_system(system)
    start = _start_now(system)
    known, unknown = _split(system)
    plan = Plan(structure, unknown, scalar)
    # diffrax differentiates this loop in forward mode only; the sensitivities make reverse mode of it as well.
    by_sensitivities = adjoint is None or isinstance(adjoint, diffrax.ForwardMode)
    adjoint = diffrax.ForwardMode() if adjoint is None else adjoint
    integrate = _integrate_with_sensitivities if by_sensitivities and unknown else _integrate
    options = Options(choice.solver, stepsize_controller, adjoint, max_steps)
    values_are_legal = jnp.all(jnp.stack(compiled.conditions)) if compiled.conditions else jnp.asarray(True)
    values = jnp.asarray(theta)[np.array(unknown, int)] if unknown else jnp.zeros(0)
    try:
        outcome = integrate(plan, options, values, known, ts, start, values_are_legal)
    except TypeError as error:
        if "forward-mode" not in str(error):
            raise
        raise TypeError(
            f"adjoint={type(adjoint).__name__}() serves reverse mode (jax.grad) only; for forward mode (jax.jvp, "
            "jax.jacfwd) leave adjoint= out, or pass adjoint=diffrax.ForwardMode()"
        ) from error
    run = Trajectory(
        ts=ts,
        ys=outcome.ys,
        system=system,
        stats=outcome.stats,
        status=outcome.status,
        t_reached=outcome.t_reached,
        assembly=outcome.assembly if start is None else start,
        choice=choice.reason,
        scalar=scalar,
    )
    return _reported(run, throw)


@dataclass(frozen=True)
class Plan:
    """What a run is compiled for (static).

    Attributes:
        structure: structure of the system.
        unknown: indices in theta of the numbers that are traced by the caller.
        scalar: whether to run on the scalar program.
    """

    structure: Structure
    unknown: tuple[int, ...]
    scalar: bool

    def theta(self, values: Float[Array, " n_unknown"], known: Float[Array, " p"]) -> Float[Array, " p"]:
        """All numbers of the system, from those that are traced and those that are known.

        A gather, not a scatter: XLA (jaxlib 0.10) aborts the process where it fuses a scatter of the values and one of
        their tangents into one loop with two outputs, as it does for `jax.jit(jax.value_and_grad(...))`.
        """
        if not self.unknown:
            return known
        order = np.arange(known.shape[0])
        order[np.array(self.unknown, int)] = known.shape[0] + np.arange(len(self.unknown))
        return jnp.concatenate([known, values])[order]


class Options(eqx.Module):
    """How to integrate.

    Attributes:
        solver: diffrax solver.
        controller: diffrax step-size controller.
        adjoint: diffrax adjoint.
        max_steps: largest number of steps.
    """

    solver: diffrax.AbstractSolver
    controller: diffrax.AbstractAdaptiveStepSizeController
    adjoint: diffrax.AbstractAdjoint
    max_steps: int = eqx.field(static=True)


class Parameters(NamedTuple):
    """What the right-hand side is given besides time and state (diffrax's `args`).

    Attributes:
        theta: all numbers of the system.
        ahead: what follows from them alone, evaluated once before the integration.
    """

    theta: Float[Array, " p"]
    ahead: tuple[Array, ...]


class Outcome(eqx.Module):
    """What an integration returns.

    Attributes:
        ys: flat states at the sample times.
        t_reached: time reached [s].
        status: integer of `Status`.
        stats: counts.
        assembly: how the start was made consistent.
    """

    ys: Float[Array, "n size"]
    t_reached: Float[Array, ""]
    status: Array
    stats: Statistics
    assembly: Assembly


@eqx.filter_jit
def _integrate(
    plan: Plan,
    options: Options,
    values: Float[Array, " n_unknown"],
    known: Float[Array, " p"],
    ts: Float[Array, " n"],
    start: Assembly | None,
    values_are_legal: Flag,
) -> Outcome:
    """Assemble the start if need be, integrate with diffrax, and gather the outcome."""
    theta = plan.theta(values, known)
    system = plan.structure.system(theta)
    assembly = assemble(*flatten_system(as_ideal(system))) if start is None else start
    is_closed = assembly.residual_after < CLOSING_TOLERANCE
    y0 = initial_state(system, assembly)
    may_run = is_closed & values_are_legal & jnp.all(jnp.isfinite(y0))
    # A lane that cannot run must not hold up the others: it gets an interval of length zero.
    t1 = jnp.where(may_run, ts[-1], ts[0])
    rate = program_for(state_rate, plan.structure, plan.scalar)
    contacts = contacts_of(plan.structure, plan.scalar) if system.contact_joints else None
    solver = options.solver if contacts is None else MemorySolver(options.solver, contacts)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: rate.inside(args.theta, args.ahead, t, y)),
        solver,
        t0=ts[0],
        t1=t1,
        dt0=None,
        y0=y0,
        args=Parameters(theta, rate.ahead(theta)),
        saveat=diffrax.SaveAt(
            subs=[diffrax.SubSaveAt(ts=jnp.minimum(ts, t1)), diffrax.SubSaveAt(t1=True)], solver_state=True
        ),
        stepsize_controller=LandingController(options.controller, contacts),  # pyright: ignore[reportCallIssue]
        adjoint=options.adjoint,
        max_steps=options.max_steps,
        throw=False,
    )
    status = status_of(solution.result, values_are_legal, is_closed)
    sampled: Any = solution.ys
    times: Any = solution.ts
    reached = times[1][0]
    is_sampled = (ts <= reached) & ((status == Status.SUCCEEDED) | may_run)
    ys = jnp.where(is_sampled[:, None], sampled[0], jnp.nan)
    return Outcome(ys, reached, status, _statistics(solution, options.solver, contacts), assembly)


def _integrate_with_sensitivities(plan, options, values, known, ts, start, values_are_legal) -> Outcome:
    """As `_integrate`, differentiable in forward and in reverse mode.

    The derivative rule computes all sensitivities by the traced numbers in forward mode and applies them: that is
    linear in the tangent, so it can be transposed. With few parameters it is cheaper than a reverse sweep, in run time
    and far more in compile time.
    """

    @jax.custom_jvp
    def run(values, known, ts, start, values_are_legal):
        return _integrate(plan, options, values, known, ts, start, values_are_legal)

    @run.defjvp
    def run_jvp(primals, tangents):
        values, *rest = primals
        outcome = run(*primals)

        def floats(v):
            result = _integrate(plan, options, v, *rest)
            return result.ys, result.t_reached, result.assembly

        jacobian = jax.jacfwd(floats)(values)
        ys, t_reached, assembly = jax.tree.map(lambda j: j @ tangents[0], jacobian)
        counts = jax.tree.map(lambda x: np.zeros(x.shape, jax.dtypes.float0), (outcome.status, outcome.stats))
        return outcome, Outcome(ys, t_reached, counts[0], counts[1], assembly)

    return run(values, known, jax.lax.stop_gradient(ts), start, values_are_legal)


@lru_cache(maxsize=64)
def contacts_of(structure: Structure, scalar: bool) -> Contacts:
    """The contacts of a system as programs, for the integrator."""
    example = jax.eval_shape(structure.system, jax.ShapeDtypeStruct((_n_numbers(structure),), jnp.float64))
    layout, n_contacts = example.layout, len(example.contact_joints)
    crossing = program_for(crossings, structure, scalar)
    slopes = program_for(onset_slopes, structure, scalar)
    update = program_for(memory_after_step, structure, scalar, 2 * layout.size + n_contacts)

    @jax.custom_jvp
    def memory(theta, t, y_start, y_end):
        return update(theta, t, jnp.concatenate([y_start, y_end, jnp.zeros(n_contacts)]))

    @memory.defjvp
    def memory_jvp(primals, tangents):
        slope = jax.lax.stop_gradient(slopes(primals[0], primals[1], primals[3]))

        def with_slope(theta, t, y_start, y_end):
            return update(theta, t, jnp.concatenate([y_start, y_end, slope]))

        return memory(*primals), jax.jvp(with_slope, primals, tangents)[1]

    def crossing_at(args, t, y):
        return crossing(args.theta, t, y)

    def updated(args, t, y_start, y_end):
        now = memory(args.theta, jnp.asarray(t, jnp.float64), y_start, y_end)
        return jnp.concatenate([y_end[: layout.memory_start], now, y_end[layout.work_start :]])

    slots = {slot.joint: slot for slot in example.memory_slots}
    entries = tuple(layout.memory_start + slots[name].start for name in example.contact_joints)
    return Contacts(crossing_at, updated, entries)


def _n_numbers(structure: Structure) -> int:
    return sum(int(np.prod(shape)) for shape in structure.shapes)


def as_ideal(system: System) -> System:
    """The system for assembly: geometry and inertia without models and forces; one program serves all models."""
    joints = {
        name: eqx.tree_at(lambda j: j.model, joint, Ideal())
        if isinstance(joint, PlacedSpherical) and joint.starts_concentric
        else joint
        for name, joint in system.joints.items()
        if not isinstance(joint, PlacedSpherical) or joint.starts_concentric or joint.model.is_ideal
    }
    return System(system.bodies, joints, {}, system.gravity, system.drift, (), False)


def _start_now(system: System) -> Assembly | None:
    """The consistent start, when the geometry is known now; None when it is traced."""
    structure, theta = flatten_system(as_ideal(system))
    return assemble_now(structure, theta) if is_concrete(theta) else None


def initial_state(system: System, assembly: Assembly) -> Float[Array, " size"]:
    """The flat state at the start: the assembled motion, the contacts' memory, and no work."""
    layout = system.layout
    without_memory = jnp.concatenate([assembly.y, jnp.zeros(layout.n_memory + layout.n_work)])
    memory = initial_memory(system, without_memory)
    return jnp.concatenate([assembly.y, memory, jnp.zeros(layout.n_work)])


def _split(system: System) -> tuple[Numeric, tuple[int, ...]]:
    """The numbers that are known now, with zeros elsewhere, and the indices of the others."""
    known, unknown, start = [], [], 0
    for leaf in jax.tree.leaves(system):
        size = int(np.prod(np.shape(leaf)))
        if is_concrete(leaf):
            known.append(np.asarray(leaf, np.float64).ravel())
        else:
            known.append(np.zeros(size))
            unknown.extend(range(start, start + size))
        start += size
    return np.concatenate(known), tuple(unknown)


def _statistics(solution: diffrax.Solution, solver, contacts: Contacts | None) -> Statistics:
    n_steps = solution.stats["num_steps"]
    n_onsets = jnp.zeros(0, jnp.int64) if contacts is None else count_of(solution.solver_state)
    return Statistics(
        n_steps,
        solution.stats["num_accepted_steps"],
        solution.stats["num_rejected_steps"],
        n_steps * stages_of(solver),
        n_onsets,
    )


def stages_of(solver: diffrax.AbstractSolver) -> int:
    """Evaluations of the right-hand side in a step (an FSAL method counts its shared one once)."""
    tableau = getattr(solver, "tableau", None)
    if tableau is None:
        return 1
    n_stages = getattr(tableau, "num_stages", None) or getattr(tableau, "n_stages", 1)
    return n_stages - 1 if getattr(tableau, "fsal", False) else n_stages


def _checked_times(ts) -> Float[Array, " n"]:
    if is_concrete(ts):
        times = np.asarray(ts, np.float64)
        if times.ndim != 1 or times.size == 0:
            raise SceneError(f"ts must be a list of sample times of shape (n,), n >= 1; it has shape {times.shape}")
        if not np.all(np.isfinite(times)):
            raise SceneError("ts must hold finite times [s]; it has NaN or infinity")
        steps = np.diff(times)
        if np.any(steps <= 0):
            at = int(np.argmax(steps <= 0))
            raise SceneError(
                f"ts must increase; ts[{at + 1}] = {times[at + 1]:.9g} follows ts[{at}] = {times[at]:.9g}. Sort the "
                "times and remove repeated ones"
            )
        return jnp.asarray(times)
    return jnp.asarray(ts, jnp.float64)


def _check_tolerances(rtol, atol) -> None:
    if is_concrete(rtol) and not float(rtol) >= SMALLEST_TOLERANCE:
        raise SceneError(
            f"rtol = {float(rtol):.3g} asks for digits that float64 does not carry; use at least "
            f"{SMALLEST_TOLERANCE:.0e}"
        )
    if is_concrete(atol) and not float(atol) > 0:
        raise SceneError(f"atol = {float(atol):.3g} must be positive; entries of the state pass through zero")


def _reported(run: Trajectory, throw: bool) -> Trajectory:
    if not is_concrete(run.status):
        if throw:
            return eqx.error_if(
                run, run.status != Status.SUCCEEDED, "a simulation did not reach its end; see Trajectory.status"
            )
        return run
    if int(run.status) != Status.SUCCEEDED:
        if throw:
            raise SimulationError(run.diagnosis)
        warnings.warn(run.diagnosis, SimulationWarning, stacklevel=3)
    return run

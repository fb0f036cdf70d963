"""Many runs of one scene builder at once: what `jax.vmap(simulate)` does, in lanes that never idle.

`jax.vmap` of an integration waits for its slowest lane and carries every buffer through every step. Here the runs
queue for a block of lanes inside one compiled loop; see `motion.lanes`.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.checks import SceneError, is_concrete
from spherejax.model.scene import Scene
from spherejax.model.system import Structure, compile_scene, flatten_system
from spherejax.motion.assembly import CLOSING_TOLERANCE, Assembly
from spherejax.motion.callbacks import without_host_checks
from spherejax.motion.dynamics import state_rate
from spherejax.motion.implicit import with_structure
from spherejax.motion.integrate import Plan, beginning, contacts_of, correction_for, stages_of
from spherejax.motion.lanes import Block, LaneOutcome, LaneProblem, run_in_lanes
from spherejax.motion.longest_step import longest_step
from spherejax.motion.many_sensitivities import RunSlopes, problem_of_rows, slopes_of, start_of_rows
from spherejax.motion.paths import path_of
from spherejax.motion.programs import program_for
from spherejax.motion.quantities import magnitudes
from spherejax.motion.sensitivities import has_controlled_sensitivities
from spherejax.motion.simulate import check_tolerances, checked_times, choice_for, split, start_now, tolerances_of
from spherejax.motion.solvers.automatic import Choice
from spherejax.motion.status import Status
from spherejax.motion.trajectory import Statistics, Trajectory
from spherejax.motion.widths import block_for
from spherejax.runtime import require_float64

Build = Callable[..., Scene]
"""Makes a scene from the parameters of one run."""


class Runs(NamedTuple):
    """Many runs.

    Attributes:
        trajectories: a `Trajectory` whose arrays have a leading axis of runs.
        time_in_contact: of each contact joint [s], shape (n_runs, n_contacts).
        peaks: largest magnitudes of the watched quantities at the ends of all steps, shape (n_runs, n_watched).
        n_lane_steps: steps that the lanes made, those of idle ones included.
        slopes: derivatives by the parameters that were asked for; None without.
    """

    trajectories: Trajectory
    time_in_contact: Float[Array, "n_runs n_contacts"]
    peaks: Float[Array, "n_runs n_watched"]
    n_lane_steps: Int[Array, ""]
    slopes: RunSlopes | None = None

    @property
    def lane_efficiency(self) -> Float[Array, ""]:
        """Steps of runs divided by steps of lanes."""
        return jnp.sum(self.trajectories.stats.n_steps) / self.n_lane_steps


class Method(NamedTuple):
    """How to integrate (static).

    Attributes:
        choice: the solver, and why.
        rtol: relative tolerance.
        atol: absolute tolerance, or None for one by kind of component.
        max_steps: largest number of steps of a run.
        track_work: whether the work of each joint is integrated.
        block: how wide the block of lanes is.
        watch: names of quantities whose largest magnitudes are kept.
        by: names of the parameters whose sensitivities are integrated as well.
    """

    choice: Choice
    rtol: float
    atol: float | None
    max_steps: int
    track_work: bool
    block: Block
    watch: tuple[str, ...] = ()
    by: tuple[str, ...] = ()


class Numbers(eqx.Module):
    """What the right-hand side of one run is given.

    Attributes:
        theta: all numbers of the system.
        ahead: what follows from them alone.
        tolerances: relative and absolute, where they depend on the run.
    """

    theta: Float[Array, " p"]
    ahead: Any
    tolerances: Any


def simulate_many(
    build: Build,
    parameters: Any,
    ts: Float[Array, " n"],
    *,
    rtol: float = 1e-8,
    atol: float | None = None,
    solver: diffrax.AbstractSolver | None = None,
    max_steps: int = 20_000_000,
    track_work: bool = False,
    watch: tuple[str, ...] = (),
    by: tuple[str, ...] = (),
    block: Block | None = None,
) -> Runs:
    """Simulate many scenes of one structure.

    Args:
        build: makes a scene from one run's parameters, by keyword when `parameters` is a mapping. It is traced.
        parameters: arrays with a leading axis of runs, in a mapping (or any pytree, given to `build` as it is).
        ts: sample times [s], increasing.

    Other args:
        rtol, atol, solver, max_steps, track_work: as in `simulate`. The solver is chosen by the first, the last and two
            runs in between; the stiffest of them decides.
        watch: names of quantities (e.g. `"acceleration.rocker"`) whose largest magnitudes at the ends of all steps are
            kept: unlike a largest sample they miss no impact.
        by: names of parameters (entries of a mapping, one number for each run) whose sensitivities are integrated
            beside the states, with the errors of both controlled: `runs.slopes`. They need an explicit method, or a
            Rosenbrock one.
        block: how wide the block of lanes is; by default by the kind of device (`motion.widths`).

    Returns:
        The runs; failed ones carry their status.

    Raises:
        SceneError: for a request that cannot be simulated.
    """
    require_float64()
    ts = checked_times(ts)
    check_tolerances(rtol, atol)
    n_runs = count_of_runs(parameters)
    method = method_for(build, parameters, rtol, atol, solver, max_steps, track_work, block or block_for())
    method = with_sensitivities(method._replace(watch=tuple(watch)), tuple(by), parameters)
    return many(build, method, parameters, jnp.asarray(ts), jnp.ones(n_runs, bool))


def count_of_runs(parameters: Any) -> int:
    """Length of the leading axis.

    Raises:
        SceneError: where there is none, or where the lengths differ.
    """
    lengths = {np.shape(leaf)[:1] for leaf in jax.tree.leaves(parameters)}
    if len(lengths) != 1 or lengths == {()}:
        raise SceneError(
            "the parameters of many runs must be arrays with one leading axis of equal length, the runs; they have "
            f"leading axes {sorted(lengths)}"
        )
    return lengths.pop()[0]


def method_for(build, parameters, rtol, atol, solver, max_steps, track_work, block) -> Method:
    """The method for all runs; a stiff one when one of the runs that are looked at asks for it."""
    if solver is not None:
        return Method(choice_for(None, rtol, solver), rtol, atol, max_steps, track_work, block)
    n_runs = count_of_runs(parameters)
    choices, problem = [], None
    for run in sorted({0, n_runs // 3, 2 * n_runs // 3, n_runs - 1}):
        try:
            scene = built(build, jax.tree.map(lambda leaf, run=run: np.asarray(leaf)[run], parameters))
            choices.append(choice_for(compile_scene(scene, track_work=track_work).system, rtol, None))
        except SceneError as error:
            problem = error
    if not choices:
        assert problem is not None
        raise problem
    stiff = [choice for choice in choices if not isinstance(choice.solver, diffrax.AbstractERK)]
    return Method((stiff or choices)[0], rtol, atol, max_steps, track_work, block)


def with_sensitivities(method: Method, by: tuple[str, ...], parameters: Any) -> Method:
    """The method with sensitivities by some of the parameters.

    Raises:
        SceneError: for a name that is no parameter, or a method that cannot integrate them.
    """
    if not by:
        return method
    names = list(parameters) if isinstance(parameters, dict) else []
    for name in by:
        if name not in names:
            known = ", ".join(map(repr, names)) or "none (they must be a mapping)"
            raise SceneError(f"sensitivities by {name!r}: no such parameter; there are {known}")
        if np.ndim(parameters[name]) != 1:
            raise SceneError(f"sensitivities by {name!r}: it must be one number for each run")
    if not has_controlled_sensitivities(method.choice.solver):
        raise SceneError(
            f"sensitivities in lanes need an explicit or a Rosenbrock method, and these runs have another one "
            f"({method.choice.reason}); pass solver=diffrax.Dopri8() or solver=sj.Ros34PW2()"
        )
    return method._replace(by=by)


def built(build: Build, parameters: Any) -> Scene:
    """The scene of one run."""
    scene = build(**parameters) if isinstance(parameters, dict) else build(parameters)
    if not isinstance(scene, Scene):
        raise SceneError(f"build must return a Scene; it returned {type(scene).__name__}")
    return scene


@eqx.filter_jit
def many(build: Build, method: Method, parameters, ts, is_wanted) -> Runs:
    """`simulate_many` with everything decided; runs that are not wanted are not made."""
    prepared = _Prepared(build, method, ts)
    with without_host_checks():
        starts: Any = jax.vmap(prepared.start)(parameters)
        may_run = starts.may_run & is_wanted
        outcome = run_in_lanes(prepared.problem(), starts.numbers, starts.y0, ts, may_run, starts.status, method.block)
    slopes = slopes_of(starts.numbers, outcome.ys) if method.by else None
    if method.by:
        starts = starts._replace(numbers=starts.numbers.value)
        outcome = outcome._replace(ys=outcome.ys[:, :, 0], y_reached=outcome.y_reached[:, 0])
    runs = jax.vmap(prepared.trajectory)(starts, outcome._replace(n_lane_steps=jnp.zeros(is_wanted.shape)))
    return Runs(runs, outcome.touching, outcome.peaks, outcome.n_lane_steps, slopes)


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


class Start(NamedTuple):
    """One run, ready to go.

    Attributes:
        numbers: what the right-hand side is given.
        y0: flat state.
        may_run: whether it can be run.
        status: what is reported otherwise.
        assembly: how the start was made consistent.
    """

    numbers: Numbers
    y0: Float[Array, " size"]
    may_run: Array
    status: Int[Array, ""]
    assembly: Assembly


class _Prepared:
    """What is known of all runs once one has been traced: the plan and the tolerances that they share."""

    def __init__(self, build: Build, method: Method, ts):
        self.build, self.method, self.ts = build, method, ts
        self.plan: Plan | None = None
        self.shared_tolerances: Any = None

    def start(self, parameters) -> Start:
        """The start of one run, with its sensitivities as rows below the state where they are asked for."""
        by = self.method.by
        if not by:
            return self.start_of_state(parameters)

        def of_values(values):
            return self.start_of_state({**parameters, **dict(zip(by, values, strict=True))})

        return start_of_rows(of_values, jnp.stack([parameters[name] for name in by]))

    def start_of_state(self, parameters) -> Start:
        """Build the scene of one run and assemble its start."""
        method = self.method
        compiled = compile_scene(built(self.build, parameters), track_work=method.track_work)
        system = compiled.system
        structure, theta = flatten_system(system)
        _, unknown = split(system)
        scalar = path_of(structure).scalar
        self.plan = plan = Plan(structure, unknown, scalar)
        theta = jnp.asarray(theta)
        tolerances = tolerances_of(system, method.choice.solver, method.rtol, method.atol)
        self.explanation = f"{method.choice.reason}; {tolerances.description}; first step by trial (Hairer)"
        limits = (tolerances.rtol, tolerances.atol)
        own = limits if not all(is_concrete(limit) for limit in limits) else None
        self.shared_tolerances = limits if own is None else None
        assembly, y0 = beginning(plan, theta, self.ts[0], start_now(system, self.ts))
        legal = jnp.all(jnp.stack([jnp.array(True), *compiled.conditions]))
        closed = assembly.residual_after < CLOSING_TOLERANCE
        status = jnp.where(legal, jnp.where(closed, Status.SUCCEEDED, Status.START_NOT_CLOSED), Status.BAD_VALUE)
        numbers = Numbers(theta, program_for(state_rate, structure, scalar).ahead(theta), own)
        return Start(numbers, y0, legal & closed & jnp.all(jnp.isfinite(y0)), status, assembly)

    def problem(self) -> LaneProblem:
        """What every lane integrates."""
        plan, method = self.plan, self.method
        assert plan is not None
        rate = program_for(state_rate, plan.structure, plan.scalar)

        def controller_of(numbers: Numbers):
            limits = self.shared_tolerances if numbers.tolerances is None else numbers.tolerances
            return diffrax.PIDController(rtol=jnp.asarray(limits[0]), atol=jnp.asarray(limits[1]))

        problem = LaneProblem(
            with_structure(method.choice.solver, plan.structure),
            controller_of,
            lambda t, y, numbers: rate.inside(numbers.theta, numbers.ahead, t, y),
            correction_for(plan),
            contacts_of(plan.structure, plan.scalar),
            method.max_steps,
            watching(plan.structure, method.watch),
            longest_step(plan.structure, self.ts),
        )
        return problem_of_rows(problem, plan.structure, rate) if method.by else problem

    def trajectory(self, start: Start, outcome: LaneOutcome) -> Trajectory:
        """One run as a trajectory."""
        plan = self.plan
        assert plan is not None
        n_steps = outcome.n_accepted + outcome.n_rejected
        stats = Statistics(
            n_steps,
            outcome.n_accepted,
            outcome.n_rejected,
            n_steps * stages_of(self.method.choice.solver),
            outcome.n_onsets,
            self.explanation,
        )
        return Trajectory(
            ts=self.ts,
            ys=outcome.ys,
            system=plan.structure.system(start.numbers.theta),
            stats=stats,
            status=outcome.status,
            t_reached=outcome.t_reached,
            y_reached=outcome.y_reached,
            assembly=start.assembly,
            choice=self.method.choice.reason,
            scalar=plan.scalar,
        )

"""Simulate a scene: what is asked for is checked, what is left open is decided, and the run is made."""

import warnings
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.behind_tracers import known_behind
from spherejax.foundations.checks import called, is_concrete, is_tracing
from spherejax.foundations.errors import SceneError
from spherejax.foundations.remembering.again import again
from spherejax.foundations.remembering.same import Same
from spherejax.model.captured import captures_explained
from spherejax.model.numbers import in_words
from spherejax.model.scene import Scene
from spherejax.model.system import System, example_of
from spherejax.motion.derivatives.refused import without_derivative
from spherejax.motion.derivatives.sensitivities import integrate_with_sensitivities, through_kinks
from spherejax.motion.equations.contacts import abrupt_contacts, kinks_of
from spherejax.motion.integration.audit import cautions, parts_with_a_range, texts_for
from spherejax.motion.integration.one_run import bound_run
from spherejax.motion.integration.problem import Outcome, Plan, RunInputs, RunMethod
from spherejax.motion.integration.status import (
    OutOfRangeWarning,
    SimulationError,
    SimulationWarning,
    Status,
    diagnosis,
)
from spherejax.motion.integration.through_diffrax import integrate_through_diffrax
from spherejax.motion.integration.unseen import bound_in_words
from spherejax.motion.results.accuracy import Limits, limits_from
from spherejax.motion.results.stopping import When, conditions_of, stopped
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.accurate import accurate
from spherejax.motion.runs.method_checks import check_control, check_solver
from spherejax.motion.runs.preparation import (
    PreparedScene,
    chosen_method,
    closed_start,
    conditions_of_jumps,
    prepared,
    prepared_from,
    scene_tolerances,
)
from spherejax.motion.runs.times import sample_times, seconds_of
from spherejax.motion.settings import DEFAULT_MAX_STEPS, RunSettings, settings_from
from spherejax.motion.solvers.automatic import SolverChoice, choose_solver
from spherejax.motion.solvers.given_steps import GivenSteps
from spherejax.motion.solvers.root_finder import with_converging_root_finder
from spherejax.motion.solvers.traits import is_explicit
from spherejax.motion.start.assembly import Assembly
from spherejax.motion.start.start_now import StartWarning
from spherejax.motion.start.tolerances import Tolerances, tolerances_in_all_units, tolerances_of
from spherejax.program_cache import memoized
from spherejax.program_cache.keys import KeyedTree, own, value_key
from spherejax.program_cache.user_code import read_once
from spherejax.runtime import require_float64

BESIDE_THE_MOTION = (
    "derivative_rtol is for derivatives that are integrated beside the motion, without a controller or an adjoint of "
    "your own. Leave it, or those, out"
)
"""Why a tolerance of derivatives is refused."""

BY_TIMES = "Leave adjoint= out, or hold ts fixed: jax.lax.stop_gradient(ts)"
"""What to do where an adjoint of the user's meets sample times that are differentiated."""


def simulate(
    scene: Scene,
    ts: Float[Array | np.ndarray, " n"],
    *,
    rtol: float = 1e-8,
    atol: float | None = None,
    solver: diffrax.AbstractSolver | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    derivative_rtol: float | None = None,
    max_steps: int = DEFAULT_MAX_STEPS,
    track_work: bool = False,
    scalar: bool | None = None,
    throw: bool = False,
    accuracy: str | float | Mapping[str, str | float] | None = None,
    until: When | Sequence[When] | None = None,
    saveat: diffrax.SaveAt | None = None,
) -> Trajectory:
    """Simulate a scene.

    Args:
        scene: the mechanism.
        ts: sample times [s], increasing; the motion starts at the first and ends at the last.

    Other args:
        rtol: relative tolerance of a step.
        atol: absolute tolerance of a step, one number for all entries of the state (m, m/s, rad/s, 1). With None each
            kind of entry has its own, by the scales of the scene, and positions are judged against the clearance; see
            `spherejax.motion.start.tolerances`. `run.stats.explanation` says what was used.
        solver: a diffrax solver; chosen by the scene when None (`run.choice` says which and why), where `jax.jit` hides
            a bushing's numbers by each run when it starts; see `choose_solver`. All of diffrax's for one term do
            (explicit, implicit, `HalfSolver`); diagonally implicit ones (`Kvaerno5`) solve their stages in the
            structure of the mechanism, unless their `root_finder` is your own.
        stepsize_controller: a diffrax controller; `PIDController(rtol, atol)` when None. Contact onsets and releases
            are landed on whichever controller judges the errors, with `diffrax.StepTo(ts)` as well, whose steps end at
            the times that you give.
        adjoint: a diffrax adjoint. With None (or `diffrax.ForwardMode()`) derivatives are forward sensitivities by the
            traced numbers, which serve forward and reverse mode alike. They are integrated beside the motion, with
            their errors controlled at twice its tolerance (see `derivative_rtol`): through ten impacts they are good to
            1e-6 at an `rtol` of 1e-8, and to 1e-4 at 1e-6. A motion and its derivative by one number cost about four
            plain runs. Of Rosenbrock methods each step is differentiated beside the motion, and repeated only where the
            derivatives' errors are a thousand times its tolerance: those of the lubricated four-bar are right to 2e-4
            at an `rtol` of 1e-8, to 1e-6 at 1e-10, for about eight values. A controller of your own judges the state
            and the sensitivities as rows of one array; a `PIDController` judges the worst row. A sample that the
            sensitivities do not reach within `max_steps` has the derivative NaN. With an adjoint of diffrax the loop is
            diffrax's, which that adjoint differentiates: nobody controls the error of the derivatives. For the gradient
            of one number by hundreds of parameters see `sj.sensitivity`.
        derivative_rtol: relative tolerance of derivatives in a step, each in units of its number; None for twice `rtol`
            with explicit methods, a thousand times with Rosenbrock methods. The motion keeps its own. More makes them
            cheaper and coarser, down to the motion's own steps with `inf`, where nobody judges them
            (`benchmarks/sensitivity_tolerance.py` has what is gained and lost).
        max_steps: largest number of steps; it may be traced, unless an `adjoint` lays out memory by it.
        track_work: integrate the work that each non-ideal joint absorbs. Its error is not judged: the steps are those
            of a run without.
        scalar: True runs on the scalar program, False on the array code. With None the scalar program is taken up to
            a size that compiles in seconds; larger systems run on the array code, whose time grows with the number of
            bodies and whose compile time hardly does. `run.stats.explanation` says so.
        accuracy: the largest error that the whole run may have at its samples: a length for the positions of all
            bodies, "1 um" or a number [m], or errors by names of quantities, {"position.rocker": "1 um",
            "reaction.elbow": "0.1 N"}. The tolerance is chosen for it: from `rtol` on it is made tighter until the
            estimated errors (`run.error`) are at most half of that, and `run.accuracy` says what came of it. It takes 3
            to 10 times the steps of the run that is returned. Where no tolerance gives it (chaos, impacts without
            friction), the run has the status `INACCURATE`, and `run.determined_until` says until when it holds.
        throw: raise `SimulationError` when the run fails; otherwise a failed run carries its status, and a
            `SimulationWarning` is given where the outcome is known at once.
        until: a condition at which the motion ends before the last sample time, such as
            `sj.When("position.arm.z", 0.1, rising=True)` or `sj.When(lambda t, y, args: ...)`, a function of the state,
            or several: the first one that is met. The run then ends with
            a sample at that instant, a root to rounding; `run.stopped_by` says which condition was met, `run.end` is
            the state there. Within `jit`, `vmap` and `grad` the number of samples is fixed: those behind the end are
            the sample at the end again, with its time in `run.ts`. The instant and all that is observed there have
            derivatives, by the implicit function. It costs two more runs, one to see the steps and one to sample the
            step in which the condition is met. A run that fails behind that instant has succeeded; `run.stats` counts
            up to the last sample time. A quantity that passes the level and comes back between two of the five instants
            that are looked at in each step is not seen. With a step-size controller of your own it is refused: such a
            run cannot be repeated.
        saveat: a `diffrax.SaveAt` whose `ts` are samples beside those of `ts`, which then may be start and end alone.
            Both of these are samples of every run (`t0`, `t1`), and every run has its dense output, `run.at`. What has
            no counterpart is refused, with what there is in its place: `steps`, `fn`, several `subs`, states of the
            solver.

    Returns:
        The motion at the sample times.

    Raises:
        SceneError: for a scene or a request that cannot be simulated, before anything is computed.
        SimulationError: with `throw=True`, for a run that did not reach its end.
    """
    require_float64()
    settings = settings_from(
        rtol, atol, solver, stepsize_controller, adjoint, derivative_rtol, max_steps, track_work, scalar
    )
    conditions = () if until is None else conditions_of(until)
    ts = ts if saveat is None else sample_times(ts, saveat)
    limits = None if accuracy is None else _limits(scene, ts, accuracy, settings)
    with read_once(), captures_explained([scene]):
        call = _call(KeyedTree(scene), ts, settings)
        for said in call.warnings:
            warnings.warn(said, StartWarning, stacklevel=2)
        run = call.run()
    if limits is not None:
        run = accurate(run, limits)
    if conditions:
        run = stopped(run, conditions)
    return reported(run, throw)


def _limits(scene: Scene, ts, accuracy, settings: RunSettings) -> Limits:
    """What `accuracy=` asks for; `SceneError` where no tolerance can be chosen for it."""
    if settings.stepsize_controller is not None:
        raise SceneError(
            "accuracy= chooses the tolerance of spherejax's own step-size control; leave stepsize_controller= out"
        )
    found = prepared(scene, settings.track_work, settings.scalar)
    if is_tracing() or found.unknown or not all(map(is_concrete, (ts, settings.rtol))):
        raise SceneError(
            "accuracy= looks at whole runs to choose their tolerance, which a trace (jit, vmap, grad) cannot do. Find "
            "the tolerance of one run outside of it, rtol = sj.simulate(scene, ts, accuracy=...).settings.rtol, and "
            "give that"
        )
    return limits_from(accuracy, found.system())


class _Call(NamedTuple):
    """A call of `simulate` of which everything is decided.

    Attributes:
        warnings: what the start changes of what the scene describes, and what looks like a mistake.
        run: makes the run; its arrays and containers belong to nobody else.
    """

    warnings: tuple[str, ...]
    run: Callable[[], Trajectory]


N_CALLS = 64
"""Calls that are kept, of all scenes."""

MOST_TIMES = 4096
"""Sample times of a call that is kept: 64 calls then hold a few megabytes."""


def _by_values(scene: KeyedTree, ts: Any, settings: RunSettings) -> Hashable | None:
    """The key of a call; of many sample times, or of a list, which is slow to compare, there is none."""
    if scene.key is None or not isinstance(ts, np.ndarray | jax.Array) or ts.size > MOST_TIMES:
        return None
    others = value_key((ts, settings))
    return None if others is None else (scene.key, others)


@memoized(N_CALLS, _by_values)
def _call(scene: KeyedTree, ts, settings: RunSettings) -> _Call:
    """A call of `simulate`; arguments as there, the scene as it was read."""
    ts, settings = checked_times(ts), called(settings, "checked")
    return call_of(prepared_from(scene, settings.track_work, settings.scalar), None, ts, settings)


class CarriedStart(NamedTuple):
    """A start that is the end of a motion: nothing is assembled.

    Attributes:
        y: flat state, with the memory of joints and forces and with the works.
        residual: by how much it misses the joints' equations of the scene that goes on [m or 1].
        conditions: boolean scalars, traced; where one fails the run is not made.
    """

    y: Any
    residual: Any
    conditions: list

    def assembly(self, n_bodies: int) -> Assembly:
        """As a start that was not moved."""
        nothing: Any = np.zeros(n_bodies)
        return Assembly(self.y, nothing[0], self.residual, nothing, nothing, nothing)


def call_of(prepared_scene: PreparedScene, carried: CarriedStart | None, ts, settings: RunSettings) -> _Call:
    """Check what is asked for and decide what is left open.

    Args:
        prepared_scene: the scene.
        carried: the start; None to assemble it.
        ts: sample times [s], checked.
        settings: checked.
    """
    path, unknown, adjoint = prepared_scene.path, prepared_scene.unknown, settings.adjoint
    check_control(settings.stepsize_controller, adjoint, ts)
    choice = choice_of(prepared_scene, settings)
    # diffrax's forward mode has no reverse mode; the sensitivities serve both.
    by_sensitivities = adjoint is None or isinstance(adjoint, diffrax.ForwardMode)
    has_own_control = settings.stepsize_controller is None
    if settings.derivative_rtol is not None and not (by_sensitivities and has_own_control):
        raise SceneError(BESIDE_THE_MOTION)
    if settings.has_traced_budget and not by_sensitivities:
        raise SceneError(
            f"max_steps is traced, and {type(adjoint).__name__} lays out memory for every step; give it as a number, "
            "or leave adjoint= out"
        )
    method, said = method_of(prepared_scene, settings, choice, by_sensitivities)
    start = closed_start(prepared_scene, ts) if carried is None else None
    assembly = None if start is None else start.assembly
    if carried is not None:
        assembly = carried.assembly(example_of(prepared_scene.structure).layout.n_bodies)
    # A state that is traced is one of the traced numbers, so that there are derivatives by it.
    from_state = carried is not None and not is_concrete(carried.y)
    plan = Plan(prepared_scene.structure, unknown, path.scalar, from_state)
    # Known times have been checked; here they would be a kernel of their own for each number of samples.
    conditions = [*prepared_scene.conditions, *called(settings, "traced_conditions"), *traced_times(ts)]
    conditions += conditions_of_jumps(prepared_scene, ts)
    if carried is not None:
        conditions += carried.conditions
    values_are_legal = jnp.all(jnp.stack(conditions)) if conditions else np.array(True)
    numbers = None if carried is not None or not by_sensitivities else prepared_scene.values_behind
    if numbers is not None and not all(map(is_concrete, jax.tree.leaves((method, ts, assembly, values_are_legal)))):
        numbers = None
    values = prepared_scene.values if numbers is None else numbers
    begun_with = assembly
    if from_state and carried is not None and assembly is not None:
        values = jnp.concatenate([jnp.asarray(values), carried.y])
        begun_with = assembly._replace(y=np.zeros(carried.y.shape))  # the state is among the values
    inputs = RunInputs(values, prepared_scene.known, ts, begun_with, values_are_legal)
    if not by_sensitivities:
        name = type(adjoint).__name__
        inputs = inputs._replace(
            ts=without_derivative(ts, f"{name} gives no derivative by sample times. {BY_TIMES}"),
            values=without_derivative(values, through_kinks(plan, name))
            if kinks_of(prepared_scene.structure)
            else values,
        )
        outcome_of = integrate_through_diffrax.bound(plan, method, adjoint, settings.max_steps, inputs)
    elif unknown or from_state or not is_concrete(ts):
        # An explicit method has nothing to say of them.
        abrupt = () if is_explicit(choice.solver) else abrupt_contacts(prepared_scene.system())
        traced = None if numbers is None else prepared_scene.traced
        outcome_of = partial(integrate_with_sensitivities, plan, method, inputs, abrupt, traced)
    else:
        outcome_of = bound_run(plan, method, inputs)
    bound = bound_in_words(prepared_scene.structure, path.scalar)
    explanation = "; ".join(filter(None, [choice.reason, said, path.reason, bound, in_words(plan.traced)]))
    settings_of_run = called(settings, "of_run", choice.solver)

    def run() -> Trajectory:
        try:
            outcome = outcome_of()
        except TypeError as error:
            if "forward-mode" not in str(error):
                raise
            raise TypeError(
                f"adjoint={type(adjoint).__name__}() serves reverse mode (jax.grad) only; for forward mode (jax.jvp, "
                "jax.jacfwd) leave adjoint= out, or pass adjoint=diffrax.ForwardMode()"
            ) from error
        begun = outcome.assembly if assembly is None else Assembly(*map(own, assembly))
        made = made_of(ts, outcome, prepared_scene.leaves(), begun)
        # It was made just now, and nobody else has it. In a constructor it would be static, and each explanation, which
        # has the tolerances in it, would have it found out anew where leaves go.
        object.__setattr__(made.stats, "explanation", explanation)
        return made

    made_of = trajectories(
        Same(prepared_scene.tree), choice.reason, path.scalar, Same(settings_of_run), carried is not None
    )
    return _Call(() if start is None else start.warnings, run)


@lru_cache(maxsize=64)
def trajectories(
    tree: Same, choice: str, scalar: bool | None, settings: Same, is_continued: bool
) -> Callable[[Any, Outcome, list, Assembly], Trajectory]:
    """A function that makes trajectories of all that is static in them, but for the explanation.

    Args:
        tree: structure of the system.
        choice, scalar, settings, is_continued: as of `Trajectory`.
    """

    def trajectory(ts, outcome: Outcome, leaves: list, assembly: Assembly) -> Trajectory:
        return Trajectory(
            ts=ts,
            ys=outcome.ys,
            system=jax.tree.unflatten(tree.value, leaves),
            stats=replace(outcome.stats, explanation=""),
            ended=outcome.status,
            t_reached=outcome.t_reached,
            y_reached=outcome.y_reached,
            assembly=assembly,
            choice=choice,
            scalar=scalar,
            settings=settings.value,
            is_continued=is_continued,
        )

    return again(trajectory)


def choice_of(prepared_scene: PreparedScene, settings: RunSettings) -> SolverChoice:
    """The solver that the caller named, or the one that the scene calls for.

    Raises:
        SceneError: for a solver that cannot integrate a mechanism so.
    """
    if settings.solver is None or not settings.is_solver_named:
        return chosen_method(prepared_scene, settings.rtol)
    controller = settings.stepsize_controller
    is_judged = controller is None or isinstance(controller, diffrax.AbstractAdaptiveStepSizeController)
    return choice_for(None, settings.rtol, settings.solver, is_judged=is_judged)


def method_of(
    prepared_scene: PreparedScene, settings: RunSettings, choice: SolverChoice, by_sensitivities: bool = True
) -> tuple[RunMethod, str]:
    """How a scene is integrated by its settings, and words on the step-size control.

    Args:
        prepared_scene: the scene.
        settings: checked.
        choice: the solver.
        by_sensitivities: whether derivatives are integrated beside the motion.
    """
    structure, controller = prepared_scene.structure, settings.stepsize_controller
    solver = with_converging_root_finder(choice.solver, settings.rtol)
    if controller is not None:
        said = f"{type(controller).__name__}: as asked for"
        if isinstance(controller, diffrax.StepTo):
            controller = GivenSteps(controller.ts)
        return RunMethod.of(structure, solver, controller, settings.max_steps), said
    in_numbers = not by_sensitivities and isinstance(choice.solver, diffrax.AbstractImplicitSolver)
    tolerances = run_tolerances(prepared_scene, settings.rtol, settings.atol, in_numbers)
    at_start = choice.at_start if by_sensitivities else None
    factor = called(settings, "tangent_tolerance_factor")
    # `lanes/first_step.py` for explicit methods, `LandingController.init` for all others.
    said = f"{tolerances.description}; first step by trial (Hairer)"
    return RunMethod.of_own_control(structure, solver, tolerances, settings.max_steps, at_start, factor), said


def choice_for(
    system: System | None,
    rtol,
    solver: diffrax.AbstractSolver | None,
    *,
    explicit_only: bool = False,
    is_judged: bool = True,
) -> SolverChoice:
    """The solver asked for, or the one that the system calls for.

    Args:
        system: needed where none is asked for.
        rtol: relative tolerance of a step.
        solver: the one asked for, or None.
        explicit_only: whether an explicit one is chosen.
        is_judged: whether steps are chosen by the errors that the solver estimates.

    Raises:
        SceneError: for a solver that cannot integrate a mechanism so.
    """
    if solver is not None:
        check_solver(solver, is_judged)
        return SolverChoice(solver, f"{type(solver).__name__}: as asked for")
    assert system is not None
    return choose_solver(system, rtol, explicit_only=explicit_only)


def _by_content(ts: Any) -> Hashable | None:
    """The key of sample times; of many, or of a list, which is slow to compare, there is none."""
    is_array = isinstance(ts, np.ndarray | jax.Array) and is_concrete(ts)
    return value_key(ts) if is_array and ts.size <= MOST_TIMES else None


@memoized(N_CALLS, _by_content)
def checked_times(ts) -> Float[Array, " n"]:
    """Sample times as an array, checked where they are known; `SceneError` says what is wrong."""
    if is_concrete(ts):
        times = seconds_of(ts)
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
    if ts.dtype.kind == "c":
        raise SceneError("ts holds complex numbers; give real times [s]")
    return jnp.asarray(ts, jnp.float64)


def traced_times(ts: Float[Array, " n"]) -> list:
    """The same conditions for sample times that are traced: they are finite, and do not go back."""
    return [] if is_concrete(ts) else [jnp.all(jnp.isfinite(ts)), jnp.all(jnp.diff(ts) >= 0)]


def run_tolerances(found: PreparedScene, rtol, atol, in_numbers: bool = False) -> Tolerances:
    """Tolerances by the scales of the scene, or those that are given.

    Args:
        found: the scene.
        rtol, atol: as of `simulate`.
        in_numbers: whether tolerances must be numbers, the same for all entries of the state.
    """
    if atol is None and not in_numbers:
        return scene_tolerances(found, rtol)
    return tolerances_in_all_units(rtol) if atol is None else tolerances_of(found.system(), rtol, atol)


def reported(run: Trajectory, throw: bool, *, stacklevel: int = 3) -> Trajectory:
    """The run; where its outcome is known a failure is an error with `throw`, else a warning."""
    if _has_plainly_succeeded(run):
        return run
    seen = run.behind_tracers
    if seen is None:
        return _raising(run) if throw else run
    if int(seen.ended) != Status.SUCCEEDED:
        if throw:
            raise SimulationError(seen.diagnosis)
        warnings.warn(seen.diagnosis, SimulationWarning, stacklevel=stacklevel)
    shares = seen.stats.audit
    if cautions(shares):  # seldom: which parts are meant takes milliseconds
        said = cautions(shares, parts_with_a_range(seen.system, seen.y_reached), texts_for(seen.system))
        warnings.warn(said, OutOfRangeWarning, stacklevel=stacklevel)
    return run


def _has_plainly_succeeded(run: Trajectory) -> bool:
    """Whether a run has, also within `jax.grad`, and there is nothing to say of it: mostly no more is looked at."""
    numbers = run.ended, run.stats.audit
    known = [numbers] if all(map(is_concrete, numbers)) else known_behind(numbers)
    if len(known) != 1 or np.ndim(known[0][0]):
        return False
    ended, shares = known[0]
    return int(ended) == Status.SUCCEEDED and not cautions(shares)


def _raising(run: Trajectory) -> Trajectory:
    """A traced run whose values, and whose derivatives, raise where it has failed.

    The error is raised on the host, when the program runs: JAX puts frames of its own in front of it, and its last line
    is the sentence. `eqx.error_if` knows no numbers, and adds a paragraph on `equinox.filter_jit`.
    """
    numbers = run.ended, run.t_reached, run.ts[-1]

    def checked(*numbers) -> Array:
        one = jax.ShapeDtypeStruct((), jnp.float64)
        return jax.pure_callback(_raise_if_failed, one, *numbers, vmap_method="sequential")

    def unchecked(*numbers) -> Array:
        del numbers
        return jnp.ones(())

    passed = jax.lax.cond(run.ended != Status.SUCCEEDED, checked, unchecked, *map(jax.lax.stop_gradient, numbers))
    return jax.tree.map(lambda leaf: _dependent(leaf, passed) if eqx.is_inexact_array(leaf) else leaf, run)


def _raise_if_failed(ended: Any, t_reached: Any, t_end: Any) -> np.ndarray:
    """One, or `SimulationError` for a run that has failed; under `jax.vmap` it is called for all runs."""
    if int(ended) != Status.SUCCEEDED:
        said = diagnosis(np.asarray(ended), np.asarray(t_reached), np.asarray(t_end))
        raise SimulationError(f"a simulation {said}")
    return np.ones(())


@jax.custom_jvp
def _dependent(x: Array, passed: Array) -> Array:
    """x, evaluated behind a check. `jax.grad` drops a check that only the value depends on: so does the derivative."""
    return x * passed


@_dependent.defjvp
def _dependent_jvp(primals, tangents):
    x, passed = primals
    return x * passed, tangents[0] * passed

"""Many runs of one scene builder at once: what `jax.vmap(simulate)` does, in lanes that never idle.

`jax.vmap` of an integration waits for its slowest lane and carries every buffer through every step. Here the runs
queue for a block of lanes inside one compiled loop; see `motion.integration.lanes`.
"""

import warnings
from functools import partial
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.behind_tracers import LOOKS, place_of
from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Numeric
from spherejax.model.captured import captures_explained
from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene
from spherejax.motion.derivatives.refused import without_derivative
from spherejax.motion.derivatives.through_touches import any_jump, warn_of_rosenbrock
from spherejax.motion.equations.contacts import abrupt_contacts
from spherejax.motion.integration.audit import cautions
from spherejax.motion.integration.lanes import Block, run_in_lanes
from spherejax.motion.integration.sensitivity_rows import scales_of
from spherejax.motion.integration.status import OutOfRangeWarning, Status
from spherejax.motion.integration.widths import block_for
from spherejax.motion.results.many_sensitivities import RunSlopes, slopes_of
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.batch_setup import BatchSettings, PreparedRuns
from spherejax.motion.runs.simulate import checked_times, choice_for
from spherejax.motion.runs.traced_functions import Build, built, known_build
from spherejax.motion.settings import DEFAULT_MAX_STEPS, RunSettings
from spherejax.motion.solvers.automatic import SolverChoice, stiffest
from spherejax.motion.start.start_now import StartWarning, changed_starts
from spherejax.program_cache import cached_jit
from spherejax.program_cache.user_code import read_once
from spherejax.runtime import require_float64

NO_DERIVATIVE_OF_MANY = (
    'simulate_many gives no derivatives in jax.grad or jax.jvp. Name the parameters that they are by, by=("mass",): '
    "runs.slopes has them, from the same integration. Or map simulate, which has them: jax.vmap(jax.grad(...))"
)
"""What whoever differentiates through `simulate_many` is told: its loop has no derivative rule."""


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


def simulate_many(
    build: Build,
    parameters: Any,
    ts: Float[Array | np.ndarray, " n"],
    *,
    rtol: float = 1e-8,
    atol: float | None = None,
    solver: diffrax.AbstractSolver | None = None,
    max_steps: int = DEFAULT_MAX_STEPS,
    track_work: bool = False,
    watch: tuple[str, ...] = (),
    by: tuple[str, ...] = (),
    derivative_rtol: float | None = None,
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
        derivative_rtol: relative tolerance of these, as in `simulate`.
        block: how wide the block of lanes is; by default by the kind of device (`motion.widths`).

    Returns:
        The runs; failed ones carry their status.

    Raises:
        SceneError: for a request that cannot be simulated.
    """
    require_float64()
    ts = checked_times(ts)
    settings = RunSettings(
        rtol, atol, solver, derivative_rtol=derivative_rtol, max_steps=max_steps, track_work=track_work
    ).checked()
    n_runs = count_of_runs(parameters)
    if not all(map(is_concrete, jax.tree.leaves((parameters, ts)))):
        parameters, ts = without_derivative((parameters, ts), NO_DERIVATIVE_OF_MANY)
    with read_once():
        check_parameters(tuple(by), parameters, derivative_rtol)
        batch = batch_settings(build, parameters, settings, block or block_for())
        batch = batch._replace(watch=tuple(watch), by=tuple(by))
        warn_of_starts(build, parameters, ts)
        check_sensitivities(build, batch, parameters)
        one = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(np.shape(leaf)[1:], jnp.result_type(leaf)), parameters)
        build = known_build(build, one, track_work, batch.by)
        runs = many(build, batch, parameters, jnp.asarray(ts), jnp.ones(n_runs, bool))
    stats, status = runs.trajectories.stats, runs.trajectories.status
    if is_concrete(stats.audit) and (said := cautions(np.asarray(stats.audit)[np.asarray(status) == Status.SUCCEEDED])):
        warnings.warn(said, OutOfRangeWarning, stacklevel=2)
    return runs


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


def batch_settings(build: Build, parameters: Any, settings: RunSettings, block: Block) -> BatchSettings:
    """How all runs are integrated; by a stiff method when one of the runs that are looked at asks for it."""
    choice = _choice_for_all(build, parameters, settings)
    runs = settings.replaced(solver=choice.solver, is_solver_named=settings.solver is not None)
    return BatchSettings(runs, choice.reason, block)


def _choice_for_all(build: Build, parameters: Any, settings: RunSettings) -> SolverChoice:
    if settings.solver is not None:
        return choice_for(None, settings.rtol, settings.solver)
    n_runs = count_of_runs(parameters)
    choices, problem = [], None
    for run in sorted({place_of(look, n_runs) for look in LOOKS}):
        try:
            scene = built(build, jax.tree.map(lambda leaf, run=run: np.asarray(leaf)[run], parameters))
            system = compile_scene(scene, track_work=settings.track_work).system
            choices.append(choice_for(system, settings.rtol, None))
        except SceneError as error:
            problem = error
    if not choices:
        assert problem is not None
        raise problem
    return stiffest(choices)


def in_words(parameters: dict[str, Any]) -> str:
    """The parameters of one run."""
    shown = {name: np.array2string(np.asarray(value), precision=6, threshold=6) for name, value in parameters.items()}
    return ", ".join(f"{name} = {value}" for name, value in shown.items())


def warn_of_starts(build: Build, parameters: Any, ts: Numeric) -> None:
    """Give a `StartWarning` where runs do not start as their scenes describe; sixteen of them are looked at.

    Parameters that are traced are not looked at.
    """
    if not all(is_concrete(leaf) for leaf in jax.tree.leaves((parameters, ts))):
        return

    change, numbers = changed_starts(partial(built, build), parameters, ts)
    if change:
        at = f" (its parameters: {in_words(numbers)})" if isinstance(numbers, dict) else ""
        warnings.warn(change + at, StartWarning, stacklevel=3)


def check_parameters(by: tuple[str, ...], parameters: Any, derivative_rtol: float | None) -> None:
    """Refuse sensitivities by what is no parameter, and a tolerance of none.

    Raises:
        SceneError: naming the parameter, or the tolerance.
    """
    if not by and derivative_rtol is not None:
        raise SceneError(
            f"derivative_rtol = {derivative_rtol:.3g} is for sensitivities, and none is recorded; record "
            'sj.studies.Sensitivity(...) or "sensitivity final position.BODY", or leave it out'
        )
    names = list(parameters) if isinstance(parameters, dict) else []
    for name in by:
        if name not in names:
            known = ", ".join(map(repr, names)) or "none (they must be a mapping)"
            raise SceneError(f"sensitivities by {name!r}: no such parameter; there are {known}")
        if np.ndim(parameters[name]) != 1:
            raise SceneError(f"sensitivities by {name!r}: it must be one number for each run")


def check_sensitivities(build: Build, settings: BatchSettings, parameters: Any) -> None:
    """Refuse or doubt the sensitivities of runs, as `check_derivatives`; the runs of `LOOKS` are looked at.

    Parameters that are traced are not looked at.
    """
    if not settings.by or not all(map(is_concrete, jax.tree.leaves(parameters))):
        return
    n_runs = count_of_runs(parameters)
    abrupt: dict[str, None] = {}
    for run in sorted({place_of(look, n_runs) for look in LOOKS}):
        scene = built(build, jax.tree.map(lambda leaf, run=run: np.asarray(leaf)[run], parameters))
        try:
            system = compile_scene(scene, track_work=settings.runs.track_work).system
        except SceneError:  # this run will have the status of a bad value
            continue
        any_jump(system)
        abrupt |= dict.fromkeys(abrupt_contacts(system))
    warn_of_rosenbrock(abrupt, settings.runs.solver, 3)


@cached_jit(what="runs in lanes")
def many(build: Build, settings: BatchSettings, parameters, ts, is_wanted) -> Runs:
    """`simulate_many` with everything decided; runs that are not wanted are not made."""
    scenes: list[Scene] = []

    def scene_of(one: Any) -> Scene:
        scenes[:] = [built(build, one)]
        return scenes[0]

    with captures_explained(scenes):
        return _many(PreparedRuns(scene_of, settings, ts), parameters, is_wanted)


def _many(prepared: PreparedRuns, parameters, is_wanted) -> Runs:
    settings, ts = prepared.settings, prepared.ts
    starts: Any = jax.vmap(prepared.start)(parameters)
    may_run = starts.may_run & is_wanted
    outcome = run_in_lanes(prepared.problem(), starts.numbers, starts.y0, ts, may_run, starts.status, settings.block)
    slopes = None
    if settings.by:
        scale = scales_of(jnp.stack([parameters[name] for name in settings.by], axis=1))
        slopes = slopes_of(starts.numbers.slopes, scale, outcome.ys)
        outcome = outcome._replace(ys=outcome.ys[:, :, 0], y_reached=outcome.y_reached[:, 0])
    runs = jax.vmap(prepared.trajectory)(starts, outcome._replace(n_lane_steps=jnp.zeros(is_wanted.shape)))
    return Runs(runs, outcome.touching, outcome.peaks, outcome.n_lane_steps, slopes)

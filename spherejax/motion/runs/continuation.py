"""Runs that go on from the end of another run: from its whole state, memory included, with nothing assembled anew."""

from dataclasses import replace
from typing import Any

import diffrax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete, shown
from spherejax.foundations.errors import SceneError
from spherejax.model.captured import captures_explained
from spherejax.model.scene import Scene
from spherejax.motion.integration.status import SimulationError, Status
from spherejax.motion.results.motion_state import MotionState
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.preparation import PreparedScene, prepared, prepared_system
from spherejax.motion.runs.simulate import CarriedStart, call_of, checked_times, read_once, reported
from spherejax.motion.settings import DEFAULT_MAX_STEPS, RunSettings
from spherejax.motion.start.seam import carried_state
from spherejax.runtime import require_float64

ROUNDING = 4 * np.finfo(np.float64).eps
"""Two times that differ by this share of the larger one are the same: sums of steps are rounded."""


def continue_from(
    run: Trajectory | MotionState,
    ts: Float[Array | np.ndarray, " n"],
    scene: Scene | None = None,
    *,
    rtol: float | None = None,
    atol: float | None = None,
    solver: diffrax.AbstractSolver | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    derivative_rtol: float | None = None,
    max_steps: int | None = None,
    throw: bool = False,
) -> Trajectory:
    """Go on with a motion from where a run has ended.

        first = sj.simulate(scene, jnp.linspace(0.0, 1.0, 101))
        second = sj.continue_from(first, jnp.linspace(1.0, 2.0, 101))

    The run begins with the whole state of the other one at its end: positions, velocities, and all that is remembered
    (impact speeds and bristles of contacts, integrals and held samples of controllers, turns, states of rubber, works).
    Nothing is assembled, projected or warned of. A motion that is cut in pieces is that of one run to the tolerance;
    the steps are others, for each piece finds its first step anew. Derivatives pass from piece to piece.

    Args:
        run: a run that has reached its end, or its state there (`run.end`).
        ts: sample times [s], increasing, not before the end of the run. That end is the first sample of what is
            returned: it is put in front where `ts` does not begin with it. Times that are traced must begin with it.
        scene: other numbers to go on with, such as a stiffness or a motor's torque; None for those of the run. Bodies,
            joints and force elements have the same names and remember the same; laws and models may be others. What
            counts from the start of a motion counts from the start that this scene describes. A clearance that is
            smaller than the ball's eccentricity begins a contact, at the speed of an impact that would have led there.

    Other args:
        rtol, atol, solver, max_steps: as of `simulate`; those of the run when None.
        stepsize_controller, adjoint, derivative_rtol, throw: as of `simulate`; they are not taken over from the run.

    Returns:
        The motion from the end of the run on; `work` and what else adds up goes on counting.

    Raises:
        SceneError: for a scene with other parts, or in which a joint would jump; for times before the end of the run.
            Where numbers are traced, such a run has the status `BAD_VALUE` or `START_NOT_CLOSED`.
        SimulationError: for a run that has failed, with its diagnosis; where that is traced, what goes on has the
            status of the run.

    Limits: a state that `jax.lax.scan` carries must keep its structure, so within it a run goes on without `scene=` of
    traced numbers (`sj.advance` has inputs). Derivatives by a state are forward sensitivities, a row for each of its
    entries (13 of a body): the derivative of a motion in pieces costs more than that of the whole.
    """
    require_float64()
    state = run.end if isinstance(run, Trajectory) else run
    with read_once(), captures_explained([] if scene is None else [scene]):
        prepared_scene, start = _start(state, scene)
        settings = _settings_from(
            state, rtol, atol, solver, stepsize_controller, adjoint, derivative_rtol, max_steps
        ).checked()
        continued = _made_from(state, prepared_scene, start, _times_from(ts, state, start), settings)
    return reported(continued, throw)


def _start(state: Any, scene: Scene | None) -> tuple[PreparedScene, CarriedStart]:
    """What is simulated, and its start."""
    refuse_failed(state)
    scalar = state.scalar if state.settings is None else state.settings.scalar
    before = state.system
    if scene is None:
        return prepared_system(before, scalar), CarriedStart(state.y, np.zeros(()), reached(state))
    if not isinstance(scene, Scene):
        raise SceneError(f"scene = {shown(scene)} is no scene; give the scene to go on with, or leave it out")
    prepared_scene = prepared(scene, before.tracks_work, scalar)
    y, residual = carried_state(before, prepared_scene.system(), state.t, state.y)
    return prepared_scene, CarriedStart(y, residual, reached(state))


def refuse_failed(state: Any) -> None:
    """Raise an error for what no motion can go on from.

    Raises:
        SceneError: for what is no state, for a run in place of its end, or for many.
        SimulationError: for the end of a run that has failed.
    """
    if isinstance(state, Trajectory):
        raise SceneError("a run is no state; give its state at the end, run.end")
    if not isinstance(state, MotionState):
        raise SceneError(
            f"a {type(state).__name__} is no state of a motion: {shown(state)}. Give sj.start(scene), or a run of "
            "sj.simulate: sj.continue_from takes the run, sj.advance its end, run.end"
        )
    if np.ndim(state.ended):
        raise SceneError(
            "these are many motions; go on with one of them, jax.tree.map(lambda leaf: leaf[0], runs), or with all: "
            "jax.vmap(lambda run: sj.continue_from(run, ts))(runs)"
        )
    if is_concrete(state.ended) and int(state.ended) != Status.SUCCEEDED:
        raise SimulationError(f"a run that has failed cannot go on: it {state.diagnosis}")


def reached(state: MotionState) -> list:
    """The condition, where it is traced, that the motion has come here."""
    return [] if is_concrete(state.ended) else [state.ended == Status.SUCCEEDED]


def _times_from(ts: Any, state: MotionState, start: CarriedStart) -> Any:
    """Sample times that begin with the end of the run; a condition of the start where they cannot be looked at."""
    times = checked_times(ts)
    if not (is_concrete(times) and is_concrete(state.t)):
        off = jnp.abs(times[0] - state.t)
        start.conditions.append(off <= ROUNDING * jnp.maximum(jnp.abs(times[0]), jnp.abs(state.t)))
        return times
    samples, end = np.array(times), float(state.t)
    off, rounding = samples[0] - end, ROUNDING * max(abs(samples[0]), abs(end))
    if off < -rounding:
        raise SceneError(
            f"ts begins at {samples[0]:.9g} s, before the end of the run, {end:.9g} s, from where it goes on. Give the "
            "times behind it"
        )
    if off <= rounding:
        samples[0] = end
        return jnp.asarray(samples)
    return jnp.asarray(np.concatenate([[end], samples]))


def _settings_from(
    state: MotionState, rtol, atol, solver, stepsize_controller, adjoint, derivative_rtol, max_steps
) -> RunSettings:
    """How a motion goes on: method and tolerances are those of the state where an argument is None."""
    before = state.settings
    if rtol is None and before is None:
        raise SceneError(
            "the tolerances of this run were traced, or a step-size controller of its own judged its steps: give "
            "rtol= (and solver=) to go on"
        )
    if before is None:
        before = RunSettings(max_steps=DEFAULT_MAX_STEPS, scalar=state.scalar)
    return RunSettings(
        before.rtol if rtol is None else rtol,
        before.atol if atol is None else atol,
        before.solver if solver is None and before.is_solver_named else solver,
        stepsize_controller,
        adjoint,
        derivative_rtol,
        before.max_steps if max_steps is None else max_steps,
        track_work=state.system.tracks_work,
        scalar=before.scalar,
    )


def _made_from(
    state: MotionState, prepared_scene: PreparedScene, start: CarriedStart, ts: Any, settings: RunSettings
) -> Trajectory:
    """The run from a start."""
    call = call_of(prepared_scene, start, ts, settings)
    run = call.run()
    if is_concrete(state.ended):
        return run
    has_come = state.ended == Status.SUCCEEDED
    return replace(
        run,
        ended=jnp.where(has_come, run.ended, state.ended),
        ys=jnp.where(has_come, run.ys, jnp.nan),
        t_reached=jnp.where(has_come, run.t_reached, state.t),
    )

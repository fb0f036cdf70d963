"""A mechanism step by step, for control and learning: numbers of its force elements are inputs, held during a step.

A step is a run between two times, by the method and to the tolerance of the start. Nothing but its end is kept.
"""

import warnings
from collections.abc import Hashable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import called, enforce, is_concrete, is_tracing, shown
from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.forms import real_number
from spherejax.foundations.lanes import rows_at
from spherejax.foundations.types import Number
from spherejax.model.captured import captures_explained
from spherejax.model.numbers import part_at, place_at, with_entry
from spherejax.model.scene import Scene
from spherejax.model.system import (
    System,
    code_now,
    example_of,
    flatten_by_factor,
    flatten_system,
    split,
    with_laws_by_factor,
)
from spherejax.motion.derivatives.sensitivities import depends_on_time, integrate_with_sensitivities
from spherejax.motion.equations.contacts import abrupt_contacts
from spherejax.motion.equations.programs import path_of
from spherejax.motion.integration.one_run import run_of
from spherejax.motion.integration.problem import Plan, RunInputs, RunMethod, beginning
from spherejax.motion.integration.status import SimulationError, SimulationWarning, Status, start_status
from spherejax.motion.results.motion_state import MotionState
from spherejax.motion.runs.continuation import reached, refuse_failed
from spherejax.motion.runs.preparation import (
    N_SCENES,
    closed_start,
    conditions_of_jumps,
    prepared,
    prepared_system,
)
from spherejax.motion.runs.simulate import (
    CarriedStart,
    checked_times,
    choice_of,
    method_of,
    read_once,
    traced_times,
)
from spherejax.motion.settings import DEFAULT_MAX_STEPS, RunSettings
from spherejax.motion.start.start_now import StartWarning
from spherejax.program_cache import cached_jit, memoized
from spherejax.runtime import require_float64

GEOMETRY = ("attachment", "coordinate", "place")
"""Fields of force elements that become others when a scene is compiled: no inputs."""

OTHER_NUMBERS = "To go on with other numbers of the scene: sj.continue_from(state, ts, scene=...)"

Inputs = Mapping[str, Float[Array, "..."] | np.ndarray | float]
"""Values by path, such as `{"motor.offset": 2.0, "push.force": (1.0, 0.0, 0.0)}`."""


def start(
    scene: Scene,
    t: Number = 0.0,
    *,
    rtol: float = 1e-8,
    atol: float | None = None,
    solver: diffrax.AbstractSolver | None = None,
    max_steps: int = DEFAULT_MAX_STEPS,
    track_work: bool = False,
    scalar: bool | None = None,
) -> MotionState:
    """The state of a mechanism at the start of its motion, for `sj.advance` and `sj.continue_from`.

        state = sj.start(scene)
        state = sj.advance(state, 0.01, {"motor.offset": 2.0})

    Args:
        scene: the mechanism.
        t: time of the start [s].

    Other args:
        rtol, atol, solver, max_steps, track_work, scalar: as of `simulate`, for the motion that goes on from here;
            `max_steps` of a step of `advance`. `rtol` and `atol` must be known.

    Returns:
        The state, assembled as `simulate` does it. Where numbers are traced (`jit`, `vmap`, `grad`) these are leaves of
        it, and derivatives by them pass through; a start that cannot be made has a status (`ended`).

    Raises:
        SceneError: for a scene that cannot be simulated.
    """
    require_float64()
    if not all(map(is_concrete, (rtol, atol, max_steps))):
        raise SceneError(
            "sj.start: rtol, atol and max_steps must be known numbers; they belong to the state's structure"
        )
    settings = RunSettings(rtol, atol, solver, max_steps=max_steps, track_work=track_work, scalar=scalar).checked()
    real_number("t", t)
    ts = checked_times(np.array([t], np.float64) if is_concrete(t) else jnp.asarray(t, jnp.float64)[None])
    with read_once(), captures_explained([scene]):
        prepared_scene = prepared(scene, track_work, scalar)
        choice = choice_of(prepared_scene, settings)
        assembled = closed_start(prepared_scene, ts)
        for change in () if assembled is None else assembled.warnings:
            warnings.warn(change, StartWarning, stacklevel=2)
        conditions = [*prepared_scene.conditions, *traced_times(ts), *conditions_of_jumps(prepared_scene, ts)]
        legal = jnp.all(jnp.stack(conditions)) if conditions else np.array(True)
        plan = Plan(prepared_scene.structure, prepared_scene.unknown, prepared_scene.path.scalar)
        values = prepared_scene.values
        y, status = _begun(
            plan, values, prepared_scene.known, ts, None if assembled is None else assembled.assembly, legal
        )
    # A method that is chosen by numbers which are traced is chosen again at each step.
    decided = settings.of_run(choice.solver)
    if decided is not None and choice.at_start is None:
        decided = decided.replaced(is_solver_named=True)
    return MotionState.of(prepared_scene.system(), jnp.asarray(ts)[0], y, status, decided, prepared_scene.path.scalar)


@cached_jit(what="the start of a motion")
def _begun(plan: Plan, values, known, ts, start, legal) -> tuple[Float[Array, " size"], Array]:
    """The flat state at the start, and its status."""
    assembly, y = beginning(plan, plan.theta(values, known), ts[0], start)
    return y, start_status(legal, jax.lax.stop_gradient(assembly.residual_after), jax.lax.stop_gradient(y))


def advance(state: MotionState, dt: Number, inputs: Inputs | None = None, *, throw: bool = False) -> MotionState:
    """The state of a mechanism a step later.

        state = sj.advance(state, 0.01, {"motor.offset": 2.0})
        state.position("cart"), state.velocity("cart")

    The motion within the step is integrated to the tolerance of the start, through contacts and samples of controllers,
    with as many steps of the method as that takes. All that the mechanism remembers goes on.

    Args:
        state: from `sj.start`, `run.end`, or a step before.
        dt: length of the step [s].
        inputs: numbers of force elements by path, held during the step; after it the state has the scene's again. A
            path is the element's name and its field: `"motor.offset"` of an `Actuator` or a `PID` (what is added to the
            effort), `"push.force"` of an `AppliedWrench` (an array), `"push.force.x"`. They may be traced.

    Other args:
        throw: raise `SimulationError` where the step fails; otherwise the state says so (`ended`), with a
            `SimulationWarning` where that is known at once. No motion goes on from a state that has failed: where that
            is traced, the state stays as it is.

    Returns:
        The state at `state.t + dt`; a pytree of the same structure. `jax.lax.scan` over `advance` compiles one step,
        `jax.vmap` of it steps many states side by side, and both may be differentiated, with inputs in contact too.

    Raises:
        SceneError: for an input that the scene does not have, or a value that is not legal.
        SimulationError: for a state that has failed; with `throw=True` for a step that fails.

    Limits: of a scene whose equations read the time (a driver, a function of time, a sampled controller) `jax.vmap`
    makes the steps of states one after the other, with a `SerialRunsWarning`. With functions of time each step takes at
    least a hundred steps of the method. The value of such a function as an input has neither cost. The derivative by a
    state is a forward sensitivity, a row for each of its entries (13 of a body).
    """
    require_float64()
    refuse_failed(state)
    if state.settings is None:
        raise SceneError(
            "this state has no method and tolerances: its run had traced ones, or a step-size controller of its own. "
            "Make it by sj.start, or of a run with rtol= as a number"
        )
    _check_length(dt)
    inputs = {} if inputs is None else inputs
    if not isinstance(inputs, Mapping):
        raise SceneError(f'inputs = {shown(inputs)} is no dictionary; write e.g. {{"motor.offset": 2.0}}')
    with read_once():
        names = tuple(inputs)
        stepper = _stepper_of(state, names)
        values = [_as_value(name, inputs[name], shape) for name, shape in zip(names, stepper.shapes, strict=True)]
        conditions = [*reached(state), *_judged(state, stepper, values)]
        after = stepper.advanced(state, dt, values, conditions)
    if is_concrete(after.ended) and int(after.ended) != Status.SUCCEEDED:
        if throw:
            raise SimulationError(after.diagnosis)
        warnings.warn(after.diagnosis, SimulationWarning, stacklevel=2)
    return after


def _check_length(dt: Any) -> None:
    """Raise `SceneError` for a step that is none."""
    real_number("dt", dt)
    if is_concrete(dt) and not 0 < float(dt) < np.inf:
        raise SceneError(f"dt = {float(dt):.6g} s must be positive and finite")


class _Stepper(NamedTuple):
    """What the steps of a mechanism are made with.

    Attributes:
        plan: what they are compiled for; the inputs are among its unknown numbers.
        method: how they are integrated.
        known: the numbers that are known.
        traced: indices of the numbers that the caller traces, but for inputs.
        order: of these and then of the inputs, as they stand in `plan.unknown`.
        places: of the inputs in the system: attributes and keys, and an entry.
        shapes: of the inputs.
        reads_time: whether the motion depends on the time by itself.
    """

    plan: Plan
    method: RunMethod
    known: Float[np.ndarray, " p"]
    traced: tuple[int, ...]
    order: np.ndarray
    places: tuple[tuple[tuple[str, ...], tuple[int, ...]], ...]
    shapes: tuple[tuple[int, ...], ...]
    reads_time: bool

    @classmethod
    def of(cls, state: MotionState, names: tuple[str, ...]) -> "_Stepper":
        """That of a state, for inputs by path."""
        settings = state.settings
        assert settings is not None
        seen = with_laws_by_factor(state.system)
        structure, theta = flatten_system(seen)
        # A system whose numbers are their own indices says where the inputs are.
        indices = structure.system(np.arange(theta.shape[0], dtype=np.float64))
        places = tuple(_place_of(state.known_system, name) for name in names)
        entries = [np.asarray(_at(indices, place)).astype(int) for place in places]
        inputs = [int(i) for entry in entries for i in entry.ravel()]
        if len(set(inputs)) < len(inputs):
            raise SceneError(f"inputs {', '.join(map(repr, names))} name a number twice; name each once")
        # A program for inputs of any value: one for a torque of zero could not be given another.
        structure = replace(
            structure, special=tuple((i, value) for i, value in structure.special if i not in set(inputs))
        )
        known, traced = split(seen)
        known = np.array(known)
        known[inputs] = 0.0
        traced = tuple(i for i in traced if i not in set(inputs))
        order = np.argsort([*traced, *inputs]).astype(int)
        unknown = tuple(sorted([*traced, *inputs]))
        # RunMethod and tolerances are those of the scene, whatever the inputs are.
        scene = prepared_system(state.system, settings.scalar)
        method, _ = method_of(scene, settings, choice_of(scene, settings))
        plan = Plan(structure, unknown, path_of(structure, settings.scalar).scalar)
        reads_time = depends_on_time(plan) or bool(example_of(structure).sampled_forces)
        shapes = tuple(entry.shape for entry in entries)
        return cls(plan, method, known, traced, order, places, shapes, reads_time)

    def advanced(self, state: MotionState, dt: Any, inputs: list, conditions: list) -> MotionState:
        """The state a step later."""
        ends = (state.t, state.t + dt) if self.reads_time else (0.0, dt)
        is_known = all(map(is_concrete, ends))
        ts = (
            jnp.asarray(np.array(ends, np.float64))
            if is_known
            else jnp.stack([jnp.asarray(t, jnp.float64) for t in ends])
        )
        conditions = [*conditions, *traced_times(ts)]
        legal = jnp.all(jnp.stack(conditions)) if conditions else np.array(True)
        start = CarriedStart(state.y, np.zeros(()), []).assembly(example_of(self.plan.structure).layout.n_bodies)
        values = self._values(state, inputs)
        if all(map(is_concrete, jax.tree.leaves((state, ts, values, legal)))) and not is_tracing():
            outcome = run_of(self.plan, self.method, RunInputs(values, self.known, ts, start, legal))
        else:
            plan = replace(self.plan, from_state=not is_concrete(state.y))
            if plan.from_state:
                values = jnp.concatenate([jnp.asarray(values), state.y])
                start = start._replace(y=np.zeros(state.y.shape))
            abrupt = abrupt_contacts(state.system)
            numbers = RunInputs(values, self.known, ts, start, legal)
            outcome = integrate_with_sensitivities(plan, self.method, numbers, abrupt)
        has_come = state.ended == Status.SUCCEEDED
        t = state.t + jnp.where(outcome.status == Status.SUCCEEDED, dt, outcome.t_reached - ts[0])
        return replace(
            state,
            t=jnp.where(has_come, t, state.t),
            y=jnp.where(has_come, outcome.y_reached, state.y),
            ended=jnp.where(has_come, outcome.status, state.ended),
        )

    def _values(self, state: MotionState, inputs: list) -> Any:
        """The unknown numbers."""
        own = [np.zeros(0)]
        if self.traced:
            own = [rows_at(jnp.asarray(flatten_by_factor(state.system)[1]), self.traced)]
        parts = [*own, *inputs]
        if all(map(is_concrete, parts)):
            return np.concatenate([np.ravel(np.asarray(part)) for part in parts])[self.order]
        return jnp.concatenate([jnp.ravel(jnp.asarray(part, jnp.float64)) for part in parts])[self.order]


def _by_known_numbers(state: MotionState, names: tuple[str, ...]) -> Hashable | None:
    """What steps are kept by; there is nothing for a state with traced numbers."""
    if any(leaf is None for leaf in state.known.leaves):
        return None
    # The code of the scene is what it is now, not what it was when the state was made.
    return state.known, code_now(state.known.tree), state.settings, state.scalar, names


@memoized(N_SCENES, _by_known_numbers)
def _stepper_of(state: MotionState, names: tuple[str, ...]) -> _Stepper:
    """What the steps of a state are made with."""
    return _Stepper.of(state, names)


def _place_of(system: System, name: Any) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Where an input is.

    Raises:
        SceneError: for a path that leads nowhere, or to what is no number of a force element.
    """
    if not isinstance(name, str):
        raise SceneError(f"inputs: {shown(name)} is no path of a number; write e.g. 'motor.offset' or 'push.force'")
    # A body or a joint may have the name of a force element: only among the latter is a name looked up.
    path = name if name.partition(".")[0] in system.forces else name.removeprefix("forces.")
    element = path.partition(".")[0]
    if element not in system.forces:
        raise SceneError(
            f"{name} is no input: there is no force element {element!r}; {one_of(system.forces, element)}. Inputs are "
            f"numbers of force elements, such as 'motor.offset' or 'push.force'. {OTHER_NUMBERS}"
        )
    place = place_at(system, f"forces.{path}")
    if any(field in GEOMETRY for field in place.steps[2:]):
        raise SceneError(f"{name} is no input: it is geometry, which is fixed during a step. {OTHER_NUMBERS}")
    if place.value is None:
        raise SceneError(f"{name} is not given in the scene; give it a value there first")
    return place.steps, place.index


def _at(system: System, place: tuple[tuple[str, ...], tuple[int, ...]]) -> Any:
    steps, index = place
    value = part_at(system, steps)
    return value[index] if index else value


def _as_value(name: str, value: Any, shape: tuple[int, ...]) -> Any:
    """An input as an array of its place.

    Raises:
        SceneError: for what is no number, or has another shape.
    """
    try:
        numbers = np.asarray(value) if is_concrete(value) else jnp.asarray(value)
    except (TypeError, ValueError):
        raise SceneError(f"inputs: {name} = {shown(value)} is no number") from None
    if numbers.dtype.kind not in "iuf":  # NumPy makes a number of a text, and NaN of None
        raise SceneError(f"inputs: {name} = {shown(value)} is no number; give it in SI units, without quotes")
    value = numbers.astype(np.float64)
    if value.shape != shape:
        raise SceneError(f"inputs: {name} has the shape {value.shape}, and its number in the scene {shape}")
    return value


def _judged(state: MotionState, stepper: _Stepper, inputs: list) -> list:
    """Conditions on inputs that are traced; `SceneError` for one that is known and not legal."""
    if not inputs:
        return []
    system = state.system
    for (steps, index), value in zip(stepper.places, inputs, strict=True):
        system = with_entry(system, steps, index, value)
    names = dict.fromkeys(steps[1] for steps, _ in stepper.places)
    return [c for n in names for c in enforce(f"force {n!r}", called(system.forces[n], "requirements"))]

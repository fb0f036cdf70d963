"""The start of a run whose numbers are known: assembled at once, and what it changes of the scene said aloud."""

import warnings
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Numeric
from spherejax.model.picking import Picked, picked
from spherejax.model.scene import Scene
from spherejax.model.system import Structure, System, compile_scene, example_of, flatten_system, special_in
from spherejax.motion.equations.friction_judgement import refuse_unsolvable_friction
from spherejax.motion.start.assembly import Assembly, as_ideal, assemble_now
from spherejax.motion.start.doubts import doubts_of
from spherejax.motion.start.driver_conflicts import REMEDY, conflicts_at, refuse_driver_conflicts
from spherejax.motion.start.locked import locked_motors
from spherejax.motion.start.positions import clearances_of, far_from, largest_body, moved_bodies, shares_of
from spherejax.motion.start.velocities import removed_velocities


class StartWarning(UserWarning):
    """A run starts with other positions or velocities than the scene describes, or its start looks like a mistake.

    It looks like one where a motor acts on bodies that have 0 degrees of freedom, and where a joint with one point
    stands beside a named point that nothing else uses.

    Bodies that had to be moved far are named with how far each was moved and turned; so are joints that took velocities
    away. Numbers that are traced (inside `jit`, `vmap`, `grad` and fits) are not looked at; `run.assembly` holds what
    was changed. Of a sweep several runs are looked at before it begins.
    """


class KnownStart(NamedTuple):
    """A start that is known before the run.

    Attributes:
        assembly: the consistent start.
        changes: what it changes of what the scene describes, in sentences.
        doubts: what looks like a mistake in the scene, in sentences.
    """

    assembly: Assembly
    changes: tuple[str, ...]
    doubts: tuple[str, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """All that is said of the start."""
        return self.changes + self.doubts


def start_now(system: System, ts: Numeric, *, stacklevel: int = 3) -> Assembly | None:
    """The consistent start, when the geometry is known now; None when it is traced.

    What it changes of the positions and velocities of the scene is said in `StartWarning`s.

    Args:
        system: the system.
        ts: sample times [s].
        stacklevel: of the warnings; 3 is who called the caller.

    Raises:
        SceneError: for joints that cannot be closed, and drivers that fight.
    """
    start = known_start(system, ts)
    if start is None:
        return None
    for said in start.warnings:
        warnings.warn(said, StartWarning, stacklevel=stacklevel)
    return start.assembly


class _StartAt:
    """Where the numbers of a start are, of systems of one structure.

    Attributes:
        ideal: those of the system as if its joints were ideal.
        clearances, speeds: of all joints; of all bodies.
    """

    def __init__(self, ideal: Picked, clearances: Picked, speeds: Picked):
        self.ideal, self.clearances, self.speeds = ideal, clearances, speeds
        self._like = Structure(ideal.tree, ideal.shapes, ())

    def structure_for(self, numbers: np.ndarray) -> Structure:
        """That of the system as if its joints were ideal."""
        # The one of before where it is the same: its hash is known.
        self._like = self._like.for_special(tuple(special_in(numbers)))
        return self._like


@lru_cache(maxsize=64)
def _start_at(structure: Structure) -> _StartAt | None:
    """None where more of the system has to be looked at: drivers, motors, friction that follows reactions."""
    speeds = picked(lambda s: [(body.velocity, body.angular_velocity) for body in s.bodies.values()], structure)
    ideal, clearances = picked(as_ideal, structure), picked(clearances_of, structure)
    if ideal is None or clearances is None or speeds is None:  # before all other questions: no user code is in it
        return None
    example = example_of(structure)
    if example.is_driven or example.friction_passes or any(force.is_motor for force in example.forces.values()):
        return None
    return _StartAt(ideal, clearances, speeds)


def usual_start(
    structure: Structure, known: Float[np.ndarray, " p"], unknown: tuple[int, ...] = ()
) -> KnownStart | None:
    """`known_start` of a system that is taken apart, where nothing is to be said of it; None where it has to be looked
    at whole.

    Args:
        structure: of the system.
        known: its numbers that are known.
        unknown: indices of the others.

    Raises:
        SceneError: for joints that cannot be closed.
    """
    at = _start_at(structure)
    if at is None or at.speeds.flat(known).any() or at.ideal.has_any(unknown):
        return None
    numbers = at.ideal.flat(known)
    ideal = at.structure_for(numbers)
    start = assemble_now(ideal, numbers)
    if not start.displacement.any() and not start.rotation.any():
        return KnownStart(start, ())
    far = far_from(largest_body(ideal, numbers), float(min(at.clearances.flat(known, unknown), default=np.inf)))
    shares = shares_of(np.asarray(start.displacement), np.asarray(start.rotation), far)
    return None if shares.max(initial=0.0) > 1 else KnownStart(start, ())


def known_start(system: System, ts: Numeric) -> KnownStart | None:
    """As `start_now`, without a warning."""
    structure, theta = flatten_system(as_ideal(system))
    if not is_concrete(theta) or (system.is_driven and not is_concrete(ts)):
        return None
    # What is not driven starts alike at any time.
    t = float(ts[0]) if system.is_driven else 0.0
    try:
        start = assemble_now(structure, theta, t)
    except SceneError as error:
        _refuse_drivers_not_finite(system, t)
        fighting = conflicts_at(structure, theta, t) if system.is_driven else ()
        if not fighting:
            raise
        names = " and ".join(map(repr, fighting))
        raise SceneError(
            f"drivers {names} fight: at t = {t:.6g} s they ask for positions that cannot be had together. {REMEDY}"
        ) from error
    # A start that is not finite is not judged: the status of its run says so, and names the driver.
    if system.is_driven and np.all(np.isfinite(start.y)):
        refuse_driver_conflicts(structure, theta, np.asarray(ts), start)
    refuse_unsolvable_friction(system, t, np.asarray(start.y))
    doubts = locked_motors(system, ts, start)
    return KnownStart(start, _changes(system, structure, theta, t, start), doubts)


def _refuse_drivers_not_finite(system: System, t: float) -> None:
    """Raise `SceneError` for a driver whose function of time is not finite when the motion starts, at t [s]."""
    for name, joint in system.joints.items():
        for function in joint.functions_of_time:
            value = np.asarray(function(jnp.asarray(t)))
            if not np.all(np.isfinite(value)):
                raise SceneError(
                    f"driver {name!r}: its function of time gives {value} at the start, t = {t:.6g} s. It must be "
                    "finite there, and so must its first and second derivative"
                )


def start_changes(system: System, ts: Numeric, start: Assembly) -> tuple[str, ...]:
    """What a start changes of the positions and velocities that a scene describes, and motors on locked bodies.

    Args:
        system: the system, of known numbers.
        ts: sample times [s]; what is not driven starts alike at any time.
        start: the consistent start.

    Returns:
        Sentences; empty where nothing is to be said.
    """
    changes = _changes(system, *flatten_system(as_ideal(system)), float(ts[0]), start)
    return (*changes, *locked_motors(system, ts, start))


def _changes(system: System, structure: Structure, theta, t: float, start: Assembly) -> tuple[str, ...]:
    """Changes of positions and velocities, by the system as if its joints were ideal, taken apart."""
    common = system, structure, theta, t, start
    return tuple(filter(None, (moved_bodies(*common), removed_velocities(*common))))


LOOKED_AT = 16
"""Runs of a sweep whose starts are looked at before it begins, the first and the last among them."""


def changed_starts(scene_of: Callable[[Any], Scene], parameters: Any, ts: Numeric) -> tuple[str, Any]:
    """What to say of runs that do not start as their scenes describe, and the parameters of the first; or nothing.

    Args:
        scene_of: the scene of a run, from its parameters.
        parameters: known arrays with a leading axis of runs.
        ts: sample times [s].
    """
    n_runs = len(jax.tree.leaves(parameters)[0])
    runs = np.linspace(0, n_runs - 1, min(n_runs, LOOKED_AT)).round().astype(int).tolist()
    if not _geometry_depends_on(scene_of, parameters, ts):
        runs = runs[:1]
    numbers = {run: jax.tree.map(lambda leaf, run=run: np.asarray(leaf)[run], parameters) for run in runs}
    starts = {run: _start_of(scene_of(numbers[run]), ts) for run in runs}
    changes = {run: start.changes for run, start in starts.items() if start is not None and start.changes}
    doubts = {run: start.doubts for run, start in starts.items() if start is not None and start.doubts}
    if not changes and not doubts:
        return "", None
    if not changes:
        first = next(iter(doubts))
        count = "all runs" if len(runs) == 1 else f"{len(doubts)} of {len(runs)} runs that were looked at"
        return f"{count} look like a mistake; of run {first}: {' '.join(doubts[first])}", numbers[first]
    count = f"{len(changes)} of {len(runs)} runs that were looked at do not start as they are described"
    first = next(iter(changes))
    if len(runs) == 1:
        count = "the runs do not start as they are described"
    return f"{count}; of run {first}: {' '.join(changes[first])}", numbers[first]


def _geometry_depends_on(scene_of: Callable[[Any], Scene], parameters: Any, ts: Numeric) -> bool:
    """Whether what is assembled is traced where the parameters are."""
    starts = []

    def traced(numbers):
        try:
            starts.append(known_start(compile_scene(scene_of(numbers)).system, ts))
        except SceneError:
            starts.append(None)

    jax.eval_shape(traced, jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(np.shape(leaf)[1:], jnp.float64), parameters))
    return starts[0] is None


def _start_of(scene: Scene, ts: Numeric) -> KnownStart | None:
    """Of one run; none of one that fails, which its status says."""
    try:
        system = compile_scene(scene).system
        start = known_start(system, ts)
        return None if start is None else start._replace(doubts=(*start.doubts, *doubts_of(scene, system)))
    except SceneError:
        return None

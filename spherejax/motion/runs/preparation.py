"""Scenes, prepared for runs: checked, split into structure and numbers, with method, tolerances and start.

That takes several times longer than the motion itself, so each of these functions is remembered by the values of its
arguments: a loop that simulates the same numbers again prepares them once. Scenes are compared by value, not by
identity: a number that was changed, in a dictionary or within an array, makes another scene. What depends on traced
numbers, or is asked for within a trace, is made each time.
"""

from collections.abc import Hashable
from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np

from spherejax.foundations.behind_tracers import known_behind
from spherejax.foundations.checks import is_concrete, is_tracing
from spherejax.foundations.types import Numeric
from spherejax.model.renewal import Compilation, Taken, traced_places
from spherejax.model.scene import Scene
from spherejax.model.system import (
    CompiledScene,
    Structure,
    System,
    compile_scene,
    example_of,
    numbers_apart,
    numbers_renewed,
    traced_numbers,
    with_laws_by_factor,
)
from spherejax.motion.derivatives.known_jacobians import primal_alone
from spherejax.motion.equations.programs import path_of
from spherejax.motion.solvers.automatic import SolverChoice, choice_by_structure, choose_solver
from spherejax.motion.start.doubts import doubts_of
from spherejax.motion.start.jumps import jump_conditions
from spherejax.motion.start.start_now import KnownStart, known_start, usual_start
from spherejax.motion.start.tolerances import Tolerances, component_tolerances, known_tolerances
from spherejax.program_cache import memoized
from spherejax.program_cache.keys import KeyedTree, LruCache, value_key

N_SCENES = 64
"""Prepared scenes that are kept; the least recently used one is evicted."""

N_ANSWERS = 256
"""Choices of methods, tolerances, starts of all of them; 256 of each."""


class PreparedScene:
    """A scene, checked and taken apart.

    Attributes:
        structure: of the system that it calls for, with laws by their factors.
        path: scalar programs or array code.
        known: its numbers that are known, with zeros elsewhere.
        unknown: indices of the others.
        conditions: on the numbers that are traced.
        is_driven: whether the start depends on its time.
        seen: the system with laws by their factors.
        doubts: what looks like a mistake in the scene, in sentences.
        is_explicit_only: whether the method must be an explicit one.
    """

    def __init__(
        self,
        system: Taken,
        seen: Taken,
        scalar: bool | None,
        conditions: list,
        doubts: tuple[str, ...] = (),
        numbers: tuple[Structure, Any, tuple[int, ...]] | None = None,
    ):
        self._taken, self.taken = system, seen
        self.structure, self.known, self.unknown = numbers_apart(*seen) if numbers is None else numbers
        self.path = path_of(self.structure, scalar)
        self.conditions = conditions
        self.is_driven = example_of(self.structure).is_driven
        # On the array path the linear systems of a stiff method are dense.
        self.is_explicit_only = self.path.scalar is False and scalar is None
        self.doubts = doubts

    @classmethod
    def of(cls, compiled: CompiledScene, scalar: bool | None, doubts: tuple[str, ...] = ()) -> "PreparedScene":
        """A scene that was compiled from the start."""
        system = Taken.apart(compiled.system)
        seen = Taken(*jax.tree.flatten(with_laws_by_factor(system.whole())))
        return cls(system, seen, scalar, compiled.conditions, doubts)

    @cached_property
    def values(self) -> Any:
        """The numbers that are not known, in their order."""
        return traced_numbers(self.taken.leaves) if self.unknown else np.zeros(0)

    @cached_property
    def traced(self) -> Any:
        """The one array that these are the numbers of: that of the scene where it is alone, else their vector."""
        traced = [leaf for leaf in self.taken.leaves if not is_concrete(leaf)]
        # Of arrays of several transformations a vector is traced by all of these, which the arrays do not show.
        return traced[0] if len(traced) == 1 and traced[0].dtype == np.float64 else self.values

    @cached_property
    def values_behind(self) -> Any:
        """The numbers behind what is traced; None where more than one `jax.jvp` or `jax.grad` traces."""
        if not self.unknown:
            return np.zeros(0)
        primal = None if is_tracing() else primal_alone(self.traced)
        return None if primal is None else np.asarray(primal, np.float64).ravel()

    @cached_property
    def seen(self) -> System:
        """The system with laws by their factors."""
        return self.taken.whole()

    def system(self) -> System:
        """What the scene calls for; the caller's own, to write into."""
        return self.system_of(self.leaves())

    def leaves(self) -> list:
        """Those of the system."""
        return [leaf.copy() if type(leaf) is np.ndarray else leaf for leaf in self._taken.leaves]

    def system_of(self, leaves: list) -> System:
        """The system of its leaves."""
        return jax.tree.unflatten(self._taken.tree, leaves)

    @property
    def tree(self) -> Any:
        """The structure of the system."""
        return self._taken.tree

    def compilation(self, reading: KeyedTree) -> Compilation | None:
        """That from which other scenes can be renewed, of the scene that was read."""
        return Compilation.of(reading, self._taken, self.taken)


def _by_scene(scene: PreparedScene, *numbers: Any) -> Hashable | None:
    """The key of what follows from a prepared scene, which is that scene and no equal one, and from numbers."""
    values = None if scene.unknown else value_key(numbers)
    return None if values is None else (scene, values)


def _by_scene_and_time(scene: PreparedScene, ts: Numeric) -> Hashable | None:
    """As `_by_scene`; what is not driven starts alike at any time."""
    return _by_scene(scene, ts) if scene.is_driven else _by_scene(scene)


def prepared(scene: Scene, track_work: bool, scalar: bool | None) -> PreparedScene:
    """A scene, checked and split into structure and numbers.

    Raises:
        SceneError: for a scene that cannot be simulated.
    """
    return prepared_from(KeyedTree(scene), track_work, scalar)


def _by_reading(scene: KeyedTree, *how: Any) -> Hashable | None:
    """The key of a scene that was read."""
    return None if scene.key is None else (scene.key, how)


_lasts = LruCache(N_SCENES)
"""Of each structure of a scene the one that was prepared last: what it was compiled to, and the prepared scene."""


@memoized(N_SCENES, _by_reading)
def prepared_from(scene: KeyedTree, track_work: bool, scalar: bool | None) -> PreparedScene:
    """`prepared` of a scene that was read already: made from the last one of the same structure where that can be, else
    from the start."""
    # User code may do anything with the numbers of a scene.
    is_renewable = scene.user_code == "" and isinstance(scene.tree, Scene)
    # With other numbers that are traced a system may say other things of itself. One of known numbers serves where it
    # says the same, and for the first time within `jax.jit`.
    how = scene.structure, track_work, scalar
    key = (how, traced_places(scene)) if is_renewable else None
    last = (_lasts.find(key) or _lasts.find((how, ()))) if is_renewable else None
    if last is not None:
        compilation, before = last
        renewed = compilation.renewed(scene)
        if renewed is not None:
            doubts = before.doubts if renewed.doubts_remain else doubts_of(scene.tree, renewed.system.whole())
            numbers = numbers_renewed(before.structure, before.known, renewed.seen.leaves, renewed.changed)
            preparation = PreparedScene(renewed.system, renewed.seen, scalar, renewed.conditions, doubts, numbers)
            if scene.key is not None and not is_tracing():
                _lasts.put((how, ()), (compilation.followed_by(scene, renewed), _Before.of(preparation)))
            return preparation
    compiled = compile_scene(scene.tree, track_work=track_work)
    preparation = PreparedScene.of(compiled, scalar, doubts_of(scene.tree, compiled.system))
    # Within a trace of `jax.jit` what JAX computes of known numbers belongs to that.
    if key is not None and not is_tracing():
        compilation = preparation.compilation(scene)
        if compilation is not None:
            _lasts.put(key, (compilation, _Before.of(preparation)))
    return preparation


class _Before(NamedTuple):
    """What is known of a prepared scene, also where some of its numbers are traced: nothing of these is held."""

    structure: Structure
    known: Any
    doubts: tuple[str, ...]

    @classmethod
    def of(cls, prepared: PreparedScene) -> "_Before":
        return cls(prepared.structure, prepared.known, prepared.doubts)


@memoized(N_SCENES)
def prepared_system(system: System, scalar: bool | None) -> PreparedScene:
    """The same of a scene that is compiled already, whose numbers have been checked and doubts been said."""
    return PreparedScene.of(CompiledScene(system, []), scalar)


def chosen_method(scene: PreparedScene, rtol: Any) -> SolverChoice:
    """The method that a scene calls for."""
    by_structure = None if scene.is_explicit_only else choice_by_structure(scene.structure)
    return by_structure or _method_by_numbers(scene, rtol)


@memoized(N_ANSWERS, _by_scene)
def _method_by_numbers(scene: PreparedScene, rtol: Any) -> SolverChoice:
    return choose_solver(scene.seen, rtol, explicit_only=scene.is_explicit_only)


def scene_tolerances(scene: PreparedScene, rtol: Any) -> Tolerances:
    """Tolerances by the scales of a scene."""
    if not scene.unknown and type(rtol) is float:
        tolerances = known_tolerances(scene.structure, scene.known, rtol)
        if tolerances is not None:
            return tolerances
    return _tolerances_of_whole(scene, rtol)


@memoized(N_ANSWERS, _by_scene)
def _tolerances_of_whole(scene: PreparedScene, rtol: Any) -> Tolerances:
    # A run and its derivative are judged by the same numbers: those behind the tracers of `jvp` and `grad`.
    values = scene.values if scene.values_behind is None else scene.values_behind
    behind = known_behind((values, rtol))
    if len(behind) == 1:
        values, known = behind[0]
        theta = scene.known.copy()
        theta[list(scene.unknown)] = values
        tolerances = known_tolerances(scene.structure, theta, known)
        if tolerances is not None:
            return tolerances
    behind = known_behind((scene.seen, rtol))
    system, known = behind[0] if len(behind) == 1 else (scene.seen, rtol)
    return component_tolerances(system, known)


def closed_start(scene: PreparedScene, ts: Numeric) -> KnownStart | None:
    """The consistent start at the first of the times, where it is known, and what is to be said of it. Its arrays are
    others' as well, not to be written to."""
    start = usual_start(scene.structure, scene.known, scene.unknown) or _closed_whole(scene, ts)
    return None if start is None else start._replace(doubts=(*start.doubts, *scene.doubts))


@memoized(N_ANSWERS, _by_scene_and_time)
def _closed_whole(scene: PreparedScene, ts: Numeric) -> KnownStart | None:
    return known_start(scene.seen, ts)


def conditions_of_jumps(scene: PreparedScene, ts: Numeric) -> list:
    """Conditions, traced, that no driver jumps; see `motion.start.jumps`."""
    return _conditions_of_drivers(scene, ts) if scene.is_driven else []


@memoized(N_ANSWERS, _by_scene)
def _conditions_of_drivers(scene: PreparedScene, ts: Numeric) -> list:
    return jump_conditions(scene.seen, ts)

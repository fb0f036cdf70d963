"""A table of prepared scenes: a loop that simulates the same numbers again prepares them once.

Checking a scene, placing its joints, choosing a method, its tolerances and its start take several times longer than the
motion itself. Scenes are compared by value, not by identity: a number that was changed, in a dictionary or within an
array, makes another scene. Scenes with traced numbers, or under `jax.jit`, are prepared each time.
"""

import itertools
from collections.abc import Callable
from typing import Any

import diffrax
import jax
import numpy as np

from spherejax.foundations.behind_tracers import known_behind
from spherejax.foundations.checks import is_concrete
from spherejax.foundations.types import Numeric
from spherejax.model.scene import Scene
from spherejax.model.system import CompiledScene, System, compile_scene, flatten_system, split, with_laws_by_factor
from spherejax.motion.equations.programs import path_of
from spherejax.motion.settings import RunSettings
from spherejax.motion.solvers.automatic import SolverChoice, choose_solver
from spherejax.motion.start.jumps import jump_conditions
from spherejax.motion.start.points_beside import points_beside
from spherejax.motion.start.start_now import KnownStart, known_start
from spherejax.motion.start.tolerances import Tolerances, component_tolerances, controller_for
from spherejax.program_cache.keys import LruCache, lru_get, own, own_arrays, value_key

N_SCENES = 64
"""Prepared scenes in the table; the least recently used one is evicted."""

N_CALLS = 64
"""Calls of `sj.simulate` in the table, of all scenes."""

MOST_TIMES = 4096
"""Sample times of a call that enters the table: 64 calls then hold a few megabytes."""

N_ANSWERS = 16
"""Choices of methods, tolerances and starts that are kept for a scene."""


class PreparedScene:
    """A scene, checked and taken apart.

    Systems and starts are copied for each caller: writing into an array or a dictionary of a run changes no other run.

    Attributes:
        structure: of the system that it calls for, with laws by their factors.
        theta: all numbers of that.
        path: scalar programs or array code.
        known: the numbers that are known, with zeros elsewhere.
        unknown: indices of the others.
        conditions: on the numbers that are traced.
    """

    def __init__(self, compiled: CompiledScene, scalar: bool | None, scene: Scene | None = None):
        self._system = own_arrays(compiled.system)
        self._leaves, self._tree = jax.tree.flatten(self._system)
        self._seen = with_laws_by_factor(self._system)
        self.structure, self.theta = flatten_system(self._seen)
        self.path = path_of(self.structure, scalar)
        self.known, self.unknown = (self.theta, ()) if is_concrete(self.theta) else split(self._seen)
        self.conditions = compiled.conditions
        # On the array path the linear systems of a stiff method are dense.
        self._explicit_only = self.path.scalar is False and scalar is None
        self._answers = LruCache(N_ANSWERS)
        # Of a scene that is compiled already they have been said.
        self._doubts = () if scene is None else points_beside(scene, self._system)

    def system(self) -> System:
        """What the scene calls for."""
        return self.system_of(self.leaves())

    def leaves(self) -> list:
        """Those of the system."""
        return list(map(own, self._leaves))

    def system_of(self, leaves: list) -> System:
        """The system of its leaves."""
        return jax.tree.unflatten(self._tree, leaves)

    def choice(self, rtol: Any) -> SolverChoice:
        """The method that it calls for."""
        return self._once("choice", (rtol,), lambda: choose_solver(self._seen, rtol, explicit_only=self._explicit_only))

    def tolerances(self, rtol: Any) -> tuple[Tolerances, diffrax.PIDController]:
        """Tolerances by its scales, and the step-size control with them."""

        def found() -> tuple[Tolerances, diffrax.PIDController]:
            # A run and its derivative are judged by the same numbers: those behind the tracers of `jvp` and `grad`.
            seen = known_behind((self._seen, rtol))
            system, known = seen[0] if len(seen) == 1 else (self._seen, rtol)
            tolerances = component_tolerances(system, known)
            return tolerances, controller_for(self.structure, tolerances.rtol, tolerances.atol)

        return self._once("tolerances", (rtol,), found)

    def start(self, ts: Numeric) -> KnownStart | None:
        """The consistent start, where it is known."""
        times = (ts,) if self._system.is_driven else ()  # what is not driven starts alike at any time
        found = self._once("start", times, lambda: known_start(self._seen, ts))
        if found is None:
            return None
        return found._replace(assembly=own_arrays(found.assembly), doubts=(*found.doubts, *self._doubts))

    def jump_conditions(self, ts: Numeric) -> list:
        """Conditions, traced, that no driver jumps; see `motion.start.jumps`."""
        if not self._system.is_driven:
            return []
        return self._once("jumps", (ts,), lambda: jump_conditions(self._seen, ts))

    def _once(self, what: str, numbers: tuple, make: Callable[[], Any]) -> Any:
        key = None if self.unknown else value_key((what, numbers))
        return lru_get(self._answers, key, make)


def prepared(scene: Scene, track_work: bool, scalar: bool | None) -> PreparedScene:
    """A scene, checked and split into structure and numbers; from the table where one with equal values is in it.

    Raises:
        SceneError: for a scene that cannot be simulated.
    """
    key = value_key((scene, track_work, scalar))
    return lru_get(_scenes, key, lambda: PreparedScene(compile_scene(scene, track_work=track_work), scalar, scene))


def prepared_system(system: System, scalar: bool | None) -> PreparedScene:
    """The same of a scene that is compiled already, whose numbers have been checked."""
    key = value_key((system, scalar))
    return lru_get(_scenes, key, lambda: PreparedScene(CompiledScene(system, []), scalar))


def remembered_call(scene: Scene, ts: Any, settings: RunSettings, make: Callable[[], Any]) -> Any:
    """The prepared call of `sj.simulate` with equal scene, times and settings, from the table; else what `make` makes.

    A call with traced values, or with values that cannot be compared, is made each time. One that raises an error is
    not entered.
    """
    if not isinstance(ts, np.ndarray | jax.Array) or ts.size > MOST_TIMES:
        return make()
    return lru_get(_calls, value_key((scene, ts, settings.parts)), make)


def remembered_stepper(key: Any, make: Callable[[], Any]) -> Any:
    """What the steps of `sj.advance` are made with, from the table; else what `make` returns."""
    return lru_get(_steppers, key, make)


class _Mark:
    """Stands for a leaf of the arguments of `again`."""

    __slots__ = ("place",)

    def __init__(self, place: int):
        self.place = place


def again(make: Callable[..., Any]) -> Callable[..., Any]:
    """A function that puts leaves of its arguments into a pytree, remembered: from its third call on the leaves go
    straight to their places, where making an object of many fields costs more than all that is in them.

    Args:
        make: puts leaves of its arguments in places that do not depend on their values. Of one that has other leaves as
            well nothing is remembered.
    """
    known: list = []
    calls = itertools.count()

    def made(*arguments: Any) -> Any:
        if next(calls) == 0:  # most are called once
            return make(*arguments)
        leaves, structure = jax.tree.flatten(arguments)
        for places, tree, of in known:
            if of == structure:
                return jax.tree.unflatten(tree, [leaves[place] for place in places])
        # Marks take the places of the leaves; what is static is the same for all.
        marks = map(_Mark, range(len(leaves)))
        found, tree = jax.tree.flatten(make(*jax.tree.unflatten(structure, marks)))
        if all(isinstance(leaf, _Mark) for leaf in found):
            known[:] = [([mark.place for mark in found], tree, structure)]
        return make(*arguments)

    return made


_scenes, _calls, _steppers = LruCache(N_SCENES), LruCache(N_CALLS), LruCache(N_SCENES)

"""Scenes that differ in numbers alone, and what their cycles are integrated with."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.model.system import Structure, System, compile_scene, flatten_system
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import path_of, program_for
from spherejax.motion.equations.projection import corrected
from spherejax.motion.integration.lanes import LaneOutcome
from spherejax.motion.integration.problem import Plan, RunMethod
from spherejax.motion.integration.spans import Jobs, over_spans
from spherejax.motion.runs.simulate import choice_for, tolerances_of
from spherejax.motion.runs.traced_functions import built, known_build
from spherejax.motion.settings import RunSettings, check_tolerances
from spherejax.program_cache import cached_jit
from spherejax.studies.linear.tangent import Geometry, held, held_along, masses, size_of

N_CLOSING = 4
"""Newton steps onto the constraints; each doubles the digits of a state that is off by a step of the shooting."""


class Family:
    """Scenes of one builder that differ in numbers.

    Args:
        build: makes a scene from numbers, by keyword; it is traced.
        values: the numbers of one of them, by name; none for a single scene.
        rtol, solver, max_steps: as in `simulate`.

    Attributes:
        names: of the numbers.
        values: those of the example.
        structure: of all systems.
        example: the system at `values`.
    """

    def __init__(self, build: Callable[..., Scene], values: Mapping[str, float], *, rtol, solver, max_steps):
        check_tolerances(rtol, None)
        self.build, self.names, self.values = build, tuple(values), dict(values)
        self.example: System = compile_scene(self.scene(values)).system
        if not is_concrete(flatten_system(self.example)[1]):
            raise SceneError("cycles are looked for with numbers that are known; call it outside of jit, vmap and grad")
        if self.example.sampled_forces:
            # The number of the coming sample is a part of the state: it grows from period to period.
            raise SceneError(
                f"force {self.example.sampled_forces[0]!r} samples at instants of its own: cycles of such mechanisms "
                "are not looked for. Simulate until the motion repeats itself (sj.simulate); or replace the element "
                "for this study by one that acts at all times, a sampled controller by sj.PID"
            )
        self._numbers = None
        if self.names:
            shapes = {name: jax.ShapeDtypeStruct((), jnp.float64) for name in self.names}
            known = known_build(build, shapes, False)
            structures: list[Structure] = []
            jax.eval_shape(lambda p: jnp.asarray(_flattened(built(known, p), structures)[0]), shapes)
            self.structure, self._numbers = structures[-1], partial(_numbers_of, known)
        else:
            self.structure, self._theta = flatten_system(self.example)
        self.layout = self.example.layout
        self.choice = choice_for(self.example, rtol, solver)
        self.rtol, self.max_steps = float(rtol), int(max_steps)
        self.tolerances = tolerances_of(self.example, self.rtol, None)
        self.scalar = path_of(self.structure).scalar
        chosen: Any = self.choice.solver
        self.settings = RunSettings(
            self.rtol, solver=chosen, max_steps=self.max_steps, is_solver_named=solver is not None
        )
        self.plan = Plan(self.structure, (), self.scalar)
        self.method = RunMethod.by_tolerances(self.structure, chosen, self.tolerances, self.rtol, self.max_steps)

    def scene(self, values: Mapping[str, float]) -> Scene:
        """The scene of some numbers.

        Raises:
            SceneError: where the builder does not take them.
        """
        try:
            return built(self.build, dict(values))
        except TypeError as error:
            raise SceneError(f"build cannot be called with {', '.join(values)}: {error}") from error

    def theta(self, values: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n t"]:
        """All numbers of the systems, from those of each row."""
        if self._numbers is None:
            return np.broadcast_to(self._theta, (len(values), len(self._theta)))
        return np.asarray(self._numbers(self._by_name(values)))

    def theta_slope(self, values: Float[np.ndarray, " p"], along: Float[np.ndarray, " p"]) -> Float[np.ndarray, " t"]:
        """Derivative of all numbers along a change of those by name."""
        if self._numbers is None:
            return np.zeros_like(self._theta)
        by_name = [self._by_name(each[None]) for each in (values, along)]
        return np.asarray(_numbers_along(self._numbers.args[0], *by_name))[0]

    def _by_name(self, values) -> dict[str, Any]:
        return {name: jnp.asarray(values[:, k]) for k, name in enumerate(self.names)}

    def system(self, theta: Float[np.ndarray, " t"]) -> System:
        """The system of some numbers."""
        return self.structure.system(theta)

    def flown(self, jobs: Jobs, shares: np.ndarray, *, with_rows: bool, cycles: int = 1) -> LaneOutcome:
        """Integrate spans, all at once; see `integration.spans`."""
        jobs = jax.tree.map(jnp.asarray, jobs)
        spans = over_spans(self.plan, self.method, with_rows, cycles, jobs, jnp.asarray(shares))
        return jax.tree.map(np.asarray, spans)

    def looked_at(self, theta, t, y) -> "Looked":
        """States closed, with their constraints, masses and rates; a leading axis of states."""
        found = _looked_at(self.structure, self.scalar, *(jnp.asarray(each) for each in (theta, t, y)))
        return jax.tree.map(np.asarray, found)

    def held_slope(self, theta, t: float, y, slope) -> np.ndarray:
        """Derivatives of the constraints and of their rates along a change of all numbers."""
        return np.asarray(_held_slope(self.structure, self.scalar, *map(jnp.asarray, (theta, t, y, slope))))

    @property
    def knows_time(self) -> bool:
        """Whether anything depends on time; on array code that is not known, and counts as if it did."""
        program = program_for(state_rate, self.structure, self.scalar).scalar
        return program is None or program.reads(1)


class Looked(NamedTuple):
    """What is looked at of states, with a leading axis of states.

    Attributes:
        y: flat states on the constraints.
        geometry: constraints and masses.
        rate: rates of the flat states.
    """

    y: Any
    geometry: Geometry
    rate: Any


@cached_jit(what="the constraints of a cycle")
def _looked_at(structure: Structure, scalar: bool | None, theta, t, y) -> Looked:
    layout = structure.system(theta[0]).layout
    size = size_of(layout)
    close = program_for(corrected, structure, scalar, is_quiet=True)
    rate = program_for(state_rate, structure, scalar)
    here, mass = (program_for(function, structure, scalar, is_quiet=True) for function in (held, masses))
    along = program_for(held_along, structure, scalar, (layout.size, size), is_quiet=True)
    units = jnp.eye(size)[: layout.n_velocity]

    def of_one(state):
        theta, t, y = state
        y = jax.lax.fori_loop(0, N_CLOSING, lambda _, y: close(theta, t, y), y)
        slopes = jax.lax.map(lambda unit: along(theta, t, (y, unit)), units).T
        geometry = Geometry(mass(theta, t, y), *jnp.split(here(theta, t, y), 2), *jnp.split(slopes, 2))
        return Looked(y, geometry, rate(theta, t, y))

    return jax.lax.map(of_one, (theta, t, y))


@cached_jit(what="how the constraints of a cycle change")
def _held_slope(structure: Structure, scalar: bool | None, theta, t, y, slope):
    here = program_for(held, structure, scalar, is_quiet=True)
    return jax.jvp(lambda theta: here(theta, t, y), (theta,), (slope,))[1]


def _flattened(scene: Scene, structures: list[Structure] | None = None):
    compiled = compile_scene(scene)
    structure, theta = flatten_system(compiled.system)
    if structures is not None:
        structures.append(structure)
    legal = jnp.all(jnp.stack([jnp.array(True), *(jnp.all(jnp.asarray(each)) for each in compiled.conditions)]))
    return theta, legal


def _theta_of(build, parameters):
    theta, legal = _flattened(built(build, parameters))
    # A value that is not legal makes a run that is not either, and is told by it.
    return jnp.where(legal, jnp.asarray(theta), jnp.nan)


@cached_jit(what="the numbers of a scene")
def _numbers_of(build, parameters):
    return jax.vmap(partial(_theta_of, build))(parameters)


@cached_jit(what="how the numbers of a scene change")
def _numbers_along(build, parameters, along):
    return jax.vmap(lambda p, dp: jax.jvp(partial(_theta_of, build), (p,), (dp,))[1])(parameters, along)

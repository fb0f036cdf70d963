"""Builders of scenes, compared by the fingerprint of what they compute; see `program_cache.fingerprints`."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.model.captured import captures_explained
from spherejax.model.scene import Scene
from spherejax.model.system import Structure, System, compile_scene, flatten_system
from spherejax.motion.equations.contacts import crossings, memory_after_step
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.start.assembly import as_ideal, assembly_residuals
from spherejax.program_cache.fingerprints import (
    Traced,
    TracedFunction,
    combined,
    known_fingerprint,
    program_fingerprint,
    value_fingerprint,
)

Build = Callable[..., Scene]
"""Makes a scene from the parameters of one run."""


def built(build: Build, parameters: Any) -> Scene:
    """The scene of one run."""
    scene = build(**parameters) if isinstance(parameters, dict) else build(parameters)
    if not isinstance(scene, Scene):
        raise SceneError(f"build must return a Scene; it returned {type(scene).__name__}")
    return scene


def known_build(build: Build, one: Any, track_work: bool, by: tuple[str, ...] = ()) -> TracedFunction:
    """A builder, compared by the fingerprint of its traced program: numbers, their conditions, equations of motion.

    Args:
        build: the builder.
        one: the parameters of one run; only shapes and types matter.
        track_work: whether the work of each joint is integrated.
        by: names of parameters by which derivatives are taken: then rules of derivatives count as well.
    """
    if isinstance(build, TracedFunction):
        return build
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(np.shape(leaf), jnp.result_type(leaf)), one)
    structures: list[Structure] = []
    scenes: list[Scene] = []

    def numbers(parameters):
        scenes[:] = [built(build, parameters)]
        compiled = compile_scene(scenes[0], track_work=track_work)
        structure, theta = flatten_system(compiled.system)
        structures.append(structure)
        return jnp.asarray(theta), [jnp.asarray(condition) for condition in compiled.conditions]

    with captures_explained(scenes):
        traced = [program_fingerprint(numbers, shapes)]
        structure = structures[-1]
        traced.append(_equations(structure, bool(by)))
        if by:
            traced.append(program_fingerprint(_with_slopes(lambda p: numbers(p)[0]), shapes))
    parts = [program.fingerprint for program in traced]
    is_bound = any(program.is_bound for program in traced)
    return TracedFunction.of(build, Traced(combined(*parts), is_bound), is_all=known_fingerprint(structure) is not None)


@lru_cache(maxsize=32)
def _equations(structure: Structure, with_slopes: bool) -> Traced:
    """What the system of a structure is, and what it computes from its numbers, the time, and a state."""
    n_numbers = sum(int(np.prod(shape)) for shape in structure.shapes)
    theta = jax.ShapeDtypeStruct((n_numbers,), jnp.float64)
    system: System = jax.eval_shape(structure.system, theta)
    y = jax.ShapeDtypeStruct((system.layout.size,), jnp.float64)
    evaluated = partial(_evaluated, structure)
    time = jax.ShapeDtypeStruct((), jnp.float64)
    traced = [program_fingerprint(evaluated, theta, time, y)]
    if with_slopes:
        traced.append(program_fingerprint(_with_slopes(lambda all: evaluated(*all)), (theta, time, y)))
    own = value_fingerprint((system, structure.special))
    fingerprints = (program.fingerprint for program in traced)
    return Traced(combined(own, *fingerprints), any(program.is_bound for program in traced))


def _evaluated(structure: Structure, theta, t, y) -> list:
    system = structure.system(theta)
    ideal = as_ideal(system)
    found: list[Any] = [state_rate(system, t, y), assembly_residuals(ideal, t, y[: ideal.layout.size])]
    if system.contact_joints:
        step = y, y, jnp.zeros(len(system.contact_joints))
        found += [crossings(system, t, y), memory_after_step(system, t, step)]
    return found


def _with_slopes(function: Callable) -> Callable:
    """The derivative along some direction."""
    return lambda parameters: jax.jvp(function, (parameters,), (jax.tree.map(jnp.ones_like, parameters),))


# Scenes at points of a grid ----------------------------------------------------------------------------------------


def numbers_fingerprint(build: Build, one: dict[str, Any]) -> str:
    """All numbers of the scene of one run, or why there is none."""
    try:
        structure, theta = flatten_system(compile_scene(built(build, one)).system)
    except SceneError as error:
        return f"SceneError: {error}"
    return combined(value_fingerprint((structure.shapes, structure.special)), np.asarray(theta).tobytes().hex())

"""Builders of scenes, and functions of runs, told by what they compute.

A compiled program is found by the functions that went into it. Python tells functions by where they are in memory, so
that an equal lambda, or a notebook cell that was run again, compiled anew and kept both programs. Here a function is
wrapped with the fingerprint of its traced program, and equal ones are equal.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
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
    combined,
    known_fingerprint,
    program_fingerprint,
    value_fingerprint,
)

Build = Callable[..., Scene]
"""Makes a scene from the parameters of one run."""


@dataclass(frozen=True)
class Known:
    """A function that equals others by what it computes.

    Attributes:
        function: the function itself.
        fingerprint: of what it computes.
        itself: the function again where equal code may stand for different objects; None otherwise.
        is_all: whether the fingerprint tells all there is to tell, in other processes too: no code of a user's own is
            left that has not been traced.
    """

    function: Callable = field(compare=False)
    fingerprint: str
    itself: Callable | None = None
    is_all: bool = True

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """What the function answers."""
        return self.function(*arguments, **named)

    def __cache_key__(self) -> Any:
        """What `fingerprints` takes for the function."""
        return self.fingerprint if self.itself is None and self.is_all else self.function


def known(function: Callable, traced: Traced, is_all: bool = True) -> Known:
    """A function with what is known of it."""
    return Known(function, traced.fingerprint, function if traced.is_bound else None, is_all)


def built(build: Build, parameters: Any) -> Scene:
    """The scene of one run."""
    scene = build(**parameters) if isinstance(parameters, dict) else build(parameters)
    if not isinstance(scene, Scene):
        raise SceneError(f"build must return a Scene; it returned {type(scene).__name__}")
    return scene


def known_build(build: Build, one: Any, track_work: bool, by: tuple[str, ...] = ()) -> Known:
    """A builder with the fingerprint of what is simulated: its numbers, their conditions, and the equations of motion.

    Args:
        build: the builder.
        one: the parameters of one run; only shapes and types matter.
        track_work: whether the work of each joint is integrated.
        by: names of parameters by which derivatives are taken: then rules of derivatives count as well.
    """
    if isinstance(build, Known):
        return build
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(np.shape(leaf), jnp.result_type(leaf)), one)
    structures: list[Structure] = []
    scenes: list[Scene] = []

    def numbers(parameters):
        scenes[:] = [built(build, parameters)]
        compiled = compile_scene(scenes[0], track_work=track_work)
        structure, theta = flatten_system(compiled.system)
        structures.append(structure)
        return jnp.asarray(theta), [jnp.asarray(each) for each in compiled.conditions]

    with captures_explained(scenes):
        traced = [program_fingerprint(numbers, shapes)]
        structure = structures[-1]
        traced.append(_equations(structure, bool(by)))
        if by:
            traced.append(program_fingerprint(_with_slopes(lambda p: numbers(p)[0]), shapes))
    parts = [each.fingerprint for each in traced]
    is_bound = any(each.is_bound for each in traced)
    return known(build, Traced(combined(*parts), is_bound), is_all=known_fingerprint(structure) is not None)


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
    return Traced(combined(own, *(each.fingerprint for each in traced)), any(each.is_bound for each in traced))


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

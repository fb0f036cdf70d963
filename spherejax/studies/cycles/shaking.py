"""A scene one of whose numbers is shaken: a force, a moment or the gravity oscillates about its value."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Number, Numeric
from spherejax.model.numbers import number_at
from spherejax.model.scene import Scene
from spherejax.physics.forces.applied import AppliedWrench

REMEDY = (
    "an input that is shaken is a component of a force or moment of an AppliedWrench, such as 'forces.push.force.z', "
    "or of gravity, such as 'gravity.z'. For what a driver or a road prescribes follow a function that makes the "
    "scene, with an sj.functions.Sine in it: "
    "sj.studies.continuation(build, 'frequency', (1, 20), period=lambda f: 1 / f, outputs=[...])"
)


class Shaken(eqx.Module):
    """value + amplitude sin(2 pi frequency t) direction.

    Attributes:
        value: about which it is shaken, shape (3,).
        amplitude: [unit of the value].
        frequency: [Hz].
        direction: shape (3,).
    """

    value: Numeric
    amplitude: Number
    frequency: Number
    direction: Numeric

    def __call__(self, t: Number) -> Float[Array, "3"]:
        """At time t [s]."""
        wave = self.amplitude * jnp.sin(2 * np.pi * self.frequency * t)
        return jnp.asarray(self.value) + wave * jnp.asarray(self.direction)


def shaken(scene: Scene, path: str) -> Callable[..., Scene]:
    """A function that makes the scene with an input that oscillates, from `amplitude` and `frequency`.

    Shaken gravity is the force of inertia that a shaken frame would have: m times it on each body.

    Raises:
        SceneError: for a path that leads to something else.
    """
    try:
        number = number_at(scene, path)
    except SceneError as error:
        raise SceneError(f"swept_sine: input: {error}") from None
    if number.steps == ("gravity",):
        return _with_gravity(scene, number.index[0])
    is_force = len(number.steps) == 3 and number.steps[0] == "forces" and number.steps[2] in ("force", "moment")
    element: Any = scene.forces[number.steps[1]] if is_force else None
    if not isinstance(element, AppliedWrench):
        raise SceneError(f"swept_sine: input {path!r} cannot be shaken: {REMEDY}")
    name, part = number.steps[1:]
    unit = np.eye(3)[number.index[0]]

    def build(amplitude: Number, frequency: Number) -> Scene:
        given = {"force": element.force, "moment": element.moment}
        given = {
            key: value if isinstance(value, np.ndarray) else getattr(value, "callable", value)
            for key, value in given.items()
        }
        given[part] = Shaken(getattr(element, part), amplitude, frequency, unit)
        wrench = AppliedWrench(element.body, given["force"], given["moment"], element.place, element.in_body_axes)
        return replace(scene, forces={**scene.forces, name: wrench})

    return build


def _with_gravity(scene: Scene, axis: int) -> Callable[..., Scene]:
    unit = np.eye(3)[axis]

    def build(amplitude: Number, frequency: Number) -> Scene:
        more = {}
        for name, body in scene.bodies.items():
            wave = Shaken(np.zeros(3), amplitude * body.mass, frequency, unit)
            more[f"inertia of {name}"] = AppliedWrench(name, wave)
        return replace(scene, forces={**scene.forces, **more})

    return build

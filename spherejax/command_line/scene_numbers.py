"""Numbers of a scene by path, e.g. `bodies.rocker.mass` or `joints.elbow.model.clearance`."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np

import spherejax as sj
from spherejax.files.place import one_of

TOPS = ("bodies", "joints", "forces", "gravity", "ground_points")


def number_at(scene: sj.Scene, path: str) -> np.ndarray:
    """The number, or the array of numbers, at a path.

    Raises:
        SceneError: for a path that leads nowhere, naming what is there.
    """
    found = _follow(scene, _steps(scene, path))
    try:
        return np.asarray(found, np.float64)
    except (TypeError, ValueError):
        raise sj.SceneError(f"{path} is no number but a {type(found).__name__}; it has {_listed(found)}") from None


def with_number(scene: sj.Scene, path: str, value: Any) -> sj.Scene:
    """The scene with another number at a path."""
    steps = _steps(scene, path)
    return eqx.tree_at(lambda s: _follow(s, steps), scene, value)


def _steps(scene: sj.Scene, path: str) -> list[str]:
    """Attributes and keys from the scene to the number; a law's own numbers may be named without the law."""
    words = path.split(".")
    if words[0] not in TOPS and words[0] in scene.bodies:
        words = ["bodies", *words]
    steps, at = [], scene
    while words:
        word = words.pop(0)
        if word not in _names_of(at):
            inner = [name for name in _names_of(at) if word in _names_of(_one(at, name)) and _is_part(_one(at, name))]
            if len(inner) != 1:
                so_far = ".".join(steps)
                known = TOPS if at is scene else _names_of(at)
                raise sj.SceneError(f"{path}: {so_far or 'the scene'} has no {word!r}; {one_of(known, word)}")
            steps.append(inner[0])
            at = _one(at, inner[0])
        steps.append(word)
        at = _one(at, word)
    return steps


def _follow(at: Any, steps: list[str]) -> Any:
    for step in steps:
        at = _one(at, step)
    return at


def _one(at: Any, name: str) -> Any:
    return at[name] if isinstance(at, Mapping) else getattr(at, name)


def _names_of(at: Any) -> list[str]:
    if isinstance(at, Mapping):
        return [str(name) for name in at]
    return [field.name for field in dataclasses.fields(at)] if _is_part(at) else []


def _is_part(at: Any) -> bool:
    return dataclasses.is_dataclass(at) and not isinstance(at, type)


def _listed(found: Any) -> str:
    return ", ".join(_names_of(found)) or "no numbers"

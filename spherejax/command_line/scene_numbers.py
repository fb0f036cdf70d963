"""Numbers of a scene by path, e.g. `bodies.rocker.mass` or `joints.elbow.model.friction.v1`.

The first word may be left out before the name of a body, and everything up to the model of the studied joint: there
`rocker.mass` and `friction.v1` say the same. So may a law in front of its own number, where one law alone has it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import spherejax as sj
from spherejax.files.number_texts import NumberError, number_in
from spherejax.files.units import UnitError, in_si
from spherejax.foundations.errors import one_of

if TYPE_CHECKING:
    from spherejax.files.fields import Context

TOPS = ("bodies", "joints", "forces", "gravity", "ground_points")


class Found(NamedTuple):
    """Where a path leads.

    Attributes:
        steps: attributes and keys from the scene to the number.
        value: what is there; None where a law takes what follows from materials.
        unit: SI unit, or None where it is not known.
    """

    steps: tuple[str, ...]
    value: Any
    unit: str | None


def number_at(scene: sj.Scene, path: str, studied: str | None = None) -> np.ndarray:
    """The number, or the array of numbers, at a path.

    Raises:
        SceneError: for a path that leads nowhere, naming what is there.
    """
    return _numeric(path, _found(scene, path, studied).value)


def with_number(scene: sj.Scene, path: str, value: Any, studied: str | None = None) -> sj.Scene:
    """The scene with another number at a path.

    Raises:
        SceneError: for a path that leads nowhere, or a value of another shape than what is there.
    """
    import equinox as eqx

    steps, own, _ = _found(scene, path, studied)
    shape = () if own is None else _numeric(path, own).shape
    if np.shape(value) != shape:
        raise sj.SceneError(f"{path} is numbers of shape {shape}, not of shape {np.shape(value)}")
    return eqx.tree_at(lambda s: _follow(s, steps), scene, value, is_leaf=lambda leaf: leaf is None)


def with_text(scene: sj.Scene, text: str, studied: str | None = None) -> sj.Scene:
    """The scene with what `--set PATH=VALUE` says; a value is a number, `0.1 mm`, or numbers with commas.

    Raises:
        SceneError: for a path that leads nowhere, a value that is no number, or one of another dimension or shape.
    """
    path, equals, given = text.partition("=")
    if not (equals and path and given):
        raise sj.SceneError(f"--set {text}: write PATH=VALUE, e.g. bodies.rocker.mass=0.03 or clearance=0.1mm")
    path = path.strip()
    try:
        found = _found(scene, path, studied)
        shape = () if found.value is None else _numeric(path, found.value).shape
    except sj.SceneError as error:
        raise sj.SceneError(f"--set {error}") from None
    entries = given.strip().removeprefix("[").removesuffix("]").split(",")
    numbers = np.array([_in_unit(text, entry, found.unit) for entry in entries])
    wanted = int(np.prod(shape, dtype=int))
    if numbers.size != wanted:
        what = "one number" if wanted == 1 else f"{wanted} numbers, with commas between them"
        raise sj.SceneError(f"--set {text}: {numbers.size} given; {path} is {what}")
    return with_number(scene, path, numbers.reshape(shape) if shape else float(numbers[0]), studied)


def _in_unit(text: str, entry: str, unit: str | None) -> float:
    try:
        return number_in(entry.strip())
    except NumberError:
        try:
            return in_si(entry, unit)
        except UnitError as error:
            raise sj.SceneError(f"--set {text}: {error}") from None


def _numeric(path: str, value: Any) -> np.ndarray:
    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError):
        what = "not given" if value is None else f"no number but a {type(value).__name__}"
        raise sj.SceneError(f"{path} is {what}; it has {_listed(value)}") from None


def _found(scene: sj.Scene, path: str, studied: str | None) -> Found:
    """Follow a path, with the units that stand on the way."""
    from spherejax.files.fields import Context

    words = _in_full(scene, path.split("."), studied)
    steps: list[str] = []
    at, unit, context = scene, None, Context(Path(), {}, {}, build=_found, describe=_found)
    while words:
        word = words.pop(0)
        if word not in _names_of(at):
            inner = [name for name in _names_of(at) if word in _names_of(_one(at, name)) and _is_part(_one(at, name))]
            if len(inner) != 1:
                so_far = ".".join(steps)
                known = TOPS if at is scene else _names_of(at)
                raise sj.SceneError(f"{path}: {so_far or 'the scene'} has no {word!r}; {one_of(known, word)}")
            words = [inner[0], word, *words]
            continue
        unit, context = _unit_of(at, word, unit, context)
        steps.append(word)
        at = _one(at, word)
    return Found(tuple(steps), at, unit)


def _in_full(scene: sj.Scene, words: list[str], studied: str | None) -> list[str]:
    """The path from the scene's own parts on."""
    if words[0] in TOPS:
        return words
    if words[0] in scene.bodies:
        return ["bodies", *words]
    model = getattr(scene.joints.get(studied or ""), "model", None)
    known = [name for name in ("model", *_names_of(model)) if model is not None]
    inside = [word for name in _names_of(model) for word in _names_of(getattr(model, name))]
    if words[0] in (*known, *inside):
        return ["joints", str(studied), *(() if words[0] == "model" else ("model",)), *words]
    wrong = f"there is no body {words[0]!r}" + (
        f", and nothing of that name in the model of {studied}" if known else ""
    )
    raise sj.SceneError(f"{'.'.join(words)}: {wrong}; {one_of([*TOPS, *scene.bodies, *known], words[0])}")


def _unit_of(part: Any, name: str, unit: str | None, context: Context) -> tuple[str | None, Context]:
    """The unit of what a part calls `name`, and what the units in it refer to."""
    from spherejax.files.kinds import fields_of
    from spherejax.files.objects import numbers_in_units
    from spherejax.files.parts import Part
    from spherejax.files.quantities import Points

    if isinstance(part, sj.Scene):
        return {"gravity": "m/s^2", "ground_points": "m"}.get(name), context
    if isinstance(part, Mapping):
        return unit, context
    field = fields_of(type(part)).get(name)
    if field is None:
        return None, context
    if isinstance(field, Points):
        return "m", context
    inside = context._replace(words={**context.words, **numbers_in_units(part)})
    return field.unit(inside), field.inside(context) if isinstance(field, Part) else context


def _follow(at: Any, steps: tuple[str, ...]) -> Any:
    for step in steps:
        at = _one(at, step)
    return at


def _one(at: Any, name: str) -> Any:
    return at[name] if isinstance(at, Mapping) else getattr(at, name)


def _names_of(at: Any) -> list[str]:
    if isinstance(at, Mapping):
        return [str(name) for name in at]
    return [field.name for field in dataclasses.fields(at) if field.name[0] != "_"] if _is_part(at) else []


def _is_part(at: Any) -> bool:
    return dataclasses.is_dataclass(at) and not isinstance(at, type)


def _listed(found: Any) -> str:
    return ", ".join(_names_of(found)) or "no numbers"

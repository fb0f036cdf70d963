"""Numbers of a scene by path in options, in units: `--set rocker.mass=30g`; see `spherejax.model.numbers`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

import spherejax as sj
from spherejax.command_line.models import UNITS, USED_BY
from spherejax.command_line.shown import WantedQuantity, wanted
from spherejax.foundations.units.number_texts import NumberError, number_in
from spherejax.foundations.units.units import UnitError, in_si


def number_at(scene: sj.Scene, path: str, studied: str | None = None) -> Any:
    """The number, or the array of numbers, at a path.

    Raises:
        SceneError: for a path that leads nowhere, naming what is there.
    """
    from spherejax.model.numbers import place_at

    value = place_at(scene, path, studied).value
    if value is None:
        raise sj.SceneError(f"{path} is not given; give it a value with --set first")
    return value


def with_number(scene: sj.Scene, path: str, value: Any, studied: str | None = None) -> sj.Scene:
    """The scene with another number at a path.

    Raises:
        SceneError: for a path that leads nowhere, or a value of another shape than what is there.
    """
    from spherejax.model.numbers import place_at, with_entry

    steps, index, own = place_at(scene, path, studied)
    shape = () if own is None else np.shape(own)
    if np.shape(value) != shape:
        raise sj.SceneError(f"{path} is numbers of shape {shape}, not of shape {np.shape(value)}")
    return with_entry(scene, steps, index, value)


UnitOf = Callable[[str], str | None]
"""The SI unit of what a name means; None: not known, any is taken; empty: it has none."""


def unit_of_option(name: str) -> str | None:
    """Of an option of the studied joint; a number of the scene is not known before there is a scene."""
    key = name.replace("-", "_")
    return UNITS.get(key, "") if key in USED_BY else None


def units_in(scene: sj.Scene, studied: str | None) -> UnitOf:
    """Of options, and of the numbers of a scene by their paths."""
    from spherejax.model.numbers import place_at

    def unit(name: str) -> str | None:
        known = unit_of_option(name)
        if known is not None:
            return known
        place = place_at(scene, name, studied)
        from spherejax.files.fields.number_units import unit_at  # it looks at every class that files know

        return unit_at(scene, place.steps)

    return unit


def require_quantities(scene: sj.Scene, texts: Iterable[str], *, units: bool = False) -> list[WantedQuantity]:
    """Judge names of quantities, before what takes long is imported or computed.

    Args:
        scene: the scene.
        texts: quantities, also as sweeps keep them, "peak reaction.elbow". What a sweep counts, "onsets.elbow", is
            left to it.
        units: whether units are understood: "position.rocker.z [mm]".

    Returns:
        The same without units, and the units.

    Raises:
        SceneError: for a name that means nothing, naming those that exist, and for a unit of another dimension.
    """
    from spherejax.motion.equations.quantities import quantity

    found = [wanted(text) if units else WantedQuantity(text) for text in texts]
    named = [one for one in found if one.name.partition(".")[0] not in ("onsets", "time_in_contact")]
    system = sj.equations.compile_scene(scene).system if named else None
    for one in named:
        words = one.name.split(" ")
        while len(words) > 1 and words[0] in ("sensitivity", "final", "peak"):
            words = words[1:]
        assert system is not None
        one.shown(quantity(" ".join(words).strip(), system).unit)
    return found


def with_text(scene: sj.Scene, text: str, studied: str | None = None) -> sj.Scene:
    """The scene with what `--set PATH=VALUE` says; a value is a number, `0.1 mm`, or numbers with commas.

    Raises:
        SceneError: for a path that leads nowhere, a value that is no number, or one of another dimension or shape.
    """
    from spherejax.model.numbers import place_at

    path, equals, given = text.partition("=")
    if not (equals and path and given):
        raise sj.SceneError(f"--set {text}: write PATH=VALUE, e.g. bodies.rocker.mass=0.03 or clearance=0.1mm")
    path = path.strip()
    try:
        found = place_at(scene, path, studied)
    except sj.SceneError as error:
        raise sj.SceneError(f"--set {error}") from None
    from spherejax.files.fields.number_units import unit_at  # it looks at every class that files know

    unit, shape = unit_at(scene, found.steps), () if found.value is None else np.shape(found.value)
    entries = given.strip().removeprefix("[").removesuffix("]").split(",")
    numbers = np.array([_in_unit(text, entry, unit) for entry in entries])
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

"""Units of the numbers of a scene by path, as their fields declare them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from spherejax.files.fields.fields import Context
from spherejax.files.fields.kinds import fields_of
from spherejax.files.fields.objects import numbers_in_units
from spherejax.files.fields.parts import Either, PartField
from spherejax.files.fields.quantities import Points
from spherejax.model.numbers import part_at
from spherejax.model.scene import Scene


def unit_at(scene: Scene, steps: tuple[str, ...]) -> str | None:
    """The SI unit of what is there; None where it is not known."""
    unit, context = None, Context(Path(), {}, {}, build=unit_at, describe=unit_at)
    for i, step in enumerate(steps):
        unit, context = _unit_of(part_at(scene, steps[:i]), step, unit, context)
    return unit


def _unit_of(part: Any, name: str, unit: str | None, context: Context) -> tuple[str | None, Context]:
    """The unit of what a part calls `name`, and what the units in it refer to."""
    if isinstance(part, Scene):
        return {"gravity": "m/s^2", "ground_points": "m"}.get(name), context
    if isinstance(part, (Mapping, tuple, list)):
        return unit, context
    field = fields_of(type(part)).get(name)
    if field is None:
        return None, context
    if isinstance(field, Points):
        return "m", context
    inside = context._replace(words={**context.words, **numbers_in_units(part)})
    within = field.part if isinstance(field, Either) else field
    return field.unit(inside), within.inside(inside) if isinstance(within, PartField) else context

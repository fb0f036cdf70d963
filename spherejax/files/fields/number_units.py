"""Units of the numbers of a scene, or of the system of a run, by path, as their fields declare them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from spherejax.files.fields.fields import Context
from spherejax.files.fields.kinds import fields_of
from spherejax.files.fields.objects import numbers_in_units
from spherejax.files.fields.parts import Either, PartField
from spherejax.files.fields.quantities import Points
from spherejax.foundations.checks import shown
from spherejax.foundations.errors import SceneError
from spherejax.model.numbers import numbers_in, part_at
from spherejax.model.scene import Scene
from spherejax.model.system import System
from spherejax.physics.joints.distance import Distance, DistanceDriver, PlacedDistance, PlacedDistanceDriver
from spherejax.physics.joints.drivers import (
    PlacedPositionDriver,
    PlacedRotationDriver,
    PlacedTranslationDriver,
    PositionDriver,
    RotationDriver,
    TranslationDriver,
)

PLACED: Mapping[type, type] = {
    PlacedDistance: Distance,
    PlacedDistanceDriver: DistanceDriver,
    PlacedPositionDriver: PositionDriver,
    PlacedRotationDriver: RotationDriver,
    PlacedTranslationDriver: TranslationDriver,
}
"""Parts of a system, and the parts of a scene whose fields they keep."""

POSITIONS = frozenset({"place", "places", "origin", "socket_place", "ball_place"})
"""What parts of a system call points on bodies."""

DIRECTIONS = frozenset(
    {"across", "axes", "axis", "direction", "normals", "pointer", "right_angles", "start_quaternion"}
)
"""What they call directions, and turns, all of them of length 1."""


class DescribedNumber(NamedTuple):
    """A number of a scene or of a compiled system, and what it is.

    Attributes:
        name: its path, as sweeps and fits take it of a scene: `"joints.elbow.model.clearance"`.
        part: the part that it belongs to: `"joints.elbow"`.
        unit: in SI; None where nobody has declared one, as in a part of your own.
        value: the number; traced where it is.
    """

    name: str
    part: str
    unit: str | None
    value: Any


def numbers(whole: Scene | System) -> list[DescribedNumber]:
    """What each number is that a run or the equations of motion depend on.

    Args:
        whole: a scene, or the numbers `args` of `sj.ode`. A gradient by either has its slopes as values.

    Returns:
        All numbers in the order of `jax.tree.leaves`, arrays entry by entry.

    Raises:
        SceneError: for anything else.
    """
    if not isinstance(whole, Scene | System):
        raise SceneError(f"numbers are those of a scene, or args of sj.ode(scene), and not of {shown(whole)}")
    return [
        DescribedNumber(each.name, each.part, unit_at(whole, each.steps), value[each.index] if each.index else value)
        for each in numbers_in(whole)
        for value in [part_at(whole, each.steps)]
    ]


def unit_at(whole: Scene | System, steps: tuple[str, ...]) -> str | None:
    """The SI unit of what is there; None where it is not known, as in a part of a user's own."""
    unit, context = None, Context(Path(), {}, {}, build=unit_at, describe=unit_at)
    for i, step in enumerate(steps):
        unit, context = _unit_of(part_at(whole, steps[:i]), step, unit, context)
    return unit


def _unit_of(part: Any, name: str, unit: str | None, context: Context) -> tuple[str | None, Context]:
    """The unit of what a part calls `name`, and what the units in it refer to."""
    if isinstance(part, Scene | System):
        return {"gravity": "m/s^2", "ground_points": "m"}.get(name), context
    if isinstance(part, (Mapping, tuple, list)):
        return unit, context
    field = fields_of(PLACED.get(type(part), type(part))).get(name)
    # Attachments and placed joints are written by nobody: their fields declare no units.
    geometric = "m" if name in POSITIONS else "1" if name in DIRECTIONS else None
    if field is None:
        return geometric, context
    if isinstance(field, Points):
        return "m", context
    inside = context._replace(words={**context.words, **numbers_in_units(part)})
    within = field.part if isinstance(field, Either) else field
    return field.unit(inside) or geometric, within.inside(inside) if isinstance(within, PartField) else context

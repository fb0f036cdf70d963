"""Every physical number of a scene or a run with its unit, as the classes describe themselves."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from spherejax.files.fields.fields import Context, Field
from spherejax.files.fields.kinds import attributes_told, fields_of
from spherejax.files.fields.objects import build, describe, numbers_in_units
from spherejax.files.fields.parts import Either, PartField
from spherejax.files.fields.quantities import Coefficients, Points
from spherejax.foundations.checks import is_concrete
from spherejax.model.scene import Scene
from spherejax.model.system import System
from spherejax.output.plot.reading import kind_of_joint
from spherejax.physics.functions.base import AbstractFunction
from spherejax.physics.joints.joint import AbstractPlacedJoint

MOST_ENTRIES = 12
"""Numbers of an array that are written out; of a longer one shape, smallest and largest."""

PLACED = dict.fromkeys(
    ("places", "place", "socket_place", "ball_place", "origin", "length", "center", "radius"), "m"
) | {"start_quaternion": "1"}
"""Units of a placed joint's geometry, which a run knows in body axes; directions are pure numbers."""

DIRECTIONS = ("axis", "axes", "across", "pointer", "normals", "right_angles", "frame")

PRESCRIBED = {"angle": "rad", "travel": "m", "length": "m", "position": "m"}
"""Units of what placed drivers prescribe by time."""


_SYMBOL = re.compile(r"[A-Za-z]{1,3}(_\w+)?")
"""What a class says of a number that has no more than its letter in the formula."""


class Used(NamedTuple):
    """One number, or what a part is.

    Attributes:
        name: where it stands, e.g. `"joints.elbow.model.clearance"`.
        value: as text.
        unit: SI; empty where nothing says it.
        meaning: what its class says of it.
    """

    name: str
    value: str
    unit: str
    meaning: str


def numbers_of(what: Scene | System) -> list[Used]:
    """All numbers of a scene, or of the system of a run, in the order of their names."""
    context = Context(Path(), {}, {}, build, describe)
    gravity = Used("gravity", written(what.gravity), "m/s^2", "acceleration of gravity, world axes")
    found = [gravity]
    if isinstance(what, Scene):
        found += [Used(f"ground.{name}", written(at), "m", "point") for name, at in what.ground_points.items()]
    for family in ("bodies", "joints", "forces"):
        for name, part in getattr(what, family).items():
            found += _of(f"{family}.{name}", part, context)
    return [*found, *_of("drift", what.drift, context)]


def _of(name: str, made: Any, context: Context) -> Iterator[Used]:
    """An object: what it is, then its numbers, then the objects in it."""
    cls = type(made)
    told, known = _asked(attributes_told, cls), _asked(fields_of, cls)
    yield Used(name, kind_of_joint(made) if isinstance(made, AbstractPlacedJoint) else cls.__name__, "", "")
    inside = context._replace(words={**context.words, **_asked(numbers_in_units, made)})
    for one in fields(made):
        value = getattr(made, one.name, None)
        if one.name.startswith("_"):  # what a class keeps for itself follows from the others
            continue
        meaning = told.get(one.name, "")
        if _SYMBOL.fullmatch(meaning):
            meaning += f", as in the formula of {cls.__name__}"
        yield from _value(f"{name}.{one.name}", value, known.get(one.name), meaning, inside, made)


def _value(name: str, value: Any, field: Field | None, meaning: str, context: Context, owner: Any) -> Iterator[Used]:
    if value is None or (callable(value) and not is_dataclass(value)):
        return
    if isinstance(value, eqx.Module) or (is_dataclass(value) and not isinstance(value, type)):
        part = field.part if isinstance(field, Either) else field
        if isinstance(value, AbstractFunction) and isinstance(owner, AbstractPlacedJoint):
            part = PartField(AbstractFunction, "s", PRESCRIBED.get(name.rpartition(".")[2]))
        yield from _of(name, value, part.inside(context) if isinstance(part, PartField) else context)
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from _value(f"{name}.{key}", each, field, meaning, context, owner)
    elif isinstance(value, bool | str):
        yield Used(name, value if isinstance(value, str) else "true" if value else "false", "", meaning)
    elif isinstance(value, list | tuple) and any(isinstance(each, eqx.Module | str | tuple) for each in value):
        if all(isinstance(each, str) for each in value):
            yield Used(name, ", ".join(value), "", meaning)
            return
        for i, each in enumerate(value):
            yield from _value(f"{name}[{i}]", each, field, meaning, context, owner)
    elif (text := written(value)) is not None:
        unit = (
            _units_of_powers(value, context) if isinstance(field, Coefficients) else _unit(name, field, context, owner)
        )
        yield Used(name, text, "1" if type(value) is int and not unit else unit, meaning)


def _unit(name: str, field: Field | None, context: Context, owner: Any) -> str:
    """The unit that the class states; of a placed joint's geometry, what it is in."""
    unit = "m" if isinstance(field, Points) else None if field is None else field.unit(context)
    if unit is None and isinstance(owner, AbstractPlacedJoint):
        key = name.rpartition(".")[2].partition("[")[0]
        unit = "1" if key in DIRECTIONS else PLACED.get(key)
    return unit or ""


def _units_of_powers(coefficients: Any, context: Context) -> str:
    """Each coefficient of a polynomial has a unit of its own."""
    units = [context.unit(Coefficients.si_of(k)) or "?" for k in range(np.size(coefficients))]
    return ", ".join(units)


def written(value: Any) -> Any:
    """A number or an array as text; None for what is neither, and for what is traced."""
    if not is_concrete(value):
        return None
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError):
        return None
    if not array.size:
        return None
    if array.ndim == 0:
        return f"{float(array):.10g}"
    if array.size > MOST_ENTRIES:
        return f"{array.size} numbers, shape {array.shape}, from {array.min():.6g} to {array.max():.6g}"
    text = np.array2string(array, separator=", ", formatter={"float_kind": lambda x: f"{x:.10g}"}, max_line_width=10**6)
    return " ".join(text.split())


def _asked(question: Callable, what: Any) -> dict:
    """What a class says of itself; nothing where a user's class cannot be asked."""
    try:
        return dict(question(what))
    except (TypeError, ValueError, AssertionError):
        return {}

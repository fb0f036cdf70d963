"""The text of a scene file: every number with its unit in a comment."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import Table

from spherejax.files.fields.fields import Context, Field
from spherejax.files.fields.kinds import fields_of
from spherejax.files.fields.objects import KIND, build, describe, described, numbers_in_units, same
from spherejax.files.fields.parts import Either, PartField
from spherejax.files.fields.quantities import Points, vector
from spherejax.files.scenes.reading import STUDIED, SceneFile
from spherejax.files.scenes.settings import FIELDS as SETTINGS
from spherejax.foundations.errors import SceneError
from spherejax.foundations.units.units import PURE
from spherejax.model.drift import AbstractDriftControl
from spherejax.model.scene import Scene
from spherejax.physics.forces.base import AbstractForce
from spherejax.physics.joints.joint import AbstractJoint

HEAD = (
    'SI units; a text with another unit is checked and converted, e.g. "0.1 mm". World axes for positions at the',
    "start, velocities, and points and axes of joints; body axes, from the center of mass, for points and inertia of",
    "bodies. Quaternions: scalar first. What is left out has its default: gravity is [0, 0, -9.81], joints are ideal;",
    "`spherejax list --kinds` shows the others.",
)
"""What a reader of the file must know."""


def scene_text(file: SceneFile, folder: Path) -> str:
    """The text of a scene file.

    Args:
        file: what it says.
        folder: where it will be: paths of a user's classes are relative to it.
    """
    scene = file.scene
    context = Context(folder, {}, {}, build, describe)
    document = tomlkit.document()
    for line in HEAD:
        document.add(tomlkit.comment(line))
    if file.title:
        document.add("title", tomlkit.item(file.title))
    usual = Scene(scene.bodies, scene.joints, scene.forces, ground_points=scene.ground_points)
    if not same(scene.gravity, usual.gravity):
        document.add("gravity", _item(vector("m/s^2").write(scene.gravity, context), "m/s^2"))
    document.add(tomlkit.nl())
    if not same(scene.drift, usual.drift):
        drift = _described_as("drift", scene.drift, AbstractDriftControl, context)
        document.add("drift", _part(drift, scene.drift, context))
    if scene.ground_points:
        document.add("ground_points", _points(scene.ground_points, context))
    bodies = {name: (_at(f"body {name!r}", described, body, context), body) for name, body in scene.bodies.items()}
    _add_each(document, "bodies", bodies, context)
    joints = {}
    for name, joint in scene.joints.items():
        table = _described_as(f"joint {name!r}", joint, AbstractJoint, context)
        joints[name] = ({**table, STUDIED: True} if name == file.studied else table, joint)
    _add_each(document, "joints", joints, context)
    forces = {
        name: (_described_as(f"force {name!r}", force, AbstractForce, context), force)
        for name, force in scene.forces.items()
    }
    _add_each(document, "forces", forces, context)
    settings = {key: value for key, value in file.settings._asdict().items() if value is not None}
    if settings:
        table = tomlkit.table()
        for key, value in settings.items():
            is_length = key == "accuracy" and isinstance(value, float)
            table.add(key, _item(value, "m" if is_length else SETTINGS[key].unit(context)))
        document.add("simulation", table)
    return tomlkit.dumps(document)


def _add_each(document: Any, key: str, described_objects: Mapping[str, tuple[dict, Any]], context: Context) -> None:
    """`[key.name]` for each object."""
    if not described_objects:
        return
    tables = tomlkit.table(is_super_table=True)
    for name, (values, made) in described_objects.items():
        tables.add(name, _table(values, made, context))
    document.add(key, tables)


def _table(values: Mapping[str, Any], made: Any, context: Context) -> Table:
    """A table: numbers with their units first, then the tables in it."""
    fields = fields_of(type(made))
    words = {name: f"{value:g}" for name, value in values.items() if isinstance(value, float)}
    words |= numbers_in_units(made) if dataclasses.is_dataclass(made) else {}
    inside = context._replace(words={**context.words, **words})
    table = tomlkit.table()
    for name, value in values.items():
        if not isinstance(value, dict):
            table.add(name, _item(value, fields[name].unit(inside) if name in fields else None))
    for name, value in values.items():
        if isinstance(value, dict):
            is_points = isinstance(fields[name], Points)
            within = _units_within(fields[name], inside)
            table.add(name, _points(value, context) if is_points else _part(value, getattr(made, name), within))
    return table


def _units_within(field: Field, context: Context) -> Context:
    """With the units of the argument and the value of a function that the field holds."""
    part = field.part if isinstance(field, Either) else field
    return part.inside(context) if isinstance(part, PartField) else context


def _part(values: Mapping[str, Any], made: Any, context: Context) -> Any:
    """A nested object: one line where it is nothing but its kind."""
    if set(values) == {KIND}:
        return tomlkit.item(values[KIND])
    return _table(values, made, context)


def _points(points: Mapping[str, Any], context: Context) -> Table:
    table = tomlkit.table()
    for name, at in points.items():
        table.add(name, _item(vector("m").write(at, context), "m"))
    return table


def _item(value: Any, unit: str | None) -> Any:
    item = tomlkit.item(value)
    if isinstance(value, Mapping):  # in one line: keys behind a table of its own would be keys of that
        item = tomlkit.inline_table()
        item.update(value)
    if unit is not None and unit != PURE:
        item.comment(unit)
    return item


def _described_as(where: str, made: Any, family: type, context: Context) -> dict[str, Any]:
    return _at(where, lambda one, within: describe(one, family, within), made, context)


def _at(where: str, function: Any, made: Any, context: Context) -> dict[str, Any]:
    """`function(made, context)`; its error says where."""
    try:
        return function(made, context)
    except SceneError as error:
        raise SceneError(f"{where} cannot be written: {error}") from error

"""Scene files: a mechanism described in TOML, as a `Scene`."""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from spherejax.files.fields.fields import Context
from spherejax.files.fields.location import FilePlace, read_toml
from spherejax.files.fields.objects import build, built, describe
from spherejax.files.fields.quantities import Points, vector
from spherejax.files.fields.rotations import read_rotation
from spherejax.files.scenes.settings import SimulationSettings, check_accuracy, read_settings
from spherejax.foundations.errors import SceneError, one_of
from spherejax.model.drift import AbstractDriftControl
from spherejax.model.scene import Scene, check_scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.forces.base import AbstractForce
from spherejax.physics.joints.joint import AbstractJoint

TABLES = ("title", "gravity", "drift", "ground_points", "bodies", "joints", "forces", "simulation")
"""What may stand at the top of a scene file."""

STUDIED = "studied"
"""The mark of the joint whose model is varied."""


class SceneFile(NamedTuple):
    """What a scene file says.

    Attributes:
        scene: the mechanism.
        title: what it is, or empty.
        studied: name of the joint whose model is varied, or None.
        settings: how it is simulated.
    """

    scene: Scene
    title: str = ""
    studied: str | None = None
    settings: SimulationSettings = SimulationSettings()


def load_scene(path: str | PathLike[str], *, allow_code: bool = False) -> Scene:
    """Read a mechanism from a scene file (TOML).

    Numbers are in SI units, or texts with a unit, "0.1 mm", whose dimension is checked. Kinds are the class names in
    kebab-case; `spherejax list --kinds` names them with their arguments. A scene file is data: reading it runs no code,
    unless it is allowed.

    Args:
        path: the file.
        allow_code: run the files that kinds like "my_laws.py:MyForce" name: Python code, with all that you may do on
            this machine. They must be in the scene file's own folder, also when links are followed. A kind
            "package.module:MyForce" is taken from a module that you have imported; none is imported for it.

    Returns:
        The scene; `read_scene_file` also returns the title, the studied joint and the table [simulation].

    Raises:
        SceneError: naming file, line, key and remedy.
    """
    return read_scene_file(path, allow_code=allow_code).scene


def read_scene_file(path: str | PathLike[str], *, allow_code: bool = False) -> SceneFile:
    """Read all that a scene file says.

    Args:
        path: the file.
        allow_code: as in `load_scene`.

    Raises:
        SceneError: naming file, line, key and remedy.
    """
    path = Path(path).expanduser()
    tables, top = read_toml(path)
    for key in tables:
        if key not in TABLES:
            (top / key).fail(f"unknown table or key; {one_of(TABLES, key)}")
    title = tables.get("title", "")
    if not isinstance(title, str):
        (top / "title").fail("is no text")
    context = Context(path.parent, _point_names(tables, top), {}, build, describe, allow_code)
    bodies = _each(tables, "bodies", top, lambda table, place: _body(table, place, context))
    studied = _studied(tables, top)
    joints = _each(tables, "joints", top, lambda table, place: _joint(table, place, context))
    forces = _each(tables, "forces", top, lambda table, place: build(AbstractForce, table, place, context))
    general: dict[str, Any] = {}
    if "gravity" in tables:
        general["gravity"] = vector("m/s^2").read(tables["gravity"], top / "gravity", context)
    if "drift" in tables:
        general["drift"] = build(AbstractDriftControl, tables["drift"], top / "drift", context)
    places = Points().read(tables.get("ground_points", {}), top / "ground_points", context)
    settings = read_settings(tables.get("simulation", {}), top / "simulation", context)
    scene = Scene(bodies, joints, forces, ground_points=places, **general)
    try:
        check_scene(scene)
    except SceneError as error:
        _named_in(str(error), tables, top).fail(str(error))
    check_accuracy(settings.accuracy, scene, top / "simulation" / "accuracy")
    return SceneFile(scene, title, studied, settings)


def _body(table: Any, place: FilePlace, context: Context) -> Body:
    if "rotation" not in table:
        return built(Body, table, place, context)
    if "quaternion" in table:
        (place / "rotation").fail("rotation and quaternion say the same twice; remove one of them")
    quaternion = read_rotation(table["rotation"], place / "rotation", context)
    plain = {key: value for key, value in table.items() if key != "rotation"}
    return built(Body, {**plain, "quaternion": quaternion.tolist()}, place, context)


def _joint(table: Any, place: FilePlace, context: Context) -> AbstractJoint:
    plain = {key: value for key, value in table.items() if key != STUDIED}
    return build(AbstractJoint, plain, place, context)


def _studied(tables: Mapping[str, Any], top: FilePlace) -> str | None:
    """The one joint that is marked."""
    marked = []
    joints = tables.get("joints", {})
    for name, table in joints.items() if isinstance(joints, dict) else ():
        if isinstance(table, dict) and STUDIED in table:
            place = top / "joints" / name / STUDIED
            if not isinstance(table[STUDIED], bool):
                place.fail(f"{table[STUDIED]!r} is not true or false")
            if table[STUDIED]:
                marked.append(name)
                if len(marked) > 1:
                    place.fail(f"{marked[0]!r} is the studied joint already; one model is varied at a time")
    return marked[0] if marked else None


def _each(tables: Mapping[str, Any], key: str, top: FilePlace, read) -> dict[str, Any]:
    """The objects of a table of tables, by name."""
    value, place = tables.get(key, {}), top / key
    if not isinstance(value, dict):
        place.fail(f"is no table; write [{key}.NAME] for each")
    found = {}
    for name, table in value.items():
        if not isinstance(table, dict):
            (place / name).fail(f"is no table; write [{key}.{name}]")
        found[name] = read(table, place / name)
    return found


def _point_names(tables: Mapping[str, Any], top: FilePlace) -> dict[str, tuple[str, ...]]:
    """Names of the points of each body, so that names in joints and forces can be checked where they stand."""
    bodies = tables.get("bodies", {})
    if not isinstance(bodies, dict) or not bodies:
        (top / "bodies" if "bodies" in tables else top).fail("has no body; write [bodies.NAME] with mass and inertia")
    for name in bodies:
        if "." in name or name == GROUND:
            reason = "is taken by the world" if name == GROUND else "has a dot, which parts body and point"
            (top / "bodies" / name).fail(f"the name {name!r} {reason}; take another")
    places = {GROUND: tables.get("ground_points", {})}
    for name, table in bodies.items():
        places[name] = table.get("points", {}) if isinstance(table, dict) else {}
    return {name: tuple(points) if isinstance(points, dict) else () for name, points in places.items()}


def _named_in(message: str, tables: Mapping[str, Any], top: FilePlace) -> FilePlace:
    """The table of the first joint, force or body that a message names in quotes."""
    for key in ("joints", "forces", "bodies"):
        for name in tables.get(key, {}):
            if f"{key.removesuffix('s').replace('bodie', 'body')} {name!r}" in message:
                return top / key / name
    return top

"""Which mechanism a command is about: a scene of the gallery, or a file."""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import spherejax as sj
from spherejax.command_line.catalog import ALIASES, JOINTS, SCENES, USUAL, Usual
from spherejax.command_line.models import USED_BY, model_from
from spherejax.command_line.robots import LOADERS, add_robot_options, refuse_robot_options, robot_of
from spherejax.command_line.scene_numbers import with_text
from spherejax.foundations.errors import one_of

SUFFIXES = {
    ".toml": "a scene file",
    ".urdf": "a robot description",
    ".xml": "a MuJoCo model",
    ".mjcf": "a MuJoCo model",
}
"""Files that describe a mechanism."""

AS_DESCRIBED = "as described"
"""Stands for the name of a model where the scene's or the file's own models are taken."""


class Chosen(NamedTuple):
    """The mechanism that a command is about.

    Attributes:
        name: of the scene, or of the file without folder.
        title: what the file says that it is, or empty.
        build: the scene with a model of the studied joint; with None as the file or the gallery has it.
        studied: name of the joint whose model is varied, or None.
        settings: what the file says about its simulation.
    """

    name: str
    title: str
    build: Callable[[sj.joints.AbstractSphericalModel | None], sj.Scene]
    studied: str | None
    settings: sj.files.SimulationSettings

    def scene(self, options: argparse.Namespace) -> sj.Scene:
        """The scene with the model and the numbers that the options ask for."""
        scene = self.build(None if options.joint is None else model_from(options))
        for text in options.set:
            scene = with_text(scene, text, self.studied)
        return scene


def add_scene(parser: argparse.ArgumentParser, joint: str = "--of") -> None:
    """The mechanism, and which of its joints is studied: the option `joint`."""
    parser.add_argument(
        "scene",
        type=_scene_name,
        metavar="SCENE",
        help=f"a scene of the gallery ({', '.join(SCENES)}), a scene file (.toml), or a robot description (.urdf, or "
        ".xml of MuJoCo)",
    )
    parser.add_argument(
        joint,
        dest="of",
        metavar="NAME",
        help="the joint that --joint is the model of (default: the studied joint of the scene or file)",
    )
    parser.add_argument(
        "--allow-code",
        action="store_true",
        help='run the Python files that a scene file names, kind = "my_laws.py:MyForce"; they must be in its folder',
    )
    add_robot_options(parser)


def chosen(options: argparse.Namespace, *, many: bool = False) -> Chosen:
    """The mechanism that the options name.

    Args:
        options: of the command.
        many: whether the options of models are of several models at once, instead of the one of `--joint`.

    Raises:
        SceneError: for a file that does not describe a mechanism; for options of a model without `--joint`.
    """
    given = options.scene
    found = _from_gallery(given) if given in SCENES else _from_file(Path(given).expanduser(), options)
    is_robot = Path(given).suffix in LOADERS
    if not is_robot:
        refuse_robot_options(given, options)
    if options.of is not None:
        found = studying(found, options.of)
    if many:
        return found
    if options.joint is None and (options.of is not None or model_name(options) == AS_DESCRIBED):
        _refuse_loose(options, ("friction", "mu", "mu_static") if is_robot and options.friction is not None else ())
    else:
        model_from(options)  # refuses options that the model does not use
    return found


def model_name(options: argparse.Namespace) -> str:
    """What the studied joint is called in titles: the word of `--joint`, or that the scene's own models are taken."""
    if options.joint is not None:
        return options.joint
    return "ideal" if options.scene in SCENES and _is_ideal(SCENES[options.scene]) else AS_DESCRIBED


def studied_in(build: Callable[..., sj.Scene]) -> str | None:
    """The joint that receives the model of a gallery scene."""
    if not _takes_model(build):
        return None
    marker = sj.Ideal()
    joints = build(marker).joints
    return next((name for name, joint in joints.items() if getattr(joint, "model", None) is marker), None)


def _is_ideal(build: Callable[..., sj.Scene]) -> bool:
    """Whether the studied joint is ideal unless another model is given."""
    studied = studied_in(build)
    joint = None if studied is None else build().joints[studied]
    return isinstance(joint, sj.Spherical) and joint.model.is_ideal


def _takes_model(build: Callable[..., sj.Scene]) -> bool:
    return "model" in inspect.signature(build).parameters


def _scene_name(text: str) -> str:
    text = ALIASES.get(text.lower(), text)
    if text not in SCENES and Path(text).suffix not in SUFFIXES:
        files = ", or a file: " + ", ".join(f"{suffix} ({what})" for suffix, what in SUFFIXES.items())
        raise argparse.ArgumentTypeError(f"there is no scene {text!r}; {one_of(SCENES, text)}{files}")
    return text


def _from_gallery(name: str) -> Chosen:
    build = SCENES[name]
    takes_model = _takes_model(build)

    def with_model(model: sj.joints.AbstractSphericalModel | None) -> sj.Scene:
        if model is not None and not takes_model:
            raise sj.SceneError(
                f"{name} has no studied joint; add --of NAME to say which joint --joint is the model of"
            )
        return build(model) if takes_model else build()

    usual = USUAL.get(name, Usual())
    settings = sj.files.SimulationSettings(t1=usual.t1, samples=usual.samples)
    return Chosen(name, "", with_model, studied_in(build), settings)


def _from_file(path: Path, options: argparse.Namespace) -> Chosen:
    file = (
        sj.files.SceneFile(robot_of(path, options))
        if path.suffix in LOADERS
        else sj.files.read_scene_file(path, allow_code=options.allow_code)
    )

    def without_model(model: sj.joints.AbstractSphericalModel | None) -> sj.Scene:
        if model is not None:
            known = one_of(_joints_with_model(file.scene), "")
            raise sj.SceneError(
                f"{path.name} marks no joint with studied = true; add --of NAME to say whose model is meant; {known}"
            )
        return file.scene

    plain = Chosen(path.name, file.title, without_model, None, file.settings)
    return plain if file.studied is None else studying(plain, file.studied)


def studying(found: Chosen, joint: str) -> Chosen:
    """The same mechanism with another studied joint."""

    def with_model(model: sj.joints.AbstractSphericalModel | None) -> sj.Scene:
        scene = found.build(None)
        if joint not in scene.joints:
            raise sj.SceneError(f"--of {joint}: there is no such joint; {one_of(scene.joints, joint)}")
        if joint not in _joints_with_model(scene):
            kind = type(scene.joints[joint]).__name__
            raise sj.SceneError(f"--of {joint}: a {kind} joint has no model; {one_of(_joints_with_model(scene), '')}")
        return scene if model is None else with_joint_model(scene, joint, model)

    return found._replace(build=with_model, studied=joint)


def with_joint_model(scene: sj.Scene, joint: str, model: sj.joints.AbstractSphericalModel) -> sj.Scene:
    """The scene with another model of one joint."""
    from spherejax.files.fields.objects import arguments_of

    given = scene.joints[joint]
    changed = type(given)(**{**arguments_of(given), "model": model})
    return changed_scene(scene, joints={**scene.joints, joint: changed})


def changed_scene(scene: sj.Scene, **changes) -> sj.Scene:
    """The scene with other parts."""
    parts: Mapping = {
        "bodies": scene.bodies, "joints": scene.joints, "forces": scene.forces, "gravity": scene.gravity,
        "ground_points": scene.ground_points, "drift": scene.drift,
    }  # fmt: skip
    return sj.Scene(**{**parts, **changes})


def _joints_with_model(scene: sj.Scene) -> list[str]:
    return [name for name, joint in scene.joints.items() if hasattr(joint, "model")]


def _refuse_loose(options: argparse.Namespace, used: tuple[str, ...]) -> None:
    """Options of a model mean nothing where the file's own model is taken."""
    for name in USED_BY:
        if name not in used and getattr(options, name) is not None:
            flag = "--" + name.replace("_", "-")
            raise sj.SceneError(
                f"{flag} changes nothing without --joint ({', '.join(JOINTS)}): the scene's own models are taken"
            )

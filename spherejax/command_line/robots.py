"""Robot descriptions on the command line: the arguments of `sj.load_urdf` and `sj.load_mjcf` as options."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import spherejax as sj
from spherejax.command_line.numbers import measured_in, number_of

LOADERS = {".urdf": "load_urdf", ".xml": "load_mjcf", ".mjcf": "load_mjcf"}
"""Functions that read robot descriptions, by the ending of the file."""

OPTIONS = {
    "base": (".urdf",),
    "keyframe": (".xml", ".mjcf"),
    "controls": (".xml", ".mjcf"),
    **dict.fromkeys(
        (
            "positions",
            "velocities",
            "ignore",
            "fixed",
            "stops",
            "mimic",
            "least_mass",
            "least_moment",
            "balance_inertia",
        ),
        tuple(LOADERS),
    ),
}
"""The options, and the files that they are for."""

_UNITS = {"positions": ("rad", "m"), "velocities": ("rad/s", "m/s"), "stops": ("N m/rad", "N/m")}
"""Of joints that turn, and of those that slide."""


def add_robot_options(parser: argparse.ArgumentParser) -> None:
    """Options for robot descriptions."""
    group = parser.add_argument_group(
        "robot descriptions (.urdf, .xml)",
        "the arguments of sj.load_urdf and sj.load_mjcf; friction of the joints is --friction LAW",
    )
    group.add_argument("--base", choices=("ground", "free"), help="whether the base stands or flies (.urdf)")
    group.add_argument("--keyframe", metavar="NAME", help="where the motion starts (.xml)")
    group.add_argument("--controls", metavar="NAME=VALUE,...", help="of actuators, as MuJoCo's ctrl (.xml)")
    for name, of in (("positions", "shoulder=30deg,finger=1cm"), ("velocities", "shoulder=0.5")):
        group.add_argument(f"--{name}", metavar="NAME=VALUE,...", help=f"of joints at the start, as {of}")
    group.add_argument("--ignore", metavar="WORD,...", help="what to leave out, as friction,mimic or contacts")
    group.add_argument("--fixed", metavar="NAME,...", help="joints that are held where they start")
    group.add_argument(
        "--stops",
        metavar="WORD=K:E,...",
        help="stiffness of limits, and the restitution of an impact on them where it is not 1, as "
        "turning=500:0.5,slider=100 N/mm,elbow=none",
    )
    group.add_argument(
        "--mimic",
        metavar="WORD=K:C,...",
        help="stiffness and damping by which joints follow others, as turning=50:0.1,sliding=1e4",
    )
    group.add_argument("--least-mass", type=measured_in("kg"), metavar="KG", help="given to bodies with less [kg]")
    group.add_argument(
        "--least-moment", type=measured_in("kg m^2"), metavar="KGM2", help="the same of moments of inertia [kg m^2]"
    )
    group.add_argument(
        "--balance-inertia", action="store_true", default=None, help="replace moments that no body has by their mean"
    )


def robot_of(path: Path, options: argparse.Namespace) -> sj.Scene:
    """The scene of a robot description.

    Raises:
        SceneError: for options that the file has no use for, and for what its reading refuses.
    """
    given: dict[str, Any] = {}
    for name, endings in OPTIONS.items():
        value = getattr(options, name, None)
        if value is None:
            continue
        if path.suffix not in endings:
            raise sj.SceneError(f"{_flag(name)} is for {' and '.join(endings)}; {path.name} has no use for it")
        given[name] = _READ[name](_flag(name), value) if name in _READ else value
    units = {}
    for name in _UNITS.keys() & given.keys():
        given[name], units[name] = given[name]
    if options.joint is None and options.friction is not None:
        from spherejax.command_line.models import friction_law

        given["friction"] = friction_law(options)
    scene = getattr(sj, LOADERS[path.suffix])(path, **given)
    for name, of_joints in units.items():
        _check_units(_flag(name), scene, of_joints)
    return scene


def refuse_robot_options(scene: str, options: argparse.Namespace) -> None:
    """Raise `SceneError` where an option for robots meets a scene that is none."""
    for name in OPTIONS:
        if getattr(options, name, None) is not None:
            raise sj.SceneError(f"{_flag(name)} is for robot descriptions ({', '.join(LOADERS)}), and {scene} is none")


def _flag(name: str) -> str:
    return "--" + name.replace("_", "-")


def _words(flag: str, text: str) -> tuple[str, ...]:
    words = tuple(word.strip() for word in text.split(","))
    if not all(words):
        raise sj.SceneError(f"{flag} {text}: a name is missing between commas")
    return words


def _pairs(flag: str, text: str) -> Iterator[tuple[str, str]]:
    for part in _words(flag, text):
        name, equals, value = (word.strip() for word in part.partition("="))
        if not (name and equals and value):
            raise sj.SceneError(f"{flag} {text}: {part!r} is no NAME=VALUE")
        yield name, value


def _measured(flag: str, text: str, value: str, units: tuple[str, ...]) -> tuple[float, str | None]:
    """A number in SI units, and the first of some units that the text has, or None for a number alone."""
    if not any(map(str.isalpha, value.replace("e", "").replace("E", ""))):
        return number_of(flag, text, value), None
    for unit in units:
        try:
            return measured_in(unit)(value), unit
        except (argparse.ArgumentTypeError, sj.SceneError):
            pass
    unit = f", with a unit of {' or '.join(units)} or without" if units else " without a unit, in SI"
    raise sj.SceneError(f"{flag} {text}: {value!r} must be a number{unit}")


def _of_joints(flag: str, text: str) -> tuple[dict[str, float], dict[str, str]]:
    """Numbers by joint, and the units of those that have one."""
    values, units = {}, {}
    for name, value in _pairs(flag, text):
        values[name], unit = _measured(flag, text, value, _UNITS[flag.removeprefix("--")])
        if unit is not None:
            units[name] = unit
    return values, units


def _check_units(flag: str, scene: sj.Scene, units: dict[str, str]) -> None:
    """Raise `SceneError` where a joint that turns is given a length, or one that slides an angle."""
    for name, unit in units.items():
        joint = scene.joints.get(name.replace(".", "_"))
        units_of: dict[type, str] = dict(zip((sj.Revolute, sj.Prismatic), _UNITS[flag.removeprefix("--")], strict=True))
        own = units_of.get(type(joint))
        if own is None:
            raise sj.SceneError(
                f"{flag}: joint {name!r} is held or has several axes here; give it without a unit, in SI"
            )
        if unit != own:
            raise sj.SceneError(f"{flag}: joint {name!r} is measured in {own}, not in {unit}")


_STIFFNESS = {"turning": ("N m/rad", "N m s/rad"), "sliding": ("N/m", "N s/m")}
"""Units of stiffness and damping."""


def _stops(flag: str, text: str) -> tuple[dict[str, Any], dict[str, str]]:
    """Stiffness, and restitution, by word; and the units of joints by their own names that have one."""
    values: dict[str, Any] = {}
    units: dict[str, str] = {}
    for name, value in _pairs(flag, text):
        if value == "none":
            values[name] = None
            continue
        is_word = name in _STIFFNESS
        stiffness, colon, restitution = (word.strip() for word in value.partition(":"))
        known = _STIFFNESS[name][:1] if is_word else _UNITS["stops"]
        values[name], unit = _measured(flag, text, stiffness, known)
        if colon:
            values[name] = {"stiffness": values[name], "restitution": number_of(flag, text, restitution)}
        if unit is not None and not is_word:
            units[name] = unit
    return values, units


def _controls(flag: str, text: str) -> dict[str, float]:
    return {name: number_of(flag, text, value) for name, value in _pairs(flag, text)}


def _mimic(flag: str, text: str) -> dict[str, dict[str, float]]:
    found = {}
    for name, value in _pairs(flag, text):
        stiffness, colon, damping = (word.strip() for word in value.partition(":"))
        k, c = _STIFFNESS.get(name, ("", ""))
        found[name] = {"stiffness": _measured(flag, text, stiffness, tuple(filter(None, (k,))))[0]}
        if colon:
            found[name]["damping"] = _measured(flag, text, damping, tuple(filter(None, (c,))))[0]
    return found


_READ: dict[str, Callable[[str, str], Any]] = {
    "positions": _of_joints,
    "velocities": _of_joints,
    "ignore": _words,
    "controls": _controls,
    "fixed": _words,
    "stops": _stops,
    "mimic": _mimic,
}
"""How texts are read."""

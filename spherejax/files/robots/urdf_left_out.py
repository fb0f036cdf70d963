"""What a URDF file has that its reading has no place for; nothing of it is dropped in silence."""

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from spherejax.foundations.errors import SceneError

EXTENSIONS = "extensions"
"""The word of `ignore=` that accepts what is left out."""

NOT_READ = {
    "robot": ("material", "transmission"),
    "link": ("visual", "collision"),
    "joint": ("calibration", "safety_controller"),
}
"""Parts of URDF that have no mechanics in a scene: the pages say so, and no file is warned of for them."""

KNOWN = {
    "robot": (("name", "version"), ("link", "joint", "loop_joint")),
    "link": (("name",), ("inertial",)),
    "inertial": ((), ("origin", "mass", "inertia")),
    "joint": (("name", "type"), ("origin", "parent", "child", "axis", "dynamics", "limit", "mimic")),
    "loop_joint": (("name", "type"), ("link1", "link2", "axis")),
    "origin": (("xyz", "rpy"), ()),
    "mass": (("value",), ()),
    "inertia": (("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), ()),
    "parent": (("link",), ()),
    "child": (("link",), ()),
    "axis": (("xyz",), ()),
    "dynamics": (("damping", "friction"), ()),
    "limit": (("lower", "upper", "effort", "velocity"), ()),
    "mimic": (("joint", "multiplier", "offset"), ()),
    "link1": (("link", "xyz", "rpy"), ()),
    "link2": (("link", "xyz", "rpy"), ()),
}
"""Attributes and parts that are read, or known (`version`, `effort`, `velocity`), of each element."""

_TOLERATED = ("robot", "link", "joint", "limit")
"""Elements that other programs extend: what they add is warned of. In others, which are read whole, it is an error."""

_MECHANICAL = (
    "ball_constraint",
    "damper",
    "drake_ignore",
    "force_element",
    "joint",
    "linear_bushing_rpy",
    "linear_spring_damper",
    "prismatic_spring",
    "revolute_spring",
    "spring",
    "torsional_spring",
)
"""Local names of other programs' elements and attributes that have mechanics, e.g. of Drake's `<drake:joint>`."""

_MANY = 6
"""Names that a message lists."""


class RobotWarning(UserWarning):
    """A robot description has something that no scene here has, which was left out, or was read in another way."""


class LeftOut(NamedTuple):
    """Something that is left out.

    Attributes:
        what: its name and place, for people.
        line: in the file.
        is_refused: whether a scene without it would be wrong.
    """

    what: str
    line: int
    is_refused: bool


def tell_left_out(path: Path, found: list[LeftOut], is_accepted: bool) -> None:
    """Say what a file has that the scene does not have.

    Raises:
        SceneError: for what would make another motion.

    Warns:
        RobotWarning: for the rest.
    """
    if is_accepted or not found:
        return
    refused = [one for one in found if one.is_refused]
    leave = f'leave it out with load_urdf(..., ignore=("{EXTENSIONS}",))'
    if refused:
        raise SceneError(
            f"{path}:{refused[0].line}: URDF has no {_listed(refused)}: without it the mechanism would move otherwise, "
            f"or a word is misspelt; correct it, or {leave}"
        )
    warnings.warn(
        f"{path}: left out is what URDF does not have: {_listed(found)}; if that is meant, {leave}",
        RobotWarning,
        stacklevel=5,
    )


def _listed(found: list[LeftOut]) -> str:
    said = list(dict.fromkeys(one.what for one in found))
    lines = {one.what: one.line for one in reversed(found)}
    shown = ", ".join(f"{what} (line {lines[what]})" for what in said[:_MANY])
    return shown + (f" and {len(said) - _MANY} more" if len(said) > _MANY else "")


def left_out_of(root: Any) -> list[LeftOut]:
    """All that is not read of a robot, in the order of the file."""
    return list(_in_element(root, "robot", ""))


def _in_element(node: Any, tag: str, place: str) -> Iterator[LeftOut]:
    attributes, children = KNOWN[tag]
    is_open = tag in _TOLERATED
    for key in node.attrib:
        name = name_of(key, node.nsmap)
        if name not in attributes:
            refused = not is_open or _is_mechanical(name)
            yield LeftOut(f"attribute {name!r} of <{tag}>{place}", node.sourceline or 0, refused)
    for child in node:
        if not isinstance(child.tag, str):  # a processing instruction
            continue
        name = name_of(child.tag, child.nsmap)
        if name in children:
            inner = f" of {name} {child.get('name')!r}" if name in ("link", "joint", "loop_joint") else place
            yield from _in_element(child, name, inner)
        elif name not in NOT_READ.get(tag, ()):
            refused = not is_open or _is_mechanical(name)
            yield LeftOut(f"<{name}>{_content(child)}{place}", child.sourceline or 0, refused)


def _is_mechanical(name: str) -> bool:
    return name.rpartition(":")[2] in _MECHANICAL


def _content(node: Any) -> str:
    """Which part an element is about, and what it says of it, as far as that is short."""
    about = node.get("reference") or node.get("name")
    parts = dict.fromkeys(name_of(child.tag, child.nsmap) for child in node if isinstance(child.tag, str))
    said = ", ".join(list(parts)[:_MANY])
    return (f" of {about!r}" if about else "") + (f" with {said}" if said else "")


def name_of(tag: str, prefixes: Mapping[str | None, str]) -> str:
    """The name of an element or attribute as it is written: `drake:joint`, and plain in a default namespace.

    Other readers of URDF know nothing of namespaces: a default one, `xmlns="http://drake.mit.edu"`, changes no name.
    """
    if not tag.startswith("{"):
        return tag
    address, _, name = tag[1:].partition("}")
    known = [prefix for prefix, one in prefixes.items() if one == address]
    return name if None in known or not known else f"{known[0]}:{name}"

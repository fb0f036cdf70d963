"""Reading URDF: links and joints as they are written, before anything is made of them."""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from spherejax.files.fields.rotations import UNTURNED, product, turn_about
from spherejax.files.robots.robot import (
    SLIDING,
    TURNING,
    Edge,
    Link,
    Loop,
    Robot,
    base_of,
    in_other_axes,
    link_name,
    parents_first,
    undotted,
)
from spherejax.files.robots.urdf_left_out import EXTENSIONS, KNOWN, left_out_of, name_of, tell_left_out
from spherejax.files.robots.urdf_loops import KINDS
from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.units.number_texts import NumberError, number_in

_NUMERIC = {
    **dict.fromkeys(("mass", "inertia", "origin", "axis", "dynamics"), None),
    **dict.fromkeys(("link1", "link2"), ("xyz", "rpy")),
    "mimic": ("multiplier", "offset"),
    "limit": ("lower", "upper"),
}
"""Elements and those of their attributes that are numbers, None for all; the library reads them as Python does, which
takes `1_5` for 15."""

_DIRECTED = (*TURNING, *SLIDING, "planar")
"""Types of joints whose axis counts: vendors write zeros for that of a fixed one."""


def read_robot(path: Path, ignore: Collection[str] = ()) -> Robot:
    """The links, joints and loops of a URDF file.

    Args:
        path: the file.
        ignore: what is left out on purpose: loops, extensions.

    Raises:
        SceneError: with file, line and element; for a missing library; for what would be lost.

    Warns:
        RobotWarning: for what is left out.
    """
    root = _root(path)
    tell_left_out(path, left_out_of(root), EXTENSIONS in ignore)
    loops = {} if "loops" in ignore else _loops(path, root)
    links: dict[str, Link] = {}
    edges: dict[str, Edge] = {}
    written: dict[tuple[str, str], str] = {}
    for tag, as_written, line, made, limits in _elements(path, root):
        kept: dict = links if tag == "link" else edges
        name = link_name(as_written) if tag == "link" else undotted(as_written)
        if name in kept:
            first = written[tag, name]
            both = "" if first == as_written else f" (written {first!r} and {as_written!r})"
            raise SceneError(f"{path}:{line}: there are two {tag}s {name!r}{both}; rename one of them")
        written[tag, name] = as_written
        try:
            kept[name] = _link(made) if tag == "link" else _edge(made, limits)
        except (TypeError, ValueError) as error:
            raise SceneError(f"{path}:{line}: {tag} {as_written!r}: {error}") from error
    if not links:
        raise SceneError(f"{path}: has no link; a file that only includes others must be expanded with xacro first")
    base = base_of(path, links, edges)
    for name, loop in loops.items():
        for link in loop.links:
            if link not in links:
                raise SceneError(f"{path}: loop joint {name!r}: there is no link {link!r}; {one_of(links, link)}")
        if name in edges:
            raise SceneError(f"{path}: loop joint {name!r} has the name of a joint; rename one of them")
    return Robot(path, links, parents_first(path, base, edges), base, loops=loops)


def _library() -> tuple[Any, Any, Any]:
    try:
        from lxml import etree  # pyright: ignore[reportAttributeAccessIssue]
        from urdf_parser_py import urdf
        from urdf_parser_py.xml_reflection.core import Path as XmlPath
    except ImportError as error:
        raise SceneError(f"reading URDF needs a library: pip install 'spherejax[urdf]' ({error})") from error
    return etree, urdf, XmlPath


def _root(path: Path) -> Any:
    """The element <robot>, with plain names where a default namespace is all that they have."""
    etree, *_ = _library()
    try:
        root = _parsed(etree, path.read_bytes())
    except OSError as error:
        raise SceneError(f"cannot read {str(path)!r}: {error.strerror or error}") from error
    except etree.XMLSyntaxError as error:
        raise SceneError(f"{path}: is no XML: {error.msg}") from error
    for node in root.iter(etree.Element):
        name = name_of(node.tag, node.nsmap)
        local = name.rpartition(":")[2]
        # Drake's own elements may have its prefix; of these it is read.
        if local == name or local in ("loop_joint", "link1", "link2"):
            node.tag = local
    if root.tag != "robot":
        remedy = "; expand it with xacro first" if "xacro" in str(root.tag) else ""
        shown = name_of(root.tag, root.nsmap)
        raise SceneError(f"{path}:{root.sourceline}: begins with <{shown}>, not with <robot>{remedy}")
    return root


def _parsed(etree: Any, text: bytes) -> Any:
    how = {"remove_comments": True, "resolve_entities": False, "no_network": True}
    parser = etree.XMLParser(**how)
    try:
        return etree.fromstring(text, parser)
    except etree.XMLSyntaxError:
        # A prefix without a declaration, as other readers of URDF take it: they know nothing of namespaces.
        if any(entry.type_name != "NS_ERR_UNDEFINED_NAMESPACE" for entry in parser.error_log):
            raise
    return etree.fromstring(text, etree.XMLParser(recover=True, **how))


def _loops(path: Path, root: Any) -> dict[str, Loop]:
    """The <loop_joint> elements.

    Raises:
        SceneError: for one without two links, of another type, or with what is no number.
    """
    found: dict[str, Loop] = {}
    for node in (each for each in root if each.tag == "loop_joint"):
        as_written, kind = str(node.get("name")), node.get("type")
        name, place = undotted(as_written), f"loop_joint {as_written!r}"

        def fail(what: str, place: str = place, line: int = node.sourceline) -> NoReturn:
            raise SceneError(f'{path}:{line}: {place}: {what}, or leave loops out with ignore=("loops",)')

        _check_numbers(path, node, place)
        if name in found:
            fail(f"there are two loop joints {name!r}; rename one of them")
        if kind not in KINDS:
            fail(f"its type is {kind!r}; {one_of(KINDS, str(kind))}")
        # Some exporters write <link1> twice.
        ends = [child for child in node if child.tag in ("link1", "link2")]
        if len(ends) != 2 or not all(end.get("link") for end in ends):
            fail('needs a <link1 link="..."/> and a <link2 link="..."/>')
        axes = node.findall("axis")
        axis = _vector(axes[0].get("xyz") if axes else None, (1.0, 0.0, 0.0))
        places = [_vector(end.get("xyz"), (0.0, 0.0, 0.0)) for end in ends]
        angles = [_vector(end.get("rpy"), (0.0, 0.0, 0.0)) for end in ends]
        if any(vector.shape != (3,) for vector in (axis, *places, *angles)):
            fail("xyz and rpy are three numbers each; correct it")
        if not np.linalg.norm(axis) > 0:
            fail("<axis> must be a direction; give a vector that is not zero")
        found[name] = Loop(
            KINDS[kind],
            (link_name(ends[0].get("link")), link_name(ends[1].get("link"))),
            (places[0], places[1]),
            (_turn(angles[0]), _turn(angles[1])),
            axis / np.linalg.norm(axis),
        )
    return found


def _vector(text: str | None, otherwise: tuple[float, ...]) -> np.ndarray:
    return np.array(otherwise if text is None else [float(word) for word in text.split()], np.float64)


def _elements(path: Path, root: Any) -> Iterator[tuple[str, str, int, Any, tuple[float, float]]]:
    """Tag, name, line, parsed object, and least and largest position of each link and joint."""
    etree, urdf, XmlPath = _library()
    for node in root:
        if node.tag not in ("link", "joint"):
            continue
        for child in list(node):
            if child.tag not in KNOWN[node.tag][1]:
                node.remove(child)
        name, line = node.get("name"), node.sourceline
        _check_numbers(path, node, f"{node.tag} {name!r}")
        limits = _limits_taken(node)
        kind = {"link": urdf.Link, "joint": urdf.Joint}[node.tag]
        try:
            _leave_known(node, kind)
            made = kind.from_xml(node, XmlPath(node.tag, tree=etree.ElementTree(root)))
        except Exception as error:  # the library's own ParseError, and Python's of numbers
            what = " ".join(str(error).split())
            raise SceneError(f"{path}:{line}: {node.tag} {name!r}: {what}") from error
        yield node.tag, str(name), line, made, limits


def _check_numbers(path: Path, node: Any, place: str) -> None:
    for part in node.iter(*_NUMERIC):
        for key, text in part.attrib.items():
            if (numeric := _NUMERIC[part.tag]) is not None and key not in numeric:
                continue
            try:
                for word in text.split():
                    number_in(word)
            except NumberError as error:
                raise SceneError(f"{path}:{part.sourceline}: {place}: {part.tag} {key}={text!r}: {error}") from None


def _limits_taken(node: Any) -> tuple[float, float]:
    """Least and largest position, 0 where one is left out (URDF's default); the element is removed.

    The library asks for an effort and a velocity beside them, which do not count here and which vendors leave out.
    """
    lower, upper = -np.inf, np.inf
    for limit in node.findall("limit"):
        lower, upper = (float(limit.get(key, "0")) for key in ("lower", "upper"))
        node.remove(limit)
    return lower, upper


def _leave_known(node: Any, kind: Any) -> None:
    """Remove what the library has no place for, which it would tell standard error about.

    Raises:
        ValueError: for an element that is there twice: the library would read the first and drop the others.
    """
    known = kind.XML_REFL
    for attribute in set(node.attrib) - set(known.attribute_map):
        del node.attrib[attribute]
    seen = set()
    for child in list(node):
        if child.tag not in known.element_map:
            node.remove(child)
            continue
        if child.tag in seen:
            raise ValueError(f"has more than one <{child.tag}>; leave the one that counts")
        seen.add(child.tag)
        inner = getattr(known.element_map[child.tag].value_type, "type", None)
        if hasattr(inner, "XML_REFL"):
            _leave_known(child, inner)


def _link(made: Any) -> Link:
    inertial = made.inertial
    if inertial is None:
        return Link(0.0, np.zeros(3), np.zeros((3, 3)))
    if inertial.inertia is None:
        raise ValueError("has a mass but no <inertia>")
    moments = np.array(inertial.inertia.to_matrix(), np.float64)
    quaternion, center = _origin(inertial.origin)
    return Link(float(inertial.mass), center, in_other_axes(quaternion, moments))


def _edge(made: Any, limits: tuple[float, float]) -> Edge:
    quaternion, place = _origin(made.origin)
    is_directed = made.type in _DIRECTED
    axis = np.array((is_directed and made.axis) or (1.0, 0.0, 0.0), np.float64)
    length = np.linalg.norm(axis)
    if not 0 < length < np.inf:
        raise ValueError("<axis> must be a direction; give a vector that is not zero")
    damping, friction = (
        0.0 if made.dynamics is None else float(getattr(made.dynamics, name) or 0.0) for name in ("damping", "friction")
    )
    follows, multiplier, offset = None, 1.0, 0.0
    if made.mimic is not None and made.type in (*TURNING, *SLIDING):
        follows = undotted(made.mimic.joint)
        multiplier = 1.0 if made.mimic.multiplier is None else float(made.mimic.multiplier)
        offset = float(made.mimic.offset or 0.0)
    # A continuous joint has no limits, whatever is written.
    lower, upper = limits if made.type in ("revolute", *SLIDING) else (-np.inf, np.inf)
    return Edge(
        made.type,
        link_name(made.parent),
        link_name(made.child),
        quaternion,
        place,
        axis / length,
        damping,
        friction,
        follows,
        multiplier,
        offset,
        lower,
        upper,
    )


def _origin(origin: Any) -> tuple[np.ndarray, np.ndarray]:
    """Quaternion and place of an <origin>."""
    angles = (None if origin is None else origin.rpy) or (0.0, 0.0, 0.0)
    place = (None if origin is None else origin.xyz) or (0.0, 0.0, 0.0)
    return _turn(angles), np.array(place, np.float64)


def _turn(angles: Sequence[float] | np.ndarray) -> np.ndarray:
    """The quaternion of roll, pitch and yaw: turns about the axes x, y and z that stay."""
    quaternion = UNTURNED
    for axis, angle in zip(np.eye(3), angles, strict=True):
        quaternion = product(turn_about(axis, float(angle)), quaternion)
    return quaternion

"""Robot descriptions as they are written (URDF): links and joints, and where they are when each joint has a position.

URDF says where a joint is in the axes of its parent link; the axes of the child link are the joint's own.

A name with dots is read with underscores in their place, for "body.point" names a point here; a link "ground" is read
as "ground_link", for the ground is the body that does not move.
"""

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from spherejax.files.number_texts import NumberError, number_in
from spherejax.files.rotations import UNTURNED, product, turn_about, turned
from spherejax.foundations.errors import SceneError, one_of
from spherejax.physics.bodies import GROUND

TURNING, SLIDING, FREE = ("revolute", "continuous"), ("prismatic",), ("floating", "planar")
"""Types of joints by how they move; a fixed joint does not."""

_READ = {"link": ("inertial",), "joint": ("parent", "child", "origin", "axis", "dynamics", "mimic", "limit")}
"""What counts of a description; shapes, materials, transmissions and plugins do not."""

_NUMERIC = {
    **dict.fromkeys(("mass", "inertia", "origin", "axis", "dynamics"), None),
    "mimic": ("multiplier", "offset"),
    "limit": ("lower", "upper"),
}
"""Elements and those of their attributes that are numbers, None for all; the library reads them as Python does, which
takes `1_5` for 15."""

_MIMICKED = 1e-9
"""How far a given position of a joint that mimics another may be from where that puts it: what printing rounds."""

_DIRECTED = (*TURNING, *SLIDING, "planar")
"""Types of joints whose axis counts: vendors write zeros for that of a fixed one."""


class Link(NamedTuple):
    """A link as described.

    Attributes:
        mass: [kg], 0 for a link without inertia.
        center: center of mass, link axes [m].
        inertia: about the center of mass, link axes [kg m^2], shape (3, 3).
    """

    mass: float
    center: np.ndarray
    inertia: np.ndarray


class Edge(NamedTuple):
    """A joint as described.

    Attributes:
        kind: its type.
        parent: name of the link that carries it.
        child: name of the link that it moves.
        quaternion: turns the joint's axes into the parent's.
        place: of the joint in the parent's axes [m].
        axis: unit vector in the joint's axes.
        damping: [N m s/rad] or [N s/m].
        friction: [N m] or [N].
        follows: name of the joint that it mimics, or None.
        multiplier: of that joint's position.
        offset: its own position where that joint's is 0 [rad or m].
        lower: least position [rad or m]; minus infinity without one.
        upper: largest position [rad or m].
    """

    kind: str
    parent: str
    child: str
    quaternion: np.ndarray
    place: np.ndarray
    axis: np.ndarray
    damping: float
    friction: float
    follows: str | None
    multiplier: float
    offset: float
    lower: float
    upper: float


class Robot(NamedTuple):
    """A tree of links.

    Attributes:
        path: the file.
        links: by name.
        edges: joints by name, parents first.
        base: name of the link without a parent.
    """

    path: Path
    links: dict[str, Link]
    edges: dict[str, Edge]
    base: str


class Pose(NamedTuple):
    """Where a link is and how it moves.

    Attributes:
        quaternion: link axes to world axes.
        place: of the link's origin, world axes [m].
        velocity: of the origin, world axes [m/s].
        angular_velocity: world axes [rad/s].
    """

    quaternion: np.ndarray
    place: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray


def read_robot(path: Path) -> Robot:
    """The links and joints of a URDF file.

    Raises:
        SceneError: with file, line and element; for a missing library.
    """
    links: dict[str, Link] = {}
    edges: dict[str, Edge] = {}
    written: dict[tuple[str, str], str] = {}
    for tag, as_written, line, made, limits in _elements(path):
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
    base = _base(path, links, edges)
    return Robot(path, links, _parents_first(path, base, edges), base)


def undotted(name: str) -> str:
    """A name as scenes have it."""
    return name.replace(".", "_")


def link_name(name: str) -> str:
    """The name of a link as scenes have it."""
    return f"{GROUND}_link" if name == GROUND else undotted(name)


def with_fixed(robot: Robot, fixed: Collection[str], positions: Mapping[str, float]) -> Robot:
    """The robot with some joints held where they are at the start."""
    edges = {}
    for name, edge in robot.edges.items():
        if name in fixed:
            q, axis = positions.get(name, 0.0), edge.axis
            if edge.kind in TURNING:
                edge = edge._replace(quaternion=product(edge.quaternion, turn_about(axis, q)))
            if edge.kind in SLIDING:
                edge = edge._replace(place=edge.place + q * turned(edge.quaternion, axis))
            edge = edge._replace(kind="fixed", follows=None)
        edges[name] = edge
    return robot._replace(edges=edges)


def with_followers(robot: Robot, given: Mapping[str, float], what: str) -> dict[str, float]:
    """Positions [rad or m] or velocities of joints by name, with those of joints that mimic others.

    Raises:
        SceneError: for a follower that is given something else, and for joints that follow each other in a circle.
    """
    found = dict(given)
    for name in robot.edges:
        chain = [name]
        while (leader := robot.edges[chain[-1]].follows) is not None:
            if leader not in robot.edges:
                raise SceneError(
                    f"{robot.path}: joint {chain[-1]!r} mimics {leader!r}, which is no joint; "
                    + one_of(robot.edges, leader)
                )
            if leader in chain:
                raise SceneError(f"{robot.path}: joints {', '.join(chain)} mimic each other in a circle")
            chain.append(leader)
        for follower in reversed(chain[:-1]):
            edge = robot.edges[follower]
            offset = edge.offset if what == "positions" else 0.0
            value = edge.multiplier * found.get(str(edge.follows), 0.0) + offset
            if follower in given and abs(given[follower] - value) > _MIMICKED * max(1.0, abs(value)):
                raise SceneError(
                    f"{robot.path}: {what}: joint {follower!r} mimics {edge.follows!r} and has {value!r} there, not "
                    f"{given[follower]!r}; leave it out"
                )
            found[follower] = value
    return found


def poses(robot: Robot, positions: Mapping[str, float], velocities: Mapping[str, float], base: Pose) -> dict[str, Pose]:
    """Pose of each link, from that of the base and positions [rad or m] and velocities of joints by name."""
    zero = np.zeros(3)
    found = {robot.base: base}
    for name, edge in robot.edges.items():
        parent = found[edge.parent]
        q, rate = positions.get(name, 0.0), velocities.get(name, 0.0)
        quaternion = product(parent.quaternion, edge.quaternion)
        axis = turned(quaternion, edge.axis)
        arm, spin, slip = turned(parent.quaternion, edge.place), parent.angular_velocity, zero
        if edge.kind in TURNING:
            quaternion, spin = product(quaternion, turn_about(edge.axis, q)), spin + rate * axis
        if edge.kind in SLIDING:
            arm, slip = arm + q * axis, rate * axis
        velocity = parent.velocity + np.cross(parent.angular_velocity, arm) + slip
        found[edge.child] = Pose(quaternion, parent.place + arm, velocity, spin)
    return found


def in_other_axes(quaternion: np.ndarray, tensor: np.ndarray) -> np.ndarray:
    """A tensor, e.g. an inertia, in the axes that a quaternion turns into."""
    rotation = np.stack([turned(quaternion, e) for e in np.eye(3)], axis=1)
    return rotation @ tensor @ rotation.T


def _elements(path: Path) -> Iterator[tuple[str, str, int, Any, tuple[float, float]]]:
    """Tag, name, line, parsed object, and least and largest position of each link and joint."""
    try:
        from lxml import etree  # pyright: ignore[reportAttributeAccessIssue]
        from urdf_parser_py import urdf
        from urdf_parser_py.xml_reflection.core import Path as XmlPath
    except ImportError as error:
        raise SceneError(f"reading URDF needs a library: pip install 'spherejax[urdf]' ({error})") from error
    try:
        parser = etree.XMLParser(remove_comments=True, resolve_entities=False, no_network=True)
        root = etree.fromstring(path.read_bytes(), parser)
    except OSError as error:
        raise SceneError(f"cannot read {str(path)!r}: {error.strerror or error}") from error
    except etree.XMLSyntaxError as error:
        raise SceneError(f"{path}: is no XML: {error.msg}") from error
    if root.tag != "robot":
        remedy = "; expand it with xacro first" if "xacro" in str(root.tag) else ""
        raise SceneError(f"{path}:{root.sourceline}: begins with <{root.tag}>, not with <robot>{remedy}")
    for node in root:
        if node.tag not in _READ:
            continue
        for child in list(node):
            if child.tag not in _READ[node.tag]:
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
    """Quaternion and place of an <origin>: roll, pitch and yaw are turns about the axes x, y and z that stay."""
    roll, pitch, yaw = (None if origin is None else origin.rpy) or (0.0, 0.0, 0.0)
    place = (None if origin is None else origin.xyz) or (0.0, 0.0, 0.0)
    quaternion = UNTURNED
    for axis, angle in zip(np.eye(3), (roll, pitch, yaw), strict=True):
        quaternion = product(turn_about(axis, angle), quaternion)
    return quaternion, np.array(place, np.float64)


def _base(path: Path, links: Mapping[str, Link], edges: Mapping[str, Edge]) -> str:
    """The one link without a parent."""
    parents: dict[str, str] = {}
    for name, edge in edges.items():
        for link in (edge.parent, edge.child):
            if link not in links:
                raise SceneError(f"{path}: joint {name!r}: there is no link {link!r}; {one_of(links, link)}")
        if edge.child in parents:
            raise SceneError(
                f"{path}: link {edge.child!r} has two parents, joints {parents[edge.child]!r} and {name!r}: URDF is a "
                "tree; leave one joint out, write the scene file, and add the loop's joint there"
            )
        parents[edge.child] = name
    bases = [name for name in links if name not in parents]
    if len(bases) != 1:
        what = f"{len(bases)} links without a parent ({', '.join(bases)})" if bases else "no link without a parent"
        raise SceneError(f"{path}: has {what}; a robot has one base link, and joints that lead from it to the others")
    return bases[0]


def _parents_first(path: Path, base: str, edges: Mapping[str, Edge]) -> dict[str, Edge]:
    """Joints in an order in which each one's parent link has been reached.

    With one base and one parent for each other link, a link that is not reached is in a circle.
    """
    ordered: dict[str, Edge] = {}
    reached = [base]
    for link in reached:  # grows while it is walked
        for name, edge in edges.items():
            if edge.parent == link and name not in ordered:
                ordered[name] = edge
                reached.append(edge.child)
    circle = [name for name in edges if name not in ordered]
    if circle:
        raise SceneError(
            f"{path}: joints {', '.join(circle)} go round in a circle; a robot is a tree that begins at {base!r}"
        )
    return ordered

"""Robot descriptions: links and joints as a file has them, and where they are when each joint has a position.

Where a joint is, is told in the axes of its parent link. The child link's axes are the joint's own; in MJCF the joint
may be beside the child's origin.

A name with dots is read with underscores in their place, for "body.point" names a point here; a link "ground" is read
as "ground_link", for the ground is the body that does not move.
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np

from spherejax.files.fields.rotations import product, turn_about, turned
from spherejax.foundations.errors import SceneError, one_of
from spherejax.physics.bodies import GROUND
from spherejax.physics.forces.base import AbstractForce
from spherejax.physics.forces.coupler import AbstractCoordinate

TURNING, SLIDING, FREE = ("revolute", "continuous"), ("prismatic",), ("floating", "planar")
"""Types of joints by how they move; a fixed joint does not."""

_MIMICKED = 1e-9
"""How far a given position of a joint that mimics another may be from where that puts it: what printing rounds."""


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


class Drive(Protocol):
    """An actuator of a joint."""

    @property
    def name(self) -> str:
        """The name of its force element."""
        ...

    def force(self, coordinate: AbstractCoordinate, position: float) -> AbstractForce:
        """The force element along the joint's coordinate, which is 0 where the joint's position is `position`."""
        ...


class Edge(NamedTuple):
    """A joint as described.

    Attributes:
        kind: its type.
        parent: name of the link that carries it.
        child: name of the link that it moves.
        quaternion: turns the child's axes, at position 0, into the parent's.
        place: of the child's origin, at position 0, in the parent's axes [m].
        axis: unit vector in the child's axes.
        damping: [N m s/rad] or [N s/m].
        friction: [N m] or [N].
        follows: name of the joint that it mimics, or None.
        multiplier: of that joint's position.
        offset: its own position where that joint's is 0 [rad or m].
        lower: least position [rad or m]; minus infinity without one.
        upper: largest position [rad or m].
        stiffness: of a spring [N m/rad] or [N/m].
        rest: position at which the spring is slack [rad or m].
        anchor: of the joint in the child's axes [m]; zero in URDF.
        second: of a universal joint, the axis that stays on the child, in its axes.
        slides: of a stack, the axes along which it slides, as rows, in the child's axes; shape (n, 3).
        turns: of a stack, those about which it turns, n = 0 to 2; None: it turns freely.
        anchors: of two hinges, a point on the axis of each, where these are nearest, in the child's axes [m].
        slides_on_child: whether the axes of slides turn with the child, rather than stay on the parent.
        actuators: what drives it.
        parts: single joints that the edge is put together of, by name, for their force elements.
    """

    kind: str
    parent: str
    child: str
    quaternion: np.ndarray
    place: np.ndarray
    axis: np.ndarray
    damping: float = 0.0
    friction: float = 0.0
    follows: str | None = None
    multiplier: float = 1.0
    offset: float = 0.0
    lower: float = -np.inf
    upper: float = np.inf
    stiffness: float = 0.0
    rest: float = 0.0
    anchor: np.ndarray = np.zeros(3)
    second: np.ndarray | None = None
    slides: np.ndarray = np.zeros((0, 3))
    turns: np.ndarray | None = None
    anchors: np.ndarray = np.zeros((0, 3))
    slides_on_child: bool = False
    actuators: tuple[Drive, ...] = ()
    parts: Mapping[str, "Edge"] = MappingProxyType({})


class Loop(NamedTuple):
    """A joint between two links of the tree, which closes a loop.

    Attributes:
        kind: spherical, revolute, prismatic, cylindrical or fixed.
        links: names of the two.
        places: of the joint on each, in its axes [m].
        quaternions: of the joint's axes in those of each link.
        axis: unit vector in the joint's axes.
    """

    kind: str
    links: tuple[str, str]
    places: tuple[np.ndarray, np.ndarray]
    quaternions: tuple[np.ndarray, np.ndarray]
    axis: np.ndarray


class Robot(NamedTuple):
    """A tree of links, and loops in it.

    Attributes:
        path: the file.
        links: by name.
        edges: joints by name, parents first.
        base: name of the link without a parent.
        loader: the function that users call, for remedies.
        loops: joints that close loops, by name.
    """

    path: Path
    links: dict[str, Link]
    edges: dict[str, Edge]
    base: str
    loader: str = "load_urdf"
    loops: Mapping[str, Loop] = MappingProxyType({})


class LinkPose(NamedTuple):
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
                quaternion = product(edge.quaternion, turn_about(axis, q))
                place = edge.place + turned(edge.quaternion, edge.anchor) - turned(quaternion, edge.anchor)
                edge = edge._replace(quaternion=quaternion, place=place)
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


def poses(
    robot: Robot, positions: Mapping[str, Any], velocities: Mapping[str, Any], base: LinkPose
) -> dict[str, LinkPose]:
    """Pose of each link, from that of the base and positions [rad or m] and velocities of joints by name.

    Balls and floating links are where their edges put them; their velocities are three numbers, of the turn in the
    child's axes, and six: of the origin in the parent's axes, then the turn.
    """
    zero = np.zeros(3)
    found = {robot.base: base}
    for name, edge in robot.edges.items():
        parent = found[edge.parent]
        q, rate = positions.get(name, 0.0), velocities.get(name, 0.0)
        quaternion = product(parent.quaternion, edge.quaternion)
        axis = turned(quaternion, edge.axis)
        arm = turned(parent.quaternion, edge.place + turned(edge.quaternion, edge.anchor))
        spin, slip = parent.angular_velocity, zero
        if edge.kind in TURNING:
            quaternion, spin = product(quaternion, turn_about(edge.axis, q)), spin + rate * axis
        if edge.kind in SLIDING:
            arm, slip = arm + q * axis, rate * axis
        if edge.kind == "spherical" and name in velocities:
            spin = spin + turned(quaternion, rate)
        if edge.kind == "floating" and name in velocities:
            slip, spin = turned(parent.quaternion, rate[:3]), spin + turned(quaternion, rate[3:])
        back = -turned(quaternion, edge.anchor)
        velocity = parent.velocity + np.cross(parent.angular_velocity, arm) + slip + np.cross(spin, back)
        found[edge.child] = LinkPose(quaternion, parent.place + arm + back, velocity, spin)
    return found


def in_other_axes(quaternion: np.ndarray, tensor: np.ndarray) -> np.ndarray:
    """A tensor, e.g. an inertia, in the axes that a quaternion turns into."""
    rotation = np.stack([turned(quaternion, e) for e in np.eye(3)], axis=1)
    return rotation @ tensor @ rotation.T


def base_of(path: Path, links: Mapping[str, Link], edges: Mapping[str, Edge]) -> str:
    """The one link without a parent."""
    parents: dict[str, str] = {}
    for name, edge in edges.items():
        for link in (edge.parent, edge.child):
            if link not in links:
                raise SceneError(f"{path}: joint {name!r}: there is no link {link!r}; {one_of(links, link)}")
        if edge.child in parents:
            raise SceneError(
                f"{path}: link {edge.child!r} has two parents, joints {parents[edge.child]!r} and {name!r}: URDF is a "
                "tree; write one of them as a <loop_joint>, which closes a loop"
            )
        parents[edge.child] = name
    bases = [name for name in links if name not in parents]
    if len(bases) != 1:
        what = f"{len(bases)} links without a parent ({', '.join(bases)})" if bases else "no link without a parent"
        raise SceneError(f"{path}: has {what}; a robot has one base link, and joints that lead from it to the others")
    return bases[0]


def parents_first(path: Path, base: str, edges: Mapping[str, Edge]) -> dict[str, Edge]:
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

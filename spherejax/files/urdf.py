"""URDF import: a robot description as a scene."""

from collections.abc import Collection, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from spherejax.files.robot import FREE, SLIDING, TURNING, Edge, Pose, Robot, in_other_axes, poses, read_robot
from spherejax.files.rotations import UNTURNED, product, turn_about, turned
from spherejax.foundations.errors import SceneError, one_of
from spherejax.model.drift import AbstractDriftControl
from spherejax.model.scene import Scene, check_scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.forces import AbstractForce, SpringDamper, TorsionalSpring
from spherejax.physics.joints import AbstractJoint, PointOnPlane, Prismatic, Revolute

CAN_BE_IGNORED = ("friction", "mimic", "damping")
"""What a description may ask for and no joint here does."""

_ROUNDING = 1e-15
"""Products of inertia below this share of the largest moment are rounding: the axes are principal."""

_FOOT = 0.1
"""Distance [m] of the three points on which a planar joint stands; of the size of a robot's parts."""


def load_urdf(
    path: str | PathLike[str],
    *,
    base: Literal["ground", "free"] = "ground",
    positions: Mapping[str, float] | None = None,
    velocities: Mapping[str, float] | None = None,
    gravity: Sequence[float] = (0.0, 0.0, -9.81),
    drift: AbstractDriftControl | None = None,
    ignore: Collection[str] = (),
) -> Scene:
    """Read a robot description (URDF) as a scene.

    Links become bodies, in the axes of the link, about the center of mass. Links that fixed joints hold together are
    one body, named by the one nearest to the base. Every link's origin is a point of its body by the link's name, and
    every joint's place one of the parent's body by the joint's name. Revolute and continuous joints become `Revolute`,
    prismatic ones `Prismatic`, planar ones three `PointOnPlane` (named by the joint with _1, _2, _3), and floating ones
    nothing: their link is free. A joint's damping becomes a force element of the same name.

    Limits of positions, velocities and efforts, shapes, materials and transmissions are not read.

    Args:
        path: the file; xacro must have been expanded.
        base: whether the base link stands on the ground, at the origin, or is free.
        positions: of joints at the start by name [rad or m]; 0 for those that are not named.
        velocities: of joints at the start by name [rad/s or m/s].
        gravity: world axes [m/s^2].
        drift: drift control.
        ignore: what to leave out where a joint asks for it: "friction", "mimic" (joints that follow others then move by
            themselves), "damping" (of planar and floating joints).

    Raises:
        SceneError: naming file, link or joint, and remedy: for a link that moves and has no mass, for what `ignore`
            names and no joint here has, for what is no tree.
    """
    robot = read_robot(Path(path).expanduser())
    positions, velocities = dict(positions or {}), dict(velocities or {})
    _check(robot, base, positions, velocities, ignore)
    groups = _groups(robot, base)
    start = poses(robot, positions, velocities)
    joints: dict[str, AbstractJoint] = {}
    forces: dict[str, AbstractForce] = {}
    for name, edge in robot.edges.items():
        if edge.kind == "fixed":
            continue
        axis = turned(product(start[edge.parent].quaternion, edge.quaternion), edge.axis)
        joints |= _joints(name, edge, groups, axis)
        forces |= _damper(name, edge, groups, axis)
    bodies = {head: _body(robot, groups, head, start[head]) for head in groups.places if head != GROUND}
    scene = Scene(bodies, joints, forces, gravity=gravity, ground_points=groups.places.get(GROUND), drift=drift)
    try:
        check_scene(scene)
    except SceneError as error:
        raise SceneError(f"{robot.path}: {error}") from error
    return scene


class Groups(NamedTuple):
    """Which links are one body.

    Attributes:
        heads: name of the body of each link: the link of the group nearest to the base, or the ground.
        quaternions: of each link's axes in those of its body's head.
        origins: of each link in the axes of its head [m].
        places: points of each body by name, from the head's origin, in its axes [m].
        feet: name of the point of each joint on the parent's body, "body.point".
    """

    heads: dict[str, str]
    quaternions: dict[str, np.ndarray]
    origins: dict[str, np.ndarray]
    places: dict[str, dict[str, np.ndarray]]
    feet: dict[str, str]


def _groups(robot: Robot, base: str) -> Groups:
    """Links that fixed joints hold together, and the points on them."""
    first = GROUND if base == GROUND else robot.base
    zero = np.zeros(3)
    found = Groups({robot.base: first}, {robot.base: UNTURNED}, {robot.base: zero}, {first: {robot.base: zero}}, {})
    for name, edge in robot.edges.items():
        head, turn = found.heads[edge.parent], found.quaternions[edge.parent]
        place = found.origins[edge.parent] + turned(turn, edge.place)
        if edge.kind == "fixed":
            found.heads[edge.child] = head
            found.quaternions[edge.child] = product(turn, edge.quaternion)
            found.origins[edge.child] = place
            found.places[head][edge.child] = place
            continue
        found.heads[edge.child], found.quaternions[edge.child], found.origins[edge.child] = edge.child, UNTURNED, zero
        found.places[edge.child] = {edge.child: zero}
        point = name if name not in robot.links else f"{name}_joint"
        found.places[head][point] = place
        found.feet[name] = f"{head}.{point}"
        if edge.kind == "planar":
            found.places[edge.child] |= {f"{name}_{k + 1}": foot for k, foot in enumerate(_three_feet(edge.axis))}
    return found


def _three_feet(axis: np.ndarray) -> list[np.ndarray]:
    """Three points around the origin in the plane across an axis."""
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across = _FOOT * across / np.linalg.norm(across)
    return [turned(turn_about(axis, k * 2 * np.pi / 3), across) for k in range(3)]


def _body(robot: Robot, groups: Groups, head: str, start: Pose) -> Body:
    """Mass, center and inertia of a group, by the parallel axes theorem."""
    links = {name: robot.links[name] for name, one in groups.heads.items() if one == head}
    mass = sum(link.mass for link in links.values())
    if not mass > 0:
        joint = next((name for name, edge in robot.edges.items() if edge.child == head), None)
        how = "as a free base" if joint is None else f"by joint {joint!r}"
        raise SceneError(
            f"{robot.path}: link {head!r} moves {how} and has no mass; give it <inertial> with mass and inertia, or "
            + ("leave the base on the ground" if joint is None else "make the joint fixed")
        )
    centers = {
        name: groups.origins[name] + turned(groups.quaternions[name], link.center) for name, link in links.items()
    }
    center = sum(link.mass * centers[name] for name, link in links.items()) / mass
    inertia = np.zeros((3, 3))
    for name, link in links.items():
        arm = centers[name] - center
        inertia += in_other_axes(groups.quaternions[name], link.inertia)
        inertia += link.mass * ((arm @ arm) * np.eye(3) - np.outer(arm, arm))
    arm = turned(start.quaternion, center)
    return Body(
        mass,
        _principal_where_it_is(inertia),
        start.place + arm,
        start.quaternion,
        start.velocity + np.cross(start.angular_velocity, arm),
        start.angular_velocity,
        {name: place - center for name, place in groups.places[head].items()},
    )


def _principal_where_it_is(inertia: np.ndarray) -> np.ndarray:
    """Three moments where the axes are principal, else the matrix."""
    products = inertia - np.diag(np.diag(inertia))
    return np.diag(inertia) if np.abs(products).max() <= _ROUNDING * np.abs(inertia).max() else inertia


def _joints(name: str, edge: Edge, groups: Groups, axis: np.ndarray) -> dict[str, AbstractJoint]:
    """The joints that a joint of the description becomes."""
    parent = groups.heads[edge.parent]
    bodies, point = (parent, edge.child), f"{edge.child}.{edge.child}"
    if edge.kind in TURNING:
        return {name: Revolute(bodies, point, axis)}
    if edge.kind in SLIDING:
        return {name: Prismatic(bodies, point, axis)}
    if edge.kind == "planar":
        names = [f"{name}_{k}" for k in (1, 2, 3)]
        return {one: PointOnPlane(f"{edge.child}.{one}", groups.feet[name], axis, parent) for one in names}
    return {}


def _damper(name: str, edge: Edge, groups: Groups, axis: np.ndarray) -> dict[str, AbstractForce]:
    """The force element of a joint's damping."""
    if edge.damping and edge.kind in TURNING:
        return {name: TorsionalSpring((groups.heads[edge.parent], edge.child), axis, damping=edge.damping)}
    if edge.damping and edge.kind in SLIDING:
        ends = (groups.feet[name], f"{edge.child}.{edge.child}")
        return {name: SpringDamper(ends, damping=edge.damping, direction=axis)}
    return {}


def _check(robot: Robot, base: str, positions: Mapping, velocities: Mapping, ignore: Collection[str]) -> None:
    """Names, and what no scene can hold."""
    if base not in (GROUND, "free"):
        raise SceneError(f"base = {base!r} is unknown; give 'ground' or 'free'")
    for one in ignore:
        if one not in CAN_BE_IGNORED:
            raise SceneError(f"ignore: {one!r} is unknown; {one_of(CAN_BE_IGNORED, str(one))}")
    for what, given in (("positions", positions), ("velocities", velocities)):
        movable = [name for name, edge in robot.edges.items() if edge.kind in (*TURNING, *SLIDING)]
        for name in given:
            if name not in movable:
                raise SceneError(f"{robot.path}: {what}: no joint {name!r} turns or slides; {one_of(movable, name)}")
    for name in robot.links:
        if "." in name or name == GROUND:
            raise SceneError(f"{robot.path}: link {name!r}: a body cannot have this name; rename the link")
    for name, edge in robot.edges.items():
        _check_edge(robot, name, edge, ignore)


def _check_edge(robot: Robot, name: str, edge: Edge, ignore: Collection[str]) -> None:
    asked = {"friction": edge.friction != 0, "mimic": edge.follows is not None}
    asked["damping"] = edge.damping != 0 and edge.kind in FREE
    for what, is_asked in asked.items():
        if is_asked and what not in ignore:
            raise SceneError(
                f"{robot.path}: joint {name!r} has {what}, which no {edge.kind} joint here has; remove it, or leave it "
                f'out with load_urdf(..., ignore=("{what}",))'
            )

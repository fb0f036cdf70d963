"""URDF import: a robot description as a scene."""

from collections.abc import Collection, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np

from spherejax.files.robots.robot import (
    FREE,
    SLIDING,
    TURNING,
    Edge,
    LinkPose,
    Robot,
    poses,
    undotted,
    with_fixed,
    with_followers,
)
from spherejax.files.robots.robot_bodies import groups_of
from spherejax.files.robots.robot_joints import Ways
from spherejax.files.robots.robot_scene import by_plain_name, check_ignored, check_names, least_of, scene_of
from spherejax.files.robots.urdf_elements import read_robot
from spherejax.files.robots.urdf_left_out import EXTENSIONS
from spherejax.files.robots.urdf_loops import closed, loop_joints
from spherejax.foundations.errors import SceneError
from spherejax.model.drift import AbstractDriftControl
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND, UNIT_NORM_TOLERANCE, numbers
from spherejax.physics.laws.friction import AbstractFrictionLaw
from spherejax.physics.orientations import as_quaternion

CAN_BE_IGNORED = ("friction", "mimic", "damping", "loops", EXTENSIONS)
"""What a description may ask for and no joint here does by itself."""


def load_urdf(
    path: str | PathLike[str],
    *,
    base: Literal["ground", "free"] = "ground",
    positions: Mapping[str, float] | None = None,
    velocities: Mapping[str, float] | None = None,
    gravity: Sequence[float] = (0.0, 0.0, -9.81),
    drift: AbstractDriftControl | None = None,
    ignore: Collection[str] = (),
    fixed: Collection[str] = (),
    least_mass: float = 0.0,
    least_moment: float = 0.0,
    balance_inertia: bool = False,
    friction: AbstractFrictionLaw | None = None,
    mimic: Mapping[str, Any] | None = None,
    stops: Mapping[str, Any] | None = None,
    base_position: Sequence[float] = (0.0, 0.0, 0.0),
    base_quaternion: Any = (1.0, 0.0, 0.0, 0.0),
    base_velocity: Sequence[float] = (0.0, 0.0, 0.0),
    base_angular_velocity: Sequence[float] = (0.0, 0.0, 0.0),
) -> Scene:
    """Read a robot description (URDF) as a scene.

    Links become bodies, in the axes of the link, about the center of mass. Links that fixed joints hold together are
    one body, named by the one nearest to the base. Every link's origin is a point of its body by the link's name, and
    every joint's place one of the parent's body by the joint's name. Revolute and continuous joints become `Revolute`,
    prismatic ones `Prismatic`, planar ones three `PointOnPlane` (named by the joint with _1, _2, _3), and floating ones
    nothing: their link is free. A joint's damping becomes a force element of the same name.

    Dots in names become underscores: link "arm.2" is the body "arm_2"; arguments take either. A link "ground" becomes
    "ground_link". The axis of a fixed or floating joint is not read.

    A description says where a joint's stops are, not how stiff; how large its friction is, not what it does at rest;
    and that a joint follows another, not by what. So these three are asked for: limits are left out without `stops`;
    friction and mimic joints are errors until `friction`, `mimic` or `ignore` says what to do. Limits of velocities and
    efforts, shapes, materials, transmissions, calibration and safety controllers are not read. Whatever else a file has
    that URDF does not have is told: a warning for elements of other programs (`<gazebo>`, `<ros2_control>`), an error
    for what would move the mechanism otherwise, or is written where every word counts (`<dynamics stiffness=...>`).

    A `<loop_joint>` (of Drake and Isaac Sim: `link1` and `link2` with `link`, `xyz`, `rpy`, an `axis`, a type:
    revolute, continuous, spherical, prismatic, cylindrical or fixed) closes a loop. Joints that are not named in
    `positions` and not held are moved to where the loops close, which is told; its axis is the same in both ends' axes.
    Names of a default namespace are read as plain ones.

    Args:
        path: the file; xacro must have been expanded.
        base: whether the base link stands on the ground or is free.
        positions: of joints at the start by name [rad or m]; 0 for those that are not named, or, for one that mimics
            another, where that puts it.
        velocities: of joints at the start by name [rad/s or m/s].
        gravity: world axes [m/s^2].
        drift: drift control; `PostStabilization()` by default.
        ignore: what to leave out where a joint asks for it: "friction", "mimic" (joints that follow others then move by
            themselves), "damping" (of planar and floating joints), "loops", "extensions" (what URDF does not have).
        fixed: names of joints that are held where they are at the start, as if they were fixed ones; their velocity,
            friction and mimicry do not count.
        least_mass: given to bodies with less [kg]; as MuJoCo's boundmass.
        least_moment: a ball's moment of inertia is added to bodies until their least one is this [kg m^2]; as MuJoCo's
            boundinertia. Files that draw a joint of three axes as links without inertia need both.
        balance_inertia: whether three moments that no body has, one larger than the sum of the others, become their
            mean; as MuJoCo's balanceinertia.
        friction: law by which a joint's friction, a torque F [N m] or force [N], changes with its rate: F mu(v)/mu_k,
            with v in rad/s of joints that turn and in m/s of those that slide. `sj.Threlfall(mu=1.0, v1=1e-2)` is F
            tanh(rate/0.01); `sj.LuGre(...)` sticks.
        mimic: how stiff a joint is coupled to the one it mimics, with arguments of `sj.forces.Coupler` for joints that
            turn and for those that slide: `{"turning": {"stiffness": 50.0, "damping": 0.1}, "sliding": {...}}`, [N
                m/rad],
            [N m s/rad] or [N/m], [N s/m]; a joint's own name stands before both. The coupler has the joint's name with
            _mimic.
        stops: how stiff joints are beyond their limits: `{"turning": 500.0, "sliding": 1e5}` [N m/rad, N/m]; a joint's
            own name stands before both, and None leaves its stops out. They are elastic, a `TorsionalSpring` or a
            `BumpStop` with the joint's name and _stop; limits may be any number of turns away. In the place of a
            stiffness, `{"stiffness": 500.0, "restitution": 0.5}`, or a damping and an onset, are arguments of
            `TorsionalStop` and `BumpStop`, of stops that lose energy.
        base_position: of the base link's origin [m], shape (3,).
        base_quaternion: of the base link, scalar first, or any form that `Body` takes.
        base_velocity: of the base link's origin, of a free base [m/s], shape (3,).
        base_angular_velocity: of a free base, world axes [rad/s], shape (3,).

    Raises:
        SceneError: naming file, link or joint, and remedy: for a link that moves and has no mass, for what a joint asks
            for and no argument answers, for what is no tree, for loops that cannot be closed.

    Warns:
        RobotWarning: for what is left out, and for joints that were moved to close loops.
    """
    check_ignored(ignore, CAN_BE_IGNORED)
    robot = read_robot(Path(path).expanduser(), ignore)
    positions, velocities = by_plain_name(positions), by_plain_name(velocities)
    fixed = [undotted(name) for name in fixed]
    ways = Ways(friction, by_plain_name(mimic), by_plain_name(stops), tuple(ignore))
    _check(robot, base, positions, velocities, ignore, fixed)
    if "mimic" not in ignore:
        own = [name for name in fixed if name in positions]
        alone = robot._replace(
            edges={name: e._replace(follows=None) if name in own else e for name, e in robot.edges.items()}
        )
        positions = with_followers(alone, positions, "positions")
    if robot.loops:
        follows = {} if "mimic" not in ignore else dict.fromkeys(robot.edges, None)
        free = robot._replace(
            edges={name: e._replace(follows=follows.get(name, e.follows)) for name, e in robot.edges.items()}
        )
        positions = closed(free, positions, [*positions, *fixed])
    robot = with_fixed(robot, fixed, positions)
    if "mimic" not in ignore:
        velocities = with_followers(robot, velocities, "velocities")
    ways.check(robot)
    for name, edge in robot.edges.items():
        _check_edge(robot, name, edge, ways)
    first = _base_pose(base, base_position, base_quaternion, base_velocity, base_angular_velocity)
    groups = groups_of(robot, base, first)
    start = poses(robot, positions, velocities, first)
    least = least_of(least_mass, least_moment, balance_inertia)
    loops = loop_joints(robot, groups, start)
    return scene_of(robot, groups, start, positions, ways, least, gravity=gravity, drift=drift, loops=loops)


def _base_pose(base: str, position, quaternion, velocity, angular_velocity) -> LinkPose:
    """Where the base link is.

    Raises:
        SceneError: for what is no vector, no orientation, or a velocity of a base on the ground.
    """
    found = []
    vectors = {"base_position": position, "base_velocity": velocity, "base_angular_velocity": angular_velocity}
    for name, given in {**vectors, "base_quaternion": as_quaternion(quaternion)}.items():
        value, size = numbers(given), 4 if name == "base_quaternion" else 3
        if np.shape(value) != (size,) or not np.all(np.isfinite(value)):
            raise SceneError(f"{name} = {given!r} must be {size} finite numbers")
        if base == GROUND and "velocity" in name and np.any(value):
            raise SceneError(f"{name} = {given!r}: the base stands on the ground; give base='free', or leave it out")
        found.append(np.asarray(value, np.float64))
    norm = np.linalg.norm(found[3])
    if not abs(norm - 1.0) < UNIT_NORM_TOLERANCE:
        raise SceneError(f"base_quaternion = {quaternion!r} must have unit norm; divide it by its norm")
    return LinkPose(found[3] / norm, *found[:3])


def _check(robot: Robot, base, positions: Mapping, velocities: Mapping, ignore, fixed: Collection[str]) -> None:
    """Names, and what no scene can hold."""
    if base not in (GROUND, "free"):
        raise SceneError(f"base = {base!r} is unknown; give 'ground' or 'free'")
    movable = [name for name, edge in robot.edges.items() if edge.kind in (*TURNING, *SLIDING)]
    check_names(robot, movable, positions, velocities, fixed)


def _check_edge(robot: Robot, name: str, edge: Edge, ways: Ways) -> None:
    moves = edge.kind in (*TURNING, *SLIDING)
    answers = {
        "friction": (edge.friction != 0, moves, "friction=sj.Threlfall(mu=1.0, v1=1e-2)", ways.friction),
        "mimic": (
            edge.follows is not None,
            moves,
            'mimic={"turning": {"stiffness": ...}, "sliding": {"stiffness": ...}}, fixed=(names of joints)',
            ways.mimic,
        ),
        "damping": (edge.damping != 0 and edge.kind in FREE, False, "", None),
    }
    if edge.kind == "fixed":
        return
    for what, (is_asked, can_have, argument, answer) in answers.items():
        if not is_asked or what in ways.ignore or (can_have and answer):
            continue
        leave = f'leave it out with load_urdf(..., ignore=("{what}",))'
        if can_have:
            raise SceneError(
                f"{robot.path}: joint {name!r} has {what}, and the file does not say all of it; say it with "
                f"load_urdf(..., {argument}), or {leave}"
            )
        raise SceneError(
            f"{robot.path}: joint {name!r} has {what}, which no {edge.kind} joint here has; remove it, or {leave}"
        )

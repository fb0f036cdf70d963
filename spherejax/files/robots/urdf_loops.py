"""Loops of a URDF file: `<loop_joint>`, which Drake and Isaac Sim have, between two links of the tree."""

import warnings
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np

from spherejax.files.fields.rotations import product, turned
from spherejax.files.robots.robot import SLIDING, TURNING, LinkPose, Loop, Robot, poses, with_followers
from spherejax.files.robots.robot_bodies import LinkGroups
from spherejax.files.robots.urdf_left_out import RobotWarning
from spherejax.foundations.errors import SceneError
from spherejax.physics.joints.axial import Cylindrical, Prismatic, Revolute
from spherejax.physics.joints.joint import AbstractJoint
from spherejax.physics.joints.pairs import Fixed
from spherejax.physics.joints.spherical import Spherical

KINDS = {
    "continuous": "revolute",
    "revolute": "revolute",
    "hinge": "revolute",
    "spherical": "spherical",
    "ball": "spherical",
    "fixed": "fixed",
    "prismatic": "prismatic",
    "cylindrical": "cylindrical",
}
"""Types of loop joints, and what they are here."""

_CLOSED = 1e-10
"""How far apart [m, rad] the ends of a loop may be: Newton's method ends at rounding, of a robot of some meters."""

_NOTICED = 5e-3
"""Positions that change by more than this [rad, m] are told: tables of three digits leave half of it."""

_N_STEPS = 50
_LONGEST_STEP = 0.3
"""Of Newton's method, and the largest change of a position [rad, m] in one: from farther away it goes astray."""

_DIFFERENCE = 1e-6
"""Of positions [rad, m], for derivatives: rounding and curvature leave 1e-10 of them, enough for Newton's method."""


def closed(robot: Robot, positions: Mapping[str, float], given: Collection[str]) -> dict[str, float]:
    """Positions of the joints with which the loops close, from those as described, changed as little as possible.

    Args:
        robot: the robot, with its loops.
        positions: of its joints [rad or m]; those left out are 0.
        given: names of joints that stay where they are.

    Raises:
        SceneError: for loops that cannot be closed, naming the one that gapes most.

    Warns:
        RobotWarning: where joints were moved by more than printed digits leave.
    """
    free = [
        name
        for name, edge in robot.edges.items()
        if edge.kind in (*TURNING, *SLIDING) and edge.follows is None and name not in given
    ]
    leaders = {name: value for name, value in positions.items() if robot.edges[name].follows is None or name in given}

    def at(x: np.ndarray) -> dict[str, float]:
        return with_followers(robot, {**leaders, **dict(zip(free, x, strict=True))}, "positions")

    def gaps(x: np.ndarray) -> np.ndarray:
        return np.concatenate([gap_of(one, _poses_at(robot, at(x))) for one in robot.loops.values()])

    begin = np.array([positions.get(name, 0.0) for name in free], np.float64)
    x = _newton(gaps, begin)
    gap = np.abs(gaps(x)).max()
    if not gap <= _CLOSED:
        found = _poses_at(robot, at(x))
        worst = max(robot.loops, key=lambda name: np.abs(gap_of(robot.loops[name], found)).max())
        raise SceneError(
            f"{robot.path}: loop joint {worst!r} cannot be closed from where the joints are: {gap:.3g} m or rad "
            "remain. Start joints near a position that closes it, with positions={...}; those named there stay"
        )
    moved = {name: value for name, value, old in zip(free, x, begin, strict=True) if abs(value - old) > _NOTICED}
    if moved:
        said = ", ".join(f"{name!r}: {value:.6g}" for name, value in moved.items())
        warnings.warn(
            f"{robot.path}: loops were open where the joints are, and joints were moved to close them: positions="
            f"{{{said}}} [rad or m]; give these, or others that close the loops, to say so",
            RobotWarning,
            stacklevel=4,
        )
    return at(x)


def _poses_at(robot: Robot, positions: Mapping[str, float]) -> dict[str, LinkPose]:
    zero = np.zeros(3)
    return poses(robot, positions, {}, LinkPose(np.array([1.0, 0.0, 0.0, 0.0]), zero, zero, zero))


def _newton(gaps: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """Where the gaps are zero, by steps as short as possible; equations may depend on each other."""
    for _ in range(_N_STEPS):
        gap = gaps(x)
        if np.abs(gap).max() <= 1e-3 * _CLOSED or not x.size:
            break
        shifts = _DIFFERENCE * np.eye(x.size)
        jacobian = np.stack([(gaps(x + shift) - gaps(x - shift)) / (2 * _DIFFERENCE) for shift in shifts], axis=1)
        # Singular values below what differences leave are zero: rows of a plane's loop across the plane.
        step = np.linalg.lstsq(jacobian, gap, rcond=1e-8)[0]
        x = x - step * min(1.0, _LONGEST_STEP / max(np.abs(step).max(), 1e-300))
    return x


def gap_of(loop: Loop, found: Mapping[str, LinkPose]) -> np.ndarray:
    """How far a loop is open [m, then rad for small angles], shape (n,)."""
    first, second = (ends_of(loop, found[link], k) for k, link in enumerate(loop.links))
    apart = second[0] - first[0]
    axes = [turned(quaternion, loop.axis) for _, quaternion in (first, second)]
    tilt = np.cross(axes[0], axes[1]) + (axes[0] - axes[1]) * (axes[0] @ axes[1] < 0)  # not the other way round
    relative = product(first[1] * np.array([1.0, -1.0, -1.0, -1.0]), second[1])
    turn = 2 * relative[1:] * np.sign(relative[0] or 1.0)
    across = apart - (apart @ axes[0]) * axes[0]
    return {
        "spherical": apart,
        "revolute": np.concatenate([apart, tilt]),
        "fixed": np.concatenate([apart, turn]),
        "prismatic": np.concatenate([across, turn]),
        "cylindrical": np.concatenate([across, tilt]),
    }[loop.kind]


def ends_of(loop: Loop, pose: LinkPose, end: int) -> tuple[np.ndarray, np.ndarray]:
    """Place of an end of a loop, and the quaternion of its axes, world axes."""
    place = pose.place + turned(pose.quaternion, loop.places[end])
    return place, product(pose.quaternion, loop.quaternions[end])


def loop_joints(robot: Robot, groups: LinkGroups, start: Mapping[str, LinkPose]) -> dict[str, AbstractJoint]:
    """The joints of the loops, which the start closes.

    Raises:
        SceneError: for a loop between two links of one body.
    """
    found: dict[str, AbstractJoint] = {}
    for name, loop in robot.loops.items():
        bodies: Any = tuple(groups.heads[link] for link in loop.links)
        if bodies[0] == bodies[1]:
            raise SceneError(
                f"{robot.path}: loop joint {name!r} is between links {loop.links[0]!r} and {loop.links[1]!r}, which "
                'fixed joints hold together; remove it, or leave loops out with ignore=("loops",)'
            )
        points = [groups.add_point(link, name, place) for link, place in zip(loop.links, loop.places, strict=True)]
        axis = turned(ends_of(loop, start[loop.links[0]], 0)[1], loop.axis)
        if loop.kind == "spherical":
            found[name] = Spherical(points[0], points[1])
        elif loop.kind == "fixed":
            found[name] = Fixed(bodies, points[1])
        else:
            kind = {"revolute": Revolute, "prismatic": Prismatic, "cylindrical": Cylindrical}[loop.kind]
            found[name] = kind(bodies, points[1], axis)
    return found

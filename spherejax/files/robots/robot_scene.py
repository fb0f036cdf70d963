"""A robot description as a scene, whichever file it comes from."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from spherejax.files.fields.rotations import product, turned
from spherejax.files.robots.robot import SLIDING, TURNING, Edge, LinkPose, Robot, undotted
from spherejax.files.robots.robot_bodies import Least, LinkGroups, body_of, check_all_have_mass, solid_of
from spherejax.files.robots.robot_joints import Ways, forces_of, hinge_joints, joints_of, stack_joints
from spherejax.foundations.errors import SceneError, one_of
from spherejax.model.drift import AbstractDriftControl
from spherejax.model.scene import Scene, check_scene
from spherejax.physics.bodies import GROUND
from spherejax.physics.forces.base import AbstractForce
from spherejax.physics.joints.joint import AbstractJoint


def scene_of(
    robot: Robot,
    groups: LinkGroups,
    start: Mapping[str, LinkPose],
    positions: Mapping[str, Any],
    ways: Ways,
    least: Least,
    *,
    gravity: Any,
    drift: AbstractDriftControl | None,
    loops: Mapping[str, AbstractJoint] | None = None,
) -> Scene:
    """The scene of a robot whose links stand where they start.

    Args:
        robot: with held joints fixed.
        groups: which links are one body.
        start: pose of each link.
        positions: of joints by name [rad or m].
        ways: what the description leaves open.
        least: what bodies without inertia are given.
        gravity: world axes [m/s^2].
        drift: drift control.
        loops: joints besides those of the tree.

    Raises:
        SceneError: naming file, link or joint, and remedy.
    """
    joints: dict[str, AbstractJoint] = {}
    forces: dict[str, AbstractForce] = {}
    axes = {
        name: turned(product(start[edge.parent].quaternion, edge.quaternion), edge.axis)
        for name, edge in robot.edges.items()
    }
    for name, edge in robot.edges.items():
        if edge.kind == "stack":
            slides, turns = _axes_of_stack(edge, start)
            joints |= stack_joints(name, edge, groups, slides, turns)
        elif edge.kind == "hinges":
            joints |= hinge_joints(name, edge, groups, np.asarray(_axes_of_stack(edge, start)[1]))
        elif edge.kind != "fixed":
            second = None if edge.second is None else turned(start[edge.child].quaternion, edge.second)
            joints |= joints_of(name, edge, groups, axes[name], ways, second)
            forces |= forces_of(name, robot, groups, axes, ways, positions)
        for part in edge.parts:
            forces |= _forces_of_part(part, edge, robot, groups, start, ways, positions)
    solids = {head: solid_of(robot, groups, head) for head in groups.places if head != GROUND}
    solids = {head: solid.with_least(least) for head, solid in solids.items()}
    check_all_have_mass(robot, groups, solids)
    bodies = {head: body_of(solid, groups.places[head], start[head]) for head, solid in solids.items()}
    joints |= loops or {}
    scene = Scene(bodies, joints, forces, gravity=gravity, ground_points=groups.places.get(GROUND), drift=drift)
    if not bodies:
        remedy = "; give base='free'" if robot.loader == "load_urdf" else ""
        raise SceneError(f"{robot.path}: nothing moves on a base that stands on the ground{remedy}")
    try:
        check_scene(scene)
    except SceneError as error:
        remedy = f" Or take {robot.loader}(..., balance_inertia=True)." if "triangle rule" in str(error) else ""
        raise SceneError(f"{robot.path}: {error}{remedy}") from error
    return scene


def _axes_of_stack(edge: Edge, start: Mapping[str, LinkPose]) -> tuple[np.ndarray, np.ndarray | None]:
    """Axes of slides and turns, world axes at the start, as rows."""
    before = product(start[edge.parent].quaternion, edge.quaternion)
    behind = start[edge.child].quaternion
    carries = behind if edge.slides_on_child else before
    slides = np.array([turned(carries, axis) for axis in edge.slides]).reshape(-1, 3)
    if edge.turns is None:
        return slides, None
    turns = [turned(quaternion, axis) for quaternion, axis in zip((before, behind), edge.turns, strict=False)]
    return slides, np.array(turns).reshape(-1, 3)


def _forces_of_part(
    name: str,
    edge: Edge,
    robot: Robot,
    groups: LinkGroups,
    start: Mapping[str, LinkPose],
    ways: Ways,
    positions: Mapping[str, Any],
) -> dict[str, AbstractForce]:
    """Spring, damper and stops of one joint of a stack.

    Along a slide they measure between the stack's points, in a direction of the body that carries the slide: the first
    of a force element. For a slide on the child the two points change places, and the direction its sign.
    """
    part = edge.parts[name]
    carries = start[edge.child].quaternion
    if part.kind in TURNING or not edge.slides_on_child:
        carries = product(start[edge.parent].quaternion, edge.quaternion)
    axis = turned(carries, part.axis)
    if part.kind in SLIDING and edge.slides_on_child:
        axis = -axis
        feet = {**groups.feet, name: groups.hands[name]}
        groups = groups._replace(feet=feet, hands={**groups.hands, name: groups.feet[name]})
    alone = robot._replace(edges={**robot.edges, name: part})
    return forces_of(name, alone, groups, {name: axis}, ways, positions)


def by_plain_name(given: Mapping[str, Any] | None) -> dict[str, Any]:
    """What is given by the names of a file, by those of the scene."""
    return {undotted(name): value for name, value in (given or {}).items()}


def least_of(mass: float, moment: float, balanced: bool) -> Least:
    """What bodies without inertia are given.

    Raises:
        SceneError: for what is no number, or negative.
    """
    return Least(_number(mass, "least_mass"), _number(moment, "least_moment"), balanced)


def check_ignored(ignore: Collection[str], known: Collection[str]) -> None:
    """Raise `SceneError` for a word that names nothing that can be left out."""
    for one in ignore:
        if one not in known:
            raise SceneError(f"ignore: {one!r} is unknown; {one_of(known, str(one))}")


def check_names(
    robot: Robot,
    movable: Collection[str],
    positions: Collection[str],
    velocities: Mapping[str, Any],
    fixed: Collection[str],
) -> None:
    """Raise `SceneError` for names of joints that are none, and for velocities of joints that are held."""
    for what, given in (("positions", positions), ("velocities", velocities)):
        for name in given:
            if name not in movable:
                raise SceneError(f"{robot.path}: {what}: no joint {name!r} turns or slides; {one_of(movable, name)}")
    for name in fixed:
        if name not in robot.edges:
            raise SceneError(f"{robot.path}: fixed: there is no joint {name!r}; {one_of(robot.edges, name)}")
        if np.any(velocities.get(name, 0.0)):
            raise SceneError(
                f"{robot.path}: joint {name!r} is held by fixed= and has no velocity; leave one of them out"
            )


def _number(value: float, name: str) -> float:
    if not (isinstance(value, int | float | np.number) and 0 <= value < np.inf):
        raise SceneError(f"{name} = {value!r} must be a number, not negative")
    return float(value)

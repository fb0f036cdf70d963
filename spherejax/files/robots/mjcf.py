"""MJCF import: a MuJoCo model as a scene."""

from collections.abc import Collection, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from spherejax.files.fields.rotations import UNTURNED
from spherejax.files.robots.mjcf_actuators import actuators_of
from spherejax.files.robots.mjcf_joints import check_stacks, followed, loops_of, put_together
from spherejax.files.robots.mjcf_left_out import FINDERS, check_left_out
from spherejax.files.robots.mjcf_model import CompiledFile, compiled, library, robot_of, start_of
from spherejax.files.robots.robot import LinkPose, Robot, poses, undotted, with_fixed, with_followers
from spherejax.files.robots.robot_bodies import LinkGroups, groups_of
from spherejax.files.robots.robot_joints import Ways
from spherejax.files.robots.robot_scene import by_plain_name, check_ignored, check_names, least_of, scene_of
from spherejax.foundations.errors import SceneError
from spherejax.model.drift import AbstractDriftControl
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND
from spherejax.physics.laws.friction import AbstractFrictionLaw


def load_mjcf(
    path: str | PathLike[str],
    *,
    keyframe: str | None = None,
    positions: Mapping[str, Any] | None = None,
    velocities: Mapping[str, Any] | None = None,
    gravity: Sequence[float] | None = None,
    drift: AbstractDriftControl | None = None,
    ignore: Collection[str] = (),
    fixed: Collection[str] = (),
    least_mass: float = 0.0,
    least_moment: float = 0.0,
    balance_inertia: bool = False,
    friction: AbstractFrictionLaw | None = None,
    mimic: Mapping[str, Any] | None = None,
    stops: Mapping[str, Any] | None = None,
    controls: Mapping[str, float] | None = None,
) -> Scene:
    """Read a MuJoCo model (MJCF) as a scene, by MuJoCo's own compiler: `pip install 'spherejax[mjcf]'`.

    Bodies keep their axes and names; bodies without joints are one body with their parents, those on the world the
    ground. Hinges become `Revolute`, slides `Prismatic`, balls `Spherical`, free joints nothing. Several joints of one
    body become what leaves the same motion, named by the first, with _1, _2, ... where it is several joints: a
    `Universal` (two hinges that meet at right angles), `Spherical` (three that meet), `Cylindrical`, three
    `PointOnPlane` (two slides and a hinge across them); slides before or behind a hinge, two hinges at right angles,
    three hinges or a ball at one point, or alone, are `PointOnPlane` with `ParallelAxes`, `PerpendicularAxes` or
    `SameOrientation`, and nothing for three slides and a ball; two hinges in any position are kept by points, planes
    and `Distance`. Springs, dampers and stops stay where they act along
    slides at right angles, or about the only hinge. For others, and with friction or couplings, `least_mass` gives the
    links between the joints a little. A joint's stiffness and damping are one
    force element of its name. Equalities close loops: `connect` is a `Spherical`, `weld` a `Fixed`, both rigid, where
    MuJoCo's give way by `solref` and `solimp`; `joint` is a `Coupler` as stiff as `mimic` says. Equalities that the
    file has switched off are not there. Each body's origin is a point of the body by the body's name, each joint's
    place by the joint's, each site by the site's. Actuators of a hinge or a slide without activation (motors, position
    and velocity servos, `general` with a fixed gain and no bias or an affine one) are force elements of their names: an
    `Actuator`, or a `PID` where the effort depends on position or rate.

    What has no place in a scene, or is not said in full, is an error that names it, until an argument says what to do
    with it: contacts between geoms, other actuators, tendons, armature, limits, friction, ... Geoms count for inertia
    alone, which MuJoCo computes. Integrator, time step, solver, the softness of constraints, and what has no mechanics
    (sensors, cameras, lights, materials, the user's numbers and texts) are not read.

    Args:
        path: the file (.xml); includes, meshes and defaults are MuJoCo's to resolve.
        keyframe: name of the keyframe at which the motion starts, or its number as text; None: as the file draws it.
            Joints that follow others are where that puts them.
        positions: of joints at the start by name, in MuJoCo's coordinates: [rad or m], a quaternion of a ball, place
            and quaternion of a free body. Those that are not named are where the keyframe has them.
        velocities: of joints at the start by name: [rad/s or m/s], three numbers of a ball, in the body's axes [rad/s],
            six of a free body: of its origin in world axes [m/s], then as a ball's.
        gravity: world axes [m/s^2]; None: the file's.
        drift: drift control; `PostStabilization()` by default.
        ignore: what to leave out: "actuators", "armature", "contacts", "curves" (springs and dampers that are no
            straight lines), "ball damping", "ball friction", "ball springs" (of balls and free joints), "equalities"
            (other than connect, weld and joint), "flexes", "fluid", "friction", "gravcomp", "limits", "mimic" (joint
            equalities), "mocap" (such bodies then stand still, where the keyframe has them), "plugins", "tendons".
        fixed: names of joints that are held where they are at the start.
        least_mass, least_moment, balance_inertia: as in `load_urdf`; given to links between the joints of one body too.
        friction: law of `frictionloss`, as in `load_urdf`.
        mimic: how stiff joint equalities are, as in `load_urdf`.
        stops: how stiff limits are, as in `load_urdf`; None for one leaves it out.
        controls: MuJoCo's `ctrl` of actuators by name, numbers that last for the whole motion; those that are not named
            have what the keyframe says, or 0. `ctrlrange`, `forcerange` and the joint's `actuatorfrcrange` hold; of an
            actuator whose effort is constant they are applied here, and not to an offset that is given to it later.

    Raises:
        SceneError: naming file, body or joint, and remedy: for what the compiler refuses, for what would be lost, for a
            weld that the start does not close.
    """
    file = compiled(Path(path).expanduser())
    check_ignored(ignore, FINDERS)
    positions, velocities = by_plain_name(positions), by_plain_name(velocities)
    ways = Ways(friction, by_plain_name(mimic), by_plain_name(stops), tuple(ignore))
    check_left_out(file, ways)
    start = start_of(file, keyframe, positions, velocities)
    robot = robot_of(file, start, {} if "mimic" in ignore else followed(file))
    if "actuators" not in ignore:
        driven = actuators_of(file, by_plain_name(controls), keyframe)
        edges = {name: edge._replace(actuators=driven.get(name, ())) for name, edge in robot.edges.items()}
        robot = robot._replace(edges=edges)
    elif controls:
        raise SceneError(f"{file.path}: controls= is of actuators, and ignore= leaves these out; leave one of both out")
    held = [undotted(name) for name in fixed]
    check_names(robot, file.joints, positions, velocities, held)
    ways.check(robot)
    rates = {name: rate for name, rate in start.velocities.items() if name not in held}
    given = _leaders(robot, start.positions, positions, held)
    at = with_followers(_free(robot, held, given), given, "positions")
    robot = with_fixed(robot, held, at)
    rates |= with_followers(robot, _leaders(robot, rates, velocities, held), "velocities")
    ground = LinkPose(UNTURNED, np.zeros(3), np.zeros(3), np.zeros(3))
    poses_at_start = poses(robot, at, rates, ground)
    robot = put_together(robot, file, ways, held)
    check_stacks(robot, file, least_mass > 0 and least_moment > 0)
    groups = groups_of(robot, GROUND, ground)
    loops = loops_of(file, groups, poses_at_start, robot.edges)
    _add_sites(file, groups)
    if gravity is None:
        gravity = tuple(file.model.opt.gravity) if file.has("GRAVITY") else (0.0, 0.0, 0.0)
    least = least_of(least_mass, least_moment, balance_inertia)
    return scene_of(robot, groups, poses_at_start, at, ways, least, gravity=gravity, drift=drift, loops=loops)


def _leaders(
    robot: Robot, values: Mapping[str, Any], given: Mapping[str, Any], held: Collection[str]
) -> dict[str, Any]:
    """What joints have that do not follow others, and those that are told or held in spite of it."""
    return {
        name: value
        for name, value in values.items()
        if robot.edges[name].follows is None or name in given or name in held
    }


def _free(robot: Robot, held: Collection[str], given: Mapping[str, Any]) -> Robot:
    """The robot in which joints that are held where they are said to be follow nothing."""
    own = [name for name in held if name in given]
    edges = {name: edge._replace(follows=None) if name in own else edge for name, edge in robot.edges.items()}
    return robot._replace(edges=edges)


def _add_sites(file: CompiledFile, groups: LinkGroups) -> None:
    mujoco = library()
    model = file.model
    for site in range(model.nsite):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SITE, site)
        if name:
            groups.add_point(file.bodies[model.site_bodyid[site]], undotted(name), np.array(model.site_pos[site]))

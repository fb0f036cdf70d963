"""Reading MJCF by MuJoCo's own compiler: its model as links and joints.

MuJoCo moves a body by any number of joints, one after another; here each but the last moves a link without inertia.
Positions are counted from where a file draws its mechanism, MuJoCo's `ref` taken off.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from spherejax.files.fields.rotations import UNTURNED, product, turned
from spherejax.files.robots.robot import Edge, Link, Robot, in_other_axes, link_name, undotted
from spherejax.foundations.errors import SceneError, one_of
from spherejax.physics.bodies import UNIT_NORM_TOLERANCE

WORLD = "world"
"""MuJoCo's name for what does not move."""

KINDS = ("floating", "spherical", "prismatic", "revolute")
"""What MuJoCo's types of joints (free, ball, slide, hinge) are called here, in its order."""

_SIZES = {"floating": (7, 6), "spherical": (4, 3), "prismatic": (1, 1), "revolute": (1, 1)}
"""Numbers that say where a joint is, and how it moves."""


class CompiledFile(NamedTuple):
    """A file as MuJoCo has compiled it.

    Attributes:
        path: the file.
        model: MuJoCo's `MjModel`.
        bodies: names by MuJoCo's numbers, as scenes have them.
        joints: the same of joints.
    """

    path: Path
    model: Any
    bodies: list[str]
    joints: list[str]

    def kind(self, joint: int) -> str:
        """How a joint moves."""
        return KINDS[int(self.model.jnt_type[joint])]

    def of_joint(self, joint: int, values: np.ndarray, *, rates: bool) -> np.ndarray:
        """The entries of a joint in MuJoCo's positions, or rates."""
        first = (self.model.jnt_dofadr if rates else self.model.jnt_qposadr)[joint]
        return np.array(values[first : first + _SIZES[self.kind(joint)][rates]], np.float64)

    def has(self, flag: str) -> bool:
        """Whether the file leaves something switched on, e.g. "GRAVITY" (`<flag gravity="enable"/>`)."""
        mujoco = library()
        bit = getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}", None)
        if bit is None and flag in ("SPRING", "DAMPER"):  # one flag before MuJoCo 3.3
            bit = getattr(mujoco.mjtDisableBit, "mjDSBL_PASSIVE", None)
        return bit is None or not self.model.opt.disableflags & int(bit)

    def has_constraints(self, flag: str) -> bool:
        """The same of what MuJoCo has as constraints, which it can switch off together."""
        return self.has("CONSTRAINT") and self.has(flag)


class MjcfStart(NamedTuple):
    """Where the joints are at the start.

    Attributes:
        positions: of joints that turn or slide by name, from where the file draws them [rad or m].
        velocities: of all joints by name, as `poses` takes them.
        poses: quaternion of each ball, and place and quaternion of each free body, by joint.
        mocap: place and quaternion of each body that MuJoCo's caller moves, by its name, where a keyframe puts it.
    """

    positions: dict[str, float]
    velocities: dict[str, Any]
    poses: dict[str, np.ndarray]
    mocap: dict[str, np.ndarray]


def library() -> Any:
    """MuJoCo, whose names type checkers do not see."""
    import mujoco

    return mujoco


def compiled(path: Path) -> CompiledFile:
    """A file, compiled.

    Raises:
        SceneError: with the compiler's words; for a missing library.
    """
    try:
        mujoco = library()
    except ImportError as error:
        raise SceneError(f"reading MJCF needs MuJoCo: pip install 'spherejax[mjcf]' ({error})") from error
    try:
        path.read_bytes()
    except OSError as error:
        raise SceneError(f"cannot read {str(path)!r}: {error.strerror or error}") from error
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise SceneError(f"{path}: MuJoCo's compiler: {' '.join(str(error).split())}") from error
    except RuntimeError as error:  # MuJoCo 4.0 on an empty anchor; it then waits forever on a lock in the next file
        remedy = "Look for empty attributes, and read the next file in a new process"
        raise SceneError(f"{path}: MuJoCo's compiler failed: {' '.join(str(error).split())} {remedy}") from error
    objects = mujoco.mjtObj
    bodies = [mujoco.mj_id2name(model, objects.mjOBJ_BODY, i) or f"body_{i}" for i in range(model.nbody)]
    joints = [mujoco.mj_id2name(model, objects.mjOBJ_JOINT, i) or _unnamed(model, bodies, i) for i in range(model.njnt)]
    found = CompiledFile(path, model, [link_name(name) for name in bodies], [undotted(name) for name in joints])
    for what, names in (("bodies", found.bodies), ("joints", found.joints)):
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise SceneError(
                f"{path}: there are two {what} {twice[0]!r}, where dots are underscores; rename one of them"
            )
    return found


def _unnamed(model: Any, bodies: list[str], joint: int) -> str:
    body = int(model.jnt_bodyid[joint])
    number = joint - int(model.body_jntadr[body]) + 1
    return f"{bodies[body]}_joint" if model.body_jntnum[body] == 1 else f"{bodies[body]}_joint_{number}"


def start_of(file: CompiledFile, keyframe: str | None, positions: Mapping, velocities: Mapping) -> MjcfStart:
    """Where the joints are: as drawn, or as a keyframe has them, but for what is given.

    Raises:
        SceneError: for names that are none, and for values that have the wrong shape.
    """
    model = file.model
    q, v = np.array(model.qpos0), np.zeros(model.nv)
    mocap: dict[str, np.ndarray] = {}
    if keyframe is not None:
        at = keyframe_number(file, keyframe)
        for body in np.flatnonzero(np.asarray(model.body_mocapid) >= 0):
            number = int(model.body_mocapid[body])
            place, turn = (
                np.reshape(values[at], (-1, n))[number] for values, n in ((model.key_mpos, 3), (model.key_mquat, 4))
            )
            mocap[file.bodies[body]] = np.array([*place, *(turn / np.linalg.norm(turn))])
        q, v = np.array(model.key_qpos[at]), np.array(model.key_qvel[at])
    for what, given in (("positions", positions), ("velocities", velocities)):
        for name in given:
            if name not in file.joints:
                raise SceneError(f"{file.path}: {what}: there is no joint {name!r}; {one_of(file.joints, name)}")
    found = MjcfStart({}, {}, {}, mocap)
    for joint, name in enumerate(file.joints):
        kind = file.kind(joint)
        place = _given(file, "positions", positions, name, kind, file.of_joint(joint, q, rates=False))
        rate = _given(file, "velocities", velocities, name, kind, file.of_joint(joint, v, rates=True))
        if kind in ("revolute", "prismatic"):
            found.positions[name] = float(place[0] - model.qpos0[model.jnt_qposadr[joint]])
            found.velocities[name] = float(rate[0])
        else:
            norm = np.linalg.norm(place[-4:])
            if not abs(norm - 1.0) < UNIT_NORM_TOLERANCE:
                raise SceneError(
                    f"{file.path}: positions[{name!r}]: the quaternion {place[-4:]!r} must have unit norm; divide it "
                    "by its norm"
                )
            found.poses[name] = np.array([*place[:-4], *(place[-4:] / norm)])
            found.velocities[name] = rate
    return found


def keyframe_number(file: CompiledFile, name: str) -> int:
    """MuJoCo's number of a keyframe.

    Raises:
        SceneError: where there is no such keyframe.
    """
    mujoco = library()
    names = [mujoco.mj_id2name(file.model, mujoco.mjtObj.mjOBJ_KEY, i) or str(i) for i in range(file.model.nkey)]
    if name not in names:
        raise SceneError(f"{file.path}: there is no keyframe {name!r}; {one_of(names, name)}")
    return names.index(name)


def _given(file: CompiledFile, what: str, given: Mapping, name: str, kind: str, otherwise: np.ndarray) -> np.ndarray:
    if name not in given:
        return otherwise
    size = _SIZES[kind][what == "velocities"]
    try:
        value = np.atleast_1d(np.asarray(given[name], np.float64))
    except (TypeError, ValueError):
        value = np.zeros(0)
    if value.shape != (size,) or not np.all(np.isfinite(value)):
        number = "a finite number" if size == 1 else f"{size} finite numbers"
        raise SceneError(f"{file.path}: {what}[{name!r}] = {given[name]!r} must be {number}")
    return value


def robot_of(file: CompiledFile, start: MjcfStart, followed: Mapping[str, tuple[str, float, float]]) -> Robot:
    """The links and joints.

    Args:
        file: compiled.
        start: where the joints are; balls and free bodies are put there.
        followed: the joint that a joint follows, the multiplier, and the offset, by name.
    """
    model = file.model
    links = {WORLD: Link(0.0, np.zeros(3), np.zeros((3, 3)))}
    edges: dict[str, Edge] = {}
    for body in range(1, model.nbody):
        name, parent = file.bodies[body], file.bodies[model.body_parentid[body]]
        quaternion, place = np.array(model.body_quat[body]), np.array(model.body_pos[body])
        if name in start.mocap:
            place, quaternion = start.mocap[name][:3], start.mocap[name][3:]
        first, n = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        if n == 0:
            edges[_free_name(edges, f"{name}_weld", file)] = Edge(
                "fixed", parent, name, quaternion, place, np.eye(3)[0]
            )
        for k in range(n):
            joint = first + k
            child = name if k == n - 1 else f"{name}_{k + 1}"
            if k < n - 1:
                links[child] = Link(0.0, np.zeros(3), np.zeros((3, 3)))
            edge = _edge(file, joint, parent, child, quaternion, place)
            edges[file.joints[joint]] = _placed(edge, start.poses.get(file.joints[joint]))
            parent, quaternion, place = child, UNTURNED, np.zeros(3)
        links[name] = _link(model, body)
    for name, (leader, multiplier, offset) in followed.items():
        edges[name] = edges[name]._replace(follows=leader, multiplier=multiplier, offset=offset)
    return Robot(file.path, links, edges, WORLD, "load_mjcf")


def _free_name(edges: Mapping, name: str, file: CompiledFile) -> str:
    while name in edges or name in file.joints:
        name += "_"
    return name


def _link(model: Any, body: int) -> Link:
    moments = np.diag(np.array(model.body_inertia[body]))
    inertia = in_other_axes(np.array(model.body_iquat[body]), moments)
    return Link(float(model.body_mass[body]), np.array(model.body_ipos[body]), inertia)


def _edge(file: CompiledFile, joint: int, parent: str, child: str, quaternion: np.ndarray, place: np.ndarray) -> Edge:
    model, kind = file.model, file.kind(joint)
    free = kind == "floating"
    edge = Edge(kind, parent, child, quaternion, place, np.array(model.jnt_axis[joint], np.float64))
    edge = edge._replace(anchor=np.zeros(3) if free else np.array(model.jnt_pos[joint], np.float64))
    if kind not in ("revolute", "prismatic"):
        return edge
    address, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
    lower, upper = -np.inf, np.inf
    if model.jnt_limited[joint] and file.has_constraints("LIMIT"):
        lower, upper = np.array(model.jnt_range[joint], np.float64) - model.qpos0[address]
    return edge._replace(
        damping=float(model.dof_damping[dof]) if file.has("DAMPER") else 0.0,
        friction=float(model.dof_frictionloss[dof]) if file.has_constraints("FRICTIONLOSS") else 0.0,
        stiffness=float(np.ravel(model.jnt_stiffness[joint])[0]) if file.has("SPRING") else 0.0,
        rest=float(model.qpos_spring[address] - model.qpos0[address]),
        lower=float(lower),
        upper=float(upper),
    )


def _placed(edge: Edge, pose: np.ndarray | None) -> Edge:
    """A ball, or a free body, where it starts."""
    if edge.kind == "floating" and pose is not None:
        return edge._replace(place=pose[:3], quaternion=pose[3:])
    if edge.kind == "spherical" and pose is not None:
        quaternion = product(edge.quaternion, pose)
        place = edge.place + turned(edge.quaternion, edge.anchor) - turned(quaternion, edge.anchor)
        return edge._replace(quaternion=quaternion, place=place)
    return edge

"""Scenes in MuJoCo: joint coordinates along a tree, loops closed by soft equality constraints, RK4 with a fixed step."""

import xml.etree.ElementTree as ET
from collections.abc import Callable

import numpy as np
from peers.started import NoCounterpart, Start, start_of

import spherejax as sj
from spherejax.physics.bodies import GROUND
from spherejax.physics.joints import PlacedRevolute, PlacedSpherical

Positions = dict[str, np.ndarray]
"""Positions of the centers of mass at the samples, shape (n, 3), by body [m]."""


def runner(scene: sj.Scene) -> Callable[[float, np.ndarray], Positions]:
    """A function of step size [s] and equidistant sample times that returns the bodies' positions.

    Raises:
        NoCounterpart: for a joint or force that this translator does not know.
    """
    start = start_of(scene)
    if start.system.forces:
        raise NoCounterpart(f"forces {', '.join(start.system.forces)}")

    def run(step: float, ts: np.ndarray) -> Positions:
        import mujoco

        tree = _Tree(start)
        model = mujoco.MjModel.from_xml_string(_document(tree, step))
        state = mujoco.MjData(model)
        _set_velocities(model, state, tree)
        mujoco.mj_forward(model, state)
        index = {name: mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in start.system.bodies}
        kept = {name: [] for name in index}
        for t in ts:
            while state.time < t - 0.5 * step:
                mujoco.mj_step(model, state)
            mujoco.mj_kinematics(model, state)
            for name, number in index.items():
                kept[name].append(state.xpos[number].copy())
        return {name: np.array(rows) for name, rows in kept.items()}

    return run


class _Tree:
    """Which joint carries each body, found from the ground outwards; the joints that are left close loops."""

    def __init__(self, start: Start):
        self.start = start
        self.parent: dict[str, tuple[str, str]] = {}
        self.children: dict[str, list[str]] = {name: [] for name in start.poses}
        reached, grew = {GROUND}, True
        used = set()
        while grew:
            grew = False
            for name, joint in start.system.joints.items():
                inside = [body in reached for body in joint.bodies]
                if name not in used and inside[0] != inside[1]:
                    parent, child = joint.bodies if inside[0] else joint.bodies[::-1]
                    self.parent[child] = (parent, name)
                    self.children[parent].append(child)
                    reached.add(child)
                    used.add(name)
                    grew = True
        self.loops = [name for name in start.system.joints if name not in used]
        self.free = [name for name in start.system.bodies if name not in reached]


def _document(tree: _Tree, step: float) -> str:
    root = ET.Element("mujoco")
    gravity = np.asarray(tree.start.system.gravity)
    option = ET.SubElement(
        root, "option", timestep=repr(step), integrator="RK4", gravity=_text(gravity), tolerance="1e-14", iterations="200"
    )
    ET.SubElement(option, "flag", contact="disable", limit="disable")
    world = ET.SubElement(root, "worldbody")
    for name in tree.children[GROUND] + tree.free:
        _add_body(world, tree, name)
    equality = ET.SubElement(root, "equality")
    for name in tree.loops:
        _close(equality, tree, name, step)
    return ET.tostring(root, encoding="unicode")


def _add_body(above: ET.Element, tree: _Tree, name: str) -> None:
    parent, joint_name = tree.parent.get(name, (GROUND, None))
    pose, base = tree.start.poses[name], tree.start.poses[parent]
    body = tree.start.system.bodies[name]
    element = ET.SubElement(
        above,
        "body",
        name=name,
        pos=_text(base.rotation.T @ (pose.position - base.position)),
        quat=_text(_product(base.quaternion * [1, -1, -1, -1], pose.quaternion)),
    )
    inertia = np.asarray(body.inertia)
    full = np.diag(inertia) if inertia.ndim == 1 else inertia
    six = [full[0, 0], full[1, 1], full[2, 2], full[0, 1], full[0, 2], full[1, 2]]
    ET.SubElement(element, "inertial", pos="0 0 0", mass=repr(float(body.mass)), fullinertia=_text(six))
    if joint_name is None:
        ET.SubElement(element, "freejoint", name=f"free:{name}")
    else:
        _add_joint(element, tree, name, joint_name)
    for child in tree.children[name]:
        _add_body(element, tree, child)


def _add_joint(element: ET.Element, tree: _Tree, child: str, name: str) -> None:
    joint = tree.start.system.joints[name]
    pose = tree.start.poses[child]
    place = _text(np.asarray(joint.points[joint.bodies.index(child)]))
    if isinstance(joint, PlacedSpherical) and joint.model.is_ideal:
        ET.SubElement(element, "joint", name=name, type="ball", pos=place)
    elif isinstance(joint, PlacedRevolute):
        axis = pose.rotation.T @ _world_axis(tree.start, joint)
        ET.SubElement(element, "joint", name=name, type="hinge", pos=place, axis=_text(axis))
    else:
        raise NoCounterpart(f"joint {name!r} ({type(joint).__name__})")


def _close(equality: ET.Element, tree: _Tree, name: str, step: float) -> None:
    """A loop is closed by making points coincide: one for a ball, two on the axis for a hinge."""
    joint = tree.start.system.joints[name]
    names = ["world" if body == GROUND else body for body in joint.bodies]
    first = tree.start.poses[joint.bodies[0]]
    at = tree.start.poses[joint.bodies[1]].point(joint.points[1])
    points = [at]
    if isinstance(joint, PlacedRevolute):
        points.append(at + 0.1 * _world_axis(tree.start, joint))
    elif not (isinstance(joint, PlacedSpherical) and joint.model.is_ideal):
        raise NoCounterpart(f"joint {name!r} ({type(joint).__name__}) in a loop")
    for point in points:
        ET.SubElement(
            equality,
            "connect",
            body1=names[0],
            body2=names[1],
            anchor=_text(first.rotation.T @ (point - first.position)),
            solref=_text([2 * step, 1.0]),
            solimp="0.9999 0.9999 0.001 0.5 2",
        )


def _set_velocities(model, state, tree: _Tree) -> None:
    """Joint rates from the bodies' velocities."""
    import mujoco

    for child, (parent, name) in tree.parent.items():
        joint = tree.start.system.joints[name]
        pose = tree.start.poses[child]
        spin = pose.angular_velocity - tree.start.poses[parent].angular_velocity
        address = model.jnt_dofadr[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)]
        if isinstance(joint, PlacedSpherical):
            state.qvel[address : address + 3] = pose.rotation.T @ spin
        else:
            state.qvel[address] = _world_axis(tree.start, joint) @ spin
    for name in tree.free:
        pose = tree.start.poses[name]
        address = model.jnt_dofadr[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, f"free:{name}")]
        state.qvel[address : address + 6] = np.concatenate([pose.velocity, pose.rotation.T @ pose.angular_velocity])


def _world_axis(start: Start, joint: PlacedRevolute) -> np.ndarray:
    return start.poses[joint.bodies[1]].direction(joint.axis)


def _product(p, q) -> np.ndarray:
    p, q = np.asarray(p, float), np.asarray(q, float)
    vector = p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])
    return np.concatenate([[p[0] * q[0] - p[1:] @ q[1:]], vector])


def _text(values) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values).ravel())

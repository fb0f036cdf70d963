"""Scenes in MuJoCo: joint coordinates along a tree, loops closed by soft equality constraints, RK4, fixed step."""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any

import numpy as np

import spherejax as sj
from peers.started import NoCounterpartError, Start, start_of
from spherejax.physics.bodies import GROUND

Positions = dict[str, np.ndarray]
"""Positions of the centers of mass at the samples, shape (n, 3), by body [m]."""


def runner(scene: sj.Scene) -> Callable[[float, np.ndarray], Positions]:
    """A function of step size [s] and equidistant sample times that returns the bodies' positions.

    Raises:
        NoCounterpartError: for a joint or force that this translator does not know.
    """
    tree = _tree_of(scene)

    def run(step: float, ts: np.ndarray) -> Positions:
        import mujoco

        model = mujoco.MjModel.from_xml_string(_document(tree, step))
        state = mujoco.MjData(model)
        _set_velocities(model, state, tree)
        mujoco.mj_forward(model, state)
        index = {name: mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in tree.start.system.bodies}
        kept = {name: [] for name in index}
        for t in ts:
            while state.time < t - 0.5 * step:
                mujoco.mj_step(model, state)
            mujoco.mj_kinematics(model, state)
            for name, number in index.items():
                kept[name].append(state.xpos[number].copy())
        return {name: np.array(rows) for name, rows in kept.items()}

    return run


def model_of(scene: sj.Scene, step: float) -> Any:
    """The `mujoco.MjModel` of a scene that starts at rest, with a step size [s].

    Raises:
        NoCounterpartError: as `runner`.
    """
    import mujoco

    return mujoco.MjModel.from_xml_string(_document(_tree_of(scene), step))


def _tree_of(scene: sj.Scene) -> "_Tree":
    start = start_of(scene)
    if start.system.forces:
        raise NoCounterpartError(f"forces {', '.join(start.system.forces)}")
    return _Tree(scene, start)


class _Tree:
    """Which joint carries each body, found from the ground outwards; the joints that are left close loops."""

    def __init__(self, scene: sj.Scene, start: Start):
        self.scene, self.start = scene, start
        self.parent: dict[str, tuple[str, str]] = {}
        self.children: dict[str, list[str]] = {name: [] for name in start.poses}
        # Loops are closed at spherical joints where there are any: they are one point.
        names = sorted(scene.joints, key=lambda name: isinstance(scene.joints[name], sj.Spherical))
        reached, used = {GROUND}, set()
        while (name := self._next(names, reached, used)) is not None:
            bodies = start.system.joints[name].bodies
            parent, child = bodies if bodies[0] in reached else bodies[::-1]
            self.parent[child] = (parent, name)
            self.children[parent].append(child)
            reached.add(child)
            used.add(name)
        self.loops = [name for name in start.system.joints if name not in used]
        self.free = [name for name in start.system.bodies if name not in reached]

    def _next(self, names: list[str], reached: set[str], used: set[str]) -> str | None:
        """The first joint that leads from a body that is reached to one that is not."""
        for name in names:
            inside = [body in reached for body in self.start.system.joints[name].bodies]
            if name not in used and inside[0] != inside[1]:
                return name
        return None


def _document(tree: _Tree, step: float) -> str:
    root = ET.Element("mujoco")
    gravity = np.asarray(tree.start.system.gravity)
    option = ET.SubElement(
        root,
        "option",
        timestep=repr(step),
        integrator="RK4",
        gravity=_text(gravity),
        tolerance="1e-14",
        iterations="200",
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
    joint, placed = tree.scene.joints[name], tree.start.system.joints[name]
    place = _text(np.asarray(placed.points[placed.bodies.index(child)]))
    if isinstance(joint, sj.Spherical):
        if not joint.model.is_ideal:
            raise NoCounterpartError(f"joint {name!r} with {type(joint.model).__name__}")
        ET.SubElement(element, "joint", name=name, type="ball", pos=place)
        return
    to_body = tree.start.poses[child].rotation.T
    for kind, axis in _axes_of(joint, name, child is not placed.bodies[1]):
        number = len(element.findall("joint"))
        at = {"name": f"{name}:{number}", "type": kind, "pos": place, "axis": _text(to_body @ np.asarray(axis, float))}
        ET.SubElement(element, "joint", at)


def _axes_of(joint, name: str, is_turned_over: bool) -> list[tuple[str, np.ndarray]]:
    """Kinds and world axes of MuJoCo's joints, from the parent to the child."""
    if isinstance(joint, sj.Revolute):
        return [("hinge", joint.axis)]
    if isinstance(joint, sj.Prismatic):
        return [("slide", joint.axis)]
    if isinstance(joint, sj.Cylindrical):
        return [("slide", joint.axis), ("hinge", joint.axis)]
    if isinstance(joint, sj.Fixed):
        return []
    if isinstance(joint, sj.Universal):
        arms = [("hinge", joint.first_axis), ("hinge", joint.second_axis)]
        return arms[::-1] if is_turned_over else arms
    raise NoCounterpartError(f"joint {name!r} ({type(joint).__name__})")


def _close(equality: ET.Element, tree: _Tree, name: str, step: float) -> None:
    """A loop is closed by making points coincide: one for a ball, two on the axis for a hinge."""
    joint, placed = tree.scene.joints[name], tree.start.system.joints[name]
    names = ["world" if body == GROUND else body for body in placed.bodies]
    first = tree.start.poses[placed.bodies[0]]
    at = tree.start.poses[placed.bodies[1]].point(placed.points[1])
    points = [at]
    if isinstance(joint, sj.Revolute):
        points.append(at + 0.1 * np.asarray(joint.axis) / np.linalg.norm(joint.axis))
    elif not isinstance(joint, sj.Spherical) or not joint.model.is_ideal:
        raise NoCounterpartError(f"joint {name!r} ({type(joint).__name__}) in a loop")
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
    """Joint rates from the bodies' velocities: the least change of coordinates that gives them."""
    import mujoco

    mujoco.mj_forward(model, state)
    rows, rates = [], []
    for name in tree.start.system.bodies:
        pose = tree.start.poses[name]
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
        mujoco.mj_jacBodyCom(model, state, linear, angular, number)
        rows += [linear, angular]
        rates += [pose.velocity, pose.angular_velocity]
    state.qvel[:] = np.linalg.lstsq(np.concatenate(rows), np.concatenate(rates), rcond=None)[0]


def _product(p, q) -> np.ndarray:
    p, q = np.asarray(p, float), np.asarray(q, float)
    vector = p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])
    return np.concatenate([[p[0] * q[0] - p[1:] @ q[1:]], vector])


def _text(values) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values).ravel())

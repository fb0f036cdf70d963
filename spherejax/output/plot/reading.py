"""A scene (at its assembled start) or a run, read for drawing: what `Mechanism` holds, made once.

A joint that is made of elementary equations is drawn by these, whatever its class: one point and two right angles are a
hinge. A body is drawn by its points: those of joints and of force elements, and those with a name.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.model.system import System, compile_scene, flatten_system
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.start.assembly import as_ideal, assemble_now
from spherejax.output.plot.mechanism import DrawnBody, DrawnJoint, Mechanism
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.forces.coupler import Turn
from spherejax.physics.joints.curves import Circle
from spherejax.physics.state import Layout, unpack


def mechanism_of(what: Scene | Trajectory, scene: Scene | None = None) -> Mechanism:
    """A scene at its assembled start, or a run, ready to be drawn.

    Args:
        what: the scene or the run.
        scene: the scene that was simulated, whose named points are drawn besides those of the joints.

    Raises:
        SceneError: for something else, for a run with lanes, or for a run without a single sample.
    """
    if isinstance(what, Scene):
        return _of_scene(what)
    if not isinstance(what, Trajectory):
        raise SceneError(f"{type(what).__name__} cannot be drawn; give a Scene or the result of sj.simulate")
    if not is_concrete(what.ys) or np.ndim(what.ys) != 2:
        raise SceneError(
            "a run with lanes, or inside a transformation, cannot be drawn; take one lane of it outside: "
            "jax.tree.map(lambda x: x[0], runs)"
        )
    ts, ys = np.asarray(what.ts), np.asarray(what.ys)
    reached = np.isfinite(ys).all(axis=1)
    if not reached.any():
        raise SceneError(f"the run has no sample to draw: {what.diagnosis or 'its states are not finite'}")
    if scene is not None and set(scene.bodies) != set(what.system.bodies):
        raise SceneError("scene= is not the scene of this run: their bodies have different names")
    return _mechanism(what.system, what.system.layout, ts[reached], ys[reached], scene, what)


def mechanism_at(system: System, t: float, y: np.ndarray) -> Mechanism:
    """A system at one time [s] and flat state, ready to be drawn."""
    return _mechanism(system, system.layout, np.array([t]), np.asarray(y)[None], None, None)


def _of_scene(scene: Scene) -> Mechanism:
    system = compile_scene(scene).system
    structure, theta = flatten_system(as_ideal(system))
    if not is_concrete(theta):
        raise SceneError("a scene with traced numbers cannot be drawn; draw it outside of the transformation")
    start = np.asarray(assemble_now(structure, theta).y)
    return _mechanism(system, Layout(len(system.bodies)), np.zeros(1), start[None], scene, None)


def _mechanism(system: System, layout: Layout, ts, ys, scene: Scene | None, run: Trajectory | None) -> Mechanism:
    state = unpack(layout, ys)
    placed = list(system.joints.values())
    joints = {name: _drawn_joint(name, joint, placed) for name, joint in system.joints.items()}
    places = _places(joints.values(), system.forces, scene)
    bodies = [_drawn_body(name, body, places.get(name, [])) for name, body in system.bodies.items()]
    size = float(np.ptp(state.position[0], axis=0).max()) + max(
        (float(np.linalg.norm(place)) for name in system.bodies for place in places.get(name, [])), default=0.0
    )
    return Mechanism(
        bodies=tuple(_fitting(one, size) for one in bodies),
        joints=joints,
        forces=system.forces,
        gravity=np.asarray(system.gravity, float),
        ground_places=np.array(places.get(GROUND, [])).reshape(-1, 3),
        ts=ts,
        positions=np.asarray(state.position),
        quaternions=np.asarray(state.quaternion),
        velocities=np.asarray(state.velocity),
        angular_velocities=np.asarray(state.angular_velocity),
        run=run,
    )


def _places(joints, forces: Mapping[str, Any], scene: Scene | None) -> dict[str, list[np.ndarray]]:
    """Points of each body that its outline joins: of joints, of force elements, and with a name."""
    found: dict[str, list[np.ndarray]] = {}
    for joint in joints:
        for body, place in zip(joint.bodies, joint.places, strict=True):
            if joint.kind == "RotationDriver":
                continue
            found.setdefault(body, []).append(place)
    for force in forces.values():
        for body, place in force_places(force):
            if np.linalg.norm(place) > 0:  # the center of mass is drawn anyway
                found.setdefault(body, []).append(place)
    if scene is not None:
        named = {GROUND: scene.ground_points, **{name: body.points for name, body in scene.bodies.items()}}
        for body, points in named.items():
            found.setdefault(body, []).extend(np.asarray(point, float) for point in points.values())
    return {body: _distinct(points) for body, points in found.items()}


def force_places(force: Any) -> list[tuple[str, np.ndarray]]:
    """Where a force element meets its bodies, as (body, place in body axes [m]); empty where it does not say."""
    force = getattr(force, "coordinate", force)
    force = getattr(force, "attachment", None) or force
    bodies = tuple(getattr(force, "bodies", None) or getattr(force, "body_names", ()))
    places = getattr(force, "places", None)
    if places is None and hasattr(force, "place") and len(bodies) == 1:
        places = (force.place,)
    if not isinstance(places, Sequence) or len(places) != len(bodies):
        return []
    return [(body, np.asarray(place, float)) for body, place in zip(bodies, places, strict=True)]


def pitch_circles(force: Any, mechanism: Any) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """The pitch circle of each wheel of a pair of gears, as (body, its center there [m], points about the center).

    Of each coordinate that is an angle on a radius, about the joint between its two bodies, in the axes of the first.
    """
    found = []
    for turn in (getattr(force, "first", None), getattr(force, "second", None)):
        if not isinstance(turn, Turn) or turn.radius is None or turn.attachment is None:
            continue
        first = turn.bodies[0]
        joint = next((one for one in mechanism.joints.values() if set(one.bodies) == set(turn.bodies)), None)
        if joint is None:
            continue
        axis = np.asarray(turn.attachment.axis, float)
        across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        across /= np.linalg.norm(across)
        angle = np.linspace(0.0, 2 * np.pi, 73)[:, None]
        ring = float(np.asarray(turn.radius)) * (np.cos(angle) * across + np.sin(angle) * np.cross(axis, across))
        found.append((first, np.asarray(joint.places[joint.bodies.index(first)], float), ring))
    return found


def _distinct(points: list[np.ndarray]) -> list[np.ndarray]:
    """Points without repetitions, in their order."""
    scale = max((float(np.abs(point).max()) for point in points), default=0.0)
    kept: list[np.ndarray] = []
    for point in points:
        if all(np.linalg.norm(point - other) > 1e-9 * scale for other in kept):
            kept.append(point)
    return kept


def _drawn_joint(name: str, joint: Any, others: Sequence[Any]) -> DrawnJoint:
    kind, bodies, axes = kind_of_joint(joint), tuple(joint.bodies), _axes(joint)
    first, second = (np.asarray(point, float) for point in joint.points)
    if kind == "RotationDriver":  # a torque has no point: it is drawn at the joint that it drives
        driven = [one for one in others if set(one.bodies) == set(bodies) and not getattr(one, "is_driven", False)]
        if driven:
            return replace(_drawn_joint(name, driven[0], ()), kind=kind, model=None)
    if kind == "PointOnCurve" and isinstance(joint.curve, Circle):
        across = sum(float(x) * np.asarray(axis, float) for x, axis in zip(joint.curve.center, joint.axes, strict=True))
        return DrawnJoint(name, "PointOnCircle", bodies, (first + across, second), ())
    if kind in ONE_POINT:  # the other point is an origin, where nothing is
        return DrawnJoint(name, kind, (bodies[1], bodies[1]), (second, second), ())
    return DrawnJoint(name, kind, bodies, (first, second), axes, getattr(joint, "model", None))


ONE_POINT = ("PositionDriver", "PointOnCurve")
"""Kinds of joints with a point on the second body only."""


KINDS = {
    (True, 0, 0): "Rim",
    (True, 0, 1): "Universal",
    (True, 0, 2): "Revolute",
    (True, 0, 3): "Fixed",
    (False, 0, 1): "PerpendicularAxes",
    (False, 0, 2): "ParallelAxes",
    (False, 0, 3): "SameOrientation",
    (False, 1, 0): "PointOnPlane",
    (False, 2, 0): "Rim",
    (False, 2, 2): "Cylindrical",
    (False, 2, 3): "Prismatic",
}
"""What a joint made of elementary equations is: whether its points coincide, numbers of planes and of right angles."""


def kind_of_joint(joint: Any) -> str:
    """What a placed joint is: by its equations where it is made of elementary ones, else by its class."""
    joint = getattr(joint, "ideal", None) or joint  # an elastic joint is drawn as the ideal one that it softens
    if hasattr(joint, "right_angles"):
        equations = (bool(joint.coincides), len(joint.normals), len(joint.right_angles))
        return KINDS.get(equations, type(joint).__name__)
    return type(joint).__name__.removeprefix("Placed")


def _axes(joint: Any) -> tuple[tuple[int, np.ndarray], ...]:
    """Directions of a placed joint: `axis` and `axes` belong to the second body, `normals` to the first.

    Joints that hold directions alone have one of each body, the first body's first.
    """
    joint = getattr(joint, "ideal", None) or joint
    own = getattr(joint, "axes", ()) or ([joint.axis] if getattr(joint, "axis", None) is not None else [])
    found = [(1, _unit(axis)) for axis in own]
    kind = kind_of_joint(joint)
    if kind == "TranslationDriver":
        found = [(0, _unit(joint.axis))]
    if kind == "Universal":
        found.append((0, _unit(joint.right_angles[0][0])))
    if kind == "PointOnPlane":
        found.append((0, _unit(joint.normals[0])))
    if kind == "ParallelAxes":
        (first, second), (other, _) = joint.right_angles
        found = [(0, _unit(np.cross(first, other))), (1, _unit(second))]
    if kind == "PerpendicularAxes":
        found = [(which, _unit(axis)) for which, axis in enumerate(joint.right_angles[0])]
    return tuple(found)


def _unit(vector) -> np.ndarray:
    vector = np.asarray(vector, float)
    return vector / np.linalg.norm(vector)


def _drawn_body(name: str, body: Body, places: list[np.ndarray]) -> DrawnBody:
    inertia = np.asarray(body.inertia, float)
    moments, axes = (inertia, np.eye(3)) if inertia.ndim == 1 else np.linalg.eigh(inertia)
    # I_1 = m (b^2 + c^2) / 12 and so on for a uniform box with sides a, b, c; printed inertias may violate I_1 <= I_2
    # + I_3, then the side is zero.
    squares = 6 * (moments.sum() - 2 * moments) / float(np.asarray(body.mass))
    half_sides = 0.5 * np.sqrt(np.maximum(squares, 0.0))
    return DrawnBody(name, np.array(places).reshape(-1, 3), half_sides, axes)


def _fitting(body: DrawnBody, size: float) -> DrawnBody:
    """The body with a box that does not hide the mechanism, whose inertia may be that of a bigger body.

    The box reaches at most a quarter beyond the body's farthest point; one that is held at its center of mass is at
    most `SMALL_BOX` of the mechanism. A free body keeps its box.
    """
    reach = float(np.linalg.norm(body.half_sides))
    if len(body.places) == 0 or reach == 0:
        return body
    farthest = float(np.linalg.norm(body.places, axis=1).max())
    most = 1.25 * farthest if farthest > SMALL_BOX * size else SMALL_BOX * size
    return replace(body, half_sides=body.half_sides * min(1.0, most / reach))


SMALL_BOX = 0.1
"""Half diagonal of the box of a body that is held at its center of mass, as a share of the mechanism, at most."""

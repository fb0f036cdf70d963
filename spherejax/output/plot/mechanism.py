"""What a drawing of a mechanism needs to know: bodies, joints, forces, and where everything is at a time.

Plain host arrays, made once from a scene (at its assembled start) or from a run; the drawing code knows nothing else.
Between samples positions and quaternions follow cubic Hermite interpolation by their rates, so that an animation moves
evenly whatever the samples are; at a sample they are the sample.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from spherejax.foundations.checks import SceneError, is_concrete
from spherejax.model.scene import Scene
from spherejax.model.system import System, compile_scene, flatten_system
from spherejax.motion.assembly import assemble_now
from spherejax.motion.integrate import as_ideal
from spherejax.motion.trajectory import Trajectory
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.joints import Circle
from spherejax.physics.state import Layout, unpack


@dataclass(frozen=True)
class DrawnBody:
    """A body as it is drawn.

    Attributes:
        name: of the body.
        places: points that its outline joins, body axes [m], shape (n_places, 3).
        half_sides: half sides of the uniform box with the body's mass and inertia [m], shape (3,).
        box_axes: principal axes of inertia as columns, body axes, shape (3, 3).
    """

    name: str
    places: np.ndarray
    half_sides: np.ndarray
    box_axes: np.ndarray


@dataclass(frozen=True)
class DrawnJoint:
    """A joint as it is drawn.

    Attributes:
        name: of the joint.
        kind: the placed joint's class name without `Placed`, which chooses the symbol.
        bodies: names of the two bodies.
        places: the joint's point on each body, body axes [m].
        axes: directions, as (index into `bodies`, unit vector in that body's axes).
        model: how a spherical joint resists; None for other kinds.
    """

    name: str
    kind: str
    bodies: tuple[str, str]
    places: tuple[np.ndarray, np.ndarray]
    axes: tuple[tuple[int, np.ndarray], ...]
    model: Any = None


@dataclass(frozen=True)
class Pose:
    """Where every body is at one time, the ground included.

    Attributes:
        t: time [s].
        positions: centers of mass by body, world axes [m].
        rotations: body axes to world axes, by body.
        quaternions: the same as quaternions.
        velocities: of the centers of mass, world axes [m/s].
        angular_velocities: world axes [rad/s].
    """

    t: float
    positions: Mapping[str, np.ndarray]
    rotations: Mapping[str, np.ndarray]
    quaternions: Mapping[str, np.ndarray]
    velocities: Mapping[str, np.ndarray]
    angular_velocities: Mapping[str, np.ndarray]

    def point(self, body: str, place: np.ndarray) -> np.ndarray:
        """Points of a body, from body axes to world axes [m]; shape (..., 3)."""
        return self.positions[body] + place @ self.rotations[body].T

    def direction(self, body: str, vector: np.ndarray) -> np.ndarray:
        """A direction of a body in world axes."""
        return self.rotations[body] @ vector


@dataclass(frozen=True)
class Mechanism:
    """Everything that is drawn, at all sample times.

    Attributes:
        bodies: in the order of the state.
        joints: by name.
        forces: force elements by name, as the scene has them.
        gravity: world axes [m/s^2].
        ground_places: points fixed in the world that carry joints or names [m], shape (n_places, 3).
        ts: sample times that were reached [s], shape (n,).
        positions: centers of mass, shape (n, n_bodies, 3).
        quaternions: shape (n, n_bodies, 4).
        velocities: shape (n, n_bodies, 3).
        angular_velocities: shape (n, n_bodies, 3).
        run: the run, where there is one.
    """

    bodies: tuple[DrawnBody, ...]
    joints: Mapping[str, DrawnJoint]
    forces: Mapping[str, Any]
    gravity: np.ndarray
    ground_places: np.ndarray
    ts: np.ndarray
    positions: np.ndarray
    quaternions: np.ndarray
    velocities: np.ndarray
    angular_velocities: np.ndarray
    run: Trajectory | None = None

    def pose(self, t: float) -> Pose:
        """Where everything is at a time.

        Raises:
            SceneError: for a time that the motion does not hold.
        """
        self.require_time(t)
        after = int(np.clip(np.searchsorted(self.ts, t), min(1, len(self.ts) - 1), len(self.ts) - 1))
        ends = np.array([max(after - 1, 0), after])
        times, share = self.ts[ends], 0.0
        if times[1] > times[0]:
            share = (t - times[0]) / (times[1] - times[0])
        position = _hermite(times, self.positions[ends], self.velocities[ends], share)
        quaternion = _hermite(times, self.quaternions[ends], self._quaternion_rates[ends], share)
        quaternion = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
        velocity, spin = (
            (1 - share) * rates[ends[0]] + share * rates[ends[1]]
            for rates in (self.velocities, self.angular_velocities)
        )

        def named(values: np.ndarray, of_ground: np.ndarray) -> dict[str, np.ndarray]:
            return {GROUND: of_ground, **{body.name: value for body, value in zip(self.bodies, values, strict=True)}}

        zero = np.zeros(3)
        return Pose(
            float(t),
            named(position, zero),
            named(rotation_matrices(quaternion), np.eye(3)),
            named(quaternion, np.array([1.0, 0.0, 0.0, 0.0])),
            named(velocity, zero),
            named(spin, zero),
        )

    def require_time(self, t: float) -> None:
        """Raise `SceneError` for a time outside of the samples that were reached."""
        first, last = self.ts[0], self.ts[-1]
        if not first <= t <= last:
            stopped = "" if self.run is None or bool(self.run.succeeded) else f"; {self.run.diagnosis}"
            raise SceneError(f"t = {t:g} s lies outside of the motion, {first:g} s to {last:g} s{stopped}")

    def hangs(self, joint: DrawnJoint) -> bool:
        """Whether a joint's body hangs from the ground at the start, so that the ground is drawn above it."""
        if (joint.bodies[0] == GROUND) == (joint.bodies[1] == GROUND):
            return False
        on_ground = joint.bodies.index(GROUND)
        other = joint.bodies[1 - on_ground]
        places = next(body.places for body in self.bodies if body.name == other)
        pose = self.pose(float(self.ts[0]))
        # Of a body with one point, its center of mass; of others the middle of their outline.
        middle = pose.point(other, places).mean(axis=0) if len(places) > 1 else pose.positions[other]
        return bool((middle - joint.places[on_ground]) @ self.gravity > 0)

    def path(self, body: str, place: np.ndarray) -> np.ndarray:
        """A point of a body at all samples, world axes [m], shape (n, 3)."""
        if body == GROUND:
            return np.broadcast_to(place, (len(self.ts), 3))
        index = [one.name for one in self.bodies].index(body)
        return self.positions[:, index] + rotation_matrices(self.quaternions[:, index]) @ place

    @cached_property
    def _quaternion_rates(self) -> np.ndarray:
        """p_dot = (0, w) p / 2 at the samples."""
        w, p = self.angular_velocities, self.quaternions
        scalar = -np.sum(w * p[..., 1:], -1, keepdims=True)
        vector = p[..., :1] * w + np.cross(w, p[..., 1:])
        return 0.5 * np.concatenate([scalar, vector], -1)


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
    force = getattr(force, "attachment", None) or force
    bodies = tuple(getattr(force, "bodies", None) or getattr(force, "body_names", ()))
    places = getattr(force, "places", None)
    if places is None and hasattr(force, "place") and len(bodies) == 1:
        places = (force.place,)
    if not isinstance(places, Sequence) or len(places) != len(bodies):
        return []
    return [(body, np.asarray(place, float)) for body, place in zip(bodies, places, strict=True)]


def _distinct(points: list[np.ndarray]) -> list[np.ndarray]:
    """Points without repetitions, in their order."""
    scale = max((float(np.abs(point).max()) for point in points), default=0.0)
    kept: list[np.ndarray] = []
    for point in points:
        if all(np.linalg.norm(point - other) > 1e-9 * scale for other in kept):
            kept.append(point)
    return kept


def _drawn_joint(name: str, joint: Any, others: Sequence[Any]) -> DrawnJoint:
    kind, bodies, axes = _kind(joint), tuple(joint.bodies), _axes(joint)
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
    (True, 0, 0): "Spherical",
    (True, 0, 1): "Universal",
    (True, 0, 2): "Revolute",
    (True, 0, 3): "Fixed",
    (False, 1, 0): "PointOnPlane",
    (False, 2, 2): "Cylindrical",
    (False, 2, 3): "Prismatic",
}
"""What a joint made of elementary equations is: whether its points coincide, numbers of planes and of right angles."""


def _kind(joint: Any) -> str:
    """What a placed joint is: by its equations where it is made of elementary ones, else by its class."""
    joint = getattr(joint, "ideal", None) or joint  # an elastic joint is drawn as the ideal one that it softens
    if hasattr(joint, "right_angles"):
        equations = (bool(joint.coincides), len(joint.normals), len(joint.right_angles))
        return KINDS.get(equations, type(joint).__name__)
    return type(joint).__name__.removeprefix("Placed")


def _axes(joint: Any) -> tuple[tuple[int, np.ndarray], ...]:
    """Directions of a placed joint: `axis` and `axes` belong to the second body, `normals` to the first."""
    joint = getattr(joint, "ideal", None) or joint
    own = getattr(joint, "axes", ()) or ([joint.axis] if getattr(joint, "axis", None) is not None else [])
    found = [(1, _unit(axis)) for axis in own]
    kind = _kind(joint)
    if kind == "TranslationDriver":
        found = [(0, _unit(joint.axis))]
    if kind == "Universal":
        found.append((0, _unit(joint.right_angles[0][0])))
    if kind == "PointOnPlane":
        found.append((0, _unit(joint.normals[0])))
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


def _hermite(ts: np.ndarray, values: np.ndarray, rates: np.ndarray, s: float) -> np.ndarray:
    """Cubic interpolation between two samples by values and rates; error of order h^4 for smooth motion."""
    weight = s * s * (3 - 2 * s)
    slopes = (ts[1] - ts[0]) * s * (1 - s) * ((1 - s) * rates[0] - s * rates[1])
    return (1 - weight) * values[0] + weight * values[1] + slopes


def rotation_matrices(quaternions: np.ndarray) -> np.ndarray:
    """Rotation matrices of quaternions of any norm, shape (..., 3, 3); see `foundations.rotation`."""
    p0, p1, p2, p3 = np.moveaxis(quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (p2 * p2 + p3 * p3), 2 * (p1 * p2 - p3 * p0), 2 * (p1 * p3 + p2 * p0)],
        [2 * (p1 * p2 + p3 * p0), 1 - 2 * (p1 * p1 + p3 * p3), 2 * (p2 * p3 - p1 * p0)],
        [2 * (p1 * p3 - p2 * p0), 2 * (p2 * p3 + p1 * p0), 1 - 2 * (p1 * p1 + p2 * p2)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)

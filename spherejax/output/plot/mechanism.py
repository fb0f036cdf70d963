"""What a drawing of a mechanism needs to know: bodies, joints, forces, and where everything is at a time.

Plain host arrays; the drawing code knows nothing else, and `reading` makes them from a scene or a run. Between samples
positions and quaternions follow cubic Hermite interpolation by their rates, so that an animation moves evenly whatever
the samples are; at a sample they are the sample.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.motion.results.trajectory import Trajectory
from spherejax.physics.bodies import GROUND


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
class MechanismPose:
    """Where every body is at one time, the ground included.

    Attributes:
        t: time [s].
        positions: centers of mass by body, world axes [m].
        rotations: body axes to world axes, by body.
        quaternions: the same as quaternions.
        velocities: of the centers of mass, world axes [m/s].
        angular_velocities: world axes [rad/s].
        memory: of each force element that remembers, as the last sample of a run has it; empty without a run.
    """

    t: float
    positions: Mapping[str, np.ndarray]
    rotations: Mapping[str, np.ndarray]
    quaternions: Mapping[str, np.ndarray]
    velocities: Mapping[str, np.ndarray]
    angular_velocities: Mapping[str, np.ndarray]
    memory: Mapping[str, np.ndarray] = field(default_factory=dict)

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

    def pose(self, t: float) -> MechanismPose:
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
        return MechanismPose(
            float(t),
            named(position, zero),
            named(rotation_matrices(quaternion), np.eye(3)),
            named(quaternion, np.array([1.0, 0.0, 0.0, 0.0])),
            named(velocity, zero),
            named(spin, zero),
            self._memory_at(int(ends[1] if share >= 1 else ends[0])),
        )

    def _memory_at(self, sample: int) -> dict[str, np.ndarray]:
        """What force elements remember: what is held between samples must not be drawn in between."""
        if self.run is None:
            return {}
        memory, slots = self.run.state.memory, self.run.system.force_slots
        return {slot.joint: np.asarray(memory[sample, slot.entries]) for slot in slots}

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

"""Force elements on paper, and the whole mechanism as strokes."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from spherejax.output.plot.camera import Camera
from spherejax.output.plot.mechanism import Mechanism, Pose, force_places
from spherejax.output.plot.shapes import body_strokes, triad_strokes
from spherejax.output.plot.strokes import CIRCLE, PAPER, Stroke, arrow_outline, ground_marks
from spherejax.output.plot.symbols import joint_strokes
from spherejax.physics.bodies import GROUND
from spherejax.physics.kinematics import BodyMotion


def force_strokes(name: str, force: Any, pose: Pose, camera: Camera, s: float) -> list[Stroke]:
    """A zigzag between the two points of an element that says where they are; arrows of the forces of any other."""
    places = force_places(force)
    if len(places) == 2:
        ends = [pose.point(body, place) for body, place in places]
        strokes = _spring(camera.project(ends[0]), camera.project(ends[1]), camera.depth(np.array(ends)), s)
        on_ground = [end for end, (body, _) in zip(ends, places, strict=True) if body == GROUND]
        marks = [mark for end in on_ground for mark in ground_marks(camera.project(end), 0.8 * s)]
        strokes = [*(replace(mark, name=f"ground:{name}") for mark in marks), *strokes]
    else:
        strokes = [_arrow(at, force_at, camera, 5 * s) for at, force_at in forces_on_bodies(force, pose)]
    return [replace(stroke, name=stroke.name or f"force:{name}") for stroke in strokes]


def forces_on_bodies(force: Any, pose: Pose) -> list[tuple[np.ndarray, np.ndarray]]:
    """The forces of an element, as (point of its line of action nearest to the center of mass [m], force [N])."""
    by_body: Any = (pose.positions, pose.quaternions, pose.rotations, pose.velocities, pose.angular_velocities)
    motions: Any = {body: BodyMotion(*(values[body] for values in by_body)) for body in pose.positions}
    found = []
    for body, wrench in force.wrenches(pose.t, motions).items():
        pull, moment = np.asarray(wrench.force, float), np.asarray(wrench.moment, float)
        if body != GROUND:
            arm = np.cross(pull, moment) / max(float(pull @ pull), 1e-300)
            found.append((pose.positions[body] + arm, pull))
    return found


def _spring(a: np.ndarray, b: np.ndarray, depth: float, s: float) -> list[Stroke]:
    shares = np.array([0.0, 0.18, *np.linspace(0.22, 0.78, 12), 0.82, 1.0])
    sides = np.array([0.0, 0.0, *np.tile([1.0, -1.0], 6), 0.0, 0.0])
    along = b - a
    across = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-300)
    line = a + shares[:, None] * along + 0.9 * s * sides[:, None] * across
    return [
        Stroke(line, depth, PAPER, 3.2),
        Stroke(line, depth, FORCE_COLOR, 1.3),
        *(Stroke(at + 0.35 * s * CIRCLE, depth, "none", 0.0, FORCE_COLOR) for at in (a, b)),
    ]


def _arrow(at: np.ndarray, force: np.ndarray, camera: Camera, length: float) -> Stroke:
    """An arrow of one length that ends where the force acts; none without a force."""
    size = float(np.linalg.norm(force))
    tip = camera.project(at)
    shaft = camera.project(length * force / size) if size > 0 else np.zeros(2)
    outline = arrow_outline(tip - shaft, tip, 0.13 * length)
    return Stroke(outline, camera.depth(at), FORCE_COLOR, 1.4, FORCE_COLOR)


FORCE_COLOR = "#7A3B00"
"""Of springs and applied forces."""


def mechanism_strokes(
    mechanism: Mechanism, pose: Pose, camera: Camera, colors: dict[str, str], s: float, frames: bool
) -> Iterator[list[Stroke]]:
    """All strokes in groups: bodies, force elements, joints, and body axes where they are asked for."""
    bar = 4.6 if len(mechanism.bodies) <= 8 else 3.2
    for body in mechanism.bodies:
        yield body_strokes(body, pose, camera, colors[body.name], s, bar)
    for name, force in mechanism.forces.items():
        if strokes := force_strokes(name, force, pose, camera, s):
            yield strokes
    for joint in mechanism.joints.values():
        yield joint_strokes(joint, pose, camera, s, mechanism.hangs(joint))
    if frames:
        yield from (triad_strokes(body.name, pose, camera, 3.2 * s) for body in mechanism.bodies)

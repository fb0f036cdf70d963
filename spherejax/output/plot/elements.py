"""Force elements on paper, and the whole mechanism as strokes."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from spherejax.output.plot.camera import Camera
from spherejax.output.plot.mechanism import Mechanism, MechanismPose
from spherejax.output.plot.reading import force_places, pitch_circles
from spherejax.output.plot.shapes import body_strokes, triad_strokes
from spherejax.output.plot.strokes import CIRCLE, GROUND_COLOR, PAPER, Stroke, arrow_outline, ground_marks
from spherejax.output.plot.symbols import joint_strokes
from spherejax.physics.bodies import GROUND
from spherejax.physics.forces.remembering import AbstractForceWithMemory, memory_entries, recalling
from spherejax.physics.forces.torsional import AbstractTorsionalForce
from spherejax.physics.forces.tyre import Tyre
from spherejax.physics.kinematics import BodyMotion


def force_strokes(name: str, mechanism: Mechanism, pose: MechanismPose, camera: Camera, s: float) -> list[Stroke]:
    """A force element: a tyre, a zigzag or a motor between two points, a spiral, pitch circles, or arrows of forces."""
    force = mechanism.forces[name]
    if isinstance(force, Tyre):
        strokes = _tyre(force, pose, camera)
    elif isinstance(force, AbstractTorsionalForce):
        strokes = _spiral(force, mechanism, pose, camera, s)
    elif circles := pitch_circles(force, mechanism):
        strokes = _pitch_circles(circles, pose, camera)
    elif len(places := force_places(force)) == 2:
        strokes = _line_element(name, places, pose, camera, s, force.is_motor)
    else:
        strokes = [_arrow(at, pull, camera, 5 * s) for at, pull in forces_on_bodies(name, force, pose)]
    return [replace(stroke, name=stroke.name or f"force:{name}") for stroke in strokes]


def _line_element(
    name: str, places: list, pose: MechanismPose, camera: Camera, s: float, is_motor: bool
) -> list[Stroke]:
    """A zigzag, or the cylinder and rod of a motor, with hatching where it stands on the ground."""
    ends = [pose.point(body, place) for body, place in places]
    on_ground = [end for end, (body, _) in zip(ends, places, strict=True) if body == GROUND]
    up = np.sign(sum((end for end in ends), np.zeros(3)) @ camera.up - 2 * on_ground[0] @ camera.up) if on_ground else 1
    marks = [mark for end in on_ground for mark in ground_marks(camera.project(end), 0.8 * s * (1 if up >= 0 else -1))]
    symbol = _cylinder if is_motor else _spring
    drawn = symbol(camera.project(ends[0]), camera.project(ends[1]), camera.depth(np.array(ends)), s)
    return [*(replace(mark, name=f"ground:{name}") for mark in marks), *drawn]


def _tyre(force: Tyre, pose: MechanismPose, camera: Camera) -> list[Stroke]:
    """The unloaded tyre's circle about the wheel's y axis, and the road below it, as far as a diameter to each side."""
    body, radius = force.center.partition(".")[0], float(np.asarray(force.radius))
    center = pose.point(body, np.asarray(force.place, float))
    rotation = pose.rotations[body]
    circle = center + radius * (CIRCLE[:, :1] * rotation[:, 0] + CIRCLE[:, 1:] * rotation[:, 2])
    x = center[0] + 2 * radius * np.linspace(-1, 1, 61)
    road = np.stack([x, np.full(61, center[1]), force.road_heights(x, pose.t)], -1)
    depth = camera.depth(center)
    return [
        Stroke(camera.project(circle), depth, "0.2", 4.0, "0.6", 0.12),
        Stroke(camera.project(road), depth, GROUND_COLOR, 1.6),
    ]


def _spiral(
    force: AbstractTorsionalForce, mechanism: Mechanism, pose: MechanismPose, camera: Camera, s: float
) -> list[Stroke]:
    """A spiral about the joint that joins the same two bodies; about the second body's center where there is none."""
    bodies = set(force.bodies)
    joint = next((one for one in mechanism.joints.values() if set(one.bodies) == bodies), None)
    second = force.bodies[1] if force.bodies[1] != GROUND else force.bodies[0]
    at = pose.positions[second] if joint is None else pose.point(joint.bodies[0], joint.places[0])
    angle = np.linspace(0, 5 * np.pi, 81)
    spiral = s * (1.3 + 1.2 * angle / angle[-1])[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    return [Stroke(camera.project(at) + spiral, camera.depth(at), FORCE_COLOR, 1.0)]


def _pitch_circles(circles: list, pose: MechanismPose, camera: Camera) -> list[Stroke]:
    strokes = []
    for body, place, ring in circles:
        line = pose.point(body, place + ring)
        strokes.append(Stroke(camera.project(line), camera.depth(line), FORCE_COLOR, 1.4, FORCE_COLOR, 0.06))
    return strokes


def forces_on_bodies(name: str, force: Any, pose: MechanismPose) -> list[tuple[np.ndarray, np.ndarray]]:
    """The forces of an element, as (point of its line of action nearest to the center of mass [m], force [N]).

    None of one that remembers where there is no run that says what.
    """
    if memory_entries(force) and name not in pose.memory:
        return []
    if isinstance(force, AbstractForceWithMemory):
        force = recalling(force, jnp.asarray(pose.memory.get(name, ())))
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


def _cylinder(a: np.ndarray, b: np.ndarray, depth: float, s: float) -> list[Stroke]:
    """An actuator or controller along a line: an open barrel and a thin rod, through which bodies stay visible."""
    along = b - a
    across = 0.55 * s * np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-300)
    begin, end = a + 0.2 * along, a + 0.6 * along
    barrel = np.array([begin + across, end + across, end - across, begin - across, begin + across])
    head = a + 0.42 * along
    return [
        Stroke(np.array([a, begin]), depth, FORCE_COLOR, 1.0),
        Stroke(barrel, depth, FORCE_COLOR, 0.9),
        Stroke(np.array([head + across, head - across]), depth, FORCE_COLOR, 1.2),
        Stroke(np.array([head, b]), depth, FORCE_COLOR, 1.0),
        *(Stroke(at + 0.35 * s * CIRCLE, depth, "none", 0.0, FORCE_COLOR) for at in (a, b)),
    ]


def _arrow(at: np.ndarray, force: np.ndarray, camera: Camera, length: float) -> Stroke:
    """An arrow of one length that ends where the force acts; none without a force."""
    size = float(np.linalg.norm(force))
    tip = camera.project(at)
    shaft = camera.project(length * force / size) if size > 0 else np.zeros(2)
    outline = arrow_outline(tip - shaft, tip, 0.1 * length)
    return Stroke(outline, camera.depth(at), FORCE_COLOR, 1.4, FORCE_COLOR)


FORCE_COLOR = "#7A3B00"
"""Of springs and applied forces."""


def mechanism_strokes(
    mechanism: Mechanism, pose: MechanismPose, camera: Camera, colors: dict[str, str], s: float, frames: bool
) -> Iterator[list[Stroke]]:
    """All strokes in groups: bodies, force elements, joints, and body axes where they are asked for."""
    bar = 4.6 if len(mechanism.bodies) <= 8 else 3.2
    for body in mechanism.bodies:
        yield body_strokes(body, pose, camera, colors[body.name], s, bar)
    for name in mechanism.forces:
        if strokes := force_strokes(name, mechanism, pose, camera, s):
            yield strokes
    for joint in mechanism.joints.values():
        yield joint_strokes(joint, pose, camera, s, mechanism.hangs(joint))
    if frames:
        yield from (triad_strokes(body.name, pose, camera, 3.2 * s) for body in mechanism.bodies)

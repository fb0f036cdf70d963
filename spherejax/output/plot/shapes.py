"""Bodies on paper: bars between their points, a box where there are too few, centers of mass and body axes."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from spherejax.output.plot.camera import Camera
from spherejax.output.plot.mechanism import DrawnBody, MechanismPose
from spherejax.output.plot.strokes import BREAK, CIRCLE, INK, PAPER, Stroke, box_faces, convex_hull, convex_hull_order


def body_strokes(
    body: DrawnBody, pose: MechanismPose, camera: Camera, color: str, s: float, bar: float
) -> list[Stroke]:
    """A body: its points joined by bars, the area between them tinted; a box where there are too few points.

    Args:
        body: the body.
        pose: where everything is.
        camera: from where it is seen.
        color: of the body.
        s: size of symbols [m].
        bar: width of a bar [point].
    """
    center = pose.positions[body.name]
    places = pose.point(body.name, body.places)
    depth = camera.depth(np.vstack([places, center]))
    bars = bars_of(places, center, body.places)
    lines = [camera.project(np.array(line)) for line in bars]
    strokes = []
    if len(places) < 2:
        strokes += _box_strokes(body, pose, camera, color, depth)
    if len(places) > 2:
        corners = np.concatenate([np.array(line) for line in bars])
        strokes.append(Stroke(convex_hull(camera.project(corners)), depth, "none", 0.0, color, 0.18))
    if lines:
        joined = np.concatenate([row for line in lines for row in (line, BREAK)][:-1])
        strokes.append(Stroke(_between_joints(joined, 1.3 * s), depth, PAPER, bar + 2.6))
        strokes.append(Stroke(joined, depth, color, bar))
    strokes += _center_of_mass(camera.project(center), depth, 0.42 * s)
    return [replace(stroke, name=f"body:{body.name}") for stroke in strokes]


def _between_joints(line: np.ndarray, gap: float) -> np.ndarray:
    """The pieces of a line without their ends: where bars cross, the front one is set off; where they join, none is."""
    pieces = []
    for a, b in pairwise(line):
        length = float(np.linalg.norm(b - a))
        share = min(gap / length, 0.5) if length > 0 else 0.5
        pieces.append(np.array([a + share * (b - a), b - share * (b - a)]))
    return np.concatenate([row for piece in pieces for row in (piece, BREAK)][:-1])


def bars_of(places: np.ndarray, center: np.ndarray, local: np.ndarray) -> list[list[np.ndarray]]:
    """Which points of a body are joined; chosen in body axes, so that the choice is the same at all times."""
    if len(places) == 0:
        return []
    if len(places) == 1:
        return [[places[0], center]]
    middle = local.mean(axis=0)
    sizes, axes = np.linalg.svd(local - middle, full_matrices=False)[1:]
    n_dimensions = int(np.sum(sizes > 1e-3 * sizes[0]))
    along = (local - middle) @ axes.T
    own = -middle @ axes.T  # the center of mass in the same directions
    beside = float(np.linalg.norm(middle + own[:n_dimensions] @ axes[:n_dimensions]))
    if n_dimensions == 1:  # points in a row
        order = np.argsort(along[:, 0])
        foot = place_in_row(places[order], center)
        return [[places[i] for i in order], *([[foot, center]] if beside > OFF_LINE * sizes[0] else [])]
    order = convex_hull_order(along[:, :2])
    is_plate = n_dimensions == 2 and len(order) == len(places) and beside < OFF_PLANE * sizes[0]
    if is_plate and _is_inside(own[:2], along[order, :2], OFF_PLANE * sizes[0]):
        return [[places[i] for i in (*order, order[0])]]
    return [[center, place] for place in places]


OFF_LINE, OFF_PLANE = 0.02, 0.1
"""A center of mass that is farther from the line or the area of its body's points, as a share of the body's size, is
joined to them."""


def _is_inside(point: np.ndarray, corners: np.ndarray, tolerance: float) -> bool:
    """Whether a point lies in a convex outline, counterclockwise, or not farther than `room` outside of it."""
    sides = np.roll(corners, -1, axis=0) - corners
    outward = np.stack([sides[:, 1], -sides[:, 0]], -1) / np.linalg.norm(sides, axis=1, keepdims=True)
    return bool(np.all(np.sum((point - corners) * outward, axis=1) < tolerance))


def place_in_row(row: np.ndarray, center: np.ndarray) -> np.ndarray:
    """The place between the ends of a row of points that is nearest to the center of mass."""
    side = row[-1] - row[0]
    share = np.clip((center - row[0]) @ side / (side @ side), 0.0, 1.0)
    return row[0] + share * side


def _box_strokes(body: DrawnBody, pose: MechanismPose, camera: Camera, color: str, depth: float) -> list[Stroke]:
    """The three faces, towards the viewer, of the uniform box with the body's inertia."""
    axes = pose.rotations[body.name] @ body.box_axes
    return box_faces(pose.positions[body.name], axes * body.half_sides, camera, color, depth, alpha=0.35)


def _center_of_mass(at: np.ndarray, depth: float, radius: float) -> list[Stroke]:
    """The quartered circle."""
    quarter = CIRCLE[:9], CIRCLE[16:25]
    quarters = np.concatenate([np.zeros((1, 2)), quarter[0], np.zeros((1, 2)), quarter[1], np.zeros((1, 2))])
    return [
        Stroke(at + radius * CIRCLE, depth, INK, 0.6, PAPER),
        Stroke(at + radius * quarters, depth, "none", 0.0, INK),
    ]


def triad_strokes(body: str, pose: MechanismPose, camera: Camera, length: float) -> list[Stroke]:
    """The body's axes at its center of mass: x red, y green, z blue."""
    center, rotation = pose.positions[body], pose.rotations[body]
    ends = [np.array([center, center + length * rotation[:, i]]) for i in range(3)]
    return [
        Stroke(camera.project(end), camera.depth(end), color, 1.3, name=f"frame:{body}")
        for end, color in zip(ends, AXIS_COLORS, strict=True)
    ]


AXIS_COLORS = ("#CC3311", "#117733", "#0044AA")
"""Of x, y and z."""

"""Joints on paper: a symbol for each kind, and hatched ground."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from spherejax.output.plot.camera import Camera
from spherejax.output.plot.mechanism import DrawnJoint, MechanismPose
from spherejax.output.plot.strokes import (
    CIRCLE,
    INK,
    PAPER,
    Stroke,
    arrow_outline,
    box_faces,
    convex_hull,
    ground_marks,
)
from spherejax.output.plot.style import MODEL_COLORS
from spherejax.physics.bodies import GROUND


def joint_strokes(joint: DrawnJoint, pose: MechanismPose, camera: Camera, s: float, hangs: bool) -> list[Stroke]:
    """The symbol of a joint; a diamond for a kind without a symbol of its own.

    Args:
        joint: the joint.
        pose: where everything is.
        camera: from where it is seen.
        s: size of symbols [m].
        hangs: whether the ground, where it is one of the bodies, is above the joint.
    """
    ends = [pose.point(body, place) for body, place in zip(joint.bodies, joint.places, strict=True)]
    axes = [pose.direction(joint.bodies[i], axis) for i, axis in joint.axes]
    ground = _ground_strokes(joint, ends, camera, -s if hangs else s)
    strokes = [*ground, *symbol_strokes(joint, ends, axes, camera, s)]
    depth = camera.depth(np.array(ends))
    return [replace(stroke, depth=depth, name=stroke.name or f"joint:{joint.name}") for stroke in strokes]


def symbol_strokes(joint: DrawnJoint, ends: list, axes: list, camera: Camera, s: float) -> list[Stroke]:
    """The symbol alone.

    Args:
        joint: the joint, for its kind and model.
        ends: its point on each body, world axes [m].
        axes: its directions in world axes.
        camera: from where it is seen.
        s: size of symbols [m].
    """
    return SYMBOLS.get(joint.kind, _unknown)(joint, ends, axes, camera, s)


def _ground_strokes(joint: DrawnJoint, ends: list[np.ndarray], camera: Camera, s: float) -> list[Stroke]:
    """Hatching below a joint's point on the ground."""
    if GROUND not in joint.bodies or joint.kind.endswith("Driver") or joint.kind == "PointOnPlane":
        return []
    at = camera.project(ends[joint.bodies.index(GROUND)])
    return [replace(stroke, name=f"ground:{joint.name}") for stroke in ground_marks(at, s)]


def model_color(model) -> str:
    """The color of a spherical joint's model, as in the other figures."""
    name = type(model).__name__.lower()
    if name == "dry" and getattr(model, "friction", None) is not None:
        name = "friction"
    return MODEL_COLORS.get(name, "#E69F00")


def _spherical(joint, ends, axes, camera, s) -> list[Stroke]:
    """A ball in a ring; the ring in the color of the joint's model where that is not ideal."""
    at = camera.project(ends[0])
    is_ideal = joint.model is None or joint.model.is_ideal
    ring, ball = (INK, INK) if is_ideal else (model_color(joint.model), model_color(joint.model))
    return [
        Stroke(at + s * CIRCLE, 0.0, ring, 1.2 if is_ideal else 1.8, PAPER),
        Stroke(at + 0.5 * s * CIRCLE, 0.0, "none", 0.0, ball),
    ]


def _revolute(joint, ends, axes, camera, s) -> list[Stroke]:
    """A short cylinder about the axis; seen along it, two circles."""
    if not axes:
        return _unknown(joint, ends, axes, camera, s)
    axis, rim = axes[0], _rim(axes[0], 0.85 * s)
    front = axis if axis @ camera.toward >= 0 else -axis
    caps = [camera.project(ends[0] + sign * 1.15 * s * front + rim) for sign in (-1, 1)]
    center = camera.project(np.array([ends[0] - 2.6 * s * axis, ends[0] + 2.6 * s * axis]))
    return [
        Stroke(center, 0.0, INK, 0.8, dashes=(0, (6, 2, 1, 2))),
        Stroke(convex_hull(np.concatenate(caps)), 0.0, INK, 1.1, "0.93"),
        Stroke(caps[1], 0.0, INK, 0.9, PAPER),
        Stroke(camera.project(ends[0] + 1.15 * s * front) + 0.18 * s * CIRCLE, 0.0, "none", 0.0, INK),
    ]


def _rim_of_bearing(joint, ends, axes, camera, s) -> list[Stroke]:
    """A ring about the axis with a disc in it, in the color of the joint's model."""
    if not axes:
        return _unknown(joint, ends, axes, camera, s)
    is_ideal = joint.model is None or joint.model.is_ideal
    color = INK if is_ideal else model_color(joint.model)
    ring, disc = (camera.project(ends[0] + _rim(axes[0], radius * s)) for radius in (1.0, 0.55))
    return [Stroke(ring, 0.0, color, 1.2 if is_ideal else 1.8, PAPER), Stroke(disc, 0.0, "none", 0.0, color)]


def _cylindrical(joint, ends, axes, camera, s) -> list[Stroke]:
    """A revolute's cylinder on a rod along which it slides."""
    if not axes:
        return _unknown(joint, ends, axes, camera, s)
    return [_rod(ends[0], axes[0], camera, 3.4 * s), *_revolute(joint, ends, axes, camera, s)[1:]]


def _prismatic(joint, ends, axes, camera, s) -> list[Stroke]:
    """A box on a rod along which it slides."""
    if not axes:
        return _unknown(joint, ends, axes, camera, s)
    first, second = perpendiculars(axes[0])
    half = s * np.stack([1.5 * axes[0], 0.8 * first, 0.8 * second], -1)
    return [_rod(ends[0], axes[0], camera, 3.4 * s), *box_faces(ends[0], half, camera, INK, 0.0, alpha=0.12)]


def _universal(joint, ends, axes, camera, s) -> list[Stroke]:
    """The cross of the two axes in a ring."""
    at = camera.project(ends[0])
    strokes = [Stroke(at + s * CIRCLE, 0.0, INK, 1.1, PAPER)]
    for axis in axes[:2]:
        strokes.append(Stroke(camera.project(ends[0] + np.outer([-1.5 * s, 1.5 * s], axis)), 0.0, INK, 1.8))
    return strokes


def _fixed(joint, ends, axes, camera, s) -> list[Stroke]:
    """A filled square."""
    square = 0.75 * s * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    return [Stroke(camera.project(ends[0]) + square, 0.0, INK, 0.8, INK)]


def _same_orientation(joint, ends, axes, camera, s) -> list[Stroke]:
    """An open square on the first body, and a smaller one on the second: their places are free."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    return [
        Stroke(camera.project(ends[0]) + 0.95 * s * corners, 0.0, INK, 1.1, PAPER),
        Stroke(camera.project(ends[1]) + 0.5 * s * corners, 0.0, INK, 1.1, PAPER),
    ]


def _parallel_axes(joint, ends, axes, camera, s) -> list[Stroke]:
    """Two parallel lines along the common direction, one on each body; seen along it, two dots."""
    if len(axes) < 2:
        return _unknown(joint, ends, axes, camera, s)
    lines = []
    for end, axis, side in zip(ends, axes, (0.4, -0.4), strict=True):
        along = camera.project(axis)
        length = float(np.linalg.norm(along))
        across = np.array([-along[1], along[0]]) / length if length > 1e-6 else np.array([0.0, 1.0])
        at = camera.project(end) + side * s * across
        lines.append(Stroke(at + np.outer([-1.9 * s, 1.9 * s], along), 0.0, INK, 1.8))
        lines.append(Stroke(at + 0.25 * s * CIRCLE, 0.0, "none", 0.0, INK))
    return lines


def _perpendicular_axes(joint, ends, axes, camera, s) -> list[Stroke]:
    """A line along the direction of each body, and the mark of a right angle between them."""
    if len(axes) < 2:
        return _unknown(joint, ends, axes, camera, s)
    first, second = axes
    mark = ends[0] + 0.7 * s * np.array([first, first + second, second])
    lines = [
        Stroke(camera.project(end + np.outer([-1.9 * s, 1.9 * s], axis)), 0.0, INK, 1.8)
        for end, axis in zip(ends, axes, strict=True)
    ]
    return [*lines, Stroke(camera.project(mark), 0.0, INK, 0.9)]


def _distance(joint, ends, axes, camera, s) -> list[Stroke]:
    """A thin link between two small balls."""
    first, second = (camera.project(end) for end in ends)
    return [
        Stroke(np.array([first, second]), 0.0, PAPER, 3.4),
        Stroke(np.array([first, second]), 0.0, INK, 1.6),
        *(Stroke(at + 0.5 * s * CIRCLE, 0.0, INK, 1.0, PAPER) for at in (first, second)),
    ]


def _on_plane(joint, ends, axes, camera, s) -> list[Stroke]:
    """A patch of the plane around the point that stays in it."""
    if not axes:
        return _unknown(joint, ends, axes, camera, s)
    first, second = perpendiculars(axes[0])
    corners = [ends[1] + 2.1 * s * (p * first + q * second) for p, q in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))]
    normal = np.array([ends[1], ends[1] + 2.2 * s * axes[0]])
    return [
        Stroke(camera.project(np.array(corners)), 0.0, INK, 0.7, "0.9", 0.8),
        Stroke(camera.project(normal), 0.0, INK, 0.9),
        Stroke(camera.project(ends[1]) + 0.5 * s * CIRCLE, 0.0, INK, 1.0, PAPER),
    ]


def _rotation_driver(joint, ends, axes, camera, s) -> list[Stroke]:
    """An arc with an arrow around the joint that is driven."""
    angle = np.radians(np.linspace(-60.0, 200.0, 41))
    arc = camera.project(ends[0]) + 2.0 * s * np.stack([np.cos(angle), np.sin(angle)], -1)
    tip = arc[-1] + 0.9 * s * np.array([-np.sin(angle[-1]), np.cos(angle[-1])])
    return [
        Stroke(arc, 0.0, DRIVER_COLOR, 1.4),
        Stroke(arrow_outline(arc[-1], tip, 0.5 * s), 0.0, DRIVER_COLOR, 0.8, DRIVER_COLOR),
    ]


def _translation_driver(joint, ends, axes, camera, s) -> list[Stroke]:
    """An arrow along the axis, beside the point that is driven."""
    along = camera.project(axes[0]) if axes else np.array([1.0, 0.0])
    length = float(np.linalg.norm(along))
    across = np.array([-along[1], along[0]]) / length if length > 0 else np.array([0.0, 1.0])
    at = camera.project(ends[1]) + 1.7 * s * across
    arrow = arrow_outline(at - 2.4 * s * along, at + 2.4 * s * along, 0.5 * s)
    return [Stroke(arrow, 0.0, DRIVER_COLOR, 1.4, DRIVER_COLOR)]


def _position_driver(joint, ends, axes, camera, s) -> list[Stroke]:
    """A cross in a ring."""
    at = camera.project(ends[1])
    cross = 1.5 * s * np.array([[-1, 0], [1, 0], [np.nan, np.nan], [0, -1], [0, 1]])
    return [Stroke(at + 0.9 * s * CIRCLE, 0.0, DRIVER_COLOR, 1.2, PAPER), Stroke(at + cross, 0.0, DRIVER_COLOR, 1.2)]


def _distance_driver(joint, ends, axes, camera, s) -> list[Stroke]:
    """The link of a distance, in the color of what is driven."""
    return [
        replace(stroke, edge=DRIVER_COLOR if stroke.edge == INK else stroke.edge)
        for stroke in _distance(joint, ends, axes, camera, s)
    ]


def _on_curve(joint, ends, axes, camera, s) -> list[Stroke]:
    """A point on a piece of a curve."""
    x = np.linspace(-2.4, 2.4, 25)
    curve = s * np.stack([x, 0.12 * x * x], -1)
    at = camera.project(ends[1])
    return [Stroke(at + curve, 0.0, INK, 1.0), Stroke(at + 0.5 * s * CIRCLE, 0.0, INK, 1.0, PAPER)]


def _on_circle(joint, ends, axes, camera, s) -> list[Stroke]:
    """A thin arm from the circle's center, and a small piece of the curve at the point."""
    return [*_distance(joint, ends, axes, camera, s), *_on_curve(joint, ends, axes, camera, s)]


DRIVER_COLOR = "#882255"
"""Of what is prescribed as a function of time."""


def _unknown(joint, ends, axes, camera, s) -> list[Stroke]:
    """A diamond, with its axes."""
    diamond = 1.05 * s * np.array([[-1, 0], [0, -1], [1, 0], [0, 1], [-1, 0]])
    lines = [
        Stroke(camera.project(ends[0] + np.outer([-2.6 * s, 2.6 * s], axis)), 0.0, INK, 0.8, dashes=(0, (6, 2, 1, 2)))
        for axis in axes
    ]
    return [*lines, Stroke(camera.project(ends[0]) + diamond, 0.0, INK, 1.1, PAPER)]


SYMBOLS: dict[str, Callable[..., list[Stroke]]] = {
    "Spherical": _spherical,
    "Revolute": _revolute,
    "Rim": _rim_of_bearing,
    "Cylindrical": _cylindrical,
    "Prismatic": _prismatic,
    "Universal": _universal,
    "Fixed": _fixed,
    "SameOrientation": _same_orientation,
    "ParallelAxes": _parallel_axes,
    "PerpendicularAxes": _perpendicular_axes,
    "Distance": _distance,
    "PointOnPlane": _on_plane,
    "PointOnCurve": _on_curve,
    "PointOnCircle": _on_circle,
    "RotationDriver": _rotation_driver,
    "TranslationDriver": _translation_driver,
    "PositionDriver": _position_driver,
    "DistanceDriver": _distance_driver,
}
"""Symbols by the kind of joint."""


def _rod(center: np.ndarray, axis: np.ndarray, camera: Camera, half_length: float) -> Stroke:
    return Stroke(camera.project(center + np.outer([-half_length, half_length], axis)), 0.0, INK, 2.0)


def _rim(axis: np.ndarray, radius: float) -> np.ndarray:
    first, second = perpendiculars(axis)
    return radius * (CIRCLE[:, :1] * first + CIRCLE[:, 1:] * second)


def perpendiculars(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two directions that make a right-handed triad with a unit vector before them."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(axis, helper)
    first = first / np.linalg.norm(first)
    return first, np.cross(axis, first)

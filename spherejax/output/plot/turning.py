"""A mechanism as shapes that a viewer moves: lines, faces and round symbols, each fixed to a body.

What `symbols`, `shapes` and `elements` draw on paper for one camera stands here in space, so that it can be turned: a
shape has an anchor on a body and corners in the axes of a body, and a pose of all bodies places it. What is fixed to no
body (a road that moves, the arrow of a force) has corners of its own at instants of the motion. The shapes are plain
lists of numbers, for JSON.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.colors import to_hex

from spherejax.output.plot.elements import FORCE_COLOR, forces_on_bodies
from spherejax.output.plot.mechanism import DrawnBody, DrawnJoint, Mechanism, MechanismPose
from spherejax.output.plot.reading import force_places, pitch_circles
from spherejax.output.plot.shapes import bars_of
from spherejax.output.plot.strokes import CIRCLE, GROUND_COLOR, INK, PAPER
from spherejax.output.plot.symbols import DRIVER_COLOR, model_color, perpendiculars
from spherejax.physics.bodies import GROUND
from spherejax.physics.forces.torsional import AbstractTorsionalForce
from spherejax.physics.forces.tyre import Tyre

Shape = dict[str, Any]

MOST_TRACK_INSTANTS = 151
"""Instants at which roads and arrows of forces are asked for: each asks the element once."""

CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def shapes_of(mechanism: Mechanism, colors: dict[str, str], s: float) -> list[Shape]:
    """All shapes of a mechanism, in groups (a body, a force, a joint) and bands: ground, bodies, forces, joints.

    As on paper, a band is drawn before the next one, and within it what is nearer to the viewer later.

    Args:
        mechanism: what is drawn.
        colors: of the bodies.
        s: size of symbols [m].
    """
    maker = _Maker({GROUND: -1, **{body.name: i for i, body in enumerate(mechanism.bodies)}}, s)
    found: list[Shape] = []
    width = 4.6 if len(mechanism.bodies) <= 8 else 3.2
    groups = [
        *((1, maker.body(body, to_hex(colors[body.name]), width)) for body in mechanism.bodies),
        *((2, maker.force(name, force, mechanism)) for name, force in mechanism.forces.items()),
        *((3, maker.joint(joint, mechanism.hangs(joint))) for joint in mechanism.joints.values()),
    ]
    for number, (band, shapes) in enumerate(groups):
        found += [{**one, "group": number, "band": 0 if one["kind"] == "ground" else band} for one in shapes]
    return found


class _Maker:
    """Makes shapes for the bodies of one mechanism.

    Attributes:
        index: of the bodies in the viewer's data, -1 for the ground.
        s: size of symbols [m].
    """

    def __init__(self, index: dict[str, int], s: float):
        self.index, self.s = index, s

    def _shape(self, kind: str, body: str, at, corners: Any = (), frame: str | None = None, **look) -> Shape:
        """A shape with its anchor on a body, and corners from there in the axes of `frame`, by default the same."""
        own = {key: to_hex(value) if key in ("edge", "face") else value for key, value in look.items()}
        return {
            "kind": kind, "body": self.index[body], "at": _listed(at), "frame": self.index[frame or body],
            "corners": _listed(corners), **own,
        }  # fmt: skip

    # Bodies ------------------------------------------------------------------------------------------------------

    def body(self, body: DrawnBody, color: str, width: float) -> list[Shape]:
        """Bars, the area between them, a box where there are too few points, the center of mass, the name."""
        name, zero, found = body.name, np.zeros(3), []
        bars = [np.array(bar) for bar in bars_of(body.places, zero, body.places)]
        if len(body.places) < 2:
            found += self._box(name, zero, body.box_axes * body.half_sides, color, 0.35)
        if len(body.places) > 2:
            found.append(self._shape("hull", name, zero, np.concatenate(bars), face=color, alpha=0.18))
        found += [self._shape("line", name, zero, bar, edge=color, width=width, rim=2.0) for bar in bars]
        middle = body.places.mean(axis=0) if len(body.places) > 1 else zero
        found.append(self._shape("center", name, zero, radius=0.42 * self.s))
        return [*found, self._shape("name", name, middle, text=name, edge=color)]

    def _box(self, body: str, at, half: np.ndarray, color: str, alpha: float) -> list[Shape]:
        """Six faces, of which the viewer leaves out those behind; half sides as columns, in the body's axes."""
        # Right-handed, so that outlines run counterclockwise from outside.
        half = half * [1.0, 1.0, 1.0 if np.linalg.det(half) >= 0 else -1.0]
        found = []
        for i in range(3):
            for side in (1.0, -1.0):
                outward, a, b = side * half[:, i], half[:, (i + 1) % 3], side * half[:, (i + 2) % 3]
                corners = [outward + p * a + q * b for p, q in CORNERS]
                look = {"edge": color, "face": color, "alpha": alpha * (0.5 + 0.25 * i)}
                found.append(self._shape("side", body, at, corners, **look))
        return found

    # Joints ------------------------------------------------------------------------------------------------------

    def joint(self, joint: DrawnJoint, hangs: bool) -> list[Shape]:
        """The symbol of a joint, the ground below it, its name."""
        s, (first, second) = self.s, joint.bodies
        at, other = joint.places
        found: list[Shape] = []
        if GROUND in joint.bodies and not joint.kind.endswith("Driver") and joint.kind != "PointOnPlane":
            place = joint.places[joint.bodies.index(GROUND)]
            found.append(self._shape("ground", GROUND, place, radius=-s if hangs else s, edge=GROUND_COLOR))
        make = SYMBOLS.get(joint.kind, _Maker._unknown)
        found += self._unknown(joint) if joint.kind in NEED_AXIS and not joint.axes else make(self, joint)
        link = joint.kind.startswith(("Distance", "PointOnCircle"))
        name = self._shape("name", second if not link else first, other if not link else at, text=joint.name, edge=INK)
        return [*found, name | {"quiet": True}]

    def _ball(self, body: str, at, radius: float, edge: str, face: str, width: float = 1.0) -> Shape:
        return self._shape("ball", body, at, radius=radius, edge=edge, face=face, width=width)

    def _spherical(self, joint: DrawnJoint) -> list[Shape]:
        """A ball in a ring, in the color of the joint's model."""
        is_ideal = joint.model is None or joint.model.is_ideal
        color = INK if is_ideal else model_color(joint.model)
        ring = self._ball(joint.bodies[0], joint.places[0], self.s, color, PAPER, 1.2 if is_ideal else 1.8)
        return [ring, self._ball(joint.bodies[1], joint.places[1], 0.5 * self.s, color, color)]

    def _axis_line(self, joint: DrawnJoint, i: int, half: float, **look) -> Shape:
        which, axis = joint.axes[i]
        line = np.outer([-half, half], axis)
        return self._shape("line", joint.bodies[which], joint.places[which], line, **look)

    def _rim(self, joint: DrawnJoint) -> list[Shape]:
        """A ring about the axis with a disc in it, in the color of the joint's model."""
        which, axis = joint.axes[0]
        across, along = perpendiculars(axis)
        circle = CIRCLE[:-1, :1] * across + CIRCLE[:-1, 1:] * along
        is_ideal = joint.model is None or joint.model.is_ideal
        color, body, at = INK if is_ideal else model_color(joint.model), joint.bodies[which], joint.places[which]
        ring, disc = self.s * circle, 0.55 * self.s * circle
        return [
            self._shape("side", body, at, ring, edge=color, face=PAPER, alpha=1.0, width=1.2 if is_ideal else 1.8),
            self._shape("side", body, at, disc, edge=color, face=color, alpha=1.0),
        ]

    def _cylinder(self, joint: DrawnJoint) -> list[Shape]:
        which, axis = joint.axes[0]
        across, along = perpendiculars(axis)
        rim = 0.85 * self.s * (CIRCLE[:-1, :1] * across + CIRCLE[:-1, 1:] * along)
        caps = [rim - 1.15 * self.s * axis, rim + 1.15 * self.s * axis]
        body, at = joint.bodies[which], joint.places[which]
        return [
            self._shape("hull", body, at, np.concatenate(caps), edge=INK, face="0.93", alpha=1.0, width=1.1),
            *(self._shape("side", body, at, cap, edge=INK, face=PAPER, alpha=1.0) for cap in (caps[0][::-1], caps[1])),
        ]

    def _revolute(self, joint: DrawnJoint) -> list[Shape]:
        """A short cylinder about the axis."""
        return [self._axis_line(joint, 0, 2.6 * self.s, edge=INK, width=0.8, dashed=True), *self._cylinder(joint)]

    def _cylindrical(self, joint: DrawnJoint) -> list[Shape]:
        """A revolute's cylinder on a rod along which it slides."""
        return [self._axis_line(joint, 0, 3.4 * self.s, edge=INK, width=2.0), *self._cylinder(joint)]

    def _prismatic(self, joint: DrawnJoint) -> list[Shape]:
        """A box on a rod along which it slides."""
        which, axis = joint.axes[0]
        across, along = perpendiculars(axis)
        half = self.s * np.stack([1.5 * axis, 0.8 * across, 0.8 * along], -1)
        box = self._box(joint.bodies[which], joint.places[which], half, INK, 0.12)
        return [self._axis_line(joint, 0, 3.4 * self.s, edge=INK, width=2.0), *box]

    def _universal(self, joint: DrawnJoint) -> list[Shape]:
        """The cross of the two axes in a ring."""
        ring = self._ball(joint.bodies[0], joint.places[0], self.s, INK, PAPER, 1.1)
        n = min(len(joint.axes), 2)
        return [ring, *(self._axis_line(joint, i, 1.5 * self.s, edge=INK, width=1.8) for i in range(n))]

    def _fixed(self, joint: DrawnJoint) -> list[Shape]:
        """A filled square."""
        return [self._shape("square", joint.bodies[0], joint.places[0], radius=0.75 * self.s, edge=INK, face=INK)]

    def _same_orientation(self, joint: DrawnJoint) -> list[Shape]:
        """An open square on the first body, and a smaller one on the second."""
        ends = zip(joint.bodies, joint.places, (0.95, 0.5), strict=True)
        return [self._shape("square", body, at, radius=size * self.s, edge=INK, face=PAPER) for body, at, size in ends]

    def _parallel_axes(self, joint: DrawnJoint) -> list[Shape]:
        """Two parallel lines along the common direction, one on each body."""
        sides = []
        for (which, axis), side in zip(joint.axes, (0.4, -0.4), strict=True):
            across, _ = perpendiculars(axis)
            line = side * self.s * across + np.outer([-1.9 * self.s, 1.9 * self.s], axis)
            sides.append(self._shape("line", joint.bodies[which], joint.places[which], line, edge=INK, width=1.8))
        return sides

    def _perpendicular_axes(self, joint: DrawnJoint) -> list[Shape]:
        """A line along the direction of each body."""
        return [self._axis_line(joint, i, 1.9 * self.s, edge=INK, width=1.8) for i in range(2)]

    def _link(self, ends: Sequence[tuple[str, Any]], color: str, **look) -> Shape:
        (first, at), (second, other) = ends
        shape = self._shape("link", first, at, edge=color, **look)
        return shape | {"body2": self.index[second], "at2": _listed(other)}

    def _distance(self, joint: DrawnJoint, color: str = INK) -> list[Shape]:
        """A thin link between two small balls."""
        ends = list(zip(joint.bodies, joint.places, strict=True))
        balls = [self._ball(body, at, 0.5 * self.s, color, PAPER) for body, at in ends]
        return [self._link(ends, color, width=1.6), *balls]

    def _point_on_plane(self, joint: DrawnJoint) -> list[Shape]:
        """A patch of the plane around the point that stays in it."""
        which, axis = joint.axes[0]
        across, along = perpendiculars(axis)
        corners = [2.1 * self.s * (p * across + q * along) for p, q in CORNERS]
        body, at, frame = joint.bodies[1], joint.places[1], joint.bodies[which]
        return [
            self._shape("face", body, at, corners, frame, edge=INK, face="0.9", alpha=0.8),
            self._shape("line", body, at, [np.zeros(3), 2.2 * self.s * axis], frame, edge=INK, width=0.9),
            self._ball(body, at, 0.5 * self.s, INK, PAPER),
        ]

    def _point_on_curve(self, joint: DrawnJoint) -> list[Shape]:
        """A point that stays on a curve, which nothing tells where it runs."""
        return [self._ball(joint.bodies[1], joint.places[1], 0.5 * self.s, INK, PAPER)]

    def _rotation_driver(self, joint: DrawnJoint) -> list[Shape]:
        """An arc with an arrow around the joint that is driven; about its axis where that is known."""
        angle = np.radians(np.linspace(-60.0, 200.0, 27))
        if not joint.axes:
            return [self._ball(joint.bodies[0], joint.places[0], 2.0 * self.s, DRIVER_COLOR, "none", 1.4)]
        which, axis = joint.axes[0]
        across, along = perpendiculars(axis)
        arc = 2.0 * self.s * (np.outer(np.cos(angle), across) + np.outer(np.sin(angle), along))
        body, at = joint.bodies[which], joint.places[which]
        return [self._shape("line", body, at, arc, edge=DRIVER_COLOR, width=1.4, arrow=True)]

    def _translation_driver(self, joint: DrawnJoint) -> list[Shape]:
        """An arrow along the axis, beside the point that is driven."""
        which, axis = joint.axes[0]
        across, _ = perpendiculars(axis)
        arrow = 1.7 * self.s * across + np.outer([-2.4 * self.s, 2.4 * self.s], axis)
        look = {"edge": DRIVER_COLOR, "width": 1.4, "arrow": True}
        return [self._shape("line", joint.bodies[1], joint.places[1], arrow, joint.bodies[which], **look)]

    def _position_driver(self, joint: DrawnJoint) -> list[Shape]:
        """A ring."""
        return [self._ball(joint.bodies[1], joint.places[1], 0.9 * self.s, DRIVER_COLOR, PAPER, 1.2)]

    def _distance_driver(self, joint: DrawnJoint) -> list[Shape]:
        """The link of a distance, in the color of what is driven."""
        return self._distance(joint, DRIVER_COLOR)

    def _unknown(self, joint: DrawnJoint) -> list[Shape]:
        """A diamond, with its axes."""
        look = {"edge": INK, "width": 0.8, "dashed": True}
        lines = [self._axis_line(joint, i, 2.6 * self.s, **look) for i in range(len(joint.axes))]
        at = joint.bodies[0], joint.places[0]
        return [*lines, self._shape("diamond", *at, radius=1.05 * self.s, edge=INK, face=PAPER)]

    # Forces ------------------------------------------------------------------------------------------------------

    def force(self, name: str, force: Any, mechanism: Mechanism) -> Iterator[Shape]:
        """A force element: a tyre, a zigzag or a motor between two points, a spiral, pitch circles, or nothing.

        Roads and arrows are tracks.
        """
        if isinstance(force, Tyre):
            body, radius = force.center.partition(".")[0], float(np.asarray(force.radius))
            wheel = radius * np.stack([CIRCLE[:, 0], np.zeros(len(CIRCLE)), CIRCLE[:, 1]], -1)
            yield self._shape("face", body, force.place, wheel, edge="0.2", face="0.6", alpha=0.12, width=4.0)
        elif isinstance(force, AbstractTorsionalForce):
            bodies = set(force.bodies)
            joint = next((one for one in mechanism.joints.values() if set(one.bodies) == bodies), None)
            second = force.bodies[1] if force.bodies[1] != GROUND else force.bodies[0]
            body, at = (second, np.zeros(3)) if joint is None else (joint.bodies[0], joint.places[0])
            yield self._shape("spiral", body, at, radius=2.5 * self.s, edge=FORCE_COLOR)
        elif circles := pitch_circles(force, mechanism):
            for body, at, ring in circles:
                yield self._shape("face", body, at, ring, edge=FORCE_COLOR, face=FORCE_COLOR, alpha=0.06, width=1.4)
        elif len(places := force_places(force)) == 2:
            for body, at in places:
                if body == GROUND:
                    yield self._shape("ground", GROUND, at, radius=0.8 * self.s, edge=GROUND_COLOR)
            symbol = {"barrel": 0.55 * self.s} if force.is_motor else {"zigzag": 0.9 * self.s}
            yield self._link(places, FORCE_COLOR, width=1.3, **symbol)


SYMBOLS: dict[str, Callable[[_Maker, DrawnJoint], list[Shape]]] = {
    "Spherical": _Maker._spherical,
    "Revolute": _Maker._revolute,
    "Rim": _Maker._rim,
    "Cylindrical": _Maker._cylindrical,
    "Prismatic": _Maker._prismatic,
    "Universal": _Maker._universal,
    "Fixed": _Maker._fixed,
    "SameOrientation": _Maker._same_orientation,
    "ParallelAxes": _Maker._parallel_axes,
    "PerpendicularAxes": _Maker._perpendicular_axes,
    "Distance": _Maker._distance,
    "PointOnPlane": _Maker._point_on_plane,
    "PointOnCurve": _Maker._point_on_curve,
    "PointOnCircle": _Maker._distance,
    "RotationDriver": _Maker._rotation_driver,
    "TranslationDriver": _Maker._translation_driver,
    "PositionDriver": _Maker._position_driver,
    "DistanceDriver": _Maker._distance_driver,
}
"""Symbols by the kind of joint, as in `symbols`."""

NEED_AXIS = (
    "Revolute",
    "Rim",
    "Cylindrical",
    "Prismatic",
    "PointOnPlane",
    "TranslationDriver",
    "ParallelAxes",
    "PerpendicularAxes",
)
"""Kinds whose symbol has a direction; a joint of one's own may not tell it."""


def tracks_of(mechanism: Mechanism, ts: np.ndarray, s: float) -> list[Shape]:
    """Roads and arrows of forces: lines that follow no body, at instants of their own.

    Args:
        mechanism: what is drawn.
        ts: times of the viewer's frames [s], shape (n,).
        s: size of symbols [m].

    Returns:
        For each a color and `points`, world axes [m], shape (instants, corners, 3), evenly over the time of the frames.
    """
    found: list[Shape] = []
    times = np.linspace(ts[0], ts[-1], min(len(ts), MOST_TRACK_INSTANTS))
    poses = [mechanism.pose(float(t)) for t in times]
    for name, force in mechanism.forces.items():
        if isinstance(force, Tyre):
            found.append({"edge": to_hex(GROUND_COLOR), "width": 1.6, "points": _road(force, poses)})
        elif not isinstance(force, AbstractTorsionalForce) and len(force_places(force)) != 2:
            arrows = [[_arrow(at, pull, 5 * s) for at, pull in forces_on_bodies(name, force, pose)] for pose in poses]
            for one in zip(*arrows, strict=True):
                look = {"edge": to_hex(FORCE_COLOR), "width": 1.6, "arrow": True}
                found.append({**look, "points": np.array(one)})
    return found


def _road(force: Tyre, poses: Sequence[MechanismPose]) -> np.ndarray:
    """The road below a tyre, as far as a diameter to each side."""
    body, radius = force.center.partition(".")[0], float(np.asarray(force.radius))
    lines = []
    for pose in poses:
        center = pose.point(body, np.asarray(force.place, float))
        x = center[0] + 2 * radius * np.linspace(-1, 1, 41)
        lines.append(np.stack([x, np.full(41, center[1]), force.road_heights(x, pose.t)], -1))
    return np.array(lines)


def _arrow(at: np.ndarray, pull: np.ndarray, length: float) -> np.ndarray:
    """Tail and tip of an arrow of one length that ends where the force acts; a point without a force."""
    size = float(np.linalg.norm(pull))
    return np.array([at - length * pull / size if size > 0 else at, at])


def _listed(values: Any) -> list:
    """Numbers for JSON, to seven digits: what a picture shows is coarser."""
    return np.array([float(f"{x:.7g}") for x in np.ravel(np.asarray(values, float))]).reshape(np.shape(values)).tolist()

"""One panel in which a mechanism is drawn in space: strokes become artists once, and move with the pose."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import FuncFormatter, MaxNLocator
from matplotlib.transforms import ScaledTranslation

from spherejax.output.plot.camera import Camera, axis_name
from spherejax.output.plot.elements import mechanism_strokes
from spherejax.output.plot.mechanism import Mechanism, MechanismPose
from spherejax.output.plot.reading import force_places, pitch_circles
from spherejax.output.plot.shapes import AXIS_COLORS
from spherejax.output.plot.strokes import INK, Stroke
from spherejax.output.plot.style import dress
from spherejax.physics.forces.tyre import Tyre

SYMBOL_SHARE, SMALLEST_SHARE = 0.017, 0.005
"""Radius of a joint's symbol as a share of the drawing's size: the usual one, and the least."""

MARGIN = 0.09
"""Room around the mechanism, as a share of the drawing's size: symbols and ground marks are outside of the points."""

MANY_POSES = 400
"""Poses that are looked at when limits are chosen: more than any picture shows, fewer than a long run has."""

BODY_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#6A51A3", "#8C6D31")
"""Colors of bodies, in turn."""


@dataclass(frozen=True)
class Trace:
    """The path of a point over time.

    Attributes:
        body: the body that the point belongs to.
        place: the point, body axes [m].
        ts: sample times [s], shape (n,).
        path: the point at the samples, world axes [m], shape (n, 3).
        color: of the line.
    """

    body: str
    place: np.ndarray
    ts: np.ndarray
    path: np.ndarray
    color: str

    def until(self, pose: MechanismPose) -> np.ndarray:
        """The path up to a pose."""
        return np.vstack([self.path[self.ts < pose.t], pose.point(self.body, self.place)])


def colors_of(mechanism: Mechanism) -> dict[str, str]:
    """A color for each body."""
    return {body.name: BODY_COLORS[i % len(BODY_COLORS)] for i, body in enumerate(mechanism.bodies)}


def drawn_points(mechanism: Mechanism, poses: Sequence[MechanismPose]) -> np.ndarray:
    """All points that a drawing must enclose, world axes [m], shape (n, 3)."""
    found = [mechanism.ground_places]
    for pose in poses:
        for joint in mechanism.joints.values():
            found.extend(pose.point(body, place)[None] for body, place in zip(joint.bodies, joint.places, strict=True))
        for force in mechanism.forces.values():
            found.extend(pose.point(body, place)[None] for body, place in force_places(force))
            found.extend(pose.point(body, place + ring) for body, place, ring in pitch_circles(force, mechanism))
            if isinstance(force, Tyre):
                around = float(np.asarray(force.radius)) * np.array(np.meshgrid(*3 * [[-1.0, 1.0]])).reshape(3, -1).T
                found.append(pose.point(force.center.partition(".")[0], np.asarray(force.place, float) + around))
        for body in mechanism.bodies:
            found.append(pose.positions[body.name][None])
            found.append(pose.point(body.name, body.places))
            if len(body.places) < 2:
                corners = np.array(np.meshgrid(*3 * [[-1.0, 1.0]])).reshape(3, -1).T * body.half_sides
                found.append(pose.point(body.name, corners @ body.box_axes.T))
    return np.concatenate(found)


def poses_of(mechanism: Mechanism) -> list[MechanismPose]:
    """Poses all over the motion."""
    indices = np.unique(np.linspace(0, len(mechanism.ts) - 1, MANY_POSES).astype(int))
    return [mechanism.pose(float(mechanism.ts[i])) for i in indices]


def extent_of(points: np.ndarray) -> float:
    """The largest extent of points along a world axis [m]; 1 for a single point."""
    size = float(np.ptp(points, axis=0).max())
    return size if size > 0 else 1.0


def symbol_size(mechanism: Mechanism, points: np.ndarray) -> float:
    """Radius of the joints' symbols [m]: the same for all, and smaller where joints are close to each other."""
    size = extent_of(points)
    lengths = [
        np.linalg.norm(body.places - body.places.mean(axis=0), axis=1).max()
        for body in mechanism.bodies
        if len(body.places) > 1
    ]
    typical = float(np.median(lengths)) if lengths else size
    return float(np.clip(0.25 * typical, SMALLEST_SHARE * size, SYMBOL_SHARE * size))


class SpaceView:
    """A panel with a mechanism in it.

    Attributes:
        ax: the panel.
        camera: from where it is seen.
        artists: one for each stroke, in the order of `strokes`.
        turns: whether limits enclose all points from all sides, so that the view can be turned.
    """

    turns = False

    def __init__(
        self,
        ax: Axes,
        mechanism: Mechanism,
        camera: Camera,
        pose: MechanismPose,
        points: np.ndarray,
        *,
        frames: bool = False,
        traces: Sequence[Trace] = (),
    ):
        self.ax, self.mechanism, self.camera, self.frames = ax, mechanism, camera, frames
        self.size = symbol_size(mechanism, points)
        self.colors = colors_of(mechanism)
        self.traces = traces
        self.points = points
        self.trace_lines = [Line2D([], [], color=trace.color, lw=0.9, alpha=0.8, zorder=1.5) for trace in traces]
        for line in self.trace_lines:
            ax.add_line(line)
        self.corner = None if camera.is_axial else AxesCorner(ax, extent_of(points))
        if camera.is_axial:
            dress_axial(ax, camera, extent_of(points))
        self.artists = [patch_of(stroke) for group in self.strokes(pose) for stroke in group]
        for artist in self.artists:
            ax.add_patch(artist)
        self.look_from(camera, pose)

    def strokes(self, pose: MechanismPose) -> list[list[Stroke]]:
        """All strokes at a pose, in groups."""
        return list(mechanism_strokes(self.mechanism, pose, self.camera, self.colors, self.size, self.frames))

    def look_from(self, camera: Camera, pose: MechanismPose) -> None:
        """Take another camera, with limits that enclose all points."""
        self.camera = camera
        self.fit()
        self.update(pose)

    @property
    def least_scale(self) -> float:
        """Meters on paper for a pixel with which all points just fit into the panel."""
        low, high = self._extent()
        panel = self._panel()
        return float(np.max((high - low) / (panel - [0, self._strip()])))

    def fit(self, scale: float | None = None) -> None:
        """Limits that enclose all points with equal scales, filling the panel as the layout has made it.

        Args:
            scale: meters for a pixel, where several panels share it; the least that this panel needs by default.
        """
        scale = self.least_scale if scale is None else scale
        low, high = self._extent()
        panel, strip = self._panel(), self._strip()
        middle, half = 0.5 * (low + high) - [0, 0.5 * scale * strip], 0.5 * scale * panel
        self.ax.set_aspect("auto")
        self.ax.set_xlim(middle[0] - half[0], middle[0] + half[0])
        self.ax.set_ylim(middle[1] - half[1], middle[1] + half[1])
        self.ax.set_aspect("equal", adjustable="box")
        if self.corner is not None:
            self.corner.follow(self.camera, scale)

    def _extent(self) -> tuple[np.ndarray, np.ndarray]:
        if not self.turns:
            return _limits(self.camera.project(self.points), 3.2 * self.size)
        middle = 0.5 * (self.points.min(axis=0) + self.points.max(axis=0))
        radius = float(np.linalg.norm(self.points - middle, axis=1).max())
        center = self.camera.project(middle)
        return _limits(np.array([center - radius, center + radius]), 3.2 * self.size)

    def _panel(self) -> np.ndarray:
        """Width and height of the panel [pixel]."""
        panel = self.ax.get_position(original=True)
        return np.array([panel.width, panel.height]) * self.ax.figure.bbox.size

    def _strip(self) -> float:
        """Height that is kept free for world axes and scale bar [pixel]."""
        return 0.0 if self.corner is None else CORNER_HEIGHT * self.ax.figure.dpi

    @property
    def moving_artists(self) -> list[Artist]:
        """What `update` moves."""
        return [*self.artists, *self.trace_lines]

    def update(self, pose: MechanismPose) -> None:
        """Move everything to a pose."""
        groups = self.strokes(pose)
        ranks = {id(group): rank for rank, group in enumerate(sorted(groups, key=lambda group: group[0].depth))}
        flat = [(group, stroke) for group in groups for stroke in group]
        for artist, (group, stroke) in zip(self.artists, flat, strict=True):
            artist.set_path(Path(stroke.points))
            artist.set_zorder(_band(stroke.name) + ranks[id(group)] / (len(groups) + 1))
        for line, trace in zip(self.trace_lines, self.traces, strict=True):
            passed = self.camera.project(trace.until(pose))
            line.set_data(passed[:, 0], passed[:, 1])


def patch_of(stroke: Stroke) -> PathPatch:
    """The artist of a stroke."""
    artist = PathPatch(
        Path(stroke.points),
        edgecolor=stroke.edge,
        linewidth=stroke.width,
        facecolor="none",
        linestyle=stroke.dashes,
        capstyle="round",
        joinstyle="round",
        gid=stroke.name,
    )
    if stroke.face != "none":
        artist.set_facecolor((stroke.face, stroke.alpha))
    return artist


def _band(name: str) -> float:
    """What is drawn behind what, whatever the depth: ground, bodies, force elements, joints, frames."""
    return {"ground": 2.0, "body": 3.0, "force": 4.0, "joint": 5.0, "frame": 6.0}[name.partition(":")[0]]


def _limits(points: np.ndarray, least_size: float) -> tuple[np.ndarray, np.ndarray]:
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(float((high - low).max()), least_size, 1e-300)
    return low - least_size - 0.3 * MARGIN * size, high + least_size + 0.3 * MARGIN * size


# What surrounds the mechanism ------------------------------------------------------------------------------------


def dress_axial(ax: Axes, camera: Camera, size: float) -> None:
    """Scales along two world axes, in mm for a mechanism below a meter."""
    dress(ax)
    unit, factor = unit_for(size)
    for axis, direction in ((ax.xaxis, camera.right), (ax.yaxis, camera.up)):
        sign = -1.0 if axis_name(direction).startswith("-") else 1.0
        axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
        axis.set_major_formatter(FuncFormatter(lambda value, _, sign=sign: f"{sign * value * factor:.6g}"))
    ax.set_xlabel(f"{axis_name(camera.right).lstrip('-')} [{unit}]")
    ax.set_ylabel(f"{axis_name(camera.up).lstrip('-')} [{unit}]")
    ax.set_title(camera.title, loc="left", fontsize=9)


class Triad:
    """The world axes in a corner of a panel, as its camera sees them.

    Attributes:
        center: where they meet, from the panel's lower left corner [inch].
        length: of an axis along the paper [inch].
    """

    def __init__(self, ax: Axes, center: np.ndarray, length: float):
        self.center, self.length = center, length
        inches: Any = ax.figure.dpi_scale_trans
        corner: Any = ax.transAxes
        origin = inches + ScaledTranslation(0, 0, corner)
        self.axes = []
        for color in AXIS_COLORS:
            line = Line2D([], [], color=color, lw=1.6, transform=origin, solid_capstyle="round", zorder=9)
            ax.add_artist(line)
            name = ax.text(0, 0, "", color=color, fontsize=8, transform=origin, ha="center", va="center", zorder=9)
            self.axes.append((line, name))

    def follow(self, camera: Camera) -> None:
        """Point the axes as a camera sees them."""
        for (line, name), axis, letter in zip(self.axes, np.eye(3), "xyz", strict=True):
            tip = self.length * camera.project(axis)
            length = float(np.linalg.norm(tip))
            line.set_data(*np.transpose([self.center, self.center + tip]))
            # An axis towards the viewer is named beside its point.
            beside = tip * (1 + 0.1 / length) if length > 0.05 else np.array([-0.09, -0.09])
            name.set_position(tuple(self.center + beside))
            name.set_text(letter)


class AxesCorner:
    """What replaces scales in a spatial view: the world axes on the left, a bar of a round length on the right."""

    def __init__(self, ax: Axes, size: float):
        self.ax, self.length = ax, round_length(0.25 * size)
        ax.set_axis_off()
        self.triad = Triad(ax, TRIAD_CENTER, TRIAD_LENGTH)
        self.bar = Line2D([], [], color=INK, lw=2.2, solid_capstyle="butt", zorder=9, gid="scale bar")
        ax.add_line(self.bar)
        unit, factor = unit_for(size)
        text = f"{factor * self.length:.6g} {unit}"
        self.text = ax.annotate(
            text, (0, 0), (0, 3), textcoords="offset points", ha="center", va="bottom", fontsize=8, zorder=9
        )

    def boxes(self) -> list[np.ndarray]:
        """What is covered, as left, bottom, right, top [pixel]."""
        panel, inch = self.ax.get_window_extent(), self.ax.figure.dpi
        reach = (TRIAD_LENGTH + 0.15) * inch
        center = np.array([panel.x0, panel.y0]) + TRIAD_CENTER * inch
        text = self.text.get_window_extent()
        return [np.array([*(center - reach), *(center + reach)]), np.array(text.extents)]

    def follow(self, camera: Camera, scale: float) -> None:
        """Point the axes as a camera sees them, and lay the bar into the panel's limits.

        Args:
            camera: the view.
            scale: meters for a pixel.
        """
        self.triad.follow(camera)
        inch = scale * self.ax.figure.dpi
        right, height = self.ax.get_xlim()[1] - 0.12 * inch, self.ax.get_ylim()[0] + 0.12 * inch
        self.bar.set_data([right - self.length, right], [height, height])
        self.text.xy = (right - 0.5 * self.length, height)


CORNER_HEIGHT = 0.6
"""Height of the strip that a spatial view keeps free for its corner [inch]."""

TRIAD_CENTER, TRIAD_LENGTH = np.array([0.38, 0.26]), 0.26
"""Where the world axes meet, from the lower left corner, and their length [inch]."""


def unit_for(size: float) -> tuple[str, float]:
    """Unit of lengths, and the factor from meters: mm for what is smaller than a meter."""
    return ("mm", 1e3) if size < 1.0 else ("m", 1.0)


def round_length(length: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above a length."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(next(step * power for step in (5.0, 2.0, 1.0) if step * power <= length * (1 + 1e-12)))

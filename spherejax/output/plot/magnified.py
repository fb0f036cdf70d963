"""A joint with clearance beside the mechanism, magnified: the ball's center in the socket, its path, normal and force.

The angle is that of the projection on the panel's plane, the distance from the middle the true |e|, as in
`output.plot.eccentricity`: contact is on the circle, and only there. The plane is the one that holds most of the path.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import ConnectionPatch, PathPatch
from matplotlib.path import Path

from spherejax.foundations.errors import SceneError
from spherejax.output.plot.camera import Camera, world_directions
from spherejax.output.plot.elements import FORCE_COLOR
from spherejax.output.plot.key import LEAD_COLOR, LEAD_DASHES
from spherejax.output.plot.mechanism import Mechanism, MechanismPose
from spherejax.output.plot.space import SpaceView, Triad
from spherejax.output.plot.strokes import CIRCLE, INK, arrow_outline

FLIGHT, CONTACT = "#56B4E9", "#D55E00"
"""Colors of the ball's center, as in the figure of eccentricities."""

MOST_PANELS = 3
"""Joints that are magnified unless others are named: more would leave no room for the mechanism."""

SNAP = 0.94
"""A plane whose normal is within 20 degrees of a world axis is taken across that axis: its cosine."""

REACH = 1.42
"""Half width of the panel against the radius of the circle: room for wall, normal and force."""

ROUNDING = 1e-12
"""Of the largest force: what equations along a bearing leave in flight."""

LONGEST_PATH = 4000
"""Samples of a path that are drawn at most; a longer one is thinned."""


@dataclass(frozen=True)
class JointMotion:
    """The motion of a ball in its socket.

    Attributes:
        name: of the joint.
        ts: sample times [s], shape (n,).
        eccentricity: e, world axes [m], shape (n, 3).
        force: on the ball's body [N], shape (n, 3); None where it is not known.
        clearance: radial clearance [m]; None for a joint without one.
        penetration: of the surfaces [m], shape (n,); None: |e| - c.
    """

    name: str
    ts: np.ndarray
    eccentricity: np.ndarray
    force: np.ndarray | None
    clearance: float | None
    penetration: np.ndarray | None = None

    @property
    def radius(self) -> float:
        """Of the circle that is drawn [m]: the clearance, or the largest |e|."""
        if self.clearance is not None:
            return self.clearance
        return max(float(np.linalg.norm(self.eccentricity, axis=1).max()), 1e-12)

    def touches(self, t: float, distance: float) -> bool:
        """Whether the surfaces touch at a time at which the ball is so far from the middle [m]."""
        if self.clearance is None:
            return False
        if self.penetration is None:
            return distance >= self.clearance
        return bool(_between(self.ts, self.penetration[:, None], t)[0] >= 0.0)

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray | None]:
        """Eccentricity and force at a time, linear between samples; a force that is rounding beside others is none."""
        e = _between(self.ts, self.eccentricity, t)
        if self.force is None:
            return e, None
        force = _between(self.ts, self.force, t)
        return e, force if np.linalg.norm(force) > ROUNDING * np.abs(self.force).max() else 0.0 * force


def joints_to_magnify(mechanism: Mechanism, names: Sequence[str] | None) -> list[str]:
    """The joints that are asked for, or, of a run, the first ones that are not ideal.

    Raises:
        SceneError: for a name that is no joint, or a joint in which nothing moves.
    """
    able = [name for name, joint in mechanism.joints.items() if joint.model is not None and not joint.model.is_ideal]
    if names is None:
        return [] if mechanism.run is None else able[:MOST_PANELS]
    names = [names] if isinstance(names, str) else list(names)
    for name in names:
        if name not in able:
            reason = "has no clearance or bushing to magnify" if name in mechanism.joints else "is no joint"
            raise SceneError(f"{name!r} {reason}; those that can be magnified: {', '.join(map(repr, able)) or 'none'}")
    return names


def joint_motion(mechanism: Mechanism, name: str) -> JointMotion:
    """Eccentricity and force of a joint at all samples that were reached."""
    joint, run, n = mechanism.joints[name], mechanism.run, len(mechanism.ts)
    ends = [mechanism.path(body, place) for body, place in zip(joint.bodies, joint.places, strict=True)]
    clearance = getattr(joint.model, "clearance", None)
    return JointMotion(
        name,
        mechanism.ts,
        ends[1] - ends[0] if run is None else np.asarray(run.eccentricity(name))[:n],
        None if run is None else np.asarray(run.reaction(name))[:n],
        None if clearance is None else float(clearance),
        None if clearance is None or run is None else np.asarray(run.penetration(name))[:n],
    )


def plane_of(motion: JointMotion, gravity: np.ndarray, normal: Sequence[float] | None, viewer: np.ndarray) -> Camera:
    """A view of the plane in which the ball's center moves, or of the one with the normal that is asked for.

    Args:
        motion: of the ball.
        gravity: world axes; what is opposite to it is up, where that is possible.
        normal: towards the viewer; None for the plane that holds most of the path, seen from the side of `viewer`.
        viewer: direction towards the viewer of the whole mechanism.

    Raises:
        SceneError: for a normal that is no direction.
    """
    if normal is not None:
        toward = np.asarray(normal, float)
        if toward.shape != (3,) or not 0 < np.linalg.norm(toward) < np.inf:
            raise SceneError(f"plane = {normal!r} must be the normal of a plane, three numbers, e.g. plane=(0, 1, 0)")
        toward = toward / np.linalg.norm(toward)
    else:
        toward = _least_direction(motion.eccentricity)
        toward = toward if toward @ viewer >= 0 else -toward
    _, second, up = world_directions(gravity)
    upward = second if abs(toward @ up) > SNAP else up
    upward = upward - (upward @ toward) * toward
    upward = upward / np.linalg.norm(upward)
    return Camera(np.cross(upward, toward), upward)


def _least_direction(eccentricity: np.ndarray) -> np.ndarray:
    """The direction in which the path extends least; a world axis where one is near, y for a ball at rest."""
    spread = eccentricity.T @ eccentricity
    if not np.trace(spread) > 0:
        return np.array([0.0, 1.0, 0.0])
    toward = np.linalg.eigh(spread)[1][:, 0]
    axis = int(np.argmax(np.abs(toward)))
    return np.eye(3)[axis] if abs(toward[axis]) > SNAP else toward


class MagnifiedView:
    """A panel with one joint in it.

    Attributes:
        ax: the panel.
        motion: what moves in it.
        camera: the plane.
    """

    def __init__(
        self, ax: Axes, mechanism: Mechanism, name: str, *, normal: Sequence[float] | None, viewer: np.ndarray
    ):
        self.ax, self.motion = ax, joint_motion(mechanism, name)
        self.joint = mechanism.joints[name]
        self.camera = plane_of(self.motion, mechanism.gravity, normal, viewer)
        every = max(1, len(self.motion.ts) // LONGEST_PATH)
        self.path, self.path_ts = self._on_paper(self.motion.eccentricity[::every]), self.motion.ts[::every]
        ax.set_axis_off()
        self._draw_socket()
        self.whole = self._line(color="0.85", lw=0.5, zorder=2)
        self.whole.set_data(*self.path.T)
        self.passed = self._line(color=FLIGHT, lw=0.8, zorder=3)
        self.arm = self._line(color=INK, lw=0.9, zorder=5)
        self.normal = self._patch(INK, 5, "normal")
        self.force = self._patch(FORCE_COLOR, 6, "force")
        self.ball = self._line(marker="o", ms=6, mec="white", mew=0.6, ls="none", zorder=7, gid=f"ball:{name}")
        self.text = ax.text(
            0.5, 0.0, "", transform=ax.transAxes, ha="center", va="top", fontsize=7.5, linespacing=1.3, zorder=8
        )
        self.triad = Triad(ax, np.array([0.16, 0.16]), 0.2)
        self.triad.follow(self.camera)
        self.link: ConnectionPatch | None = None

    def fit(self) -> None:
        """Limits around the circle."""
        reach = REACH * self.motion.radius
        self.ax.set_xlim(-reach, reach)
        self.ax.set_ylim(-reach, reach)
        self.ax.set_aspect("equal", adjustable="box", anchor="C")

    def magnification(self, view: SpaceView) -> float:
        """How many times larger than in the drawing of the mechanism the joint is drawn."""
        own = self.ax.transData.transform(np.array([[0.0, 0.0], [self.motion.radius, 0.0]]))
        other = view.ax.transData.transform(np.array([[0.0, 0.0], [view.size, 0.0]]))
        return float((np.ptp(own[:, 0]) / self.motion.radius) / (np.ptp(other[:, 0]) / view.size))

    def join(self, view: SpaceView, pose: MechanismPose) -> None:
        """State the scale, and lead a line from the joint in the mechanism to this panel."""
        self.ax.apply_aspect()
        times = float(f"{self.magnification(view):.2g}")
        self.ax.set_title(f"{self.motion.name}, magnified {times:,.0f} times", fontsize=8.5)
        self.link = ConnectionPatch(
            (0.0, 0.0), (-self.motion.radius, 0.0), view.ax.transData, self.ax.transData,
            color=LEAD_COLOR, lw=0.7, ls=LEAD_DASHES, zorder=-1,
        )  # fmt: skip
        self.ax.figure.add_artist(self.link)
        self.view = view
        self.update(pose)

    @property
    def moving_artists(self) -> list[Artist]:
        """What `update` moves."""
        own = [self.passed, self.arm, self.ball, self.normal, self.force, self.text]
        return own if self.link is None else [self.link, *own]

    def update(self, pose: MechanismPose) -> None:
        """Move everything to a time."""
        e, force = self.motion.at(pose.t)
        at = self._on_paper(e[None])[0]
        distance, radius = float(np.linalg.norm(e)), self.motion.radius
        touches = self.motion.touches(pose.t, distance)
        color = CONTACT if touches else FLIGHT
        self.passed.set_data(*np.vstack([self.path[self.path_ts < pose.t], at]).T)
        self.arm.set_data([0.0, at[0]], [0.0, at[1]])
        self.ball.set_data([at[0]], [at[1]])
        self.ball.set_markerfacecolor(color)
        outward = at / max(float(np.linalg.norm(at)), 1e-300)
        self.normal.set_path(Path(arrow_outline(at, at + 0.33 * radius * outward, 0.05 * radius)))
        self.normal.set_visible(touches)
        pull = np.zeros(2)
        if force is not None and np.any(force):
            pull = 0.5 * radius * self.camera.project(force) / np.linalg.norm(force)
        self.force.set_path(Path(arrow_outline(at, at + pull, 0.07 * radius)))
        self.text.set_text(self._words(distance, touches, force))
        if self.link is not None:
            place = pose.point(self.joint.bodies[0], self.joint.places[0])
            self.link.xy1 = tuple(self.view.camera.project(place))

    def _words(self, distance: float, touches: bool, force: np.ndarray | None) -> str:
        c = self.motion.clearance
        unit, factor = ("mm", 1e3) if distance >= 1e-5 or c is not None else ("µm", 1e6)
        if c is None:
            first = f"|e| = {factor * distance:.3g} {unit}  (circle: largest |e|)"
        else:
            state = "contact (black arrow: normal)" if touches else "flight"
            first = f"|e| = {factor * distance:.4f} {unit} = {distance / c:.3f} c, {state}"
        size = 0.0 if force is None else float(np.linalg.norm(force))
        arrow = "brown arrow" if touches else "arrow"
        second = f"force on the ball: {size:.3g} N ({arrow}: its direction)" if size > 0 else "no force on the ball"
        return first if force is None else f"{first}\n{second}"

    def _on_paper(self, eccentricity: np.ndarray) -> np.ndarray:
        """The direction of the projection with the true distance."""
        flat = self.camera.project(eccentricity)
        length = np.linalg.norm(flat, axis=1, keepdims=True)
        true = np.linalg.norm(eccentricity, axis=1, keepdims=True)
        return flat * true / np.where(length > 0, length, 1.0)

    def _draw_socket(self) -> None:
        radius, has_wall = self.motion.radius, self.motion.clearance is not None
        if has_wall:
            wall = Path.make_compound_path(Path(1.12 * radius * CIRCLE), Path(radius * CIRCLE[::-1]))
            self.ax.add_patch(PathPatch(wall, facecolor="0.93", edgecolor="0.6", hatch="/////", lw=0.0, zorder=1))
        circle = self._line(color=INK, lw=1.3, ls="-" if has_wall else (0, (4, 3)), zorder=4, gid="circle")
        angle = np.linspace(0, 2 * np.pi, 181)
        circle.set_data(radius * np.cos(angle), radius * np.sin(angle))
        cross = self._line(color="0.55", lw=0.7, zorder=2)
        cross.set_data(0.07 * radius * np.array([-1, 1, np.nan, 0, 0]), 0.07 * radius * np.array([0, 0, np.nan, -1, 1]))

    def _line(self, **style) -> Line2D:
        line = Line2D([], [], **style)
        self.ax.add_line(line)
        return line

    def _patch(self, color: str, zorder: float, name: str) -> PathPatch:
        patch = PathPatch(Path(np.zeros((1, 2))), facecolor=color, edgecolor=color, lw=1.2, zorder=zorder, gid=name)
        self.ax.add_patch(patch)
        return patch


def _between(ts: np.ndarray, rows: np.ndarray, t: float) -> np.ndarray:
    return np.array([np.interp(t, ts, column) for column in rows.T])

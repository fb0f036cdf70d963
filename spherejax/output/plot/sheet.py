"""A sheet: the mechanism in space, its projections and magnified joints beside it, all at one time.

It is laid out once; another time only moves what is drawn. A picture is a sheet at one time, an animation at many.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from spherejax.foundations.errors import SceneError
from spherejax.output.plot import key
from spherejax.output.plot.camera import Camera, best_camera, camera_from, three_projections
from spherejax.output.plot.elements import FORCE_COLOR, force_strokes
from spherejax.output.plot.labels import Label, place_labels
from spherejax.output.plot.magnified import MagnifiedView, joints_to_magnify
from spherejax.output.plot.mechanism import Mechanism, MechanismPose
from spherejax.output.plot.space import SpaceView, Trace, colors_of, drawn_points
from spherejax.output.plot.style import RESOLUTION, Picture

SPACE, SHEET_OF_THREE = (7.0, 5.0), (9.0, 7.0)
"""Width and height [inch] of the spatial view alone, and with three projections."""

JOINT_WIDTH = 3.0
"""Width of the column of magnified joints [inch]."""


@dataclass(frozen=True)
class Wishes:
    """What a sheet shall show; see `spherejax.draw`."""

    view: tuple[float, float] | None = None
    projections: bool = False
    magnified: Sequence[str] | None = None
    plane: Sequence[float] | None = None
    traces: Sequence[str] = ()
    frames: bool = False
    labels: bool = True
    title: str | None = None


class Sheet:
    """A figure of a mechanism that can be moved to another time.

    Attributes:
        figure: the figure.
        mechanism: what is drawn.
        pose: what is drawn now.
        views: the mechanism, first in space.
        joints: magnified joints.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        poses: Sequence[MechanismPose],
        wishes: Wishes,
        *,
        pace: str = "",
        dpi: float = RESOLUTION,
        turns: bool = False,
    ):
        """A sheet whose limits enclose the mechanism at all `poses`, drawn at the last of them.

        Args:
            mechanism: what is drawn.
            poses: one for a picture; several for what moves.
            wishes: what is shown.
            pace: how fast the time passes, written beside the time.
            dpi: pixels per inch.
            turns: whether the spatial view will be turned, so that its limits enclose everything from all sides.
        """
        pose = poses[-1]
        self.mechanism, self.wishes, self.pace, self.pose = mechanism, wishes, pace, pose
        traces = traces_of(mechanism, wishes.traces)
        points = np.concatenate([drawn_points(mechanism, poses), *(trace.until(pose) for trace in traces)])
        camera = camera_for(mechanism, points, wishes.view)
        magnified = joints_to_magnify(mechanism, wishes.magnified)
        has_key = wishes.labels and len(mechanism.joints) > 0
        self.figure, axes, beside, bottom = _grid(wishes.projections, len(magnified), has_key, dpi)
        self.title = self.figure.suptitle("", fontsize=11)
        cameras = [camera, *three_projections(mechanism.gravity)] if wishes.projections else [camera]
        self.views = [
            SpaceView(ax, mechanism, one, pose, points, frames=wishes.frames, traces=traces)
            for ax, one in zip(axes, cameras, strict=True)
        ]
        self.views[0].turns = turns
        self.joints = [
            MagnifiedView(ax, mechanism, name, normal=wishes.plane, viewer=camera.toward)
            for ax, name in zip(beside, magnified, strict=True)
        ]
        self._say(pose)
        self._settle(pose)
        if bottom is not None:
            key.draw_key(bottom, mechanism, bodies=len(poses) > 1, magnified=bool(self.joints))

    @property
    def moving_artists(self) -> list[Artist]:
        """What `update` moves."""
        parts = (*self.views, *self.joints)
        return [self.title, *(artist for part in parts for artist in part.moving_artists)]

    def update(self, pose: MechanismPose) -> None:
        """Move everything to another time."""
        self.pose = pose
        self._say(pose)
        for one in (*self.views, *self.joints):
            one.update(pose)

    def write_names(self, pose: MechanismPose) -> None:
        """Names of bodies, joints and force elements in the spatial view, where they are at a pose."""
        view = self.views[0]
        covered = [] if view.corner is None else view.corner.boxes()
        place_labels(view.ax, labels_of(view, pose), [*view.artists, *view.trace_lines], covered)

    def _say(self, pose: MechanismPose) -> None:
        is_start = self.mechanism.run is None and len(self.mechanism.ts) == 1
        time = "assembled start" if is_start else f"t = {pose.t:.4f} s"
        if self.pace:
            time = f"{time}, {self.pace}"
        if self.wishes.title is None:
            self.title.set_text(time)
        else:  # of a picture the title replaces the time, in an animation it stands before it
            self.title.set_text(f"{self.wishes.title}: {time}" if self.pace else self.wishes.title)

    def _settle(self, pose: MechanismPose) -> None:
        """Lay out the figure once, then fit the views into their panels; projections share one scale."""
        for view in self.views:
            view.ax.set_aspect("auto")
        for joint in self.joints:
            joint.fit()
            joint.update(pose)
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")
        common = max((view.least_scale for view in self.views if view.camera.is_axial), default=None)
        for view in self.views:
            view.fit(common if view.camera.is_axial else None)
        for joint in self.joints:
            joint.join(self.views[0], pose)


def _grid(
    projections: bool, n_joints: int, has_key: bool, dpi: float
) -> tuple[Figure, list[Axes], list[Axes], Axes | None]:
    """Figure and panels: of the mechanism (spatial, front, side, top), of the joints, and of the key."""
    width, height = SHEET_OF_THREE if projections else SPACE
    columns = [width, JOINT_WIDTH] if n_joints else [width]
    rows = [height, key.HEIGHT] if has_key else [height]
    figure = Picture(figsize=(sum(columns), sum(rows)), dpi=dpi, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(len(rows), len(columns), width_ratios=columns, height_ratios=rows)
    if projections:  # third-angle: the top above the front, the side to its right
        inner = grid[0, 0].subgridspec(2, 2)
        space, front, side, top = (figure.add_subplot(inner[i, j]) for i, j in ((0, 1), (1, 0), (1, 1), (0, 0)))
        axes = [space, front, side, top]
    else:
        axes = [figure.add_subplot(grid[0, 0])]
    beside = []
    if n_joints:
        column = grid[0, 1].subgridspec(n_joints, 1, hspace=0.25)  # for the two lines below each panel
        beside = [figure.add_subplot(column[i, 0]) for i in range(n_joints)]
    return figure, axes, beside, figure.add_subplot(grid[1, :]) if has_key else None


def camera_for(mechanism: Mechanism, points: np.ndarray, view: tuple[float, float] | None) -> Camera:
    """The view that is asked for, or one that suits the points.

    Raises:
        SceneError: for a view that is not two angles.
    """
    if view is None:
        return best_camera(points, mechanism.gravity)
    angles = np.asarray(view, float)
    if angles.shape != (2,) or not np.all(np.isfinite(angles)):
        raise SceneError(f"view = {view!r} must be azimuth and elevation in degrees, e.g. view=(30, 20)")
    return camera_from(float(angles[0]), float(angles[1]), mechanism.gravity)


def traces_of(mechanism: Mechanism, names: Sequence[str]) -> list[Trace]:
    """Paths of bodies (their centers of mass) and joints (their points on the second body), by name.

    Raises:
        SceneError: for a name that is neither.
    """
    colors = colors_of(mechanism)
    found = []
    for name in [names] if isinstance(names, str) else names:
        if name in colors:
            body, place = name, np.zeros(3)
        elif name in mechanism.joints:
            joint = mechanism.joints[name]
            body, place = joint.bodies[1], joint.places[1]
        else:
            known = ", ".join(map(repr, [*colors, *mechanism.joints]))
            raise SceneError(f"there is no body or joint {name!r} to trace; there are {known}")
        found.append(Trace(body, place, mechanism.ts, mechanism.path(body, place), colors.get(body, "0.35")))
    return found


def labels_of(view: SpaceView, pose: MechanismPose) -> list[Label]:
    """Names of bodies, joints and force elements, where they are at a pose."""
    found = []
    for joint in view.mechanism.joints.values():
        ends = [pose.point(body, place) for body, place in zip(joint.bodies, joint.places, strict=True)]
        anchor = view.camera.project(
            np.mean(ends, axis=0) if joint.kind.startswith(("Distance", "PointOnCircle")) else ends[1]
        )
        found.append(Label(joint.name, anchor, 1.2 * view.size, "0.25", False, f"joint:{joint.name}"))
    for body in view.mechanism.bodies:
        places = body.places if len(body.places) > 1 else np.vstack([body.places, np.zeros((1, 3))])
        anchor = view.camera.project(pose.point(body.name, places.mean(axis=0)))
        found.append(Label(body.name, anchor, 0.6 * view.size, view.colors[body.name], True, f"body:{body.name}"))
    named = {label.text for label in found}
    for name in view.mechanism.forces:
        strokes = force_strokes(name, view.mechanism, pose, view.camera, view.size)
        strokes = [stroke for stroke in strokes if stroke.name.startswith("force:")]
        if strokes and name not in named:  # a robot's joint and its damper share a name
            anchor = np.nanmean(strokes[0].points, axis=0)
            found.append(Label(name, anchor, 0.8 * view.size, FORCE_COLOR, False, f"force:{name}"))
    return found

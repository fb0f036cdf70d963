"""A mechanism drawn in space, with its projections, traces of points, and its joints magnified."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from spherejax.foundations.checks import SceneError
from spherejax.model.scene import Scene
from spherejax.motion.trajectory import Trajectory
from spherejax.output.plot.camera import Camera, best_camera, camera_from, three_projections
from spherejax.output.plot.labels import Label, place_labels
from spherejax.output.plot.mechanism import Mechanism, Pose, mechanism_of
from spherejax.output.plot.space import SpaceView, Trace, colors_of, drawn_points
from spherejax.output.plot.style import RESOLUTION


def draw_mechanism(
    what: Scene | Trajectory,
    t: float | None = None,
    *,
    scene: Scene | None = None,
    view: tuple[float, float] | None = None,
    projections: bool = False,
    traces: Sequence[str] = (),
    frames: bool = False,
    labels: bool = True,
    title: str | None = None,
) -> Figure:
    """The figure of `spherejax.draw`, which explains the arguments."""
    mechanism = mechanism_of(what, scene)
    pose = mechanism.pose(float(mechanism.ts[0]) if t is None else float(t))
    followed = traces_of(mechanism, traces)
    points = np.concatenate([drawn_points(mechanism, [pose]), *(trace.until(pose) for trace in followed)])
    figure = Figure(figsize=(9.0, 7.2) if projections else (7.0, 5.2), dpi=RESOLUTION, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title_of(mechanism, pose) if title is None else title, fontsize=11)
    camera = camera_for(mechanism, points, view)
    axes, cameras = _panels(figure, camera, mechanism, projections)
    views = [
        SpaceView(ax, mechanism, one, pose, points, frames=frames, traces=followed)
        for ax, one in zip(axes, cameras, strict=True)
    ]
    settle(figure, views)
    if labels:
        place_labels(views[0].ax, labels_of(views[0], pose), views[0].artists)
    return figure


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


def _panels(figure: Figure, camera: Camera, mechanism: Mechanism, projections: bool) -> tuple[list[Axes], list[Camera]]:
    """The spatial view, and as third-angle projections the top above the front and the side to its right."""
    if not projections:
        return [figure.subplots()], [camera]
    front, side, top = three_projections(mechanism.gravity)
    (above, space), (middle, right) = figure.subplots(2, 2)
    return [space, middle, right, above], [camera, front, side, top]


def settle(figure: Figure, views: Sequence[SpaceView]) -> None:
    """Lay out the figure once, then fit the views into their panels; projections share one scale."""
    for view in views:
        view.ax.set_aspect("auto")
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    axial = [view for view in views if view.camera.is_axial]
    common = max((view.least_scale for view in axial), default=None)
    for view in views:
        view.fit(common if view.camera.is_axial else None)


def title_of(mechanism: Mechanism, pose: Pose) -> str:
    """What is shown."""
    return "assembled start" if mechanism.run is None else f"t = {pose.t:.4g} s"


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


def labels_of(view: SpaceView, pose: Pose) -> list[Label]:
    """Names of bodies and joints, where they are at a pose."""
    found = []
    for joint in view.mechanism.joints.values():
        anchor = view.camera.project(pose.point(joint.bodies[0], joint.places[0]))
        found.append(Label(joint.name, anchor, 1.2 * view.size, "0.25", False, f"joint:{joint.name}"))
    for body in view.mechanism.bodies:
        places = body.places if len(body.places) > 1 else np.vstack([body.places, np.zeros((1, 3))])
        anchor = view.camera.project(pose.point(body.name, places.mean(axis=0)))
        found.append(Label(body.name, anchor, 0.6 * view.size, view.colors[body.name], True, f"body:{body.name}"))
    return found

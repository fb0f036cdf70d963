"""Pictures of a mechanism: `draw` one instant, `animate` a run, `view` it in a notebook.

Matplotlib is imported when the first one is made.
"""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from spherejax.model.scene import Scene
from spherejax.motion.results.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(
    what: Scene | Trajectory,
    t: float | None = None,
    *,
    scene: Scene | None = None,
    view: tuple[float, float] | None = None,
    projections: bool = False,
    magnified: Sequence[str] | None = None,
    plane: Sequence[float] | None = None,
    traces: Sequence[str] = (),
    frames: bool = False,
    labels: bool = True,
    title: str | None = None,
) -> "Figure":
    """Draw a mechanism in space: bodies, joints by their symbols, force elements, ground, world axes.

    A body is the bars and the area between its points; one with a single point, or none, is the uniform box with its
    mass and inertia. The quartered circle is its center of mass. Views are parallel projections: lengths along the
    paper are true.

    Args:
        what: a scene, drawn at its assembled start, or a run.
        t: time [s] of a run, its first sample by default; between samples by cubic interpolation.

    Other args:
        scene: the scene of the run, whose named points are drawn too; the run itself knows those of joints and forces.
        view: azimuth and elevation of the viewer [deg], about the direction opposite to gravity; by default a view in
            which the joints do not hide each other, and the front of a plane mechanism.
        projections: whether front, side and top are drawn beside it, to one scale, with axes.
        magnified: joints that are not ideal, drawn magnified beside the mechanism: clearance circle, path of the
            ball's center up to t, contact normal, force. By default the first three of a run, and none of a scene.
        plane: normal of the plane in which they are drawn, world axes; by default of the plane that holds most of the
            path. The angle is that of the projection, the distance from the middle the true |e|.
        traces: bodies (by their centers of mass) and joints whose paths up to t are drawn.
        frames: whether each body's axes are drawn at its center of mass: x red, y green, z blue.
        labels: whether bodies, joints and force elements carry their names, and the symbols a key.
        title: instead of the time.

    Returns:
        The figure; `figure.savefig("mechanism.png")` writes it.

    Raises:
        SceneError: for something that is no scene or run, a time outside of the run, or an unknown name.
    """
    from spherejax.output.plot.reading import mechanism_of
    from spherejax.output.plot.sheet import Sheet, Wishes

    mechanism = mechanism_of(what, scene)
    pose = mechanism.pose(float(mechanism.ts[0]) if t is None else float(t))
    sheet = Sheet(mechanism, [pose], Wishes(view, projections, magnified, plane, traces, frames, labels, title))
    if labels:
        sheet.write_names(pose)
    return sheet.figure


def animate(
    run: Trajectory,
    path: str | os.PathLike,
    *,
    fps: float = 25.0,
    slow: float | None = None,
    scene: Scene | None = None,
    view: tuple[float, float] | None = None,
    projections: bool = False,
    magnified: Sequence[str] | None = None,
    plane: Sequence[float] | None = None,
    traces: Sequence[str] = (),
    frames: bool = False,
    title: str | None = None,
    dpi: float = 100.0,
    overwrite: bool = False,
    report: Callable[[str, float], None] | None = None,
) -> Path:
    """Write a run as a film, with the time and its pace on every frame.

    Args:
        run: the run; motion between its samples follows by cubic interpolation.
        path: where to write; `.gif` needs nothing else, `.mp4` needs ffmpeg (`pip install 'spherejax[video]'`).

    Other args:
        fps: frames a second. A GIF counts in hundredths of a second: 25 and 50 are exact, others are rounded, and the
            times of the frames with them.
        slow: seconds of film for a second of motion, e.g. 20 for an impact; by default a round number with which the
            film lasts about six seconds.
        scene, view, projections, magnified, plane, traces, frames, title: as for `draw`; the limits enclose the whole
            motion.
        dpi: pixels per inch; the sheet is 7 inches wide, 10 with a magnified joint.
        overwrite: replace an existing file.
        report: called after each frame with what was done and the share of the work.

    Returns:
        The path.

    Raises:
        SceneError: for another ending, an existing file without `overwrite`, an MP4 without ffmpeg, more than 20,000
            frames, and as `draw`; before anything is drawn.
    """
    from spherejax.output.plot.animation import animation_path, write_animation
    from spherejax.output.plot.reading import mechanism_of
    from spherejax.output.plot.sheet import Wishes

    mechanism = mechanism_of(run, scene)
    wishes = Wishes(view, projections, magnified, plane, traces, frames, True, title)
    path = animation_path(path, overwrite=overwrite)
    return write_animation(mechanism, path, wishes, fps=fps, slow=slow, dpi=dpi, report=report)


def view(
    run: Trajectory | Scene,
    *,
    scene: Scene | None = None,
    view: tuple[float, float] | None = None,
    projections: bool = False,
    magnified: Sequence[str] | None = None,
    plane: Sequence[float] | None = None,
    traces: Sequence[str] = (),
    frames: bool = False,
    title: str | None = None,
    dpi: float = 100.0,
):
    """Look at a run in a notebook: slide or play the time, turn the mechanism with the mouse. Works without the web.

    Args:
        run: the run; a scene stands still and can be turned.

    Other args:
        scene, view, projections, magnified, plane, traces, frames, title: as for `draw`.
        dpi: pixels per inch; the sheet is 7 inches wide, 10 with a magnified joint.

    Returns:
        A widget (`pip install 'spherejax[notebooks]'`), to be the last line of a cell; where ipympl or ipywidgets is
        missing a picture, with a warning that says so.

    Raises:
        SceneError: as `draw`.
    """
    from spherejax.output.plot.interactive import view_of
    from spherejax.output.plot.reading import mechanism_of
    from spherejax.output.plot.sheet import Wishes

    wishes = Wishes(view, projections, magnified, plane, traces, frames, True, title)
    return view_of(mechanism_of(run, scene), wishes, dpi)

"""Pictures of a mechanism: `draw` for one instant. Matplotlib is imported when the first picture is made."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from spherejax.model.scene import Scene
from spherejax.motion.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(
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
) -> "Figure":
    """Draw a mechanism in space: bodies, joints by their symbols, force elements, ground, world axes.

    A body is the bars and the area between its points; one with a single point, or none, is the uniform box with its
    mass and inertia. The quartered circle is its center of mass. Lengths are true in the projections, and along the
    paper in the spatial view, which is a parallel projection.

    Args:
        what: a scene, drawn at its assembled start, or a run.
        t: time [s] of a run, its first sample by default; between samples by cubic interpolation.

    Other args:
        scene: the scene of the run, whose named points are drawn too; the run itself knows those of joints and forces.
        view: azimuth and elevation of the viewer [deg], about the direction opposite to gravity; by default a view in
            which the joints do not hide each other, and the front of a plane mechanism.
        projections: whether front, side and top are drawn beside it, to one scale, with axes.
        traces: bodies (by their centers of mass) and joints whose paths up to t are drawn.
        frames: whether each body's axes are drawn at its center of mass: x red, y green, z blue.
        labels: whether bodies and joints carry their names.
        title: instead of the time.

    Returns:
        The figure; `figure.savefig("mechanism.png")` writes it.

    Raises:
        SceneError: for something that is no scene or run, a time outside of the run, or an unknown name.
    """
    from spherejax.output.plot.drawing import draw_mechanism

    return draw_mechanism(
        what,
        t,
        scene=scene,
        view=view,
        projections=projections,
        traces=traces,
        frames=frames,
        labels=labels,
        title=title,
    )

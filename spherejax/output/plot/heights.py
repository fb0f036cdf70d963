"""A mechanism with the height of a body marked, as histories show it."""

import numpy as np
from matplotlib.figure import Figure

from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.output.plot.reading import mechanism_of
from spherejax.output.plot.sheet import Sheet, Wishes

COLOR = "#9A0000"
"""Of the mark; no body and no joint model has it."""


def with_height(scene: Scene, body: str, title: str) -> Figure:
    """Draw a mechanism at its start, with a line from the plane z = 0 to the center of mass of a body.

    Args:
        scene: the mechanism.
        body: the body.
        title: of the figure.

    Raises:
        SceneError: for a body that is not there.
    """
    mechanism = mechanism_of(scene, None)
    pose = mechanism.pose(float(mechanism.ts[0]))
    if body not in pose.positions:
        raise SceneError(f"there is no body {body!r}; there are {', '.join(pose.positions)}")
    sheet = Sheet(mechanism, [pose], Wishes(title=title))
    view = sheet.views[0]
    top = np.asarray(pose.positions[body], float)
    beside = np.array([-7.0 * view.size, 0.0])  # free of the body
    center = view.camera.project(top)
    low, high = view.camera.project(top * [1.0, 1.0, 0.0]) + beside, center + beside
    side = 2.5 * view.size
    arrow = {"arrowstyle": "<->", "color": COLOR, "lw": 1.1, "shrinkA": 0, "shrinkB": 0}
    view.ax.annotate("", tuple(low), tuple(high), arrowprops=arrow)
    view.ax.plot([high[0] - 0.5 * side, center[0]], [high[1], center[1]], color=COLOR, lw=0.8)
    view.ax.plot([low[0] - side, low[0] + side], [low[1], low[1]], color=COLOR, lw=0.8)
    middle = 0.5 * (low + high)
    view.ax.text(
        middle[0] - 0.6 * view.size, middle[1], f"z = {1e3 * top[2]:.2f} mm", color=COLOR, ha="right", va="center",
        fontsize=8.5, gid="height",
    )  # fmt: skip
    sheet.write_names(pose)
    return sheet.figure

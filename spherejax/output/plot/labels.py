"""Names beside what they name, without covering each other or the drawing.

Greedy: label after label takes the free place nearest to its anchor. A few dozen labels need nothing better.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.text import Text

DISTANCES = (3, 7, 12, 20, 30, 44, 62)
"""Distances of the label's rim from what it names that are tried [point]."""

DIRECTIONS = np.stack([np.cos(np.arange(16) * np.pi / 8), np.sin(np.arange(16) * np.pi / 8)], -1)
LEADER_FROM = 17.0
"""From this distance of the label's nearest edge on [point] a thin line leads to the anchor."""

OVERLAP_COST, STROKE_COST, OUTSIDE_COST = 50.0, 3.0, 200.0
"""Of a label on another label, on a drawn line (per sample point of it), and outside of the panel."""


@dataclass(frozen=True)
class Label:
    """A name and where it belongs.

    Attributes:
        text: the name.
        anchor: on paper [m], shape (2,).
        radius: of what is there, which the label keeps clear [m].
        color: of the text.
        is_bold: bodies are, joints are not.
        name: what it belongs to, for `gid`.
    """

    text: str
    anchor: np.ndarray
    radius: float
    color: str
    is_bold: bool = False
    name: str = ""


def place_labels(
    ax: Axes, labels: Sequence[Label], drawn: Sequence[PathPatch | Line2D], covered: Sequence = ()
) -> None:
    """Write labels into a panel whose layout is final.

    Args:
        ax: the panel.
        labels: what to write; the first choose first.
        drawn: what they should not cover.
        covered: boxes that are taken, as left, bottom, right, top [pixel].
    """
    point = ax.figure.dpi / 72
    obstacles = _samples(ax, drawn, 3 * point)
    panel = ax.get_window_extent()
    boxes: list[np.ndarray] = list(covered)
    for label in labels:
        text = ax.text(
            0, 0, label.text, color=label.color, fontsize=7.5, fontweight="bold" if label.is_bold else "normal",
            ha="center", va="center", zorder=8, gid=f"label:{label.name}", transform=None,
        )  # fmt: skip
        extent = text.get_window_extent()
        half = 0.5 * np.array([extent.width, extent.height]) + 1.0 * point
        anchor = ax.transData.transform(label.anchor)
        rim = float(np.linalg.norm(ax.transData.transform((label.anchor[0] + label.radius, label.anchor[1])) - anchor))
        center = _best(anchor, rim, half, boxes, obstacles, panel, point)
        boxes.append(np.concatenate([center - half, center + half]))
        _put(ax, text, label, center, anchor, half, point)


def _best(anchor, rim, half, boxes, obstacles, panel, point) -> np.ndarray:
    """The center of the cheapest place; of equal ones the first, which is the nearest."""
    reach = np.array([_reach(direction, half) for direction in DIRECTIONS])
    distances = np.repeat(DISTANCES, len(DIRECTIONS))
    outward = np.tile(DIRECTIONS, (len(DISTANCES), 1))
    centers = anchor + outward * (rim + distances * point + np.tile(reach, len(DISTANCES)))[:, None]
    costs = 0.25 * distances + _costs(centers - half, centers + half, boxes, obstacles, panel)
    return centers[np.argmin(costs)]


def _reach(direction: np.ndarray, half: np.ndarray) -> float:
    """From a box's center to its rim along a direction."""
    return float(np.min(half / np.maximum(np.abs(direction), 1e-9)))


def _costs(low: np.ndarray, high: np.ndarray, boxes: list[np.ndarray], obstacles: np.ndarray, panel) -> np.ndarray:
    """What is covered by each of the boxes from `low` to `high`, shape (n,)."""
    near = np.all((obstacles >= low.min(axis=0)) & (obstacles <= high.max(axis=0)), axis=1)
    points = obstacles[near][None]
    covered = np.all((points >= low[:, None]) & (points <= high[:, None]), axis=-1)
    costs = STROKE_COST * covered.sum(axis=1).astype(float)
    if boxes:
        taken = np.array(boxes)[None]
        overlaps = np.all((low[:, None] < taken[..., 2:]) & (high[:, None] > taken[..., :2]), axis=-1)
        costs += OVERLAP_COST * overlaps.sum(axis=1)
    outside = (low < [panel.x0, panel.y0]).any(axis=1) | (high > [panel.x1, panel.y1]).any(axis=1)
    return costs + OUTSIDE_COST * outside


def _samples(ax: Axes, drawn: Sequence[PathPatch | Line2D], spacing: float) -> np.ndarray:
    """Points all along the drawn lines [pixel], shape (n, 2)."""
    found = [np.zeros((0, 2))]
    for artist in drawn:
        corners = ax.transData.transform(np.asarray(artist.get_path().vertices))
        for a, b in pairwise(corners):
            length = np.linalg.norm(b - a)
            if np.isfinite(length):
                shares = np.linspace(0.0, 1.0, max(2, int(length / spacing)))[:, None]
                found.append(a + shares * (b - a))
    # Symbols are drawn with many short lines: one sample for each place is enough.
    return spacing * np.unique(np.round(np.concatenate(found) / spacing), axis=0)


def _put(ax: Axes, text: Text, label: Label, center, anchor, half, point) -> None:
    """Fix the label to its anchor, at a distance in points that another resolution keeps."""
    offset = (center - anchor) / point
    text.remove()
    gap = np.linalg.norm(center - anchor) - _reach((center - anchor) / np.linalg.norm(center - anchor), half)
    ax.annotate(
        label.text,
        (label.anchor[0], label.anchor[1]),
        xytext=tuple(offset),
        textcoords="offset points",
        color=label.color,
        fontsize=7.5,
        fontweight="bold" if label.is_bold else "normal",
        ha="center",
        va="center",
        zorder=8,
        gid=f"label:{label.name}",
        annotation_clip=False,
        arrowprops=None if gap < LEADER_FROM * point else {"arrowstyle": "-", "color": "0.6", "lw": 0.5, "shrinkB": 4},
    )

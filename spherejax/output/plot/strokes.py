"""What is drawn, as strokes on paper: lines and filled outlines, and the shapes that several of them share.

A mechanism gives the same number of strokes in the same meaning at every time, so that an animation only moves them.
Sizes of symbols are given in one length s [m on paper] for the whole drawing.
"""

from dataclasses import dataclass

import numpy as np

from spherejax.output.plot.camera import Camera

INK, PAPER, GROUND_COLOR = "0.15", "white", "0.35"

CIRCLE = np.stack([np.cos(np.linspace(0, 2 * np.pi, 33)), np.sin(np.linspace(0, 2 * np.pi, 33))], -1)
BREAK = np.full((1, 2), np.nan)
"""A vertex that interrupts a line."""


@dataclass(frozen=True)
class Stroke:
    """A line or a filled outline.

    Attributes:
        points: on paper [m], shape (n, 2); a row of NaN interrupts the line.
        depth: towards the viewer; what is larger is drawn later.
        edge: color of the line, or "none".
        width: of the line [point].
        face: color of the area, or "none".
        alpha: opacity of the area.
        dashes: pattern of the line.
        name: what it belongs to, e.g. `"body:rocker"`.
    """

    points: np.ndarray
    depth: float = 0.0
    edge: str = INK
    width: float = 0.9
    face: str = "none"
    alpha: float = 1.0
    dashes: str | tuple = "-"
    name: str = ""


def box_faces(
    center: np.ndarray, half: np.ndarray, camera: Camera, color: str, depth: float, alpha: float
) -> list[Stroke]:
    """Three visible faces of a box with half sides as the columns of `half`; the rim is the same for all."""
    strokes = []
    for i in range(3):
        normal, a, b = half[:, i], half[:, (i + 1) % 3], half[:, (i + 2) % 3]
        outward = normal if normal @ camera.toward >= 0 else -normal
        corners = np.array([center + outward + p * a + q * b for p, q in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        outline = camera.project(np.vstack([corners, corners[:1]]))
        strokes.append(Stroke(outline, depth, "none", 0.0, PAPER))
        strokes.append(Stroke(outline, depth, color, 0.9, color, alpha * (0.5 + 0.25 * i)))
    return strokes


def ground_marks(at: np.ndarray, s: float) -> list[Stroke]:
    """A pedestal on hatched ground, below a point on paper."""
    base = at + s * np.array([[0.0, 0.0], [-1.3, -2.1], [1.3, -2.1], [0.0, 0.0]])
    line = at + s * np.array([[-2.1, -2.1], [2.1, -2.1]])
    hatching = [
        at + s * np.array(row)
        for x in np.linspace(-1.5, 2.1, 6)
        for row in ([[x, -2.1], [x - 0.7, -2.9]], [[np.nan, np.nan]])
    ]
    return [
        Stroke(base, 0.0, GROUND_COLOR, 0.8, "0.88"),
        Stroke(line, 0.0, GROUND_COLOR, 1.4),
        Stroke(np.concatenate(hatching), 0.0, GROUND_COLOR, 0.7),
    ]


def arrow_outline(tail: np.ndarray, tip: np.ndarray, half_width: float) -> np.ndarray:
    """An arrow as one closed line, from its tail to its tip and back; a point where both are the same."""
    shaft = tip - tail
    length = float(np.linalg.norm(shaft))
    along = shaft / length if length > 0 else np.zeros(2)
    across = half_width * np.array([-along[1], along[0]])
    neck = tip - min(2.2 * half_width, length) * along
    return np.array([tail, neck, neck + across, tip, neck - across, neck, tail])


def convex_hull(points: np.ndarray) -> np.ndarray:
    """The convex hull of points on paper, closed."""
    order = convex_hull_order(points)
    return points[[*order, order[0]]]


def convex_hull_order(points: np.ndarray) -> list[int]:
    """Indices of the points on their convex hull, counterclockwise (Andrew's monotone chain)."""
    order = sorted(range(len(points)), key=lambda i: (points[i, 0], points[i, 1]))

    def chain(indices) -> list[int]:
        kept: list[int] = []
        for i in indices:
            while len(kept) > 1 and _turn(points[kept[-2]], points[kept[-1]], points[i]) <= 0:
                kept.pop()
            kept.append(i)
        return kept[:-1]

    return chain(order) + chain(reversed(order)) or order[:1]


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))

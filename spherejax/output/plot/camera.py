"""From space to paper: parallel projections, seen from any side.

A parallel projection keeps lengths and parallels, so that a drawing can be measured, and its panels are ordinary plane
axes, which draw an animation's frame several times faster than matplotlib's own three-dimensional ones.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

USUAL_AZIMUTHS = (-60, -45, -30, 30, 45, 60, 120, 150, -120, -150)
USUAL_ELEVATION = 22.0
"""Directions [deg] among which the view of a spatial mechanism is chosen."""

FLAT = 0.02
"""A mechanism that is thinner than this share of its size is plane, and seen from the front."""

MOST_POINTS = 40
"""Points that are looked at when a view is chosen: their pairs are counted."""


@dataclass(frozen=True)
class Camera:
    """A parallel projection.

    Attributes:
        right: direction to the right on paper, world axes, unit length.
        up: direction upwards on paper.
        title: what the view is called.
        is_axial: whether both directions are world axes, so that the panel can carry scales.
    """

    right: np.ndarray
    up: np.ndarray
    title: str = ""
    is_axial: bool = False

    @property
    def toward(self) -> np.ndarray:
        """Direction towards the viewer."""
        return np.cross(self.right, self.up)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Points on paper [m], shape (..., 2)."""
        return np.stack([points @ self.right, points @ self.up], -1)

    def depth(self, points: np.ndarray) -> float:
        """How near points are to the viewer on average [m]; larger is nearer."""
        return float(np.mean(points @ self.toward))


def world_directions(gravity: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three world axes, right-handed: two horizontal ones, and the one that is opposite to gravity (z without it)."""
    axis = int(np.argmax(np.abs(gravity))) if np.any(gravity) else 2
    up = np.zeros(3)
    up[axis] = 1.0 if gravity[axis] <= 0 else -1.0
    first = np.zeros(3)
    first[1 if axis == 0 else 0] = 1.0
    return first, np.cross(up, first), up


def camera_from(azimuth: float, elevation: float, gravity: np.ndarray) -> Camera:
    """A view from a direction.

    Args:
        azimuth: of the viewer, about the upward direction from the first horizontal axis [deg].
        elevation: of the viewer above the horizontal [deg].
        gravity: world axes; what is opposite to it is up.
    """
    first, second, up = world_directions(gravity)
    a, e = np.radians(azimuth), np.radians(elevation)
    right = -np.sin(a) * first + np.cos(a) * second
    upward = -np.sin(e) * (np.cos(a) * first + np.sin(a) * second) + np.cos(e) * up
    return Camera(right, upward)


def three_projections(gravity: np.ndarray) -> tuple[Camera, Camera, Camera]:
    """Front, side and top, as on an engineer's sheet."""
    first, second, up = world_directions(gravity)
    return (
        Camera(first, up, "front", is_axial=True),
        Camera(second, up, "side", is_axial=True),
        Camera(first, second, "top", is_axial=True),
    )


def best_camera(points: np.ndarray, gravity: np.ndarray) -> Camera:
    """A view in which the points do not hide each other; along the normal for points in a world plane.

    Args:
        points: world axes [m], shape (n, 3).
        gravity: world axes.
    """
    size = np.ptp(points, axis=0)
    front, side, top = three_projections(gravity)
    for camera in (front, side, top):
        if abs(size @ camera.toward) < FLAT * max(size.max(), 1e-300) and np.sum(size > FLAT * size.max()) == 2:
            return Camera(camera.right, camera.up)
    cameras = [camera_from(azimuth, USUAL_ELEVATION, gravity) for azimuth in USUAL_AZIMUTHS]
    scale = max(float(size.max()), 1e-300)
    return max(cameras, key=lambda camera: _openness(camera.project(points[:MOST_POINTS]) / scale))


def _openness(points: np.ndarray) -> float:
    """How far points are apart on paper: the sum of logarithms punishes any two that hide each other."""
    distances = [np.linalg.norm(a - b) for a, b in combinations(points, 2)]
    return float(np.sum(np.log(np.maximum(distances, 1e-2))))


def axis_name(direction: np.ndarray) -> str:
    """Name of a world axis, with a minus where the direction is opposite to it."""
    axis = int(np.argmax(np.abs(direction)))
    return ("" if direction[axis] > 0 else "-") + "xyz"[axis]

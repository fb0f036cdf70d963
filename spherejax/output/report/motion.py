"""A motion as data for the viewer of a report: shapes once, and a pose of every body for each frame.

Positions and quaternions are float32, seven digits of the mechanism's size, as base64 text: a third of what decimal
numbers take. Between samples poses follow the cubic interpolation of `sj.animate`; the viewer goes straight between
frames.
"""

import base64
from typing import Any

import numpy as np

from spherejax.model.scene import Scene
from spherejax.motion.results.trajectory import Trajectory
from spherejax.output.plot.camera import world_directions
from spherejax.output.plot.interactive import angles_of
from spherejax.output.plot.magnified import joint_motion, joints_to_magnify
from spherejax.output.plot.mechanism import Mechanism
from spherejax.output.plot.reading import mechanism_of
from spherejax.output.plot.sheet import camera_for
from spherejax.output.plot.space import colors_of, drawn_points, poses_of, symbol_size, unit_for
from spherejax.output.plot.turning import shapes_of, tracks_of

N_FRAMES, FEWEST_FRAMES = 601, 61
"""Frames of a motion: ten seconds at the rate of a screen; fewer of a mechanism of very many bodies."""

MOST_POSES = 60_000
"""Poses of all bodies at all frames of a report, 28 bytes each."""


def viewed(what: Scene | Trajectory, name: str, *, scene: Scene | None = None, share: int = 1) -> dict[str, Any]:
    """The data of one mechanism.

    Args:
        what: a run, or a scene at its assembled start.
        name: what the viewer calls it.
        scene: the scene of the run, whose named points are drawn too.
        share: how many motions the report shows.

    Raises:
        SceneError: as `sj.draw`, e.g. for a run without a single sample.
    """
    mechanism = mechanism_of(what, scene)
    points = drawn_points(mechanism, poses_of(mechanism))
    size, colors = symbol_size(mechanism, points), colors_of(mechanism)
    ts = _times(mechanism, share)
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    camera = camera_for(mechanism, points, None)
    azimuth, elevation = angles_of(camera, mechanism.gravity)
    half = np.abs(camera.project(points - middle)).max(axis=0) + 3.2 * size
    unit, factor = unit_for(float(np.ptp(points, axis=0).max()) or 1.0)
    tracks = tracks_of(mechanism, ts, size)
    return {
        "name": name,
        "bodies": [body.name for body in mechanism.bodies],
        "colors": [colors[body.name] for body in mechanism.bodies],
        "start": float(ts[0]),
        "end": float(ts[-1]),
        "frames": len(ts),
        "poses": _packed(_poses(mechanism, ts)),
        "shapes": shapes_of(mechanism, colors, size),
        "tracks": [{**one, "shape": list(one["points"].shape), "points": _packed(one["points"])} for one in tracks],
        "joints": [_magnified(mechanism, joint, ts) for joint in joints_to_magnify(mechanism, None)],
        "axes": [axis.tolist() for axis in world_directions(mechanism.gravity)],
        "view": [azimuth, elevation],
        "middle": middle.tolist(),
        "half": half.tolist(),
        "radius": float(np.linalg.norm(points - middle, axis=1).max() + 3.2 * size) or 1.0,
        "unit": [unit, factor],
    }


def _times(mechanism: Mechanism, share: int) -> np.ndarray:
    if len(mechanism.ts) == 1:
        return mechanism.ts
    most = MOST_POSES // (share * max(len(mechanism.bodies), 1))
    return np.linspace(mechanism.ts[0], mechanism.ts[-1], int(np.clip(most, FEWEST_FRAMES, N_FRAMES)))


def _poses(mechanism: Mechanism, ts: np.ndarray) -> np.ndarray:
    """Positions and quaternions, shape (n, n_bodies, 7); neighbouring quaternions lie on the same side."""
    found = np.zeros((len(ts), len(mechanism.bodies), 7))
    for i, t in enumerate(ts):
        pose = mechanism.pose(float(t))
        for j, body in enumerate(mechanism.bodies):
            found[i, j] = [*pose.positions[body.name], *pose.quaternions[body.name]]
            if i and found[i, j, 3:] @ found[i - 1, j, 3:] < 0:
                found[i, j, 3:] *= -1
    return found


def _magnified(mechanism: Mechanism, name: str, ts: np.ndarray) -> dict[str, Any]:
    """The ball's center in its socket at the frames, as shares of the circle's radius; the nearest samples before."""
    motion = joint_motion(mechanism, name)
    before = np.clip(np.searchsorted(motion.ts, ts, side="right") - 1, 0, len(motion.ts) - 1)
    radius = motion.radius or 1.0
    return {
        "name": name,
        "path": _packed(motion.eccentricity[before] / radius),
        "radius": radius,
        "clearance": motion.clearance is not None,
    }


def _packed(values: np.ndarray) -> str:
    """Little-endian float32 as base64."""
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")

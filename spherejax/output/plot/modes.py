"""Modes of a linearized mechanism: it, and it displaced along each mode."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spherejax.foundations.errors import SceneError
from spherejax.output.plot.animation import animation_path, pace_in_words, write_animation
from spherejax.output.plot.elements import mechanism_strokes
from spherejax.output.plot.mechanism import Mechanism
from spherejax.output.plot.reading import mechanism_at
from spherejax.output.plot.sheet import Wishes, camera_for
from spherejax.output.plot.space import SpaceView, drawn_points, extent_of, patch_of
from spherejax.output.plot.style import new_figure

MOST = 6
"""Modes that are drawn where nobody says which."""

REACH = 0.14
"""Largest displacement that is drawn, as a share of the drawing's size."""

INSTANTS = 200
"""Poses of a swing in a film, between which it is interpolated; the last is left out, for the film begins anew."""

FILM_SECONDS = 2.0
"""How long a swing lasts in a film, whatever its frequency."""

GHOST = "0.72"
"""Gray of the mechanism that is not displaced."""


def modes(
    found: Any,
    which: int | Sequence[int] | None = None,
    *,
    view: tuple[float, float] | None = None,
    reach: float = REACH,
    title: str = "",
) -> Figure:
    """The mechanism displaced along its modes, and in gray where it is not; a panel for each mode.

    A mode whose parts do not swing in phase (damped, gyroscopic) is drawn at the instant of its largest displacement.

    Args:
        found: `sj.linearize(...).modes()`.
        which: numbers of the modes, as its table counts; the first six when None.

    Other args:
        view: azimuth and elevation of the viewer [deg]; chosen by the mechanism when None.
        reach: largest displacement, as a share of the size of the drawing.
        title: what is shown; the state by default.

    Raises:
        SceneError: for something that has no modes, a mode that does not exist, none that moves a body, or a `reach`
            that is not positive.
    """
    if not hasattr(found, "shapes") or not hasattr(found, "linear"):
        raise SceneError(f"modes: {type(found).__name__} has no modes; give sj.linearize(scene).modes()")
    require_reach(reach)
    numbers = _numbers(found, which)
    point = found.linear.point
    still = mechanism_at(point.system, point.t, point.y)
    displaced = [_displaced(still, found.shapes[k], reach) for k in numbers]
    points = np.concatenate([drawn_points(one, [one.pose(float(one.ts[0]))]) for one in (still, *displaced)])
    columns = min(3, len(numbers))
    rows = -(-len(numbers) // columns)
    figure, axes = new_figure(rows, columns, 3.4 * columns, 3.1 * rows + 0.3, title or f"Modes {point.words}")
    views = []
    for ax, k, mechanism in zip(axes.flat, numbers, displaced, strict=False):
        views.append(_panel(ax, still, mechanism, points, view))
        ax.set_title(f"mode {k}: {found.frequency[k]:.4g} Hz, damping {found.damping_ratio[k]:.2g}", fontsize=9)
    for ax in axes.flat[len(numbers) :]:
        ax.set_axis_off()
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for one in views:
        one.fit(max(each.least_scale for each in views))
    return figure


def require_reach(reach: float) -> None:
    """Raise `SceneError` for a displacement that cannot be drawn."""
    if not 0 < reach < np.inf:
        raise SceneError(f"reach = {reach:g} must be positive: a share of the drawing's size, e.g. {REACH:g}")


def _numbers(found: Any, which: int | Sequence[int] | None) -> list[int]:
    moving = [k for k in range(len(found)) if np.abs(found.shapes[k]).max(initial=0.0) > 0]
    if which is None:
        if not moving:
            raise SceneError("modes: none of the modes moves a body; there is nothing to draw")
        return moving[:MOST]
    numbers = [int(k) for k in np.atleast_1d(np.asarray(which))]
    wrong = next((k for k in numbers if k not in moving), None)
    if wrong is not None or not numbers:
        raise SceneError(f"modes: there is no mode {wrong} that moves a body; there are {moving}")
    return numbers


def _panel(ax: Axes, still: Mechanism, displaced: Mechanism, points: np.ndarray, view) -> SpaceView:
    camera = camera_for(still, points, view)
    panel = SpaceView(ax, displaced, camera, displaced.pose(float(displaced.ts[0])), points)
    pose = still.pose(float(still.ts[0]))
    for group in mechanism_strokes(still, pose, camera, panel.colors, panel.size, False):
        for stroke in group:
            patch = patch_of(stroke)
            patch.set(edgecolor=GHOST, facecolor="none", zorder=1.0)
            ax.add_patch(patch)
    ax.set_aspect("auto")
    return panel


def film(
    found: Any,
    mode: int,
    path: str | os.PathLike,
    *,
    view: tuple[float, float] | None,
    reach: float,
    fps: float,
    overwrite: bool,
) -> Path:
    """Write a mode as a film; arguments as of `Modes.animate`."""
    require_reach(reach)
    (mode,) = _numbers(found, mode)
    path = animation_path(path, overwrite=overwrite)
    frequency = float(found.damped_frequency[mode])
    moved, period = swing(found, mode, reach)
    value = found.eigenvalues[mode]
    if frequency > 0:
        title = f"mode {mode}, {frequency:.4g} Hz, damping {found.damping_ratio[mode]:.2g} left out"
    else:
        change = "grows" if value.real > 0 else "dies away"
        title = f"mode {mode}, {change} by {abs(value.real):.4g} 1/s; no oscillation"
    slow = FILM_SECONDS / period
    pace = pace_in_words(float(f"{slow:.3g}")) if frequency > 0 else ""
    wishes = Wishes(view=view, magnified=(), title=title, labels=False)
    return write_animation(moved, path, wishes, fps=fps, slow=slow, dpi=100.0, report=None, pace=pace)


def swing(found: Any, mode: int, reach: float) -> tuple[Mechanism, float]:
    """A mode without its damping as a motion, and how long it lasts [s]: `FILM_SECONDS` where it does not oscillate."""
    point, frequency = found.linear.point, float(found.damped_frequency[mode])
    still = mechanism_at(point.system, point.t, point.y)
    period = 1 / frequency if frequency > 0 else FILM_SECONDS
    ts = np.linspace(0.0, period, INSTANTS, endpoint=False)
    moves = _largest_moves(still, found.shapes[mode], reach) * np.exp(2j * np.pi * ts / period)[:, None, None]
    rates = (2j * np.pi / period * moves).real
    poses = [_moved(still, one.real) for one in moves]
    motion = replace(
        still,
        ts=ts,
        positions=np.concatenate([one.positions for one in poses]),
        quaternions=np.concatenate([one.quaternions for one in poses]),
        velocities=rates[..., :3],
        angular_velocities=rates[..., 3:],  # but for a turn that changes its axis, by its square; only between poses
    )
    return motion, period


def _displaced(still: Mechanism, shape: np.ndarray, reach: float) -> Mechanism:
    """The mechanism at the instant of a mode at which the squares of all displacements are largest together."""
    return _moved(still, np.real(_largest_moves(still, shape, reach)))


def _largest_moves(still: Mechanism, shape: np.ndarray, reach: float) -> np.ndarray:
    """Displacements and rotations of a mode, to be drawn; their real part at the instant at which they are largest."""
    size = extent_of(drawn_points(still, [still.pose(float(still.ts[0]))]))
    lengths = shape * np.array([1.0] * 3 + [0.3 * size] * 3)
    # The sum of Re(z e^i)^2 is largest where the phase of sum z^2 is turned away.
    phase = np.exp(-0.5j * np.angle(np.sum(lengths**2)))
    return reach * size / np.abs((lengths * phase).real).max() * shape * phase


def _moved(still: Mechanism, moves: np.ndarray) -> Mechanism:
    """The mechanism with its bodies displaced and turned."""
    angles = np.linalg.norm(moves[:, 3:], axis=1, keepdims=True)
    half = np.sinc(angles / (2 * np.pi)) / 2 * moves[:, 3:]
    p = still.quaternions[0]
    cosines = np.cos(angles / 2)
    scalar = cosines * p[:, :1] - np.sum(half * p[:, 1:], 1, keepdims=True)
    vector = cosines * p[:, 1:] + p[:, :1] * half + np.cross(half, p[:, 1:])
    quaternions = np.concatenate([scalar, vector], 1)
    return replace(still, positions=still.positions + moves[None, :, :3], quaternions=quaternions[None])

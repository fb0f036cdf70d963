"""The path of the ball's center inside the clearance, joint by joint (Figs 20 and 24).

The path is spatial: on the four-bar no plane holds more than nine tenths of it. Each circle shows one plane of world
axes: for a journal that across its bearing. The paper's figures have the plane that holds gravity and most of the
reaction, x-z for the four-bar, in which its rocker swings, y-z for the suspension, across the car. The angle is that of
the projection, but the distance from the middle is the true |e|: a projected distance would draw contact beside the
plane as if the ball were in flight, whereas here contact is on the circle or beyond it, and only there.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from spherejax.foundations.errors import SceneError
from spherejax.output.plot.curves import Curves, thinned
from spherejax.output.plot.style import LABELS, letter, model_colors, new_figure

_CONTACT = "#D55E00"
_FLIGHT = "#56B4E9"

CHORD, MOST_POINTS = 0.005, 60_000
"""A path has a point at least every 0.5 % of the circle's radius, but no more points than this."""

RESOLVED = 0.3
"""Samples farther apart than this share of the radius are drawn as points: a chord between them would be no path."""


def eccentricity_paths(
    models: Mapping[str, Curves],
    title: str,
    *,
    every: int | None = None,
    plane: tuple[int, int] | None = None,
    outer: bool = False,
) -> Figure:
    """For each joint model the path inside the clearance circle, and below it the distance over time.

    The angle is that of the projection on a plane, the distance from the middle the true |e|: contact is on the circle
    or beyond it, and only there. A joint without clearance has a dashed circle, its largest |e|.

    Args:
        models: what `curves_of` returns, by model name (`"dry"`, `"bushing"`, ...), a column each; `"ideal"` is left
            out. Names of joint models have their own colors.
        title: what is shown, with the values of the parameters.
        every: every how many samples the path has a point; when None as many as a smooth curve needs. Points in
            contact are drawn in any case, and samples too far apart for a path as points.
        plane: the world axes along which the paths are drawn: 0, 1, 2 for x, y, z; when None, for each path that of
            `main_plane`.
        outer: whether a second circle shows the largest distance, where the ball is pressed in by much.

    Raises:
        SceneError: where there is no model to draw.
    """
    shown = {name: one for name, one in models.items() if "ideal" not in (name, one.kind)}
    colors = model_colors({name: one.kind for name, one in models.items()})
    if not shown:
        raise SceneError("an ideal joint has no eccentricity to draw; give curves of another model")
    look = _EccentricityLook(plane, every, outer)
    figure, axes = new_figure(2, len(shown), 3.1 * len(shown), 5.9, title)
    for (upper, lower), (name, one) in zip(axes.T, shown.items(), strict=True):
        is_small = one.clearance is None and np.nanmax(one.distance) < 5e-4
        unit, scale = (1e6, "µm") if is_small else (1e3, "mm")
        _draw_path(upper, one, unit, scale, look)
        lower.plot(*thinned(one.ts, unit * one.distance), color=colors[name], lw=0.9)
        if one.clearance is not None:
            lower.axhline(unit * one.clearance, color="black", lw=1.0)
            top = max(one.clearance, np.nanmax(one.distance)) if outer else one.clearance
            lower.set_ylim(0, 1.12 * unit * top)
        else:
            lower.set_ylim(bottom=0)
        lower.set_xlim(one.ts[0], one.ts[-1])
        lower.set_xlabel(LABELS["t"])
        lower.set_ylabel(f"|e| [{scale}]")
    letter(list(axes.flat))
    return figure


def main_plane(curves: Sequence[Curves]) -> tuple[int, int]:
    """The two world axes along which eccentricities are largest, by the sum of squares: of a journal those across it.

    Args:
        curves: of one joint, at least one.
    """
    squares = np.sum([np.nansum(one.eccentricity**2, axis=0) for one in curves], axis=0)
    # Where none is the smallest (a joint that is not pressed) y is left out, for gravity is mostly along z.
    smallest = 1 if squares[1] <= squares.min() else int(np.argmin(squares))
    first, second = (axis for axis in range(3) if axis != smallest)
    return first, second


class _EccentricityLook(NamedTuple):
    plane: tuple[int, int] | None
    every: int | None
    outer: bool


def _draw_path(ax: Axes, one: Curves, unit: float, scale: str, look: _EccentricityLook) -> None:
    first, second = main_plane([one]) if look.plane is None else look.plane
    e = unit * one.eccentricity
    distance = unit * one.distance
    in_plane = np.hypot(e[:, first], e[:, second])
    stretch = distance / np.where(in_plane > 0, in_plane, 1.0)
    x, z = stretch * e[:, first], stretch * e[:, second]
    touching = one.touching
    radius = np.nanmax(distance, initial=0.0) if one.clearance is None else unit * one.clearance
    _draw_flight(ax, x, z, radius, look.every, 0.4 if touching.any() else 0.7)
    if touching.any():
        chosen = np.flatnonzero(touching)
        chosen = chosen[:: max(1, len(chosen) // 6000)]
        ax.scatter(x[chosen], z[chosen], s=6, color=_CONTACT, lw=0, zorder=4)
        share = np.sum(touching * np.gradient(one.ts)) / np.sum(np.gradient(one.ts))
        remark = f"in contact {100 * share:.3g} % of the time"
    else:
        remark = "never in contact" if one.clearance is not None else "circle: largest |e|"
    if look.outer:
        remark = f"{remark}\n" if one.clearance is not None else ""
        remark += f"largest |e| (dashed): {np.nanmax(distance):.4g} {scale}"
    ax.set_title(f"{one.label}\n{remark}", loc="left", fontsize=9)
    style = {"ls": "--", "color": "0.4"} if one.clearance is None else {"ls": "-", "color": "black"}
    ax.add_patch(Circle((0.0, 0.0), radius, fill=False, lw=1.0, zorder=3, **style))
    if look.outer and np.nanmax(distance) > radius:
        ax.add_patch(Circle((0.0, 0.0), np.nanmax(distance), fill=False, lw=0.8, ls="--", color="0.4", zorder=3))
        radius = np.nanmax(distance)
    reach = 1.22 * max(radius, 1e-12)
    ax.set_xlim(-reach, reach)
    ax.set_ylim(-reach, reach)
    ax.set_aspect("equal")
    ax.set_xlabel(f"along {'xyz'[first]} [{scale}]")
    ax.set_ylabel(f"along {'xyz'[second]} [{scale}]")


def _draw_flight(ax: Axes, x: np.ndarray, z: np.ndarray, radius: float, every: int | None, width: float) -> None:
    """The path as a curve where samples are near each other, and as points where they are not."""
    if every is not None:
        x, z = x[::every], z[::every]
    steps = np.hypot(np.diff(x), np.diff(z))
    steps = np.where(np.isfinite(steps), steps, 0.0)
    if every is None:
        along = np.concatenate([np.zeros(1), np.cumsum(steps)])
        chord = max(CHORD * radius, along[-1] / MOST_POINTS, 1e-300)
        place = np.floor(along / chord)
        # The samples on both sides of a long step are kept, so that a step is told from a chord.
        kept = np.flatnonzero(np.concatenate([np.ones(1, bool), (np.diff(place) > 0) | ~np.isfinite(x[1:])]))
        kept = np.unique(np.concatenate([kept, np.maximum(kept - 1, 0), [len(x) - 1]]))
        x, z = x[kept], z[kept]
        steps = np.hypot(np.diff(x), np.diff(z))
    is_far = np.concatenate([steps > RESOLVED * radius, np.zeros(1, bool)])
    if is_far.mean() < 0.5:
        gaps = np.flatnonzero(is_far) + 1
        ax.plot(np.insert(x, gaps, np.nan), np.insert(z, gaps, np.nan), color=_FLIGHT, lw=width, zorder=2)
    if is_far.any():
        ends = is_far | np.concatenate([np.zeros(1, bool), is_far[:-1]])
        ax.plot(x[ends], z[ends], ".", ms=2.0, color=_FLIGHT, mew=0, zorder=2)

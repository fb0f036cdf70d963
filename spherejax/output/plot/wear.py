"""The figure of a study of wear: maps of both surfaces, and what was rubbed off along the cycles."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter

from spherejax.output.plot.style import LAW_COLORS, legend_under, letter, new_figure, typeset_number

SHOWN = 0.999
"""Share of the volume that a map shows."""

OUTLINE = [withStroke(linewidth=2.0, foreground="white", alpha=0.8)]
"""Of words on a map."""

FAINTEST = 0.005
"""Depth that is drawn, as a share of the largest."""

_AXES = "xyz"


class WearMap(NamedTuple):
    """One side of a joint.

    Attributes:
        name: of the side and its body.
        depth_at: depth [um] at unit vectors, shape (n, n, 3).
        directions: to cells of equal area, shape (m, 3).
        depths: of them [um].
        volumes: along the cycles [mm^3].
        deepest: along the cycles [um].
    """

    name: str
    depth_at: Callable[[np.ndarray], np.ndarray]
    directions: np.ndarray
    depths: np.ndarray
    volumes: np.ndarray
    deepest: np.ndarray


class WearRing(NamedTuple):
    """One side of a journal in its bearing.

    Attributes:
        name: of the side and its body.
        angles: of the cells around the axis [degrees], rising.
        depths: of them, in each plane along the axis [um].
        volumes: along the cycles [mm^3].
        deepest: along the cycles [um].
        planes: where they are along the axis, in words; empty where there is one depth all along.
    """

    name: str
    angles: np.ndarray
    depths: np.ndarray
    volumes: np.ndarray
    deepest: np.ndarray
    planes: tuple[str, ...] = ()


def wear_figure(maps: Sequence[WearMap | WearRing], cycles: np.ndarray, title: str) -> Figure:
    """A map of each side that wears, centered there, and volumes and depths along the cycles.

    The maps of a ball are Lambert's azimuthal projections, which keep areas; those of a journal are the depth by angle.

    Args:
        maps: the sides.
        cycles: numbers of cycles.
        title: what is shown.
    """
    along = len(cycles) > 1
    maps = [one for one in maps if np.any(one.depths > 0)] or maps
    figure, axes = new_figure(1, len(maps) + along, 4.2 * (len(maps) + along), 3.9, title)
    for ax, one in zip(axes[0], maps, strict=False):
        if isinstance(one, WearRing):
            _draw_ring(ax, one)
        else:
            _draw_map(figure, ax, one)
    if along:
        _draw_cycles(axes[0, -1], maps, cycles)
    letter(list(axes[0]))
    return figure


def _draw_map(figure: Figure, ax: Axes, one: WearMap) -> None:
    ax.set_title(one.name, loc="left", fontsize=9)
    ax.grid(False)
    ax.set_aspect("equal")
    ax.set_xticks([])
    ax.set_yticks([])
    for spine in ax.spines.values():
        spine.set_visible(False)
    if not np.any(one.depths > 0):
        ax.set(xlim=(-1, 1), ylim=(-1, 1))
        ax.text(0, 0, "not worn", ha="center", va="center", fontsize=9, color="0.4")
        return
    center = _middle(one.directions, one.depths)
    right, up = _across(center)
    angle = _half_width(one.directions, one.depths, center)
    edge = 2 * np.sin(angle / 2)
    place = np.linspace(-edge, edge, 401)
    x, y = np.meshgrid(place, place)
    away = np.hypot(x, y)
    inside = away <= edge
    u = _unprojected(np.where(inside, x, 0.0), np.where(inside, y, 0.0), center, right, up)
    depth = np.where(inside, one.depth_at(u), np.nan)
    ax.add_patch(Circle((0, 0), edge, facecolor="0.95", edgecolor="0.6", lw=0.8, zorder=0))
    worn = np.where(depth > FAINTEST * one.depths.max(), depth, np.nan)
    shown = ax.pcolormesh(x, y, worn, cmap="viridis_r", vmin=0.0, rasterized=True)
    bar = figure.colorbar(shown, ax=ax, shrink=0.7, pad=0.02)
    bar.set_label("depth [$\\mu$m]", fontsize=8)
    bar.ax.tick_params(labelsize=7.5)
    said: dict = {"fontsize": 6.5, "ha": "center", "va": "center", "zorder": 4, "path_effects": OUTLINE}
    step = next(s for s in (1, 2, 5, 10, 20, 30, 60) if np.degrees(angle) / s <= 4 or s == 60)
    turn = np.linspace(0, 2 * np.pi, 200)
    for degrees in np.arange(step, np.degrees(angle) + 1e-6, step):
        r = 2 * np.sin(np.radians(degrees) / 2)
        ax.plot(r * np.cos(turn), r * np.sin(turn), color="0.55", lw=0.5, zorder=3)
        ax.text(0.5 * r, -0.866 * r, f"{degrees:g}°", **said)
    _mark_axes(ax, center, right, up, angle)
    ax.set(xlim=(-1.12 * edge, 1.12 * edge), ylim=(-1.12 * edge, 1.12 * edge))
    words = ", ".join(f"{round(value, 2) + 0.0:.2f}" for value in center)
    ax.set_xlabel(f"from the center along ({words})\nup: {_named(up)}", fontsize=7.5)


def _draw_ring(ax: Axes, one: WearRing) -> None:
    ax.set_title(one.name, loc="left", fontsize=9)
    ax.set(xlim=(-180, 180), xticks=range(-180, 181, 90), xlabel="angle from the joint's x axis [degrees]")
    ax.set_ylabel("depth [$\\mu$m]")
    if one.planes:
        shades = colormaps["viridis"](np.linspace(0.0, 0.85, len(one.planes)))
        for name, depths, shade in zip(one.planes, one.depths, shades, strict=True):
            ax.plot(one.angles, depths, color=shade, lw=1.3, label=name)
        ax.legend(fontsize=7, frameon=False, title="along the axis", title_fontsize=7)
    else:
        ax.fill_between(one.angles, one.depths[0], color=LAW_COLORS[0], alpha=0.2, lw=0)
        ax.plot(one.angles, one.depths[0], color=LAW_COLORS[0], lw=1.3)
    ax.set_ylim(0, None)
    if not np.any(one.depths > 0):
        ax.set_ylim(0, 1)
        ax.text(0, 0.5, "not worn", ha="center", va="center", fontsize=9, color="0.4")


def _mark_axes(ax: Axes, center, right, up, angle: float) -> None:
    """Where the body's axes pierce the sphere."""
    for name, axis in zip(_AXES, np.eye(3), strict=True):
        for sign in (1, -1):
            away = np.arccos(np.clip(sign * axis @ center, -1, 1))
            if away > min(angle, np.radians(175)):
                continue
            along = np.array([sign * axis @ right, sign * axis @ up])
            size = np.linalg.norm(along)
            at = 2 * np.sin(away / 2) * along / size if size > 0 else np.zeros(2)
            ax.plot(*at, "+", color="black", ms=6, mew=1.0, zorder=4)
            name_there = f"{'-' if sign < 0 else ''}{name}"
            place = float(at[0]), float(at[1])
            offset = {"xytext": (4, 4), "textcoords": "offset points", "fontsize": 8, "zorder": 4}
            ax.annotate(name_there, place, **offset, path_effects=OUTLINE)


def _draw_cycles(ax: Axes, maps: Sequence[WearMap | WearRing], cycles: np.ndarray) -> None:
    ax.set_title("rubbed off (lines) and deepest (dots)", loc="left", fontsize=9)
    depths = ax.twinx()
    for one, color in zip(maps, LAW_COLORS, strict=False):
        ax.plot(cycles, one.volumes, color=color, lw=1.3, label=one.name)
        depths.plot(cycles, one.deepest, ".", color=color, ms=4)
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: typeset_number(value)))
    ax.set_xlabel("cycles")
    ax.set_ylabel("volume [mm$^3$]")
    ax.set(xlim=(0, None), ylim=(0, None))
    depths.set_ylim(0, None)
    depths.set_ylabel("largest depth [$\\mu$m]", fontsize=9)
    depths.tick_params(labelsize=8)
    depths.spines["top"].set_visible(False)
    legend_under(ax)


def _middle(directions: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """Where the wear is: the mean direction, or across the least worn axis where the wear goes all around."""
    mean = depths @ directions / depths.sum()
    if np.linalg.norm(mean) > 0.15:
        return mean / np.linalg.norm(mean)
    _, vectors = np.linalg.eigh((directions * depths[:, None]).T @ directions)
    return vectors[:, -1] * np.sign(vectors[np.argmax(np.abs(vectors[:, -1])), -1])


def _half_width(directions: np.ndarray, depths: np.ndarray, center: np.ndarray) -> float:
    """Of the cap that is shown [rad]: most of the volume and some room."""
    away = np.arccos(np.clip(directions @ center, -1, 1))
    order = np.argsort(away)
    inside = np.cumsum(depths[order]) / depths.sum()
    widest = away[order][min(np.searchsorted(inside, SHOWN), len(away) - 1)]
    return float(min(1.15 * widest + 0.01, np.pi))


def _across(center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Right and up on the map: up is the body's z, or its y where z is looked at."""
    axis = np.array([0.0, 0.0, 1.0]) if abs(center[2]) < 0.8 else np.array([0.0, 1.0, 0.0])
    up = axis - (axis @ center) * center
    up /= np.linalg.norm(up)
    return np.cross(up, center), up


def _unprojected(x, y, center, right, up) -> np.ndarray:
    """Unit vectors of places on Lambert's map."""
    square = x * x + y * y
    height = 1 - square / 2
    across = np.sqrt(np.maximum(1 - square / 4, 0.0))
    return height[..., None] * center + (across * x)[..., None] * right + (across * y)[..., None] * up


def _named(up: np.ndarray) -> str:
    at = int(np.argmax(np.abs(up)))
    return f"{'-' if up[at] < 0 else ''}{_AXES[at]}"

"""Figures of sweeps: curves over one parameter, maps over two, pairs of more or of samples, fans over time."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spherejax.output.plot.style import ABOVE_LEFT, LAW_COLORS, legend_below, new_figure, note
from spherejax.output.plot.swept_axes import (
    at_the_bottom,
    beyond,
    has_failed,
    label,
    list_of_outliers,
    logarithmic_where_even,
    outliers,
    wide_parameters,
    with_unit,
)
from spherejax.output.plot.swept_fans import fan_figure
from spherejax.output.plot.swept_pairs import mark_failures, pairs_figure

if TYPE_CHECKING:
    import xarray

COUNTED = ("status", "t_reached", "n_steps", "n_rejected", "warnings")


def figures_of_sweep(swept: "xarray.Dataset", title: str = "") -> dict[str, Figure]:
    """A figure for each thing that was kept: maps and curves of numbers, fan charts of what depends on time.

    Runs that did not reach their end are marked by red crosses.

    Args:
        swept: the result of `sj.sweep` or `sj.open_sweep`.
        title: what was swept.

    Returns:
        Figures by name of the quantity; over more than two parameters, of its components one by one.
    """
    figures = {}
    for name in [str(name) for name in swept.data_vars if name not in COUNTED] + ["n_steps"]:
        figures |= _figures_of(swept, name, title)
    return figures


def _figures_of(swept: "xarray.Dataset", name: str, title: str) -> dict[str, Figure]:
    variable = swept[name]
    own = [str(dim) for dim in variable.dims if dim not in swept["status"].dims]
    over_time, further = own[:1] == ["time"], [dim for dim in own if dim != "time"]
    wide = wide_parameters(swept)
    if len(further) > 1 or not wide:
        return {}
    panels = [(name, variable)]
    if further:
        panels, constant = _varying(_panels(swept, name, further[0]))
        title = "\n".join(filter(None, [title, constant]))
    if over_time:
        return {name: fan_figure(swept, panels, wide, title)}
    if len(wide) == 1:
        return {name: _curves(swept, panels, wide[0], title)}
    if len(wide) == 2 and "run" not in variable.dims:
        return {name: _maps(swept, panels, wide, title)}
    return {each: pairs_figure(swept, _squeezed(values, wide), each, wide, title) for each, values in panels}


def _squeezed(values, wide: list[str]):
    """Without the parameters that have a single value."""
    return values.squeeze([dim for dim in values.dims if dim != "run" and dim not in wide])


def _panels(swept: "xarray.Dataset", name: str, dim: str) -> list[tuple[str, Any]]:
    labels = [str(each) for each in np.asarray(swept[dim])] if dim in swept.coords else range(swept.sizes[dim])
    return [(f"{name} {each}", swept[name].isel({dim: i})) for i, each in enumerate(labels)]


def _varying(panels: list[tuple[str, Any]]) -> tuple[list[tuple[str, Any]], str]:
    """The components that are not the same number in all runs, and what is said of the others; all, if none varies."""
    same = {}
    for name, values in panels:
        finite = np.asarray(values, float)
        finite = finite[np.isfinite(finite)]
        if finite.size and np.ptp(finite) == 0:
            same[name] = f"{with_unit(name, values)} is {finite[0]:.6g} in all runs"
    if len(same) == len(panels):
        return panels, ""
    return [panel for panel in panels if panel[0] not in same], "; ".join(same.values())


def _sheet(panels, title: str, width: float = 4.2, height: float = 3.4) -> tuple[Figure, np.ndarray]:
    figure, axes = new_figure(1, len(panels), width * len(panels) + 0.4, height, title)
    return figure, axes[0]


def _curves(swept, panels, parameter: str, title: str) -> Figure:
    figure, axes = _sheet(panels, title)
    places = np.asarray(swept[parameter])
    order = np.argsort(places)
    is_samples = "run" in swept["status"].dims
    failed = np.asarray(has_failed(swept)).ravel()
    for ax, (name, values) in zip(axes, panels, strict=True):
        style = "." if is_samples else "o-"
        ax.plot(places[order], np.asarray(values).ravel()[order], style, color=LAW_COLORS[0], ms=3, lw=1.1)
        at_the_bottom(ax, places[failed])
        label(ax, with_unit(parameter, swept[parameter]), with_unit(name, values))
        logarithmic_where_even(ax, places, "x")
    if failed.any():
        legend_below(figure, axes[0])
    return figure


FEW_CELLS = 8
"""Values along an axis of a map up to which each has a tick, and its cell is whole."""


def limit_cells(ax: Axes, values: Any, axis: str) -> None:
    """The range of an axis of a map: whole cells where they are few, and else what was swept.

    The outer cells reach beyond what was swept, by half of their width. Of many cells that is cut off; of three the one
    in the middle would look as if it stood for half of the range.
    """
    places = np.unique(np.asarray(values))
    is_x = axis == "x"
    if len(places) <= FEW_CELLS and (ax.get_xscale() if is_x else ax.get_yscale()) == "linear":
        (ax.set_xticks if is_x else ax.set_yticks)(places)
    else:
        (ax.set_xlim if is_x else ax.set_ylim)(float(places[0]), float(places[-1]))


def _maps(swept, panels, parameters: list[str], title: str) -> Figure:
    figure, axes = _sheet(panels, title, 4.6, 3.8)
    across, up = parameters
    for ax, (name, values) in zip(axes, panels, strict=True):
        grid = np.asarray(_squeezed(values, parameters).transpose(up, across), float)
        far = outliers(grid)
        low, high = (np.nanmin(grid[~far]), np.nanmax(grid[~far])) if far.any() else (None, None)
        drawn = ax.pcolormesh(
            values[across], values[up], grid, cmap="viridis", shading="nearest", rasterized=True, vmin=low, vmax=high
        )
        figure.colorbar(drawn, ax=ax, extend=beyond(grid, low, high)).set_label(with_unit(name, values), fontsize=9)
        listed = list_of_outliers(grid, far, (up, np.asarray(values[up])), (across, np.asarray(values[across])))
        ax.grid(False)
        label(ax, with_unit(across, values[across]), with_unit(up, values[up]))
        logarithmic_where_even(ax, values[across], "x")
        logarithmic_where_even(ax, values[up], "y")
        limit_cells(ax, values[across], "x")
        limit_cells(ax, values[up], "y")
        n_failed = mark_failures(ax, swept, across, up)
        if n_failed:
            ax.set_title(f"crosses: {n_failed} failed runs", loc="right", fontsize=8)
        if np.isnan(grid).sum() > n_failed:
            note(ax, f"{int(np.isnan(grid).sum())} runs without a value are left white", place=ABOVE_LEFT)
        if listed:
            # Below the axis: a remark in the panel would cover runs.
            ax.text(0.0, -0.17, listed, transform=ax.transAxes, va="top", fontsize=7, color="0.25")
    return figure

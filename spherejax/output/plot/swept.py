"""Figures of sweeps: curves over one parameter, maps over two, fans over time."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spherejax.output.plot.style import LAW_COLORS, new_figure, note

if TYPE_CHECKING:
    import xarray

BANDS = ((0.05, 0.95), (0.25, 0.75))
"""Shares of the runs that the bands of a fan hold."""

COUNTED = ("status", "t_reached", "n_steps", "n_rejected")


def figures_of_sweep(swept: "xarray.Dataset", title: str = "") -> dict[str, Figure]:
    """A figure for each thing that was kept: maps and curves of numbers, fan charts of what depends on time.

    Args:
        swept: the result of `sj.sweep`.
        title: what was swept.

    Returns:
        Figures by name of the quantity.
    """
    figures = {}
    for name in [str(name) for name in swept.data_vars if name not in (*COUNTED, "status")] + ["n_steps"]:
        figure = _figure_of(swept, name, title)
        if figure is not None:
            figures[name] = figure
    return figures


def _figure_of(swept: "xarray.Dataset", name: str, title: str) -> Figure | None:
    variable = swept[name]
    parameters = _parameters(swept)
    own = [dim for dim in variable.dims if dim not in (*parameters, "run")]
    if own and own[0] == "time":
        return _fan(swept, name, title)
    if len(own) > 1:
        return None
    panels = [(name, variable)] if not own else _panels(swept, name, str(own[0]))
    if "run" in variable.dims:
        return _scatter(swept, panels, title)
    wide = [p for p in parameters if swept.sizes[p] > 1]
    if len(wide) == 1:
        return _curves(panels, wide[0], title)
    if len(wide) == 2:
        return _maps(panels, wide, title)
    return None


def _parameters(swept: "xarray.Dataset") -> list[str]:
    """Parameters that have an axis of their own."""
    return [str(dim) for dim in swept["status"].dims if dim != "run"]


def _panels(swept: "xarray.Dataset", name: str, dim: str) -> list[tuple[str, Any]]:
    labels = [str(label) for label in np.asarray(swept[dim])] if dim in swept.coords else range(swept.sizes[dim])
    return [(f"{name} {label}", swept[name].isel({dim: i})) for i, label in enumerate(labels)]


def _sheet(panels, title: str, width: float = 4.2, height: float = 3.4) -> tuple[Figure, np.ndarray]:
    figure, axes = new_figure(1, len(panels), width * len(panels) + 0.4, height, title)
    return figure, axes[0]


def _curves(panels, parameter: str, title: str) -> Figure:
    figure, axes = _sheet(panels, title)
    for ax, (name, values) in zip(axes, panels, strict=True):
        ax.plot(values[parameter], values.squeeze(), "o-", color=LAW_COLORS[0], ms=3, lw=1.1)
        _label(ax, parameter, _with_unit(name, values))
        _logarithmic_where_even(ax, np.asarray(values[parameter]), "x")
    return figure


def _maps(panels, parameters: list[str], title: str) -> Figure:
    figure, axes = _sheet(panels, title, 4.6, 3.8)
    across, up = parameters
    for ax, (name, values) in zip(axes, panels, strict=True):
        grid = np.asarray(values.squeeze().transpose(up, across), float)
        drawn = ax.pcolormesh(values[across], values[up], grid, cmap="viridis", shading="nearest", rasterized=True)
        figure.colorbar(drawn, ax=ax).set_label(_with_unit(name, values), fontsize=9)
        ax.grid(False)
        _label(ax, across, up)
        _logarithmic_where_even(ax, np.asarray(values[across]), "x")
        _logarithmic_where_even(ax, np.asarray(values[up]), "y")
        if np.isnan(grid).any():
            note(ax, f"{int(np.isnan(grid).sum())} runs without a value are left white")
    return figure


def _scatter(swept: "xarray.Dataset", panels, title: str) -> Figure:
    names = [str(name) for name in swept.coords if swept[name].dims == ("run",) and name != "run"]
    figure, axes = new_figure(len(panels), len(names), 3.4 * len(names) + 0.4, 2.9 * len(panels) + 0.3, title)
    for row, (name, values) in zip(axes, panels, strict=True):
        for ax, parameter in zip(row, names, strict=True):
            ax.plot(swept[parameter], values, ".", color=LAW_COLORS[0], ms=3, alpha=0.6)
            _label(ax, parameter, _with_unit(name, values))
            _logarithmic_where_even(ax, np.sort(np.asarray(swept[parameter])), "x")
    return figure


def _fan(swept: "xarray.Dataset", name: str, title: str) -> Figure | None:
    variable = swept[name]
    own = [str(dim) for dim in variable.dims if dim not in (*_parameters(swept), "run", "time")]
    if len(own) > 1:
        return None
    panels = [(name, variable)] if not own else _panels(swept, name, own[0])
    figure, axes = _sheet(panels, title)
    for ax, (label, values) in zip(axes, panels, strict=True):
        runs = np.asarray(values.transpose("time", ...), float).reshape(swept.sizes["time"], -1)
        for (low, high), alpha in zip(BANDS, (0.22, 0.45), strict=True):
            band = np.nanquantile(runs, [low, high], axis=1)
            share = f"{100 * (high - low):.0f} % of the runs"
            ax.fill_between(swept["time"], *band, color=LAW_COLORS[0], alpha=alpha, lw=0, label=share)
        ax.plot(swept["time"], np.nanmedian(runs, axis=1), color="black", lw=1.1, label="median")
        _label(ax, "time [s]", _with_unit(label, values))
    axes[0].legend(fontsize=7.5, frameon=False)
    return figure


def _label(ax: Axes, across: str, up: str) -> None:
    ax.set_xlabel(across)
    ax.set_ylabel(up)
    ax.locator_params(axis="x", nbins=6)
    # Small numbers get one power of ten at the end of the axis, not a row of zeros each.
    ax.ticklabel_format(style="sci", scilimits=(-3, 4), useMathText=True)


def _with_unit(name: str, values) -> str:
    unit = values.attrs.get("units", "")
    words = name.replace("_", " ").replace(".", ", ")
    return f"{words} [{unit}]" if unit else words


def _logarithmic_where_even(ax: Axes, values: np.ndarray, axis: str) -> None:
    """A logarithmic axis where the values span more than a decade and their ratios are alike."""
    if len(values) < 3 or not np.all(values > 0) or values.max() < 10 * values.min():
        return
    steps, ratios = np.diff(values), np.diff(np.log(values))
    if np.ptp(ratios) / abs(ratios.mean()) < np.ptp(steps) / abs(steps.mean()):
        (ax.set_xscale if axis == "x" else ax.set_yscale)("log")

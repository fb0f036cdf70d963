"""What depends on time in a sweep: a fan of all runs, and below it how it moves with each parameter.

Runs that did not reach their end are left out, from the start: bands that lose members on the way would jump.
"""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spherejax.output.plot.style import ABOVE_RIGHT, LAW_COLORS, legend_under, new_figure, note, ordered_colors
from spherejax.output.plot.swept_axes import label, with_unit

if TYPE_CHECKING:
    import xarray

BANDS = ((0.05, 0.95), (0.25, 0.75))
"""Shares of the runs that the bands of a fan hold."""

GROUPS, ROWS = 5, 3
"""Curves of one parameter; parameters in one figure."""


def fan_figure(
    swept: "xarray.Dataset", panels: list[tuple[str, "xarray.DataArray"]], names: list[str], title: str
) -> Figure:
    """Bands that hold 50 and 90 % of the runs; below, medians of the runs with about the same value of a parameter.

    Args:
        swept: the result of `sj.sweep`.
        panels: names and values, with a dimension `time`.
        names: parameters of which medians are drawn.
        title: what was swept.
    """
    shown = names[:ROWS]
    n_rows = 1 + len(shown)
    figure, axes = new_figure(n_rows, len(panels), 4.2 * len(panels) + 0.4, 2.6 * n_rows + 0.6, title)
    for column, (name, values) in enumerate(panels):
        _fan(axes[0, column], swept, values)
        for ax, parameter in zip(axes[1:, column], shown, strict=True):
            _medians(ax, swept, values, parameter)
            if column == 0:
                legend_under(ax, n_columns=3, gap=0.2)
                ax.get_legend().set_title(f"median by {with_unit(parameter, swept[parameter])}", {"size": 7})
        for ax in axes[:, column]:
            label(ax, "time [s]", with_unit(name, values))
    legend_under(axes[0, 0], gap=0.2)
    return figure


def _by_run(swept, values) -> np.ndarray:
    """Values with shape (time, runs)."""
    return np.asarray(values.transpose("time", ...), float).reshape(swept.sizes["time"], -1)


def _fan(ax: Axes, swept, values) -> None:
    runs = _by_run(swept, values)
    is_whole = _is_whole(runs)
    if not is_whole.any():
        note(ax, "no run reached its end")
        return
    runs = runs[:, is_whole]
    for (low, high), alpha in zip(BANDS, (0.22, 0.45), strict=True):
        band = np.quantile(runs, [low, high], axis=1)
        share = f"{100 * (high - low):.0f} % of the runs"
        ax.fill_between(swept["time"], *band, color=LAW_COLORS[0], alpha=alpha, lw=0, label=share)
    ax.plot(swept["time"], np.median(runs, axis=1), color="black", lw=1.1, label="median")
    if not is_whole.all():
        note(ax, f"{int(np.sum(~is_whole))} runs that failed are left out", place=ABOVE_RIGHT)


def _is_whole(runs: np.ndarray) -> np.ndarray:
    return np.asarray(np.isfinite(runs).all(0))


def _medians(ax: Axes, swept, values, parameter: str) -> None:
    one = values.isel(time=0)
    of_runs = np.asarray(swept[parameter].broadcast_like(one).transpose(*one.dims), float).ravel()
    runs = _by_run(swept, values.transpose("time", *one.dims))
    groups = _groups(of_runs)
    for (low, high), color in zip(groups, ordered_colors(len(groups)), strict=True):
        members = runs[:, (of_runs >= low) & (of_runs <= high) & _is_whole(runs)]
        if members.size:
            text = f"{low:.4g}" if low == high else f"{low:.3g} to {high:.3g}"
            ax.plot(swept["time"], np.median(members, axis=1), color=color, lw=1.2, label=text)


def _groups(of_runs: np.ndarray) -> list[tuple[float, float]]:
    """Least and largest value of groups of about equal size."""
    values = np.unique(of_runs)
    return [(part[0], part[-1]) for part in np.array_split(values, min(GROUPS, len(values)))]

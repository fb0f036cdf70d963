"""Sweeps of many parameters, or of samples: a panel for each pair of them, and one for each alone on the diagonal."""

from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from spherejax.output.plot.style import LAW_COLORS, new_figure
from spherejax.output.plot.swept_axes import (
    FAILED,
    at_the_bottom,
    has_failed,
    label,
    logarithmic_where_even,
    with_unit,
)

if TYPE_CHECKING:
    import xarray

MOST = 5
"""Parameters in one figure; further ones are left out, and the title says so."""

BAND = (0.05, 0.95)
"""Share of the runs that a band holds."""


def pairs_figure(
    swept: "xarray.Dataset", values: "xarray.DataArray", name: str, names: list[str], title: str
) -> Figure:
    """One number over many parameters.

    On the diagonal it is drawn against one parameter (all samples; for a product the median over the other parameters,
    and a band that holds 90 % of the runs); below, each pair of parameters, in color (samples; for a product the median
    over the others). Red crosses: failed runs, or, where a panel gathers several
    runs in one place, that some of them failed.

    Args:
        swept: the result of `sj.sweep`.
        values: one number for each run.
        name: what it is called.
        names: parameters.
        title: what was swept.
    """
    shown = names[:MOST]
    if len(shown) < len(names):
        title = f"{title} (the first {MOST} of {len(names)} parameters)"
    n = len(shown)
    figure, axes = new_figure(n, n, 2.5 * n + 1.2, 2.2 * n + 0.5, title)
    is_samples = "run" in values.dims
    limits = _limits([values] if is_samples else [_median(values, *pair) for pair in combinations(shown, 2)])
    drawn = None
    for row, up in enumerate(shown):
        for column, across in enumerate(shown):
            ax = axes[row, column]
            if column > row:
                ax.set_axis_off()
                continue
            if column == row:
                (_alone_of_samples if is_samples else _alone_of_product)(ax, swept, values, across)
                label(ax, with_unit(across, swept[across]), with_unit(name, values))
                ax.yaxis.label.set_fontsize(7)
            else:
                draw = _pair_of_samples if is_samples else _pair_of_product
                drawn = draw(ax, swept, values, across, up, limits)
                label(ax, with_unit(across, swept[across]), with_unit(up, swept[up]))
                logarithmic_where_even(ax, swept[up], "y")
            logarithmic_where_even(ax, swept[across], "x")
            ax.tick_params(labelsize=6.5)
            ax.xaxis.get_offset_text().set_size(6.5)
            ax.yaxis.get_offset_text().set_size(6.5)
    if drawn is not None:
        what = with_unit(name, values)
        bar = figure.colorbar(drawn, ax=axes, shrink=0.6, pad=0.02)
        bar.set_label(what if is_samples else f"{what}, median over the others", fontsize=9)
    if bool(has_failed(swept).any()):
        figure.legend(
            handles=[_mark_of_failures("failed" if is_samples else "one or more failed")],
            loc="upper right",
            fontsize=8,
            frameon=False,
        )
    return figure


def _mark_of_failures(text: str) -> Any:
    return Line2D([], [], label=text, **FAILED)


def _limits(drawn: list) -> tuple[float, float]:
    """The color's range, without the few percent that would leave no color to the rest."""
    finite = np.concatenate([np.asarray(values, float).ravel() for values in drawn])
    finite = finite[np.isfinite(finite)]
    return tuple(np.quantile(finite, [0.02, 0.98])) if finite.size else (0.0, 1.0)


# Samples -------------------------------------------------------------------------------------------------------------


def _alone_of_samples(ax: Axes, swept, values, across: str) -> None:
    ax.plot(swept[across], values, ".", color=LAW_COLORS[0], ms=3, alpha=0.6)
    at_the_bottom(ax, np.asarray(swept[across])[np.asarray(has_failed(swept))])


def _pair_of_samples(ax: Axes, swept, values, across: str, up: str, limits) -> Any:
    low, high = limits
    drawn = ax.scatter(swept[across], swept[up], c=np.asarray(values, float), s=7, cmap="viridis", vmin=low, vmax=high)
    failed = np.asarray(has_failed(swept))
    ax.plot(np.asarray(swept[across])[failed], np.asarray(swept[up])[failed], **FAILED)
    return drawn


# Products ------------------------------------------------------------------------------------------------------------


def _alone_of_product(ax: Axes, swept, values, across: str) -> None:
    others = [dim for dim in values.dims if dim != across]
    band = values.quantile(list(BAND), dim=others)
    ax.fill_between(swept[across], band[0], band[1], color=LAW_COLORS[0], alpha=0.25, lw=0)
    ax.plot(swept[across], values.median(dim=others), "o-", color=LAW_COLORS[0], ms=3, lw=1.1)
    failed = has_failed(swept).any(dim=others)
    at_the_bottom(ax, np.asarray(swept[across])[np.asarray(failed)])


def _pair_of_product(ax: Axes, swept, values, across: str, up: str, limits) -> Any:
    grid = np.asarray(_median(values, across, up).transpose(up, across), float)
    low, high = limits
    drawn = ax.pcolormesh(
        swept[across], swept[up], grid, cmap="viridis", shading="nearest", rasterized=True, vmin=low, vmax=high
    )
    ax.grid(False)
    mark_failures(ax, swept, across, up)
    return drawn


def _median(values, across: str, up: str) -> "xarray.DataArray":
    """Over all parameters but two."""
    return values.median(dim=[dim for dim in values.dims if dim not in (across, up)])


def mark_failures(ax: Axes, swept, across: str, up: str) -> int:
    """A cross in each cell of a map in which a run failed; returns how many cells."""
    others = [dim for dim in swept["status"].dims if dim not in (across, up)]
    rows, columns = np.nonzero(np.asarray(has_failed(swept).any(dim=others).transpose(up, across)))
    if len(rows):
        ax.plot(
            np.asarray(swept[across])[columns], np.asarray(swept[up])[rows], label="failed", clip_on=False, **FAILED
        )
    return len(rows)

"""The figure of a design study: the measures of all designs that were tried."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from spherejax.output.plot.style import LAW_COLORS, legend_below, new_figure


def history_figure(
    measures: Mapping[str, np.ndarray],
    limits: Mapping[str, tuple[float, float]],
    units: Mapping[str, str],
    keeps_limits: np.ndarray,
    title: str,
) -> Figure:
    """Each measure by the number of the design, one panel below the other; limits are shaded.

    Args:
        measures: values of all designs, by name; the first is the one made least.
        limits: pairs (lower, upper) by name of the measure; infinite where there is none.
        units: by name.
        keeps_limits: which designs keep all limits.
        title: what was sought.
    """
    figure, axes = new_figure(len(measures), 1, 7.0, 2.2 * len(measures) + 0.6, title)
    legal = np.asarray(keeps_limits, bool)
    for ax, (name, values) in zip(axes[:, 0], measures.items(), strict=True):
        values = np.asarray(values)
        numbers = np.arange(1, values.size + 1)
        ax.plot(numbers, values, color="0.7", lw=0.8, zorder=1)
        ax.scatter(numbers[legal], values[legal], s=14, color=LAW_COLORS[0], label="keeps the limits", zorder=2)
        ax.scatter(
            numbers[~legal], values[~legal], s=14, facecolors="none", edgecolors=LAW_COLORS[1],
            label="oversteps a limit", zorder=2,
        )  # fmt: skip
        _shade(ax, limits.get(name, (-np.inf, np.inf)))
        unit = units.get(name, "")
        ax.set_ylabel(f"{name}{f' [{unit}]' if unit else ''}", fontsize=8)
    axes[-1, 0].set_xlabel("design")
    legend_below(figure, axes[0, 0])
    return figure


def _shade(ax, limit: tuple[float, float]) -> None:
    low, high = ax.get_ylim()
    for bound, outside in ((limit[0], low), (limit[1], high)):
        if np.isfinite(bound):
            ax.axhline(bound, color="0.3", lw=0.8, ls="--")
            ax.axhspan(bound, max(outside, bound) if bound == limit[1] else min(outside, bound), color="0.92", zorder=0)
    ax.set_ylim(low, high)

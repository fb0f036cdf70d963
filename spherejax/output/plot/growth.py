"""The picture of how sensitivities grow along a record, and how far a gradient means anything."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from spherejax.output.plot.style import LAW_COLORS, legend_below, legend_under, letter, new_figure

STYLES = ("-", "--", ":", "-.")
"""Of experiments."""


def growth_figure(
    sizes: Mapping[str, tuple[np.ndarray, np.ndarray]],
    names: Sequence[str],
    followed: Sequence[tuple[float, float]],
    record: tuple[float, float],
    title: str,
) -> Figure:
    """Sensitivities by parameter along time; beside them, how long changes of the parameters are followed.

    Args:
        sizes: by experiment instants [s] and sensitivities over the noise, shape (n, k).
        names: of the parameters.
        followed: changes of the parameters and until when the motion follows its tangent [s].
        record: its first and last instant [s].
        title: what is shown.
    """
    figure, axes = new_figure(1, 2, 10.0, 4.2, title)
    left, right = axes[0]
    for style, (experiment, (ts, by_parameter)) in zip(STYLES * len(sizes), sizes.items(), strict=False):
        several = f" ({experiment})" if len(sizes) > 1 else ""
        for i, name in enumerate(names):
            seen = np.where(by_parameter[:, i] > 0, by_parameter[:, i], np.nan)
            color = LAW_COLORS[i % len(LAW_COLORS)]
            left.semilogy(ts, seen, style, color=color, linewidth=1.0, label=f"{name}{several}")
    left.set_xlabel("time [s]")
    left.set_ylabel("|d prediction / d ln parameter| / noise")
    left.set_title("sensitivities", loc="left")
    changes, until = np.transpose(followed)
    right.semilogx(changes, until, "o-", color=LAW_COLORS[0], markersize=4)
    right.axhline(record[1], color="0.5", linewidth=0.8, linestyle="--", label="end of the record")
    right.set_ylim(record[0] - 0.03 * (record[1] - record[0]), record[1] + 0.06 * (record[1] - record[0]))
    right.set_xlabel("change of the parameters (share of their sizes)")
    right.set_ylabel("followed by the tangent until [s]")
    right.set_title("how far the gradient means something", loc="left")
    legend_under(right, n_columns=1, gap=0.18)
    letter([left, right])
    if len(sizes) * len(names) <= len(LAW_COLORS):
        legend_below(figure, left)
    return figure

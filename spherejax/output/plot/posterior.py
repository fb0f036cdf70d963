"""Pictures of a posterior: pairs of parameters, and the chains."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from spherejax.output.plot.style import LAW_COLORS, legend_below, new_figure

LARGEST_GRID = 8
"""Numbers in a figure of pairs; those beyond are left out, and the title says so."""

N_BINS = 30


def pairs_figure(
    draws: np.ndarray, names: list[str], normal: tuple[np.ndarray, np.ndarray] | None, title: str
) -> Figure:
    """Draws of each pair of numbers; on the diagonal how often each value occurs.

    Args:
        draws: (n_chains, n_draws, k).
        names: of the k numbers.
        normal: mean (k,) and covariance (k, k) of a normal distribution to compare with, drawn with its densities and
            the ellipses of one and two standard deviations; None: nothing.
        title: what was drawn from.
    """
    k = min(len(names), LARGEST_GRID)
    if k < len(names):
        title = f"{title}\nthe first {k} of {len(names)} numbers"
    flat = draws.reshape(-1, draws.shape[-1])
    figure, axes = new_figure(k, k, 2.6 * k + 1.0, 2.3 * k + 0.8, title)
    for row in range(k):
        for column in range(k):
            ax = axes[row, column]
            if column > row:
                ax.set_visible(False)
                continue
            if row == column:
                _often(ax, flat[:, row], None if normal is None else (normal[0][row], normal[1][row, row]))
            else:
                ax.plot(flat[:, column], flat[:, row], ".", color=LAW_COLORS[5], ms=2, alpha=0.5, rasterized=True)
                if normal is not None:
                    _ellipses(ax, normal[0], normal[1], column, row)
                ax.set_ylabel(names[row])
            if row == k - 1:
                ax.set_xlabel(names[column])
            _few_ticks(ax, both=row != column)
        axes[row, row].set_xlim(axes[-1, row].get_xlim())
    legend_below(figure, axes[0, 0])
    return figure


def _few_ticks(ax: Axes, *, both: bool) -> None:
    ax.xaxis.set_major_locator(MaxNLocator(4))
    ax.ticklabel_format(axis="x", style="sci", scilimits=(-2, 4))
    if both:
        ax.yaxis.set_major_locator(MaxNLocator(4))
        ax.ticklabel_format(axis="y", style="sci", scilimits=(-2, 4))


def _often(ax: Axes, values: np.ndarray, normal) -> None:
    ax.hist(values, bins=N_BINS, density=True, color=LAW_COLORS[5], label="draws")
    if normal is not None and np.isfinite(normal[1]):
        mean, deviation = normal[0], np.sqrt(normal[1])
        low, high = values.min(), values.max()
        reach = 0.2 * (high - low)
        at = np.linspace(low - reach, high + reach, 301)
        density = np.exp(-(((at - mean) / deviation) ** 2) / 2) / (deviation * np.sqrt(2 * np.pi))
        ax.plot(at, density, color=LAW_COLORS[1], lw=1.2, label="fit")
    ax.set_yticks([])


def _ellipses(ax: Axes, mean: np.ndarray, covariance: np.ndarray, x: int, y: int) -> None:
    part = covariance[np.ix_([x, y], [x, y])]
    if not np.all(np.isfinite(part)):
        return
    sizes, axes = np.linalg.eigh(part)
    angle = np.linspace(0, 2 * np.pi, 100)
    circle = axes @ (np.sqrt(np.maximum(sizes, 0))[:, None] * np.stack([np.cos(angle), np.sin(angle)]))
    box = ax.axis()
    for reach in (1, 2):
        ax.plot(mean[x] + reach * circle[0], mean[y] + reach * circle[1], color=LAW_COLORS[1], lw=1.0)
    # What the data do not determine has ellipses as large as life.
    if np.ptp(circle[0]) > 2 * (box[1] - box[0]) or np.ptp(circle[1]) > 2 * (box[3] - box[2]):
        ax.axis(box)


def traces_figure(draws: np.ndarray, names: list[str], title: str) -> Figure:
    """Each number along the chains.

    Args:
        draws: (n_chains, n_draws, k).
        names: of the k numbers.
        title: what was drawn from.
    """
    k = min(len(names), LARGEST_GRID)
    figure, axes = new_figure(k, 1, 7.5, 1.6 * k + 0.8, title)
    for at, ax in enumerate(axes[:, 0]):
        for chain, values in enumerate(draws[..., at]):
            ax.plot(values, lw=0.5, color=LAW_COLORS[chain % len(LAW_COLORS)], label=f"chain {chain + 1}")
        ax.set_ylabel(names[at])
    axes[-1, 0].set_xlabel("draw")
    legend_below(figure, axes[0, 0])
    return figure

"""Pictures of what scatters: histograms, contributions along time, and shares of variances."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from spherejax.output.plot.style import LAW_COLORS, LAW_DASHES, legend_below, new_figure

COLUMNS = 3
"""Panels side by side."""

CURVES = len(LAW_COLORS)
"""Numbers that are drawn one by one, those that matter most; the others are drawn together."""

PANELS = 9
"""In one figure, those that scatter most."""


def histograms_figure(output: Any) -> Figure:
    """How often each value of an output occurs, with mean and the middle 95 %.

    Args:
        output: a `studies.uncertainty.outputs.Output`; its entries that scatter most are drawn.
    """
    flat = output.flat
    deviations = flat.std(0)
    shown = [c for c in np.argsort(-deviations, kind="stable")[:PANELS] if deviations[c] > 1e-9 * deviations.max()]
    shown = sorted(shown) or [0]
    figure, axes = _panels(len(shown), f"Scatter of {_words(output.name)}: {len(flat)} runs")
    for ax, c in zip(axes, shown, strict=True):
        values = flat[:, c]
        ax.hist(values, bins=min(40, max(10, len(values) // 25)), color=LAW_COLORS[5])
        ax.axvline(values.mean(), color=LAW_COLORS[1], lw=1.4, label="mean")
        for share, said in zip(np.quantile(values, [0.025, 0.975]), ("middle 95 %", None), strict=True):
            ax.axvline(share, color=LAW_COLORS[0], lw=1.2, ls=LAW_DASHES[1], label=said)
        ax.set_xlabel(_with_unit(output.labels[c], output.unit))
        ax.set_ylabel("runs")
        ax.ticklabel_format(style="sci", axis="x", scilimits=(-3, 4), useMathText=True)
    legend_below(figure, axes[0])
    return figure


def budget_figure(part: Any, names: Sequence[str], ts: Float[np.ndarray, " n"]) -> Figure:
    """What a deviation of each number changes along time, and the standard deviation that they make together.

    Args:
        part: a `studies.uncertainty.budget.BudgetPart`.
        names: of the numbers.
        ts: sample times [s].
    """
    column = part.column
    largest = np.nanmax(part.deviation, axis=0, initial=0.0)
    shown = [c for c in range(len(column.labels)) if largest[c] > 1e-9 * largest.max()] or [0]
    order = np.argsort(-np.nan_to_num(np.abs(part.effects)).max(axis=(0, 1)), kind="stable")[:CURVES]
    figure, axes = _panels(len(shown), f"Deviation of {_words(column.name)}, first order")
    for ax, c in zip(axes, shown, strict=True):
        deviation = part.deviation[:, c]
        ax.fill_between(ts, -deviation, deviation, color="0.85", lw=0, label="standard deviation")
        for k, at in enumerate(order):
            ax.plot(
                ts, part.effects[:, c, at], color=LAW_COLORS[k], ls=LAW_DASHES[k], lw=1.2, label=_words(names[int(at)])
            )
        ax.set_xlabel("time [s]")
        ax.set_ylabel(_with_unit(f"change of {_words(column.labels[c])}", column.unit))
        ax.ticklabel_format(style="sci", axis="y", scilimits=(-3, 4), useMathText=True)
        ax.margins(x=0.0)
    legend_below(figure, axes[0])
    return figure


def stacks_figure(rows: Sequence[tuple[str, Float[np.ndarray, " p"]]], names: Sequence[str]) -> Figure:
    """Shares of the variance as parts of a bar.

    Args:
        rows: what scatters, and the share of each number.
        names: of the numbers.
    """
    rows = list(rows) or [("nothing scatters", np.zeros(len(names)))]
    shares = np.stack([each for _, each in rows])
    order = np.argsort(-shares.sum(0), kind="stable")
    figure, axes = new_figure(1, 1, 6.6, 1.6 + 0.36 * len(rows), "Which tolerance makes the scatter")
    ax, left = axes[0, 0], np.zeros(len(rows))
    named, others = order[:CURVES], order[CURVES:]
    parts = [(_words(names[int(k)]), shares[:, k], LAW_COLORS[i]) for i, k in enumerate(named)]
    if len(others):
        parts.append((f"{len(others)} others", shares[:, others].sum(1), "0.6"))
    for name, share, color in parts:
        ax.barh(np.arange(len(rows)), 100 * share, left=left, color=color, height=0.7, label=name)
        left += 100 * share
    ax.set_yticks(np.arange(len(rows)), [_words(label) for label, _ in rows])
    ax.invert_yaxis()
    ax.set_xlim(0, 100)
    ax.set_xlabel("share of the variance [%], where it is largest")
    legend_below(figure, ax)
    return figure


def shares_figure(shares: Any, names: Sequence[str]) -> Figure:
    """Bars of first and total indices with their standard errors.

    Args:
        shares: a `studies.uncertainty.sobol.Shares`; the entries that scatter most are drawn.
        names: of the numbers.
    """
    largest = shares.deviation.max(initial=0.0)
    shown = [c for c in np.argsort(-shares.deviation, kind="stable")[:PANELS] if shares.deviation[c] > 1e-9 * largest]
    shown = sorted(shown) or [0]
    height = 1.6 + 0.34 * len(names)
    title = f"Shares of the variance of {_words(shares.output.name)}"
    figure, axes = _panels(len(shown), title, height=height)
    at = np.arange(len(names))
    for ax, c in zip(axes, shown, strict=True):
        for place, values, errors, color, said in (
            (-0.2, shares.first[c], shares.first_error[c], LAW_COLORS[0], "by itself"),
            (0.2, shares.total[c], shares.total_error[c], LAW_COLORS[4], "with others"),
        ):
            ax.barh(at + place, 100 * values, height=0.38, color=color, xerr=100 * errors, label=said, ecolor="0.3")
        ax.set_yticks(at, [_words(name) for name in names])
        ax.invert_yaxis()
        ax.axvline(0.0, color="0.6", lw=0.6)
        ax.set_xlabel(f"{_words(shares.output.labels[c])} [%]")
    legend_below(figure, axes[0])
    return figure


def shares_in_time_figure(shares: Any, names: Sequence[str], ts: Float[np.ndarray, " n"]) -> Figure:
    """Total indices along time, beside the standard deviation that they share.

    Args:
        shares: a `studies.uncertainty.sobol.Shares` of what depends on time.
        names: of the numbers.
        ts: sample times [s].
    """
    output, n = shares.output, len(ts)
    deviation = shares.deviation.reshape(n, -1)
    total = shares.total.reshape(n, -1, len(names))
    largest = deviation.max(0, initial=0.0)
    shown = [c for c in range(deviation.shape[1]) if largest[c] > 1e-9 * largest.max(initial=0.0)][:PANELS] or [0]
    weight = np.sum(total * deviation[..., None] ** 2, axis=(0, 1))
    order = np.argsort(-weight, kind="stable")[:CURVES]
    title = f"Shares of the variance of {_words(output.name)}"
    figure, axes = new_figure(2, len(shown), 4.0 * len(shown) + 0.6, 5.2, title)
    for column, c in zip(axes.T, shown, strict=True):
        column[0].plot(ts, deviation[:, c], color="0.2", lw=1.2)
        column[0].set_ylabel(_with_unit("standard deviation", output.unit))
        column[0].ticklabel_format(style="sci", axis="y", scilimits=(-3, 4), useMathText=True)
        if len(shown) > 1:
            column[0].set_title(_words(output.labels[c].replace(f" at {ts[0]:.4g} s", "")), fontsize=9)
        for k, at in enumerate(order):
            share = np.where(deviation[:, c] > 1e-9 * largest[c], 100 * total[:, c, at], np.nan)
            column[1].plot(ts, share, color=LAW_COLORS[k], ls=LAW_DASHES[k], lw=1.2, label=_words(names[int(at)]))
        column[1].set_ylabel("share, with others [%]")
        column[1].set_xlabel("time [s]")
        column[1].set_ylim(-5, 105)
    legend_below(figure, axes[1, 0])
    return figure


def _panels(n: int, title: str, height: float = 2.9) -> tuple[Figure, list]:
    """A figure with n panels in rows."""
    columns = min(n, COLUMNS)
    rows = -(-n // columns)
    figure, axes = new_figure(rows, columns, 3.6 * columns + 0.8, height * rows + 0.7, title)
    for ax in axes.ravel()[n:]:
        ax.set_visible(False)
    return figure, list(axes.ravel()[:n])


def _with_unit(text: str, unit: str) -> str:
    return f"{_words(text)} [{unit}]" if unit else _words(text)


def _words(name: str) -> str:
    return name.replace("_", " ")

"""Pictures of a fit: data and model, residuals, correlations, the path to the minimum."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

from spherejax.output.plot.style import LAW_COLORS, legend_below, legend_under, letter, new_figure, note, number_decades

LARGEST_SHEET = 12
"""Panels of a sheet; components beyond are left out, and the sheet says so."""


class FittedComponent(NamedTuple):
    """One measured component.

    Attributes:
        label: what it is, with its unit.
        ts: instants at which it was measured [s].
        measured: values.
        predicted: values at the estimates.
        noise: standard deviations.
    """

    label: str
    ts: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    noise: np.ndarray

    @property
    def residuals(self) -> np.ndarray:
        """Over the noise."""
        return (self.predicted - self.measured) / self.noise


def fit_figure(components: Sequence[FittedComponent], title: str) -> Figure:
    """Measurements as points, the model as a line."""
    figure, panels = _sheet(components, title)
    for ax, each in zip(panels, components, strict=False):
        ax.plot(each.ts, each.measured, ".", color=LAW_COLORS[1], markersize=3, label="measured")
        ax.plot(each.ts, each.predicted, color=LAW_COLORS[0], linewidth=1.0, label="model at the estimates")
        ax.set_xlabel("time [s]")
        ax.set_ylabel(each.label)
    letter(panels)
    legend_below(figure, panels[0])
    return figure


def residuals_figure(components: Sequence[FittedComponent], title: str) -> Figure:
    """Residuals over the noise along time, and how often each size occurs, beside the normal distribution."""
    shown = list(components[: LARGEST_SHEET // 2])
    figure, axes = new_figure(len(shown), 2, 9.0, 1.0 + 2.1 * len(shown), _with_left_out(title, components, len(shown)))
    for (along, often), each in zip(axes, shown, strict=True):
        residuals = each.residuals
        along.axhspan(-2, 2, color="0.93", zorder=0)
        along.axhline(0, color="0.5", linewidth=0.8)
        along.plot(each.ts, residuals, ".", color=LAW_COLORS[0], markersize=3)
        along.set_xlabel("time [s]")
        along.set_ylabel("residual / noise")
        along.set_title(each.label, loc="left", fontsize=9)
        _distribution(often, residuals)
    letter([ax for ax in axes.flat])
    return figure


def _distribution(ax: Axes, residuals: np.ndarray) -> None:
    reach = max(4.0, float(np.max(np.abs(residuals))))
    ax.hist(residuals, bins=30, range=(-reach, reach), density=True, color=LAW_COLORS[5], label="residuals")
    at = np.linspace(-reach, reach, 201)
    normal = np.exp(-(at**2) / 2) / np.sqrt(2 * np.pi)
    ax.plot(at, normal, color=LAW_COLORS[1], linewidth=1.2, label="normal noise")
    ax.set_xlabel("residual / noise")
    ax.set_ylabel("density")
    ax.set_title("how often each size occurs", loc="left")
    legend_under(ax, gap=0.2)
    note(ax, f"standard deviation {np.std(residuals):.3g}", place=(0.02, 0.98))


def correlation_figure(correlation: np.ndarray, names: Sequence[str], title: str) -> Figure:
    """The correlation matrix of the estimates, with its numbers."""
    size = 2.8 + 0.55 * len(names)
    figure, axes = new_figure(1, 1, size + 0.8, size, title)
    ax = axes[0, 0]
    ax.grid(False)
    image = ax.imshow(correlation, cmap="RdBu_r", norm=TwoSlopeNorm(0.0, -1.0, 1.0))
    ax.set_xticks(range(len(names)), names, rotation=45, ha="right")
    ax.set_yticks(range(len(names)), names)
    for (row, column), value in np.ndenumerate(correlation):
        color = "white" if abs(value) > 0.6 else "black"
        ax.text(column, row, f"{value:.2f}", ha="center", va="center", fontsize=8, color=color)
    bar = figure.colorbar(image, ax=ax, shrink=0.8)
    bar.set_label("correlation", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    return figure


def history_figure(costs: np.ndarray, ends: np.ndarray, values: np.ndarray, names: Sequence[str], title: str) -> Figure:
    """Residuals and parameters by accepted step; lines mark where the record that is looked at grows.

    Args:
        costs: mean squares of the residuals over the noise, of each step.
        ends: end of the record that they are of [s], infinite for the whole.
        values: parameters, shape (steps, k).
        names: of the parameters.
        title: what is shown.
    """
    steps = np.arange(len(costs))
    figure, axes = new_figure(1, 2, 10.0, 4.0, title)
    left, right = axes[0]
    left.semilogy(steps, costs, ".-", color=LAW_COLORS[0], markersize=4)
    left.set_ylabel("mean square of residual / noise")
    left.set_title("cost", loc="left")
    positive = bool(np.all(values > 0))
    shown = values if positive else values / np.maximum(np.abs(values[-1]), 1e-300)
    shown = shown / shown[-1] if positive else shown
    for i, name in enumerate(names):
        right.plot(steps, shown[:, i], ".-", markersize=4, color=LAW_COLORS[i % len(LAW_COLORS)], label=name)
    if positive:
        right.set_yscale("log")
        number_decades(right.yaxis, shown)
    right.set_ylabel("parameter / estimate")
    right.set_title("parameters", loc="left")
    for ax in (left, right):
        ax.set_xlabel("accepted step")
        for step in np.nonzero(np.diff(np.nan_to_num(ends, posinf=np.finfo(float).max)))[0]:
            ax.axvline(step + 0.5, color="0.6", linewidth=0.8, linestyle=":")
    if np.any(np.isfinite(ends)):
        note(left, "dotted: the record that is looked at grows", place=(0.99, 0.98))
    letter([left, right])
    if len(names) <= len(LAW_COLORS):
        legend_below(figure, right)
    return figure


def _sheet(components: Sequence[FittedComponent], title: str) -> tuple[Figure, list[Axes]]:
    n = min(len(components), LARGEST_SHEET)
    columns = 1 if n == 1 else 2
    rows = -(-n // columns)
    figure, axes = new_figure(rows, columns, 7.5 if n == 1 else 10.0, 1.2 + 2.4 * rows, title)
    figure.suptitle(_with_left_out(title, components, n), fontsize=11)
    panels = list(axes.flat)
    for spare in panels[n:]:
        spare.set_axis_off()
    return figure, panels[:n]


def _with_left_out(title: str, components: Sequence[FittedComponent], n: int) -> str:
    return title if len(components) <= n else f"{title} ({n} of {len(components)} components)"

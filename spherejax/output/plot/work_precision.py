"""What accuracy costs: errors against seconds, steps and tolerances, and statistics where histories do not repeat."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from spherejax.output.plot.style import (
    LAW_COLORS,
    MODEL_COLORS,
    dress,
    legend_below,
    letter,
    new_figure,
    note,
    number_decades,
)

MARKERS = ("o", "s", "^", "D", "v", "P")
"""A marker for each solver: points stay apart in a print without color."""


@dataclass(frozen=True)
class WorkCurve:
    """The finished runs of one solver, in the order of their tolerances.

    Attributes:
        solver: its name.
        rtols: relative tolerances.
        seconds: times of a run [s].
        steps: steps tried.
        errors: achieved errors by quantity, each as long as `rtols`.
        statistics: as `errors`; empty for a motion that repeats.
    """

    solver: str
    rtols: Sequence[float]
    seconds: Sequence[float]
    steps: Sequence[float]
    errors: Mapping[str, Sequence[float]]
    statistics: Mapping[str, Sequence[float]] = field(default_factory=dict)


class Statistic(NamedTuple):
    """A panel of a statistic.

    Attributes:
        title: what it is, with the unit of the axis.
        scale: factor from the values to the axis.
        mean: of an ensemble of tight runs.
        deviation: standard deviation of the ensemble.
    """

    title: str
    scale: float
    mean: float
    deviation: float


@dataclass(frozen=True)
class WorkDiagram:
    """All curves of one model.

    Attributes:
        title: what was run.
        curves: one for each solver.
        units: unit of each quantity, in the order of the panels; the first is drawn large.
        floors: error of each quantity below which the reference says nothing.
        frontiers: seconds and errors of the runs that no other beats, by quantity.
        statistics: how each statistic of the curves is drawn.
        remark: what cannot be seen in the curves, such as solvers that did not finish.
    """

    title: str
    curves: Sequence[WorkCurve]
    units: Mapping[str, str]
    floors: Mapping[str, float]
    frontiers: Mapping[str, tuple[Sequence[float], Sequence[float]]]
    statistics: Mapping[str, "Statistic"] = field(default_factory=dict)
    remark: str = ""


def work_precision_figure(diagram: WorkDiagram) -> Figure:
    """Error against seconds: the first quantity large with tolerances at the points, the others small."""
    figure, axes = new_figure(2, 4, 12.5, 6.2, diagram.title)
    grid = axes[0, 0].get_gridspec()
    for ax in axes[:, :2].flat:
        ax.remove()
    large = figure.add_subplot(grid[:, :2])
    dress(large)
    panels = [large, *axes[:, 2:].flat]
    for ax, quantity in zip(panels, diagram.units, strict=False):
        _draw_errors(ax, diagram, quantity, lambda curve: curve.seconds)
        _draw_frontier(ax, *diagram.frontiers[quantity], is_large=ax is large)
        _seconds_axis(ax)
        ax.set_xlabel("time of a run")
    for place, (curve, color, _) in enumerate(_dressed(diagram.curves)):
        _label_tolerances(large, curve, next(iter(diagram.units)), color, to_the_left=place % 2 == 1)
    note(large, "down and left is better; labels: relative tolerance", place=(0.99, 0.99))
    if diagram.remark:
        note(large, diagram.remark, place=(0.01, 0.01))
    letter(panels)
    legend_below(figure, large)
    return figure


def steps_figure(diagram: WorkDiagram) -> Figure:
    """Error of the first quantity against steps, and against the tolerance that was asked for."""
    quantity = next(iter(diagram.units))
    figure, axes = new_figure(1, 2, 9.5, 4.8, diagram.title)
    by_steps, by_tolerance = axes[0]
    _draw_errors(by_steps, diagram, quantity, lambda curve: curve.steps)
    by_steps.set_xlabel("steps tried")
    every = np.concatenate([np.asarray(curve.steps, float) for curve in diagram.curves] or [np.ones(1)])
    number_decades(by_steps.xaxis, every[np.isfinite(every) & (every > 0)])
    by_steps.set_title("error and steps", loc="left", fontsize=9)
    _draw_errors(by_tolerance, diagram, quantity, lambda curve: curve.rtols)
    _tolerance_axis(by_tolerance)
    by_tolerance.set_title("error and tolerance", loc="left", fontsize=9)
    letter([by_steps, by_tolerance])
    legend_below(figure, by_steps)
    return figure


def statistics_figure(diagram: WorkDiagram, title: str) -> Figure:
    """Statistics of every run against its tolerance, beside mean and spread of the tight runs.

    Args:
        diagram: the curves, with their statistics.
        title: over which time the statistics are taken.
    """
    n_columns = 4
    n_rows = -(-len(diagram.statistics) // n_columns)
    figure, axes = new_figure(n_rows, n_columns, 12.5, 3.0 * n_rows + 0.7, title)
    for ax in axes.flat[len(diagram.statistics) :]:
        ax.remove()
    panels = list(axes.flat)[: len(diagram.statistics)]
    for ax, (name, statistic) in zip(panels, diagram.statistics.items(), strict=True):
        mean, deviation = statistic.scale * statistic.mean, statistic.scale * statistic.deviation
        for width, shade in ((3, "0.93"), (1, "0.84")):
            ax.axhspan(mean - width * deviation, mean + width * deviation, color=shade, lw=0, zorder=0)
        ax.axhline(mean, color="0.4", lw=1.0, ls="--", label="tight runs: mean, one and three standard deviations")
        for curve, color, marker in _dressed(diagram.curves):
            values = statistic.scale * np.asarray(curve.statistics[name])
            ax.plot(curve.rtols, values, marker=marker, color=color, ms=4, lw=0, label=curve.solver)
        _tolerance_axis(ax)
        ax.yaxis.get_major_formatter().set_useOffset(False)
        ax.set_title(statistic.title, loc="left", fontsize=9)
    letter(panels)
    legend_below(figure, panels[0])
    return figure


def frontiers_figure(frontiers: Mapping[str, Sequence[tuple[float, float, str]]], title: str) -> Figure:
    """What accuracy costs for each of several models.

    Args:
        frontiers: seconds, position error [m] and label of the runs of each model that no other beats.
        title: what is shown.
    """
    figure, axes = new_figure(1, 1, 8.0, 5.6, title)
    ax = axes[0, 0]
    spare = iter(LAW_COLORS * len(frontiers))
    for place, (model, runs) in enumerate(frontiers.items()):
        color = MODEL_COLORS.get(model) or next(spare)
        seconds, errors = [run[0] for run in runs], [run[1] for run in runs]
        ax.plot(seconds, errors, marker=MARKERS[place % len(MARKERS)], color=color, ms=4.5, lw=1.3, label=model)
        for x, y, label in runs:
            text = label.replace("e-0", "e-")
            ax.annotate(text, (x, y), (5, 3), textcoords="offset points", fontsize=6.0, color=color)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.yaxis.set_minor_locator(NullLocator())
    _seconds_axis(ax)
    ax.margins(x=0.12)
    note(ax, "an error that a reference does not resolve is drawn at the reference's bound", place=(0.01, 0.01))
    ax.set_xlabel("time of a run")
    ax.set_ylabel("position error [m]")
    legend_below(figure, ax)
    return figure


def _tolerance_axis(ax: Axes) -> None:
    ax.set_xscale("log")
    ax.invert_xaxis()
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_xlabel("relative tolerance asked for")


def _dressed(curves: Sequence[WorkCurve]):
    """Curves with their colors and markers, the same in every panel."""
    n = len(curves)
    return zip(curves, (LAW_COLORS * n)[:n], (MARKERS * n)[:n], strict=True)


def _draw_errors(ax: Axes, diagram: WorkDiagram, quantity: str, place_of) -> None:
    """Errors of one quantity as lines, above a band that the reference does not resolve."""
    floor = diagram.floors[quantity]
    for curve, color, marker in _dressed(diagram.curves):
        errors = np.maximum(curve.errors[quantity], 1e-300)
        ax.plot(place_of(curve), errors, marker=marker, color=color, ms=4.5, lw=1.1, label=curve.solver, zorder=3)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.yaxis.set_major_locator(LogLocator(numticks=12))
    ax.yaxis.set_minor_locator(NullLocator())
    every = [np.asarray(curve.errors[quantity], float) for curve in diagram.curves]
    shown = np.concatenate(every) if every else np.zeros(0)
    shown = shown[np.isfinite(shown) & (shown > 0)]
    lowest = min(shown.min(initial=np.inf), floor if floor > 0 else np.inf)
    highest = shown.max(initial=0.0)
    if np.isfinite(lowest) and highest > 0:
        ax.set_ylim(0.25 * lowest, 4 * max(highest, lowest))
    if floor > 0:
        ax.axhspan(0.0, floor, color="0.90", lw=0, zorder=0, label="not resolved by the reference")
    unit = diagram.units[quantity].replace("^2", "$^2$")
    ax.set_ylabel(f"error [{unit}]")
    ax.set_title(quantity, loc="left", fontsize=9)


def _draw_frontier(ax: Axes, seconds: Sequence[float], errors: Sequence[float], *, is_large: bool) -> None:
    width = 9.0 if is_large else 6.0
    ax.plot(
        seconds,
        errors,
        color="#F0E442",
        lw=width,
        alpha=0.75,
        solid_capstyle="round",
        solid_joinstyle="round",
        zorder=1,
        label="no other run beats it",
    )


def _label_tolerances(ax: Axes, curve: WorkCurve, quantity: str, color: str, *, to_the_left: bool) -> None:
    """Tolerances in their curve's color; neighbors on different sides, so that close curves can be read."""
    offset, side = ((-5, -7), "right") if to_the_left else ((5, 3), "left")
    for rtol, seconds, error in zip(curve.rtols, curve.seconds, curve.errors[quantity], strict=True):
        if np.isfinite(error):
            text = f"{rtol:.0e}".replace("e-0", "e-")
            ax.annotate(
                text, (seconds, error), offset, textcoords="offset points", fontsize=6.5, color=color, ha=side, zorder=4
            )


FEWEST_TICKS = 3
"""On an axis of times."""


def _seconds_axis(ax: Axes) -> None:
    """Ticks such as 2 ms: times span a decade or two, where powers of ten alone would be too few."""
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: duration_tick(value)))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_minor_formatter(NullFormatter())
    low, high = ax.get_xlim()
    if high / low > 1e3:
        ax.xaxis.set_major_locator(LogLocator(numticks=6))
        return
    for subs in ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 2.0, 3.0, 5.0), (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)):
        ticks = LogLocator(subs=subs)
        places = np.asarray(ticks.tick_values(low, high))
        if np.sum((low <= places) & (places <= high)) >= FEWEST_TICKS:
            ax.xaxis.set_major_locator(ticks)
            return
    ax.xaxis.set_major_locator(MaxNLocator(4, min_n_ticks=FEWEST_TICKS))


def duration_tick(seconds: float) -> str:
    """A time as a tick label, e.g. `20 ms`."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= 0.999 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.0e} s"

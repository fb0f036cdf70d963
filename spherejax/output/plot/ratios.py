"""Computing time of the joint models against the ideal one (Figs 21 and 25)."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from matplotlib.figure import Figure

from spherejax.output.plot.style import legend_below, model_colors, new_figure


def time_ratios(
    models: Mapping[str, str],
    ratios: Sequence[float],
    steps: Sequence[int],
    title: str,
    *,
    colors: Mapping[str, str] | None = None,
) -> Figure:
    """A bar for each model on a logarithmic axis, annotated with ratio and steps.

    Args:
        models: what each model is called in figures, by its name, the ideal one among them.
        ratios: computing time divided by that of the ideal model.
        steps: steps of the integrator.
        title: what is shown.
        colors: of the models, by name; those of the kinds of models when None.
    """
    figure, axes = new_figure(1, 1, max(6.8, 1.3 * len(models)), 4.0, title)
    ax = axes[0, 0]
    shown = model_colors(dict.fromkeys(models, "")) if colors is None else colors
    ax.bar(list(models.values()), ratios, color=[shown[name] for name in models], width=0.6)
    for position, (ratio, n_steps) in enumerate(zip(ratios, steps, strict=True)):
        text = f"{ratio:.3g}\n{n_steps:,} steps"
        ax.annotate(text, (position, ratio), (0, 3), textcoords="offset points", ha="center", fontsize=8)
    ax.set_yscale("log")
    ax.set_ylim(min(0.5, 0.5 * min(ratios)), 6.0 * max(ratios))
    ax.set_ylabel("time of a warm run / that of the ideal joint [-]")
    ax.tick_params(axis="x", labelsize=9)
    ax.grid(False, axis="x")
    return figure


class Bar(NamedTuple):
    """One model with one method.

    Attributes:
        ratio: computing time divided by that of the ideal model with the same method.
        n_steps: steps of the integrator.
        seconds: computing time [s].
    """

    ratio: float
    n_steps: int
    seconds: float


HATCHES = ("", "////", "....")
"""A hatch for each method."""


def time_ratios_by_method(models: Mapping[str, str], methods: Mapping[str, Sequence[Bar]], title: str) -> Figure:
    """For each model a bar for each method, annotated with ratio, steps and time.

    Args:
        models: what each model is called in figures, by its name.
        methods: by the name of the method, a bar for each model.
        title: what is shown.
    """
    figure, axes = new_figure(1, 1, 10.5, 4.8, title)
    ax = axes[0, 0]
    width = 0.8 / len(methods)
    for place, (method, bars) in enumerate(methods.items()):
        middles = [position + (place - (len(methods) - 1) / 2) * width for position in range(len(models))]
        colors = list(model_colors(dict.fromkeys(models, "")).values())
        heights = [bar.ratio for bar in bars]
        ax.bar(middles, heights, 0.92 * width, color=colors, hatch=HATCHES[place], edgecolor="white", lw=0.5)
        ax.bar([0], [0], color="0.6", hatch=HATCHES[place], edgecolor="white", label=method)
        for middle, bar in zip(middles, bars, strict=True):
            text = f"{bar.ratio:.3g}\n{_count(bar.n_steps)} steps\n{_duration(bar.seconds)}"
            ax.annotate(text, (middle, bar.ratio), (0, 3), textcoords="offset points", ha="center", fontsize=7.5)
    ratios = [bar.ratio for bars in methods.values() for bar in bars]
    ax.set_xticks(range(len(models)), list(models.values()))
    ax.set_yscale("log")
    ax.set_ylim(min(0.5, 0.5 * min(ratios)), 6.0 * max(ratios))
    ax.set_ylabel("time of a warm run / that of the ideal joint [-]")
    ax.tick_params(axis="x", labelsize=9)
    ax.grid(False, axis="x")
    legend_below(figure, ax)
    return figure


def _count(n: int) -> str:
    return f"{n:,}" if n < 1e5 else f"{n / 1e3:,.0f} k"


def _duration(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.3g} s"

"""Figures of sensitivities: which parameter matters when, and which matters most."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spherejax.output.plot.style import LAW_COLORS, LAW_DASHES, legend_below, new_figure

CURVES = len(LAW_COLORS)
"""Parameters that are drawn as curves, those that matter most; the map has more of them."""

ROWS = 24
"""Parameters in a map or a ranking, at most."""


@dataclass(frozen=True)
class EffectBars:
    """What 1 % of each parameter changes of an observable.

    Attributes:
        name: of the observable.
        unit: its unit.
        ts: sample times [s].
        parameters: names, the one that matters most first.
        labels: names of the observable's components.
        values: shape (n, components, p).
    """

    name: str
    unit: str
    ts: Float[np.ndarray, " n"]
    parameters: tuple[str, ...]
    labels: tuple[str, ...]
    values: Float[np.ndarray, "n c p"]


def effects_figure(effects: EffectBars) -> Figure:
    """Curves and a map over time for each component that changes at all."""
    changing = [c for c in range(len(effects.labels)) if np.any(np.abs(np.nan_to_num(effects.values[:, c])) > 0)] or [0]
    largest = float(np.nanmax(np.abs(effects.values), initial=0.0)) or 1.0
    changing = [c for c in changing if np.nanmax(np.abs(effects.values[:, c])) > 1e-9 * largest] or changing[:1]
    n_rows = min(len(effects.parameters), ROWS)
    height = max(2.5, 1.2 + 0.24 * n_rows)
    title = f"What 1 % of each parameter changes of {_words(effects.name)}"
    figure, axes = new_figure(len(changing), 2, 10.0, height * len(changing) + 0.6, title)
    for row, c in zip(axes, changing, strict=True):
        _draw_curves(row[0], effects, c)
        _draw_map(figure, row[1], effects, c)
    if len(effects.parameters) > 1:
        legend_below(figure, axes[0, 0])
    return figure


def _draw_curves(ax: Axes, effects: EffectBars, c: int) -> None:
    for k, name in enumerate(effects.parameters[:CURVES]):
        ax.plot(effects.ts, effects.values[:, c, k], color=LAW_COLORS[k], ls=LAW_DASHES[k], lw=1.2, label=_words(name))
    ax.set_xlabel("time [s]")
    ax.set_ylabel(f"change of {_words(effects.labels[c])} [{effects.unit}]".replace(" []", ""))
    ax.ticklabel_format(style="sci", axis="y", scilimits=(-3, 4), useMathText=True)
    ax.axhline(0.0, color="0.6", lw=0.6, zorder=0)


def _draw_map(figure: Figure, ax: Axes, effects: EffectBars, c: int) -> None:
    names = effects.parameters[:ROWS]
    values = effects.values[:, c, : len(names)].T
    limit = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
    rows = np.arange(len(names))
    drawn = ax.pcolormesh(
        effects.ts, rows, values, cmap="RdBu_r", vmin=-limit, vmax=limit, shading="nearest", rasterized=True
    )
    bar = figure.colorbar(drawn, ax=ax)
    bar.set_label(f"[{effects.unit}]" if effects.unit else "", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    bar.formatter.set_powerlimits((-3, 4))  # pyright: ignore[reportAttributeAccessIssue]
    ax.set_yticks(rows, [_words(name) for name in names])
    ax.invert_yaxis()
    ax.grid(False)
    ax.set_xlabel("time [s]")
    if len(effects.parameters) > ROWS:
        ax.set_title(f"the {ROWS} of {len(effects.parameters)} that matter most", fontsize=8)


def ranking_figure(ranking: Sequence[tuple[str, str, float]]) -> Figure:
    """Bars of how much each parameter matters: the share of an observable's variation that 1 % of it makes.

    Args:
        ranking: parameter, observable, share; the largest first.
    """
    several = len({observable for _, observable, _ in ranking}) > 1
    shown = [each for each in ranking if np.isfinite(each[2])][:ROWS] or list(ranking[:1])
    figure, axes = new_figure(1, 1, 6.4, 1.2 + 0.26 * len(shown), "Which parameter matters most")
    ax = axes[0, 0]
    observables = list(dict.fromkeys(observable for _, observable, _ in shown))
    shares = [100 * share if np.isfinite(share) else 0.0 for _, _, share in shown]
    colors = [LAW_COLORS[observables.index(observable) % len(LAW_COLORS)] for _, observable, _ in shown]
    ax.barh(np.arange(len(shown)), shares, color=colors, height=0.7)
    names = [f"{_words(p)}, on {_words(o)}" if several else _words(p) for p, o, _ in shown]
    ax.set_yticks(np.arange(len(shown)), names)
    ax.invert_yaxis()
    of = "the observable" if several else _words(shown[0][1])
    ax.set_xlabel(f"root mean square change by 1 % of the parameter,\nas % of the variation of {of}")
    positive = [share for share in shares if share > 0]
    if positive and max(positive) > 30 * min(positive):
        ax.set_xscale("log")
        ax.set_xlim(left=max(min(positive), 1e-6 * max(positive)) / 2)
    return figure


def _words(name: str) -> str:
    return name.replace("_", " ").replace(".", ", ")

"""Histories of several quantities side by side, one curve for each joint model (Fig. 23)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spherejax.foundations.errors import SceneError
from spherejax.output.plot.curves import thinned
from spherejax.output.plot.style import LABELS, legend_below, letter, model_colors, new_figure, note

WIDTHS = (3.6, 2.8, 2.0, 1.4, 0.8)
"""Line widths of curves that coincide, from the back to the front."""


@dataclass(frozen=True)
class Panel:
    """One quantity of all models, for `model_histories`.

    Attributes:
        title: what it is.
        label: of the vertical axis, with unit.
        ts: sample times [s], shape (n,).
        curves: by model name, each of shape (n,).
        window: interval of time that is shown [s]; None: all.
        limits: of the vertical axis; None: by the curves. What lies beyond is said in the panel.
        remark: a few words in a corner.
    """

    title: str
    label: str
    ts: np.ndarray
    curves: Mapping[str, np.ndarray]
    window: tuple[float, float] | None = None
    limits: tuple[float, float] | None = None
    remark: str = ""


@dataclass(frozen=True)
class Shade:
    """An interval of time that is marked in all panels of `model_histories`.

    Attributes:
        interval: [s].
        what: a word for it.
    """

    interval: tuple[float, float]
    what: str


def model_histories(
    panels: Sequence[Panel],
    labels: Mapping[str, str],
    title: str,
    *,
    n_columns: int = 2,
    shade: Shade | None = None,
) -> Figure:
    """A panel for each quantity; models that coincide are told apart by the widths of their lines.

    Args:
        panels: the quantities, at least one.
        labels: names of the models for people, by model name (`"ideal"`, `"dry"`, ...); their order is that of the
            legend. Names of joint models have their own colors, others one each.
        title: what is shown.
        n_columns: of the panels.
        shade: an interval to mark.

    Raises:
        SceneError: without a panel, or for one that has none of the models.
    """
    for panel in panels:
        if not set(panel.curves) & set(labels):
            known = ", ".join(map(repr, labels)) or "none"
            raise SceneError(f"panel {panel.title!r} has curves of {sorted(panel.curves)}, but labels are for {known}")
    n_rows = -(-len(panels) // n_columns)
    figure, axes = new_figure(n_rows, n_columns, 4.7 * n_columns, 2.6 * n_rows + 0.9, title)
    for ax in axes.flat[len(panels) :]:
        ax.remove()
    shown = list(axes.flat)[: len(panels)]
    for ax, panel in zip(shown, panels, strict=True):
        _draw(ax, panel, labels)
        if shade is not None:
            _mark(ax, shade, speaks=ax is shown[0])
    letter(shown)
    legend_below(figure, max(shown, key=lambda ax: len(ax.lines)))
    return figure


def _draw(ax: Axes, panel: Panel, labels: Mapping[str, str]) -> None:
    start, end = panel.window or (panel.ts[0], panel.ts[-1])
    inside = (panel.ts >= start) & (panel.ts <= end)
    drawn = [name for name in labels if name in panel.curves]
    widths = WIDTHS[-len(drawn) :] if len(drawn) <= len(WIDTHS) else np.linspace(WIDTHS[0], WIDTHS[-1], len(drawn))
    colors = model_colors(dict.fromkeys(labels, ""))
    for width, name in zip(widths, drawn, strict=True):
        ts, values = thinned(panel.ts[inside], panel.curves[name][inside])
        ax.plot(ts, values, color=colors[name], lw=width, alpha=0.9, label=labels[name])
    ax.set_xlim(start, end)
    ax.set_xlabel(LABELS["t"])
    ax.set_ylabel(panel.label)
    ax.set_title(panel.title, loc="left", fontsize=9)
    if panel.limits is not None:
        ax.set_ylim(*panel.limits)
        values = np.concatenate([panel.curves[name][inside] for name in drawn])
        low, high = np.nanmin(values), np.nanmax(values)
        if low < panel.limits[0] or high > panel.limits[1]:
            note(ax, f"axis clipped; peaks from {low:.3g} to {high:.3g}")
    if panel.remark:
        note(ax, panel.remark, place=(0.01, 0.99))


def _mark(ax: Axes, shade: Shade, *, speaks: bool) -> None:
    start, end = np.clip(shade.interval, *ax.get_xlim())
    if end > start:
        ax.axvspan(start, end, color="0.5", alpha=0.10, lw=0, zorder=0)
        if speaks:
            # At the foot of the panel, where a curve that rises over the interval is not.
            ax.annotate(shade.what, ((start + end) / 2, 0.0), (0, 4), xycoords=("data", "axes fraction"),
                        textcoords="offset points", ha="center", fontsize=7, color="0.35")  # fmt: skip

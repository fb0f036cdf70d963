"""Time histories of a body and of the energy against the ideal joint (Figs 10 to 18)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spherejax.foundations.errors import SceneError
from spherejax.output.plot.curves import Curves, thinned
from spherejax.output.plot.style import (
    LABELS,
    LAW_COLORS,
    MODEL_COLORS,
    legend_below,
    letter,
    limit_by_bulk,
    new_figure,
    note,
    repeated,
)

QUANTITIES = ("position", "velocity", "acceleration", "energy")
"""What a panel can show, by the titles of panels."""


class _Shown(NamedTuple):
    """How a quantity of several runs is drawn.

    Attributes:
        title: of the panel.
        label: of its vertical axis, with unit.
        factor: to that unit.
        field: of `Curves`.
    """

    title: str
    label: str
    factor: float
    field: str


def _shown(quantity: str, ideal: Curves, curves: Sequence[Curves]) -> _Shown:
    if quantity == "position":
        return _Shown("angle" if ideal.turns else quantity, ideal.position_label, ideal.position_factor, quantity)
    if quantity in ("velocity", "acceleration"):
        title = f"angular {quantity}" if ideal.turns else quantity
        label = ideal.velocity_label if quantity == "velocity" else ideal.acceleration_label
        return _Shown(title, label, 1.0, quantity)
    every = (*curves, ideal)
    largest = max((float(np.nanmax(np.abs(one.energy_balance), initial=0.0)) for one in every), default=0.0)
    unit, factor = ("J", 1.0) if largest >= 1.0 else ("mJ", 1e3)
    is_driven = any(one.supplied is not None for one in every)
    title = "mechanical energy, less what was put in" if is_driven else "mechanical energy"
    return _Shown(title, f"energy change [{unit}]", factor, "energy_balance")


WIDTHS = (2.8, 2.0, 1.4, 0.8)
"""Line widths of up to four curves that coincide, from the back to the front."""


def four_histories(
    curves: Sequence[Curves],
    ideal: Curves,
    title: str,
    *,
    colors: Sequence | None = None,
    horizon: float | None = None,
) -> Figure:
    """Position, its two rates and the energy of several runs in four panels, against the ideal joint.

    Velocities and accelerations are drawn to the bulk of their samples; peaks beyond it are told in the panel.

    Args:
        curves: the runs to compare, as `curves_of` returns them.
        ideal: the same motion with ideal joints, drawn black and dashed above the others.
        title: what is compared, with the values of the parameters.
        colors: one for each run; they begin again where they end. When None those of the joint models, where the runs
            have different ones.
        horizon: time [s] from which a chaotic history is one of many; shaded when given.

    Raises:
        SceneError: for runs that are followed along another axis than the ideal one.
    """
    colors = _colors(curves, ideal, colors)
    figure, axes = new_figure(2, 2, 9.0, 6.4, title)
    for ax, quantity in zip(axes.flat, QUANTITIES, strict=True):
        draw(ax, quantity, curves, ideal, colors)
        mark_horizon(ax, horizon, speaks=quantity == "energy")
    letter(list(axes.flat))
    legend_below(figure, axes[0, 0])
    return figure


def acceleration_and_energy(
    curves: Sequence[Curves],
    ideal: Curves,
    title: str,
    *,
    colors: Sequence | None = None,
    horizon: float | None = None,
    close_up: tuple[float, float] | None = None,
) -> Figure:
    """Acceleration and energy, and a close-up of the acceleration when asked for.

    Args:
        curves: the runs to compare.
        ideal: the same motion with ideal joints.
        title: what is compared, with the values of the parameters.
        colors: one for each run; they begin again where they end. When None those of the joint models, where the runs
            have different ones.
        horizon: time [s] from which a chaotic history is one of many; shaded when given.
        close_up: interval [s] of a third panel.

    Raises:
        SceneError: for runs that are followed along another axis than the ideal one.
    """
    colors = _colors(curves, ideal, colors)
    n_panels = 2 if close_up is None else 3
    figure, axes = new_figure(n_panels, 1, 8.0, 2.9 * n_panels + 0.4, title)
    for ax, quantity in zip(axes[:, 0], ("acceleration", "energy"), strict=False):
        # Chaotic histories do not coincide.
        draw(ax, quantity, curves, ideal, colors, coinciding=horizon is None and len(curves) == len(WIDTHS))
        mark_horizon(ax, horizon, speaks=quantity == "energy")
    if close_up is not None:
        _draw_close_up(axes[2, 0], curves, ideal, colors, close_up)
    letter(list(axes.flat))
    legend_below(figure, axes[0, 0])
    return figure


def _colors(curves: Sequence[Curves], ideal: Curves, colors: Sequence | None) -> Sequence:
    """The colors of the runs, all of which are followed along the same axis."""
    for one in curves:
        if one.axis != ideal.axis:
            raise SceneError(
                f"the curves of {one.label!r} are along {one.axis}, those of {ideal.label!r} along {ideal.axis}: give "
                "curves_of the same axis= for all"
            )
    if colors is not None:
        return colors
    kinds = [one.kind for one in curves]
    return [MODEL_COLORS[kind] for kind in kinds] if _are_models(kinds) else LAW_COLORS


def _are_models(kinds: Sequence[str]) -> bool:
    return len(set(kinds)) == len(kinds) and all(kind in MODEL_COLORS and kind != "ideal" for kind in kinds)


def draw(
    ax: Axes,
    quantity: str,
    curves: Sequence[Curves],
    ideal: Curves,
    colors: Sequence,
    coinciding: bool = False,
) -> None:
    """One quantity of several runs in one panel; those that coincide are told apart by their widths."""
    title, label, factor, field = _shown(quantity, ideal, curves)
    unrest = [-np.nanstd(one.acceleration) for one in curves]
    for place, (one, color) in enumerate(zip(curves, repeated(colors, len(curves)), strict=True)):
        rank = sorted(unrest).index(unrest[place])  # the calmer a curve, the further in front
        width = WIDTHS[rank] if coinciding else 1.0
        x, y = thinned(one.ts, factor * getattr(one, field))
        ax.plot(x, y, color=color, lw=width, alpha=0.9, label=one.label, zorder=2 + rank / 100)
    ax.plot(
        *thinned(ideal.ts, factor * getattr(ideal, field)),
        color="black",
        lw=0.9,
        dashes=(5, 2),
        label=ideal.label,
        zorder=3,
    )
    ax.set_xlabel(LABELS["t"])
    ax.set_ylabel(label)
    ax.set_title(title, loc="left", fontsize=9)
    ax.set_xlim(ideal.ts[0], ideal.ts[-1])
    if quantity in ("velocity", "acceleration"):
        limit_by_bulk(ax, [factor * getattr(one, field) for one in (*curves, ideal)])


def mark_horizon(ax: Axes, horizon: float | None, *, speaks: bool) -> None:
    """Shade the part of a chaotic history that another tolerance would draw differently."""
    if horizon is None or not horizon < ax.get_xlim()[1]:
        return
    ax.axvspan(horizon, ax.get_xlim()[1], color="0.5", alpha=0.10, lw=0, zorder=0)
    if speaks:
        note(ax, f"shaded: chaotic, one history of many (from {horizon:.2f} s)", place=(0.01, 0.02))


def _draw_close_up(ax: Axes, curves: Sequence[Curves], ideal: Curves, colors: Sequence, interval) -> None:
    for one, color in zip((*curves, ideal), (*repeated(colors, len(curves)), "black"), strict=True):
        inside = (one.ts >= interval[0]) & (one.ts <= interval[1])
        style = (0, (5, 2)) if one is ideal else "-"
        ax.plot(*thinned(one.ts[inside], one.acceleration[inside]), color=color, lw=1.1, ls=style)
    ax.set_xlim(*interval)
    ax.set_xlabel(LABELS["t"])
    ax.set_ylabel(ideal.acceleration_label)
    ax.set_title(
        "acceleration where sliding nearly stops (smallest sliding speed in the middle)",
        loc="left",
        fontsize=9,
    )


def slowest_sliding(one: Curves, *, after: float, half_width: float) -> tuple[float, float] | None:
    """The interval around the instant at which ball and socket slide least [s].

    Args:
        one: a run with friction.
        after: look from this time [s] on, when the first impacts are over.
        half_width: half of the interval's length [s].

    Returns:
        Start and end [s]; None without friction or in a run that ends before `after`.
    """
    if one.sliding_speed is None or one.ts[-1] <= after + half_width:
        return None
    touching = np.ones(len(one.ts), bool) if one.clearance is None else one.touching
    candidates = touching & (one.ts > after) & (one.ts < one.ts[-1] - half_width)
    if not candidates.any():
        return None
    middle = float(one.ts[np.argmin(np.where(candidates, one.sliding_speed, np.inf))])
    return middle - half_width, middle + half_width

"""Time histories of a body and of the energy against the ideal joint (Figs 10 to 18)."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spherejax.output.plot.curves import Curves, thinned
from spherejax.output.plot.style import (
    LABELS,
    LAW_COLORS,
    legend_below,
    letter,
    limit_by_bulk,
    new_figure,
    note,
    repeated,
)

QUANTITIES = {
    "z": ("position", 1e3),
    "z_rate": ("velocity", 1.0),
    "z_acceleration": ("acceleration", 1.0),
    "energy": ("energy_change", 1e3),
}
"""What a panel can show: the field of `Curves`, and the factor to the unit of the label."""

TITLES = {
    "z": "position",
    "z_rate": "velocity",
    "z_acceleration": "acceleration",
    "energy": "mechanical energy",
}


WIDTHS = (2.8, 2.0, 1.4, 0.8)
"""Line widths of up to four curves that coincide, from the back to the front."""


def four_histories(
    curves: Sequence[Curves],
    ideal: Curves,
    title: str,
    *,
    colors: Sequence = LAW_COLORS,
    horizon: float | None = None,
) -> Figure:
    """Height, its two rates and the energy of several runs in four panels, against the ideal joint.

    Velocities and accelerations are drawn to the bulk of their samples; peaks beyond it are told in the panel.

    Args:
        curves: the runs to compare, as `curves_of` returns them.
        ideal: the same motion with ideal joints, drawn black and dashed above the others.
        title: what is compared, with the values of the parameters.
        colors: one for each run; they begin again where they end.
        horizon: time [s] from which a chaotic history is one of many; shaded when given.
    """
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
    colors: Sequence = LAW_COLORS,
    horizon: float | None = None,
    close_up: tuple[float, float] | None = None,
) -> Figure:
    """Acceleration and energy, and a close-up of the acceleration when asked for.

    Args:
        curves: the runs to compare.
        ideal: the same motion with ideal joints.
        title: what is compared, with the values of the parameters.
        colors: one for each run; they begin again where they end.
        horizon: time [s] from which a chaotic history is one of many; shaded when given.
        close_up: interval [s] of a third panel.
    """
    n_panels = 2 if close_up is None else 3
    figure, axes = new_figure(n_panels, 1, 8.0, 2.9 * n_panels + 0.4, title)
    for ax, quantity in zip(axes[:, 0], ("z_acceleration", "energy"), strict=False):
        # Chaotic histories do not coincide.
        draw(ax, quantity, curves, ideal, colors, coinciding=horizon is None and len(curves) == len(WIDTHS))
        mark_horizon(ax, horizon, speaks=quantity == "energy")
    if close_up is not None:
        _draw_close_up(axes[2, 0], curves, ideal, colors, close_up)
    letter(list(axes.flat))
    legend_below(figure, axes[0, 0])
    return figure


def draw(
    ax: Axes,
    quantity: str,
    curves: Sequence[Curves],
    ideal: Curves,
    colors: Sequence,
    coinciding: bool = False,
) -> None:
    """One quantity of several runs in one panel; those that coincide are told apart by their widths."""
    field, factor = QUANTITIES[quantity]
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
    ax.set_ylabel(LABELS[quantity] if quantity == "energy" else f"{ideal.body} {LABELS[quantity]}".strip())
    ax.set_title(TITLES[quantity], loc="left", fontsize=9)
    ax.set_xlim(ideal.ts[0], ideal.ts[-1])
    if quantity in ("z_rate", "z_acceleration"):
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
    ax.set_ylabel(f"{ideal.body} {LABELS['z_acceleration']}".strip())
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
    touching = one.distance >= (one.clearance or 0.0)
    candidates = touching & (one.ts > after) & (one.ts < one.ts[-1] - half_width)
    if not candidates.any():
        return None
    middle = float(one.ts[np.argmin(np.where(candidates, one.sliding_speed, np.inf))])
    return middle - half_width, middle + half_width

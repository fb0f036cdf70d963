"""Where the energy of a run comes from and goes, part by part, over time."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spherejax.motion.results.energy_parts import EnergyByPart
from spherejax.output.plot.curves import thinned
from spherejax.output.plot.space import BODY_COLORS
from spherejax.output.plot.style import LABELS, legend_under, letter, new_figure, note, repeated

MOST_PARTS = 8
"""Curves in a panel, those of the largest energies; the panel says how many are left out."""


def energy_by_part(balance: EnergyByPart, title: str = "Energy since the start, by part") -> Figure:
    """Draw what was put in, what is stored, and what was lost, each part with a curve of its own.

    Args:
        balance: `run.energy_by_part`.
        title: of the figure.

    Returns:
        A figure with a panel for each of the three, without those that have no part.
    """
    kinds = {"put in": balance.put_in, "stored": balance.stored, "lost": balance.lost}
    kinds = {kind: parts for kind, parts in kinds.items() if parts}
    largest = max(float(np.abs(values).max()) for parts in kinds.values() for values in parts.values())
    unit, factor = energy_unit(largest)
    figure, axes = new_figure(1, len(kinds), 3.7 * len(kinds), 3.6, title)
    names = list(dict.fromkeys(name for parts in kinds.values() for name in parts))
    colors = dict(zip(names, repeated(BODY_COLORS, len(names)), strict=True))  # a part has one color in all panels
    for ax, (kind, parts) in zip(axes.flat, kinds.items(), strict=True):
        scaled = {name: factor * values for name, values in parts.items()}
        _panel(ax, balance.ts, scaled, colors, f"{kind} [{unit}]")
    letter(list(axes.flat))
    return figure


def energy_unit(largest: float) -> tuple[str, float]:
    """The unit for energies up to some size [J], and its factor: J from 1 J on, mJ, or uJ below 1 mJ."""
    if largest >= 1.0 or largest == 0.0:
        return "J", 1.0
    return ("mJ", 1e3) if largest >= 1e-3 else ("uJ", 1e6)


def _panel(ax: Axes, ts: np.ndarray, parts: dict[str, np.ndarray], colors: dict[str, str], label: str) -> None:
    shown = sorted(parts, key=lambda name: -float(np.abs(parts[name]).max()))[:MOST_PARTS]
    for name in shown:
        ax.plot(*thinned(ts, parts[name]), color=colors[name], lw=1.1, label=name)
    ax.axhline(0.0, color="0.8", lw=0.7, zorder=0)
    ax.set(xlabel=LABELS["t"], ylabel=label, xlim=(ts[0], ts[-1]))
    if len(parts) > MOST_PARTS:
        note(ax, f"the largest {MOST_PARTS} of {len(parts)}", place=(0.99, 0.98))
    legend_under(ax)

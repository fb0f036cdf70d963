"""Cycles: one of them with its multipliers, a branch of them along a number, and answers to a swept sine."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from spherejax.foundations.errors import SceneError
from spherejax.motion.equations.quantities import quantity
from spherejax.output.plot.style import LAW_COLORS, legend_below, letter, new_figure, ordered_colors, repeated

MOST = 4
"""Quantities in one figure of a cycle."""

ROUNDING = 1e-9
"""Share of a swing below which its middle is said to be zero."""

EVENT_MARKS = {"fold": "o", "period doubling": "s", "Neimark-Sacker": "D", "branch point": "^"}


def cycle(found: Any, names: Sequence[str] = (), title: str = "") -> Figure:
    """Quantities over a period, and the Floquet multipliers in the unit circle.

    Args:
        found: what `sj.steady_cycle` returns.
        names: quantities, one component each; the heights of the bodies without.
        title: what is shown; period and stability by default.

    Raises:
        SceneError: for something that is no cycle, or a quantity that is a vector.
    """
    if not hasattr(found, "multipliers") or not hasattr(found, "run"):
        raise SceneError(f"cycle: {type(found).__name__} is no cycle; give what sj.steady_cycle returns")
    system = found.run.system
    names = list(names) or [f"position.{body}.z" for body in system.bodies][:MOST]
    asked = [quantity(name, system) for name in names]
    vector = next((each.name for each in asked if each.dims), None)
    if vector is not None or len(names) > MOST:
        raise SceneError(
            f"cycle draws up to {MOST} quantities, one component each" + (f"; {vector!r} is a vector" if vector else "")
        )
    figure, axes = new_figure(1, 2, 8.4, 3.6, title or _said(found))
    left, right = axes[0]
    share = np.linspace(0.0, 1.0, len(found.run.ts))
    for each, color in zip(asked, repeated(LAW_COLORS, len(asked)), strict=True):
        values = np.asarray(each.of(found.run))
        middle, size = (values.max() + values.min()) / 2, (values.max() - values.min()) / 2
        middle = 0.0 if abs(middle) < ROUNDING * size else middle
        unit = each.unit if each.unit not in ("", "1") else ""
        said = f"{each.name}: {middle:.4g} $\\pm$ {size:.3g} {unit}".rstrip()
        left.plot(share, (values - middle) / (size or 1.0), color=color, lw=1.4, label=said)
    left.set_xlabel(f"time [periods of {found.period:.4g} s]")
    left.set_ylabel("departure from the middle, over the largest")
    left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), fontsize=8, frameon=False)
    _unit_circle(right, found.multipliers)
    letter([left, right])
    return figure


def _said(found: Any) -> str:
    if not found.succeeded:
        return "No cycle"
    return f"Cycle of {found.period:.6g} s, {found.multipliers.words.partition(':')[0]}"


def _unit_circle(ax: Axes, multipliers: Any) -> None:
    angle = np.linspace(0.0, 2 * np.pi, 200)
    ax.plot(np.cos(angle), np.sin(angle), color="0.6", lw=1.0)
    mu, free = multipliers.values, multipliers.is_free
    grows = np.abs(mu) > 1 + multipliers.margin
    for chosen, color, mark, said in (
        (~grows & ~free, LAW_COLORS[0], "o", "dies away"),
        (grows & ~free, LAW_COLORS[1], "X", "grows"),
        (free, "0.3", "+", "a shift in time"),
    ):
        if np.any(chosen):
            ax.plot(mu[chosen].real, mu[chosen].imag, mark, color=color, ms=7, ls="none", label=said)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("multipliers, real part")
    ax.set_ylabel("imaginary part")
    if len(mu):
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3, fontsize=8, frameon=False)


def continuation(branch: Any, name: str | None = None, title: str = "") -> Figure:
    """A branch of cycles over its number: lines where it is stable, dashes where not, marks where that changes.

    Args:
        branch: what `sj.studies.continuation` returns.
        name: one of its outputs, whose first harmonic and extremes are drawn; the period, and the largest multiplier,
            without.
        title: what is shown.

    Raises:
        SceneError: for something that is no branch, has no points, or did not keep the quantity.
    """
    if not hasattr(branch, "events") or not hasattr(branch, "points"):
        raise SceneError(
            f"continuation: {type(branch).__name__} is no branch; give what sj.studies.continuation returns"
        )
    if not branch.points:
        raise SceneError(f"continuation: the branch has no cycles to draw: {branch.diagnosis}")
    if name is None and branch.outputs:
        name = branch.outputs[0]
    if name is not None and name not in branch.outputs:
        kept = ", ".join(map(repr, branch.outputs)) or "none"
        raise SceneError(f"continuation: the branch did not keep {name!r}; it has outputs= {kept}")
    table = branch.to_xarray()
    values = branch.values
    figure, axes = new_figure(1, 2, 8.6, 3.6, title or f"Cycles along {branch.number}")
    left, right = axes[0]
    if name is None:
        drawn, words = np.asarray(table["period"]), "period [s]"
    else:
        unit = table[f"{name}.amplitude"].attrs.get("units", "")
        drawn, words = (
            np.asarray(table[f"{name}.amplitude"]),
            f"{name}, first harmonic" + (f" [{unit}]" if unit else ""),
        )
    multiplier = np.asarray(table["largest_multiplier"])
    for ax, heights in ((left, drawn), (right, multiplier)):
        at = [
            event.point.multipliers.largest if ax is right else _between(branch, event, values, heights)
            for event in branch.events
        ]
        _branch(ax, branch, heights, at)
        for event, height in zip(branch.events, at, strict=True):
            ax.plot(event.value, height, EVENT_MARKS[event.kind], color="black", mfc="white", ms=6, zorder=5)
        ax.set_xlabel(branch.number)
    left.set_ylabel(words)
    right.axhline(1.0, color="0.6", lw=0.8)
    right.set_ylabel("largest multiplier, modulus")
    kinds = list(dict.fromkeys(event.kind for event in branch.events))
    handles = [Line2D([], [], color=LAW_COLORS[0], lw=1.6, label="stable")]
    if not branch.is_stable.all():
        handles.append(Line2D([], [], color=LAW_COLORS[1], lw=1.6, ls=(0, (4, 2)), label="unstable"))
    handles += [Line2D([], [], color="black", mfc="white", marker=EVENT_MARKS[k], ls="none", label=k) for k in kinds]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8, frameon=False)
    letter([left, right])
    return figure


def _branch(ax: Axes, branch: Any, heights: np.ndarray, at_events: Sequence[float]) -> None:
    """Runs of cycles that are alike, from event to event: where one is located the look changes there."""
    events, stable = branch.events, branch.is_stable
    places = np.concatenate([np.arange(len(stable)), [event.before - 0.5 for event in events]])
    order = np.argsort(places, kind="stable")
    values = np.concatenate([branch.values, [event.value for event in events]])[order]
    heights = np.concatenate([heights, at_events])[order]
    # Of the line from each vertex to the next: that of a cycle is the cycle's, and behind an event what it becomes.
    looks = np.concatenate([stable, [event.becomes_stable for event in events]]).astype(int)[order]
    borders = [0, *(np.flatnonzero(np.diff(looks)) + 1).tolist(), len(values)]
    for first, last in pairwise(borders):
        part = slice(first, min(last + 1, len(values)))
        look: dict[str, Any] = {"color": LAW_COLORS[0]} if looks[first] else {"color": LAW_COLORS[1], "ls": (0, (4, 2))}
        ax.plot(values[part], heights[part], lw=1.6, **look)


def _between(branch: Any, event: Any, values: np.ndarray, heights: np.ndarray) -> float:
    """The height of an event: by its place between the points, along the branch."""
    k = min(max(event.before, 1), len(values) - 1)
    shots = [branch.points[i].shot for i in (k - 1, k)]
    parts = [float(np.linalg.norm(one.seen(branch.family, event.point.shot.place.y))) for one in shots]
    share = parts[0] / (sum(parts) or 1.0)
    return float(heights[k - 1] + share * (heights[k] - heights[k - 1]))


def swept_sine(found: Any, output: str | None = None, title: str = "") -> Figure:
    """Magnitude, phase and distortion over frequency: points of the mechanism itself, a line of its linear neighbor.

    Args:
        found: what `sj.studies.swept_sine` returns.
        output: one of its outputs; the first when None.
        title: what is shown.

    Raises:
        SceneError: for something else, or an output that it does not have.
    """
    if not hasattr(found, "distortion") or not hasattr(found, "linear"):
        raise SceneError(
            f"swept_sine: {type(found).__name__} is no swept sine; give what sj.studies.swept_sine returns"
        )
    output = found.outputs[0] if output is None else output
    if output not in found.outputs:
        raise SceneError(f"swept_sine: there is no output {output!r}; there are {', '.join(map(repr, found.outputs))}")
    i = found.outputs.index(output)
    figure, axes = new_figure(3, 1, 7.0, 6.8, title or f"{output} by {found.input}")
    upper, middle, lower = axes[:, 0]
    f = found.frequencies
    fine = np.geomspace(f.min(), f.max(), 400) if len(f) > 1 else f
    linear = np.asarray(found.linear.frequency_response(fine))[:, i, 0]
    upper.plot(fine, np.abs(linear), color="0.35", lw=1.2, label="linear")
    middle.plot(fine, np.degrees(np.unwrap(np.angle(linear))), color="0.35", lw=1.2)
    reference = np.unwrap(np.angle(linear))
    for k, (amplitude, color) in enumerate(zip(found.amplitudes, ordered_colors(len(found.amplitudes)), strict=True)):
        values = found.response[k, :, i]
        for chosen, look in ((found.is_stable[k], {"mfc": color}), (~found.is_stable[k], {"mfc": "white"})):
            said = f"amplitude {amplitude:.4g}" if look["mfc"] is color else None
            style = {"color": color, "ls": "none", "marker": "o", "ms": 4, **look}
            upper.plot(f[chosen], np.abs(values[chosen]), label=said, **style)
            phase = np.angle(values[chosen])
            near = np.interp(f[chosen], fine, reference)
            phase = phase + 2 * np.pi * np.round((near - phase) / (2 * np.pi))
            middle.plot(f[chosen], np.degrees(phase), **style)
            lower.plot(f[chosen], 100 * found.distortion[k, chosen, i], **style)
    for ax in (upper, middle, lower):
        if len(f) > 1 and f.max() > 3 * f.min():
            ax.set_xscale("log")
            ax.xaxis.set_major_formatter("{x:g}")
    upper.set_yscale("log")
    unit = found.output_units[i]
    upper.set_ylabel(f"magnitude [{unit or 'SI'} per unit]")
    middle.set_ylabel("phase [deg]")
    lower.set_ylabel("distortion [%]")
    lower.set_xlabel("frequency [Hz]")
    letter([upper, middle, lower])
    legend_below(figure, upper)
    return figure

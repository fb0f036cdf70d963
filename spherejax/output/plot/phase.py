"""Phase portraits of a body's motion along one axis (Fig. 19)."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from spherejax.output.plot.curves import Curves
from spherejax.output.plot.style import letter, limit_by_bulk, model_colors, new_figure


def phase_portraits(models: Mapping[str, Curves], title: str, *, every: int = 1) -> Figure:
    """Position against velocity, and velocity against acceleration; a row for each joint model.

    Args:
        models: what `curves_of` returns, by model name (`"ideal"`, `"dry"`, ...), drawn from top to bottom on common
            axes.
        title: what is shown, with the values of the parameters.
        every: every how many samples the path has a point; an impact is a loop of some ten of them.

    The ideal motion lies behind every portrait in grey, so that each one can be judged by itself.
    """
    figure, axes = new_figure(len(models), 2, 8.2, 2.3 * len(models) + 0.5, title)
    ideal = next((one for name, one in models.items() if "ideal" in (name, one.kind)), None)
    colors, first = model_colors({name: one.kind for name, one in models.items()}), next(iter(models.values()))
    for (left, right), (name, one) in zip(axes, models.items(), strict=True):
        for curves, style in ((ideal, {"color": "0.65", "lw": 2.0}), (one, {"color": colors[name], "lw": 0.7})):
            if curves is None or (curves is one and curves is ideal and style["lw"] > 1):
                continue
            left.plot(first.position_factor * curves.position[::every], curves.velocity[::every], **style)
            right.plot(curves.velocity[::every], curves.acceleration[::every], **style)
        left.set_ylabel("angular velocity [rad/s]" if first.turns else "velocity [m/s]")
        right.set_ylabel("angular acceleration [rad/s$^2$]" if first.turns else "acceleration [m/s$^2$]")
        right.xaxis.set_major_locator(MaxNLocator(5))
        left.set_title(one.label, loc="left", fontsize=9)
        right.set_title(one.label, loc="left", fontsize=9)
    axes[-1, 0].set_xlabel(first.position_label)
    axes[-1, 1].set_xlabel(first.velocity_label)
    _share_limits(axes, models)
    letter(list(axes.flat))
    return figure


def _share_limits(axes: np.ndarray, models: Mapping[str, Curves]) -> None:
    """Common limits of positions and velocities; accelerations each by their bulk."""
    positions = [one.position_factor * one.position for one in models.values()]
    velocities = [one.velocity for one in models.values()]
    for left, right in axes:
        _set_range(left.set_xlim, positions)
        _set_range(left.set_ylim, velocities)
        _set_range(right.set_xlim, velocities)
    for (_, right), one in zip(axes, models.values(), strict=True):
        limit_by_bulk(right, [one.acceleration], keep=97.0)


def _set_range(setter, values: list[np.ndarray]) -> None:
    low, high = min(np.nanmin(v) for v in values), max(np.nanmax(v) for v in values)
    margin = 0.05 * max(high - low, 1e-9 * abs(low), 1e-12)  # of a body at rest, more than rounding
    setter(low - margin, high + margin)

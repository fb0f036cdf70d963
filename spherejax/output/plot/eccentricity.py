"""The path of the ball's center inside the clearance, joint by joint (Fig. 20).

The path is spatial: in world axes no plane holds more than nine tenths of it. Each circle shows the plane in
which the rocker swings, x-z, because it is the same for all models and holds gravity and most of the
reaction. The angle is that of the projection, but the distance from the middle is the true |e|: a projected
distance would draw contact beside the plane as if the ball were in flight, whereas here contact is on the
circle, and only there.
"""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from spherejax.output.plot.curves import Curves, thinned
from spherejax.output.plot.style import LABELS, MODEL_COLORS, letter, new_figure

_CONTACT = "#D55E00"
_FLIGHT = "#56B4E9"


def eccentricity_paths(models: Mapping[str, Curves], title: str, *, every: int = 20) -> Figure:
    """For each joint model the path inside the clearance circle, and below it the distance over time.

    Args:
        models: by model name; the ideal one is left out.
        title: what is shown, with the values of the parameters.
        every: samples of the path to skip; contact points are drawn wherever they are among the rest.
    """
    shown = {name: one for name, one in models.items() if name != "ideal"}
    figure, axes = new_figure(2, len(shown), 3.1 * len(shown), 5.9, title)
    for (upper, lower), (name, one) in zip(axes.T, shown.items(), strict=True):
        unit, scale = (1e6, "µm") if one.clearance is None else (1e3, "mm")
        _draw_path(upper, one, unit, scale, every)
        lower.plot(*thinned(one.ts, unit * one.distance), color=MODEL_COLORS.get(name, "0.3"), lw=0.9)
        if one.clearance is not None:
            lower.axhline(unit * one.clearance, color="black", lw=1.0)
            lower.set_ylim(0, 1.12 * unit * one.clearance)
        else:
            lower.set_ylim(bottom=0)
        lower.set_xlim(one.ts[0], one.ts[-1])
        lower.set_xlabel(LABELS["t"])
        lower.set_ylabel(f"|e| [{scale}]")
    letter(list(axes.flat))
    return figure


def _draw_path(ax: Axes, one: Curves, unit: float, scale: str, every: int) -> None:
    e = unit * one.eccentricity
    distance = unit * one.distance
    in_plane = np.hypot(e[:, 0], e[:, 2])
    stretch = distance / np.where(in_plane > 0, in_plane, 1.0)
    x, z = stretch * e[:, 0], stretch * e[:, 2]
    touching = np.zeros(len(e), bool) if one.clearance is None else one.distance >= one.clearance
    if touching.any():
        ax.plot(x[::every], z[::every], color=_FLIGHT, lw=0.4, zorder=2)
        chosen = np.flatnonzero(touching)
        chosen = chosen[:: max(1, len(chosen) // 6000)]
        ax.scatter(x[chosen], z[chosen], s=6, color=_CONTACT, lw=0, zorder=4)
        remark = f"in contact {100 * touching.mean():.3g} % of the time"
    else:
        ax.plot(x[::every], z[::every], color=_FLIGHT, lw=0.7, zorder=2)
        remark = "never in contact" if one.clearance is not None else "circle: largest |e|"
    ax.set_title(f"{one.label}\n{remark}", loc="left", fontsize=9)
    radius = np.nanmax(distance) if one.clearance is None else unit * one.clearance
    style = {"ls": "--", "color": "0.4"} if one.clearance is None else {"ls": "-", "color": "black"}
    ax.add_patch(Circle((0.0, 0.0), radius, fill=False, lw=1.0, zorder=3, **style))
    reach = 1.22 * max(radius, 1e-12)
    ax.set_xlim(-reach, reach)
    ax.set_ylim(-reach, reach)
    ax.set_aspect("equal")
    ax.set_xlabel(f"along x [{scale}]")
    ax.set_ylabel(f"along z [{scale}]")

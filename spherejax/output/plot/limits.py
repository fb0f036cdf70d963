"""How every model tends to the ideal joint: a small gap, a stiff bushing, a viscous film."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from spherejax.output.plot.style import LAW_COLORS, MODEL_COLORS, letter, new_figure, typeset_number


@dataclass(frozen=True)
class LimitCurve:
    """The deviation from the ideal motion against one parameter.

    Attributes:
        label: the joint model, with the parameters that stay.
        parameter: name and unit of the parameter, for the axis.
        values: its values.
        deviations: largest deviation of the body's position from the ideal motion [m, rad]; NaN for a run that failed.
        order: expected power of the parameter, for a line to compare with; None without an expectation.
        kind: short name of the joint model, which has a color of its own; empty without one.
    """

    label: str
    parameter: str
    values: Sequence[float]
    deviations: Sequence[float]
    order: int | None = None
    kind: str = ""


def limits_to_ideal(
    limits: Sequence[LimitCurve], title: str, *, what: str = "position [mm]", factor: float = 1e3
) -> Figure:
    """A panel for each parameter, with logarithmic axes; limits of the same parameter share a panel.

    Args:
        limits: what to draw.
        title: what is shown, with the length of the motion.
        what: whose deviation it is, with the unit.
        factor: from the deviations to that unit.
    """
    parameters = list(dict.fromkeys(limit.parameter for limit in limits))
    figure, axes = new_figure(1, len(parameters), 3.3 * len(parameters) + 0.3, 4.6, title)
    for ax, parameter in zip(axes.flat, parameters, strict=True):
        own = [one for one in limits if one.parameter == parameter]
        kinds = [one.kind for one in own]
        for i, limit in enumerate(own):
            is_second = limit.kind in kinds[:i] and bool(limit.kind)
            ax.plot(
                limit.values,
                factor * np.asarray(limit.deviations),
                "o--" if is_second else "o-",
                color=MODEL_COLORS.get(limit.kind, LAW_COLORS[i % len(LAW_COLORS)]),
                ms=4,
                lw=1.2,
                label=limit.label,
            )
            if limit.order is not None:
                _draw_slope(ax, limit, factor)
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.xaxis.set_major_locator(
            FixedLocator(sorted({v for one in limits if one.parameter == parameter for v in one.values}))
        )
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: typeset_number(value)))
        ax.xaxis.set_minor_locator(NullLocator())
        ax.set_xlabel(parameter)
        ax.set_title(parameter.split(" [")[0], loc="left", fontsize=9)
        ax.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False)
    name, _, unit = what.rpartition(" ")
    axes[0, 0].set_ylabel(f"largest deviation of {name} from ideal {unit}")
    letter(list(axes.flat))
    return figure


def _draw_slope(ax: Axes, limit: LimitCurve, factor: float) -> None:
    values = np.asarray(limit.values, float)
    middle = len(values) // 2
    line = factor * limit.deviations[middle] * (values / values[middle]) ** limit.order
    ax.plot(values, line, ":", color="0.4", lw=1.0, label=f"power {limit.order:+d}")

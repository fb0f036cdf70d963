"""Dynamic stiffness and loss angle over frequency."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spherejax.foundations.errors import SceneError
from spherejax.output.plot.style import (
    LAW_COLORS,
    LAW_DASHES,
    legend_below,
    letter,
    new_figure,
    ordered_colors,
    repeated,
    typeset_number,
)

if TYPE_CHECKING:
    import xarray


def dynamic_stiffness(tables: "Mapping[str, xarray.Dataset]", title: str = "Dynamic stiffness") -> Figure:
    """Dynamic stiffness and loss angle over frequency: a colour for each model, a dash for each amplitude.

    Args:
        tables: `sj.studies.dynamic_stiffness(...).to_xarray()`, by what the legend says.
        title: what is shown.

    Raises:
        SceneError: without a table, or for one of a rotation beside one of a deflection.
    """
    if not tables:
        raise SceneError("dynamic_stiffness: there is no table to draw; give {'rubber': table.to_xarray()}")
    units = {str(table["stiffness"].attrs["units"]) for table in tables.values()}
    if len(units) > 1:
        raise SceneError(f"dynamic_stiffness: stiffnesses in {' and '.join(sorted(units))} have no axis in common")
    figure, left, right = _panels(title, units.pop())
    several = len(tables) > 1
    for i, (name, table) in enumerate(tables.items()):
        n = table.sizes["amplitude"]
        colors = n * [LAW_COLORS[i % len(LAW_COLORS)]] if several else ordered_colors(n)
        dashes = repeated(LAW_DASHES, n)
        for j, (color, dash) in enumerate(zip(colors, dashes, strict=True)):
            look = {"color": color, "ls": dash, "lw": 1.5, "label": _label(name, table, j)}
            _curve(left, right, table, j, **look)
    legend_below(figure, left)
    return figure


def fitted_stiffness(curves: "xarray.Dataset", measured: np.ndarray, title: str) -> Figure:
    """Measurements as dots and a fit as curves, a colour for each amplitude.

    Args:
        curves: of the fit, over frequency and the measured amplitudes.
        measured: rows of frequency [Hz], amplitude, stiffness and loss angle [rad].
        title: what is shown.
    """
    figure, left, right = _panels(title, str(curves["stiffness"].attrs["units"]))
    amplitudes = np.asarray(curves["amplitude"])
    for j, color in enumerate(ordered_colors(len(amplitudes))):
        _curve(left, right, curves, j, color=color, lw=1.2, label=_label("", curves, j))
        rows = measured[measured[:, 1] == amplitudes[j]]
        dots = {"color": color, "ls": "none", "marker": "o", "ms": 3.5, "mfc": "white"}
        left.plot(rows[:, 0], rows[:, 2], **dots)
        right.plot(rows[:, 0], np.degrees(rows[:, 3]), **dots)
    legend_below(figure, left)
    return figure


def _panels(title: str, unit: str) -> tuple[Figure, Axes, Axes]:
    figure, axes = new_figure(1, 2, 8.6, 3.6, title)
    left, right = axes[0]
    left.set_ylabel(f"dynamic stiffness [{unit}]")
    right.set_ylabel("loss angle [deg]")
    for ax in (left, right):
        ax.set_xscale("log")
        ax.set_xlabel("frequency [Hz]")
        ax.xaxis.set_major_formatter("{x:g}")
    left.set_yscale("log")
    left.tick_params(which="both", labelsize=8)
    letter([left, right])
    return figure, left, right


def _curve(left: Axes, right: Axes, table: "xarray.Dataset", j: int, **look) -> None:
    frequency = np.asarray(table["frequency"])
    left.plot(frequency, np.asarray(table["stiffness"])[:, j], **look)
    right.plot(frequency, np.degrees(np.asarray(table["loss_angle"])[:, j]), **look)


def _label(name: str, table: "xarray.Dataset", j: int) -> str:
    amplitude, unit = float(table["amplitude"][j]), str(table["amplitude"].attrs["units"])
    size = f"{1e3 * amplitude:g} mm" if unit == "m" else f"{typeset_number(amplitude)} {unit}"
    return f"{name}, {size}" if name else size

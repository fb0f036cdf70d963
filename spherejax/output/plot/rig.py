"""Curves of a suspension on the rig: a panel for each characteristic, a color for each rig."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spherejax.foundations.errors import SceneError, one_of
from spherejax.output.plot.style import LAW_COLORS, LAW_DASHES, legend_below, letter, new_figure, repeated

if TYPE_CHECKING:
    import xarray

UNITS = {
    "rad": ("deg", 180.0 / np.pi),
    "m": ("mm", 1e3),
    "N": ("kN", 1e-3),
    "N/m": ("N/mm", 1e-3),
    "rad/m": ("deg/m", 180.0 / np.pi),
    "1": ("-", 1.0),
}
"""What is shown in place of SI units, and the factor."""

PANELS = (
    "toe",
    "camber",
    "caster",
    "kingpin_inclination",
    "track_change",
    "roll_center_height",
    "recession",
    "wheel_load",
    "wheel_rate",
)
"""Characteristics that are shown unless asked otherwise."""

STANDS_STILL = 1e-9
"""Range of a curve [shown unit] below which its axis would show rounding."""


def rig(
    rigs: "Mapping[str, xarray.Dataset] | xarray.Dataset",
    show: Sequence[str] = PANELS,
    title: str = "Suspension rig",
) -> Figure:
    """Characteristics over travel or steer, each in a panel, in degrees and millimeters.

        sj.plot.rig({"ideal": ideal.to_xarray(), "rubber": rubber.to_xarray()}, ["toe", "camber"])

    Args:
        rigs: what `sj.vehicle.rig(...).to_xarray()` gives, or several by what the legend says.
        show: names of characteristics; those that no rig has are left out.
        title: what is shown.

    Raises:
        SceneError: for what is no rig, or an unknown characteristic.
    """
    given: Any = rigs
    named: Mapping[str, Any] = given if isinstance(given, Mapping) and "toe" not in given else {"": given}
    if not named or not all("toe" in getattr(one, "data_vars", ()) for one in named.values()):
        raise SceneError('sj.plot.rig draws what sj.vehicle.rig(...).to_xarray() gives, or several: {"rubber": ...}')
    first = next(iter(named.values()))
    known = {str(name) for one in named.values() for name in one.data_vars if one[name].ndim == 1} - {"status"}
    wrong = next((name for name in show if name not in known | set(PANELS)), None)
    if wrong is not None:
        raise SceneError(f"sj.plot.rig: there is no characteristic {wrong!r}; {one_of(sorted(known), wrong)}")
    names = [name for name in show if name in known]
    n_columns = min(3, len(names))
    n_rows = -(-len(names) // n_columns)
    figure, axes = new_figure(n_rows, n_columns, 3.6 * n_columns + 0.4, 2.5 * n_rows + 0.9, title)
    panels = list(axes.ravel())
    for ax in panels[len(names) :]:
        ax.remove()
    colors, dashes = repeated(LAW_COLORS, len(named)), repeated(LAW_DASHES, len(named))
    for ax, name in zip(panels, names, strict=False):
        unit, factor = UNITS.get(first[name].attrs["units"], (first[name].attrs["units"], 1.0))
        for (label, one), color, dash in zip(named.items(), colors, dashes, strict=True):
            if name in one:
                across, _ = _abscissa(one)
                ax.plot(across, factor * np.asarray(one[name]), color=color, ls=dash, lw=1.4, label=label)
        ax.set_title(str(first[name].attrs["long_name"]), fontsize=9)
        ax.set_ylabel(f"[{unit}]")
        ax.set_xlabel(_abscissa(first)[1])
        _widen(ax)
    letter(panels[: len(names)])
    if len(named) > 1:
        legend_below(figure, panels[0])
    return figure


def _abscissa(one: Any) -> tuple[np.ndarray, str]:
    """What the curves are over, and its label."""
    dim = str(one["toe"].dims[0])
    if dim == "position":
        return np.arange(one.sizes[dim]), "position"
    return 1e3 * np.asarray(one[dim]), f"{dim} [mm]"


def _widen(ax: Axes) -> None:
    low, high = ax.get_ylim()
    if high - low < STANDS_STILL:
        middle = 0.5 * (low + high)
        ax.set_ylim(middle - 0.5, middle + 0.5)

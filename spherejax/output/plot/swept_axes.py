"""What the figures of sweeps share: axes with names and units, logarithms where they fit, marks of failed runs."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.transforms import blended_transform_factory

if TYPE_CHECKING:
    import xarray

FAILED = {"marker": "x", "color": "#D62728", "ls": "", "ms": 4.5, "mew": 1.1, "zorder": 5}
"""How a run that did not reach its end is marked."""


def parameters_of(swept: "xarray.Dataset") -> list[str]:
    """Names of what was swept."""
    if "run" in swept["status"].dims:
        return [str(name) for name in swept.coords if swept[name].dims == ("run",) and name != "run"]
    return [str(dim) for dim in swept["status"].dims]


def wide_parameters(swept: "xarray.Dataset") -> list[str]:
    """Those that have more than one value."""
    return [name for name in parameters_of(swept) if len(np.unique(swept[name])) > 1]


def has_failed(swept: "xarray.Dataset") -> "xarray.DataArray":
    """Which runs did not reach their end; those that have not been made yet are none of them."""
    return swept["status"] > 0


def at_the_bottom(ax: Axes, places) -> None:
    """Marks of failed runs along the lower edge of a panel, where their values would be."""
    if len(places):
        across = blended_transform_factory(ax.transData, ax.transAxes)
        ax.plot(places, np.full(len(places), 0.025), transform=across, clip_on=False, label="failed", **FAILED)


def label(ax: Axes, across: str, up: str) -> None:
    """Names of the axes; small numbers get one power of ten at the end of the axis, not a row of zeros each."""
    ax.set_xlabel(across)
    ax.set_ylabel(up)
    ax.locator_params(axis="x", nbins=6)
    ax.ticklabel_format(style="sci", scilimits=(-3, 4), useMathText=True)


def with_unit(name: str, values: Any) -> str:
    """A name in words, with its unit where it has one."""
    unit = values.attrs.get("units", "")
    words = name.replace("_", " ").replace(".", ", ")
    return f"{words} [{unit}]" if unit not in ("", "1") else words


def is_even_in_ratio(values: np.ndarray) -> bool:
    """Whether values span more than a decade and their ratios are alike."""
    values = np.unique(values)
    if len(values) < 3 or not np.all(values > 0) or values.max() < 10 * values.min():
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(np.ptp(ratios) / abs(ratios.mean()) < np.ptp(steps) / abs(steps.mean()))


def logarithmic_where_even(ax: Axes, values: Any, axis: str) -> None:
    """A logarithmic axis where the values ask for it."""
    if is_even_in_ratio(np.asarray(values)):
        (ax.set_xscale if axis == "x" else ax.set_yscale)("log")

"""What the figures of sweeps share: axes with names and units, logarithms where they fit, marks of failed runs."""

from typing import TYPE_CHECKING, Any, Literal

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


FENCE, FLATTENED = 5.0, 3.0
"""A value is an outlier beyond five interquartile ranges from the quartiles, where it makes the range of the colors
three times as wide as the others need."""

MOST_LISTED = 3
"""How many outliers are listed below a map, with the parameters of their runs."""


def outliers(values: np.ndarray) -> np.ndarray:
    """Which values would leave no color to the others: far beyond the quartiles of all; none of a steady slope."""
    finite = values[np.isfinite(values)]
    none = np.zeros(values.shape, bool)
    if finite.size < 5:
        return none
    first, third = np.quantile(finite, [0.25, 0.75])
    reach = FENCE * (third - first)
    far = (values < first - reach) | (values > third + reach)
    if reach == 0 or not far.any():
        return none
    rest = values[np.isfinite(values) & ~far]
    return far if np.ptp(finite) > FLATTENED * np.ptp(rest) else none


def beyond(values: np.ndarray, low: float | None, high: float | None) -> Literal["neither", "both", "min", "max"]:
    """At which ends of a range of colors there are values beyond it."""
    below = low is not None and bool(np.nanmin(values) < low)
    above = high is not None and bool(np.nanmax(values) > high)
    return "both" if below and above else "min" if below else "max" if above else "neither"


def list_of_outliers(
    values: np.ndarray, far: np.ndarray, rows: tuple[str, np.ndarray], columns: tuple[str, np.ndarray]
) -> str:
    """A text that lists the runs whose values are beyond the colors, the farthest first; empty without such runs.

    Args:
        values: shape (rows, columns).
        far: which are outliers.
        rows: name and values of the parameter along the rows.
        columns: the same along the columns.
    """
    places = np.argwhere(far)
    middle = float(np.nanmedian(values))
    places = sorted(places, key=lambda place: -abs(values[tuple(place)] - middle))
    lines = [
        f"{values[i, j]:.3g} at {rows[0]} = {rows[1][i]:.4g}, {columns[0]} = {columns[1][j]:.4g}"
        for i, j in places[:MOST_LISTED]
    ]
    more = [f"and {len(places) - MOST_LISTED} more"] if len(places) > MOST_LISTED else []
    return "\n".join(["beyond the colors:", *lines, *more]) if lines else ""

"""The numbers that runs of a sweep keep, run by run, and which of the runs can be used."""

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from spherejax.foundations.errors import SceneError
from spherejax.motion.integration.status import Status
from spherejax.studies.sweep.records import TAKEN
from spherejax.studies.sweep.spreads import Scattered, Spread, scattered

if TYPE_CHECKING:
    import xarray


SHOWN = 12
"""Entries of one output in tables that are printed."""

STANDS_STILL = 1e-9
"""Deviation of an entry, as a share of the largest of its output, below which it is rounding."""


class UncertaintyWarning(UserWarning):
    """Runs that failed are left out of a statistic, or it rests on an assumption that does not hold."""


class Output(NamedTuple):
    """What a sweep keeps of each run, under one name.

    Attributes:
        name: its name.
        unit: its unit; empty where it is not known.
        values: shape (n_runs, ...).
        dims: names of the dimensions behind the first.
        labels: of its entries, in the order of the flattened array.
    """

    name: str
    unit: str
    values: Float[np.ndarray, "n_runs ..."]
    dims: tuple[str, ...]
    labels: tuple[str, ...]

    @property
    def flat(self) -> Float[np.ndarray, "n_runs c"]:
        """The entries side by side."""
        return self.values.reshape(len(self.values), -1)


def most_scattered(output: Output, deviations: Float[np.ndarray, " c"]) -> list[int]:
    """The entries of an output that are told: of each component the time when it scatters most; none that stands still.

    Args:
        output: the output.
        deviations: of its entries.
    """
    places = np.arange(deviations.size).reshape(output.values.shape[1:])
    if "time" in output.dims:
        by_time = np.moveaxis(places, output.dims.index("time"), 0).reshape(places.shape[output.dims.index("time")], -1)
        places = by_time[np.argmax(deviations[by_time], axis=0), np.arange(by_time.shape[1])]
    moving = [int(c) for c in places.ravel() if deviations[c] > STANDS_STILL * deviations.max()]
    return sorted(moving, key=lambda c: -deviations[c])[:SHOWN] or [int(places.ravel()[0])]


def scattered_numbers(spreads: Mapping[str, Spread]) -> list[Scattered]:
    """What scatters, by name.

    Raises:
        SceneError: for nothing, or for what says no scatter.
    """
    if not isinstance(spreads, Mapping) or not spreads:
        raise SceneError(
            'spreads= needs uncertain numbers by name, e.g. {"clearance": sj.studies.Tolerance(1e-4, 2e-5)}'
        )
    return [scattered(name, spread) for name, spread in spreads.items()]


def along_time(swept: "xarray.Dataset") -> "xarray.Dataset":
    """The sweep, with what functions keep at every sample along `time`, as quantities are."""
    n = swept.sizes.get("time", 0)
    renamed = {}
    for name in swept.data_vars:
        own = [dim for dim in swept[name].dims if dim not in swept["status"].dims]
        if own and own[0] not in swept.coords and swept.sizes[own[0]] == n > 1:
            renamed[name] = swept[name].rename({own[0]: "time"}).assign_coords(time=swept["time"])
    return swept.assign(renamed)


def outputs_of(swept: "xarray.Dataset") -> list[Output]:
    """What a sweep of samples has kept."""
    return [_output(swept[name]) for name in swept.data_vars if name not in TAKEN]


def _output(kept: "xarray.DataArray") -> Output:
    values = np.asarray(kept.values, np.float64)
    dims = tuple(str(dim) for dim in kept.dims[1:])
    ends = [[_end(kept, dim, i) for i in range(kept.sizes[dim])] for dim in dims]
    labels = [str(kept.name)]
    for each in ends:
        labels = [label + end for label in labels for end in each]
    unit = str(kept.attrs.get("units", ""))
    return Output(str(kept.name), "" if unit == "1" else unit, values, dims, tuple(labels))


def _end(kept: "xarray.DataArray", dim: str, i: int) -> str:
    """What tells an entry along a dimension from the others."""
    if dim == "time":
        return f" at {float(kept[dim][i]):.4g} s"
    return f".{kept[dim].values[i]}" if dim in kept.coords else f"[{i}]"


def usable(swept: "xarray.Dataset", outputs: list[Output]) -> Bool[np.ndarray, " n_runs"]:
    """Which runs succeeded, with finite results."""
    good = np.asarray(swept["status"].values) == Status.SUCCEEDED
    for output in outputs:
        good &= np.all(np.isfinite(output.flat), axis=1)
    return good


def tell_of_failures(
    what: str,
    swept: "xarray.Dataset",
    good: Bool[np.ndarray, " n_runs"],
    left: str,
    *,
    is_enough: bool,
    stacklevel: int,
) -> str:
    """Warn of runs that are left out; a sentence, empty where there are none.

    Args:
        what: the study.
        swept: its runs.
        good: which of them can be used.
        left: what is left of them.
        is_enough: whether that is something to go on.
        stacklevel: of the warning, as seen from the study.

    Raises:
        SceneError: where it is not.
    """
    if np.all(good):
        return ""
    first = int(np.argmin(good))
    numbers = [name for name in swept.coords if swept[name].dims == swept["status"].dims and name != "run"]
    where = ", ".join(f"{name} = {float(swept[name].values[first]):.6g}" for name in numbers)
    why = swept.attrs.get("failures") or "what was observed is not finite"
    text = f"{what}: {int(np.sum(~good))} of {good.size} runs failed, the first with {where}: {why}"
    if not is_enough:
        raise SceneError(f"{text}. {left}")
    text += f". It speaks of the others alone: {left}"
    warnings.warn(text, UncertaintyWarning, stacklevel=stacklevel + 1)
    return text


def table(rows: list[tuple[str, ...]]) -> list[str]:
    """Lines of a table whose first row is its head; numbers to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    padded = [[cell.rjust(width) for cell, width in zip(row, widths, strict=True)] for row in rows]
    return ["  ".join([row[0].ljust(widths[0]), *cells[1:]]) for row, cells in zip(rows, padded, strict=True)]

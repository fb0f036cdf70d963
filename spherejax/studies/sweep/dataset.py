"""The results of a sweep as a labelled data set."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from spherejax.motion.dataset import AXES, COMPONENTS
from spherejax.motion.status import REMEDIES, Status
from spherejax.studies.sweep.grids import Grid
from spherejax.studies.sweep.records import Record

if TYPE_CHECKING:
    import xarray

COUNTED = {
    "status": ("1", "how the run ended; 0: it reached its end"),
    "t_reached": ("s", "time reached"),
    "n_steps": ("1", "steps, kept or repeated"),
    "n_rejected": ("1", "steps repeated"),
}
"""What is there of every run: unit and long name."""


def dataset_of(
    grid: Grid, record: Record, ts: Float[np.ndarray, " n"], values: Mapping[str, np.ndarray], facts: Mapping[str, Any]
) -> "xarray.Dataset":
    """Everything that a sweep has kept, with the parameters as coordinates."""
    import xarray

    variables = {}
    for kept in record.kept:
        array = values[kept.name].reshape(*grid.shape, *values[kept.name].shape[1:])
        own = kept.dims
        if own is None:
            own = tuple(f"{kept.name}_{axis}" for axis in range(array.ndim - len(grid.dims)))
        variables[kept.name] = ((*grid.dims, *own), array, kept.attributes)
    for name, (unit, long_name) in COUNTED.items():
        attributes: dict[str, Any] = {"units": unit, "long_name": long_name}
        if name == "status":
            attributes["flag_values"] = [int(status) for status in Status]
            attributes["flag_meanings"] = " ".join(status.name.lower() for status in Status)
        variables[name] = (grid.dims, values[name].reshape(grid.shape), attributes)
    dataset = xarray.Dataset(variables, _coordinates(grid, ts))
    dims = set(dataset.dims)
    extra = {"axis": list(AXES), "component": list(COMPONENTS)}
    dataset = dataset.assign_coords({name: labels for name, labels in extra.items() if name in dims})
    return dataset.assign_attrs({**facts, "failures": failures_of(values["status"])})


def failures_of(status: np.ndarray) -> str:
    """How many runs failed, why, and what to do; empty when none did."""
    flat = status.ravel()
    sentences = []
    for kind in Status:
        where = np.flatnonzero(flat == kind)
        if kind != Status.SUCCEEDED and where.size:
            which = ", ".join(map(str, where[:5])) + (", ..." if where.size > 5 else "")
            sentences.append(f"{where.size} runs ({which}), {kind.name.lower()}: {REMEDIES[kind]}.")
    return "\n".join(sentences)


def _coordinates(grid: Grid, ts) -> dict:
    coordinates: dict[str, Any] = {"time": ("time", ts, {"units": "s", "long_name": "time"})}
    if grid.axes:
        return {**coordinates, **{name: (name, values) for name, values in grid.axes.items()}}
    return {**coordinates, **{name: ("run", values) for name, values in grid.values.items()}}

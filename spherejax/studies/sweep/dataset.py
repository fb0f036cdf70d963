"""The results of a sweep as a labelled data set."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from spherejax.motion.integration.status import REMEDIES, Status
from spherejax.motion.results.dataset import AXES, COMPONENTS
from spherejax.motion.results.run_flags import FLAGS, MASKS
from spherejax.studies.sweep.grids import Grid
from spherejax.studies.sweep.records import PARAMETER, Record

if TYPE_CHECKING:
    import xarray

COUNTED = {
    "status": ("1", "how the run ended; 0: it reached its end"),
    "t_reached": ("s", "time reached"),
    "n_steps": ("1", "steps, kept or repeated"),
    "n_rejected": ("1", "steps repeated"),
    "warnings": ("1", "what is to be minded of the run; 0: it reached its end within the range of its laws"),
}
"""What is there of every run: unit and long name."""

RUN = "run"
"""The dimension of runs that are just numbered."""


class RunsColumn(NamedTuple):
    """One thing that is known of every run.

    Attributes:
        dims: dimensions behind the run's.
        attributes: unit, long name.
    """

    dims: tuple[str, ...]
    attributes: dict[str, Any]


def columns_of(record: Record, n_dims: Mapping[str, int]) -> dict[str, RunsColumn]:
    """What is known of every run, by name.

    Args:
        record: what is kept.
        n_dims: number of dimensions of each thing that is kept, of one run.
    """
    columns = {}
    for kept in record.kept:
        own = kept.dims
        if own is None:
            last = (PARAMETER,) if kept.by else ()
            own = (*(f"{kept.name}_{axis}" for axis in range(n_dims[kept.name] - len(last))), *last)
        columns[kept.name] = RunsColumn(own, dict(kept.attributes))
    for name, (unit, long_name) in COUNTED.items():
        attributes: dict[str, Any] = {"units": unit, "long_name": long_name}
        if name == "status":
            attributes["flag_values"] = [int(status) for status in Status]
            attributes["flag_meanings"] = " ".join(status.name.lower() for status in Status)
        if name == "warnings":
            attributes["flag_masks"] = list(MASKS.values())
            attributes["flag_meanings"] = " ".join(FLAGS)
        columns[name] = RunsColumn((), attributes)
    return columns


def coordinates_of(grid: Grid, ts: Float[np.ndarray, " n"]) -> dict[str, tuple]:
    """Times and parameters."""
    coordinates: dict[str, Any] = {"time": ("time", ts, {"units": "s", "long_name": "time"})}
    if grid.axes:
        return {**coordinates, **{name: (name, values) for name, values in grid.axes.items()}}
    return {**coordinates, **{name: (RUN, values) for name, values in grid.values.items()}}


def dataset_of(
    dims: tuple[str, ...],
    coordinates: Mapping[str, tuple],
    columns: Mapping[str, RunsColumn],
    values: Mapping[str, Any],
    facts: Mapping[str, Any],
    account: "SweepAccount",
) -> "xarray.Dataset":
    """Everything that a sweep has kept, with the parameters as coordinates.

    Args:
        dims: names of the grid's axes.
        coordinates: times and parameters.
        columns: what there is.
        values: arrays that begin with the grid's axes; in memory, or read when they are asked for.
        facts: attributes.
        account: more of them: time, lanes, failures.
    """
    import xarray

    variables = {name: ((*dims, *own), values[name], attributes) for name, (own, attributes) in columns.items()}
    dataset = xarray.Dataset(variables, coordinates)
    by = next((attributes["by"] for own, attributes in columns.values() if PARAMETER in own), "")
    extra = {"axis": list(AXES), "component": list(COMPONENTS), PARAMETER: by.split()}
    dataset = dataset.assign_coords({name: labels for name, labels in extra.items() if name in dataset.dims})
    return dataset.assign_attrs({**facts, **account.attributes})


N_NAMED = 5
"""Runs that failed in one way and are named by their number."""


@dataclass
class SweepAccount:
    """Time, lanes and failures, added up chunk by chunk.

    Attributes:
        is_stored: of every chunk.
        n_runs: of the sweep.
        seconds: of every chunk [s].
        n_lane_steps: of every chunk.
        n_steps: of all runs together.
        failed: how many runs failed in each way, and which ones first.
    """

    is_stored: np.ndarray
    n_runs: int
    seconds: np.ndarray
    n_lane_steps: np.ndarray
    n_steps: int
    failed: dict[Status, tuple[int, list[int]]]

    @staticmethod
    def of_nothing(is_stored: np.ndarray, n_runs: int, seconds: np.ndarray, n_lane_steps: np.ndarray) -> "SweepAccount":
        """Before any run has been counted."""
        return SweepAccount(is_stored, n_runs, np.asarray(seconds, float), n_lane_steps, 0, {})

    def add(self, first: int, status: np.ndarray, n_steps: np.ndarray) -> None:
        """Count runs, of which the first has the number `first`."""
        self.n_steps += int(np.sum(np.maximum(n_steps, 0)))
        for kind in np.unique(status[status > Status.SUCCEEDED]):
            n, which = self.failed.get(Status(kind), (0, []))
            found = np.flatnonzero(status == kind)
            named = [*which, *(first + int(run) for run in found[: N_NAMED + 1 - len(which)])]
            self.failed[Status(kind)] = (n + found.size, named)

    @property
    def attributes(self) -> dict[str, Any]:
        """What the result says of them."""
        total = int(np.sum(self.n_lane_steps))
        return {
            "seconds_of_chunks": self.seconds,
            "n_lane_steps": total,
            "lane_efficiency": self.n_steps / max(total, 1),
            "failures": self.failures,
        }

    @property
    def failures(self) -> str:
        """How many runs failed, why, and what to do; empty when none did."""
        sentences = []
        for kind in sorted(self.failed):
            n, which = self.failed[kind]
            named = ", ".join(map(str, which[:N_NAMED])) + (", ..." if n > N_NAMED else "")
            sentences.append(f"{n} runs ({named}), {kind.name.lower()}: {REMEDIES[kind]}.")
        return "\n".join(sentences)

"""The chunks of a sweep that are there: in memory, or in a store."""

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.motion.integration.status import OutOfRangeWarning
from spherejax.studies.sweep.chunks import ChunkResult, ChunkWork, Rows, shapes_of
from spherejax.studies.sweep.dataset import COUNTED, SweepAccount, columns_of, coordinates_of, dataset_of
from spherejax.studies.sweep.grids import Grid
from spherejax.studies.sweep.reading import dataset_in
from spherejax.studies.sweep.store import Store, open_store

if TYPE_CHECKING:
    import xarray


class Results:
    """What has been computed, and what is missing.

    Attributes:
        grid: the runs.
        work: what is done with every chunk.
        n_chunks: number of chunks.
        store: where they are kept, or None for memory.
        cautions: what the first chunk with such runs was used for beyond the range of its laws; empty for nothing.
    """

    def __init__(
        self, grid: Grid, work: ChunkWork, path: Path | None, facts: Mapping[str, Any], own: Mapping[str, Any]
    ):
        self.grid, self.work, self.facts = grid, work, facts
        self.n_chunks = -(-grid.n_runs // work.size)
        shapes = shapes_of(work, self.rows(0))
        self.columns = columns_of(work.record, {name: len(each.shape) for name, each in shapes.items()})
        self.store: Store | None = None
        self.cautions = ""
        if path is None:
            check_memory(grid.n_runs, shapes)
            # Of their final size from the start: no second copy when all is done.
            self.arrays = {name: np.empty((grid.n_runs, *each.shape), each.dtype) for name, each in shapes.items()}
            self.of_chunks = {name: np.zeros(self.n_chunks) for name in ("seconds", "n_lane_steps")}
        else:
            # Where the user's folder stands does not make it another sweep.
            identity = {"grid": grid.fingerprint, "chunk_size": work.size, **facts, **own}
            del identity["commit"]
            ts = np.asarray(work.ts)
            self.store = open_store(path, identity, facts, shapes, self.columns, grid, ts, work.size)

    def rows(self, chunk: int) -> Rows:
        """Parameters of a chunk's runs."""
        return self.grid.rows(self._runs(chunk).start, self._runs(chunk).stop)

    def _runs(self, chunk: int) -> slice:
        return slice(chunk * self.work.size, min((chunk + 1) * self.work.size, self.grid.n_runs))

    def missing(self) -> list[int]:
        """Chunks still to be computed."""
        return list(range(self.n_chunks)) if self.store is None else self.store.missing()

    def put(self, chunk: int, result: ChunkResult) -> None:
        """Take a chunk."""
        if result.cautions and not self.cautions:
            self.cautions = f"chunk {chunk} of {self.n_chunks}: {result.cautions}"
            warnings.warn(self.cautions, OutOfRangeWarning, stacklevel=4)
        if self.store is not None:
            self.store.put(chunk, result)
            return
        for name, values in (result.kept | {name: getattr(result, name) for name in COUNTED}).items():
            if name not in self.arrays:
                self.arrays[name] = np.empty(self.grid.n_runs, values.dtype)
            self.arrays[name][self._runs(chunk)] = values
        self.of_chunks["seconds"][chunk] = result.seconds
        self.of_chunks["n_lane_steps"][chunk] = result.n_lane_steps

    def dataset(self) -> "xarray.Dataset":
        """All runs, labelled; in memory, or read from the store where they are looked at."""
        if self.store is not None:
            # What was there has been verified before, and what has come since was written by this process.
            found = dataset_in(self.store, self.store.read_through(verify=False))
            return found.assign_attrs(commit=self.facts["commit"], cautions=self.cautions)
        grid, arrays = self.grid, self.arrays
        values = {name: array.reshape(*grid.shape, *array.shape[1:]) for name, array in arrays.items()}
        account = SweepAccount.of_nothing(np.ones(self.n_chunks, bool), grid.n_runs, **self.of_chunks)
        account.add(0, arrays["status"], arrays["n_steps"])
        coordinates = coordinates_of(grid, np.asarray(self.work.ts))
        found = dataset_of(grid.dims, coordinates, self.columns, values, self.facts, account)
        return found.assign_attrs(cautions=self.cautions)


def check_memory(n_runs: int, shapes: Mapping[str, Any]) -> None:
    """Raise `SceneError` for results that this machine cannot hold in memory."""
    of_run = sum(int(np.prod(each.shape)) * np.dtype(each.dtype).itemsize for each in shapes.values())
    needed, there = n_runs * (of_run + 8 * len(COUNTED)), memory_of_machine()
    if there is not None and needed > SHARE * there:
        largest = max(shapes, key=lambda name: int(np.prod(shapes[name].shape)))
        raise SceneError(
            f"the results of {n_runs:,} runs take {needed / 1e9:.3g} GB, and this machine has {there / 1e9:.3g} GB of "
            "memory. Give a folder, store='sweep.zarr', which takes them as they come, or keep less (most is "
            f"{largest!r})"
        )


SHARE = 0.8
"""Of the memory, that results may take: the rest is for the program and the chunks under way."""


def memory_of_machine() -> int | None:
    """Bytes; None where the system does not say."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return None

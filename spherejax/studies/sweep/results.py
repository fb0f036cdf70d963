"""The chunks of a sweep that are there: in memory, or in a store."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spherejax.studies.sweep.chunks import ChunkResult, Rows, Work, shapes_of
from spherejax.studies.sweep.dataset import COUNTED, account_of, columns_of, coordinates_of, dataset_of
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
    """

    def __init__(self, grid: Grid, work: Work, path: Path | None, facts: Mapping[str, Any]):
        self.grid, self.work, self.facts = grid, work, facts
        self.n_chunks = -(-grid.n_runs // work.size)
        shapes = shapes_of(work, self.rows(0))
        self.columns = columns_of(work.record, {name: len(each.shape) for name, each in shapes.items()})
        self.store: Store | None = None
        if path is None:
            # Of their final size from the start: no second copy when all is done.
            self.arrays = {name: np.empty((grid.n_runs, *each.shape), each.dtype) for name, each in shapes.items()}
            self.of_chunks = {name: np.zeros(self.n_chunks) for name in ("seconds", "n_lane_steps")}
        else:
            # Where the user's folder stands does not make it another sweep.
            identity = {"grid": grid.fingerprint, "chunk_size": work.size, **facts}
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
            found = dataset_in(self.store)
            return found.assign_attrs(commit=self.facts["commit"])
        grid, arrays = self.grid, self.arrays
        values = {name: array.reshape(*grid.shape, *array.shape[1:]) for name, array in arrays.items()}
        account = account_of(arrays["n_steps"], self.of_chunks["seconds"], self.of_chunks["n_lane_steps"])
        coordinates = coordinates_of(grid, np.asarray(self.work.ts))
        return dataset_of(grid.dims, coordinates, self.columns, values, {**self.facts, **account})

"""Where a sweep keeps its results: a Zarr group, written chunk by chunk, from which a stopped sweep goes on.

A chunk counts as stored when its digest has been written, which is the last thing that is done. A chunk that was cut
off has none and is computed again. Digests are checked when a store is opened: what was damaged since is found.

Runs are numbered along one axis, so that each chunk is a file of each array. Dimensions, units and the parameters of
every run are stored as well: any program that reads Zarr finds its way (`xarray.open_zarr(path, consolidated=False)`),
and `open_sweep` sees a product with its axes again.
"""

import hashlib
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from spherejax.foundations.checks import SceneError
from spherejax.studies.sweep.chunks import ChunkResult
from spherejax.studies.sweep.dataset import RUN, Column
from spherejax.studies.sweep.grids import Grid

COUNTED = {"status": np.int64, "t_reached": np.float64, "n_steps": np.int64, "n_rejected": np.int64}
"""What is stored of every run besides what was asked for."""

OF_CHUNKS = {"seconds": np.float64, "n_lane_steps": np.int64, "digest": np.uint64}
"""What is stored of every chunk."""

MARK = "spherejax sweep"


class Store:
    """The results of one sweep in a Zarr group.

    Attributes:
        path: the folder.
        n_runs: number of runs.
        chunk_size: runs in a chunk.
    """

    def __init__(self, path: Path, group: Any):
        self.path, self.group = path, group
        self.chunk_size = int(group.attrs["chunk_size"])
        self.n_runs = int(np.prod(group.attrs["grid_shape"]))
        self.n_chunks = -(-self.n_runs // self.chunk_size)
        # A look-up in a group reads and parses a file: once for each array, not once for each chunk.
        try:
            self.arrays: dict[str, Any] = {name: group[name] for name in (*self.names, *OF_CHUNKS, *self.parameters)}
        except Exception as error:
            raise _damaged(path, f"an array cannot be opened ({error})") from error

    def runs_of(self, chunk: int) -> slice:
        """Indices of a chunk's runs."""
        return slice(chunk * self.chunk_size, min((chunk + 1) * self.chunk_size, self.n_runs))

    @property
    def names(self) -> list[str]:
        """What is stored of every run as its result."""
        return self.group.attrs["columns"]

    @property
    def parameters(self) -> list[str]:
        """Times, and what was swept."""
        return ["time", *self.group.attrs["parameters"]]

    def put(self, chunk: int, result: ChunkResult) -> None:
        """Store a chunk; its digest comes last."""
        runs, values = self.runs_of(chunk), _by_name(result)
        for name, array in values.items():
            self.arrays[name][runs] = array
        self.arrays["seconds"][chunk] = result.seconds
        self.arrays["n_lane_steps"][chunk] = result.n_lane_steps
        self.arrays["digest"][chunk] = _digest(values)

    @property
    def n_stored(self) -> int:
        """Number of runs in stored chunks."""
        stored = np.flatnonzero(self.of_all("digest"))
        return sum(self.runs_of(int(chunk)).stop - self.runs_of(int(chunk)).start for chunk in stored)

    def missing(self) -> list[int]:
        """Chunks that are not stored yet.

        Raises:
            SceneError: when a stored chunk is not what was written.
        """
        digests = self.of_all("digest")
        return [chunk for chunk in range(self.n_chunks) if not self._is_stored(chunk, int(digests[chunk]))]

    def _is_stored(self, chunk: int, digest: int) -> bool:
        if digest == 0:
            return False
        try:
            values = {name: np.asarray(self.arrays[name][self.runs_of(chunk)]) for name in self.names}
        except Exception as error:
            raise _damaged(self.path, f"chunk {chunk} cannot be read ({error})") from error
        if _digest(values) != digest:
            raise _damaged(self.path, f"chunk {chunk} is not what was written")
        return True

    def of_all(self, name: str) -> np.ndarray:
        """Something of every run (e.g. `n_steps`) or of every chunk (`seconds`, `n_lane_steps`), read now."""
        try:
            return np.asarray(self.arrays[name])
        except Exception as error:
            raise _damaged(self.path, f"{name!r} cannot be read ({error})") from error


def open_store(
    path: Path,
    identity: Mapping[str, Any],
    facts: Mapping[str, Any],
    shapes: Mapping[str, jax.ShapeDtypeStruct],
    columns: Mapping[str, Column],
    grid: Grid,
    ts: np.ndarray,
    chunk_size: int,
) -> Store:
    """A new store, or the store of the same sweep.

    Args:
        path: folder, which does not exist or holds a store of this sweep.
        identity: what makes it the same sweep; compared entry by entry.
        facts: what a reader wants to know.
        shapes: of what is kept of one run.
        columns: dimensions and units of what is stored of one run.
        grid: the runs.
        ts: sample times [s].
        chunk_size: runs in a chunk; an existing store has its own.

    Raises:
        SceneError: for the store of another sweep, a damaged one, or a folder that is none.
    """
    if path.exists():
        return _reopened(path, identity)
    return _made(path, identity, facts, shapes, columns, grid, ts, chunk_size)


def stored_chunk_size(path: Path) -> int | None:
    """Runs in a chunk of an existing store; None where there is none.

    Raises:
        SceneError: for a path that cannot be a store, or something else that is there.
    """
    if path.suffix in (".nc", ".csv", ".h5", ".hdf5"):
        raise SceneError(
            f"store={str(path)!r}: a store is a folder of Zarr files, which takes the results as they come; name it "
            f"e.g. {path.with_suffix('.zarr').name!r}, and write a file of the result: result.to_netcdf({path.name!r})"
        )
    if not path.exists():
        return None
    return int(opened(path).attrs["chunk_size"])


def opened(path: Path, mode: Any = "r+") -> Any:
    """The group of an existing store.

    Raises:
        SceneError: where there is none.
    """
    import zarr

    try:
        group = zarr.open_group(path, mode=mode)
        is_store = group.attrs.get("mark") == MARK and {"identity", "chunk_size", "grid_shape"} <= set(group.attrs)
    except Exception as error:
        raise SceneError(f"{str(path)!r} exists and is no store of a sweep ({error}); choose another path") from error
    if not is_store:
        raise SceneError(f"{str(path)!r} exists and is no store of a sweep; choose another path")
    return group


def _made(path: Path, identity, facts, shapes, columns, grid: Grid, ts, chunk_size: int) -> Store:
    import zarr

    # Made beside its place and moved there whole: a store that exists is complete.
    unfinished = path.with_name(path.name + ".unfinished")
    shutil.rmtree(unfinished, ignore_errors=True)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        group = zarr.open_group(unfinished, mode="w")
    except OSError as error:
        raise SceneError(f"cannot write {str(path)!r}: {error.strerror or error}") from error
    kinds = {name: (each.shape, each.dtype) for name, each in shapes.items()}
    kinds |= {name: ((), dtype) for name, dtype in COUNTED.items()}
    for name, (shape, dtype) in kinds.items():
        group.create_array(
            name,
            shape=(grid.n_runs, *shape),
            chunks=(chunk_size, *shape),
            dtype=np.dtype(dtype),
            fill_value=np.nan if np.issubdtype(dtype, np.floating) else -1,
            dimension_names=(RUN, *columns[name].dims),
            attributes=columns[name].attributes,
        )
    n_chunks = -(-grid.n_runs // chunk_size)
    for name, dtype in OF_CHUNKS.items():
        group.create_array(
            name, shape=(n_chunks,), chunks=(1,), dtype=np.dtype(dtype), fill_value=0, dimension_names=("chunk",)
        )
    _describe(group, facts, grid, ts)
    group.attrs.update(
        {
            "mark": MARK,
            "identity": json.dumps(identity),
            "chunk_size": chunk_size,
            "columns": list(columns),
            "grid_dims": list(grid.dims),
            "grid_shape": list(grid.shape),
            "parameters": list(grid.values),
            # What readers of Zarr take for coordinates.
            "coordinates": " ".join(grid.values),
        }
    )
    unfinished.rename(path)
    return Store(path, zarr.open_group(path, mode="r+"))


def _describe(group: Any, facts: Mapping[str, Any], grid: Grid, ts: np.ndarray) -> None:
    """Times, parameters and what a reader wants to know."""
    group.create_array("time", data=ts, dimension_names=("time",), attributes={"units": "s", "long_name": "time"})
    for name, values in grid.values.items():
        group.create_array(name, data=np.asarray(values), dimension_names=(RUN,))
    group.attrs.update({"facts": dict(facts)})


_DIGESTS = {
    "grid": "its grid has other parameters or other values",
    "numbers": "its numbers that are not swept are others, e.g. a mass or a point of the scene",
}
"""What differs where only digests are compared."""


def _reopened(path: Path, identity) -> Store:
    group = opened(path)
    before = json.loads(group.attrs["identity"])
    now = json.loads(json.dumps(identity))
    different = [key for key in now if before.get(key) != now[key]]
    if different:
        key = different[0]
        what = _DIGESTS.get(key, f"its {key} is {before.get(key)!r}, not {now[key]!r}")
        raise SceneError(
            f"{str(path)!r} is the store of another sweep: {what}. Choose another path, or ask for the same sweep to "
            "go on with it"
        )
    return Store(path, group)


def _damaged(path: Path, what: str) -> SceneError:
    return SceneError(f"the store {str(path)!r} is damaged: {what}. Move it away and run the sweep again")


def _by_name(result: ChunkResult) -> dict[str, np.ndarray]:
    counted = {name: np.asarray(getattr(result, name), dtype) for name, dtype in COUNTED.items()}
    return {**result.kept, **counted}


def _digest(values: Mapping[str, np.ndarray]) -> int:
    digest = hashlib.sha256()
    for name in sorted(values):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(values[name]).tobytes())
    # 63 bits, never zero: zero says that nothing is stored.
    return int.from_bytes(digest.digest()[:8], "big") >> 1 | 1

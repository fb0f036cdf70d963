"""Where a sweep keeps its results: a Zarr group, written chunk by chunk, from which a stopped sweep resumes.

A chunk counts as stored when its digest has been written, which is the last thing that is done. A chunk that was cut
off has none and is computed again. Digests are compared when a store is opened, to be read or resumed, and
with them times, parameters and all that describes the arrays: what was damaged since, or is missing, is found.

Runs are numbered along one axis, so that each chunk is a file of each array. Dimensions, units and the parameters of
every run are stored as well: any program that reads Zarr finds its way (`xarray.open_zarr(path, consolidated=False)`),
and `open_sweep` sees a product with its axes again.
"""

import hashlib
import json
import math
import shutil
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.output.escapes import RENAMED, escapes_of
from spherejax.output.wholeness import check_store_is_whole
from spherejax.studies.sweep.chunks import ChunkResult
from spherejax.studies.sweep.dataset import RUN, RunsColumn, SweepAccount
from spherejax.studies.sweep.failures import StoreWarning, writing
from spherejax.studies.sweep.grids import SLAB, Grid

COUNTED = {
    "status": np.int64,
    "t_reached": np.float64,
    "n_steps": np.int64,
    "n_rejected": np.int64,
    "warnings": np.int64,
}
"""What is stored of every run besides what was asked for; stores of format 2 and 1 have no `warnings`."""

OF_CHUNKS = {"seconds": np.float64, "n_lane_steps": np.int64, "digest": np.uint64}
"""What is stored of every chunk."""

MARK = "spherejax sweep"

FORMAT = 3
"""1, which is not written down: digests cover the runs alone. 2: times and lanes of a chunk too, and the description of
the arrays. 3: warnings of each run."""

AT_ONCE = 2**26
"""Bytes that are read at a time to be compared with their digests."""


class Store:
    """The results of one sweep in a Zarr group.

    Attributes:
        path: the folder.
        n_runs: number of runs.
        chunk_size: runs in a chunk.
    """

    def __init__(self, path: Path, group: Any):
        self.path, self.group = path, group
        self.format = int(group.attrs.get("format", 1))
        self.chunk_size = int(group.attrs["chunk_size"])
        self.n_runs = math.prod(group.attrs["grid_shape"])
        self.n_chunks = -(-self.n_runs // self.chunk_size)
        # A look-up in a group reads and parses a file: once for each array, not once for each chunk.
        try:
            escapes = {name: word for word, name in json.loads(group.attrs.get(RENAMED, "{}")).items()}
            names = (*self.names, *OF_CHUNKS, *self.parameters)
            self.arrays: dict[str, Any] = {name: group[escapes.get(name, name)] for name in names}
        except Exception as error:
            raise damaged(path, f"an array cannot be opened ({error})") from error

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
        """Store a chunk; its digest comes last.

        Raises:
            SweepError: when it cannot be written; it then counts as missing.
        """
        runs, stored = self.runs_of(chunk), self.names
        values = {name: array for name, array in _by_name(result).items() if name in stored}
        of_chunk = {"seconds": result.seconds, "n_lane_steps": result.n_lane_steps}
        with writing(self.path, f"chunk {chunk}"):
            for name, array in values.items():
                self.arrays[name][runs] = array
            for name, value in of_chunk.items():
                self.arrays[name][chunk] = value
            self.arrays["digest"][chunk] = _digest(values, of_chunk if self.format > 1 else {})

    @property
    def n_stored(self) -> int:
        """Number of runs in stored chunks."""
        stored = np.flatnonzero(self.of_all("digest"))
        return sum(self.runs_of(int(chunk)).stop - self.runs_of(int(chunk)).start for chunk in stored)

    def missing(self) -> list[int]:
        """Chunks that are not stored yet; those that are have been verified.

        Raises:
            SceneError: when something that is stored is not what was written.
        """
        return np.flatnonzero(~self.read_through(verify=True).is_stored).tolist()

    def read_through(self, *, verify: bool) -> SweepAccount:
        """Go through all chunks, some at a time.

        Args:
            verify: compare everything with what was written; otherwise only what counts is read.

        Raises:
            SceneError: when something cannot be read, or is not what was written.
        """
        # Before the runs: what is written meanwhile counts as missing.
        digests, of_chunks = self.of_all("digest"), {name: self.of_all(name) for name in ("seconds", "n_lane_steps")}
        if verify:
            self._verify_description()
        account = SweepAccount.of_nothing(digests != 0, self.n_runs, **of_chunks)
        names = self.names if verify else ["status", "n_steps"]
        for chunk, values in self._stored_chunks(digests != 0, names):
            own = {name: each[chunk] for name, each in of_chunks.items()} if self.format > 1 else {}
            if verify and _digest(values, own) != int(digests[chunk]):
                raise damaged(self.path, f"chunk {chunk} is not what was written")
            account.add(self.runs_of(chunk).start, values["status"], values["n_steps"])
        return account

    def _stored_chunks(self, is_stored: np.ndarray, names: list[str]) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
        """The stored chunks one after the other, read several at a time."""
        bytes_of_run = sum(
            int(np.prod(self.arrays[name].shape[1:])) * self.arrays[name].dtype.itemsize for name in names
        )
        several = max(AT_ONCE // max(bytes_of_run * self.chunk_size, 1), 1)
        for first in range(0, self.n_chunks, several):
            chunks = [chunk for chunk in range(first, min(first + several, self.n_chunks)) if is_stored[chunk]]
            if not chunks:
                continue
            begin, end = self.runs_of(chunks[0]).start, self.runs_of(chunks[-1]).stop
            try:
                read = {name: np.asarray(self.arrays[name][begin:end]) for name in names}
            except Exception as error:
                which = chunks[0] if len(chunks) == 1 else f"{chunks[0]} to {chunks[-1]}"
                raise damaged(self.path, f"chunk {which} cannot be read ({error})") from error
            for chunk in chunks:
                runs = self.runs_of(chunk)
                yield chunk, {name: each[runs.start - begin : runs.stop - begin] for name, each in read.items()}

    def _verify_description(self) -> None:
        """Compare times, parameters, and what describes the arrays, with what was written."""
        attrs = self.group.attrs
        identity = json.loads(attrs["identity"])
        grid = hashlib.sha256(
            repr((attrs["facts"]["grid_kind"], tuple(attrs["grid_dims"]), tuple(attrs["grid_shape"]))).encode()
        )
        for name in attrs["parameters"]:
            grid.update(name.encode())
            for start in range(0, self.n_runs, SLAB):
                grid.update(np.asarray(self._read(name, slice(start, start + SLAB)), np.float64).tobytes())
        if grid.hexdigest() != identity["grid"]:
            raise damaged(self.path, "the parameters of its runs are not what was written")
        if times_fingerprint(self.of_all("time")) != identity["times"]:
            raise damaged(self.path, "its sample times are not what was written")
        if self.format == 1:
            warnings.warn(
                f"the store {str(self.path)!r} was written by an earlier version of spherejax: runs, parameters "
                "and times have been verified; units, names, and the seconds of its chunks could not be",
                StoreWarning,
                stacklevel=2,
            )
        elif _seal(self.path, self.group) != attrs["seal"]:
            raise damaged(self.path, "what describes its arrays is not what was written")

    def of_all(self, name: str) -> np.ndarray:
        """Something of every run (e.g. `n_steps`) or of every chunk (`seconds`, `n_lane_steps`), read now."""
        return self._read(name, slice(None))

    def _read(self, name: str, where: slice) -> np.ndarray:
        try:
            return np.asarray(self.arrays[name][where])
        except Exception as error:
            raise damaged(self.path, f"{name!r} cannot be read ({error})") from error


def open_store(
    path: Path,
    identity: Mapping[str, Any],
    facts: Mapping[str, Any],
    shapes: Mapping[str, jax.ShapeDtypeStruct],
    columns: Mapping[str, RunsColumn],
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
    check_path(path)
    if not path.exists():
        return None
    return int(opened(path).attrs["chunk_size"])


def check_path(path: Path) -> None:
    """Raise `SceneError` for a path that names a file of another kind."""
    if path.suffix in (".nc", ".csv", ".h5", ".hdf5"):
        raise SceneError(
            f"store={str(path)!r}: a store is a folder of Zarr files, which takes the results as they come; name it "
            f"e.g. {path.with_suffix('.zarr').name!r}, and write a file of the result: result.to_netcdf({path.name!r})"
        )


def opened(path: Path, mode: Any = "r+") -> Any:
    """The group of an existing store.

    Raises:
        SceneError: where there is none.
    """
    import zarr

    try:
        check_store_is_whole(path)
        group = zarr.open_group(path, mode=mode, zarr_format=3)  # version 2 knows pickles, which are code
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
    with writing(path, "the store"):
        path.parent.mkdir(parents=True, exist_ok=True)
        group = zarr.open_group(unfinished, mode="w")
        # A slash in a name would make a group of its own, which no reader of the store looks into.
        escapes = escapes_of((*columns, *OF_CHUNKS, *grid.names))
        _add_arrays(group, shapes, columns, grid, chunk_size, escapes)
        _describe(group, facts, grid, ts, escapes)
        if escapes:
            group.attrs[RENAMED] = json.dumps({word: name for name, word in escapes.items()})
        group.attrs.update(
            {
                "mark": MARK,
                "format": FORMAT,
                "identity": json.dumps(identity),
                "chunk_size": chunk_size,
                "columns": list(columns),
                "grid_dims": list(grid.dims),
                "grid_shape": list(grid.shape),
                "parameters": list(grid.names),
                # What readers of Zarr take for coordinates.
                "coordinates": " ".join(escapes.get(name, name) for name in grid.names),
            }
        )
        group.attrs["seal"] = _seal(unfinished, zarr.open_group(unfinished, mode="r"))
        unfinished.rename(path)
    return Store(path, zarr.open_group(path, mode="r+"))


def _add_arrays(group: Any, shapes, columns, grid: Grid, chunk_size: int, escapes: Mapping[str, str]) -> None:
    kinds = {name: (each.shape, each.dtype) for name, each in shapes.items()}
    kinds |= {name: ((), dtype) for name, dtype in COUNTED.items()}
    for name, (shape, dtype) in kinds.items():
        group.create_array(
            escapes.get(name, name),
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


def _describe(group: Any, facts: Mapping[str, Any], grid: Grid, ts: np.ndarray, escapes: Mapping[str, str]) -> None:
    """Times, parameters and what a reader wants to know."""
    group.create_array("time", data=ts, dimension_names=("time",), attributes={"units": "s", "long_name": "time"})
    for name in grid.names:
        size = min(grid.n_runs, SLAB)
        word = escapes.get(name, name)
        array = group.create_array(word, shape=(grid.n_runs,), chunks=(size,), dtype="float64", dimension_names=(RUN,))
        for number, values in enumerate(grid.slabs(name)):
            array[number * SLAB : number * SLAB + len(values)] = values
    group.attrs.update({"facts": dict(facts)})


def _seal(path: Path, group: Any) -> str:
    """A digest of what describes the arrays: shapes, types, names, units, and the attributes of the store."""
    attributes = {name: value for name, value in group.attrs.items() if name != "seal"}
    digest = hashlib.sha256(json.dumps(attributes, sort_keys=True).encode())
    for name in sorted(group.array_keys()):
        digest.update(name.encode() + (path / name / "zarr.json").read_bytes())
    return digest.hexdigest()


def times_fingerprint(ts: np.ndarray) -> str:
    """A digest of sample times."""
    return hashlib.sha256(np.asarray(ts, np.float64).tobytes().hex().encode()).hexdigest()[:16]


_DIGESTS = {
    "grid": "its grid has other parameters or other values",
    "numbers": "its numbers that are not swept are others, e.g. a mass or a point of the scene",
    "times": "its sample times are others",
    "program": "its builder made other scenes of the same parameters, by another formula or with another law",
    "points": "its builder made other scenes of the same parameters",
    "functions": "a function in its record= computed something else",
}
"""What differs where only digests are compared."""

SINCE_FORMAT_2 = ("program", "points", "functions")

WHERE_ASKED_FOR = ("derivative_rtol",)
"""What is said of a sweep only where it was asked for."""


def _reopened(path: Path, identity) -> Store:
    group = opened(path)
    before = json.loads(group.attrs["identity"])
    now = json.loads(json.dumps(identity))
    if "format" not in group.attrs:
        now = {key: value for key, value in now.items() if key not in SINCE_FORMAT_2}
        warnings.warn(
            f"the store {str(path)!r} was written by an earlier version of spherejax, which compared the builder at "
            "one run alone and no code of functions: see to it yourself that neither has changed, or begin a new store",
            StoreWarning,
            stacklevel=5,
        )
    different = [key for key in (*now, *WHERE_ASKED_FOR) if before.get(key) != now.get(key)]
    if different:
        key = different[0]
        what = _DIGESTS.get(key, f"its {key} is {before.get(key)!r}, not {now.get(key)!r}")
        raise SceneError(
            f"{str(path)!r} is the store of another sweep: {what}. Choose another path, or ask for the same sweep to "
            "go on with it"
        )
    return Store(path, group)


def damaged(path: Path, what: str) -> SceneError:
    """The error for a store that is not what was written."""
    return SceneError(f"the store {str(path)!r} is damaged: {what}. Move it away and run the sweep again")


def _by_name(result: ChunkResult) -> dict[str, np.ndarray]:
    counted = {name: np.asarray(getattr(result, name), dtype) for name, dtype in COUNTED.items()}
    return {**result.kept, **counted}


def _digest(values: Mapping[str, np.ndarray], of_chunk: Mapping[str, float]) -> int:
    digest = hashlib.sha256()
    for name in sorted(values):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(values[name]).tobytes())
    for name, value in of_chunk.items():
        digest.update(name.encode() + np.asarray(value, OF_CHUNKS[name]).tobytes())
    # 63 bits, never zero: zero says that nothing is stored.
    return int.from_bytes(digest.digest()[:8], "big") >> 1 | 1

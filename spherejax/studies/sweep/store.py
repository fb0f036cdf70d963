"""Where a sweep keeps its results: a Zarr group, written chunk by chunk, from which a stopped sweep goes on.

A chunk counts as stored when its digest has been written, which is the last thing that is done. A chunk that was cut
off has none and is computed again. Digests are checked when a store is opened: what was damaged since is found.
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

COUNTED = {"status": np.int64, "t_reached": np.float64, "n_steps": np.int64, "n_rejected": np.int64}
"""What is stored of every run besides what was asked for."""

MARK = "spherejax sweep"


class Store:
    """The results of one sweep in a Zarr group.

    Attributes:
        path: the folder.
        n_runs: number of runs.
        chunk_size: runs in a chunk.
    """

    def __init__(self, path: Path, group: Any, n_runs: int, chunk_size: int):
        self.path, self.group = path, group
        self.n_runs, self.chunk_size = n_runs, chunk_size
        self.n_chunks = -(-n_runs // chunk_size)

    def runs_of(self, chunk: int) -> slice:
        """Indices of a chunk's runs."""
        return slice(chunk * self.chunk_size, min((chunk + 1) * self.chunk_size, self.n_runs))

    @property
    def names(self) -> list[str]:
        """What is stored of every run."""
        return [name for name in self.group.array_keys() if name not in ("digest", "seconds", "n_lane_steps")]

    def put(self, chunk: int, result: ChunkResult) -> None:
        """Store a chunk; its digest comes last."""
        runs, values = self.runs_of(chunk), _by_name(result)
        for name, array in values.items():
            self.group[name][runs] = array
        self.group["seconds"][chunk] = result.seconds
        self.group["n_lane_steps"][chunk] = result.n_lane_steps
        self.group["digest"][chunk] = _digest(values)

    def missing(self) -> list[int]:
        """Chunks that are not stored yet.

        Raises:
            SceneError: when a stored chunk is not what was written.
        """
        digests = np.asarray(self.group["digest"])
        return [chunk for chunk in range(self.n_chunks) if not self._is_stored(chunk, int(digests[chunk]))]

    def _is_stored(self, chunk: int, digest: int) -> bool:
        if digest == 0:
            return False
        try:
            values = {name: np.asarray(self.group[name][self.runs_of(chunk)]) for name in self.names}
        except Exception as error:
            raise _damaged(self.path, f"chunk {chunk} cannot be read ({error})") from error
        if _digest(values) != digest:
            raise _damaged(self.path, f"chunk {chunk} is not what was written")
        return True

    def values(self) -> dict[str, np.ndarray]:
        """Everything that is stored, by name, with a leading axis of runs."""
        return {name: np.asarray(self.group[name]) for name in self.names}

    def of_chunks(self, name: str) -> np.ndarray:
        """`seconds` or `n_lane_steps` of every chunk."""
        return np.asarray(self.group[name])


def open_store(
    path: Path,
    identity: Mapping[str, Any],
    shapes: Mapping[str, jax.ShapeDtypeStruct],
    n_runs: int,
    chunk_size: int,
) -> Store:
    """A new store, or the store of the same sweep.

    Args:
        path: folder, which does not exist or holds a store of this sweep.
        identity: what makes it the same sweep; compared entry by entry.
        shapes: of what is kept of one run.
        n_runs: number of runs.
        chunk_size: runs in a chunk; an existing store has its own.

    Raises:
        SceneError: for the store of another sweep, a damaged one, or a folder that is none.
    """
    if path.exists():
        return _reopened(path, identity, shapes, n_runs)
    return _made(path, identity, shapes, n_runs, chunk_size)


def stored_chunk_size(path: Path) -> int | None:
    """Runs in a chunk of an existing store; None where there is none."""
    if not path.exists():
        return None
    return int(_opened(path).attrs["chunk_size"])


def _made(path: Path, identity, shapes, n_runs: int, chunk_size: int) -> Store:
    import zarr

    # Made beside its place and moved there whole: a store that exists is complete.
    unfinished = path.with_name(path.name + ".unfinished")
    shutil.rmtree(unfinished, ignore_errors=True)
    try:
        group = zarr.open_group(unfinished, mode="w")
    except OSError as error:
        raise SceneError(f"cannot write {str(path)!r}: {error.strerror or error}") from error
    columns = {name: (each.shape, each.dtype) for name, each in shapes.items()}
    columns |= {name: ((), dtype) for name, dtype in COUNTED.items()}
    for name, (shape, dtype) in columns.items():
        empty = np.nan if np.issubdtype(dtype, np.floating) else -1
        group.create_array(
            name, shape=(n_runs, *shape), chunks=(chunk_size, *shape), dtype=np.dtype(dtype), fill_value=empty
        )
    n_chunks = -(-n_runs // chunk_size)
    for name, dtype in (("seconds", np.float64), ("n_lane_steps", np.int64), ("digest", np.uint64)):
        group.create_array(name, shape=(n_chunks,), chunks=(1,), dtype=np.dtype(dtype), fill_value=0)
    group.attrs.update({"mark": MARK, "identity": json.dumps(identity), "chunk_size": chunk_size})
    unfinished.rename(path)
    return Store(path, zarr.open_group(path, mode="r+"), n_runs, chunk_size)


def _reopened(path: Path, identity, shapes, n_runs: int) -> Store:
    group = _opened(path)
    before = json.loads(group.attrs["identity"])
    now = json.loads(json.dumps(identity))
    different = [key for key in now if before.get(key) != now[key]]
    if different:
        key = different[0]
        raise SceneError(
            f"{str(path)!r} is the store of another sweep: its {key} is {before.get(key)!r}, not {now[key]!r}. Choose "
            "another path, or ask for the same sweep to go on with it"
        )
    missing = [name for name in (*shapes, *COUNTED, "digest", "seconds", "n_lane_steps") if name not in group]
    if missing:
        raise _damaged(path, f"{missing[0]!r} is not there")
    return Store(path, group, n_runs, int(group.attrs["chunk_size"]))


def _opened(path: Path) -> Any:
    import zarr

    try:
        group = zarr.open_group(path, mode="r+")
        is_store = group.attrs.get("mark") == MARK and {"identity", "chunk_size"} <= set(group.attrs)
    except Exception as error:
        raise SceneError(f"{str(path)!r} exists and is no store of a sweep ({error}); choose another path") from error
    if not is_store:
        raise SceneError(f"{str(path)!r} exists and is no store of a sweep; choose another path")
    return group


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

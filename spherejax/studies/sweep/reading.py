"""The store of a sweep as a data set that is read where it is looked at, so that memory holds what is asked for."""

import math
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.studies.sweep.dataset import RUN, RunsColumn, SweepAccount, dataset_of
from spherejax.studies.sweep.failures import StoreWarning
from spherejax.studies.sweep.store import Store, opened

if TYPE_CHECKING:
    import xarray


def open_sweep(path: str | os.PathLike, *, verify: bool = True) -> "xarray.Dataset":
    """The results in the store of a sweep, finished or not.

    Arrays are read when they are looked at; `.load()` brings all of them into memory. Runs that had not been made when
    the store was opened have status -1 and no values (NaN).

    Args:
        path: folder that `sj.sweep(store=)` or `spherejax sweep --out` has written.

    Other args:
        verify: read everything once and compare it with the digests that were written with it: runs, times,
            parameters, units. That reads some hundred megabytes a second. Without it a `StoreWarning` says that nothing
            was compared.

    Returns:
        What `sj.sweep` returns.

    Raises:
        SceneError: where there is no such store; for one in which something is missing or not what was written.
    """
    path = Path(path).expanduser()
    if not path.exists():
        raise SceneError(f"there is no store {str(path)!r}")
    store = Store(path, opened(path, "r"))
    if not verify:
        warnings.warn(
            f"the store {str(path)!r} is read as it is: verify=False compares nothing with what was written",
            StoreWarning,
            stacklevel=2,
        )
    return dataset_in(store, store.read_through(verify=verify))


def dataset_in(store: Store, account: SweepAccount) -> "xarray.Dataset":
    """What a store holds, where `account` says that it is stored."""
    from xarray.core import indexing

    attrs, arrays = store.group.attrs, store.arrays
    dims, shape = tuple(attrs["grid_dims"]), tuple(attrs["grid_shape"])
    columns = {name: RunsColumn(_own_dims(arrays[name]), dict(arrays[name].attrs)) for name in store.names}
    on_disk: Any = _on_disk()
    lazy: Any = indexing

    def lazily(name: str) -> Any:
        array = on_disk(arrays[name], shape, account.is_stored, store.chunk_size)
        return lazy.CopyOnWriteArray(lazy.LazilyIndexedArray(array))

    values = {name: lazily(name) for name in columns}
    return dataset_of(dims, _coordinates(store, dims, shape), columns, values, attrs["facts"], account)


def _coordinates(store: Store, dims: tuple[str, ...], shape: tuple[int, ...]) -> dict[str, tuple]:
    arrays = store.arrays
    coordinates: dict[str, tuple] = {"time": ("time", np.asarray(arrays["time"]), dict(arrays["time"].attrs))}
    for name in store.group.attrs["parameters"]:
        if dims == (RUN,):
            coordinates[name] = (RUN, np.asarray(arrays[name]))
        else:
            # Along its own axis, from the first rows that have all of its values: 1e8 runs stay where they are.
            axis = dims.index(name)
            every = math.prod(shape[axis + 1 :])
            coordinates[name] = (name, np.asarray(arrays[name][: shape[axis] * every])[::every])
    return coordinates


def _own_dims(array: Any) -> tuple[str, ...]:
    return tuple(array.metadata.dimension_names[1:])


def _on_disk() -> Any:
    """The class of arrays that are read when they are looked at; xarray is imported when one is needed."""
    from xarray.backends import BackendArray
    from xarray.core.indexing import IndexingSupport, explicit_indexing_adapter

    class OnDisk(BackendArray):
        """An array of a store, its first axis, the runs, seen with the axes of the grid."""

        def __init__(self, array: Any, grid_shape: tuple[int, ...], is_stored: np.ndarray, chunk_size: int):
            self.array, self.grid_shape = array, grid_shape
            self.is_stored, self.chunk_size = is_stored, chunk_size
            self.shape, self.dtype = (*grid_shape, *array.shape[1:]), array.dtype

        def __getitem__(self, key):
            return explicit_indexing_adapter(key, self.shape, IndexingSupport.OUTER, self._read)

        def _read(self, key: tuple) -> np.ndarray:
            """Rows that are wanted, then what is wanted of them; each index belongs to its own axis."""
            n = len(self.grid_shape)
            runs = np.arange(self.array.shape[0]).reshape(self.grid_shape)
            for axis in reversed(range(n)):
                runs = runs[(slice(None),) * axis + (key[axis],)]
            wanted = runs.ravel()
            if wanted.size == 0:
                rows = np.empty((0, *self.array.shape[1:]), self.dtype)
            elif wanted[-1] - wanted[0] == wanted.size - 1 and np.all(np.diff(wanted) == 1):
                rows = self.array[int(wanted[0]) : int(wanted[-1]) + 1]
            else:
                rows = self.array.oindex[(wanted, *(slice(None),) * (self.array.ndim - 1))]
            cut_off = ~self.is_stored[wanted // self.chunk_size]
            if np.any(cut_off):
                # What a chunk has that was not written to its end is no result.
                rows = np.array(rows)
                rows[cut_off] = self.array.fill_value
            for axis in reversed(range(len(key) - n)):
                rows = rows[(slice(None),) * (axis + 1) + (key[n + axis],)]
            return rows.reshape((*runs.shape, *rows.shape[1:]))

    return OnDisk

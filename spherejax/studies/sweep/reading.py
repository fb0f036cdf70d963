"""The store of a sweep as a data set that is read where it is looked at, so that memory holds what is asked for."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spherejax.foundations.checks import SceneError
from spherejax.studies.sweep.dataset import RUN, Column, account_of, dataset_of
from spherejax.studies.sweep.store import Store, opened

if TYPE_CHECKING:
    import xarray


def open_sweep(path: str | os.PathLike) -> "xarray.Dataset":
    """The results in the store of a sweep, finished or not.

    Arrays are read when they are looked at; `.load()` brings all of them into memory. Runs that have not been made yet
    have status -1 and no values (NaN).

    Args:
        path: folder that `sj.sweep(store=)` or `spherejax sweep --out` has written.

    Returns:
        What `sj.sweep` returns.

    Raises:
        SceneError: where there is no such store.
    """
    path = Path(path).expanduser()
    if not path.exists():
        raise SceneError(f"there is no store {str(path)!r}")
    return dataset_in(Store(path, opened(path, "r")))


def dataset_in(store: Store) -> "xarray.Dataset":
    """What a store holds."""
    from xarray.core import indexing

    attrs, arrays = store.group.attrs, store.arrays
    dims, shape = tuple(attrs["grid_dims"]), tuple(attrs["grid_shape"])
    columns = {name: Column(_own_dims(arrays[name]), dict(arrays[name].attrs)) for name in store.names}
    on_disk: Any = _on_disk()
    lazy: Any = indexing
    values = {name: lazy.CopyOnWriteArray(lazy.LazilyIndexedArray(on_disk(arrays[name], shape))) for name in columns}
    account = account_of(*(store.of_all(name) for name in ("n_steps", "seconds", "n_lane_steps")))
    return dataset_of(dims, _coordinates(store, dims, shape), columns, values, {**attrs["facts"], **account})


def _coordinates(store: Store, dims: tuple[str, ...], shape: tuple[int, ...]) -> dict[str, tuple]:
    arrays = store.arrays
    coordinates: dict[str, tuple] = {"time": ("time", np.asarray(arrays["time"]), dict(arrays["time"].attrs))}
    for name in store.group.attrs["parameters"]:
        values = np.asarray(arrays[name])
        if dims == (RUN,):
            coordinates[name] = (RUN, values)
        else:
            axis = dims.index(name)
            along = values.reshape(shape)[(0,) * axis + (slice(None),) + (0,) * (len(dims) - axis - 1)]
            coordinates[name] = (name, along)
    return coordinates


def _own_dims(array: Any) -> tuple[str, ...]:
    return tuple(array.metadata.dimension_names[1:])


def _on_disk() -> Any:
    """The class of arrays that are read when they are looked at; xarray is imported when one is needed."""
    from xarray.backends import BackendArray
    from xarray.core.indexing import IndexingSupport, explicit_indexing_adapter

    class OnDisk(BackendArray):
        """An array of a store, its first axis, the runs, seen with the axes of the grid."""

        def __init__(self, array: Any, grid_shape: tuple[int, ...]):
            self.array, self.grid_shape = array, grid_shape
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
            for axis in reversed(range(len(key) - n)):
                rows = rows[(slice(None),) * (axis + 1) + (key[n + axis],)]
            return rows.reshape(*runs.shape, *rows.shape[1:])

    return OnDisk

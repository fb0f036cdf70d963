"""Data sets as plain HDF5: a dataset for each variable and coordinate, with units and names as attributes.

Dimensions are HDF5's own: each has its name as label, and its coordinate attached as scale, so that tools that know
nothing of xarray (h5py, MATLAB, HDFView, Julia) find what belongs together.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import xarray

COORDINATE = "is_coordinate"
"""Attribute of what is a coordinate."""


def write_hdf5(dataset: "xarray.Dataset", path: Path) -> None:
    """Write a data set."""
    import h5py

    with h5py.File(path, "w") as opened:
        file: Any = opened
        file.attrs.update({str(name): _attribute(value) for name, value in dataset.attrs.items()})
        for name, variable in dataset.variables.items():
            made = file.create_dataset(str(name), data=_values(np.asarray(variable)))
            made.attrs.update({str(key): _attribute(value) for key, value in variable.attrs.items()})
            if name in dataset.coords:
                made.attrs[COORDINATE] = True
        for dim in dataset.dims:
            if dim in dataset.coords:
                file[str(dim)].make_scale(str(dim))
        for name, variable in dataset.variables.items():
            for axis, dim in enumerate(variable.dims):
                file[str(name)].dims[axis].label = str(dim)
                if dim in dataset.coords and dim != name:
                    file[str(name)].dims[axis].attach_scale(file[str(dim)])


def read_hdf5(path: Path) -> "xarray.Dataset":
    """Read what `write_hdf5` wrote.

    Raises:
        OSError, ValueError: for a file that is none, or has no such dimensions.
    """
    import h5py
    import xarray

    variables, coordinates = {}, {}
    with h5py.File(path, "r") as file:
        for name, item in file.items():
            if not isinstance(item, h5py.Dataset):
                raise ValueError(f"{name!r} is a group")
            dims = tuple(dim.label for dim in item.dims)
            if not all(dims):
                raise ValueError(f"the dimensions of {name!r} have no names")
            attributes = {key: _plain(value) for key, value in item.attrs.items() if key not in _OWN}
            values: Any = item.asstr()[()] if h5py.check_string_dtype(item.dtype) else item[()]
            found = coordinates if item.attrs.get(COORDINATE, False) else variables
            found[name] = (dims, np.asarray(values, str) if _is_text(item) else values, attributes)
        return xarray.Dataset(variables, coordinates, {key: _plain(value) for key, value in file.attrs.items()})


_OWN = (COORDINATE, "CLASS", "NAME", "DIMENSION_LIST", "DIMENSION_LABELS", "REFERENCE_LIST")


def _is_text(item: Any) -> bool:
    import h5py

    return h5py.check_string_dtype(item.dtype) is not None


def _values(values: np.ndarray) -> np.ndarray:
    return values.astype(object) if values.dtype.kind == "U" else values


def _attribute(value: Any) -> Any:
    return value if isinstance(value, str) else _values(np.asarray(value))


def _plain(value: Any) -> Any:
    array = np.asarray(value)
    return array.item() if array.ndim == 0 else array.tolist() if array.dtype.hasobject else value

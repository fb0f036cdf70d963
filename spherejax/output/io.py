"""Files: netCDF and CSV of data sets, read back by any tool that knows these formats."""

import csv
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.motion.results.dataset import to_dataset
from spherejax.motion.results.trajectory import Trajectory

if TYPE_CHECKING:
    import xarray

SUFFIXES = (".nc", ".csv")
"""What can be written: netCDF 4 (everything, with attributes) and CSV (what depends on time)."""


def save(result: "Trajectory | xarray.Dataset", path: str | os.PathLike, *, overwrite: bool = False) -> Path:
    """Write a run or a data set; the suffix of the path decides the format.

    `.nc` is netCDF 4 with all attributes. `.csv` is a table with one row for each sample (of `run.impacts`, each
    contact) and one column for each number, named with its unit, e.g. `position rocker z [m]`. Missing folders are
    made.

    Args:
        result: a run, or a data set.
        path: where to write.
        overwrite: replace an existing file.

    Returns:
        The path.

    Raises:
        SceneError: for another suffix, for an existing file without `overwrite`, or where nothing can be
        written.
    """
    path = writable(path, overwrite=overwrite)
    dataset = to_dataset(result) if isinstance(result, Trajectory) else result
    try:
        if path.suffix == ".nc":
            dataset.to_netcdf(path, engine="h5netcdf")
        else:
            _write_csv(dataset, path)
    except ImportError as error:
        raise SceneError(f"cannot write netCDF: {error}; or write a table (.csv)") from error
    except OSError as error:
        raise SceneError(f"cannot write {str(path)!r}: {error.strerror or error}") from error
    return path


def load(path: str | os.PathLike) -> "xarray.Dataset":
    """Read a netCDF file that `save` wrote, into memory.

    Raises:
        SceneError: for a file that does not exist or is no netCDF file.
    """
    import xarray

    path = Path(path)
    if not path.is_file():
        raise SceneError(f"there is no file {str(path)!r}")
    if path.suffix != ".nc":
        raise SceneError(
            f"load reads netCDF files (.nc), and {str(path)!r} is none; read a CSV file with any table reader"
        )
    try:
        return xarray.load_dataset(path, engine="h5netcdf")
    except (OSError, ValueError) as error:
        raise SceneError(f"{str(path)!r} is no readable netCDF file: {error}") from error


def writable(path: str | os.PathLike, *, overwrite: bool = False) -> Path:
    """The path, with its folder made; an error when it must not or cannot be written.

    Called before a long run, so that a wrong path does not cost the run.

    Raises:
        SceneError: as `save`.
    """
    path = Path(path).expanduser()
    if path.suffix not in SUFFIXES:
        raise SceneError(f"{str(path)!r}: the suffix {path.suffix!r} names no format; use {' or '.join(SUFFIXES)}")
    require_free(path, overwrite=overwrite)
    make_folder(path.parent)
    return path


def require_free(path: Path, *, overwrite: bool) -> None:
    """Raise `SceneError` when a file exists and must not be replaced."""
    if path.exists() and not overwrite:
        raise SceneError(
            f"{str(path)!r} exists; choose another name, or ask to overwrite it (overwrite=True, --overwrite)"
        )


def make_folder(folder: Path) -> None:
    """Make a folder and those above it.

    Raises:
        SceneError: where that is not possible.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SceneError(f"cannot make the folder {str(folder)!r}: {error.strerror or error}") from error


def _write_csv(dataset: "xarray.Dataset", path: Path) -> None:
    along = "time" if "time" in dataset.dims else str(next(iter(dataset.dims)))
    names, columns = ["time [s]" if along == "time" else along], [np.asarray(dataset[along])]
    for name, variable in dataset.data_vars.items():
        if not variable.dims or variable.dims[0] != along:
            continue
        labels = [[str(label) for label in np.asarray(dataset[dim])] for dim in variable.dims[1:]]
        flat = np.asarray(variable).reshape(variable.shape[0], -1)
        for column, index in enumerate(np.ndindex(*variable.shape[1:])):
            words = [str(name), *(labels[axis][i] for axis, i in enumerate(index))]
            names.append(f"{' '.join(words)} [{variable.attrs.get('units', '')}]")
            columns.append(flat[:, column])
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        # repr of a float64 is the shortest text that reads back as the same number.
        texts = [[repr(value.item()) for value in column] for column in columns]
        writer.writerows(zip(*texts, strict=True))

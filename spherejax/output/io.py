"""Files: netCDF, Zarr, HDF5 and CSV of data sets, read back by any tool that knows these formats."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spherejax.files.paths.drafts import draft_of
from spherejax.foundations.errors import SceneError
from spherejax.motion.results.dataset import to_dataset
from spherejax.motion.results.trajectory import Trajectory
from spherejax.output.escapes import escaped, unescaped
from spherejax.output.hdf5 import read_hdf5, write_hdf5
from spherejax.output.paths import SUFFIXES, writable
from spherejax.output.tables import write_csv
from spherejax.output.wholeness import check_hdf5_is_whole, check_store_is_whole

if TYPE_CHECKING:
    import xarray


def save(result: "Trajectory | xarray.Dataset | Any", path: str | os.PathLike, *, overwrite: bool = False) -> Path:
    """Write a run, a data set, or the result of a study; the suffix of the path decides the format.

    The file is written under another name and renamed when it is complete: a part of a file is never there.

    `.nc` is netCDF 4, `.zarr` a Zarr store (a folder), `.h5` or `.hdf5` plain HDF5 with names and units as attributes
    and dimensions as scales; each has everything. `.csv` is a table with one row for each sample (of `run.impacts`,
    each contact; of a sweep, each run, or each run's samples) and one column for each number, named with its unit, e.g.
    `position rocker z [m]`; what has no rows, such as names of methods, is not in it. Missing folders are made.

    In `.nc`, `.zarr` and HDF5 a slash separates groups. The name of a quantity that has one, e.g. `front/left.length`
    of a force element `front/left`, is written with `%2F` in its place; the attribute `escaped_names` of the file holds
    the names as they were, and `load` restores them.

    Args:
        result: a run, a data set, or what has a `to_xarray()`: a fit, sensitivities, a linearization, a budget.
        path: where to write.
        overwrite: replace an existing file.

    Returns:
        The path.

    Raises:
        SceneError: for another suffix, for an existing file without `overwrite`, or where nothing can be
        written.
    """
    path = writable(path, overwrite=overwrite)
    dataset = _dataset(result)
    if path.suffix == ".zarr":
        _check_replaced_store(path)
    try:
        if path.suffix == ".csv":
            write_csv(dataset, path)
            return path
        with draft_of(path) as draft:
            if path.suffix == ".nc":
                escaped(dataset).to_netcdf(draft, engine="h5netcdf")
            elif path.suffix == ".zarr":
                # Version 2 is what every reader knows; in version 3 texts have no specification yet.
                escaped(dataset).to_zarr(draft, mode="w", zarr_format=2)
            else:
                write_hdf5(escaped(dataset), draft)
    except ImportError as error:
        raise SceneError(f"cannot write {path.suffix}: {error}; or write a table (.csv)") from error
    except OSError as error:
        raise SceneError(f"cannot write {str(path)!r}: {error.strerror or error}") from error
    return path


def load(path: str | os.PathLike) -> "xarray.Dataset":
    """Read a netCDF file, a Zarr store or an HDF5 file that `save` wrote, into memory.

    Raises:
        SceneError: for a file that does not exist or is none of these; for one that takes bytes from other files
            (external storage, external links, virtual datasets, symbolic links in a store) or names a codec that runs
            code (pickle): the numbers would not be those of the file.
    """
    import xarray

    path = Path(path)
    if not path.exists() or (path.is_dir() and path.suffix != ".zarr"):
        raise SceneError(f"there is no file {str(path)!r}")
    kind = SUFFIXES.get(path.suffix, "")
    if path.suffix == ".csv" or not kind:
        raise SceneError(
            f"load reads netCDF files (.nc), Zarr stores (.zarr) and HDF5 (.h5, .hdf5), and {str(path)!r} is none; "
            "read a CSV file with any table reader"
        )
    try:
        if path.suffix == ".zarr":
            check_store_is_whole(path)
            return unescaped(xarray.load_dataset(path, engine="zarr"))
        check_hdf5_is_whole(path)
        return unescaped(xarray.load_dataset(path, engine="h5netcdf") if path.suffix == ".nc" else read_hdf5(path))
    except (OSError, ValueError, KeyError, RuntimeError, TypeError, AttributeError) as error:
        raise SceneError(f"{str(path)!r} is no readable file of this kind ({kind}): {error}") from error


def _dataset(result: Any) -> "xarray.Dataset":
    import xarray

    if isinstance(result, xarray.Dataset):
        return result
    if isinstance(result, Trajectory):
        return to_dataset(result)
    if not callable(getattr(result, "to_xarray", None)):
        raise SceneError(f"save: a {type(result).__name__} is no run, no data set, and has no to_xarray()")
    found = result.to_xarray()
    return found.to_dataset(name=found.name or "values") if isinstance(found, xarray.DataArray) else found


def _check_replaced_store(path: Path) -> None:
    """Raise `SceneError` for a folder that is no Zarr store, or that of a sweep."""
    if not path.exists():
        return
    import zarr

    if path.is_file() or not any((path / name).exists() for name in ("zarr.json", ".zgroup")):
        raise SceneError(f"{str(path)!r} exists and is no Zarr store; it is not replaced. Choose another name")
    if (path / "zarr.json").exists() and "identity" in zarr.open_group(path, mode="r").attrs:
        raise SceneError(f"{str(path)!r} is the store of a sweep; it is not replaced. Choose another name")

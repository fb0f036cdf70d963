"""Paths that are written to: judged before anything is computed, and before anything is imported that takes long."""

import os
import re
from pathlib import Path

from spherejax.foundations.errors import SceneError, one_of

SUFFIXES = {
    ".nc": "netCDF 4",
    ".zarr": "a Zarr store",
    ".h5": "plain HDF5",
    ".hdf5": "plain HDF5",
    ".csv": "a table, with units in its head",
}
"""What can be written: everything, with attributes, but for the table, which holds what has rows."""


def writable(path: str | os.PathLike, *, overwrite: bool = False) -> Path:
    """The path, with its folder made; an error when it must not or cannot be written.

    Called before a long run, so that a wrong path does not cost the run.

    Raises:
        SceneError: as `save`.
    """
    path = Path(path).expanduser()
    if path.suffix not in SUFFIXES:
        raise SceneError(f"{str(path)!r}: the suffix {path.suffix!r} names no format; {one_of(SUFFIXES, path.suffix)}")
    require_free(path, overwrite=overwrite)
    make_folder(path.parent)
    return path


def file_name(name: str) -> str:
    """A quantity's name as a part of a file's name: slashes, dots, spaces and the like become underscores."""
    return re.sub(r"[^\w-]", "_", name)


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

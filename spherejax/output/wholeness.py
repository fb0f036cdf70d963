"""Files that hold their numbers themselves: HDF5 and Zarr can point to bytes of other files, which `load` refuses."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any


def check_hdf5_is_whole(path: Path) -> None:
    """Raise `ValueError` where an HDF5 or netCDF 4 file takes numbers from other files.

    HDF5 opens them by path: a file from a stranger would give bytes of any file that its reader may read, as numbers.
    """
    import h5py

    with h5py.File(path, "r") as file:
        groups: list[tuple[str, Any]] = [("/", file)]
        seen = {_address(file)}
        for place, group in groups:  # grows while it is walked
            for name in group:
                where = f"{place}{name}"
                link = group.get(name, getlink=True)
                if isinstance(link, h5py.ExternalLink):
                    raise ValueError(f"{where!r} is a link to another file, {link.filename!r}, which is not followed")
                if isinstance(link, h5py.SoftLink) and link.path not in file:
                    raise ValueError(f"{where!r} is a link that leads nowhere, to {link.path!r}")
                item = group[name]
                if isinstance(item, h5py.Dataset):
                    _check_dataset(where, item)
                elif isinstance(item, h5py.Group) and _address(item) not in seen:
                    seen.add(_address(item))
                    groups.append((f"{where}/", item))


def _check_dataset(where: str, dataset: Any) -> None:
    if dataset.external:
        names = ", ".join(repr(str(name)) for name, *_ in dataset.external)
        raise ValueError(f"{where!r} keeps its numbers in other files ({names}), which are not read")
    if dataset.is_virtual:
        raise ValueError(f"{where!r} is a virtual dataset, put together from other files, which are not read")


def _address(group: Any) -> tuple[int, int]:
    from h5py import h5o  # pyright: ignore[reportAttributeAccessIssue]

    found = h5o.get_info(group.id)
    return found.fileno, found.addr


def check_store_is_whole(path: Path) -> None:
    """Raise `ValueError` where a Zarr store takes bytes from elsewhere, or names a codec that runs code.

    A symbolic link in it gives bytes of another file as numbers. Pickles may be code that is run when they are read;
    numcodecs refuses them itself only in its newest versions.
    """
    for entry in _entries(path):
        if entry.is_symlink():
            raise ValueError(f"{os.path.relpath(entry.path, path)!r} is a symbolic link, which is not followed")
        if entry.name in (".zarray", ".zmetadata", "zarr.json"):
            try:
                # Bytes, as zarr gives them to this reader: a text may be UTF-16 as well.
                metadata = json.loads(Path(entry.path).read_bytes())
            except ValueError:  # zarr cannot read it either, and whoever reads says what is damaged
                continue
            if _names_pickle(metadata):
                raise ValueError(
                    f"{os.path.relpath(entry.path, path)!r} says that values are stored as pickles, which may be code; "
                    "write the store anew with numbers and texts alone"
                )


def _entries(folder: Path | str) -> Iterator[os.DirEntry[str]]:
    with os.scandir(folder) as entries:
        for entry in entries:
            yield entry
            if entry.is_dir(follow_symlinks=False):
                yield from _entries(entry.path)


_OF_CODECS = ("codecs", "compressor", "filters", "object_codec")


def _names_pickle(described: Any, *, is_codec: bool = False) -> bool:
    if isinstance(described, dict):
        names = (described.get("id"), described.get("name")) if is_codec else ()
        if any(isinstance(name, str) and "pickle" in name.lower() for name in names):
            return True
        return any(_names_pickle(part, is_codec=is_codec or key in _OF_CODECS) for key, part in described.items())
    return isinstance(described, list) and any(_names_pickle(part, is_codec=is_codec) for part in described)

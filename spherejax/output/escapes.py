"""Names that a file format cannot hold, escaped so that they can be restored.

netCDF, HDF5 and Zarr take a slash for a separator of groups; a scene may have a joint `front/left`.
"""

import json
import re
from collections.abc import Hashable, Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray

RENAMED = "escaped_names"
"""Attribute of a data set: the names as they were, by those in the file, in JSON."""

_UNFIT = re.compile(r"[/\\\x00-\x1f\x7f]|^\s|\s$|^\.+$|^\.z|^$")
"""Separators, control characters, spaces at the ends (refused by netCDF), `.` and `..` (paths), Zarr's own files."""


def escapes_of(names: Iterable[str]) -> dict[str, str]:
    """The names to be written by the names as they are, of those that must be escaped: `a/b` as `a%2Fb`."""
    names = list(dict.fromkeys(names))
    made: dict[str, str] = {}
    for name in names:
        if not _UNFIT.search(name):
            continue
        word = _UNFIT.sub(lambda found: "".join(f"%{ord(letter):02X}" for letter in found[0]) or "%", name)
        while word in names or word in made.values():
            word += "%"
        made[name] = word
    return made


def escaped(dataset: "xarray.Dataset") -> "xarray.Dataset":
    """The data set with names that every format holds; an attribute says what they were."""
    made = escapes_of(str(name) for name in (*dataset.variables, *dataset.dims))
    if not made:
        return dataset
    original = json.dumps({word: name for name, word in made.items()}, ensure_ascii=False)
    return _renamed(dataset, made).assign_attrs({RENAMED: original})


def unescaped(dataset: "xarray.Dataset") -> "xarray.Dataset":
    """The data set with the names that `escaped` replaced.

    Raises:
        ValueError: for an attribute that is not what `escaped` wrote.
    """
    if RENAMED not in dataset.attrs:
        return dataset
    attributes = dict(dataset.attrs)
    original = json.loads(attributes.pop(RENAMED))
    if not isinstance(original, dict) or not all(isinstance(name, str) for name in original.values()):
        raise ValueError(f"the attribute {RENAMED!r} holds no names")
    known = {str(name) for name in (*dataset.variables, *dataset.dims)}
    found = _renamed(dataset, {word: name for word, name in original.items() if word in known})
    found.attrs = attributes
    return found


def _renamed(dataset: "xarray.Dataset", names: dict[str, str]) -> "xarray.Dataset":
    changed: dict[Hashable, Hashable] = {**names}
    return dataset.rename(changed)

"""Data sets as tables (CSV): a row for each sample, or each run, and a column for each number, with its unit."""

import csv
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spherejax.files.paths.drafts import draft_of
from spherejax.foundations.errors import SceneError

if TYPE_CHECKING:
    import xarray

Column = tuple[str, np.ndarray]


def write_csv(dataset: "xarray.Dataset", path: Path) -> None:
    """Write a data set as a table.

    Rows run over the dimensions that count or measure (`time`, the numbers of a sweep, `run`), the last fastest;
    columns over those that name (bodies, axes). What has none of the dimensions of the rows is not in the table. Where
    a data set only names, rows run over its first dimension.

    Raises:
        SceneError: for a data set of single numbers, which is no table.
    """
    dims = _rows(dataset)
    if not dims:
        raise SceneError(f"{str(path)!r}: single numbers are no table; write them as .nc, .zarr or .h5")
    columns = [*_places(dataset, dims), *_columns(dataset, dims)]
    rows = zip(*([_text(value) for value in values] for _, values in columns), strict=True)
    write_rows(path, [name for name, _ in columns], rows)


def write_rows(path: Path, heads: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a CSV file: a line of heads, then a line for each row; whole or not at all.

    Raises:
        OSError: where nothing can be written.
    """
    with draft_of(path) as draft, draft.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(heads)
        writer.writerows(rows)


def _rows(dataset: "xarray.Dataset") -> list[str]:
    variables = [[str(dim) for dim in variable.dims] for variable in dataset.data_vars.values() if variable.dims]
    leading = [dims[0] for dims in variables]
    if not leading or "time" in leading:
        return leading[:1] and ["time"]
    if not _counts(dataset, leading[0]):
        return leading[:1]
    beside = {dim for dims in variables if leading[0] in dims for dim in dims}
    return [str(dim) for dim in dataset.dims if dim in beside and _counts(dataset, str(dim))]


def _counts(dataset: "xarray.Dataset", dim: str) -> bool:
    """Whether a dimension counts or measures, and does not name."""
    return dim not in dataset.coords or dataset[dim].dtype.kind in "fiub"


def _places(dataset: "xarray.Dataset", rows: list[str]) -> Iterator[Column]:
    """Where each row is: the coordinates of its dimensions, and what else is known along these alone."""
    shape = tuple(dataset.sizes[dim] for dim in rows)
    for dim in rows:
        values = dataset[dim] if dim in dataset.coords else np.arange(dataset.sizes[dim])
        place = [dataset.sizes[dim] if each == dim else 1 for each in rows]
        yield _head(dataset, dim), np.broadcast_to(np.asarray(values).reshape(place), shape).ravel()
    for name, variable in dataset.coords.items():
        if str(name) not in rows and variable.dims and all(dim in rows for dim in variable.dims):
            yield _head(dataset, str(name)), _spread(variable, rows, shape).ravel()


def _columns(dataset: "xarray.Dataset", rows: list[str]) -> Iterator[Column]:
    shape = tuple(dataset.sizes[dim] for dim in rows)
    for name, variable in dataset.data_vars.items():
        if not any(dim in rows for dim in variable.dims):
            continue
        naming = [dim for dim in variable.dims if dim not in rows]
        labels = [[str(label) for label in _labels(dataset, dim)] for dim in naming]
        values = _spread(variable, rows, shape).reshape(int(np.prod(shape)), -1)
        unit = variable.attrs.get("units", "")
        for column, index in enumerate(np.ndindex(*(dataset.sizes[dim] for dim in naming))):
            words = " ".join([str(name), *(labels[axis][i] for axis, i in enumerate(index))])
            one = values[:, column]
            if np.iscomplexobj(one):
                yield _with_unit(f"Re {words}", unit), np.real(one)
                yield _with_unit(f"Im {words}", unit), np.imag(one)
            else:
                yield _with_unit(words, unit), one


def _spread(variable: Any, rows: list[str], shape: tuple[int, ...]) -> np.ndarray:
    """The values with the dimensions of the rows in front, repeated along those that it has not."""
    naming = [dim for dim in variable.dims if dim not in rows]
    own = [dim for dim in rows if dim in variable.dims]
    values = np.asarray(variable.transpose(*own, *naming))
    inner = values.shape[len(own) :]
    place = [n if dim in own else 1 for dim, n in zip(rows, shape, strict=True)]
    return np.broadcast_to(values.reshape(*place, *inner), (*shape, *inner))


def _labels(dataset: "xarray.Dataset", dim: Any) -> np.ndarray:
    return np.asarray(dataset[dim]) if dim in dataset.coords else np.arange(dataset.sizes[dim])


def _head(dataset: "xarray.Dataset", name: str) -> str:
    unit = "s" if name == "time" else dataset[name].attrs.get("units", "") if name in dataset.coords else ""
    return _with_unit(name, "" if unit == "1" else unit)  # a number that was swept, or one that counts


def _with_unit(words: str, unit: str) -> str:
    return f"{words} [{unit}]" if unit else words


def _text(value: Any) -> str:
    plain = value.item() if isinstance(value, np.generic) else value
    # repr of a float64 is the shortest text that reads back as the same number.
    return plain if isinstance(plain, str) else repr(plain)

"""Tables of measurements: CSV files.

The first row names the columns: `time`, and observables like `position.rocker.z`. Units may follow in brackets,
`position.rocker.z [mm]`; without them they are SI units. What `sj.save` writes (`position rocker z [m]`) is read as
well, without the run's own errors (violations of constraints). Columns are separated by commas, semicolons or tabs.
Empty cells and NaN stand for what was not measured; lines that are empty or begin with # are passed over.

A file with names of its own is read by a mapping from them to observables, `{"height": "position.rocker.z [mm]"}`;
columns that it does not name are left out.
"""

import csv
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.units.number_texts import NumberError, number_in
from spherejax.foundations.units.units import UnitError, factor_of
from spherejax.motion.equations.quantities import OF_BODIES, OF_JOINTS, OF_THE_WHOLE

MISSING = {"", "nan", "na", "n/a", "null", "none", "-"}
TIMES = {"time", "t"}
WITH_UNIT = re.compile(r"^(?P<name>.*?)\s*\[(?P<unit>[^\]]*)\]$")


class MeasuredTable(NamedTuple):
    """A table of measurements.

    Attributes:
        columns: by name, in SI units, `time` among them.
        units: in which the file has those that are not in SI units, by name.
    """

    columns: dict[str, np.ndarray]
    units: dict[str, str]


def read_table(path: Path, columns: Mapping[str, str] | None = None) -> MeasuredTable:
    """The columns of a table.

    Args:
        path: of the file.
        columns: observables, with units in brackets, by the names that the file has for them; a column whose own head
            names a unit needs none. None: the file names observables itself.

    Raises:
        SceneError: for a file that cannot be read, naming the line and the column.
    """
    lines = lines_of(path)
    number, head = lines[0]
    chosen = list(range(len(head)))
    if columns is not None:
        head, chosen = _renamed(head, columns, path, number)
    names, factors, units = _columns(head, path, number)
    rows = []
    for number, cells in lines[1:]:
        if len(cells) != len(lines[0][1]):
            raise SceneError(
                f"{path.name}:{number}: {len(cells)} cells in a row, but the head (line {lines[0][0]}) names "
                f"{len(lines[0][1])} columns"
            )
        rows.append([_number(cells[at], path, number, name) for at, name in zip(chosen, names, strict=True)])
    if not rows:
        raise SceneError(f"{path.name}: no measurements below the head")
    table = np.array(rows) * factors
    missing = np.isnan(table[:, names.index("time")])
    if missing.any():
        raise SceneError(f"{path.name}:{lines[1 + int(np.argmax(missing))][0]}: the time is missing")
    kept = {name: column for name, column in zip(names, table.T, strict=True) if not name.endswith("_violation")}
    return MeasuredTable(kept, {name: unit for name, unit in units.items() if name in kept})


def lines_of(path: Path) -> list[tuple[int, list[str]]]:
    """Numbered rows of cells, without comments and empty lines."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise SceneError(f"{str(path)!r} is no text file: {error}") from error
    except OSError as error:
        raise SceneError(f"cannot read {str(path)!r}: {error.strerror or error}") from error
    kept = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")]
    if not kept:
        raise SceneError(f"{str(path)!r} is empty: the first row must name the columns, time first")
    head = kept[0][1]
    separator = max((";", "\t", ","), key=head.count)
    cells = csv.reader((line for _, line in kept), delimiter=separator, skipinitialspace=True)
    return [(i, [cell.strip() for cell in row]) for (i, _), row in zip(kept, cells, strict=False)]


def _renamed(head: list[str], columns: Mapping[str, str], path: Path, number: int) -> tuple[list[str], list[int]]:
    """The heads of the columns that are read, by the names of observables, and where they stand."""
    bare = [found["name"] if (found := WITH_UNIT.match(cell)) else cell for cell in head]
    renamed, chosen = [], []
    for own, observable in columns.items():
        at = [i for i, cell in enumerate(head) if own in (cell, bare[i])]
        if len(at) != 1:
            what = one_of(bare, own) if not at else f"{len(at)} columns have that name"
            raise SceneError(f"{path.name}:{number}: there is no column {own!r}; {what}")
        unit = WITH_UNIT.match(head[at[0]])
        has_unit = WITH_UNIT.match(observable) is not None
        renamed.append(observable if has_unit or unit is None else f"{observable} [{unit['unit']}]")
        chosen.append(at[0])
    if not any(name.partition(" [")[0].lower() in TIMES for name in renamed):
        for i, name in enumerate(bare):
            if name.lower() in TIMES and i not in chosen:
                return ["time" + head[i][len(name) :], *renamed], [i, *chosen]
    return renamed, chosen


def _columns(head: list[str], path: Path, number: int) -> tuple[list[str], np.ndarray, dict[str, str]]:
    """Names of the columns, what their numbers are multiplied by, and the units of those that are not in SI units."""
    names, factors, units = [], [], {}
    for cell in head:
        found = WITH_UNIT.match(cell)
        name, unit = (found["name"], found["unit"].strip()) if found else (cell, "")
        name = "time" if name.lower() in TIMES else ".".join(name.split())
        if not name:
            raise SceneError(f"{path.name}:{number}: a column has no name")
        if "[" in name or "]" in name:
            raise SceneError(f"{path.name}:{number}: {cell!r}: write the name, then one unit in brackets, e.g. x [mm]")
        if name in names:
            raise SceneError(f"{path.name}:{number}: two columns are named {name!r}")
        if _is_number(name):
            raise SceneError(
                f"{path.name}:{number}: {cell!r} is a number: the first row must name the columns, e.g. "
                "time,position.rocker.z"
            )
        names.append(name)
        try:
            factors.append(_factor(name, unit))
            if factors[-1] != 1.0:
                units[name] = unit
        except UnitError as error:
            raise SceneError(f"{path.name}:{number}: column {name!r}: {error}") from error
    if "time" not in names:
        raise SceneError(f"{path.name}:{number}: no column is named time; there are {', '.join(map(repr, names))}")
    return names, np.array(factors), units


def _factor(name: str, unit: str) -> float:
    """From the unit of a column to SI units."""
    kinds = {**OF_BODIES, **OF_JOINTS, **OF_THE_WHOLE}
    kind = name.partition(".")[0]
    expected = "s" if name == "time" else kinds[kind][1] if kind in kinds else None
    if unit in ("", expected) or (expected is not None and " or " in expected):
        return 1.0
    return factor_of(unit, expected)


def _number(cell: str, path: Path, number: int, name: str) -> float:
    if cell.lower() in MISSING:
        return np.nan
    try:
        return number_in(cell)
    except NumberError as error:
        raise SceneError(f"{path.name}:{number}: column {name!r}: {error}") from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True

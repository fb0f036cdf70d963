"""Measured road profiles from tables."""

import os
from pathlib import Path

import numpy as np

from spherejax.foundations.checks import shown
from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.units.number_texts import NumberError, number_in
from spherejax.foundations.units.units import UnitError, factor_of
from spherejax.physics.functions.tables import SmoothTable
from spherejax.studies.fit.table import WITH_UNIT, lines_of

COLUMNS = ("x", "z")


def load_road(path: str | os.PathLike, *, spacing: float | None = None) -> SmoothTable:
    """A measured profile as a road: cubics through its points, for `sj.forces.Tyre(road=...)`.

        x [m], z [mm]
        0.00, 0.0
        0.05, 1.2

    Args:
        path: a CSV file with columns x, the way, and z, the height; units in brackets, or in meters.

    Other args:
        spacing: the profile is averaged over windows of this length, one after the other [m]. A table is searched
            point by point: a profile of ten thousand points costs as much as the suspension. None: as it is.

    Raises:
        SceneError: for a table that cannot be read, with file and line, or a way that does not increase.
    """
    file = Path(path).expanduser()
    lines = lines_of(file)
    number, head = lines[0]
    places: dict[str, tuple[int, float]] = {}
    for at, cell in enumerate(head):
        found = WITH_UNIT.match(cell)
        name, unit = (found["name"].strip().lower(), found["unit"].strip()) if found else (cell.strip().lower(), "m")
        if name not in COLUMNS:
            raise SceneError(f"{file.name}:{number}: column {cell!r} is none of a road; {one_of(COLUMNS, name)}")
        try:
            places[name] = at, factor_of(unit, "m")
        except UnitError as error:
            raise SceneError(f"{file.name}:{number}: column {name!r}: {error}") from error
    missing = [name for name in COLUMNS if name not in places]
    if missing:
        raise SceneError(f"{file.name}:{number}: there is no column {missing[0]!r}; a road has 'x [m], z [m]'")
    rows = []
    for number, cells in lines[1:]:
        if len(cells) != len(head):
            raise SceneError(f"{file.name}:{number}: {len(cells)} cells in a row, but the head names {len(head)}")
        try:
            rows.append([places[name][1] * number_in(cells[places[name][0]]) for name in COLUMNS])
        except NumberError as error:
            raise SceneError(f"{file.name}:{number}: {error}") from None
        if len(rows) > 1 and not rows[-1][0] > rows[-2][0]:
            raise SceneError(f"{file.name}:{number}: x = {rows[-1][0]:.6g} m does not lie behind the one before it")
    if len(rows) < 2:
        raise SceneError(f"{file.name}: a road needs two points or more")
    x, z = np.array(rows).T
    return SmoothTable(*((x, z) if spacing is None else _averaged(x, z, spacing)))


def _averaged(x: np.ndarray, z: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Means over windows of one length, at their middles."""
    n = int((x[-1] - x[0]) / spacing) if spacing > 0 else 0
    if n < 2:
        raise SceneError(f"spacing = {shown(spacing)} must be positive and fit twice into {x[-1] - x[0]:.6g} m")
    ends = x[0] + spacing * np.arange(n + 1)
    # The integral of straight lines between all points and all ends is exact.
    places = np.union1d(x, ends)
    heights = np.interp(places, x, z)
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (heights[1:] + heights[:-1]) * np.diff(places))])
    return ends[:-1] + 0.5 * spacing, np.diff(np.interp(ends, places, integral)) / spacing

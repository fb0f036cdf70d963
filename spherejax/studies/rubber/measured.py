"""Measured dynamic stiffness from what people have it in: tables, dicts, data sets."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.forms import visible
from spherejax.foundations.units.number_texts import NumberError, number_in
from spherejax.foundations.units.units import UnitError, factor_of
from spherejax.output.io import load
from spherejax.studies.fit.table import MISSING, WITH_UNIT, lines_of
from spherejax.studies.rubber.stiffness import COLUMNS, DynamicStiffness


class MeasuredStiffness(NamedTuple):
    """Measurements, one entry for each frequency and amplitude.

    Attributes:
        frequency: [Hz].
        amplitude: [m], or [rad].
        stiffness: |K| [N/m], or [N m/rad]; NaN where it was not measured.
        loss_angle: [rad]; NaN where it was not measured.
    """

    frequency: Float[np.ndarray, " n"]
    amplitude: Float[np.ndarray, " n"]
    stiffness: Float[np.ndarray, " n"]
    loss_angle: Float[np.ndarray, " n"]


def measured_stiffness(given: Any, *, rotation: bool) -> MeasuredStiffness:
    """Measurements from a `DynamicStiffness`, a dict, a data set, or the path of a CSV or netCDF file.

    Raises:
        SceneError: for what cannot be read, or makes no sense.
    """
    name = "measured"
    if isinstance(given, str | os.PathLike):
        path = Path(given).expanduser()
        name = path.name
        given = load(path) if path.suffix == ".nc" else _from_table(path, rotation)
    if isinstance(given, DynamicStiffness):
        given = given.to_xarray()
    if hasattr(given, "data_vars"):
        given = _from_dataset(given, name)
    if not isinstance(given, Mapping):
        raise SceneError(
            f"{name}: cannot read a dynamic stiffness from {type(given).__name__}; give a dict with "
            f"{', '.join(COLUMNS)}, an xarray.Dataset with them, or the path of a CSV or netCDF file"
        )
    return _checked(given, name)


def _from_dataset(given: Any, name: str) -> dict[str, np.ndarray]:
    missing = [column for column in ("frequency", "amplitude", "stiffness") if column not in given]
    if missing:
        raise SceneError(f"{name}: the data set has no {missing[0]!r}; it has {', '.join(map(str, given.variables))}")
    wanted = [column for column in ("stiffness", "loss_angle") if column in given]
    flat = given[wanted].to_dataframe().reset_index()
    return {column: flat[column].to_numpy() for column in COLUMNS if column in flat}


def _from_table(path: Path, rotation: bool) -> dict[str, np.ndarray]:
    """Columns with units in brackets, in SI units where there are none."""
    units = dict(zip(COLUMNS, ("Hz", "rad", "N m/rad", "rad") if rotation else ("Hz", "m", "N/m", "rad"), strict=True))
    lines = lines_of(path)
    number, head = lines[0]
    columns: dict[str, tuple[int, float]] = {}
    for at, cell in enumerate(head):
        found = WITH_UNIT.match(cell)
        name, unit = (found["name"], found["unit"].strip()) if found else (cell, "")
        name = "_".join(name.lower().split())
        if name not in units:
            raise SceneError(
                f"{path.name}:{number}: column {cell!r} is none of a dynamic stiffness; {one_of(COLUMNS, name)}"
            )
        try:
            columns[name] = at, factor_of(unit, units[name]) if unit else 1.0
        except UnitError as error:
            raise SceneError(f"{path.name}:{number}: column {name!r}: {error}") from error
    values: dict[str, list[float]] = {name: [] for name in columns}
    for number, cells in lines[1:]:
        if len(cells) != len(head):
            raise SceneError(
                f"{path.name}:{number}: {len(cells)} cells in a row, but the head names {len(head)} columns"
            )
        for name, (at, factor) in columns.items():
            try:
                text = cells[at]
                values[name].append(np.nan if text.lower() in MISSING else factor * number_in(text))
            except NumberError as error:
                raise SceneError(f"{path.name}:{number}: column {name!r}: {error}") from None
    return {name: np.array(column) for name, column in values.items()}


def _checked(given: Mapping[str, Any], name: str) -> MeasuredStiffness:
    unknown = [key for key in given if key not in COLUMNS]
    if unknown:
        raise SceneError(
            f"{name}: {unknown[0]!r} is nothing of a dynamic stiffness; {one_of(COLUMNS, str(unknown[0]))}"
        )
    missing = [key for key in ("frequency", "amplitude") if key not in given]
    missing += ["stiffness"] if "stiffness" not in given and "loss_angle" not in given else []
    if missing:
        raise SceneError(f"{name} has no {missing[0]!r}; it has {', '.join(map(repr, given)) or 'nothing'}")
    try:
        arrays = [np.asarray(visible(given.get(key, np.nan)), np.float64) for key in COLUMNS]
        found = MeasuredStiffness(*(np.array(one).ravel() for one in np.broadcast_arrays(*arrays)))
    except (TypeError, ValueError) as error:
        raise SceneError(f"{name}: the numbers of {', '.join(given)} do not go together: {error}") from error
    for key, values in (("frequency", found.frequency), ("amplitude", found.amplitude)):
        if not np.all((values > 0) & np.isfinite(values)):
            raise SceneError(f"{name}: {key} must be above zero and finite; it is {values[~(values > 0)][:3]}")
    stiffness = found.stiffness[~np.isnan(found.stiffness)]
    if not np.all((stiffness > 0) & (stiffness < np.inf)):
        raise SceneError(
            f"{name}: stiffness must be above zero; it is the magnitude |K|, {stiffness[~(stiffness > 0)][:3]}"
        )
    angles = found.loss_angle[~np.isnan(found.loss_angle)]
    if not np.all(np.abs(angles) <= np.pi):
        raise SceneError(f"{name}: loss_angle must lie within half a turn [rad]; write [deg] if it is in degrees")
    return found

"""Measurements from what people have them in: dicts, data sets, netCDF and CSV files."""

import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.motion.equations.quantities import OF_BODIES, OF_JOINTS, OF_THE_WHOLE
from spherejax.output.io import load
from spherejax.studies.fit.measured import Measured
from spherejax.studies.fit.table import MeasuredTable, read_table

if TYPE_CHECKING:
    import xarray

TIME = "time"


def experiments_from(measured: Any, columns: Mapping[str, str] | None = None) -> list[Measured]:
    """A list of experiments, from one or a list; `columns` of tables as in `table.read_table`.

    Raises:
        SceneError: for what cannot be read as measurements.
    """
    many = measured if isinstance(measured, list | tuple) else [measured]
    if not many:
        raise SceneError("measured is an empty list: there is nothing to fit to")
    return [measured_from(each, columns) for each in many]


def measured_from(given: Any, columns: Mapping[str, str] | None = None) -> Measured:
    """One experiment from a `Measured`, a dict, a data set, or the path of a CSV or netCDF file."""
    if isinstance(given, str | os.PathLike):
        return from_file(Path(given).expanduser(), columns)
    if columns is not None:
        raise SceneError(f"columns= names the columns of CSV files; this is a {type(given).__name__}, which has names")
    if isinstance(given, Measured):
        return given
    if hasattr(given, "data_vars"):
        return from_dataset(given)
    if isinstance(given, Mapping):
        return _from_dict(given)
    raise SceneError(
        f"cannot read measurements from {type(given).__name__}; give sj.Measured(ts, values), a dict with {TIME!r}, an "
        "xarray.Dataset, or the path of a CSV or netCDF file"
    )


def from_file(path: Path, columns: Mapping[str, str] | None = None) -> Measured:
    """One experiment from a file: `.nc` is netCDF, anything else a table; see `table`."""
    if path.suffix == ".nc" and columns is not None:
        raise SceneError(f"columns= names the columns of CSV files, and {path.name!r} is netCDF: rename its variables")
    given = load(path) if path.suffix == ".nc" else read_table(path, columns)
    try:
        is_table = isinstance(given, MeasuredTable)
        return (_from_dict(given.columns, given.units) if is_table else from_dataset(given)).named(path.stem)
    except SceneError as error:
        raise SceneError(f"{path.name}: {error}") from error


def _from_dict(given: Mapping[str, Any], units: Mapping[str, str] = MappingProxyType({})) -> Measured:
    if TIME not in given:
        raise SceneError(f"measured has no {TIME!r} [s]; it has {', '.join(map(repr, given)) or 'nothing'}")
    values = {name: column for name, column in given.items() if name != TIME}
    return Measured(given[TIME], values, shown_in={name: unit for name, unit in units.items() if name != TIME})


def from_dataset(given: "xarray.Dataset") -> Measured:
    """One experiment from a data set with a coordinate `time` [s].

    Variables are named like observables (`"position.rocker.z"`), or like the kinds in a run's own data set
    (`"position"`), with the body or joint as a dimension or a scalar coordinate, and so the axis: both of
    `run.to_xarray()[["position"]]` and `run.to_xarray()[["position"]].sel(body="rocker", axis="z")` will do. What
    measures errors of the run (violations of constraints), and what is no observable, is left out.
    """
    if TIME not in given.coords:
        raise SceneError(f"the data set has no coordinate {TIME!r} [s]; it has {', '.join(map(str, given.coords))}")
    values: dict[str, np.ndarray] = {}
    for name, variable in given.data_vars.items():
        if TIME in variable.dims and np.issubdtype(variable.dtype, np.number):
            values |= _of_variable(str(name), variable)
    if not values:
        raise SceneError(
            f"the data set has no observable along {TIME!r}; its variables are "
            f"{', '.join(map(str, given.data_vars)) or 'none'}. Name them like 'position.rocker.z'"
        )
    return Measured(np.asarray(given[TIME]), values)


OWNERS = ("body", "joint", "spherical_joint", "clearance_joint", "force_joint", "contact_joint")
COMPONENTS = ("axis", "component")


def _of_variable(name: str, variable: "xarray.DataArray") -> dict[str, np.ndarray]:
    """Observables in a variable, by name."""
    kind = name.partition(".")[0]
    if kind in OF_THE_WHOLE and (kind.endswith("violation") or variable.ndim > 1):
        return {}
    if kind not in OF_BODIES and kind not in OF_JOINTS and kind not in OF_THE_WHOLE:
        # Results of force elements, or functions of the user's; what else a run's data set has has no dot.
        simple = "." in name or not any(dim in OWNERS for dim in variable.dims)
        return {name: np.asarray(variable)} if simple and variable.ndim <= 2 else {}
    owner_of = [dim for dim in OWNERS if dim in variable.dims]
    if owner_of:
        each = [(str(owner), variable.sel({owner_of[0]: owner})) for owner in np.asarray(variable[owner_of[0]])]
    else:
        scalar = [str(np.asarray(variable[c])) for c in OWNERS if c in variable.coords and variable[c].ndim == 0]
        each = [(scalar[0] if scalar and "." not in name else "", variable)]
    found = {}
    for owner, part in each:
        axes = [str(np.asarray(part[c])) for c in COMPONENTS if c in part.coords and part[c].ndim == 0]
        full = ".".join(filter(None, [name, owner, *axes]))
        found[full] = np.asarray(part.transpose(TIME, ...))
    return found

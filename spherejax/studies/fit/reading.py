"""Measurements from what people have them in: dicts, data sets, CSV and netCDF files."""

from collections.abc import Mapping
from typing import Any

from spherejax.foundations.checks import SceneError
from spherejax.studies.fit.measured import Measured


def experiments_from(measured: Any) -> list[Measured]:
    """A list of experiments, from one or a list.

    Raises:
        SceneError: for what cannot be read as measurements.
    """
    many = measured if isinstance(measured, list | tuple) else [measured]
    if not many:
        raise SceneError("measured is an empty list: there is nothing to fit to")
    return [measured_from(each) for each in many]


def measured_from(given: Any) -> Measured:
    """One experiment from a `Measured`, a dict, a data set or a path."""
    if isinstance(given, Measured):
        return given
    if isinstance(given, Mapping) and not hasattr(given, "data_vars"):
        return _from_dict(given)
    raise SceneError(
        f"cannot read measurements from {type(given).__name__}; give sj.Measured(ts, values), a dict with 'time', an "
        "xarray.Dataset, or the path of a CSV or netCDF file"
    )


def _from_dict(given: Mapping[str, Any]) -> Measured:
    if "time" not in given:
        raise SceneError(f"measured has no 'time' [s]; it has {', '.join(map(repr, given)) or 'nothing'}")
    return Measured(given["time"], {name: values for name, values in given.items() if name != "time"})

"""A study of accuracy as an `xarray.Dataset`, every variable with its unit."""

from typing import TYPE_CHECKING

import numpy as np

from spherejax.studies.accuracy.samples import STATISTICS, UNITS

if TYPE_CHECKING:
    import xarray

    from spherejax.studies.accuracy.result import Row, WorkPrecision

COUNTS = {
    "n_repeats": "runs that the median is of",
    "n_steps": "steps tried",
    "n_rejected": "steps repeated",
    "n_evaluations": "evaluations of the right-hand side",
    "n_onsets": "contact onsets",
}
"""Counts of a row and what they mean."""


def to_dataset(result: "WorkPrecision") -> "xarray.Dataset":
    """The rows on a grid of `model`, `solver` and `rtol`, the references by `model`.

    Of a run that did not finish or was not tried, times and errors are NaN and the counts what is known.
    """
    import xarray

    solvers = list(dict.fromkeys(row.solver for row in result.rows))
    rtols = sorted({row.rtol for row in result.rows}, reverse=True)
    place = {(row.model, row.solver, row.rtol): row for row in result.rows}
    grid = [[[place.get((m, s, r)) for r in rtols] for s in solvers] for m in result.models]
    coordinates = {
        "model": result.models,
        "solver": solvers,
        "rtol": ("rtol", rtols, {"units": "1", "long_name": "relative tolerance of a step"}),
    }
    texts = {f"advice_{model}": text for model, text in result.advice.items()}
    notes = {f"notes_{model}": " ".join(text) for model, text in result.notes.items()}
    attributes = {"t1": result.t1, "n_samples": result.n_samples, **texts, **notes}
    return xarray.Dataset({**_of_rows(grid), **_of_references(result)}, coordinates, attributes)


def _of_rows(grid: "list[list[list[Row | None]]]") -> dict:
    nan = float("nan")

    def column(value, missing, unit: str, long_name: str):
        values = [[[missing if row is None else value(row) for row in line] for line in plane] for plane in grid]
        return ("model", "solver", "rtol"), np.array(values), {"units": unit, "long_name": long_name}

    columns = {
        "seconds": column(lambda row: row.seconds, nan, "s", "median time of a warm run"),
        "compile_seconds": column(lambda row: row.compile_seconds, nan, "s", "time to trace and compile"),
        "succeeded": column(lambda row: int(row.succeeded), 0, "1", "1 when the run reached its end"),
    }
    for name, meaning in COUNTS.items():
        columns[name] = column(lambda row, name=name: getattr(row, name), 0, "1", meaning)
    for name, unit in UNITS.items():
        meaning = f"largest error of the {name}"
        columns[f"{name}_error"] = column(lambda row, name=name: row.errors[name], nan, unit, meaning)
    for name, (unit, meaning) in STATISTICS.items():
        if any(row is not None and name in row.statistics for plane in grid for line in plane for row in line):
            columns[name] = column(lambda row, name=name: row.statistics.get(name, nan), nan, unit, meaning)
    return columns


def _of_references(result: "WorkPrecision") -> dict:
    references = [result.references[model] for model in result.models]
    columns = {}
    for name, unit in UNITS.items():
        errors, peaks = [one.errors[name] for one in references], [one.scales[name] for one in references]
        apart = {"units": unit, "long_name": f"difference of the two reference runs, {name}"}
        peak = {"units": unit, "long_name": f"peak of the {name}, to which errors may be related"}
        columns[f"{name}_reference_error"] = ("model", errors, apart)
        columns[f"{name}_peak"] = ("model", peaks, peak)
    horizons = [result.t1 if one.horizon is None else one.horizon for one in references]
    until = {"units": "s", "long_name": "time until which errors are measured"}
    return {**columns, "horizon": ("model", horizons, until)}

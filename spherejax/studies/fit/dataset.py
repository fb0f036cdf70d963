"""A fit as an `xarray.Dataset`: estimates, statistics, data, predictions and the path, labelled."""

import importlib.metadata
import json
from typing import TYPE_CHECKING

import numpy as np

from spherejax.studies.fit.columns import columns_of, units_of

if TYPE_CHECKING:
    import xarray


def to_dataset(fit) -> "xarray.Dataset":
    """A fit as a labelled data set.

    Dimensions: `parameter` (arrays flattened), `other_parameter`, `bound` (low, high), `direction` (of the singular
    values), `step` (accepted steps of the best start), `start`; for each experiment `i` a time `time_i` and a component
    `observable_i`, with `measured_i`, `predicted_i`, `residual_i` (over the noise) and `noise_i` (standard deviations).
    With `validate=` errors of prediction by `prediction`, a component of a record.
    """
    import xarray

    known, names = fit.knowledge, fit.names
    variables: dict = {
        "estimate": ("parameter", known.values),
        "start": ("parameter", fit.problem.unknowns.flat_values_of(fit.problem.u0)),
        "standard_deviation": ("parameter", known.standard_deviations),
        "interval": (("parameter", "bound"), known.intervals(fit.level), {"level": fit.level}),
        "covariance": (("parameter", "other_parameter"), fit.covariance),
        "correlation": (("parameter", "other_parameter"), fit.correlation),
        "singular_value": ("direction", fit.singular_values),
        "cost_of_step": ("step", np.array(fit.best.costs), {"long_name": "half the sum of squares of residuals"}),
        "record_of_step": ("step", np.array(fit.best.ends), {"units": "s", "long_name": "end of the record looked at"}),
        "value_of_step": (("step", "parameter"), np.asarray(fit.history["value"])),
        "cost_of_start": ("start_number", np.array([course.cost for course in fit.courses])),
        "end_of_start": (("start_number", "parameter"), _ends(fit)),
    }
    coordinates: dict = {"parameter": names, "other_parameter": names, "bound": ["low", "high"]}
    for i, experiment in enumerate(fit.problem.experiments):
        time, component = f"time_{i}", f"observable_{i}"
        coordinates[time] = (time, experiment.measured.ts, {"units": "s"})
        coordinates[component] = columns_of(experiment)
        residual = fit.tables[i]
        measured = np.where(experiment.is_measured, experiment.data, np.nan)
        facts = {"experiment": str(experiment.measured.name), "units": json.dumps(units_of(experiment))}
        both = (time, component)
        deviation = fit.noise[i]
        variables[f"measured_{i}"] = (both, measured, facts)
        variables[f"predicted_{i}"] = (both, measured + residual * fit.problem.noise[i], facts)
        variables[f"residual_{i}"] = (both, residual * fit.problem.noise[i] / deviation, {"units": "1"})
        variables[f"noise_{i}"] = (both, deviation, facts)
    if fit.validation is not None:
        errors = fit.validation.errors
        coordinates["prediction"] = [f"{one.record}: {one.component}" for one in errors]
        for field in ("rms", "largest", "noise", "expected", "of_fit", "motion"):
            numbers = np.array([getattr(one, field) for one in errors])
            variables[f"prediction_{field}"] = (
                "prediction",
                numbers,
                {"units": json.dumps([one.unit for one in errors])},
            )
    return xarray.Dataset(variables, coordinates, _attributes(fit))


def _ends(fit) -> np.ndarray:
    nothing = np.full(len(fit.names), np.nan)
    return np.stack([fit.problem.unknowns.flat_values_of(c.u) if c.us else nothing for c in fit.courses])


def _attributes(fit) -> dict:
    """Only strings and numbers: netCDF knows no others."""
    versions = {name: importlib.metadata.version(name) for name in ("spherejax", "jax", "diffrax", "optimistix")}
    return {
        "status": fit.status,
        "succeeded": int(fit.succeeded),
        "warnings": "\n".join(fit.warnings) or "none",
        "undetermined": "\n".join(each.explanation for each in fit.undetermined) or "nothing",
        "report": str(fit),
        "cost": fit.cost,
        "n_residuals": fit.problem.n_residuals,
        "noise_was_stated": int(fit.problem.noise_is_known),
        "reduced_chi_square": fit.reduced_chi_square,
        "n_iterations": fit.n_iterations,
        "seconds": fit.seconds,
        "method": fit.problem.experiments[0].frame.choice,
        **{f"{name}_version": version for name, version in versions.items()},
    }

"""Residuals and measurements of an experiment side by side: one column for each component."""

import numpy as np

from spherejax.foundations.units.units import factor_of
from spherejax.studies.fit.experiment import Experiment
from spherejax.studies.fit.observables import labels_of
from spherejax.studies.fit.sensor import unit_of


def widths_of(experiment: Experiment) -> list[int]:
    """Components of each observable."""
    return [1 if value.ndim == 1 else value.shape[1] for value in experiment.measured.values.values()]


def columns_of(experiment: Experiment) -> list[str]:
    """Names of the components that an experiment has measured."""
    names = experiment.measured.values
    return [label for name, width in zip(names, widths_of(experiment), strict=True) for label in labels_of(name, width)]


def units_of(experiment: Experiment) -> list[str]:
    """Units of the components; empty where they are not known."""
    units = zip(units_of_channels(experiment).values(), widths_of(experiment), strict=True)
    return [unit for unit, width in units for _ in range(width)]


def units_of_channels(experiment: Experiment) -> dict[str, str]:
    """Unit of each channel's readings; empty where it is not known."""
    channels = zip(experiment.measured.values, experiment.frame.observables, strict=True)
    return {name: unit_of(experiment.measured.sensors.get(name), observable.unit) for name, observable in channels}


def shown_units_of(experiment: Experiment) -> list[tuple[str, float]]:
    """Units in which pictures show the components, and what numbers in them are multiplied by to be in SI units."""
    shown = []
    channels = zip(units_of_channels(experiment).items(), widths_of(experiment), strict=True)
    for (name, own), width in channels:
        unit = experiment.measured.shown_in.get(name)
        factor = 1.0 if unit is None else factor_of(unit, own or None)
        shown += [(own if unit is None else unit, factor)] * width
    return shown


def tables_of(experiments, residuals: np.ndarray) -> list[np.ndarray]:
    """Flat residuals by experiment, shape (n, m) each; NaN where nothing was measured."""
    tables, at = [], 0
    for experiment in experiments:
        table = np.full(experiment.is_measured.shape, np.nan)
        n = int(np.sum(experiment.is_measured))
        table[experiment.is_measured] = residuals[at : at + n]
        at += n
        tables.append(table)
    return tables

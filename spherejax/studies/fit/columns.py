"""Residuals and measurements of an experiment side by side: one column for each component."""

import numpy as np

from spherejax.studies.fit.experiment import Experiment
from spherejax.studies.fit.observables import labels_of


def widths_of(experiment: Experiment) -> list[int]:
    """Components of each observable."""
    return [1 if value.ndim == 1 else value.shape[1] for value in experiment.measured.values.values()]


def columns_of(experiment: Experiment) -> list[str]:
    """Names of the components that an experiment has measured."""
    names = experiment.measured.values
    return [label for name, width in zip(names, widths_of(experiment), strict=True) for label in labels_of(name, width)]


def units_of(experiment: Experiment) -> list[str]:
    """Units of the components; empty where they are not known."""
    observables = zip(experiment.frame.observables, widths_of(experiment), strict=True)
    return [observable.unit for observable, width in observables for _ in range(width)]


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

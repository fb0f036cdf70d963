"""Sweeps: many runs of one scene builder, from one core to a cluster."""

from spherejax.studies.sweep.failures import StoreWarning, SweepError
from spherejax.studies.sweep.grids import Grid, product, random_samples, sobol_samples, zipped
from spherejax.studies.sweep.reading import open_sweep
from spherejax.studies.sweep.records import Sensitivity
from spherejax.studies.sweep.run import sweep
from spherejax.studies.sweep.spreads import Tolerance

__all__ = [
    "Grid",
    "Sensitivity",
    "StoreWarning",
    "SweepError",
    "Tolerance",
    "open_sweep",
    "product",
    "random_samples",
    "sobol_samples",
    "sweep",
    "zipped",
]

"""What scatter of numbers makes of a motion: budgets of first order, samples, and shares of the variance."""

from spherejax.studies.uncertainty.budget import ToleranceBudget, tolerance_budget
from spherejax.studies.uncertainty.monte_carlo import Scatter, monte_carlo
from spherejax.studies.uncertainty.outputs import UncertaintyWarning
from spherejax.studies.uncertainty.sobol import SobolIndices, sobol_indices

__all__ = [
    "Scatter",
    "SobolIndices",
    "ToleranceBudget",
    "UncertaintyWarning",
    "monte_carlo",
    "sobol_indices",
    "tolerance_budget",
]

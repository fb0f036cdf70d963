"""A candidate that was fitted, or that failed."""

from dataclasses import dataclass, field, replace

import numpy as np

from spherejax.studies.fit.fit_result import Fit
from spherejax.studies.fit.validation import Validation


@dataclass(frozen=True)
class Fitted:
    """A candidate that was fitted, or that failed.

    Attributes:
        fit: to all values of the records; None of one that failed.
        train_u: unknowns fitted without the held-out ends of the records.
        cuts: until when each record was fitted then [s].
        validation: prediction of records that were held out as a whole.
        has_parameters: whether the model has any of its own.
        n_draws: parameters that were tried over the ranges.
        n_failed: draws whose runs did not reach their ends.
        diagnosis: why it failed, or nothing.
        seconds: how long it took [s].
    """

    fit: Fit | None = None
    train_u: np.ndarray = field(default_factory=lambda: np.zeros(0))
    cuts: list[float] = field(default_factory=list)
    validation: Validation | None = None
    has_parameters: bool = True
    n_draws: int = 0
    n_failed: int = 0
    diagnosis: str = ""
    seconds: float = 0.0

    def timed(self, seconds: float) -> "Fitted":
        """The same with the time that it took [s]."""
        fit = None if self.fit is None else replace(self.fit, seconds=seconds)
        return replace(self, fit=fit, seconds=seconds)

    @classmethod
    def failed(cls, diagnosis: str, n_draws: int = 0, n_failed: int = 0) -> "Fitted":
        """One that failed."""
        return cls(diagnosis=diagnosis, n_draws=n_draws, n_failed=n_failed)

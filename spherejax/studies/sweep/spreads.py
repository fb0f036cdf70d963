"""How a number scatters: a tolerance, a range, or any distribution of scipy.stats."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import shape_of, visible

UNBOUNDED = 3.0
"""Standard deviations that stand for the half width of a distribution without limits."""

LEAST = 2.0**-54
"""Of probabilities, so that a distribution without limits stays finite."""


@dataclass(frozen=True)
class Tolerance:
    """A number with limits, as on a drawing: `sj.studies.Tolerance(1e-4, 2e-5)` is 0.1 mm +- 0.02 mm.

    Attributes:
        nominal: the middle.
        half_width: to the limits on either side; parts beyond them are rejected, and no sample is.
        scatter: `"normal"`, with `sigmas` standard deviations to the limits, cut off there; or `"uniform"`.
        sigmas: see there. Three are those of a process that is just capable.
    """

    nominal: float
    half_width: float
    scatter: Literal["normal", "uniform"] = "normal"
    sigmas: float = 3.0

    def __post_init__(self):
        for name in ("nominal", "half_width", "sigmas"):
            value = getattr(self, name)
            if not is_concrete(value) or shape_of(value) != () or not np.isfinite(np.asarray(value, np.float64)):
                raise SceneError(f"Tolerance: {name} = {value!r} must be a finite number")
            if name != "nominal" and not value > 0:
                raise SceneError(f"Tolerance: {name} = {value:g} must be positive")
        if self.scatter not in ("normal", "uniform"):
            raise SceneError(f"Tolerance: scatter = {self.scatter!r} is 'normal' or 'uniform'")

    @property
    def distribution(self):
        """As scipy.stats has it."""
        from scipy import stats

        if self.scatter == "uniform":
            return stats.uniform(self.nominal - self.half_width, 2 * self.half_width)
        return stats.truncnorm(-self.sigmas, self.sigmas, self.nominal, self.half_width / self.sigmas)


Spread = Any
"""A `Tolerance`, a range (least, largest) of equal probability, or a distribution: `scipy.stats.norm(0.1, 0.01)`."""


@dataclass(frozen=True)
class Scattered:
    """A number that scatters.

    Attributes:
        name: its name.
        distribution: of scipy.stats.
        is_range: whether it was given as one.
    """

    name: str
    distribution: Any
    is_range: bool = False

    @property
    def nominal(self) -> float:
        """The mean."""
        return float(self.distribution.mean())

    @property
    def deviation(self) -> float:
        """The standard deviation."""
        return float(self.distribution.std())

    @property
    def half_width(self) -> float:
        """From the mean to the farther limit; where there is none, three standard deviations."""
        low, high = (float(end) for end in self.distribution.support())
        reach = max(self.nominal - low, high - self.nominal)
        return reach if np.isfinite(reach) else UNBOUNDED * self.deviation

    @property
    def step(self) -> float:
        """A standard deviation, or less where the nearer limit is nearer than that."""
        low, high = (float(end) for end in self.distribution.support())
        return min(self.deviation, self.nominal - low, high - self.nominal)

    def at(self, shares) -> np.ndarray:
        """The values below which these shares of all lie."""
        return np.asarray(self.distribution.ppf(np.clip(shares, LEAST, 1 - 2 * LEAST)))


def scattered(name: str, spread: Spread) -> Scattered:
    """A number that scatters, checked.

    Raises:
        SceneError: for what says no such thing.
    """
    if isinstance(spread, Tolerance):
        return Scattered(name, spread.distribution)
    if all(callable(getattr(spread, part, None)) for part in ("ppf", "mean", "std", "support")):
        found = Scattered(name, spread)
        if np.ndim(spread.mean()) or not (np.isfinite(found.nominal) and 0 < found.deviation < np.inf):
            raise SceneError(
                f"parameter {name!r}: a distribution of one number with a finite mean and standard deviation is "
                f"needed; it has {spread.mean()} and {spread.std()}"
            )
        return found
    return Scattered(name, _uniform(name, spread), is_range=True)


def _uniform(name: str, given):
    from scipy import stats

    try:
        ends = np.asarray(visible(given), np.float64)
    except (TypeError, ValueError):
        ends = np.zeros(0)
    if ends.shape != (2,) or not np.all(np.isfinite(ends)) or not ends[0] < ends[1]:
        raise SceneError(
            f"parameter {name!r} needs a range (least, largest), a sj.studies.Tolerance(nominal, half_width) "
            f"or a distribution "
            f"of scipy.stats; it has {given!r}"
        )
    return stats.uniform(ends[0], ends[1] - ends[0])

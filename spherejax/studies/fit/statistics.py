"""What residuals and their Jacobian at the estimates say about the parameters.

With the Jacobian J of the noise-weighted residuals by the numbers p, each in units of its scale s (its own size, or
what `Parameter(scale=)` says), and its singular values sigma_i and directions v_i,

    covariance of p / s = variance * sum_i v_i v_i^T / sigma_i^2,

which is the Cramer-Rao bound for independent normal errors where the noise is stated (variance 1). Along v_i the data
leave a standard deviation of 1 / sigma_i.

Where the errors are correlated, with the covariance R, J^T J is no longer the inverse of the covariance, which is then
(J^T J)^-1 (J^T R J) (J^T J)^-1; see `correlation`.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.studies.fit.correlation import Correlated
from spherejax.studies.fit.parameters import FitUnknowns

SMALLEST_SHARE = 0.1
"""A parameter belongs to a direction in words if its part of it is at least this share of the largest."""


UNKNOWN = 1e150
"""Stands for an infinite standard deviation, in units of scales."""


class Undetermined(NamedTuple):
    """A direction among the parameters that the data do not determine.

    Attributes:
        direction: by name: relative changes of positive parameters, changes in units of their scales of the others.
        singular_value: of the noise-weighted Jacobian along it; 1 over it is the standard deviation along it.
        explanation: one sentence.
    """

    direction: dict[str, float]
    singular_value: float
    explanation: str


@dataclass(frozen=True)
class Knowledge:
    """What the data say about the parameters near the estimates.

    Attributes:
        unknowns: what was fitted.
        u: the estimates as unknowns.
        jacobian: of the weighted residuals by the unknowns.
        variance: of the weighted residuals: 1 where the noise was stated, estimated otherwise.
        degrees_of_freedom: of that estimate; infinite where the noise was stated.
        correlated: what correlations of the errors do; None where they are independent.
    """

    unknowns: FitUnknowns
    u: np.ndarray
    jacobian: np.ndarray
    variance: float
    degrees_of_freedom: float
    correlated: Correlated | None = None

    @cached_property
    def values(self) -> np.ndarray:
        """The estimates."""
        return self.unknowns.flat_values_of(self.u)

    @cached_property
    def scales(self) -> np.ndarray:
        """What counts as a large change of each."""
        return self.unknowns.scales(self.values)

    @cached_property
    def scaled_jacobian(self) -> np.ndarray:
        """By the parameters in units of their scales."""
        return self.jacobian * self.unknowns_per_scale

    @cached_property
    def unknowns_per_scale(self) -> np.ndarray:
        """Change of each unknown for a change of its parameter by its scale; 0 for one that rests on its bound."""
        slopes = np.asarray(jax.jvp(self._flat, (jnp.asarray(self.u),), (jnp.ones(self.u.size),))[1])
        return np.where(slopes == 0, 0.0, self.scales / np.where(slopes == 0, 1.0, slopes))

    @property
    def most_sensitive(self) -> np.ndarray:
        """Direction of the parameters, in units of their scales, that changes the predictions most."""
        return self._decomposition[1][0]

    def _flat(self, u):
        return jnp.concatenate([jnp.ravel(value) for value in self.unknowns.values_of(u).values()])

    @cached_property
    def _decomposition(self) -> tuple[np.ndarray, np.ndarray]:
        """Singular values, falling, and directions in rows; those without any trace in the data have the value 0."""
        n, k = self.scaled_jacobian.shape
        _, singular, right = np.linalg.svd(self.scaled_jacobian, full_matrices=n < k)
        singular = np.concatenate([singular, np.zeros(k - singular.size)])
        without_trace = singular <= (singular[0] if k else 0.0) * max(n, k) * np.finfo(float).eps
        # Parts that are rounding would make everything look undetermined.
        rounding = without_trace[:, None] & (np.abs(right) < 1e-8)
        return np.where(without_trace, 0.0, singular), np.where(rounding, 0.0, right)

    @property
    def singular_values(self) -> np.ndarray:
        """Of the scaled Jacobian, falling."""
        return self._decomposition[0]

    @cached_property
    def scaled_covariance(self) -> np.ndarray:
        """Of the parameters in units of their scales; of size 1e200 and more where the data have no trace of them."""
        singular, right = self._decomposition
        size = np.where(singular > 0, singular, 1.0)
        if self.correlated is None:
            factor = right.T * np.where(singular > 0, np.sqrt(self.variance) / size, UNKNOWN)
            return factor @ factor.T
        inverse = (right.T * np.where(singular > 0, 1 / size**2, 0.0)) @ right
        meat = self.correlated.meat * np.outer(self.unknowns_per_scale, self.unknowns_per_scale)
        open_directions = right.T * np.where(singular > 0, 0.0, UNKNOWN)
        return inverse @ meat @ inverse + open_directions @ open_directions.T

    @property
    def widening(self) -> np.ndarray:
        """How many times larger the standard deviations are than those of independent errors of the same size."""
        if self.correlated is None:
            return np.ones(self.u.size)
        independent = replace(self, correlated=None).scaled_deviations
        there = np.isfinite(independent) & (independent > 0)
        return np.where(there, self.scaled_deviations / np.where(there, independent, 1.0), 1.0)

    @property
    def covariance_of_unknowns(self) -> np.ndarray:
        """Of the method's unknowns u; not finite where the data have no trace of a parameter."""
        return self.scaled_covariance * np.outer(self.unknowns_per_scale, self.unknowns_per_scale)

    @property
    def covariance(self) -> np.ndarray:
        """Of the parameters, in their units; infinite where the data have no trace of them."""
        scaled = self.scaled_covariance
        infinite = np.copysign(np.inf, scaled)
        return np.where(np.abs(scaled) >= UNKNOWN, infinite, scaled * np.outer(self.scales, self.scales))

    @property
    def standard_deviations(self) -> np.ndarray:
        """Of the parameters, in their units; infinite where the data have no trace of them."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def scaled_deviations(self) -> np.ndarray:
        """Standard deviations in units of the scales."""
        deviations = np.sqrt(np.diagonal(self.scaled_covariance))
        return np.where(deviations >= np.sqrt(UNKNOWN), np.inf, deviations)

    @property
    def correlation(self) -> np.ndarray:
        """Of the parameters."""
        deviations = np.sqrt(np.diagonal(self.scaled_covariance))
        return self.scaled_covariance / np.outer(deviations, deviations)

    def intervals(self, level: float) -> np.ndarray:
        """Confidence intervals within the bounds, shape (k, 2): of positive parameters symmetric in the logarithm."""
        from scipy import stats  # half a second, which not every process has to spend

        quantile = float(stats.t.ppf((1 + level) / 2, self.degrees_of_freedom))
        reach = quantile * self.scaled_deviations
        relative = self.unknowns.each("is_relative") & (self.values > 0)
        factor = np.where(reach > 700.0, np.inf, np.exp(np.minimum(reach, 700.0)))
        low = np.where(relative, self.values / factor, self.values - reach * self.scales)
        high = np.where(relative, self.values * factor, self.values + reach * self.scales)
        lower, upper = self.unknowns.each("lower"), self.unknowns.each("upper")
        return np.stack([np.maximum(low, lower), np.minimum(high, upper)], 1)

    def undetermined(self, within: float) -> list[Undetermined]:
        """Directions along which the data leave a larger standard deviation than `within`, the worst first."""
        singular, right = self._decomposition
        if self.correlated is None:
            size = np.sqrt(self.variance) / np.where(singular > 0, singular, 1.0)
        else:
            size = np.sqrt(np.einsum("ij,jk,ik->i", right, self.scaled_covariance, right))
        deviations = np.where(singular > 0, size, np.inf)
        found = [
            _described(self.unknowns, right[i], float(singular[i]), float(deviations[i]), within)
            for i in range(singular.size)
            if deviations[i] > within
        ]
        return found[::-1]


def _described(unknowns: FitUnknowns, direction: np.ndarray, singular: float, deviation: float, within: float):
    names, relative = unknowns.names, unknowns.each("is_relative")
    direction = direction * np.sign(direction[np.argmax(np.abs(direction))])
    parts = {name: float(part) for name, part in zip(names, direction, strict=True)}
    order = np.argsort(-np.abs(direction))
    main = [int(i) for i in order if abs(direction[i]) >= SMALLEST_SHARE * abs(direction[order[0]])]
    first = names[main[0]]
    if len(main) == 1:
        what = f"{first} is"
    else:
        others = [f"{names[i]} {'rises' if direction[i] > 0 else 'falls'}" for i in main[1:]]
        what = f"{first} while {_listed(others)}{_ratios(direction, main, relative)} is"
    how = _how_open(deviation, bool(relative[main[0]]), first)
    text = f"{what} {how}; singular value {singular:.3g}"
    return Undetermined(parts, singular, text[0].lower() + text[1:])


def _how_open(deviation: float, is_relative: bool, name: str) -> str:
    if np.isinf(deviation):
        return f"not determined at all: changing {name} leaves no trace in what was measured"
    if is_relative and deviation > 0.5:
        return f"not determined: a factor of {np.exp(min(deviation, 700.0)):.2g} in it is within one standard deviation"
    if is_relative:
        return f"determined no better than to {100 * deviation:.2g} percent (one standard deviation)"
    return f"determined no better than to {deviation:.2g} of its scale (one standard deviation)"


def _ratios(direction: np.ndarray, main: list[int], relative: np.ndarray) -> str:
    if len(main) == 2 and all(relative[main]):
        return f" by {abs(direction[main[1]] / direction[main[0]]):.2g} as many percent"
    return ""


def _listed(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


class Whiteness(NamedTuple):
    """The test of Ljung and Box (1978) of consecutive residuals.

    Attributes:
        probability: that white residuals look as correlated as these.
        statistic: Q = n (n + 2) sum_k r_k^2 / (n - k), which is distributed as chi-square with as many degrees of
            freedom as there are lags, where residuals are white.
        n_lags: how many correlations r_k are looked at, k = 1, 2, ...
        n: residuals.
        lag: k of the largest magnitude of r_k.
        correlation: that r_k.
    """

    probability: float
    statistic: float
    n_lags: int
    n: int
    lag: int
    correlation: float

    @property
    def bound(self) -> float:
        """The magnitude that a correlation of white residuals exceeds once in twenty, 1.96 / sqrt(n)."""
        return 1.96 / self.n**0.5


def whiteness_of(residuals: np.ndarray, n_lags: int = 10) -> Whiteness:
    """How likely residuals are white noise; with probability 1 where there are too few to say, or all are the same.

    Args:
        residuals: consecutive, of one observable.
        n_lags: how many correlations are looked at; a fifth of the residuals at most.
    """
    n = residuals.size
    n_lags = min(n_lags, n // 5)
    centered = residuals - residuals.mean() if n else residuals
    power = float(centered @ centered)
    if n_lags < 1 or power == 0:
        return Whiteness(1.0, 0.0, max(n_lags, 0), n, 1, 0.0)
    correlations = np.array([centered[k:] @ centered[:-k] for k in range(1, n_lags + 1)]) / power
    statistic = float(n * (n + 2) * np.sum(correlations**2 / (n - np.arange(1, n_lags + 1))))
    from scipy import stats

    at = int(np.argmax(np.abs(correlations)))
    return Whiteness(float(stats.chi2.sf(statistic, n_lags)), statistic, n_lags, n, at + 1, float(correlations[at]))

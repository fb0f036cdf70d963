"""Robust losses: how much a residual counts that is far larger than the noise.

A fit minimises the sum of L(r) over all residuals r, each in standard deviations of the noise,

    least squares    L = r^2 / 2
    Huber            L = r^2 / 2 up to |r| = c, then c |r| - c^2 / 2
    Cauchy           L = c^2 / 2 log(1 + r^2 / c^2)

Methods that minimise sums of squares see s = sign(r) sqrt(2 L(r)) in place of r, and its derivatives s'(r) J: then
s^2 / 2 = L exactly, the gradient is that of the robust cost, and (s')^2 is the weight of a residual in the matrix of
the Gauss-Newton step. With Huber's loss and |r| much larger than c it is c / (2 |r|), half that of iteratively
reweighted least squares, whose step is too short there: the second derivative of L is zero.

Sources: Huber 1964, Annals of Mathematical Statistics 35, 73; Holland and Welsch 1977, Communications in Statistics A6,
813, for the constants with which 95 percent of the efficiency are kept where errors are normal.
"""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np

from spherejax.foundations.errors import SceneError


@runtime_checkable
class Loss(Protocol):
    """How much residuals count: `Huber`, `Cauchy`, or one of your own; all functions take arrays, and are compared."""

    def cost(self, residuals: Any) -> Any:
        """L(r), differentiable."""
        ...

    def slope(self, residuals: Any) -> Any:
        """L'(r)."""
        ...

    def curvature(self, residuals: Any) -> Any:
        """L''(r)."""
        ...

    def residual(self, roots: Any) -> Any:
        """r from s = sign(r) sqrt(2 L(r))."""
        ...


@dataclass(frozen=True)
class Huber:
    """Residuals beyond a threshold count by their size, not by its square: for a few outliers.

    Attributes:
        threshold: c, in standard deviations of the noise.
    """

    threshold: float = 1.345

    def __post_init__(self):
        _check_positive("Huber: threshold", self.threshold)

    def cost(self, residuals: Any) -> Any:
        """L(r)."""
        size, c = jnp.abs(residuals), self.threshold
        return jnp.where(size <= c, residuals**2 / 2, c * size - c**2 / 2)

    def slope(self, residuals: Any) -> Any:
        """L'(r)."""
        return jnp.clip(residuals, -self.threshold, self.threshold)

    def curvature(self, residuals: Any) -> Any:
        """L''(r)."""
        return jnp.where(jnp.abs(residuals) <= self.threshold, 1.0, 0.0)

    def residual(self, roots: Any) -> Any:
        """The residual r from s = sign(r) sqrt(2 L(r))."""
        c = self.threshold
        return jnp.where(jnp.abs(roots) <= c, roots, jnp.sign(roots) * (roots**2 + c**2) / (2 * c))


@dataclass(frozen=True)
class Cauchy:
    """Residuals far beyond the scale hardly count at all: for gross errors. The cost may have several minima.

    Attributes:
        scale: c, in standard deviations of the noise.
    """

    scale: float = 2.385

    def __post_init__(self):
        _check_positive("Cauchy: scale", self.scale)

    def cost(self, residuals: Any) -> Any:
        """L(r)."""
        return self.scale**2 / 2 * jnp.log1p((residuals / self.scale) ** 2)

    def slope(self, residuals: Any) -> Any:
        """L'(r)."""
        return residuals / (1 + (residuals / self.scale) ** 2)

    def curvature(self, residuals: Any) -> Any:
        """L''(r); negative beyond the scale."""
        share = (residuals / self.scale) ** 2
        return (1 - share) / (1 + share) ** 2

    def residual(self, roots: Any) -> Any:
        """The residual r from s = sign(r) sqrt(2 L(r))."""
        return jnp.sign(roots) * self.scale * jnp.sqrt(jnp.expm1((roots / self.scale) ** 2))


def rooted(loss: Loss, residuals: Any) -> tuple[Any, Any]:
    """s = sign(r) sqrt(2 L(r)), and ds/dr = L'(r) / s; 1 at zero."""
    roots = jnp.sign(residuals) * jnp.sqrt(2 * loss.cost(residuals))
    is_zero = jnp.abs(residuals) < SMALLEST
    return roots, jnp.where(is_zero, 1.0, loss.slope(residuals) / jnp.where(is_zero, 1.0, roots))


SMALLEST = 1e-150
"""Below this the square of a residual is no number any more; every loss is r^2 / 2 there."""


@dataclass(frozen=True)
class PseudoErrors:
    """Residuals of a robust fit as errors of a linear model.

    An estimate moves by (J^T J)^-1 J^T e, to first order in 1 / n, with e = L'(r) / mean(L''): least squares of e.

    Attributes:
        errors: e.
        factor: correction of their variance for small n (Huber 1981, Robust Statistics, section 7.6).
    """

    errors: np.ndarray
    factor: float


def pseudo_errors(loss: Loss | None, residuals: np.ndarray, n_parameters: int) -> PseudoErrors:
    """Residuals as errors of a linear model; of least squares they are the residuals.

    Args:
        loss: None: least squares.
        residuals: over the noise.
        n_parameters: fitted.
    """
    if loss is None or not residuals.size:
        return PseudoErrors(residuals, 1.0)
    slopes, curvatures = (np.asarray(f(residuals)) for f in (loss.slope, loss.curvature))
    mean = max(float(np.mean(curvatures)), LEAST_CURVATURE)
    factor = 1 + n_parameters / residuals.size * float(np.var(curvatures)) / mean**2
    return PseudoErrors(slopes / mean, factor**2)


LEAST_CURVATURE = 0.05
"""A mean of L'' below this says that nearly all residuals are outliers: the noise is understated many times."""


def robust_scale(errors: np.ndarray, share: float) -> float:
    """Standard deviation of normal errors with the median magnitude of these; `share` of them are free."""
    return float(np.median(np.abs(errors))) / 0.674489750196082 / np.sqrt(share)


def check_loss(loss: Any) -> None:
    """Refuse what is no loss.

    Raises:
        SceneError: naming it.
    """
    if loss is not None and (isinstance(loss, type) or not isinstance(loss, Loss)):
        raise SceneError(
            f"loss must be sj.studies.Huber(), sj.studies.Cauchy() or None for least squares; it is {loss!r}"
        )


def _check_positive(what: str, number: Any) -> None:
    if isinstance(number, bool) or not isinstance(number, int | float) or not 0 < number < np.inf:
        raise SceneError(f"{what} = {number!r} must be a positive number, in standard deviations of the noise")

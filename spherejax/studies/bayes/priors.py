"""What is known about parameters before the measurements: log densities, up to a constant.

A prior of one's own is a function from the parameter to the logarithm of its density, written with `jax.numpy`; of an
array, to the sum over its numbers, or to one for each.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import visible

Prior = Callable[[Array], Any]
"""From a parameter to the logarithm of its density."""


@dataclass(frozen=True)
class Uniform:
    """Every value alike, within the parameter's bounds."""

    def __call__(self, value: Array) -> Any:
        """log p = const."""
        return jnp.zeros_like(value)


@dataclass(frozen=True)
class LogUniform:
    """Every ratio alike: the density falls like 1 / value; for positive parameters whose size is not known."""

    def __call__(self, value: Array) -> Any:
        """log p = -log x + const."""
        return -jnp.log(value)


@dataclass(frozen=True)
class Normal:
    """About `mean`, with a standard deviation, in the parameter's unit.

    Attributes:
        mean: the mean.
        deviation: the standard deviation.
    """

    mean: Any
    deviation: Any

    def __post_init__(self):
        _check_positive("deviation", self.deviation)

    def __call__(self, value: Array) -> Any:
        """log p = -((x - m) / s)^2 / 2 + const."""
        return -(((value - jnp.asarray(self.mean)) / jnp.asarray(self.deviation)) ** 2) / 2


@dataclass(frozen=True)
class LogNormal:
    """About `median`, within about a factor, for positive parameters.

    Attributes:
        median: the median.
        factor: one standard deviation of the logarithm is the logarithm of this factor, above 1.
    """

    median: Any
    factor: Any

    def __post_init__(self):
        _check_positive("median", self.median)
        if not np.all(np.asarray(self.factor, np.float64) > 1):
            raise SceneError(f"LogNormal(factor={self.factor!r}): the factor must be above 1")

    def __call__(self, value: Array) -> Any:
        """log p = -(log(x / m) / log f)^2 / 2 - log x + const."""
        logarithm = jnp.log(value)
        share = (logarithm - jnp.log(jnp.asarray(self.median))) / jnp.log(jnp.asarray(self.factor))
        return -(share**2) / 2 - logarithm


def _check_positive(name: str, value: Any) -> None:
    if not np.all(np.asarray(visible(value), np.float64) > 0):
        raise SceneError(f"{name} of a prior must be positive; it is {value!r}")

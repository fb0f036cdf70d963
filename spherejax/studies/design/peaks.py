"""The largest value of a history, as a smooth function of what the history depends on.

The largest sample jumps from one instant to another as a design changes, and its derivative jumps with it. A p-norm
counts all instants, the largest most:

    P(x) = (sum_i |x_i|^p)^(1/p) = m (sum_i (|x_i|/m)^p)^(1/p),    m = max_i |x_i|

m <= P <= m n^(1/p) for n samples, so that P below a limit keeps every sample below it.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Number, Scalar

SHARPNESS = 50.0
"""Exponent p of a smooth peak by default: twenty samples within a percent of the largest add six percent."""

SMALLEST_SHARE = 1e-6
"""Samples below this share of the largest count as this share: their powers are far below rounding."""


def magnitudes(values: Float[Array, "n ..."]) -> Float[Array, " n"]:
    """Absolute values of numbers, lengths of vectors.

    Limits: at zero the derivative is taken as 0.
    """
    return jax.vmap(safe_norm)(jnp.asarray(values).reshape(values.shape[0], -1))


def smooth_peak(values: Float[Array, "n ..."], sharpness: Number = SHARPNESS) -> Scalar:
    """The p-norm of a history, a smooth and slightly larger stand-in for its largest magnitude.

    Args:
        values: samples of a number, shape (n,), or of a vector, shape (n, k), which counts by its length.
        sharpness: the exponent p; the larger, the closer to the largest sample.

    Returns:
        The p-norm, in the unit of the values.

    Limits: 0 with derivative 0 for a history of zeros; tends to the largest sample as p grows.

    Source: Kreisselmeier and Steinhauser (1979) introduced such envelopes in optimisation; Le, Norato, Bruns, Ha,
    Tortorelli (2010), Struct. Multidisc. Optim. 41:605-620, Eq. 8, use the p-norm for the largest stress.
    """
    found: Any = magnitudes(values)
    largest = jax.lax.stop_gradient(jnp.max(found))
    scale = jnp.where(largest > 0, largest, 1.0)
    shares = jnp.maximum(found / scale, SMALLEST_SHARE)
    power = jnp.exp(jax.lax.stop_gradient(sharpness) * jnp.log(shares))
    return jnp.where(largest > 0, scale * jnp.sum(power) ** (1 / sharpness), 0.0)

"""Smoothing of samples by splines of the fifth degree, with two smooth derivatives.

The spline s minimizes

    sum_i (y_i - s(t_i))^2 + p integral s'''(t)^2 dt,    p = 1/(h w^6),    w = 2 pi cutoff

with h the mean interval of the samples. Far from the ends of equally spaced samples that is a filter without phase,
whose gain at the frequency f is 1/(1 + (f/cutoff)^6): one half at the cutoff, as of a Butterworth filter of the third
order that is run forward and backward.

Source: Woltring (1986), Advances in Engineering Software 8(2):104-113, splines of this kind for biomechanics; the gain
is Craven and Wahba's (1979), Numer. Math. 31:377-403, for the third derivative.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.interpolate import BSpline

from spherejax.foundations.types import Number

DEGREE = 5

GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(3)
"""Exact for the square of s''', which is a parabola between two knots."""


class Smoothed(NamedTuple):
    """Smoothed samples and their derivatives, at the instants of the samples.

    Attributes:
        value: shape (n, k).
        rate: [1/s].
        second: second derivative [1/s^2].
    """

    value: Float[Array, "n k"]
    rate: Float[Array, "n k"]
    second: Float[Array, "n k"]


def smoothed(times: np.ndarray, values: Float[Array, "n k"], cutoff: Number) -> Smoothed:
    """The smoothing spline at its samples.

    Args:
        times: increasing, known numbers [s], shape (n,).
        values: samples, one column for each signal.
        cutoff: frequency at which the gain is one half [Hz].

    Limits: the linear system is a dense one of n + 4 unknowns: a second for a thousand samples. Within some 1/cutoff of
    both ends the derivatives are less exact than between.
    """
    interval = (times[-1] - times[0]) / (len(times) - 1)
    # Counted in intervals: the numbers of both parts of the sum are then of similar size at any rate of sampling.
    at = (times - times[0]) / interval
    knots = np.concatenate([np.full(DEGREE, at[0]), at, np.full(DEGREE, at[-1])])
    bases = [_basis(knots, at, order) for order in range(3)]
    inside = (at[:-1, None] + at[1:, None]) / 2 + (at[1:, None] - at[:-1, None]) / 2 * GAUSS
    weights = np.sqrt((at[1:, None] - at[:-1, None]) / 2 * WEIGHTS)
    bend = weights.ravel()[:, None] * _basis(knots, inside.ravel(), 3)
    stiffness = (interval * 2 * np.pi * jnp.asarray(cutoff)) ** -3.0
    # As least squares and not by normal equations, whose condition is the square of this one's: 1e7 at a hundredth of
    # the sampling rate.
    q, r = jnp.linalg.qr(jnp.concatenate([jnp.asarray(bases[0]), stiffness * bend]))
    right = q[: len(times)].T @ values
    coefficients = jnp.linalg.solve(r, right)
    value, rate, second = (basis @ coefficients / interval**order for order, basis in enumerate(bases))
    return Smoothed(value, rate, second)


def _basis(knots: np.ndarray, at: np.ndarray, order: int) -> np.ndarray:
    """Derivatives of all B-splines, shape (len(at), n_basis)."""
    n_basis = len(knots) - DEGREE - 1
    return BSpline(knots, np.eye(n_basis), DEGREE)(at, nu=order)

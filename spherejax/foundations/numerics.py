"""Guarded mathematics: the value is untouched, and the derivative is finite where the formula alone gives
0/0.

Each function here exists because the plain formula returns NaN, or loses its digits, at a point that a
simulated joint does reach: the centered ball, a separated contact, zero sliding. Each docstring states
value and derivative at that point. The guard is always the same double `where`: the argument is replaced
before the dangerous operation *and* the result is chosen after it, since a single `where` around a division
still differentiates the branch that was not taken.

Only elementary operations occur, in straight-line order: no loops, no branches, no dynamic indexing. A series
has a fixed number of terms and is evaluated by Horner's rule, unrolled.
"""

import math
from collections.abc import Sequence
from fractions import Fraction

import jax.numpy as jnp

from spherejax.foundations.types import Number, Scalar, Vector3

CONCENTRIC_RADIUS = 1e-12
"""Eccentricity below which ball and socket count as concentric [m].

A hundredth of an atom, far below any clearance or deformation that matters, so that no result depends on
it, and far above the point where its square would underflow.
"""

BERNOULLI = tuple(
    Fraction(*pair)
    for pair in (
        (1, 6),
        (-1, 30),
        (1, 42),
        (-1, 30),
        (5, 66),
        (-691, 2730),
        (7, 6),
        (-3617, 510),
        (43867, 798),
        (-174611, 330),
        (854513, 138),
    )
)
"""The Bernoulli numbers B_2, B_4, ..., B_22: Abramowitz and Stegun (1964), Table 23.2."""

_TANHC_SERIES = tuple(
    float(4**k * (4**k - 1) * b / math.factorial(2 * k)) for k, b in enumerate(BERNOULLI[:8], start=1)
)
_TANHC_RADIUS = 0.1
"""Below it the series: 8 terms leave 1e-18. Above it the quotient's derivative has lost 1/x**2 = 100
roundings."""


def horner(coefficients: Sequence[float], x: Number) -> Number:
    """The polynomial sum_k coefficients[k] x**k, unrolled."""
    total = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total


def safe_sqrt(x: Number) -> Scalar:
    """sqrt(x) for x > 0, else 0.

    Limits: value 0 and derivative 0 for x <= 0, where the true derivative is unbounded or undefined.
    """
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def safe_norm(x: Vector3) -> Scalar:
    """The Euclidean length of a vector, |x|, in the unit of x.

    Limits: at x = 0 the value is 0 and the derivative is taken as 0, the mean of the one-sided ones; the
    true one does not exist. Everywhere else value and derivative x/|x| are those of the plain formula.
    Lengths below 1e-154 underflow to 0.
    """
    return safe_sqrt(x @ x)


def safe_divide(numerator: Number, denominator: Number) -> Scalar:
    """numerator / denominator.

    Limits: value 0 and derivative 0 where the denominator is 0.
    """
    regular = denominator != 0
    return jnp.where(regular, numerator / jnp.where(regular, denominator, 1.0), 0.0)


def positive_power(x: Number, n: Number) -> Scalar:
    """x**n for x > 0, else 0: the elastic force of a contact that has closed.

    Args:
        x: the base, any sign.
        n: the exponent, at least 1; concrete or traced.

    Limits: for x <= 0 the value and the derivatives by x and by n are 0, which for n > 1 are the true ones
    from the right too.
    """
    positive = x > 0
    return jnp.where(positive, jnp.where(positive, x, 1.0) ** n, 0.0)


def tanhc(x: Number) -> Scalar:
    """tanh(x)/x, even and smooth.

    Limits: value 1 and derivative 0 at x = 0, second derivative -2/3; 1/|x| for large |x|.

    Source: Abramowitz and Stegun (1964), 4.5.64, for the series 1 - x**2/3 + 2 x**4/15 - ...
    """
    near = jnp.abs(x) < _TANHC_RADIUS
    x_near = jnp.where(near, x, 0.0)
    x_far = jnp.where(near, 1.0, x)
    return jnp.where(near, horner(_TANHC_SERIES, x_near * x_near), jnp.tanh(x_far) / x_far)


def radial_projection(e: Vector3, e_rate: Vector3) -> Vector3:
    """The part of the eccentricity's rate along the line of centers, P e_rate [m/s].

        P = (e e^T + l**2 I)/(e.e + l**2),    l = CONCENTRIC_RADIUS

    For a concentric ball the line of centers n = e/|e| is undefined, and n n^T jumps with the direction in
    which the ball leaves. A film or a bushing around a concentric ball resists alike in every direction,
    so P passes smoothly from the identity at the center to n n^T.

    Args:
        e: eccentricity, socket center to ball center [m].
        e_rate: its rate [m/s].

    Limits: at e = 0, P = I and dP/de = 0. For |e| >> l, P = n n^T with a relative error (l/|e|)**2: 1e-12
    at a micrometer. P is symmetric with eigenvalues in (0, 1], so a force -k P e_rate never adds energy.
    """
    l2 = CONCENTRIC_RADIUS**2
    return (e * (e @ e_rate) + l2 * e_rate) / (e @ e + l2)

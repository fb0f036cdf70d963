"""The film of a ball that moves in any direction: squeeze and wedge as one vector, and the couple of shear.

On the sphere of film points u (outward, unit) the gap is h = c (1 - eps n.u), and Reynolds' equation to the first order
in c/R is

    div(h**3 grad p) = -12 nu R**2 V.u,    V = e_rate - w x e,    w = (w_socket + w_ball)/2

Squeeze and wedge are this one vector V, which vanishes when both bodies turn as one. Its solution is

    p = (12 nu R**2 / c**3) (2 - eps n.u)/(1 - eps n.u)**2  u.W,    W = V_n n/4 + V_t/(4 + eps**2)

so that the pressure is positive on exactly half of the sphere, u.W > 0, whatever the direction of V. The forces below
are its integrals. They are written in r = e/c and its square: nothing is singular for a concentric ball.

Source: derived here, and checked against a numerical solution of Reynolds' equation (`tests/test_laws_full_film.py`).
Maps for cups with a rim, computed numerically: Goenka and Booker (1980), J. Lubr. Technol. 102, 8-14.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.numerics import horner, safe_norm
from spherejax.foundations.types import Number, Scalar, Vector3

_SERIES_SQUARE = 0.1
"""eps**2 below which the shear factors are summed: above it their differences have lost 1/eps**4 = 100 roundings."""

_ORDERS = range(18)
"""With eps**2 <= 0.1 these terms leave 1e-18."""

_ALONG = tuple(3.0 / ((2 * k + 1) * (2 * k + 3)) for k in _ORDERS)
_EXCESS = tuple(3.0 * k / ((2 * k + 1) * (2 * k + 3)) for k in _ORDERS)[1:]

_NODES, _WEIGHTS = (np.asarray(each) for each in np.polynomial.legendre.leggauss(7))
_QUADRATURE = tuple(zip((_NODES + 1) / 2, _WEIGHTS / 2, strict=True))
"""Of half of a sphere. For eps <= 1/4 the integrand has no singularity within the ellipse of rho = 14: 1e-13."""

_QUADRATURE_SQUARE = 0.25**2
"""eps**2 up to which it serves. Above it the closed form has lost 1/eps**4 = 256 roundings at most."""


class ShearFactors(NamedTuple):
    """Moments of the mean shear stress [-].

    Attributes:
        along: m_par, for a spin along the line of centers.
        excess: (m_perp - m_par)/eps**2; a spin across the line of centers has m_perp.
    """

    along: Scalar
    excess: Scalar


def shear_factors(square: Number) -> ShearFactors:
    """How much more a pair resists relative spin when the ball is eccentric [-].

        m_par = 3/4 (2/eps**2 - (1 - eps**2) L/eps**3) = 3 sum_k eps**(2k)/((2k+1)(2k+3))
        m_perp = 3/8 ((1 + eps**2) L/eps**3 - 2/eps**2) = 3 sum_k (k+1) eps**(2k)/((2k+1)(2k+3))

    with L = ln((1 + eps)/(1 - eps)).

    Args:
        square: eps**2 in [0, 1).

    Limits: m_par = m_perp = 1 at eps = 0; m_par -> 3/2, m_perp -> 3/4 (L - 1) as eps -> 1.

    Source: derived here.
    """
    near = square < _SERIES_SQUARE
    low, high = jnp.where(near, square, 0.0), jnp.where(near, 0.5, square)
    eps = jnp.sqrt(high)
    per_eps = (jnp.log1p(eps) - jnp.log1p(-eps)) / eps
    along = 0.75 * (2.0 - (1.0 - high) * per_eps) / high
    across = 0.375 * ((1.0 + high) * per_eps - 2.0) / high
    return ShearFactors(
        jnp.where(near, horner(_ALONG, low), along), jnp.where(near, horner(_EXCESS, low), (across - along) / high)
    )


def full_sphere_load(r: Vector3, velocity: Vector3) -> Vector3:
    """Load of a film that carries pressure and suction, F = -C load [m/s].

        load = B_t V + (B_r - B_t) n (n.V),    B_r = 4/3 m_par/(1 - eps**2),    B_t = 16/3 m_perp/(4 + eps**2)

    Args:
        r: e/c, shorter than 1.
        velocity: V [m/s].

    Limits: 4/3 V at r = 0, with derivative 0 by r. As eps -> 1, B_r -> 1/(1 - eps), B_t -> 0.8 (ln(2/(1 - eps)) - 1).

    Source: derived here; B_r is B(eps) + B(-eps) of `squeeze_factor`.
    """
    square = r @ r
    along, excess = shear_factors(square)
    across = along + square * excess
    gap, four = 1.0 - square, 4.0 + square
    coupling = 4.0 / 3.0 * (along + 4.0 * across - 4.0 * excess) / (gap * four)
    return 16.0 / 3.0 * across / four * velocity + coupling * (r @ velocity) * r


def half_sphere_load(r: Vector3, velocity: Vector3) -> Vector3:
    """Load of a film that carries pressure only, on the half of the sphere where u.W > 0, F = -C load [m/s].

        load = 4 (a W + d (|W| r - (r.w) W)),    w = W/|W|,    x = n.w
        a = int s**2 (g Q**(-3/2) + Q**(-1/2)) ds,    g = 1 - eps x s,    s from 0 to 1
        d = int s (1 - s**2) (Q**(-3/2) + Q**(-1/2)/(g + Q**(1/2))) ds
        Q = g**2 - eps**2 (1 - x**2)(1 - s**2)

    Q is quadratic in s, so that both are elementary; they are evaluated so for eps > 1/4, and by Gauss and Legendre's
    rule below, where the elementary forms cancel.

    Args:
        r: e/c, shorter than 1.
        velocity: V [m/s].

    Limits: 2/3 V at r = 0. For V along n it is B(eps) V or, separating, B(-eps) V of `squeeze_factor`; for V across n
    half of what `full_sphere_load` has, and a lift that centers the ball. At V = 0, where it has a kink (it is
    homogeneous of degree 1), the load is 0 and its derivative a finite one.

    Source: derived here.
    """
    square = r @ r
    w = film_slope(r, velocity)
    size = safe_norm(w)
    slant = (r @ w) / jnp.where(size > 0, size, 1.0)
    near = square < _QUADRATURE_SQUARE
    a_near, d_near = _by_quadrature(jnp.where(near, square, 0.0), jnp.where(near, slant, 0.0))
    eps = jnp.sqrt(jnp.where(near, 0.64, square))
    a_far, d_far = _elementary(eps, jnp.clip(jnp.where(near, 0.24, slant) / eps, -1.0, 1.0))
    a, d = jnp.where(near, a_near, a_far), jnp.where(near, d_near, d_far)
    return 4.0 * (a * w + d * (size * r - slant * w))


def film_slope(r: Vector3, velocity: Vector3) -> Vector3:
    """W = V_n n/4 + V_t/(4 + eps**2), without n."""
    square = r @ r
    return velocity / (4.0 + square) + r * (r @ velocity) / (4.0 * (4.0 + square))


class PressurePeak(NamedTuple):
    """Where the film presses most.

    Attributes:
        height: p c**3/(12 nu R**2) [m/s].
        place: unit vector from the center to there; zero where nothing presses.
    """

    height: Scalar
    place: Vector3


def pressure_peak(r: Vector3, velocity: Vector3) -> PressurePeak:
    """The largest pressure of the film, the same whether or not it bears suction elsewhere.

        height = max_u (2 - r.u)/(1 - r.u)**2 u.W

    It lies in the plane of r and W, between both: u = W/|W| cos(a) + m sin(a), m across W toward r. A peak near the
    wall is as narrow as sqrt(2 (1 - eps)), and there may be a lower one beside it, so the angle is first looked for on
    a grid that is dense about r, and then by bisection between its neighbors.

    Args:
        r: e/c, shorter than 1.
        velocity: V [m/s].

    Limits: V/2 along V at r = 0; along n (2 - eps)/(1 - eps)**2 V/4 closing, (2 + eps)/(1 + eps)**2 V/4 separating;
    0 at V = 0. Not differentiable where two peaks are as high.

    Source: derived here from the pressure above.
    """
    w = film_slope(r, velocity)
    size = safe_norm(w)
    ahead = w / jnp.where(size > 0, size, 1.0)
    slant = r @ ahead
    across = r - slant * ahead
    lean = safe_norm(across)
    toward = across / jnp.where(lean > 0, lean, 1.0)

    def height(angle):
        q = slant * jnp.cos(angle) + lean * jnp.sin(angle)
        return (2.0 - q) / (1.0 - q) ** 2 * jnp.cos(angle)

    def slope(angle):
        """Of the height's logarithm, times what is positive."""
        sine, cosine = jnp.sin(angle), jnp.cos(angle)
        q, q_rate = slant * cosine + lean * sine, lean * cosine - slant * sine
        return q_rate * (3.0 - q) * cosine - sine * (1.0 - q) * (2.0 - q)

    # Neither the search nor the grid is differentiated: a step of Newton from the peak has its derivative.
    held_slant, held_lean = jax.lax.stop_gradient((slant, lean))
    width = jnp.sqrt(2.0 * jnp.maximum(1.0 - jnp.hypot(held_slant, held_lean), 1e-16))
    about = jnp.arctan2(held_lean, held_slant) + width * jnp.linspace(-4.0, 4.0, 33)
    quarter = jnp.pi / 2
    angles = jnp.clip(jnp.concatenate([jnp.linspace(0.0, quarter, 33), about]), 0.0, quarter)
    top = angles[jnp.argmax(jax.lax.stop_gradient(height(angles)))]
    low = jnp.max(jnp.where(angles < top, angles, 0.0))
    high = jnp.min(jnp.where(angles > top, angles, quarter))

    def halve(_, ends):
        low, high = ends
        middle = (low + high) / 2
        rises = jax.lax.stop_gradient(slope(middle)) > 0
        return jnp.where(rises, middle, low), jnp.where(rises, high, middle)

    low, high = jax.lax.fori_loop(0, 60, halve, (low, high))
    angle = (low + high) / 2
    value, curvature = slope(angle), jax.lax.stop_gradient(jax.grad(slope)(angle))
    angle = angle - jnp.where(curvature < 0, (value - jax.lax.stop_gradient(value)) / curvature, 0.0)
    place = ahead * jnp.cos(angle) + toward * jnp.sin(angle)
    return PressurePeak(size * height(angle), place)


def directions_across(axis: Vector3) -> tuple[Vector3, Vector3]:
    """Two unit vectors across a unit vector, each at right angles to the other, right-handed with the axis last.

    Limits: jump where the z component of the axis changes sign, and are smooth elsewhere; x and y at axis = 0.

    Source: Duff et al. (2017), J. Comput. Graph. Tech. 6 (1):1-8.
    """
    x, y, z = axis[0], axis[1], axis[2]
    sign = jnp.where(z >= 0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    first = jnp.stack([1.0 + sign * x * x * a, sign * x * y * a, -sign * x])
    return first, jnp.stack([x * y * a, sign + y * y * a, -y])


def _by_quadrature(square: Scalar, slant: Scalar) -> tuple[Scalar, Scalar]:
    """a and d from eps**2 and eps x."""
    a, d = [], []
    for s, weight in _QUADRATURE:
        g = 1.0 - slant * s
        q = g * g - (square - slant * slant) * (1.0 - s * s)
        root = jnp.sqrt(q)
        a.append(weight * s * s * (g / q + 1.0) / root)
        d.append(weight * s * (1.0 - s * s) * (1.0 / q + 1.0 / (g + root)) / root)
    return sum(a), sum(d)  # pyright: ignore[reportReturnType]


def _elementary(eps: Scalar, x: Scalar) -> tuple[Scalar, Scalar]:
    """a and d in closed form.

    With y = eps s - x: Q = y**2 + sigma**2, sigma**2 = (1 - eps**2)(1 - x**2), and s and g are linear in y. What is
    left are integrals of y**k Q**(-1/2) and y**k Q**(-3/2) from y0 = -x to y1 = eps - x.
    """
    gap, m = (1.0 - eps) * (1.0 + eps), (1.0 - x) * (1.0 + x)
    y0, y1 = -x, eps - x
    root0, root1 = jnp.sqrt(1.0 - eps * eps * m), 1.0 - eps * x
    root = root1 - root0
    inverse = 1.0 / root1 - 1.0 / root0
    # Where y passes 0 both terms of a difference have one sign; elsewhere the difference is written out.
    passes = (y0 < 0) & (y1 > 0)
    sigma2 = jnp.where(passes, gap * m, 1.0)
    sum_of = y1 * root0 + y0 * root1
    p = jnp.where(
        passes, (y1 * root0 - y0 * root1) / sigma2, eps * (eps - 2.0 * x) / jnp.where(passes, 1.0, sum_of)
    ) / (root0 * root1)  # of Q**(-3/2), times eps
    log0, log1 = jnp.log(jnp.abs(y0) + root0), jnp.log(jnp.abs(y1) + root1)
    v = jnp.where(passes, log0 + log1 - jnp.log(sigma2), jnp.where(x > 0, log0 - log1, log1 - log0))  # of Q**(-1/2)
    rest = v - gap * m * p  # of y**2 Q**(-3/2)
    third = root + gap * m * inverse  # of y**3 Q**(-3/2)
    weighted = (y1 * root1 - y0 * root0) / 2.0 - gap * m * v / 2.0 + 2.0 * x * root + x * x * v  # of s**2 Q**(-1/2)
    a = m * rest - 2.0 * x * m * inverse + x * x * m * p
    a = a - x * (third + 2.0 * x * rest - x * x * inverse) + weighted
    d = x * (m - gap) * p - (eps * eps - 3.0 * x * x) * inverse - 3.0 * x * rest - third
    # The second term of d, s (g Q**(-1/2) - 1) / (eps**2 (1 - x**2)), with the denominator divided out by hand.
    d = d + 1.5 * root + x * v * (1.0 + gap / 2.0) - eps * eps / 2.0 * (1.0 + 1.0 / (1.0 + root0))
    return a / eps**3, d / eps**4

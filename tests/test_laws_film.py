"""Squeeze film: the load factor to rounding, the three boundary conditions, and the blend into contact."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from spherejax.foundations.numerics import CONCENTRIC_RADIUS
from spherejax.physics.laws.film import (
    Guembel,
    PinkusSternlicht,
    Sommerfeld,
    film_force,
    hybrid_weight,
    squeeze_coefficient,
    squeeze_factor,
)

C, R, NU = 1e-4, 0.01, 0.4  # clearance, socket radius, viscosity: the paper's four-bar
BOUNDARIES = [Guembel(), PinkusSternlicht(), Sommerfeld()]
RATIOS = np.concatenate([-np.geomspace(1e-12, 0.95, 40), np.geomspace(1e-12, 0.95, 40), [0.29999, 0.3, 0.30001]])


def exact(eps, terms=900):
    """B and B' by their power series in extended precision, summed from the smallest term."""
    e = np.longdouble(eps)
    k = np.arange(terms, dtype=np.longdouble)
    weights = (k + 2) / (k + 3)
    return float((weights * e**k)[::-1].sum()), float((k[1:] * weights[1:] * e ** (k[1:] - 1))[::-1].sum())


def test_squeeze_factor_to_rounding():
    expected = np.array([exact(eps) for eps in RATIOS])
    np.testing.assert_allclose(jax.vmap(squeeze_factor)(RATIOS), expected[:, 0], rtol=1e-13)
    np.testing.assert_allclose(jax.vmap(jax.grad(squeeze_factor))(RATIOS), expected[:, 1], rtol=1e-11)
    forward = jax.vmap(lambda eps: jax.jvp(squeeze_factor, (eps,), (1.0,))[1])(RATIOS)
    np.testing.assert_allclose(forward, expected[:, 1], rtol=1e-11)


def test_squeeze_factor_in_rational_arithmetic():
    eps = Fraction(1, 8)
    value = sum(Fraction(k + 2, k + 3) * eps**k for k in range(30))
    np.testing.assert_allclose(squeeze_factor(0.125), float(value), rtol=4e-16)


def test_squeeze_factor_closed_form_and_limits():
    for eps in (0.35, 0.6, 0.9, 0.9999, -0.5, -0.99):
        closed = np.log(1 - eps) / eps**3 + 1 / (eps**2 * (1 - eps)) - 1 / (2 * eps)
        np.testing.assert_allclose(squeeze_factor(eps), closed, rtol=1e-13)
    np.testing.assert_allclose(squeeze_factor(0.0), 2 / 3, rtol=1e-15)
    np.testing.assert_allclose(jax.grad(squeeze_factor)(0.0), 3 / 4, rtol=1e-14)
    np.testing.assert_allclose(squeeze_factor(-1 + 1e-12), 1 - np.log(2), rtol=1e-11)
    np.testing.assert_allclose((1e-9) * squeeze_factor(1 - 1e-9), 1.0, rtol=1e-7)
    assert np.isfinite(jax.grad(squeeze_factor)(1 - 1e-12))


def pressure_force(eps, lower, upper):
    """Reynolds' equation for a squeezed spherical gap h = c(1 - eps cos t), per 6 pi nu R (R/c)**3 e_rate.

    d/dt(sin t h**3 dp/dt) = -12 nu R**2 e_rate cos t sin t gives dp/dt = -6 nu R**2 e_rate sin t/h**3, hence
    p = 3 nu R**2 e_rate/(c eps) [1/h**2 - 1/h(pi/2)**2]; the force is 2 pi R**2 times the integral of
    p cos t sin t.
    """

    def integrand(t):
        return (1 / (1 - eps * np.cos(t)) ** 2 - 1) / eps * np.cos(t) * np.sin(t)

    return quad(integrand, lower, upper, epsabs=1e-13, epsrel=1e-12)[0]


@pytest.mark.parametrize("eps", [0.1, 0.5, 0.9])
def test_against_the_pressure_field(eps):
    near, far = pressure_force(eps, 0, np.pi / 2), pressure_force(eps, np.pi / 2, np.pi)
    np.testing.assert_allclose(squeeze_factor(eps), near, rtol=1e-10)
    np.testing.assert_allclose(squeeze_factor(-eps), far, rtol=1e-10)
    np.testing.assert_allclose(Guembel().load_factor(eps, False), near, rtol=1e-10)
    np.testing.assert_allclose(Guembel().load_factor(eps, True), far, rtol=1e-10)
    np.testing.assert_allclose(Sommerfeld().load_factor(eps, True), near + far, rtol=1e-10)
    np.testing.assert_allclose(Sommerfeld().load_factor(eps, False), near + far, rtol=1e-10)
    np.testing.assert_allclose(PinkusSternlicht().load_factor(eps, True), near, rtol=1e-10)


def test_squeeze_coefficient():
    np.testing.assert_allclose(squeeze_coefficient(NU, R, C), 6 * np.pi * 0.4 * 0.01 * 1e6, rtol=1e-13)
    centered = squeeze_coefficient(NU, R, 5e-5) * squeeze_factor(0.0)
    np.testing.assert_allclose(centered, 4e5, rtol=0.01)  # N s/m, quoted for the tightest clearance


def force(e, e_rate, boundary=BOUNDARIES[0], offset=0.0):
    return film_force(e, e_rate, C, R, NU, boundary, offset)


@pytest.mark.parametrize("boundary", BOUNDARIES, ids=lambda b: type(b).__name__)
def test_force_opposes_radial_motion(boundary):
    n = jnp.array([2.0, -3.0, 6.0]) / 7
    across = jnp.array([3.0, 2.0, 0.0])
    for rate in (0.03, -0.03):
        expected = -squeeze_coefficient(NU, R, C) * boundary.load_factor(0.4, rate < 0) * rate * n
        scale = np.abs(expected).max()
        np.testing.assert_allclose(force(0.4 * C * n, rate * n, boundary), expected, atol=1e-13 * scale)
        slid = force(0.4 * C * n, rate * n + 0.01 * across, boundary)
        np.testing.assert_allclose(slid, expected, atol=1e-13 * scale)  # no resistance across the line of centers
    offset = force(0.4 * C * n, rate * n, boundary, 2e-6)
    ratio = 0.4 * C / (C + 2e-6)
    np.testing.assert_allclose(
        offset, expected * boundary.load_factor(ratio, True) / boundary.load_factor(0.4, True), rtol=1e-12
    )


@pytest.mark.parametrize("boundary", BOUNDARIES, ids=lambda b: type(b).__name__)
def test_concentric_ball(boundary):
    rate = jnp.array([0.02, -0.01, 0.03])
    damping = squeeze_coefficient(NU, R, C) * boundary.load_factor(0.0, False)
    np.testing.assert_allclose(force(jnp.zeros(3), rate, boundary), -damping * rate, rtol=1e-14)
    for jacobian in (jax.jacfwd, jax.jacrev):
        by_e, by_rate = jacobian(lambda e, r: force(e, r, boundary), (0, 1))(jnp.zeros(3), rate)
        np.testing.assert_array_equal(by_e, 0.0)
        np.testing.assert_allclose(by_rate, -damping * np.eye(3), rtol=1e-14)


@pytest.mark.parametrize("boundary", BOUNDARIES, ids=lambda b: type(b).__name__)
@pytest.mark.parametrize("length", [3 * CONCENTRIC_RADIUS, 1e-7, 0.299 * C, 0.7 * C, 0.999 * C])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_derivatives_agree(boundary, length, sign):
    e = length * jnp.array([2.0, -3.0, 6.0]) / 7
    rate = sign * jnp.array([0.02, -0.01, 0.03])
    step = 1e-5 * min(length, C - length)
    f = lambda e: force(e, rate, boundary)  # noqa: E731
    forward, reverse = jax.jacfwd(f)(e), jax.jacrev(f)(e)
    differences = np.array([(f(e + h) - f(e - h)) / (2 * step) for h in step * np.eye(3)]).T
    scale = np.abs(forward).max()
    np.testing.assert_allclose(forward, reverse, atol=1e-12 * scale)
    np.testing.assert_allclose(forward, differences, atol=1e-7 * scale)


@pytest.mark.parametrize("boundary", BOUNDARIES, ids=lambda b: type(b).__name__)
@pytest.mark.parametrize("length", [C * (1 - 1e-13), C, C + 1.5e-6, C + 3e-6, 10 * C])
@pytest.mark.parametrize("offset", [0.0, 2e-6])
def test_finite_beyond_the_wall(boundary, length, offset):
    e, rate = jnp.array([0.0, length, 0.0]), jnp.array([0.1, 0.3, 0.0])
    assert np.isfinite(force(e, rate, boundary, offset)).all()
    for jacobian in (jax.jacfwd, jax.jacrev):
        by_e, by_clearance = jacobian(
            lambda e, c: (1 - hybrid_weight(e[1], c, 1e-6)) * film_force(e, rate, c, R, NU, boundary, offset),
            (0, 1),
        )(e, C)
        assert np.isfinite(by_e).all()
        assert np.isfinite(by_clearance).all()


def test_every_direction_of_rate_dissipates():
    key = np.random.default_rng(1)
    e = key.normal(size=(500, 3))
    e *= (C * key.uniform(0, 0.99, 500) / np.linalg.norm(e, axis=1))[:, None]
    rate = key.normal(size=(500, 3))
    for boundary in BOUNDARIES:
        power = jax.vmap(lambda e, r, b=boundary: force(e, r, b) @ r)(e, rate)
        assert power.max() <= 0


def test_hybrid_weight():
    width = 1e-6
    weights = jax.vmap(lambda e: hybrid_weight(e, C, width))(C + width * np.array([-50, 0.0, 0.25, 0.5, 1.001, 90]))
    np.testing.assert_allclose(weights, [0, 0, 0.25, 0.5, 1, 1], atol=1e-9)
    slope = jax.grad(hybrid_weight)
    np.testing.assert_allclose(slope(C + 0.5 * width, C, width), 1 / width, rtol=1e-12)
    for e in (0.5 * C, C, C + 2 * width):
        assert slope(e, C, width) == 0.0
    for e, expected in ((0.5 * C, 0.0), (C, 0.0), (C * (1 + 1e-12), 1.0), (2 * C, 1.0)):
        assert hybrid_weight(e, C, 0.0) == expected
        np.testing.assert_array_equal(jax.grad(hybrid_weight, (0, 1, 2))(e, C, 0.0), 0.0)

"""Guarded functions: value, forward, reverse and finite differences, at and near the singular point."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spherejax.foundations.numerics import (
    CONCENTRIC_RADIUS,
    horner,
    positive_power,
    radial_projection,
    safe_divide,
    safe_norm,
    safe_sqrt,
    tanhc,
)


def derivatives(f, x):
    """Jacobians of f at x: forward and reverse."""
    return jax.jacfwd(f)(x), jax.jacrev(f)(x)


def central(f, x, step):
    x = np.asarray(x, float)
    columns = [(f(x + h) - f(x - h)) / (2 * step) for h in step * np.eye(x.size).reshape(-1, *x.shape)]
    return np.moveaxis(np.array(columns), 0, -1).reshape(*np.shape(columns[0]), *x.shape)


@pytest.mark.parametrize("scale", [1e-30, 1e-12, 1e-4, 1.0, 1e10])
def test_safe_norm_is_exact_at_every_scale(scale):
    x = scale * jnp.array([3.0, -4.0, 12.0])
    value, gradient = jax.value_and_grad(safe_norm)(x)
    np.testing.assert_allclose(value, 13.0 * scale, rtol=4e-16)
    assert value == safe_norm(x)
    np.testing.assert_allclose(gradient, x / (13.0 * scale), rtol=1e-15)


def test_safe_norm_at_zero():
    value, gradient = jax.value_and_grad(safe_norm)(jnp.zeros(3))
    assert value == 0.0
    np.testing.assert_array_equal(gradient, 0.0)
    np.testing.assert_array_equal(jax.jacfwd(safe_norm)(jnp.zeros(3)), 0.0)
    np.testing.assert_array_equal(jax.hessian(safe_norm)(jnp.zeros(3)), 0.0)
    gradients = jax.vmap(jax.grad(safe_norm))(jnp.array([[0.0, 0, 0], [0, 2.0, 0]]))
    np.testing.assert_array_equal(gradients, [[0, 0, 0], [0, 1, 0]])  # a zero row spoils no other


def test_safe_sqrt():
    assert safe_sqrt(4.0) == 2.0
    for x in (0.0, -1.0):
        assert safe_sqrt(x) == 0.0
        assert jax.grad(safe_sqrt)(x) == 0.0
    np.testing.assert_allclose(jax.grad(safe_sqrt)(4.0), 0.25, rtol=1e-15)


def test_safe_divide():
    assert safe_divide(3.0, 2.0) == 1.5
    assert safe_divide(3.0, 0.0) == 0.0
    np.testing.assert_array_equal(jax.grad(safe_divide, (0, 1))(3.0, 0.0), (0.0, 0.0))
    np.testing.assert_allclose(jax.grad(safe_divide, (0, 1))(3.0, 2.0), (0.5, -0.75), rtol=1e-15)


@pytest.mark.parametrize("n", [1.0, 1.5, 2, 3.7])
def test_positive_power(n):
    for x in (-1e-5, 0.0):
        assert positive_power(x, n) == 0.0
        assert jax.grad(positive_power)(x, n) == 0.0
        assert jax.grad(positive_power, 1)(x, float(n)) == 0.0
    x = 2.6e-5
    np.testing.assert_allclose(positive_power(x, n), x**n, rtol=1e-15)
    np.testing.assert_allclose(jax.grad(positive_power)(x, n), n * x ** (n - 1), rtol=1e-14)
    np.testing.assert_allclose(jax.grad(positive_power, 1)(x, float(n)), x**n * np.log(x), rtol=1e-14)
    tiny = 1e-200
    assert np.isfinite(jax.grad(positive_power)(tiny, n))


def test_tanhc_against_extended_precision_and_limits():
    x = np.concatenate([np.geomspace(1e-9, 50.0, 400), [0.0999999, 0.1, 0.1000001]])
    exact = np.tanh(x.astype(np.longdouble)) / x
    np.testing.assert_allclose(jax.vmap(tanhc)(x), exact.astype(float), rtol=2e-15)
    long = x.astype(np.longdouble)
    slope = ((1 - np.tanh(long) ** 2) - np.tanh(long) / long) / long
    usable = x > 1e-2  # the reference itself cancels below
    np.testing.assert_allclose(jax.vmap(jax.grad(tanhc))(x)[usable], slope[usable].astype(float), rtol=3e-13)
    np.testing.assert_allclose(jax.vmap(jax.grad(tanhc))(x[x < 1e-3]), -2 / 3 * x[x < 1e-3], rtol=2e-6)
    assert tanhc(0.0) == 1.0
    assert jax.grad(tanhc)(0.0) == 0.0
    np.testing.assert_allclose(jax.grad(jax.grad(tanhc))(0.0), -2 / 3, rtol=1e-15)
    assert tanhc(-0.7) == tanhc(0.7)
    np.testing.assert_allclose(tanhc(1e6), 1e-6, rtol=1e-15)


def test_horner():
    assert horner((1.0, -2.0, 3.0), 2.0) == 9.0
    assert horner((5.0,), 2.0) == 5.0


rate = jnp.array([0.02, -0.01, 0.03])


def test_radial_projection_limits():
    np.testing.assert_array_equal(radial_projection(jnp.zeros(3), rate), rate)
    for jacobian in derivatives(lambda e: radial_projection(e, rate), jnp.zeros(3)):
        np.testing.assert_array_equal(jacobian, 0.0)
    np.testing.assert_allclose(jax.jacfwd(radial_projection, 1)(jnp.zeros(3), rate), np.eye(3), rtol=1e-15)
    for length in (1e-7, 1e-4, 1.0):
        n = jnp.array([2.0, -3.0, 6.0]) / 7
        expected = n * (n @ rate)
        error = np.abs(radial_projection(length * n, rate) - expected).max()
        assert error < (2 * (CONCENTRIC_RADIUS / length) ** 2 + 4e-16) * np.abs(rate).max()
    for length in (1e-300, 1e-40, 1e-15):
        assert np.isfinite(jax.jacfwd(radial_projection)(length * n, rate)).all()


@pytest.mark.parametrize("length", [0.3 * CONCENTRIC_RADIUS, CONCENTRIC_RADIUS, 30 * CONCENTRIC_RADIUS, 1e-4])
def test_radial_projection_derivatives_agree(length):
    e = length * jnp.array([2.0, -3.0, 6.0]) / 7
    forward, reverse = derivatives(lambda e: radial_projection(e, rate), e)
    differences = central(lambda e: radial_projection(e, rate), e, 1e-5 * length)
    scale = np.abs(forward).max()
    np.testing.assert_allclose(forward, reverse, atol=1e-14 * scale)
    np.testing.assert_allclose(forward, differences, atol=1e-8 * scale)
    P = jax.jacfwd(radial_projection, 1)(e, rate)
    eigenvalues = np.linalg.eigvalsh(P)
    assert eigenvalues.min() > 0.0 or length > 1e-6  # rounding alone may reach zero far out
    assert eigenvalues.max() <= 1.0 + 1e-15
    np.testing.assert_allclose(P, P.T, atol=1e-16)

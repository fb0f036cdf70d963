"""Steps of Runge-Kutta methods on linear equations, whose ends are known polynomials and fractions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spherejax.compiler import native_code, scalarize
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.runge_kutta import Tableau, explicit_stages

A = np.array([[0, 0, 0, 0], [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1, 0]])
RK4 = Tableau.explicit(A, np.array([0, 0.5, 0.5, 1]), [np.array([1, 2, 2, 1]) / 6])
H = 0.3


def end_of(z):
    """y(h) / y(0) of y' = z / h y, by a method of order 4 with four stages."""
    return 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24


def test_array_code_of_an_explicit_step():
    y, rate = jnp.array([1.0, -2.0]), jnp.array([0.7, -1.1])

    def end(rate, y):
        return y + RK4.sums_of(RK4.stages(lambda t, y: rate * y, jnp.zeros(()), jnp.array(H), jnp.array(H), y))[0]

    np.testing.assert_allclose(end(rate, y), y * end_of(rate * H), rtol=1e-15)
    # In reverse, too: d(end)/d(rate) = h y P'(z).
    slope = jax.grad(lambda rate: jnp.sum(end(rate, y)))(rate)
    z = rate * H
    np.testing.assert_allclose(slope, H * y * (1 + z + z**2 / 2 + z**3 / 6), rtol=1e-14)


def test_array_code_of_a_rosenbrock_step():
    """With one stage, and gamma = 1, it is the implicit Euler method of a linear equation."""
    euler = Tableau(A=((0.0,),), c=(0.0,), sums=((1.0,),), C=((0.0,),), d=(0.0,), gamma=1.0)
    rate, y, h = -2.5, jnp.array([1.0, 3.0]), jnp.array(H)
    k = euler.stages(lambda t, y: rate * y, jnp.zeros(()), h, h, y, solve=lambda b: b / (1 - h * rate))
    np.testing.assert_allclose(y + euler.sums_of(k)[0], y / (1 - H * rate), rtol=1e-15)


@pytest.mark.skipif(not machine_code.is_available(), reason="no machine code with this jaxlib")
@pytest.mark.parametrize("n_runs", [1, 3])
def test_an_explicit_step_in_one_call(n_runs):
    """Of one run, of several, and of each of more by `jax.vmap`."""
    rates = -0.5 + jnp.arange(float(n_runs))[None] / 4
    program = scalarize(lambda theta, t, y: theta[0] * y, rates[:, 0], jnp.zeros(()), jnp.ones(2))

    def end(h, rates):
        t, lengths, y = jnp.zeros(n_runs), jnp.full(n_runs, 1.0) * h, jnp.ones((2, n_runs))
        called = explicit_stages(program, RK4, t, lengths, jnp.zeros(n_runs), y, 4, rates, ())
        assert called is not None
        return y + called[1][0]

    lengths = jnp.array([0.1, 0.3])
    with native_code():
        one, several = jax.jit(end)(lengths[1], rates), jax.jit(jax.vmap(end, (0, None)))(lengths, rates)
    np.testing.assert_allclose(one, jnp.tile(end_of(rates * 0.3), (2, 1)), rtol=1e-15)
    np.testing.assert_allclose(several, [jnp.tile(end_of(rates * h), (2, 1)) for h in lengths], rtol=1e-15)

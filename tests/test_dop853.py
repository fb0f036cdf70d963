"""DOP853: coefficients, order conditions, states inside a step, its error, and runs by all ways."""

from dataclasses import replace

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from scipy.integrate import DOP853

import spherejax as sj
from spherejax.motion.integration.lanes.inside import _density, _stage_weights, trees_of
from spherejax.motion.solvers.dop853 import TwoErrors

TABLEAU = sj.solvers.Dop853.tableau
TS = jnp.linspace(0.0, 0.1, 6)


def stages(tableau=TABLEAU):
    """a and c of all."""
    n = len(tableau.b_sol)
    a = np.zeros((n, n))
    for i, row in enumerate(tableau.a_lower, start=1):
        a[i, :i] = row
    return a, np.concatenate([[0.0], tableau.c])


def defects(weights, a, order):
    """How far weights are from each condition of an order."""
    return np.array([weights @ _stage_weights(tree, a) - 1 / _density(tree) for tree in trees_of(order)])


def test_the_coefficients_are_those_of_scipy():
    a, c = stages()
    assert np.array_equal(a[:12, :12], DOP853.A)
    assert np.array_equal(a[13:], DOP853.A_EXTRA)
    assert np.array_equal(c[:12], DOP853.C)
    assert np.array_equal(c[13:], DOP853.C_EXTRA)
    assert np.array_equal(TABLEAU.b_sol[:12], DOP853.B)
    assert np.array_equal(a[12, :12], DOP853.B)
    assert np.array_equal(TABLEAU.b_error[:13], DOP853.E5)
    assert np.array_equal(TABLEAU.b_lower[:13], DOP853.E3)


def test_the_order_conditions_hold():
    """Of the step up to 8; of the methods that its error is the difference from, up to 5 and 3."""
    a, _ = stages()
    weights = TABLEAU.b_sol
    methods = ((weights, 8), (weights - TABLEAU.b_error, 5), (weights - TABLEAU.b_lower, 3))
    for method, order in methods:
        held = [np.abs(defects(method, a, n)).max() < 1e-13 for n in range(1, order + 2)]
        assert held == [True] * order + [False]


def stable_up_to(tableau, direction):
    """The first h |lambda| with |R(h lambda)| > 1, R(z) = 1 + z b (I - z A)^-1 1."""
    a, _ = stages(tableau)
    powers = [np.ones(len(a))]
    for _ in a:
        powers.append(a @ powers[-1])
    factors = [1.0, *(tableau.b_sol @ power for power in powers)]
    sizes = np.arange(0.01, 10.0, 0.01)
    grows = np.abs(np.polynomial.polynomial.polyval(direction * sizes, factors)) > 1 + 1e-6
    return sizes[np.argmax(grows)]


@pytest.mark.parametrize(("direction", "found"), [(-1, (5.2, 6.4)), (1j, (3.7, 6.0))])
def test_it_is_stable_over_longer_steps_than_dopri8(direction, found):
    tableaus = diffrax.Dopri8.tableau, TABLEAU
    assert [stable_up_to(tableau, direction) for tableau in tableaus] == pytest.approx(found, abs=0.05)


def step_by_scipy(h):
    """A step, as SciPy makes it, of an oscillator that is driven."""
    solver = DOP853(
        lambda t, y: rate(t, y, None, np), 0.3, np.array([1.0, 0.5]), 2.0, first_step=h, rtol=1e-3, atol=1e3
    )
    solver.step()
    return solver


def rate(t, y, args=None, np=jnp):
    return np.stack([y[1], -4 * np.sin(y[0]) + np.cos(3 * t)])


def step_of_ours(h):
    term, y = diffrax.ODETerm(rate), jnp.array([1.0, 0.5])
    return sj.solvers.Dop853().step(
        term, 0.3, 0.3 + h, y, None, sj.solvers.Dop853().init(term, 0.3, 0.3 + h, y, None), False
    )


def test_a_step_is_scipys_inside_too():
    h = 0.2
    theirs, (y1, _, dense_info, _, _) = step_by_scipy(h), step_of_ours(h)
    np.testing.assert_allclose(y1, theirs.y, rtol=1e-14)
    inside = sj.solvers.Dop853.interpolation_cls(t0=0.3, t1=0.3 + h, **dense_info)
    of_theirs = theirs.dense_output()
    for share in (0.0, 0.1, 0.37, 0.8, 1.0):
        np.testing.assert_allclose(inside.evaluate(0.3 + share * h), of_theirs(0.3 + share * h), rtol=1e-13)
    between = inside.evaluate(0.35, 0.45)
    np.testing.assert_allclose(between, of_theirs(0.45) - of_theirs(0.35), rtol=1e-11)


def test_its_error_is_hairers_of_one_component():
    """Of a state of one entry the norms are its entries."""
    term, y = diffrax.ODETerm(lambda t, y, args: -y * y), jnp.array([1.0])
    _, error, dense_info, _, _ = sj.solvers.Dop853().step(term, 0.0, 0.5, y, None, (True, y), False)
    made = np.asarray(dense_info["k"])[:13]
    theirs = DOP853(lambda t, y: -y * y, 0.0, np.array([1.0]), 2.0)
    expected = theirs._estimate_error_norm(made / 0.5, 0.5, np.ones(1))
    assert abs(float(error[0])) == pytest.approx(expected, rel=1e-12)


def test_no_error_is_none_and_has_a_derivative():
    values, slopes = jax.jvp(TwoErrors.together, (jnp.zeros(2), jnp.array([0.0, 1.0])), (jnp.ones(2), jnp.ones(2)))
    assert values.tolist() == [0.0, 0.0]
    assert np.isfinite(slopes).all()


def test_errors_of_any_size_are_told():
    """A trial step far beyond a wall has errors whose squares are no numbers."""
    for size in (1e-200, 1e200):
        found = TwoErrors.together(size * jnp.array([3.0, -3.0, 0.0]), size * jnp.array([40.0, 0.0, 1.0]))
        np.testing.assert_allclose(found / size, [9 / 5, 3, 0], rtol=1e-15)


def test_a_step_without_length_is_its_start():
    _, _, dense_info, _, _ = step_of_ours(0.0)
    inside = sj.solvers.Dop853.interpolation_cls(t0=0.3, t1=0.3, **dense_info)
    assert inside.evaluate(0.3).tolist() == [1.0, 0.5]


def test_errors_fall_with_the_eighth_power():
    """Of steps and of states inside them (seventh), and the estimate with the eighth of the step."""
    exact = scipy.integrate.solve_ivp(
        lambda t, y: rate(t, y, None, np), (0.3, 2.3), [1.0, 0.5], "DOP853", rtol=1e-13, atol=1e-14, dense_output=True
    ).sol

    @eqx.filter_jit
    def run(n):
        return diffrax.diffeqsolve(
            diffrax.ODETerm(rate),
            sj.solvers.Dop853(),
            0.3,
            2.3,
            2.0 / n,
            jnp.array([1.0, 0.5]),
            saveat=diffrax.SaveAt(ts=jnp.array([1.37, 2.3])),
        ).ys

    errors = np.array([np.abs(run(jnp.asarray(float(n))) - exact(np.array([1.37, 2.3])).T).max(1) for n in (5, 10)])
    inside, end = np.log2(errors[0] / errors[1])
    assert inside > 6.5
    assert end > 7.5
    estimates = [np.abs(step_of_ours(h)[1]).max() for h in (0.1, 0.05)]
    assert np.log2(estimates[0] / estimates[1]) == pytest.approx(8, abs=0.6)


def height(joint, scale, **options):
    """Of the rocker at all samples, under a share of gravity."""
    scene = sj.gallery.four_bar(joint)
    scene = replace(scene, gravity=scale * jnp.asarray(scene.gravity))
    return sj.simulate(scene, TS, **options).position("rocker")[:, 2]


def test_a_run_is_that_of_dopri8():
    run, expected = (
        height(sj.Ideal(), 1.0, rtol=1e-9, solver=solver) for solver in (sj.solvers.Dop853(), diffrax.Dopri8())
    )
    np.testing.assert_allclose(run, expected, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("joint", [sj.Ideal(), sj.Dry(1e-4, friction=sj.Threlfall(mu=0.1))], ids=["ideal", "dry"])
def test_runs_with_derivatives_in_lanes_and_by_diffrax_are_those_of_dopri8(joint):
    of_ours = {"rtol": 1e-9, "solver": sj.solvers.Dop853()}
    moved = (1.0,), (1.0,)
    expected, slope = jax.jvp(lambda x: height(joint, x, rtol=1e-11, solver=diffrax.Dopri8()), *moved)
    found, along = jax.jvp(lambda x: height(joint, x, **of_ours), *moved)
    np.testing.assert_allclose(found, expected, atol=1e-11)
    np.testing.assert_allclose(along, slope, rtol=1e-6, atol=1e-6 * np.abs(slope).max())
    many = jax.vmap(lambda x: height(joint, x, **of_ours))(jnp.array([1.0, 0.5]))
    np.testing.assert_allclose(many[0], expected, atol=1e-11)
    alone = height(joint, 1.0, adjoint=diffrax.RecursiveCheckpointAdjoint(), **of_ours)
    np.testing.assert_allclose(alone, expected, atol=1e-11)

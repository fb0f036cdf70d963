"""Robust losses in fits: SciPy's losses on the closed form, derivatives, intervals that cover the truth."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from fitting import DAMPER, INSTANTS, SENSOR, SPRING, START, oscillation, oscillator, seen
from scipy import optimize

import spherejax as sj
from spherejax.studies.fit import Whole, problem_of
from spherejax.studies.fit.losses import rooted

X = "position.ball.x"
TRUTH = {"stiffness": SPRING, "damping": DAMPER}
LOSSES = {"huber": (sj.studies.Huber(1.5), 1.5), "cauchy": (sj.studies.Cauchy(2.0), 2.0)}


def with_outliers(seed=0, share=0.1, ts=INSTANTS):
    """One reading in ten is off by thirty times the noise, to one side."""
    data = seen(seed, ts)
    rng = np.random.default_rng(1000 + seed)
    off = np.where(rng.uniform(size=ts.size) < share, 30 * SENSOR * rng.uniform(0.5, 1.5, ts.size), 0.0)
    return {**data, X: data[X] + off}


@pytest.mark.parametrize("name", LOSSES)
def test_estimates_are_those_of_scipys_loss_on_the_closed_form(name):
    loss, scale = LOSSES[name]
    data = with_outliers()
    fitted = sj.fit(
        oscillator, START, data, noise=SENSOR, loss=loss, method=sj.studies.LevenbergMarquardt(tolerance=1e-4)
    )
    plain = sj.fit(oscillator, START, data, noise=SENSOR)

    def residuals(p):
        return (oscillation(stiffness=p[0], damping=p[1]) - data[X]) / SENSOR

    scipy = optimize.least_squares(
        residuals, [SPRING, DAMPER], loss=name, f_scale=scale, x_scale=[SPRING, DAMPER], xtol=1e-14, ftol=1e-14
    )
    assert fitted.cost == pytest.approx(scipy.cost, rel=1e-4)
    for key, value in zip(TRUTH, scipy.x, strict=True):
        assert fitted.estimates[key] == pytest.approx(value, abs=0.02 * fitted.standard_deviations[key])
        assert abs(fitted.estimates[key] - TRUTH[key]) < abs(plain.estimates[key] - TRUTH[key])
    outliers = np.abs(residuals(scipy.x)) > 4
    assert f"{outliers.sum()} outliers beyond 4 standard deviations" in str(fitted)
    np.testing.assert_allclose(fitted.residuals["experiment 1"][X], residuals(scipy.x), atol=0.05)


@pytest.mark.parametrize("name", LOSSES)
def test_a_loss_is_what_its_functions_say(name):
    loss, _ = LOSSES[name]
    r = np.array([-1e3, -2.5, -0.3, 0.0, 1e-160, 0.1, 1.4999, 1.5001, 2.0, 40.0])
    slopes = jax.vmap(jax.grad(loss.cost))(jnp.asarray(r))
    np.testing.assert_allclose(loss.slope(r), slopes, rtol=1e-12)
    np.testing.assert_allclose(loss.curvature(r), jax.vmap(jax.grad(loss.slope))(jnp.asarray(r)), rtol=1e-9)
    roots, by_residual = rooted(loss, r)
    np.testing.assert_allclose(np.asarray(roots) ** 2 / 2, loss.cost(r), rtol=1e-12, atol=1e-300)
    np.testing.assert_allclose(np.asarray(roots * by_residual), slopes, rtol=1e-9, atol=1e-150)
    np.testing.assert_allclose(loss.residual(np.asarray(roots)), r, rtol=1e-9, atol=1e-150)
    with pytest.raises(sj.SceneError, match="must be a positive number"):
        type(loss)(0.0)


@pytest.mark.slow
def test_gradients_in_reverse_are_those_of_the_loss():
    data = sj.Measured(INSTANTS, {X: with_outliers()[X]})
    problem = problem_of(oscillator, START, [data], SENSOR, loss=sj.studies.Cauchy())
    u = problem.u0 + 0.1
    residuals, jacobian = problem.residuals_and_jacobian(u)
    reverse = problem.cost_and_gradient(u)
    assert reverse.cost == pytest.approx(float(residuals @ residuals) / 2, rel=1e-6)
    np.testing.assert_allclose(reverse.gradient, jacobian.T @ residuals, rtol=1e-5)
    with pytest.raises(sj.SceneError, match="likelihood is that of normal errors"):
        problem.log_likelihood(u)


def test_noise_is_estimated_without_the_outliers():
    fitted = sj.fit(oscillator, START, with_outliers(), loss=sj.studies.Huber())
    assert fitted.noise[0][0, 0] == pytest.approx(SENSOR, rel=0.35)
    plain = sj.fit(oscillator, START, with_outliers())
    assert plain.noise[0][0, 0] > 5 * SENSOR
    for name, truth in TRUTH.items():
        assert abs(fitted.estimates[name] - truth) < 4 * fitted.standard_deviations[name]
        assert fitted.standard_deviations[name] < 0.5 * plain.standard_deviations[name]


def test_what_is_no_loss_is_refused():
    for wrong in ("huber", sj.studies.Huber, 1.5):
        with pytest.raises(sj.SceneError, match=r"loss must be sj\.studies\.Huber\(\)"):
            sj.fit(oscillator, START, seen(), noise=SENSOR, loss=wrong)


@pytest.mark.slow
@pytest.mark.parametrize("loss", [sj.studies.Huber(), sj.studies.Cauchy()])
def test_intervals_cover_the_truth_where_one_reading_in_ten_is_wrong(loss):
    """Errors of ten times the noise to both sides: without bias, and no formula of normal errors holds."""
    n, covered = 200, np.zeros(2)
    for seed in range(n):
        rng = np.random.default_rng(seed)
        size = np.where(rng.uniform(size=INSTANTS.size) < 0.1, 10.0, 1.0)
        data = {"time": INSTANTS, X: oscillation() + SENSOR * size * rng.normal(size=INSTANTS.size)}
        fitted = sj.fit(oscillator, TRUTH, data, noise=SENSOR, loss=loss, horizon=Whole())
        intervals = fitted.interval()
        covered += [intervals[name][0] < truth < intervals[name][1] for name, truth in TRUTH.items()]
    # Binomial with 0.95 of 200: 181 to 198 in all but 0.2 percent of the cases.
    assert np.all((covered >= 181) & (covered <= 198)), covered


@pytest.mark.slow
def test_descent_finds_the_same_with_a_loss():
    fitted = sj.fit(oscillator, TRUTH, with_outliers(), noise=SENSOR, loss=sj.studies.Huber())
    by_descent = sj.fit(
        oscillator, TRUTH, with_outliers(), noise=SENSOR, loss=sj.studies.Huber(), horizon=Whole(),
        method=sj.studies.Descent(optax.adam(1e-3), n_steps=300, reverse=True),
    )  # fmt: skip
    for name in TRUTH:
        assert by_descent.estimates[name] == pytest.approx(
            fitted.estimates[name], abs=0.2 * fitted.standard_deviations[name]
        )

"""Intervals with correlated errors: autoregressive processes against closed forms, and coverage of the truth."""

import re

import numpy as np
import pytest
from fitting import DAMPER, INSTANTS, SENSOR, SPRING, START, oscillation, oscillator
from scipy import linalg, signal, stats

import spherejax as sj
from spherejax.studies.fit import Whole
from spherejax.studies.fit.correlation import ChannelResiduals, Process, correlated_errors

X = "position.ball.x"
TS = np.linspace(0.02, 2.0, 200)
TRUTH = {"stiffness": SPRING, "damping": DAMPER}


def autoregressive(factor, n, rng) -> np.ndarray:
    """An AR(1) process with unit variance."""
    return np.sqrt(1 - factor**2) * signal.lfilter([1.0], [1.0, -factor], rng.normal(size=n + 500))[500:]


def model(n: int) -> np.ndarray:
    """Columns of a linear model: a decaying vibration, its phase, and a constant."""
    t = np.linspace(0, 2, n)
    decay = np.exp(-0.4 * t)
    return np.stack([t * decay * np.cos(10 * t), decay * np.sin(10 * t), np.ones(n)], 1)


def one_channel(n: int) -> list[ChannelResiduals]:
    return [ChannelResiduals("x", np.arange(n), (0, b"x"))]


def test_a_process_has_the_covariances_of_its_closed_form():
    factor, n = 0.9, 300
    process = Process(np.array([factor]), 2.0)
    expected = 2.0 * factor ** np.arange(n) / (1 - factor**2)
    np.testing.assert_allclose(process.covariances(n), expected, rtol=1e-9, atol=1e-12)
    jacobian = model(n)
    driven = process.driven(jacobian)
    meat = process.variance * driven.T @ driven
    np.testing.assert_allclose(meat, jacobian.T @ linalg.toeplitz(expected) @ jacobian, rtol=1e-9)


def test_white_errors_change_nothing_and_correlated_ones_widen():
    rng = np.random.default_rng(0)
    n, jacobian = 2000, model(2000)
    assert correlated_errors(rng.normal(size=n), jacobian, one_channel(n), 1.0, is_known=True) is None
    residuals = autoregressive(0.8, n, rng)
    residuals -= jacobian @ np.linalg.lstsq(jacobian, residuals)[0]
    answer = correlated_errors(residuals, jacobian, one_channel(n), 1.0, is_known=False)
    assert answer.orders["x"] >= 1
    assert answer.neighbours["x"] == pytest.approx(0.8, abs=0.05)
    exact = jacobian.T @ linalg.toeplitz(0.8 ** np.arange(n)) @ jacobian
    assert np.all(np.abs(np.sqrt(np.diagonal(answer.meat) / np.diagonal(exact)) - 1) < 0.2)
    # The same errors in two channels tell no more than one of them.
    both = [ChannelResiduals("x", np.arange(n), (0, b"")), ChannelResiduals("y", np.arange(n, 2 * n), (0, b""))]
    twice = np.concatenate([residuals, residuals + 1e-3 * rng.normal(size=n)])
    doubled = correlated_errors(twice, np.concatenate([jacobian] * 2), both, 1.0, is_known=False)
    assert doubled.across["x", "y"] > 0.99
    np.testing.assert_allclose(np.diagonal(doubled.meat), 4 * np.diagonal(answer.meat), rtol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.0, 0.5, 0.8, 0.95])
@pytest.mark.parametrize("n", [200, 500])
def test_intervals_of_a_linear_model_cover_the_truth(factor, n):
    """2,000 refits each: 93 to 97 of 100, where independent errors would claim so of 20 to 75."""
    rng = np.random.default_rng(1)
    jacobian = model(n)
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    covered, naive, draws = np.zeros(3), np.zeros(3), 2000
    for _ in range(draws):
        errors = autoregressive(factor, n, rng)
        off = inverse @ (jacobian.T @ errors)
        residuals = errors - jacobian @ off
        variance = residuals @ residuals / (n - 3)
        answer = correlated_errors(residuals, jacobian, one_channel(n), variance, is_known=False)
        white = np.sqrt(variance * np.diagonal(inverse)) * stats.t.ppf(0.975, n - 3)
        if answer is None:
            reach = white
        else:
            deviations = np.sqrt(np.diagonal(inverse @ answer.meat @ inverse))
            reach = deviations * stats.t.ppf(0.975, answer.degrees_of_freedom)
        covered += np.abs(off) < reach
        naive += np.abs(off) < white
    # 200 samples of a process that lasts 20 of them are ten independent ones.
    low, high = (0.93, 0.97) if factor < 0.9 else (0.90, 0.985)
    assert np.all((covered / draws > low) & (covered / draws < high)), covered / draws
    assert factor < 0.5 or np.all(naive / draws < 0.8)


def seen(seed, factor, noise=SENSOR) -> dict:
    rng = np.random.default_rng(seed)
    return {"time": TS, X: oscillation(TS) + noise * autoregressive(factor, TS.size, rng)}


@pytest.mark.slow
def test_a_fit_says_how_much_wider_its_intervals_are():
    fitted = sj.fit(oscillator, START, seen(3, 0.8), noise=SENSOR, horizon=Whole())
    jacobian = np.asarray(fitted.problem.jacobian(fitted.u))
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    exact = inverse @ jacobian.T @ linalg.toeplitz(0.8 ** np.arange(TS.size)) @ jacobian @ inverse
    for i, name in enumerate(TRUTH):
        expected = TRUTH[name] * np.sqrt(exact[i, i])
        assert fitted.standard_deviations[name] == pytest.approx(expected, rel=0.3)
        independent = TRUTH[name] * np.sqrt(inverse[i, i])
        assert fitted.best_possible[name] == pytest.approx(independent, rel=0.02)
    (warning,) = fitted.warnings
    assert re.search(r"they are 2\.\d( to 2\.\d)? times those of independent ones", warning)


@pytest.mark.slow
def test_intervals_of_fits_with_correlated_noise_cover_the_truth():
    """200 refits of the vibration, AR(1) errors with a factor of 0.7, two parameters: 93 to 97 of 100 of all 400."""
    covered, n = 0, 200
    for seed in range(n):
        fitted = sj.fit(oscillator, TRUTH, seen(seed, 0.7), horizon=Whole())
        intervals = fitted.interval()
        covered += sum(intervals[name][0] < truth < intervals[name][1] for name, truth in TRUTH.items())
    assert 0.93 <= covered / (2 * n) <= 0.97, covered / (2 * n)


@pytest.mark.slow
def test_instants_need_not_be_regular():
    rng = np.random.default_rng(5)
    data = {"time": INSTANTS, X: oscillation() + SENSOR * rng.normal(size=INSTANTS.size)}
    fitted = sj.fit(oscillator, TRUTH, data, noise=SENSOR, horizon=Whole())
    assert fitted.knowledge.correlated is None
    assert fitted.standard_deviations == fitted.best_possible

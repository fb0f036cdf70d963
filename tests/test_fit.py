"""`sj.fit` on the four-bar with a bushing: estimates, intervals, and what the data cannot determine."""

import itertools

import fitting
import numpy as np
import pytest
from fitting import DAMPING, NOISE, STIFFNESS, bushing_four_bar

import spherejax as sj


@pytest.fixture(scope="module")
def motion():
    return fitting.rocker_motion()


@pytest.fixture(scope="module")
def measured(motion):
    return fitting.measured(motion)


@pytest.mark.parametrize(("stiffer", "damped"), itertools.product([0.1, 10.0], [0.1, 10.0]))
def test_finds_the_bushing_from_starts_a_factor_of_ten_away(measured, stiffer, damped):
    start = {"stiffness": STIFFNESS * stiffer, "damping": DAMPING * damped}
    fitted = sj.fit(bushing_four_bar, start, measured, noise=NOISE)
    assert fitted.succeeded
    assert fitted.status.startswith("converged")
    assert fitted.estimates["stiffness"] == pytest.approx(STIFFNESS, rel=0.01)
    assert fitted.estimates["damping"] == pytest.approx(DAMPING, rel=0.01)
    assert fitted.best_possible["stiffness"] / STIFFNESS == pytest.approx(4e-4, rel=0.2)
    assert fitted.best_possible["damping"] / DAMPING == pytest.approx(4e-3, rel=0.2)
    assert not fitted.undetermined
    assert not fitted.warnings
    assert fitted.n_iterations <= 40


def test_says_that_the_data_cannot_determine_the_damping_under_much_noise(motion):
    noise = 0.01 * np.std(motion)
    fitted = sj.fit(bushing_four_bar, {"stiffness": 5e4, "damping": 3e-3}, fitting.measured(motion, noise), noise=noise)
    assert fitted.succeeded
    worst = fitted.undetermined[0]
    assert abs(worst.direction["damping"]) > abs(worst.direction["stiffness"])
    assert worst.singular_value == fitted.singular_values[-1] < 100
    assert worst.explanation.startswith("damping is determined no better than to ")
    assert worst.explanation in str(fitted)
    # What it says is so: the estimate is off by the size that it states, not by less than a percent.
    assert 0.01 < fitted.standard_deviations["damping"] / fitted.estimates["damping"] < 1


def test_says_that_the_data_cannot_determine_a_stiff_bushing():
    measured = fitting.measured(fitting.rocker_motion(stiffness=1e6))
    fitted = sj.fit(bushing_four_bar, {"stiffness": 5e5, "damping": 3e-3}, measured, noise=NOISE)
    assert fitted.succeeded
    assert fitted.singular_values[-1] < 100
    assert [max(each.direction, key=lambda name: abs(each.direction[name])) for each in fitted.undetermined] == [
        "damping"
    ]
    low, high = fitted.interval()["damping"]
    assert low < DAMPING < high


def test_a_wrong_minimum_is_avoided_and_otherwise_told(measured):
    """Out of step with the measured vibration, the whole record has a minimum at a softer bushing without damping."""
    start = {"stiffness": 0.1 * STIFFNESS, "damping": 0.1 * DAMPING}
    whole = sj.fit(bushing_four_bar, start, measured, noise=NOISE, horizon=sj.studies.Whole())
    assert whole.estimates["stiffness"] < 0.2 * STIFFNESS
    assert any("times as large as the stated noise" in warning for warning in whole.warnings)
    assert any("not white" in warning for warning in whole.warnings)


@pytest.mark.slow
def test_intervals_cover_the_truth(motion):
    """100 draws of the noise, from starts off by a factor of ten in all four directions."""
    factors = list(itertools.product([0.1, 10.0], [0.1, 10.0]))
    covered = {"stiffness": 0, "damping": 0}
    for seed in range(100):
        stiffer, damped = factors[seed % 4]
        start = {"stiffness": STIFFNESS * stiffer, "damping": DAMPING * damped}
        fitted = sj.fit(bushing_four_bar, start, fitting.measured(motion, seed=seed), noise=NOISE)
        for name, truth in (("stiffness", STIFFNESS), ("damping", DAMPING)):
            low, high = fitted.interval(0.95)[name]
            covered[name] += low < truth < high
            assert fitted.estimates[name] == pytest.approx(truth, rel=0.015)
    assert min(covered.values()) >= 90
    # Exact intervals cover fewer than 100 with a probability of 99.4 percent.
    assert min(covered.values()) < 100

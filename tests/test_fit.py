"""`sj.fit`: parameters from measured motions, and what the result says about them."""

import itertools

import fitting
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
    # The issue of these numbers: 0.04 and 0.4 percent.
    assert fitted.best_possible["stiffness"] / STIFFNESS == pytest.approx(4e-4, rel=0.2)
    assert fitted.best_possible["damping"] / DAMPING == pytest.approx(4e-3, rel=0.2)
    assert not fitted.undetermined
    assert not fitted.warnings

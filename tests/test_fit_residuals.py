"""What a fit says of its residuals: whether they are white noise, by which test, and how they are correlated."""

from types import SimpleNamespace

import numpy as np
import pytest

from spherejax.studies.fit.judgement import _colour, _poor
from spherejax.studies.fit.statistics import whiteness_of


def autoregressive(factor, lag, n=600, seed=3):
    """x_i = factor x_(i - lag) + e_i."""
    noise = np.random.default_rng(seed).normal(size=n + 200)
    for i in range(lag, noise.size):
        noise[i] += factor * noise[i - lag]
    return noise[200:]


def said(residuals):
    """The warning of a fit with these residuals of one observable, or none."""
    knowledge = SimpleNamespace(widening=np.ones(1))
    return "".join(_colour(SimpleNamespace(residuals={"data": {"height": np.asarray(residuals)}}, knowledge=knowledge)))


def test_white_noise_is_taken_for_what_it_is():
    """Probabilities are spread evenly: as many below 0.05 as there should be, and none below a thousandth of a time."""
    rng = np.random.default_rng(1)
    found = np.array([whiteness_of(rng.normal(size=300)).probability for _ in range(2000)])
    assert abs(np.mean(found < 0.05) - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 2000)
    assert abs(np.mean(found < 0.5) - 0.5) < 4 * np.sqrt(0.25 / 2000)
    assert said(rng.normal(size=300)) == ""


@pytest.mark.parametrize(
    ("factor", "lag", "words"),
    [
        (0.6, 1, "neighbouring ones have a correlation of 0."),
        (-0.6, 1, "neighbouring ones have a correlation of -0."),
        (0.6, 4, "those 4 samples apart have a correlation of 0."),
    ],
)
def test_the_correlation_that_was_found_is_said(factor, lag, words):
    """Of residuals with a correlation of -0.13 it was said that neighbouring ones are alike."""
    residuals = autoregressive(factor, lag)
    text = said(residuals)
    assert words in text
    assert "test of Ljung and Box" in text
    test = whiteness_of(residuals)
    by_numpy = np.corrcoef(residuals[lag:], residuals[:-lag])[0, 1]
    assert test.lag == lag
    assert test.correlation == pytest.approx(by_numpy, abs=0.01)
    assert test.correlation == pytest.approx(factor, abs=0.1)
    assert f"{test.correlation:.2g}" in text
    assert f"less than {1.96 / np.sqrt(600):.2g}" in text


@pytest.mark.parametrize("residuals", [[], [1.0], [1.0] * 50, [0.0] * 50])
def test_residuals_that_say_nothing_have_no_warning(residuals):
    assert said(residuals) == ""
    assert whiteness_of(np.asarray(residuals)).probability == 1.0


@pytest.mark.parametrize(("size", "is_known", "is_told"), [(0.5, True, True), (0.5, False, True), (0.1, False, False)])
def test_a_model_that_explains_little_of_the_motion_is_told(size, is_known, is_told):
    """Residuals like a slow wave, of this share of a motion with the standard deviation 1; the noise is 0.01 of it."""
    t = np.linspace(0, 10, 400)
    wave = np.sin(t) / np.sqrt(np.mean(np.sin(t) ** 2))
    noise = 0.01 if is_known else size
    experiment = SimpleNamespace(
        is_measured=np.ones((400, 1), bool),
        data=(np.cos(20 * t) / np.std(np.cos(20 * t)))[:, None],
        measured=SimpleNamespace(name="data"),
    )
    problem = SimpleNamespace(experiments=[experiment], noise_is_known=is_known)
    residuals = {"data": {"height": size / noise * wave}}
    words = "".join(_poor(SimpleNamespace(problem=problem, residuals=residuals, noise=[np.full((400, 1), noise)])))
    assert (f"{100 * size:.0f} percent of height (data)" in words) is is_told
    white = {"data": {"height": np.random.default_rng(0).normal(size=400)}}
    assert not _poor(SimpleNamespace(problem=problem, residuals=white, noise=[np.full((400, 1), size)]))

"""Prediction of records that were not fitted, in `sj.fit(..., validate=)`: errors, expectations, plain words."""

import re

import numpy as np
import pytest
from fitting import INSTANTS, SENSOR, SPRING, START, oscillation, oscillator, seen

import spherejax as sj

X = "position.ball.x"
TS = np.linspace(0.05, 1.8, 60)


def launched(stiffness, damping, speed):
    return oscillator(stiffness, damping, speed)


def record(seed=7, *, own=True, build=launched, noise=SENSOR, speed=1.3, **motion):
    """A launch with a speed that is known only roughly."""
    values = {X: seen(seed, TS, noise=noise, speed=speed, **motion)[X]}
    return sj.Measured(
        TS, values, name="launch", build=build, own={"speed": sj.Parameter(1.0, scale=1.0)} if own else {}
    )


@pytest.fixture(scope="module")
def fitted():
    return sj.fit(oscillator, START, seen(), noise=SENSOR, validate=record())


def test_errors_of_prediction_are_those_of_the_closed_form(fitted):
    """With the fitted parameters, and with the launch speed that fits the record best."""
    from scipy import optimize

    data = seen(7, TS, speed=1.3)[X]

    def errors(speed):
        return oscillation(TS, **fitted.estimates, speed=speed[0]) - data

    best = optimize.least_squares(errors, [1.0], xtol=1e-12)
    (one,) = fitted.validation.errors
    assert one.rms == pytest.approx(np.sqrt(np.mean(errors(best.x) ** 2)), rel=1e-3)
    assert one.largest == pytest.approx(np.max(np.abs(errors(best.x))), rel=1e-3)
    assert fitted.validation.own == {"speed of launch": pytest.approx(best.x[0], abs=1e-5)}
    assert (one.record, one.component, one.unit, one.n, one.noise) == ("launch", X, "m", TS.size, SENSOR)
    assert one.motion == pytest.approx(np.std(data))
    assert fitted.names == ["stiffness", "damping"]


def test_expected_errors_have_the_parts_of_noise_and_intervals(fitted):
    step = 1e-6
    columns = [
        (oscillation(TS, speed=1.3, **{**fitted.estimates, name: value * (1 + step)})
         - oscillation(TS, speed=1.3, **fitted.estimates)) / (value * step)
        for name, value in fitted.estimates.items()
    ]  # fmt: skip
    jacobian = np.stack(columns, 1)
    variance = SENSOR**2 + np.mean(np.einsum("ni,ij,nj->n", jacobian, fitted.covariance, jacobian))
    (one,) = fitted.validation.errors
    assert one.expected == pytest.approx(np.sqrt(variance), rel=1e-2)
    assert one.rms == pytest.approx(one.expected, rel=0.3)
    assert not fitted.warnings


def test_how_long_a_prediction_holds(fitted):
    errors = np.abs(fitted.validation.differences["launch"][X])
    assert fitted.validation.within(1.0, X) == {"launch": TS[-1]}
    assert fitted.validation.within(0.0, X) == {"launch": 0.0}
    limit = np.sort(errors)[-3]
    assert fitted.validation.within(limit, X) == {"launch": TS[int(np.argmax(errors > limit)) - 1]}
    with pytest.raises(sj.SceneError, match="no record has 'angle'"):
        fitted.validation.within(1.0, "angle")


def test_the_report_says_it(fitted, tmp_path):
    text = str(fitted)
    assert "Prediction of 60 values that were not fitted (speed of launch = 1." in text
    assert re.search(r"position\.ball\.x \[m\] +60 +\S+e-05|position\.ball\.x \[m\] +60 +0\.0001", text)
    assert set(fitted.figures()) == {"fit", "residuals", "correlation", "history", "validation"}
    saved = fitted.to_xarray()
    assert saved["prediction_rms"].sel(prediction=f"launch: {X}") == fitted.validation.errors[0].rms
    page = fitted.report_page("Oscillator", None)
    assert "Prediction" in [section.title for section in page.sections]


def test_a_model_that_is_too_poor_is_told_in_plain_words():
    """Records of another spring: fitted by one stiffness, they are not predicted to the noise."""
    other = record(
        own=False, build=lambda stiffness, damping: launched(stiffness, damping, 1.3), stiffness=1.01 * SPRING
    )
    fitted = sj.fit(oscillator, START, seen(), noise=SENSOR, validate=[other])
    (warning,) = fitted.warnings
    (one,) = fitted.validation.errors
    assert one.times_noise > 10
    assert f"is predicted to {one.rms:.3g} m, {one.times_noise:.3g} times the noise" in warning
    assert "the model is too poor, or the record differs" in warning
    far = record(own=False, build=lambda stiffness, damping: launched(stiffness, damping, 1.3), stiffness=2 * SPRING)
    wrong = sj.fit(oscillator, START, seen(), noise=SENSOR, validate=[far])
    assert "the model does not predict position.ball.x of launch: the error is" in wrong.warnings[0]


def test_noise_that_is_not_stated_is_that_of_the_fit():
    fitted = sj.fit(oscillator, START, {"time": INSTANTS, X: seen()[X]}, validate=record())
    (one,) = fitted.validation.errors
    assert one.noise == pytest.approx(fitted.noise[0][0, 0])
    assert one.noise == pytest.approx(SENSOR, rel=0.2)
    assert one.of_fit == pytest.approx(one.noise, rel=0.05)


def test_a_record_that_cannot_be_run_is_named():
    def explodes(stiffness, damping):
        return oscillator(stiffness, -damping)

    with pytest.raises(sj.SceneError, match="damping"):
        sj.fit(oscillator, START, seen(), noise=SENSOR, validate=sj.Measured(TS, {X: oscillation(TS)}, build=explodes))
    with pytest.raises(sj.SceneError, match="names no quantity"):
        sj.fit(oscillator, START, seen(), noise=SENSOR, validate={"time": TS, "height.ball": oscillation(TS)})

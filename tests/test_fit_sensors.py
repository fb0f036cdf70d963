"""Sensors in fits: gain, bias, delay and filters against the closed form of a damped vibration, and SciPy's fits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fitting import DAMPER, FREE_LENGTH, MASS, OFFSET, SPRING, oscillation, oscillator
from scipy import integrate, optimize

import spherejax as sj
from spherejax.studies.fit import Whole, problem_of
from spherejax.studies.fit.sensing import low_pass

X = "position.ball.x"
TS = np.linspace(0.1, 2.0, 96)  # [s]
TRUTH = {"stiffness": SPRING, "damping": DAMPER, "gain": 3.0, "bias": -0.2, "late": 0.013, "smooth": 0.1}
START = {
    "stiffness": 180.0, "damping": 1.0, "gain": 2.5, "bias": sj.Parameter(0.0, scale=0.1),
    "late": sj.Parameter(0.0, scale=0.01, upper=0.09), "smooth": 0.15,
}  # fmt: skip
VOLT = 3e-3  # standard deviation of the readings [V]
SENSOR = sj.studies.Sensor(X, gain="gain", bias="bias", delay="late", filter=sj.studies.LowPass("smooth"), unit="V")


def filtered(ts, stiffness=SPRING, damping=DAMPER, smooth=0.1, first=None):
    """What a low pass makes of the vibration, exactly [m]: L + Re(c / (1 + s T) exp(s t)) + k exp(-t / T)."""
    decay = damping / (2 * MASS)
    frequency = np.sqrt(stiffness / MASS - decay**2)
    s = -decay + 1j * frequency
    c = OFFSET - 1j * decay * OFFSET / frequency
    steady = FREE_LENGTH + np.real(c / (1 + s * smooth) * np.exp(s * np.asarray(ts)))
    begin = FREE_LENGTH + OFFSET if first is None else first
    return steady + (begin - FREE_LENGTH - np.real(c / (1 + s * smooth))) * np.exp(-np.asarray(ts) / smooth)


def reading(ts=TS, gain=3.0, bias=-0.2, late=0.013, **motion):
    """The readings without noise [V]."""
    return gain * filtered(np.asarray(ts) - late, **motion) + bias


def volts(seed=0, noise=VOLT):
    return reading() + noise * np.random.default_rng(seed).normal(size=TS.size)


def record(**changes):
    return sj.Measured(TS, {"volts": volts()}, sensors={"volts": SENSOR}, **changes)


@pytest.fixture(scope="module")
def problem():
    return problem_of(oscillator, START, [record()], VOLT, rtol=1e-10)


def test_the_closed_form_is_that_of_scipys_integrator():
    def rate(t, f):
        return (oscillation(np.array([t])) - f) / 0.1

    solved = integrate.solve_ivp(rate, (0, 1.0), [0.0], rtol=1e-10, atol=1e-12, t_eval=[0.05, 1.0])
    np.testing.assert_allclose(filtered([0.05, 1.0], first=0.0), solved.y[0], rtol=1e-8)


def test_readings_are_those_of_the_closed_form(problem):
    u = problem.unknowns.unknowns_of(TRUTH)
    expected = (reading() - volts()) / VOLT
    np.testing.assert_allclose(problem.residuals(u), expected, atol=1e-3)
    (experiment,) = problem.experiments
    error = np.abs(np.asarray(experiment.predict_alone(jnp.asarray(u)).values)[:, 0] - reading()).max()
    assert error < experiment.filter_errors(jnp.asarray(u))["volts"] < 100 * error


@pytest.mark.slow
def test_derivatives_are_those_of_the_closed_form_in_both_modes(problem):
    """By every parameter; the delay's comes from the rates of the state."""
    u = problem.unknowns.unknowns_of(TRUTH)
    columns = []
    for i, h in enumerate([1e-5] * 3 + [1e-4] * 2 + [1e-5]):
        up, down = (problem.unknowns.values_of(jnp.asarray(u + sign * h * np.eye(6)[i])) for sign in (1, -1))
        up, down = (reading(**{name: float(value) for name, value in values.items()}) for values in (up, down))
        columns.append((up - down) / (2 * h * VOLT))
    expected = np.stack(columns, 1)
    jacobian = problem.jacobian(u)
    assert np.all(np.abs(jacobian - expected) < 1e-4 * np.abs(expected).max(0))
    np.testing.assert_allclose(jax.jacfwd(problem.residuals)(jnp.asarray(u)), jacobian, rtol=1e-9)
    start = problem.u0
    residuals, jacobian = problem.residuals_and_jacobian(start)
    reverse = problem.cost_and_gradient(start)
    assert reverse.cost == pytest.approx(float(residuals @ residuals) / 2, rel=1e-6)
    np.testing.assert_allclose(reverse.gradient, jacobian.T @ residuals, rtol=1e-5)


@pytest.mark.slow
def test_a_fit_finds_what_scipy_finds_on_the_closed_form():
    fitted = sj.fit(oscillator, START, record(), noise=VOLT)
    names = list(TRUTH)

    def residuals(p):
        return (reading(**dict(zip(names, p, strict=True))) - volts()) / VOLT

    # Delay and time constant are alike, and a step may lead to a time constant below zero.
    bounds = [0.0 if name == "smooth" else -np.inf for name in names], np.inf
    scale = np.abs(list(TRUTH.values()))
    scipy = optimize.least_squares(residuals, list(TRUTH.values()), x_scale=scale, xtol=1e-12, bounds=bounds)
    deviations = np.sqrt(np.diagonal(np.linalg.inv(scipy.jac.T @ scipy.jac)))
    for name, value, deviation in zip(names, scipy.x, deviations, strict=True):
        assert fitted.estimates[name] == pytest.approx(value, abs=0.03 * deviation)
        assert fitted.standard_deviations[name] == pytest.approx(deviation, rel=0.02)
        assert abs(fitted.estimates[name] - TRUTH[name]) < 4 * deviation
    assert fitted.succeeded
    assert not fitted.warnings
    assert fitted.to_xarray()["measured_0"].attrs["units"] == '["V"]'


@pytest.mark.slow
def test_a_clock_offset_between_two_channels_is_a_parameter():
    """Two instruments see the same; the clock of one is late. Both begin at the same instants, which may be equal."""
    early, late = oscillation(TS), oscillation(TS + 0.013)
    noise = 1e-5 * np.random.default_rng(2).normal(size=(2, TS.size))
    values = {"camera": early + noise[0], "encoder": late + noise[1]}
    sensors = {"camera": sj.studies.Sensor(X), "encoder": sj.studies.Sensor(X, delay=lambda p: -p["offset"])}
    measured = sj.Measured(TS, values, sensors=sensors)
    start = {"stiffness": 180.0, "damping": 1.0, "offset": sj.Parameter(0.0, scale=0.01)}
    fitted = sj.fit(oscillator, start, measured, noise=1e-5)
    assert fitted.estimates["offset"] == pytest.approx(0.013, abs=4 * fitted.standard_deviations["offset"])
    assert fitted.standard_deviations["offset"] < 1e-5
    assert fitted.estimates["stiffness"] == pytest.approx(SPRING, rel=1e-3)
    assert set(fitted.residuals["experiment 1"]) == {"camera", "encoder"}


@pytest.mark.slow
def test_filters_that_begin_empty_and_differentiators():
    smooth = 0.1
    rate = (oscillation(TS) - filtered(TS)) / smooth
    sensors = {
        "empty": sj.studies.Sensor(X, filter=sj.studies.LowPass(smooth, settled=False)),
        "speed": sj.studies.Sensor(X, filter=sj.studies.Differentiator(smooth)),
        "ball": sj.studies.Sensor("position.ball", gain=(1.0, 2.0, 2.0), bias=(0.0, 0.1, 0.2)),
    }
    vector = np.stack([oscillation(TS), np.full(TS.size, 0.1), np.full(TS.size, 0.2)], 1)
    values = {"empty": filtered(TS, first=0.0), "speed": rate, "ball": vector}
    measured = sj.Measured(TS, values, sensors=sensors)
    problem = problem_of(oscillator, {"stiffness": SPRING, "damping": DAMPER}, [measured], 1.0, rtol=1e-10)
    np.testing.assert_allclose(problem.residuals(problem.u0), 0.0, atol=2e-5)


@pytest.mark.slow
def test_sensors_alone_can_be_fitted():
    def known():
        return oscillator(SPRING, DAMPER)

    start = {"gain": 1.0, "bias": sj.Parameter(0.0, scale=0.1), "late": 0.02}
    sensor = sj.studies.Sensor(X, gain="gain", bias="bias", delay="late", filter=sj.studies.LowPass(0.1))
    measured = sj.Measured(TS, {"volts": volts()}, sensors={"volts": sensor})
    fitted = sj.fit(known, start, measured, noise=VOLT, horizon=Whole())
    for name in start:
        assert abs(fitted.estimates[name] - TRUTH[name]) < 4 * fitted.standard_deviations[name]
    residuals, jacobian = fitted.problem.residuals_and_jacobian(fitted.problem.u0)
    gradient = fitted.problem.cost_and_gradient(fitted.problem.u0).gradient
    np.testing.assert_allclose(gradient, jacobian.T @ residuals, rtol=1e-9)


@pytest.mark.slow
def test_a_coarse_filter_is_told():
    sparse = np.linspace(0.2, 2.0, 10)
    start = {"stiffness": SPRING, "damping": DAMPER}
    sensor = sj.studies.Sensor(filter=sj.studies.LowPass(0.1, substeps=1))
    fitted = sj.fit(
        oscillator, start, {"time": sparse, X: filtered(sparse)}, noise=1e-4, sensors={X: sensor}, horizon=Whole()
    )
    assert any("Raise substeps" in warning for warning in fitted.warnings)


# Parameters of builders, sensors and single experiments ------------------------------------------------------------


@pytest.mark.slow
def test_each_experiment_has_its_own_start_beside_common_parameters():
    def launched(stiffness, damping, speed):
        return oscillator(stiffness, damping, speed)

    records = [
        sj.Measured(
            TS, {X: oscillation(TS, speed=speed) + 1e-5 * np.random.default_rng(i).normal(size=TS.size)},
            own={"speed": sj.Parameter(0.0, scale=1.0)}, name=name, build=build,
        )
        for i, (name, speed, build) in enumerate([("slow", 0.3, None), ("fast", 2.0, launched)])
    ]  # fmt: skip
    still = sj.Measured(TS, {X: oscillation(TS)}, build=lambda stiffness: oscillator(stiffness, DAMPER), name="still")
    fitted = sj.fit(launched, {"stiffness": 180.0, "damping": 1.0}, [*records, still], noise=1e-5)
    assert fitted.names == ["stiffness", "damping", "speed of slow", "speed of fast"]
    assert fitted.estimates["speed of slow"] == pytest.approx(0.3, abs=1e-3)
    assert fitted.estimates["speed of fast"] == pytest.approx(2.0, abs=1e-3)
    assert fitted.estimates["stiffness"] == pytest.approx(SPRING, rel=1e-4)
    assert fitted.succeeded
    # What one experiment does not depend on has no derivative there, and none is integrated.
    assert fitted.problem.experiments[2].frame.moved == (0,)
    assert np.all(fitted.problem.jacobian(fitted.u)[: TS.size, 3] == 0)
    assert float(fitted.runs["fast"].velocity("ball")[0, 0]) == pytest.approx(2.0, abs=1e-3)


def test_experiments_of_the_same_name_are_told_apart():
    again = [sj.Measured(TS, {X: oscillation(TS)}, name="a") for _ in range(2)]
    problem = problem_of(oscillator, {"stiffness": 180.0, "damping": 1.0}, again, 1.0)
    assert [one.measured.name for one in problem.experiments] == ["a", "a (2)"]


Sensor, LowPass = sj.studies.Sensor, sj.studies.LowPass
KNOWN = {"stiffness": SPRING, "damping": DAMPER}
REFUSED = {
    "before the start": (KNOWN, {X: Sensor(delay=0.2)}, {}, "a delay of 0.2 s of 'position.ball.x' asks for"),
    "no parameter": (KNOWN, {X: Sensor(gain="gian")}, {}, "gain of the sensor of .* is the parameter 'gian'"),
    "no channel": (KNOWN, {"y": Sensor()}, {}, r"sensors=\['y'\] have no measured values"),
    "no sensor": (KNOWN, {X: 2.0}, {}, "sensors must be a dict of sj.studies.Sensor"),
    "components": (KNOWN, {X: Sensor(gain=(1.0, 2.0))}, {}, "has 2 numbers; it must be one, or one for each of"),
    "unknown": (KNOWN, {X: Sensor("position.bal.x")}, {}, "belongs to a body.*one of 'ball'"),
    "not used": ({**KNOWN, "color": 1.0}, {}, {}, "no builder and no sensor takes the parameter 'color'"),
    "own not used": (KNOWN, {}, {"own": {"color": 1.0}}, "nor a sensor takes its parameter 'color'"),
    "own and common": (KNOWN, {}, {"own": {"damping": 1.0}}, "is a parameter of all experiments .* and one that"),
    "negative filter": (
        {**KNOWN, "T": -1.0}, {X: Sensor(filter=LowPass("T"))}, {}, "time constant of the filter of .* posit"
    ),
}  # fmt: skip


@pytest.mark.parametrize(("start", "sensors", "options", "message"), REFUSED.values(), ids=REFUSED)
def test_what_makes_no_sense_is_refused(start, sensors, options, message):
    with pytest.raises(sj.SceneError, match=message):
        sj.fit(oscillator, start, sj.Measured(TS, {X: oscillation(TS)}, sensors=sensors, **options), noise=1.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: sj.studies.Sensor(gain=0.0), "gain = 0 shows nothing"),
        (lambda: sj.studies.Sensor(delay=[0.1, 0.2]), "delay must be a finite number, the name"),
        (lambda: sj.studies.Sensor(bias=np.nan), "bias must be a finite number"),
        (lambda: sj.studies.Sensor(filter=0.1), r"filter must be sj\.studies\.LowPass"),
        (lambda: sj.studies.LowPass(0.0), "time_constant = 0 s must be positive"),
        (lambda: sj.studies.LowPass(0.1, substeps=0), "substeps = 0 must be a whole number"),
        (lambda: sj.studies.Sensor(2.0), "of = 2.0 must be the name of an observable"),
        (lambda: jax.jit(lambda x: sj.studies.Sensor(gain=x))(1.0), "gain is traced"),
    ],
)
def test_bad_sensors_are_refused(make, message):
    with pytest.raises(sj.SceneError, match=message):
        make()


@pytest.mark.slow
def test_a_delay_beyond_the_start_is_a_failed_run_with_its_reason_or_held():
    start = {**KNOWN, "late": sj.Parameter(0.0, scale=0.01)}
    for held in (False, True):
        sensor = sj.studies.Sensor(X, delay="late", held_before_start=held)
        problem = problem_of(oscillator, start, [sj.Measured(TS, {X: oscillation(TS)}, sensors={X: sensor})], 1.0)
        u = problem.unknowns.unknowns_of({**KNOWN, "late": 0.2})
        assert bool(problem.evaluate(u[None]).failed[0]) is not held
        if held:
            expected = oscillation(np.maximum(TS - 0.2, 0.0)) - oscillation(TS)
            np.testing.assert_allclose(problem.residuals(u), expected, atol=1e-6)
        else:
            assert "asks for the motion at -0.1 s" in problem.evaluate(u[None]).diagnoses[0]
            assert "asks for the motion" in problem.cost_and_gradient(u).diagnosis


@pytest.mark.parametrize("time_constant", [1e-6, 0.05, 0.11, 30.0, 1e9])
def test_the_recursion_is_exact_for_cubic_inputs(time_constant):
    """At any ratio of interval and time constant, with repeated samples; against the polynomial solution."""
    ts = np.array([0.0, 0.1, 0.1, 0.3, 0.9])
    p = np.polynomial.Polynomial([1.0, -2.0, 3.0, -1.5])
    # T f' + f = p has the solution sum_k (-T)^k p^(k), and exp(-t / T).
    steady = sum((-time_constant) ** k * (p.deriv(k) if k else p) for k in range(4))
    scale = max(1.0, time_constant**3)
    exact = steady(ts) + (p(0.0) - steady(0.0)) * np.exp(-ts / time_constant)
    x, rate = p(ts)[:, None], p.deriv()(ts)[:, None]
    answer = low_pass(*map(jnp.asarray, (ts, x, rate)), time_constant, jnp.asarray(x[0]))[:, 0]
    np.testing.assert_allclose(answer, exact, atol=1e-13 * scale)
    slope = jax.grad(lambda T: low_pass(*map(jnp.asarray, (ts, x, rate)), T, jnp.asarray(x[0]))[-1, 0])(time_constant)
    assert np.isfinite(slope)

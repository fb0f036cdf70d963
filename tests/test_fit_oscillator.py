"""`sj.fit` on a motion that is known exactly: statistics, methods, bounds, experiments, failures, interrupts."""

import os
import signal
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from fitting import DAMPER, INSTANTS, SENSOR, SPRING, START, oscillation, oscillator, seen

import spherejax as sj
from spherejax.studies.fit import Course, Ending, Whole, problem_of
from spherejax.studies.fit.record import Held, no_worse_than_starts

TRUTH = {"stiffness": SPRING, "damping": DAMPER}


@pytest.fixture(scope="module")
def problem():
    return problem_of(
        oscillator, START, [sj.Measured(INSTANTS, {"position.ball.x": seen()["position.ball.x"]})], SENSOR
    )


@pytest.fixture(scope="module")
def fitted():
    return sj.fit(oscillator, START, seen(), noise=SENSOR)


# The problem --------------------------------------------------------------------------------------------------------


def test_residuals_are_those_of_the_exact_motion(problem):
    u = problem.unknowns.unknowns_of(TRUTH)
    expected = (oscillation() - seen()["position.ball.x"]) / SENSOR
    np.testing.assert_allclose(problem.residuals(u), expected, atol=1e-3)


def test_jacobian_is_that_of_the_exact_motion(problem):
    """By the logarithms of both numbers, against central differences of the exact solution."""
    h = 1e-5
    columns = []
    for name in TRUTH:
        up, down = ({**TRUTH, name: TRUTH[name] * np.exp(sign * h)} for sign in (1, -1))
        columns.append((oscillation(**up) - oscillation(**down)) / (2 * h * SENSOR))
    u = problem.unknowns.unknowns_of(TRUTH)
    expected = np.stack(columns, 1)
    assert np.all(np.abs(problem.jacobian(u) - expected) < 1e-6 * np.max(np.abs(expected), 0))
    forward = jax.jacfwd(problem.residuals)(jnp.asarray(u))
    np.testing.assert_allclose(forward, problem.jacobian(u), rtol=1e-9)


def test_likelihood_is_normal_and_has_a_gradient(problem):
    u = problem.unknowns.unknowns_of(TRUTH)
    residuals = np.asarray(problem.residuals(u))
    expected = -np.sum(residuals**2) / 2 - residuals.size * np.log(SENSOR * np.sqrt(2 * np.pi))
    assert float(problem.log_likelihood(u)) == pytest.approx(expected, rel=1e-12)
    gradient = jax.jit(jax.grad(problem.log_likelihood))(jnp.asarray(u))
    residuals, jacobian = (np.asarray(part) for part in problem.residuals_and_jacobian(u))
    # The terms of the sum all but cancel at the truth: what may differ is a share of them, not of it.
    scale = np.abs(jacobian.T) @ np.abs(residuals)
    np.testing.assert_allclose((gradient + jacobian.T @ residuals) / scale, 0.0, atol=1e-6)


def test_a_shorter_record_is_the_beginning_of_the_whole(problem):
    u, n = problem.u0, int(np.sum(INSTANTS <= 0.5))
    part = problem.until(0.5)
    assert part.n_residuals == n
    np.testing.assert_allclose(part.residuals(u), problem.residuals(u)[:n], rtol=1e-6, atol=1e-4)


# The result ---------------------------------------------------------------------------------------------------------


def test_estimates_have_the_covariance_of_the_exact_motion(fitted):
    u = np.log([SPRING, DAMPER])
    jacobian = np.asarray(fitted.problem.jacobian(u))
    scaled = np.linalg.inv(jacobian.T @ jacobian)
    expected = scaled * np.outer([SPRING, DAMPER], [SPRING, DAMPER])
    deviations = np.sqrt(np.diagonal(expected))
    assert np.all(np.abs(fitted.covariance - expected) < 0.02 * np.outer(deviations, deviations))
    np.testing.assert_allclose(fitted.singular_values, np.linalg.svd(jacobian)[1], rtol=0.02)
    for name, truth in TRUTH.items():
        assert abs(fitted.estimates[name] - truth) < 4 * fitted.standard_deviations[name]
        assert fitted.best_possible[name] == fitted.standard_deviations[name]
    assert np.diagonal(fitted.correlation) == pytest.approx([1, 1])
    assert fitted.succeeded
    assert not fitted.warnings
    assert not fitted.undetermined


def test_intervals_cover_the_truth_in_many_draws():
    covered, n = np.zeros(2), 100
    for seed in range(n):
        fitted = sj.fit(oscillator, TRUTH, seen(seed), noise=SENSOR, horizon=Whole())
        intervals = fitted.interval(0.8)
        covered += [intervals[name][0] < truth < intervals[name][1] for name, truth in TRUTH.items()]
    # Binomial with 0.8: 68 to 90 in all but 0.5 percent of the cases.
    assert np.all((covered >= 68) & (covered <= 90))


def test_noise_of_each_observable_is_estimated():
    rng = np.random.default_rng(3)
    step = 1e-6
    speed = (oscillation(INSTANTS + step) - oscillation(INSTANTS - step)) / (2 * step)
    values = {
        "position.ball.x": oscillation() + 1e-4 * rng.normal(size=INSTANTS.size),
        "velocity.ball.x": speed + 3e-2 * rng.normal(size=INSTANTS.size),
    }
    fitted = sj.fit(oscillator, START, sj.Measured(INSTANTS, values))
    assert fitted.succeeded
    position, velocity = fitted.noise[0][0]
    assert position == pytest.approx(1e-4, rel=0.2)
    assert velocity == pytest.approx(3e-2, rel=0.2)
    assert "estimated noise: position.ball.x" in str(fitted)
    for name, truth in TRUTH.items():
        assert abs(fitted.estimates[name] - truth) < 4 * fitted.standard_deviations[name]
    with pytest.raises(sj.SceneError, match="likelihood needs the noise"):
        fitted.problem.log_likelihood(fitted.u)


def test_missing_values_do_not_count():
    data = seen()
    wild = data["position.ball.x"].copy()
    wild[::3] = np.nan
    with_gaps = sj.fit(oscillator, START, {"time": data["time"], "position.ball.x": wild}, noise=SENSOR)
    kept = ~np.isnan(wild)
    without = {"time": data["time"][kept], "position.ball.x": wild[kept]}
    shorter = sj.fit(oscillator, START, without, noise=SENSOR)
    assert with_gaps.problem.n_residuals == kept.sum()
    for name in TRUTH:
        assert with_gaps.estimates[name] == pytest.approx(shorter.estimates[name], rel=1e-5)


def test_measurements_may_begin_with_the_motion_and_each_have_its_noise(fitted):
    """The first instant is that of the start; what is known badly counts little."""
    ts = np.concatenate([[0.0], INSTANTS[1:]])
    data = seen(ts=ts)
    noise = np.where(np.arange(ts.size) % 2, SENSOR, 1e3 * SENSOR)
    wild = data["position.ball.x"] + np.where(np.arange(ts.size) % 2, 0.0, 0.1)
    found = sj.fit(oscillator, START, {**data, "position.ball.x": wild}, noise={"position.ball.x": noise})
    assert found.residuals["experiment 1"]["position.ball.x"].size == ts.size
    for name, truth in TRUTH.items():
        assert abs(found.estimates[name] - truth) < 4 * found.standard_deviations[name]
        assert found.standard_deviations[name] > 1.1 * fitted.standard_deviations[name]


def test_two_experiments_are_worth_more_than_one(fitted):
    later = np.linspace(0.1, 1.0, 30)

    def launched(stiffness, damping):
        return oscillator(stiffness, damping, speed=2.0)

    second = sj.Measured(later, {"position.ball.x": seen(5, later, speed=2.0)["position.ball.x"]}, build=launched)
    both = sj.fit(oscillator, START, [seen(), second], noise=SENSOR)
    assert both.problem.n_residuals == INSTANTS.size + later.size
    assert list(both.residuals) == ["experiment 1", "experiment 2"]
    for name, truth in TRUTH.items():
        assert both.standard_deviations[name] < 0.8 * fitted.standard_deviations[name]
        assert abs(both.estimates[name] - truth) < 4 * both.standard_deviations[name]
    run = both.runs["experiment 2"]
    np.testing.assert_allclose(run.position("ball")[1:, 0], oscillation(later, speed=2.0), atol=1e-4)


def test_functions_of_a_run_can_be_measured(fitted):
    def distance(run):
        return jnp.linalg.norm(run.position("ball"), axis=1)

    given = sj.Measured(INSTANTS, {"distance": seen()["position.ball.x"]}, functions={"distance": distance})
    found = sj.fit(oscillator, START, given, noise=SENSOR)
    for name in TRUTH:
        assert found.estimates[name] == pytest.approx(fitted.estimates[name], rel=1e-6)


def test_results_of_force_elements_can_be_measured(fitted):
    found = sj.fit(oscillator, START, {"time": INSTANTS, "spring.length": seen()["position.ball.x"]}, noise=SENSOR)
    for name in TRUTH:
        assert found.estimates[name] == pytest.approx(fitted.estimates[name], rel=1e-6)


def test_what_leaves_no_trace_is_named():
    def build(stiffness, sideways):
        scene = oscillator(stiffness, DAMPER)
        ball = scene.bodies["ball"]
        body = sj.Body(ball.mass, (sideways,) * 3, position=ball.position, points=dict(ball.points))
        return sj.Scene(
            {"ball": body}, {}, forces=scene.forces, gravity=scene.gravity, ground_points=scene.ground_points
        )

    found = sj.fit(build, {"stiffness": 150.0, "sideways": 1e-3}, seen(), noise=SENSOR)
    assert found.estimates["stiffness"] == pytest.approx(SPRING, rel=1e-3)
    (only,) = found.undetermined
    assert only.singular_value == 0
    assert "not determined at all" in only.explanation
    assert found.standard_deviations["sideways"] == np.inf
    assert found.interval()["sideways"] == (0.0, np.inf)
    assert np.isfinite(found.standard_deviations["stiffness"])
    assert "unknown" in str(found)


# Bounds, scales, arrays ---------------------------------------------------------------------------------------------


def test_bounds_are_kept_and_told():
    start = {"stiffness": sj.Parameter(80.0, lower=50.0, upper=150.0), "damping": 0.4}
    found = sj.fit(oscillator, start, seen(), noise=SENSOR)
    assert 149.0 < found.estimates["stiffness"] <= 150.0
    assert any("rests on its upper bound 150" in warning for warning in found.warnings)
    assert found.interval()["stiffness"][1] <= 150.0


def test_bounds_that_are_not_active_change_nothing(fitted):
    start = {
        "stiffness": sj.Parameter(80.0, lower=10.0, upper=1e4),
        "damping": sj.Parameter(0.4, scale=1.0, lower=-0.5),
    }
    found = sj.fit(oscillator, start, seen(), noise=SENSOR)
    for name in TRUTH:
        assert found.estimates[name] == pytest.approx(fitted.estimates[name], rel=1e-4)
        assert found.standard_deviations[name] == pytest.approx(fitted.standard_deviations[name], rel=1e-3)
    assert not found.warnings


def test_a_parameter_that_runs_away_is_told():
    start = {"stiffness": 150.0, "damping": 0.4}
    # The valley is flat: at 1e-8 and 1e-9 some fits end in it at 7e-4, by the rounding of their steps.
    found = sj.fit(oscillator, start, seen(damping=0.0, noise=1e-9), noise=SENSOR, rtol=1e-10)
    assert found.estimates["damping"] < 0.4e-4
    assert any("damping has fallen from 0.4 to" in warning for warning in found.warnings)


def test_arrays_are_fitted_number_by_number(fitted):
    def build(numbers):
        return oscillator(numbers[0], numbers[1])

    found = sj.fit(build, {"numbers": np.array([80.0, 0.4])}, seen(), noise=SENSOR)
    assert found.names == ["numbers[0]", "numbers[1]"]
    np.testing.assert_allclose(found.estimates["numbers"], list(fitted.estimates.values()), rtol=1e-6)
    assert found.interval()["numbers"].shape == (2, 2)


# Methods, starts, failures ------------------------------------------------------------------------------------------


def test_descent_finds_the_same(fitted):
    found = sj.fit(
        oscillator, TRUTH | {"damping": 2.0}, seen(), noise=SENSOR,
        method=sj.studies.Descent(optax.adam(2e-2), n_steps=400), horizon=Whole(),
    )  # fmt: skip
    assert found.status == Ending.CONVERGED.value
    for name in TRUTH:
        assert abs(found.estimates[name] - fitted.estimates[name]) < 0.2 * fitted.standard_deviations[name]


def test_starts_side_by_side_are_those_one_by_one(problem):
    us = problem.u0 + np.array([[0.0, 0.0], [0.3, -0.2], [0.1, 0.5]])
    together = problem.evaluate(us)
    assert not together.failed.any()
    for u, residuals, jacobian in zip(us, together.residuals, together.jacobians, strict=True):
        alone, slopes = problem.residuals_and_jacobian(u)
        np.testing.assert_array_equal(residuals, alone)
        np.testing.assert_array_equal(jacobian, slopes)


@pytest.mark.slow
def test_lanes_of_an_accelerator_are_the_same(problem):
    us = problem.u0 + np.array([[0.0, 0.0], [0.3, -0.2]])
    (experiment,) = problem.experiments
    lanes = experiment.predict_lanes(jnp.asarray(us))
    for lane, u in enumerate(us):
        alone = experiment.predict(jnp.asarray(u))
        np.testing.assert_allclose(lanes.values[lane], alone.values, rtol=1e-8)
        np.testing.assert_allclose(lanes.slopes[lane], alone.slopes, rtol=1e-5, atol=1e-8)


def test_what_is_known_beforehand_serves_those_that_go_on(problem):
    """A start that has ended is not evaluated any more; the other keeps its own place."""
    us = np.stack([problem.u0, problem.u0 + 1.0])
    held = Held(problem, us, 2.0)
    both, second = held.evaluate(us + 0.1), held.evaluate(us[1:] + 0.1)
    np.testing.assert_allclose(second.residuals[0], both.residuals[1], rtol=1e-9)
    np.testing.assert_allclose(second.residuals[0][-2:], 0.05)


def test_descent_takes_back_a_step_whose_gradient_is_lost(problem):
    class Losing:
        """Its gradient is not a number beyond a step's length from the start."""

        n_residuals = problem.n_residuals

        def evaluate(self, us):
            return problem.evaluate(us)

        def cost_and_gradient(self, u):
            found = problem.cost_and_gradient(u)
            if np.abs(u - problem.u0).max() < 0.015:
                return found
            return found._replace(gradient=np.full(u.size, np.nan), diagnosis="lost")

    method = sj.studies.Descent(optax.adam(2e-2), n_steps=5, reverse=True)
    (course,) = method.minimize(Losing(), problem.u0[None], noise_is_known=True)
    assert course.n_failed > 0
    assert course.diagnosis == "lost"
    assert course.cost < course.costs[0]


def test_starts_that_end_elsewhere_are_told():
    """The whole record at once, from ten starts: some are out of step for good."""
    later = 5 * INSTANTS
    found = sj.fit(oscillator, START, seen(ts=later), noise=SENSOR, starts=10, horizon=Whole())
    assert len(found.starts) == 10
    assert found.starts[0]["start"] == pytest.approx(START)
    assert len({each["start"]["stiffness"] for each in found.starts}) == 10
    for name in TRUTH:
        assert abs(found.estimates[name] - TRUTH[name]) < 4 * found.standard_deviations[name]
    elsewhere = sum(each["cost"] > 2 * found.cost for each in found.starts)
    assert 0 < elsewhere < 10
    assert any("starts ended in minima with a larger cost" in warning for warning in found.warnings)


def test_a_failed_run_is_a_step_taken_back():
    """Without a logarithm the damping is tried below zero, where no run is made."""
    start = {"stiffness": SPRING, "damping": sj.Parameter(5.0, positive=False, scale=5.0)}
    data = seen(damping=0.05)
    found = sj.fit(oscillator, start, data, noise=SENSOR, horizon=Whole())
    assert found.succeeded
    assert found.best.n_failed > 0
    assert abs(found.estimates["damping"] - 0.05) < 4 * found.standard_deviations["damping"]
    assert any("taken back" in warning for warning in found.warnings)


def test_a_start_that_fails_is_told():
    found = sj.fit(oscillator, START, seen(), noise=SENSOR, max_steps=5)
    assert not found.succeeded
    assert found.status == Ending.FAILED_START.value
    assert "stiffness = 80, damping = 0.4" in found.diagnosis
    assert "max_steps" in found.diagnosis
    assert found.diagnosis in str(found)
    with pytest.raises(sj.SimulationError, match="nothing was estimated"):
        found.standard_deviations  # noqa: B018


@pytest.mark.usefixtures("hears_interrupts")
def test_an_interrupt_keeps_the_best_so_far(fitted):
    def interrupt(now):
        if now.iteration == 4:
            os.kill(os.getpid(), signal.SIGINT)

    found = sj.fit(oscillator, START, seen(), noise=SENSOR, horizon=Whole(), progress=interrupt)
    assert not found.succeeded
    assert found.status == Ending.INTERRUPTED.value
    assert found.n_iterations < fitted.n_iterations
    start = 2 * found.best.costs[0]
    assert 2 * found.cost < start
    assert found.residuals["experiment 1"]["position.ball.x"].shape == INSTANTS.shape
    assert "interrupted" in str(found)


@pytest.mark.usefixtures("hears_interrupts")
def test_an_interrupt_while_the_record_grows_reports_the_whole():
    def interrupt(now):
        if now.iteration == 2:
            os.kill(os.getpid(), signal.SIGINT)

    found = sj.fit(oscillator, START, seen(), noise=SENSOR, progress=interrupt)
    assert found.status == Ending.INTERRUPTED.value
    assert found.best.residuals.size == INSTANTS.size


def test_parts_that_cannot_be_run_from_each_other_fall_back_to_the_start():
    """Every part leads to a stiffness with which the whole cannot be run; it is then begun at the start."""
    method = LeadsAstray()
    found = sj.fit(oscillator, START, seen(), noise=SENSOR, method=method)
    assert found.succeeded
    assert method.begun[-2][0] == 25.0
    np.testing.assert_allclose(method.begun[-1], np.log(list(START.values())))
    assert found.estimates["stiffness"] == pytest.approx(SPRING, rel=1e-3)


class LeadsAstray:
    """Levenberg-Marquardt that leads astray on parts of the record, and fails from there on the whole."""

    max_iterations = 100

    def __init__(self):
        self.begun = []

    def roughly(self):
        return self

    def minimize(self, problem, us, *, noise_is_known, watch):
        self.begun.append(us[0].copy())
        if isinstance(problem, Held):
            return [Course([np.array([25.0, 0.0])], [1.0], [np.inf], ending=Ending.CONVERGED, n_iterations=1)]
        if us[0][0] > 20:
            return [Course(ending=Ending.FAILED_START, n_iterations=1, n_failed=1, diagnosis="too stiff")]
        return sj.studies.LevenbergMarquardt().minimize(problem, us, noise_is_known=noise_is_known, watch=watch)


def test_progress_is_told():
    told = []
    sj.fit(oscillator, START, seen(), noise=SENSOR, progress=told.append)
    assert told[-1].n_going == 0
    assert told[-1].cost < told[0].cost * 10
    assert told[-1].values == pytest.approx([SPRING, DAMPER], rel=0.01)


def test_nothing_is_printed_to_logs(capfd):
    sj.fit(oscillator, START, seen(), noise=SENSOR)
    assert capfd.readouterr() == ("", "")


# Out ----------------------------------------------------------------------------------------------------------------


def test_everything_is_saved(fitted, tmp_path):
    import xarray

    path = fitted.save(tmp_path / "fit.nc")
    saved = xarray.load_dataset(path, engine="h5netcdf")
    assert saved["estimate"].sel(parameter="stiffness") == fitted.estimates["stiffness"]
    np.testing.assert_array_equal(saved["measured_0"].sel(observable_0="position.ball.x"), seen()["position.ball.x"])
    residual = (saved["predicted_0"] - saved["measured_0"]) / saved["noise_0"]
    np.testing.assert_allclose(residual, saved["residual_0"], atol=1e-9)
    assert saved.attrs["report"] == str(fitted)
    assert saved.attrs["succeeded"] == 1


def test_pictures_are_drawn(fitted):
    figures = fitted.figures("Oscillator")
    assert set(figures) == {"fit", "residuals", "correlation", "history"}
    points, line = figures["fit"].axes[0].lines
    np.testing.assert_array_equal(points.get_ydata(), seen()["position.ball.x"])
    np.testing.assert_allclose(line.get_ydata(), oscillation(), atol=1e-4)
    costs = figures["history"].axes[0].lines[0].get_ydata()
    assert costs[-1] == pytest.approx(2 * fitted.cost / INSTANTS.size)


# Other minima ---------------------------------------------------------------------------------------------------------


def gone_to(problem, name, factor) -> Course:
    """A course that ended with a number so many times too large."""
    u = problem.unknowns.unknowns_of({**TRUTH, name: factor * TRUTH[name]})
    course, found = Course(), problem.evaluate(u[None])
    course.accept(u, found.residuals[0], found.jacobians[0])
    course.ending = Ending.CONVERGED
    return course


def test_no_fit_ends_worse_than_it_began(problem):
    """Parts of a record may lead away from a start that was better."""
    start = problem.unknowns.unknowns_of({**TRUTH, "stiffness": 1.01 * SPRING})
    astray = gone_to(problem, "stiffness", 3.0)
    begun = []

    def minimize(us):
        begun.append(us)
        return sj.studies.LevenbergMarquardt().minimize(problem, us, noise_is_known=True, watch=lambda courses: None)

    (found,) = no_worse_than_starts(problem, [astray], start[None], minimize)
    np.testing.assert_array_equal(begun, [start[None]])
    np.testing.assert_allclose(np.exp(found.u[0]), SPRING, rtol=1e-3)
    assert [tuple(u) for u, _ in found.others] == [tuple(start), tuple(astray.u)]
    assert found.others[1][1] == astray.cost > found.cost
    # A start that is worse, or failed, changes nothing.
    good = gone_to(problem, "stiffness", 1.0)
    (same,) = no_worse_than_starts(problem, [good], start[None], minimize)
    assert same is good
    assert len(begun) == 1


def test_an_interrupt_while_the_start_is_looked_at_loses_nothing(problem, monkeypatch):
    found = gone_to(problem, "stiffness", 1.0)
    start = problem.unknowns.unknowns_of({**TRUTH, "stiffness": 1.01 * SPRING})

    def interrupted(us):
        raise KeyboardInterrupt

    monkeypatch.setattr(problem, "evaluate", interrupted)
    (kept,) = no_worse_than_starts(problem, [found], start[None], interrupted)
    assert kept is found
    assert kept.ending is Ending.INTERRUPTED
    assert kept.us


def test_other_parameters_that_fit_as_well_are_named(fitted):
    far = fitted.problem.unknowns.unknowns_of({"stiffness": 2 * SPRING, "damping": DAMPER})
    near = fitted.u
    for others, said in (([(far, fitted.cost + 1.0)], True), ([(far, fitted.cost + 20.0), (near, fitted.cost)], False)):
        changed = replace(fitted, courses=[replace(fitted.best, others=others)])
        told = [each for each in changed.warnings if "fits as well" in each]
        assert bool(told) is said
        assert not told or "stiffness = 400" in told[0]

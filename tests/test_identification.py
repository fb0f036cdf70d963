"""Identification in the hard cases: impacts, films, bushings, shock absorbers; how far gradients reach."""

import diffrax
import identification as cases
import jax.numpy as jnp
import numpy as np
import pytest
from identification import BALL, DRY, FILM, MOUNT, SHOCK, assert_identified, relative_best

import spherejax as sj
from spherejax.studies.fit import Whole, problem_of

DOPRI8 = diffrax.Dopri8()
GROWING = sj.studies.GrowingHorizon()


def fit(build, start, measured, **options):
    return sj.fit(build, start, measured, solver=DOPRI8, progress=False, **options)


# A ball that bounces in its socket: nine impacts ---------------------------------------------------------------------

BALL_TS = np.linspace(1.5e-4, 9e-3, 60)


def off(clearance, restitution) -> dict:
    """A start that is off by these factors."""
    start = sj.Parameter(BALL["restitution"] * restitution, lower=0.0, upper=1.0)
    return {"clearance": BALL["clearance"] * clearance, "restitution": start}


@pytest.fixture(scope="module")
def ball():
    return cases.measured(cases.ball_in_socket(**BALL), "ball", BALL_TS, cases.MOTION_NOISE, solver=DOPRI8)


@pytest.fixture(scope="module")
def grown(ball):
    return fit(cases.ball_in_socket, off(1.5, 0.5), ball, horizon=GROWING)


@pytest.fixture(scope="module")
def at_once(ball):
    method = sj.studies.LevenbergMarquardt(max_iterations=15)
    return fit(cases.ball_in_socket, off(1.5, 0.5), ball, horizon=Whole(), method=method, max_steps=20_000)


def test_a_growing_horizon_leads_through_nine_impacts(grown):
    assert grown.succeeded
    assert_identified(grown, BALL)
    assert np.all(relative_best(grown, BALL) < 2e-5)
    assert grown.reduced_chi_square == pytest.approx(1.0, abs=0.2)
    assert grown.history["until"][-1] == np.inf
    ends = grown.history["until"].values
    assert np.all(np.diff(ends[np.isfinite(ends)]) >= 0)
    assert not grown.warnings


def test_the_whole_record_at_once_does_not(at_once):
    assert at_once.reduced_chi_square > 1e4
    (warning,) = [each for each in at_once.warnings if "gradient" in each]
    assert "horizon=sj.studies.GrowingHorizon()" in warning


def test_noise_need_not_be_known(ball):
    unsaid = sj.Measured(ball.ts, ball.values)
    assert_identified(fit(cases.ball_in_socket, off(0.5, 0.5), unsaid, horizon=GROWING, max_steps=20_000), BALL)


def test_growth_says_how_far_the_gradient_reaches(grown, at_once):
    growth = grown.growth
    assert growth.start.change == pytest.approx(0.5, abs=0.01)
    # The start meets the socket after half as long again, and the gradient knows nothing of what comes before.
    assert growth.start.until < 9e-4
    until = [each.until for each in growth.steps]
    assert np.all(np.diff(until) >= 0)
    assert until[0] < 2e-3
    assert until[-1] == BALL_TS[-1]
    assert 1e-5 <= growth.reach <= 1e-3
    assert 2 < growth.factor < 6  # by eye, from the picture: the steps between contacts rise threefold
    assert "0.01 percent to the end" in growth.explanation
    assert growth.explanation.endswith("the record had to grow with the fit.")
    assert "GrowingHorizon" in at_once.growth.explanation


def test_the_reach_is_that_of_secants(ball, grown):
    """Found again with plain runs: halfway to the next step the motion has left its tangent, or has not."""
    problem = problem_of(cases.ball_in_socket, off(1.0, 1.0), [ball], solver=DOPRI8)
    direction = np.linalg.svd(problem.jacobian(grown.u))[2][0]
    tangent = np.asarray(problem.jacobian(grown.u) @ direction)
    at = np.asarray(problem.residuals(grown.u))

    def mismatch(change):
        secant = (np.asarray(problem.residuals(grown.u + change * direction)) - at) / change
        return np.linalg.norm(secant - tangent) / np.linalg.norm(tangent)

    assert mismatch(grown.growth.reach / 10) < 0.1
    assert mismatch(30 * grown.growth.reach) > 0.5


def test_jacobian_is_that_of_finite_differences_through_the_onsets(ball):
    problem = problem_of(cases.ball_in_socket, off(1.0, 1.0), [ball], solver=DOPRI8, rtol=1e-10)
    u, step = problem.u0, 1e-7
    jacobian = np.asarray(problem.jacobian(u))
    for k in range(u.size):
        ahead, behind = (problem.residuals(u + sign * step * np.eye(u.size)[k]) for sign in (1, -1))
        differences = np.asarray(ahead - behind) / (2 * step)
        assert differences == pytest.approx(jacobian[:, k], abs=1e-4 * np.max(np.abs(jacobian[:, k])))


def test_an_interrupt_keeps_what_has_been_found(ball):
    told = []

    def interrupting(seen):
        told.append(seen)
        if len(told) >= 12:
            raise KeyboardInterrupt

    stopped = sj.fit(cases.ball_in_socket, off(1.5, 0.5), ball, solver=DOPRI8, horizon=GROWING, progress=interrupting)
    assert "interrupted" in stopped.status
    assert not stopped.succeeded
    assert stopped.estimates["clearance"] == pytest.approx(BALL["clearance"], rel=0.05)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"first": -1.0}, "first = -1.0 must be positive"),
        ({"explained": 0.5}, "explained = 0.5 must be more than 1"),
        ({"restarts": -1}, "restarts = -1 must not be negative"),
    ],
)
def test_bad_horizons_are_refused(options, said):
    with pytest.raises(sj.SceneError, match=said):
        sj.studies.GrowingHorizon(**options)


# The dry four-bar: ten onsets -----------------------------------------------------------------------------------------

DRY_TS = np.arange(1, 81) * 5e-4  # [s]; the eleventh onset comes later


@pytest.fixture(scope="module")
def dry():
    run = sj.simulate(cases.dry_four_bar(**DRY), np.concatenate([[0.0], DRY_TS]), solver=DOPRI8)
    assert int(run.stats.n_onsets[0]) == 10
    return cases.measured(cases.dry_four_bar(**DRY), "rocker", DRY_TS, cases.MOTION_NOISE, solver=DOPRI8)


@pytest.mark.slow
@pytest.mark.parametrize("mu", [0.5, 1.5])
@pytest.mark.parametrize("restitution", [0.5, 1.5])
@pytest.mark.parametrize("clearance", [0.5, 1.5])
def test_dry_joint_from_its_first_ten_onsets(dry, clearance, restitution, mu):
    start = {
        "clearance": DRY["clearance"] * clearance,
        "restitution": sj.Parameter(DRY["restitution"] * restitution, lower=0.0, upper=1.0),
        "mu": DRY["mu"] * mu,
    }
    fitted = fit(cases.dry_four_bar, start, dry, horizon=GROWING)
    assert fitted.succeeded
    assert_identified(fitted, DRY)
    assert fitted.reduced_chi_square == pytest.approx(1.0, abs=0.2)
    assert np.all(relative_best(fitted, DRY) < 0.005)


@pytest.mark.slow
def test_jacobian_of_the_dry_joint_is_that_of_finite_differences(dry):
    start = {name: DRY[name] for name in ("clearance", "mu")}
    start["restitution"] = sj.Parameter(DRY["restitution"], lower=0.0, upper=1.0)
    problem = problem_of(cases.dry_four_bar, start, [dry], solver=DOPRI8, rtol=1e-11)
    u, step = problem.u0, 1e-5  # shorter ones drown in the errors of the runs, longer ones in the curvature
    jacobian = np.asarray(problem.jacobian(u))
    for k in range(u.size):
        ahead, behind = (problem.residuals(u + sign * step * np.eye(u.size)[k]) for sign in (1, -1))
        differences = np.asarray(ahead - behind) / (2 * step)
        assert differences == pytest.approx(jacobian[:, k], abs=1e-3 * np.max(np.abs(jacobian[:, k])))


# Film, mount, shock absorber -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_viscosity_of_a_film():
    ts = np.linspace(2e-3, 0.2, 100)
    film = cases.measured(cases.lubricated_four_bar(**FILM), "rocker", ts, cases.MOTION_NOISE, solver=DOPRI8)
    for factor in (0.5, 1.5):
        fitted = fit(cases.lubricated_four_bar, {"viscosity": factor * FILM["viscosity"]}, film)
        assert fitted.succeeded
        assert_identified(fitted, FILM)
        assert relative_best(fitted, FILM) == pytest.approx([2.5e-3], rel=0.1)


@pytest.mark.slow
def test_six_stiffnesses_of_a_mount_from_two_experiments():
    ts = np.linspace(2e-3, 0.3, 150)
    builders = cases.mount((0.1, 0.2, 0.0), (0.0, 0.0, 1.0)), cases.mount((0.0, 0.0, 0.1), (1.0, 1.0, 0.0))
    experiments = []
    for seed, build in enumerate(builders):
        run = sj.simulate(build(**{k: jnp.asarray(v) for k, v in MOUNT.items()}), np.concatenate([[0.0], ts]))
        noise = 1e-5 * np.random.default_rng(seed).normal(size=(ts.size, 3))
        values = {"position.block": np.asarray(run.position("block"))[1:] + noise}
        experiments.append(sj.Measured(ts, values, noise=1e-5, build=build))
    for factors in ([0.5] * 6, [1.5] * 6, [0.5, 1.5, 0.5, 1.5, 0.5, 1.5]):
        start = {name: value * factor for (name, value), factor in zip(MOUNT.items(), factors, strict=True)}
        fitted = fit(builders[0], start, experiments)
        assert fitted.succeeded
        assert_identified(fitted, MOUNT)
        assert np.all(relative_best(fitted, MOUNT) < 0.005)


@pytest.mark.slow
def test_shock_absorber_of_the_suspension_from_the_motion_of_the_wheel():
    ts = np.linspace(5e-3, 1.2, 240)
    truth = {name: jnp.asarray(value) for name, value in SHOCK.items()}
    scene = cases.suspension_over_a_bump(**truth)
    wheel = cases.measured(scene, "wheel", ts, cases.WHEEL_NOISE, components="z", solver=DOPRI8)
    for factor in (0.5, 1.5):
        start = {name: sj.Parameter(factor * value, positive=False) for name, value in SHOCK.items()}
        fitted = fit(cases.suspension_over_a_bump, start, wheel)
        assert fitted.succeeded
        assert_identified(fitted, SHOCK)
        assert np.all(relative_best(fitted, SHOCK) < 0.005)

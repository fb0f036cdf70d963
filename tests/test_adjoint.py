"""Gradients of a fit in reverse: forward sensitivities and differences say the same, through impacts and stiffness."""

import diffrax
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from identification import ball_in_socket

import spherejax as sj
from spherejax.motion.derivatives import pullback
from spherejax.studies.fit import Whole, problem_of


def assert_gradient(problem, within, u=None):
    """Cost and gradient in reverse are those of forward sensitivities."""
    u = problem.u0 if u is None else u
    found = problem.cost_and_gradient(u)
    residuals, jacobian = (np.asarray(part) for part in problem.residuals_and_jacobian(u))
    assert found.diagnosis == ""
    assert found.cost == pytest.approx(residuals @ residuals / 2, rel=within)
    forward = jacobian.T @ residuals
    np.testing.assert_allclose(found.gradient, forward, atol=within * np.linalg.norm(forward))
    return found.gradient


def difference(problem, direction, h):
    """The slope of the cost along a direction, by runs without derivatives."""
    ends = [np.asarray(problem.residuals(jnp.asarray(problem.u0 + s * direction))) for s in (-h, h)]
    return (ends[1] @ ends[1] - ends[0] @ ends[0]) / (4 * h)


# Bushings -----------------------------------------------------------------------------------------------------------


def bob(stiffness, damping, length, speed=0.0):
    """A bob in a bushing; its length enters the start and where the ball is, and it may be thrown."""
    length = jnp.asarray(length)
    ball = -length * jnp.array([1.0, 0.0, 0.0])
    body = sj.Body(0.1, (1e-4,) * 3, position=-ball, velocity=speed * jnp.array([0.0, 1.0, 0.0]), points={"ball": ball})
    joint = sj.Spherical("ground.hook", "bob.ball", sj.Bushing(stiffness, damping), starts_concentric=not speed)
    return sj.Scene({"bob": body}, {"hook": joint}, ground_points={"hook": (0.0, 0.0, 0.0)})


def thrown(stiffness, damping, length):
    return bob(stiffness, damping, length, speed=0.5)


SOFT = {"stiffness": 1e4, "damping": 1e-3, "length": 0.05}
EARLY, LATE = np.linspace(0.002, 0.03, 15), np.sort(np.random.default_rng(0).uniform(0.0, 0.05, 9))


def tip(run):
    """Where the free end of the bob is."""
    return 2 * run.position("bob")


def hung(truth):
    """A bob let go, and one thrown, measured at other times: positions, forces, works, functions, gaps."""
    runs = [
        sj.simulate(build(**truth), np.concatenate([[0.0], ts]), track_work=True)
        for build, ts in ((bob, EARLY), (thrown, LATE))
    ]
    forces = np.array(runs[0].reaction("hook"))[1:]
    forces[3] = np.nan
    first = sj.Measured(
        EARLY,
        {"reaction.hook": forces, "position.bob.z": np.asarray(runs[0].position("bob"))[1:, 2]},
        noise={"reaction.hook": 0.1, "position.bob.z": 1e-4},
    )
    second = sj.Measured(
        LATE,
        {"acceleration.bob": np.asarray(runs[1].acceleration("bob"))[1:], "tip": np.asarray(tip(runs[1]))[1:]},
        noise={"acceleration.bob": 1.0, "tip": 1e-4},
        build=thrown,
        functions={"tip": tip},
    )
    return [first, second]


@pytest.mark.slow
def test_two_experiments_with_a_bushing():
    problem = problem_of(bob, {name: 1.1 * value for name, value in SOFT.items()}, hung(SOFT))
    gradient = assert_gradient(problem, 1e-6)
    direction = np.array([1.0, -1.0, 0.02])
    assert direction @ gradient == pytest.approx(difference(problem, direction, 1e-4), rel=1e-4)


STIFF = {"stiffness": 1e6, "damping": 1e-2}


def stiff(stiffness, damping):
    return bob(stiffness, damping, 0.05)


@pytest.mark.parametrize(
    "solver",
    [pytest.param(sj.solvers.Rodas5P(), marks=pytest.mark.slow), diffrax.Kvaerno5()],
    ids=["Rosenbrock", "implicit"],
)
def test_a_stiff_bushing(solver):
    """Through the checkpoints of an adaptive run this was NaN. An implicit method gets the steps of Rodas5P."""
    run = sj.simulate(stiff(**STIFF), np.concatenate([[0.0], EARLY]), rtol=1e-9, solver=sj.solvers.Rodas5P())
    measured = sj.Measured(EARLY, {"position.bob": np.asarray(run.position("bob"))[1:]}, noise=1e-8)
    problem = problem_of(stiff, {"stiffness": 5e5, "damping": 5e-3}, [measured], solver=solver)
    rosenbrock = problem_of(stiff, {"stiffness": 5e5, "damping": 5e-3}, [measured], solver=sj.solvers.Rodas5P())
    gradient = problem.cost_and_gradient(problem.u0).gradient
    if isinstance(solver, sj.solvers.Rodas5P):
        assert_gradient(problem, 1e-4)
    for direction in np.eye(2):
        assert direction @ gradient == pytest.approx(difference(rosenbrock, direction, 3e-4), rel=1e-4)


# Impacts ------------------------------------------------------------------------------------------------------------

BALL = {"clearance": 1e-4, "restitution": 0.8}
BOUNCES = np.linspace(2e-4, 4e-3, 20)


def bounced():
    run = sj.simulate(ball_in_socket(**BALL), np.concatenate([[0.0], BOUNCES]))
    assert int(run.stats.n_onsets[0]) >= 4
    return {"time": BOUNCES, "position.ball": np.asarray(run.position("ball"))[1:]}


@pytest.mark.slow
def test_through_impacts(monkeypatch):
    """With room for few steps: the run is cut into stretches."""
    monkeypatch.setattr(pullback, "ROOM", 32)
    start = {"clearance": 1.05e-4, "restitution": 0.75}
    problem = problem_of(ball_in_socket, start, [sj.Measured(BOUNCES, {"position.ball": bounced()["position.ball"]})])
    gradient = assert_gradient(problem, 1e-6)
    for direction in np.eye(2):
        assert direction @ gradient == pytest.approx(difference(problem, direction, 1e-5), rel=1e-3)


def test_a_run_that_cannot_be_made_says_why():
    measured = sj.Measured(BOUNCES, {"position.ball": bounced()["position.ball"]})
    problem = problem_of(ball_in_socket, BALL, [measured], max_steps=20)
    found = problem.cost_and_gradient(problem.u0)
    assert np.isnan(found.cost)
    assert np.isnan(found.gradient).all()
    assert "steps" in found.diagnosis


# Many parameters ----------------------------------------------------------------------------------------------------

KNOTS = np.linspace(0.0, 1.0, 21)


class AlongX(eqx.Module):
    """A force along x by a function of time."""

    history: sj.functions.SmoothTable

    def __call__(self, t):
        return jnp.stack([self.history(t), 0.0, 0.0])


def pushed(forces):
    """A body under a force of unknown history along x."""
    push = sj.AppliedWrench("body", AlongX(sj.functions.SmoothTable(KNOTS, forces)))
    return sj.Scene({"body": sj.Body(2.0, (1e-3,) * 3)}, {}, forces={"push": push}, gravity=(0.0, 0.0, 0.0))


@pytest.mark.slow
def test_descent_recovers_a_history_of_many_numbers():
    truth = np.sin(5 * KNOTS) + 0.3 * np.cos(9 * KNOTS)
    ts = np.linspace(0.0, 1.0, 41)
    run = sj.simulate(pushed(truth), ts)
    values = {"acceleration.body.x": run.acceleration("body")[:, 0], "position.body.x": run.position("body")[:, 0]}
    measured = sj.Measured(ts, {name: np.asarray(value) for name, value in values.items()})
    start = {"forces": sj.Parameter(np.zeros(21), positive=False, scale=1.0)}
    method = sj.studies.Descent(
        optax.adam(optax.exponential_decay(0.1, 300, 1e-2)), n_steps=300, tolerance=1e-9, reverse=True
    )
    noise = {"acceleration.body.x": 1e-2, "position.body.x": 1e-2}
    fitted = sj.fit(pushed, start, measured, noise=noise, method=method, horizon=Whole())
    np.testing.assert_allclose(fitted.estimates["forces"], truth, atol=0.02)

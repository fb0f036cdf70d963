"""Derivatives of runs by their sample times: the offset of a clock is a number like any other.

A sample moves by its rate, the first time moves the start: closed forms, for motions in which time enters by itself
and for those in which it does not, on every way of integrating.
"""

import cases
import controlling
import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.motion.integration.lanes.operation import SerialRunsWarning

TS = np.array([0.3, 0.55, 0.9])
MASS, PUSH, OMEGA = 0.7, 2.0, 5.0


def pushed(mass=MASS, phase=0.0) -> sj.Scene:
    """A free body that a force pushes which depends on time."""
    body = sj.Body(mass, (1e-3,) * 3, position=(0.1, 0.0, 0.0), velocity=(0.4, 0.0, 0.0))
    force = sj.AppliedWrench("body", force=lambda t: PUSH * jnp.array([1.0, 0.0, 0.0]) * jnp.sin(OMEGA * t))
    return sj.Scene({"body": body}, forces={"push": force}, gravity=(0.0, 0.0, 0.0))


def motion(run, body="body"):
    """Position, velocity and acceleration along x, shape (3, n)."""
    return jnp.stack([run.position(body)[:, 0], run.velocity(body)[:, 0], run.acceleration(body)[:, 0]])


def exact_motion(ts, mass=MASS):
    a, t0 = PUSH / mass, ts[0]
    x = 0.1 + (0.4 + a / OMEGA * jnp.cos(OMEGA * t0)) * (ts - t0)
    x = x - a / OMEGA**2 * (jnp.sin(OMEGA * ts) - jnp.sin(OMEGA * t0))
    v = 0.4 + a / OMEGA * (jnp.cos(OMEGA * t0) - jnp.cos(OMEGA * ts))
    return jnp.stack([x, v, a * jnp.sin(OMEGA * ts)])


WAYS = {
    "lane": {},
    "array code": {"scalar": False},
    "Rosenbrock": {"solver": sj.solvers.Rodas5P()},
    "own control": {"stepsize_controller": diffrax.PIDController(1e-9, 1e-11)},
    "implicit": {"solver": diffrax.Kvaerno5()},
}
SLOW = ("array code", "own control", "implicit")


@pytest.mark.parametrize("way", [pytest.param(way, marks=[pytest.mark.slow] * (way in SLOW)) for way in WAYS])
def test_by_every_sample_time_where_time_enters_by_itself(way):
    def of_times(ts):
        return motion(sj.simulate(pushed(), ts, rtol=1e-9, **WAYS[way]))

    exact = jax.jacfwd(exact_motion)(jnp.asarray(TS))
    np.testing.assert_allclose(jax.jacfwd(of_times)(jnp.asarray(TS)), exact, atol=1e-6)


@pytest.mark.parametrize("mode", [jax.jacfwd, lambda f: jax.jit(jax.jacrev(f))], ids=["forward", "jit of reverse"])
def test_by_the_offset_of_a_clock_and_the_mass_together(mode):
    def of_numbers(numbers):
        return motion(sj.simulate(pushed(numbers[1]), TS + numbers[0] * np.array([1.0, 0.5, 2.0]), rtol=1e-9))

    def exact(numbers):
        return exact_motion(TS + numbers[0] * jnp.array([1.0, 0.5, 2.0]), numbers[1])

    at = jnp.array([0.02, MASS])
    np.testing.assert_allclose(mode(of_numbers)(at), jax.jacfwd(exact)(at), atol=1e-6)


def test_residuals_of_two_records_whose_clocks_are_late_by_unknown_times():
    """What a fit of clock offsets solves: each record depends on its own offset, and both on the mass.

    The motion of both begins at 0, so that the offsets move the samples alone.
    """
    instants = (np.array([0.2, 0.5]), np.array([0.3, 0.6, 0.8]))

    def residuals(numbers):
        starts = [jnp.concatenate([jnp.zeros(1), ts + late]) for ts, late in zip(instants, numbers[:2], strict=True)]
        return jnp.concatenate(
            [sj.simulate(pushed(numbers[2]), ts, rtol=1e-9).position("body")[1:, 0] for ts in starts]
        )

    def exact(numbers):
        starts = [jnp.concatenate([jnp.zeros(1), ts + late]) for ts, late in zip(instants, numbers[:2], strict=True)]
        return jnp.concatenate([exact_motion(ts, numbers[2])[0, 1:] for ts in starts])

    at = jnp.array([0.013, -0.02, MASS])
    found = jax.jit(jax.jacfwd(residuals))(at)
    np.testing.assert_allclose(found, jax.jacfwd(exact)(at), atol=1e-6)
    assert not np.any(found[:2, 1])
    assert not np.any(found[2:, 0])


def crank(mass=0.5) -> sj.Scene:
    """A body on a hinge whose angle is prescribed: where it is follows from the time alone."""
    body = sj.Body(mass, (1e-2,) * 3, position=(0.0, 0.2, 0.0))
    joints = {
        "hinge": sj.Revolute(("ground", "body"), point=(0.0, 0.0, 0.0), axis=(1.0, 0.0, 0.0)),
        "drive": sj.RotationDriver(("ground", "body"), (1.0, 0.0, 0.0), lambda t: 0.4 * jnp.sin(OMEGA * t)),
    }
    return sj.Scene({"body": body}, joints, gravity=(0.0, 0.0, 0.0))


def test_a_driven_start_moves_with_the_first_sample_time():
    """Each sample depends on its own time alone, the assembled start too; so does what the driver exerts."""

    def of_times(ts):
        run = sj.simulate(crank(), ts, rtol=1e-9)
        return jnp.stack([run.position("body")[:, 1], run.velocity("body")[:, 1], run.driving_effort("drive")])

    def exact(ts):
        angle, inertia = 0.4 * jnp.sin(OMEGA * ts), 1e-2 + 0.5 * 0.2**2
        rate = 0.4 * OMEGA * jnp.cos(OMEGA * ts)
        return jnp.stack([0.2 * jnp.cos(angle), -0.2 * rate * jnp.sin(angle), -inertia * OMEGA**2 * angle])

    ts = jnp.asarray(TS)
    np.testing.assert_allclose(of_times(ts), exact(ts), atol=1e-8)
    np.testing.assert_allclose(jax.jacrev(of_times)(ts), jax.jacfwd(exact)(ts), atol=1e-6)


def falling(ts, gravity=9.81):
    scene = sj.Scene({"body": sj.Body(1.0, (1e-3,) * 3, velocity=(0.0, 0.0, 3.0))}, gravity=(0.0, 0.0, -gravity))
    return sj.simulate(scene, ts).position("body")[:, 2]


def test_where_time_does_not_enter_only_differences_count_and_no_row_is_integrated():
    found = jax.jacfwd(falling)(jnp.asarray(TS))
    speeds = 3.0 - 9.81 * (TS - TS[0])
    expected = np.diag(speeds) - np.outer(speeds, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(found, expected, atol=1e-9)
    twice = jax.hessian(lambda ts: falling(ts)[-1])(jnp.asarray(TS))
    np.testing.assert_allclose(twice, -9.81 * np.outer([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), atol=1e-8)


def test_many_offsets_at_once():
    def height(offset):
        return falling(TS + offset * np.array([0.0, 1.0, 1.0]))[-1]

    offsets = jnp.array([0.0, 0.1])
    with pytest.warns(SerialRunsWarning):
        slopes = jax.vmap(jax.grad(height))(offsets)
    np.testing.assert_allclose(slopes, 3.0 - 9.81 * (TS[-1] - TS[0] + offsets), atol=1e-9)
    # Many scenes, one offset: they share their sample times, and their lanes.

    def lower(offset, gravity):
        return falling(TS + offset * np.array([0.0, 1.0, 1.0]), gravity)[-1]

    along = jax.jit(jax.vmap(jax.jacfwd(lower), (None, 0)))
    np.testing.assert_allclose(along(0.1, jnp.array([1.0, 5.0])), 3.0 - 0.7 * np.array([1.0, 5.0]), atol=1e-9)


def test_what_has_no_derivative_by_time_says_so():
    ts = jnp.asarray(TS)
    twice = jax.hessian(lambda offset: motion(sj.simulate(pushed(), ts * (1 + offset))).sum())
    with pytest.raises(
        sj.SceneError, match=r"second derivatives of a run by its sample times .* differences of jax\.grad"
    ):
        twice(0.0)
    mixed = jax.jacfwd(jax.grad(lambda g, offset: falling(ts * (1 + offset), g).sum()), 1)
    with pytest.raises(sj.SceneError, match="second derivatives of a run by its sample times"):
        mixed(9.81, 0.0)
    adjoint = diffrax.DirectAdjoint()
    with pytest.raises(sj.SceneError, match="DirectAdjoint gives no derivative by sample times"):
        jax.grad(lambda offset: sj.simulate(pushed(), ts + offset, adjoint=adjoint, max_steps=100).ys.sum())(0.0)


@pytest.mark.slow
def test_through_contact_where_time_enters_by_itself():
    """A ball that a force drives to and fro in its socket, through several impacts, against differences."""
    ball = cases.ball_in_socket(sj.Dry(1e-4, normal=sj.LankaraniNikravesh(restitution=0.7)), 0.2)
    push = sj.AppliedWrench("ball", force=lambda t: jnp.array([0.3, 0.0, 0.0]) * jnp.cos(60 * t))
    scene = sj.Scene(
        ball.bodies, ball.joints, {"push": push}, gravity=(0.0, 0.0, 0.0), ground_points=ball.ground_points
    )

    def place(first):
        ts = jnp.stack([first, 0.06, 0.1])
        run = sj.simulate(scene, ts, rtol=1e-11)
        return jnp.stack([run.position("ball")[:, 0] / 1e-4, run.velocity("ball")[:, 0] / 1e-2]), run

    assert int(place(jnp.array(0.003))[1].stats.n_onsets[0]) >= 3
    h = 1e-6
    difference = (place(jnp.array(0.003 + h))[0] - place(jnp.array(0.003 - h))[0]) / (2 * h)
    found = jax.jacfwd(lambda first: place(first)[0])(jnp.array(0.003))
    np.testing.assert_allclose(found, difference, atol=1e-4 * np.abs(difference).max())


def test_a_clock_that_samples_has_no_derivative_by_its_offset():
    scene = controlling.sampled_motor(0.01)
    with pytest.raises(sj.SceneError, match="samples at instants of its own"):
        jax.grad(lambda offset: sj.simulate(scene, TS + offset).ys.sum())(0.0)


def test_a_failed_run_has_the_derivative_nan_and_its_warning_is_worded():
    """In forward and in reverse mode, outside of `jax.jit` too, where the warning is given."""

    def height(mass):
        scene = sj.gallery.physical_pendulum(sj.Dry(1e-3), mass=mass)
        return sj.simulate(scene, jnp.linspace(0.0, 0.1, 3), max_steps=5).ys[-1, 1]

    for derivative in (jax.grad, jax.jacfwd):
        with pytest.warns(sj.SimulationWarning, match="stopped at t = .* max_steps"):
            assert np.isnan(derivative(height)(1.0))
        assert np.isnan(jax.jit(derivative(height))(1.0))

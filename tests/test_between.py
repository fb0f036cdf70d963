"""The state of a run at any time: against closed forms, within impacts too, with derivatives, on every road."""

from dataclasses import replace

import cases
import controlling
import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import gamma
from test_continuation import block, block_at

import spherejax as sj
from spherejax.motion.equations.quantities import magnitudes

pytestmark = pytest.mark.filterwarnings(
    "ignore::spherejax.errors.OutOfRangeWarning"
)  # 0.5 m/s press beyond Eq. 24's range

GAP, STIFFNESS, SPEED = 1e-4, 1e10, 0.5
BALL = 0.2
ENDS = np.array([0.0, 6e-4])
HALF = 0.8 * np.sqrt(np.pi) * gamma(0.4) / gamma(0.9) / 2
"""Of the time that a ball spends in Hertz's contact, in units of depth / speed: the integral of (1 - x^2.5)^-0.5."""


def ball(speed=SPEED):
    model = sj.Dry(clearance=GAP, normal=sj.Hertz(stiffness=STIFFNESS))
    return cases.ball_in_socket(model, BALL, (0.0, 0.0, speed))


def depth(speed):
    return (1.25 * BALL * speed**2 / STIFFNESS) ** 0.4


def instants(speed=SPEED):
    """In flight, where the ball is deepest, and in flight behind the impact."""
    onset = GAP / speed
    return np.array([0.5 * onset, onset + HALF * depth(speed) / speed, onset + 2 * HALF * depth(speed) / speed + 1e-4])


def heights(speed=SPEED):
    """Of the ball at `instants` of the usual speed."""
    flight, _, behind = instants()
    release = GAP / speed + 2 * HALF * depth(speed) / speed
    return np.array([speed * flight, GAP + depth(SPEED), GAP - speed * (behind - release)])


@pytest.fixture(scope="module")
def run():
    return sj.simulate(ball(), ENDS, rtol=1e-10)


def test_the_state_is_that_of_the_closed_form_within_an_impact_too(run):
    times = instants()
    states = run.at(times[::-1])  # in any order
    np.testing.assert_allclose(states.t, times[::-1])
    np.testing.assert_allclose(states.position("ball")[::-1, 2], heights(), atol=1e-12)
    np.testing.assert_allclose(states.velocity("ball")[::-1, 2], [SPEED, 0.0, -SPEED], atol=2e-5 * SPEED)
    force = STIFFNESS * depth(SPEED) ** 1.5
    np.testing.assert_allclose(states.value("reaction.joint.z")[::-1], [0.0, -force, 0.0], rtol=1e-7, atol=1e-7 * force)
    np.testing.assert_allclose(states.value("penetration.joint")[1], depth(SPEED), rtol=1e-7)
    energies = np.asarray(states.value("mechanical_energy"))
    np.testing.assert_allclose(energies, BALL * SPEED**2 / 2, rtol=1e-8)
    # One of them has the shape of one.
    one = run.at(times[1])
    np.testing.assert_allclose(one.y, states.y[1], rtol=1e-12)
    assert one.value("reaction.joint").shape == one.position("ball").shape == (3,)
    np.testing.assert_allclose(one.observation.kinetic_energy, 0.0, atol=1e-9)


def test_a_motion_goes_on_from_the_middle_of_a_run(run):
    behind = instants()[2]
    other = sj.continue_from(run.at(behind), [behind, behind + 1e-5])
    np.testing.assert_allclose(other.position("ball")[-1, 2], heights()[2] - SPEED * 1e-5, atol=1e-12)


def test_samples_cost_nothing_and_repeat_to_the_last_bit(run):
    np.testing.assert_array_equal(run.at(ENDS).y, run.ys)
    fine = sj.simulate(ball(), np.linspace(*ENDS, 61), rtol=1e-10)
    np.testing.assert_array_equal(fine.at(fine.ts[7] + 1e-6).y, fine.at(np.array([fine.ts[7] + 1e-6, 3e-4])).y[0])


SCENES = {
    "oscillator": (block, 1.0, {}),
    "oscillator by a Rosenbrock method": (block, 1.0, {"solver": sj.solvers.Rodas5P()}),
    "oscillator by diffrax": (block, 1.0, {"solver": diffrax.Kvaerno5()}),
    "oscillator on array code": (block, 1.0, {"scalar": False}),
    "four-bar": (lambda: sj.gallery.four_bar(sj.Dry(clearance=1e-4)), 0.2, {}),
    "sampled controller": (lambda: controlling.sampled_motor(0.01), 0.1, {}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_a_run_that_is_sampled_there_says_the_same(name):
    build, t_end, options = SCENES[name]
    scene, ts = build(), np.linspace(0.0, t_end, 5)
    between = np.array([0.31, 0.77]) * t_end
    run = sj.simulate(scene, ts, rtol=1e-9, **options)
    there = sj.simulate(scene, np.unique([*ts, *between]), rtol=1e-9, **options)
    expected = there.ys[np.searchsorted(there.ts, between)]
    np.testing.assert_allclose(run.at(between).y, expected, rtol=1e-10, atol=1e-12)
    traced = jax.jit(lambda run, t: run.at(t).y)(run, between)
    # A program of traced numbers rounds in its own way, and impacts of the dry four-bar amplify that.
    np.testing.assert_allclose(traced, expected, rtol=1e-5, atol=2e-6 if name == "four-bar" else 1e-8)


@pytest.mark.slow
def test_derivatives_by_numbers_and_by_the_time():
    """By the speed of a ball, behind its impact, and by the time: in forward and in reverse mode, under `jit`."""
    behind = instants()[2]

    def height(speed, t):
        return sj.simulate(ball(speed), ENDS, rtol=1e-10).at(t).position("ball")[2]

    by_speed, by_time = jax.jit(jax.grad(height, (0, 1)))(SPEED, behind)
    # c - v (t - c/v - T v^-1/5)
    duration = 2 * HALF * depth(SPEED) / SPEED
    np.testing.assert_allclose(by_speed, -behind + 0.8 * duration, rtol=1e-6)
    np.testing.assert_allclose(by_time, -SPEED, rtol=1e-8)


@pytest.mark.slow
def test_many_runs_and_runs_that_go_on():
    ks = jnp.array([3.0, 8.0])
    ts, between = np.linspace(0.0, 1.0, 3), np.array([0.7, 0.2])
    expected = [[block_at(t, 0.0, 1.0, k, 0.0)[0] for t in between] for k in (3.0, 8.0)]

    def places(k):
        states = sj.simulate(block(k), ts, rtol=1e-10).at(between)
        return states.position("block")[:, 0], states.value("kinetic_energy")

    found, energies = jax.vmap(places)(ks)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert energies.shape == (2, 2)
    runs = jax.vmap(lambda k: sj.simulate(block(k), ts, rtol=1e-10))(ks)
    states = jax.vmap(lambda run: run.at(between))(runs)
    np.testing.assert_allclose(states.position("block")[..., 0], expected, atol=1e-9)
    with pytest.raises(sj.SceneError, match=r"jax\.vmap"):
        runs.at(0.3)

    def behind_a_seam(k):
        first = sj.simulate(block(k), np.array([0.0, 0.3]), rtol=1e-10)
        return sj.continue_from(first, np.array([0.3, 1.0])).at(0.7).position("block")[0]

    step = 1e-5
    slope = (block_at(0.7, 0.0, 1.0, 8.0 + step, 0.0)[0] - block_at(0.7, 0.0, 1.0, 8.0 - step, 0.0)[0]) / (2 * step)
    value, derivative = jax.value_and_grad(behind_a_seam)(8.0)
    np.testing.assert_allclose(value, expected[1][0], atol=1e-9)
    np.testing.assert_allclose(derivative, slope, rtol=1e-6)


def test_times_that_are_none_are_answered_in_words(run):
    for t, words in (
        (7e-4, r"outside of the run, which goes from 0 s to 0\.0006 s.*continue_from"),
        (-1.0, "outside of the run"),
        (np.nan, "must be finite"),
        ("0.1", "is no time"),
        ([[1e-4]], "shape"),
        ([], "shape"),
    ):
        with pytest.raises(sj.SceneError, match=words):
            run.at(t)
    with pytest.raises(sj.SceneError, match="cannot be repeated"):
        replace(run, settings=None).at(1e-4)  # its tolerances were traced
    with pytest.raises(sj.SceneError, match=r"a ball that flies; run\.impacts\('joint'\)"):
        magnitudes(run.system, 0.0, run.ys[0], ("penetration.joint",))
    with pytest.raises(sj.SceneError, match="adds up from the start"):
        run.at(1e-4).value("dissipated_energy.joint")


@pytest.mark.slow
def test_in_a_trace_a_time_outside_of_the_run_has_a_status(run):
    state = jax.jit(lambda t: run.at(t))(jnp.array([1e-4, 7e-4, jnp.nan]))
    np.testing.assert_array_equal(state.ended, [0, sj.Status.BAD_VALUE, sj.Status.BAD_VALUE])
    np.testing.assert_array_equal(np.isnan(state.position("ball")[:, 2]), [False, True, True])


@pytest.mark.slow
def test_a_run_that_failed_has_states_as_far_as_it_came():
    with pytest.warns(sj.SimulationWarning, match="max_steps"):
        run = sj.simulate(block(8.0), np.array([0.0, 10.0]), max_steps=6)
    reached = float(run.t_reached)
    assert 0 < reached < 10
    at = 0.7 * reached
    np.testing.assert_allclose(run.at(at).position("block")[0], block_at(at, 0.0, 1.0, 8.0, 0.0)[0], atol=1e-6)
    with pytest.raises(sj.SimulationError, match="did not come to t = 9 s"):
        run.at(9.0)
    states = jax.jit(lambda run: run.at(np.array([9.0, at])))(run)
    np.testing.assert_array_equal(states.ended, [sj.Status.TOO_MANY_STEPS, 0])

"""The four-bar against published numbers and against own references in minimal coordinates."""

import cases
import jax.numpy as jnp
import numpy as np
import pytest
import reduction
from scipy.integrate import solve_ivp

import spherejax as sj
from spherejax.model.system import flatten_system
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for

TIMES = np.array([0.0, 0.2, 0.5, 1.0, 2.0])
# An exact reduction to one degree of freedom, printed digits: crank [deg], rocker z [m], z_dot [m/s], z_ddot [m/s^2].
TABLE = np.array(
    [
        [0.0, 0.032624, 0.0, -0.36507],
        [83.0764, 0.028212, 0.103059, 0.65731],
        [264.5104, 0.030147, 0.118415, -1.09939],
        [145.8921, 0.036933, 0.012191, -1.12913],
        [302.1988, 0.036299, 0.004665, -0.18590],
    ]
)
SIZE = 0.1  # of the mechanism [m]


@pytest.fixture(scope="module")
def reduced():
    return [reduction.instant(*y) for y in reduction.ideal_motion(TIMES).T]


@pytest.fixture(scope="module")
def tight():
    """The ideal four-bar at 1e-10, from a start that closes to rounding."""
    return sj.simulate(cases.exact_four_bar(), jnp.asarray(TIMES), rtol=1e-10, atol=1e-12).require_success()


def test_reduction_reproduces_the_table(reduced):
    assert np.degrees([i.crank_angle for i in reduced]) == pytest.approx(TABLE[:, 0], abs=6e-5)
    assert [i.rocker_z for i in reduced] == pytest.approx(TABLE[:, 1], abs=6e-7)
    assert [i.rocker_z_rate for i in reduced] == pytest.approx(TABLE[:, 2], abs=6e-7)
    # The printed accelerations are good to 4e-5 m/s^2 only; z and z_dot, from which they follow, to all digits.
    assert np.array([i.rocker_z_acceleration for i in reduced]) == pytest.approx(TABLE[:, 3], abs=5e-5)


def test_reduction_reproduces_turning_points_swing_and_peak():
    at, angles = reduction.turning_points()
    assert at == pytest.approx([0.6759, 1.3519], abs=1e-4)
    assert np.degrees(angles) == pytest.approx([302.866, 0.0], abs=1e-3)
    t, peak = reduction.largest_acceleration(0.47, 0.49)
    assert t == pytest.approx(0.4781, abs=1e-4)
    assert peak == pytest.approx(11.094, abs=1e-3)


def test_defaults_meet_the_table():
    run = sj.simulate(sj.gallery.four_bar(), jnp.asarray(TIMES)).require_success()
    z = run.position("rocker")[:, 2]
    assert np.asarray(z) == pytest.approx(TABLE[:, 1], abs=2e-6)
    assert np.asarray(z) == pytest.approx(TABLE[:, 1], abs=6e-7)


def test_motion_meets_the_reduction(tight, reduced):
    z, z_rate = tight.position("rocker")[:, 2], tight.velocity("rocker")[:, 2]
    assert np.asarray(z) == pytest.approx([i.rocker_z for i in reduced], abs=1e-8)
    assert np.asarray(z_rate) == pytest.approx([i.rocker_z_rate for i in reduced], abs=1e-7)
    z_acceleration = np.asarray(tight.acceleration("rocker"))[:, 2]
    # Against the largest acceleration of the motion, 11 m/s^2.
    assert z_acceleration == pytest.approx([i.rocker_z_acceleration for i in reduced], abs=11 * 1e-7)


def test_every_body_goes_by_its_own_name(tight):
    phi, phi_rate = reduction.ideal_motion(TIMES)
    spin = np.stack([phi_rate, 0 * phi_rate, 0 * phi_rate], 1)
    assert np.asarray(tight.position("crank")) == pytest.approx(np.zeros((5, 3)), abs=1e-8)
    assert np.asarray(tight.angular_velocity("crank")) == pytest.approx(spin, abs=1e-6 * np.abs(spin).max())
    centers = np.stack([reduction.coupler_center(angle) for angle in phi])
    assert np.asarray(tight.position("coupler")) == pytest.approx(centers, abs=1e-8)
    assert np.asarray(tight.acceleration("crank")) == pytest.approx(np.zeros((5, 3)), abs=11 * 1e-7)


def test_reactions_meet_the_reduction(tight, reduced):
    expected = np.stack([i.reaction for i in reduced])
    scale = np.abs(expected).max()
    assert np.asarray(tight.reaction("coupler_rocker")) == pytest.approx(expected, abs=1e-7 * scale)


def test_crank_turns_back_where_the_reduction_does():
    at, _ = reduction.turning_points()
    run = sj.simulate(cases.exact_four_bar(), jnp.asarray([0.0, *at]), rtol=1e-10, atol=1e-12)
    crank_rate = np.asarray(run.angular_velocity("crank"))[1:, 0]
    # 10 rad/s is the scale of the crank's rate.
    assert crank_rate == pytest.approx([0.0, 0.0], abs=10 * 1e-7)


@pytest.fixture(scope="module")
def same_equations():
    """The package's own right-hand side under SciPy's DOP853 at 1e-13: only the integrator differs."""
    scene = sj.gallery.four_bar()
    system = sj.equations.compile_scene(scene).system
    structure, theta = flatten_system(system)
    rate = program_for(state_rate, structure)
    start = sj.simulate(scene, cases.times(1e-3)).ys[0]
    run = solve_ivp(
        lambda t, y: np.asarray(rate(theta, t, y)),
        (0.0, 2.0),
        np.asarray(start),
        "DOP853",
        t_eval=TIMES,
        rtol=1e-13,
        atol=1e-15,
    )
    assert run.success
    return run.y.T


@pytest.mark.parametrize("rtol", [1e-6, 1e-8, 1e-10])
def test_error_is_within_ten_times_the_tolerance(same_equations, rtol):
    run = sj.simulate(sj.gallery.four_bar(), jnp.asarray(TIMES), rtol=rtol, atol=rtol / 100).require_success()
    expected = same_equations[:, :21].reshape(len(TIMES), 3, 7)[:, :, :3]
    positions = np.stack([run.position(name) for name in sorted(run.system.bodies)], 1)
    assert np.abs(positions - expected).max() <= 10 * rtol * SIZE


@pytest.fixture(scope="module")
def event_exact():
    return reduction.dry_motion(0.2)


@pytest.mark.parametrize(("rtol", "error"), [(1e-8, 1e-10), (1e-10, 1e-11)])
def test_dry_friction_meets_an_event_exact_reference(event_exact, rtol, error):
    z, n_onsets, _ = event_exact
    scene = cases.exact_four_bar(cases.FOUR_BAR_MODELS["friction"])
    run = sj.simulate(scene, cases.times(0.2), rtol=rtol, atol=rtol / 100).require_success()
    assert float(run.position("rocker")[-1, 2]) == pytest.approx(z, abs=error)
    assert int(run.stats.n_onsets[0]) == n_onsets

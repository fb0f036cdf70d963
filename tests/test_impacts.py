"""Contacts one by one, and peaks, against closed forms and against samples that are far finer than an impact."""

import cases
import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.motion.results.impacts import peak_of
from spherejax.motion.results.steps import SHARES, PartingWarning, steps_of
from spherejax.motion.results.within_steps import NODES

COARSE = np.array([0.0, 0.004, 0.01])
pytestmark = pytest.mark.filterwarnings(
    "ignore::spherejax.errors.OutOfRangeWarning"
)  # 0.5 m/s press beyond Eq. 24's range


def bounced(model, **options):
    return sj.simulate(cases.ball_in_socket(model, 0.2, (0.0, 0.3, 0.4)), COARSE, rtol=1e-9, **options)


@pytest.fixture(scope="module")
def run():
    return bounced(sj.Dry(clearance=1e-4, friction=sj.Threlfall()), track_work=True)


@pytest.fixture(scope="module")
def fine():
    """The same with samples 50 ns apart."""
    scene = cases.ball_in_socket(sj.Dry(clearance=1e-4, friction=sj.Threlfall()), 0.2, (0.0, 0.3, 0.4))
    return sj.simulate(scene, np.linspace(0.0, 0.01, 200_001), rtol=1e-9, track_work=True)


def test_every_contact_is_told_as_fine_samples_see_it(run, fine):
    table = run.impacts("joint")
    assert table.sizes["contact"] == int(run.stats.n_onsets[0]) > 8
    t, force = np.asarray(fine.ts), np.asarray(fine.reaction("joint"))
    depth, work = np.asarray(fine.penetration("joint")), np.asarray(fine.absorbed_work("joint"))
    for one in range(table.sizes["contact"]):
        row = table.isel(contact=one)
        own = (t >= float(row.onset)) & (t <= float(row.release))
        # All that touches lies between onset and release.
        near = (t > float(row.onset) - 1e-5) & (t < float(row.release) + 1e-5)
        assert np.abs(t[near & (depth > 0)][[0, -1]] - t[own][[0, -1]]).max() < 2e-7
        assert float(row.peak_force) == pytest.approx(np.linalg.norm(force[own], axis=1).max(), rel=3e-5)
        assert float(row.peak_penetration) == pytest.approx(depth[own].max(), rel=3e-5)
        np.testing.assert_allclose(row.impulse, np.trapezoid(force[own], t[own], axis=0), atol=1e-6)
        assert float(row.energy_lost) == pytest.approx(work[own][-1] - work[own][0], rel=1e-5)
    assert list(table.onset.values) == sorted(table.onset.values)
    assert table.peak_force.attrs["units"] == "N"
    assert table.attrs["joint"] == "joint"
    frame = table.drop_dims("axis").to_dataframe()
    assert len(frame) == table.sizes["contact"]


def test_the_energy_of_a_ball_goes_into_its_impacts(run):
    table = run.impacts("joint")
    kinetic = np.asarray(run.kinetic_energy)
    # In flight a ball without weight keeps its energy.
    assert float(table.energy_lost.sum()) == pytest.approx(kinetic[0] - kinetic[-1], rel=1e-6)
    assert float(table.energy_lost.min()) > 0


def test_an_elastic_impact_is_that_of_hertz():
    """m v^2/2 = K delta^2.5/2.5, F = K delta^1.5, impulse 2 m v, duration 2.943 delta/v; nothing is lost."""
    stiffness, mass, speed = 1e10, 0.2, 0.5
    run = bounced(sj.Dry(clearance=1e-4, normal=sj.Hertz(stiffness=stiffness)))
    table = run.impacts("joint")
    depth = (2.5 * mass * speed**2 / 2 / stiffness) ** 0.4
    assert table.sizes["contact"] > 5
    first = table.isel(contact=0)
    assert float(first.onset) == pytest.approx(1e-4 / speed, rel=1e-9)
    np.testing.assert_allclose(first.place, (0.0, 0.6, 0.8), atol=1e-9)
    for one in range(table.sizes["contact"] - 1):
        row = table.isel(contact=one)
        assert float(row.approach_speed) == pytest.approx(speed, rel=1e-7)
        assert float(row.peak_penetration) == pytest.approx(depth, rel=2e-8)
        assert float(row.peak_force) == pytest.approx(stiffness * depth**1.5, rel=2e-8)
        assert float(np.linalg.norm(row.impulse)) == pytest.approx(2 * mass * speed, rel=1e-7)
        assert float(row.release - row.onset) == pytest.approx(2.9432 * depth / speed, rel=1e-4)
        assert abs(float(row.energy_lost)) < 1e-6 * mass * speed**2


def test_peaks_are_those_of_fine_samples(run, fine):
    found = run.peak("reaction.joint")
    force = np.linalg.norm(fine.reaction("joint"), axis=1)
    assert found.value == pytest.approx(force.max(), rel=3e-5)
    assert found.time == pytest.approx(float(fine.ts[force.argmax()]), abs=2e-7)
    # The samples of the run itself see none of it.
    assert np.linalg.norm(run.reaction("joint"), axis=1).max() < 0.5 * found.value
    assert run.peak("acceleration.ball").value == pytest.approx(found.value / 0.2, rel=1e-5)
    assert run.peak("kinetic_energy").value == pytest.approx(float(run.kinetic_energy[0]), rel=1e-12)
    with pytest.raises(sj.SceneError, match=r"reaction\.NAME"):
        run.peak("reaction.jiont")


@pytest.mark.parametrize(
    "model", [sj.Ideal(), pytest.param(sj.Lubricated(clearance=1e-4, viscosity=0.4), marks=pytest.mark.slow)]
)
def test_peaks_of_a_smooth_motion_and_of_a_stiff_method(model):
    scene = sj.gallery.four_bar(model)
    coarse = sj.simulate(scene, [0.0, 0.2], rtol=1e-8)
    fine = sj.simulate(scene, np.linspace(0.0, 0.2, 4001), rtol=1e-8)
    for name, values in (
        ("acceleration.rocker", fine.acceleration("rocker")),
        ("reaction.coupler_rocker", fine.reaction("coupler_rocker")),
    ):
        assert coarse.peak(name).value == pytest.approx(np.linalg.norm(values, axis=1).max(), rel=2e-4)


def test_contacts_at_the_start_and_at_the_end():
    """A ball that lies on the wall from the start, pressed: one contact, without a release."""
    scene = cases.ball_in_socket(sj.Dry(clearance=1e-4), 0.2)
    push = sj.AppliedWrench("ball", force=(0.0, 0.0, -50.0))
    scene = sj.Scene(
        scene.bodies, scene.joints, {"push": push}, gravity=(0.0, 0.0, 0.0), ground_points=scene.ground_points
    )
    first = sj.simulate(scene, np.linspace(0.0, 0.05, 3), rtol=1e-8)
    table = first.impacts("joint")
    assert np.isnan(table.release[-1])
    assert np.isfinite(table.release[:-1]).all()
    assert float(table.onset[0]) > 0
    assert first.impacts("joint") is not table
    before = sj.simulate(scene, [0.0, 1e-4], rtol=1e-8).impacts("joint")
    assert before.sizes["contact"] == 0
    assert before.impulse.shape == (0, 3)


def test_more_steps_than_expected_are_found_all_the_same(run):
    few = steps_of(run.system, run.settings, run.ts, run.ys, 1, float(run.t_reached), run.scalar)
    assert len(few.ends) == int(run.stats.n_accepted) > 256
    assert few.ends[-1] == 0.01
    np.testing.assert_allclose(few.at_ends[-1], run.ys[-1], atol=1e-9)
    assert few.inside.shape == (len(few.ends), len(SHARES))
    assert np.all(np.diff(np.column_stack([few.inside, few.ends]).ravel()) > 0)


def test_a_run_that_ended_early_is_told_as_far_as_it_came():
    scene = cases.ball_in_socket(sj.Dry(clearance=1e-4), 0.2, (0.0, 0.3, 0.4))
    with pytest.warns(sj.SimulationWarning):
        run = sj.simulate(scene, COARSE, rtol=1e-9, max_steps=100)
    table = run.impacts("joint")
    assert 1 <= table.sizes["contact"] < 8
    assert float(table.onset.max()) < float(run.t_reached) < 0.01


def test_a_repeated_run_that_parts_is_said(run):
    other = eqx.tree_at(lambda r: r.ys, run, run.ys.at[1, 2].add(1e-5))
    with pytest.warns(PartingWarning, match=r"from t = 0\.004 s on"):
        other.impacts("joint")


def test_lanes_are_asked_one_by_one():
    def simulated(clearance):
        scene = cases.ball_in_socket(sj.Dry(clearance=clearance), 0.2, (0.0, 0.3, 0.4))
        return sj.simulate(scene, COARSE, rtol=1e-9)

    runs = jax.vmap(simulated)(jnp.array([1e-4, 2e-4]))
    with pytest.raises(sj.SceneError, match="one lane"):
        runs.impacts("joint")
    lane = jax.tree.map(lambda x: x[1], runs)
    assert lane.impacts("joint").sizes["contact"] == int(lane.stats.n_onsets[0])
    with pytest.raises(sj.SceneError, match="one lane"):
        jax.eval_shape(lambda c: simulated(c).impacts("joint").onset.values, 1e-4)


def test_what_cannot_be_repeated_says_so():
    scene = cases.ball_in_socket(sj.Dry(clearance=1e-4), 0.2)
    control = diffrax.PIDController(rtol=1e-8, atol=1e-10)
    run = sj.simulate(scene, [0.0, 1e-5], rtol=1e-6, stepsize_controller=control)
    with pytest.raises(sj.SceneError, match="stepsize_controller"):
        run.impacts("joint")


@pytest.mark.slow
def test_impacts_by_an_implicit_method():
    scene = cases.ball_in_socket(sj.Dry(clearance=1e-4), 0.2, velocity=(0.1, 0.02, 0.0))
    ts = jnp.array([0.0, 2e-3, 4e-3])
    own, theirs = (sj.simulate(scene, ts, solver=solver).impacts("joint") for solver in (None, diffrax.Kvaerno5()))
    assert own.sizes["contact"] == theirs.sizes["contact"] > 0
    np.testing.assert_allclose(theirs["onset"], own["onset"], rtol=1e-6)
    np.testing.assert_allclose(theirs["peak_force"], own["peak_force"], rtol=2e-4)  # its states inside steps are cubic


def test_joints_without_contact_and_runs_of_an_instant():
    run = sj.simulate(sj.gallery.four_bar(sj.Ideal()), [0.0, 0.01])
    with pytest.raises(sj.SceneError, match="has no contact"):
        run.impacts("coupler_rocker")
    with pytest.raises(sj.SceneError, match="one instant"):
        sj.simulate(sj.gallery.four_bar(sj.Ideal()), [0.0]).peak("kinetic_energy")


def test_a_polynomial_that_meets_a_kink_is_not_believed():
    nodes = np.array([NODES])
    ends, spans = np.array([0.0, 1.0]), (np.zeros(1), np.ones(1))
    smooth = np.sin(np.pi * (0.3 + 0.4 * nodes))  # a good part of an impact in one step
    value, time = peak_of(ends, np.zeros(2), *spans, smooth)
    assert value == pytest.approx(1.0, rel=1e-8)  # of cos(0.4 pi s / 2) by degree 7
    assert time == pytest.approx(0.5, abs=1e-7)
    kink = np.array([[0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]])
    assert peak_of(ends, np.zeros(2), *spans, kink)[0] == 1.0
    assert peak_of(ends, np.array([0.0, 2.0]), *spans, smooth) == (2.0, 1.0)


def test_a_peak_at_the_start_is_not_before_it():
    """By rounding it was at -1e-20 s: the instant comes from those inside the first step."""
    lengths = np.linspace(1e-3, 1.0, 50)
    falling = [
        peak_of(np.array([0.0, x]), np.zeros(2), [x * 1e-17 - 1e-19], [x], 10 - np.array([NODES])) for x in lengths
    ]
    assert all(time >= 0.0 for _, time in falling)
    np.testing.assert_allclose([time for _, time in falling], 0.0, atol=1e-12)

"""Drift control: what each keeps of the constraints, of the energy and of the motion, and that nothing else changes."""

import re
from functools import lru_cache

import cases
import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax import cli
from spherejax.model.system import flatten_system
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import constraint_set, velocity_violation
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.equations.projection import corrected
from spherejax.motion.start.assembly import as_ideal, assemble_now
from spherejax.physics.bodies import inertia_in_world
from spherejax.physics.state import unpack

CONTROLS = {
    "none": sj.solvers.NoDriftControl(),
    "baumgarte": sj.solvers.Baumgarte(),
    "post_stabilization": sj.solvers.PostStabilization(),
    "projection": sj.solvers.Projection(),
}
CORRECTING = ("post_stabilization", "projection")
ENERGY = 0.05  # exchanged between weight and motion of the four-bar [J]
ROUNDING = 1e-14


@lru_cache
def program(control: str, model: str = "ideal"):
    """Runs of the four-bar by duration, tolerance and the factor of gravity, compiled once."""

    @jax.jit
    def run(t_end, rtol, weight):
        scene = sj.gallery.four_bar(cases.FOUR_BAR_MODELS[model], drift=CONTROLS[control])
        scene = eqx.tree_at(lambda s: s.gravity, scene, scene.gravity * weight)
        return sj.simulate(scene, t_end * jnp.linspace(0.0, 1.0, 41), rtol=rtol, atol=1e-3 * rtol)

    return run


def four_bar(control, model="ideal", t_end=2.0, rtol=1e-8, weight=1.0):
    return program(control, model)(t_end, rtol, weight).require_success()


def norm_error(run):
    return float(np.abs((np.asarray(run.state.quaternion) ** 2).sum(-1) - 1).max())


# What is kept -------------------------------------------------------------------------------------------------------

POSITION_BOUND = {"none": 1e-8, "baumgarte": 2e-9, "post_stabilization": ROUNDING, "projection": ROUNDING}
VELOCITY_BOUND = {"none": 2e-8, "baumgarte": 2e-8, "post_stabilization": ROUNDING, "projection": ROUNDING}


@pytest.mark.parametrize(
    ("control", "model", "t_end"),
    [
        *((control, "ideal", 2.0) for control in CONTROLS),
        *(pytest.param(c, "bushing", 0.1, marks=pytest.mark.slow) for c in CONTROLS),
    ],
)
def test_constraints_are_kept(control, model, t_end):
    run = four_bar(control, model, t_end)
    assert np.asarray(run.constraint_violation).max() < POSITION_BOUND[control]
    assert np.asarray(run.velocity_violation).max() < VELOCITY_BOUND[control]
    assert norm_error(run) < (ROUNDING if control in CORRECTING else 5e-9)


@pytest.mark.parametrize("control", CONTROLS)
def test_energy_is_kept(control):
    energy = np.asarray(four_bar(control).mechanical_energy)
    assert np.abs(energy - energy[0]).max() < 1e-7 * ENERGY


def test_without_control_violations_grow_and_with_control_they_do_not():
    def largest(control, t_end):
        run = four_bar(control, t_end=t_end)
        return np.asarray(run.constraint_violation).max(), np.asarray(run.velocity_violation).max()

    none_short, none_long = largest("none", 2.0), largest("none", 40.0)
    assert none_long[0] > 30 * none_short[0]  # with the square of time
    baumgarte_short, baumgarte_long = largest("baumgarte", 2.0), largest("baumgarte", 40.0)
    assert baumgarte_long[0] < 3 * baumgarte_short[0]
    assert none_long[0] > 20 * baumgarte_long[0]
    for control in CORRECTING:
        assert max(largest(control, 40.0)) < ROUNDING


def test_projection_iterates_where_one_correction_does_not_reach_rounding():
    once, thrice = (four_bar(control, rtol=1e-3) for control in CORRECTING)
    assert np.asarray(thrice.constraint_violation).max() < ROUNDING
    assert np.asarray(thrice.velocity_violation).max() < ROUNDING
    assert ROUNDING < np.asarray(once.constraint_violation).max() < 1e-8
    assert np.asarray(once.velocity_violation).max() < 1e-6


@pytest.mark.parametrize(("rtol", "limit"), [(1e-8, 1e-9), (1e-11, 1e-11)])
def test_all_controls_give_one_motion(rtol, limit):
    heights = [np.asarray(four_bar(control, rtol=rtol).position("rocker"))[:, 2] for control in CONTROLS]
    assert np.ptp(heights[0]) > 0.005
    assert np.ptp(heights, axis=0).max() < limit


# The correction itself ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def displaced():
    """A state of the four-bar with bristles and work, off the constraints by about a micrometer and 1 m/s."""
    scene = sj.gallery.four_bar(sj.Dry(cases.C, friction=sj.LuGre()), drift=sj.solvers.Projection())
    system = sj.equations.compile_scene(scene, track_work=True).system
    y = cases.displaced_state(system, assemble_now(*flatten_system(as_ideal(system))), 3, 1e-6)
    y[system.layout.work_start :] = 0.123
    y[3:7] *= 1.001
    return system, y


def violations(system, y):
    motions = body_motions(system, unpack(system.layout, jnp.asarray(y)))
    constraints = constraint_set(system, 0.0, motions)
    return np.asarray(constraints.residual), np.asarray(velocity_violation(constraints, motions))


def test_correction_closes_positions_and_velocities_and_leaves_memory_and_work(displaced):
    system, y = displaced
    before = violations(system, y)
    once = np.asarray(corrected(system, 0.0, jnp.asarray(y)))
    twice = np.asarray(corrected(system, 0.0, jnp.asarray(once)))
    assert min(np.abs(v).max() for v in before) > 1e-6
    assert np.abs(violations(system, once)[0]).max() < 1e-8
    assert max(np.abs(v).max() for v in violations(system, twice)) < ROUNDING
    assert np.abs(y[system.layout.memory_start :]).min() > 0
    np.testing.assert_array_equal(twice[system.layout.memory_start :], y[system.layout.memory_start :])
    quaternions = unpack(system.layout, twice).quaternion
    assert np.abs((np.asarray(quaternions) ** 2).sum(-1) - 1).max() < ROUNDING


def test_correction_is_the_least_in_the_metric_of_the_masses(displaced):
    # The oracle: the velocity of least distance, by the pseudo-inverse of D M^(-1/2).
    system, y = displaced
    there = np.asarray(corrected(system, 0.0, jnp.asarray(y)))
    v = system.layout.n_velocity
    start = system.layout.n_position
    y = np.concatenate([there[:start], y[start:]])  # on the position constraints, with the velocities given

    def rates(velocities):
        return violations(system, np.concatenate([y[:start], velocities, y[start + v :]]))[1]

    jacobian = np.stack([rates(column) for column in np.eye(v)], 1)
    motions = body_motions(system, unpack(system.layout, jnp.asarray(y)))
    root = np.zeros((v, v))
    for i, (name, body) in enumerate(system.bodies.items()):
        values, vectors = np.linalg.eigh(np.asarray(inertia_in_world(body.inertia, motions[name].rotation)))
        root[6 * i : 6 * i + 3, 6 * i : 6 * i + 3] = np.sqrt(body.mass) * np.eye(3)
        root[6 * i + 3 : 6 * i + 6, 6 * i + 3 : 6 * i + 6] = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    given = y[start : start + v]
    inverse = np.linalg.inv(root)
    least = given - inverse @ np.linalg.pinv(jacobian @ inverse) @ jacobian @ given
    found = np.asarray(corrected(system, 0.0, jnp.asarray(y)))[start : start + v]
    np.testing.assert_allclose(found, least, rtol=0, atol=1e-9)
    assert np.abs(found - given).max() > 0.1


def test_without_feedback_the_program_has_no_terms_of_it():
    def operations(control):
        structure, _ = flatten_system(sj.equations.compile_scene(sj.gallery.four_bar(drift=CONTROLS[control])).system)
        return program_for(state_rate, structure).scalar.n_operations_inside

    assert operations("none") == operations("projection") == operations("post_stabilization")
    assert operations("none") < operations("baumgarte") - 100


# Other scenes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("control", CONTROLS)
def test_a_free_body_keeps_its_angular_momentum_and_unit_quaternion(control):
    body = sj.Body(1.0, (1e-3, 2e-3, 3e-3), angular_velocity=(0.1, 5.0, 0.1))  # about the unstable axis
    scene = sj.Scene({"top": body}, gravity=(0.0, 0.0, 0.0), drift=CONTROLS[control])
    run = sj.simulate(scene, cases.times(10.0, 21), rtol=1e-10, atol=1e-12).require_success()
    q, w = (np.asarray(value("top")) for value in (run.quaternion, run.angular_velocity))
    from scipy.spatial.transform import Rotation

    matrices = Rotation.from_quat(q, scalar_first=True).as_matrix()
    momenta = np.einsum("nij,j,nkj,nk->ni", matrices, np.array([1e-3, 2e-3, 3e-3]), matrices, w)
    assert matrices[:, 1, 1].min() < -0.5  # it tumbles
    assert np.abs(momenta - momenta[0]).max() < 1e-8 * np.abs(momenta).max()
    assert norm_error(run) < (ROUNDING if control in CORRECTING else 1e-8)


def door(n_hinges: int, drift) -> sj.Scene:
    """A body on one or several hinges along one axis: each hinge after the first is redundant."""
    body = sj.Body(0.5, (1e-3, 2e-3, 1.5e-3), position=(0.1, 0.0, 0.0))
    hinges = {
        f"hinge_{i}": sj.Revolute(("ground", "bob"), (0.0, 0.05 * i, 0.0), (0.0, 1.0, 0.0)) for i in range(n_hinges)
    }
    return sj.Scene({"bob": body}, hinges, drift=drift)


def test_redundant_constraints_do_no_harm_to_the_correction():
    # The two hinges ask for the same five equations: the correction is that of one hinge.
    found = []
    for n_hinges in (1, 2):
        system = sj.equations.compile_scene(door(n_hinges, sj.solvers.Projection())).system
        y = cases.displaced_state(system, assemble_now(*flatten_system(as_ideal(system))), 3, 1e-6)
        for _ in range(2):
            y = np.asarray(corrected(system, 0.0, jnp.asarray(y)))
        assert max(np.abs(v).max() for v in violations(system, y)) < ROUNDING
        found.append(y)
    np.testing.assert_allclose(found[1][7:], found[0][7:], rtol=0, atol=1e-8)
    assert np.abs(found[0][7:]).max() > 0.1


@pytest.mark.slow
def test_projection_goes_with_contacts():
    runs = [four_bar(control, "friction", t_end=0.1, rtol=1e-9) for control in ("baumgarte", "projection")]
    assert int(runs[0].stats.n_onsets[0]) == int(runs[1].stats.n_onsets[0]) > 3
    assert np.asarray(runs[1].constraint_violation).max() < ROUNDING
    heights = [np.asarray(run.position("rocker"))[:, 2] for run in runs]
    np.testing.assert_allclose(*heights, rtol=0, atol=1e-10)


def test_projection_goes_with_a_stiff_method():
    scene = door(1, sj.solvers.Projection())
    stiff = sj.simulate(scene, cases.times(0.5, 6), rtol=1e-8, solver=sj.solvers.Rodas5P()).require_success()
    explicit = sj.simulate(scene, cases.times(0.5, 6), rtol=1e-10).require_success()
    assert np.asarray(stiff.constraint_violation).max() < ROUNDING
    np.testing.assert_allclose(stiff.position("bob"), explicit.position("bob"), rtol=0, atol=1e-7)


# Transformations ----------------------------------------------------------------------------------------------------


def height_of_the_door(weight, control, **options):
    scene = door(1, CONTROLS[control])
    scene = eqx.tree_at(lambda s: s.gravity, scene, scene.gravity * weight)
    return sj.simulate(scene, cases.times(0.5, 2), rtol=1e-10, atol=1e-13, **options).position("bob")[-1, 2]


@lru_cache
def slope_of_the_door(control):
    """In forward mode."""
    return float(jax.jit(jax.jacfwd(lambda weight: height_of_the_door(weight, control)))(1.0))


@pytest.mark.parametrize(
    "control", [pytest.param(c, marks=[pytest.mark.slow] * (c == "post_stabilization")) for c in CORRECTING]
)
def test_derivative_agrees_with_differences(control):
    height = jax.jit(lambda weight: height_of_the_door(weight, control))
    h = 1e-4
    difference = (8 * (height(1 + h) - height(1 - h)) - (height(1 + 2 * h) - height(1 - 2 * h))) / (12 * h)
    assert abs(slope_of_the_door(control)) > 1e-3
    assert slope_of_the_door(control) == pytest.approx(float(difference), rel=1e-6)


@pytest.mark.slow
def test_reverse_mode_by_checkpoints_passes_through_the_projection():
    options = {"adjoint": diffrax.RecursiveCheckpointAdjoint(), "max_steps": 200}
    reverse = jax.jit(jax.grad(lambda weight: height_of_the_door(weight, "projection", **options)))(1.0)
    assert float(reverse) == pytest.approx(slope_of_the_door("projection"), rel=1e-9)


@pytest.mark.slow
def test_lanes_equal_single_runs():
    weights = jnp.array([0.5, 1.0, 2.0])
    run = program("projection")
    # The first steps are short, and their errors those of rounding, which is another one in vectors: the steps that
    # follow differ, and the motion by what the tolerance allows.
    lanes = jax.jit(jax.vmap(lambda weight: run(0.5, 1e-11, weight).ys))(weights)
    for lane, weight in zip(lanes, weights, strict=True):
        np.testing.assert_allclose(lane, run(0.5, 1e-11, weight).ys, rtol=1e-10, atol=1e-9)
    assert np.ptp(np.asarray(lanes)[:, -1], axis=0).max() > 0.01


# Requests -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wrong", ["projection", sj.solvers.Projection, 5.0])
def test_what_is_no_drift_control_is_named(wrong):
    with pytest.raises(sj.SceneError, match=r"drift = .*no drift control; give .*Projection\(\)"):
        sj.simulate(sj.gallery.four_bar(drift=wrong), cases.times(0.1))


def test_command_line_takes_each_control(capsys):
    from spherejax.command_line.catalog import DRIFT_CONTROLS

    assert set(DRIFT_CONTROLS.values()) == {type(control) for control in CONTROLS.values()}
    words = ["run", "four-bar", "--t1", "0.2", "--samples", "5", "--rtol", "1e-6", "--drift"]
    found = {}
    for name in ("none", "projection"):
        assert cli.main([*words, name]) == 0
        found[name] = float(re.search(r"largest constraint violation\W+([\d.e+-]+)", capsys.readouterr().out)[1])
    assert found["projection"] < ROUNDING < found["none"]
    assert cli.main([*words, "glue"]) == 2
    assert "post-stabilization" in capsys.readouterr().err

"""Hard cases of mechanisms: redundant constraints, singular configurations, masses far apart, spin, long motion, lanes.

See `test_hard_cases` for the rules and for a ball in its socket.
"""

import cases
import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.compiler.linear_algebra.symmetric import symmetric_solve

ALONG_Y = (0.0, 1.0, 0.0)


def _rod(start, end, mass):
    """A uniform rod between two points of the xz plane, its x axis along it."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    d = end - start
    length, half = np.linalg.norm(d), np.arctan2(-d[2], d[0]) / 2
    across = mass * length**2 / 12
    return sj.Body(
        mass,
        (across / 100, across, across),
        position=(start + end) / 2,
        quaternion=(np.cos(half), 0.0, np.sin(half), 0.0),
    )


def planar_loop(pins, masses=(1.0, 1.0, 1.0), speed=0.0):
    """Four revolutes in a plane: 20 equations for 18 velocities and one degree of freedom, so three are redundant.

    Args:
        pins: the four pins; the first and the last stand on the ground.
        masses: of crank, coupler and rocker [kg].
        speed: the coupler's horizontal speed before the start is made consistent [m/s].
    """
    a, b, c, d = pins
    bodies = {"crank": _rod(a, b, masses[0]), "coupler": _rod(b, c, masses[1]), "rocker": _rod(c, d, masses[2])}
    coupler = eqx.tree_at(lambda body: body.velocity, bodies["coupler"], np.array([speed, 0.0, 0.0]))
    joints = {
        "a": sj.Revolute(("ground", "crank"), a, ALONG_Y),
        "b": sj.Revolute(("crank", "coupler"), b, ALONG_Y),
        "c": sj.Revolute(("coupler", "rocker"), c, ALONG_Y),
        "d": sj.Revolute(("ground", "rocker"), d, ALONG_Y),
    }
    return sj.Scene({**bodies, "coupler": coupler}, joints)


UNEQUAL = ((0, 0, 0), (0, 0, 0.2), (0.5, 0, 0.45), (0.6, 0, 0))
PARALLEL = ((0, 0, 0), (0.1, 0, 0.3), (0.6, 0, 0.3), (0.5, 0, 0))


def assert_conserves(run, relative):
    energy = np.asarray(run.mechanical_energy)
    assert np.isfinite(np.asarray(run.ys)).all()
    assert np.abs(energy - energy[0]).max() < relative * np.ptp(np.asarray(run.kinetic_energy))


# Redundant constraints ----------------------------------------------------------------------------------------------


def test_dependent_equations_are_left_out():
    # Rank 4 in 6: the solution solves all equations, by array code and as a scalar program.
    random = np.random.default_rng(1)
    D = random.standard_normal((6, 4))
    S, x = D @ D.T, random.standard_normal(6)
    b = S @ x
    for solve in (
        symmetric_solve,
        sj.compiler.scalarize(symmetric_solve, *(jax.ShapeDtypeStruct(v.shape, jnp.float64) for v in (S, b))),
    ):
        found = np.asarray(solve(jnp.asarray(S), jnp.asarray(b)))
        assert S @ found == pytest.approx(b, rel=1e-10)
        assert np.sum(found == 0) == 2
    assert not np.isfinite(symmetric_solve(jnp.asarray(S).at[2, 2].set(jnp.nan), jnp.asarray(b))).all()


def test_derivative_of_a_redundant_solution():
    # Along a path of rank 4: by the force D^T x that the multipliers make, which is unique.
    random = np.random.default_rng(2)
    D, E, g = random.standard_normal((6, 4)), random.standard_normal((4, 4)), random.standard_normal(4)

    def force(s):
        rows = D @ (jnp.eye(4) + s * E)
        return rows.T @ symmetric_solve(rows @ rows.T, rows @ g)

    h = 1e-5
    slope = jax.jvp(force, (0.0,), (1.0,))[1]
    assert np.asarray(force(0.0)) == pytest.approx(g, rel=1e-9)
    assert np.asarray(slope) == pytest.approx(np.asarray((force(h) - force(-h)) / (2 * h)), abs=1e-5)


@pytest.mark.parametrize("scalar", [True, False])
def test_planar_loop_has_redundant_constraints(scalar):
    # Three of the twenty pivots are rounding; divided by, they would be noise, or NaN.
    run = sj.simulate(planar_loop(UNEQUAL), cases.times(1.0 if scalar else 0.1, 5), rtol=1e-8, scalar=scalar)
    run.require_success()
    assert int(run.stats.n_steps) < 200
    assert_conserves(run, 1e-5)
    assert np.asarray(run.constraint_violation).max() < 1e-7


def test_parallel_loop_passes_its_singular_configuration():
    # Swings through the position in which all rods lie on one line. There the constraints lose one more rank, and the
    # loop may go on as another mechanism; whichever it takes, it keeps its energy and its pins.
    run = sj.simulate(planar_loop(PARALLEL), cases.times(0.5, 41), rtol=1e-8, max_steps=200_000).require_success()
    heights = np.asarray(run.position("crank"))[:, 2]
    assert heights[0] > 0.1
    assert np.ptp(heights) > 0.1
    assert_conserves(run, 1e-4)
    assert np.asarray(run.constraint_violation).max() < 1e-7


# Masses far apart ---------------------------------------------------------------------------------------------------


def _four_bar(crank, coupler):
    """The four-bar with other masses of crank and coupler [kg], their inertias in proportion."""
    return eqx.tree_at(
        lambda s: (
            s.bodies["crank"].mass,
            s.bodies["crank"].inertia,
            s.bodies["coupler"].mass,
            s.bodies["coupler"].inertia,
        ),
        sj.gallery.four_bar(),
        (crank, crank * jnp.full(3, 1e-4), coupler, coupler * jnp.array([0.01, 1e-4, 0.01])),
    )


def _end_of_four_bar(crank, rtol=1e-8):
    run = sj.simulate(_four_bar(crank, 1e3), cases.times(0.3, 11), rtol=rtol, atol=rtol / 1000, max_steps=20_000)
    return run.position("rocker")[-1], (run.status, run.stats.n_steps, run.mechanical_energy, run.kinetic_energy)


def test_bodies_of_1_mg_beside_1_t():
    # The forces on the light crank cancel to one part in 1e9: the noise of that must not set the steps.
    end = jax.jit(_end_of_four_bar)
    light, (status, n_steps, energy, kinetic) = end(1e-6)
    assert status == sj.Status.SUCCEEDED
    assert int(n_steps) < 500
    assert float(jnp.max(jnp.abs(energy - energy[0]))) < 1e-6 * float(jnp.ptp(kinetic))
    # Massless in effect: a crank a thousand times as heavy moves as well.
    heavier, _ = end(1e-3)
    assert np.asarray(light) == pytest.approx(np.asarray(heavier), abs=1e-6)


@pytest.mark.slow
def test_gradient_by_a_vanishing_mass():
    # What the crank's first kilogram does, beside the coupler's 1000 kg, is linear in it.
    slope = jax.jit(jax.jacfwd(lambda m: _end_of_four_bar(m, 1e-9)[0]))
    end = jax.jit(lambda m: _end_of_four_bar(m, 1e-11)[0])
    difference = np.asarray(end(1.0) - end(1e-4))
    size = np.abs(difference).max()
    assert np.asarray(slope(1e-4)) == pytest.approx(difference, abs=1e-3 * size)
    # The derivative of 1 / m is 1e12 here: of 16 digits the cancellation leaves one. That noise also sets the steps of
    # the sensitivities: below an rtol of 1e-10 none is short enough.
    assert np.asarray(slope(1e-6)) == pytest.approx(difference, abs=0.3 * size)


def test_dust_on_a_bushing_of_a_heavy_body():
    # 1e-6 kg beside 1e3 kg: the pair swings as a harmonic oscillator of the lighter mass.
    point = {"points": {"p": (0.0, 0.0, 0.0)}}
    bodies = {
        "block": sj.Body(1e3, (10.0,) * 3, **point),
        "dust": sj.Body(1e-6, (1e-12,) * 3, position=(1e-3, 0.0, 0.0), **point),
    }
    joint = sj.Spherical("block.p", "dust.p", sj.Bushing(1e3, 0.0), starts_concentric=False)
    ts = np.linspace(0.0, 1e-3, 11)
    run = sj.simulate(sj.Scene(bodies, {"j": joint}, gravity=(0.0, 0.0, 0.0)), jnp.asarray(ts), max_steps=10_000)
    run.require_success()
    expected = 1e-3 * np.cos(np.sqrt(1e3 / 1e-6) * ts)
    assert np.asarray(run.position("dust"))[:, 0] == pytest.approx(expected, abs=1e-6 * 1e-3 * int(run.stats.n_steps))


# Spin and long motion -----------------------------------------------------------------------------------------------


def _spun(inertia, t_end=0.05):
    body = sj.Body(1.0, inertia, angular_velocity=(1e4, 1.0, 1.0))
    run = sj.simulate(sj.Scene({"body": body}, gravity=(0.0, 0.0, 0.0)), cases.times(t_end), max_steps=50_000)
    return run.angular_velocity("body")[-1], run.quaternion("body")[-1], run.status


def test_free_spin_of_1e4_per_second():
    # 80 turns about the axis of least inertia. The step errors of the quaternion, one rtol each, are pulled back to
    # unit norm; energy and momentum hold to the steps' errors: 1000 steps of 1e-8.
    inertia = jnp.array([1e-3, 2e-3, 3e-3])
    w, q, status = jax.jit(_spun)(inertia)
    assert status == sj.Status.SUCCEEDED
    assert float(jnp.linalg.norm(q)) == pytest.approx(1.0, abs=1e-5)
    rotation = np.asarray(jnp.stack([_axis(q, i) for i in range(3)], 1))
    in_body = rotation.T @ np.asarray(w)
    assert 0.5 * np.asarray(inertia) @ in_body**2 == pytest.approx(0.5 * (1e-3 * 1e8 + 5e-3), rel=1e-5)
    momentum = rotation @ (np.asarray(inertia) * in_body)
    assert momentum == pytest.approx([10.0, 2e-3, 3e-3], abs=1e-4)
    slope = jax.jit(jax.jacfwd(lambda i: _spun(i)[0]))(inertia)
    assert np.isfinite(np.asarray(slope)).all()


def _axis(q, i):
    from spherejax.foundations.rotation import rotation_matrix

    return rotation_matrix(q / jnp.linalg.norm(q))[:, i]


@pytest.mark.slow
def test_1000_seconds_of_a_pendulum():
    # 1600 swings; Baumgarte's feedback works on rounding only, and energy drifts by at most rtol a step.
    run = sj.simulate(cases.pendulum(), cases.times(1000.0, 101), rtol=1e-9, atol=1e-11, max_steps=500_000)
    run.require_success()
    assert_conserves(run, 1e-9 * int(run.stats.n_accepted))
    assert np.asarray(run.constraint_violation).max() < 1e-7


def test_gradient_of_100_seconds_of_a_pendulum():
    # By gravity, the phase: it grows with time, and stays that of finite differences.
    def end(gravity):
        scene = eqx.tree_at(lambda s: s.gravity, cases.pendulum(), gravity * jnp.array([0.0, 0.0, -1.0]))
        return sj.simulate(scene, cases.times(100.0), rtol=1e-10, atol=1e-13, max_steps=100_000).position("bob")[-1]

    value, h = jax.jit(end), 1e-5
    slope = np.asarray(jax.jit(jax.jacfwd(end))(9.81))
    assert slope == pytest.approx(
        np.asarray(value(9.81 + h) - value(9.81 - h)) / (2 * h), abs=1e-3 * np.abs(slope).max()
    )


# Lanes and requests -------------------------------------------------------------------------------------------------


def test_one_lane_fails_and_the_others_do_not_feel_it():
    # A bushing too stiff for the explicit method that is asked for: that lane runs out of steps.
    @jax.jit
    @jax.vmap
    def lanes(stiffness):
        scene = cases.ball_in_socket(sj.Bushing(stiffness, 1.0), 0.2, (0.1, 0.0, 0.0))
        run = sj.simulate(scene, cases.times(0.01, 3), solver=diffrax.Dopri8(), max_steps=20_000)
        return run.position("ball"), run.status, run.t_reached

    found, status, reached = map(np.asarray, lanes(jnp.array([1e4, 1e10, 1e5])))
    assert list(map(sj.Status, status.tolist())) == [
        sj.Status.SUCCEEDED,
        sj.Status.TOO_MANY_STEPS,
        sj.Status.SUCCEEDED,
    ]
    assert np.isfinite(found[[0, 2]]).all()
    assert np.isfinite(found[1, 0]).all()
    assert np.isnan(found[1, -1]).all()
    assert 0 < reached[1] < 0.01
    good, _, _ = map(np.asarray, lanes(jnp.array([1e4, 1e3, 1e5])))
    assert np.array_equal(found[[0, 2]], good[[0, 2]])


def test_a_single_sample_is_the_start():
    run = sj.simulate(cases.pendulum(), jnp.zeros(1)).require_success()
    assert run.ys.shape[0] == 1
    assert np.asarray(run.position("bob"))[0] == pytest.approx([0.1, 0.0, 0.0])


def test_value_and_gradient_in_one_program():
    # XLA once aborted the process here: a scatter of the traced numbers was fused with that of their tangents.
    def loss(x):
        scene = cases.ball_in_socket(sj.Bushing(1e4 * x[0], 1e-3 * x[1]), 0.2, (0.1, 0.0, 0.2))
        return jnp.sum(sj.simulate(scene, cases.times(0.01, 3)).position("ball") ** 2)

    value, slope = jax.jit(jax.value_and_grad(loss))(jnp.ones(2))
    assert float(value) == pytest.approx(float(loss(jnp.ones(2))), rel=1e-9)
    assert np.isfinite(np.asarray(slope)).all()
    assert np.abs(np.asarray(slope)).min() > 0

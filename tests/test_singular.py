"""Singular configurations: mechanisms pass through them at any tolerance, and equations come and go."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spherejax as sj
from spherejax.compiler.linear_algebra.symmetric import REDUNDANT_PIVOT, SINGULAR_PIVOT, symmetric_solve
from spherejax.model.system import compile_scene
from spherejax.motion.start.redundancy import singular_passes

G = 9.81


def turning_angle(ts, n_loops, speed=1.0):
    """Angle of the standing rods from upright: the equation in the docstring of `n_four_bar`, for rods of 1 m."""
    k = ((n_loops + 1) / 2 + n_loops) / ((n_loops + 1) / 3 + n_loops) * G
    whole = solve_ivp(
        lambda _, y: [y[1], k * np.sin(y[0])], (0, ts[-1]), [0, speed], "DOP853", ts, rtol=1e-13, atol=1e-13
    )
    return whole.y[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "drift", [sj.solvers.PostStabilization(), pytest.param(sj.solvers.Projection(), marks=pytest.mark.slow)]
)
def test_n_four_bar_passes_its_singular_configurations(drift):
    ts = np.linspace(0.0, 3.0, 31)
    theta = turning_angle(ts, 2)
    assert theta[-1] > 2 * np.pi  # all rods lay on one line three times

    @jax.jit
    def run(rtol):
        return sj.simulate(sj.gallery.n_four_bar(2, drift=drift), jnp.asarray(ts), rtol=rtol, max_steps=20_000)

    for rtol, error in ((1e-6, 1e-4), (1e-8, 3e-6), (1e-9, 3e-7), (1e-10, 1e-7), (1e-11, 1e-7)):
        motion = run(rtol).require_success()
        energy = np.asarray(motion.mechanical_energy)
        assert np.asarray(motion.position("rod_00"))[:, 0] == pytest.approx(0.5 * np.sin(theta), abs=error), rtol
        assert energy == pytest.approx(np.full(31, energy[0]), abs=5 * error), rtol


def test_equations_are_left_out_from_the_asked_bound_on():
    # The third row is the sum of the others but for d: its pivot is about d^2.
    rows = jnp.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 1e-4]])
    S, b = rows @ rows.T, rows @ jnp.array([0.3, -0.2, 0.5])

    def solution(bound):
        return symmetric_solve(S, b, bound)

    exact = np.linalg.solve(np.asarray(S), np.asarray(b))
    assert np.asarray(solution(REDUNDANT_PIVOT)) == pytest.approx(exact, rel=1e-6)
    for bound in (REDUNDANT_PIVOT, SINGULAR_PIVOT):
        left_out = np.isclose(np.asarray(solution(bound)), 0).any()
        assert left_out == (bound == SINGULAR_PIVOT)
        program = sj.compiler.scalarize(lambda S, b, at=bound: symmetric_solve(S, b, at), S, b)
        # Programs order the rows themselves: what S x gives back is the same, which row is left out is not.
        assert np.asarray(S @ program(S, b)) == pytest.approx(np.asarray(S @ solution(bound)), abs=1e-4)
        tangent = jax.jacfwd(lambda b, at=bound: symmetric_solve(S, b, at))(b)
        assert np.isfinite(tangent).all()


def test_the_bound_is_that_of_rounding_where_masses_or_moments_differ():
    def bound(mass, inertia):
        bodies = {"a": sj.Body(1.0, (1.0, 1.0, 1.0)), "b": sj.Body(mass, inertia, position=(1.0, 0.0, 0.0))}
        return compile_scene(sj.Scene(bodies)).system.smallest_pivot

    assert bound(0.01, (1e-3, 1e-3, 1e-3)) == SINGULAR_PIVOT
    assert bound(0.01, 1e-3 * np.eye(3)) == SINGULAR_PIVOT
    assert bound(1e-6, (1e-3, 1e-3, 1e-3)) == REDUNDANT_PIVOT
    assert bound(0.01, (1e-5, 1e-3, 1e-3)) == REDUNDANT_PIVOT
    assert jax.jit(lambda m: jnp.asarray(bound(m, (1e-3, 1e-3, 1e-3))))(0.01) == REDUNDANT_PIVOT


def states_of_parallelograms(system, n_loops, angles):
    """Flat states of `n_four_bar` with rods of 1 m for angles from upright, at rest."""
    ys = []
    for angle in angles:
        tilt, across = np.array([np.sin(angle), np.cos(angle), 0.0]), np.array([1.0, 0.0, 0.0])
        turned = [np.cos(angle / 2), 0.0, 0.0, -np.sin(angle / 2)]
        at = {f"rod_{i:02d}": [*(i * across + tilt / 2), *turned] for i in range(n_loops + 1)}
        at |= {f"bar_{i:02d}": [*((i - 0.5) * across + tilt), 1.0, 0.0, 0.0, 0.0] for i in range(1, n_loops + 1)}
        ys.append(np.concatenate([*(at[name] for name in system.bodies), np.zeros(6 * len(at))]))
    return np.array(ys)


@pytest.mark.parametrize("n_loops", [1, 2])
def test_passes_of_singular_configurations_are_seen_between_samples(n_loops):
    """All rods lie on one line at a quarter and at three quarters of a turn; `n_loops` values go through zero at once.

    The planar loops have redundant equations all along, which are no pass.
    """
    system = compile_scene(sj.gallery.n_four_bar(n_loops)).system
    ts = np.linspace(0.0, 1.0, 24)
    passes = singular_passes(system, ts, states_of_parallelograms(system, n_loops, 2 * np.pi * ts))
    assert not passes.unclear
    assert [each.after < t < each.before for each, t in zip(passes.found, (0.25, 0.75), strict=True)] == [True, True]
    assert all(set(each.joints) == set(system.joints) for each in passes.found)
    assert "Between 0.217391 s and 0.26087 s a singular configuration was passed" in str(passes)


def test_samples_in_a_singular_configuration_and_far_apart():
    system = compile_scene(sj.gallery.n_four_bar(1)).system
    at = states_of_parallelograms(system, 1, np.array([1.4, np.pi / 2, 1.8, 2.0, 4.0]))
    inside = singular_passes(system, np.arange(4.0), at[:4])
    assert [(each.after, each.before) for each in inside.found] == [(0.0, 2.0)]
    assert not singular_passes(system, np.arange(2.0), at[2:4]).found
    assert singular_passes(system, np.arange(2.0), at[3:]).unclear == ((0.0, 1.0),)


def test_passes_of_a_traced_run_are_refused_in_words():
    def n_passes(mass):
        body = sj.Body(mass, (1e-2, 1e-2, 1e-2), position=(0.0, 0.0, -0.3))
        hinge = sj.Revolute(("ground", "arm"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        return len(sj.simulate(sj.Scene({"arm": body}, {"hinge": hinge}), np.array([0.0, 0.1])).singular_passes.found)

    assert n_passes(1.0) == 0
    with pytest.raises(sj.SceneError, match="known numbers; return the run from jit"):
        jax.make_jaxpr(n_passes)(1.0)


@pytest.mark.slow
def test_a_run_says_which_singular_configurations_it_has_passed():
    ts = np.linspace(0.0, 2.0, 41)
    run = sj.simulate(sj.gallery.n_four_bar(1), ts).require_success()
    theta = turning_angle(ts, 1)
    wanted = np.flatnonzero(np.diff(np.floor(theta / np.pi + 0.5)))
    assert len(wanted) > 1
    assert [each.after for each in run.singular_passes.found] == list(ts[wanted])

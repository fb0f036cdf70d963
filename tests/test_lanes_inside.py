"""States inside an explicit step, from its stages; and the flags that the lanes' speed rests on."""

from dataclasses import replace
from functools import partial
from importlib.metadata import version

import diffrax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.compiler import hooks
from spherejax.motion.integration.lanes.inside import extension, trees_of
from spherejax.motion.integration.lanes.stages import ExplicitStages


def stages_of(solver):
    """Coefficients and weights of the stages that the end of a step needs."""
    steps = ExplicitStages(solver.tableau, lambda t, y, _: y, with_dense_output=False)
    n = steps.n_stages
    return steps.coefficients[:n, :n], steps.weights[:n], steps.inside


def test_the_number_of_rooted_trees():
    assert [len(trees_of(n)) for n in range(1, 8)] == [1, 1, 2, 4, 9, 20, 48]


@pytest.mark.parametrize(("solver", "order"), [(diffrax.Dopri8(), 5), (diffrax.Tsit5(), 4), (diffrax.Dopri5(), 4)])
def test_states_inside_a_step_have_the_order_that_the_stages_allow(solver, order):
    a, b, inside = stages_of(solver)
    assert inside.shape == (len(b), order + 1)
    assert np.allclose(inside.sum(axis=1), b, atol=1e-13)
    powers = np.arange(1, order + 2)

    def error(h, x=0.4):
        """Of y' = y^2, y(0) = 1, at the fraction x of a step h."""
        k = np.zeros(len(b))
        for i in range(len(b)):
            k[i] = h * (1 + a[i] @ k) ** 2
        return abs(1 + (inside @ x**powers) @ k - 1 / (1 - x * h))

    slope = np.log2(error(0.08) / error(0.04))
    assert slope == pytest.approx(order + 1, abs=0.5)


def test_a_method_of_order_one_has_a_straight_line_inside():
    assert extension(np.zeros((1, 1)), np.ones(1)).tolist() == [[1.0, 0.0]]


@pytest.mark.parametrize(
    ("joint", "solver"),
    [(sj.Ideal(), diffrax.Dopri8()), pytest.param(sj.Dry(1e-4), diffrax.Tsit5(), marks=pytest.mark.slow)],
)
def test_the_first_step_is_the_same_by_looks_and_by_diffrax(joint, solver):
    """Runs that begin together look with their own stages; those of a queue are given what diffrax finds."""

    def build(scale):
        scene = sj.gallery.four_bar(joint)
        return replace(scene, gravity=scale * jnp.asarray(scene.gravity))

    ts, scales = jnp.array([0.0, 0.1]), jnp.array([1.0, 2.0, 0.5])
    first = [
        sj.simulate_many(
            build, scales, ts, solver=solver, max_steps=1, block=sj.solvers.Block(width, width)
        ).trajectories
        for width in (1, 3)
    ]
    for runs in first:
        assert np.all(runs.stats.n_steps == 1)
        assert np.all(runs.t_reached > 0)
    np.testing.assert_allclose(first[1].t_reached, first[0].t_reached, rtol=1e-6)


def test_looks_are_not_counted_and_leave_no_trace():
    build = partial(sj.gallery.four_bar, sj.Dry(1e-4))
    ts = jnp.array([0.0, 0.02, 0.04])
    alone = sj.simulate(build(), ts)
    queued = sj.simulate_many(lambda _: build(), jnp.zeros(3), ts, block=sj.solvers.Block(2, 2)).trajectories
    for name in ("n_accepted", "n_rejected", "n_onsets"):
        assert np.array_equal(np.asarray(getattr(queued.stats, name))[1], getattr(alone.stats, name)), name
    # The energy that is lost is rounding here: 5e-9 of what is allowed.
    np.testing.assert_allclose(np.asarray(queued.stats.audit)[1], alone.stats.audit, rtol=0.2, atol=1e-8)
    np.testing.assert_allclose(queued.ys[2], alone.ys, rtol=1e-6, atol=1e-6)


def test_a_run_of_one_instant_and_a_run_that_may_not_be_made():
    at_once = sj.simulate(sj.gallery.four_bar(), jnp.array([0.5]))
    assert at_once.succeeded
    assert np.all(np.isfinite(at_once.ys))

    def build(mass):
        return sj.Scene({"ball": sj.Body(mass, (1.0, 1.0, 1.0))}, {})

    runs = sj.simulate_many(build, jnp.array([1.0, -1.0]), jnp.array([0.0, 0.1])).trajectories
    assert list(np.asarray(runs.status)) == [sj.Status.SUCCEEDED, sj.Status.BAD_VALUE]
    assert np.all(np.asarray(runs.stats.audit)[1] <= 0)


def test_flags_of_the_user_are_kept():
    assert "--xla_cpu_prefer_vector_width=512" in hooks.with_xla_flags("")
    assert "vector_width=512" not in hooks.with_xla_flags("--xla_cpu_prefer_vector_width=256")
    mine = "--xla_backend_extra_options=my_option"
    assert hooks.with_xla_flags(mine).startswith(mine + ",xla_cpu_small_while_loop_byte_threshold=")
    assert hooks.with_xla_flags(hooks.with_xla_flags(mine)) == hooks.with_xla_flags(mine)
    # XLA ends the process over a flag that it does not know.
    known = (0, 10) <= tuple(map(int, version("jaxlib").split(".")[:2])) <= (0, 12)
    assert ("ynn_fusion_type=" in hooks.with_xla_flags(mine)) == known
    assert hooks.with_xla_flags("--xla_cpu_experimental_ynn_fusion_type=reduce").count("ynn") == 1


def test_a_block_of_which_few_may_run_looks_before_it_narrows():
    def build(mass):
        return sj.Scene({"ball": sj.Body(mass, (1.0, 1.0, 1.0))}, {})

    masses = jnp.concatenate([jnp.ones(3), -jnp.ones(21)])
    runs = sj.simulate_many(build, masses, jnp.array([0.0, 0.1, 0.2])).trajectories
    alone = sj.simulate(build(1.0), jnp.array([0.0, 0.1, 0.2]))
    assert np.array_equal(np.asarray(runs.status) == sj.Status.SUCCEEDED, masses > 0)
    assert np.array_equal(runs.stats.n_steps[:3], np.full(3, alone.stats.n_steps))
    np.testing.assert_allclose(runs.ys[0], alone.ys, atol=1e-12)


def test_the_audit_begins_with_the_start_and_not_with_a_look():
    """What is looked at at the ends of looks is no motion: driven joints gape there."""
    bodies, axis = ("ground", "rod"), (0.0, 1.0, 0.0)
    motor = sj.RotationDriver(bodies, axis, angle=sj.functions.Linear(slope=1.0))
    joints = {"hinge": sj.Revolute(bodies, (0.0, 0.0, 0.0), axis), "motor": motor}
    motion = {"velocity": (0.0, 0.0, -0.3), "angular_velocity": (0.0, 1.0, 0.0)}
    rod = sj.Body(1.0, (1e-2, 1e-2, 1e-3), position=(0.3, 0.0, 0.0), **motion)
    scene = sj.Scene({"rod": rod}, joints)
    run = sj.simulate(scene, jnp.array([0.0, 0.1]))
    assert run.succeeded
    assert np.max(np.asarray(run.stats.audit)) < 1e-3


JOINTS = {"dry": sj.Dry(1e-4, friction=sj.Threlfall()), "stiff": sj.Bushing(1e6, 1e-2)}


@pytest.mark.parametrize("joint", [*JOINTS])
def test_how_often_a_run_is_sampled_says_nothing_of_its_steps(joint):
    """One run writes its samples between stretches of steps, many lanes in each of them: none, one or many a step."""
    scene = sj.gallery.four_bar(JOINTS[joint])
    ts = jnp.linspace(0.0, 0.02, 4001)
    often, seldom = (sj.simulate(scene, ts[::every], rtol=1e-6) for every in (1, 500))
    lanes = sj.simulate_many(
        lambda _: scene, jnp.zeros(3), ts[::500], rtol=1e-6, block=sj.solvers.Block(2)
    ).trajectories
    assert often.stats.n_steps < 2000  # of its 4,000 samples more than one lie in a step
    for name in ("n_accepted", "n_rejected", "n_onsets"):
        assert np.array_equal(getattr(often.stats, name), getattr(seldom.stats, name)), name
    assert np.all(np.isfinite(often.ys))
    np.testing.assert_allclose(often.ys[::500], seldom.ys, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(lanes.ys[1], seldom.ys, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(("width", "narrow"), [(1, None), (2, None), (3, 1), (24, None)])
def test_jobs_that_may_not_be_made_are_written_down_wherever_they_wait(width, narrow):
    """Also at the end of the queue, where nobody is busy any more: such a row said that it had succeeded."""

    def build(mass):
        return sj.Scene({"ball": sj.Body(mass, (1.0, 1.0, 1.0))}, {})

    masses = jnp.concatenate([jnp.array([1.0, -1.0, -1.0, -1.0, -1.0, 2.0, 1.0]), -jnp.ones(2 * width)])
    runs = sj.simulate_many(
        build, masses, jnp.array([0.0, 0.1, 0.2]), block=sj.solvers.Block(width, narrow)
    ).trajectories
    expected = np.where(masses > 0, sj.Status.SUCCEEDED, sj.Status.BAD_VALUE)
    assert np.array_equal(runs.status, expected)
    assert np.array_equal(np.isfinite(np.asarray(runs.ys)[:, -1]).all(axis=-1), masses > 0)

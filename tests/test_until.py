"""Runs that end where a condition is met: the instant is a root, with the derivative of the implicit function."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_between import ENDS, GAP, SPEED, STIFFNESS, ball, depth
from test_continuation import MASS, block

import spherejax as sj

pytestmark = [
    pytest.mark.filterwarnings("ignore::spherejax.errors.OutOfRangeWarning"),  # 0.5 m/s press beyond Eq. 24's range
    pytest.mark.filterwarnings("ignore::spherejax.errors.SerialRunsWarning"),
]

RATE, LEVEL = np.sqrt(8.0 / MASS), 0.3
TS = np.linspace(0.0, 1.0, 6)


def passes(speed, level):
    """When a mass on a spring, x = v / w sin(w t), passes a level first."""
    return np.arcsin(level * RATE / speed) / RATE


def test_a_trace_keeps_the_number_of_samples():
    """Beside the slow tests of values: the whole way through a trace, without compiling it."""

    def end(speed):
        run = sj.simulate(block(speed=speed), TS, until=sj.When("position.block.x", LEVEL))
        return run.ts, run.position("block"), run.stopped_by

    ts, places, which = jax.eval_shape(jax.vmap(end), jnp.array([1.0, 2.0]))
    assert (ts.shape, places.shape, which.shape) == ((2, 6), (2, 6, 3), (2,))


@pytest.mark.slow
def test_a_run_ends_where_a_quantity_passes_a_level():
    scene = block()
    run = sj.simulate(scene, TS, rtol=1e-10, until=sj.When("position.block.x", LEVEL, rising=True))
    t = passes(1.0, LEVEL)
    np.testing.assert_allclose(run.ts, [0.0, 0.2, t], atol=2e-8)
    assert abs(float(run.position("block")[-1, 0]) - LEVEL) < 1e-15
    assert (run.status, int(run.stopped_by), float(run.end.t)) == (sj.Status.SUCCEEDED, 0, float(run.ts[-1]))


@pytest.mark.slow
def test_the_first_of_several_conditions_ends_a_run():
    """Downwards; one that is never met does not count."""
    scene = block()
    never, back = sj.When("position.block.x", 0.6), sj.When("velocity.block.x", 0.0, rising=False)
    run = sj.simulate(scene, TS, rtol=1e-10, until=[never, back])
    assert int(run.stopped_by) == 1
    np.testing.assert_allclose(run.ts[-1], np.pi / 2 / RATE, atol=2e-8)
    whole = sj.simulate(scene, TS, until=never)
    assert (int(whole.stopped_by), len(whole.ts)) == (-1, len(TS))


@pytest.mark.slow
def test_a_run_may_end_within_an_impact():
    """By energy: v^2 = v0^2 - 0.8 K d^2.5 / m at the depth d, here half of the largest one."""
    half = depth(SPEED) / 2
    run = sj.simulate(ball(), ENDS, rtol=1e-10, until=sj.When("penetration.joint", half, rising=True))
    speed = np.sqrt(SPEED**2 - 0.8 * STIFFNESS * half**2.5 / 0.2)
    np.testing.assert_allclose(run.velocity("ball")[-1, 2], speed, rtol=1e-6)
    np.testing.assert_allclose(run.position("ball")[-1, 2], GAP + half, rtol=1e-12)


@pytest.mark.slow
def test_the_instant_has_derivatives_in_a_trace():
    def end(speed, level):
        run = sj.simulate(block(speed=speed), TS, rtol=1e-10, until=sj.When("position.block.x", level))
        return run.t_reached, (run.ts, run.position("block")[:, 0], run.stopped_by)

    t = passes(1.0, LEVEL)
    slope = 1 / np.sqrt(1 - (LEVEL * RATE) ** 2)  # by the level; by the speed it is -level / speed of that
    (_, (ts, places, which)), slopes = jax.jit(jax.value_and_grad(end, (0, 1), has_aux=True))(1.0, LEVEL)
    np.testing.assert_allclose(ts, [0.0, 0.2, t, t, t, t], atol=2e-8)
    np.testing.assert_allclose(places[2:], LEVEL, atol=1e-14)
    assert int(which) == 0
    np.testing.assert_allclose(slopes, [-LEVEL * slope, slope], rtol=1e-6)
    _, (ts, places, which) = jax.vmap(end, (0, None))(jnp.array([1.0, 2.0]), 0.55)
    np.testing.assert_array_equal(which, [-1, 0])
    np.testing.assert_allclose(ts[0], TS)
    np.testing.assert_allclose(ts[1, -1], passes(2.0, 0.55), atol=2e-8)


def test_what_is_no_condition_is_answered_in_words():
    for until, words in (
        ("position.block.x > 1", r"is no condition; give sj\.When"),
        ([], "is no condition"),
        (sj.When("position.block"), r"is a vector; name one of its components, such as 'position\.block\.x'"),
        (sj.When("position.blok.x"), "position.NAME"),
    ):
        with pytest.raises(sj.SceneError, match=words):
            sj.simulate(block(), TS, until=until)
    for arguments, words in (
        ((3.0,), "is no name of a quantity"),
        (("position.block.x", "0.1"), "level"),
        (("position.block.x", 0.1, "up"), "rising"),
    ):
        with pytest.raises(sj.SceneError, match=words):
            sj.When(*arguments)

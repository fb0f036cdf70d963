"""Peaks within `jit`, `vmap` and `grad`, with derivatives, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_between import ENDS, STIFFNESS, ball, depth, instants
from test_continuation import block, block_at

import spherejax as sj

pytestmark = [
    pytest.mark.filterwarnings("ignore::spherejax.errors.OutOfRangeWarning"),  # 0.5 m/s press beyond Eq. 24's range
    pytest.mark.filterwarnings(
        "ignore::spherejax.errors.SerialRunsWarning"
    ),  # peaks of many runs are looked for one by one
]


def hardest(speed):
    """The largest force of a ball that strikes its socket once, and when; two samples see nothing of it."""
    return sj.simulate(ball(speed), ENDS, rtol=1e-9).peak("reaction.joint", steps=512)


@pytest.mark.slow
def test_the_peak_of_an_impact_and_its_derivative():
    """K delta^1.5 with delta = (5 m v^2 / 4 K)^0.4: proportional to v^1.2."""
    speeds = jnp.array([0.4, 0.5])
    (values, times), slopes = jax.jit(jax.vmap(jax.value_and_grad(hardest, has_aux=True)))(speeds)
    forces = STIFFNESS * depth(np.array([0.4, 0.5])) ** 1.5
    np.testing.assert_allclose(values, forces, rtol=1e-8)
    np.testing.assert_allclose(slopes, 1.2 * forces / speeds, rtol=2e-6)
    np.testing.assert_allclose(times, [instants(0.4)[1], instants(0.5)[1]], rtol=1e-6)
    alone = hardest(0.5)
    assert alone.value == pytest.approx(float(values[1]), rel=5e-9)
    assert alone.time == pytest.approx(float(times[1]), rel=1e-7)  # of a maximum, less is determined than of its value


@pytest.mark.slow
def test_a_run_with_more_steps_than_are_kept_raises():
    def fastest(speed, steps):
        return sj.simulate(block(speed=speed), np.array([0.0, 0.3])).peak("velocity.block", steps=steps).value

    with pytest.raises(Exception, match=r"the run has more than 2 steps.*give more: run\.peak\('velocity\.block'"):
        jax.jit(fastest, static_argnums=1)(1.0, 2)


@pytest.mark.slow
def test_peaks_at_the_ends_of_a_run_have_the_derivative_there():
    """A mass on a spring is fastest at its start; its way is longest at the end of less than a quarter of a period."""
    ends = np.array([0.0, 0.3])

    def peaks(speed):
        run = sj.simulate(block(speed=speed), ends, rtol=1e-10)
        return run.peak("velocity.block").value, run.peak("position.block.x").value

    values, slopes = jax.jit(lambda v: (peaks(v), jax.jacfwd(peaks)(v)))(2.0)
    way = block_at(0.3, 0.0, 1.0, 8.0, 0.0)[0]
    np.testing.assert_allclose(values, [2.0, 2 * way], rtol=1e-8)
    np.testing.assert_allclose(slopes, [1.0, way], rtol=1e-7)


@pytest.mark.parametrize(("steps", "words"), [(0, "must be a whole number"), (10.0, "must be a whole number")])
def test_a_number_of_steps_that_is_none_is_answered_in_words(steps, words):
    def value(speed):
        return sj.simulate(block(speed=speed), np.array([0.0, 0.3])).peak("velocity.block", steps=steps).value

    with pytest.raises(sj.SceneError, match=words):
        jax.eval_shape(value, 1.0)

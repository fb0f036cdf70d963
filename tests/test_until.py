"""Runs that end where a condition is met: the instant is a root, with the derivative of the implicit function."""

import diffrax
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
        ((3.0,), "is no name of a quantity and no function"),
        (("position.block.x", "0.1"), "level"),
        (("position.block.x", 0.1, "up"), "rising"),
    ):
        with pytest.raises(sj.SceneError, match=words):
            sj.When(*arguments)


# Conditions that are functions ---------------------------------------------------------------------------------------

EQUATIONS = sj.ode(block()).f


def place(y):
    return EQUATIONS.unpack(y).bodies["block"].position[0]


def met(speed, offset, names=()):
    """A run up to where a function that closes over an array passes zero, or one of some quantities its level."""
    shift = jnp.stack([jnp.asarray(offset), jnp.asarray(1.0)])
    own = sj.When(lambda t, y, args: place(y) - shift[0], rising=True)
    return sj.simulate(block(speed=speed), TS, rtol=1e-10, until=[*names, own])


def test_a_function_that_is_no_condition_is_answered_in_words():
    for what, words in (
        (lambda t, y, args: y[:3], r"<lambda> is called with.*\(t, y, args\).*arrays of the shapes \(3,\)"),
        (lambda t, y, args: (y[0], y[1]), r"shapes \(\), \(\)"),
        (lambda t, y, args: None, "shapes nothing"),
        (lambda t, y, args: y[0] < 0.1, r"type bool; return the difference"),
        (lambda t, y: y[0], r"It raised TypeError: .*positional argument"),
        (lambda t, y, args: 1.0 if y[0] > 0 else 0.0, "It raised TracerBoolConversionError"),
    ):
        with pytest.raises(sj.SceneError, match=words):
            sj.simulate(block(), TS, until=sj.When(what))


def test_a_function_in_a_trace_keeps_the_number_of_samples():
    run = jax.eval_shape(jax.vmap(met), jnp.array([1.0, 2.0]), jnp.array([0.1, 0.3]))
    assert (run.ts.shape, run.stopped_by.shape) == ((2, 6), (2,))


@pytest.mark.slow
def test_a_run_ends_where_a_function_passes_zero():
    run = met(1.0, LEVEL)
    np.testing.assert_allclose(run.ts, [0.0, 0.2, passes(1.0, LEVEL)], atol=2e-8)
    assert abs(float(run.position("block")[-1, 0]) - LEVEL) < 1e-15
    # Of the time, of what is observed, and of numbers of the scene, beside names, in the order of the conditions.
    kinetic = sj.When(lambda t, y, args: EQUATIONS.observe(t, y, args).kinetic_energy / args.bodies["block"].mass, 0.1)
    late = sj.When(lambda t, y, args: t - 0.9)
    names = [sj.When("position.block.x", 0.6), kinetic, sj.When("velocity.block.x", 0.1), late]
    run = met(1.0, 0.7, names)
    assert int(run.stopped_by) == 1
    np.testing.assert_allclose(run.velocity("block")[-1, 0], np.sqrt(0.2), rtol=1e-9)
    run = met(1.0, 0.7, [names[0], late])
    assert (int(run.stopped_by), float(run.ts[-1])) == (1, pytest.approx(0.9, abs=1e-15))


@pytest.mark.slow
def test_the_instant_has_derivatives_by_what_a_function_closes_over():
    t, slope = passes(1.0, LEVEL), 1 / np.sqrt(1 - (LEVEL * RATE) ** 2)
    value_and_slopes = jax.value_and_grad(lambda *numbers: met(*numbers).t_reached, (0, 1))
    for derived in (jax.jit(value_and_slopes), value_and_slopes):
        value, slopes = derived(1.0, LEVEL)
        np.testing.assert_allclose(value, t, atol=2e-8)
        np.testing.assert_allclose(slopes, [-LEVEL * slope, slope], rtol=1e-6)
    ends = jax.jit(jax.vmap(lambda *numbers: met(*numbers).t_reached))(jnp.array([1.0, 2.0]), jnp.array([0.3, 0.2]))
    np.testing.assert_allclose(ends, [passes(1.0, 0.3), passes(2.0, 0.2)], atol=2e-8)


# diffrax.SaveAt ------------------------------------------------------------------------------------------------------


def test_samples_by_a_saveat_of_diffrax():
    scene, span = block(), [0.0, 1.0]
    times = np.array([0.25, 0.5])
    for saveat, ts in (
        (diffrax.SaveAt(ts=times), [0.0, 0.25, 0.5, 1.0]),
        (diffrax.SaveAt(t0=True, ts=jnp.array([0.0, 0.5]), t1=True), [0.0, 0.5, 1.0]),
        (diffrax.SaveAt(t1=True, dense=True), span),
        (diffrax.SaveAt(dense=True), span),
    ):
        run = sj.simulate(scene, span, saveat=saveat)
        np.testing.assert_allclose(run.ts, ts)
        np.testing.assert_array_equal(run.ys, sj.simulate(scene, ts).ys)

    def ends(t):
        return sj.simulate(scene, span, saveat=diffrax.SaveAt(ts=jnp.array([0.7, t]))).ts

    np.testing.assert_allclose(jax.eval_shape(ends, 0.3).shape, (4,))


def test_what_a_saveat_cannot_ask_for_is_answered_in_words():
    subs = [diffrax.SubSaveAt(t0=True), diffrax.SubSaveAt(t1=True)]
    for saveat, words in (
        (diffrax.SaveAt(steps=True), r"steps=1 has no counterpart.*run\.at\(t\)"),
        (diffrax.SaveAt(t1=True, fn=lambda t, y, args: y[0]), r"fn= has no counterpart.*jax\.vmap\(fn"),
        (diffrax.SaveAt(subs=subs), "subs= of 2 kinds"),
        (diffrax.SaveAt(t1=True, solver_state=True), r"solver_state=True has no counterpart.*continue_from"),
        (diffrax.SaveAt(ts=[0.5, 1.5]), r"t = 1\.5 s is outside of the run"),
        (TS, r"is no diffrax\.SaveAt; give the sample times themselves as ts"),
    ):
        with pytest.raises(sj.SceneError, match=words):
            sj.simulate(block(), [0.0, 1.0], saveat=saveat)

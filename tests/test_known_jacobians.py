"""First derivatives outside of `jax.jit`: computed with the run, right under each transformation, and no others taken.

Against the closed form of `test_nested_derivatives`, a body on a spring and a damper.
"""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_nested_derivatives import ALONG, AT, ONE, exact, place

import spherejax as sj
from spherejax.motion.derivatives import known_jacobians, sensitivities
from spherejax.motion.runs import preparation

SLOPES = jax.grad(exact)


def linearized(f):
    _, linear = jax.linearize(f, AT)
    return jax.vmap(linear)(jnp.eye(3)) + 0.0 * jax.jit(linear)(ALONG)


TRANSFORMATIONS = {
    "grad": lambda f: jax.grad(f)(AT),
    "value and grad": lambda f: jax.value_and_grad(f)(AT)[1],
    "jacfwd": lambda f: jax.jacfwd(f)(AT),
    "jacrev": lambda f: jax.jacrev(lambda p: jnp.stack([f(p), f(p)]))(AT)[1],
    "linearize": linearized,
    "vmap of vjp": lambda f: jax.vmap(jax.vjp(f, AT)[1])(jnp.ones(2))[0][1],
    "grad by the tangent": lambda f: jax.grad(lambda along: jax.jvp(f, (AT,), (along,))[1])(ONE),
    "grad beside jvp": lambda f: jax.grad(lambda p: jax.jvp(lambda x: x * f(p), (2.0,), (1.0,))[1])(AT),
    "grad beside vmap": lambda f: jax.grad(lambda p: jnp.sum(jax.vmap(lambda x: x * f(p))(jnp.ones(2))))(AT) / 2,
}


@pytest.mark.parametrize("transformation", TRANSFORMATIONS)
def test_derivatives_computed_with_the_run_are_right(transformation, monkeypatch):
    def rule(*_, **__):
        raise AssertionError("the rule of jax.custom_jvp is traced")

    monkeypatch.setattr(sensitivities, "_run_and_jacobians", rule)
    derivatives = TRANSFORMATIONS[transformation]
    np.testing.assert_allclose(derivatives(place), derivatives(exact), rtol=1e-6)


def test_a_directional_derivative_is_right():
    value, slope = jax.jvp(place, (AT,), (ALONG,))
    np.testing.assert_allclose(value, place(AT), rtol=1e-8)
    np.testing.assert_allclose(slope, SLOPES(AT) @ ALONG, rtol=1e-6)


def test_a_number_of_another_precision_has_a_derivative():
    def end(mass):
        return place((AT[0], mass, AT[2]))

    slope = jax.grad(end)(jnp.asarray(AT[1], jnp.float32))
    assert slope.dtype == jnp.float32
    np.testing.assert_allclose(slope, SLOPES(AT)[1], rtol=1e-5)
    np.testing.assert_allclose(jax.grad(end)(float(AT[1])), SLOPES(AT)[1], rtol=1e-6)


def test_numbers_behind_two_transformations_are_not_taken_for_known():
    seen = []

    def looked_at(x):
        seen.append(known_jacobians.primal_alone(x))
        return x

    jax.grad(looked_at)(2.0)
    jax.grad(lambda x: jax.grad(lambda y: looked_at(x * y))(1.0))(2.0)
    jax.jvp(jax.grad(looked_at), (2.0,), (1.0,))
    jax.vmap(jax.grad(looked_at))(jnp.ones(2))
    jax.grad(lambda x: jnp.sum(jax.vmap(lambda y: looked_at(x * y))(jnp.ones(2))))(2.0)
    jax.jit(jax.grad(looked_at))(2.0)
    looked_at(2.0)
    assert seen == [2.0, *[None] * (len(seen) - 1)]
    assert len(seen) == 7


def test_numbers_of_two_transformations_are_not_taken_for_those_of_one():
    seen = []

    def looked_at(mass, speed):
        body = sj.Body(mass, (1e-3,) * 3, velocity=jnp.stack([speed, 0.0, 0.0]))
        seen.append(preparation.prepared(sj.Scene({"body": body}), False, None).values_behind)
        return mass * speed

    jax.grad(looked_at)(2.0, 0.3)
    jax.grad(looked_at, (0, 1))(2.0, 0.3)
    jax.grad(lambda mass: jax.grad(looked_at, 1)(mass, 0.3))(2.0)
    alone, both, apart = seen
    np.testing.assert_array_equal(alone, [2.0])
    np.testing.assert_array_equal(both, [2.0, 0.3, 0.0, 0.0])
    assert apart is None


@pytest.mark.parametrize("mode", [jax.jacrev, jax.jacfwd])
@pytest.mark.parametrize("compiled", [lambda function: function, jax.jit], ids=["outside of jit", "within jit"])
def test_a_run_that_fails_has_no_derivatives(mode, compiled):
    """Neither forward nor in reverse, where a gradient of zero would look like one."""

    def ends(speed):
        body = sj.Body(1.0, (1e-3,) * 3, position=(0.5, 0.0, 0.0), velocity=(speed, 0.0, 0.0))
        spring = sj.SpringDamper(("ground.o", "body"), stiffness=100.0, free_length=0.2)
        scene = sj.Scene({"body": body}, forces={"spring": spring}, ground_points={"o": (0.0, 0.0, 0.0)})
        run = sj.simulate(scene, np.array([0.0, 1e-3, 2.0]), max_steps=8)
        reached = {"behind": run.ys[2, 0], "time": run.t_reached, "state": run.y_reached[0]}
        return reached, run.ended

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sj.SimulationWarning)
        slopes, ended = compiled(mode(ends, has_aux=True))(0.3)
    assert int(ended) != sj.Status.SUCCEEDED
    assert all(np.isnan(slopes[name]) for name in ("behind", "time", "state"))

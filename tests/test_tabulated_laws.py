"""Laws of a user that look something up: runs on the fast path, and their derivatives, against array code."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj

KNOTS = jnp.array([-0.4, -0.15, -0.04, 0.0, 0.03, 0.2, 0.5])
FORCES = jnp.array([-9.0, -4.0, -1.0, 0.0, 1.5, 3.0, 8.0])
FACTORS = jnp.array([0.4, 1.0, 1.7])


class Tabulated(sj.forces.AbstractForce):
    """A spring by a table, damped by a force that is chosen by the speed."""

    knots: jax.Array
    forces: jax.Array
    factors: jax.Array

    @property
    def body_names(self):
        return ("ball",)

    def wrenches(self, t, motions):
        ball = motions["ball"]
        x, v = ball.position[0], ball.velocity[0]
        inwards, slow, outwards = self.factors
        # Without jumps: over these no derivative of a run is that of differences.
        drag = jnp.select(
            [v < -0.3, v < 0.4], [inwards * (v + 0.3) - 0.3 * slow, slow * v], outwards * (v - 0.4) + 0.4 * slow
        )
        drag = jnp.where(slow > 0.1, drag, 0.0)  # a truth that is evaluated ahead
        force = -jnp.interp(x, self.knots, self.forces) - 0.2 * drag
        return {"ball": sj.forces.Wrench(jnp.stack([force, 0 * force, 0 * force]), jnp.zeros(3))}


def end(numbers, **how):
    ball = sj.Body(1.0, (1, 1, 1), position=(0.45, 0.0, 0.0))
    scene = sj.Scene({"ball": ball}, forces={"law": Tabulated(*numbers)}, gravity=(0, 0, 0))
    return sj.simulate(scene, jnp.linspace(0.0, 1.5, 4), rtol=1e-9, **how).position("ball")[-1, 0]


NUMBERS = KNOTS, FORCES, FACTORS
ALONG = jax.tree.map(lambda x: jnp.asarray(np.random.default_rng(x.size).normal(size=x.shape)), NUMBERS)
MANY = jax.tree.map(lambda x, d: jnp.stack([x + 1e-3 * k * d for k in range(3)]), NUMBERS, ALONG)

WAYS = {
    "value": lambda of: of(NUMBERS),
    "forward": lambda of: jax.jvp(of, (NUMBERS,), (ALONG,))[1],
    "back": lambda of: jax.grad(of)(NUMBERS),
    "of many": lambda of: jax.vmap(of)(MANY),
    "back of many": lambda of: jax.vmap(jax.grad(of))(MANY),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_law_with_a_table_is_on_the_fast_path_and_right(way):
    with warnings.catch_warnings():
        warnings.simplefilter("error", sj.errors.ArrayPathWarning)
        fast = WAYS[way](end)
    slow = WAYS[way](lambda numbers: end(numbers, scalar=False))
    for ours, right in zip(jax.tree.leaves(fast), jax.tree.leaves(slow), strict=True):
        np.testing.assert_allclose(ours, right, rtol=1e-6, atol=1e-8)


def test_its_derivative_is_that_of_finite_differences():
    h = 1e-3
    ends = [end(jax.tree.map(lambda x, d, h=h: x + h * d, NUMBERS, ALONG)) for h in (h, -h)]
    slope = jax.jvp(end, (NUMBERS,), (ALONG,))[1]
    assert float(slope) == pytest.approx(float(ends[0] - ends[1]) / (2 * h), rel=2e-4)


def test_a_gradient_by_many_numbers_of_a_law_that_evaluates_truths_ahead():
    """Back along the steps, which a gradient by more than 32 numbers goes, it failed: a truth has no derivative."""
    n = 40
    knots = jnp.linspace(-0.5, 0.5, n)
    numbers = knots, jnp.sin(3 * knots), FACTORS
    gradient = jax.grad(end)(numbers)
    along = jax.tree.map(lambda x: jnp.cos(jnp.arange(x.size) * 1.0), numbers)
    total = sum(jnp.vdot(g, d) for g, d in zip(gradient, along, strict=True))
    slope = jax.jvp(end, (numbers,), (along,))[1]
    assert float(total) == pytest.approx(float(slope), rel=1e-5)
    assert float(jnp.linalg.norm(gradient[1])) > 0.01

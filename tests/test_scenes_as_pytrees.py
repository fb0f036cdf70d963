"""Scenes are pytrees of arrays: what Equinox does with a network, it does with a scene."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import spherejax as sj
from spherejax.program_cache.keys import value_key

TS = jnp.linspace(0.0, 0.05, 3)
SCENES = {
    "dry four-bar": lambda: sj.gallery.four_bar(sj.Dry(clearance=1e-4, friction=sj.Threlfall(mu=0.1))),
    "film": lambda: sj.gallery.four_bar(sj.Lubricated(clearance=1e-4, viscosity=0.4)),
    "bushing": lambda: sj.gallery.four_bar(sj.Bushing(stiffness=1e6, damping=1e-3)),
    "pendulum": sj.gallery.simple_pendulum,
    "suspension": sj.gallery.suspension,
    "piston": sj.gallery.piston,
    "gears": sj.gallery.rattling_gears,
    "chain": lambda: sj.gallery.chain(3),
}


def hanging(mass=2, stiffness=300, gravity=9.81):
    """A ball on a spring; whole numbers of Python are numbers as well."""
    ball = sj.Body(mass, (1e-2, 1e-2, 1e-2), position=(0.0, 0.0, -0.3), points={"top": (0.0, 0.0, 0.05)})
    spring = sj.SpringDamper(("ground.hook", "ball.top"), stiffness=stiffness, damping=3, free_length=0.2)
    return sj.Scene(
        {"ball": ball}, {}, {"spring": spring}, gravity=(0, 0, -gravity), ground_points={"hook": (0.0, 0.0, 0.0)}
    )


def height(scene):
    return sj.simulate(scene, TS, rtol=1e-10).position("ball")[-1, 2]


@pytest.mark.parametrize("name", SCENES)
def test_every_number_of_a_scene_is_an_array(name):
    leaves = jax.tree.leaves(SCENES[name]())
    assert leaves
    assert [leaf for leaf in leaves if not eqx.is_inexact_array(leaf)] == []
    assert {np.asarray(leaf).dtype for leaf in leaves} == {np.dtype(np.float64)}


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_that_is_taken_apart_and_put_together_is_the_same(name):
    scene = SCENES[name]()
    numbers, rest = eqx.partition(scene, eqx.is_inexact_array)
    key = value_key(scene)
    assert key is not None
    assert value_key(eqx.combine(numbers, rest)) == key
    assert value_key(jax.tree.map(lambda leaf: leaf, scene)) == key
    flat, unravel = ravel_pytree(numbers)
    assert flat.dtype == np.float64
    again = eqx.combine(unravel(flat), rest)
    assert all(map(np.array_equal, jax.tree.leaves(again), jax.tree.leaves(scene)))


def test_a_gradient_by_a_whole_scene_is_that_by_each_of_its_numbers():
    scene = hanging()
    slopes = eqx.filter_grad(height)(scene)
    assert jax.tree.structure(slopes) == jax.tree.structure(scene)
    flat, unravel = ravel_pytree(scene)
    found = ravel_pytree(slopes)[0]
    assert np.isfinite(found).all()
    mass, stiffness = slopes.bodies["ball"].mass, slopes.forces["spring"].stiffness
    assert float(mass) == pytest.approx(float(jax.grad(lambda m: height(hanging(mass=m)))(2.0)), rel=1e-8)
    assert float(stiffness) == pytest.approx(float(jax.grad(lambda k: height(hanging(stiffness=k)))(300.0)), rel=1e-8)
    end = jax.jit(lambda flat: height(unravel(flat)))  # one program, whatever becomes zero
    for i in np.flatnonzero(np.abs(found) > 1e-6 * np.abs(found).max()):
        step = 1e-5 * max(1.0, abs(float(flat[i])))
        up, down = (end(flat.at[i].add(sign * step)) for sign in (1, -1))
        assert float(found[i]) == pytest.approx(float(up - down) / (2 * step), rel=1e-4, abs=1e-9)


def test_a_value_and_its_gradient_at_once():
    value, slopes = eqx.filter_value_and_grad(height)(hanging())
    assert float(value) == pytest.approx(float(height(hanging())), abs=1e-12)
    assert float(slopes.gravity[2]) > 0


def test_another_number_needs_no_other_program():
    traced = []

    @eqx.filter_jit
    def end(scene):
        traced.append(1)
        return height(scene)

    heights = []
    for stiffness in (300.0, 310.0, 320, 330.0):
        heights.append(float(end(hanging(stiffness=stiffness))))
        if stiffness == 310.0:
            n = len(traced)
    assert len(traced) == n <= 2
    assert np.all(np.diff(heights) > 0)
    assert heights[2] == pytest.approx(float(height(hanging(stiffness=320))), abs=1e-10)


def test_scenes_side_by_side():
    scenes = [hanging(mass=mass) for mass in (1, 2.0, 3.0)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)
    heights = eqx.filter_vmap(height)(stacked)
    np.testing.assert_allclose(heights, [float(height(scene)) for scene in scenes], atol=1e-10)
    slopes = eqx.filter_vmap(eqx.filter_grad(height))(stacked)
    alone = eqx.filter_grad(height)(scenes[1])
    np.testing.assert_allclose(slopes.bodies["ball"].mass[1], alone.bodies["ball"].mass, rtol=1e-7)


def test_a_number_is_replaced_by_its_place():
    scene = hanging()
    heavier = eqx.tree_at(lambda scene: scene.bodies["ball"].mass, scene, 3.0)
    assert float(height(heavier)) == pytest.approx(float(height(hanging(mass=3))), abs=1e-12)
    half = jax.tree.map(lambda leaf: leaf, eqx.tree_at(lambda scene: scene.forces["spring"].stiffness, scene, 150.0))
    assert float(height(half)) < float(height(scene))


def test_counts_in_a_users_own_module_stay_counts():
    class Fence(sj.functions.AbstractFunction):
        n: int
        size: float

        def __call__(self, x):
            return self.size * sum(jnp.sin(k * x) for k in range(1, self.n + 1))

        def requirements(self):
            return []

    spring = sj.SpringDamper(("ground.hook", "ball.top"), spring=Fence(3, 0.5), free_length=0.2)
    scene = sj.Scene(hanging().bodies, {}, {"spring": spring}, ground_points={"hook": (0.0, 0.0, 0.0)})
    law = scene.forces["spring"].spring
    assert type(law.n) is int
    assert type(law.size) is np.float64

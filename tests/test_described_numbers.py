"""What each number of a scene and of `theta` is: name, part, unit; and by which of them a run was traced."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.model.numbers import numbers_of
from spherejax.model.system import compile_scene, flatten_system

TIMES = jnp.array([0.0, 1e-3])


def scene_of(name):
    make = getattr(sj.gallery, name)
    return make(3) if name in ("chain", "n_four_bar") else make()


@pytest.mark.parametrize("name", sj.gallery.__all__)
def test_each_number_of_theta_is_known_by_its_name(name):
    system = compile_scene(scene_of(name)).system
    structure, theta = flatten_system(system)
    numbers = numbers_of(structure)
    assert [number.value(system) for number in numbers] == theta.tolist()
    assert len({number.name for number in numbers}) == len(numbers)


@pytest.mark.parametrize("name", sj.gallery.__all__)
def test_each_number_has_a_unit_unless_a_user_wrote_the_part(name):
    """Coefficients of a polynomial, and the factor that a law of impact becomes, have units that no field declares."""
    scene = scene_of(name)
    for whole in (scene, compile_scene(scene).system):
        bare = [each.name for each in sj.equations.numbers(whole) if each.unit is None]
        assert all("gait" in path or ".module." in path or ".coefficients." in path for path in bare), bare


def test_units_are_those_of_the_fields():
    scene = sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.Threlfall(0.1)))
    units = {each.name: each.unit for each in sj.equations.numbers(sj.ode(scene).args)}
    assert units["joints.coupler_rocker.model.clearance"] == "m"
    assert units["joints.coupler_rocker.model.friction.v1"] == "m/s"
    assert units["joints.coupler_rocker.socket_place.y"] == "m"
    assert units["joints.rocker_pivot.axes.0.x"] == "1"
    assert units["bodies.rocker.inertia.z"] == "kg m^2"
    assert units["gravity.z"] == "m/s^2"
    assert units["drift.alpha"] == "1/s"


def test_units_of_drivers_are_those_of_what_they_prescribe():
    parts = {each.name: each for each in sj.equations.numbers(compile_scene(sj.gallery.slider_crank()).system)}
    assert {each.part for each in parts.values()} >= {"bodies.slider", "joints.guide", "gravity"}
    scene = sj.gallery.double_wishbone()
    units = {each.name: each.unit for each in sj.equations.numbers(compile_scene(scene).system)}
    driven = [name for name in units if name.endswith("travel.value")]
    assert driven
    assert {units[name] for name in driven} == {"m"}


def test_a_gradient_stands_beside_the_numbers_that_it_is_by():
    scene = sj.gallery.physical_pendulum()
    f, y0, args = sj.ode(scene)
    slopes = jax.grad(lambda args: jnp.sum(f(0.0, y0, args) ** 2))(args)
    numbers, by = sj.equations.numbers(args), sj.equations.numbers(slopes)
    assert [each.name for each in numbers] == [each.name for each in by]
    at = [each.name for each in numbers].index("gravity.z")
    step = 1e-4
    moved = [
        jnp.sum(f(0.0, y0, eqx.tree_at(lambda a: a.gravity, args, args.gravity.at[2].add(d))) ** 2)
        for d in (step, -step)
    ]
    assert by[at].value == pytest.approx(float(moved[0] - moved[1]) / (2 * step), rel=1e-7)
    # Within a trace the values are the tracers, and names are known all the same.
    named = jax.jit(lambda args: {each.name: each.value for each in sj.equations.numbers(args)})(args)
    assert float(named["gravity.z"]) == -9.81


def test_a_run_says_by_which_numbers_it_was_traced():
    @jax.jit
    def of_two(clearance, mu):
        return sj.simulate(sj.gallery.four_bar(sj.Dry(clearance, friction=sj.Threlfall(mu))), TIMES)

    words = of_two(1e-4, 0.1).stats.explanation
    assert "traced: joints.coupler_rocker.model.clearance, joints.coupler_rocker.model.friction.mu" in words
    known = sj.simulate(sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.Threlfall(0.1))), TIMES)
    assert "traced" not in known.stats.explanation


def test_of_many_traced_numbers_the_parts_are_said():
    scene = sj.gallery.four_bar()
    words = eqx.filter_jit(sj.simulate)(scene, TIMES).stats.explanation
    n = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(compile_scene(scene).system)]).size
    assert f"traced: {n} numbers of bodies.coupler, bodies.crank, bodies.rocker" in words


@pytest.mark.parametrize("other", [{"mass": 1.0}, 3.0, None])
def test_numbers_of_something_else_are_refused(other):
    with pytest.raises(sj.SceneError, match="numbers are those of a scene, or args of"):
        sj.equations.numbers(other)

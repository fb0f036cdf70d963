"""What laws keep at any numbers: hypothesis draws them, edges first, and shrinks what it finds to the simplest."""

import dataclasses

import cases
import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import spherejax as sj
from spherejax.physics.laws.films import FilmGap, FilmMotion
from spherejax.physics.laws.friction import AbstractStaticFriction

FEW = settings(max_examples=40, deadline=None, derandomize=True, database=None)
"""The same numbers each time, so that a commit that fails has broken something."""

STIFFNESS = 1e10  # N/m**1.5
STATIC = {name: law for name, law in cases.FRICTION_LAWS.items() if isinstance(law, AbstractStaticFriction)}
FILMS = [(sj.laws.FullFilm(), sj.Guembel()), (sj.laws.RadialFilm(), sj.Guembel())]


def numbers(least, largest):
    """Without subnormal ones: where XLA computes, they are zero."""
    return st.floats(least, largest, allow_subnormal=False)


def vectors(size: float):
    return st.tuples(*[numbers(-size, size)] * 3).map(np.array)


@jax.jit
def normal_forces(penetration, rate, onset):
    laws = cases.NORMAL_LAWS.values()
    return jnp.stack([law.force(penetration, rate, onset, STIFFNESS) for law in laws])


@FEW
@given(numbers(-1e-3, 1e-3), numbers(-10.0, 10.0), numbers(0.0, 10.0))
def test_surfaces_never_pull_and_do_nothing_apart(penetration, rate, onset):
    forces = np.asarray(normal_forces(penetration, rate, onset))
    assert np.all(np.isfinite(forces))
    assert np.all(forces >= 0.0)
    if penetration <= 0.0:
        assert np.all(forces == 0.0)


@jax.jit
def tractions(velocity, normal_force):
    return jnp.stack([law.traction(velocity, normal_force) for law in STATIC.values()])


@FEW
@given(vectors(10.0), numbers(0.0, 1e4))
def test_friction_opposes_sliding_and_is_bounded_by_its_largest_coefficient(velocity, normal_force):
    forces = np.asarray(tractions(velocity, normal_force))
    size, rounding = np.linalg.norm(forces, axis=1), 1e-12 * normal_force
    for law, traction, force in zip(STATIC.values(), forces, size, strict=True):
        numbers = {field.name: getattr(law, field.name) for field in dataclasses.fields(law)}
        assert force <= normal_force * max(value for name, value in numbers.items() if name.startswith("mu")) + rounding
        assert traction @ velocity <= 0.0
        assert np.linalg.norm(np.cross(traction, velocity)) <= rounding * np.linalg.norm(velocity)


@jax.jit
def film_actions(e, rate, socket_spin, ball_spin):
    actions = []
    for film, boundary in FILMS:
        gap = FilmGap(cases.C, 0.01, 0.4, 0.02 * cases.C, boundary)
        action = film.action(FilmMotion(e, rate, socket_spin, ball_spin), gap)
        actions.append((jnp.stack(action[:3]), jnp.stack([action.pressure_power, action.shear_power])))
    return [jnp.stack(parts) for parts in zip(*actions, strict=True)]


@FEW
@given(vectors(cases.C / 2), vectors(0.1), vectors(50.0), vectors(50.0), vectors(3.0))
def test_films_turn_with_the_axes_and_take_energy(e, rate, socket_spin, ball_spin, turn):
    motion, rotation = (e, rate, socket_spin, ball_spin), Rotation.from_rotvec(turn)
    forces, powers = map(np.array, film_actions(*motion))
    turned, powers_turned = map(np.asarray, film_actions(*map(rotation.apply, motion)))
    expected = rotation.apply(forces.reshape(-1, 3)).reshape(forces.shape)
    # Of what each is made of: where terms cancel, rounding of the turned vectors is left.
    spin = np.linalg.norm(socket_spin) + np.linalg.norm(ball_spin)
    speed = np.linalg.norm(rate) + spin * cases.C
    load = 6 * np.pi * 0.4 * 0.01 * (0.01 / cases.C) ** 3 * speed
    size = np.array([load, load * cases.C, load * cases.C])[None, :, None]
    assert np.all(np.abs(turned - expected) <= 1e-11 * size)
    assert np.all(np.abs(powers_turned - powers) <= 1e-11 * load * speed)
    assert np.all(powers >= -1e-11 * load * speed)

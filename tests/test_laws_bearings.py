"""Films and contacts of a journal in its bearing: against quadrature, textbook formulas and their own definitions."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import spherejax as sj
from spherejax.physics.laws.bearings import (
    long_full_load,
    long_half_load,
    long_slope,
    short_full_load,
    short_half_load,
)
from spherejax.physics.laws.conformity import Pair
from spherejax.physics.laws.films import FilmGap, FilmMotion

AXIS = jnp.array([0.0, 0.0, 1.0])
RATIOS = (0.0, 1e-3, 0.3, 0.8, 0.99, 0.999)
ANGLES = (0.0, 1e-3, 60.0, 90.0, 150.0, 179.9, 180.0)


def vector(x, y=0.0):
    return jnp.array([x, y, 0.0])


def integrated(pressure, center, half):
    """int pressure(a) u da over half of the circle about `center`, or all of it; the gap is least at a = 0."""

    def component(i):
        ends = (center - math.pi / 2, center + math.pi / 2) if half else (-math.pi, math.pi)
        inside = [0.0] if ends[0] < 0 < ends[1] else None
        return quad(
            lambda a: pressure(a) * (math.cos(a), math.sin(a))[i],
            *ends,
            points=inside,
            limit=400,
            epsabs=0,
            epsrel=1e-10,
        )[0]

    return np.array([component(0), component(1)])


@pytest.mark.parametrize("half", [True, False], ids=["pressure only", "with suction"])
@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("eps", RATIOS)
@pytest.mark.filterwarnings("ignore::scipy.integrate.IntegrationWarning")
def test_loads_are_the_integrals_of_the_pressure(eps, angle, half):
    direction = math.radians(angle)
    v = np.array([math.cos(direction), math.sin(direction)])
    r, velocity = vector(eps), vector(*v)

    def short(a):
        return (v @ (math.cos(a), math.sin(a))) / (1 - eps * math.cos(a)) ** 3

    w = np.asarray(long_slope(r, velocity))[:2]
    np.testing.assert_allclose(w, [v[0] / 2, v[1] / (2 + eps * eps)], rtol=1e-13, atol=1e-15)

    def long(a):
        return 12 * (w @ (math.cos(a), math.sin(a))) * (2 - eps * math.cos(a)) / (1 - eps * math.cos(a)) ** 2

    if half:
        found = short_half_load(r, velocity, AXIS), long_half_load(r, velocity, AXIS)
    else:
        found = short_full_load(r, velocity), long_full_load(r, velocity)
    wanted = integrated(short, direction, half), integrated(long, math.atan2(w[1], w[0]), half)
    for load, expected in zip(found, wanted, strict=True):
        # Over the whole circle the integrals of one sign cancel but for rounding.
        np.testing.assert_allclose(load[:2], expected, atol=1e-8 * np.abs(expected).max(), rtol=0)
        assert load[2] == 0


@pytest.mark.parametrize("load", [short_half_load, long_half_load])
def test_half_loads_have_derivatives_everywhere(load):
    for eps, v in ((0.0, (0.0, 0.0)), (0.0, (1.0, 0.0)), (0.5, (0.0, 0.0)), (0.9, (-1.0, 0.3)), (0.9999, (-1.0, 0.0))):
        r, velocity = vector(eps), vector(*v)
        for jacobian in (jax.jacfwd, jax.jacrev):
            by_r, by_v = jacobian(lambda r, v: load(r, v, AXIS), (0, 1))(r, velocity)
            assert np.all(np.isfinite(by_r))
            assert np.all(np.isfinite(by_v))
    r, velocity = vector(0.6, 0.2), vector(0.4, -0.7)
    found = jax.jacfwd(lambda r: load(r, velocity, AXIS))(r)
    h = 1e-5
    differences = [
        (load(r + h * e, velocity, AXIS) - load(r - h * e, velocity, AXIS)) / (2 * h) for e in jnp.eye(3)[:2]
    ]
    np.testing.assert_allclose(found[:, :2].T, differences, rtol=1e-7, atol=1e-7 * np.abs(found).max())


GAP = FilmGap(5e-5, 0.02, 0.03, 0.0, sj.Guembel())
SPEED = 300.0


def steady(film, eps, gap=GAP):
    """Force on a journal that turns steadily at an eccentricity ratio, along and across the line of centers."""
    motion = FilmMotion(vector(eps * gap.clearance), jnp.zeros(3), jnp.zeros(3), SPEED * AXIS, AXIS)
    return film.action(motion, gap)


@pytest.mark.parametrize("eps", [0.1, 0.5, 0.9])
def test_a_steady_short_bearing_is_that_of_ocvirk(eps):
    length, (c, radius, viscosity, *_) = 0.01, GAP
    action = steady(sj.laws.ShortBearing(length), eps)
    size = viscosity * SPEED * radius * length**3 / (4 * c**2) * eps / (1 - eps**2) ** 2
    load = size * math.sqrt(16 * eps**2 + math.pi**2 * (1 - eps**2))
    assert float(jnp.linalg.norm(action.force)) == pytest.approx(load, rel=1e-12)
    attitude = math.atan2(math.pi * math.sqrt(1 - eps**2), 4 * eps)
    assert math.atan2(float(action.force[1]), -float(action.force[0])) == pytest.approx(attitude, rel=1e-12)


@pytest.mark.parametrize("eps", [0.1, 0.5, 0.9])
def test_a_steady_long_bearing_is_half_of_sommerfelds(eps):
    length, (c, radius, viscosity, *_) = 0.08, GAP
    action = steady(sj.laws.LongBearing(length), eps)
    size = 6 * viscosity * SPEED * radius**3 * length / c**2 * eps / (2 + eps**2)
    np.testing.assert_allclose(
        action.force[:2], [-2 * size * eps / (1 - eps**2), size * math.pi / math.sqrt(1 - eps**2)], rtol=1e-9
    )
    whole = steady(sj.laws.LongBearing(length), eps, GAP._replace(boundary=sj.Sommerfeld())).force
    np.testing.assert_allclose(whole[:2], [0.0, 2 * float(action.force[1])], rtol=1e-9, atol=1e-9 * size)


@pytest.mark.parametrize("boundary", [sj.Guembel(), sj.Sommerfeld()])
@pytest.mark.parametrize("film", [sj.laws.ShortBearing(0.01), sj.laws.LongBearing(0.08)])
def test_a_bearing_film_keeps_angular_momentum_and_takes_power(film, boundary):
    random = np.random.default_rng(3)
    gap = GAP._replace(boundary=boundary)
    for _ in range(20):
        e, rate = (np.append(x, 0.0) for x in random.standard_normal((2, 2)))
        e = 0.9 * gap.clearance * random.uniform() * e / np.linalg.norm(e)
        spins = random.standard_normal(2) * 100
        motion = FilmMotion(jnp.asarray(e), 0.01 * jnp.asarray(rate), spins[0] * AXIS, spins[1] * AXIS, AXIS)
        action = film.action(motion, gap)
        total = np.cross(e, action.force) + action.ball_moment + action.socket_moment
        assert np.abs(total).max() < 1e-12 * np.abs(action.ball_moment).max()
        assert action.pressure_power >= 0
        assert action.shear_power >= 0
        absorbed = -(
            action.force @ motion.e_rate
            + action.ball_moment @ motion.ball_spin
            + action.socket_moment @ motion.socket_spin
        )
        assert float(absorbed) == pytest.approx(float(action.pressure_power + action.shear_power), rel=1e-10)
    # A pair that turns as one feels nothing.
    e = vector(3e-5, 1e-5)
    motion = FilmMotion(e, jnp.cross(50.0 * AXIS, e), 50.0 * AXIS, 50.0 * AXIS, AXIS)
    assert np.abs(film.action(motion, gap).force).max() < 1e-9
    concentric = steady(film, 0.0, gap)
    petroff = 2 * math.pi * gap.viscosity * film.length * gap.socket_radius**3 * SPEED / gap.clearance
    assert float(-concentric.ball_moment[2]) == pytest.approx(petroff, rel=1e-13)


# Contact of cylinders ------------------------------------------------------------------------------------------------

PAIR = Pair(5e-4, 0.010, 2 * sj.Material().contact_compliance())
CYLINDERS = {"johnson": (sj.laws.JohnsonCylinder(0.02), -1.0), "esdu": (sj.laws.EsduCylinder(0.02), 1.0)}


@pytest.mark.parametrize("name", CYLINDERS)
@pytest.mark.parametrize("ratio", [1e-12, 1e-6, 1e-3, 0.05, 0.3, 0.39])
def test_the_load_of_a_cylinder_solves_its_formula(name, ratio):
    law, shift = CYLINDERS[name]
    depth = ratio * PAIR.clearance
    load = float(law.force(depth, PAIR))
    f = PAIR.compliance * load / (math.pi * law.length)
    assert f * (math.log(4 * PAIR.clearance / f) + shift) == pytest.approx(depth, rel=1e-13)
    assert float(jax.grad(lambda x: law.energy(x, PAIR))(depth)) == pytest.approx(load, rel=1e-12)
    slope = jax.grad(lambda x: law.force(x, PAIR))
    exact = math.pi * law.length / PAIR.compliance / (math.log(4 * PAIR.clearance / f) + shift - 1)
    assert float(slope(depth)) == pytest.approx(exact, rel=1e-11)
    h = 1e-4 * depth
    curvature = float(slope(depth + h) - slope(depth - h)) / (2 * h)
    assert float(jax.grad(slope)(depth)) == pytest.approx(curvature, rel=1e-5)


@pytest.mark.parametrize("name", CYLINDERS)
def test_a_cylinder_goes_on_straight_where_its_formula_turns_back(name):
    law, shift = CYLINDERS[name]
    assert law.largest_ratio == pytest.approx(8 * math.exp(shift - 2))
    turning = law.largest_ratio * PAIR.clearance
    slope = jax.grad(lambda x: law.force(x, PAIR))
    for function in (lambda x: law.force(x, PAIR), lambda x: law.energy(x, PAIR), slope):
        below, above = function(turning * (1 - 1e-9)), function(turning * (1 + 1e-9))
        assert float(below) == pytest.approx(float(above), rel=1e-7)
    assert float(slope(3 * turning)) == pytest.approx(math.pi * law.length / PAIR.compliance, rel=1e-12)
    for depth in (0.0, -1e-5):
        assert law.force(depth, PAIR) == law.energy(depth, PAIR) == slope(depth) == 0.0

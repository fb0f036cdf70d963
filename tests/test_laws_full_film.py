"""The full film: against Reynolds' equation solved numerically, what must be kept, its limits and derivatives."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import legendre

import spherejax as sj
from spherejax.foundations.rotation import rotation_matrix
from spherejax.physics.laws.film import squeeze_factor
from spherejax.physics.laws.films import FilmGap, FilmMotion
from spherejax.physics.laws.full_film import (
    directions_across,
    full_sphere_load,
    half_sphere_load,
    pressure_peak,
    shear_factors,
)

C, R, NU = 1e-4, 0.01, 0.4
UP, ACROSS = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
LOADS = {"half": half_sphere_load, "full": full_sphere_load}
BOUNDARIES = {"half": sj.Guembel(), "full": sj.Sommerfeld()}

# Reynolds' equation, solved -------------------------------------------------------------------------------------


@cache
def pressures(eps: float, n: int = 60):
    """p of V along and across the line of centers, as functions of zeta = n.u, divided by 12 nu R^2 / c^3.

    Galerkin's method for div((1 - eps zeta)^3 grad p) = -V.u on the unit sphere: p = f(zeta) for V along, and
    sqrt(1 - zeta^2) f(zeta) cos(phi) for V across, f a sum of Legendre polynomials.
    """
    zeta, weights = legendre.leggauss(400)
    basis = legendre.legvander(zeta, n)
    slopes = np.stack([legendre.legval(zeta, legendre.legder(row)) for row in np.eye(n + 1)], 1)
    film, square = (1 - eps * zeta) ** 3 * weights, 1 - zeta**2
    # Along: a constant pressure is free, for nothing flows into or out of the sphere.
    along = (slopes.T * (film * square)) @ slopes
    f0 = np.zeros(n + 1)
    f0[1:] = np.linalg.solve(along[1:, 1:], basis[:, 1:].T @ (weights * zeta))
    # Across: with p = sqrt(square) f, the slope along the meridian times sin(theta) is square f' - zeta f.
    meridian = square[:, None] * slopes - zeta[:, None] * basis
    across = (meridian.T * film) @ meridian + (basis.T * film) @ basis
    f1 = np.linalg.solve(across, basis.T @ (weights * square))
    return (lambda z: legendre.legval(z, f0)), (lambda z: np.sqrt(1 - z**2) * legendre.legval(z, f1))


def solved(eps: float, velocity, only_pressure: bool) -> np.ndarray:
    """The load by quadrature of the solved pressure over the sphere; V in the plane of UP and ACROSS."""
    along, across = pressures(eps)
    zeta, weights = legendre.leggauss(200)
    n = 480
    phi = (np.arange(n) + 0.5) * 2 * np.pi / n
    u = [np.sqrt(1 - zeta[:, None] ** 2) * f(phi) for f in (np.cos, np.sin)] + [zeta[:, None] + 0 * phi]
    p = along(zeta)[:, None] * velocity[2] + across(zeta)[:, None] * np.cos(phi) * velocity[0]
    # The constant that the equation leaves free: where the gap is c, the oil of V along n is at ambient pressure.
    p = p - along(0.0) * velocity[2]
    p = np.maximum(p, 0.0) if only_pressure else p
    return 2 / np.pi * np.array([np.sum(weights[:, None] * p * each) * 2 * np.pi / n for each in u])


@pytest.mark.parametrize("kind", LOADS)
@pytest.mark.parametrize("eps", [0.05, 0.2, 0.3, 0.6, 0.8])
@pytest.mark.parametrize("degrees", [0, 30, 75, 90, 120, 180])
def test_the_load_is_that_of_reynolds_equation(kind, eps, degrees):
    angle = np.radians(degrees)
    velocity = np.sin(angle) * ACROSS + np.cos(angle) * UP
    expected = solved(eps, velocity, kind == "half")
    load = LOADS[kind](eps * UP, velocity)
    np.testing.assert_allclose(load, expected, atol=2e-5 * np.linalg.norm(expected), rtol=0)


@pytest.mark.parametrize("eps", [0.05, 0.3, 0.6, 0.8])
@pytest.mark.parametrize("degrees", [0, 30, 60, 90, 120, 180])
def test_the_largest_pressure_and_its_place_are_those_of_reynolds_equation(eps, degrees):
    angle = np.radians(degrees)
    velocity = np.sin(angle) * ACROSS + np.cos(angle) * UP
    along, across = pressures(eps)
    theta = np.linspace(-np.pi, np.pi, 20001)  # the half plane of n and V, and the one opposite: x = sin(theta)
    zeta = np.cos(theta)
    p = (along(zeta) - along(0.0)) * velocity[2] + across(zeta) * np.sign(np.sin(theta)) * velocity[0]
    found = pressure_peak(eps * UP, velocity)
    assert float(found.height) == pytest.approx(p.max(), rel=2e-4)
    at = theta[p.argmax()]
    np.testing.assert_allclose(found.place, np.sin(at) * ACROSS + np.cos(at) * UP, atol=2e-2)


def test_the_largest_pressure_is_found_where_it_is_a_needle():
    """No point of the film has more, for balls that all but touch and move in any direction."""
    for eps in (0.9, 0.99, 0.9999, 1 - 1e-6):
        for degrees in (0.0, 20.0, 60.0, 89.0, 89.99, 90.0, 91.0, 150.0, 180.0):
            angle = np.radians(degrees)
            velocity = np.sin(angle) * ACROSS + np.cos(angle) * UP
            w = velocity * np.array([1 / (4 + eps**2), 0.0, 0.25])
            theta = np.concatenate(
                [np.linspace(-np.pi, np.pi, 20001), 5 * np.sqrt(1 - eps) * np.linspace(-1, 1, 20001)]
            )
            q = eps * np.cos(theta)
            p = (2 - q) / (1 - q) ** 2 * (np.sin(theta) * w[0] + np.cos(theta) * w[2])
            found = float(pressure_peak(eps * UP, velocity).height)
            assert found >= p.max() * (1 - 1e-9), (eps, degrees)
            assert found <= p.max() * (1 + 1e-4), (eps, degrees)


def test_the_largest_pressure_along_the_line_of_centers():
    for eps in (1e-12, 0.1, 0.7, 0.999):
        closing, opening = (pressure_peak(eps * UP, sign * UP) for sign in (1.0, -1.0))
        assert float(closing.height) == pytest.approx((2 - eps) / (1 - eps) ** 2 / 4, rel=1e-9)
        assert float(opening.height) == pytest.approx((2 + eps) / (1 + eps) ** 2 / 4, rel=1e-9)
        np.testing.assert_allclose(closing.place, UP, atol=1e-7)
        np.testing.assert_allclose(opening.place, -UP, atol=1e-7)
    concentric = pressure_peak(0 * UP, ACROSS)
    assert float(concentric.height) == pytest.approx(0.5)
    np.testing.assert_allclose(concentric.place, ACROSS)
    assert [*map(float, jax.tree.leaves(pressure_peak(0.3 * UP, 0 * UP))[:1])] == [0.0]


def test_the_largest_pressure_has_right_derivatives():
    r, v = np.array([0.3, 0.2, -0.5]), np.array([0.1, 0.7, 0.2])

    def flat(r, v):
        peak = pressure_peak(r, v)
        return jnp.append(peak.place, peak.height)

    forward, backward = jax.jacfwd(flat, (0, 1))(r, v), jax.jacrev(flat, (0, 1))(r, v)
    h = 1e-6
    numbers = (
        np.stack([(flat(r + h * e, v) - flat(r - h * e, v)) / (2 * h) for e in np.eye(3)], -1),
        np.stack([(flat(r, v + h * e) - flat(r, v - h * e)) / (2 * h) for e in np.eye(3)], -1),
    )
    for one, two, three in zip(forward, backward, numbers, strict=True):
        np.testing.assert_allclose(one, two, atol=1e-13)
        np.testing.assert_allclose(one, three, atol=1e-8)
    for motion in ((0 * r, 0 * r), (r, 0 * r), (0 * r, v), (r, r), (r, -r)):
        for each in jax.tree.leaves((jax.jacfwd(flat, (0, 1))(*motion), jax.jacrev(flat, (0, 1))(*motion))):
            assert np.all(np.isfinite(each))


# Numbers, limits -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("eps", "along", "across", "lift", "m_par", "m_perp"),
    [
        (0.0, 1.33333, 1.33333, 0.0, 1.0, 1.0),
        (0.1, 1.34951, 1.33536, 0.03772, 1.00201, 1.00403),
        (0.3, 1.49265, 1.35385, 0.11898, 1.01873, 1.03823),
        (0.5, 1.87777, 1.40523, 0.22363, 1.05624, 1.11980),
        (0.8, 4.38910, 1.68663, 0.58369, 1.18506, 1.46737),
        (0.95, 18.45589, 2.41237, 1.66662, 1.34959, 2.21749),
    ],
)
def test_factors_by_quadrature(eps, along, across, lift, m_par, m_perp):
    """Computed elsewhere by quadrature and finite volumes, five digits."""
    e = eps * UP
    np.testing.assert_allclose(full_sphere_load(e, UP), along * UP, atol=1e-5)
    np.testing.assert_allclose(full_sphere_load(e, ACROSS), across * ACROSS, atol=1e-5)
    np.testing.assert_allclose(half_sphere_load(e, ACROSS), across / 2 * ACROSS + lift * UP, atol=1e-5)
    along, excess = shear_factors(eps**2)
    np.testing.assert_allclose([along, along + eps**2 * excess], [m_par, m_perp], atol=1e-5)


@pytest.mark.parametrize(
    ("eps", "degrees", "normal", "tangential"),
    [(0.5, 45, 1.0432, 0.6069), (0.8, 60, 2.0971, 0.9805), (0.95, 120, -0.0650, 0.4724)],
)
def test_oblique_motion(eps, degrees, normal, tangential):
    angle = np.radians(degrees)
    load = half_sphere_load(eps * UP, np.sin(angle) * ACROSS + np.cos(angle) * UP)
    np.testing.assert_allclose(load, tangential * ACROSS + normal * UP, atol=1e-4)


@pytest.mark.parametrize("eps", [0.0, 1e-9, 0.1, 0.2499999, 0.2500001, 0.5, 0.9, 0.999, 1 - 1e-6])
def test_along_the_line_of_centers_it_is_the_squeeze_film(eps):
    np.testing.assert_allclose(half_sphere_load(eps * UP, UP), squeeze_factor(eps) * UP, rtol=1e-10, atol=1e-14)
    np.testing.assert_allclose(half_sphere_load(eps * UP, -UP), -squeeze_factor(-eps) * UP, rtol=1e-10, atol=1e-9)
    both = squeeze_factor(eps) + squeeze_factor(-eps)
    np.testing.assert_allclose(full_sphere_load(eps * UP, UP), both * UP, rtol=1e-10, atol=1e-14)


def random_motions(n: int, largest: float):
    random = np.random.default_rng(3)
    r, v = random.normal(size=(2, n, 3))
    r *= (random.uniform(0, largest, n) / np.linalg.norm(r, axis=1))[:, None]
    v[: n // 4] = np.cross(r[: n // 4], v[: n // 4])  # exactly across
    v[n // 4 : n // 2] = r[n // 4 : n // 2] * random.normal(size=(n // 4, 1))  # along
    return jnp.asarray(r), jnp.asarray(v)


def test_pressure_and_suction_of_the_half_films_are_the_full_film():
    r, v = random_motions(2000, 0.999)
    half = jax.vmap(half_sphere_load)
    full = jax.vmap(full_sphere_load)(r, v)
    difference = jnp.linalg.norm(half(r, v) - half(r, -v) - full, axis=1)
    assert float(jnp.max(difference / jnp.linalg.norm(full, axis=1))) < 1e-10


@pytest.mark.parametrize("load", LOADS.values(), ids=LOADS)
def test_the_forms_meet_where_one_replaces_the_other(load):
    for eps in (0.25, np.sqrt(0.1)):
        for degrees in (0, 20, 89, 90, 150, 180):
            v = np.sin(np.radians(degrees)) * ACROSS + np.cos(np.radians(degrees)) * UP
            below, above = (load((eps + side * 1e-14) * UP, v) for side in (-1, 1))
            np.testing.assert_allclose(below, above, rtol=0, atol=2e-12)


# What must be kept -----------------------------------------------------------------------------------------------


def gap(boundary, offset=2e-6) -> FilmGap:
    return FilmGap(C, R, NU, offset, boundary)


def motions(n: int):
    r, v = random_motions(n, 0.999999)
    spins = jnp.asarray(np.random.default_rng(4).normal(size=(2, n, 3)))
    return FilmMotion(C * r, 1e-3 * v, *spins)


@pytest.mark.parametrize("boundary", BOUNDARIES.values(), ids=BOUNDARIES)
def test_a_pair_that_turns_as_one_feels_nothing(boundary):
    random = np.random.default_rng(5)
    spin, e = random.normal(size=3), 0.9 * C * UP
    action = sj.laws.FullFilm().action(FilmMotion(e, np.cross(spin, e), spin, spin), gap(boundary))
    assert float(jnp.linalg.norm(action.force)) < 1e-10
    assert float(jnp.linalg.norm(action.ball_moment) + jnp.linalg.norm(action.socket_moment)) < 1e-14


@pytest.mark.parametrize("boundary", BOUNDARIES.values(), ids=BOUNDARIES)
def test_angular_momentum_is_kept_and_no_power_comes_from_nowhere(boundary):
    motion = motions(4000)
    action = jax.vmap(lambda m: sj.laws.FullFilm().action(m, gap(boundary)))(motion)
    total = jnp.cross(motion.e, action.force) + action.ball_moment + action.socket_moment
    assert float(jnp.max(jnp.linalg.norm(total, axis=1) / (C * jnp.linalg.norm(action.force, axis=1)))) < 1e-12
    assert float(jnp.min(action.pressure_power)) >= 0
    assert float(jnp.min(action.shear_power)) >= 0
    given = jnp.sum(action.force * motion.e_rate, 1)
    given += jnp.sum(action.ball_moment * motion.ball_spin + action.socket_moment * motion.socket_spin, 1)
    np.testing.assert_allclose(-given, action.pressure_power + action.shear_power, rtol=1e-9)


@pytest.mark.parametrize("boundary", BOUNDARIES.values(), ids=BOUNDARIES)
def test_derivatives_forward_reverse_and_by_differences_agree(boundary):
    def force(e, rate, spin, clearance):
        motion = FilmMotion(e, rate, spin, -0.5 * spin)
        action = sj.laws.FullFilm().action(motion, FilmGap(clearance, R, NU, 2e-6, boundary))
        return jnp.concatenate([action.force, 1e3 * action.ball_moment, 1e3 * action.socket_moment])

    jacobians = [jax.jit(each(force, (0, 1, 2, 3))) for each in (jax.jacfwd, jax.jacrev)]
    value = jax.jit(force)
    motion = motions(40)
    keep = np.linalg.norm(motion.e, axis=1) < 0.9 * C
    for e, rate, spin, _ in np.asarray(jnp.stack(motion[:4], 1))[keep]:
        point = (e, rate, spin, C)
        forward, reverse = (jacobian(*point) for jacobian in jacobians)
        for i, scale in enumerate((1e-5 * C, 1e-8, 1e-4, 1e-5 * C)):
            np.testing.assert_allclose(forward[i], reverse[i], rtol=1e-8, atol=1e-9 * np.abs(forward[i]).max())
            direction = np.ones(3) / np.sqrt(3) if i < 3 else 1.0
            ends = [
                value(*(x + side * scale * direction if j == i else x for j, x in enumerate(point))) for side in (-1, 1)
            ]
            slope = forward[i] @ direction if i < 3 else forward[i]
            np.testing.assert_allclose(
                (ends[1] - ends[0]) / (2 * scale), slope, atol=3e-5 * float(jnp.abs(slope).max())
            )


@pytest.mark.parametrize("boundary", BOUNDARIES.values(), ids=BOUNDARIES)
def test_values_and_derivatives_are_finite_everywhere(boundary):
    def force(e, rate):
        action = sj.laws.FullFilm().action(FilmMotion(e, rate, 0 * UP, 3 * UP), gap(boundary))
        return jnp.concatenate([action.force, action.ball_moment, action.socket_moment])

    found = jax.jit(
        lambda *point: [force(*point), jax.jacfwd(force, (0, 1))(*point), jax.jacrev(force, (0, 1))(*point)]
    )
    for eps in (0.0, 1e-300, 1e-12, 0.25, 0.5, 1.0, 1.02, 1.5):
        for velocity in (0 * UP, 1e-300 * UP, UP, ACROSS, -UP + 1e-9 * ACROSS):
            for each in jax.tree.leaves(found(eps * C * UP, velocity)):
                assert np.all(np.isfinite(each)), (eps, velocity)


# In a joint ------------------------------------------------------------------------------------------------------


def free_pair(film: sj.laws.AbstractFilm) -> sj.Scene:
    """Two bodies in flight, joined by a film; nothing else acts."""
    inertia = (2e-5, 3e-5, 2.5e-5)
    model = sj.Lubricated(clearance=C, viscosity=0.05, boundary=sj.Sommerfeld(), film=film)
    first = sj.Body(0.2, inertia, angular_velocity=(10.0, -20.0, 5.0), points={"socket": (0.02, 0.0, 0.0)})
    second = sj.Body(
        0.1,
        inertia,
        position=(0.04, 0.0, 0.0),
        velocity=(0.01, 0.51, 0.23),  # 0.017 m/s in the socket
        angular_velocity=(-15.0, 8.0, 20.0),
        points={"ball": (-0.02, 0.0, 0.0)},
    )
    joint = sj.Spherical("first.socket", "second.ball", model, starts_concentric=False)
    return sj.Scene({"first": first, "second": second}, {"joint": joint}, gravity=(0.0, 0.0, 0.0))


def test_a_free_pair_keeps_its_momenta_and_loses_what_the_film_absorbs():
    # The relative motion of the centers ends within a microsecond, the relative spin much later.
    times = np.concatenate([[0.0], np.geomspace(1e-10, 0.02, 2000)])
    run = sj.simulate(free_pair(sj.laws.FullFilm()), times, rtol=1e-9)
    assert run.succeeded
    masses, inertia = {"first": 0.2, "second": 0.1}, np.diag([2e-5, 3e-5, 2.5e-5])
    total, spin = np.zeros((len(times), 3)), np.zeros((len(times), 3))
    for name, mass in masses.items():
        rotation = np.asarray(jax.vmap(rotation_matrix)(run.quaternion(name)))
        turning = rotation @ inertia @ np.swapaxes(rotation, 1, 2) @ np.asarray(run.angular_velocity(name))[..., None]
        velocity = np.asarray(run.velocity(name))
        total += mass * velocity
        spin += mass * np.cross(np.asarray(run.position(name)), velocity) + turning[..., 0]
    assert np.abs(total - total[0]).max() < 1e-10
    assert np.abs(spin - spin[0]).max() < 1e-10
    power = sum(np.asarray(run.part("joint", name)) for name in ("film_power", "shear_power"))
    absorbed = np.sum((power[1:] + power[:-1]) / 2 * np.diff(times))
    lost = float(run.kinetic_energy[0] - run.kinetic_energy[-1])
    assert lost == pytest.approx(absorbed, rel=1e-3)
    e = np.asarray(run.eccentricity("joint"))[0]
    assert float(np.linalg.norm(e)) < 1e-12  # so that the largest pressure is half of 12 nu R^2/c^3 V, before V
    v = np.asarray(run.eccentricity_rate("joint"))[0]
    peak = 6 * 0.05 * R**2 / C**3 * np.linalg.norm(v)
    assert float(run.part("joint", "film_pressure")[0]) == pytest.approx(peak, rel=1e-9)
    np.testing.assert_allclose(run.part("joint", "film_pressure_place")[0], v / np.linalg.norm(v), atol=1e-9)
    kept = run.to_xarray()
    assert kept["joint.film_pressure"].attrs["units"] == "Pa"
    assert kept["joint.film_pressure_place"].dims == ("time", "axis")
    assert lost > 1e-4


def test_the_papers_film_has_no_moments():
    action = sj.laws.RadialFilm().action(FilmMotion(0.5 * C * UP, ACROSS + UP, UP, ACROSS), gap(sj.Guembel()))
    assert float(jnp.linalg.norm(action.ball_moment) + jnp.linalg.norm(action.socket_moment)) == 0
    assert float(action.shear_power) == 0
    assert float(action.pressure_power) > 0


def test_the_full_film_is_the_default_where_its_condition_has_one():
    assert isinstance(sj.Lubricated(clearance=C).film, sj.laws.FullFilm)
    assert isinstance(sj.Lubricated(clearance=C, boundary=sj.Sommerfeld()).film, sj.laws.FullFilm)
    assert isinstance(sj.Lubricated(clearance=C, boundary=sj.PinkusSternlicht()).film, sj.laws.RadialFilm)


def test_a_condition_of_squeezing_alone_is_refused():
    with pytest.raises(sj.SceneError, match=r"PinkusSternlicht.*sj\.Guembel\(\)"):
        sj.Lubricated(clearance=C, boundary=sj.PinkusSternlicht(), film=sj.laws.FullFilm())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("clearance", "ratio", "n_steps"), [(5e-5, (0.07, 0.1), 6000), (1e-4, (0.27, 0.30), 5000), (2e-4, (0.6, 0.7), 5000)]
)
def test_the_four_bar_rides_on_a_full_film(clearance, ratio, n_steps):
    """No bursts: the rocker's vertical acceleration peaks below the ideal run's, and tight runs agree."""
    times = jnp.linspace(0.0, 2.0, 2001)
    scene = sj.gallery.four_bar(sj.Lubricated(clearance=clearance, viscosity=0.4, film=sj.laws.FullFilm()))
    run, tighter = (sj.simulate(scene, times, rtol=rtol) for rtol in (1e-8, 1e-10))
    assert run.succeeded
    assert int(run.stats.n_accepted) < n_steps
    largest = np.linalg.norm(np.asarray(run.eccentricity("coupler_rocker")), axis=1).max() / clearance
    assert ratio[0] < largest < ratio[1]
    assert 10.1 < np.abs(np.asarray(run.acceleration("rocker"))[:, 2]).max() < 11.2
    assert np.abs(np.asarray(run.position("rocker") - tighter.position("rocker"))).max() < 1e-7


@pytest.mark.parametrize(
    "axis", [(1, 1, 1), (-1, -1, -1), (0, 0, 1), (0, 0, -1), (1, 0, 0), (1e-9, 0, -1), (3, -2, 0.5)]
)
def test_directions_across_are_a_right_handed_frame(axis):
    def both(axis):
        return jnp.stack(directions_across(axis))

    z = jnp.asarray(axis) / np.linalg.norm(axis)
    frame = jnp.stack([*directions_across(z), z])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(frame) == pytest.approx(1.0, rel=1e-14)
    forward, backward = jax.jacfwd(both)(z), jax.jacrev(both)(z)
    np.testing.assert_allclose(forward, backward, atol=1e-14)
    if z[2] == 0:  # where they jump
        return
    differences = np.stack([(both(z + h) - both(z - h)) / 2e-7 for h in 1e-7 * np.eye(3)], axis=-1)
    np.testing.assert_allclose(forward, differences, atol=1e-6)

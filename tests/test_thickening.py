"""Oil that thickens under the film's pressure, by Barus' law and by Roelands': Reynolds' equation, loads by other
integrals, runs, limits."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

import spherejax as sj
from spherejax.physics.kinematics import RelativeMotion
from spherejax.physics.laws.films import FilmGap, FilmMotion

RADIUS, LENGTH, CLEARANCE, VISCOSITY, SPEED = 0.02, 0.02, 1e-4, 0.05, 300.0
AXIS = jnp.array([0.0, 0.0, 1.0])
GUEMBEL, SOMMERFELD = sj.Guembel(), sj.Sommerfeld()
FILMS = {
    "ball": sj.laws.FullFilm(),
    "short": sj.laws.ShortBearing(LENGTH),
    "long": sj.laws.LongBearing(5 * RADIUS),
}


def gap(boundary, thickening=None):
    return FilmGap(CLEARANCE, RADIUS, VISCOSITY, 0.0, boundary, thickening)


def moved(name, eps, seed):
    """A motion of a ball, or of a journal across its axis."""
    r = np.random.default_rng(seed)
    e, rate, spin = r.normal(size=3), r.normal(scale=0.03, size=3), r.normal(scale=100.0, size=3)
    if name != "ball":
        e[2] = rate[2] = spin[0] = spin[1] = 0.0
    e *= eps * CLEARANCE / np.linalg.norm(e)
    return FilmMotion(*map(jnp.asarray, (e, rate, np.zeros(3), spin)), None if name == "ball" else AXIS)


def law_for(film, motion, boundary, largest):
    """The alpha [1/Pa] at which alpha q reaches about a value."""
    share = film.range_share(motion, gap(boundary, sj.laws.BarusThickening(1.0)))
    return sj.laws.BarusThickening(largest / (0.7 * float(share)))


def swept(motion):
    return np.asarray(motion.e_rate - jnp.cross(motion.ball_spin / 2, motion.e))


def by_other_integral(name, motion, alpha, suction, n=120):
    """Force on the ball and couple of shear [N, N m]: the pressure's formulas on even grids of many points."""
    r, v, spin = np.asarray(motion.e) / CLEARANCE, swept(motion), np.asarray(motion.ball_spin)
    heights, weights = np.polynomial.legendre.leggauss(n)
    angles = 2 * np.pi * (np.arange(2 * n) + 0.5) / (2 * n)
    if name == "ball":
        slope = v / (4 + r @ r) + r * (r @ v) / (4 * (4 + r @ r))
        frame = np.linalg.svd(slope[:, None])[0] * np.sign(np.linalg.svd(slope[:, None])[0][:, 0] @ slope)
        heights, weights = (heights + 1) / 2, weights / 2
        sides = [(1.0, heights), (1.0, -heights)] if suction else [(1.0, heights)]
        force, couple = np.zeros(3), np.zeros(3)
        for _, s in sides:
            across = np.cos(angles)[:, None] * frame[:, 1] + np.sin(angles)[:, None] * frame[:, 2]
            u = s[:, None, None] * frame[:, 0] + np.sqrt(1 - s * s)[:, None, None] * across
            x = u @ r
            q = 12 * VISCOSITY * RADIUS**2 / CLEARANCE**3 * (2 - x) / (1 - x) ** 2 * (u @ slope)
            measure = RADIUS**2 * weights[:, None] * np.pi / n
            force -= np.einsum("ij,ijk->k", measure * -np.log1p(-alpha * q) / alpha, u)
            shear = measure * RADIUS**2 * VISCOSITY * alpha * q / (1 - alpha * q) / (CLEARANCE * (1 - x))
            couple -= np.einsum("ij,ijk->k", shear, spin - u * (u @ spin)[..., None])
        return force, couple
    length = LENGTH if name == "short" else 5 * RADIUS
    u = np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1)
    x, s = u @ r, heights
    if name == "short":
        q = 1.5 * VISCOSITY * length**2 / CLEARANCE**3 * (u @ v) / (1 - x) ** 3
        q = q[:, None] * (1 - s * s)
    else:
        slope = v / (2 + r @ r) + r * (r @ v) / (2 * (2 + r @ r))
        q = 12 * VISCOSITY * RADIUS**2 / CLEARANCE**3 * (2 - x) / (1 - x) ** 2 * (u @ slope)
        q = q[:, None] * np.ones_like(s)
    q = q if suction else np.maximum(q, 0.0)
    measure = weights / 2 * length * RADIUS * np.pi / n
    force = -((-np.log1p(-alpha * q) / alpha) @ measure) @ u
    shear = (alpha * q / (1 - alpha * q)) @ measure * RADIUS**2 * VISCOSITY / (CLEARANCE * (1 - x))
    return force, -np.sum(shear) * spin


@pytest.mark.parametrize("boundary", [GUEMBEL, SOMMERFELD], ids=["pressure", "suction"])
@pytest.mark.parametrize("name", FILMS)
def test_load_and_couple_are_those_of_finer_integrals(name, boundary):
    film = FILMS[name]
    for seed, (eps, largest, tolerance) in enumerate(
        ((0.0, 0.5, 1e-5), (0.3, 0.6, 3e-5), (0.7, 0.6, 1e-3), (0.8, 0.6, 1e-3), (0.9, 0.6, 5e-3))
    ):
        motion = moved(name, max(eps, 1e-9), seed)
        law = law_for(film, motion, boundary, largest)
        thin, thick = film.action(motion, gap(boundary)), film.action(motion, gap(boundary, law))
        force, couple = by_other_integral(name, motion, float(law.coefficient), boundary.bears_suction)
        if name == "short" and boundary.bears_suction:  # nearly empty of pressure: six points along the axis
            tolerance *= 10
        atol = tolerance * np.linalg.norm(force)
        np.testing.assert_allclose(thick.force, force, atol=atol)
        added = (thick.ball_moment - thick.socket_moment - thin.ball_moment + thin.socket_moment) / 2
        whole = (thick.ball_moment - thick.socket_moment) / 2
        np.testing.assert_allclose(added, couple, atol=tolerance * np.linalg.norm(whole))
        assert -float(thick.force @ swept(motion)) == pytest.approx(float(thick.pressure_power), rel=1e-12)
        if not boundary.bears_suction:
            assert np.linalg.norm(force) > 1.02 * np.linalg.norm(thin.force)
            assert thick.pressure_power > thin.pressure_power
            assert thick.shear_power > thin.shear_power


@pytest.mark.parametrize("eps", [0.0, 0.5])
@pytest.mark.parametrize("direction", [(1, 1, 1), (-1, -1, -1), (1, 1, 0), (0, -1, 1), (0, 0, 1)])
def test_a_ball_that_moves_along_the_line_of_centers_meets_the_same_in_every_direction(direction, eps):
    # The points of its film are counted about that line, from a direction across it.
    n = np.array(direction) / np.linalg.norm(direction)
    still = np.zeros(3)
    motion = FilmMotion(*map(jnp.asarray, (eps * CLEARANCE * n, 0.03 * n, still, still)))
    film, law = FILMS["ball"], law_for(FILMS["ball"], motion, GUEMBEL, 0.6)
    force, _ = by_other_integral("ball", motion, float(law.coefficient), suction=False)
    added = film.action(motion, gap(GUEMBEL, law)).force
    np.testing.assert_allclose(added, force, atol=1e-5 * np.linalg.norm(force))


@pytest.mark.parametrize(("eps", "tolerance"), [(0.3, 5e-5), (0.6, 3e-4)])
def test_derivatives_of_a_ball_are_those_of_finer_integrals(eps, tolerance):
    """By place and velocity. Points are not differentiated, so derivatives are as right as the integral is."""
    film, motion = FILMS["ball"], moved("ball", eps, seed=7)
    law = law_for(film, motion, GUEMBEL, 0.6)

    def force(numbers):
        e, rate = numbers * jnp.array([[CLEARANCE], [0.03]])
        return film.action(motion._replace(e=e, e_rate=rate), gap(GUEMBEL, law)).force

    def fine(numbers):
        e, rate = numbers * np.array([[CLEARANCE], [0.03]])
        moved_on = motion._replace(e=e, e_rate=rate)
        return by_other_integral("ball", moved_on, float(law.coefficient), suction=False)[0]

    at = np.stack([motion.e / CLEARANCE, motion.e_rate / 0.03])
    slopes = np.asarray(jax.jacfwd(force)(jnp.asarray(at)))
    steps = 1e-4 * np.eye(6).reshape(6, 2, 3)
    differences = np.stack([(fine(at + h) - fine(at - h)) / 2e-4 for h in steps], -1).reshape(3, 2, 3)
    np.testing.assert_allclose(slopes, differences, atol=tolerance * np.abs(slopes).max())


def test_the_pressure_obeys_reynolds_equation_with_its_own_viscosity():
    """Along the axis of a short bearing, h^3 dp/dz = -12 eta(p) V.u z by SciPy from the end inward; and the load."""
    film, e = FILMS["short"], np.array([0.6 * CLEARANCE, 0.0, 0.0])
    motion = FilmMotion(jnp.asarray(e), jnp.zeros(3), jnp.zeros(3), SPEED * AXIS, AXIS)
    law = law_for(film, motion, GUEMBEL, 0.7)
    alpha, v = float(law.coefficient), swept(motion)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    middle = math.atan2(v[1], v[0])
    force = np.zeros(3)
    for node, weight in zip(nodes, weights, strict=True):
        angle = middle + node * math.pi / 2
        u = np.array([math.cos(angle), math.sin(angle), 0.0])
        drive = 12 * VISCOSITY * (v @ u) / (CLEARANCE - e @ u) ** 3

        def inward(x, y, drive=drive):
            return [drive * (LENGTH / 2 - x) * math.exp(alpha * y[0]), y[0]]

        end = solve_ivp(inward, (0.0, LENGTH / 2), [0.0, 0.0], rtol=1e-9, atol=1e-9).y[1, -1]
        force -= weight * math.pi / 2 * RADIUS * 2 * end * u
    thick = film.action(motion, gap(GUEMBEL, law))
    np.testing.assert_allclose(thick.force, force, atol=2e-4 * np.linalg.norm(force))
    assert np.linalg.norm(force) > 1.25 * float(jnp.linalg.norm(film.action(motion, gap(GUEMBEL)).force))


P_0, ETA_R = 1.962e8, math.exp(-9.67)


def roelands(viscosity, index):
    """eta(p)/eta_0, and the pressure at which that is so many times one."""
    logarithm = math.log(viscosity / ETA_R)

    def ratio(p):
        return math.exp(logarithm * ((1 + p / P_0) ** index - 1))

    def pressure(times):
        return P_0 * ((1 + math.log(times) / logarithm) ** (1 / index) - 1)

    return ratio, pressure


@pytest.mark.parametrize(("viscosity", "tolerance"), [(0.003, 1e-5), (0.05, 2e-7), (0.4, 2e-8), (5.0, 2e-9)])
@pytest.mark.parametrize("index", [0.4, 0.6, 0.7, 1.3])
def test_pressure_and_viscosity_are_roelands_at_its_reduced_pressure(index, viscosity, tolerance):
    """q is the integral of eta_0/eta(p) dp, by SciPy; from half of the viscosity to ten times it."""
    ratio, pressure = roelands(viscosity, index)
    oil = sj.laws.RoelandsThickening(index).of_viscosity(viscosity)
    pressures = np.array([pressure(times) for times in (0.51, 0.8, 0.99, 1.01, 1.5, 2.5, 4.0, 6.0, 9.9)])
    reduced = np.array([quad(lambda p: 1 / ratio(p), 0.0, end, epsabs=0.0, epsrel=1e-11)[0] for end in pressures])
    excess = oil.excess(jnp.asarray(reduced))
    np.testing.assert_allclose(reduced + excess.pressure, pressures, atol=tolerance * pressures.max())
    np.testing.assert_allclose(1 + excess.viscosity, [ratio(p) for p in pressures], rtol=tolerance)
    # Beyond, straight on: the pressure by its slope, which is the viscosity's ratio.
    end = quad(lambda p: 1 / ratio(p), 0.0, pressure(10.0), epsabs=0.0, epsrel=1e-11)[0]
    far = oil.excess(jnp.array([1.1 * end, 1.2 * end]))
    slope = float(jnp.diff(far.pressure)[0]) / (0.1 * end) + 1
    assert slope == pytest.approx(10.0, rel=1e-5)
    assert float(far.viscosity[0]) == pytest.approx(9 + 0.1 * end * ten_fold_slope(ratio, pressure), rel=1e-3)


def ten_fold_slope(ratio, pressure):
    """d(eta/eta_0)/dq = eta/eta_0 d(eta/eta_0)/dp at ten times the viscosity, by differences."""
    p = pressure(10.0)
    return 10.0 * (ratio(1.0001 * p) - ratio(0.9999 * p)) / (2e-4 * p)


def test_with_the_index_one_it_is_barus_law():
    alpha = math.log(VISCOSITY / ETA_R) / P_0
    reduced = jnp.linspace(-0.9, 1.2, 43) / alpha
    one = sj.laws.RoelandsThickening(1.0).of_viscosity(VISCOSITY).excess(reduced)
    other = sj.laws.BarusThickening(alpha).excess(reduced)
    for mine, its in zip(one, other, strict=True):
        np.testing.assert_allclose(mine, its, rtol=1e-4, atol=1e-9 * float(jnp.max(jnp.abs(its))))


@pytest.mark.slow
def test_roelands_pressure_obeys_reynolds_equation_with_its_viscosity():
    """As that of Barus, in a short bearing whose oil becomes three times as thick."""
    film, e, speed, viscosity, index = FILMS["short"], np.array([0.8 * CLEARANCE, 0.0, 0.0]), 120.0, 0.4, 0.6
    motion = FilmMotion(jnp.asarray(e), jnp.zeros(3), jnp.zeros(3), speed * AXIS, AXIS)
    ratio, _ = roelands(viscosity, index)
    v = swept(motion)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    middle = math.atan2(v[1], v[0])
    force, largest = np.zeros(3), 1.0
    for node, weight in zip(nodes, weights, strict=True):
        angle = middle + node * math.pi / 2
        u = np.array([math.cos(angle), math.sin(angle), 0.0])
        drive = 12 * viscosity * (v @ u) / (CLEARANCE - e @ u) ** 3

        def inward(x, y, drive=drive):
            return [drive * (LENGTH / 2 - x) * ratio(y[0]), y[0]]

        solution = solve_ivp(inward, (0.0, LENGTH / 2), [0.0, 0.0], rtol=1e-9, atol=1e-6)
        largest = max(largest, ratio(solution.y[0, -1]))
        force -= weight * math.pi / 2 * RADIUS * 2 * solution.y[1, -1] * u
    oil = FilmGap(CLEARANCE, RADIUS, viscosity, 0.0, GUEMBEL, sj.laws.RoelandsThickening(index))
    thick = film.action(motion, oil)
    np.testing.assert_allclose(thick.force, force, atol=1e-3 * np.linalg.norm(force))
    thin = film.action(motion, oil._replace(thickening=None))
    assert largest > 3
    assert np.linalg.norm(force) > 1.25 * float(jnp.linalg.norm(thin.force))


def test_little_thickening_changes_little_and_the_film_is_the_same_without():
    for name, film in FILMS.items():
        motion = moved(name, 0.6, 3)
        thin = film.action(motion, gap(GUEMBEL))
        thick = film.action(motion, gap(GUEMBEL, sj.laws.BarusThickening(1e-14)))
        np.testing.assert_allclose(thick.force, thin.force, rtol=1e-6)
        np.testing.assert_allclose(thick.ball_moment, thin.ball_moment, rtol=1e-6, atol=1e-12)


# Runs


def model_of(thickening, name="short", **options):
    conformity = None if name == "ball" else sj.laws.JohnsonCylinder(LENGTH)
    return sj.Lubricated(
        CLEARANCE,
        VISCOSITY,
        socket_radius=RADIUS,
        film=FILMS[name],
        conformity=conformity,
        thickening=thickening,
        **options,
    )


def journal(model, load):
    shaft = sj.Body(1.0, (1e-4, 1e-4, 1e-4), angular_velocity=(0.0, 0.0, SPEED))
    joints = {
        "bearing": sj.Revolute(("ground", "shaft"), (0, 0, 0), (0, 0, 1), model),
        "motor": sj.RotationDriver(("ground", "shaft"), (0, 0, 1), sj.functions.Linear(SPEED)),
    }
    return sj.Scene({"shaft": shaft}, joints, gravity=(0.0, -load, 0.0))


def socket(model):
    body = sj.Body(0.2, (1e-3, 1e-3, 1e-3), angular_velocity=(0, 0, SPEED), points={"center": (0, 0, 0)})
    joint = sj.Spherical("ground.socket", "ball.center", model)
    return sj.Scene({"ball": body}, {"joint": joint}, gravity=(0, 0, -500), ground_points={"socket": (0, 0, 0)})


@pytest.mark.slow
def test_a_loaded_journal_stands_where_the_thicker_oil_bears_it():
    law, load = sj.laws.BarusThickening(2e-7), 400.0
    run = sj.simulate(journal(model_of(law, e_h0=0.0, e_h1=0.0), load), [0.0, 0.1, 0.2], rtol=1e-8)
    assert run.succeeded

    def size(eps, alpha):
        motion = FilmMotion(jnp.array([eps * CLEARANCE, 0.0, 0.0]), jnp.zeros(3), jnp.zeros(3), SPEED * AXIS, AXIS)
        if alpha == 0:
            return float(jnp.linalg.norm(FILMS["short"].action(motion, gap(GUEMBEL)).force))
        return np.linalg.norm(by_other_integral("short", motion, alpha, False, 60)[0])

    eps = float(jnp.linalg.norm(run.eccentricity("bearing")[-1])) / CLEARANCE
    assert eps == pytest.approx(brentq(lambda eps: size(eps, 2e-7) - load, 0.3, 0.68), rel=1e-3)
    thin = brentq(lambda eps: size(eps, 0.0) - load, 0.1, 0.95)
    assert eps < 0.98 * thin


@pytest.mark.slow
def test_oil_that_thickens_without_bound_is_said():
    with pytest.warns(sj.errors.OutOfRangeWarning, match=r"'bearing'.*thickens.*alpha"):
        run = sj.simulate(journal(model_of(sj.laws.BarusThickening(1e-6)), 3000.0), [0.0, 0.02])
    assert run.succeeded


LAWS = {"Barus": (sj.laws.BarusThickening, 5e-8), "Roelands": (sj.laws.RoelandsThickening, 0.9)}


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", ["short", "ball"])
def test_every_number_has_its_derivative(name, law):
    """Of the place after a while, forward against differences: alpha or index, viscosity, clearance, radius."""
    law_of, number = LAWS[law]
    start = jnp.array([number, VISCOSITY, CLEARANCE, RADIUS])

    def final(numbers):
        number, viscosity, c, radius = numbers
        model = sj.Lubricated(
            c,
            viscosity,
            socket_radius=radius,
            film=FILMS[name],
            normal=sj.Hertz(stiffness=1e10),
            thickening=law_of(number),
        )
        joint, scene = ("joint", socket(model)) if name == "ball" else ("bearing", journal(model, 1000.0))
        return sj.simulate(scene, [0.0, 0.01], rtol=1e-9).eccentricity(joint)[-1] / CLEARANCE

    slopes = np.asarray(jax.jacfwd(final)(start)) * np.asarray(start)
    rows = np.asarray(start) * (1 + 1e-4 * np.concatenate([np.eye(4), -np.eye(4)]))
    values = np.asarray(jax.jit(jax.vmap(final))(jnp.asarray(rows)))
    differences = ((values[:4] - values[4:]) / 2e-4).T
    np.testing.assert_allclose(slopes, differences, rtol=1e-4, atol=1e-6)
    assert (np.abs(slopes).max(0) > 1e-4).all()


# Limits, errors, files, cost


@pytest.mark.parametrize(
    ("law_of", "numbers"),
    [(sj.laws.BarusThickening, (1e-10, 1e-3)), (sj.laws.RoelandsThickening, (0.3, 1.3))],
    ids=["Barus", "Roelands"],
)
@pytest.mark.parametrize("name", FILMS)
def test_nothing_that_can_be_reached_is_not_a_number(name, law_of, numbers):
    """At rest, centered, along and across, near the wall and beyond; thin and far too thick; and derivatives."""

    @jax.jit
    @jax.vmap
    def answer(e, rate, across, spin, number):
        def of(e, rate, number):
            model = model_of(law_of(number), name)
            motion = RelativeMotion(
                jnp.array([1.0, 0.0, 0.0]) * e,
                jnp.array([rate, across * rate, 0.0]),
                jnp.eye(3),
                jnp.array([1.0, 0.0, 0.0, 0.0]),
                jnp.zeros(3),
                jnp.array([0.0, 0.0, 1.0]) * spin,
            )
            response = model.respond(motion, jnp.where(e > CLEARANCE, 1e-3, 0.0)[None])
            return jnp.concatenate([response.force, response.ball_moment, response.socket_moment])

        return of(e, rate, number), jax.jacfwd(of, (0, 1, 2))(e, rate, number)

    grid = jnp.meshgrid(
        jnp.array([0.0, 5e-5, 9.9e-5, 1.2e-4]),
        jnp.array([0.0, -1.0]),
        jnp.array([0.0, 1.0]),
        jnp.array([0.0, 300.0]),
        jnp.array(numbers),
        indexing="ij",
    )
    found = answer(*(axis.ravel() for axis in grid))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"thickening": sj.laws.BarusThickening(0.0)}, r"thickening\.coefficient = 0 must be positive.*1/Pa"),
        ({"thickening": sj.laws.RoelandsThickening(2.0)}, r"thickening\.index = 2 must lie in \[0\.3, 1\.3\]"),
        ({"thickening": sj.laws.RoelandsThickening(0.6, 0.0)}, r"thickening\.pressure = 0 must be positive.*Pa"),
        (
            {"thickening": sj.laws.BarusThickening(2e-8), "film": sj.laws.RadialFilm()},
            r"film = 'RadialFilm' must know oil that thickens.*FullFilm",
        ),
    ],
)
def test_wrong_numbers_are_named(options, said):
    with pytest.raises(sj.SceneError, match=said):
        sj.equations.compile_scene(socket(sj.Lubricated(CLEARANCE, **options)))


def test_a_file_gives_the_coefficient_with_its_unit(tmp_path):
    scene = journal(model_of(sj.laws.BarusThickening(2e-8)), 100.0)
    path = tmp_path / "thick.toml"
    sj.save_scene(scene, path)
    assert eqx.tree_equal(sj.load_scene(path), scene)
    path.write_text(path.read_text().replace("coefficient = 2e-08", 'coefficient = "20 1/GPa"'))
    law = sj.load_scene(path).joints["bearing"].model.thickening
    assert law.coefficient == pytest.approx(2e-8)
    path.write_text(
        path.read_text()
        .replace('kind = "barus-thickening"', 'kind = "roelands-thickening"')
        .replace('coefficient = "20 1/GPa"', 'index = 0.6\npressure = "196 MPa"')
    )
    law = sj.load_scene(path).joints["bearing"].model.thickening
    assert isinstance(law, sj.laws.RoelandsThickening)
    assert (law.index, law.pressure) == (0.6, 1.96e8)


@pytest.mark.parametrize("law", [sj.laws.BarusThickening(2e-8), sj.laws.RoelandsThickening(0.6)])
@pytest.mark.parametrize("name", ["short", "ball"])
def test_effects_say_what_thickening_costs_and_thin_oil_has_none_of_it(name, law):
    build = (lambda model: socket(model)) if name == "ball" else (lambda model: journal(model, 100.0))
    thick, thin = (sj.effects(build(model_of(oil, name)), timed=False).rows for oil in (law, None))
    assert [row[1:-1] for row in thick[:-1]] == [row[1:-1] for row in thin]
    last, before = thick[-1], thick[-2]
    assert last.effect == f"viscosity by pressure ({type(law).__name__})"
    assert last.n_states == before.n_states
    assert 100 < last.n_operations - before.n_operations < 10000

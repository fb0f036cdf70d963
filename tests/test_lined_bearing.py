"""The film of a bearing with an elastic liner: against Reynolds' equation on a grid, exact series, balances, runs."""

import math
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse as sparse
from scipy.integrate import simpson
from scipy.sparse.linalg import spsolve

import spherejax as sj
from spherejax.model.system import compile_scene
from spherejax.motion.start.doubts import doubts_of
from spherejax.physics.kinematics import RelativeMotion
from spherejax.physics.laws import bearings
from spherejax.physics.laws.films import FilmGap, FilmMotion
from spherejax.physics.laws.lined_axial import profile_of

RADIUS, LENGTH, CLEARANCE, VISCOSITY, SPEED = 0.02, 0.02, 1e-4, 0.05, 300.0
AXES = jnp.eye(3)
LINER = sj.laws.WinklerLiner(1e9, 0.4, 2e-3)
GAP = FilmGap(CLEARANCE, RADIUS, VISCOSITY, 0.0, sj.Guembel())
PRESSURE = 12 * VISCOSITY * SPEED / 2 * RADIUS**2 / CLEARANCE**2
"""The unit of the pressure on the grid [Pa]."""


def liner_of(compliance):
    """A liner that the unit of pressure deflects by so many clearances; E = k_w t (1 + nu)(1 - 2 nu)/(1 - nu)."""
    foundation = PRESSURE / (compliance * CLEARANCE)
    return sj.laws.WinklerLiner(foundation * 2e-3 * 1.4 * 0.2 / 0.6, 0.4, 2e-3)


def on_grid(eps, whole, slenderness, around=180, along=18):
    """Load [R L times the unit of pressure] of a steadily turning journal, and its largest pressure: Reynolds' equation
    in both directions with a deflection at each point, and no negative pressure (an LCP).

        d/da (H**3 dP/da - H) + (2 R/L)**2 d/ds (H**3 dP/ds) = 0 where P > 0,    H = 1 - eps cos(a) + whole P

    by Newton's method, with more and more of the compliance.
    """
    angles, da, ds = 2 * np.pi * (np.arange(around) + 0.5) / around, 2 * np.pi / around, 1 / along
    stretch = 1 / slenderness**2
    rigid = np.repeat((1 - eps * np.cos(angles))[:, None], along, 1)
    index = np.arange(around * along).reshape(around, along)
    pressure = np.zeros((around, along))
    change, compliances = np.inf, [0.03 * whole, 0.2 * whole, whole]
    for _ in range(120):
        compliance = compliances[0]
        gap = rigid + compliance * pressure
        round_gap, round_slope = 0.5 * (gap + np.roll(gap, -1, 0)), (np.roll(pressure, -1, 0) - pressure) / da
        axial_gap, axial_slope = 0.5 * (gap[:, 1:] + gap[:, :-1]), (pressure[:, 1:] - pressure[:, :-1]) / ds
        flow, axial = round_gap**3 * round_slope - round_gap, stretch * axial_gap**3 * axial_slope
        balance = (flow - np.roll(flow, 1, 0)) / da
        balance[:, :-1] += axial / ds
        balance[:, 1:] -= axial / ds
        end = stretch * rigid[:, 0] ** 3 / (ds / 2) / ds
        balance[:, -1] -= end * pressure[:, -1]
        entries = []

        def link(i, j, by_i, by_j, entries=entries):
            for row, column, value in ((i, i, by_i), (i, j, by_j), (j, i, -by_i), (j, j, -by_j)):
                entries.append((row.ravel(), column.ravel(), value.ravel()))

        bend = 1.5 * compliance * round_gap**2 * round_slope - 0.5 * compliance
        link(index, np.roll(index, -1, 0), (bend - round_gap**3 / da) / da, (bend + round_gap**3 / da) / da)
        bend = 1.5 * compliance * axial_gap**2 * axial_slope
        link(
            index[:, :-1],
            index[:, 1:],
            stretch * (bend - axial_gap**3 / ds) / ds,
            stretch * (bend + axial_gap**3 / ds) / ds,
        )
        entries.append((index[:, -1], index[:, -1], -end))
        rows, columns, values = (np.concatenate(part) for part in zip(*entries, strict=True))
        slope = sparse.csr_matrix((values, (rows, columns)), (index.size, index.size))
        empty = (-slope.diagonal() * pressure.ravel()) < -balance.ravel()
        rest = np.where(empty, pressure.ravel(), balance.ravel())
        matrix = sparse.diags_array(1.0 * ~empty) @ slope + sparse.diags_array(1.0 * empty)
        step = spsolve(matrix.tocsc(), -rest).reshape(around, along)
        pressure, change = pressure + step, np.abs(step).max()
        if change < 1e-10 * np.abs(pressure).max():
            if len(compliances) == 1:
                break
            del compliances[0]
    assert change < 1e-9 * np.abs(pressure).max()
    assert pressure.min() > -1e-9
    arms = np.stack([np.cos(angles), np.sin(angles)])
    return arms @ pressure.sum(1) * da * ds, pressure.max()


def moving(memory, e=(0.0, 0.0), rate=(0.0, 0.0), spins=(0.0, 0.0), axes=AXES):
    axis = axes[:, 2]
    plane = [v[0] * axes[:, 0] + v[1] * axes[:, 1] for v in (e, rate)]
    return FilmMotion(*plane, spins[0] * axis, spins[1] * axis, axis, memory, axes)


@eqx.filter_jit
def rates_of(film, w, e, gap, rate, speed):
    return film.action(moving(w, e, rate, (0.0, speed)), gap).memory_rate


@eqx.filter_jit
def slope_of(film, w, e, gap, rate, speed):
    return jax.jacfwd(lambda w: film.action(moving(w, e, rate, (0.0, speed)), gap).memory_rate)(w)


def steady(film, e, gap=GAP, rate=(0.0, 0.0), speed=SPEED):
    """Deflections that stay while a journal turns, or is squeezed, at a place; by Newton's method."""
    # Arrays, by which one program serves all numbers.
    film, *others = jax.tree.map(jnp.asarray, (film, tuple(e), gap, tuple(rate), speed))
    w, step = np.zeros(len(film.memory)), np.ones(1)
    for _ in range(60):
        step = np.linalg.solve(slope_of(film, w, *others), -rates_of(film, w, *others))
        w = w + step
        if np.abs(step).max() < 1e-10 * np.abs(w).max():
            break
    assert np.abs(step).max() < 1e-9 * np.abs(w).max()
    return film.action(moving(jnp.asarray(w), e, rate, (0.0, speed)), gap), w


def load_of(action, length):
    return -np.asarray(action.force)[:2] / (PRESSURE * RADIUS * length)


# Against the grid


@pytest.mark.parametrize(
    ("slenderness", "eps", "compliance", "share", "tolerance"),
    [
        (0.5, 0.3, 0.3, 0.996, 0.01),
        (0.5, 0.5, 0.1, 0.998, 0.01),
        (0.5, 0.7, 0.3, 0.902, 0.02),
        (0.5, 0.8, 0.1, 0.900, 0.04),
        (0.5, 0.8, 0.3, 0.722, 0.04),
        (0.5, 0.9, 0.1, 0.583, 0.10),
        (1.0, 0.5, 0.1, 0.985, 0.01),
        (1.0, 0.7, 0.1, 0.937, 0.035),
        (0.25, 0.7, 1.0, 0.881, 0.02),
    ],
)
def test_load_and_direction_are_those_of_a_fine_grid(slenderness, eps, compliance, share, tolerance):
    """Of 32 points with one parabola each; the load of the rigid bearing would be wrong by 1 - share."""
    length = 2 * RADIUS * slenderness
    film = sj.laws.LinedBearing(length, liner_of(compliance))
    action, _ = steady(film, (eps * CLEARANCE, 0.0))
    load = load_of(action, length)
    expected, highest = on_grid(eps, compliance, slenderness)
    hard, _ = on_grid(eps, 0.0, slenderness)
    assert np.linalg.norm(load) == pytest.approx(np.linalg.norm(expected), rel=tolerance)
    turned = math.atan2(load[1], load[0]) - math.atan2(expected[1], expected[0])
    assert abs(turned) < 0.03
    assert np.linalg.norm(expected) / np.linalg.norm(hard) == pytest.approx(share, abs=0.01)
    assert compliance * highest > 0.01


def refined(eps, compliance, slenderness):
    """Of two grids, to the limit of ever finer ones."""
    coarse, fine = (np.append(*on_grid(eps, compliance, slenderness, *size)) for size in ((120, 12), (180, 18)))
    return fine + (fine - coarse) / (1.5**2 - 1)


@pytest.mark.parametrize(("axial", "of_peak"), [(2, 0.07), pytest.param(3, 0.035, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("slenderness", "eps", "compliance", "tolerance"),
    [
        (0.5, 0.5, 0.1, 0.003),
        (0.5, 0.7, 0.3, 0.004),
        (0.5, 0.8, 0.1, 0.005),
        (0.5, 0.8, 0.3, 0.005),
        (0.5, 0.9, 0.1, 0.02),
        (1.0, 0.7, 0.1, 0.005),
        (1.0, 0.8, 0.1, 0.006),
        (1.0, 0.9, 1e-6, 0.02),
        (0.25, 0.7, 1.0, 0.003),
        (4.0, 0.8, 1e-6, 0.015),
    ],
)
def test_deflections_along_the_axis_have_load_and_pressure_of_a_fine_grid(
    slenderness, eps, compliance, tolerance, axial, of_peak
):
    """Of 32 points with two or three of them: what the page says of `axial=2`."""
    length, e = 2 * RADIUS * slenderness, (eps * CLEARANCE, 0.0)
    *expected, highest = refined(eps, compliance, slenderness)
    film = sj.laws.LinedBearing(length, liner_of(compliance), axial=axial)
    action, w = steady(film, e)
    load = load_of(action, length)
    assert np.linalg.norm(load) == pytest.approx(np.linalg.norm(expected), rel=tolerance)
    assert abs(math.atan2(load[1], load[0]) - math.atan2(expected[1], expected[0])) < 0.02
    peak = film.pressure_peak(moving(jnp.asarray(w), e), GAP)
    assert float(peak.height) == pytest.approx(highest * PRESSURE, rel=of_peak)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_polynomials_along_the_axis_are_integrated_and_differentiated_exactly(n):
    """Their squares, of a mass matrix that is diagonal so; their slopes; and what leaves a gap of one thickness."""
    profile = profile_of(n)
    s, all_places = profile.places, np.append(profile.places, 1.0)
    basis = [
        np.polynomial.Polynomial([1.0, 0.0, -1.0]) * np.polynomial.Polynomial(np.eye(2 * n)[2 * j]) for j in range(n)
    ]
    for first in basis:
        np.testing.assert_allclose(profile.slopes @ first(s), first.deriv()(all_places), atol=1e-12)
        np.testing.assert_allclose(profile.in_middle @ first(s), first(0.0), atol=1e-13)
        assert profile.along(first(s)) == pytest.approx(first.integ()(1.0), rel=1e-13)
        for second in basis:
            assert profile.along(first(s) * second(s)) == pytest.approx((first * second).integ()(1.0), rel=1e-13)
            small = 1e-9 * jnp.asarray(second(s))[:, None]
            leaving = 1e9 * profile.leaving(0.5, jnp.ones(1), small, small)
            stiffness = 16.0 * (first.deriv() * second.deriv()).integ()(1.0)
            assert float(profile.along(first(s) * leaving[:, 0])) == pytest.approx(stiffness, rel=1e-7)


def test_the_load_hardly_depends_on_the_points_and_on_where_they_are():
    loads = []
    for points, angle in ((24, 0.0), (32, 0.0), (32, 0.07), (64, 0.0), (64, 0.03)):
        e = 0.7 * CLEARANCE * np.array([math.cos(angle), math.sin(angle)])
        loads.append(np.linalg.norm(steady(sj.laws.LinedBearing(LENGTH, LINER, points), e)[0].force))
    np.testing.assert_allclose(loads, loads[-1], rtol=0.012)


def test_a_stiff_liner_leaves_the_rigid_bearing():
    """Ocvirk's load where the bearing is short; and Reynolds' of the length where it is not."""
    hard = sj.laws.WinklerLiner(2e13, 0.4, 1e-3)
    for slenderness, tolerance in ((0.05, 0.01), (0.1, 0.02)):
        length = 2 * RADIUS * slenderness
        for eps in (0.3, 0.6):
            e = (eps * CLEARANCE, 0.0)
            lined = steady(sj.laws.LinedBearing(length, hard, 64), e)[0]
            short = sj.laws.ShortBearing(length).action(moving(None, e, spins=(0.0, SPEED)), GAP)
            np.testing.assert_allclose(lined.force, short.force, atol=tolerance * float(jnp.linalg.norm(short.force)))
            np.testing.assert_allclose(lined.ball_moment, short.ball_moment, rtol=1e-3, atol=1e-12)
    expected, _ = on_grid(0.6, 0.0, 1.0)
    load = load_of(steady(sj.laws.LinedBearing(2 * RADIUS, hard, 64), (0.6 * CLEARANCE, 0.0))[0], 2 * RADIUS)
    assert np.linalg.norm(load) == pytest.approx(np.linalg.norm(expected), rel=0.01)


@pytest.mark.parametrize(
    ("axial", "tolerances"),
    [(1, (0.02, 0.02, 0.1, 0.17)), pytest.param(3, (0.02, 0.02, 0.01, 0.08), marks=pytest.mark.slow)],
)
def test_small_vibrations_have_the_impedance_of_the_exact_series(axial, tolerances):
    """A concentric journal in a full film: w = sum_j w_j cos(a) cos((2 j + 1) pi z/L), each with its own decay."""
    gap = GAP._replace(boundary=sj.Sommerfeld())
    film, n = sj.laws.LinedBearing(LENGTH, LINER, 16, axial=axial), 16 * axial

    def answer(w, v):
        action = film.action(moving(w, rate=(v, 0.0)), gap)
        return action.memory_rate, action.force[0]

    rates, forces = jax.jacfwd(answer, (0, 1))(jnp.zeros(n), 0.0)
    decay, driven = (np.asarray(part) for part in rates)
    by_w, by_v = (np.asarray(part) for part in forces)
    orders = 2 * np.arange(2000) + 1
    foundation = float(LINER.foundation())
    fades = foundation * CLEARANCE**3 / (12 * VISCOSITY) * (1 / RADIUS**2 + (orders * math.pi / LENGTH) ** 2)
    shares = (4 / (math.pi * orders)) ** 2 / 2
    for hertz, tolerance in zip((10.0, 1e3, 1e4, 1e6), tolerances, strict=True):
        omega = 2 * math.pi * hertz
        found = by_w @ np.linalg.solve(1j * omega * np.eye(n) - decay, driven) + by_v
        exact = -foundation * RADIUS * LENGTH * math.pi * np.sum(shares / (1j * omega + fades))
        assert abs(found - exact) < tolerance * abs(exact)


# Balances


def random_state(seed, suction, axial=1):
    r = np.random.default_rng(seed)
    angle = r.uniform(0, 2 * np.pi)
    turn = np.linalg.qr(r.normal(size=(3, 3)))[0]
    turn = turn * np.sign(np.linalg.det(turn))
    w = jnp.asarray(r.normal(scale=2e-6 if suction else 1e-5, size=32 * axial))
    e = CLEARANCE * r.uniform(0, 0.9) * np.array([np.cos(angle), np.sin(angle)])
    return moving(w, e, r.normal(scale=0.05, size=2), r.normal(scale=200.0, size=2), jnp.asarray(turn))


@pytest.mark.parametrize("axial", [1, 2, pytest.param(4, marks=pytest.mark.slow)])
@pytest.mark.parametrize("boundary", [sj.Guembel(), sj.Sommerfeld()], ids=["pressure", "suction"])
def test_power_goes_into_the_liner_or_is_dissipated_and_angular_momentum_stays(boundary, axial):
    film, gap = sj.laws.LinedBearing(LENGTH, LINER, axial=axial), GAP._replace(boundary=boundary)
    act = jax.jit(lambda motion: film.action(motion, gap))
    for seed in range(20):
        motion = random_state(seed, boundary.bears_suction, axial)
        action = act(motion)
        assert action.pressure_power > 0
        assert action.shear_power > 0

        def stored(w, motion=motion):
            return film.action(motion._replace(memory=w), gap).stored_energy

        given = -(action.force @ motion.e_rate)
        given -= action.ball_moment @ motion.ball_spin + action.socket_moment @ motion.socket_spin
        _, into = jax.jvp(stored, (motion.memory,), (action.memory_rate,))
        taken = [float(into), float(action.pressure_power), float(action.shear_power)]
        assert float(given) == pytest.approx(sum(taken), rel=1e-11, abs=1e-11 * max(map(abs, taken)))
        about_socket = jnp.cross(motion.e, action.force) + action.ball_moment + action.socket_moment
        np.testing.assert_allclose(about_socket, 0.0, atol=1e-12 * float(jnp.linalg.norm(action.ball_moment)))


@pytest.mark.parametrize("axial", [1, 2])
def test_a_pair_that_turns_as_one_feels_nothing(axial):
    e = jnp.array([0.5 * CLEARANCE, 0.0])
    motion = moving(jnp.zeros(32 * axial), e, 50.0 * jnp.array([-e[1], e[0]]), (50.0, 50.0))
    action = sj.laws.LinedBearing(LENGTH, LINER, axial=axial).action(motion, GAP)
    np.testing.assert_allclose(action.memory_rate, 0.0, atol=1e-16)
    np.testing.assert_allclose(action.force, 0.0)
    np.testing.assert_allclose(action.ball_moment, 0.0, atol=1e-15)


# Runs


def model_of(liner=LINER, boundary=None, points=16, axial=1, **options):
    return sj.Lubricated(
        CLEARANCE,
        VISCOSITY,
        socket_radius=RADIUS,
        film=sj.laws.LinedBearing(LENGTH, liner, points, axial=axial),
        boundary=boundary,
        conformity=sj.laws.JohnsonCylinder(LENGTH),
        **options,
    )


def journal(model, load=400.0, driven=True, velocity=(0.0, 0.0, 0.0)):
    """A shaft of 1 kg that turns at a given speed, or freely."""
    shaft = sj.Body(1.0, (1e-4, 1e-4, 1e-4), velocity=velocity, angular_velocity=(0.0, 0.0, SPEED))
    joints = {"bearing": sj.Revolute(("ground", "shaft"), (0, 0, 0), (0, 0, 1), model, starts_concentric=driven)}
    if driven:
        joints["motor"] = sj.RotationDriver(("ground", "shaft"), (0, 0, 1), sj.functions.Linear(SPEED))
    return sj.Scene({"shaft": shaft}, joints, gravity=(0.0, -load, 0.0))


@pytest.fixture(scope="module")
def loaded():
    return sj.simulate(journal(model_of(e_h0=0.0, e_h1=0.0)), [0.0, 0.1, 0.2], rtol=1e-8)


def test_a_run_comes_to_the_place_that_bears_the_load(loaded):
    """There the steady film, by Newton's method, bears the weight; the same scene without a liner stands elsewhere."""
    assert loaded.succeeded
    place = np.asarray(loaded.eccentricity("bearing")[-1])
    action, w = steady(model_of().film, place[:2])
    np.testing.assert_allclose(action.force, [0.0, 400.0, 0.0], atol=1e-4 * 400.0)
    memory = loaded.memory("bearing")
    found = np.array([memory[f"deflection_{i}"][-1] for i in range(16)])
    np.testing.assert_allclose(np.sort(found), np.sort(w), rtol=1e-3, atol=1e-5 * np.abs(w).max())
    peak = float(LINER.foundation()) * w.max()
    assert float(loaded.part("bearing", "film_pressure")[-1]) == pytest.approx(peak, rel=1e-5)
    assert np.abs(place).max() < 0.8 * CLEARANCE


def test_a_run_takes_a_stiff_method_where_the_liner_is_fast(loaded):
    """An explicit one would take some 90,000 steps here, and 1.8e7 with a liner of steel."""
    assert loaded.stats.n_steps < 3000
    steel = sj.simulate(journal(model_of(sj.laws.WinklerLiner(2e11, 0.3, 2e-3), e_h0=0.0, e_h1=0.0)), [0.0, 0.1, 0.2])
    assert steel.stats.n_steps < 3000


@pytest.mark.slow
@pytest.mark.parametrize("axial", [1, 2])
def test_what_a_free_shaft_loses_is_dissipated(axial):
    scene = journal(model_of(axial=axial), load=0.0, driven=False, velocity=(0.1, 0.05, 0.0))
    ts = 0.05 * np.linspace(0.0, 1.0, 1001) ** 2
    run = sj.simulate(scene, ts, rtol=1e-9)
    assert run.succeeded
    powers = [np.asarray(run.part("bearing", name)) for name in ("film_power", "shear_power")]
    assert all((power >= -1e-12).all() for power in powers)
    lost = float(run.mechanical_energy[0] - run.mechanical_energy[-1])
    assert sum(simpson(power, x=ts) for power in powers) == pytest.approx(lost, rel=1e-5)
    assert lost > 0.1


@pytest.mark.slow
def test_a_journal_that_goes_beyond_its_clearance_is_stopped_and_said():
    """A soft liner under a load that it cannot hold within the clearance: dry contact helps, and the run says so."""
    soft = sj.laws.WinklerLiner(5e6, 0.4, 2e-3)
    with pytest.warns(sj.errors.OutOfRangeWarning, match=r"'bearing'.*LinedBearing.*0\.8"):
        run = sj.simulate(journal(model_of(soft, friction=sj.Threlfall())), [0.0, 0.05, 0.1])
    assert run.succeeded
    e = np.linalg.norm(np.asarray(run.eccentricity("bearing"))[-1])
    assert 0.99 < e / CLEARANCE < 1.05


@pytest.mark.slow
def test_every_number_has_its_derivative():
    """Of the place after a while, forward against differences, by length, liner, viscosity, clearance and radius."""
    start = jnp.array([CLEARANCE, VISCOSITY, RADIUS, LENGTH, 1e9, 0.4, 2e-3])

    def final(numbers):
        c, viscosity, radius, length, *liner = numbers
        film = sj.laws.LinedBearing(length, sj.laws.WinklerLiner(*liner), 16)
        model = sj.Lubricated(c, viscosity, socket_radius=radius, film=film, normal=sj.Hertz(stiffness=1e10), e_h1=2e-6)
        return sj.simulate(journal(model), [0.0, 0.02], rtol=1e-9).eccentricity("bearing")[-1, :2] / CLEARANCE

    slopes = np.asarray(jax.jacfwd(final)(start)) * np.asarray(start)
    steps = 1e-4 * np.asarray(start)
    rows = np.asarray(start) + np.concatenate([np.diag(steps), -np.diag(steps)])
    values = np.asarray(jax.jit(jax.vmap(final))(jnp.asarray(rows)))
    differences = ((values[:7] - values[7:]) / 2e-4).T
    np.testing.assert_allclose(slopes, differences, rtol=1e-4, atol=1e-6)
    assert (np.abs(slopes).max(0) > 1e-4).all()


@pytest.mark.slow
def test_a_film_with_two_deflections_along_the_axis_has_its_derivatives():
    """Of force, powers and rates at a state, by each number and each deflection; differences in complete steps."""
    motion = random_state(3, False, 2)
    start = jnp.concatenate([jnp.array([CLEARANCE, VISCOSITY, RADIUS, LENGTH, 1e9, 0.4, 2e-3]), motion.memory])
    gap = GAP._replace(transition_offset=2e-6)

    @jax.jit
    def answer(numbers):
        c, viscosity, radius, length, *liner = numbers[:7]
        film = sj.laws.LinedBearing(length, sj.laws.WinklerLiner(*liner), axial=2)
        action = film.action(
            motion._replace(memory=numbers[7:]), gap._replace(clearance=c, viscosity=viscosity, socket_radius=radius)
        )
        powers = jnp.stack([action.pressure_power, action.shear_power])
        return jnp.concatenate([action.force[:2], 1e-3 * powers, action.memory_rate])

    slopes = np.asarray(jax.jacfwd(answer)(start)) * np.asarray(start)
    steps = 1e-5 * np.diag(np.asarray(start))
    rows = jax.vmap(answer)(start + jnp.asarray(np.concatenate([steps, -steps])))
    differences = np.asarray(rows[: start.size] - rows[start.size :]).T / 2e-5
    scale = np.abs(slopes).max(1, keepdims=True)
    np.testing.assert_allclose(slopes / scale, differences / scale, atol=1e-7)
    assert (np.abs(slopes).max(0) > 0).all()


# Limits, errors, cost


@pytest.mark.parametrize(
    ("boundary", "axial"),
    [(sj.Guembel(), 1), (sj.Sommerfeld(), 1), pytest.param(sj.Guembel(), 2, marks=pytest.mark.slow)],
    ids=["pressure", "suction", "two along the axis"],
)
def test_nothing_that_can_be_reached_is_not_a_number(boundary, axial):
    model = model_of(boundary=boundary, friction=sj.Threlfall(), axial=axial)

    @jax.jit
    @jax.vmap
    def answer(e, rate, spin, size):
        def of(model, e, rate, size):
            motion = RelativeMotion(
                jnp.array([1.0, 0.3, 0.0]) * e,
                jnp.array([-0.2, 1.0, 0.0]) * rate,
                jnp.eye(3),
                jnp.array([1.0, 0.0, 0.0, 0.0]),
                jnp.zeros(3),
                jnp.array([0.0, 0.0, 1.0]) * spin,
            )
            shape = jnp.cos(jnp.arange(16.0 * axial))
            memory = jnp.concatenate([jnp.where(e > CLEARANCE, 1e-3, 0.0)[None], size * shape])
            response = model.respond(motion, memory)
            return jnp.concatenate([response.force, response.ball_moment, response.memory_rate])

        return of(model, e, rate, size), jax.jacfwd(of, (0, 1, 2, 3))(model, e, rate, size)

    grid = jnp.meshgrid(
        jnp.array([0.0, 5e-5, 9.5e-5, 1e-4, 1.2e-4, 1.0]),
        jnp.array([0.0, 1e-3, 1.0]),
        jnp.array([0.0, 300.0]),
        jnp.array([0.0, 1e-7, 1e-5, 1e-3]),
        indexing="ij",
    )
    found = answer(*(axis.ravel() for axis in grid))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))


@pytest.mark.parametrize(
    ("film", "said"),
    [
        (lambda: sj.laws.LinedBearing(0.0, LINER), r"joint 'bearing'.*length = 0 must be positive.*\[m\]"),
        (lambda: sj.laws.LinedBearing(0.02, sj.laws.WinklerLiner(-1.0, 0.4, 1e-3)), r"liner\.youngs_modulus = -1"),
        (lambda: sj.laws.LinedBearing(0.02, sj.laws.WinklerLiner(1e9, 0.5, 1e-3)), r"liner\.poissons_ratio = 0\.5"),
        (lambda: sj.laws.LinedBearing(0.02, LINER, 4), r"points = 4 must be a whole number from 16 to 96"),
        (lambda: sj.laws.LinedBearing(0.02, LINER, axial=0), r"axial = 0 must be a whole number from 1 to 4.*give 2"),
        (lambda: sj.laws.LinedBearing(0.02, LINER, axial=5), r"axial = 5 must be a whole number from 1 to 4.*give 2"),
    ],
)
def test_wrong_numbers_are_named(film, said):
    model = eqx.tree_at(lambda m: m.film, model_of(), film())
    with pytest.raises(sj.SceneError, match=said):
        sj.equations.compile_scene(journal(model))


HARD = sj.laws.WinklerLiner(1e12, 0.3, 2e-3)


@pytest.mark.parametrize(
    ("film", "radii", "eps", "ratio", "said"),
    [
        (sj.laws.ShortBearing, 1.0, 0.8, 1.65, None),
        (
            sj.laws.ShortBearing,
            2.0,
            0.8,
            3.22,
            "not longer than their radius; in one of 2 radii.*1.4 times.*3.2 times",
        ),
        (sj.laws.LongBearing, 4.0, 0.5, 1.39, None),
        (sj.laws.LongBearing, 3.0, 0.5, 1.81, "LongBearing is for bearings of four radii or more"),
        (lambda length: sj.laws.LinedBearing(length, HARD), 4.0, 0.8, 0.933, None),
        (lambda length: sj.laws.LinedBearing(length, HARD), 8.0, 0.8, 0.905, "parabola of pressure.*axial=2"),
        (lambda length: sj.laws.LinedBearing(length, HARD, axial=2), 8.0, 0.8, 0.985, None),
        (lambda length: sj.laws.LinedBearing(length, HARD, axial=2), 16.0, 0.8, 0.979, "axial=2.*up to eight radii"),
    ],
)
def test_a_film_that_is_not_for_the_length_of_its_bearing_is_said(film, radii, eps, ratio, said):
    """With how much it errs there, beside a grid: its documented limits."""
    length = radii * RADIUS
    film = film(length)
    if film.memory:
        load = load_of(steady(film, (eps * CLEARANCE, 0.0))[0], length)
    else:
        load = load_of(film.action(moving(None, (eps * CLEARANCE, 0.0), spins=(0.0, SPEED)), GAP), length)
    expected, _ = on_grid(eps, 1e-6, radii / 2, 120, 24)
    assert np.linalg.norm(load) / np.linalg.norm(expected) == pytest.approx(ratio, rel=0.01)
    model = sj.Lubricated(
        CLEARANCE, VISCOSITY, socket_radius=RADIUS, film=film, conformity=sj.laws.JohnsonCylinder(LENGTH)
    )  # fmt: skip
    scene = journal(model)
    doubts = " ".join(doubts_of(scene, compile_scene(scene).system))
    assert re.search(f"joint 'bearing': .*{said}", doubts) if said else not doubts


FACTORS = {
    0.5: ((1.03, 1.06, 1.18), (41, 29, 10), (1.00, 1.00, 1.00)),
    1.0: ((1.12, 1.20, 1.65), (11, 8, 3.6), (1.00, 1.00, 0.99)),
    2.0: ((1.42, 1.69, 3.22), (3.5, 2.9, 1.75), (1.00, 1.00, 0.95)),
    4.0: ((2.4, 3.2, 8.6), (1.47, 1.39, 1.16), (0.99, 0.99, 0.93)),
    8.0: ((5.5, 8.2, 27), (0.85, 0.88, 0.93), (0.97, 0.96, 0.91)),
}
"""By L/R: loads of short, long and lined bearings over those of the grid, at eccentricity ratios of 0.3, 0.5 and 0.8.
The table of the page on journals."""


def test_what_is_said_of_lengths_is_in_the_table():
    for kind, said in ((0, bearings.SHORT_FACTORS), (1, bearings.LONG_FACTORS)):
        assert tuple(zip(*((row[kind][0], row[kind][2]) for row in FACTORS.values()), strict=True)) == said
    assert tuple(FACTORS) == bearings.LENGTHS
    assert "at least 5.5 times" in sj.laws.ShortBearing(0.2).doubt(RADIUS)


@pytest.mark.slow
@pytest.mark.parametrize("radii", FACTORS)
def test_the_table_of_lengths_is_what_a_grid_says(radii):
    length = radii * RADIUS
    for at, eps in enumerate((0.3, 0.5, 0.8)):
        e = (eps * CLEARANCE, 0.0)
        exact = np.linalg.norm(on_grid(eps, 1e-6, radii / 2, 120, 24)[0])
        actions = [
            kind(length).action(moving(None, e, spins=(0.0, SPEED)), GAP)
            for kind in (sj.laws.ShortBearing, sj.laws.LongBearing)
        ]
        actions.append(steady(sj.laws.LinedBearing(length, HARD), e)[0])
        for action, factors in zip(actions, FACTORS[radii], strict=True):
            # To the last digit of the table.
            assert np.linalg.norm(load_of(action, length)) / exact == pytest.approx(factors[at], rel=0.04, abs=0.01)


def test_a_ball_has_no_such_film():
    body = sj.Body(0.2, (1e-3, 1e-3, 1e-3), points={"center": (0, 0, 0)})
    joint = sj.Spherical("ground.socket", "ball.center", model_of())
    with pytest.raises(sj.SceneError, match=r"film = 'LinedBearing' must be of a ball in its socket"):
        sj.equations.compile_scene(sj.Scene({"ball": body}, {"joint": joint}, ground_points={"socket": (0, 0, 0)}))


def test_a_run_says_nothing_up_to_what_the_axis_is_resolved_for():
    for axial, largest in ((1, 0.8), (2, 0.9)):
        film = sj.laws.LinedBearing(LENGTH, LINER, axial=axial)
        assert float(film.range_share(moving(None, (0.0, largest * CLEARANCE)), GAP)) == pytest.approx(1.0)
        assert f"{largest:g}" in film.beyond_range


def test_effects_say_what_the_liner_costs_and_a_rigid_bearing_has_none_of_it():
    rigid = eqx.tree_at(lambda m: m.film, model_of(), sj.laws.ShortBearing(LENGTH))
    lined, hard = (sj.effects(journal(model), timed=False).rows for model in (model_of(), rigid))
    assert [row[1:-1] for row in lined[:-1]] == [row[1:-1] for row in hard]
    last, before = lined[-1], lined[-2]
    assert last.effect == "elastic liner (16 points)"
    assert (last.n_states, last.n_memory) == (before.n_states + 16, before.n_memory + 16)
    assert 0 < last.n_operations - before.n_operations < 1000
    resolved = sj.effects(journal(model_of(axial=2)), timed=False).rows[-1]
    assert (resolved.effect, resolved.n_states) == ("elastic liner (32 points)", before.n_states + 32)
    assert last.n_operations < resolved.n_operations < 2.5 * last.n_operations


# Published charts

RAIMONDI_AND_BOYD = (
    (0.5, 0.2, 2.03, 74.94, 40.9),
    (0.5, 0.4, 0.779, 61.45, 17.0),
    (0.5, 0.6, 0.319, 48.14, 8.10),
    (0.5, 0.8, 0.0923, 33.31, 3.26),
    (1.0, 0.2, 0.631, 74.02, 12.8),
    (1.0, 0.4, 0.264, 63.10, 5.79),
    (1.0, 0.6, 0.121, 50.58, 3.22),
    (1.0, 0.8, 0.0446, 36.24, 1.70),
)
"""Full bearings: L/2R, eps, Sommerfeld number, attitude angle [deg], friction (R/c) f."""


def test_hard_bearings_have_the_charts_of_raimondi_and_boyd():
    """Load and friction, and so the rise of temperature by the charts' own flow, which is in proportion to friction."""
    hard = sj.laws.WinklerLiner(2e13, 0.4, 1e-3)
    for slenderness, eps, sommerfeld, attitude, friction in RAIMONDI_AND_BOYD:
        length = 2 * RADIUS * slenderness
        action, _ = steady(sj.laws.LinedBearing(length, hard, 48), (eps * CLEARANCE, 0.0))
        load = -np.asarray(action.force)
        size = np.linalg.norm(load)
        number = VISCOSITY * SPEED / (2 * math.pi) * 2 * RADIUS * length / size * (RADIUS / CLEARANCE) ** 2
        power = float(action.pressure_power + action.shear_power)
        tolerance = 0.03 if slenderness == 1.0 and eps > 0.7 else 0.013
        assert number == pytest.approx(sommerfeld, rel=tolerance)
        assert power / (SPEED * size * CLEARANCE) == pytest.approx(friction, rel=tolerance)
        assert math.degrees(math.atan2(abs(load[1]), load[0])) == pytest.approx(attitude, abs=4.0)


SLENDERNESSES = (1.0, 1 / 2, 1 / 3, 1 / 8)
TURNING = {
    0.1: ((0.1196, 0.0368, 0.0171, 0.0025), (79.410, 81.767, 82.299, 82.653)),
    0.2: ((0.2518, 0.0783, 0.0366, 0.0054), (73.858, 75.142, 75.344, 75.422)),
    0.3: ((0.4091, 0.1304, 0.0617, 0.0091), (68.264, 68.493, 68.368, 68.211)),
    0.4: ((0.6108, 0.2026, 0.0968, 0.0144), (62.571, 61.778, 61.382, 61.007)),
    0.5: ((0.8903, 0.3124, 0.1522, 0.0231), (56.705, 54.993, 54.348, 53.784)),
    0.6: ((1.3146, 0.4982, 0.2496, 0.0390), (50.536, 48.049, 47.191, 46.449)),
    0.7: ((2.0432, 0.8595, 0.4492, 0.0732), (43.859, 40.803, 39.756, 38.865)),
    0.8: ((3.5663, 1.7339, 0.9687, 0.1706), (36.235, 32.938, 31.761, 30.692)),
}
SQUEEZED = {
    -0.8: (0.6293, 0.1685, 0.0761, 0.0109),
    0.0: (2.4076, 0.7224, 0.3355, 0.0488),
    0.2: (3.8485, 1.2236, 0.5826, 0.0859),
    0.4: (6.8503, 2.4202, 1.1756, 0.1774),
    0.6: (14.769, 6.0649, 3.1002, 0.4899),
    0.7: (24.842, 11.373, 6.0733, 1.0027),
    0.8: (50.349, 26.676, 15.282, 2.7312),
}
"""Butenschoen (1976), by which MBDyn's journals are tested: Sommerfeld numbers load (c/R)**2/(2 R L eta omega) by L/2R,
with attitude angles [deg], of a journal that turns at eps; and with the rate of eps in place of omega, of one that is
squeezed, or leaves the wall at a negative eps."""

OFF_TABLES = {
    ("turning", 32, 1): ((0.022, 0.020, 0.053), (0.010, 0.008, 0.013)),
    ("turning", 64, 1): ((0.021, 0.017, 0.022), (0.009, 0.006, 0.007)),
    ("turning", 32, 2): ((0.023, 0.006, 0.015), (0.009, 0.006, 0.0095)),
    ("squeezed", 32, 1): ((0.015, 0.029, 0.058), (0.009, 0.011, 0.027)),
    ("squeezed", 64, 1): ((0.009, 0.015, 0.028), (0.009, 0.004, 0.010)),
    ("squeezed", 32, 2): ((0.0025, 0.005, 0.0145), (0.0095, 0.003, 0.008)),
}
"""How far loads may be off up to 0.6, at 0.7 and at 0.8, in bearings as long as wide and in shorter ones: what the page
says."""


def off_tables(kind, points, axial, eps, slenderness):
    return OFF_TABLES[kind, points, axial][slenderness < 1][0 if eps <= 0.6 else 1 if eps == 0.7 else 2]


def sommerfeld(action, length, speed):
    return np.linalg.norm(action.force) * (CLEARANCE / RADIUS) ** 2 / (2 * RADIUS * length * VISCOSITY * speed)


@pytest.mark.parametrize(("points", "axial"), [(32, 1), (64, 1), (32, 2)])
def test_hard_bearings_have_the_tables_of_mbdyns_journals(points, axial):
    """Load, attitude, and friction, (R/c) f = pi/(So sqrt(1 - eps**2)) + (eps/2) sin(attitude) of the tables."""
    hard = sj.laws.WinklerLiner(2e13, 0.4, 1e-3)
    for eps, row in TURNING.items():
        for slenderness, number, attitude in zip(SLENDERNESSES, *row, strict=True):
            length = 2 * RADIUS * slenderness
            action, _ = steady(sj.laws.LinedBearing(length, hard, points, axial=axial), (eps * CLEARANCE, 0.0))
            load = -np.asarray(action.force)
            tolerance = off_tables("turning", points, axial, eps, slenderness)
            assert sommerfeld(action, length, SPEED) == pytest.approx(number, rel=tolerance)
            off = 1.4 if slenderness < 1 else 4.5 if eps < 0.6 else 1.7
            assert math.degrees(math.atan2(abs(load[1]), load[0])) == pytest.approx(attitude, abs=off)
            power = float(action.pressure_power + action.shear_power)
            friction = math.pi / (math.sqrt(1 - eps**2) * number) + 0.5 * eps * math.sin(math.radians(attitude))
            assert power / (SPEED * np.linalg.norm(load) * CLEARANCE) == pytest.approx(friction, rel=tolerance)


def test_where_the_film_differs_most_from_the_tables_the_grid_does_too():
    """At an eccentricity ratio of 0.1 in a bearing as long as wide."""
    expected = np.linalg.norm(refined(0.1, 1e-6, 1.0)[:2])
    film = sj.laws.LinedBearing(2 * RADIUS, HARD, axial=2)
    load = load_of(steady(film, (0.1 * CLEARANCE, 0.0))[0], 2 * RADIUS)
    assert np.linalg.norm(load) == pytest.approx(expected, rel=0.002)
    # The unit of the grid's load is three times that of the tables.
    assert 3 * expected / TURNING[0.1][0][0] == pytest.approx(1.021, abs=0.001)


@pytest.mark.parametrize(("points", "axial"), [(32, 1), (64, 1), (32, 2)])
def test_hard_bearings_that_are_squeezed_have_the_tables_of_mbdyns_journals(points, axial):
    hard, speed = sj.laws.WinklerLiner(2e13, 0.4, 1e-3), 1e-3
    for eps, row in SQUEEZED.items():
        for slenderness, number in zip(SLENDERNESSES, row, strict=True):
            length, rate = 2 * RADIUS * slenderness, (math.copysign(speed, eps), 0.0)
            film = sj.laws.LinedBearing(length, hard, points, axial=axial)
            action, _ = steady(film, (abs(eps) * CLEARANCE, 0.0), rate=rate, speed=0.0)
            tolerance = off_tables("squeezed", points, axial, eps, slenderness)
            assert sommerfeld(action, length, speed / CLEARANCE) == pytest.approx(number, rel=tolerance)


@pytest.mark.slow
def test_a_warm_bearing_is_near_one_that_was_resolved_in_temperature():
    """ROSS (github.com/petrobras/ross, tests/data/fluid_film/fixed_adiabatic.json): two pads of 176 degrees, a field of
    temperature without heat to the bodies. One temperature in a full gap dissipates and warms too much, by a sixth."""
    radius, length, clearance, cold, load, speed = 0.2, 0.263144, 1.94564e-4, 322.983, 112814.9, 94.24778
    flow = 854.95 * 1951.5 * 3.6829e-4  # density, specific heat, side flow
    heat = sj.laws.OilHeat(
        sj.laws.ReynoldsViscosity(math.log(0.0190157 / 0.00771523) / 30.0, cold),
        100.0,
        flow_capacity=flow,
        inlet_temperature=323.0,
        start_temperature=336.0,
    )
    model = sj.Lubricated(
        clearance,
        0.0190157,
        socket_radius=radius,
        film=sj.laws.LinedBearing(length, sj.laws.WinklerLiner(2e13, 0.3, 1e-3)),
        conformity=sj.laws.JohnsonCylinder(length),
        heat=heat,
        e_h0=0.0,
        e_h1=0.0,
    )
    shaft = sj.Body(200.0, (1.0, 1.0, 1.0), angular_velocity=(0.0, 0.0, speed))
    joints = {
        "bearing": sj.Revolute(("ground", "shaft"), (0, 0, 0), (0, 0, 1), model),
        "motor": sj.RotationDriver(("ground", "shaft"), (0, 0, 1), sj.functions.Linear(speed)),
    }
    run = sj.simulate(sj.Scene({"shaft": shaft}, joints, gravity=(0, -load / 200.0, 0)), [0.0, 1.0, 2.0], rtol=1e-7)
    e = np.asarray(run.eccentricity("bearing"))[-1] / clearance
    rise = float(run.part("bearing", "oil_temperature")[-1]) - 323.0
    power = float(run.part("bearing", "film_power")[-1] + run.part("bearing", "shear_power")[-1])
    assert rise == pytest.approx(power / flow, rel=1e-3)
    assert np.linalg.norm(e) == pytest.approx(0.61135, rel=0.05)
    assert math.degrees(math.atan2(e[0], -e[1])) == pytest.approx(math.degrees(0.80503), abs=1.0)
    assert float(run.part("bearing", "film_pressure")[-1]) == pytest.approx(2.8018e6, rel=0.08)
    assert power == pytest.approx(8380.1, rel=0.18)
    assert rise == pytest.approx(336.61 - 323.0, rel=0.18)
    assert power > 1.1 * 8380.1

"""Oil whose temperature is resolved round a bearing, and films that grooves feed: closed forms, balances, ROSS."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import lambertw

import spherejax as sj
from spherejax.model.system import compile_scene
from spherejax.motion.start.doubts import doubts_of
from spherejax.physics.kinematics import RelativeMotion
from spherejax.physics.laws.films import FilmGap, FilmMotion

RADIUS, LENGTH, CLEARANCE, VISCOSITY, SPEED = 0.02, 0.02, 1e-4, 0.05, 300.0
COLD, BETA, CAPACITY = 313.15, 0.03, 1.7e6
REYNOLDS = sj.laws.ReynoldsViscosity(BETA)
LINER = sj.laws.WinklerLiner(1e12, 0.3, 2e-3)
GAP = FilmGap(CLEARANCE, RADIUS, VISCOSITY, 0.0, sj.Guembel())


def moving(memory, e=(0.0, 0.0), rate=(0.0, 0.0), spins=(0.0, SPEED)):
    place, velocity = (jnp.array([*v, 0.0]) for v in (e, rate))
    axis = jnp.array([0.0, 0.0, 1.0])
    return FilmMotion(place, velocity, spins[0] * axis, spins[1] * axis, axis, memory, jnp.eye(3))


def acting(film, heat, motion, warming, gap=GAP):
    """Of the film and of the heat: action and rates of the temperatures."""
    temperature = heat.temperature(warming)
    action = film.action(motion, gap._replace(viscosity=gap.viscosity * heat.viscosity.ratio(temperature)))
    power = action.pressure_power + action.shear_power
    return action, heat.rates(temperature, power, action.transport), heat.told(temperature, action.transport)


def steady(film, heat, e=(0.0, 0.0), gap=GAP, speed=SPEED):
    """Deflections and temperatures of a journal that turns steadily at a place, by implicit steps that grow.

    Where the film fills and empties, Newton's method alone does not find them.
    """
    n, clearance = film.points, gap.clearance

    def answer(x):
        return acting(film, heat, moving(x[:n] * clearance, e, spins=(0.0, speed)), x[n:], gap)

    @jax.jit
    def rates(x):
        action, warming, _ = answer(x)
        return jnp.concatenate([action.memory_rate / clearance, warming])

    slope = jax.jit(jax.jacfwd(rates))
    x, step = jnp.concatenate([jnp.zeros(n), jnp.zeros(n)]), 1e-4
    scale = jnp.concatenate([jnp.full(n, 0.1), jnp.full(n, 5.0)])
    for _ in range(400):
        change = jnp.linalg.solve(jnp.eye(2 * n) / step - slope(x), rates(x))
        if not float(jnp.abs(change / scale).max()) < 1.0:
            step = step / 3.0
            continue
        x, step = x + change, min(1.5 * step, 1e6)
        if step == 1e6 and float(jnp.abs(change).max()) < 1e-9:
            break
    assert float(jnp.abs(change).max()) < 1e-9
    return answer(x), np.asarray(x[:n]), np.asarray(x[n:])


# Closed forms


@pytest.mark.parametrize(("points", "within"), [(16, 0.003), pytest.param(64, 0.0008, marks=pytest.mark.slow)])
def test_the_oil_of_a_concentric_journal_warms_by_a_logarithm_from_groove_to_groove(points, within):
    """C Q dT/da = eta(T) (speed R)^2 L R/c: T = T_g + ln(1 + beta k a)/beta; at the groove warm and fresh oil mix."""
    film = sj.laws.LinedBearing(LENGTH, LINER, points, grooves=1)
    heat = sj.laws.BearingHeat(REYNOLDS, CAPACITY, carry_over=0.6, inlet_temperature=COLD + 5.0)
    (action, _, told), _, warming = steady(film, heat)
    flow = SPEED * RADIUS / 2 * LENGTH * CLEARANCE

    def warmth(start, angle):
        slope = VISCOSITY * math.exp(-BETA * start) * (SPEED * RADIUS) ** 2 * LENGTH * RADIUS / CLEARANCE
        return start + math.log1p(BETA * slope * angle / (CAPACITY * flow)) / BETA

    start = 5.0
    for _ in range(100):
        start = 0.6 * warmth(start, 2 * math.pi) + 0.4 * 5.0
    # Temperatures are those with which oil leaves a point, half a step on.
    expected = np.array([warmth(start, 2 * math.pi * (i + 0.5) / points) for i in range(points)])
    assert expected.max() - 5.0 > 7.0
    np.testing.assert_allclose(warming, expected, atol=within * (expected.max() - 5.0))
    power = float(action.shear_power)
    assert power == pytest.approx(CAPACITY * flow * 0.4 * (warmth(start, 2 * math.pi) - 5.0), rel=within)
    assert power == pytest.approx(float(told["heat_to_flow"]), rel=1e-9)


def test_without_flow_through_it_is_the_balance_of_one_temperature():
    """A concentric journal that no groove feeds: Lambert's function, and the rates of `OilHeat` on the way there."""
    film = sj.laws.LinedBearing(LENGTH, LINER, 16)
    numbers = {"socket_conductance": 2.0, "ball_conductance": 1.0}
    heat = sj.laws.BearingHeat(REYNOLDS, CAPACITY, **numbers)
    whole = sj.laws.OilHeat(REYNOLDS, CAPACITY * 2 * math.pi * RADIUS * LENGTH * CLEARANCE, **numbers)
    for warmth in (-10.0, 0.0, 25.0):
        action, rates, told = acting(film, heat, moving(jnp.zeros(16)), jnp.full(16, warmth))
        one = whole.rate(COLD + warmth, action.shear_power)
        np.testing.assert_allclose(rates, np.full(16, float(one)), rtol=1e-11)
        lost = whole.heat_flows(COLD + warmth)
        assert float(told["heat_to_ball"]) == pytest.approx(float(lost.to_ball), rel=1e-12)
        assert float(told["heat_to_flow"]) == pytest.approx(0.0, abs=1e-12)
    power = 2 * math.pi * VISCOSITY * LENGTH * RADIUS**3 / CLEARANCE * SPEED**2
    (_, _, told), _, warming = steady(film, heat)
    np.testing.assert_allclose(warming, float(lambertw(BETA * power / 3.0).real) / BETA, rtol=1e-9)
    assert float(told["hottest_oil"]) == pytest.approx(float(told["oil_temperature"]), rel=1e-12)


# Balances


def random_state(film, seed, suction=False):
    r = np.random.default_rng(seed)
    w = r.normal(scale=1e-6, size=len(film.memory))
    if film.grooves and not suction:
        w = np.where(w < 0, 20 * w, w)
    angle = r.uniform(0, 2 * np.pi)
    e = CLEARANCE * r.uniform(0, 0.7) * np.array([np.cos(angle), np.sin(angle)])
    spins = r.normal(scale=200.0, size=2)
    return moving(jnp.asarray(w), e, r.normal(scale=0.02, size=2), spins), jnp.asarray(r.normal(10.0, 5.0, film.points))


@pytest.mark.parametrize(("grooves", "axial"), [(0, 1), (1, 1), (2, 1), (0, 2), (2, 2)])
def test_heat_and_oil_and_energy_are_accounted_for(grooves, axial):
    """At any state: heat of the oil grows by what is dissipated less what leaves, its volume by what comes in, and what
    the journal gives is stored in the liner or dissipated."""
    film = sj.laws.LinedBearing(LENGTH, sj.laws.WinklerLiner(1e9, 0.4, 2e-3), 16, grooves, 0.3, 0.1, axial)
    heat = sj.laws.BearingHeat(REYNOLDS, CAPACITY, 3.0, 2.0, 0.7, 310.0, 320.0, 300.0)
    states = [random_state(film, seed) for seed in range(30)]

    @jax.jit
    def answer(motion, warming):
        action, rates, told = acting(film, heat, motion, warming)
        moves = (motion.e_rate - jnp.cross(motion.socket_spin, motion.e), action.memory_rate, rates)

        def kept(e, w, warming):
            # In axes of the bearing the journal's center moves so.
            transport = film.action(
                motion._replace(e=e, memory=w), GAP._replace(viscosity=jnp.full(16, VISCOSITY))
            ).transport
            above = heat.temperature(warming) - heat.inlet_temperature
            return CAPACITY * transport.volume @ above, jnp.sum(transport.volume)

        _, (heat_rate, volume_rate) = jax.jvp(kept, (motion.e, motion.memory, warming), moves)

        def stored(w):
            return film.action(motion._replace(memory=w), GAP).stored_energy

        _, into = jax.jvp(stored, (motion.memory,), (action.memory_rate,))
        return action, told, heat_rate, volume_rate, into

    for motion, warming in states:
        action, told, heat_rate, volume_rate, into = answer(motion, warming)
        power = np.asarray(action.transport.power)
        total = float(action.pressure_power + action.shear_power)
        assert power.sum() == pytest.approx(total, rel=1e-11)
        assert power.min() >= 0
        lost = [float(told[f"heat_to_{where}"]) for where in ("socket", "ball", "flow")]
        scale = total + sum(map(abs, lost))
        assert float(heat_rate) == pytest.approx(total - sum(lost), abs=1e-10 * scale)
        out = float(jnp.sum(action.transport.outward))
        assert float(volume_rate) == pytest.approx(-out, abs=1e-11 * float(jnp.abs(action.transport.forward).sum()))
        given = -(action.force @ motion.e_rate)
        given -= action.ball_moment @ motion.ball_spin + action.socket_moment @ motion.socket_spin
        assert float(given) == pytest.approx(total + float(into), rel=1e-10)


def test_a_starved_film_keeps_its_oil_from_groove_to_groove():
    """Where the gap is not filled nothing leaves, and the flow is that with which the groove has filled the gap."""
    film = sj.laws.LinedBearing(LENGTH, LINER, 32, grooves=2, groove_angle=0.0)
    heat = sj.laws.BearingHeat(sj.laws.ReynoldsViscosity(0.0), CAPACITY)
    (action, _, _), w, _ = steady(film, heat, (0.3 * CLEARANCE, -0.5 * CLEARANCE))
    forward, outward = np.asarray(action.transport.forward), np.asarray(action.transport.outward)
    angles = 2 * np.pi * np.arange(32) / 32
    gap = 1 - 0.3 * np.cos(angles) + 0.5 * np.sin(angles)
    starved = np.flatnonzero(w[1:16] < 0) + 1
    np.testing.assert_array_equal(starved, np.arange(1, 16))  # all of the half behind the first groove
    carried = SPEED / 2 * RADIUS * LENGTH * CLEARANCE
    np.testing.assert_allclose(forward[:15], carried * gap[0], rtol=1e-6)
    np.testing.assert_allclose(outward[1:16], 0.0, atol=1e-9 * carried)
    # Its thickness at a point is the mean of what arrives and what leaves.
    np.testing.assert_allclose((gap + 0.4 * (w + np.roll(w, 1)))[2:16], gap[0], rtol=0.01)
    # In the loaded half oil leaves at the ends as long as there is pressure.
    pressed = np.flatnonzero(w > 0)
    assert pressed.min() >= 17
    assert (outward[pressed[1:-1]] > 0).all()
    assert -float(action.force[1]) < 0 < 0.5 * float(action.shear_power)


@pytest.mark.parametrize("axial", [1, 2])
def test_a_journal_that_turns_the_other_way_is_the_mirror_image(axial):
    film = sj.laws.LinedBearing(LENGTH, LINER, 16, grooves=2, axial=axial)
    heat = sj.laws.BearingHeat(REYNOLDS, CAPACITY, 1.0, 1.0)
    motion, warming = random_state(film, 4)
    mirror = np.r_[0, np.arange(15, 0, -1)]
    of_all = np.concatenate([mirror + 16 * k for k in range(axial)])
    flip = jnp.array([1.0, -1.0, 1.0])
    other = motion._replace(
        e=motion.e * flip,
        e_rate=motion.e_rate * flip,
        socket_spin=-motion.socket_spin,
        ball_spin=-motion.ball_spin,
        memory=motion.memory[of_all],
    )
    action, rates, told = acting(film, heat, motion, warming)
    mirrored, its_rates, its_told = acting(film, heat, other, warming[mirror])
    np.testing.assert_allclose(mirrored.force, action.force * flip, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(mirrored.memory_rate[of_all], action.memory_rate, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(its_rates[mirror], rates, rtol=1e-9, atol=1e-9)
    assert float(its_told["heat_to_flow"]) == pytest.approx(float(told["heat_to_flow"]), rel=1e-10)


# Runs


def model_of(heat=None, film=None, **options):
    heat = sj.laws.BearingHeat(REYNOLDS, CAPACITY, 1.0) if heat is None else heat
    film = sj.laws.LinedBearing(LENGTH, LINER, 16, grooves=2) if film is None else film
    return sj.Lubricated(
        CLEARANCE,
        VISCOSITY,
        socket_radius=RADIUS,
        film=film,
        conformity=sj.laws.JohnsonCylinder(LENGTH),
        heat=heat,
        **options,
    )


@pytest.mark.slow
def test_a_run_ends_where_newton_finds_the_balance_of_load_and_heat():
    heat = sj.laws.BearingHeat(REYNOLDS, CAPACITY, 1.0)
    film = sj.laws.LinedBearing(LENGTH, LINER, 16, grooves=2)
    scene = sj.gallery.journal_bearing(model_of(heat, film, e_h0=0.0, e_h1=0.0), load=200.0)
    run = sj.simulate(scene, [0.0, 0.2, 0.4], rtol=1e-6)
    assert run.succeeded
    frame = np.asarray(run.system.spherical("bearing").frame)
    place = frame.T @ np.asarray(run.eccentricity("bearing")[-1])
    (action, _, told), _, warming = steady(film, heat, tuple(place[:2]))
    np.testing.assert_allclose(frame @ np.asarray(action.force), [0.0, 200.0, 0.0], atol=0.02)
    memory = run.memory("bearing")
    np.testing.assert_allclose([memory[f"oil_warming_{i}"][-1] for i in range(16)], warming, rtol=1e-4)
    power = float(run.part("bearing", "film_power")[-1] + run.part("bearing", "shear_power")[-1])
    lost = sum(float(run.part("bearing", f"heat_to_{where}")[-1]) for where in ("socket", "ball", "flow"))
    assert power == pytest.approx(lost, rel=1e-4)
    assert float(run.part("bearing", "hottest_oil")[-1]) == pytest.approx(float(told["hottest_oil"]), rel=1e-6)
    assert float(run.part("bearing", "oil_temperature")[-1]) < float(told["hottest_oil"]) - 2.0


def test_the_angle_of_grooves_is_that_in_the_bearing():
    """Grooves that are turned, with the load that turns as they do."""
    turned = sj.laws.LinedBearing(LENGTH, LINER, 16, grooves=1, groove_angle=0.7)
    straight = sj.laws.LinedBearing(LENGTH, LINER, 16, grooves=1)
    motion, _ = random_state(straight, 2)
    c, s = math.cos(0.7), math.sin(0.7)
    turn = jnp.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    other = motion._replace(e=turn @ motion.e, e_rate=turn @ motion.e_rate)
    np.testing.assert_allclose(turned.action(other, GAP).force, turn @ straight.action(motion, GAP).force, rtol=1e-9)


ROSS = {"load": 112814.9, "speed": 94.24778, "radius": 0.2, "length": 0.263144, "clearance": 1.94564e-4}
COLD_OF_ROSS, THIN, THINNER = 322.98333, 0.01901574, 0.007715233


@pytest.mark.parametrize(
    ("eps", "attitude", "load", "power", "inflow", "outflow"),
    [
        (0.25, 0.6435011, 28218.9, 10492.8, (5.08726e-4, 4.13564e-4), (3.70744e-4, 4.13564e-4)),
        (0.5409873, 0.8435665, 112696.5, 11675.3, (5.72512e-4, 2.93703e-4), (2.37277e-4, 2.93703e-4)),
    ],
)
def test_a_film_that_grooves_feed_has_load_power_and_flows_of_ross(eps, attitude, load, power, inflow, outflow):
    """Of one viscosity: its fixed_eccentricity and fixed_isoviscous, the lower pad first, where its journal stands."""
    gap = FilmGap(ROSS["clearance"], ROSS["radius"], THIN, 0.0, sj.Guembel())
    liner = sj.laws.WinklerLiner(2e13, 0.3, 1e-3)
    film = sj.laws.LinedBearing(ROSS["length"], liner, 32, 2, math.pi, math.radians(4.0))
    heat = sj.laws.BearingHeat(sj.laws.ReynoldsViscosity(0.0), CAPACITY)
    e = eps * gap.clearance * np.array([math.sin(attitude), -math.cos(attitude)])
    (action, _, _), _, _ = steady(film, heat, tuple(e), gap, ROSS["speed"])
    assert float(jnp.linalg.norm(action.force)) == pytest.approx(load, rel=0.015)
    assert float(action.pressure_power + action.shear_power) == pytest.approx(power, rel=0.011)
    flow = np.asarray(action.transport.forward)
    np.testing.assert_allclose(flow[[0, 16]], inflow, rtol=0.022)
    np.testing.assert_allclose(flow[[15, 31]], outflow, rtol=0.022)


def ross(heat, points, axial=1):
    """Its bearing with two grooves of 4 degrees across the load, loaded until it stays where it is."""
    film = sj.laws.LinedBearing(
        ROSS["length"], sj.laws.WinklerLiner(2e13, 0.3, 1e-3), points, 2, math.pi / 2, math.radians(4.0), axial
    )
    model = sj.Lubricated(
        ROSS["clearance"],
        THIN,
        socket_radius=ROSS["radius"],
        film=film,
        conformity=sj.laws.JohnsonCylinder(ROSS["length"]),
        heat=heat,
        e_h0=0.0,
        e_h1=0.0,
    )
    speed = ROSS["speed"]
    shaft = sj.Body(200.0, (1.0, 1.0, 1.0), angular_velocity=(0.0, 0.0, speed))
    joints = {
        "bearing": sj.Revolute(("ground", "shaft"), (0, 0, 0), (0, 0, 1), model),
        "motor": sj.RotationDriver(("ground", "shaft"), (0, 0, 1), sj.functions.Linear(speed)),
    }
    scene = sj.Scene({"shaft": shaft}, joints, gravity=(0, -ROSS["load"] / 200.0, 0))
    run = sj.simulate(scene, [0.0, 0.5, 1.0], rtol=1e-6)
    assert run.succeeded
    e = np.asarray(run.eccentricity("bearing"))[-1] / ROSS["clearance"]
    power = float(run.part("bearing", "film_power")[-1] + run.part("bearing", "shear_power")[-1])
    return run, np.hypot(*e[:2]), math.degrees(math.atan2(e[0], -e[1])), power


@pytest.mark.slow
@pytest.mark.parametrize(("points", "axial", "of_hottest"), [(32, 1, 0.04), (64, 1, 0.021), (32, 2, 0.04)])
def test_ross_has_the_same_bearing_within_two_percent(points, axial, of_hottest):
    """ROSS (github.com/petrobras/ross, tests/data/fluid_film/fixed_adiabatic.json): two pads of 176 degrees, a field of
    temperature without heat to the bodies, 80 % of the oil carried over at the grooves."""
    viscosity = sj.laws.ReynoldsViscosity(math.log(THIN / THINNER) / 30.0, COLD_OF_ROSS)
    heat = sj.laws.BearingHeat(
        viscosity, 854.9516 * 1951.5015, carry_over=0.8, inlet_temperature=323.0, start_temperature=336.0
    )
    run, eps, attitude, power = ross(heat, points, axial)
    assert eps == pytest.approx(0.61135, rel=0.01)
    assert attitude == pytest.approx(46.125, abs=0.5)
    assert float(run.part("bearing", "film_pressure")[-1]) == pytest.approx(2.80183e6, rel=0.0125)
    assert power == pytest.approx(8380.1, rel=0.008)
    rise = float(run.part("bearing", "oil_temperature")[-1]) - 323.0
    assert rise == pytest.approx(336.6145 - 323.0, rel=0.01)
    hottest = float(run.part("bearing", "hottest_oil")[-1]) - 323.0
    assert hottest == pytest.approx(
        344.4045 - 323.0, rel=of_hottest
    )  # in the middle of the length, at the end of its pad
    assert float(run.part("bearing", "heat_to_flow")[-1]) == pytest.approx(power, rel=1e-5)


@pytest.mark.slow
def test_every_number_has_its_derivative():
    """Of the mean temperature and the place after a while, forward against differences, by the film's numbers too."""
    heat = sj.laws.BearingHeat(REYNOLDS, CAPACITY, 2.0, 1.0, 0.7, 305.0, 310.0, 300.0, 315.0)
    film = sj.laws.LinedBearing(LENGTH, sj.laws.WinklerLiner(1e10, 0.4, 2e-3), 16, 2, 0.3, 0.1)
    leaves, tree = jax.tree.flatten((heat, film))
    start = jnp.array(leaves)

    def final(numbers):
        heat, film = jax.tree.unflatten(tree, list(numbers))
        stiff = sj.Hertz(stiffness=1e10)
        model = sj.Lubricated(CLEARANCE, VISCOSITY, socket_radius=RADIUS, film=film, heat=heat, normal=stiff)
        scene = sj.gallery.journal_bearing(model, load=200.0)
        run = sj.simulate(scene, [0.0, 0.03], rtol=1e-9)
        return jnp.stack([run.part("bearing", "oil_temperature")[-1], run.eccentricity("bearing")[-1, 0] / CLEARANCE])

    slopes = np.asarray(jax.jacfwd(final)(start)) * np.asarray(start)
    steps = 1e-4 * np.asarray(start)
    rows = np.asarray(start) + np.concatenate([np.diag(steps), -np.diag(steps)])
    values = np.asarray(jax.jit(jax.vmap(final))(jnp.asarray(rows)))
    n = start.size
    differences = ((values[:n] - values[n:]) / 2e-4).T
    np.testing.assert_allclose(slopes, differences, rtol=1e-4, atol=2e-4)
    assert (np.abs(slopes).max(0) > 1e-5).all()


# Limits, errors, files, cost


@pytest.mark.parametrize("grooves", [pytest.param(0, marks=pytest.mark.slow), 2])
def test_nothing_that_can_be_reached_is_not_a_number(grooves):
    film = sj.laws.LinedBearing(LENGTH, LINER, 16, grooves)
    model = model_of(sj.laws.BearingHeat(REYNOLDS, CAPACITY, 1.0, 1.0), film, friction=sj.Threlfall())

    @jax.jit
    @jax.vmap
    def answer(e, rate, spin, size, warmth):
        def of(model, e, rate, size):
            motion = RelativeMotion(
                jnp.array([1.0, 0.3, 0.0]) * e,
                jnp.array([-0.2, 1.0, 0.0]) * rate,
                jnp.eye(3),
                jnp.array([1.0, 0.0, 0.0, 0.0]),
                jnp.zeros(3),
                jnp.array([0.0, 0.0, 1.0]) * spin,
            )
            shape = jnp.cos(jnp.arange(16.0))
            memory = jnp.concatenate([jnp.where(e > CLEARANCE, 1e-3, 0.0)[None], size * shape, warmth * (2.0 + shape)])
            response = model.respond(motion, memory)
            return jnp.concatenate([response.force, response.ball_moment, response.memory_rate])

        return of(model, e, rate, size), jax.jacfwd(of, (0, 1, 2, 3))(model, e, rate, size)

    grid = jnp.meshgrid(
        jnp.array([0.0, 5e-5, 1e-4, 1.0]),
        jnp.array([0.0, 1.0]),
        jnp.array([-300.0, 0.0, 300.0]),
        jnp.array([0.0, 1e-6, 1e-2]),
        jnp.array([0.0, -100.0, 1e4]),
        indexing="ij",
    )
    found = answer(*(axis.ravel() for axis in grid))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))


@pytest.mark.parametrize(
    ("heat", "film", "said"),
    [
        ({"volume_capacity": 0.0}, {}, r"joint 'bearing'.*heat\.volume_capacity = 0 must be positive.*J/\(m\^3 K\)"),
        ({"carry_over": 1.2}, {}, r"heat\.carry_over = 1\.2 must lie in \[0, 1\]"),
        ({"ball_conductance": -1.0}, {}, r"heat\.ball_conductance = -1.*W/K"),
        ({"inlet_temperature": -3.0}, {}, r"heat\.inlet_temperature = -3.*\[K\]"),
        ({"viscosity": sj.laws.ReynoldsViscosity(-0.1)}, {}, r"heat\.ReynoldsViscosity\.coefficient = -0\.1"),
        ({}, {"grooves": 3}, r"grooves = 3 must be a divisor of points, or 0"),
        ({}, {"grooves": -1}, r"grooves = -1 must be"),
        ({}, {"groove_width": 0.5}, r"groove_width = 0\.5 must lie between 0 and the distance of two points, 0\.393"),
        ({}, {"groove_angle": math.inf}, r"groove_angle = inf must be finite"),
        ({}, None, r"film = 'ShortBearing' must be resolved round its bearing with heat=BearingHeat.*LinedBearing"),
    ],
)
def test_wrong_numbers_are_named(heat, film, said):
    heat = sj.laws.BearingHeat(**({"viscosity": REYNOLDS, "volume_capacity": CAPACITY} | heat))
    film = sj.laws.ShortBearing(LENGTH) if film is None else sj.laws.LinedBearing(LENGTH, LINER, 16, **film)
    with pytest.raises(sj.SceneError, match=said):
        sj.equations.compile_scene(sj.gallery.journal_bearing(model_of(heat, film)))


def test_a_film_without_grooves_is_said_before_the_run():
    for grooves, is_said in ((0, True), (1, False)):
        scene = sj.gallery.journal_bearing(model_of(film=sj.laws.LinedBearing(LENGTH, LINER, 16, grooves)))
        doubts = " ".join(doubts_of(scene, compile_scene(scene).system))
        assert ("joint 'bearing': heat=BearingHeat with film=LinedBearing(grooves=0)" in doubts) == is_said
        assert bool(doubts) == is_said


def test_files_have_units(tmp_path):
    path = tmp_path / "warm.toml"
    film = sj.laws.LinedBearing(LENGTH, LINER, 16, 2, 0.5, 0.05)
    heat = sj.laws.BearingHeat(REYNOLDS, 1.7e6, 2.0, socket_temperature=320.0)
    scene = sj.gallery.journal_bearing(model_of(heat, film))
    sj.save_scene(scene, path)
    assert eqx.tree_equal(sj.load_scene(path), scene)
    text = path.read_text()
    changed = text.replace("volume_capacity = 1700000.0", 'volume_capacity = "1.7 MJ/(m^3 K)"')
    changed = changed.replace("groove_angle = 0.5", 'groove_angle = "30 deg"')
    assert changed.count("MJ") == changed.count("deg") == 1
    path.write_text(changed)
    model = sj.load_scene(path).joints["bearing"].model
    assert model.heat.volume_capacity == pytest.approx(1.7e6)
    assert model.film.groove_angle == pytest.approx(math.pi / 6)


def test_effects_say_what_it_costs_and_one_temperature_has_none_of_it():
    def rows(heat, grooves):
        film = sj.laws.LinedBearing(LENGTH, LINER, 16, grooves)
        model = eqx.tree_at(lambda m: m.heat, model_of(film=film), heat, is_leaf=lambda leaf: leaf is None)
        return sj.effects(sj.gallery.journal_bearing(model), timed=False).rows

    cold, fed = rows(None, 0), rows(None, 2)
    warm = rows(sj.laws.BearingHeat(REYNOLDS, CAPACITY), 2)
    assert [row[1:-1] for row in warm[:-1]] == [row[1:-1] for row in fed]
    last, before = warm[-1], warm[-2]
    assert last.effect == "warm oil at 16 points (ReynoldsViscosity)"
    assert (last.n_states, last.n_memory) == (before.n_states + 16, before.n_memory + 16)
    assert 0 < last.n_operations - before.n_operations < 2200
    assert 0 < fed[-1].n_operations - cold[-1].n_operations < 700


def test_comparisons_keep_it():
    like = model_of()
    models = sj.joint_models(like)
    assert isinstance(models["lubricated"].heat, sj.laws.BearingHeat)
    assert models["lubricated"].film.grooves == 2

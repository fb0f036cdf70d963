"""The temperature of the oil as a state of a joint: closed forms, balances, limits, derivatives, files, cost."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import simpson, solve_bvp
from scipy.optimize import brentq
from scipy.special import lambertw

import spherejax as sj
from spherejax.physics.kinematics import RelativeMotion

RADIUS, LENGTH, CLEARANCE, VISCOSITY, SPEED = 0.02, 0.02, 1e-4, 0.1, 300.0
BETA, COLD = 0.03, 313.15
REYNOLDS = sj.laws.ReynoldsViscosity(BETA)
VOGEL = sj.laws.VogelViscosity(900.0 / (COLD - 170.0) ** 2, 170.0)

JOURNAL_POWER = 2 * math.pi * VISCOSITY * LENGTH * RADIUS**3 / CLEARANCE * SPEED**2
"""That a concentric journal puts into cold oil [W], by Petroff."""
BALL_POWER = 8 * math.pi * VISCOSITY * RADIUS**4 / (3 * CLEARANCE) * SPEED**2
"""That a concentric ball puts into cold oil [W]."""


def oil(**numbers):
    return sj.laws.OilHeat(REYNOLDS, **({"heat_capacity": 0.5} | numbers))


def bearing(heat, **options):
    return sj.Lubricated(
        CLEARANCE,
        VISCOSITY,
        socket_radius=RADIUS,
        film=sj.laws.ShortBearing(LENGTH),
        conformity=sj.laws.JohnsonCylinder(LENGTH),
        heat=heat,
        **options,
    )


def socket(heat, **options):
    return sj.Lubricated(CLEARANCE, VISCOSITY, socket_radius=RADIUS, heat=heat, **options)


def journal(heat, load=0.0, **options):
    """A shaft of 1 kg that turns at a given speed."""
    shaft = sj.Body(1.0, (1e-4, 1e-4, 1e-4), angular_velocity=(0.0, 0.0, SPEED))
    joints = {
        "bearing": sj.Revolute(("ground", "shaft"), (0, 0, 0), (0, 0, 1), bearing(heat, **options)),
        "motor": sj.RotationDriver(("ground", "shaft"), (0, 0, 1), sj.functions.Linear(SPEED)),
    }
    return sj.Scene({"shaft": shaft}, joints, gravity=(0.0, -load, 0.0))


def ball(heat, spin=(0.0, 0.0, SPEED), velocity=(0.0, 0.0, 0.0), **options):
    """A ball of 0.2 kg that spins freely in its socket."""
    body = sj.Body(0.2, (1e-3, 1e-3, 1e-3), velocity=velocity, angular_velocity=spin, points={"center": (0, 0, 0)})
    joint = sj.Spherical("ground.socket", "ball.center", socket(heat, **options), starts_concentric=False)
    return sj.Scene({"ball": body}, {"joint": joint}, gravity=(0, 0, 0), ground_points={"socket": (0, 0, 0)})


# Viscosities


def test_viscosities_are_their_formulas():
    for kelvins in (273.15, 300.0, COLD, 350.0, 420.0):
        assert float(REYNOLDS.ratio(kelvins)) == pytest.approx(math.exp(-BETA * (kelvins - COLD)), rel=1e-13)
        ratio = math.exp(900.0 / (kelvins - 170.0) - 900.0 / (COLD - 170.0))
        assert float(VOGEL.ratio(kelvins)) == pytest.approx(ratio, rel=1e-12)


@pytest.mark.parametrize(
    "law", [REYNOLDS, VOGEL, sj.laws.ReynoldsViscosity(0.0)], ids=["reynolds", "vogel", "constant"]
)
def test_viscosities_are_finite_at_any_temperature_and_fall(law):
    kelvins = jnp.concatenate([jnp.linspace(-1e4, 1e4, 4001), jnp.array([169.9, 170.0, 170.1, 1e6, 1e12])])
    values, slopes = jax.vmap(jax.value_and_grad(law.ratio))(kelvins)
    assert np.isfinite(values).all()
    assert np.isfinite(slopes).all()
    assert (np.asarray(slopes) <= 0).all()
    assert (np.asarray(values) >= 0).all()
    assert (np.diff(np.asarray(values)[:4001]) <= 0).all()
    by_numbers = jax.vmap(jax.grad(lambda law, kelvin: law.ratio(kelvin)), (None, 0))(law, kelvins)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(by_numbers))


# Runs against closed forms


@pytest.fixture(scope="module")
def steady():
    """The temperature of a concentric journal that has turned for long, and the moment of the film."""
    numbers = {"socket_conductance": 2.0, "ball_conductance": 1.0, "flow_capacity": 0.5}
    return sj.simulate(journal(oil(heat_capacity=0.1, **numbers)), [0.0, 0.5, 1.0], rtol=1e-7)


def warming(power, conductance):
    """beta (T - T_0) of the balance nu(T) power/nu_0 = G (T - T_0): x exp(x) = beta power/G."""
    return float(lambertw(BETA * power / conductance).real)


def test_a_steady_journal_has_the_temperature_and_the_couple_of_the_closed_form(steady):
    x = warming(JOURNAL_POWER, 3.5)
    assert x > 0.3
    assert float(steady.part("bearing", "oil_temperature")[-1]) == pytest.approx(COLD + x / BETA, rel=1e-9)
    couple = float(steady.part("bearing", "film_moment")[-1, 2])
    assert couple == pytest.approx(-JOURNAL_POWER * math.exp(-x) / SPEED, rel=1e-7)
    flows = [float(steady.part("bearing", f"heat_to_{where}")[-1]) for where in ("socket", "ball", "flow")]
    np.testing.assert_allclose(flows, np.array([2.0, 1.0, 0.5]) * x / BETA, rtol=1e-7)


@pytest.mark.slow
def test_heat_that_stays_in_the_oil_warms_it_by_a_logarithm():
    """C dT/dt = P exp(-beta (T - T_0))."""
    ts = np.array([0.0, 0.05, 0.2, 1.0])
    run = sj.simulate(journal(oil()), ts, rtol=1e-7)
    expected = np.log1p(BETA * JOURNAL_POWER / 0.5 * ts) / BETA
    assert expected[-1] > 50.0
    np.testing.assert_allclose(run.memory("bearing")["oil_warming"], expected, rtol=1e-7)


@pytest.mark.slow
def test_a_loaded_journal_finds_the_balance_of_load_and_heat():
    """Ocvirk's load and couple with the viscosity that their own power leaves, by root finding with SciPy."""
    load, conductance = 300.0, 4.0

    def force(eps, viscosity):
        wedge = viscosity * SPEED * RADIUS * LENGTH**3 / (4 * CLEARANCE**2)
        return wedge * eps / (1 - eps**2) ** 2 * math.sqrt(16 * eps**2 + math.pi**2 * (1 - eps**2))

    def power(kelvins):
        viscosity = VISCOSITY * math.exp(-BETA * (kelvins - COLD))
        eps = brentq(lambda eps: force(eps, viscosity) - load, 0.0, 0.999, xtol=1e-14)
        side = load * math.sin(math.atan2(math.pi * math.sqrt(1 - eps**2), 4 * eps))
        petroff = 2 * math.pi * viscosity * SPEED * LENGTH * RADIUS**3 / CLEARANCE / math.sqrt(1 - eps**2)
        return SPEED * (petroff + CLEARANCE * eps * side / 2), eps

    kelvins = brentq(lambda kelvins: power(kelvins)[0] - conductance * (kelvins - COLD), COLD, 500.0, xtol=1e-12)
    heat = oil(heat_capacity=0.1, socket_conductance=3.0, ball_conductance=1.0)
    run = sj.simulate(journal(heat, load, e_h0=0.0, e_h1=0.0), [0.0, 0.5, 1.0], rtol=1e-7)
    assert float(run.part("bearing", "oil_temperature")[-1]) == pytest.approx(kelvins, rel=1e-7)
    eps = float(jnp.linalg.norm(run.eccentricity("bearing")[-1])) / CLEARANCE
    assert 0.4 < eps < 0.9
    assert eps == pytest.approx(power(kelvins)[1], rel=1e-6)
    cold = brentq(lambda eps: force(eps, VISCOSITY) - load, 0.0, 0.999)
    assert eps > 1.1 * cold


def test_what_the_ball_loses_the_oil_has_or_gave_away():
    """Squeeze, wedge and shear of a ball that is let go off the center; its energy is all that there is."""
    heat = oil(heat_capacity=0.5, socket_conductance=3.0, ball_conductance=1.0, socket_temperature=300.0)
    ts = np.linspace(0.0, 1.0, 2001)
    run = sj.simulate(ball(heat, spin=(20.0, -40.0, 60.0), velocity=(0.2, 0.0, 0.1)), ts, rtol=1e-9)
    lost = float(run.mechanical_energy[0] - run.mechanical_energy[-1])
    assert float(jnp.max(jnp.linalg.norm(run.eccentricity("joint"), axis=1))) < CLEARANCE
    stored = 0.5 * float(run.memory("joint")["oil_warming"][-1])
    gone = [simpson(np.asarray(run.part("joint", f"heat_to_{where}")), x=ts) for where in ("socket", "ball")]
    assert lost > 2.0
    assert stored + sum(gone) == pytest.approx(lost, rel=1e-5)  # of Simpson's rule over the fast start
    adiabatic = sj.simulate(ball(oil(), spin=(20.0, -40.0, 60.0), velocity=(0.2, 0.0, 0.1)), ts[::100], rtol=1e-9)
    balance = adiabatic.mechanical_energy + 0.5 * adiabatic.memory("joint")["oil_warming"]
    np.testing.assert_allclose(balance, balance[0], rtol=1e-8)


def test_one_temperature_serves_as_far_as_is_said():
    """Nahme's exact solution across a gap between walls of one temperature, and the balance with 12 k A/h."""

    conductivity = 0.13

    def exact(nahme):
        s = math.sqrt(nahme / 8)
        return math.asinh(s) / (s * math.sqrt(1 + s * s))

    def numerical(nahme):
        """Of k T'' = -tau u', tau = nu u' with the gap, the speed and nu_0 as units: x = beta T, u, and tau."""
        solved = solve_bvp(
            lambda y, z, p: np.stack([z[1], -nahme * p[0] ** 2 * np.exp(z[0]), p[0] * np.exp(z[0])]),
            lambda a, b, p: np.array([a[0], b[0], a[2], b[2] - 1.0]),
            np.linspace(0, 1, 41),
            np.stack([np.zeros(41), np.zeros(41), np.linspace(0, 1, 41)]),
            p=[1.0],
            tol=1e-8,
        )
        assert solved.success
        return float(solved.p[0])

    for nahme, tolerance in ((0.5, 1e-3), (2.0, 0.006), (4.0, 0.02), (9.0, 0.05)):
        assert numerical(nahme) == pytest.approx(exact(nahme), rel=1e-6)
        gap, area, speed = 1e-4, 1e-3, 5.0
        beta = nahme * conductivity / (VISCOSITY * speed**2)
        heat = sj.laws.OilHeat(
            sj.laws.ReynoldsViscosity(beta),
            1.0,
            socket_conductance=6 * conductivity * area / gap,
            ball_conductance=6 * conductivity * area / gap,
        )

        def rate(kelvins, heat=heat, cold=VISCOSITY * speed**2 * area / gap):
            return float(heat.rate(kelvins, cold * heat.viscosity.ratio(kelvins)))

        ratio = float(heat.viscosity.ratio(brentq(rate, COLD, COLD + 1e4, xtol=1e-9)))
        assert ratio == pytest.approx(exact(nahme), rel=tolerance)
        assert abs(ratio / exact(nahme) - 1) > tolerance / 4  # the bound is no wider than it has to be


# Limits, derivatives, errors, files, cost


@pytest.mark.parametrize(("make", "law"), [(bearing, REYNOLDS), (socket, VOGEL)], ids=["journal", "ball"])
def test_nothing_that_can_be_reached_is_not_a_number(make, law):
    """At rest, centered, sliding, in dry contact; cold and as hot as may be; values and derivatives by all numbers."""
    model = make(sj.laws.OilHeat(law, 0.5, 1.0, 1.0, 1.0), friction=sj.Threlfall())

    @jax.jit
    @jax.vmap
    def answer(e, rate, spin, warmth):
        def of(model, e, rate, warmth):
            motion = RelativeMotion(
                jnp.array([1.0, 0.3, 0.0]) * e,
                jnp.array([-0.2, 1.0, 0.0]) * rate,
                jnp.eye(3),
                jnp.array([1.0, 0.0, 0.0, 0.0]),
                jnp.zeros(3),
                jnp.array([0.0, 0.0, 1.0]) * spin,
            )
            memory = jnp.stack([jnp.where(e > CLEARANCE, 1e-3, 0.0), warmth])
            response = model.respond(motion, memory)
            return jnp.concatenate([response.force, response.ball_moment, response.memory_rate])

        return of(model, e, rate, warmth), jax.jacfwd(of, (0, 1, 2, 3))(model, e, rate, warmth)

    grid = jnp.meshgrid(
        jnp.array([0.0, 5e-5, 9.5e-5, 9.6e-5, 9.65e-5, 1.2e-4]),
        jnp.array([0.0, 1e-3, 1.0]),
        jnp.array([0.0, 300.0]),
        jnp.array([-300.0, -100.0, 0.0, 50.0, 1e6]),
        indexing="ij",
    )
    found = answer(*(axis.ravel() for axis in grid))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))
    at = {name: np.asarray(axis.ravel()) for name, axis in zip(("e", "rate", "spin", "warmth"), grid, strict=True)}
    rates = np.asarray(found[0])[:, -1]
    unheated = (at["e"] > 1.03 * CLEARANCE) | ((at["rate"] == 0) & (at["spin"] == 0) & (at["e"] == 0))
    np.testing.assert_allclose(rates[unheated], -6.0 * at["warmth"][unheated], rtol=1e-12)
    heated = (at["warmth"] == 0) & (at["spin"] > 0) & (at["e"] < CLEARANCE)
    assert (rates[heated] > 0).all()


@pytest.mark.slow
def test_every_number_of_the_heat_has_its_derivative():
    """Of the temperature after a while, forward against differences, in each of its ten numbers."""
    heat = sj.laws.OilHeat(REYNOLDS, 0.5, 2.0, 1.0, 0.5, 305.0, 310.0, 300.0, 315.0)
    leaves, tree = jax.tree.flatten(heat)
    start = jnp.array(leaves)
    assert start.size == 10

    def final(numbers):
        scene = ball(jax.tree.unflatten(tree, list(numbers)), velocity=(0.2, 0.0, 0.1))
        return sj.simulate(scene, [0.0, 0.1], rtol=1e-9).part("joint", "oil_temperature")[-1]

    slopes = np.asarray(jax.jacfwd(final)(start))
    runs = jax.jit(jax.vmap(final))
    steps = 1e-4 * np.asarray(start)
    rows = np.asarray(start) + np.concatenate([np.diag(steps), -np.diag(steps)])
    values = np.asarray(runs(jnp.asarray(rows)))
    differences = (values[:10] - values[10:]) / (2 * steps)
    np.testing.assert_allclose(slopes * np.asarray(start), differences * np.asarray(start), rtol=2e-6, atol=2e-5)
    assert (np.abs(slopes * np.asarray(start)) > 1e-3).all()


@pytest.mark.parametrize(
    ("heat", "said"),
    [
        (lambda: oil(heat_capacity=0.0), r"joint 'joint'.*heat\.heat_capacity = 0 must be positive.*J/K"),
        (lambda: oil(socket_conductance=-1.0), r"heat\.socket_conductance = -1.*W/K"),
        (lambda: oil(flow_capacity=math.nan), r"heat\.flow_capacity = nan"),
        (lambda: oil(ball_temperature=-3.0), r"heat\.ball_temperature = -3.*\[K\]"),
        (
            lambda: sj.laws.OilHeat(sj.laws.ReynoldsViscosity(-0.1), 1.0),
            r"heat\.ReynoldsViscosity\.coefficient = -0\.1",
        ),
        (
            lambda: sj.laws.OilHeat(sj.laws.VogelViscosity(0.04, 320.0), 1.0),
            r"heat\.VogelViscosity\.reference_temperature = 313\.15 must be above pole_temperature = 320",
        ),
    ],
)
def test_wrong_numbers_are_named(heat, said):
    with pytest.raises(sj.SceneError, match=said):
        sj.equations.compile_scene(ball(heat()))


def test_a_file_gives_temperatures_in_degrees(tmp_path):
    path = tmp_path / "warm.toml"
    scene = ball(sj.laws.OilHeat(VOGEL, 0.5, 2.0, socket_temperature=320.0))
    sj.save_scene(scene, path)
    assert eqx.tree_equal(sj.load_scene(path), scene)
    text = path.read_text()
    changed = text.replace("socket_temperature = 320.0", 'socket_temperature = "60 degC"')
    changed = changed.replace("socket_conductance = 2.0", 'socket_conductance = "3000 mW/K"')
    assert changed.count("degC") == changed.count("mW/K") == 1
    path.write_text(changed)
    heat = sj.load_scene(path).joints["joint"].model.heat
    assert heat.socket_temperature == pytest.approx(333.15, abs=1e-9)
    assert heat.socket_conductance == pytest.approx(3.0)
    path.write_text(text.replace("heat_capacity = 0.5", 'heat_capacity = "20 degC"'))
    with pytest.raises(sj.SceneError, match=r"heat\.heat_capacity: '20 degC'"):
        sj.load_scene(path)


def test_effects_say_what_the_heat_costs_and_a_cold_film_has_none_of_it():
    warm, cold = (sj.effects(ball(heat), timed=False).rows for heat in (oil(socket_conductance=1.0), None))
    assert [row[1:-1] for row in warm[:-1]] == [row[1:-1] for row in cold]
    last, before = warm[-1], warm[-2]
    assert last.effect == "warm oil (ReynoldsViscosity)"
    assert (last.n_states, last.n_memory) == (before.n_states + 1, before.n_memory + 1)
    assert 0 < last.n_operations - before.n_operations < 60

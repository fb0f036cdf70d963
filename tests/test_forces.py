"""Force elements: what all of them must satisfy, exact solutions, kinks, bad input."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from elements import CONSERVATIVE, DAMPED, ELEMENTS, TWO_BODIED, advanced, answer, program, scene_with, states

import spherejax as sj
from spherejax.model.system import System, flatten_system
from spherejax.motion.solvers.automatic import choose_solver
from spherejax.motion.solvers.force_rates import force_rates

TIME, STEP = 0.7, 1e-5
ANSWERS = {name: program(answer(force)) for name, force in ELEMENTS.items()}


def rate_of_energy(name: str, y: np.ndarray, clock: float = 1.0) -> float:
    """Of the stored energy along the motion, by a difference of fourth order."""

    def energy(k):
        return float(ANSWERS[name](TIME + clock * k * STEP, advanced(y, k * STEP))["energy"])

    return (8 * (energy(1) - energy(-1)) - (energy(2) - energy(-2))) / (12 * STEP)


# What every element must satisfy -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TWO_BODIED)
def test_action_is_reaction(name):
    for y in states():
        wrenches = ANSWERS[name](TIME, y)["wrenches"]
        places = {"first": y[:3], "second": y[7:10]}
        force = sum(wrench.force for wrench in wrenches.values())
        moment = sum(wrench.moment + np.cross(places[body], wrench.force) for body, wrench in wrenches.items())
        size = max(1.0, *(np.abs(wrench).max() for wrench in wrenches.values()))
        assert np.abs(force).max() < 1e-13 * size
        assert np.abs(moment).max() < 1e-13 * size


@pytest.mark.parametrize("name", CONSERVATIVE)
def test_wrenches_derive_from_the_energy(name):
    """Virtual work: the power along each of the twelve directions is minus the rate of the energy."""
    acted = 0.0
    for y in states(3):
        for direction in range(12):
            y[14:] = np.eye(12)[direction]
            power = float(ANSWERS[name](TIME, y)["power"])
            acted = max(acted, abs(power))
            assert power == pytest.approx(-rate_of_energy(name, y, clock=0.0), rel=1e-7, abs=1e-6)
    assert acted > 0.1  # the states do reach what is tested


@pytest.mark.parametrize("name", [*CONSERVATIVE, *DAMPED])
def test_powers_are_in_balance(name):
    """What is stored and dissipated comes from the bodies and the road."""
    for y in states():
        now = ANSWERS[name](TIME, y)
        given = now["parts"].get("road_power", 0.0) - now["power"]
        dissipated = float(now["parts"].get("dissipated_power", 0.0))
        assert rate_of_energy(name, y) + dissipated == pytest.approx(given, rel=1e-7, abs=1e-5)
        assert dissipated >= 0


@pytest.mark.parametrize("name", DAMPED)
def test_dampers_dissipate_somewhere(name):
    assert max(ANSWERS[name](TIME, y)["parts"]["dissipated_power"] for y in states()) > 0.01


@pytest.mark.parametrize("name", ELEMENTS)
def test_scalar_program_is_the_array_code(name):
    in_arrays = answer(ELEMENTS[name])
    for y in states(2):
        expected = jax.tree.leaves(in_arrays(TIME, jnp.asarray(y)))
        for value, want in zip(jax.tree.leaves(ANSWERS[name](TIME, y)), expected, strict=True):
            np.testing.assert_allclose(value, want, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("name", ELEMENTS)
def test_slopes_by_state_and_numbers_are_finite(name):
    force = ELEMENTS[name]
    numbers, structure = jax.tree.flatten(force)

    def of_numbers(numbers, y):
        return answer(jax.tree.unflatten(structure, numbers))(jnp.asarray(TIME), y)["wrenches"]

    slopes = sj.scalarize(
        lambda numbers, y: jax.jacfwd(of_numbers, (0, 1))(numbers, y),
        [jnp.asarray(number, float) for number in numbers],
        jnp.zeros(26),
    )
    for y in states(2):
        assert all(np.isfinite(slope).all() for slope in jax.tree.leaves(slopes.compute(numbers, y)))


# Exact solutions -----------------------------------------------------------------------------------------------------

G, MASS, STIFFNESS, DAMPING = 9.81, 2.0, 80.0, 3.0
HEIGHT, STOP = 0.2, 2e4
TWIST, TORSION, INERTIA = 2.5, 30.0, 0.1
CHASSIS, SUSPENSION, TYRE, RADIUS = 300.0, 2e4, 2e5, 0.3
BOUNCE = np.sqrt(2 * G * HEIGHT)
RETURN = 2 * BOUNCE / G + 2 * (np.pi - np.arctan(BOUNCE * np.sqrt(STOP / MASS) / G)) / np.sqrt(STOP / MASS)
"""When a body that falls on a stop is back where it began: twice the fall, and the contact."""

TIMES = np.sort(np.append(np.linspace(0.0, 2.0, 21), RETURN))


def solved_scene() -> sj.Scene:
    """Bodies that know nothing of each other, but for a wheel and the chassis upon it."""
    tyre_height = RADIUS - (CHASSIS + MASS) * G / TYRE

    def body(x, z, mass=MASS, **others):
        return sj.Body(mass, [INERTIA] * 3, position=(x, 0.0, z), **others)

    vertical = (0.0, 0.0, 1.0)
    return sj.Scene(
        {
            "swinging": body(0.0, -1.2),
            "damped": body(1.0, -1.2),
            "falling": body(2.0, HEIGHT),
            "twisting": body(3.0, 0.0),
            "wheel": body(4.0, tyre_height),
            "chassis": body(4.0, tyre_height + 0.6 - CHASSIS * G / SUSPENSION, CHASSIS),
        },
        forces={
            "spring": sj.SpringDamper(("ground.a", "swinging"), STIFFNESS, free_length=1.0),
            "spring_damper": sj.SpringDamper(("ground.b", "damped"), STIFFNESS, DAMPING, 1.0),
            "stop": sj.BumpStop(("ground.c", "falling"), shortest=0.0, stiffness=STOP, direction=vertical),
            "torsion": sj.TorsionalSpring(("ground", "twisting"), (0.0, 3.0, 0.0), TORSION, free_angle=TWIST),
            "suspension": sj.SpringDamper(("wheel", "chassis"), SUSPENSION, 2e3, 0.6),
            "tyre": sj.Tyre("wheel", RADIUS, TYRE),
        },
        ground_points={"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0), "c": (2.0, 0.0, 0.0)},
    )


@pytest.fixture(scope="module")
def solved() -> sj.Trajectory:
    return sj.simulate(solved_scene(), ts=jnp.asarray(TIMES), rtol=1e-10, atol=1e-12).require_success()


def test_harmonic_oscillator(solved):
    rest, w = -1.0 - MASS * G / STIFFNESS, np.sqrt(STIFFNESS / MASS)
    exact = rest + (-1.2 - rest) * np.cos(w * TIMES)
    np.testing.assert_allclose(solved.position("swinging")[:, 2], exact, atol=1e-8)
    np.testing.assert_allclose(solved.force("spring")["length"], -exact, atol=1e-8)
    np.testing.assert_allclose(solved.force("spring")["force"], STIFFNESS * (-exact - 1.0), atol=1e-6)
    np.testing.assert_allclose(solved.force("spring")["potential_energy"], STIFFNESS / 2 * (exact + 1) ** 2, atol=1e-6)


def test_damped_decay(solved):
    rest, decay = -1.0 - MASS * G / STIFFNESS, DAMPING / (2 * MASS)
    w = np.sqrt(STIFFNESS / MASS - decay**2)
    turned = np.cos(w * TIMES) + decay / w * np.sin(w * TIMES)
    exact = rest + (-1.2 - rest) * np.exp(-decay * TIMES) * turned
    np.testing.assert_allclose(solved.position("damped")[:, 2], exact, atol=1e-8)
    rate = solved.force("spring_damper")["rate"]
    np.testing.assert_allclose(solved.force("spring_damper")["dissipated_power"], DAMPING * rate**2, rtol=1e-9)


def test_fall_on_a_stop_returns(solved):
    back = int(np.searchsorted(TIMES, RETURN))
    assert solved.position("falling")[back, 2] == pytest.approx(HEIGHT, abs=1e-7)
    assert solved.velocity("falling")[back, 2] == pytest.approx(0.0, abs=1e-6)


def test_torsional_pendulum_beyond_half_a_turn(solved):
    exact = TWIST * (1 - np.cos(np.sqrt(TORSION / INERTIA) * TIMES))
    assert exact.max() > 4.5
    np.testing.assert_allclose(solved.force("torsion")["angle"], exact, atol=1e-6)
    np.testing.assert_allclose(solved.force("torsion")["torque"], TORSION * (exact - TWIST), atol=1e-4)


def test_quarter_car_rests(solved):
    np.testing.assert_allclose(solved.position("wheel"), np.tile(solved.position("wheel")[0], (22, 1)), atol=1e-9)
    np.testing.assert_allclose(solved.acceleration("chassis"), 0.0, atol=1e-6)
    np.testing.assert_allclose(solved.force("tyre")["load"], (CHASSIS + MASS) * G, rtol=1e-9)
    np.testing.assert_allclose(solved.force("suspension")["force"], -CHASSIS * G, rtol=1e-9)


def test_energy_of_the_whole_is_lost_to_the_dampers(solved):
    lost = solved.mechanical_energy[0] - solved.mechanical_energy[-1]
    damped = solved.force("spring_damper")["potential_energy"] + MASS * (
        (solved.velocity("damped") ** 2).sum(1) / 2 + G * solved.position("damped")[:, 2]
    )
    assert lost == pytest.approx(float(damped[0] - damped[-1]), abs=1e-6)


def test_results_are_in_the_data_set(solved):
    data = solved.to_xarray()
    assert data["tyre.load"].dims == ("time",)
    assert data["tyre.load"].attrs["units"] == "N"
    np.testing.assert_allclose(data["spring.power"], solved.force("spring")["power"])
    with pytest.raises(sj.SceneError, match=r"no force element 'sprng'; the run has .*'spring'"):
        solved.force("sprng")


def hanging(stiffness) -> sj.Scene:
    spring = sj.SpringDamper(("ground.a", "ball"), stiffness, free_length=1.0)
    return sj.Scene(
        {"ball": sj.Body(MASS, [INERTIA] * 3, position=(0.0, 0.0, -1.2))},
        forces={"spring": spring},
        ground_points={"a": (0.0, 0.0, 0.0)},
    )


def test_stiffness_is_swept_and_differentiated():
    ts = jnp.linspace(0.0, 0.5, 3)

    def height(k):
        return sj.simulate(hanging(k), ts=ts, rtol=1e-9).position("ball")[-1, 2]

    def exact(k):
        rest = -1.0 - MASS * G / k
        return rest + (-1.2 - rest) * jnp.cos(jnp.sqrt(k / MASS) * ts[-1])

    ks = jnp.array([40.0, 80.0])
    heights, slopes = jax.vmap(lambda k: jax.jvp(height, (k,), (jnp.ones(()),)))(ks)
    np.testing.assert_allclose(heights, jax.vmap(exact)(ks), atol=1e-7)
    np.testing.assert_allclose(slopes, jax.vmap(jax.grad(exact))(ks), rtol=1e-5)


# Kinks ---------------------------------------------------------------------------------------------------------------


def slopes_at(force: sj.AbstractForce, y) -> dict:
    """Wrenches and their derivatives by the state."""
    of_state = answer(force)
    function = program(lambda t, y: (of_state(t, y), jax.jacfwd(lambda y: of_state(t, y)["wrenches"])(y)))
    value, slope = function(TIME, np.asarray(y))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((value, slope)))
    return {"value": value, "slope": slope}


def together(distance=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Both bodies in world axes, the second at a place, the first at rest at the origin."""
    turned = [1.0, 0.0, 0.0, 0.0]
    return np.concatenate([np.zeros(3), turned, distance, turned, np.zeros(6), velocity, np.zeros(3)])


CENTERS = ("first", "second")


def test_a_spring_without_free_length_is_smooth_where_its_ends_meet():
    found = slopes_at(sj.SpringDamper(CENTERS, 50.0), together())
    np.testing.assert_allclose(found["slope"]["second"].force[:, 7:10], -50.0 * np.eye(3), rtol=1e-12)
    np.testing.assert_array_equal(found["value"]["wrenches"]["second"].force, 0.0)


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.0), (1.0, 2.0, 3.0)])
def test_coinciding_ends_are_finite(velocity):
    spring = sj.SpringDamper(CENTERS, 50.0, 4.0, 0.3, spring=sj.Linear(2.0), damper=jnp.tanh)
    slopes_at(spring, together(velocity=velocity))
    slopes_at(sj.BumpStop(CENTERS, 0.1, 0.2, 1e3, 1.0, 0.01), together(velocity=velocity))


@pytest.mark.parametrize("onset", [0.0, 0.01])
def test_exactly_at_a_stop_nothing_acts(onset):
    for stop in (
        sj.BumpStop(CENTERS, longest=0.5, stiffness=1e3, onset=onset),
        sj.BumpStop(("ground", "second"), shortest=0.5, stiffness=1e3, onset=onset, direction=(0.0, 0.0, 1.0)),
        sj.Tyre("second", 0.5, 1e3, onset=onset),
    ):
        found = slopes_at(stop, together((0.0, 0.0, 0.5), (0.0, 0.0, 1.0)))
        assert not np.any(found["value"]["wrenches"]["second"].force)
        assert not np.any(found["slope"]["second"].force)


def test_a_stop_never_holds():
    stop = sj.BumpStop(CENTERS, longest=0.5, stiffness=1e3, damping=1e3, onset=0.001)
    assert slopes_at(stop, together((0.0, 0.0, 0.51), (0.0, 0.0, -1.0)))["value"]["parts"]["force"] == 0
    assert slopes_at(stop, together((0.0, 0.0, 0.51), (0.0, 0.0, 1.0)))["value"]["parts"]["force"] == pytest.approx(
        1009.5
    )


def test_onset_has_a_continuous_slope_and_energy():
    stop = sj.BumpStop(CENTERS, longest=0.5, stiffness=1e3, onset=0.02)
    for depth in (0.0, 0.02):
        before, after = (slopes_at(stop, together((0.0, 0.0, 0.5 + depth + side))) for side in (-1e-9, 1e-9))
        for found in (lambda x: x["slope"]["second"].force[2, 9], lambda x: x["value"]["energy"]):
            assert found(before) == pytest.approx(found(after), rel=1e-6, abs=1e-4)


def test_shock_absorber_at_rest_and_beyond_its_transition():
    absorber = sj.ShockAbsorber(CENTERS, sj.Linear(100.0), sj.Linear(300.0), transition=0.02)
    for rate, force in ((-0.5, -50.0), (-0.02, -2.0), (0.0, 0.0), (0.02, 6.0), (0.5, 150.0)):
        found = slopes_at(absorber, together((0.0, 0.0, 1.0), (0.0, 0.0, rate)))
        assert found["value"]["parts"]["force"] == pytest.approx(force, abs=1e-12)
    sharp = sj.ShockAbsorber(CENTERS, sj.Linear(100.0), sj.Linear(300.0), transition=0.0)
    assert slopes_at(sharp, together((0.0, 0.0, 1.0)))["value"]["parts"]["force"] == 0


def test_twist_tilted_by_pi_is_finite():
    y = together()
    spring = sj.TorsionalSpring(("ground", "second"), (0.0, 0.0, 1.0), 5.0, 1.0)
    start = np.asarray(scene_with(spring).bodies["second"].quaternion)
    y[10:14] = [-start[1], start[0], -start[3], start[2]]  # half a turn about x since the start, times the start
    y[20:] = np.arange(6)
    slopes_at(spring, y)


# The forces of a suspension ------------------------------------------------------------------------------------------


def test_leaf_spring_with_bump_stop():
    up = (0.0, 0.0, 1.0)
    leaf = sj.SpringDamper(("ground", "second"), 35900.0, free_length=-0.076, direction=up)
    stop = sj.BumpStop(("ground", "second"), longest=0.145, stiffness=1e7, direction=up)
    for u in (-0.05, 0.0, 0.1, 0.145, 0.146):
        y = together((0.3, 0.2, u))
        force = sum(slopes_at(element, y)["value"]["wrenches"]["second"].force for element in (leaf, stop))
        expected = 35900 * (0.076 + u) + 1e7 * max(0.0, u - 0.145)
        np.testing.assert_allclose(force, [0.0, 0.0, -expected], rtol=1e-9)


def test_tyre_over_the_bump():
    tyre = sj.Tyre("second", 0.36325, 460e3, road=sj.Bump(height=0.2, start=15.0, length=5.0), speed=5.0)
    at_time = program(answer(tyre))
    for t in (0.0, 3.2, 3.5, 4.5):
        found = at_time(t, together((0.0, -0.615, 0.5)))
        height = 0.1 * (1 - np.cos(2 * np.pi * (5 * t - 15) / 5)) if 3 < t < 4 else 0.0
        assert found["parts"]["road_height"] == pytest.approx(height, abs=1e-14)
        assert found["parts"]["load"] == pytest.approx(460e3 * max(0.0, 0.36325 - 0.5 + height), rel=1e-12)
        np.testing.assert_allclose(found["wrenches"]["second"].force, [0.0, 0.0, found["parts"]["load"]])


# Method and program --------------------------------------------------------------------------------------------------


def system_between(stiffness: float, damping: float, mass: float) -> System:
    """A light body on a spring below a heavy one, which hangs from another spring."""
    return sj.compile_scene(
        sj.Scene(
            {
                "heavy": sj.Body(50.0, [1.0] * 3, position=(0.0, 0.0, -1.0)),
                "light": sj.Body(mass, [1.0] * 3, position=(0.0, 0.0, -1.5)),
            },
            forces={
                "slow": sj.SpringDamper(("ground", "heavy"), 2e4, 100.0, 1.0),
                "fast": sj.SpringDamper(("heavy", "light"), stiffness, damping, 0.5),
            },
        )
    ).system


def test_rates_of_force_elements():
    system = system_between(1e7, 1e3, 0.1)
    structure, theta = flatten_system(system)
    rates = force_rates(system, structure, np.asarray(theta))
    assert rates.decay == pytest.approx(1e3 * (1 / 0.1 + 1 / 50), rel=1e-2)
    assert rates.frequency == pytest.approx(np.sqrt(1e7 * (1 / 0.1 + 1 / 50)), rel=1e-2)


@pytest.mark.parametrize(
    ("stiffness", "damping", "mass", "solver"),
    [
        (1e7, 1e3, 50.0, diffrax.Dopri8),  # a stop of a car is not stiff
        (1e7, 1e4, 0.1, sj.Rodas5P),  # decays at 1e5 per second
        (1e8, 300.0, 0.01, sj.Rodas5P),  # vibrates at 1e5 rad/s, and that decays
        (1e8, 0.0, 0.01, diffrax.Dopri8),  # vibrates at 1e5 rad/s for ever
    ],
)
def test_stiff_force_elements_get_a_stiff_method(stiffness, damping, mass, solver):
    choice = choose_solver(system_between(stiffness, damping, mass), 1e-8)
    assert isinstance(choice.solver, solver)
    assert "force elements act at about" in choice.reason


def test_a_law_without_scalar_program_runs_on_array_code():
    xs, ys = np.array([0.0, 1.0, 3.0]), np.array([-50.0, 0.0, 60.0])
    slow = hanging(0.0)
    forces = {"spring": sj.SpringDamper(("ground.a", "ball"), spring=lambda u: jnp.interp(u, xs, ys))}
    slow = sj.Scene(slow.bodies, forces=forces, ground_points=slow.ground_points)
    with pytest.warns(sj.ArrayPathWarning, match="state_rate runs as array code"):
        run = sj.simulate(slow, ts=jnp.linspace(0.0, 0.5, 3))
    fast = sj.Scene(
        slow.bodies,
        forces={"spring": sj.SpringDamper(("ground.a", "ball"), spring=sj.Table(xs, ys))},
        ground_points=slow.ground_points,
    )
    np.testing.assert_allclose(run.ys, sj.simulate(fast, ts=run.ts).ys, atol=1e-6)


# Bad input -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("force", "message"),
    [
        (lambda: sj.SpringDamper(CENTERS, -1.0), "force 'element': stiffness = -1 must be finite and not negative"),
        (lambda: sj.SpringDamper(CENTERS, 1.0, -2.0), "damping = -2"),
        (lambda: sj.SpringDamper(CENTERS, 1.0, free_length=np.nan), "free_length"),
        (lambda: sj.SpringDamper(("first.ear", "second"), 1.0), "body 'first' has no point 'ear'; it has 'eye'"),
        (lambda: sj.SpringDamper(("first", "third.eye"), 1.0), "there is no body 'third'"),
        (lambda: sj.SpringDamper(("first", "first.eye"), 1.0), "must lie on two bodies"),
        (lambda: sj.SpringDamper("first", 1.0), "must name two points"),  # pyright: ignore[reportArgumentType]
        (lambda: sj.SpringDamper(CENTERS, 1.0, direction=(0.0, 0.0, 0.0)), "direction = .* must be a direction"),
        (lambda: sj.SpringDamper(CENTERS, 1.0, direction=(0.0, 1.0)), "three numbers"),
        (lambda: sj.ShockAbsorber(CENTERS, jnp.sin, jnp.sin, transition=-1.0), "transition = -1"),
        (lambda: sj.BumpStop(CENTERS, 0.2, 0.1, 1e3), "longest = 0.1 must be above shortest"),
        (lambda: sj.BumpStop(CENTERS, 0.2, stiffness=1e3, damping=1.0), "onset = 0 must be positive with damping"),
        (lambda: sj.TorsionalSpring(("first", "first"), (0, 0, 1), 1.0), "bodies = .* must be two bodies"),
        (lambda: sj.TorsionalSpring(CENTERS, (0, 0, 0), 1.0), "axis = .* must be a direction"),
        (lambda: sj.Tyre("second", -0.3, 1e5), "radius = -0.3 must be positive"),
        (lambda: sj.Tyre("ground", 0.3, 1e5), "must be on a moving body"),
        (lambda: sj.Tyre("second", 0.3, 1e5, road=sj.Bump(0.1, 0.0, 0.0)), "road.length = 0"),
        (lambda: sj.Tyre("second", 0.3, 1e5, road=0.0), "road = 0.0 is no function"),  # pyright: ignore[reportArgumentType]
        (lambda: sj.AppliedWrench("second.ear"), "no point 'ear'"),
    ],
)
def test_bad_input_is_named(force, message):
    with pytest.raises(sj.SceneError, match=message):
        sj.compile_scene(scene_with(force()))


def test_missing_arguments_are_named():
    with pytest.raises(TypeError, match="shortest= or longest="):
        sj.BumpStop(CENTERS, stiffness=1e3)
    with pytest.raises(TypeError, match="compression= and extension="):
        sj.ShockAbsorber(CENTERS, None, jnp.sin)  # pyright: ignore[reportArgumentType]

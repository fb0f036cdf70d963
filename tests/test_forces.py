"""Force elements: what all of them must satisfy, exact solutions, the method that they get."""

from collections.abc import Callable
from functools import cache
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from elements import CONSERVATIVE, DAMPED, ELEMENTS, TWO_BODIED, advanced, answer, program, states

import spherejax as sj
from spherejax.foundations.rotation import rotation_matrix
from spherejax.model.system import System, flatten_system
from spherejax.motion.solvers.automatic import choose_solver
from spherejax.motion.solvers.force_rates import force_rates

TIME, STEP = 0.7, 1e-5


@cache
def answered(name: str) -> Callable[..., Any]:
    """An element's answer, as a program: made when it is first asked for, not by every worker that collects tests."""
    return program(answer(ELEMENTS[name]))


def rate_of_energy(name: str, y: np.ndarray, clock: float = 1.0) -> float:
    """Of the stored energy along the motion, by a difference of fourth order."""

    def energy(k):
        return float(answered(name)(TIME + clock * k * STEP, advanced(y, k * STEP))["energy"])

    return (8 * (energy(1) - energy(-1)) - (energy(2) - energy(-2))) / (12 * STEP)


# What every element must satisfy -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TWO_BODIED)
def test_action_is_reaction(name):
    for y in states():
        wrenches = answered(name)(TIME, y)["wrenches"]
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
            power = float(answered(name)(TIME, y)["power"])
            acted = max(acted, abs(power))
            assert power == pytest.approx(-rate_of_energy(name, y, clock=0.0), rel=1e-7, abs=1e-6)
    assert acted > 0.1  # the states do reach what is tested


@pytest.mark.parametrize("name", [*CONSERVATIVE, *DAMPED])
def test_powers_are_in_balance(name):
    """What is stored and dissipated comes from the bodies and the road."""
    for y in states():
        now = answered(name)(TIME, y)
        given = now["parts"].get("road_power", 0.0) - now["power"]
        dissipated = float(now["parts"].get("dissipated_power", 0.0))
        assert rate_of_energy(name, y) + dissipated == pytest.approx(given, rel=1e-7, abs=1e-5)
        assert dissipated >= 0


@pytest.mark.parametrize("name", DAMPED)
def test_dampers_dissipate_somewhere(name):
    assert max(answered(name)(TIME, y)["parts"]["dissipated_power"] for y in states()) > 0.01


@pytest.mark.parametrize("name", ELEMENTS)
def test_scalar_program_is_the_array_code(name):
    in_arrays = answer(ELEMENTS[name])
    for y in states(2):
        expected = jax.tree.leaves(in_arrays(TIME, jnp.asarray(y)))
        for value, want in zip(jax.tree.leaves(answered(name)(TIME, y)), expected, strict=True):
            np.testing.assert_allclose(value, want, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("name", ELEMENTS)
def test_slopes_by_state_and_numbers_are_finite(name):
    force = ELEMENTS[name]
    numbers, structure = jax.tree.flatten(force)

    def of_numbers(numbers, y):
        return answer(jax.tree.unflatten(structure, numbers))(jnp.asarray(TIME), y)["wrenches"]

    slopes = sj.compiler.scalarize(
        lambda numbers, y: jax.jacfwd(of_numbers, (0, 1))(numbers, y),
        [jnp.asarray(number, float) for number in numbers],
        jnp.zeros(26),
    )
    for y in states(2):
        assert all(np.isfinite(slope).all() for slope in jax.tree.leaves(slopes.compute(numbers, y)))


def test_laws_and_applied_forces_have_the_values_given():
    y = states(1)[0]
    rotation = np.asarray(rotation_matrix(jnp.asarray(y[10:14])))
    eye = rotation @ np.array([0.0, -0.1, 0.02])

    law = answered("law of three")(TIME, y)
    length, rate = law["parts"]["length"], law["parts"]["rate"]
    assert law["parts"]["force"] == pytest.approx(3 * length * np.sin(TIME) + rate**3)
    assert law["parts"]["dissipated_power"] == pytest.approx(-law["power"])
    first_eye = y[:3] + np.asarray(rotation_matrix(jnp.asarray(y[3:7]))) @ np.array([0.1, 0.0, 0.05])
    assert length == pytest.approx(np.linalg.norm(y[7:10] + eye - first_eye))

    cubic = answered("spring by a user's function")(TIME, y)["parts"]
    assert cubic["force"] == pytest.approx(3 * length + length**3)

    push = answered("push")(TIME, y)["wrenches"]["second"]
    np.testing.assert_array_equal(push.force, [1.0, 2.0, 3.0])
    arm = eye + rotation @ np.array([0.01, 0.02, 0.0])
    np.testing.assert_allclose(push.moment, np.cross(arm, push.force) + np.array([0.1, 0.0, 0.2]), rtol=1e-13)

    by_time = answered("push by time")(TIME, y)["wrenches"]["second"]
    np.testing.assert_allclose(by_time.force, rotation @ [np.sin(TIME), TIME, 0.0], rtol=1e-13)
    by_state = answered("push by state")(TIME, y)["wrenches"]["second"]
    np.testing.assert_allclose(by_state.moment, -TIME * y[17:20], rtol=1e-13)
    np.testing.assert_array_equal(by_state.force, 0.0)


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
            "stop": sj.forces.BumpStop(("ground.c", "falling"), shortest=0.0, stiffness=STOP, direction=vertical),
            "torsion": sj.TorsionalSpring(("ground", "twisting"), (0.0, 3.0, 0.0), TORSION, free_angle=TWIST),
            "suspension": sj.SpringDamper(("wheel", "chassis"), SUSPENSION, 2e3, 0.6),
            "tyre": sj.forces.Tyre("wheel", RADIUS, TYRE),
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

    ks = jnp.array([40.0, 80.0, -1.0])
    heights, slopes = jax.vmap(lambda k: jax.jvp(height, (k,), (jnp.ones(()),)))(ks)
    np.testing.assert_allclose(heights[:2], jax.vmap(exact)(ks[:2]), atol=1e-7)
    np.testing.assert_allclose(slopes[:2], jax.vmap(jax.grad(exact))(ks[:2]), rtol=1e-5)
    assert np.isnan(heights[2])  # a negative stiffness ends its own lane only


# Method and program --------------------------------------------------------------------------------------------------


def system_between(stiffness: float, damping: float, mass: float) -> System:
    """A light body on a spring below a heavy one, which hangs from another spring."""
    return sj.equations.compile_scene(
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
    free = force_rates(system, structure, np.asarray(theta), constrained=False)
    assert free == pytest.approx(rates)


def test_constraints_slow_force_elements_down():
    """A light body that is fixed to a heavy one is as slow as this; the choice looks twice."""
    bodies = {
        "heavy": sj.Body(50.0, [1.0] * 3, position=(0.0, 0.0, -1.0)),
        "light": sj.Body(1e-3, [1.0] * 3, position=(0.0, 0.0, -1.5)),
    }
    joints = {"weld": sj.Fixed(("heavy", "light"), (0.0, 0.0, -1.5))}
    forces = {"spring": sj.SpringDamper(("ground", "light"), 2e4, 1e3, 1.5)}
    system = sj.equations.compile_scene(sj.Scene(bodies, joints, forces)).system
    structure, theta = flatten_system(system)
    free, held = (force_rates(system, structure, np.asarray(theta), constrained) for constrained in (False, True))
    assert free.decay == pytest.approx(1e3 / 1e-3, rel=1e-2)
    assert held.decay == pytest.approx(1e3 / 50.001, rel=1e-2)
    assert isinstance(choose_solver(system).solver, diffrax.Dopri8)


@pytest.mark.parametrize(
    ("stiffness", "damping", "mass", "solver"),
    [
        (1e7, 1e3, 50.0, diffrax.Dopri8),  # a stop of a car is not stiff
        (1e7, 1e4, 0.1, sj.solvers.Rodas5P),  # decays at 1e5 per second
        (1e8, 300.0, 0.01, sj.solvers.Rodas5P),  # vibrates at 1e5 rad/s, and that decays
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
    with pytest.warns(sj.errors.ArrayPathWarning, match="state_rate runs as array code"):
        run = sj.simulate(slow, ts=jnp.linspace(0.0, 0.5, 3))
    fast = sj.Scene(
        slow.bodies,
        forces={"spring": sj.SpringDamper(("ground.a", "ball"), spring=sj.functions.Table(xs, ys))},
        ground_points=slow.ground_points,
    )
    same = sj.simulate(fast, ts=run.ts)
    np.testing.assert_allclose(run.ys[:, :13], same.ys, atol=1e-6)
    # Of a function nobody knows whether it adds energy: what it puts in is counted. Here it is a spring.
    energy = same.kinetic_energy + same.potential_energy - same.force("spring")["potential_energy"]
    np.testing.assert_allclose(run.supplied_work, energy - energy[0], rtol=1e-5)

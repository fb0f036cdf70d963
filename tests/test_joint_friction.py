"""Friction in ideal joints: against closed forms, an implicit equation solved by itself, energy; what is refused."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import displaced_state
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root

import spherejax as sj
from spherejax.model.system import flatten_system
from spherejax.motion.equations import dynamics
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import constrained_accelerations, constraint_set
from spherejax.motion.equations.loads import applied_wrenches, joint_loads
from spherejax.motion.equations.programs import program_for
from spherejax.motion.equations.quantities import quantity
from spherejax.motion.integration.problem import Parameters
from spherejax.motion.solvers.implicit import systems_of
from spherejax.motion.start.assembly import as_ideal, assemble_now
from spherejax.physics.state import unpack

MU, RADIUS, G = 0.1, 0.01, 9.81
SHARP = sj.Threlfall(mu=MU, v1=1e-5)  # Coulomb's law but for a few hundredths of a millimeter per second

PRESSURES = {"cosine": sj.laws.CosinePressure(), "uniform": sj.laws.UniformPressure(), "point": sj.laws.PointContact()}


def spinning_ball(model, spin=(0.0, 0.0, 5.0), gravity=-G, mass=0.2, inertia=1e-4) -> sj.Scene:
    """A ball that turns in a socket of the ground, about its own center."""
    ball = sj.Body(mass, (inertia,) * 3, angular_velocity=spin, points={"center": (0.0, 0.0, 0.0)})
    return sj.Scene(
        {"ball": ball},
        {"joint": sj.Spherical("ground.socket", "ball.center", model)},
        gravity=(0.0, 0.0, gravity),
        ground_points={"socket": (0.0, 0.0, 0.0)},
    )


def pendulum(model, angle=0.5 * np.pi, axis=(0.0, 1.0, 0.0), length=0.1) -> sj.Scene:
    """A pendulum that starts at an angle from its lowest place."""
    place = length * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    body = sj.Body(0.5, (1e-3, 2e-3, 1.5e-3), position=tuple(place))
    return sj.Scene({"bob": body}, {"pivot": sj.Revolute(("ground", "bob"), (0.0, 0.0, 0.0), axis, model)})


def chain(first, second) -> sj.Scene:
    """Two bodies that hang from each other by balls, in motion."""
    upper = sj.Body(
        0.8, (3e-4, 2.7e-3, 2.5e-3), position=(0.1, 0.0, 0.0), angular_velocity=(3.0, -1.0, 2.0),
        velocity=tuple(np.cross((3.0, -1.0, 2.0), (0.1, 0.0, 0.0))),
        points={"top": (-0.1, 0.0, 0.0), "end": (0.1, 0.02, 0.0)},
    )  # fmt: skip
    end_velocity = np.cross((3.0, -1.0, 2.0), (0.2, 0.02, 0.0))
    spin = np.array([-4.0, 2.0, 1.0])
    lower = sj.Body(
        0.5, (2e-4, 1.7e-3, 1.5e-3), position=(0.2, 0.02, -0.08), angular_velocity=tuple(spin),
        velocity=tuple(end_velocity + np.cross(spin, (0.0, 0.0, -0.08))),
        points={"top": (0.0, 0.0, 0.08)},
    )  # fmt: skip
    return sj.Scene(
        {"upper": upper, "lower": lower},
        {
            "shoulder": sj.Spherical("ground.hook", "upper.top", first),
            "elbow": sj.Spherical("upper.end", "lower.top", second),
        },
        ground_points={"hook": (0.0, 0.0, 0.0)},
    )


def sound(scene, ts, **options):
    run = sj.simulate(scene, jnp.asarray(ts), **options)
    assert run.succeeded, run.diagnosis
    return run


# The factors of the pressures ----------------------------------------------------------------------------------------


def test_factors_are_the_integrals_over_the_half_sphere():
    """Friction moment over mu R |F|, by quadrature of pressure times lever over the pressed half."""

    n = 400
    theta, phi = np.meshgrid((np.arange(n) + 0.5) / n * np.pi / 2, (np.arange(2 * n) + 0.5) / n * np.pi)
    area = np.sin(theta) * (np.pi / 2 / n) * (np.pi / n)
    about, across = np.sin(theta), np.sqrt(1 - (np.sin(theta) * np.cos(phi)) ** 2)  # distances from the two axes
    for law, pressure in ((sj.laws.CosinePressure(), np.cos(theta)), (sj.laws.UniformPressure(), np.ones_like(theta))):
        force = np.sum(pressure * np.cos(theta) * area)
        factors = [np.sum(pressure * lever * area) / force for lever in (across, about)]
        np.testing.assert_allclose((law.across, law.about), factors, rtol=1e-4)


@pytest.mark.parametrize("name", PRESSURES)
@pytest.mark.parametrize("direction", ["about", "across"])
def test_ball_under_weight_slows_down_as_its_pressure_says(name, direction):
    pressure = PRESSURES[name]
    spin = (0.0, 0.0, 5.0) if direction == "about" else (3.0, 4.0, 0.0)
    run = sound(spinning_ball(sj.Ideal(SHARP, RADIUS, pressure), spin), [0.0, 0.1])
    k = getattr(pressure, direction)
    left = 5.0 - MU * RADIUS * k * 0.2 * G / 1e-4 * 0.1
    np.testing.assert_allclose(run.angular_velocity("ball")[-1], np.array(spin) * left / 5.0, atol=1e-6)


def test_reaction_at_an_angle_turns_the_axis_of_rotation():
    """Across and about the reaction friction differs: a ball that turns obliquely gets a moment off its axis."""
    run = sound(spinning_ball(sj.Ideal(SHARP, RADIUS, sj.laws.PointContact()), (3.0, 0.0, 4.0)), [0.0])
    expected = -MU * RADIUS * 0.2 * G * np.array([0.6, 0.0, 0.0])
    np.testing.assert_allclose(run.part("joint", "friction_moment")[0], expected, atol=1e-9)


# Preload -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", [SHARP, sj.BrownMcPhee(0.1, 0.1, 1e-5), sj.LuGre(0.1, 0.1, 1e-4, 1e6, 300.0)])
def test_preload_stops_a_ball_when_its_momentum_is_spent(law):
    model = sj.Ideal(law, RADIUS, sj.laws.PreloadAlone(), preload=1e-3)
    run = sound(spinning_ball(model), [0.0, 0.25, 0.45, 0.55, 0.7])  # J w0 / M0 = 0.5 s
    spins = np.asarray(run.angular_velocity("ball"))[:, 2]
    np.testing.assert_allclose(spins, [5.0, 2.5, 0.5, 0.0, 0.0], atol=2e-3)
    np.testing.assert_allclose(run.part("joint", "bearing_load"), 0.2 * G)
    assert run.system.friction_passes == 0


def test_preload_and_reaction_add_up():
    model = sj.Ideal(SHARP, RADIUS, preload=1e-3)
    run = sound(spinning_ball(model), [0.0, 0.1])
    left = 5.0 - (MU * RADIUS * 0.2 * G + 1e-3) / 1e-4 * 0.1
    np.testing.assert_allclose(run.angular_velocity("ball")[-1, 2], left, atol=1e-6)


# Shafts, sliders, crosses --------------------------------------------------------------------------------------------


def test_pendulum_with_constant_friction_loses_the_same_angle_in_every_swing():
    """Small swings under a moment M0: 2 M0/(m g l) each half period, whatever the amplitude."""
    m, length, preload = 0.5, 0.1, 5e-4
    inertia = 2e-3 + m * length**2
    half = np.pi / np.sqrt(m * G * length / inertia)
    model = sj.Ideal(sj.Threlfall(0.1, 1e-7), 0.005, sj.laws.PreloadAlone(), preload=preload)
    run = sound(pendulum(model, 0.02), half * np.arange(6))
    angle = np.arctan2(np.asarray(run.position("bob"))[:, 0], -np.asarray(run.position("bob"))[:, 2])
    expected = 0.02 - 2 * preload / (m * G * length) * np.arange(6)
    np.testing.assert_allclose(np.abs(angle), expected, atol=2e-5)  # 0.02^3 of the sine, and the rounded corner


@pytest.mark.parametrize("radius", [0.01, 0.15])
def test_pendulum_agrees_with_its_implicit_equation_solved_by_itself(radius):
    """The bearing load holds the friction that it causes; a root finder at each instant, and another integrator."""
    m, length, v1 = 0.5, 0.1, 1e-2
    inertia, k = 2e-3 + m * length**2, 4 / np.pi

    def acceleration(angle, rate):
        def unbalance(a):
            pull = m * length * a + m * G * np.sin(angle)  # reaction along the swing
            hold = m * length * rate**2 + m * G * np.cos(angle)
            friction = MU * k * radius * np.hypot(pull, hold) * np.tanh(radius * rate / v1)
            return inertia * a + m * G * length * np.sin(angle) + friction

        return brentq(unbalance, -1e4, 1e4, xtol=1e-13, rtol=1e-14)

    ts = np.linspace(0.0, 1.0, 6)
    exact = solve_ivp(
        lambda t, y: [y[1], acceleration(*y)], (0, 1), [np.pi / 2, 0.0], t_eval=ts, rtol=1e-9, atol=1e-11
    ).y
    model = sj.Ideal(sj.Threlfall(MU, v1), radius, passes=10)
    run = sound(pendulum(model), ts, rtol=1e-9)
    np.testing.assert_allclose(run.angular_velocity("bob")[:, 1], -exact[1], atol=2e-6)
    assert 0 < np.max(run.part("pivot", "friction_contraction")) < MU * k * radius * m * length / inertia * 1.01


def dense_solution(system, y, joints):
    """Accelerations of the chain with friction, by a root finder on the equations written out in NumPy."""
    state = unpack(system.layout, jnp.asarray(y))
    names = list(system.bodies)
    position, velocity = {"ground": np.zeros(3)}, {"ground": np.zeros(3)}
    spin, turn = {"ground": np.zeros(3)}, {"ground": np.eye(3)}
    for i, name in enumerate(names):
        w, x, y_, z = np.asarray(state.quaternion[i])
        turn[name] = np.array([
            [1 - 2 * (y_**2 + z**2), 2 * (x * y_ - w * z), 2 * (x * z + w * y_)],
            [2 * (x * y_ + w * z), 1 - 2 * (x**2 + z**2), 2 * (y_ * z - w * x)],
            [2 * (x * z - w * y_), 2 * (y_ * z + w * x), 1 - 2 * (x**2 + y_**2)],
        ])  # fmt: skip
        position[name] = np.asarray(state.position[i])
        velocity[name], spin[name] = np.asarray(state.velocity[i]), np.asarray(state.angular_velocity[i])

    def unbalance(unknown):
        a, alpha = {"ground": np.zeros(3)}, {"ground": np.zeros(3)}
        for i, name in enumerate(names):
            a[name], alpha[name] = unknown[6 * i : 6 * i + 3], unknown[6 * i + 3 : 6 * i + 6]
        total, gaps = {}, []
        for name in names:
            mass, J = (
                float(system.bodies[name].mass),
                turn[name] * np.asarray(system.bodies[name].inertia) @ turn[name].T,
            )
            w = spin[name]
            total[name] = [mass * (a[name] - [0, 0, -G]), J @ alpha[name] + np.cross(w, J @ w)]
        for i, (name, law) in enumerate(joints.items()):
            placed, force = system.joints[name], unknown[12 + 3 * i : 15 + 3 * i]
            (one, two), arms = placed.bodies, []
            for body, place in zip(placed.bodies, placed.points, strict=True):
                arms.append(turn[body] @ np.asarray(place))
            spinning = spin[two] - spin[one]
            n = force / np.linalg.norm(force)
            rate = np.linalg.norm(spinning)
            K = law["across"] * (np.eye(3) - np.outer(n, n)) + law["about"] * np.outer(n, n)
            size = law["mu"] * np.tanh(law["radius"] * rate / law["v1"])
            M = -size * law["radius"] * np.linalg.norm(force) * K @ spinning / rate
            M = M - law["preload"] * size / law["mu"] * spinning / rate
            for body, arm, sign in ((one, arms[0], -1), (two, arms[1], 1)):
                if body != "ground":
                    total[body][0] = total[body][0] - sign * force
                    total[body][1] = total[body][1] - sign * (M + np.cross(arm, force))
            point = [
                a[body] + np.cross(alpha[body], arm) + np.cross(spin[body], np.cross(spin[body], arm))
                for body, arm in zip(placed.bodies, arms, strict=True)
            ]
            gaps.append(point[1] - point[0])
        return np.concatenate([*(np.concatenate(total[name]) for name in names), *gaps])

    found = root(unbalance, np.ones(18), tol=1e-13)
    assert np.max(np.abs(unbalance(found.x))) < 1e-9
    return found.x[:12].reshape(2, 6)


def test_two_joints_agree_with_newtons_method_on_all_equations():
    first = sj.Ideal(sj.Threlfall(0.2, 1e-2), 0.02, preload=0.01, passes=12)
    second = sj.Ideal(sj.Threlfall(0.3, 2e-2), 0.015, sj.laws.PointContact(), passes=3)
    scene = eqx.tree_at(lambda s: s.drift, chain(first, second), sj.solvers.NoDriftControl())
    system = sj.equations.compile_scene(scene).system
    start = np.asarray(assemble_now(*flatten_system(as_ideal(system))).y)
    names = list(system.bodies)
    expected = dense_solution(system, start, {
        "shoulder": dict(across=4 / np.pi, about=1.0, mu=0.2, radius=0.02, v1=1e-2, preload=0.01),
        "elbow": dict(across=1.0, about=0.0, mu=0.3, radius=0.015, v1=2e-2, preload=0.0),
    })  # fmt: skip
    found = dynamics.evaluate(system, jnp.zeros(()), jnp.asarray(start))
    scale = np.max(np.abs(expected))
    np.testing.assert_allclose(found.solution.accelerations, expected, atol=1e-9 * scale, err_msg=str(names))


def test_shaft_that_turns_and_slides_slows_down_along_its_velocity():
    """With J = m R^2 about the axis the surface's velocity (R w, s) keeps its direction."""
    m, k = 0.3, np.pi / 2
    body = sj.Body(m, (1e-3, 1e-3, m * RADIUS**2), velocity=(0.0, 0.0, 0.3), angular_velocity=(0.0, 0.0, 40.0))
    model = sj.Ideal(SHARP, RADIUS, sj.laws.UniformPressure(), preload_force=0.06)
    joint = sj.Cylindrical(("ground", "shaft"), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), model)
    scene = sj.Scene({"shaft": body}, {"bearing": joint}, gravity=(G, 0.0, 0.0))
    run = sound(scene, [0.0, 0.2])
    left = 0.5 - (MU * k * m * G + 0.06) / m * 0.2
    found = [RADIUS * float(run.angular_velocity("shaft")[-1, 2]), float(run.velocity("shaft")[-1, 2])]
    np.testing.assert_allclose(found, [0.8 * left, 0.6 * left], atol=1e-6)


@pytest.mark.slow
def test_slider_carries_its_tilt_and_its_twist():
    """A sledge whose guide is off its center of mass: weight, tilt about the guide's ends, twist at its radius."""
    m, offset, length, radius = 0.3, 0.02, 0.1, 0.015
    body = sj.Body(m, (1e-3,) * 3, velocity=(0.0, 0.0, 0.5))
    model = sj.Ideal(sj.Threlfall(0.05, 1e-5), radius, sj.laws.PointContact(), length=length, passes=8)
    joint = sj.Prismatic(("ground", "sledge"), (0.0, offset, 0.0), (0.0, 0.0, 1.0), model)
    run = sound(sj.Scene({"sledge": body}, {"guide": joint}, gravity=(G, 0.0, 0.0)), [0.0])
    # The weight twists the guide, friction tilts the sledge about its center of mass.
    expected = brentq(
        lambda N: 2 * np.hypot(m * G / 2, 0.05 * N * offset / length) + m * G * offset / radius - N, 0, 100, xtol=1e-12
    )
    np.testing.assert_allclose(run.part("guide", "bearing_load"), expected, rtol=1e-9)
    np.testing.assert_allclose(run.acceleration("sledge")[0, 2], -0.05 * expected / m, rtol=1e-6)


@pytest.mark.slow
def test_cross_rubs_at_both_pins():
    """Turning about one arm only that pin rubs; its load is what is across it."""
    for spin, across in (((2.0, 0.0, 0.0), np.hypot(3.0, 4.0)), ((0.0, 2.0, 0.0), np.hypot(1.0, 4.0))):
        body = sj.Body(1.0, (1e-2,) * 3, angular_velocity=spin)
        joint = sj.Universal(
            ("ground", "cross"), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), sj.Ideal(SHARP, RADIUS)
        )
        run = sound(sj.Scene({"cross": body}, {"joint": joint}, gravity=(1.0, 3.0, 4.0)), [0.0])
        expected = -MU * RADIUS * 4 / np.pi * across * np.array(spin) / 2
        np.testing.assert_allclose(run.part("joint", "friction_moment")[0], expected, atol=1e-9)


def test_bearing_of_a_length_carries_moments_at_its_ends():
    """A bob beside its bearing: the two ends carry m G (1/2 +- b/L), and more than the weight once b > L/2."""
    m, b, length = 0.5, 0.08, 0.05
    body = sj.Body(m, (1e-3,) * 3, position=(0.0, b, 0.0), angular_velocity=(0.0, 3.0, 0.0))
    model = sj.Ideal(SHARP, RADIUS, length=length)
    joint = sj.Revolute(("ground", "bob"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), model)
    run = sound(sj.Scene({"bob": body}, {"pivot": joint}), [0.0])
    np.testing.assert_allclose(run.part("pivot", "bearing_load"), m * G * 2 * b / length, rtol=1e-9)


# Energy, and what is shown -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", [sj.Threlfall(0.2, 1e-2), pytest.param(sj.LuGre(), marks=pytest.mark.slow)])
def test_what_is_lost_is_what_friction_has_taken(law):
    first, second = sj.Ideal(law, 0.02, preload=0.01), sj.Ideal(law, 0.015, sj.laws.UniformPressure())
    run = sound(chain(first, second), np.linspace(0.0, 0.2, 6), track_work=True, rtol=1e-9)
    lost = run.mechanical_energy[0] - run.mechanical_energy
    taken = run.dissipated_energy("shoulder") + run.dissipated_energy("elbow")
    np.testing.assert_allclose(lost, taken, atol=1e-6 * float(np.max(run.kinetic_energy)))
    assert lost[-1] > 0.02
    table = run.to_xarray()
    assert table["elbow.friction_moment"].attrs["units"] == "N m"
    assert table["elbow.friction_power"].attrs["units"] == "W"
    assert list(table.force_joint.values) == ["elbow", "shoulder"]
    assert np.all(table["shoulder.friction_power"] > -1e-9)


def test_reactions_hold_the_friction():
    run = sound(chain(sj.Ideal(SHARP, RADIUS), sj.Ideal()), [0.0, 0.01])
    moment = run.part("shoulder", "friction_moment")
    np.testing.assert_allclose(run.reaction_moment("shoulder"), moment, atol=1e-12)
    np.testing.assert_allclose(run.part("shoulder", "bearing_load"), np.linalg.norm(run.reaction("shoulder"), axis=1))
    power = -np.sum(np.asarray(moment) * np.asarray(run.angular_velocity("upper")), axis=1)
    np.testing.assert_allclose(run.part("shoulder", "friction_power"), power)
    assert quantity("shoulder.friction_moment", run.system).unit == "N m"


def test_bristles_hold_what_a_static_law_lets_creep():
    """A pendulum a little off its lowest place: LuGre's friction holds it there."""
    model = sj.Ideal(sj.LuGre(0.3, 0.4), 0.02)
    run = sound(pendulum(model, 0.02), [0.0, 0.5, 1.0])
    place = np.asarray(run.position("bob"))[:, 0]
    assert np.abs(place[2] - place[1]) < 1e-9
    assert np.abs(place[2] - place[0]) < 1e-5
    assert run.system.memory_slots[0].names == ("bristle_around",)


# What cannot be ------------------------------------------------------------------------------------------------------


def door(model) -> sj.Scene:
    """A door on two hinges: what each carries is not unique."""
    hinges = {
        name: sj.Revolute(("ground", "door"), (0.0, 0.0, z), (0.0, 0.0, 1.0), model)
        for name, z in (("lower_hinge", 0.2), ("upper_hinge", 1.8))
    }
    return sj.Scene({"door": sj.Body(20.0, (6.0, 8.0, 2.0), position=(0.4, 0.0, 1.0))}, hinges)


def plane_four_bar(model) -> sj.Scene:
    """Four revolute joints with parallel axes: in the plane all is unique, out of it nothing."""
    bodies = {
        "crank": sj.Body(0.2, (1e-4, 1e-4, 1e-4), position=(0.0, 0.0, 0.05)),
        "coupler": sj.Body(0.4, (1e-3, 1e-3, 1e-3), position=(0.1, 0.0, 0.1)),
        "rocker": sj.Body(0.2, (1e-4, 1e-4, 1e-4), position=(0.2, 0.0, 0.05)),
    }
    pins = {
        "a": (("ground", "crank"), (0.0, 0.0, 0.0)),
        "b": (("crank", "coupler"), (0.0, 0.0, 0.1)),
        "c": (("coupler", "rocker"), (0.2, 0.0, 0.1)),
        "d": (("ground", "rocker"), (0.2, 0.0, 0.0)),
    }
    joints = {name: sj.Revolute(pair, point, (0.0, 1.0, 0.0), model) for name, (pair, point) in pins.items()}
    return sj.Scene(bodies, joints, gravity=(2.0, 0.0, -9.0))


def test_loads_that_are_not_unique_are_refused_with_the_joints():
    model = sj.Ideal(sj.Threlfall(), RADIUS)
    with pytest.raises(sj.SceneError, match=r"'lower_hinge', 'upper_hinge' follows a load that is not unique.*bushing"):
        sj.simulate(door(model), jnp.linspace(0, 1, 3))
    with pytest.raises(sj.SceneError, match="'a', 'b', 'c', 'd' follows a load that is not unique"):
        sj.simulate(plane_four_bar(sj.Ideal(sj.Threlfall(), RADIUS, length=0.02)), jnp.linspace(0, 1, 3))


@pytest.mark.slow
def test_redundant_joints_whose_loads_are_unique_may_rub():
    """By the radial loads in a plane, and by preloads anywhere."""
    run = sound(plane_four_bar(sj.Ideal(sj.Threlfall(), RADIUS)), [0.0, 0.05], track_work=True)
    assert np.all([run.dissipated_energy(name)[-1] > 0 for name in "abcd"])
    sound(door(sj.Ideal(sj.Threlfall(), RADIUS, sj.laws.PreloadAlone(), preload=0.1)), [0.0, 0.05])


@pytest.mark.slow
def test_traced_numbers_are_judged_while_the_run_goes_on():
    def ended(mass):
        scene = door(sj.Ideal(sj.Threlfall(), RADIUS))
        scene = eqx.tree_at(lambda s: s.bodies["door"].mass, scene, mass)
        return sj.simulate(
            eqx.tree_at(lambda s: s.gravity, scene, np.array([0.0, 1.0, 0.0])), jnp.linspace(0, 1, 3)
        ).ended

    assert int(jax.jit(ended)(20.0)) == sj.Status.AUDIT_FAILED


def jamming(mu, speed=0.0, passes=4) -> sj.Scene:
    """A sledge whose guide is short and far from its center of mass: mu 2 h/L = 4 mu."""
    body = sj.Body(0.3, (1e-6,) * 3, velocity=(0.0, 0.0, speed))
    model = sj.Ideal(
        sj.Threlfall(mu, 1e-2), None, sj.laws.PointContact(), preload_force=0.1, length=0.05, passes=passes
    )
    guide = sj.Prismatic(("ground", "sledge"), (0.0, 0.1, 0.0), (0.0, 0.0, 1.0), model)
    return sj.Scene({"sledge": body}, {"guide": guide}, gravity=(0.0, 0.0, 1.0))


@pytest.mark.slow
def test_painleve_is_reported_with_the_joint():
    with pytest.raises(sj.SceneError, match=r"'guide' and its reaction enlarge each other.*leaves 1\.2.*Painleve"):
        sj.simulate(jamming(0.3, 1.0), jnp.linspace(0, 0.1, 3))
    with pytest.warns(sj.SimulationWarning, match=r"friction in joint 'guide' and its reaction enlarge each other"):
        run = sj.simulate(jamming(0.3, passes=20), jnp.linspace(0, 0.1, 3))
    assert run.status == sj.Status.AUDIT_FAILED
    assert run.t_reached < 0.05


def test_too_few_passes_are_reported():
    with pytest.raises(sj.SceneError, match=r"'guide' has not settled: 0\.0\d+ of the loads.*Raise passes="):
        sj.simulate(jamming(0.1, 1.0), jnp.linspace(0, 0.1, 3))
    sound(jamming(0.1, 1.0, passes=12), [0.0, 0.02])


@pytest.mark.parametrize(
    ("joint", "said"),
    [
        (lambda: sj.Spherical("ground.o", "body.o", sj.Ideal(sj.Threlfall())), r"joint 'j': radius.*must be given"),
        (lambda: sj.Spherical("ground.o", "body.o", sj.Ideal(radius=0.01)), r"radius = 0.01 must come with friction="),
        (
            lambda: sj.Spherical("ground.o", "body.o", sj.Ideal(sj.Threlfall(), 0.01, length=0.1)),
            "length = 0.1 must be left out",
        ),
        (
            lambda: sj.Spherical("ground.o", "body.o", sj.Ideal(sj.Threlfall(), 0.01, sj.laws.PreloadAlone())),
            "pressure = 'PreloadAlone' must come with a preload",
        ),
        (
            lambda: sj.Spherical("ground.o", "body.o", sj.Ideal(sj.Threlfall(0.0), 0.01, preload=1.0)),
            "preload = 1 must come with a friction law whose coefficient",
        ),
        (lambda: sj.Spherical("ground.o", "body.o", sj.Ideal(sj.Coulomb(), 0.01)), "Coulomb's jumps at zero sliding"),
        (
            lambda: sj.Spherical("ground.o", "body.o", sj.Ideal(sj.Threlfall(), -0.01)),
            "radius = -0.01 must be positive",
        ),
        (lambda: sj.Spherical("ground.o", "body.o", sj.Ideal(sj.Threlfall(), 0.01, passes=1)), "passes = 1 must be"),
        (
            lambda: sj.Prismatic(("ground", "body"), (0, 0, 0), (0, 0, 1), sj.Ideal(sj.Threlfall(), preload=1.0)),
            "preload = 1 must be left out. Give preload_force=",
        ),
        (
            lambda: sj.Revolute(
                ("ground", "body"), (0, 0, 0), (0, 0, 1), sj.Ideal(sj.Threlfall(), 0.1, preload_force=1.0)
            ),
            "preload_force = 1 must be left out. Give preload=",
        ),
        (
            lambda: sj.Fixed(("ground", "body"), (0, 0, 0), sj.Ideal(sj.Threlfall(), 0.1)),
            "friction = 'Threlfall' must be left out. Nothing moves",
        ),
    ],
)
def test_numbers_that_make_no_sense_are_named(joint, said):
    body = sj.Body(1.0, (1e-3,) * 3, points={"o": (0.0, 0.0, 0.0)})
    scene = sj.Scene({"body": body}, {"j": joint()}, ground_points={"o": (0.0, 0.0, 0.0)})
    with pytest.raises(sj.SceneError, match=said):
        sj.simulate(scene, jnp.linspace(0, 1, 3))


# Programs and derivatives --------------------------------------------------------------------------------------------

KINDS = {
    "ball": lambda model: sj.Spherical("a.p", "b.p", model),
    "revolute": lambda model: sj.Revolute(("a", "b"), (0.1, -0.2, 0.3), (1.0, 2.0, -0.5), model),
    "cylindrical": lambda model: sj.Cylindrical(("a", "b"), (0.1, -0.2, 0.3), (1.0, 2.0, -0.5), model),
    "prismatic": lambda model: sj.Prismatic(("a", "b"), (0.1, -0.2, 0.3), (1.0, 2.0, -0.5), model),
    "universal": lambda model: sj.Universal(("a", "b"), (0.1, -0.2, 0.3), (1.0, 2.0, -0.5), (2.0, -1.0, 0.0), model),
}


def model_for(kind, law) -> sj.Ideal:
    slides = kind in ("cylindrical", "prismatic")
    preload = {"preload_force": 0.5} if slides else {"preload": 0.02}
    return sj.Ideal(law, 0.01, sj.laws.UniformPressure(), **preload, length=None if kind == "ball" else 0.3)


def pair(kind, law, model=None) -> sj.Scene:
    """Two free bodies in general position, joined."""
    rng = np.random.default_rng(7)

    def body(position):
        quaternion = rng.normal(size=4)
        return sj.Body(
            1.0 + rng.random(), 0.02 + 0.01 * rng.random(3), position=position,
            quaternion=quaternion / np.linalg.norm(quaternion), velocity=0.3 * rng.normal(size=3),
            angular_velocity=rng.normal(size=3), points={"p": 0.2 * rng.normal(size=3)},
        )  # fmt: skip

    bodies = {"a": body((0.0, 0.1, 0.2)), "b": body((0.3, -0.2, 0.4))}
    return sj.Scene(bodies, {"joint": KINDS[kind](model_for(kind, law) if model is None else model)})


LAWS = {"threlfall": sj.Threlfall(0.2), "lugre": sj.LuGre()}
AT_REST_FAST = (("ball", "threlfall"),)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kind", KINDS)
def test_scalar_program_is_the_array_code_and_momentum_is_kept(kind, law):
    system = sj.equations.compile_scene(pair(kind, LAWS[law]), track_work=True).system
    structure, theta = flatten_system(system)
    y = displaced_state(system, assemble_now(*flatten_system(as_ideal(system))), 3, 0.0)
    scalar = np.asarray(program_for(dynamics.state_rate, structure, True)(theta, 0.0, jnp.asarray(y)))
    arrays = np.asarray(program_for(dynamics.state_rate, structure, False)(theta, 0.0, jnp.asarray(y)))
    np.testing.assert_allclose(scalar, arrays, atol=1e-10 * np.max(np.abs(arrays)))
    # Friction is between the two: with gravity alone the momentum about the common center does not change.
    found = dynamics.evaluate(system, jnp.zeros(()), jnp.asarray(y))
    ((name, friction),) = ((n, f) for n, f in dynamics.resistances(found.friction.groups).items())
    assert name == "joint"
    on_a, on_b = np.asarray(friction.wrenches)
    places = np.asarray(found.state.position)
    np.testing.assert_allclose(on_a[:3] + on_b[:3], 0, atol=1e-12)
    about_origin = on_a[3:] + on_b[3:] + np.cross(places[0], on_a[:3]) + np.cross(places[1], on_b[:3])
    np.testing.assert_allclose(about_origin, 0, atol=1e-12)
    assert np.linalg.norm(on_b) > 1e-4
    if law == "threlfall":
        assert friction.absorbed_power > 0


@pytest.mark.parametrize(
    ("kind", "law"),
    [
        pytest.param(kind, law, marks=[pytest.mark.slow] * ((kind, law) not in AT_REST_FAST))
        for kind in KINDS
        for law in LAWS
    ],
)
def test_derivatives_are_finite_at_rest_and_without_load(kind, law):
    system = sj.equations.compile_scene(eqx.tree_at(lambda s: s.gravity, pair(kind, LAWS[law]), np.zeros(3))).system
    structure, theta = flatten_system(system)
    y = np.zeros(system.layout.size)
    n_q = system.layout.n_position
    y[:n_q] = np.asarray(assemble_now(*flatten_system(as_ideal(system))).y)[:n_q]

    def rates(theta, y):
        return dynamics.state_rate(structure.system(theta), jnp.zeros(()), y)

    for slopes in (jax.jacfwd(rates, (0, 1)), jax.jacrev(rates, (0, 1))):
        assert all(np.all(np.isfinite(part)) for part in slopes(jnp.asarray(theta), jnp.asarray(y)))


@pytest.mark.slow
def test_derivatives_of_a_run_forward_reverse_and_by_differences():
    def end(numbers):
        mu, radius, preload = numbers
        model = sj.Ideal(sj.Threlfall(mu, 1e-2), radius, preload=preload)
        run = sj.simulate(chain(model, sj.Ideal(sj.Threlfall(mu, 1e-2), radius)), jnp.linspace(0, 0.2, 3), rtol=1e-10)
        return run.position("lower")[-1] @ jnp.array([1.0, 2.0, -1.0])

    numbers = jnp.array([0.2, 0.02, 0.01])
    forward, reverse = jax.jacfwd(end)(numbers), jax.grad(end)(numbers)
    steps = 1e-4 * numbers
    differences = [
        float(end(numbers.at[i].add(steps[i])) - end(numbers.at[i].add(-steps[i]))) / (2 * float(steps[i]))
        for i in range(3)
    ]
    np.testing.assert_allclose(forward, differences, rtol=2e-5)
    np.testing.assert_allclose(reverse, forward, rtol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("solver", [sj.solvers.Rodas5P(), sj.solvers.Ros34PW2()])
@pytest.mark.parametrize("law", LAWS)
def test_stiff_methods_find_the_same_motion(solver, law):
    scene = chain(sj.Ideal(LAWS[law], 0.02), sj.Ideal(LAWS[law], 0.02))
    ts = [0.0, 0.1]
    exact, found = sound(scene, ts, rtol=1e-10), sound(scene, ts, rtol=1e-7, solver=solver)
    np.testing.assert_allclose(found.position("lower"), exact.position("lower"), atol=1e-6)


@pytest.mark.parametrize("law", ["threlfall", pytest.param("lugre", marks=pytest.mark.slow)])
def test_linear_systems_of_stiff_methods_hold_the_friction(law):
    """(I - gamma h J) k = rhs in the mechanism's structure, against J by differentiation of the right-hand side.

    But for the row of the work of the constraint forces, on which nothing depends: it is left out of the matrix.
    """
    model = sj.Ideal(LAWS[law], 0.02, preload=0.01, passes=10)
    system = sj.equations.compile_scene(chain(model, model), track_work=True).system
    structure, theta = flatten_system(system)
    theta, t, gamma_h = jnp.asarray(theta), jnp.zeros(()), 1e-3
    y = jnp.asarray(displaced_state(system, assemble_now(*flatten_system(as_ideal(system))), 1, 0.0))
    rate = program_for(dynamics.state_rate, structure)
    systems = systems_of(structure)
    rhs = jnp.asarray(np.random.default_rng(1).normal(size=y.shape))
    at, _ = systems.jacobian(t, y, Parameters(theta, rate.ahead(theta)))
    k = np.asarray(systems.factorize(at, jnp.asarray(gamma_h))[0](rhs))
    J = np.asarray(jax.jacfwd(lambda y: rate(theta, t, y))(y))
    expected = np.linalg.solve(np.eye(len(y)) - gamma_h * J, rhs)
    rows = np.arange(len(y)) != system.layout.size - 1
    np.testing.assert_allclose(k[rows], expected[rows], atol=1e-7 * np.max(np.abs(expected)))


@pytest.mark.slow
def test_joints_of_all_sorts_remember_and_work_each_for_itself():
    """Bristles in an ideal joint beside those of a contact, and beside a bushing: memory and work by joint."""
    sticking = sj.Ideal(sj.LuGre(), 0.02, preload=0.01)
    scene = chain(sticking, sj.Dry(clearance=1e-3, friction=sj.LuGre()))
    system = sj.equations.compile_scene(scene).system
    assert [(slot.joint, len(slot.names)) for slot in system.memory_slots] == [("elbow", 4), ("shoulder", 3)]
    run = sound(scene, np.linspace(0.0, 0.05, 3), track_work=True)
    lost = run.mechanical_energy[0] - run.mechanical_energy
    taken = run.dissipated_energy("elbow") + run.dissipated_energy("shoulder")
    # What bristles of the contact gain as it is pressed harder is work of the joint, and not of the mechanism.
    np.testing.assert_allclose(lost, taken, atol=1e-5 * float(np.max(run.kinetic_energy)))


def test_bushing_and_friction_work_each_for_itself():
    rubber = sj.Bushing(law=sj.laws.VectorElastomer(1e5, 1e-3))
    swapped = sound(chain(rubber, sj.Ideal(sj.Threlfall(0.2, 1e-2), 0.02)), np.linspace(0.0, 0.05, 3), track_work=True)
    lost = swapped.mechanical_energy[0] - swapped.mechanical_energy
    taken = swapped.dissipated_energy("elbow") + swapped.dissipated_energy("shoulder")
    np.testing.assert_allclose(lost, taken, atol=1e-6 * float(np.max(swapped.kinetic_energy)))
    assert swapped.dissipated_energy("elbow")[-1] > 5e-4


def test_runs_side_by_side_and_on_array_code_are_those_by_themselves():
    ts = jnp.linspace(0, 0.1, 3)

    def end(mu, **options):
        model = sj.Ideal(sj.BrownMcPhee(mu, 1.5 * mu, 1e-2), RADIUS, sj.laws.UniformPressure(), preload=0.01)
        return sj.simulate(spinning_ball(model, (3.0, 0.0, 4.0), inertia=1e-3), ts, **options).ys[-1]

    mus = jnp.array([0.05, 0.1, 0.2])
    each = np.stack([end(mu) for mu in mus])
    np.testing.assert_allclose(jax.vmap(end)(mus), each, atol=1e-7)
    np.testing.assert_allclose(end(mus[2], scalar=False), each[2], atol=1e-7)


def test_stiff_friction_is_left_to_a_stiff_method():
    law = sj.Threlfall(MU, 1e-9)
    run = sound(spinning_ball(sj.Ideal(law, RADIUS), inertia=1e-6), [0.0, 0.05])
    assert "Rodas5P: friction in ideal joints" in run.choice
    assert "Dopri8: friction in ideal joints" in sound(spinning_ball(sj.Ideal(SHARP, RADIUS)), [0.0]).choice


@pytest.mark.parametrize("model", [sj.Ideal(), sj.Dry(clearance=1e-4, friction=sj.LuGre())])
def test_nothing_is_compiled_in_without_friction(model):
    """The right-hand side is what it is by bodies, loads and constraints alone, operation by operation."""
    system = sj.equations.compile_scene(sj.gallery.four_bar(model), track_work=True).system
    structure, theta = flatten_system(system)

    def plain(system, t, y):
        state = unpack(system.layout, y)
        motions = body_motions(system, state)
        loads = joint_loads(system, motions, state.memory)
        applied = applied_wrenches(system, t, motions, state.memory, loads)
        constraints = constraint_set(system, t, motions)
        solution = constrained_accelerations(system, motions, constraints, applied)
        turning = jax.vmap(dynamics._position_rate, (None, 0))(system.drift.norm_feedback, motions.moving)
        parts = [turning.ravel(), solution.accelerations.ravel(), loads.memory_rates]
        rates = [loads.absorbed_powers]
        if system.tracks_supply:
            zero = jnp.zeros(())
            rates.append(dynamics.supplied_power(system, t, motions, state.memory, loads, zero)[None])
        return jnp.concatenate([*parts, *rates])

    def text(function):
        y = jnp.zeros(system.layout.size)
        return str(jax.make_jaxpr(lambda theta, t, y: function(structure.system(theta), t, y))(theta, 0.0, y))

    assert text(dynamics.state_rate) == text(plain)
    rubbing = sj.equations.compile_scene(sj.gallery.four_bar(sj.Ideal(sj.Threlfall(), RADIUS)), track_work=True).system
    # The work that the joint absorbs, and that of the constraint forces, beside friction that dissipates.
    assert rubbing.layout.size == sj.equations.compile_scene(sj.gallery.four_bar()).system.layout.size + 2


# Files ---------------------------------------------------------------------------------------------------------------


def test_files_give_the_joint_back(tmp_path):
    model = sj.Ideal(sj.LuGre(), 0.012, sj.laws.UniformPressure(), preload=0.5, passes=5)
    path = tmp_path / "chain.toml"
    sj.save_scene(chain(model, sj.Ideal()), path)
    text = path.read_text()
    assert "passes = 5" in text
    assert text.count("pressure =") == 1
    read = sj.load_scene(path)
    assert jax.tree.all(jax.tree.map(lambda a, b: bool(np.all(a == b)), read.joints["shoulder"].model, model))
    assert jax.tree.structure(read.joints["shoulder"].model) == jax.tree.structure(model)
    path.write_text(text.replace("radius = 0.012", 'radius = "12 mm"').replace("preload = 0.5", 'preload = "500 N mm"'))
    again = sj.load_scene(path).joints["shoulder"].model
    np.testing.assert_allclose([again.radius, again.preload], [0.012, 0.5])
    path.write_text(text.replace("radius = 0.012", 'radius = "12 N"'))
    with pytest.raises(sj.SceneError, match="radius: '12 N' is a force"):
        sj.load_scene(path)


def test_friction_is_an_effect_with_a_price():
    table = sj.effects(sj.gallery.four_bar(sj.Ideal(sj.Threlfall(), RADIUS)), timed=False)
    assert [row.effect for row in table.rows] == ["ideal scene", "friction in the ideal joint (Threlfall; 4 passes)"]
    assert table.rows[1].n_operations > table.rows[0].n_operations

"""Angles about an axis through many turns, in everything that has one, against closed forms."""

import warnings

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.motion.integration.audit import CHECKS

Z = (0.0, 0.0, 1.0)
TS = np.linspace(0.0, 0.7, 8)


def wheel(forces, speed=40.0, inertia=1e-3):
    """A wheel on a hinge, without weight."""
    body = sj.Body(1.0, (inertia,) * 3, angular_velocity=(0.0, 0.0, speed))
    return sj.Scene({"w": body}, {"hinge": sj.Revolute(("ground", "w"), (0, 0, 0), Z)}, forces, gravity=(0, 0, 0))


def coil(stiffness=0.02, **more):
    return {"coil": sj.TorsionalSpring(("ground", "w"), Z, stiffness, **more)}


def oscillating(speed, t=TS):
    """Angle and rate of an oscillator that starts at its rest position."""
    w = np.sqrt(20.0)
    return speed / w * np.sin(w * t), speed * np.cos(w * t)


@pytest.mark.parametrize("speed", [40.0, -40.0, 400.0])
def test_a_torsional_spring_is_wound_up_by_any_number_of_turns(speed):
    run = sj.simulate(wheel(coil(), speed), TS, rtol=1e-9)
    angle, rate = oscillating(speed)
    np.testing.assert_allclose(run.angular_velocity("w")[:, 2], rate, atol=1e-6 * abs(speed))
    np.testing.assert_allclose(run.force("coil")["angle"], angle, atol=1e-6 * abs(speed))
    np.testing.assert_allclose(run.force("coil")["torque"], 0.02 * angle, atol=1e-7 * abs(speed))
    np.testing.assert_allclose(run.mechanical_energy, 5e-4 * speed**2, rtol=1e-6)
    np.testing.assert_allclose(run.memory("coil")["turned"], angle, atol=1e-6 * abs(speed))
    assert 0 <= run.stats.audit[CHECKS.index("turns")] < 1e-3


ROADS = {
    "stiff lane": {"solver": sj.solvers.Rodas5P()},
    "array code": {"scalar": False},
    "diffrax": {"adjoint": diffrax.RecursiveCheckpointAdjoint()},
    "diffrax, implicit": {"solver": diffrax.Kvaerno5(), "rtol": 1e-7},
}


@pytest.mark.parametrize("road", ROADS)
def test_turns_are_counted_on_every_road(road):
    run = sj.simulate(wheel(coil()), TS, **{"rtol": 1e-9, **ROADS[road]})
    np.testing.assert_allclose(run.angular_velocity("w")[:, 2], oscillating(40.0)[1], atol=2e-4)


def test_turns_are_counted_in_lanes_of_many_runs():
    speeds = np.array([-40.0, 20.0, 90.0])

    def made(speed):
        return wheel(coil(), speed)

    many = jax.jit(jax.vmap(lambda speed: sj.simulate(made(speed), TS, rtol=1e-9).angular_velocity("w")[:, 2]))(speeds)
    swept = sj.sweep(made, {"speed": speeds}, TS, rtol=1e-9, record=["coil.angle"], progress=False)
    for k, speed in enumerate(speeds):
        angle, rate = oscillating(speed)
        np.testing.assert_allclose(many[k], rate, atol=1e-4)
        np.testing.assert_allclose(swept["coil.angle"].isel(speed=k), angle, atol=1e-4)


def test_derivatives_go_through_turns():
    """Of the rate after two turns and back, by the stiffness: forward, in reverse, and as the closed form has it."""

    def last(k):
        return sj.simulate(wheel(coil(k)), TS, rtol=1e-10).angular_velocity("w")[-1, 2]

    def exact(k):
        return 40.0 * jnp.cos(jnp.sqrt(k / 1e-3) * TS[-1])

    expected = float(jax.grad(exact)(0.02))
    assert float(jax.jacfwd(last)(0.02)) == pytest.approx(expected, rel=1e-6)
    assert float(jax.grad(last)(0.02)) == pytest.approx(expected, rel=1e-6)
    assert (last(0.02 + 1e-5) - last(0.02 - 1e-5)) / 2e-5 == pytest.approx(expected, rel=1e-4)


def geared(ratio=3.0, speed=30.0, torque=0.01, stiffness=1e5, motor=None):
    """A pinion and a wheel that mesh outside, with a motor on the pinion."""
    r = 0.02
    pinion = sj.Body(1.0, (1e-3,) * 3, angular_velocity=(0, 0, speed))
    other = sj.Body(1.0, (9e-3,) * 3, position=(0.2, 0, 0), angular_velocity=(0, 0, -speed / ratio))
    joints = {
        "first": sj.Revolute(("ground", "pinion"), (0, 0, 0), Z),
        "second": sj.Revolute(("ground", "wheel"), (0.2, 0, 0), Z),
    }
    turns = sj.Turn(("ground", "pinion"), Z, r), sj.Turn(("ground", "wheel"), Z, ratio * r)
    forces = {
        "mesh": sj.forces.Coupler(*turns, ratio=-1.0, stiffness=stiffness),
        "motor": sj.Actuator(sj.Turn(("ground", "pinion"), Z), torque) if motor is None else motor,
    }
    return sj.Scene({"pinion": pinion, "wheel": other}, joints, forces, gravity=(0, 0, 0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_gears_turn_on_and_on(sign):
    """As one inertia J_1 + J_2/9 on the pinion; lag and position are lengths of any number of turns."""
    t = np.linspace(0.0, 4.0, 5)
    run = sj.simulate(geared(speed=sign * 30.0, torque=sign * 0.01), t, rtol=1e-9)
    angle = sign * (30.0 * t + 2.5 * t * t)
    np.testing.assert_allclose(run.force("motor")["position"], angle, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(run.angular_velocity("wheel")[:, 2], -(sign * 30.0 + sign * 5.0 * t) / 3.0, atol=5e-3)
    np.testing.assert_allclose(run.memory("mesh")["turned_2"], -angle / 3.0, atol=1e-3)
    assert np.abs(run.force("mesh")["lag"]).max() < 1e-5
    np.testing.assert_allclose(run.mechanical_energy, run.mechanical_energy[0] + run.supplied_work, rtol=1e-7)


def test_what_acts_along_a_turn_reads_all_of_it():
    turn = sj.Turn(("ground", "w"), Z)
    forces = {
        "motor": sj.Actuator(turn, 0.0),
        "samples": sj.forces.SampledActuator(turn, [0.0, 0.5], [0.0, 0.0]),
        "control": sj.PID(turn, 0.0, 0.0),
        "by rate": sj.PID(turn, 40.0, 0.0, of_rate=True),
        "digital": sj.forces.SampledPID(turn, 0.05, 0.0, 0.0),
    }
    run = sj.simulate(wheel(forces, -40.0), TS, rtol=1e-9)
    for name in forces:
        np.testing.assert_allclose(run.force(name)["position"], -40.0 * TS, atol=1e-5, err_msg=name)


def test_a_force_of_ones_own_with_a_turn_needs_to_know_nothing_of_it():
    class Brake(sj.forces.AbstractForce):
        """Holds a shaft more, the further it has turned."""

        turn: sj.Turn
        rising: float

        @property
        def body_names(self):
            return self.turn.body_names

        def placed(self, bodies, find):
            return Brake(self.turn.placed(bodies, find), self.rising)

        def wrenches(self, t, motions):
            return self.turn.wrenches(motions, -self.rising * self.turn.motion(motions).value)

    run = sj.simulate(wheel({"brake": Brake(sj.Turn(("ground", "w"), Z), 0.02)}), TS, rtol=1e-9)
    np.testing.assert_allclose(run.angular_velocity("w")[:, 2], oscillating(40.0)[1], atol=1e-5)


def test_errors_of_many_turns_do_not_add_up_to_another_turn():
    """A free rotor at a loose tolerance: its orientation goes astray, the count of its turns does not."""
    run = sj.simulate(wheel({"motor": sj.Actuator(sj.Turn(("ground", "w"), Z))}), [0.0, 400.0], rtol=1e-3)
    assert run.status == sj.Status.SUCCEEDED
    assert run.stats.audit[CHECKS.index("turns")] < 0.01


def test_a_joint_and_a_spring_of_its_name_both_have_entries_of_the_state():
    scene = wheel(coil())
    scene = sj.Scene(scene.bodies, {"coil": scene.joints["hinge"]}, scene.forces, gravity=(0, 0, 0))
    run = sj.simulate(scene, TS, rtol=1e-9)
    np.testing.assert_allclose(run.to_xarray()["coil.turned"], oscillating(40.0)[0], atol=1e-5)


def test_a_rest_position_is_found_beyond_half_a_turn():
    """A spring that pulls by 4 rad, against nothing."""
    scene = wheel(coil(free_angle=4.0), 0.0)
    found = sj.equilibrium(scene).scene
    run = sj.simulate(found, TS)
    np.testing.assert_allclose(run.force("coil")["angle"], 4.0, atol=1e-9)
    np.testing.assert_allclose(run.angular_velocity("w"), 0.0, atol=1e-9)


def test_how_often_a_wheel_has_turned_is_no_state_of_a_linearization():
    run = sj.simulate(wheel(coil()), TS, rtol=1e-9)
    linear = sj.linearize(run, t=0.35)
    assert not any("turned" in name for name in linear.states)
    np.testing.assert_allclose(np.abs(np.linalg.eigvals(linear.A)), np.sqrt(20.0), rtol=1e-6)


def test_a_tilt_by_half_a_turn_is_said():
    """A free body that tumbles across the axis that its spring is about."""
    body = sj.Body(1.0, (1e-3,) * 3, angular_velocity=(1.0, 0.0, 0.0))
    scene = sj.Scene({"w": body}, forces=coil(1e-6), gravity=(0, 0, 0))
    with pytest.warns(
        sj.errors.OutOfRangeWarning, match="^force element 'coil': the axis .* tilted by more than 170 degrees"
    ):
        run = sj.simulate(scene, [0.0, 3.1])
    assert run.status == sj.Status.SUCCEEDED
    assert "force element 'coil': the axis" in run.audit
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sj.simulate(scene, [0.0, 2.5])


def driven(stiffness=0.0):
    """A wheel in oil whose motor swells and ebbs four times a second, while it turns once."""
    w, c, J = 2 * np.pi, 1e-3, 1e-3
    turn = sj.Turn(("ground", "w"), Z)
    motor = sj.Actuator(turn, sj.functions.Sine(1e-3, 4.0, offset=c * w))
    oil = sj.TorsionalSpring(("ground", "w"), Z, stiffness, c)
    return wheel({"motor": motor, "oil": oil}, w, J)


def test_a_wheel_that_goes_round_has_a_cycle():
    """J rate' + c rate = c w + a sin: the multiplier is exp(-c T/J); how often it went round has none."""
    cycle = sj.steady_cycle(driven(), period=1.0)
    assert cycle.succeeded, cycle.diagnosis
    values = np.sort(np.abs(cycle.multipliers.values))
    np.testing.assert_allclose(values, [np.exp(-1.0), 1.0], rtol=1e-5)
    spent = cycle.run.force("motor")["position"]
    assert spent[-1] - spent[0] == pytest.approx(2 * np.pi, rel=1e-6)


def test_a_spring_that_is_wound_up_has_no_cycle():
    with pytest.warns(sj.errors.CycleWarning, match="a spring is wound up"):
        assert not sj.steady_cycle(driven(2e-8), period=1.0, settle=0).succeeded


def on_rubber(kind, speed, rotational):
    """A wheel on a bushing, which resists its turn by 0.02 N m/rad."""
    law = sj.laws.MatrixElastomer(np.diag([1e5] * 3), np.zeros((3, 3)), np.diag([*rotational, 0.02]))
    model = sj.Bushing(law=law)
    joints = {
        "revolute": sj.Revolute(("ground", "w"), (0, 0, 0), Z, model),
        "spherical": sj.Spherical("ground.eye", "w.eye", model),
    }
    body = sj.Body(1.0, (1e-3,) * 3, angular_velocity=(0, 0, speed), points={"eye": (0, 0, 0)})
    return sj.Scene({"w": body}, {"rubber": joints[kind]}, gravity=(0, 0, 0), ground_points={"eye": (0, 0, 0)})


@pytest.mark.parametrize("kind", ["revolute", "spherical"])
@pytest.mark.parametrize(("speed", "rotational"), [(20.0, (0.02, 0.02)), (-20.0, (0.5, 0.8))])
def test_rubber_is_twisted_beyond_half_a_turn(kind, speed, rotational):
    """By 256 degrees, and back: the moment does not jump."""
    run = sj.simulate(on_rubber(kind, speed, rotational), TS, rtol=1e-9)
    angle, rate = oscillating(speed)
    np.testing.assert_allclose(run.angular_velocity("w")[:, 2], rate, atol=1e-5)
    np.testing.assert_allclose(run.part("rubber", "rotation")[:, 2], angle, atol=1e-5)
    assert np.abs(angle).max() > 4.0


@pytest.mark.parametrize("kind", ["revolute", "spherical"])
def test_rubber_that_is_twisted_further_ends_the_run(kind):
    with pytest.warns(sj.SimulationWarning, match="more than three quarters of a turn.*joint 'rubber'"):
        run = sj.simulate(on_rubber(kind, 40.0, (0.02, 0.02)), TS)
    assert run.status == sj.Status.AUDIT_FAILED
    # What the message advises.
    law = sj.laws.HingeElastomer(np.diag([1e5] * 3), np.zeros((3, 3)), 0.02)
    scene = wheel(coil())
    scene = sj.Scene(
        scene.bodies,
        {"hinge": sj.Revolute(("ground", "w"), (0, 0, 0), Z, sj.Bushing(law=law))},
        coil(),
        gravity=(0, 0, 0),
    )
    run = sj.simulate(scene, TS, rtol=1e-9)
    np.testing.assert_allclose(run.angular_velocity("w")[:, 2], oscillating(40.0)[1], atol=1e-4)


def test_a_moment_is_continuous_through_half_a_turn():
    """Of a cylindrical bushing that is tilted besides: it jumped to its opposite."""
    law = sj.laws.MatrixElastomer.cylindrical(
        np.array(Z),
        radial_stiffness=1.0,
        axial_stiffness=1.0,
        conical_stiffness=5.0,
        torsional_stiffness=1.0,
        damping=0.0,
    )
    tilt = np.array([np.cos(0.05), np.sin(0.05), 0.0, 0.0])

    def moment(angle):
        c, s = np.cos(angle / 2), np.sin(angle / 2)
        q = np.array([c * tilt[0], c * tilt[1], s * tilt[1], s * tilt[0]])
        return np.asarray(law.moment(law.measure_of_rotation(jnp.asarray(q)), jnp.zeros(3)))

    before, after = moment(np.pi - 1e-7), moment(np.pi + 1e-7)
    np.testing.assert_allclose(before, after, atol=1e-5)
    assert np.abs(before[2]) > 1.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rubber_is_relaxed_by_the_shorter_way(sign):
    """Whatever the sign of the quaternion that says where it is."""
    q = sign * np.array([np.cos(0.15), 0.0, 0.0, np.sin(0.15)])
    law = sj.laws.MatrixElastomer(np.diag([1e5] * 3), np.zeros((3, 3)), np.eye(3))
    joint = sj.Revolute(("ground", "w"), (0, 0, 0), Z, sj.Bushing(law=law, relaxed_quaternion=q))
    body = sj.Body(1.0, (1e-3,) * 3)
    run = sj.simulate(sj.Scene({"w": body}, {"rubber": joint}, gravity=(0, 0, 0)), [0.0, 1e-4])
    assert run.part("rubber", "rotation")[0, 2] == pytest.approx(-0.3)


def test_the_sign_of_a_quaternion_says_which_way_round():
    """A scene that starts where another one has come to rest, 4 rad from where it was described."""
    q = np.array([np.cos(2.0), 0.0, 0.0, np.sin(2.0)])
    for sign, angle in ((1.0, 4.0), (-1.0, 4.0 - 2 * np.pi)):
        body = sj.Body(1.0, (1e-3,) * 3, quaternion=sign * q, reference_quaternion=(1, 0, 0, 0))
        run = sj.simulate(sj.Scene({"w": body}, wheel({}).joints, coil(), gravity=(0, 0, 0)), [0.0, 0.01])
        assert run.force("coil")["angle"][0] == pytest.approx(angle)

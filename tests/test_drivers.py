"""Prescribed motions: exact motions and efforts, power, methods that agree, derivatives, bad input."""

import cases
import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.foundations.rotation import rotation_matrix

Y, Z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
PAIR = ("ground", "arm")
DOPRI8 = diffrax.Dopri8()


def arm(**options):
    """An arm of 2 kg along x, its center 0.3 m from the origin."""
    points = {"end": (0.2, 0.0, 0.0), "pin": (-0.3, 0.0, 0.0)}
    return sj.Body(2.0, (0.02, 0.03, 0.025), position=(0.3, 0.0, 0.0), points=points, **options)


class Spin(eqx.Module):
    """Angle of a motor that swings while it turns."""

    rate: float
    swing: float

    def __call__(self, t):
        return self.rate * t + self.swing * jnp.sin(3.0 * t)


def path(t):
    return jnp.stack([0.5 + 0.1 * jnp.sin(5 * t), 0.2 * t, 0.1 * (1 - jnp.cos(4 * t))])


@pytest.fixture(scope="module")
def run():
    """Four arms, each driven in another way, in one scene."""
    slope = (0.6, 0.0, 0.8)
    joints = {
        "pivot": sj.Revolute(("ground", "turning"), "turning.pin", Y),
        "motor": sj.RotationDriver(("ground", "turning"), Y, Spin(40.0, 0.5)),
        "rail": sj.Prismatic(("ground", "sliding"), (0.3, 0.0, 0.0), slope),
        "push": sj.TranslationDriver(("ground", "sliding"), "sliding.end", slope, sj.functions.Sine(0.1, 2.0)),
        "hinge": sj.Revolute(("ground", "lifted"), "lifted.pin", Y),
        "jack": sj.joints.DistanceDriver("ground.peg", "lifted.end", lambda t: 0.6 + 0.15 * jnp.sin(4 * t)),
        "hand": sj.joints.PositionDriver("led.end", path),
    }
    bodies = {name: arm() for name in ("turning", "sliding", "lifted", "led")}
    scene = sj.Scene(bodies, joints, ground_points={"peg": (0.0, 0.0, 0.6)}, drift=sj.solvers.Projection())
    return sj.simulate(scene, cases.times(2.0, 201), rtol=1e-9, solver=DOPRI8).require_success()


def test_all_hold(run):
    assert np.asarray(run.constraint_violation).max() < 1e-12
    assert np.asarray(run.velocity_violation).max() < 1e-11


def test_motor_turns_many_times_and_reports_its_torque(run):
    t = np.asarray(run.ts)
    angle, rate, acceleration = 40 * t + 0.5 * np.sin(3 * t), 40 + 1.5 * np.cos(3 * t), -4.5 * np.sin(3 * t)
    assert angle[-1] > 12 * 2 * np.pi
    place = 0.3 * np.stack([np.cos(angle), 0 * t, -np.sin(angle)], 1)
    assert np.asarray(run.position("turning")) == pytest.approx(place, abs=1e-12)
    torque = (0.03 + 2.0 * 0.3**2) * acceleration - 2.0 * 9.81 * 0.3 * np.cos(angle)
    assert np.asarray(run.driving_effort("motor")) == pytest.approx(torque, abs=1e-8)
    assert np.asarray(run.driving_power("motor")) == pytest.approx(torque * rate, abs=1e-6)
    # What the motor exerts is a moment about the axis and no force.
    assert np.asarray(run.reaction("motor")) == pytest.approx(np.zeros((201, 3)), abs=1e-12)
    assert np.asarray(run.reaction_moment("motor"))[:, 1] == pytest.approx(torque, abs=1e-8)


def test_translation_and_its_force(run):
    t, w = np.asarray(run.ts), 4 * np.pi
    s = 0.1 * np.sin(w * t)
    place = np.array([0.3, 0, 0]) + np.outer(s, [0.6, 0, 0.8])
    assert np.asarray(run.position("sliding")) == pytest.approx(place, abs=1e-12)
    force = 2.0 * (-w * w * s + 9.81 * 0.8)
    assert np.asarray(run.driving_effort("push")) == pytest.approx(force, abs=1e-8)
    assert np.asarray(run.driving_power("push")) == pytest.approx(force * 0.1 * w * np.cos(w * t), abs=1e-8)


def test_length_of_a_jack(run):
    """A jack from a peg above holds the arm's end: the angle follows from the triangle."""
    length = 0.6 + 0.15 * np.sin(4 * np.asarray(run.ts))
    up = np.arccos((0.25 + 0.36 - length**2) / (2 * 0.5 * 0.6))  # the arm's angle from the line to the peg
    place = 0.3 * np.stack([np.sin(up), 0 * up, np.cos(up)], 1)
    assert np.asarray(run.position("lifted")) == pytest.approx(place, abs=1e-9)


def test_work_of_the_drivers_is_the_change_of_energy(run):
    power = np.sum([run.driving_power(name) for name in ("motor", "push", "jack", "hand")], 0)
    work = np.concatenate([[0.0], np.cumsum((power[:-2:2] + 4 * power[1:-1:2] + power[2::2]) * 0.01 / 3)])
    energy = np.asarray(run.mechanical_energy)[::2]
    assert np.ptp(work) > 10.0
    assert energy - energy[0] == pytest.approx(work, abs=2e-3 * np.ptp(work))


def test_a_driven_point_follows_its_path(run):
    rotations = jax.vmap(rotation_matrix)(run.quaternion("led"))
    ends = np.asarray(run.position("led")) + np.asarray(rotations) @ np.array([0.2, 0.0, 0.0])
    assert ends == pytest.approx(np.asarray(jax.vmap(path)(run.ts)), abs=1e-12)
    force = 2.0 * (np.asarray(run.acceleration("led")) + np.array([0.0, 0.0, 9.81]))
    assert np.asarray(run.driving_effort("hand")) == pytest.approx(force, abs=1e-9)
    assert np.asarray(run.reaction("hand")) == pytest.approx(force, abs=1e-9)


@pytest.mark.parametrize("start", [0.5, 2.0, -3.0, 40.0])
def test_start_is_assembled_to_the_driver(start):
    """From any angle to the driven one, on the right branch, with the driven velocity."""
    joints = {
        "pivot": sj.Revolute(PAIR, "arm.pin", Y),
        "motor": sj.RotationDriver(PAIR, Y, sj.functions.Linear(2.0, start)),
    }
    scene = sj.Scene({"arm": arm()}, joints)
    assembly = sj.simulate(scene, jnp.array([0.25]), solver=DOPRI8).assembly  # the start is at the first sample
    angle = start + 0.5
    assert np.asarray(assembly.y[:3]) == pytest.approx([0.3 * np.cos(angle), 0.0, -0.3 * np.sin(angle)], abs=1e-9)
    assert np.asarray(assembly.y[10:13]) == pytest.approx([0.0, 2.0, 0.0], abs=1e-9)
    assert float(assembly.residual_after) < 1e-9


def test_baumgarte_holds_a_driven_motion():
    """Feedback knows the driven velocity: D v + Phi_t, not D v."""
    joints = {"pivot": sj.Revolute(PAIR, "arm.pin", Y), "motor": sj.RotationDriver(PAIR, Y, sj.functions.Linear(20.0))}
    scene = sj.Scene({"arm": arm()}, joints)
    run = sj.simulate(scene, cases.times(1.0, 5), rtol=1e-8, solver=DOPRI8).require_success()
    assert np.asarray(run.velocity_violation).max() < 1e-5
    assert np.asarray(run.constraint_violation).max() < 1e-6


# A motor, and a rod on a rubber bushing ------------------------------------------------------------------------------


def crank_and_rod(speed=30.0, stiffness=2e5):
    """A motor turns a crank; a rod hangs on its pin by a bushing and slides on a plane."""
    rubber = sj.laws.HingeElastomer.symmetric(
        radial_stiffness=stiffness, axial_stiffness=stiffness, conical_stiffness=50.0, damping=1e-4
    )
    points = {"pin": (-0.1, 0, 0), "eye": (0.1, 0, 0)}
    bodies = {
        "crank": sj.Body(0.2, (1e-4, 1e-4, 1e-4), points={"pin": (0.05, 0.0, 0.0)}),
        "rod": sj.Body(0.3, (1e-4, 2e-3, 2e-3), position=(0.15, 0, 0), points=points),
    }
    joints = {
        "shaft": sj.Revolute(("ground", "crank"), (0.0, 0.0, 0.0), Y),
        "motor": sj.RotationDriver(("ground", "crank"), Y, Spin(speed, 0.2)),
        "pin": sj.Revolute(("crank", "rod"), "crank.pin", Y, sj.Bushing(law=rubber)),
        "table": sj.joints.PointOnPlane("rod.eye", (0.0, 0.0, 0.0), Z),
    }
    return sj.Scene(bodies, joints)


TS = cases.times(0.1, 5)


@pytest.fixture(scope="module")
def reference():
    return sj.simulate(crank_and_rod(), TS, rtol=1e-10, solver=DOPRI8).require_success()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "rtol", "agreement"),
    [(sj.solvers.Rodas5P(), 1e-8, 1e-7), pytest.param(sj.solvers.Ros34PW2(), 1e-6, 1e-5, marks=pytest.mark.slow)],
    ids=["Rodas5P", "Ros34PW2"],
)
def test_methods_agree_on_a_driven_mechanism_with_a_bushing(reference, solver, rtol, agreement):
    run = sj.simulate(crank_and_rod(), TS, rtol=rtol, solver=solver).require_success()
    place = np.asarray(reference.position("rod"))
    assert np.ptp(place[:, 0]) > 0.05
    assert np.asarray(run.position("rod")) == pytest.approx(place, abs=agreement)
    assert np.asarray(run.driving_effort("motor")) == pytest.approx(
        np.asarray(reference.driving_effort("motor")), abs=1e4 * agreement
    )


@pytest.mark.slow
def test_array_code_moves_alike(reference):
    run = sj.simulate(crank_and_rod(), TS[:2], rtol=1e-10, solver=DOPRI8, scalar=False).require_success()
    assert np.asarray(run.ys) == pytest.approx(np.asarray(reference.ys[:2]), abs=1e-7)
    torque = np.asarray(reference.driving_effort("motor")[:2])
    assert np.asarray(run.driving_effort("motor")) == pytest.approx(torque, abs=1e-4)


@pytest.mark.slow
def test_derivatives_by_a_driver_and_by_a_bushing():
    ts = cases.times(0.03)

    @jax.jit
    def outcome(x):
        scene = crank_and_rod(30.0 * (1 + x[0]), 2e5 * (1 + x[1]))
        run = sj.simulate(scene, ts, rtol=1e-11, atol=1e-13, solver=DOPRI8)
        return jnp.concatenate([run.position("rod")[-1], run.velocity("rod")[-1]])

    slopes = np.asarray(jax.jit(jax.jacfwd(outcome))(jnp.zeros(2)))
    for i, step in enumerate((1e-4, 1e-3)):
        e = np.eye(2)[i] * step
        f = [np.asarray(outcome(k * e)) for k in (-2.0, -1.0, 1.0, 2.0)]
        differences = (8 * (f[2] - f[1]) - (f[3] - f[0])) / (12 * step)
        assert np.abs(differences).max() > 1e-5
        assert slopes[:, i] == pytest.approx(differences, abs=1e-5 * np.abs(differences).max())


@pytest.mark.slow
def test_lanes_with_different_drivers(reference):
    """Speeds side by side in one batch; the start of each lane is assembled to its own driver."""

    def places(speed):
        return sj.simulate(crank_and_rod(speed), TS, rtol=1e-10, solver=DOPRI8).position("rod")

    lanes = np.asarray(jax.vmap(places)(jnp.array([20.0, 30.0])))
    assert lanes[1] == pytest.approx(np.asarray(reference.position("rod")), abs=1e-8)
    assert np.abs(lanes[0] - lanes[1]).max() > 0.01


# Singular configurations and bad input -------------------------------------------------------------------------------


def test_a_jack_beyond_its_reach_stops_with_a_diagnosis():
    joints = {
        "pivot": sj.Revolute(PAIR, "arm.pin", Y),
        "jack": sj.joints.DistanceDriver("ground.peg", "arm.end", lambda t: 0.78 + 1.0 * t),
        "idle": sj.Spherical("arm.end", "weight.end"),
    }
    weight = sj.Body(0.1, (1e-4, 1e-4, 1e-4), position=(0.5, 0.0, -0.1), points={"end": (0.0, 0.0, 0.1)})
    scene = sj.Scene({"arm": arm(), "weight": weight}, joints, ground_points={"peg": (0.0, 0.0, 0.6)})
    with pytest.warns(sj.SimulationWarning):
        run = sj.simulate(scene, cases.times(1.0, 3), rtol=1e-6, solver=DOPRI8, max_steps=20_000)
    assert float(run.t_reached) == pytest.approx(1.1 - 0.78, abs=1e-4)
    assert "'jack', 'pivot'" in run.diagnosis
    assert "'idle'" not in run.diagnosis
    assert "singular" in run.diagnosis
    assert run.constraints.rank == 9


ROD = {"rod": sj.joints.Distance("ground.peg", "arm.end")}
REFUSED = {
    "no function": (lambda: sj.RotationDriver(PAIR, Y, 3.0), "angle = 3.0", "function of time"),
    "wrong shape": (lambda: sj.joints.PositionDriver("arm.end", jnp.sin), "position(t).shape", "(3,)"),
    "not in jnp": (lambda: sj.RotationDriver(PAIR, Y, lambda t: float(t)), "angle", "jax.numpy"),
    "a number that is none": (lambda: sj.RotationDriver(PAIR, Y, Spin(np.nan, 0.0)), "angle", "finite"),
    "a name among numbers": (lambda: sj.RotationDriver(PAIR, Y, Spin("fast", 0.0)), "angle", "static"),
    "no axis": (lambda: sj.TranslationDriver(PAIR, (0, 0, 0), (0, 0, 0), jnp.sin), "axis", "direction"),
    "negative length": (
        lambda: sj.joints.DistanceDriver("ground.peg", "arm.end", lambda t: t - 1.0),
        "length(0) = -1",
        "positive",
    ),
    "rod without length": (lambda: sj.joints.Distance("arm.end", "ground.end"), "'arm.end'", "coincide", "length="),
    "rod of length zero": (lambda: sj.joints.Distance("ground.peg", "arm.end", 0.0), "length = 0", "positive"),
    "skew cross": (lambda: sj.Universal(PAIR, (0, 0, 0), Y, (0.0, 1.0, 1.0)), "second_axis", "perpendicular"),
    "no normal": (lambda: sj.joints.PointOnPlane("arm.end", (0, 0, 0), (0, 0, 0)), "normal", "direction"),
    "no radius": (
        lambda: sj.joints.PointOnCurve("arm.end", sj.joints.Circle((0, 0, 0), Y, -1.0)),
        "radius = -1",
        "positive",
    ),
    "no curve": (lambda: sj.joints.PointOnCurve("arm.end", Y), "curve", "ImplicitCurve"),
    "one function": (
        lambda: sj.joints.PointOnCurve("arm.end", sj.joints.ImplicitCurve(lambda x: x[:1])),
        "(2,)",
        "two functions",
    ),
    "unknown point": (lambda: sj.Cylindrical(PAIR, "arm.tip", Y), "'tip'", "'end'"),
    "unknown body of a plane": (
        lambda: sj.joints.PointOnPlane("arm.end", (0, 0, 0), Y, body="wall"),
        "'wall'",
        "'arm'",
    ),
    "plane on the same body": (
        lambda: sj.joints.PointOnPlane("arm.end", (0, 0, 0), Y, body="arm"),
        "itself",
        "two different",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_bad_joints_are_refused(name):
    build, *words = REFUSED[name]
    pegs = {"peg": (0.0, 0.0, 0.6), "end": (0.5, 0.0, 0.0)}
    with pytest.raises(sj.SceneError) as error:
        sj.equations.compile_scene(sj.Scene({"arm": arm()}, {"bad": build()}, ground_points=pegs))
    for word in words:
        assert word in str(error.value)


def test_effort_of_what_is_no_driver(reference):
    with pytest.raises(sj.SceneError, match=r"'shaft' is no driver; the run has 'motor'"):
        reference.driving_effort("shaft")


def test_force_elements_connect_bodies():
    """A body that only a force holds is legal; one that nothing holds is most likely a mistake."""
    joints = {"pivot": sj.Revolute(PAIR, "arm.pin", Y)}
    bodies = {"arm": arm(), "kite": arm()}
    with pytest.raises(sj.SceneError, match=r"'kite' is joined to nothing.*add a joint"):
        sj.equations.compile_scene(sj.Scene(bodies, joints))
    sj.equations.compile_scene(sj.Scene(bodies, joints, {"wind": sj.AppliedWrench("kite", (1.0, 0.0, 0.0))}))

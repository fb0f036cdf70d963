"""Forces from motions: against runs, against minimal coordinates, least norms, measured motions, derivatives."""

import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.gallery.leg import BEND, CRANK, HIP, LEVER, MASSES, ROD, SHANK, THIGH
from spherejax.studies.inverse import InverseWarning, SampledMotion, inverse_dynamics
from spherejax.studies.inverse.smoothing import smoothed

TS = np.linspace(0.0, 0.6, 13)
HIP_TURN, CRANK_TURN = (sj.Turn(("ground", body), (0.0, 1.0, 0.0)) for body in ("thigh", "crank"))
MOTORS = {"hip_motor": HIP_TURN, "knee_motor": CRANK_TURN}
FOUR_BAR_CRANK = sj.Turn(("ground", "crank"), (1.0, 0.0, 0.0))


def swing(t):
    return 0.4 * jnp.sin(3.0 * t)


def driven_four_bar(model=None, *, coupler_mass=0.1416, **more):
    """The four-bar with a motor on its crank."""
    scene = sj.gallery.four_bar(model, drift=sj.solvers.PostStabilization())
    coupler = scene.bodies["coupler"]
    bodies = dict(scene.bodies)
    bodies["coupler"] = sj.Body(
        coupler_mass, coupler.inertia, coupler.position, coupler.quaternion, points=coupler.points
    )
    motor = {"motor": sj.RotationDriver(("ground", "crank"), (1.0, 0.0, 0.0), swing)}
    return sj.Scene(bodies, {**scene.joints, **motor}, **more)


# Against runs -------------------------------------------------------------------------------------------------------


RUBBING = sj.Ideal(sj.Threlfall(mu=0.2, v1=1e-3), radius=0.01, passes=20)


@pytest.mark.parametrize("model", [sj.Ideal(), pytest.param(RUBBING, marks=pytest.mark.slow)])
def test_motor_and_reactions_of_a_run_come_back(model):
    scene = driven_four_bar(model)
    run = sj.simulate(scene, TS, rtol=1e-9, atol=1e-12).require_success()
    result = inverse_dynamics(scene, run)
    size = np.abs(result.effort("motor")).max()
    np.testing.assert_allclose(result.effort("motor"), run.driving_effort("motor"), atol=1e-12 * size)
    for joint in result.joints:
        np.testing.assert_allclose(result.reaction(joint), run.reaction(joint), atol=1e-11)
        np.testing.assert_allclose(result.reaction_moment(joint), run.reaction_moment(joint), atol=1e-12)
    assert result.largest_unbalanced < 1e-12
    assert not result.not_unique


def test_a_motion_that_drivers_prescribe_needs_no_run():
    scene = driven_four_bar()
    run = sj.simulate(scene, TS, rtol=1e-11, atol=1e-13).require_success()
    result = inverse_dynamics(scene, TS)
    size = np.abs(result.effort("motor")).max()
    # The run's own error in angles.
    np.testing.assert_allclose(result.effort("motor"), run.driving_effort("motor"), atol=1e-10 * size)
    np.testing.assert_allclose(result.reaction("coupler_rocker"), run.reaction("coupler_rocker"), atol=1e-9)
    np.testing.assert_allclose(result.acceleration("rocker"), run.acceleration("rocker"), atol=1e-9)
    power = sum(np.asarray(result.power(name)) for name in result.motors)
    np.testing.assert_allclose(power, run.observation.driving_power["motor"], atol=1e-10)


@pytest.mark.slow
def test_a_clearance_is_replaced_by_its_reaction():
    scene = driven_four_bar(sj.Dry(clearance=1e-4))
    run = sj.simulate(scene, TS, rtol=1e-8, atol=1e-12).require_success()
    result = inverse_dynamics(scene, run)
    # Without friction contact acts along the line of centers: the force is the whole of it.
    scale = np.abs(run.reaction("coupler_rocker")).max()
    assert scale > 1.0
    np.testing.assert_allclose(result.reaction("coupler_rocker"), run.reaction("coupler_rocker"), atol=1e-11 * scale)
    assert np.max(result.misfit.gap) == pytest.approx(1e-4, rel=0.05)


@pytest.mark.slow
def test_actuators_springs_and_turns_come_back():
    turn = sj.Turn(("ground", "rotor"), (0.0, 0.0, 1.0))
    body = sj.Body(2.0, (0.1, 0.1, 0.2), angular_velocity=(0.0, 0.0, 9.0), points={"center": (0.0, 0.0, 0.0)})

    def build(effort):
        return sj.Scene(
            {"rotor": body},
            {"axle": sj.Revolute(("ground", "rotor"), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))},
            {
                "motor": sj.Actuator(turn, effort),
                "spring": sj.TorsionalSpring(("ground", "rotor"), (0.0, 0.0, 1.0), stiffness=0.05),
            },
        )

    scene = build(sj.functions.Sine(0.3, 1.0, offset=0.5))
    run = sj.simulate(scene, jnp.linspace(0.0, 2.0, 41), rtol=1e-10).require_success()
    # More than two turns: the spring's angle is not that of the orientation.
    assert run.force("spring")["angle"].max() > 4 * np.pi
    result = inverse_dynamics(scene, run)
    np.testing.assert_allclose(result.effort("motor"), run.force("motor")["effort"], atol=1e-10)


# Loops and minimal coordinates --------------------------------------------------------------------------------------


def legs_coordinates(t):
    """Angles of thigh and crank by the foot's path: two triangles."""
    start = THIGH * down(HIP) + SHANK * down(HIP + BEND)
    w = 2 * jnp.pi * 1.5
    foot = start + jnp.array([0.08 * jnp.sin(w * t), 0.05 * (1 - jnp.cos(w * t))])
    a, b = THIGH, SHANK
    bend = -jnp.arccos((foot @ foot - a * a - b * b) / (2 * a * b))
    thigh = jnp.arctan2(foot[0], -foot[1]) - jnp.arctan2(b * jnp.sin(bend), a + b * jnp.cos(bend))
    lever = a * down(thigh) - LEVER * down(thigh + bend)
    pin = meeting(jnp.zeros(2), CRANK, lever, ROD)
    return jnp.array([thigh, jnp.arctan2(pin[0], -pin[1])])


def legs_places(q):
    """Centers in the plane and angles of thigh, shank, crank and rod, by the angles of thigh and crank."""
    thigh, crank = q
    knee, pin = THIGH * down(thigh), CRANK * down(crank)
    lever = meeting(knee, LEVER, pin, ROD, side=-1.0)
    shank = (knee - lever) / LEVER
    foot = knee + SHANK * shank
    rod = lever - pin
    centers = jnp.stack([knee / 2, (lever + foot) / 2, pin / 2, (pin + lever) / 2])
    angles = jnp.stack([thigh, jnp.arctan2(shank[0], -shank[1]), crank, jnp.arctan2(rod[0], rod[1])])
    return centers, angles


def down(angle):
    return jnp.array([jnp.sin(angle), -jnp.cos(angle)])


def meeting(first, first_radius, second, second_radius, side=1.0):
    way = second - first
    d = jnp.sqrt(way @ way)
    along = (d * d + first_radius**2 - second_radius**2) / (2 * d)
    across = side * jnp.sqrt(first_radius**2 - along**2)
    return first + along * way / d + across * jnp.array([-way[1], way[0]]) / d


def legs_moments(t):
    """Virtual work: sum over bodies of m (a - g).dx/dq + I alpha dtheta/dq."""
    masses = jnp.array([MASSES[name] for name in ("thigh", "shank", "crank", "rod")])
    lengths = jnp.array([0.25, 0.30, 0.06, 0.25])
    inertias = masses * lengths**2 / 12

    def path(t):
        return legs_places(legs_coordinates(t))

    def second(f):
        return lambda t: jax.jvp(lambda s: jax.jvp(f, (s,), (1.0,))[1], (t,), (1.0,))[1]

    acceleration, turning = second(path)(t)
    centers, angles = jax.jacfwd(legs_places)(legs_coordinates(t))
    pressed = masses[:, None] * (acceleration + jnp.array([0.0, 9.81]))
    # Turning about y by the right hand is from z to x: these angles fall there.
    return jnp.einsum("bi,biq->q", pressed, centers) + jnp.einsum("b,bq->q", inertias * turning, angles)


def test_a_leg_with_a_four_bar_linkage_against_virtual_work():
    """The case of pinocchio's issue 2356: motor moments of a leg with a closed loop, for a foot that is guided."""
    scene = sj.gallery.leg()
    result = inverse_dynamics(scene, TS, motors=MOTORS)
    expected = np.array(jax.vmap(legs_moments)(jnp.asarray(TS)))
    # Angles of the reference grow forward, from down to x: against the right hand about y.
    actual = -np.stack([result.effort("hip_motor"), result.effort("knee_motor")], 1)
    assert np.abs(expected).max(axis=0).min() > 0.3
    np.testing.assert_allclose(actual, expected, atol=1e-12 * np.abs(expected).max())
    assert result.largest_unbalanced < 1e-12
    # The drivers of the foot are no motors, and carry nothing: the same motors make the same motion in a run.
    assert set(result.motors) == {"hip_motor", "knee_motor"}
    assert result.not_unique == ()


@pytest.mark.slow
def test_the_moments_of_a_leg_make_its_motion():
    ts = np.linspace(0.0, 0.2, 401)
    scene = sj.gallery.leg()
    result = inverse_dynamics(scene, ts, motors=MOTORS)
    joints = {name: joint for name, joint in scene.joints.items() if not name.startswith("foot")}
    bodies = {
        name: sj.Body(
            body.mass,
            body.inertia,
            result.position(name)[0],
            result.quaternion(name)[0],
            result.velocity(name)[0],
            result.angular_velocity(name)[0],
            points=body.points,
        )
        for name, body in scene.bodies.items()
    }
    motors = {
        "hip_motor": sj.Actuator(HIP_TURN, sj.functions.SmoothTable(ts, result.effort("hip_motor"))),
        "knee_motor": sj.Actuator(CRANK_TURN, sj.functions.SmoothTable(ts, result.effort("knee_motor"))),
    }
    run = sj.simulate(sj.Scene(bodies, joints, motors), ts, rtol=1e-7).require_success()
    # What the table of moments interpolates, twice integrated.
    np.testing.assert_allclose(run.position("shank"), result.position("shank"), atol=1e-6)


# Not unique ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_two_motors_on_one_shaft_share_its_moment():
    scene = driven_four_bar()
    alone = inverse_dynamics(scene, TS)
    result = inverse_dynamics(scene, TS, motors={"left": FOUR_BAR_CRANK, "right": FOUR_BAR_CRANK})
    np.testing.assert_allclose(result.effort("left"), alone.effort("motor") / 2, rtol=1e-10)
    np.testing.assert_allclose(result.effort("right"), alone.effort("motor") / 2, rtol=1e-10)
    assert result.not_unique == ("left", "right")


def test_a_door_on_two_hinges_has_the_least_reactions():
    places = [(0.0, 0.0, 0.0), (0.0, 0.0, 1.0)]
    door = sj.Body(10.0, (1.0, 1.0, 1.0), position=(0.5, 0.0, 0.5))
    joints = {f"hinge_{i}": sj.Revolute(("ground", "door"), place, (0.0, 0.0, 1.0)) for i, place in enumerate(places)}
    driver = {"motor": sj.RotationDriver(("ground", "door"), (0.0, 0.0, 1.0), rate=0.0)}
    result = inverse_dynamics(sj.Scene({"door": door}, {**joints, **driver}), jnp.array([0.0]))
    assert [name for name in result.not_unique if "force" in name] == ["hinge_0 (force)", "hinge_1 (force)"]
    forces = np.stack([result.reaction(name)[0] for name in joints])
    moments = np.stack([result.reaction_moment(name)[0] for name in joints])
    np.testing.assert_allclose(forces.sum(0), [0.0, 0.0, 98.1], atol=1e-11)
    # By hand: x and -x across, M at each hinge, 98.1 * 0.5 = x * 1 + 2 M; the least 2 x^2 + 2 M^2/L^2 has M = 2 L^2 x.
    x = 98.1 * 0.5 / (1 + 4 * result.length**2)
    np.testing.assert_allclose(np.abs(forces[:, 0]), x, rtol=1e-10)
    np.testing.assert_allclose(np.abs(moments[:, 1]), (98.1 * 0.5 - x) / 2, rtol=1e-10)
    np.testing.assert_allclose(forces[:, 2], 98.1 / 2, rtol=1e-12)


def test_a_degree_of_freedom_without_a_motor_is_told():
    with pytest.warns(InverseWarning, match="a degree of freedom has no motor"):
        result = inverse_dynamics(sj.gallery.leg(), TS, motors={"hip_motor": HIP_TURN})
    assert result.largest_unbalanced > 0.1


# Measured motions ---------------------------------------------------------------------------------------------------


def test_the_smoothing_is_a_filter_of_known_gain():
    ts = np.linspace(0.0, 3.0, 181)
    for frequency, gain in ((5.0, 0.5), (10.0, 1 / (1 + 2**6))):
        w = 2 * np.pi * frequency
        result = smoothed(ts, jnp.asarray(np.sin(w * ts))[:, None], 5.0)
        middle = slice(60, 121)
        # Sums for integrals: the gain of equally spaced samples differs by (f/rate)^6.
        np.testing.assert_allclose(result.value[middle, 0], gain * np.sin(w * ts[middle]), atol=2e-4)
        np.testing.assert_allclose(result.second[middle, 0], -gain * w * w * np.sin(w * ts[middle]), atol=5e-4 * w * w)
    # A parabola has no third derivative: nothing is smoothed.
    result = smoothed(ts, jnp.asarray(3 * ts**2 - ts)[:, None], 0.5)
    np.testing.assert_allclose(result.second[:, 0], 6.0, atol=1e-6)
    np.testing.assert_allclose(result.rate[:, 0], 6 * ts - 1, atol=1e-7)


@pytest.mark.slow
def test_a_measured_joint_angle():
    ts = np.linspace(0.0, 1.0, 61)
    exact = inverse_dynamics(driven_four_bar(), ts)
    scene = sj.gallery.four_bar()
    measured = SampledMotion(ts, coordinates={"crank": (FOUR_BAR_CRANK, swing(ts))}, cutoff=15.0)
    result = inverse_dynamics(scene, measured, motors={"motor": FOUR_BAR_CRANK})
    size = np.abs(exact.effort("motor")).max()
    middle = slice(15, -15)
    np.testing.assert_allclose(result.effort("motor")[middle], exact.effort("motor")[middle], atol=1e-5 * size)


@pytest.mark.slow
def test_measured_poses_with_noise():
    rng, ts = np.random.default_rng(3), np.linspace(0.0, 1.0, 201)
    exact = inverse_dynamics(driven_four_bar(), ts)
    scene = sj.gallery.four_bar()
    positions = {b: exact.position(b) + 1e-5 * rng.normal(size=(201, 3)) for b in scene.bodies}
    quaternions = {b: -exact.quaternion(b) + 1e-4 * rng.normal(size=(201, 4)) for b in scene.bodies}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InverseWarning)
        measured = SampledMotion(ts, positions=positions, quaternions=quaternions, cutoff=6.0)
        result = inverse_dynamics(scene, measured, motors={"motor": FOUR_BAR_CRANK})
    # All joints hold exactly, whatever the noise is.
    assert np.max(result.misfit.gap) < 1e-12
    size = np.abs(exact.effort("motor")).max()
    np.testing.assert_allclose(result.effort("motor")[40:-40], exact.effort("motor")[40:-40], atol=5e-3 * size)


# Derivatives, jit and vmap ------------------------------------------------------------------------------------------


def pendulums_moment(mass, length):
    """Of a rod that is swung about y by a driver, at all instants."""
    body = sj.Body(mass, (0.2, 0.2, 0.1), position=(0.0, 0.0, -length), points={"end": (0.0, 0.0, length)})
    joints = {
        "pivot": sj.Revolute(("ground", "rod"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        "motor": sj.RotationDriver(("ground", "rod"), (0.0, 1.0, 0.0), swing),
    }
    return inverse_dynamics(sj.Scene({"rod": body}, joints), TS[:4]).effort("motor")


def test_values_and_derivatives_of_a_pendulum_are_the_closed_form():
    def expected(mass, length):
        angle, turning = swing(TS[:4]), -9.0 * swing(TS[:4])
        return (0.2 + mass * length**2) * turning + mass * 9.81 * length * jnp.sin(angle)

    numbers = jnp.array([0.3, 0.4]), jnp.array([1.0, 1.2])
    result = jax.jit(jax.vmap(jax.jacrev(pendulums_moment, (0, 1))))(*numbers)
    wanted = jax.vmap(jax.jacfwd(expected, (0, 1)))(*numbers)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-11), result, wanted)
    np.testing.assert_allclose(pendulums_moment(0.3, 1.0), expected(0.3, 1.0), atol=1e-12)


def test_a_measured_angle_of_a_pendulum():
    ts = np.linspace(0.0, 1.0, 41)
    axis = sj.Turn(("ground", "rod"), (0.0, 1.0, 0.0))
    body = sj.Body(0.3, (0.2, 0.2, 0.1), position=(0.0, 0.0, -1.0))
    scene = sj.Scene({"rod": body}, {"pivot": sj.Revolute(("ground", "rod"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))})
    measured = SampledMotion(ts, coordinates={"angle": (axis, swing(ts) + 2 * np.pi)}, cutoff=15.0)
    result = inverse_dynamics(scene, measured, motors={"motor": axis})
    expected = (0.2 + 0.3) * -9.0 * swing(ts) + 0.3 * 9.81 * np.sin(swing(ts))
    np.testing.assert_allclose(result.effort("motor")[10:-10], expected[10:-10], atol=1e-4)


def size_of(length, mass):
    scene = driven_four_bar(coupler_mass=mass)
    place = jnp.array([0.0, length, 0.0])
    result = inverse_dynamics(eqx.tree_at(lambda s: s.bodies["coupler"].points["crank_end"], scene, place), TS[:5])
    return jnp.sum(result.effort("motor") ** 2) * 1e4 + jnp.sum(result.reaction("rocker_pivot") ** 2)


@pytest.mark.slow
def test_derivatives_by_lengths_and_masses():
    at = (0.061, 0.1416)
    exact = jax.jit(jax.grad(size_of, (0, 1)))(*at)
    forward = [jax.jvp(size_of, at, unit)[1] for unit in ((1.0, 0.0), (0.0, 1.0))]
    for i, (reverse, along) in enumerate(zip(exact, forward, strict=True)):
        step = 1e-5 * np.eye(2)[i]
        difference = (size_of(*(at + step)) - size_of(*(at - step))) / 2e-5
        assert float(reverse) == pytest.approx(float(difference), rel=1e-6)
        assert float(along) == pytest.approx(float(reverse), rel=1e-9)


@pytest.mark.slow
def test_many_at_once():
    masses = jnp.array([0.1, 0.2])
    many = jax.vmap(lambda mass: inverse_dynamics(driven_four_bar(coupler_mass=mass), TS[:5]))(masses)
    for i, mass in enumerate(masses):
        alone = inverse_dynamics(driven_four_bar(coupler_mass=float(mass)), TS[:5])
        np.testing.assert_allclose(many.effort("motor")[i], alone.effort("motor"), rtol=1e-9)


@pytest.mark.slow
def test_derivative_by_a_sample_and_the_cutoff():
    ts, scene = np.linspace(0.0, 1.0, 31), sj.gallery.four_bar()

    def effort(bump, cutoff):
        samples = swing(ts) + bump * np.exp(-(((ts - 0.5) / 0.1) ** 2))
        measured = SampledMotion(ts, coordinates={"crank": (FOUR_BAR_CRANK, samples)}, cutoff=cutoff)
        return inverse_dynamics(scene, measured, motors={"motor": FOUR_BAR_CRANK}).effort("motor")[15]

    exact = jax.grad(effort, (0, 1))(0.0, 8.0)
    for i, step in enumerate((1e-5, 1e-3)):
        by, at = step * np.eye(2)[i], np.array([0.0, 8.0])
        difference = (effort(*(at + by)) - effort(*(at - by))) / (2 * step)
        assert float(exact[i]) == pytest.approx(float(difference), rel=1e-5)


# Bad input ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: inverse_dynamics(sj.gallery.four_bar(), TS), "the scene has no driver"),
        (lambda: inverse_dynamics(driven_four_bar(), TS, motors="moter"), "did you mean 'motor'"),
        (lambda: inverse_dynamics(driven_four_bar(), TS, motors={"crank_pivot": FOUR_BAR_CRANK}), "give it another"),
        (lambda: inverse_dynamics(driven_four_bar(), TS, motors={"m": 3.0}), "must be a Turn"),
        (lambda: inverse_dynamics(driven_four_bar(), [[0.0]]), "must have the shape"),
        (lambda: inverse_dynamics(driven_four_bar(), "start"), "must be instants"),
        (lambda: inverse_dynamics(sj.gallery.leg(stride=0.6), TS), "cannot be closed"),
        (lambda: SampledMotion(TS, cutoff=1.0), "needs samples"),
        (lambda: SampledMotion(TS[::-1], positions={}, cutoff=1.0), "increase"),
        (lambda: SampledMotion(TS, positions={"rod": np.zeros((3, 3))}, cutoff=1.0), "must have the shape"),
        (lambda: SampledMotion(TS, positions={"rod": np.full((13, 3), np.nan)}, cutoff=1.0), "not finite"),
        (lambda: SampledMotion(TS, coordinates={"crank": swing(TS)}, cutoff=1.0), "a coordinate and its samples"),
        (lambda: SampledMotion(TS, positions={"rod": np.zeros((13, 3))}, cutoff=50.0), "half of the sampling rate"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(sj.SceneError, match=message):
        call()


def test_instants_that_cannot_be_closed_have_no_forces_where_numbers_are_traced():
    """The same stride is an error where it is known."""
    effort = jax.jit(lambda stride: inverse_dynamics(sj.gallery.leg(stride=stride), TS).effort("foot_x"))
    assert np.isfinite(effort(0.08)).all()
    assert np.isnan(effort(0.6)).any()


@pytest.mark.slow
def test_a_table_with_units():
    table = inverse_dynamics(sj.gallery.leg(), TS[:3], motors=MOTORS).to_xarray()
    assert table["hip_motor.effort"].attrs["units"] == "N m"
    assert table["reaction"].dims == ("time", "joint", "axis")
    assert float(abs(table["unbalanced_force"]).max()) < 1e-12

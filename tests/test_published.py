"""Problems that others published, against closed forms, printed digits and equations of their own.

The references use minimal coordinates and SciPy alone; nothing of the package enters them.
"""

import dataclasses
import importlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk

import spherejax as sj
from spherejax import cli
from spherejax.gallery.hip import Gait
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import constraint_set
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.start.assembly import as_ideal, assemble_now, described_state
from spherejax.physics.state import unpack

G = 9.81


def simulated(scene, ts, rtol):
    return sj.simulate(scene, jnp.asarray(ts), rtol=rtol).require_success()


def accelerations_at_start(scene):
    """Accelerations and angular accelerations of the bodies at the described start, by name; compiles nothing."""
    system = compile_scene(scene).system
    structure, theta = flatten_system(system)
    start = np.asarray(assemble_now(*flatten_system(as_ideal(system))).y)
    start = np.concatenate([start, np.zeros(system.layout.size - start.size)])
    rate = np.asarray(program_for(state_rate, structure).compute(theta, 0.0, start))
    n = len(scene.bodies)
    return dict(zip(sorted(scene.bodies), rate[7 * n : 13 * n].reshape(n, 6), strict=True))


def turned(quaternion):
    """Angle of a body that turns about z."""
    return 2 * np.arctan2(quaternion[..., 3], quaternion[..., 0])


# Pendulums --------------------------------------------------------------------------------------------------------


def swing(ts, length):
    """Angle from the vertical of a simple pendulum released from the horizontal: sin(angle/2) = k sn(K + w t)."""
    sn, _, _, _ = ellipj(ellipk(0.5) + np.sqrt(G / length) * ts, 0.5)
    return 2 * np.arcsin(np.sqrt(0.5) * sn)


def test_a01_simple_pendulum():
    ts = np.linspace(0.0, 10.0, 101)
    run = simulated(sj.gallery.simple_pendulum(), ts, 1e-10)
    angle = swing(ts, 1.0)
    expected = np.stack([-np.sin(angle), -np.cos(angle), 0 * ts], 1)
    assert np.asarray(run.position("bob")) == pytest.approx(expected, abs=1e-8)


def rod_center(ts):
    angle = swing(ts, 0.2)  # a uniform rod of 0.3 m swings as a simple pendulum of 2/3 of its length
    return 0.15 * np.stack([np.sin(angle), 0 * ts, -np.cos(angle)], 1)


def test_physical_pendulum_on_an_ideal_pivot():
    ts = np.linspace(0.0, 2.0, 21)
    run = simulated(sj.gallery.physical_pendulum(), ts, 1e-10)
    assert np.asarray(run.position("rod")) == pytest.approx(rod_center(ts), abs=1e-8)


@pytest.mark.parametrize(
    ("model", "sizes"),
    [
        (lambda size: sj.Bushing(1.0 / size, 1e-2), (1e-5, 1e-6)),  # yields by about size * (force in newtons)
        (lambda size: sj.Dry(clearance=size), (1e-4, 1e-5)),
        # The film yields by size^3 and time; the full one would shear its oil, which is the stronger the thinner it is.
        (lambda size: sj.Lubricated(clearance=size, viscosity=0.4, film=sj.laws.RadialFilm()), (1e-4, 1e-5)),
    ],
    ids=["bushing", "dry", "lubricated"],
)
def test_physical_pendulum_tends_to_the_ideal_one(model, sizes):
    ts = np.linspace(0.0, 0.2, 11)

    @jax.jit
    def position(size):
        return sj.simulate(sj.gallery.physical_pendulum(model(size)), jnp.asarray(ts), rtol=1e-7).position("rod")

    errors = [np.abs(np.asarray(position(size)) - rod_center(ts)).max() for size in sizes]
    for size, error in zip(sizes, errors, strict=True):
        assert 1e-4 * size < error < 30 * size
    assert errors[1] < 0.3 * errors[0]


def double_swing(ts, mass, length):
    """Centers of two rods released from the horizontal, angles from the vertical, by Lagrange's equations."""

    def rate(_, y):
        a, b, a_rate, b_rate = y
        c, s = np.cos(a - b), np.sin(a - b)
        inertia = mass * length**2 * np.array([[4 / 3, c / 2], [c / 2, 1 / 3]])
        load = (
            -mass
            * length
            * np.array(
                [length * s * b_rate**2 / 2 + 1.5 * G * np.sin(a), -length * s * a_rate**2 / 2 + 0.5 * G * np.sin(b)]
            )
        )
        return [a_rate, b_rate, *np.linalg.solve(inertia, load)]

    start = [np.pi / 2, np.pi / 2, 0.0, 0.0]
    a, b, _, _ = solve_ivp(rate, (0, ts[-1]), start, "DOP853", ts, rtol=1e-12, atol=1e-12).y
    upper = length / 2 * np.stack([np.sin(a), 0 * a, -np.cos(a)], 1)
    return upper, 2 * upper + length / 2 * np.stack([np.sin(b), 0 * b, -np.cos(b)], 1)


def test_double_pendulum():
    ts = np.linspace(0.0, 1.0, 21)
    run = simulated(sj.gallery.double_pendulum(), ts, 1e-10)
    upper, lower = double_swing(ts, 0.5, 0.3)
    assert np.asarray(run.position("upper")) == pytest.approx(upper, abs=1e-7)
    assert np.asarray(run.position("lower")) == pytest.approx(lower, abs=1e-7)


def test_chain_of_two_is_the_double_pendulum():
    ts = np.linspace(0.0, 0.5, 6)
    run = simulated(sj.gallery.chain(2), ts, 1e-10)
    upper, lower = (center[:, [0, 2, 1]] for center in double_swing(ts, 1.0, 1.0))
    assert np.asarray(run.position("link_01")) == pytest.approx(upper, abs=1e-8)
    assert np.asarray(run.position("link_02")) == pytest.approx(lower, abs=1e-8)


def test_heavy_top_follows_the_elliptic_function():
    mass, A, C, w, p = 15.0, 0.234375 + 15.0, 0.46875, 150.0, -4.61538
    # (A u')^2 = 2 A (E - m g u)(1 - u^2) - (L - C w u)^2 with E = A p^2 / 2 and L = A p; u = z / (1 m) = 0 is a root.
    cubic = np.array([2 * A * mass * G, -A * A * p * p - (C * w) ** 2, 2 * A * (p * C * w - mass * G), 0.0])
    u1, u2, u3 = np.sort(np.roots(cubic).real)
    assert u2 == pytest.approx(0.0, abs=1e-12)  # it starts at the top of its nodding
    ts = np.linspace(0.0, 1.5, 16)
    k2 = (u2 - u1) / (u3 - u1)

    def height(t):
        sn = ellipj(ellipk(k2) + np.sqrt(mass * G * (u3 - u1) / (2 * A)) * t, k2)[0]
        return u1 + (u2 - u1) * sn**2

    # The other two places are not compared: it swings through a point close below the tip, where their angle is lost.
    run = simulated(sj.gallery.heavy_top(), ts, 1e-11)
    assert np.asarray(run.position("top"))[:, 2] == pytest.approx(height(ts), abs=1e-8)
    assert height(ts).min() < -0.9


# The test set for initial value problems --------------------------------------------------------------------------

CAR_AXIS = (
    0.493455784275402809122e-1, 0.496989460230171153861, 0.104174252488542151681e1, 0.373911027265361256927,
    -0.770583684040972357970e-1, 0.744686658723778553466e-2, 0.175568157537232222276e-1, 0.770341043779251976443,
)  # fmt: skip
"""Positions, then velocities of the left and the right mass at t = 3: the test set's quadruple precision."""


def test_car_axis():
    run = simulated(sj.gallery.car_axis(), [0.0, 1.5, 3.0], 1e-10)
    found = [values(mass)[-1, :2] for values in (run.position, run.velocity) for mass in ("left", "right")]
    assert np.concatenate(found) == pytest.approx(np.array(CAR_AXIS), rel=1e-8)


ANDREWS = (
    15.81077119629904, -15.75637105984298, 0.04082224013073101, -0.5347301163226948, 0.5244099658805304,
    0.5347301163226948, 1.048080741042263,
)  # fmt: skip
"""beta, Theta, gamma, Phi, delta, Omega, epsilon at t = 0.03 s: the test set's solution, 16 digits."""


ANDREWS_RATES = (
    1139.920302151208, -1424.379294994111, 11.03291221937134, 19.29337464421385, 0.5735699284790808,
    -19.29337464421385, 0.3231791658026955,
)  # fmt: skip
ANDREWS_ACCELERATIONS = (
    -24631.76316945196, 51850.37701610329, 324102.5686413781, 566749.3645176213, 16743.62929479361,
    -566749.3645176222, 9826.520791458422,
)  # fmt: skip
"""First and second derivatives of the angles at t = 0.03 s, from the same solution."""


def by_body(angles):
    """Angles of the seven bodies from the seven angles of the test set."""
    beta, theta, gamma, phi, delta, omega, epsilon = angles
    return np.array([beta, beta + theta, gamma, phi + delta, delta, omega + epsilon, epsilon])


def test_andrews_accelerates_as_printed(monkeypatch):
    module = importlib.import_module("spherejax.gallery.andrews")

    def centers(h):
        monkeypatch.setattr(module, "START", tuple(np.array(ANDREWS) + h * np.array(ANDREWS_RATES)))
        return np.array([body.position for body in sj.gallery.andrews().bodies.values()])

    h = 1e-6
    velocities = (centers(-2 * h) - 8 * centers(-h) + 8 * centers(h) - centers(2 * h)) / (12 * h)
    centers(0.0)
    scene, rates = sj.gallery.andrews(), by_body(ANDREWS_RATES)
    bodies = {
        name: dataclasses.replace(body, velocity=velocity, angular_velocity=np.array([0.0, 0.0, rate]))
        for (name, body), velocity, rate in zip(scene.bodies.items(), velocities, rates, strict=True)
    }
    moving = sj.Scene(
        bodies, scene.joints, scene.forces, gravity=scene.gravity, ground_points=scene.ground_points, drift=scene.drift
    )
    found = accelerations_at_start(moving)
    expected = by_body(ANDREWS_ACCELERATIONS)
    # As the unknowns of highest index they carry fewer digits than the angles.
    assert np.array([found[f"k{i}"][5] for i in range(1, 8)]) == pytest.approx(expected, rel=0, abs=2e-7 * 566749)


@pytest.mark.slow
def test_andrews_against_the_printed_digits():
    run = simulated(sj.gallery.andrews(), [0.0, 0.015, 0.03], 1e-8)
    k1, k2, k3, k4, k5, k6, k7 = (turned(np.asarray(run.quaternion(f"k{i}"))[-1]) for i in range(1, 8))
    found = np.array([k1, k2 - k1, k3, k4 - k5, k5, k6 - k7, k7])
    whole_turns = 2 * np.pi * np.round((np.array(ANDREWS) - found) / (2 * np.pi))
    assert found + whole_turns == pytest.approx(np.array(ANDREWS), rel=1e-8)


# The IFToMM library -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a02_two_four_bars_for_10_seconds():
    ts = np.linspace(0.0, 10.0, 101)
    run = simulated(sj.gallery.n_four_bar(2), ts, 1e-10)
    y = solve_ivp(
        lambda _, y: [y[1], 3.5 / 3 * G * np.sin(y[0])], (0, 10), [0, 1], "DOP853", ts, rtol=1e-13, atol=1e-13
    )
    assert np.asarray(run.position("rod_00"))[:, 0] == pytest.approx(0.5 * np.sin(y.y[0]), abs=1e-6)
    energy = np.asarray(run.mechanical_energy)
    assert energy == pytest.approx(np.full(101, energy[0]), abs=1e-6)


def test_a04_bricard_moves_with_one_redundant_equation():
    scene = sj.gallery.bricard()
    system = compile_scene(scene).system
    start = described_state(system)

    motions = body_motions(system, unpack(system.layout, start))
    equations = constraint_set(system, jnp.zeros(()), motions)
    jacobian = jax.jacfwd(lambda v: equations.times(v.reshape(5, 6)))(jnp.zeros(30))
    singular_values = np.linalg.svd(np.asarray(jacobian), compute_uv=False)
    assert singular_values.shape == (30,)
    assert singular_values[-1] < 1e-12 < 1e-3 < singular_values[-2]


@pytest.mark.slow
def test_a04_bricard_for_10_seconds():
    ts = np.linspace(0.0, 10.0, 201)
    run, other = (simulated(sj.gallery.bricard(), ts, rtol) for rtol in (1e-9, 1e-11))
    energy = np.asarray(run.mechanical_energy)
    assert energy == pytest.approx(np.full(201, energy[0]), abs=1e-6)
    corner = np.asarray(run.position("rod_3"))
    assert corner == pytest.approx(np.asarray(other.position("rod_3")), abs=1e-6)
    assert np.ptp(corner[:, 0]) > 1.5  # it moves far
    # Closure of the loop with three-fold symmetry: the hinge angles are a, b, a, b, a, b, and
    # cos(a) + cos(b) + cos(a) cos(b) = 0 (Bricard's trihedral linkage with axes at right angles).
    edges = np.eye(3)[[0, 1, 2, 0, 1]] * [[1], [-1], [1], [-1], [1]]
    rotation = [rotations(np.asarray(run.quaternion(f"rod_{i}"))) for i in range(1, 6)]
    along = [r @ e for r, e in zip(rotation, edges, strict=True)]
    along.append(np.tile([0.0, 0.0, -1.0], (201, 1)))
    cosine = np.stack([np.sum(along[i - 1] * along[i], 1) for i in range(6)])
    assert cosine[[0, 2, 4]] == pytest.approx(np.tile(cosine[0], (3, 1)), abs=1e-9)
    a, b = cosine[0], cosine[1]
    assert a + b + a * b == pytest.approx(0 * ts, abs=1e-9) or a + b - a * b == pytest.approx(0 * ts, abs=1e-9)


def rotations(q):
    w, v = q[:, 0, None, None], q[:, 1:]
    x, y, z = v.T
    skew = np.stack([0 * x, -z, y, z, 0 * x, -x, -y, x, 0 * x], 1).reshape(-1, 3, 3)
    return np.eye(3) + 2 * w * skew + 2 * skew @ skew


def governor_rate(_, y):
    """Lagrange's equations with equal rods: shaft's angular velocity w, slider's height s, the rods' incline a."""
    s, a, s_rate, a_rate, w = y
    rod, ball, slider, width = 0.3, 5.0, 3.0, 0.01
    along, across = rod * (1.0 + width**2) / 12, rod * 2 * width**2 / 12
    about_hinge = along + rod * 0.25 + ball
    first = 0.5 * rod + ball  # first moment about the hinge
    c, d = np.cos(a), np.sin(a)
    # About z: shaft and slider, and per rod its own moment and the square of its distance.
    spread = 2 * (0.05**2 * (rod + ball) + 2 * 0.05 * first * c + about_hinge * c * c + across * d * d)
    spread_slope = 2 * (-2 * 0.05 * first * d - 2 * (about_hinge - across) * c * d)
    inertia = rod * 2 * width**2 / 12 + slider * 2 * 0.1**2 / 12 + spread
    dx, dz = 0.5 * c, 1 - 0.5 * d - s  # from the slider's side to the rod's middle
    length = np.hypot(dx, dz)
    by_a, by_s = (-0.5 * d * dx - 0.5 * c * dz) / length, -dz / length
    tension = 8e5 * (length - 0.5) + 4e4 * (by_a * a_rate + by_s * s_rate)
    s_accel = (-slider * G - 2 * tension * by_s) / slider
    a_accel = (0.25 * spread_slope * w * w + first * G * c - tension * by_a) / about_hinge
    return [s_rate, a_rate, s_accel, a_accel, -spread_slope * a_rate * w / inertia]


GOVERNOR_START = [0.5, np.pi / 6, 0.0, 0.0, 2 * np.pi]


def test_a05_governor_starts_as_lagranges_equations_say():
    found = accelerations_at_start(sj.gallery.governor())
    _, _, s_accel, a_accel, w_rate = governor_rate(0.0, GOVERNOR_START)
    assert found["slider"][2] == pytest.approx(s_accel, rel=1e-9)
    assert found["rod_right"][4] == pytest.approx(a_accel, rel=1e-9)
    assert found["rod_left"][4] == pytest.approx(-a_accel, rel=1e-9)
    assert found["shaft"][5] == pytest.approx(w_rate, abs=1e-9)


@pytest.mark.slow
def test_a05_governor_against_two_methods():
    ts = np.linspace(0.0, 10.0, 21)
    references = [
        solve_ivp(governor_rate, (0, 10), GOVERNOR_START, method, ts, rtol=1e-10, atol=1e-12).y
        for method in ("Radau", "LSODA")
    ]
    assert references[0] == pytest.approx(references[1], abs=1e-7)
    run = simulated(sj.gallery.governor(), ts, 1e-8)
    assert np.asarray(run.position("slider"))[:, 2] == pytest.approx(references[0][0], abs=1e-7)
    assert np.asarray(run.angular_velocity("shaft"))[:, 2] == pytest.approx(references[0][4], abs=1e-6)


# Textbook and application -----------------------------------------------------------------------------------------


def slider_crank_points(angle):
    """Slider's place and the rod's rotation matrix by the crank's angle from upright."""
    pin = np.array([0.0, 0.1 - 0.08 * np.sin(angle), 0.12 + 0.08 * np.cos(angle)])
    slider = np.array([np.sqrt(0.09 - pin[1] ** 2 - pin[2] ** 2), 0.0, 0.0])
    along = (slider - pin) / 0.3
    across = np.cross(along, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    return pin, slider, np.column_stack([along, across, np.cross(along, across)])


def slider_crank_inertia(angle, h=1e-4):
    """Generalized inertia and potential energy; derivatives of the geometry by differences of the fourth order."""
    weights = np.array([1, -8, 8, -1]) / (12 * h)
    pins, sliders, turns = zip(*(slider_crank_points(angle + k * h) for k in (-2, -1, 1, 2)), strict=True)
    pin, _, turn = slider_crank_points(angle)
    slider_rate = np.tensordot(weights, np.array(sliders), 1)
    center_rate = np.tensordot(weights, np.array(pins) + np.array(sliders), 1) / 2
    spin = turn.T @ np.tensordot(weights, np.array(turns), 1)
    spin = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
    inertia = 1e-4 + 0.5 * center_rate @ center_rate + 2.0 * slider_rate @ slider_rate
    return inertia + np.array([4e-4, 4e-3, 4e-3]) @ spin**2, 0.5 * G * pin[2] / 2


def test_slider_crank_keeps_to_its_one_degree_of_freedom():
    ts = np.linspace(0.0, 1.0, 11)
    run = simulated(sj.gallery.slider_crank(), ts, 1e-10)

    def rate(_, y):
        h = 1e-3
        (i1, v1), (i2, v2), (i3, v3), (i4, v4) = (slider_crank_inertia(y[0] + k * h) for k in (-2, -1, 1, 2))
        slope, force = ((a - 8 * b + 8 * c - d) / (12 * h) for a, b, c, d in ((i1, i2, i3, i4), (v1, v2, v3, v4)))
        return [y[1], -(0.5 * slope * y[1] ** 2 + force) / slider_crank_inertia(y[0])[0]]

    angle = solve_ivp(rate, (0, 1), [0.0, 2 * np.pi], "DOP853", ts, rtol=1e-9, atol=1e-10).y[0]
    expected = [slider_crank_points(a)[1][0] for a in angle]
    assert angle[-1] > 2 * np.pi
    assert np.asarray(run.position("slider"))[:, 0] == pytest.approx(expected, abs=1e-7)


@pytest.mark.slow
def test_hip_sinks_through_its_film_and_rests_on_the_metal():
    scene = sj.gallery.hip()
    coefficient = 6 * np.pi * 2.5e-3 * 14.05e-3 * (14.05e-3 / 50e-6) ** 3

    def factor(e):
        if e < 0.05:
            return sum((k + 2) / (k + 3) * e**k for k in range(16))
        return np.log1p(-e) / e**3 + 1 / (e**2 * (1 - e)) - 1 / (2 * e)

    gait = scene.forces["gait"]
    assert isinstance(gait, Gait)
    load = gait.load
    early = np.linspace(0.0, 4e-3, 5)

    def rate(t, y):  # m e'' = F - C B(e / c) e'
        return [y[1], (float(load(t)) - coefficient * factor(y[0] / 50e-6) * y[1]) / 3.0]

    squeezed = solve_ivp(rate, (0, 4e-3), [0.0, 0.0], "Radau", early, rtol=1e-8, atol=1e-12).y[0]
    late = np.array([0.1, 0.3, 0.5, 0.7, 1.0])
    run = simulated(scene, np.concatenate([early, late]), 1e-6)
    found = np.asarray(run.eccentricity("cup"))[:, 2]
    assert found[:5] == pytest.approx(squeezed, abs=0.02 * 50e-6)
    # At rest on the metal: F = K delta^1.5, with the stiffness of two spheres, the cup's radius negative (Eq. 24).
    modulus = (1 - 0.3**2) / 210e9
    stiffness = 4 / (3 * 2 * modulus) * np.sqrt(14.05e-3 * 14e-3 / 50e-6)
    forces = np.array([float(load(t)) for t in late])
    assert forces.max() > 2500
    assert forces.min() == pytest.approx(300.0)
    assert found[5:] - 50e-6 == pytest.approx((forces / stiffness) ** (2 / 3), rel=0.02)
    # Nothing rubs: the leg swings as the muscles say.
    frequency = 2 * np.pi
    expected = np.pi / 9 * frequency * np.cos(frequency * np.concatenate([early, late]))
    assert np.asarray(run.angular_velocity("femur"))[:, 1] == pytest.approx(expected, abs=1e-5)


def test_bad_numbers_of_links_and_loops_are_named():
    with pytest.raises(sj.SceneError, match="n_links = 0 must be at least 1"):
        sj.gallery.chain(0)
    with pytest.raises(sj.SceneError, match="n_loops = 0 must be at least 1"):
        sj.gallery.n_four_bar(0)


# On the command line ------------------------------------------------------------------------------------------------


def test_scenes_run_by_their_short_names(capsys):
    assert cli.main(["run", "a01", "--samples", "3"]) == 0
    out = capsys.readouterr().out
    assert "simple-pendulum" in out
    assert "10 s" in out  # the published length
    assert cli.main(["list"]) == 0
    out = capsys.readouterr().out
    for name in ("n-four-bar (a02)", "bricard (a04)", "governor (a05)", "andrews", "car-axis", "heavy-top", "hip"):
        assert name in out


def test_a_scene_without_a_studied_joint_says_so(capsys):
    assert cli.main(["run", "a04", "--joint", "dry"]) == 2
    assert "bricard has no studied joint; add --of NAME" in capsys.readouterr().err

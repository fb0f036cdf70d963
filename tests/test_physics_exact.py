"""Closed forms: pendulum, rigid body, heavy top, oscillator, impact, squeeze film."""

import cases
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk

import spherejax as sj

G = 9.81
TIGHT = {"rtol": 1e-11, "atol": 1e-13}
NO_GRAVITY = (0.0, 0.0, 0.0)


def test_physical_pendulum_follows_the_elliptic_function():
    # cases.pendulum: released from the horizontal at a distance l, about the y axis: sin(theta/2) = k sn(K + w t).
    mass, inertia, length = 0.5, 2e-3, 0.1
    w = np.sqrt(mass * G * length / (inertia + mass * length**2))
    k2 = np.sin(np.pi / 4) ** 2
    ts = np.linspace(0.0, 3.0, 31)  # about five swings
    sn, _, _, _ = ellipj(ellipk(k2) + w * ts, k2)
    theta = 2 * np.arcsin(np.sqrt(k2) * sn)  # from the vertical
    run = sj.simulate(cases.pendulum(), jnp.asarray(ts), **TIGHT).require_success()
    expected = length * np.stack([np.sin(theta), 0 * theta, -np.cos(theta)], 1)
    assert np.asarray(run.position("bob")) == pytest.approx(expected, abs=1e-8 * length)


def test_torque_free_body_follows_jacobi_functions():
    inertia = np.array([1.0, 2.0, 3.0]) * 1e-3
    w0 = np.array([2.0, 0.0, 3.0])
    ts = np.linspace(0.0, 5.0, 26)
    energy2, momentum2 = inertia @ w0**2, inertia**2 @ w0**2  # 2T and L^2
    i1, i2, i3 = inertia
    assert momentum2 > energy2 * i2  # precession about the third axis: w3 carries dn
    rate = np.sqrt((i3 - i2) * (momentum2 - energy2 * i1) / (i1 * i2 * i3))
    k2 = (i2 - i1) * (energy2 * i3 - momentum2) / ((i3 - i2) * (momentum2 - energy2 * i1))
    sn, cn, dn, _ = ellipj(rate * ts, k2)
    # Amplitudes from the two invariants; at t = 0 the second component passes zero, upwards for i2 (i3 - i1) > 0.
    w2 = np.sqrt((energy2 * i3 - momentum2) / (i2 * (i3 - i2)))
    expected = np.stack([w0[0] * cn, w2 * sn, w0[2] * dn], 1)
    sign = np.sign((i3 - i1) * w0[2] * w0[0])
    expected[:, 1] *= sign
    body = sj.Body(1.0, inertia, angular_velocity=w0)
    run = sj.simulate(sj.Scene({"body": body}, gravity=NO_GRAVITY), jnp.asarray(ts), **TIGHT).require_success()
    rotation = Rotation.from_quat(np.array(run.quaternion("body")), scalar_first=True)
    in_body = rotation.inv().apply(np.array(run.angular_velocity("body")))
    assert in_body == pytest.approx(expected, abs=1e-8 * 3.0)
    momentum = rotation.apply(in_body * inertia)
    assert momentum == pytest.approx(np.tile(inertia * w0, (len(ts), 1)), abs=1e-9 * np.sqrt(momentum2))


def test_heavy_symmetric_top_precesses_steadily():
    # A top on a spherical joint at the ground. Steady precession at the rate W with tilt theta and spin s about its
    # axis (total, in the axis' direction): (C s - A W cos theta) W = m g l, moments A and C at the fixed point.
    mass, length, across, along, tilt, spin = 0.3, 0.08, 8e-4, 5e-4, 0.6, 120.0
    A = across + mass * length**2
    W = min(np.roots([A * np.cos(tilt), -along * spin, mass * G * length]).real)
    turn = Rotation.from_rotvec([0.0, tilt, 0.0])
    axis = turn.apply([0.0, 0.0, 1.0])
    # The angular velocity: precession about z, and what is needed of spin so that its part along the axis is `spin`.
    w = np.array([0.0, 0.0, W]) + (spin - W * np.cos(tilt)) * axis
    body = sj.Body(
        mass,
        (across, across, along),
        position=length * axis,
        quaternion=turn.as_quat(scalar_first=True),
        velocity=np.cross(w, length * axis),
        angular_velocity=w,
        points={"tip": (0.0, 0.0, -length)},
    )
    scene = sj.Scene(
        {"top": body}, {"tip": sj.Spherical("ground.peg", "top.tip")}, ground_points={"peg": (0.0, 0.0, 0.0)}
    )
    ts = np.linspace(0.0, 1.0, 11)
    run = sj.simulate(scene, jnp.asarray(ts), **TIGHT).require_success()
    expected = Rotation.from_rotvec(np.outer(W * ts, [0.0, 0.0, 1.0])).apply(length * axis)
    assert pytest.approx(mass * G * length / (along * spin), rel=0.3) == W  # the slow of the two precessions
    assert np.asarray(run.position("top")) == pytest.approx(expected, abs=1e-8 * length)


@pytest.mark.parametrize("damping", [0.0, 2e-3])
def test_bushing_is_a_harmonic_oscillator_along_a_line(damping):
    mass, stiffness, speed = 0.2, 2e4, 0.5
    scene = cases.ball_in_socket(sj.Bushing(stiffness, damping), mass, (0.6 * speed, 0.0, 0.8 * speed))
    ts = np.linspace(0.0, 0.1, 21)  # five periods
    run = sj.simulate(scene, jnp.asarray(ts), **TIGHT).require_success()
    decay = stiffness * damping / (2 * mass)
    frequency = np.sqrt(stiffness / mass - decay**2)
    along = speed / frequency * np.exp(-decay * ts) * np.sin(frequency * ts)
    expected = along[:, None] * np.array([0.6, 0.0, 0.8])
    assert np.asarray(run.position("ball")) == pytest.approx(expected, abs=1e-8 * speed / frequency)


# Free impact --------------------------------------------------------------------------------------------------------

RESTITUTIONS = np.array([0.1, 0.3, 0.5, 0.7, 0.9, 0.99])
LAWS = {
    sj.HuntCrossley: lambda c: 3 * (1 - c) / 2,
    sj.LankaraniNikravesh: lambda c: 3 * (1 - c**2) / 4,
    sj.Gonthier: lambda c: (1 - c**2) / c,
    sj.Flores: lambda c: 8 * (1 - c) / (5 * c),
}
MASS, SPEED, STIFFNESS = 0.2, 0.3, 1e10  # kg, m/s, N/m^1.5


def restitution_in_closed_form(chi):
    """e that solves chi (1 + e) = ln[(1 + chi)/(1 - chi e)]."""
    top = min(1.0, 1 / chi) * (1 - 1e-15)
    return brentq(lambda e: chi * (1 + e) - np.log1p(chi) + np.log1p(-chi * e), 1e-6, top, xtol=1e-15)


@pytest.mark.parametrize("law", [*LAWS, sj.ExactRestitution])
def test_free_impact_realizes_the_closed_form(law):
    # From the center at SPEED: at the wall after c / SPEED, back after at most a few contact durations.
    scale = (MASS * SPEED**2 / STIFFNESS) ** 0.4
    t_contact = cases.C / SPEED
    t_end = 1.5 * t_contact + 10 * scale / SPEED
    ts = jnp.concatenate([jnp.zeros(1), t_contact + scale / SPEED * jnp.linspace(0.01, 2.5, 250), jnp.array([t_end])])

    @jax.jit
    @jax.vmap
    def impact(c_r):
        model = sj.Dry(clearance=cases.C, normal=law(restitution=c_r, stiffness=STIFFNESS))
        scene = cases.ball_in_socket(model, MASS, (0.0, 0.6 * SPEED, -0.8 * SPEED))
        run = sj.simulate(scene, ts, rtol=1e-10, atol=1e-13)
        return run.velocity("ball")[-1], run.position("ball"), run.velocity("ball"), run.status, run.stats.n_onsets

    v_end, positions, velocities, status, n_onsets = map(np.asarray, impact(jnp.asarray(RESTITUTIONS)))
    assert (status == sj.Status.SUCCEEDED).all()
    assert (n_onsets == 1).all()
    direction = np.array([0.0, 0.6, -0.8])
    chi = np.array([LAWS[law](c) for c in RESTITUTIONS]) if law in LAWS else None
    for k, c_r in enumerate(RESTITUTIONS):
        expected = c_r if chi is None else restitution_in_closed_form(chi[k])
        assert -v_end[k] @ direction / SPEED == pytest.approx(expected, abs=1e-6), c_r
        factor = (
            chi[k]
            if chi is not None
            else brentq(
                lambda x, e=c_r: x * (1 + e) - np.log1p(x) + np.log1p(-x * e), 1e-4, (1 - 1e-15) / c_r, xtol=1e-15
            )
        )
        # delta_max^(n+1) = m (n+1)/K v^2 (1/chi - ln(1 + chi)/chi^2). The samples bracket it; a Hermite cubic has it.
        deepest = (2.5 * MASS * SPEED**2 / STIFFNESS * (1 / factor - np.log1p(factor) / factor**2)) ** 0.4
        depth = np.linalg.norm(positions[k], axis=1) - cases.C
        rate = velocities[k] @ direction
        assert _peak(np.asarray(ts), depth, rate) == pytest.approx(deepest, rel=1e-6), c_r


def _peak(t, depth, rate):
    """Maximum of the cubic Hermite interpolant of (depth, rate)."""
    at = int(np.argmax(depth))
    peaks = []
    for i in (at - 1, at):
        h = t[i + 1] - t[i]
        d = (depth[i + 1] - depth[i]) / h
        cubic = np.array([rate[i] + rate[i + 1] - 2 * d, 3 * d - 2 * rate[i] - rate[i + 1], rate[i], 0.0])
        for x in np.roots(np.polyder(cubic)):
            if abs(x.imag) < 1e-12 and 0 <= x.real <= 1:
                peaks.append(depth[i] + h * np.polyval(cubic, x.real))
    return max([depth[at], *peaks])


# Squeeze film -------------------------------------------------------------------------------------------------------


def load_factor(eps):
    """B(eps), by its power series near 0."""
    if eps < 0.05:
        return sum((k + 2) / (k + 3) * eps**k for k in range(16))
    return np.log1p(-eps) / eps**3 + 1 / (eps**2 * (1 - eps)) - 1 / (2 * eps)


@pytest.mark.parametrize("boundary", cases.BOUNDARIES.values(), ids=cases.BOUNDARIES)
def test_film_under_constant_load_sinks_as_the_integral_says(boundary):
    # Inertia is negligible (the film damps at 1e7/s): F dt = C c B(eps) d eps, from the center.
    load, viscosity, c, radius = 50.0, 0.4, cases.C, 0.010
    coefficient = 6 * np.pi * viscosity * radius * (radius / c) ** 3

    def factor(eps):
        if isinstance(boundary, sj.Sommerfeld):
            return load_factor(eps) + _opening(eps)
        return load_factor(eps)

    def time_to(eps):
        return coefficient * c / load * quad(factor, 0.0, eps, epsabs=0, epsrel=1e-12, limit=200)[0]

    ratios = np.array([0.2, 0.5, 0.8, 0.95])
    ts = np.array([0.0, *map(time_to, ratios)])
    scene = cases.ball_in_socket(
        sj.Lubricated(clearance=c, viscosity=viscosity, boundary=boundary, e_h0=0.0, e_h1=0.0), 1e-3
    )
    scene = sj.Scene(
        scene.bodies,
        scene.joints,
        {"load": sj.AppliedWrench("ball", force=(0.0, 0.0, -load))},
        gravity=NO_GRAVITY,
        ground_points=scene.ground_points,
    )
    run = sj.simulate(scene, jnp.asarray(ts), rtol=1e-8, atol=1e-14, solver=sj.solvers.Rodas5P()).require_success()
    # The time constant of the inertia, m/(C B), is 1e-8 of the time that is measured.
    assert -np.asarray(run.position("ball"))[1:, 2] / c == pytest.approx(ratios, abs=1e-6)


def _opening(eps):
    """B(-eps)."""
    if eps < 0.05:
        return sum((k + 2) / (k + 3) * (-eps) ** k for k in range(16))
    return -np.log1p(eps) / eps**3 + 1 / (eps**2 * (1 + eps)) + 1 / (2 * eps)

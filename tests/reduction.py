"""Independent references for the spatial four-bar: own equations in minimal coordinates, plain NumPy and SciPy.

Geometry from the paper's Tables 1 and 2. The crank (0.020 m) turns about the x axis at the origin, the rocker
(0.074 m) about the y axis at P; the coupler (0.122 m) is an axisymmetric rod between their ends. No moment acts about
the coupler's axis in the ideal mechanism, so its spin keeps its initial value, zero, and never enters.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

G = 9.81
P = np.array([-0.040, -0.085, 0.0])
CRANK, COUPLER, ROCKER = 0.020, 0.122, 0.074
CRANK_INERTIA = 3.92e-5  # about the x axis, through its center of mass
COUPLER_MASS, COUPLER_ACROSS, COUPLER_ALONG = 0.1416, 1.7743e-3, 3.51e-5
ROCKER_MASS = 0.0316
ROCKER_INERTIA = 1.456e-4 + ROCKER_MASS * (ROCKER / 2) ** 2  # about the y axis through P
TIGHT = {"rtol": 1e-13, "atol": 1e-15, "method": "DOP853"}


class Instant(NamedTuple):
    """The ideal mechanism at one instant."""

    crank_angle: float
    rocker_z: float
    rocker_z_rate: float
    rocker_z_acceleration: float
    reaction: np.ndarray  # of the coupler-rocker joint on the rocker [N]


class _Geometry(NamedTuple):
    """Positions and their first and second derivatives by the crank angle."""

    pin: tuple
    psi: tuple
    end: tuple


def _crank_pin(phi):
    s, c = math.sin(phi), math.cos(phi)
    return (
        CRANK * np.array([0.0, -s, c]),
        CRANK * np.array([0.0, -c, -s]),
        CRANK * np.array([0.0, s, -c]),
    )


def rocker_angle(phi):
    """psi with |pin - end| = COUPLER, on the branch of the initial configuration (the rocker leans to -x)."""
    pin, _, _ = _crank_pin(phi)
    a, b = 2 * ROCKER * P[0], -2 * ROCKER * pin[2]
    c = COUPLER**2 - ROCKER**2 - P[0] ** 2 - (P[1] - pin[1]) ** 2 - pin[2] ** 2
    return math.atan2(a, b) + math.acos(c / math.hypot(a, b))


def _geometry(phi):
    A, A1, A2 = _crank_pin(phi)
    psi = rocker_angle(phi)
    s, c = math.sin(psi), math.cos(psi)
    B = P + ROCKER * np.array([s, 0.0, c])
    Bp, Bpp = ROCKER * np.array([c, 0.0, -s]), ROCKER * np.array([-s, 0.0, -c])
    d = B - A
    psi1 = (d @ A1) / (d @ Bp)  # d . (B' - A') = 0
    d1 = Bp * psi1 - A1
    psi2 = (d @ A2 - d @ Bpp * psi1**2 - d1 @ d1) / (d @ Bp)
    return _Geometry((A, A1, A2), (psi, psi1, psi2), (B, Bp * psi1, Bpp * psi1**2 + Bp * psi2))


def _derivatives(phi):
    """Geometry, the coupler's center and direction with derivatives, generalized inertia and force terms."""
    g = _geometry(phi)
    center = [(a + b) / 2 for a, b in zip(g.pin, g.end, strict=True)]
    u = [(b - a) / COUPLER for a, b in zip(g.pin, g.end, strict=True)]
    psi, psi1, psi2 = g.psi
    M = CRANK_INERTIA + ROCKER_INERTIA * psi1**2 + COUPLER_MASS * center[1] @ center[1] + COUPLER_ACROSS * u[1] @ u[1]
    half_M1 = ROCKER_INERTIA * psi1 * psi2 + COUPLER_MASS * center[1] @ center[2] + COUPLER_ACROSS * u[1] @ u[2]
    V1 = G * (COUPLER_MASS * center[1][2] - ROCKER_MASS * ROCKER / 2 * math.sin(psi) * psi1)
    return g, center, u, M, half_M1, V1


def coupler_center(phi):
    """Center of mass of the coupler [m]."""
    g = _geometry(phi)
    return (g.pin[0] + g.end[0]) / 2


def crank_acceleration(phi, phi_rate):
    """M phi_ddot + M'/2 phi_dot^2 + V' = 0."""
    _, _, _, M, half_M1, V1 = _derivatives(phi)
    return -(half_M1 * phi_rate**2 + V1) / M


def ideal_motion(ts):
    """Crank angle and rate at the times `ts`, from rest at phi = 0."""
    ts = np.asarray(ts, float)
    run = solve_ivp(lambda t, y: [y[1], crank_acceleration(*y)], (0.0, ts[-1]), [0.0, 0.0], t_eval=ts, **TIGHT)
    assert run.success
    return run.y


def turning_points(t_end=2.0):
    """Times at which the crank turns back, and its angles there."""

    def turns(t, y):
        return y[1] if t > 0 else 1e-3

    run = solve_ivp(lambda t, y: [y[1], crank_acceleration(*y)], (0.0, t_end), [0.0, 0.0], events=turns, **TIGHT)
    return run.t_events[0], run.y_events[0][:, 0]


def largest_acceleration(t_low, t_high):
    """Time and value of the largest rocker z_ddot in an interval."""
    run = solve_ivp(lambda t, y: [y[1], crank_acceleration(*y)], (0.0, t_high), [0.0, 0.0], dense_output=True, **TIGHT)

    def z_ddot(t):
        return instant(*run.sol(t)).rocker_z_acceleration

    def slope(t):
        return z_ddot(t + 1e-5) - z_ddot(t - 1e-5)

    at = brentq(slope, t_low, t_high)
    return at, z_ddot(at)


def instant(phi, phi_rate):
    """What is compared, at one state."""
    g, center, u, _, _, _ = _derivatives(phi)
    phi_acceleration = crank_acceleration(phi, phi_rate)

    def second(q):
        return q[1] * phi_acceleration + q[2] * phi_rate**2

    psi, psi_rate, psi_acceleration = g.psi[0], g.psi[1] * phi_rate, second(g.psi)
    half = ROCKER / 2
    gravity = np.array([0.0, 0.0, -G])
    # The coupler's momentum and angular momentum give the force at its end B across its axis; the rocker's equation
    # of motion gives the part along the axis.
    load = COUPLER_MASS * (second(center) - gravity) + 2 * COUPLER_ACROSS / COUPLER * second(u)
    across = (load - (load @ u[0]) * u[0]) / 2
    arm = g.end[0] - P
    weight = np.cross(half / ROCKER * arm, ROCKER_MASS * gravity)[1]
    needed = ROCKER_INERTIA * psi_acceleration - weight
    along = -(needed + np.cross(arm, across)[1]) / np.cross(arm, u[0])[1]
    return Instant(
        phi,
        half * math.cos(psi),
        -half * math.sin(psi) * psi_rate,
        -half * (math.cos(psi) * psi_rate**2 + math.sin(psi) * psi_acceleration),
        -(across + along * u[0]),
    )


# Dry joint with friction, restarted at every onset and release -----------------------------------------------------


class DryJoint(NamedTuple):
    """Lankarani-Nikravesh contact with Threlfall friction in the coupler-rocker joint."""

    clearance: float = 1e-4
    socket_radius: float = 0.010
    restitution: float = 0.9
    mu: float = 0.1
    v1: float = 1e-3
    youngs_modulus: float = 207e9
    poissons_ratio: float = 0.3

    @property
    def stiffness(self):
        ball = self.socket_radius - self.clearance
        compliance = 2 * (1 - self.poissons_ratio**2) / self.youngs_modulus
        return 4 / (3 * compliance) * math.sqrt(self.socket_radius * ball / self.clearance)


def _cross(a, b):
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _relative(y):
    """Eccentricity, its rate, and what they are made of, at y = (phi, psi, eta, phi_dot, psi_dot, omega).

    eta is the coupler's axis, from its rocker end to its crank end; omega its angular velocity.
    """
    phi, psi, eta, phi_rate, psi_rate, omega = y[0], y[1], y[2:5], y[5], y[6], y[7:10]
    A, A1, A2 = _crank_pin(phi)
    s, c = math.sin(psi), math.cos(psi)
    arm = np.array([ROCKER * s, 0.0, ROCKER * c])
    arm_rate = np.array([ROCKER * c * psi_rate, 0.0, -ROCKER * s * psi_rate])
    e = P + arm - A + COUPLER * eta
    e_rate = arm_rate - A1 * phi_rate + COUPLER * _cross(omega, eta)
    return e, e_rate, A1, A2, arm, eta, omega, phi_rate, psi_rate


def _rates(joint, stiffness, onset_rate, y):
    """Kane's equations in (phi_dot, psi_dot, omega); `onset_rate` is None in flight."""
    e, e_rate, A1, A2, arm, eta, omega, phi_rate, psi_rate = _relative(y)
    rho = -COUPLER / 2 * eta
    on_socket = np.zeros(3)
    socket_arm, ball_arm = -COUPLER * eta, arm
    if onset_rate is not None:
        distance = math.sqrt(e @ e)
        n = e / distance
        depth, depth_rate = distance - joint.clearance, e_rate @ n
        if depth > 0:
            chi = 0.75 * (1 - joint.restitution**2)
            normal = stiffness * depth**1.5 * max(0.0, 1 + chi * depth_rate / onset_rate)
            radii = 2 * joint.socket_radius - joint.clearance
            from_ball, from_socket = (radii - distance) / 2 * n, (radii + distance) / 2 * n
            rocker_omega = np.array([0.0, psi_rate, 0.0])
            slip = e_rate + _cross(rocker_omega, from_ball) - _cross(omega, from_socket)
            slip = slip - (slip @ n) * n
            speed = math.sqrt(slip @ slip)
            friction = joint.mu * normal * math.tanh(speed / joint.v1) / speed * slip if speed > 0 else 0 * n
            on_socket = normal * n + friction
            socket_arm = socket_arm + from_socket
            ball_arm = ball_arm + from_ball
    push = COUPLER_MASS * (np.array([0.0, 0.0, -G]) - A2 * phi_rate**2 - _cross(omega, _cross(omega, rho)))
    along = eta @ omega
    gyroscopic = (COUPLER_ALONG - COUPLER_ACROSS) * along * _cross(omega, eta)
    M = np.empty((4, 4))
    M[0, 0] = CRANK_INERTIA + COUPLER_MASS * A1 @ A1
    M[0, 1:] = M[1:, 0] = COUPLER_MASS * _cross(rho, A1)
    across = COUPLER_ACROSS + COUPLER_MASS * (COUPLER / 2) ** 2
    M[1:, 1:] = across * np.eye(3) + (COUPLER_ALONG - across) * np.outer(eta, eta)
    right = np.empty(4)
    right[0] = A1 @ (on_socket + push)
    right[1:] = _cross(socket_arm, on_socket) - gyroscopic + _cross(rho, push)
    solved = np.linalg.solve(M, right)
    rocker = -_cross(ball_arm, on_socket)[1] + arm[0] / 2 * ROCKER_MASS * G
    return np.concatenate(
        [
            [phi_rate, psi_rate],
            _cross(omega, eta),
            [solved[0], rocker / ROCKER_INERTIA],
            solved[1:],
        ]
    )


def dry_motion(t_end, joint=None, rtol=1e-12, atol=1e-15):
    """Final rocker z [m], number of onsets, and the final state of the dry mechanism, from rest and concentric."""
    joint = DryJoint() if joint is None else joint
    stiffness = joint.stiffness
    psi = rocker_angle(0.0)
    A, _, _ = _crank_pin(0.0)
    eta = (A - P - ROCKER * np.array([math.sin(psi), 0.0, math.cos(psi)])) / COUPLER
    y, t, onset_rate, n_onsets = np.array([0.0, psi, *eta, 0.0, 0.0, 0.0, 0.0, 0.0]), 0.0, None, 0

    while t < t_end:
        direction = 1 if onset_rate is None else -1

        def depth(now, y, start=t, direction=direction):
            e = _relative(y)[0]
            # A phase starts on the surface: rounding must not hide the next crossing, nor invent one.
            return math.sqrt(e @ e) - joint.clearance if now > start else -direction * 1e-30

        depth.terminal, depth.direction = True, direction
        run = solve_ivp(
            lambda _, y, onset_rate=onset_rate: _rates(joint, stiffness, onset_rate, y),
            (t, t_end),
            y,
            "DOP853",
            events=depth,
            max_step=2e-4,  # shorter than any flight from wall to wall: none is stepped over
            rtol=rtol,
            atol=atol,
        )
        assert run.success or run.status == 1
        t, y = run.t[-1], run.y[:, -1]
        if run.status == 1:
            if onset_rate is None:
                e, e_rate, *_ = _relative(y)
                onset_rate, n_onsets = e @ e_rate / math.sqrt(e @ e), n_onsets + 1
            else:
                onset_rate = None
    return ROCKER / 2 * math.cos(y[1]), n_onsets, y

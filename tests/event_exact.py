"""A ball in a dry socket without spherejax: flight in closed form, every onset and release located, contact by DOP853.

In flight e(t) = e0 + v0 t + g t^2/2, so |e|^2 - c^2 is a polynomial of degree four. Its real roots are isolated between
those of its derivative, recursively down to a line, so that no crossing can be stepped over. From an onset on, the
displacement since the onset is integrated, with which penetration is formed without cancellation,

    |e|^2 - c^2 = 2 e_onset . x + x . x,    delta = (|e|^2 - c^2)/(|e| + c),

and the release is looked for inside every step, at `LOOKS` points of the dense output and then by bisection.

The ball's center of mass is its center and its inertia is a number, so that its orientation does not matter.
"""

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq

RTOL = 1e-12
"""Of the steps in contact; absolute tolerances are a tenth of it times the depth and the speed of the impact."""

LOOKS = 9
"""Points at which a step in contact is searched for a release."""

MINIMUM_ONSET_RATE = 1e-6
"""What the hysteresis term divides by at least [m/s], as the laws document."""


def hysteresis_factor(law: str, restitution: float) -> float:
    """chi [-] of a normal law, from the published formulas."""
    e = restitution
    if law == "ExactRestitution":
        return _exact_factor(e)
    return {
        "Hertz": 0.0,
        "HuntCrossley": 1.5 * (1 - e),
        "LankaraniNikravesh": 0.75 * (1 - e * e),
        "Gonthier": (1 - e * e) / e,
        "Flores": 1.6 * (1 - e) / e,
    }[law]


def _exact_factor(e: float) -> float:
    """The root of chi (1 + e) = ln[(1 + chi)/(1 - chi e)] in (0, 1/e)."""

    def residual(chi):
        return chi * (1 + e) - math.log1p(chi) + math.log1p(-chi * e)

    # Positive just above zero, where it rises as chi^2; without bound below zero towards 1/e.
    low, high = 1.6 * (1 - e) / 2, (1 - 1e-15) / e
    return 0.0 if e == 1 else brentq(residual, low, high, xtol=1e-15, rtol=1e-14)


def hertzian_stiffness(socket_radius: float, clearance: float, youngs_modulus=207e9, poissons_ratio=0.3) -> float:
    """K [N/m^1.5] of two equal materials (Eq. 24), the socket's radius counted negative."""
    compliance = 2 * (1 - poissons_ratio**2) / youngs_modulus
    ball_radius = socket_radius - clearance
    return 4 / (3 * compliance) * math.sqrt(socket_radius * ball_radius / clearance)


@dataclass(frozen=True)
class Contact:
    """Geometry and laws of one joint.

    Attributes:
        clearance: c [m].
        hysteresis_factor: chi [-].
        stiffness: K [N/m^1.5].
        socket_radius: [m].
        mu: friction coefficient [-]; 0 without friction.
        v1: threshold velocity of mu tanh(v/v1) [m/s].
    """

    clearance: float
    hysteresis_factor: float
    stiffness: float
    socket_radius: float = 0.010
    mu: float = 0.0
    v1: float = 1e-3

    def normal_force(self, penetration: float, rate: float, onset_rate: float) -> float:
        """f_n [N]."""
        if penetration <= 0:
            return 0.0
        damping = 1 + self.hysteresis_factor * rate / max(onset_rate, MINIMUM_ONSET_RATE)
        return self.stiffness * penetration**1.5 * max(damping, 0.0)

    def friction_secant(self, speed: float) -> float:
        """mu(v)/v [s/m]."""
        x = speed / self.v1
        return self.mu / self.v1 * (math.tanh(x) / x if x > 1e-8 else 1.0)

    def depth(self, mass: float, speed: float) -> float:
        """Largest penetration of an elastic impact [m]."""
        return (1.25 * mass * speed**2 / self.stiffness) ** 0.4


@dataclass(frozen=True)
class Ball:
    """A ball and where it starts.

    Attributes:
        mass: [kg].
        inertia: about its center [kg m^2].
        position: eccentricity at the start [m], inside the clearance.
        velocity: [m/s].
        angular_velocity: [rad/s].
        gravity: acceleration vector [m/s^2].
    """

    mass: float
    inertia: float
    position: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    gravity: np.ndarray


@dataclass
class Path:
    """A motion at sample times.

    Attributes:
        ts: sample times [s].
        position, velocity, angular_velocity: at samples, NaN beyond `t_known`.
        touching: whether ball and socket touch at each sample.
        n_onsets: onsets up to each sample.
        onsets: (time, normal velocity) of each onset.
        releases: times.
        t_known: up to where the motion was followed [s].
    """

    ts: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    touching: np.ndarray
    n_onsets: np.ndarray
    onsets: list = field(default_factory=list)
    releases: list = field(default_factory=list)
    t_known: float = math.inf

    def note(self, i, position, velocity, angular_velocity, touching):
        """Record one sample."""
        self.position[i], self.velocity[i], self.angular_velocity[i] = position, velocity, angular_velocity
        self.touching[i], self.n_onsets[i] = touching, len(self.onsets)


def ball_path(ball: Ball, contact: Contact, ts, max_onsets: int = 1000, max_steps: int = 100_000) -> Path:
    """The motion of a ball in its socket.

    Args:
        ball: the ball and its start.
        contact: the joint.
        ts: sample times [s].
        max_onsets: how many impacts are followed.
        max_steps: how many steps of one contact are followed: a ball that stays in contact vibrates there a hundred
            thousand times a second.
    """
    ts = np.asarray(ts, float)
    path = Path(ts, *(np.full((ts.size, 3), np.nan) for _ in range(3)), np.zeros(ts.size, bool), np.zeros(ts.size, int))
    t, e = ts[0], np.array(ball.position, float)
    v, w = np.array(ball.velocity, float), np.array(ball.angular_velocity, float)
    on_surface = False
    while True:
        wait = flight_time(e, v, ball.gravity, contact.clearance, ts[-1] - t, on_surface)
        for i in np.flatnonzero((ts >= t) & (ts < t + wait) | (ts == t)):
            s = ts[i] - t
            path.note(i, e + v * s + ball.gravity * s * s / 2, v + ball.gravity * s, w, False)
        if math.isinf(wait):
            return path
        t = t + wait
        e, v = e + v * wait + ball.gravity * wait * wait / 2, v + ball.gravity * wait
        e *= contact.clearance / np.linalg.norm(e)
        if len(path.onsets) == max_onsets:
            path.t_known = t
            return path
        path.onsets.append((t, float(v @ e) / contact.clearance))
        t, e, v, w = _through_contact(ball, contact, path, t, e, v, w, max_steps)
        if t >= min(ts[-1], path.t_known):
            return path
        path.releases.append(t)
        e *= contact.clearance / np.linalg.norm(e)
        on_surface = True


def flight_time(e, v, gravity, clearance, longest, on_surface) -> float:
    """Time until |e| = clearance is crossed outwards [s]; infinite where it is not within `longest`.

    A ball that has just been released is on the surface: its root at t = 0 is divided out.
    """
    coefficients = [e @ e - clearance**2, 2 * e @ v, v @ v + e @ gravity, v @ gravity, gravity @ gravity / 4]
    if on_surface:
        coefficients = coefficients[1:]
        if coefficients[0] >= 0:
            return 0.0
    # In units of the time to cross the clearance, so that no coefficient over- or underflows.
    unit = min(clearance / max(np.linalg.norm(v), 1e-12), math.sqrt(clearance / max(np.linalg.norm(gravity), 1e-12)))
    scaled = [a * unit**k for k, a in enumerate(coefficients)]
    found = [s for s in real_roots(scaled, 0.0, longest / unit) if s > 0]
    # From below to above: the polynomial is negative at the start, so it is the first root that is crossed.
    return found[0] * unit if found else math.inf


def real_roots(coefficients, low: float, high: float) -> list[float]:
    """Sign changes of a polynomial (lowest coefficient first) in [low, high], increasing."""
    while len(coefficients) > 1 and coefficients[-1] == 0:
        coefficients = coefficients[:-1]
    if len(coefficients) < 2:
        return []

    def value(x):
        total = 0.0
        for a in reversed(coefficients):
            total = total * x + a
        return total

    turns = real_roots([k * a for k, a in enumerate(coefficients)][1:], low, high)
    roots = []
    for a, b in pairwise([low, *turns, high]):
        if value(a) * value(b) < 0:
            roots.append(brentq(value, a, b, xtol=1e-300, rtol=4 * np.finfo(float).eps))
    return roots


def _through_contact(ball: Ball, contact: Contact, path: Path, t_onset, e_onset, v_onset, w_onset, max_steps):
    """From an onset to the release or the end: time, e, v, w there. Samples on the way are noted."""
    ex, ey, ez = map(float, e_onset)
    gx, gy, gz = map(float, ball.gravity)
    c, m, inertia = contact.clearance, ball.mass, ball.inertia
    ball_radius = contact.socket_radius - c
    onset_rate = float(v_onset @ e_onset) / c

    def gap(y):
        """|e|^2 - c^2."""
        return 2 * (ex * y[0] + ey * y[1] + ez * y[2]) + y[0] ** 2 + y[1] ** 2 + y[2] ** 2

    def gap_at(t, dense):
        return gap(dense(t))

    def rate(t, y):
        x, y_, z, vx, vy, vz, wx, wy, wz = y
        nx, ny, nz = ex + x, ey + y_, ez + z
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / length, ny / length, nz / length
        approach = vx * nx + vy * ny + vz * nz
        force = contact.normal_force(gap((x, y_, z)) / (length + c), approach, onset_rate)
        fx, fy, fz = -force * nx, -force * ny, -force * nz
        tx = ty = tz = 0.0
        to_contact = contact.socket_radius - (length + c) / 2
        if contact.mu:
            ux = vx + to_contact * (wy * nz - wz * ny) - approach * nx
            uy = vy + to_contact * (wz * nx - wx * nz) - approach * ny
            uz = vz + to_contact * (wx * ny - wy * nx) - approach * nz
            along = -force * contact.friction_secant(math.sqrt(ux * ux + uy * uy + uz * uz))
            tx, ty, tz = along * ux, along * uy, along * uz
        arm = to_contact / inertia
        return (
            vx,
            vy,
            vz,
            (fx + tx) / m + gx,
            (fy + ty) / m + gy,
            (fz + tz) / m + gz,
            arm * (ny * tz - nz * ty),
            arm * (nz * tx - nx * tz),
            arm * (nx * ty - ny * tx),
        )

    speed = max(float(np.linalg.norm(v_onset)), 1e-9)
    depth = max(contact.depth(m, max(onset_rate, 1e-9)), 1e-15)
    size = np.repeat([depth, speed, speed / ball_radius], 3)
    left = path.ts[-1] - t_onset
    start = np.concatenate([np.zeros(3), v_onset, w_onset])
    solver = DOP853(rate, 0.0, start, left, rtol=RTOL, atol=0.1 * RTOL * size, first_step=min(depth / speed / 20, left))
    pending = list(np.flatnonzero((path.ts >= t_onset) & ~np.isfinite(path.position[:, 0])))

    def note(upto, dense):
        while pending and path.ts[pending[0]] - t_onset <= upto:
            y = dense(path.ts[pending[0]] - t_onset)
            path.note(pending.pop(0), e_onset + y[:3], y[3:6], y[6:9], True)

    for _ in range(max_steps):
        message = solver.step()
        if solver.status == "failed":
            raise RuntimeError(message)
        dense = solver.dense_output()
        looks = np.linspace(solver.t_old, solver.t, LOOKS)
        gaps = [gap(y) for y in dense(looks).T]
        for a, b, gap_b in zip(looks[:-1], looks[1:], gaps[1:], strict=True):
            if gap_b < 0:
                # At the very onset the gap is zero to rounding.
                at = brentq(gap_at, a, b, args=(dense,), xtol=1e-300, rtol=1e-14) if gap(dense(a)) > 0 else b
                note(at, dense)
                y = dense(at)
                return t_onset + at, e_onset + y[:3], y[3:6], y[6:9]
        note(solver.t, dense)
        if solver.status == "finished":
            break
    path.t_known = t_onset + solver.t
    y = solver.y
    return path.t_known, e_onset + y[:3], y[3:6], y[6:9]

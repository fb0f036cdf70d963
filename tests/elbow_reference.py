"""A double pendulum with a dry elbow without spherejax, in the plane, with every onset and release located.

Coordinates are the angles of both rods and the eccentricity e of the elbow itself, so that nothing cancels:

    y = (theta, omega, phi, psi, e_x, e_z, e'_x, e'_z),    rods along u(angle) = (sin, cos) in the x-z plane,

the angles turning about +y. Between events DOP853 integrates with the mode (flight or contact) held; in contact e is
the displacement since the onset. Steps are a fraction of the time to cross the clearance, searched at `LOOKS` points.
"""

import math
from dataclasses import dataclass
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import socket_starts
from event_exact import LOOKS, RTOL, Contact, Path
from scipy.integrate import DOP853
from scipy.optimize import brentq
from socket_starts import MAX_ONSETS, MAX_STEPS, SMALLEST_DISTURBANCE, Exact, Laws, log_uniform

import spherejax as sj

GRAVITY = 9.81
DISTURBANCE = 0.3
"""As for balls, in relative tolerances of the whole pendulum, of which the clearance is a small part. Runs that miss
nothing deviate by 0.03 of that."""

N_COMPARED, N_LATER = socket_starts.N_COMPARED, socket_starts.N_LATER


@dataclass(frozen=True)
class Rods:
    """Masses [kg], lengths [m] and moments of inertia about the centers [kg m^2] of the upper and the lower rod."""

    m1: float
    l1: float
    i1: float
    m2: float
    l2: float
    i2: float


def path(rods: Rods, contact: Contact, start, ts) -> Path:
    """The motion of the elbow: e and e' in three dimensions at the sample times."""
    ts = np.asarray(ts, float)
    found = Path(
        ts, *(np.full((ts.size, 3), np.nan) for _ in range(3)), np.zeros(ts.size, bool), np.zeros(ts.size, int)
    )
    t, y, c = ts[0], np.array(start, float), contact.clearance
    touching = False
    while t < ts[-1]:
        base = y[4:6].copy() if touching else np.zeros(2)
        onset_rate = float(y[6:8] @ y[4:6]) / c if touching else 0.0
        if touching:
            if len(found.onsets) == MAX_ONSETS:
                break
            found.onsets.append((t, onset_rate))
            y[4:6] = 0.0
        t, y, ended = _phase(rods, contact, found, t, y, base, onset_rate, touching)
        y[4:6] += base
        if not ended:
            break
        y[4:6] *= c / np.linalg.norm(y[4:6])
        touching = not touching
    found.t_known = t
    return found


def _phase(rods, contact, found, t0, y0, base, onset_rate, touching):
    """One flight or one contact: time, state, and whether it ended with an event."""
    c, bx, bz = contact.clearance, float(base[0]), float(base[1])
    start_gap = 0.0 if touching else y0[4] ** 2 + y0[5] ** 2 - c * c
    released = not touching and abs(start_gap) < 1e-9 * c * c
    sign = -1.0 if touching else 1.0  # of the gap once the event has passed

    def gap(y):
        if touching:
            return 2 * (bx * y[4] + bz * y[5]) + y[4] ** 2 + y[5] ** 2
        return y[4] ** 2 + y[5] ** 2 - c * c

    def gap_at(t, dense):
        return gap(dense(t))

    def rate(t, y):
        theta, w, phi, psi, x, z, vx, vz = y
        ux, uz = math.sin(theta), math.cos(theta)
        fx = fz = on_upper = on_lower = 0.0
        if touching:
            nx, nz = bx + x, bz + z
            length = math.hypot(nx, nz)
            nx, nz = nx / length, nz / length
            approach = vx * nx + vz * nz
            force = contact.normal_force(gap(y) / (length + c), approach, onset_rate)
            fx, fz = -force * nx, -force * nz
            if contact.mu:
                socket, ball = contact.socket_radius + (length - c) / 2, contact.socket_radius - (length + c) / 2
                turn = ball * psi - socket * w
                sx, sz = vx + turn * nz - approach * nx, vz - turn * nx - approach * nz
                along = -force * contact.friction_secant(math.hypot(sx, sz))
                tx, tz = along * sx, along * sz
                fx, fz = fx + tx, fz + tz
                moment = nz * tx - nx * tz
                on_upper, on_lower = -socket * moment, ball * moment
        rx, rz = rods.l1 * ux, rods.l1 * uz
        moment = rods.m1 * GRAVITY * rx / 2 - (rz * fx - rx * fz) + on_upper
        w_rate = moment / (rods.i1 + rods.m1 * rods.l1**2 / 4)
        qx, qz = -rods.l2 / 2 * math.sin(phi), -rods.l2 / 2 * math.cos(phi)
        psi_rate = (qz * fx - qx * fz + on_lower) / rods.i2
        ax = fx / rods.m2 + psi_rate * qz - psi * psi * qx - w_rate * rz + w * w * rx
        az = fz / rods.m2 - GRAVITY - psi_rate * qx - psi * psi * qz + w_rate * rx + w * w * rz
        return (w, w_rate, psi, psi_rate, vx, vz, ax, az)

    speed = max(math.hypot(y0[6], y0[7]), math.sqrt(2 * GRAVITY * c) * 0.1)
    reduced = 1 / (1 / rods.m2 + rods.l1**2 / (rods.i1 + rods.m1 * rods.l1**2 / 4) + rods.l2**2 / 4 / rods.i2)
    length = max(contact.depth(reduced, max(onset_rate, 1e-9)), 1e-15) if touching else c
    turn = max(abs(y0[1]), abs(y0[3]), math.sqrt(GRAVITY / rods.l1))
    size = np.array([1.0, turn, 1.0, turn, length, length, speed, speed])
    left = found.ts[-1] - t0
    longest = np.inf if touching else 0.2 * c / max(speed, math.sqrt(2 * GRAVITY * c))
    first = min(length / speed / 20, left)
    if released:
        # A ball that rolls along the wall is back on it soon: the first look must come before that.
        inwards = -2 * (y0[4] * y0[6] + y0[5] * y0[7])
        *_, ax, az = rate(0.0, y0)
        outwards = 2 * (y0[6] ** 2 + y0[7] ** 2 + y0[4] * ax + y0[5] * az)
        if inwards > 0 and outwards > 0:
            first = min(first, 0.5 * inwards / outwards)
    solver = DOP853(
        rate, 0.0, y0, left, rtol=RTOL, atol=0.1 * RTOL * size, max_step=longest, first_step=first
    )  # fmt: skip
    pending = list(np.flatnonzero((found.ts >= t0) & ~np.isfinite(found.position[:, 0])))

    def note(upto, dense):
        while pending and found.ts[pending[0]] - t0 <= upto:
            y = dense(found.ts[pending[0]] - t0)
            e, v = (y[4] + bx, 0.0, y[5] + bz), (y[6], 0.0, y[7])
            found.note(pending.pop(0), e, v, (0.0, y[1], 0.0), touching)

    for _ in range(MAX_STEPS):
        message = solver.step()
        if solver.status == "failed":
            raise RuntimeError(message)
        dense = solver.dense_output()
        looks = np.linspace(solver.t_old, solver.t, LOOKS)
        gaps = [gap(y) for y in dense(looks).T]
        if solver.t_old == 0 and (touching or released):
            gaps[0] = -sign * 0.0
        for i in range(1, LOOKS):
            # A phase starts at a gap of zero and moves away from it.
            if sign * gaps[i] > 0 and sign * gaps[i - 1] < 0:
                at = brentq(gap_at, looks[i - 1], looks[i], args=(dense,), xtol=1e-300, rtol=1e-14)
                note(at, dense)
                return t0 + at, dense(at), True
        note(solver.t, dense)
        if solver.status == "finished":
            break
    return t0 + solver.t, np.array(solver.y), False


# Random starts, and the same pendulum in spherejax ---------------------------------------------------------------


def draw(random: np.random.Generator, n: int):
    """Pendulums of one clearance within a factor of two, so that sample times suit them all."""
    clearance, speed = log_uniform(random, 1e-6, 1e-3), log_uniform(random, 5e-3, 0.5)
    starts = [start(random, clearance * random.uniform(0.7, 1.4), speed) for _ in range(n)]
    crossing = clearance / max(speed, math.sqrt(2 * GRAVITY * clearance))
    first = np.linspace(0.0, 2 * MAX_ONSETS * crossing, N_COMPARED, endpoint=False)
    later = np.linspace(2 * MAX_ONSETS, 2 * MAX_ONSETS + log_uniform(random, 8.0, 300.0), N_LATER)
    return starts, np.concatenate([first, later * crossing])


def start(random, clearance: float, speed: float) -> dict[str, np.ndarray]:
    """Rods of random size, angles and rates; the ball anywhere in the clearance, at a random velocity."""
    m1, m2 = log_uniform(random, 0.1, 2.0), log_uniform(random, 0.1, 2.0)
    l1, l2 = log_uniform(random, 0.1, 0.6), log_uniform(random, 0.1, 0.6)
    rates = random.normal(size=2) * random.choice([0.0, 3.0])
    angle, shift = random.uniform(0, 2 * np.pi, 2)
    place = clearance * random.choice([0.0, random.uniform(0, 0.95)]) * np.array([np.sin(shift), np.cos(shift)])
    velocity = speed * np.array([np.sin(angle), np.cos(angle)])
    numbers = {
        "rods": [m1, l1, m1 * l1**2 / 12, m2, l2, m2 * l2**2 / 12],
        "state": [
            *random.uniform(0, 2 * np.pi, 1),
            rates[0],
            *random.uniform(0, 2 * np.pi, 1),
            rates[1],
            *place,
            *velocity,
        ],
        "clearance": clearance,
        "restitution": random.uniform(0.2, 0.99),
        "mu": random.uniform(0.0, 0.3),
        "v1": max(1e-3, speed * log_uniform(random, 0.02, 0.5)),
    }
    return {key: np.asarray(value, float) for key, value in numbers.items()}


def exact(laws: Laws, numbers, ts, rtol: float, random) -> Exact:
    """The reference with two disturbed companions; places are judged as spherejax documents, against 1e4 clearances."""
    ts = ts[:N_COMPARED]
    rods, clearance = Rods(*map(float, numbers["rods"])), float(numbers["clearance"])
    reach = rods.l1 + rods.l2
    pace = math.sqrt(GRAVITY * reach) + float(np.abs(numbers["state"][[1, 3]]).max()) * reach
    crossing = max(float(np.linalg.norm(numbers["state"][6:])), math.sqrt(2 * GRAVITY * clearance))
    length = max(DISTURBANCE * rtol * min(reach, 1e4 * clearance), SMALLEST_DISTURBANCE * clearance)
    pace = max(DISTURBANCE * rtol * pace, SMALLEST_DISTURBANCE * crossing)
    true = path(rods, laws.contact(numbers), numbers["state"], ts)
    place, speed = np.zeros(ts.size), np.zeros(ts.size)
    for _ in range(2):
        scale = np.array([length / reach, pace / reach, length / reach, pace / reach, length, length, pace, pace])
        # At loose tolerances the disturbance may be as large as the clearance itself.
        moved = {**numbers, "clearance": clearance * math.exp(math.tanh(length * random.normal() / clearance))}
        other = path(rods, laws.contact(moved), numbers["state"] + scale * random.normal(size=8), ts)
        fly = (other.n_onsets == true.n_onsets) & ~true.touching & ~other.touching
        place = np.maximum(place, np.linalg.norm(other.position - true.position, axis=1))
        speed = np.maximum(speed, np.where(fly, np.linalg.norm(other.velocity - true.velocity, axis=1), 0.0))
    place, speed = (np.maximum.accumulate(np.where(np.isnan(x), np.inf, x)) for x in (place, speed))
    return Exact(true, place + length, speed + pace)


def scene(laws: Laws, numbers) -> sj.Scene:
    """The same pendulum in spherejax."""
    m1, l1, i1, m2, l2, i2 = numbers["rods"]
    theta, w, phi, psi, x, z, vx, vz = numbers["state"]
    ux, uz = jnp.sin(theta), jnp.cos(theta)
    px, pz = jnp.sin(phi), jnp.cos(phi)
    top, top_speed = (l1 * ux + x, l1 * uz + z), (l1 * w * uz + vx, -l1 * w * ux + vz)

    def rod(mass, inertia, length, center, velocity, angle, turn):
        half = (angle - jnp.pi / 2) / 2
        zero = jnp.zeros(())
        return sj.Body(
            mass,
            jnp.stack([0.1 * inertia, inertia, inertia]),
            position=jnp.stack([center[0], zero, center[1]]),
            quaternion=jnp.stack([jnp.cos(half), zero, jnp.sin(half), zero]),
            velocity=jnp.stack([velocity[0], zero, velocity[1]]),
            angular_velocity=jnp.stack([zero, turn, zero]),
            points={"start": jnp.stack([-length / 2, zero, zero]), "end": jnp.stack([length / 2, zero, zero])},
        )

    bodies = {
        "upper": rod(m1, i1, l1, (l1 * ux / 2, l1 * uz / 2), (l1 * w * uz / 2, -l1 * w * ux / 2), theta, w),
        "lower": rod(
            m2,
            i2,
            l2,
            (top[0] + l2 * px / 2, top[1] + l2 * pz / 2),
            (top_speed[0] + l2 * psi * pz / 2, top_speed[1] - l2 * psi * px / 2),
            phi,
            psi,
        ),
    }
    law = getattr(sj.laws, laws.normal)
    normal = law() if laws.normal == "Hertz" else law(restitution=numbers["restitution"])
    friction = sj.Threlfall(mu=numbers["mu"], v1=numbers["v1"]) if laws.friction else None
    elbow = sj.Dry(numbers["clearance"], normal=normal, friction=friction)
    return sj.Scene(
        bodies,
        {
            "shoulder": sj.Spherical("ground.pivot", "upper.start"),
            "joint": sj.Spherical("upper.end", "lower.start", elbow, starts_concentric=False),
        },
        gravity=(0.0, 0.0, -GRAVITY),
        ground_points={"pivot": (0.0, 0.0, 0.0)},
    )


@cache
def compiled(laws: Laws):
    """(numbers, ts, rtol) -> histories, one program for all pendulums of these laws."""

    def outcome(numbers, ts, rtol):
        run = sj.simulate(scene(laws, numbers), ts, rtol=rtol, max_steps=400_000)
        return socket_starts.read(run, run.eccentricity("joint"), run.eccentricity_rate("joint"))

    return jax.jit(outcome)


def single(laws: Laws, numbers, ts, rtol) -> dict[str, np.ndarray]:
    """One run by `sj.simulate`."""
    return jax.tree.map(np.asarray, compiled(laws)(numbers, jnp.asarray(ts), jnp.asarray(rtol)))


def judge(numbers, ts, rtol: float, run, reference: Exact):
    """The run of a pendulum against its reference."""
    m1, l1, _, m2, l2, _ = map(float, numbers["rods"])
    w, psi = numbers["state"][[1, 3]]
    swing = (m1 + m2) * GRAVITY * (l1 + l2)
    motion = m1 * (w * l1) ** 2 / 2 + m2 * (abs(w) * l1 + abs(psi) * l2) ** 2 / 2
    return socket_starts.judged(float(numbers["clearance"]), swing + motion, ts, rtol, run, reference)

"""Independent reference for impacts with friction: a ball in a fixed socket, in a plane, plain NumPy and SciPy.

The ball starts off the socket's center, so its impacts are oblique and friction sets it spinning. The motion is
restarted at every onset and release, so the integrator sees smooth equations only; its derivatives are differences of
fourth order.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

INERTIA, POISSON, V1, OFFSET = 1e-5, 0.3, 1e-2, 4e-5  # [kg m^2, -, m/s, m]
NUMBERS = {
    "clearance": 1e-4,
    "restitution": 0.9,
    "modulus": 207e9,
    "mass": 0.1,
    "speed": 0.05,
    "socket_radius": 0.010,
    "mu": 0.1,
}
VALUES = np.array(list(NUMBERS.values()))
SCALE = np.array([1e-4, 1e-4, 0.05, 0.05, 1.0])
"""Sizes of the entries of the state (x, y, x_rate, y_rate, spin)."""


class Bounces(NamedTuple):
    """A motion.

    Attributes:
        states: (x, y, x_rate, y_rate, spin) at the sample times, shape (n, 5) [m, m/s, rad/s].
        onset_times: of all impacts [s].
        onset_rates: normal velocities at these instants [m/s].
    """

    states: np.ndarray
    onset_times: np.ndarray
    onset_rates: np.ndarray


def _rates(values, onset_rate):
    c, restitution, modulus, mass, _, radius, mu = values
    ball = radius - c
    stiffness = 4 / 3 * modulus / (2 * (1 - POISSON**2)) * np.sqrt(radius * ball / c)
    chi = 0.75 * (1 - restitution**2)

    def rates(_, s):
        x, y, vx, vy, spin = s
        distance = np.hypot(x, y)
        nx, ny = x / distance, y / distance
        depth = distance - c
        if onset_rate is None or depth <= 0:
            return [vx, vy, 0.0, 0.0, 0.0]
        normal = stiffness * depth**1.5 * max(0.0, 1 + chi * (vx * nx + vy * ny) / onset_rate)
        arm = ball - depth / 2  # the surfaces meet half-way
        friction = -mu * normal * np.tanh((vy * nx - vx * ny + spin * arm) / V1)
        ax, ay = -normal * nx - friction * ny, -normal * ny + friction * nx
        return [vx, vy, ax / mass, ay / mass, arm * friction / INERTIA]

    return rates


def bounces(values, ts) -> Bounces:
    """The motion with the numbers `values`, in the order of `NUMBERS`, sampled at the increasing times `ts`."""
    t, s, onset_rate = 0.0, np.array([0.0, OFFSET, values[4], 0.0, 0.0]), None
    states, times, rates = [], [], []
    for sample in ts:
        while t < sample:
            sign = 1 if onset_rate is None else -1

            def depth(now, s, start=t, sign=sign):
                # A phase starts on the surface: rounding must not hide the next crossing, nor invent one.
                return np.hypot(s[0], s[1]) - values[0] if now > start else -sign * 1e-30

            depth.terminal, depth.direction = True, sign
            atol = 1e-17 * np.array([1, 1, 1e3, 1e3, 1e5])
            run = solve_ivp(_rates(values, onset_rate), (t, sample), s, "DOP853", events=depth, rtol=1e-13, atol=atol)
            assert run.success
            t, s = run.t[-1], run.y[:, -1]
            if run.status == 1 and onset_rate is None:
                onset_rate = (s[0] * s[2] + s[1] * s[3]) / np.hypot(s[0], s[1])
                times.append(t)
                rates.append(onset_rate)
            elif run.status == 1:
                onset_rate = None
        states.append(s)
    return Bounces(np.array(states), np.array(times), np.array(rates))


def slopes(ts, h) -> Bounces:
    """Derivatives by the logarithms of all numbers (a last axis), by differences over +-h and +-2h."""
    columns = []
    for e in np.eye(len(VALUES)):
        low2, low, high, high2 = (bounces(VALUES * (1 + k * h * e), ts) for k in (-2, -1, 1, 2))
        columns.append(
            Bounces(*((a - 8 * b + 8 * c - d) / (12 * h) for a, b, c, d in zip(low2, low, high, high2, strict=True)))
        )
    return Bounces(*(np.stack(column, -1) for column in zip(*columns, strict=True)))

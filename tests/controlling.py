"""Motors under control, and what becomes of them by linear algebra: the references of `test_controllers`."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.linalg import expm
from scipy.signal import cont2discrete

import spherejax as sj

ROTOR = sj.Turn(("ground", "rotor"), axis=(0.0, 0.0, 1.0))
STIFFNESS, DAMPING, SPEED = 0.3, 0.02, 0.5
"""Of the torsion spring [N m/rad, N m s/rad], and how fast the rotor turns at the start [rad/s]."""

ROTOR_FILE = """
gravity = [0, 0, 0]

[bodies.rotor]
mass = 1.0
inertia = [0.01, 0.01, 0.02]

[joints.bearing]
kind = "revolute"
bodies = ["ground", "rotor"]
point = [0, 0, 0]
axis = [0, 0, 1]

[forces.motor]
"""
"""A file of a rotor in its bearing, up to the lines of its motor."""

GAINS: dict[str, Any] = dict(proportional=0.8, integral=2.0, derivative=0.05, filter_time=0.02)


def motor(
    control: sj.forces.AbstractForce, inertia: Any = 0.02, speed: Any = SPEED, **more: sj.forces.AbstractForce
) -> sj.Scene:
    """A rotor on a torsion spring, and what drives it."""
    rotor = sj.Body(1.0, jnp.stack([0.01, 0.01, jnp.asarray(inertia)]), angular_velocity=(0.0, 0.0, speed))
    bearing = sj.Revolute(("ground", "rotor"), point=(0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0))
    spring = sj.TorsionalSpring(("ground", "rotor"), (0.0, 0.0, 1.0), STIFFNESS, DAMPING)
    return sj.Scene(
        {"rotor": rotor}, {"bearing": bearing}, {"motor": control, "spring": spring, **more}, gravity=(0.0, 0.0, 0.0)
    )


def sampled_motor(period: Any, inertia: Any = 0.02, **gains: Any) -> sj.Scene:
    """The motor with a digital controller."""
    return motor(sj.forces.SampledPID(ROTOR, period, 1.5, **{**GAINS, **gains}), inertia)


def sampled_answer(
    ts: np.ndarray,
    period: float = 0.01,
    inertia: float = 0.02,
    *,
    proportional: float = GAINS["proportional"],
    integral: float = GAINS["integral"],
    derivative: float = GAINS["derivative"],
    filter_time: float = GAINS["filter_time"],
    first: float = 0.0,
    delayed: bool = False,
) -> np.ndarray:
    """Angle, speed and torque at the times, exactly: the plant by matrix exponentials between the samples."""
    A = np.array([[0.0, 1.0], [-STIFFNESS / inertia, -DAMPING / inertia]])
    B = np.array([[0.0], [1 / inertia]])

    def moved(x, torque, span):
        if span <= 0:
            return x
        discrete, by_input, *_ = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), span, method="zoh")
        return discrete @ x + by_input[:, 0] * torque

    nodes, x, torque, coming, i, z = [], np.array([0.0, SPEED]), 0.0, 0.0, 0.0, 1.5
    nodes.append((0.0, x, torque))
    x = moved(x, 0.0, first)
    for k in range(int(np.ceil((ts[-1] - first) / period)) + 2):
        e = 1.5 - x[0]
        difference = (e - z) / (period + filter_time)
        wanted = proportional * e + i + derivative * difference
        i, z = i + period * integral * e, z + period * difference
        torque, coming = (coming, wanted) if delayed else (wanted, wanted)
        nodes.append((first + k * period, x, torque))
        x = moved(x, torque, period)
    starts = np.array([node[0] for node in nodes])
    rows = []
    for t in ts:
        start, at_start, torque = nodes[int(np.searchsorted(starts, t + 1e-12, side="right")) - 1]
        rows.append([*moved(at_start, torque, t - start), torque])
    return np.array(rows)


def continuous_answer(ts: np.ndarray, reference: tuple[float, float], inertia: float, speed: float) -> np.ndarray:
    """Angle, speed, integral, filtered error and torque of a free rotor with `sj.PID` and a ramp for a reference."""
    offset, slope = reference
    kp, ki, kd, time = (GAINS[name] for name in ("proportional", "integral", "derivative", "filter_time"))
    unit = np.eye(6)  # angle, speed, integral, filtered error, 1, t
    error = offset * unit[4] + slope * unit[5] - unit[0]
    rate = (error - unit[3]) / time
    torque = kp * error + unit[2] + kd * rate
    A = np.zeros((6, 6))
    A[0], A[1] = unit[1], torque / inertia
    A[2], A[3], A[5] = ki * error, rate, unit[4]
    start = np.array([0.0, speed, 0.0, offset, 1.0, 0.0])
    states = np.array([expm(A * t) @ start for t in ts])
    return np.column_stack([states[:, :4], states @ torque])


class NeuralForce(sj.forces.AbstractForce):
    """A force along x by place and speed, of a network."""

    network: sj.Network

    @property
    def body_names(self):
        """The ball."""
        return ("ball",)

    def wrenches(self, t, motions):
        """The network's value along x."""
        ball = motions["ball"]
        force = self.network(jnp.stack([ball.position[0], ball.velocity[0]]))
        return {"ball": sj.forces.Wrench(jnp.stack([force, 0.0 * force, 0.0 * force]), jnp.zeros(3))}

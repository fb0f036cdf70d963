"""Whether the coefficients of a linearization are constant: at rest, and in steady motion seen from the right axes."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.motion.start.tolerances import length_scale, time_scale
from spherejax.studies.linear.coordinates import Coordinates, coordinates_of
from spherejax.studies.linear.point import OperatingPoint
from spherejax.studies.linear.tangent import TangentEquations, moved

STEP = 1e-5
"""Time after which the coefficients are looked at again, as a share of the mechanism's own time and of the time in
which a body turns by one radian."""

CONSTANT = 1e-4
"""Changes of the coefficients [share per time scale] below this are rounding; measured for rest positions: 1e-7."""

RESTING = 1e-7
"""Accelerations [lengths per square of the time scale] below this are rounding; `equilibrium` leaves 1e-9."""


class Steadiness(NamedTuple):
    """How far a state is from one about which coefficients are constant.

    Attributes:
        acceleration: of the mechanism in the axes that were asked for, as a share of its length over the square of
            its time scale.
        change: of the coefficients in its time scale, as a share of them.
    """

    acceleration: float
    change: float

    @property
    def is_steady(self) -> bool:
        """Whether the coefficients are constant."""
        return self.acceleration < RESTING and self.change < CONSTANT


def steadiness_of(
    point: OperatingPoint,
    turning: Float[np.ndarray, "3"],
    coordinates: Coordinates,
    slopes: Float[np.ndarray, "n_z n_x"],
    rates: Float[np.ndarray, " n_z"],
) -> Steadiness:
    """Look at accelerations, and at the coefficients a moment later.

    Args:
        point: the state.
        turning: angular velocity of the axes [rad/s].
        coordinates: about the state.
        slopes: of the rates along the coordinates.
        rates: of the state.
    """
    system, layout = point.system, point.system.layout
    n_v = layout.n_velocity
    time, length = (float(np.asarray(scale(system))) for scale in (time_scale, length_scale))
    velocity = point.y[layout.n_position : layout.memory_start]
    seen = rates[n_v : 2 * n_v].reshape(-1, 3) - np.cross(turning, velocity.reshape(-1, 3))
    free = coordinates.free @ (coordinates.free.T @ (coordinates.mass @ seen.ravel()))
    by_kind = np.tile([1 / length] * 3 + [1.0] * 3, n_v // 6)
    acceleration = float(np.max(np.abs(free * by_kind), initial=0.0)) * time**2
    acceleration += float(np.max(np.abs(rates[2 * n_v :]), initial=0.0)) * time / length
    fastest = max(float(np.max(np.abs(velocity * by_kind))), float(np.linalg.norm(turning)), 1 / time)
    step = STEP / fastest
    change = np.concatenate([velocity, rates[n_v:]]) * step
    y = np.asarray(moved(layout, jnp.asarray(point.y), jnp.asarray(change)))
    after = TangentEquations(point.structure, point.theta, point.t + step, y)
    then = coordinates_of(after.geometry, layout.n_memory)
    if then.degrees_of_freedom != coordinates.degrees_of_freedom:
        return Steadiness(acceleration, np.inf)
    found = after.rates_along(turning, then.basis)
    later = then.basis @ (then.inverse @ found) @ then.inverse
    whole = coordinates.basis @ (coordinates.inverse @ slopes) @ coordinates.inverse
    turned = _turned(turning * step, n_v, layout.n_memory)
    difference = turned.T @ later @ turned - whole
    # Rows and columns in units of one kind, so that a stiff joint does not hide a change elsewhere more than it must.
    units = np.concatenate([by_kind, by_kind * time, np.full(layout.n_memory, 1 / length)])
    balanced = [np.linalg.norm(units[:, None] * each / units) for each in (difference, whole)]
    return Steadiness(acceleration, float(balanced[0] / max(balanced[1], 1e-300) * time / step))


def _turned(turn: np.ndarray, n_v: int, n_memory: int) -> np.ndarray:
    """The matrix that turns every vector of a change of state; memory stays."""
    angle = np.linalg.norm(turn)
    x, y, z = turn / angle if angle > 0 else turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)
    whole = np.eye(2 * n_v + n_memory)
    whole[: 2 * n_v, : 2 * n_v] = np.kron(np.eye(2 * n_v // 3), rotation)
    return whole

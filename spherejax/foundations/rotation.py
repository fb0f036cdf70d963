"""Rotations by unit quaternions (Euler parameters), scalar first: p = (p0, p1, p2, p3).

`rotation_matrix(p)` turns components in body axes into components in world axes, s = A s'. Angular velocities
are in world axes [rad/s].
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from spherejax.foundations.types import Matrix3, Quaternion, Vector3

_SMALL_ANGLE = 1e-4
"""Half angles below this [rad] use a series: its first neglected term, x^4 / 120, is below float64's resolution."""


def _namespace(*arrays: Any) -> Any:
    """NumPy for its own arrays: what is known at once needs no compiler."""
    return np if all(isinstance(array, np.ndarray) for array in arrays) else jnp


def rotation_matrix(quaternion: Quaternion) -> Matrix3:
    """Rotation matrix A of a quaternion; a rotation whatever the quaternion's norm.

    Source: Nikravesh (1988), Computer-Aided Analysis of Mechanical Systems; A = (2 p0^2 - 1) I + 2 (p p^T + p0 p~)
    for a unit quaternion, divided by the square of its norm, so that A does not change along p.

    Limits: undefined for the zero quaternion.
    """
    p0, p1, p2, p3 = quaternion
    twice = 2 / (p0 * p0 + p1 * p1 + p2 * p2 + p3 * p3)
    t1, t2, t3 = twice * p1, twice * p2, twice * p3
    return _namespace(quaternion).array(
        [
            [1 - (t2 * p2 + t3 * p3), t1 * p2 - t3 * p0, t1 * p3 + t2 * p0],
            [t1 * p2 + t3 * p0, 1 - (t1 * p1 + t3 * p3), t2 * p3 - t1 * p0],
            [t1 * p3 - t2 * p0, t2 * p3 + t1 * p0, 1 - (t1 * p1 + t2 * p2)],
        ]
    )


def quaternion_rate(quaternion: Quaternion, angular_velocity: Vector3) -> Quaternion:
    """Time derivative p_dot = (0, w) p / 2 [1/s] for an angular velocity w in world axes [rad/s]."""
    p0, p1, p2, p3 = quaternion
    wx, wy, wz = angular_velocity
    return 0.5 * jnp.array(
        [
            -p1 * wx - p2 * wy - p3 * wz,
            p0 * wx + p3 * wy - p2 * wz,
            -p3 * wx + p0 * wy + p1 * wz,
            p2 * wx - p1 * wy + p0 * wz,
        ]
    )


def quaternion_product(left: Quaternion, right: Quaternion) -> Quaternion:
    """Quaternion of the rotation `right` followed by the rotation `left`."""
    a0, a1, a2, a3 = left
    b0, b1, b2, b3 = right
    return _namespace(left, right).array(
        [
            a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3,
            a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2,
            a0 * b2 - a1 * b3 + a2 * b0 + a3 * b1,
            a0 * b3 + a1 * b2 - a2 * b1 + a3 * b0,
        ]
    )


def conjugate(quaternion: Quaternion) -> Quaternion:
    """Quaternion of the inverse rotation."""
    return quaternion * np.array([1.0, -1.0, -1.0, -1.0])


def normalized(quaternion: Quaternion) -> Quaternion:
    """The quaternion divided by its norm. Limits: undefined for the zero quaternion."""
    xp = _namespace(quaternion)
    return quaternion / xp.sqrt(xp.sum(quaternion * quaternion))


def rotation_vector(quaternion: Quaternion) -> Vector3:
    """Rotation vector (axis times angle) [rad] of a unit quaternion, of length up to 2 pi, as its sign says: those of
    a motion keep theirs, so that the vector goes on through half a turn, where one of at most pi jumps.

    Limits: at the identity the value is 0 and the derivative 2 dp_(1..3); at an angle of 2 pi, where there is no axis,
    value and derivative stay finite.
    """
    p0, vector = quaternion[0], quaternion[1:]
    square = jnp.sum(vector * vector)
    is_small = square < _SMALL_ANGLE**2
    sine = jnp.sqrt(jnp.where(is_small, 1.0, square))
    general = 2 * jnp.arctan2(sine, jnp.where(is_small, 1.0, p0)) / sine
    series = 2 / jnp.where(is_small, p0, 1.0) * (1 - square / (3 * jnp.where(is_small, p0 * p0, 1.0)))
    return jnp.where(is_small, series, general) * vector


def quaternion_from_rotation_vector(vector: Vector3) -> Quaternion:
    """Unit quaternion of a rotation vector [rad]. Limits: at 0 the identity, with derivative (0, I/2)."""
    square = jnp.sum(vector * vector) / 4
    is_small = square < _SMALL_ANGLE**2
    half = jnp.sqrt(jnp.where(is_small, 1.0, square))
    ratio = jnp.where(is_small, 1 - square / 6, jnp.sin(half) / half)
    cosine = jnp.where(is_small, 1 - square / 2 + square * square / 24, jnp.cos(half))
    return jnp.concatenate([cosine[None], ratio * vector / 2])


def skew(a: Vector3) -> Matrix3:
    """The matrix a~ with a~ b = a x b."""
    zero = jnp.zeros_like(a[0])
    return jnp.array([[zero, -a[2], a[1]], [a[2], zero, -a[0]], [-a[1], a[0], zero]])

"""Motion of bodies, of points on them, and of a ball in its socket (Eqs 11 to 15).

Sign convention, everywhere: body i carries the socket and body j the ball; the eccentricity runs from the socket's
center to the ball's center; a joint reports the force on the ball's body.
"""

from typing import NamedTuple

import jax.numpy as jnp

from spherejax.foundations.rotation import rotation_matrix
from spherejax.foundations.types import Matrix3, Quaternion, Vector3


class BodyMotion(NamedTuple):
    """Where one body is and how it moves.

    Attributes:
        position: center of mass, world axes [m].
        quaternion: body axes to world axes.
        rotation: the rotation matrix A of the quaternion.
        velocity: of the center of mass, world axes [m/s].
        angular_velocity: world axes [rad/s].
    """

    position: Vector3
    quaternion: Quaternion
    rotation: Matrix3
    velocity: Vector3
    angular_velocity: Vector3


class PointMotion(NamedTuple):
    """Where a point of a body is and how it moves.

    Attributes:
        arm: from the body's center of mass to the point, world axes [m].
        position: world axes [m].
        velocity: world axes [m/s].
    """

    arm: Vector3
    position: Vector3
    velocity: Vector3


class RelativeMotion(NamedTuple):
    """What every model of a spherical joint is told: the motion of the ball in its socket.

    Attributes:
        eccentricity: e, from socket center to ball center, world axes [m].
        eccentricity_rate: time derivative of e in world axes [m/s].
        socket_rotation: socket axes to world axes (the axes of the socket's body).
        relative_quaternion: rotation of the ball's body against the socket's body since the start, in socket axes.
        socket_angular_velocity: world axes [rad/s].
        ball_angular_velocity: world axes [rad/s].
        ball_rotation: axes of the ball's body to world axes; None where nobody asks for them.
    """

    eccentricity: Vector3
    eccentricity_rate: Vector3
    socket_rotation: Matrix3
    relative_quaternion: Quaternion
    socket_angular_velocity: Vector3
    ball_angular_velocity: Vector3
    ball_rotation: Matrix3 | None = None


def body_motion(position: Vector3, quaternion: Quaternion, velocity: Vector3, angular_velocity: Vector3) -> BodyMotion:
    """Motion of one body, with its rotation matrix."""
    return BodyMotion(position, quaternion, rotation_matrix(quaternion), velocity, angular_velocity)


def ground_motion() -> BodyMotion:
    """The motion of the ground: none."""
    zero = jnp.zeros(3)
    return BodyMotion(zero, jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.eye(3), zero, zero)


def point_motion(body: BodyMotion, place: Vector3) -> PointMotion:
    """Motion of the point at `place` (body axes [m]): r + A s', r_dot + w x A s' (Eqs 4 and 6)."""
    arm = body.rotation @ place
    return PointMotion(arm, body.position + arm, body.velocity + jnp.cross(body.angular_velocity, arm))


def centripetal_acceleration(body: BodyMotion, arm: Vector3) -> Vector3:
    """w x (w x s) [m/s^2]: the part of a point's acceleration that the body's accelerations do not carry."""
    return jnp.cross(body.angular_velocity, jnp.cross(body.angular_velocity, arm))

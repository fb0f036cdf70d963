"""Constraint equations between two bodies: the elementary ones written out, any other by differentiation.

Equations may depend on time, Phi(t, q) = 0. Then Phi_dot = D v + Phi_t, and D (accelerations) = gamma.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.rotation import quaternion_rate, skew
from spherejax.foundations.types import Scalar, Vector3
from spherejax.physics.kinematics import BodyMotion, centripetal_acceleration, point_motion


class ConstraintRows(NamedTuple):
    """Constraint equations between two bodies i and j, Phi = 0.

    Attributes:
        residual: Phi [m or 1], shape (n,).
        jacobians: D_i and D_j with Phi_dot = D_i (v_i, w_i) + D_j (v_j, w_j) + Phi_t, each of shape (n, 6).
        bias: gamma, with D (accelerations) = gamma [m/s^2 or 1/s^2], shape (n,); Phi_tt is part of it.
        rate_at_rest: Phi_t, what Phi changes with time alone [m/s or 1/s], shape (n,); zeros for what is not driven.
    """

    residual: Float[Array, " n"]
    jacobians: tuple[Float[Array, "n 6"], Float[Array, "n 6"]]
    bias: Float[Array, " n"]
    rate_at_rest: Float[Array, " n"]


def coincidence_rows(body_i: BodyMotion, body_j: BodyMotion, place_i: Vector3, place_j: Vector3) -> ConstraintRows:
    """Two points coincide: Phi = r_j + s_j - r_i - s_i, D = [-I, s_i~, I, -s_j~].

    gamma = w_i x (w_i x s_i) - w_j x (w_j x s_j).

    Source: the paper, Eqs 3 to 10, with the dots of Eq. 10 restored.
    """
    point_i, point_j = point_motion(body_i, place_i), point_motion(body_j, place_j)
    identity = jnp.eye(3)
    return ConstraintRows(
        point_j.position - point_i.position,
        (
            jnp.concatenate([-identity, skew(point_i.arm)], 1),
            jnp.concatenate([identity, -skew(point_j.arm)], 1),
        ),
        centripetal_acceleration(body_i, point_i.arm) - centripetal_acceleration(body_j, point_j.arm),
        jnp.zeros(3),
    )


def perpendicularity_row(
    body_i: BodyMotion, body_j: BodyMotion, direction_i: Vector3, direction_j: Vector3
) -> ConstraintRows:
    """Two directions, fixed in the bodies, stay perpendicular: Phi = b . u, one equation.

    With b = A_i b', u = A_j u': Phi_dot = w_i . (b x u) + w_j . (u x b), and
    gamma = -[(w_i x (w_i x b)) . u + 2 (w_i x b) . (w_j x u) + b . (w_j x (w_j x u))].
    """
    b, u = body_i.rotation @ direction_i, body_j.rotation @ direction_j
    b_rate, u_rate = jnp.cross(body_i.angular_velocity, b), jnp.cross(body_j.angular_velocity, u)
    bias = -(
        jnp.cross(body_i.angular_velocity, b_rate) @ u
        + 2 * (b_rate @ u_rate)
        + b @ jnp.cross(body_j.angular_velocity, u_rate)
    )
    normal = jnp.cross(b, u)
    zero = jnp.zeros(3)
    return ConstraintRows(
        jnp.stack([b @ u]),
        (jnp.concatenate([zero, normal])[None], jnp.concatenate([zero, -normal])[None]),
        jnp.stack([bias]),
        jnp.zeros(1),
    )


def plane_row(
    body_i: BodyMotion, body_j: BodyMotion, place_i: Vector3, place_j: Vector3, normal_i: Vector3
) -> ConstraintRows:
    """A point of body j stays in a plane of body i: Phi = b . d [m], d from the plane's point to the body's point.

    With b = A_i b' of unit length: Phi_dot = b . (v_j + w_j x s_j - v_i) + w_i . (b x (d + s_i)), and
    gamma = -[(w_i x (w_i x b)) . d + 2 (w_i x b) . d_dot + b . (w_j x (w_j x s_j) - w_i x (w_i x s_i))].
    """
    b = body_i.rotation @ normal_i
    point_i, point_j = point_motion(body_i, place_i), point_motion(body_j, place_j)
    d, d_rate = point_j.position - point_i.position, point_j.velocity - point_i.velocity
    b_rate = jnp.cross(body_i.angular_velocity, b)
    drawn = centripetal_acceleration(body_j, point_j.arm) - centripetal_acceleration(body_i, point_i.arm)
    bias = -(jnp.cross(body_i.angular_velocity, b_rate) @ d + 2 * (b_rate @ d_rate) + b @ drawn)
    return ConstraintRows(
        jnp.stack([b @ d]),
        (
            jnp.concatenate([-b, jnp.cross(b, d + point_i.arm)])[None],
            jnp.concatenate([b, jnp.cross(point_j.arm, b)])[None],
        ),
        jnp.stack([bias]),
        jnp.zeros(1),
    )


Residual = Callable[[Scalar, BodyMotion, BodyMotion], Float[Array, " n"]]
"""Phi(t, motion of body i, motion of body j) [m or 1]; it may read positions and orientations, not velocities."""


def differentiated_rows(
    residual: Residual, t: Scalar, body_i: BodyMotion, body_j: BodyMotion, *, is_driven: bool = True
) -> ConstraintRows:
    """The rows of any smooth Phi(t, q): D by forward mode, Phi_t by its own, gamma by differentiating twice along v.

    Along the motion with constant v and w, Phi_ddot = -gamma. Exact: nothing is approximated by differences.

    Args:
        residual: Phi.
        t: time [s].
        body_i: motion of the first body.
        body_j: motion of the second body.

    Other args:
        is_driven: whether Phi depends on time.
    """

    def at(changes: Float[Array, "12"]):
        return residual(t, _displaced(body_i, changes[:6]), _displaced(body_j, changes[6:]))

    def along_motion(s: Scalar):
        return residual(t + s if is_driven else t, _advanced(body_i, s), _advanced(body_j, s))

    def rate_along_motion(s: Scalar):
        return jax.jvp(along_motion, (s,), (jnp.ones_like(s),))[1]

    zero = jnp.zeros(())
    value = residual(t, body_i, body_j)
    jacobian = jax.jacfwd(at)(jnp.zeros(12))
    phi_t = jnp.zeros_like(value)
    if is_driven:
        time = jnp.asarray(t, jnp.float64)
        phi_t = jax.jvp(lambda t: residual(t, body_i, body_j), (time,), (jnp.ones_like(time),))[1]
    acceleration = jax.jvp(rate_along_motion, (zero,), (jnp.ones_like(zero),))[1]
    return ConstraintRows(value, (jacobian[:, :6], jacobian[:, 6:]), -acceleration, phi_t)


def _displaced(body: BodyMotion, change: Float[Array, "6"]) -> BodyMotion:
    """A body after a small displacement and rotation, to first order."""
    shift, turn = change[:3], change[3:]
    return body._replace(
        position=body.position + shift,
        quaternion=body.quaternion + quaternion_rate(body.quaternion, turn),
        rotation=body.rotation + skew(turn) @ body.rotation,
    )


def _advanced(body: BodyMotion, s: Scalar) -> BodyMotion:
    """A body that goes on for a short time s with constant velocities, to second order."""
    spin = skew(body.angular_velocity)
    turned = spin @ body.rotation
    faster = quaternion_rate(body.quaternion, body.angular_velocity)
    return body._replace(
        position=body.position + s * body.velocity,
        quaternion=body.quaternion + s * faster + s * s / 2 * quaternion_rate(faster, body.angular_velocity),
        rotation=body.rotation + s * turned + s * s / 2 * (spin @ turned),
    )


def stacked(*rows: ConstraintRows) -> ConstraintRows:
    """Several sets of rows between the same two bodies as one."""
    return ConstraintRows(
        jnp.concatenate([r.residual for r in rows]),
        (
            jnp.concatenate([r.jacobians[0] for r in rows]),
            jnp.concatenate([r.jacobians[1] for r in rows]),
        ),
        jnp.concatenate([r.bias for r in rows]),
        jnp.concatenate([r.rate_at_rest for r in rows]),
    )

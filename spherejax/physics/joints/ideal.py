"""Ideal joints: constraint equations (Eqs 3 to 10) instead of forces."""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.rotation import skew
from spherejax.foundations.types import Vector3
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.kinematics import BodyMotion, centripetal_acceleration, point_motion


class Ideal(AbstractSphericalModel):
    """The two centers coincide: three constraint equations, no clearance, no dissipation."""

    is_ideal: ClassVar[bool] = True

    def requirements(self) -> list[Requirement]:
        """An ideal joint has no numbers."""
        return []


class ConstraintRows(NamedTuple):
    """Constraint equations between two bodies i and j, Phi = 0.

    Attributes:
        residual: Phi [m or 1], shape (n,).
        jacobians: D_i and D_j with Phi_dot = D_i (v_i, w_i) + D_j (v_j, w_j), each of shape (n, 6).
        bias: gamma, with D (accelerations) = gamma [m/s^2 or 1/s^2], shape (n,).
    """

    residual: Float[Array, " n"]
    jacobians: tuple[Float[Array, "n 6"], Float[Array, "n 6"]]
    bias: Float[Array, " n"]


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
    )

"""Contact of ball and socket (Eqs 15 to 36), shared by the dry and the lubricated joint.

The surfaces meet half-way between the socket's point at its center + R_i n and the ball's at its center + R_j n, with
n = e / |e| and R_j = R_i - c. Friction acts in that one point on both bodies, on the relative velocity of their
*material* points there: at two points a penetration apart it would be a couple that turns a free pair, and two bodies
that turn as one would slide. The paper's Eq. 17, read literally (R_k n_dot instead of w_k x R_k n), makes the sliding
velocity (|e| - c) n_dot, which vanishes at the socket's surface, so that friction would do nothing.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Number, Scalar, Vector3
from spherejax.physics import memory as remembered
from spherejax.physics.joints.base import Crossing, Effect
from spherejax.physics.kinematics import RelativeMotion
from spherejax.physics.laws.conformity import AbstractConformity, Pair, PressedPair
from spherejax.physics.laws.friction import AbstractFrictionLaw
from spherejax.physics.laws.material import Material, generalized_stiffness
from spherejax.physics.laws.normal import AbstractNormalLaw, Hertz


class Surfaces(NamedTuple):
    """Geometry and material of ball and socket.

    Attributes:
        clearance: c = R_i - R_j [m].
        socket_radius: R_i [m].
        socket_material: material of the socket.
        ball_material: material of the ball.
        conformity: how the surfaces press back, or None for Hertz's law.
    """

    clearance: Number
    socket_radius: Number
    socket_material: Material
    ball_material: Material
    conformity: AbstractConformity | None = None

    @property
    def ball_radius(self) -> Number:
        """R_j = R_i - c [m] (Eq. 11)."""
        return self.socket_radius - self.clearance

    def requirements(self, ball_radius_given: bool) -> list[Requirement]:
        """A positive clearance that leaves a ball."""
        c, radius = self.clearance, self.socket_radius
        remedy = "Give the radial clearance in meters, e.g. clearance=1e-4."
        if ball_radius_given:
            fits = Requirement(
                "ball_radius",
                self.ball_radius,
                self.ball_radius < radius,
                "be smaller than the socket's radius",
                "The ball is larger than its socket: exchange the two radii or check their units.",
            )
        else:
            fits = Requirement("clearance", c, (c > 0) & (c < np.inf), "be positive [m]", remedy)
        return [
            Requirement(
                "socket_radius",
                radius,
                (radius > 0) & (radius < np.inf),
                "be positive [m]",
                "Give the socket's inner radius in meters, e.g. socket_radius=0.010.",
            ),
            fits,
            Requirement(
                "clearance",
                c,
                c < radius,
                "be smaller than the socket's radius",
                "No ball is left inside the socket: reduce the clearance or check its unit.",
            ),
            *self.socket_material.requirements(),
            *self.ball_material.requirements(),
        ]


class ContactForces(NamedTuple):
    """Forces of one contact.

    Attributes:
        normal_force: f_n [N], not negative.
        force: on the ball, normal and friction together, world axes [N].
        friction: the friction part of `force` [N].
        bristle_rate: time derivative of the bristle deflection [m/s]; empty without bristles.
        sliding_velocity: tangential velocity of the ball's surface against the socket's [m/s].
        bristle_energy: stored in the bristles of a friction law that has some [J].
    """

    normal_force: Scalar
    force: Vector3
    friction: Vector3
    bristle_rate: Float[Array, " n"]
    sliding_velocity: Vector3
    bristle_energy: Scalar


def direction_of(e: Vector3) -> Vector3:
    """n = e / |e|. Limits: 0 at e = 0, where no contact is possible; value and derivative are finite there."""
    length = safe_norm(e)
    return e / jnp.where(length > 0, length, 1.0)


def contact_arms(motion: RelativeMotion, surfaces: Surfaces) -> tuple[Vector3, Vector3]:
    """From the ball's and from the socket's center to the point where they touch [m].

        a_j = (R_j - delta/2) n,    a_i = (R_i + delta/2) n,    delta = |e| - c,    a_i - a_j = e

    Limits: 0 at e = 0, where no contact is possible.
    """
    n, distance = direction_of(motion.eccentricity), safe_norm(motion.eccentricity)
    radii = surfaces.socket_radius + surfaces.ball_radius
    return 0.5 * (radii - distance) * n, 0.5 * (radii + distance) * n


def sliding_velocity(motion: RelativeMotion, surfaces: Surfaces) -> Vector3:
    """Tangential velocity [m/s] of the ball's material point against the socket's, where they touch (Eqs 18, 19).

    Limits: 0 for two bodies that turn as one, however deep they are pressed.
    """
    n = direction_of(motion.eccentricity)
    ball_arm, socket_arm = contact_arms(motion, surfaces)
    relative = (
        motion.eccentricity_rate
        + jnp.cross(motion.ball_angular_velocity, ball_arm)
        - jnp.cross(motion.socket_angular_velocity, socket_arm)
    )
    return relative - (relative @ n) * n


def stiffness_of(normal: AbstractNormalLaw, surfaces: Surfaces) -> Number | PressedPair:
    """The normal law's own stiffness, or Eq. 24 with the socket's radius negative [N/m^n]; with a conformity, that."""
    if surfaces.conformity is not None:
        compliance = surfaces.socket_material.contact_compliance() + surfaces.ball_material.contact_compliance()
        return PressedPair(surfaces.conformity, Pair(surfaces.clearance, surfaces.socket_radius, compliance))
    if normal.stiffness is not None:
        return normal.stiffness
    return generalized_stiffness(
        surfaces.socket_radius, surfaces.ball_radius, surfaces.socket_material, surfaces.ball_material
    )


def contact_forces(
    motion: RelativeMotion,
    memory: Float[Array, " n_memory"],
    surfaces: Surfaces,
    normal: AbstractNormalLaw,
    friction: Any,
    share: Number = 1.0,
) -> ContactForces:
    """Normal and friction force of one contact.

    Args:
        motion: motion of the ball in the socket.
        memory: onset rate [m/s] (0 in flight), then the bristle deflection [m], as `contact_memory` lists them.
        surfaces: geometry and material.
        normal: normal law.
        friction: friction law, or None.
        share: the part of the normal force that acts, in [0, 1] (the hybrid lubricated joint).

    Returns:
        The forces. In flight (onset rate 0) they are zero even where a trial step of the integrator has gone
        beyond the surface, so that flight is smooth up to the onset that the integrator lands on.
    """
    e = motion.eccentricity
    n = direction_of(e)
    penetration = safe_norm(e) - surfaces.clearance
    penetration_rate = motion.eccentricity_rate @ n
    stiffness = stiffness_of(normal, surfaces)
    n_bristle = 0 if friction is None else friction.bristle_size
    onset_rate = remembered.onset_rate(memory)
    is_touching = onset_rate > 0
    penetration = jnp.where(is_touching, penetration, -surfaces.clearance)
    normal_force = share * normal.force(penetration, penetration_rate, onset_rate, stiffness)
    # Without friction nothing but an observer reads it, and it falls out of the compiled equations of motion.
    velocity = sliding_velocity(motion, surfaces)
    if friction is None:
        zero = jnp.zeros(3)
        return ContactForces(normal_force, -normal_force * n, zero, jnp.zeros(0), velocity, jnp.zeros(()))
    bristle_energy = jnp.zeros(())
    if n_bristle:
        deflection = remembered.bristle(memory)
        bristle = deflection - (deflection @ n) * n
        traction = friction.bristle_traction(bristle, velocity, normal_force)
        bristle_energy = friction.bristle_energy(bristle, normal_force)
        # The bristles are carried by the socket's surface; in flight they rest.
        carried = friction.bristle_rate(bristle, velocity) + jnp.cross(motion.socket_angular_velocity, deflection)
        bristle_rate = jnp.where(is_touching, carried, 0.0)
    else:
        traction = friction.traction(velocity, normal_force)
        bristle_rate = jnp.zeros(0)
    return ContactForces(normal_force, traction - normal_force * n, traction, bristle_rate, velocity, bristle_energy)


def has_bristles(model: Any) -> bool:
    """Whether a model's friction law has bristles, which store energy beside the surfaces."""
    return model.friction is not None and bool(model.friction.bristle_size)


def contact_moments(motion: RelativeMotion, surfaces: Surfaces, friction: Vector3) -> tuple[Vector3, Vector3]:
    """Moments [N m] of the friction force about the ball's and the socket's center; the normal force has none."""
    ball_arm, socket_arm = contact_arms(motion, surfaces)
    return jnp.cross(ball_arm, friction), -jnp.cross(socket_arm, friction)


def contact_crossing(motion: RelativeMotion, clearance: Number) -> Crossing:
    """g = (|e|^2 / c^2 - 1) / 2, its rate e . e_dot / c^2, and e_dot / c."""
    e, e_rate, square = motion.eccentricity, motion.eccentricity_rate, clearance * clearance
    return Crossing((e @ e / square - 1) / 2, e @ e_rate / square, e_rate / clearance)


def contact_effects(model: Any, first: str) -> tuple[Effect, ...]:
    """The effects of a model with contact, one upon the other: elastic contact, its damping, friction.

    Args:
        model: the model; it has the fields `normal`, `friction` and `conformity`.
        first: name of the effects that come with elastic contact.
    """
    elastic = Hertz(stiffness=model.normal.stiffness, exponent=model.normal.exponent)
    law = type(elastic if model.conformity is None else model.conformity).__name__
    first = f"{first} ({law})"
    plain = eqx.tree_at(lambda m: (m.normal, m.friction), model, (elastic, None), is_leaf=lambda leaf: leaf is None)
    effects = [Effect(first, plain)]
    frictionless = eqx.tree_at(lambda m: m.friction, model, None, is_leaf=lambda leaf: leaf is None)
    if type(model.normal) is not type(elastic):
        memory = ", with onset memory" if model.normal.remembers_onset else ""
        effects.append(Effect(f"contact damping ({type(model.normal).__name__}{memory})", frictionless))
    if model.friction is not None:
        bristles = ", with bristles" if model.friction.bristle_size else ""
        effects.append(Effect(f"friction ({type(model.friction).__name__}{bristles})", model))
    return tuple(effects)


def contact_law_requirements(
    normal: AbstractNormalLaw, friction: AbstractFrictionLaw | None, conformity: AbstractConformity | None
) -> list[Requirement]:
    """What the laws of a contact require, with the law's name in front of each number."""
    laws = [law for law in (normal, friction, conformity) if law is not None]
    required = [(law, requirement) for law in laws for requirement in law.requirements()]
    found = [r if r.value is law else r._replace(field=f"{type(law).__name__}.{r.field}") for law, r in required]
    if conformity is not None and normal.stiffness is not None:
        name = type(conformity).__name__
        remedy = f"Leave it out, or leave out conformity: {name} has a stiffness of its own."
        field = f"{type(normal).__name__}.stiffness"
        found.append(Requirement(field, normal.stiffness, False, f"not be given beside a {name}", remedy))
    return found

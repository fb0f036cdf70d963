"""Contact of ball and socket (Eqs 15 to 36), shared by the dry and the lubricated joint.

The surfaces meet half-way between the socket's point at its center + R_i n and the ball's at its center + R_j n, with
n = e / |e| and R_j = R_i - c. Friction acts in that one point on both bodies, on the relative velocity of their
*material* points there: at two points a penetration apart it would be a couple that turns a free pair, and two bodies
that turn as one would slide. The paper's Eq. 17, read literally (R_k n_dot instead of w_k x R_k n), makes the sliding
velocity (|e| - c) n_dot, which vanishes at the socket's surface, so that friction would do nothing.

Surfaces that are worn, or not round, have a depth by direction (`physics.laws.depth`), and the penetration is

    delta = |e| - c - h_i(A_i^T n) - h_j(A_j^T n).

The elastic force is the gradient of the energy E(delta) by the place of the ball's center and by the rotations of both
bodies, so that it conserves energy. With t_k the part across n of the gradient of h_k, turned to world axes,

    F = -E' m,    m = n - (t_i + t_j)/|e|,    M_i = E' t_i x n,    M_j = E' t_j x n,

about the centers of socket and ball. The normal force is E' |m|, and acts along m: a ball that is round has no moment
about its center. Friction acts where the surfaces meet, across m.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement, called, is_concrete
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Matrix3, Number, Scalar, Vector3
from spherejax.physics import memory as remembered
from spherejax.physics.joints.base import Crossing, Effect
from spherejax.physics.kinematics import RelativeMotion
from spherejax.physics.laws.conformity import AbstractConformity, Pair, PressedPair
from spherejax.physics.laws.depth import AbstractDepth
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
        socket_depth: of the socket's surface below its sphere; None: it is round.
        ball_depth: of the ball's surface below its sphere; None: it is round.
    """

    clearance: Number
    socket_radius: Number
    socket_material: Material
    ball_material: Material
    conformity: AbstractConformity | None = None
    socket_depth: AbstractDepth | None = None
    ball_depth: AbstractDepth | None = None

    @property
    def are_round(self) -> bool:
        """Whether both are spheres (static)."""
        return self.socket_depth is None and self.ball_depth is None

    @property
    def ball_radius(self) -> Number:
        """R_j = R_i - c [m] (Eq. 11)."""
        return self.socket_radius - self.clearance

    @property
    def mean_radii(self) -> tuple[Number, Number]:
        """Radii of socket and ball with the mean depths of their surfaces [m], for the stiffness."""
        outer, inner = self.socket_radius, self.ball_radius
        outer = outer if self.socket_depth is None else outer + self.socket_depth.mean
        return outer, inner if self.ball_depth is None else inner - self.ball_depth.mean

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
            *called(self.socket_material, "requirements"),
            *called(self.ball_material, "requirements"),
            *self._requirements_of_depths(),
        ]

    def _requirements_of_depths(self) -> list[Requirement]:
        """Legal depths, which leave a gap in every direction and however the ball is turned."""
        depths = {"socket_depth": self.socket_depth, "ball_depth": self.ball_depth}
        there = {name: depth for name, depth in depths.items() if depth is not None}
        required = [r._replace(field=f"{name}.{r.field}") for name, d in there.items() for r in d.requirements()]
        if not there or not all(r.satisfied is True or np.all(_as_known(r.satisfied)) for r in required):
            return required
        least = sum(depth.least for depth in there.values())
        gap = self.clearance + least
        remedy = (
            "The surfaces overlap with the ball in the middle: enlarge the clearance, or make the depths less negative."
        )
        return [
            *required,
            Requirement(" + ".join(["clearance", *there]), gap, gap > 0, "be positive everywhere", remedy),
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


class SurfaceContact(NamedTuple):
    """Where and how ball and socket meet, or would.

    Attributes:
        penetration: delta [m].
        penetration_rate: its time derivative [m/s].
        normal: unit vector along the gradient m of delta; for round surfaces n = e/|e|.
        steepness: |m|; None: 1.
        ball_arm: from the ball's center to the point where they meet [m].
        socket_arm: from the socket's center [m].
        ball_twist: moment about the ball's center for each newton of E' [m]; None: none.
        socket_twist: about the socket's center [m]; None: none.
    """

    penetration: Scalar
    penetration_rate: Scalar
    normal: Vector3
    steepness: Scalar | None
    ball_arm: Vector3
    socket_arm: Vector3
    ball_twist: Vector3 | None = None
    socket_twist: Vector3 | None = None


def surface_contact(motion: RelativeMotion, surfaces: Surfaces) -> SurfaceContact:
    """Where ball and socket meet.

        a_j = (R_j - h_j - delta/2) m/|m|,    a_i = a_j + e

    Limits: the arms are 0 at e = 0 for round surfaces, where no contact is possible; everything is finite there.
    """
    e = motion.eccentricity
    n, distance = direction_of(e), safe_norm(e)
    if surfaces.are_round:
        radii = surfaces.socket_radius + surfaces.ball_radius
        arms = 0.5 * (radii - distance) * n, 0.5 * (radii + distance) * n
        return SurfaceContact(distance - surfaces.clearance, motion.eccentricity_rate @ n, n, None, *arms)
    reach = reach_of(motion, surfaces)
    across = (reach.socket_slope + reach.ball_slope) / jnp.where(distance > 0, distance, 1.0)
    m = n - across
    steepness = safe_norm(m)
    normal = m / jnp.where(steepness > 0, steepness, 1.0)
    penetration = distance - reach.length
    ball_radius = surfaces.ball_radius - reach.ball_depth
    ball_arm = (ball_radius - 0.5 * penetration) * normal
    rate = motion.eccentricity_rate @ n - reach.rate_by(motion) / jnp.where(distance > 0, distance, 1.0)
    twists = jnp.cross(reach.ball_slope, n), jnp.cross(reach.socket_slope, n)
    return SurfaceContact(penetration, rate, normal, steepness, ball_arm, ball_arm + e, *twists)


class SurfaceReach(NamedTuple):
    """How far the ball can go in the direction of its eccentricity.

    Attributes:
        length: rho = c + h_i + h_j [m].
        socket_slope: t_i, the gradient of h_i by the direction, across it, world axes [m].
        ball_slope: t_j, that of h_j [m].
        ball_depth: h_j [m].
    """

    length: Scalar
    socket_slope: Vector3
    ball_slope: Vector3
    ball_depth: Scalar

    def rate_by(self, motion: RelativeMotion) -> Scalar:
        """|e| times the rate of rho [m^2/s]: t_i.(e_dot - w_i x e) + t_j.(e_dot - w_j x e)."""
        e, e_rate = motion.eccentricity, motion.eccentricity_rate
        in_socket = e_rate - jnp.cross(motion.socket_angular_velocity, e)
        in_ball = e_rate - jnp.cross(motion.ball_angular_velocity, e)
        return self.socket_slope @ in_socket + self.ball_slope @ in_ball


def reach_of(motion: RelativeMotion, surfaces: Surfaces) -> SurfaceReach:
    """How far the ball can go in its direction; finite at e = 0, where depths are those that their polynomials have
    at u = 0."""
    n, none = direction_of(motion.eccentricity), (jnp.zeros(()), jnp.zeros(3))
    socket = _depth_along(surfaces.socket_depth, motion.socket_rotation, n) if surfaces.socket_depth else none
    ball = _depth_along(surfaces.ball_depth, motion.ball_rotation, n) if surfaces.ball_depth else none
    return SurfaceReach(surfaces.clearance + socket[0] + ball[0], socket[1], ball[1], ball[0])


def _depth_along(depth: AbstractDepth, axes: Matrix3 | None, n: Vector3) -> tuple[Scalar, Vector3]:
    """h in a direction, and its gradient across that, both in world axes."""
    assert axes is not None
    value, gradient = depth.depth_and_gradient(axes.T @ n)
    slope = axes @ gradient
    return value, slope - (slope @ n) * n


def _as_known(condition) -> Any:
    return condition if is_concrete(condition) else True


def contact_arms(motion: RelativeMotion, surfaces: Surfaces) -> tuple[Vector3, Vector3]:
    """From the ball's and from the socket's center to the point where they touch [m].

        a_j = (R_j - delta/2) n,    a_i = (R_i + delta/2) n,    delta = |e| - c,    a_i - a_j = e

    of round surfaces; see `surface_contact` for others. Limits: 0 at e = 0, where no contact is possible.
    """
    touch = surface_contact(motion, surfaces)
    return touch.ball_arm, touch.socket_arm


def sliding_velocity(motion: RelativeMotion, surfaces: Surfaces) -> Vector3:
    """Tangential velocity [m/s] of the ball's material point against the socket's, where they touch (Eqs 18, 19).

    Limits: 0 for two bodies that turn as one, however deep they are pressed.
    """
    touch = surface_contact(motion, surfaces)
    n = touch.normal
    relative = (
        motion.eccentricity_rate
        + jnp.cross(motion.ball_angular_velocity, touch.ball_arm)
        - jnp.cross(motion.socket_angular_velocity, touch.socket_arm)
    )
    return relative - (relative @ n) * n


def stiffness_of(normal: AbstractNormalLaw, surfaces: Surfaces) -> Number | PressedPair:
    """The normal law's own stiffness, or Eq. 24 with the socket's radius negative [N/m^n]; with a conformity, that."""
    outer, inner = surfaces.mean_radii
    if surfaces.conformity is not None:
        compliance = surfaces.socket_material.contact_compliance() + surfaces.ball_material.contact_compliance()
        clearance = surfaces.clearance if surfaces.are_round else outer - inner
        return PressedPair(surfaces.conformity, Pair(clearance, outer, compliance))
    if normal.stiffness is not None:
        return normal.stiffness
    return generalized_stiffness(outer, inner, surfaces.socket_material, surfaces.ball_material)


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
    touch = surface_contact(motion, surfaces)
    n = touch.normal
    stiffness = stiffness_of(normal, surfaces)
    n_bristle = 0 if friction is None else friction.bristle_size
    onset_rate = remembered.onset_rate(memory)
    is_touching = onset_rate > 0
    penetration = jnp.where(is_touching, touch.penetration, -surfaces.clearance)
    slope = share * normal.force(penetration, touch.penetration_rate, onset_rate, stiffness)
    normal_force = slope if touch.steepness is None else slope * touch.steepness
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


def contact_moments(
    motion: RelativeMotion, surfaces: Surfaces, friction: Vector3, normal_force: Scalar
) -> tuple[Vector3, Vector3]:
    """Moments [N m] of a contact about the ball's and the socket's center: of the friction, and of the normal force
    where the surfaces are not round."""
    touch = surface_contact(motion, surfaces)
    ball, socket = jnp.cross(touch.ball_arm, friction), -jnp.cross(touch.socket_arm, friction)
    if touch.steepness is None or touch.ball_twist is None or touch.socket_twist is None:
        return ball, socket
    slope = normal_force / jnp.where(touch.steepness > 0, touch.steepness, 1.0)
    return ball + slope * touch.ball_twist, socket + slope * touch.socket_twist


def contact_crossing(motion: RelativeMotion, surfaces: Surfaces) -> Crossing:
    """g = (|p|^2 - 1) / 2 with the place of the ball p = e / rho, its rate p . p_dot, and p_dot.

    rho is the clearance c; on surfaces that are not round, how far the ball can go in its direction.
    """
    e, e_rate = motion.eccentricity, motion.eccentricity_rate
    if surfaces.are_round:
        clearance = surfaces.clearance
        square = clearance * clearance
        return Crossing((e @ e / square - 1) / 2, e @ e_rate / square, e_rate / clearance)
    reach = reach_of(motion, surfaces)
    rho = reach.length
    place = e / rho
    # e rho_dot = n |e| rho_dot, and |e| rho_dot is finite in the middle.
    velocity = (e_rate - direction_of(e) * reach.rate_by(motion) / rho) / rho
    return Crossing((place @ place - 1) / 2, place @ velocity, velocity)


def contact_effects(model: Any, first: str) -> tuple[Effect, ...]:
    """The effects of a model with contact, one upon the other: elastic contact, its damping, friction.

    Args:
        model: the model; it has the fields `normal`, `friction` and `conformity`.
        first: name of the effects that come with elastic contact.
    """
    elastic = Hertz(stiffness=model.normal.stiffness, exponent=model.normal.exponent)
    law = type(elastic if model.conformity is None else model.conformity).__name__
    first = f"{first} ({law})"
    whole, model = model, model.as_round()
    plain = eqx.tree_at(lambda m: (m.normal, m.friction), model, (elastic, None), is_leaf=lambda leaf: leaf is None)
    effects = [Effect(first, plain)]
    frictionless = eqx.tree_at(lambda m: m.friction, model, None, is_leaf=lambda leaf: leaf is None)
    if type(model.normal) is not type(elastic):
        memory = ", with onset memory" if model.normal.remembers_onset else ""
        effects.append(Effect(f"contact damping ({type(model.normal).__name__}{memory})", frictionless))
    if model.friction is not None:
        bristles = ", with bristles" if model.friction.bristle_size else ""
        effects.append(Effect(f"friction ({type(model.friction).__name__}{bristles})", model))
    if not whole.surfaces.are_round:
        depths = {"socket": whole.surfaces.socket_depth, "ball": whole.surfaces.ball_depth}
        own = ", ".join(f"{side} {type(depth).__name__}" for side, depth in depths.items() if depth is not None)
        effects.append(Effect(f"surfaces not round ({own})", whole))
    return tuple(effects)


def contact_law_requirements(
    normal: AbstractNormalLaw, friction: AbstractFrictionLaw | None, conformity: AbstractConformity | None
) -> list[Requirement]:
    """What the laws of a contact require, with the law's name in front of each number."""
    laws = [law for law in (normal, friction, conformity) if law is not None]
    required = [(law, requirement) for law in laws for requirement in called(law, "requirements")]
    found = [r if r.value is law else r._replace(field=f"{type(law).__name__}.{r.field}") for law, r in required]
    if conformity is not None and normal.stiffness is not None:
        name = type(conformity).__name__
        remedy = f"Leave it out, or leave out conformity: {name} has a stiffness of its own."
        field = f"{type(normal).__name__}.stiffness"
        found.append(Requirement(field, normal.stiffness, False, f"not be given beside a {name}", remedy))
    return found

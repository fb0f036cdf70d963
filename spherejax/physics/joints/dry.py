"""The dry joint with clearance: normal contact and friction (sections 3.2, 4.1 and 4.2 of the paper)."""

from typing import Annotated

import equinox as eqx
import jax.numpy as jnp

from spherejax.foundations.checks import Requirement
from spherejax.foundations.types import Number, Scalar, Unit
from spherejax.physics.joints.base import Response
from spherejax.physics.joints.clearance import AbstractClearanceModel, clearance_from
from spherejax.physics.joints.contact import (
    Surfaces,
    contact_effects,
    contact_forces,
    contact_law_requirements,
    contact_moments,
    has_bristles,
    stiffness_of,
)
from spherejax.physics.laws.conformity import AbstractConformity
from spherejax.physics.laws.depth import AbstractDepth
from spherejax.physics.laws.friction import AbstractFrictionLaw
from spherejax.physics.laws.material import Material
from spherejax.physics.laws.normal import AbstractNormalLaw, LankaraniNikravesh


class Dry(AbstractClearanceModel):
    """Ball and socket with clearance, dry: they fly, impact, and slide on each other.

    Attributes:
        clearance: radial clearance c = R_i - R_j [m].
        socket_radius: R_i, inner radius of the socket [m].
        normal: law of the normal force.
        friction: law of the friction force, or None.
        socket_material: material of the socket.
        ball_material: material of the ball.
        conformity: how surfaces that nearly fit press back, in place of Hertz's law (`SphericalProfile`,
            `WinklerLiner`); None for that.
        socket_depth: how deep the socket's surface lies below its sphere, by direction in the axes of its body: worn
            away, or not round (`HarmonicDepth`); of a bearing below its cylinder (`FourierDepth`). None: it is round.
        ball_depth: the same of the ball or the journal, in the axes of its body.

    Args:
        ball_radius: R_j, instead of the clearance [m].

    With depths the penetration is |e| - c - h_i - h_j, the depths taken in the direction of e. Their mean goes into the
    stiffness of Eq. 24, or of a conformity; how they curve does not.

    Source: the paper, sections 3.2, 4.1, 4.2; defaults from its Table 3. The forces on surfaces that are not round are
    derived here, see `spherejax.physics.joints.contact`.
    """

    clearance: Number
    socket_radius: Number
    normal: AbstractNormalLaw
    friction: AbstractFrictionLaw | None
    socket_material: Material
    ball_material: Material
    conformity: AbstractConformity | None
    socket_depth: AbstractDepth | None
    ball_depth: AbstractDepth | None
    _ball_radius_given: bool = eqx.field(static=True)

    def __init__(
        self,
        clearance: Annotated[Number | None, Unit("m")] = None,
        *,
        socket_radius: Annotated[Number, Unit("m")] = 0.010,
        ball_radius: Annotated[Number | None, Unit("m")] = None,
        normal: AbstractNormalLaw | None = None,
        friction: AbstractFrictionLaw | None = None,
        socket_material: Material | None = None,
        ball_material: Material | None = None,
        conformity: AbstractConformity | None = None,
        socket_depth: AbstractDepth | None = None,
        ball_depth: AbstractDepth | None = None,
    ):
        self.clearance = clearance_from(clearance, socket_radius, ball_radius)
        self.socket_radius = socket_radius
        self.normal = LankaraniNikravesh(restitution=0.9) if normal is None else normal
        self.friction = friction
        self.socket_material = Material() if socket_material is None else socket_material
        self.ball_material = Material() if ball_material is None else ball_material
        self.conformity = conformity
        self.socket_depth = socket_depth
        self.ball_depth = ball_depth
        self._ball_radius_given = ball_radius is not None

    @property
    def surfaces(self) -> Surfaces:
        """Geometry and material together."""
        return super().surfaces._replace(socket_depth=self.socket_depth, ball_depth=self.ball_depth)

    def as_round(self) -> "Dry":
        """The same joint with surfaces that are spheres, or cylinders."""
        if self.surfaces.are_round:
            return self
        round_ones = None, None
        return eqx.tree_at(
            lambda m: (m.socket_depth, m.ball_depth), self, round_ones, is_leaf=lambda leaf: leaf is None
        )

    @property
    def effects(self):
        """Elastic contact, then what the normal law adds to it, then friction, then surfaces that are not round."""
        return contact_effects(self, "normal contact, elastic")

    def requirements(self) -> list[Requirement]:
        """Legal geometry, materials and laws."""
        return self.surfaces.requirements(self._ball_radius_given) + contact_law_requirements(
            self.normal, self.friction, self.conformity
        )

    def respond(self, motion, memory) -> Response:
        """Contact forces on the ball, at the contact point, as force and moments at the centers."""
        surfaces = self.surfaces
        contact = contact_forces(motion, memory, surfaces, self.normal, self.friction)
        ball_moment, socket_moment = contact_moments(motion, surfaces, contact.friction, contact.normal_force)
        penetration = self.penetration(motion)
        return Response(
            force=contact.force,
            ball_moment=ball_moment,
            socket_moment=socket_moment,
            memory_rate=jnp.concatenate([jnp.zeros(1), contact.bristle_rate]),
            elastic_energy=self._elastic_energy(penetration) + contact.bristle_energy,
            parts={
                "penetration": penetration,
                "normal_force": contact.normal_force,
                "friction_force": contact.friction,
                "sliding_velocity": contact.sliding_velocity,
            },
        )

    def stored_energy(self, motion, memory):
        """Of the pressed surfaces alone, where there are no bristles."""
        if has_bristles(self) or type(self).respond is not Dry.respond:
            return super().stored_energy(motion, memory)
        return self._elastic_energy(self.penetration(motion))

    def _elastic_energy(self, penetration: Scalar) -> Scalar:
        return self.normal.elastic_energy(penetration, stiffness_of(self.normal, self.surfaces))

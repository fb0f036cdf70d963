"""What the dry and the lubricated joint share: a ball in a socket with clearance, and the memory of their contact."""

from typing import Self

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement, is_concrete
from spherejax.foundations.forms import real_number
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Number, Numeric, Scalar
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.contact import (
    Surfaces,
    contact_crossing,
    surface_contact,
)
from spherejax.physics.kinematics import RelativeMotion
from spherejax.physics.laws.conformity import LARGEST_HERTZIAN_RATIO, AbstractConformity
from spherejax.physics.laws.friction import AbstractFrictionLaw
from spherejax.physics.laws.material import Material
from spherejax.physics.laws.normal import HERTZIAN_EXPONENT, AbstractNormalLaw
from spherejax.physics.memory import MemoryEntry, contact_memory, is_touching, memory_at_onset

GRADUAL_EXPONENT = 1.4
"""From this exponent on derivatives by Rosenbrock methods are right to 1e-6, as they are with an exponent of 1. Between
the two they were wrong by 2e-6 with 1.3, 5e-6 with 1.2, 1e-5 with 1.1 and 7e-5 with 1.05, whatever their tolerance (a
ball of 1 kg that meets 1e7 N/m^n at 1 m/s)."""


def clearance_from(clearance: Number | None, socket_radius: Number, ball_radius: Number | None) -> Numeric:
    """The clearance c = R_i - R_j [m] from whichever of clearance and ball radius is given."""
    if (clearance is None) == (ball_radius is None):
        raise TypeError("give either clearance= or ball_radius=, not both and not neither")
    if ball_radius is not None:
        real_number("ball_radius", ball_radius)
        real_number("socket_radius", socket_radius)
    return clearance if ball_radius is None else socket_radius - ball_radius


class AbstractClearanceModel(AbstractSphericalModel):
    """A ball in a socket with clearance.

    Attributes:
        clearance: radial clearance c = R_i - R_j [m].
        socket_radius: R_i [m].
        normal: law of the normal force.
        friction: law of the friction force, or None.
        socket_material: material of the socket.
        ball_material: material of the ball.
        conformity: how surfaces that nearly fit press back, in place of Hertz's law; None for that.
    """

    clearance: eqx.AbstractVar[Number]
    socket_radius: eqx.AbstractVar[Number]
    normal: eqx.AbstractVar[AbstractNormalLaw]
    friction: eqx.AbstractVar[AbstractFrictionLaw | None]
    socket_material: eqx.AbstractVar[Material]
    ball_material: eqx.AbstractVar[Material]
    conformity: eqx.AbstractVar[AbstractConformity | None]

    @property
    def surfaces(self) -> Surfaces:
        """Geometry and material together."""
        return Surfaces(self.clearance, self.socket_radius, self.socket_material, self.ball_material, self.conformity)

    def as_round(self) -> Self:
        """The same model with surfaces that are spheres."""
        return self

    @property
    def memory(self) -> tuple[MemoryEntry, ...]:
        """The onset rate, 0 in flight, for every law: it says that the ball touches; and bristles of laws with them."""
        return contact_memory(self.friction is not None and bool(self.friction.bristle_size))

    @property
    def has_surfaces(self) -> bool:
        """It has."""
        return True

    @property
    def surfaces_touch(self) -> bool:
        """Whether there is a contact that rubs and wears (static)."""
        return True

    @property
    def detects_onsets(self) -> bool:
        """For every law: a step that flies through the wall would not feel it."""
        return True

    @property
    def stiffens_from_zero(self) -> bool:
        """With an exponent that is known to be Hertz's, or a conformity that says so."""
        if self.conformity is not None:
            return self.conformity.stiffens_from_zero
        exponent = self.normal.exponent
        return is_concrete(exponent) and bool(np.all(np.asarray(exponent) == HERTZIAN_EXPONENT))

    @property
    def stiffens_abruptly(self) -> bool:
        """With an exponent near 1 or not known, and with a conformity that does not grow from a slope of zero."""
        if self.conformity is not None:
            return not self.conformity.stiffens_from_zero
        exponent = self.normal.exponent
        if not is_concrete(exponent):
            return True
        n = np.asarray(exponent)
        return not np.all((n == 1) | (n >= GRADUAL_EXPONENT))

    @property
    def never_adds_energy(self) -> bool:
        """Where its laws do not."""
        laws = (self.normal, self.friction, self.conformity)
        return all(law.never_adds_energy for law in laws if law is not None)

    @property
    def largest_ratio(self) -> float | None:
        """Penetration over clearance up to which the elastic law holds: a tenth for Eq. 24; None for any."""
        if self.conformity is not None:
            return self.conformity.largest_ratio
        return LARGEST_HERTZIAN_RATIO if self.normal.stiffness is None else None

    @property
    def offset_ratio(self) -> Scalar | None:
        """By which share of the clearance a film is thicker than its gap; None without a film."""
        return None

    def film_range_share(self, motion: RelativeMotion, memory: Float[Array, " n_memory"]) -> Scalar | None:
        """How far out the ball is, as a share of what its film is for; None for any."""
        del motion, memory
        return None

    @property
    def beyond_film_range(self) -> str:
        """What a `film_range_share` above 1 means, in words (static); empty without a film."""
        return ""

    def requirements_of(self, *, is_bearing: bool) -> list[Requirement]:
        """Laws of a ball in a socket, or of a journal in a bearing; a stiffness that is given serves both."""
        law = self.conformity
        if law is not None:
            fits, name = law.is_line_contact == is_bearing, type(law).__name__
        else:
            fits, name = not is_bearing or self.normal.stiffness is not None, "None"
        remedy = (
            "Give conformity=sj.laws.JohnsonCylinder(length) or sj.laws.EsduCylinder(length), or a normal law "
            "with a stiffness: "
            "that of Eq. 24 is of spheres."
            if is_bearing
            else "JohnsonCylinder and EsduCylinder are of revolute joints; a ball has SphericalProfile, WinklerLiner."
        )
        of = "a journal in its bearing" if is_bearing else "a ball in its socket"
        remedy_of_depth = (
            "Give sj.laws.FourierDepth(coefficients): a depth around the axis."
            if is_bearing
            else "Give sj.laws.HarmonicDepth(coefficients): a depth by direction."
        )
        surfaces = self.surfaces
        depths = {"socket_depth": surfaces.socket_depth, "ball_depth": surfaces.ball_depth}
        return [
            Requirement("conformity", name, fits, f"be of {of}", remedy),
            *(
                Requirement(
                    field, type(depth).__name__, depth.is_around_axis == is_bearing, f"be of {of}", remedy_of_depth
                )
                for field, depth in depths.items()
                if depth is not None
            ),
        ]

    def penetration(self, motion):
        """|e| - c [m]; less, on surfaces that are not round, by their depths in the direction of e."""
        if self.surfaces.are_round:
            return safe_norm(motion.eccentricity) - self.clearance
        return surface_contact(motion, self.surfaces).penetration

    def penetration_rate(self, motion):
        """Its time derivative [m/s]."""
        if self.surfaces.are_round:
            return super().penetration_rate(motion)
        return surface_contact(motion, self.surfaces).penetration_rate

    def crossing(self, motion):
        """Sign change at a penetration of zero."""
        return contact_crossing(motion, self.surfaces)

    def is_touching(self, memory):
        """Whether an onset is remembered."""
        return is_touching(memory)

    def memory_at_onset(self, onset_rate):
        """Onset rate, and bristles undeflected."""
        return memory_at_onset(self.memory, onset_rate)

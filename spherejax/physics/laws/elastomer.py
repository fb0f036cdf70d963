"""Elastomers of a bushing: ball and socket bonded by rubber, without a gap.

Each member answers a deflection (the eccentricity vector) and its rate with a force on the ball; a bushing
that also resists rotation answers with a moment. The elastic parts derive from `elastic_energy`, so an
energy balance closes. Here: the family, and those with a pivot that turns freely.
"""

import abc
from typing import Annotated, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import non_negative
from spherejax.foundations.numerics import radial_projection, safe_norm
from spherejax.foundations.rotation import rotation_vector
from spherejax.foundations.types import Matrix3, Number, Quaternion, Scalar, Unit, Vector3
from spherejax.physics.laws.base import AbstractLaw

LARGEST_ROTATION = 1.5 * np.pi
"""Largest rotation [rad] that is measured by its vector, which has no direction after a whole turn. The audit looks at
the ends of steps, and from here to where the vector is as short again on the other side no step leads."""


class AbstractElastomer(AbstractLaw):
    """The resistance of a bushing.

    Attributes:
        isotropic: whether the law has no axes of its own: it then receives vectors in world axes, otherwise
            in socket axes, with the rate that an observer on the socket sees.
    """

    isotropic: eqx.AbstractClassVar[bool]

    @property
    @abc.abstractmethod
    def resists_rotation(self) -> bool:
        """Whether `moment` is more than zero."""

    @abc.abstractmethod
    def force(self, deflection: Vector3, deflection_rate: Vector3) -> Vector3:
        """Force on the ball [N], applied at its center; the socket receives the opposite one at the same
        point.

        Args:
            deflection: e, socket center to ball center [m].
            deflection_rate: its rate [m/s].
        """

    def measure_of_rotation(self, relative_quaternion: Quaternion) -> Vector3:
        """What the law takes for the rotation of the ball in the socket: the rotation vector [rad], or its own measure.

        The rotation vector has no direction after a whole turn, and a run ends before: see `rotation_share`. A law for
        a joint that turns many times has another measure.
        """
        return rotation_vector(relative_quaternion)

    def rotation_share(self, relative_quaternion: Quaternion) -> Scalar | None:
        """The rotation as a share of the largest for which its measure is good: a run ends beyond 1. None for any."""
        rotation = self.measure_of_rotation(relative_quaternion)
        return safe_norm(rotation) / LARGEST_ROTATION if self.resists_rotation else None

    def resisted_rotation(self, rotation: Vector3) -> Matrix3:
        """B: what of an angular velocity the law resists, as B w; relaxation and inner friction act on that alone.

        All of it, unless a law leaves a turn free.

        Args:
            rotation: as `measure_of_rotation` has it.
        """
        del rotation
        return jnp.eye(3)

    @abc.abstractmethod
    def moment(self, rotation: Vector3, rotation_rate: Vector3) -> Vector3:
        """Moment on the ball [N m], in socket axes.

        Args:
            rotation: of the ball relative to the socket, socket axes, as `measure_of_rotation` has it.
            rotation_rate: relative angular velocity, socket axes [rad/s].
        """

    @abc.abstractmethod
    def elastic_energy(self, deflection: Vector3, rotation: Vector3) -> Scalar:
        """Energy stored in the elastomer [J]."""

    def requirements_of_free_turning(self) -> list[Requirement]:
        """What the law must satisfy, besides its requirements, in a joint that turns freely about its axis z."""
        return []


class AbstractPivotElastomer(AbstractElastomer):
    """An elastomer around a pivot that turns freely."""

    @property
    def resists_rotation(self) -> bool:
        """False."""
        return False

    def moment(self, rotation: Vector3, rotation_rate: Vector3) -> Vector3:
        """Zero."""
        return jnp.zeros(3)


class RadialElastomer(AbstractPivotElastomer):
    """The paper's bushing: a linear spring and a damper of the radial rate alone.

        f = -k (e + b P e_rate)

    Attributes:
        stiffness: k [N/m].
        damping: b, stiffness-proportional [s].

    Limits: at e = 0, where the line of centers is undefined, the damper acts alike in every direction (P =
    I, see `spherejax.foundations.numerics.radial_projection`). Motion across the line of centers is undamped.

    Source: Rodrigues da Silva et al. (2022), Eq. 41, after Ambrosio and Verissimo (2009).
    """

    never_adds_energy: ClassVar[bool] = True

    stiffness: Annotated[Number, Unit("N/m")]
    damping: Annotated[Number, Unit("s")]
    isotropic: ClassVar[bool] = True

    def force(self, deflection: Vector3, deflection_rate: Vector3) -> Vector3:
        """-k (e + b P e_rate) [N]."""
        return -self.stiffness * (deflection + self.damping * radial_projection(deflection, deflection_rate))

    def elastic_energy(self, deflection: Vector3, rotation: Vector3) -> Scalar:
        """k e.e/2 [J]."""
        return 0.5 * self.stiffness * (deflection @ deflection)

    def requirements(self) -> list[Requirement]:
        """k >= 0, b >= 0."""
        return _spring_and_damper(self)


class VectorElastomer(AbstractPivotElastomer):
    """A linear spring and damper that damps motion in every direction.

        f = -k (e + b e_rate)

    Attributes:
        stiffness: k [N/m].
        damping: b, stiffness-proportional [s].

    Limits: linear, hence smooth at e = 0; equal to `RadialElastomer` for radial motion.

    Source: Rodrigues da Silva et al. (2022), Eq. 41, with the rate of the vector in place of the radial one.
    """

    never_adds_energy: ClassVar[bool] = True

    stiffness: Annotated[Number, Unit("N/m")]
    damping: Annotated[Number, Unit("s")]
    isotropic: ClassVar[bool] = True

    def force(self, deflection: Vector3, deflection_rate: Vector3) -> Vector3:
        """-k (e + b e_rate) [N]."""
        return -self.stiffness * (deflection + self.damping * deflection_rate)

    def elastic_energy(self, deflection: Vector3, rotation: Vector3) -> Scalar:
        """k e.e/2 [J]."""
        return 0.5 * self.stiffness * (deflection @ deflection)

    def requirements(self) -> list[Requirement]:
        """k >= 0, b >= 0."""
        return _spring_and_damper(self)


def _spring_and_damper(elastomer) -> list[Requirement]:
    return [
        non_negative("stiffness", elastomer.stiffness, "N/m"),
        non_negative("damping", elastomer.damping, "s"),
    ]

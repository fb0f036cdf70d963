"""Elastomers of joints that turn freely: moments depend on how axes tilt, never on how far the joint has turned."""

import abc
from typing import Annotated, ClassVar

import jax.numpy as jnp

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import non_negative
from spherejax.foundations.types import Matrix3, Number, Quaternion, Scalar, Unit, Vector3
from spherejax.physics.laws.elastomer import AbstractElastomer
from spherejax.physics.laws.elastomer_matrix import symmetric_requirement

_SMALL_SINE = 1e-3
"""Below it angle/sine and angle**2 by series: their first neglected terms are below 1e-18."""

_HALF_TURN = 1e-8
"""Sine below which an axis that points backwards counts as turned by half a turn, where the tilt has no direction."""


class AbstractAxisElastomer(AbstractElastomer):
    """An elastomer whose rotation is measured by an axis of the ball in the axes of the socket.

    Attributes:
        stiffness: K, (3, 3) symmetric [N/m], along the joint's axes.
        damping: D, (3, 3) symmetric [N s/m].
    """

    isotropic: ClassVar[bool] = False

    @property
    @abc.abstractmethod
    def matrices(self) -> tuple[Matrix3, Matrix3]:
        """K and D."""

    @property
    def resists_rotation(self) -> bool:
        """True."""
        return True

    def rotation_share(self, relative_quaternion: Quaternion) -> None:
        """None: an axis is what it is at any turn."""
        del relative_quaternion

    def force(self, deflection: Vector3, deflection_rate: Vector3) -> Vector3:
        """-(K e + D e_rate) [N]."""
        K, D = (jnp.asarray(matrix) for matrix in self.matrices)
        return -(K @ deflection + D @ deflection_rate)

    def elastic_energy(self, deflection: Vector3, rotation: Vector3) -> Scalar:
        """e^T K e/2 and the energy of the tilt [J]."""
        return 0.5 * (deflection @ (jnp.asarray(self.matrices[0]) @ deflection)) + self.tilt_energy(rotation)

    @abc.abstractmethod
    def tilt_energy(self, axis: Vector3) -> Scalar:
        """Energy of the tilt [J]."""


class HingeElastomer(AbstractAxisElastomer):
    """The bushing of a joint that turns about its axis z: revolute, or cylindrical with no axial stiffness.

        f = -(K e + D e_rate)
        m = -(k_c alpha t + d_c (w - a (a . w)) + d_t a (a . w)),    alpha = angle(z, a), t = z x a/|z x a|

    a is the ball's z axis, seen from the socket: it does not change when the joint turns. The moment of the tilt
    derives from k_c alpha**2/2 at any angle.

    Attributes:
        stiffness: K, (3, 3) symmetric [N/m], along the joint's axes; zero in zz for a joint that slides.
        damping: D, (3, 3) symmetric [N s/m].
        conical_stiffness: k_c, against tilting the axis [N m/rad].
        conical_damping: d_c, of the angular velocity across the ball's axis [N m s/rad].
        torsional_damping: d_t, of the angular velocity along it [N m s/rad].

    Limits: without tilt the moment is 0 and its derivative k_c. At a tilt of pi, where t has no direction, the
    elastic moment is taken as 0.
    """

    never_adds_energy: ClassVar[bool] = True

    stiffness: Annotated[Matrix3, Unit("N/m")]
    damping: Annotated[Matrix3, Unit("N s/m")]
    conical_stiffness: Annotated[Number, Unit("N m/rad")]
    conical_damping: Annotated[Number, Unit("N m s/rad")] = 0.0
    torsional_damping: Annotated[Number, Unit("N m s/rad")] = 0.0

    @classmethod
    def symmetric(
        cls,
        *,
        radial_stiffness: Number,
        axial_stiffness: Number,
        conical_stiffness: Number,
        damping: Number,
        torsional_damping: Number = 0.0,
    ) -> "HingeElastomer":
        """A bushing that is the same in all directions across its axis.

        Args:
            radial_stiffness: across the axis [N/m].
            axial_stiffness: along the axis [N/m]; zero for a joint that slides.
            conical_stiffness: against tilting the axis [N m/rad].
            damping: b, stiffness-proportional, for all three [s].
            torsional_damping: against turning [N m s/rad].
        """
        K = radial_stiffness * jnp.diag(jnp.array([1.0, 1.0, 0.0])) + axial_stiffness * jnp.diag(
            jnp.array([0.0, 0.0, 1.0])
        )
        return cls(K, damping * K, conical_stiffness, damping * conical_stiffness, torsional_damping)

    @property
    def matrices(self) -> tuple[Matrix3, Matrix3]:
        """K and D."""
        return self.stiffness, self.damping

    def measure_of_rotation(self, relative_quaternion: Quaternion) -> Vector3:
        """a: the ball's z axis in socket axes."""
        return turned_axis(relative_quaternion, 2)

    def resisted_rotation(self, rotation: Vector3) -> Matrix3:
        """I - a a^T: rotation across the ball's axis."""
        return jnp.eye(3) - rotation[:, None] * rotation[None, :]

    def moment(self, rotation: Vector3, rotation_rate: Vector3) -> Vector3:
        """-(k_c alpha t + d_c (w - a (a . w)) + d_t a (a . w)) [N m]."""
        a = rotation
        sine_squared = a[0] * a[0] + a[1] * a[1]
        ratio, _ = _angle_over_sine(sine_squared, a[2])
        tilt = ratio * jnp.stack([-a[1], a[0], jnp.zeros_like(a[0])])
        along = a * (a @ rotation_rate)
        damping = self.conical_damping * (rotation_rate - along) + self.torsional_damping * along
        return -(self.conical_stiffness * tilt + damping)

    def tilt_energy(self, axis: Vector3) -> Scalar:
        """k_c alpha**2/2 [J]."""
        _, angle_squared = _angle_over_sine(axis[0] * axis[0] + axis[1] * axis[1], axis[2])
        return 0.5 * self.conical_stiffness * angle_squared

    def requirements(self) -> list[Requirement]:
        """Symmetric matrices and numbers that are not negative."""
        return [
            symmetric_requirement("stiffness", self.stiffness),
            symmetric_requirement("damping", self.damping),
            non_negative("conical_stiffness", self.conical_stiffness, "N m/rad"),
            non_negative("conical_damping", self.conical_damping, "N m s/rad"),
            non_negative("torsional_damping", self.torsional_damping, "N m s/rad"),
        ]


class CrossElastomer(AbstractAxisElastomer):
    """The bushing of a universal joint: it turns about both arms of its cross, and holds the right angle between them.

        f = -(K e + D e_rate)
        m = -(k_s beta + d_s beta_rate) n,    beta = pi/2 - angle(z, a), n = a x z/|a x z|

    z is the first body's arm, a the second body's arm, seen from the first; beta_rate = w . n. The elastic moment
    derives from k_s beta**2/2 at any turn of either arm.

    Attributes:
        stiffness: K, (3, 3) symmetric [N/m], in axes of the first body with z along its arm.
        damping: D, (3, 3) symmetric [N s/m].
        torsional_stiffness: k_s [N m/rad].
        torsional_damping: d_s [N m s/rad].

    Limits: at beta = pi/2, where n has no direction, the moment is 0.
    """

    never_adds_energy: ClassVar[bool] = True

    stiffness: Annotated[Matrix3, Unit("N/m")]
    damping: Annotated[Matrix3, Unit("N s/m")]
    torsional_stiffness: Annotated[Number, Unit("N m/rad")]
    torsional_damping: Annotated[Number, Unit("N m s/rad")] = 0.0

    @property
    def matrices(self) -> tuple[Matrix3, Matrix3]:
        """K and D."""
        return self.stiffness, self.damping

    def measure_of_rotation(self, relative_quaternion: Quaternion) -> Vector3:
        """a: the ball's x axis, which is the second arm, in socket axes."""
        return turned_axis(relative_quaternion, 0)

    def resisted_rotation(self, rotation: Vector3) -> Matrix3:
        """n^T in the first row: the turn beta is one number, whatever the turns of the arms."""
        normal, _ = _across_the_cross(rotation)
        return jnp.array([1.0, 0.0, 0.0])[:, None] * normal[None, :]

    def moment(self, rotation: Vector3, rotation_rate: Vector3) -> Vector3:
        """-(k_s beta + d_s w . n) n [N m]."""
        normal, cosine = _across_the_cross(rotation)
        beta = jnp.arctan2(rotation[2], cosine)
        return -(self.torsional_stiffness * beta + self.torsional_damping * (rotation_rate @ normal)) * normal

    def tilt_energy(self, axis: Vector3) -> Scalar:
        """k_s beta**2/2 [J]."""
        cosine_squared = axis[0] * axis[0] + axis[1] * axis[1]
        regular = cosine_squared > _HALF_TURN**2
        beta = jnp.arctan2(axis[2], jnp.sqrt(jnp.where(regular, cosine_squared, _HALF_TURN**2)))
        return 0.5 * self.torsional_stiffness * beta * beta

    def requirements(self) -> list[Requirement]:
        """Symmetric matrices and numbers that are not negative."""
        return [
            symmetric_requirement("stiffness", self.stiffness),
            symmetric_requirement("damping", self.damping),
            non_negative("torsional_stiffness", self.torsional_stiffness, "N m/rad"),
            non_negative("torsional_damping", self.torsional_damping, "N m s/rad"),
        ]


def _across_the_cross(a: Vector3) -> tuple[Vector3, Scalar]:
    """n = a x z/|a x z| and |a x z|. Limits: 0 and 1 where a points along z."""
    cosine_squared = a[0] * a[0] + a[1] * a[1]
    regular = cosine_squared > _HALF_TURN**2
    cosine = jnp.sqrt(jnp.where(regular, cosine_squared, 1.0))
    return jnp.where(regular, 1.0, 0.0) * jnp.stack([a[1], -a[0], jnp.zeros_like(a[0])]) / cosine, cosine


def turned_axis(quaternion: Quaternion, index: int) -> Vector3:
    """A column of a quaternion's rotation matrix: where a coordinate axis is turned to."""
    p0, p1, p2, p3 = quaternion
    square = p0 * p0 + p1 * p1 + p2 * p2 + p3 * p3
    if index == 0:
        return jnp.stack([square - 2 * (p2 * p2 + p3 * p3), 2 * (p1 * p2 + p0 * p3), 2 * (p1 * p3 - p0 * p2)]) / square
    return jnp.stack([2 * (p1 * p3 + p0 * p2), 2 * (p2 * p3 - p0 * p1), square - 2 * (p1 * p1 + p2 * p2)]) / square


def _angle_over_sine(sine_squared: Scalar, cosine: Scalar) -> tuple[Scalar, Scalar]:
    """angle/sin(angle) and angle**2, for an angle between 0 and pi by the square of its sine and its cosine.

    Limits: 1 + sine**2/6 + ... and sine**2 + sine**4/3 + ... at 0; at pi the quotient is 0.
    """
    is_small = (sine_squared < _SMALL_SINE**2) & (cosine > 0)
    is_backwards = (sine_squared < _HALF_TURN**2) & (cosine <= 0)
    is_regular = ~(is_small | is_backwards)
    sine = jnp.sqrt(jnp.where(is_regular, sine_squared, 1.0))
    angle = jnp.arctan2(sine, jnp.where(is_regular, cosine, 1.0))
    s = jnp.where(is_small, sine_squared, 0.0)
    near = 1 + s / 6 * (1 + s * 9 / 20 * (1 + s * 25 / 42))
    near_squared = s * (1 + s / 3 * (1 + s * 8 / 15))
    ratio = jnp.where(is_regular, angle / sine, jnp.where(is_small, near, 0.0))
    squared = jnp.where(is_regular, angle * angle, jnp.where(is_small, near_squared, jnp.pi**2))
    return ratio, squared

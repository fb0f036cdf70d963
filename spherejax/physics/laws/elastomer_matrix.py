"""Elastomers that resist rotation as well: six components, for joints that hold a direction or an orientation."""

from typing import Annotated, ClassVar, Self

import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import numeric
from spherejax.foundations.numerics import BERNOULLI, horner
from spherejax.foundations.types import Matrix3, Number, Quaternion, Scalar, Unit, Vector3
from spherejax.physics.laws.elastomer import AbstractElastomer

_COTANGENT_RADIUS = 1.0
"""Rotation angle [rad] below which 1 - (angle/2) cot(angle/2) has lost digits, and the series is used."""

_COTANGENT_SERIES = tuple(
    float(abs(b)) / float(np.prod(np.arange(1.0, 2 * k + 1))) for k, b in enumerate(BERNOULLI, start=1)
)
"""Of (1 - (angle/2) cot(angle/2))/angle**2 in angle**2: Abramowitz and Stegun (1964), 4.3.70.

Eleven terms leave 1e-18 at 1 rad.
"""


class MatrixElastomer(AbstractElastomer):
    """Linear stiffness and damping along and about the socket's axes.

        f = -(K e + D e_rate)
        m = -(J^-T K_r theta + D_r omega),    J^-T x = x + theta x x/2 + g theta x (theta x x)
        g = (1 - (|theta|/2) cot(|theta|/2))/|theta|**2

    J relates the rotation vector's rate to the angular velocity, omega = J theta_rate. With it the elastic
    moment derives from theta^T K_r theta/2 at any angle; without it (the usual small-angle law -K_r theta) an
    anisotropic bushing would gain or lose energy with the square of the angle. Both agree for isotropic K_r.

    Attributes:
        stiffness: K, (3, 3) symmetric [N/m].
        damping: D, (3, 3) symmetric [N s/m].
        rotational_stiffness: K_r, (3, 3) symmetric [N m/rad], or `None`.
        rotational_damping: D_r, (3, 3) symmetric [N m s/rad], or `None`.

    Limits: linear at e = 0 and theta = 0, where g = 1/12 and J = I; g = 1/pi**2 at pi, and grows without bound
    towards 2 pi, where a rotation vector has no direction. A run in which the joint is turned by more than three
    quarters of a turn ends (status AUDIT_FAILED). For more: in a joint about an axis `HingeElastomer`, with a
    `TorsionalSpring` beside the joint where its torsion is elastic.

    Source: the general bushing of Ambrosio and Verissimo (2009), Multibody Syst. Dyn. 22:341-365, to which
    the exact J is added.
    """

    never_adds_energy: ClassVar[bool] = True

    stiffness: Annotated[Matrix3, Unit("N/m")]
    damping: Annotated[Matrix3, Unit("N s/m")]
    rotational_stiffness: Annotated[Matrix3 | None, Unit("N m/rad")] = None
    rotational_damping: Annotated[Matrix3 | None, Unit("N m s/rad")] = None
    isotropic: ClassVar[bool] = False

    @classmethod
    def cylindrical(
        cls,
        axis: Vector3,
        *,
        radial_stiffness: Number,
        axial_stiffness: Number,
        conical_stiffness: Number,
        torsional_stiffness: Number,
        damping: Number,
    ) -> Self:
        """A bushing with an axis of symmetry.

        Args:
            axis: its direction in socket axes, any length but zero.
            radial_stiffness: across the axis [N/m].
            axial_stiffness: along the axis [N/m].
            conical_stiffness: against tilting the axis [N m/rad].
            torsional_stiffness: about the axis [N m/rad].
            damping: b, stiffness-proportional, for all four [s].

        Source: Ambrosio and Verissimo (2009), the four deformations of their Sect. 3.
        """
        a = jnp.asarray(axis, dtype=float)
        along = a[:, None] * a[None, :] / (a @ a)
        across = jnp.eye(3) - along
        K = radial_stiffness * across + axial_stiffness * along
        K_r = conical_stiffness * across + torsional_stiffness * along
        return cls(K, damping * K, K_r, damping * K_r)

    @property
    def resists_rotation(self) -> bool:
        """Whether a rotational stiffness or damping was given."""
        return self.rotational_stiffness is not None or self.rotational_damping is not None

    def rotation_share(self, relative_quaternion: Quaternion) -> Scalar | None:
        """Of a rotation that is resisted elastically; damping alone asks for no measure."""
        if self.rotational_stiffness is None:
            return None
        share = AbstractElastomer.rotation_share(self, relative_quaternion)
        assert share is not None
        return jnp.where(jnp.any(jnp.asarray(self.rotational_stiffness) != 0), share, 0.0)

    def force(self, deflection: Vector3, deflection_rate: Vector3) -> Vector3:
        """-(K e + D e_rate) [N]."""
        return -(jnp.asarray(self.stiffness) @ deflection + jnp.asarray(self.damping) @ deflection_rate)

    def moment(self, rotation: Vector3, rotation_rate: Vector3) -> Vector3:
        """-(J^-T K_r theta + D_r omega) [N m]."""
        moment = jnp.zeros(3)
        if self.rotational_stiffness is not None:
            moment = moment - _inverse_transposed_jacobian(rotation, jnp.asarray(self.rotational_stiffness) @ rotation)
        if self.rotational_damping is not None:
            moment = moment - jnp.asarray(self.rotational_damping) @ rotation_rate
        return moment

    def elastic_energy(self, deflection: Vector3, rotation: Vector3) -> Scalar:
        """(e^T K e + theta^T K_r theta)/2 [J]."""
        energy = 0.5 * (deflection @ (jnp.asarray(self.stiffness) @ deflection))
        if self.rotational_stiffness is not None:
            energy = energy + 0.5 * (rotation @ (jnp.asarray(self.rotational_stiffness) @ rotation))
        return energy

    def requirements(self) -> list[Requirement]:
        """Every matrix symmetric with a diagonal that is not negative."""
        matrices = {
            "stiffness": self.stiffness,
            "damping": self.damping,
            "rotational_stiffness": self.rotational_stiffness,
            "rotational_damping": self.rotational_damping,
        }
        return [symmetric_requirement(field, value) for field, value in matrices.items() if value is not None]

    def requirements_of_free_turning(self) -> list[Requirement]:
        """A torsional stiffness that brings the joint back: the rotation vector goes through less than a turn."""
        if self.rotational_stiffness is None:
            return []
        torsional = numeric(self.rotational_stiffness)[2, 2]
        return [
            Requirement(
                "rotational_stiffness",
                self.rotational_stiffness,
                torsional > 0,
                "have a positive entry zz (torsion about the joint's axis)",
                "A joint that turns freely takes HingeElastomer or CrossElastomer, whose tilt is right at any turn.",
            )
        ]


def _inverse_transposed_jacobian(theta: Vector3, x: Vector3) -> Vector3:
    """x + theta x x/2 + g theta x (theta x x): J^-T of the left Jacobian J of the rotation vector."""
    square = theta @ theta
    near = square < _COTANGENT_RADIUS**2
    square_near = jnp.where(near, square, 0.0)
    square_far = jnp.where(near, 1.0, square)
    half = 0.5 * jnp.sqrt(square_far)
    far = (1.0 - half * jnp.cos(half) / jnp.sin(half)) / square_far
    g = jnp.where(near, horner(_COTANGENT_SERIES, square_near), far)
    once = jnp.cross(theta, x)
    return x + 0.5 * once + g * jnp.cross(theta, once)


def symmetric_requirement(field: str, value) -> Requirement:
    """A symmetric (3, 3) matrix whose diagonal is not negative."""
    matrix = numeric(value)
    expected = "be a symmetric (3, 3) matrix without negative diagonal entries"
    remedy = "Give [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]] along the socket's axes."
    if matrix.shape != (3, 3):
        return Requirement(field, value, False, expected, remedy)
    scale = abs(matrix).max()
    rounding = 1e-12  # of the largest entry: what a rotation into other axes leaves
    symmetric = (abs(matrix - matrix.T) <= rounding * scale).all()
    finite = scale < np.inf
    return Requirement(
        field,
        value,
        symmetric & finite & (matrix[0, 0] >= 0) & (matrix[1, 1] >= 0) & (matrix[2, 2] >= 0),
        expected,
        remedy,
    )

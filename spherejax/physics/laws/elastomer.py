"""Elastomers of a bushing: ball and socket bonded by rubber, without a gap.

Each member answers a deflection (the eccentricity vector) and its rate with a force on the ball; a bushing
that also resists rotation answers with a moment. The elastic parts derive from `elastic_energy`, so an
energy balance closes.
"""

import abc
from typing import ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.numerics import BERNOULLI, horner, radial_projection
from spherejax.foundations.types import Matrix3, Number, Scalar, Vector3
from spherejax.physics.laws.base import AbstractLaw, non_negative, numeric

_COTANGENT_RADIUS = 1.0
"""Rotation angle [rad] below which 1 - (angle/2) cot(angle/2) has lost digits, and the series is used."""

_COTANGENT_SERIES = tuple(
    float(abs(b)) / float(np.prod(np.arange(1.0, 2 * k + 1))) for k, b in enumerate(BERNOULLI, start=1)
)
"""Of (1 - (angle/2) cot(angle/2))/angle**2 in angle**2: Abramowitz and Stegun (1964), 4.3.70.

Eleven terms leave 1e-18 at 1 rad.
"""


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

    @abc.abstractmethod
    def moment(self, rotation: Vector3, rotation_rate: Vector3) -> Vector3:
        """Moment on the ball [N m], in socket axes.

        Args:
            rotation: rotation vector of the ball relative to the socket, socket axes [rad].
            rotation_rate: relative angular velocity, socket axes [rad/s].
        """

    @abc.abstractmethod
    def elastic_energy(self, deflection: Vector3, rotation: Vector3) -> Scalar:
        """Energy stored in the elastomer [J]."""


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

    stiffness: Number
    damping: Number
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

    stiffness: Number
    damping: Number
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

    Limits: linear at e = 0 and theta = 0, where g = 1/12 and J = I. g = 1/pi**2 at pi, beyond which the
    rotation vector jumps.

    Source: the general bushing of Ambrosio and Verissimo (2009), Multibody Syst. Dyn. 22:341-365, to which
    the exact J is added.
    """

    stiffness: Matrix3
    damping: Matrix3
    rotational_stiffness: Matrix3 | None = None
    rotational_damping: Matrix3 | None = None
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
        return [_symmetric(field, value) for field, value in matrices.items() if value is not None]


class CurveElastomer(AbstractPivotElastomer):
    """A nonlinear radial spring, given by points of its force-deflection curve, with stiffness-proportional
    damping.

        f = -(F(|e|) n + b d/dt[F(|e|) n])

    F is the monotone piecewise cubic through the origin and the given points, continued as an odd function
    below the origin and by a straight line beyond the last point. The damper is b times the rate of the
    elastic force: the tangent stiffness F' along the line of centers, the secant F/|e| across it.

    Attributes:
        deflections: (n,) positive, increasing, without the origin [m].
        forces: (n,) positive, not decreasing [N].
        damping: b [s].

    Limits: at e = 0 both stiffnesses are F'(0), the slope of the first segment, so the force is smooth there:
    -F'(0) (e + b e_rate). F' is continuous with kinks at the points. With one point: `VectorElastomer`.

    Source: Fritsch and Butland (1984), SIAM J. Sci. Stat. Comput. 5:300-304, weighted harmonic mean slopes;
    the last one by the three-point formula with the limiter of Fritsch and Carlson (1980). The curve takes
    the place of k delta in Eq. 41 of Rodrigues da Silva et al. (2022).
    """

    deflections: Float[np.ndarray, " n"]
    forces: Float[np.ndarray, " n"]
    damping: Number
    isotropic: ClassVar[bool] = True

    def force(self, deflection: Vector3, deflection_rate: Vector3) -> Vector3:
        """-(F n + b d/dt[F n]) [N]."""
        _, secant, tangent = self._curve(deflection)
        rate = secant * deflection_rate + (tangent - secant) * radial_projection(deflection, deflection_rate)
        return -(secant * deflection + self.damping * rate)

    def elastic_energy(self, deflection: Vector3, rotation: Vector3) -> Scalar:
        """The integral of F from 0 to |e| [J]."""
        energy, _, _ = self._curve(deflection)
        return energy

    def requirements(self) -> list[Requirement]:
        """Points in order, b >= 0."""
        x, y = numeric(self.deflections), numeric(self.forces)
        same_length = x.ndim == 1 and x.shape == y.shape and x.shape[0] > 0
        requirements = [
            Requirement(
                "deflections",
                self.deflections,
                same_length,
                "be a list of one or more numbers, as many as forces",
                "Give one force for each deflection.",
            )
        ]
        if same_length:
            requirements += [
                Requirement(
                    "deflections",
                    self.deflections,
                    (x[0] > 0) & (x[1:] > x[:-1]).all() & (x[-1] < np.inf),
                    "be positive and increasing",
                    "Leave out the origin, which the curve always passes, and sort the points [m].",
                ),
                Requirement(
                    "forces",
                    self.forces,
                    (y[0] > 0) & (y[1:] >= y[:-1]).all() & (y[-1] < np.inf),
                    "be positive and not decreasing",
                    "Give the magnitude of the resisting force [N].",
                ),
            ]
        return [*requirements, non_negative("damping", self.damping, "s")]

    def _pieces(self):
        """Start, force, slope, quadratic and cubic coefficient of every piece, the straight end included;
        (n+1,) each."""
        x = jnp.concatenate([np.zeros(1), jnp.asarray(self.deflections)])
        y = jnp.concatenate([np.zeros(1), jnp.asarray(self.forces)])
        h = x[1:] - x[:-1]
        d = (y[1:] - y[:-1]) / h
        # The odd continuation has the first segment's slope on both sides of the origin: that is the slope
        # there, and the force stays smooth.
        m = jnp.concatenate([d[:1], _interior_slopes(h, d), _end_slope(h, d)])
        m0, m1 = m[:-1], m[1:]
        quadratic = (3.0 * d - 2.0 * m0 - m1) / h
        cubic = (m0 + m1 - 2.0 * d) / (h * h)
        straight = np.zeros(1)
        return h, x, y, m, jnp.concatenate([quadratic, straight]), jnp.concatenate([cubic, straight])

    def _curve(self, deflection: Vector3):
        """Energy [J], secant stiffness F/|e| and tangent stiffness F' [N/m]."""
        h, x, y, m, quadratic, cubic = self._pieces()
        square = deflection @ deflection
        beyond_first = square >= x[1] * x[1]
        length = jnp.sqrt(jnp.where(square > 0, square, 1.0))
        length = jnp.where(square > 0, length, 0.0)
        # Energy up to the start of each piece: the running sum, as a constant matrix.
        energies = h * (y[:-1] + h * (m[:-1] / 2.0 + h * (quadratic[:-1] / 3.0 + h * cubic[:-1] / 4.0)))
        stored = np.tri(h.shape[0] + 1, h.shape[0], -1) @ energies
        # Each piece is chosen by a sum in which all others are replaced by zero: no dynamic index.
        inside = length >= x
        inside = inside & jnp.concatenate([~inside[1:], np.ones(1, bool)])
        x0, y0, c1, c2, c3, energy0 = (jnp.sum(jnp.where(inside, c, 0.0)) for c in (x, y, m, quadratic, cubic, stored))
        u = length - x0
        energy = energy0 + u * (y0 + u * (c1 / 2.0 + u * (c2 / 3.0 + u * c3 / 4.0)))
        slope_sum = c1 + u * (c2 + u * c3)
        # On the first piece y0 = 0 and u = |e|: the quotient is known without a division.
        safe_length = jnp.where(beyond_first, length, 1.0)
        secant = jnp.where(beyond_first, (y0 + u * slope_sum) / safe_length, slope_sum)
        tangent = c1 + u * (2.0 * c2 + u * 3.0 * c3)
        return energy, secant, tangent


def _interior_slopes(h, d):
    """Slopes at the points between two segments of lengths h and slopes d: zero beside a flat one, for
    monotony."""
    h0, h1, d0, d1 = h[:-1], h[1:], d[:-1], d[1:]
    rising = (d0 > 0) & (d1 > 0)
    w0, w1 = 2.0 * h1 + h0, h1 + 2.0 * h0
    harmonic = (w0 + w1) / (w0 / jnp.where(rising, d0, 1.0) + w1 / jnp.where(rising, d1, 1.0))
    return jnp.where(rising, harmonic, 0.0)


def _end_slope(h, d):
    """Slope at the last point, (1,)."""
    if h.shape[0] == 1:
        return d
    h0, h1, d0, d1 = h[-1:], h[-2:-1], d[-1:], d[-2:-1]
    slope = ((2.0 * h0 + h1) * d0 - h0 * d1) / (h0 + h1)
    return jnp.where(slope > 0, jnp.where(slope < 3.0 * d0, slope, 3.0 * d0), 0.0)


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


def _spring_and_damper(elastomer) -> list[Requirement]:
    return [
        non_negative("stiffness", elastomer.stiffness, "N/m"),
        non_negative("damping", elastomer.damping, "s"),
    ]


def _symmetric(field: str, value) -> Requirement:
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

"""How deep a surface lies below its sphere or cylinder, by direction: one that is worn, or was never round.

A socket's depth h_i is counted outwards, a ball's h_j inwards, both along the radius. In the direction n = e/|e| the
ball may then go c + h_i + h_j from the socket's center:

    delta = |e| - c - h_i(A_i^T n) - h_j(A_j^T n)

with the axes A of the two bodies. A journal in its bearing is the same across the bearing's axis, with axes A of which
z is along it; a bearing whose depth changes along its axis is looked at in planes across it.
"""

import abc
from typing import Annotated, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import numeric
from spherejax.foundations.types import Listed, Number, Numeric, Scalar, Unit, Vector3
from spherejax.physics.bodies import numbers

LARGEST_DEGREE = 24
"""Of harmonics: 625 numbers. Beyond, a program would be of so many operations that its compilation takes minutes."""


LARGEST_ORDER = 64
"""Of harmonics around an axis: they resolve three degrees."""


class AbstractDepth(eqx.Module):
    """The depth of a surface below its sphere or cylinder, by direction.

    Attributes:
        is_around_axis: whether it is the depth of a cylinder, the same all along the axis (static).
    """

    is_around_axis: ClassVar[bool] = False

    @property
    @abc.abstractmethod
    def mean(self) -> Number:
        """Mean depth over the sphere or around the axis [m], by which radii and clearance enter a stiffness."""

    @property
    @abc.abstractmethod
    def least(self) -> Numeric:
        """The smallest depth [m]: clearance and depth together must leave a gap in every direction."""

    @abc.abstractmethod
    def depth(self, u: Vector3) -> Scalar:
        """h [m] at a unit vector in the axes of the surface's body; it must be smooth, and finite at u = 0."""

    @abc.abstractmethod
    def requirements(self) -> list[Requirement]:
        """The values that the depth is defined for."""

    def depth_and_gradient(self, u: Vector3) -> tuple[Scalar, Vector3]:
        """h [m] and its gradient by u [m]; of the gradient only what is across u counts."""
        return jax.value_and_grad(self.depth)(u)


class HarmonicDepth(AbstractDepth):
    """A smooth depth, as real spherical harmonics.

        h(u) = sum_n sum_m a_nm Y_nm(u),    n = 0 ... L,  m = -n ... n

    with Schmidt's semi-normalization: Y_00 = 1, (Y_1-1, Y_10, Y_11) = (y, z, x), and sum_m Y_nm^2 = 1 for each n. So
    a_00 is the mean depth, and the three of n = 1 are a shift of the sphere.

    Attributes:
        coefficients: a_nm at the index n^2 + n + m, shape ((L + 1)^2,) [m].

    Limits: a surface is resolved down to about 180/L degrees, and a narrower pocket rings around its edges.

    Source: Abramowitz and Stegun (1964), 8.5.3, for the recurrence of Legendre's functions. The power of the sine in
    them is joined with cos and sin of m phi to (x + i y)^m, so that everything is a polynomial and no pole is singular.
    """

    coefficients: Numeric

    def __init__(self, coefficients: Annotated[Listed, Unit("m")]):
        self.coefficients = numbers(coefficients)

    @property
    def degree(self) -> int:
        """L."""
        return round(np.sqrt(np.size(self.coefficients))) - 1

    @property
    def mean(self) -> Number:
        """a_00 [m]."""
        return jnp.asarray(self.coefficients)[0]

    @property
    def least(self) -> Numeric:
        """The smallest depth on a grid with (2 L + 2)^2 directions, two for each half wave [m]."""
        return jnp.min(harmonics(grid_of(2 * self.degree + 1)[0], self.degree) @ jnp.asarray(self.coefficients))

    def depth(self, u: Vector3) -> Scalar:
        """h [m]."""
        return self.depth_and_gradient(u)[0]

    def depth_and_gradient(self, u: Vector3) -> tuple[Scalar, Vector3]:
        """h [m], and the gradient of its polynomial by u [m]."""
        L, a = self.degree, jnp.asarray(self.coefficients)
        x, y, z = u[0], u[1], u[2]
        legendre = _legendre(z, L)
        zero = jnp.zeros(())
        value, along_x, along_y, along_z = zero, zero, zero, zero
        # Re and Im of (x + i y)^m, and of the power before
        real, imaginary, real_before, imaginary_before = jnp.ones(()), zero, zero, zero
        for m in range(L + 1):
            factors = [_NORM[n, m] for n in range(m, L + 1)]
            plus = [a[n * n + n + m] * f for n, f in zip(range(m, L + 1), factors, strict=True)]
            minus = [a[n * n + n - m] * f for n, f in zip(range(m, L + 1), factors, strict=True)] if m else []
            cosine, cosine_slope = _weighted(plus, legendre, m, L)
            sine, sine_slope = _weighted(minus, legendre, m, L) if m else (zero, zero)
            value = value + cosine * real + sine * imaginary
            along_z = along_z + cosine_slope * real + sine_slope * imaginary
            along_x = along_x + m * (cosine * real_before + sine * imaginary_before)
            along_y = along_y + m * (sine * real_before - cosine * imaginary_before)
            real_before, imaginary_before = real, imaginary
            real, imaginary = x * real - y * imaginary, x * imaginary + y * real
        return value, jnp.stack([along_x, along_y, along_z])

    def requirements(self) -> list[Requirement]:
        """A full set of finite numbers, up to a degree that can be compiled."""
        shape, size = np.shape(self.coefficients), np.size(self.coefficients)
        is_full = len(shape) == 1 and size > 0 and size == (self.degree + 1) ** 2
        a = numeric(self.coefficients)
        return [
            Requirement(
                "coefficients",
                f"{size} numbers",
                is_full,
                "be 1, 4, 9, 16, ... numbers in a row",
                "Give all (L + 1)^2 of the degrees up to L, those that are not wanted as zeros.",
            ),
            Requirement(
                "coefficients",
                f"{size} numbers",
                self.degree <= LARGEST_DEGREE,
                f"be of a degree up to {LARGEST_DEGREE}",
                "Leave the higher degrees out.",
            ),
            Requirement(
                "coefficients",
                self.coefficients,
                abs(a) < np.inf,
                "be finite",
                "Give depths in meters, e.g. coefficients=[1e-5, 0.0, 0.0, 0.0].",
            ),
        ]


class FourierDepth(AbstractDepth):
    """A smooth depth of a cylinder around its axis, the same all along it: a bearing or a journal that is not round.

        h(phi) = a_0 + sum_m (a_m cos m phi + b_m sin m phi),    m = 1 ... M

    phi is counted about the joint's axis a from the joint's x axis, which each of both bodies takes with it. At the
    start x = a x k/|a x k|, with the coordinate direction k of the world (x, y or z) that is least along the axis; of
    equal ones the first: about the world's z, phi is counted from the world's y; about y, from -z; about x, from z.

    Attributes:
        coefficients: a_0, a_1, b_1, a_2, b_2, ..., shape (2 M + 1,) [m].

    Limits: a surface is resolved down to about 180/M degrees, and a narrower pocket rings around its edges. What is
    worn more at one end of the bearing than at the other is a `LegendreFourierDepth`.

    Source: cos m phi and sin m phi are the parts of (x + i y)^m, polynomials in the direction, so that everything is
    finite and smooth in the middle of the bearing, too.
    """

    is_around_axis: ClassVar[bool] = True

    coefficients: Numeric

    def __init__(self, coefficients: Annotated[Listed, Unit("m")]):
        self.coefficients = numbers(coefficients)

    @property
    def order(self) -> int:
        """M."""
        return np.size(self.coefficients) // 2

    @property
    def mean(self) -> Number:
        """a_0 [m]."""
        return jnp.asarray(self.coefficients)[0]

    @property
    def least(self) -> Numeric:
        """The smallest depth on a grid of 8 M + 4 angles, eight for each wave [m]."""
        turn = 2 * np.pi * np.arange(8 * self.order + 4) / (8 * self.order + 4)
        return jnp.min(waves(np.stack([np.cos(turn), np.sin(turn)], -1), self.order) @ jnp.asarray(self.coefficients))

    def depth(self, u: Vector3) -> Scalar:
        """h [m]."""
        return self.depth_and_gradient(u)[0]

    def depth_and_gradient(self, u: Vector3) -> tuple[Scalar, Vector3]:
        """h [m], and the gradient of its polynomial by u [m], which has no part along the axis."""
        a = jnp.asarray(self.coefficients)
        x, y = u[0], u[1]
        value, along_x, along_y = a[0], jnp.zeros(()), jnp.zeros(())
        real, imaginary = jnp.ones(()), jnp.zeros(())  # of (x + i y)^(m - 1)
        for m in range(1, self.order + 1):
            cosine, sine = a[2 * m - 1], a[2 * m]
            along_x = along_x + m * (cosine * real + sine * imaginary)
            along_y = along_y + m * (sine * real - cosine * imaginary)
            real, imaginary = x * real - y * imaginary, x * imaginary + y * real
            value = value + cosine * real + sine * imaginary
        return value, jnp.stack([along_x, along_y, jnp.zeros(())])

    def requirements(self) -> list[Requirement]:
        """An odd number of finite numbers, up to an order that can be compiled."""
        shape, size = np.shape(self.coefficients), np.size(self.coefficients)
        return [
            Requirement(
                "coefficients",
                f"{size} numbers",
                len(shape) == 1 and size % 2 == 1,
                "be 1, 3, 5, ... numbers in a row",
                "Give a_0, and a cosine and a sine for each order.",
            ),
            Requirement(
                "coefficients",
                f"{size} numbers",
                self.order <= LARGEST_ORDER,
                f"be of an order up to {LARGEST_ORDER}",
                "Leave the higher orders out.",
            ),
            Requirement(
                "coefficients",
                self.coefficients,
                abs(numeric(self.coefficients)) < np.inf,
                "be finite",
                "Give depths in meters, e.g. coefficients=[1e-5, 0.0, 0.0].",
            ),
        ]


class LegendreFourierDepth(eqx.Module):
    """A smooth depth of a bearing by the angle and by the place along its axis: worn more at one end than at the other.

        h(phi, s) = sum_k P_k(s) (a_k0 + sum_m (a_km cos m phi + b_km sin m phi)),    s = 2 z/L,  k = 0 ... K

    with Legendre's polynomials P_k = 1, s, (3 s^2 - 1)/2, ... and the angle phi of `FourierDepth`. The first row is the
    mean along the axis, so a_00 times the bearing's area is the volume; the second row tilts the surface.

    It is the `socket_depth` of `sj.joints.tilting_journal`, whose planes of contact have the depths that are there.

    Attributes:
        coefficients: by row a_k0, a_k1, b_k1, a_k2, b_k2, ..., shape (K + 1, 2 M + 1) [m].

    Limits: n planes see no more than n rows. A parallel journal (`Revolute`) and a film have no such depth.

    Source: Legendre's polynomials by their recurrence, Abramowitz and Stegun (1964), 8.5.3.
    """

    coefficients: Numeric

    def __init__(self, coefficients: Annotated[Numeric, Unit("m")]):
        self.coefficients = numbers(coefficients)

    @property
    def rows(self) -> int:
        """K + 1."""
        return np.shape(self.coefficients)[0]

    @property
    def mean(self) -> Number:
        """a_00, over the whole bearing [m]."""
        return jnp.asarray(self.coefficients)[0, 0]

    def at(self, place: float) -> FourierDepth:
        """The depth around the axis at a place along it, -1 at the first end and 1 at the second."""
        polynomials = np.polynomial.legendre.legvander(np.asarray([place]), self.rows - 1)[0]
        a = self.coefficients
        summed = (np.dot if isinstance(a, np.ndarray) else jnp.dot)(polynomials, a)
        return FourierDepth(summed)

    @classmethod
    def through(cls, places: Float[np.ndarray, " n"], depths: list[FourierDepth]) -> "LegendreFourierDepth":
        """The depth of n rows that is one of `depths` at each of n places along the axis.

        Args:
            places: between -1 and 1, all different, shape (n,).
            depths: around the axis there; where their orders differ, the higher waves of the others are zero.
        """
        widest = max(np.size(depth.coefficients) for depth in depths)
        rows = [jnp.pad(jnp.asarray(d.coefficients), (0, widest - np.size(d.coefficients))) for d in depths]
        polynomials = np.polynomial.legendre.legvander(np.asarray(places), len(depths) - 1)
        return cls(jnp.linalg.solve(jnp.asarray(polynomials), jnp.stack(rows)))

    def requirements(self) -> list[Requirement]:
        """A table of finite numbers, each row of which is a Fourier series."""
        shape = np.shape(self.coefficients)
        is_table = len(shape) == 2 and shape[0] > 0
        table = Requirement(
            "coefficients",
            f"of shape {shape}",
            is_table,
            "be a table with a row for each polynomial along the axis",
            "Give e.g. coefficients=[[1e-5, 0.0, 0.0], [4e-6, 0.0, 0.0]]: the mean, and how it grows along the axis.",
        )
        if not is_table:
            return [table]
        return [table, *FourierDepth(jnp.ravel(jnp.asarray(self.coefficients)[0])).requirements()[:2], *self._finite()]

    def _finite(self) -> list[Requirement]:
        return [
            Requirement(
                "coefficients",
                self.coefficients,
                abs(numeric(self.coefficients)) < np.inf,
                "be finite",
                "Give depths in meters, e.g. coefficients=[[1e-5, 0.0, 0.0], [4e-6, 0.0, 0.0]].",
            )
        ]


def waves(u: Float[np.ndarray, "*q d"], order: int) -> Float[np.ndarray, "*q k"]:
    """1, cos phi, sin phi, cos 2 phi, ... at unit vectors across the axis, in the order of the coefficients."""
    power, columns = u[..., 0] + 1j * u[..., 1], [np.ones(u.shape[:-1])]
    for m in range(1, order + 1):
        turned = power**m
        columns += [turned.real, turned.imag]
    return np.stack(columns, axis=-1)


def _norms(L: int) -> dict[tuple[int, int], float]:
    """Factors of d^m P_n/dz^m: sqrt(2 (n - m)!/(n + m)!), and 1 for m = 0."""
    norms = {}
    for n in range(L + 1):
        norms[n, 0], ratio = 1.0, 1.0
        for m in range(1, n + 1):
            ratio /= (n + m) * (n - m + 1)
            norms[n, m] = float(np.sqrt(2 * ratio))
    return norms


_NORM = _norms(LARGEST_DEGREE)


def _legendre(z, L: int) -> dict:
    """Q_n = d^m P_n/dz^m for m <= n <= L, by (n - m) Q_n = (2 n - 1) z Q_(n-1) - (n + m - 1) Q_(n-2).

    Numbers stay numbers: the compiler does not see what is known.
    """
    table = {}
    for m in range(L + 2):
        if m <= L:
            table[m, m] = float(np.prod(np.arange(1.0, 2 * m, 2))) if m else 1.0
        for n in range(m + 1, L + 1):
            before = table[n - 2, m] if n - 2 >= m else 0.0
            table[n, m] = ((2 * n - 1) * z * table[n - 1, m] - (n + m - 1) * before) / (n - m)
    return table


def _weighted(weights: list, legendre: dict, m: int, L: int):
    """sum_n w_n d^m P_n/dz^m, and its derivative by z."""
    value = sum((w * legendre[n, m] for n, w in zip(range(m, L + 1), weights, strict=True)), jnp.zeros(()))
    slopes = zip(range(m + 1, L + 1), weights[1:], strict=True)
    return value, sum((w * legendre[n, m + 1] for n, w in slopes), jnp.zeros(()))


def harmonics(u: Float[np.ndarray, "*q 3"], degree: int) -> Float[np.ndarray, "*q k"]:
    """Y_nm at unit vectors, in the order of the coefficients."""
    x, y, z = u[..., 0], u[..., 1], u[..., 2]
    legendre = _legendre(z, degree)
    columns = [np.zeros_like(z)] * (degree + 1) ** 2
    power, turned = np.ones_like(z, dtype=complex), x + 1j * y
    for m in range(degree + 1):
        for n in range(m, degree + 1):
            column = _NORM[n, m] * legendre[n, m] * power
            columns[n * n + n + m] = column.real
            if m:
                columns[n * n + n - m] = column.imag
        power = power * turned
    return np.stack(columns, axis=-1)


def grid_of(degree: int) -> tuple[Float[np.ndarray, "q 3"], Float[np.ndarray, " q"]]:
    """Directions and weights (their sum is 1) that integrate harmonics up to twice a degree exactly over the sphere."""
    z, across = np.polynomial.legendre.leggauss(degree + 1)
    turn = 2 * np.pi * np.arange(2 * degree + 2) / (2 * degree + 2)
    r = np.sqrt(1 - z * z)[:, None]
    u = np.stack([r * np.cos(turn), r * np.sin(turn), np.broadcast_to(z[:, None], (len(z), len(turn)))], axis=-1)
    return u.reshape(-1, 3), np.repeat(across / 2, len(turn)) / len(turn)

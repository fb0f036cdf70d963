"""An elastomer given by points of its force-deflection curve."""

from typing import Annotated, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import non_negative, numeric
from spherejax.foundations.numerics import radial_projection
from spherejax.foundations.types import Number, Scalar, Unit, Vector3
from spherejax.physics.laws.elastomer import AbstractPivotElastomer


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

    never_adds_energy: ClassVar[bool] = True

    deflections: Annotated[Float[np.ndarray, " n"], Unit("m")]
    forces: Annotated[Float[np.ndarray, " n"], Unit("N")]
    damping: Annotated[Number, Unit("s")]
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

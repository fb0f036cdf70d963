"""Viscosity by pressure after Roelands: oil that thickens less at high pressure than `BarusThickening` says.

With s = ln(eta/eta_0) the law and the reduced pressure of `thickening` are

    s = A ((1 + p/p_0)**z - 1),                      A = ln(eta_0/eta_r)
    alpha q = G(s) = integral from 0 to s of exp(-t) (1 + t/A)**m dt,      m = 1/z - 1,    alpha = A z/p_0

alpha is the slope of s at p = 0. G has no inverse in closed form. With z = 1 it is that of Barus' law, s = -ln(1 -
alpha q), and elsewhere it differs little: s/v is a smooth function of v = -ln(1 - alpha q/G(infinity)). Here it is the
polynomial through seven values of s, made once for each A and z; what is evaluated at points of a film is a logarithm,
that polynomial and two powers.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import numeric, positive
from spherejax.foundations.types import Number, Scalar, Unit
from spherejax.physics.laws.thickening import (
    LARGEST_AT_POINTS,
    LARGEST_REDUCED,
    AbstractThickening,
    Excess,
    PressedOil,
)

THINNEST = float(np.exp(-9.67))
"""eta_r [Pa s], 6.315e-5."""

LEAST_LOGARITHM = 1.5
"""Of A: an oil of 0.28 mPa s. Warm oil that is thinner is taken for that one."""

LEAST_INDEX, LARGEST_INDEX = 0.3, 1.3
"""z between which the inverse is as exact as is said."""

_LOWEST, _HIGHEST = -0.7, float(-np.log1p(-LARGEST_REDUCED))
"""ln(eta/eta_0) between which the law holds: half and ten times the viscosity. Beyond, all goes on straight."""

_NODES = np.array([_LOWEST, -0.3, 0.35, 0.8, 1.3, 1.8, _HIGHEST])
"""ln(eta/eta_0) where the polynomial is exact; at 0 it is by its form."""

_LEGENDRE, _LEGENDRE_WEIGHTS = (np.asarray(row) for row in np.polynomial.legendre.leggauss(8))
_LAGUERRE, _LAGUERRE_WEIGHTS = (np.asarray(row) for row in np.polynomial.laguerre.laggauss(12))


class RoelandsThickening(AbstractThickening):
    """The viscosity grows with the pressure by Roelands' law: eta(p) = eta_0 exp(A ((1 + p/p_0)**z - 1)).

    A = ln(eta_0/(6.315e-5 Pa s)) = ln(eta_0/(1 Pa s)) + 9.67 is that of the joint's viscosity eta_0, at its
    temperature where the oil warms. Near p = 0 it is Barus' law with alpha = A z/p_0.

    Attributes:
        index: Roelands' z [-], 0.3 to 1.3; 0.4 to 0.7 for most oils. 1 is Barus' law.
        pressure: p_0 [Pa].

    The film's pressure is that of the reduced pressure q, the integral of eta_0/eta(p) dp, which obeys Reynolds'
    equation of the viscosity eta_0. q has a bound, G(infinity)/alpha, some 1.1/alpha: beyond it there is no finite
    pressure. A run in which the viscosity exceeds 3.4 to 4 times eta_0 at a point warns (`OutOfRangeWarning`).

    Limits: viscosities up to ten times eta_0, beyond which pressure and viscosity go on straight. Load and couple as of
        `BarusThickening`; p and eta within 1e-6 of the law's for viscosities from 0.05 Pa s and indices from 0.4 on,
        1e-5 of an oil of 3 mPa s.

    Source: Roelands (1966), Correlational aspects of the viscosity-temperature-pressure relationship of lubricating
    oils, thesis, Delft. The reduced pressure of this law: derived here.
    """

    index: Annotated[Number, Unit("1")]
    pressure: Annotated[Number, Unit("Pa")] = 1.962e8

    def of_viscosity(self, viscosity: Number) -> PressedOil:
        """Of oil with the viscosity eta_0 [Pa s]."""
        logarithm = jnp.maximum(jnp.log(viscosity / THINNEST), LEAST_LOGARITHM)
        return _RoelandsOil.of(logarithm, self.index, self.pressure)

    def requirements(self) -> list[Requirement]:
        """A usual z, p_0 > 0."""
        index, remedy = numeric(self.index), "Indices of oils are 0.4 to 0.7; 1 is that of BarusThickening."
        usual = (index >= LEAST_INDEX) & (index <= LARGEST_INDEX)
        return [
            Requirement("index", self.index, usual, f"lie in [{LEAST_INDEX}, {LARGEST_INDEX}]", remedy),
            positive("pressure", self.pressure, "Pa"),
        ]


class _RoelandsOil(NamedTuple):
    """Roelands' law of one oil.

    Attributes:
        logarithm: A.
        index: z.
        coefficient: alpha [1/Pa].
        bound: G(infinity).
        lowest, highest: G at the ends of the range.
        polynomial: of s/v, in Newton's form over `places`.
        places: v of the nodes.
    """

    logarithm: Scalar
    index: Number
    coefficient: Scalar
    bound: Scalar
    lowest: Scalar
    highest: Scalar
    polynomial: Float[Array, " n"]
    places: Float[Array, " n"]

    @classmethod
    def of(cls, logarithm: Scalar, index: Number, pressure: Number) -> "_RoelandsOil":
        power = 1.0 / index - 1.0

        def weight(s: Array) -> Array:
            return (1.0 + s / logarithm) ** power

        nodes = jnp.asarray(_NODES)
        inside = 0.5 * nodes[:, None] * (1.0 + _LEGENDRE)
        values = 0.5 * nodes * ((jnp.exp(-inside) * weight(inside)) @ _LEGENDRE_WEIGHTS)
        bound = weight(jnp.asarray(_LAGUERRE)) @ _LAGUERRE_WEIGHTS
        places = -jnp.log1p(-values / bound)
        return cls(
            logarithm,
            index,
            logarithm * index / pressure,
            bound,
            values[0],
            values[-1],
            _divided_differences(places, nodes / places),
            places,
        )

    def excess(self, reduced: Array) -> Excess:
        """p - q and eta/eta_0 - 1 of a reduced pressure q [Pa]; straight lines beyond the range."""
        share = self.coefficient * reduced
        inside = jnp.clip(share, self.lowest, self.highest)
        beyond = share - inside
        v = -jnp.log1p(-inside / self.bound)
        ratio = self.polynomial[-1]
        for i in reversed(range(len(_NODES) - 1)):
            ratio = self.polynomial[i] + (v - self.places[i]) * ratio
        s = v * ratio
        viscosity = jnp.exp(s)
        far = 1.0 + s / self.logarithm
        # p - q in units of 1/alpha: A z ((1 + s/A)**(1/z) - 1) - alpha q.
        pressure = self.logarithm * self.index * (far ** (1.0 / self.index) - 1.0) - inside
        slope = viscosity * viscosity / far ** (1.0 / self.index - 1.0)
        return Excess((pressure + (viscosity - 1.0) * beyond) / self.coefficient, viscosity - 1.0 + slope * beyond)

    def range_share(self, reduced: Array) -> Scalar:
        """The largest alpha q as a share of what a run says nothing of."""
        largest = LARGEST_AT_POINTS * self.highest / LARGEST_REDUCED
        return jnp.max(self.coefficient * reduced) / largest


def _divided_differences(places: Array, values: Array) -> Array:
    """Coefficients of the polynomial through points, in Newton's form."""
    coefficients, column = [values[0]], values
    for order in range(1, len(_NODES)):
        column = (column[1:] - column[:-1]) / (places[order:] - places[:-order])
        coefficients.append(column[0])
    return jnp.stack(coefficients)

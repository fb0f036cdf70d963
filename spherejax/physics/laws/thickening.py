"""Viscosity by pressure: what an oil that thickens under the film's own pressure adds to load and couple.

With eta(p) = eta_0 exp(alpha p) the reduced pressure q = (1 - exp(-alpha p))/alpha turns Reynolds' equation, whatever
the gap, into that of a constant viscosity:

    div(h**3/eta grad p) = div(h**3/eta_0 grad q),    p = -ln(1 - alpha q)/alpha,    eta = eta_0/(1 - alpha q)

So the closed forms of `full_film` and `bearings` are of q, and exact; its edge is that of p. What p bears beyond q, and
what the thicker oil brakes beyond the thin one, is integrated over points of the film. So it is with any law of the
pressure alone, with q the integral of eta_0/eta(p) dp; see `roelands`.
"""

from abc import abstractmethod
from typing import Annotated, ClassVar, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import positive
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Number, Scalar, Unit, Vector3
from spherejax.physics.laws.base import AbstractLaw
from spherejax.physics.laws.full_film import directions_across

LARGEST_REDUCED = 0.9
"""alpha q up to which the logarithm is taken: there the viscosity is ten times that without pressure. Beyond, pressure
and viscosity go on straight, so that trial steps stay finite."""

LARGEST_AT_POINTS = 0.7
"""alpha q at the points of a film up to which a run says nothing. The highest pressure, between the points, is up to an
eighth higher for a ball at an eccentricity ratio of 0.9, and 4 % in a bearing."""

_HALF, _HALF_WEIGHTS = (np.asarray(row) for row in np.polynomial.legendre.leggauss(6))
_AXIAL, _AXIAL_WEIGHTS = (_HALF + 1) / 2, _HALF_WEIGHTS / 2
"""Of half of a bearing's length."""

_NODES, _WEIGHTS = (np.asarray(row) for row in np.polynomial.legendre.leggauss(16))
"""Round half of a bearing."""

_TURN_NODES, _TURN_WEIGHTS = (np.asarray(row) for row in np.polynomial.legendre.leggauss(10))
_RISE_NODES, _RISE_WEIGHTS = (np.asarray(row) for row in np.polynomial.legendre.leggauss(10))
"""Over half of a ball's film: in the plane of its middle and the smallest gap, and across that plane. Six across left
derivatives wrong by 3 % at an eccentricity ratio of 0.6."""

CROWDED = 0.4
"""Width over which points crowd, as a share of the distance at which the gap vanishes off the real angles: 1 - alpha q
vanishes nearer. With 1 a ball's load at an eccentricity ratio of 0.6 is wrong by 30 times as much, with 0.3 by four
times."""


class Excess(NamedTuple):
    """What pressure adds.

    Attributes:
        pressure: p - q [Pa].
        viscosity: eta/eta_0 - 1 [-].
    """

    pressure: Array
    viscosity: Array


class PressedOil(Protocol):
    """An oil of some viscosity without pressure, as films ask for it."""

    def excess(self, reduced: Array) -> Excess:
        """p - q and eta/eta_0 - 1 of a reduced pressure q [Pa]."""
        ...

    def range_share(self, reduced: Array) -> Scalar:
        """The largest q as a share of that up to which a run says nothing."""
        ...


class AbstractThickening(AbstractLaw):
    """How the viscosity of an oil grows with its pressure."""

    beyond_range: ClassVar[str] = (
        "oil that thickens under pressure came near the bound beyond which its law has no finite pressure (of "
        "BarusThickening alpha q > 0.7; take a smaller coefficient or index, or a load that such oil can bear)"
    )
    """What a run says of it, and what to do."""

    @abstractmethod
    def of_viscosity(self, viscosity: Number) -> PressedOil:
        """The law for an oil with the viscosity eta_0 [Pa s] without pressure."""


class BarusThickening(AbstractThickening):
    """The viscosity grows exponentially with the pressure: eta(p) = eta_0 exp(alpha p).

    The film's pressure is exact, by the reduced pressure q = (1 - exp(-alpha p))/alpha, which obeys Reynolds' equation
    of the viscosity eta_0. There is none where alpha q >= 1: oil that thickens so under a given motion has no finite
    pressure. A run in which alpha q exceeds `LARGEST_AT_POINTS` warns (`OutOfRangeWarning`).

    Attributes:
        coefficient: alpha [1/Pa]; 1e-8 to 3e-8 for mineral oils.

    Limits: load and couple within 1e-3 up to alpha q = 0.6 at an eccentricity ratio of 0.8, 5e-3 at 0.9; in a short
        bearing with suction within 1 and 5 %. Mineral oils follow it to some 100 MPa; beyond they thicken less
        (`RoelandsThickening`).

    Source: Barus (1893), Am. J. Sci. 45:87-96; the reduced pressure is Grubin's.
    """

    coefficient: Annotated[Number, Unit("1/Pa")]

    def of_viscosity(self, viscosity: Number) -> "BarusThickening":
        """The same: alpha is that of any viscosity."""
        del viscosity
        return self

    def reduced_share(self, reduced: Array) -> Array:
        """alpha q [-]."""
        return self.coefficient * reduced

    def excess(self, reduced: Array) -> Excess:
        """p - q and eta/eta_0 - 1 of a reduced pressure q [Pa]; straight lines beyond `LARGEST_REDUCED`."""
        share = self.reduced_share(reduced)
        inside = jnp.minimum(share, LARGEST_REDUCED)
        beyond = (share - inside) / (1.0 - LARGEST_REDUCED)
        pressure = (beyond - jnp.log1p(-inside) - share) / self.coefficient
        viscosity = inside / (1.0 - inside) + beyond / (1.0 - LARGEST_REDUCED)
        return Excess(pressure, viscosity)

    def range_share(self, reduced: Array) -> Scalar:
        """The largest alpha q as a share of `LARGEST_AT_POINTS`."""
        return jnp.max(self.reduced_share(reduced)) / LARGEST_AT_POINTS

    def requirements(self) -> list[Requirement]:
        """alpha > 0."""
        return [positive("coefficient", self.coefficient, "1/Pa")]


class Thickened(NamedTuple):
    """What thickening adds to a film.

    Attributes:
        force: on the ball [N].
        couple: on the ball, of shear [N m].
    """

    force: Vector3
    couple: Vector3


class Round(NamedTuple):
    """Points round half or all of a bearing.

    Attributes:
        places: unit vectors from the axis.
        weights: angles [rad].
    """

    places: Float[Array, "n 3"]
    weights: Float[Array, " n"]


def points_round(r: Vector3, middle: Vector3, axis: Vector3, bears_suction: bool | None) -> Round:
    """Points over the half of the circle about a vector, where the pressure is, and over the other half with suction.

    They crowd where the gap is smallest, a = a_n + b sinh(t) with cosh(b/CROWDED) = 1/eps. They are not differentiated:
    where they lie matters to the error of the rule alone, and at the edge there is nothing.
    """
    halves = [_half_round(r, middle, axis)]
    if bears_suction:
        halves.append(_half_round(r, -middle, axis))
    return Round(*(jnp.concatenate(parts) for parts in zip(*halves, strict=True)))


def _half_round(r: Vector3, middle: Vector3, axis: Vector3) -> Round:
    r, middle, axis = jax.lax.stop_gradient((r, middle, axis))
    size = safe_norm(middle)
    w = middle / jnp.where(size > 0, size, 1.0)
    m = jnp.cross(axis, w)
    angles, weights = _crowded(*_crowding(r @ w, r @ m), _NODES, _WEIGHTS)
    return Round(jnp.cos(angles)[:, None] * w + jnp.sin(angles)[:, None] * m, weights)


def _crowding(x: Scalar, y: Scalar) -> tuple[Scalar, Scalar]:
    """The angle of the smallest gap, and how wide points crowd there."""
    eps = jnp.sqrt(jnp.maximum(x * x + y * y, 1e-8))
    place = jnp.arctan2(y, jnp.where(eps > 2e-4, x, 1.0))
    return place, CROWDED * jnp.log((1.0 + jnp.sqrt(jnp.maximum(1.0 - eps * eps, 0.0))) / eps)


def _crowded(place: Scalar, width: Scalar, nodes: np.ndarray, weights: np.ndarray) -> tuple[Array, Array]:
    """Angles from -pi/2 to pi/2 that crowd about one of them, and their weights."""
    low, high = jnp.arcsinh((-0.5 * jnp.pi - place) / width), jnp.arcsinh((0.5 * jnp.pi - place) / width)
    t = 0.5 * (high + low) + 0.5 * (high - low) * nodes
    return place + width * jnp.sinh(t), 0.5 * (high - low) * weights * width * jnp.cosh(t)


class BearingPressure(NamedTuple):
    """Reduced pressure of a bearing at points round it.

    Attributes:
        around: the points.
        middle: q in the middle of the length [Pa].
        gap: h/c.
        is_parabolic: whether q falls to the ends as a parabola (static); else it is the same along the axis.
    """

    around: Round
    middle: Float[Array, " n"]
    gap: Float[Array, " n"]
    is_parabolic: bool


def thickened_bearing(oil: PressedOil, reduced: BearingPressure, area: Number, braking: Vector3) -> Thickened:
    """What thickening adds in a bearing.

    Args:
        oil: how it thickens.
        reduced: reduced pressure.
        area: L R [m^2].
        braking: eta_0 L R^3/c times the angular velocity of the journal against the bearing [N m].
    """
    shape, weights = (1.0 - _AXIAL**2, _AXIAL_WEIGHTS) if reduced.is_parabolic else (np.ones(1), np.ones(1))
    excess = oil.excess(reduced.middle[:, None] * shape)
    pressure, viscosity = excess.pressure @ weights, excess.viscosity @ weights
    force = -area * ((reduced.around.weights * pressure) @ reduced.around.places)
    return Thickened(force, -jnp.sum(reduced.around.weights * viscosity / reduced.gap) * braking)


class BallPressure(NamedTuple):
    """Reduced pressure of a ball's film at points of half or all of the sphere.

    Attributes:
        places: unit vectors u.
        weights: solid angles.
        pressure: q [Pa].
        gap: h/c.
    """

    places: Float[Array, "n 3"]
    weights: Float[Array, " n"]
    pressure: Float[Array, " n"]
    gap: Float[Array, " n"]


def ball_pressure(r: Vector3, slope: Vector3, scale: Number, bears_suction: bool | None) -> BallPressure:
    """q = scale (2 - r.u)/(1 - r.u)**2 u.W at points of the film of `full_film`.

    Args:
        r: e/(c + e_h1).
        slope: W [m/s].
        scale: 12 eta_0 R^2/c^3 [Pa s/m].
        bears_suction: whether the half where u.W < 0 counts as well (static).
    """
    halves = [_half_ball(r, slope)]
    if bears_suction:
        halves.append(_half_ball(r, -slope))
    places, weights = (jnp.concatenate(parts) for parts in zip(*halves, strict=True))
    gap = 1.0 - places @ r
    return BallPressure(places, weights, scale * (1.0 + gap) / gap**2 * (places @ slope), gap)


def _half_ball(r: Vector3, slope: Vector3) -> tuple[Array, Array]:
    """Points of the half of the sphere about W, u = cos(b) (cos(a) w + sin(a) m) + sin(b) w x m with r in the plane of
    w and m: those of `_half_round` in a, and as crowded about that plane in b."""
    r, slope = jax.lax.stop_gradient((r, slope))
    size = safe_norm(slope)
    w = slope / jnp.where(size > 0, size, 1.0)
    across = r - (r @ w) * w
    lean = safe_norm(across)
    # With r along w any direction across w will do.
    m = jnp.where(lean > 1e-9, across / jnp.where(lean > 0, lean, 1.0), directions_across(w)[0])
    place, width = _crowding(r @ w, r @ m)
    turns, turn_weights = _crowded(place, width, _TURN_NODES, _TURN_WEIGHTS)
    rises, rise_weights = _crowded(jnp.zeros(()), width, _RISE_NODES, _RISE_WEIGHTS)
    flat = jnp.cos(turns)[:, None] * w + jnp.sin(turns)[:, None] * m
    places = jnp.cos(rises)[:, None, None] * flat + jnp.sin(rises)[:, None, None] * jnp.cross(w, m)
    weights = (rise_weights * jnp.cos(rises))[:, None] * turn_weights
    return places.reshape(-1, 3), weights.reshape(-1)


def thickened_ball(oil: PressedOil, reduced: BallPressure, area: Number, braking: Vector3) -> Thickened:
    """What thickening adds in a ball's film.

    Args:
        oil: how it thickens.
        reduced: reduced pressure.
        area: R^2 [m^2].
        braking: eta_0 R^4/c times the angular velocity of the ball against the socket [N m].
    """
    excess = oil.excess(reduced.pressure)
    sheared = reduced.weights * excess.viscosity / reduced.gap
    couple = (sheared * (reduced.places @ braking)) @ reduced.places - jnp.sum(sheared) * braking
    return Thickened(-area * ((reduced.weights * excess.pressure) @ reduced.places), couple)

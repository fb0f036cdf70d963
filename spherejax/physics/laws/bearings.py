"""The film of a journal in its bearing: short or long, squeezed and swept in one.

In the plane across the axis the gap is h = c (1 - eps n.u) at the place u (outward, unit), and Reynolds' equation knows
the motion by one vector, V = e_rate - w x e with the mean angular velocity w of both:

    short:  p = 6 nu (L**2/4 - z**2) V.u/h**3                                      (flow along the axis alone)
    long:   p = 12 nu R**2/c**3 (2 - eps n.u)/(1 - eps n.u)**2 u.W,   W = V_n n/2 + V_t/(2 + eps**2)

Pressure is positive on exactly half of the circle, about V or W. The loads below are its integrals, in r = e/c.

Source: Ocvirk (1952), NACA TN 2808, and Sommerfeld (1904), for any motion as in Booker (1965), J. Basic Eng.
87:537-546; the integrals are derived here and checked against quadrature (`tests/test_laws_bearings.py`).
"""

import math
from typing import Annotated, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement, is_concrete
from spherejax.foundations.legal import positive
from spherejax.foundations.numerics import horner, safe_norm
from spherejax.foundations.types import Number, Scalar, Unit, Vector3
from spherejax.physics.laws.films import AbstractFilm, FilmAction, FilmGap, FilmMotion, ratio_vector, swept
from spherejax.physics.laws.thickening import BearingPressure, points_round, thickened_bearing

_NODES, _WEIGHTS = (np.asarray(each) for each in np.polynomial.legendre.leggauss(40))

_SLIM = 0.5
"""q/|x| below which arctan is taken without its first terms, which cancel."""

_TAIL = tuple((-1.0) ** k / (2 * k + 5) for k in range(26))
"""Of (arctan t - t + t**3/3)/t**5 in t**2; 0.25**26 = 2e-16."""


def short_full_load(r: Vector3, velocity: Vector3) -> Vector3:
    """Load of a short film that carries pressure and suction, F = -nu R (L/c)**3 load [m/s].

        load = pi (1 - eps**2)**(-3/2) (V + 3 r (r.V)/(1 - eps**2))

    Limits: pi V at r = 0.
    """
    gap = 1.0 - r @ r
    return jnp.pi / (gap * jnp.sqrt(gap)) * (velocity + 3.0 * (r @ velocity) / gap * r)


def long_full_load(r: Vector3, velocity: Vector3) -> Vector3:
    """Load of a long film that carries pressure and suction, F = -nu L (R/c)**3 load [m/s].

        load = 12 pi/((2 + eps**2) q) (2 V + 3 r (r.V)/q**2),    q**2 = 1 - eps**2

    Limits: 12 pi V at r = 0.
    """
    gap = 1.0 - r @ r
    return 12.0 * jnp.pi / ((3.0 - gap) * jnp.sqrt(gap)) * (2.0 * velocity + 3.0 * (r @ velocity) / gap * r)


def short_half_load(r: Vector3, velocity: Vector3, axis: Vector3) -> Vector3:
    """Load of a short film that carries pressure only, F = -nu R (L/c)**3 load [m/s].

        load = |V| int cos(a) u/(1 - r.u)**3 da  over half of the circle about V
             = |V| (k_w w + k_m m),    w = V/|V|,  m = axis x w,  x = r.w,  y = r.m,  q**2 = 1 - x**2 - y**2
        k_w = 3 x/q**4 + A (q**2 + 3 x**2)/q**5,    A = arctan2(q, -x)
        k_m = y (2/q**4 + x**2/(q**4 (1 - y**2)) + 3 x A/q**5)

    Limits: pi/2 V at r = 0; 0 at V = 0, where it has a kink (it is homogeneous of degree 1).
    """
    w, m, size = _frame(velocity, axis)
    x, y = r @ w, r @ m
    square = 1.0 - x * x - y * y
    # The journal leaves the wall: k is of the order of one, and its terms are of that of q**-4.
    leaves = -x * _SLIM > jnp.sqrt(square)
    near, far = jnp.where(leaves, x, -1.0), jnp.where(leaves, 0.0, x)
    tail_square = jnp.where(leaves, square, 0.25 * _SLIM) / (near * near)
    tail = horner(_TAIL, tail_square)
    far_square = jnp.where(leaves, 1.0, square)
    far_q = jnp.sqrt(far_square)
    angle = jnp.arctan2(far_q, -far)
    fourth, fifth = far_square * far_square, far_square * far_square * far_q
    along_far = 3.0 * far / fourth + angle * (far_square + 3.0 * far * far) / fifth
    side_far = (2.0 + far * far / (far_square + far * far)) / fourth + 3.0 * far * angle / fifth
    along_near = (1.0 / 3.0) / near**3 - (tail_square + 3.0) * tail / near**3
    side_near = (1.0 / (1.0 + tail_square) - 3.0 * tail) / near**4
    along, side = jnp.where(leaves, along_near, along_far), jnp.where(leaves, side_near, side_far)
    return size * (along * w + y * side * m)


def long_half_load(r: Vector3, velocity: Vector3, axis: Vector3) -> Vector3:
    """Load of a long film that carries pressure only, F = -nu L (R/c)**3 load [m/s].

        load = 12 |W| int cos(a) u (1/(1 - r.u)**2 + 1/(1 - r.u)) da  over half of the circle about W

    by 40 Gauss points that crowd where the gap is smallest, a = a_n + b sinh(t) with cosh(b) = 1/eps: to 1e-9 up to
    eps = 0.999, to 1e-7 at 0.9999.

    Limits: 6 pi V at r = 0; 0 at V = 0, where it has a kink.
    """
    w, m, size = _frame(long_slope(r, velocity), axis)
    x, y = r @ w, r @ m
    # Where the points lie does not matter but to rounding: they are not differentiated.
    held_x, held_y = jax.lax.stop_gradient((x, y))
    eps = jnp.sqrt(jnp.maximum(held_x**2 + held_y**2, 1e-8))
    place = jnp.arctan2(held_y, jnp.where(eps > 2e-4, held_x, 1.0))
    width = jnp.log((1.0 + jnp.sqrt(jnp.maximum(1.0 - eps * eps, 0.0))) / eps)
    low, high = jnp.arcsinh((-0.5 * jnp.pi - place) / width), jnp.arcsinh((0.5 * jnp.pi - place) / width)
    along, side = jnp.zeros(()), jnp.zeros(())
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        t = 0.5 * (high + low) + 0.5 * (high - low) * node
        angle = place + width * jnp.sinh(t)
        measure = 0.5 * (high - low) * weight * width * jnp.cosh(t)
        cosine, sine = jnp.cos(angle), jnp.sin(angle)
        thickness = 1.0 - x * cosine - y * sine
        pressure = measure * cosine * (1.0 / thickness + 1.0) / thickness
        along, side = along + pressure * cosine, side + pressure * sine
    return 12.0 * size * (along * w + side * m)


def long_slope(r: Vector3, velocity: Vector3) -> Vector3:
    """W = V_n n/2 + V_t/(2 + eps**2), without n."""
    two = 2.0 + r @ r
    return velocity / two + r * (r @ velocity) / (2.0 * two)


def _frame(vector: Vector3, axis: Vector3) -> tuple[Vector3, Vector3, Scalar]:
    """Direction of a vector, the direction across it about the axis, and its size; zeros for none."""
    size = safe_norm(vector)
    w = vector / jnp.where(size > 0, size, 1.0)
    return w, jnp.cross(axis, w), size


LENGTHS = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Lengths of bearings in radii, for the factors below."""

SHORT_FACTORS = ((1.03, 1.12, 1.42, 2.4, 5.5), (1.18, 1.65, 3.22, 8.6, 27.0))
LONG_FACTORS = ((41.0, 11.0, 3.5, 1.47, 0.85), (10.0, 3.6, 1.75, 1.16, 0.93))
"""Loads of Ocvirk's and Sommerfeld's steady bearings over those of Reynolds' equation on a fine grid, at eccentricity
ratios of 0.3 and 0.8 (`tests/test_lined_bearing.py` has the grid)."""

LONGEST_SHORT, SHORTEST_LONG = 1.0, 4.0
"""Lengths of bearings, in radii, beyond and below which it is said how much too much Ocvirk's or Sommerfeld's bear: at
these they err by 1.1 to 1.65 and by 1.2 to 1.5 times."""

SLACK = 1.0 + 1e-9
"""Lengths that are meant to be at a bound are not beyond it by rounding."""


def _too_much(radii: float, factors: tuple[tuple[float, ...], tuple[float, ...]]) -> str:
    """By how much a bearing of a length bears too much, in words; between the lengths of the table by logarithms."""
    ends = "at least " if not LENGTHS[0] <= radii <= LENGTHS[-1] else ""
    inner, outer = (float(np.exp(np.interp(np.log(radii), np.log(LENGTHS), np.log(row)))) for row in factors)
    return (
        f"in one of {radii:.3g} radii, as here, it bears {ends}{inner:.2g} times what Reynolds' equation says at an "
        f"eccentricity ratio of 0.3, and {ends}{outer:.2g} times at 0.8"
    )


class AbstractBearingFilm(AbstractFilm):
    """The film of a journal in a bearing with clearance.

        F = -nu (...) load,  V = e_rate - w x e,  w = (w_bearing + w_journal)/2,  r = e/(c + e_h1)
        M_journal = -e x F/2 + M_c,    M_bearing = -e x F/2 - M_c
        M_c = -2 pi nu L R**3/(c sqrt(1 - eps**2)) (w_journal - w_bearing)          (Petroff, in a full gap)

    Both turn about one axis; what crosses it does nothing.

    Attributes:
        length: L, of the bearing [m].
    """

    is_of_bearing: ClassVar[bool] = True
    thickens: ClassVar[bool] = True
    length: eqx.AbstractVar[Number]

    def requirements(self) -> list[Requirement]:
        """A length."""
        return [positive("length", self.length, "m")]

    def action(self, motion: FilmMotion, gap: FilmGap) -> FilmAction:
        """Force, and moments that keep the angular momentum of the pair."""
        axis = motion.axis
        assert axis is not None  # a bearing has one
        velocity = swept(motion)
        velocity = velocity - (velocity @ axis) * axis
        spin = (motion.ball_spin - motion.socket_spin) @ axis
        r = ratio_vector(motion, gap)
        force = -gap.viscosity * self._load(r, velocity, axis, gap)
        petroff = 2.0 * jnp.pi * gap.viscosity * self.length * gap.socket_radius**3 / gap.clearance
        couple = -petroff / jnp.sqrt(1.0 - r @ r) * spin * axis
        if (oil := gap.pressed_oil) is not None:
            braking = petroff / (2.0 * jnp.pi) * spin * axis
            reduced = self.reduced(motion, gap)
            added = thickened_bearing(oil, reduced, self.length * gap.socket_radius, braking)
            force, couple = force + added.force, couple + added.couple
        arm = jnp.cross(motion.e, force) / 2
        return FilmAction(force, couple - arm, -couple - arm, -(force @ velocity), -(couple @ axis) * spin)

    def range_share(self, motion: FilmMotion, gap: FilmGap) -> Scalar | None:
        """The largest reduced pressure as a share of what a run says nothing of; None for oil that does not thicken."""
        oil = gap.pressed_oil
        return None if oil is None else oil.range_share(self.reduced(motion, gap).middle)

    def reduced(self, motion: FilmMotion, gap: FilmGap) -> BearingPressure:
        """The reduced pressure at points round the bearing; of oil that does not thicken the pressure itself."""
        axis = motion.axis
        assert axis is not None
        r, velocity = ratio_vector(motion, gap), swept(motion)
        return self._pressure(r, velocity - (velocity @ axis) * axis, axis, gap)

    def _load(self, r: Vector3, velocity: Vector3, axis: Vector3, gap: FilmGap) -> Vector3:
        """-F/nu [m^2/s]."""
        raise NotImplementedError

    def _pressure(self, r: Vector3, velocity: Vector3, axis: Vector3, gap: FilmGap) -> BearingPressure:
        """In the middle of the length."""
        raise NotImplementedError


class ShortBearing(AbstractBearingFilm):
    """The film of a short journal bearing (Ocvirk): oil flows along the axis. For L up to R.

    With `Guembel` pressure only, with `Sommerfeld` suction as well; see `short_half_load`, `short_full_load`.

    Attributes:
        length: L, of the bearing [m].

    Limits: rigid, constant viscosity, c << R, ambient pressure at both ends. Beside a fine grid of Reynolds' equation
        it bears, at eccentricity ratios of 0.3, 0.5, 0.8, for L = R/2 1.03, 1.06, 1.18 times as much, for L = R 1.12,
        1.20, 1.65 times, for L = 2 R 1.4, 1.7, 3.2 times; beyond R a run warns (`StartWarning`). `LinedBearing` with a
        hard liner serves any length up to 4 R.

    Source: Ocvirk (1952), NACA TN 2808; any motion as in Booker (1965), J. Basic Eng. 87:537-546.
    """

    length: Annotated[Number, Unit("m")]

    def doubt(self, socket_radius: float) -> str:
        """Of a bearing longer than its radius."""
        if not is_concrete(self.length) or not self.length > LONGEST_SHORT * socket_radius * SLACK:
            return ""
        return (
            f"film=ShortBearing is for bearings not longer than their radius; "
            f"{_too_much(float(self.length / socket_radius), SHORT_FACTORS)}. Give film=sj.laws.LinedBearing(length, "
            "liner) with a hard liner, or sj.laws.LongBearing(length) from four radii on"
        )

    def damping(self, clearance: Number, socket_radius: Number, viscosity: Number) -> Number:
        """pi/2 nu R (L/c)**3."""
        return 0.5 * math.pi * viscosity * socket_radius * (self.length / clearance) ** 3

    def _load(self, r, velocity, axis, gap):
        load = short_full_load(r, velocity) if gap.boundary.bears_suction else short_half_load(r, velocity, axis)
        return gap.socket_radius * (self.length / gap.clearance) ** 3 * load

    def _pressure(self, r, velocity, axis, gap):
        around = points_round(r, velocity, axis, gap.boundary.bears_suction)
        thickness = 1.0 - around.places @ r
        scale = 1.5 * gap.viscosity * self.length**2 / gap.clearance**3
        return BearingPressure(around, scale * (around.places @ velocity) / thickness**3, thickness, True)


class LongBearing(AbstractBearingFilm):
    """The film of a long journal bearing (Sommerfeld): oil flows round the journal. For L from 4 R on.

    With `Guembel` pressure only, with `Sommerfeld` suction as well; see `long_half_load`, `long_full_load`.

    Attributes:
        length: L, of the bearing [m].

    Limits: rigid, constant viscosity, c << R. Beside a fine grid of Reynolds' equation it bears, at eccentricity ratios
        of 0.3, 0.5, 0.8, for L = 2 R 3.5, 2.9, 1.75 times as much, for L = 4 R 1.5, 1.4, 1.2 times, for L = 8 R 0.85 to
        0.93 times (its film ends where the gap is narrowest); below 4 R a run warns (`StartWarning`). `LinedBearing`
        with a hard liner serves any length up to 4 R.

    Source: Sommerfeld (1904), Z. Math. Phys. 50:97-155; any motion as in Booker (1965), J. Basic Eng. 87:537-546.
    """

    length: Annotated[Number, Unit("m")]

    def doubt(self, socket_radius: float) -> str:
        """Of a bearing shorter than four radii."""
        if not is_concrete(self.length) or not self.length * SLACK < SHORTEST_LONG * socket_radius:
            return ""
        return (
            f"film=LongBearing is for bearings of four radii or more; "
            f"{_too_much(float(self.length / socket_radius), LONG_FACTORS)}. Give film=sj.laws.LinedBearing(length, "
            "liner) with a hard liner, or sj.laws.ShortBearing(length) up to one radius"
        )

    def damping(self, clearance: Number, socket_radius: Number, viscosity: Number) -> Number:
        """6 pi nu L (R/c)**3."""
        return 6.0 * math.pi * viscosity * self.length * (socket_radius / clearance) ** 3

    def _load(self, r, velocity, axis, gap):
        load = long_full_load(r, velocity) if gap.boundary.bears_suction else long_half_load(r, velocity, axis)
        return self.length * (gap.socket_radius / gap.clearance) ** 3 * load

    def _pressure(self, r, velocity, axis, gap):
        slope = long_slope(r, velocity)
        around = points_round(r, slope, axis, gap.boundary.bears_suction)
        thickness = 1.0 - around.places @ r
        scale = 12.0 * gap.viscosity * gap.socket_radius**2 / gap.clearance**3
        pressure = scale * (1.0 + thickness) / thickness**2 * (around.places @ slope)
        return BearingPressure(around, pressure, thickness, False)

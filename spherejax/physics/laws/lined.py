"""The film of a journal in a bearing with an elastic liner: Reynolds' equation and the liner's deflection together.

A thin layer that is bonded to a stiff shell gives way at each point by its own pressure alone, as a foundation of
columns: p = k_w w with k_w = E (1 - nu)/((1 + nu)(1 - 2 nu) t). The gap is h = h_0 + w, h_0 = c (1 - r.u) that of rigid
circles, and in axes of the bearing Reynolds' equation is

    dw/dt + W dw/da = V.u + (1/12 eta) [ d/da (h**3 dp/da)/R**2 + d/dz (h**3 dp/dz) ]

with V = e_rate - w x e of `bearings`, W half the speed of the journal against the bearing, and eta the viscosity: the
deflection is what is integrated, and no equation is left to be solved. Along the axis pressure and deflection are
parabolas, or polynomials through several deflections, by Galerkin's method (`lined_axial`); round the bearing there
are n points.

The differences round the bearing are central, and so skew: sum w_i (w_(i+1) - w_(i-1)) = 0. What the journal gives
to the film is then stored in the liner or dissipated, to rounding.

Source: derived here. The column model: Higginson (1965), Proc. IMechE 180 (3B):31-38 (journal bearings with soft
liners); Bartel et al. (1985), J. Biomech. Eng. 107:193-199, for k_w.
"""

from typing import Annotated, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement, is_concrete
from spherejax.foundations.legal import numeric, positive
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Number, Scalar, Unit, Vector3
from spherejax.physics.laws.bearings import SLACK, ShortBearing
from spherejax.physics.laws.conformity import WinklerLiner
from spherejax.physics.laws.films import AbstractFilm, FilmAction, FilmGap, FilmMotion, swept
from spherejax.physics.laws.full_film import PressurePeak
from spherejax.physics.laws.lined_axial import AbstractProfile, between, profile_of
from spherejax.physics.laws.oil import OilTransport
from spherejax.physics.memory import MemoryEntry

FEWEST_POINTS, MOST_POINTS = 16, 96
"""Round the bearing, each a state; a load depends on where it is against the points, at an eccentricity ratio of 0.8 by
5 % with 16, 1 % with 32 and 0.2 % with 64 (`benchmarks/lined_bearing_turned.py`)."""

MOST_AXIAL = 4
"""Deflections along half of the axis. Loads of 4 differ from those of 3 by less than what 32 points err."""

LARGEST_LINED_RATIO, LARGEST_RESOLVED_RATIO = 0.8, 0.9
"""|e|/(c + e_h1) up to which a run says nothing, of a parabola along the axis and of two unknowns or more. There 32
points are within 5.5 and 2.7 % of a fine grid in bearings up to twice the radius long
(`benchmarks/lined_bearing_axial.py`); at 0.95 of hard ones two unknowns are off by 6 %, which is that of 32 points."""

LONGEST_LINED, LONGEST_RESOLVED = 4.0, 8.0
"""Length of a bearing, in radii, beyond which a run says that its pressure is none of these along the axis: at an
eccentricity ratio of 0.8 a rigid one bears 7 % too little there by a parabola, and 9.5 % at twice that length; by two
unknowns 1.5 % at eight radii."""

LARGEST_GAP_RATIO = 0.98
"""|e|/(c + e_h1) beyond which the gap of the rigid circles is held, so that the couple of shear stays finite."""

SLOW = 1.0
"""Of a journal [rad/s]: where it turns more slowly no film warms noticeably on its way round, and it does not matter on
which side of a point its viscosity is taken; the sides change smoothly there."""

SMALLEST_SHARE = 0.01
"""Of the clearance: an empty gap has oil of this thickness for its heat, so that its temperature stays finite."""


def _ahead(spin: Scalar) -> Scalar:
    """Which way a journal turns: 1 for forward, 0 for backward."""
    return 0.5 + 0.5 * spin / jnp.sqrt(spin**2 + SLOW**2)


def _arriving(values: Float[Array, " n"], spin: Scalar) -> Float[Array, " n"]:
    """What arrives at each point."""
    ahead = _ahead(spin)
    return ahead * jnp.roll(values, 1, -1) + (1.0 - ahead) * jnp.roll(values, -1, -1)


def _carried_upwind(values: Float[Array, " n"], speed: Scalar) -> Float[Array, " n"]:
    """What a speed carries of a quantity from each point to the next one, by its value where it comes from."""
    return jnp.maximum(speed, 0.0) * values + jnp.minimum(speed, 0.0) * jnp.roll(values, -1, -1)


def _leaving_upwind(values: Float[Array, " n"], speed: Scalar) -> Float[Array, " n"]:
    """What leaves a point so, beyond what arrives."""
    forward = _carried_upwind(values, speed)
    return forward - jnp.roll(forward, 1, -1)


class _FilmState(NamedTuple):
    """Of a film at its points.

    Attributes:
        places: unit vectors to them, world axes.
        rigid: gap of rigid circles [m].
        deflection: of the liner, the points along the last axis [m].
        empty: w where oil is missing, not positive [m].
        rates: of w [m/s].
        viscosity_between: between each point and the next one [Pa s].
    """

    places: Float[Array, "n 3"]
    rigid: Float[Array, " n"]
    deflection: Array
    empty: Array
    rates: Array
    viscosity_between: Float[Array, " n"]


class LinedBearing(AbstractFilm):
    """The film of a journal in a bearing with an elastic liner, of any length up to four radii.

        d/dt w_i = V.u_i (5/4) - W (w_(i+1) - w_(i-1))/(2 da) + (15/8) k_w/(12 eta) [round - along]
        round = [B_(i+1/2) (w_(i+1) - w_i) - B_(i-1/2) (w_i - w_(i-1))]/(R da)**2,    along = (4/L**2) A_i w_i
        F = -(2/3) L R da sum_i k_w w_i u_i

    w_i is the deflection of the liner in the middle of its length at the place u_i, A and B the cubic means of the gap
    along the axis with the weights of Galerkin's method. The liner is a foundation of columns, p = k_w w, with the k_w
    of `WinklerLiner`. What the film gives to the journal and takes from it differs by what the liner stores,
    (4/15) k_w L R da sum w_i**2, and by what is dissipated, which is never negative.

    That is `axial=1`, pressure as a parabola along the axis. With a soft liner and a great eccentricity the gap is
    narrow at the ends and wide in the middle, and pressure flat with steep ends. With `axial=n`, n from 2 on, it is an
    even polynomial of degree 2 n in s = 2 z/L, zero at the ends, through the deflections w_ki at n places s_k, the
    positive ones of Gauss and Lobatto's rule with the weights m_k, which makes the mass matrix diagonal:

        d/dt w_ki = V.u_i - W (w_k(i+1) - w_k(i-1))/(2 da) + k_w/(12 eta) [round_k - along_k]
        round_k as above with B_k(i+1/2) = ((h_ki + h_k(i+1))/2)**3
        along_ki = (4/L**2) (1/m_k) sum_q m_q D_qk h_qi**3 dw/ds|_q,    D_qk = d/dw_k of dw/ds at s_q
        F = -L R da sum_i u_i sum_k m_k k_w w_ki,    stored energy (1/2) k_w L R da sum_ki m_k w_ki**2

    q over the nodes and the end. The balance of energy holds to rounding as before.

    With `Sommerfeld` suction draws the liner in. With `Guembel` the pressure is nowhere negative, and its edge is where
    the flow has it (Reynolds' condition): points where w_i < 0 have neither pressure nor deflection, and w_i says how
    much is missing. Moments are those of `ShortBearing`, with Petroff's couple in the deformed gap.

    The film stays where the journal goes beyond the clearance, beside the dry contact there: then the gap of the rigid
    circles is that at `LARGEST_GAP_RATIO`.

    Without grooves the bearing's ends are flooded: oil comes in there wherever the gap widens. With `grooves` along the
    axis, at equal distances, it comes in at them alone, at no pressure, and oil is conserved (Elrod): where it does not
    fill the gap, -(4/5) w_i of the gap is empty, oil flows with half the speed of the journal, and only the part that
    is filled is sheared. So a film is starved behind a narrow place until the next groove. Then

        d/dt w_i = (5/4) V.u_i - W (w_i - w_(i-1))/da       where w_i < 0, for W > 0

    Attributes:
        length: L, of the bearing [m].
        liner: its material and thickness.
        points: round the bearing, each a state (static).
        grooves: along the axis, that feed oil, at equal distances; a divisor of the points, or 0 (static).
        groove_angle: of the first groove, from the x axis of the joint's frame about z, as `FourierDepth` counts angles
            [rad]: about the world's z from the world's y.
        groove_width: of each groove, up to the distance of two points; there is no shear in it [rad].
        axial: deflections along half of the axis at each point, each a state: 1 for a parabola, at most 4; 2 where
            the liner is soft or the eccentricity large (static).

    Limits: a liner that is thin against the width of the pressure, on a stiff shell; c << R, ambient
        pressure at both ends. Load within 2 % of a fine grid with a deflection at each point up to eps = 0.7 (3.5 % for
        L = 2 R), within 5.5 % at 0.8 and 10 % at 0.9: beyond 0.8 a run warns (`OutOfRangeWarning`). For L = 4 R it
        bears 0.99, 0.99, 0.93 times that of a rigid grid at 0.3, 0.5, 0.8; in longer bearings a run warns
        (`StartWarning`). With `axial=2` the load of bearings up to L = 8 R is within 1.5 % up to eps = 0.8 and 4 % at
        0.9 (2.7 % for L = 2 R), from where on a run warns; the largest pressure is within 8 and 12 % (`axial=3`: 4 and
        6 %).
        As the liner stiffens the film becomes that of a rigid bearing, and its states as fast as k_w c**3/(eta L**2)
        [1/s].

    Source: derived here; columns in journal bearings as in Higginson (1965), Proc. IMechE 180 (3B):31-38; oil that is
    conserved as in Elrod (1981), J. Lubr. Technol. 103:350-354.
    """

    is_of_bearing: ClassVar[bool] = True
    beyond_range: ClassVar[str] = (
        "on a LinedBearing the journal was further out than 0.8 of the clearance, where the pressure is no parabola "
        "along the axis and the film bears too little, by a tenth at 0.9, or, with axial=2 or more, further out than "
        "0.9 (axial=2 in place of the parabola, a thicker oil, a longer bearing or a stiffer liner keeps it within)"
    )

    length: Annotated[Number, Unit("m")]
    liner: WinklerLiner
    points: int = eqx.field(static=True, default=32)
    grooves: int = eqx.field(static=True, default=0)
    groove_angle: Annotated[Number, Unit("rad")] = 0.0
    groove_width: Annotated[Number, Unit("rad")] = 0.0
    axial: int = eqx.field(static=True, default=1)

    @property
    def _profile(self) -> AbstractProfile:
        return profile_of(self.axial)

    @property
    def n_points(self) -> int:
        """Each may have a viscosity of its own."""
        return self.points

    @property
    def n_grooves(self) -> int:
        """That feed the film."""
        return self.grooves

    @property
    def memory(self) -> tuple[MemoryEntry, ...]:
        """The deflection at each point: in the middle of the length, or place by place along the axis, from the middle
        on, all points of one place after each other."""
        return tuple(MemoryEntry(f"deflection_{i}", "m", "film") for i in range(self.points * self.axial))

    @property
    def stores_energy(self) -> bool:
        """The liner does."""
        return True

    def rigid(self) -> AbstractFilm:
        """`ShortBearing` of that length."""
        return ShortBearing(self.length)

    def range_share(self, motion: FilmMotion, gap: FilmGap) -> Scalar:
        """|e|/(c + e_h1) as a share of `LARGEST_LINED_RATIO`, or `LARGEST_RESOLVED_RATIO`."""
        largest = LARGEST_LINED_RATIO if self.axial == 1 else LARGEST_RESOLVED_RATIO
        return safe_norm(motion.e) / (gap.clearance + gap.transition_offset) / largest

    def doubt(self, socket_radius: float) -> str:
        """Of a bearing much longer than its diameter."""
        longest = LONGEST_LINED if self.axial == 1 else LONGEST_RESOLVED
        if not is_concrete(self.length) or not self.length > longest * socket_radius * SLACK:
            return ""
        here = f"here {float(self.length / socket_radius):.3g} radii. Give"
        rigid = "film=sj.laws.LongBearing(length), whose bearing is rigid, or take the load for a lower bound"
        if self.axial > 1:
            return (
                f"film=LinedBearing with axial={self.axial} has been compared with Reynolds' equation in bearings of "
                f"up to eight radii; {here} {rigid}"
            )
        return (
            "film=LinedBearing has a parabola of pressure along the axis, and bears too little in a bearing longer "
            "than four radii: at eight radii 0.97 times what Reynolds' equation says at an eccentricity ratio of 0.3, "
            f"and 0.91 times at 0.8; {here} axial=2, which serves up to eight radii, or {rigid}"
        )

    def places(self, motion: FilmMotion) -> Float[Array, "n 3"]:
        """Unit vectors to the points, which are fixed in the bearing, world axes."""
        angles = 2.0 * np.pi * np.arange(self.points) / self.points
        axes = motion.socket_axes
        assert axes is not None  # a bearing has them
        x, y = axes[:, 0], axes[:, 1]
        if self.grooves:
            cosine, sine = jnp.cos(self.groove_angle), jnp.sin(self.groove_angle)
            x, y = cosine * x + sine * y, cosine * y - sine * x
        return jnp.asarray(np.cos(angles))[:, None] * x + jnp.asarray(np.sin(angles))[:, None] * y

    def deflections(self, memory: Array, gap: FilmGap) -> Array:
        """Of the liner where it has a pressure [m]: without suction those that are positive, and none at grooves."""
        deflections = memory if gap.boundary.bears_suction else jnp.maximum(memory, 0.0)
        return jnp.where(self._is_groove, 0.0, deflections) if self.grooves else deflections

    def action(self, motion: FilmMotion, gap: FilmGap) -> FilmAction:
        """Force and moments of the pressure that the liner bears, and the rates of its deflections."""
        axis, missing = motion.axis, motion.memory
        assert axis is not None
        assert missing is not None
        radius, step = gap.socket_radius, 2.0 * np.pi / self.points
        foundation, area = self.liner.foundation(), self.length * radius * step
        velocity = swept(motion)
        velocity = velocity - (velocity @ axis) * axis
        spin = (motion.ball_spin - motion.socket_spin) @ axis
        places = self.places(motion)
        rigid = gap.clearance * (1.0 - places @ _ratio_vector(motion, gap))
        profile = self._profile
        missing = profile.arranged(missing)
        w, empty = self.deflections(missing, gap), self._empty(missing, gap, rigid, spin)
        ahead, behind = jnp.roll(w, -1, -1), jnp.roll(w, 1, -1)
        flow = profile.round_conductance(rigid, w) * (ahead - w) / (radius * step) ** 2
        leaving = profile.leaving(self.length, rigid, w, w if self.grooves else missing)
        is_resolved, viscosity = jnp.ndim(gap.viscosity) > 0, gap.viscosity
        viscosity_between = jnp.asarray(viscosity)
        if is_resolved:
            viscosity, viscosity_between = self._viscosities(viscosity_between, spin)
            flow, leaving = flow / viscosity_between, leaving / viscosity
        scale = foundation / 12.0 if is_resolved else foundation / (12.0 * viscosity)
        spread = scale * (flow - jnp.roll(flow, 1, -1) - leaving)
        filled = -_leaving_upwind(empty, 0.5 * spin) / step if self.grooves else 0.0
        carried = -0.25 * spin * (ahead - behind) / step
        rates = carried + filled + (profile.mean * (places @ velocity) + spread) / profile.square
        if self.grooves:
            rates = jnp.where(self._is_groove, 0.0, rates)
        force = -profile.mean * foundation * area * (profile.along(w) @ places)
        braking = profile.sheared(viscosity * area * radius**2 * self._sheared(rigid, empty, spin), rigid, w)
        couple = -jnp.sum(braking) * spin * axis
        stored = 0.5 * profile.square * foundation * area * profile.inner(w, w)
        arm = jnp.cross(motion.e, force) / 2
        action = FilmAction(
            force,
            couple - arm,
            -couple - arm,
            # Where the gap fills again, oil enters the film against its pressure: what that takes is lost.
            -foundation * area * profile.inner(w, spread + profile.square * filled),
            -(couple @ axis) * spin,
            rates.ravel(),
            stored,
        )
        if not is_resolved:
            return action
        pressed = scale * flow * (ahead - w)
        lost = 0.5 * (pressed + jnp.roll(pressed, 1, -1)) + (scale * leaving - profile.square * filled) * w
        power = foundation * area * profile.along(lost) + braking * spin**2
        film = _FilmState(places, rigid, w, empty, rates, viscosity_between)
        return action._replace(transport=self._transport(motion, gap, film, spin, power))

    def _viscosities(self, viscosity: Float[Array, " n"], spin: Scalar) -> tuple[Array, Array]:
        """At each point, and between it and the next one.

        Oil mixes upwind: the temperature that is kept for a point is that with which oil leaves it, half a step on. At
        the point it is the mean of what arrives and what leaves, which makes the difference of second order. Behind a
        groove fresh oil arrives.
        """
        ahead = _ahead(spin)
        at_points = jnp.where(self._is_groove, viscosity, 0.5 * (viscosity + _arriving(viscosity, spin)))
        return at_points, ahead * viscosity + (1.0 - ahead) * jnp.roll(viscosity, -1)

    @property
    def _is_groove(self) -> np.ndarray:
        """Of each point (static)."""
        at = np.arange(self.points)
        return at % (self.points // self.grooves) == 0 if self.grooves else at < 0

    def _empty(self, memory: Array, gap: FilmGap, rigid: Float[Array, " n"], spin: Scalar) -> Float[Array, " n"]:
        """-5/4 of the part of the gap without oil [m]; none without grooves, or with suction.

        A groove fills the gap that it meets: of a gap that widens from there, half a step on a part is empty.
        """
        if not self.grooves or gap.boundary.bears_suction:
            return jnp.zeros(memory.shape)
        after, ahead = self._gap_between(rigid, gap), _ahead(spin)
        behind_it = ahead * after + (1.0 - ahead) * jnp.roll(after, 1)
        return jnp.minimum(jnp.where(self._is_groove, (rigid - behind_it) / self._profile.empty, memory), 0.0)

    def _gap_between(self, thickness: Float[Array, " n"], gap: FilmGap) -> Float[Array, " n"]:
        """Between each point and the next one, such that its difference over a step is the slope at a point."""
        half = np.pi / self.points
        return gap.clearance + half / (np.sin(half) * np.cos(half)) * (between(thickness) - gap.clearance)

    def _sheared(self, rigid: Float[Array, " n"], empty: Float[Array, " n"], spin: Scalar) -> Array:
        """Share of the gap in which oil is sheared; at a groove the mean of both sides, beside its width.

        As of `_viscosities`, what arrives at a point and what leaves it count alike; bounded, so that there is no jump
        where a point fills.
        """
        if not self.grooves:
            return jnp.ones(())
        mean = jnp.maximum(0.5 * (empty + _arriving(empty, spin)), 2.0 * empty)
        filled = jnp.clip(1.0 + self._profile.empty * mean / rigid, 0.0, 1.0)
        beside = jnp.maximum(1.0 - self.groove_width * self.points / (2.0 * np.pi), 0.0)
        return jnp.where(self._is_groove, beside * 0.5 * (jnp.roll(filled, 1, -1) + jnp.roll(filled, -1, -1)), filled)

    def _transport(
        self, motion: FilmMotion, gap: FilmGap, film: _FilmState, spin: Scalar, power: Array
    ) -> OilTransport:
        """Flows of the oil: what leaves at the ends is what the flow from point to point and the volume leave over.

        Oil is counted as in Galerkin's equation, (4/5) w on the mean of the length for w of either sign: what leaves
        then has no jump where a film begins or ends.
        """
        radius, step = gap.socket_radius, 2.0 * np.pi / self.points
        profile, area = self._profile, self.length * radius * step
        deflection = profile.oil(film.deflection)
        on_both = deflection + jnp.roll(deflection, -1)
        widening = -(film.places @ (motion.e_rate - jnp.cross(motion.socket_spin, motion.e)))
        thickness = jnp.maximum(gap.clearance - film.places @ motion.e, SMALLEST_SHARE * gap.clearance)
        carried = 0.5 * spin * (self._gap_between(thickness, gap) + 0.5 * profile.empty * on_both)
        carried = carried + profile.empty * _carried_upwind(profile.oil(film.empty), 0.5 * spin)
        slope = self.liner.foundation() * (jnp.roll(film.deflection, -1, -1) - film.deflection) / (radius * step)
        conductance = profile.flow_conductance(film.rigid, film.deflection)
        driven = profile.along(conductance / (12.0 * film.viscosity_between) * slope)
        forward = self.length * (radius * carried - driven)
        outward = -area * (widening + profile.empty * profile.oil(film.rates)) - (forward - jnp.roll(forward, 1))
        assert motion.memory is not None
        missing = jnp.where(self._is_groove, 0.0, profile.arranged(motion.memory))
        filled = thickness + profile.empty * profile.oil(missing)
        volume = area * jnp.maximum(filled, SMALLEST_SHARE * gap.clearance)
        return OilTransport(forward, outward, volume, power, self._is_groove)

    def pressure_peak(self, motion: FilmMotion, gap: FilmGap) -> PressurePeak:
        """The largest pressure of all points, in the middle of the length."""
        assert motion.memory is not None
        memory = self._profile.arranged(motion.memory)
        middle = self._profile.middle(memory, self.deflections(memory, gap))
        highest = jnp.argmax(middle)
        largest = jnp.maximum(middle[highest], 0.0)
        return PressurePeak(
            self.liner.foundation() * largest, jnp.where(largest > 0, 1.0, 0.0) * self.places(motion)[highest]
        )

    def requirements(self) -> list[Requirement]:
        """A length, a liner, and a number of points."""
        is_count = isinstance(self.points, int) and FEWEST_POINTS <= self.points <= MOST_POINTS
        what = f"be a whole number from {FEWEST_POINTS} to {MOST_POINTS}"
        return [
            positive("length", self.length, "m"),
            *(r._replace(field=f"liner.{r.field}") for r in self.liner.requirements()),
            Requirement("points", self.points, is_count, what, "Leave it out for 32."),
            self._requirement_of_axial(),
            *self._requirements_of_grooves(is_count),
        ]

    def _requirement_of_axial(self) -> Requirement:
        fits = isinstance(self.axial, int) and 1 <= self.axial <= MOST_AXIAL
        remedy = "Leave it out for a parabola, or give 2."
        return Requirement("axial", self.axial, fits, f"be a whole number from 1 to {MOST_AXIAL}", remedy)

    def _requirements_of_grooves(self, is_count: bool) -> list[Requirement]:
        """Grooves at points, and narrower than their distance."""
        fits = isinstance(self.grooves, int) and self.grooves >= 0 and is_count
        fits = fits and (self.grooves == 0 or self.points % self.grooves == 0)
        width, angle = numeric(self.groove_width), numeric(self.groove_angle)
        widest = 2.0 * np.pi / self.points * SLACK if is_count else np.inf
        return [
            Requirement("grooves", self.grooves, fits, "be a divisor of points, or 0", "Give 0, 1 or 2, for example."),
            Requirement("groove_angle", self.groove_angle, abs(angle) < np.inf, "be finite", "Give an angle [rad]."),
            Requirement(
                "groove_width",
                self.groove_width,
                (width >= 0) & (width <= widest),
                f"lie between 0 and the distance of two points, {widest:.3g}",
                "Give a smaller angle [rad], or fewer points.",
            ),
        ]


def _ratio_vector(motion: FilmMotion, gap: FilmGap) -> Vector3:
    """r = e/(c + e_h1), not longer than `LARGEST_GAP_RATIO`."""
    r = motion.e / (gap.clearance + gap.transition_offset)
    ratio = safe_norm(r)
    return r * jnp.where(ratio < LARGEST_GAP_RATIO, 1.0, LARGEST_GAP_RATIO / jnp.maximum(ratio, 0.5))

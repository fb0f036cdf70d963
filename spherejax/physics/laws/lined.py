"""The film of a journal in a bearing with an elastic liner: Reynolds' equation and the liner's deflection together.

A thin layer that is bonded to a stiff shell gives way at each point by its own pressure alone, as a foundation of
columns: p = k_w w with k_w = E (1 - nu)/((1 + nu)(1 - 2 nu) t). The gap is h = h_0 + w, h_0 = c (1 - r.u) that of rigid
circles, and in axes of the bearing Reynolds' equation is

    dw/dt + W dw/da = V.u + (1/12 eta) [ d/da (h**3 dp/da)/R**2 + d/dz (h**3 dp/dz) ]

with V = e_rate - w x e of `bearings`, W half the speed of the journal against the bearing, and eta the viscosity: the
deflection is what is integrated, and no equation is left to be solved. Along the axis pressure and deflection are
parabolas, w (1 - s**2) with s = 2 z/L (Galerkin's method with this one function); round the bearing there are n
points.

The differences round the bearing are central, and so skew: sum w_i (w_(i+1) - w_(i-1)) = 0. What the journal gives
to the film is then stored in the liner or dissipated, to rounding.

Source: derived here. The column model: Higginson (1965), Proc. IMechE 180 (3B):31-38 (journal bearings with soft
liners); Bartel et al. (1985), J. Biomech. Eng. 107:193-199, for k_w.
"""

from typing import Annotated, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement, is_concrete
from spherejax.foundations.legal import positive
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Number, Scalar, Unit, Vector3
from spherejax.physics.laws.bearings import SLACK, ShortBearing
from spherejax.physics.laws.conformity import WinklerLiner
from spherejax.physics.laws.films import AbstractFilm, FilmAction, FilmGap, FilmMotion, swept
from spherejax.physics.laws.full_film import PressurePeak
from spherejax.physics.memory import MemoryEntry

FEWEST_POINTS, MOST_POINTS = 16, 96
"""Round the bearing, each a state; with 32 a load depends by 1 % on where it is against the points."""

LARGEST_LINED_RATIO = 0.8
"""|e|/(c + e_h1) up to which a run says nothing. There 32 points are within 4 % of a fine grid, at 0.9 within 10 %:
pressure that is not a parabola along the axis."""

LONGEST_LINED = 4.0
"""Length of a bearing, in radii, beyond which a run says that its pressure is no parabola along the axis: a rigid one
bears 7 % too little there at an eccentricity ratio of 0.8, and 9.5 % at twice that length."""

LARGEST_GAP_RATIO = 0.98
"""|e|/(c + e_h1) beyond which the gap of the rigid circles is held, so that the couple of shear stays finite."""

_AXIAL = (4.0 / 3.0, 8.0 / 5.0, 32.0 / 35.0, 64.0 / 315.0)
"""Of int 4 s**2 (h_0 + w (1 - s**2))**3 ds from 0 to 1, in h_0**3, h_0**2 w, h_0 w**2, w**3."""

_ROUND = (8.0 / 15.0, 48.0 / 35.0, 128.0 / 105.0, 256.0 / 693.0)
"""Of int (1 - s**2)**2 (h_0 + w (1 - s**2))**3 ds, likewise."""

_SQUARE, _MEAN = 8.0 / 15.0, 2.0 / 3.0
"""Of int (1 - s**2)**2 ds and int (1 - s**2) ds."""


def _conductance(factors: tuple[float, ...], gap: Array, deflection: Array) -> Array:
    """A cubic form of the gap and the deflection [m^3]."""
    a, b, c, d = factors
    return ((a * gap + b * deflection) * gap + c * deflection**2) * gap + d * deflection**3


class LinedBearing(AbstractFilm):
    """The film of a journal in a bearing with an elastic liner, of any length up to four radii.

        d/dt w_i = V.u_i (5/4) - W (w_(i+1) - w_(i-1))/(2 da) + (15/8) k_w/(12 eta) [round - along]
        round = [B_(i+1/2) (w_(i+1) - w_i) - B_(i-1/2) (w_i - w_(i-1))]/(R da)**2,    along = (4/L**2) A_i w_i
        F = -(2/3) L R da sum_i k_w w_i u_i

    w_i is the deflection of the liner in the middle of its length at the place u_i, A and B the cubic means of the gap
    along the axis with the weights of Galerkin's method. The liner is a foundation of columns, p = k_w w, with the k_w
    of `WinklerLiner`. What the film gives to the journal and takes from it differs by what the liner stores,
    (4/15) k_w L R da sum w_i**2, and by what is dissipated, which is never negative.

    With `Sommerfeld` suction draws the liner in. With `Guembel` the pressure is nowhere negative, and its edge is where
    the flow has it (Reynolds' condition): points where w_i < 0 have neither pressure nor deflection, and w_i says how
    much is missing. Moments are those of `ShortBearing`, with Petroff's couple in the deformed gap.

    The film stays where the journal goes beyond the clearance, beside the dry contact there: then the gap of the rigid
    circles is that at `LARGEST_GAP_RATIO`.

    Attributes:
        length: L, of the bearing [m].
        liner: its material and thickness.
        points: round the bearing, each a state (static).

    Limits: a liner that is thin against the width of the pressure, on a stiff shell; c << R, one viscosity, ambient
        pressure at both ends. Load within 2 % of a fine grid with a deflection at each point up to eps = 0.7 (3.5 % for
        L = 2 R), within 4 % at 0.8 and 10 % at 0.9: beyond 0.8 a run warns (`OutOfRangeWarning`). For L = 4 R it bears
        0.99, 0.99, 0.93 times that of a rigid grid at 0.3, 0.5, 0.8; in longer bearings a run warns (`StartWarning`).
        As the liner stiffens the film becomes that of a rigid bearing, and its states as fast as k_w c**3/(eta L**2)
        [1/s].

    Source: derived here; columns in journal bearings as in Higginson (1965), Proc. IMechE 180 (3B):31-38.
    """

    is_of_bearing: ClassVar[bool] = True
    beyond_range: ClassVar[str] = (
        "on a LinedBearing the journal was further out than 0.8 of the clearance, where the pressure is no parabola "
        "along the axis and the film bears too little, by a tenth at 0.9 (a thicker oil, a longer bearing or a stiffer "
        "liner keeps it within)"
    )

    length: Annotated[Number, Unit("m")]
    liner: WinklerLiner
    points: int = eqx.field(static=True, default=32)

    @property
    def memory(self) -> tuple[MemoryEntry, ...]:
        """The deflection at each point, in the middle of the length; errors are judged by a micrometer."""
        return tuple(MemoryEntry(f"deflection_{i}", "m", 1e-6) for i in range(self.points))

    @property
    def stores_energy(self) -> bool:
        """The liner does."""
        return True

    def rigid(self) -> AbstractFilm:
        """`ShortBearing` of that length."""
        return ShortBearing(self.length)

    def range_share(self, motion: FilmMotion, gap: FilmGap) -> Scalar:
        """|e|/(c + e_h1) as a share of `LARGEST_LINED_RATIO`."""
        return safe_norm(motion.e) / (gap.clearance + gap.transition_offset) / LARGEST_LINED_RATIO

    def doubt(self, socket_radius: float) -> str:
        """Of a bearing much longer than its diameter."""
        if not is_concrete(self.length) or not self.length > LONGEST_LINED * socket_radius * SLACK:
            return ""
        return (
            "film=LinedBearing has a parabola of pressure along the axis, and bears too little in a bearing longer "
            "than four radii: at eight radii 0.97 times what Reynolds' equation says at an eccentricity ratio of 0.3, "
            f"and 0.91 times at 0.8; here {float(self.length / socket_radius):.3g} radii. Give "
            "film=sj.laws.LongBearing(length), whose bearing is rigid, or take the load for a lower bound"
        )

    def places(self, motion: FilmMotion) -> Float[Array, "n 3"]:
        """Unit vectors to the points, which are fixed in the bearing, world axes."""
        angles = 2.0 * np.pi * np.arange(self.points) / self.points
        axes = motion.socket_axes
        assert axes is not None  # a bearing has them
        return jnp.asarray(np.cos(angles))[:, None] * axes[:, 0] + jnp.asarray(np.sin(angles))[:, None] * axes[:, 1]

    def deflections(self, memory: Float[Array, " n"], gap: FilmGap) -> Float[Array, " n"]:
        """Of the liner where it has a pressure [m]: without suction those that are positive."""
        return memory if gap.boundary.bears_suction else jnp.maximum(memory, 0.0)

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
        w = self.deflections(missing, gap)
        ahead, behind = jnp.roll(w, -1), jnp.roll(w, 1)
        conductance = _conductance(_ROUND, rigid, w)
        flow = 0.5 * (conductance + jnp.roll(conductance, -1)) * (ahead - w) / (radius * step) ** 2
        leaving = 4.0 / self.length**2 * _conductance(_AXIAL, rigid, w) * missing
        spread = foundation / (12.0 * gap.viscosity) * (flow - jnp.roll(flow, 1) - leaving)
        carried = -0.25 * spin * (ahead - behind) / step
        rates = carried + (_MEAN * (places @ velocity) + spread) / _SQUARE
        force = -_MEAN * foundation * area * (w @ places)
        couple = -gap.viscosity * area * radius**2 * jnp.sum(1.0 / (rigid + _MEAN * w)) * spin * axis
        stored = 0.5 * _SQUARE * foundation * area * (w @ w)
        arm = jnp.cross(motion.e, force) / 2
        return FilmAction(
            force,
            couple - arm,
            -couple - arm,
            -foundation * area * (w @ spread),
            -(couple @ axis) * spin,
            rates,
            stored,
        )

    def pressure_peak(self, motion: FilmMotion, gap: FilmGap) -> PressurePeak:
        """The largest pressure of all points, in the middle of the length."""
        assert motion.memory is not None
        highest = jnp.argmax(motion.memory)
        largest = jnp.maximum(motion.memory[highest], 0.0)
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
        ]


def _ratio_vector(motion: FilmMotion, gap: FilmGap) -> Vector3:
    """r = e/(c + e_h1), not longer than `LARGEST_GAP_RATIO`."""
    r = motion.e / (gap.clearance + gap.transition_offset)
    ratio = safe_norm(r)
    return r * jnp.where(ratio < LARGEST_GAP_RATIO, 1.0, LARGEST_GAP_RATIO / jnp.maximum(ratio, 0.5))

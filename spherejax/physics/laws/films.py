"""What a film does to ball and socket: the paper's, along the line of centers, or the full one, in every direction."""

import abc
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.numerics import radial_projection, safe_norm
from spherejax.foundations.types import Matrix3, Number, Scalar, Vector3
from spherejax.physics.laws.base import AbstractLaw
from spherejax.physics.laws.film import (
    MAXIMUM_ECCENTRICITY_RATIO,
    AbstractFilmBoundary,
    film_force,
    squeeze_coefficient,
)
from spherejax.physics.laws.full_film import PressurePeak, film_slope, pressure_peak, shear_factors
from spherejax.physics.laws.oil import OilTransport
from spherejax.physics.laws.thickening import (
    AbstractThickening,
    BallPressure,
    PressedOil,
    ball_pressure,
    thickened_ball,
)
from spherejax.physics.memory import MemoryEntry

LARGEST_OFFSET_RATIO = 0.05
"""e_h1 / c up to which the film is used without a warning. A film stands at e/(c + e_h1), so the eccentricity under a
load is too large by about this share; the paper goes up to 0.04 (2 micrometers at c = 0.05 mm)."""


class FilmGap(NamedTuple):
    """The gap and what fills it.

    Attributes:
        clearance: c [m].
        socket_radius: R [m].
        viscosity: nu [Pa s]; one at each point for a film that has some, where the oil's temperature is resolved.
        transition_offset: e_h1 [m], by which the film is thicker than the gap, so that it stays finite at |e| = c.
        boundary: which parts of the film carry pressure.
        thickening: how the viscosity grows with the pressure; None for one that does not.
    """

    clearance: Number
    socket_radius: Number
    viscosity: Number | Float[Array, " n"]
    transition_offset: Number
    boundary: AbstractFilmBoundary
    thickening: AbstractThickening | None = None

    @property
    def pressed_oil(self) -> PressedOil | None:
        """How the oil of this viscosity thickens; None where it does not."""
        return None if self.thickening is None else self.thickening.of_viscosity(self.viscosity)


class FilmMotion(NamedTuple):
    """Motion of the ball in its socket, world axes.

    Attributes:
        e: eccentricity, socket center to ball center [m].
        e_rate: its rate [m/s].
        socket_spin, ball_spin: angular velocities of both [rad/s].
        axis: of a bearing, unit length; None for a ball.
        memory: what the film remembers, as its `memory` lists it; None for one that lists nothing.
        socket_axes: axes of the socket, z along a bearing, as columns in world axes; None where nobody asks for them.
    """

    e: Vector3
    e_rate: Vector3
    socket_spin: Vector3
    ball_spin: Vector3
    axis: Vector3 | None = None
    memory: Float[Array, " n"] | None = None
    socket_axes: Matrix3 | None = None


class FilmAction(NamedTuple):
    """What the film does, world axes.

    Attributes:
        force: on the ball, at its center [N]; the socket receives the opposite at its own center.
        ball_moment: on the ball about its center [N m].
        socket_moment: on the socket about its center [N m].
        pressure_power: dissipated by the flow of the oil under pressure [W], not negative.
        shear_power: dissipated by the shear of the oil [W], not negative.
        memory_rate: rates of what the film remembers; None for one that lists nothing.
        stored_energy: of a film that stores some [J], as by a liner; None for others.
        transport: of the oil from point to point, where its temperature is resolved; None elsewhere.
    """

    force: Vector3
    ball_moment: Vector3
    socket_moment: Vector3
    pressure_power: Scalar
    shear_power: Scalar
    memory_rate: Float[Array, " n"] | None = None
    stored_energy: Scalar | None = None
    transport: OilTransport | None = None


class AbstractFilm(AbstractLaw):
    """In which directions a film resists.

    Attributes:
        is_of_bearing: whether it is that of a journal in a bearing, and not of a ball in a socket.
        thickens: whether it knows oil that thickens under pressure.
        carries_contact: whether it bears the ball beyond the clearance too, on a liner, in place of dry contact.
        beyond_range: what its own `range_share` above 1 means, in words; empty where that is of the oil alone.
    """

    is_of_bearing: ClassVar[bool] = False
    carries_contact: ClassVar[bool] = False
    thickens: ClassVar[bool] = False
    beyond_range: ClassVar[str] = ""

    @property
    def memory(self) -> tuple[MemoryEntry, ...]:
        """What the film remembers through contact and flight, each entry 0 at the start (static); nothing by default.

        It comes with the motion, and the action brings its rates.
        """
        return ()

    @property
    def stores_energy(self) -> bool:
        """Whether the film gives back some of what it takes (static), and says by its action how much it stores.

        Such a film acts in full where dry contact begins, beside it: were its force taken away by the share of the
        contact, as that of others is, it would not give back what it took.
        """
        return False

    @property
    def n_points(self) -> int:
        """Round the bearing, each with a viscosity of its own (static); 0 of a film that has one viscosity."""
        return 0

    @property
    def n_grooves(self) -> int:
        """That feed the film (static)."""
        return 0

    def rigid(self) -> "AbstractFilm | None":
        """The film between surfaces that do not give way, for tables of effects; None for one that has no other."""
        return None

    def range_share(self, motion: FilmMotion, gap: FilmGap) -> Scalar | None:
        """How far out the ball is, as a share of what the film is for: a run warns beyond 1. None for any."""
        return None

    def doubt(self, socket_radius: float) -> str:
        """What is said before a run of a film that is not for a socket of that radius [m]; empty of one that is."""
        del socket_radius
        return ""

    def damping(self, clearance: Number, socket_radius: Number, viscosity: Number) -> Number | None:
        """Force by velocity of a concentric ball without suction [N s/m]; None of a film that a liner makes softer."""
        del clearance, socket_radius, viscosity
        return None

    @abc.abstractmethod
    def action(self, motion: FilmMotion, gap: FilmGap) -> FilmAction:
        """Force and moments of the film."""

    def pressure_peak(self, motion: FilmMotion, gap: FilmGap) -> PressurePeak | None:
        """Largest pressure [Pa], and the unit vector from the center to its place; None for a film that knows none."""
        return None

    def thickness(self, motion: FilmMotion, gap: FilmGap) -> Scalar | None:
        """The least thickness [m] between surfaces that give way; None where it is that of the rigid gap."""
        return None

    def requirements(self) -> list[Requirement]:
        """None: a film has no numbers of its own."""
        return []


def _pressure_peak(velocity: Vector3, motion: FilmMotion, gap: FilmGap) -> PressurePeak:
    height, place = pressure_peak(ratio_vector(motion, gap), velocity)
    return PressurePeak(12.0 * gap.viscosity * gap.socket_radius**2 / gap.clearance**3 * height, place)


def ratio_vector(motion: FilmMotion, gap: FilmGap) -> Vector3:
    """r = e/(c + e_h1), not longer than `MAXIMUM_ECCENTRICITY_RATIO`."""
    r = motion.e / (gap.clearance + gap.transition_offset)
    ratio = safe_norm(r)
    return r * jnp.where(ratio < MAXIMUM_ECCENTRICITY_RATIO, 1.0, MAXIMUM_ECCENTRICITY_RATIO / jnp.maximum(ratio, 0.5))


class RadialFilm(AbstractFilm):
    """The paper's film: it resists motion along the line of centers, and nothing else.

        F = -C load_factor P e_rate

    A ball that swings across that line meets no resistance: it may ring for long, and take many steps. No moments.

    Source: Rodrigues da Silva et al. (2022), Eq. 37; see `film_force`.
    """

    def damping(self, clearance: Number, socket_radius: Number, viscosity: Number) -> Number:
        """2/3 C."""
        return 2.0 / 3.0 * squeeze_coefficient(viscosity, socket_radius, clearance)

    def action(self, motion: FilmMotion, gap: FilmGap) -> FilmAction:
        """`film_force`, and no moments."""
        clearance, radius, viscosity, offset, boundary, _ = gap
        force = film_force(motion.e, motion.e_rate, clearance, radius, viscosity, boundary, offset)
        none = jnp.zeros(3)
        return FilmAction(force, none, none, -(force @ motion.e_rate), jnp.zeros(()))

    def pressure_peak(self, motion: FilmMotion, gap: FilmGap) -> PressurePeak:
        """See `pressure_peak`, for the velocity along the line of centers."""
        return _pressure_peak(radial_projection(motion.e, motion.e_rate), motion, gap)


class FullFilm(AbstractFilm):
    """The film of Reynolds' equation for any motion: squeeze and wedge as one vector, and the couple of shear.

        F = -C load(r, V),    V = e_rate - w x e,    w = (w_socket + w_ball)/2,    r = e/(c + e_h1)
        M_ball = -e x F/2 + M_c,    M_socket = -e x F/2 - M_c
        M_c = -(8 pi nu R**4/(3 c)) (m_par n n^T + m_perp (I - n n^T)) (w_ball - w_socket)

    with C = 6 pi nu R (R/c)**3 and the load of the boundary condition (`half_sphere_load` for `Guembel`,
    `full_sphere_load` for `Sommerfeld`). A pair that turns as one body feels nothing; momentum and angular momentum are
    kept; the absorbed power -F.V - M_c.(w_ball - w_socket) is never negative. The couple of shear is that of a gap that
    is full of oil, whatever the boundary condition.

    Limits: an unpierced sphere in a full ring of oil of constant viscosity, rigid surfaces, c << R. A cup with a rim
    has less film; heavily loaded joints deform (elastohydrodynamics). For |e| beyond `MAXIMUM_ECCENTRICITY_RATIO` of
    c + e_h1 the film is that at this ratio.

    With oil that thickens under pressure this is the film of the reduced pressure, see `thickening`.

    Source: derived here, see `full_film`.
    """

    thickens: ClassVar[bool] = True

    def damping(self, clearance: Number, socket_radius: Number, viscosity: Number) -> Number:
        """2/3 C."""
        return 2.0 / 3.0 * squeeze_coefficient(viscosity, socket_radius, clearance)

    def action(self, motion: FilmMotion, gap: FilmGap) -> FilmAction:
        """Force, and moments that keep the angular momentum of the pair."""
        velocity = swept(motion)
        spin = motion.ball_spin - motion.socket_spin
        r = ratio_vector(motion, gap)
        coefficient = squeeze_coefficient(gap.viscosity, gap.socket_radius, gap.clearance)
        load = gap.boundary.swept_load(r, velocity)
        assert load is not None  # `Lubricated` refuses such a boundary
        force = -coefficient * load
        along, excess = shear_factors(r @ r)
        across = along + (r @ r) * excess
        # 8 pi nu R^4/(3 c) = 4/9 C c^2
        couple = -4.0 / 9.0 * coefficient * gap.clearance**2 * (across * spin - excess * (r @ spin) * r)
        if (oil := gap.pressed_oil) is not None:
            braking = gap.viscosity * gap.socket_radius**4 / gap.clearance * spin
            added = thickened_ball(oil, self._reduced(motion, gap), gap.socket_radius**2, braking)
            force, couple = force + added.force, couple + added.couple
        arm = jnp.cross(motion.e, force) / 2
        return FilmAction(force, couple - arm, -couple - arm, -(force @ velocity), -(couple @ spin))

    def range_share(self, motion: FilmMotion, gap: FilmGap) -> Scalar | None:
        """The largest reduced pressure as a share of what a run says nothing of; None for oil that does not thicken."""
        oil = gap.pressed_oil
        return None if oil is None else oil.range_share(self._reduced(motion, gap).pressure)

    def _reduced(self, motion: FilmMotion, gap: FilmGap) -> BallPressure:
        r, scale = ratio_vector(motion, gap), 12.0 * gap.viscosity * gap.socket_radius**2 / gap.clearance**3
        return ball_pressure(r, film_slope(r, swept(motion)), scale, gap.boundary.bears_suction)

    def pressure_peak(self, motion: FilmMotion, gap: FilmGap) -> PressurePeak:
        """See `pressure_peak`, for V; of oil that thickens the pressure, not the reduced one."""
        peak, oil = _pressure_peak(swept(motion), motion, gap), gap.pressed_oil
        return peak if oil is None else peak._replace(height=peak.height + oil.excess(peak.height).pressure)


def swept(motion: FilmMotion) -> Vector3:
    """V = e_rate - w x e: the ball's velocity less the mean rotation of both."""
    return motion.e_rate - jnp.cross((motion.socket_spin + motion.ball_spin) / 2, motion.e)

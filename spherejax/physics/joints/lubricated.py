"""The hydrodynamically lubricated joint: a film that hands over to dry contact (sections 3.3 and 4.3)."""

from typing import Annotated, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import is_numeric
from spherejax.foundations.legal import at_least, non_negative, positive
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Number, Scalar, Unit
from spherejax.physics.joints.base import Effect, Medium, Response
from spherejax.physics.joints.clearance import AbstractClearanceModel, clearance_from
from spherejax.physics.joints.contact import (
    contact_effects,
    contact_forces,
    contact_law_requirements,
    contact_moments,
    has_bristles,
    stiffness_of,
)
from spherejax.physics.kinematics import RelativeMotion
from spherejax.physics.laws.conformity import AbstractConformity, PressedPair
from spherejax.physics.laws.film import AbstractFilmBoundary, Guembel, hybrid_weight
from spherejax.physics.laws.films import AbstractFilm, FilmAction, FilmGap, FilmMotion, FullFilm, RadialFilm
from spherejax.physics.laws.friction import AbstractFrictionLaw
from spherejax.physics.laws.material import Material
from spherejax.physics.laws.normal import AbstractNormalLaw, HuntCrossleyDissipation
from spherejax.physics.laws.oil import AbstractOilHeat
from spherejax.physics.laws.thickening import AbstractThickening
from spherejax.physics.memory import MemoryEntry

WIDTH_SHARE, OFFSET_SHARE = 0.01, 0.02
"""Defaults of e_h0 and e_h1 as shares of the clearance: the paper's 1 and 2 micrometers (Table 3) at its c = 0.1 mm.
The same lengths at c = 5 micrometers halve the load of a short journal bearing at an eccentricity ratio of 0.5."""

_NODES, _WEIGHTS = (tuple(map(float, row)) for row in np.polynomial.legendre.leggauss(12))


_served: dict[Any, bool] = {}


def _serves_every_direction(boundary: AbstractFilmBoundary) -> bool:
    # Its numbers do not matter, so it is asked once, and nothing is evaluated, which would compile each operation.
    kind = jax.tree.structure(boundary)
    if kind not in _served:
        vector = jax.ShapeDtypeStruct((3,), jnp.float64)
        _served[kind] = jax.eval_shape(boundary.swept_load, vector, vector) is not None
    return _served[kind]


def _usual_film(boundary: AbstractFilmBoundary) -> AbstractFilm:
    """The full film, where its boundary condition has one."""
    return FullFilm() if _serves_every_direction(boundary) else RadialFilm()


def _check_film(film: AbstractFilm, boundary: AbstractFilmBoundary) -> None:
    """A film in every direction needs a boundary condition for every direction."""
    if not isinstance(film, RadialFilm) and not _serves_every_direction(boundary):
        raise SceneError(
            f"{type(film).__name__} with {type(boundary).__name__}: that condition is of squeezing along the line of "
            "centers alone. Take boundary=sj.Guembel() or boundary=sj.Sommerfeld(), or film=sj.laws.RadialFilm()."
        )


def _rates_of(film: FilmAction) -> list[Float[Array, " n"]]:
    return [] if film.memory_rate is None else [film.memory_rate]


def _with_store_of(film: FilmAction, energy: Scalar) -> Scalar:
    return energy if film.stored_energy is None else energy + film.stored_energy


def _share_of(clearance: Any, share: float) -> Any:
    """A length as a share of the clearance [m]; 0 where the clearance is no number, which the checks of a scene name.

    By division: 1e-4 / 100 is the paper's 1e-6 to the last bit, 1e-4 * 0.01 is not.
    """
    return clearance / round(1 / share) if is_numeric(clearance) else 0.0


class Lubricated(AbstractClearanceModel):
    """Ball and socket with clearance, filled with a lubricant: a film, and dry contact beyond it.

        f = (1 - w) f_film + w f_contact,    w = 0 up to e = c, linear to 1 at e = c + e_h0

    Attributes:
        clearance: radial clearance c = R_i - R_j [m].
        socket_radius: R_i, inner radius of the socket [m].
        viscosity: dynamic viscosity of the lubricant [Pa s].
        normal: law of the normal force in dry contact.
        friction: law of the friction force in dry contact, or None.
        e_h0: width of the transition from film to contact [m]; 0.01 c unless it is given.
        e_h1: offset that keeps the film finite at e = c [m]; 0.02 c unless it is given. The film is that at the
            eccentricity ratio e/(c + e_h1), so an equilibrium lies further out than without it by the factor
            1 + e_h1/c; above 0.05 c a run warns (`OutOfRangeWarning`).
        boundary: which parts of the film carry pressure.
        film: in which directions it resists: `FullFilm()`, or `RadialFilm()`, the paper's; `LinedSocket(liner)` in a
            cup that gives way, which bears the ball beyond the clearance too, in place of dry contact.
        socket_material: material of the socket.
        ball_material: material of the ball.
        conformity: how surfaces that nearly fit press back, in place of Hertz's law (`SphericalProfile`,
            `WinklerLiner`); None for that.
        heat: what warms and cools the oil, whose viscosity then falls with its temperature; None for a constant
            viscosity.
        thickening: how the viscosity grows with the film's pressure; None for one that does not.

    Args:
        ball_radius: R_j, instead of the clearance [m].

    A film that is not given is the full one. With `boundary=PinkusSternlicht()`, which says nothing of a ball that
    moves across the line of centers, it is the radial one.

    Source: the paper, Eqs 37 to 40, with the eccentricity rate in m/s and, on separation, the pressure of the other
    half film (`Guembel`); defaults from its Table 3, where e_h0 = 1e-6 m and e_h1 = 2e-6 m hold for every clearance:
    here they scale with it and agree at c = 1e-4 m. The full film is derived here; the paper has the radial one.
    """

    clearance: Number
    socket_radius: Number
    viscosity: Number
    normal: AbstractNormalLaw
    friction: AbstractFrictionLaw | None
    e_h0: Number
    e_h1: Number
    boundary: AbstractFilmBoundary
    film: AbstractFilm
    socket_material: Material
    ball_material: Material
    conformity: AbstractConformity | None
    heat: AbstractOilHeat | None
    thickening: AbstractThickening | None
    _ball_radius_given: bool = eqx.field(static=True)

    def __init__(
        self,
        clearance: Annotated[Number | None, Unit("m")] = None,
        viscosity: Annotated[Number, Unit("Pa s")] = 0.4,
        *,
        socket_radius: Annotated[Number, Unit("m")] = 0.010,
        ball_radius: Annotated[Number | None, Unit("m")] = None,
        normal: AbstractNormalLaw | None = None,
        friction: AbstractFrictionLaw | None = None,
        e_h0: Annotated[Number | None, Unit("m")] = None,
        e_h1: Annotated[Number | None, Unit("m")] = None,
        boundary: AbstractFilmBoundary | None = None,
        film: AbstractFilm | None = None,
        socket_material: Material | None = None,
        ball_material: Material | None = None,
        conformity: AbstractConformity | None = None,
        heat: AbstractOilHeat | None = None,
        thickening: AbstractThickening | None = None,
    ):
        self.clearance = clearance_from(clearance, socket_radius, ball_radius)
        self.socket_radius = socket_radius
        self.viscosity = viscosity
        self.normal = HuntCrossleyDissipation() if normal is None else normal
        self.friction = friction
        self.e_h0 = _share_of(self.clearance, WIDTH_SHARE) if e_h0 is None else e_h0
        self.e_h1 = _share_of(self.clearance, OFFSET_SHARE) if e_h1 is None else e_h1
        self.boundary = Guembel() if boundary is None else boundary
        self.film = _usual_film(self.boundary) if film is None else film
        if film is not None:
            _check_film(film, self.boundary)
        self.socket_material = Material() if socket_material is None else socket_material
        self.ball_material = Material() if ball_material is None else ball_material
        self.conformity = conformity
        self.heat = heat
        self.thickening = thickening
        self._ball_radius_given = ball_radius is not None

    @property
    def effects(self):
        """Elastic contact, what the normal law adds to it, friction, the liner of the film, viscosity by
        pressure, the warmth of the oil."""
        cold = eqx.tree_at(lambda m: (m.heat, m.thickening), self, (None, None), is_leaf=lambda leaf: leaf is None)
        rigid = self.film.rigid()
        base = cold if rigid is None else eqx.tree_at(lambda m: m.film, cold, rigid)
        kind = type(base.film)
        film = {RadialFilm: "radial film", FullFilm: "full film"}.get(kind, kind.__name__)
        effects = contact_effects(base, f"{film} ({type(self.boundary).__name__}) and elastic contact")
        if rigid is not None:
            effects = (*effects, Effect(f"elastic liner ({len(self.film.memory)} points)", cold))
        if self.thickening is not None:
            thick = eqx.tree_at(lambda m: m.heat, self, None, is_leaf=lambda leaf: leaf is None)
            effects = (*effects, Effect(f"viscosity by pressure ({type(self.thickening).__name__})", thick))
        if self.heat is None:
            return effects
        return (*effects, Effect(self.heat.effect(self.film.n_points), self))

    def requirements(self) -> list[Requirement]:
        """Legal geometry, lubricant, materials and laws."""
        return [
            *self.surfaces.requirements(self._ball_radius_given),
            positive("viscosity", self.viscosity, "Pa s"),
            non_negative("e_h0", self.e_h0, "m"),
            at_least("e_h1", self.e_h1, "e_h0", self.e_h0),
            *self.boundary.requirements(),
            *self.film.requirements(),
            *contact_law_requirements(self.normal, self.friction, self.conformity),
            *self._requirements_of_heat(),
            *self._requirements_of_thickening(),
            *self._requirements_of_lined_contact(),
        ]

    def _requirements_of_heat(self) -> list[Requirement]:
        """A legal law, and for temperatures round a bearing a film that is resolved there."""
        if self.heat is None:
            return []
        name, fits = type(self.film).__name__, self.film.n_points > 0 or not self.heat.is_resolved
        what = f"be resolved round its bearing with heat={type(self.heat).__name__}"
        return [
            *(r._replace(field=f"heat.{r.field}") for r in self.heat.requirements()),
            Requirement("film", name, fits, what, "Take LinedBearing, or OilHeat for one temperature of all oil."),
        ]

    def _requirements_of_thickening(self) -> list[Requirement]:
        """A legal law, and a film that knows of it."""
        if self.thickening is None:
            return []
        name, remedy = type(self.film).__name__, "Take FullFilm, ShortBearing or LongBearing, or leave thickening out."
        return [
            *(r._replace(field=f"thickening.{r.field}") for r in self.thickening.requirements()),
            Requirement("film", name, self.film.thickens, "know oil that thickens under pressure", remedy),
        ]

    def _requirements_of_lined_contact(self) -> list[Requirement]:
        """No dry friction where the film takes the place of the contact."""
        if not self.film.carries_contact or self.friction is None:
            return []
        what = f"be None with film={type(self.film).__name__}, in which surfaces never touch"
        return [Requirement("friction", type(self.friction).__name__, False, what, "Leave it out.")]

    def requirements_of(self, *, is_bearing: bool) -> list[Requirement]:
        """A film of such a joint as well."""
        film = self.film
        remedy = (
            "Give film=sj.laws.ShortBearing(length) or film=sj.laws.LongBearing(length)."
            if is_bearing
            else "Give film=sj.laws.FullFilm() or film=sj.laws.LinedSocket(liner); bearings belong to revolute joints."
        )
        of = "of a journal in its bearing" if is_bearing else "of a ball in its socket"
        fits = film.is_of_bearing == is_bearing
        return [
            Requirement("film", type(film).__name__, fits, f"be {of}", remedy),
            *super().requirements_of(is_bearing=is_bearing),
        ]

    @property
    def memory(self) -> tuple[MemoryEntry, ...]:
        """That of the contact, what the film remembers, and the warmth of the oil."""
        film = (entry._replace(lasts=True) for entry in self.film.memory)
        return (*super().memory, *film, *self._heat_entries())

    def _heat_entries(self) -> tuple[MemoryEntry, ...]:
        return () if self.heat is None else self.heat.memory_of(self.film.n_points)

    @property
    def memory_fades(self) -> bool:
        """Where the film has a liner, whose deflection does."""
        return self.film.stores_energy

    @property
    def offset_ratio(self) -> Scalar | None:
        """e_h1/c, by which the film's offset biases an eccentricity; above `films.LARGEST_OFFSET_RATIO` a run warns.
        None for a film that has no use for the offset."""
        if self.film.carries_contact:
            return None
        return jnp.asarray(self.e_h1 / self.clearance)

    @property
    def surfaces_touch(self) -> bool:
        """Beyond the clearance, but for a film that bears the ball there too."""
        return not self.film.carries_contact

    @property
    def largest_ratio(self) -> float | None:
        """That of dry contact; None where the film bears the ball instead."""
        return None if self.film.carries_contact else super().largest_ratio

    @property
    def medium(self) -> Medium:
        """A film."""
        return Medium.FILM

    def respond(self, motion, memory) -> Response:
        """Film and contact forces on the ball."""
        surfaces = self.surfaces
        weight = self._contact_share(motion)
        contact = contact_forces(motion, memory, surfaces, self.normal, self.friction, weight)
        film_motion, gap = self._film_motion(motion, memory), self._film_gap(memory)
        film = self.film.action(film_motion, gap)
        share = self._film_share(weight)
        ball_moment, socket_moment = contact_moments(motion, surfaces, contact.friction, contact.normal_force)
        penetration = self.penetration(motion)
        thickness = self.film.thickness(film_motion, gap)
        return Response(
            force=share * film.force + contact.force,
            ball_moment=share * film.ball_moment + ball_moment,
            socket_moment=share * film.socket_moment + socket_moment,
            memory_rate=jnp.concatenate(
                [jnp.zeros(1), contact.bristle_rate, *_rates_of(film), *self._warming_rate(film, share, memory)]
            ),
            elastic_energy=_with_store_of(film, self._elastic_energy(penetration) + contact.bristle_energy),
            parts={
                "penetration": penetration,
                "normal_force": contact.normal_force,
                "friction_force": contact.friction,
                "film_force": share * film.force,
                "film_moment": share * film.ball_moment,
                "film_power": share * film.pressure_power,
                "shear_power": share * film.shear_power,
                "film_thickness": -penetration if thickness is None else thickness,
                "sliding_velocity": contact.sliding_velocity,
                **self._heat_parts(film, memory),
            },
        )

    def stored_energy(self, motion, memory):
        """Of the pressed surfaces, and of bristles and of a film that stores some, where there are any."""
        if has_bristles(self) or self.film.stores_energy or type(self).respond is not Lubricated.respond:
            return super().stored_energy(motion, memory)
        return self._elastic_energy(self.penetration(motion))

    def observed(self, motion, memory):
        """Largest pressure of the film's share [Pa], and the unit vector from the socket's center to its place."""
        peak = self.film.pressure_peak(self._film_motion(motion, memory), self._film_gap(memory))
        if peak is None:
            return {}
        weight = self._contact_share(motion)
        return {"film_pressure": self._film_share(weight) * peak.height, "film_pressure_place": peak.place}

    def film_range_share(self, motion: RelativeMotion, memory) -> Scalar | None:
        """How far out the ball is, as a share of what the film is for; None for any."""
        return self.film.range_share(self._film_motion(motion, memory), self._film_gap(memory))

    @property
    def beyond_film_range(self) -> str:
        """Of the film, or of its oil that thickens."""
        return self.film.beyond_range or ("" if self.thickening is None else self.thickening.beyond_range)

    def _contact_share(self, motion: RelativeMotion) -> Scalar:
        """Of the dry contact's force that acts; none where the film bears the ball beyond the clearance too."""
        if self.film.carries_contact:
            return jnp.zeros(())
        return hybrid_weight(safe_norm(motion.eccentricity), self.clearance, self.e_h0)

    def _film_share(self, weight: Scalar) -> Scalar:
        """Of the film's force: what contact leaves, or all of it where the film stores energy."""
        return jnp.ones(()) if self.film.stores_energy else 1 - weight

    def _film_motion(self, motion: RelativeMotion, memory) -> FilmMotion:
        return FilmMotion(
            motion.eccentricity,
            motion.eccentricity_rate,
            motion.socket_angular_velocity,
            motion.ball_angular_velocity,
            motion.socket_rotation[:, 2],
            memory[len(super().memory) :][: len(self.film.memory)] if self.film.memory else None,
            motion.socket_rotation,
        )

    def _film_gap(self, memory) -> FilmGap:
        viscosity = self.viscosity
        if self.heat is not None:
            viscosity = viscosity * self.heat.viscosity.ratio(self._oil_temperature(self.heat, memory))
        return FilmGap(self.clearance, self.socket_radius, viscosity, self.e_h1, self.boundary, self.thickening)

    def _oil_temperature(self, heat: AbstractOilHeat, memory) -> Array:
        """Of the oil [K], by what comes last in the memory."""
        return heat.temperature(memory[-len(self._heat_entries()) :])

    def _warming_rate(self, film: FilmAction, share: Scalar, memory) -> list[Float[Array, " n"]]:
        """Of the oil [K/s]; none without heat."""
        if self.heat is None:
            return []
        power = share * (film.pressure_power + film.shear_power)
        return [self.heat.rates(self._oil_temperature(self.heat, memory), power, film.transport)]

    def _heat_parts(self, film: FilmAction, memory) -> dict[str, Array]:
        """Temperature of the oil and where its heat goes; nothing without heat."""
        return {} if self.heat is None else self.heat.told(self._oil_temperature(self.heat, memory), film.transport)

    def _elastic_energy(self, penetration: Scalar) -> Scalar:
        """Integral of w(delta) f(delta): the blended contact force does the work that contact gives back.

        With h = e_h0 and f = K delta^n: K delta^(n+2) / ((n+2) h) up to delta = h, then
        K h^(n+1) / (n+2) + K (delta^(n+1) - h^(n+1)) / (n+1); otherwise by 12 Gauss points in sqrt(delta).
        """
        if self.film.carries_contact:
            return jnp.zeros(())
        normal, h = self.normal, self.e_h0
        stiffness = stiffness_of(normal, self.surfaces)
        width = jnp.where(h > 0, h, 1.0)
        inside = jnp.clip(penetration, 0.0, h)
        if isinstance(stiffness, PressedPair):
            roots = [0.5 * (1.0 + node) for node in _NODES]
            terms = [x**3 * normal.elastic_force(inside * x * x, stiffness) for x in roots]
            blended = inside**2 / width * sum(w * term for w, term in zip(_WEIGHTS, terms, strict=True))
        else:
            n = normal.exponent
            blended = normal.elastic_force(inside, stiffness) * inside * inside / ((n + 2) * width)
        full = normal.elastic_energy(penetration, stiffness) - normal.elastic_energy(inside, stiffness)
        return jnp.where(h > 0, blended, 0.0) + full

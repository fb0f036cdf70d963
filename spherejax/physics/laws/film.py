"""Squeeze film between ball and socket, and its blend into dry contact.

What the paper has: a film that acts along the line of centers (`films.RadialFilm`). The one that acts in every
direction is in `full_film`.

A ball that moves at the rate e_rate along the line of centers presses the lubricant out of the closing half
of the gap and draws it into the opening half. Reynolds' equation integrated over one half sphere gives

    f = C e_rate B(eps),    C = 6 pi nu R (R/c)**3,    eps = |e|/c

with eps > 0 on the closing half; the opening half is the same integral at -eps. Which halves carry pressure
is the boundary condition. e_rate is the eccentricity's rate in m/s, not the rate of the ratio.
"""

import abc
import math
from typing import ClassVar

import jax.numpy as jnp

from spherejax.foundations.checks import Requirement
from spherejax.foundations.numerics import horner, radial_projection, safe_norm
from spherejax.foundations.types import Flag, Number, Scalar, Vector3
from spherejax.physics.laws.base import AbstractLaw
from spherejax.physics.laws.full_film import full_sphere_load, half_sphere_load

MAXIMUM_ECCENTRICITY_RATIO = 1.0 - 1e-12
"""Ratio beyond which the film's load factor, which grows as 1/(1 - eps), is held constant to stay finite.

The remaining gap, 1e-16 m of a tenth of a millimeter, has no physical meaning: a film that gets there is
replaced by contact.
"""

_SERIES_RADIUS = 0.3
"""Above it the logarithm less its first two terms has lost 3/eps**2 = 33 roundings at most."""

_SERIES = tuple(1.0 / (2 * k + 3) for k in range(11))
"""Of (artanh(t) - t)/t**3 in t**2; with |t| <= 0.3/1.7 eleven terms leave 1e-18."""


def squeeze_factor(eccentricity_ratio: Number) -> Scalar:
    """Load factor B of one half sphere under pressure [-].

        B(eps) = ln(1 - eps)/eps**3 + 1/(eps**2 (1 - eps)) - 1/(2 eps) = sum_k (k + 2)/(k + 3) eps**k

    Evaluated as 1/(1 - eps) - S(eps), S = sum_k eps**k/(k + 3) = -(ln(1 - eps) + eps + eps**2/2)/eps**3.
    Near zero, where S cancels, t = eps/(2 - eps) turns the logarithm into -2 artanh(t), the leading terms
    drop out by hand, and S = (1 + t)/4 + (1 + t)**3/4 (1/3 + t**2/5 + t**4/7 + ...) has no differences left.

    Args:
        eccentricity_ratio: eps in (-1, 1); negative for the half that opens.

    Limits: B(0) = 2/3, B'(0) = 3/4; B -> 1/(1 - eps) as eps -> 1; B(-1) = 1 - ln 2.

    Source: Rodrigues da Silva et al. (2022), Eq. 37, after Pinkus and Sternlicht (1961); re-derived from
    Reynolds' equation. The form in t is derived here.
    """
    near = jnp.abs(eccentricity_ratio) < _SERIES_RADIUS
    eps_near = jnp.where(near, eccentricity_ratio, 0.0)
    eps_far = jnp.where(near, 0.5, eccentricity_ratio)
    t = eps_near / (2.0 - eps_near)
    sum_near = 0.25 * (1.0 + t) * (1.0 + (1.0 + t) ** 2 * horner(_SERIES, t * t))
    sum_far = -(jnp.log1p(-eps_far) + eps_far + 0.5 * eps_far * eps_far) / (eps_far * eps_far * eps_far)
    return 1.0 / (1.0 - eccentricity_ratio) - jnp.where(near, sum_near, sum_far)


def squeeze_coefficient(viscosity: Number, socket_radius: Number, clearance: Number) -> Number:
    """C = 6 pi nu R (R/c)**3 [N s/m].

    Args:
        viscosity: dynamic viscosity nu [Pa s].
        socket_radius: R [m].
        clearance: c [m].

    Source: Rodrigues da Silva et al. (2022), Eq. 37.
    """
    return 6.0 * math.pi * viscosity * socket_radius * (socket_radius / clearance) ** 3


class AbstractFilmBoundary(AbstractLaw):
    """Which parts of the film carry pressure.

    Attributes:
        bears_suction: whether a bearing's film carries suction as it does pressure; None for a condition of squeezing
            alone.
    """

    bears_suction: ClassVar[bool | None] = None

    @abc.abstractmethod
    def load_factor(self, eccentricity_ratio: Number, separating: Flag) -> Scalar:
        """The film's force divided by C |e_rate| [-], positive: the film always opposes the motion.

        Args:
            eccentricity_ratio: eps in [0, 1).
            separating: whether the ball moves toward the center of the socket.
        """

    def swept_load(self, r: Vector3, velocity: Vector3) -> Vector3 | None:
        """The load F = -C load [m/s] of a ball that moves in any direction; None for a condition of squeezing alone.

        Args:
            r: e/c, shorter than 1.
            velocity: of the ball in its socket, less the mean rotation of both [m/s].
        """
        return None

    def requirements(self) -> list[Requirement]:
        """None: a boundary condition has no numbers."""
        return []


class Guembel(AbstractFilmBoundary):
    """Positive pressure only; the half that would be under tension cavitates and is at rest.

    Closing, the near half carries: B(eps). Separating, the far half does: B(-eps), which is weak.

    Limits: 2/3 at eps = 0 for either direction. The factor jumps as the rate changes sign; the force,
    proportional to the rate, does not.

    Source: re-derived from Reynolds' equation; the closing branch is Rodrigues da Silva et al. (2022), Eq.
    37, the separating one replaces it.
    """

    bears_suction: ClassVar[bool | None] = False

    def load_factor(self, eccentricity_ratio: Number, separating: Flag) -> Scalar:
        """B(eps) while closing, B(-eps) while separating."""
        return squeeze_factor(jnp.where(separating, -eccentricity_ratio, eccentricity_ratio))

    def swept_load(self, r: Vector3, velocity: Vector3) -> Vector3:
        """`half_sphere_load`."""
        return half_sphere_load(r, velocity)


class PinkusSternlicht(AbstractFilmBoundary):
    """The printed formula for both directions: suction as strong as squeeze, B(eps).

    Limits: 2/3 at eps = 0; for a separating ball 1/(1 - eps), which no lubricant sustains.

    Source: Rodrigues da Silva et al. (2022), Eq. 37, read literally.
    """

    def load_factor(self, eccentricity_ratio: Number, separating: Flag) -> Scalar:
        """B(eps)."""
        return squeeze_factor(eccentricity_ratio)


class Sommerfeld(AbstractFilmBoundary):
    """Both halves carry, one by pressure, one by suction: B(eps) + B(-eps).

    Limits: 4/3 at eps = 0 with derivative 0; smooth in the rate.

    Source: the full-domain condition named in Rodrigues da Silva et al. (2022), Sect. 4.3; re-derived.
    """

    bears_suction: ClassVar[bool | None] = True

    def load_factor(self, eccentricity_ratio: Number, separating: Flag) -> Scalar:
        """B(eps) + B(-eps)."""
        return squeeze_factor(eccentricity_ratio) + squeeze_factor(-eccentricity_ratio)

    def swept_load(self, r: Vector3, velocity: Vector3) -> Vector3:
        """`full_sphere_load`."""
        return full_sphere_load(r, velocity)


def film_force(
    e: Vector3,
    e_rate: Vector3,
    clearance: Number,
    socket_radius: Number,
    viscosity: Number,
    boundary: AbstractFilmBoundary,
    transition_offset: Number,
) -> Vector3:
    """Force of the squeeze film on the ball [N], along the line of centers and against the motion.

        f = -C load_factor(eps, e.e_rate < 0) P e_rate,    eps = |e|/(c + e_h1)

    Args:
        e: eccentricity, socket center to ball center [m].
        e_rate: its rate [m/s].
        clearance: c [m].
        socket_radius: R [m].
        viscosity: nu [Pa s].
        boundary: which parts of the film carry pressure.
        transition_offset: e_h1 [m], zero for a film that is never replaced by contact.

    Limits: at e = 0 the force is -C load_factor(0) e_rate in every direction, its derivative by e is taken
    as 0. For eps beyond `MAXIMUM_ECCENTRICITY_RATIO` the load factor is constant: finite, with derivative
    0; contact has the full weight there.

    Source: Rodrigues da Silva et al. (2022), Eqs. 37 and 40; the c in C stays c.
    """
    ratio = safe_norm(e) / (clearance + transition_offset)
    eps = jnp.where(ratio < MAXIMUM_ECCENTRICITY_RATIO, ratio, MAXIMUM_ECCENTRICITY_RATIO)
    load = squeeze_coefficient(viscosity, socket_radius, clearance) * boundary.load_factor(eps, e @ e_rate < 0)
    return -load * radial_projection(e, e_rate)


def hybrid_weight(eccentricity: Number, clearance: Number, transition_width: Number) -> Scalar:
    """Share of dry contact in the blend of film and contact [-]; the film's share is one minus it.

        w = 0 for |e| <= c,    (|e| - c)/e_h0 between,    1 for |e| >= c + e_h0

    Args:
        eccentricity: |e| [m].
        clearance: c [m].
        transition_width: e_h0 [m]; zero makes w a step.

    Limits: continuous with kinks at both ends, where the derivative is taken as 0. For e_h0 = 0: 0 up to
    and at |e| = c, 1 beyond, derivative 0.

    Source: Rodrigues da Silva et al. (2022), Eq. 39, after Flores et al.
    """
    depth = eccentricity - clearance
    width = jnp.where(transition_width > 0, transition_width, 1.0)
    return jnp.where(depth <= 0, 0.0, jnp.where(depth >= transition_width, 1.0, depth / width))

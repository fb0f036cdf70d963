"""How hard conformal surfaces press back: a ball that nearly fills its socket.

Hertz's law with the stiffness of Eq. 24 takes the surfaces as paraboloids and is good while the penetration is small
against the clearance. Beyond a tenth of it the contact reaches round the ball, and how the load grows depends on the
clearance itself.
"""

import abc
from typing import Annotated, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import numeric, positive
from spherejax.foundations.numerics import horner
from spherejax.foundations.types import Number, Scalar, Unit
from spherejax.physics.laws.base import AbstractLaw

LARGEST_HERTZIAN_RATIO = 0.1
"""Penetration over clearance up to which Eq. 24 is used without a word: there it is 3 % too stiff, at 1 a quarter, by
`SphericalProfile`."""

_SLIM = 0.3
"""Contact radius over sphere radius below which the closed form of the load has lost more than a digit."""

_SLIM_SERIES = tuple(4.0 * k / (4.0 * k * k - 1.0) for k in range(1, 16))
"""Of (1 + x^2) artanh x - x, in odd powers of x from the third; at x = 0.3 fifteen terms leave 1e-17 of it."""

_NEWTON_STEPS = 6
"""For clearances up to half the radius and penetrations up to a hundred clearances six steps reach rounding."""

_DEEPEST = 300.0
"""2 delta/R_j at which exp overflows nearly; a trial step of the integrator may come there, no ball does."""

_NODES, _WEIGHTS = (tuple(map(float, row)) for row in np.polynomial.legendre.leggauss(24))


class Pair(NamedTuple):
    """What the surfaces of one joint give to its elastic law.

    Attributes:
        clearance: c = R_i - R_j [m].
        socket_radius: R_i [m].
        compliance: sigma_i + sigma_j, the sum of (1 - nu^2)/E of both materials [1/Pa].
    """

    clearance: Number
    socket_radius: Number
    compliance: Number


class AbstractConformity(AbstractLaw):
    """The elastic force of a ball in a socket that nearly fits it, in place of Hertz's K delta^1.5.

    Attributes:
        is_line_contact: whether it is that of a journal in a bearing.
        stiffens_from_zero: whether the slope of the force by the penetration is zero at a penetration of zero, and
            grows at least like its root: derivatives of runs then need no care where contact ends.
    """

    never_adds_energy: ClassVar[bool] = True
    is_line_contact: ClassVar[bool] = False
    stiffens_from_zero: ClassVar[bool] = False

    @property
    def largest_ratio(self) -> float | None:
        """delta/c up to which the law holds; a run that goes beyond says so. None for any."""
        return None

    @abc.abstractmethod
    def force(self, penetration: Number, pair: Pair) -> Scalar:
        """The force that presses the surfaces apart, never negative [N].

        Args:
            penetration: delta = |e| - c [m]; 0 for delta <= 0.
            pair: the surfaces.
        """

    @abc.abstractmethod
    def energy(self, penetration: Number, pair: Pair) -> Scalar:
        """Its integral over the penetration [J]."""


class PressedPair(NamedTuple):
    """An elastic law with the surfaces of one joint; it stands where a stiffness does.

    Attributes:
        law: the elastic law.
        pair: the surfaces.
    """

    law: AbstractConformity
    pair: Pair

    def force(self, penetration: Number) -> Scalar:
        """The elastic force [N]."""
        return self.law.force(penetration, self.pair)

    def energy(self, penetration: Number) -> Scalar:
        """The stored energy [J]."""
        return self.law.energy(penetration, self.pair)

    def depth(self, load: Number) -> Scalar:
        """The penetration under a load [m], by Newton's method on logarithms: nearly straight, so ten steps do."""

        def logarithm(x):
            return jnp.log(self.force(jnp.exp(x)))

        x = jnp.log(0.1 * self.pair.clearance)
        for _ in range(10):
            value, slope = jax.jvp(logarithm, (x,), (jnp.ones_like(x),))
            x = x - (value - jnp.log(load)) / slope
        return jnp.exp(x)


class WinklerLiner(AbstractConformity):
    """A thin elastic liner in a rigid socket: each point presses by its own thickness (Winkler's foundation).

        f = (pi k_w R^2/3) delta^2 (3 c + 2 delta)/(c + delta)^2,    k_w = E (1 - nu)/((1 + nu)(1 - 2 nu) t)

    with the interpenetration e.u - c of each surface point u. It holds at any conformity, for a liner that is thin
    against the contact; the plastic cups of joints and artificial hips are meant.

    Attributes:
        youngs_modulus: E of the liner [Pa].
        poissons_ratio: nu of the liner [-].
        thickness: t of the liner [m].

    Limits: f -> pi k_w R^2 delta^2/c for delta << c, and 2 pi k_w R^2 delta/3 for delta >> c. As nu -> 1/2 a
        confined layer cannot be pressed: its stiffness has no bound.

    Source: Bartel et al. (1985), J. Biomech. Eng. 107:193-199, for k_w; Blankevoort et al. (1991), J. Biomech.
    24:1019-1031. The force and its integral follow by integration over the sphere.
    """

    youngs_modulus: Annotated[Number, Unit("Pa")]
    poissons_ratio: Annotated[Number, Unit("1")]
    thickness: Annotated[Number, Unit("m")]
    stiffens_from_zero: ClassVar[bool] = True

    def foundation(self) -> Number:
        """k_w [Pa/m]."""
        nu = self.poissons_ratio
        return self.youngs_modulus * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu) * self.thickness)

    def force(self, penetration: Number, pair: Pair) -> Scalar:
        """f [N]. Limits: value and derivative 0 for delta <= 0."""
        depth, c = jnp.maximum(penetration, 0.0), pair.clearance
        area = jnp.pi * self.foundation() * pair.socket_radius**2 / 3.0
        return area * depth**2 * (3.0 * c + 2.0 * depth) / (c + depth) ** 2

    def energy(self, penetration: Number, pair: Pair) -> Scalar:
        """(pi k_w R^2/3) delta^3/(c + delta) [J], the integral of f."""
        depth = jnp.maximum(penetration, 0.0)
        area = jnp.pi * self.foundation() * pair.socket_radius**2 / 3.0
        return area * depth**3 / (pair.clearance + depth)

    def requirements(self) -> list[Requirement]:
        """A compressible, isotropic liner."""
        nu = numeric(self.poissons_ratio)
        return [
            positive("youngs_modulus", self.youngs_modulus, "Pa"),
            positive("thickness", self.thickness, "m"),
            Requirement(
                "poissons_ratio",
                self.poissons_ratio,
                (nu > -1.0) & (nu < 0.5),
                "lie in (-1, 0.5)",
                "A confined layer of an incompressible material has no finite stiffness; polyethylene has about 0.46.",
            ),
        ]


class SphericalProfile(AbstractConformity):
    """Two elastic bodies with the profile of spheres, as half-spaces: Hertz's law without his paraboloids.

        delta = a (L_j - L_i)/2,    L_k = ln((R_k + a)/(R_k - a))
        f = [(a^2 + R_j^2) L_j/2 - (a^2 + R_i^2) L_i/2 - a (R_j - R_i)]/(sigma_i + sigma_j)

    with the contact radius a as parameter. With w = a^2/(R_j^2 - a^2) the first line is nearly c w, and Newton's method
    finds w from (R_i/2c) (exp(2 delta/R_j) - 1), which is right for the slightest and for the deepest penetration.

    Limits: tends to Eq. 24 as delta/c -> 0. Bodies count as half-spaces although the contact reaches round the ball:
        beyond delta = c, where a is 0.7 R, that is rough. Steel, R 10 mm, c 0.1 mm under 20 kN: 27.3 um, by Eq. 24
        26.0 um.

    Source: Sneddon (1965), Int. J. Eng. Sci. 3:47-57, for the punch with the difference of both profiles.
    """

    stiffens_from_zero: ClassVar[bool] = True

    def contact_radius(self, penetration: Number, pair: Pair) -> Scalar:
        """a [m]. Limits: sqrt(R_i R_j delta/c) for small delta, below R_j for any; 0 for delta <= 0."""
        is_pressed = penetration > 0
        rim = self._rim(jnp.where(is_pressed, penetration, pair.clearance), pair)
        return jnp.where(is_pressed, rim.radius, 0.0)

    def force(self, penetration: Number, pair: Pair) -> Scalar:
        """f [N]. Limits: value and derivative 0 for delta <= 0."""
        is_pressed = penetration > 0
        rim = self._rim(jnp.where(is_pressed, penetration, pair.clearance), pair)
        return jnp.where(is_pressed, _load(rim, pair), 0.0)

    def energy(self, penetration: Number, pair: Pair) -> Scalar:
        """The integral of f [J], by 24 Gauss points in artanh(a/R_j), in which f d(delta) has no singularity.

        Limits: value and derivative 0 for delta <= 0.
        """
        is_pressed = penetration > 0
        inner = pair.socket_radius - pair.clearance
        rim = self._rim(jnp.where(is_pressed, penetration, pair.clearance), pair)
        half = 0.25 * jnp.log1p(2.0 * rim.radius / rim.gap)

        def power(node):
            angle = half * (1.0 + node)
            ratio = jnp.tanh(angle)
            # d(a)/d(angle) = R_j (1 - a^2/R_j^2)
            at = _Rim(inner * ratio, inner * 2.0 / (jnp.expm1(2.0 * angle) + 2.0))
            return _load(at, pair) * _depth_slope(at, pair) * at.gap * (1.0 + ratio)

        total = half * sum(weight * power(node) for node, weight in zip(_NODES, _WEIGHTS, strict=True))
        return jnp.where(is_pressed, total, 0.0)

    def requirements(self) -> list[Requirement]:
        """None of its own."""
        return []

    def _rim(self, depth: Number, pair: Pair) -> "_Rim":
        """The edge of the contact of a positive penetration."""
        inner, outer = pair.socket_radius - pair.clearance, pair.socket_radius
        deep = jnp.minimum(2.0 * depth / inner, _DEEPEST)
        w = 0.5 * outer / pair.clearance * jnp.expm1(deep)
        for i in range(_NEWTON_STEPS):
            # The derivatives come from the last two steps: one gives the first, the other the second.
            w = jax.lax.stop_gradient(w) if i == _NEWTON_STEPS - 2 else w
            rim = _rim_of(w, inner)
            # a = R_j sqrt(q) with q = w/(1 + w), and dq/dw = 1/(1 + w)^2
            slope = _depth_slope(rim, pair) * inner**2 / (2.0 * rim.radius * (1.0 + w) ** 2)
            stepped = w - (_depth(rim, pair) - 0.5 * deep * inner) / slope
            w = jnp.where(stepped > 0.0, stepped, 0.5 * w)
        return _rim_of(w, inner)


class _Rim(NamedTuple):
    """The edge of a contact: its radius a, and R_j - a without cancellation [m]."""

    radius: Scalar
    gap: Scalar


def _rim_of(w: Number, inner: Number) -> _Rim:
    root = jnp.sqrt(w / (1.0 + w))
    return _Rim(inner * root, inner / ((1.0 + w) * (1.0 + root)))


def _depth(rim: _Rim, pair: Pair) -> Scalar:
    """delta [m], with both logarithms as one: their difference is of the order of c/R."""
    a, c = rim.radius, pair.clearance
    return 0.5 * a * jnp.log1p(2.0 * a * c / (rim.gap * (pair.socket_radius + a)))


def _depth_slope(rim: _Rim, pair: Pair) -> Scalar:
    """d(delta)/da: d(L_k)/da = 2 R_k/(R_k^2 - a^2), the difference on one denominator."""
    a, c, outer = rim.radius, pair.clearance, pair.socket_radius
    inner = outer - c
    span = jnp.log1p(2.0 * a * c / (rim.gap * (outer + a)))
    bend = 2.0 * c * (inner * outer + a * a) / (rim.gap * (inner + a) * (rim.gap + c) * (outer + a))
    return 0.5 * (span + a * bend)


def _load(rim: _Rim, pair: Pair) -> Scalar:
    """f [N]."""
    a, outer = rim.radius, pair.socket_radius
    inner = outer - pair.clearance
    outside = rim.gap + pair.clearance
    return (inner**2 * _bulge(a / inner, rim.gap / inner) - outer**2 * _bulge(a / outer, outside / outer)) / (
        pair.compliance
    )


def _bulge(x: Number, complement: Number) -> Scalar:
    """(1 + x^2) artanh x - x with the complement 1 - x. Limits: 4 x^3/3 for small x, by its series where the difference
    would lose digits."""
    is_slim = x < _SLIM
    near, far = jnp.where(is_slim, x, 0.0), jnp.where(is_slim, _SLIM, x)
    rest = jnp.where(is_slim, 1.0 - _SLIM, complement)
    series = near**3 * horner(_SLIM_SERIES, near * near)
    return jnp.where(is_slim, series, (1.0 + far * far) * 0.5 * jnp.log1p(2.0 * far / rest) - far)

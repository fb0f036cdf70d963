"""Friction laws: the tangential force of a contact, against the sliding velocity.

The static laws of the paper state a magnitude mu(|v_t|) f_n along -v_t/|v_t|, and that direction does not
exist at zero sliding. All of them, except Coulomb's, have a magnitude that vanishes there at least
linearly. So a law is written once as its *secant*, mu(v)/v, a finite function with which no direction has
to be formed:

    f_t = -f_n secant(|v_t|) v_t

LuGre's law adds a memory, the mean deflection of the bristles between the surfaces.
"""

import abc
from typing import Annotated, Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import above, at_least, non_negative, numeric, positive
from spherejax.foundations.numerics import safe_norm, tanhc
from spherejax.foundations.types import Number, Scalar, Unit, Vector3
from spherejax.physics.laws.base import AbstractLaw

_PASSIVITY_SPEEDS = np.linspace(0.02, 4.0, 200)
"""Speeds in units of v_s at which passivity is looked at: the bristle damping has faded to 1e-7 beyond. The margin is
smooth, and its minimum between two speeds is some 1e-4 of the largest term lower than at them."""


class AbstractFrictionLaw(AbstractLaw):
    """The force that opposes sliding.

    Attributes:
        bristle_size: how many numbers the law remembers: 0 for a static law, which gives `traction`; 3 for
            a law that gives `bristle_rate` and `bristle_traction`.
        simulable: whether the law is defined at zero sliding.
    """

    bristle_size: eqx.AbstractClassVar[int]
    simulable: eqx.AbstractClassVar[bool]

    @abc.abstractmethod
    def coefficient(self, speed: Number) -> Scalar:
        """Friction coefficient in steady sliding [-].

        Args:
            speed: sliding speed |v_t| [m/s], not negative.
        """

    @property
    def sliding_coefficient(self) -> Number | None:
        """Coefficient of fast dry sliding [-], which measures a preload; None where the law has no such number."""
        return None

    def bristle_energy(self, bristle: Vector3, normal_force: Number) -> Scalar:
        """Energy stored in the bristles [J]; zero unless the law says otherwise."""
        del bristle, normal_force
        return jnp.zeros(())


class AbstractStaticFriction(AbstractFrictionLaw):
    """Friction as a function of the sliding velocity alone; a subclass gives `secant` and `requirements`."""

    bristle_size: ClassVar[int] = 0

    @abc.abstractmethod
    def secant(self, speed: Number) -> Scalar:
        """Friction coefficient divided by the sliding speed [s/m], finite at zero speed.

        Args:
            speed: sliding speed |v_t| [m/s], not negative.
        """

    def coefficient(self, speed: Number) -> Scalar:
        """secant(speed) speed [-]."""
        return self.secant(speed) * speed

    def traction(self, sliding_velocity: Vector3, normal_force: Number) -> Vector3:
        """Friction force on the surface that slides with `sliding_velocity` against the other [N].

            f_t = -f_n secant(|v_t|) v_t

        Args:
            sliding_velocity: v_t, tangential [m/s].
            normal_force: f_n [N], not negative.

        Limits: at v_t = 0 the value is 0 and the derivative by v_t is -f_n secant(0) I, the true one.
        """
        return -(normal_force * self.secant(safe_norm(sliding_velocity))) * sliding_velocity


class Coulomb(AbstractStaticFriction):
    """Constant friction; a reference curve for plots, undefined at zero sliding and therefore not simulated.

    Attributes:
        mu: friction coefficient [-].

    Source: Rodrigues da Silva et al. (2022), Eqs. 30 and 31.
    """

    never_adds_energy: ClassVar[bool] = True

    mu: Annotated[Number, Unit("1")] = 0.1
    simulable: ClassVar[bool] = False

    def secant(self, speed: Number) -> Scalar:
        """mu/v [s/m].

        Limits: unbounded as v -> 0; the value 0 is returned at v = 0.
        """
        sliding = speed > 0
        return jnp.where(sliding, self.mu / jnp.where(sliding, speed, 1.0), 0.0)

    def requirements(self) -> list[Requirement]:
        """Never satisfied: a joint needs a friction that is defined at zero sliding."""
        return [
            Requirement(
                "friction",
                self,
                self.simulable,
                "be a law whose force vanishes with the sliding velocity: Coulomb's jumps at zero sliding, where no "
                "integration can follow it, and serves as a curve for plots only",
                "Take friction=Threlfall(mu=..., v1=1e-3), which is Coulomb's law beyond twice the threshold velocity "
                "v1 [m/s], or BengisuAkay, Ambrosio, BrownMcPhee or LuGre.",
            )
        ]


class Threlfall(AbstractStaticFriction):
    """Coulomb's law smoothed by a hyperbolic tangent, mu tanh(v/v1).

    Attributes:
        mu: kinetic friction coefficient [-].
        v1: threshold velocity [m/s]; three quarters of the friction act there.

    Limits: slope mu/v1 at v = 0; smooth everywhere.

    Source: Rodrigues da Silva et al. (2022), Eq. 32, after Threlfall (1978), whose own function is an
    exponential. Defaults: Table 3.
    """

    never_adds_energy: ClassVar[bool] = True

    mu: Annotated[Number, Unit("1")] = 0.1
    v1: Annotated[Number, Unit("m/s")] = 1e-3
    simulable: ClassVar[bool] = True

    @property
    def sliding_coefficient(self) -> Number:
        """mu."""
        return self.mu

    def secant(self, speed: Number) -> Scalar:
        """(mu/v1) tanh(v/v1)/(v/v1) [s/m]; mu/v1 at v = 0."""
        return self.mu / self.v1 * tanhc(speed / self.v1)

    def requirements(self) -> list[Requirement]:
        """mu >= 0, v1 > 0."""
        return [non_negative("mu", self.mu, "-"), positive("v1", self.v1, "m/s")]


class BengisuAkay(AbstractStaticFriction):
    """A parabola up to the static friction at v0, then an exponential fall to the kinetic one.

    Attributes:
        mu_kinetic: friction coefficient at high speed [-].
        mu_static: largest friction coefficient, reached at v0 [-].
        v0: threshold velocity [m/s].
        kappa: rate of the fall [s/m].

    Limits: slope 2 mu_static/v0 at v = 0. At v0 the value is continuous and the slope jumps from 0 to
    -kappa (mu_static - mu_kinetic); the derivative taken there is the right one.

    Source: Bengisu and Akay (1994) as in Rodrigues da Silva et al. (2022), Eq. 33. Defaults: Table 3.
    """

    never_adds_energy: ClassVar[bool] = True

    mu_kinetic: Annotated[Number, Unit("1")] = 0.1
    mu_static: Annotated[Number, Unit("1")] = 0.15
    v0: Annotated[Number, Unit("m/s")] = 1e-4
    kappa: Annotated[Number, Unit("s/m")] = 1000.0
    simulable: ClassVar[bool] = True

    @property
    def sliding_coefficient(self) -> Number:
        """mu_kinetic."""
        return self.mu_kinetic

    def secant(self, speed: Number) -> Scalar:
        """mu(v)/v [s/m]; 2 mu_static/v0 at v = 0."""
        rising = speed < self.v0
        # Below v0 the exponent is positive, and for a large kappa v0 the branch not taken would overflow.
        v = jnp.where(rising, self.v0, speed)
        parabola = self.mu_static * (2.0 - speed / self.v0) / self.v0
        fall = self.mu_kinetic + (self.mu_static - self.mu_kinetic) * jnp.exp(-self.kappa * (v - self.v0))
        return jnp.where(rising, parabola, fall / v)

    def requirements(self) -> list[Requirement]:
        """mu_static >= mu_kinetic >= 0, v0 > 0, kappa > 0."""
        return [
            non_negative("mu_kinetic", self.mu_kinetic, "-"),
            at_least("mu_static", self.mu_static, "mu_kinetic", self.mu_kinetic),
            positive("v0", self.v0, "m/s"),
            positive("kappa", self.kappa, "s/m"),
        ]


class Ambrosio(AbstractStaticFriction):
    """Coulomb's law with a dead zone up to v0 and a ramp from v0 to v1.

    Attributes:
        mu: kinetic friction coefficient [-].
        v0: velocity below which there is no friction [m/s].
        v1: velocity from which the full friction acts [m/s].

    Limits: value and slope 0 for v <= v0. The slope jumps at v0 and v1; the derivative taken there is that of
    the dead zone at v0, and that of the constant at v1.

    Source: Ambrosio (2003) as in Rodrigues da Silva et al. (2022), Eq. 35. Defaults: Table 3.
    """

    never_adds_energy: ClassVar[bool] = True

    mu: Annotated[Number, Unit("1")] = 0.1
    v0: Annotated[Number, Unit("m/s")] = 1e-4
    v1: Annotated[Number, Unit("m/s")] = 1e-3
    simulable: ClassVar[bool] = True

    @property
    def sliding_coefficient(self) -> Number:
        """mu."""
        return self.mu

    def secant(self, speed: Number) -> Scalar:
        """mu(v)/v [s/m]; 0 at v = 0."""
        sliding = speed > self.v0
        v = jnp.where(sliding, speed, self.v1)
        ramp = jnp.where(speed < self.v1, (v - self.v0) / (self.v1 - self.v0), 1.0)
        return jnp.where(sliding, self.mu * ramp / v, 0.0)

    def requirements(self) -> list[Requirement]:
        """mu >= 0, v1 > v0 > 0."""
        return [
            non_negative("mu", self.mu, "-"),
            positive("v0", self.v0, "m/s"),
            above("v1", self.v1, "v0", self.v0),
        ]


class BrownMcPhee(AbstractStaticFriction):
    """A smooth law with the Stribeck effect, without the viscous term.

        mu(v) = mu_k tanh(4 x) + (mu_s - mu_k) x/(x**2/4 + 3/4)**2,    x = v/v_s

    Attributes:
        mu_kinetic: friction coefficient at high speed [-].
        mu_static: static friction coefficient [-].
        stribeck_velocity: v_s [m/s]; the second term is largest there, mu_s - mu_k.

    Limits: slope (4 mu_k + 16/9 (mu_s - mu_k))/v_s at v = 0; smooth everywhere.

    Source: Brown and McPhee (2016) as in Rodrigues da Silva et al. (2022), Eq. 36. Defaults: Table 3.
    """

    never_adds_energy: ClassVar[bool] = True

    mu_kinetic: Annotated[Number, Unit("1")] = 0.1
    mu_static: Annotated[Number, Unit("1")] = 0.15
    stribeck_velocity: Annotated[Number, Unit("m/s")] = 1e-3
    simulable: ClassVar[bool] = True

    @property
    def sliding_coefficient(self) -> Number:
        """mu_kinetic."""
        return self.mu_kinetic

    def secant(self, speed: Number) -> Scalar:
        """mu(v)/v [s/m]; (4 mu_k + 16/9 (mu_s - mu_k))/v_s at v = 0."""
        x = speed / self.stribeck_velocity
        shape = 0.25 * x * x + 0.75
        stribeck = (self.mu_static - self.mu_kinetic) / (shape * shape)
        return (4.0 * self.mu_kinetic * tanhc(4.0 * x) + stribeck) / self.stribeck_velocity

    def requirements(self) -> list[Requirement]:
        """mu_static >= mu_kinetic >= 0, stribeck_velocity > 0."""
        return [
            non_negative("mu_kinetic", self.mu_kinetic, "-"),
            at_least("mu_static", self.mu_static, "mu_kinetic", self.mu_kinetic),
            positive("stribeck_velocity", self.stribeck_velocity, "m/s"),
        ]


class LuGre(AbstractFrictionLaw):
    """Friction with memory: presliding, stiction, hysteresis and the Stribeck effect from one bristle
    deflection z.

        z_rate = v_t - sigma_0 |v_t|/g(|v_t|) z
        f_t = -f_n (sigma_0 z + sigma_1(|v_t|) z_rate + sigma_2 v_t)
        g(v) = mu_k + (mu_s - mu_k) exp(-(v/v_s)**2),    sigma_1(v) = sigma_1 exp(-(v/v_s)**2)

    Everything is per newton of normal force, so z is a length and the bristles are as stiff as the contact
    is pressed. The bristle damping fades with the sliding speed: with a constant one the law can feed
    energy into the joint, and a bristle at rest that is struck by an onset at speed v would pull with
    sigma_1 v, many times the normal force.

    Attributes:
        mu_kinetic: friction coefficient at high speed [-].
        mu_static: friction coefficient as sliding begins [-].
        stribeck_velocity: v_s [m/s].
        bristle_stiffness: sigma_0 [1/m]; a contact yields by mu/sigma_0 before it slips (1 um by default).
        bristle_damping: sigma_1 [s/m] at rest.
        viscous: sigma_2 [s/m].

    Limits: at v_t = 0, z_rate = 0 and its derivative by v_t is taken as I, the mean of the one-sided ones,
    I -+ (sigma_0/mu_s) z t^T. In steady sliding |f_t| = f_n (g(v) + sigma_2 v).

    Passivity: the bristles store f_n sigma_0 |z|^2/2 (`bristle_energy`). Under a constant normal force friction
    takes more than they store, for every sliding motion, if

        sigma_1(v) v <= 4 g(v)    or    sigma_1(v) v <= mu_s^2/(mu_s - g(v))  where 2 g(v) > mu_s,

    at every v: bristles that began undeflected never exceed sigma_0 |z| = mu_s, and the bounds are those of such
    states, derived here and tested by search. They hold for sigma_1 v_s <= 9 mu_k, for mu_s = mu_k always,
    and with viscous friction for somewhat more. A law beyond it feeds energy into the joint and is refused
    (`passivity_margin`). A normal force that *rises* by F while the bristles are deflected stiffens them, and
    so feeds in at most F mu_s^2/(2 sigma_0), whatever sigma_1: for the defaults 0.11 um times the force, a few percent
    of the energy of an impact in metal, and more for softer bristles. That belongs to every law whose bristles are
    as stiff as the contact is pressed.

    Source: Canudas de Wit et al. (1995), IEEE Trans. Autom. Control 40:419-425, the vector form by components;
    for bounds of any state, with a constant sigma_1, see Barabanov and Ortega (2000), IEEE Trans. Autom. Control
    45:830-832. The defaults for sigma_0 = 1e5 and sigma_1 = sqrt(1e5) are its numbers for a
    unit mass, read per newton of normal force; the friction coefficients and v_s are those of Table 3 of
    Rodrigues da Silva et al. (2022).
    """

    # A rising normal force stiffens deflected bristles and so adds energy; see above.
    never_adds_energy: ClassVar[bool] = False

    mu_kinetic: Annotated[Number, Unit("1")] = 0.1
    mu_static: Annotated[Number, Unit("1")] = 0.15
    stribeck_velocity: Annotated[Number, Unit("m/s")] = 1e-3
    bristle_stiffness: Annotated[Number, Unit("1/m")] = 1e5
    bristle_damping: Annotated[Number, Unit("s/m")] = 316.0
    viscous: Annotated[Number, Unit("s/m")] = 0.0
    bristle_size: ClassVar[int] = 3
    simulable: ClassVar[bool] = True

    @property
    def sliding_coefficient(self) -> Number:
        """mu_kinetic."""
        return self.mu_kinetic

    def bristle_rate(self, bristle: Vector3, sliding_velocity: Vector3) -> Vector3:
        """z_rate = v_t - sigma_0 |v_t|/g(|v_t|) z [m/s].

        Args:
            bristle: z, mean deflection of the bristles [m].
            sliding_velocity: v_t [m/s].
        """
        speed = safe_norm(sliding_velocity)
        return sliding_velocity - (self.bristle_stiffness * speed / self._stribeck_curve(speed)) * bristle

    def bristle_traction(self, bristle: Vector3, sliding_velocity: Vector3, normal_force: Number) -> Vector3:
        """Friction force on the surface that slides with `sliding_velocity` against the other [N].

        Args:
            bristle: z [m].
            sliding_velocity: v_t [m/s].
            normal_force: f_n [N], not negative.
        """
        damping = self.bristle_damping * self._fading(safe_norm(sliding_velocity))
        return -normal_force * (
            self.bristle_stiffness * bristle
            + damping * self.bristle_rate(bristle, sliding_velocity)
            + self.viscous * sliding_velocity
        )

    def bristle_energy(self, bristle: Vector3, normal_force: Number) -> Scalar:
        """Energy stored in the bristles, f_n sigma_0 |z|^2/2 [J]."""
        return 0.5 * normal_force * self.bristle_stiffness * (bristle @ bristle)

    def passivity_margin(self) -> Scalar:
        """Smallest power that friction dissipates, over all speeds and deflections, per f_n |v_t| [-].

            min over v, s of   g s^2 - sigma_1(v) v (s - 1) + sigma_2 v,    s = sigma_0 z/g(v) in [0, mu_s/g(v)]

        Negative for a law that feeds energy in. The minimum over s is exact, that over v is taken at
        `_PASSIVITY_SPEEDS`.
        """
        values = (self.mu_kinetic, self.mu_static, self.stribeck_velocity, self.bristle_damping, self.viscous)
        mu_k, mu_s, v_s, damping, viscous = (numeric(value) for value in values)
        xp: Any = np if all(isinstance(x, np.ndarray) for x in (mu_k, mu_s, v_s, damping, viscous)) else jnp
        fading = np.exp(-(_PASSIVITY_SPEEDS**2))
        g = mu_k + (mu_s - mu_k) * fading
        pull = damping * fading * v_s * _PASSIVITY_SPEEDS
        with np.errstate(all="ignore"):  # an illegal number is reported by the other requirements
            s = xp.minimum(pull / (2.0 * g), mu_s / g)
            return xp.min(g * s * s - pull * (s - 1.0) + viscous * v_s * _PASSIVITY_SPEEDS)

    def coefficient(self, speed: Number) -> Scalar:
        """g(v) + sigma_2 v for v > 0 [-]; 0 at rest, where any |z| <= mu_s/sigma_0 is an equilibrium."""
        return jnp.where(speed > 0, self._stribeck_curve(speed) + self.viscous * speed, 0.0)

    def _fading(self, speed: Number) -> Scalar:
        x = speed / self.stribeck_velocity
        return jnp.exp(-x * x)

    def _stribeck_curve(self, speed: Number) -> Scalar:
        return self.mu_kinetic + (self.mu_static - self.mu_kinetic) * self._fading(speed)

    def requirements(self) -> list[Requirement]:
        """mu_static >= mu_kinetic > 0 (g divides), v_s > 0, sigma_0 > 0, sigma_1 >= 0 and passive, sigma_2 >= 0."""
        return [
            positive("mu_kinetic", self.mu_kinetic, "-"),
            at_least("mu_static", self.mu_static, "mu_kinetic", self.mu_kinetic),
            positive("stribeck_velocity", self.stribeck_velocity, "m/s"),
            positive("bristle_stiffness", self.bristle_stiffness, "1/m"),
            non_negative("bristle_damping", self.bristle_damping, "s/m"),
            non_negative("viscous", self.viscous, "s/m"),
            Requirement(
                "bristle_damping",
                self.bristle_damping,
                self.passivity_margin() >= 0,
                "be so small that friction never feeds energy into the joint",
                "Any bristle_damping up to 9 mu_kinetic/stribeck_velocity is passive; see the docstring of LuGre.",
            ),
        ]

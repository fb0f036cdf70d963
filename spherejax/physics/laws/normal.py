"""Normal contact laws: Hertz's elastic force, alone or with hysteresis damping.

    f_n = K delta**n (1 + chi delta_rate/delta_rate_onset)

The laws differ in the hysteresis factor chi alone, a function of the restitution. The rate at the onset of
the contact is a memory of the joint, not a function of its state; a law says with `remembers_onset` that it
needs it.
"""

import abc
from typing import Annotated, ClassVar

import equinox as eqx
import jax.numpy as jnp

from spherejax.foundations.checks import Requirement
from spherejax.foundations.numerics import positive_power
from spherejax.foundations.types import Number, Scalar, Unit
from spherejax.physics.laws.base import AbstractLaw, numeric, positive
from spherejax.physics.laws.impact import exact_hysteresis_factor

MINIMUM_ONSET_RATE = 1e-6
"""Smallest onset rate that the hysteresis term divides by [m/s].

A grazing onset has a rate of zero, and the quotient none. One micrometer per second is far below any impact
that matters (a ball dropped by 1e-13 m reaches it); slower onsets are damped as if they had this rate.
"""


class AbstractNormalLaw(AbstractLaw):
    """The force that presses ball and socket apart, as a function of how far and how fast they
    interpenetrate.

    To write a law of your own, subclass `AbstractHysteresisLaw` and give `hysteresis_factor`, or
    subclass this and give `force` and `requirements`.

    Attributes:
        remembers_onset: whether `force` uses the onset rate.
        stiffness: K [N/m**n]; `None` takes it from the joint's radii and materials (Eq. 24).
        exponent: n [-], 1.5 for spheres (Hertz).
    """

    remembers_onset: eqx.AbstractClassVar[bool]
    stiffness: eqx.AbstractVar[Number | None]
    exponent: eqx.AbstractVar[Number]

    @abc.abstractmethod
    def force(self, penetration: Number, penetration_rate: Number, onset_rate: Number, stiffness: Number) -> Scalar:
        """Magnitude of the contact force, never negative [N].

        Args:
            penetration: delta = |e| - c [m]; zero or below without contact.
            penetration_rate: its rate [m/s], positive while the ball presses in.
            onset_rate: the penetration rate at the onset of this contact [m/s].
            stiffness: K [N/m**n].
        """

    def elastic_force(self, penetration: Number, stiffness: Number) -> Scalar:
        """The conservative part, K delta**n [N].

        Limits: value and derivative 0 for delta <= 0.

        Source: Rodrigues da Silva et al. (2022), Eq. 23.
        """
        return stiffness * positive_power(penetration, self.exponent)

    def elastic_energy(self, penetration: Number, stiffness: Number) -> Scalar:
        """Energy stored by the elastic part, K delta**(n+1)/(n+1) [J].

        Limits: value and derivative 0 for delta <= 0.
        """
        return stiffness * positive_power(penetration, self.exponent + 1.0) / (self.exponent + 1.0)

    def elastic_requirements(self) -> list[Requirement]:
        """What `stiffness` and `exponent` must satisfy."""
        n = numeric(self.exponent)
        requirements = [
            Requirement(
                "exponent",
                self.exponent,
                (n >= 1.0) & (n < jnp.inf),
                "be finite and at least 1",
                "Hertz's value for spheres is 1.5.",
            )
        ]
        if self.stiffness is not None:
            requirements.append(positive("stiffness", self.stiffness, "N/m**n"))
        return requirements


class AbstractHysteresisLaw(AbstractNormalLaw):
    """Hertz's force with a damping that is proportional to it, scaled by the onset rate of the contact.

    Attributes:
        restitution: c_r [-], in (0, 1].
    """

    restitution: eqx.AbstractVar[Number]
    remembers_onset: ClassVar[bool] = True
    never_adds_energy: ClassVar[bool] = True

    @abc.abstractmethod
    def hysteresis_factor(self) -> Number:
        """chi [-], not negative, a function of the restitution alone."""

    def force(self, penetration: Number, penetration_rate: Number, onset_rate: Number, stiffness: Number) -> Scalar:
        """f_n = max(0, K delta**n (1 + chi delta_rate/delta_rate_onset)) [N].

        A free impact never turns the bracket negative; a pair that is pulled apart does, and surfaces without
        adhesion then let go: the force is clipped at zero, with a derivative of zero on the clipped side.

        Limits: value and derivatives 0 for delta <= 0. A grazing onset counts as `MINIMUM_ONSET_RATE`, so
        value and derivatives stay finite at an onset rate of zero.
        """
        damping = 1.0 + self.hysteresis_factor() * penetration_rate / jnp.maximum(onset_rate, MINIMUM_ONSET_RATE)
        return self.elastic_force(penetration, stiffness) * jnp.where(damping > 0, damping, 0.0)

    def requirements(self) -> list[Requirement]:
        """Restitution in (0, 1]: at 0 the factor of most laws is infinite, and the others never realize
        it."""
        c_r = numeric(self.restitution)
        return [
            Requirement(
                "restitution",
                self.restitution,
                (c_r > 0) & (c_r <= 1),
                "lie in (0, 1]",
                "For a nearly plastic contact give a small positive number; 1 dissipates nothing.",
            ),
            *self.elastic_requirements(),
        ]


class Hertz(AbstractNormalLaw):
    """Purely elastic contact, f_n = K delta**n.

    Neither the rate nor the onset's enters the force.

    Attributes:
        stiffness: K [N/m**n], or `None` for Eq. 24.
        exponent: n [-].

    Source: Rodrigues da Silva et al. (2022), Eq. 23, after Hertz (1881).
    """

    stiffness: Annotated[Number | None, Unit("N/m^{exponent}")] = None
    exponent: Annotated[Number, Unit("1")] = 1.5
    remembers_onset: ClassVar[bool] = False
    never_adds_energy: ClassVar[bool] = True

    def hysteresis_factor(self) -> Number:
        """Zero: no hysteresis."""
        return 0.0

    def force(self, penetration: Number, penetration_rate: Number, onset_rate: Number, stiffness: Number) -> Scalar:
        """K delta**n [N]; both rates are ignored.

        Limits: value and derivative 0 for delta <= 0.
        """
        return self.elastic_force(penetration, stiffness)

    def requirements(self) -> list[Requirement]:
        """Stiffness and exponent alone."""
        return self.elastic_requirements()


class HuntCrossley(AbstractHysteresisLaw):
    """chi = 3 (1 - c_r)/2, for nearly elastic contacts.

    Attributes:
        restitution: c_r [-].
        stiffness: K [N/m**n], or `None` for Eq. 24.
        exponent: n [-].

    Limits: chi -> 3/2 as c_r -> 0, so no impact restores less than 0.488 of its speed.

    Source: Hunt and Crossley (1975) as in Rodrigues da Silva et al. (2022), Eq. 26.
    """

    restitution: Annotated[Number, Unit("1")]
    stiffness: Annotated[Number | None, Unit("N/m^{exponent}")] = None
    exponent: Annotated[Number, Unit("1")] = 1.5

    def hysteresis_factor(self) -> Number:
        """3 (1 - c_r)/2."""
        return 1.5 * (1.0 - self.restitution)


class LankaraniNikravesh(AbstractHysteresisLaw):
    """chi = 3 (1 - c_r**2)/4, for nearly elastic contacts.

    Attributes:
        restitution: c_r [-].
        stiffness: K [N/m**n], or `None` for Eq. 24.
        exponent: n [-].

    Limits: chi -> 3/4 as c_r -> 0; c_r = 0.1 realizes 0.665.

    Source: Lankarani and Nikravesh (1990) as in Rodrigues da Silva et al. (2022), Eq. 27.
    """

    restitution: Annotated[Number, Unit("1")]
    stiffness: Annotated[Number | None, Unit("N/m^{exponent}")] = None
    exponent: Annotated[Number, Unit("1")] = 1.5

    def hysteresis_factor(self) -> Number:
        """3 (1 - c_r**2)/4."""
        return 0.75 * (1.0 - self.restitution**2)


class Gonthier(AbstractHysteresisLaw):
    """chi = (1 - c_r**2)/c_r, for elastic to nearly plastic contacts.

    Attributes:
        restitution: c_r [-].
        stiffness: K [N/m**n], or `None` for Eq. 24.
        exponent: n [-].

    Limits: chi -> 1/c_r as c_r -> 0, which is exact there; 2 (1 - c_r) near 1, where 3 (1 - c_r)/2 would be.

    Source: Gonthier et al. (2004) as in Rodrigues da Silva et al. (2022), Eq. 28.
    """

    restitution: Annotated[Number, Unit("1")]
    stiffness: Annotated[Number | None, Unit("N/m^{exponent}")] = None
    exponent: Annotated[Number, Unit("1")] = 1.5

    def hysteresis_factor(self) -> Number:
        """(1 - c_r**2)/c_r."""
        return (1.0 - self.restitution**2) / self.restitution


class Flores(AbstractHysteresisLaw):
    """chi = 8 (1 - c_r)/(5 c_r), for hard and soft materials.

    Attributes:
        restitution: c_r [-].
        stiffness: K [N/m**n], or `None` for Eq. 24.
        exponent: n [-].

    Limits: chi -> 1.6/c_r as c_r -> 0; 1.6 (1 - c_r) near 1.

    Source: Flores et al. (2011) as in Rodrigues da Silva et al. (2022), Eq. 29.
    """

    restitution: Annotated[Number, Unit("1")]
    stiffness: Annotated[Number | None, Unit("N/m^{exponent}")] = None
    exponent: Annotated[Number, Unit("1")] = 1.5

    def hysteresis_factor(self) -> Number:
        """8 (1 - c_r)/(5 c_r)."""
        return 1.6 * (1.0 - self.restitution) / self.restitution


class ExactRestitution(AbstractHysteresisLaw):
    """The factor with which a free impact realizes exactly the prescribed restitution.

    The published factors are approximations and miss c_r; this one solves chi (1 + c_r) =
    ln[(1 + chi)/(1 - chi c_r)] to rounding, whatever mass, stiffness, exponent and speed.

    Attributes:
        restitution: c_r [-].
        stiffness: K [N/m**n], or `None` for Eq. 24.
        exponent: n [-].

    Limits: chi = 3 (1 - c_r)/2 + ... near 1 (Hunt-Crossley), 1/c_r as c_r -> 0 (Gonthier).

    Source: `exact_hysteresis_factor`.
    """

    restitution: Annotated[Number, Unit("1")]
    stiffness: Annotated[Number | None, Unit("N/m^{exponent}")] = None
    exponent: Annotated[Number, Unit("1")] = 1.5

    def hysteresis_factor(self) -> Scalar:
        """The root chi of the impact equation."""
        return exact_hysteresis_factor(self.restitution)

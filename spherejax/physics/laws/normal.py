"""Normal contact laws: an elastic force, alone or with damping that is proportional to it.

    f_n = K delta**n (1 + chi delta_rate/delta_rate_onset)          laws of impact
    f_n = K delta**n (1 + 1.5 alpha delta_rate)                     without memory, for contacts that are held

The laws of impact differ in the hysteresis factor chi alone, a function of the restitution. The rate at the onset of
the contact is a memory of the joint, not a function of its state; a law says with `remembers_onset` that it needs it.
Scaled by it, the damping of a contact that began slowly and is held grows without reason: a ball that a film lets down
on the wall at 1e-6 m/s and that is then loaded takes seconds to be pressed in. `HuntCrossleyDissipation` is for it.

The elastic part is K delta**n, or that of the joint's `conformity`, which stands where the stiffness does.
"""

import abc
from typing import Annotated, Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement, called, is_concrete
from spherejax.foundations.legal import non_negative, numeric, positive
from spherejax.foundations.numerics import positive_power
from spherejax.foundations.types import Function, Number, Scalar, Unit
from spherejax.physics.functions.base import AbstractFunction, as_function, function_requirements
from spherejax.physics.laws.base import AbstractLaw
from spherejax.physics.laws.conformity import PressedPair
from spherejax.physics.laws.impact import exact_hysteresis_factor

MINIMUM_ONSET_RATE = 1e-6
"""Smallest onset rate that the hysteresis term divides by [m/s].

A grazing onset has a rate of zero, and the quotient none. One micrometer per second is far below any impact
that matters (a ball dropped by 1e-13 m reaches it); slower onsets are damped as if they had this rate.
"""

HERTZIAN_EXPONENT = 1.5

IMPACT_SPEEDS = tuple(map(float, np.geomspace(MINIMUM_ONSET_RATE, 1e3, 181)))
"""Onset rates [m/s] at which a restitution that depends on them is looked at."""


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
    def force(
        self, penetration: Number, penetration_rate: Number, onset_rate: Number, stiffness: Number | PressedPair
    ) -> Scalar:
        """Magnitude of the contact force, never negative [N].

        Args:
            penetration: delta = |e| - c [m]; zero or below without contact.
            penetration_rate: its rate [m/s], positive while the ball presses in.
            onset_rate: the penetration rate at the onset of this contact [m/s].
            stiffness: K [N/m**n], or what stands for it in a joint with a `conformity`; give it to `elastic_force`.
        """

    def elastic_force(self, penetration: Number, stiffness: Number | PressedPair) -> Scalar:
        """The conservative part, K delta**n [N].

        Limits: value and derivative 0 for delta <= 0.

        Source: Rodrigues da Silva et al. (2022), Eq. 23.
        """
        if isinstance(stiffness, PressedPair):
            return stiffness.force(penetration)
        return stiffness * positive_power(penetration, self.exponent)

    def elastic_energy(self, penetration: Number, stiffness: Number | PressedPair) -> Scalar:
        """Energy stored by the elastic part, K delta**(n+1)/(n+1) [J].

        Limits: value and derivative 0 for delta <= 0.
        """
        if isinstance(stiffness, PressedPair):
            return stiffness.energy(penetration)
        return stiffness * positive_power(penetration, self.exponent + 1.0) / (self.exponent + 1.0)

    def depth(self, load: Number, stiffness: Number | PressedPair) -> Scalar:
        """The penetration at which the elastic part carries a positive load [m]."""
        if isinstance(stiffness, PressedPair):
            return stiffness.depth(load)
        return (load / stiffness) ** (1.0 / self.exponent)

    def elastic_requirements(self) -> list[Requirement]:
        """What `stiffness` and `exponent` must satisfy."""
        n = numeric(self.exponent)
        if self.stiffness is None and is_concrete(n) and not np.all(n == HERTZIAN_EXPONENT):
            remedy = "The stiffness that follows from radii and materials is in N/m**1.5: give stiffness= with it."
            return [Requirement("exponent", self.exponent, False, "be 1.5 without a stiffness", remedy)]
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
    """The elastic force with a damping that is proportional to it, scaled by the onset rate of the contact.

    Attributes:
        restitution: c_r [-], in (0, 1]; or a function of the onset rate [m/s] (`PowerTail` for metals that yield).
    """

    restitution: eqx.AbstractVar[Number | AbstractFunction]
    remembers_onset: ClassVar[bool] = True
    never_adds_energy: ClassVar[bool] = True

    def __post_init__(self):
        if callable(self.restitution):
            self.restitution = as_function(self.restitution)  # pyright: ignore

    @abc.abstractmethod
    def hysteresis_factor(self) -> Number:
        """chi [-], not negative, a function of the restitution alone, which is a number here: see `at_onset`."""

    def at_onset(self, onset_rate: Number) -> "AbstractHysteresisLaw":
        """The law with the restitution of one onset: itself, unless that is a function of the onset rate [m/s]."""
        if not callable(self.restitution):
            return self
        return eqx.tree_at(
            lambda law: law.restitution, self, self.restitution(jnp.maximum(onset_rate, MINIMUM_ONSET_RATE))
        )

    def force(
        self, penetration: Number, penetration_rate: Number, onset_rate: Number, stiffness: Number | PressedPair
    ) -> Scalar:
        """f_n = max(0, K delta**n (1 + chi delta_rate/delta_rate_onset)) [N].

        A free impact never turns the bracket negative; a pair that is pulled apart does, and surfaces without
        adhesion then let go: the force is clipped at zero, with a derivative of zero on the clipped side.

        Limits: value and derivatives 0 for delta <= 0. A grazing onset counts as `MINIMUM_ONSET_RATE`, so
        value and derivatives stay finite at an onset rate of zero.
        """
        factor = self.at_onset(onset_rate).hysteresis_factor()
        return self.elastic_force(penetration, stiffness) * _damped(factor, penetration_rate, onset_rate)

    def requirements(self) -> list[Requirement]:
        """Restitution in (0, 1]: at 0 the factor of most laws is infinite, and the others never realize
        it."""
        if isinstance(self.restitution, AbstractFunction):
            return [*self._function_requirements(self.restitution), *self.elastic_requirements()]
        c_r = numeric(self.restitution)
        return [
            Requirement(
                "restitution",
                self.restitution,
                (c_r > 0) & (c_r <= 1),
                "lie in (0, 1]",
                "For a nearly plastic contact give a small positive number; 1 dissipates nothing.",
            ),
            *called(self, "elastic_requirements"),
        ]

    def _function_requirements(self, restitution: AbstractFunction) -> list[Requirement]:
        own = function_requirements("restitution", restitution)
        if any(is_concrete(row.satisfied) and not np.all(np.asarray(row.satisfied)) for row in own):
            return own
        if not all(is_concrete(leaf) for leaf in jax.tree.leaves(restitution)):
            values = jax.vmap(restitution)(jnp.asarray(IMPACT_SPEEDS))
            return [*own, Requirement("restitution", values, (values > 0) & (values <= 1), "lie in (0, 1]", "")]
        with jax.ensure_compile_time_eval():
            found = np.asarray(jax.vmap(restitution)(jnp.asarray(IMPACT_SPEEDS)))
        wrong = ~((found > 0) & (found <= 1))
        worst = int(np.argmax(wrong))
        remedy = f"At an onset of {IMPACT_SPEEDS[worst]:.3g} m/s it does not; it is asked from 1e-6 to 1000 m/s."
        return [*own, Requirement("restitution", found[worst], not np.any(wrong), "lie in (0, 1] at any speed", remedy)]


def _damped(factor: Number, penetration_rate: Number, onset_rate: Number) -> Scalar:
    """max(0, 1 + chi delta_rate/delta_rate_onset) [-]."""
    damping = 1.0 + factor * penetration_rate / jnp.maximum(onset_rate, MINIMUM_ONSET_RATE)
    return jnp.where(damping > 0, damping, 0.0)


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

    def force(
        self, penetration: Number, penetration_rate: Number, onset_rate: Number, stiffness: Number | PressedPair
    ) -> Scalar:
        """K delta**n [N]; both rates are ignored.

        Limits: value and derivative 0 for delta <= 0.
        """
        return self.elastic_force(penetration, stiffness)

    def requirements(self) -> list[Requirement]:
        """Stiffness and exponent alone."""
        return self.elastic_requirements()


class HuntCrossleyDissipation(AbstractNormalLaw):
    """Hertz's force with a damping by the rate alone, without memory: f_n = K delta**n (1 + 1.5 alpha delta_rate).

    For contacts that are held, pressed and let go slowly, where an onset's speed says nothing; the default of the
    lubricated joint, whose film lets the ball down on the wall at micrometers per second. It needs no onset rate, so
    that a contact forgets how it began.

    Attributes:
        dissipation: alpha [s/m].
        stiffness: K [N/m**n], or `None` for Eq. 24.
        exponent: n [-].

    Limits: a free impact at v restores 1 - alpha v of its speed for small alpha v: slow impacts are elastic. Pulled
        apart faster than 1/(1.5 alpha), surfaces without adhesion let go: the force is clipped at zero. alpha = 0 is
        `Hertz`.

    Source: Hunt and Crossley (1975), J. Appl. Mech. 42:440-445; steel, bronze and ivory have 0.08 to 0.32 s/m, quoted
    from there by Marhefka and Orin (1999), IEEE Trans. Syst. Man Cybern. A 29:566-572.
    """

    dissipation: Annotated[Number, Unit("s/m")] = 0.3
    stiffness: Annotated[Number | None, Unit("N/m^{exponent}")] = None
    exponent: Annotated[Number, Unit("1")] = 1.5
    remembers_onset: ClassVar[bool] = False
    never_adds_energy: ClassVar[bool] = True

    def force(
        self, penetration: Number, penetration_rate: Number, onset_rate: Number, stiffness: Number | PressedPair
    ) -> Scalar:
        """max(0, K delta**n (1 + 1.5 alpha delta_rate)) [N]; the onset rate is ignored.

        Limits: value and derivative 0 for delta <= 0.
        """
        damping = 1.0 + 1.5 * self.dissipation * penetration_rate
        return self.elastic_force(penetration, stiffness) * jnp.where(damping > 0, damping, 0.0)

    def requirements(self) -> list[Requirement]:
        """A dissipation that is not negative."""
        return [non_negative("dissipation", self.dissipation, "s/m"), *self.elastic_requirements()]


class HuntCrossley(AbstractHysteresisLaw):
    """chi = 3 (1 - c_r)/2, for nearly elastic contacts.

    Attributes:
        restitution: c_r [-].
        stiffness: K [N/m**n], or `None` for Eq. 24.
        exponent: n [-].

    Limits: chi -> 3/2 as c_r -> 0, so no impact restores less than 0.488 of its speed.

    Source: Hunt and Crossley (1975) as in Rodrigues da Silva et al. (2022), Eq. 26.
    """

    restitution: Annotated[Number | AbstractFunction, Unit("1"), Function("m/s", "1")]
    stiffness: Annotated[Number | None, Unit("N/m^{exponent}")] = None
    exponent: Annotated[Number, Unit("1")] = 1.5

    def hysteresis_factor(self) -> Number:
        """3 (1 - c_r)/2."""
        c_r: Any = self.restitution
        return 1.5 * (1.0 - c_r)


class LankaraniNikravesh(AbstractHysteresisLaw):
    """chi = 3 (1 - c_r**2)/4, for nearly elastic contacts.

    Attributes:
        restitution: c_r [-].
        stiffness: K [N/m**n], or `None` for Eq. 24.
        exponent: n [-].

    Limits: chi -> 3/4 as c_r -> 0; c_r = 0.1 realizes 0.665.

    Source: Lankarani and Nikravesh (1990) as in Rodrigues da Silva et al. (2022), Eq. 27.
    """

    restitution: Annotated[Number | AbstractFunction, Unit("1"), Function("m/s", "1")]
    stiffness: Annotated[Number | None, Unit("N/m^{exponent}")] = None
    exponent: Annotated[Number, Unit("1")] = 1.5

    def hysteresis_factor(self) -> Number:
        """3 (1 - c_r**2)/4."""
        c_r: Any = self.restitution
        return 0.75 * (1.0 - c_r**2)


class Gonthier(AbstractHysteresisLaw):
    """chi = (1 - c_r**2)/c_r, for elastic to nearly plastic contacts.

    Attributes:
        restitution: c_r [-].
        stiffness: K [N/m**n], or `None` for Eq. 24.
        exponent: n [-].

    Limits: chi -> 1/c_r as c_r -> 0, which is exact there; 2 (1 - c_r) near 1, where 3 (1 - c_r)/2 would be.

    Source: Gonthier et al. (2004) as in Rodrigues da Silva et al. (2022), Eq. 28.
    """

    restitution: Annotated[Number | AbstractFunction, Unit("1"), Function("m/s", "1")]
    stiffness: Annotated[Number | None, Unit("N/m^{exponent}")] = None
    exponent: Annotated[Number, Unit("1")] = 1.5

    def hysteresis_factor(self) -> Number:
        """(1 - c_r**2)/c_r."""
        c_r: Any = self.restitution
        return (1.0 - c_r**2) / c_r


class Flores(AbstractHysteresisLaw):
    """chi = 8 (1 - c_r)/(5 c_r), for hard and soft materials.

    Attributes:
        restitution: c_r [-].
        stiffness: K [N/m**n], or `None` for Eq. 24.
        exponent: n [-].

    Limits: chi -> 1.6/c_r as c_r -> 0; 1.6 (1 - c_r) near 1.

    Source: Flores et al. (2011) as in Rodrigues da Silva et al. (2022), Eq. 29.
    """

    restitution: Annotated[Number | AbstractFunction, Unit("1"), Function("m/s", "1")]
    stiffness: Annotated[Number | None, Unit("N/m^{exponent}")] = None
    exponent: Annotated[Number, Unit("1")] = 1.5

    def hysteresis_factor(self) -> Number:
        """8 (1 - c_r)/(5 c_r)."""
        c_r: Any = self.restitution
        return 1.6 * (1.0 - c_r) / c_r


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

    restitution: Annotated[Number | AbstractFunction, Unit("1"), Function("m/s", "1")]
    stiffness: Annotated[Number | None, Unit("N/m^{exponent}")] = None
    exponent: Annotated[Number, Unit("1")] = 1.5

    def hysteresis_factor(self) -> Scalar:
        """The root chi of the impact equation."""
        c_r: Any = self.restitution
        # A known number needs no program: operation by operation it would take half a second to compile.
        return exact_hysteresis_factor(c_r, np if is_concrete(c_r) else jnp)


class _Factor(AbstractNormalLaw):
    """What the equations of motion see of a law of impact: its factor, a number.

    One compiled program serves all laws that differ in it alone; see `by_factor`.

    Attributes:
        factor: chi [-].
        stiffness: K [N/m**n], or `None` for Eq. 24.
        exponent: n [-].
    """

    factor: Number
    stiffness: Number | None
    exponent: Number
    remembers_onset: ClassVar[bool] = True
    never_adds_energy: ClassVar[bool] = True

    def force(
        self, penetration: Number, penetration_rate: Number, onset_rate: Number, stiffness: Number | PressedPair
    ) -> Scalar:
        """As of `AbstractHysteresisLaw` [N]."""
        return self.elastic_force(penetration, stiffness) * _damped(self.factor, penetration_rate, onset_rate)

    def requirements(self) -> list[Requirement]:
        """None: the law that it stands for has been checked."""
        return []


BY_FACTOR = (HuntCrossley, LankaraniNikravesh, Gonthier, Flores, ExactRestitution)
"""Laws of which nothing but the factor enters the force; not their subclasses, which may have a force of their own."""


def by_factor(law: AbstractNormalLaw) -> AbstractNormalLaw:
    """The law as a number, where its restitution is one; any other law as it is."""
    own: Any = law
    if type(law) not in BY_FACTOR or callable(own.restitution):
        return law
    # By NumPy: within `jax.jit` what JAX computes of a known number is known no longer.
    made: Any = own
    if type(own.restitution) is not np.float64:
        given = np.asarray(own.restitution, np.float64)[()] if is_concrete(own.restitution) else own.restitution
        made = type(own)(given)
    return _Factor(called(made, "hysteresis_factor"), own.stiffness, own.exponent)

"""The temperature of a film's oil: what heats and cools it, and how the viscosity falls with it.

The oil of one joint is one reservoir with one temperature T, a state of the joint. The film's dissipation heats it;
it loses heat to both bodies, whose temperatures are given, and to oil that flows through:

    C dT/dt = P - G_s (T - T_s) - G_b (T - T_b) - W (T - T_in)
"""

import abc
from typing import Annotated, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import above, non_negative, positive
from spherejax.foundations.types import Number, Scalar, Unit
from spherejax.physics.laws.base import AbstractLaw
from spherejax.physics.memory import MemoryEntry

GRADE_TEMPERATURE = 313.15
"""40 degC [K], at which the viscosity grades of ISO 3448 are stated."""

LARGEST_EXPONENT = 40.0
"""The viscosity is at most exp(40) = 2e17 times that at the reference temperature, and at least exp(-40) times: a trial
step of the integrator far into the cold or the heat stays finite, no oil is that thick or thin."""


class AbstractOilViscosity(AbstractLaw):
    """How the viscosity of an oil falls with its temperature, from that at T_0, which its joint states."""

    @abc.abstractmethod
    def exponent(self, temperature: Number) -> Scalar:
        """ln(nu(T)/nu(T_0)) [-]."""

    def ratio(self, temperature: Number) -> Scalar:
        """nu(T)/nu(T_0) [-]. Limits: constant, with derivative 0, beyond exp(40) and below exp(-40)."""
        return jnp.exp(jnp.clip(self.exponent(temperature), -LARGEST_EXPONENT, LARGEST_EXPONENT))


class ReynoldsViscosity(AbstractOilViscosity):
    """Exponential law of the viscosity: each kelvin takes away the same share.

        nu(T) = nu(T_0) exp(-beta (T - T_0))

    Attributes:
        coefficient: beta [1/K]; 0.02 to 0.05 for mineral oils near 40 degC, 0 for a constant viscosity.
        reference_temperature: T_0 [K]; 40 degC by default.

    Limits: good for some 20 K about T_0; beyond, real oils thin less and less: see `VogelViscosity`.

    Source: Reynolds (1886), Phil. Trans. R. Soc. 177:157-234.
    """

    coefficient: Annotated[Number, Unit("1/K")]
    reference_temperature: Annotated[Number, Unit("K")] = GRADE_TEMPERATURE

    def exponent(self, temperature: Number) -> Scalar:
        """-beta (T - T_0)."""
        return jnp.asarray(-self.coefficient * (temperature - self.reference_temperature))

    def requirements(self) -> list[Requirement]:
        """beta >= 0, T_0 > 0."""
        return [
            non_negative("coefficient", self.coefficient, "1/K"),
            positive("reference_temperature", self.reference_temperature, "K"),
        ]


class VogelViscosity(AbstractOilViscosity):
    """Vogel's law of the viscosity, which holds for mineral oils over a hundred kelvins and more.

        nu(T) = nu(T_0) exp(B/(T - T_p) - B/(T_0 - T_p)),    B = beta (T_0 - T_p)**2

    Attributes:
        coefficient: beta [1/K], the share that a kelvin takes away at T_0, as of `ReynoldsViscosity`.
        pole_temperature: T_p [K], at which the viscosity has no bound; some 150 to 190 K for mineral oils.
        reference_temperature: T_0 [K]; 40 degC by default.

    Limits: that of `ReynoldsViscosity` near T_0; exp(-beta (T_0 - T_p)) of nu(T_0) as T grows. At and below T_p the
        viscosity is that of `LARGEST_EXPONENT`.

    Source: Vogel (1921), Phys. Z. 22:645-646.
    """

    coefficient: Annotated[Number, Unit("1/K")]
    pole_temperature: Annotated[Number, Unit("K")]
    reference_temperature: Annotated[Number, Unit("K")] = GRADE_TEMPERATURE

    def exponent(self, temperature: Number) -> Scalar:
        """-beta (T - T_0)(T_0 - T_p)/(T - T_p), up to `LARGEST_EXPONENT`, which it has at some T above T_p."""
        reference = self.reference_temperature - self.pole_temperature
        # Where the exponent is 40, B/(T - T_p) = 40 + B/(T_0 - T_p): below that the formula comes to its pole.
        nearest = self.coefficient * reference**2 / (LARGEST_EXPONENT + self.coefficient * reference)
        distance = temperature - self.pole_temperature
        is_liquid = distance > nearest
        safe = jnp.where(is_liquid, distance, reference)
        return jnp.where(is_liquid, self.coefficient * reference * (reference - safe) / safe, LARGEST_EXPONENT)

    def requirements(self) -> list[Requirement]:
        """beta > 0, T_0 > T_p >= 0."""
        return [
            positive("coefficient", self.coefficient, "1/K"),
            non_negative("pole_temperature", self.pole_temperature, "K"),
            above("reference_temperature", self.reference_temperature, "pole_temperature", self.pole_temperature),
        ]


class OilTransport(NamedTuple):
    """The oil of a film that is resolved round its bearing, and what warms it, at each point.

    Attributes:
        forward: flow from the point to the next one [m^3/s]; negative where the oil flows back.
        outward: what leaves at both ends of the bearing, or into a groove, beyond what comes in there [m^3/s].
        volume: of the oil at the point, positive [m^3].
        power: dissipated at the point [W].
        is_groove: whether fresh oil is fed there (static).
    """

    forward: Float[Array, " n"]
    outward: Float[Array, " n"]
    volume: Float[Array, " n"]
    power: Float[Array, " n"]
    is_groove: np.ndarray


class HeatFlows(NamedTuple):
    """Where the heat of the oil goes.

    Attributes:
        to_socket: conducted to the socket's body [W].
        to_ball: conducted to the ball's body [W].
        to_flow: carried off by the oil that flows through [W].
    """

    to_socket: Scalar
    to_ball: Scalar
    to_flow: Scalar

    def told(self) -> dict[str, Array]:
        """By the names that a run tells them by."""
        return {"heat_to_socket": self.to_socket, "heat_to_ball": self.to_ball, "heat_to_flow": self.to_flow}


class AbstractOilHeat(AbstractLaw):
    """What warms and cools the oil of a joint, whose viscosity falls with its temperature.

    Attributes:
        viscosity: how the viscosity that the joint states changes with the temperature.
        is_resolved: whether there is a temperature at each point round a bearing, and not one of all oil.
    """

    viscosity: eqx.AbstractVar[AbstractOilViscosity]
    is_resolved: ClassVar[bool] = False

    @abc.abstractmethod
    def memory_of(self, n_points: int) -> tuple[MemoryEntry, ...]:
        """What is remembered of the oil, with a film that has so many points round its bearing (static)."""

    @abc.abstractmethod
    def effect(self, n_points: int) -> str:
        """What it is called in the table of effects."""

    @abc.abstractmethod
    def temperature(self, memory: Float[Array, " n"]) -> Array:
        """Of the oil [K]: a scalar, or one at each point."""

    @abc.abstractmethod
    def rates(self, temperature: Array, power: Scalar, transport: OilTransport | None) -> Float[Array, " n"]:
        """Of the temperature [K/s].

        Args:
            temperature: of the oil [K].
            power: that the film absorbs [W].
            transport: flows and powers point by point; None of a film that is not resolved.
        """

    @abc.abstractmethod
    def told(self, temperature: Array, transport: OilTransport | None) -> dict[str, Array]:
        """Temperatures [K] and flows of heat [W] by the names that a run tells them by."""

    def doubt(self, film: str, n_grooves: int) -> str:
        """What is said before a run with a film of that name that so many grooves feed; empty for nothing."""
        del film, n_grooves
        return ""

    def requirements_of_viscosity(self) -> list[Requirement]:
        """Those of the law of the viscosity."""
        law, name = self.viscosity, type(self.viscosity).__name__
        return [r._replace(field=f"{name}.{r.field}") for r in law.requirements()]


class OilHeat(AbstractOilHeat):
    """Heat balance of the oil in a lubricated joint, and its viscosity by temperature.

        C dT/dt = P - G_s (T - T_s) - G_b (T - T_b) - W (T - T_in)

    P is the power that the film absorbs: of squeeze and wedge and of shear, as far as the film carries the load. The
    friction of dry contact heats the bodies, not the oil.

    Attributes:
        viscosity: how the viscosity that the joint states changes with the temperature.
        heat_capacity: C, of the oil and of what warms with it [J/K].
        socket_conductance: G_s, between oil and socket's body [W/K].
        ball_conductance: G_b, between oil and ball's body [W/K].
        flow_capacity: W, of the oil that flows through: density times specific heat times volume flow [W/K].
        socket_temperature: T_s, of the socket's body [K].
        ball_temperature: T_b, of the ball's body [K].
        inlet_temperature: T_in, of the oil that flows in [K].
        start_temperature: of the oil at the start [K].

    All temperatures are 40 degC by default; all conductances are 0, which keeps the heat in the oil.

    Limits: one temperature of the whole film, bodies of constant temperature, oil that leaves as warm as the film is
        (a film that warms in proportion to the way leaves twice as warm: take twice the W). A gap h between walls of
        the area A and one temperature has G_s = G_b = 6 k A/h with the conductivity k of the oil: the mean of the
        parabola across it. The couple of Nahme's exact solution across such a gap, with `ReynoldsViscosity`, is met
        within 2 % up to the Nahme number beta nu U**2/k = 4, and within 5 % up to 9. Viscosity by pressure is
        `thickening=` of the joint (`BarusThickening`, `RoelandsThickening`): it grows by some 2 % per MPa.

    Source: lumped heat balances as in Raimondi and Boyd (1958), ASLE Trans. 1:159-209; the solution across the gap:
    Nahme (1940), Ing.-Arch. 11:191-209.
    """

    viscosity: AbstractOilViscosity
    heat_capacity: Annotated[Number, Unit("J/K")]
    socket_conductance: Annotated[Number, Unit("W/K")] = 0.0
    ball_conductance: Annotated[Number, Unit("W/K")] = 0.0
    flow_capacity: Annotated[Number, Unit("W/K")] = 0.0
    socket_temperature: Annotated[Number, Unit("K")] = GRADE_TEMPERATURE
    ball_temperature: Annotated[Number, Unit("K")] = GRADE_TEMPERATURE
    inlet_temperature: Annotated[Number, Unit("K")] = GRADE_TEMPERATURE
    start_temperature: Annotated[Number, Unit("K")] = GRADE_TEMPERATURE

    never_adds_energy: ClassVar[bool] = True

    def memory_of(self, n_points: int) -> tuple[MemoryEntry, ...]:
        """How much warmer the oil is than at the start; it goes on through contact and flight."""
        del n_points
        return (MemoryEntry("oil_warming", "K", 1.0, lasts=True),)

    def effect(self, n_points: int) -> str:
        """In the table of effects."""
        del n_points
        return f"warm oil ({type(self.viscosity).__name__})"

    def temperature(self, memory: Float[Array, " n"]) -> Scalar:
        """T [K]."""
        return self.start_temperature + memory[0]

    def heat_flows(self, temperature: Number) -> HeatFlows:
        """What the oil loses at a temperature [W]."""
        return HeatFlows(
            jnp.asarray(self.socket_conductance * (temperature - self.socket_temperature)),
            jnp.asarray(self.ball_conductance * (temperature - self.ball_temperature)),
            jnp.asarray(self.flow_capacity * (temperature - self.inlet_temperature)),
        )

    def rates(self, temperature: Array, power: Scalar, transport: OilTransport | None) -> Float[Array, " n"]:
        """See `rate`."""
        del transport
        return self.rate(temperature, power)[None]

    def told(self, temperature: Array, transport: OilTransport | None) -> dict[str, Array]:
        """The temperature, and where the heat goes."""
        del transport
        return {"oil_temperature": temperature, **self.heat_flows(temperature).told()}

    def rate(self, temperature: Number, power: Number) -> Scalar:
        """dT/dt [K/s].

        Args:
            temperature: T [K].
            power: P, absorbed by the film [W].
        """
        lost = self.heat_flows(temperature)
        return (power - lost.to_socket - lost.to_ball - lost.to_flow) / self.heat_capacity

    def requirements(self) -> list[Requirement]:
        """A capacity, conductances that are not negative, temperatures above 0 K."""
        temperatures = ("socket_temperature", "ball_temperature", "inlet_temperature", "start_temperature")
        conductances = ("socket_conductance", "ball_conductance", "flow_capacity")
        return [
            positive("heat_capacity", self.heat_capacity, "J/K"),
            *(non_negative(field, getattr(self, field), "W/K") for field in conductances),
            *(positive(field, getattr(self, field), "K") for field in temperatures),
            *self.requirements_of_viscosity(),
        ]

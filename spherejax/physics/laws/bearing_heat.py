"""The temperature of the oil round a bearing: carried by the film's flow, fed at grooves, warmed by its dissipation.

At each of the n points of the film the oil has one temperature, a state, across the gap and along the axis. Oil flows
from point to point; what the gap cannot hold leaves at the ends of the bearing, as warm as it is there:

    C V_i dT_i/dt = P_i + C [Q_(i-1/2) (T_(i-1) - T_i) + q_i (T_in - T_i)] - (G_s (T_i - T_s) + G_b (T_i - T_b))/n

with C the heat capacity of a volume of oil, V_i the oil at the point, P_i what the film dissipates there, Q the flow
(upwind: the sum goes over whatever flows in), q_i fresh oil that is drawn in. At a groove only the share s of the oil
that arrives goes on; fresh oil takes the place of the rest.
"""

from typing import Annotated, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import non_negative, numeric, positive
from spherejax.foundations.types import Number, Scalar, Unit
from spherejax.physics.laws.oil import GRADE_TEMPERATURE, AbstractOilHeat, AbstractOilViscosity, HeatFlows, OilTransport
from spherejax.physics.memory import MemoryEntry


class _Exchange(NamedTuple):
    """What flows of oil do to its heat.

    Attributes:
        warming: of the oil at each point [W].
        to_flow: carried out of the bearing, above the temperature of fresh oil [W].
    """

    warming: Float[Array, " n"]
    to_flow: Scalar


class BearingHeat(AbstractOilHeat):
    """Heat balance of the oil at each point round a bearing, for `film=LinedBearing(...)`.

        C V_i dT_i/dt = P_i + C [Q_(i-1/2) (T_(i-1) - T_i) + q_i (T_in - T_i)] - (G_s (T_i - T_s) + G_b (T_i - T_b))/n

    At a groove of the film, `carry_over` of the oil that arrives goes on, or less where the gap takes less; fresh oil
    fills the gap.

    Attributes:
        viscosity: how the viscosity that the joint states changes with the temperature.
        volume_capacity: C, of the oil: density times specific heat [J/(m^3 K)]; 1.7e6 for mineral oils.
        socket_conductance: G_s, between all oil and the bearing's body [W/K].
        ball_conductance: G_b, between all oil and the journal's body [W/K].
        carry_over: share of the oil that goes on past a groove [-]; 0.7 to 0.9 for axial grooves, 0 where a groove
            takes all warm oil away.
        socket_temperature: T_s, of the bearing's body [K].
        ball_temperature: T_b, of the journal's body [K].
        inlet_temperature: T_in, of fresh oil [K].
        start_temperature: of the oil at the start [K].

    All temperatures are 40 degC by default; all conductances are 0, which leaves the heat to the oil.

    T_i is the temperature with which oil leaves the point, half a step on; the viscosity at the point is the mean of
    what arrives and what leaves.

    Limits: one temperature across the gap and along the axis; laminar flow; bodies of constant temperature. A bearing
        that ROSS has resolved is met with 32 points within 1.2 % in eccentricity, pressure, power and mean rise, and
        3.5 % in the highest rise (`tests/test_bearing_heat.py`). With no grooves and a journal that runs in the middle
        it is `OilHeat` with the heat capacity of the oil in the gap.

    Source: derived here; the mixing of warm and fresh oil at a groove as in Mitsui et al. (1983), J. Lubr. Technol.
    105:414-421.
    """

    viscosity: AbstractOilViscosity
    volume_capacity: Annotated[Number, Unit("J/(m^3 K)")]
    socket_conductance: Annotated[Number, Unit("W/K")] = 0.0
    ball_conductance: Annotated[Number, Unit("W/K")] = 0.0
    carry_over: Annotated[Number, Unit("1")] = 0.8
    socket_temperature: Annotated[Number, Unit("K")] = GRADE_TEMPERATURE
    ball_temperature: Annotated[Number, Unit("K")] = GRADE_TEMPERATURE
    inlet_temperature: Annotated[Number, Unit("K")] = GRADE_TEMPERATURE
    start_temperature: Annotated[Number, Unit("K")] = GRADE_TEMPERATURE

    never_adds_energy: ClassVar[bool] = True
    is_resolved: ClassVar[bool] = True

    def memory_of(self, n_points: int) -> tuple[MemoryEntry, ...]:
        """How much warmer the oil is than at the start, at each point."""
        return tuple(MemoryEntry(f"oil_warming_{i}", "K", 1.0, lasts=True) for i in range(n_points))

    def effect(self, n_points: int) -> str:
        """In the table of effects."""
        return f"warm oil at {n_points} points ({type(self.viscosity).__name__})"

    def temperature(self, memory: Float[Array, " n"]) -> Float[Array, " n"]:
        """T_i [K]."""
        return self.start_temperature + memory

    def rates(self, temperature: Array, power: Scalar, transport: OilTransport | None) -> Float[Array, " n"]:
        """dT_i/dt [K/s]; the power stands in the transport, point by point."""
        del power
        assert transport is not None  # `Lubricated` refuses a film that has none
        lost = self._to_socket(temperature) + self._to_ball(temperature)
        warming = transport.power + self._exchange(temperature, transport).warming - lost
        return warming / (self.volume_capacity * transport.volume)

    def told(self, temperature: Array, transport: OilTransport | None) -> dict[str, Array]:
        """Mean and highest temperature [K], and where the heat goes [W]."""
        assert transport is not None
        lost = HeatFlows(
            jnp.sum(self._to_socket(temperature)),
            jnp.sum(self._to_ball(temperature)),
            self._exchange(temperature, transport).to_flow,
        )
        return {"oil_temperature": jnp.mean(temperature), "hottest_oil": jnp.max(temperature), **lost.told()}

    def doubt(self, film: str, n_grooves: int) -> str:
        """Of a film that no groove feeds."""
        if n_grooves:
            return ""
        return (
            f"heat=BearingHeat with film={film}(grooves=0) has fresh oil only where the film draws it in at the ends "
            "of the bearing, where the gap widens: give the film grooves=1 or more"
        )

    def _to_socket(self, temperature: Array) -> Array:
        return self.socket_conductance / temperature.size * (temperature - self.socket_temperature)

    def _to_ball(self, temperature: Array) -> Array:
        return self.ball_conductance / temperature.size * (temperature - self.ball_temperature)

    def _exchange(self, temperature: Array, transport: OilTransport) -> _Exchange:
        forward, backward = transport.forward, jnp.roll(transport.forward, 1)
        behind, ahead = jnp.roll(temperature, 1), jnp.roll(temperature, -1)
        from_behind, from_ahead = jnp.maximum(backward, 0.0), jnp.maximum(-forward, 0.0)
        arrives = from_behind + from_ahead
        needed = arrives - transport.outward  # what flows on, and what fills a gap that widens
        at_groove = jnp.clip(self.carry_over * arrives, 0.0, jnp.maximum(needed, 0.0))
        is_drained = transport.is_groove & (arrives > 0)
        kept = jnp.where(is_drained, at_groove / jnp.where(arrives > 0, arrives, 1.0), 1.0)
        fresh = jnp.maximum(needed - kept * arrives, 0.0)
        pressed_out = jnp.maximum(kept * arrives - needed, 0.0)
        inlet, capacity = self.inlet_temperature, self.volume_capacity
        mixed = kept * (from_behind * (behind - temperature) + from_ahead * (ahead - temperature))
        drained = (1.0 - kept) * (from_behind * (behind - inlet) + from_ahead * (ahead - inlet))
        before = 0.5 * (1.0 - kept) * transport.power  # half of what warms oil at a groove does so before it drains
        return _Exchange(
            capacity * (mixed + fresh * (inlet - temperature)) - before,
            jnp.sum(capacity * (drained + pressed_out * (temperature - inlet)) + before),
        )

    def requirements(self) -> list[Requirement]:
        """A capacity, conductances that are not negative, a share, temperatures above 0 K."""
        temperatures = ("socket_temperature", "ball_temperature", "inlet_temperature", "start_temperature")
        share, remedy = numeric(self.carry_over), "Give the share of the oil that goes on past a groove."
        return [
            positive("volume_capacity", self.volume_capacity, "J/(m^3 K)"),
            *(non_negative(field, getattr(self, field), "W/K") for field in ("socket_conductance", "ball_conductance")),
            Requirement("carry_over", self.carry_over, (share >= 0) & (share <= 1), "lie in [0, 1]", remedy),
            *(positive(field, getattr(self, field), "K") for field in temperatures),
            *self.requirements_of_viscosity(),
        ]

"""A PID controller in continuous time, and what it shares with a digital one (`sampled_pid`).

Units as of actuators: along a `Turn` angles in rad and moments in N m, else lengths in m and forces in N.
"""

import abc
from collections.abc import Callable, Mapping
from typing import Annotated, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import numeric, positive
from spherejax.foundations.types import Function, Listed, Number, Numeric, Scalar, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.forces.actuators import (
    AbstractMotor,
    coordinate_requirements,
    effort_entry,
)
from spherejax.physics.forces.base import Motions
from spherejax.physics.forces.coupler import AbstractCoordinate, CoordinateMotion
from spherejax.physics.forces.remembering import AbstractForceWithMemory, ForceAction
from spherejax.physics.functions.base import AbstractFunction, function_requirements
from spherejax.physics.functions.shapes import finite, function_or_constant
from spherejax.physics.memory import MemoryEntry, Scale


class Sensed(NamedTuple):
    """What a controller sees at one instant.

    Attributes:
        motion: of the coordinate, through any number of turns.
        value: what is controlled: its position [m or rad] or its rate [m/s or rad/s].
        reference: what that should be.
        error: reference less value.
        error_rate: the error's time derivative, of a position [m/s or rad/s]; of a rate nobody measures it.
    """

    motion: CoordinateMotion
    value: Scalar
    reference: Scalar
    error: Scalar
    error_rate: Scalar | None


GAIN_UNITS: Mapping[tuple[bool, bool], Mapping[str, str]] = {
    (False, False): {"controlled": "m", "proportional": "N/m", "integral": "N/(m s)", "derivative": "N s/m"},
    (True, False): {
        "controlled": "rad", "proportional": "N m/rad", "integral": "N m/(rad s)", "derivative": "N m s/rad",
    },
    (False, True): {"controlled": "m/s", "proportional": "N s/m", "integral": "N/m", "derivative": "N s^2/m"},
    (True, True): {
        "controlled": "rad/s", "proportional": "N m s/rad", "integral": "N m/rad", "derivative": "N m s^2/rad",
    },
}  # fmt: skip
"""Units of what is controlled and of the gains: by whether the coordinate is an angle, and whether it is its rate."""

_CONTROLLED, _CONTROLLED_SHOWN = "{controlled}", "m or rad, of a rate m/s or rad/s"
ReferenceValue = Annotated[
    Number | Callable, Unit(_CONTROLLED, _CONTROLLED_SHOWN), Function("s", _CONTROLLED, _CONTROLLED_SHOWN)
]
ProportionalGain = Annotated[Number, Unit("{proportional}", "N/m or N m/rad")]
IntegralGain = Annotated[Number | None, Unit("{integral}", "N/(m s) or N m/(rad s)")]
DerivativeGain = Annotated[Number | None, Unit("{derivative}", "N s/m or N m s/rad")]
EffortLimits = Annotated[Listed | None, Unit("{effort}", "N or N m")]
EffortOffset = Annotated[Number, Unit("{effort}", "N or N m")]
"""Arguments of controllers, with units by the coordinate and `of_rate`: see `AbstractController.unit_words`."""


class AbstractController(AbstractMotor, AbstractForceWithMemory):
    """What controllers share: a coordinate, a reference, gains, limits of the effort."""

    reference: eqx.AbstractVar[AbstractFunction]
    proportional: eqx.AbstractVar[Number]
    integral: eqx.AbstractVar[Number | None]
    derivative: eqx.AbstractVar[Number | None]
    filter_time: eqx.AbstractVar[Number | None]
    limits: eqx.AbstractVar[Numeric | None]
    tracking_time: eqx.AbstractVar[Number | None]
    offset: eqx.AbstractVar[Number]
    of_rate: eqx.AbstractVar[bool]
    smooth_limits: eqx.AbstractVar[bool]

    @property
    def memory(self):
        """What the controller computes with."""
        return self._states

    @property
    @abc.abstractmethod
    def _states(self) -> tuple[MemoryEntry, ...]:
        """What the controller computes with."""

    def memory_at_start(self, t, motions):
        """No effort, nothing integrated, and a filter that has settled: no error is new to it."""
        seen = self._measured(t, motions)
        start = [seen.error if entry.name == "filtered" else jnp.zeros(()) for entry in self.memory]
        return jnp.stack(start) if start else jnp.zeros(0)

    def _entries(self, memory) -> dict[str, Scalar]:
        return {entry.name: memory[i] for i, entry in enumerate(self.memory)}

    def _measured(self, t: Scalar, motions: Motions) -> Sensed:
        motion = self.coordinate.motion(motions)
        reference = self.reference(t)
        value = motion.rate if self.of_rate else motion.value
        rate = None if self.of_rate else self.reference.derivative(t) - motion.rate
        return Sensed(motion, value, reference, reference - value, rate)

    def _limited(self, effort: Scalar) -> Scalar:
        if self.limits is None:
            return effort
        low, high = self.limits[0], self.limits[1]
        if not self.smooth_limits:
            return jnp.clip(effort, low, high)
        middle, half = (low + high) / 2, (high - low) / 2
        return middle + half * jnp.tanh((effort - middle) / half)

    def _unwinding(self, demand: Scalar, effort: Scalar) -> Scalar | float:
        """What limits take from the integral, by time [N/s or N m/s]."""
        if self.limits is None or self.tracking_time is None:
            return 0.0
        return (effort - demand) / self.tracking_time

    def _parts(self, seen: Sensed, effort: Scalar) -> dict[str, Scalar]:
        return {
            "effort": effort,
            "position": seen.motion.value,
            "rate": seen.motion.rate,
            "reference": seen.reference,
            "error": seen.error,
        }

    def time_to_breakpoint(self, t, motions):
        """To where the reference begins, ends or turns."""
        del motions
        return self.reference.distance_to_breakpoint(t, True)

    @staticmethod
    def unit_words(coordinate: AbstractCoordinate, of_rate: bool = False) -> dict[str, str]:
        """Units of its numbers, by its coordinate and by whether the rate of that is controlled."""
        return {"effort": coordinate.part_units["effort"], **GAIN_UNITS[coordinate.is_angle, of_rate]}

    @property
    def part_units(self) -> Mapping[str, str]:
        """Those of the coordinate; references and errors are positions or rates."""
        unit = self.unit_words(self.coordinate, self.of_rate)["controlled"]
        return {**super().part_units, "reference": unit, "error": unit}

    def requirements(self) -> list[Requirement]:
        """A coordinate, a reference, finite gains, limits in order, positive times."""
        rows = [
            *coordinate_requirements(self.coordinate),
            *function_requirements("reference", self.reference),
            finite("proportional", self.proportional),
            finite("offset", self.offset),
        ]
        rows += [finite(name, gain) for name, gain in self._optional_gains() if gain is not None]
        if self.limits is not None:
            rows.append(_limits_requirement(self.limits))
        if self.tracking_time is not None:
            rows += [positive("tracking_time", self.tracking_time, "s"), self._tracks_something()]
        return rows

    def _optional_gains(self):
        return ("integral", self.integral), ("derivative", self.derivative)

    def _tracks_something(self) -> Requirement:
        has_both = self.limits is not None and self.integral is not None
        remedy = "Give limits and an integral gain, or leave tracking_time out."
        return Requirement(
            "tracking_time", self.tracking_time, has_both, "have limits and an integral to act on", remedy
        )


class PID(AbstractController):
    """A PID controller in continuous time: a motor's torque or a cylinder's force along a coordinate.

        e = reference(t) - x    (x the coordinate, or its rate with `of_rate`)
        f = limited(k_p e + i + k_d e_rate + offset)
        i' = k_i e + (f - unlimited f) / tracking_time
        with a filter:  e_rate = (e - z) / filter_time,  z' = e_rate

    positive where it makes the coordinate grow.

        sj.PID(sj.Turn(("ground", "rotor"), axis=(0, 0, 1)), reference=sj.functions.SmoothStep(0.0, 0.2, 0.0, 6.0),
               proportional=20.0, integral=40.0, derivative=2.0, filter_time=1e-3, limits=(-5, 5), tracking_time=0.1)

    Attributes:
        coordinate: a `Turn`, a `Travel` or an `Extension`.
        reference: of the coordinate, with `of_rate` of its rate: a number [m or rad, of a rate m/s or rad/s], or any
            function of time t in s.
        proportional: k_p [N/m or N m/rad].
        integral: k_i [N/(m s) or N m/(rad s)]; None, the default, has no integral.
        derivative: k_d [N s/m or N m s/rad]; None has no derivative.
        filter_time: time constant of the derivative's filter [s]; None, the default, takes the rate as it is.
        limits: least and largest effort [N or N m], shape (2,); None for an effort without.
        tracking_time: time constant with which limits unwind the integral [s]; None lets it wind up.
        offset: added to the effort [N or N m]: weight that is known, an input for `sj.linearize`.
        of_rate: whether the coordinate's rate is controlled, as of a motor by speed; k_p is then in N s/m or N m s/rad,
            and so on.
        smooth_limits: whether the effort comes to its limits as a hyperbolic tangent; else it is clipped.

    It remembers `integral` i [N or N m] and `filtered` z.

    Limits: at a jump of the reference the derivative is that of the parts beside it, without the jump; with a filter it
    is the filter's answer. A controlled rate needs the filter for a derivative. The motion begins with i = 0, z = e.

    Source: Astrom and Hagglund (2006), Advanced PID Control, sections 2.3, 3.5: back-calculation.
    """

    coordinate: AbstractCoordinate
    reference: AbstractFunction
    proportional: Number
    integral: Number | None
    derivative: Number | None
    filter_time: Number | None
    limits: Numeric | None
    tracking_time: Number | None
    offset: Number
    of_rate: bool = eqx.field(static=True)
    smooth_limits: bool = eqx.field(static=True)

    def __init__(
        self,
        coordinate: AbstractCoordinate,
        reference: ReferenceValue = 0.0,
        proportional: ProportionalGain = 0.0,
        integral: IntegralGain = None,
        derivative: DerivativeGain = None,
        *,
        filter_time: Annotated[Number | None, Unit("s")] = None,
        limits: EffortLimits = None,
        tracking_time: Annotated[Number | None, Unit("s")] = None,
        offset: EffortOffset = 0.0,
        of_rate: bool = False,
        smooth_limits: bool = False,
    ):
        self.coordinate = coordinate
        self.reference = function_or_constant(reference)
        self.proportional = proportional
        self.integral = integral
        self.derivative = derivative
        self.filter_time = filter_time
        self.limits = None if limits is None else numbers(limits)
        self.tracking_time = tracking_time
        self.offset = offset
        self.of_rate = of_rate
        self.smooth_limits = smooth_limits

    @property
    def _states(self):
        integral = MemoryEntry("integral", *effort_entry(self.coordinate))
        return (*((integral,) if self.integral is not None else ()), *(filtered_error(self) if self._filters else ()))

    @property
    def _filters(self) -> bool:
        return self.derivative is not None and self.filter_time is not None

    def unknown_in_time(self, t, motions):
        """The reference, where it is a function of one's own that does not say where it turns."""
        del motions
        unit = "1" if self.coordinate.is_angle else "m"
        return ((self.reference(t), unit),) if self.reference.is_unknown else ()

    def action(self, t, motions, memory):
        """`effort` [N or N m]; `position`, `rate` of the coordinate, `reference`, `error`."""
        kept, seen = self._entries(memory), self._measured(t, motions)
        demand = self.proportional * seen.error + self.offset
        rates = []
        if self.integral is not None:
            demand = demand + kept["integral"]
        rate = self._error_rate(seen, kept)
        if self.derivative is not None:
            demand = demand + self.derivative * rate
        effort = self._limited(demand)
        if self.integral is not None:
            rates.append(self.integral * seen.error + self._unwinding(demand, effort))
        if self._filters:
            rates.append(rate)
        wrenches = self.coordinate.wrenches(motions, effort)
        return ForceAction(wrenches, jnp.stack([jnp.zeros(()), *rates])[1:], parts=self._parts(seen, effort))

    def _error_rate(self, seen: Sensed, kept):
        if self._filters:
            return (seen.error - kept["filtered"]) / self.filter_time
        return jnp.zeros(()) if seen.error_rate is None else seen.error_rate

    def requirements(self):
        """A coordinate, a reference, finite gains, limits in order, positive times."""
        rows = super().requirements()
        if self.filter_time is not None:
            rows.append(positive("filter_time", self.filter_time, "s"))
        if self.of_rate and self.derivative is not None:
            remedy = "Give a filter_time: nobody measures the rate of a rate."
            rows.append(Requirement("filter_time", self.filter_time, self._filters, "be there", remedy))
        return rows


def filtered_error(controller: AbstractController) -> tuple[MemoryEntry, ...]:
    """The filtered error."""
    is_angle = controller.coordinate.is_angle
    of_rate: Scale = "angular_speed" if is_angle else "speed"
    of_position: Scale = "angle" if is_angle else "length"
    unit = controller.unit_words(controller.coordinate, controller.of_rate)["controlled"]
    return (MemoryEntry("filtered", unit, of_rate if controller.of_rate else of_position),)


def _limits_requirement(limits) -> Requirement:
    values = numeric(limits)
    if values.shape != (2,):
        return Requirement("limits", limits, False, "be two numbers", "Give the least and the largest effort.")
    fits = (values[0] < values[1]) & (abs(values) < np.inf).all()
    return Requirement("limits", limits, fits, "increase and be finite", "Give the least effort first.")

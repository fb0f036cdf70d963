"""A digital PID controller: it measures, computes and holds, every period.

Units as of actuators: along a `Turn` angles in rad and moments in N m, else lengths in m and forces in N.
"""

from typing import Annotated, Any

import equinox as eqx
import jax.numpy as jnp

from spherejax.foundations.legal import non_negative
from spherejax.foundations.types import Number, Numeric, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.forces.actuators import effort_entry
from spherejax.physics.forces.controllers import (
    AbstractController,
    DerivativeGain,
    EffortLimits,
    EffortOffset,
    IntegralGain,
    ProportionalGain,
    ReferenceValue,
    filtered_error,
)
from spherejax.physics.forces.coupler import AbstractCoordinate
from spherejax.physics.forces.remembering import ForceAction, Sampling
from spherejax.physics.functions.base import AbstractFunction
from spherejax.physics.functions.shapes import function_or_constant
from spherejax.physics.memory import MemoryEntry


class SampledPID(AbstractController):
    """A digital PID controller: it measures every `period`, computes, and holds its effort until the next sample.

    At the k-th sample, at t_k = first_sample + k period,

        e_k = reference(t_k) - x(t_k)
        f_k = limited(k_p e_k + i_k + k_d (e_k - z_k-1) / (period + filter_time) + offset)
        i_k+1 = i_k + period (k_i e_k + (f_k - unlimited f_k) / tracking_time)
        z_k = z_k-1 + period / (period + filter_time) (e_k - z_k-1)

    and the effort is f_k from t_k to t_k+1; with `delayed` from t_k+1 to t_k+2, as of a computer that takes a period.
    Steps of the integration end on the samples: between them the motion is smooth, and results do not depend on how the
    steps fall.

    Attributes:
        coordinate: a `Turn`, a `Travel` or an `Extension`.
        period: from sample to sample [s].
        reference: of the coordinate, with `of_rate` of its rate: a number [m or rad, of a rate m/s or rad/s], or any
            function of time t in s.
        proportional: k_p [N/m or N m/rad].
        integral: k_i [N/(m s) or N m/(rad s)]; None, the default, has no integral.
        derivative: k_d [N s/m or N m s/rad]; None has no derivative.
        filter_time: time constant of the derivative's filter [s].
        limits: least and largest effort [N or N m], shape (2,); None for an effort without.
        tracking_time: time constant with which limits unwind the integral [s]; None lets it wind up.
        offset: added to the effort [N or N m].
        first_sample: t_0 [s]; before it there is no effort.
        of_rate: whether the coordinate's rate is controlled, as of a motor by speed; k_p is then in N s/m or N m s/rad,
            and so on.
        smooth_limits: whether the effort comes to its limits as a hyperbolic tangent; else it is clipped.
        delayed: whether an effort acts one period after its sample.

    It remembers `samples`, the number of the coming one, `effort` f [N or N m], `integral` i, `filtered` z, and
    `coming`, the effort that is delayed.

    Limits: the motion begins with i = 0 and z = e, so that the first sample has no derivative.

    Source: Astrom and Wittenmark (1997), Computer-Controlled Systems, section 8.5, with a backward difference of the
    error for the derivative.
    """

    coordinate: AbstractCoordinate
    period: Number
    reference: AbstractFunction
    proportional: Number
    integral: Number | None
    derivative: Number | None
    filter_time: Number | None
    limits: Numeric | None
    tracking_time: Number | None
    offset: Number
    first_sample: Number
    of_rate: bool = eqx.field(static=True)
    smooth_limits: bool = eqx.field(static=True)
    delayed: bool = eqx.field(static=True)

    def __init__(
        self,
        coordinate: AbstractCoordinate,
        period: Annotated[Number, Unit("s")],
        reference: ReferenceValue = 0.0,
        proportional: ProportionalGain = 0.0,
        integral: IntegralGain = None,
        derivative: DerivativeGain = None,
        *,
        filter_time: Annotated[Number, Unit("s")] = 0.0,
        limits: EffortLimits = None,
        tracking_time: Annotated[Number | None, Unit("s")] = None,
        offset: EffortOffset = 0.0,
        first_sample: Annotated[Number, Unit("s")] = 0.0,
        of_rate: bool = False,
        smooth_limits: bool = False,
        delayed: bool = False,
    ):
        self.coordinate = coordinate
        self.period = period
        self.reference = function_or_constant(reference)
        self.proportional = proportional
        self.integral = integral
        self.derivative = derivative
        self.filter_time = filter_time
        self.limits = None if limits is None else numbers(limits)
        self.tracking_time = tracking_time
        self.offset = offset
        self.first_sample = first_sample
        self.of_rate = of_rate
        self.smooth_limits = smooth_limits
        self.delayed = delayed

    @property
    def sampling(self):
        """Every period."""
        return Sampling(self.period, self.first_sample)

    @property
    def _states(self):
        unit, scale = effort_entry(self.coordinate)
        names = ["effort"] + ["integral"] * (self.integral is not None) + ["coming"] * self.delayed
        filtered = filtered_error(self) if self.derivative is not None else ()
        return (*(MemoryEntry(name, unit, scale) for name in names), *filtered)

    def sampled(self, t, motions, memory):
        """The memory behind a sample."""
        now, seen = self._entries(memory), self._measured(t, motions)
        demand = self.proportional * seen.error + self.offset
        if self.integral is not None:
            demand = demand + now["integral"]
        if self.derivative is not None:
            smoothing: Any = self.filter_time
            difference = (seen.error - now["filtered"]) / (self.period + smoothing)
            demand = demand + self.derivative * difference
            now["filtered"] = now["filtered"] + self.period * difference
        effort = self._limited(demand)
        if self.integral is not None:
            growing = self.integral * seen.error + self._unwinding(demand, effort)
            now["integral"] = now["integral"] + self.period * growing
        now["effort"], now["coming"] = (now["coming"], effort) if self.delayed else (effort, effort)
        return jnp.stack([now[entry.name] for entry in self.memory])

    def action(self, t, motions, memory):
        """`effort` [N or N m]; `position`, `rate` of the coordinate, `reference`, `error`."""
        seen, effort = self._measured(t, motions), self._entries(memory)["effort"]
        wrenches = self.coordinate.wrenches(motions, effort)
        return ForceAction(wrenches, jnp.zeros(len(memory)), parts=self._parts(seen, effort))

    def requirements(self):
        """A coordinate, a positive period, a reference, finite gains, limits in order, positive times."""
        return [
            *super().requirements(),
            *self.sampling.requirements(),
            non_negative("filter_time", self.filter_time, "s"),
        ]

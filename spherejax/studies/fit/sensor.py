"""Sensors: what an instrument makes of an observable before it is recorded.

With an observable x(t) of the motion, a channel reads

    reading(t) = gain * f(t - delay) + bias,        f = x, or what a filter makes of x.

    low pass, time constant T           T df/dt + f = x
    differentiator, time constant T     T df/dt + f = dx/dt

Every number is a number, the name of a fitted parameter, or a function of the parameters.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import visible, whole_number

SensorNumber = float | str | Callable[[Mapping[str, Any]], Any] | Any
"""A number (or one for each component), the name of a parameter, or a function of a mapping with all parameters."""


@dataclass(frozen=True)
class LowPass:
    """A first-order low-pass filter, T df/dt + f = x.

    It is computed by an exact recursion between samples: over each interval h the observable is the cubic polynomial
    that has its values and its rates at both ends, and the filter's answer to a cubic polynomial is a formula. The
    error is that of the polynomial, at most h^4 / 384 times the fourth derivative of x; `sj.fit` compares with
    intervals twice as long, and warns where the difference is more than a tenth of the noise.

    Attributes:
        time_constant: T [s]; the cut-off frequency is 1 / (2 pi T).
        settled: what the filter remembers when the motion starts: True, as if x had stood for long at its first
            value; False, nothing: f is zero at the start.
        substeps: into how many intervals the time between two samples is divided.
    """

    time_constant: SensorNumber
    settled: bool = field(default=True, kw_only=True)
    substeps: int = field(default=4, kw_only=True)

    def __post_init__(self):
        _check_filter(self)


@dataclass(frozen=True)
class Differentiator:
    """A differentiator behind a low pass, T df/dt + f = dx/dt: how a controller computes a speed from an angle.

    f = (x - g) / T with the low pass g of x; computed, and with the errors of, `LowPass`.

    Attributes:
        time_constant: T [s].
        settled: what the filter remembers when the motion starts: True, as if x had stood for long at its first
            value, so that f is zero; False: g is zero, and f begins with x / T.
        substeps: into how many intervals the time between two samples is divided.
    """

    time_constant: SensorNumber
    settled: bool = field(default=True, kw_only=True)
    substeps: int = field(default=4, kw_only=True)

    def __post_init__(self):
        _check_filter(self)


@dataclass(frozen=True)
class Sensor:
    """The instrument behind a channel of `sj.Measured`: reading(t) = gain * f(t - delay) + bias.

    Each number is a number, the name of a fitted parameter (a text), or a function of a mapping with all parameters,
    e.g. `lambda p: 0.5 * p["length"]`. A parameter may be used by the sensor alone: the builder then need not take it.

    Attributes:
        of: the observable, e.g. `"position.rocker.z"`; None: the name of the channel. Two instruments that measure the
            same observable are channels with names of their own.
        gain: factor; an array for the components of a vector.
        bias: in units of the readings; an array for the components of a vector.
        delay: the reading at t shows the motion at t - delay [s]. Negative for a clock that runs late. Its derivative
            comes from the rates of the state.
        filter: `sj.studies.LowPass` or `sj.studies.Differentiator`, in front of gain, bias and delay; None: none.
        held_before_start: what a delayed channel shows of times before the motion starts: True, the value at the
            start, right of a mechanism that rests until it is released at `t0`; False: such a reading is refused.
        unit: of the readings, for reports; the observable's own where it is not said and `gain` is 1.

    Limits: where the state jumps (a sampled controller, an ideal impact) the derivative by the delay is that of the
    side on which the sample lies.
    """

    of: str | None = None
    gain: SensorNumber = field(default=1.0, kw_only=True)
    bias: SensorNumber = field(default=0.0, kw_only=True)
    delay: SensorNumber = field(default=0.0, kw_only=True)
    filter: LowPass | Differentiator | None = field(default=None, kw_only=True)
    held_before_start: bool = field(default=False, kw_only=True)
    unit: str | None = field(default=None, kw_only=True)

    def __post_init__(self):
        if self.of is not None and not isinstance(self.of, str):
            raise SceneError(f"Sensor: of = {self.of!r} must be the name of an observable, e.g. 'position.rocker.z'")
        if not isinstance(self.filter, LowPass | Differentiator | None):
            raise SceneError(
                f"Sensor: filter must be sj.studies.LowPass, sj.studies.Differentiator or None; it is {self.filter!r}"
            )
        for name in ("gain", "bias", "delay"):
            object.__setattr__(self, name, _number(f"Sensor: {name}", getattr(self, name), is_one=name == "delay"))
        if isinstance(self.gain, float) and self.gain == 0:
            raise SceneError("Sensor: gain = 0 shows nothing of the motion; leave the channel out")

    @property
    def names(self) -> Iterator[str]:
        """Parameters that it uses by name."""
        return (number for number in self.numbers.values() if isinstance(number, str))

    @property
    def numbers(self) -> dict[str, SensorNumber]:
        """Its numbers by name."""
        own = {"gain": self.gain, "bias": self.bias, "delay": self.delay}
        return own if self.filter is None else {**own, "time_constant": self.filter.time_constant}

    @property
    def n_substeps(self) -> int:
        """Into how many intervals the time between two samples is divided."""
        return 1 if self.filter is None else self.filter.substeps


def _check_filter(filter_: LowPass | Differentiator) -> None:
    kind = type(filter_).__name__
    time_constant = _number(f"{kind}: time_constant", filter_.time_constant, is_one=True)
    if isinstance(time_constant, float) and not time_constant > 0:
        raise SceneError(f"{kind}: time_constant = {time_constant:.6g} s must be positive; without a filter: None")
    object.__setattr__(filter_, "time_constant", time_constant)
    object.__setattr__(filter_, "substeps", whole_number(f"{kind}: substeps", filter_.substeps, "Leave it out."))


def _number(what: str, number: Any, *, is_one: bool) -> Any:
    """A number as a float, a tuple of floats for components; a name or a function as it is.

    Raises:
        SceneError: for anything else.
    """
    if isinstance(number, str) or callable(number):
        return number
    if not all(map(is_concrete, jax.tree.leaves(number))):
        raise SceneError(f"{what} is traced; give a number, the name of a fitted parameter, or a function of them")
    try:
        values = np.asarray(visible(number), np.float64)
    except (TypeError, ValueError):
        values = np.full((1, 1), np.nan)
    if values.ndim > (0 if is_one else 1) or not np.all(np.isfinite(values)):
        many = "" if is_one else " (or one for each component)"
        raise SceneError(
            f"{what} must be a finite number{many}, the name of a parameter, or a function of a mapping with the "
            f"parameters; it is {number!r}"
        )
    return values.item() if values.ndim == 0 else tuple(values.tolist())


def unit_of(sensor: Sensor | None, unit: str) -> str:
    """The unit of a channel's readings, from that of its observable; empty where it is not known."""
    if sensor is None:
        return unit
    if sensor.unit is not None:
        return sensor.unit
    if sensor.gain != 1.0 or not unit:
        return ""
    if isinstance(sensor.filter, Differentiator):
        return {"m/s": "m/s^2", "rad/s": "rad/s^2"}.get(unit, "" if "/" in unit else f"{unit}/s")
    return unit

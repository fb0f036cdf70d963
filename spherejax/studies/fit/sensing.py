"""The channels of an experiment: when the run is sampled for them, and what their sensors make of it.

Channels with the same delay d are a group. The run is sampled at t - d for every instant t of the record, so no reading
is interpolated, and the derivative by d is minus the rate of the state. A filter needs samples in between as well: the
recursion over an interval h, with a = h / T and x(s) = sum_j c_j s^j for s from 0 to 1, is

    f(h) = exp(-a) f(0) + sum_j c_j m_j(a),      m_j(a) = integral from 0 to 1 of a exp(-a (1 - s)) s^j ds.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.types import Flag, Scalar
from spherejax.motion.results.trajectory import Trajectory
from spherejax.studies.fit.observables import Observable
from spherejax.studies.fit.sensor import Differentiator, Sensor, SensorNumber

RunAt = Callable[[Array, Array], Trajectory]
"""The run with some of its samples: from times and flat states."""

Span = tuple[int, int]


class SensedChannel(NamedTuple):
    """How a channel is read (static); entries count in the vector of all sensors' numbers.

    Attributes:
        observable: of the motion.
        group: of channels with the same delay.
        gain, bias: entries, from and up to.
        time_constant: entry; None without a filter.
        differentiates: whether the filter is a differentiator.
        is_settled: whether the filter was on for long before the motion starts.
    """

    observable: Observable
    group: int
    gain: Span
    bias: Span
    time_constant: int | None
    differentiates: bool
    is_settled: bool


class Sensing(NamedTuple):
    """How all channels of an experiment are read (static).

    Attributes:
        channels: in the order of the measured values.
        delays: entry of each group's delay.
        substeps: of each group, into how many intervals the time between two samples is divided.
    """

    channels: tuple[SensedChannel, ...]
    delays: tuple[int, ...]
    substeps: tuple[int, ...]

    @property
    def has_filters(self) -> bool:
        """Whether a channel has a filter."""
        return any(map(is_filtered, self.channels))


class SensorNumbers(NamedTuple):
    """The numbers of all sensors of an experiment, as functions of the parameters (static).

    Attributes:
        numbers: in the order of the vector, with their sizes.
        conditions: what must hold, by entry.
        delays, time_constants: entries, with the names of the channels.
        earliest: of each delay, the first instant of its channels that is not held at the start [s].
        t0: start of the motion [s].
    """

    numbers: tuple[tuple[SensorNumber, int], ...]
    delays: tuple[tuple[int, str, float], ...]
    time_constants: tuple[tuple[int, str], ...]
    t0: float

    def __call__(self, values: Mapping[str, Any]) -> Float[Array, " q"]:
        """The vector of all numbers; `values` by the names of this experiment's parameters."""
        return jnp.concatenate([jnp.broadcast_to(_value(number, values), (n,)) for number, n in self.numbers])

    def are_legal(self, vector: Float[Array, " q"]) -> Flag:
        """Whether all times can be sampled and all filters are filters."""
        conditions = [earliest - vector[entry] >= self.t0 for entry, _, earliest in self.delays]
        conditions += [vector[entry] > 0 for entry, _ in self.time_constants]
        return jnp.all(jnp.stack([jnp.all(jnp.isfinite(vector)), *conditions]))

    def refusals(self, vector: np.ndarray) -> list[str]:
        """Why numbers are not legal, sentences without their ends."""
        reasons = [
            f"a delay of {vector[entry]:.6g} s of {name!r} asks for the motion at {earliest - vector[entry]:.6g} s, "
            f"before it starts at t0 = {self.t0:.6g} s. Leave out the first readings (NaN), let the motion start "
            "earlier (Measured(..., t0=)), bound the delay (sj.Parameter(..., upper=)), or, where the mechanism rests "
            "until t0, say Sensor(held_before_start=True)"
            for entry, name, earliest in self.delays
            if not earliest - vector[entry] >= self.t0
        ]
        reasons += [
            f"the time constant of the filter of {name!r} = {vector[entry]:.6g} s is not positive; start it from a "
            "positive number"
            for entry, name in self.time_constants
            if not vector[entry] > 0
        ]
        return reasons or ([] if np.all(np.isfinite(vector)) else ["a number of a sensor is not finite"])


class _Channels(NamedTuple):
    """What `channels_of` returns.

    Attributes:
        sensing: how channels are read; None where all show their observables as they are.
        numbers: of their sensors; None likewise.
    """

    sensing: Sensing | None
    numbers: SensorNumbers | None


def channels_of(
    sensors: Mapping[str, Sensor],
    observables: Mapping[str, Observable],
    earliest: Mapping[str, float],
    t0: float,
    start: Mapping[str, Any],
) -> _Channels:
    """How the channels of an experiment are read.

    Args:
        sensors: by channel; a channel without shows its observable as it is.
        observables: by channel.
        earliest: first instant at which the channel was measured [s].
        t0: start of the motion [s].
        start: parameters of this experiment at the start of the fit.

    Raises:
        SceneError: for a sensor's number that is no number, or not legal at the start.
    """
    if not sensors:
        return _Channels(None, None)
    numbers: list[tuple[SensorNumber, int]] = []

    def entries(channel: str, name: str, number: SensorNumber, *, is_one: bool = False) -> Span:
        size = _size(f"{name} of the sensor of {channel!r}", number, start, is_one=is_one)
        first = sum(n for _, n in numbers)
        numbers.append((number, size))
        return first, first + size

    groups: dict[SensorNumber, int] = {}
    delays: list[int] = []
    first_instants: list[tuple[int, str, float]] = []
    substeps: list[int] = []
    channels: list[SensedChannel] = []
    time_constants: list[tuple[int, str]] = []
    for name, observable in observables.items():
        sensor = sensors.get(name, Sensor())
        if sensor.delay not in groups:
            groups[sensor.delay] = len(groups)
            delays.append(entries(name, "delay", sensor.delay, is_one=True)[0])
            first_instants.append((delays[-1], name, np.inf))
            substeps.append(1)
        group = groups[sensor.delay]
        substeps[group] = max(substeps[group], sensor.n_substeps)
        if not sensor.held_before_start and earliest[name] < first_instants[group][2]:
            first_instants[group] = delays[group], name, earliest[name]
        time_constant = None
        if sensor.filter is not None:
            time_constant = entries(name, "time_constant", sensor.filter.time_constant, is_one=True)[0]
            time_constants.append((time_constant, name))
        channels.append(
            SensedChannel(
                observable,
                group,
                entries(name, "gain", sensor.gain),
                entries(name, "bias", sensor.bias),
                time_constant,
                isinstance(sensor.filter, Differentiator),
                sensor.filter is None or sensor.filter.settled,
            )
        )
    made = SensorNumbers(tuple(numbers), tuple(first_instants), tuple(time_constants), t0)
    if reasons := made.refusals(np.asarray(made(start))):
        raise SceneError("; ".join(reasons))
    return _Channels(Sensing(tuple(channels), tuple(delays), tuple(substeps)), made)


def _value(number: SensorNumber, values: Mapping[str, Any]) -> Array:
    if isinstance(number, str):
        number = values[number]
    elif callable(number):
        number = number(values)
    return jnp.asarray(number, jnp.float64)


def _size(what: str, number: SensorNumber, start: Mapping[str, Any], *, is_one: bool) -> int:
    """How many numbers a number of a sensor has at the start of the fit."""
    if isinstance(number, str) and number not in start:
        raise SceneError(f"{what} is the parameter {number!r}, which is not fitted; {one_of(list(start), number)}")
    shape = _value(number, start).shape
    if len(shape) > (0 if is_one else 1):
        raise SceneError(
            f"{what} has shape {shape}; it must be one number{'' if is_one else ', or a list of components'}"
        )
    return math.prod(shape)


# Times --------------------------------------------------------------------------------------------------------------


class Samples(NamedTuple):
    """When the run of an experiment is sampled.

    Attributes:
        ts: the start of the motion, then all sample times in their order [s].
        places: of each group, where its start and its samples stand among these.
    """

    ts: Float[Array, " n"]
    places: tuple[Int[Any, " m"], ...]


def samples_for(sensing: Sensing, numbers: Float[Array, " q"], instants: Float[Array, " n+1"]) -> Samples:
    """When the run is sampled, for instants of the record behind the start of the motion [s]."""
    t0, parts = instants[:1], []
    for delay, substeps in zip(sensing.delays, sensing.substeps, strict=True):
        own = jnp.concatenate([t0, jnp.maximum(instants[1:] - numbers[delay], t0)])
        shares = np.arange(1, substeps + 1) / substeps
        between = own[:-1, None] + jnp.diff(own)[:, None] * shares
        # The last of them exactly: rounding must not put a sample behind the next interval's first.
        parts.append(jnp.concatenate([between[:, :-1], own[1:, None]], 1).ravel())
    if len(parts) == 1:
        return Samples(jnp.concatenate([t0, parts[0]]), (np.arange(parts[0].size + 1),))
    mixed = jnp.concatenate(parts)
    order = jnp.argsort(jax.lax.stop_gradient(mixed))
    place = 1 + jnp.argsort(order)
    ends = np.cumsum([part.size for part in parts])
    split = jnp.split(place, ends[:-1])
    return Samples(
        jnp.concatenate([t0, mixed[order]]), tuple(jnp.concatenate([jnp.zeros(1, part.dtype), part]) for part in split)
    )


# Readings -----------------------------------------------------------------------------------------------------------


def readings(
    sensing: Sensing, numbers: Float[Array, " q"], samples: Samples, run_at: RunAt, ys, rates
) -> list[Float[Array, "n+1 components"]]:
    """What each channel reads at the start of the motion and at the instants of the record.

    Args:
        sensing: how channels are read.
        numbers: of the sensors.
        samples: when the run was sampled.
        run_at: the run at some of these times.
        ys: flat states at the samples.
        rates: their derivatives by time; used by filters alone.
    """
    return [
        _scaled(numbers, channel, _shown(sensing, numbers, samples, channel, run_at, ys, rates))
        for channel in sensing.channels
    ]


def filter_errors(
    sensing: Sensing, numbers: Float[Array, " q"], samples: Samples, run_at: RunAt, ys, rates
) -> Float[Array, " filters"]:
    """Largest change of the readings of each channel with a filter, where its intervals are twice as long."""
    errors = []
    for channel in filter(is_filtered, sensing.channels):
        ts, x, x_rate = _observed(samples, channel, run_at, ys, rates)
        fine = _filtered(numbers, channel, ts, x, x_rate)[::2]
        coarse = _filtered(numbers, channel, ts[::2], x[::2], x_rate[::2])
        errors.append(jnp.max(jnp.abs((fine - coarse) * numbers[slice(*channel.gain)])))
    return jnp.stack(errors) if errors else jnp.zeros(0)


def is_filtered(channel: SensedChannel) -> bool:
    """Whether a channel has a filter."""
    return channel.time_constant is not None


def _shown(sensing: Sensing, numbers, samples: Samples, channel: SensedChannel, run_at: RunAt, ys, rates) -> Array:
    """The observable, or what its filter makes of it, at the start and at the instants of the record."""
    step = sensing.substeps[channel.group]
    if channel.time_constant is None:
        place = samples.places[channel.group][::step]
        return channel.observable.of(run_at(samples.ts[place], ys[place]))
    return _filtered(numbers, channel, *_observed(samples, channel, run_at, ys, rates))[::step]


def _observed(samples: Samples, channel: SensedChannel, run_at: RunAt, ys, rates) -> tuple[Array, Array, Array]:
    """Times, observable and its rate at all samples of a channel."""
    place = samples.places[channel.group]
    ts = samples.ts[place]

    def observable(ts, ys):
        return channel.observable.of(run_at(ts, ys))

    x, x_rate = jax.jvp(observable, (ts, ys[place]), (jnp.ones_like(ts), rates[place]))
    return ts, x, x_rate


def _filtered(numbers, channel: SensedChannel, ts, x, x_rate) -> Float[Array, "n components"]:
    assert channel.time_constant is not None
    time_constant = numbers[channel.time_constant]
    smooth = low_pass(ts, x, x_rate, time_constant, x[0] if channel.is_settled else jnp.zeros_like(x[0]))
    return (x - smooth) / time_constant if channel.differentiates else smooth


def _scaled(numbers, channel: SensedChannel, shown) -> Float[Array, "n components"]:
    gain, bias = numbers[slice(*channel.gain)], numbers[slice(*channel.bias)]
    return gain * shown + bias


def low_pass(
    ts: Float[Array, " n"],
    x: Float[Array, "n m"],
    x_rate: Float[Array, "n m"],
    time_constant: Scalar,
    first: Float[Array, " m"],
) -> Float[Array, "n m"]:
    """What T df/dt + f = x makes of x, given by its values and rates at samples; exact where x is cubic in between.

    Args:
        ts: sample times, not falling [s].
        x: values.
        x_rate: rates.
        time_constant: T [s], positive.
        first: f at the first sample.
    """
    h = jnp.diff(ts)[:, None]
    a = h / time_constant
    rise, r0, r1 = jnp.diff(x, axis=0), h * x_rate[:-1], h * x_rate[1:]
    coefficients = x[:-1], r0, 3 * rise - 2 * r0 - r1, r0 + r1 - 2 * rise
    moments = _moments(a)
    added = sum(c * m for c, m in zip(coefficients, moments, strict=True))

    def over(f, interval):
        kept, added = interval
        f = kept * f + added
        return f, f

    # A loop: an associative scan has log2(n) levels, which take minutes to compile beside sensitivities.
    return jnp.concatenate([first[None], jax.lax.scan(over, first, (jnp.exp(-a), added))[1]])


SERIES = 20
"""Terms of the series of m_j, which is used up to a = 1: the first that is left out is below 1e-18."""


def _moments(a: Array) -> list[Array]:
    """m_0 to m_3 of a = h / T; by parts m_j = 1 - j m_(j-1) / a, which cancels where a is small."""
    is_small = a < 1.0
    small, large = jnp.where(is_small, a, 0.5), jnp.where(is_small, 2.0, a)
    exact, moments = -jnp.expm1(-large), []
    for j in range(4):
        if j:
            exact = 1 - j * exact / large
        # integral of (1 - s)^i s^j = i! j! / (i + j + 1)!
        terms = [(-1.0) ** i * math.factorial(j) / math.factorial(i + j + 1) for i in range(SERIES)]
        series = jnp.zeros_like(a)
        for term in reversed(terms):
            series = series * small + term
        moments.append(jnp.where(is_small, small * series, exact))
    return moments

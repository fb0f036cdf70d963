"""Measurements of one experiment: values of observables at instants, some of them missing."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.forms import visible
from spherejax.motion.runs.many import Build
from spherejax.motion.runs.times import seconds_of
from spherejax.studies.fit.sensor import Sensor

Function = Callable[[Any], Any]
"""From a `Trajectory` to an array with a leading axis of samples."""


@dataclass(frozen=True, init=False, eq=False)
class Measured:
    """What was measured in one experiment.

    Attributes:
        ts: instants [s], increasing, shape (n,).
        values: measured values by observable, shape (n,) or (n, components), in SI units; NaN, or masked, where nothing
            was measured. Observables are named as in `spherejax.motion.equations.quantities`, e.g. `"velocity.rocker"`
            (three components) or `"position.rocker.z"` (one of them), results of force elements as `"shock.length"`,
            and `functions` by their own names. A channel with a sensor may have any name.
        noise: standard deviation of the errors in the units of the values, a number for all observables, or numbers
            (or arrays, for each value) by observable; None: what the fit is told.
        build: from parameters to the scene of this experiment; None: what the fit is told.
        name: of the experiment.
        t0: when the motion starts [s], with the scene as `build` describes it.
        functions: from a `Trajectory` to an array with a leading axis of samples, by name.
        shown_in: units in which pictures show the values, by observable, e.g. `{"position.rocker.z": "mm"}`; of a file
            those that it names. Others are shown in SI units.
        sensors: what the instrument of a channel makes of its observable, by channel: gain, bias, delay, filter. A
            channel without one shows its observable as it is.
        own: parameters that this experiment has for itself, e.g. the angle from which it was released: numbers, arrays
            or `sj.Parameter`, by the names that its builder or its sensors use. In the fit they are named after the
            experiment, `"angle of second"`.
    """

    ts: np.ndarray
    values: dict[str, np.ndarray]
    noise: Any
    build: Build | None
    name: str | None
    t0: float
    functions: dict[str, Function]
    shown_in: dict[str, str]
    sensors: dict[str, Sensor]
    own: dict[str, Any]

    def __init__(
        self,
        ts: Any,
        values: Mapping[str, Any],
        *,
        noise: Any = None,
        build: Build | None = None,
        name: str | None = None,
        t0: float = 0.0,
        functions: Mapping[str, Function] | None = None,
        shown_in: Mapping[str, str] | None = None,
        sensors: Mapping[str, Sensor] | None = None,
        own: Mapping[str, Any] | None = None,
    ):
        _refuse_traced(ts, values)
        times = _times(ts, t0)
        fields = {
            "ts": times, "values": {key: _column(key, value, times.size) for key, value in values.items()},
            "noise": noise, "build": build, "name": name, "t0": float(t0), "functions": dict(functions or {}),
            "shown_in": dict(shown_in or {}),
            "sensors": _sensors(sensors), "own": dict(own or {}),
        }  # fmt: skip
        for key, value in fields.items():
            object.__setattr__(self, key, value)
        _check(self)

    @property
    def n_values(self) -> int:
        """Count of what was measured."""
        return sum(int(np.sum(~np.isnan(value))) for value in self.values.values())

    @property
    def observables(self) -> dict[str, str]:
        """Names of the observables by channel."""
        sensors = self.sensors
        return {name: (sensors[name].of if name in sensors else None) or name for name in self.values}

    def named(self, name: str) -> "Measured":
        """The same with a name, where it has none."""
        return self if self.name is not None else self.replaced(name=name)

    def replaced(self, **changes: Any) -> "Measured":
        """The same with other fields, all but the instants and the values."""
        fields = ("noise", "build", "name", "t0", "functions", "shown_in", "sensors", "own")
        return Measured(self.ts, self.values, **{**{field: getattr(self, field) for field in fields}, **changes})

    def __repr__(self) -> str:
        what = ", ".join([*self.values][:4]) + (f" and {len(self.values) - 4} more" if len(self.values) > 4 else "")
        return f"Measured({what}: {self.n_values} values at {self.ts.size} instants to t = {self.ts[-1]:.6g} s)"


def _refuse_traced(ts: Any, values: Mapping[str, Any]) -> None:
    """Refuse numbers that JAX traces: NumPy's own error would name neither the measurement nor what to do."""
    if not all(map(is_concrete, jax.tree.leaves(ts))):
        raise SceneError(
            "the instants of measurements are traced; sj.fit takes them as numbers. An unknown clock offset is a "
            "parameter: Measured(..., sensors={channel: sj.studies.Sensor(delay='late')}), as the page on "
            "fits shows ('A clock "
            "offset between two channels'). Residuals of your own take sj.simulate, whose sample times have derivatives"
        )
    for name, value in values.items():
        if not all(map(is_concrete, jax.tree.leaves(value))):
            raise SceneError(f"measured values of {name!r} are traced; give numbers, outside of jit, vmap and grad")


def _times(ts: Any, t0: float) -> np.ndarray:
    times = seconds_of(ts, "the instants of measurements")
    if times.ndim != 1 or times.size == 0:
        raise SceneError(
            f"the instants of measurements must be a list of shape (n,), n >= 1; it has shape {times.shape}"
        )
    if not np.all(np.isfinite(times)):
        at = int(np.argmin(np.isfinite(times)))
        raise SceneError(f"the instants of measurements must be finite [s]; entry {at} is {times[at]}")
    steps = np.diff(times)
    if np.any(steps <= 0):
        at = int(np.argmax(steps <= 0))
        raise SceneError(
            f"the instants of measurements must increase; {times[at + 1]:.9g} s (entry {at + 1}) follows "
            f"{times[at]:.9g} s. Sort the samples, and put those of one instant into one row"
        )
    if not times[0] >= t0:
        raise SceneError(
            f"measurements begin at {times[0]:.9g} s, before the motion starts at t0 = {t0:.9g} s; shift the times, or "
            "say with Measured(..., t0=) when the scene is as its builder describes it"
        )
    return times


def _column(name: str, value: Any, n: int) -> np.ndarray:
    try:
        array = np.asarray(visible(value), np.float64)
    except (TypeError, ValueError) as error:
        raise SceneError(f"measured {name!r} must be numbers") from error
    if array.ndim not in (1, 2) or array.shape[0] != n:
        raise SceneError(
            f"measured {name!r} has shape {array.shape}; it must have one row for each of the {n} instants, "
            f"({n},) or ({n}, components)"
        )
    if np.any(np.isinf(array)):
        raise SceneError(f"measured {name!r} has an infinite value; leave out what was not measured, or write NaN")
    return array


def _sensors(sensors: Any) -> dict[str, Sensor]:
    if not isinstance(sensors, Mapping | None) or not all(isinstance(one, Sensor) for one in (sensors or {}).values()):
        raise SceneError(f"sensors must be a dict of sj.studies.Sensor by channel; it is {sensors!r}")
    return dict(sensors or {})


def _check(measured: Measured) -> None:
    if not measured.values:
        raise SceneError("nothing was measured: give values by observable, e.g. {'position.rocker.z': values}")
    if not measured.n_values:
        raise SceneError(f"nothing was measured: all values of {', '.join(measured.values)} are missing (NaN)")
    unshown = [name for name in measured.shown_in if name not in measured.values]
    if unshown:
        raise SceneError(
            f"shown_in names {unshown[0]!r}, which was not measured; {one_of(measured.values, unshown[0])}"
        )
    unused = [name for name in measured.functions if name not in measured.observables.values()]
    if unused:
        raise SceneError(
            f"functions={unused} have no measured values of that name; measured are {list(measured.values)}"
        )
    unused = [name for name in measured.sensors if name not in measured.values]
    if unused:
        raise SceneError(f"sensors={unused} have no measured values of that name; measured are {list(measured.values)}")

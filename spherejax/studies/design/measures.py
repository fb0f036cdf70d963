"""Measures of a run by name: what is made least, and what is limited.

    "peak reaction.a_arm_pivot"       largest magnitude of the samples
    "rms acceleration.wheel"          root of the mean square of the samples' magnitudes, each sample counting alike
    "final position.wheel.z"          at the last sample, with its sign (of a vector: its length)

and functions from a `Trajectory` to a number, by names of one's own.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

from spherejax.foundations.errors import SceneError
from spherejax.foundations.numerics import safe_sqrt
from spherejax.foundations.types import Number, Scalar
from spherejax.model.system import System
from spherejax.motion.results.trajectory import Trajectory
from spherejax.studies.design.peaks import magnitudes, smooth_peak
from spherejax.studies.fit.observables import Observable, observable

KINDS = ("peak", "rms", "final")

Function = Callable[[Trajectory], Any]
"""From a run to a number."""


class DesignMeasured(NamedTuple):
    """A measure of a run.

    Attributes:
        smooth: what gradients are taken of.
        true: what it stands for.
    """

    smooth: Scalar
    true: Scalar


@dataclass(frozen=True)
class Measure:
    """A measure as it was asked for.

    Attributes:
        name: as it was asked for.
        kind: peak, rms, final or function.
        observable: of what.
        function: a user's function of a run, or None.
    """

    name: str
    kind: str
    observable: Observable | None = None
    function: Function | None = None

    @property
    def unit(self) -> str:
        """Of its value; empty where it is not known."""
        return "" if self.observable is None else self.observable.unit

    @property
    def needs_work(self) -> bool:
        """Whether the run must integrate the work of its joints."""
        return self.observable is not None and self.observable.needs_work

    def of(self, run: Trajectory, sharpness: Number) -> DesignMeasured:
        """Its value for a run."""
        if self.observable is None:
            assert self.function is not None
            value = jnp.asarray(self.function(run), jnp.float64)
            if value.shape:
                raise SceneError(f"measure {self.name!r} must be one number; its shape is {value.shape}")
            return DesignMeasured(value, value)
        history = self.observable.of(run)
        if self.kind == "peak":
            return DesignMeasured(smooth_peak(history, sharpness), jnp.max(magnitudes(history)))
        if self.kind == "rms":
            value = safe_sqrt(jnp.mean(magnitudes(history) ** 2))
        else:
            value = history[-1, 0] if history.shape[1] == 1 else magnitudes(history[-1:])[0]
        return DesignMeasured(value, value)


def measure(name: str, system: System, functions: Mapping[str, Function]) -> Measure:
    """A measure of a system by name.

    Raises:
        SceneError: for a name that means nothing, naming what exists.
    """
    if name in functions:
        return Measure(name, "function", function=functions[name])
    kind, _, of_what = name.partition(" ")
    if kind not in KINDS or not of_what:
        own = f", or a function of measures= ({', '.join(map(repr, functions))})" if functions else ""
        raise SceneError(
            f"{name!r} names no measure; write 'peak QUANTITY', 'rms QUANTITY' or 'final QUANTITY', for example "
            f"'peak acceleration.BODY'{own}"
        )
    try:
        found = observable(of_what, system, {})
    except SceneError as error:
        raise SceneError(f"{name!r}: {str(error).removeprefix('measured ')}") from None
    return Measure(name, kind, found)

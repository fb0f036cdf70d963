"""What is kept of each run of a sweep.

    "position.rocker"                  at the sample times
    "final position.rocker"            at the last sample
    "peak acceleration.rocker"         largest magnitude at the samples and the ends of all steps: misses no impact
    "onsets.coupler_rocker"            number of contact onsets
    "time_in_contact.coupler_rocker"   [s]
    "sensitivity final position.rocker"   derivatives by all parameters of the sweep; also of samples

and functions from a `Trajectory` to an array, by name. `sj.studies.Sensitivity(...)` asks for derivatives by some of
the parameters, or of functions.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array

from spherejax.foundations.errors import SceneError
from spherejax.model.system import System
from spherejax.motion.equations.quantities import Quantity, quantity
from spherejax.motion.results.many_sensitivities import RunSlopes
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.many import Runs

Kind = Literal["samples", "final", "peak", "onsets", "time_in_contact", "function", "sensitivity"]
Wanted = Sequence[str] | Mapping[str, Any] | Sequence[Any]
"""Names, or functions by name, or a list of both."""


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives of what a sweep keeps by its parameters.

    They are forward sensitivities, integrated in the lanes beside the states with the errors of both controlled,
    through contact onsets too. They need an explicit method, or a Rosenbrock one.

    Attributes:
        of: a name such as `"final position.rocker"` or `"position.rocker"`, or a function from a `Trajectory` to an
            array.
        by: names of parameters of the sweep; all of them when None. What one sweep keeps is differentiated by the same
            parameters: all that are named.
    """

    of: str | Callable[[Trajectory], Any]
    by: tuple[str, ...] | None = None


TAKEN = ("status", "t_reached", "n_steps", "n_rejected", "warnings", "digest", "seconds", "n_lane_steps", "time", "run")
"""Names that results and stores of sweeps use themselves."""

PARAMETER = "parameter"
"""The dimension of derivatives by several parameters."""

OBSERVED_AT_ONCE = 64
"""Runs whose observables are evaluated together: as wide as a block of lanes."""


@dataclass(frozen=True)
class Kept:
    """One thing that is kept of each run.

    Attributes:
        name: its name in the result.
        kind: how it is found.
        quantity: of what.
        function: a function from a run to an array, where it is one.
        inner: what the derivatives are of, where it is a sensitivity.
        by: names of the parameters of the derivatives.
    """

    name: str
    kind: Kind
    quantity: Quantity | None = None
    function: Callable | None = None
    inner: "Kept | None" = None
    by: tuple[str, ...] = ()

    @property
    def dims(self) -> tuple[str, ...] | None:
        """Dimensions behind the run's; None where only the values tell."""
        if self.kind == "function":
            return None
        if self.inner is not None:
            return None if self.inner.dims is None else (*self.inner.dims, PARAMETER)
        own = self.quantity.dims if self.quantity is not None else ()
        return {"samples": ("time", *own), "final": own}.get(self.kind, ())

    @property
    def attributes(self) -> dict[str, str]:
        """Unit and long name."""
        if self.kind == "function":
            return {"long_name": self.name}
        if self.inner is not None:
            inner = self.inner.attributes
            units = f"{inner.get('units', '1')} per unit of the parameter"
            long_name = f"derivative of {inner['long_name']} by each parameter"
            return {"units": units, "long_name": long_name, "by": " ".join(self.by)}
        unit = {"onsets": "1", "time_in_contact": "s"}.get(self.kind)
        return {"units": unit or (self.quantity.unit if self.quantity else "1"), "long_name": _LONG[self.kind](self)}

    def of(self, runs: Runs, watched: tuple[str, ...]) -> Array:
        """The values of all runs, shape (n_runs, ...)."""
        if self.kind == "peak":
            assert self.quantity is not None
            at_steps = runs.peaks[:, watched.index(self.quantity.name)]
            return jnp.maximum(at_steps, jax.lax.map(self._peak_of, runs.trajectories, batch_size=OBSERVED_AT_ONCE))
        if self.inner is not None:
            return jax.lax.map(self._slopes_of, (runs.trajectories, runs.slopes), batch_size=OBSERVED_AT_ONCE)
        if self.kind in ("onsets", "time_in_contact"):
            joints = runs.trajectories.system.contact_joints
            source = runs.trajectories.stats.n_onsets if self.kind == "onsets" else runs.time_in_contact
            return source[:, joints.index(self.name.partition(".")[2])]
        # All at once would fill the memory with lanes: observables of a block, then the next.
        return jax.lax.map(self._of_one, runs.trajectories, batch_size=OBSERVED_AT_ONCE)

    def _peak_of(self, run: Trajectory) -> Array:
        """Largest magnitude at the samples; steps of a smooth motion can be longer than their interval."""
        assert self.quantity is not None
        values = self.quantity.of(run).reshape(len(run.ts), -1)
        return jnp.sqrt(jnp.nanmax(jnp.sum(values * values, 1)))

    def _slopes_of(self, run_and_slopes: tuple[Trajectory, RunSlopes]) -> Array:
        assert self.inner is not None
        run, slopes = run_and_slopes
        return slopes.of(self.inner._of_one, run)

    def _of_one(self, run: Trajectory) -> Array:
        if self.function is not None:
            return jnp.asarray(self.function(run))
        assert self.quantity is not None
        values = self.quantity.of(run)
        return values if self.kind == "samples" else values[-1]


_LONG: dict[str, Callable[[Kept], str]] = {
    "samples": lambda kept: f"{kept.name} at the sample times",
    "final": lambda kept: f"{kept.name}, last sample",
    "peak": lambda kept: f"{kept.name}: largest magnitude at the samples and the ends of all steps",
    "onsets": lambda kept: "number of contact onsets",
    "time_in_contact": lambda kept: "time in contact",
}


@dataclass(frozen=True)
class Record:
    """All that is kept of each run.

    Attributes:
        kept: one after the other.
    """

    kept: tuple[Kept, ...]

    @property
    def by(self) -> tuple[str, ...]:
        """Names of the parameters by which derivatives are kept; all are by the same."""
        return next((k.by for k in self.kept if k.by), ())

    @property
    def watched(self) -> tuple[str, ...]:
        """Names of the quantities whose peaks are kept."""
        return tuple(k.quantity.name for k in self.kept if k.kind == "peak" and k.quantity is not None)

    @property
    def needs_work(self) -> bool:
        """Whether the runs must integrate the work of their joints."""
        quantities = [(k.inner or k).quantity for k in self.kept]
        return any(each is not None and each.needs_work() for each in quantities)

    @property
    def described(self) -> list[str]:
        """One text for each, which is another one for another record."""
        return [f"{k.kind}: {k.name}" + (f" by {', '.join(k.by)}" if k.by else "") for k in self.kept]

    def of(self, runs: Runs) -> dict[str, Array]:
        """Everything that is kept, by name."""
        return {kept.name: kept.of(runs, self.watched) for kept in self.kept}


def record_of(wanted: Wanted, system: System, parameters: Sequence[str] = ()) -> Record:
    """What is asked for, checked against a system and the names of the parameters.

    Raises:
        SceneError: for a name that means nothing, or one that is asked for twice.
    """
    if isinstance(wanted, str):
        wanted = [wanted]
    items = list(wanted.items()) if isinstance(wanted, Mapping) else [(item, item) for item in wanted]
    kept = tuple(_kept(name, item, system) for name, item in items)
    names = [each.name for each in kept]
    if not names:
        raise SceneError('record= asks for nothing; name a quantity, e.g. record=["final position.rocker"]')
    taken = next((name for name in names if name in TAKEN), None)
    if taken is not None:
        raise SceneError(f"record= calls something {taken!r}, as the sweep calls what it counts; choose another name")
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise SceneError(f"record= asks for {twice!r} twice")
    by = _parameters_of(items, parameters)
    return Record(tuple(each if each.inner is None else replace(each, by=by) for each in kept))


def _parameters_of(items, parameters: Sequence[str]) -> tuple[str, ...]:
    """The parameters by which derivatives are asked for, in the order of the sweep."""
    asked = [_sensitivity_in(item) for _, item in items]
    by = {name for each in asked if each is not None for name in (parameters if each.by is None else each.by)}
    unknown = sorted(by - set(parameters))
    if unknown:
        raise SceneError(
            f"sensitivities by {unknown[0]!r}: no such parameter; the sweep has {', '.join(map(repr, parameters))}"
        )
    return tuple(name for name in parameters if name in by)


def _sensitivity_in(item) -> Sensitivity | None:
    """The request for derivatives in an item of the record."""
    if isinstance(item, Sensitivity):
        return Sensitivity(item.of, (item.by,) if isinstance(item.by, str) else item.by)
    first, _, rest = item.partition(" ") if isinstance(item, str) else ("", "", "")
    return Sensitivity(rest.strip()) if first == "sensitivity" and rest.strip() else None


def _kept(name, item, system: System) -> Kept:
    sensitivity = _sensitivity_in(item)
    if sensitivity is not None:
        inner = _kept(sensitivity.of, sensitivity.of, system)
        if inner.kind not in ("samples", "final", "function"):
            raise SceneError(
                f"sensitivity of {sensitivity.of!r}: derivatives are kept of samples, final values and functions of a "
                "run alone"
            )
        named = isinstance(name, str) and not isinstance(item, str)
        return Kept(name if named else f"sensitivity_{inner.name}", "sensitivity", inner=inner)
    if callable(item):
        return Kept(name if isinstance(name, str) else getattr(item, "__name__", "function"), "function", None, item)
    if not isinstance(item, str):
        raise SceneError(f"record= takes names and functions; {item!r} is neither")
    kind, _, joint = item.partition(".")
    if kind in ("onsets", "time_in_contact"):
        if joint not in system.contact_joints:
            raise SceneError(
                f"{item!r}: joint {joint!r} has no contact whose onsets are located; those that have: "
                f"{', '.join(map(repr, system.contact_joints)) or 'none'}"
            )
        return Kept(item, "onsets" if kind == "onsets" else "time_in_contact")
    first, _, rest = item.partition(" ")
    if first in ("final", "peak") and rest:
        found = quantity(rest.strip(), system)
        return Kept(f"{first}_{found.name}", "final" if first == "final" else "peak", found)
    if rest and first.islower():
        raise SceneError(
            f"{item!r}: a record is a quantity, or 'final' or 'peak' before one, as 'peak {rest.strip()}'; for "
            "anything else give a function of the run"
        )
    return Kept(item, "samples", quantity(item, system))

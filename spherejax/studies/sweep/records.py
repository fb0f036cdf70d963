"""What is kept of each run of a sweep.

    "position.rocker"                  at the sample times
    "final position.rocker"            at the last sample
    "peak acceleration.rocker"         largest magnitude at the samples and the ends of all steps: misses no impact
    "onsets.coupler_rocker"            number of contact onsets
    "time_in_contact.coupler_rocker"   [s]

and functions from a `Trajectory` to an array, by name.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array

from spherejax.foundations.checks import SceneError
from spherejax.model.system import System
from spherejax.motion.many import Runs
from spherejax.motion.quantities import Quantity, quantity
from spherejax.motion.trajectory import Trajectory

Kind = Literal["samples", "final", "peak", "onsets", "time_in_contact", "function"]
Wanted = Sequence[str] | Mapping[str, Callable[[Trajectory], Any]] | Sequence[Any]
"""Names, or functions by name, or a list of both."""

TAKEN = ("status", "t_reached", "n_steps", "n_rejected", "digest", "seconds", "n_lane_steps", "time", "run")
"""Names that results and stores of sweeps use themselves."""

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
    """

    name: str
    kind: Kind
    quantity: Quantity | None = None
    function: Callable | None = None

    @property
    def dims(self) -> tuple[str, ...] | None:
        """Dimensions behind the run's; None where only the values tell."""
        if self.kind == "function":
            return None
        own = self.quantity.dims if self.quantity is not None else ()
        return {"samples": ("time", *own), "final": own}.get(self.kind, ())

    @property
    def attributes(self) -> dict[str, str]:
        """Unit and long name."""
        if self.kind == "function":
            return {"long_name": self.name}
        unit = {"onsets": "1", "time_in_contact": "s"}.get(self.kind)
        return {"units": unit or (self.quantity.unit if self.quantity else "1"), "long_name": _LONG[self.kind](self)}

    def of(self, runs: Runs, watched: tuple[str, ...]) -> Array:
        """The values of all runs, shape (n_runs, ...)."""
        if self.kind == "peak":
            assert self.quantity is not None
            at_steps = runs.peaks[:, watched.index(self.quantity.name)]
            return jnp.maximum(at_steps, jax.lax.map(self._peak_of, runs.trajectories, batch_size=OBSERVED_AT_ONCE))
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
    def watched(self) -> tuple[str, ...]:
        """Names of the quantities whose peaks are kept."""
        return tuple(k.quantity.name for k in self.kept if k.kind == "peak" and k.quantity is not None)

    @property
    def needs_work(self) -> bool:
        """Whether the runs must integrate the work of their joints."""
        return any(k.quantity is not None and k.quantity.needs_work() for k in self.kept)

    def of(self, runs: Runs) -> dict[str, Array]:
        """Everything that is kept, by name."""
        return {kept.name: kept.of(runs, self.watched) for kept in self.kept}


def record_of(wanted: Wanted, system: System) -> Record:
    """What is asked for, checked against a system.

    Raises:
        SceneError: for a name that means nothing, or one that is asked for twice.
    """
    if isinstance(wanted, str):
        wanted = [wanted]
    items = wanted.items() if isinstance(wanted, Mapping) else [(item, item) for item in wanted]
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
    return Record(kept)


def _kept(name, item, system: System) -> Kept:
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
    return Kept(item, "samples", quantity(item, system))

"""A branch of cycles along a number: its points, what is kept of each, and what happens between them."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from spherejax.foundations.errors import SceneError
from spherejax.motion.equations.quantities import quantity
from spherejax.motion.results.trajectory import Trajectory
from spherejax.studies.cycles.cycle_result import Cycle, coefficients, motions
from spherejax.studies.cycles.shooting import CandidateState, SearchOutcome, stacked_places
from spherejax.studies.cycles.study import made

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

AT_ONCE = 32
"""Cycles whose motions are made in one call: few different programs, whatever the number of points."""


class Event(NamedTuple):
    """Something that happens on a branch.

    Attributes:
        kind: "fold", "period doubling", "Neimark-Sacker" or "branch point".
        value: of the number.
        period: of the cycle there [s].
        before: index of the first point behind it.
        becomes_stable: whether the cycles behind it are stable.
        point: the cycle there.
    """

    kind: str
    value: float
    period: float
    before: int
    becomes_stable: bool
    point: Any

    def __repr__(self) -> str:
        now = "stable" if self.becomes_stable else "unstable"
        return f"{self.kind} at {self.value:.9g} (period {self.period:.6g} s); behind it {now}"


@dataclass(frozen=True, repr=False)
class Branch:
    """Cycles along a number; prints what happens along it.

    Attributes:
        number: its name.
        span: where it was to go.
        points: the cycles, in order along the branch.
        events: folds and changes of stability, in order.
        outputs: names of the quantities that are kept.
        diagnosis: why the branch ends before the span does; empty where it does not.
    """

    number: str
    span: tuple[float, float]
    points: list = field(repr=False)
    events: list[Event]
    outputs: tuple[str, ...]
    diagnosis: str
    family: Any = field(repr=False)
    request: Any = field(repr=False)

    @classmethod
    def of(cls, points, events, number, span, outputs, family, request, why) -> "Branch":
        """From the points of a walk."""
        return cls(number, span, points, events, outputs, why, family, request)

    @property
    def succeeded(self) -> bool:
        """Whether it was followed to an end."""
        return not self.diagnosis

    @property
    def values(self) -> Float[np.ndarray, " n"]:
        """The number at each point."""
        at = self.family.names.index(self.number)
        return np.array([float(point.shot.place.values[at]) for point in self.points])

    @property
    def periods(self) -> Float[np.ndarray, " n"]:
        """Of each cycle [s]."""
        return np.array([float(point.shot.place.period) for point in self.points])

    @property
    def is_stable(self) -> np.ndarray:
        """Of each cycle."""
        return np.array([point.multipliers.is_stable for point in self.points], bool)

    @property
    def folds(self) -> list[Event]:
        """Where the branch turns back."""
        return [event for event in self.events if event.kind == "fold"]

    def __len__(self) -> int:
        return len(self.points)

    def cycle(self, k: int) -> Cycle:
        """The cycle of a point, with its motion.

        Raises:
            SceneError: for a point that there is not.
        """
        if not -len(self) <= k < len(self):
            raise SceneError(f"the branch has no point {k}; it has {len(self)}, counted from 0")
        return made(self.family, SearchOutcome(self.points[k].shot, True, 0, ""), self.request)

    @cached_property
    def runs(self) -> list[Trajectory]:
        """The motion of each point over a period."""
        found: list[Trajectory] = []
        for first in range(0, len(self.points), AT_ONCE):
            places = [point.shot.place for point in self.points[first : first + AT_ONCE]]
            whole = stacked_places([*places, *places[-1:] * (AT_ONCE - len(places))])
            found += motions(self.family, CandidateState(*whole), self.request.t, self.request.samples)[: len(places)]
        return found

    def to_xarray(self) -> "xarray.Dataset":
        """A table with a row for each point: number, period, stability, and of each output what is kept.

        Of an output y: `y.max`, `y.min`, `y.mean`, `y.amplitude` of the first harmonic, `y.phase` [rad] of it (of
        cos), and `y.distortion`, the share of the higher harmonics, sqrt(sum of squares) over the first.
        """
        import xarray

        sizes = [np.sort(np.abs(point.multipliers.judged))[::-1] for point in self.points]
        columns: dict[str, Any] = {
            "period": ("point", self.periods, {"units": "s"}),
            "stable": ("point", self.is_stable.astype(int)),
            "n_unstable": ("point", np.array([point.multipliers.n_unstable for point in self.points], int)),
            "largest_multiplier": ("point", np.array([each[0] if len(each) else 0.0 for each in sizes])),
            "closing_error": ("point", np.array([point.shot.error for point in self.points])),
        }
        for name in self.outputs:
            columns |= self._kept(name)
        events = [str(event) for event in self.events]
        return xarray.Dataset(
            columns, {self.number: ("point", self.values)}, {"number": self.number, "events": "; ".join(events)}
        )

    def _kept(self, name: str) -> dict[str, Any]:
        found = quantity(name, self.family.example)
        values = np.stack([np.asarray(found.of(run)) for run in self.runs])
        c = coefficients(values.T).T
        unit = {"units": found.unit} if found.unit else {}
        first = np.abs(c[:, 1])
        higher = np.linalg.norm(c[:, 2:], axis=1)
        return {
            f"{name}.max": ("point", values.max(axis=1), unit),
            f"{name}.min": ("point", values.min(axis=1), unit),
            f"{name}.mean": ("point", np.real(c[:, 0]), unit),
            f"{name}.amplitude": ("point", first, unit),
            f"{name}.phase": ("point", np.angle(c[:, 1]), {"units": "rad"}),
            f"{name}.distortion": ("point", np.divide(higher, first, out=np.full_like(first, np.nan), where=first > 0)),
        }

    def figure(self, name: str | None = None) -> "Figure":
        """The branch over its number, stable and unstable parts, with its events; see `sj.plot.continuation`."""
        from spherejax.output.plot.cycles import continuation

        return continuation(self, name)

    def __str__(self) -> str:
        if not self.points:
            return f"no branch of cycles along {self.number}: {self.diagnosis}"
        values = self.values
        lines = [
            f"Branch of {len(self)} cycles along {self.number}: from {values[0]:.6g} to {values[-1]:.6g}, "
            f"{int(self.is_stable.sum())} of them stable",
            *(f"  {event}" for event in self.events),
        ]
        return "\n".join([*lines, *([self.diagnosis] if self.diagnosis else [])])

    __repr__ = __str__

"""What a study of accuracy returns: rows, references, advice."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from spherejax.studies.accuracy.frontier import Point, advice, duration, efficient, spreads
from spherejax.studies.accuracy.reference import Reference
from spherejax.studies.accuracy.samples import UNITS

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

SPREADS_ALLOWED = 5.0
"""A statistic further than this many standard deviations from the mean of eight tight runs is pointed out: a ninth run
of the same distribution is that far out once in 450 times (Student's t with seven degrees of freedom), and a study
makes some hundred comparisons."""


@dataclass(frozen=True)
class Row:
    """One run: a model, a solver, a tolerance.

    Attributes:
        model: name of the model or scene.
        solver: name of the solver.
        rtol: relative tolerance of a step.
        atol: absolute tolerance of a step, in the units of the state.
        seconds: median time of a warm run without samples and observables [s]; NaN for a run that did not finish.
        n_repeats: repeats that the median is of.
        compile_seconds: time to trace and compile the timed program [s], the same for all tolerances of a solver; much
            less than usual when a persistent compilation cache knows it.
        n_steps: steps tried.
        n_rejected: steps repeated.
        n_evaluations: evaluations of the right-hand side (implicit methods: without those of Newton iterations and
            Jacobians).
        n_onsets: contact onsets.
        errors: largest error over samples and over bodies or joints, by quantity, in the units of `UNITS`; until the
            horizon where there is one; NaN for a run that did not finish.
        statistics: see `STATISTICS`; empty for a motion that repeats.
        status: name of the status, `"succeeded"` or what went wrong.
        diagnosis: what went wrong and what to do; empty after success.
    """

    model: str
    solver: str
    rtol: float
    atol: float
    seconds: float = float("nan")
    n_repeats: int = 0
    compile_seconds: float = float("nan")
    n_steps: int = 0
    n_rejected: int = 0
    n_evaluations: int = 0
    n_onsets: int = 0
    errors: Mapping[str, float] = field(default_factory=lambda: dict.fromkeys(UNITS, float("nan")))
    statistics: Mapping[str, float] = field(default_factory=dict)
    status: str = "succeeded"
    diagnosis: str = ""

    @property
    def succeeded(self) -> bool:
        """Whether the run reached its end."""
        return self.status == "succeeded"


@dataclass(frozen=True)
class WorkPrecision:
    """Error against time for solvers, tolerances and models; prints as a table with advice.

    Attributes:
        rows: all runs.
        references: what errors are measured against, by model.
        t1: length of the motion [s].
        n_samples: number of samples at which errors are taken.
        target: position error that the advice prices [m]; None for one that suits the data.
    """

    rows: Sequence[Row]
    references: Mapping[str, Reference]
    t1: float
    n_samples: int
    target: float | None = None

    @property
    def models(self) -> list[str]:
        """Names of the models."""
        return list(self.references)

    def rows_of(self, model: str) -> list[Row]:
        """The rows of a model."""
        return [row for row in self.rows if row.model == model]

    def is_resolved(self, row: Row, quantity: str = "position") -> bool:
        """Whether an error stands out from the reference's own."""
        return bool(row.errors[quantity] > self.references[row.model].floor(quantity))

    def relative_error(self, row: Row, quantity: str) -> float:
        """An error as a share of the quantity's peak [-], see `samples.scales`."""
        scale = self.references[row.model].scales[quantity]
        return row.errors[quantity] / scale if scale else float("nan")

    def points(self, model: str, quantity: str = "position") -> list[Point]:
        """The finished runs of a model; an error that is not resolved counts as what the reference resolves."""
        floor = self.references[model].floor(quantity)
        return [
            Point(row.solver, row.rtol, max(row.errors[quantity], floor), row.seconds)
            for row in self.rows_of(model)
            if row.succeeded
        ]

    def frontier(self, model: str, quantity: str = "position") -> list[Point]:
        """The runs of a model that no other beats in both error and time."""
        return efficient(self.points(model, quantity))

    def deviations(self, row: Row) -> dict[str, float]:
        """How far the statistics of a run lie from the ensemble's mean, in its standard deviations."""
        members = self.references[row.model].members
        return spreads(row.statistics, members) if row.succeeded and members else {}

    @property
    def advice(self) -> dict[str, str]:
        """What an accuracy in position costs, in a sentence for each model."""
        return {model: self._advice_of(model) for model in self.models}

    def _advice_of(self, model: str) -> str:
        reference = self.references[model]
        sentence = advice(self.points(model), floor=reference.floor("position"), target=self.target)
        if reference.horizon is None:
            return sentence
        return f"In position, over the first {reference.horizon:.3g} s: {sentence}"

    def figures(self, model: str) -> "dict[str, Figure]":
        """The figures of a model: `work_precision`, `steps`, and `statistics` where histories do not repeat."""
        from spherejax.studies.accuracy.figures import figures_of

        return figures_of(self, model)

    def overview(self) -> "Figure":
        """All models in one figure: position errors of the runs that no other run of the model beats."""
        from spherejax.studies.accuracy.figures import overview_of

        return overview_of(self)

    @property
    def notes(self) -> dict[str, list[str]]:
        """What else must be known about each model: its reference, what did not finish, statistics out of line."""
        return {model: [str(self.references[model]), *self._notes_of(model)] for model in self.models}

    def _notes_of(self, model: str) -> list[str]:
        notes = []
        failed: dict[str, list[Row]] = {}
        for row in self.rows_of(model):
            if not row.succeeded:
                failed.setdefault(row.solver, []).append(row)
        for solver, rows in failed.items():
            tolerances = ", ".join(f"{row.rtol:.0e}" for row in rows)
            notes.append(f"{solver} did not finish at rtol {tolerances}: {rows[0].diagnosis}")
        for row in self.rows_of(model):
            strange = {name: far for name, far in self.deviations(row).items() if far > SPREADS_ALLOWED}
            if strange:
                words = ", ".join(f"{name} by {far:.2g}" for name, far in strange.items())
                notes.append(
                    f"{row.solver} at rtol {row.rtol:.0e} lies outside the spread of the tight runs (in their standard "
                    f"deviations): {words}."
                )
        return notes

    def __str__(self) -> str:
        lines = []
        for model in self.models:
            lines += [f"{model}, {self.t1:g} s", *self._table(model), *self.notes[model], self.advice[model], ""]
        return "\n".join(lines).rstrip()

    def _table(self, model: str) -> list[str]:
        heads = ("solver", "rtol", "time", "steps", "rejected", *(f"{n} [{u}]" for n, u in UNITS.items()))
        rows = [heads, *(self.cells(row) for row in self.rows_of(model))]
        widths = [max(len(row[i]) for row in rows) for i in range(len(heads))]
        return ["  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)) for row in rows]

    def cells(self, row: Row) -> tuple[str, ...]:
        """A row as text: solver, tolerance, time, steps, rejected steps, errors (`<` marks those not resolved)."""
        if not row.succeeded:
            failure = row.status.replace("_", " ")
            return (row.solver, f"{row.rtol:.0e}", failure, f"{row.n_steps:,}", f"{row.n_rejected:,}", *("-",) * 5)
        floors = self.references[row.model]
        shown = [
            f"{row.errors[name]:.1e}" if self.is_resolved(row, name) else f"< {floors.floor(name):.0e}"
            for name in UNITS
        ]
        return (
            row.solver,
            f"{row.rtol:.0e}",
            duration(row.seconds),
            f"{row.n_steps:,}",
            f"{row.n_rejected:,}",
            *shown,
        )

    def to_xarray(self) -> "xarray.Dataset":
        """The rows on a grid of `model`, `solver` and `rtol`, with units; what was not run is NaN or zero."""
        from spherejax.studies.accuracy.dataset import to_dataset

        return to_dataset(self)

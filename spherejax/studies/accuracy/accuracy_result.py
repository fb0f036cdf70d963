"""What a study of accuracy returns: rows, references, advice."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from spherejax.model.scene import Scene
from spherejax.motion.results.reported import Reported
from spherejax.studies.accuracy.frontier import FrontierPoint, advice, duration, efficient, spreads
from spherejax.studies.accuracy.page import HEADS, page_of
from spherejax.studies.accuracy.reference import Reference
from spherejax.studies.accuracy.samples import STATISTICS, UNITS

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

    from spherejax.output.plot.work_precision import WorkDiagram
    from spherejax.output.report.page import Page

SPREADS_ALLOWED = 5.0
"""A statistic further than this many standard deviations from the mean of eight tight runs is pointed out: a ninth run
of the same distribution is that far out once in 450 times (Student's t with seven degrees of freedom), and a study
makes some hundred comparisons."""

_COUNTS = {
    "n_repeats": "runs that the median is of",
    "n_steps": "steps tried",
    "n_rejected": "steps repeated",
    "n_evaluations": "evaluations of the right-hand side",
    "n_onsets": "contact onsets",
}
"""Counts of a row and what they mean."""

_PANELS = {
    "peak_acceleration": ("peak acceleration [m/s$^2$]", 1.0),
    "dissipated_energy": ("dissipated energy [mJ]", 1e3),
    "time_in_contact": ("time in contact [s]", 1.0),
    "n_onsets": ("contact onsets of the whole run", 1.0),
    "eccentricity_05": ("|e|, exceeded in 95 % of the time [um]", 1e6),
    "eccentricity_50": ("|e|, exceeded half of the time [um]", 1e6),
    "eccentricity_95": ("|e|, exceeded in 5 % of the time [um]", 1e6),
}
"""Titles of the statistics, with the unit of the axis, and the factor to it."""


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
        estimates: the same by the estimate of `run.error`, from a companion at a hundredth of the tolerance in place of
            the reference; NaN where that did not finish within the budget.
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
    estimates: Mapping[str, float] = field(default_factory=lambda: dict.fromkeys(UNITS, float("nan")))
    statistics: Mapping[str, float] = field(default_factory=dict)
    status: str = "succeeded"
    diagnosis: str = ""

    @property
    def succeeded(self) -> bool:
        """Whether the run reached its end."""
        return self.status == "succeeded"


@dataclass(frozen=True)
class WorkPrecision(Reported):
    """Error against time for solvers, tolerances and models; prints as a table with advice.

    Attributes:
        rows: all runs.
        references: what errors are measured against, by model.
        t1: length of the motion [s].
        n_samples: number of samples at which errors are taken.
        target: position error that the advice prices [m]; None for one that suits the data.
        name: of what was studied, for titles; empty without one.
    """

    rows: Sequence[Row]
    references: Mapping[str, Reference]
    t1: float
    n_samples: int
    target: float | None = None
    name: str = ""

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

    def points(self, model: str, quantity: str = "position") -> list[FrontierPoint]:
        """The finished runs of a model; an error that is not resolved counts as what the reference resolves."""
        floor = self.references[model].floor(quantity)
        return [
            FrontierPoint(row.solver, row.rtol, max(row.errors[quantity], floor), row.seconds)
            for row in self.rows_of(model)
            if row.succeeded
        ]

    def frontier(self, model: str, quantity: str = "position") -> list[FrontierPoint]:
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
        return _figures_of(self, model)

    def overview(self) -> "Figure":
        """All models in one figure: position errors of the runs that no other run of the model beats."""
        return _overview_of(self)

    @property
    def notes(self) -> dict[str, list[str]]:
        """What else must be known about each model: its reference, how well `run.error` estimates, `cautions_of`."""
        return {model: [*self.measured_by(model), *self.cautions_of(model)] for model in self.models}

    def measured_by(self, model: str) -> list[str]:
        """What the errors of a model are measured against, and how well `run.error` meets those that are resolved."""
        return [str(self.references[model]), *filter(None, [self._note_on_estimates(model)])]

    def cautions_of(self, model: str) -> list[str]:
        """What did not finish, and statistics out of line."""
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

    def _note_on_estimates(self, model: str) -> str:
        rows = [row for row in self.rows_of(model) if row.succeeded and self.is_resolved(row)]
        shares = [row.estimates["position"] / row.errors["position"] for row in rows]
        known = [share for share in shares if np.isfinite(share)]
        if not known:
            return ""
        return (
            f"run.error estimates {min(known):.2g} to {max(known):.2g} of the position error, in {len(known)} runs "
            "whose error the reference resolves."
        )

    def __str__(self) -> str:
        lines = []
        for model in self.models:
            lines += [f"{model}, {self.t1:g} s", *self._table(model), *self.notes[model], self.advice[model], ""]
        return "\n".join(lines).rstrip()

    def _table(self, model: str) -> list[str]:
        rows = [HEADS, *(self.cells(row) for row in self.rows_of(model))]
        widths = [max(len(row[i]) for row in rows) for i in range(len(HEADS))]
        return ["  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)) for row in rows]

    def cells(self, row: Row) -> tuple[str, ...]:
        """A row as text, under `HEADS`; `<` marks errors that the reference does not resolve."""
        if not row.succeeded:
            failure = row.status.replace("_", " ")
            return (row.solver, f"{row.rtol:.0e}", failure, f"{row.n_steps:,}", f"{row.n_rejected:,}", *("-",) * 6)
        floors = self.references[row.model]
        shown = [
            f"{row.errors[name]:.1e}" if self.is_resolved(row, name) else f"< {floors.floor(name):.0e}"
            for name in UNITS
        ]
        estimate = row.estimates["position"]
        return (
            row.solver,
            f"{row.rtol:.0e}",
            duration(row.seconds),
            f"{row.n_steps:,}",
            f"{row.n_rejected:,}",
            f"{estimate:.1e}" if np.isfinite(estimate) else "-",
            *shown,
        )

    def report_page(self, title: str, scene: Scene | None) -> "Page":
        """The page that `report` writes."""
        return page_of(self, title, scene)

    def to_xarray(self) -> "xarray.Dataset":
        """The rows on a grid of `model`, `solver` and `rtol`, with units; what was not run is NaN or zero."""
        return _to_dataset(self)


# As a data set, and as pictures ---------------------------------------------------------------------------------------


def _to_dataset(result: WorkPrecision) -> "xarray.Dataset":
    """The rows on a grid of `model`, `solver` and `rtol`, the references by `model`.

    Of a run that did not finish or was not tried, times and errors are NaN and the counts what is known.
    """
    import xarray

    solvers = list(dict.fromkeys(row.solver for row in result.rows))
    rtols = sorted({row.rtol for row in result.rows}, reverse=True)
    place = {(row.model, row.solver, row.rtol): row for row in result.rows}
    grid = [[[place.get((m, s, r)) for r in rtols] for s in solvers] for m in result.models]
    coordinates = {
        "model": result.models,
        "solver": solvers,
        "rtol": ("rtol", rtols, {"units": "1", "long_name": "relative tolerance of a step"}),
    }
    texts = {f"advice_{model}": text for model, text in result.advice.items()}
    notes = {f"notes_{model}": " ".join(text) for model, text in result.notes.items()}
    attributes = {"t1": result.t1, "n_samples": result.n_samples, **texts, **notes}
    return xarray.Dataset({**_of_rows(grid), **_of_references(result)}, coordinates, attributes)


def _of_rows(grid: list[list[list[Row | None]]]) -> dict:
    nan = float("nan")

    def column(value, missing, unit: str, long_name: str):
        values = [[[missing if row is None else value(row) for row in line] for line in plane] for plane in grid]
        return ("model", "solver", "rtol"), np.array(values), {"units": unit, "long_name": long_name}

    columns = {
        "seconds": column(lambda row: row.seconds, nan, "s", "median time of a warm run"),
        "compile_seconds": column(lambda row: row.compile_seconds, nan, "s", "time to trace and compile"),
        "succeeded": column(lambda row: int(row.succeeded), 0, "1", "1 when the run reached its end"),
    }
    for name, meaning in _COUNTS.items():
        columns[name] = column(lambda row, name=name: getattr(row, name), 0, "1", meaning)
    for name, unit in UNITS.items():
        meaning = f"largest error of the {name}"
        columns[f"{name}_error"] = column(lambda row, name=name: row.errors[name], nan, unit, meaning)
        meaning = f"largest error of the {name} by the estimate of run.error"
        columns[f"{name}_estimate"] = column(lambda row, name=name: row.estimates[name], nan, unit, meaning)
    for name, (unit, meaning) in STATISTICS.items():
        if any(row is not None and name in row.statistics for plane in grid for line in plane for row in line):
            columns[name] = column(lambda row, name=name: row.statistics.get(name, nan), nan, unit, meaning)
    return columns


def _of_references(result: WorkPrecision) -> dict:
    references = [result.references[model] for model in result.models]
    columns = {}
    for name, unit in UNITS.items():
        errors, peaks = [one.errors[name] for one in references], [one.scales[name] for one in references]
        apart = {"units": unit, "long_name": f"difference of the two reference runs, {name}"}
        peak = {"units": unit, "long_name": f"peak of the {name}, to which errors may be related"}
        columns[f"{name}_reference_error"] = ("model", errors, apart)
        columns[f"{name}_peak"] = ("model", peaks, peak)
    horizons = [result.t1 if one.horizon is None else one.horizon for one in references]
    until = {"units": "s", "long_name": "time until which errors are measured"}
    return {**columns, "horizon": ("model", horizons, until)}


def _figures_of(result: WorkPrecision, model: str) -> "dict[str, Figure]":
    """The figures of one model by name: `work_precision`, `steps`, and `statistics` where histories do not repeat.

    Args:
        result: the study.
        model: one of `result.models`.
    """
    from spherejax.output.plot.work_precision import statistics_figure, steps_figure, work_precision_figure

    diagram = _diagram_of(result, model)
    drawn = {"work_precision": work_precision_figure(diagram), "steps": steps_figure(diagram)}
    parted = result.references[model].parted
    if diagram.statistics and parted is not None:
        title = (
            f"{_named(result, model)}: statistics from {parted:.3g} s, when tight runs have parted, to {result.t1:g} s"
        )
        drawn["statistics"] = statistics_figure(diagram, title)
    return drawn


def _named(result: WorkPrecision, model: str) -> str:
    """A model with the mechanism that it is of."""
    return ", ".join(filter(None, (result.name, model)))


def _diagram_of(result: WorkPrecision, model: str) -> "WorkDiagram":
    """What the figures of one model show."""
    from spherejax.output.plot.work_precision import Statistic, WorkCurve, WorkDiagram

    reference = result.references[model]
    rows = [row for row in result.rows_of(model) if row.succeeded]
    curves = []
    for solver in dict.fromkeys(row.solver for row in rows):
        own = [row for row in rows if row.solver == solver]
        curves.append(
            WorkCurve(
                solver,
                [row.rtol for row in own],
                [row.seconds for row in own],
                [row.n_steps for row in own],
                {name: [row.errors[name] for row in own] for name in UNITS},
                {name: [row.statistics[name] for row in own] for name in own[0].statistics},
            )
        )
    known = reference.members[0] if reference.members else {}
    columns = {name: [member[name] for member in reference.members] for name in known}
    frontiers = {name: result.frontier(model, name) for name in UNITS}
    failed = list(dict.fromkeys(row.solver for row in result.rows_of(model) if not row.succeeded))
    return WorkDiagram(
        f"{_named(result, model)}: what accuracy costs, {result.t1:g} s of motion\n{result.advice[model]}",
        curves,
        UNITS,
        {name: reference.floor(name) for name in UNITS},
        {name: ([p.seconds for p in points], [p.error for p in points]) for name, points in frontiers.items()},
        {
            name: Statistic(*_PANELS[name], float(np.mean(values)), float(np.std(values, ddof=1)))
            for name, values in columns.items()
        },
        f"did not finish at every tolerance: {', '.join(failed)}" if failed else "",
    )


def _overview_of(result: WorkPrecision) -> "Figure":
    """The efficient runs of all models in one figure.

    Args:
        result: the study.
    """
    from spherejax.output.plot.work_precision import frontiers_figure

    runs = {
        model: [(p.seconds, p.error, f"{p.solver} {p.rtol:.0e}") for p in result.frontier(model)]
        for model in result.models
    }
    what = f"{result.t1:g} s of motion: the best run of each model for every error"
    title = f"{result.name}: what accuracy costs, {what}" if result.name else f"What accuracy costs, {what}"
    return frontiers_figure(runs, title)

"""What a comparison of the joint models is about, one mechanism and what of it is looked at; and what it finds.

A `Subject` says everything that is particular to a mechanism; `spherejax.studies.compare` does the rest. Any scene with
a joint that can take the models is one (`spherejax.studies.subjects.own`); the paper's two mechanisms are two more,
with figures by the paper's numbers.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import diffrax
import numpy as np

from spherejax.model.scene import Scene
from spherejax.motion.results.energy_parts import ROUNDED_LOSS
from spherejax.motion.results.reported import Reported
from spherejax.motion.results.trajectory import Trajectory
from spherejax.output.plot.curves import Curves
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.studies.cases import Case, LimitStudy, Study, numbers_of
from spherejax.studies.comparison_page import page_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from spherejax.output.report.page import Page

RTOL = 1e-8
"""Relative tolerance of all runs; with dry friction the four-bar's rocker is then within 1e-11 m of a run at 1e-10."""

SceneOf = Callable[[AbstractSphericalModel], Scene]
"""Makes the scene from the model of the studied joint."""


ROUNDED_GAP = 1e-9
"""Eccentricity by the reference length below which a joint is closed: 1e-13 m in a clearance of 0.1 mm."""


class TableColumn(NamedTuple):
    """A column of the table of models.

    Attributes:
        head: for people, with unit.
        value: in the unit of the head, from a row; None where there is nothing to say.
        text: how it is printed: a format for numbers, or a function from the value to a text.
        rounding: magnitude, in the unit of the head, below which a number is printed as `~0`.
    """

    head: str
    value: "Callable[[ModelRow], Any]"
    text: str | Callable[[Any], str] = ".4g"
    rounding: float = 0.0

    def cell(self, row: "ModelRow") -> str:
        """What the table shows."""
        value = self.value(row)
        if callable(self.text):
            return self.text(value)
        if value is not None and 0 < abs(value) < self.rounding:
            return "~0"
        return "-" if value is None or value != value else f"{value:{self.text}}"


class TableOf(NamedTuple):
    """A further table.

    Attributes:
        title: what it shows.
        heads: of the columns, with units.
        rows: cells as text.
    """

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


class Length(NamedTuple):
    """How long a motion is, and how finely it is looked at.

    Attributes:
        seconds: length of the motion [s].
        interval: of the samples [s].
        fine: until when [s] and at which interval [s] the beginning is sampled; None: as the rest.
        n_studies: how many parameter studies are run; None: all.
        limits: whether the limits are run.
        fixed: whether the fixed method is run.
    """

    seconds: float
    interval: float
    fine: tuple[float, float] | None = None
    n_studies: int | None = None
    limits: bool = True
    fixed: bool = True

    @property
    def ts(self) -> np.ndarray:
        """Sample times [s], shape (n,)."""
        usual = np.linspace(0.0, self.seconds, round(self.seconds / self.interval) + 1)
        if self.fine is None:
            return usual
        until, interval = self.fine
        first = np.linspace(0.0, until, round(until / interval) + 1)
        return np.concatenate([first, usual[usual > until + 0.5 * interval]])


@dataclass(frozen=True)
class Subject:
    """One mechanism whose joint models are compared, and what of it is looked at.

    Attributes:
        name: what it is called.
        build: the scene from the model of the studied joint.
        joint: the joint whose model changes.
        models: the cases that are compared, by short name, an ideal one among them.
        full: the motion of the usual comparison.
        quick: that of the quick one.
        body: the body whose motion is compared; None for that of the studied joint's two which the models change most.
        axis: along or about which axis, as in `Curves`; None for that of the body's largest motion.
        columns: of the table; None for `usual_columns`.
        measures: numbers of a run that its row shall hold, by name.
        figures: functions that draw the figures, by file name without suffix; of a comparison that is not done yet,
            those for which all is known.
        figures_ahead: those of them that need no run.
        numbers: what stands before the names of figures and studies, by name: `{"models": "fig18"}`.
        summaries: further tables.
        remarks: sentences below the tables.
        studies: parameter studies, from the models.
        limits: limits to the ideal joint, from the models.
        t_limits: length of the motion in the limits [s].
        reference: what eccentricities of all models are compared with [m].
        tracks_work: whether the work that the studied joint absorbs is integrated.
        fixed_solver: a method that all models are timed with besides the automatic choice.
        rtol: relative tolerance of all runs.
    """

    name: str
    build: SceneOf
    joint: str
    models: Mapping[str, Case]
    full: Length
    quick: Length
    figures: "Callable[[Comparison], dict[str, Callable]]"
    body: str | None = None
    axis: str | None = None
    columns: "Sequence[TableColumn] | None" = None
    figures_ahead: "Callable[[Subject], dict[str, Callable]]" = field(default=lambda subject: {})
    measures: Callable[[Trajectory, Curves], Mapping[str, float]] = field(default=lambda run, curves: {})
    numbers: Mapping[str, str] = field(default_factory=dict)
    summaries: "Callable[[Comparison], list[TableOf]]" = field(default=lambda comparison: [])
    remarks: "Callable[[Comparison], list[str]]" = field(default=lambda comparison: [])
    studies: Callable[[Mapping[str, Case]], list[Study]] = field(default=lambda models: [])
    limits: Callable[[Mapping[str, Case]], list[LimitStudy]] = field(default=lambda models: [])
    t_limits: float = 0.0
    reference: float = 1e-4
    tracks_work: bool = False
    fixed_solver: diffrax.AbstractSolver | None = None
    rtol: float = RTOL

    @property
    def ideal(self) -> str:
        """Name of the ideal model, which the others are compared with."""
        return next(name for name, case in self.models.items() if case.kind == "ideal")

    @property
    def parameters(self) -> str:
        """Numbers of the models, for titles."""
        return numbers_of(self.models)

    def numbered(self, name: str) -> str:
        """The file name of a figure."""
        return f"{self.numbers[name]}_{name}" if name in self.numbers else name

    def shown_columns(self, comparison: "Comparison") -> "Sequence[TableColumn]":
        """The columns of the table."""
        return usual_columns(comparison) if self.columns is None else self.columns


def usual_columns(comparison: "Comparison") -> "Sequence[TableColumn]":
    """What is said of any mechanism."""
    subject = comparison.subject
    turns = any(one.turns for one in comparison.models.values())
    peak = f"peak {'angular ' if turns else ''}acceleration [{'rad' if turns else 'm'}/s^2]"
    unit, factor = ("mJ", 1e3) if _is_small([row.lost_energy for row in comparison.rows]) else ("J", 1.0)
    moved = [float(np.nanmax(np.asarray(run.kinetic_energy), initial=0.0)) for run in comparison.runs.values()]
    least_loss = ROUNDED_LOSS * max(moved, default=0.0)
    gap = f"{1e3 * subject.reference:.2f} mm" if subject.reference >= 1e-5 else f"{1e6 * subject.reference:.3g} um"
    of_rows = {name for row in comparison.rows for name in row.measures}
    measured = [_measured_column(name, unit, factor) for name in sorted(of_rows)]
    return (
        TableColumn(f"energy lost [{unit}]", lambda row: factor * row.lost_energy, rounding=factor * least_loss),
        TableColumn(peak, lambda row: row.peak_acceleration),
        *measured,
        TableColumn(f"max |e| / {gap}", lambda row: row.eccentricity_ratio, rounding=ROUNDED_GAP),
        TableColumn("onsets", lambda row: row.n_onsets, "d"),
        TableColumn("steps", lambda row: row.n_steps, ",d"),
        TableColumn("warm run [s]", lambda row: row.seconds, ".3g"),
        TableColumn("time ratio", lambda row: row.time_ratio, ".3g"),
        TableColumn(
            "determined until [s]", lambda row: row.determined_until, lambda t: "the end" if t is None else f"{t:.3g}"
        ),
    )


def _measured_column(name: str, unit: str, factor: float) -> TableColumn:
    """A column of a measure; an energy is shown in the unit that the lost energy has beside it."""
    scale = factor if name.endswith(" [J]") else 1.0
    shown = name.replace(" [J]", f" [{unit}]")

    def value(row):
        found = row.measures.get(name)
        return None if found is None else scale * found

    return TableColumn(shown, value)


def _is_small(energies: Sequence[float]) -> bool:
    """Whether energies [J] are told in mJ."""
    return all(abs(energy) < 1.0 for energy in energies if np.isfinite(energy))


# What is found -----------------------------------------------------------------------------------------------------


class Timed(NamedTuple):
    """What a model costs with one method.

    Attributes:
        n_steps: steps of the integrator.
        seconds: median time of a warm run with few samples [s].
        time_ratio: `seconds` divided by those of the ideal joint with the same method.
    """

    n_steps: int
    seconds: float
    time_ratio: float


@dataclass(frozen=True)
class ModelRow:
    """One joint model in the table.

    Attributes:
        name: short name of the model, e.g. `"friction"`.
        label: name for people.
        lost_energy: energy lost until the end [J]: what the mechanical energy has fallen by, and what was put in.
        peak_acceleration: largest magnitude of the body's acceleration at the samples, along the axis on which it is
            followed [m/s^2], or about it [rad/s^2].
        eccentricity_ratio: largest |e| / the subject's reference length [-]; for every model the same.
        n_onsets: contact onsets; None for a model that does not locate them.
        n_steps: steps of the integrator.
        seconds: median time of a warm run with few samples [s].
        time_ratio: `seconds` divided by those of the ideal joint.
        determined_until: `run.determined_until`, until when the motion is determined [s]; None when that is the end.
        method: which integrator, and why.
        measures: further numbers, by name; see `Subject.measures`.
        fixed: what the run costs with the subject's fixed method, or None.
        failure: why and when the run stopped; empty for one that reached the end.
    """

    name: str
    label: str
    lost_energy: float
    peak_acceleration: float
    eccentricity_ratio: float
    n_onsets: int | None
    n_steps: int
    seconds: float
    time_ratio: float
    determined_until: float | None
    method: str
    measures: Mapping[str, float] = field(default_factory=dict)
    fixed: Timed | None = None
    failure: str = ""


@dataclass(frozen=True)
class StudyResult:
    """The curves of one parameter study.

    Attributes:
        study: what was varied.
        curves: one for each case.
    """

    study: Study
    curves: list[Curves]

    @property
    def summary(self) -> list[tuple[str, float, float]]:
        """Label, lost energy [J] and peak acceleration [m/s^2, rad/s^2] of each case."""
        return [(one.label, one.lost_energy, one.peak_acceleration) for one in self.curves]


@dataclass(frozen=True)
class LimitResult:
    """Deviation from the ideal motion as a parameter tends to its limit.

    Attributes:
        label: the joint model, with the parameters that stay.
        parameter: name and unit.
        values: values of the parameter.
        deviations: largest deviation of the body's position from the ideal motion [m, rad]; NaN where a run failed.
        order: power of the parameter that is expected near the limit.
        kind: short name of the joint model.
    """

    label: str
    parameter: str
    values: list[float]
    deviations: list[float]
    order: int | None
    kind: str = ""


@dataclass(frozen=True)
class Comparison(Reported):
    """Everything that `compare` found; prints as tables.

    Attributes:
        t_end: length of the motion [s].
        rows: the table, one row for each model.
        models: the curves of the models by name.
        runs: their trajectories by name.
        studies: parameter studies.
        limits: limits to the ideal joint, over `t_limits` seconds.
        t_limits: length of the motion in the limits [s].
        determined: what of `determined_until` is known while there are no rows yet.
        subject: the mechanism.
    """

    t_end: float
    rows: list[ModelRow]
    models: dict[str, Curves]
    runs: dict[str, Trajectory]
    studies: list[StudyResult] = field(default_factory=list)
    limits: list[LimitResult] = field(default_factory=list)
    t_limits: float = 0.0
    determined: Mapping[str, float | None] = field(default_factory=dict)
    subject: Subject = field(kw_only=True)

    @property
    def determined_until(self) -> dict[str, float | None]:
        """Until when each model's motion is determined [s], by short name; None where that is the end."""
        return {**self.determined, **{row.name: row.determined_until for row in self.rows}}

    @property
    def ideal(self) -> Curves:
        """The curves of the ideal joint, which the others are compared with."""
        return self.models[self.subject.ideal]

    @property
    def followed(self) -> str:
        """Which motion is compared, in words."""
        one = self.ideal
        return f"{one.body}, {f'angle about {one.axis[-1]}' if one.turns else one.axis}"

    @property
    def tables(self) -> list[TableOf]:
        """The table of the models, what else the mechanism has to say, and a table for each parameter study."""
        subject = self.subject
        columns = subject.shown_columns(self)
        rows = [(row.label, *(column.cell(row) for column in columns)) for row in self.rows]
        title = f"Joint models of {subject.joint}, {self.t_end:g} s of motion ({self.followed}): {subject.parameters}"
        first = TableOf(title, ("model", *(column.head for column in columns)), rows)
        return [first, *subject.summaries(self), *(self._table_of(result) for result in self.studies)]

    def _table_of(self, result: StudyResult) -> TableOf:
        is_small = _is_small([lost for _, lost, _ in result.summary])
        factor, unit = (1e3, "mJ") if is_small else (1.0, "J")
        peak = "peak angular acceleration [rad/s^2]" if self.ideal.turns else "peak acceleration [m/s^2]"
        rows = [(label, f"{factor * lost:.4g}", f"{peak:.4g}") for label, lost, peak in result.summary]
        name = self.subject.numbers.get(result.study.name, result.study.name)
        title = f"{name}: {result.study.title}".replace("\n", " ")
        return TableOf(title, ("case", f"energy lost [{unit}]", peak), rows)

    @property
    def remarks(self) -> list[str]:
        """Sentences below the tables: which runs stopped, and what the mechanism has to say."""
        failed = [f"{row.label}: {row.failure}" for row in self.rows if row.failure]
        return failed if failed else self.subject.remarks(self)

    def __str__(self) -> str:
        texts = [f"{one.title}\n{_as_text(one)}" for one in self.tables]
        return "\n\n".join([*texts, *self.remarks])

    def figures(self) -> "dict[str, Figure]":
        """All figures, by the names that `spherejax compare` gives their files."""
        return {name: draw() for name, draw in self.subject.figures(self).items()}

    def report_page(self, title: str, scene: Scene | None) -> "Page":
        """The page that `report` writes."""
        return page_of(self, title, scene)


def _as_text(table: TableOf) -> str:
    """A table with aligned columns."""
    lines = [table.heads, *table.rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(table.heads))]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if i else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        )
        for line in lines
    )

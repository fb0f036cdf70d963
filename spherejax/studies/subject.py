"""What a comparison of the joint models is about, one mechanism and what of it is looked at; and what it finds.

A `Subject` says everything that is particular to a mechanism; `spherejax.studies.compare` does the rest. Another
mechanism is one more file in `spherejax.studies.subjects`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import diffrax
import numpy as np

from spherejax.model.scene import Scene
from spherejax.motion.results.reported import Reported
from spherejax.motion.results.trajectory import Trajectory
from spherejax.output.plot.curves import Curves
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.laws.films import AbstractFilm
from spherejax.studies.cases import Case, LimitStudy, Study, film_name
from spherejax.studies.comparison_page import page_of

if TYPE_CHECKING:
    from spherejax.output.report.page import Page

SceneOf = Callable[[AbstractSphericalModel], Scene]
"""Makes the scene from the model of the studied joint."""


class TableColumn(NamedTuple):
    """A column of the table of models.

    Attributes:
        head: for people, with unit.
        value: in the unit of the head, from a row; None where there is nothing to say.
        text: how it is printed: a format for numbers, or a function from the value to a text.
    """

    head: str
    value: "Callable[[ModelRow], Any]"
    text: str | Callable[[Any], str] = ".4g"

    def cell(self, row: "ModelRow") -> str:
        """What the table shows."""
        value = self.value(row)
        if callable(self.text):
            return self.text(value)
        return "-" if value is None else f"{value:{self.text}}"


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
    """One mechanism whose joint models are compared.

    Attributes:
        name: on the command line.
        build: the scene from the model of the studied joint.
        body: the body whose motion is compared.
        joint: the joint whose model changes.
        models: the cases that are compared, by short name, the ideal one among them; `film=` is that of the lubricated
            joint, of `studies` and `limits` as well.
        parameters: of the models, for titles.
        full: the motion of the usual comparison.
        quick: that of the quick one.
        columns: of the table.
        measures: numbers of a run that its row shall hold, by name.
        figures: functions that draw the figures, by file name without suffix; of a comparison that is not done yet,
            those for which all is known.
        figures_ahead: those of them that need no run.
        summaries: further tables.
        remarks: sentences below the tables.
        studies: parameter studies.
        limits: limits to the ideal joint.
        t_limits: length of the motion in the limits [s].
        reference: what eccentricities of all models are compared with [m].
        apart: two runs have parted when the heights of the body differ by this much [m].
        tracks_work: whether the work that the studied joint absorbs is integrated.
        fixed_solver: a method that all models are timed with besides the automatic choice.
    """

    name: str
    build: SceneOf
    body: str
    joint: str
    models: Callable[..., dict[str, Case]]
    parameters: str
    full: Length
    quick: Length
    columns: Sequence[TableColumn]
    figures: "Callable[[Comparison], dict[str, Callable]]"
    figures_ahead: "Callable[[Subject], dict[str, Callable]]" = field(default=lambda subject: {})
    measures: Callable[[Trajectory, Curves], Mapping[str, float]] = field(default=lambda run, curves: {})
    summaries: "Callable[[Comparison], list[TableOf]]" = field(default=lambda comparison: [])
    remarks: "Callable[[Comparison], list[str]]" = field(default=lambda comparison: [])
    studies: Callable[..., list[Study]] = field(default=lambda film=None: [])
    limits: Callable[..., list[LimitStudy]] = field(default=lambda film=None: [])
    t_limits: float = 0.0
    reference: float = 1e-4
    apart: float = 1e-5
    tracks_work: bool = False
    fixed_solver: diffrax.AbstractSolver | None = None

    def with_film(self, film: AbstractFilm) -> "Subject":
        """The same comparison with another film in the lubricated joint."""
        told = self.parameters.replace("0.4 Pa s", f"0.4 Pa s ({film_name(film)})")
        asked = {name: partial(getattr(self, name), film=film) for name in ("models", "studies", "limits")}
        return replace(self, parameters=told, **asked)


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
        lost_energy: mechanical energy lost until the end [J].
        peak_acceleration: largest |z acceleration| of the body at the samples [m/s^2].
        eccentricity_ratio: largest |e| / the subject's reference length [-]; for every model the same.
        n_onsets: contact onsets; None for a model that does not locate them.
        n_steps: steps of the integrator.
        seconds: median time of a warm run with few samples [s].
        time_ratio: `seconds` divided by those of the ideal joint.
        horizon: until when the motion does not depend on the tolerance [s]; None when that is the end.
        method: which integrator, and why.
        measures: further numbers, by name; see `Subject.measures`.
        fixed: what the run costs with the subject's fixed method, or None.
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
    horizon: float | None
    method: str
    measures: Mapping[str, float] = field(default_factory=dict)
    fixed: Timed | None = None


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
        """Label, lost energy [J] and peak |z acceleration| [m/s^2] of each case."""
        return [
            (one.label, -float(one.energy_change[-1]), float(np.max(np.abs(one.acceleration)))) for one in self.curves
        ]


@dataclass(frozen=True)
class LimitResult:
    """Deviation from the ideal motion as a parameter tends to its limit.

    Attributes:
        label: the joint model, with the parameters that stay.
        parameter: name and unit.
        values: values of the parameter.
        deviations: largest deviation of the body's height from the ideal motion [m].
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
    """Everything that `compare` found.

    Attributes:
        t_end: length of the motion [s].
        rows: the table, one row for each model.
        models: the curves of the five models by short name.
        runs: their trajectories by short name.
        studies: parameter studies.
        limits: limits to the ideal joint, over `t_limits` seconds.
        t_limits: length of the motion in the limits [s].
        parted: the horizons that are known while there are no rows yet.
        subject: the mechanism.
    """

    t_end: float
    rows: list[ModelRow]
    models: dict[str, Curves]
    runs: dict[str, Trajectory]
    studies: list[StudyResult] = field(default_factory=list)
    limits: list[LimitResult] = field(default_factory=list)
    t_limits: float = 0.0
    parted: Mapping[str, float | None] = field(default_factory=dict)
    subject: Subject = field(kw_only=True)

    @property
    def horizons(self) -> dict[str, float | None]:
        """Until when each model's motion does not depend on the tolerance [s], by short name."""
        return {**self.parted, **{row.name: row.horizon for row in self.rows}}

    def report_page(self, title: str, scene: Scene | None) -> "Page":
        """The page that `report` writes."""
        return page_of(self, title, scene)

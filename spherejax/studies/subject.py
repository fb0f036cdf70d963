"""What a comparison of the joint models is about: one mechanism, and what of it is looked at.

A `Subject` says everything that is particular to a mechanism; `spherejax.studies.compare` does the rest. Another
mechanism is one more file in `spherejax.studies.subjects`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import diffrax
import numpy as np

from spherejax.model.scene import Scene
from spherejax.motion.trajectory import Trajectory
from spherejax.output.plot.curves import Curves
from spherejax.physics.joints import AbstractSphericalModel
from spherejax.studies.cases import Case, LimitStudy, Study

if TYPE_CHECKING:
    from spherejax.studies.compare import Comparison, Row

SceneOf = Callable[[AbstractSphericalModel], Scene]
"""Makes the scene from the model of the studied joint."""


class Column(NamedTuple):
    """A column of the table of models.

    Attributes:
        head: for people, with unit.
        value: in the unit of the head, from a row; None where there is nothing to say.
        text: how it is printed: a format for numbers, or a function from the value to a text.
    """

    head: str
    value: "Callable[[Row], Any]"
    text: str | Callable[[Any], str] = ".4g"

    def cell(self, row: "Row") -> str:
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
        models: the cases that are compared, by short name, the ideal one among them.
        parameters: of the models, for titles.
        full: the motion of the usual comparison.
        quick: that of the quick one.
        columns: of the table.
        measures: numbers of a run that its row shall hold, by name.
        figures: functions that draw the figures, by file name without suffix.
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
    models: Callable[[], dict[str, Case]]
    parameters: str
    full: Length
    quick: Length
    columns: Sequence[Column]
    figures: "Callable[[Comparison], dict[str, Callable]]"
    measures: Callable[[Trajectory, Curves], Mapping[str, float]] = field(default=lambda run, curves: {})
    summaries: "Callable[[Comparison], list[TableOf]]" = field(default=lambda comparison: [])
    remarks: "Callable[[Comparison], list[str]]" = field(default=lambda comparison: [])
    studies: Callable[[], list[Study]] = field(default=lambda: [])
    limits: Callable[[], list[LimitStudy]] = field(default=lambda: [])
    t_limits: float = 0.0
    reference: float = 1e-4
    apart: float = 1e-5
    tracks_work: bool = False
    fixed_solver: diffrax.AbstractSolver | None = None

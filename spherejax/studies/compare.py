"""The joint models against each other on one mechanism: the study behind `spherejax compare four-bar`.

Five models at a clearance of 0.10 mm (Figs 18 to 21), the influence of single parameters (Figs 10 to 17), and the
limits in which every model becomes the ideal joint. Everything is returned as data; drawing and printing are others'.

Motion without friction is chaotic: two runs that differ in the tolerance alone part after about half a second, and from
then on a history is one of many that are equally right. `horizon` finds that instant from two runs.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.gallery import four_bar
from spherejax.model.scene import Scene
from spherejax.motion.simulate import simulate
from spherejax.motion.trajectory import Trajectory
from spherejax.output.plot.curves import Curves, curves_of
from spherejax.physics.joints import AbstractSphericalModel, Ideal
from spherejax.studies.cases import Case, Study, five_models, limit_studies, parameter_studies

BODY, JOINT = "rocker", "coupler_rocker"
"""The body whose motion is compared and the joint whose model changes."""

RTOL = 1e-8
"""Relative tolerance of all runs. A run with dry friction then moves the rocker to within 1e-11 m of one at 1e-10."""

SAMPLE_INTERVAL = 1e-5
"""Interval of the samples [s], the paper's: an impact lasts for about 5e-5 s, so its peak is seen."""

CLEARANCE_OF_REFERENCE = 1e-4
"""The clearance that eccentricities of all models are compared with [m], also that of a bushing, which has none."""

APART = 1e-5
"""Two runs have parted when the rocker's heights differ by this much [m]: a tenth of the clearance."""

REPEATS = 3
"""Timed runs after one to warm up; their median counts."""

Report = Callable[[str, float], None]
"""Called with what has just been done and the share of the work that is done."""


@dataclass(frozen=True)
class Row:
    """One joint model in the table.

    Attributes:
        name: short name of the model, e.g. `"friction"`.
        label: name for people.
        lost_energy: mechanical energy lost until the end [J].
        peak_acceleration: largest |z acceleration| of the rocker at the samples [m/s^2].
        eccentricity_ratio: largest |e| / 0.10 mm [-]; for every model the same reference.
        n_onsets: contact onsets; None for a model that does not locate them.
        n_steps: steps of the integrator.
        seconds: median time of a warm run with few samples [s].
        time_ratio: `seconds` divided by those of the ideal joint.
        horizon: until when the motion does not depend on the tolerance [s]; None when that is the end.
        method: which integrator, and why.
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


@dataclass(frozen=True)
class StudyResult:
    """The curves of one parameter study.

    Attributes:
        study: what was varied.
        curves: one for each case.
        rows: (label, lost energy [J], peak |z acceleration| [m/s^2]) for each case.
    """

    study: Study
    curves: list[Curves]

    @property
    def summary(self) -> list[tuple[str, float, float]]:
        """Label, lost energy [J] and peak |z acceleration| [m/s^2] of each case."""
        return [(one.label, -float(one.energy_change[-1]), float(np.max(np.abs(one.acceleration)))) for one in self.curves]


@dataclass(frozen=True)
class LimitResult:
    """Deviation from the ideal motion as a parameter tends to its limit.

    Attributes:
        label: the joint model, with the parameters that stay.
        parameter: name and unit.
        values: values of the parameter.
        deviations: largest deviation of the rocker's height from the ideal motion [m].
        order: power of the parameter that is expected near the limit.
    """

    label: str
    parameter: str
    values: list[float]
    deviations: list[float]
    order: int | None


@dataclass(frozen=True)
class Comparison:
    """Everything that `compare` found.

    Attributes:
        t_end: length of the motion [s].
        rows: the table, one row for each model.
        models: the curves of the five models by short name.
        runs: their trajectories by short name.
        studies: parameter studies.
        limits: limits to the ideal joint, over `t_limits` seconds.
        t_limits: length of the motion in the limits [s].
    """

    t_end: float
    rows: list[Row]
    models: dict[str, Curves]
    runs: dict[str, Trajectory]
    studies: list[StudyResult] = field(default_factory=list)
    limits: list[LimitResult] = field(default_factory=list)
    t_limits: float = 0.0

    @property
    def horizons(self) -> dict[str, float | None]:
        """Until when each model's motion does not depend on the tolerance [s], by short name."""
        return {row.name: row.horizon for row in self.rows}


def _silent(what: str, share: float) -> None:
    del what, share


def compare(
    scene_of: Callable[[AbstractSphericalModel], Scene] = four_bar,
    *,
    quick: bool = False,
    report: Report = _silent,
) -> Comparison:
    """Simulate the five joint models, and unless quick the parameter studies and the limits.

    Args:
        scene_of: makes the scene from the model of the studied joint.
        quick: 0.2 s of motion instead of 2 s, one parameter study, no limits.
        report: called as the work goes on.

    Returns:
        The comparison.
    """
    t_end = 0.2 if quick else 2.0
    ts = jnp.linspace(0.0, t_end, round(t_end / SAMPLE_INTERVAL) + 1)
    models = five_models()
    studies = parameter_studies()[:1] if quick else parameter_studies()
    limits = [] if quick else limit_studies()
    done = _Progress(report, 3 * len(models) + len(_distinct(studies)) + 3 * len(limits))
    runs, curves = {}, {}
    for name, case in models.items():
        runs[name] = _run(scene_of, case, ts)
        curves[name] = curves_of(runs[name], case.label, body=BODY, joint=JOINT)
        done(f"simulated: {case.label}")
    horizons = {}
    for name, case in models.items():
        horizons[name] = horizon(scene_of, case, ts, runs[name])
        done(f"checked against a smaller tolerance: {case.label}")
    seconds = {}
    for name, case in models.items():
        seconds[name] = warm_seconds(scene_of, case, t_end)
        done(f"timed: {case.label}")
    rows = [_row(name, models[name], runs[name], curves[name], seconds, horizons[name]) for name in models]
    known = {case: curves[name] for name, case in models.items()}
    results = _study(scene_of, studies, ts, known, done)
    t_limits = 0.5
    found = [_limit(scene_of, study, jnp.linspace(0.0, t_limits, ts.shape[0]), done) for study in limits]
    return Comparison(t_end, rows, curves, runs, results, found, t_limits)


class _Progress:
    """Counts finished pieces of work and reports their share."""

    def __init__(self, report: Report, n_pieces: int):
        self.report, self.n_pieces, self.n_done = report, n_pieces, 0

    def __call__(self, what: str) -> None:
        self.n_done += 1
        self.report(what, min(1.0, self.n_done / self.n_pieces))


def _run(scene_of, case: Case, ts, rtol: float = RTOL) -> Trajectory:
    return simulate(scene_of(case.model()), ts, rtol=rtol, throw=True)


def _row(name: str, case: Case, run: Trajectory, one: Curves, seconds: Mapping[str, float], part: float | None) -> Row:
    return Row(
        name=name,
        label=case.label,
        lost_energy=-float(one.energy_change[-1]),
        peak_acceleration=float(np.max(np.abs(one.acceleration))),
        eccentricity_ratio=float(np.max(one.distance)) / CLEARANCE_OF_REFERENCE,
        n_onsets=int(np.sum(run.stats.n_onsets)) if run.system.contact_joints else None,
        n_steps=int(run.stats.n_steps),
        seconds=seconds[name],
        time_ratio=seconds[name] / seconds["ideal"],
        horizon=part,
        method=run.choice,
    )


def horizon(scene_of, case: Case, ts: Float[Array, " n"], run: Trajectory) -> float | None:
    """Until when the motion does not depend on the tolerance [s]; None when that is the end.

    The run is repeated at a hundredth of the tolerance (a stiff method at a tenth: it is of lower order and the hundredth
    would cost ten times more), and the heights of the rocker are compared with `APART`.
    """
    factor = 1e-1 if "Rodas" in run.choice else 1e-2
    finer = _run(scene_of, case, ts, rtol=factor * RTOL)
    difference = np.abs(np.asarray(run.position(BODY)[:, 2] - finer.position(BODY)[:, 2]))
    parted = np.flatnonzero(difference > APART)
    return float(ts[parted[0]]) if parted.size else None


def warm_seconds(scene_of, case: Case, t_end: float, *, n_samples: int = 201, repeats: int = REPEATS) -> float:
    """Median time of a run that is compiled already [s]; few samples, so that integration is timed and not saving."""
    ts = jnp.linspace(0.0, t_end, n_samples)
    jax.block_until_ready(_run(scene_of, case, ts).ys)
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(_run(scene_of, case, ts).ys)
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def _distinct(studies: Sequence[Study]) -> list[Case]:
    return list(dict.fromkeys(case for study in studies for case in study.cases))


def _study(scene_of, studies: Sequence[Study], ts, known: dict, done: _Progress) -> list[StudyResult]:
    """Curves of all studies; a case that occurs in several is simulated once."""
    known = dict(known)
    for case in _distinct(studies):
        if case not in known:
            known[case] = curves_of(_run(scene_of, case, ts), case.label, body=BODY, joint=JOINT)
        done(f"simulated: {case.label}")
    return [StudyResult(study, [_relabelled(known[c], c.label) for c in study.cases]) for study in studies]


def _relabelled(one: Curves, label: str) -> Curves:
    from dataclasses import replace

    return replace(one, label=label)


def _limit(scene_of, study, ts, done: _Progress) -> LimitResult:
    ideal = np.asarray(simulate(scene_of(Ideal()), ts, rtol=RTOL, throw=True).position(BODY)[:, 2])
    deviations = []
    for value in study.values:
        run = simulate(scene_of(study.model_of(value)), ts, rtol=RTOL, throw=True)
        deviations.append(float(np.max(np.abs(np.asarray(run.position(BODY)[:, 2]) - ideal))))
    for _ in range(3):
        done(f"limit: {study.label}")
    return LimitResult(study.label, study.parameter, list(study.values), deviations, study.order)


__all__ = ["Comparison", "LimitResult", "Row", "StudyResult", "compare", "horizon", "partial", "warm_seconds"]

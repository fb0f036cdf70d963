"""The joint models against each other on one mechanism: the study behind `spherejax compare four-bar`.

Five models at a clearance of 0.10 mm (Figs 18 to 21), the influence of single parameters (Figs 10 to 17), and
the limits in which every model becomes the ideal joint. Everything is returned as data; drawing and printing
are others'.

Motion without friction is chaotic: two runs that differ in the tolerance alone part after about half a
second, and from then on a history is one of many that are equally right. `horizon` finds that instant from
two runs.
"""

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
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
from spherejax.studies.cases import Case, LimitStudy, Study, five_models, limit_studies, parameter_studies

BODY, JOINT = "rocker", "coupler_rocker"
"""The body whose motion is compared and the joint whose model changes."""

RTOL = 1e-8
"""Relative tolerance of all runs; with dry friction the rocker is then within 1e-11 m of a run at 1e-10."""

SAMPLE_INTERVAL = 1e-5
"""Interval of the samples [s], the paper's: an impact lasts for about 5e-5 s, so its peak is seen."""

CLEARANCE_OF_REFERENCE = 1e-4
"""What eccentricities of all models are compared with [m], also that of a bushing, which has no clearance."""

APART = 1e-5
"""Two runs have parted when the rocker's heights differ by this much [m]: a tenth of the clearance."""

REPEATS = 3
"""Timed runs after one to warm up; their median counts."""

TIMED_SAMPLES = 201
"""Samples of the timed runs."""

T_LIMITS = 0.5
"""Length of the motion in the limits to the ideal joint [s]: dry motion is hardly chaotic until then."""

_VERBS = {
    "_curves": "simulated",
    "_curves_only": "simulated",
    "_run_for_timing": "prepared to be timed",
    "horizon": "compared with a smaller tolerance",
    "_limit": "limit",
}

SceneOf = Callable[[AbstractSphericalModel], Scene]
"""Makes the scene from the model of the studied joint."""

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
    scene_of: SceneOf = four_bar,
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
    t_end, t_limits = (0.2, 0.0) if quick else (2.0, T_LIMITS)
    ts = jnp.linspace(0.0, t_end, round(t_end / SAMPLE_INTERVAL) + 1)
    models = five_models()
    studies = parameter_studies()[:1] if quick else parameter_studies()
    limits = [] if quick else limit_studies()
    others = [case for case in _distinct(studies) if case not in models.values()]
    done = _Progress(report, 4 * len(models) + len(others) + len(limits))
    with _workers() as pool:
        # The slowest to compile first, so that no worker is left alone with one at the end.
        order = sorted(models, key=lambda name: -list(models).index(name))
        found = pool.each([partial(_curves, scene_of, models[name], ts) for name in order], done)
        runs = {name: found[order.index(name)][0] for name in models}
        curves = {name: found[order.index(name)][1] for name in models}
        pool.each([partial(_run_for_timing, scene_of, models[name], t_end) for name in order], done)
        apart = pool.each([partial(horizon, scene_of, case, ts, runs[name]) for name, case in models.items()], done)
        horizons = dict(zip(models, apart, strict=True))
        known = {case: curves[name] for name, case in models.items()}
        found = pool.each([partial(_curves_only, scene_of, case, ts) for case in others], done)
        known.update(zip(others, found, strict=True))
        t_short = jnp.linspace(0.0, t_limits, ts.shape[0])
        limit_results = pool.each([partial(_limit, scene_of, study, t_short) for study in limits], done)
    seconds = {}
    for name, case in models.items():  # alone on the machine
        seconds[name] = warm_seconds(scene_of, case, t_end)
        done(f"timed: {case.label}")
    rows = [_row(name, models[name], runs[name], curves[name], seconds, horizons[name]) for name in models]
    results = [StudyResult(study, [replace(known[c], label=c.label) for c in study.cases]) for study in studies]
    return Comparison(t_end, rows, curves, runs, results, limit_results, t_limits)


class _Progress:
    """Counts finished pieces of work and reports their share."""

    def __init__(self, report: Report, n_pieces: int):
        self.report, self.n_pieces, self.n_done = report, n_pieces, 0

    def __call__(self, what: str) -> None:
        self.n_done += 1
        self.report(what, min(1.0, self.n_done / self.n_pieces))


class _Pool:
    """Workers that compile and run at the same time; the results keep their order."""

    def __init__(self, executor: ThreadPoolExecutor):
        self.executor = executor

    def each(self, work: Sequence[partial], done: _Progress) -> list:
        """The results of all pieces of work, reported as they come."""
        futures = {self.executor.submit(piece): piece for piece in work}
        for future in as_completed(futures):
            future.result()
            piece = futures[future]
            done(f"{_VERBS[piece.func.__name__]}: {piece.args[1].label}")
        return [future.result() for future in futures]


@contextmanager
def _workers() -> Iterator[_Pool]:
    """As many workers as there are cores, four at most: each holds a run with 2e5 samples, 0.3 GB."""
    executor = ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1))
    try:
        yield _Pool(executor)
    finally:
        executor.shutdown(cancel_futures=True)


def _run(scene_of: SceneOf, case: Case, ts, rtol: float = RTOL) -> Trajectory:
    return simulate(scene_of(case.model()), ts, rtol=rtol, throw=True)


def _curves(scene_of: SceneOf, case: Case, ts) -> tuple[Trajectory, Curves]:
    run = _run(scene_of, case, ts)
    return run, curves_of(run, case.label, body=BODY, joint=JOINT)


def _curves_only(scene_of: SceneOf, case: Case, ts) -> Curves:
    return _curves(scene_of, case, ts)[1]


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


def horizon(scene_of: SceneOf, case: Case, ts: Float[Array, " n"], run: Trajectory) -> float | None:
    """Until when the motion does not depend on the tolerance [s]; None when that is the end.

    The run is repeated at a hundredth of the tolerance (a stiff method at a tenth: it is of lower order and
    the hundredth would cost ten times more), and the heights of the rocker are compared with `APART`.
    """
    factor = 1e-1 if "Rodas" in run.choice else 1e-2
    finer = _run(scene_of, case, ts, rtol=factor * RTOL)
    difference = np.abs(np.asarray(run.position(BODY)[:, 2] - finer.position(BODY)[:, 2]))
    parted = np.flatnonzero(difference > APART)
    return float(ts[parted[0]]) if parted.size else None


def _run_for_timing(scene_of: SceneOf, case: Case, t_end: float) -> Trajectory:
    """A run with few samples, so that integration is timed and not saving."""
    run = simulate(scene_of(case.model()), jnp.linspace(0.0, t_end, TIMED_SAMPLES), rtol=RTOL, throw=True)
    return jax.block_until_ready(run)


def warm_seconds(scene_of: SceneOf, case: Case, t_end: float, *, repeats: int = REPEATS) -> float:
    """Median time of a run that is compiled already [s]."""
    _run_for_timing(scene_of, case, t_end)
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        _run_for_timing(scene_of, case, t_end)
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def _distinct(studies: Sequence[Study]) -> list[Case]:
    return list(dict.fromkeys(case for study in studies for case in study.cases))


def _limit(scene_of: SceneOf, study: LimitStudy, ts) -> LimitResult:
    ideal = np.asarray(simulate(scene_of(Ideal()), ts, rtol=RTOL, throw=True).position(BODY)[:, 2])
    deviations = []
    for value in study.values:
        run = simulate(scene_of(study.model_of(value)), ts, rtol=RTOL, throw=True)
        deviations.append(float(np.max(np.abs(np.asarray(run.position(BODY)[:, 2]) - ideal))))
    return LimitResult(study.label, study.parameter, list(study.values), deviations, study.order)

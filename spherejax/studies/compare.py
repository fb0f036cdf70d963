"""The joint models against each other on one mechanism: the study behind `spherejax compare`.

Five models (Figs 18 to 21 of the paper for the four-bar, 23 to 25 for the suspension), the influence of single
parameters (Figs 10 to 17), and the limits in which every model becomes the ideal joint. What is particular to a
mechanism is its `Subject`. Everything is returned as data; drawing and printing are others'.

Motion without friction may be chaotic: two runs that differ in the tolerance alone part, and from then on a history is
one of many that are equally right. `horizon` finds that instant from two runs.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.simulate import simulate
from spherejax.motion.solvers.automatic import choose_solver, stiffest
from spherejax.output.plot.curves import Curves, curves_of
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.ideal import Ideal
from spherejax.studies.cases import Case, LimitStudy, Study
from spherejax.studies.subject import Comparison, LimitResult, ModelRow, StudyResult, Subject, Timed
from spherejax.studies.subjects.four_bar import FOUR_BAR
from spherejax.studies.workers import Piece, Progress, Report, silent, workers

RTOL = 1e-8
"""Relative tolerance of all runs; with dry friction the four-bar's rocker is then within 1e-11 m of a run at 1e-10."""

REPEATS = 3
"""Timed runs after one to warm up; their median counts."""

TIMED_SAMPLES = 201
"""Samples of the timed runs."""


class Meanwhile(NamedTuple):
    """Work for who waits for a comparison, in steps.

    Attributes:
        ahead: what needs no run.
        as_found: what needs the runs of the models, and more as it is found: from a function that says what is known
            now, a comparison without rows, with the studies that are complete.
    """

    ahead: Iterator[Any]
    as_found: Callable[[Callable[[], Comparison]], Iterator[Any]]


def compare(
    subject: Subject = FOUR_BAR, *, quick: bool = False, report: Report = silent, meanwhile: Meanwhile | None = None
) -> Comparison:
    """Simulate the joint models of a mechanism, the parameter studies and the limits.

    Args:
        subject: the mechanism, and what is looked at.
        quick: a shorter motion and fewer studies, as the subject says.
        report: called as the work goes on.
        meanwhile: work for this thread while others compile; it may not be done when this returns.

    Returns:
        The comparison.
    """
    length = subject.quick if quick else subject.full
    t_end, t_limits = length.seconds, subject.t_limits if length.limits else 0.0
    ts = jnp.asarray(length.ts)
    models = subject.models()
    studies = subject.studies()[: length.n_studies]
    limits = subject.limits() if length.limits else []
    fixed = subject.fixed_solver if length.fixed else None
    solvers = (None,) if fixed is None else (None, fixed)
    others = [case for case in _distinct(studies) if case not in models.values()]
    ahead, as_found = (None, lambda so_far: None) if meanwhile is None else meanwhile
    done = Progress(report, (2 + 2 * len(solvers)) * len(models) + len(others) + len(limits))
    with workers(done) as pool:
        # The slowest to compile first, so that no worker is left alone with one at the end.
        order = list(reversed(models))
        found = pool.each([_piece("simulated", _curves, subject, models[name], ts) for name in order], ahead)
        runs = {name: found[order.index(name)][0] for name in models}
        curves = {name: found[order.index(name)][1] for name in models}
        t_short = jnp.linspace(0.0, t_limits, ts.shape[0])
        known = {case: curves[name] for name, case in models.items()}
        horizons: dict[str, float | None] = {}
        limits_found: dict[LimitStudy, LimitResult] = {}
        timed: dict[Any, Trajectory] = {}
        # All that is left at once, what compiles first; but for the horizons, which figures wait for.
        work: list[tuple[dict, Any, Piece]] = [
            *((known, case, _piece("simulated", _curves_only, subject, case, ts)) for case in others),
            *(
                (horizons, name, _piece("compared with a smaller tolerance", horizon, subject, case, ts, runs[name]))
                for name, case in models.items()
            ),
            *((limits_found, study, _piece("limit", _limit, subject, study, t_short)) for study in limits),
            *(
                (
                    timed,
                    (name, number),
                    _piece("prepared to be timed", _run_for_timing, subject, models[name], t_end, solver),
                )
                for number, solver in enumerate(solvers)
                for name in order
            ),
        ]

        def heard(at: int, result: Any) -> None:
            place, name, _ = work[at]
            place[name] = result

        def so_far() -> Comparison:
            complete = [study for study in studies if all(case in known for case in study.cases)]
            results = [_study_result(study, known) for study in complete]
            return Comparison(t_end, [], curves, runs, results, t_limits=t_limits, parted=horizons, subject=subject)

        pool.each([piece for *_, piece in work], as_found(so_far), heard)
    limit_results = [limits_found[study] for study in limits]
    usual = _timed(subject, models, t_end, None, done)
    by_fixed = {} if fixed is None else _timed(subject, models, t_end, fixed, done)
    rows = [
        _row(subject, name, models[name], runs[name], curves[name], usual[name], horizons[name], by_fixed.get(name))
        for name in models
    ]
    results = [_study_result(study, known) for study in studies]
    return Comparison(t_end, rows, curves, runs, results, limit_results, t_limits, subject=subject)


def _study_result(study: Study, known: Mapping[Case, Curves]) -> StudyResult:
    return StudyResult(study, [replace(known[case], label=case.label) for case in study.cases])


def _piece(verb: str, work, subject: Subject, case: Case | LimitStudy, *arguments) -> Piece:
    return Piece(f"{verb}: {case.label}", partial(work, subject, case, *arguments))


def _run(subject: Subject, case: Case, ts, rtol: float = RTOL) -> Trajectory:
    return simulate(subject.build(case.model()), ts, rtol=rtol, track_work=subject.tracks_work, throw=True)


def _curves(subject: Subject, case: Case, ts) -> tuple[Trajectory, Curves]:
    run = _run(subject, case, ts)
    return run, curves_of(run, case.label, body=subject.body, joint=subject.joint)


def _curves_only(subject: Subject, case: Case, ts) -> Curves:
    return _curves(subject, case, ts)[1]


def _row(
    subject: Subject,
    name: str,
    case: Case,
    run: Trajectory,
    one: Curves,
    timed: Timed,
    part: float | None,
    fixed: Timed | None,
) -> ModelRow:
    return ModelRow(
        name=name,
        label=case.label,
        lost_energy=-float(one.energy_change[-1]),
        peak_acceleration=float(np.max(np.abs(one.acceleration))),
        eccentricity_ratio=float(np.max(one.distance)) / subject.reference,
        n_onsets=int(np.sum(run.stats.n_onsets)) if run.system.contact_joints else None,
        n_steps=timed.n_steps,
        seconds=timed.seconds,
        time_ratio=timed.time_ratio,
        horizon=part,
        method=run.choice,
        measures=subject.measures(run, one),
        fixed=fixed,
    )


def horizon(subject: Subject, case: Case, ts: Float[Array, " n"], run: Trajectory) -> float | None:
    """Until when the motion does not depend on the tolerance [s]; None when that is the end.

    The run is repeated at a hundredth of the tolerance (a stiff method at a tenth: it is of lower order and
    the hundredth would cost ten times more), and the heights of the body are compared with `Subject.apart`.
    """
    factor = 1e-1 if "Rodas" in run.choice else 1e-2
    finer = _run(subject, case, ts, rtol=factor * RTOL)
    difference = np.abs(np.asarray(run.position(subject.body)[:, 2] - finer.position(subject.body)[:, 2]))
    parted = np.flatnonzero(difference > subject.apart)
    return float(ts[parted[0]]) if parted.size else None


def _run_for_timing(subject: Subject, case: Case, t_end: float, solver: diffrax.AbstractSolver | None) -> Trajectory:
    return _run_few_samples(subject.build(case.model()), t_end, solver)


def _run_few_samples(scene: Scene, t_end: float, solver: diffrax.AbstractSolver | None) -> Trajectory:
    """A run with few samples, so that integration is timed and not saving."""
    run = simulate(scene, jnp.linspace(0.0, t_end, TIMED_SAMPLES), rtol=RTOL, solver=solver, throw=True)
    return jax.block_until_ready(run)


def _timed(subject: Subject, models: Mapping[str, Case], t_end: float, solver, done: Progress) -> dict[str, Timed]:
    """What each model costs, alone on the machine."""
    found: dict[str, tuple[int, float]] = {}
    for name, case in models.items():
        found[name] = warm_run(subject.build(case.model()), t_end, solver)
        done(f"timed: {case.label}")
    ideal = found["ideal"][1]
    return {name: Timed(n_steps, seconds, seconds / ideal) for name, (n_steps, seconds) in found.items()}


def warm_run(
    scene: Scene, t_end: float, solver: diffrax.AbstractSolver | None = None, *, repeats: int = REPEATS
) -> tuple[int, float]:
    """Steps and median time [s] of a run that is compiled already."""
    n_steps = int(_run_few_samples(scene, t_end, solver).stats.n_steps)
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        _run_few_samples(scene, t_end, solver)
        times.append(time.perf_counter() - start)
    return n_steps, float(np.median(times))


def _distinct(studies: Sequence[Study]) -> list[Case]:
    return list(dict.fromkeys(case for study in studies for case in study.cases))


def _limit(subject: Subject, study: LimitStudy, ts) -> LimitResult:
    # With the account of the work, which nobody reads here: so are the programs those of the models' own runs. And all
    # by one method, for one program.
    models = [study.model_of(value) for value in study.values]
    systems = [compile_scene(subject.build(model), track_work=subject.tracks_work).system for model in models]
    solver = stiffest([choose_solver(system, RTOL) for system in systems]).solver

    def heights(model: AbstractSphericalModel, solver: diffrax.AbstractSolver | None) -> np.ndarray:
        run = simulate(subject.build(model), ts, rtol=RTOL, solver=solver, track_work=subject.tracks_work, throw=True)
        return np.asarray(run.position(subject.body)[:, 2])

    ideal = heights(Ideal(), None)
    deviations = [float(np.max(np.abs(heights(model, solver) - ideal))) for model in models]
    return LimitResult(study.label, study.parameter, list(study.values), deviations, study.order, study.kind)

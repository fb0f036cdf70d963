"""The joint models against each other on one mechanism: `sj.compare` and `spherejax compare`.

The models (Figs 18 to 21 of the paper for the four-bar, 23 to 25 for the suspension), the influence of single
parameters (Figs 10 to 17), and the limits in which every model becomes the ideal joint. What is particular to a
mechanism is its `Subject`. Everything is returned as data; drawing and printing are others'.

Motion without friction may be chaotic: two runs that differ in the tolerance alone part, and from then on a history is
one of many that are equally right. `run.determined_until` says when.
"""

import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene
from spherejax.motion.integration.status import SimulationWarning
from spherejax.motion.results.global_error import bodies_apart
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.simulate import simulate
from spherejax.motion.solvers.automatic import choose_solver, stiffest
from spherejax.motion.start.start_now import StartWarning
from spherejax.output.plot.curves import ROTATIONS, Curves, axis_of_motion, curves_of
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.studies.cases import Case, LimitStudy, Study
from spherejax.studies.subject import RTOL, Comparison, LimitResult, ModelRow, StudyResult, Subject, Timed
from spherejax.studies.subjects.own import own_mechanism
from spherejax.studies.workers import Piece, Progress, Report, silent, workers

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
    scene: Scene | Callable[..., Scene],
    t1: float = 2.0,
    *,
    joint: str | None = None,
    models: Mapping[str, AbstractSphericalModel] | None = None,
    body: str | None = None,
    axis: str | None = None,
    samples: int | None = None,
    studies: bool = False,
    rtol: float = RTOL,
    name: str = "",
    report: Report = silent,
) -> Comparison:
    """Simulate a mechanism with several models of one of its joints, and compare the motions and their cost.

    Each model is simulated, once more at a smaller tolerance (from when on is its motion chaotic?), and timed against
    the ideal joint. Programs are compiled side by side: five models take some 20 s the first time.

    Args:
        scene: the mechanism, or a builder: a function from a joint model to the scene.
        t1: length of the motion [s].

    Other args:
        joint: the joint whose model changes, a spherical one, or a revolute one: a journal in its bearing. Without it
            that which a builder gives the model, else the only joint that can take the models, or the only one of
            these that is not ideal.
        models: joint models by name, e.g. `{"dry": sj.Dry(clearance=1e-4), "wet": sj.Lubricated(clearance=1e-4)}`; an
            ideal one is added where there is none. By default those of `joint_models`, with the numbers of the joint's
            own model.
        body: the body whose motion is compared; that of the joint's two which the models change most when None.
        axis: along which world axis, `"x"`, `"y"` or `"z"`, or about which one, `"rotation.x"` and so on; that of the
            body's largest motion when None.
        samples: of each run; as many as show impacts of 0.05 ms when None, 200,001 at most.
        studies: whether the numbers of the models are varied as well, and the limits to the ideal joint are run: some
            40 further runs.
        rtol: relative tolerance of a step.
        name: of the mechanism, for titles.
        report: called as the work goes on, with what was done and the share that is done.

    Returns:
        The comparison: `print` it, or take its `rows`, `runs`, `figures()` and `report("page.html")`.

    Raises:
        SceneError: for a joint that is not there or cannot take a model; where several joints can, it names them.
    """
    subject = own_mechanism(
        scene, t1, joint=joint, models=models, body=body, axis=axis, samples=samples, rtol=rtol, name=name
    )
    return compare_models(subject, quick=not studies, report=report)


def compare_models(
    subject: Subject, *, quick: bool = False, report: Report = silent, meanwhile: Meanwhile | None = None
) -> Comparison:
    """Simulate the joint models of a mechanism, the parameter studies and the limits.

    Args:
        subject: the mechanism, and what is looked at.
        quick: a shorter motion and fewer studies, as the subject says.
        report: called as the work goes on.
        meanwhile: work for this thread while others compile; it may not be done when this returns.

    Returns:
        The comparison. A run that fails is a row with its diagnosis.
    """
    length = subject.quick if quick else subject.full
    t_end, t_limits = length.seconds, subject.t_limits if length.limits else 0.0
    ts = jnp.asarray(length.ts)
    models = subject.models
    studies = subject.studies(models)[: length.n_studies]
    limits = subject.limits(models) if length.limits else []
    fixed = subject.fixed_solver if length.fixed else None
    solvers = (None,) if fixed is None else (None, fixed)
    others = [case for case in _distinct(studies) if case not in models.values()]
    ahead, as_found = (None, lambda so_far: None) if meanwhile is None else meanwhile
    done = Progress(report, (2 + 2 * len(solvers)) * len(models) + len(others) + len(limits))
    with workers(done) as pool, warnings.catch_warnings():
        # The row of a run that fails says so. What closing the start has moved is the same for all runs: one warning.
        warnings.simplefilter("ignore", SimulationWarning)
        warnings.simplefilter("once", StartWarning)
        # The slowest to compile first, so that no worker is left alone with one at the end.
        order = list(models)[::-1]
        observed = pool.each([_piece("simulated", _observed, subject, models[name], ts) for name in order], ahead)
        runs = {name: observed[order.index(name)] for name in models}
        subject = followed(subject, runs)
        curves = {name: _curves(subject, case, runs[name]) for name, case in models.items()}
        t_short = jnp.linspace(0.0, t_limits, ts.shape[0])
        known = {case: curves[name] for name, case in models.items()}
        determined: dict[str, float | None] = {}
        limit_by_study: dict[LimitStudy, LimitResult] = {}
        timed: dict[Any, Trajectory] = {}
        # All that is left at once, what compiles first; but for `determined`, which figures wait for.
        work: list[tuple[dict, Any, Piece]] = [
            *((known, case, _piece("simulated", _curves_only, subject, case, ts)) for case in others),
            *(
                (determined, name, Piece(f"error estimated: {case.label}", partial(determined_until, runs[name])))
                for name, case in models.items()
            ),
            *((limit_by_study, study, _piece("limit", _limit, subject, study, t_short)) for study in limits),
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

        def keep_result(at: int, result: Any) -> None:
            place, name, _ = work[at]
            place[name] = result

        def so_far() -> Comparison:
            complete = [study for study in studies if all(case in known for case in study.cases)]
            results = [_study_result(study, known) for study in complete]
            return Comparison(
                t_end, [], curves, runs, results, t_limits=t_limits, determined=determined, subject=subject
            )

        pool.each([piece for *_, piece in work], as_found(so_far), keep_result)
        limit_results = [limit_by_study[study] for study in limits]
        usual = _timed(subject, t_end, None, done)
        by_fixed = {} if fixed is None else _timed(subject, t_end, fixed, done)
    rows = [
        _row(subject, name, runs[name], curves[name], usual[name], determined[name], by_fixed.get(name))
        for name in models
    ]
    results = [_study_result(study, known) for study in studies]
    return Comparison(t_end, rows, curves, runs, results, limit_results, t_limits, subject=subject)


def followed(subject: Subject, runs: Mapping[str, Trajectory]) -> Subject:
    """The subject with a body and an axis: those that are named, or those of the largest effect and motion."""
    ideal, body, axis = runs[subject.ideal], subject.body, subject.axis
    if body is None:
        names = list(ideal.system.bodies)
        mine = [name for name in ideal.system.joints[subject.joint].bodies if name in names]
        changed = dict.fromkeys(mine, 0.0)
        for run in runs.values():
            apart = bodies_apart(ideal.system, ideal.state, run.state)
            for name in mine:
                changed[name] = max(changed[name], float(np.nanmax(apart[:, names.index(name)], initial=0.0)))
        body = max(reversed(mine), key=lambda name: changed[name])
    return replace(subject, body=body, axis=axis_of_motion(ideal, body) if axis is None else axis)


def _study_result(study: Study, known: Mapping[Case, Curves]) -> StudyResult:
    return StudyResult(study, [replace(known[case], label=case.label) for case in study.cases])


def _piece(verb: str, work, subject: Subject, case: Case | LimitStudy, *arguments) -> Piece:
    return Piece(f"{verb}: {case.label}", partial(work, subject, case, *arguments))


def _run(subject: Subject, case: Case, ts) -> Trajectory:
    return simulate(subject.build(case.model), ts, rtol=subject.rtol, track_work=subject.tracks_work)


def _observed(subject: Subject, case: Case, ts) -> Trajectory:
    """A run with all that can be observed of it, which takes as long as the run, and so is done by the workers."""
    run = _run(subject, case, ts)
    jax.block_until_ready(run.observation.acceleration)
    return run


def _curves(subject: Subject, case: Case, run: Trajectory) -> Curves:
    assert subject.body is not None
    return curves_of(run, case.label, body=subject.body, joint=subject.joint, axis=subject.axis)


def _curves_only(subject: Subject, case: Case, ts) -> Curves:
    return _curves(subject, case, _run(subject, case, ts))


def _row(
    subject: Subject,
    name: str,
    run: Trajectory,
    one: Curves,
    timed: Timed,
    until: float | None,
    fixed: Timed | None,
) -> ModelRow:
    distance = one.distance[np.isfinite(one.distance)]
    return ModelRow(
        name=name,
        label=subject.models[name].label,
        lost_energy=one.lost_energy,
        peak_acceleration=one.peak_acceleration,
        eccentricity_ratio=float(np.max(distance, initial=0.0)) / subject.reference,
        n_onsets=int(np.sum(run.stats.n_onsets)) if run.system.contact_joints else None,
        n_steps=timed.n_steps,
        seconds=timed.seconds,
        time_ratio=timed.time_ratio,
        determined_until=until,
        method=run.choice,
        measures=subject.measures(run, one),
        fixed=fixed,
        failure="" if bool(run.succeeded) else run.diagnosis,
    )


def determined_until(run: Trajectory) -> float | None:
    """`run.determined_until` [s], or None when that is the end."""
    until = run.determined_until
    return until if until < float(run.ts[-1]) else None


def _run_for_timing(subject: Subject, case: Case, t_end: float, solver: diffrax.AbstractSolver | None) -> Trajectory:
    return _run_few_samples(subject.build(case.model), t_end, solver, subject.rtol)


def _run_few_samples(scene: Scene, t_end: float, solver: diffrax.AbstractSolver | None, rtol: float) -> Trajectory:
    """A run with few samples, so that integration is timed and not saving."""
    run = simulate(scene, jnp.linspace(0.0, t_end, TIMED_SAMPLES), rtol=rtol, solver=solver)
    return jax.block_until_ready(run)


def _timed(subject: Subject, t_end: float, solver, done: Progress) -> dict[str, Timed]:
    """What each model costs, alone on the machine."""
    costs: dict[str, tuple[int, float]] = {}
    for name, case in subject.models.items():
        costs[name] = warm_run(subject.build(case.model), t_end, solver, rtol=subject.rtol)
        done(f"timed: {case.label}")
    ideal = costs[subject.ideal][1]
    return {name: Timed(n_steps, seconds, seconds / ideal) for name, (n_steps, seconds) in costs.items()}


def warm_run(
    scene: Scene,
    t_end: float,
    solver: diffrax.AbstractSolver | None = None,
    *,
    repeats: int = REPEATS,
    rtol: float = RTOL,
) -> tuple[int, float]:
    """Steps and median time [s] of a run that is compiled already; of one that fails the time is NaN."""
    first = _run_few_samples(scene, t_end, solver, rtol)
    if not bool(first.succeeded):
        return int(first.stats.n_steps), float("nan")
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        _run_few_samples(scene, t_end, solver, rtol)
        times.append(time.perf_counter() - start)
    return int(first.stats.n_steps), float(np.median(times))


def _distinct(studies: Sequence[Study]) -> list[Case]:
    return list(dict.fromkeys(case for study in studies for case in study.cases))


def _limit(subject: Subject, study: LimitStudy, ts) -> LimitResult:
    # With the account of the work, which nobody reads here: so are the programs those of the models' own runs. And all
    # by one method, for one program.
    models = [study.model_of(value) for value in study.values]
    systems = [compile_scene(subject.build(model), track_work=subject.tracks_work).system for model in models]
    solver = stiffest([choose_solver(system, subject.rtol) for system in systems]).solver

    def positions(model: AbstractSphericalModel, solver: diffrax.AbstractSolver | None) -> np.ndarray:
        scene = subject.build(model)
        run = simulate(scene, ts, rtol=subject.rtol, solver=solver, track_work=subject.tracks_work)
        if subject.axis in ROTATIONS:
            return _curves(subject, Case("", "", model), run).position
        return np.asarray(run.position(str(subject.body))[:, "xyz".index(str(subject.axis))])

    ideal = positions(subject.models[subject.ideal].model, None)
    deviations = [float(np.max(np.abs(positions(model, solver) - ideal))) for model in models]
    return LimitResult(study.label, study.parameter, list(study.values), deviations, study.order, study.kind)

"""`sj.compare_models`: which of several models has made some records."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import diffrax
import numpy as np

from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.forms import real_number, whole_number
from spherejax.runtime import interrupts_kept
from spherejax.studies.fit.experiment import Experiment
from spherejax.studies.fit.fit_result import Fit
from spherejax.studies.fit.fitting import experiments_with_sensors, minimized
from spherejax.studies.fit.levenberg_marquardt import LevenbergMarquardt
from spherejax.studies.fit.measured import Measured
from spherejax.studies.fit.methods import Course, Ending, Method
from spherejax.studies.fit.problem import Problem, problem_of
from spherejax.studies.fit.reading import experiments_from
from spherejax.studies.fit.record import Whole
from spherejax.studies.fit.sensor import Sensor
from spherejax.studies.fit.validation import validation_of
from spherejax.studies.model_choice.candidate import (
    FIXED,
    Candidate,
    FixedBuild,
    candidates_from,
    check_arguments,
)
from spherejax.studies.model_choice.choice_result import ModelComparison, comparison_of
from spherejax.studies.model_choice.fitted import Fitted
from spherejax.studies.model_choice.search import draws_over_ranges, searched
from spherejax.studies.progress import telling
from spherejax.studies.random_numbers import Rng, generator

MAX_STEPS = 200_000
"""Steps after which a run is given up: a draw from far within a range may be stiffer than any model in question."""

ITERATIONS = 24
"""Steps of a local fit: that of a wrong model may creep along a rugged cost for ever, and need not be exact."""

TOLERANCE = 0.1
"""Of a local fit, in standard deviations: what is left to gain is less than a hundredth in the criterion."""

ROUGH_ITERATIONS = 8
"""Steps of each local fit before those that have stayed behind are left."""

FEW_ITERATIONS = 4
"""Steps that are still made for a hopeless candidate, for its numbers to be of a minimum about as it is."""

EXPLAINED = 2.0
"""A candidate whose mean square of residuals over the noise is smaller explains the records."""

HOPELESS = 10.0
"""A candidate whose cost is larger than that of one that explains the records by this factor is not fitted further."""

FAR_BEHIND = 1.5
"""A local fit is left after its rough steps where its cost is larger than the least one by this factor."""


def compare_models(
    records: Any,
    candidates: Mapping[str, Any],
    *,
    validate: Any = None,
    held_out: float = 0.25,
    columns: Mapping[str, str] | None = None,
    noise: Any = None,
    sensors: Mapping[str, Sensor] | None = None,
    method: Method | None = None,
    draws: int = 64,
    starts: int = 4,
    rtol: float = 1e-7,
    atol: float | None = None,
    solver: diffrax.AbstractSolver | None = None,
    max_steps: int = MAX_STEPS,
    rng: Rng = 0,
    progress: bool | Callable[[str], None] = True,
) -> ModelComparison:
    """Tell which of several models has made some records, or that the records cannot tell.

    Each model is fitted: parameters are drawn over their ranges, the best draws are fitted by their gradients, first
    without the held-out values and then with all values of the records. Models are then compared by an information
    criterion that counts the parameters that the data determine, and by how well they predict what was held out; see
    `docs/concepts/identification.md`.

    Args:
        records: one record or a list, as for `sj.fit`.
        candidates: by name `sj.studies.Candidate(build, start)`, or a pair of both; for a model without parameters its
            builder or its scene. Give parameters that are not known to a factor of ten as `sj.Parameter(start, lower=,
            upper=)`: they are searched over this range.

    Other args:
        validate: records that are held out as a whole, one or a list; None: the last part of each record is.
        held_out: how large that part is, a share of the record's duration; without `validate` only.
        columns, noise, sensors: of the records, as in `sj.fit`. Noise that is not stated is estimated from the
            residuals of the model that leaves the smallest.
        method: of the local fits; `sj.studies.LevenbergMarquardt(tolerance=0.1, max_iterations=24)` by default.
        draws: parameters that are tried over the ranges of each model with parameters, the start among them.
        starts: from how many of these local fits begin.
        rtol, atol, solver, max_steps: of the runs, as in `simulate`. A draw that takes more steps counts as failed.
        rng: of the draws, a whole number or a generator.
        progress: shown in terminals and notebooks and not in logs (True), not at all (False), or a function that is
            given a line for each step of the way.

    Returns:
        The comparison: prints as a table with its verdict. A candidate that fails is a row that says why.

    Raises:
        SceneError: for a request that makes no sense: what is wrong with all candidates, or a share that is none.
    """
    began = time.monotonic()
    models = candidates_from(candidates)
    real_number("held_out", held_out)
    if not 0.0 <= held_out <= 0.9:
        raise SceneError(f"held_out = {held_out!r} is the share of each record that is not fitted; it is 0 to 0.9")
    draws = whole_number("draws", draws, "draws=64 are enough for three parameters")
    starts = whole_number("starts", starts, "starts=4 is the default")
    fitted_records = _records(records, columns, sensors, "record", is_strict=True)
    held_records = None if validate is None else _records(validate, columns, sensors, "validation", is_strict=False)
    random = generator(rng)
    task = _Task(
        fitted_records, held_records, 0.0 if validate is not None else float(held_out), noise,
        method or LevenbergMarquardt(tolerance=TOLERANCE, max_iterations=ITERATIONS), draws, starts,
        {"rtol": rtol, "atol": atol, "solver": solver, "max_steps": max_steps}, lambda line: None,
    )  # fmt: skip
    own = {name for one in [*fitted_records, *(held_records or [])] for name in one.own}
    for name, candidate in models.items():
        check_arguments(name, candidate, own)
    found, begun, seconds = {}, {}, {}
    refused: dict[str, SceneError] = {}
    with interrupts_kept(), telling(progress, "models") as tell:
        task = replace(task, tell=tell)
        for name, candidate in models.items():
            start = time.monotonic()
            try:
                begun[name] = _begun(name, candidate, task, random)
            except SceneError as error:
                refused[name], found[name] = error, Fitted.failed(str(error))
            seconds[name] = time.monotonic() - start
        if len(refused) == len(models):
            raise next(iter(refused.values()))
        for name, one in begun.items():
            start = time.monotonic()
            is_hopeless = _is_hopeless(one, list(begun.values()))
            try:
                found[name] = _finished(name, models[name], one, task, is_hopeless=is_hopeless)
            except SceneError as error:
                found[name] = Fitted.failed(str(error))
            seconds[name] += time.monotonic() - start
    results = {name: found[name].timed(seconds[name]) for name in models}
    return comparison_of(results, is_validated=validate is not None, seconds=time.monotonic() - began)


@dataclass(frozen=True)
class _Task:
    """What all candidates share."""

    records: list[Measured]
    held_records: list[Measured] | None
    held_out: float
    noise: Any
    method: Method
    draws: int
    starts: int
    integration: dict[str, Any]
    tell: Callable[[str], None]

    def watch(self, name: str) -> Callable[[list[Course]], None]:
        """Tells how far the local fits of a candidate are."""

        def watch(courses: list[Course]) -> None:
            steps, least = max(one.n_iterations for one in courses), min(one.cost for one in courses)
            self.tell(f"{name}: step {steps}, half the sum of squares {least:.6g}")

        return watch


def _records(given, columns, sensors, word: str, *, is_strict: bool) -> list[Measured]:
    records = experiments_with_sensors(experiments_from(given, columns), sensors, is_strict=is_strict)
    for one in records:
        if one.build is not None:
            raise SceneError(
                f"{one.name or 'a record'} has a builder of its own, which would stand for all candidates; give the "
                "builders by record, sj.studies.Candidate({record: build}), or what differs as own= parameters"
            )
    return [one.named(f"{word} {i + 1}" if len(records) > 1 else word) for i, one in enumerate(records)]


@dataclass(frozen=True)
class _BegunFit:
    """A candidate after its draws and the rough steps of its local fits.

    Attributes:
        problem: of all values of the records.
        train: the same without their held-out ends.
        courses: of the local fits.
        n_draws: parameters that were tried over the ranges.
        n_failed: draws whose runs did not reach their ends.
    """

    problem: Problem
    train: Problem
    courses: list[Course]
    n_draws: int
    n_failed: int

    @property
    def best(self) -> Course:
        """The local fit with the least cost."""
        return min(self.courses, key=lambda course: course.cost)

    def failed(self, why: str) -> Fitted:
        """A candidate that failed; says how many of the draws did, where that is most of them."""
        if 2 * self.n_failed > self.n_draws:
            why += f" ({self.n_failed} of {self.n_draws} draws over the ranges failed, too)"
        return Fitted.failed(why, n_draws=self.n_draws, n_failed=self.n_failed)


def _begun(name: str, candidate: Candidate, task: _Task, random: np.random.Generator) -> _BegunFit:
    """Draws over the ranges, and rough fits from the best of them."""
    problem = _problem(candidate, task.records, task)
    train = _without_ends(problem, task.held_out) if task.held_out > 0 else problem
    us, n_draws, n_failed = problem.u0[None], 0, 0
    if not candidate.is_fixed or any(one.own for one in task.records):
        n_draws = task.draws
        drawn = draws_over_ranges(problem.unknowns, problem.u0, n_draws, random)
        tried = searched(train, drawn, lambda n: task.tell(f"{name}: draw {n} of {n_draws}"))
        us, n_failed = tried.best(task.starts), tried.n_failed
    method = task.method
    if len(us) > 1 and isinstance(method, LevenbergMarquardt):
        method = replace(method, max_iterations=min(ROUGH_ITERATIONS, method.max_iterations))
    courses = method.minimize(train, us, noise_is_known=train.noise_is_known, watch=task.watch(name))
    _pass_on_interrupts(courses)
    return _BegunFit(problem, train, courses, n_draws, n_failed)


def _pass_on_interrupts(courses: Sequence[Course]) -> None:
    """End the comparison where a fit was interrupted: a verdict on what is half fitted would be wrong."""
    if any(course.ending is Ending.INTERRUPTED for course in courses):
        raise KeyboardInterrupt


def _is_hopeless(one: _BegunFit, others: Sequence[_BegunFit]) -> bool:
    """Whether a candidate is so far behind one that explains the records that more steps cannot change the verdict."""
    least = min(other.best.cost for other in others)
    explained = one.train.noise_is_known and 2 * least < EXPLAINED * one.train.n_residuals
    return explained and one.best.cost > HOPELESS * least


def _finished(name: str, candidate: Candidate, begun: _BegunFit, task: _Task, *, is_hopeless: bool) -> Fitted:
    """A candidate fitted without what is held out, and with all values of the records."""
    if not begun.best.us:
        return begun.failed(begun.best.diagnosis or "no run reached its end")
    method, train = task.method, begun.train
    if is_hopeless and isinstance(method, LevenbergMarquardt):
        method = replace(method, max_iterations=min(FEW_ITERATIONS, method.max_iterations))
    courses = begun.courses if is_hopeless else _gone_on(begun, method, task.watch(name))
    _pass_on_interrupts(courses)
    courses = sorted((course for course in courses if course.us), key=lambda course: course.cost)
    train_u = courses[0].u
    if task.held_out > 0 and not train.noise_is_known:
        _, again = minimized(train, method, Whole(), train_u[None], task.watch(name))
        courses = [one for one in again if one.us] + courses
    task.tell(f"{name}: all values")
    why = ""
    for course in courses:  # where the run fails later with the best parameters of the first part: with the next ones
        train_u = course.u
        whole, ended = minimized(begun.problem, method, Whole(), train_u[None], task.watch(name))
        _pass_on_interrupts(ended)
        if ended[0].us:
            break
        why = why or ended[0].diagnosis
    else:
        return begun.failed(f"with the parameters of the first part the run fails later: {why}")
    fit = Fit(whole, ended, 0.95, 0.01, 0.0, candidate.builders[0])
    validation = None
    if task.held_records is not None:
        task.tell(f"{name}: validation")
        n_samples = max(one.measured.ts.size for one in begun.problem.experiments)
        held = _problem(candidate, task.held_records, task, n_samples=n_samples, is_held_out=True)
        validation = validation_of(fit, held, method)
    return Fitted(
        fit=fit,
        train_u=train_u,
        cuts=[_cut(one, task.held_out) for one in begun.problem.experiments],
        validation=validation,
        has_parameters=not candidate.is_fixed,
        n_draws=begun.n_draws,
        n_failed=begun.n_failed,
    )


def _gone_on(begun: _BegunFit, method: Method, watch) -> list[Course]:
    """The local fits, of which those go on that are not done and have not stayed behind."""
    courses = sorted((course for course in begun.courses if course.us), key=lambda course: course.cost)
    near = [course for course in courses if course.cost <= FAR_BEHIND * courses[0].cost]
    going = [course for course in near[:2] if course.ending is Ending.TOO_MANY_ITERATIONS]
    if not going:
        return courses
    us = np.stack([course.u for course in going])
    ended = method.minimize(begun.train, us, noise_is_known=begun.train.noise_is_known, watch=watch)
    return [*courses, *(course for course in ended if course.us)]


def _problem(candidate: Candidate, records: Sequence[Measured], task: _Task, **options: Any) -> Problem:
    build, start = candidate.build, dict(candidate.start)
    if not start and not any(one.own for one in records):
        start = {FIXED: 1.0}
        options["is_held_out"] = True  # nothing depends on the unknown that stands for no parameters
    wrap = FixedBuild if FIXED in start else lambda one: one
    if isinstance(build, Mapping):
        for one in records:
            if one.name not in build:
                raise SceneError(f"no builder for the record {one.name!r}: {one_of(build, str(one.name))}")
        records = [one.replaced(build=wrap(build[str(one.name)])) for one in records]
        build = next(iter(build.values()))
    return problem_of(wrap(build), start, records, task.noise, **task.integration, **options)


def _cut(experiment: Experiment, share: float) -> float:
    """Until when a record is fitted [s]."""
    if share == 0:
        return np.inf
    begin, end = experiment.measured.t0, float(experiment.measured.ts[-1])
    return begin + (1.0 - share) * (end - begin)


def _without_ends(problem: Problem, share: float) -> Problem:
    """The problem without the last part of each record."""
    experiments = [one.until(_cut(one, share)) for one in problem.experiments]
    for one in experiments:
        if not one.is_measured.any():
            raise SceneError(
                f"{one.measured.name}: nothing was measured in its first {100 * (1 - share):.3g} percent; lower "
                "held_out="
            )
    return Problem(problem.unknowns, problem.start, experiments, problem.noise, problem.noise_is_known, problem.loss)

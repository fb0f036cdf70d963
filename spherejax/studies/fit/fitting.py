"""`sj.fit`: identification of parameters from measured motions."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import diffrax
import numpy as np

from spherejax.foundations.errors import SceneError, one_of
from spherejax.motion.runs.many import Build
from spherejax.runtime import interrupts_kept
from spherejax.studies.fit.columns import tables_of, widths_of
from spherejax.studies.fit.fit_result import Fit
from spherejax.studies.fit.levenberg_marquardt import LevenbergMarquardt
from spherejax.studies.fit.losses import Loss, robust_scale
from spherejax.studies.fit.measured import Measured
from spherejax.studies.fit.methods import Course, Ending, FitProgress, FitWatch, Method
from spherejax.studies.fit.problem import MAX_STEPS, Problem, problem_of
from spherejax.studies.fit.progress import reporting
from spherejax.studies.fit.reading import experiments_from
from spherejax.studies.fit.record import Grown, Horizon, Whole
from spherejax.studies.fit.sensor import Sensor
from spherejax.studies.fit.validation import validation_of
from spherejax.studies.random_numbers import Rng, generator, rng_was_seed

SPREAD = np.log(10.0)
"""Further starts lie within this of the first in each unknown: a factor of ten for positive parameters."""

REWEIGHTINGS = 4
"""How often the noise is estimated anew from the residuals, at most."""


@rng_was_seed
def fit(
    build: Build,
    start: Mapping[str, Any],
    measured: Any,
    *,
    validate: Any = None,
    columns: Mapping[str, str] | None = None,
    noise: Any = None,
    sensors: Mapping[str, Sensor] | None = None,
    loss: Loss | None = None,
    method: Method | None = None,
    starts: int = 1,
    horizon: Horizon | None = None,
    rtol: float = 1e-8,
    atol: float | None = None,
    solver: diffrax.AbstractSolver | None = None,
    max_steps: int = MAX_STEPS,
    level: float = 0.95,
    determined_within: float = 0.01,
    rng: Rng = 0,
    progress: bool | Callable[[FitProgress], None] = True,
) -> Fit:
    """Estimate parameters of a scene from measurements of its motion.

    Minimises half the sum of squares of (prediction - measurement) / noise over all experiments.

    Args:
        build: makes a `Scene` from the parameters, given by keyword. It is traced.
        start: where to begin, by parameter: numbers, arrays, or `sj.Parameter` with bounds. Numbers that are positive
            are fitted by their logarithm, unless told otherwise.
        measured: one experiment or a list: a `sj.Measured`; a dict with `"time"` [s] and values by observable; an
            `xarray.Dataset` with a coordinate `time`; the path of a CSV or netCDF file. Observables are named like
            `"position.rocker.z"` or `"velocity.rocker"`.

    Other args:
        validate: records that are predicted with the estimates, one or a list, as `measured`: `fitted.validation` and
            the report say how large the errors are, against the noise and the residuals of the fit. What a record has
            for itself (`sj.Measured(..., own=)`, e.g. an initial angle) is fitted to it, all else held.
        columns: what the columns of CSV files are, by the names that stand in their first row, e.g.
            `{"t/ms": "time [ms]", "height": "position.rocker.z [mm]"}`; others are left out. None: they are named like
            observables.
        noise: standard deviation of the errors of measurement, in the units of what was measured: a number, or numbers
            by observable. With None it is estimated from the residuals, for each observable of each experiment.
        sensors: what the instruments make of the observables, by channel: `sj.studies.Sensor` with gain, bias, delay or
            filter, known or fitted. For experiments that say nothing of their own (`sj.Measured(..., sensors=)`).
        loss: how much residuals count that are far larger than the noise: `sj.studies.Huber()` for a few outliers,
            `sj.studies.Cauchy()` for gross errors; None: by their squares. Where the noise is not stated it is then
            estimated by the median magnitude of the residuals. Intervals are those of the estimate with this loss.
        method: `sj.studies.LevenbergMarquardt()`, the default, or `sj.studies.Descent(optax_optimiser)` for many
            parameters.
        starts: how many starts, side by side on all cores. The first is `start`; the others lie around it, up to a
            factor of ten away (positive parameters) or `log(10)` scales (others), within the bounds.
        horizon: how much of the record is looked at. With None the record grows: rough fits of its first parts, each
            twice as long, lead into the whole; a start whose vibration is out of step with the measured one would
            otherwise end in a wrong minimum. `sj.studies.Whole()` begins with all of it.
        rtol, atol, solver, max_steps: of the runs, as in `simulate`. An explicit solver controls the errors of the
            derivatives too. A run that fails within the fit is a step taken back.
        level: of the confidence intervals in the report.
        determined_within: a combination of parameters that the data leave with a larger standard deviation (relative,
            of positive parameters) is named as undetermined.
        rng: of the further starts, a whole number or a generator.
        progress: shown in terminals and notebooks and not in logs (True), not at all (False), or a function that is
            given what `studies.fit.methods.FitProgress` holds.

    Returns:
        The `Fit`. An interrupt (Ctrl-C) ends it with the best parameters so far, and the status says so.

    Raises:
        SceneError: for a request that makes no sense, before anything is simulated.
    """
    began = time.monotonic()
    method = LevenbergMarquardt() if method is None else method
    experiments = experiments_with_sensors(experiments_from(measured, columns), sensors)
    problem = problem_of(
        build, start, experiments, noise, rtol=rtol, atol=atol, solver=solver, max_steps=max_steps, loss=loss
    )
    held_out = None
    if validate is not None:
        records = [
            one.named(f"validation {i + 1}")
            for i, one in enumerate(
                experiments_with_sensors(experiments_from(validate, columns), sensors, is_strict=False)
            )
        ]
        n_samples = max(one.measured.ts.size for one in problem.experiments)
        held_out = problem_of(
            build, start, records, noise, rtol=rtol, atol=atol, solver=solver, max_steps=max_steps, n_samples=n_samples,
            is_held_out=True, loss=loss,
        )  # fmt: skip
    us = _starts(problem, starts, rng)
    with interrupts_kept(), reporting(progress, problem, method.max_iterations) as report:
        watch = FitWatch(report, problem, method.max_iterations)
        problem, courses = minimized(problem, method, horizon or Grown(), us, watch)
        fitted = Fit(problem, courses, level, determined_within, time.monotonic() - began, build)
        if held_out is None or not fitted.best.us or fitted.best.ending is Ending.INTERRUPTED:
            return fitted
        validation = validation_of(fitted, held_out, method)
    return replace(fitted, validation=validation, seconds=time.monotonic() - began)


def experiments_with_sensors(
    experiments: list[Measured], sensors: Mapping[str, Sensor] | None, *, is_strict: bool = True
) -> list[Measured]:
    """Experiments with the sensors of the fit, where they have none of their own.

    Raises:
        SceneError: where `is_strict`, for a sensor of a channel that no experiment has.
    """
    if sensors is None:
        return experiments
    channels = {name for one in experiments for name in one.values}
    for name in sensors:
        if is_strict and name not in channels:
            raise SceneError(f"sensors= names {name!r}, which no experiment has measured; {one_of(channels, name)}")
    return [
        one if one.sensors else one.replaced(sensors={key: x for key, x in sensors.items() if key in one.values})
        for one in experiments
    ]


def minimized(problem: Problem, method: Method, horizon: Horizon, us, watch) -> tuple[Problem, list[Course]]:
    """Minimise; where the noise is not known, weigh the observables by their residuals and minimise again."""
    is_known = problem.noise_is_known
    courses = horizon.minimize(problem, method, us, noise_is_known=is_known, watch=watch)
    is_robust = problem.loss is not None
    for _ in range((3 if is_robust else 1) * REWEIGHTINGS):
        best = min(courses, key=lambda course: course.cost)
        # Least squares of one observable are the same with any weight; a robust loss needs to know what is large.
        is_alike = _n_observables(problem) == 1 and not is_robust
        if is_known or is_alike or not best.us or best.ending is Ending.INTERRUPTED:
            break
        noise = _estimated_noise(problem, best)
        change = max(float(np.max(np.abs(np.log(new / old)))) for new, old in zip(noise, problem.noise, strict=True))
        problem = problem.with_noise(noise, is_known=False)
        ends = np.stack([course.u if course.us else u for course, u in zip(courses, us, strict=True)])
        again = Whole().minimize(problem, method, ends, noise_is_known=False, watch=watch)
        courses = [new.after(old, np.inf) for new, old in zip(again, courses, strict=True)]
        if change < 0.01:
            break
    return problem, courses


def _n_observables(problem: Problem) -> int:
    return sum(len(experiment.measured.values) for experiment in problem.experiments)


def _estimated_noise(problem: Problem, course: Course) -> list[np.ndarray]:
    """Root mean squares of the residuals of each observable, in its unit."""
    share = max((problem.n_residuals - problem.unknowns.size) / problem.n_residuals, 1e-3)
    found = []
    tables = tables_of(problem.experiments, problem.raw(course.residuals))
    size = _deviation if problem.loss is None else _robust_deviation
    for experiment, table, noise in zip(problem.experiments, tables, problem.noise, strict=True):
        errors, columns, first = table * noise, [], 0
        for width in widths_of(experiment):
            part = slice(first, first + width)
            columns.append(np.full((len(errors), width), size(errors[:, part], experiment.data[:, part], share)))
            first += width
        found.append(np.concatenate(columns, 1))
    return found


def _deviation(errors: np.ndarray, values: np.ndarray, share: float) -> float:
    """Of errors with NaN among them; what is predicted to the last digit must not outweigh everything else."""
    there = errors[~np.isnan(errors)]
    if not there.size:
        return 1.0
    return max(float(np.sqrt(np.mean(there**2) / share)), 1e-12 * float(np.max(np.abs(values))), 1e-300)


def _robust_deviation(errors: np.ndarray, values: np.ndarray, share: float) -> float:
    """As `_deviation`, by the median magnitude, which outliers do not move."""
    there = errors[~np.isnan(errors)]
    if not there.size:
        return 1.0
    return max(robust_scale(there, share), 1e-12 * float(np.max(np.abs(values))), 1e-300)


def _starts(problem: Problem, n: int, rng: Rng) -> np.ndarray:
    """Unknowns where each start begins, the first as given."""
    if n < 1:
        raise SceneError(f"starts = {n} must be at least 1")
    away = generator(rng).uniform(-SPREAD, SPREAD, (n - 1, problem.u0.size))
    return problem.u0 + np.concatenate([np.zeros((1, problem.u0.size)), away])

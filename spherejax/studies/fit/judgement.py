"""What a fit has to warn of: sentences."""

import numpy as np

from spherejax.studies.fit.columns import widths_of
from spherejax.studies.fit.growth import REMEDY, lost_at, start_of
from spherejax.studies.fit.methods import Course, Ending
from spherejax.studies.fit.statistics import Whiteness, whiteness_of

UNLIKELY = 1e-3
"""Residuals that white noise shows more rarely than this are not taken for white."""

RUNAWAY = 1e4
"""A positive parameter that changes by a larger factor, and is not determined there, has run away."""

FEWEST = 20
"""Fewer residuals than this say nothing about their colour."""

UNEXPLAINED = 0.3
"""Residuals that are larger than this share of the motion itself, and are no noise, say that the model is too poor."""

FILTER_SHARE = 0.1
"""Share of the noise that a filter's predictions may change by where its intervals are twice as long. The error itself
is about a fifteenth of the change, where the motion is smooth."""


def diagnosis_of(course: Course, problem) -> str:
    """Why a fit did not succeed, and what to do; empty after success."""
    if course.ending is Ending.FAILED_START:
        start = ", ".join(f"{name} = {_shown(value)}" for name, value in problem.start.items())
        return (
            f"the run at the start ({start}) failed: {course.diagnosis or 'no reason given'} Begin the fit from "
            "parameters with which the scene runs."
        )
    if course.ending is Ending.TOO_MANY_ITERATIONS:
        return (
            f"no minimum after {course.n_iterations} steps. Give more "
            f"(method=sj.studies.LevenbergMarquardt(max_iterations=)), "
            "start nearer, or fit fewer parameters."
        )
    return Ending.INTERRUPTED.value if course.ending is Ending.INTERRUPTED else ""


def warnings_of(fit) -> list[str]:
    """What to think about before the estimates are used, most important first."""
    found = [fit.diagnosis] if fit.diagnosis else []
    if not fit.best.us:
        return found
    return [
        *found,
        *_starts(fit),
        *_elsewhere(fit),
        *_misfit(fit),
        *_poor(fit),
        *_lost(fit),
        *_bounds(fit),
        *_colour(fit),
        *_filters(fit),
        *_failures(fit),
        *(fit.validation.warnings if fit.validation is not None else []),
        *fit.notes,
    ]


def _starts(fit) -> list[str]:
    """Starts that ended elsewhere."""
    ended = [course for course in fit.courses if course.ending is not None and course.ending.succeeded]
    failed = sum(course.ending is Ending.FAILED_START for course in fit.courses)
    found = [f"{failed} of {len(fit.courses)} starts failed: their runs did not reach their ends"] if failed else []
    deviations = fit.knowledge.scaled_deviations
    best, scales = fit.knowledge.values, fit.knowledge.scales
    variance = fit.knowledge.variance
    higher, elsewhere = 0, 0
    for course in ended:
        if course is fit.best:
            continue
        values = fit.problem.unknowns.flat_values_of(course.u)
        if (course.cost - fit.cost) / variance > max(1.0, 1e-6 * fit.cost / variance):
            higher += 1
        elif np.any(np.abs(values - best) / scales > np.maximum(deviations, 1e-6)):
            elsewhere += 1
    if higher:
        found.append(
            f"{higher} of {len(fit.courses)} starts ended in minima with a larger cost: the cost has several minima, "
            "and there may be a smaller one still (see fit.starts; more starts, or a start nearer to the truth)"
        )
    if elsewhere:
        found.append(
            f"{elsewhere} of {len(fit.courses)} starts ended at other parameters with the same cost: the data do not "
            "tell them apart (see fit.starts)"
        )
    return found


def _elsewhere(fit) -> list[str]:
    """Other parameters that the data do not rule out, though they lie outside the intervals."""
    if not fit.best.others:
        return []
    from scipy import stats  # half a second, which not every process has to spend

    known, found = fit.knowledge, []
    bar = stats.chi2.ppf(fit.level, known.values.size)
    low, high = known.intervals(fit.level).T
    for u, cost in fit.best.others:
        values = fit.problem.unknowns.flat_values_of(u)
        if 2 * (cost - fit.cost) / known.variance < bar and np.any((values < low) | (values > high)):
            where = ", ".join(f"{name} = {x:.6g}" for name, x in zip(fit.problem.unknowns.names, values, strict=True))
            found.append(
                f"{where} fits as well (half the sum of squares {cost:.4g}, against {fit.cost:.4g}) and lies outside "
                "the intervals: they are those of one minimum among several. Give bounds, or starts=, or measure more"
            )
    return found


def _misfit(fit) -> list[str]:
    """Residuals that are not of the size that was stated."""
    if not fit.problem.noise_is_known:
        return []
    ratio, spread = fit.reduced_chi_square, np.sqrt(2 / max(fit.degrees_of_freedom, 1))
    if ratio > 1 + max(5 * spread, 0.2):
        allowed = fit.problem.loss is not None or fit.knowledge.correlated is not None
        return [
            f"the residuals are {np.sqrt(ratio):.3g} times as large as the stated noise: the model misses something, "
            "the noise is understated, or this is not the smallest minimum; the standard deviations "
            + ("are those of the residuals, not of the stated noise" if allowed else "are too small")
        ]
    if ratio < 1 - max(5 * spread, 0.2):
        return [
            f"the residuals are only {np.sqrt(ratio):.3g} times the stated noise: it is overstated, and so are the "
            "standard deviations"
        ]
    return []


def _poor(fit) -> list[str]:
    """Components of which much is left that is not noise: shares of the motion itself."""
    poor = []
    for experiment, columns, noise in zip(fit.problem.experiments, fit.residuals.values(), fit.noise, strict=True):
        for column, (name, residuals) in enumerate(columns.items()):
            there = experiment.is_measured[:, column]
            motion = float(np.std(experiment.data[there, column])) if there.any() else 0.0
            error = residuals[there] * noise[there, column]
            share = float(np.sqrt(np.mean(error**2))) / motion if motion > 0 else 0.0
            is_noise = float(np.mean(residuals[there] ** 2)) < 1.5**2 if there.any() else True
            if not fit.problem.noise_is_known:
                is_noise = there.sum() < FEWEST or whiteness_of(residuals[there]).probability >= UNLIKELY
            if share > UNEXPLAINED and not is_noise:
                poor.append(f"{100 * share:.2g} percent of {name} ({experiment.measured.name})")
    if not poor:
        return []
    return [
        f"the model leaves much of the motion unexplained, which is not noise: {', '.join(poor)} (root mean squares). "
        "It is too poor, something that was taken as known is not, or this is a wrong minimum"
    ]


def _lost(fit) -> list[str]:
    """A gradient that has lost its meaning within the record, where the residuals are large."""
    if not _misfit(fit) or fit.reduced_chi_square < 1:
        return []
    start = start_of(fit.problem, fit.knowledge, fit.best)
    if start is None or start.to_the_end:
        return []
    return [f"{lost_at(start)} (see fit.growth). {REMEDY}".replace("The fit", "the fit", 1)]


def _bounds(fit) -> list[str]:
    """Estimates that rest on their bounds, and positive ones that have gone to zero or without end."""
    unknowns, found = fit.problem.unknowns, []
    starts = unknowns.flat_values_of(fit.problem.u0)
    bounds = zip(unknowns.each("lower"), unknowns.each("upper"), strict=True)
    known = fit.knowledge
    for name, value, start, deviation, (lower, upper) in zip(
        unknowns.names, known.values, starts, known.scaled_deviations, bounds, strict=True
    ):
        width = upper - lower if np.isfinite(upper - lower) else max(abs(value), abs(start))
        for bound, side in ((lower, "lower"), (upper, "upper")):
            # Zero below a positive number is no bound to rest on: it is far away in the logarithm.
            if np.isfinite(bound) and not bound == lower == 0 and abs(value - bound) < 1e-3 * width:
                found.append(
                    f"{name} = {value:.6g} rests on its {side} bound {bound:.6g}: the data want it beyond, and its "
                    "interval is cut off there"
                )
        if lower == 0 and deviation > 0.5 and not start / RUNAWAY < value < start * RUNAWAY:
            where = "fallen" if value < start else "risen"
            found.append(
                f"{name} has {where} from {start:.6g} to {value:.6g}: the data want none of it, they want it without "
                "end, or this is not the smallest minimum; give it bounds, or leave it out"
            )
    return found


def _colour(fit) -> list[str]:
    """Residuals that are not white."""
    coloured = []
    for experiment, columns in fit.residuals.items():
        for name, values in columns.items():
            there = values[~np.isnan(values)]
            test = whiteness_of(there)
            if there.size >= FEWEST and test.probability < UNLIKELY:
                coloured.append((name if len(fit.residuals) == 1 else f"{name} of {experiment}", test))
    if not coloured:
        return []
    are = ", ".join(f"{name} ({_correlated(test)})" for name, test in coloured)
    return [
        f"the residuals of {are} are not white noise by the test of Ljung and Box. The model misses something that was "
        f"measured, or the errors are correlated. {_widened(fit.knowledge.widening)}"
    ]


def _widened(widening: np.ndarray) -> str:
    """What was done about correlated errors."""
    if not np.any(widening != 1.0):
        return (
            "The standard deviations assume independent errors: they are wrong, and too small where neighbouring "
            "residuals are alike"
        )
    low, high = float(np.min(widening)), float(np.max(widening))
    times = f"{high:.2g}" if high - low < 0.05 * high else f"{low:.2g} to {high:.2g}"
    return (
        f"The standard deviations allow for correlated errors: they are {times} times those of independent ones. They "
        "do not allow for a model that is wrong"
    )


def _correlated(test: Whiteness) -> str:
    """What a test has found: the largest correlation, and how likely all of them are."""
    apart = "neighbouring ones" if test.lag == 1 else f"those {test.lag} samples apart"
    return (
        f"{apart} have a correlation of {test.correlation:.2g}, white noise has less than {test.bound:.2g} in 19 of 20 "
        f"cases; Q = {test.statistic:.3g} over {test.n_lags} lags, p = {test.probability:.1g}"
    )


def _filters(fit) -> list[str]:
    """Filters whose intervals are too long for what passes through them."""
    coarse = []
    for experiment, noise in zip(fit.problem.experiments, fit.noise, strict=True):
        first = dict(zip(experiment.measured.values, np.cumsum([0, *widths_of(experiment)]).tolist(), strict=False))
        for name, error in experiment.filter_errors(fit.u).items():
            there = experiment.is_measured[:, first[name]]
            if there.any() and not error <= FILTER_SHARE * float(np.median(noise[there, first[name]])):
                coarse.append(f"{name} ({experiment.measured.name}) by {error:.2g}")
    if not coarse:
        return []
    return [
        f"with filter intervals twice as long the predictions change: {', '.join(coarse)}, which is more than a tenth "
        "of the noise. Raise substeps of sj.studies.LowPass or sj.studies.Differentiator"
    ]


def _failures(fit) -> list[str]:
    if not fit.best.n_failed:
        return []
    return [
        f"{fit.best.n_failed} of {fit.best.n_iterations} runs on the way did not reach their ends; these steps were "
        f"taken back ({fit.best.diagnosis})"
    ]


def _shown(value) -> str:
    return f"{value.item():.6g}" if np.ndim(value) == 0 else np.array2string(np.asarray(value), precision=6)

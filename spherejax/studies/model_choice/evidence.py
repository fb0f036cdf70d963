"""What records say for each of several models: an information criterion, and a score of held-out values.

All models are judged by one process of the errors, that of the channel's residuals under the model that leaves the
smallest innovations. With the innovations w of its residuals (see `fit.correlation`; of white residuals these over
their noise), the determined parameters gamma and the count n of values,

    criterion = sum w^2 + gamma log n,    gamma = sum_j s_j^2 / (1 + s_j^2),

where s_j are the singular values of the whitened Jacobian by the parameters over the widths of their ranges. A
direction that the data determine counts as one parameter, and one that they do not as none. For two models whose
innovations differ by d, the noise alone leaves a

    standard error of the difference = 2 |d|,

for sum (w + d)^2 - sum w^2 = |d|^2 + 2 d.w, and w has unit variance.

Held-out values have the normal density whose covariance is that of the errors and of what the fit has left open in the
parameters, C = (J^T J + 1)^-1 in the same units; with the innovations w and the whitened Jacobian H of these values,

    score = sum w^2 - w^T H (C^-1 + H^T H)^-1 H^T w + log det(1 + C H^T H),

minus twice the logarithm of the density but for what all models share.

Sources: Schwarz 1978, Annals of Statistics 6, 461, for the criterion; MacKay 1992, Neural Computation 4, 415, for
gamma; Vuong 1989, Econometrica 57, 307, for a standard error of the difference; Dawid 1984, Journal of the Royal
Statistical Society A 147, 278, for judging models by what they predict.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spherejax.studies.fit.columns import columns_of
from spherejax.studies.fit.correlation import ChannelResiduals, Process, process_of
from spherejax.studies.fit.parameters import FitUnknowns
from spherejax.studies.fit.problem import Problem


class SharedResiduals(NamedTuple):
    """Residuals of a model at some parameters, in units that all models share.

    Attributes:
        errors: prediction minus measurement over a noise that is the same for all models, shape (n,).
        jacobian: derivatives by the parameters over the widths of their ranges, shape (n, k).
        channels: consecutive values of one component of one record.
        is_held_out: which of the values the fit has not seen, shape (n,).
    """

    errors: np.ndarray
    jacobian: np.ndarray
    channels: Sequence[ChannelResiduals]
    is_held_out: np.ndarray


class Innovations(NamedTuple):
    """Whitened residuals of a model and their Jacobian, all of them, and which were held out."""

    values: np.ndarray
    jacobian: np.ndarray
    is_held_out: np.ndarray


def residuals_of(
    problem: Problem, u: np.ndarray, noise: Sequence[np.ndarray], is_held_out: np.ndarray
) -> SharedResiduals:
    """Residuals of a problem at some unknowns.

    Args:
        problem: with all values.
        u: unknowns.
        noise: standard deviations that all models share, (n, m) by experiment.
        is_held_out: by value.
    """
    evaluation = problem.evaluate(u[None])
    errors, jacobian = problem.raw(evaluation.residuals[0]), evaluation.jacobians[0]
    own = np.concatenate([n[one.is_measured] for n, one in zip(problem.noise, problem.experiments, strict=True)])
    common = np.concatenate([n[one.is_measured] for n, one in zip(noise, problem.experiments, strict=True)])
    ratio = own / common
    widths = widths_of_ranges(problem.unknowns, u)
    return SharedResiduals(errors * ratio, jacobian * ratio[:, None] * widths, channels_in(problem), is_held_out)


def channels_in(problem: Problem) -> list[ChannelResiduals]:
    """Which residuals of a problem are consecutive values of one component."""
    channels, first = [], 0
    for i, experiment in enumerate(problem.experiments):
        numbers = np.zeros(experiment.is_measured.shape, int)
        count = int(experiment.is_measured.sum())
        numbers[experiment.is_measured] = first + np.arange(count)
        first += count
        for column, name in enumerate(columns_of(experiment)):
            there = experiment.is_measured[:, column]
            channels.append(ChannelResiduals(name, numbers[there, column], (i, there.tobytes())))
    return channels


def widths_of_ranges(unknowns: FitUnknowns, u: np.ndarray) -> np.ndarray:
    """Change of each unknown along the width of its parameter's range.

    The width is the standard deviation of what is drawn over the range: of a positive parameter without bounds on both
    sides a factor of e, of another one its scale.
    """
    values = unknowns.flat_values_of(u)
    widths, at = [], 0
    for part in unknowns.parts:
        lower, upper = part.lower, part.upper
        for _ in range(part.size):
            value, width = values[at], 1.0
            is_ranged = np.isfinite(lower) and np.isfinite(upper)
            if is_ranged:
                share = np.clip((value - lower) / (upper - lower), 1e-12, 1 - 1e-12)
                slope = (upper - lower) * share * (1 - share)
                is_logarithmic = lower > 0 and upper > 10 * lower
                spread = value * np.log(upper / lower) if is_logarithmic else upper - lower
                width = spread / np.sqrt(12.0) / slope
            widths.append(width)
            at += 1
    return np.array(widths)


def processes_of(residuals: SharedResiduals, *, noise_is_known: bool) -> list[Process]:
    """The process of each channel's errors, from the values that the fit has seen.

    White residuals of the stated size have the stated variance, 1; larger ones their own.
    """
    processes = []
    for channel in residuals.channels:
        errors = residuals.errors[channel.rows]
        process = process_of(errors)
        n = max(errors.size, 1)
        if noise_is_known:
            limit = 1.0 + 5.0 * np.sqrt(2.0 / n)
            size = float(process.covariances(1)[0])
            if not process.factors.size and size < limit:
                process = Process(process.factors, 1.0)
            elif size < 1.0:
                process = process._replace(variance=process.variance / size)
        processes.append(process._replace(variance=max(process.variance, 1e-300)))
    return processes


def size_of_innovations(residuals: SharedResiduals) -> float:
    """How well a model can explain the values, whatever the process of the errors: n log variance, penalised."""
    total = 0.0
    for channel in residuals.channels:
        errors = residuals.errors[channel.rows]
        process = process_of(errors)
        total += errors.size * np.log(max(process.variance, 1e-300)) + process.factors.size * np.log(errors.size + 1)
    return total


def whitened(residuals: SharedResiduals, processes: Sequence[Process]) -> Innovations:
    """Innovations of residuals over their standard deviations; the first of a channel, as many as its order, drop out.

    What stands before them is not known.
    """
    values, jacobians, held = [], [], []
    for channel, process in zip(residuals.channels, processes, strict=True):
        rows = channel.rows
        polynomial = np.concatenate([[1.0], -process.factors])
        size, skip = np.sqrt(process.variance), process.factors.size
        columns = np.column_stack([residuals.errors[rows], residuals.jacobian[rows]])
        moved = sum(
            factor * np.concatenate([np.zeros((lag, columns.shape[1])), columns[: len(columns) - lag]])
            for lag, factor in enumerate(polynomial)
            if lag <= len(columns)
        )
        moved = np.asarray(moved)[skip:] / size
        values.append(moved[:, 0])
        jacobians.append(moved[:, 1:])
        held.append(residuals.is_held_out[rows][skip:])
    return Innovations(np.concatenate(values), np.concatenate(jacobians), np.concatenate(held))


def n_determined(jacobian: np.ndarray) -> float:
    """How many parameters the values determine, gamma."""
    squares = np.linalg.svd(jacobian, compute_uv=False) ** 2 if jacobian.size else np.zeros(0)
    return float(np.sum(squares / (1.0 + squares)))


def criterion_of(innovations: Innovations) -> float:
    """The information criterion of a fit."""
    n = innovations.values.size
    return float(innovations.values @ innovations.values) + n_determined(innovations.jacobian) * np.log(max(n, 1))


def held_out_score(innovations: Innovations, seen: np.ndarray) -> float:
    """Minus twice the logarithm of the density of held-out values, but for what all models share.

    Args:
        innovations: of the held-out values.
        seen: whitened Jacobian of the values that were fitted.
    """
    w, h = innovations.values, innovations.jacobian
    k = h.shape[1]
    known = seen.T @ seen + np.eye(k)
    both = known + h.T @ h
    moved = h.T @ w
    logs = np.linalg.slogdet(both)[1] - np.linalg.slogdet(known)[1]
    return float(w @ w - moved @ np.linalg.solve(both, moved) + logs)


def standard_error(first: Innovations, second: Innovations) -> float:
    """Of the difference of two sums of squares, by the noise alone."""
    return 2.0 * float(np.linalg.norm(first.values - second.values))

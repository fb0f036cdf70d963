"""Prediction of records that were not fitted: how far a model can be trusted beyond the data that made it.

The common parameters are those of the fit. What a record has for itself (`Measured.own`, such as the angle from which
it was released) is fitted to it, all else held. The errors of prediction are compared with the noise, and with what
noise and the intervals of the parameters let expect,

    expected^2 = noise^2 + mean(diag(J C J^T)),    C the covariance of the common parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from spherejax.foundations.errors import SceneError, one_of
from spherejax.studies.fit.columns import columns_of, tables_of, units_of
from spherejax.studies.fit.experiment import CostAndGradient, Experiment
from spherejax.studies.fit.methods import Method
from spherejax.studies.fit.parameters import FitUnknowns
from spherejax.studies.fit.problem import Evaluation, Problem
from spherejax.studies.fit.record import Grown

AS_EXPECTED = 1.5
"""Errors of prediction up to so many times what was expected count as expected."""

UNEXPLAINED = 0.5
"""Errors of prediction larger than this share of the motion itself: the model does not predict."""


class PredictionErrors(NamedTuple):
    """Errors of prediction of one component of a record; in the unit of its readings.

    Attributes:
        record: its name.
        component: which.
        unit: of its readings; empty where it is not known.
        n: count of readings.
        rms: root mean square of prediction minus measurement.
        largest: largest magnitude of it.
        noise: standard deviation of the errors of measurement, as stated or as estimated by the fit; NaN where the
            fit has no such channel.
        expected: rms that noise and intervals of the parameters let expect; infinite where these are.
        of_fit: rms of the same channel's residuals in the fit; NaN where it has none.
        motion: rms of the measured values about their mean.
    """

    record: str
    component: str
    unit: str
    n: int
    rms: float
    largest: float
    noise: float
    expected: float
    of_fit: float
    motion: float

    @property
    def times_noise(self) -> float:
        """How many times the noise."""
        return self.rms / self.noise

    @property
    def unexplained(self) -> float:
        """Share of the motion that is not predicted: 0 is perfect, 1 no better than a constant."""
        return self.rms / self.motion if self.motion > 0 else np.nan


@dataclass(frozen=True)
class Validation:
    """Prediction of records that were not fitted; prints as a table with what it means.

    Attributes:
        problem: of these records.
        u: unknowns: the estimates of the common parameters, then what each record has for itself.
        tables: prediction minus measurement over `problem.noise`, (n, m) by record; NaN: not measured, or failed.
        errors: by record and component.
        failures: by record, why its run failed.
        own: what each record has for itself, as fitted to it, by name.
    """

    problem: Problem
    u: np.ndarray
    tables: list[np.ndarray]
    errors: list[PredictionErrors]
    failures: dict[str, str]
    own: dict[str, Any]

    @cached_property
    def warnings(self) -> list[str]:
        """What the errors of prediction say against the model, sentences without their ends."""
        failed = [f"the run of {name} failed with the estimates: {why}" for name, why in self.failures.items()]
        return [*failed, *filter(None, map(_judged, self.errors))]

    @cached_property
    def differences(self) -> dict[str, dict[str, np.ndarray]]:
        """Prediction minus measurement in the units of the readings, by record and component; NaN: not measured."""
        return {
            str(one.measured.name): dict(zip(columns_of(one), (table * noise).T, strict=True))
            for one, table, noise in zip(self.problem.experiments, self.tables, self.problem.noise, strict=True)
        }

    def within(self, limit: float, component: str) -> dict[str, float]:
        """Until when a component is predicted to within a limit, by record [s]: the last reading before it is not.

        The end of the record where all readings are; the start of the motion where none is. Of chaotic motions this
        says more than a mean error.
        """
        times = {}
        for one in self.problem.experiments:
            errors = self.differences[str(one.measured.name)].get(component)
            if errors is None:
                continue
            there = ~np.isnan(errors)
            ts, is_off = one.measured.ts[there], np.abs(errors[there]) > limit
            ends = np.concatenate([[one.measured.t0], ts])
            times[str(one.measured.name)] = float(ends[int(np.argmax(is_off)) if is_off.any() else -1])
        if not times:
            names = {name for one in self.differences.values() for name in one}
            raise SceneError(f"no record has {component!r}; {one_of(names, component)}")
        return times

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The table of errors, its head first."""
        heads = ("", "values", "rms error", "largest", "noise", "expected", "in the fit", "unexplained")
        return [heads, *(_row(one, several=len(self.problem.experiments) > 1) for one in self.errors)]

    def __str__(self) -> str:
        n = sum(one.n for one in self.errors)
        text = f"Prediction of {n} values that were not fitted"
        if self.own:
            fitted = ", ".join(f"{name} = {value:.6g}" for name, value in self.own.items())
            text += f" ({fitted} fitted to them)"
        return "\n".join([f"{text}:", *aligned(self.rows)])


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of a table as lines, the first column to the left."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  ".join([row[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True))])
        for row in rows
    ]


def _row(one: PredictionErrors, *, several: bool) -> tuple[str, ...]:
    name = f"{one.component} of {one.record}" if several else one.component
    numbers = (one.rms, one.largest, one.noise, one.expected, one.of_fit)
    return (
        f"{name} [{one.unit}]" if one.unit else name,
        str(one.n),
        *(f"{number:.3g}" if np.isfinite(number) else "-" for number in numbers),
        f"{100 * one.unexplained:.2g} %" if np.isfinite(one.unexplained) else "-",
    )


def _judged(one: PredictionErrors) -> str:
    """What is wrong with a prediction, or nothing."""
    if not np.isfinite(one.rms):
        return ""
    size = f"{one.rms:.3g} {one.unit}".rstrip()
    where = f"{one.component} of {one.record}"
    if one.unexplained > UNEXPLAINED:
        return (
            f"the model does not predict {where}: the error is {size}, {100 * one.unexplained:.3g} percent of the "
            "motion itself. It is too poor, the fit is in a wrong minimum, or the motion is chaotic (predict a shorter "
            "time)"
        )
    ratio = one.rms / one.expected
    if not ratio > AS_EXPECTED:
        return ""
    so = "" if not one.rms > 2 * one.of_fit else f", and {one.rms / one.of_fit:.2g} times the residuals of the fit"
    return (
        f"{where} is predicted to {size}, {one.times_noise:.3g} times the noise{so}, where noise and intervals of the "
        f"parameters let expect {one.expected:.2g}: the model is too poor, or the record differs in something that is "
        "no parameter. The intervals do not contain this error"
    )


class OwnParameters:
    """The problem of hold-out records by what each has for itself, with the common parameters held."""

    def __init__(self, problem: Problem, common: np.ndarray):
        self.problem, self.common = problem, common
        self.experiments, self.noise_is_known = problem.experiments, problem.noise_is_known
        self.n_residuals = problem.n_residuals
        names = problem.unknowns.parts
        sizes = np.cumsum([part.size for part in names])
        self.unknowns = FitUnknowns(tuple(part for part, end in zip(names, sizes, strict=True) if end > common.size))

    @property
    def names(self) -> list[str]:
        """Of the numbers that are fitted."""
        return self.unknowns.names

    @property
    def u0(self) -> np.ndarray:
        """Where the fit begins."""
        return self.problem.u0[self.common.size :]

    def whole(self, own: np.ndarray) -> np.ndarray:
        """All unknowns."""
        return np.concatenate([self.common, own])

    def evaluate(self, us: np.ndarray) -> Evaluation:
        """Residuals, and their derivatives by the own parameters."""
        evaluation = self.problem.evaluate(np.stack([self.whole(u) for u in us]))
        return evaluation._replace(jacobians=evaluation.jacobians[:, :, self.common.size :])

    def cost_and_gradient(self, u: np.ndarray) -> CostAndGradient:
        """Half the sum of squares, and its gradient in reverse mode."""
        result = self.problem.cost_and_gradient(self.whole(u))
        return result._replace(gradient=result.gradient[self.common.size :])

    def until(self, t: float) -> "OwnParameters":
        """The problem with what was measured up to t [s]."""
        return OwnParameters(self.problem.until(t), self.common)


def validation_of(fit, problem: Problem, method: Method) -> Validation:
    """Predict hold-out records with the estimates of a fit.

    Args:
        fit: the fit.
        problem: of the hold-out records, its common unknowns first.
        method: by which their own parameters are fitted.
    """
    n_own = sum(len(one.measured.own) for one in problem.experiments)
    n_common = sum(part.size for part in problem.unknowns.parts[: len(problem.unknowns.parts) - n_own])
    common = fit.u[:n_common]
    if not problem.noise_is_known:
        problem = problem.with_noise([_noise_for(one, fit) for one in problem.experiments], is_known=False)
    u = np.concatenate([common, problem.u0[n_common:]])
    if n_own:
        own: Any = OwnParameters(problem, common)  # stands for a `Problem`, whose methods it has
        courses = Grown().minimize(
            own, method, own.u0[None], noise_is_known=problem.noise_is_known, watch=lambda courses: None
        )
        u = own.whole(courses[0].u) if courses[0].us else u
    evaluation = problem.evaluate(u[None])
    tables = tables_of(problem.experiments, problem.raw(evaluation.residuals[0]))
    failures = {
        str(one.measured.name): _why_failed(one, u)
        for one, table in zip(problem.experiments, tables, strict=True)
        if not np.all(np.isfinite(table[one.is_measured]))
    }
    values = problem.unknowns.flat_values_of(u)
    return Validation(
        problem,
        u,
        tables,
        _errors(fit, problem, tables, evaluation.jacobians[0][:, :n_common]),
        failures,
        dict(zip(problem.names[n_common:], values[n_common:].tolist(), strict=True)),
    )


def _why_failed(experiment: Experiment, u: np.ndarray) -> str:
    prediction = experiment.predict(jnp.asarray(u))
    why = experiment.diagnosis(prediction.status, prediction.t_reached, u)
    return why or "the readings are not finite"


def _noise_for(experiment, fit) -> np.ndarray:
    """Standard deviations of hold-out readings, as the fit estimated them for channels of the same name; else 1."""
    known = _by_component(fit, [np.nan_to_num(noise) for noise in fit.noise])
    sizes = [known.get(name, 1.0) for name in columns_of(experiment)]
    return np.broadcast_to(np.array(sizes), experiment.data.shape)


def _by_component(fit, tables: Sequence[np.ndarray]) -> dict[str, float]:
    """Root mean squares of tables like the measurements of a fit, by component, over all experiments that have it."""
    squares: dict[str, list[np.ndarray]] = {}
    for experiment, table in zip(fit.problem.experiments, tables, strict=True):
        for column, name in enumerate(columns_of(experiment)):
            squares.setdefault(name, []).append(table[experiment.is_measured[:, column], column] ** 2)
    return {
        name: float(np.sqrt(np.mean(np.concatenate(parts))))
        for name, parts in squares.items()
        if sum(part.size for part in parts)
    }


def _errors(fit, problem: Problem, tables: list[np.ndarray], jacobian: np.ndarray) -> list[PredictionErrors]:
    residuals = [np.nan_to_num(table) * noise for table, noise in zip(fit.tables, fit.problem.noise, strict=True)]
    of_fit = _by_component(fit, residuals)
    fitted = {name for one in fit.problem.experiments for name in columns_of(one)}
    n_common = jacobian.shape[1]
    with np.errstate(all="ignore"):  # of parameters that are not determined the variance is infinite
        covariance = fit.knowledge.covariance_of_unknowns[:n_common, :n_common]
        spread = np.einsum("ni,ij,nj->n", jacobian, covariance, jacobian)
    spreads = tables_of(problem.experiments, np.where(np.isfinite(spread), spread, np.inf))
    errors = []
    for experiment, table, noises, moved in zip(problem.experiments, tables, problem.noise, spreads, strict=True):
        for column, (name, unit) in enumerate(zip(columns_of(experiment), units_of(experiment), strict=True)):
            there = experiment.is_measured[:, column]
            if not there.any():
                continue
            noise, measured = noises[there, column], experiment.data[there, column]
            error = table[there, column] * noise
            is_known = problem.noise_is_known or name in fitted
            variance = noise**2 * (float(is_known) + np.maximum(moved[there, column], 0.0))
            errors.append(
                PredictionErrors(
                    record=str(experiment.measured.name),
                    component=name,
                    unit=unit,
                    n=int(there.sum()),
                    rms=_rms(error),
                    largest=float(np.max(np.abs(error))),
                    noise=_rms(noise) if is_known else np.nan,
                    expected=float(np.sqrt(np.mean(variance))),
                    of_fit=of_fit.get(name, np.nan),
                    motion=float(np.std(measured)),
                )
            )
    return errors


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))

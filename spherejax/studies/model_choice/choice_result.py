"""The result of a comparison of models: a row for each, and what the records say."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from spherejax.studies.fit.columns import columns_of
from spherejax.studies.fit.correlation import Process
from spherejax.studies.fit.fit_result import Fit
from spherejax.studies.fit.problem import Problem
from spherejax.studies.fit.validation import aligned
from spherejax.studies.model_choice.evidence import (
    Innovations,
    criterion_of,
    held_out_score,
    n_determined,
    processes_of,
    residuals_of,
    size_of_innovations,
    standard_error,
    whitened,
)
from spherejax.studies.model_choice.figure import figure_of
from spherejax.studies.model_choice.fitted import Fitted

if TYPE_CHECKING:
    import matplotlib.figure
    import xarray

DECISIVE = 6.0
"""Differences of the criterion below this decide nothing: odds of 20 to 1 (Kass and Raftery 1995, "strong")."""

STANDARD_ERRORS = 2.0
"""A difference decides where it is larger than so many of its standard errors."""

POOR = 1.5
"""Residuals of the best model that are larger than the stated noise by this factor: no candidate is right."""


class ModelEvidence(NamedTuple):
    """What the records say about one model.

    Attributes:
        name: of the candidate.
        n_parameters: count of numbers that were fitted.
        n_determined: how many of them the data determine; a direction counts by its part, between 0 and 1.
        residuals: root mean square over the noise, with all values fitted.
        prediction: root mean square of the errors of held-out values over the noise; NaN without.
        criterion: information criterion less that of the best model; negative where it is lower.
        criterion_error: standard error of this difference, by the noise.
        held_out: score of the held-out values less that of the best model; NaN without.
        held_out_error: standard error of this difference.
        distance: of its predictions from those of the best model, in standard deviations of the noise, whitened.
        is_told_apart: whether the records speak against it.
        diagnosis: why it failed; empty of one that was fitted.
        seconds: how long its fits took [s].
    """

    name: str
    n_parameters: int
    n_determined: float
    residuals: float
    prediction: float
    criterion: float
    criterion_error: float
    held_out: float
    held_out_error: float
    distance: float
    is_told_apart: bool
    diagnosis: str
    seconds: float


@dataclass(frozen=True, repr=False)
class ModelComparison:
    """Which of several models has made some records; prints as a table with a verdict.

    Attributes:
        evidence: by candidate, the best first, failed ones last.
        best: name of the candidate that the records speak for; of those that they do not tell apart the one with the
            fewest parameters. None where all failed.
        every_fit: `Fit` to all values of the records of each candidate that ran, by name; that of a model without
            parameters has one that does nothing.
        is_validated: whether records were held out as a whole.
        conflict: what the two judgements disagree in, or nothing.
        noise_is_known: whether the noise was stated.
        seconds: how long it took [s], compilation included.
    """

    evidence: dict[str, ModelEvidence]
    best: str | None
    every_fit: dict[str, Fit]
    is_validated: bool
    conflict: str
    noise_is_known: bool
    seconds: float

    @property
    def fits(self) -> dict[str, Fit]:
        """`Fit` of each candidate with parameters to all values of the records, by name."""
        return {name: fit for name, fit in self.every_fit.items() if self.evidence[name].n_parameters}

    @property
    def is_decided(self) -> bool:
        """Whether the records tell the best model from all others."""
        return self.best is not None and not self.alike and not self.conflict

    @property
    def alike(self) -> list[str]:
        """Models that the records do not tell from the best one."""
        others = (one for one in self.evidence.values() if one.name != self.best and not one.diagnosis)
        return [one.name for one in others if not one.is_told_apart]

    @property
    def n_values(self) -> int:
        """Count of the values of the records."""
        return next((fit.problem.n_residuals for fit in self.every_fit.values()), 0)

    @property
    def warnings(self) -> list[str]:
        """What to think about before the verdict is used, sentences."""
        found = [self.conflict] if self.conflict else []
        found += [
            f"the runs of what was held out fail with the parameters of {one.name}: it does not predict them"
            for one in self.evidence.values()
            if np.isposinf(one.held_out)
        ]
        if self.best is not None and self.noise_is_known and self.evidence[self.best].residuals > POOR:
            found.append(
                f"the best model leaves residuals of {self.evidence[self.best].residuals:.3g} times the stated noise: "
                "none of the candidates explains the records, or its smallest minimum was not found (draws=, starts=)"
            )
        found += [
            f"the fit of {name} has not ended: {self.every_fit[name].diagnosis}"
            for name in ([self.best, *self.alike] if self.best else [])
            if not self.every_fit[name].succeeded
        ]
        return found

    @property
    def verdict(self) -> str:
        """What the records say, in words."""
        if self.best is None:
            return "All candidates failed: nothing can be said."
        best = self.evidence[self.best]
        others = [one for one in self.evidence.values() if one.name != self.best and not one.diagnosis]
        if not others:
            return f"{self.best}: the only candidate that did not fail."
        if self.alike:
            names = _listed([self.best, *self.alike])
            n = self.n_values
            differences = ", ".join(
                f"{name} from {self.best} by {self.evidence[name].distance / np.sqrt(n):.2g} times the noise"
                for name in self.alike
            )
            return (
                f"The records cannot tell {names} apart: over {n} values their predictions differ ({differences}, root "
                f"mean square) by what noise alone can bring about. {self.best} is named because it has the fewest "
                f"parameters ({best.n_parameters}), or the lower criterion among as many. More or longer records, less "
                "noise, or another observable can tell more."
            )
        second = min(others, key=lambda one: one.criterion)
        text = f"The records speak for {self.best}, and against {_listed([one.name for one in others])}"
        text += f": the next one, {second.name}, has a criterion that is larger by {_with_error(second, 'criterion')}"
        if np.isfinite(second.prediction):
            text += (
                f". What was held out is predicted by {second.name} to {second.prediction:.3g} times the noise, by "
                f"{self.best} to {best.prediction:.3g} times"
            )
        return text + "."

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The table, its head first."""
        heads = ("", "parameters", "determined", "residuals", "prediction", "criterion", "held out", "")
        return [heads, *(_row(one, is_best=one.name == self.best) for one in self.evidence.values())]

    def __str__(self) -> str:
        lines = [
            f"Comparison of {len(self.evidence)} models ({self.seconds:.1f} s)",
            "",
            *aligned(self.rows),
            "",
            "residuals, prediction: root mean squares over the noise; criterion, held out: above those of the best",
            "",
            self.verdict,
        ]
        failed = [f"  - {one.name} failed: {one.diagnosis}" for one in self.evidence.values() if one.diagnosis]
        warned = [f"  - {warning}" for warning in self.warnings]
        if failed or warned:
            lines += ["", "Warnings:", *failed, *warned]
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"ModelComparison(best={self.best!r}, decided={self.is_decided}, models={list(self.evidence)})"

    def to_xarray(self) -> "xarray.Dataset":
        """The numbers of the table by model, with the verdict among the attributes."""
        import xarray

        rows = list(self.evidence.values())
        fields = [name for name in ModelEvidence._fields if name not in ("name", "diagnosis")]
        columns: dict[str, Any] = {name: ("model", np.array([getattr(one, name) for one in rows])) for name in fields}
        columns["diagnosis"] = ("model", np.array([one.diagnosis for one in rows], dtype=str))
        columns["seconds"] = (*columns["seconds"], {"units": "s"})
        attributes = {"best": self.best or "", "is_decided": int(self.is_decided), "verdict": self.verdict}
        return xarray.Dataset(columns, {"model": [one.name for one in rows]}, attributes)

    def plot(self, title: str = "") -> "matplotlib.figure.Figure":
        """Errors and criteria of the models, and their predictions beside the first component of the records."""
        return figure_of(self, title)


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _with_error(one: ModelEvidence, what: str) -> str:
    value, error = getattr(one, what), getattr(one, f"{what}_error")
    return f"{value:.4g} +- {error:.2g}" if np.isfinite(value) else "-"


def _row(one: ModelEvidence, *, is_best: bool) -> tuple[str, ...]:
    if one.diagnosis:
        return (one.name, "", "", "", "", "", "", "failed")
    said = "best" if is_best else ("" if one.is_told_apart else "not told apart")
    return (
        one.name,
        str(one.n_parameters),
        f"{one.n_determined:.1f}",
        f"{one.residuals:.3g}",
        f"{one.prediction:.3g}" if np.isfinite(one.prediction) else "-",
        "0" if is_best else _with_error(one, "criterion"),
        "0" if is_best and np.isfinite(one.held_out) else _with_error(one, "held_out"),
        said,
    )


# From fits to evidence ------------------------------------------------------------------------------------------------


class _Judged(NamedTuple):
    """A candidate with all that it is judged by.

    Attributes:
        innovations: of all values of the records, all of them fitted.
        held: of held-out values; None without.
        criterion: of the former.
        score: of the latter; NaN without.
        residuals, prediction: root mean squares over the noise.
    """

    innovations: Innovations
    held: Innovations | None
    criterion: float
    score: float
    residuals: float
    prediction: float


def comparison_of(found: Mapping[str, Fitted], *, is_validated: bool, seconds: float) -> ModelComparison:
    """The evidence of fitted candidates."""
    fits = {name: one.fit for name, one in found.items() if one.fit is not None}
    judged = _judged({name: found[name] for name in fits}) if fits else {}
    best, conflict = None, ""
    if judged:
        totals = {name: one.criterion + (one.score if is_validated else 0.0) for name, one in judged.items()}
        first = min(totals, key=lambda name: totals[name])
        alike = [
            name
            for name in judged
            if name == first or not _is_told_apart(judged[name], judged[first], is_validated=is_validated)
        ]
        best = min(alike, key=lambda name: (_count(found[name]), totals[name]))
        conflict = _conflict(judged, best)
    evidence = {
        name: _evidence(name, found[name], judged.get(name), judged.get(best or ""), is_validated=is_validated)
        for name in found
    }
    order = sorted(evidence.values(), key=lambda one: (bool(one.diagnosis), one.name != best, one.criterion))
    known = all(fit.problem.noise_is_known for fit in fits.values())
    return ModelComparison({one.name: one for one in order}, best, fits, is_validated, conflict, known, seconds)


def _count(one: Fitted) -> int:
    """Numbers that were fitted."""
    assert one.fit is not None
    return one.fit.problem.unknowns.size if one.has_parameters else 0


def _judged(found: Mapping[str, Fitted]) -> dict[str, _Judged]:
    fits: dict[str, Fit] = {name: one.fit for name, one in found.items() if one.fit is not None}
    noise = _shared_noise(fits)
    residuals = {}
    for name, fit in fits.items():
        none = np.zeros(fit.problem.n_residuals, bool)
        residuals[name] = residuals_of(fit.problem, fit.u, noise, none)
    reference = min(residuals, key=lambda name: size_of_innovations(residuals[name]))
    is_known = fits[reference].problem.noise_is_known
    processes = processes_of(residuals[reference], noise_is_known=is_known)
    by_name = {channel.name: process for channel, process in zip(residuals[reference].channels, processes, strict=True)}
    judged = {}
    for name, one in found.items():
        all_of = whitened(residuals[name], processes)
        held, seen, errors = _held_out(one, fits[name], noise, processes, by_name)
        judged[name] = _Judged(
            all_of,
            held,
            criterion_of(all_of),
            np.nan if held is None else held_out_score(held, seen) if np.all(np.isfinite(held.values)) else np.inf,
            _rms(residuals[name].errors),
            _rms(errors),
        )
    return judged


def _shared_noise(fits: Mapping[str, Fit]) -> list[np.ndarray]:
    """Standard deviations by which all models are judged: as stated, or those of the smallest residuals."""
    known = [fit for fit in fits.values() if fit.problem.noise_is_known]
    if known:
        return list(known[0].problem.noise)

    def size(fit: Fit) -> float:
        return sum(
            float(np.sum(np.log(np.maximum(noise[one.is_measured], 1e-300))))
            for noise, one in zip(fit.noise, fit.problem.experiments, strict=True)
        )

    return list(min(fits.values(), key=size).noise)


def _held_out(one: Fitted, fit: Fit, noise, processes: Sequence[Process], by_name: Mapping[str, Process]):
    """Innovations of held-out values, the whitened Jacobian of those that were fitted, and errors over the noise."""
    if one.validation is not None:
        return _of_records(one, fit, noise, processes, by_name)
    if not np.isfinite(one.cuts).any():
        return None, np.zeros((0, 0)), np.full(1, np.nan)
    problem = fit.problem
    later = np.concatenate(
        [
            (experiment.measured.ts > cut)[np.nonzero(experiment.is_measured)[0]]
            for experiment, cut in zip(problem.experiments, one.cuts, strict=True)
        ]
    )
    residuals = residuals_of(problem, one.train_u, noise, later)
    all_of = whitened(residuals, processes)
    held = Innovations(*(part[all_of.is_held_out] for part in all_of))
    return held, all_of.jacobian[~all_of.is_held_out], residuals.errors[later]


def _of_records(one: Fitted, fit: Fit, noise, processes, by_name):
    """Of records that were held out as a whole: what they have for themselves was fitted to them."""
    validation = one.validation
    assert validation is not None
    problem: Problem = validation.problem
    sizes = {
        name: float(np.median(table[:, i]))
        for table, experiment in zip(noise, fit.problem.experiments, strict=True)
        for i, name in enumerate(columns_of(experiment))
    }
    shared = [
        own
        if problem.noise_is_known
        else np.broadcast_to([sizes.get(name, 1.0) for name in columns_of(experiment)], own.shape)
        for own, experiment in zip(problem.noise, problem.experiments, strict=True)
    ]
    residuals = residuals_of(problem, validation.u, shared, np.ones(problem.n_residuals, bool))
    white = Process(np.zeros(0), 1.0)
    held = whitened(residuals, [by_name.get(channel.name, white) for channel in residuals.channels])
    none = np.zeros(fit.problem.n_residuals, bool)
    seen = whitened(residuals_of(fit.problem, fit.u, noise, none), processes)
    n_own = sum(np.size(x) for record in problem.experiments for x in record.measured.own.values())
    common = held.jacobian.shape[1] - n_own
    extra = seen.jacobian.shape[1] - common
    held = held._replace(
        jacobian=np.concatenate(
            [held.jacobian[:, :common], np.zeros((len(held.values), extra)), held.jacobian[:, common:]], 1
        )
    )
    return held, np.concatenate([seen.jacobian, np.zeros((len(seen.values), n_own))], 1), residuals.errors


def _is_told_apart(one: _Judged, best: _Judged, *, is_validated: bool) -> bool:
    """Whether the records speak against a model; records that were held out as a whole are further evidence."""
    difference = one.criterion - best.criterion
    error = standard_error(one.innovations, best.innovations)
    if is_validated and one.held is not None and best.held is not None:
        difference += one.score - best.score
        error = float(np.hypot(error, standard_error(one.held, best.held)))
    return bool(difference > max(DECISIVE, STANDARD_ERRORS * error))


def _conflict(judged: Mapping[str, _Judged], best: str) -> str:
    """Whether held-out values speak for another model than the criterion does."""
    own = judged[best]
    for name, one in judged.items():
        if name == best or one.held is None or own.held is None or not np.isfinite(one.score):
            continue
        error = standard_error(one.held, own.held)
        if own.score - one.score > max(DECISIVE, STANDARD_ERRORS * error):
            return (
                f"{name} predicts what was held out better than {best} does (by {own.score - one.score:.3g}, standard "
                f"error {error:.2g}), though it fits all values worse: the two judgements disagree"
            )
    return ""


def _evidence(
    name: str, found: Fitted, one: _Judged | None, best: _Judged | None, *, is_validated: bool
) -> ModelEvidence:
    nan = float("nan")
    if one is None or best is None:
        return ModelEvidence(name, 0, nan, nan, nan, nan, nan, nan, nan, nan, False, found.diagnosis, found.seconds)
    has_held = one.held is not None and best.held is not None
    error = standard_error(one.innovations, best.innovations)
    return ModelEvidence(
        name=name,
        n_parameters=_count(found),
        n_determined=n_determined(one.innovations.jacobian) if found.has_parameters else 0.0,
        residuals=one.residuals,
        prediction=one.prediction,
        criterion=one.criterion - best.criterion,
        criterion_error=error,
        held_out=one.score - best.score,
        held_out_error=standard_error(one.held, best.held) if has_held else nan,  # type: ignore[arg-type]
        distance=error / 2,
        is_told_apart=one is not best and _is_told_apart(one, best, is_validated=is_validated),
        diagnosis="",
        seconds=found.seconds,
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")

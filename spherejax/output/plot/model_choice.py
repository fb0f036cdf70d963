"""The picture of a comparison of models: how large their errors are, what the criterion says, what they predict."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from spherejax.output.plot.fitted import FittedComponent
from spherejax.output.plot.style import LAW_COLORS, LAW_DASHES, legend_under, letter, new_figure, note, repeated


class ComparedModel(NamedTuple):
    """One model of a comparison.

    Attributes:
        name: of the model.
        is_best: whether the records speak for it.
        residuals, prediction: root mean squares over the noise; the latter NaN without held-out values.
        criterion: information criterion less that of the best model.
        criterion_error: standard error of this difference.
    """

    name: str
    is_best: bool
    residuals: float
    prediction: float
    criterion: float
    criterion_error: float


def model_choice_figure(
    models: Sequence[ComparedModel], record: FittedComponent, predictions: Mapping[str, np.ndarray], title: str
) -> Figure:
    """Errors and criteria by model, and the predictions of all models beside a component of the record."""
    figure, axes = new_figure(2, 2, 9.5, 7.0, title)
    (errors, criteria), (motion, residuals) = axes
    at = np.arange(len(models))[::-1]
    names = [f"{one.name} (best)" if one.is_best else one.name for one in models]
    errors.axvline(1.0, color="0.6", linewidth=0.8, zorder=0)
    errors.plot([one.residuals for one in models], at, "o", color=LAW_COLORS[0], label="residuals, all values fitted")
    if any(np.isfinite(one.prediction) for one in models):
        errors.plot(
            [one.prediction for one in models], at, "s", color=LAW_COLORS[1], fillstyle="none",
            label="prediction of held-out values",
        )  # fmt: skip
    errors.set_xscale("log")
    errors.set_xlabel("root mean square of the errors / noise")
    legend_under(errors, n_columns=1, gap=0.2)
    worse = [(place, one) for place, one in zip(at, models, strict=True) if not one.is_best]
    criteria.errorbar(
        [one.criterion for _, one in worse],
        [place for place, _ in worse],
        xerr=[2 * one.criterion_error for _, one in worse],
        fmt="o", color=LAW_COLORS[0], capsize=3,
    )  # fmt: skip
    criteria.set_xscale("symlog", linthresh=10.0)
    criteria.axvline(0.0, color="0.6", linewidth=0.8, zorder=0)
    criteria.set_xlabel("criterion - that of the best model (bars: 2 standard errors)")
    for ax in (errors, criteria):
        ax.set_yticks(at, names)
        ax.set_ylim(-0.6, len(models) - 0.4)
    motion.plot(record.ts, record.measured, ".", color="0.6", markersize=2.5, label="measured", zorder=0)
    looks = zip(models, repeated(LAW_COLORS, len(models)), repeated(LAW_DASHES, len(models)), strict=True)
    for one, color, dashes in looks:
        line = predictions[one.name]
        motion.plot(record.ts, line, color=color, linestyle=dashes, linewidth=1.2, label=one.name)
        size = np.abs(line - record.measured) / record.noise
        residuals.plot(record.ts, _smoothed(size), color=color, linestyle=dashes, linewidth=1.2)
    motion.set_xlabel("time [s]")
    motion.set_ylabel(record.label)
    legend_under(motion, n_columns=3, gap=0.2)
    residuals.set_yscale("log")
    residuals.axhline(1.0, color="0.6", linewidth=0.8, zorder=0)
    residuals.set_xlabel("time [s]")
    residuals.set_ylabel("error / noise, smoothed")
    note(residuals, "root mean square over a fiftieth of the record")
    letter(list(axes.flat))
    return figure


def _smoothed(sizes: np.ndarray) -> np.ndarray:
    """Running root mean square over a fiftieth of the values."""
    width = max(len(sizes) // 50, 1)
    weights = np.ones(width)
    counts = np.convolve(np.ones(len(sizes)), weights, "same")
    return np.sqrt(np.convolve(sizes**2, weights, "same") / counts)

"""A fit as a text that a person reads."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from spherejax.studies.fit.columns import units_of_channels, widths_of

Units = Mapping[str, tuple[str, float]]
"""By parameter the unit in which it is told, and what numbers in it are multiplied by to be in SI units."""


OUTLIER = 4.0
"""A residual larger than so many standard deviations is called an outlier: of normal errors one in 16,000."""


def report(fit, units: Units = MappingProxyType({})) -> str:
    """Estimates with standard deviations and intervals, how it ended, warnings, what stays open.

    Args:
        fit: the fit.
        units: in which estimates are told; in SI units, and none is named, where nothing is said.
    """
    lines = [headline(fit)]
    if fit.best.us:
        lines += ["", *_table(fit, units)]
    if fit.validation is not None:
        lines += ["", str(fit.validation)]
    if fit.best.us and fit.undetermined:
        lines += ["", "What the data do not determine:", *(f"  - {each.explanation}" for each in fit.undetermined)]
    if fit.warnings:
        lines += ["", "Warnings:", *(f"  - {warning}" for warning in fit.warnings)]
    return "\n".join(lines)


def headline(fit) -> str:
    """What was fitted to what, how it ended, and how far the residuals agree with the noise."""
    n = fit.problem.n_residuals
    experiments = len(fit.problem.experiments)
    of = f"{n} values" + (f" of {experiments} experiments" if experiments > 1 else "")
    text = f"Fit of {', '.join(fit.names)} to {of}: {fit.status} ({fit.n_iterations} iterations, {fit.seconds:.1f} s)"
    if not fit.best.us:
        return text
    if fit.problem.loss is not None:
        far = sum(int(np.sum(np.abs(r) > OUTLIER)) for record in fit.residuals.values() for r in record.values())
        text += f"; {far} outlier{'s' * (far != 1)} beyond {OUTLIER:g} standard deviations"
    if fit.problem.noise_is_known:
        return f"{text}; residuals {np.sqrt(fit.reduced_chi_square):.3g} times the stated noise"
    return f"{text}; {_estimated_noise(fit)}"


def _estimated_noise(fit) -> str:
    parts = []
    for experiment, noise in zip(fit.problem.experiments, fit.problem.noise, strict=True):
        at = 0
        for (name, unit), width in zip(units_of_channels(experiment).items(), widths_of(experiment), strict=True):
            deviation = float(np.median(noise[:, at])) * np.sqrt(fit.reduced_chi_square)
            at += width
            unit = f" {unit}" if unit not in ("", "1") else ""
            of = f" ({experiment.measured.name})" if len(fit.problem.experiments) > 1 else ""
            parts.append(f"{name}{of} {deviation:.3g}{unit}")
    return f"estimated noise: {', '.join(parts)}"


def _table(fit, units: Units) -> list[str]:
    intervals = fit.knowledge.intervals(fit.level)
    heads = ["", "estimate", "std. dev.", "percent", f"{100 * fit.level:g} % interval"]
    rows = [heads]
    for name, value, deviation, (low, high) in zip(
        fit.names, fit.knowledge.values, fit.knowledge.standard_deviations, intervals, strict=True
    ):
        unit, factor = units.get(name, ("", 1.0))
        value, deviation, low, high = (each / factor for each in (value, deviation, low, high))
        head = f"{name} [{unit}]" if unit else name
        rows.append([head, f"{value:.6g}", *deviation_of(value, deviation), f"{low:.6g} to {high:.6g}"])
    widths = [max(len(row[i]) for row in rows) for i in range(len(heads))]
    return [
        "  ".join(
            [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        )
        for row in rows
    ]


def deviation_of(value: float, deviation: float) -> tuple[str, str]:
    """A standard deviation, and how many percent of the estimate it is."""
    if not np.isfinite(deviation):
        return "unknown", "-"
    return f"{deviation:.2g}", f"{100 * deviation / abs(value):.2g}" if value else "-"

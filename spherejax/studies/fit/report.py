"""A fit as a text that a person reads."""

import numpy as np


def report(fit) -> str:
    """Estimates with standard deviations and intervals, how it ended, warnings, what stays open."""
    lines = [headline(fit)]
    if fit.best.us:
        lines += ["", *_table(fit)]
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
    if fit.problem.noise_is_known:
        return f"{text}; residuals {np.sqrt(fit.reduced_chi_square):.3g} times the stated noise"
    return f"{text}; {_estimated_noise(fit)}"


def _estimated_noise(fit) -> str:
    parts = []
    for experiment, noise in zip(fit.problem.experiments, fit.problem.noise, strict=True):
        at = 0
        for observable, values in zip(experiment.frame.observables, experiment.measured.values.values(), strict=True):
            deviation = float(np.median(noise[:, at])) * np.sqrt(fit.reduced_chi_square)
            at += 1 if values.ndim == 1 else values.shape[1]
            unit = f" {observable.unit}" if observable.unit not in ("", "1") else ""
            of = f" ({experiment.measured.name})" if len(fit.problem.experiments) > 1 else ""
            parts.append(f"{observable.name}{of} {deviation:.3g}{unit}")
    return f"estimated noise: {', '.join(parts)}"


def _table(fit) -> list[str]:
    intervals = fit.knowledge.intervals(fit.level)
    head = ["", "estimate", "std. dev.", "percent", f"{100 * fit.level:g} % interval"]
    rows = [head]
    for name, value, deviation, (low, high) in zip(
        fit.names, fit.knowledge.values, fit.knowledge.standard_deviations, intervals, strict=True
    ):
        rows.append([name, f"{value:.6g}", *deviation_of(value, deviation), f"{low:.6g} to {high:.6g}"])
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
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

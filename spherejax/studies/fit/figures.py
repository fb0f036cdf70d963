"""The figures of a fit."""

from typing import TYPE_CHECKING

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.studies.fit.columns import columns_of, shown_units_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figures_of(fit, title: str = "") -> "dict[str, Figure]":
    """Pictures by name: `fit`, `residuals`, `correlation` (of several parameters), `history`, `validation`.

    Args:
        fit: the fit.
        title: what was fitted; the names of the parameters when empty.
    """
    from spherejax.output.plot.fitted import correlation_figure, fit_figure, history_figure, residuals_figure

    if not fit.best.us:
        raise SceneError(f"there is nothing to draw: {fit.diagnosis}")
    title = title or f"Fit of {', '.join(fit.names)}"
    components = components_of(fit.problem, fit.tables, fit.noise)
    drawn = {
        "fit": fit_figure(components, f"{title}: measurements and model"),
        "residuals": residuals_figure(components, f"{title}: residuals"),
        "history": _history(fit, title, history_figure),
    }
    if fit.validation is not None:
        problem = fit.validation.problem
        predicted = components_of(problem, fit.validation.tables, problem.noise)
        drawn["validation"] = fit_figure(predicted, f"{title}: prediction of records that were not fitted")
    if len(fit.names) > 1:
        drawn["correlation"] = correlation_figure(fit.correlation, fit.names, f"{title}: correlations")
    return drawn


def _history(fit, title: str, draw) -> "Figure":
    ends = np.asarray(fit.history["until"])
    counts = {end: _n_until(fit, end) for end in set(ends.tolist())}
    squares = np.asarray(fit.history["cost"]) * 2 / np.array([counts[end] for end in ends.tolist()])
    return draw(squares, ends, np.asarray(fit.history["value"]), fit.names, f"{title}: the way to the minimum")


def _n_until(fit, end: float) -> int:
    experiments = fit.problem.experiments
    return max(sum(int(np.sum(each.is_measured[each.measured.ts <= end])) for each in experiments), 1)


def components_of(problem, tables, noise) -> list:
    """Measured components of all experiments of a problem.

    Args:
        problem: whose experiments they are.
        tables: prediction minus measurement over the noise of the problem.
        noise: standard deviations.
    """
    from spherejax.output.plot.fitted import FittedComponent

    components = []
    for i, experiment in enumerate(problem.experiments):
        several = f"{experiment.measured.name}: " if len(problem.experiments) > 1 else ""
        named = zip(columns_of(experiment), shown_units_of(experiment), strict=True)
        for column, (name, (unit, factor)) in enumerate(named):
            there = experiment.is_measured[:, column]
            if not there.any():
                continue
            measured = experiment.data[there, column]
            predicted = measured + tables[i][there, column] * problem.noise[i][there, column]
            label = f"{several}{name} [{unit}]" if unit else f"{several}{name}"
            shown = (values / factor for values in (measured, predicted, noise[i][there, column]))
            components.append(FittedComponent(label, experiment.measured.ts[there], *shown))
    return components

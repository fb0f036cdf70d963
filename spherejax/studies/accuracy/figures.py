"""The figures of a study of accuracy."""

from typing import TYPE_CHECKING

import numpy as np

from spherejax.studies.accuracy.samples import UNITS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from spherejax.output.plot.work_precision import WorkDiagram
    from spherejax.studies.accuracy.result import WorkPrecision


_PANELS = {
    "peak_acceleration": ("peak acceleration [m/s$^2$]", 1.0),
    "dissipated_energy": ("dissipated energy [mJ]", 1e3),
    "time_in_contact": ("time in contact [s]", 1.0),
    "n_onsets": ("contact onsets of the whole run", 1.0),
    "eccentricity_05": ("|e|, exceeded in 95 % of the time [um]", 1e6),
    "eccentricity_50": ("|e|, exceeded half of the time [um]", 1e6),
    "eccentricity_95": ("|e|, exceeded in 5 % of the time [um]", 1e6),
}
"""Titles of the statistics, with the unit of the axis, and the factor to it."""


def figures_of(result: "WorkPrecision", model: str) -> "dict[str, Figure]":
    """The figures of one model by name: `work_precision`, `steps`, and `statistics` where histories do not repeat.

    Args:
        result: the study.
        model: one of `result.models`.
    """
    from spherejax.output.plot.work_precision import statistics_figure, steps_figure, work_precision_figure

    diagram = diagram_of(result, model)
    drawn = {"work_precision": work_precision_figure(diagram), "steps": steps_figure(diagram)}
    parted = result.references[model].parted
    if diagram.statistics and parted is not None:
        title = f"{model}: statistics from {parted:.3g} s, when tight runs have parted, to {result.t1:g} s"
        drawn["statistics"] = statistics_figure(diagram, title)
    return drawn


def diagram_of(result: "WorkPrecision", model: str) -> "WorkDiagram":
    """What the figures of one model show."""
    from spherejax.output.plot.work_precision import Statistic, WorkCurve, WorkDiagram

    reference = result.references[model]
    rows = [row for row in result.rows_of(model) if row.succeeded]
    curves = []
    for solver in dict.fromkeys(row.solver for row in rows):
        own = [row for row in rows if row.solver == solver]
        curves.append(
            WorkCurve(
                solver,
                [row.rtol for row in own],
                [row.seconds for row in own],
                [row.n_steps for row in own],
                {name: [row.errors[name] for row in own] for name in UNITS},
                {name: [row.statistics[name] for row in own] for name in own[0].statistics},
            )
        )
    known = reference.members[0] if reference.members else {}
    columns = {name: [member[name] for member in reference.members] for name in known}
    frontiers = {name: result.frontier(model, name) for name in UNITS}
    failed = list(dict.fromkeys(row.solver for row in result.rows_of(model) if not row.succeeded))
    return WorkDiagram(
        f"{model}: what accuracy costs, {result.t1:g} s of motion\n{result.advice[model]}",
        curves,
        UNITS,
        {name: reference.floor(name) for name in UNITS},
        {name: ([p.seconds for p in points], [p.error for p in points]) for name, points in frontiers.items()},
        {
            name: Statistic(*_PANELS[name], float(np.mean(values)), float(np.std(values, ddof=1)))
            for name, values in columns.items()
        },
        f"did not finish at every tolerance: {', '.join(failed)}" if failed else "",
    )


def overview_of(result: "WorkPrecision") -> "Figure":
    """The efficient runs of all models in one figure.

    Args:
        result: the study.
    """
    from spherejax.output.plot.work_precision import frontiers_figure

    runs = {
        model: [(p.seconds, p.error, f"{p.solver} {p.rtol:.0e}") for p in result.frontier(model)]
        for model in result.models
    }
    title = f"What accuracy costs, {result.t1:g} s of motion: the best run of each model for every error"
    return frontiers_figure(runs, title)

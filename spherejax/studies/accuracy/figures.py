"""The figures of a study of accuracy."""

from typing import TYPE_CHECKING

import numpy as np

from spherejax.studies.accuracy.samples import STATISTICS, UNITS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from spherejax.output.plot.work_precision import WorkDiagram
    from spherejax.studies.accuracy.result import WorkPrecision


def figures_of(result: "WorkPrecision", model: str) -> "dict[str, Figure]":
    """The figures of one model by name: `work_precision`, `steps`, and `statistics` where histories do not repeat.

    Args:
        result: the study.
        model: one of `result.models`.
    """
    from spherejax.output.plot.work_precision import statistics_figure, steps_figure, work_precision_figure

    diagram = diagram_of(result, model)
    drawn = {"work_precision": work_precision_figure(diagram), "steps": steps_figure(diagram)}
    if diagram.statistics:
        drawn["statistics"] = statistics_figure(diagram)
    return drawn


def diagram_of(result: "WorkPrecision", model: str) -> "WorkDiagram":
    """What the figures of one model show."""
    from spherejax.output.plot.work_precision import WorkCurve, WorkDiagram

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
    until = "" if reference.horizon is None else f", errors of the first {reference.horizon:.3g} s"
    frontiers = {name: result.frontier(model, name) for name in UNITS}
    return WorkDiagram(
        f"{model}: what accuracy costs, {result.t1:g} s of motion{until}\n{result.advice[model]}",
        curves,
        UNITS,
        {name: reference.floor(name) for name in UNITS},
        {name: ([p.seconds for p in points], [p.error for p in points]) for name, points in frontiers.items()},
        {
            name: (STATISTICS[name][0], float(np.mean(values)), float(np.std(values, ddof=1)))
            for name, values in columns.items()
        },
    )

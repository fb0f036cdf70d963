"""The report of a fit as a page."""

from types import MappingProxyType
from typing import Any

import numpy as np

from spherejax.model.scene import Scene
from spherejax.motion.runs.many import built
from spherejax.output.report.page import Page, PagePicture, PageTable, PageText
from spherejax.studies.fit.columns import units_of_channels
from spherejax.studies.fit.report import Units, deviation_of, headline, report


def page_of(fit, title: str, scene: Scene | None, units: Units = MappingProxyType({})) -> Page:
    """Estimates, what the data do not determine, figures, the fitted motions, numbers used.

    Args:
        fit: the fit.
        title: the heading.
        scene: whose numbers are listed; that of the first experiment at the estimates when None.
        units: in which estimates are told; in SI units, and none is named, where nothing is said.
    """
    from spherejax.output.report.of_runs import add_motion, add_sources, add_versions, cautions_of

    names = ", ".join(fit.names)
    verdict = f"Succeeded: {fit.status}." if fit.succeeded else f"FAILED: {fit.status}."
    page = Page(title or f"Fit of {names}", verdict)
    page.failed += [] if fit.succeeded else fit.diagnosis.splitlines() or ["no minimum was found"]
    if not fit.best.us:
        page.add("The fit", PageText(report(fit, units).splitlines(), fixed=True))
        add_versions(page)
        return page
    page.cautions += [*fit.warnings, *(each.explanation for each in fit.undetermined)]
    page.cautions += [f"{name}: {said}" for name, run in fit.runs.items() for said in cautions_of(run)]
    page.add(
        "Estimates", PageText([headline(fit)]), _estimates(fit, units)
    )  # what else `print(fit)` says stands on top
    page.add("Measurements", _measurements(fit), _starts(fit, units))
    if fit.validation is not None:
        head, *rows = fit.validation.rows
        title = str(fit.validation).splitlines()[0].rstrip(":")
        page.add("Prediction", PageTable(("reading", *head[1:]), rows, title))
    page.add("Figures", *(PagePicture(figure, f"{name}, {names}") for name, figure in fit.figures(title).items()))
    add_motion(page, fit.runs, scene)
    scene = scene or built(fit.problem.experiments[0].build, fit.estimates)
    add_sources(page, scene, next(iter(fit.runs.values())))
    return page


def _estimates(fit, units: Units) -> PageTable:
    known, rows = fit.knowledge, []
    for name, value, deviation, (low, high) in zip(
        fit.names, known.values, known.standard_deviations, known.intervals(fit.level), strict=True
    ):
        unit, factor = units.get(name, ("", 1.0))
        value, deviation, low, high = (each / factor for each in (value, deviation, low, high))
        head = f"{name} [{unit}]" if unit else name
        rows.append((head, f"{value:.8g}", *deviation_of(value, deviation), f"{low:.6g}", f"{high:.6g}"))
    level = f"{100 * fit.level:g} %"
    heads = ("parameter", "estimate", "standard deviation", "percent", f"{level} from", f"{level} to")
    return PageTable(heads, rows, numeric=True)


def _measurements(fit) -> PageTable:
    rows = [
        (
            str(one.measured.name),
            ", ".join(f"{name} [{unit}]" if unit else name for name, unit in units_of_channels(one).items()),
            f"{int(np.sum(one.is_measured)):,}",
            f"{one.measured.ts[0]:.6g}",
            f"{one.measured.ts[-1]:.6g}",
        )
        for one in fit.problem.experiments
    ]
    return PageTable(("experiment", "what was measured", "values", "from [s]", "to [s]"), rows)


def _starts(fit, units: Units) -> PageTable:
    def told(name: str, value: Any) -> str:
        unit, factor = units.get(name, ("", 1.0))
        return f"{name} = {value / factor:.6g} {unit}".rstrip()

    def said(values: dict[str, Any] | None) -> str:
        return "-" if values is None else ", ".join(told(*each) for each in values.items())

    rows = [
        (said(one["start"]), said(one["end"]), f"{one['cost']:.6g}", one["status"], str(one["n_iterations"]))
        for one in fit.starts
    ]
    return PageTable(("start", "end", "cost", "status", "iterations"), rows, "Where each start went")

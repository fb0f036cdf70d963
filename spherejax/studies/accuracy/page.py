"""The report of a study of accuracy as a page."""

from spherejax.model.scene import Scene
from spherejax.output.report.page import Page, PagePicture, PageTable, PageText
from spherejax.studies.accuracy.samples import UNITS

HEADS = (
    "solver", "rtol", "time", "steps", "rejected", "run.error [m]",
    *(f"{name} [{unit}]" for name, unit in UNITS.items()),
)  # fmt: skip
"""Heads of the table of runs; `run.error` estimates the position's error, which stands beside it."""


def page_of(study, title: str, scene: Scene | None) -> Page:
    """Errors, times and advice of every model, with what did not finish on top.

    Args:
        study: the study.
        title: the heading.
        scene: whose numbers are listed and that is drawn; the study itself keeps none.
    """
    from spherejax.output.report.motion import viewed
    from spherejax.output.report.of_runs import add_sources, add_versions
    from spherejax.output.report.page import PageMotion

    n_failed, n = sum(not row.succeeded for row in study.rows), len(study.rows)
    verdict = f"{n - n_failed:,} of {n:,} runs finished, {study.t1:g} s of motion each."
    page = Page(title or f"What accuracy costs: {', '.join(filter(None, (study.name, *study.models)))}", verdict)
    if n_failed == n:
        page.failed.append("No run finished; see the tables for why.")
    for model in study.models:
        page.cautions += [f"{model}: {note}" for note in study.cautions_of(model)]
    if len(study.models) > 1:
        page.add("All models", PagePicture(study.overview(), "the efficient runs of all models"))
    for model in study.models:
        rows = [study.cells(row) for row in study.rows_of(model)]
        table = PageTable(
            HEADS, rows, "Largest errors at the samples; < marks those that the reference resolves no further"
        )
        why = [(row.solver, f"{row.rtol:.0e}", row.diagnosis) for row in study.rows_of(model) if not row.succeeded]
        figures = [PagePicture(figure, f"{name} of {model}") for name, figure in study.figures(model).items()]
        said = PageText([study.advice[model], *study.measured_by(model)])
        page.add(model, said, *figures, table, PageTable(("solver", "rtol", "why it did not finish"), why))
    if scene is None:
        add_versions(page)
    else:
        page.add("The mechanism", PageMotion([viewed(scene, "")]))
        add_sources(page, scene)
    return page

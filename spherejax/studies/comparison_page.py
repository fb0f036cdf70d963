"""The report of a comparison of joint models as a page."""

from dataclasses import replace

from spherejax.model.scene import Scene
from spherejax.output.report.page import Page, PagePicture, PageTable, PageText


def page_of(comparison, title: str, scene: Scene | None) -> Page:
    """Tables and figures of the comparison, the motions of all models, the numbers of their joints.

    Args:
        comparison: the comparison.
        title: the heading.
        scene: whose numbers are listed; those of the runs when None.
    """
    from spherejax.output.report.of_runs import add_cited, add_motion, add_numbers, add_versions, cautions_of

    subject, runs = comparison.subject, comparison.runs
    failed = [name for name, run in runs.items() if not bool(run.succeeded)]
    verdict = f"FAILED: {', '.join(failed)}." if failed else f"Succeeded: all models reached {comparison.t_end:g} s."
    page = Page(title or f"Joint models of {subject.joint} compared: {subject.name}", verdict)
    page.failed += [f"{name}: {runs[name].diagnosis}" for name in failed]
    for row in comparison.rows:
        if row.determined_until is not None:
            page.cautions.append(
                f"{row.label}: the motion is determined until {row.determined_until:.3g} s; what is later is one of "
                "many histories that are equally right."
            )
        page.cautions += [f"{row.label}: {said}" for said in cautions_of(runs[row.name])]
    labels = {row.name: row.label for row in comparison.rows}
    add_motion(page, {labels[name]: run for name, run in runs.items()}, scene)
    n_studies = len(comparison.studies)
    tables = [PageTable(one.heads, one.rows, one.title, numeric=True) for one in comparison.tables]
    page.add("Models", *tables[: len(tables) - n_studies], PageText(comparison.remarks))
    methods = [(row.label, row.method, f"{row.n_steps:,}", f"{row.seconds:.3g}") for row in comparison.rows]
    page.add("Methods", PageTable(("model", "method, and why", "steps", "time of a warm run [s]"), methods))
    for table in tables[len(tables) - n_studies :]:
        page.add(table.caption, replace(table, caption=""), folded=True)
    figures = subject.figures(comparison)
    page.add("Figures", *(PagePicture(figure_of(), name) for name, figure_of in figures.items()))
    add_numbers(page, scene or next(iter(runs.values())).system)
    for name, run in runs.items():
        add_numbers(page, run.system, f"Numbers of {subject.joint}, {labels[name]}", f"joints.{subject.joint}")
    add_cited(page, list(runs.values()))
    add_versions(page)
    return page

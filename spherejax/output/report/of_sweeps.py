"""Reports of sweeps."""

from typing import TYPE_CHECKING

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.motion.integration.status import Status
from spherejax.motion.results.run_flags import flagged_runs
from spherejax.output.plot.swept import COUNTED, figures_of_sweep
from spherejax.output.report.motion import viewed
from spherejax.output.report.of_runs import add_sources, add_versions
from spherejax.output.report.page import Page, PageMotion, PagePicture, PageTable, pairs

if TYPE_CHECKING:
    import xarray

MISSING = -1
"""Status of runs that a store does not hold yet."""


def page_of_sweep(swept: "xarray.Dataset", title: str, scene: Scene | None) -> Page:
    """The report of what `sj.sweep` or `sj.open_sweep` gives.

    Raises:
        SceneError: for a data set that is no sweep.
    """
    if not {"status", "t_reached", "n_steps"} <= set(swept.data_vars):
        raise SceneError("this data set is no result of sj.sweep: it has no status; give the sweep, or a run")
    status = np.asarray(swept["status"])
    failed, missing = int((status > Status.SUCCEEDED).sum()), int((status == MISSING).sum())
    done = f"Succeeded: all {status.size:,} runs." if not failed else f"FAILED: {failed:,} of {status.size:,} runs."
    if missing:
        word = "FAILED" if failed else "NOT FINISHED"
        done = f"{word}: {missing:,} of {status.size:,} runs are missing, {failed:,} failed."
    page = Page(title or f"Sweep of {', '.join(_varied(swept))}", done)
    page.failed += [line for line in str(swept.attrs.get("failures", "")).splitlines() if line]
    if missing:
        page.failed.append("Runs are missing: give the same call with the same store to go on.")
    if swept.attrs.get("cautions"):
        page.cautions.append(str(swept.attrs["cautions"]))
    page.add("What was varied", _parameters(swept))
    page.add("Results", _results(swept), _flagged(swept))
    figures = figures_of_sweep(swept, title)
    page.add("Figures", *(PagePicture(figure, f"{name} over what was varied") for name, figure in figures.items()))
    page.add("All runs", _table(swept), folded=True)
    if scene is not None:
        page.add("The mechanism", PageMotion([viewed(scene, "")]))
    facts = [(name.replace("_", " "), value) for name, value in swept.attrs.items() if np.ndim(value) == 0]
    page.add("How it was made", pairs((name, value) for name, value in facts if name not in ("failures", "cautions")))
    if scene is None:
        add_versions(page)
    else:
        add_sources(page, scene)
    return page


def _varied(swept: "xarray.Dataset") -> list[str]:
    return [str(name) for name in swept["status"].coords if name != "run"]


def _parameters(swept: "xarray.Dataset") -> PageTable:
    rows = [
        (name, swept[name].attrs.get("units", ""), f"{len(np.unique(swept[name])):,}", *_ends(np.asarray(swept[name])))
        for name in _varied(swept)
    ]
    return PageTable(("parameter", "unit", "values", "least", "largest"), rows, numeric=True)


def _kept(swept: "xarray.Dataset") -> list[str]:
    return [str(name) for name in swept.data_vars if name not in COUNTED]


def _results(swept: "xarray.Dataset") -> PageTable:
    rows = [
        (
            name,
            swept[name].attrs.get("units", ""),
            *_ends(np.asarray(swept[name], float)),
            ", ".join(map(str, swept[name].dims)),
        )
        for name in [*_kept(swept), "n_steps"]
    ]
    return PageTable(("quantity", "unit", "least", "largest", "dimensions"), rows, "Over all runs that have a value")


def _flagged(swept: "xarray.Dataset") -> PageTable:
    rows = []
    for runs in flagged_runs(swept):
        where = [f"{name} {' to '.join(_ends(np.array(ends)))}" for name, ends in runs.ranges(swept).items()]
        reached = " to ".join(_ends(np.array(runs.t_reached)))
        rows.append((runs.what, f"{runs.n:,}", "; ".join(where), reached, runs.text))
    return PageTable(
        ("why", "runs", "where", "time reached [s]", "what to do"), rows, "Runs that failed, or left the range of a law"
    )


def _table(swept: "xarray.Dataset") -> PageTable:
    """A row for each run: parameters, how it ended, single numbers."""
    dims = swept["status"].dims
    single = [name for name in _kept(swept) if swept[name].dims == dims]
    names = [*_varied(swept), "status", "t_reached", "n_steps", *single]
    columns = [
        np.asarray(swept[name].broadcast_like(swept["status"]).transpose(*dims)).ravel()
        if name in swept.coords
        else np.asarray(swept[name]).ravel()
        for name in names
    ]
    rows = [
        tuple(_cell(name, value) for name, value in zip(names, row, strict=True)) for row in zip(*columns, strict=True)
    ]
    heads = [
        f"{name} [{unit}]" if (unit := swept[name].attrs.get("units", "")) not in ("", "1") else name for name in names
    ]
    return PageTable(heads, rows, numeric=True)


def _cell(name: str, value) -> str:
    if name == "status":
        return "missing" if value == MISSING else Status(int(value)).name.lower().replace("_", " ")
    return f"{value:.6g}" if np.issubdtype(type(value), np.number) else str(value)


def _ends(values: np.ndarray) -> tuple[str, str]:
    values = values[np.isfinite(values)]
    return (f"{values.min():.6g}", f"{values.max():.6g}") if values.size else ("-", "-")

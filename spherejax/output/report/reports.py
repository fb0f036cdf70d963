"""`sj.report`: from a result to its page."""

import os
from pathlib import Path
from typing import Any

from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.motion.results.trajectory import Trajectory
from spherejax.output.report.page import Page, target


def report(
    what: Any,
    path: str | os.PathLike,
    *,
    scene: Scene | None = None,
    title: str = "",
    overwrite: bool = False,
) -> Path:
    """Write a page of HTML about a result: one file that opens in any browser, without a network.

    On top stands how it ended, in red with the diagnosis where something failed, in amber what is to be minded. Below
    are the mechanism in space, to play and turn; figures; tables of costs, audit, peaks and contacts; every number that
    was used, with its unit; what to cite; versions.

    Of a run, peaks and contacts come from its steps: the run is made once more, as by `run.peak`. Of lanes, all are in
    a table, and the first that failed (or the first) is told in full. Pictures become coarser where a page would exceed
    5 MB.

    Args:
        what: a run or lanes (`Trajectory`, or the `Runs` of `sj.simulate_many`), the data set of `sj.sweep` or
            `sj.open_sweep`, a `Fit`, a `WorkPrecision`, a comparison of joint models, or a scene.
        path: where to write, `.html`; missing folders are made.

    Other args:
        scene: the scene that was simulated: its named points are drawn, and its numbers are listed as it describes
            them, joints in world axes. A sweep has no mechanism to show and no numbers without one.
        title: the heading; by default what it is about.
        overwrite: replace an existing file.

    Returns:
        The path.

    Raises:
        SceneError: for anything else, a traced run, another ending, or an existing file without `overwrite`; before
            anything is computed.
    """
    path = target(path, overwrite=overwrite)
    return page_of(what, title, scene).write(path, overwrite=overwrite)


def page_of(what: Any, title: str, scene: Scene | None) -> Page:
    """The page of a result."""
    from spherejax.output.report.of_runs import page_of_run, page_of_scene

    if isinstance(what, Trajectory):
        return page_of_run(what, title, scene)
    if isinstance(what, Scene):
        return page_of_scene(what, title)
    if isinstance(getattr(what, "trajectories", None), Trajectory):
        return page_of_run(what.trajectories, title, scene)
    if hasattr(what, "report_page"):
        return what.report_page(title, scene)
    if hasattr(what, "data_vars"):
        from spherejax.output.report.of_sweeps import page_of_sweep

        return page_of_sweep(what, title, scene)
    raise SceneError(
        f"{type(what).__name__} cannot be reported; give a run, lanes, the result of sj.sweep, sj.fit, "
        "sj.work_precision or a comparison, or a scene"
    )

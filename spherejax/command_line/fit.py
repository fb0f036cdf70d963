"""`spherejax fit`: parameters of a mechanism from measurements of its motion."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import spherejax as sj
from spherejax.command_line.catalog import SOLVERS
from spherejax.command_line.measurements import add_measurements, measured_from, noise_of
from spherejax.command_line.models import add_joint_options
from spherejax.command_line.numbers import real, whole
from spherejax.command_line.printing import print_table, say
from spherejax.command_line.reports import add_report, check_report, write_report
from spherejax.command_line.scene_numbers import UnitOf, units_in
from spherejax.command_line.scenes import add_scene, chosen
from spherejax.command_line.shown import ShownNumbers, shown_in
from spherejax.command_line.unknowns import builder_of, own_numbers, starts_of, with_starts

DESCRIPTION = """\
Estimate numbers of a mechanism from measurements of its motion, by Levenberg-Marquardt on
forward sensitivities. Measurements come in a table (CSV) whose first row names the columns,
    time,position.rocker.z
    0.001,0.032606
or in a netCDF file. Columns may have units, position.rocker.z [mm], and empty cells. What is fitted is
an option of the studied joint (stiffness, clearance, mu, ...) or a number of the scene
(bodies.rocker.mass, forces.shock.stiffness). Written are the estimates with standard deviations and
intervals (estimates.csv), the report, everything else (fit.nc), and pictures.
"""

EPILOG = """examples:
  spherejax fit four-bar --joint bushing --measured rocker.csv --start stiffness=1e4 --start damping=1e-2 \\
      --noise 1e-6 --out fit/
  spherejax fit four-bar --joint bushing --measured one.csv --validate other.csv --start stiffness=1e4
  spherejax fit scene.toml --measured drop.csv --start joints.elbow.model.clearance=1e-4:1e-5:1e-3 --out fit/
"""

FILES = ("estimates.csv", "report.txt", "fit.nc")

LOSSES = {"huber": lambda: sj.studies.Huber(), "cauchy": lambda: sj.studies.Cauchy()}
"""Robust losses by name; made when they are asked for, for importing them takes long."""


def add_fit(commands) -> None:
    """The command `fit`."""
    parser = commands.add_parser(
        "fit",
        help="estimate parameters from measurements",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser)
    add_joint_options(parser)
    add_measurements(parser)
    wanted = parser.add_argument_group("what is fitted")
    wanted.add_argument(
        "--start",
        action="append",
        required=True,
        metavar="NAME=VALUE[:LOW:HIGH]",
        help="where to begin, and bounds; once for each parameter. VALUE may be left out (NAME alone): the scene's own",
    )
    wanted.add_argument("--starts", type=whole, default=1, metavar="N", help="further starts around it (default: 1)")
    how = parser.add_argument_group("how")
    how.add_argument("--whole", action="store_true", help="begin with the whole record, not with its first parts")
    how.add_argument(
        "--loss",
        choices=LOSSES,
        help="how much outliers count (default: by their squares); huber for a few, cauchy for gross errors",
    )
    how.add_argument("--max-iterations", type=whole, default=100, metavar="N", help="steps (default: 100)")
    how.add_argument("--level", type=real, default=0.95, help="of the confidence intervals (default: 0.95)")
    how.add_argument("--rtol", type=real, default=1e-8, help="relative tolerance of a step (default: 1e-8)")
    how.add_argument("--solver", choices=SOLVERS, help="integrator (default: chosen by the scene)")
    files = parser.add_argument_group("files")
    files.add_argument("--out", metavar="FOLDER", help=f"write {', '.join(FILES)} and pictures to this folder")
    add_report(files, "the fit")
    files.add_argument("--overwrite", action="store_true", help="replace the files of an earlier fit")
    files.add_argument("--no-pictures", action="store_true", help="write no pictures")
    parser.set_defaults(action=fit_scene)


def fit_scene(options: argparse.Namespace) -> int:
    """Fit, print the report, write everything."""
    from spherejax.output.paths import make_folder, require_free

    folder = None if options.out is None else Path(options.out).expanduser()
    if folder is not None:
        require_free(folder / FILES[0], overwrite=options.overwrite)
    check_report(options)
    asked = starts_of(options)
    found = chosen(with_starts(options, asked))
    scene = found.scene(with_starts(options, asked))
    own = own_numbers(found, scene, asked)
    unit_of = units_in(scene, found.studied)
    asked = starts_of(options, unit_of)  # a unit of another dimension is refused
    from spherejax.studies.fit import Ending, Whole  # it takes long: names and units have been judged

    start = {name: sj.Parameter(own[name]) if begin is None else begin.parameter for name, begin in asked.items()}
    measured, held_out = (
        [measured_from(path, options) for path in paths] for paths in (options.measured, options.validate)
    )
    if folder is not None:
        make_folder(folder)
    fitted = sj.fit(
        builder_of(found, options),
        start,
        measured,
        validate=held_out or None,
        noise=noise_of(options, scene, [*measured, *held_out]),
        loss=LOSSES[options.loss]() if options.loss else None,
        method=sj.studies.LevenbergMarquardt(max_iterations=options.max_iterations),
        starts=options.starts,
        horizon=Whole() if options.whole else None,
        rtol=options.rtol,
        solver=SOLVERS[options.solver]() if options.solver else None,
        level=options.level,
    )
    shown = _shown(options, unit_of)
    _print(fitted, shown)
    if folder is not None and fitted.best.us:
        names = _write(fitted, shown, folder, found.title or found.name, pictures=not options.no_pictures)
        print(f"wrote {', '.join(names)} to {folder}")
    write_report(options, _InUnits(fitted, shown), "")
    if fitted.best.ending is Ending.INTERRUPTED:
        raise KeyboardInterrupt
    if not fitted.succeeded:
        raise sj.SimulationError(fitted.diagnosis)
    return 0


class _InUnits(NamedTuple):
    """A fit whose page tells the estimates in the units that were given."""

    fitted: sj.studies.Fit
    shown: dict[str, ShownNumbers]

    def report_page(self, title: str, scene: sj.Scene | None) -> Any:
        """The page that `sj.report` writes."""
        from spherejax.studies.fit.page import page_of

        return page_of(self.fitted, title, scene, self.shown)


def _shown(options: argparse.Namespace, unit_of: UnitOf) -> dict[str, ShownNumbers]:
    """In which units the parameters are told."""
    given = (text.partition("=") for text in options.start)
    return {name: shown_in(texts.split(":"), unit_of(name)) for name, _, texts in given}


def _print(fitted: sj.studies.Fit, shown: dict[str, ShownNumbers]) -> None:
    from spherejax.studies.fit.report import report

    say(report(fitted, shown))
    if len(fitted.courses) > 1:
        told = {name: shown.get(name, ShownNumbers()) for name in fitted.names}
        rows = [
            (*(f"{v / told[name].factor:.5g}" for name, v in (each["end"] or dict.fromkeys(told, np.nan)).items()),
             f"{each['cost']:.6g}", each["status"])
            for each in fitted.starts
        ]  # fmt: skip
        print_table("starts", (*(one.head(name) for name, one in told.items()), "cost", "status"), rows)


def _write(
    fitted: sj.studies.Fit, shown: dict[str, ShownNumbers], folder: Path, title: str, *, pictures: bool
) -> list[str]:
    """Table, report, data set and figures; returns their names."""
    from spherejax.files.paths.drafts import draft_of
    from spherejax.studies.fit.report import report

    _write_estimates(fitted, shown, folder / FILES[0])
    with draft_of(folder / FILES[1]) as draft:
        draft.write_text(f"{report(fitted, shown)}\n", encoding="utf-8")
    fitted.save(folder / FILES[2], overwrite=True)
    names: list[str] = [*FILES]
    for name, figure in fitted.figures(title).items() if pictures else ():
        figure.savefig(folder / f"{name}.png")
        names.append(f"{name}.png")
    return names


def _write_estimates(fitted: sj.studies.Fit, shown: dict[str, ShownNumbers], path: Path) -> None:
    from spherejax.output.tables import write_rows

    known = fitted.knowledge
    rows = []
    for name, value, deviation, (low, high) in zip(
        fitted.names, known.values, known.standard_deviations, known.intervals(fitted.level), strict=True
    ):
        unit, factor = shown.get(name, ShownNumbers())
        rows.append([name, *(repr(float(v) / factor) for v in (value, deviation, low, high)), fitted.level, unit])
    write_rows(path, ["parameter", "estimate", "standard_deviation", "low", "high", "level", "unit"], rows)

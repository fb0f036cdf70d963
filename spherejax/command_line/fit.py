"""`spherejax fit`: parameters of a mechanism from measurements of its motion."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import spherejax as sj
from spherejax.command_line.catalog import SOLVERS
from spherejax.command_line.models import USED_BY, add_joint_options
from spherejax.command_line.numbers import measured_in, number_of, real, whole
from spherejax.command_line.printing import print_table, say
from spherejax.command_line.reports import add_report, check_report, write_report
from spherejax.command_line.scene_numbers import UnitOf, number_at, unit_of_option, units_in, with_number
from spherejax.command_line.scenes import Chosen, add_scene, chosen
from spherejax.command_line.shown import ShownNumbers, shown_in

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

LOSSES = {"huber": lambda: sj.Huber(), "cauchy": lambda: sj.Cauchy()}
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
    given = parser.add_argument_group("what was measured")
    given.add_argument(
        "--measured",
        action="append",
        required=True,
        metavar="FILE",
        help="table (.csv) or netCDF file (.nc); may be repeated: several experiments with the same mechanism",
    )
    given.add_argument(
        "--validate",
        action="append",
        default=[],
        metavar="FILE",
        help="table or netCDF file that is not fitted but predicted: how large the errors are, against the noise and "
        "the residuals; may be repeated",
    )
    given.add_argument(
        "--noise",
        action="append",
        metavar="[NAME=]SIGMA",
        help='standard deviation of the errors, of all columns or of one, in SI units or as "2 um" (default: from the '
        "residuals)",
    )
    given.add_argument(
        "--column",
        action="append",
        default=[],
        metavar="OWN=QUANTITY",
        help='what a column of the file is, where it has a name of its own: "height=position.rocker.z [mm]"; others '
        "are left out; may be repeated",
    )
    given.add_argument("--t0", type=measured_in("s"), metavar="S", help="when the motion starts [s] (default: 0)")
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
    asked = _starts(options)
    found = chosen(_with_starts(options, asked))
    scene = found.scene(_with_starts(options, asked))
    own = _own_numbers(found, scene, asked)
    unit_of = units_in(scene, found.studied)
    asked = _starts(options, unit_of)  # a unit of another dimension is refused
    from spherejax.studies.fit import Ending, Whole  # it takes long: names and units have been judged

    start = {name: sj.Parameter(own[name]) if begin is None else begin.parameter for name, begin in asked.items()}
    measured, held_out = (
        [_measured(path, options) for path in paths] for paths in (options.measured, options.validate)
    )
    if folder is not None:
        make_folder(folder)
    fitted = sj.fit(
        _builder(found, options),
        start,
        measured,
        validate=held_out or None,
        noise=_noise(options, scene, [*measured, *held_out]),
        loss=LOSSES[options.loss]() if options.loss else None,
        method=sj.LevenbergMarquardt(max_iterations=options.max_iterations),
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

    fitted: sj.Fit
    shown: dict[str, ShownNumbers]

    def report_page(self, title: str, scene: sj.Scene | None) -> Any:
        """The page that `sj.report` writes."""
        from spherejax.studies.fit.page import page_of

        return page_of(self.fitted, title, scene, self.shown)


class Begin(NamedTuple):
    """What `--start` says of a parameter, in SI units; as `sj.Parameter`, which takes long to import."""

    start: float
    bounds: tuple[float, ...] = ()

    @property
    def parameter(self) -> sj.Parameter:
        """For the fit."""
        return sj.Parameter(self.start, **dict(zip(("lower", "upper"), self.bounds, strict=False)))


def _starts(options: argparse.Namespace, unit_of: UnitOf = unit_of_option) -> dict[str, Begin | None]:
    """Parameters by name; None where the scene's own number is meant."""
    start: dict[str, Begin | None] = {}
    for text in options.start:
        name, equals, given = text.partition("=")
        if name in start:
            raise sj.SceneError(f"--start {name} is given twice")
        if not equals:
            start[name] = None
            continue
        parts = given.split(":")
        if not name or len(parts) not in (1, 3):
            raise sj.SceneError(f"--start {text}: write NAME=VALUE or NAME=VALUE:LOW:HIGH, e.g. stiffness=1e4:1e3:1e7")
        numbers = [number_of("--start", text, part, unit_of(name)) for part in parts]
        start[name] = Begin(numbers[0], tuple(numbers[1:]))
    return start


def _shown(options: argparse.Namespace, unit_of: UnitOf) -> dict[str, ShownNumbers]:
    """In which units the parameters are told."""
    given = (text.partition("=") for text in options.start)
    return {name: shown_in(texts.split(":"), unit_of(name)) for name, _, texts in given}


def _with_starts(options: argparse.Namespace, start: dict[str, Begin | None]) -> argparse.Namespace:
    """Options of the studied joint with the starts in their place."""
    of_joint = {}
    for name, parameter in start.items():
        key = name.replace("-", "_")
        if key not in USED_BY:
            continue
        if getattr(options, key) is not None:
            raise sj.SceneError(f"--{name} is given, and fitted as well; leave one out")
        if parameter is None:
            raise sj.SceneError(f"--start {name}: write {name}=VALUE")
        of_joint[key] = parameter.start
    return argparse.Namespace(**{**vars(options), **of_joint})


def _own_numbers(found: Chosen, scene: sj.Scene, start: dict[str, Begin | None]) -> dict[str, Any]:
    """The scene's own numbers, by the paths that are fitted; a wrong path is refused."""
    own = {}
    for name, begin in start.items():
        if name.replace("-", "_") in USED_BY:
            continue
        try:
            own[name] = number_at(scene, name, found.studied)
        except sj.SceneError as error:
            raise sj.SceneError(f"--start {error}") from None
        if begin is not None and own[name].ndim:
            raise sj.SceneError(f"--start {name}: it is an array of shape {own[name].shape}; give the name alone")
    return own


def _builder(found: Chosen, options: argparse.Namespace):
    """A function from the parameters to the scene."""

    def build(**values) -> sj.Scene:
        of_joint = {name.replace("-", "_"): v for name, v in values.items() if name.replace("-", "_") in USED_BY}
        scene = found.scene(argparse.Namespace(**{**vars(options), **of_joint}))
        for name, value in values.items():
            if name.replace("-", "_") not in of_joint:
                scene = with_number(scene, name, value, found.studied)
        return scene

    return build


def _measured(path: str, options: argparse.Namespace) -> sj.Measured:
    from spherejax.studies.fit.reading import from_file

    read = from_file(Path(path).expanduser(), _columns(options))
    if options.t0 is None:
        return read
    return sj.Measured(read.ts, read.values, name=read.name, t0=options.t0, shown_in=read.shown_in)


def _columns(options: argparse.Namespace) -> dict[str, str] | None:
    """Observables by the names that the file has for them."""
    columns = {}
    for text in options.column:
        own, equals, observable = text.rpartition("=")
        if not equals or not own.strip() or not observable.strip():
            raise sj.SceneError(f"--column {text}: write OWN=QUANTITY, e.g. 'height=position.rocker.z [mm]'")
        columns[own.strip()] = observable.strip()
    return columns or None


def _noise(options: argparse.Namespace, scene: sj.Scene, measured: list[sj.Measured]) -> Any:
    """Standard deviations in SI units; a unit must be one of what was measured."""
    if options.noise is None:
        return None
    if len(options.noise) == 1 and "=" not in options.noise[0]:
        text = options.noise[0]
        return {name: _deviation(text, text, name, scene) for each in measured for name in each.values}
    noise = {}
    for text in options.noise:
        name, equals, sigma = (part.strip() for part in text.partition("="))
        if not equals:
            raise sj.SceneError(f"--noise {text}: give one number for all columns, or NAME=SIGMA for each")
        noise[name] = _deviation(text, sigma, name, scene)
    return noise


def _deviation(text: str, sigma: str, name: str, scene: sj.Scene) -> float:
    """One of them; the fit itself refuses an unknown name, because it knows all that was measured."""
    from spherejax.motion.equations.quantities import quantity

    try:
        unit = quantity(name, sj.compile_scene(scene).system).unit
    except sj.SceneError:
        unit = ""
    return number_of("--noise", text, sigma, unit)


def _print(fitted: sj.Fit, shown: dict[str, ShownNumbers]) -> None:
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


def _write(fitted: sj.Fit, shown: dict[str, ShownNumbers], folder: Path, title: str, *, pictures: bool) -> list[str]:
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


def _write_estimates(fitted: sj.Fit, shown: dict[str, ShownNumbers], path: Path) -> None:
    from spherejax.output.tables import write_rows

    known = fitted.knowledge
    rows = []
    for name, value, deviation, (low, high) in zip(
        fitted.names, known.values, known.standard_deviations, known.intervals(fitted.level), strict=True
    ):
        unit, factor = shown.get(name, ShownNumbers())
        rows.append([name, *(repr(float(v) / factor) for v in (value, deviation, low, high)), fitted.level, unit])
    write_rows(path, ["parameter", "estimate", "standard_deviation", "low", "high", "level", "unit"], rows)

"""`spherejax accuracy`: what accuracy costs in time, as a table, advice, files and figures."""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import spherejax as sj
from spherejax.command_line.catalog import JOINTS, SOLVERS
from spherejax.command_line.models import add_joint_options
from spherejax.command_line.numbers import measured_in, real, whole
from spherejax.command_line.printing import print_table, progress, say
from spherejax.command_line.reports import add_report, check_report, write_report
from spherejax.command_line.scenes import Chosen, add_scene, chosen, model_name

DESCRIPTION = """\
Run a mechanism with several solvers at several tolerances, time every run, and measure its error
against a reference whose own error is estimated: separately for position, velocity, acceleration,
reaction and energy. Prints the table and, in a sentence, what an accuracy costs. Where two tight
runs part (a dry joint without friction), errors are measured while they agree, and statistics are
compared afterwards. Times are of warm runs; compilation is reported apart.
"""

EPILOG = """examples:
  spherejax accuracy four-bar --joint friction --out results/
  spherejax accuracy four-bar --joint dry --t1 0.8 --solvers tsit5 dopri8 --tolerances 1e-5 1e-7 1e-9
  spherejax accuracy four-bar --models ideal dry friction --quick --out results/
  spherejax accuracy four-bar --joint bushing --stiffness 1e5 --quick --out results/
  spherejax accuracy my_mechanism.toml --t1 0.5 --out results/
"""

QUICK_TIME, QUICK_SECONDS = 0.05, 1.0
"""Length of the motion and budget of a run with --quick [s]."""

USUAL_TIME, USUAL_SECONDS = 0.2, 5.0
"""The same without."""

QUICK_TOLERANCES = (1e-5, 1e-7, 1e-9)
QUICK_SOLVERS = ("tsit5", "dopri8", "rodas5p")
"""What is compared with --quick: implicit methods with iterations take half a minute to compile."""

FILES = ("accuracy.csv", "accuracy.nc")
"""Files besides the figures."""


def add_accuracy(commands) -> None:
    """The command `accuracy`."""
    parser = commands.add_parser(
        "accuracy",
        help="show what accuracy costs in time: solvers and tolerances",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser)
    add_joint_options(parser)
    parser.add_argument(
        "--models",
        nargs="+",
        choices=JOINTS,
        metavar="NAME",
        help=f"several models of the studied joint with their defaults, instead of --joint: {', '.join(JOINTS)}",
    )
    study = parser.add_argument_group("what is run")
    study.add_argument(
        "--t1", type=measured_in("s"), metavar="S", help="length of the motion [s] (default: 0.2; quick: 0.05)"
    )
    study.add_argument(
        "--solvers",
        nargs="+",
        choices=SOLVERS,
        metavar="NAME",
        help=f"integrators: {', '.join(SOLVERS)} (default: tsit5 dopri8 rodas4p rodas5p ros34pw2 kvaerno5)",
    )
    study.add_argument(
        "--tolerances", nargs="+", type=real, metavar="R", help="relative tolerances (default: 1e-4 1e-5 ... 1e-10)"
    )
    study.add_argument("--repeats", type=whole, default=5, metavar="N", help="timed runs of each (default: 5)")
    study.add_argument(
        "--target", type=measured_in("m"), metavar="M", help="position error to price [m] (default: by the runs)"
    )
    study.add_argument(
        "--max-seconds",
        type=measured_in("s"),
        metavar="S",
        help="budget of a run [s]; more is given up (default: 5; quick: 1)",
    )
    study.add_argument("--quick", action="store_true", help="shorter motion, three solvers, three tolerances")
    files = parser.add_argument_group("files")
    files.add_argument("--out", metavar="FOLDER", help="write accuracy.csv, accuracy.nc and figures to this folder")
    add_report(files, "the study")
    files.add_argument("--overwrite", action="store_true", help="replace the files of an earlier study")
    parser.set_defaults(action=show_accuracy)


def show_accuracy(options: argparse.Namespace) -> int:
    """Run, print table and advice, write files."""
    from spherejax.output.paths import make_folder, require_free

    found = chosen(options)
    scenes = scenes_from(options, found)
    check_report(options)
    folder = None if options.out is None else Path(options.out).expanduser()
    if folder is not None:
        require_free(folder / FILES[0], overwrite=options.overwrite)
        make_folder(folder)
    start = time.perf_counter()
    with progress("running") as report:
        result = sj.work_precision(scenes, name=found.title or found.name, report=report, **_request(options))
    print_accuracy(result)
    if folder is not None:
        names = _write(result, folder)
        print(f"wrote {', '.join(names)} to {folder} in {time.perf_counter() - start:.0f} s")
    # Of several models each has numbers of its own, which one list would not tell.
    write_report(options, result, "", next(iter(scenes.values())) if len(scenes) == 1 else None)
    return 0


def scenes_from(options: argparse.Namespace, found: Chosen) -> dict[str, sj.Scene]:
    """The scenes by name of their model.

    Raises:
        SceneError: for an option of one model beside `--models`, which take their defaults.
    """
    if options.models is None:
        return {model_name(options): found.scene(options)}
    if options.joint is not None:
        raise sj.SceneError("--models compares models with their defaults; leave --joint and its options out")
    plain = {name: argparse.Namespace(**{**vars(options), "joint": name}) for name in options.models}
    return {name: found.scene(one) for name, one in plain.items()}


def _request(options: argparse.Namespace) -> dict:
    """The arguments of `work_precision` that the options ask for."""
    names = options.solvers or (QUICK_SOLVERS if options.quick else None)
    request = {
        "t1": _or(options.t1, QUICK_TIME if options.quick else USUAL_TIME),
        "n_repeats": options.repeats,
        "max_seconds": _or(options.max_seconds, QUICK_SECONDS if options.quick else USUAL_SECONDS),
        "target": options.target,
    }
    if names is not None:
        request["solvers"] = solvers_named(names)
    tolerances = options.tolerances or (QUICK_TOLERANCES if options.quick else None)
    return request if tolerances is None else {**request, "tolerances": tolerances}


def solvers_named(names) -> dict:
    """Solvers by their class names; those that the study knows are set up as it does."""
    from spherejax.studies.accuracy import SOLVERS as STUDIED

    classes = [SOLVERS[name] for name in names]
    return {one.__name__: STUDIED[one.__name__] if one.__name__ in STUDIED else one() for one in classes}


def print_accuracy(result: sj.studies.WorkPrecision) -> None:
    """The table of each model, then what it means."""
    from spherejax.studies.accuracy.page import HEADS

    for model in result.models:
        rows = [result.cells(row) for row in result.rows_of(model)]
        title = f"{model}, {result.t1:g} s: largest errors at the samples (<: the reference resolves no more)"
        print_table(title, HEADS, rows, numeric=True)
        compiled = {row.solver: row.compile_seconds for row in result.rows_of(model)}
        known = [f"{solver} {seconds:.1f} s" for solver, seconds in compiled.items() if math.isfinite(seconds)]
        print(f"Compiled once for all tolerances: {', '.join(known) or 'nothing'}.")
        for text in (*result.notes[model], result.advice[model]):
            say(text)


def _write(result: sj.studies.WorkPrecision, folder: Path) -> list[str]:
    """Table, data set and figures; returns their names."""
    from spherejax.output.io import save

    _write_table(result, folder / FILES[0])
    save(result.to_xarray(), folder / FILES[1], overwrite=True)
    names: list[str] = list(FILES)
    figures = {f"{name}_{model}": one for model in result.models for name, one in result.figures(model).items()}
    if len(result.models) > 1:
        figures["models"] = result.overview()
    for name, figure in figures.items():
        path = folder / f"{name}.png"
        try:
            figure.savefig(path)
        except OSError as error:
            raise sj.SceneError(f"cannot write {str(path)!r}: {error.strerror or error}") from error
        names.append(path.name)
    return names


def _write_table(result: sj.studies.WorkPrecision, path: Path) -> None:
    from spherejax.output.tables import write_rows
    from spherejax.studies.accuracy.samples import UNITS

    heads = {
        "model": "model", "solver": "solver", "rtol": "rtol [-]", "atol": "atol [units of the state]",
        "seconds": "seconds [s]", "n_repeats": "n_repeats", "compile_seconds": "compile_seconds [s]",
        "n_steps": "n_steps", "n_rejected": "n_rejected", "n_evaluations": "n_evaluations", "n_onsets": "n_onsets",
        "status": "status", "diagnosis": "diagnosis",
    }  # fmt: skip
    kinds = [
        (f"{name}_error [{unit}]", f"{name}_relative_error [-]", f"{name}_resolved", f"{name}_estimate [{unit}]")
        for name, unit in UNITS.items()
    ]
    lines = []
    for row in result.rows:
        errors = [
            (row.errors[name], result.relative_error(row, name), result.is_resolved(row, name), row.estimates[name])
            for name in UNITS
        ]
        lines.append([*(getattr(row, name) for name in heads), *(cell for error in errors for cell in error)])
    write_rows(path, [*heads.values(), *(head for kind in kinds for head in kind)], lines)


def _or(value, default):
    return default if value is None else value

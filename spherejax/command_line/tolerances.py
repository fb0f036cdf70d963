"""`spherejax tolerances`: what scatter of numbers makes of a motion, and whose it is; as table, files and pictures."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import spherejax as sj
from spherejax.command_line.catalog import SOLVERS
from spherejax.command_line.models import add_joint_options
from spherejax.command_line.numbers import measured_in, number_of_samples, real, whole
from spherejax.command_line.printing import say
from spherejax.command_line.scene_numbers import require_quantities
from spherejax.command_line.scenes import Chosen, add_scene, chosen
from spherejax.command_line.shown import ShownNumbers, WantedQuantity, sensitivities_in_units, shown_in
from spherejax.foundations.units.number_texts import NumberError, number_in
from spherejax.foundations.units.units import UnitError, in_si

if TYPE_CHECKING:
    from spherejax.model.numbers import Number

DESCRIPTION = """\
Which tolerance of which number makes the scatter of what a mechanism does, and how large is it? A number
scatters about its value in the scene, or about one that is given, within limits. The budget is of first
order, from derivatives, and checks itself by runs to either side of each number; sobol (shares of the
variance) and samples assume nothing and cost many runs.
"""

EPILOG = """examples:
  spherejax tolerances four-bar --joint bushing --tolerance "stiffness=+-20%" \\
      --tolerance "rocker.mass=+-0.5g" --of position.rocker.z --out t/
  spherejax tolerances four-bar --joint dry --tolerance "clearance=0.1mm+-20um" --method sobol --runs 64 \\
      --of "peak reaction.coupler_rocker" --out t/
  spherejax tolerances four-bar --tolerance rocker.mass=0.03:0.033 --method samples --runs 500 \\
      --of "final position.rocker"
"""

FILES = ("tolerances.nc", "tolerances.csv")

METHODS = ("budget", "sobol", "samples")

RUNS = {"sobol": 64, "samples": 200}
"""Usual numbers: a power of two for Sobol's sequence."""


def add_tolerances(commands) -> None:
    """The command `tolerances`."""
    parser = commands.add_parser(
        "tolerances",
        help="what tolerances make of a motion, and which of them makes most",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser, joint="--studied")
    add_joint_options(parser)
    what = parser.add_argument_group("what is asked")
    what.add_argument(
        "--tolerance",
        action="append",
        required=True,
        type=_tolerance,
        metavar="NAME=SPREAD",
        help="what scatters: stiffness=1e5+-2e4, rocker.mass=+-0.5g (about its value in the scene), mu=+-10%%, or a "
        "range of equal probability, LOW:HIGH; units as in --set; may be repeated",
    )
    what.add_argument(
        "--of",
        dest="observables",
        action="append",
        required=True,
        metavar="QUANTITY",
        help='what is observed, in a unit in brackets if wanted: with the budget along time, "position.rocker.z [mm]"; '
        'with the other methods as of a sweep, "final position.rocker", "peak reaction.coupler_rocker [kN]", '
        '"onsets.coupler_rocker"; may be repeated',
    )
    what.add_argument("--method", choices=METHODS, default="budget", help="how it is found (default: budget)")
    what.add_argument(
        "--uniform", action="store_true", help="+- are limits of equal probability (default: normal, three deviations)"
    )
    what.add_argument("--samples", type=whole, default=101, metavar="N", help="sample times (default: 101)")
    how = parser.add_argument_group("time, accuracy, runs")
    how.add_argument(
        "--t1", type=measured_in("s"), default=0.2, metavar="S", help="length of the motion [s] (default: 0.2)"
    )
    how.add_argument("--rtol", type=real, default=1e-8, help="relative tolerance of a step (default: 1e-8)")
    how.add_argument("--solver", choices=SOLVERS, help="integrator (default: chosen by the scene)")
    how.add_argument(
        "--runs",
        type=whole,
        metavar="N",
        help="with sobol a power of two, N (numbers + 2) runs (default: 64); with samples that many (default: 200)",
    )
    how.add_argument("--seed", type=whole, default=0, help="of what is drawn (default: 0)")
    files = parser.add_argument_group("files")
    files.add_argument("--out", metavar="FOLDER", help=f"write {', '.join(FILES)} and pictures to this folder")
    files.add_argument("--overwrite", action="store_true", help="replace files that exist")
    parser.set_defaults(action=find_tolerances)


def _tolerance(text: str) -> str:
    """A text that has the form of a tolerance, for `type=` of the option."""
    name, equals, given = (part.strip() for part in text.partition("="))
    if not (equals and name and given):
        raise argparse.ArgumentTypeError(f"{text}: write NAME=MIDDLE+-WIDTH, NAME=+-WIDTH or NAME=LOW:HIGH")
    if "+-" not in given and ":" not in given:
        middle = given if given[0].isdigit() else ""
        raise argparse.ArgumentTypeError(f"{text}: say how much, e.g. {name}={middle}+-1%, or a range LOW:HIGH")
    return text


def find_tolerances(options: argparse.Namespace) -> int:
    """Compute, print, write."""
    from spherejax.output.paths import require_free

    folder = None if options.out is None else Path(options.out).expanduser()
    for name in FILES if folder is not None else ():
        require_free(Path(str(folder)) / name, overwrite=options.overwrite)
    if options.method == "budget" and options.runs is not None:
        raise sj.SceneError(f"--runs {options.runs} means nothing with --method budget; add --method sobol or samples")
    found = chosen(options)
    scene = found.scene(options)
    numbers = _numbers(options, found, scene)
    asked = require_quantities(scene, options.observables, units=True)
    spreads = _spreads(options, numbers, scene)  # which takes long to import: names have been judged

    def build(**values) -> sj.Scene:
        made = scene
        for key, value in values.items():
            made = numbers[key].changed(made, value)
        return made

    result = _in_units(_study(options, build, spreads, [*dict.fromkeys(one.name for one in asked)]), asked)
    say(result.told(_shown(options, numbers, scene)) if isinstance(result, sj.studies.ToleranceBudget) else result)
    if folder is not None:
        _write(result, folder, options.overwrite)
    return 0


def _study(options: argparse.Namespace, build: Any, spreads: dict[str, Any], observables: list[str]) -> Any:
    ts = np.linspace(0.0, options.t1, number_of_samples(options.samples))
    how = {"rtol": options.rtol, "solver": SOLVERS[options.solver]() if options.solver else None}
    if options.method == "budget":
        return sj.studies.tolerance_budget(build, spreads, ts, observables=observables, **how)
    n = RUNS[options.method] if options.runs is None else options.runs
    study = sj.studies.sobol_indices if options.method == "sobol" else sj.monte_carlo
    return study(build, spreads, ts, record=observables, n=n, rng=options.seed, **how)


def _in_units(result: Any, asked: Sequence[WantedQuantity]) -> Any:
    """The result with what is observed in the units in which it was asked for."""
    from spherejax.studies.sweep.records import TAKEN
    from spherejax.studies.uncertainty.outputs import outputs_of

    units = {one.name: one for one in asked}
    if isinstance(result, sj.studies.ToleranceBudget):
        found = sensitivities_in_units(result.sensitivities, asked)
        parts = []
        for part, column in zip(result.parts, found.columns, strict=True):
            factor = units[column.name].shown(part.column.unit).factor
            scaled = {name: getattr(part, name) / factor for name in ("effects", "deviation", "worst")}
            parts.append(replace(part, column=column, **scaled))
        return replace(result, sensitivities=found, parts=tuple(parts))
    runs = result.runs
    named = zip([name for name in runs.data_vars if name not in TAKEN], units.values(), strict=True)
    told = {name: one.shown(runs[name].attrs.get("units", "")).of(runs[name]) for name, one in named}
    if isinstance(result, sj.studies.SobolIndices):  # shares have no unit: it has only been judged
        return result
    runs = runs.assign(told)
    return replace(result, runs=runs, outputs=tuple(outputs_of(runs)))


def _numbers(options: argparse.Namespace, found: Chosen, scene: sj.Scene) -> dict[str, Number]:
    """The uncertain numbers, by names that are identifiers."""
    from spherejax.model.numbers import full_path, number_at

    numbers: dict[str, Number] = {}
    for text in options.tolerance:
        name = text.partition("=")[0].strip()
        try:
            number = number_at(scene, full_path(scene, name, found.studied))
        except sj.SceneError as error:
            raise sj.SceneError(f"--tolerance {error}") from None
        if any(number[1:] == other[1:] for other in numbers.values()):
            raise sj.SceneError(f"--tolerance {name}: it is given twice")
        numbers[name.replace(".", "_")] = number
    return numbers


def _spreads(
    options: argparse.Namespace, numbers: dict[str, Number], scene: sj.Scene
) -> dict[str, sj.studies.Tolerance | tuple[float, float]]:
    """How they scatter."""
    from spherejax.files.fields.number_units import unit_at

    return {
        key: _spread(
            text,
            text.partition("=")[2].strip(),
            number.value(scene),
            unit_at(scene, number.steps),
            options.uniform,
        )
        for text, (key, number) in zip(options.tolerance, numbers.items(), strict=True)
    }


def _shown(options: argparse.Namespace, numbers: dict[str, Number], scene: sj.Scene) -> dict[str, ShownNumbers]:
    """In which units the numbers are told."""
    from spherejax.files.fields.number_units import unit_at

    texts = (re.split(r"\+-|:", text.partition("=")[2]) for text in options.tolerance)
    return {
        key: shown_in((each for each in given if not each.strip().endswith("%")), unit_at(scene, number.steps))
        for (key, number), given in zip(numbers.items(), texts, strict=True)
    }


def _spread(
    text: str, given: str, own: float, unit: str | None, uniform: bool
) -> sj.studies.Tolerance | tuple[float, float]:
    """What one text says of a number whose value in the scene is `own`."""
    if "+-" not in given:
        low, _, high = given.partition(":")
        return _number(text, low, unit), _number(text, high, unit)
    middle, _, width = given.partition("+-")
    nominal = _number(text, middle, unit) if middle.strip() else own
    if width.strip().endswith("%"):
        half = abs(nominal) * _number(text, width.strip()[:-1], None) / 100
    else:
        half = _number(text, width, unit)
    try:
        return sj.studies.Tolerance(nominal, half, "uniform" if uniform else "normal")
    except sj.SceneError as error:
        raise sj.SceneError(f"--tolerance {text}: {error}") from None


def _number(text: str, part: str, unit: str | None) -> float:
    try:
        return number_in(part.strip())
    except NumberError as error:
        if unit is None:
            raise sj.SceneError(f"--tolerance {text}: {error}") from None
    try:
        return in_si(part.strip(), unit)
    except UnitError as error:
        raise sj.SceneError(f"--tolerance {text}: {error}") from None


def _write(result: Any, folder: Path, overwrite: bool) -> None:
    from spherejax.output.io import save
    from spherejax.output.paths import file_name, make_folder

    make_folder(folder)
    dataset = result.to_xarray() if hasattr(result, "to_xarray") else result.runs
    if "time" not in dataset.dims and "parameter" in dataset.dims:
        dataset = dataset.transpose("parameter", ...)  # a row for each number
    written = [save(dataset, folder / name, overwrite=overwrite) for name in FILES]
    for name, figure in result.figures().items():
        path = folder / f"{file_name(name)}.png"
        figure.savefig(path)
        written.append(path)
    print(f"wrote {', '.join(str(path) for path in written)}")

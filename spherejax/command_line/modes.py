"""`spherejax modes`: eigenvalues, shapes and frequency responses of a mechanism about its start or rest position."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import spherejax as sj
from spherejax.command_line.models import add_joint_options
from spherejax.command_line.numbers import measured_in, whole
from spherejax.command_line.printing import say
from spherejax.command_line.scene_numbers import require_quantities
from spherejax.command_line.scenes import add_scene, chosen

if TYPE_CHECKING:
    from spherejax.model.numbers import Number

DESCRIPTION = """\
Linearize a mechanism about its start, or about the rest position near it, and print its modes:
undamped frequency, damping ratio, eigenvalue, and the body that moves most. Constraints, redundant
ones too, are taken into account; derivatives are exact.
"""

EPILOG = """examples:
  spherejax modes suspension --at rest
  spherejax modes suspension --at rest --by wheel.mass --out modes/
  spherejax modes four-bar --joint bushing --input gravity.z --output position.rocker.z --f1 2000 --out modes/
"""

FILES = ("modes.nc", "modes.png", "response.csv", "response.png")


def add_modes(commands) -> None:
    """The command `modes`."""
    parser = commands.add_parser(
        "modes",
        help="modes and frequency response about the start or a rest position",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser)
    add_joint_options(parser)
    what = parser.add_argument_group("what is asked")
    what.add_argument(
        "--at", choices=("start", "rest"), default="start", help="the state: as assembled, or at rest (default: start)"
    )
    what.add_argument(
        "--by",
        action="append",
        default=[],
        metavar="NUMBER",
        help="derivatives of frequencies and damping ratios by a number of the scene, e.g. bodies.rocker.mass; may be "
        "repeated",
    )
    response = parser.add_argument_group("frequency response")
    response.add_argument(
        "--input", action="append", default=[], metavar="NUMBER", help="e.g. gravity.z, forces.push.force.z"
    )
    response.add_argument(
        "--output", action="append", default=[], metavar="QUANTITY", help='e.g. "position.rocker.z", "reaction.elbow"'
    )
    hertz = measured_in("Hz")
    response.add_argument("--f0", type=hertz, default=0.1, metavar="HZ", help="lowest frequency [Hz] (default: 0.1)")
    response.add_argument("--f1", type=hertz, default=100.0, metavar="HZ", help="highest frequency [Hz] (default: 100)")
    response.add_argument("--points", type=whole, default=400, metavar="N", help="frequencies (default: 400)")
    files = parser.add_argument_group("files")
    files.add_argument("--out", metavar="FOLDER", help=f"write {', '.join(FILES)} to this folder")
    files.add_argument("--overwrite", action="store_true", help="replace files that exist")
    parser.set_defaults(action=find_modes)


def find_modes(options: argparse.Namespace) -> int:
    """Linearize, print, write."""
    from spherejax.output.paths import require_free

    folder = None if options.out is None else Path(options.out).expanduser()
    asks_response = bool(options.input or options.output)
    if asks_response and not (options.input and options.output and folder):
        raise sj.SceneError("a frequency response needs --input, --output and --out FOLDER")
    if not 0 < options.f0 < options.f1 < np.inf or options.points < 2:
        raise sj.SceneError(
            f"--f0 {options.f0:g} --f1 {options.f1:g} --points {options.points}: frequencies must be positive and "
            "rise, two at least"
        )
    if folder is not None:
        for name in FILES:
            require_free(folder / name, overwrite=options.overwrite)
    found = chosen(options)
    scene = found.scene(options)
    inputs = [number.name for name in options.input for number in _numbers("--input", scene, name, found.studied)]
    by = [number for name in options.by for number in _numbers("--by", scene, name, found.studied)]
    require_quantities(scene, options.output)
    from spherejax.files.fields.number_units import unit_at

    linear = sj.linearize(scene, at=options.at, inputs=inputs, outputs=options.output)
    modes = linear.modes()
    say(modes)
    for number in by:
        _print_slopes(modes, number.name, unit_at(scene, number.steps))
    if folder is not None:
        _write(linear, folder, options)
    return 0


def _numbers(option: str, scene: sj.Scene, name: str, studied: str | None) -> list[Number]:
    """What an option names, by names with nothing left out; of an array all entries."""
    from spherejax.model.numbers import full_path, numbers_at

    try:
        return numbers_at(scene, full_path(scene, name, studied))
    except sj.SceneError as error:
        raise sj.SceneError(f"{option} {error}") from None


def _print_slopes(modes: sj.studies.Modes, number: str, unit: str | None) -> None:
    """Derivatives of frequency and damping of each mode."""
    found = modes.slopes(number)
    print(f"per {'unit' if unit in (None, '1') else unit} of {number}:")
    for k, slope in enumerate(found):
        said = "repeated" if slope is None else f"{slope.frequency:+.5g} Hz, damping {slope.damping_ratio:+.5g}"
        print(f"{k:4d}  {said}")


def _write(linear: sj.studies.Linearization, folder: Path, options: argparse.Namespace) -> None:
    from spherejax.output.io import save
    from spherejax.output.paths import make_folder

    make_folder(folder)
    modes = linear.modes()
    written = [save(modes.to_xarray(), folder / "modes.nc", overwrite=options.overwrite)]
    if np.any(modes.shapes):
        modes.figure().savefig(folder / "modes.png")
        written.append(folder / "modes.png")
    if options.input:
        response = linear.frequency_response(np.geomspace(options.f0, options.f1, options.points))
        written.append(_table(response, folder / "response.csv"))
        sj.plot.bode(response).savefig(folder / "response.png")
        written.append(folder / "response.png")
    print(f"wrote {', '.join(str(path) for path in written)}")


def _table(response, path: Path) -> Path:
    """A row for each frequency; real and imaginary part of each output by each input."""
    from spherejax.output.tables import write_rows

    outputs, inputs = (list(map(str, response[name].values)) for name in ("output", "input"))
    heads = [f"{part} {o} by {i}" for o in outputs for i in inputs for part in ("Re", "Im")]
    values = np.asarray(response).reshape(len(response), -1)
    rows = (
        [repr(float(x)) for x in (frequency, *np.stack([np.real(row), np.imag(row)], 1).ravel())]
        for frequency, row in zip(np.asarray(response["frequency"]), values, strict=True)
    )
    write_rows(path, ["frequency [Hz]", *heads], rows)
    return path

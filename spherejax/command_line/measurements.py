"""What was measured, as options: files, their columns and their noise. For `fit` and `identify`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import spherejax as sj
from spherejax.command_line.numbers import measured_in, number_of


def add_measurements(parser: argparse.ArgumentParser) -> None:
    """Options of what was measured."""
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


def measured_from(path: str, options: argparse.Namespace) -> sj.Measured:
    """The measurements of a file."""
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


def noise_of(options: argparse.Namespace, scene: sj.Scene, measured: list[sj.Measured]) -> Any:
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
        unit = quantity(name, sj.equations.compile_scene(scene).system).unit
    except sj.SceneError:
        unit = ""
    return number_of("--noise", text, sigma, unit)

"""`spherejax export`: a scene as an FMU, for other simulation tools."""

from __future__ import annotations

import argparse

import spherejax as sj
from spherejax.command_line.models import add_joint_options
from spherejax.command_line.numbers import measured_in, real
from spherejax.command_line.scene_numbers import require_quantities
from spherejax.command_line.scenes import Chosen, add_scene, chosen

DESCRIPTION = """\
Write a mechanism as an FMU (Functional Mock-up Unit, FMI 3.0), which other simulation tools run: in C
for model exchange and, where an explicit method serves, co-simulation, with its source and compiled for
this machine; or in Python for co-simulation of any scene in tools that are Python.
"""

EPILOG = """examples:
  spherejax export four-bar --joint dry --fmu four_bar.fmu --output position.rocker \\
      --output reaction.coupler_rocker --parameter clearance --input gravity.z
  spherejax export my_mechanism.toml --fmu my_mechanism.fmu --kind python --output shock.length
"""


def add_export(commands) -> None:
    """The command `export`."""
    parser = commands.add_parser(
        "export",
        help="write a scene as an FMU for other simulation tools",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser)
    add_joint_options(parser)
    ports = parser.add_argument_group("what it shows")
    ports.add_argument(
        "--input", action="append", default=[], metavar="NUMBER", help="that may change: forces.push.force.z; repeat"
    )
    ports.add_argument(
        "--parameter",
        action="append",
        default=[],
        metavar="NUMBER",
        help="that may be set before the start: clearance, bodies.rocker.mass; may be repeated",
    )
    ports.add_argument(
        "--output",
        action="append",
        required=True,
        metavar="QUANTITY",
        help='e.g. "position.rocker", "reaction.coupler_rocker.z"; may be repeated',
    )
    how = parser.add_argument_group("how it runs")
    how.add_argument("--kind", choices=("c", "python"), default="c", help="what it is written in (default: c)")
    how.add_argument("--rtol", type=real, default=1e-8, help="relative tolerance of co-simulation (default: 1e-8)")
    how.add_argument("--t1", type=measured_in("s"), default=1.0, metavar="S", help="suggested end [s] (default: 1)")
    how.add_argument(
        "--step", type=measured_in("s"), default=1e-3, metavar="S", help="suggested communication step [s]"
    )
    files = parser.add_argument_group("files")
    files.add_argument("--fmu", required=True, type=_fmu, metavar="FILE", help="the FMU, with the ending .fmu")
    files.add_argument("--overwrite", action="store_true", help="replace an existing file")
    parser.set_defaults(action=export_scene)


def _fmu(text: str) -> str:
    if not text.lower().endswith(".fmu"):
        raise argparse.ArgumentTypeError(f"{text!r} is no FMU; give it the ending .fmu")
    return text


def export_scene(options: argparse.Namespace) -> int:
    """Write the file."""
    found = chosen(options)
    scene = found.scene(options)
    inputs = _paths("--input", options.input, scene, found)
    parameters = _paths("--parameter", options.parameter, scene, found)
    require_quantities(scene, options.output)
    path = sj.export_fmu(
        scene,
        options.fmu,
        inputs=inputs,
        parameters=parameters,
        outputs=options.output,
        kind=options.kind,
        rtol=options.rtol,
        stop_time=options.t1,
        step_size=options.step,
        description=found.title or found.name,
        overwrite=options.overwrite,
    )
    print(f"wrote {path}")
    return 0


def _paths(option: str, names: list[str], scene: sj.Scene, found: Chosen) -> list[str]:
    """With nothing left out: the FMU knows no studied joint."""
    from spherejax.model.numbers import full_path

    try:
        return [full_path(scene, name, found.studied) for name in names]
    except sj.SceneError as error:
        raise sj.SceneError(f"{option} {error}") from None

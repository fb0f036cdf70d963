"""`spherejax rig`: kinematics and compliance of a corner of a car."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import spherejax as sj
from spherejax.command_line.models import add_joint_options
from spherejax.command_line.numbers import measured_in, whole
from spherejax.command_line.printing import say
from spherejax.command_line.scenes import add_scene, chosen
from spherejax.foundations.errors import SceneError
from spherejax.foundations.units.units import in_si

DESCRIPTION = """\
Put a corner of a car on a suspension rig: a platform lifts the wheel, the steering is held, loads
act at the contact patch. Prints toe, camber, caster, kingpin, scrub radius, track, roll center,
wheel rate and compliance over the wheel's travel, or over the steering. Quasi-static: nothing
moves in time.
"""

EPILOG = """examples:
  spherejax rig double-wishbone --travel "-80:80 mm" --out results/
  spherejax rig mcpherson --steer "-40:40 mm" --points 9
  spherejax rig double-wishbone --of lower_ball --joint dry --clearance 0.1mm --lateral 2kN
"""

FAILED_RUN = 3
"""The exit code of positions without a result, as of runs that failed (`spherejax.cli`)."""

FILES = ("rig.csv", "rig.nc", "rig.png")


def add_rig(commands) -> None:
    """The command `rig`."""
    parser = commands.add_parser(
        "rig",
        help="suspension rig: toe, camber, roll center, wheel rate, compliance over travel",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser)
    add_joint_options(parser)
    what = parser.add_argument_group("what is asked")
    what.add_argument(
        "--travel", default="-80:80 mm", metavar="FROM:TO", help='of the wheel, e.g. "-80:80 mm", "0.05" (default: '
        '"-80:80 mm", or 0 with --steer)'
    )  # fmt: skip
    what.add_argument("--steer", default="0", metavar="FROM:TO", help='of the rack, e.g. "-40:40 mm" (default: 0)')
    what.add_argument("--points", type=whole, default=17, metavar="N", help="positions (default: 17)")
    for name, unit in (("longitudinal", "N"), ("lateral", "N"), ("aligning", "N m"), ("driving", "N")):
        what.add_argument(
            f"--{name}",
            type=measured_in(unit),
            default=0.0,
            metavar=unit.replace(" ", ""),
            help=f"{name} load [{unit}]",
        )
    files = parser.add_argument_group("files")
    files.add_argument("--out", metavar="FOLDER", help=f"write {', '.join(FILES)} to this folder")
    files.add_argument("--overwrite", action="store_true", help="replace files that exist")
    parser.set_defaults(action=put_on_rig)


def put_on_rig(options: argparse.Namespace) -> int:
    """Compute, print, write."""
    from spherejax.output.paths import make_folder, require_free

    folder = None if options.out is None else Path(options.out).expanduser()
    if folder is not None:
        for name in FILES:
            require_free(folder / name, overwrite=options.overwrite)
    if options.points < 1:
        raise sj.SceneError(f"--points {options.points} must be at least 1")
    steer = _range("--steer", options.steer, options.points)
    asked = "0" if np.ptp(steer) > 0 and options.travel == "-80:80 mm" else options.travel
    travel = _range("--travel", asked, options.points)
    scene = chosen(options).scene(options)  # before what takes long to import: a wrong name is told at once
    loads = sj.vehicle.WheelLoads(options.longitudinal, options.lateral, options.aligning, options.driving)
    found = sj.vehicle.rig(scene, travel, steer=steer, loads=loads)
    say(found)
    if folder is not None:
        from spherejax.output.io import save

        make_folder(folder)
        found.to_csv(folder / "rig.csv")
        save(found.to_xarray(), folder / "rig.nc", overwrite=options.overwrite)
        found.figure().savefig(folder / "rig.png")
        print(f"wrote {', '.join(str(folder / name) for name in FILES)}")
    return 0 if np.all(found.is_found) else FAILED_RUN


def _range(flag: str, text: str, n: int) -> np.ndarray:
    """Numbers from one end to the other; a unit behind the last one holds for both."""
    first, colon, last = text.partition(":")
    unit = "".join(part for part in last.split()[1:]) if colon else ""
    try:
        ends = [_length(first if not unit or " " in first.strip() else f"{first} {unit}"), _length(last or first)]
    except SceneError as error:
        raise sj.SceneError(f'{flag} {text}: {error}. Write e.g. {flag} "-80:80 mm"') from None
    return np.linspace(ends[0], ends[1], n) if colon else np.asarray(ends[0])


def _length(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return in_si(text, "m")

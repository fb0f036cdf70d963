"""`spherejax cycle`: the motion of a mechanism that repeats itself, and whether it is stable."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import spherejax as sj
from spherejax.command_line.models import add_joint_options
from spherejax.command_line.numbers import positive_in, real, whole
from spherejax.command_line.printing import say
from spherejax.command_line.scenes import add_scene, chosen

DESCRIPTION = """\
Find the motion that repeats itself: of a mechanism that something drives, after the given period;
of one that is left to itself, after a period that is found with it. Its Floquet multipliers say
whether it is stable: by so much a small deviation grows in a period. Unstable cycles, on which no
simulation settles, are found as well.
"""

EPILOG = """examples:
  spherejax cycle my_driven_mechanism.toml --period 0.05 --out cycle/
  spherejax cycle my_driven_mechanism.toml --period 0.05 --joint bushing --plot position.rocker.z --out cycle/
  spherejax cycle simple-pendulum --near 2.4
"""

FILES = ("cycle.nc", "cycle.png", "multipliers.csv", "harmonics.csv")


def add_cycle(commands) -> None:
    """The command `cycle`."""
    parser = commands.add_parser(
        "cycle",
        help="the motion that repeats itself, and its stability",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser)
    add_joint_options(parser)
    seconds = positive_in("s")
    what = parser.add_argument_group("what is asked")
    period = what.add_mutually_exclusive_group(required=True)
    period.add_argument("--period", type=seconds, metavar="S", help="of what drives the mechanism [s]")
    period.add_argument(
        "--near", type=seconds, metavar="S", help="nothing drives it: about how long a cycle takes [s]; it is found"
    )
    what.add_argument(
        "--at", choices=("start", "rest"), default="start", help="where the search begins (default: start)"
    )
    what.add_argument(
        "--settle",
        type=whole,
        metavar="N",
        help="periods that are simulated before (default: 10, without a drive none)",
    )
    what.add_argument("--rtol", type=real, default=1e-8, metavar="X", help="relative tolerance (default: 1e-8)")
    what.add_argument(
        "--plot", action="append", default=[], metavar="QUANTITY", help='e.g. "position.rocker.z"; may be repeated'
    )
    files = parser.add_argument_group("files")
    files.add_argument("--out", metavar="FOLDER", help=f"write {', '.join(FILES)} to this folder")
    files.add_argument("--overwrite", action="store_true", help="replace files that exist")
    parser.set_defaults(action=find_cycle)


def find_cycle(options: argparse.Namespace) -> int:
    """Find the cycle, print, write."""
    from spherejax.output.paths import make_folder, require_free

    folder = None if options.out is None else Path(options.out).expanduser()
    if options.plot and folder is None:
        raise sj.SceneError("--plot needs --out FOLDER, to write cycle.png and harmonics.csv to")
    if folder is not None:
        for name in FILES:
            require_free(folder / name, overwrite=options.overwrite)
    scene = chosen(options).scene(options)
    _require_quantities(scene, options.plot)
    cycle = sj.steady_cycle(
        scene,
        period=options.period,
        near=options.near,
        at=options.at,
        settle=options.settle,
        rtol=options.rtol,
        throw=True,
    )
    say(cycle)
    if folder is None:
        return 0
    from spherejax.output.io import save

    make_folder(folder)
    written = [save(cycle.to_xarray(), folder / "cycle.nc", overwrite=options.overwrite)]
    cycle.figure(*options.plot).savefig(folder / "cycle.png")
    written.append(folder / "cycle.png")
    mu = cycle.multipliers.values
    rows = np.stack([np.real(mu), np.imag(mu), np.abs(mu)], 1)
    written.append(_table(folder / "multipliers.csv", ["real", "imaginary", "modulus"], rows))
    if options.plot:
        found = [cycle.harmonics(name) for name in options.plot]
        heads = ["order", *(f"{part} {name}" for name in options.plot for part in ("Re", "Im"))]
        orders = np.arange(len(found[0]))
        rows = np.stack([orders, *(part for c in found for part in (np.real(c), np.imag(c)))], 1)
        written.append(_table(folder / "harmonics.csv", heads, rows))
    print(f"wrote {', '.join(str(path) for path in written)}")
    return 0


def _require_quantities(scene: sj.Scene, names: list[str]) -> None:
    """Refuse names before anything is computed."""
    from spherejax.motion.equations.quantities import quantity

    system = sj.equations.compile_scene(scene).system
    for name in names:
        if quantity(name, system).dims:
            raise sj.SceneError(f"--plot {name}: it is a vector; name one component, e.g. {name}.z")


def _table(path: Path, heads: list[str], rows: np.ndarray) -> Path:
    from spherejax.output.tables import write_rows

    write_rows(path, heads, ([repr(float(x)) for x in row] for row in rows))
    return path

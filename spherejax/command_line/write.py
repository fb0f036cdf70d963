"""`spherejax write`: a scene as a file that can be edited and run."""

from __future__ import annotations

import argparse

import spherejax as sj
from spherejax.command_line.models import add_joint_options
from spherejax.command_line.scenes import add_scene, chosen

DESCRIPTION = """\
Write a mechanism to a scene file (TOML) with every number and its unit, to start a mechanism of your
own from, or to see what a robot description (.urdf) becomes. Reading the file gives the same scene,
to the last bit. `spherejax list --kinds` names everything that can stand in such a file.
"""

EPILOG = """examples:
  spherejax write four-bar --joint friction --out four_bar.toml
  spherejax run four_bar.toml --t1 0.2
  spherejax write robot.urdf --out robot.toml
"""

GALLERY_SETTINGS = {"t1": 2.0, "samples": 2001, "rtol": 1e-8}
"""The table [simulation] for scenes that come from no file: the defaults of `spherejax run`."""


def add_write(commands) -> None:
    """The command `write`."""
    parser = commands.add_parser(
        "write",
        help="write a scene to a file that can be edited and run",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser)
    add_joint_options(parser)
    files = parser.add_argument_group("files")
    files.add_argument("--out", required=True, metavar="FILE", help="the scene file, with the ending .toml")
    files.add_argument("--overwrite", action="store_true", help="replace an existing file")
    parser.set_defaults(action=write_scene)


def write_scene(options: argparse.Namespace) -> int:
    """Write the file."""
    found = chosen(options)
    settings = (
        found.settings
        if any(value is not None for value in found.settings)
        else sj.files.SimulationSettings(**GALLERY_SETTINGS)
    )
    path = sj.save_scene(
        found.scene(options),
        options.out,
        title=found.title or found.name,
        studied=found.studied,
        settings=settings,
        overwrite=options.overwrite,
    )
    print(f"wrote {path}")
    return 0

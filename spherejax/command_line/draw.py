"""`spherejax draw`: a mechanism as a picture, or its motion as a film."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import spherejax as sj
from spherejax.command_line.models import add_joint_options
from spherejax.command_line.numbers import measured_in, real
from spherejax.command_line.printing import progress
from spherejax.command_line.scenes import AS_DESCRIBED, Chosen, add_scene, chosen, model_name

DESCRIPTION = """\
Draw a mechanism in space: bodies, joints by their symbols, force elements, ground and world axes; at
its assembled start, or at the time --t of its motion, with joints with clearance magnified beside it.
An ending .gif or .mp4 makes a film of the motion. Numbers are in SI units, or have a unit of their own
("0.1 mm").
"""

EPILOG = """examples:
  spherejax draw four-bar --out four_bar.png
  spherejax draw four-bar --joint friction --t 0.15 --trace coupler_rocker --out four_bar.png
  spherejax draw my_mechanism.toml --projections --out sheet.pdf
  spherejax draw four-bar --joint dry --t1 0.5 --out motion.gif
  spherejax draw four-bar --joint dry --t1 0.05 --slow 200 --fps 50 --out impacts.mp4
"""

PICTURES, FILMS = (".png", ".svg", ".pdf"), (".gif", ".mp4")
"""What can be written."""

SAMPLES = 4001
"""Samples of the motion: enough for the path of a ball in its socket."""


def add_draw(commands) -> None:
    """The command `draw`."""
    parser = commands.add_parser(
        "draw",
        help="draw a mechanism, or make a film of its motion",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser)
    add_joint_options(parser)
    what = parser.add_argument_group("what is drawn")
    what.add_argument(
        "--t", type=measured_in("s"), metavar="S", help="time of a picture [s] (default: the assembled start)"
    )
    what.add_argument("--t1", type=measured_in("s"), metavar="S", help="length of a film's motion [s] (default: 2)")
    what.add_argument(
        "--view", type=real, nargs=2, metavar=("AZ", "EL"), help="azimuth and elevation of the viewer [deg]"
    )
    what.add_argument("--projections", action="store_true", help="front, side and top beside the spatial view")
    what.add_argument("--magnify", nargs="+", metavar="JOINT", help="joints drawn magnified (default: not ideal ones)")
    what.add_argument("--trace", nargs="+", default=[], metavar="NAME", help="bodies and joints whose paths are drawn")
    what.add_argument("--frames", action="store_true", help="the axes of each body")
    what.add_argument("--no-labels", action="store_true", help="a picture without names")
    film = parser.add_argument_group("films")
    film.add_argument("--fps", type=real, metavar="N", help="frames a second (default: 25)")
    film.add_argument("--slow", type=real, metavar="X", help="seconds of film for a second of motion (default: by it)")
    files = parser.add_argument_group("files")
    files.add_argument("--out", required=True, metavar="FILE", help="a picture (.png .svg .pdf) or film (.gif .mp4)")
    files.add_argument("--overwrite", action="store_true", help="replace an existing file")
    parser.set_defaults(action=draw_scene)


def draw_scene(options: argparse.Namespace) -> int:
    """Simulate what is needed, draw, write the file."""
    path = Path(options.out).expanduser()
    is_film = path.suffix.lower() in FILMS
    found = chosen(options)
    scene = found.scene(options)
    _require_sense(options, path, is_film)
    if options.magnify or options.trace or options.view:
        sj.draw(scene, **_wishes(options))  # a wrong name shall not cost a simulation
    if is_film:
        _write_film(options, found, scene, path)
    else:
        _write_picture(options, found, scene, path)
    print(f"wrote {path}")
    return 0


def _require_sense(options: argparse.Namespace, path: Path, is_film: bool) -> None:
    """Refuse what would be ignored, and files that cannot be written, before anything is computed."""
    from spherejax.output.paths import make_folder, require_free
    from spherejax.output.plot.animation import animation_path

    if path.suffix.lower() not in (*PICTURES, *FILMS):
        raise sj.SceneError(
            f"{str(path)!r}: the ending {path.suffix!r} names no format; use {', '.join(PICTURES)} for a picture, "
            f"{' or '.join(FILMS)} for a film"
        )
    of_films = {"--t1": options.t1, "--fps": options.fps, "--slow": options.slow}
    of_pictures = {"--t": options.t, "--no-labels": options.no_labels or None}
    kind, other = ("film", of_pictures) if is_film else ("picture", of_films)
    for flag, value in other.items():
        if value is not None:
            raise sj.SceneError(f"{flag} means nothing for a {kind} ({path.suffix}); leave it out")
    for flag, value in {"--t1": options.t1, "--fps": options.fps, "--slow": options.slow}.items():
        if value is not None and not 0 < value < np.inf:
            raise sj.SceneError(f"{flag} = {value:g} must be positive")
    if options.t is not None and not 0 <= options.t < np.inf:
        raise sj.SceneError(f"--t = {options.t:g} must be a time after the start [s], or 0")
    if is_film:
        animation_path(path, overwrite=options.overwrite)
    else:
        require_free(path, overwrite=options.overwrite)
        make_folder(path.parent)


def _write_picture(options: argparse.Namespace, found: Chosen, scene: sj.Scene, path: Path) -> None:
    title, wishes = _title(options, found), _wishes(options)
    if not options.t:
        figure = sj.draw(scene, title=title, labels=not options.no_labels, **wishes)
    else:
        run = _simulated(scene, options.t, found)
        title = f"{title}: t = {options.t:g} s"
        figure = sj.draw(run, options.t, scene=scene, title=title, labels=not options.no_labels, **wishes)
    try:
        figure.savefig(path)
    except OSError as error:
        raise sj.SceneError(f"cannot write {str(path)!r}: {error.strerror or error}") from error


def _write_film(options: argparse.Namespace, found: Chosen, scene: sj.Scene, path: Path) -> None:
    t1 = options.t1 or found.settings.t1 or 2.0
    run = _simulated(scene, t1, found)
    with progress("drawing") as report:
        sj.animate(
            run,
            path,
            fps=options.fps or 25.0,
            slow=options.slow,
            scene=scene,
            title=_title(options, found),
            overwrite=options.overwrite,
            report=_by_tenths(report),
            **_wishes(options),
        )


def _simulated(scene: sj.Scene, t1: float, found: Chosen) -> sj.Trajectory:
    said = found.settings
    solver = None if said.solver is None else _solver(said.solver)
    return sj.simulate(scene, np.linspace(0.0, t1, SAMPLES), rtol=said.rtol or 1e-8, solver=solver, throw=True)


def _solver(name: str):
    from spherejax.files.scenes.solvers import SOLVERS

    return SOLVERS[name]()


def _wishes(options: argparse.Namespace) -> dict:
    return {
        "view": None if options.view is None else tuple(options.view),
        "projections": options.projections,
        "magnified": options.magnify,
        "traces": options.trace,
        "frames": options.frames,
    }


def _title(options: argparse.Namespace, found: Chosen) -> str:
    model = model_name(options)
    return found.title or (found.name if model == AS_DESCRIBED else f"{found.name}, {model} joint")


def _by_tenths(report):
    """Report a tenth of the work at a time: a line for each frame would fill a log."""
    said = [0]

    def tell(what: str, share: float) -> None:
        if int(10 * share) > said[0]:
            said[0] = int(10 * share)
            report(what, share)

    return tell

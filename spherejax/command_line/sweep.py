"""`spherejax sweep`: many runs of one scene, stored as they come, and pictures of the result."""

from __future__ import annotations

import argparse
import re
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import spherejax as sj
from spherejax.command_line.catalog import SOLVERS
from spherejax.command_line.models import USED_BY, add_joint_options
from spherejax.command_line.numbers import measured_in, number_of, number_of_samples, real, whole
from spherejax.command_line.printing import print_table, say
from spherejax.command_line.reports import add_report, check_report, write_report
from spherejax.command_line.scene_numbers import UnitOf, require_quantities, unit_of_option, units_in, with_number
from spherejax.command_line.scenes import Chosen, add_scene, chosen
from spherejax.command_line.shown import ShownNumbers, WantedQuantity, in_units, shown_in, wanted
from spherejax.command_line.sweep_check import print_check
from spherejax.foundations.errors import one_of
from spherejax.foundations.units.units import PURE

DEFAULT_RTOL = 1e-7
"""Relative tolerance of a step where none is given."""

DESCRIPTION = """\
Simulate a mechanism for many parameters, on all cores. What is varied is an option of the studied
joint (clearance, mu, restitution, stiffness, ...) or a number of the scene by its path (rocker.mass,
friction.v1, forces.shock.damping, as with --set). Every combination is run, or samples of the
ranges with --draws. Results go to a Zarr store chunk by chunk: a sweep that was stopped goes on when
the same command is given again. Pictures (maps, curves, fan charts) are written beside the store.
"""

EPILOG = """examples:
  spherejax sweep four-bar --joint friction --vary clearance=1e-5:5e-4:64 --vary mu=0:0.3:16 --out sweep.zarr
  spherejax sweep four-bar --joint friction --vary "clearance=0.05 mm,0.1 mm,0.2 mm" --out c.nc
  spherejax sweep four-bar --joint bushing --vary stiffness=1e5:1e7:9:log --record position.rocker --out k.nc
  spherejax sweep four-bar --vary rocker.mass=0.02:0.04 --vary coupler.mass=0.1:0.2 --draws 256 --out m.zarr
"""


def add_sweep(commands) -> None:
    """The command `sweep`."""
    parser = commands.add_parser(
        "sweep",
        help="simulate a scene for many parameters, on all cores",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser)
    add_joint_options(parser)
    grid = parser.add_argument_group("what is varied")
    grid.add_argument(
        "--vary",
        action="append",
        required=True,
        metavar="NAME=VALUES",
        help="LOW:HIGH:N (evenly spaced), LOW:HIGH:N:log, a list A,B,C, or LOW:HIGH with --draws; once for each name. "
        'Numbers may have units: "clearance=0.1 mm:0.5 mm:9"',
    )
    grid.add_argument("--draws", type=whole, metavar="N", help="N samples of Sobol's sequence instead of a product")
    grid.add_argument("--seed", type=whole, default=0, help="of the samples (default: 0)")
    kept = parser.add_argument_group("what is kept")
    kept.add_argument(
        "--record",
        action="append",
        metavar="QUANTITY",
        help='e.g. "position.rocker", "final position.rocker", "peak acceleration.rocker [km/s^2]", '
        '"onsets.coupler_rocker"; '
        "may be repeated (default: peak reaction of the studied joint, where the last body ends, contacts)",
    )
    kept.add_argument("--samples", type=whole, default=101, metavar="N", help="sample times (default: 101)")
    how = parser.add_argument_group("time, accuracy, machine")
    how.add_argument(
        "--t1", type=measured_in("s"), default=0.2, metavar="S", help="length of the motion [s] (default: 0.2)"
    )
    how.add_argument(
        "--rtol",
        type=real,
        default=DEFAULT_RTOL,
        help="relative tolerance of a step (default: 1e-7, where `run` has 1e-8: a fourth to a third fewer steps; "
        "--check N tells what that changes)",
    )
    how.add_argument(
        "--check",
        type=whole,
        default=0,
        metavar="N",
        help="make N runs once more at a tenth of the tolerance, and print what changes (default: 0)",
    )
    how.add_argument(
        "--derivative-rtol",
        type=real,
        metavar="X",
        help="of sensitivities (default: twice --rtol, films 1000 times)",
    )
    how.add_argument("--max-steps", type=whole, default=1_000_000, metavar="N", help="give a run up beyond")
    how.add_argument("--solver", choices=SOLVERS, help="integrator (default: chosen by the scene)")
    how.add_argument("--chunk", type=whole, metavar="N", help="runs that are handed out, and stored, at a time")
    how.add_argument("--workers", type=whole, metavar="N", help="chunks at the same time (default: all cores)")
    files = parser.add_argument_group("files")
    files.add_argument(
        "--out", required=True, metavar="PATH", help="store (.zarr, can be resumed) or file (.nc, .h5, .csv)"
    )
    add_report(files, "the sweep")
    files.add_argument("--overwrite", action="store_true", help="replace an existing file; not a store")
    files.add_argument("--no-pictures", action="store_true", help="write no pictures")
    parser.set_defaults(action=sweep_scene)


def sweep_scene(options: argparse.Namespace) -> int:
    """Run the sweep, print a summary, write everything."""
    from spherejax.output.paths import SUFFIXES, writable

    path = Path(options.out).expanduser()
    if path.suffix not in SUFFIXES:
        raise sj.SceneError(
            f"--out {options.out}: the suffix {path.suffix!r} names no format; {one_of(SUFFIXES, path.suffix)}"
        )
    if path.suffix != ".zarr":
        writable(path, overwrite=options.overwrite)
    check_report(options)
    asked = asked_of(options)
    names = asked.names
    found = chosen(_with_first_values(options, asked))
    build = builder(found, options, names)
    scene = build(**asked.first)  # names are judged by it, before what takes long is imported
    recorded = _recorded(found, options, scene)
    unit_of = units_in(scene, found.studied)
    asked = asked_of(options, unit_of)  # a unit of another dimension is refused
    grid = asked.grid(options)

    def runs_of(grid: sj.studies.Grid, rtol: float, **where: Any):
        return sj.sweep(
            build,
            grid,
            np.linspace(0.0, options.t1, number_of_samples(options.samples)),
            record=[one.name for one in recorded],
            rtol=rtol,
            derivative_rtol=options.derivative_rtol,
            max_steps=options.max_steps,
            solver=SOLVERS[options.solver]() if options.solver else None,
            workers=options.workers,
            **where,
        )

    begin = time.perf_counter()
    store = path if path.suffix == ".zarr" else None
    result = in_si = runs_of(grid, options.rtol, chunk=options.chunk, store=store)
    seconds = time.perf_counter() - begin
    if path.suffix != ".zarr":
        from spherejax.output.io import save

        of_si = {key: ShownNumbers(unit_of(name) or "") for key, name in names.items()}
        save(in_units(result, of_si), path, overwrite=options.overwrite)
    result = in_units(result, asked.shown)
    for one, name in zip(recorded, list(result.data_vars), strict=False):
        result = result.assign({name: one.shown(result[name].attrs["units"]).of(result[name])})
    _print(found, options, asked, result, seconds)
    if options.check:
        kept = list(in_si.data_vars)[: len(recorded)]
        print_check(in_si, list(map(str, kept)), options.check, grid, options.rtol, runs_of)
    pictures = [] if options.no_pictures else _draw(result, found, path)
    write_report(options, result, f"{found.title or found.name}: {', '.join(options.vary)}", scene)
    print(f"wrote {path}" + (f" and {len(pictures)} pictures beside it" if pictures else ""))
    if bool((result["status"] != 0).all()):
        raise sj.SimulationError(f"all {result['status'].size:,} runs failed; why is told above")
    return 0


class AskedGrid(NamedTuple):
    """What `--vary` asks for, in SI units.

    Attributes:
        names: what each parameter of the grid is called by the user; names that are no identifiers get one.
        values: of a product, by parameter.
        ranges: of samples, by parameter.
        logarithmic: parameters whose ranges are.
        shown: in which units they are told.
    """

    names: dict[str, str]
    values: dict[str, np.ndarray]
    ranges: dict[str, tuple[float, float]]
    logarithmic: list[str]
    shown: dict[str, ShownNumbers]

    @property
    def first(self) -> dict[str, float]:
        """Values of one run, to see what they make of the scene; of ranges the middles."""
        middles = {key: float(np.mean(ends)) for key, ends in self.ranges.items()}
        return {**{key: float(values[0]) for key, values in self.values.items()}, **middles}

    def grid(self, options: argparse.Namespace) -> sj.studies.Grid:
        """All runs."""
        if options.draws is None:
            return sj.studies.product(self.values)
        return sj.studies.sobol_samples(self.ranges, options.draws, rng=options.seed, logarithmic=self.logarithmic)


def asked_of(options: argparse.Namespace, unit_of: UnitOf = unit_of_option) -> AskedGrid:
    """What `--vary` asks for; it takes no long import."""
    asked = AskedGrid({}, {}, {}, [], {})
    for text in options.vary:
        name, equals, given = text.partition("=")
        if not equals or not name or not given:
            raise sj.SceneError(f"--vary {text}: write NAME=VALUES, e.g. clearance=1e-5:5e-4:64")
        if name in asked.names.values():
            raise sj.SceneError(f"--vary {name} is given twice")
        key = name.replace(".", "_")
        asked.names[key] = name
        parts = given.split(":")
        if options.draws is None:
            asked.values[key] = _values(text, parts, unit_of(name))
        elif len(parts) not in (2, 3) or parts[2:] not in ([], ["log"]):
            raise sj.SceneError(f"--vary {text}: with --draws write {name}=LOW:HIGH or {name}=LOW:HIGH:log")
        else:
            low, high = (number_of("--vary", text, part, unit_of(name)) for part in parts[:2])
            asked.ranges[key] = (low, high)
            asked.logarithmic.extend([key] if parts[2:] else [])
        asked.shown[key] = shown_in(re.split("[:,]", given), unit_of(name))
    return asked


def _values(text: str, parts: list[str], unit: str | None) -> np.ndarray:
    if len(parts) == 1:
        return np.array([number_of("--vary", text, part, unit) for part in parts[0].split(",")])
    if len(parts) not in (3, 4) or parts[3:] not in ([], ["log"]):
        raise sj.SceneError(f"--vary {text}: write LOW:HIGH:N, LOW:HIGH:N:log, or a list A,B,C")
    low, high = (number_of("--vary", text, part, unit) for part in parts[:2])
    n = number_of("--vary", text, parts[2])
    if n != int(n) or n < 1:
        raise sj.SceneError(f"--vary {text}: N = {n:g} must be a whole number, at least 1")
    n = int(n)
    if parts[3:] and not (low > 0 and high > 0):
        raise sj.SceneError(f"--vary {text}: a logarithmic range must be positive")
    return np.geomspace(low, high, n) if parts[3:] else np.linspace(low, high, n)


def _with_first_values(options: argparse.Namespace, asked: AskedGrid) -> argparse.Namespace:
    """Options with the first run's values, to check that they mean something together."""
    first = {key: value for key, value in asked.first.items() if asked.names[key] in USED_BY}
    for key in first:
        if getattr(options, key) is not None:
            raise sj.SceneError(f"--{asked.names[key]} is given, and varied as well; leave one out")
    return argparse.Namespace(**{**vars(options), **first})


def builder(found: Chosen, options: argparse.Namespace, names: dict[str, str], flag: str = "--vary"):
    """A function from the grid's parameters to the scene."""
    for name in names.values():
        if name not in USED_BY and "." not in name:
            known = [*USED_BY, "BODY.mass", "friction.v1", "joints.NAME.model.clearance", "forces.NAME.damping"]
            raise sj.SceneError(f"{flag} {name}: no such number; {one_of(known, name)}, and other paths like these")

    def build(**values) -> sj.Scene:
        of_joint = {key: value for key, value in values.items() if names[key] in USED_BY}
        scene = found.scene(argparse.Namespace(**{**vars(options), **of_joint}))
        for key, value in values.items():
            if key in of_joint:
                continue
            try:
                scene = with_number(scene, names[key], value, found.studied)
            except sj.SceneError as error:
                raise sj.SceneError(f"{flag} {error}") from None
        return scene

    return build


def _recorded(found: Chosen, options: argparse.Namespace, scene: sj.Scene) -> list[WantedQuantity]:
    """What is kept, judged by the scene of the first run; if no such mechanism can be, the sweep judges the others."""
    texts = options.record or _default_record(found, scene)
    try:
        sj.equations.compile_scene(scene)
    except sj.SceneError:
        return [wanted(text) for text in texts]
    return require_quantities(scene, texts, units=True)


def _default_record(found: Chosen, scene: sj.Scene) -> list[str]:
    joint = found.studied or next(iter(scene.joints), None)
    ends = [f"final position.{body}" for body in list(scene.bodies)[-1:]]
    contact = sj.equations.compile_scene(scene).system.contact_joints
    events = [f"{kind}.{name}" for name in contact for kind in ("onsets", "time_in_contact")]
    return [*([f"peak reaction.{joint}"] if joint else []), *ends, *events]


def _print(found: Chosen, options: argparse.Namespace, asked: AskedGrid, result, seconds: float) -> None:
    from spherejax.output.plot.swept import COUNTED

    facts = result.attrs
    # Said, because "mu=0,3" is a list of two numbers, where somebody may mean 0.3.
    varied = {asked.shown[key].head(name): np.unique(result[key]) for key, name in asked.names.items()}
    rows = [
        *(
            (name, f"{len(values):,} value{'s' * (len(values) > 1)}, {_range(values)}")
            for name, values in varied.items()
        ),
        ("runs", f"{result['status'].size:,}"),
        ("failed", f"{int((result['status'] != 0).sum()):,}"),
        ("time with compilation [s]", f"{seconds:.1f}"),
        ("steps", f"{int(result['n_steps'].sum()):,}"),
        ("lane efficiency", f"{facts['lane_efficiency']:.3f}"),
        ("method", str(facts["method"])),
        ("relative tolerance of a step", _tolerance(options)),
    ]
    for name in result.data_vars:
        values = np.asarray(result[name], float)
        if name not in COUNTED and np.isfinite(values).any():
            rows.append((f"{name} [{result[name].attrs.get('units', '')}]", _range(values)))
    print_table(f"{found.title or found.name}: {', '.join(options.vary)}", ("quantity", "value"), rows)
    _print_flagged(result)


def _tolerance(options: argparse.Namespace) -> str:
    if options.check or options.rtol != DEFAULT_RTOL:
        return f"{options.rtol:g}"
    return f"{options.rtol:g}, the default; --check 4 makes four runs at a tenth of it, and tells what changes"


def _print_flagged(result) -> None:
    """Which runs failed or left the range of a law, for which values, and what to do."""
    from spherejax.motion.results.run_flags import flagged_runs

    flagged = flagged_runs(result)
    rows = []
    for runs in flagged:
        where = [
            f"{name} {_range(np.array(ends))} {result[name].attrs['units'].removeprefix(PURE)}".rstrip()
            for name, ends in runs.ranges(result).items()
        ]
        rows.append((runs.what, f"{runs.n:,}", "; ".join(where), _range(np.array(runs.t_reached))))
    if rows:
        title = "runs that failed, or left the range of a law (variable `warnings`)"
        print_table(title, ("why", "runs", "where", "time reached [s]"), rows)
        say("\n".join(f"{runs.what}: {runs.text}." for runs in flagged))


def _range(values: np.ndarray) -> str:
    return f"{np.nanmin(values):.5g} to {np.nanmax(values):.5g}"


def _draw(result, found: Chosen, path: Path) -> list[Path]:
    from spherejax.output.paths import file_name
    from spherejax.output.plot.swept import figures_of_sweep

    folder = path.with_suffix("")
    written = []
    for name, figure in figures_of_sweep(result, found.title or found.name).items():
        folder.mkdir(parents=True, exist_ok=True)
        target = folder / f"{file_name(name)}.png"
        figure.savefig(target)
        written.append(target)
    return written

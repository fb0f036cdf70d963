"""`spherejax run`: one scene, one joint model, one file."""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

import spherejax as sj
from spherejax.command_line.catalog import DRIFT_CONTROLS, SOLVERS
from spherejax.command_line.draw import PICTURES
from spherejax.command_line.models import add_joint_options
from spherejax.command_line.numbers import measured_in, number_of_samples, real, whole
from spherejax.command_line.printing import print_table
from spherejax.command_line.reports import add_report, check_report, write_report
from spherejax.command_line.scene_numbers import require_quantities
from spherejax.command_line.scenes import AS_DESCRIBED, add_scene, changed_scene, chosen, model_name
from spherejax.command_line.shown import WantedQuantity
from spherejax.foundations.units.number_texts import NumberError, number_in

DESCRIPTION = """\
Simulate a mechanism, print how the run went, and write the sampled motion: positions, velocities,
accelerations, reactions, eccentricities and energies. The mechanism is a scene of the gallery or a
file that describes one; `spherejax write` makes a file to start from. Options that are not given take
the values of the file's table [simulation], or the defaults named below. Numbers are in SI units, or have a
unit of their own: --clearance "0.1 mm" --t1 "200 ms".
"""

EPILOG = """examples:
  spherejax run four-bar --joint friction --out run.nc
  spherejax run four-bar --joint dry --clearance 1e-4 --normal lankarani-nikravesh --friction threlfall \\
      --t1 0.2 --rtol 1e-9 --out run.nc
  spherejax run four-bar --joint bushing --stiffness 1e5 --dt 1e-3 --out run.csv
  spherejax run four-bar --t1 1000 --samples 101 --drift projection
  spherejax run four-bar --joint dry --t1 0.2 --accuracy "1 nm" --accuracy "reaction.coupler_rocker=0.1 N"
  spherejax run my_mechanism.toml --out run.nc
  spherejax run robot.urdf --t1 1
  spherejax run robot.urdf --friction "threlfall v1=0.01" --stops turning=500 --positions "elbow=30 deg"
  spherejax run robot.xml --ignore contacts,actuators --keyframe home
  spherejax run a04
  spherejax run four-bar --joint friction --t1 0.2 --report run.html
  spherejax run my_mechanism.toml --joint lubricated --of elbow --t1 0.5
  spherejax run four-bar --joint dry --t1 0.2 --impacts impacts.csv --peak reaction.coupler_rocker
  spherejax run four-bar --joint dry --t1 0.2 --spectrum reaction.coupler_rocker=spectrum.png
"""

POSITIONS = "positions"
"""What an accuracy without a name is of, as in `sj.simulate`."""


def add_run(commands) -> None:
    """The command `run`."""
    parser = commands.add_parser(
        "run",
        help="simulate one scene and write its motion to a file",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser)
    add_joint_options(parser)
    times = parser.add_argument_group("times and accuracy")
    times.add_argument(
        "--t1", type=measured_in("s"), metavar="S", help="length of the motion [s] (default: 2, or as published)"
    )
    sampling = times.add_mutually_exclusive_group()
    sampling.add_argument("--samples", type=whole, metavar="N", help="how many (default: 2001, or as published)")
    sampling.add_argument(
        "--dt", type=measured_in("s"), metavar="S", help="interval of the samples [s], instead of their number"
    )
    times.add_argument("--rtol", type=real, help="relative tolerance of a step (default: 1e-8)")
    times.add_argument(
        "--accuracy", action="append", metavar="[QUANTITY=]ERROR",
        help='largest error of the whole run: "1 um" for the positions of all bodies, or of a quantity, '
        '"reaction.NAME=0.1 N"; may be repeated. The tolerance is made tighter, from --rtol on, until the estimated '
        "errors are within it; in a file accuracy = \"1 um\" in [simulation]",
    )  # fmt: skip
    times.add_argument("--atol", type=real, help="absolute tolerance of a step, one number (default: by the scene)")
    times.add_argument("--max-steps", type=whole, metavar="N", help="give up beyond (default: 20000000)")
    times.add_argument(
        "--peak", action="append", default=[], metavar="NAME",
        help='largest magnitude of a quantity over all steps, as reaction.NAME, acceleration.NAME or "reaction.NAME '
        '[kN]"; may be repeated',
    )  # fmt: skip
    times.add_argument("--solver", choices=SOLVERS, help="integrator (default: chosen by the scene)")
    times.add_argument("--drift", choices=DRIFT_CONTROLS, help="drift control (default: that of the scene)")
    files = parser.add_argument_group("files")
    files.add_argument(
        "--out", metavar="FILE", help="write the motion: .nc (netCDF), .zarr, .h5 (everything), or .csv (a table)"
    )
    files.add_argument(
        "--impacts", metavar="FILE", help="write each contact of the studied joint: .csv, .nc, .zarr or .h5"
    )
    files.add_argument(
        "--spectrum", action="append", default=[], metavar="QUANTITY=FILE",
        help='amplitudes of a quantity by frequency, from all steps: "reaction.NAME.z=spectrum.png", or .csv, '
        ".nc, .zarr, .h5; may be repeated",
    )  # fmt: skip
    add_report(files, "the motion")
    files.add_argument("--overwrite", action="store_true", help="replace an existing file")
    parser.set_defaults(action=run_scene)


def run_scene(options: argparse.Namespace) -> int:
    """Simulate, print a summary, write the file."""
    import jax

    from spherejax.output.paths import writable

    found = chosen(options)
    scene = found.scene(options)
    if options.drift is not None:
        scene = changed_scene(scene, drift=DRIFT_CONTROLS[options.drift]())
    options.accuracy = accuracy_from(options.accuracy)
    options = with_defaults(options, found.settings)
    ts = sample_times(options)
    for path in filter(None, (options.out, options.impacts)):
        writable(path, overwrite=options.overwrite)
    spectra = _spectra(options, scene)
    check_report(options)
    peaks = require_quantities(scene, options.peak, units=True)
    system = sj.equations.compile_scene(scene).system
    joint = found.studied if options.impacts is None else _with_contact(found.studied, system.contact_joints)
    solver = SOLVERS[options.solver]() if options.solver else None
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sj.SimulationWarning)  # a failure is told as an error, below
        run = sj.simulate(
            scene,
            ts,
            rtol=options.rtol,
            atol=options.atol,
            max_steps=options.max_steps,
            solver=solver,
            accuracy=options.accuracy,
            track_work=_needs_work(options.accuracy, system),
        )
    jax.block_until_ready(run.ys)
    seconds = time.perf_counter() - start
    title = f"{found.title or found.name}, {_joint_words(options)}, {options.t1:g} s"
    if not bool(run.succeeded):
        write_report(options, run, title, scene)
    run.require_success()
    rows = [*_summary(run, seconds), *_peaks(run, peaks)]
    print_table(title, ("quantity", "value"), [*rows, _waited(options)])
    from spherejax.output.io import save

    if options.impacts is not None:
        table = run.impacts(str(joint))
        print(f"wrote {save(table, options.impacts, overwrite=options.overwrite)}: {table.sizes['contact']} contacts")
    for name, path in spectra:
        _write_spectrum(run, name, path, overwrite=options.overwrite)
    if options.out is not None:
        print(f"wrote {save(run, options.out, overwrite=options.overwrite)}")
    write_report(options, run, title, scene)
    return 0


def with_defaults(options: argparse.Namespace, settings: sj.files.SimulationSettings) -> argparse.Namespace:
    """What the options leave open, as the scene's file says, or as the help does."""
    said = {name: getattr(options, name) for name in sj.files.SimulationSettings._fields}
    if said["samples"] is not None or said["dt"] is not None:
        settings = settings._replace(samples=None, dt=None)
    last = {"t1": 2.0, "rtol": 1e-8, "max_steps": 20_000_000}
    for name, value in settings._asdict().items():
        if said[name] is None:
            said[name] = last.get(name) if value is None else value
    return argparse.Namespace(**{**vars(options), **said})


def accuracy_from(texts: list[str] | None) -> dict[str, str | float] | None:
    """What `sj.simulate` takes as `accuracy`, from the texts of `--accuracy`.

    Raises:
        SceneError: for a text without an error, and a quantity that is named twice.
    """
    found: dict[str, str | float] = {}
    for text in texts or ():
        name, equals, limit = (part.strip() for part in text.rpartition("="))
        name = name if equals else POSITIONS
        if not name or not limit:
            raise sj.SceneError(f'--accuracy {text}: write e.g. "1 um" or "position.rocker=1 um"')
        if name in found:
            raise sj.SceneError(f"--accuracy names {name} twice")
        try:
            found[name] = number_in(limit)
        except NumberError:
            found[name] = limit
    return found or None


def _needs_work(accuracy: str | float | Mapping[str, str | float] | None, system: sj.equations.System) -> bool:
    """Whether the accuracy of a work is asked for, which only a run that integrates it has."""
    from spherejax.motion.equations.quantities import quantity

    names = accuracy if isinstance(accuracy, Mapping) else ()
    return any(name != POSITIONS and quantity(name, system).needs_work() for name in names)


def _joint_words(options: argparse.Namespace) -> str:
    name = model_name(options)
    return name if name == AS_DESCRIBED else f"{name} joint"


def sample_times(options: argparse.Namespace):
    """Sample times from `--t1` and `--samples` or `--dt`.

    Raises:
        SceneError: for an interval or a number of samples that cannot be.
    """
    if not (np.isfinite(options.t1) and options.t1 > 0):
        raise sj.SceneError(f"--t1 = {options.t1:g} must be a positive time [s]")
    if options.dt is not None:
        if not 0 < options.dt <= options.t1:
            raise sj.SceneError(f"--dt = {options.dt:g} must be positive and not above --t1 = {options.t1:g} [s]")
        n_samples = round(options.t1 / options.dt) + 1
    else:
        n_samples = 2001 if options.samples is None else options.samples
    return np.linspace(0.0, options.t1, number_of_samples(n_samples))


def _with_contact(studied: str | None, contacts: tuple[str, ...]) -> str:
    """The joint whose contacts are told: the studied one, or the only one that has any."""
    if studied in contacts:
        return studied
    if studied is None and len(contacts) == 1:
        return contacts[0]
    known = ", ".join(map(repr, contacts)) or "none"
    raise sj.SceneError(
        f"--impacts: the studied joint, {studied!r}, has no clearance; joints with contact: {known}. Choose its model "
        "by --joint dry, friction or lubricated, or another joint by --of"
    )


def _spectra(options: argparse.Namespace, scene: sj.Scene) -> list[tuple[str, Path]]:
    """Quantities whose spectra are asked for, and where they go; judged before anything is computed."""
    from spherejax.output.paths import make_folder, require_free, writable

    found = []
    for text in options.spectrum:
        name, equals, path = (part.strip() for part in text.partition("="))
        if not (name and equals and path):
            raise sj.SceneError(f"--spectrum {text}: write QUANTITY=FILE, e.g. reaction.elbow.z=spectrum.png")
        require_quantities(scene, [name])
        target = Path(path).expanduser()
        if target.suffix.lower() in PICTURES:
            require_free(target, overwrite=options.overwrite)
            make_folder(target.parent)
        else:
            writable(target, overwrite=options.overwrite)
        found.append((name, target))
    return found


def _write_spectrum(run: sj.Trajectory, name: str, path: Path, *, overwrite: bool) -> None:
    from spherejax.output.io import save

    found = run.spectrum(name)
    if path.suffix.lower() in PICTURES:
        sj.plot.spectrum(found).savefig(path)
    else:
        save(found, path, overwrite=overwrite)
    print(f"wrote {path}")


def _peaks(run: sj.Trajectory, wanted: list[WantedQuantity]) -> list[tuple[str, str]]:
    from spherejax.motion.equations.quantities import quantity

    system, found = run.system, []
    for one in wanted:
        peak = run.peak(one.name)
        shown = one.shown(quantity(one.name, system).unit)
        found.append((shown.head(f"largest {one.name}"), f"{peak.value / shown.factor:.6g} at {peak.time:.6g} s"))
    return found


def _energies(run: sj.Trajectory) -> list[tuple[str, str]]:
    """What was put in, and what was lost: put in, or there at the start, and no longer there at the end."""
    from spherejax.motion.results.energy_parts import ROUNDED_LOSS

    energy = np.asarray(run.mechanical_energy)
    put_in = float(np.asarray(run.supplied_work)[-1])
    lost = float(energy[0] - energy[-1]) + put_in
    unit, factor = ("J", 1.0) if max(abs(lost), abs(put_in)) >= 1.0 else ("mJ", 1e3)
    moved = max(float(np.max(np.asarray(run.kinetic_energy))), abs(put_in))
    said = "~0 (rounding)" if 0 < abs(lost) < ROUNDED_LOSS * moved else f"{factor * lost:.6g}"
    rows = [(f"energy lost at the end [{unit}]", said)]
    if run.system.tracks_supply:
        rows.insert(0, (f"work put in by drivers and forces [{unit}]", f"{factor * put_in:.6g}"))
    return rows


def _waited(options: argparse.Namespace) -> tuple[str, str]:
    """All that was waited for up to here: libraries, the scene, the run, and the quantities of the table."""
    return "time since the command began [s]", f"{time.perf_counter() - options.begun:.2f}"


def _summary(run: sj.Trajectory, seconds: float) -> list[tuple[str, str]]:
    peaks = {
        body: float(np.max(np.linalg.norm(np.asarray(run.acceleration(body)), axis=1))) for body in run.system.bodies
    }
    body = max(peaks, key=lambda name: peaks[name])
    rows = [
        ("method", run.choice),
        ("steps", f"{int(run.stats.n_steps):,} ({int(run.stats.n_rejected):,} rejected)"),
        ("time of the first run, with compilation [s]", f"{seconds:.2f}"),
        *([] if run.accuracy is None else [("tolerance by accuracy", str(run.accuracy))]),
        *_energies(run),
        ("largest acceleration at the samples [m/s^2]", f"{peaks[body]:.4g} ({body})"),
        ("drift control", type(run.system.drift).__name__),
        ("largest constraint violation", f"{float(np.max(np.asarray(run.constraint_violation))):.2e}"),
        ("largest violation of the velocities", f"{float(np.max(np.asarray(run.velocity_violation))):.2e}"),
    ]
    for name in run.system.force_joints:
        distance = np.linalg.norm(np.asarray(run.eccentricity(name)), axis=1)
        rows.append((f"largest eccentricity of {name} [mm]", f"{1e3 * distance.max():.6g}"))
    for name, onsets in zip(run.system.contact_joints, np.asarray(run.stats.n_onsets), strict=True):
        rows.append((f"contact onsets of {name}", f"{int(onsets)}"))
    for name in run.system.friction_joints[:1] if run.system.friction_passes else ():
        largest = float(np.max(np.asarray(run.part(name, "friction_contraction"))))
        rows.append(("largest contraction of friction and reactions", f"{largest:.2e}"))
    return rows

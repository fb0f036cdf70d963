"""`spherejax compare`: the joint models against each other, as a table, files and figures."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import spherejax as sj
from spherejax.command_line.catalog import SUBJECTS
from spherejax.command_line.models import USED_BY, add_joint_options, all_models_from
from spherejax.command_line.numbers import measured_in, number_of_samples, real, whole
from spherejax.command_line.printing import print_table, progress, say
from spherejax.command_line.reports import add_report, check_report, write_report
from spherejax.command_line.scene_numbers import with_text
from spherejax.command_line.scenes import add_scene, chosen, studying

if TYPE_CHECKING:
    from spherejax.motion.results.trajectory import Trajectory
    from spherejax.studies.subject import Comparison, Subject
    from spherejax.studies.workers import Report

SAVED_SAMPLES = 2000
"""Samples of the netCDF files, about; the study itself uses a hundred times more."""

DESCRIPTION = """\
Simulate a mechanism with five models of one of its joints (ideal, dry, dry with friction, lubricated,
bushing), vary their parameters, and print a table: energies, peaks, largest eccentricity, steps, computing
time against the ideal joint, and until when the motion is determined. Writes table.csv, one netCDF file
for each model, and figures. Any mechanism can be compared: a scene file or a scene of the gallery, with
one spherical or revolute joint that is studied. The paper's mechanisms, four-bar and suspension, have
figures with its numbers (figNN_*.png). A comparison takes a minute or two on two free cores, with --quick
half of it; later runs are faster, because compiled programs are kept.
"""

EPILOG = """examples:
  spherejax compare my_mechanism.toml --out results/
  spherejax compare my_mechanism.toml --of elbow --clearance "0.2 mm" --t1 0.5 --quick --out results/
  spherejax compare my_mechanism.toml --of pin --length "10 mm" --body slider --out results/
  spherejax compare four-bar --out results/
  spherejax compare suspension --out results/
  spherejax compare four-bar --film radial --out paper/
"""


def add_compare(commands) -> None:
    """The command `compare`."""
    parser = commands.add_parser(
        "compare",
        help="compare all joint models on a mechanism: table, figures, files",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser)
    motion = parser.add_argument_group("what is compared")
    motion.add_argument(
        "--body", metavar="NAME", help="whose motion is compared (default: the one that the models change most)"
    )
    motion.add_argument(
        "--axis",
        choices=AXES,
        metavar="AXIS",
        help="along x, y or z, or about rotation.x, rotation.y or rotation.z (default: where the body moves most)",
    )
    motion.add_argument(
        "--t1", type=measured_in("s"), metavar="S", help="length of the motion [s] (default: 2, or of the file)"
    )
    motion.add_argument(
        "--samples", type=whole, metavar="N", help="of each run (default: one each 10 us, up to 200001)"
    )
    motion.add_argument("--rtol", type=real, help="relative tolerance of a step (default: 1e-8, or of the file)")
    motion.add_argument(
        "--quick",
        action="store_true",
        help="without parameter studies and limits; four-bar: 0.2 s and one study; suspension: 4.2 s and one method",
    )
    add_joint_options(parser, many=True)
    files = parser.add_argument_group("files")
    files.add_argument("--out", default="results", metavar="FOLDER", help="folder for all files (default: results)")
    add_report(files, "the comparison")
    files.add_argument("--overwrite", action="store_true", help="replace the files of an earlier comparison")
    parser.set_defaults(action=show_comparison)


def show_comparison(options: argparse.Namespace) -> int:
    """Simulate, print the table, write everything."""
    from spherejax.output.paths import make_folder, require_free
    from spherejax.studies.compare import Meanwhile, compare_models

    folder = Path(options.out).expanduser()
    require_free(folder / "table.csv", overwrite=options.overwrite)
    check_report(options)
    subject = subject_from(options)
    make_folder(folder)
    start = time.perf_counter()
    writer = _Writer(folder)
    meanwhile = Meanwhile(writer.ahead(subject), writer.as_found)
    with progress("comparing") as report:
        comparison = compare_models(
            subject, quick=options.quick, report=lambda what, share: report(what, 0.9 * share), meanwhile=meanwhile
        )
        names = writer.write_rest(comparison, report)
    print_comparison(comparison)
    write_report(options, comparison, "")
    seconds = time.perf_counter() - start
    print(
        f"wrote table.csv, {len(comparison.runs)} netCDF files and {len(names)} figures to {folder} in {seconds:.0f} s"
    )
    failed = [row for row in comparison.rows if row.failure]
    if failed:
        raise sj.SimulationError(f"{failed[0].label}: {failed[0].failure}")
    return 0


def subject_from(options: argparse.Namespace) -> Subject:
    """What the options ask to compare.

    Raises:
        SceneError: for a joint that cannot be studied, and for options that do not fit together.
    """
    from spherejax.studies.cases import cases_of
    from spherejax.studies.subjects.own import own_mechanism, studied_joint

    mechanism = chosen(options, many=True)
    if options.samples is not None:
        number_of_samples(options.samples)
    described = mechanism.build(None)
    joint = mechanism.studied or studied_joint(described)
    if mechanism.studied is None:
        mechanism = studying(mechanism, joint)
    has_models = any(getattr(options, name, None) is not None for name in USED_BY)
    prepared = SUBJECTS.get(options.scene)
    if prepared is not None and joint == prepared.joint and not options.set:
        changes: dict[str, Any] = {name: getattr(options, name) for name in ("body", "axis", "rtol")}
        if has_models:
            changes["models"] = cases_of(all_models_from(options, None))
        subject = replace(prepared, **{name: value for name, value in changes.items() if value is not None})
        t1 = subject.full.seconds if options.t1 is None else options.t1
        if options.t1 is not None or options.samples is not None:
            interval = subject.full.interval if options.samples is None else t1 / (options.samples - 1)
            subject = replace(
                subject,
                full=subject.full._replace(seconds=t1, interval=interval),
                quick=subject.quick._replace(seconds=t1, interval=interval),
                t_limits=min(subject.t_limits, t1),
            )
        return subject
    studied: Any = described.joints[joint]

    def build(model: sj.joints.AbstractSphericalModel) -> sj.Scene:
        scene = mechanism.build(model)
        for text in options.set:
            scene = with_text(scene, text, joint)
        return scene

    settings = mechanism.settings
    return own_mechanism(
        build,
        _first(options.t1, settings.t1, 2.0),
        joint=joint,
        models=all_models_from(options, studied.model),
        body=options.body,
        axis=options.axis,
        samples=options.samples,
        rtol=_first(options.rtol, settings.rtol, 1e-8),
        name=mechanism.title or mechanism.name,
    )


def _first(*values: Any) -> Any:
    """The first that is not None."""
    return next(value for value in values if value is not None)


def print_comparison(comparison: Comparison) -> None:
    """The table of the models, one for each parameter study, and what else the mechanism has to say."""
    for table in comparison.tables:
        print_table(table.title, table.heads, table.rows, numeric=True)
    for remark in comparison.remarks:
        say(remark)


AXES = ("x", "y", "z", "rotation.x", "rotation.y", "rotation.z")
"""Of `--axis`: those of `spherejax.output.plot.curves`, which the help does not load."""


class _Writer:
    """Writes figures and data as soon as there is what they show: Python draws while programs are compiled.

    Args:
        folder: of all files.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self.written: set[str] = set()

    def ahead(self, subject: Subject) -> Iterator[None]:
        """Figures that need no run, in steps."""
        from spherejax.command_line.figures import figures_ahead

        for name, draw in figures_ahead(subject).items():
            self._draw(name, draw)
            yield

    def data_of(self, runs: Mapping[str, Trajectory]) -> Iterator[None]:
        """The netCDF files of runs, in steps."""
        from spherejax.motion.results.dataset import to_dataset
        from spherejax.output.io import save

        for name, run in runs.items():
            file = f"{name}.nc"
            if file not in self.written:
                dataset = to_dataset(run, every=max(1, len(run.ts) // SAVED_SAMPLES))
                save(dataset, self.folder / file, overwrite=True)
                self.written.add(file)
            yield

    def as_found(self, so_far: Callable[[], Comparison]) -> Iterator[Any]:
        """The netCDF files of the models' runs, then figures as soon as all is known that they show, in steps."""
        from spherejax.command_line.figures import figures_of
        from spherejax.studies.workers import NOTHING_YET

        yield from self.data_of(so_far().runs)
        while True:
            new = [(name, draw) for name, draw in figures_of(so_far()).items() if name not in self.written]
            if new:
                self._draw(*new[0])
            yield None if new else NOTHING_YET

    def write_rest(self, comparison: Comparison, report: Report) -> list[str]:
        """All that has not been written yet; returns the names of all figures."""
        from spherejax.command_line.figures import figures_of

        _write_table(comparison, self.folder / "table.csv")  # first: it is not lost with a figure that fails
        for _ in self.data_of(comparison.runs):
            pass
        figures = figures_of(comparison)
        for done, (name, draw) in enumerate(figures.items(), start=1):
            if name not in self.written:
                self._draw(name, draw)
            report(f"drawn: {name}.png", 0.9 + 0.1 * done / len(figures))
        return list(figures)

    def _draw(self, name: str, draw: Callable) -> None:
        path = self.folder / f"{name}.png"
        try:
            draw().savefig(path)
        except OSError as error:
            raise sj.SceneError(f"cannot write {str(path)!r}: {error.strerror or error}") from error
        self.written.add(name)


def _write_table(comparison: Comparison, path: Path) -> None:
    """Every number of every row, in SI units, whatever the mechanism."""
    from spherejax.output.tables import write_rows

    rows = comparison.rows
    peak = f"peak_acceleration [{'rad' if comparison.ideal.turns else 'm'}/s^2]"
    heads = {
        "name": "model", "lost_energy": "lost_energy [J]", "peak_acceleration": peak,
        "eccentricity_ratio": "eccentricity_ratio [-]", "n_onsets": "n_onsets", "n_steps": "n_steps",
        "seconds": "seconds [s]", "time_ratio": "time_ratio [-]", "determined_until": "determined_until [s]",
        "method": "method",
    }  # fmt: skip
    measures = list(dict.fromkeys(name for row in rows for name in row.measures))
    fixed = [] if rows[0].fixed is None else ["fixed_n_steps", "fixed_seconds [s]", "fixed_time_ratio [-]"]
    failures = ["failure"] if any(row.failure for row in rows) else []
    lines = []
    for row in rows:
        values = [getattr(row, name) for name in heads]
        values += [row.measures.get(name) for name in measures]
        values += [] if row.fixed is None else list(row.fixed)
        values += [row.failure] if failures else []
        lines.append(["" if value is None else value for value in values])
    write_rows(path, [*heads.values(), *measures, *fixed, *failures], lines)

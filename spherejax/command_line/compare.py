"""`spherejax compare`: the joint models against each other, as a table, files and figures."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import spherejax as sj
from spherejax.command_line.catalog import FILMS, SUBJECTS
from spherejax.command_line.printing import print_table, progress
from spherejax.command_line.reports import add_report, check_report, write_report

if TYPE_CHECKING:
    from spherejax.motion.results.trajectory import Trajectory
    from spherejax.studies.subject import Comparison, ModelRow, Subject
    from spherejax.studies.workers import Report

SAVED_SAMPLES = 2000
"""Samples of the netCDF files, about; the study itself uses a hundred times more."""

DESCRIPTION = """\
Simulate a mechanism with five models of one spherical joint (ideal, dry, dry with friction,
lubricated, bushing), vary their parameters, and print a table: energies, peaks, largest eccentricity,
steps, and computing time against the ideal joint. Writes table.csv, one netCDF file for each model,
and figures that follow the numbering of the paper (figNN_*.png). A mechanism takes a minute or a minute
and a half on two free cores; later runs are faster, because compiled programs are kept.
"""

EPILOG = """examples:
  spherejax compare four-bar --out results/
  spherejax compare suspension --out results/
  spherejax compare four-bar --quick --out results/
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
    parser.add_argument("scene", choices=SUBJECTS, help="the mechanism")
    parser.add_argument(
        "--quick", action="store_true", help="a short version: 0.2 s and one parameter study; 4.2 s and one method"
    )
    parser.add_argument(
        "--film", choices=FILMS, default="full", help="of the lubricated joint; radial is the paper's (default: full)"
    )
    parser.add_argument("--out", default="results", metavar="FOLDER", help="folder for all files (default: results)")
    add_report(parser, "the comparison")
    parser.add_argument("--overwrite", action="store_true", help="replace the files of an earlier comparison")
    parser.set_defaults(action=compare_models)


def compare_models(options: argparse.Namespace) -> int:
    """Simulate, print the table, write everything."""
    from spherejax.output.paths import make_folder, require_free
    from spherejax.studies.compare import Meanwhile, compare

    folder = Path(options.out).expanduser()
    require_free(folder / "table.csv", overwrite=options.overwrite)
    check_report(options)
    make_folder(folder)
    start = time.perf_counter()
    subject = SUBJECTS[options.scene]
    subject = subject if options.film == "full" else subject.with_film(FILMS[options.film]())
    writer = _Writer(folder)
    meanwhile = Meanwhile(writer.ahead(subject), writer.as_found)
    with progress("comparing") as report:
        comparison = compare(
            subject, quick=options.quick, report=lambda what, share: report(what, 0.9 * share), meanwhile=meanwhile
        )
        names = writer.write_rest(comparison, report)
    print_comparison(comparison)
    write_report(options, comparison, "")
    seconds = time.perf_counter() - start
    print(
        f"wrote table.csv, {len(comparison.runs)} netCDF files and {len(names)} figures to {folder} in {seconds:.0f} s"
    )
    return 0


def print_comparison(comparison: Comparison) -> None:
    """The table of the models, one for each parameter study, and what else the mechanism has to say."""
    subject = comparison.subject
    heads = ("model", *(column.head for column in subject.columns))
    rows = [(row.label, *(column.cell(row) for column in subject.columns)) for row in comparison.rows]
    title = f"Joint models, {comparison.t_end:g} s of motion: {subject.parameters}"
    print_table(title, heads, rows, numeric=True)
    for table in subject.summaries(comparison):
        print_table(table.title, table.heads, table.rows, numeric=True)
    for result in comparison.studies:
        rows = [(label, f"{1e3 * lost:.4g}", f"{peak:.4g}") for label, lost, peak in result.summary]
        title = f"{result.study.name}: {result.study.title}".replace("\n", " ")
        print_table(title, ("case", "energy lost [mJ]", "peak acceleration [m/s^2]"), rows, numeric=True)
    for remark in subject.remarks(comparison):
        print(remark)


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

        _write_table(comparison.rows, self.folder / "table.csv")  # first: it is not lost with a figure that fails
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


def _write_table(rows: list[ModelRow], path: Path) -> None:
    """Every number of every row, in SI units, whatever the mechanism."""
    from spherejax.output.tables import write_rows

    heads = {
        "name": "model", "lost_energy": "lost_energy [J]", "peak_acceleration": "peak_acceleration [m/s^2]",
        "eccentricity_ratio": "eccentricity_ratio [-]", "n_onsets": "n_onsets", "n_steps": "n_steps",
        "seconds": "seconds [s]", "time_ratio": "time_ratio [-]", "horizon": "repeatable_until [s]",
        "method": "method",
    }  # fmt: skip
    measures = list(rows[0].measures)
    fixed = [] if rows[0].fixed is None else ["fixed_n_steps", "fixed_seconds [s]", "fixed_time_ratio [-]"]
    lines = []
    for row in rows:
        values = [getattr(row, name) for name in heads]
        values += [row.measures[name] for name in measures]
        values += [] if row.fixed is None else list(row.fixed)
        lines.append(["" if value is None else value for value in values])
    write_rows(path, [*heads.values(), *measures, *fixed], lines)

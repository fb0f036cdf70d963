"""`spherejax identify`: which model of a joint has made some measurements."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import spherejax as sj
from spherejax.command_line.catalog import JOINTS
from spherejax.command_line.measurements import add_measurements, measured_from, noise_of
from spherejax.command_line.models import add_joint_options
from spherejax.command_line.numbers import real, whole
from spherejax.command_line.printing import progress, say
from spherejax.command_line.scene_numbers import units_in
from spherejax.command_line.scenes import add_scene, chosen
from spherejax.command_line.unknowns import builder_of, own_numbers, starts_of, with_starts
from spherejax.foundations.errors import one_of

if TYPE_CHECKING:
    from spherejax.studies.model_choice import Candidate, ModelComparison
    from spherejax.studies.workers import Report

DESCRIPTION = """\
Compare models of the studied joint by what they make of measurements: each candidate is fitted, and judged
by an information criterion that counts the parameters that the data determine, and by how well it predicts
what was held out: the last part of each record, or the files of --validate. The table ends with a verdict;
where the data cannot tell models apart it says so. Written are the table (models.csv), the report, the
estimates of all candidates (estimates.csv), and a picture.
"""

EPILOG = """examples:
  spherejax identify four-bar --measured rocker.csv --noise "2 um" --candidate ideal \\
      --candidate "bushing stiffness=1e4:1e3:1e7 damping=1e-3" \\
      --candidate "dry clearance='0.1 mm:0.01 mm:1 mm'" --out joint/
  spherejax identify arm.toml --of pin --measured far.csv --validate near.csv \\
      --candidate "tight: friction mu=0.1" --candidate "loose: dry clearance=1e-4:1e-5:1e-3"
"""

FILES = ("models.csv", "report.txt", "estimates.csv", "models.png")


class CandidateText(NamedTuple):
    """A candidate as an option says it: `[NAME:] JOINT [PARAMETER=VALUE[:LOW:HIGH] ...]`."""

    name: str
    joint: str
    start: list[str]


def add_identify(commands) -> None:
    """The command `identify`."""
    parser = commands.add_parser(
        "identify",
        help="tell which joint model has made measurements",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser)
    add_joint_options(parser)
    add_measurements(parser)
    models = parser.add_argument_group("what is compared")
    models.add_argument(
        "--candidate",
        action="append",
        required=True,
        metavar="'[NAME:] JOINT [PARAMETER=VALUE[:LOW:HIGH] ...]'",
        help=f"a model of the studied joint ({', '.join(JOINTS)}) and what is fitted with it, as --start of fit has "
        "it; two or more",
    )
    how = parser.add_argument_group("how")
    how.add_argument(
        "--held-out", type=real, default=0.25, metavar="SHARE", help="last part of each record that is not fitted but "
        "predicted, where there is no --validate (default: 0.25)",
    )  # fmt: skip
    how.add_argument("--draws", type=whole, default=64, metavar="N", help="values that are tried over each range")
    how.add_argument("--starts", type=whole, default=4, metavar="N", help="from how many of them fits begin")
    how.add_argument("--rtol", type=real, default=1e-7, help="relative tolerance of a step (default: 1e-7)")
    files = parser.add_argument_group("files")
    files.add_argument("--out", metavar="FOLDER", help=f"write {', '.join(FILES)} to this folder")
    files.add_argument("--overwrite", action="store_true", help="replace the files of an earlier comparison")
    parser.set_defaults(action=identify)


def identify(options: argparse.Namespace) -> int:
    """Fit the candidates, print the table with its verdict, write everything."""
    from spherejax.output.paths import make_folder, require_free

    folder = None if options.out is None else Path(options.out).expanduser()
    if folder is not None:
        require_free(folder / FILES[0], overwrite=options.overwrite)
    if options.joint is not None:
        raise sj.SceneError(f"--joint {options.joint}: the joints that are compared stand in --candidate; leave it out")
    texts = [candidate_text(text) for text in options.candidate]
    names = [text.name for text in texts]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise sj.SceneError(f"--candidate {twice} is given twice; give names: --candidate 'other: {twice} ...'")
    if len(texts) < 2:
        raise sj.SceneError("--candidate must be given twice or more: there is nothing to compare")
    candidates = {text.name: _candidate(text, options) for text in texts}
    measured, held_out = (
        [measured_from(path, options) for path in paths] for paths in (options.measured, options.validate)
    )
    scene = chosen(_options_of(texts[0], options)).scene(_options_of(texts[0], options))
    if folder is not None:
        make_folder(folder)
    with progress("comparing models") as report:
        comparison = sj.compare_models(
            measured,
            candidates,
            validate=held_out or None,
            held_out=options.held_out,
            noise=noise_of(options, scene, [*measured, *held_out]),
            draws=options.draws,
            starts=options.starts,
            rtol=options.rtol,
            progress=_Stages(report, len(candidates)),
        )
    say(str(comparison))
    if folder is not None:
        _write(comparison, folder)
        print(f"wrote {', '.join(FILES)} to {folder}")
    if comparison.best is None:
        raise sj.SimulationError("all candidates failed; the table says why")
    return 0


class _Stages:
    """Hands on the stages of a comparison, but not each of the many draws and steps.

    Each candidate has three: its draws, the fit without what is held out, and the fit of all values.
    """

    def __init__(self, report: Report, n_candidates: int):
        self._report, self._last, self._n_begun, self._n = report, "", 0, 3 * n_candidates

    def __call__(self, line: str) -> None:
        stage = line.partition(" draw ")[0].partition(": step ")[0]
        if stage == self._last or not stage:
            return
        self._last = stage
        self._report(stage, min(self._n_begun / self._n, 1.0))
        self._n_begun += 1


def candidate_text(text: str) -> CandidateText:
    """What an option `--candidate` says.

    Raises:
        SceneError: for a joint that does not exist, or a text that is none.
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise sj.SceneError(f"--candidate {text}: {error}") from None
    name = words.pop(0)[:-1] if words and words[0].endswith(":") else ""
    if not words or "=" in words[0]:
        raise sj.SceneError(f"--candidate {text}: write [NAME:] JOINT [PARAMETER=VALUE ...], e.g. 'friction mu=0.1'")
    if words[0] not in JOINTS:
        raise sj.SceneError(f"--candidate {text}: there is no joint {words[0]!r}; {one_of(JOINTS, words[0])}")
    return CandidateText(name or words[0], words[0], words[1:])


def _options_of(text: CandidateText, options: argparse.Namespace) -> argparse.Namespace:
    """The options with a candidate's joint, and where its parameters begin."""
    own = argparse.Namespace(**{**vars(options), "joint": text.joint, "start": text.start})
    try:
        return with_starts(own, starts_of(own))
    except sj.SceneError as error:
        raise _of_candidate(text, error) from None


def _candidate(text: CandidateText, options: argparse.Namespace) -> Candidate:
    own = _options_of(text, options)
    try:
        found = chosen(own)
        scene = found.scene(own)
        numbers = own_numbers(found, scene, starts_of(own))
        begins = starts_of(own, units_in(scene, found.studied))  # a unit of another dimension is refused
    except sj.SceneError as error:
        raise _of_candidate(text, error) from None
    start = {name: sj.Parameter(numbers[name]) if one is None else one.parameter for name, one in begins.items()}
    return sj.studies.Candidate(builder_of(found, own), start)


def _of_candidate(text: CandidateText, error: sj.SceneError) -> sj.SceneError:
    """An error of `fit`'s options in the words of this command."""
    return sj.SceneError(f"--candidate {text.name}: {str(error).replace('--start ', '')}")


def _write(comparison: ModelComparison, folder: Path) -> None:
    """Table, report, estimates and picture."""
    from spherejax.files.paths.drafts import draft_of
    from spherejax.output.tables import write_rows

    rows = comparison.evidence.values()
    write_rows(folder / FILES[0], list(next(iter(rows))._fields), [[*row] for row in rows])
    with draft_of(folder / FILES[1]) as draft:
        draft.write_text(f"{comparison}\n", encoding="utf-8")
    estimates = []
    for name, fit in comparison.fits.items():
        known = fit.knowledge
        for parameter, value, (low, high) in zip(fit.names, known.values, known.intervals(0.95), strict=True):
            estimates.append([name, parameter, *(repr(float(x)) for x in (value, low, high))])
    write_rows(folder / FILES[2], ["model", "parameter", "estimate", "low_95", "high_95"], estimates)
    comparison.plot("which joint it is").savefig(folder / FILES[3])

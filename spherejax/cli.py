"""The command line: `spherejax run`, `compare`, `sweep`, `fit`, `modes` and so on; `spherejax --help` has them all."""

import argparse
import difflib
import io
import os
import re
import sys
import time
import warnings
from collections.abc import Sequence
from functools import partial
from typing import Any, NoReturn

import spherejax as sj
from spherejax import runtime
from spherejax.command_line import printing
from spherejax.command_line.advice import in_options

BEGUN = time.perf_counter()
"""When this process had Python running, and none of the libraries that take long."""

BAD_REQUEST, FAILED_RUN, INTERRUPTED, READER_GONE = 2, 3, 130, 141
"""Exit codes besides 0; the last one is that of a process which the signal SIGPIPE ends."""

DESCRIPTION = """Multibody simulation with ideal, dry, lubricated and bushing spherical joints.

Each command has its own help, e.g. `spherejax run --help`. Exit code 0: done; 2: the request makes no sense;
3: a run did not reach its end; 130: interrupted; 141: the reader of the output has gone.
"""

EPILOG = """examples:
  spherejax list
  spherejax run four-bar --joint friction --t1 0.2 --out run.nc
  spherejax compare four-bar --quick --out results/
  spherejax write four-bar --out my_mechanism.toml
  spherejax run my_mechanism.toml

Compiled programs are kept in $XDG_CACHE_HOME/spherejax (~/.cache without XDG_CACHE_HOME), so that a command
starts faster the second time; SPHEREJAX_CACHE names another folder, and SPHEREJAX_CACHE=0 switches that off.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: arguments; those of the process when None.

    Returns:
        The exit code: 0 done, 2 for a request that makes no sense, 3 for a failed run, 130 when interrupted, 141 when
        the reader of the output has gone.
    """
    try:
        code = _main(argv)
        sys.stdout.flush()  # a short output is written here, and its reader may have gone
        return code
    except BrokenPipeError:
        # `spherejax list --kinds | head`: what is still in the buffer goes nowhere, without a second error at the end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return READER_GONE


@runtime.interrupts_kept()
def _main(argv: Sequence[str] | None) -> int:
    try:
        options = _read(parser(), argv)
    except SystemExit as stop:  # argparse has printed the help or the error
        return stop.code if isinstance(stop.code, int) else BAD_REQUEST
    if runtime.is_command():
        _print_any_name()
        warnings.formatwarning = _in_one_line
        runtime.set_up()
    options.begun = BEGUN if argv is None else time.perf_counter()
    with printing.worded(partial(in_options, flags=options.flags)):
        return _run(options, leaves=argv is None)


def _run(options: argparse.Namespace, *, leaves: bool) -> int:
    """Run a command, and say in words what went wrong.

    Args:
        options: of the command.

    Other args:
        leaves: whether the process ends with an interrupted command.
    """
    from spherejax.files.fields.code import described_error, line_of

    try:
        return options.action(options)
    except (sj.SceneError, sj.runtime.PrecisionError) as error:
        print(f"spherejax: {_one_line(error)}", file=sys.stderr)
        return BAD_REQUEST
    except sj.errors.SweepError as error:
        print("\n".join([f"spherejax: {_one_line(error)}", *_notes(error)]), file=sys.stderr)
        return FAILED_RUN
    except sj.SimulationError as error:
        print(f"spherejax: the run failed: {_one_line(error)}", file=sys.stderr)
        return FAILED_RUN
    except KeyboardInterrupt as interrupt:
        print("\n".join(["spherejax: interrupted", *_notes(interrupt)]), file=sys.stderr)
        if leaves:
            _leave(INTERRUPTED)
        return INTERRUPTED
    except (Exception, SystemExit) as error:
        # Code beside a scene file, run by --allow-code: its errors are the user's, and no traceback of ours.
        at = line_of(error)
        if at is None:
            raise
        print(f"spherejax: {' '.join(described_error(error).split())}", file=sys.stderr)
        return BAD_REQUEST


class _Version(argparse.Action):
    """`--version`: of this package and of those that compute, as an issue needs them."""

    def __init__(self, option_strings: Sequence[str], dest: str, **_: Any):
        super().__init__(option_strings, dest, nargs=0, help="show versions and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        # Looked up only when they are asked for; none of the packages is loaded.
        names = ("spherejax", "jax", "jaxlib", "diffrax", "equinox", "numpy")
        of_python = ".".join(map(str, sys.version_info[:3]))
        of_others = ", ".join([f"Python {of_python}", *(f"{name} {_version(name)}" for name in names[1:])])
        print(f"{names[0]} {_version(names[0])} ({of_others})")
        parser.exit(0)


def _version(name: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:  # a folder of sources that nobody has installed
        return "unknown"


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are not buried under the list of all options."""

    _given: Sequence[str] = ()

    def parse_known_args(self, args=None, namespace=None):
        """As of argparse; what was given is kept for the errors."""
        self._given = list(sys.argv[1:] if args is None else args)
        return super().parse_known_args(self._given, namespace)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            near = difflib.get_close_matches(str(value), map(str, action.choices or ()), n=1)
            error.message += f"; did you mean {near[0]!r}?" if near else ""
            raise

    def error(self, message: str) -> NoReturn:
        """Say what is wrong, and where the options are listed."""
        if "required" in message:  # perhaps it is there, and misspelled
            known = self._option_string_actions
            flags = [word.partition("=")[0] for word in self._given if word.startswith("--")]
            flags = [flag for flag in flags if not any(one.startswith(flag) for one in known)]
            message += f"; unrecognized: {' '.join(flags)}{meant(flags, self)}" if flags else ""
        self.exit(BAD_REQUEST, f"{self.prog}: error: {message}\nusage: {self.prog} --help\n")


def parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    from spherejax.command_line.accuracy import add_accuracy
    from spherejax.command_line.catalog import add_list
    from spherejax.command_line.compare import add_compare
    from spherejax.command_line.completion import PrintCompletion
    from spherejax.command_line.cycle import add_cycle
    from spherejax.command_line.draw import add_draw
    from spherejax.command_line.effects import add_effects
    from spherejax.command_line.export import add_export
    from spherejax.command_line.fit import add_fit
    from spherejax.command_line.identify import add_identify
    from spherejax.command_line.modes import add_modes
    from spherejax.command_line.rig import add_rig
    from spherejax.command_line.run import add_run
    from spherejax.command_line.sensitivity import add_sensitivity
    from spherejax.command_line.sweep import add_sweep
    from spherejax.command_line.tolerances import add_tolerances
    from spherejax.command_line.write import add_write

    formatter = argparse.RawDescriptionHelpFormatter
    parser = _Parser("spherejax", description=DESCRIPTION, epilog=EPILOG, formatter_class=formatter)
    parser.add_argument("--version", action=_Version)
    parser.add_argument("--print-completion", action=PrintCompletion)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for add in (
        add_run,
        add_draw,
        add_compare,
        add_effects,
        add_accuracy,
        add_sweep,
        add_fit,
        add_identify,
        add_sensitivity,
        add_tolerances,
        add_modes,
        add_rig,
        add_cycle,
        add_write,
        add_export,
        add_list,
    ):
        add(commands)
    for command in commands.choices.values():
        command.set_defaults(flags=tuple(command._option_string_actions))
    for command in {parser, *commands.choices.values()}:
        # argparse takes -1e-4 for an option: its own pattern of a negative number knows no exponent.
        command._negative_number_matcher = re.compile(r"^-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")
    return parser


def _read(parser: argparse.ArgumentParser, argv: Sequence[str] | None) -> argparse.Namespace:
    """The options of a command; for one that does not exist the nearest that does."""
    words = list(sys.argv[1:] if argv is None else argv)
    options, unknown = parser.parse_known_args(words)
    if unknown:
        commands: Any = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
        command = next((commands.choices[word] for word in words if word in commands.choices), parser)
        flags = [each.partition("=")[0] for each in unknown if each.startswith("-")]
        command.error(f"unrecognized arguments: {' '.join(unknown)}{meant(flags, command)}")
    return options


def meant(flags: Sequence[str], parser: argparse.ArgumentParser) -> str:
    """The options that are spelled like these, as a question; nothing where there are none."""
    # Dashes count for nothing: with them every short word resembles every other.
    options = {option.lstrip("-"): option for option in parser._option_string_actions}
    near = [difflib.get_close_matches(flag.lstrip("-"), options, n=1) for flag in flags]
    return "; did you mean " + " and ".join(options[each[0]] for each in near if each) + "?" if any(near) else ""


def _in_one_line(message: Any, category: type, filename: str, lineno: int, line: str | None = None) -> str:
    """A warning of ours without the place in our code that gives it."""
    if category.__module__.partition(".")[0] == "spherejax":
        return f"spherejax: warning: {printing.in_words(' '.join(str(message).split()))}\n"
    return _as_python_does(message, category, filename, lineno, line)


_as_python_does = warnings.formatwarning


def _print_any_name() -> None:
    """Names of a scene may have letters that the output's encoding lacks: cp1252 in a file or pipe on Windows.

    A command would end in a UnicodeEncodeError after all of its work. Such letters are written as escapes, as Python
    does in errors.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def _leave(code: int) -> None:
    """End the process now: threads that compute cannot be stopped, and Python would wait for them."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _one_line(error: BaseException) -> str:
    return printing.in_words(" ".join(str(error).split()))


def _notes(error: BaseException) -> list[str]:
    return [printing.in_words(note) for note in getattr(error, "__notes__", ())]


if __name__ == "__main__":
    sys.exit(main())

"""`spherejax --print-completion`: the completion script of a shell, made by shtab from the parser of all commands."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from typing import Any, NoReturn

from spherejax.command_line.catalog import SCENES

SHELLS = ("bash", "zsh")
"""Shells for which a script is made."""

FILES = ("FILE", "PATH", "FOLDER", "TEXT")
"""Metavars of arguments that are files or folders."""

# As `shtab.FILE`, which need not be installed for a parser to be built.
_FILE = {"bash": "_shtab_compgen_files", "zsh": "_files"}
_SCENE = dict.fromkeys(SHELLS, "_spherejax_scenes")


class PrintCompletion(argparse.Action):
    """`--print-completion bash|zsh`: prints the script and exits."""

    def __init__(self, option_strings: Sequence[str], dest: str, **_: Any):
        super().__init__(
            option_strings, dest, choices=SHELLS, metavar="|".join(SHELLS), help="print the shell's completion script"
        )

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> NoReturn:
        """Print the script of the shell `values`."""
        try:
            text = script(parser, str(values))
        except ImportError:
            parser.error(f"{option} needs the package shtab: pip install 'spherejax[completion]'")
        print(text)
        parser.exit(0)


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """The completion script of a shell, for commands, options, words to choose from, scenes and files.

    Raises:
        ImportError: where shtab is not installed.
    """
    import shtab

    for action in _actions(parser):
        if action.dest == "scene":
            setattr(action, "complete", _SCENE)  # noqa: B010  (shtab's own protocol; argparse declares no such field)
        elif action.metavar in FILES or action.dest == "measured":
            setattr(action, "complete", _FILE)  # noqa: B010
    scenes = " ".join(SCENES)
    preamble: Any = {  # of each shell: shtab takes it so, and its types do not say it
        "bash": f'_spherejax_scenes() {{\n  compgen -W "{scenes}" -- "$1"\n  _shtab_compgen_files "$1"\n}}',
        "zsh": f'_spherejax_scenes() {{\n  _alternative "scenes:scene:({scenes})" "files:file:_files"\n}}',
    }
    return shtab.complete(parser, shell=shell, preamble=preamble)


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for command in {id(one): one for one in action.choices.values()}.values():
                yield from _actions(command)

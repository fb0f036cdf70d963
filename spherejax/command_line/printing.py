"""Tables and progress on the terminal; plain lines where there is none."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

_wording: Callable[[str], str] = str


@contextmanager
def worded(wording: Callable[[str], str]) -> Iterator[None]:
    """A context in which texts of the library are printed in other words: those of the command that runs."""
    global _wording
    before, _wording = _wording, wording
    try:
        yield
    finally:
        _wording = before


def in_words(text: str) -> str:
    """A text of the library as the command that runs prints it."""
    return _wording(text)


Report = Callable[[str, float], None]

WIDTH_WITHOUT_TERMINAL = 150
"""Columns of a table that is written to a file or a pipe, where none must be cut."""


def console(*, errors: bool = False) -> Console:
    """The terminal, as wide as it is."""
    from rich.console import Console

    stream = sys.stderr if errors else sys.stdout
    width = None if stream.isatty() else WIDTH_WITHOUT_TERMINAL

    class PipedConsole(Console):
        def on_broken_pipe(self) -> None:
            """Leave it to the command, which has an exit code for it; rich would end the process with 1."""
            raise BrokenPipeError

    return PipedConsole(file=stream, width=width, highlight=False)


def print_table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]], *, numeric: bool = False) -> None:
    """A titled table; with `numeric`, all columns but the first are aligned to the right."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left", title_style="bold")
    for position, head in enumerate(heads):
        table.add_column(Text(head), justify="right" if numeric and position else "left", overflow="fold")
    for row in rows:
        # Text, for a unit in brackets is no markup.
        table.add_row(*(Text(in_words(cell)) for cell in row))
    console().print(table)


def say(result: object) -> None:
    """Print what the library says of a result, its advice in the words of the command line."""
    print(in_words(str(result)))


@contextmanager
def progress(title: str) -> Iterator[Report]:
    """A function that reports what is done and the share of the work: a bar, or lines without a terminal."""
    out = console(errors=True)
    if not out.is_terminal:
        yield lambda what, share: print(f"[{100 * share:3.0f} %] {what}", file=sys.stderr, flush=True)
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=out, transient=True) as bar:
        task = bar.add_task(title, total=1.0)
        yield lambda what, share: bar.update(task, completed=share, description=what)

"""How far a study is that says so in words: a line in terminals and notebooks, nothing in logs."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from spherejax.foundations.terminals import console, is_watched


@contextmanager
def telling(progress: bool | Callable[[str], None], title: str) -> Iterator[Callable[[str], None]]:
    """A function that shows a line in place of the last one."""
    if callable(progress):
        yield progress
        return
    if not progress or not is_watched():
        yield lambda line: None
        return
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    with Progress(SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), console=console()) as shown:
        task = shown.add_task(title, total=None)
        yield lambda line: shown.update(task, description=line)

"""How far a fit is: a line in terminals and notebooks, nothing in logs."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from spherejax.foundations.terminals import console, is_watched
from spherejax.studies.fit.methods import FitProgress
from spherejax.studies.fit.problem import Problem

Report = Callable[[FitProgress], None]


@contextmanager
def reporting(progress: bool | Report, problem: Problem, n_iterations: int) -> Iterator[Report]:
    """A function that shows how far a fit is."""
    if callable(progress):
        yield progress
        return
    if not progress or not is_watched():
        yield lambda seen: None
        return
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("fit"), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console()) as line:
        task = line.add_task("compiling", total=n_iterations)
        yield lambda seen: line.update(task, completed=seen.iteration, description=described(seen, problem.names))


def described(seen: FitProgress, names: list[str]) -> str:
    """Where a fit is, in one line; the residual is a root mean square over the noise."""
    values = ", ".join(f"{name} {value:.4g}" for name, value in zip(names[:4], seen.values[:4], strict=True))
    more = f", ... ({len(names)} numbers)" if len(names) > 4 else ""
    going = f", {seen.n_going} starts going" if seen.n_going > 1 else ""
    root = (2 * seen.cost / max(seen.n_residuals, 1)) ** 0.5
    return f"residual {root:.3g}, {values}{more}, step {seen.iteration}{going}"

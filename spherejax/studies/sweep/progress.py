"""How far a sweep is: a bar in terminals and notebooks, nothing in logs."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from spherejax.motion.status import Status
from spherejax.studies.sweep.chunks import ChunkResult


@dataclass(frozen=True)
class Seen:
    """What has been done so far.

    Attributes:
        n_runs: runs of the sweep.
        n_done: runs that are done, those of an earlier start included.
        n_done_before: runs of an earlier start.
        n_failed: runs that did not reach their end.
        n_steps: steps of runs.
        n_lane_steps: steps of lanes.
        began: when, by `time.monotonic` [s].
    """

    n_runs: int
    n_done: int
    n_done_before: int
    n_failed: int
    n_steps: int
    n_lane_steps: int
    began: float

    @staticmethod
    def beginning(n_runs: int, n_chunks: int, n_chunks_before: int, chunk_size: int) -> "Seen":
        """Nothing done but what an earlier start has left."""
        before = n_runs if n_chunks_before == n_chunks else n_chunks_before * chunk_size
        return Seen(n_runs, before, before, 0, 0, 0, time.monotonic())

    def with_chunk(self, result: ChunkResult) -> "Seen":
        """One more chunk."""
        return replace(
            self,
            n_done=self.n_done + len(result.status),
            n_failed=self.n_failed + int(np.sum(result.status != Status.SUCCEEDED)),
            n_steps=self.n_steps + int(np.sum(result.n_steps)),
            n_lane_steps=self.n_lane_steps + result.n_lane_steps,
        )

    @property
    def runs_per_second(self) -> float:
        """Rate since the start, compiling included."""
        return (self.n_done - self.n_done_before) / max(time.monotonic() - self.began, 1e-9)

    @property
    def seconds_left(self) -> float:
        """By the rate so far [s]; infinite where nothing is known."""
        return (self.n_runs - self.n_done) / self.runs_per_second if self.runs_per_second else float("inf")

    @property
    def lane_efficiency(self) -> float:
        """Steps of runs divided by steps of lanes."""
        return self.n_steps / max(self.n_lane_steps, 1)

    def __str__(self) -> str:
        if self.n_done == self.n_done_before:
            return (
                f"{self.n_done:,} of {self.n_runs:,} runs, {'all done' if self.n_done == self.n_runs else 'compiling'}"
            )
        failed = f", {self.n_failed} failed" if self.n_failed else ""
        return (
            f"{self.n_done:,} of {self.n_runs:,} runs, {self.runs_per_second:,.0f} per second, "
            f"lane efficiency {self.lane_efficiency:.2f}{failed}"
        )


Report = Callable[[Seen], None]


@contextmanager
def reporting(progress: bool | Report, n_runs: int) -> Iterator[Report]:
    """A function that shows what has been done."""
    if callable(progress):
        yield progress
        return
    if not progress or not (sys.stderr.isatty() or _is_notebook()):
        yield lambda seen: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("sweep"), BarColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=not _is_notebook())) as bar:
        task = bar.add_task("compiling", total=n_runs)
        yield lambda seen: bar.update(task, completed=seen.n_done, description=str(seen))


def _is_notebook() -> bool:
    shell = sys.modules.get("IPython")
    return shell is not None and type(shell.get_ipython()).__name__ == "ZMQInteractiveShell"

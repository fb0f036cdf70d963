"""How far a sweep is: a bar in terminals and notebooks, a line every ten seconds in logs."""

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spherejax.foundations.terminals import console, is_notebook
from spherejax.motion.integration.status import Status
from spherejax.studies.sweep.chunks import ChunkResult


@dataclass(frozen=True)
class SweepProgress:
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
    def beginning(n_runs: int, n_chunks: int, n_chunks_before: int, chunk_size: int) -> "SweepProgress":
        """Nothing done but what an earlier start has left."""
        before = n_runs if n_chunks_before == n_chunks else n_chunks_before * chunk_size
        return SweepProgress(n_runs, before, before, 0, 0, 0, time.monotonic())

    def with_chunk(self, result: ChunkResult) -> "SweepProgress":
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
            doing = "all done before" if self.n_done == self.n_runs else "first chunk, with compilation"
            return f"{self.n_done:,} of {self.n_runs:,} runs, {doing}"
        failed = f", {self.n_failed} failed" if self.n_failed else ""
        return (
            f"{self.n_done:,} of {self.n_runs:,} runs, {self.runs_per_second:,.0f} per second, "
            f"lane efficiency {self.lane_efficiency:.2f}{failed}"
        )


Report = Callable[[SweepProgress], None]


SECONDS_BETWEEN = 0.2
"""A notebook's display is not renewed more often."""

SECONDS_BETWEEN_LINES = 10.0
"""Time between two lines in a log [s]: a sweep that is over sooner writes none, one of an hour a few hundred."""


@contextmanager
def reporting(progress: bool | Report, n_runs: int) -> Iterator[Report]:
    """A function that shows what has been done."""
    if callable(progress):
        yield progress
    elif progress and is_notebook():
        yield _notebook_display()
    elif progress and sys.stderr.isatty():
        with _terminal_bar(n_runs) as report:
            yield report
    elif progress and os.environ.get("SPHEREJAX_QUIET", "0") == "0":
        with _lines() as report:
            yield report
    else:
        yield lambda seen: None


@contextmanager
def _lines() -> Iterator[Report]:
    """A line on standard error now and then, where it is a file or a pipe: the log of a batch job is not silent.

    A thread writes them, so that a long first chunk, with compilation, is seen too.
    """
    latest: list[SweepProgress] = []
    is_over = threading.Event()

    def write() -> None:
        while not is_over.wait(SECONDS_BETWEEN_LINES):
            for seen in latest[-1:]:
                left = (
                    "" if seen.n_done in (seen.n_runs, seen.n_done_before) else f", {_minutes(seen.seconds_left)} left"
                )
                print(f"spherejax: sweep: {seen}{left}", file=sys.stderr, flush=True)

    def report(seen: SweepProgress) -> None:
        latest[:] = [seen]

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    try:
        yield report
    finally:
        is_over.set()
        writer.join()


@contextmanager
def _terminal_bar(n_runs: int) -> Iterator[Report]:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("sweep"), BarColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
    with Progress(*columns, console=console()) as bar:
        task = bar.add_task(f"{n_runs:,} runs", total=n_runs)
        yield lambda seen: bar.update(task, completed=seen.n_done, description=str(seen))


def _notebook_display() -> Report:
    """One output that is replaced: what a saved notebook shows is how the sweep ended, without any widget."""
    from IPython.display import display

    handle: Any = display(_shown("sweep"), raw=True, display_id=True)
    renewed = [0.0]

    def report(seen: SweepProgress) -> None:
        if seen.n_done == seen.n_runs or time.monotonic() - renewed[0] > SECONDS_BETWEEN:
            renewed[0] = time.monotonic()
            left = "" if seen.n_done in (seen.n_runs, seen.n_done_before) else f", {_minutes(seen.seconds_left)} left"
            handle.update(_shown(f"sweep: {seen}{left}", seen.n_done / seen.n_runs), raw=True)

    return report


def _shown(text: str, share: float = 0.0) -> dict[str, str]:
    return {"text/plain": text, "text/html": f'<progress value="{share:.4f}"></progress> {text}'}


def _minutes(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"

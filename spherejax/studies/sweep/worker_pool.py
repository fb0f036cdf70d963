"""Who computes the chunks of a sweep: threads on the cores, the accelerators side by side, or somebody's executor."""

import math
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import replace
from queue import SimpleQueue
from threading import Thread
from typing import Any, NamedTuple

import jax

from spherejax import runtime
from spherejax.foundations.errors import SceneError
from spherejax.studies.sweep.chunks import (
    ChunkResult,
    ChunkWork,
    compiled_for,
    n_rows,
    packed,
    run_chunk,
    run_packed_chunk,
)
from spherejax.studies.sweep.devices import compiled_for_all, run_side_by_side
from spherejax.studies.sweep.failures import SweepError, explained
from spherejax.studies.sweep.progress import Report, SweepProgress
from spherejax.studies.sweep.results import Results

ATTEMPTS = 3
"""How often a chunk is sent out when the worker that has it dies."""

Submit = Callable[[Sequence[int]], "Future[list[ChunkResult]]"]
"""Hand out chunks that are computed together."""


class WorkerPool(NamedTuple):
    """Where chunks go.

    Attributes:
        opened: a context in which `Submit` works.
        together: chunks that are handed out together.
        at_once: how many such are under way at the same time; more wait here, where they can be stopped.
    """

    opened: Callable
    together: int
    at_once: int


def worker_pool_for(results: Results, workers: int, executor: Executor | None) -> WorkerPool:
    """An executor, where one is given; otherwise the devices of this process."""
    if executor is not None:
        return _elsewhere(results, executor)
    devices = jax.local_devices()
    return _threads(results, workers) if len(devices) == 1 else _devices(results, devices[:workers])


def default_workers() -> int:
    """All cores, or all devices where there are several or one is no CPU."""
    devices = jax.local_devices()
    if devices[0].platform == "cpu" and len(devices) == 1:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return len(devices)


CHUNK_SECONDS = 2.0
"""What a chunk of a long sweep takes [s], about: what is lost where it is stopped, and how long its threads go on."""

LONG_SWEEP = 60.0
"""Time [s] beyond which a sweep is compiled again for smaller chunks, which takes 10 s of processor time."""

FEWEST_FOR_EACH_LANE = 12
"""Runs in a chunk for each lane, at least. At the end of a chunk lanes idle. With 1,024 runs of a dry four-bar in 24
lanes these are 1 % of the steps in chunks of 1,024, 2 in chunks of 512, 4 in chunks of 256, 10 in chunks of 128."""


def paced(work: ChunkWork, *, some_runs: Callable[[int], Any], n_runs: int, workers: int) -> ChunkWork:
    """The work in smaller chunks, where the sweep is long and a chunk would take long.

    Two runs for each lane are made to see how long one takes, by the program of a whole chunk.

    Args:
        work: in chunks by number alone.

    Other args:
        some_runs: parameters of so many runs that stand for all.
        n_runs: of the sweep.
        workers: chunks that are computed at the same time.
    """
    width = work.settings.block.width
    fewest = FEWEST_FOR_EACH_LANE * width
    if work.size < 2 * fewest or len(jax.local_devices()) > 1:
        return work
    rows = some_runs(2 * width)
    with _Threads(1) as pool:  # this one stays free to be interrupted
        tried = pool.submit(lambda: run_chunk(work, rows, compiled_for(work, rows))).result()
    seconds = tried.seconds / n_rows(rows)
    if n_runs * seconds / workers < LONG_SWEEP or work.size * seconds < 2 * CHUNK_SECONDS:
        return work
    # By powers of two: the times of two sweeps are never the same, and their programs shall be.
    size = fewest * 2 ** max(0, math.floor(math.log2(CHUNK_SECONDS / (fewest * seconds))))
    return replace(work, size=min(size, work.size))


def run_chunks(results: Results, worker_pool: WorkerPool, report: Report) -> None:
    """Hand out the missing chunks, take what comes back, and hand out again what was lost."""
    waiting = results.missing()
    seen = SweepProgress.beginning(
        results.grid.n_runs, results.n_chunks, results.n_chunks - len(waiting), results.work.size
    )
    report(seen)
    if not waiting:
        return
    attempts: Counter[int] = Counter()
    try:
        with worker_pool.opened() as submit:
            under_way: dict[Future, list[int]] = {}
            try:
                while waiting or under_way:
                    while waiting and len(under_way) < worker_pool.at_once:
                        chunks, waiting = waiting[: worker_pool.together], waiting[worker_pool.together :]
                        attempts.update(chunks)
                        try:
                            under_way[submit(chunks)] = chunks
                        except Exception as error:
                            _keep_finished(results, under_way)
                            raise _told(error, results, chunks[0], attempts[chunks[0]]) from error
                    for future in wait(under_way, runtime.LONGEST_WAIT, return_when=FIRST_COMPLETED).done:
                        chunks = under_way.pop(future)
                        error = _error_of(future)
                        if error is None:
                            for chunk, result in zip(chunks, future.result(), strict=True):
                                results.put(chunk, result)
                                seen = seen.with_chunk(result)
                            report(seen)
                        elif _may_try_again(error, max(attempts[chunk] for chunk in chunks)):
                            waiting = [*waiting, *chunks]
                        else:
                            _keep_finished(results, under_way)
                            raise _told(error, results, chunks[0], attempts[chunks[0]])
            except KeyboardInterrupt:
                _keep_finished(results, under_way)
                raise
            finally:
                for future in under_way:
                    future.cancel()
    except (KeyboardInterrupt, SweepError) as stop:
        stop.add_note(_where_it_stands(results))
        raise


def _where_it_stands(results: Results) -> str:
    if results.store is None:
        return "sweep: stopped; nothing is kept, for the sweep has no store (store=)"
    return (
        f"sweep: stopped; {results.store.n_stored:,} of {results.grid.n_runs:,} runs are in "
        f"{str(results.store.path)!r}, and the same call goes on from there"
    )


def _error_of(future: Future) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as cancelled:
        return cancelled


def _may_try_again(error: BaseException, attempts: int) -> bool:
    """A worker may have died; a scheduler that has gone takes no more chunks, and waits for ever."""
    return attempts < ATTEMPTS and not isinstance(error, SceneError | SweepError | CancelledError | BrokenExecutor)


def _told(error: BaseException, results: Results, chunk: int, attempts: int) -> BaseException:
    told = explained(error, chunk, results.work.size, attempts)
    if told is not error:
        told.__cause__ = error
    return told


def _keep_finished(results: Results, under_way: Mapping[Future, list[int]]) -> None:
    """Take what other workers have finished meanwhile."""
    for future, chunks in under_way.items():
        if future.done() and _error_of(future) is None:
            for chunk, result in zip(chunks, future.result(), strict=True):
                results.put(chunk, result)


# The three pools --------------------------------------------------------------------------------------------------


def _elsewhere(results: Results, executor: Executor) -> WorkerPool:
    sent = packed(results.work)

    @contextmanager
    def opened() -> Iterator[Submit]:
        yield lambda chunks: executor.submit(run_packed_chunk, sent, results.rows(chunks[0]))

    return WorkerPool(opened, 1, 4 * (getattr(executor, "_max_workers", None) or os.cpu_count() or 1))


def _threads(results: Results, workers: int) -> WorkerPool:
    """Threads of one device: the compiled loop runs on one core."""
    work = results.work

    @contextmanager
    def opened() -> Iterator[Submit]:
        with _Threads(workers) as pool:
            # Compiled in a thread: this one stays free to be interrupted.
            program = pool.submit(lambda: compiled_for(work, results.rows(0)))
            yield lambda chunks: pool.submit(lambda: [run_chunk(work, results.rows(chunks[0]), program.result())])

    return WorkerPool(opened, 1, workers)


def _devices(results: Results, devices: Sequence[Any]) -> WorkerPool:
    """All devices together, a chunk for each; the next chunks wait while the last ones are stored."""
    work, n = results.work, len(devices)

    @contextmanager
    def opened() -> Iterator[Submit]:
        with _Threads(1) as pool:
            program = pool.submit(lambda: compiled_for_all(work, results.rows(0), devices))

            def side_by_side(chunks: Sequence[int]) -> list[ChunkResult]:
                return run_side_by_side(work, [results.rows(chunk) for chunk in chunks], program.result(), n)

            yield lambda chunks: pool.submit(lambda: side_by_side(chunks))

    return WorkerPool(opened, n, 2)


class _Threads:
    """Threads that an interrupted sweep does not wait for; they end with the chunk that they are at."""

    def __init__(self, n: int):
        self.jobs: SimpleQueue = SimpleQueue()
        self.threads = [Thread(target=self._work) for _ in range(n)]

    def __enter__(self) -> "_Threads":
        for thread in self.threads:
            thread.start()
        return self

    def __exit__(self, *_) -> None:
        for _ in self.threads:
            self.jobs.put(None)

    def submit(self, call: Callable[[], Any]) -> Future:
        future: Future = Future()
        self.jobs.put((future, call))
        return future

    def _work(self) -> None:
        while (job := self.jobs.get()) is not None:
            future, call = job
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(call())
            except BaseException as error:
                future.set_exception(error)

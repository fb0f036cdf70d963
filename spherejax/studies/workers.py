"""Work that is compiled and run at the same time by several workers, and reported as it comes."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Any, NamedTuple

from spherejax import runtime

Report = Callable[[str, float], None]
"""Called with what has just been done and the share of the work that is done."""


def silent(what: str, share: float) -> None:
    """Report nothing."""
    del what, share


class Piece(NamedTuple):
    """A piece of work.

    Attributes:
        what: in words, for the report.
        work: to be called.
    """

    what: str
    work: Callable[[], Any]


class Progress:
    """Counts finished pieces of work and reports their share."""

    def __init__(self, report: Report, n_pieces: int):
        self.report, self.n_pieces, self.n_done = report, n_pieces, 0

    def __call__(self, what: str) -> None:
        """One more is done."""
        self.n_done += 1
        self.report(what, min(1.0, self.n_done / self.n_pieces))


_NOTHING = object()

NOTHING_YET = object()
"""A step of who waits in which there was nothing to do: the next one is made when another piece of work is done."""


def _unheard(at: int, result: Any) -> None:
    del at, result


class Pool:
    """Workers that compile and run at the same time; the results keep their order."""

    def __init__(self, executor: ThreadPoolExecutor, done: Progress):
        self.executor, self.done = executor, done

    def each(
        self,
        pieces: Sequence[Piece],
        meanwhile: Iterator[Any] | None = None,
        heard: Callable[[int, Any], None] = _unheard,
    ) -> list:
        """The results of all pieces of work, reported as they come.

        Args:
            pieces: the work.
            meanwhile: work for the thread that waits; a step of it is made whenever there is nothing to report. What is
                left of it when all pieces are done is left to the caller.
            heard: called by the thread that waits with the place of a piece that is done, and its result.
        """
        futures = {self.executor.submit(piece.work): at for at, piece in enumerate(pieces)}
        waiting, has_more, is_idle = set(futures), meanwhile is not None, False
        while waiting:
            timeout = 0 if has_more and not is_idle else runtime.LONGEST_WAIT
            found, waiting = wait(waiting, timeout=timeout, return_when=FIRST_COMPLETED)
            for future in found:
                heard(futures[future], future.result())
                self.done(pieces[futures[future]].what)
            if waiting and has_more and meanwhile is not None:
                step = next(meanwhile, _NOTHING)
                has_more, is_idle = step is not _NOTHING, step is NOTHING_YET
        return [future.result() for future in futures]


@contextmanager
def workers(done: Progress) -> Iterator[Pool]:
    """As many workers as there are cores, four at most: each holds a run with 2e5 samples, 0.3 GB."""
    executor = ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1))
    try:
        yield Pool(executor, done)
    finally:
        executor.shutdown(cancel_futures=True)

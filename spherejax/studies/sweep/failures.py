"""What can stop a sweep from outside, in one sentence each: what happened, what is kept, and what to do."""

import errno
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, CancelledError
from contextlib import contextmanager
from pathlib import Path


class SweepError(RuntimeError):
    """A sweep that cannot go on: the message says what happened, what is kept, and what to do."""


class StoreWarning(UserWarning):
    """Something about a store that could not be verified."""


NO_SPACE = tuple(getattr(errno, name) for name in ("ENOSPC", "EDQUOT", "EFBIG") if hasattr(errno, name))
"""Error numbers for a full disk, a used quota and the largest file; Windows need not have one for quotas."""


@contextmanager
def writing(path: Path, what: str) -> Iterator[None]:
    """Errors of the file system while something is written, as a `SweepError`."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        remedy = "make room, then make" if error.errno in NO_SPACE else "see to it, then make"
        raise SweepError(f"cannot write {what} to {str(path)!r}: {reason}. {remedy.capitalize()} the same call again; "
                         "what is stored stays stored") from error  # fmt: skip


def explained(error: BaseException, chunk: int, n_runs: int, n_attempts: int) -> BaseException:
    """The error of a chunk that could not be computed, in the words of a sweep where the cause is known.

    Args:
        error: what came instead of results.
        chunk: its number.
        n_runs: how many runs it has.
        n_attempts: how often it has been sent out.
    """
    told = f"{type(error).__name__}: {error}".rstrip(": ")
    if _is_out_of_memory(error):
        return SweepError(
            f"chunk {chunk} does not fit in memory ({told}). Hand out fewer runs at a time, e.g. "
            f"chunk={max(n_runs // 4, 1)} (now {n_runs}; a store keeps the chunk that it was begun with), or use fewer "
            "workers="
        )
    if type(error).__name__ == "KilledWorker" or isinstance(error, BrokenExecutor):
        return SweepError(
            f"the workers that had chunk {chunk} died ({told}), {n_attempts} of them. Most often they exceed a limit "
            f"of memory: give them more, or hand out fewer runs at a time, e.g. chunk={max(n_runs // 4, 1)} (now "
            f"{n_runs}; a store keeps the chunk that it was begun with). A pool of processes that is broken must be "
            "made anew"
        )
    if _is_disconnected(error):
        return SweepError(
            f"the executor has stopped, and chunk {chunk} with it ({told}). Start its scheduler or pool again"
        )
    return error


def _is_out_of_memory(error: BaseException) -> bool:
    return isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error)


_DISCONNECTED = ("CommClosedError", "FutureCancelledError", "FuturesCancelledError", "ClosedClientError")


def _is_disconnected(error: BaseException) -> bool:
    if isinstance(error, CancelledError | ConnectionError | TimeoutError) or type(error).__name__ in _DISCONNECTED:
        return True
    return isinstance(error, RuntimeError) and "after shutdown" in str(error)

"""One process at a time writes a store: a lock beside it, which names its owner and which ends with its process."""

import errno
import os
import socket
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from spherejax.foundations.errors import SceneError
from spherejax.studies.sweep.failures import StoreWarning, writing

_NAMES = ("ENOLCK", "ENOTSUP", "EOPNOTSUPP", "ENOSYS")
NO_LOCKS = tuple(getattr(errno, name) for name in _NAMES if hasattr(errno, name))
"""Error numbers of file systems that have no locks; not every system has a number of each name."""


@contextmanager
def held(path: Path | None) -> Iterator[None]:
    """The right to write a store; nothing without a path.

    The lock belongs to the operating system, not to a file that is there: it ends with its process, however that ends.
    What a killed process has left lying is taken over.

    Raises:
        SceneError: while another process has it; the message says which one.
    """
    if path is None:
        yield
        return
    beside = path.with_name(path.name + ".lock")
    descriptor = _opened(path, beside)
    try:
        yield
    finally:
        # Before it is let go: afterwards it may be somebody else's.
        with suppress(OSError):
            beside.unlink()
        os.close(descriptor)
        if os.name == "nt":  # Windows deletes no file that is open, nor, so, one that somebody else has opened since
            with suppress(OSError):
                beside.unlink()


def _opened(path: Path, beside: Path) -> int:
    while True:
        with writing(path, "the lock of the store"):
            beside.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(beside, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if not _is_taken_by_us(descriptor):
                owner = os.read(descriptor, 1000).decode(errors="replace") or "another process"
                raise SceneError(
                    f"{str(path)!r} is being written by {owner}: wait until it has ended, or choose another path"
                )
            if _is_still_there(descriptor, beside):
                owner = f"process {os.getpid()} on {socket.gethostname()}, since {time.strftime('%Y-%m-%d %H:%M:%S')}"
                os.ftruncate(descriptor, 0)
                os.write(descriptor, owner.encode())
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _is_taken_by_us(descriptor: int) -> bool:
    try:
        import fcntl
    except ImportError:  # Windows
        return _is_taken_by_us_on_windows(descriptor)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
        warnings.warn(
            "the file system of the store has no locks: see to it that no other process writes the store",
            StoreWarning,
            stacklevel=5,
        )
    return True


def _is_taken_by_us_on_windows(descriptor: int) -> bool:
    import msvcrt

    # A byte far behind the text: the one that is locked cannot be read by others.
    os.lseek(descriptor, 10_000, os.SEEK_SET)
    try:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # pyright: ignore[reportAttributeAccessIssue]
    except OSError:
        return False
    finally:
        os.lseek(descriptor, 0, os.SEEK_SET)
    return True


def _is_still_there(descriptor: int, beside: Path) -> bool:
    """Whether the file that was locked is the one that others see: its last owner may have removed it meanwhile."""
    try:
        return os.path.samestat(os.fstat(descriptor), beside.stat())
    except FileNotFoundError:
        return False

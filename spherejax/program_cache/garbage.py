"""Pauses Python's cyclic garbage collector while programs are traced and compiled.

Tracing makes a hundred thousand small objects that all live until the program is done. Each time enough of them have
come, Python searches everything that the process holds for cycles (a million objects after `import jax`) and finds next
to nothing. This takes a third of the processor time of the four-bar's first call (dry with friction: 18.0 s with it,
11.3 s without). The collection is postponed, not left out: the first one afterwards frees what has become garbage.
"""

import gc
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class _Pauses:
    """How many callers, on all threads, have paused it: the collector is one for the process."""

    def __init__(self) -> None:
        # Counted, since the first thread to leave must not switch it on for the others.
        self.lock, self.n, self.was_on = threading.Lock(), 0, False

    def begin(self) -> None:
        with self.lock:
            # Before the first pause alone: in an inner one it is off in any case.
            if self.n == 0:
                self.was_on = gc.isenabled()
                gc.disable()
            self.n += 1

    def end(self) -> None:
        with self.lock:
            self.n -= 1
            # A user may have switched it off: it stays off then.
            if self.n == 0 and self.was_on:
                gc.enable()


_pauses = _Pauses()


@contextmanager
def gc_paused() -> Iterator[None]:
    """No cyclic garbage is collected in this context; afterwards as before. May be nested, and used by threads."""
    _pauses.begin()
    try:
        yield
    finally:
        _pauses.end()

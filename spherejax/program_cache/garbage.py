"""Python's cyclic garbage collector, put off while programs are traced and compiled.

Tracing makes a hundred thousand small objects that all live until the program is done. Each time enough of them have
come, Python looks through everything that the process holds for cycles (after `import jax` a million objects) and finds
next to nothing: a third of the processor time of the four-bar's first call (dry with friction: 18.0 s with, 11.3 s
without). It is put off, not left out: what has become garbage is found by the first collection afterwards.
"""

import gc
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class _Pauses:
    """How many callers, on all threads, want it put off; the switch is one for the process."""

    def __init__(self) -> None:
        self.lock, self.n, self.was_on = threading.Lock(), 0, False

    def begin(self) -> None:
        with self.lock:
            if self.n == 0:
                self.was_on = gc.isenabled()
                gc.disable()
            self.n += 1

    def end(self) -> None:
        with self.lock:
            self.n -= 1
            if self.n == 0 and self.was_on:
                gc.enable()


_pauses = _Pauses()


@contextmanager
def gc_paused() -> Iterator[None]:
    """No cyclic garbage is looked for in this context; afterwards as before. May be nested, and used by threads."""
    _pauses.begin()
    try:
        yield
    finally:
        _pauses.end()

"""Whether somebody watches, and what they are told: how far a study is, and what they wait for."""

import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import jax.monitoring


def is_watched() -> bool:
    """Whether standard error is a terminal, or this is a notebook."""
    return sys.stderr.isatty() or is_notebook()


def is_notebook() -> bool:
    """Whether this runs in a notebook."""
    shell = sys.modules.get("IPython")
    return shell is not None and type(shell.get_ipython()).__name__ == "ZMQInteractiveShell"


def console():
    """rich's console on standard error, or in the notebook."""
    from rich.console import Console

    return Console(stderr=not is_notebook())


SAID_AFTER = 1.0
"""How long one waits before a word is said [s]."""


@contextmanager
def waiting_for(what: str, program: str) -> Iterator[None]:
    """Say what is compiled, to whoever waits for longer than a moment, and how long it took.

    On terminals and in notebooks; not in logs, not in the workers of a pool, and not where the environment variable
    `SPHEREJAX_QUIET` is set. Of waits within one another the outermost speaks.

    Args:
        what: is compiled, e.g. `"a run"`.
        program: name of the compiled function, with which the wait is over.
    """
    is_quiet = os.environ.get("SPHEREJAX_QUIET", "0") != "0" or multiprocessing.parent_process() is not None
    if _waiting.word is not None or is_quiet or not is_watched():
        yield
        return
    _listen()
    word = _waiting.word = _Word(what, program)
    try:
        yield
        word.ends()
    finally:
        word.is_over()
        _waiting.word = None


class _Word:
    """What is said of one wait."""

    def __init__(self, what: str, program: str):
        self.program = program
        self._what, self._began, self._lock = what, time.monotonic(), threading.Lock()
        self._is_said = self._is_over = False
        self._timer = threading.Timer(SAID_AFTER, self._begins)
        self._timer.daemon = True
        self._timer.start()

    def _begins(self) -> None:
        with self._lock:
            if not self._is_over:
                self._is_said = True
                self._print(f"compiling {self._what}; once for each kind of scene ...")

    def ends(self) -> None:
        """It is compiled."""
        with self._lock:
            if self._is_said and not self._is_over:
                self._print(f"compiled {self._what} in {time.monotonic() - self._began:.0f} s")
        self.is_over()

    def is_over(self) -> None:
        """Nothing more is said."""
        self._timer.cancel()
        with self._lock:
            self._is_over = True

    def _print(self, said: str) -> None:
        print(f"spherejax: {said}", file=sys.stderr, flush=True)


class _Waiting(threading.local):
    word: _Word | None = None


_waiting = _Waiting()


@cache
def _listen() -> None:
    """A wait is over when its program is compiled, however long that program then runs."""
    jax.monitoring.register_event_duration_secs_listener(_heard)


def _heard(event: str, duration_secs: float, **said: Any) -> None:
    word = _waiting.word
    if word is not None and event.endswith("backend_compile_duration") and word.program in str(said.get("fun_name")):
        word.ends()

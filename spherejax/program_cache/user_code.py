"""The fingerprint of user code: code that no version number identifies, read at the moment of the call.

User code is traced once, and its program is cached. In a notebook the helpers of a user's function, and the constants
that it looks up, are edited and run again; the cached program computes what they were before. So the key of everything
with user code in it contains a fingerprint of that code as it is now, with all that it looks up. A cell that was edited
and run again gives another key, and what depends on it is traced again.

Some code changes what it looks up while it is traced: it counts its calls, or appends to a list. It would get another
key at each call. So names that a function assigns to are left out; and where tracing is seen to change something else
that the code looks up, only functions, classes and numbers count from then on, and a warning says so.
"""

import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from spherejax.program_cache.fingerprints import code_fingerprint, own_parts, reaches_tracer

N_TREES = 1024
"""Structures of which the user code in them is remembered (which objects, not what they are now)."""


def user_code_fingerprint(tree: Any) -> str:
    """The fingerprint of the user code in the structure of a pytree; empty where there is none.

    Args:
        tree: what `jax.tree.structure` returns.
    """
    # Which objects are user code is looked up once for a structure; most structures have none, and are done here.
    parts = _parts_of(tree)
    if not parts:
        return ""
    seen = getattr(_reading, "seen", None)
    if seen is None:
        return _current(parts)
    if parts not in seen:
        # Both now: once tracing has begun, what the code assigns to or appends to may be something else.
        seen[parts] = _current(parts), _fingerprint(parts, with_state=False)
    return seen[parts][0]


@contextmanager
def read_once() -> Iterator[None]:
    """User code is read once in this context, and once more at its end. May be nested.

    Reading once saves time (a call asks for several keys), and makes all keys of a call agree. Reading again shows
    whether tracing has changed what the code looks up.
    """
    # The outermost context reads, and compares at its end: an inner one would take what tracing has changed so far for
    # the state before.
    if getattr(_reading, "seen", None) is not None:
        yield
        return
    seen, _reading.answers = {}, {}
    _reading.seen = seen
    try:
        yield
    finally:
        # Before the code is read again: within the context the first reading would be returned.
        _reading.seen = _reading.answers = None
        for parts, (before, code) in seen.items():
            # If functions and numbers changed as well, the user has edited the code meanwhile, on another thread.
            if _current(parts) != before and _fingerprint(parts, with_state=False) == code:
                _before_tracing[parts, code] = before
                warnings.warn(
                    f"what {_names(parts)} looks up changed while it was simulated: from now on lists, tables and "
                    "objects that it looks up are not watched; where one of them is changed between runs, the program "
                    "of before is run. Functions, classes and numbers are watched as before",
                    RuntimeWarning,
                    stacklevel=4,
                )


def once(name: str, find: Callable[[], Any]) -> Any:
    """What `find` returns: asked once within `read_once`, each time outside of it."""
    answers = getattr(_reading, "answers", None)
    if answers is None:
        return find()
    if name not in answers:
        answers[name] = find()
    return answers[name]


def parts_that_reach_tracers(tree: Any) -> tuple:
    """The user code in the structure of a pytree, if some of it looks up a value that JAX traces; else nothing.

    Args:
        tree: what `jax.tree.structure` returns.
    """
    parts = own_parts(tree)
    return parts if parts and reaches_tracer(parts) else ()


# Of each thread: another one may be in the middle of tracing.
_reading = threading.local()

_before_tracing: dict[tuple, str] = {}
"""Of code that changes what it looks up while it is traced: its fingerprint before that, by its objects, and by its
fingerprint without what changes. It stays the fingerprint as long as functions, classes and numbers stay the same."""


def _current(parts: tuple) -> str:
    # Only such code is read without its state: for all other code a list that a user changes is another program.
    if any(parts == changing for changing, _ in _before_tracing):
        code = _fingerprint(parts, with_state=False)
        return _before_tracing.get((parts, code), code)
    return _fingerprint(parts)


def _fingerprint(parts: tuple, *, with_state: bool = True) -> str:
    try:
        return code_fingerprint(parts, with_state=with_state)
    except Exception as error:  # what code looks up may be anything, and fail when it is read
        # Lists and objects are the usual reason: a file, a socket, a table of another library.
        if with_state:
            return _fingerprint(parts, with_state=False)
        warnings.warn(
            f"{_names(parts)} cannot be looked into ({type(error).__name__}: {error}): whether it has been changed "
            "since it was first simulated is not seen",
            RuntimeWarning,
            stacklevel=5,
        )
        return "unknown"


def _names(parts: tuple) -> str:
    return ", ".join(getattr(part.value, "__qualname__", type(part.value).__qualname__) for part in parts)


class _Same:
    """An object, compared by identity whatever its class says: user code may define `__eq__` without `__hash__`."""

    __slots__ = ("value",)

    def __init__(self, value: Any):
        self.value = value

    def __hash__(self) -> int:
        # The address is not given to another object meanwhile: this one is held here.
        return id(self.value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.value is other.value

    def __cache_key__(self) -> Any:
        """What stands for it in a fingerprint: the object itself."""
        return self.value


# By equality of structures: equal ones hold equal classes and functions.
@lru_cache(maxsize=N_TREES)
def _parts_of(tree: Any) -> tuple[_Same, ...]:
    return tuple(map(_Same, own_parts(tree)))

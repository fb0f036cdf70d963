"""Code of a user's own in what is simulated, told by what it is now.

A law, a force or a function is traced once, and its program is kept. In a notebook the helpers of a user's own law and
the constants that it looks up are written anew again and again: a program that was traced before computes what they
were then. So whatever is kept of something with such code is told by a fingerprint of that code as it is now, with all
that it looks up: a cell that is run again is seen, and what it changes is traced anew.

What code counts or collects while it is traced would make it another one each time. Names that it assigns to do not
count; and where a run is seen to change what its code looks up, in lists and objects say, only functions, classes and
numbers count from then on, and a warning says so.
"""

import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from spherejax.program_cache.fingerprints import code_fingerprint, own_parts

N_TREES = 1024
"""Trees of which it is remembered whether there is code of a user's own in them."""


def user_code_fingerprint(tree: Any) -> str:
    """The fingerprint of the code of a user's own that the tree of a pytree holds; empty where there is none.

    Args:
        tree: what `jax.tree.structure` returns.
    """
    parts = _parts_of(tree)
    if not parts:
        return ""
    seen = getattr(_looking, "seen", None)
    if seen is None:
        return _told(parts)
    if parts not in seen:
        seen[parts] = _told(parts), _fingerprint(parts, with_state=False)
    return seen[parts][0]


@contextmanager
def looked_at_once() -> Iterator[None]:
    """Code is looked at once in this context, and again at its end: whether what was traced has changed what it looks
    up itself. May be nested."""
    if getattr(_looking, "seen", None) is not None:
        yield
        return
    seen, _looking.found = {}, {}
    _looking.seen = seen
    try:
        yield
    finally:
        _looking.seen = _looking.found = None
        for parts, (told, code) in seen.items():
            if _told(parts) != told and _fingerprint(parts, with_state=False) == code:
                _by_code[parts, code] = told
                warnings.warn(
                    f"what {_names(parts)} looks up changed while it was simulated: from now on lists, tables and "
                    "objects that it looks up are not watched; where one of them is changed between runs, the program "
                    "of before is run. Functions, classes and numbers are watched as before",
                    RuntimeWarning,
                    stacklevel=4,
                )


def once(name: str, find: Callable[[], Any]) -> Any:
    """What is found of code that does not change within `looked_at_once`; outside of it, found anew each time."""
    found = getattr(_looking, "found", None)
    if found is None:
        return find()
    if name not in found:
        found[name] = find()
    return found[name]


_looking = threading.local()

_by_code: dict[tuple, str] = {}
"""What code is told by, where tracing it changes what it looks up: by what it was before that."""


def _told(parts: tuple) -> str:
    if any(parts == changing for changing, _ in _by_code):
        code = _fingerprint(parts, with_state=False)
        return _by_code.get((parts, code), code)
    return _fingerprint(parts)


def _fingerprint(parts: tuple, *, with_state: bool = True) -> str:
    try:
        return code_fingerprint(parts, with_state=with_state)
    except Exception as error:  # what code looks up may be anything, and fail when it is looked at
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
    """Told by identity, whatever it is."""

    __slots__ = ("value",)

    def __init__(self, value: Any):
        self.value = value

    def __hash__(self) -> int:
        return id(self.value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.value is other.value

    def __cache_key__(self) -> Any:
        """What `fingerprints` takes for it."""
        return self.value


@lru_cache(maxsize=N_TREES)
def _parts_of(tree: Any) -> tuple[_Same, ...]:
    return tuple(map(_Same, own_parts(tree)))

"""Errors for what a user wrote; nothing here waits for JAX, so that a command can answer at once."""

import difflib
from collections.abc import Iterable


class SceneError(ValueError):
    """A scene, a model or a request that cannot be simulated; the message says what, where and what to do."""


def one_of(names: Iterable[str], given: str) -> str:
    """For an error message: the nearest name to a wrong one, and all that there are."""
    names = list(names)
    near = difflib.get_close_matches(given[:100].lower(), names, n=1)
    listed = ", ".join(names) or "none"
    return f"did you mean {near[0]!r}? There are: {listed}" if near else f"there are: {listed}"

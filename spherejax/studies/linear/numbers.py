"""Numbers of a scene by path, such as `"forces.push.force.z"`, and how the numbers of a system follow them.

A path is made of attributes and names from the scene on: `joints.elbow.model.stiffness`, `bodies.rocker.mass`,
`gravity.z`. A part in between may be left out where one alone has what follows: `joints.elbow.model.stiffness` is the
stiffness of its law. An entry of an array is `.x`, `.y`, `.z` of three, else its index: `.0`, of a matrix `.0.1`.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.errors import SceneError, one_of
from spherejax.model.scene import Scene
from spherejax.model.system import System

AXES = {"x": 0, "y": 1, "z": 2}


class Number(NamedTuple):
    """One number of a scene or a system.

    Attributes:
        name: its path.
        steps: attributes and keys that lead to the array that holds it.
        index: its entry there; () of a number by itself.
    """

    name: str
    steps: tuple[str, ...]
    index: tuple[int, ...]

    def value(self, whole: Scene | System) -> float:
        """Its value."""
        return float(np.asarray(_follow(whole, self.steps), np.float64)[self.index])

    def size(self, whole: Scene | System) -> float:
        """How large it is: the largest of the numbers that it stands among; 1 where all are zero."""
        return float(np.abs(np.asarray(_follow(whole, self.steps), np.float64)).max()) or 1.0

    def changed(self, whole: Any, value: Any) -> Any:
        """The scene or system with another value; it may be traced."""
        leaf = jnp.asarray(_follow(whole, self.steps), jnp.float64)
        new = leaf.at[self.index].set(value) if self.index else jnp.asarray(value)
        return eqx.tree_at(lambda part: _follow(part, self.steps), whole, new)


def numbers_at(whole: Scene | System, path: str) -> list[Number]:
    """The number at a path; of an array all its entries.

    Raises:
        SceneError: for a path that leads nowhere, or to what is no number; it names what is there.
    """
    if not isinstance(path, str) or not path:
        raise SceneError(f"{path!r} is no path of a number; write e.g. 'forces.push.force.z' or 'bodies.rocker.mass'")
    steps: list[str] = []
    words, at = path.split("."), whole
    while words and _has_names(at):
        word = words.pop(0)
        if word not in _names_of(at):
            inner = [name for name in _names_of(at) if word in _names_of(_one(at, name))]
            if len(inner) != 1:
                where = ".".join(steps) or "the scene"
                raise SceneError(f"{path!r}: {where} has no {word!r}; {one_of(_names_of(at), word)}")
            words = [inner[0], word, *words]
            continue
        steps.append(word)
        at = _one(at, word)
    try:
        value = np.asarray(at, np.float64)
    except (TypeError, ValueError):
        known = f"; it has {', '.join(_names_of(at))}" if _names_of(at) else ""
        what = "a function" if callable(at) else "not given" if at is None else f"a {type(at).__name__}"
        raise SceneError(f"{path!r} is no number but {what}{known}") from None
    letters = _letters(value.shape)
    if not words:
        entries = list(np.ndindex(value.shape))
        names = [".".join([path, *(letters(i) for i in entry)]) for entry in entries]
        return [Number(name, tuple(steps), entry) for name, entry in zip(names, entries, strict=True)]
    index = tuple(AXES[w] if w in AXES and value.shape == (3,) else int(w) if w.isdigit() else -1 for w in words)
    if len(index) != value.ndim or any(not 0 <= i < n for i, n in zip(index, value.shape, strict=False)):
        entries = ", ".join(".".join(map(letters, entry)) for entry in np.ndindex(value.shape))
        raise SceneError(
            f"{path!r}: {'.'.join(steps)} is "
            + (f"numbers of shape {value.shape}; its entries are {entries}" if value.ndim else "a number by itself")
        )
    return [Number(path, tuple(steps), index)]


def number_at(whole: Scene | System, path: str) -> Number:
    """The one number at a path; as `numbers_at`, and an array is refused."""
    found = numbers_at(whole, path)
    if len(found) != 1:
        raise SceneError(f"{path!r} is {len(found)} numbers; name one, e.g. {found[0].name!r}")
    return found[0]


def _letters(shape: tuple[int, ...]) -> Callable[[int], str]:
    return (lambda i: "xyz"[i]) if shape == (3,) else str


def _follow(at: Any, steps: tuple[str, ...]) -> Any:
    for step in steps:
        at = _one(at, step)
    return at


def _one(at: Any, name: str) -> Any:
    if isinstance(at, (tuple, list)):
        return at[int(name)]
    return at[name] if isinstance(at, Mapping) else getattr(at, name)


def _has_names(at: Any) -> bool:
    return isinstance(at, (Mapping, tuple, list)) or (dataclasses.is_dataclass(at) and not isinstance(at, type))


def _names_of(at: Any) -> list[str]:
    if isinstance(at, Mapping):
        return [str(name) for name in at]
    if isinstance(at, (tuple, list)):
        return [str(i) for i in range(len(at))]
    if dataclasses.is_dataclass(at) and not isinstance(at, type):
        return [field.name for field in dataclasses.fields(at) if field.name[0] != "_"]
    return []

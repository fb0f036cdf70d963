"""Numbers of a scene by path, such as `"forces.push.force.z"`, and how the numbers of a system follow them.

A path is made of attributes and names from the scene on: `joints.elbow.model.clearance`, `bodies.rocker.mass`,
`gravity.z`. The first word may be left out before the name of a body, and everything up to the model of the studied
joint, where one is known: there `rocker.mass` and `friction.v1` say the same. So may a part in between where one alone
has what follows, as a law in front of its own number. An entry of an array is `.x`, `.y`, `.z` of three, else its
index: `.0`, of a matrix `.0.1`.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.errors import SceneError, one_of
from spherejax.model.scene import Scene
from spherejax.model.system import Structure, System, example_of

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

    @property
    def part(self) -> str:
        """The part that it belongs to, such as `joints.elbow`, or `gravity`, which has no name of its own."""
        return ".".join(self.steps[: 2 if self.steps[0] in ("bodies", "joints", "forces") else 1])

    def value(self, whole: Scene | System) -> float:
        """Its value."""
        return float(np.asarray(part_at(whole, self.steps), np.float64)[self.index])

    def size(self, whole: Scene | System) -> float:
        """How large it is: the largest of the numbers that it stands among; 1 where all are zero."""
        return float(np.abs(np.asarray(part_at(whole, self.steps), np.float64)).max()) or 1.0

    def changed(self, whole: Any, value: Any) -> Any:
        """The scene or system with another value; it may be traced."""
        return with_entry(whole, self.steps, self.index, value)


class Place(NamedTuple):
    """Where a path leads.

    Attributes:
        steps: attributes and keys to a number, an array, or None where a law takes what follows from materials.
        index: entry of the array; () for all of it.
        value: what is there, the entry where there is an index.
    """

    steps: tuple[str, ...]
    index: tuple[int, ...]
    value: Any


def numbers_at(whole: Scene | System, path: str, studied: str | None = None) -> list[Number]:
    """The number at a path; of an array all its entries.

    Raises:
        SceneError: for a path that leads nowhere, or to what is no number; it names what is there.
    """
    steps, index, value = place_at(whole, path, studied)
    if value is None:
        raise SceneError(f"{path} is not given in the scene; give it a value there first")
    if index or not np.ndim(value):
        return [Number(path, steps, index)]
    letter = _letters(np.shape(value))
    entries = list(np.ndindex(np.shape(value)))
    return [Number(".".join([path, *(letter(i) for i in entry)]), steps, entry) for entry in entries]


def number_at(whole: Scene | System, path: str, studied: str | None = None) -> Number:
    """The one number at a path; as `numbers_at`, and an array is refused."""
    found = numbers_at(whole, path, studied)
    if len(found) != 1:
        raise SceneError(f"{path!r} is {len(found)} numbers; name one, e.g. {found[0].name!r}")
    return found[0]


def place_at(whole: Scene | System, path: str, studied: str | None = None) -> Place:
    """Follow a path.

    Args:
        whole: a scene, or the system of a run.
        path: the path.
        studied: the joint whose model's numbers may be named by themselves.

    Raises:
        SceneError: for a path that leads nowhere, or to what is no number; it names what is there.
    """
    if not isinstance(path, str) or not path:
        raise SceneError(f"{path!r} is no path of a number; write e.g. 'forces.push.force.z' or 'bodies.rocker.mass'")
    words, at = _in_full(whole, path.split("."), studied), whole
    steps: list[str] = []
    while words and _has_names(at):
        word = words.pop(0)
        if word not in names_of(at):
            inner = [name for name in names_of(at) if word in names_of(_one(at, name))]
            if len(inner) != 1:
                where = ".".join(steps) or "the scene"
                raise SceneError(f"{path}: {where} has no {word!r}; {one_of(names_of(at), word)}")
            words = [inner[0], word, *words]
            continue
        steps.append(word)
        at = _one(at, word)
    if at is None:
        if words:
            raise SceneError(f"{path}: {'.'.join(steps)} is not given in the scene")
        return Place(tuple(steps), (), None)
    try:
        value = at if isinstance(at, jax.Array) else np.asarray(at, np.float64)  # traced ones are JAX's
    except (TypeError, ValueError):
        known = f"; it has {', '.join(names_of(at))}" if names_of(at) else ""
        what = "a function" if callable(at) else f"a {type(at).__name__}"
        raise SceneError(f"{path} is no number but {what}{known}") from None
    index = _index(path, ".".join(steps), value, words)
    return Place(tuple(steps), index, value[index] if index else value)


def numbers_in(whole: Scene | System) -> tuple[Number, ...]:
    """All numbers of a scene or a system, in the order of its leaves."""
    numbers = []
    for keys, leaf in jax.tree_util.tree_flatten_with_path(whole)[0]:
        steps = tuple(str(getattr(key, "name", getattr(key, "key", getattr(key, "idx", key)))) for key in keys)
        letter = _letters(np.shape(leaf))
        entries = np.ndindex(np.shape(leaf))
        numbers += [Number(".".join([*steps, *map(letter, entry)]), steps, entry) for entry in entries]
    return tuple(numbers)


@lru_cache(maxsize=64)
def numbers_of(structure: Structure) -> tuple[Number, ...]:
    """Of each number of `theta`, in its order, what it is."""
    return numbers_in(example_of(structure))


NAMED = 6
"""Traced numbers of which a run's explanation says the names; of more it says the parts that they belong to."""


def in_words(numbers: Sequence[Number]) -> str:
    """Which numbers these are, in a few words; empty for none."""
    if not numbers:
        return ""
    if len(numbers) <= NAMED:
        return f"traced: {', '.join(number.name for number in numbers)}"
    parts = [*dict.fromkeys(number.part for number in numbers)]
    more = f" and {len(parts) - NAMED} more parts" if len(parts) > NAMED else ""
    return f"traced: {len(numbers)} numbers of {', '.join(parts[:NAMED])}{more}"


def full_path(whole: Scene | System, path: str, studied: str | None = None) -> str:
    """The path with nothing left out."""
    steps, index, _ = place_at(whole, path, studied)
    letter = _letters(np.shape(part_at(whole, steps))) if index else str
    return ".".join([*steps, *map(letter, index)])


def part_at(whole: Any, steps: tuple[str, ...]) -> Any:
    """What attributes and keys lead to."""
    for step in steps:
        whole = _one(whole, step)
    return whole


def with_entry(whole: Any, steps: tuple[str, ...], index: tuple[int, ...], value: Any) -> Any:
    """A scene or system with another number or array at a place; it may be traced."""
    if index:
        value = jnp.asarray(part_at(whole, steps), jnp.float64).at[index].set(value)
    return eqx.tree_at(lambda part: part_at(part, steps), whole, value, is_leaf=lambda leaf: leaf is None)


def names_of(at: Any) -> list[str]:
    """What the parts of a thing are called."""
    if isinstance(at, Mapping):
        return [str(name) for name in at]
    if isinstance(at, (tuple, list)):
        return [str(i) for i in range(len(at))]
    if dataclasses.is_dataclass(at) and not isinstance(at, type):
        return [field.name for field in dataclasses.fields(at) if field.name[0] != "_"]
    return []


def _in_full(whole: Scene | System, words: list[str], studied: str | None) -> list[str]:
    """The path from the scene's own parts on."""
    tops = names_of(whole)
    if not isinstance(whole, Scene) or words[0] in tops:
        return words
    if words[0] in whole.bodies:
        return ["bodies", *words]
    model = getattr(whole.joints.get(studied or ""), "model", None)
    known = [name for name in ("model", *names_of(model)) if model is not None]
    inside = [word for name in names_of(model) for word in names_of(getattr(model, name))]
    if words[0] in (*known, *inside):
        return ["joints", str(studied), *(() if words[0] == "model" else ("model",)), *words]
    if any(words[0] in names_of(getattr(whole, top)) for top in tops):
        return words
    wrong = f"there is no body {words[0]!r}" + (
        f", and nothing of that name in the model of {studied}" if known else ""
    )
    names = dict.fromkeys([*tops, *whole.bodies, *known, *inside])
    raise SceneError(f"{'.'.join(words)}: {wrong}; {one_of(names, words[0])}")


def _index(path: str, where: str, value: Any, words: list[str]) -> tuple[int, ...]:
    """The entry of an array that words name; () for none."""
    if not words:
        return ()
    letter = _letters(value.shape)
    index = tuple(AXES[w] if w in AXES and value.shape == (3,) else int(w) if w.isdigit() else -1 for w in words)
    if len(index) != value.ndim or any(not 0 <= i < n for i, n in zip(index, value.shape, strict=False)):
        entries = ", ".join(".".join(map(letter, entry)) for entry in np.ndindex(value.shape))
        raise SceneError(
            f"{path}: {where} is "
            + (f"numbers of shape {value.shape}; its entries are {entries}" if value.ndim else "a number by itself")
        )
    return index


def _letters(shape: tuple[int, ...]) -> Callable[[int], str]:
    return (lambda i: "xyz"[i]) if shape == (3,) else str


def _one(at: Any, name: str) -> Any:
    if isinstance(at, (tuple, list)):
        return at[int(name)]
    return at[name] if isinstance(at, Mapping) else getattr(at, name)


def _has_names(at: Any) -> bool:
    """Whether names lead on from a thing, though it may have none."""
    return isinstance(at, (Mapping, tuple, list)) or (dataclasses.is_dataclass(at) and not isinstance(at, type))

"""Numbers behind JAX's tracers: outside `jax.jit` those of `jax.jvp`, `jax.grad` and `jax.vmap` can be looked at."""

from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from spherejax.foundations.checks import is_concrete

LOOKS = (0.0, 1 / 3, 2 / 3, 1.0)
"""Which of many runs are looked at: the first, the last and two in between."""


def place_of(look: float, n: int) -> int:
    """The run, of n, that is looked at."""
    return int(look * (n - 1))


def known_behind(tree: Any) -> list[Any]:
    """The tree with the numbers that stand behind its tracers; for some of the lanes, where there are any.

    Args:
        tree: any pytree.

    Returns:
        One tree, or one for each look at the lanes; none where `jax.jit` hides a number.
    """
    leaves, structure = jax.tree.flatten(tree)
    if all(is_concrete(leaf) for leaf in leaves):
        return [tree]
    found = []
    for look in LOOKS if any(map(_is_lane, _layers(leaves))) else LOOKS[:1]:
        seen = [_seen(leaf, look) for leaf in leaves]
        if any(leaf is None for leaf in seen):
            return []
        found.append(jax.tree.unflatten(structure, seen))
    return found


def shared_behind(leaf: Any) -> np.ndarray | None:
    """The array behind tracers of `jax.vmap`, where all lanes have the same; None where they differ, or are hidden."""
    while leaf is not None and not is_concrete(leaf):
        inner = _inner(leaf) if hasattr(leaf, "batch_dim") else None
        if inner is not None and _is_lane(leaf):
            if not is_concrete(inner):
                return None
            rows = np.moveaxis(np.asarray(inner), leaf.batch_dim, 0)
            inner = rows[0] if len(rows) and np.array_equal(rows, np.broadcast_to(rows[:1], rows.shape)) else None
        leaf = inner
    return None if leaf is None else np.asarray(leaf)


# The names of these attributes are JAX's own and undocumented. Should a release drop them, numbers are hidden as under
# `jit`: the same results, by a method that was chosen without looking at them.


def _inner(leaf: Any) -> Any:
    """What the tracer stands for, one transformation further in; None where there is nothing to see."""
    # What is the same in all lanes is a tracer of `jax.vmap` without a batch axis; results of runs in `jax.jacfwd` are.
    inner = getattr(leaf, "val", None) if hasattr(leaf, "batch_dim") else getattr(leaf, "primal", None)
    return inner if isinstance(inner, jax.Array | np.ndarray | np.generic | float | int) else None


def _is_lane(leaf: Any) -> bool:
    return isinstance(getattr(leaf, "batch_dim", None), int)


def _layers(leaves: list[Any]) -> Iterator[Any]:
    """All tracers in a list, those within others included."""
    for leaf in leaves:
        while leaf is not None and not is_concrete(leaf):
            yield leaf
            leaf = _inner(leaf)


def _seen(leaf: Any, look: float) -> Any:
    while leaf is not None and not is_concrete(leaf):
        inner = _inner(leaf)
        if inner is not None and _is_lane(leaf):
            at = place_of(look, inner.shape[leaf.batch_dim])
            # To JAX each look at numbers would be a program to compile.
            is_number = is_concrete(inner)
            inner = np.take(np.asarray(inner), at, leaf.batch_dim) if is_number else _row(inner, at, leaf.batch_dim)
        leaf = inner
    return None if leaf is None else np.asarray(leaf)


def _row(tracer: Any, at: int, axis: int) -> Any:
    return jax.lax.index_in_dim(tracer, at, axis, keepdims=False)

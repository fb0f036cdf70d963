"""Arrays that are made some rows at a time, by programs of one shape, put together."""

import math
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import is_tracing

ALIGNMENT = 64
"""Bytes on whose multiples an array begins that JAX takes as it is; others it copies."""


@contextmanager
def as_numbers() -> Iterator[None]:
    """What is computed from numbers are numbers, also where something is being traced.

    Elsewhere nothing is changed: a program that is traced in `jax.ensure_compile_time_eval` has its constants made by
    small programs of their own, hundreds of them.
    """
    with jax.ensure_compile_time_eval() if is_tracing() else nullcontext():
        yield


def joined_rows(parts: Iterator[Any], n: int, shared: int = 0) -> Any:
    """The first n rows of parts one below the other.

    Args:
        parts: pytrees of arrays, all of the same shapes; one is read, and let go, before the next one is asked for.
        n: rows of the whole.
        shared: rows at the beginning of each part that stand for the last ones before it, and are left out.

    Returns:
        A pytree of JAX's arrays, in memory that nobody else writes to.
    """
    with as_numbers():
        leaves, tree = jax.tree.flatten(next(parts))
        if not leaves:
            return jax.tree.unflatten(tree, leaves)
        size = leaves[0].shape[0]
        if n <= size:
            # A few rows of a large part would keep all of it in memory: those are copied.
            rows = [np.asarray(leaf)[:n] if 2 * n > size else np.asarray(leaf)[:n].copy() for leaf in leaves]
        else:
            rows = [_room((n, *leaf.shape[1:]), leaf.dtype) for leaf in leaves]
            for at in range(0, n - shared, size - shared):
                new = shared if at else 0
                for row, leaf in zip(rows, leaves, strict=True):
                    row[at + new : at + size] = np.asarray(leaf)[new : n - at]
                leaves = leaf = None  # what the next part is written to may be their memory
                leaves = jax.tree.leaves(next(parts)) if at + size < n else []
        return jax.tree.unflatten(tree, jax.device_put(rows, may_alias=True))


def placed_rows(parts: Iterator[tuple[int, int, Any]], n: int) -> Any:
    """n rows out of parts that overlap by one: the last row of a part is the first of the next, where it is left out.

    Args:
        parts: where a part begins, how many of its rows are written, and an array of as many rows or more. What no part
            has is NaN.
        n: rows of the whole.

    Returns:
        One of JAX's arrays, in memory that nobody else writes to.
    """
    with as_numbers():
        _, end, part = next(parts)
        first, following = np.asarray(part), next(parts, None)
        if following is None and end == n and 2 * n > len(first):  # fewer rows of a part would keep all of it in memory
            return jax.device_put(first[:n], may_alias=True)
        rows = _room((n, *first.shape[1:]), first.dtype)
        rows[:end] = first[:end]
        while following is not None:
            begin, n_written, part = following
            end = begin + n_written
            rows[begin + 1 : end] = np.asarray(part)[1:n_written]
            following = next(parts, None)
        rows[end:] = np.nan
        # To copy a few rows takes half of what it takes to hand them over as they are.
        return jnp.asarray(rows) if n <= len(first) else jax.device_put(rows, may_alias=True)


def in_blocks(function: Any, fixed: tuple, size: int, *arrays: Any) -> Any:
    """A compiled function of rows, evaluated block after block: one program for any number of rows.

    Args:
        function: made by `cached_jit`, of what is fixed and as many rows of each array; its results have a row for
            each.
        fixed: its first arguments.
        size: rows of a block. The last one is filled up with its last row.
        arrays: of numbers, with a row each for all that is evaluated; one row at least.
    """
    rows = [np.asarray(array) for array in arrays]
    n = len(rows[0])
    evaluated = function.bound_but(len(rows), *fixed, *(np.zeros((size, *x.shape[1:]), x.dtype) for x in rows))

    def parts() -> Iterator[Any]:
        for at in range(0, n, size):
            blocks = [each[at : at + size] for each in rows]
            missing = size - len(blocks[0])
            if missing:
                blocks = [np.concatenate([each, np.repeat(each[-1:], missing, axis=0)]) for each in blocks]
            yield evaluated(*blocks)

    return joined_rows(parts(), n)


def _room(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    size = np.dtype(dtype).itemsize * math.prod(shape)
    room = np.empty(size + ALIGNMENT, np.uint8)
    first = -room.ctypes.data % ALIGNMENT
    return room[first : first + size].view(dtype).reshape(shape)

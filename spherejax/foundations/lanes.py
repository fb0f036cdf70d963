"""One function for many things of the same kind: bodies, joints, pairs of joints, runs, side by side as lanes."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int


def over_lanes(function: Callable, *lanes, shared: tuple = ()) -> Any:
    """`function(*shared, *lane)` for each lane.

    Args:
        function: written for one lane.
        *lanes: arguments (pytrees) whose arrays have a leading axis of lanes.

    Other args:
        shared: arguments that all lanes share, given first.

    Returns:
        The results, with a leading axis of lanes.
    """
    axes = (*(None for _ in shared), *(0 for _ in lanes))
    return jax.vmap(function, axes)(*shared, *lanes)


def in_lanes(function: Callable) -> Callable:
    """Map a function of one run over the last axis of its arguments and results, where blocks of runs have them."""
    return jax.vmap(function, in_axes=-1, out_axes=-1)


def with_rows_at(
    target: Float[Array, "n ..."], index: Int[Array, " n_lanes"], rows: Float[Array, "n_lanes ..."]
) -> Float[Array, "n ..."]:
    """`target` with `target[index[i]] = rows[i]`; an index outside of it writes nothing.

    On the CPU one row after the other: XLA (jax 0.10) compiles no loop that holds a scatter into one native function,
    and a block of lanes took a third longer for it.
    """

    def one_by_one(target, index, rows):
        rest = target.shape[1:]

        def write(i, target):
            is_there = (index[i] >= 0) & (index[i] < target.shape[0])
            at = (index[i], *(0 for _ in rest))
            old = jax.lax.dynamic_slice(target, at, (1, *rest))
            return jax.lax.dynamic_update_slice(target, jnp.where(is_there, rows[i][None], old), at)

        return jax.lax.fori_loop(0, rows.shape[0], write, target)

    def scattered(target, index, rows):
        return target.at[index].set(rows, mode="drop")

    return jax.lax.platform_dependent(target, index, rows, cpu=one_by_one, default=scattered)


def rows_at(array: Float[Array, "n ..."], index: Sequence[int] | Int[np.ndarray, " k"]) -> Float[Array, "k ..."]:
    """Rows of an array by static, non-negative numbers; a run of numbers is a slice."""
    numbers = np.asarray(index, np.int32)
    if numbers.size == 0:
        return array[:0]
    if np.array_equal(numbers, np.arange(numbers[0], numbers[0] + numbers.size)):
        return array[numbers[0] : numbers[0] + numbers.size]
    dimensions = jax.lax.GatherDimensionNumbers(tuple(range(1, array.ndim)), (0,), (0,))
    mode = jax.lax.GatherScatterMode.PROMISE_IN_BOUNDS
    return jax.lax.gather(array, numbers[:, None], dimensions, (1, *array.shape[1:]), mode=mode)


def sums_by_index(values: Float[Array, "k ..."], index: Int[np.ndarray, " k"], size: int) -> Float[Array, "size ..."]:
    """For each target the sum of the values that name it: out[i] = sum of values[j] over index[j] = i.

    Gathered in turns, the r-th value of each target in turn r, because XLA on the CPU writes scattered sums one by one.
    Targets of many values are summed in chunks first, so that the work stays proportional to the number of values.

    Args:
        values: what is summed.
        index: target of each value (static); a value with the target -1 counts nowhere.
        size: number of targets.
    """
    index = np.asarray(index)
    counts = np.bincount(index[index >= 0], minlength=size)
    if np.array_equal(index, np.arange(size)):
        return values
    if counts.max(initial=0) > LARGEST_FAN_IN:
        chunks, of_chunk = _chunked(index)
        values = sums_by_index(values, chunks, len(of_chunk))
        return sums_by_index(values, of_chunk, size)
    order = np.argsort(index, kind="stable")[np.sum(index < 0) :]
    starts = np.concatenate([[0], np.cumsum(counts)])[:-1]
    padded = jnp.concatenate([values, jnp.zeros((1, *values.shape[1:]), values.dtype)])
    nothing = len(index)
    order = np.append(order, nothing)
    total = jnp.zeros((size, *values.shape[1:]), values.dtype)
    for turn in range(counts.max(initial=0)):
        source = np.where(counts > turn, order[np.minimum(starts + turn, len(order) - 1)], nothing)
        total = total + rows_at(padded, source) if turn else rows_at(padded, source)
    return total


LARGEST_FAN_IN = 8
"""Values of one target that are summed in one go."""


def _chunked(index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Chunk of each value, with at most `LARGEST_FAN_IN` in a chunk, and the target of each chunk."""
    chunks, of_chunk = np.zeros(len(index), int), []
    seen: dict[int, tuple[int, int]] = {}
    for position, target in enumerate(index.tolist()):
        if target < 0:
            chunks[position] = -1
            continue
        chunk, filled = seen.get(target, (-1, LARGEST_FAN_IN))
        if filled == LARGEST_FAN_IN:
            chunk, filled = len(of_chunk), 0
            of_chunk.append(target)
        chunks[position] = chunk
        seen[target] = (chunk, filled + 1)
    return chunks, np.array(of_chunk, int)

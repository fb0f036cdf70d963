"""Rows of an array by static numbers, and sums of rows by static targets, without a scatter."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int


def rows_at(array: Float[Array, "n ..."], index: Sequence[int] | Int[np.ndarray, " k"]) -> Float[Array, "k ..."]:
    """Rows of an array by static, non-negative numbers; a run of numbers is a slice."""
    numbers = np.asarray(index, np.int32)
    if numbers.size == 0:
        return array[:0]
    # XLA fuses a slice with what reads it; a gather is computed for itself.
    if np.array_equal(numbers, np.arange(numbers[0], numbers[0] + numbers.size)):
        return array[numbers[0] : numbers[0] + numbers.size]
    dimensions = jax.lax.GatherDimensionNumbers(tuple(range(1, array.ndim)), (0,), (0,))
    # The numbers are known and were never negative: other modes clip or compare each of them.
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
    # Values without a target come first in this order, and are cut off.
    order = np.argsort(index, kind="stable")[np.sum(index < 0) :]
    starts = np.concatenate([[0], np.cumsum(counts)])[:-1]
    # A target that has no value left in a turn reads the row of zeros behind the last one.
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
        # A target that was not met yet counts as one with a full chunk.
        chunk, filled = seen.get(target, (-1, LARGEST_FAN_IN))
        if filled == LARGEST_FAN_IN:
            chunk, filled = len(of_chunk), 0
            of_chunk.append(target)
        chunks[position] = chunk
        seen[target] = (chunk, filled + 1)
    return chunks, np.array(of_chunk, int)

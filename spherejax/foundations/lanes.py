"""One function for many things of the same kind: bodies, joints, pairs of joints, runs, side by side as lanes."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from spherejax.foundations.linear_algebra import mapped
from spherejax.foundations.linear_algebra import rows_at as rows_at
from spherejax.foundations.linear_algebra import sums_by_index as sums_by_index


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
    return mapped(function, axes, (*shared, *lanes))


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

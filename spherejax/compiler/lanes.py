"""Arrays whose last axes are lanes, spread over more of them, summed over some, or taken one lane after the other.

A set of axes is an integer with a bit for each.
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jax import Array

from spherejax.compiler.emit.stablehlo import Shape, sizes


def widened(x: Array, axes: int, wanted: int, lanes: Shape) -> Array:
    """The same over other axes of lanes; along those that are not wanted all entries are the same.

    A vector of coefficients has all lanes of its entries.
    """
    # No operation at all: most arguments have the lanes that are wanted.
    if axes == wanted:
        return x
    n_inner = x.ndim - axes.bit_count()
    own = [axis for axis in range(len(lanes)) if axes >> axis & 1]
    # From the last axis on, so that those before it keep their places.
    for at, axis in reversed([*enumerate(own)]):
        if not wanted >> axis & 1:
            x = jax.lax.index_in_dim(x, 0, n_inner + at, keepdims=False)
    # From here on only axes are left that are wanted, and those that are missing are added.
    axes &= wanted
    among = [axis for axis in range(len(lanes)) if wanted >> axis & 1]
    dims = [*range(n_inner), *(n_inner + at for at, axis in enumerate(among) if axes >> axis & 1)]
    return jax.lax.broadcast_in_dim(x, (*x.shape[:n_inner], *sizes(lanes, wanted)), dims)


def in_first_lanes(x: Array, axes: int, wanted: int, lanes: Shape) -> Array:
    """The same over more axes of lanes: in the first lane of these, with zeros in the others."""
    if axes == wanted:
        return x
    n_inner = x.ndim - axes.bit_count()
    among = [(axis, n) for axis, n in enumerate(lanes) if wanted >> axis & 1]
    new = [n_inner + at for at, (axis, _) in enumerate(among) if not axes >> axis & 1]
    padding = [(0, 0, 0)] * n_inner + [(0, 0 if axes >> axis & 1 else n - 1, 0) for axis, n in among]
    # A pad is one operation, and its transpose takes the first lane again.
    return jax.lax.pad(jnp.expand_dims(x, new), jnp.zeros((), x.dtype), padding)


def narrowed(x: Array, axes: int, wanted: int) -> Array:
    """The sum over the axes of lanes that are not wanted."""
    n_inner = x.ndim - axes.bit_count()
    among = [axis for axis in range(axes.bit_length()) if axes >> axis & 1]
    return jnp.sum(x, [n_inner + at for at, axis in enumerate(among) if not wanted >> axis & 1])


def by_a_loop(call: Callable[..., Sequence[Array]], arguments: Sequence, dims: Sequence) -> tuple[Sequence, Sequence]:
    """The results of a call, and their new axes, for each place of a new axis in turn.

    Args:
        call: what is called, on the axes of lanes that are there.
        arguments, dims: those of the batching rule.
    """
    # None has no entries to map over: `jax.lax.map` leaves it as it is, and what is shared is not copied.
    moved = [None if dim is None else jnp.moveaxis(x, dim, 0) for x, dim in zip(arguments, dims, strict=True)]

    def one(parts: Sequence) -> list[Array]:
        return [*call(*(x if part is None else part for x, part in zip(arguments, parts, strict=True)))]

    # A loop of XLA's and not a longer vector: the call has one axis of lanes, and its text is the same for every
    # length.
    results = jax.lax.map(one, moved)
    return results, [0] * len(results)


def inside_a_loop(
    call: Callable[..., Sequence[Array]],
    arguments: Sequence,
    dims: Sequence,
    axes: Sequence[int],
    was: Sequence[int],
    now: Sequence[int],
) -> tuple[Sequence, Sequence]:
    """As `by_a_loop`, for a new axis that is longer than the only one there is: the loop goes over that one.

    Args:
        call: what is called, with the new axis as its only one.
        arguments, dims: those of the batching rule.
        axes: of the arguments, without the new one.
        was, now: of the results, before and with the new axis alone.
    """
    turned = [x if dim is None else jnp.moveaxis(x, dim, -1) for x, dim in zip(arguments, dims, strict=True)]
    # The new axis goes last, where the operation wants its lanes; the old one goes first, where `map` takes it.
    new = [int(dim is not None) for dim in dims]
    rows = [jnp.moveaxis(x, -1 - last, 0) if over else None for x, over, last in zip(turned, axes, new, strict=True)]

    def one(parts: Sequence) -> list[Array]:
        return [*call(*(x if part is None else part for x, part in zip(turned, parts, strict=True)))]

    results = [
        jnp.moveaxis(x, 0, -1 - last) if over else x[0]
        for x, over, last in zip(jax.lax.map(one, rows), was, now, strict=True)
    ]
    return results, [x.ndim - 1 if last else None for x, last in zip(results, now, strict=True)]

"""Arrays whose last axes are lanes, spread over more of them or summed over some; a set of axes is an integer."""

import jax
import jax.numpy as jnp
from jax import Array

from spherejax.foundations.line_writer import Shape, sizes


def widened(x: Array, axes: int, wanted: int, lanes: Shape) -> Array:
    """The same over other axes of lanes; along those that are not wanted all entries are the same.

    A vector of coefficients has all lanes of its entries.
    """
    if axes == wanted:
        return x
    n_inner = x.ndim - axes.bit_count()
    own = [axis for axis in range(len(lanes)) if axes >> axis & 1]
    for at, axis in reversed([*enumerate(own)]):
        if not wanted >> axis & 1:
            x = jax.lax.index_in_dim(x, 0, n_inner + at, keepdims=False)
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
    return jax.lax.pad(jnp.expand_dims(x, new), jnp.zeros((), x.dtype), padding)


def narrowed(x: Array, axes: int, wanted: int) -> Array:
    """The sum over the axes of lanes that are not wanted."""
    n_inner = x.ndim - axes.bit_count()
    among = [axis for axis in range(axes.bit_length()) if axes >> axis & 1]
    return jnp.sum(x, [n_inner + at for at, axis in enumerate(among) if not wanted >> axis & 1])

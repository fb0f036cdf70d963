"""A function of one thing, mapped over all things of its kind."""

import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp

from spherejax.compiler.graph import NotScalarizable

_state = threading.local()

LARGEST_MAPPED = 5_000
"""Scalar operations of a function of one thing, at most; of a larger one the mapped array code is kept. The largest of
a chain's has 300."""


@contextmanager
def scalar_programs(scalarize: Callable | None) -> Iterator[None]:
    """What `mapped` traces in this context are scalar programs over lanes, made by `scalarize`; None for array code."""
    # Handed in: who makes scalar programs imports this package.
    before, _state.scalarize = getattr(_state, "scalarize", None), scalarize
    try:
        yield
    finally:
        _state.scalarize = before


def mapped(function: Callable, axes: Sequence[int | None], arguments: Sequence[Any]) -> Any:
    """`jax.vmap(function, axes)(*arguments)`; in array code that becomes machine code, a scalar program over lanes.

    A function for which there is no scalar program (it closes over traced values, it takes other numbers than floats,
    an operation has no rule, it is too large) is mapped as array code there, too.

    Args:
        function: of one thing.
        axes: of each argument None, where all things share it, or 0, where its arrays have a leading axis of things.
        arguments: pytrees.
    """
    whole = jax.vmap(function, axes)
    scalarize = getattr(_state, "scalarize", None)
    if scalarize is None:
        return whole(*arguments)
    leaves, tree = jax.tree.flatten(tuple(arguments))
    own = [axis is not None for axis, each in zip(axes, arguments, strict=True) for _ in jax.tree.leaves(each)]
    arrays = [jnp.asarray(leaf) for leaf in leaves]
    examples = [
        jax.ShapeDtypeStruct(x.shape[1:] if one else x.shape, x.dtype) for x, one in zip(arrays, own, strict=True)
    ]

    def of_one(*numbers: Any) -> Any:
        return function(*jax.tree.unflatten(tree, numbers))

    try:
        if any(x.dtype != jnp.float64 for x in arrays):
            raise NotScalarizable("other numbers than floats are mapped")
        with scalar_programs(None):
            program = scalarize(of_one, *examples, n_ahead=0, maximum_operations=LARGEST_MAPPED)
    except NotScalarizable as reason:
        logging.getLogger(__name__).info("%r is mapped as array code: %s", function, reason)
        return whole(*arguments)
    return jax.vmap(program, [0 if one else None for one in own])(*arrays)

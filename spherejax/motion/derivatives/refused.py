"""Numbers by which there is no derivative: to differentiate by them is an error, not a zero."""

from functools import partial
from typing import Any

import jax
from jax.custom_derivatives import SymbolicZero

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError


def without_derivative(tree: Any, reason: str) -> Any:
    """The same arrays; whoever differentiates by them, in forward or in reverse mode, gets a `SceneError`.

    `jax.lax.stop_gradient` would make every derivative by them a zero that nobody notices. What is known stays known:
    there is no derivative by it, and within `jax.jit` it would become a tracer.

    Args:
        tree: a pytree of arrays.
        reason: what the error says: why there is none, and what to do.
    """
    leaves, structure = jax.tree.flatten(tree)
    traced = [i for i, leaf in enumerate(leaves) if not is_concrete(leaf)]
    for i, leaf in zip(traced, _refusing(reason, [leaves[i] for i in traced]), strict=True):
        leaves[i] = leaf
    return jax.tree.unflatten(structure, leaves)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _refusing(reason: str, tree: Any) -> Any:
    del reason
    return tree


def _refuse(reason: str, primals: tuple, tangents: tuple) -> tuple:
    if any(not isinstance(tangent, SymbolicZero) for tangent in jax.tree.leaves(tangents, is_leaf=_is_zero)):
        raise SceneError(reason)
    return primals[0], tangents[0]


def _is_zero(leaf: Any) -> bool:
    return isinstance(leaf, SymbolicZero)


_refusing.defjvp(_refuse, symbolic_zeros=True)

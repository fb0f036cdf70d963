"""Objects of many fields, made again with other leaves."""

import itertools
from collections.abc import Callable
from typing import Any

import jax

KNOWN = 8
"""Structures of arguments that are remembered, the last ones."""


class _Mark:
    """Stands for a leaf of the arguments of `again`."""

    __slots__ = ("place",)

    def __init__(self, place: int):
        self.place = place


def again(make: Callable[..., Any]) -> Callable[..., Any]:
    """A function that puts leaves of its arguments into a pytree, remembered: from its third call on the leaves go
    straight to their places, where making an object of many fields costs more than all that is in them.

    Args:
        make: puts leaves of its arguments in places that do not depend on their values. Of one that has other leaves as
            well nothing is remembered.
    """
    known: list = []
    calls = itertools.count()

    def made(*arguments: Any) -> Any:
        if next(calls) == 0:  # most are called once
            return make(*arguments)
        leaves, structure = jax.tree.flatten(arguments)
        for places, tree, of in known:
            if of == structure:
                return jax.tree.unflatten(tree, [leaves[place] for place in places])
        # Marks take the places of the leaves; what is static is the same for all.
        marks = map(_Mark, range(len(leaves)))
        found, tree = jax.tree.flatten(make(*jax.tree.unflatten(structure, marks)))
        if all(isinstance(leaf, _Mark) for leaf in found):
            known[:] = [([mark.place for mark in found], tree, structure), *known[: KNOWN - 1]]
        return make(*arguments)

    return made

"""Numbers that a function only picks out of a system: found once for a structure, then read off its vector at once.

A system of marks goes through the function. What comes out are marks, in the places of the numbers that it picks, and
constants. Whoever computes with a mark, compares it or asks for its truth, gets an error: of such a function nothing is
known beyond the one system.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.forms import is_numeric
from spherejax.foundations.linear_algebra import rows_at
from spherejax.model.system import Structure, System, is_own


class _Number:
    """Stands for a number or an array of a system; it can be handed on, and nothing else."""

    __slots__ = ("place",)

    def __init__(self, place: int):
        self.place = place

    def _refuse(self, *_: Any) -> Any:
        raise TypeError("a mark is no number")

    __eq__ = __ne__ = __lt__ = __le__ = __gt__ = __ge__ = _refuse
    __bool__ = __float__ = __len__ = __iter__ = __array__ = __jax_array__ = _refuse
    __hash__ = object.__hash__


class Picked:
    """What a function picks out of systems of one structure.

    Attributes:
        tree, shapes: of what it returns.
    """

    def __init__(self, tree: Any, places: list[np.ndarray], constants: np.ndarray):
        self.tree, self.shapes = tree, tuple(place.shape for place in places)
        self._places, self._constants = places, constants
        self._flat = np.concatenate([np.zeros(0, int), *(place.ravel() for place in places)])

    def flat(self, theta: np.ndarray, without: tuple[int, ...] = ()) -> np.ndarray:
        """The numbers, one after the other, from those of the system; without some of these."""
        numbers = np.concatenate([theta, self._constants]) if self._constants.size else theta
        return numbers[self._flat[~np.isin(self._flat, without)]] if without else numbers[self._flat]

    @property
    def has_constants(self) -> bool:
        """Whether the function returns numbers of its own as well."""
        return bool(self._constants.size)

    def within(self, theta: Float[Array, " p"]) -> Float[Array, " k"]:
        """`flat` within a trace: one operation, however many numbers there are."""
        return rows_at(jnp.concatenate([theta, self._constants]) if self.has_constants else theta, self._flat)

    def has_any(self, indices: tuple[int, ...]) -> bool:
        """Whether some of these numbers of a system are among them."""
        return bool(indices) and bool(np.isin(self._flat, indices).any())

    def among(self, n: int) -> np.ndarray:
        """Which of n numbers of a system are picked."""
        is_picked = np.zeros(n, bool)
        is_picked[self._flat[self._flat < n]] = True
        return is_picked


def places_of_leaves(
    function: Callable[[Any], Any], tree: Any, leaves: list, among: Sequence[int]
) -> tuple[Any, list[list[int]]] | None:
    """The structure of what a function returns, and for each of some leaves of its argument the places where it stands
    among the leaves of that; None where the function does more with these leaves than to hand them on.

    Args:
        function: of this package's code alone.
        tree, leaves: its argument, taken apart.
        among: places of these leaves.
    """
    marked = list(leaves)
    for i in among:
        marked[i] = _Number(i)
    try:
        returned, made = jax.tree.flatten(function(jax.tree.unflatten(tree, marked)))
    except Exception:  # it asks for more than a mark can answer
        return None
    return made, [[at for at, leaf in enumerate(returned) if leaf is marked[i]] for i in among]


def picked(function: Callable[[System], Any], structure: Structure) -> Picked | None:
    """What a function picks; None for one that does more than that, and where user code may say what it does."""
    if structure.code or not is_own(structure.tree):
        return None
    sizes = [int(np.prod(shape)) for shape in structure.shapes]
    starts = np.cumsum([0, *sizes])
    marks = [_Number(place) for place in range(len(sizes))]
    try:
        leaves, tree = jax.tree.flatten(function(jax.tree.unflatten(structure.tree, marks)))
    except Exception:  # it asks for more than a mark can answer
        return None
    places, constants = [], []
    for leaf in leaves:
        if isinstance(leaf, _Number):
            first, last = starts[leaf.place], starts[leaf.place + 1]
            places.append(np.arange(first, last).reshape(structure.shapes[leaf.place]))
        elif is_numeric(leaf) and not isinstance(leaf, jax.core.Tracer):
            value = np.asarray(leaf, np.float64)
            first = starts[-1] + sum(map(np.size, constants))
            places.append(first + np.arange(value.size).reshape(value.shape))
            constants.append(value.ravel())
        else:
            return None
    return Picked(tree, places, np.concatenate([np.zeros(0), *constants]))

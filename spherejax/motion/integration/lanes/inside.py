"""States inside a step of an explicit Runge-Kutta method, from the stages that it has evaluated anyway.

A state at the fraction x of a step is y(x) = y + sum_i b_i(x) k_i, with k_i = h f at stage i and polynomials b_i that
satisfy, as far as the stages allow, the order conditions of an extension of the method: for all rooted trees tau of up
to p nodes

    sum_i b_i(x) Phi_i(tau) = x^|tau| / gamma(tau).

That is linear in the coefficients of b_i. Their smallest solution is taken, and a term x^(p+1) that no condition sees
makes the end of the step y(1) that of the method. p is 5 for the methods of order 8 and 4 for those of order 5.

Source: Hairer, Norsett, Wanner (1993), Solving Ordinary Differential Equations I, II.2 and II.6.
"""

from functools import lru_cache
from math import prod

import numpy as np

Tree = tuple

_HIGHEST_ORDER = 6
_SOLVED = 1e-10


def extension(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Coefficients of the polynomials b_i: b_i(x) = sum_m c[i, m] x^(m+1).

    Args:
        a: coefficients of the stages, lower triangular, shape (n, n).
        b: weights of the step, shape (n,).

    Returns:
        Of shape (n, p + 1), with p the highest order for which the conditions can be satisfied.
    """
    by_used_stages, by_all_stages = _smallest(a, np.flatnonzero(b)), _smallest(a, np.arange(len(b)))
    # Stages without a weight in the step are left out where the others do as well: each costs a look at its increments.
    found = by_used_stages if by_used_stages.shape == by_all_stages.shape else by_all_stages
    return np.column_stack([found, b - found.sum(axis=1)])


def _smallest(a: np.ndarray, stages: np.ndarray) -> np.ndarray:
    """The smallest coefficients of some stages, of the highest order that they allow."""
    found = np.zeros((len(a), 0))
    for order in range(1, _HIGHEST_ORDER + 1):
        trees = [tree for size in range(1, order + 1) for tree in trees_of(size)]
        conditions = np.array([_stage_weights(tree, a)[stages] for tree in trees])
        wanted = np.array([[(_size(tree) == m + 1) / _density(tree) for m in range(order)] for tree in trees])
        coefficients = np.linalg.lstsq(conditions, wanted, rcond=1e-11)[0]
        if np.abs(conditions @ coefficients - wanted).max() > _SOLVED:
            break
        found = np.zeros((len(a), order))
        found[stages] = coefficients
    return found


@lru_cache(maxsize=16)
def trees_of(size: int) -> list[Tree]:
    """All rooted trees with this many nodes; a tree is the sorted tuple of the trees at its root."""
    return sorted(set(_forests(size - 1, size - 1)))


def _forests(size: int, largest: int):
    """Sorted tuples of trees with this many nodes together, none larger than `largest`."""
    if size == 0:
        yield ()
    for first in range(min(size, largest), 0, -1):
        for tree in trees_of(first):
            for rest in _forests(size - first, first):
                yield tuple(sorted((tree, *rest)))


def _size(tree: Tree) -> int:
    return 1 + sum(_size(branch) for branch in tree)


def _density(tree: Tree) -> int:
    return _size(tree) * prod(_density(branch) for branch in tree)


def _stage_weights(tree: Tree, a: np.ndarray) -> np.ndarray:
    weights = np.ones(len(a))
    for branch in tree:
        weights = weights * (a @ _stage_weights(branch, a))
    return weights

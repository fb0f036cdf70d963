"""Eigenvalues of a state matrix with its zero ones set apart, and left and right vectors of the others.

A mechanism that can move as a rigid body, or that nothing holds, has pairs of zero eigenvalues with a single vector:
computed as they stand, rounding splits them to +-1e-8 of the fastest rate, among which slow modes are lost. They are
taken out first, by the staircase: an orthonormal basis [Q0, Q1] whose first part spans the null space makes A block
triangular, [0, *; 0, A1], and so on with A1 until nothing is left in the null space. Ranks are judged by singular
values after balancing. Balancing makes small entries count, and so what rounding has left of forces that cancel must be
taken for nothing before.
"""

from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Complex, Float

RANK = 1e-12
"""Singular values below this share of the largest are zero, after balancing."""


class Eigen(NamedTuple):
    """Eigenvalues and vectors.

    Attributes:
        n_zero: how many eigenvalues are zero.
        values: the others, shape (k,).
        right: their right vectors as columns, shape (n, k).
        left: their left vectors as columns, w^H A = lambda w^H, with w^H v = 1; shape (n, k).
        condition: |w| |v| of each: how much more than itself a change of A moves the eigenvalue at most.
    """

    n_zero: int
    values: Complex[np.ndarray, " k"]
    right: Complex[np.ndarray, "n k"]
    left: Complex[np.ndarray, "n k"]
    condition: Float[np.ndarray, " k"]


def eigen(A: Float[np.ndarray, "n n"], rounding: Float[np.ndarray, "n n"] | float = 0.0) -> Eigen:
    """Eigenvalues and vectors of a state matrix.

    Args:
        A: state matrix.
        rounding: entries that are no larger than this are zero.
    """
    A = np.where(np.abs(A) > rounding, A, 0.0)
    n = len(A)
    if not n:
        none = np.zeros((0, 0), complex)
        return Eigen(0, np.zeros(0, complex), none, none, np.zeros(0))
    balanced, scaling = (np.asarray(each) for each in scipy.linalg.matrix_balance(A, permute=False))
    largest = np.linalg.norm(balanced, 2)
    basis, rest = np.eye(n), balanced
    n_zero = 0
    while len(rest):
        _, sizes, right = np.linalg.svd(rest)
        rank = int(np.sum(sizes > RANK * largest))
        if rank == len(rest):
            break
        turn = np.concatenate([right[rank:], right[:rank]]).T
        basis[:, n_zero:] = basis[:, n_zero:] @ turn
        turned = turn.T @ rest @ turn
        zeros = len(rest) - rank
        n_zero, rest = n_zero + zeros, turned[zeros:, zeros:]
    none = np.zeros((0, 0))
    found: Any = scipy.linalg.eig(rest, left=True) if len(rest) else (np.zeros(0), none, none)
    values, left, right = found
    # The whole is block triangular in the new basis: above a right vector of the rest stands what it asks for.
    whole = basis.T @ balanced @ basis
    above = np.zeros((n_zero, len(rest)), complex)
    for k, value in enumerate(values):
        shifted = whole[:n_zero, :n_zero] - value * np.eye(n_zero)
        above[:, k] = -np.linalg.solve(shifted, whole[:n_zero, n_zero:] @ right[:, k]) if n_zero else 0.0
    right = scaling @ basis @ np.concatenate([above, right])
    left = np.linalg.solve(scaling.T, basis @ np.concatenate([np.zeros_like(above), left]))
    right = right / np.linalg.norm(right, axis=0)
    products = np.sum(left.conj() * right, axis=0)
    products = np.where(np.abs(products) > 0, products, 1e-300)
    left = left / products.conj()
    condition = np.linalg.norm(left, axis=0)
    return Eigen(n_zero, np.asarray(values, complex), right, left, condition)

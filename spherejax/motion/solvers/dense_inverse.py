"""The inverse of a small dense matrix in plain array code, and a solve whose derivatives never see a pivot.

Where one matrix serves many right-hand sides one after the other, as in the stages of a Rosenbrock method, a product
with the inverse is several times faster than two triangular substitutions, whose loops wait for every entry. The
forward error of such a solution is of the same size; its residual may be larger for an ill-conditioned matrix.

Gauss-Jordan elimination with partial pivoting, in place (N. J. Higham, "Accuracy and Stability of Numerical
Algorithms", 2nd edition, section 14.4). LAPACK would keep XLA on a CPU from compiling the time loop around it into
one native function.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from spherejax.foundations.types import Flag


class Inverse(NamedTuple):
    """The inverse of an (n, n) matrix.

    Attributes:
        matrix: the inverse.
        regular: whether every pivot was finite and not zero; if not, the matrix is finite and meaningless.
    """

    matrix: Float[Array, "n n"]
    regular: Flag


def invert(matrix: Float[Array, "n n"]) -> Inverse:
    """The inverse with partial pivoting. Not meant to be differentiated: see `inverse_solver`."""
    n = matrix.shape[0]
    index = jnp.arange(n)

    def eliminate(k: Int[Array, ""], carry):
        # Rows 0..k-1 hold finished rows of the inverse of the row-permuted matrix; `order` is that permutation.
        A, order, regular = carry
        p = jnp.argmax(jnp.where(index >= k, jnp.abs(A[:, k]), -1.0))
        row_k, row_p = A[k], A[p]
        A = A.at[p].set(row_k)
        order_k, order_p = order[k], order[p]
        order = order.at[p].set(order_k).at[k].set(order_p)
        pivot = row_p[k]
        usable = jnp.isfinite(pivot) & (pivot != 0.0)
        scale = 1 / jnp.where(usable, pivot, 1.0)
        row = jnp.where(index == k, 1.0, row_p) * scale
        column = jnp.where(index == k, 0.0, A[:, k])
        A = jnp.where(index == k, 0.0, A) - column[:, None] * row
        return A.at[k].set(row), order, regular & usable

    A, order, regular = lax.fori_loop(0, n, eliminate, (matrix, index, jnp.array(True)))
    return Inverse(jnp.zeros_like(A).at[:, order].set(A), regular)


def inverse_solver(
    matrix: Float[Array, "n n"],
) -> tuple[Callable[[Float[Array, " n"]], Float[Array, " n"]], Flag]:
    """A function that solves A x = rhs for many right-hand sides by the inverse, and whether A is regular.

    The derivative is that of the solution, A dx = d rhs - dA x, with the same inverse (forward) or its transpose
    (reverse); the elimination itself is not differentiated.

    Limits:
        A singular: the flag is False, the solution is finite and meaningless. The caller must discard it.
    """
    inverse = invert(lax.stop_gradient(matrix))

    def solve(rhs: Float[Array, " n"]) -> Float[Array, " n"]:
        return lax.custom_linear_solve(
            lambda x: times(matrix, x),
            rhs,
            solve=lambda _, b: times(inverse.matrix, b),
            transpose_solve=lambda _, b: times(inverse.matrix.T, b),
        )

    return solve, inverse.regular


def times(matrix: Float[Array, "n m"], vector: Float[Array, " m"]) -> Float[Array, " n"]:
    """A x without a `dot`, which could keep the time loop from being one function."""
    return jnp.sum(matrix * vector, axis=1)

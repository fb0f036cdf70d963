"""LU factors of a small dense matrix in plain array code, and a solve whose derivatives never see a pivot.

A call of LAPACK costs more than the factors of a matrix of this size (3 to 60 rows), and it keeps XLA on a
CPU from compiling the time loop around it into one native function. So the elimination is a loop over
columns, each a masked update of the whole matrix, and the substitutions are loops over columns too.

With row interchanges P (partial pivoting), P A = L U, L unit lower and U upper triangular (G. H. Golub, C.
F. Van Loan, "Matrix Computations", 4th edition, algorithm 3.4.1).
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from spherejax.foundations.types import Flag


class LUFactors(NamedTuple):
    """P A = L U of an (n, n) matrix A."""

    triangles: Float[Array, "n n"]
    """U on and above the diagonal, L below it."""
    row_order: Int[Array, " n"]
    """Row i of P A is row `row_order[i]` of A."""
    regular: Flag
    """Whether every pivot was finite and not zero. Other pivots are set to one: the factors are then not
    those of A, but finite if A is."""


def lu_factor(matrix: Float[Array, "n n"]) -> LUFactors:
    """The LU factors with partial pivoting. Not meant to be differentiated: see `dense_solver`."""
    n = matrix.shape[0]
    index = jnp.arange(n)

    def eliminate(k: Int[Array, ""], factors: LUFactors) -> LUFactors:
        A, order, regular = factors
        below = index > k
        p = jnp.argmax(jnp.where(index >= k, jnp.abs(A[:, k]), -1.0))
        row_k, row_p = A[k], A[p]
        usable = jnp.isfinite(row_p[k]) & (row_p[k] != 0.0)
        row_p = row_p.at[k].set(jnp.where(usable, row_p[k], 1.0))
        A = A.at[p].set(row_k).at[k].set(row_p)
        order = order.at[p].set(order[k]).at[k].set(order[p])
        column = A[:, k]
        multipliers = jnp.where(below, column / row_p[k], 0.0)
        A = A - multipliers[:, None] * jnp.where(below, row_p, 0.0)
        A = A.at[:, k].set(jnp.where(below, multipliers, column))
        return LUFactors(A, order, regular & usable)

    return lax.fori_loop(0, n, eliminate, LUFactors(matrix, index, jnp.array(True)))


def lu_solve(factors: LUFactors, rhs: Float[Array, " n"]) -> Float[Array, " n"]:
    """The solution x of A x = rhs."""
    triangles, order, _ = factors
    return _backward(triangles, _forward(triangles, rhs[order], None), jnp.diagonal(triangles))


def lu_solve_transposed(factors: LUFactors, rhs: Float[Array, " n"]) -> Float[Array, " n"]:
    """The solution x of A^T x = rhs, where A^T = U^T L^T P."""
    triangles, order, _ = factors
    x = _backward(triangles.T, _forward(triangles.T, rhs, jnp.diagonal(triangles)), None)
    return jnp.zeros_like(x).at[order].set(x)


def dense_solver(
    matrix: Float[Array, "n n"],
) -> tuple[Callable[[Float[Array, " n"]], Float[Array, " n"]], Flag]:
    """A function that solves A x = rhs for many right-hand sides, and whether A is regular.

    The derivative is that of the solution, A dx = d rhs - dA x, solved with the same factors (forward) or
    their transposes (reverse); the elimination itself is not differentiated.

    Limits:
        A singular: the flag is False, the solution is finite and meaningless. The caller must discard it.
    """
    factors = lu_factor(lax.stop_gradient(matrix))

    def multiply(x: Float[Array, " n"]) -> Float[Array, " n"]:
        return jnp.sum(matrix * x, axis=1)

    def solve(rhs: Float[Array, " n"]) -> Float[Array, " n"]:
        return lax.custom_linear_solve(
            multiply,
            rhs,
            solve=lambda _, b: lu_solve(factors, b),
            transpose_solve=lambda _, b: lu_solve_transposed(factors, b),
        )

    return solve, factors.regular


def _forward(
    lower: Float[Array, "n n"], rhs: Float[Array, " n"], diagonal: Float[Array, " n"] | None
) -> Float[Array, " n"]:
    """Forward substitution with the part of `lower` below the diagonal, and `diagonal` (None: ones) on it."""
    n = rhs.shape[0]
    index = jnp.arange(n)
    return lax.fori_loop(0, n, lambda k, x: _substitute(lower, x, diagonal, k, index > k), rhs)


def _backward(
    upper: Float[Array, "n n"], rhs: Float[Array, " n"], diagonal: Float[Array, " n"] | None
) -> Float[Array, " n"]:
    """Backward substitution with the part of `upper` above the diagonal and `diagonal` (None: ones) on it."""
    n = rhs.shape[0]
    index = jnp.arange(n)

    def step(j: Int[Array, ""], x: Float[Array, " n"]) -> Float[Array, " n"]:
        k = n - 1 - j
        return _substitute(upper, x, diagonal, k, index < k)

    return lax.fori_loop(0, n, step, rhs)


def _substitute(
    triangle: Float[Array, "n n"],
    x: Float[Array, " n"],
    diagonal: Float[Array, " n"] | None,
    k: Int[Array, ""],
    remaining: Bool[Array, " n"],
) -> Float[Array, " n"]:
    """Solve for unknown k and take it out of the `remaining` equations."""
    x_k = x[k] if diagonal is None else x[k] / diagonal[k]
    reduced = jnp.where(remaining, x - triangle[:, k] * x_k, x)
    return jnp.where(jnp.arange(x.shape[0]) == k, x_k, reduced)

"""Solve S X = B for a symmetric positive semi-definite S, as one named operation.

Being a JAX primitive of its own, the solve has one derivative rule (never through the factorization), one batching
rule, and a name by which `spherejax.compiler.program` recognizes it and replaces it by an unrolled sparse
elimination. As array code it is the same elimination, L D L^T, in a loop.
"""

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

symmetric_solve_p = Primitive("symmetric_solve")

REDUNDANT_PIVOT = 1e-12
"""A row whose pivot is below this, relative to the row's diagonal entry, depends on the rows before it.

For rows that repeat others rounding leaves pivots of 1e-16 to 4e-13 (planar loops of revolutes); independent rows
keep 3e-4 and more there, and 1e-10 in a mechanism of 1e-6 kg beside 1e3 kg.
"""

SINGULAR_PIVOT = 1e-7
"""The same bound where masses and moments are alike: it also leaves out rows that become dependent for an instant.

At an angle d from a singular configuration such a row keeps a pivot of the order of d^2. A rounding error r of the
positions then disturbs the velocities by r / d^2 and the accelerations by r / d^3, so that a controller which resolves
them takes ever smaller steps and never passes (the N-four-bar at rtol 1e-9, caught at d = 1e-4). Left out, the row does
not hold for the time that d takes to pass; what the velocity gains meanwhile is orthogonal to the motions that the
constraints allow, and the next correction removes it. Larger bounds gain more: at 1e-7 the N-four-bar errs by 1e-7 m.
"""


def symmetric_solve(
    matrix: Float[Array, "*batch n n"],
    right_side: Float[Array, "*batch n m"] | Float[Array, "*batch n"],
    smallest_pivot: float = REDUNDANT_PIVOT,
) -> Float[Array, "..."]:
    """Solution X of S X = B with S symmetric positive semi-definite.

    Equations that depend on others (redundant constraints) are left out: their unknowns are 0, and X solves all
    equations where B is consistent. With independent equations nothing is left out. L D L^T without exchanges needs
    no other rule: for such matrices it is stable whatever the order of the rows.

    Args:
        matrix: S, shape (..., n, n); only symmetric values are meaningful.
        right_side: B, shape (..., n, m), or (..., n) for one right-hand side.
        smallest_pivot: an equation whose pivot is below this part of its diagonal entry counts as dependent (static).

    Returns:
        X, of the shape of `right_side`. For n = 0 an empty array.

    Limits:
        Not finite where an entry of S or B is not, or where a diagonal entry of S is negative. Which equations are left
        out may change along a path of matrices whose rank changes; X then jumps, but not S X.
    """
    if matrix.shape[-1] == 0:
        return right_side
    if right_side.ndim == matrix.ndim - 1:
        return symmetric_solve_p.bind(matrix, right_side[..., None], smallest_pivot=smallest_pivot)[..., 0]
    return symmetric_solve_p.bind(matrix, right_side, smallest_pivot=smallest_pivot)


def _by_elimination(matrix, right_side, *, smallest_pivot):
    """L D L^T in a loop: after step j, rows and columns up to j are eliminated, and x carries L^-1 B."""
    diagonal = jnp.diagonal(matrix, axis1=-2, axis2=-1)
    n = matrix.shape[-1]
    index = jnp.arange(n)

    def eliminate(j, carry):
        s, x, lower, inverse_pivots = carry
        # The diagonal as it came is the scale of a pivot: what is left of it after elimination has lost it.
        column = s[..., :, j]
        pivot, smallest = column[..., j], smallest_pivot * diagonal[..., j]
        inverse = jnp.where(pivot <= smallest, 0.0, 1.0 / jnp.where(pivot <= smallest, 1.0, pivot))
        # Over the whole column, with zeros above: the loop has the same shapes in each turn.
        factors = jnp.where(index > j, column * inverse[..., None], 0.0)
        s = s - factors[..., :, None] * column[..., None, :]
        x = x - factors[..., :, None] * x[..., j, :][..., None, :]
        return s, x, lower.at[..., :, j].set(factors), inverse_pivots.at[..., j].set(inverse)

    def substitute(i, x):
        j = n - 1 - i
        below = jnp.sum(lower[..., :, j][..., None] * x, -2)  # the factors vanish down to row j
        return x.at[..., j, :].set(x[..., j, :] - below)

    # One loop for all sizes: unrolled, a matrix of 60 rows would be a program of 36,000 operations.
    start = matrix, right_side, jnp.zeros_like(matrix), jnp.zeros_like(diagonal)
    _, x, lower, inverse_pivots = jax.lax.fori_loop(0, n, eliminate, start)
    x = jax.lax.fori_loop(0, n, substitute, x * inverse_pivots[..., None])
    return jnp.where(jnp.any(diagonal < 0, -1)[..., None, None], jnp.nan, x)


def _jvp(primals, tangents, **static):
    matrix, right_side = primals
    matrix_tangent, right_tangent = tangents
    solution = symmetric_solve_p.bind(matrix, right_side, **static)
    residual = None if isinstance(right_tangent, ad.Zero) else right_tangent
    if not isinstance(matrix_tangent, ad.Zero):
        product = matrix_tangent @ solution
        residual = -product if residual is None else residual - product
    # S dX = dB - dS X, as below; without tangents nothing is solved.
    if residual is None:
        return solution, jnp.zeros_like(solution)
    return solution, symmetric_solve_p.bind(matrix, residual, **static)


def _transpose(cotangent, matrix, right_side, **static):
    del right_side  # the solve is linear in it, and S is symmetric
    if isinstance(cotangent, ad.Zero):
        return None, cotangent
    return None, symmetric_solve_p.bind(matrix, cotangent, **static)


def _batch(arguments, axes, **static):
    matrix, right_side = arguments
    matrix_axis, right_axis = axes
    if matrix_axis is None and matrix.ndim == 2 and right_side.ndim == 3:
        # One matrix, many right-hand sides: they become columns, and the factorization is done once.
        moved = jnp.moveaxis(right_side, right_axis, 2)
        columns = moved.reshape(moved.shape[0], -1)
        solution = symmetric_solve_p.bind(matrix, columns, **static)
        return solution.reshape(moved.shape), 2
    size = (matrix.shape[matrix_axis]) if matrix_axis is not None else right_side.shape[right_axis]
    matrix = batching.bdim_at_front(matrix, matrix_axis, size)
    right_side = batching.bdim_at_front(right_side, right_axis, size)
    return symmetric_solve_p.bind(matrix, right_side, **static), 0


symmetric_solve_p.def_impl(jax.jit(_by_elimination, static_argnames="smallest_pivot"))
symmetric_solve_p.def_abstract_eval(lambda matrix, right_side, **static: right_side)
mlir.register_lowering(symmetric_solve_p, mlir.lower_fun(_by_elimination, multiple_results=False))
ad.primitive_jvps[symmetric_solve_p] = _jvp
ad.primitive_transposes[symmetric_solve_p] = _transpose
batching.primitive_batchers[symmetric_solve_p] = _batch

"""Solve S X = B for a symmetric positive definite S, as one named operation.

Being a JAX primitive of its own, the solve has one derivative rule (never through the factorization), one batching
rule, and a name by which `spherejax.foundations.scalarize` recognizes it and replaces it by an unrolled sparse
elimination. As array code it is a Cholesky factorization (LAPACK on the CPU).
"""

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

symmetric_solve_p = Primitive("symmetric_solve")


def symmetric_solve(
    matrix: Float[Array, "*batch n n"], right_side: Float[Array, "*batch n m"] | Float[Array, "*batch n"]
) -> Float[Array, "..."]:
    """Solution X of S X = B with S symmetric positive definite.

    Args:
        matrix: S, shape (..., n, n); only symmetric values are meaningful.
        right_side: B, shape (..., n, m), or (..., n) for one right-hand side.

    Returns:
        X, of the shape of `right_side`. For n = 0 an empty array.

    Limits:
        Not finite where S is singular or indefinite.
    """
    if matrix.shape[-1] == 0:
        return right_side
    if right_side.ndim == matrix.ndim - 1:
        return symmetric_solve_p.bind(matrix, right_side[..., None])[..., 0]
    return symmetric_solve_p.bind(matrix, right_side)


def _by_cholesky(matrix, right_side):
    factor = jnp.linalg.cholesky(matrix, symmetrize_input=False)
    half = jax.lax.linalg.triangular_solve(factor, right_side, left_side=True, lower=True)
    return jax.lax.linalg.triangular_solve(factor, half, left_side=True, lower=True, transpose_a=True)


def _jvp(primals, tangents):
    matrix, right_side = primals
    matrix_tangent, right_tangent = tangents
    solution = symmetric_solve_p.bind(matrix, right_side)
    residual = None if isinstance(right_tangent, ad.Zero) else right_tangent
    if not isinstance(matrix_tangent, ad.Zero):
        product = matrix_tangent @ solution
        residual = -product if residual is None else residual - product
    if residual is None:
        return solution, jnp.zeros_like(solution)
    return solution, symmetric_solve_p.bind(matrix, residual)


def _transpose(cotangent, matrix, right_side):
    del right_side  # the solve is linear in it, and S is symmetric
    if isinstance(cotangent, ad.Zero):
        return None, cotangent
    return None, symmetric_solve_p.bind(matrix, cotangent)


def _batch(arguments, axes):
    matrix, right_side = arguments
    matrix_axis, right_axis = axes
    if matrix_axis is None and matrix.ndim == 2 and right_side.ndim == 3:
        # One matrix, many right-hand sides: they become columns, and the factorization is done once.
        moved = jnp.moveaxis(right_side, right_axis, 2)
        columns = moved.reshape(moved.shape[0], -1)
        solution = symmetric_solve_p.bind(matrix, columns)
        return solution.reshape(moved.shape), 2
    size = (matrix.shape[matrix_axis]) if matrix_axis is not None else right_side.shape[right_axis]
    matrix = batching.bdim_at_front(matrix, matrix_axis, size)
    right_side = batching.bdim_at_front(right_side, right_axis, size)
    return symmetric_solve_p.bind(matrix, right_side), 0


symmetric_solve_p.def_impl(jax.jit(_by_cholesky))
symmetric_solve_p.def_abstract_eval(lambda matrix, right_side: right_side)
mlir.register_lowering(symmetric_solve_p, mlir.lower_fun(_by_cholesky, multiple_results=False))
ad.primitive_jvps[symmetric_solve_p] = _jvp
ad.primitive_transposes[symmetric_solve_p] = _transpose
batching.primitive_batchers[symmetric_solve_p] = _batch

"""Solve A X = B for a general matrix A with structural zeros, as one named operation.

Being a JAX primitive of its own, the solve has one derivative rule (never through the factorization), one batching
rule, and a name by which `spherejax.compiler.program` recognizes it and replaces it by an unrolled sparse
elimination, which does not exchange rows by size. As array code it is LAPACK's factorization with partial pivoting.
"""

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

general_solve_p = Primitive("general_solve")


def general_solve(matrix: Float[Array, "*batch n n"], right_side: Float[Array, "*batch n"]) -> Float[Array, "*batch n"]:
    """Solution x of A x = b.

    Args:
        matrix: A, shape (..., n, n).
        right_side: b, shape (..., n).

    Limits:
        Not finite where A is singular. As a scalar program the rows are eliminated in an order that keeps structural
        zeros, without exchanges by size: A must be such that this is stable, as [K, D^T; D, 0] is for a K whose
        symmetric part is positive definite, and small changes of it.
    """
    return general_solve_p.bind(matrix, right_side[..., None])[..., 0]


def _by_lapack(matrix, right_side):
    return jnp.linalg.solve(matrix, right_side)


def _jvp(primals, tangents):
    matrix, right_side = primals
    matrix_tangent, right_tangent = tangents
    solution = general_solve_p.bind(matrix, right_side)
    # A dx = db - dA x: one more solve, and never a derivative of the factorization.
    residual = jnp.zeros_like(solution) if isinstance(right_tangent, ad.Zero) else right_tangent
    if not isinstance(matrix_tangent, ad.Zero):
        residual = residual - matrix_tangent @ solution
    return solution, general_solve_p.bind(matrix, residual)


def _transpose(cotangent, matrix, right_side):
    del right_side  # the solve is linear in it
    if isinstance(cotangent, ad.Zero):
        return None, cotangent
    return None, general_solve_p.bind(jnp.swapaxes(matrix, -1, -2), cotangent)


def _batch(arguments, axes):
    matrix, right_side = arguments
    sizes = [a.shape[axis] for a, axis in zip(arguments, axes, strict=True) if axis is not None]
    # LAPACK factors each system of a batch anew: a matrix that all share gains nothing by staying alone.
    matrix = batching.bdim_at_front(matrix, axes[0], sizes[0])
    right_side = batching.bdim_at_front(right_side, axes[1], sizes[0])
    return general_solve_p.bind(matrix, right_side), 0


general_solve_p.def_impl(jax.jit(_by_lapack))
general_solve_p.def_abstract_eval(lambda matrix, right_side: right_side)
mlir.register_lowering(general_solve_p, mlir.lower_fun(_by_lapack, multiple_results=False))
ad.primitive_jvps[general_solve_p] = _jvp
ad.primitive_transposes[general_solve_p] = _transpose
batching.primitive_batchers[general_solve_p] = _batch

"""Least squares with equations that hold exactly, of any rank; differentiable.

Pseudoinverses and not factorizations: redundant equations and directions that nothing determines are ordinary here, and
`jnp.linalg.pinv` has a derivative that holds wherever the rank does not change.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

RANK = 1e-9
"""Singular values below this share of the largest count as zero: rounding leaves 1e-15, mechanisms near a singular
configuration 1e-6."""


def pseudoinverse(matrix: Float[Array, "n k"]) -> Float[Array, "k n"]:
    """The pseudoinverse, with singular values below `RANK` of the largest taken for zero."""
    if 0 in matrix.shape:
        return jnp.zeros(matrix.shape[::-1])
    return jnp.linalg.pinv(matrix, rtol=RANK)


def constrained_least_squares(
    equations: Float[Array, "n k"],
    right: Float[Array, " n"],
    wishes: Float[Array, "m k"],
    values: Float[Array, " m"],
) -> Float[Array, " k"]:
    """The x with `equations` x = `right` that comes nearest to `wishes` x = `values`; the shortest one of these.

        x = A^+ b + (C P)^+ (c - C A^+ b),    P = 1 - A^+ A

    Args:
        equations: A, which holds exactly where it can, else in the least squares.
        right: b.
        wishes: C, met in the least squares; its rows have sizes of about 1.
        values: c.
    """
    inverse = pseudoinverse(equations)
    held = inverse @ equations
    base = inverse @ right
    if not wishes.shape[0]:
        return base
    # The rows of `held` are orthogonal to those of C P, and have singular values of 1: beside them what is rounding in
    # C P, where the equations leave nothing free, is seen as such.
    free = pseudoinverse(jnp.concatenate([wishes - wishes @ held, held]))[:, : wishes.shape[0]]
    return base + free @ (values - wishes @ base)

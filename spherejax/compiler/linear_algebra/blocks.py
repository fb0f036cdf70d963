"""Solve S x = b for a symmetric positive semi-definite S of blocks, most of which are zero, as one named operation.

The blocks are eliminated in an order chosen once from the pattern, in loops whose turns touch the blocks of one pivot
row only: the work grows with the number of blocks that exist or fill in, and the compiled program does not grow at all.
Like `symmetric_solve`, with the same rule for redundant equations, it is a JAX primitive with one derivative rule, and
`spherejax.compiler.program` replaces it by an unrolled elimination of the scalar entries.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

from spherejax.compiler.linear_algebra.block_pattern import BlockPattern, Segment
from spherejax.compiler.linear_algebra.sums import sums_by_index
from spherejax.compiler.linear_algebra.symmetric import REDUNDANT_PIVOT

block_solve_p = Primitive("block_solve")

Blocks = Float[Array, "*batch k m m"]
Columns = Float[Array, "*batch k m c"]


def block_solve(
    pattern: BlockPattern,
    diagonal: Float[Array, "n m m"],
    pairs: Float[Array, "e m m"],
    right: Float[Array, "n m"],
    smallest_pivot: float = REDUNDANT_PIVOT,
) -> Float[Array, "n m"]:
    """Solution x of S x = b, with redundant equations left out as in `symmetric_solve`.

    Args:
        pattern: which blocks exist (static).
        diagonal: blocks (i, i). Rows that only fill a block up have a one on the diagonal and zeros elsewhere.
        pairs: blocks (i, j) of `pattern.pairs`, in its order.
        right: b.
        smallest_pivot: an equation whose pivot is below this part of its diagonal entry counts as dependent (static).

    Returns:
        x; an empty array without blocks.
    """
    if pattern.n_blocks == 0:
        return right
    return block_solve_p.bind(diagonal, pairs, right[..., None], pattern=pattern, smallest_pivot=smallest_pivot)[..., 0]


def block_times(pattern: BlockPattern, diagonal: Blocks, pairs: Blocks, columns: Columns) -> Columns:
    """S times columns."""
    i, j = pattern.rows, pattern.columns
    # One sum over all products instead of two sums over parts: `sums_by_index` gathers, and gathers once.
    batch = columns.shape[:-3]
    products = jnp.concatenate(
        [
            product(diagonal, columns),
            product(pairs, columns[..., j, :, :]),
            product(jnp.swapaxes(pairs, -1, -2), columns[..., i, :, :]),
        ],
        axis=len(batch),
    )
    target = np.concatenate([np.arange(pattern.n_blocks), i, j])
    moved = jnp.moveaxis(products, len(batch), 0)
    return jnp.moveaxis(sums_by_index(moved, target, pattern.n_blocks), 0, len(batch))


def product(a, b):
    """Matrix product as a sum of products: XLA on the CPU calls a library for a dot, which keeps loops apart."""
    return jnp.sum(a[..., :, :, None] * b[..., None, :, :], -2)


# The elimination -----------------------------------------------------------------------------------------------------


def _solve(diagonal, pairs, right, *, pattern: BlockPattern, smallest_pivot: float):
    function = partial(_solve_one, pattern, smallest_pivot)
    # Batch axes stand in front (`_batch`); each is one mapping of the elimination for one system.
    for _ in range(right.ndim - 3):
        function = jax.vmap(function)
    return function(diagonal, pairs, right)


def _solve_one(pattern: BlockPattern, smallest_pivot: float, diagonal, pairs, right):
    """Segment after segment forward, then back."""
    m = diagonal.shape[-1]
    # Slots: the diagonal, what is below it, and one of zeros, which steps with fewer neighbors than room read and
    # write.
    zero = jnp.zeros((1, m, m))
    sources = jnp.concatenate([pairs, jnp.swapaxes(pairs, -1, -2), zero])
    blocks = jnp.concatenate([diagonal, sources[pattern.elimination.sources]])
    entries = jnp.diagonal(diagonal, axis1=-2, axis2=-1)
    # Of the matrix as it came: what elimination has left of an entry says nothing of its scale.
    smallest = smallest_pivot * entries
    x = jnp.concatenate([right, jnp.zeros((1, *right.shape[1:]))])
    kept = []
    for segment in pattern.elimination.segments:
        blocks, x, ratios = _forward(segment, blocks, smallest, x)
        kept.append(ratios)
    for segment, ratios in zip(reversed(pattern.elimination.segments), reversed(kept), strict=True):
        x = _backward(segment, ratios, x)
    # Not positive semi-definite: pivots would count as redundant, and a wrong solution would look like one.
    return jnp.where(jnp.any(entries < 0), jnp.nan, x[:-1])


def _forward(segment: Segment, blocks, smallest, x):
    """Eliminate the pivots of a segment: their rows of x become P b, those of their neighbors lose N P b."""
    steps = jax.tree.map(jnp.asarray, segment)
    n_steps, d = segment.neighbors.shape
    m = blocks.shape[-1]

    def eliminate(s, carry):
        blocks, x, kept = carry
        pivot, slots, updated, near = steps.pivot[s], steps.blocks[s], steps.updates[s], steps.neighbors[s]
        # The blocks are read before anything is written: XLA then changes the arrays of the loop in place.
        below, row = blocks[slots], x[pivot]
        solved, ratios, changes, moved = eliminated(blocks[pivot], smallest[pivot], below, row)
        x = x.at[pivot].set(solved)
        blocks = _taken_from(blocks, updated, changes)
        x = _taken_from(x, near, moved)
        return blocks, x, kept.at[s].set(ratios)

    return jax.lax.fori_loop(0, n_steps, eliminate, (blocks, x, jnp.zeros((n_steps, d, m, m))))


def _taken_from(array, places, changes):
    """The array less changes at places, one after the other: empty places may come twice, with changes of zero."""
    if places.shape[0] > LARGEST_UNROLLED:
        return array.at[places].add(-changes)
    for i in range(places.shape[0]):
        array = array.at[places[i]].add(-changes[i])
    return array


LARGEST_UNROLLED = 16
"""Blocks of one step that are changed by operations of their own; more are left to a loop."""


def eliminated(pivot, smallest, below, row):
    """Elimination of one block row.

    Args:
        pivot: its block on the diagonal, after the steps before.
        smallest: pivots up to these are those of redundant equations, shape (m,).
        below: the blocks N_a of its column, shape (d, m, m).
        row: its right-hand side b, shape (m, c).

    Returns:
        P b; G_a = P N_a^T; N_b G_a for each pair a <= b; N_a P b, with P the (pseudo)inverse of the pivot.
    """
    d, m = below.shape[0], pivot.shape[0]
    c = row.shape[1]
    # The right-hand side and all neighbors at once: the small block is factored once.
    columns = jnp.concatenate([row, *(below[a].T for a in range(d))], 1)
    solved = _by_elimination(pivot, smallest, columns)
    own = solved[:, :c]
    ratios = [solved[:, c + m * a : c + m * (a + 1)] for a in range(d)]
    changes = [product(below[b], ratios[a]) for a in range(d) for b in range(a, d)]
    moved = [product(below[a], own) for a in range(d)]
    none = jnp.zeros((0, m, m))
    return (
        own,
        jnp.stack(ratios) if d else none,
        jnp.stack(changes) if d else none,
        jnp.stack(moved) if d else jnp.zeros((0, m, c)),
    )


def _by_elimination(matrix, smallest, columns):
    """L D L^T of a small block, unrolled."""
    m = matrix.shape[0]
    rows, inverses, factors = list(columns), [], []
    for j in range(m):
        pivot = matrix[0, 0]
        is_redundant = pivot <= smallest[j]
        # The divisor of a redundant row is 1: the branch that is not taken must be finite as well, or derivatives are
        # NaN.
        inverse = jnp.where(is_redundant, 0.0, 1.0 / jnp.where(is_redundant, 1.0, pivot))
        below = matrix[1:, 0] * inverse
        matrix = matrix[1:, 1:] - below[:, None] * matrix[1:, 0][None, :]
        for i in range(j + 1, m):
            rows[i] = rows[i] - below[i - j - 1] * rows[j]
        inverses.append(inverse)
        factors.append(below)
    for j in reversed(range(m)):
        rows[j] = rows[j] * inverses[j]
        for i in range(j + 1, m):
            rows[j] = rows[j] - factors[j][i - j - 1] * rows[i]
    return jnp.stack(rows)


def _backward(segment: Segment, ratios, x):
    """Substitution: x_j = P b_j - sum of G_a x_a."""
    steps = jax.tree.map(jnp.asarray, segment)
    n_steps = len(segment.pivot)

    def substitute(i, x):
        s = n_steps - 1 - i
        pivot = steps.pivot[s]
        # Empty neighbors name the last row of x, which is zero.
        reached = jnp.sum(product(ratios[s], x[steps.neighbors[s]]), 0)
        return x.at[pivot].add(-reached)

    return jax.lax.fori_loop(0, n_steps, substitute, x)


# The primitive -------------------------------------------------------------------------------------------------------


def _jvp(primals, tangents, *, pattern, **static):
    diagonal, pairs, right = primals
    solution = block_solve_p.bind(diagonal, pairs, right, pattern=pattern, **static)
    diagonal_tangent, pairs_tangent, residual = (
        jnp.zeros_like(primal) if isinstance(tangent, ad.Zero) else tangent
        for primal, tangent in zip(primals, tangents, strict=True)
    )
    # S dx = db - dS x: one more solve with the same matrix, and never a derivative of the factorization.
    if not (isinstance(tangents[0], ad.Zero) and isinstance(tangents[1], ad.Zero)):
        residual = residual - block_times(pattern, diagonal_tangent, pairs_tangent, solution)
    return solution, block_solve_p.bind(diagonal, pairs, residual, pattern=pattern, **static)


def _transpose(cotangent, diagonal, pairs, right, **static):
    del right  # the solve is linear in it, and S is symmetric
    if isinstance(cotangent, ad.Zero):
        return None, None, cotangent
    return None, None, block_solve_p.bind(diagonal, pairs, cotangent, **static)


def _batch(arguments, axes, **static):
    diagonal, pairs, right = arguments
    if axes[0] is None and axes[1] is None and diagonal.ndim == 3:
        # One matrix, many right-hand sides: they become columns, and the factorization is done once.
        moved = jnp.moveaxis(right, axes[2], 3)
        columns = moved.reshape(*moved.shape[:2], -1)
        solution = block_solve_p.bind(diagonal, pairs, columns, **static)
        return solution.reshape(moved.shape), 3
    size = next(x.shape[axis] for x, axis in zip(arguments, axes, strict=True) if axis is not None)
    fronted = [batching.bdim_at_front(x, axis, size) for x, axis in zip(arguments, axes, strict=True)]
    return block_solve_p.bind(*fronted, **static), 0


block_solve_p.def_impl(jax.jit(_solve, static_argnames=("pattern", "smallest_pivot")))
block_solve_p.def_abstract_eval(lambda diagonal, pairs, right, **static: right)
mlir.register_lowering(block_solve_p, mlir.lower_fun(_solve, multiple_results=False))
ad.primitive_jvps[block_solve_p] = _jvp
ad.primitive_transposes[block_solve_p] = _transpose
batching.primitive_batchers[block_solve_p] = _batch

"""Systems of linear equations as straight-line scalar programs: sparse eliminations, unrolled.

Rows are taken in an order that keeps structural zeros (minimum degree). Only entries that are no structural zeros are
looked at, so that the work of making a program grows with its size.
"""

from typing import Any

import numpy as np

from spherejax.compiler.graph import Graph
from spherejax.compiler.linear_algebra.block_pattern import BlockPattern, minimum_degree_order
from spherejax.compiler.linear_algebra.symmetric import REDUNDANT_PIVOT
from spherejax.compiler.operations import BOOL, FLOAT, NotScalarizable


def symmetric_solve(
    graph: Graph, matrix: np.ndarray, right_side: np.ndarray, *, smallest_pivot: float, **_: Any
) -> np.ndarray:
    """Names of the entries of the solution; arguments and parameters as of the primitive `symmetric_solve`."""
    size, columns = right_side.shape[-2:]
    matrices = matrix.reshape(-1, size, size)
    right_sides = right_side.reshape(-1, size, columns)
    systems = zip(matrices, right_sides, strict=True)
    solved = [_eliminate(graph, _lower_rows(graph, m), b, smallest_pivot) for m, b in systems]
    return np.array(solved, np.int64).reshape(right_side.shape)


def block_solve(
    graph: Graph, diagonal: np.ndarray, pairs: np.ndarray, right: np.ndarray, *, pattern: BlockPattern,
    smallest_pivot: float, **_: Any,
) -> np.ndarray:  # fmt: skip
    """As `symmetric_solve`, of a matrix of blocks; arguments and parameters as of the primitive `block_solve`."""
    n, m, columns = right.shape[-3:]
    # Batches become systems one after the other: a straight line has no other way to have many.
    size = int(np.prod(right.shape[:-3]))
    batches = zip(
        diagonal.reshape(size, n, m, m),
        pairs.reshape(size, len(pattern.pairs), m, m),
        right.reshape(size, n * m, columns),
        strict=True,
    )
    solved = [_eliminate(graph, _lower_rows_of_blocks(graph, pattern, d, p), b, smallest_pivot) for d, p, b in batches]
    return np.array(solved, np.int64).reshape(right.shape)


Rows = list[dict[int, int]]
"""Names of the entries that are no structural zeros, by column, for each row."""


def _lower_rows(graph: Graph, matrix: np.ndarray) -> Rows:
    """The rows of a symmetric matrix up to the diagonal."""
    return [
        {j: node for j, node in enumerate(row[: i + 1]) if not graph.is_value(node, 0)}
        for i, row in enumerate(matrix.tolist())
    ]


def _lower_rows_of_blocks(graph: Graph, pattern: BlockPattern, diagonal: np.ndarray, pairs: np.ndarray) -> Rows:
    """The rows of a symmetric matrix of blocks up to the diagonal."""
    m = diagonal.shape[-1]
    rows: Rows = [{} for _ in range(pattern.n_blocks * m)]
    for block, names in enumerate(diagonal):
        for i, entries in enumerate(_lower_rows(graph, names)):
            rows[block * m + i] = {block * m + j: node for j, node in entries.items()}
    for (left, below), names in zip(pattern.pairs, pairs.tolist(), strict=True):
        for i, entries in enumerate(names):
            for j, node in enumerate(entries):
                if not graph.is_value(node, 0):
                    rows[below * m + j][left * m + i] = node
    return rows


def _eliminate(graph: Graph, lower: Rows, right_side: np.ndarray, smallest_pivot: float) -> np.ndarray:
    """L D L^T elimination, unrolled, with rows in an order that keeps structural zeros, and back substitution.

    Redundant rows are left out as in `symmetric_solve`.
    """
    size = len(lower)
    order = _order_of(lower)
    place = {row: position for position, row in enumerate(order)}
    zero = graph.constant(0, FLOAT)
    # Columns of the reordered matrix from the diagonal down.
    # Dictionaries: what is not in one is a structural zero, for which no operation is ever made.
    columns: Rows = [{} for _ in range(size)]
    for i, entries in enumerate(lower):
        for j, node in entries.items():
            columns[min(place[i], place[j])][max(place[i], place[j])] = node
    x = [right_side[i].tolist() for i in order]
    # Before elimination: the scale of each pivot.
    diagonal = [columns[j].get(j, zero) for j in range(size)]
    inverse_pivots = []
    factors: list[dict[int, int]] = []
    for j in range(size):
        column = columns[j]
        inverse_pivot = _inverse_pivot(graph, column.pop(j, zero), diagonal[j], smallest_pivot)
        # Sorted, so that the same function gives the same program in every process: its text is its name on disk.
        below = {i: graph.mul(column[i], inverse_pivot) for i in sorted(column) if not graph.is_value(column[i], 0)}
        for i in below:
            for k in below:
                # The lower half is enough, since the matrix is symmetric.
                if k <= i:
                    product = graph.mul(below[i], column[k])
                    columns[k][i] = graph.sub(columns[k].get(i, zero), product)
        for i, factor in below.items():
            x[i] = [graph.sub(a, graph.mul(factor, b)) for a, b in zip(x[i], x[j], strict=True)]
        inverse_pivots.append(inverse_pivot)
        factors.append(below)
    # D, then L^T from the last row up: the entries of x below row j are final.
    for j in reversed(range(size)):
        x[j] = [graph.mul(a, inverse_pivots[j]) for a in x[j]]
        for i, factor in factors[j].items():
            x[j] = [graph.sub(a, graph.mul(factor, b)) for a, b in zip(x[j], x[i], strict=True)]
    solution = np.empty_like(right_side)
    for position, row in enumerate(order):
        solution[row] = x[position]
    return solution


def _inverse_pivot(graph: Graph, pivot: int, diagonal: int, smallest_pivot: float) -> int:
    """1 / pivot, or 0 for a redundant row."""
    # Nothing was taken from it: it cannot be small by cancellation, and needs no guard.
    if pivot == diagonal:
        return graph.div(graph.constant(1, FLOAT), pivot)
    return _inverse_unless_small(graph, pivot, pivot, diagonal, smallest_pivot)


def _inverse_unless_small(
    graph: Graph, pivot: int, magnitude: int, scale: int, smallest_pivot: float = REDUNDANT_PIVOT
) -> int:
    """1 / pivot, or 0 where its magnitude is rounding of `scale`; the guarded divisor keeps derivatives finite."""
    one, zero = graph.constant(1, FLOAT), graph.constant(0, FLOAT)
    # Relative to what the pivot was made of: rows of all units are alike then.
    smallest = graph.mul(scale, graph.constant(smallest_pivot, FLOAT))
    is_redundant = graph.apply("le", (magnitude, smallest), BOOL, ())
    return graph.select(is_redundant, graph.div(one, graph.select(is_redundant, pivot, one)), zero)


def general_solve(graph: Graph, matrix: np.ndarray, right_side: np.ndarray, **_: Any) -> np.ndarray:
    """As `symmetric_solve`, of a matrix without symmetry."""
    if matrix.ndim != 2 or right_side.shape[1] != 1:
        raise NotScalarizable("a general solve for several matrices or right-hand sides")
    return _eliminate_general(graph, matrix, right_side[:, 0]).reshape(right_side.shape)


def _eliminate_general(graph: Graph, matrix: np.ndarray, right_side: np.ndarray) -> np.ndarray:
    """L U elimination, unrolled, with rows and columns in an order that keeps structural zeros.

    A row without a diagonal entry gets its pivot from the rows before it; where their contributions cancel, the row is
    redundant and left out, as in `symmetric_solve`.
    """
    size = len(matrix)
    order = _minimum_degree_order(np.vectorize(lambda node: not graph.is_value(int(node), 0))(matrix))
    a = [[int(matrix[i, j]) for j in order] for i in order]
    x = [int(right_side[i]) for i in order]
    zero = graph.constant(0, FLOAT)
    # A row of multipliers has no diagonal entry to compare its pivot with: the sum of what was taken away is its scale.
    contributed = {i: zero for i in range(size) if graph.is_value(a[i][i], 0)}
    inverse_pivots = []
    for j in range(size):
        inverse_pivots.append(_inverse_of_contributions(graph, a[j][j], contributed.get(j)))
        # Asked once for a pivot, and not for each row below it: most entries are structural zeros.
        right_of_pivot = [k for k in range(j + 1, size) if not graph.is_value(a[j][k], 0)]
        for i in range(j + 1, size):
            if graph.is_value(a[i][j], 0):
                continue
            factor = graph.mul(a[i][j], inverse_pivots[j])
            for k in right_of_pivot:
                product = graph.mul(factor, a[j][k])
                a[i][k] = graph.sub(a[i][k], product)
                if k == i and i in contributed:
                    size_of = graph.apply("abs", (product,), FLOAT, ())
                    contributed[i] = graph.add(contributed[i], size_of)
            x[i] = graph.sub(x[i], graph.mul(factor, x[j]))
    for j in reversed(range(size)):
        for k in range(j + 1, size):  # products with structural zeros make no operation
            x[j] = graph.sub(x[j], graph.mul(a[j][k], x[k]))
        x[j] = graph.mul(x[j], inverse_pivots[j])
    solution = np.empty(size, np.int64)
    solution[order] = x
    return solution


def _inverse_of_contributions(graph: Graph, pivot: int, contributed: int | None) -> int:
    """1 / pivot, or 0 where what made the pivot has cancelled; None: the row has a diagonal entry of its own."""
    if contributed is None:
        return graph.div(graph.constant(1, FLOAT), pivot)
    magnitude = graph.apply("abs", (pivot,), FLOAT, ())
    return _inverse_unless_small(graph, pivot, magnitude, contributed)


def _order_of(lower: Rows) -> list[int]:
    """The elimination order of a symmetric matrix."""
    neighbors: dict[int, set[int]] = {i: set() for i in range(len(lower))}
    for i, entries in enumerate(lower):
        for j in entries:
            if j != i:
                neighbors[i].add(j)
                neighbors[j].add(i)
    return minimum_degree_order(neighbors, [i for i, entries in enumerate(lower) if i not in entries])


def _minimum_degree_order(is_nonzero: np.ndarray) -> list[int]:
    """The elimination order of a matrix whose pattern need not be symmetric."""
    joined = is_nonzero | is_nonzero.T
    neighbors = {i: set(np.flatnonzero(row).tolist()) - {i} for i, row in enumerate(joined)}
    return minimum_degree_order(neighbors, np.flatnonzero(~np.diagonal(is_nonzero)).tolist())

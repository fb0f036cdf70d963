"""How each JAX primitive acts on arrays of scalar node names; used by `spherejax.foundations.scalarize`.

Three families: primitives that only move entries (executed on the names), elementwise primitives (one node an
entry), and those with a rule of their own (products, sums, the symmetric solve). Derivative rules attached by hand
(`custom_jvp`, `custom_vjp`) are refused: inlining the function under them would lose the rule.
"""

from functools import reduce

import jax
import numpy as np

from spherejax.foundations.scalar_graph import BOOL, FLOAT, Graph
from spherejax.foundations.symmetric_solve import REDUNDANT_PIVOT


class NotScalarizable(Exception):  # noqa: N818 - it says what it is
    """The function has no scalar program; the message says which operation stands in the way."""


STRUCTURAL = frozenset(
    [
        "reshape",
        "squeeze",
        "expand_dims",
        "transpose",
        "rev",
        "slice",
        "concatenate",
        "broadcast_in_dim",
        "stack",
        "split",
        "copy",
        "copy_p",
        "gather",
        "dynamic_slice",
        "dynamic_update_slice",
        "scatter",
        "tile",
    ]
)

ELEMENTWISE = frozenset(
    [
        "max",
        "min",
        "exp",
        "exp2",
        "log",
        "log1p",
        "expm1",
        "tanh",
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
        "atan2",
        "sinh",
        "cosh",
        "asinh",
        "acosh",
        "atanh",
        "abs",
        "sign",
        "rsqrt",
        "cbrt",
        "logistic",
        "floor",
        "ceil",
        "round",
        "is_finite",
        "rem",
        "erf",
        "erfc",
        "lt",
        "le",
        "gt",
        "ge",
        "eq",
        "ne",
        "and",
        "or",
        "not",
        "xor",
        "clamp",
        "nextafter",
        "stop_gradient",
    ]
)


def move_names(graph: Graph, primitive, parameters, inputs, shapes) -> list[np.ndarray]:
    """Execute a primitive that only moves entries on the names of the entries."""
    name = primitive.name
    numpy_rule = _MOVES.get(name)
    if numpy_rule is not None:
        outputs = numpy_rule(inputs, parameters)
        return [np.broadcast_to(array, shape) for array, shape in zip(outputs, shapes, strict=True)]
    moved = {"scatter": (0, 2), "dynamic_update_slice": (0, 1)}.get(name, (0,))
    operands = []
    for position, array in enumerate(inputs):
        if position in moved:
            operands.append(array)
            continue
        if not all(graph.is_constant(int(node)) for node in array.ravel()):
            raise NotScalarizable(f"{name!r} with an index that is computed")
        operands.append(
            np.vectorize(lambda node: graph.value(int(node)), otypes=[np.int64])(array).reshape(array.shape)
        )
    with jax.ensure_compile_time_eval():
        moved_names = np.asarray(primitive.bind(*operands, **_filling_with_nothing(name, parameters)))
    if np.any(moved_names < 0):
        raise NotScalarizable(f"{name!r} with an index out of range")
    return [moved_names]


def _filling_with_nothing(name, parameters):
    """Out of range, a gather gives the name -1, which no node has."""
    if name == "gather":
        return {**parameters, "mode": jax.lax.GatherScatterMode.FILL_OR_DROP, "fill_value": -1}
    return parameters


def _broadcast(inputs, parameters):
    shape, dimensions = parameters["shape"], parameters["broadcast_dimensions"]
    aligned = [1] * len(shape)
    for position, dimension in enumerate(dimensions):
        aligned[dimension] = inputs[0].shape[position]
    return [np.broadcast_to(inputs[0].reshape(aligned), shape)]


def _slice(inputs, parameters):
    strides = parameters["strides"] or (1,) * inputs[0].ndim
    bounds = zip(parameters["start_indices"], parameters["limit_indices"], strides, strict=True)
    return [inputs[0][tuple(slice(*bound) for bound in bounds)]]


_MOVES = {
    "reshape": lambda inputs, p: [inputs[0].reshape(p["new_sizes"])],
    "squeeze": lambda inputs, p: [np.squeeze(inputs[0], tuple(p["dimensions"]))],
    "expand_dims": lambda inputs, p: [np.expand_dims(inputs[0], tuple(p["dimensions"]))],
    "transpose": lambda inputs, p: [inputs[0].transpose(p["permutation"])],
    "rev": lambda inputs, p: [np.flip(inputs[0], p["dimensions"])],
    "slice": _slice,
    "concatenate": lambda inputs, p: [np.concatenate(inputs, p["dimension"])],
    "stack": lambda inputs, p: [np.stack(inputs, p["axis"])],
    "split": lambda inputs, p: np.split(inputs[0], np.cumsum(p["sizes"])[:-1], p["axis"]),
    "broadcast_in_dim": _broadcast,
    "copy": lambda inputs, p: [inputs[0]],
    "copy_p": lambda inputs, p: [inputs[0]],
}


def _entrywise(function, *arrays, shape):
    flat = [np.broadcast_to(array, shape).ravel() for array in arrays]
    names = [function(*map(int, entry)) for entry in zip(*flat, strict=True)]
    return np.array(names, np.int64).reshape(shape)


def _folding(method):
    """A rule for an elementwise operation that `Graph` folds."""

    def rule(graph, inputs, parameters, shapes, dtypes):
        del parameters, dtypes
        return [_entrywise(lambda *nodes: getattr(graph, method)(*nodes), *inputs, shape=shapes[0])]

    return rule


def _select(graph, inputs, parameters, shapes, dtypes):
    del parameters, dtypes
    if len(inputs) != 3:
        raise NotScalarizable("a selection among more than two")
    if any(graph.dtypes[int(node)] != BOOL for node in inputs[0].ravel()):
        raise NotScalarizable("a selection by an integer")
    return [_entrywise(graph.select, *inputs, shape=shapes[0])]


def _square(graph, inputs, parameters, shapes, dtypes):
    del parameters, dtypes
    return [_entrywise(lambda node: graph.mul(node, node), inputs[0], shape=shapes[0])]


def _square_root(graph, inputs, parameters, shapes, dtypes):
    del parameters, dtypes
    half = graph.constant(0.5, FLOAT)
    return [_entrywise(lambda node: graph.power(node, half), inputs[0], shape=shapes[0])]


def _integer_power(graph, inputs, parameters, shapes, dtypes):
    del dtypes
    return [_entrywise(lambda node: graph.integer_power(node, parameters["y"]), inputs[0], shape=shapes[0])]


def _convert(graph, inputs, parameters, shapes, dtypes):
    del parameters

    def one(node):
        source, target = graph.dtypes[node], dtypes[0]
        if source == target:
            return node
        if graph.is_constant(node):
            return graph.constant(graph.value(node), target)
        if source == BOOL:
            return graph.select(node, graph.constant(0, target), graph.constant(1, target))
        raise NotScalarizable(f"a conversion from {source} to {target}")

    return [_entrywise(one, inputs[0], shape=shapes[0])]


def _iota(graph, inputs, parameters, shapes, dtypes):
    del inputs
    shape, dimension = shapes[0], parameters["dimension"]
    counts = np.broadcast_to(
        np.arange(shape[dimension]).reshape([-1 if d == dimension else 1 for d in range(len(shape))]), shape
    )
    return [_entrywise(lambda count: graph.constant(count, dtypes[0]), counts, shape=shape)]


def _rows(array: np.ndarray, axes) -> tuple[np.ndarray, tuple[int, ...]]:
    """The array as rows to be reduced, and the shape of the result."""
    kept = [axis for axis in range(array.ndim) if axis not in axes]
    shape = tuple(array.shape[axis] for axis in kept)
    count = int(np.prod([array.shape[axis] for axis in axes]))
    return array.transpose([*kept, *axes]).reshape(int(np.prod(shape)), count), shape


def _reduction(combine, start):
    def rule(graph, inputs, parameters, shapes, dtypes):
        del shapes
        rows, shape = _rows(inputs[0], tuple(parameters["axes"]))
        first = graph.constant(start, dtypes[0])
        names = [reduce(lambda a, b: combine(graph, a, b), map(int, row), first) for row in rows]
        return [np.array(names, np.int64).reshape(shape)]

    return rule


def _extremum(primitive, start):
    return _reduction(lambda graph, a, b: graph.apply(primitive, (a, b), graph.dtypes[b], ()), start)


def _dot_general(graph, inputs, parameters, shapes, dtypes):
    del dtypes
    (left_summed, right_summed), (left_batch, right_batch) = parameters["dimension_numbers"]
    left, right = inputs

    def arranged(array, batch, summed):
        free = [axis for axis in range(array.ndim) if axis not in batch and axis not in summed]
        batch_size = int(np.prod([array.shape[axis] for axis in batch]))
        free_size = int(np.prod([array.shape[axis] for axis in free]))
        summed_size = int(np.prod([array.shape[axis] for axis in summed]))
        return array.transpose([*batch, *free, *summed]).reshape(batch_size, free_size, summed_size)

    a, b = arranged(left, left_batch, left_summed), arranged(right, right_batch, right_summed)
    zero = graph.constant(0, FLOAT)
    names = [
        reduce(graph.add, (graph.mul(int(x), int(y)) for x, y in zip(row, column, strict=True)), zero)
        for block_a, block_b in zip(a, b, strict=True)
        for row in block_a
        for column in block_b
    ]
    return [np.array(names, np.int64).reshape(shapes[0])]


def _symmetric_solve(graph, inputs, parameters, shapes, dtypes):
    del dtypes
    matrix, right_side = inputs
    size, columns = right_side.shape[-2:]
    matrices = matrix.reshape(-1, size, size)
    right_sides = right_side.reshape(-1, size, columns)
    smallest = parameters["smallest_pivot"]
    solved = [_eliminate(graph, m, b, smallest) for m, b in zip(matrices, right_sides, strict=True)]
    return [np.array(solved, np.int64).reshape(shapes[0])]


def _eliminate(graph: Graph, matrix: np.ndarray, right_side: np.ndarray, smallest_pivot: float) -> np.ndarray:
    """L D L^T elimination, unrolled, with rows in an order that keeps structural zeros, and back substitution.

    Redundant rows are left out as in `symmetric_solve`.
    """
    size = len(matrix)
    order = _minimum_degree_order(np.vectorize(lambda node: not graph.is_value(int(node), 0))(matrix))
    s = [[int(matrix[max(i, j), min(i, j)]) for j in order] for i in order]
    x = [[int(node) for node in right_side[i]] for i in order]
    diagonal = [s[j][j] for j in range(size)]
    inverse_pivots = []
    factors: list[dict[int, int]] = []
    for j in range(size):
        inverse_pivot = _inverse_pivot(graph, s[j][j], diagonal[j], smallest_pivot)
        below = {i: graph.mul(s[i][j], inverse_pivot) for i in range(j + 1, size) if not graph.is_value(s[i][j], 0)}
        for i in below:
            for k in below:
                if k <= i:
                    s[i][k] = graph.sub(s[i][k], graph.mul(below[i], s[k][j]))
        for i, factor in below.items():
            x[i] = [graph.sub(a, graph.mul(factor, b)) for a, b in zip(x[i], x[j], strict=True)]
        inverse_pivots.append(inverse_pivot)
        factors.append(below)
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
    if pivot == diagonal:
        return graph.div(graph.constant(1, FLOAT), pivot)
    return _inverse_unless_small(graph, pivot, pivot, diagonal, smallest_pivot)


def _inverse_unless_small(
    graph: Graph, pivot: int, magnitude: int, scale: int, smallest_pivot: float = REDUNDANT_PIVOT
) -> int:
    """1 / pivot, or 0 where its magnitude is too small a part of `scale`; guarded, so that derivatives are finite."""
    one, zero = graph.constant(1, FLOAT), graph.constant(0, FLOAT)
    smallest = graph.mul(scale, graph.constant(smallest_pivot, FLOAT))
    is_redundant = graph.apply(jax.lax.le_p, (magnitude, smallest), BOOL, ())
    return graph.select(is_redundant, graph.div(one, graph.select(is_redundant, pivot, one)), zero)


def _general_solve(graph, inputs, parameters, shapes, dtypes):
    del parameters, dtypes
    matrix, right_side = inputs
    if matrix.ndim != 2 or right_side.shape[1] != 1:
        raise NotScalarizable("a general solve for several matrices or right-hand sides")
    return [_eliminate_general(graph, matrix, right_side[:, 0]).reshape(shapes[0])]


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
    contributed = {i: zero for i in range(size) if graph.is_value(a[i][i], 0)}
    inverse_pivots = []
    for j in range(size):
        inverse_pivots.append(_inverse_of_contributions(graph, a[j][j], contributed.get(j)))
        right_of_pivot = [k for k in range(j + 1, size) if not graph.is_value(a[j][k], 0)]
        for i in range(j + 1, size):
            if graph.is_value(a[i][j], 0):
                continue
            factor = graph.mul(a[i][j], inverse_pivots[j])
            for k in right_of_pivot:
                product = graph.mul(factor, a[j][k])
                a[i][k] = graph.sub(a[i][k], product)
                if k == i and i in contributed:
                    size_of = graph.apply(jax.lax.abs_p, (product,), FLOAT, ())
                    contributed[i] = graph.add(contributed[i], size_of)
            x[i] = graph.sub(x[i], graph.mul(factor, x[j]))
    for j in reversed(range(size)):
        for k in range(j + 1, size):
            x[j] = graph.sub(x[j], graph.mul(a[j][k], x[k]))
        x[j] = graph.mul(x[j], inverse_pivots[j])
    solution = np.empty(size, np.int64)
    solution[order] = x
    return solution


def _inverse_of_contributions(graph: Graph, pivot: int, contributed: int | None) -> int:
    """1 / pivot, or 0 where what made the pivot has cancelled; None: the row has a diagonal entry of its own."""
    if contributed is None:
        return graph.div(graph.constant(1, FLOAT), pivot)
    magnitude = graph.apply(jax.lax.abs_p, (pivot,), FLOAT, ())
    return _inverse_unless_small(graph, pivot, magnitude, contributed)


def _minimum_degree_order(is_nonzero: np.ndarray) -> list[int]:
    """Elimination order that takes, again and again, the row with the fewest neighbors (Tinney's second scheme).

    A row whose diagonal entry is a structural zero waits for all its neighbors: they make its pivot, and only all of
    them together make one that cannot vanish.
    """
    has_pivot = np.diagonal(is_nonzero)
    is_nonzero = is_nonzero | is_nonzero.T
    neighbors = {i: {j for j in np.flatnonzero(row).tolist() if j != i} for i, row in enumerate(is_nonzero)}
    awaited = {i: set() if has_pivot[i] else set(neighbors[i]) for i in neighbors}
    order = []
    while neighbors:
        row = min(neighbors, key=lambda i: (len(awaited[i]), len(neighbors[i]), i))
        joined = neighbors.pop(row)
        for i in joined:
            neighbors[i] = (neighbors[i] | joined) - {i, row}
            awaited[i].discard(row)
        order.append(row)
    return order


RULES = {
    "add": _folding("add"),
    "add_any": _folding("add"),
    "sub": _folding("sub"),
    "mul": _folding("mul"),
    "div": _folding("div"),
    "neg": _folding("neg"),
    "pow": _folding("power"),
    "square": _square,
    "sqrt": _square_root,
    "integer_pow": _integer_power,
    "select_n": _select,
    "convert_element_type": _convert,
    "iota": _iota,
    "reduce_sum": _reduction(lambda graph, a, b: graph.add(a, b), 0),
    "reduce_prod": _reduction(lambda graph, a, b: graph.mul(a, b), 1),
    "reduce_max": _extremum(jax.lax.max_p, -np.inf),
    "reduce_min": _extremum(jax.lax.min_p, np.inf),
    "reduce_and": _extremum(jax.lax.and_p, True),
    "reduce_or": _extremum(jax.lax.or_p, False),
    "dot_general": _dot_general,
    "symmetric_solve": _symmetric_solve,
    "general_solve": _general_solve,
}

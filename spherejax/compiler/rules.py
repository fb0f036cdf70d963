"""How each JAX primitive acts on arrays of scalar node names; used by `spherejax.compiler.program`.

Three families: primitives that only move entries (executed on the names), elementwise primitives (one node an
entry), and those with a rule of their own (products, sums, the symmetric solve). Derivative rules attached by hand are
followed (`custom_jvp`; see `scalar_interpreter`) or refused (`custom_vjp`, which says nothing of tangents): inlining
the function under them would lose the rule.
"""

from functools import partial, reduce

import jax
import numpy as np

from spherejax.compiler.graph import BOOL, FLOAT, Graph, NotScalarizable
from spherejax.compiler.linear_algebra.unrolled import SOLVES

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
        "unstack",
        "split",
        "copy",
        "copy_p",
        "gather",
        "dynamic_slice",
        "dynamic_update_slice",
        "scatter",
        "tile",
        "pad",
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
    numpy_rule = MOVES.get(name)
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
    # By NumPy, where that is easily said: JAX would compile a program for each shape, at 20 ms.
    if name == "gather":
        moved_names = _gathered(operands[0], operands[1], parameters)
    else:
        with jax.ensure_compile_time_eval():
            moved_names = np.asarray(primitive.bind(*operands, **parameters))
    if np.any(moved_names < 0):
        raise NotScalarizable(f"{name!r} with an index out of range")
    return [moved_names]


def _gathered(array: np.ndarray, indices: np.ndarray, parameters) -> np.ndarray:
    """`jax.lax.gather` of names; out of range it gives the name -1, which no node has."""
    how, sizes = parameters["dimension_numbers"], parameters["slice_sizes"]
    dropped = (*how.collapsed_slice_dims, *how.operand_batching_dims)
    kept = [size for dimension, size in enumerate(sizes) if dimension not in dropped]
    found = np.empty((*indices.shape[:-1], *kept), np.int64)
    clips = parameters["mode"] == jax.lax.GatherScatterMode.CLIP
    for place in np.ndindex(indices.shape[:-1]):
        begin = np.zeros(array.ndim, np.int64)
        begin[list(how.start_index_map)] = indices[place]
        for dimension, of_indices in zip(how.operand_batching_dims, how.start_indices_batching_dims, strict=True):
            begin[dimension] = place[of_indices]
        room = np.array(array.shape) - sizes
        begin = np.clip(begin, 0, room) if clips else begin
        is_within = np.all((begin >= 0) & (begin <= room))
        part = array[tuple(map(slice, begin, begin + sizes))] if is_within else np.full(sizes, -1)
        found[place] = part.reshape(kept)
    return np.moveaxis(found, range(found.ndim - len(kept), found.ndim), how.offset_dims)


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


def _pad(inputs, parameters):
    array, filling = inputs
    config = parameters["padding_config"]
    if any(low < 0 or high < 0 or interior for low, high, interior in config):
        raise NotScalarizable("a negative or interior padding")
    return [np.pad(array, [(low, high) for low, high, _ in config], constant_values=int(filling))]


MOVES = {
    "reshape": lambda inputs, p: [inputs[0].reshape(p["new_sizes"])],
    "squeeze": lambda inputs, p: [np.squeeze(inputs[0], tuple(p["dimensions"]))],
    "expand_dims": lambda inputs, p: [np.expand_dims(inputs[0], tuple(p["dimensions"]))],
    "transpose": lambda inputs, p: [inputs[0].transpose(p["permutation"])],
    "rev": lambda inputs, p: [np.flip(inputs[0], p["dimensions"])],
    "slice": _slice,
    "concatenate": lambda inputs, p: [np.concatenate(inputs, p["dimension"])],
    "stack": lambda inputs, p: [np.stack(inputs, p["axis"])],
    "unstack": lambda inputs, p: list(np.moveaxis(inputs[0], p["axis"], 0)),
    "split": lambda inputs, p: np.split(inputs[0], np.cumsum(p["sizes"])[:-1], p["axis"]),
    "broadcast_in_dim": _broadcast,
    "pad": _pad,
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


def _one_minus_square(graph, inputs, parameters, shapes, dtypes):
    del parameters
    one = graph.constant(1, dtypes[0])
    return [_entrywise(lambda x: graph.mul(graph.add(one, x), graph.sub(one, x)), inputs[0], shape=shapes[0])]


def _log2(graph, inputs, parameters, shapes, dtypes):
    factor, how = graph.constant(1 / np.log(2), FLOAT), tuple(sorted(parameters.items()))
    logarithm = partial(graph.apply, jax.lax.log_p, dtype=dtypes[0], parameters=how)
    return [_entrywise(lambda x: graph.mul(logarithm((x,)), factor), inputs[0], shape=shapes[0])]


def _polynomial(graph, inputs, parameters, shapes, dtypes):
    """By Horner's rule; the coefficients from the lowest degree on."""
    del parameters, dtypes

    def one(x, *coefficients):
        return reduce(lambda found, a: graph.add(a, graph.mul(x, found)), reversed(coefficients))

    return [_entrywise(one, *inputs, shape=shapes[0])]


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
    "one_minus_square": _one_minus_square,  # this one and log2 since JAX 0.11, polynomial since 0.12
    "log2": _log2,
    "polynomial": _polynomial,
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
    **SOLVES,
}

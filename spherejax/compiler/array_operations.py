"""What an operation on whole arrays is: one record for each.

In a scalar program such an operation is no operation: entries change their places (`reshape`, `gather`), or are put
together by several operations on numbers (`reduce_sum`, `dot_general`, a linear solve). So it needs no derivative, no
evaluation, no StableHLO and no C: those are of the operations on numbers that it becomes. It has two rules of its own,
where records of `operations` have ten: one on arrays of names of nodes, and one for loops in LLVM's language, where
arrays stay arrays in memory and indices may be known only when the program runs.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import accumulate
from typing import Any, NamedTuple

import jax
import numpy as np

from spherejax.compiler.emit.llvm_arrays import (
    LARGEST_WRITTEN_OUT,
    ArrayText,
    NotWrittenError,
    TooManyEntriesError,
    Value,
    chunks,
    constant,
    kind_of,
    vector,
)
from spherejax.compiler.graph import Graph
from spherejax.compiler.linear_algebra.unrolled import block_solve, general_solve, symmetric_solve
from spherejax.compiler.lookups import block_at, changed_at, holds_within, in_order, place_of_extreme
from spherejax.compiler.operations import (
    BOOL,
    DOUBLE,
    FLOAT,
    INT,
    MAY_OVERFLOW,
    OPERATIONS,
    TRUTH,
    WHOLE,
    Call,
    NotScalarizable,
    ScalarOperation,
)


class Use(NamedTuple):
    """One use of an operation on arrays of names.

    Attributes:
        primitive, parameters: of JAX.
        shapes, dtypes: of the results; dtypes as nodes have them.
        types: the same as JAX has them.
    """

    primitive: Any
    parameters: Mapping[str, Any]
    shapes: Sequence[tuple[int, ...]]
    dtypes: Sequence[np.dtype]
    types: Sequence[np.dtype]


@dataclass(frozen=True, kw_only=True)
class ArrayOperation:
    """What an operation on whole arrays is.

    Attributes:
        name: of the primitive.
        names: from a graph, arrays of names of nodes, and a `Use` to arrays of names; None where a scalar program
            cannot have it.
        llvm: from an `ArrayText`, values, parameters and the results' shapes and types to values; None where XLA is
            left to compile the loop.
        fuses: whether XLA can write it into a kernel of several operations; see `native.loop_fusion`.
        reduces: whether XLA may hand it to a library where it is large.
        solves: whether it is a linear solve, whose derivative rule is shorter than the derivative of its elimination.
        moves: of an operation that only moves entries, what it does with any arrays, from these and its parameters.
    """

    name: str
    names: Callable[[Graph, Sequence[np.ndarray], Use], list[np.ndarray]] | None = None
    llvm: Callable[[ArrayText, Sequence[Value], Any, Sequence[Any]], list[Value]] | None = None
    fuses: bool = True
    reduces: bool = False
    solves: bool = False
    moves: Callable[[Sequence[np.ndarray], Any], list[np.ndarray]] | None = None


# Operations on numbers, entry by entry --------------------------------------------------------------------------------


def by_entry(graph: Graph, operation: ScalarOperation, inputs: Sequence[np.ndarray], use: Use) -> list[np.ndarray]:
    """The names of what an operation on numbers gives for each entry."""
    (shape,), (dtype,) = use.shapes, use.dtypes
    if (rule := operation.folded) is not None:
        return [_entrywise(lambda *nodes: rule(graph, *nodes, **use.parameters), *inputs, shape=shape)]
    frozen = tuple(sorted(use.parameters.items()))  # equal uses are one node, so that parameters are hashed
    return [_entrywise(lambda *nodes: graph.apply(operation.name, nodes, dtype, frozen), *inputs, shape=shape)]


def _entrywise(node: Callable[..., int], *arrays: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    flat = [np.broadcast_to(array, shape).ravel() for array in arrays]
    names = [node(*map(int, entry)) for entry in zip(*flat, strict=True)]
    return np.array(names, np.int64).reshape(shape)


def written_by_entry(
    text: ArrayText, operation: ScalarOperation, values: Sequence[Value], parameters: Any, avals: Sequence[Any]
) -> list[Value]:
    """As `by_entry`, in LLVM's language."""
    (aval,) = avals
    # Kinds of the arguments, not of the result alone: a comparison of floats is a truth.
    call = Call(tuple(value.kind for value in values), kind_of(aval.dtype), parameters)
    if not operation.can_be_llvm(call):
        raise NotWrittenError(f"{operation.name} of {' and '.join(call.kinds)}")
    wraps = aval.dtype == np.int32 and operation.name in MAY_OVERFLOW
    if operation.copies and call.kinds == (call.kind,) and not wraps:
        return [values[0].as_shape(aval.shape)]  # nothing is written: it stays where it is

    def write(width: int, *names: str) -> str:
        writer = text.at(width)
        number = operation.in_llvm(writer, call, *names)
        return in_32_bits(writer, number) if wraps else number

    return [text.entrywise(aval.shape, call.kind, values, write)]


def in_32_bits(text: Any, number: str) -> str:
    """A whole number, computed with 64 bits, as JAX has it with 32: it wraps around."""
    typed, bits = text.type(WHOLE), text.number(32, WHOLE)
    return text.made(f"ashr {typed} {text.made(f'shl {typed} {number}, {bits}')}, {bits}")


def _selected(text: ArrayText, which: str, on_false: Value, on_true: Value, shape: Sequence[int]) -> Value:
    aval = jax.ShapeDtypeStruct(tuple(shape), _DTYPES[on_true.kind])
    values = [Value((), TRUTH, which), on_false, on_true]
    return written_by_entry(text, OPERATIONS["select"], values, {}, [aval])[0]


_DTYPES = {DOUBLE: np.float64, WHOLE: np.int64, TRUTH: np.bool_}


# What moves entries ---------------------------------------------------------------------------------------------------

Moves = Callable[[Sequence[np.ndarray], Any], list[np.ndarray]]


def _solving(name: str, solve: Callable[..., np.ndarray]) -> ArrayOperation:
    """A linear solve, which becomes an elimination; in a loop XLA is left to call its own."""

    def names(graph: Graph, inputs: Sequence[np.ndarray], use: Use) -> list[np.ndarray]:
        return [solve(graph, *inputs, **use.parameters)]

    return ArrayOperation(name=name, names=names, fuses=False, solves=True)


def _moving(name: str, moves: Moves) -> ArrayOperation:
    """An operation whose results are entries of its arguments, at places that are known: NumPy moves whatever it is."""

    def names(graph: Graph, inputs: Sequence[np.ndarray], use: Use) -> list[np.ndarray]:
        del graph
        outputs = moves(inputs, use.parameters)
        return [np.broadcast_to(array, shape) for array, shape in zip(outputs, use.shapes, strict=True)]

    def llvm(text: ArrayText, values: Sequence[Value], parameters: Any, avals: Sequence[Any]) -> list[Value]:
        # NumPy moves numbers of places, counted through all arguments; the text then reads from these.
        begins = np.cumsum([0, *(value.size for value in values)])
        places = [b + np.arange(v.size).reshape(v.shape) for b, v in zip(begins, values, strict=False)]
        return [
            text.moved(values, np.broadcast_to(entries, aval.shape), kind_of(aval.dtype))
            for entries, aval in zip(moves(places, parameters), avals, strict=True)
        ]

    return ArrayOperation(name=name, names=names, llvm=llvm, moves=moves)


def _names_by_jax(graph: Graph, inputs: Sequence[np.ndarray], use: Use) -> list[np.ndarray]:
    """JAX moves names as it moves numbers."""
    del graph
    with jax.ensure_compile_time_eval():  # also where somebody traces the function that is made a program
        return [np.asarray(use.primitive.bind(*inputs, **use.parameters))]


def gathered(array: np.ndarray, indices: np.ndarray, parameters: Any) -> np.ndarray:
    """`jax.lax.gather` of names; out of range it gives the name -1, which no node has.

    By NumPy: JAX would compile a program for each shape, at 20 ms.
    """
    how, sizes = parameters["dimension_numbers"], parameters["slice_sizes"]
    dropped = (*how.collapsed_slice_dims, *how.operand_batching_dims)
    kept = [size for dimension, size in enumerate(sizes) if dimension not in dropped]
    parts = np.empty((*indices.shape[:-1], *kept), np.int64)
    # Of the other modes each drops or fills what is outside, and what is promised to be inside is checked here.
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
        parts[place] = part.reshape(kept)
    return np.moveaxis(parts, range(parts.ndim - len(kept), parts.ndim), how.offset_dims)


# Names at places that are computed: each is one of several, by a whole number (`Graph.lookup`). Places that are known
# fold in the same way.


def _names_of_gather(graph: Graph, inputs: Sequence[np.ndarray], use: Use) -> list[np.ndarray]:
    array, indices = inputs
    if all(graph.is_constant(int(node)) for node in indices.ravel()):
        known = np.array([graph.value(int(node)) for node in indices.ravel()], np.int64).reshape(indices.shape)
        names = gathered(array, known, use.parameters)
        if np.all(names >= 0):
            return [names]
    how, sizes, mode = (use.parameters[name] for name in ("dimension_numbers", "slice_sizes", "mode"))
    dropped = (*how.collapsed_slice_dims, *how.operand_batching_dims)
    kept = [size for dimension, size in enumerate(sizes) if dimension not in dropped]
    parts = np.empty((*indices.shape[:-1], *kept), np.int64)
    for place in np.ndindex(indices.shape[:-1]):
        starts = {d: int(node) for d, node in zip(how.start_index_map, indices[place], strict=True)}
        for dimension, of_indices in zip(how.operand_batching_dims, how.start_indices_batching_dims, strict=True):
            starts[dimension] = graph.constant(place[of_indices], INT)
        part = block_at(graph, array, starts, sizes)
        if mode == jax.lax.GatherScatterMode.FILL_OR_DROP:
            filling, dtype = _filling(use), use.dtypes[0]
            inside = holds_within(graph, starts, np.array(array.shape) - sizes)
            filled = graph.constant(filling, dtype)
            part = np.array([graph.select(inside, filled, int(node)) for node in part.ravel()], np.int64)
        elif mode not in (jax.lax.GatherScatterMode.CLIP, jax.lax.GatherScatterMode.PROMISE_IN_BOUNDS):
            raise NotScalarizable(f"'gather' in the mode {mode} with an index that is computed")
        parts[place] = part.reshape(kept)
    return [np.moveaxis(parts, range(parts.ndim - len(kept), parts.ndim), how.offset_dims)]


def _filling(use: Use) -> Any:
    """What JAX fills with where a place is outside: NaN, the least number, the largest of those with no sign, true."""
    filling, dtype = use.parameters.get("fill_value"), use.types[0]
    if filling is not None:
        return filling
    if dtype.kind == "f":
        return np.nan
    return True if dtype.kind == "b" else np.iinfo(dtype).max if dtype.kind == "u" else np.iinfo(dtype).min


def _names_of_dynamic_slice(graph: Graph, inputs: Sequence[np.ndarray], use: Use) -> list[np.ndarray]:
    array, *starts = inputs
    return [block_at(graph, array, {d: int(node) for d, node in enumerate(starts)}, use.shapes[0])]


def _names_of_dynamic_update_slice(graph: Graph, inputs: Sequence[np.ndarray], use: Use) -> list[np.ndarray]:
    del use
    array, block, *indices = inputs
    starts = {d: graph.bounded(int(node), 0, array.shape[d] - block.shape[d]) for d, node in enumerate(indices)}
    return [changed_at(graph, array, starts, block, lambda _, new: new)]


def _scattering(by: str | None) -> Callable[[Graph, Sequence[np.ndarray], Use], list[np.ndarray]]:
    """`jax.lax.scatter`, and those that add to what is there, multiply it, ...: one block after the other."""

    def names(graph: Graph, inputs: Sequence[np.ndarray], use: Use) -> list[np.ndarray]:
        array, indices, blocks = inputs
        (dtype,) = use.dtypes
        operation = None if by is None else OPERATIONS[by]

        def changed(old: int, new: int) -> int:
            if operation is None:
                return new
            return (
                operation.fold(graph, old, new)
                if operation.fold
                else graph.apply(operation.name, (old, new), dtype, ())
            )

        how, mode = use.parameters["dimension_numbers"], use.parameters["mode"]
        window = how.update_window_dims
        blocks = np.moveaxis(blocks, window, range(blocks.ndim - len(window), blocks.ndim))
        kept = [d for d in range(array.ndim) if d not in (*how.inserted_window_dims, *how.operand_batching_dims)]
        for place in np.ndindex(indices.shape[:-1]):
            starts = {d: int(n) for d, n in zip(how.scatter_dims_to_operand_dims, indices[place], strict=True)}
            for dimension, of_indices in zip(how.operand_batching_dims, how.scatter_indices_batching_dims, strict=True):
                starts[dimension] = graph.constant(place[of_indices], INT)
            sizes = dict(zip(kept, blocks[place].shape, strict=True))
            block = blocks[place].reshape([sizes.get(d, 1) for d in range(array.ndim)])
            if mode == jax.lax.GatherScatterMode.CLIP:
                starts = {d: graph.bounded(n, 0, array.shape[d] - block.shape[d]) for d, n in starts.items()}
            array = changed_at(graph, array, starts, block, changed)
        return [array]

    return names


def _broadcast(inputs: Sequence[np.ndarray], parameters: Any) -> list[np.ndarray]:
    shape, dimensions = parameters["shape"], parameters["broadcast_dimensions"]
    aligned = [1] * len(shape)  # NumPy spreads axes of one entry
    for position, dimension in enumerate(dimensions):
        aligned[dimension] = inputs[0].shape[position]
    return [np.broadcast_to(inputs[0].reshape(aligned), shape)]


def _slice(inputs: Sequence[np.ndarray], parameters: Any) -> list[np.ndarray]:
    strides = parameters["strides"] or (1,) * inputs[0].ndim
    bounds = zip(parameters["start_indices"], parameters["limit_indices"], strides, strict=True)
    return [inputs[0][tuple(slice(*bound) for bound in bounds)]]


def _pad(inputs: Sequence[np.ndarray], parameters: Any) -> list[np.ndarray]:
    array, filling = inputs
    config = parameters["padding_config"]
    # `np.pad` has neither; JAX writes derivatives of strided slices with the latter.
    if any(low < 0 or high < 0 or interior for low, high, interior in config):
        raise NotScalarizable("a negative or interior padding")
    return [np.pad(array, [(low, high) for low, high, _ in config], constant_values=int(filling))]


# Indices that are known when the program runs -------------------------------------------------------------------------


def _strides(shape: Sequence[int]) -> np.ndarray:
    return np.array([int(np.prod(shape[i + 1 :], dtype=int)) for i in range(len(shape))], int)


def _offsets(shape: Sequence[int], sizes: Sequence[int]) -> np.ndarray:
    """Where the entries of a block of an array are, from its first one on."""
    places = np.indices(tuple(sizes)).reshape(len(sizes), -1)
    return (_strides(shape) @ places).astype(int).reshape(tuple(sizes)) if len(sizes) else np.zeros((), int)


def _begin(text: ArrayText, shape: Sequence[int], starts: dict[int, str], room: dict[int, int]) -> str:
    """Where a block begins whose place along some dimensions is known when the program runs; kept within the array."""
    total = "0"
    for dimension, start in starts.items():
        if room[dimension] == 0:
            continue  # wherever it is asked to begin, it begins at 0
        within = text.clamped(start, 0, room[dimension])
        step = text.made(f"mul nsw i64 {within}, {int(_strides(shape)[dimension])}")
        total = step if total == "0" else text.made(f"add nsw i64 {total}, {step}")
    return total


def _dynamic_slice(text, values, parameters, avals):
    (aval,), (source, *starts) = avals, values
    # The place is clamped, so that what is read is always inside: XLA does the same.
    if any(size == 0 for size in aval.shape):
        return [Value(aval.shape, source.kind, "")]
    room = {d: n - size for d, (n, size) in enumerate(zip(source.shape, aval.shape, strict=True))}
    del parameters
    begin = _begin(text, source.shape, {d: text.read(start) for d, start in enumerate(starts)}, room)
    return [text.picked(source, begin, _offsets(source.shape, aval.shape))]


def _to_be_changed(text: ArrayText, value: Value) -> Value:
    """An array to write into: a copy, or where it is large the array itself."""
    if text.stays(value):
        return text.changed(value)  # a copy in each turn would cost more than the turn
    target = text.array(value.shape, value.kind)
    text.copy(value, target)
    return target


def _dynamic_update_slice(text, values, parameters, avals):
    del parameters, avals
    target, source, *starts = values
    if source.size == 0:
        return [target]
    room = {d: n - size for d, (n, size) in enumerate(zip(target.shape, source.shape, strict=True))}
    begin = _begin(text, target.shape, {d: text.read(start) for d, start in enumerate(starts)}, room)
    if target.size == 1:  # a number is no array in memory
        return [source.as_shape(target.shape)]
    target = _to_be_changed(text, target)
    text.put(target, begin, _offsets(target.shape, source.shape), source)
    return [target]


def _row_of(text: ArrayText, indices: Value, row: int, n: int) -> list[str]:
    return [text.read(indices, row * n + i) for i in range(n)]


def _is_inside(text: ArrayText, starts: dict[int, str], room: dict[int, int]) -> str:
    is_inside = "true"
    for dimension, start in starts.items():
        above = text.made(f"icmp sge i64 {start}, 0")
        below = text.made(f"icmp sle i64 {start}, {room[dimension]}")
        is_inside = text.made(f"and i1 {is_inside}, {text.made(f'and i1 {above}, {below}')}")
    return is_inside


LARGEST_GATHER = 64
"""Rows of a gather that is written out, at most: each is a block of instructions."""


def _gather(text, values, parameters, avals):
    (aval,), (source, indices) = avals, values
    how, sizes, mode = parameters["dimension_numbers"], parameters["slice_sizes"], parameters["mode"]
    # Batched indices come from `vmap`; the loop is of a single run.
    if how.operand_batching_dims or not aval.size:
        raise NotWrittenError("a gather by rows")
    if (known := text.numbers_of(indices)) is not None:
        entries = gathered(np.arange(source.size).reshape(source.shape), known, parameters)
        if np.all(entries >= 0):
            return [text.moved([source], np.broadcast_to(entries, aval.shape), source.kind)]
    of_index, n = how.start_index_map, len(how.start_index_map)
    rows = indices.size // n if n else 1
    if rows > LARGEST_GATHER:
        raise NotWrittenError("a gather of many rows")
    room = {d: source.shape[d] - sizes[d] for d in of_index}
    block = _offsets(source.shape, sizes)
    parts = []
    for row in range(rows):
        starts = dict(zip(of_index, _row_of(text, indices, row, n), strict=True))
        part = text.picked(source, _begin(text, source.shape, starts, room), block)
        if mode == jax.lax.GatherScatterMode.FILL_OR_DROP:
            filling = parameters.get("fill_value")
            # JAX fills floats with NaN, and whole numbers by their type, of which nothing is left here.
            if filling is None and source.kind != DOUBLE:
                raise NotWrittenError("a gather that fills in whole numbers")
            inside = _is_inside(text, starts, room)
            instead = text.known(np.asarray(np.nan if filling is None else filling, _DTYPES[source.kind]))
            part = _selected(text, inside, instead, part, part.shape)
        parts.append(part)
    # Which entry stands where, by the rule of names.
    names = np.arange(rows * block.size)
    ids = _placed(names.reshape(rows, *block.shape), indices.shape, how)
    return [text.moved(parts, np.broadcast_to(ids.reshape(aval.shape), aval.shape), source.kind)]


def _placed(parts: np.ndarray, shape: Sequence[int], how: Any) -> np.ndarray:
    """Blocks of a gather in the order of its result."""
    kept = [d for d in range(parts.ndim - 1) if d not in how.collapsed_slice_dims]
    blocks = parts.reshape((*shape[:-1], *(parts.shape[1 + d] for d in kept)))
    return np.moveaxis(blocks, range(len(shape) - 1, blocks.ndim), how.offset_dims)


def _scatter(text, values, parameters, avals):
    del avals
    target, indices, source = values
    how, mode = parameters["dimension_numbers"], parameters["mode"]
    # One block alone: of several the later would have to see what the former have written.
    if how.operand_batching_dims or int(np.prod(indices.shape[:-1])) != 1 or not source.size:
        raise NotWrittenError("a scatter by rows")
    window = iter(source.shape[d] for d in how.update_window_dims)
    sizes = [1 if d in how.inserted_window_dims else next(window) for d in range(len(target.shape))]
    room = {d: target.shape[d] - sizes[d] for d in how.scatter_dims_to_operand_dims}
    starts = dict(zip(room, _row_of(text, indices, 0, len(room)), strict=True))
    begin = _begin(text, target.shape, starts, room)
    inside = "true" if mode == jax.lax.GatherScatterMode.CLIP else _is_inside(text, starts, room)
    if target.size == 1:
        return [_selected(text, inside, target, source, target.shape)]
    changed, offsets = _to_be_changed(text, target), _offsets(target.shape, sizes)
    before = text.picked(changed, begin, offsets)
    # What lies outside is dropped: the block, moved inside, gets back what it had.
    text.put(changed, begin, offsets, _selected(text, inside, before, source.as_shape(offsets.shape), offsets.shape))
    return [changed]


def _scatter_add(text, values, parameters, avals):
    """The transpose of a gather whose indices are known, and all different."""
    (aval,), (target, indices, source) = avals, values
    how, known = parameters["dimension_numbers"], text.numbers_of(indices)
    if known is None or how.operand_batching_dims or not source.size:
        raise NotWrittenError("a scatter whose indices are computed")
    window = iter(source.shape[d] for d in how.update_window_dims)
    sizes = [1 if d in how.inserted_window_dims else next(window) for d in range(len(target.shape))]
    begins = np.zeros((*known.shape[:-1], len(target.shape)), int)
    begins[..., list(how.scatter_dims_to_operand_dims)] = known
    if np.any(begins < 0) or np.any(begins + sizes > target.shape):
        raise NotWrittenError("a scatter with an index out of range")
    kept = [d for d in range(len(sizes)) if d not in how.inserted_window_dims]
    block = _offsets(target.shape, sizes).reshape([sizes[d] for d in kept])
    places = (begins @ _strides(target.shape)).reshape(known.shape[:-1] + (1,) * len(kept)) + block
    places = np.moveaxis(places, range(places.ndim - len(kept), places.ndim), how.update_window_dims).ravel()
    if np.unique(places).size < places.size:
        raise NotWrittenError("a scatter that adds twice in one place")
    # From where each entry comes that is added; the first of all is nothing.
    entries = np.zeros(target.size, int)
    entries[places] = 1 + np.arange(source.size)
    nothing = Value((), target.kind, constant(0, target.kind))
    added = text.moved([nothing, source], entries.reshape(target.shape), target.kind)
    return written_by_entry(text, OPERATIONS["add"], [target, added], {}, [aval])


def _same(text, values, parameters, avals):
    del text, parameters
    return [value.as_shape(aval.shape) for value, aval in zip(values, avals, strict=True)]


# What puts entries together -------------------------------------------------------------------------------------------


def _rows(array: np.ndarray, axes: Sequence[int]) -> np.ndarray:
    """The array as rows to be reduced."""
    kept = [axis for axis in range(array.ndim) if axis not in axes]
    size = int(np.prod([array.shape[axis] for axis in kept], dtype=int))
    count = int(np.prod([array.shape[axis] for axis in axes], dtype=int))
    return array.transpose([*kept, *axes]).reshape(size, count)


def _reduction(name: str, by: str, start: Mapping[np.dtype, Any]) -> ArrayOperation:
    """An operation that puts entries together, two by two.

    Args:
        name: of the primitive.
        by: the operation on two numbers.
        start: what does not change the other one of these, for each type; nothing of the types that are refused.
    """
    operation = OPERATIONS[by]

    def names(graph: Graph, inputs: Sequence[np.ndarray], use: Use) -> list[np.ndarray]:
        (shape,), (dtype,) = use.shapes, use.dtypes

        def joined(a: int, b: int) -> int:
            return operation.fold(graph, a, b) if operation.fold else graph.apply(by, (a, b), dtype, ())

        if dtype not in start:
            raise NotScalarizable(f"{name!r} of {dtype}")
        # From the neutral element on, which sums and products fold away.
        first = graph.constant(start[dtype], dtype)
        rows = _rows(inputs[0], use.parameters["axes"])
        return [np.array([reduce(joined, map(int, row), first) for row in rows], np.int64).reshape(shape)]

    def llvm(text: ArrayText, values: Sequence[Value], parameters: Any, avals: Sequence[Any]) -> list[Value]:
        (aval,), (value,) = avals, values
        kind = value.kind
        call = Call((kind, kind), kind, {})
        if aval.dtype == np.int32 and name in MAY_OVERFLOW:
            raise NotWrittenError(f"{name} of numbers of type {aval.dtype}")
        if value.size == aval.size or not aval.size:
            return [value.as_shape(aval.shape)]  # nothing is put together
        if value.size > LARGEST_WRITTEN_OUT and aval.size > 1:
            raise NotWrittenError(f"{value.size} numbers that are put together")
        if value.size >= text.large:
            raise TooManyEntriesError(f"{value.size} numbers that are put together", value.size)
        if not operation.can_be_llvm(call):
            raise NotWrittenError(f"{name} of {kind}")

        def joined(width: int, a: str, b: str) -> str:
            return operation.in_llvm(text.at(width), call, a, b)

        first = constant(start[np.dtype(_DTYPES[kind])], kind)
        if not value.size:
            return [text.entrywise(aval.shape, kind, [Value((), kind, first)], lambda width, x: x)]
        rows = _rows(np.arange(value.size).reshape(value.shape), parameters["axes"])
        if aval.size == 1:
            return [Value(aval.shape, kind, text.folded(value, rows[0], first, joined))]
        target = text.array(aval.shape, kind)
        # Several sums at once, as vectors, where their entries stand side by side (a sum over the first axis).
        are_side_by_side = np.array_equal(rows, rows[:1] + np.arange(aval.size)[:, None])
        for at, width in chunks(aval.size) if are_side_by_side else [(i, 1) for i in range(aval.size)]:
            if width == 1:
                text.write(target, at, text.folded(value, rows[at], first, joined))
                continue
            total = text.read(value, int(rows[at, 0]), width)
            for entry in rows[at, 1:]:
                total = joined(width, total, text.read(value, int(entry), width))
            text.write(target, at, total, width)
        return [target]

    return ArrayOperation(name=name, names=names, llvm=llvm, reduces=True)


def _cumulative(name: str, by: str) -> ArrayOperation:
    """An operation that puts together each entry with all before it along an axis.

    Args:
        name: of the primitive.
        by: the operation on two numbers.
    """
    operation = OPERATIONS[by]

    def names(graph: Graph, inputs: Sequence[np.ndarray], use: Use) -> list[np.ndarray]:
        (dtype,) = use.dtypes

        def joined(a: int, b: int) -> int:
            return operation.fold(graph, a, b) if operation.fold else graph.apply(by, (a, b), dtype, ())

        rows = [np.moveaxis(inputs[0], use.parameters["axis"], 0)[:: -1 if use.parameters["reverse"] else 1]]
        done = list(accumulate(rows[0], np.vectorize(joined, otypes=[np.int64])))
        done = np.reshape(done, rows[0].shape)[:: -1 if use.parameters["reverse"] else 1]
        return [np.moveaxis(done, 0, use.parameters["axis"])]

    def llvm(text: ArrayText, values: Sequence[Value], parameters: Any, avals: Sequence[Any]) -> list[Value]:
        (aval,), (value,) = avals, values
        call = Call((value.kind, value.kind), value.kind, {})
        if aval.dtype == np.int32 and by in MAY_OVERFLOW:
            raise NotWrittenError(f"{name} of numbers of type {aval.dtype}")
        if parameters["axis"] != 0 or parameters["reverse"] or not operation.can_be_llvm(call):
            raise NotWrittenError(f"{name} from the end, or of another axis than the first")
        if value.size <= 1 or aval.shape[0] == 1:
            return [value]
        if value.size >= text.large:
            raise TooManyEntriesError(f"{name} of {value.size} numbers", value.size)
        n, width = aval.shape[0], value.size // aval.shape[0]
        target = text.array(aval.shape, value.kind)
        for at, wide in chunks(width):
            text.write(target, at, text.read(value, at, wide), wide)

        def turn(i: str) -> None:
            before = text.made(f"mul nsw i64 {i}, {width}")
            for at, wide in chunks(width):
                last, here = (text.made(f"add nsw i64 {before}, {at + skipped}") for skipped in (0, width))
                numbers = text.read(target, last, wide), text.read(value, here, wide)
                text.write(target, here, operation.in_llvm(text.at(wide), call, *numbers), wide)

        text.counted(n - 1, turn)
        return [target]

    return ArrayOperation(name=name, names=names, llvm=llvm, reduces=True)


_LEAST = {FLOAT: -np.inf, INT: np.iinfo(INT).min, BOOL: False}
_MOST = {FLOAT: np.inf, INT: np.iinfo(INT).max, BOOL: True}
_REDUCTIONS = (
    _reduction("reduce_sum", "add", {FLOAT: 0, INT: 0}),
    _reduction("reduce_prod", "mul", {FLOAT: 1, INT: 1}),
    _reduction("reduce_max", "max", _LEAST),
    _reduction("reduce_min", "min", _MOST),
    # All bits of -1 are set; 1 would clear all but the last of each number.
    _reduction("reduce_and", "and", {INT: -1, BOOL: True}),
    _reduction("reduce_or", "or", {INT: 0, BOOL: False}),
)


def _arranged(array: np.ndarray, batch: Sequence[int], summed: Sequence[int]) -> np.ndarray:
    """A factor of `dot_general` as matrices: of each place of the batch, rows that are multiplied and summed."""
    free = [axis for axis in range(array.ndim) if axis not in batch and axis not in summed]
    shape = [int(np.prod([array.shape[axis] for axis in which], dtype=int)) for which in (batch, free, summed)]
    return array.transpose([*batch, *free, *summed]).reshape(shape)


def both_arranged(arrays: Iterable[np.ndarray], parameters: Any) -> tuple[np.ndarray, np.ndarray]:
    """Both factors of `dot_general` as matrices, see `_arranged`."""
    (summed_a, summed_b), (batch_a, batch_b) = parameters["dimension_numbers"]
    left, right = arrays
    return _arranged(left, batch_a, summed_a), _arranged(right, batch_b, summed_b)


def _names_of_product(graph: Graph, inputs: Sequence[np.ndarray], use: Use) -> list[np.ndarray]:
    a, b = both_arranged(inputs, use.parameters)
    # From zero on: a structural zero that the first product replaces.
    zero = graph.constant(0, FLOAT)
    names = [
        reduce(graph.add, (graph.mul(int(x), int(y)) for x, y in zip(row, column, strict=True)), zero)
        for block_a, block_b in zip(a, b, strict=True)
        for row in block_a
        for column in block_b
    ]
    return [np.array(names, np.int64).reshape(use.shapes[0])]


def _dot_general(text, values, parameters, avals):
    (aval,), (left, right) = avals, values
    # XLA has a product over nothing, which is zero, and of whole numbers; runs have neither.
    if left.kind != DOUBLE or right.kind != DOUBLE or not left.size or not right.size:
        raise NotWrittenError("a product of whole numbers")
    a, b = both_arranged((np.arange(v.size).reshape(v.shape) for v in (left, right)), parameters)
    if a.shape[0] * a.shape[1] * b.shape[1] * a.shape[2] > 4 * LARGEST_WRITTEN_OUT:
        raise NotWrittenError("a large product of matrices")
    zero, rows = constant(0.0, DOUBLE), []
    for block_a, block_b in zip(a, b, strict=True):
        n_free, n_summed = block_b.shape
        in_columns = n_free > 1 and np.array_equal(block_b, block_b[:1] + np.arange(n_free)[:, None])
        for row in block_a:
            if in_columns:  # as sums of whole rows of the right one
                for at, width in chunks(n_free):
                    total = text.spread(zero, DOUBLE, width)
                    for k in range(n_summed):
                        factor = text.spread(text.read(left, int(row[k])), DOUBLE, width)
                        total = _times_and_plus(
                            text, width, total, factor, text.read(right, int(block_b[at, k]), width)
                        )
                    rows.append((total, width))
                continue
            for column in block_b:  # else entry by entry
                rows.append((_product(text, left, right, row, column), 1))
    if aval.size == 1:
        return [Value(aval.shape, DOUBLE, rows[0][0])]
    target, at = text.array(aval.shape, DOUBLE), 0
    for name, width in rows:
        text.write(target, at, name, width)
        at += width
    return [target]


def _times_and_plus(text: ArrayText, width: int, total: str, a: str, b: str) -> str:
    typed = vector(DOUBLE, width)
    product = text.made(f"fmul contract {typed} {a}, {b}")
    return text.made(f"fadd contract {typed} {total}, {product}")


def _product(text: ArrayText, left: Value, right: Value, row: np.ndarray, column: np.ndarray) -> str:
    """A sum of products."""
    are_whole = all(np.array_equal(places, places[0] + np.arange(places.size)) for places in (row, column))
    if not are_whole or row.size < 8 or left.size == 1 or right.size == 1:  # a vector has eight numbers
        total = constant(0.0, DOUBLE)
        for i, j in zip(row, column, strict=True):
            total = _times_and_plus(text, 1, total, text.read(left, int(i)), text.read(right, int(j)))
        return total
    size, products = row.size, text.array(row.shape, DOUBLE)
    for at, width in chunks(size):
        a, b = (text.read(factor, int(of[0]) + at, width) for factor, of in ((left, row), (right, column)))
        # Without `contract`: the sum below goes by halves, and has no place for fused additions.
        text.write(products, at, text.made(f"fmul {vector(DOUBLE, width)} {a}, {b}"), width)
    total = ARRAY_OPERATIONS["reduce_sum"].llvm
    assert total is not None
    return total(text, [products], {"axes": (0,)}, [jax.ShapeDtypeStruct((), np.float64)])[0].name


# What is the largest, and what is in order ----------------------------------------------------------------------------


def _place_of(name: str) -> Callable[[Graph, Sequence[np.ndarray], Use], list[np.ndarray]]:
    """The place of the largest or the smallest entry in each row."""

    def names(graph: Graph, inputs: Sequence[np.ndarray], use: Use) -> list[np.ndarray]:
        (shape,) = use.shapes
        rows = _rows(inputs[0], use.parameters["axes"])
        return [np.array([place_of_extreme(graph, name, [*map(int, row)]) for row in rows], np.int64).reshape(shape)]

    return names


def _names_of_sort(graph: Graph, inputs: Sequence[np.ndarray], use: Use) -> list[np.ndarray]:
    dimension, n_keys = use.parameters["dimension"], use.parameters["num_keys"]
    columns = [np.moveaxis(array, dimension, -1) for array in inputs]
    shape = columns[0].shape
    flat = [column.reshape(-1, shape[-1]).copy() for column in columns]
    for row in range(flat[0].shape[0]):
        entries = [tuple(int(column[row, at]) for column in flat) for at in range(shape[-1])]
        for at, entry in enumerate(in_order(graph, entries, n_keys)):
            for column, node in zip(flat, entry, strict=True):
                column[row, at] = node
    return [np.moveaxis(column.reshape(shape), -1, dimension) for column in flat]


# What comes out of nothing --------------------------------------------------------------------------------------------


def _counts(shape: Sequence[int], dimension: int) -> np.ndarray:
    counts = np.arange(shape[dimension]).reshape([-1 if d == dimension else 1 for d in range(len(shape))])
    return np.broadcast_to(counts, shape)


def _names_of_iota(graph: Graph, inputs: Sequence[np.ndarray], use: Use) -> list[np.ndarray]:
    del inputs
    (shape,), (dtype,) = use.shapes, use.dtypes
    counts = _counts(shape, use.parameters["dimension"])
    return [_entrywise(lambda count: graph.constant(count, dtype), counts, shape=shape)]


def _empty(text, values, parameters, avals):
    del values, parameters
    (aval,) = avals  # whatever it is: the derivative of a scan makes room of it
    return [text.known(np.zeros(aval.shape, aval.dtype))]


def _iota(text, values, parameters, avals):
    del values
    (aval,) = avals
    return [text.known(_counts(aval.shape, parameters["dimension"]).astype(aval.dtype))]


# The records ----------------------------------------------------------------------------------------------------------

_ALL = (
    _moving("reshape", lambda inputs, p: [inputs[0].reshape(p["new_sizes"])]),
    _moving("squeeze", lambda inputs, p: [np.squeeze(inputs[0], tuple(p["dimensions"]))]),
    _moving("expand_dims", lambda inputs, p: [np.expand_dims(inputs[0], tuple(p["dimensions"]))]),
    _moving("transpose", lambda inputs, p: [inputs[0].transpose(p["permutation"])]),
    _moving("rev", lambda inputs, p: [np.flip(inputs[0], p["dimensions"])]),
    _moving("slice", _slice),
    _moving("concatenate", lambda inputs, p: [np.concatenate(inputs, p["dimension"])]),
    _moving("stack", lambda inputs, p: [np.stack(inputs, p["axis"])]),
    _moving("unstack", lambda inputs, p: list(np.moveaxis(inputs[0], p["axis"], 0))),
    _moving("split", lambda inputs, p: np.split(inputs[0], np.cumsum(p["sizes"])[:-1], p["axis"])),
    _moving("broadcast_in_dim", _broadcast),
    _moving("pad", _pad),
    _moving("copy", lambda inputs, p: [inputs[0]]),
    _moving("copy_p", lambda inputs, p: [inputs[0]]),
    # No rule for loops: none has been seen in one.
    ArrayOperation(name="tile", names=_names_by_jax),
    ArrayOperation(name="gather", names=_names_of_gather, llvm=_gather),
    ArrayOperation(name="dynamic_slice", names=_names_of_dynamic_slice, llvm=_dynamic_slice),
    ArrayOperation(name="dynamic_update_slice", names=_names_of_dynamic_update_slice, llvm=_dynamic_update_slice),
    # XLA has no way to write most scatters into a kernel; see `native.loop_fusion` for the others.
    ArrayOperation(name="scatter", names=_scattering(None), llvm=_scatter, fuses=False),
    ArrayOperation(name="scatter-sub", names=_scattering("sub"), fuses=False),
    ArrayOperation(name="scatter-mul", names=_scattering("mul"), fuses=False),
    ArrayOperation(name="scatter-min", names=_scattering("min"), fuses=False),
    ArrayOperation(name="scatter-max", names=_scattering("max"), fuses=False),
    ArrayOperation(name="iota", names=_names_of_iota, llvm=_iota),
    ArrayOperation(name="empty2", llvm=_empty, fuses=False),
    ArrayOperation(name="scatter-add", names=_scattering("add"), llvm=_scatter_add, fuses=False),
    *_REDUCTIONS,
    ArrayOperation(name="argmax", names=_place_of("argmax"), fuses=False),
    ArrayOperation(name="argmin", names=_place_of("argmin"), fuses=False),
    ArrayOperation(name="sort", names=_names_of_sort, fuses=False),
    _cumulative("cumsum", "add"),
    _cumulative("cumprod", "mul"),
    _cumulative("cummax", "max"),
    _cumulative("cummin", "min"),
    ArrayOperation(name="dot_general", names=_names_of_product, llvm=_dot_general, reduces=True),
    _solving("symmetric_solve", symmetric_solve),
    _solving("block_solve", block_solve),
    _solving("general_solve", general_solve),
    # Constants that are put to where they are (jax 0.6).
    ArrayOperation(name="device_put", names=lambda graph, inputs, use: list(inputs), fuses=False),
    # A barrier is for XLA alone: machine code has none of what it is a barrier to. The second is equinox's.
    ArrayOperation(name="optimization_barrier", llvm=_same, fuses=False),
    ArrayOperation(name="nonbatchable", llvm=_same),
)

ARRAY_OPERATIONS: dict[str, ArrayOperation] = {operation.name: operation for operation in _ALL}
"""By the names of JAX's primitives."""


# Constants -----------------------------------------------------------------------------------------------------------


def of_constants(name: str, arrays: Sequence[np.ndarray], parameters: Any, avals: Sequence[Any]) -> list | None:
    """What an operation gives of constants, by NumPy: JAX would compile each of them, at 20 ms. None for others."""
    if name == "pad":
        has_gaps = any(interior for *_, interior in parameters["padding_config"])
        return None if has_gaps else [_padded(arrays[0], arrays[1], parameters)]
    if (rule := ARRAY_OPERATIONS.get(name)) is not None and rule.moves is not None:
        return rule.moves(arrays, parameters)
    if name == "iota":
        shape, dimension = avals[0].shape, parameters["dimension"]
        return [np.indices(shape)[dimension].astype(avals[0].dtype)]
    if name == "convert_element_type":
        return [arrays[0].astype(avals[0].dtype)]
    if name == "select_n" and len(arrays) == 3:
        return [np.where(arrays[0], arrays[2], arrays[1])]
    return [_BY_NUMPY[name](*arrays)] if name in _BY_NUMPY else None


_BY_NUMPY: dict[str, Callable] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "neg": np.negative, "eq": np.equal, "ne": np.not_equal,
    "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal,
}  # fmt: skip


def _padded(array: np.ndarray, filling: np.ndarray, parameters: Any) -> np.ndarray:
    config = [(low, high) for low, high, _ in parameters["padding_config"]]
    if any(low < 0 or high < 0 for low, high in config):
        raise NotWrittenError("a negative padding")
    return np.pad(array, config, constant_values=filling.item())

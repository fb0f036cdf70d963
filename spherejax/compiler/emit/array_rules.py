"""Operations of JAX that move entries of arrays, or put them together, as text; see `array_text`."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import numpy as np

from spherejax.compiler.emit import number_rules
from spherejax.compiler.emit.llvm_arrays import (
    LARGE,
    LARGEST_WRITTEN_OUT,
    ArrayText,
    NotWrittenError,
    Value,
    chunks,
    constant,
    kind_of,
    vector,
)
from spherejax.compiler.emit.number_rules import Rule, arithmetic, extremum, logic, select
from spherejax.compiler.rules import MOVES

# What moves entries ---------------------------------------------------------------------------------------------------


def _moves(name: str) -> Rule:
    def rule(text, values, parameters, avals):
        begins = np.cumsum([0, *(value.size for value in values)])
        places = [b + np.arange(v.size).reshape(v.shape) for b, v in zip(begins, values, strict=False)]
        moved = MOVES[name](places, parameters)
        return [
            text.moved(values, np.broadcast_to(entries, aval.shape), kind_of(aval.dtype))
            for entries, aval in zip(moved, avals, strict=True)
        ]

    return rule


def _iota(text, values, parameters, avals):
    del values
    (aval,), at = avals, parameters["dimension"]
    counts = np.arange(aval.shape[at]).reshape([-1 if d == at else 1 for d in range(len(aval.shape))])
    return [text.known(np.broadcast_to(counts, aval.shape).astype(aval.dtype))]


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
            continue
        within = text.clamped(start, 0, room[dimension])
        step = text.made(f"mul nsw i64 {within}, {int(_strides(shape)[dimension])}")
        total = step if total == "0" else text.made(f"add nsw i64 {total}, {step}")
    return total


def _dynamic_slice(text, values, parameters, avals):
    (aval,), (source, *starts) = avals, values
    if any(size == 0 for size in aval.shape):
        return [Value(aval.shape, source.kind, "")]
    room = {d: n - size for d, (n, size) in enumerate(zip(source.shape, aval.shape, strict=True))}
    del parameters
    begin = _begin(text, source.shape, {d: text.read(start) for d, start in enumerate(starts)}, room)
    return [text.picked(source, begin, _offsets(source.shape, aval.shape))]


def _to_be_changed(text: ArrayText, value: Value) -> Value:
    """An array to write into: a copy, or where it is large the array itself."""
    if value.size >= LARGE:
        return text.changed(value)
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
    if target.size == 1:
        return [source.as_shape(target.shape)]
    target = _to_be_changed(text, target)
    text.put(target, begin, _offsets(target.shape, source.shape), source)
    return [target]


def _row_of(text: ArrayText, indices: Value, row: int, n: int) -> list[str]:
    return [text.read(indices, row * n + i) for i in range(n)]


def _is_inside(text: ArrayText, starts: dict[int, str], room: dict[int, int]) -> str:
    found = "true"
    for dimension, start in starts.items():
        above = text.made(f"icmp sge i64 {start}, 0")
        below = text.made(f"icmp sle i64 {start}, {room[dimension]}")
        found = text.made(f"and i1 {found}, {text.made(f'and i1 {above}, {below}')}")
    return found


def _gather(text, values, parameters, avals):
    (aval,), (source, indices) = avals, values
    how, sizes, mode = parameters["dimension_numbers"], parameters["slice_sizes"], parameters["mode"]
    if how.operand_batching_dims or not aval.size:
        raise NotWrittenError("a gather by rows")
    of_index, n = how.start_index_map, len(how.start_index_map)
    rows = indices.size // n if n else 1
    if rows > 64:
        raise NotWrittenError("a gather of many rows")
    room = {d: source.shape[d] - sizes[d] for d in of_index}
    block = _offsets(source.shape, sizes)
    found = []
    for row in range(rows):
        starts = dict(zip(of_index, _row_of(text, indices, row, n), strict=True))
        part = text.picked(source, _begin(text, source.shape, starts, room), block)
        if mode == jax.lax.GatherScatterMode.FILL_OR_DROP:
            filling = parameters.get("fill_value")
            if filling is None and source.kind != "double":
                raise NotWrittenError("a gather that fills in whole numbers")
            inside = Value((), "i1", _is_inside(text, starts, room))
            instead = text.known(np.asarray(np.nan if filling is None else filling, _DTYPES[source.kind]))
            part = select(text, [inside, instead, part], {}, [jax.ShapeDtypeStruct(part.shape, _DTYPES[source.kind])])[
                0
            ]
        found.append(part)
    # Which entry stands where, by the rule of names.
    names = np.arange(rows * block.size)
    ids = _placed(names.reshape(rows, *block.shape), indices.shape, how)
    return [text.moved(found, np.broadcast_to(ids.reshape(aval.shape), aval.shape), source.kind)]


def _placed(parts: np.ndarray, shape: Sequence[int], how: Any) -> np.ndarray:
    """Blocks of a gather in the order of its result."""
    kept = [d for d in range(parts.ndim - 1) if d not in how.collapsed_slice_dims]
    blocks = parts.reshape((*shape[:-1], *(parts.shape[1 + d] for d in kept)))
    return np.moveaxis(blocks, range(len(shape) - 1, blocks.ndim), how.offset_dims)


def _scatter(text, values, parameters, avals):
    del avals
    target, indices, source = values
    how, mode = parameters["dimension_numbers"], parameters["mode"]
    if how.operand_batching_dims or int(np.prod(indices.shape[:-1])) != 1 or not source.size:
        raise NotWrittenError("a scatter by rows")
    window = iter(source.shape[d] for d in how.update_window_dims)
    sizes = [1 if d in how.inserted_window_dims else next(window) for d in range(len(target.shape))]
    room = {d: target.shape[d] - sizes[d] for d in how.scatter_dims_to_operand_dims}
    starts = dict(zip(room, _row_of(text, indices, 0, len(room)), strict=True))
    begin = _begin(text, target.shape, starts, room)
    inside = "true" if mode == jax.lax.GatherScatterMode.CLIP else _is_inside(text, starts, room)
    if target.size == 1:
        which = Value((), "i1", inside)
        return select(text, [which, target, source], {}, [jax.ShapeDtypeStruct(target.shape, _DTYPES[target.kind])])
    changed, offsets = _to_be_changed(text, target), _offsets(target.shape, sizes)
    now = text.picked(changed, begin, offsets)
    which = Value((), "i1", inside)
    flat = source.as_shape(offsets.shape)
    new = select(text, [which, now, flat], {}, [jax.ShapeDtypeStruct(offsets.shape, _DTYPES[target.kind])])[0]
    text.put(changed, begin, offsets, new)
    return [changed]


_DTYPES = {"double": np.float64, "i64": np.int64, "i1": np.bool_}


# What puts entries together -------------------------------------------------------------------------------------------


def _reduced(start: Callable[[str], Any], join: Callable[..., str]) -> Rule:
    """An operation that puts entries together, from what it begins with for a kind of numbers."""

    def rule(text, values, parameters, avals):
        (aval,), (value,) = avals, values
        kind, axes = value.kind, tuple(parameters["axes"])
        if value.size > LARGEST_WRITTEN_OUT:
            raise NotWrittenError(f"{value.size} numbers that are put together")
        if value.size == 1 or not aval.size:
            return [value.as_shape(aval.shape)]
        first, joined = constant(start(kind), kind), partial(join, text, kind, parameters)
        if not value.size:
            return [text.entrywise(aval.shape, kind, [Value((), kind, first)], lambda width, x: x)]
        kept = [d for d in range(len(value.shape)) if d not in axes]
        rows = np.arange(value.size).reshape(value.shape).transpose([*kept, *axes]).reshape(aval.size, -1)
        if aval.size == 1:
            return [Value(aval.shape, kind, text.folded(value, rows[0], first, joined))]
        target = text.array(aval.shape, kind)
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

    return rule


_LEAST = {"double": -np.inf, "i64": -(2**63), "i1": False}
_MOST = {"double": np.inf, "i64": 2**63 - 1, "i1": True}


def _dot_general(text, values, parameters, avals):
    (aval,), (left, right) = avals, values
    (summed_a, summed_b), (batch_a, batch_b) = parameters["dimension_numbers"]
    if left.kind != "double" or right.kind != "double" or not left.size or not right.size:
        raise NotWrittenError("a product of whole numbers")

    def arranged(value, batch, summed):
        free = [d for d in range(len(value.shape)) if d not in batch and d not in summed]
        shape = [int(np.prod([value.shape[d] for d in which], dtype=int)) for which in (batch, free, summed)]
        return np.arange(value.size).reshape(value.shape).transpose([*batch, *free, *summed]).reshape(shape)

    a, b = arranged(left, batch_a, summed_a), arranged(right, batch_b, summed_b)
    if a.shape[0] * a.shape[1] * b.shape[1] * a.shape[2] > 4 * LARGEST_WRITTEN_OUT:
        raise NotWrittenError("a large product of matrices")
    zero, rows = constant(0.0, "double"), []
    for block_a, block_b in zip(a, b, strict=True):
        n_free, n_summed = block_b.shape
        in_columns = n_free > 1 and np.array_equal(block_b, block_b[:1] + np.arange(n_free)[:, None])
        for row in block_a:
            if in_columns:  # as sums of whole rows of the right one
                for at, width in chunks(n_free):
                    total = text.spread(zero, "double", width)
                    for k in range(n_summed):
                        factor = text.spread(text.read(left, int(row[k])), "double", width)
                        total = _times_and_plus(
                            text, width, total, factor, text.read(right, int(block_b[at, k]), width)
                        )
                    rows.append((total, width))
                continue
            for column in block_b:
                rows.append((_product(text, left, right, row, column), 1))
    if aval.size == 1:
        return [Value(aval.shape, "double", rows[0][0])]
    target, at = text.array(aval.shape, "double"), 0
    for name, width in rows:
        text.write(target, at, name, width)
        at += width
    return [target]


def _times_and_plus(text: ArrayText, width: int, total: str, a: str, b: str) -> str:
    typed = vector("double", width)
    product = text.made(f"fmul contract {typed} {a}, {b}")
    return text.made(f"fadd contract {typed} {total}, {product}")


def _product(text: ArrayText, left: Value, right: Value, row: np.ndarray, column: np.ndarray) -> str:
    """A sum of products."""
    are_whole = all(np.array_equal(each, each[0] + np.arange(each.size)) for each in (row, column))
    if not are_whole or row.size < 8 or left.size == 1 or right.size == 1:
        total = constant(0.0, "double")
        for i, j in zip(row, column, strict=True):
            total = _times_and_plus(text, 1, total, text.read(left, int(i)), text.read(right, int(j)))
        return total
    size, products = row.size, text.array(row.shape, "double")
    for at, width in chunks(size):
        a, b = (text.read(each, int(of[0]) + at, width) for each, of in ((left, row), (right, column)))
        text.write(products, at, text.made(f"fmul {vector('double', width)} {a}, {b}"), width)
    (total,) = RULES["reduce_sum"](text, [products], {"axes": (0,)}, [jax.ShapeDtypeStruct((), np.float64)])
    return total.name


# All of them ----------------------------------------------------------------------------------------------------------


def _same(text, values, parameters, avals):
    del text, parameters
    return [value.as_shape(aval.shape) for value, aval in zip(values, avals, strict=True)]


RULES: dict[str, Rule] = {
    **number_rules.RULES,
    **{name: _moves(name) for name in MOVES},
    **dict.fromkeys(("stop_gradient", "optimization_barrier", "nonbatchable"), _same),
    "iota": _iota,
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "gather": _gather,
    "scatter": _scatter,
    "dot_general": _dot_general,
    "reduce_sum": _reduced(lambda kind: 0, arithmetic("add")),
    "reduce_prod": _reduced(lambda kind: 1, arithmetic("mul")),
    "reduce_max": _reduced(lambda kind: _LEAST[kind], extremum("max")),
    "reduce_min": _reduced(lambda kind: _MOST[kind], extremum("min")),
    "reduce_and": _reduced(lambda kind: True, logic("and")),
    "reduce_or": _reduced(lambda kind: False, logic("or")),
}

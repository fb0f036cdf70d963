"""A linear system of blocks in machine code: loops over pivots around one scalar program.

The steps are those of `linear_algebra.blocks`, in the same order. What one pivot does to its own block, to those of its
neighbors and to their right-hand sides is a straight line over numbers; which blocks these are is read from tables.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np

from spherejax.compiler.emit.llvm_arrays import NotWrittenError, Value
from spherejax.compiler.linear_algebra.block_pattern import BlockPattern, Segment
from spherejax.compiler.linear_algebra.blocks import eliminated, product
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.operations import DOUBLE, NotScalarizable
from spherejax.compiler.primitive import StraightLine
from spherejax.compiler.program import scalarize

LARGEST_STEP = 20_000
"""Operations of one pivot's step, at most: those of five equations with four neighbors are 6,000."""


def elimination(writer: Any, values: Sequence[Value], pattern: BlockPattern, smallest_pivot: float) -> Value:
    """The solution of S x = b, shape (n, m, c).

    Args:
        writer: a `ProgramText`.
        values: diagonal blocks, pairs of blocks and right-hand sides of `block_solve`, as they are in memory.
        pattern, smallest_pivot: parameters of `block_solve`.
    """
    text, (diagonal, pairs, right) = writer.text, values
    m, c = right.shape[1:]
    if right.size == 1:  # a number is no array in memory
        raise NotWrittenError("a system of one equation")
    steps = pattern.elimination

    def in_slots(arrays: Sequence[np.ndarray], _: Any) -> list[np.ndarray]:
        own, others, zero = arrays
        sources = np.concatenate([others, np.swapaxes(others, -1, -2), zero])
        return [np.concatenate([own, sources[steps.sources]])]

    blocks = writer.placed(in_slots, [diagonal, pairs, np.zeros((1, m, m))])
    x = writer.placed(lambda arrays, _: [np.concatenate(arrays)], [right, np.zeros((1, m, c))])
    least = text.array((), DOUBLE)
    text.write(least, 0, text.known(np.inf).name)
    kept = []
    for segment in steps.segments:
        n_steps, d = segment.neighbors.shape
        ratios = text.array((n_steps, max(d, 1), m, m), DOUBLE)
        _forward(writer, segment, smallest_pivot, diagonal, blocks, x, least, ratios)
        kept.append(ratios)
    for segment, ratios in zip(reversed(steps.segments), reversed(kept), strict=True):
        _backward(writer, segment, ratios, x)
    # Not positive semi-definite: as `linear_algebra.blocks` answers it.
    number = text.made(f"load double, ptr {least.name}, align 8")
    is_negative = text.made(f"fcmp olt double {number}, {text.known(0.0).name}")
    nothing = text.known(np.nan).name

    def judged(width: int, entry: str) -> str:
        typed = f"<{width} x double>" if width > 1 else "double"
        return text.made(f"select i1 {is_negative}, {typed} {text.spread(nothing, DOUBLE, width)}, {typed} {entry}")

    solution = x._replace(shape=right.shape)
    return text.entrywise(right.shape, DOUBLE, [solution], judged)


def _forward(
    writer: Any,
    segment: Segment,
    smallest_pivot: float,
    diagonal: Value,
    blocks: Value,
    x: Value,
    least: Value,
    ratios: Value,
) -> None:
    """Eliminate the pivots of a segment, in place."""
    text = writer.text
    m, c = diagonal.shape[-1], x.shape[-1]
    n_steps, d = segment.neighbors.shape
    name = writer.function(_step_line(m, c, d, smallest_pivot), (), (0,) * (4 + 2 * d + d * (d + 1) // 2))

    def step(s: str) -> None:
        at_blocks = [_at(text, blocks, segment.pivot, s, m * m)]
        at_blocks += [_at(text, blocks, segment.blocks[:, a], s, m * m) for a in range(d)]
        changed = [_at(text, blocks, segment.updates[:, u], s, m * m) for u in range(segment.updates.shape[1])]
        row = _at(text, x, segment.pivot, s, m * c)
        near = [_at(text, x, segment.neighbors[:, a], s, m * c) for a in range(d)]
        own = _at(text, diagonal, segment.pivot, s, m * m)
        place = text.made(f"mul nsw i64 {s}, {max(d, 1) * m * m}")
        targets = [(row, m * c), (least.name, 1), *((each, m * c) for each in near), *((u, m * m) for u in changed)]
        # A function's results overlap none of its arguments: they are copied to their places behind it.
        results = [text.array((max(size, 2),), DOUBLE) for _, size in targets]  # one number alone would be no array
        pointers = [own, at_blocks[0], row, least.name, *at_blocks[1:], *near, *changed]
        pointers += [text.pointer(ratios, place), *(result.name for result in results)]
        text.say(f"call void @{name}({', '.join(f'ptr {pointer}' for pointer in pointers)})")
        for (target, size), result in zip(targets, results, strict=True):
            text.through(
                size, lambda i, w, t=target, r=result: text.write(r._replace(name=t), i, text.read(r, i, w), w)
            )

    text.counted(n_steps, step)


def _backward(writer: Any, segment: Segment, ratios: Value, x: Value) -> None:
    """Substitution, in place."""
    text = writer.text
    m, c = x.shape[1:]
    n_steps, d = segment.neighbors.shape
    if not d:
        return
    name = writer.function(_back_line(m, c, d), (), (0,) * (2 + d))

    def step(i: str) -> None:
        s = text.made(f"sub nsw i64 {n_steps - 1}, {i}")
        row = _at(text, x, segment.pivot, s, m * c)
        near = [_at(text, x, segment.neighbors[:, a], s, m * c) for a in range(d)]
        place = text.made(f"mul nsw i64 {s}, {d * m * m}")
        result = text.array((max(m * c, 2),), DOUBLE)
        pointers = [row, text.pointer(ratios, place), *near, result.name]
        text.say(f"call void @{name}({', '.join(f'ptr {pointer}' for pointer in pointers)})")
        text.through(m * c, lambda i, w: text.write(result._replace(name=row), i, text.read(result, i, w), w))

    text.counted(n_steps, step)


def _at(text: Any, array: Value, numbers: np.ndarray, s: str, size: int) -> str:
    """Where the block is whose number a table has for a step."""
    table = text.known(np.asarray(numbers, np.int64) * size)
    return text.pointer(array, table.name if table.size == 1 else text.read(table, s))


@lru_cache(maxsize=64)
def _step_line(m: int, c: int, d: int, smallest_pivot: float) -> StraightLine:
    """One pivot's step."""

    def step(own, pivot, row, least, *others):
        below, near, changed = others[:d], others[d : 2 * d], others[2 * d :]
        scale = jnp.stack([own[i, i] for i in range(m)])
        stacked = jnp.stack(below) if d else jnp.zeros((0, m, m))
        solved, ratios, changes, moved = eliminated(pivot, smallest_pivot * scale, stacked, row)
        results = [ratios if d else jnp.zeros((1, m, m)), solved, jnp.minimum(least, jnp.min(scale))]
        return [*results, *(x - moved[a] for a, x in enumerate(near)), *(x - changes[u] for u, x in enumerate(changed))]

    shapes = [(m, m), (m, m), (m, c), (), *[(m, m)] * d, *[(m, c)] * d, *[(m, m)] * (d * (d + 1) // 2)]
    return _line(step, shapes)


@lru_cache(maxsize=64)
def _back_line(m: int, c: int, d: int) -> StraightLine:
    """One row's substitution."""

    def step(row, ratios, *near):
        return row - jnp.sum(product(ratios, jnp.stack(near)), 0)

    return _line(step, [(m, c), (d, m, m), *[(m, c)] * d])


def _line(function: Any, shapes: Sequence[tuple[int, ...]]) -> StraightLine:
    examples = [np.zeros(shape) for shape in shapes]
    try:
        with machine_code.native_code(True):
            made = scalarize(function, *examples, n_ahead=0, maximum_operations=LARGEST_STEP, has_slopes=False)
            return made.line_called()
    except NotScalarizable as reason:
        raise NotWrittenError(f"a step of an elimination: {reason}") from reason

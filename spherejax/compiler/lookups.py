"""Names of nodes at places that are computed, and in an order that is: tables, searches for the largest, sorts.

In an array of names an entry at a computed place is one of several by a whole number (`Graph.lookup`), and an order is
a network of exchanges. Places and keys that are known fold: the names then only move.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from spherejax.compiler.graph import Graph
from spherejax.compiler.operations import BOOL, FLOAT, INT, NotScalarizable

# Tables ---------------------------------------------------------------------------------------------------------------


def holds_within(graph: Graph, starts: Mapping[int, int], room: np.ndarray) -> int:
    """A truth: whether a block that begins at a place lies within an array."""
    holds = graph.constant(True, BOOL)
    for dimension, start in starts.items():
        for word, bound in (("ge", 0), ("le", room[dimension])):
            compared = graph.apply(word, (start, graph.constant(bound, INT)), BOOL)
            low, high = graph.limits(start)
            if not (low >= bound if word == "ge" else high <= bound):
                holds = graph.both(holds, compared)
    return holds


def block_at(graph: Graph, array: np.ndarray, starts: Mapping[int, int], sizes: Sequence[int]) -> np.ndarray:
    """Names of a block of an array that begins at a place, and is moved inside where it would begin outside."""
    room = np.array(array.shape, int) - np.array(sizes, int)
    # All blocks there may be, along one axis that is counted as the place is; those along known places are one.
    low, high = np.zeros(array.ndim, int), np.zeros(array.ndim, int)
    place = graph.constant(0, INT)
    for dimension, start in starts.items():
        start = graph.bounded(start, 0, int(room[dimension]))
        low[dimension], high[dimension] = graph.limits(start)
        if low[dimension] == high[dimension]:
            continue
        n_places = graph.constant(high[dimension] - low[dimension] + 1, INT)
        place = graph.add(graph.mul(place, n_places), graph.sub(start, graph.constant(low[dimension], INT)))
    n_blocks = [int(high[dimension] - low[dimension] + 1) for dimension in starts]
    if int(np.prod(n_blocks)) * int(np.prod(sizes)) > LARGEST_BLOCKS:
        raise NotScalarizable(f"a table of {array.size} entries that is read at a computed place")
    blocks = []
    for at in np.ndindex(*n_blocks):
        begin = low.copy()
        begin[list(starts)] += np.array(at, int)
        blocks.append(array[tuple(slice(b, b + size) for b, size in zip(begin, sizes, strict=True))].ravel())
    rows = np.stack(blocks, 1)  # of each entry of the block the names there may be
    names = [graph.lookup(place, [int(node) for node in row]) for row in rows]
    return np.array(names, np.int64).reshape(tuple(sizes))


LARGEST_BLOCKS = 16 * 4096
"""Names in all blocks of an array that one may be read from, at most."""


def changed_at(
    graph: Graph, array: np.ndarray, starts: Mapping[int, int], block: np.ndarray, changed: Callable[[int, int], int]
) -> np.ndarray:
    """Names of an array of which a block is changed that begins at a place; where it would be outside nothing is.

    Args:
        block: names that the entries are changed by, with all dimensions of the array.
        changed: from an entry and one of the block to what stands there then.
    """
    array, room = array.copy(), np.array(array.shape, int) - np.array(block.shape, int)
    before = array.copy()
    ranges = []
    for dimension, start in starts.items():
        low, high = graph.limits(start)
        ranges.append(range(max(low, 0), min(high, int(room[dimension])) + 1))
    if int(np.prod([len(places) for places in ranges])) * block.size > LARGEST_BLOCKS:
        raise NotScalarizable(f"an array of {array.size} entries that is changed at a computed place")
    for at in itertools.product(*ranges):
        is_here = graph.constant(True, BOOL)
        for start, place in zip(starts.values(), at, strict=True):
            is_here = graph.both(is_here, graph.apply("eq", (start, graph.constant(place, INT)), BOOL))
        begin = dict(zip(starts, at, strict=True))
        for offset in np.ndindex(block.shape):
            entry = tuple(begin.get(dimension, 0) + step for dimension, step in enumerate(offset))
            then = changed(int(before[entry]), int(block[offset]))
            array[entry] = graph.select(is_here, int(array[entry]), then)
    return array


# The largest, and orders ----------------------------------------------------------------------------------------------


def place_of_extreme(graph: Graph, name: str, row: Sequence[int]) -> int:
    """The place of the largest (`argmax`) or the smallest entry: the first of equal ones, and NaN before all else."""
    best, place = row[0], graph.constant(0, INT)
    for at, entry in enumerate(row[1:], 1):
        is_better = _is_better(graph, name, entry, best)
        if graph.dtypes[entry] == BOOL:  # the best truth so far, without a selection
            best = (graph.either if name == "argmax" else graph.both)(best, entry)
        else:
            best = graph.select(is_better, best, entry)
        place = graph.select(is_better, place, graph.constant(at, INT))
    return place


def _is_better(graph: Graph, name: str, entry: int, best: int) -> int:
    dtype = graph.dtypes[entry]
    if dtype == BOOL:
        first, second = (best, entry) if name == "argmax" else (entry, best)
        return graph.both(graph.apply("not", (first,)), second)
    if dtype == INT:
        return graph.apply("gt" if name == "argmax" else "lt", (entry, best), BOOL)
    # Not the opposite comparison: of NaN each is false.
    is_no_better = graph.apply("le" if name == "argmax" else "ge", (entry, best), BOOL)
    is_number = graph.apply("eq", (best, best), BOOL)
    return graph.both(graph.apply("not", (is_no_better,)), is_number)


LARGEST_INSERTED, LARGEST_SORTED = 16, 64
"""Numbers that are sorted by exchanges of neighbors, and by exchanges at all: n (n - 1) / 2 of the former, of the
latter some n log(n)^2 / 4, each of which needs more operations."""


def in_order(graph: Graph, entries: list[tuple[int, ...]], n_keys: int) -> list[tuple[int, ...]]:
    """Tuples of names in the order of the first ones: equal ones stay in their order, and NaN is last."""
    n = len(entries)
    if all(graph.is_constant(key) for entry in entries for key in entry[:n_keys]):
        return sorted(entries, key=lambda entry: [_key(graph.value(key)) for key in entry[:n_keys]])
    if n > LARGEST_SORTED:
        raise NotScalarizable(f"'sort' of {n} numbers")
    is_inserted = n <= LARGEST_INSERTED
    pairs = _pairs_of_neighbors(n) if is_inserted else _pairs_of_merges(n)
    if not is_inserted:  # exchanges over a distance may pass equal ones: their places are a last key
        entries = [(*entry[:n_keys], graph.constant(at, INT), *entry[n_keys:]) for at, entry in enumerate(entries)]
    n_compared = n_keys if is_inserted else n_keys + 1
    for i, j in pairs:
        first, second = entries[i], entries[j]
        is_wrong = _is_before(graph, second[:n_compared], first[:n_compared])
        entries[i] = tuple(graph.select(is_wrong, a, b) for a, b in zip(first, second, strict=True))
        entries[j] = tuple(graph.select(is_wrong, b, a) for a, b in zip(first, second, strict=True))
    return entries if is_inserted else [(*entry[:n_keys], *entry[n_keys + 1 :]) for entry in entries]


def _key(value: Any) -> tuple[bool, Any]:
    return bool(value != value), 0 if value != value else value  # NaN is not ordered by itself


def _is_before(graph: Graph, a: Sequence[int], b: Sequence[int]) -> int:
    """Whether a stands before b, by their first keys that differ."""
    is_before = graph.constant(False, BOOL)
    for x, y in reversed([*zip(a, b, strict=True)]):
        if graph.dtypes[x] == FLOAT:
            is_number = graph.apply("eq", (x, x), BOOL)
            first = graph.both(graph.apply("not", (graph.apply("le", (y, x), BOOL),)), is_number)
            not_behind = graph.either(graph.apply("le", (x, y), BOOL), graph.apply("ne", (y, y), BOOL))
        elif graph.dtypes[x] == BOOL:
            first = graph.both(graph.apply("not", (x,)), y)
            not_behind = graph.either(graph.apply("not", (x,)), y)
        else:
            first, not_behind = (graph.apply(word, (x, y), BOOL) for word in ("lt", "le"))
        is_before = graph.either(first, graph.both(not_behind, is_before))
    return is_before


def _pairs_of_neighbors(n: int) -> list[tuple[int, int]]:
    return [(j - 1, j) for i in range(1, n) for j in range(i, 0, -1)]


def _pairs_of_merges(n: int) -> list[tuple[int, int]]:
    """D. E. Knuth, The Art of Computer Programming 3, algorithm 5.2.2 M: Batcher's exchanges for any count."""
    pairs, largest = [], 1 << ((n - 1).bit_length() - 1)
    p = largest
    while p:
        q, r, d = largest, 0, p
        while True:
            pairs += [(i, i + d) for i in range(n - d) if i & p == r]
            if q == p:
                break
            q, r, d = q // 2, p, q - p
        p //= 2
    return pairs

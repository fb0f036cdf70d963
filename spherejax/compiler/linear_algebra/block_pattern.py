"""Which blocks of a symmetric matrix exist, in which order they are eliminated, and what fills in (all static)."""

import heapq
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Int


@dataclass(frozen=True)
class BlockPattern:
    """A symmetric matrix of square blocks.

    Attributes:
        n_blocks: number of block rows.
        pairs: the blocks (i, j), i < j, off the diagonal that exist.
    """

    n_blocks: int
    pairs: tuple[tuple[int, int], ...]

    # A static argument of every call of the solve, whose pairs would be hashed each time.
    @cached_property
    def _hash(self) -> int:
        return hash((self.n_blocks, self.pairs))

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def rows(self) -> Int[np.ndarray, " e"]:
        """Block row i of each pair."""
        return np.array([i for i, _ in self.pairs], int)

    @cached_property
    def columns(self) -> Int[np.ndarray, " e"]:
        """Block column j of each pair."""
        return np.array([j for _, j in self.pairs], int)

    @cached_property
    def elimination(self) -> "Elimination":
        """The order of elimination and what each step touches."""
        return _elimination(self)


class Segment(NamedTuple):
    """Consecutive steps of an elimination that have room for the same number of neighbors.

    Attributes:
        pivot: block row that each step eliminates, shape (n_steps,).
        neighbors: rows that are still to come and have a block in the pivot's column, in the order in which they come;
            a step with fewer has the row `n_blocks`, which is empty. Shape (n_steps, d).
        blocks: the slots of these blocks, shape (n_steps, d).
        updates: the slots of the blocks that each pair (a, b), a <= b, of neighbors changes, pair after pair, shape
            (n_steps, d (d + 1) / 2).
    """

    pivot: Int[np.ndarray, " s"]
    neighbors: Int[np.ndarray, "s d"]
    blocks: Int[np.ndarray, "s d"]
    updates: Int[np.ndarray, "s u"]


class Elimination(NamedTuple):
    """Elimination of all block rows, in slots: first the diagonal ones by row, then those below the diagonal.

    Attributes:
        sources: where the start of each slot below the diagonal is: pair e, or pair e transposed as n_pairs + e, or
            2 n_pairs for a block that fills in. The last slot stays empty.
        segments: the steps, one segment after the other.
    """

    sources: Int[np.ndarray, " f"]
    segments: tuple[Segment, ...]


def minimum_degree_order(neighbors: Mapping[int, Iterable[int]], without_pivot: Iterable[int] = ()) -> list[int]:
    """Elimination order that takes, again and again, the row with the fewest neighbors (Tinney's second scheme).

    A row `without_pivot`, whose diagonal entry is a structural zero, waits for all its neighbors: they make its pivot,
    and only all of them together make one that cannot vanish.
    """
    remaining = {i: set(joined) for i, joined in neighbors.items()}
    awaited = {i: set(remaining[i]) for i in without_pivot}

    def rank(i):
        return (len(awaited.get(i, ())), len(remaining[i]), i)

    queue = [rank(i) for i in remaining]
    heapq.heapify(queue)
    order = []
    while queue:
        entry = heapq.heappop(queue)
        row = entry[-1]
        if row not in remaining or entry != rank(row):
            # A heap cannot change an entry: a row whose rank has changed has several, of which the last one counts.
            continue  # an earlier rank of a row that has changed, or is gone
        joined = remaining.pop(row)
        for i in joined:
            # Eliminating a row joins all of its neighbors with each other: this is the fill-in.
            remaining[i] = (remaining[i] | joined) - {i, row}
            if i in awaited:
                awaited[i].discard(row)
            heapq.heappush(queue, rank(i))
        order.append(row)
    return order


def _elimination(pattern: BlockPattern) -> Elimination:
    joined: dict[int, set[int]] = {i: set() for i in range(pattern.n_blocks)}
    for i, j in pattern.pairs:
        joined[i].add(j)
        joined[j].add(i)
    order = minimum_degree_order(joined)
    place = {row: position for position, row in enumerate(order)}
    # The elimination is played through once on the pattern, so that every block that fills in has its slot before.
    later: list[list[int]] = []
    for row in order:
        # In the order of elimination: of a pair of neighbors the block stands below the diagonal then.
        coming = sorted((i for i in joined[row] if place[i] > place[row]), key=lambda i: place[i])
        for i in coming:
            joined[i].update(k for k in coming if k != i)
        later.append(coming)
    number = {pair: e for e, pair in enumerate(pattern.pairs)}
    sources, slot = [], {}
    for row, coming in zip(order, later, strict=True):
        for i in coming:
            slot[i, row] = pattern.n_blocks + len(sources)
            # Stored with rows of i and columns of the pivot: as it is given for i < row, else transposed.
            transposed = number.get((row, i), len(number)) + len(number)
            sources.append(number.get((i, row), transposed))
    sources.append(2 * len(number))
    return Elimination(np.array(sources, int), _segments(pattern.n_blocks, order, later, slot, len(sources) - 1))


def _segments(n_blocks: int, order, later, slot, n_below: int) -> tuple[Segment, ...]:
    empty = n_blocks + n_below
    # Loops need the same number of neighbors in each turn. Room grows by factors of two and never shrinks, so that
    # there are few loops, one behind the other, and at most half of the work is on empty blocks.
    room, rooms = 0, []
    for coming in later:
        while room < len(coming):
            room = 2 * room or 1
        rooms.append(room)
    segments = []
    for d in sorted(set(rooms)):
        steps = [s for s, r in enumerate(rooms) if r == d]
        neighbors = np.full((len(steps), d), n_blocks)
        blocks = np.full((len(steps), d), empty)
        updates = np.full((len(steps), d * (d + 1) // 2), empty)
        pairs = [(a, b) for a in range(d) for b in range(a, d)]
        for position, s in enumerate(steps):
            coming = later[s]
            neighbors[position, : len(coming)] = coming
            blocks[position, : len(coming)] = [slot[i, order[s]] for i in coming]
            for column, (a, b) in enumerate(pairs):
                if b < len(coming):
                    updates[position, column] = coming[a] if a == b else slot[coming[b], coming[a]]
        segments.append(Segment(np.array([order[s] for s in steps], int), neighbors, blocks, updates))
    return tuple(segments)

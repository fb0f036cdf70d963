"""Long sums of products in a straight line, as loops over vectors: products of matrices that are arguments.

A network of 64 x 64 weights is four thousand products and sums. Written one by one LLVM evaluates them number by number
and takes seconds to compile them. Here three shapes are recognized in the graph, where they come from a product of a
matrix with a vector, from its derivative, or from its transpose:

    a dot      sum_k W_k b_k, in which the W_k stand side by side in an argument
    dots       several of the same b_k, a distance apart: sum_k W_jk b_k, j = 0, 1, ...
    columns    sums of the same b_k for places of W_k that follow each other: sum_k W_kj b_k, j = 0, 1, ...
    rows       results a b_j that stand side by side

A dot is summed in sixteen parts, several are in eight, so that they differ by rounding from a sum from left to right.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from spherejax.compiler.operations import FLOAT

SHORTEST = 16
"""Products that are a loop, at least: two vectors."""

FEWEST_DOTS = 8
"""Dots that are evaluated together, at least: they are evaluated eight at a time."""

FEWEST = 200
"""Products in loops of a line, at least. Mechanisms have a sum of some twenty here and there: a loop gains nothing, and
its sum differs by rounding from that of the same line for many runs, which has no loops."""


LEAST_DEFERRED = 8
"""Products for each number of the vector from which a caller evaluates them, at least."""


class Dot(NamedTuple):
    """Products whose first factors stand side by side.

    Attributes:
        first: argument and entry of the first one.
        others: nodes of the second factors.
    """

    first: tuple[int, int]
    others: tuple[int, ...]


class Columns(NamedTuple):
    """Products of several sums, whose first factors are a distance apart.

    Attributes:
        first: argument and entry of the first one, of the first sum.
        stride: distance of the next one, in the same sum.
        others: nodes of the second factors.
        n: how many sums; the first factors of the next sum stand beside those of this one.
    """

    first: tuple[int, int]
    stride: int
    others: tuple[int, ...]
    n: int


class Dots(NamedTuple):
    """Products of several sums, whose first factors stand side by side.

    Attributes:
        first: argument and entry of the first one, of the first sum.
        stride: distance of the first one of the next sum.
        others: nodes of the second factors.
        n: how many sums.
    """

    first: tuple[int, int]
    stride: int
    others: tuple[int, ...]
    n: int


class WeightedSum(NamedTuple):
    """A node that is a sum.

    Attributes:
        dots: parts of it.
        together: parts of it that are evaluated with those of other sums, with the place among these.
        rest: other nodes that are added.
    """

    dots: tuple[Dot, ...]
    together: tuple[tuple[Columns | Dots, int], ...]
    rest: tuple[int, ...]


class MultipleRow(NamedTuple):
    """Results that are multiples of other nodes.

    Attributes:
        factor: a node.
        others: nodes that it is multiplied with.
        products: the results.
    """

    factor: int
    others: tuple[int, ...]
    products: tuple[int, ...]


class RowBlock(NamedTuple):
    """Rows of a result that are multiples of the same nodes, a distance apart: a product b x^T.

    Attributes:
        entry, stride: where the first row begins, and how far behind it the next one.
        n_rows, n_columns: how many rows, and of how many numbers.
        place: in a vector, where b begins, and x behind it.
    """

    entry: int
    stride: int
    n_rows: int
    n_columns: int
    place: int


class DeferredRows(NamedTuple):
    """The rows of a result that a caller evaluates, from a vector with the b and x of all of them.

    Attributes:
        blocks: the rows.
        factors, others: by the entry at which a row, or a block, begins: the place of its b, or its x.
        size: of the vector.
    """

    blocks: tuple[RowBlock, ...]
    factors: Mapping[int, int]
    others: Mapping[int, int]
    size: int


class Loops(NamedTuple):
    """What is written as loops.

    Attributes:
        sums: by node.
        rows: by result and its entry at which they begin.
        written: nodes that are written one by one; arguments are read for them, and for `sums` and `rows`.
    """

    sums: dict[int, WeightedSum]
    rows: dict[tuple[int, int], MultipleRow]
    written: frozenset[int]

    @property
    def n_products(self) -> int:
        """How many products there are in the loops."""
        of_sums = [
            part for total in self.sums.values() for part in (*total.dots, *(whole for whole, _ in total.together))
        ]
        return sum(len(part.others) for part in (*of_sums, *self.rows.values()))


def loops_of(line: Any, place: Mapping[int, tuple[int, int]]) -> Loops | None:
    """The loops of a line; None where they are not worth it.

    Args:
        line: what is evaluated.
        place: for nodes that are arguments, which one and which entry of it.
    """
    if len(line.nodes) < FEWEST:
        return None
    loops = _LoopSearch(line, place).loops()
    return loops if loops.n_products >= FEWEST else None


def deferred_rows(loops: Loops | None, result: int) -> DeferredRows | None:
    """The rows of a result, where a vector of their factors is much shorter than they are; else None."""
    rows = [] if loops is None else sorted((at, row) for (i, at), row in loops.rows.items() if i == result)
    blocks: list[RowBlock] = []
    others: tuple[int, ...] = ()
    for at, row in rows:
        last = blocks[-1] if blocks else None
        # The second row of a block tells how far apart they are.
        stride = 0 if last is None else at - last.entry if last.n_rows == 1 else last.stride
        if last is not None and row.others == others and at == last.entry + last.n_rows * stride:
            blocks[-1] = last._replace(n_rows=last.n_rows + 1, stride=stride)
        else:
            place = 0 if last is None else last.place + last.n_rows + last.n_columns
            blocks.append(RowBlock(at, len(row.others), 1, len(row.others), place))
        others = row.others
    size = blocks[-1].place + blocks[-1].n_rows + blocks[-1].n_columns if blocks else 0
    if sum(block.n_rows * block.n_columns for block in blocks) < LEAST_DEFERRED * max(size, 1):
        return None
    return DeferredRows(
        tuple(blocks),
        {block.entry + k * block.stride: block.place + k for block in blocks for k in range(block.n_rows)},
        {block.entry: block.place + block.n_rows for block in blocks},
        size,
    )


class _SumParts(NamedTuple):
    """A sum while it is looked at.

    Attributes:
        dots, columns: what loops could be made of, each with its products.
        rest: other terms.
        inner: additions in it that nobody else reads.
    """

    dots: list[tuple[Dot, list[int]]]
    columns: list[tuple[Columns, list[int]]]
    rest: list[int]
    inner: list[int]


class _LoopSearch:
    """Looks for the three shapes among the nodes of a line."""

    def __init__(self, line: Any, place: Mapping[int, tuple[int, int]]):
        self.line, self.graph, self.place = line, line.graph, place
        self.sizes = [int(np.prod(shape)) for shape in line.shapes] + [group.size for group in line.residuals]
        self.results = [[int(node) for node in output.ravel()] for output in line.outputs]
        self.uses: Counter[int] = Counter(node for result in self.results for node in result)
        for node in line.nodes:
            if node not in place:
                self.uses.update(self.graph.arguments[node])

    def loops(self) -> Loops:
        rows = self._rows()
        sums, absorbed = self._sums()
        for row in rows.values():
            absorbed.update(row.products)
        # From the results back: what is read by what is written.
        in_rows = {(i, at + k) for (i, at), row in rows.items() for k in range(len(row.others))}
        needed = {n for i, r in enumerate(self.results) for at, n in enumerate(r) if (i, at) not in in_rows}
        for row in rows.values():
            needed.update(self._read((row.factor,), row.others))
        for node in reversed(self.line.nodes):
            if node in sums:
                parts = sums[node]
                factors = [dot.others for dot in parts.dots] + [whole.others for whole, _ in parts.together]
                needed.update(self._read(parts.rest, *factors))
            elif node in needed and node not in self.place:
                needed.update(self.graph.arguments[node])
        return Loops(sums, rows, frozenset(needed - absorbed))

    def _read(self, nodes: Sequence[int], *factors: tuple[int, ...]) -> set[int]:
        """Nodes that are read one by one, and factors that do not stand side by side in an argument."""
        return set(nodes).union(*(others for others in factors if self._beside(others) is None))

    def _beside(self, nodes: Sequence[int]) -> tuple[int, int] | None:
        return beside([self.place.get(node) for node in nodes])

    # Sums -------------------------------------------------------------------------------------------------------------

    def _sums(self) -> tuple[dict[int, WeightedSum], set[int]]:
        """Sums with loops in them, and the nodes that need not be written for them."""
        inner: set[int] = set()
        parts: dict[int, _SumParts] = {}
        for node in reversed(self.line.nodes):
            if node in inner or not self._is("add", node):
                continue
            sums, terms = self._flat(node)
            inner.update(sums)
            products = [term for term in terms if self.uses[term] == 1 and self._is("mul", term)]
            if len(products) < SHORTEST:
                continue
            dots, columns = self._runs(products)
            if dots or columns:
                taken = {product for _, run in [*dots, *columns] for product in run}
                parts[node] = _SumParts(dots, columns, [term for term in terms if term not in taken], sums)
        together = self._together({node: own.columns for node, own in parts.items()})
        side_by_side = self._dots_together({node: own.dots for node, own in parts.items()})
        with_loops, absorbed = {}, set()
        for node, (dots, columns, rest, sums) in parts.items():
            of_columns, left = [], []
            for own, run in columns:
                if (node, own) in together:
                    of_columns.append(together[node, own])
                    absorbed.update(run)
                else:
                    left += run
            if not dots and not of_columns:
                continue
            alone = []
            for dot, run in dots:
                absorbed.update(run)
                if (node, dot) in side_by_side:
                    of_columns.append(side_by_side[node, dot])
                else:
                    alone.append(dot)
            absorbed.update(sums)
            with_loops[node] = WeightedSum(tuple(alone), tuple(of_columns), (*rest, *left))
        return with_loops, absorbed

    def _is(self, operation: str, node: int) -> bool:
        is_it = node not in self.place and self.graph.operations[node] == operation
        return is_it and self.graph.dtypes[node] == FLOAT

    def _flat(self, root: int) -> tuple[list[int], list[int]]:
        """The additions that nobody reads but the next one, and what they add, in order."""
        sums, terms, waiting = [], [], [root]
        while waiting:
            node = waiting.pop()
            if node == root or (self.uses[node] == 1 and self._is("add", node)):
                sums.append(node)
                waiting += reversed(self.graph.arguments[node])
            else:
                terms.append(node)
        return [node for node in sums if node != root], terms

    def _runs(self, products: Sequence[int]) -> tuple[list[tuple[Dot, list[int]]], list[tuple[Columns, list[int]]]]:
        """Products whose first factors are side by side, or the same distance apart in one argument."""
        factors = sorted((*self._factors(product), product) for product in products if self._has_place(product))
        dots, columns, begin = [], [], 0
        while begin < len(factors):
            argument, entry = factors[begin][0]
            stride, end = 0, begin + 1
            while end < len(factors) and factors[end][0][0] == argument:
                step = factors[end][0][1] - factors[end - 1][0][1]
                if step <= 0 or (stride and step != stride):
                    break
                stride, end = step, end + 1
            run = factors[begin:end]
            if len(run) >= SHORTEST:
                others, nodes = tuple(other for _, other, _ in run), [product for *_, product in run]
                if stride == 1:
                    dots.append((Dot((argument, entry), others), nodes))
                else:
                    columns.append((Columns((argument, entry), stride, others, 0), nodes))
                begin = end
            else:
                begin += 1
        return dots, columns

    def _has_place(self, product: int) -> bool:
        return any(factor in self.place for factor in self.graph.arguments[product])

    def _factors(self, product: int) -> tuple[tuple[int, int], int]:
        """The place of one factor, and the other one: of two arguments the larger one is the matrix."""
        a, b = self.graph.arguments[product]
        sizes = [self.sizes[self.place[x][0]] if x in self.place else -1 for x in (a, b)]
        first, other = (a, b) if sizes[0] >= sizes[1] else (b, a)
        return self.place[first], other

    def _together(self, own: Mapping[int, list[tuple[Columns, list[int]]]]) -> dict[tuple[int, Columns], tuple]:
        """Columns of several sums that stand side by side: for each the whole and its place in it."""
        by_others: dict[tuple, list[tuple[int, int, Columns]]] = {}
        for node, columns in own.items():
            for part, _ in columns:
                key = part.first[0], part.stride, part.others
                by_others.setdefault(key, []).append((part.first[1], node, part))
        together = {}
        for (argument, stride, others), members in by_others.items():
            members.sort()
            begin = 0
            for end in range(1, len(members) + 1):
                if end < len(members) and members[end][0] == members[end - 1][0] + 1:
                    continue
                if end - begin >= SHORTEST:
                    whole = Columns((argument, members[begin][0]), stride, others, end - begin)
                    for at, (_, node, part) in enumerate(members[begin:end]):
                        together[node, part] = whole, at
                begin = end
        return together

    def _dots_together(self, own: Mapping[int, list[tuple[Dot, list[int]]]]) -> dict[tuple[int, Dot], tuple]:
        """Dots of several sums that are the same distance apart: for each all of them and its place among them."""
        by_others: dict[tuple, list[tuple[int, int, Dot]]] = {}
        for node, dots in own.items():
            for dot, _ in dots:
                by_others.setdefault((dot.first[0], dot.others), []).append((dot.first[1], node, dot))
        together = {}
        for (argument, others), members in by_others.items():
            members.sort()
            begin = 0
            while begin + 1 < len(members):
                stride, end = members[begin + 1][0] - members[begin][0], begin + 2
                while end < len(members) and members[end][0] - members[end - 1][0] == stride:
                    end += 1
                if end - begin < FEWEST_DOTS:
                    begin += 1
                    continue
                whole = Dots((argument, members[begin][0]), stride, others, end - begin)
                for at, (_, node, dot) in enumerate(members[begin:end]):
                    together[node, dot] = whole, at
                begin = end
        return together

    # Rows -------------------------------------------------------------------------------------------------------------

    def _rows(self) -> dict[tuple[int, int], MultipleRow]:
        rows = {}
        for i, result in enumerate(self.results):
            at = 0
            while at < len(result):
                row = self._row(result, at)
                if row is not None:
                    rows[i, at] = row
                at += 1 if row is None else len(row.others)
        return rows

    def _row(self, result: Sequence[int], at: int) -> MultipleRow | None:
        common, end = self._product_only(result, at), at + 1
        while end < len(result) and (both := common & self._product_only(result, end)):
            common, end = both, end + 1
        if end - at < SHORTEST:
            return None
        factor = min(common)
        others = []
        for node in result[at:end]:
            a, b = self.graph.arguments[node]
            others.append(b if a == factor else a)
        return MultipleRow(factor, tuple(others), tuple(result[at:end]))

    def _product_only(self, result: Sequence[int], at: int) -> set[int]:
        """The factors of a result that is a product, and that nothing else reads."""
        node = result[at]
        return set(self.graph.arguments[node]) if self.uses[node] == 1 and self._is("mul", node) else set()


def beside(places: Sequence[tuple[int, int] | None]) -> tuple[int, int] | None:
    """The first of some places that stand side by side in an argument; None where they do not."""
    first = places[0]
    if first is None or any(at != (first[0], first[1] + i) for i, at in enumerate(places)):
        return None
    return first


# Text -----------------------------------------------------------------------------------------------------------------

# Not inlined: with sixty copies of a loop in one function LLVM takes five seconds, and with as many calls a tenth.
DOT = """\
define internal double @spherejax.dot(ptr %a, ptr %b, i64 %n) noinline nounwind {
work:
  %whole = and i64 %n, -16
  br label %loop
loop:
  %i = phi i64 [0, %work], [%i.next, %loop]
  %s0 = phi <8 x double> [zeroinitializer, %work], [%t0, %loop]
  %s1 = phi <8 x double> [zeroinitializer, %work], [%t1, %loop]
  %j = add nuw nsw i64 %i, 8
  %p.a0 = getelementptr inbounds double, ptr %a, i64 %i
  %p.b0 = getelementptr inbounds double, ptr %b, i64 %i
  %p.a1 = getelementptr inbounds double, ptr %a, i64 %j
  %p.b1 = getelementptr inbounds double, ptr %b, i64 %j
  %a0 = load <8 x double>, ptr %p.a0, align 8
  %b0 = load <8 x double>, ptr %p.b0, align 8
  %a1 = load <8 x double>, ptr %p.a1, align 8
  %b1 = load <8 x double>, ptr %p.b1, align 8
  %m0 = fmul contract <8 x double> %a0, %b0
  %m1 = fmul contract <8 x double> %a1, %b1
  %t0 = fadd contract <8 x double> %s0, %m0
  %t1 = fadd contract <8 x double> %s1, %m1
  %i.next = add nuw nsw i64 %i, 16
  %goes.on = icmp ult i64 %i.next, %whole
  br i1 %goes.on, label %loop, label %parts
parts:
  %eight = fadd <8 x double> %t0, %t1
  %low4 = shufflevector <8 x double> %eight, <8 x double> poison, <4 x i32> <i32 0, i32 1, i32 2, i32 3>
  %high4 = shufflevector <8 x double> %eight, <8 x double> poison, <4 x i32> <i32 4, i32 5, i32 6, i32 7>
  %four = fadd <4 x double> %low4, %high4
  %low2 = shufflevector <4 x double> %four, <4 x double> poison, <2 x i32> <i32 0, i32 1>
  %high2 = shufflevector <4 x double> %four, <4 x double> poison, <2 x i32> <i32 2, i32 3>
  %two = fadd <2 x double> %low2, %high2
  %one = extractelement <2 x double> %two, i64 0
  %other = extractelement <2 x double> %two, i64 1
  %sum = fadd double %one, %other
  br label %look
look:
  %k = phi i64 [%whole, %parts], [%k.next, %turn]
  %s = phi double [%sum, %parts], [%s.next, %turn]
  %is.more = icmp ult i64 %k, %n
  br i1 %is.more, label %turn, label %end
turn:
  %p.a = getelementptr inbounds double, ptr %a, i64 %k
  %p.b = getelementptr inbounds double, ptr %b, i64 %k
  %x = load double, ptr %p.a, align 8
  %y = load double, ptr %p.b, align 8
  %m = fmul contract double %x, %y
  %s.next = fadd contract double %s, %m
  %k.next = add nuw nsw i64 %k, 1
  br label %look
end:
  ret double %s
}
"""
"""From (a, b, n), n at least 16, to the sum of n products."""


WIDE = 'noinline nounwind "prefer-vector-width"="512"'
"""Of functions of thousands of numbers. With vectors of 256 bits the gradient by 4,417 weights takes 3 % longer."""

_EIGHT = "<8 x double>"

_HALVES = (
    ((0, 8, 2, 10, 4, 12, 6, 14), (1, 9, 3, 11, 5, 13, 7, 15)),
    ((0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15)),
    ((0, 1, 2, 3, 8, 9, 10, 11), (4, 5, 6, 7, 12, 13, 14, 15)),
)
"""How eight vectors become one that has the sum of each: of two vectors, which entries are added to which. First those
of each vector beside each other, then those two apart, then four apart."""


def _eight_sums(vectors: Sequence[str], name: str) -> list[str]:
    """Instructions for a vector of the sums of the entries of eight vectors."""
    lines = []
    for level, halves in enumerate(_HALVES):
        following = []
        for i in range(0, len(vectors), 2):
            own = name if len(vectors) == 2 else f"%h{level}.{i // 2}"
            parts = [f"{own}.a", f"{own}.b"]
            for part, places in zip(parts, halves, strict=True):
                entries = ", ".join(f"i32 {place}" for place in places)
                pair = f"{_EIGHT} {vectors[i]}, {_EIGHT} {vectors[i + 1]}"
                lines.append(f"  {part} = shufflevector {pair}, <8 x i32> <{entries}>")
            lines.append(f"  {own} = fadd {_EIGHT} {parts[0]}, {parts[1]}")
            following.append(own)
        vectors = following
    return lines


_LANES = "<i64 0, i64 1, i64 2, i64 3, i64 4, i64 5, i64 6, i64 7>"

CACHE_LINE = 8
"""Numbers of it. A vector that lies in two of them takes two reads: products of a matrix and a vector then take half
as long again."""


def columns_ahead(entry: int, stride: int, n: int) -> int:
    """So many columns of a matrix stand ahead of the first one that begins a cache line, in each of its rows.

    Args:
        entry: where it begins in an array, which begins with a cache line.
        stride: distance of its rows; of rows that begin elsewhere in their lines there are none.
        n: its columns.
    """
    return -entry % CACHE_LINE if stride % CACHE_LINE == 0 and n >= 2 * CACHE_LINE else 0


def _lanes(name: str, operation: str, limit: str) -> list[str]:
    """`name`: which of eight lanes compare so with a number."""
    return [
        f"  {name}.i = insertelement <8 x i64> poison, i64 {limit}, i64 0",
        f"  {name}.v = shufflevector <8 x i64> {name}.i, <8 x i64> poison, <8 x i32> zeroinitializer",
        f"  {name} = icmp {operation} <8 x i64> {_LANES}, {name}.v",
    ]


def _eight_products(p: str, before: str, at: str, factors: str) -> list[str]:
    """Eight rows at the column `at` times a vector, added to the vectors of the names `before`: `%{p}0` and so on."""
    rows = range(8)
    return [
        *(f"  %p{p}{r} = getelementptr inbounds double, ptr %w{r}, i64 {at}" for r in rows),
        *(f"  %x{p}{r} = load {_EIGHT}, ptr %p{p}{r}, align 8" for r in rows),
        *(f"  %m{p}{r} = fmul contract {_EIGHT} %x{p}{r}, {factors}" for r in rows),
        *(f"  %{p}{r} = fadd contract {_EIGHT} {before}{r}, %m{p}{r}" for r in rows),
    ]


def _dots_text() -> str:
    """Eight sums at a time, each in eight parts. What is ahead of the first whole vector, and behind the last one, is a
    vector as well, whose other factors are zeros."""
    rows = range(8)
    return "\n".join(
        [
            "define internal void @spherejax.dots("
            f"ptr %w, i64 %stride, ptr %b, i64 %n, ptr noalias %y, i64 %m, i64 %ahead) {WIDE} {{",
            "work:",
            "  %n.inside = sub nuw nsw i64 %n, %ahead",
            "  %n.whole = and i64 %n.inside, -8",
            "  %whole = add nuw nsw i64 %n.whole, %ahead",
            "  %is.ahead = icmp ne i64 %ahead, 0",
            f"  %b.first = load {_EIGHT}, ptr %b, align 8",
            *_lanes("%of.first", "ult", "%ahead"),
            f"  %f.first = select <8 x i1> %of.first, {_EIGHT} %b.first, {_EIGHT} zeroinitializer",
            "  %is.behind = icmp ult i64 %whole, %n",
            "  %last = sub nuw nsw i64 %n, 8",
            "  %p.last = getelementptr inbounds double, ptr %b, i64 %last",
            f"  %b.last = load {_EIGHT}, ptr %p.last, align 8",
            "  %n.known = sub nuw nsw i64 %whole, %last",
            *_lanes("%of.last", "uge", "%n.known"),
            f"  %f.last = select <8 x i1> %of.last, {_EIGHT} %b.last, {_EIGHT} zeroinitializer",
            "  br label %look",
            "look:",
            "  %j = phi i64 [0, %work], [%j.next, %put]",
            "  %j.next = add nuw nsw i64 %j, 8",
            "  %fits = icmp ule i64 %j.next, %m",
            "  br i1 %fits, label %rows, label %left",
            "rows:",
            "  %begin0 = mul nuw nsw i64 %j, %stride",
            *(f"  %begin{r} = add nuw nsw i64 %begin{r - 1}, %stride" for r in rows[1:]),
            *(f"  %w{r} = getelementptr inbounds double, ptr %w, i64 %begin{r}" for r in rows),
            "  br i1 %is.ahead, label %first, label %inside",
            "first:",
            *(f"  %none{r} = fadd {_EIGHT} zeroinitializer, zeroinitializer" for r in rows),
            *_eight_products("a", "%none", "0", "%f.first"),
            "  br label %inside",
            "inside:",
            *(f"  %begun{r} = phi {_EIGHT} [zeroinitializer, %rows], [%a{r}, %first]" for r in rows),
            "  br label %loop",
            "loop:",
            "  %k = phi i64 [%ahead, %inside], [%k.next, %loop]",
            *(f"  %s{r} = phi {_EIGHT} [%begun{r}, %inside], [%t{r}, %loop]" for r in rows),
            "  %p = getelementptr inbounds double, ptr %b, i64 %k",
            f"  %x = load {_EIGHT}, ptr %p, align 8",
            *_eight_products("t", "%s", "%k", "%x"),
            "  %k.next = add nuw nsw i64 %k, 8",
            "  %goes.on = icmp ult i64 %k.next, %whole",
            "  br i1 %goes.on, label %loop, label %behind",
            "behind:",
            "  br i1 %is.behind, label %rest, label %put",
            "rest:",
            *_eight_products("z", "%t", "%last", "%f.last"),
            "  br label %put",
            "put:",
            *(f"  %u{r} = phi {_EIGHT} [%t{r}, %behind], [%z{r}, %rest]" for r in rows),
            *_eight_sums([f"%u{r}" for r in rows], "%sums"),
            "  %at = getelementptr inbounds double, ptr %y, i64 %j",
            f"  store {_EIGHT} %sums, ptr %at, align 8",
            "  br label %look",
            "left:",
            "  %i = phi i64 [%j, %look], [%i.next, %one]",
            "  %is.left = icmp ult i64 %i, %m",
            "  br i1 %is.left, label %one, label %end",
            "one:",
            "  %begin = mul nuw nsw i64 %i, %stride",
            "  %row = getelementptr inbounds double, ptr %w, i64 %begin",
            "  %sum = call double @spherejax.dot(ptr %row, ptr %b, i64 %n)",
            "  %to = getelementptr inbounds double, ptr %y, i64 %i",
            "  store double %sum, ptr %to, align 8",
            "  %i.next = add nuw nsw i64 %i, 1",
            "  br label %left",
            "end:",
            "  ret void",
            "}",
            "",
        ]
    )


DOTS = _dots_text()
"""From (W, its stride, b, n, y, m, columns ahead) to y_j = sum_k W_jk b_k, n at least 16, for m of them. Whole vectors
begin behind those columns. It calls `DOT`."""


def _in_blocks(
    widths: Sequence[int], turn: Any, end: str = "  ret void", before: str = "work", begin: str = "0"
) -> str:
    """Loops over entries up to %m in blocks of these widths, each as far as it goes.

    Args:
        widths: of blocks, the widest first.
        turn: from a width and a prefix for names to the lines of a block that begins at the entry %j.prefix, and the
            name of the label that it ends in.
        end: the last lines.
        before: the label that the loops begin behind.
        begin: the first entry.
    """
    lines = []
    for width in widths:
        p = f"w{width}"
        text, last = turn(width, p)
        lines += [
            f"  br label %look.{p}",
            f"look.{p}:",
            f"  %j.{p} = phi i64 [{begin}, %{before}], [%end.{p}, %{last}]",
            f"  %end.{p} = add nuw nsw i64 %j.{p}, {width}",
            f"  %fits.{p} = icmp ule i64 %end.{p}, %m",
            f"  br i1 %fits.{p}, label %turn.{p}, label %behind.{p}",
            f"turn.{p}:",
            *text,
            f"  br label %look.{p}",
            f"behind.{p}:",
        ]
        before, begin = f"behind.{p}", f"%j.{p}"
    return "\n".join([*lines, end, "}", ""])


def _vector(width: int) -> str:
    return f"<{width} x double>" if width > 1 else "double"


def _spread(name: str, width: int) -> list[str]:
    """`name.v`: the number `name` in all entries of a vector."""
    kind = _vector(width)
    if width == 1:
        return [f"  {name}.v = fadd double {name}, 0.0"]
    return [
        f"  {name}.i = insertelement {kind} poison, double {name}, i64 0",
        f"  {name}.v = shufflevector {kind} {name}.i, {kind} poison, <{width} x i32> zeroinitializer",
    ]


def _column_block(adds: bool, width: int, p: str, of: str | None = None) -> tuple[list[str], str]:
    """A block of columns; `of`: those that it is for, where these are not all."""
    kind, zero = _vector(width), "zeroinitializer" if width > 1 else "0.0"
    # What is added to comes from memory, and its factors are as far apart as the rows.
    begin, at_factor = (f"%y.{p}", f"%row.{p}") if adds else (zero, f"%k.{p}")
    lines = [
        f"  %p.y.{p} = getelementptr inbounds double, ptr %y, i64 %j.{p}",
        *([f"  %y.{p} = load {kind}, ptr %p.y.{p}, align 8"] if adds or of else []),
        f"  br label %over.{p}",
        f"over.{p}:",
        f"  %k.{p} = phi i64 [0, %turn.{p}], [%k.next.{p}, %over.{p}]",
        f"  %s.{p} = phi {kind} [{begin}, %turn.{p}], [%t.{p}, %over.{p}]",
        f"  %row.{p} = mul nuw nsw i64 %k.{p}, %stride",
        f"  %at.{p} = add nuw nsw i64 %row.{p}, %j.{p}",
        f"  %p.w.{p} = getelementptr inbounds double, ptr %w, i64 %at.{p}",
        f"  %p.b.{p} = getelementptr inbounds double, ptr %b, i64 {at_factor}",
        f"  %x.{p} = load {kind}, ptr %p.w.{p}, align 8",
        f"  %b.{p} = load double, ptr %p.b.{p}, align 8",
        *_spread(f"%b.{p}", width),
        f"  %m.{p} = fmul contract {kind} %x.{p}, %b.{p}.v",
        f"  %t.{p} = fadd contract {kind} %s.{p}, %m.{p}",
        f"  %k.next.{p} = add nuw nsw i64 %k.{p}, 1",
        f"  %goes.on.{p} = icmp ult i64 %k.next.{p}, %n",
        f"  br i1 %goes.on.{p}, label %over.{p}, label %sum.{p}",
        f"sum.{p}:",
        *([f"  %u.{p} = select <{width} x i1> {of}, {kind} %t.{p}, {kind} %y.{p}"] if of else []),
        f"  store {kind} %{'u' if of else 't'}.{p}, ptr %p.y.{p}, align 8",
    ]
    return lines, f"sum.{p}"


def _columns_text(name: str, adds: bool) -> str:
    """Blocks of whole vectors; what is ahead of them, and behind them, is a part of a vector."""
    first, _ = _column_block(adds, 8, "first", "%of.first")
    last, _ = _column_block(adds, 8, "last", "%of.last")
    begin = [
        "define internal void "
        f"@spherejax.{name}(ptr %w, i64 %stride, ptr %b, i64 %n, ptr noalias %y, i64 %m, i64 %ahead) {WIDE} {{",
        "work:",
        "  %is.ahead = icmp ne i64 %ahead, 0",
        *_lanes("%of.first", "ult", "%ahead"),
        "  br i1 %is.ahead, label %turn.first, label %inside",
        "turn.first:",
        "  %j.first = add nuw nsw i64 0, 0",
        *first,
        "  br label %inside",
        "inside:",
    ]
    end = [
        "  %is.behind = icmp ult i64 %j.w8, %m",
        "  br i1 %is.behind, label %turn.last, label %end",
        "turn.last:",
        "  %j.last = sub nuw nsw i64 %m, 8",
        "  %n.known = sub nuw nsw i64 %j.w8, %j.last",
        *_lanes("%of.last", "uge", "%n.known"),
        *last,
        "  br label %end",
        "end:",
        "  ret void",
    ]
    blocks = _in_blocks((32, 8), partial(_column_block, adds), "\n".join(end), "inside", "%ahead")
    return "\n".join([*begin, blocks])


COLUMNS = _columns_text("columns", False)
"""From (W, its stride, b, n, y, m, columns ahead) to y_j = sum_k W_kj b_k, for m of them, at least 16. Whole vectors
begin behind those columns."""

PRODUCTS = (
    _columns_text("columns.added", True)
    + """\
define internal void @spherejax.products(
    ptr %f, i64 %size, i64 %n, ptr noalias %y, i64 %stride, i64 %rows, i64 %m) noinline nounwind {
work:
  %x = getelementptr inbounds double, ptr %f, i64 %rows
  br label %turn
turn:
  %i = phi i64 [0, %work], [%i.next, %turn]
  %b = getelementptr inbounds double, ptr %f, i64 %i
  %at = mul nuw nsw i64 %i, %stride
  %row = getelementptr inbounds double, ptr %y, i64 %at
  call void @spherejax.columns.added(ptr %x, i64 %size, ptr %b, i64 %n, ptr %row, i64 %m, i64 0)
  %i.next = add nuw nsw i64 %i, 1
  %goes.on = icmp ult i64 %i.next, %rows
  br i1 %goes.on, label %turn, label %end
end:
  ret void
}
"""
)
"""From (f, its size, n, Y, its stride, rows, m) to Y_ij + sum_k b_ki x_kj in their places, for m columns; vector k of n
has b_k and behind it x_k. A stage of a step reads and writes Y once less: that of 64 x 64 weights fills a cache."""


def _row_block(adds: bool, width: int, p: str) -> tuple[list[str], str]:
    kind, factor = _vector(width), "%a.v" if width > 1 else "%a.one"
    lines = [
        f"  %p.b.{p} = getelementptr inbounds double, ptr %b, i64 %j.{p}",
        f"  %p.y.{p} = getelementptr inbounds double, ptr %y, i64 %j.{p}",
        f"  %b.{p} = load {kind}, ptr %p.b.{p}, align 8",
        f"  %m.{p} = fmul contract {kind} %b.{p}, {factor}",
    ]
    if adds:
        lines += [
            f"  %y.{p} = load {kind}, ptr %p.y.{p}, align 8",
            f"  %s.{p} = fadd contract {kind} %y.{p}, %m.{p}",
        ]
    return [*lines, f"  store {kind} %{'s' if adds else 'm'}.{p}, ptr %p.y.{p}, align 8"], f"turn.{p}"


def _row_text(name: str, adds: bool) -> str:
    begin = (
        f"define internal void @spherejax.{name}(double %a.one, ptr %b, ptr noalias %y, i64 %m) {WIDE} {{\n"
        "work:\n"
        "  %a.i = insertelement <8 x double> poison, double %a.one, i64 0\n"
        "  %a.v = shufflevector <8 x double> %a.i, <8 x double> poison, <8 x i32> zeroinitializer\n"
    )
    return begin + _in_blocks((8, 1), partial(_row_block, adds))


ROW, ADDED_ROW = _row_text("row", False), _row_text("row.added", True)
"""From (a, b, y, m) to y_j = a b_j, and y_j + a b_j in its place, for m of them."""

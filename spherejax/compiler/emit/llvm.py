"""Scalar programs in LLVM's language, as functions that XLA can call.

A function has the binary interface of `jax.ffi` (`xla/ffi/api/c_api.h`, version 0.3, which XLA says it keeps): it gets
a frame, in which it finds where the numbers of its arguments are, and where its results are to go.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from spherejax.compiler.emit.llvm_functions import FUNCTIONS, OF_VECTORS_ALONE, WITHIN
from spherejax.compiler.emit.llvm_rows import rows_of
from spherejax.compiler.emit.llvm_sums import (
    ADDED_ROW,
    COLUMNS,
    DOT,
    DOTS,
    ROW,
    Columns,
    DeferredRows,
    Dots,
    MultipleRow,
    WeightedSum,
    beside,
    columns_ahead,
    deferred_rows,
    loops_of,
)
from spherejax.compiler.native import ffi_abi
from spherejax.compiler.operations import BOOL, DOUBLE, FLOAT, KINDS, OPERATIONS, TRUTH, WHOLE, Call

LARGEST_FRAME = 2**18
"""Bytes of values that a function may have at once, at most: lanes are taken fewer at a time in larger programs, for a
thread of XLA's pool has a stack of a few megabytes."""

LANES_AT_A_TIME = 8
"""Numbers in the widest vectors there are, 512 bits."""


def can_be_written(line: Any) -> bool:
    """Whether all operations of a line have a rule here."""
    graph, residuals = line.graph, frozenset(line.flat_residuals)
    return all(
        _is_known(graph, node)
        for node in line.nodes
        if node not in residuals and graph.operations[node] not in ("constant", "input")
    )


def _is_known(graph: Any, node: int) -> bool:
    return OPERATIONS[graph.operations[node]].can_be_llvm(_call(graph, node))


def _call(graph: Any, node: int) -> Call:
    kinds = tuple(KINDS[graph.dtypes[a]] for a in graph.arguments[node])
    return Call(kinds, KINDS[graph.dtypes[node]], dict(graph.parameters_of(node) or ()))


FUNCTION = "PROGRAM"
"""Stands for the name of the function, which is a digest of the rest."""


def head(n_arguments: int, n_results: int) -> str:
    """How a function begins that XLA calls: with pointers to the numbers, `%a0`, ... and `%r0`, ..."""
    lines = [ffi_abi.beginning(FUNCTION)]
    for letter, of, n in (("a", "arguments", n_arguments), ("r", "results", n_results)):
        # All places are looked up at the start: in a loop over lanes LLVM would have to prove that they stay the same.
        for i in range(n):
            lines += [
                f"  %{letter}{i}.place = getelementptr inbounds ptr, ptr %{of}, i64 {i}",
                f"  %{letter}{i}.buffer = load ptr, ptr %{letter}{i}.place",
                f"  %{letter}{i}.data = getelementptr inbounds i8, ptr %{letter}{i}.buffer, i64 {ffi_abi.BUFFER_DATA}",
                f"  %{letter}{i} = load ptr, ptr %{letter}{i}.data",
            ]
    return "\n".join(lines)


def widest_for(*lines: Any) -> int:
    """Numbers in the vectors that these lines may be evaluated with: their values have to fit a frame."""
    # A power of two: LLVM takes vectors of other sizes to pieces.
    room = max(1, LARGEST_FRAME // (8 * max(1, *(len(line.nodes) for line in lines))))
    return min(LANES_AT_A_TIME, 1 << (room.bit_length() - 1))


def _element(dtype: np.dtype, in_memory: bool) -> str:
    # XLA keeps a truth in a byte; LLVM computes with single bits.
    return "i8" if in_memory and dtype == BOOL else KINDS[dtype]


def constant(value: Any, kind: str) -> str:
    """A number, exactly."""
    if kind == DOUBLE:  # by its bits: LLVM refuses decimals that are no double exactly
        return f"0x{int(np.float64(value).view(np.uint64)):016X}"
    return str(int(value)) if kind == WHOLE else "true" if value else "false"


def number_of(text: str, kind: str) -> Any:
    """The reverse of `constant`."""
    if kind == DOUBLE:
        return np.uint64(int(text, 16)).view(np.float64)
    return np.int64(text) if kind == WHOLE else np.bool_(text == "true")


class Numbers:
    """Writes operations on numbers, or on vectors of some; a `LlvmWriter`.

    Args:
        made: adds an instruction, and gives the name of its result.
        declared: functions that the instructions call.
        size: how many numbers a value is.
    """

    def __init__(self, made: Callable[[str], str], declared: dict[str, None], size: int):
        self.made, self._declared, self._size = made, declared, size

    def type(self, kind: str) -> str:
        """The type of numbers of a kind."""
        return f"<{self._size} x {kind}>" if self._size > 1 else kind

    def number(self, value: Any, kind: str) -> str:
        """A constant."""
        text = constant(value, kind)
        return text if self._size == 1 else "<" + ", ".join([f"{kind} {text}"] * self._size) + ">"

    def intrinsic(self, word: str, kind: str, *names: str, result: str | None = None) -> str:
        """A function that LLVM has itself; `result` where it gives another kind than it takes."""
        typed, to = self.type(kind), self.type(result or kind)
        # LLVM tells its intrinsics apart by the types in their names: the result first, where it is another one.
        marks = "".join(f".{self._mark(kind_of)}" for kind_of in ([result, kind] if result else [kind]))
        name = f"@llvm.{word}{marks}"
        self._declared[f"declare {to} {name}({', '.join([typed] * len(names))})"] = None
        return self.made(f"call {to} {name}({', '.join(f'{typed} {argument}' for argument in names)})")

    def _mark(self, kind: str) -> str:
        element = {DOUBLE: "f64"}.get(kind, kind)
        return f"v{self._size}{element}" if self._size > 1 else element

    def library(self, word: str, *names: str) -> str:
        """A function of the mathematical library, or ours in its place."""
        if word in FUNCTIONS and (self._size > 1 or word not in OF_VECTORS_ALONE):
            return self.ours(word, *names)
        return self.of_library(word, *names)

    def of_library(self, word: str, *names: str) -> str:
        """A function of the mathematical library, of one number after the other: it has none of vectors."""
        needs = ", ".join(["double"] * len(names))
        # `memory(none)`: nobody reads `errno`, so that equal calls are made once and unused ones not at all.
        self._declared[f"declare double @{word}({needs}) nounwind willreturn memory(none)"] = None
        if self._size == 1:
            return self.made(f"call double @{word}({', '.join(f'double {argument}' for argument in names)})")
        typed, whole = self.type(DOUBLE), "poison"
        for i in range(self._size):
            numbers = [self.made(f"extractelement {typed} {name}, i64 {i}") for name in names]
            result = self.made(f"call double @{word}({', '.join(f'double {x}' for x in numbers)})")
            whole = self.made(f"insertelement {typed} {whole}, double {result}, i64 {i}")
        return whole

    def ours(self, word: str, *names: str) -> str:
        """A call of one of `llvm_functions`; vectors of three, five, ... numbers are filled up with their first one."""
        size = 1 << (self._size - 1).bit_length()
        declared, function = _function(word, size, len(names))
        self._declared.update(dict.fromkeys((*declared, function)))
        typed, called = self.type(DOUBLE), f"<{size} x double>" if size > 1 else DOUBLE
        if size != self._size:
            names = tuple(self._moved(name, typed, [*range(self._size), *[0] * (size - self._size)]) for name in names)
        result = self.made(
            f"call {called} @{_name(word, size)}({', '.join(f'{called} {argument}' for argument in names)})"
        )
        return result if size == self._size else self._moved(result, called, range(self._size))

    def _moved(self, name: str, typed: str, entries: Sequence[int]) -> str:
        places = ", ".join(f"i32 {i}" for i in entries)
        return self.made(f"shufflevector {typed} {name}, {typed} poison, <{len(entries)} x i32> <{places}>")


def _name(word: str, size: int) -> str:
    return f"spherejax.{word}.{size}"


@cache
def _function(word: str, size: int, n_arguments: int) -> tuple[tuple[str, ...], str]:
    """One of `llvm_functions` for vectors of a size: what it needs declared, and its text."""
    lines: list[str] = []

    def made(text: str) -> str:
        lines.append(f"  %v{len(lines)} = {text}")
        return f"%v{len(lines) - 1}"

    declared: dict[str, None] = {}
    writer, names = Numbers(made, declared, size), [f"%x{i}" for i in range(n_arguments)]
    result, typed = FUNCTIONS[word](writer, *names), writer.type(DOUBLE)
    if word in WITHIN:
        # Arguments beyond are rare, and NaN is one of them: all numbers of a vector are looked at together.
        of_truths, bits = writer.type(TRUTH), f"i{size}"
        bound = writer.number(WITHIN[word], DOUBLE)
        is_near = made(f"fcmp ole {typed} {writer.intrinsic('fabs', DOUBLE, names[0])}, {bound}")
        are_near = made(f"bitcast {of_truths} {is_near} to {bits}") if size > 1 else is_near
        are_all = made(f"icmp eq {bits} {are_near}, -1")
        lines += [f"  br i1 {are_all}, label %near, label %far", "near:", f"  ret {typed} {result}", "far:"]
        result = made(f"select {of_truths} {is_near}, {typed} {result}, {typed} {writer.of_library(word, *names)}")
    lines.append(f"  ret {typed} {result}")
    # Not inlined, as loops over sums are not: a layer of a network would have 64 copies.
    begin = (
        f"define internal {typed} @{_name(word, size)}({', '.join(f'{typed} {name}' for name in names)}) "
        "noinline willreturn memory(none) nounwind {"
    )
    return tuple(declared), "\n".join([begin, *lines, "}", ""])


COPY = "declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)"
"""What copies an array."""

FEWEST_ENTRIES = 5
"""Cases of a lookup that are a table in memory, at least: fewer are selections."""


class Tables(NamedTuple):
    """Lookups that read memory.

    Attributes:
        lookups: their nodes.
        entries: arguments that nothing else reads: they stay where they are.
    """

    lookups: frozenset[int]
    entries: frozenset[int]

    @classmethod
    def of(cls, line: Any, place: Mapping[int, tuple[int, int]]) -> "Tables":
        """Those of a line, of which `place` says what is an argument."""
        graph, lookups = line.graph, []
        for node in line.nodes:
            # A truth has no pointer to its bit.
            is_lookup = node not in place and graph.operations[node] == "lookup" and graph.dtypes[node] != BOOL
            if is_lookup and len(graph.arguments[node]) > FEWEST_ENTRIES:
                lookups.append(node)
        if not lookups:
            return cls(frozenset(), frozenset())
        entries = {case for node in lookups for case in graph.arguments[node][1:] if case in place}
        in_tables = frozenset(lookups)
        for node in line.nodes:
            if node not in place:
                entries.difference_update(graph.arguments[node][: 1 if node in in_tables else None])
        for output in line.outputs:
            entries.difference_update(map(int, output.ravel()))
        return cls(in_tables, frozenset(entries))


class StoredTable(NamedTuple):
    """Where the entries of a table are.

    Attributes:
        pointer: to the first one.
        stride: numbers from one to the next.
        has_numbers: whether an entry is a number for each run, or lane, side by side.
    """

    pointer: str
    stride: int
    has_numbers: bool


class FunctionText:
    """The text of a function of LLVM for a line.

    Values over lanes are vectors of `width` lanes; a loop goes over all of them. Where the width does not divide the
    number of lanes, the last turn begins earlier, and computes some again.

    Args:
        line: what is evaluated.
        lanes, axes: as of the operation `straight_line`.
        n_runs: of a function for several runs at once every value is a vector, of one number for each, and so is each
            entry of its arguments and results; the loop goes over lanes one by one then.
        added: results that are added to what stands in their places, without lanes.
        deferred: those among them whose rows the caller evaluates (`deferred_rows`); the vector for each is a further
            result.
    """

    def __init__(
        self,
        line: Any,
        lanes: tuple[int, ...],
        axes: tuple[int, ...],
        n_runs: int = 1,
        added: tuple[int, ...] = (),
        deferred: tuple[int, ...] = (),
    ):
        self.line, self.graph, self.added = line, line.graph, added
        self.spread, self.outputs_spread = line.spread(axes)
        self.axes = axes
        self.n_lanes = lanes[0] if lanes else 1
        self.n_runs = n_runs
        # Of several runs a value is a vector already; vectors of vectors there are not.
        self.width = 1 if n_runs > 1 else min(self.n_lanes, widest_for(line))
        self.lines: list[str] = []
        self.declared: dict[str, None] = {}
        self.values: dict[int, str] = {}
        self.wide: dict[int, str] = {}
        self.place: dict[int, tuple[int, int]] = {}
        for i, group in enumerate(line.residuals, len(line.shapes)):
            self.place.update({int(node): (i, entry) for entry, node in enumerate(group.ravel())})
        for node in line.nodes:
            if node not in self.place and self.graph.operations[node] == "input":
                self.place[node] = self.graph.parameters[node]
        self.in_loop = False
        # Over lanes, and for several runs, the values are vectors already.
        is_alone = n_runs == 1 and not any(self.spread.values())
        self.loops = loops_of(line, self.place) if is_alone else None
        self.rows = rows_of(line, self._is_operation, LANES_AT_A_TIME) if is_alone else None
        self.deferred = {result: self.deferred_rows(result) for result in deferred}
        self.tables = Tables.of(line, self.place)
        self._rooms: list[str] = []
        self._in_vectors: dict[int, tuple[str, tuple[int, ...]]] = {}
        self._arrays: dict[Any, str] = {}
        self._tables: dict[tuple[tuple[int, ...], bool], StoredTable] = {}
        self._of_one = Numbers(self._made, self.declared, self._size(False))
        self._of_all_lanes = Numbers(self._made, self.declared, self._size(True))

    def deferred_rows(self, result: int) -> DeferredRows | None:
        """The rows of a result, for a caller that evaluates them."""
        return deferred_rows(self.loops, result)

    # Small things -----------------------------------------------------------------------------------------------------

    def _made(self, text: str) -> str:
        name = f"%v{len(self.lines)}"
        self.lines.append(f"  {name} = {text}")
        return name

    def _size(self, is_wide: bool) -> int:
        """Numbers in a value."""
        return self.n_runs * (self.width if is_wide else 1)

    def _type(self, dtype: np.dtype, is_wide: bool, in_memory: bool = False) -> str:
        element, size = _element(dtype, in_memory), self._size(is_wide)
        return f"<{size} x {element}>" if size > 1 else element

    def _constant(self, value: Any, dtype: np.dtype, is_wide: bool) -> str:
        return (self._of_all_lanes if is_wide else self._of_one).number(value, KINDS[dtype])

    def _over_lanes(self, value: str, dtype: np.dtype) -> str:
        if self.width == 1:
            return value
        element, vector = _element(dtype, False), self._type(dtype, True)
        # LLVM has no instruction that fills a vector; this pair is what it recognizes as one.
        first = self._made(f"insertelement {vector} poison, {element} {value}, i64 0")
        return self._made(f"shufflevector {vector} {first}, {vector} poison, <{self.width} x i32> zeroinitializer")

    def _value(self, node: int, is_wide: bool) -> str:
        graph = self.graph
        if node not in self.place and graph.is_constant(node):
            return self._constant(graph.value(node), graph.dtypes[node], is_wide)
        if not is_wide or self.spread[node]:
            # Entries of tables are read where one has to be copied.
            return self._read(node) if node in self.tables.entries else self.values[node]
        if node not in self.wide:
            # Read again in the loop: a thousand vectors of one number each would have to wait in memory.
            is_read = node in self.tables.entries or (self.in_loop and node in self.place)
            one = self._read(node) if is_read else self.values[node]
            self.wide[node] = self._over_lanes(one, graph.dtypes[node])
        return self.wide[node]

    def _pointer(self, argument: str, entry: int, dtype: np.dtype, is_wide: bool) -> str:
        # Steps of an array of numbers: the size of a vector may be rounded up.
        element = self._type(dtype, False, True).replace("<", "[").replace(">", "]")
        at: Any = entry * self.n_lanes if is_wide else entry
        if is_wide and self.in_loop:
            at = self._made(f"add nuw nsw i64 %lane, {at}")
        return self._made(f"getelementptr inbounds {element}, ptr {argument}, i64 {at}")

    def _read(self, node: int) -> str:
        argument, entry = self.place[node]
        dtype, is_wide = self.graph.dtypes[node], bool(self.spread[node])
        pointer = self._pointer(f"%a{argument}", entry, dtype, is_wide)
        kind = self._type(dtype, is_wide, True)
        # A vector begins at any entry, so that no more can be said than the alignment of one number.
        value = self._made(f"load {kind}, ptr {pointer}, align {1 if dtype == BOOL else 8}")
        return self._made(f"trunc {kind} {value} to {self._type(dtype, is_wide)}") if dtype == BOOL else value

    def _write(self, node: int, result: int, entry: int, is_wide: bool) -> None:
        dtype, adds = self.graph.dtypes[node], result in self.added
        if adds and self.graph.is_value(node, 0):
            return
        value, kind = self._value(node, is_wide), self._type(dtype, is_wide, True)
        if dtype == BOOL:
            value = self._made(f"zext {self._type(dtype, is_wide)} {value} to {kind}")
        pointer = self._pointer(f"%r{result}", entry, dtype, is_wide)
        if adds:
            value = self._made(f"fadd contract {kind} {self._made(f'load {kind}, ptr {pointer}, align 8')}, {value}")
        self.lines.append(f"  store {kind} {value}, ptr {pointer}, align {1 if dtype == BOOL else 8}")

    # Operations -------------------------------------------------------------------------------------------------------

    def _is_operation(self, node: int) -> bool:
        return node not in self.place and self.graph.operations[node] != "constant"

    def _node(self, node: int) -> str:
        graph, is_wide = self.graph, bool(self.spread[node])
        if node in self.tables.lookups:
            return self._looked_up(node)
        values = [self._value(a, is_wide) for a in graph.arguments[node]]
        writer = self._of_all_lanes if is_wide else self._of_one
        return OPERATIONS[graph.operations[node]].in_llvm(writer, _call(graph, node), *values)

    def _row(self, nodes: tuple[int, ...]) -> None:
        """Several uses of a function, as one of a vector."""
        graph, first = self.graph, nodes[0]
        writer = Numbers(self._made, self.declared, len(nodes))
        typed = writer.type(DOUBLE)
        vectors = []
        for arguments in zip(*(graph.arguments[node] for node in nodes), strict=True):
            vector = "poison"
            for i, node in enumerate(arguments):
                vector = self._made(f"insertelement {typed} {vector}, double {self._value(node, False)}, i64 {i}")
            vectors.append(vector)
        result = OPERATIONS[graph.operations[first]].in_llvm(writer, _call(graph, first), *vectors)
        self._in_vectors[first] = result, nodes
        for i, node in enumerate(nodes):
            self.values[node] = self._made(f"extractelement {typed} {result}, i64 {i}")

    # Tables -----------------------------------------------------------------------------------------------------------

    def _looked_up(self, node: int) -> str:
        """An entry of a table in memory, or of a vector one for each of its numbers."""
        graph, is_wide = self.graph, bool(self.spread[node])
        index, *cases = graph.arguments[node]
        kind, size = KINDS[graph.dtypes[node]], self._size(is_wide)
        table = self._table(tuple(cases))
        value = self._value(index, is_wide)
        if size == 1:
            return self._entry_of(table, value, 0, kind)
        vector, whole = f"<{size} x {kind}>", "poison"
        for i in range(size):
            place = self._made(f"extractelement <{size} x i64> {value}, i64 {i}")
            entry = self._entry_of(table, place, i, kind)
            whole = self._made(f"insertelement {vector} {whole}, {kind} {entry}, i64 {i}")
        return whole

    def _entry_of(self, table: "StoredTable", index: str, number: int, kind: str) -> str:
        if table.stride != 1:
            index = self._made(f"mul nuw nsw i64 {index}, {table.stride}")
        if table.has_numbers and number:
            index = self._made(f"add nuw nsw i64 {index}, {number}")
        pointer = self._made(f"getelementptr inbounds {kind}, ptr {table.pointer}, i64 {index}")
        return self._made(f"load {kind}, ptr {pointer}, align 8")

    def _table(self, cases: tuple[int, ...]) -> "StoredTable":
        """Where the entries of a table are: constants, in an argument, or copied side by side."""
        graph, kind = self.graph, KINDS[self.graph.dtypes[cases[0]]]
        is_wide = any(self.spread.get(case, 0) for case in cases)
        if (cases, self.in_loop and is_wide) in self._tables:
            return self._tables[cases, self.in_loop and is_wide]
        size = self._size(is_wide)
        place = beside([self.place.get(case) for case in cases])
        if all(self._is_constant(case) for case in cases):
            table = StoredTable(self._constants([constant(graph.value(case), kind) for case in cases], kind), 1, False)
        elif place is not None:
            argument, entry = place
            pointer = self._pointer(f"%a{argument}", entry, graph.dtypes[cases[0]], is_wide)
            table = StoredTable(pointer, self.n_runs * (self.n_lanes if is_wide else 1), size > 1)
        else:
            table = StoredTable(self._copied(cases, is_wide, kind), size, size > 1)
        self._tables[cases, self.in_loop and is_wide] = table
        return table

    def _is_constant(self, node: int) -> bool:
        return node not in self.place and self.graph.is_constant(node)

    def _constants(self, texts: Sequence[str], kind: str) -> str:
        content = f"[{len(texts)} x {kind}] [{', '.join(f'{kind} {text}' for text in texts)}], align 8"
        # Functions are put together by their texts: equal tables have one name, and others none of theirs.
        name = f"@spherejax.table.{hashlib.sha256(content.encode()).hexdigest()[:16]}"
        self.declared[f"{name} = internal unnamed_addr constant {content}"] = None
        return name

    def _copied(self, cases: tuple[int, ...], is_wide: bool, kind: str) -> str:
        """The entries side by side in an array of its own: those that are so in an argument in one piece."""
        size, array = self._size(is_wide), f"%table{len(self._rooms)}"
        self._rooms.append(f"  {array} = alloca [{len(cases) * size} x {kind}], align 64")
        of_value = f"<{size} x {kind}>" if size > 1 else kind
        at = 0
        while at < len(cases):
            target = self._made(f"getelementptr inbounds {kind}, ptr {array}, i64 {at * size}")
            n = 1
            if not is_wide and cases[at] in self.place:
                while at + n < len(cases) and beside([self.place.get(c) for c in cases[at : at + n + 1]]) is not None:
                    n += 1
            if n > 1:
                self.declared[COPY] = None
                argument, entry = self.place[cases[at]]
                source = self._pointer(f"%a{argument}", entry, self.graph.dtypes[cases[at]], False)
                self.lines.append(
                    f"  call void @llvm.memcpy.p0.p0.i64(ptr align 8 {target}, ptr align 8 {source}, "
                    f"i64 {8 * n * size}, i1 false)"
                )
            else:
                self.lines.append(f"  store {of_value} {self._value(cases[at], is_wide)}, ptr {target}, align 8")
            at += n
        return array

    # Loops over vectors -----------------------------------------------------------------------------------------------

    def _sum(self, parts: WeightedSum) -> str:
        total: str | None = None
        for node in parts.rest:
            total = self._added(total, self._value(node, False))
        for dot in parts.dots:
            self.declared[DOT] = None
            pointers = f"ptr {self._entry(dot.first)}, ptr {self._array(dot.others)}"
            total = self._added(total, self._made(f"call double @spherejax.dot({pointers}, i64 {len(dot.others)})"))
        for whole, at in parts.together:
            pointer = self._made(f"getelementptr inbounds double, ptr {self._together(whole)}, i64 {at}")
            total = self._added(total, self._made(f"load double, ptr {pointer}, align 8"))
        assert total is not None
        return total

    def _added(self, total: str | None, value: str) -> str:
        return value if total is None else self._made(f"fadd contract double {total}, {value}")

    def _together(self, whole: Columns | Dots) -> str:
        """A pointer to all of these sums, which are evaluated when the first of them is asked for."""
        if whole not in self._arrays:
            matrix, factors = self._entry(whole.first), self._array(whole.others)
            sums = self._room(whole.n)
            name, texts, n_columns = "dots", [DOT, DOTS], len(whole.others)
            if isinstance(whole, Columns):
                name, texts, n_columns = "columns", [COLUMNS], whole.n
            self.declared.update(dict.fromkeys(texts))
            ahead = columns_ahead(whole.first[1], whole.stride, n_columns)
            self.lines.append(
                f"  call void @spherejax.{name}(ptr {matrix}, i64 {whole.stride}, ptr {factors}, "
                f"i64 {len(whole.others)}, ptr {sums}, i64 {whole.n}, i64 {ahead})"
            )
            self._arrays[whole] = sums
        return self._arrays[whole]

    def _write_row(self, row: MultipleRow, result: int, entry: int) -> None:
        if (rows := self.deferred.get(result)) is not None:
            self._write_factors(row, rows, result, entry)
            return
        name, text = ("row.added", ADDED_ROW) if result in self.added else ("row", ROW)
        self.declared[text] = None
        pointer = self._pointer(f"%r{result}", entry, FLOAT, False)
        factor, others = self._value(row.factor, False), self._array(row.others)
        self.lines.append(
            f"  call void @spherejax.{name}(double {factor}, ptr {others}, ptr {pointer}, i64 {len(row.others)})"
        )

    def _write_factors(self, row: MultipleRow, rows: DeferredRows, result: int, entry: int) -> None:
        """What the caller evaluates a row from."""
        vector = f"%r{len(self.line.outputs) + [*self.deferred].index(result)}"
        factor = self._pointer(vector, rows.factors[entry], FLOAT, False)
        self.lines.append(f"  store double {self._value(row.factor, False)}, ptr {factor}, align 8")
        if entry in rows.others:
            self.declared[COPY] = None
            others = self._pointer(vector, rows.others[entry], FLOAT, False)
            self.lines.append(
                f"  call void @llvm.memcpy.p0.p0.i64(ptr align 8 {others}, ptr align 8 {self._array(row.others)}, "
                f"i64 {8 * len(row.others)}, i1 false)"
            )

    def _array(self, nodes: tuple[int, ...]) -> str:
        """A pointer to the values of nodes, side by side."""
        if nodes not in self._arrays:
            place = beside([self.place.get(node) for node in nodes])
            if place is not None:
                return self._entry(place)
            array = self._room(len(nodes))
            at = 0
            while at < len(nodes):
                pointer = self._made(f"getelementptr inbounds double, ptr {array}, i64 {at}")
                vector, row = self._in_vectors.get(nodes[at], ("", ()))
                if row and nodes[at : at + len(row)] == row:
                    self.lines.append(f"  store <{len(row)} x double> {vector}, ptr {pointer}, align 8")
                    at += len(row)
                else:
                    self.lines.append(f"  store double {self._value(nodes[at], False)}, ptr {pointer}, align 8")
                    at += 1
            self._arrays[nodes] = array
        return self._arrays[nodes]

    def _entry(self, place: tuple[int, int]) -> str:
        argument, entry = place
        return self._pointer(f"%a{argument}", entry, FLOAT, False)

    def _room(self, n: int) -> str:
        return self._made(f"alloca [{n} x double], align 64")

    # The whole --------------------------------------------------------------------------------------------------------

    def written(self) -> str:
        """The text of a function that XLA calls."""
        body = self._body()
        return "\n".join(
            [*sorted(self.declared), head(self.n_arguments, self.n_results), *body, "  ret ptr null", "}", ""]
        )

    def written_inside(self, name: str) -> tuple[set[str], str]:
        """What a function that another one calls needs declared, and its text.

        It has pointers to all arguments, then to all results.
        """
        # A result overlaps nothing else; arguments may be the same array twice, which is harmless.
        pointers = [f"ptr %a{i}" for i in range(self.n_arguments)] + [
            f"ptr noalias %r{i}" for i in range(self.n_results)
        ]
        begin = f"define internal void @{name}({', '.join(pointers)}) nounwind {{\nwork:"
        body = self._body()
        return set(self.declared), "\n".join([begin, *body, "  ret void", "}", ""])

    @property
    def n_arguments(self) -> int:
        """Of the line."""
        return len(self.line.shapes) + len(self.line.residuals)

    @property
    def n_results(self) -> int:
        """Of the line, and vectors for the caller."""
        return len(self.line.outputs) + len(self.deferred)

    def _body(self) -> list[str]:
        self._part(is_wide=False)
        if (self.axes and any(self.spread.values())) or any(self.outputs_spread):
            self._over_all_lanes()
        # Ahead of all: room that is taken in a loop would be taken in each turn.
        return [*self._rooms, *self.lines]

    def _part(self, is_wide: bool) -> None:
        """What is over lanes, or what is not."""
        for node in self.line.nodes if self.rows is None else self.rows.order:
            if bool(self.spread[node]) != is_wide or node in self.values:
                continue
            if self.rows is not None and node in self.rows.rows:
                self._row(self.rows.rows[node])
                continue
            if self.loops is not None and node in self.loops.sums:
                self.values[node] = self._sum(self.loops.sums[node])
                continue
            if self.loops is not None and node not in self.loops.written:
                continue
            if node in self.tables.entries:
                continue
            if node in self.place:
                self.values[node] = self._read(node)
            elif self._is_operation(node):
                self.values[node] = self._node(node)
        if not is_wide:
            for node in self.tables.lookups:  # what lanes look up in a table that they share
                cases = self.graph.arguments[node][1:]
                if self.spread[node] and not any(self.spread.get(case, 0) for case in cases):
                    self._table(cases)
        # With its own part: what is not over lanes is written once, ahead of the loop.
        for i, (output, spread) in enumerate(zip(self.line.outputs, self.outputs_spread, strict=True)):
            if bool(spread) == is_wide:
                entry, nodes = 0, output.ravel()
                while entry < len(nodes):
                    row = None if self.loops is None else self.loops.rows.get((i, entry))
                    if row is None:
                        self._write(int(nodes[entry]), i, entry, is_wide)
                        entry += 1
                    else:
                        self._write_row(row, i, entry)
                        entry += len(row.others)

    def _over_all_lanes(self) -> None:
        n_turns = -(-self.n_lanes // self.width)
        if n_turns == 1:  # without a loop all places are constants
            self._part(is_wide=True)
            return
        wanted = [
            argument
            for node in self.line.nodes
            if self.spread[node]
            for argument in self.graph.arguments[node][: 1 if node in self.tables.lookups else None]
        ]
        for output, spread in zip(self.line.outputs, self.outputs_spread, strict=True):
            wanted += map(int, output.ravel()) if spread else []
        for node in dict.fromkeys(wanted):  # what all lanes share is spread out once
            if not self.spread.get(node, 1) and node not in self.place:
                self._value(node, True)
        last = self.n_lanes - self.width
        self.lines += [
            "  br label %loop",
            "loop:",
            "  %turn = phi i64 [0, %work], [%next, %loop]",
            f"  %begin = mul i64 %turn, {self.width}",
            f"  %is.last = icmp sgt i64 %begin, {last}",
            f"  %lane = select i1 %is.last, i64 {last}, i64 %begin",
        ]
        self.in_loop = True
        self._part(is_wide=True)
        self.lines += [
            "  %next = add i64 %turn, 1",
            f"  %is.done = icmp sge i64 %next, {n_turns}",
            "  br i1 %is.done, label %end, label %loop",
            "end:",
        ]

"""Functions that XLA calls for several runs: a group of them at a time, as vectors of one number for each.

What XLA gives has runs last, and rows first: tangents of something have an axis of rows in front. The function inside,
for one group, finds each entry as a vector of the group's runs, and rows as lanes: behind the entries (`text`).
Where the width of a group does not divide the number of runs, the last one begins earlier, and is made again.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from spherejax.compiler.emit.llvm import LANES_AT_A_TIME, head
from spherejax.compiler.emit.llvm_vectors import call_of, room_for, spread_out


class RunGroups(NamedTuple):
    """How a call evaluates its runs.

    Attributes:
        n_runs: how many the call has; None where its arrays have no axis of runs.
        width: runs in a group, a power of two.
    """

    n_runs: int | None = None
    width: int = 1

    @classmethod
    def of(cls, n_runs: int | None, widest: int) -> "RunGroups":
        """The widest groups that so many runs, and vectors of so many numbers, allow."""
        widest = min(widest, n_runs or 1)
        return cls(n_runs, 1 << (widest.bit_length() - 1))

    @property
    def one(self) -> str:
        """The type of a number of each run."""
        return vector_of(self.width)

    @property
    def at_a_time(self) -> int:
        """Numbers in the widest vectors that an array's entries can be gone through with, all the same in one run."""
        return self.width if self.width > 1 else LANES_AT_A_TIME

    def vectors(self, size: int) -> list[tuple[int, int, str]]:
        """The vectors that so many entries are gone through with: number, first entry and type of each."""
        step = self.at_a_time
        return [(i, begin, f"<{min(step, size - begin)} x double>") for i, begin in enumerate(range(0, size, step))]

    def in_vectors(self, size: int, write: Callable[[int, int, str], str]) -> str:
        """Instructions for all of so many entries; `write` has those for one of the `vectors`."""
        return "\n".join(write(*vector) for vector in self.vectors(size))

    def for_all_runs(self, name: str, number: str) -> str:
        """The instructions that give a name to a number which all runs share."""
        if self.width > 1:
            return spread_out(name, number, self.one)
        # LLVM has no instruction that copies; -0 is what changes no number, +0 would turn -0 into +0.
        return f"  {name} = fadd double {number}, 0x8000000000000000"

    def lanes_for(self, n_rows: int) -> int:
        """Lanes for so many rows: vectors of three or five numbers are taken to pieces."""
        if self.width > 1:  # each row is a vector of the runs already
            return n_rows
        return n_rows if n_rows <= 2 else 4 if n_rows <= 4 else -(-n_rows // LANES_AT_A_TIME) * LANES_AT_A_TIME


def vector_of(width: int) -> str:
    """The type of so many numbers."""
    return "double" if width == 1 else f"<{width} x double>"


class Operand(NamedTuple):
    """An argument or a result of a call.

    Attributes:
        before: numbers that have no rows.
        size: numbers of a row behind them.
        n_rows: rows.
        kind: type of the numbers in memory.
        is_shared: whether all runs have the same.
        n: how many of these there are, one behind the other.
    """

    before: int
    size: int = 0
    n_rows: int = 0
    kind: str = "double"
    is_shared: bool = False
    n: int = 1

    def room(self, groups: RunGroups) -> int:
        """Numbers of a group's."""
        return self.n * self._numbers(groups.lanes_for(self.n_rows)) * groups.width

    def _numbers(self, n_lanes: int) -> int:
        return self.before + self.size * n_lanes

    def is_as_inside(self, groups: RunGroups) -> bool:
        """Whether the function inside can take it as it is."""
        is_turned = self.n_rows > 0 and groups.lanes_for(self.n_rows) > 1
        has_runs = groups.n_runs is not None and not self.is_shared
        return not is_turned and not has_runs and groups.width == 1

    def turned(self, way: str, outside: str, inside: str, groups: RunGroups) -> list[str]:
        """Its numbers into a group's array (`in`), or out of it."""
        has_runs = groups.n_runs is not None and not self.is_shared
        stride, lanes = (groups.n_runs or 1) if has_runs else 1, groups.lanes_for(self.n_rows)
        lines = []
        if has_runs:
            lines.append(f"  {outside}.of = getelementptr inbounds {self.kind}, ptr {outside}, i64 %run")
            outside = f"{outside}.of"
        for i in range(self.n):
            far, near = f"{outside}.{way}{i}", f"{inside}.{way}{i}"
            outer, inner = i * self._numbers(self.n_rows) * stride, i * self._numbers(lanes) * groups.width
            lines += [
                f"  {far} = getelementptr inbounds {self.kind}, ptr {outside}, i64 {outer}",
                f"  {near} = getelementptr inbounds {self.kind}, ptr {inside}, i64 {inner}",
            ]
            # Sizes are arguments, so that all arrays of a kind share one function of the text.
            numbers = ", ".join(f"i64 {x}" for x in (self.before, self.size, self.n_rows, lanes, stride))
            lines.append(f"  call void @{_turn_name(way, self.kind, has_runs)}(ptr {far}, ptr {near}, {numbers})")
        return lines

    def functions(self, way: str, groups: RunGroups) -> str:
        """The function that `turned` calls."""
        return _turn(way, self.kind, groups.n_runs is not None and not self.is_shared, groups.width)


def function_of(arguments: Sequence[Operand], results: Sequence[Operand], groups: RunGroups, inside: str) -> str:
    """The function that XLA calls.

    Args:
        arguments: its arguments.
        results: its results.
        groups: how it goes through the runs.
        inside: name of a function with pointers to all arguments of a group, then to its results.
    """
    # A dictionary for its order: the text, whose digest is its name, has to be the same in every process.
    room, taken, functions, pointers = [], [], {}, []
    for i, array in enumerate(arguments):
        if array.is_as_inside(groups):
            pointers.append(f"%a{i}")
            continue
        # Room is taken ahead of the loop over groups: within it, `alloca` would take more of the stack in each turn.
        pointers.append(f"%in{i}")
        size = array.room(groups)
        room.append(room_for(f"%in{i}", size, array.kind))
        if groups.lanes_for(array.n_rows) > array.n_rows:  # lanes that stand for no row
            room.append(_zeroed(f"%in{i}", size))
        taken += array.turned("in", f"%a{i}", f"%in{i}", groups)
        functions[array.functions("in", groups)] = None
    given_back = []
    for i, array in enumerate(results):
        if array.is_as_inside(groups):
            pointers.append(f"%r{i}")
            continue
        pointers.append(f"%out{i}")
        room.append(room_for(f"%out{i}", array.room(groups), array.kind))
        given_back += array.turned("out", f"%r{i}", f"%out{i}", groups)
        functions[array.functions("out", groups)] = None
    new_line = "\n"
    body = new_line.join([*taken, call_of(inside, pointers), *given_back])
    # One group alone begins at run 0; the sum is a copy, for which LLVM has no instruction.
    begin, end = "  %run = add i64 0, 0", ""
    # The last group begins earlier where the width does not divide the number of runs: some runs are made twice, with
    # the same results. A group of fewer runs would be a second function.
    if groups.n_runs is not None and groups.n_runs > groups.width:
        last = groups.n_runs - groups.width
        begin = f"""\
  br label %group
group:
  %begin = phi i64 [0, %work], [%next, %group]
  %is.behind = icmp sgt i64 %begin, {last}
  %run = select i1 %is.behind, i64 {last}, i64 %begin"""
        end = f"""\
  %next = add i64 %begin, {groups.width}
  %is.done = icmp sge i64 %next, {groups.n_runs}
  br i1 %is.done, label %end, label %group
end:"""
    return f"""\
declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)
{new_line.join(functions)}
{head(len(arguments), len(results))}
{new_line.join(room)}
{begin}
{body}
{end}
  ret ptr null
}}
"""


def _zeroed(name: str, size: int) -> str:
    return f"  call void @llvm.memset.p0.i64(ptr {name}, i8 0, i64 {8 * size}, i1 false)"


def _turn_name(way: str, kind: str, has_runs: bool) -> str:
    return f"turn.{way}.{kind}.{'runs' if has_runs else 'shared'}"


def _turn(way: str, kind: str, has_runs: bool, width: int) -> str:
    """A function that copies some numbers, and rows behind them into lanes or back, for a group of runs."""
    vector = kind if width == 1 else f"<{width} x {kind}>"
    # Of one number: runs begin anywhere in the arrays of XLA, which has aligned only their first entries.
    align = 1 if kind == "i8" else 8
    if way == "out":
        moved = f"  %x = load {vector}, ptr %q, align {align}\n  store {vector} %x, ptr %p, align {align}"
    elif has_runs or width == 1:
        moved = f"  %x = load {vector}, ptr %p, align {align}\n  store {vector} %x, ptr %q, align {align}"
    else:  # an array that runs share has one number where a group needs a vector
        moved = (
            f"  %one = load {kind}, ptr %p, align {align}\n"
            f"  %first = insertelement {vector} poison, {kind} %one, i64 0\n"
            f"  %x = shufflevector {vector} %first, {vector} poison, <{width} x i32> zeroinitializer\n"
            f"  store {vector} %x, ptr %q, align {align}"
        )

    # Twice in the text, under other names: for what has no rows, and for the rows.
    def places(label: str, far: str, near: str) -> str:
        return (
            f"  %far.{label} = mul i64 {far}, %stride\n"
            f"  %p.{label} = getelementptr inbounds {kind}, ptr %from, i64 %far.{label}\n"
            f"  %near.{label} = mul i64 {near}, {width}\n"
            f"  %q.{label} = getelementptr inbounds {kind}, ptr %to, i64 %near.{label}\n"
            + moved.replace("%p,", f"%p.{label},").replace("%q,", f"%q.{label},")
            .replace("%x", f"%x.{label}").replace("%one", f"%one.{label}").replace("%first", f"%first.{label}")
        )  # fmt: skip

    numbers = ", ".join(f"i64 %{name}" for name in ("before", "size", "n", "lanes", "stride"))
    return f"""
define internal void @{_turn_name(way, kind, has_runs)}(ptr %from, ptr noalias %to, {numbers}) nounwind {{
start:
  %has.before = icmp sgt i64 %before, 0
  br i1 %has.before, label %first.entries, label %rows
first.entries:
  %i = phi i64 [0, %start], [%i.next, %first.entries]
{places("one", "%i", "%i")}
  %i.next = add i64 %i, 1
  %i.done = icmp sge i64 %i.next, %before
  br i1 %i.done, label %rows, label %first.entries
rows:
  %n.all = mul i64 %size, %n
  %has.rows = icmp sgt i64 %n.all, 0
  br i1 %has.rows, label %row, label %end
row:
  %r = phi i64 [0, %rows], [%r.next, %row.end]
  %r.begin = mul i64 %r, %size
  br label %entry
entry:
  %e = phi i64 [0, %row], [%e.next, %entry]
  %at.row = add i64 %r.begin, %e
  %at.rows = add i64 %before, %at.row
  %e.begin = mul i64 %e, %lanes
  %at.lane = add i64 %e.begin, %r
  %at.lanes = add i64 %before, %at.lane
{places("two", "%at.rows", "%at.lanes")}
  %e.next = add i64 %e, 1
  %e.done = icmp sge i64 %e.next, %size
  br i1 %e.done, label %row.end, label %entry
row.end:
  %r.next = add i64 %r, 1
  %r.done = icmp sge i64 %r.next, %n
  br i1 %r.done, label %end, label %row
end:
  ret void
}}
"""

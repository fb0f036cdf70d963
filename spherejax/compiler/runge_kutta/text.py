"""The lines of `tableau` in LLVM's language, as a loop over stages around the functions of the parts (`recipe`).

State and rows of tangents stand behind each other in one array, so that one loop over entries sums up both. Of a group
of runs each entry is a vector of one number for each run, and so is what belongs to a run alone (t, h, `bend`).
"""

from collections.abc import Sequence
from typing import NamedTuple

from spherejax.compiler.emit import llvm_vectors as vectors
from spherejax.compiler.emit.llvm import FunctionText
from spherejax.compiler.native.groups import RunGroups
from spherejax.compiler.operations import BOOL
from spherejax.compiler.runge_kutta import recipe
from spherejax.compiler.runge_kutta.recipe import LinePart, StepRecipe, made_by_rate
from spherejax.compiler.runge_kutta.tableau import Tableau


def step_text(step: StepRecipe, n_arguments: int, groups: RunGroups) -> tuple[set[str], str]:
    """What is to be declared, and functions: `step` has pointers to all arguments, to k, and to sums, of a group."""
    tableau, one = step.tableau, groups.one
    assert tableau is not None
    n, is_explicit = len(tableau.c), step.solve is None
    parts = _Parts(step, groups)
    size = step.size * groups.width
    total = size * (1 + groups.lanes_for(step.n_rows))
    pointers = [f"%a{i}" for i in range(n_arguments)] + ["%k"] + ["%sums"] * bool(tableau.sums)
    # `noalias`: what is made is never what is read, so that LLVM need not load the same number twice.
    arguments = ", ".join(f"ptr noalias {pointer}" for pointer in pointers)
    arrays = ["%moved", "%change"] if is_explicit else ["%moved", "%change", "%right"]
    behind = "total" if tableau.sums else "end"
    begin = _begin_of_explicit(n * total, groups) if is_explicit else ["  %gamma = load double, ptr @rows.gamma"]
    n_made = "%n.of.all" if is_explicit else str(n)
    lines = [
        *_constants(tableau),
        *(part.function for part in parts.every),
        vectors.summing(total),
        f"define internal void @step({arguments}) nounwind {{",
        "work:",
        vectors.room_for("%time", groups.width),
        # Sums begin from %nothing, an array of zeros: one function serves for states and for sums of increments.
        *(vectors.room_for(array, total) for array in [*arrays, "%nothing"]),
        f"  call void @llvm.memset.p0.i64(ptr align 8 %nothing, i8 0, i64 {8 * total}, i1 false)",
        *parts.room,
        "",
        # Rows stand behind the state: parts for tangents get a pointer to the first of them.
        vectors.entry_at("%begin.rows", f"%a{recipe.Y}", size),
        *(vectors.entry_at(f"{array}.rows", array, size) for array in arrays),
        f"  %t = load {one}, ptr %a{recipe.T}, align 8",
        f"  %h = load {one}, ptr %a{recipe.H}, align 8",
        *begin,
        *(part.call for part in parts.ahead),
        f"  br i1 %some, label %stage, label %{behind}" if is_explicit else "  br label %stage",
        "stage:",
        "  %i = phi i64 [0, %work], [%next, %stage]",
        f"  %row = mul nuw nsw i64 %i, {n}",
        # Only the increments before this one are read (n = %i): in a Rosenbrock step the memory of the others has not
        # been written, and a weight of 0 times NaN would be NaN.
        *_sum("%p.a", "@rows.A", "%row", f"%a{recipe.Y}", "%i", "%moved"),
        *([] if is_explicit else _sum("%p.c", "@rows.C", "%row", "%nothing", "%i", "%right")),
        *_time(groups, is_bent=is_explicit),
        *(part.call for part in parts.rates),
        *(_explicit_increments(total, groups) if is_explicit else _solved_increments(parts, size, total, groups)),
        "  %next = add nuw nsw i64 %i, 1",
        f"  %is.done = icmp sge i64 %next, {n_made}",
        f"  br i1 %is.done, label %{behind}, label %stage",
        *(_sums(tableau, total) if tableau.sums else []),
        "end:",
        "  ret void",
        "}",
        "",
    ]
    return parts.declared, "\n".join(lines)


# The tableau --------------------------------------------------------------------------------------------------------


def _constants(tableau: Tableau) -> list[str]:
    # In tables: with coefficients as numbers of the text each stage would need a copy of f, and its compilation.
    matrices, rows = {"A": tableau.A, "C": tableau.C}, {"c": tableau.c, "d": tableau.d}
    arrays = {name: [x for row in matrix for x in row] for name, matrix in matrices.items()} | rows
    arrays |= {"gamma": [tableau.gamma] if tableau.C else [], "sums": [x for row in tableau.sums for x in row]}
    return [
        f"@rows.{name} = private constant [{len(numbers)} x double] [{vectors.listed(numbers)}]"
        for name, numbers in arrays.items()
        if numbers
    ]


def _sum(pointer: str, weights: str, row: str, begin: str, n: str, to: str) -> list[str]:
    """Of the first n increments, with a row of weights."""
    return [
        f"  {pointer} = getelementptr inbounds double, ptr {weights}, i64 {row}",
        f"  call void @sum(ptr {begin}, ptr %k, ptr {pointer}, i64 {n}, ptr {to})",
    ]


def _time(groups: RunGroups, is_bent: bool) -> list[str]:
    """The time of a stage; of an explicit step with its length, in a time that is stretched."""
    one, share = groups.one, "%c" if is_bent else "%instant"
    bent = [
        f"  %rest = fsub {one} %unit, %c",
        f"  %bent = fmul {one} %bend, %rest",
        f"  %straight = fsub {one} %unit, %bent",
        f"  %instant = fmul {one} %c, %straight",
    ]
    length = [
        f"  %turn = fsub {one} %rest, %c",
        f"  %slow = fmul {one} %bend, %turn",
        f"  %speed = fsub {one} %unit, %slow",
        f"  %length = fmul {one} %h, %speed",
    ]
    return [
        "  %p.instant = getelementptr inbounds double, ptr @rows.c, i64 %i",
        "  %instant.of.all = load double, ptr %p.instant",
        groups.for_all_runs(share, "%instant.of.all"),
        *(bent if is_bent else []),
        f"  %after = fmul {one} %instant, %h",
        f"  %t.i = fadd {one} %t, %after",
        f"  store {one} %t.i, ptr %time, align 8",
        *(length if is_bent else []),
    ]


def _sums(tableau: Tableau, total: int) -> list[str]:
    """The wanted sums of all increments, in a loop behind that over stages."""
    n = len(tableau.c)
    return [
        "total:",
        # From %work directly where no stage is made at all.
        "  %m = phi i64 [0, %work], [0, %stage], [%m.next, %total]",
        f"  %m.row = mul nuw nsw i64 %m, {n}",
        f"  %m.to = mul nuw nsw i64 %m, {total}",
        "  %p.m = getelementptr inbounds double, ptr %sums, i64 %m.to",
        *_sum("%p.w", "@rows.sums", "%m.row", "%nothing", str(n), "%p.m"),
        "  %m.next = add nuw nsw i64 %m, 1",
        f"  %m.done = icmp sge i64 %m.next, {len(tableau.sums)}",
        "  br i1 %m.done, label %end, label %total",
    ]


# Explicit -----------------------------------------------------------------------------------------------------------


def _begin_of_explicit(size: int, groups: RunGroups) -> list[str]:
    return [
        f"  %bend = load {groups.one}, ptr %a{recipe.BEND}, align 8",
        f"  %n.of.all = load i64, ptr %a{recipe.N_MADE}",
        groups.for_all_runs("%unit", "0x3FF0000000000000"),
        # Stages that are not made stay zero, so that sums over all of them are right whatever their number is.
        f"  call void @llvm.memset.p0.i64(ptr align 8 %k, i8 0, i64 {8 * size}, i1 false)",
        "  %some = icmp sgt i64 %n.of.all, 0",
    ]


def _explicit_increments(total: int, groups: RunGroups) -> list[str]:
    """k_i = length f, for state and rows."""

    def increment(i: int, at: int, kind: str) -> str:
        # Of a group the length is a vector of the runs' own already; of one run it is a number for all entries.
        is_group = groups.width > 1
        lines = [
            vectors.loaded(f"%f{i}", "%change", at, kind),
            *([] if is_group else [vectors.spread_out(f"%h{i}.wide", "%length", kind)]),
            f"  %hf{i} = fmul {kind} {'%length' if is_group else f'%h{i}.wide'}, %f{i}",
            vectors.stored(f"%hf{i}", "%p.to", at, kind),
        ]
        return "\n".join(lines)

    return [
        f"  %to = mul nuw nsw i64 %i, {total}",
        "  %p.to = getelementptr inbounds double, ptr %k, i64 %to",
        groups.in_vectors(total, increment),
    ]


# Rosenbrock ---------------------------------------------------------------------------------------------------------


def _solved_increments(parts: "_Parts", size: int, total: int, groups: RunGroups) -> list[str]:
    """k_i = gamma S(right side), for the state and then for rows."""
    is_group = groups.width > 1

    def right_side(i: int, at: int, kind: str) -> str:
        lines = [
            vectors.loaded(f"%s{i}", "%right", at, kind),
            vectors.loaded(f"%f{i}", "%change", at, kind),
            vectors.loaded(f"%u{i}", f"%a{recipe.SLOPE}", at, kind),
            # h is each run's own; d is the method's, the same for all.
            vectors.add_scaled(f"%b{i}", f"%s{i}", "%h", f"%f{i}", kind, is_group),
            vectors.add_scaled(f"%w{i}", f"%b{i}", "%d", f"%u{i}", kind),
            vectors.stored(f"%w{i}", "%right", at, kind),
        ]
        return "\n".join(lines)

    def times_gamma(i: int, at: int, kind: str) -> str:
        lines = [
            vectors.loaded(f"%x{i}", "%solution", at, kind),
            vectors.spread_out(f"%gamma{i}", "%gamma", kind),
            f"  %g{i} = fmul {kind} %gamma{i}, %x{i}",
            vectors.stored(f"%g{i}", "%solution", at, kind),
        ]
        return "\n".join(lines)

    return [
        "  %p.d = getelementptr inbounds double, ptr @rows.d, i64 %i",
        "  %d = load double, ptr %p.d",
        f"  %to = mul nuw nsw i64 %i, {total}",
        # S writes into k itself. Its rows are multiplied with gamma behind the tangents of the matrix, which take
        # k / gamma: the solution itself.
        "  %solution = getelementptr inbounds double, ptr %k, i64 %to",
        f"  %solution.rows = getelementptr inbounds double, ptr %solution, i64 {size}",
        groups.in_vectors(total, right_side),
        *(part.call for part in parts.solve),
        *_bent_right_side(parts, total - size, groups),
        *(part.call for part in parts.solve_rows),
        groups.in_vectors(total, times_gamma),
    ]


def _bent_right_side(parts: "_Parts", size: int, groups: RunGroups) -> list[str]:
    """Adds gamma h J' k / gamma to the right side of the rows, `size` numbers of them."""
    if not parts.bends:
        return []
    lines = [*(part.call for part in parts.bends), f"  %gamma.h = load {groups.one}, ptr %a{parts.gamma_h}, align 8"]
    for i, at, kind in groups.vectors(size):
        lines += [
            vectors.loaded(f"%rr{i}", "%right.rows", at, kind),
            vectors.loaded(f"%rb{i}", f"%bend{len(parts.bends) - 1}.0", at, kind),
            vectors.add_scaled(f"%rw{i}", f"%rr{i}", "%gamma.h", f"%rb{i}", kind, groups.width > 1),
            vectors.stored(f"%rw{i}", "%right.rows", at, kind),
        ]
    return lines


# Parts --------------------------------------------------------------------------------------------------------------


class _Written(NamedTuple):
    """A part as text.

    Attributes:
        declared: what is declared.
        function: its function.
        room: for what it makes.
        call: of it.
    """

    declared: set[str]
    function: str
    room: list[str]
    call: str


def _written(part: LinePart, name: str, results: list[str], groups: RunGroups) -> _Written:
    line = part.line
    # Lanes of rows follow from the width of a group, which the recipe does not know: it holds for any number of runs.
    lanes = (groups.lanes_for(part.n_rows),) if part.n_rows else part.lanes
    text = FunctionText(line, lanes, part.axes or (0,) * len(part.sources), groups.width)
    declared, function = text.written_inside(name)
    sizes = (
        output.size * (text.n_lanes if over else 1) * groups.width
        for output, over in zip(line.outputs, text.outputs_spread, strict=True)
    )
    room = [
        vectors.room_for(f"%{result}", size, "i8" if line.dtype(output) == BOOL else "double")
        for result, output, size in zip(results, line.outputs, sizes, strict=True)
    ]
    pointers = [f"%a{source}" if isinstance(source, int) else f"%{source}" for source in part.sources]
    return _Written(declared, function, room, vectors.call_of(name, [*pointers, *(f"%{result}" for result in results)]))


class _Parts:
    """All parts of a step as text.

    Attributes:
        ahead: what is evaluated once.
        rates: f, and its tangents if there are rows.
        solve, solve_rows: S for the state and for the rows.
        bends: what is evaluated between these two.
        gamma_h: as of the rows.
    """

    def __init__(self, step: StepRecipe, groups: RunGroups):
        def written(parts: Sequence[LinePart], name: str, result: str) -> list[_Written]:
            """With results `made0.0`, `made0.1`, ... of a part 0."""
            return [
                _written(part, f"{name}{at}", [f"{result}{at}.{i}" for i in range(len(part.line.outputs))], groups)
                for at, part in enumerate(parts)
            ]

        rows = step.rows
        coefficients = [made_by_rate(i) for i in range(1, len(step.rate.line.outputs))]
        rate = _written(step.rate, "rate", ["change", *coefficients], groups)
        along = [] if rows is None else [_written(rows.along, "along", ["change.rows"], groups)]
        again = None if rows is None else rows.solve
        self.ahead = written(step.ahead, "part", "made")
        self.rates = [rate, *along]
        self.solve = [] if step.solve is None else [_written(step.solve, "solve", [recipe.SOLUTION], groups)]
        self.solve_rows = [] if again is None else [_written(again, "solve.rows", ["solution.rows"], groups)]
        self.bends = [] if rows is None else written(rows.bends, "bend", "bend")
        self.gamma_h = 0 if rows is None else rows.gamma_h
        self.every = [*self.ahead, rate, *self.solve, *along, *self.solve_rows, *self.bends]

    @property
    def declared(self) -> set[str]:
        """What is to be declared."""
        return set().union(*(part.declared for part in self.every))

    @property
    def room(self) -> list[str]:
        """For what parts make: `%change` stands in the text, and S writes into k, where increments belong."""
        return [line for part in [*self.ahead, *self.bends] for line in part.room] + self.rates[0].room[1:]

"""All stages of an explicit Runge-Kutta step in one call of machine code.

    k_i = h (1 - bend (1 - 2 c_i)) f(t + c_i (1 - bend (1 - c_i)) h, y + sum_j a_ij k_j)

and sums of them, with the weights of the step's end and of its error. One by one, twelve stages of a step would cost
XLA a call and several kernels each, more than a small right-hand side takes. Here the stages are a loop around the
line's own function. Tangents of the state go along, if there are some: its derivative's function is in the same loop,
over as many lanes. Many runs are a loop around all of this, over groups of them (`groups`).
"""

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import mlir

from spherejax.compiler.emit import llvm_vectors as vectors
from spherejax.compiler.emit.llvm import FunctionText, widest_for
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.native.groups import Operand, RunGroups, function_of
from spherejax.compiler.operations import BOOL, FLOAT
from spherejax.compiler.primitive import ActiveInputs, StraightLine
from spherejax.compiler.program import ScalarProgram

LARGEST_STATE = 512
"""Vectors of a state, with its rows, up to which stages are kept on the stack."""


_TIME = 1
"""Place of t among the arguments (numbers, t, y) of a program."""


def explicit_stages(
    program: ScalarProgram,
    tableau: tuple[np.ndarray, np.ndarray, Sequence[np.ndarray]],
    t: Array,
    h: Array,
    bend: Array,
    y: Array,
    n_made: Any,
    numbers: Array,
    ahead: tuple[Array, ...],
    slopes: tuple[Array, tuple[Array | None, ...]] | None = None,
    moving: tuple[int, ...] | None = None,
) -> tuple[Array, Array] | None:
    """All stages of an explicit Runge-Kutta step of many runs by one call; None where it cannot be machine code.

    Args:
        program: of a rate f(numbers, t, y) that returns dy/dt. The numbers are its leading argument.
        tableau: the coefficients a (strictly lower, one row for each stage), the instants c, and weights of the sums
            over the stages that are wanted.
        t, h, bend: time, length of the step, and how the time within it is stretched (0: not at all), shape (n_runs,).
        y: state, shape (size, n_runs), or with tangents below it (1 + rows, size, n_runs).
        n_made: how many stages are evaluated, the first ones; increments of the others are zero.
        numbers: shape (n, n_runs).
        ahead: what `program.ahead` has evaluated, with a last axis of runs.
        slopes: tangents of `numbers` and of `ahead`, with an axis of rows in front; None without rows.
        moving: entries of `numbers` that have tangents; None for all.

    Returns:
        The increments k of the stages, shape (s, size, n_runs), and their sums, shape (m, size, n_runs). With rows each
        has an axis of 1 + rows in front of its size.
    """
    if not machine_code.native_code_enabled():
        return None
    # How arguments are passed on is the same for all runs: the first one shows it.
    first = jax.tree.map(lambda x: x[..., 0], ahead)
    line, _ = program.line_inside(first)
    if not can_be_called(line, y.shape[:-1]):
        return None
    others = _over_runs(lambda x, ahead: (x, *program.line_inside(ahead)[1]))(numbers, ahead)
    along = entries = None
    if slopes is not None:
        with_numbers = _over_runs(lambda x, *both: (x, *program.slopes_inside(*both)))
        along = with_numbers(slopes[0], ahead, slopes[1])
        if moving is not None:
            entries = program.moving_inside(first, moving)
    return stages(line, _TIME, ExplicitMethod.of(*tableau), t, h, bend, y, n_made, others, along, entries)


def _over_runs(function: Callable) -> Callable:
    return jax.vmap(function, in_axes=-1, out_axes=-1)


def can_be_called(line: StraightLine, shape: tuple[int, ...]) -> bool:
    """Whether the stages of a line that returns a state can be one call.

    Args:
        line: f.
        shape: of the state, or of the state and rows of tangents below it.
    """
    (output, *others) = line.outputs
    # A line that returns more than the rate would need a place for it in each stage.
    is_state = not others and output.shape == shape[-1:] and line.dtype(output) == FLOAT
    # As one run, in vectors of several entries; of a group of runs each entry is a vector.
    size = output.size if len(shape) == 1 else output.size * (1 + RunGroups().lanes_for(shape[0] - 1))
    fits = 0 < size <= LARGEST_STATE * RunGroups().at_a_time
    return is_state and fits and line.in_machine_code and machine_code.is_available() and line.can_be_called


def stages(
    line: StraightLine,
    at: int,
    method: "ExplicitMethod",
    t: Array,
    h: Array,
    bend: Array,
    y: Array,
    n_made: Any,
    others: Sequence[Array],
    along: Sequence[Array | None] | None = None,
    moving: Sequence[ActiveInputs] | None = None,
) -> tuple[Array, Array]:
    """The increments k, shape (s, size, n_runs), and sums of them, shape (m, size, n_runs).

    With rows of tangents below the state each has an axis of 1 + rows in front of its size.

    Args:
        line: f.
        at: place of t among its arguments; y is behind it.
        method: the tableau.
        t, h, bend: as above, with a last axis of runs.
        y: shape (size, n_runs), or with tangents of it below it (1 + rows, size, n_runs).
        n_made: so many stages are evaluated, the first ones; increments of the others are zero.
        others: the other arguments of the line, in order; with a last axis of runs.
        along: tangents of `others`, with a leading axis of rows; None for what has none. None without rows.
        moving: which entries of `others` move at all; None for all of what has tangents.
    """
    rows = None
    if along is not None:
        moves: tuple[ActiveInputs, ...] = tuple(tangents is not None for tangents in along)
        if moving is not None:
            moves = tuple(some if has else False for has, some in zip(moves, moving, strict=True))
            along = [entries_at(x, some) for x, some in zip(along, moves, strict=True)]
        # Time has no tangent within a step (`bend` and h are the same for all rows); the state always has one.
        derivative = line.derivative((*moves[:at], False, True, *moves[at:]))
        assert derivative.follows == (True,), "a rate that does not depend on the state"
        line, rows = derivative.values, _Rows(derivative.slopes, tuple(map(bool, moves)), y.shape[0] - 1)
        others = *others, *(x for x in along if x is not None)
    n_runs = y.shape[-1]
    # One run is written without groups: its entries are the vectors then, and its numbers stay numbers.
    if n_runs == 1:
        t, h, bend, *others = (jnp.squeeze(x, -1) for x in (t, h, bend, *others))
    arguments = t, h, bend, jnp.asarray(n_made, jnp.int64), y, *others
    how = {"method": method._replace(at=at), "n_runs": None if n_runs == 1 else n_runs}
    k, sums = _stages.bind(*arguments, line=line, rows=rows, **how)
    return k, sums


def entries_at(x: Array | None, some: ActiveInputs) -> Array | None:
    """Some entries of an array, by their numbers along its second axis; None for none.

    In pieces: a loop of machine code (`loops`) has no rule for any entries whatever.
    """
    if x is None or not some:
        return None
    if some is True:
        return x
    breaks = [0, *(i for i in range(1, len(some)) if some[i] != some[i - 1] + 1), len(some)]
    pieces = [x[:, some[begin] : some[end - 1] + 1] for begin, end in itertools.pairwise(breaks)]
    return pieces[0] if len(pieces) == 1 else jnp.concatenate(pieces, 1)


class ExplicitMethod(NamedTuple):
    """A tableau.

    Attributes:
        coefficients: a, strictly lower.
        instants: c.
        sums: weights of what is summed over the stages.
        at: place of t among the arguments of f.
    """

    coefficients: tuple[tuple[float, ...], ...]
    instants: tuple[float, ...]
    sums: tuple[tuple[float, ...], ...]
    at: int = 0

    @classmethod
    def of(cls, coefficients: np.ndarray, instants: np.ndarray, sums: Sequence[np.ndarray]) -> "ExplicitMethod":
        """Of arrays; weights of stages that are not there do not count."""
        n = len(instants)
        weights = (tuple(np.asarray(row)[:n].tolist()) + (0.0,) * (n - len(row)) for row in sums)
        return cls(tuple(map(tuple, coefficients.tolist())), tuple(instants.tolist()), tuple(weights))


class _Rows(NamedTuple):
    """What makes the rows below a state: the line of their rates, which of the other arguments move, how many rows."""

    line: StraightLine
    moves: tuple[bool, ...]
    n: int


_stages = Primitive("stages")
_stages.multiple_results = True


@_stages.def_abstract_eval
def _shapes(t: Any, h: Any, bend: Any, n_made: Any, y: Any, *others: Any, method: ExplicitMethod, **what: Any) -> list:
    del t, h, bend, n_made, others, what
    return [ShapedArray((n, *y.shape), y.dtype) for n in (len(method.instants), len(method.sums))]


def _target(
    avals: Sequence, *, line: StraightLine, rows: _Rows | None, method: ExplicitMethod, n_runs: int | None
) -> str:
    del avals
    # A line with coefficients belongs to one line of slopes.
    key = "stages", rows and rows.n, method, n_runs
    return machine_code.called_text(key, line, lambda: _text(line, rows, method, n_runs), is_wide=n_runs is not None)


def _lowered(context: Any, *arguments: Any, **how: Any) -> Sequence:
    return jax.ffi.ffi_lowering(_target(context.avals_in, **how))(context, *arguments)


machine_code.TARGETS["stages"] = _target
mlir.register_lowering(_stages, _lowered, platform="cpu")


def _groups(line: StraightLine, rows: _Rows | None, n_runs: int | None) -> RunGroups:
    # A state with rows that is beyond the stack goes one run at a time.
    size, lines = int(line.outputs[0].size), (line,) if rows is None else (line, rows.line)
    widest = widest_for(*lines) if size * (1 + (rows.n if rows else 0)) <= LARGEST_STATE else 1
    return RunGroups.of(n_runs, widest)


def _text(line: StraightLine, rows: _Rows | None, method: ExplicitMethod, n_runs: int | None) -> str:
    groups = _groups(line, rows, n_runs)
    declared, inner = _stages_text(line, rows, method, groups)
    size = int(line.outputs[0].size)
    below: Any = (size, rows.n) if rows else ()
    others = [Operand(int(np.prod(shape)), kind=kind) for shape, kind in _others(line, method)]
    tangents = [Operand(0, int(np.prod(shape)), rows.n) for shape in _tangents(rows, method)] if rows else []
    operands = (
        Operand(1),
        Operand(1),
        Operand(1),
        Operand(1, kind="i64", is_shared=True),
        Operand(size, *below),
        *others,
        *tangents,
    )
    results = [Operand(size, *below, n=n) for n in (len(method.instants), len(method.sums))]
    called = function_of(operands, results, groups, "stages")
    # Sorted: the name of the function is a digest of its text, which has to be the same in every process.
    return "\n".join([*sorted(declared), inner, called])


def _others(line: StraightLine, method: ExplicitMethod) -> list[tuple[tuple[int, ...], str]]:
    """Shapes and types of the arguments of f besides t and y."""
    of_residuals = ["i8" if line.dtype(group) == BOOL else "double" for group in line.residuals]
    kinds = ["double"] * len(line.shapes) + of_residuals
    shapes = [*line.shapes, *(group.shape for group in line.residuals)]
    both = [*zip(shapes, kinds, strict=True)]
    return both[: method.at] + both[method.at + 2 :]


def _tangents(rows: _Rows, method: ExplicitMethod) -> list[tuple[int, ...]]:
    """Shapes of the tangents among the arguments, besides that of the state."""
    at = _place_of_state(rows, method)
    return [shape for i, shape in enumerate(rows.line.shapes) if i != at]


_STATE = 4
"""Place of y among the arguments of the stages; before it are t, h, bend and the number of stages."""


def _stages_text(
    line: StraightLine, rows: _Rows | None, method: ExplicitMethod, groups: RunGroups
) -> tuple[set[str], str]:
    """What is to be declared, and functions: `stages` has pointers to all arguments, to k, and to sums, of a group."""
    coefficients, instants, sums, at = method
    n, n_sums = len(instants), len(sums)
    width, n_lanes = groups.width, groups.lanes_for(rows.n) if rows else 0
    n_values = int(line.outputs[0].size) * width
    size = n_values * (1 + n_lanes)
    rate = FunctionText(line, (), (0,) * (len(line.shapes) + len(line.residuals)), width)
    declared, inner = rate.written_inside("rate")
    # In the order of `operands`: those of f first, then tangents, which `along` reads from the same counter.
    numbers = (f"%a{i}" for i in itertools.count(_STATE + 1))
    pointers = ["%time" if i == at else "%moved" if i == at + 1 else next(numbers) for i in range(rate.n_arguments)]
    made = [f"%made{i}" for i in range(1, len(line.outputs))]
    calls = vectors.call_of("rate", [*pointers, "%change", *made])
    memory = [
        vectors.room_for(name, output.size * width, "i8" if line.dtype(output) == BOOL else "double")
        for name, output in zip(made, line.outputs[1:], strict=True)
    ]
    if rows is not None:
        over = (int(n_lanes > 1),) * len(rows.line.shapes) + (0,) * len(made)
        more, along = FunctionText(rows.line, (n_lanes,) * (n_lanes > 1), over, width).written_inside("along")
        # State and rows stand behind each other in one array, so that one loop over entries sums up both.
        declared, inner = declared | more, inner + along
        state = _place_of_state(rows, method)
        moving = ["%moved.rows" if i == state else next(numbers) for i in range(len(rows.line.shapes))]
        calls += vectors.call_of("along", [*moving, *made, "%change.rows"])
    n_arguments = rate.n_arguments + 3 + (sum(rows.moves) if rows else 0)

    def kept(i: int, begin: int, kind: str) -> str:
        length = "%length" if width > 1 else f"%h{i}.wide"
        lines = [vectors.loaded(f"%f{i}", "%change", begin, kind)]
        # Of a group the length is a vector of the runs' own already; of one run it is a number for all entries.
        lines += [] if width > 1 else [vectors.spread_out(length, "%length", kind)]
        lines += [f"  %hf{i} = fmul {kind} {length}, %f{i}", vectors.stored(f"%hf{i}", "%p.to", begin, kind)]
        return "\n".join(lines)

    new_line, one = "\n", groups.one  # a name, because f-strings have no backslashes before Python 3.12
    arguments = ", ".join(f"ptr noalias %a{i}" for i in range(n_arguments))
    # Stages that are not made stay zero (memset of %r0), so that sums over all of them are right whatever `n_made` is.
    # Sums begin from %nothing, an array of zeros: one function serves for states and for sums of increments.
    text = f"""\
@coefficients = private constant [{n * n} x double] [{vectors.listed(x for row in coefficients for x in row)}]
@instants = private constant [{n} x double] [{vectors.listed(instants)}]
@weights = private constant [{n * n_sums} x double] [{vectors.listed(x for row in sums for x in row)}]
{inner}
{vectors.summing(size)}
define internal void @stages({arguments}, ptr noalias %r0, ptr noalias %r1) nounwind {{
work:
{vectors.room_for("%time", width)}
{vectors.room_for("%moved", size)}
{vectors.room_for("%change", size)}
{vectors.room_for("%nothing", size)}
  call void @llvm.memset.p0.i64(ptr align 8 %nothing, i8 0, i64 {8 * size}, i1 false)
{vectors.entry_at("%moved.rows", "%moved", n_values)}
{vectors.entry_at("%change.rows", "%change", n_values)}
{new_line.join(memory)}
  %t = load {one}, ptr %a0, align 8
  %h = load {one}, ptr %a1, align 8
  %bend = load {one}, ptr %a2, align 8
  %n.of.all = load i64, ptr %a3
{groups.for_all_runs("%unit", "0x3FF0000000000000")}
  call void @llvm.memset.p0.i64(ptr align 8 %r0, i8 0, i64 {8 * n * size}, i1 false)
  %some = icmp sgt i64 %n.of.all, 0
  br i1 %some, label %stage, label %total
stage:
  %i = phi i64 [0, %work], [%next, %stage]
  %row = mul nuw nsw i64 %i, {n}
  %p.a = getelementptr inbounds double, ptr @coefficients, i64 %row
  call void @sum(ptr %a4, ptr %r0, ptr %p.a, i64 %i, ptr %moved)
  %p.c = getelementptr inbounds double, ptr @instants, i64 %i
  %c.of.all = load double, ptr %p.c
{groups.for_all_runs("%c", "%c.of.all")}
  %rest = fsub {one} %unit, %c
  %bent = fmul {one} %bend, %rest
  %straight = fsub {one} %unit, %bent
  %instant = fmul {one} %c, %straight
  %after = fmul {one} %instant, %h
  %t.i = fadd {one} %t, %after
  store {one} %t.i, ptr %time, align 8
  %turn = fsub {one} %rest, %c
  %slow = fmul {one} %bend, %turn
  %speed = fsub {one} %unit, %slow
  %length = fmul {one} %h, %speed
{calls}  %to = mul nuw nsw i64 %i, {size}
  %p.to = getelementptr inbounds double, ptr %r0, i64 %to
{groups.in_vectors(size, kept)}
  %next = add nuw nsw i64 %i, 1
  %is.done = icmp sge i64 %next, %n.of.all
  br i1 %is.done, label %total, label %stage
total:
  %m = phi i64 [0, %work], [0, %stage], [%m.next, %total]
  %m.row = mul nuw nsw i64 %m, {n}
  %p.w = getelementptr inbounds double, ptr @weights, i64 %m.row
  %m.to = mul nuw nsw i64 %m, {size}
  %p.m = getelementptr inbounds double, ptr %r1, i64 %m.to
  call void @sum(ptr %nothing, ptr %r0, ptr %p.w, i64 {n}, ptr %p.m)
  %m.next = add nuw nsw i64 %m, 1
  %m.done = icmp sge i64 %m.next, {n_sums}
  br i1 %m.done, label %end, label %total
end:
  ret void
}}
"""
    return declared, text


def _place_of_state(rows: _Rows, method: ExplicitMethod) -> int:
    """Among the arguments of the rates of rows, which are those of f that move."""
    return sum(rows.moves[: method.at])

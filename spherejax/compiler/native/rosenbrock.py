"""All stages of a Rosenbrock step in one call of machine code.

    k_i = gamma S(h f(t + c_i h, y + sum_j A_ij k_j) + sum_j C_ij k_j + d_i h^2 df/dt)

f and S are straight lines: the right-hand side, and the solver of (I - gamma h J) x = b. One by one, eight stages of a
step would cost XLA two calls and several kernels each, as much as the two functions themselves take. What S needs is
evaluated ahead in the same call. Tangents of the state go along, if there are some, over as many lanes:

    k_i' = gamma S(h f_i' + sum_j C_ij k_j' + d_i h^2 (df/dt)' + gamma h J' k_i / gamma)

f_i' is what makes the tangents of f, and J' k is made by parts of its own. Many runs are a loop around all of this,
over groups of them (`groups`).
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir

from spherejax.compiler.emit import llvm_vectors as vectors
from spherejax.compiler.emit.llvm import FunctionText, widest_for
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.native.groups import Operand, RunGroups, function_of
from spherejax.compiler.operations import BOOL, FLOAT
from spherejax.compiler.primitive import StraightLine

LARGEST_STATE = 128
"""Vectors of a state, with its rows, up to which stages are kept on the stack."""

LARGEST_ROOM = 2**19
"""Bytes of what is made in a step of a group of runs, at most: a thread of XLA's pool has a few megabytes."""


class RosenbrockMethod(NamedTuple):
    """A Rosenbrock method, in the letters above; see `rosenbrock_tableaus`."""

    A: tuple[tuple[float, ...], ...]
    C: tuple[tuple[float, ...], ...]
    c: tuple[float, ...]
    d: tuple[float, ...]
    gamma: float

    @classmethod
    def of(cls, tableau: Any) -> "RosenbrockMethod":
        """Of a tableau with these letters."""
        A, C = (tuple(map(tuple, np.asarray(matrix).tolist())) for matrix in (tableau.A, tableau.C))
        c, d = (tuple(np.asarray(vector).tolist()) for vector in (tableau.c, tableau.d))
        return cls(A, C, c, d, float(tableau.gamma))


class LinePart(NamedTuple):
    """A straight line that is evaluated in the call.

    Attributes:
        line: the line.
        sources: of each of its arguments: a number for an argument of the call, else a name: of what a stage makes
            (`TIME`, `MOVED`, `RIGHT`), or of what another part has made (`made`).
        lanes, axes: as of the operation `straight_line`.
        n_rows: how many rows its lanes are for, instead of `lanes`.
    """

    line: StraightLine
    sources: tuple[int | str, ...]
    lanes: tuple[int, ...] = ()
    axes: tuple[int, ...] = ()
    n_rows: int = 0


TIME, MOVED, RIGHT, FOUND = "time", "moved", "right", "found"
"""Of a stage: the arguments of f, the right side, and what S gives."""

BEGIN_ROWS, MOVED_ROWS = "begin.rows", "moved.rows"
"""Tangents of the state at the start of a step, and of the argument of f; over lanes."""


def made(part: int, output: int) -> str:
    """The name of an output of one of the parts that are evaluated ahead of the stages."""
    return f"made{part}.{output}"


def made_by_rate(output: int) -> str:
    """The name of an output of f: the first one is its value."""
    return f"rate{output}"


def rows_of(argument: int) -> str:
    """The name of an argument that has a leading axis of rows, over lanes."""
    return f"rows{argument}"


def over_lanes(line: StraightLine, sources: Sequence[int | str], wide: Sequence[bool], n_rows: int) -> "LinePart":
    """A part some of whose arguments are over lanes, one for each row."""
    if n_rows == 1:
        return LinePart(line, tuple(sources))
    return LinePart(line, tuple(sources), axes=tuple(map(int, wide)), n_rows=n_rows)


class Rows(NamedTuple):
    """Tangents that go along with the state.

    Attributes:
        n: how many.
        operands: arguments of the call that have an axis of rows, and the sizes of a row.
        along: what makes the tangents of f.
        bends: what is evaluated behind S, and what makes dJ/dy Y k of it, the last; empty where J is constant.
        solve: S for the tangents.
        gamma_h: place of gamma h among the arguments of the call.
    """

    n: int
    operands: tuple[tuple[int, int], ...]
    along: LinePart
    bends: tuple[LinePart, ...]
    solve: LinePart
    gamma_h: int


class RosenbrockSteps(NamedTuple):
    """What is done in a step.

    Attributes:
        ahead: evaluated once, in order.
        rate: f, with what its tangents are made of.
        solve: S.
        method: the method; None while it is not known yet.
        rows: tangents; None without.
    """

    ahead: tuple[LinePart, ...]
    rate: LinePart
    solve: LinePart
    method: RosenbrockMethod | None = None
    rows: Rows | None = None

    @property
    def parts(self) -> tuple[LinePart, ...]:
        """All of them."""
        of_rows = () if self.rows is None else (self.rows.along, *self.rows.bends, self.rows.solve)
        return *self.ahead, self.rate, self.solve, *of_rows


def can_be_called(steps: RosenbrockSteps, size: int) -> bool:
    """Whether the stages of a step of a state of so many entries can be one call."""
    n = _size_of(steps, size, RunGroups())
    if not machine_code.native_code_enabled() or not 0 < n <= LARGEST_STATE * RunGroups().at_a_time:
        return False
    if not all(part.line.in_machine_code and part.line.can_be_called for part in steps.parts):
        return False
    return all(
        part.line.outputs[0].shape == (size,) and part.line.dtype(part.line.outputs[0]) == FLOAT
        for part in (steps.rate, steps.solve)
    )


def _size_of(steps: RosenbrockSteps, size: int, groups: RunGroups) -> int:
    """Entries of a state with its rows."""
    return size * (1 + (0 if steps.rows is None else groups.lanes_for(steps.rows.n)))


def rosenbrock_stages(steps: RosenbrockSteps, t: Array, h: Array, y: Array, slope: Array, *others: Array) -> Array:
    """The increments k, shape (s, size), or (s, 1 + rows, size).

    Args:
        steps: what is done.
        t, h, y: where the step starts [s], how long it is [s], the state there, with rows of tangents below it.
        slope: h^2 df/dt there, in the same shape.
        others: the other arguments of the parts; `sources` count from t.
    """
    arguments = t, h, y, slope, *others
    (k,) = _rosenbrock_stages.bind(*arguments, steps=steps, n_runs=None, shared=(False,) * len(arguments))
    return k


_rosenbrock_stages = Primitive("rosenbrock_stages")
_rosenbrock_stages.multiple_results = True


@_rosenbrock_stages.def_abstract_eval
def _shapes(t: Any, h: Any, y: Any, *others: Any, steps: RosenbrockSteps, **how: Any) -> list:
    del t, h, others, how
    assert steps.method is not None
    return [ShapedArray((len(steps.method.c), *y.shape), y.dtype)]


def _batched(arguments: Sequence, dims: Sequence, **how: Any) -> tuple[Sequence, Sequence]:
    """More runs, on a last axis; a run alone needs none, and of two axes one is gone along."""
    n = next(x.shape[dim] for x, dim in zip(arguments, dims, strict=True) if dim is not None)
    if n == 1:  # without an axis of runs its text, and so its machine code, is that of a run alone
        alone = [x if dim is None else jnp.squeeze(x, dim) for x, dim in zip(arguments, dims, strict=True)]
        return [x[None] for x in _rosenbrock_stages.bind(*alone, **how)], [0]
    if how["n_runs"] is not None:  # groups have one axis of runs: the new one is a loop around the call
        moved = [None if dim is None else jnp.moveaxis(x, dim, 0) for x, dim in zip(arguments, dims, strict=True)]

        def one(parts: Sequence) -> list[Array]:
            operands = (x if part is None else part for x, part in zip(arguments, parts, strict=True))
            return _rosenbrock_stages.bind(*operands, **how)

        return jax.lax.map(one, moved), [0]
    behind = [x if dim is None else jnp.moveaxis(x, dim, -1) for x, dim in zip(arguments, dims, strict=True)]
    shared = [dim is None for dim in dims]
    # Where a step begins differs between runs as a rule; what the caller shares, its seeds, say, is read once for all.
    for i in range(_N_OF_STEP):
        behind[i] = jnp.broadcast_to(behind[i][..., None], (*behind[i].shape, n)) if shared[i] else behind[i]
        shared[i] = False
    (k,) = _rosenbrock_stages.bind(*behind, steps=how["steps"], n_runs=n, shared=tuple(shared))
    return [k], [k.ndim - 1]


_N_OF_STEP = 4
"""Arguments that say where a step begins: t, h, y, slope."""

batching.primitive_batchers[_rosenbrock_stages] = _batched


def _target(avals: Sequence, *, steps: RosenbrockSteps, n_runs: int | None, shared: tuple[bool, ...]) -> str:
    operands = _operands(avals, steps, n_runs, shared)
    key = "rosenbrock", operands, n_runs, steps  # kept with the solver, whose factors belong to its step
    # LLVM takes a third longer with its passes, and films run as fast without; bushings and dry runs do not.
    return machine_code.called_text(
        key, steps.solve.line, lambda: _text(steps, operands, n_runs), is_wide=n_runs is not None, is_optimised=False
    )


def _lowered(context: Any, *arguments: Any, **how: Any) -> Sequence:
    return jax.ffi.ffi_lowering(_target(context.avals_in, **how))(context, *arguments)


machine_code.TARGETS["rosenbrock_stages"] = _target
mlir.register_lowering(_rosenbrock_stages, _lowered, platform="cpu")


def _operands(
    avals: Sequence, steps: RosenbrockSteps, n_runs: int | None, shared: tuple[bool, ...]
) -> tuple[Operand, ...]:
    """The arguments of the call."""
    rows, (size,) = steps.rows, steps.rate.line.outputs[0].shape
    below: Any = () if rows is None else (size, rows.n)
    of_rows = {} if rows is None else dict(rows.operands)
    operands = [Operand(1), Operand(1), Operand(size, *below), Operand(size, *below)]
    for i, aval in enumerate(avals[_N_OF_STEP:], _N_OF_STEP):
        kind = "i8" if aval.dtype == BOOL else "double"
        if i in of_rows:
            assert rows is not None
            operands.append(Operand(0, of_rows[i], rows.n, kind, shared[i]))
        else:
            n = aval.size // (1 if n_runs is None or shared[i] else n_runs)
            operands.append(Operand(n, kind=kind, is_shared=shared[i]))
    return tuple(operands)


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


def _part(part: LinePart, name: str, results: list[str], groups: RunGroups) -> _Written:
    line = part.line
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


def _groups(steps: RosenbrockSteps, n_runs: int | None) -> RunGroups:
    """As wide as the values of the parts, and what is made in a step, allow."""
    (size,), parts, method = steps.rate.line.outputs[0].shape, steps.parts, steps.method
    n_rows = 0 if steps.rows is None else steps.rows.n
    if n_runs is None or size * (1 + n_rows) > LARGEST_STATE:
        return RunGroups(n_runs)
    # Rows are counted for every output: which of them are over lanes is not looked at for an upper bound.
    made = sum(output.size for part in parts for output in part.line.outputs) * max(1, n_rows)
    # Increments of all stages, and five more arrays of the size of a state (`%moved` to `%nothing`, and y).
    made += size * (1 + n_rows) * ((len(method.c) if method else 0) + 5)
    room = max(1, LARGEST_ROOM // (8 * made))
    return RunGroups.of(n_runs, min(room, widest_for(*(part.line for part in parts))))


def _text(steps: RosenbrockSteps, operands: Sequence[Operand], n_runs: int | None) -> str:
    """The function that XLA calls."""
    groups, (size,) = _groups(steps, n_runs), steps.rate.line.outputs[0].shape
    assert steps.method is not None
    below: Any = () if steps.rows is None else (size, steps.rows.n)
    result = Operand(size, *below, n=len(steps.method.c))
    declared, inner = _step(steps, len(operands), groups)
    # Sorted: the name of the function is a digest of its text, which has to be the same in every process.
    return "\n".join([*sorted(declared), inner, function_of(operands, [result], groups, "step")])


def _step(steps: RosenbrockSteps, n_arguments: int, groups: RunGroups) -> tuple[set[str], str]:
    """What is to be declared, and functions: `step` has pointers to all arguments, and to k, of a group of runs."""
    method, rows, one = steps.method, steps.rows, groups.one
    assert method is not None
    n, width = len(method.c), groups.width
    n_values = int(steps.rate.line.outputs[0].size)
    size, total = n_values * width, _size_of(steps, n_values, groups) * width
    ahead = [
        _part(part, f"part{at}", [made(at, i) for i in range(len(part.line.outputs))], groups)
        for at, part in enumerate(steps.ahead)
    ]
    others = [made_by_rate(i) for i in range(1, len(steps.rate.line.outputs))]
    rate = _part(steps.rate, "rate", ["change", *others], groups)
    solve = _part(steps.solve, "solve", [FOUND], groups)
    every, behind = [*ahead, rate, solve], []
    if rows is not None:
        along = _part(rows.along, "along", ["change.rows"], groups)
        again = _part(rows.solve, "solve.rows", ["found.rows"], groups)
        behind = [
            _part(part, f"bend{at}", [f"bend{at}.{i}" for i in range(len(part.line.outputs))], groups)
            for at, part in enumerate(rows.bends)
        ]
        every += [along, again, *behind]
    # Without the first results of f and S: `%change` stands in the text, and S writes into k, where increments belong.
    room = [line for part in [*ahead, *behind] for line in part.room] + rate.room[1:]
    arguments = ", ".join(f"ptr noalias %a{i}" for i in range(n_arguments))
    of_rows = "" if rows is None else _solved_rows(rows, behind, again, total - size, groups)
    new_line = "\n"
    text = f"""\
@rows.A = private constant [{n * n} x double] [{vectors.listed(x for row in method.A for x in row)}]
@rows.C = private constant [{n * n} x double] [{vectors.listed(x for row in method.C for x in row)}]
@rows.c = private constant [{n} x double] [{vectors.listed(method.c)}]
@rows.d = private constant [{n} x double] [{vectors.listed(method.d)}]
@rows.gamma = private constant [1 x double] [{vectors.listed([method.gamma])}]
{new_line.join(part.function for part in every)}
{vectors.summing(total)}
define internal void @step({arguments}, ptr noalias %k) nounwind {{
work:
{vectors.room_for("%time", width)}
{vectors.room_for("%moved", total)}
{vectors.room_for("%change", total)}
{vectors.room_for("%right", total)}
{vectors.room_for("%nothing", total)}
  call void @llvm.memset.p0.i64(ptr align 8 %nothing, i8 0, i64 {8 * total}, i1 false)
{new_line.join(room)}
{new_line.join(vectors.entry_at(f"%{rows_of(i)}", f"%a{i}", 0) for i, _ in (rows.operands if rows else ()))}
{vectors.entry_at("%begin.rows", "%a2", size)}
{vectors.entry_at("%moved.rows", "%moved", size)}
{vectors.entry_at("%change.rows", "%change", size)}
{vectors.entry_at("%right.rows", "%right", size)}
  %t = load {one}, ptr %a0, align 8
  %h = load {one}, ptr %a1, align 8
  %gamma = load double, ptr @rows.gamma
{"".join(part.call for part in ahead)}  br label %stage
stage:
  %i = phi i64 [0, %work], [%next, %stage]
  %row = mul nuw nsw i64 %i, {n}
  %p.a = getelementptr inbounds double, ptr @rows.A, i64 %row
  call void @sum(ptr %a2, ptr %k, ptr %p.a, i64 %i, ptr %moved)
  %p.c = getelementptr inbounds double, ptr @rows.C, i64 %row
  call void @sum(ptr %nothing, ptr %k, ptr %p.c, i64 %i, ptr %right)
  %p.instant = getelementptr inbounds double, ptr @rows.c, i64 %i
  %instant.of.all = load double, ptr %p.instant
{groups.for_all_runs("%instant", "%instant.of.all")}
  %after = fmul {one} %instant, %h
  %t.i = fadd {one} %t, %after
  store {one} %t.i, ptr %time, align 8
{rate.call}{"" if rows is None else along.call}  %p.d = getelementptr inbounds double, ptr @rows.d, i64 %i
  %d = load double, ptr %p.d
  %to = mul nuw nsw i64 %i, {total}
  %found = getelementptr inbounds double, ptr %k, i64 %to
  %found.rows = getelementptr inbounds double, ptr %found, i64 {size}
{groups.in_vectors(total, partial(_right_side, by_run=width > 1))}
{solve.call}{of_rows}{groups.in_vectors(total, _times_gamma)}
  %next = add nuw nsw i64 %i, 1
  %is.done = icmp sge i64 %next, {n}
  br i1 %is.done, label %end, label %stage
end:
  ret void
}}
"""
    return set().union(*(part.declared for part in every)), text


def _solved_rows(rows: Rows, behind: list[_Written], again: _Written, size: int, groups: RunGroups) -> str:
    """The tangents of what S has found; `size` numbers of them."""
    lines = [part.call.rstrip("\n") for part in behind]
    if behind:
        lines.append(f"  %gamma.h = load {groups.one}, ptr %a{rows.gamma_h}, align 8")
        for i, at, kind in groups.vectors(size):
            lines += [
                vectors.loaded(f"%rr{i}", "%right.rows", at, kind),
                vectors.loaded(f"%rb{i}", f"%bend{len(behind) - 1}.0", at, kind),
                vectors.add_scaled(f"%rw{i}", f"%rr{i}", "%gamma.h", f"%rb{i}", kind, groups.width > 1),
                vectors.stored(f"%rw{i}", "%right.rows", at, kind),
            ]
    return "\n".join([*lines, again.call])


def _right_side(i: int, at: int, kind: str, by_run: bool) -> str:
    lines = [
        vectors.loaded(f"%s{i}", "%right", at, kind),
        vectors.loaded(f"%f{i}", "%change", at, kind),
        vectors.loaded(f"%u{i}", "%a3", at, kind),
        vectors.add_scaled(f"%b{i}", f"%s{i}", "%h", f"%f{i}", kind, by_run),
        vectors.add_scaled(f"%w{i}", f"%b{i}", "%d", f"%u{i}", kind),
        vectors.stored(f"%w{i}", "%right", at, kind),
    ]
    return "\n".join(lines)


def _times_gamma(i: int, at: int, kind: str) -> str:
    lines = [
        vectors.loaded(f"%x{i}", "%found", at, kind),
        vectors.spread_out(f"%gamma{i}", "%gamma", kind),
        f"  %g{i} = fmul {kind} %gamma{i}, %x{i}",
        vectors.stored(f"%g{i}", "%found", at, kind),
    ]
    return "\n".join(lines)

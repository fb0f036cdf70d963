"""All stages of a Rosenbrock step in one call of machine code.

    k_i = gamma S(h f(t + c_i h, y + sum_j A_ij k_j) + sum_j C_ij k_j + d_i h^2 df/dt)

f and S are straight lines: the right-hand side, and the solver of (I - gamma h J) x = b. One by one, eight stages of a
step would cost XLA two calls and several kernels each, as much as the two functions themselves take. What S needs is
evaluated ahead in the same call. Tangents of the state go along, if there are some, over as many lanes:

    k_i' = gamma S(h f_i' + sum_j C_ij k_j' + d_i h^2 (df/dt)' + gamma h J' k_i / gamma)

f_i' is what makes the tangents of f, and J' k is given by parts of its own.
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

from spherejax.foundations import machine_code
from spherejax.foundations.machine_lines import (
    TURN,
    add_scaled,
    call_of,
    lanes_for,
    listed,
    loaded,
    room_for,
    spread_out,
    stored,
    turned,
    zeroed,
)
from spherejax.foundations.machine_text import LANES_AT_A_TIME, Text, head
from spherejax.foundations.scalar_graph import BOOL, FLOAT
from spherejax.foundations.straight_line import StraightLine

LARGEST_STATE = 1024
"""Entries of a state up to which a sum over stages is kept in registers and on the stack."""


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


class Part(NamedTuple):
    """A straight line that is evaluated in the call.

    Attributes:
        line: the line.
        sources: of each of its arguments: a number for one that the call is given, else a name: of what a stage makes
            (`TIME`, `MOVED`, `RIGHT`), or of what another part has made (`made`).
        lanes, axes: as of the operation `straight_line`.
    """

    line: StraightLine
    sources: tuple[int | str, ...]
    lanes: tuple[int, ...] = ()
    axes: tuple[int, ...] = ()


TIME, MOVED, RIGHT, FOUND = "time", "moved", "right", "found"
"""Of a stage: the arguments of f, the right side, and what S gives."""

BEGIN_ROWS, MOVED_ROWS = "begin.rows", "moved.rows"
"""Tangents of the state at the start of a step, and of what f is given; over lanes."""


def made(part: int, output: int) -> str:
    """The name of an output of one of the parts that are evaluated ahead of the stages."""
    return f"made{part}.{output}"


def made_by_rate(output: int) -> str:
    """The name of an output of f: the first one is its value."""
    return f"rate{output}"


def rows_of(argument: int) -> str:
    """The name of an argument that has a leading axis of rows, over lanes."""
    return f"rows{argument}"


def over_lanes(line: StraightLine, sources: Sequence[int | str], wide: Sequence[bool], n_rows: int) -> "Part":
    """A part some of whose arguments are over lanes, one for each row."""
    width = lanes_for(n_rows)
    if width == 1:
        return Part(line, tuple(sources))
    return Part(line, tuple(sources), (width,), tuple(map(int, wide)))


class Rows(NamedTuple):
    """Tangents that go along with the state.

    Attributes:
        n: how many.
        given: arguments of the call that have an axis of rows, and the sizes of a row.
        along: what makes the tangents of f.
        bends: what is evaluated behind S, and what makes dJ/dy Y k of it, the last; empty where J is constant.
        solve: S for the tangents.
        gamma_h: place of gamma h among the arguments of the call.
    """

    n: int
    given: tuple[tuple[int, int], ...]
    along: Part
    bends: tuple[Part, ...]
    solve: Part
    gamma_h: int


class Steps(NamedTuple):
    """What is done in a step.

    Attributes:
        ahead: evaluated once, in order.
        rate: f, with what its tangents are made of.
        solve: S.
        method: the method; None while it is not known yet.
        rows: tangents; None without.
    """

    ahead: tuple[Part, ...]
    rate: Part
    solve: Part
    method: RosenbrockMethod | None = None
    rows: Rows | None = None

    @property
    def parts(self) -> tuple[Part, ...]:
        """All of them."""
        of_rows = () if self.rows is None else (self.rows.along, *self.rows.bends, self.rows.solve)
        return *self.ahead, self.rate, self.solve, *of_rows


def can_be_called(steps: Steps, size: int) -> bool:
    """Whether the stages of a step of a state of so many entries can be one call."""
    n = size * (1 + (0 if steps.rows is None else lanes_for(steps.rows.n)))
    if not machine_code.is_on() or not 0 < n <= LARGEST_STATE:
        return False
    if not all(part.line.in_machine_code and part.line.can_be_called for part in steps.parts):
        return False
    return all(
        part.line.outputs[0].shape == (size,) and part.line.dtype(part.line.outputs[0]) == FLOAT
        for part in (steps.rate, steps.solve)
    )


def rosenbrock_stages(steps: Steps, t: Array, h: Array, y: Array, slope: Array, *others: Array) -> Array:
    """The increments k, shape (s, size), or (s, 1 + rows, size).

    Args:
        steps: what is done.
        t, h, y: where the step starts [s], how long it is [s], the state there, with rows of tangents below it.
        slope: h^2 df/dt there, in the same shape.
        others: what else the parts are given; `sources` count from t.
    """
    (k,) = _rosenbrock_stages.bind(t, h, y, slope, *others, steps=steps)
    return k


_rosenbrock_stages = Primitive("rosenbrock_stages")
_rosenbrock_stages.multiple_results = True


@_rosenbrock_stages.def_abstract_eval
def _shapes(t: Any, h: Any, y: Any, slope: Any, *others: Any, steps: Steps) -> list:
    del t, h, slope, others
    assert steps.method is not None
    return [ShapedArray((len(steps.method.c), *y.shape), y.dtype)]


def _batched(arguments: Sequence, dims: Sequence, *, steps: Steps) -> tuple[Sequence, Sequence]:
    """One run after the other; a run alone needs no axis."""
    n = next(x.shape[dim] for x, dim in zip(arguments, dims, strict=True) if dim is not None)
    if n == 1:
        alone = [x if dim is None else jnp.squeeze(x, dim) for x, dim in zip(arguments, dims, strict=True)]
        return [x[None] for x in _rosenbrock_stages.bind(*alone, steps=steps)], [0]
    moved = [None if dim is None else jnp.moveaxis(x, dim, 0) for x, dim in zip(arguments, dims, strict=True)]

    def one(parts: Sequence) -> list[Array]:
        found = (x if part is None else part for x, part in zip(arguments, parts, strict=True))
        return _rosenbrock_stages.bind(*found, steps=steps)

    return jax.lax.map(one, moved), [0]


batching.primitive_batchers[_rosenbrock_stages] = _batched


def _lowered(context: Any, *arguments: Any, steps: Steps) -> Sequence:
    key = "rosenbrock", len(arguments), steps  # kept with the solver, whose factors belong to its step
    name = machine_code.called_text(key, steps.solve.line, lambda: _text(steps, len(arguments)))
    return jax.ffi.ffi_lowering(name)(context, *arguments)


mlir.register_lowering(_rosenbrock_stages, _lowered, platform="cpu")


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


def _part(part: Part, name: str, results: list[str]) -> _Written:
    line = part.line
    text = Text(line, part.lanes, part.axes or (0,) * len(part.sources))
    declared, function = text.written_inside(name)
    room = [
        room_for(
            f"%{result}", output.size * (text.n_lanes if over else 1), "i8" if line.dtype(output) == BOOL else "double"
        )
        for result, output, over in zip(results, line.outputs, text.outputs_spread, strict=True)
    ]
    pointers = [f"%a{source}" if isinstance(source, int) else f"%{source}" for source in part.sources]
    return _Written(declared, function, room, call_of(name, [*pointers, *(f"%{result}" for result in results)]))


def _text(steps: Steps, n_arguments: int) -> str:
    """The function that XLA calls: what it is given and gives has rows first, where the stages have lanes last."""
    method, rows = steps.method, steps.rows
    assert method is not None
    n, (size,) = len(method.c), steps.rate.line.outputs[0].shape
    width = 0 if rows is None else lanes_for(rows.n)
    total = size * (1 + width)
    ahead = [
        _part(part, f"part{at}", [made(at, i) for i in range(len(part.line.outputs))])
        for at, part in enumerate(steps.ahead)
    ]
    others = [made_by_rate(i) for i in range(1, len(steps.rate.line.outputs))]
    rate, solve = _part(steps.rate, "rate", ["change", *others]), _part(steps.solve, "solve", [FOUND])
    every, behind = [*ahead, rate, solve], []
    if rows is not None:
        along, again = _part(rows.along, "along", ["change.rows"]), _part(rows.solve, "solve.rows", ["found.rows"])
        behind = [
            _part(part, f"bend{at}", [f"bend{at}.{i}" for i in range(len(part.line.outputs))])
            for at, part in enumerate(rows.bends)
        ]
        every += [along, again, *behind]
    room = [line for each in [*ahead, *behind] for line in each.room] + rate.room[1:]
    chunks = [(begin, min(LANES_AT_A_TIME, total - begin)) for begin in range(0, total, LANES_AT_A_TIME)]

    def each(write: Any) -> str:
        return "\n".join(write(i, begin, f"<{wide} x double>") for i, (begin, wide) in enumerate(chunks))

    new_line = "\n"
    return f"""\
{new_line.join(sorted(set().union(*(each.declared for each in every), _DECLARED)))}
@rows.A = private constant [{n * n} x double] [{listed(x for row in method.A for x in row)}]
@rows.C = private constant [{n * n} x double] [{listed(x for row in method.C for x in row)}]
@rows.c = private constant [{n} x double] [{listed(method.c)}]
@rows.d = private constant [{n} x double] [{listed(method.d)}]
@rows.gamma = private constant [1 x double] [{listed([method.gamma])}]
{new_line.join(each.function for each in every)}
{"" if rows is None else TURN}
{head(n_arguments, 1)}
{room_for("%time", 1)}
{room_for("%moved", total)}
{room_for("%change", total)}
{room_for("%right", total)}
{new_line.join(room)}
{_taken_in(rows, size, width, n)}
  %moved.rows = getelementptr inbounds double, ptr %moved, i64 {size}
  %change.rows = getelementptr inbounds double, ptr %change, i64 {size}
  %right.rows = getelementptr inbounds double, ptr %right, i64 {size}
  %t = load double, ptr %a0
  %h = load double, ptr %a1
  %gamma = load double, ptr @rows.gamma
{each(lambda i, at, kind: loaded(f"%begin{i}", "%begin", at, kind))}
{"".join(each.call for each in ahead)}  br label %stage
stage:
  %i = phi i64 [0, %work], [%next, %solved]
  %row = mul nuw nsw i64 %i, {n}
  %has.sum = icmp sgt i64 %i, 0
  br i1 %has.sum, label %sum, label %summed
sum:
  %j = phi i64 [0, %stage], [%j.next, %sum]
{each(partial(_sums, name="%{}{}"))}
  %place = add nuw nsw i64 %row, %j
  %p.a = getelementptr inbounds double, ptr @rows.A, i64 %place
  %a = load double, ptr %p.a
  %p.c = getelementptr inbounds double, ptr @rows.C, i64 %place
  %c = load double, ptr %p.c
  %from = mul nuw nsw i64 %j, {total}
  %p.k = getelementptr inbounds double, ptr %k, i64 %from
{each(_summed)}
  %j.next = add nuw nsw i64 %j, 1
  %is.last = icmp sge i64 %j.next, %i
  br i1 %is.last, label %summed, label %sum
summed:
{each(partial(_sums, name="%{}{}.all"))}
{each(lambda i, at, kind: stored(f"%m{i}.all", "%moved", at, kind))}
  %p.instant = getelementptr inbounds double, ptr @rows.c, i64 %i
  %instant = load double, ptr %p.instant
  %after = fmul double %instant, %h
  %t.i = fadd double %t, %after
  store double %t.i, ptr %time
{rate.call}{"" if rows is None else along.call}  %p.d = getelementptr inbounds double, ptr @rows.d, i64 %i
  %d = load double, ptr %p.d
  %to = mul nuw nsw i64 %i, {total}
  %found = getelementptr inbounds double, ptr %k, i64 %to
  %found.rows = getelementptr inbounds double, ptr %found, i64 {size}
{each(_right_side)}
{solve.call}{"" if rows is None else _solved_rows(rows, behind, again, size, total)}{each(_times_gamma)}
  br label %solved
solved:
  %next = add nuw nsw i64 %i, 1
  %is.done = icmp sge i64 %next, {n}
  br i1 %is.done, label %end, label %stage
end:
{_given_back(rows, size, width, n)}
  ret ptr null
}}
"""


_DECLARED = frozenset(
    ["declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)", "declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)"]
)


def _taken_in(rows: Rows | None, size: int, width: int, n: int) -> str:
    """Where the stages find the state and its slope, and where they leave the increments."""
    if rows is None:
        return "\n".join(_same(f"%{name}", given) for name, given in (("begin", "%a2"), ("slope", "%a3"), ("k", "%r0")))
    total = size * (1 + width)
    lines = [room_for("%k", n * total)]
    for name, given in (("begin", "%a2"), ("slope", "%a3")):
        lines += [room_for(f"%{name}", total), zeroed(f"%{name}", total)]
        lines.append(turned("in", given, f"%{name}", size, size, rows.n, width))
    for argument, own in rows.given:
        name = f"%{rows_of(argument)}"
        lines += [room_for(name, own * width), zeroed(name, own * width)]
        lines.append(turned("in", f"%a{argument}", name, 0, own, rows.n, width))
    return "\n".join([*lines, f"  %begin.rows = getelementptr inbounds double, ptr %begin, i64 {size}"])


def _same(name: str, other: str) -> str:
    return f"  {name} = getelementptr inbounds double, ptr {other}, i64 0"


def _given_back(rows: Rows | None, size: int, width: int, n: int) -> str:
    """The increments in rows."""
    if rows is None:
        return ""
    lines = []
    for i in range(n):
        lines += [
            f"  %k.{i} = getelementptr inbounds double, ptr %k, i64 {i * size * (1 + width)}",
            f"  %r.{i} = getelementptr inbounds double, ptr %r0, i64 {i * size * (1 + rows.n)}",
            turned("out", f"%k.{i}", f"%r.{i}", size, size, rows.n, width),
        ]
    return "\n".join(lines)


def _solved_rows(rows: Rows, behind: list[_Written], again: _Written, size: int, total: int) -> str:
    """The tangents of what S has found."""
    lines = [each.call.rstrip("\n") for each in behind]
    if behind:
        lines.append(f"  %gamma.h = load double, ptr %a{rows.gamma_h}")
        for i, at in enumerate(range(0, total - size, LANES_AT_A_TIME)):
            kind = f"<{min(LANES_AT_A_TIME, total - size - at)} x double>"
            lines += [
                loaded(f"%rr{i}", "%right.rows", at, kind),
                loaded(f"%rb{i}", f"%bend{len(behind) - 1}.0", at, kind),
                add_scaled(f"%rw{i}", f"%rr{i}", "%gamma.h", f"%rb{i}", kind),
                stored(f"%rw{i}", "%right.rows", at, kind),
            ]
    return "\n".join([*lines, again.call])


def _sums(i: int, at: int, kind: str, name: str) -> str:
    """What is summed so far: with A from the state, with C from zero."""
    del at
    return "\n".join(
        f"  {name.format(letter, i)} = phi {kind} [{begin}, %stage], [%{letter}{i}.next, %sum]"
        for letter, begin in (("m", f"%begin{i}"), ("s", "zeroinitializer"))
    )


def _summed(i: int, at: int, kind: str) -> str:
    lines = [
        loaded(f"%k{i}", "%p.k", at, kind),
        add_scaled(f"%m{i}.next", f"%m{i}", "%a", f"%k{i}", kind),
        add_scaled(f"%s{i}.next", f"%s{i}", "%c", f"%k{i}", kind),
    ]
    return "\n".join(lines)


def _right_side(i: int, at: int, kind: str) -> str:
    lines = [
        loaded(f"%f{i}", "%change", at, kind),
        loaded(f"%u{i}", "%slope", at, kind),
        add_scaled(f"%b{i}", f"%s{i}.all", "%h", f"%f{i}", kind),
        add_scaled(f"%w{i}", f"%b{i}", "%d", f"%u{i}", kind),
        stored(f"%w{i}", "%right", at, kind),
    ]
    return "\n".join(lines)


def _times_gamma(i: int, at: int, kind: str) -> str:
    lines = [
        loaded(f"%x{i}", "%found", at, kind),
        spread_out(f"%gamma{i}", "%gamma", kind),
        f"  %g{i} = fmul {kind} %gamma{i}, %x{i}",
        stored(f"%g{i}", "%found", at, kind),
    ]
    return "\n".join(lines)

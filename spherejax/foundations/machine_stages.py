"""All stages of an explicit Runge-Kutta step in one call of machine code.

    k_i = h (1 - bend (1 - 2 c_i)) f(t + c_i (1 - bend (1 - c_i)) h, y + sum_j a_ij k_j)

One by one, twelve stages of a step would cost XLA a call and several kernels each, more than a small right-hand side
takes. Here the stages are a loop around the line's own function. Tangents of the state go along, if there are some: its
derivative's function is in the same loop, over as many lanes.
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

LARGEST_STATE = 4096
"""Entries of a state, with its rows, up to which a sum over stages is kept in registers and on the stack."""


def can_be_called(line: StraightLine, shape: tuple[int, ...]) -> bool:
    """Whether the stages of a line that returns a state can be one call.

    Args:
        line: f.
        shape: of the state, or of the state and rows of tangents below it.
    """
    (output, *others) = line.outputs
    is_state = not others and output.shape == shape[-1:] and line.dtype(output) == FLOAT
    fits = output.size > 0 and _size(output.size, shape) <= LARGEST_STATE
    return is_state and fits and line.in_machine_code and machine_code.is_available() and line.can_be_called


def _size(size: int, shape: tuple[int, ...]) -> int:
    return size if len(shape) == 1 else size * (1 + lanes_for(shape[0] - 1))


def stages(
    line: StraightLine,
    at: int,
    coefficients: np.ndarray,
    instants: np.ndarray,
    t: Array,
    h: Array,
    bend: Array,
    y: Array,
    n_made: Any,
    others: Sequence[Array],
) -> Array:
    """The increments k, shape (s, size, 1).

    Args:
        line: f.
        at: place of t among its arguments; y is behind it.
        coefficients: a, shape (s, s), strictly lower.
        instants: c.
        t, h, bend, y: as above; y of one lane, shape (size, 1).
        n_made: so many stages are evaluated, the first ones; increments of the others are zero.
        others: the other arguments of the line, in order.
    """
    arguments = t, h, bend, jnp.asarray(n_made, jnp.int64), y, *others
    (k,) = _stages.bind(*arguments, line=line, rows=None, method=_Method.of(at, coefficients, instants))
    return k


def stages_with_rows(
    line: StraightLine,
    at: int,
    coefficients: np.ndarray,
    instants: np.ndarray,
    t: Array,
    h: Array,
    bend: Array,
    rows: Array,
    n_made: Any,
    others: Sequence[Array],
    along: Sequence[Array | None],
) -> Array:
    """The increments of a state and of tangents of it, shape (s, 1 + rows, size, 1).

    Args:
        line, at, coefficients, instants, t, h, bend, n_made, others: as for `stages`.
        rows: y, then tangents of it, of one lane, shape (1 + rows, size, 1); at least one.
        along: tangents of `others`, with a leading axis of rows; None for what has none.
    """
    moves = tuple(each is not None for each in along)
    derivative = line.derivative((*moves[:at], False, True, *moves[at:]))
    assert derivative.follows == (True,), "a rate that does not depend on the state"
    tangents = [x for x in along if x is not None]
    arguments = t, h, bend, jnp.asarray(n_made, jnp.int64), rows, *others, *tangents
    below = _Rows(derivative.slopes, moves, rows.shape[0] - 1)
    (k,) = _stages.bind(*arguments, line=derivative.values, rows=below, method=_Method.of(at, coefficients, instants))
    return k


class _Method(NamedTuple):
    """Place of t among the arguments of f, and the tableau."""

    at: int
    coefficients: tuple[tuple[float, ...], ...]
    instants: tuple[float, ...]

    @classmethod
    def of(cls, at: int, coefficients: np.ndarray, instants: np.ndarray) -> "_Method":
        return cls(at, tuple(map(tuple, coefficients.tolist())), tuple(instants.tolist()))


class _Rows(NamedTuple):
    """What makes the rows below a state: the line of their rates, which of the other arguments move, how many rows."""

    line: StraightLine
    moves: tuple[bool, ...]
    n: int


_stages = Primitive("stages")
_stages.multiple_results = True


@_stages.def_abstract_eval
def _shapes(t: Any, h: Any, bend: Any, n: Any, y: Any, *others: Any, method: _Method, **what: Any) -> list:
    del t, h, bend, n, others, what
    return [ShapedArray((len(method.instants), *y.shape), y.dtype)]


def _lowered(context: Any, *arguments: Any, line: StraightLine, rows: _Rows | None, method: _Method) -> Sequence:
    # A line with coefficients belongs to one line of slopes.
    key = "stages", rows and rows.n, method
    name = machine_code.called_text(key, line, lambda: _text(line, rows, method))
    return jax.ffi.ffi_lowering(name)(context, *arguments)


mlir.register_lowering(_stages, _lowered, platform="cpu")


def _text(line: StraightLine, rows: _Rows | None, method: _Method) -> str:
    """The function that XLA calls: what it is given and gives has rows first, where the stages have lanes last."""
    declared, inner, n_arguments = _stages_text(line, rows, method)
    before, after, pointers = [], [], [*(f"%a{i}" for i in range(n_arguments)), "%r0"]
    width = lanes_for(rows.n) if rows else 0
    if rows is not None and width > 1:
        n, n_values = len(method.instants), int(line.outputs[0].size)
        inner += TURN
        declared |= {"declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)"}
        tangents = [
            int(np.prod(shape)) for i, shape in enumerate(rows.line.shapes) if i != _place_of_state(rows, method)
        ]
        first = n_arguments - len(tangents)
        for i, size in enumerate(tangents, first):
            pointers[i] = f"%lanes{i}"
            before += [
                room_for(f"%lanes{i}", size * width),
                zeroed(f"%lanes{i}", size * width),
                turned("in", f"%a{i}", f"%lanes{i}", 0, size, rows.n, width),
            ]
        pointers[_STATE], pointers[-1] = "%state", "%k"
        before += [room_for("%state", n_values * (1 + width)), zeroed("%state", n_values * (1 + width))]
        before.append(turned("in", "%a4", "%state", n_values, n_values, rows.n, width))
        before.append(room_for("%k", n * n_values * (1 + width)))
        for i in range(n):
            before += [
                f"  %k{i} = getelementptr inbounds double, ptr %k, i64 {i * n_values * (1 + width)}",
                f"  %r{i}.row = getelementptr inbounds double, ptr %r0, i64 {i * n_values * (1 + rows.n)}",
            ]
            after.append(turned("out", f"%k{i}", f"%r{i}.row", n_values, n_values, rows.n, width))
    new_line = "\n"
    return f"""\
{new_line.join(sorted(declared))}
{inner}
{head(n_arguments, 1)}
{new_line.join(before)}
{call_of("stages", pointers)}{new_line.join(after)}
  ret ptr null
}}
"""


_STATE = 4
"""Place of y among the arguments of the stages; before it are t, h, bend and the number of stages."""


def _stages_text(line: StraightLine, rows: _Rows | None, method: _Method) -> tuple[set[str], str, int]:
    """What is to be declared, functions (`stages` has pointers to all arguments, and to k), the number of arguments."""
    at, coefficients, instants = method
    n, n_values, width = len(instants), int(line.outputs[0].size), lanes_for(rows.n) if rows else 0
    size = n_values * (1 + width)
    rate = Text(line, (), (0,) * (len(line.shapes) + len(line.given)))
    declared, inner = rate.written_inside("rate")
    numbers = (f"%a{i}" for i in itertools.count(_STATE + 1))
    pointers = ["%time" if i == at else "%moved" if i == at + 1 else next(numbers) for i in range(rate.n_arguments)]
    made = [f"%made{i}" for i in range(1, len(line.outputs))]
    calls = call_of("rate", [*pointers, "%change", *made])
    memory = [
        room_for(name, output.size, "i8" if line.dtype(output) == BOOL else "double")
        for name, output in zip(made, line.outputs[1:], strict=True)
    ]
    if rows is not None:
        over = (int(width > 1),) * len(rows.line.shapes) + (0,) * len(made)
        more, along = Text(rows.line, (width,) * (width > 1), over).written_inside("along")
        declared, inner = declared | more, inner + along
        state = _place_of_state(rows, method)
        moving = ["%moved.rows" if i == state else next(numbers) for i in range(len(rows.line.shapes))]
        calls += call_of("along", [*moving, *made, "%change.rows"])
    n_arguments = rate.n_arguments + 3 + (sum(rows.moves) if rows else 0)
    chunks = [(begin, min(LANES_AT_A_TIME, size - begin)) for begin in range(0, size, LANES_AT_A_TIME)]

    def each(write: Callable[[int, int, str], str]) -> str:
        return "\n".join(write(at, begin, f"<{width} x double>") for at, (begin, width) in enumerate(chunks))

    new_line = "\n"
    arguments = ", ".join(f"ptr noalias %a{i}" for i in range(n_arguments))
    text = f"""\
@coefficients = private constant [{n * n} x double] [{listed(x for row in coefficients for x in row)}]
@instants = private constant [{n} x double] [{listed(instants)}]
{inner}
define internal void @stages({arguments}, ptr noalias %r0) nounwind {{
work:
{room_for("%time", 1)}
{room_for("%moved", size)}
{room_for("%change", size)}
  %moved.rows = getelementptr inbounds double, ptr %moved, i64 {n_values}
  %change.rows = getelementptr inbounds double, ptr %change, i64 {n_values}
{new_line.join(memory)}
  %t = load double, ptr %a0
  %h = load double, ptr %a1
  %bend = load double, ptr %a2
  %n = load i64, ptr %a3
  call void @llvm.memset.p0.i64(ptr align 8 %r0, i8 0, i64 {8 * n * size}, i1 false)
{each(lambda i, at, kind: loaded(f"%begin{i}", "%a4", at, kind))}
  %some = icmp sgt i64 %n, 0
  br i1 %some, label %stage, label %end
stage:
  %i = phi i64 [0, %work], [%next, %moving]
  %row = mul nuw nsw i64 %i, {n}
  %has.sum = icmp sgt i64 %i, 0
  br i1 %has.sum, label %sum, label %summed
sum:
  %j = phi i64 [0, %stage], [%j.next, %sum]
{each(lambda i, at, kind: f"  %s{i} = phi {kind} [%begin{i}, %stage], [%s{i}.next, %sum]")}
  %place = add nuw nsw i64 %row, %j
  %p.a = getelementptr inbounds double, ptr @coefficients, i64 %place
  %a = load double, ptr %p.a
  %from = mul nuw nsw i64 %j, {size}
  %p.k = getelementptr inbounds double, ptr %r0, i64 %from
{each(_add)}
  %j.next = add nuw nsw i64 %j, 1
  %is.last = icmp sge i64 %j.next, %i
  br i1 %is.last, label %summed, label %sum
summed:
{each(lambda i, at, kind: f"  %m{i} = phi {kind} [%begin{i}, %stage], [%s{i}.next, %sum]")}
{each(lambda i, at, kind: stored(f"%m{i}", "%moved", at, kind))}
  %p.c = getelementptr inbounds double, ptr @instants, i64 %i
  %c = load double, ptr %p.c
  %rest = fsub double 0x3FF0000000000000, %c
  %bent = fmul double %bend, %rest
  %straight = fsub double 0x3FF0000000000000, %bent
  %instant = fmul double %c, %straight
  %after = fmul double %instant, %h
  %t.i = fadd double %t, %after
  store double %t.i, ptr %time
  %turn = fsub double %rest, %c
  %slow = fmul double %bend, %turn
  %speed = fsub double 0x3FF0000000000000, %slow
  %length = fmul double %h, %speed
{calls}  br label %moving
moving:
  %to = mul nuw nsw i64 %i, {size}
  %p.to = getelementptr inbounds double, ptr %r0, i64 %to
{each(_keep)}
  %next = add nuw nsw i64 %i, 1
  %is.done = icmp sge i64 %next, %n
  br i1 %is.done, label %end, label %stage
end:
  ret void
}}
"""
    return declared | {"declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)"}, text, n_arguments


def _place_of_state(rows: _Rows, method: _Method) -> int:
    """Among the arguments of the rates of rows, which are those of f that move."""
    return sum(rows.moves[: method.at])


def _add(i: int, begin: int, kind: str) -> str:
    return f"{loaded(f'%k{i}', '%p.k', begin, kind)}\n{add_scaled(f'%s{i}.next', f'%s{i}', '%a', f'%k{i}', kind)}"


def _keep(i: int, begin: int, kind: str) -> str:
    return "\n".join(
        [
            loaded(f"%f{i}", "%change", begin, kind),
            spread_out(f"%h{i}.wide", "%length", kind),
            f"  %hf{i} = fmul {kind} %h{i}.wide, %f{i}",
            stored(f"%hf{i}", "%p.to", begin, kind),
        ]
    )

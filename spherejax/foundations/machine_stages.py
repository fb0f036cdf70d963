"""All stages of an explicit Runge-Kutta step in one call of machine code.

    k_i = h (1 - bend (1 - 2 c_i)) f(t + c_i (1 - bend (1 - c_i)) h, y + sum_j a_ij k_j)

One by one, twelve stages of a step would cost XLA a call and several kernels each, more than a small right-hand side
takes. Here the stages are a loop around the line's own function.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import mlir

from spherejax.foundations import machine_code
from spherejax.foundations.machine_text import LANES_AT_A_TIME, Text, head
from spherejax.foundations.scalar_graph import FLOAT
from spherejax.foundations.straight_line import StraightLine

LARGEST_STATE = 256
"""Entries of a state up to which a sum over stages is kept in registers and on the stack."""


def can_be_called(line: StraightLine, shape: tuple[int, ...]) -> bool:
    """Whether the stages of a line that returns a state of this shape can be one call."""
    (output, *others) = line.outputs
    is_state = not others and output.shape == shape and line.dtype(output) == FLOAT and 0 < output.size <= LARGEST_STATE
    return is_state and line.in_machine_code and machine_code.is_available() and line.can_be_called


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
    """The increments k, shape (s, size).

    Args:
        line: f.
        at: place of t among its arguments; y is behind it.
        coefficients: a, shape (s, s), strictly lower.
        instants: c.
        t, h, bend, y: as above.
        n_made: so many stages are evaluated, the first ones; increments of the others are zero.
        others: the other arguments of the line, in order.
    """
    method = tuple(map(tuple, coefficients.tolist())), tuple(instants.tolist())
    n = jnp.asarray(n_made, jnp.int64)
    (k,) = _stages.bind(t, h, bend, n, y, *others, line=line, at=at, method=method)
    return k


_stages = Primitive("stages")
_stages.multiple_results = True


@_stages.def_abstract_eval
def _shapes(t: Any, h: Any, bend: Any, n: Any, y: Any, *others: Any, line: Any, at: int, method: tuple) -> list:
    del t, h, bend, n, others, line, at
    return [ShapedArray((len(method[1]), *y.shape), y.dtype)]


def _lowered(context: Any, *arguments: Any, line: StraightLine, at: int, method: tuple) -> Sequence:
    key = "stages", at, method
    name = machine_code.called_text(key, line, lambda: _text(line, at, *method))
    return jax.ffi.ffi_lowering(name)(context, *arguments)


mlir.register_lowering(_stages, _lowered, platform="cpu")


def _text(line: StraightLine, at: int, coefficients: tuple, instants: tuple) -> str:
    n, size = len(instants), int(line.outputs[0].size)
    rate = Text(line, (), (0,) * (len(line.shapes) + len(line.given)))
    inner = rate.written_inside("rate")
    others = iter(range(5, 5 + rate.n_arguments))
    pointers = [
        "%time" if i == at else "%moved" if i == at + 1 else f"%a{next(others)}" for i in range(rate.n_arguments)
    ]
    call = ", ".join(f"ptr {pointer}" for pointer in [*pointers, "%change"])
    chunks = [(begin, min(LANES_AT_A_TIME, size - begin)) for begin in range(0, size, LANES_AT_A_TIME)]

    def each(write: Callable[[int, int, str], str]) -> str:
        return "\n".join(write(at, begin, f"<{width} x double>") for at, (begin, width) in enumerate(chunks))

    return f"""\
@coefficients = private constant [{n * n} x double] [{_numbers(x for row in coefficients for x in row)}]
@instants = private constant [{n} x double] [{_numbers(instants)}]
declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)
{inner}
{head(rate.n_arguments + 3, 1)}
  %time = alloca double, align 8
  %moved = alloca [{size} x double], align 64
  %change = alloca [{size} x double], align 64
  %t = load double, ptr %a0
  %h = load double, ptr %a1
  %bend = load double, ptr %a2
  %n = load i64, ptr %a3
  call void @llvm.memset.p0.i64(ptr align 8 %r0, i8 0, i64 {8 * n * size}, i1 false)
{each(lambda i, at, kind: _at(f"%y{i}", "%a4", at) + f"{chr(10)}  %begin{i} = load {kind}, ptr %y{i}, align 8")}
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
{each(lambda i, at, kind: _at(f"%p.m{i}", "%moved", at) + f"{chr(10)}  store {kind} %m{i}, ptr %p.m{i}, align 8")}
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
  call void @rate({call})
  br label %moving
moving:
  %to = mul nuw nsw i64 %i, {size}
  %p.to = getelementptr inbounds double, ptr %r0, i64 %to
{each(_keep)}
  %next = add nuw nsw i64 %i, 1
  %is.done = icmp sge i64 %next, %n
  br i1 %is.done, label %end, label %stage
end:
  ret ptr null
}}
"""


def _numbers(values: Any) -> str:
    return ", ".join(f"double 0x{int(np.float64(x).view(np.uint64)):016X}" for x in values)


def _at(name: str, array: str, begin: int) -> str:
    return f"  {name} = getelementptr inbounds double, ptr {array}, i64 {begin}"


def _spread(name: str, value: str, kind: str) -> str:
    width = kind[1 : kind.index(" ")]
    return (
        f"  {name}.one = insertelement {kind} poison, double {value}, i64 0\n"
        f"  {name} = shufflevector {kind} {name}.one, {kind} poison, <{width} x i32> zeroinitializer"
    )


def _add(i: int, begin: int, kind: str) -> str:
    return "\n".join(
        [
            _at(f"%p.k{i}", "%p.k", begin),
            f"  %k{i} = load {kind}, ptr %p.k{i}, align 8",
            _spread(f"%a{i}.wide", "%a", kind),
            f"  %ak{i} = fmul contract {kind} %a{i}.wide, %k{i}",
            f"  %s{i}.next = fadd contract {kind} %s{i}, %ak{i}",
        ]
    )


def _keep(i: int, begin: int, kind: str) -> str:
    return "\n".join(
        [
            _at(f"%p.f{i}", "%change", begin),
            f"  %f{i} = load {kind}, ptr %p.f{i}, align 8",
            _spread(f"%h{i}.wide", "%length", kind),
            f"  %hf{i} = fmul {kind} %h{i}.wide, %f{i}",
            _at(f"%p.to{i}", "%p.to", begin),
            f"  store {kind} %hf{i}, ptr %p.to{i}, align 8",
        ]
    )

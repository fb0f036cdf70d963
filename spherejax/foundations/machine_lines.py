"""Lines of LLVM's language that functions of several parts are written of; see `machine_text` for whole programs."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from spherejax.foundations.machine_text import LANES_AT_A_TIME


def room_for(name: str, size: int, kind: str = "double") -> str:
    """Room on the stack for an array."""
    return f"  {name} = alloca [{size} x {kind}], align 64"


def call_of(name: str, pointers: Sequence[str]) -> str:
    """A call with pointers."""
    return f"  call void @{name}({', '.join(f'ptr {pointer}' for pointer in pointers)})\n"


def listed(values: Any) -> str:
    """Numbers, exactly."""
    return ", ".join(f"double 0x{int(np.float64(x).view(np.uint64)):016X}" for x in values)


def entry_at(name: str, array: str, begin: int) -> str:
    """Where an entry of an array is."""
    return f"  {name} = getelementptr inbounds double, ptr {array}, i64 {begin}"


def spread_out(name: str, value: str, kind: str) -> str:
    """A number in each lane of a vector."""
    width = kind[1 : kind.index(" ")]
    return (
        f"  {name}.one = insertelement {kind} poison, double {value}, i64 0\n"
        f"  {name} = shufflevector {kind} {name}.one, {kind} poison, <{width} x i32> zeroinitializer"
    )


def loaded(name: str, array: str, begin: int, kind: str) -> str:
    """A vector out of an array."""
    return f"{entry_at(f'{name}.from', array, begin)}\n  {name} = load {kind}, ptr {name}.from, align 8"


def stored(name: str, array: str, begin: int, kind: str) -> str:
    """A vector into an array."""
    return f"{entry_at(f'{name}.to', array, begin)}\n  store {kind} {name}, ptr {name}.to, align 8"


def add_scaled(name: str, vector: str, number: str, other: str, kind: str) -> str:
    """vector + number * other."""
    return "\n".join(
        [
            spread_out(f"{name}.wide", number, kind),
            f"  {name}.part = fmul contract {kind} {name}.wide, {other}",
            f"  {name} = fadd contract {kind} {vector}, {name}.part",
        ]
    )


def lanes_for(n_rows: int) -> int:
    """Lanes for so many rows: vectors of three or five numbers are taken to pieces."""
    return n_rows if n_rows <= 2 else 4 if n_rows <= 4 else -(-n_rows // LANES_AT_A_TIME) * LANES_AT_A_TIME


TURN = "".join(
    f"""
define internal void @turn.{way}(ptr %from, ptr noalias %to, i64 %before, i64 %size, i64 %n, i64 %width) nounwind {{
start:
  %bytes = mul i64 %before, 8
  call void @llvm.memcpy.p0.p0.i64(ptr %to, ptr %from, i64 %bytes, i1 false)
  %f = getelementptr inbounds double, ptr %from, i64 %before
  %t = getelementptr inbounds double, ptr %to, i64 %before
  br label %row
row:
  %r = phi i64 [0, %start], [%r.next, %row.end]
  %r.begin = mul i64 %r, %size
  br label %entry
entry:
  %e = phi i64 [0, %row], [%e.next, %entry]
  %at.rows = add i64 %r.begin, %e
  %e.begin = mul i64 %e, %width
  %at.lanes = add i64 %e.begin, %r
  %p = getelementptr inbounds double, ptr %f, i64 %at.{source}
  %q = getelementptr inbounds double, ptr %t, i64 %at.{target}
  %x = load double, ptr %p
  store double %x, ptr %q
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
    for way, source, target in (("in", "rows", "lanes"), ("out", "lanes", "rows"))
)
"""Functions that copy some numbers, and what follows in rows into lanes or back."""


def zeroed(name: str, size: int) -> str:
    """Zeros into an array."""
    return f"  call void @llvm.memset.p0.i64(ptr {name}, i8 0, i64 {8 * size}, i1 false)"


def turned(way: str, source: str, target: str, n_before: int, size: int, n_rows: int, width: int) -> str:
    """A call of one of `TURN`, between an array of rows and one of lanes."""
    return f"  call void @turn.{way}(ptr {source}, ptr {target}, i64 {n_before}, i64 {size}, i64 {n_rows}, i64 {width})"

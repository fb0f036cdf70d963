"""Lines of LLVM's language that functions of several parts are written of; see `text` for whole programs."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from spherejax.compiler.emit.llvm import LANES_AT_A_TIME


def room_for(name: str, size: int, kind: str = "double") -> str:
    """Room on the stack for an array."""
    return f"  {name} = alloca [{size} x {kind}], align 64"


def call_of(name: str, pointers: Sequence[str]) -> str:
    """A call with pointers."""
    return f"  call void @{name}({', '.join(f'ptr {pointer}' for pointer in pointers)})"


def listed(values: Any) -> str:
    """Numbers, exactly."""
    # By bits: decimal digits of LLVM's language must be exact, or the text is refused.
    return ", ".join(f"double 0x{int(np.float64(x).view(np.uint64)):016X}" for x in values)


def entry_at(name: str, array: str, begin: int | str) -> str:
    """Where an entry of an array is."""
    return f"  {name} = getelementptr inbounds double, ptr {array}, i64 {begin}"


def spread_out(name: str, value: str, kind: str) -> str:
    """A number in each lane of a vector."""
    width = kind[1 : kind.index(" ")]  # of `<8 x double>`
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


def add_scaled(name: str, vector: str, number: str, other: str, kind: str, is_wide: bool = False) -> str:
    """vector + number * other; a wide number is a vector itself."""
    wide = number if is_wide else f"{name}.wide"
    # `contract`: LLVM may make one fused operation of both, as it may in XLA's own code; never a sum in another order.
    lines = [
        f"  {name}.part = fmul contract {kind} {wide}, {other}",
        f"  {name} = fadd contract {kind} {vector}, {name}.part",
    ]
    return "\n".join(lines if is_wide else [spread_out(wide, number, kind), *lines])


AT_ONCE = 8
"""Vectors that are summed side by side: with those of a whole state they would not stay in registers."""


def summing(size: int) -> str:
    """A function `sum` from (x, k, weights, n, y) to y = x + sum_j weights_j k_j over the first n of arrays k_j.

    What has no weight does not count: it may be infinite.

    Args:
        size: of x, of each k_j, and of y.
    """
    # The outer loop is over blocks of entries and the inner one over stages: sums stay in registers, and y is written
    # once. The other way round, y would be loaded and stored for each stage.
    block = AT_ONCE * LANES_AT_A_TIME
    # A loop over blocks of whole vectors, and one block for the rest: written out, a state of 500 entries would be
    # thousands of instructions.
    whole, rest = divmod(size, block)
    lines = [
        "define internal void @sum(ptr %x, ptr %k, ptr %weights, i64 %n, ptr noalias %y) nounwind {",
        "start:",
        f"  br label %{'many' if whole else 'few'}",
    ]
    if whole:
        lines += [
            "many:",
            "  %b = phi i64 [0, %start], [%b.next, %many.end]",
            f"  %many.at = mul nuw nsw i64 %b, {block}",
            _summing("many", block, size),
            "  %b.next = add nuw nsw i64 %b, 1",
            f"  %b.done = icmp sge i64 %b.next, {whole}",
            "  br i1 %b.done, label %few, label %many",
        ]
    lines.append("few:")
    if rest:
        lines += [f"  %few.at = add i64 0, {whole * block}", _summing("few", rest, size)]
    return "\n".join([*lines, "  ret void", "}", ""])


def _summing(label: str, n_entries: int, size: int) -> str:
    """A block of entries from `label.at` on; goes on in the block `label.end`."""
    chunks = [(at, min(LANES_AT_A_TIME, n_entries - at)) for at in range(0, n_entries, LANES_AT_A_TIME)]
    kinds = [(i, at, f"<{wide} x double>") for i, (at, wide) in enumerate(chunks)]
    lines = [entry_at(f"%{label}.x", "%x", f"%{label}.at"), entry_at(f"%{label}.y", "%y", f"%{label}.at")]
    lines += [loaded(f"%{label}.x{i}", f"%{label}.x", at, kind) for i, at, kind in kinds]
    lines += [
        f"  br label %{label}.of",
        f"{label}.of:",
        f"  %{label}.j = phi i64 [0, %{label}], [%{label}.next, %{label}.on]",
    ]
    lines += [
        f"  %{label}.s{i} = phi {kind} [%{label}.x{i}, %{label}], [%{label}.t{i}, %{label}.on]" for i, _, kind in kinds
    ]
    # A weight of zero is jumped over: 0 times infinity would be NaN, and a stage that was not made yet has any number.
    lines += [
        f"  %{label}.more = icmp slt i64 %{label}.j, %n",
        f"  br i1 %{label}.more, label %{label}.look, label %{label}.end",
        f"{label}.look:",
        f"  %{label}.p = getelementptr inbounds double, ptr %weights, i64 %{label}.j",
        f"  %{label}.w = load double, ptr %{label}.p",
        f"  %{label}.counts = fcmp une double %{label}.w, 0.0",
        f"  br i1 %{label}.counts, label %{label}.add, label %{label}.on",
        f"{label}.add:",
        f"  %{label}.row = mul nuw nsw i64 %{label}.j, {size}",
        f"  %{label}.from = add nuw nsw i64 %{label}.row, %{label}.at",
        entry_at(f"%{label}.k", "%k", f"%{label}.from"),
    ]
    for i, at, kind in kinds:
        lines += [
            loaded(f"%{label}.k{i}", f"%{label}.k", at, kind),
            add_scaled(f"%{label}.a{i}", f"%{label}.s{i}", f"%{label}.w", f"%{label}.k{i}", kind),
        ]
    lines += [f"  br label %{label}.on", f"{label}.on:"]
    lines += [
        f"  %{label}.t{i} = phi {kind} [%{label}.s{i}, %{label}.look], [%{label}.a{i}, %{label}.add]"
        for i, _, kind in kinds
    ]
    lines += [
        f"  %{label}.next = add nuw nsw i64 %{label}.j, 1",
        f"  br label %{label}.of",
        f"{label}.end:",
    ]
    for i, at, kind in kinds:
        lines += [
            entry_at(f"%{label}.to{i}", f"%{label}.y", at),
            f"  store {kind} %{label}.s{i}, ptr %{label}.to{i}, align 8",
        ]
    return "\n".join(lines)

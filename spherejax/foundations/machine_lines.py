"""Lines of LLVM's language that functions of several parts are written of; see `machine_text` for whole programs."""

from collections.abc import Sequence
from typing import Any

import numpy as np


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


def add_scaled(name: str, vector: str, number: str, other: str, kind: str, is_wide: bool = False) -> str:
    """vector + number * other; a wide number is a vector itself."""
    wide = number if is_wide else f"{name}.wide"
    lines = [
        f"  {name}.part = fmul contract {kind} {wide}, {other}",
        f"  {name} = fadd contract {kind} {vector}, {name}.part",
    ]
    return "\n".join(lines if is_wide else [spread_out(wide, number, kind), *lines])

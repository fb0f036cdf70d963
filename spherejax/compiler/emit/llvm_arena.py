"""Places for the arrays of a function, of which those that are never needed at the same time share one.

LLVM gives each array on the stack a place of its own. Array code of a hundred bodies makes a thousand arrays, a
megabyte of them, most of which are read once and soon.
"""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from spherejax.compiler.emit.llvm_arrays import NotWrittenError

SMALLEST_SHARED = 256
"""Bytes of an array that may share its place, at least: of smaller ones LLVM makes registers."""

_NAME = re.compile(r"%[\w.]+")
_POINTER = re.compile(r"\s*(%[\w.]+) = getelementptr .*?, ptr (%[\w.]+),")
_LABEL = re.compile(r"label %([\w.]+)")


class SharedRoom(NamedTuple):
    """Instructions that give arrays their places, to stand at the beginning of the function.

    Attributes:
        lines: the instructions.
        n_bytes: of room that the function is to be given, because the stack has too little; 0 where it is on the stack.
    """

    lines: list[str]
    n_bytes: int


def shared_room(sizes: Mapping[str, int], lines: Sequence[str], largest: int, given: str | None = None) -> SharedRoom:
    """Places for the arrays of a function.

    Args:
        sizes: bytes of the arrays by name.
        lines: of the function, behind its beginning.
        largest: bytes of all places together on the stack, at most.
        given: the name of a pointer to room elsewhere, which is taken where that is too little; None for no such room.

    Raises:
        NotWrittenError: if they need more.
    """
    offsets, total = _packed(sizes, _uses(sizes, lines))
    if not offsets:
        return SharedRoom([], 0)
    if total > largest and given is None:
        raise NotWrittenError(f"arrays of {total} bytes that do not fit the stack")
    is_on_stack = total <= largest
    arena = f"alloca [{total} x i8], align 64" if is_on_stack else f"getelementptr inbounds i8, ptr {given}, i64 0"
    places = [f"  {name} = getelementptr inbounds i8, ptr %arena, i64 {at}" for name, at in offsets.items()]
    return SharedRoom([f"  %arena = {arena}", *places], 0 if is_on_stack else total)


def _packed(sizes: Mapping[str, int], uses: Mapping[str, tuple[int, int]]) -> tuple[dict[str, int], int]:
    """Where each array begins: at the first place that is free while it is in use."""
    placed: list[tuple[int, int, int, int]] = []  # first and last use, begin and end
    offsets, total = {}, 0
    for name in sorted(uses, key=lambda name: (-sizes[name], uses[name])):
        first, last = uses[name]
        size, at = -(-sizes[name] // 64) * 64, 0
        for begin, end in sorted(place for begun, ended, *place in placed if begun <= last and first <= ended):
            if begin - at >= size:
                break
            at = max(at, end)
        placed.append((first, last, at, at + size))
        offsets[name], total = at, max(total, at + size)
    return offsets, total


def _uses(sizes: Mapping[str, int], lines: Sequence[str]) -> dict[str, tuple[int, int]]:
    """The first and the last line in which each array is in use; all of a loop in which it is."""
    base = {name: name for name in sizes}
    uses: dict[str, list[int]] = {}
    labels: dict[str, int] = {}
    loops: list[tuple[int, int]] = []
    in_frame: list[str] = []
    for at, line in enumerate(lines):
        if line.endswith(":"):
            labels[line[:-1]] = at
            continue
        if (pointer := _POINTER.match(line)) and pointer[2] in base:
            base[pointer[1]] = base[pointer[2]]
        arrays = [base[name] for name in _NAME.findall(line) if name in base]
        if line.startswith("  store ptr "):
            in_frame += arrays  # where a call finds it that comes some lines later
        elif " call ptr @" in line:
            arrays, in_frame = in_frame, []
        for name in arrays:
            uses.setdefault(name, [at, at])[1] = at
        if line.startswith("  br "):
            loops += [(labels[label], at) for label in _LABEL.findall(line) if label in labels]
    # The inner loops end first: what is extended to one is then extended to those around it.
    for begin, end in loops:
        for span in uses.values():
            if span[0] <= end and begin <= span[1]:
                span[0], span[1] = min(span[0], begin), max(span[1], end)
    return {name: (first, last) for name, (first, last) in uses.items()}

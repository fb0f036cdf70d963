"""A program of machine code for each of many runs, on all processors.

`jax.vmap` of a run that is machine code as a whole is one call for each run. XLA (jaxlib 0.10) makes calls one after
the other, on one processor. Here one function makes all of them: threads take the next run as soon as they are done
with one. Each run is computed as if it were alone, so that its numbers do not depend on how many threads there are.

Threads are those of POSIX. Elsewhere, and with one processor, the function makes the calls in turn.
"""

import os
from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.ffi
import numpy as np
from jax.core import ShapedArray
from jax.extend import core as jex
from jax.interpreters import batching, mlir

from spherejax.compiler.emit.llvm import head
from spherejax.compiler.lanes import by_a_loop
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.native.loops import LoopText, WrittenLoop, loop_primitive, target_of_loop

PREFIX = "spherejaxruns_"
"""Of the names of these functions, which are loaded behind those that they call (`loops.PREFIXES`)."""

STACK = 2**23
"""Bytes of a thread's stack: as the first thread of a process has on most systems, where the others may have less."""

MOST_THREADS = 64
"""Each takes some twenty instructions of the text."""

_mapped = jex.Primitive("mapped_in_machine_code")
_mapped.multiple_results = True


def _n_processors() -> int:
    """Processors that this process may use."""
    if os.name != "posix":
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _of_many(arguments: Sequence, dims: Sequence, *, written: WrittenLoop, results: tuple) -> tuple[Sequence, Sequence]:
    n = next(x.shape[dim] for x, dim in zip(arguments, dims, strict=True) if dim is not None)
    is_mapped = tuple(dim is not None for dim in dims)
    front = [jax.numpy.moveaxis(x, dim, 0) if dim is not None else x for x, dim in zip(arguments, dims, strict=True)]
    rooms = tuple(r for a, r in written.in_place if a in written.rooms and dims[a] is None)
    rooms += (len(results) - 1,) if written.n_room else ()
    n_threads = max(1, min(n, _n_processors(), MOST_THREADS))
    made = _mapped.bind(
        *front, written=written, results=results, n=n, is_mapped=is_mapped, rooms=rooms, n_threads=n_threads
    )
    # Of rooms there is one for each thread, in which nobody looks behind the call.
    return [x[0] if r in rooms else x for r, x in enumerate(made)], [
        None if r in rooms else 0 for r in range(len(made))
    ]


batching.primitive_batchers[loop_primitive] = _of_many


@_mapped.def_abstract_eval
def _shapes(*_: Any, results: tuple, n: int, rooms: tuple, n_threads: int, **__: Any) -> list:
    return [ShapedArray((n_threads if r in rooms else n, *x.shape), x.dtype) for r, x in enumerate(results)]


def _lowered(
    context: Any, *arguments: Any, written: WrittenLoop, results: tuple, n: int, is_mapped: tuple, rooms: tuple,
    n_threads: int,
) -> Sequence:  # fmt: skip
    inner = target_of_loop(written)
    of_one = [
        aval.update(shape=aval.shape[1:]) if m else aval for aval, m in zip(context.avals_in, is_mapped, strict=True)
    ]
    text = _MappedText(written, inner, of_one, results, is_mapped, rooms).of_runs(n, n_threads)
    name = machine_code.target_of(text, is_wide=False, is_optimised=True, prefix=PREFIX)
    machine_code.note_ffi_targets([*written.called, inner, name])
    return jax.ffi.ffi_lowering(name)(context, *arguments)


mlir.register_lowering(_mapped, _lowered, platform="cpu")


def _batched(arguments: Sequence, dims: Sequence, **how: Any) -> tuple[Sequence, Sequence]:
    return by_a_loop(partial(_mapped.bind, **how), arguments, dims)


batching.primitive_batchers[_mapped] = _batched


class _MappedText(LoopText):
    """The text of a function that calls another one for each run.

    Args:
        written, inner: the other one, and its target.
        avals, results: of one run.
        is_mapped: of each argument whether each run has its own.
        rooms: results that are room for a thread.
    """

    def __init__(
        self, written: WrittenLoop, inner: str, avals: Sequence[Any], results: Sequence[Any], is_mapped: Sequence[bool],
        rooms: Sequence[int],
    ):  # fmt: skip
        super().__init__(None, avals, results)
        self._inner, self._is_mapped, self._rooms = inner, is_mapped, rooms
        self._room_of = {a: r for a, r in written.in_place if r in rooms}

    def of_runs(self, n: int, n_threads: int) -> str:
        """The text of a function that XLA calls, and of that which each thread executes."""
        n_arguments, n_results = len(self.avals), len(self.results)
        # What the threads share: pointers to arguments and results, and the number of the next run. Each has its index.
        names = [*(f"%a{i}" for i in range(n_arguments)), *(f"%r{i}" for i in range(n_results))]
        shared = [f"  %shared = alloca [{len(names) + 1} x ptr], align 64"]
        for i, name in enumerate([*names, "null"]):
            shared += [
                f"  %shared.{i} = getelementptr inbounds ptr, ptr %shared, i64 {i}",
                f"  store ptr {name}, ptr %shared.{i}, align 8",
            ]
        threads = [line for t in range(n_threads) for line in self._own(t)]
        started = [line for t in range(1, n_threads) for line in self._started(t)]
        joined = [line for t in range(1, n_threads) for line in self._joined(t)]
        attributes = ["  %attributes = alloca [16 x i64], align 64"]
        if n_threads > 1:
            attributes += [
                "  %x.init = call i32 @pthread_attr_init(ptr %attributes)",
                f"  %x.size = call i32 @pthread_attr_setstacksize(ptr %attributes, i64 {STACK})",
            ]
        body = [*shared, *attributes, *threads, *started, "  %x.own = call ptr @runs(ptr %own.0)"]
        body += [*joined, "  ret ptr null", "}", ""]
        declared = [f"declare ptr @{self._inner}(ptr)"]
        if n_threads > 1:
            declared += [
                "declare i32 @pthread_attr_init(ptr)",
                "declare i32 @pthread_attr_setstacksize(ptr, i64)",
                "declare i32 @pthread_create(ptr, ptr, ptr, ptr)",
                "declare i32 @pthread_join(i64, ptr)",
            ]
        of_thread = self._of_thread(n)
        return "\n".join([*declared, *self.text.declared, of_thread, head(n_arguments, n_results), *body])

    @staticmethod
    def _own(t: int) -> list[str]:
        """What a thread is given: what is shared, and its index."""
        return [
            f"  %own.{t} = alloca [2 x i64], align 64",
            f"  store ptr %shared, ptr %own.{t}, align 8",
            f"  %index.{t} = getelementptr inbounds i64, ptr %own.{t}, i64 1",
            f"  store i64 {t}, ptr %index.{t}, align 8",
            f"  %thread.{t} = alloca i64, align 8",
        ]

    @staticmethod
    def _started(t: int) -> list[str]:
        return [f"  %failed.{t} = call i32 @pthread_create(ptr %thread.{t}, ptr %attributes, ptr @runs, ptr %own.{t})"]

    @staticmethod
    def _joined(t: int) -> list[str]:
        # Where the system has no more threads, the others make all runs.
        return [
            f"  %is.started.{t} = icmp eq i32 %failed.{t}, 0",
            f"  br i1 %is.started.{t}, label %join.{t}, label %joined.{t}",
            f"join.{t}:",
            f"  %id.{t} = load i64, ptr %thread.{t}, align 8",
            f"  %x.join.{t} = call i32 @pthread_join(i64 %id.{t}, ptr null)",
            f"  br label %joined.{t}",
            f"joined.{t}:",
        ]

    def _of_thread(self, n: int) -> str:
        """The function that a thread executes: the next run, until there is none."""
        text, n_arguments = self.text, len(self.avals)
        frame = self._frame(n_arguments, len(self.results))
        index = text.made("load i64, ptr %p.index, align 8")

        def base(i: int) -> str:
            return text.made(f"load ptr, ptr {text.made(f'getelementptr inbounds ptr, ptr %shared, i64 {i}')}, align 8")

        bases = [base(i) for i in range(n_arguments + len(self.results))]
        counter = text.made(f"getelementptr inbounds ptr, ptr %shared, i64 {len(bases)}")
        text.say("br label %look")
        text.lines.append("look:")
        i = text.made(f"atomicrmw add ptr {counter}, i64 1 seq_cst")
        text.say(f"br i1 {text.made(f'icmp ult i64 {i}, {n}')}, label %turn, label %end")
        text.lines.append("turn:")

        def of_run(pointer: str, aval: Any, at: str) -> str:
            offset = text.made(f"mul nsw i64 {at}, {aval.size * np.dtype(aval.dtype).itemsize}")
            return text.made(f"getelementptr inbounds i8, ptr {pointer}, i64 {offset}")

        results = [
            of_run(bases[n_arguments + r], aval, index if r in self._rooms else i)
            for r, aval in enumerate(self.results)
        ]
        arguments = [
            # Room is changed where it is.
            results[self._room_of[a]] if a in self._room_of else of_run(bases[a], aval, i) if mapped else bases[a]
            for a, (aval, mapped) in enumerate(zip(self.avals, self._is_mapped, strict=True))
        ]
        for places, pointers in ((frame.arguments, arguments), (frame.results, results)):
            for place, pointer in zip(places, pointers, strict=True):
                text.say(f"store ptr {pointer}, ptr {place}, align 8")
        text.made(f"call ptr @{self._inner}(ptr {frame.name})")
        text.say("br label %look")
        text.lines.append("end:")
        begin = [
            "define internal ptr @runs(ptr %own) nounwind {",
            "work:",
            "  %shared = load ptr, ptr %own, align 8",
            "  %p.index = getelementptr inbounds i64, ptr %own, i64 1",
        ]
        return "\n".join([*begin, *text.room, *self._at_begin, *text.lines, "  ret ptr null", "}", ""])

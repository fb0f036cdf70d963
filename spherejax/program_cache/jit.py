"""`cached_jit`: a decorator that compiles a pure function, and keeps its programs in memory and on disk.

It does what `equinox.filter_jit` does (arrays are traced, everything else is static), with three differences:

* **The memory is bounded.** JAX keeps what it has compiled for as long as the process lives: 15 to 30 MB for the
  program of a four-bar, for each structure and each number of samples. A study that varies them grows until it is
  killed. Here the least recently used program is freed.
* **Programs are cached on disk** (`disk_cache`): another process neither traces nor compiles them again.
* **Within other programs it is one call** (`call`), where `many` is given: a program of a user's that contains it does
  not trace it again.
"""

from collections.abc import Callable, Sequence
from functools import partial, update_wrapper
from types import MappingProxyType
from typing import Any

import equinox as eqx
import jax
import jax.core

from spherejax.program_cache import settings
from spherejax.program_cache.garbage import gc_paused
from spherejax.program_cache.keys import LruCache, call_key
from spherejax.program_cache.program import N_PROGRAMS, CompiledProgram, Options


class CachedJit:
    """A compiled function; see `cached_jit`."""

    def __init__(self, function: Callable, n_programs: int, what: tuple[str, ...], options: Options):
        self._function, self._what, self._options = function, what, options
        self._programs = LruCache(n_programs, evicted=CompiledProgram.clear)
        update_wrapper(self, function)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Evaluate; a program that has not been met is traced and compiled."""
        program, _, arrays = self._program_for(arguments, named)
        return self._evaluated(program, arrays)

    def bound(self, *arguments: Any) -> Callable[[], Any]:
        """A function that evaluates with these arguments, without taking them apart again at each call."""
        program, make, arrays = self._program_for(arguments, {})
        # The program itself is not held: if it is evicted in between, its memory is freed, and it is made again.
        key = program.key
        return lambda: self._evaluated(self._programs.get(key, make), arrays)

    def bound_form(self, *arguments: Any) -> Callable[[Sequence], Any]:
        """A function that evaluates with other arrays of the same shapes and types, in the order of the leaves of these
        arguments; all that is no array is as it is here."""
        program, make, _ = self._program_for(arguments, {})
        key = program.key
        return lambda arrays: self._evaluated(self._programs.get(key, make), list(arrays))

    def bound_but(self, n_last: int, *arguments: Any) -> Callable[..., Any]:
        """A function of the last few arguments that evaluates with all the others as they are here.

        Its arguments are pytrees of arrays alone, NumPy's too, of the same shapes and types as those here.
        """
        program, make, arrays = self._program_for(arguments, {})
        key = program.key
        # Leaves are in the order of the arguments: the last ones are those of the last arguments.
        first = arrays[: len(arrays) - len(jax.tree.leaves(arguments[-n_last:]))]
        return lambda *last: self._evaluated(self._programs.get(key, make), [*first, *jax.tree.leaves(last)])

    def _evaluated(self, program: CompiledProgram, arrays: list) -> Any:
        # An executable takes numbers only; within another program the function is a part of that.
        if any(isinstance(array, jax.core.Tracer) for array in arrays):
            with gc_paused():
                return program.results(program.within(*arrays))
        return program.results(program.now(*arrays))

    def compiled(self, *arguments: Any) -> Callable:
        """The program for arguments like these, compiled now: threads that share it do not compile it again."""
        entry, *_ = self._program_for(arguments, {})
        # The context is around the compiler alone: whoever waits for a run is told by that run.
        with settings.current().compiling(self._what[0], entry.name):
            program = entry.compiled

        # It holds the program itself: an eviction on another thread does not take it away.
        def run(*arguments: Any) -> Any:
            return entry.results(program(*filter(eqx.is_array, jax.tree.leaves(arguments))))

        return run

    def shapes(self, *arguments: Any) -> Any:
        """What a call would return, as shapes and types."""
        program, *_ = self._program_for(arguments, {})
        return program.results(program.shapes)

    @property
    def n_programs(self) -> int:
        """How many programs are in memory now."""
        return len(self._programs)

    def clear(self) -> None:
        """Free all programs."""
        self._programs.clear()

    def _program_for(self, arguments: tuple, named: dict) -> tuple[CompiledProgram, Callable, list]:
        """The program for these arguments, how it is made again, and the arrays that it takes."""
        # The names of arguments are in the structure: `f(x)` and `f(x=x)` are two programs, as they are to JAX.
        key, static, arrays = call_key((arguments, named))
        # Made again after an eviction too, by whoever holds `make`.
        make = partial(CompiledProgram.of, self._function, key, static, self._what, self._options)
        return self._programs.get(key, make), make, arrays


def cached_jit(
    function: Callable | None = None,
    *,
    n_programs: int = N_PROGRAMS,
    what: str = "",
    many: str = "",
    options: Options = MappingProxyType({}),
) -> Any:
    """Compile a pure function, and keep its programs in memory and on disk.

    Args:
        function: its arguments are arrays, hashable values, and pytrees of both. Arrays are traced; another value of
            anything else is another program.

    Other args:
        n_programs: how many programs are kept in memory. The least recently used one is evicted, and is loaded or
            compiled again when it is asked for again.
        what: what is compiled, for whoever waits, e.g. `"a run"`; by default the name of the function.
        many: the same of many at once, under `jax.vmap`. Where it is given, a call within another program is one
            operation (see `call`), unless code of a user's own is in it.
        options: of XLA, or a function that says them for the arguments of a call, its arrays left out.
    """
    if function is None:
        return partial(cached_jit, n_programs=n_programs, what=what, many=many, options=options)
    # More than one text means that the function may be one operation of other programs (`CompiledProgram.within`).
    said = what or getattr(function, "__name__", "a program")
    return CachedJit(function, n_programs, (said, many) if many else (said,), options)

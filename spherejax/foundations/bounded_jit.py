"""`eqx.filter_jit` with a bound: a program that has not been used for long is let go, and its memory with it.

JAX keeps what it has compiled for as long as the process lives: 15 to 30 MB for a program of a four-bar, for each
number of samples, each structure, each builder. A study that varies them grows until it is killed.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import partial, update_wrapper
from typing import Any, NamedTuple

import equinox as eqx
import jax

N_PROGRAMS = 24
"""Programs of one function that are kept: at most about half a gigabyte of a mechanism such as the four-bar."""


class _Static(eqx.Module):
    value: Any = eqx.field(static=True)


class _Entry(NamedTuple):
    """One program: a `jax.jit` of its own, so that it can be let go alone, and what it has compiled ahead of time."""

    jitted: Any
    ahead: dict[str, Any]


class BoundedJit:
    """A compiled function; see `bounded_jit`."""

    def __init__(self, function: Callable, n_programs: int):
        self._function, self._n_programs = function, n_programs
        self._entries: OrderedDict[Hashable, _Entry] = OrderedDict()
        self._lock = threading.RLock()
        update_wrapper(self, function)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Evaluate; what has not been seen is traced and compiled."""
        entry, arrays = self._entry_for((arguments, named))
        found, static = entry.jitted(arrays)
        return eqx.combine(found, static.value)

    def compiled(self, *arguments: Any) -> Callable:
        """The program for arguments like these, compiled now: threads that share it do not compile it again."""
        entry, arrays = self._entry_for((arguments, {}))
        with self._lock:
            if "program" not in entry.ahead:
                entry.ahead["program"] = entry.jitted.lower(arrays).compile()
        program = entry.ahead["program"]

        def run(*arguments: Any) -> Any:
            found, static = program(eqx.filter((arguments, {}), eqx.is_array))
            return eqx.combine(found, static.value)

        return run

    @property
    def n_programs(self) -> int:
        """How many are kept now."""
        return len(self._entries)

    def clear(self) -> None:
        """Let all of them go."""
        with self._lock:
            while self._entries:
                self._let_go()

    def _entry_for(self, arguments: tuple) -> tuple[_Entry, Any]:
        arrays, rest = eqx.partition(arguments, eqx.is_array)
        leaves, tree = jax.tree.flatten(rest)
        avals = tuple((leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)) for leaf in jax.tree.leaves(arrays))
        key = (tree, tuple(leaves), jax.tree.structure(arrays), avals)
        with self._lock:
            entry = self._entries.get(key)
            if entry is None:
                entry = self._entries[key] = _Entry(self._jitted(rest), {})
            self._entries.move_to_end(key)
            while len(self._entries) > self._n_programs:
                self._let_go()
        return entry, arrays

    def _jitted(self, rest: Any) -> Any:
        def run(arrays):
            positional, named = eqx.combine(arrays, rest)
            found = self._function(*positional, **named)
            arrays_found, static = eqx.partition(found, eqx.is_array)
            return arrays_found, _Static(static)

        run.__name__ = run.__qualname__ = self._function.__name__
        return jax.jit(run)

    def _let_go(self) -> None:
        _, entry = self._entries.popitem(last=False)
        entry.jitted.clear_cache()


def bounded_jit(function: Callable | None = None, *, n_programs: int = N_PROGRAMS) -> Any:
    """Compile a function: arrays are traced, all else is static, as `eqx.filter_jit` does.

    Args:
        function: its arguments are arrays, hashable values, and pytrees of both.

    Other args:
        n_programs: how many programs are kept; the one that was used longest ago goes first, and is compiled again when
            it is asked for again.
    """
    return partial(bounded_jit, n_programs=n_programs) if function is None else BoundedJit(function, n_programs)


def inlined(function: Callable) -> Callable:
    """A compiled function as what it was before, for use inside another one.

    Programs are then kept by the outer function alone: `diffrax.diffeqsolve` keeps its own trace of each, 12 MB for a
    four-bar, for as long as the process lives.
    """
    return getattr(function, "__wrapped__", function)

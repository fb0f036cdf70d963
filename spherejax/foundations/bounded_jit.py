"""`eqx.filter_jit` with a bound: a program that has not been used for long is let go, and its memory with it.

JAX keeps what it has compiled for as long as the process lives: 15 to 30 MB for a program of a four-bar, for each
number of samples, each structure, each builder. A study that varies them grows until it is killed.
"""

import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import partial, update_wrapper
from typing import Any

import equinox as eqx
import jax

N_PROGRAMS = int(os.environ.get("SPHEREJAX_PROGRAMS", "24"))
"""Programs of one function that are kept: of a mechanism such as the four-bar about half a gigabyte.

A study that goes round more lengths of records, or mechanisms, than this compiles them again each time: set the
environment variable `SPHEREJAX_PROGRAMS` to more before the import, or to less where memory is short."""


class _Entry:
    """One program: a `jax.jit` of its own, so that it can be let go alone.

    Only leaves go in and out of it. JAX remembers trees of arguments and results for ever, with all that is static in
    them.
    """

    def __init__(self, function: Callable, rest: Any, tree: Any):
        self.compiled: Any = None
        self._results: Any = None

        def run(*leaves: Any) -> Any:
            positional, named = eqx.combine(jax.tree.unflatten(tree, leaves), rest)
            arrays, static = eqx.partition(function(*positional, **named), eqx.is_array)
            found, found_tree = jax.tree.flatten(arrays)
            self._results = (found_tree, static)
            return tuple(found)

        run.__name__ = run.__qualname__ = getattr(function, "__name__", "program")
        self.jitted: Any = jax.jit(run)

    def results(self, leaves: tuple) -> Any:
        """What the function returned, from the leaves that were computed."""
        tree, static = self._results
        return eqx.combine(jax.tree.unflatten(tree, leaves), static)


class BoundedJit:
    """A compiled function; see `bounded_jit`."""

    def __init__(self, function: Callable, n_programs: int):
        self._function, self._n_programs = function, n_programs
        self._entries: OrderedDict[Hashable, _Entry] = OrderedDict()
        self._lock = threading.RLock()
        update_wrapper(self, function)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Evaluate; what has not been seen is traced and compiled."""
        entry, leaves = self._entry_for(arguments, named)
        return entry.results(entry.jitted(*leaves))

    def compiled(self, *arguments: Any) -> Callable:
        """The program for arguments like these, compiled now: threads that share it do not compile it again."""
        entry, leaves = self._entry_for(arguments, {})
        with self._lock:
            if entry.compiled is None:
                entry.compiled = entry.jitted.lower(*leaves).compile()
        program = entry.compiled

        def run(*arguments: Any) -> Any:
            return entry.results(program(*jax.tree.leaves(eqx.filter((arguments, {}), eqx.is_array))))

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

    def _entry_for(self, arguments: tuple, named: dict) -> tuple[_Entry, list]:
        arrays, rest = eqx.partition((arguments, named), eqx.is_array)
        leaves, tree = jax.tree.flatten(arrays)
        static, static_tree = jax.tree.flatten(rest)
        kinds = tuple((leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)) for leaf in leaves)
        key = (static_tree, tuple(static), tree, kinds)
        with self._lock:
            entry = self._entries.get(key)
            if entry is None:
                entry = self._entries[key] = _Entry(self._function, rest, tree)
            self._entries.move_to_end(key)
            while len(self._entries) > self._n_programs:
                self._let_go()
        return entry, leaves

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

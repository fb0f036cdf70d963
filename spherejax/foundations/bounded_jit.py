"""`eqx.filter_jit` with a bound: a program that has not been used for long is let go, and its memory with it.

JAX keeps what it has compiled for as long as the process lives: 15 to 30 MB for a program of a four-bar, for each
number of samples, each structure, each builder. A study that varies them grows until it is killed.

What was traced is kept on disk too (`kept_traces`): another process neither traces nor compiles it again.
"""

import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import partial, update_wrapper
from typing import Any

import equinox as eqx
import jax
import jax.core
from jax import export

from spherejax.foundations import kept_traces
from spherejax.foundations.terminals import waiting_for

N_PROGRAMS = int(os.environ.get("SPHEREJAX_PROGRAMS", "24"))
"""Programs of one function that are kept: of a mechanism such as the four-bar about half a gigabyte.

A study that goes round more lengths of records, or mechanisms, than this compiles them again each time: set the
environment variable `SPHEREJAX_PROGRAMS` to more before the import, or to less where memory is short."""


class _Entry:
    """One program: a `jax.jit` of its own, so that it can be let go alone.

    Only leaves go in and out of it. JAX remembers trees of arguments and results for ever, with all that is static in
    them.

    Attributes:
        jitted: the program as it is traced; for use inside another one.
        compiled: the program for threads that share it, once it was asked for.
        has_been_called: whether it was compiled here, by its first call.
        name: under which it is compiled.
    """

    def __init__(self, function: Callable, rest: Any, tree: Any, kinds: tuple):
        self.compiled: Any = None
        self.has_been_called = False
        self.name: str = getattr(function, "__name__", "program")
        self._results: Any = None
        self._program: Any = None
        self._made_from = function, rest, tree, kinds
        self._lock = threading.Lock()

        def run(*leaves: Any) -> Any:
            positional, named = eqx.combine(jax.tree.unflatten(tree, leaves), rest)
            arrays, static = eqx.partition(function(*positional, **named), eqx.is_array)
            found, found_tree = jax.tree.flatten(arrays)
            self._results = (found_tree, static)
            return tuple(found)

        self.jitted: Any = _jitted(run, self.name)

    @property
    def program(self) -> Any:
        """The program for numbers: loaded, or traced and kept, at its first use."""
        with self._lock:
            if self._program is None:
                self._program = self._loaded_or_traced()
        return self._program

    def _loaded_or_traced(self) -> Any:
        function, rest, tree, kinds = self._made_from
        key = kept_traces.key_for(function, rest, tree, kinds)
        found = kept_traces.load(key)
        if found is None:
            found = self._traced(key)
        if found is None:
            return self.jitted
        content, (example, static) = found
        self._results = jax.tree.structure(example), static
        # What this process has traced goes the same way: what is compiled of it is then found by the next one.
        return _jitted(export.deserialize(bytearray(content)).call, "kept_" + self.name)

    def _traced(self, key: str | None) -> tuple | None:
        """The program, traced and kept, with what tells the results of it; None where it cannot be kept."""
        if key is None:
            return None
        *_, kinds = self._made_from
        leaves = [jax.ShapeDtypeStruct(shape, dtype, weak_type=weak) for shape, dtype, weak in kinds]
        with kept_traces.listened() as has_warned:
            self.jitted.trace(*leaves)
        try:
            content = bytes(export.export(self.jitted)(*leaves).serialize())
        except (ValueError, NotImplementedError):  # it calls Python, or code of which JAX promises nothing
            return None
        found_tree, static = self._results
        found = content, (jax.tree.unflatten(found_tree, range(found_tree.num_leaves)), static)
        if not has_warned():
            kept_traces.save(key, found)
        return found

    def clear(self) -> None:
        """Let go of what was compiled."""
        self.jitted.clear_cache()
        if self._program is not None:
            self._program.clear_cache()

    def results(self, leaves: tuple) -> Any:
        """What the function returned, from the leaves that were computed."""
        tree, static = self._results
        return eqx.combine(jax.tree.unflatten(tree, leaves), static)


def _jitted(run: Callable, name: str) -> Any:
    """A function, compiled under a name."""

    def named(*leaves: Any) -> Any:
        return run(*leaves)

    named.__name__ = named.__qualname__ = name
    return jax.jit(named)


class BoundedJit:
    """A compiled function; see `bounded_jit`."""

    def __init__(self, function: Callable, n_programs: int, what: str):
        self._function, self._n_programs, self._what = function, n_programs, what
        self._entries: OrderedDict[Hashable, _Entry] = OrderedDict()
        self._lock = threading.RLock()
        update_wrapper(self, function)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Evaluate; what has not been seen is traced and compiled."""
        entry, leaves = self._entry_for(arguments, named)
        if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            return entry.results(entry.jitted(*leaves))
        if entry.has_been_called:
            return entry.results(entry.program(*leaves))
        with waiting_for(self._what, entry.name):
            found = entry.program(*leaves)
        entry.has_been_called = True
        return entry.results(found)

    def compiled(self, *arguments: Any) -> Callable:
        """The program for arguments like these, compiled now: threads that share it do not compile it again."""
        entry, leaves = self._entry_for(arguments, {})
        with self._lock:
            if entry.compiled is None:
                with waiting_for(self._what, entry.name):
                    entry.compiled = entry.program.lower(*leaves).compile()
        program = entry.compiled

        def run(*arguments: Any) -> Any:
            return entry.results(program(*jax.tree.leaves(eqx.filter((arguments, {}), eqx.is_array))))

        return run

    def shapes(self, *arguments: Any) -> Any:
        """What a call would return, as shapes and types."""
        entry, leaves = self._entry_for(arguments, {})
        return entry.results(jax.eval_shape(entry.program, *leaves))

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
                entry = self._entries[key] = _Entry(self._function, rest, tree, kinds)
            self._entries.move_to_end(key)
            while len(self._entries) > self._n_programs:
                self._let_go()
        return entry, leaves

    def _let_go(self) -> None:
        _, entry = self._entries.popitem(last=False)
        entry.clear()


def bounded_jit(function: Callable | None = None, *, n_programs: int = N_PROGRAMS, what: str = "") -> Any:
    """Compile a function: arrays are traced, all else is static, as `eqx.filter_jit` does.

    Args:
        function: its arguments are arrays, hashable values, and pytrees of both.

    Other args:
        n_programs: how many programs are kept; the one that was used longest ago goes first, and is compiled again when
            it is asked for again.
        what: what whoever waits is told to wait for, e.g. `"a run"`; by default the name of the function.
    """
    if function is None:
        return partial(bounded_jit, n_programs=n_programs, what=what)
    return BoundedJit(function, n_programs, what or getattr(function, "__name__", "a program"))


def inlined(function: Callable) -> Callable:
    """A compiled function as what it was before, for use inside another one.

    Programs are then kept by the outer function alone: `diffrax.diffeqsolve` keeps its own trace of each, 12 MB for a
    four-bar, for as long as the process lives.
    """
    return getattr(function, "__wrapped__", function)

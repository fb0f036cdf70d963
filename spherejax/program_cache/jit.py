"""`eqx.filter_jit` with a bound: a program that has not been used for long is let go, and its memory with it.

JAX keeps what it has compiled for as long as the process lives: 15 to 30 MB for a program of a four-bar, for each
structure, each builder, each number of samples where that matters. A study that varies them grows until it is killed.

What was compiled is kept on disk too (`disk_cache`): another process neither traces nor compiles it again.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import partial, update_wrapper
from types import MappingProxyType
from typing import Any

import equinox as eqx
import jax
import jax.core

from spherejax.program_cache import settings
from spherejax.program_cache.garbage import gc_paused
from spherejax.program_cache.program import N_PROGRAMS, KeptProgram, Options
from spherejax.program_cache.user_code import user_code_fingerprint


class _Key:
    """By what a program is told; its hash is computed once."""

    __slots__ = ("_hash", "parts")

    def __init__(self, *parts: Hashable):
        self.parts, self._hash = parts, hash(parts)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, _Key) and self.parts == other.parts)


class CachedJit:
    """A compiled function; see `cached_jit`."""

    def __init__(self, function: Callable, n_programs: int, what: tuple[str, ...], options: Options):
        self._function, self._n_programs, self._what, self._options = function, n_programs, what, options
        self._entries: OrderedDict[Hashable, KeptProgram] = OrderedDict()
        self._lock = threading.RLock()
        update_wrapper(self, function)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Evaluate; what has not been seen is traced and compiled."""
        key, make, leaves = self._key_for(arguments, named)
        return self._called(self._kept(key, make), leaves)

    def bound(self, *arguments: Any) -> Callable[[], Any]:
        """A function that evaluates with these arguments, and looks for its program without taking them apart again."""
        key, make, leaves = self._key_for(arguments, {})
        key = self._kept(key, make).key
        return lambda: self._called(self._kept(key, make), leaves)

    def bound_but(self, n_last: int, *arguments: Any) -> Callable[..., Any]:
        """A function of the last few arguments that evaluates with all the others as they are here.

        What it is given are pytrees of arrays alone, NumPy's too, of the same shapes and types as those here.
        """
        key, make, leaves = self._key_for(arguments, {})
        key = self._kept(key, make).key
        first = leaves[: len(leaves) - len(jax.tree.leaves(arguments[-n_last:]))]
        return lambda *last: self._called(self._kept(key, make), [*first, *jax.tree.leaves(last)])

    def _called(self, entry: KeptProgram, leaves: list) -> Any:
        if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            with gc_paused():
                return entry.results(entry.within(*leaves))
        return entry.results(entry.now(*leaves))

    def compiled(self, *arguments: Any) -> Callable:
        """The program for arguments like these, compiled now: threads that share it do not compile it again."""
        entry, _ = self._entry_for(arguments, {})
        with settings.current().compiling(self._what[0], entry.name):
            program = entry.compiled

        def run(*arguments: Any) -> Any:
            return entry.results(program(*jax.tree.leaves(eqx.filter((arguments, {}), eqx.is_array))))

        return run

    def shapes(self, *arguments: Any) -> Any:
        """What a call would return, as shapes and types."""
        entry, _ = self._entry_for(arguments, {})
        return entry.results(entry.shapes)

    @property
    def n_programs(self) -> int:
        """How many are kept now."""
        return len(self._entries)

    def clear(self) -> None:
        """Let all of them go."""
        with self._lock:
            while self._entries:
                self._let_go()

    def _entry_for(self, arguments: tuple, named: dict) -> tuple[KeptProgram, list]:
        key, make, leaves = self._key_for(arguments, named)
        return self._kept(key, make), leaves

    def _key_for(self, arguments: tuple, named: dict) -> tuple[_Key, Callable[[], KeptProgram], list]:
        """By what the program for these arguments is told, how it is made, and what it takes."""
        arrays, rest = eqx.partition((arguments, named), eqx.is_array)
        leaves, tree = jax.tree.flatten(arrays)
        static, static_tree = jax.tree.flatten(rest)
        kinds = tuple((leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)) for leaf in leaves)
        key = _Key(static_tree, user_code_fingerprint(static_tree), tuple(static), tree, kinds)

        def made() -> KeptProgram:
            return KeptProgram.of(self._function, rest, tree, kinds, self._what, self._options)

        return key, made, leaves

    def _kept(self, key: _Key, make: Callable[[], KeptProgram]) -> KeptProgram:
        with self._lock:
            entry = self._entries.get(key)
            if entry is None:
                entry = self._entries[key] = make()
                entry.key = key  # itself: to compare others with it takes longer
            self._entries.move_to_end(key)
            while len(self._entries) > self._n_programs:
                self._let_go()
        return entry

    def _let_go(self) -> None:
        _, entry = self._entries.popitem(last=False)
        entry.clear()


def cached_jit(
    function: Callable | None = None,
    *,
    n_programs: int = N_PROGRAMS,
    what: str = "",
    many: str = "",
    options: Options = MappingProxyType({}),
) -> Any:
    """Compile a function: arrays are traced, all else is static, as `eqx.filter_jit` does.

    Args:
        function: its arguments are arrays, hashable values, and pytrees of both.

    Other args:
        n_programs: how many programs are kept; the one that was used longest ago goes first, and is compiled again when
            it is asked for again.
        what: what whoever waits is told to wait for, e.g. `"a run"`; by default the name of the function.
        many: the same of many at once, under `jax.vmap`. Where it is given, a call within another program is one
            operation (see `call`), unless code of a user's own is in it.
        options: of XLA, or a function that says them for the arguments of a call, its arrays left out.
    """
    if function is None:
        return partial(cached_jit, n_programs=n_programs, what=what, many=many, options=options)
    said = what or getattr(function, "__name__", "a program")
    return CachedJit(function, n_programs, (said, many) if many else (said,), options)


def inlined(function: Callable) -> Callable:
    """A compiled function as what it was before, for use inside another one.

    Programs are then kept by the outer function alone: `diffrax.diffeqsolve` keeps its own trace of each, 12 MB for a
    four-bar, for as long as the process lives.
    """
    return getattr(function, "__wrapped__", function)

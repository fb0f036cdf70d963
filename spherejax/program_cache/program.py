"""One program of a compiled function: in memory, on disk for the next process, and within other programs.

It is loaded or compiled at its first call. What is written to disk is what XLA has compiled, with the code that the
program calls (`settings.ExtraBlobs`), the shapes of its results, and what it returns besides arrays.
"""

import os
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from functools import cached_property
from typing import Any
from uuid import uuid4

import equinox as eqx
import jax
from jax.experimental import serialize_executable

from spherejax.program_cache import disk_cache, folders, private, settings
from spherejax.program_cache.call import CachedCall
from spherejax.program_cache.garbage import gc_paused
from spherejax.program_cache.jaxprs import calls_python
from spherejax.program_cache.keys import ArrayKind, CacheKey, LruCache
from spherejax.program_cache.several_devices import gathered

N_PROGRAMS = int(os.environ.get("SPHEREJAX_PROGRAMS", "24"))
"""Programs of one function that are kept in memory: of a mechanism such as the four-bar about half a gigabyte.

A study that alternates between more lengths of records, or mechanisms, than this compiles them again each time: set the
environment variable `SPHEREJAX_PROGRAMS` to more before the import, or to less where memory is short."""


Options = Mapping[str, Any] | Callable[..., Mapping[str, Any]]
"""Options of XLA, or a function from the arguments of a call to them."""


class CompiledProgram:
    """One program of a function: a `jax.jit` of its own, so that its memory can be freed alone.

    Only leaves go in and out of it. JAX remembers trees of arguments and results for as long as the process lives, with
    all that is static in them.

    Attributes:
        jitted: the program as it is traced; for use inside another one.
        key: of the call that it was made for.
        made_from: all that goes into it: the function, the structure and the leaves of its key, and the axes over which
            it is mapped.
        has_been_called: whether it was compiled here, by its first call.
        name: under which it is compiled.
    """

    def __init__(
        self,
        made_from: tuple,
        run: Callable,
        returned: "_Returned",
        what: tuple[str, ...],
        options: Callable[[], Mapping],
    ):
        self.key: CacheKey | None = None
        self.has_been_called = False
        # Of the function: profiles and JAX's events have it.
        self.name: str = getattr(made_from[0], "__name__", "program")
        self.jitted: Any = _jitted(run, self.name)
        self.made_from = made_from
        self._run, self._returned, self._what, self._options = run, returned, what, options
        self._program: Any = None
        self._shapes: list | None = None
        self._call: CachedCall | None = None
        # By the axes and the number of runs: each is a program of its own, and they are evicted as others are.
        self._many = LruCache(N_PROGRAMS, evicted=CompiledProgram.clear)
        self._lock = threading.Lock()

    @classmethod
    def of(cls, function: Callable, key: CacheKey, static: list, what: tuple[str, ...], options: Options):
        """The program of a function for the calls of a key.

        Args:
            function: pure, of arrays and of static values.
            key: of `call_key`.
            static: the leaves of the arguments, with None in the places of arrays.
            what: what is compiled; and of many at once, if it may be one operation of other programs.
            options: of XLA.
        """
        returned = _Returned()
        places = [place for place, leaf in enumerate(static) if leaf is None]

        def run(*arrays: Any) -> Any:
            leaves = list(static)
            for place, array in zip(places, arrays, strict=True):
                leaves[place] = array
            positional, named = jax.tree.unflatten(key.structure, leaves)
            with settings.current().tracing():
                results, others = eqx.partition(function(*positional, **named), eqx.is_array)
            computed, tree = jax.tree.flatten(results)
            # Left here by a side effect of tracing: a compiled program returns arrays alone.
            returned.parts = (tree, others)
            return tuple(computed)

        def chosen() -> Mapping[str, Any]:
            if not callable(options):
                return options
            positional, named = jax.tree.unflatten(key.structure, static)
            return options(*positional, **named)

        program = cls((function, key.structure, key.leaves, ()), run, returned, what, chosen)
        program.key = key
        return program

    def now(self, *leaves: Any) -> Sequence:
        """The results' leaves, from numbers; whoever waits for the compiler is told."""
        numbers = gathered(leaves)
        if private.is_jit_disabled():  # a compiled program raises an error then
            return self._run(*numbers)
        # Nothing is compiled any more, so that nobody has to be told what takes so long.
        if self.has_been_called:
            program = self.program
            # A function of `jax.jit` within another one becomes a part of that.
            if program is self.jitted or private.is_outside_of_transformations():
                return program(*numbers)
            # Within `jax.grad` JAX takes another way to a compiled program, of 700 calls of Python.
            with private.outside_of_transformations():
                return program(*numbers)
        with settings.current().compiling(self._what[0], self.name):
            program = self.program
            # Of a program that is not on disk, JAX traces and compiles at this call.
            with gc_paused() if program is self.jitted else nullcontext():
                results = program(*numbers)
        self.has_been_called = True
        return results

    def traced(self, *leaves: Any) -> tuple:
        """The results' leaves, from tracers."""
        return self._run(*leaves)

    def within(self, *leaves: Any) -> Sequence:
        """The results' leaves within another program: by one operation, where that is possible."""
        # Without a key there is user code in it, which may hold on to values that are traced around it.
        key = self._key_now() if len(self._what) > 1 else None
        return self.jitted(*leaves) if key is None else self._as_call(key)(*leaves)

    def mapped(self, axes: tuple[int | None, ...], n: int) -> CachedCall:
        """The operation of n at once, those arrays stacked whose axis is not None."""

        def made() -> CompiledProgram:
            function, structure, leaves, maps = self.made_from
            # Axes belong to arrays alone; other leaves are the same for all.
            left = iter(axes)
            stacked = tuple(leaf.stacked(n, next(left)) if isinstance(leaf, ArrayKind) else leaf for leaf in leaves)
            what = self._what[-1], self._what[-1]
            made_from = function, structure, stacked, (*maps, axes)
            # No options: they are chosen for one run.
            return CompiledProgram(made_from, jax.vmap(self._run, axes), self._returned, what, lambda: {})

        entry = self._many.get((axes, n), made)
        return entry._as_call(entry._key_now())

    def _as_call(self, key: str | None) -> CachedCall:
        # A constant of the package that was changed by hand gives another key: the call of before is not used then.
        call = self._call
        if call is None or call.key != key:
            call = self._call = CachedCall(self, key)
        return call

    @property
    def program(self) -> Any:
        """The program for numbers: loaded, or compiled and written, at its first use."""
        # With the lock: a second thread waits for the program instead of compiling it, too.
        with self._lock, gc_paused():
            if self._program is None:
                self._program = self._loaded() or self._compiled()
        return self._program

    @property
    def compiled(self) -> Any:
        """The program for threads that share it."""
        # A `jax.jit` compiles at its first call, and so in each thread that calls it before it is done.
        program = self.program
        with self._lock:
            if self._program is self.jitted:
                with gc_paused():
                    self._program = program.lower(*self.examples).compile()
            return self._program

    @property
    def shapes(self) -> list:
        """What is computed, as shapes and types."""
        # A file holds the shapes, and to load it takes less than to trace.
        with self._lock:
            if self._program is None:
                self._program = self._loaded()
        if self._shapes is None:
            self._shapes = list(jax.eval_shape(self.jitted, *self.examples))
        return self._shapes

    @cached_property
    def _key(self) -> str | None:
        return self._key_now()

    def _key_now(self) -> str | None:
        return disk_cache.key_for(*self.made_from, folders.kind_of_processor(), settings.extra_blobs().is_available())

    @property
    def examples(self) -> list:
        """The arrays that it takes, as shapes and types."""
        _, _, leaves, _ = self.made_from
        return [leaf.example for leaf in leaves if isinstance(leaf, ArrayKind)]

    def _loaded(self) -> Any:
        """The program that another process has left; None where there is none."""
        entry = disk_cache.load(self._key)
        if entry is None:
            return None
        try:
            content, blobs, shapes, static = entry
            if b"lapack_" in content:  # names of functions are in it as text
                private.register_lapack()
            # Of JAX's own: the arguments in a tuple, none by name, and the results in a tuple.
            trees = jax.tree.structure((tuple(self.examples), {})), jax.tree.structure(tuple(shapes))
            settings.extra_blobs().load(blobs)
            program = serialize_executable.deserialize_and_load(content, *trees)
        except Exception:  # whatever is wrong with it: it is compiled again
            return None
        self.static, self._shapes = static, shapes
        return program

    def _compiled(self) -> Any:
        """The program, compiled and written; where it must not be written, one that JAX compiles when it is called."""
        if self._key is None:
            # JAX compiles it at its first call. Options are taken here only.
            options = self._options()
            return _compiled(self.jitted.lower(*self.examples), options) if options else self.jitted
        # Named by the key, so that JAX's own cache has it only where our file of it has been lost. A program that JAX
        # has loaded from there cannot be written again: it would lack functions, and fail when it runs. Then it is
        # compiled once more, under a name that JAX cannot have met.
        for part in (self._key, uuid4().hex):
            with disk_cache.record_warnings() as has_warned, settings.extra_blobs().record() as lowered_blobs:
                traced = _jitted(self._run, f"{self.name}_{part[:12]}").trace(*self.examples)
                lowered = traced.lower()
            with private.found_by_jax() as was_found:
                program = _compiled(lowered, self._options())
            blobs = lowered_blobs()
            may_be_written = not has_warned() and not calls_python(traced.jaxpr.jaxpr)
            if not may_be_written or not was_found():
                break
        # Only where JAX says for certain that it was compiled here; None is no answer, and nothing is written then.
        if may_be_written and was_found() is False:
            self._keep(program, blobs, traced.out_info)
        return program

    def _keep(self, program: Any, blobs: dict[str, bytes], shapes: Any) -> None:
        with suppress(ValueError, NotImplementedError):  # JAX cannot write it
            content, *_ = serialize_executable.serialize(program)
            disk_cache.save(self._key, (content, blobs, jax.tree.leaves(shapes), self.static))

    @property
    def static(self) -> Any:
        """What the function returns besides arrays, and where these stand in it, as it can be written to disk."""
        tree, others = self._returned.parts
        # A structure of JAX cannot be pickled where classes of equinox are in it; a tree of numbers can.
        return jax.tree.unflatten(tree, range(tree.num_leaves)), others

    @static.setter
    def static(self, value: Any) -> None:
        example, others = value
        self._returned.parts = jax.tree.structure(example), others

    def clear(self) -> None:
        """Free what was compiled."""
        # Of this function alone; `jax.clear_caches` would free the programs of the user as well.
        self.jitted.clear_cache()
        self._program = self._call = None
        self._many.clear()

    def results(self, leaves: Sequence) -> Any:
        """What the function returned, from the leaves that were computed."""
        return self._returned.put_together(leaves)


class _Place:
    """Where a computed leaf stands among the results."""

    __slots__ = ("i",)

    def __init__(self, i: int):
        self.i = i


class _Returned:
    """What a function returns, known once it was traced; the same where it is mapped over many arguments.

    Attributes:
        parts: the tree of its arrays, and a tree of all that is none.
    """

    def __init__(self) -> None:
        self.parts: Any = None
        self._whole: Any = None

    def put_together(self, leaves: Sequence) -> Any:
        """What the function returned, from the leaves that were computed."""
        # Both trees are joined once, with places in place of arrays; after that a call puts leaves in their places.
        if self._whole is None or self._whole[0] is not self.parts:
            tree, others = self.parts
            places = jax.tree.unflatten(tree, [_Place(i) for i in range(tree.num_leaves)])
            self._whole = self.parts, *jax.tree.flatten(eqx.combine(places, others))
        _, whole, tree = self._whole
        return jax.tree.unflatten(tree, [leaves[part.i] if type(part) is _Place else part for part in whole])


def _jitted(run: Callable, name: str) -> Any:
    """A function, compiled under a name."""

    # A function of its own each time: JAX finds traces by the function, and would keep them beyond the eviction.
    def named(*leaves: Any) -> Any:
        return run(*leaves)

    named.__name__ = named.__qualname__ = name
    return jax.jit(named)


def _compiled(lowered: Any, options: Mapping[str, Any]) -> Any:
    try:
        return lowered.compile(compiler_options=dict(options) or None)
    except jax.errors.JaxRuntimeError:
        if not options:
            raise
        return lowered.compile()  # a version of XLA that does not know them; what else is wrong is raised again

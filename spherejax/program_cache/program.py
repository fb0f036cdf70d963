"""One compiled function: for numbers, kept on disk for the next process, and within other programs."""

import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from functools import cache, cached_property
from typing import Any
from uuid import uuid4

import equinox as eqx
import jax
import jax.monitoring
from jax.experimental import serialize_executable

from spherejax.program_cache import disk_cache, settings
from spherejax.program_cache.call import Operation
from spherejax.program_cache.garbage import gc_paused
from spherejax.program_cache.jaxprs import calls_python, make_lapack_known
from spherejax.program_cache.several_devices import gathered

N_PROGRAMS = int(os.environ.get("SPHEREJAX_PROGRAMS", "24"))
"""Programs of one function that are kept: of a mechanism such as the four-bar about half a gigabyte.

A study that goes round more lengths of records, or mechanisms, than this compiles them again each time: set the
environment variable `SPHEREJAX_PROGRAMS` to more before the import, or to less where memory is short."""


Options = Mapping[str, Any] | Callable[..., Mapping[str, Any]]
"""Options of XLA, or a function from the arguments of a call to them."""


class _Place:
    """Where a computed leaf stands among the results."""

    __slots__ = ("i",)

    def __init__(self, i: int):
        self.i = i


class KeptProgram:
    """One program: a `jax.jit` of its own, so that it can be let go alone.

    Only leaves go in and out of it. JAX remembers trees of arguments and results for ever, with all that is static in
    them.

    Attributes:
        jitted: the program as it is traced; for use inside another one.
        key: by what it is told.
        made_from: the function, what is static in its arguments, their tree, shapes and types, and the axes over which
            it is mapped.
        has_been_called: whether it was compiled here, by its first call.
        name: under which it is compiled.
    """

    def __init__(
        self, made_from: tuple, run: Callable, said: "_Said", what: tuple[str, ...], options: Callable[[], Mapping]
    ):
        self.key: Any = None
        self.has_been_called = False
        self.name: str = getattr(made_from[0], "__name__", "program")
        self.jitted: Any = _jitted(run, self.name)
        self.made_from = made_from
        self._run, self._said, self._what, self._options = run, said, what, options
        self._program: Any = None
        self._shapes: list | None = None
        self._operation: Operation | None = None
        self._many: OrderedDict[tuple, KeptProgram] = OrderedDict()
        self._lock = threading.Lock()

    @classmethod
    def of(cls, function: Callable, rest: Any, tree: Any, kinds: tuple, what: tuple[str, ...], options: Options):
        """The program of a function, from what is static in its arguments."""
        said = _Said()

        def run(*leaves: Any) -> Any:
            positional, named = eqx.combine(jax.tree.unflatten(tree, leaves), rest)
            with settings.current().tracing():
                arrays, static = eqx.partition(function(*positional, **named), eqx.is_array)
            found, found_tree = jax.tree.flatten(arrays)
            said.results = (found_tree, static)
            return tuple(found)

        def chosen() -> Mapping[str, Any]:
            return options(*rest[0], **rest[1]) if callable(options) else options

        return cls((function, rest, tree, kinds, ()), run, said, what, chosen)

    def now(self, *leaves: Any) -> Sequence:
        """The results' leaves, from numbers; who has to wait for a compiler is told."""
        leaves = tuple(gathered(leaves))
        if jax.config.values["jax_disable_jit"]:  # compiled ones refuse it
            return self._run(*leaves)
        if self.has_been_called:
            return self.program(*leaves)
        with settings.current().compiling(self._what[0], self.name):
            program = self.program
            # JAX traces and compiles what is not kept at this call.
            with gc_paused() if program is self.jitted else nullcontext():
                found = program(*leaves)
        self.has_been_called = True
        return found

    def traced(self, *leaves: Any) -> tuple:
        """The results' leaves, from tracers."""
        return self._run(*leaves)

    def within(self, *leaves: Any) -> Sequence:
        """The results' leaves within another program: by one operation, where that can be."""
        key = self._key_now() if len(self._what) > 1 else None
        return self.jitted(*leaves) if key is None else self._as_operation(key)(*leaves)

    def mapped(self, axes: tuple[int | None, ...], n: int) -> Operation:
        """The operation of many at once."""
        function, rest, tree, kinds, maps = self.made_from
        with self._lock:
            entry = self._many.get((axes, n))
            if entry is None:
                stacked = tuple(
                    kind if axis is None else ((n, *kind[0]), *kind[1:]) for kind, axis in zip(kinds, axes, strict=True)
                )
                made_from = function, rest, tree, stacked, (*maps, axes)
                what = self._what[-1], self._what[-1]
                entry = KeptProgram(made_from, jax.vmap(self._run, axes), self._said, what, lambda: {})
                self._many[axes, n] = entry
            self._many.move_to_end((axes, n))
            while len(self._many) > N_PROGRAMS:
                self._many.popitem(last=False)[1].clear()
        return entry._as_operation(entry._key_now())

    def _as_operation(self, key: str | None) -> Operation:
        operation = self._operation
        if operation is None or operation.key != key:
            operation = self._operation = Operation(self, key)
        return operation

    @property
    def program(self) -> Any:
        """The program for numbers: loaded, or compiled and kept, at its first use."""
        with self._lock, gc_paused():
            if self._program is None:
                self._program = self._loaded() or self._compiled()
        return self._program

    @property
    def compiled(self) -> Any:
        """The program for threads that share it."""
        program = self.program
        with self._lock:
            if self._program is self.jitted:
                with gc_paused():
                    self._program = program.lower(*self.examples).compile()
            return self._program

    @property
    def shapes(self) -> list:
        """What is computed, as shapes and types."""
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
        return disk_cache.key_for(
            *self.made_from, settings.current().processor(), settings.extra_blobs().is_available()
        )

    @property
    def examples(self) -> list:
        """The arguments, as shapes and types."""
        *_, kinds, _ = self.made_from
        return [jax.ShapeDtypeStruct(shape, dtype, weak_type=weak) for shape, dtype, weak in kinds]

    def _loaded(self) -> Any:
        """The program that another process has left; None where there is none."""
        found = disk_cache.load(self._key)
        if found is None:
            return None
        try:
            content, codes, shapes, static = found
            if b"lapack_" in content:
                make_lapack_known()
            # Of JAX's own: the arguments in a tuple, none by name, and the results in a tuple.
            trees = jax.tree.structure((tuple(self.examples), {})), jax.tree.structure(tuple(shapes))
            settings.extra_blobs().load(codes)
            program = serialize_executable.deserialize_and_load(content, *trees)
        except Exception:  # whatever is wrong with it: it is compiled anew
            return None
        self.static, self._shapes = static, shapes
        return program

    def _compiled(self) -> Any:
        """The program, compiled and kept; where it cannot be kept, one that JAX compiles when it is called."""
        if self._key is None:
            # JAX compiles it at its first call, except with options, which it takes here only.
            options = self._options()
            return _compiled(self.jitted.lower(*self.examples), options) if options else self.jitted
        # Named by the key, so that JAX's own cache knows it only where our file of it has been lost. What JAX has
        # loaded from there cannot be written again: it would lack functions, and fail when it runs.
        for part in (self._key, uuid4().hex):
            with disk_cache.listened() as has_warned, settings.extra_blobs().record() as lowered_codes:
                traced = _jitted(self._run, f"{self.name}_{part[:12]}").trace(*self.examples)
                lowered = traced.lower()
            with found_by_jax() as found:
                program = _compiled(lowered, self._options())
            codes = lowered_codes()
            may_be_kept = not has_warned() and not calls_python(traced.jaxpr.jaxpr)
            if not may_be_kept or not found():
                break
        if may_be_kept and found() is False:
            self._keep(program, codes, traced.out_info)
        return program

    def _keep(self, program: Any, codes: dict[str, bytes], shapes: Any) -> None:
        with suppress(ValueError, NotImplementedError):  # JAX cannot write it
            content, *_ = serialize_executable.serialize(program)
            disk_cache.save(self._key, (content, codes, jax.tree.leaves(shapes), self.static))

    @property
    def static(self) -> Any:
        """What the function returns besides arrays, and where these stand in it, as it can be kept."""
        tree, static = self._said.results
        return jax.tree.unflatten(tree, range(tree.num_leaves)), static

    @static.setter
    def static(self, value: Any) -> None:
        example, static = value
        self._said.results = jax.tree.structure(example), static

    def clear(self) -> None:
        """Let go of what was compiled."""
        self.jitted.clear_cache()
        self._program = self._operation = None
        for entry in self._many.values():
            entry.clear()
        self._many.clear()

    def results(self, leaves: Sequence) -> Any:
        """What the function returned, from the leaves that were computed."""
        return self._said.put_together(leaves)


class _Said:
    """What a function returns, known once it was traced; the same where it is mapped over many arguments.

    Attributes:
        results: the tree of its arrays, and all that is none.
    """

    def __init__(self) -> None:
        self.results: Any = None
        self._whole: Any = None

    def put_together(self, leaves: Sequence) -> Any:
        """What the function returned, from the leaves that were computed."""
        if self._whole is None or self._whole[0] is not self.results:
            tree, static = self.results
            places = jax.tree.unflatten(tree, [_Place(i) for i in range(tree.num_leaves)])
            self._whole = self.results, *jax.tree.flatten(eqx.combine(places, static))
        _, parts, tree = self._whole
        return jax.tree.unflatten(tree, [leaves[part.i] if type(part) is _Place else part for part in parts])


def _jitted(run: Callable, name: str) -> Any:
    """A function, compiled under a name."""

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


@contextmanager
def found_by_jax() -> Iterator[Callable[[], bool | None]]:
    """A function that says whether what is compiled in the context was loaded from JAX's cache; None where JAX does not
    say, for it has been told not to keep it, or uses other words."""
    _listen()
    _compiling.was_found = None if jax.config.values["jax_compilation_cache_dir"] else False
    yield lambda: _compiling.was_found


_compiling = threading.local()


@cache
def _listen() -> None:
    jax.monitoring.register_event_listener(_heard)


def _heard(event: str, **_: Any) -> None:
    if event in ("/jax/compilation_cache/cache_hits", "/jax/compilation_cache/cache_misses"):
        _compiling.was_found = event.endswith("hits")

"""`eqx.filter_jit` with a bound: a program that has not been used for long is let go, and its memory with it.

JAX keeps what it has compiled for as long as the process lives: 15 to 30 MB for a program of a four-bar, for each
structure, each builder, each number of samples where that matters. A study that varies them grows until it is killed.

What was compiled is kept on disk too (`kept_on_disk`): another process neither traces nor compiles it again.
"""

import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from functools import cache, cached_property, partial, update_wrapper
from types import MappingProxyType
from typing import Any
from uuid import uuid4

import equinox as eqx
import jax
import jax.core
import jax.monitoring
from jax.experimental import serialize_executable
from jax.extend import core as jex

from spherejax import runtime
from spherejax.foundations.checks import exits_as_errors
from spherejax.foundations.kept import kept_on_disk
from spherejax.foundations.kept.collecting import collecting_later
from spherejax.foundations.machine import code as machine_code
from spherejax.foundations.terminals import waiting_for

N_PROGRAMS = int(os.environ.get("SPHEREJAX_PROGRAMS", "24"))
"""Programs of one function that are kept: of a mechanism such as the four-bar about half a gigabyte.

A study that goes round more lengths of records, or mechanisms, than this compiles them again each time: set the
environment variable `SPHEREJAX_PROGRAMS` to more before the import, or to less where memory is short."""


Options = Mapping[str, Any] | Callable[..., Mapping[str, Any]]
"""Options of XLA, or a function from the arguments of a call to them."""


class _Key:
    """By what a program is told; its hash is computed once."""

    __slots__ = ("_hash", "parts")

    def __init__(self, *parts: Hashable):
        self.parts, self._hash = parts, hash(parts)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, _Key) and self.parts == other.parts)


class _Place:
    """Where a computed leaf stands among the results."""

    __slots__ = ("i",)

    def __init__(self, i: int):
        self.i = i


class _Entry:
    """One program: a `jax.jit` of its own, so that it can be let go alone.

    Only leaves go in and out of it. JAX remembers trees of arguments and results for ever, with all that is static in
    them.

    Attributes:
        jitted: the program as it is traced; for use inside another one.
        key: by what it is told.
        has_been_called: whether it was compiled here, by its first call.
        name: under which it is compiled.
    """

    def __init__(self, function: Callable, rest: Any, tree: Any, kinds: tuple, options: Mapping[str, Any]):
        self.key: Any = None
        self.has_been_called = False
        self.name: str = getattr(function, "__name__", "program")
        self._results: Any = None
        self._whole: Any = None
        self._program: Any = None
        self._shapes: list | None = None
        self._made_from = function, rest, tree, kinds
        self._options = options
        self._lock = threading.Lock()

        def run(*leaves: Any) -> Any:
            positional, named = eqx.combine(jax.tree.unflatten(tree, leaves), rest)
            with exits_as_errors():
                arrays, static = eqx.partition(function(*positional, **named), eqx.is_array)
            found, found_tree = jax.tree.flatten(arrays)
            self._results = (found_tree, static)
            return tuple(found)

        self._run = run
        self.jitted: Any = _jitted(run, self.name)

    @property
    def program(self) -> Any:
        """The program for numbers: loaded, or compiled and kept, at its first use."""
        with self._lock, collecting_later():
            if self._program is None:
                self._program = self._loaded() or self._compiled()
        return self._program

    @property
    def compiled(self) -> Any:
        """The program for threads that share it."""
        program = self.program
        with self._lock:
            if self._program is self.jitted:
                with collecting_later():
                    self._program = program.lower(*self._examples).compile()
            return self._program

    @property
    def shapes(self) -> list:
        """What is computed, as shapes and types."""
        with self._lock:
            if self._program is None:
                self._program = self._loaded()
        if self._shapes is None:
            self._shapes = list(jax.eval_shape(self.jitted, *self._examples))
        return self._shapes

    @cached_property
    def _key(self) -> str | None:
        return kept_on_disk.key_for(*self._made_from, runtime.kind_of_processor(), machine_code.is_available())

    @property
    def _examples(self) -> list:
        *_, kinds = self._made_from
        return [jax.ShapeDtypeStruct(shape, dtype, weak_type=weak) for shape, dtype, weak in kinds]

    def _loaded(self) -> Any:
        """The program that another process has left; None where there is none."""
        found = kept_on_disk.load(self._key)
        if found is None:
            return None
        content, codes, shapes, (example, static) = found
        if b"lapack_" in content:
            make_lapack_known()
        # Of JAX's own: the arguments in a tuple, none by name, and the results in a tuple.
        trees = jax.tree.structure((tuple(self._examples), {})), jax.tree.structure(tuple(shapes))
        try:
            machine_code.make_known(codes)
            program = serialize_executable.deserialize_and_load(content, *trees)
        except Exception:  # whatever is wrong with it: it is compiled anew
            return None
        self._results, self._shapes = (jax.tree.structure(example), static), shapes
        return program

    def _compiled(self) -> Any:
        """The program, compiled and kept; where it cannot be kept, one that JAX compiles when it is called."""
        if self._key is None:
            # JAX compiles it at its first call, except with options, which it takes here only.
            return _compiled(self.jitted.lower(*self._examples), self._options) if self._options else self.jitted
        # Named by the key, so that JAX's own cache knows it only where our file of it has been lost. What JAX has
        # loaded from there cannot be written again: it would lack functions, and fail when it runs.
        for part in (self._key, uuid4().hex):
            with kept_on_disk.listened() as has_warned, machine_code.listened() as lowered_codes:
                traced = _jitted(self._run, f"{self.name}_{part[:12]}").trace(*self._examples)
                lowered = traced.lower()
            with found_by_jax() as found:
                program = _compiled(lowered, self._options)
            codes = lowered_codes()
            may_be_kept = not has_warned() and not calls_python(traced.jaxpr.jaxpr)
            if not may_be_kept or not found():
                break
        if may_be_kept and found() is False:
            self._keep(program, codes, traced.out_info)
        return program

    def _keep(self, program: Any, codes: dict[str, bytes], shapes: Any) -> None:
        found_tree, static = self._results
        example = jax.tree.unflatten(found_tree, range(found_tree.num_leaves))
        with suppress(ValueError, NotImplementedError):  # JAX cannot write it
            content, *_ = serialize_executable.serialize(program)
            kept_on_disk.save(self._key, (content, codes, jax.tree.leaves(shapes), (example, static)))

    def clear(self) -> None:
        """Let go of what was compiled."""
        self.jitted.clear_cache()
        self._program = None

    def results(self, leaves: Sequence) -> Any:
        """What the function returned, from the leaves that were computed."""
        if self._whole is None or self._whole[0] is not self._results:
            tree, static = self._results
            places = jax.tree.unflatten(tree, [_Place(i) for i in range(tree.num_leaves)])
            self._whole = self._results, *jax.tree.flatten(eqx.combine(places, static))
        _, parts, tree = self._whole
        return jax.tree.unflatten(tree, [leaves[part.i] if type(part) is _Place else part for part in parts])


@cache
def make_lapack_known() -> None:
    """JAX looks LAPACK's functions up (in SciPy) when it lowers the first program that calls one.

    A process that only loads such a program calls nothing at all: a segmentation fault (jaxlib 0.10.2).
    """
    jax.jit(jax.numpy.linalg.inv).lower(jax.ShapeDtypeStruct((2, 2), jax.numpy.float64))


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


def calls_python(jaxpr: Any) -> bool:
    """Whether a traced program calls Python when it runs, as no other process could."""
    return any(
        "callback" in equation.primitive.name or any(map(calls_python, _programs_in(equation.params.values())))
        for equation in jaxpr.eqns
    )


def _programs_in(parameters: Iterable) -> Iterator[Any]:
    """Those within an operation: the branches of a condition, the body of a loop."""
    for value in parameters:
        if isinstance(value, tuple | list):
            yield from _programs_in(value)
        elif isinstance(value, jex.ClosedJaxpr | jex.Jaxpr):
            yield value.jaxpr if isinstance(value, jex.ClosedJaxpr) else value


class BoundedJit:
    """A compiled function; see `bounded_jit`."""

    def __init__(self, function: Callable, n_programs: int, what: str, options: Options):
        self._function, self._n_programs, self._what, self._options = function, n_programs, what, options
        self._entries: OrderedDict[Hashable, _Entry] = OrderedDict()
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

    def _called(self, entry: _Entry, leaves: list) -> Any:
        if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            with collecting_later():
                return entry.results(entry.jitted(*leaves))
        if entry.has_been_called:
            return entry.results(entry.program(*leaves))
        with waiting_for(self._what, entry.name):
            program = entry.program
            # JAX traces and compiles what is not kept at this call.
            with collecting_later() if program is entry.jitted else nullcontext():
                found = program(*leaves)
        entry.has_been_called = True
        return entry.results(found)

    def compiled(self, *arguments: Any) -> Callable:
        """The program for arguments like these, compiled now: threads that share it do not compile it again."""
        entry, _ = self._entry_for(arguments, {})
        with waiting_for(self._what, entry.name):
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

    def _entry_for(self, arguments: tuple, named: dict) -> tuple[_Entry, list]:
        key, make, leaves = self._key_for(arguments, named)
        return self._kept(key, make), leaves

    def _key_for(self, arguments: tuple, named: dict) -> tuple[_Key, Callable[[], _Entry], list]:
        """By what the program for these arguments is told, how it is made, and what it takes."""
        arrays, rest = eqx.partition((arguments, named), eqx.is_array)
        leaves, tree = jax.tree.flatten(arrays)
        static, static_tree = jax.tree.flatten(rest)
        kinds = tuple((leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)) for leaf in leaves)
        key = _Key(static_tree, tuple(static), tree, kinds)

        def made() -> _Entry:
            options = self._options(*arguments, **named) if callable(self._options) else self._options
            return _Entry(self._function, rest, tree, kinds, options)

        return key, made, leaves

    def _kept(self, key: _Key, make: Callable[[], _Entry]) -> _Entry:
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


def bounded_jit(
    function: Callable | None = None,
    *,
    n_programs: int = N_PROGRAMS,
    what: str = "",
    options: Options = MappingProxyType({}),
) -> Any:
    """Compile a function: arrays are traced, all else is static, as `eqx.filter_jit` does.

    Args:
        function: its arguments are arrays, hashable values, and pytrees of both.

    Other args:
        n_programs: how many programs are kept; the one that was used longest ago goes first, and is compiled again when
            it is asked for again.
        what: what whoever waits is told to wait for, e.g. `"a run"`; by default the name of the function.
        options: of XLA, or a function that says them for the arguments of a call.
    """
    if function is None:
        return partial(bounded_jit, n_programs=n_programs, what=what, options=options)
    return BoundedJit(function, n_programs, what or getattr(function, "__name__", "a program"), options)


def inlined(function: Callable) -> Callable:
    """A compiled function as what it was before, for use inside another one.

    Programs are then kept by the outer function alone: `diffrax.diffeqsolve` keeps its own trace of each, 12 MB for a
    four-bar, for as long as the process lives.
    """
    return getattr(function, "__wrapped__", function)

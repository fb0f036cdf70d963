"""Fingerprints: short texts that are equal for what computes the same, in other processes too.

A traced program is identified by its operations and constants, not by how it was written: renaming, comments and moving
code about leave its fingerprint as it is, and a changed number anywhere, in helpers too, does not. Functions that are
not traced (a force in a scene, a callback on the host) are identified by their bytecode, defaults, closures, and what
they look up in their modules. Addresses and the order of sets are left out, since they differ between processes.
"""

import argparse
import array
import dataclasses
import enum
import functools
import hashlib
import re
import types
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax.extend import core as jex

from spherejax.program_cache import settings
from spherejax.program_cache.installed import is_in_package, is_installed, is_versioned, module_of, top_level
from spherejax.program_cache.lookups import assigned_in, used_globals, used_of_modules

NOT_COMPUTED = frozenset({
    "name", "debug_info", "ctx_mesh",
    "jvp_jaxpr_fun", "fwd_jaxpr_thunk", "fwd", "bwd", "out_trees", "call", "jvp", "transpose_rule",
})  # fmt: skip
"""Parameters of operations that say nothing about the value: names, and rules of derivatives, which are functions that
JAX makes anew in each trace. Where derivatives are wanted, trace them."""

MOST = 10_000
"""Functions and classes that are read for one fingerprint; user code of some size has fewer.

Beyond that, what is read is no user code but a library that nobody has installed."""

_STATELESS = (
    type(None), bool, int, float, complex, str, bytes, tuple, type, types.ModuleType, types.FunctionType,
    types.BuiltinFunctionType, functools.partial, property, staticmethod, classmethod,
)  # fmt: skip
"""What does not change by being used."""


_CONTAINERS = (list, dict, set, deque, np.ndarray)
"""What is changed by writing into it."""

_NAMESPACES = (types.SimpleNamespace, argparse.Namespace)
"""Classes of Python's own whose objects hold a user's settings."""


class Traced(NamedTuple):
    """What a function computes.

    Attributes:
        fingerprint: the same for functions that compute the same.
        is_bound: whether equal code may stand for different objects: it calls Python when it runs
            (`jax.pure_callback`), or closes over a traced value.
    """

    fingerprint: str
    is_bound: bool


@dataclasses.dataclass(frozen=True)
class TracedFunction:
    """A function that equals others by what it computes.

    Python compares functions by their addresses, so that an equal lambda, or a notebook cell that is run again, would
    be compiled again, and both programs kept.

    Attributes:
        function: the function itself.
        fingerprint: of what it computes.
        itself: the function again where equal code may stand for different objects; None otherwise.
        is_all: whether the fingerprint identifies all of it, in other processes too: no user code is left that has not
            been traced.
    """

    function: Callable = dataclasses.field(compare=False)
    fingerprint: str
    itself: Callable | None = None
    is_all: bool = True

    @classmethod
    def of(cls, function: Callable, traced: Traced, is_all: bool = True) -> "TracedFunction":
        """A function with what is known of its trace."""
        return cls(function, traced.fingerprint, function if traced.is_bound else None, is_all)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """What the function returns."""
        return self.function(*arguments, **named)

    def __cache_key__(self) -> Any:
        """What stands for the function in a fingerprint: its own one, where that identifies all of it."""
        return self.fingerprint if self.itself is None and self.is_all else self.function


def program_fingerprint(function: Callable, *examples: Any) -> Traced:
    """What a function computes from arrays.

    Args:
        function: pure JAX code.
        *examples: arrays or `jax.ShapeDtypeStruct`s, in any pytrees; only shapes and types matter.
    """
    # A function of its own each time: JAX would return an earlier trace, and what a module held then.
    closed, shapes = jax.make_jaxpr(lambda *arguments: function(*arguments), return_shape=True)(*examples)
    reader = _Reader(_Mode.WHOLE)
    reader.program(closed.jaxpr, closed.consts)
    reader.value([(leaf.shape, str(leaf.dtype)) for leaf in jax.tree.leaves(shapes)])
    # The fingerprint first: reading to the end may meet what makes it bound.
    fingerprint = reader.fingerprint
    return Traced(fingerprint, reader.is_bound)


def value_fingerprint(value: Any) -> str:
    """What a Python value is: numbers, containers, objects by their fields, functions and classes by their code."""
    reader = _Reader(_Mode.WHOLE)
    reader.value(value)
    return reader.fingerprint


def known_fingerprint(value: Any) -> str | None:
    """The fingerprint of a value in which version numbers identify all code; None for a value with user code in it.

    User code is not read here: it may be large, and may be anything.
    """
    reader = _Reader(_Mode.VERSIONED)
    try:
        reader.value(value)
        fingerprint = reader.fingerprint
    except (_UserCodeError, RecursionError):  # the latter in a text that an object makes of itself
        return None
    return None if reader.is_bound else fingerprint


def own_parts(value: Any) -> tuple:
    """The user code in a value: classes, functions and objects that no version number identifies."""
    reader = _Reader(_Mode.COLLECTING)
    reader.value(value)
    reader.finish()
    return tuple(reader.user_code.values())


def code_fingerprint(parts: tuple, *, with_state: bool = True) -> str:
    """What user code is now, with all that it looks up, but for names that it assigns to itself.

    Args:
        parts: classes, functions and objects, as `own_parts` finds them.
        with_state: with lists, arrays and objects that it looks up; else with functions, classes and numbers alone.
    """
    reader = _Reader(_Mode.CODE if with_state else _Mode.CODE_ALONE)
    reader.value(parts)
    return reader.fingerprint


def reaches_tracer(parts: tuple) -> bool:
    """Whether user code looks up a value that JAX traces, in its closures, globals, classes or objects.

    Args:
        parts: classes, functions and objects, as `own_parts` finds them.
    """
    reader = _Reader(_Mode.CODE)
    with suppress(Exception):  # what code looks up may be anything, and fail when it is read
        reader.value(parts)
        reader.finish()
    return reader.is_traced


def combined(*fingerprints: str) -> str:
    """One fingerprint of several."""
    # No fingerprint holds a zero byte, so that no two lists give the same text.
    return hashlib.sha256("\0".join(fingerprints).encode()).hexdigest()[:32]


class _UserCodeError(Exception):
    """Something that no version number identifies."""


class _Mode(enum.Enum):
    """What is done with user code, and with what it looks up."""

    WHOLE = enum.auto()  # read like everything else
    VERSIONED = enum.auto()  # refused
    COLLECTING = enum.auto()  # collected, and not read
    CODE = enum.auto()  # read, with what it looks up in modules, and without what it assigns to
    CODE_ALONE = enum.auto()  # the same, without lists, arrays and objects that it looks up


class _Reader:
    """Reads a value into a hash, word after word.

    An object within another one is hashed as a number, and read when the one around it is finished. So the depth of
    calls is that of one object's own parts, however deep objects lie in each other, and however long a chain of
    functions is that look each other up; and an object that refers to itself comes to an end.

    Attributes:
        is_bound: whether something was met that is only equal to itself: a traced value, or a call of Python.
        is_traced: whether a traced value was met.
        user_code: the user code that was met, by address, where it is collected.
    """

    def __init__(self, mode: _Mode):
        self.is_bound = self.is_traced = False
        self.user_code: dict[int, Any] = {}
        self._mode, self._reads_lookups = mode, mode in (_Mode.CODE, _Mode.CODE_ALONE)
        self._hash = hashlib.sha256()
        # With the objects themselves: the address of one that is freed would be given to another.
        self._met: dict[int, tuple[int, Any]] = {}
        self._waiting: deque[Any] = deque()
        self._n_read = 0
        self._around: frozenset[int] = frozenset()  # sets in which this is a part

    @property
    def fingerprint(self) -> str:
        self.finish()
        return self._hash.hexdigest()[:32]  # 128 bits: no two of a user's programs will ever agree by chance

    def finish(self) -> None:
        """Read all objects that were met."""
        while self._waiting:
            self._composed(self._waiting.popleft())

    def _skips(self, is_users: bool, value: Any) -> bool:
        """Note user code, and refuse it where that is asked; whether it is to be left unread."""
        if is_users and self._mode is _Mode.VERSIONED:
            raise _UserCodeError
        if is_users and self._mode is _Mode.COLLECTING:
            self.user_code[id(value)] = value
        return is_users and self._mode is _Mode.COLLECTING

    def word(self, *words: object) -> None:
        for word in words:
            text = str(word).encode()
            # With its length: "ab", "c" is not "a", "bc".
            self._hash.update(len(text).to_bytes(8, "big") + text)

    # Programs -------------------------------------------------------------------------------------------------------

    def program(self, jaxpr: Any, constants: Any) -> None:
        # Variables by the order in which they appear: their names and addresses differ from trace to trace.
        number: dict[Any, int] = {}

        def read(atom: Any) -> None:
            if isinstance(atom, jex.Literal):
                self.word("literal", atom.aval)
                self.array(atom.val)
            else:
                self.word(number[atom])

        for variable in (*jaxpr.constvars, *jaxpr.invars):
            self.word(number.setdefault(variable, len(number)), variable.aval)
        for constant in constants:
            self.array(constant)
        for equation in jaxpr.eqns:
            self.word("equation", equation.primitive.name)
            # A callback computes what its Python function returns, which may depend on anything.
            self.is_bound |= "callback" in equation.primitive.name
            for atom in equation.invars:
                read(atom)
            for key in sorted(set(equation.params) - NOT_COMPUTED):
                self.word(key)
                self.value(equation.params[key])
            for variable in equation.outvars:
                self.word(number.setdefault(variable, len(number)), variable.aval)
        for atom in jaxpr.outvars:
            read(atom)

    def array(self, value: Any) -> None:
        if isinstance(value, jax.core.Tracer):
            # A constant of a trace around this one: its kind is known, its numbers are not.
            self.is_bound = self.is_traced = True
            self.word("traced", value.aval)
            return
        # The type and the shape as well: the same bytes are other numbers to another type.
        if hasattr(value, "dtype") and jnp.issubdtype(value.dtype, jax.dtypes.extended):
            with jax.ensure_compile_time_eval():  # within a transformation it is a constant all the same
                value = jax.random.key_data(value)  # NumPy has no arrays of keys
        array = np.asarray(value)
        self.word("array", array.dtype, array.shape)
        self._hash.update(np.ascontiguousarray(array).tobytes())

    # Values ---------------------------------------------------------------------------------------------------------

    def value(self, value: Any) -> None:
        if value is None or isinstance(value, bool | int | float | complex | str | bytes | np.dtype):
            # The text of a number is exact, and tells -0.0 from 0.0; the type tells 1 from True.
            self.word(type(value).__name__, repr(value))
        elif isinstance(value, jex.ClosedJaxpr):
            self.program(value.jaxpr, value.consts)
        elif isinstance(value, jex.Jaxpr):
            self.program(value, ())
        elif isinstance(value, jax.ShapeDtypeStruct):
            self.word("shape", value.shape, value.dtype)
        elif isinstance(value, jax.Array) or (isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject):
            self.array(value)
        elif isinstance(value, enum.Enum):
            self.word(_name_of(type(value)), value.name)
        elif isinstance(value, types.ModuleType):
            self.word("module", value.__name__)
        else:
            if id(value) not in self._met:
                self._met[id(value)] = (len(self._met), value)
                self._waiting.append(value)
            self.word("met", self._met[id(value)][0])

    def _composed(self, value: Any) -> None:
        if self._mode is _Mode.COLLECTING and isinstance(value, _CONTAINERS) and callable(value):
            self.user_code[id(value)] = value  # of a user's own class, which derives from a container
        if isinstance(value, Mapping):
            self.word(type(value).__name__, len(value))
            # In a fixed order: two dictionaries that were filled in another order are equal.
            for key in sorted(value, key=repr):
                self.value(key)
                self.value(value[key])
        elif isinstance(value, set | frozenset):
            around = self._around | {id(value)}
            self.word(type(value).__name__, *sorted(self._alone(part, around) for part in value))
        elif isinstance(value, tuple | list | np.ndarray | deque):
            self.word(type(value).__name__, len(value))
            for part in value:
                self.value(part)
        elif isinstance(value, functools.partial):
            self._partial(value)
        elif isinstance(value, types.MethodType):
            self.value(("method", value.__func__, value.__self__))
        elif isinstance(value, type):
            self._class(value)
        elif isinstance(value, types.FunctionType):
            self._function(value)
        elif isinstance(value, property | staticmethod | classmethod | functools.cached_property):
            self.value([getattr(value, name, None) for name in ("fget", "__func__", "func")])
        elif isinstance(value, jax.tree_util.PyTreeDef):
            self._tree(value)
        elif _is_of_jax(value) and not dataclasses.is_dataclass(value):
            self._text(value)
        else:
            self._object(value)

    def _alone(self, value: Any, around: frozenset[int]) -> str:
        """The fingerprint of a part of a set by itself: sets have another order in each process."""
        reader = _Reader(self._mode)
        reader.user_code, reader._n_read = self.user_code, self._n_read
        # A function in a set may look up that set.
        reader._around, reader._met = around, {address: (-1, None) for address in around}
        reader.value(value)
        fingerprint = reader.fingerprint
        self.is_bound |= reader.is_bound
        self.is_traced |= reader.is_traced
        self._n_read = reader._n_read
        return fingerprint

    def _partial(self, value: functools.partial) -> None:
        arguments = [*value.args, *value.keywords.values()]
        # What is in these changes, while the partial, by which a structure is compared, stays the same object.
        if self._mode is _Mode.COLLECTING and any(isinstance(argument, _CONTAINERS) for argument in arguments):
            self.user_code[id(value)] = value
        self.value(("partial", value.func, len(value.args), tuple(value.keywords)))
        for argument in arguments:
            self._used(argument)

    def _object(self, value: Any) -> None:
        # A dunder name: a method `cache_key` of a user's own class may be about something else.
        if hasattr(type(value), "__cache_key__"):
            self.value((type(value).__name__, value.__cache_key__()))
            return
        wrapped = getattr(value, "__wrapped__", None)
        if callable(wrapped):  # jax.jit, functools.lru_cache and their like
            self.value(("wrapped", type(value).__name__, wrapped))
            return
        self.value(type(value))
        is_installed_kind = is_installed(module_of(type(value)), None) and not isinstance(value, _NAMESPACES)
        if self._reads_lookups and not dataclasses.is_dataclass(value) and is_installed_kind:
            self._installed(value)
            return
        # The object too, not its class alone: its fields may change, while a structure that holds it stays equal. Of a
        # pytree the structure says what it is.
        if not is_versioned(module_of(type(value))) and jax.tree_util.all_leaves([value]):
            self._skips(True, value)
        # Its fields alone: what else a dataclass holds, such as a cached property, was computed from them.
        if dataclasses.is_dataclass(value):
            fields = {field.name: getattr(value, field.name, None) for field in dataclasses.fields(value)}
        else:
            slots = [name for kind in type(value).__mro__ for name in _as_list(getattr(kind, "__slots__", ()))]
            fields = {**{name: getattr(value, name, None) for name in slots}, **getattr(value, "__dict__", {})}
        if self._mode is _Mode.CODE_ALONE and not _is_frozen(value):
            fields = {name: part for name, part in fields.items() if callable(part)}
            self.word("state")
        if fields:
            self.value(fields)
        elif self._mode is not _Mode.CODE_ALONE:
            self._text(value)

    def _installed(self, value: Any) -> None:
        """An object of another library: its numbers where it is an array (`pandas.Series`, `array.array`), and no more.
        To read a logger, a file or a table whole would not come to an end."""
        if hasattr(type(value), "__array__") or isinstance(value, array.array | bytearray):
            with suppress(Exception):  # an `xarray.Dataset` has the method, and raises
                self.value(np.asarray(value))

    def _tree(self, tree: Any) -> None:
        """A structure of JAX, by an example of it: its text would not tell one function in it from another."""
        try:
            example = jax.tree.unflatten(tree, range(tree.num_leaves))
        except Exception:  # a class of a user's that does not take numbers for its leaves
            if not self._skips(True, tree):
                self._text(tree)
            return
        self.value(("tree", tree.num_leaves, example))

    def _text(self, value: Any) -> None:
        text = repr(value)
        without = without_addresses(text)
        # With an address in its text it may be anything, and is only equal to itself: as user code is.
        self._skips(without != text, value)
        self.word(without)

    # Code -----------------------------------------------------------------------------------------------------------

    def _class(self, kind: type) -> None:
        self.word("class", _name_of(kind))
        module = module_of(kind)
        if self._skips(not is_versioned(module), kind) or self._is_named(module, None):
            return
        self._count()
        self.value([base for base in kind.__bases__ if base is not object])
        own = {name: part for name, part in vars(kind).items() if not name.startswith("__") or name == "__call__"}
        own = {name: part for name, part in own.items() if not name.startswith("_abc")}  # tables of `abc.ABC`
        if not self._reads_lookups:
            self.value(own)
            return
        # Each by its name: an attribute that is a list or an object may change while the class is used.
        for name in sorted(own):
            self.word(name)
            self._used(own[name])

    def _function(self, function: types.FunctionType) -> None:
        if self._skips(not is_versioned(function.__module__), function):
            return
        if self._is_named(function.__module__, function.__code__.co_filename):
            self.word("function", _name_of(function))
            if top_level(function.__module__) == settings.current().package:
                # A function that the package makes is the same code each time, with other values around it.
                self._closed_over(function)
            return
        self._count()
        self._code(function.__code__, function.__doc__)
        self._closed_over(function)
        if self._reads_lookups:
            # What a decorator notes of a function (`__wrapped__`) is code; all else may count calls, and is state.
            for name in sorted(function.__dict__):
                self.word(name)
                is_code = callable(function.__dict__[name])
                self._used(function.__dict__[name] if is_code or self._mode is _Mode.CODE else None)
        assigned = assigned_in(function.__code__) if self._reads_lookups else frozenset()
        for name, used in used_of_modules(function) if self._reads_lookups else ():
            self.word(name)
            self._used(used)
        for name, used in used_globals(function):
            self.word(name)
            if name not in assigned:
                self._used(used)

    def _is_named(self, module: str | None, file: str | None) -> bool:
        """Whether the name of code identifies it: that of Python, and of packages.

        Raises:
            _UserCodeError: for a versioned package that is not installed, such as a checkout of JAX, where versions
                shall identify code: it changes, and its version does not. Within a process it stays what it is.
        """
        if is_installed(module, file):
            return True
        if not (is_versioned(module) and is_in_package(module, file)):
            return False
        if self._mode is _Mode.VERSIONED:
            raise _UserCodeError
        return True

    def _count(self) -> None:
        self._n_read += 1
        # An error, not a shorter reading: a fingerprint of half of it would agree with that of another program.
        if self._n_read > MOST:
            raise RuntimeError(f"more than {MOST:,} functions and classes are looked up")

    def _closed_over(self, function: types.FunctionType) -> None:
        self.value([function.__defaults__, function.__kwdefaults__])
        assigned = assigned_in(function.__code__) if self._reads_lookups else frozenset()
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            try:
                if name not in assigned:
                    self._used(cell.cell_contents)
            except ValueError:  # a cell that has not been filled yet
                self.word("empty")

    def _used(self, value: Any) -> None:
        """Something that code looks up."""
        # Arrays of JAX cannot be written into; those of NumPy can, and count as state.
        if self._mode is not _Mode.CODE_ALONE or isinstance(value, (*_STATELESS, jax.Array)):
            self.value(value)
        else:
            self.word("state", _name_of(type(value)))

    def _code(self, code: types.CodeType, doc: str | None) -> None:
        """Operations, constants and names of what is looked up; not the names of variables, lines, or the docstring."""
        self.word("code", code.co_code.hex(), code.co_argcount, code.co_kwonlyargcount, code.co_flags, code.co_names)
        for constant in code.co_consts:
            # Functions within it: their names and lines are not read either, only what they do.
            if isinstance(constant, types.CodeType):
                self._code(constant, None)
            # The docstring is a constant of a function as well, and changes nothing that it computes.
            elif constant != doc or doc is None:
                self.value(constant)


def _is_frozen(value: Any) -> bool:
    """Whether an object is a dataclass that nobody can write into."""
    return dataclasses.is_dataclass(value) and type(value).__dataclass_params__.frozen  # pyright: ignore


def _is_of_jax(value: Any) -> bool:
    return top_level(type(value).__module__) in ("jax", "jaxlib") and not callable(getattr(value, "__wrapped__", None))


def _name_of(value: Any) -> str:
    return f"{value.__module__}.{value.__qualname__}"


def _as_list(slots: Any) -> list[str]:
    return [slots] if isinstance(slots, str) else list(slots)


def without_addresses(text: str) -> str:
    """A text that Python makes of an object, as it is in each process."""
    return re.sub(r" at 0x[0-9a-f]+|id=\d+", "", text)

"""Closure conversion: traced values that a plain Python function closes over become explicit leaves of a pytree.

A user's function of a scene may close over a parameter, `damper=lambda rate: friction * jnp.arctan(100.0 * rate)`.
Within `jax.jit`, `jax.grad`, `jax.vmap` or a sweep `friction` is a tracer. A function is static structure of a scene; a
tracer in static structure cannot be batched or differentiated, and it leaks. So the function is taken apart where it
enters a part: each tracer that it reaches is replaced by a placeholder, and becomes a leaf like any other number of the
scene. To call the function, the placeholders are replaced by the present values of the leaves.

Tracers are searched for in closures, default arguments, attributes of functions and objects, arguments of
`functools.partial`, containers, and whatever these refer to. They are not searched for in global variables, modules
and classes, which belong to the whole process: `program_cache.fingerprints.traced_parts` reports those.

Only tracers are converted. A concrete value may decide a branch (`if n > 2:`) and stays part of the structure.
"""

import copy
import dataclasses
import functools
import types
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np

LARGEST_ARRAY = 4096
"""Entries up to which equal arrays in two functions count as the same; larger ones are compared by identity."""

MOST_OBJECTS = 20_000
"""Objects that are searched; a function may refer to a table of any size."""


class Placeholder(NamedTuple):
    """Stands for a captured value in a converted function.

    Attributes:
        index: place of the value among the captured ones.
        dtype: its type; leaves are float64, and an index must be an integer again.
    """

    index: int
    dtype: Any


class ConstantArray:
    """An array that is structure: hashable, equal to another one of the same type with the same entries.

    Attributes:
        array: the array; nobody writes into it.
    """

    def __init__(self, array: Any):
        self.array = array
        is_key = jnp.issubdtype(array.dtype, jax.dtypes.prng_key)
        with jax.ensure_compile_time_eval():  # within a transformation it is a constant all the same
            entries = np.asarray(jax.random.key_data(array) if is_key else array)
        self._key = str(array.dtype), entries.shape, entries.tobytes()

    def __cache_key__(self) -> Any:
        """What `fingerprints` takes for it."""
        return self._key

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ConstantArray) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def __repr__(self) -> str:
        return f"ConstantArray({self.array!r})"


class Template:
    """A callable with placeholders for what it captured: static, hashable, free of tracers.

    Two templates are equal where their code is the same and all else that they close over is equal: so a function that
    a builder writes anew in each call is the same structure, and nothing is compiled again. Immutable values and small
    arrays are compared by value, other objects by identity. The comparison reads the variables of now.
    """

    def __init__(self, frame: Any):
        self._frame = frame

    def filled(self, values: tuple) -> Any:
        """The callable with the captured values in place.

        Args:
            values: one for each placeholder.
        """
        return _replaced(self._frame, lambda one: isinstance(one, Placeholder), lambda one: restored(one, values))

    def __cache_key__(self) -> Any:
        """What `fingerprints` takes for it."""
        return self._frame

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        return isinstance(other, Template) and hash(self) == hash(other) and _key(self._frame) == _key(other._frame)

    def __hash__(self) -> int:
        # What is compared can change (a variable is assigned again); a hash must not.
        frame = self._frame
        return hash((type(frame), getattr(frame, "__code__", None)))

    def __repr__(self) -> str:
        return f"Template({getattr(self._frame, '__qualname__', type(self._frame).__qualname__)})"


class Converted(NamedTuple):
    """A callable taken apart.

    Attributes:
        template: the callable without its traced values.
        values: these values, as float64.
    """

    template: Template
    values: tuple


def closure_converted(function: Callable) -> Converted | None:
    """A callable taken apart into structure and traced values; None where it reaches no tracer.

    Of an `equinox.Module` the arrays are leaves already. It is converted where functions within it, or static fields,
    reach tracers; then its arrays are among the values.
    """
    values: list = []
    met: dict[int, Placeholder] = {}
    kept_alive: list = []  # an address must not be given out twice

    def taken(value: Any) -> Placeholder:
        if id(value) not in met:
            met[id(value)] = Placeholder(len(values), _dtype_of(value))
            values.append(as_float(value))
            kept_alive.append(value)
        return met[id(value)]

    frame: Any = function
    if isinstance(function, eqx.Module):
        frame = jax.tree.map(lambda leaf: taken(leaf) if is_number(leaf) else leaf, function)
    n_leaves = len(values)
    frame = _replaced(frame, is_tracer, taken)
    return Converted(Template(frame), tuple(values)) if len(values) > n_leaves else None


def is_number(leaf: Any) -> bool:
    """Whether a leaf of a module is numbers of a floating type; an equinox of 2026 asks tracers for what they lack."""
    return jnp.issubdtype(leaf.dtype, jnp.inexact) if is_tracer(leaf) else eqx.is_inexact_array_like(leaf)


def is_tracer(value: Any) -> bool:
    """Whether JAX traces a value."""
    return isinstance(value, jax.core.Tracer)


def _dtype_of(value: Any) -> Any:
    return getattr(value, "dtype", None) or np.dtype(np.float64)


def as_float(value: Any) -> Any:
    """A leaf for the vector of all numbers; float64 carries integers up to 2^53, and the words of a random key."""
    dtype = _dtype_of(value)
    if jnp.issubdtype(dtype, jax.dtypes.prng_key):
        value = jax.random.key_data(value)
    elif dtype.kind == "c":
        return jnp.stack([value.real, value.imag]).astype(jnp.float64)
    return jnp.asarray(value).astype(jnp.float64) if dtype != np.float64 else value


def restored(place: Placeholder, values: tuple) -> Any:
    """A captured value of its own type again, from the leaves."""
    value, dtype = jnp.asarray(values[place.index]), place.dtype
    if jnp.issubdtype(dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(value.astype(jnp.uint32), impl=jax.random.key_impl(jnp.zeros((0,), dtype)))
    if dtype.kind == "c":
        return (value[0] + 1j * value[1]).astype(dtype)
    return value if value.dtype == dtype else value.astype(dtype)


# The graph of objects that a function reaches ------------------------------------------------------------------------

_ATOMS = (
    type(None), bool, int, float, complex, str, bytes, range, type, types.ModuleType, types.BuiltinFunctionType,
    types.CodeType, np.ndarray, np.generic, np.dtype, np.ufunc, jax.Array, set, frozenset,
)  # fmt: skip
"""What is not searched: numbers, names, and what belongs to the whole process. Tracers are not hashable."""

_WRAPPERS: tuple[type, ...] = (type(jax.jit(lambda: None)), type(functools.lru_cache(lambda: None)))
"""Compiled objects that hold a function as `__wrapped__`, and cannot be copied."""

_EMPTY = types.CellType()
"""Equal to the cells of all variables that have no value yet."""


def _is_atom(value: Any) -> bool:
    return isinstance(value, Placeholder) or (isinstance(value, _ATOMS) and not is_tracer(value))


def _inner(value: Any) -> list:
    """What an object refers to."""
    if _is_atom(value):
        return []
    if isinstance(value, types.FunctionType):
        filled = [cell.cell_contents for cell in value.__closure__ or () if cell != _EMPTY]
        named = [*(value.__kwdefaults__ or {}).values(), *value.__dict__.values()]
        return [*filled, *(value.__defaults__ or ()), *named]
    if isinstance(value, types.MethodType):
        return [value.__func__, value.__self__]
    if isinstance(value, functools.partial):
        return [value.func, *value.args, *value.keywords.values()]
    if isinstance(value, tuple | list):
        return list(value)
    if isinstance(value, dict):
        return list(value.values())
    if isinstance(value, _WRAPPERS):
        return [getattr(value, "__wrapped__", None)]
    return list(_attributes(value).values())


def _attributes(value: Any) -> dict[str, Any]:
    slots = [name for kind in type(value).__mro__ for name in _as_names(kind.__dict__.get("__slots__", ()))]
    found = {name: getattr(value, name) for name in slots if name[:2] != "__" and hasattr(value, name)}
    return {**found, **getattr(value, "__dict__", {})}


def _as_names(slots: Any) -> tuple[str, ...]:
    return (slots,) if isinstance(slots, str) else tuple(slots)


def _replaced(root: Any, is_target: Callable[[Any], bool], replacement: Callable[[Any], Any]) -> Any:
    """The graph of objects from `root` on with some of them replaced; what refers to none of them is left as it is."""
    objects: dict[int, Any] = {}  # all that are reached; held, so that an address is not given out twice
    referring: dict[int, list[int]] = {}
    targets: list[int] = []
    waiting = [root]
    while waiting and len(objects) < MOST_OBJECTS:
        value = waiting.pop()
        if id(value) in objects:
            continue
        objects[id(value)] = value
        if is_target(value):
            targets.append(id(value))
            continue
        for each in _inner(value):
            referring.setdefault(id(each), []).append(id(value))
            waiting.append(each)
    changing, at = set(targets), list(targets)
    while at:
        new = [one for one in referring.get(at.pop(), ()) if one not in changing]
        changing.update(new)
        at += new
    return _Copies(changing, is_target, replacement).of(root) if targets else root


class _Copies:
    """Copies of those objects that refer to what is replaced, each made once."""

    def __init__(self, changing: set[int], is_target: Callable[[Any], bool], replacement: Callable[[Any], Any]):
        self._changing, self._is_target, self._replacement = changing, is_target, replacement
        self._made: dict[int, Any] = {}

    def of(self, value: Any) -> Any:
        """The copy of an object, or itself."""
        at = id(value)
        if at not in self._changing:
            return value
        if at not in self._made:
            if self._is_target(value):
                self._made[at] = self._replacement(value)
            elif isinstance(value, types.FunctionType):
                self._function(value)
            elif isinstance(value, list | dict):
                self._container(value)
            else:
                self._made[at] = self._other(value)
        return self._made[at]

    def _function(self, function: types.FunctionType) -> None:
        cells = function.__closure__ or ()
        renewed = tuple(map(self._cell, cells))
        copied = types.FunctionType(function.__code__, function.__globals__, function.__name__, None, renewed)
        self._made[id(function)] = copied  # before its cells are filled: it may refer to itself
        for cell, own in zip(cells, renewed, strict=True):
            if own is not cell and own == _EMPTY:
                own.cell_contents = self.of(cell.cell_contents)
        copied.__defaults__ = function.__defaults__ and tuple(map(self.of, function.__defaults__))
        copied.__kwdefaults__ = function.__kwdefaults__ and self._values(function.__kwdefaults__)
        copied.__qualname__, copied.__module__, copied.__doc__ = (
            function.__qualname__, function.__module__, function.__doc__,
        )  # fmt: skip
        copied.__dict__.update(self._values(function.__dict__))

    def _cell(self, cell: types.CellType) -> types.CellType:
        """An empty cell for a variable that changes; others keep theirs, and are seen when they are assigned again."""
        if cell == _EMPTY or id(cell.cell_contents) not in self._changing:
            return cell
        return self._made.setdefault(id(cell), types.CellType())  # shared by all functions of the variable

    def _container(self, value: Any) -> None:
        copied = self._made[id(value)] = copy.copy(value)
        if isinstance(value, dict):
            copied.update(self._values(value))
        else:
            copied[:] = map(self.of, value)

    def _values(self, named: dict) -> dict:
        return {name: self.of(each) for name, each in named.items()}

    def _other(self, value: Any) -> Any:
        if isinstance(value, types.MethodType):
            return types.MethodType(self.of(value.__func__), self.of(value.__self__))
        if isinstance(value, functools.partial):
            arguments = [self.of(value.func), *map(self.of, value.args)]
            return type(value)(*arguments, **self._values(value.keywords))
        if isinstance(value, tuple):
            entries = [self.of(each) for each in value]
            return type(value)(*entries) if hasattr(value, "_fields") else type(value)(entries)
        if isinstance(value, _WRAPPERS):
            # The function alone: compiled or remembered, it would hold on to what it was traced with.
            return self.of(value.__wrapped__)
        copied = copy.copy(value)
        for name, each in _attributes(value).items():
            object.__setattr__(copied, name, self.of(each))  # of a frozen dataclass too, which a module is
        return copied


def _key(root: Any) -> tuple:
    """All that tells one graph of objects from another, now: code, immutable values and small arrays by value, other
    objects by identity."""
    met: dict[int, int] = {}
    words: list = []

    def read(value: Any) -> None:
        if isinstance(value, Placeholder):
            words.append(("placeholder", value.index, str(value.dtype)))
        elif value is None or isinstance(value, bool | int | float | complex | str | bytes):
            words.append((type(value), repr(value)))  # by repr: -0.0 is not 0.0, and NaN is NaN
        elif id(value) in met:
            words.append(("met", met[id(value)]))
        else:
            met[id(value)] = len(met)
            _read_object(value, words, read)

    read(root)
    return tuple(words)


def _read_object(value: Any, words: list, read: Callable[[Any], None]) -> None:
    if isinstance(value, np.ndarray | np.generic | jax.Array) and value.size <= LARGEST_ARRAY:
        array = np.asarray(value)
        content = id(value) if array.dtype.hasobject else array.tobytes()
        words.append((type(value), str(array.dtype), array.shape, content))
    elif isinstance(value, types.FunctionType):
        words.append((types.FunctionType, value.__code__, id(value.__globals__)))
        for cell in value.__closure__ or ():
            words.append(cell == _EMPTY)
            if cell != _EMPTY:
                read(cell.cell_contents)
        for part in (value.__defaults__, value.__kwdefaults__):
            read(part)
    elif isinstance(value, tuple | list | dict | functools.partial | types.MethodType) or (
        dataclasses.is_dataclass(value) and not isinstance(value, type)
    ):
        inner = _inner(value)
        names = tuple(value) if isinstance(value, dict) else tuple(getattr(value, "keywords", ()))
        words.append((type(value), len(inner), names))
        for each in inner:
            read(each)
    else:
        words.append((type(value), id(value)))

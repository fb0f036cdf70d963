"""When two values are the same to a cache: they have equal keys.

A key has three parts, and there is no other notion of "the same as before" in this package:

* the *structure* of a pytree: its containers, and all that is static in them;
* the *user code* in that structure, by a fingerprint of what it is at the moment of the call (`user_code`);
* the *leaves*: numbers and arrays by type and bits (`value_key`) or, for a function that is compiled, arrays by shape
  and type and everything else as in `value_key` (`call_key`).

An object may say what stands for it in fingerprints by a method `__cache_key__`. Keys are compared within a process;
`disk_cache.key_for` makes of the same parts a digest that other processes find again.
"""

import struct
from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import wraps
from itertools import compress
from threading import Lock
from typing import Any, TypeVar, cast

import jax
import jax.core
import numpy as np

from spherejax.program_cache.garbage import gc_paused
from spherejax.program_cache.jaxprs import is_tracing
from spherejax.program_cache.user_code import user_code_fingerprint

_Function = TypeVar("_Function", bound=Callable[..., Any])


class CacheKey:
    """A key whose hash is computed once: it goes through all that is static, and a table asks for it at each call."""

    __slots__ = ("_hash", "leaves", "structure", "user_code")

    def __init__(self, structure: Any, user_code: str, leaves: tuple):
        self.structure, self.user_code, self.leaves = structure, user_code, leaves
        self._hash = hash((structure, user_code, leaves))

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        if not isinstance(other, CacheKey) or self._hash != other._hash:
            return False
        # Equal hashes do not make equal keys: a collision would return another scene's motion. The structure last:
        # comparing it may call `__eq__` of many objects.
        mine, others = (self.leaves, self.user_code, self.structure), (other.leaves, other.user_code, other.structure)
        return mine == others


def value_key(tree: Any) -> CacheKey | None:
    """The key of a pytree by the values in it; None where a value is traced, or cannot be compared."""
    return KeyedTree(tree).key


class KeyedTree:
    """A pytree, taken apart once for all that asks what is in it.

    Attributes:
        tree: the pytree.
        leaves, structure: as JAX takes it apart.
        values: of each leaf its type and bits; None of one that is traced, or cannot be compared.
        user_code: the fingerprint of user code in it; empty without.
        key: of all of it, as of `value_key`.
    """

    __slots__ = ("key", "leaves", "structure", "tree", "user_code", "values")

    def __init__(self, tree: Any):
        self.tree = tree
        self.leaves, self.structure = jax.tree.flatten(tree)
        values = []
        for leaf in self.leaves:
            kind = type(leaf)
            # What scenes are made of, without a question.
            if kind is np.float64:
                values.append((kind, "<f8", (), leaf.tobytes()))
            elif kind is np.ndarray and not leaf.dtype.hasobject:
                values.append((kind, leaf.dtype.str, leaf.shape, leaf.tobytes()))
            else:
                values.append(_plain_key(leaf) or _array_key(leaf))
        self.values = tuple(values)
        self.user_code = self.key = None
        try:
            self.user_code = user_code_fingerprint(self.structure)
            if None not in self.values:
                self.key = CacheKey(self.structure, self.user_code, self.values)
        except TypeError:  # something static is not hashable
            pass


def _array_key(leaf: Any) -> tuple | None:
    """An array by its type and content; None for anything else, and for an array whose content is not known."""
    # Tracers are instances of `jax.Array`, too: their values are not known.
    if isinstance(leaf, jax.core.Tracer) or not isinstance(leaf, np.ndarray | np.generic | jax.Array):
        return None
    try:
        array = np.asarray(leaf)
    except TypeError:  # keys of random numbers, which NumPy has no arrays of
        return None
    # The bytes of an array of objects are addresses: another object may have the same one a moment later.
    if array.dtype.hasobject:
        return None
    # The class as well: checks tell a number from an array of no dimension. The bytes are compared, not their hash:
    # a collision would be another scene's motion, and the arrays of a scene are small.
    return type(leaf), array.dtype.str, array.shape, array.tobytes()


class ArrayKind(tuple):
    """What a compiled program depends on of an array: its shape, its type, and whether that type is weak."""

    __slots__ = ()

    @classmethod
    def of(cls, array: Any) -> "ArrayKind":
        """That of an array, a tracer among them."""
        return cls((array.shape, array.dtype, getattr(array, "weak_type", False)))

    @property
    def example(self) -> jax.ShapeDtypeStruct:
        """An array of this kind, to JAX."""
        # With the weak type: the program would be traced for other promotions than those that the caller gets.
        shape, dtype, weak_type = self
        return jax.ShapeDtypeStruct(shape, dtype, weak_type=weak_type)

    def stacked(self, n: int, axis: int | None) -> "ArrayKind":
        """The kind of n of them, one beside the other along a new leading axis; of an axis None, of one for all."""
        shape, dtype, weak_type = self
        return self if axis is None else ArrayKind(((n, *shape), dtype, weak_type))


_ARRAYS = (np.ndarray, np.generic, jax.Array)
"""What is traced: as of `equinox.is_array`, which is asked fifty times in a call."""


def call_key(tree: Any) -> tuple[CacheKey, list, list]:
    """The key of a call of a compiled function, by the shapes and types of arrays and by the values of all else.

    Returns:
        The key; all leaves of the arguments, with None in the places of arrays (JAX knows no leaf that is None); and
        the arrays.

    Raises:
        TypeError: where something that is no array is not hashable.
    """
    leaves, structure = jax.tree.flatten(tree)
    parts, static, is_array = list(leaves), list(leaves), [isinstance(leaf, _ARRAYS) for leaf in leaves]
    for i, leaf in enumerate(leaves):
        if is_array[i]:
            parts[i] = ArrayKind((leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)))
            static[i] = None
        else:
            # The leaf itself, not its fingerprint: equality is up to its class, as it is for what JAX keeps static.
            parts[i] = _plain_key(leaf) or leaf
    arrays = list(compress(leaves, is_array))
    return CacheKey(structure, user_code_fingerprint(structure), tuple(parts)), static, arrays


def _plain_key(leaf: Any) -> tuple | None:
    """A Python number by its type and bits, a text as it is; None for anything else.

    To Python `1`, `1.0` and `True` are equal, and so are `0.0` and `-0.0`; programs made from them are not. NaN is
    unequal to itself, and the program made from it is the same.
    """
    # Not by `isinstance`: an enumeration of integers and NumPy's numbers derive from these, and are other values.
    kind = type(leaf)
    if kind is float:
        return kind, _DOUBLE.pack(leaf)
    return (kind, leaf) if kind is int or kind is bool or kind is str else None


_DOUBLE = struct.Struct("d")


# What was made for a key -------------------------------------------------------------------------------------------


class LruCache:
    """A table of bounded size; the least recently used entry is evicted first. Threads may share it.

    Attributes:
        size: how many entries there may be.
    """

    def __init__(self, size: int, evicted: Callable[[Any], None] = lambda value: None):
        self.size = size
        self._evicted = evicted
        self._entries: OrderedDict[Hashable, Any] = OrderedDict()
        self._lock = Lock()

    def get(self, key: Hashable, make: Callable[[], Any], may_enter: Callable[[], bool] = lambda: True) -> Any:
        """The entry of a key; where there is none, what `make` returns becomes the entry, if it may be entered then."""
        with self._lock:
            if key in self._entries:
                self._entries.move_to_end(key)
                return self._entries[key]
        # Without the lock: it may take seconds, and may ask this table again. Of two threads that make the same, both
        # get what was entered first.
        made = make()
        if not may_enter():
            return made
        evicted = []
        with self._lock:
            # The first one stays, and both threads return it: programs are compared by identity further on, and two
            # would be compiled.
            made = self._entries.setdefault(key, made)
            self._entries.move_to_end(key)
            while len(self._entries) > self.size:
                evicted.append(self._entries.popitem(last=False)[1])
        # Without the lock again: freeing a program may run a user's finalizers.
        for value in evicted:
            self._evicted(value)
        return made

    def find(self, key: Hashable) -> Any:
        """The entry of a key; None where there is none."""
        with self._lock:
            if key not in self._entries:
                return None
            self._entries.move_to_end(key)
            return self._entries[key]

    def put(self, key: Hashable, value: Any) -> None:
        """Make something the entry of a key, in place of what was."""
        with self._lock:
            self._entries.pop(key, None)
        self.get(key, lambda: value)

    def clear(self) -> None:
        """Evict all entries."""
        with self._lock:
            entries = list(self._entries.values())
            self._entries.clear()
        for value in entries:
            self._evicted(value)

    def __contains__(self, key: Hashable) -> bool:
        return key in self._entries

    def __len__(self) -> int:
        return len(self._entries)

    def values(self) -> list:
        """The entries, the least recently used first."""
        with self._lock:
            return list(self._entries.values())


def lru_get(cache: LruCache, key: Hashable | None, make: Callable[[], Any]) -> Any:
    """What was made for this key before; else what `make` makes now, which is entered into the table.

    Nothing is entered without a key, nor while JAX traces a program: arrays that are made then belong to its trace,
    also those of known numbers, and JAX raises an `UnexpectedTracerError` where they are used in another one.
    """
    if key is None:
        return make()

    def made() -> Any:
        with gc_paused():
            return make()

    # Asked after a miss alone: it takes 5 us, and what is in the table serves a trace as well.
    return cache.get(key, made, may_enter=lambda: not is_tracing())


def memoized(
    size: int, key: Callable[..., Hashable | None] | None = None, *, copied: bool = False
) -> Callable[[_Function], _Function]:
    """A decorator for a pure function whose results are kept, by the values of its arguments.

    The wrapped function has its table of results as `.table`.

    Args:
        size: how many results are kept.
        key: that of the arguments, which it is given as they are; None for no key: then nothing is kept. By default
            their `value_key`.
        copied: whether each caller gets containers and NumPy arrays of its own, so that who writes into them changes
            no other result.
    """

    def decorate(function: _Function) -> _Function:
        table = LruCache(size)

        @wraps(function)
        def call(*arguments: Any) -> Any:
            values = value_key(arguments) if key is None else key(*arguments)
            result = lru_get(wrapped.table, values, lambda: function(*arguments))
            return own_arrays(result) if copied else result

        wrapped: Any = call
        wrapped.table = table
        return cast(_Function, wrapped)

    return decorate


def own_arrays(tree: Any) -> Any:
    """A copy of a pytree in containers and NumPy arrays of its own: who writes into it changes no entry of a table."""
    return jax.tree.map(own, tree)


def own(leaf: Any) -> Any:
    """A copy of a NumPy array; anything else, which nobody can write into, as it is."""
    return leaf.copy() if isinstance(leaf, np.ndarray) else leaf

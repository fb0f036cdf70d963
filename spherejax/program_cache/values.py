"""Things told by value, not by identity, and what was made of them remembered.

Whoever changes a number, in a dictionary or within an array, has another thing.
"""

import struct
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

import jax
import jax.core
import numpy as np

from spherejax.program_cache.garbage import gc_paused
from spherejax.program_cache.jaxprs import is_tracing
from spherejax.program_cache.user_code import user_code_fingerprint


def value_key(tree: Any) -> Hashable | None:
    """All there is in a pytree, to be compared, code of a user's own as it is now; None where something in it is
    traced, or cannot be compared."""
    leaves, structure = jax.tree.flatten(tree)
    values = []
    for leaf in leaves:
        kind = type(leaf)
        if kind is float:
            values.append((kind, _DOUBLE.pack(leaf)))  # -0.0 is not 0.0, and NaN is NaN
            continue
        if kind is int or kind is bool:
            values.append((kind, leaf))
            continue
        if isinstance(leaf, jax.core.Tracer) or not isinstance(
            leaf, bool | int | float | np.ndarray | np.generic | jax.Array
        ):
            return None
        array = np.asarray(leaf)
        if array.dtype.hasobject:
            return None
        # A number and an array of no dimension are not the same to whoever checks them.
        values.append((kind, array.dtype.str, array.shape, array.tobytes()))
    try:
        hash(structure)
    except TypeError:  # something static in it is not hashable
        return None
    return structure, user_code_fingerprint(structure), tuple(values)


def own_arrays(tree: Any) -> Any:
    """The same, in arrays and containers of its own."""
    return jax.tree.map(own, tree)


def own(leaf: Any) -> Any:
    """The same number, or the same numbers in an array of its own."""
    return leaf.copy() if isinstance(leaf, np.ndarray) else leaf


def lru_get(found: OrderedDict, lock: Any, n: int, key: Hashable, make: Callable[[], Any]) -> Any:
    """What was made for this key before, else what `make` makes now, which is remembered with the n most recent."""
    with lock:
        if key in found:
            found.move_to_end(key)
            return found[key]
    # Without the lock: it may take seconds, and two threads that make the same do no harm.
    with gc_paused():
        made = make()
    if is_tracing():
        return made  # under `jax.jit` arrays belong to its trace, also those of known numbers
    with lock:
        found[key] = made
        while len(found) > n:
            found.popitem(last=False)
    return made


_DOUBLE = struct.Struct("d")

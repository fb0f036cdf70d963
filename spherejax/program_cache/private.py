"""What the cache uses of JAX that is private or undocumented, in one place, with what happens without it.

    python -m spherejax.program_cache.private

prints for the installed version which of these parts are missing, and what that costs. Results stay right.
"""

import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.metadata import version
from typing import Any

import jax
import jax.monitoring
from jax.extend.core import Primitive
from jax.interpreters import mlir
from jax.sharding import AbstractMesh, NamedSharding, PartitionSpec


def is_jit_disabled() -> bool:
    """Whether `jax.disable_jit` is in force: a compiled program raises an error then.

    Without the setting, or with another name, False.
    """
    return bool(jax.config.values.get("jax_disable_jit", False))


def n_devices(context: Any) -> int:
    """Over how many devices XLA partitions the program that is lowered in a context of a lowering rule.

    One under `jax.shard_map`, where each device has a program of its own, and where JAX does not say.
    """
    # The compiler asks in the same way (`compiler/private.py`): neither of the two imports the other, so the line
    # stands twice, and `tests/test_spread_arrays.py` holds both against JAX.
    return getattr(context.module_context.axis_context, "num_devices", 1)


@cache
def register_lapack() -> None:
    """Have JAX look up LAPACK's functions in SciPy, which it does when it lowers the first program that calls one.

    A process that only loads such a program jumps to no function at all: a segmentation fault (jaxlib 0.10.2).
    """
    # A small program that calls LAPACK. It need not be compiled: what is asked for happens when it is lowered.
    jax.jit(jax.numpy.linalg.inv).lower(jax.ShapeDtypeStruct((2, 2), jax.numpy.float64))


HIT, MISS = "/jax/compilation_cache/cache_hits", "/jax/compilation_cache/cache_misses"
"""Names of JAX's events when it has looked for a program in its compilation cache."""


@contextmanager
def found_by_jax() -> Iterator[Callable[[], bool | None]]:
    """A context whose value says whether what was compiled in it was loaded from JAX's compilation cache.

    None where JAX does not say: it keeps no program that was compiled quickly, or its events have other names. A
    program that JAX has loaded lacks functions and must not be written again, so without an answer nothing is written.
    """
    _listen()
    # JAX does not return it; its events say it, on the thread that compiles.
    _compiling.was_found = None if jax.config.values.get("jax_compilation_cache_dir") else False
    yield lambda: _compiling.was_found


_compiling = threading.local()


@cache
def _listen() -> None:
    jax.monitoring.register_event_listener(_heard)


def _heard(event: str, **_: Any) -> None:
    if event in (HIT, MISS):
        _compiling.was_found = event == HIT


# The check ------------------------------------------------------------------------------------------------------------


def _has_settings() -> bool:
    return {"jax_disable_jit", "jax_compilation_cache_dir"} <= set(jax.config.values)


def _says_how_many_devices() -> bool:
    counts = []
    probe = Primitive("probe")
    probe.def_abstract_eval(lambda x: x)

    def lowering(context: Any, x: Any) -> Sequence:
        counts.append(n_devices(context))
        return [x]

    mlir.register_lowering(probe, lowering)
    sharding = NamedSharding(AbstractMesh((2,), ("device",)), PartitionSpec("device"))
    example = jax.ShapeDtypeStruct((2,), jax.numpy.float32, sharding=sharding)
    jax.jit(probe.bind).trace(example).lower(lowering_platforms=("cpu",))
    return counts == [2]


PARTS: Sequence[tuple[str, str, Callable[[], bool]]] = (
    ("settings by name", "errors of JAX's under jax.disable_jit; programs are not written to disk", _has_settings),
    (
        "the number of devices of a program",
        "arrays on several devices end with an error of XLA's",
        _says_how_many_devices,
    ),
)
"""Name, what happens where it is missing, and whether it is there."""


def missing() -> list[str]:
    """The parts that the installed version does not have, by name."""
    return [name for name, _, is_there in PARTS if not is_there()]


def main() -> int:
    """Print what is missing; 1 where something is."""
    print(f"jax {version('jax')}")
    gone = missing()
    for name, without, _ in PARTS:
        print(f"  missing: {name}; without it: {without}" if name in gone else f"  there: {name}")
    return min(len(gone), 1)


if __name__ == "__main__":
    sys.exit(main())

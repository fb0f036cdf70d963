"""What the cache uses of JAX that is private or undocumented, in one place, with what happens without it.

    python -m spherejax.program_cache.private

prints for the installed version which of these parts are missing, and what that costs. Results stay right.
"""

import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache
from importlib.metadata import version
from tempfile import TemporaryDirectory
from typing import Any

import jax
import jax.monitoring
from jax.experimental.compilation_cache import compilation_cache
from jax.extend.core import Primitive
from jax.interpreters import mlir
from jax.sharding import AbstractMesh, NamedSharding, PartitionSpec


def is_jit_disabled() -> bool:
    """Whether `jax.disable_jit` is in force: a compiled program raises an error then.

    Without the setting, or with another name, False.
    """
    return bool(getattr(jax.config, "jax_disable_jit", False))


try:
    from jax._src.core import trace_state_clean as is_outside_of_transformations
except ImportError:

    def is_outside_of_transformations() -> bool:
        """Whether no transformation of JAX is under way; False where JAX does not say."""
        return False


try:
    from jax._src.core import eval_context as outside_of_transformations
except ImportError:

    def outside_of_transformations() -> AbstractContextManager:
        """A context in which no transformation of JAX is under way; any context where JAX has none."""
        return nullcontext()


def n_devices(context: Any) -> int:
    """Over how many devices XLA partitions the program that is lowered in a context of a lowering rule.

    One under `jax.shard_map`, where each device has a program of its own, and where JAX does not say.
    """
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
    # Without a folder JAX has loaded nothing for certain. A setting of another name is no answer.
    _compiling.was_found = None if jax.config.values.get("jax_compilation_cache_dir", "unknown") else False
    yield lambda: _compiling.was_found


_compiling = threading.local()


@cache
def _listen() -> None:
    jax.monitoring.register_event_listener(_heard)


def _heard(event: str, **_: Any) -> None:
    if event in (HIT, MISS):
        _compiling.was_found = event == HIT


# The check ------------------------------------------------------------------------------------------------------------

# The compiler's `private.py` has the same loop over parts of its own, and `is_jit_disabled` and `n_devices`, too. The
# cache and the compiler may each be taken out of the package alone, so neither imports the other, and these lines stand
# twice.


def _has_settings() -> bool:
    return {"jax_disable_jit", "jax_compilation_cache_dir"} <= set(jax.config.values)


def _says_what_it_loads() -> bool:
    """Whether JAX's events say of a program that it was compiled, or loaded from JAX's compilation cache."""
    settings = {"jax_compilation_cache_dir": None, "jax_persistent_cache_min_compile_time_secs": 0.0}
    if not settings.keys() <= jax.config.values.keys():
        return False
    before = {name: jax.config.values[name] for name in settings}
    with TemporaryDirectory() as folder:
        # In the folder that JAX has already, if it has one: it opens one cache in a process.
        settings["jax_compilation_cache_dir"] = before["jax_compilation_cache_dir"] or folder
        try:
            for name, value in settings.items():
                jax.config.update(name, value)
            with found_by_jax() as was_found:
                jax.jit(lambda x: x + 1.0).lower(1.0).compile()
            return was_found() is not None
        finally:
            for name, value in before.items():
                jax.config.update(name, value)
            if not before["jax_compilation_cache_dir"]:
                compilation_cache.reset_cache()  # or JAX would write to the folder that is deleted now


def _can_step_outside() -> bool:
    are_outside = []

    def probe(x: Any) -> Any:
        with outside_of_transformations():
            are_outside.append(is_outside_of_transformations())
        return x

    jax.grad(probe)(1.0)
    return are_outside == [True]


def _says_how_many_devices() -> bool:
    counts = []
    # Only a lowering rule gets the context. An abstract mesh stands for two devices that this process need not have.
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
    ("events of the compilation cache", "programs are not written to disk where JAX has a cache", _says_what_it_loads),
    (
        "whether a transformation is under way",
        "5 us more for each question whether a program is traced",
        is_outside_of_transformations,
    ),
    (
        "a context outside of transformations",
        "0.3 ms more for each program that is called with numbers within jax.grad",
        _can_step_outside,
    ),
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

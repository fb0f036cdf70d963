"""Flags and options of XLA with which scalar programs are fast; a host sets the flags before JAX's backend starts.

They are private to XLA: `private` checks whether the installed versions have them. This file imports no JAX, because
flags that are set after the start of the backend have no effect. It is apart from `private`, which is also a command:
what `import spherejax` loads already, `python -m` would load a second time, with a warning.
"""

from collections.abc import Mapping
from importlib.metadata import version
from types import MappingProxyType
from typing import Any

BACKEND_OPTIONS = "--xla_backend_extra_options="
"""The one flag that takes the list of `LOOP_OPTIONS`: XLA reads one such list only."""

LOOP_OPTIONS = ("xla_cpu_small_while_loop_byte_threshold=1000000000",)
"""Lets XLA compile a whole `while` loop (a whole integration) into one native function; by default it does so for tiny
loops only. Together with scalar programs it makes a right-hand side 15 to 30 times faster; it does not help code that
calls LAPACK or multiplies matrices inside the loop. Names in this list that begin with "xla_" and that XLA does not
know are passed over, and runs are slower."""

VECTOR_WIDTH = "--xla_cpu_prefer_vector_width"
"""Lets the compiler use vectors of 512 bits where the processor has them (by default 256, even there), which takes a
tenth off a step of a block of lanes. It is a preference: a processor without them is none the worse."""

LIBRARY = "--xla_cpu_experimental_ynn_fusion_type"
"""Empty, it keeps XLA from handing sums and products of matrices to a library (YNNPACK). It does so also within what is
to be one kernel (`native.loop_fusion`), and then cannot write it (jaxlib 0.10)."""

JAXLIB_WITH_LIBRARY = (0, 10), (0, 12)
"""The first and the last jaxlib that is known to have that flag: a flag that XLA does not know ends the process."""

LESS_ALIASING: Mapping[str, Any] = MappingProxyType({"xla_llvm_enable_noalias_metadata": False})
"""An option for a program of thousands of scalars: LLVM is not told of each pair of them that they do not overlap."""

FAST_COMPILE: Mapping[str, Any] = MappingProxyType({**LESS_ALIASING, "xla_backend_optimization_level": 0})
"""Options for a program whose compile time is favoured over its run time. XLA raises an error for an option that it
does not know: the caller then compiles without them."""


def with_xla_flags(flags: str) -> str:
    """The value of XLA_FLAGS with our flags added, but for those that are set.

    Args:
        flags: the value that the process has.
    """
    words = flags.split()
    # By name, whatever the value: what the user has set stays.
    if VECTOR_WIDTH not in flags:
        words.append(f"{VECTOR_WIDTH}=512")
    if LIBRARY not in flags and has_library():
        words.append(f"{LIBRARY}=")
    missing = ",".join(option for option in LOOP_OPTIONS if option.split("=")[0] not in flags)
    if not missing:
        return flags if words == flags.split() else " ".join(words)
    # Of two lists XLA reads the last one only, so ours goes into the user's.
    for position, word in enumerate(words):
        if word.startswith(BACKEND_OPTIONS):
            words[position] = f"{word},{missing}"
            return " ".join(words)
    return " ".join([*words, BACKEND_OPTIONS + missing])


def has_backend_started() -> bool:
    """Whether JAX's backend has started, so that flags come too late. False where JAX does not say: the usual case."""
    try:
        from jax._src import xla_bridge

        return xla_bridge.backends_are_initialized()
    except (ImportError, AttributeError):
        return False


def has_library() -> bool:
    """Whether the installed jaxlib is known to have the flag `LIBRARY`."""
    first, last = JAXLIB_WITH_LIBRARY
    return first <= installed_jaxlib() <= last


def installed_jaxlib() -> tuple[int, ...]:
    """Major and minor version of jaxlib, from its metadata: nothing of JAX is imported."""
    return tuple(int(part) for part in version("jaxlib").split(".")[:2])

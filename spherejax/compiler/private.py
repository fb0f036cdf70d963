"""What the compiler uses of JAX and XLA that is private or undocumented, in one place, with what happens without it.

    python -m spherejax.compiler.private

prints for the installed versions which of these parts are missing, and what that costs. The binary interface of calls
is in `native/ffi_abi.py`. A missing part makes a program slower or ends with an error that names it. Results stay
right. JAX is imported where it is needed: flags have to be known before it starts.
"""

import importlib.util
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from spherejax.compiler.native import ffi_abi

# Of JAX ---------------------------------------------------------------------------------------------------------------


def new_context() -> Callable[[bool], Any] | None:
    """A context of tracing that JAX's caches tell apart: what was traced in another one is traced again.

    Returns:
        `jax.make_user_context(False)`; None where JAX has none. Then there is no machine code: a program that was
        traced with it would be taken for the one without.
    """
    import jax

    return jax.make_user_context(False) if hasattr(jax, "make_user_context") else None


def is_jit_disabled() -> bool:
    """Whether `jax.disable_jit` is in force: then nothing is lowered, and machine code cannot be called.

    Without the setting, or with another name, False: an operation that is evaluated one by one would then fail with
    JAX's own error.
    """
    import jax

    return bool(jax.config.values.get("jax_disable_jit", False))


def is_dropped(variable: Any) -> bool:
    """Whether nothing reads a result of an operation. JAX has no public name for what stands in its place.

    By the name of its type: with another name it is False, and derivatives or outputs are made that nobody reads.
    """
    return type(variable).__name__ == "DropVar"


def counts_of_scan(parameters: dict[str, Any]) -> tuple[int, int]:
    """How many arguments of a `scan` stay the same in all turns, and how many are carried; the others are slices.

    Args:
        parameters: those of the operation; two numbers until JAX 0.10, a tree of all arguments from 0.11 on. With
            neither of them a `KeyError` names the missing one: a wrong guess would mix arguments up.
    """
    if "num_consts" in parameters:
        return parameters["num_consts"], parameters["num_carry"]
    fixed, carried, _ = parameters["ft_in"].unpack()
    return len(fixed), len(carried)


def has_backend_started() -> bool:
    """Whether JAX's backend has started, so that flags come too late. False where JAX does not say: the usual case."""
    try:
        from jax._src import xla_bridge

        return xla_bridge.backends_are_initialized()
    except (ImportError, AttributeError):
        return False


def n_devices(context: Any) -> int:
    """Over how many devices XLA partitions the program that is lowered in a context of a lowering rule.

    One under `jax.shard_map`, where each device has a program of its own, and where JAX does not say.
    """
    return getattr(context.module_context.axis_context, "num_devices", 1)


# Of XLA ---------------------------------------------------------------------------------------------------------------

KERNEL_ATTRIBUTES = {"xla_cpu_small_call": "true", "inlineable": "false"}
"""Frontend attributes of a called function that XLA's CPU compiler then makes one kernel (jaxlib 0.10).

Where the first one means nothing the call is an ordinary one: right, and slower. XLA aborts the process where such a
function has an argument that nothing reads; `loop_fusion` leaves none."""

ATTRIBUTES = "mhlo.frontend_attributes"
"""Name under which StableHLO hands such attributes on; with another name they are dropped."""


BACKEND_OPTIONS = "--xla_backend_extra_options="
"""The one flag that takes the list of `LOOP_OPTIONS`: XLA reads one such list only."""

LOOP_OPTIONS = (
    "xla_cpu_small_while_loop_byte_threshold=1000000000",
    "xla_cpu_use_multi_output_fusion",
)
"""The first one lets XLA compile a whole `while` loop (a whole integration) into one native function; by default it
does so for tiny loops only. The second lets one fusion have several outputs. Together with scalar programs they make a
right-hand side 15 to 30 times faster; neither helps code that calls LAPACK or multiplies matrices inside the loop.
Names in this list that XLA does not know are passed over, and runs are slower."""

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
"""Options for a program that is compiled soon rather than well. XLA raises an error for an option that it does not
know: whoever compiles with these compiles without them then."""


def with_xla_flags(flags: str) -> str:
    """The value of XLA_FLAGS with our flags added, but for those that are set.

    Args:
        flags: the value that the process has.
    """
    words = flags.split()
    if VECTOR_WIDTH not in flags:
        words.append(f"{VECTOR_WIDTH}=512")
    if LIBRARY not in flags and _has_library():
        words.append(f"{LIBRARY}=")
    missing = ",".join(option for option in LOOP_OPTIONS if option.split("=")[0] not in flags)
    if not missing:
        return flags if words == flags.split() else " ".join(words)
    for position, word in enumerate(words):
        if word.startswith(BACKEND_OPTIONS):
            words[position] = f"{word},{missing}"
            return " ".join(words)
    return " ".join([*words, BACKEND_OPTIONS + missing])


def _has_library() -> bool:
    first, last = JAXLIB_WITH_LIBRARY
    return first <= _jaxlib() <= last


def _jaxlib() -> tuple[int, ...]:
    return tuple(int(part) for part in version("jaxlib").split(".")[:2])


# The check ------------------------------------------------------------------------------------------------------------


class PrivatePart(NamedTuple):
    """A private part.

    Attributes:
        name: what it is.
        without: what happens where it is missing.
        is_there: whether it is there, in the installed versions.
    """

    name: str
    without: str
    is_there: Callable[[], bool]


def _scan_parameters() -> bool:
    import jax

    closed = jax.make_jaxpr(lambda x: jax.lax.scan(lambda c, _: (c * 2, c), x, None, length=2))(1.0)
    (loop,) = (equation for equation in closed.jaxpr.eqns if equation.primitive.name == "scan")
    try:
        return counts_of_scan(loop.params) == (0, 1)
    except (KeyError, AttributeError):
        return False


def _is_known_jaxlib() -> bool:
    first, last = ffi_abi.KNOWN_JAXLIB
    return first <= _jaxlib() <= last


def _has_in_core(name: str) -> bool:
    from jax.extend import core

    return hasattr(core, name)


def _has_setting(name: str) -> bool:
    import jax

    return name in jax.config.values


def _has_bridge() -> bool:
    from jax._src import xla_bridge

    return hasattr(xla_bridge, "backends_are_initialized")


def _takes(options: Mapping[str, Any]) -> bool:
    """Whether XLA takes options of a program."""
    import jax

    try:
        jax.jit(lambda x: x + 1.0).lower(1.0).compile(compiler_options=dict(options))
    except jax.errors.JaxRuntimeError:
        return False
    return True


def header() -> Path | None:
    """The header of the binary interface that jaxlib installs; None where it installs none."""
    package = importlib.util.find_spec("jaxlib")
    places = [] if package is None else package.submodule_search_locations or []
    paths = [Path(place) / "include" / "xla" / "ffi" / "api" / "c_api.h" for place in places]
    return next((path for path in paths if path.is_file()), None)


def _is_interface_the_same() -> bool:
    path = header()
    if path is None:
        return False
    lines = path.read_text(encoding="utf-8").splitlines()
    wanted = f"#define XLA_FFI_API_MAJOR {ffi_abi.API_MAJOR}", f"#define XLA_FFI_API_MINOR {ffi_abi.API_MINOR}"
    return all(line in lines for line in wanted)


_NO_MACHINE_CODE = "no machine code, with one warning: XLA compiles everything, and first calls take longer"

PARTS: Sequence[PrivatePart] = (
    PrivatePart("a known version of jaxlib", _NO_MACHINE_CODE, _is_known_jaxlib),
    PrivatePart("jax.make_user_context", _NO_MACHINE_CODE, lambda: new_context() is not None),
    PrivatePart("llvmlite", _NO_MACHINE_CODE, lambda: importlib.util.find_spec("llvmlite") is not None),
    PrivatePart(
        "version 0.3 of XLA's interface of calls, in its header",
        "offsets in native/ffi_abi.py have to be compared before this version is admitted to KNOWN_JAXLIB",
        _is_interface_the_same,
    ),
    PrivatePart("numbers of arguments of `scan`", "loops are refused, with an error that names it", _scan_parameters),
    PrivatePart(
        "DropVar",
        "derivatives are made that nobody reads: programs take longer to make",
        lambda: _has_in_core("DropVar"),
    ),
    PrivatePart(
        "the setting jax_disable_jit",
        "an error of JAX's under jax.disable_jit",
        lambda: _has_setting("jax_disable_jit"),
    ),
    PrivatePart(
        "jax.extend.core.jaxprs_in_params",
        "an AttributeError where loops are fused",
        lambda: _has_in_core("jaxprs_in_params"),
    ),
    PrivatePart(
        "jax._src.xla_bridge.backends_are_initialized",
        "no warning where spherejax is imported too late for its flags",
        _has_bridge,
    ),
    PrivatePart(
        "options of one program, " + " and ".join(FAST_COMPILE),
        "programs are compiled without them, which takes a quarter longer for large ones",
        lambda: _takes(FAST_COMPILE),
    ),
    PrivatePart(
        "a jaxlib of which it is known whether it has " + LIBRARY,
        "the flag is not set: a kernel with a sum or a product of matrices may fail to compile",
        _has_library,
    ),
)


def missing() -> list[PrivatePart]:
    """The parts that the installed versions do not have."""
    return [part for part in PARTS if not part.is_there()]


def main() -> int:
    """Print what is missing; 1 where something is."""
    print(f"jax {version('jax')}, jaxlib {version('jaxlib')}")
    gone = missing()
    for part in PARTS:
        print(f"  missing: {part.name}; without it: {part.without}" if part in gone else f"  there: {part.name}")
    return min(len(gone), 1)


if __name__ == "__main__":
    sys.exit(main())

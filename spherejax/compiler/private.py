"""What the compiler uses of JAX and XLA that is private or undocumented, in one place, with what happens without it.

    python -m spherejax.compiler.private

prints for the installed versions which of these parts are missing, and what that costs. The binary interface of calls
is in `native/ffi_abi.py`, flags of XLA are in `xla_flags`. A missing part makes a program slower or ends with an error
that names it. Results stay right.
"""

import importlib.util
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax
from jax.extend import core

from spherejax.compiler import xla_flags
from spherejax.compiler.native import ffi_abi

# Of JAX ---------------------------------------------------------------------------------------------------------------


def new_context() -> Callable[[bool], Any] | None:
    """A context of tracing that JAX's caches tell apart: what was traced in another one is traced again.

    Returns:
        `jax.make_user_context(False)`; None where JAX has none. Then there is no machine code: a program that was
        traced with it would be taken for the one without.
    """
    return jax.make_user_context(False) if hasattr(jax, "make_user_context") else None


def is_jit_disabled() -> bool:
    """Whether `jax.disable_jit` is in force: then nothing is lowered, and machine code cannot be called.

    Without the setting, or with another name, False: an operation that is evaluated one by one would then fail with
    JAX's own error.
    """
    return bool(getattr(jax.config, "jax_disable_jit", False))


def is_dropped(variable: Any) -> bool:
    """Whether nothing reads a result of an operation. JAX has no public name for what stands in its place.

    By the name of its type: with another name it is False, and derivatives or outputs are made that nobody reads. JAX
    0.10 makes them only where it takes derivatives in reverse (`tracers_to_jaxpr`).
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

COMPILING = "backend_compile_and_load", "backend_compile"
"""Names of the function of `jax._src.compiler` that hands a program to XLA: the second one in JAX 0.6."""


def wrap_compilation(wrapper: Callable[[Callable], Callable]) -> bool:
    """Put a function around the one with which JAX hands a program to XLA.

    Args:
        wrapper: from that function to the one in its place. Once in its place it is left there.

    Returns:
        Whether JAX has such a function.
    """
    place = _compiling()
    if place is None:
        return False
    compiler, name = place
    function = getattr(compiler, name)
    if not hasattr(function, _WRAPPED):
        wrapped = wrapper(function)
        setattr(wrapped, _WRAPPED, True)
        setattr(compiler, name, wrapped)
    return True


_WRAPPED = "__spherejax_wraps__"


def _compiling() -> tuple[Any, str] | None:
    try:
        from jax._src import compiler
    except ImportError:
        return None
    return next(((compiler, name) for name in COMPILING if hasattr(compiler, name)), None)


def with_backend_option(options: Any, name: str) -> Any:
    """Options of one program and one more of those that XLA reads from `xla_backend_extra_options`.

    JAX sets options of a program by name, but no list of them. They are a message of Protocol Buffers: two that are
    written one behind the other are read as one, so the list is put behind.

    Args:
        options: a `CompileOptions` of jaxlib. Anything else is given back.
        name: of the option.

    Returns:
        Another `CompileOptions`; the same one where jaxlib does not read what is written here.
    """
    if type(options).__name__ != "CompileOptions":
        return options
    behind = _field(1, name.encode()) + _field(2, b"")  # an entry of a map: the name, and no value
    for number in reversed(_PATH):
        behind = _field(number, behind)
    try:
        more = type(options).ParseFromString(options.SerializeAsString() + behind)
    except (AttributeError, TypeError, ValueError, RuntimeError):
        return options
    # Of a message that it cannot read jaxlib says nothing, and takes what it has read.
    return more if name.encode() in more.SerializeAsString() else options


_PATH = 3, 3, 500
"""Numbers of the fields from `CompileOptionsProto` to its `executable_build_options`, to their `debug_options`, to
`xla_backend_extra_options` (`xla/pjrt/proto/compile_options.proto`, `xla/xla.proto`)."""


def _field(number: int, content: bytes) -> bytes:
    """A field whose content has a length, as Protocol Buffers write it."""
    return _of_any_length(number << 3 | 2) + _of_any_length(len(content)) + content


def _of_any_length(number: int) -> bytes:
    """Seven bits of it in each byte, the lowest first; the eighth one says that more follow."""
    more, rest = divmod(number, 128)
    return bytes([rest]) if not more else bytes([rest | 128]) + _of_any_length(more)


# The check ------------------------------------------------------------------------------------------------------------

# `program_cache/private.py` has the same loop over parts of its own, and `is_jit_disabled` and `n_devices`, too. The
# compiler and the cache may be taken out of spherejax alone, so neither imports the other: these lines stand twice.


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
    # One carried number, and neither a constant nor a slice: the names alone may still be there with another meaning.
    closed = jax.make_jaxpr(lambda x: jax.lax.scan(lambda c, _: (c * 2, c), x, None, length=2))(1.0)
    (loop,) = (equation for equation in closed.jaxpr.eqns if equation.primitive.name == "scan")
    try:
        return counts_of_scan(loop.params) == (0, 1)
    except (KeyError, AttributeError):
        return False


def _is_known_jaxlib() -> bool:
    first, last = ffi_abi.KNOWN_JAXLIB
    return first <= xla_flags.installed_jaxlib() <= last


def _has_in_core(name: str) -> bool:
    return hasattr(core, name)


def _has_setting(name: str) -> bool:
    return name in jax.config.values


def _has_bridge() -> bool:
    from jax._src import xla_bridge

    return hasattr(xla_bridge, "backends_are_initialized")


def _takes(options: Mapping[str, Any]) -> bool:
    """Whether XLA takes options of a program."""
    # XLA has no list of its options. It refuses an unknown one when it compiles.
    try:
        jax.jit(lambda x: x + 1.0).lower(1.0).compile(compiler_options=dict(options))
    except jax.errors.JaxRuntimeError:
        return False
    return True


def _takes_backend_option() -> bool:
    from jaxlib import xla_client

    options = xla_client.CompileOptions()
    return with_backend_option(options, "xla_of_nobody") is not options


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
    defines = f"#define XLA_FFI_API_MAJOR {ffi_abi.API_MAJOR}", f"#define XLA_FFI_API_MINOR {ffi_abi.API_MINOR}"
    return all(line in lines for line in defines)


_NO_MACHINE_CODE = "no machine code, with one warning: XLA compiles everything, and first calls take longer"

_NO_OPTION_OF_ONE_PROGRAM = "kernels have one result each (several_results.py): what XLA compiles of a run is slower"

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
        "options of one program, " + " and ".join(xla_flags.FAST_COMPILE),
        "programs are compiled without them, which takes a quarter longer for large ones",
        lambda: _takes(xla_flags.FAST_COMPILE),
    ),
    PrivatePart(
        "jax._src.compiler.backend_compile_and_load",
        _NO_OPTION_OF_ONE_PROGRAM,
        lambda: _compiling() is not None,
    ),
    PrivatePart("fields of jaxlib's CompileOptions", _NO_OPTION_OF_ONE_PROGRAM, _takes_backend_option),
    PrivatePart(
        "a jaxlib of which it is known whether it has " + xla_flags.LIBRARY,
        "the flag is not set: a kernel with a sum or a product of matrices may fail to compile",
        xla_flags.has_library,
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

"""What must be set before JAX's backend starts: 64-bit numbers and three compiler flags for the CPU.

The first flag lets XLA compile a whole `while` loop (a whole integration) into one native function; by default it
does so for tiny loops only. The second lets one fusion have several outputs. Together with the scalar program of
`spherejax.foundations.scalarize` they make a right-hand side 15 to 30 times faster; neither helps code that calls
LAPACK or multiplies matrices inside the loop.

A third one lets the compiler use vectors of 512 bits where the processor has them (by default 256, even there), which
takes a tenth off a step of a block of lanes. It is a preference: a processor without them is none the worse.
"""

import _thread
import os
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import jax

_BACKEND_OPTION = "--xla_backend_extra_options="
_LOOP_OPTIONS = (
    "xla_cpu_small_while_loop_byte_threshold=1000000000",
    "xla_cpu_use_multi_output_fusion",
)
_VECTOR_WIDTH = "--xla_cpu_prefer_vector_width"


class ConfigurationWarning(UserWarning):
    """The process is configured in a way that makes runs slower or less exact than they could be."""


class PrecisionError(RuntimeError):
    """JAX runs in 32-bit mode, which cannot carry penetrations of 1e-8 m beside positions of 0.1 m."""


def configure(*, cache: str | os.PathLike | None = None) -> None:
    """Switch on 64-bit numbers and the compiler flags; called by `import spherejax`.

    Set the environment variable `SPHEREJAX_CONFIGURE=0` before the import to opt out. Flags that the user has set
    already are kept. When JAX's backend has started before the call, the flags come too late: one warning says so
    (64-bit mode still takes effect for arrays made from then on).

    Args:
        cache: a folder for JAX's persistent compilation cache; None leaves JAX's own setting.
    """
    jax.config.update("jax_enable_x64", True)
    if cache is not None:
        jax.config.update("jax_compilation_cache_dir", os.fspath(cache))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    flags = os.environ.get("XLA_FLAGS", "")
    wanted = _with_flags(flags)
    if wanted == flags:
        return
    if _backend_started():
        warnings.warn(
            "spherejax was imported after JAX's backend had started, so its compiler flags cannot take effect and "
            "runs will be several times slower. Import spherejax before the first JAX computation, or set "
            f"XLA_FLAGS={wanted!r} yourself.",
            ConfigurationWarning,
            stacklevel=3,
        )
        return
    os.environ["XLA_FLAGS"] = wanted


AGAIN_AFTER = 0.01
"""When a lost interrupt is raised again [s]."""


@contextmanager
def interrupts_kept() -> Iterator[None]:
    """Ctrl-C is heard at whatever moment it comes.

    Python drops an exception that is raised in a callback, and JAX has one for each collection of garbage: while
    programs were traced and compiled, one interrupt in eight was lost there. It is raised again a moment later.

    Only the main thread is interrupted; in others nothing is done, for the hook belongs to the whole process.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    reported_before = sys.unraisablehook

    def heard(lost: Any) -> None:
        if lost.exc_type is KeyboardInterrupt:
            # Not at once: here it would be dropped like the first one.
            again = threading.Timer(AGAIN_AFTER, _thread.interrupt_main)
            again.daemon = True
            again.start()
        else:
            reported_before(lost)

    sys.unraisablehook = heard
    try:
        yield
    finally:
        sys.unraisablehook = reported_before


def require_float64() -> None:
    """Raise `PrecisionError` when JAX is in 32-bit mode."""
    if not jax.config.read("jax_enable_x64"):
        raise PrecisionError(
            "JAX is in 32-bit mode (jax_enable_x64 is False), which cannot resolve a penetration of 1e-8 m beside a "
            "position of 0.1 m. Call spherejax.runtime.configure() before you make arrays, or set JAX_ENABLE_X64=1."
        )


def _with_flags(flags: str) -> str:
    """`flags` with ours added, but for those that are set; XLA reads one list of extra options only."""
    words = flags.split()
    if _VECTOR_WIDTH not in flags:
        words.append(f"{_VECTOR_WIDTH}=512")
    missing = ",".join(option for option in _LOOP_OPTIONS if option.split("=")[0] not in flags)
    if not missing:
        return flags if _VECTOR_WIDTH in flags else " ".join(words)
    for position, word in enumerate(words):
        if word.startswith(_BACKEND_OPTION):
            words[position] = f"{word},{missing}"
            return " ".join(words)
    return " ".join([*words, _BACKEND_OPTION + missing])


def _backend_started() -> bool:
    try:
        from jax._src import xla_bridge

        return xla_bridge.backends_are_initialized()
    except (ImportError, AttributeError):  # a private function: without it we assume the usual case
        return False

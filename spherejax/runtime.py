"""What must be set before JAX's backend starts: 64-bit numbers, flags of XLA (`compiler.hooks`), a folder for programs.

Compiled programs are kept in the user's cache folder, so that the next process need not compile them again.
"""

import _thread
import os
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from spherejax.compiler import hooks
from spherejax.program_cache import folders


class ConfigurationWarning(UserWarning):
    """The process is configured in a way that makes runs slower or less exact than they could be."""


class PrecisionError(RuntimeError):
    """JAX runs in 32-bit mode, which cannot carry penetrations of 1e-8 m beside positions of 0.1 m."""


OFF, ON = ("0", "off", "no", "false"), ("1", "on", "yes", "true")
"""Words of `SPHEREJAX_CACHE` that are no folders: taken for ones, they would be made where the process stands."""


def configure(*, cache: str | os.PathLike | None = None) -> None:
    """Switch on 64-bit numbers, the compiler flags and the cache; called by `import spherejax`.

    Set the environment variable `SPHEREJAX_CONFIGURE=0` before the import to opt out. Flags that the user has set
    already are kept; with one of these flags XLA (jaxlib 0.10) cannot compile every program of yours, see
    `docs/howto/platforms.md`. When JAX's backend has started before the call, the flags come too late: one warning says
    so (64-bit mode still takes effect for arrays made from then on).

    Args:
        cache: a folder for compiled programs. None: the folder that the environment variable `SPHEREJAX_CACHE` names,
            or else `spherejax` in the user's cache folder ($XDG_CACHE_HOME, or ~/.cache). `SPHEREJAX_CACHE=0` (also
            `off`, `no`, `false`) switches that off; `1`, `on`, `yes` and `true` are that folder. Where JAX has been
            told of a compilation cache already, it keeps that one for what it compiles.

    The files of the cache are code that is executed. Where somebody else could have written them, one
    `ConfigurationWarning` says so, and the process does without a cache; see `program_cache.folders`.

    Raises:
        OSError: when the folder that was asked for cannot be written to. The user's own is then done without.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    _keep_programs(cache)
    flags = os.environ.get("XLA_FLAGS", "")
    wanted = hooks.with_xla_flags(flags)
    if wanted == flags:
        return
    if hooks.has_backend_started():
        warnings.warn(
            "spherejax was imported after JAX's backend had started, so its compiler flags cannot take effect and "
            "runs will be several times slower. Import spherejax before the first JAX computation, or set "
            f"XLA_FLAGS={wanted!r} yourself.",
            ConfigurationWarning,
            stacklevel=3,
        )
        return
    os.environ["XLA_FLAGS"] = wanted


def set_up() -> None:
    """Configure this process, unless `SPHEREJAX_CONFIGURE=0` says that somebody else does."""
    if os.environ.get("SPHEREJAX_CONFIGURE", "1") != "0":
        configure()


def is_command() -> bool:
    """Whether this process is the command `spherejax`, which sets itself up when it has read its arguments.

    JAX takes longer to load than help, or an error in an argument, may take.
    """
    words = sys.orig_argv
    module = words[words.index("-m") + 1 :][:1] if "-m" in words[:-1] else []
    return module == ["spherejax"] or Path(next(iter(sys.argv), "")).stem == "spherejax"


def _keep_programs(asked: str | os.PathLike | None) -> None:
    named = os.environ.get("SPHEREJAX_CACHE", "")
    if asked is None and named.lower() in OFF:
        return
    if named.lower() in ON:
        named = ""
    try:
        folder = folders.use(Path(asked or named or _users_own()))
    except OSError:
        if asked is None:
            return
        raise
    import jax

    before = jax.config.values["jax_compilation_cache_dir"]
    if folder.why_not:
        if before and Path(before).parent == folder.path:  # of an earlier call
            jax.config.update("jax_compilation_cache_dir", None)
        warnings.warn(
            f"nothing is kept in {str(folder.path)!r}: {folder.why_not}. Its files are code that is executed, and "
            "somebody else could have written them, so each process compiles anew. Delete the folder, or name one in a "
            "place that is yours alone (SPHEREJAX_CACHE=...); SPHEREJAX_CACHE=0 does without, and without this warning",
            ConfigurationWarning,
            stacklevel=4,
        )
        return
    if before and asked is None:
        return
    jax.config.update("jax_compilation_cache_dir", os.fspath(folder.compiled))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def _users_own() -> Path:
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "spherejax"
    except RuntimeError as error:  # nobody's home, as in some containers
        raise OSError(str(error)) from error


AGAIN_AFTER = 0.01
"""When a lost interrupt is raised again [s]."""


LONGEST_WAIT = 0.5 if os.name == "nt" else None
"""Timeout of a wait for other threads [s]. Windows delivers Ctrl-C after a wait, not during it (bpo-35935); other
systems need no timeout."""


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
    import jax

    if not jax.config.read("jax_enable_x64"):
        raise PrecisionError(
            "JAX is in 32-bit mode (jax_enable_x64 is False), which cannot resolve a penetration of 1e-8 m beside a "
            "position of 0.1 m. Call spherejax.runtime.configure() before you make arrays, or set JAX_ENABLE_X64=1."
        )

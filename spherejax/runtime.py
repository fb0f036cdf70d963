"""What must be set before JAX's backend starts: 64-bit numbers, four compiler flags, a folder for programs.

The first flag lets XLA compile a whole `while` loop (a whole integration) into one native function; by default it
does so for tiny loops only. The second lets one fusion have several outputs. Together with the scalar program of
`compiler.program` they make a right-hand side 15 to 30 times faster; neither helps code that calls LAPACK
or multiplies matrices inside the loop.

A third one lets the compiler use vectors of 512 bits where the processor has them (by default 256, even there), which
takes a tenth off a step of a block of lanes. It is a preference: a processor without them is none the worse.

The fourth keeps XLA from handing sums and products of matrices to a library (YNNPACK). It does so also within what is
to be one kernel (`compiler.native.loop_fusion`), and then cannot write it (jaxlib 0.10).

Compiled programs are kept in the user's cache folder, so that the next process need not compile them again.
"""

import _thread
import hashlib
import os
import platform
import stat
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

_BACKEND_OPTION = "--xla_backend_extra_options="
_LOOP_OPTIONS = (
    "xla_cpu_small_while_loop_byte_threshold=1000000000",
    "xla_cpu_use_multi_output_fusion",
)
_VECTOR_WIDTH = "--xla_cpu_prefer_vector_width"
_LIBRARY = "--xla_cpu_experimental_ynn_fusion_type"


class ConfigurationWarning(UserWarning):
    """The process is configured in a way that makes runs slower or less exact than they could be."""


class PrecisionError(RuntimeError):
    """JAX runs in 32-bit mode, which cannot carry penetrations of 1e-8 m beside positions of 0.1 m."""


def configure(*, cache: str | os.PathLike | None = None) -> None:
    """Switch on 64-bit numbers, the compiler flags and the cache; called by `import spherejax`.

    Set the environment variable `SPHEREJAX_CONFIGURE=0` before the import to opt out. Flags that the user has set
    already are kept. When JAX's backend has started before the call, the flags come too late: one warning says so
    (64-bit mode still takes effect for arrays made from then on).

    Args:
        cache: a folder for compiled programs. None: the folder that the environment variable `SPHEREJAX_CACHE` names,
            or else `spherejax` in the user's cache folder ($XDG_CACHE_HOME, or ~/.cache). `SPHEREJAX_CACHE=0` switches
            that off. Where JAX has been told of a compilation cache already, it keeps that one for what it compiles.

    The files of the cache are code that is executed. Where somebody else could have written them, one
    `ConfigurationWarning` says so, and the process does without a cache; see `why_not_private`.

    Raises:
        OSError: when the folder that was asked for cannot be written to. The user's own is then done without.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    _keep_programs(cache)
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


LARGEST_CACHE = 2 * 2**30
"""Bytes that are kept; what was not used for longest goes first."""

LOOKED_AT_AGAIN_AFTER = 3600.0
"""How often the size of the folder is looked at [s], at the start of a process."""

KEPT = "kept"
"""Folder in the cache of what this package keeps itself; see `program_cache.disk_cache`."""

_kept: list[Path] = []


def cache_folder() -> Path | None:
    """Where programs are kept; None where they are not."""
    return _kept[-1] if _kept else None


def _keep_programs(asked: str | os.PathLike | None) -> None:
    named = os.environ.get("SPHEREJAX_CACHE", "")
    if asked is None and named == "0":
        return
    try:
        folder = Path(asked or named or _users_own()).absolute()
        # One folder for each kind of processor: homes are shared between machines, compiled programs must not be.
        compiled = folder / f"compiled-{kind_of_processor()}"
        _make_private(compiled)
        if not os.access(compiled, os.W_OK):
            raise PermissionError(f"no permission to write to {compiled}")
        # Links are followed now: where they lead later is not looked at again.
        folder, compiled = folder.resolve(), compiled.resolve()
        why = why_not_private(compiled)
        if not why and (folder / KEPT).exists():  # its files are looked at when they are opened
            why = why_not_private(folder / KEPT, with_files=False)
    except OSError:
        if asked is None:
            return
        raise
    import jax

    if why:
        _do_without(folder, why)
        return
    _kept[:] = [folder]
    _make_room(folder)
    if jax.config.values["jax_compilation_cache_dir"] and asked is None:
        return
    jax.config.update("jax_compilation_cache_dir", os.fspath(compiled))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def _make_private(folder: Path) -> None:
    """Make a folder, and those above it that are missing, so that nobody else can enter, whatever the umask says."""
    for each in reversed((folder, *folder.parents)):
        if not each.exists():
            each.mkdir(mode=0o700, exist_ok=True)


def _do_without(folder: Path, why: str) -> None:
    import jax

    _kept.clear()
    now = jax.config.values["jax_compilation_cache_dir"]
    if now and Path(now).parent == folder:  # of an earlier call
        jax.config.update("jax_compilation_cache_dir", None)
    warnings.warn(
        f"nothing is kept in {str(folder)!r}: {why}. Its files are code that is executed, and somebody else could have "
        "written them, so each process compiles anew. Delete the folder, or name one in a place that is yours alone "
        "(SPHEREJAX_CACHE=...); SPHEREJAX_CACHE=0 does without, and without this warning",
        ConfigurationWarning,
        stacklevel=5,
    )


def why_not_private(folder: Path, *, with_files: bool = True) -> str:
    """Why another user could have written a file of a folder, in words; empty where none could.

    The rules are those of ssh for its keys. The folder, its files and all folders above it belong to the user or to
    root, and others may write none of them. They may write a folder above that is sticky, such as `/tmp`, in which
    nobody moves what belongs to others. Where others cannot enter the folder, it does not matter whether they could
    write its files.

    "Others" are not the members of a group that has the user's name, is the user's main group, and has no further
    members: with a umask of 002, as on Debian and Fedora, all folders may be written by such a group.

    Args:
        folder: an absolute path without links, of a folder that exists. Systems without owners of files, such as
            Windows, have no answer but "".
        with_files: whether its files are looked at; it takes 2 us for each on a local disk.
    """
    if not hasattr(os, "getuid"):
        return ""
    own = folder.stat()
    if why := _why_others(folder, own, may_enter=True):
        return why
    for above in folder.parents:
        status = above.stat()
        if _is_unmapped(status.st_uid) and not _is_open(status):
            continue
        if why := _why_others(above, status, may_enter=not status.st_mode & stat.S_ISVTX):
            return why
    if with_files:
        may_enter = bool(own.st_mode & (stat.S_IXGRP | stat.S_IXOTH))
        with os.scandir(folder) as entries:
            for entry in entries:
                if why := _why_others(Path(entry.path), entry.stat(follow_symlinks=False), may_enter=may_enter):
                    return why
    return ""


def _why_others(path: Path, status: os.stat_result, *, may_enter: bool) -> str:
    """Why others than the user and root could have written something, in words."""
    if status.st_uid not in (0, os.getuid()):
        return f"{str(path)!r} belongs to {_user(status.st_uid)}"
    return f"others may write to {str(path)!r}" if may_enter and _is_open(status) else ""


def _is_open(status: os.stat_result) -> bool:
    """Whether somebody besides its owner and root may write."""
    by_group = status.st_mode & stat.S_IWGRP and not _is_private(status.st_gid)
    return bool(status.st_mode & stat.S_IWOTH or by_group)


@cache
def _is_private(group: int) -> bool:
    """Whether nobody but the user, and root, is in a group."""
    import grp
    import pwd

    try:
        user, found = pwd.getpwuid(os.getuid()), grp.getgrgid(group)
    except KeyError:  # a container that does not know its user
        return False
    is_users = (found.gr_name, group) == (user.pw_name, user.pw_gid)
    return set(found.gr_mem) <= {user.pw_name, "root"} and (is_users or group == 0)


def _user(uid: int) -> str:
    import pwd

    try:
        return f"the user {pwd.getpwuid(uid).pw_name!r}"
    except KeyError:
        return f"another user ({uid})"


@cache
def _is_unmapped(uid: int) -> bool:
    """Whether this number stands for all users that a container does not know, root among them.

    So in Apptainer without privileges: folders above a home belong to "nobody" there.
    """
    try:
        rows = Path("/proc/self/uid_map").read_text().splitlines()
        overflow = int(Path("/proc/sys/kernel/overflowuid").read_text())
        ranges = [range(int(first), int(first) + int(n)) for first, _, n in map(str.split, rows)]
    except (OSError, ValueError):
        return False
    return uid == overflow and not any(uid in each for each in ranges)


def _users_own() -> Path:
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "spherejax"
    except RuntimeError as error:  # nobody's home, as in some containers
        raise OSError(str(error)) from error


def _make_room(folder: Path) -> None:
    """Let go of what has not been used for longest, where the folder has grown too large.

    JAX has a bound of its own, for which it reads two files for each that is there whenever it writes one.
    """
    looked = folder / "looked-at"
    try:
        if looked.exists() and time.time() - looked.stat().st_mtime < LOOKED_AT_AGAIN_AFTER:
            return
        looked.touch()
        files = [file for part in (KEPT, "compiled-*") for file in folder.glob(f"{part}/*")]
        found = sorted(((max(each.st_atime, each.st_mtime), each.st_size, file) for file, each in _sized(files)))
        total = sum(size for _, size, _ in found)
        for _, size, file in found:
            if total <= LARGEST_CACHE:
                return
            file.unlink(missing_ok=True)
            total -= size
    except OSError:  # another process makes room as well, or the folder may be read only
        return


def _sized(files: list[Path]) -> Iterator[tuple[Path, os.stat_result]]:
    for file in files:
        with suppress(FileNotFoundError):
            yield file, file.stat()


_WORDS_OF_PROCESSORS = frozenset(
    ["processor", "model name", "flags", "Features", "CPU implementer", "CPU architecture", "CPU variant", "CPU part"]
)
"""Fields of /proc/cpuinfo that tell processors apart: x86 has a name and flags, ARM features and numbers for a name."""


def _name_of_apples() -> str:
    """The processor of a Mac, e.g. "Apple M2"; `platform.processor` says "arm" of all of them.

    A home that was copied from an M4 to an M1 contains programs that an M1 cannot run.
    """
    import subprocess

    command = ["/usr/sbin/sysctl", "-n", "machdep.cpu.brand_string"]
    try:
        return subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=10, check=True).stdout
    except (OSError, subprocess.SubprocessError):
        return platform.processor()


@cache
def kind_of_processor() -> str:
    """A short name of what the compiler makes its code for."""
    words = {"machine": platform.machine(), "system": platform.system()}
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            for line in file:  # one processor after the other, each in as many lines; all are of a kind
                name = line.partition(":")[0].strip()
                if name == "processor" and name in words:
                    break
                if name in _WORDS_OF_PROCESSORS:
                    words[name] = line
    except OSError:
        words["name"] = platform.processor() if sys.platform != "darwin" else _name_of_apples()
    return hashlib.sha256(repr(sorted(words.items())).encode()).hexdigest()[:8]


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


def _with_flags(flags: str) -> str:
    """`flags` with ours added, but for those that are set; XLA reads one list of extra options only."""
    words = flags.split()
    if _VECTOR_WIDTH not in flags:
        words.append(f"{_VECTOR_WIDTH}=512")
    if _LIBRARY not in flags and _knows_library():
        words.append(f"{_LIBRARY}=")
    missing = ",".join(option for option in _LOOP_OPTIONS if option.split("=")[0] not in flags)
    if not missing:
        return flags if words == flags.split() else " ".join(words)
    for position, word in enumerate(words):
        if word.startswith(_BACKEND_OPTION):
            words[position] = f"{word},{missing}"
            return " ".join(words)
    return " ".join([*words, _BACKEND_OPTION + missing])


def _knows_library() -> bool:
    """Whether XLA has the flag: one that it does not know ends the process."""
    from importlib.metadata import version

    return (0, 10) <= tuple(map(int, version("jaxlib").split(".")[:2])) <= (0, 12)


def _backend_started() -> bool:
    try:
        from jax._src import xla_bridge

        return xla_bridge.backends_are_initialized()
    except (ImportError, AttributeError):  # a private function: without it we assume the usual case
        return False

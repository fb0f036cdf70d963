"""Programs on disk, for the next process, which loads them in a fraction of the time that tracing and compiling takes.

An entry is found by a key over everything that it was made from: the arguments, the sources of the package, the
versions of what it stands on, and the settings of JAX. Where that is not known for certain nothing is written, and the
entry is made as if there were no cache: it depends on user code, a function of the package has been replaced, a source
file has changed since the process began, or a package is not an installed one (`package_state`). Patches of JAX itself
are not seen: switch the cache off then.

A fault of the folder (damaged files, a full disk, no permission) never reaches the caller: the entry is made again, and
written over. A file is written beside its place and then moved there, so that processes may share the folder.

Security: files are pickles and machine code, and loading one executes it. A file is read only if it belongs to the user
and nobody else may write it, and only if it contains the hash of its key and its content: a file that was cut off, or
copied over another one, is not loaded.
"""

import hashlib
import io
import os
import pickle
import stat
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import jax
from jax.extend.core import Primitive

from spherejax.program_cache import folders
from spherejax.program_cache.fingerprints import known_fingerprint
from spherejax.program_cache.package_state import package_state
from spherejax.program_cache.user_code import once

T = TypeVar("T")

_MARK = b"spherejax kept 2\n"
"""The first bytes of a file; a new number for a new format, since older files are not looked into."""

# Of each thread: a warning of one says nothing of what another one traces.
_tracing = threading.local()


def key_for(*what: Any) -> str | None:
    """The key on disk of what is made from some values; None where it must not be written.

    Args:
        *what: all that goes into it: functions of the package, values, parts of a `keys.CacheKey`. Constants of
            `Settings.constant_folders` are part of the key as they are now, others as they stand in the sources.
    """
    # Before the fingerprint, which takes longest: without a folder nobody would ask for the key.
    if folders.entries() is None or is_debugging():
        return None
    values = known_fingerprint(what)
    # One reading serves all keys of a call; see `user_code.read_once`.
    package = None if values is None else once("package", package_state)
    if values is None or package is None:
        return None
    return hashlib.sha256(f"{package}\0{values}".encode()).hexdigest()


def load_or_make(key: str | None, make: Callable[[], T], kind: type[T]) -> T:
    """The entry of a key; where there is none, or none of this kind, what `make` returns is written and returned."""
    value = load(key)
    if not isinstance(value, kind):
        value = make()
        save(key, value)
    return value


def load(key: str | None) -> Any:
    """The entry of a key; None where there is none, or none that is whole and the user's own."""
    folder = folders.entries()
    if key is None or folder is None:
        return None
    try:
        with open(folder / key, "rb") as file:
            # The file that is open is judged, not its name: that may stand for another file a moment later.
            content = file.read() if _is_own(os.fstat(file.fileno())) else b""
        # The digest is checked before anything is unpickled: a pickle executes what it says while it is read.
        head = len(_MARK) + 64
        if content[: len(_MARK)] != _MARK or content[len(_MARK) : head] != _digest_of(key, content[head:]):
            return None
        return pickle.loads(content[head:])
    except Exception:  # whatever the folder holds: the entry is made again
        return None


def save(key: str | None, value: Any) -> None:
    """Write an entry, where that is possible."""
    folder = folders.entries()
    if key is None or folder is None:
        return
    try:
        buffer = io.BytesIO()
        _Pickler(buffer, pickle.HIGHEST_PROTOCOL).dump(value)
        content = buffer.getvalue()
        # The mode counts where the folder is made here; one that exists was judged when it was chosen (`folders.use`).
        folder.mkdir(mode=0o700, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=folder, prefix=".new-")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(_MARK + _digest_of(key, content) + content)
            # At once, for whoever reads meanwhile; of two processes that write the same entry the last one stays.
            os.replace(name, folder / key)
        except BaseException:
            # Ctrl-C as well: nobody would ever look for the file again.
            os.unlink(name)
            raise
    except Exception:  # a full disk, no permission, a value that cannot be pickled: nothing is written
        return


@contextmanager
def record_warnings() -> Iterator[Callable[[], bool]]:
    """A function that says whether something has warned since the context was entered; see `note_warning`."""
    # A count instead of a flag: contexts are nested, and the inner one must not take the warning from the outer one.
    before = getattr(_tracing, "n_warnings", 0)
    yield lambda: getattr(_tracing, "n_warnings", 0) > before


def note_warning() -> None:
    """What is traced now must not be written: it has warned, and whoever loads it would not be warned.

    Called by code that warns while it is traced. `warnings.catch_warnings` would see it too, but changes the filters of
    all threads.
    """
    _tracing.n_warnings = getattr(_tracing, "n_warnings", 0) + 1


def is_debugging() -> bool:
    """Whether JAX is set to treat programs otherwise than usual, or has several places to run them in."""
    # A program on disk does what it was compiled for: it checks no NaN, leaks no tracer, and runs on one CPU.
    unusual = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs", "jax_check_tracer_leaks")
    # A setting that this version of JAX has under another name may be on.
    is_debugged = any(getattr(jax.config, name, True) for name in unusual)
    return is_debugged or jax.default_backend() != "cpu" or jax.device_count() > 1


# Files ----------------------------------------------------------------------------------------------------------------


def _is_own(file: os.stat_result) -> bool:
    # `mkstemp` writes with mode 600, so that others have no right to a file in folders of any mode. Windows has no such
    # owners and modes; there a user's folder is protected by its access list.
    others = stat.S_IWGRP | stat.S_IWOTH
    return not hasattr(os, "getuid") or (file.st_uid == os.getuid() and not file.st_mode & others)


def _digest_of(key: str, content: bytes) -> bytes:
    # With the key: three files copied over those of another scene gave its motion, and no error.
    return hashlib.sha256(key.encode() + b"\0" + content).hexdigest().encode()


class _Pickler(pickle.Pickler):
    """Writes JAX's primitives by their names: in another process they are other objects."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, Primitive):
            # Only those that the other process finds under the same name: another one would compute something else.
            if getattr(jax.lax, f"{obj.name}_p", None) is not obj:
                raise pickle.PicklingError(f"the operation {obj.name!r} is not one of jax.lax")
            return _primitive, (obj.name,)
        return NotImplemented


def _primitive(name: str) -> Primitive:
    return getattr(jax.lax, f"{name}_p")

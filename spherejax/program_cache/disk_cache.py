"""What was traced and compiled is kept on disk for the next process, which loads it in a fraction of the time.

A thing is found again by a key over everything that it was made from: the arguments, the sources of this package, the
versions of what it stands on, and the settings of JAX. Where that cannot be told for certain nothing is kept, and the
thing is made anew as if there were no store: code of a user's own is part of it, a function of this package has been
replaced, a source file has changed since the process began, or a package is not an installed one. What others patch in
JAX is not seen: set `SPHEREJAX_CACHE=0` then.

Whatever is wrong with the folder (damaged files, a full disk, no permission), a run does not notice. A file is written
beside its place and moved there, so that processes may share the folder. A file holds a hash of its key and its
content: what was copied over another file, or was cut off, is not loaded. What is not loaded is made anew, and written
over. The files are pickles, which can hold code: none is unpickled but the user's own, which nobody else may write.
"""

import hashlib
import io
import operator
import os
import pickle
import stat
import sys
import tempfile
import threading
import types
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax
from jax.extend.core import Primitive

from spherejax.program_cache import settings
from spherejax.program_cache.fingerprints import is_installed, known_fingerprint
from spherejax.program_cache.user_code import once

_MARK = b"spherejax kept 2\n"
_tracing = threading.local()


def key_for(*what: Any) -> str | None:
    """The key of what is made from some values; None where it must not be kept.

    Args:
        *what: all that goes into it: functions of this package, values and static parts of arguments. Constants of
            `Settings.constant_folders` are part of the key as they are now, others as they stand in the sources.
    """
    if _folder() is None or is_debugging():
        return None
    values = known_fingerprint(what)
    package = None if values is None else once("package", _package)
    if values is None or package is None:
        return None
    return hashlib.sha256(f"{package}\0{values}".encode()).hexdigest()


def load(key: str | None) -> Any:
    """What was kept under a key; None where there is nothing, or nothing whole."""
    folder = _folder()
    if key is None or folder is None:
        return None
    try:
        with open(folder / key, "rb") as file:
            content = file.read() if _is_own(os.fstat(file.fileno())) else b""
        head = len(_MARK) + 64
        if content[: len(_MARK)] != _MARK or content[len(_MARK) : head] != _digest_of(key, content[head:]):
            return None
        return pickle.loads(content[head:])
    except Exception:  # whatever the folder holds: it is made anew
        return None


def save(key: str | None, value: Any) -> None:
    """Keep a value under a key, where that can be."""
    folder = _folder()
    if key is None or folder is None:
        return
    try:
        buffer = io.BytesIO()
        _Pickler(buffer, pickle.HIGHEST_PROTOCOL).dump(value)
        content = buffer.getvalue()
        folder.mkdir(mode=0o700, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=folder, prefix=".new-")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(_MARK + _digest_of(key, content) + content)
            os.replace(name, folder / key)
        except BaseException:
            os.unlink(name)
            raise
    except Exception:  # a full disk, no permission, a value that cannot be written: nothing is kept
        return


@contextmanager
def listened() -> Iterator[Callable[[], bool]]:
    """A function that says whether something has warned since the context was entered; see `note_warning`."""
    before = getattr(_tracing, "n_warnings", 0)
    yield lambda: getattr(_tracing, "n_warnings", 0) > before


def note_warning() -> None:
    """What is traced now must not be kept: it has said something that whoever loads it must hear too."""
    _tracing.n_warnings = getattr(_tracing, "n_warnings", 0) + 1


# What a thing depends on besides its arguments ------------------------------------------------------------------------


def _folder() -> Path | None:
    return settings.current().folder()


def _is_own(file: os.stat_result) -> bool:
    # Written with mode 600, so that others have no right to them in folders of any mode.
    others = stat.S_IWGRP | stat.S_IWOTH
    return not hasattr(os, "getuid") or (file.st_uid == os.getuid() and not file.st_mode & others)


def is_debugging() -> bool:
    """Whether JAX is to do something else than usual with programs, or may run them in several places."""
    unusual = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs", "jax_check_tracer_leaks")
    is_debugged = any(getattr(jax.config, name) for name in unusual)
    return is_debugged or jax.default_backend() != "cpu" or jax.device_count() > 1


@lru_cache(maxsize=1)
def _sources() -> tuple[Path, ...]:
    folder = settings.current().sources
    return () if folder is None else tuple(sorted(folder.rglob("*.py")))


def _package() -> str | None:
    """This package as it is, and what it stands on; None where that cannot be told. It takes 5 ms each time."""
    constants = None if _has_changed() or not _are_versions_true() else _constants()
    return None if constants is None else f"{_code()}\0{constants}"


def _has_changed() -> bool:
    """Whether what is on disk may be something else than what was imported."""
    return any(file.stat().st_mtime >= settings.current().began for file in _sources())


def _are_versions_true() -> bool:
    """Whether packages that versions tell are installed: a checkout of JAX changes, and its version does not."""
    return all(is_installed(name, None) for name in settings.current().versioned if name in sys.modules)


@lru_cache(maxsize=1)
def _code() -> str:
    """The sources of this package and the versions of the others."""
    words = hashlib.sha256()
    told = settings.current()
    for file in _sources():
        words.update(str(file.relative_to(told.sources or "")).encode() + b"\0" + file.read_bytes() + b"\0")
    words.update(
        "\0".join(
            [sys.version, *(f"{name} {_version(name)}" for name in sorted({told.package, *told.versioned}))]
        ).encode()
    )
    return words.hexdigest()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


_SETTINGS = ("jax_enable_x64", "jax_default_matmul_precision", "jax_numpy_dtype_promotion", "jax_numpy_rank_promotion")


def _constants() -> str | None:
    """Settings of JAX and constants of this package as they are; None where a function of it has been replaced."""
    words = hashlib.sha256(os.environ.get("XLA_FLAGS", "").encode())
    words.update(repr([getattr(jax.config, name) for name in _SETTINGS]).encode())
    told = settings.current()
    # A list: another thread may be importing something.
    for name in sorted(name for name in list(sys.modules) if name.startswith(f"{told.package}.")):
        folder = name.split(".")[1]
        if folder not in told.constant_folders and folder not in told.watched_folders:
            continue
        module, found = sys.modules.get(name), _seen.get(name)
        if module is None:
            continue
        if found is None or not found.is_still_so(vars(module)):
            found = _seen[name] = _SeenModule(name, vars(module), with_constants=folder in told.constant_folders)
        if found.words is None:
            return None
        words.update(found.words)
    return words.hexdigest()


class _SeenModule:
    """A module of this package when its names were last looked up: to look at all of them takes 8 ms each time.

    Attributes:
        words: its constants; None where a function of it has been replaced.
    """

    def __init__(self, name: str, names: dict[str, Any], with_constants: bool):
        self._held = dict(names)
        self._classes = [
            (vars(value), dict(vars(value)))
            for value in self._held.values()
            if isinstance(value, type) and value.__module__ == name
        ]
        constants = []
        self.words: bytes | None = None
        for key, value in self._held.items():
            if type(value) in (int, float, bool, str, tuple):
                if with_constants and key == key.upper():
                    constants.append(f"{name}.{key}={value!r}\0")
            elif not _is_original(value, name):
                return
        self.words = "".join(constants).encode()

    def is_still_so(self, names: dict[str, Any]) -> bool:
        """Whether all names stand for what they stood for then."""
        return all(_is_same(now, then) for now, then in [(names, self._held), *self._classes])


_seen: dict[str, _SeenModule] = {}


def _is_same(now: Mapping[str, Any], then: dict[str, Any]) -> bool:
    """Whether names stand for the same objects, in the same order."""
    names, values = list(now), list(now.values())  # another thread may be importing something
    return names == list(then) and all(map(operator.is_, values, then.values()))


def _is_original(value: Any, module: str) -> bool:
    """Whether a name of a module of this package stands for a function or a class of ours, or of what is versioned."""
    if isinstance(value, types.FunctionType):
        return _is_known(value)
    if isinstance(value, type) and value.__module__ == module:
        return all(_is_known(each) for each in vars(value).values() if isinstance(each, types.FunctionType))
    return True


def _is_known(function: types.FunctionType) -> bool:
    # Methods of named tuples are in modules of their own.
    module = function.__module__ or ""
    return module.startswith("namedtuple_") or is_installed(module, function.__code__.co_filename)


# Files ----------------------------------------------------------------------------------------------------------------


def _digest_of(key: str, content: bytes) -> bytes:
    return hashlib.sha256(key.encode() + b"\0" + content).hexdigest().encode()


class _Pickler(pickle.Pickler):
    """Writes JAX's operations by their names."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, Primitive):
            if getattr(jax.lax, f"{obj.name}_p", None) is not obj:
                raise pickle.PicklingError(f"the operation {obj.name!r} is not one of jax.lax")
            return _primitive, (obj.name,)
        return NotImplemented


def _primitive(name: str) -> Primitive:
    return getattr(jax.lax, f"{name}_p")

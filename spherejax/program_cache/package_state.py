"""The state of the package: what a program depends on besides its arguments, as a part of every key on disk.

These are the sources of the package, the versions of the packages that it stands on, the settings of JAX and of XLA,
and the constants of the package as they are now. There is no state, and nothing is written to disk, where one of these
is uncertain: a source was edited after the process began to import it, a function or a class has been replaced (by a
test, or by a user who tries something), or a package is a checkout whose version does not change with its code.
"""

import hashlib
import operator
import os
import sys
import types
from collections.abc import Mapping
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax

from spherejax.program_cache import settings
from spherejax.program_cache.fingerprints import without_addresses
from spherejax.program_cache.installed import is_installed


def package_state() -> str | None:
    """A text that changes with the package and all that it stands on; None where it is uncertain.

    It takes 5 ms.
    """
    # The cheapest question first: where the answer is no, as while a developer edits, nothing else is asked.
    constants = None if _has_changed() or not _are_versions_true() else _constants()
    return None if constants is None else f"{_code(settings.current())}\0{constants}"


def sources() -> tuple[Path, ...]:
    """All Python files of the package."""
    return _files_in(settings.current().sources)


# By the folder, not for ever: settings of before (there are none until the package is attached) would stay otherwise.
@lru_cache(maxsize=4)
def _files_in(folder: Path | None) -> tuple[Path, ...]:
    # In an order of their own: that of a folder differs between file systems, and the key with it.
    return () if folder is None else tuple(sorted(folder.rglob("*.py")))


def _has_changed() -> bool:
    """Whether what is on disk may be something else than what was imported."""
    # Equal times count as changed: file systems round them, and an edit in the same second would not be seen.
    began = settings.current().began
    try:
        return any(file.stat().st_mtime >= began for file in sources())
    except OSError:  # an installer that replaces the package deletes its files: this process goes on without the disk
        return True


def _are_versions_true() -> bool:
    """Whether packages that versions tell are installed: a checkout of JAX changes, and its version does not."""
    # Only those that are loaded: what is not loaded has no part in a program.
    return all(is_installed(name, None) for name in settings.current().versioned if name in sys.modules)


@lru_cache(maxsize=4)
def _code(current: settings.Settings) -> str:
    """The sources of this package and the versions of the others."""
    # Once in a process: edits after that are seen by their times, in `_has_changed`.
    words = hashlib.sha256()
    for file in _files_in(current.sources):
        # With its name below the folder: the package may be installed anywhere, and a renamed file is another module.
        words.update(str(file.relative_to(current.sources or "")).encode() + b"\0" + file.read_bytes() + b"\0")
    names = sorted({current.package, *current.versioned})
    # Of Python the whole text: bytecode, and so fingerprints of functions, differ between builds of one version.
    words.update("\0".join([sys.version, *(f"{name} {_version(name)}" for name in names)]).encode())
    return words.hexdigest()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:  # a package that is optional, or one that is run from its sources
        return ""


# Those that change what a function is traced to. Arguments, such as the type of an array, are in the key anyway.
_SETTINGS = ("jax_enable_x64", "jax_default_matmul_precision", "jax_numpy_dtype_promotion", "jax_numpy_rank_promotion")


def _constants() -> str | None:
    """Settings of JAX and constants of this package as they are; None where a function of it has been replaced."""
    words = hashlib.sha256(os.environ.get("XLA_FLAGS", "").encode())
    words.update(repr([getattr(jax.config, name) for name in _SETTINGS]).encode())
    current = settings.current()
    # A list: another thread may be importing something.
    for name in sorted(name for name in list(sys.modules) if name.startswith(f"{current.package}.")):
        folder = name.split(".")[1]
        # A folder of which nothing is said is not looked at: a command line, figures, which no program is made of.
        if folder not in current.constant_folders and folder not in current.watched_folders:
            continue
        module, seen = sys.modules.get(name), _seen.get(name)
        if module is None:  # it was removed a moment ago
            continue
        if seen is None or not seen.is_still_so(vars(module)):
            seen = _seen[name] = _SeenModule(name, vars(module), with_constants=folder in current.constant_folders)
        if seen.words is None:
            return None
        words.update(seen.words)
    return words.hexdigest()


class _SeenModule:
    """A module of this package when its names were last looked up: to look at all of them takes 8 ms each time.

    Attributes:
        words: its constants; None where a function of it has been replaced.
    """

    def __init__(self, name: str, names: dict[str, Any], with_constants: bool):
        # The objects, not their addresses: that of one that is freed is given to the next one.
        self._held = dict(names)
        # Methods are replaced in the class, not in the module.
        self._classes = [
            (vars(value), dict(vars(value)))
            for value in self._held.values()
            if isinstance(value, type) and value.__module__ == name
        ]
        constants = []
        self.words: bytes | None = None
        for key, value in self._held.items():
            # Not instances of classes derived from these: an enumeration is a class of ours, and its members too.
            if type(value) in (int, float, bool, str, tuple):
                if with_constants and key == key.upper():
                    # A tuple may hold functions, whose texts have addresses: another process would find no entry.
                    constants.append(f"{name}.{key}={without_addresses(repr(value))}\0")
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
        return all(_is_known(method) for method in vars(value).values() if isinstance(method, types.FunctionType))
    return True


def _is_known(function: types.FunctionType) -> bool:
    # Methods of named tuples are in modules of their own.
    module = function.__module__ or ""
    return module.startswith("namedtuple_") or is_installed(module, function.__code__.co_filename)

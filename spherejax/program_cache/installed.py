"""Which code a version number identifies: that of Python, of installed packages, and of the package that is cached.

All other code is user code. It may change at any moment, and is read instead (`user_code`).
"""

import functools
import os
import site
import sys
import sysconfig
from importlib.metadata import distributions
from pathlib import Path

from spherejax.program_cache import settings


def top_level(module: str | None) -> str:
    """The first part of the name of a module."""
    return (module or "").split(".")[0]


def is_versioned(module: str | None) -> bool:
    """Whether the key on disk has the version of a module: of the package, what it stands on, and Python's own."""
    current, top = settings.current(), top_level(module)
    # `__main__` is among the names of the standard library, and is what a user has just typed.
    return top == current.package or top in current.versioned or (top in sys.stdlib_module_names and top != "__main__")


def module_of(kind: type) -> str | None:
    """The module that a class belongs to; None for one that only says that it is of Python's own.

    A class that `exec` makes without a `__name__` says that it is of `builtins`, one of `dataclasses.make_dataclass` or
    `types.new_class` that it is of `types`. Such a class is user code, and is not to be found there.
    """
    module = kind.__module__
    is_pythons_own = kind.__flags__ & (_HEAP_TYPE | _IMMUTABLE_TYPE) != _HEAP_TYPE
    if is_pythons_own or top_level(module) not in sys.stdlib_module_names or "<locals>" in kind.__qualname__:
        return module
    found: object = sys.modules.get(module)
    for name in kind.__qualname__.split("."):
        found = getattr(found, name, None)
    return module if found is kind else None


_HEAP_TYPE, _IMMUTABLE_TYPE = 1 << 9, 1 << 8
"""Flags of classes: made while a program runs, and not to be changed. Of those that Python code makes the first alone
stands (`Py_TPFLAGS_HEAPTYPE`, `Py_TPFLAGS_IMMUTABLETYPE`)."""


def is_installed(module: str | None, file: str | None) -> bool:
    """Whether code belongs to Python, an installed package, or the package that is cached.

    Args:
        module: the name of its module.
        file: from which it was compiled; None where only the module is known.
    """
    top = top_level(module)
    if top == settings.current().package or top in sys.builtin_module_names or top in sys.stdlib_module_names:
        return top != "__main__"
    file = file or getattr(sys.modules.get(module or ""), "__file__", None)
    # Frozen modules are in the interpreter itself. Code of which no file is known may be anything.
    if file is None or file.startswith(("<frozen", *_installed_folders())):
        return file is not None
    # `<string>`, `<ipython-input-...>`: somebody has typed it.
    return not file.startswith("<") and _is_distributed(file, tuple(sys.path))


def is_in_package(module: str | None, file: str | None) -> bool:
    """Whether the file of a function lies within its module's package: not where `functools.wraps` has lent a name."""
    folders = getattr(sys.modules.get(top_level(module)), "__path__", None)
    # With a separator behind the folder: `jax_tools` is not in `jax`.
    return file is None or any(file.startswith(os.path.join(folder, "")) for folder in folders or ())


@functools.lru_cache(maxsize=1)
def _installed_folders() -> tuple[str, ...]:
    paths = sysconfig.get_paths()
    folders = [paths[key] for key in ("stdlib", "platstdlib", "purelib", "platlib")]
    return tuple(str(Path(folder)) for folder in (*folders, site.getusersitepackages()))


# The search path is an argument: a user may extend it at any time.
@functools.lru_cache(maxsize=4096)
def _is_distributed(file: str, path: tuple[str, ...]) -> bool:
    """Whether a file belongs to a package that an installer has put into a folder of the search path.

    So packages of a cluster's modules (PYTHONPATH), of `pip install --target` and of `uv run --with` are recognized,
    which are in none of the interpreter's own folders. A user's modules may lie beside them: only what a distribution
    lists is installed.
    """
    for entry in path:
        folder = os.path.join(os.path.abspath(entry), "")
        if file.startswith(folder):
            # By the name alone: a folder of this name that an interpreter does not know is one of another interpreter,
            # or of a cluster's module, and is filled by installers.
            if os.path.basename(folder[:-1]) in ("site-packages", "dist-packages"):
                return True
            if file[len(folder) :].split(os.sep)[0] in _distributed_in(folder):
                return True
    return False


@functools.lru_cache(maxsize=64)
def _distributed_in(folder: str) -> frozenset[str]:
    """Folders and files of distributions that were installed into a folder.

    Those have a list of their files, `RECORD`. A project that its developer has installed (`pip install -e`) has none
    in its own folder, where `egg-info` lies: its code changes, and its version does not.
    """
    listed = (distribution.read_text("RECORD") or "" for distribution in distributions(path=[folder]))
    # A line is a path, a hash and a size; paths have slashes on all systems.
    return frozenset(line.split(",")[0].split("/")[0].strip('"') for text in listed for line in text.splitlines())

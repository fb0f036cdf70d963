"""What the program cache is told of the package that uses it: its name, its sources, and what else it is joined to.

The cache imports nothing of that package. The package calls `configure` once, before any program is compiled. Until
then programs are kept in memory alone.
"""

import time
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class ExtraBlobs:
    """Code that compiled programs call and that JAX does not write with them, such as object code of another compiler.

    Attributes:
        is_available: whether this process can run such code. Programs that can and programs that cannot differ, so this
            is a part of every key.
        record: a context whose value is a function that returns the blobs, by name, which programs that were lowered
            in the context call. They are written to disk with the program.
        load: makes blobs, by name, known to this process, before a program that calls them is loaded. Raises an error
            where this process cannot run them; the program is then compiled anew.
        note: tells the contexts of `record` around it that the program which is lowered now calls blobs, by name.
    """

    is_available: Callable[[], bool] = lambda: False
    record: Callable[[], AbstractContextManager[Callable[[], dict[str, bytes]]]] = lambda: nullcontext(dict)
    load: Callable[[dict[str, bytes]], None] = lambda blobs: None
    note: Callable[[Iterable[str]], None] = lambda names: None


@dataclass(frozen=True)
class Settings:
    """Settings of the cache.

    Attributes:
        package: top-level name of the package whose functions may be cached on disk. Code outside it, and outside the
            packages of `versioned`, is a user's own and is never written.
        sources: the folder of that package. All its Python files are a part of every key on disk.
        versioned: other packages whose versions tell their code. A key holds these versions.
        constant_folders: folders within `sources` whose modules are loaded whenever a key is made. The values of their
            constants (names in capitals) are a part of the key, so that a constant changed by hand is seen.
        watched_folders: folders within `sources` of which only functions and classes are watched: where one of them has
            been replaced, nothing is kept. Their modules may be loaded or not.
        compiling: a context around compiling, from what is compiled (words for whoever waits) and its name.
        tracing: a context around a function that is traced.
        extra_blobs: makes the hook for code that programs call; called when the first key is made.
        began: when the process began to import the package [s since 1970]. Where a source is newer, nothing is kept.
    """

    package: str = ""
    sources: Path | None = None
    # What traced programs are made of in any case; a package adds what its own functions call.
    versioned: frozenset[str] = frozenset({"jax", "jaxlib", "equinox", "numpy"})
    constant_folders: frozenset[str] = frozenset()
    watched_folders: frozenset[str] = frozenset()
    compiling: Callable[[str, str], AbstractContextManager] = lambda what, name: nullcontext()
    tracing: Callable[[], AbstractContextManager] = nullcontext
    extra_blobs: Callable[[], ExtraBlobs] = ExtraBlobs
    # Settings are made when the package is imported, before most of its modules are.
    began: float = field(default_factory=time.time)


# One for the process: JAX's primitives and its compilation cache are, too.
_settings = Settings()
_blobs: list[ExtraBlobs] = []


def configure(settings: Settings) -> None:
    """Tell the cache of the package that uses it: once in a process, before any program is compiled."""
    global _settings
    _settings = settings
    _blobs.clear()  # they belong to the settings of before


def current() -> Settings:
    """What the cache was told last."""
    return _settings


def extra_blobs() -> ExtraBlobs:
    """The hook for code that programs call."""
    if not _blobs:  # not in `configure`: what the hook stands on may take long to import
        _blobs.append(_settings.extra_blobs())
    return _blobs[0]

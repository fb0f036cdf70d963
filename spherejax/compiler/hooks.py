"""What joins the compiler to a host package and its process: a store of object code, warnings, tracing, flags of XLA.

The compiler imports nothing of the package that it is part of, and keeps nothing on disk itself. A host that has a disk
cache attaches it here, once, before anything is compiled. Without a host every process compiles for itself, warnings
are plain `UserWarning`s, and functions are traced as they are. The flags of XLA with which programs are fast have to be
set before JAX's backend starts; only the host can do so, and finds them here (`xla_flags`). This file imports no JAX.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

from spherejax.compiler.xla_flags import FAST_COMPILE, LESS_ALIASING, has_backend_started, with_xla_flags

__all__ = [
    "FAST_COMPILE",
    "LESS_ALIASING",
    "Hooks",
    "attach",
    "attached",
    "has_backend_started",
    "with_xla_flags",
]  # fmt: skip


@dataclass(frozen=True)
class Hooks:
    """What a host gives.

    Attributes:
        lookup: object code by its name. What is no `bytes` counts as none: a store may answer with anything that it
            finds under a name.
        save: keeps object code under a name; it must not raise.
        warning: the class of warnings about an installation that cannot compile machine code.
        tracing: a context around each function that is traced.
    """

    lookup: Callable[[str], Any] = lambda name: None
    save: Callable[[str, bytes], Any] = lambda name, content: None
    warning: type[Warning] = UserWarning
    tracing: Callable[[], AbstractContextManager] = nullcontext


_hooks = Hooks()


def attach(hooks: Hooks) -> None:
    """Attach what a host gives, in place of what was attached before."""
    global _hooks
    _hooks = hooks


def attached() -> Hooks:
    """What is attached now: read at each use, because a host may come after the import of what uses it."""
    return _hooks

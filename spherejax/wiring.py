"""Joins the program cache, the native compiler and this package: the one file that tells each of them of the others.

Neither the cache nor the compiler imports anything of the package. What they need of it is passed in here, by functions
that import what takes long when they are first called.
"""

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from spherejax import runtime
from spherejax.compiler import hooks
from spherejax.program_cache import settings


def connect() -> None:
    """Tell the program cache of this package, and the compiler of the program cache. It imports no JAX."""
    hooks.attach(hooks.Hooks(_lookup, _save, runtime.ConfigurationWarning, _tracing))
    settings.configure(
        settings.Settings(
            package=__name__.split(".")[0],
            sources=Path(__file__).resolve().parent,
            versioned=frozenset({
                "jax", "jaxlib", "equinox", "diffrax", "lineax", "optimistix", "optax", "jaxtyping", "numpy",
            }),
            # What every program is made of. Which studies are loaded depends on the user's program, so their constants
            # would make other keys of the same run.
            constant_folders=frozenset({"program_cache", "compiler", "foundations", "physics", "model", "motion"}),
            watched_folders=frozenset({"studies"}),
            compiling=_compiling,
            tracing=_tracing,
            extra_blobs=_object_code,
        )
    )  # fmt: skip


def _compiling(what: str, name: str) -> AbstractContextManager:
    from spherejax.foundations.terminals import waiting_for

    return waiting_for(what, name)


def _tracing() -> AbstractContextManager:
    from spherejax.foundations.checks import exits_as_errors

    return exits_as_errors()


def _lookup(name: str) -> Any:
    from spherejax.program_cache import disk_cache

    return disk_cache.load(name)


def _save(name: str, content: bytes) -> None:
    from spherejax.program_cache import disk_cache

    disk_cache.save(name, content)


def _object_code() -> settings.ExtraBlobs:
    from spherejax.compiler import native_code as native

    return settings.ExtraBlobs(
        native.is_available, native.record_ffi_targets, native.register_object_code, native.note_ffi_targets
    )

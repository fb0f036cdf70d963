"""A compiler for small functions: array code becomes a straight-line scalar program, and machine code of its own.

It knows nothing of mechanics, and imports nothing else of spherejax. `README.md` says how it works.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from spherejax.compiler import hooks, linear_algebra, runge_kutta
    from spherejax.compiler.graph import NotScalarizable
    from spherejax.compiler.native.array_programs import ArrayProgram
    from spherejax.compiler.native.switch import native_code
    from spherejax.compiler.program import ScalarProgram, scalarize

# A name is imported when it is first asked for: `hooks` is needed when the host package is imported, which must not
# import JAX (0.3 s).
_PLACES = {
    "ArrayProgram": ".native.array_programs",
    "NotScalarizable": ".graph",
    "ScalarProgram": ".program",
    "hooks": ".hooks",
    "linear_algebra": ".linear_algebra",
    "native_code": ".native.switch",
    "runge_kutta": ".runge_kutta",
    "scalarize": ".program",
}

__all__ = [
    "ArrayProgram", "NotScalarizable", "ScalarProgram", "hooks", "linear_algebra", "native_code",
    "runge_kutta", "scalarize",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(_PLACES[name], __name__)
    value = getattr(module, name, module)  # a module that is public stands for itself
    globals()[name] = value
    return value

"""What a Python function looks up when it runs, read off its bytecode."""

import dis
import functools
import sys
import types
from collections.abc import Iterator
from typing import Any

from spherejax.program_cache.installed import is_installed


def used_globals(function: types.FunctionType) -> Iterator[tuple[str, Any]]:
    """What a function and those within it look up in their module, and in user modules that are named there."""
    names = _names_in(function.__code__)
    for name in names:
        # Builtins, attributes and names that are not defined yet: bytecode has all of them in one list.
        if name not in function.__globals__:
            continue
        used = function.__globals__[name]
        yield name, used
        # `helpers.friction`: bytecode has both names, and does not say that one is looked up in the other.
        if isinstance(used, types.ModuleType) and not _is_installed_module(used):
            yield from ((f"{name}.{inner}", getattr(used, inner)) for inner in names if hasattr(used, inner))


def used_of_modules(function: types.FunctionType) -> Iterator[tuple[str, Any]]:
    """What a function may look up in user modules that it closes over, or imports itself."""
    names = _names_in(function.__code__)
    # A cell that has not been filled yet equals an empty one; to read it raises an error.
    inside = [cell.cell_contents for cell in function.__closure__ or () if cell != types.CellType()]
    # `import helpers` within a function leaves no global name; the module is found by its own.
    modules = [*inside, *(sys.modules.get(name) for name in names if name not in function.__globals__)]
    own = (module for module in modules if isinstance(module, types.ModuleType) and not _is_installed_module(module))
    for module in own:
        yield from ((f"{module.__name__}.{name}", getattr(module, name)) for name in names if hasattr(module, name))


@functools.lru_cache(maxsize=1024)
def assigned_in(code: types.CodeType) -> frozenset[str]:
    """Names outside a function that it, or one within it, assigns to."""
    # A name that is deleted is changed, too.
    operations = ("STORE_GLOBAL", "STORE_DEREF", "DELETE_GLOBAL", "DELETE_DEREF")
    names = {str(step.argval) for step in dis.get_instructions(code) if step.opname in operations}
    inner = (assigned_in(constant) for constant in code.co_consts if isinstance(constant, types.CodeType))
    return frozenset(names.union(*inner))


def _names_in(code: types.CodeType) -> list[str]:
    # A dictionary, not a set: the order is that of the code, the same in each process.
    names = dict.fromkeys(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            names.update(dict.fromkeys(_names_in(constant)))
    return list(names)


def _is_installed_module(module: types.ModuleType) -> bool:
    return is_installed(module.__name__, getattr(module, "__file__", None))

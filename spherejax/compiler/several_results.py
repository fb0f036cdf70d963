"""The option of XLA that lets one kernel have several results, for the programs that need it and for no other.

A scalar program that XLA compiles has many results, and without the option XLA computes all that two of them share
twice. XLA takes such an option from its flags, for all programs of a process. But with this one XLA (jaxlib 0.10) ends
the process where it compiles a loop with two reductions of pairs (`argmax`, `argmin`), whoever wrote it. So it is no
flag here: lowering rules mark the program that they write into, and `attach` puts a function around the one with which
JAX hands programs to XLA. It gives the option to marked programs with at most one such reduction.

Where JAX or XLA have changed what is private here the option is not given: programs are slower, and right.
"""

from collections.abc import Callable
from functools import cache, wraps
from typing import Any

from jax.extend.mlir import ir

from spherejax.compiler import private

OPTION = "xla_cpu_use_multi_output_fusion"

_MARK = "spherejax_has_several_results"


def mark(context: Any) -> None:
    """Mark the program that is being written as one that needs the option.

    Args:
        context: of a lowering rule.
    """
    attributes = context.module_context.module.operation.attributes
    kept = _frontend(attributes)
    if _MARK not in kept:
        attributes[private.ATTRIBUTES] = ir.DictAttr.get({**kept, _MARK: ir.StringAttr.get("true")})


def _frontend(attributes: Any) -> dict[str, ir.Attribute]:
    if private.ATTRIBUTES not in attributes:
        return {}
    return {named.name: named.attr for named in ir.DictAttr(attributes[private.ATTRIBUTES])}


def _needs(module: Any) -> bool:
    """Whether a program is marked, and XLA surely survives the option."""
    with module.context:
        if _MARK not in _frontend(module.operation.attributes):
            return False
        try:
            return _n_reductions_of_pairs(module) <= 1
        except (AttributeError, KeyError, TypeError, ValueError):  # a form of programs that we do not know
            return False


def _n_reductions_of_pairs(module: Any) -> int:
    """How many there are, at most, in what may become one piece of a program for XLA.

    It puts functions in the place of their calls, the body of a loop in the place of a loop of one turn, and one branch
    in the place of a choice that is known.
    """
    functions = {ir.StringAttr(f.attributes["sym_name"]).value: f.operation for f in module.body.operations}

    @cache
    def of_function(name: str) -> int:  # no function calls itself
        return sum(map(of_region, functions[name].regions))

    def of_region(region: Any) -> int:
        return sum(of_operation(operation.operation) for block in region for operation in block.operations)

    def of_operation(operation: Any) -> int:
        match operation.name:
            case "func.call":
                return of_function(ir.FlatSymbolRefAttr(operation.attributes["callee"]).value)
            case "stablehlo.reduce":
                return int(len(operation.results) > 1)
            case "stablehlo.case" | "stablehlo.if":
                return max(map(of_region, operation.regions), default=0)
        return sum(map(of_region, operation.regions))

    return of_function("main")


def attach() -> None:
    """Give the option to marked programs from now on; a second call changes nothing."""
    private.wrap_compilation(_with_option)


def _with_option(compiled: Callable) -> Callable:
    @wraps(compiled)
    def made(backend: Any, module: Any, *rest: Any, **named: Any) -> Any:
        if backend.platform == "cpu" and _needs(module):
            # Where JAX has the options among its arguments differs between its versions.
            rest = tuple(private.with_backend_option(argument, OPTION) for argument in rest)
            named = {name: private.with_backend_option(argument, OPTION) for name, argument in named.items()}
        return compiled(backend, module, *rest, **named)

    return made

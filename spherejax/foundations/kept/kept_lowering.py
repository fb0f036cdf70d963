"""Programs within other programs, kept as JAX has lowered them (StableHLO).

A user's function around `simulate` is traced and lowered in every process: nobody can tell what is in it. The runs in
it are most of that, and they are known. So their operation is lowered apart, once for all processes (see
`kept_on_disk`), and the user's program takes it in as a function that it calls. Then the program as a whole is the same
as in the process before, and JAX finds what it has compiled of it. A jitted run of a dry four-bar starts in half the
time in the next process, its gradient in 0.55 of it, the film's in 0.4.
"""

import io
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import jax
from jax.extend.mlir import ir, passmanager
from jax.extend.mlir.dialects import func
from jax.interpreters import mlir

from spherejax import runtime
from spherejax.foundations.kept import kept_on_disk
from spherejax.foundations.kept.bounded_jit import calls_python, make_lapack_known
from spherejax.foundations.kept.collecting import collecting_later
from spherejax.foundations.machine import code as machine_code


def kept_lowering(function: Callable[..., tuple]) -> Callable[..., Sequence]:
    """The rule that lowers an operation of several results, from what it computes; kept where that is possible.

    Args:
        function: of the operation's operands, with its parameters by name; code of this package.
    """
    anew = mlir.lower_fun(function, multiple_results=True)

    def rule(context: Any, *operands: Any, **parameters: Any) -> Sequence:
        outer = context.module_context.module
        examples = [jax.ShapeDtypeStruct(each.shape, each.dtype) for each in context.avals_in]
        key = _key(context, function, examples, parameters)
        if key is not None:
            with outer.context:
                module = _loaded(key) or _lowered(key, partial(function, **parameters), examples)
                if module is not None:
                    return _called(outer, f"kept_{key[:16]}", module, operands)
        return anew(context, *operands, **parameters)

    return rule


def _key(context: Any, function: Callable, examples: list, parameters: dict[str, Any]) -> str | None:
    if tuple(context.module_context.platforms) != ("cpu",):
        return None
    shapes = [(each.shape, str(each.dtype)) for each in examples]
    where = runtime.kind_of_processor(), machine_code.is_available()
    return kept_on_disk.key_for("lowered", function, shapes, parameters, *where)


def _loaded(key: str) -> Any:
    """The module that another process has lowered, or this one for another program; None where there is none."""
    found = kept_on_disk.load(key)
    with suppress(Exception):  # whatever is wrong with it: it is lowered anew
        content, codes = found
        module = ir.Module.parse(content)
        machine_code.make_known(codes)
        machine_code.note_called(codes)
        if b"lapack_" in content:
            make_lapack_known()
        return module
    return None


def _lowered(key: str, function: Callable, examples: list) -> Any:
    """The module, lowered now and kept; None where the program cannot be taken out of the process.

    Its `main` takes all operands and returns all results.
    """

    def to_be_lowered(
        *operands: Any,
    ) -> Any:  # its name is heard, of a partial function not always
        return function(*operands)

    with kept_on_disk.listened() as has_warned, machine_code.listened() as codes, collecting_later():
        traced = jax.jit(to_be_lowered, keep_unused=True).trace(*examples)
        if calls_python(traced.jaxpr.jaxpr):
            return None
        module: Any = traced.lower().compiler_ir("stablehlo")
    with module.context:
        passmanager.PassManager.parse("builtin.module(strip-debuginfo)").run(module.operation)
    main: Any = ir.SymbolTable(module.operation)["main"]
    if len(main.type.inputs) != len(examples):  # JAX can be told to make arguments of constants
        return None
    content = io.BytesIO()
    module.operation.write_bytecode(content)
    if not has_warned():
        kept_on_disk.save(key, (content.getvalue(), codes()))
    return ir.Module.parse(content.getvalue())


def _called(outer: Any, name: str, module: Any, operands: Sequence) -> Sequence:
    """The results of a call of a module's `main`; the outer module takes its functions in under names of their own."""
    if name not in ir.SymbolTable(outer.operation):
        _take_in(outer, name, module)
    function: Any = ir.SymbolTable(outer.operation)[name]
    return func.CallOp(function.type.results, ir.FlatSymbolRefAttr.get(name), list(operands)).results


def _take_in(outer: Any, name: str, module: Any) -> None:
    names = [operation.sym_name.value for operation in module.body.operations]
    new = {old: name if old == "main" else f"{name}_{old}" for old in names}
    for old in names:
        ir.SymbolTable.replace_all_symbol_uses(old, new[old], module.operation)
    for operation in list(module.body.operations):
        ir.SymbolTable.set_symbol_name(operation, new[operation.sym_name.value])
        ir.SymbolTable.set_visibility(operation, "private")
        for each in ("arg_attrs", "res_attrs"):  # of a program's arguments, which say nothing of a function's
            if each in operation.attributes:
                del operation.attributes[each]
        outer.body.append(operation)

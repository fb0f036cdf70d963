"""A cached call: a compiled function within another program, as one operation of JAX.

A user's program that calls a function of the package is traced and lowered in every process, since user code may be
anything. Most of its operations are those of the package's function, which can be cached. So that function becomes one
operation (`within`). While the user's program is traced, only the shapes of its results are needed. The function is
lowered apart, once for all processes (see `disk_cache`), and the user's module takes it in as a function that it calls.
Then the whole module is the same as in the process before, and JAX finds it in its own compilation cache.

Under `jax.vmap` it becomes the operation of many, which is one program also where nothing is jitted.
"""

import hashlib
import io
import threading
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.extend.mlir import ir, passmanager
from jax.extend.mlir.dialects import func
from jax.interpreters import ad, batching, mlir

from spherejax.program_cache import disk_cache, private, settings
from spherejax.program_cache.garbage import gc_paused
from spherejax.program_cache.jaxprs import calls_python
from spherejax.program_cache.several_devices import is_partitioned, lowered_replicated


class Operable(Protocol):
    """A function that can be an operation: of arrays, to a tuple of arrays and something static.

    Attributes:
        made_from: all that goes into it.
        static: what it returns besides arrays, as it can be written to disk; known once it was traced, or else set.
    """

    made_from: tuple
    static: Any

    @property
    def examples(self) -> list[jax.ShapeDtypeStruct]:
        """Its arguments, as shapes and types."""
        ...

    def traced(self, *leaves: Any) -> tuple:
        """Its results, from tracers."""
        ...

    def now(self, *leaves: Any) -> Sequence:
        """Its results, from numbers."""
        ...

    def mapped(self, axes: tuple[int | None, ...], n: int) -> "CachedCall":
        """The same of n at once, those arguments stacked whose axis is 0."""
        ...


class _Lowered(NamedTuple):
    """A function as it is written to disk: its module, the blobs that it calls, and its results' shapes."""

    content: bytes
    blobs: dict[str, bytes]
    shapes: list


class CachedCall:
    """A function as it stands in other programs, where it is a parameter: hashable, and compared by identity.

    Attributes:
        function: the function.
        key: its key on disk; None where it must not be written.
    """

    def __init__(self, function: Operable, key: str | None):
        self.function = function
        self.key, self._key_within = key, None if key is None else _digest(key)
        self._lowered: _Lowered | None = None
        self._traced: Any = None  # by JAX, not lowered yet
        self._has_warned = False
        # Threads may trace programs that contain the same function.
        self._lock = threading.RLock()

    def __call__(self, *leaves: Any) -> Sequence:
        """The results, within another program."""
        return _within.bind(*leaves, operation=self)

    def __cache_key__(self) -> tuple:
        """What stands for it in fingerprints: what it was made from, not what has been learned about it since."""
        return self.function.made_from

    @property
    def calls_python(self) -> bool:
        """Whether it calls Python when it runs; then it is not written."""
        return self._traced is not None and calls_python(self._traced.jaxpr.jaxpr)

    @property
    def shapes(self) -> list:
        """Of the results."""
        with self._lock:
            if self._lowered is None and self._traced is None and not self._load():
                self._trace()
            # Not lowered for its shapes: a caller that asks for shapes alone (`jax.eval_shape`) never lowers it.
            if self._lowered is None:
                traced: Any = self._traced
                return jax.tree.leaves(traced.out_info)
            return self._lowered.shapes

    @property
    def jaxpr(self) -> Any:
        """What it computes, as JAX traces it, for whoever wants to look into it."""
        return jax.make_jaxpr(self.function.traced)(*self.function.examples).jaxpr

    def module(self) -> Any:
        """What it computes, as a module of StableHLO whose function `name` takes all arguments and returns all results;
        None where it calls Python. In the MLIR context of the caller."""
        with self._lock:
            with suppress(Exception):  # whatever is wrong with what was on disk: it is lowered again
                if self._lowered is not None or (self._traced is None and self._load()):
                    return self._read()
            if self._traced is None:
                self._trace()
            return self._read() if self._lower() else None

    def _load(self) -> bool:
        entry = disk_cache.load(self._key_within)
        try:
            lowered, static = entry
            self._lowered, self.function.static = _Lowered(*lowered), static
        except Exception:  # nothing, or another thing under its name
            return False
        return True

    def _trace(self) -> None:
        def to_be_lowered(*leaves: Any) -> tuple:  # JAX's events have its name, which tests and profiles look for
            return self.function.traced(*leaves)

        with disk_cache.record_warnings() as has_warned, gc_paused():
            # Unused arguments too: the caller passes all of them.
            self._traced = jax.jit(to_be_lowered, keep_unused=True).trace(*self.function.examples)
        self._has_warned = has_warned()

    def _lower(self) -> bool:
        if self.calls_python:
            return False
        with disk_cache.record_warnings() as has_warned, settings.extra_blobs().record() as blobs, gc_paused():
            module: Any = self._traced.lower().compiler_ir("stablehlo")
        # Locations in the sources belong to the process that has traced it, and mean nothing in another one.
        with module.context:
            passmanager.PassManager.parse("builtin.module(strip-debuginfo)").run(module.operation)
        main: Any = ir.SymbolTable(module.operation)["main"]
        if len(main.type.inputs) != len(self.function.examples):  # JAX can be set to make arguments of constants
            return False
        # Before it is written: whoever reads it takes it in as it is.
        with module.context:
            _rename(module, self.name)
        content = io.BytesIO()
        module.operation.write_bytecode(content)
        # As bytes, not as a module: a module belongs to the MLIR context of the caller, and is used up there.
        self._lowered = _Lowered(content.getvalue(), blobs(), jax.tree.leaves(self._traced.out_info))
        if not (self._has_warned or has_warned()):
            # A plain tuple: in a file, a class of this module would be looked up by its name when it is read.
            disk_cache.save(self._key_within, (tuple(self._lowered), self.function.static))
        self._traced = None  # it holds the whole trace, which nobody needs any more
        return True

    def _read(self) -> Any:
        assert self._lowered is not None
        content, blobs, _ = self._lowered
        module = ir.Module.parse(content)
        settings.extra_blobs().load(blobs)
        # The program around it is lowered now, and has to be written with these blobs as well.
        settings.extra_blobs().note(blobs)
        if b"lapack_" in content:
            private.register_lapack()
        return module

    @property
    def name(self) -> str:
        """Of the function in a program that takes it in."""
        # By the key, so that the module around it is the same text in each process, and JAX's cache finds that.
        return f"kept_{str(self._key_within or id(self))[:16]}"


def _digest(key: str) -> str:
    """Another key: what is written of a function for other programs is not its program for numbers."""
    return hashlib.sha256(f"within {key}".encode()).hexdigest()


_within = Primitive("within")
# Its tuple is flat: trees of results are put together outside of it.
_within.multiple_results = True


def _now(*leaves: Any, operation: CachedCall) -> Sequence:
    return operation.function.now(*leaves)


def _shapes(*_: Any, operation: CachedCall) -> list[ShapedArray]:
    return [ShapedArray(s.shape, s.dtype, weak_type=getattr(s, "weak_type", False)) for s in operation.shapes]


def _batched(leaves: Sequence, dims: Sequence, *, operation: CachedCall) -> tuple[Sequence, list[int]]:
    n = next(leaf.shape[dim] for leaf, dim in zip(leaves, dims, strict=True) if dim is not None)
    front = [leaf if not dim else jnp.moveaxis(leaf, dim, 0) for leaf, dim in zip(leaves, dims, strict=True)]
    # None for what is the same for all: it is neither copied nor computed many times.
    results = operation.function.mapped(tuple(None if dim is None else 0 for dim in dims), n)(*front)
    return results, [0] * len(results)


def _differentiated(leaves: Sequence, tangents: Sequence, *, operation: CachedCall) -> tuple:
    # No rule of its own: the function is traced into the program, where its own rules apply.
    return jax.jvp(operation.function.traced, tuple(leaves), tuple(map(ad.instantiate_zeros, tangents)))


def _lowering(context: Any, *operands: Any, operation: CachedCall) -> Sequence:
    if is_partitioned(context):  # what is kept was lowered for one device
        return lowered_replicated(operation.function.traced)(context, *operands)
    outer = context.module_context.module
    # Lowered modules and blobs are for the CPU; for other platforms, and for several at once, it is traced.
    if tuple(context.module_context.platforms) == ("cpu",):
        with outer.context:
            module = operation.module()
            if module is not None:
                return _called(outer, operation.name, module, operands)
    return mlir.lower_fun(operation.function.traced, multiple_results=True)(context, *operands)


_within.def_impl(_now)
_within.def_abstract_eval(_shapes)
batching.primitive_batchers[_within] = _batched
ad.primitive_jvps[_within] = _differentiated
mlir.register_lowering(_within, _lowering)


def _called(outer: Any, name: str, module: Any, operands: Sequence) -> Sequence:
    """The results of a call of a module's function; the outer module takes all of the module's functions in."""
    # Once, for any number of calls: equal names are equal functions.
    if name not in ir.SymbolTable(outer.operation):
        for operation in list(module.body.operations):
            outer.body.append(operation)
    function: Any = ir.SymbolTable(outer.operation)[name]
    return func.CallOp(function.type.results, ir.FlatSymbolRefAttr.get(name), list(operands)).results


def _rename(module: Any, name: str) -> None:
    """Give a module's functions names of their own, `main` the name alone, so that another module can take them in."""
    for operation in module.body.operations:
        old = operation.sym_name.value
        new = name if old == "main" else f"{name}_{old}"
        ir.SymbolTable.replace_all_symbol_uses(old, new, module.operation)
        ir.SymbolTable.set_symbol_name(operation, new)
        ir.SymbolTable.set_visibility(operation, "private")
        for attribute in ("arg_attrs", "res_attrs"):  # of a program's arguments, which say nothing of a function's
            if attribute in operation.attributes:
                del operation.attributes[attribute]

"""An array whose entries nobody has written yet, for rows that a loop writes before it reads them.

XLA fills each array with something. A loop that may take four thousand steps, and takes ten, would fill megabytes in
each call, which takes longer than all else in the gradient of a short run. Here a call of machine code that does
nothing returns the array. Where there is no machine code it is filled with zeros.
"""

from typing import Any

import jax
import jax.ffi
import jax.numpy as jnp
from jax import Array
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import mlir

from spherejax.compiler.emit.llvm import head
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.operations import FLOAT


def uninitialized(shape: tuple[int, ...]) -> Array:
    """An array of 64-bit floats, whose entries may be anything, NaN too."""
    return _uninitialized.bind(shape=tuple(shape), is_native=machine_code.is_available())


UNINITIALIZED = "uninitialized"
"""The name of the operation."""

_uninitialized = Primitive(UNINITIALIZED)


@_uninitialized.def_abstract_eval
def _shaped(*, shape: tuple[int, ...], is_native: bool) -> ShapedArray:
    del is_native
    return ShapedArray(shape, FLOAT)


@_uninitialized.def_impl
def _now(*, shape: tuple[int, ...], is_native: bool) -> Array:
    del is_native
    return jnp.zeros(shape)


def _filled(context: Any, *, shape: tuple[int, ...], is_native: bool) -> Any:
    del is_native
    return mlir.lower_fun(lambda: jnp.zeros(shape), multiple_results=False)(context)


def _lowered(context: Any, *, shape: tuple[int, ...], is_native: bool) -> Any:
    if not is_native:
        return _filled(context, shape=shape, is_native=is_native)
    text = "\n".join([head(0, 0), "  ret ptr null", "}", ""])
    name = machine_code.target_of(text, is_wide=False, is_optimised=False)
    machine_code.note_ffi_targets([name])
    # With an effect: two of them are two places in memory, and one within a loop is not moved out of it.
    return jax.ffi.ffi_lowering(name, has_side_effect=True)(context)


mlir.register_lowering(_uninitialized, _filled)
mlir.register_lowering(_uninitialized, _lowered, platform="cpu")

"""Numbers whose derivatives are known with them, as operands of JAX's transformations.

Outside of `jax.jit`, `jax.grad` and `jax.jvp` evaluate a function with numbers, and take one operation after the other
to pieces. `jax.custom_jvp` is traced anew in each call, with everything in its rule: 5 ms for a run, as long as a run
with its derivatives takes. Where the numbers behind the tracers can be looked at, results and derivatives are computed
first; JAX then sees one operation that returns the results, and one linear operation on the tangents.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from inspect import signature
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete, is_tracing


def primal_alone(x: Any) -> Any:
    """The number behind a tracer of one `jax.jvp` or `jax.grad` and of nothing else; None for any other tracer.

    A number behind two transformations depends on those of the outer one, and so do its derivatives.
    """
    if is_concrete(x) or hasattr(x, "batch_dim"):
        return None
    primal = getattr(x, "primal", None)
    is_number = is_concrete(primal) and isinstance(primal, jax.Array | np.ndarray | np.generic | float)
    return np.asarray(primal) if is_number else None


def with_derivatives(x: Any, results: Sequence, along: Callable[[Any], Sequence]) -> list:
    """Results that are known, as functions of x.

    Args:
        x: an array, traced, for whose number `primal_alone` is an answer: one alone, for the rule cannot see whether
            several are traced by the same transformation.
        results: floating-point arrays of numbers.
        along: their derivatives along a tangent of x, linear in that.
    """
    return _with_derivatives.bind(x, *results, along=along)


def columns_of(array: Array, first: int, last: int) -> Array | None:
    """Columns of an array, the last axis, where the numbers behind it can be looked at; None elsewhere."""
    primal = primal_alone(array)
    if primal is None or is_tracing():
        return None

    def along(tangent: Array) -> list[Array]:
        return [jax.lax.slice_in_dim(tangent, first, last, axis=primal.ndim - 1)]

    (columns,) = with_derivatives(array, [primal[..., first:last]], along)
    return columns


def _results(x: Any, *results: Any, along: Callable) -> list:
    del x, along
    return list(results)


def _differentiated(primals: Sequence, tangents: Sequence, *, along: Callable) -> tuple[list, list]:
    return list(primals[1:]), list(along(ad.instantiate_zeros(tangents[0])))


_with_derivatives = Primitive("with_derivatives")
_with_derivatives.multiple_results = True
_with_derivatives.def_impl(_results)
_with_derivatives.def_abstract_eval(_results)
ad.primitive_jvps[_with_derivatives] = _differentiated


def _linearized(is_vjp: bool, are_moving: Sequence, x: Any, *results: Any, along: Callable) -> tuple:
    del is_vjp, are_moving, x

    def linear(residuals: Any, tangent: Any, *_: Any) -> Sequence:
        del residuals
        return along(ad.instantiate_zeros(tangent))

    return list(results), [True] * len(results), (), linear


def _register_linearization() -> bool:
    """Give `jax.grad` the rule of the operation as it is, where JAX takes one; whether it does.

    JAX derives it from the rule of `jax.jvp` otherwise, by partial evaluation, in 0.6 ms of each call. What is used is
    private, and without it the results are the same: a version that asks rules for other arguments is left alone.
    """
    with suppress(Exception):
        from jax._src.interpreters import ad as private

        asked_for = list(signature(private.fallback_linearize_rule).parameters)
        if asked_for == ["_prim", "_is_vjp", "_nonzeros", "primals", "params"]:
            private.primitive_linearizations[_with_derivatives] = _linearized
            return True
    return False


LINEARIZES_AT_ONCE = _register_linearization()
"""Whether `jax.grad` takes the rule of the operation as it is."""


# Matrices -------------------------------------------------------------------------------------------------------------


def times_jacobians(tangent: Float[Array, "..."], *jacobians: Float[Array, "*shape p"]) -> list[Float[Array, "*shape"]]:
    """The products J t, as one operation of JAX, linear in t, which has p entries in any shape."""
    return _times.bind(tangent, *jacobians)


@jax.jit
def _products(tangent: Array, *jacobians: Array) -> list[Array]:
    return [jacobian @ jnp.ravel(tangent) for jacobian in jacobians]


@jax.jit
def _sum_of_products(cotangents: list[Array], jacobians: list[Array]) -> Array:
    pairs = zip(cotangents, jacobians, strict=True)
    return sum((jnp.tensordot(y, jacobian, jnp.ndim(y)) for y, jacobian in pairs), jnp.zeros(()))


def _shapes(tangent: Any, *jacobians: Any) -> list[ShapedArray]:
    return [ShapedArray(jacobian.shape[:-1], tangent.dtype) for jacobian in jacobians]


def _times_differentiated(primals: Sequence, tangents: Sequence) -> tuple[list, list]:
    return jax.jvp(_products, primals, tuple(map(ad.instantiate_zeros, tangents)))


def _transposed(cotangents: Sequence, tangent: Any, *jacobians: Any) -> list:
    pairs = zip(cotangents, jacobians, strict=True)
    moving = [(y, jacobian) for y, jacobian in pairs if type(y) is not ad.Zero]
    if not moving:
        back: Any = ad.Zero(tangent.aval)
    elif all(map(is_concrete, (*jacobians, *(y for y, _ in moving)))):
        products = [np.tensordot(np.asarray(y), np.asarray(jacobian), np.ndim(y)) for y, jacobian in moving]
        back = jnp.asarray(np.sum(products, axis=0).reshape(tangent.aval.shape))
    else:
        back = _sum_of_products(*map(list, zip(*moving, strict=True))).reshape(tangent.aval.shape)
    return [back, *(None for _ in jacobians)]


def _batched(operands: Sequence, dims: Sequence) -> tuple[Sequence, list[int]]:
    products = jax.vmap(_products, tuple(dims))(*operands)
    return products, [0] * len(products)


_times = Primitive("times_jacobians")
_times.multiple_results = True
_times.def_impl(_products)
_times.def_abstract_eval(_shapes)
ad.primitive_jvps[_times] = _times_differentiated
ad.primitive_transposes[_times] = _transposed
batching.primitive_batchers[_times] = _batched
mlir.register_lowering(_times, mlir.lower_fun(_products, multiple_results=True))

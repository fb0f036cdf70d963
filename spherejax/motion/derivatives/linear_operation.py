"""A linear function whose transpose is a function of its own: one operation of JAX.

The derivative of a run along one direction is cheapest forward, beside the run; the transpose of that derivative, from
many outputs to very many numbers, is cheapest backward along the steps of the run. Both are the same linear map. JAX
would transpose the forward function line by line, which no adaptive loop allows; here each of the two is written by
itself, and JAX takes the one that it needs: `jax.jvp` the first, `jax.grad` the second.

`jax.custom_vjp` has no forward mode, and `jax.custom_derivatives.linear_call` (JAX 0.10) no `jax.vmap`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from spherejax.motion.integration.compiling import for_each

Arrays = Sequence[Any]


@dataclass(frozen=True, eq=False)
class LinearMap:
    """A matrix M(residuals) that nobody writes down (static; compared by its identity).

    Attributes:
        forward: of (residuals, x): M x; all are lists of arrays.
        backward: of (residuals, y): M^T y.
        differentiable: of (residuals, x): M x by other means, which JAX can differentiate by the residuals; or it
            raises an error that says why that is not done.
        inputs, outputs: shapes and types of x and y.
        is_backward: whether the operation is M^T.
    """

    forward: Callable[[Arrays, Arrays], Arrays]
    backward: Callable[[Arrays, Arrays], Arrays]
    differentiable: Callable[[Arrays, Arrays], Arrays]
    inputs: tuple[jax.ShapeDtypeStruct, ...]
    outputs: tuple[jax.ShapeDtypeStruct, ...]
    is_backward: bool = False

    @property
    def transposed(self) -> "LinearMap":
        """M^T for M, and M for M^T."""
        return replace(self, is_backward=not self.is_backward)

    @property
    def image(self) -> tuple[jax.ShapeDtypeStruct, ...]:
        """Shapes and types of what it returns."""
        return self.inputs if self.is_backward else self.outputs

    def of(self, residuals: Arrays, x: Arrays) -> Arrays:
        """The product."""
        return (self.backward if self.is_backward else self.forward)(residuals, x)

    def by_other_means(self, residuals: Arrays, x: Arrays) -> Arrays:
        """The product, differentiable by the residuals."""
        if not self.is_backward:
            return self.differentiable(residuals, x)
        zeros = [jnp.zeros(form.shape, form.dtype) for form in self.inputs]
        _, back = jax.vjp(lambda *numbers: list(self.differentiable(residuals, numbers)), *zeros)
        return back(list(x))


def is_linearized_in_program(value: Any, tangent: Any) -> bool:
    """Whether JAX linearizes a function, as reverse mode does, within `jax.jit` and no other transformation.

    Then the tangent is not known yet, and the value is a number of the program. This is a hint, on which nothing but
    time may depend: `jax.linearize` looks the same, and reverse mode through an inner `jax.jit` does not.
    """
    # By names: these classes of JAX have no public ones. Should the names change, two runs are made in place of one.
    return type(tangent).__name__ == "JaxprTracer" and type(value).__name__ == "DynamicJaxprTracer"


def linear_operation(linear: LinearMap, residuals: Arrays, x: Arrays) -> list:
    """M(residuals) x as one operation, linear in x."""
    return _linear_operation.bind(*residuals, *x, linear=linear, n_residuals=len(residuals))


def _computed(*operands: Any, linear: LinearMap, n_residuals: int) -> list:
    return list(linear.of(operands[:n_residuals], operands[n_residuals:]))


def _shapes(*operands: Any, linear: LinearMap, n_residuals: int) -> list:
    del operands, n_residuals
    return [ShapedArray(form.shape, form.dtype) for form in linear.image]


def _differentiated(primals: Sequence, tangents: Sequence, *, linear: LinearMap, n_residuals: int):
    residuals, x = list(primals[:n_residuals]), list(primals[n_residuals:])
    product = linear_operation(linear, residuals, x)
    of_residuals, of_x = tangents[:n_residuals], tangents[n_residuals:]
    slopes = linear_operation(linear, residuals, list(map(ad.instantiate_zeros, of_x)))
    moving = [i for i, tangent in enumerate(of_residuals) if type(tangent) is not ad.Zero]
    if not moving:
        return product, slopes

    def of_moving(*moved):
        changed = dict(zip(moving, moved, strict=True))
        return list(linear.by_other_means([changed.get(i, own) for i, own in enumerate(residuals)], x))

    further = jax.jvp(of_moving, [residuals[i] for i in moving], [of_residuals[i] for i in moving])[1]
    return product, [a + b for a, b in zip(slopes, further, strict=True)]


def _transposed(cotangents: Sequence, *operands: Any, linear: LinearMap, n_residuals: int) -> list:
    residuals = operands[:n_residuals]
    back = linear_operation(linear.transposed, residuals, list(map(ad.instantiate_zeros, cotangents)))
    return [*(None for _ in residuals), *back]


def _batched(operands: Sequence, dims: Sequence, *, linear: LinearMap, n_residuals: int):
    n = next(x.shape[dim] for x, dim in zip(operands, dims, strict=True) if dim is not None)
    # What goes in and comes out is mapped throughout, so that the transpose has the same form; residuals are not
    # copied where all maps share them.
    residuals = [
        x if dim is None else jnp.moveaxis(x, dim, 0)
        for x, dim in zip(operands[:n_residuals], dims[:n_residuals], strict=True)
    ]
    axes = [None if dim is None else 0 for dim in dims[:n_residuals]]
    x = [
        jnp.broadcast_to(x, (n, *x.shape)) if dim is None else jnp.moveaxis(x, dim, 0)
        for x, dim in zip(operands[n_residuals:], dims[n_residuals:], strict=True)
    ]

    def wide(forms):
        return tuple(jax.ShapeDtypeStruct((n, *form.shape), form.dtype) for form in forms)

    mapped = LinearMap(
        partial(_side_by_side, linear.forward, axes),
        partial(_each_by_itself, linear.backward, axes),
        partial(_side_by_side, linear.differentiable, axes),
        wide(linear.inputs),
        wide(linear.outputs),
        linear.is_backward,
    )
    product = linear_operation(mapped, residuals, x)
    return product, [0] * len(product)


def _side_by_side(function: Callable, axes: list, residuals: Arrays, x: Arrays) -> Arrays:
    return jax.vmap(lambda own, x: list(function(own, x)), (axes, 0))(list(residuals), list(x))


def _each_by_itself(function: Callable, axes: list, residuals: Arrays, x: Arrays) -> Arrays:
    """Mapped so that loops of different lengths do not wait for each other."""
    own = [value for value, axis in zip(residuals, axes, strict=True) if axis is not None]

    def one(mapped):
        own, x = mapped
        own = iter(own)
        return list(
            function([value if axis is None else next(own) for value, axis in zip(residuals, axes, strict=True)], x)
        )

    return for_each(one, (own, list(x)))


_linear_operation = Primitive("linear_operation")
_linear_operation.multiple_results = True
_linear_operation.def_impl(_computed)
_linear_operation.def_abstract_eval(_shapes)
ad.primitive_jvps[_linear_operation] = _differentiated
ad.primitive_transposes[_linear_operation] = _transposed
batching.primitive_batchers[_linear_operation] = _batched
mlir.register_lowering(_linear_operation, mlir.lower_fun(_computed, multiple_results=True))

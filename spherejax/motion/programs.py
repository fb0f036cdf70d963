"""Functions of a system as programs: clear array code on one side, what the integrator calls on the other.

Every function of a system, time and state is written as array code `function(system, t, y)`. A `Program` evaluates
it on the flat parameter vector theta as a straight-line scalar program, made once for each structure and kept; where
no scalar program can be made it falls back to the array code, with a warning.
"""

import warnings
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import concretely
from spherejax.foundations.scalar_rules import NotScalarizable
from spherejax.foundations.scalarize import ScalarProgram, scalarize
from spherejax.model.system import Structure, System


class ArrayPathWarning(UserWarning):
    """A scene runs on array code, which is right but 10 to 30 times slower than a scalar program."""


SystemFunction = Callable[[System, jax.Array, Any], object]
Sizes = int | tuple[int, ...] | None


class Program:
    """A function of a system as a callable `program(theta, t, y)`.

    Attributes:
        scalar: the scalar program, or None on the array path.
    """

    def __init__(self, function: SystemFunction, structure: Structure, use_scalars: bool, y_size: Sizes, n_ahead: int):
        self.function = function
        self.structure = structure
        self.scalar: ScalarProgram | None = None
        if use_scalars:
            try:
                self.scalar = _scalar_program(function, structure, y_size, n_ahead)
            except NotScalarizable as reason:
                warnings.warn(
                    f"{function.__name__} runs as array code, 10 to 30 times slower than a scalar program: {reason}. "
                    "Write the law with elementwise operations, jnp.where, dot and cross to get the fast path, or pass "
                    "scalar=False to silence this.",
                    ArrayPathWarning,
                    stacklevel=2,
                )

    def ahead(self, *leading):
        """What depends on the leading arguments (the parameters) alone, evaluated once; pass it to `inside`."""
        return () if self.scalar is None else self.scalar.ahead(*leading)

    def inside(self, theta, ahead, t, y) -> Any:
        """As a call, inside a loop over which the leading arguments (the parameters) are constant."""
        if self.scalar is None:
            return self(theta, t, y)
        return self.scalar.inside(ahead, theta, jnp.asarray(t, jnp.float64), y)

    def compute(self, theta, t, y) -> Any:
        """Evaluate concrete numbers now, as NumPy, without compiling anything where there is a scalar program."""
        if self.scalar is not None:
            return self.scalar.compute(theta, t, y)
        return concretely(lambda *numbers: self.function(self.structure.system(numbers[0]), *numbers[1:]), theta, t, y)

    def __call__(self, theta, t, y) -> Any:
        """Evaluate at parameters theta, time t [s] and flat state y."""
        if self.scalar is not None:
            return self.scalar(theta, jnp.asarray(t, jnp.float64), y)
        return self.function(self.structure.system(theta), t, y)


@lru_cache(maxsize=256)
def program_for(
    function: SystemFunction,
    structure: Structure,
    use_scalars: bool = True,
    y_size: Sizes = None,
    n_ahead: int = 1,
) -> Program:
    """The program of a function for a structure, made on first use and kept.

    Args:
        function: array code `function(system, t, y)`.
        structure: what the program is compiled for.
        use_scalars: make a scalar program; False keeps the array code.
        y_size: length of the function's third argument, or lengths if it is a tuple; None for a flat state.
        n_ahead: number of leading arguments that `Program.ahead` is given: 1 for the parameters alone.
    """
    return Program(function, structure, use_scalars, y_size, n_ahead)


def _scalar_program(function: SystemFunction, structure: Structure, y_size: Sizes, n_ahead: int) -> ScalarProgram:
    size = sum(int(np.prod(shape)) for shape in structure.shapes)

    def of_numbers(theta, t, y):
        return function(structure.system(theta), t, y)

    of_numbers.__name__ = function.__name__
    number = jax.ShapeDtypeStruct((), jnp.float64)
    shapes = jax.ShapeDtypeStruct((size,), jnp.float64)
    if y_size is None:
        y_size = jax.eval_shape(structure.system, shapes).layout.size
    sizes = y_size if isinstance(y_size, tuple) else (y_size,)
    vectors = tuple(jax.ShapeDtypeStruct((size,), jnp.float64) for size in sizes)
    state = vectors if isinstance(y_size, tuple) else vectors[0]
    fixed = {(0, index): value for index, value in structure.special}
    return scalarize(of_numbers, shapes, number, state, fixed=fixed, n_ahead=n_ahead)

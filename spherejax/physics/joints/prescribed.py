"""Prescribed motions: functions of time, whose numbers, where they have any, are leaves."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement, is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Number
from spherejax.physics.functions.base import AbstractFunction, as_function, function_requirements
from spherejax.physics.functions.integral import Integral


def prescribed(function: Callable, field: str) -> AbstractFunction:
    """A function of time as the user gives it: one of `spherejax.physics.functions`, or any callable in jnp.

    Raises:
        SceneError: for what is not callable.
    """
    if not callable(function):
        raise SceneError(f"{field} = {function!r} must be a function of time t [s], written in jax.numpy")
    found = as_function(function)
    assert found is not None
    return found


def prescribed_by(
    value: Callable | None, field: str, rate: Number | Callable | None, start: Number
) -> AbstractFunction:
    """What is prescribed: a function of time, or the integral of its rate from t = 0, where it is `start`.

    Raises:
        SceneError: for both or neither, for a start without a rate, and for what is not callable.
    """
    if (value is None) == (rate is None):
        which = "neither" if value is None else "both"
        raise SceneError(f"give {field}= or rate=, functions of time t [s], not {which}")
    if value is not None:
        if not (is_concrete(start) and start == 0):
            raise SceneError(f"start= belongs to rate=; {field}= says itself where it starts")
        return prescribed(value, field)
    assert rate is not None
    return Integral(rate, start)


def time_requirements(function: AbstractFunction, field: str, shape: tuple[int, ...] = ()) -> list[Requirement]:
    """The function gives an array of the right shape, and its numbers are finite.

    Raises:
        SceneError: for a function that cannot be evaluated.
    """
    leaves = jax.tree.leaves(function)
    if not all(hasattr(leaf, "dtype") or isinstance(leaf, int | float) for leaf in leaves):
        raise SceneError(
            f"{field} = {function!r} holds what is no number; declare such fields with equinox.field(static=True)"
        )
    try:
        found = jax.eval_shape(function, jax.ShapeDtypeStruct((), jnp.float64)).shape
    except Exception as error:
        raise SceneError(
            f"{field}: the function of time cannot be evaluated ({error}). Write it in jax.numpy, for a scalar t [s]"
        ) from error
    expected = "give one number" if shape == () else f"give an array of shape {shape}"
    return [
        Requirement(f"{field}(t).shape", found, found == shape, expected, "Check what the function of time returns."),
        *(
            Requirement(f"a number of {field}", leaf, abs(leaf) < np.inf, "be finite", "Check the units (SI).")
            for leaf in leaves
        ),
        *function_requirements(field, function),
    ]

"""Prescribed motions: functions of time whose numbers, where they have any, are leaves."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from spherejax.foundations.checks import Requirement, SceneError
from spherejax.foundations.types import Number, Scalar


class TimeFunction(eqx.Module):
    """A function of time in jnp, smooth to the second derivative.

    A pytree (an `equinox.Module` with `__call__`) keeps its numbers as leaves, which can be swept and differentiated;
    any other callable is structure: define it once, since each new function object is compiled anew.

    Attributes:
        law: the function, where it is a pytree.
        plain: the function, where it is not (static).
    """

    law: Callable | None
    plain: Callable | None = eqx.field(static=True)

    def __call__(self, t: Scalar) -> Array:
        """The value at time t [s]."""
        function = self.plain if self.law is None else self.law
        assert function is not None
        return jnp.asarray(function(t), jnp.float64)


def time_function(function: Callable, field: str) -> TimeFunction:
    """A function of time as the user gives it.

    Raises:
        SceneError: for what is not callable, or a pytree with leaves that are no numbers.
    """
    if isinstance(function, TimeFunction):
        return function
    if not callable(function):
        raise SceneError(f"{field} = {function!r} must be a function of time t [s], written in jax.numpy")
    leaves = jax.tree.leaves(function)
    if any(leaf is function for leaf in leaves):
        return TimeFunction(None, function)
    if not all(eqx.is_inexact_array_like(leaf) or isinstance(leaf, int) for leaf in leaves):
        raise SceneError(
            f"{field} = {function!r} holds what is no number; declare such fields with equinox.field(static=True)"
        )
    return TimeFunction(function, None)


def time_requirements(function: TimeFunction, field: str, shape: tuple[int, ...] = ()) -> list[Requirement]:
    """The function gives an array of the right shape, and its numbers are finite.

    Raises:
        SceneError: for a function that cannot be evaluated.
    """
    try:
        found = jax.eval_shape(function, jax.ShapeDtypeStruct((), jnp.float64)).shape
    except Exception as error:
        raise SceneError(
            f"{field}: the function of time cannot be evaluated ({error}). Write it in jax.numpy, for a scalar t [s]"
        ) from error
    expected = "give one number" if shape == () else f"give an array of shape {shape}"
    finite = [abs(leaf) < np.inf for leaf in jax.tree.leaves(function)]
    return [
        Requirement(f"{field}(t).shape", found, found == shape, expected, "Check what the function of time returns."),
        *(
            Requirement(f"a number of {field}", leaf, ok, "be finite", "Check the units (SI).")
            for leaf, ok in zip(jax.tree.leaves(function), finite, strict=True)
        ),
    ]


class Uniform(eqx.Module):
    """Motion at a constant rate: start + rate t.

    Attributes:
        rate: [rad/s] or [m/s].
        start: value at t = 0 [rad] or [m].
    """

    rate: Number
    start: Number = 0.0

    def __call__(self, t: Scalar) -> Scalar:
        """start + rate t."""
        return self.start + self.rate * t


class Harmonic(eqx.Module):
    """Swinging motion: mean + amplitude sin(2 pi frequency t + phase).

    Attributes:
        amplitude: [rad] or [m].
        frequency: [Hz].
        phase: [rad].
        mean: [rad] or [m].
    """

    amplitude: Number
    frequency: Number
    phase: Number = 0.0
    mean: Number = 0.0

    def __call__(self, t: Scalar) -> Scalar:
        """mean + amplitude sin(2 pi frequency t + phase)."""
        return self.mean + self.amplitude * jnp.sin(2 * jnp.pi * self.frequency * t + self.phase)

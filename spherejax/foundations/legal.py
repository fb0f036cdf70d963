"""What numbers must usually satisfy: to be positive, to lie above another."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement, is_concrete
from spherejax.foundations.forms import is_numeric


def numeric(value) -> Any:
    """`value` (a number, an array or a nested list of them) as one array, of NumPy where nothing in it is traced.

    NumPy matters under an outer `jit`: a comparison of concrete JAX arrays would be staged there, and a value that
    could be judged at once would look as if it could not. What is no real number (a text, a time) is NaN, which no
    requirement admits.
    """
    is_array = type(value) is np.float64 or (type(value) is np.ndarray and value.dtype == np.float64)
    if not is_array and not is_numeric(value):
        return np.full(np.asarray(value, dtype=object).shape, np.nan)
    if is_array or all(is_concrete(leaf) for leaf in jax.tree.leaves(value)):
        return np.asarray(value, dtype=float)
    return jnp.asarray(value)


def positive(field: str, value, unit: str) -> Requirement:
    """`value` lies in (0, inf)."""
    x, remedy = numeric(value), f"Give a number above zero [{unit}]."
    return Requirement(field, value, (x > 0) & (x < np.inf), "be positive and finite", remedy)


def non_negative(field: str, value, unit: str) -> Requirement:
    """`value` lies in [0, inf)."""
    x, remedy = numeric(value), f"Give zero or more [{unit}]."
    return Requirement(field, value, (x >= 0) & (x < np.inf), "be finite and not negative", remedy)


def at_least(field: str, value, bound_field: str, bound) -> Requirement:
    """`value` is finite and not below the value named `bound_field`."""
    x, remedy = numeric(value), f"Raise {field} or lower {bound_field}."
    expected = f"be at least {bound_field}{_value_of(bound)}"
    return Requirement(field, value, (x >= numeric(bound)) & (x < np.inf), expected, remedy)


def _value_of(bound) -> str:
    """The number behind a name, where it is known."""
    return f" = {float(bound):.6g}" if is_concrete(bound) and np.ndim(bound) == 0 else ""


def above(field: str, value, bound_field: str, bound) -> Requirement:
    """`value` is finite and above the value named `bound_field`."""
    x, remedy = numeric(value), f"Raise {field} or lower {bound_field}."
    expected = f"be above {bound_field}{_value_of(bound)}"
    return Requirement(field, value, (x > numeric(bound)) & (x < np.inf), expected, remedy)

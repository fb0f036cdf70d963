"""What numbers must usually satisfy: to be positive, to lie above another."""

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement, is_concrete


def numeric(value):
    """`value` (a number, an array or a nested list of them) as one array, of NumPy where nothing in it is
    traced.

    NumPy matters under an outer `jit`: a comparison of concrete JAX arrays would be staged there,
    and a value that could be judged at once would look as if it could not.
    """
    is_array = type(value) is np.float64 or type(value) is np.ndarray  # of these nothing is asked
    if is_array or all(is_concrete(leaf) for leaf in jax.tree.leaves(value)):
        return np.asarray(value, dtype=float)
    return jnp.asarray(value)


def positive(field: str, value, unit: str) -> Requirement:
    """`value` lies in (0, inf)."""
    x = numeric(value)
    return Requirement(
        field, value, (x > 0) & (x < np.inf), "be positive and finite", f"Give a number above zero [{unit}]."
    )


def non_negative(field: str, value, unit: str) -> Requirement:
    """`value` lies in [0, inf)."""
    x = numeric(value)
    return Requirement(
        field, value, (x >= 0) & (x < np.inf), "be finite and not negative", f"Give zero or more [{unit}]."
    )


def at_least(field: str, value, bound_field: str, bound) -> Requirement:
    """`value` is finite and not below the value named `bound_field`."""
    x = numeric(value)
    return Requirement(
        field,
        value,
        (x >= numeric(bound)) & (x < np.inf),
        f"be at least {bound_field}{_value_of(bound)}",
        f"Raise {field} or lower {bound_field}.",
    )


def _value_of(bound) -> str:
    """The number behind a name, where it is known."""
    return f" = {float(bound):.6g}" if is_concrete(bound) and np.ndim(bound) == 0 else ""


def above(field: str, value, bound_field: str, bound) -> Requirement:
    """`value` is finite and above the value named `bound_field`."""
    x = numeric(value)
    return Requirement(
        field,
        value,
        (x > numeric(bound)) & (x < np.inf),
        f"be above {bound_field}{_value_of(bound)}",
        f"Raise {field} or lower {bound_field}.",
    )

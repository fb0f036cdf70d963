"""What is asked of the steps of a run within a program of JAX: a fixed number of rows, of which some are used.

Which steps matter is looked for without derivatives; the states there are taken again, with derivatives, by
`between.states_at`.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.types import Flag
from spherejax.model.system import flatten_by_factor
from spherejax.motion.integration.problem import Plan, RunMethod
from spherejax.motion.integration.status import Status
from spherejax.motion.results.steps import SHARES, Repetition, repeatable
from spherejax.motion.results.within_steps import LARGEST_RISE

SEEN_AT_ONCE = 64
"""States of steps that are looked at in one turn of a loop, which ends behind the last step."""


def repetition_of(run: Any) -> tuple[Plan, Repetition]:
    """What `steps.repeated_in_steps` needs to repeat a single run.

    Raises:
        SceneError: for a run that cannot be repeated.
    """
    structure, theta = flatten_by_factor(run.system)
    method = RunMethod.of_settings(run.system, structure, repeatable(run.settings))
    ends = jnp.asarray(run.ts)[jnp.array([0, -1])]
    is_made = (run.ended == Status.SUCCEEDED) | (run.t_reached > ends[0])
    return Plan(structure, (), run.scalar), Repetition(method, jnp.asarray(theta), run.ys[0], ends, is_made)


def seen_at_steps(
    see: Callable, n_values: int, ts: Float[Array, " m"], ys: Float[Array, "m size"], n_used: Any
) -> Float[Array, "m n_values"]:
    """`see(t, y)` at the first `n_used` states, shape (n_values,) each; minus infinity at the others."""
    block = min(SEEN_AT_ONCE, ts.shape[0])

    def seen(i, values):
        at = jnp.minimum(i * block, ts.shape[0] - block)
        rows = (jax.lax.dynamic_slice_in_dim(array, at, block) for array in (ts, ys))
        is_used = at + jnp.arange(block) < n_used
        seen = jnp.where(is_used[:, None], jax.vmap(see)(*rows), -jnp.inf)
        return jax.lax.dynamic_update_slice_in_dim(values, seen, at, 0)

    n_blocks = jnp.minimum((n_used + block - 1) // block, -(-ts.shape[0] // block))
    return jax.lax.fori_loop(0, n_blocks, seen, jnp.full((ts.shape[0], n_values), -jnp.inf))


_FINE = np.linspace(0.0, 1.0, 201)
FINE_WEIGHTS = np.stack(
    [np.prod([(_FINE - other) / (node - other) for other in SHARES if other != node], axis=0) for node in SHARES],
    axis=1,
)
"""Lagrange's polynomials of the inner nodes."""


def largest_within(seen: Float[Array, "n k"]) -> Float[Array, " n"]:
    """About the largest value within each step, from those at `SHARES`: of the cubic through them, wrong by 1e-5."""
    rising, highest = jnp.max(seen @ jnp.asarray(FINE_WEIGHTS).T, axis=1), jnp.max(seen, axis=1)
    is_believed = (rising >= highest) & (rising <= highest + LARGEST_RISE * jnp.abs(highest))
    return jnp.where(is_believed, rising, highest)


def refusing(words: str, value: Float[Array, "*n"], has_derivative: Flag) -> Float[Array, "*n"]:
    """The value; its derivative raises where it has none, while the program runs."""

    @jax.custom_jvp
    def same(value, has_derivative):
        return value

    @same.defjvp
    def same_jvp(primals, tangents):
        value, has_derivative = primals
        # A factor: linear in the tangent, for reverse mode as well.
        return value, tangents[0] * eqx.error_if(jnp.ones(()), ~has_derivative, words)

    return same(value, has_derivative)

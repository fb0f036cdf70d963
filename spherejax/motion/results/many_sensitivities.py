"""Sensitivities of many runs: rows below the state of every lane; see `sensitivity_rows` for their equations.

The lanes integrate the state and its sensitivities by the parameters asked for as one matrix, whose worst row is
judged: a run takes the steps that its sensitivities need.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.motion.results.trajectory import Trajectory


class RunSlopes(NamedTuple):
    """Derivatives of runs by parameters (of many runs: a leading axis).

    Attributes:
        theta: of the numbers of the system, shape (p, n_numbers).
        ys: of the flat states at the sample times, shape (p, n, size).
    """

    theta: Float[Array, "p n_numbers"]
    ys: Float[Array, "p n size"]

    def of(self, function: Callable[[Trajectory], Array], run: Trajectory) -> Float[Array, "*shape p"]:
        """The derivatives of an array that follows from a run, by the chain rule; the parameters are the last axis."""
        system = jax.tree.map(jnp.asarray, run.system)
        leaves, tree = jax.tree.flatten(system)

        def value(leaves, ys):
            return jnp.asarray(function(replace(run, system=jax.tree.unflatten(tree, leaves), ys=ys)))

        def along(theta, ys):
            return jax.jvp(value, (leaves, run.ys), (_leaves_of(theta, leaves), ys))[1]

        return jax.vmap(along, out_axes=-1)(self.theta, self.ys)


def _leaves_of(theta: Float[Array, " n_numbers"], leaves: list) -> list:
    """A flat vector cut into the shapes of leaves."""
    parts, start = [], 0
    for leaf in leaves:
        parts.append(theta[start : start + leaf.size].reshape(leaf.shape))
        start += leaf.size
    return parts


def slopes_of(slopes: Any, scale: Float[Array, "n_runs p"], ys: Float[Array, "n_runs n rows size"]) -> RunSlopes:
    """The derivatives of all runs.

    Args:
        slopes: scaled derivatives of what the right-hand side is given.
        scale: of each parameter.
        ys: the rows at the samples.
    """

    def of_one(slopes, scale, ys):
        return RunSlopes(slopes.theta / scale[:, None], jnp.moveaxis(ys[:, 1:], 1, 0) / scale[:, None, None])

    return jax.vmap(of_one)(slopes, scale, ys)

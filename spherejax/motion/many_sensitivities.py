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

from spherejax.model.system import Structure
from spherejax.motion.implicit_rows import solver_of_rows
from spherejax.motion.lanes import LaneProblem
from spherejax.motion.programs import Program
from spherejax.motion.sensitivity_rows import (
    correcting_rows,
    judging_rows,
    linearized,
    of_first_row,
    rows_rate,
    scales_of,
    with_rows,
)
from spherejax.motion.trajectory import Trajectory


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


def start_of_rows(start_of: Callable, values: Float[Array, " p"]) -> Any:
    """The start of one run with rows below its state, and with the slopes of what the right-hand side is given."""
    scale = scales_of(values)
    start, slopes = linearized(start_of, values, jnp.diag(scale))
    value, its_slopes = (replace(each, tolerances=None, limits=None) for each in (start.numbers, slopes.numbers))
    numbers = LaneNumbers(value, its_slopes, scale, start.numbers.tolerances, start.numbers.limits)
    return start._replace(numbers=numbers, y0=jnp.concatenate([start.y0[None], slopes.y0]))


class LaneNumbers(NamedTuple):
    """What the right-hand side of the rows of one run is given: as `Linearized`, with what has no derivatives.

    Attributes:
        value: what the right-hand side of the state is given, but for the tolerances.
        slopes: its scaled derivatives.
        scale: of each parameter.
        tolerances: relative and absolute, where they depend on the run.
        limits: of the audit.
    """

    value: Any
    slopes: Any
    scale: Float[Array, " p"]
    tolerances: Any
    limits: Any


def problem_of_rows(problem: LaneProblem, structure: Structure, rate: Program) -> LaneProblem:
    """What every lane integrates, for the state and its sensitivities."""

    def controller_of(numbers):
        return judging_rows(problem.controller_of(replace(numbers.value, tolerances=numbers.tolerances)))

    def watch(t, rows, numbers):
        assert problem.watch is not None
        return problem.watch(t, rows[0], numbers.value)

    return problem._replace(
        solver=solver_of_rows(problem.solver, structure, rate),
        controller_of=controller_of,
        rate=lambda t, rows, numbers: rows_rate(rate, numbers, t, rows),
        correct=correcting_rows(problem.correct),
        contacts=None if problem.contacts is None else with_rows(problem.contacts, rate),
        watch=None if problem.watch is None else watch,
        audit=None if problem.audit is None else problem.audit.of_rows(),
        room=of_first_row(problem.room),
    )


def slopes_of(numbers: LaneNumbers, ys: Float[Array, "n_runs n rows size"]) -> RunSlopes:
    """The derivatives of all runs, from the rows at their samples."""

    def of_one(numbers: LaneNumbers, ys):
        theta = numbers.slopes.theta / numbers.scale[:, None]
        return RunSlopes(theta, jnp.moveaxis(ys[:, 1:], 1, 0) / numbers.scale[:, None, None])

    return jax.vmap(of_one)(numbers, ys)

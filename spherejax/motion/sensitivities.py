"""Derivatives of runs by the numbers that the caller traces: rows of sensitivities beside the state, integrated under
error control; see `sensitivity_rows` for their equations.
"""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.types import Flag
from spherejax.motion.assembly import CLOSING_TOLERANCE, Assembly
from spherejax.motion.callbacks import without_host_checks
from spherejax.motion.dynamics import state_rate
from spherejax.motion.implicit_rows import solver_of_rows
from spherejax.motion.integrate import (
    Options,
    Outcome,
    Parameters,
    Plan,
    beginning,
    contacts_of,
    correction_for,
    integrate,
    landing_controller,
    samples,
    wrapped,
)
from spherejax.motion.programs import program_for
from spherejax.motion.sensitivity_rows import (
    correcting_rows,
    judging_rows,
    linearized,
    rows_rate,
    scales_of,
    with_rows,
)
from spherejax.motion.solvers.rosenbrock import AbstractRosenbrock
from spherejax.motion.status import status_of


def integrate_with_sensitivities(plan, options, values, known, ts, start, values_are_legal) -> Outcome:
    """As `integrate`, differentiable in forward and in reverse mode.

    The derivative rule computes all sensitivities by the traced numbers and applies them: that is linear in the
    tangent, so it can be transposed. With few parameters it is cheaper than a reverse sweep, in run time and far more
    in compile time. The outcome itself is that of the plain run.
    """
    slopes_of = _controlled_slopes if has_controlled_sensitivities(options.solver) else _slopes_through_the_loop
    # Tolerances may be traced: a rule may not close over them.
    arrays, others = eqx.partition(options, eqx.is_array)

    @jax.custom_jvp
    def run(values, arrays, known, ts, start, values_are_legal):
        return integrate(plan, eqx.combine(arrays, others), values, known, ts, start, values_are_legal)

    @run.defjvp
    def run_jvp(primals, tangents):
        outcome = run(*primals)
        values, arrays, *rest = primals
        jacobian = slopes_of(plan, eqx.combine(arrays, others), values, *rest)
        ys, assembly = jax.tree.map(lambda j: j @ tangents[0], jacobian)
        # Samples that the run did not reach are NaN, and constant.
        ys = jnp.where(jnp.isnan(outcome.ys), 0.0, ys)
        counts = jax.tree.map(lambda x: np.zeros(x.shape, jax.dtypes.float0), (outcome.status, outcome.stats))
        still = jnp.zeros_like(outcome.t_reached), jnp.zeros_like(outcome.y_reached)
        return outcome, Outcome(ys, *still, counts[0], counts[1], assembly)

    arrays = jax.lax.stop_gradient(arrays)
    return run(values, arrays, known, jax.lax.stop_gradient(ts), start, values_are_legal)


def has_controlled_sensitivities(solver: diffrax.AbstractSolver) -> bool:
    """Whether a run with this solver integrates its sensitivities under error control.

    Explicit Runge-Kutta methods and Rosenbrock methods do; see `implicit_rows` for these. diffrax's implicit methods
    would need the Jacobian of the state and all sensitivities together, with second derivatives of the right-hand side
    in it. Their runs are differentiated step by step instead.
    """
    return isinstance(solver, diffrax.AbstractERK | AbstractRosenbrock)


class Slopes(NamedTuple):
    """Derivatives of an outcome by the traced numbers, which are the last axis.

    Attributes:
        ys: of the flat states; NaN where the sensitivities did not reach a sample.
        assembly: of the assembled start.
    """

    ys: Float[Array, "n size p"]
    assembly: Assembly


class StatesAndSlopes(NamedTuple):
    """A run and its derivatives along k directions in the traced numbers, from one integration.

    Attributes:
        ys: flat states at the sample times; NaN where a failed run did not reach a sample.
        slopes: their derivatives along the directions.
        assembly: how the start was made consistent.
        assembly_slopes: its derivatives, with a leading axis of directions.
        status: integer of `Status`.
        t_reached: time reached [s].
        n_steps: steps tried.
    """

    ys: Float[Array, "n size"]
    slopes: Float[Array, "k n size"]
    assembly: Assembly
    assembly_slopes: Assembly
    status: Int[Array, ""]
    t_reached: Float[Array, ""]
    n_steps: Int[Array, ""]


def integrate_along(
    plan: Plan,
    options: Options,
    values: Float[Array, " p"],
    directions: Float[Array, "k p"],
    known: Float[Array, " n_numbers"],
    ts: Float[Array, " n"],
    start: Assembly | None,
    values_are_legal: Flag,
) -> StatesAndSlopes:
    """Integrate a run and its derivatives along directions in the traced numbers, in one integration.

    Args:
        plan, options, values, known, ts, start, values_are_legal: as for `integrate`.
        directions: of length |p| or so, for all sensitivities to be in the units of the state.

    The errors of the sensitivities are controlled as the state's, where `has_controlled_sensitivities`; otherwise the
    method's steps are differentiated.
    """
    if has_controlled_sensitivities(options.solver):
        return _controlled(plan, options, values, directions, known, ts, start, values_are_legal)

    def floats(values):
        outcome = integrate(plan, options, values, known, ts, start, values_are_legal)
        return (outcome.ys, outcome.assembly), outcome

    def along(direction):
        return jax.jvp(floats, (values,), (direction,), has_aux=True)

    _, slopes, outcome = jax.vmap(along, out_axes=(None, 0, None))(directions)
    n_steps = outcome.stats.n_steps
    return StatesAndSlopes(
        outcome.ys, slopes[0], outcome.assembly, slopes[1], outcome.status, outcome.t_reached, n_steps
    )


def _slopes_through_the_loop(plan, options, values, *rest) -> Slopes:
    """The derivative of every step of the run, in forward mode."""

    def floats(v):
        result = integrate(plan, options, v, *rest)
        return Slopes(result.ys, result.assembly)

    return jax.jacfwd(floats)(values)


@eqx.filter_jit
def _controlled_slopes(plan: Plan, options: Options, values: Float[Array, " p"], *rest) -> Slopes:
    """The derivatives by each of the traced numbers, with their errors controlled."""
    scale = scales_of(values)
    found = _controlled(plan, options, values, jnp.diag(scale), *rest)
    assembly = jax.tree.map(lambda x: _numbers_last(x, scale), found.assembly_slopes)
    return Slopes(_numbers_last(found.slopes, scale), assembly)


def _controlled(
    plan: Plan,
    options: Options,
    values: Float[Array, " p"],
    directions: Float[Array, "k p"],
    known: Float[Array, " n_numbers"],
    ts: Float[Array, " n"],
    start: Assembly | None,
    values_are_legal: Flag,
) -> StatesAndSlopes:
    """Integrate the state and its sensitivities together, with the errors of both controlled."""
    rate = program_for(state_rate, plan.structure, plan.scalar)
    contacts = contacts_of(plan.structure, plan.scalar)

    def parameters_of(values):
        theta = plan.theta(values, known)
        return Parameters(theta, rate.ahead(theta))

    def beginning_of(values):
        return beginning(plan, plan.theta(values, known), ts[0], start)

    (assembly, y0), (assembly_slopes, Y0) = linearized(beginning_of, values, directions)
    is_closed = assembly.residual_after < CLOSING_TOLERANCE
    may_run = is_closed & values_are_legal & jnp.all(jnp.isfinite(y0))
    t1 = jnp.where(may_run, ts[-1], ts[0])
    contacts = None if contacts is None else with_rows(contacts, rate)
    correct = correcting_rows(correction_for(plan))
    with without_host_checks():
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, rows, args: rows_rate(rate, args, t, rows)),
            wrapped(solver_of_rows(options.solver, plan.structure, rate), correct, contacts),
            t0=ts[0],
            t1=t1,
            dt0=None,
            y0=jnp.concatenate([y0[None], Y0]),
            args=linearized(parameters_of, values, directions),
            saveat=diffrax.SaveAt(subs=[samples(jnp.minimum(ts, t1), correct), diffrax.SubSaveAt(t1=True)]),
            stepsize_controller=landing_controller(judging_rows(options.controller), contacts, plan, ts),
            adjoint=options.adjoint,
            max_steps=options.max_steps,
            throw=False,
        )
    sampled: Any = solution.ys
    times: Any = solution.ts
    reached = times[1][0]
    status = status_of(solution.result, values_are_legal, is_closed)
    rows = jnp.where(((ts <= reached) & may_run)[:, None, None], sampled[0], jnp.nan)
    n_steps = solution.stats["num_steps"]
    slopes = jnp.moveaxis(rows[:, 1:], 1, 0)
    return StatesAndSlopes(rows[:, 0], slopes, assembly, assembly_slopes, status, reached, n_steps)


def _numbers_last(scaled: Float[Array, "p ..."], scale: Float[Array, " p"]) -> Array:
    return jnp.moveaxis(scaled, 0, -1) / scale

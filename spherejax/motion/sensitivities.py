"""Derivatives of runs by the numbers that the caller traces.

Sensitivities Y_k = s_k dy/dp_k are integrated together with the state (s_k = |p_k|, or 1 where p_k is 0, so that all
are in the units of the state),

    y_rate = f(y, p),    Y_k_rate = df/dy Y_k + s_k df/dp_k,

as rows of one matrix: y first, then one Y_k for each number. The step-size controller judges every row. That is
needed behind a contact onset, where df/dy grows like the root of time: steps that are right for the motion, whose
force grows like the power 3/2, are too long for its sensitivities.

At a contact onset the instant tau moves with the numbers. A step lands just behind it, and there

    Y_k := Y_k + (f_flight - f_contact) s_k dtau/dp_k,

while the memory's part jumps as `contacts.memory_after_step` says. The force of the landing window is below a
micronewton, and yet without this term each impact would add a relative error of 1e-7: contact stiffens from zero with
an infinite slope. Bristles, which begin to move at the onset, need the term in full.
"""

from collections.abc import Callable
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
from spherejax.motion.contacts import GRAZING_RATE
from spherejax.motion.dynamics import state_rate
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
from spherejax.motion.programs import Program, program_for
from spherejax.motion.solvers.landing import Contacts
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

    An implicit method would need the Jacobian of the state and all sensitivities together, with second derivatives of
    the right-hand side in it. Its runs are differentiated step by step instead.
    """
    return isinstance(solver, diffrax.AbstractERK)


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

    With an explicit Runge-Kutta method the errors of the sensitivities are controlled as the state's; any other
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
    scale = jnp.where(values == 0, 1.0, jnp.abs(values))
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

    (assembly, y0), (assembly_slopes, Y0) = _linearized(beginning_of, values, directions)
    is_closed = assembly.residual_after < CLOSING_TOLERANCE
    may_run = is_closed & values_are_legal & jnp.all(jnp.isfinite(y0))
    t1 = jnp.where(may_run, ts[-1], ts[0])
    contacts = None if contacts is None else _with_rows(contacts, rate)
    correct = _correcting_rows(correction_for(plan))
    with without_host_checks():
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, rows, args: _rows_rate(rate, args, t, rows)),
            wrapped(options.solver, correct, contacts),
            t0=ts[0],
            t1=t1,
            dt0=None,
            y0=jnp.concatenate([y0[None], Y0]),
            args=_linearized(parameters_of, values, directions),
            saveat=diffrax.SaveAt(subs=[samples(jnp.minimum(ts, t1), correct), diffrax.SubSaveAt(t1=True)]),
            stepsize_controller=landing_controller(_judging_rows(options.controller), contacts, plan, ts),
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


class Linearized(NamedTuple):
    """Something that follows from the traced numbers, and its derivatives along directions in them.

    Attributes:
        value: the value.
        slopes: the derivatives, with a leading axis of directions; None for what is not a float.
    """

    value: Any
    slopes: Any


def _linearized(function, values: Float[Array, " p"], directions: Float[Array, "k p"]) -> Linearized:
    """The value of a function of the traced numbers, and its derivatives."""

    def floats(values):
        return eqx.partition(function(values), lambda leaf: jnp.issubdtype(jnp.result_type(leaf), jnp.floating))

    def along(direction):
        return jax.jvp(floats, (values,), (direction,), has_aux=True)

    value, slopes, others = jax.vmap(along, out_axes=(None, 0, None))(directions)
    return Linearized(eqx.combine(value, others), slopes)


def _rows_rate(rate: Program, parameters: Linearized, t, rows: Float[Array, "rows size"]) -> Float[Array, "rows size"]:
    """The right-hand side for the state and its sensitivities."""

    def state_rate(numbers, y):
        return rate.inside(numbers.theta, numbers.ahead, t, y)

    return _rows_of(state_rate, (parameters.value, rows[0]), (parameters.slopes, rows[1:]))


def _rows_of(function, primals, slopes) -> Float[Array, "rows size"]:
    """A function's value as first row, its derivatives below."""

    def along(tangents):
        return eqx.filter_jvp(function, primals, tangents)

    value, tangents = eqx.filter_vmap(along, out_axes=(None, 0))(slopes)
    return jnp.concatenate([value[None], tangents])


def _correcting_rows(correct: Callable | None) -> Callable | None:
    """The drift control's correction of the state and of its sensitivities."""
    if correct is None:
        return None

    def correct_rows(parameters, t, rows):
        def corrected(numbers, y):
            return correct(numbers, t, y)

        return _rows_of(corrected, (parameters.value, rows[0]), (parameters.slopes, rows[1:]))

    return correct_rows


def _with_rows(contacts: Contacts, rate: Program) -> Contacts:
    """Contacts of the state in the first row; at an onset the sensitivities below it jump."""

    def crossings(parameters, t, rows):
        return contacts.crossings(parameters.value, t, rows[0])

    def update(parameters, t, start, end):
        def updated(numbers, y_start, y_end):
            return contacts.update(numbers, t, y_start, y_end)

        values = (parameters.value, start[0], end[0])
        rows = _rows_of(updated, values, (parameters.slopes, start[1:], end[1:]))
        began = ~contacts.is_touching(start[0]) & contacts.is_touching(rows[0])
        delays = _onset_delays(contacts, parameters, t, end, began, rows[0])
        flight, contact = jax.vmap(
            lambda y: rate.inside(parameters.value.theta, parameters.value.ahead, jnp.asarray(t), y)
        )(jnp.stack([end[0], rows[0]]))
        return rows.at[1:].add(delays[:, None] * (flight - contact))

    return Contacts(crossings, update, tuple((0, entry) for entry in contacts.onset_entries))


def _onset_delays(contacts: Contacts, parameters: Linearized, t, rows, began, updated) -> Float[Array, " p"]:
    """How much later the onset at the end of a step comes with each number (scaled) [s]; 0 without an onset.

    Limits: 0 for a grazing onset. Onsets in one step are taken as one, with the mean of their delays.
    """

    def value(numbers, y):
        return contacts.crossings(numbers, t, y).value

    slopes = _rows_of(value, (parameters.value, rows[0]), (parameters.slopes, rows[1:]))[1:]
    onset_rate = jnp.stack([updated[entry] for entry in contacts.onset_entries])
    counts = began & (onset_rate > GRAZING_RATE)
    rates = jnp.where(counts, contacts.crossings(parameters.value, t, rows[0]).rate, 1.0)
    return -jnp.sum(jnp.where(counts, slopes / rates, 0.0), 1) / jnp.maximum(jnp.sum(counts), 1)


def _judging_rows(controller):
    """The controller with the norm of the worst row, so that many numbers do not dilute the error of one."""
    if not isinstance(controller, diffrax.PIDController):
        return controller
    norm = controller.norm
    return eqx.tree_at(lambda c: c.norm, controller, lambda errors: jnp.max(jax.vmap(norm)(errors)))

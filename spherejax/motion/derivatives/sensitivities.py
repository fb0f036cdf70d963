"""Derivatives of runs by the numbers that the caller traces: rows of sensitivities beside the state, integrated under
error control; see `sensitivity_rows` for their equations.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, Int

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Flag
from spherejax.model.system import example_of
from spherejax.motion.derivatives.linear_operation import LinearMap, linear_operation
from spherejax.motion.derivatives.pullback import pulled_back
from spherejax.motion.derivatives.through_touches import any_jump, warn_of_rosenbrock
from spherejax.motion.equations.contacts import kinks_of
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration.diffrax_integration import diffeqsolve
from spherejax.motion.integration.implicit_rows import rows_with_fixed_matrix, slack_of
from spherejax.motion.integration.integrate import (
    Options,
    Outcome,
    Plan,
    audit_limits,
    audit_of,
    beginning,
    contacts_of,
    correction_for,
    integrate,
    landing_controller,
    parameters_from,
    room_of,
    samples,
    samples_reached,
    status_at_end,
    with_loop_of,
    wrapped,
)
from spherejax.motion.integration.one_run import RunRequest, can_be_a_job, run_of, slopes_as_job
from spherejax.motion.integration.sampling import samples_of
from spherejax.motion.integration.sensitivity_rows import (
    Linearized,
    RowParameters,
    correcting_rows,
    judging_rows,
    linearized,
    of_first_row,
    rows_rate,
    unseen_of_first_row,
    with_rows,
    with_start_time,
)
from spherejax.motion.integration.status import Status, start_status
from spherejax.motion.integration.unseen import unseen_of
from spherejax.motion.solvers.rosenbrock import AbstractRosenbrock
from spherejax.motion.solvers.traits import is_explicit
from spherejax.motion.start.assembly import Assembly
from spherejax.program_cache import cached_jit


def integrate_with_sensitivities(
    plan: Plan, options: Options, values, known, ts, start, values_are_legal, abrupt: tuple[str, ...] = ()
) -> Outcome:
    """As `integrate`, differentiable in forward and in reverse mode: by the traced numbers and by the sample times.

    The derivative rule computes all sensitivities by the traced numbers and applies them: that is linear in the
    tangent, so it can be transposed. With few parameters it is cheaper than a reverse sweep, in run time and far more
    in compile time. In a lane the outcome and its derivatives come from one integration, by diffrax from two.

    The derivative by the sample times is exact where time does not enter the equations by itself, and needs no
    integration; elsewhere the first time has a row of sensitivities of its own. See `sensitivity_rows`.

    Args:
        plan, options, values, known, ts, start, values_are_legal: as of `integrate`.
        abrupt: names of contacts that Rosenbrock methods do not differentiate well; see `through_touches`.
    """
    in_lanes = can_be_a_job(plan.structure, options)
    if not plan.unknown and not plan.from_state and is_concrete(ts):
        return run_of(plan, options, values, known, ts, start, values_are_legal)
    # Tolerances may be traced: a rule may not close over them.
    arrays, others = eqx.partition(options, eqx.is_array)

    def slopes_by(by_start: bool) -> Callable:
        """The run and its slopes, by the first sample time behind the numbers where `by_start`."""

        def by_diffrax(values, arrays, *rest: Any) -> tuple[Outcome, Slopes]:
            options = eqx.combine(arrays, others).decided
            outcome = run(values, arrays, *rest)
            if has_controlled_sensitivities(options.solver):
                return outcome, _controlled_slopes(plan, options, values, *rest, by_start=by_start)
            return outcome, _slopes_through_the_loop(plan, options, values, *rest, by_start=by_start)

        @jax.custom_jvp
        def with_slopes(values, arrays, *rest: Any) -> tuple[Outcome, Slopes]:
            options = eqx.combine(arrays, others).decided
            if not (in_lanes and has_controlled_sensitivities(options.solver)):
                return by_diffrax(values, arrays, *rest)
            scale = with_start_time(plan.scales(values), by_start)
            found = slopes_as_job(plan, options, values, _diagonal(scale), *rest, by_start=by_start)
            return found.outcome, Slopes(*_unscaled((found.ys, found.assembly), scale))

        def with_slopes_jvp(primals, tangents):
            # Second derivatives: lanes have none of their own.
            if by_start or _is_moved(tangents[3]):
                raise SceneError(NO_SECOND_BY_TIME)
            solver = eqx.combine(primals[1], others).decided.solver
            example = example_of(plan.structure)
            if example.touching_forces or (example.contact_joints and isinstance(solver, diffrax.AbstractERK)):
                raise SceneError(NO_SECOND_DERIVATIVES)
            _refuse_large(plan)
            found = by_diffrax(*primals)

            def floats(values):
                return eqx.filter(by_diffrax(values, *primals[1:]), _is_float)

            # All of them, then those along the tangent: that can be transposed, which diffrax's forward mode cannot.
            second = jax.jacfwd(floats)(primals[0])
            along = _instantiated(tangents[0], primals[0])
            # A film may never be pressed through; where it is, they would miss what happens there.
            along = jnp.where(_has_contact(plan, found[0]), jnp.nan, along)
            return found, jax.tree.map(
                lambda value, slopes: _no_tangent(value) if slopes is None else slopes @ along, found, second
            )

        with_slopes.defjvp(with_slopes_jvp, symbolic_zeros=True)
        return with_slopes

    is_by_one_direction = in_lanes and _goes_back(plan, options)

    def along_one_direction(outcome: Outcome, primals, tangent) -> Any:
        """The derivatives of samples and start along a tangent, whose transpose goes back along the run's steps."""
        residuals, tree = jax.tree.flatten((primals, outcome.status == Status.SUCCEEDED))

        def forward(leaves, x):
            (values, arrays, *rest), _ = jax.tree.unflatten(tree, leaves)
            options = eqx.combine(arrays, others).decided
            # Errors of sensitivities are judged in the units of the state: the tangent is as large as the numbers.
            size = jnp.max(jnp.abs(x[0] / plan.scales(values)))
            size = jnp.where(size > 0, size, 1.0)
            slopes = slopes_as_job(plan, options, values, (x[0] / size)[None], *rest)
            return jax.tree.leaves(jax.tree.map(lambda leaf: leaf[0] * size, (slopes.ys, slopes.assembly)))

        def backward(leaves, y):
            (values, arrays, *rest), has_succeeded = jax.tree.unflatten(tree, leaves)
            request = RunRequest.of(plan.structure, eqx.combine(arrays, others).decided)
            slopes = pulled_back(plan, request, values, *rest, *jax.tree.unflatten(image, y))
            return [jnp.where(has_succeeded, slopes, jnp.nan)]

        def differentiable(leaves, x):
            _, jacobian = slopes_by(False)(*jax.tree.unflatten(tree, leaves)[0])
            return jax.tree.leaves(_along(jacobian, x[0]))

        forms, image = jax.tree.flatten((outcome.ys, outcome.assembly))
        inputs, outputs = (_shapes_of(arrays) for arrays in ([tangent], forms))
        linear = LinearMap(forward, backward, differentiable, inputs, outputs)
        return jax.tree.unflatten(image, linear_operation(linear, residuals, [tangent]))

    @jax.custom_jvp
    def run(values, arrays, known, ts, start, values_are_legal):
        return run_of(plan, eqx.combine(arrays, others), values, known, ts, start, values_are_legal)

    def run_jvp(primals, tangents):
        values, _, known, ts, *_ = primals
        moves_times = _is_moved(tangents[3])
        by_start = moves_times and depends_on_time(plan)
        if moves_times:
            _refuse_by_time(plan)
        if _is_moved(tangents[0]) or by_start:
            has_touches = bool(example_of(plan.structure).touching_forces)
            jumps = any_jump(plan.structure.system(plan.theta(values, known))) if has_touches else None
            warn_of_rosenbrock(abrupt, options.solver)
            along = _instantiated(tangents[0], values)
            if is_by_one_direction and not by_start:
                outcome = run(*primals)
                ys_dot, assembly = along_one_direction(outcome, primals, along)
            else:
                outcome, jacobian = slopes_by(by_start)(*primals)
                if by_start:
                    along = jnp.append(along, tangents[3][0])
                ys_dot, assembly = _along(jacobian, along)
            if jumps is not None:  # of a function whose numbers `jax.jit` hides, an error can say nothing
                # A factor: `jnp.where` transposed would be a gradient of zero.
                ys_dot = ys_dot * jnp.where(jumps, jnp.nan, 1.0)
        else:
            outcome = run(*primals)
            ys_dot, assembly = jax.tree.map(jnp.zeros_like, (outcome.ys, outcome.assembly))
        succeeded = outcome.status == Status.SUCCEEDED
        t_dot = jnp.zeros_like(outcome.t_reached)
        if moves_times:
            # What the first time moves besides is in the rows, where it is more than a shift of all times.
            delays = tangents[3] if by_start else tangents[3] - tangents[3][0]
            ys_dot = ys_dot + delays[:, None] * _rates_at(plan, plan.theta(values, known), ts, outcome.ys)
            t_dot = tangents[3][-1]
        t_dot, y_dot = jax.tree.map(lambda dot: jnp.where(succeeded, dot, jnp.nan), (t_dot, ys_dot[-1]))
        counts = jax.tree.map(_no_tangent, (outcome.status, outcome.stats))
        return outcome, Outcome(ys_dot, t_dot, y_dot, counts[0], counts[1], assembly)

    run.defjvp(run_jvp, symbolic_zeros=True)
    arrays = jax.lax.stop_gradient(arrays)
    return run(values, arrays, known, ts, start, values_are_legal)


MANY = 32
"""Numbers above which a derivative is taken along one direction, and a gradient back along the run's steps.

Gradients by rows and back take as long as each other by some 40 weights of a network (13: 0.22 and 0.36 ms; 33: 0.59
and 0.73; 51: 0.46 and 0.38), and by some 30 numbers of a dry four-bar. The first call back takes 2 s more."""


def _goes_back(plan: Plan, options: Options) -> bool:
    """Whether gradients of a run go back along its steps, in place of rows for all numbers.

    Where a stiffness may be there at once each row has to be controlled by itself; see `adjoint.UNSURE_THROUGH_KINKS`.
    """
    return len(plan.unknown) > MANY and is_explicit(options.solver) and not kinks_of(plan.structure)


def _shapes_of(arrays: list) -> tuple[jax.ShapeDtypeStruct, ...]:
    return tuple(jax.ShapeDtypeStruct(jnp.shape(array), jnp.result_type(array)) for array in arrays)


def depends_on_time(plan: Plan) -> bool:
    """Whether a motion that begins later is another motion: time enters its equations by itself."""
    return example_of(plan.structure).is_driven or program_for(state_rate, plan.structure, plan.scalar).reads_time


def _refuse_by_time(plan: Plan) -> None:
    """Refuse what has no derivative by the sample times."""
    sampled = example_of(plan.structure).sampled_forces
    if sampled:
        raise SceneError(
            f"the motion has no derivative by its sample times: force {sampled[0]!r} samples at instants of its own, "
            "and a start that passes one of them changes the motion at once. Hold ts fixed (jax.lax.stop_gradient), or "
            "take differences of runs"
        )


NO_SECOND_BY_TIME = (
    "second derivatives of a run by its sample times are not available where numbers of the scene are traced, or where "
    "a drive, a road or an applied force depends on time. Take differences of jax.grad, which is right by the sample "
    "times: with a step of a thousandth of the motion's time scale they have four to six digits"
)


@cached_jit(what="the rates at the samples")
def _rates_at(plan: Plan, theta: Float[Array, " p"], ts: Float[Array, " n"], ys: Float[Array, "n size"]) -> Array:
    """Time derivatives of the flat states at the samples; NaN where these are."""
    rate = program_for(state_rate, plan.structure, plan.scalar)
    ahead = rate.ahead(theta)
    # A loop: mapped, the right-hand side of a large system would have temporaries for all samples at once.
    return jax.lax.map(lambda sample: rate.inside(theta, ahead, *sample), (ts, ys))


def _has_contact(plan: Plan, outcome: Outcome) -> Flag:
    """Whether a ball touches its socket, at the start or later."""
    contacts = contacts_of(plan.structure, plan.scalar)
    entries = () if contacts is None else contacts.onset_entries
    begins = [outcome.ys[0, entry] > 0 for entry in entries]
    return jnp.any(jnp.stack([jnp.array(False), *begins, *(outcome.stats.n_onsets > 0)]))


def _is_float(leaf: Any) -> bool:
    return jnp.issubdtype(jnp.result_type(leaf), jnp.floating)


def _is_moved(tangent: Any) -> bool:
    """Whether a tangent is more than the zero that JAX knows of."""
    return not isinstance(tangent, SymbolicZero)


def _instantiated(tangent: Any, value: Array) -> Array:
    """The tangent as an array."""
    return tangent if _is_moved(tangent) else jnp.zeros_like(value)


def _no_tangent(x: Array) -> Any:
    """The tangent of what is constant."""
    return np.zeros(x.shape, x.dtype if jnp.issubdtype(x.dtype, jnp.floating) else jax.dtypes.float0)


def _diagonal(scale: Any) -> Any:
    """As a matrix, shape (p, p); of known numbers by NumPy, as `scales_of`."""
    return np.diag(scale) if isinstance(scale, np.ndarray) else jnp.diag(scale)


def has_controlled_sensitivities(solver: diffrax.AbstractSolver) -> bool:
    """Whether a run with this solver integrates its sensitivities under error control.

    Explicit Runge-Kutta methods do, and Rosenbrock methods, whose steps are differentiated beside the state's; see
    `implicit_rows`. Of diffrax's implicit methods the whole run is differentiated step by step, errors unseen.
    """
    return isinstance(solver, diffrax.AbstractERK | AbstractRosenbrock)


MOST_FOR_SECOND = 5_000
"""Scalar operations of a right-hand side up to which second derivatives are taken. To compile them takes 40 s for a
pendulum (400 operations), two to five minutes for mechanisms of 2,000, 14 minutes and 5 GB for a chain of 3,200; at
13,000 (Andrews' mechanism) the process was killed for its 24 GB."""


def _refuse_large(plan: Plan) -> None:
    """Refuse second derivatives that no usual machine can compile: it would end the process, without a word."""
    program = program_for(state_rate, plan.structure, plan.scalar)
    n = np.inf if program.too_large else 0 if program.scalar is None else program.scalar.n_operations
    if n > MOST_FOR_SECOND:
        raise SceneError(
            f"second derivatives of a run whose right-hand side has {n:,.0f} scalar operations take more memory to "
            f"compile than most machines have (up to {MOST_FOR_SECOND:,} it takes minutes). Take "
            "differences of jax.grad: with a step of a thousandth of a number they have four to six digits"
        )


def refuse_through_kinks(plan: Plan, method: str) -> None:
    """Refuse derivatives of a run's own steps where a force may have a kink: stages on both sides mix its slopes.

    Args:
        plan: what the run is compiled for.
        method: that integrates, or differentiates.
    """
    if kinks_of(plan.structure):
        raise SceneError(through_kinks(plan, method))


def through_kinks(plan: Plan, method: str) -> str:
    """Why there is no derivative by a method, and what to do."""
    return (
        f"derivatives by {method} are not right through {names_of_kinks(plan)}: where it begins to press, its "
        "stiffness may be there at once, and a step with stages on both sides gives derivatives that are wrong by any "
        "amount, or not finite. Leave solver= and adjoint= out, or take solver=spherejax.Rodas5P()"
    )


def names_of_kinks(plan: Plan) -> str:
    """The joints and forces whose stiffness may be there at once, in words; empty without."""
    system = example_of(plan.structure)
    contacts = [name for i, name in enumerate(system.contact_joints) if i in kinks_of(plan.structure)]
    return " and ".join(map(repr, (*contacts, *system.touching_forces)))


NO_SECOND_DERIVATIVES = (
    "second derivatives of a run with a clearance joint, a stop or a tyre are not right: they miss what happens when "
    "contact begins (6 % on a dry four-bar). Take differences of jax.grad, which is right through contact: with a step "
    "of a thousandth of a number they have four digits"
)


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
    if can_be_a_job(plan.structure, options):
        found = slopes_as_job(plan, options, values, directions, known, ts, start, values_are_legal)
        run = found.outcome
        return StatesAndSlopes(
            run.ys, found.ys, run.assembly, found.assembly, run.status, run.t_reached, run.stats.n_steps
        )
    if has_controlled_sensitivities(options.solver):
        return _controlled(plan, options, values, directions, known, ts, start, values_are_legal)
    refuse_through_kinks(plan, type(options.solver).__name__)

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


def _slopes_through_the_loop(
    plan, options, values, known, ts, start, values_are_legal, by_start: bool = False
) -> Slopes:
    """The derivative of every step of the run, in forward mode."""
    refuse_through_kinks(plan, type(options.solver).__name__)

    def floats(v):
        result = integrate(plan, options, v, known, ts, start, values_are_legal)
        return Slopes(result.ys, result.assembly)

    if values.shape[0]:
        slopes = jax.jacfwd(floats)(values)
    else:  # JAX maps over no directions where there are none, and its reductions do not bear that
        slopes = jax.tree.map(lambda leaf: jnp.zeros((*leaf.shape, 0)), jax.eval_shape(floats, values))
    if not by_start:
        return slopes
    # A motion that begins later at the state y0 is there where one that begins now has the state y0 - f dt.
    along = jnp.zeros((1, values.shape[0] + 1)).at[0, -1].set(1.0)
    began = start_of_rows(plan, values, along, known, ts, start, values_are_legal, by_start)

    def from_state(y0):
        at_state = replace(plan, from_state=False)
        return integrate(at_state, options, values, known, ts, began.assembly._replace(y=y0), values_are_legal).ys

    by_time = jax.jvp(from_state, (began.y0,), (began.slopes[0],))[1]
    assembly = jax.tree.map(
        lambda j, dot: jnp.concatenate([j, dot[0][..., None]], -1), slopes[1], began.assembly_slopes
    )
    return Slopes(jnp.concatenate([slopes.ys, by_time[..., None]], -1), assembly)


@cached_jit(what="the derivatives of a run")
def _controlled_slopes(
    plan: Plan, options: Options, values: Float[Array, " p"], known, ts, start, values_are_legal, by_start: bool
) -> Slopes:
    """The derivatives by each of the traced numbers, with their errors controlled."""
    scale = with_start_time(plan.scales(values), by_start)
    found = _controlled(plan, options, values, _diagonal(scale), known, ts, start, values_are_legal, by_start)
    return Slopes(*_unscaled((found.slopes, found.assembly_slopes), scale))


def _controlled(
    plan: Plan,
    options: Options,
    values: Float[Array, " p"],
    directions: Float[Array, "k p"],
    known: Float[Array, " n_numbers"],
    ts: Float[Array, " n"],
    start: Assembly | None,
    values_are_legal: Flag,
    by_start: bool = False,
) -> StatesAndSlopes:
    """Integrate the state and its sensitivities together, with the errors of both controlled."""
    rate = program_for(state_rate, plan.structure, plan.scalar)

    began = start_of_rows(plan, values, directions, known, ts, start, values_are_legal, by_start)
    rows0 = jnp.concatenate([began.y0[None], began.slopes])
    parameters = linearized(partial(parameters_from, plan, rate, known), values, directions[:, : values.shape[0]])
    found = integrate_rows(plan, options, parameters, rows0, ts, began)
    slopes = jnp.moveaxis(found.rows[:, 1:], 1, 0)
    return StatesAndSlopes(
        found.rows[:, 0], slopes, began.assembly, began.assembly_slopes, found.status, found.t_reached, found.n_steps
    )


class RowsStart(NamedTuple):
    """The start of a run and its derivatives along k directions in the traced numbers.

    Attributes:
        y0: flat state.
        slopes: its derivatives.
        assembly: how the start was made consistent.
        assembly_slopes: its derivatives, with a leading axis of directions.
        values_are_legal: whether the scene's conditions hold.
    """

    y0: Float[Array, " size"]
    slopes: Float[Array, "k size"]
    assembly: Assembly
    assembly_slopes: Assembly
    values_are_legal: Flag

    @property
    def status(self) -> Int[Array, ""]:
        """Of the run before its first step, an integer of `Status`."""
        return start_status(self.values_are_legal, self.assembly.residual_after, self.y0)

    @property
    def may_run(self) -> Flag:
        """Whether the run can be made."""
        return self.status == Status.SUCCEEDED


def start_of_rows(
    plan: Plan,
    values,
    directions,
    known,
    ts: Float[Array, " n"],
    start: Assembly | None,
    values_are_legal: Flag,
    by_start: bool = False,
) -> RowsStart:
    """The start of a run and its derivatives; arguments as for `integrate_along`.

    With `by_start` the directions have the first sample time as their last entry.
    """
    n = values.shape[0]

    def beginning_of(values):
        t0 = values[n] if by_start else ts[0]
        return beginning(plan, plan.theta(values[:n], known), t0, plan.start(values[:n], start))

    numbers = jnp.append(values, ts[0]) if by_start else values
    (assembly, y0), (assembly_slopes, slopes) = linearized(beginning_of, numbers, directions)
    if by_start:
        rate = program_for(state_rate, plan.structure, plan.scalar)
        slopes = slopes - directions[:, n, None] * rate(plan.theta(values, known), ts[0], y0)
    return RowsStart(y0, slopes, assembly, assembly_slopes, values_are_legal)


class IntegratedRows(NamedTuple):
    """A state and its sensitivities along time, as rows of one matrix.

    Attributes:
        rows: at the sample times; NaN where they were not reached.
        also_saved: times and values of what was saved besides.
        status: integer of `Status`.
        t_reached: time reached [s].
        n_steps: steps tried.
    """

    rows: Float[Array, "n rows size"]
    also_saved: list[tuple[Array, Array]]
    status: Int[Array, ""]
    t_reached: Float[Array, ""]
    n_steps: Int[Array, ""]


def integrate_rows(
    plan: Plan,
    options: Options,
    parameters: Linearized,
    rows0: Float[Array, "rows size"],
    ts: Float[Array, " n"],
    began: RowsStart,
    also_saved: Sequence[diffrax.SubSaveAt] = (),
) -> IntegratedRows:
    """Integrate a state and its sensitivities together, with the errors of all rows controlled.

    Args:
        plan, options, ts: as for `integrate`.
        parameters: what the right-hand side is given, and its derivatives.
        rows0: the first state, then its derivatives.
        began: the start.

    Other args:
        also_saved: what to save besides the samples.
    """
    rate = program_for(state_rate, plan.structure, plan.scalar)
    contacts = contacts_of(plan.structure, plan.scalar)
    contacts = None if contacts is None else with_rows(contacts, rate)
    correct = correcting_rows(correction_for(plan))
    taken = samples_of(plan.structure, plan.scalar)
    taken = None if taken is None else taken.of_rows()
    t1 = jnp.where(began.may_run, ts[-1], ts[0])
    saved = [samples(jnp.minimum(ts, t1), correct, taken), diffrax.SubSaveAt(t1=True), *also_saved]
    solver = with_loop_of(options.adjoint, rows_with_fixed_matrix(options.solver, plan.structure, rate))
    # As the state's; through kinks those of a W-method less.
    slack = min(1.0, slack_of(solver, plan.structure))
    judging = replace(options, controller=judging_rows(options.controller, slack))
    solution = diffeqsolve(
        diffrax.ODETerm(lambda t, rows, args: rows_rate(rate, args, t, rows)),
        wrapped(solver, correct, contacts, taken, audit_of(plan).of_rows()),
        t0=ts[0],
        t1=t1,
        dt0=None,
        y0=rows0,
        args=RowParameters(*parameters, audit_limits(plan, options, parameters.value.theta)),
        saveat=diffrax.SaveAt(subs=saved),
        stepsize_controller=landing_controller(
            judging,
            solver,
            contacts,
            taken,
            plan,
            ts,
            of_first_row(room_of(plan)),
            unseen_of_first_row(unseen_of(plan.structure, plan.scalar, solver)),
        ),
        adjoint=options.adjoint,
        max_steps=options.max_steps,
        throw=False,
    )
    sampled: Any = solution.ys
    times: Any = solution.ts
    reached = times[1][0]
    rows = samples_reached(sampled[0], (ts <= reached) & began.may_run)
    status = status_at_end(began.status, solution.result, reached, ts[-1], rows, sampled[1])
    others = list(zip(times[2:], sampled[2:], strict=True))
    return IntegratedRows(rows, others, status, reached, solution.stats["num_steps"])


@jax.jit
def _along(jacobian: Slopes, tangent: Float[Array, " p"]) -> Slopes:
    """Derivatives along a tangent of the numbers; NaN at samples that the run did not reach."""
    return jax.tree.map(lambda j: j @ tangent, jacobian)


def _unscaled(scaled: Any, scale: Any) -> Any:
    """Derivatives by the numbers, with these on the last axis, of those by scaled numbers, with these on the first."""
    if all(map(is_concrete, jax.tree.leaves((scaled, scale)))):
        return jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf), 0, -1) / scale, scaled)
    return _unscaled_within(scaled, scale)


@jax.jit
def _unscaled_within(scaled: Any, scale: Float[Array, " p"]) -> Any:
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1) / scale, scaled)

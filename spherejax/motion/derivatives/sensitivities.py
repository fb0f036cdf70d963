"""Derivatives of runs by the numbers that the caller traces: rows of sensitivities beside the state, integrated under
error control; see `sensitivity_rows` for their equations.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete, is_tracing
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Flag
from spherejax.model.system import example_of
from spherejax.motion.derivatives.known_jacobians import primal_alone, times_jacobians, with_derivatives
from spherejax.motion.derivatives.linear_operation import LinearMap, is_linearized_in_program, linear_operation
from spherejax.motion.derivatives.pullback import (
    StepsKept,
    can_go_back,
    can_keep_steps,
    pulled_back,
    run_that_keeps_steps,
    with_steps_back,
)
from spherejax.motion.derivatives.through_touches import any_jump, warn_of_rosenbrock
from spherejax.motion.equations.contacts import kinks_of
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration.one_run import differentiable_slopes, run_and_slopes, run_of
from spherejax.motion.integration.problem import Outcome, Plan, RunInputs, RunMethod, contacts_of
from spherejax.motion.integration.sensitivity_rows import with_start_time
from spherejax.motion.integration.status import Status
from spherejax.motion.start.assembly import Assembly
from spherejax.program_cache import cached_jit


def integrate_with_sensitivities(
    plan: Plan, method: RunMethod, inputs: RunInputs, abrupt: tuple[str, ...] = (), traced: Any = None
) -> Outcome:
    """As `run_of`, differentiable in forward and in reverse mode: by the traced numbers and by the sample times.

    The derivative rule computes all sensitivities by the traced numbers and applies them: that is linear in the
    tangent, so it can be transposed. With few parameters it is cheaper than a reverse sweep, in run time and far more
    in compile time. The outcome and its derivatives come from one integration.

    The derivative by the sample times is exact where time does not enter the equations by itself, and needs no
    integration; elsewhere the first time has a row of sensitivities of its own. See `sensitivity_rows`.

    Args:
        plan, method, inputs: as of `run_of`.
        abrupt: names of contacts that Rosenbrock methods do not differentiate well; see `through_touches`.
        traced: the array that the caller traces, where the values of `inputs`, as all of these, are the numbers behind
            it; None where these values are what is traced.
    """
    if traced is not None:
        return _with_known_derivatives(plan, method, traced, inputs, abrupt)
    if not plan.unknown and not plan.from_state and is_concrete(inputs.ts):
        return run_of(plan, method, inputs)
    numbers = _numbers_behind(method, inputs)
    if numbers is not None:
        return _with_known_derivatives(plan, method, inputs.values, numbers, abrupt)
    # Tolerances may be traced: a rule may not close over them.
    arrays, others = eqx.partition(method, eqx.is_array)

    @jax.custom_jvp
    def run(inputs: RunInputs, arrays: Any) -> Outcome:
        return run_of(plan, eqx.combine(arrays, others), inputs)

    def run_jvp(primals, tangents):
        inputs, moved = primals[0], tangents[0]
        values, ts = inputs.values, inputs.ts
        moves_times = _is_moved(moved.ts)
        by_start = moves_times and depends_on_time(plan)
        if moves_times:
            _refuse_by_time(plan)
        if _is_moved(moved.values) or by_start:
            has_touches = bool(example_of(plan.structure).touching_forces)
            jumps = any_jump(plan.structure.system(plan.theta_of(inputs))) if has_touches else None
            warn_of_rosenbrock(abrupt, method.solver)
            along = _instantiated(moved.values, values)
            if _goes_back(plan) and not by_start:
                # In reverse mode the run keeps its steps for the way back. In forward mode it would carry a sensitivity
                # that nobody reads.
                keeps = is_linearized_in_program(values, moved.values) and can_keep_steps(plan, method)
                outcome, kept = keeping(*primals) if keeps else (run(*primals), None)
                ys_dot, assembly = _along_one_direction(plan, others, primals, outcome, kept)(along)
            else:
                outcome, jacobian = _run_and_jacobians(plan, others, by_start)(*primals)
                if by_start:
                    along = jnp.append(along, moved.ts[0])
                ys_dot, assembly = _along(jacobian, along)
            if jumps is not None:  # of a function whose numbers `jax.jit` hides, an error can say nothing
                # A factor: `jnp.where` transposed would be a gradient of zero.
                ys_dot = ys_dot * jnp.where(jumps, jnp.nan, 1.0)
        else:
            outcome = run(*primals)
            ys_dot, assembly = jax.tree.map(jnp.zeros_like, (outcome.ys, outcome.assembly))
            along = jnp.zeros(0)
        t_dot = np.zeros(())
        if moves_times:
            # What the first time moves besides is in the rows, where it is more than a shift of all times.
            delays = moved.ts if by_start else moved.ts - moved.ts[0]
            ys_dot = ys_dot + delays[:, None] * _rates_at(plan, plan.theta_of(inputs), ts, outcome.ys)
            t_dot = moved.ts[-1]
        t_dot, y_dot = _at_end(outcome.status, t_dot, ys_dot, along)
        counts = jax.tree.map(_no_tangent, (outcome.status, outcome.stats))
        return outcome, Outcome(ys_dot, t_dot, y_dot, counts[0], counts[1], assembly)

    @jax.custom_jvp
    def keeping(inputs: RunInputs, arrays: Any) -> tuple[Outcome, StepsKept]:
        return run_that_keeps_steps(plan, eqx.combine(arrays, others), inputs)

    def keeping_jvp(primals, tangents):
        outcome, outcome_dot = run_jvp(primals, tangents)
        kept = StepsKept.of_nothing(plan)
        return (outcome, kept), (outcome_dot, jax.tree.map(_zero_tangent, kept))

    run.defjvp(run_jvp, symbolic_zeros=True)
    keeping.defjvp(keeping_jvp, symbolic_zeros=True)
    return run(inputs, jax.lax.stop_gradient(arrays))


def _run_and_jacobians(plan: Plan, others: Any, by_start: bool = False) -> Callable[[RunInputs, Any], tuple]:
    """The run and its slopes, by the first sample time behind the numbers where `by_start`.

    Args:
        plan: as of `run_of`.
        others: the method without its arrays, which are an argument of the function that is returned.
        by_start: whether there are slopes by the first sample time.
    """

    @jax.custom_jvp
    def with_slopes(inputs: RunInputs, arrays: Any) -> tuple[Outcome, Slopes]:
        scale = with_start_time(plan.scales(inputs.values), by_start)
        run = run_and_slopes(plan, eqx.combine(arrays, others), inputs, _diagonal(scale), by_start)
        return run.outcome, Slopes(*_unscaled((run.slopes, run.assembly_slopes), scale))

    def with_slopes_jvp(primals, tangents):
        inputs, moved = primals[0], tangents[0]
        if by_start or _is_moved(moved.ts):
            raise SceneError(NO_SECOND_BY_TIME)
        method = eqx.combine(primals[1], others).decided
        example = example_of(plan.structure)
        if example.touching_forces or (example.contact_joints and isinstance(method.rest, diffrax.AbstractERK)):
            raise SceneError(NO_SECOND_DERIVATIVES)
        _refuse_large(plan)
        first = with_slopes(*primals)

        def floats(values):
            return eqx.filter(_differentiable(plan, method, inputs._replace(values=values)), _is_float)

        # All of them, then those along the tangent: that can be transposed, which a loop cannot.
        second = jax.jacfwd(floats)(inputs.values)
        along = _instantiated(moved.values, inputs.values)
        # A film may never be pressed through; where it is, they would miss what happens there.
        along = jnp.where(_has_contact(plan, first[0]), jnp.nan, along)
        return first, jax.tree.map(
            lambda value, slopes: _no_tangent(value) if slopes is None else slopes @ along, first, second
        )

    with_slopes.defjvp(with_slopes_jvp, symbolic_zeros=True)
    return with_slopes


def _along_one_direction(
    plan: Plan, others: Any, primals: tuple[RunInputs, Any], outcome: Outcome, kept: StepsKept | None = None
) -> Callable[[Array], tuple[Any, Assembly]]:
    """The derivatives of samples and start along a tangent, whose transpose goes back along the run's steps."""
    residuals, tree = jax.tree.flatten((primals, outcome.status == Status.SUCCEEDED, kept))
    image: Any = jax.tree.structure((outcome.ys, outcome.assembly))

    def forward(leaves, x):
        (inputs, arrays), *_ = jax.tree.unflatten(tree, leaves)
        # Errors of sensitivities are judged in the units of the state: the tangent is as large as the numbers.
        size = jnp.max(jnp.abs(x[0] / plan.scales(inputs.values)))
        size = jnp.where(size > 0, size, 1.0)
        one = run_and_slopes(plan, eqx.combine(arrays, others), inputs, (x[0] / size)[None])
        return jax.tree.leaves(jax.tree.map(lambda leaf: leaf[0] * size, (one.slopes, one.assembly_slopes)))

    def backward(leaves, y):
        (inputs, arrays), has_succeeded, kept = jax.tree.unflatten(tree, leaves)
        method = eqx.combine(arrays, others)
        back = method.with_solver(with_steps_back(method.solver))
        gradient = pulled_back(plan, back, inputs, *jax.tree.unflatten(image, y), None, kept, has_succeeded)
        gradient.warn()
        return [gradient.slopes]

    def differentiable(leaves, x):
        _, jacobian = _run_and_jacobians(plan, others)(*jax.tree.unflatten(tree, leaves)[0])
        return jax.tree.leaves(_along(jacobian, x[0]))

    def along(tangent: Array) -> tuple[Any, Assembly]:
        inputs, outputs = _shapes_of([tangent]), _shapes_of(jax.tree.leaves((outcome.ys, outcome.assembly)))
        linear = LinearMap(forward, backward, differentiable, inputs, outputs)
        return jax.tree.unflatten(image, linear_operation(linear, residuals, [tangent]))

    return along


def _numbers_behind(method: RunMethod, inputs: RunInputs) -> RunInputs | None:
    """The inputs with numbers in place of the traced ones, where one `jax.jvp` or `jax.grad` has nothing else traced;
    None within `jax.jit`, `jax.vmap` and a second derivative."""
    values = primal_alone(inputs.values)
    if values is None or is_tracing():
        return None
    numbers = inputs._replace(values=values)
    return numbers if all(map(is_concrete, jax.tree.leaves((method, numbers)))) else None


def _with_known_derivatives(
    plan: Plan, method: RunMethod, traced: Any, numbers: RunInputs, abrupt: tuple[str, ...]
) -> Outcome:
    """The outcome of a run whose derivatives are computed with it, by the numbers behind what the caller traces.

    Args:
        plan, method, abrupt: as of `integrate_with_sensitivities`.
        traced: the array that the caller traces.
        numbers: of the run, those behind the traced array among them.
    """
    has_touches = bool(example_of(plan.structure).touching_forces)
    if has_touches:  # an error where a force jumps at its touch; all numbers are known
        any_jump(plan.structure.system(plan.theta_of(numbers)))
    warn_of_rosenbrock(abrupt, method.solver)
    # Of a start that is known already there are no derivatives: it is no function of the numbers.
    n = None if numbers.start is None or plan.from_state else 2
    if _goes_back(plan):
        outcome = run_of(plan, method, numbers)
        arrays, others = eqx.partition(method, eqx.is_array)
        along_all = _along_one_direction(plan, others, (numbers, arrays), outcome)
        has_succeeded = int(outcome.status) == Status.SUCCEEDED

        def along(tangent: Array) -> list:
            ys_dot, assembly = along_all(jnp.ravel(tangent))
            return [ys_dot, ys_dot[-1] if has_succeeded else jnp.full_like(ys_dot[-1], jnp.nan), *assembly][:n]

    else:
        scale = plan.scales(numbers.values)
        run = run_and_slopes(plan, method, numbers, _diagonal(scale))
        outcome = run.outcome
        ys, *assembly = _unscaled([run.slopes, *([] if n else run.assembly_slopes)], scale)
        has_succeeded = int(outcome.status) == Status.SUCCEEDED
        jacobians = [ys, ys[-1] if has_succeeded else np.full_like(ys[-1], np.nan), *assembly]

        def along(tangent: Array) -> list:
            return times_jacobians(tangent, *jacobians)

    results = [outcome.ys, outcome.y_reached, *outcome.assembly][:n]
    ys, y_reached, *assembly = with_derivatives(traced, results, along)
    t_reached = outcome.t_reached
    if not has_succeeded:
        (t_reached,) = with_derivatives(traced, [t_reached], lambda tangent: [jnp.nan * jnp.sum(tangent)])
    start = Assembly(*assembly) if assembly else outcome.assembly
    return Outcome(ys, t_reached, y_reached, outcome.status, outcome.stats, start)


MANY = 32
"""Numbers above which a derivative is taken along one direction, and a gradient back along the run's steps.

Gradients by rows and back take as long as each other by some 40 weights of a network (13: 0.22 and 0.36 ms; 33: 0.59
and 0.73; 51: 0.46 and 0.38), and by some 30 numbers of a dry four-bar. The first call back takes 2 s more."""


def _goes_back(plan: Plan) -> bool:
    """Whether gradients of a run go back along its steps, in place of rows for all numbers."""
    return len(plan.unknown) > MANY and can_go_back(plan)


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


def _zero_tangent(x: Array) -> Any:
    """The tangent of an array that may be large: of numbers no constant of its size."""
    return jnp.zeros_like(x) if _is_float(x) else _no_tangent(x)


def _no_tangent(x: Array) -> Any:
    """The tangent of what is constant."""
    return np.zeros(x.shape, x.dtype if jnp.issubdtype(x.dtype, jnp.floating) else jax.dtypes.float0)


def _diagonal(scale: Any) -> Any:
    """As a matrix, shape (p, p); of known numbers by NumPy, as `scales_of`."""
    return np.diag(scale) if isinstance(scale, np.ndarray) else jnp.diag(scale)


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


def through_kinks(plan: Plan, method: str) -> str:
    """Why there is no derivative by a method, and what to do."""
    return (
        f"derivatives by {method} are not right through {_names_of_kinks(plan)}: where it begins to press, its "
        "stiffness may be there at once, and a step with stages on both sides gives derivatives that are wrong by any "
        "amount, or not finite. Leave solver= and adjoint= out, or take solver=spherejax.solvers.Rodas5P()"
    )


def _names_of_kinks(plan: Plan) -> str:
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


@cached_jit(what="the derivatives of a run")
def _differentiable(plan: Plan, method: RunMethod, inputs: RunInputs) -> tuple[Outcome, Slopes]:
    """A run and its slopes, to be differentiated once more in forward mode."""
    scale = plan.scales(inputs.values)
    run = differentiable_slopes(plan, method, inputs, _diagonal(scale))
    return run.outcome, Slopes(*_unscaled((run.slopes, run.assembly_slopes), scale))


@jax.jit
def _along(jacobian: Slopes, tangent: Float[Array, " p"]) -> Slopes:
    """Derivatives along a tangent of the numbers; NaN at samples that the run did not reach."""
    return jax.tree.map(lambda j: j @ tangent, jacobian)


@jax.jit
def _at_end(
    status: Array, t_dot: Float[Array, ""], ys_dot: Float[Array, "n size"], along: Float[Array, " p"]
) -> tuple[Array, Array]:
    """The tangents of the time and of the state at the end, along a tangent of the numbers; NaN where the run did not
    come there, in reverse mode as well."""
    # Factors: `jnp.where` transposed would be a gradient of zero.
    factor = jnp.where(status == Status.SUCCEEDED, 1.0, jnp.nan)
    return factor * t_dot + (factor - 1) * jnp.sum(along), factor * ys_dot[-1]


def _unscaled(scaled: Any, scale: Any) -> Any:
    """Derivatives by the numbers, with these on the last axis, of those by scaled numbers, with these on the first."""
    if all(map(is_concrete, jax.tree.leaves((scaled, scale)))):
        return jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf), 0, -1) / scale, scaled)
    return _unscaled_within(scaled, scale)


@jax.jit
def _unscaled_within(scaled: Any, scale: Float[Array, " p"]) -> Any:
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1) / scale, scaled)

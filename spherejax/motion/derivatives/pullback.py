"""The gradient of a run by many numbers under JAX's transformations: back along the steps of the run, once.

Rows of sensitivities (`sensitivity_rows`) cost in proportion to the numbers: the gradient by the 1,185 weights of a
force took as long as 3,000 runs. Here the run keeps its steps y_0, y_1, ...; then lambda_n, the derivatives of what is
wanted by y_n, follow from the last to the first,

    (lambda_n, mu_n) = (d(y_n+1, samples in the step)/d(y_n, numbers))^T (lambda_n+1, derivatives by these samples),

and the sum of all mu_n are the derivatives by the numbers. Samples inside a step are the method's own interpolation
between its stages, as in the run itself, so each step is evaluated once, with all of its samples.

The run that keeps them carries one sensitivity along, by a mixture of all numbers, whose error is controlled with the
state's: its steps are then short enough for derivatives, behind contact onsets as well (`sensitivity_rows`). Where JAX
asks for a value and its gradient in one program, that run gives the value as well (`run_that_keeps_steps`), within the
same tolerances. Elsewhere (outside of `jax.jit`, and where `jax.jit` or `jax.vmap` stands between) it is a second run,
made for the way back. The run and the way back are one call of machine code each, where all in them has a rule; mapped,
such calls are made on all processors.

A compiled program has room for a fixed number of steps. A longer run is cut into stretches: the run goes to its end and
notes the state at which each stretch begins; then each stretch, from the last to the first, is made once more and gone
back. From the same state a stretch takes the same steps to the last bit.

The steps are those of the method, a Rosenbrock method's with its matrix differentiated (`implicit_rows`); a method that
is neither explicit nor that is replaced by Rodas5P.

Limits: step-size control sees the errors of the derivatives along the mixture alone. Directions that grow although the
mixture does not are detected by the error amplification of the adjoint lambda, see `Gradient`.
"""

import warnings
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.types import Flag
from spherejax.model.system import example_of
from spherejax.motion.equations.contacts import kinks_of
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import Program, program_for
from spherejax.motion.equations.projection import correction_reads_parameters
from spherejax.motion.integration.compiling import (
    for_one_run,
    in_machine_code,
    in_one_call,
    native_run,
    options_for,
    uninitialized,
)
from spherejax.motion.integration.implicit_rows import differentiable_solver
from spherejax.motion.integration.jobs import Job, JobKind, with_slopes
from spherejax.motion.integration.lanes import Block, LaneProblem, StepLog, steps_in_lanes
from spherejax.motion.integration.lanes.landing import BEHIND
from spherejax.motion.integration.lanes.over_kinks import gone_over_kink
from spherejax.motion.integration.lanes.stages import explicit_tableau, own_time
from spherejax.motion.integration.one_run import integrated, lane_job, made_alone, outcome_of_first_row, run_and_slopes
from spherejax.motion.integration.problem import (
    Outcome,
    Parameters,
    Plan,
    RunInputs,
    RunMethod,
    beginning,
    contacts_of,
    correction_for,
    parameters_from,
)
from spherejax.motion.integration.sampling import samples_of
from spherejax.motion.integration.sensitivity_rows import delay_weights
from spherejax.motion.integration.status import SimulationWarning, Status
from spherejax.motion.solvers.joint_rates import fastest_in_clearance
from spherejax.motion.solvers.kinks import over_kink
from spherejax.motion.solvers.rosenbrock import Rodas5P
from spherejax.motion.solvers.traits import is_explicit, is_linearly_implicit
from spherejax.motion.start.assembly import ideal_numbers, is_assembled_by_arrays, numbers_of_start
from spherejax.physics.forces.remembering import SAME_INSTANT
from spherejax.program_cache import cached_jit

LARGEST_AMPLIFICATION = 1.0
"""Error amplification up to which a gradient is returned; beyond it the gradient is NaN, see `Gradient`.

The sensitivity along the mixture stays of the size of one on steps on which the adjoint along other directions grows to
1e18 (a four-bar with Bushing(1e6, 100), whose rates are 7e8 per second, at an rtol of 1e-6). There the amplification is
2e14, and the gradient wrong by any factor; it is 4e1 to 9e3 at 1e-7, with errors of 1e-3 to 1e-1 (other samples make
other steps), and 3e-4 at 1e-8, with an error of 3e-6. Through impacts and films it is below 1e-3 at 1e-6, in proportion
to rtol (`benchmarks/adjoint_accuracy.py`)."""

LARGEST_UNROLLED = 500
"""Numbers of a right-hand side up to which the stages of an explicit step are unrolled.

An unrolled stage accumulates the cotangents of the stages that it has weights for; in a loop each stage passes through
the cotangents of all stages, and the gradient of a dry four-bar (167 numbers) takes an eighth longer. Cotangents of the
numbers are summed in place by a loop, and copied by unrolled stages: with 1,205 numbers the loop is 5 to 9 % faster."""

ROOM, ROOM_WITH_CONTACT = 1024, 4096
"""Steps of a stretch. All stretches but the last are made twice. Room that is not used is not written either."""

FACTOR_OVER_KINKS = 0.1
"""Errors of the mixture, where the steps that a user's controller judges begin by going over kinks: this share of what
a row by one number is allowed. With 1 the gradient of a ball in a socket of 1e8 N/m is right to 1e-6, with 0.1 to 1e-7.
"""

FACTOR_ELSEWHERE = 20.0
"""Tolerance of the errors of the mixture, as a multiple of the state's, for explicit methods: the mixture is judged by
its own size, which is stricter than the state's tolerance.

With 20 in place of 5 the gradient of a dry four-bar takes a tenth less, with 50 hardly less than that. Its errors with
5, 20 and 50 at an rtol of 1e-8 are 4e-8, 4e-8 and 1e-7 (3e-6, 3e-6 and 4e-5 at 1e-6), with five times the clearance
2e-8, 7e-8 and 7e-8 (`benchmarks/adjoint_accuracy.py`). Through contacts of other exponents they are up to 5e-7."""

N_STRETCHES = 4096
"""So many of them, four million steps and more; the gradient of a run with more is NaN."""


class Gradient(NamedTuple):
    """The derivatives of a number by the traced numbers.

    Attributes:
        slopes: the derivatives; NaN where the run fails, and where the error amplification is too large.
        amplification: the error amplification, max over steps of |lambda_n| . (atol + rtol |y_n|), as a share of the
            size |dg/dy| . (atol/rtol + |y|) of the differentiated number g, summed over its samples. Beyond
            `LARGEST_AMPLIFICATION` a local error within the tolerances changes g by more than its own size: neither g
            nor its gradient is determined.
    """

    slopes: Float[Array, " p"]
    amplification: Float[Array, ""]

    def warn(self, stacklevel: int = 2) -> None:
        """Give a `SimulationWarning` where the amplification is too large, unless a transformation hides it."""
        if is_concrete(self.amplification) and float(self.amplification) > LARGEST_AMPLIFICATION:
            message = UNDETERMINED.format(float(self.amplification))
            warnings.warn(message, SimulationWarning, stacklevel=stacklevel + 1)


UNDETERMINED = (
    "the gradient is NaN, because the run is too sensitive for its tolerances: a local error of one step, as large as "
    "rtol allows, changes the differentiated value by {:.2g} times its size. Tighten rtol or shorten the run. Causes "
    "are chaotic motion, and dampers whose damping time is far longer than the run"
)


class _Sweep(NamedTuple):
    """What has been summed on the way back.

    Attributes:
        by_state: lambda, the derivatives by the state at the end of the coming step.
        by_numbers: those by the parameters of the right-hand side.
        sample: index of the last sample whose derivatives have not been added.
        scale: size of the differentiated number, see `Gradient`.
        amplification: error amplification over the steps so far, see `Gradient`.
    """

    by_state: Float[Array, " size"]
    by_numbers: Any
    sample: Int[Array, ""]
    scale: Float[Array, ""]
    amplification: Float[Array, ""]


class _Tolerances(NamedTuple):
    """Relative and absolute tolerances of the entries of a state; zeros where the step-size controller has none."""

    rtol: Float[Array, " size"]
    atol: Float[Array, " size"]

    def errors(self, y):
        """The largest local errors within the tolerances."""
        return self.atol + self.rtol * jnp.abs(y)

    def sizes(self, y):
        """Sizes of the entries of a state, with a floor of atol/rtol."""
        is_relative = self.rtol > 0
        return jnp.where(is_relative, self.atol / jnp.where(is_relative, self.rtol, 1.0), 0.0) + jnp.abs(y)


class _Stretches(NamedTuple):
    """The loop over stretches.

    Attributes:
        at: index of the coming one.
        goes_back: whether the end of the run has been reached.
        is_sound: whether no stretch has failed.
        times, rows: where each begins but for the first one [s], and state and sensitivity there.
        log: the steps of the last one.
        sweep: of those behind.
    """

    at: Int[Array, ""]
    goes_back: Bool[Array, ""]
    is_sound: Bool[Array, ""]
    times: Float[Array, " n"]
    rows: Float[Array, "n 2 size"]
    log: StepLog
    sweep: _Sweep


class StepsKept(NamedTuple):
    """The steps that a run has kept when it was made.

    Attributes:
        are_kept: whether it has: the run succeeded, and there was room for all of them.
        n_steps: how many.
        start: the state that it began with.
        log: the steps.
    """

    are_kept: Flag
    n_steps: Int[Array, ""]
    start: Float[Array, " size"]
    log: StepLog

    @classmethod
    def of_nothing(cls, plan: Plan) -> "StepsKept":
        """No steps."""
        size = example_of(plan.structure).layout.size
        log = StepLog.of_nothing(_room(plan), 0, (2, size))
        return cls(jnp.array(False), jnp.zeros((), jnp.int64), jnp.zeros(size), log)


def _room(plan: Plan) -> int:
    return ROOM if contacts_of(plan.structure, plan.scalar) is None else ROOM_WITH_CONTACT


def with_steps_back(solver: Any) -> Any:
    """The method whose steps are gone back: for one that is neither explicit nor a Rosenbrock method, Rodas5P."""
    return solver if is_explicit(solver) or is_linearly_implicit(solver) else Rodas5P()


@cached_jit(what="the gradient of a run", options=options_for)
def pulled_back(
    plan: Plan,
    method: RunMethod,
    inputs: RunInputs,
    by_ys: Float[Array, "n size"],
    by_assembly: Any = None,
    along: Float[Array, " p"] | None = None,
    kept: StepsKept | None = None,
    has_succeeded: Flag | bool = True,
) -> "Gradient":
    """The derivatives of a number by the traced numbers.

    Args:
        plan, method, inputs: as of `one_run.integrated`; the method as `with_steps_back` makes it.
        by_ys: its derivatives by the sampled states.
        by_assembly: those by how the start was assembled; None where it does not depend on that.
        along: the direction in the numbers whose sensitivity is carried along; None for a mixture of all.
        kept: the steps of the run, with the sensitivity by a mixture of all numbers; None where it has kept none.
        has_succeeded: whether the run has; else the derivatives are NaN.
    """
    # Straight lines of a thousand operations and more, back as well as forward, take XLA minutes.
    with program_for(state_rate, plan.structure, plan.scalar).native_code(in_machine_code(plan)):
        return in_one_call(
            lambda: _pulled_back(plan, method, inputs, by_ys, by_assembly, along, kept, has_succeeded),
            in_machine_code(plan),
            joins=False,
        )


def can_keep_steps(plan: Plan, method: RunMethod) -> bool:
    """Whether `run_that_keeps_steps` makes the run as `run_of` makes it, but for the length of steps."""
    is_on_same_programs = method.stiff_rest is not None or for_one_run(plan, method.rest) == plan
    solver = method.solver
    return is_on_same_programs and in_machine_code(plan) and with_steps_back(solver) is solver


@cached_jit(what="a run that keeps its steps", options=options_for)
def run_that_keeps_steps(plan: Plan, method: RunMethod, inputs: RunInputs) -> tuple[Outcome, StepsKept]:
    """A run, and its steps for a gradient: made for both at once, with the sensitivity by a mixture of all numbers.

    Of several runs under `jax.vmap` no steps are kept, whose room would be megabytes for each: they are made in lanes.
    """
    one = jax.custom_batching.custom_vmap(partial(_with_steps, plan))

    @one.def_vmap
    def in_lanes(n, is_mapped, method, inputs):
        axes = jax.tree.map(lambda mapped: 0 if mapped else None, tuple(is_mapped))
        outcome = jax.vmap(partial(integrated, plan), axes, axis_size=n)(method, inputs)
        steps = StepsKept.of_nothing(plan)
        is_own = jax.tree.map(lambda _: True, outcome), jax.tree.map(lambda _: False, steps)
        return (outcome, steps), is_own

    return one(method, inputs)


def _with_steps(plan: Plan, method: RunMethod, inputs: RunInputs) -> tuple[Outcome, StepsKept]:
    """As `run_that_keeps_steps`, for one run."""
    usual = method.decided

    def kept() -> tuple[Outcome, StepsKept]:
        job, problem = _as_mixture(plan, usual, inputs, None)
        if method.stiff_rest is not None:
            # A run for the other method keeps none: the way back makes its own.
            fastest = fastest_in_clearance(plan.structure, plan.scalar, job.numbers.theta)
            job = job._replace(may_run=job.may_run & (fastest <= method.limit))
        lane = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], job)
        room = _room(plan)
        numbers, rows, may_run, status, _ = lane
        log = StepLog.of_nothing(room, 0, job.y0.shape)
        made, log = steps_in_lanes(problem, numbers, rows, inputs.ts, may_run, status, Block(), room, (), log)
        made = jax.tree.map(lambda leaf: leaf[0], made._replace(n_lane_steps=made.n_lane_steps[None]))
        n_steps = made.n_accepted + made.n_rejected
        are_kept = job.may_run & (made.status == Status.SUCCEEDED) & (n_steps <= method.max_steps)
        outcome = outcome_of_first_row(usual, job, made)
        steps = StepsKept(are_kept, made.n_accepted, job.y0[0], log)
        if method.stiff_rest is not None:
            return outcome, steps
        # A run that failed, or had too many steps, is made once more without the sensitivity: what is reported is its
        # own. Where it is not wanted its loop makes no step.
        alone = job.numbers._replace(slopes=None, tangent_tolerance_factor=None)
        again = job._replace(numbers=alone, y0=job.y0[0], may_run=job.may_run & ~are_kept)
        of_itself = made_alone(plan, usual, again, inputs.ts)
        return jax.tree.map(lambda one, other: jnp.where(are_kept, one, other), outcome, of_itself), steps

    with program_for(state_rate, plan.structure, plan.scalar).native_code(in_machine_code(plan)):
        outcome, steps = in_one_call(kept, in_machine_code(plan), joins=False)
        if method.stiff_rest is not None:  # it is one of two loops, each of which takes as long to compile
            outcome = jax.lax.cond(steps.are_kept, lambda: outcome, lambda: integrated(plan, method, inputs))
    return outcome, steps


def can_go_back(plan: Plan) -> bool:
    """Whether the steps of a run can be gone back.

    Those of array code with joints cannot: XLA (JAX 0.10) ends the process where it compiles the way back through their
    elimination. Nor can those of a law with a loop that JAX has no reverse mode for. Rows take their place; they are
    right, and take as long as a run for each number.
    """
    rate = program_for(state_rate, plan.structure, plan.scalar)
    is_array_code_of_joints = rate.scalar is None and bool(example_of(plan.structure).joints)
    return not is_array_code_of_joints and rate.can_be_transposed


def gradient_of(plan: Plan, method: RunMethod, inputs: RunInputs, directions, by_ys) -> Float[Array, " p"]:
    """The slopes that are `pulled_back` of a run whose numbers move along directions alone, shape (k, p).

    A mixture of these directions is carried. Where steps cannot be gone back, see `can_go_back`, the gradient is right
    along these directions alone.
    """
    if not can_go_back(plan):
        rows = run_and_slopes(plan, method, inputs, directions)
        scale = plan.scales(inputs.values)
        return jnp.linalg.pinv(directions / scale) @ jnp.einsum("kns,ns->k", rows.slopes, by_ys) / scale
    along = jnp.asarray(mixture_of(directions.shape[0])[0]) @ directions
    gradient = pulled_back(plan, method.with_solver(with_steps_back(method.solver)), inputs, by_ys, None, along)
    gradient.warn()
    return gradient.slopes


def _as_mixture(plan: Plan, method: RunMethod, inputs: RunInputs, along: Any) -> tuple[Job, LaneProblem]:
    """The run with a sensitivity along a direction, and what its lane integrates."""
    values = inputs.values
    if along is None:
        along = jnp.asarray(mixture_of(values.shape[0])[0] * plan.scales(values))

    def job_of_values(values):
        return lane_job(plan, method, inputs._replace(values=values))

    job, _ = with_slopes(job_of_values, values, along[None])
    factor = jnp.asarray(method.factor(plan.structure))
    if is_explicit(method.rest) and method.control is not None and kinks_of(plan.structure):
        factor = factor * FACTOR_OVER_KINKS
    elif is_explicit(method.rest) and method.tangent_tolerance_factor is None:  # who gives a tolerance has that
        factor = factor * FACTOR_ELSEWHERE
    job = job._replace(numbers=job.numbers._replace(tangent_tolerance_factor=factor))
    kind = JobKind.of(plan, method, with_rows=True, moving=plan.unknown, is_mixture=True)
    return job, kind.problem(inputs.ts, method.shared)._replace(max_steps=_room(plan))


def _pulled_back(
    plan: Plan, method: RunMethod, inputs: RunInputs, by_ys, by_assembly, along, kept, has_succeeded
) -> Gradient:
    values, known, ts = inputs.values, inputs.known, inputs.ts
    begun = _as_mixture(plan, method, inputs, along) if kept is None else None
    rate = program_for(state_rate, plan.structure, plan.scalar)
    parameters, to_values = jax.vjp(partial(parameters_from, plan, rate, known), values)
    back = _StepsBack(plan, method, rate, parameters, ts, by_ys)
    n = jnp.asarray(ts.shape[0] - 1)
    none = jnp.zeros(())
    size = example_of(plan.structure).layout.size
    sweep = _Sweep(jnp.zeros(size), jax.tree.map(jnp.zeros_like, parameters), n, none, none)
    stretches = _Stretches(
        jnp.zeros((), jnp.int64),
        jnp.array(False) if kept is None else kept.are_kept,
        jnp.array(True),
        uninitialized((N_STRETCHES,)),
        uninitialized((N_STRETCHES, 2, size)),
        StepLog.of_nothing(_room(plan), 0, (2, size)) if kept is None else kept.log,
        sweep,
    )

    def beginning_of_run() -> tuple[Job, LaneProblem]:
        return _as_mixture(plan, method, inputs, along) if begun is None else begun

    turn = partial(_with_stretch, beginning_of_run, ts[jnp.array([0, -1])], back, kept)
    swept = native_run(lambda: jax.lax.while_loop(_goes_on, turn, stretches), back.is_native, joins=False)
    # Samples at the start are the start.
    is_first = (jnp.arange(ts.shape[0]) <= swept.sweep.sample)[:, None]
    by_start = swept.sweep.by_state + jnp.sum(jnp.where(is_first, by_ys, 0.0), axis=0)

    at_start = _start_back(plan, inputs, by_assembly, by_start)
    amplification = jnp.where(swept.is_sound, swept.sweep.amplification, 0.0)
    is_determined = swept.is_sound & jnp.asarray(has_succeeded) & (amplification <= LARGEST_AMPLIFICATION)
    slopes = to_values(jax.tree.map(_as_cotangent, swept.sweep.by_numbers))[0] + at_start
    return Gradient(jnp.where(is_determined, slopes, jnp.nan), amplification)


def _start_back(plan: Plan, inputs: RunInputs, by_assembly: Any, by_state: Float[Array, " size"]) -> Float[Array, " p"]:
    """The derivatives by the traced numbers, of those by the assembled start and by the state there."""
    values = inputs.values

    def start_of(values):
        moved = inputs._replace(values=values)
        return beginning(plan, plan.theta_of(moved), inputs.ts[0], plan.start_of(moved))

    if by_assembly is None:
        by_assembly = jax.tree.map(lambda x: jnp.zeros(x.shape), jax.eval_shape(start_of, values)[0])
    wanted = by_assembly, by_state
    ideal, _ = ideal_numbers(plan.structure, plan.theta_of(inputs))
    if inputs.start is not None or not is_assembled_by_arrays(ideal):
        return jax.vjp(start_of, values)[1](wanted)[0]
    # Array code of joints has no way back. Forward it takes a tenth of a millisecond for each number of some tens of
    # bodies, and most numbers of a network are none of the start.
    (moving,) = np.nonzero(numbers_of_start(plan.structure)[list(plan.unknown)])

    def along(i):
        _, moved = jax.jvp(start_of, (values,), ((jnp.arange(values.size) == i).astype(values.dtype),))
        return sum(map(jnp.vdot, jax.tree.leaves(wanted), jax.tree.leaves(moved)))

    return jnp.zeros_like(values).at[moving].set(jax.lax.map(along, jnp.asarray(moving)))


def _goes_on(stretches: _Stretches) -> Bool[Array, ""]:
    return (stretches.at >= 0) & stretches.is_sound


def _with_stretch(
    beginning_of_run: Callable[[], tuple[Job, LaneProblem]],
    ts,
    back: "_StepsBack",
    kept: StepsKept | None,
    stretches: _Stretches,
) -> _Stretches:
    """A stretch is made: on the way to the end its own end is noted, on the way back its steps are gone back."""
    at = stretches.at
    # The first one begins with the run. Written to the rows, that would be a copy of all of them.
    is_first = at == 0
    t = jnp.where(is_first, ts[0], stretches.times[at])

    def made(log):
        job, problem = beginning_of_run()
        rows = jnp.where(is_first, job.y0, stretches.rows[at])
        ends, may_run = jnp.stack([t, ts[1]]), stretches.is_sound & job.may_run
        own = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], (job.numbers, rows, may_run, job.status))
        numbers, first, may_run, status = own
        outcome, log = steps_in_lanes(
            problem, numbers, first, ends, may_run, status, Block(), log.times.shape[0], (), log
        )
        ended = outcome.n_accepted[0], outcome.status[0], outcome.t_reached[0], outcome.y_reached[0]
        return (*ended, rows[0]), log

    if kept is None:
        (n_steps, status, t_end, rows_end, begin), log = made(stretches.log)
    else:
        # Only what is made once more has to be begun once more, which takes as long as some of the steps.
        ended = kept.n_steps, jnp.asarray(Status.SUCCEEDED, jnp.int64), t, stretches.rows[at], kept.start
        (n_steps, status, t_end, rows_end, begin), log = jax.lax.cond(
            is_first & kept.are_kept, lambda log: (ended, log), made, stretches.log
        )
    is_full = status == Status.TOO_MANY_STEPS
    is_sound = (status == Status.SUCCEEDED) | (is_full & (n_steps > 0))
    notes = is_full & ~stretches.goes_back
    is_sound = is_sound & ~(notes & (at + 1 == N_STRETCHES))
    goes_back = is_sound & ~notes

    def gone_back(sweep):
        return back.along(log, n_steps, t, begin, sweep)

    sweep = jax.lax.cond(goes_back, gone_back, lambda sweep: sweep, stretches.sweep)
    coming = jnp.minimum(at + 1, N_STRETCHES - 1)
    return _Stretches(
        jnp.where(notes, at + 1, at - 1),
        stretches.goes_back | goes_back,
        is_sound,
        stretches.times.at[coming].set(jnp.where(notes, t_end, stretches.times[coming])),
        stretches.rows.at[coming].set(jnp.where(notes, rows_end, stretches.rows[coming])),
        log,
        sweep,
    )


class _StepsBack:
    """The way back along steps; lives while a program is traced."""

    def __init__(self, plan: Plan, method: RunMethod, rate: Program, parameters: Parameters, ts, by_ys):
        self.parameters, self.ts, self.by_ys = parameters, ts, by_ys
        # Cumulative sums of |dg/dy| over the samples: the sum over the samples of one step is a difference of two. Most
        # losses look at few of the samples, or at few times: how many of them are differentiated is counted as well.
        self.weights = jnp.pad(jnp.cumsum(jnp.abs(by_ys), axis=0), ((1, 0), (0, 0)))
        self.n_differentiated = jnp.pad(jnp.cumsum(jnp.any(by_ys != 0, axis=1)), (1, 0))
        self.rate = lambda t, y, parameters: rate.inside(parameters.theta, parameters.ahead, t, y)
        self.correct, self.event = correction_for(plan), event_of(plan, rate)
        self.corrects_by_numbers = self.correct is not None and correction_reads_parameters(plan.structure, plan.scalar)
        self.taken = samples_of(plan.structure, plan.scalar)
        self.contacts = contacts_of(plan.structure, plan.scalar)
        self.has_kinks = self.contacts is not None and bool(self.contacts.kinks)
        solver = method.solver
        self.interpolation = solver.interpolation_cls
        self.is_explicit, self.is_native = is_explicit(solver), in_machine_code(plan)
        # Steps of explicit methods end by going over a kink (`lanes.over_kinks`), those of others, and those that a
        # controller of a user's judges, begin so (`solvers.kinks`).
        self.ends_over = self.has_kinks and self.is_explicit and method.control is None
        self.begins_over = self.has_kinks and not self.ends_over
        controller = method.controller(plan.structure)
        self.tolerances = _Tolerances(*(jnp.asarray(getattr(controller, name, 0.0)) for name in ("rtol", "atol")))
        self.unrolls_stages = sum(leaf.size for leaf in jax.tree.leaves(parameters)) <= LARGEST_UNROLLED
        if self.is_explicit:
            weights = solver.tableau.b_sol
            # Stages behind these are for states inside a step alone: the fourteenth of Dopri8.
            n_of_end = int(np.flatnonzero(weights)[-1]) + 1
            self.tableau = explicit_tableau(solver.tableau, n_of_end, [weights])
            self.with_stages_inside = explicit_tableau(solver.tableau, len(weights), ())
        else:
            self.solver = differentiable_solver(solver, plan.structure)

    def along(self, log: StepLog, n_steps, t0, y0, sweep: _Sweep) -> _Sweep:
        """Back along the steps of a stretch that begins at t0 [s] in the state y0."""

        def end(i):
            # Within the loop: ahead of it, XLA would copy the room for thousands of steps.
            return log.times[i, -1], log.states[i, -1, 0]

        def one_step_back(carry):
            i, sweep = carry
            is_first = i == 0
            t, y = end(jnp.maximum(i - 1, 0))
            t, y = jnp.where(is_first, t0, t), jnp.where(is_first, y0, y)
            size, bend = log.trials[i, 0], log.trials[i, 1]
            return i - 1, self._step_back(t, y, *end(i), size, bend, sweep)

        def all_back():
            return jax.lax.while_loop(lambda carry: carry[0] >= 0, one_step_back, (n_steps - 1, sweep))[1]

        # Not joined where it has to be left to XLA, which (JAX 0.10) cannot compile a branch of a contact then.
        return native_run(all_back, self.is_native, joins=False)

    def _step_back(self, t, y, t_next, y_next, size, bend, sweep: _Sweep) -> _Sweep:
        """Back along one step, that was kept from a trial step of a size [s], made in a bent time."""
        # An event ended it early: the rest of the trial step is no part of it, nor is the rest of its bent time.
        whole, size = size, t_next - t
        # One that is longer than its trial went over a kink at its end.
        goes_over, t_end = self.ends_over & (size > whole), t_next
        if self.ends_over:
            t_end, size = jnp.where(goes_over, t + whole, t_next), jnp.minimum(size, whole)
        if self.contacts is not None and self.is_explicit and not self.begins_over:
            part = jnp.clip(own_time(size / whole, bend), 0.0, 1.0)
            bend = jnp.clip(bend * part**2 * whole / size, -1.0, 1.0)
        else:
            bend = None

        def over(parameters, y, end):
            assert self.contacts is not None
            rate = self._rate_by(parameters)
            return end, gone_over_kink(self.contacts, rate, parameters, t_end, t_next - t_end, end)

        def made(parameters, y):
            begins = t
            if self.contacts is not None and self.begins_over:
                begins, y, _ = over_kink(self.contacts, self.rate, t, y, parameters)
            end, inside = self._made(parameters, begins, t_end - begins, y, bend)
            end = end if self.correct is None else self.correct(parameters, t_end, end)
            if self.ends_over:
                y, end = jax.lax.cond(goes_over, over, lambda _, y, end: (y, end), parameters, y, end)
            end = end if self.event is None else self.event(parameters, t_next, y, end, y_next, jnp.array(True))
            return end if self.taken is None else self.taken.update(parameters, t_next, end), inside

        (_, inside), back = jax.vjp(made, self.parameters, y)
        at_end = t_next - SAME_INSTANT * jnp.abs(t_next)
        ts, last = self.ts, self.ts.shape[0] - 1

        def is_at_end(carry):
            _, i = carry
            return (i >= 0) & (ts[jnp.clip(i, 0, last)] >= at_end)

        def with_end(carry):
            by_state, i = carry
            return by_state + self.by_ys[i], i - 1

        def is_inside(i):
            return (i >= 0) & (ts[jnp.clip(i, 0, last)] > t)

        by_end, first = jax.lax.while_loop(is_at_end, with_end, (sweep.by_state, sweep.sample))
        i = jax.lax.while_loop(is_inside, lambda i: i - 1, first)
        none = jax.tree.map(jnp.zeros_like, inside)
        by_numbers, by_inside = jax.lax.cond(
            self.n_differentiated[first + 1] > self.n_differentiated[i + 1],
            partial(self._samples_back, t, size, bend, inside, first, i),
            lambda *same: same,
            sweep.by_numbers,
            none,
        )
        more, by_state = back((by_end, by_inside))
        added = self.weights[sweep.sample + 1] - self.weights[i + 1]
        scale = sweep.scale + added @ self.tolerances.sizes(y_next)
        amplification = jnp.abs(by_state) @ self.tolerances.errors(y) / jnp.where(scale > 0, scale, 1.0)
        amplification = jnp.maximum(sweep.amplification, amplification)
        return _Sweep(by_state, _added(by_numbers, more), i, scale, amplification)

    def _made(self, parameters, t, size, y, bend) -> tuple[Array, dict[str, Any]]:
        """The end of a step, before what happens there, and what states inside it are made from."""
        if self.is_explicit:
            rate = self._rate_by(parameters)
            if self.unrolls_stages:
                k = self.tableau.unrolled_stages(rate, t, size, y, bend)
            else:
                k = self.tableau.stages(rate, t, size, size, y, bend=bend)
            end = y + self.tableau.sums_of(k)[0]
            return end, {"y0": y, "y1": end, "k": jnp.stack(k) if isinstance(k, list) else k}
        term = diffrax.ODETerm(self.rate)
        end, _, inside, *_ = self.solver.step(term, t, t + size, y, parameters, None, jnp.array(False))
        return end, inside

    def _samples_back(self, t, size, bend, inside, first, behind, by_numbers, by_inside) -> tuple:
        """The derivatives by samples inside a step, added to those by the numbers and by the stages of its end.

        Args:
            t, size: where the step begins, and how long it is [s].
            bend: of its time.
            inside: what `_made` returns.
            first, behind: the last of the samples, and the first one before the step.
            by_numbers, by_inside: the derivatives so far.
        """
        if self.is_explicit and len(self.with_stages_inside.c) > len(self.tableau.c):

            def completed(parameters, inside):
                known = [*inside["k"]]
                k = self.with_stages_inside.unrolled_stages(
                    self._rate_by(parameters), t, size, inside["y0"], bend, known
                )
                return {**inside, "k": jnp.stack(k)}

            whole, back = jax.vjp(completed, self.parameters, inside)
        else:
            whole, back = inside, None
        none = jax.tree.map(jnp.zeros_like, whole)
        # Only the correction of samples may read numbers: where it does not, thousands of them are not carried along.
        so_far = (none, by_numbers) if self.corrects_by_numbers else (none,)

        def with_sample(carry):
            *so_far, i = carry
            return (*self._sample_back(t, size, bend, whole, i, *so_far), i - 1)

        by_whole, *corrected, _ = jax.lax.while_loop(lambda carry: carry[-1] > behind, with_sample, (*so_far, first))
        (by_numbers,) = corrected or (by_numbers,)
        if back is not None:
            more, by_whole = back(by_whole)
            by_numbers = _added(by_numbers, more)
        return by_numbers, _added(by_inside, by_whole)

    def _rate_by(self, parameters: Parameters) -> Callable:
        return lambda t, y: self.rate(t, y, parameters)

    def _sample_back(self, t, size, bend, inside, i, by_inside, by_numbers=None) -> tuple:
        """The derivatives by one sample, added to those by the stages of its step, and to those by numbers if given."""
        at = self.ts[i]

        def sampled(inside, parameters):
            share = jnp.clip((at - t) / size, 0.0, 1 + BEHIND if self.ends_over else 1.0)
            share = share if bend is None else own_time(share, bend)
            y = self.interpolation(t0=t, t1=t + size, **inside).evaluate(t + share * size)
            return y if self.correct is None else self.correct(parameters, at, y)

        if by_numbers is None:
            of_these = partial(sampled, parameters=self.parameters)
            so_far, more = (by_inside,), jax.vjp(of_these, inside)[1](self.by_ys[i])
        else:
            so_far, more = (by_inside, by_numbers), jax.vjp(sampled, inside, self.parameters)[1](self.by_ys[i])
        return _added(so_far, more)


def _added(so_far: Any, more: Any) -> Any:
    """Derivatives by numbers, added up. By truths and whole numbers, which a law may evaluate ahead, there are none."""
    return jax.tree.map(lambda x, y: x if y.dtype == jax.dtypes.float0 else x + y, so_far, more)


def _as_cotangent(x: Any) -> Any:
    return x if jnp.issubdtype(x.dtype, jnp.floating) else np.zeros(x.shape, jax.dtypes.float0)


def mixture_of(n_directions: int) -> Float[np.ndarray, "1 k"]:
    """The direction whose sensitivity is carried along: all directions with random signs, of the size of one."""
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (1, n_directions))
    return signs / np.sqrt(n_directions)


def event_of(plan: Plan, rate: Program) -> Callable | None:
    """What contact onsets and releases at the end of a step do to the state there; None without contacts."""
    contacts = contacts_of(plan.structure, plan.scalar)
    if contacts is None or not contacts.onset_entries:
        return None
    n_motion = example_of(plan.structure).layout.memory_start

    def event(parameters: Parameters, t, y, end, y_next, is_step):
        def changed(parameters, y, end):
            # The motion that the run had itself there, so that it is on the same side of the surface.
            own = y_next[:n_motion] + (end[:n_motion] - jax.lax.stop_gradient(end[:n_motion]))
            end = jnp.concatenate([own, end[n_motion:]])
            updated = contacts.update(parameters, t, y, end)
            weights = delay_weights(contacts, parameters, t, y, end, updated)
            flight, contact = (rate.inside(parameters.theta, parameters.ahead, t, each) for each in (end, updated))
            weights, jump = jax.lax.stop_gradient((weights, flight - contact))
            here = contacts.crossings(parameters, t, end).value[: contacts.n_contacts]
            delay = jnp.sum(weights * (here - jax.lax.stop_gradient(here)))  # 0, but for its derivatives
            return updated + delay * jump

        begins_or_ends = is_step & jnp.any(contacts.is_touching(y) != contacts.is_touching(y_next))
        return jax.lax.cond(begins_or_ends, changed, lambda parameters, y, end: end, parameters, y, end)

    return event

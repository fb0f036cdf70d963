"""Runs in lanes, each over a span of time of its own, from a state of its own.

All lanes of a block share their sample times. Cycles of different periods do not, and so each lane is given the share
x of its span: t = begin + length x, dy/dx = length f(t, y). Everything else is as in `jobs`; functions that know the
time are told it, and what they say of rates is taken by the share.
"""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.types import Numeric, Scalar
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration.audit import Audit
from spherejax.motion.integration.jobs import JobKind, RunNumbers
from spherejax.motion.integration.lanes import LaneOutcome, LaneProblem, run_in_lanes
from spherejax.motion.integration.longest_step import STEPS_AT_LEAST
from spherejax.motion.integration.problem import Parameters, Plan, RunMethod
from spherejax.motion.integration.sensitivity_rows import linearized
from spherejax.motion.integration.status import Status
from spherejax.motion.integration.widths import block_for
from spherejax.motion.solvers.landing import ContactFunctions
from spherejax.motion.solvers.traits import is_explicit
from spherejax.motion.solvers.wrapping import AbstractForwardingSolver
from spherejax.physics.joints.base import Crossing
from spherejax.program_cache import cached_jit


class Span(NamedTuple):
    """What the right-hand side of one lane is given.

    Attributes:
        numbers: as of a run over time.
        begin: where the span begins [s].
        length: how long it is [s].
    """

    numbers: RunNumbers
    begin: Scalar
    length: Scalar

    def time(self, x: Any) -> Any:
        """The time at a share of the span [s]."""
        return self.begin + self.length * x


class InOwnTime(AbstractForwardingSolver):
    """A solver whose steps are made in time, and asked for in shares of a span.

    Attributes:
        solver: the solver.
        rate: right-hand side in time (t, y, numbers).
    """

    solver: diffrax.AbstractSolver
    rate: Any = eqx.field(static=True)

    def init(self, terms, t0, t1, y0, args):
        """The solver's own."""
        del terms
        return self.solver.init(diffrax.ODETerm(self.rate), args.time(t0), args.time(t1), y0, args.numbers)

    def func(self, terms, t0, y0, args):
        """The rate by the share."""
        del terms
        return args.length * self.solver.func(diffrax.ODETerm(self.rate), args.time(t0), y0, args.numbers)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """A step in time."""
        del terms
        term = diffrax.ODETerm(self.rate)
        return self.solver.step(term, args.time(t0), args.time(t1), y0, args.numbers, solver_state, made_jump)


def by_shares(problem: LaneProblem, cycles: int) -> LaneProblem:
    """What every lane integrates, with `Span` for its parameters and the share of its span for the time.

    Args:
        problem: the same in time.
        cycles: how often what depends on time repeats itself in a span.
    """

    def timed(function) -> Any:
        if function is None:
            return None
        return lambda span, x, *states: function(span.numbers, span.time(x), *states)

    def rate(x, y, span: Span):
        return span.length * problem.rate(span.time(x), y, span.numbers)

    def room(span: Span, x, y):
        assert problem.room is not None
        return problem.room(span.numbers, span.time(x), y) / span.length

    def factor(span: Span):
        assert problem.tangent_tolerance_factor is not None
        return problem.tangent_tolerance_factor(span.numbers)

    solver: Any = problem.solver
    if not is_explicit(solver):
        solver = InOwnTime(solver, problem.rate)  # pyright: ignore[reportCallIssue]
    audit = problem.audit
    return problem._replace(
        solver=solver,
        controller_of=lambda span: problem.controller_of(span.numbers),
        rate=rate,
        correct=timed(problem.correct),
        contacts=None if problem.contacts is None else _contacts(problem.contacts),
        longest_step=None if problem.longest_step is None else jnp.asarray(1.0 / (STEPS_AT_LEAST * cycles)),
        audit=None if audit is None else _audit(audit),
        room=None if problem.room is None else room,
        unseen=None if problem.unseen is None else problem.unseen._replace(signals=timed(problem.unseen.signals)),
        tangent_tolerance_factor=None if problem.tangent_tolerance_factor is None else factor,
        program=None,
    )


def _audit(audit: Audit) -> Audit:
    def look(span: Span, x, y):
        return audit.look(span.numbers, span.time(x), y)

    return Audit(look, lambda span: audit.limits(span.numbers))


def _contacts(contacts: ContactFunctions) -> ContactFunctions:
    def by_share(crossings):
        def crossed(span: Span, x, y) -> Crossing:
            found = crossings(span.numbers, span.time(x), y)
            return found._replace(rate=found.rate * span.length, velocity=found.velocity * span.length)

        return crossed

    def timed(update):
        return lambda span, x, start, end: update(span.numbers, span.time(x), start, end)

    first_row = contacts.first_row
    return contacts._replace(
        crossings=by_share(contacts.crossings),
        update=timed(contacts.update),
        update_lanes=timed(contacts.update_lanes),
        first_row=None if first_row is None else (first_row[0], by_share(first_row[1])),
    )


class Jobs(NamedTuple):
    """Spans to be integrated.

    Attributes:
        theta: numbers of the system of each, shape (n, p).
        y0: flat states, shape (n, size), or with k rows of derivatives below each, shape (n, 1 + k, size).
        directions: of the rows in the numbers, shape (n, k, p); k = 0 without rows.
        begin: where each begins [s], shape (n,).
        length: how long it is [s], shape (n,).
        is_wanted: which are to be made, shape (n,).
    """

    theta: Numeric
    y0: Numeric
    directions: Numeric
    begin: Numeric
    length: Numeric
    is_wanted: Numeric


@cached_jit(what="cycles in lanes")
def over_spans(
    plan: Plan, method: RunMethod, with_rows: bool, cycles: int, jobs: Jobs, shares: Float[Array, " n"]
) -> LaneOutcome:
    """Integrate spans, all at once.

    Args:
        plan, method: what is integrated, and how.
        with_rows: whether derivatives are integrated beside the states.
        cycles: how often what depends on time repeats itself in a span.
        jobs: the spans.
        shares: of each span at which states are wanted, from 0 to 1.
    """
    rate = program_for(state_rate, plan.structure, plan.scalar)

    def numbers_of(theta, directions) -> RunNumbers:
        def of_theta(theta):
            return Parameters(theta, rate.ahead(theta))

        limits, tolerances = method.limits(plan, theta), method.own_tolerances
        if not with_rows:
            return RunNumbers(of_theta(theta), None, tolerances, limits)
        moved = linearized(of_theta, theta, directions)
        return RunNumbers(moved.value, moved.slopes, tolerances, limits)

    kind = JobKind.of(plan, method, with_rows=with_rows)
    problem = by_shares(kind.problem(shares, method.shared), cycles)
    spans = Span(jax.vmap(numbers_of)(jobs.theta, jobs.directions), jobs.begin, jobs.length)
    status = jnp.full(jobs.begin.shape, Status.SUCCEEDED, jnp.int64)
    return run_in_lanes(problem, spans, jobs.y0, shares, jobs.is_wanted, status, block_for())

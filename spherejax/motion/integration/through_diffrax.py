"""A run by `diffrax.diffeqsolve`, for those who differentiate it by one of diffrax's adjoints.

All other runs are made in lanes. The step is the same there and here: the method's, then what happens at its end
(`step_end`), judged by the same `LandingController`. What differs is the loop around it, which is diffrax's, for its
adjoints differentiate that loop and no other.
"""

import inspect
from types import FunctionType
from typing import Any

import diffrax
import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration.audit import Audit
from spherejax.motion.integration.compiling import options_for_stiff
from spherejax.motion.integration.longest_step import longest_step
from spherejax.motion.integration.problem import (
    Outcome,
    Parameters,
    Plan,
    RunInputs,
    RunMethod,
    audit_of,
    beginning,
    contacts_of,
    correction_for,
    room_of,
    stages_of,
)
from spherejax.motion.integration.sampling import samples_of
from spherejax.motion.integration.statistics import Statistics
from spherejax.motion.integration.status import AUDIT_RESULT, Status, end_status, start_status, status_of
from spherejax.motion.integration.step_end import StepEnd
from spherejax.motion.integration.unseen import unseen_of
from spherejax.motion.solvers.implicit import with_structure
from spherejax.motion.solvers.landing import ErrorAndInside, LandingController
from spherejax.motion.solvers.root_finder import with_converging_root_finder
from spherejax.motion.solvers.traits import stage_defect
from spherejax.motion.solvers.wrapping import AbstractForwardingSolver
from spherejax.program_cache import cached_jit


class EngineStep(AbstractForwardingSolver):
    """A solver whose steps end as those of lanes do.

    Attributes:
        solver: the solver that makes the steps.
        end: what happens at the end of each (static).
        audit: what is looked at there (static).
    """

    solver: diffrax.AbstractSolver
    end: StepEnd = eqx.field(static=True)
    audit: Audit = eqx.field(static=True)

    def init(self, terms, t0, t1, y0, args):
        """The wrapped solver's state, no onset yet, and the audit of the start."""
        watch = self.audit.begun(*jax.lax.stop_gradient((args, t0, y0)))
        return self.solver.init(terms, t0, t1, y0, args), self.end.no_onsets, watch

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """A step of the wrapped solver, and its end."""
        inner, n_onsets, watch = solver_state
        y1, error, inside, inner, result = self.solver.step(terms, t0, t1, y0, args, inner, made_jump)
        y1, began = self.end.changed(args, t0, y0, t1, y1)
        watch = self.audit.seen(*jax.lax.stop_gradient((args, watch, t1, y1)))
        is_wrong = ~watch.is_sound & (result == diffrax.RESULTS.successful)
        result = diffrax.RESULTS.where(is_wrong, AUDIT_RESULT, result)
        if self.end.contacts is not None:
            error = ErrorAndInside(error, inside, jax.lax.stop_gradient(stage_defect(self.solver, inside)))
        return y1, error, inside, (inner, n_onsets + began, watch), result


@cached_jit(what="a run", options=options_for_stiff)
def integrate_through_diffrax(
    plan: Plan, method: RunMethod, adjoint: diffrax.AbstractAdjoint, max_steps: int, inputs: RunInputs
) -> Outcome:
    """Assemble the start if need be, integrate with diffrax and its adjoint, and gather the outcome.

    Args:
        plan, method, inputs: as of `one_run.integrated`.
        adjoint: of the user's.
        max_steps: largest number of steps, for which it may lay out memory.
    """
    ts, theta = inputs.ts, plan.theta_of(inputs)
    assembly, y0 = beginning(plan, theta, ts[0], plan.start_of(inputs))
    began = start_status(inputs.values_are_legal, assembly.residual_after, y0)
    may_run = began == Status.SUCCEEDED
    # A run that is not made gets an interval of length zero.
    t1 = jnp.where(may_run, ts[-1], ts[0])
    rate = program_for(state_rate, plan.structure, plan.scalar)
    where = plan.structure, plan.scalar
    end = StepEnd(correction_for(plan), contacts_of(*where), samples_of(*where))
    stepper = method.controller(plan.structure)
    solver = _stepping(plan, method.solver, getattr(stepper, "rtol", None), adjoint)
    controller: Any = LandingController  # pyright takes its fields for those of diffrax's base class
    solution = _diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: rate.inside(args.theta, args.ahead, t, y)),
        EngineStep(solver, end, audit_of(plan)),  # pyright: ignore[reportCallIssue]
        t0=ts[0],
        t1=t1,
        dt0=None,
        y0=y0,
        args=Parameters(theta, rate.ahead(theta), method.limits(plan, theta)),
        saveat=diffrax.SaveAt(
            subs=[
                diffrax.SubSaveAt(ts=jnp.minimum(ts, t1), fn=lambda t, y, args: end.sampled(args, t, y)),
                diffrax.SubSaveAt(t1=True),
            ],
            solver_state=True,
        ),
        stepsize_controller=controller(
            stepper,
            end.contacts,
            solver.interpolation_cls,
            longest_step(plan.structure, ts, scalar=plan.scalar),
            room_of(plan),
            None if end.samples is None else end.samples.were_taken,
            unseen_of(plan.structure, plan.scalar, solver),
        ),
        adjoint=adjoint,
        max_steps=max_steps,
        throw=False,
    )
    saved: Any = solution.ys  # at the sample times, and at the end
    times: Any = solution.ts
    reached, last = times[1][0], jax.lax.stop_gradient(saved[1][0])
    ys = _reached(saved[0], (ts <= reached) & may_run)
    are_finite = jnp.all(jnp.isfinite(jax.lax.stop_gradient(ys))) & jnp.all(jnp.isfinite(last))
    status = jnp.where(may_run, status_of(solution.result), began)
    status = end_status(status, reached, ts[-1], are_finite)
    return Outcome(ys, reached, last, status, _statistics(solution, method.rest), assembly)


def _stepping(plan: Plan, solver: Any, rtol: Any, adjoint: diffrax.AbstractAdjoint) -> Any:
    """The method as diffrax steps it, with the loop over its stages that the adjoint can differentiate.

    diffrax chooses that loop itself for solvers that are not wrapped.
    """
    solver = with_structure(solver, plan.structure) if plan.scalar is not False else solver
    solver = solver if rtol is None else with_converging_root_finder(solver, rtol, makes_own_steps=True)
    kind = "bounded" if isinstance(adjoint, diffrax.DirectAdjoint) else None
    if kind is None or not isinstance(solver, diffrax.AbstractRungeKutta) or solver.scan_kind is not None:
        return solver
    return eqx.tree_at(lambda s: s.scan_kind, solver, kind, is_leaf=lambda x: x is None)


def _reached(ys: Float[Array, "n size"], is_reached: Bool[Array, " n"]) -> Float[Array, "n size"]:
    """The samples, NaN where the run did not come: what diffrax did not write is infinite."""
    return jnp.where(is_reached[:, None] & jnp.isfinite(jax.lax.stop_gradient(ys)), ys, jnp.nan)


def _statistics(solution: diffrax.Solution, solver: Any) -> Statistics:
    n_steps: Int[Array, ""] = solution.stats["num_steps"]
    state: Any = solution.solver_state
    accepted, rejected = (solution.stats[f"num_{kind}_steps"] for kind in ("accepted", "rejected"))
    return Statistics(n_steps, accepted, rejected, n_steps * stages_of(solver), state[1], state[2].worst)


class _WithoutHostChecks:
    """`equinox.internal` with an `error_if` that checks nothing."""

    def __getattr__(self, name: str) -> Any:
        return getattr(eqxi, name)

    @staticmethod
    def error_if(x, pred, msg: str, **options):
        """Its first argument, as it is."""
        del pred, msg, options
        return x


def _without_host_checks(function: Any) -> Any:
    """A function of another module with a global scope of its own, in which nothing is checked.

    diffrax checks sample times while the compiled program runs, by calls from it into Python. JAX's persistent cache
    keeps no program that makes such calls: it would be compiled anew in each process. `simulate` has checked them. The
    module itself stays as it is: other calls, those of other threads among them, keep all their checks.
    """
    function = inspect.unwrap(function)
    scope = {**function.__globals__, "eqxi": _WithoutHostChecks()}
    copy = FunctionType(function.__code__, scope, function.__name__, function.__defaults__, function.__closure__)
    copy.__kwdefaults__ = function.__kwdefaults__
    return copy


_diffeqsolve = _without_host_checks(diffrax.diffeqsolve)

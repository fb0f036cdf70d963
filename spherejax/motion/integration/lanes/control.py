"""How the lanes of a block go on after a trial step: kept whole, kept up to a contact event inside it, or repeated.

`Repeating` leaves that to the `LandingController` of single runs, and serves every solver; `landing.Landing` finds
events inside the steps of explicit Runge-Kutta methods. Arrays have their lanes on the last axis.
"""

from typing import Any, NamedTuple

import diffrax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from spherejax.foundations.lanes import in_lanes
from spherejax.motion.integration.status import status_of
from spherejax.motion.integration.step_end import StepEnd
from spherejax.motion.solvers.landing import ErrorAndInside, LandingController
from spherejax.motion.solvers.traits import stage_defect


class Judgment(NamedTuple):
    """What becomes of the trial steps of a block.

    Attributes:
        keep: whether a step is kept, whole or up to an event.
        t: where the coming step starts [s].
        t_next: where it ends [s].
        y: the state at t, if the step is kept.
        state: the control's.
        made_jump: whether the state jumps at t.
        verdict: `diffrax.RESULTS`.
        began: contacts that began in the step, shape (n_contacts, n_lanes).
    """

    keep: Bool[Array, " n_lanes"]
    t: Float[Array, " n_lanes"]
    t_next: Float[Array, " n_lanes"]
    y: Float[Array, "... n_lanes"]
    state: Any
    made_jump: Bool[Array, " n_lanes"]
    verdict: Any
    began: Bool[Array, "n_contacts n_lanes"]


class BlockSteps(NamedTuple):
    """Trial steps of a block.

    Attributes:
        t0, t1: start and end [s].
        y0, y1: states there.
        error: estimate of the error of y1.
        dense_info: what states inside it are made from; of explicit methods the increments of the stages, `k`.
        parameters: what the right-hand side is given.
        stage_defect: see `stages.TrialStep`.
        t_end: where the runs end [s].
    """

    t0: Float[Array, " n_lanes"]
    t1: Float[Array, " n_lanes"]
    y0: Float[Array, "... n_lanes"]
    y1: Float[Array, "... n_lanes"]
    error: Float[Array, "... n_lanes"]
    dense_info: Any
    parameters: Any
    stage_defect: Float[Array, "... n_lanes"] | None = None
    t_end: Float[Array, " n_lanes"] | float = jnp.inf


class Repeating:
    """The control of single runs: a step that crosses a contact surface is taken again to end there."""

    def __init__(self, problem, order):
        self.problem, self.order = problem, order

    def _controller(self, parameters) -> LandingController:
        problem = self.problem
        interpolation = problem.solver.interpolation_cls
        were_taken = None if problem.samples is None else problem.samples.were_taken
        # Made for each lane: tolerances are arrays of the run, and cost nothing in a traced program.
        made: Any = LandingController  # pyright takes its fields for those of diffrax's base class
        controller = problem.controller_of(parameters)
        return made(
            controller, problem.contacts, interpolation, problem.longest_step, problem.room, were_taken, problem.unseen
        )

    def init(self, term, t0, t_end, y0, parameters):
        """The end of the first step [s], and the control's state, of one lane."""
        func = self.problem.solver.func
        return self._controller(parameters).init(term, t0, t_end, y0, None, parameters, func, self.order)

    def time_warp(self, state, size) -> Float[Array, " n_lanes"]:
        """Of the time that the coming steps are made in; straight."""
        return jnp.zeros(size.shape)

    def judge(self, step: BlockSteps, state, was_jump) -> Judgment:
        """What becomes of the trial steps."""
        return in_lanes(self._judge)(step, state, was_jump)

    def _judge(self, step: BlockSteps, state, was_jump) -> Judgment:
        problem = self.problem
        end = StepEnd(problem.correct, problem.contacts, problem.samples)
        # The end is corrected and its contacts updated before it is judged, as explicit steps are.
        y, began = end.changed(step.parameters, step.t0, step.y0, step.t1, step.y1)
        # The controller looks for events on the solver's own interpolation, which it is handed with the error.
        error = step.error
        if problem.contacts is not None:
            error = ErrorAndInside(error, step.dense_info, stage_defect(problem.solver, step.dense_info))
        keep, t, t_next, made_jump, state, verdict = self._controller(step.parameters).adapt_step_size(
            step.t0, step.t1, step.y0, y, step.parameters, error, self.order, state
        )
        return Judgment(keep, t, t_next, y, state, jnp.where(keep, made_jump, was_jump), verdict, began)


def told_by(keep, result, verdict) -> Int[Array, ""]:
    """The status of a lane after a step, from what the solver and the control say."""
    if result is not None:
        verdict = diffrax.RESULTS.where(keep & (result != diffrax.RESULTS.successful), result, verdict)
    return status_of(verdict)


def clipped(t, t_next, t_end, keep) -> Array:
    """The end of the coming step, at most the end of the run; as diffrax does it."""
    # A remainder of a few roundings would be a step of its own, with an error that means nothing.
    floor = t_end - 100 * jnp.finfo(jnp.float64).eps * jnp.abs(t_end)
    return jnp.where(t_next > floor, jnp.where(keep, t_end, t + 0.5 * (t_end - t)), t_next)

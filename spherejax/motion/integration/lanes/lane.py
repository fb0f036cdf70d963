"""What runs in lanes are made of: the problem, a run under way, and what becomes of all of them."""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from spherejax.motion.integration.audit import Audit, Watch
from spherejax.motion.integration.compiling import uninitialized
from spherejax.motion.integration.sampling import SampledElements
from spherejax.motion.integration.status import Status
from spherejax.motion.integration.unseen import Unseen
from spherejax.motion.solvers.landing import ContactFunctions

IN_A_GROUP = 8
"""Lanes that machine code takes at a time."""


class Block(NamedTuple):
    """How wide the block of lanes is (static).

    Attributes:
        width: lanes, at most.
        narrow: lanes once the queue is empty and no more than these are busy: the loop is compiled a second time for
            them. None: the block stays as wide as it is.
    """

    width: int = 24
    narrow: int | None = None

    def width_for(self, n_runs: int) -> int:
        """Lanes for so many runs: not more than are needed to fill them as few times as `width` lanes would be filled.

        In 24 lanes 32 runs take as long as 48 would, for the last eight are made beside sixteen idle lanes; in 16 lanes
        they fill all of them twice.
        """
        n_rounds = -(-n_runs // self.width)
        if n_rounds <= 1:
            return max(1, n_runs)
        return min(self.width, IN_A_GROUP * -(-n_runs // (IN_A_GROUP * n_rounds)))

    @property
    def in_words(self) -> str:
        """Of a sweep's account."""
        return str(self.width) if self.narrow is None else f"{self.width}, at the end {self.narrow}"


class LaneProblem(NamedTuple):
    """What is integrated in every lane (static functions of one lane).

    Attributes:
        solver: a diffrax solver, not wrapped.
        controller_of: the diffrax controller of a run, from its parameters.
        rate: right-hand side (t, y, parameters).
        correct: drift control's correction (parameters, t, y), or None.
        contacts: contacts whose onsets are located, or None.
        max_steps: largest number of steps of a run.
        watch: numbers (t, y, parameters) whose largest values at the ends of all steps are kept, or None.
        longest_step: of every run [s], or None.
        audit: what is looked at, at the end of each step, or None.
        room: how soon [s] something comes that no step may pass over (parameters, t, y), or None.
        n_judged: entries of the state whose errors are judged, the first ones; None for all.
        samples: of force elements that sample, or None.
        tangent_tolerance_factor: how much larger the errors of sensitivities may be than the state's, from a run's
            parameters; None where there are none.
        in_machine_code: whether the programs become machine code of their own.
        program: of (theta, t, y), which `rate` evaluates inside; None where it does something else.
        moving: entries of theta that the sensitivities are by; None for all.
        unseen: looks between the stages for pulses of functions of time, or None.
        lands_inside: whether steps of explicit methods may end on events inside them, in a time of their own; not with
            a controller of a user's, and not where the steps are differentiated once more.
        judges_by_own_size: whether errors of sensitivities are judged by their own largest part where that is small.
    """

    solver: diffrax.AbstractSolver
    controller_of: Callable
    rate: Callable
    correct: Callable | None
    contacts: ContactFunctions | None
    max_steps: int | Array
    watch: Callable | None = None
    longest_step: Array | None = None
    audit: Audit | None = None
    room: Callable | None = None
    n_judged: int | None = None
    samples: SampledElements | None = None
    tangent_tolerance_factor: Callable | None = None
    in_machine_code: bool = False
    program: Any = None
    moving: tuple[int, ...] | None = None
    unseen: Unseen | None = None
    lands_inside: bool = True
    judges_by_own_size: bool = False


class StepLog(NamedTuple):
    """The steps of all runs of a queue, one row each; what is in rows of steps that were not made is undetermined.

    Attributes:
        times: of the shares of each step that were asked for, and of its end [s], shape (n_jobs, capacity, k + 1).
        states: there; at the end with what its events changed, shape (n_jobs, capacity, k + 1, ...).
        trials: length [s] of the trial step that was kept, before an event inside it cut it short or a step over a
            kink was added to it (`over_kinks`), and the bend of the time that it was made in (`stages.own_time`), shape
            (n_jobs, capacity, 2).
    """

    times: Float[Array, "n_jobs capacity k+1"]
    states: Float[Array, "n_jobs capacity k+1 ..."]
    trials: Float[Array, "n_jobs capacity 2"]

    @classmethod
    def of_nothing(cls, n_rows: int, n_shares: int, shape: tuple[int, ...]) -> "StepLog":
        """Room for so many steps, of states of a shape; without the axis of runs."""
        # Not filled: most runs write few of these rows.
        rows = n_rows, n_shares + 1
        return cls(*map(uninitialized, (rows, (*rows, *shape), (n_rows, 2))))


class Lane(NamedTuple):
    """A run under way (of all lanes: the last axis).

    Attributes:
        job: index of the run; the number of runs where the lane is idle.
        t_end: where it ends [s].
        t: start of the coming step [s].
        t_next: end of the coming step [s].
        y: state at t.
        parameters: what the right-hand side is given.
        solver_state: the solver's.
        controller_state: the controller's.
        made_jump: whether the state jumped at t.
        n_accepted: steps kept.
        n_rejected: steps repeated.
        n_onsets: contact onsets of each contact.
        touching: time in contact of each contact [s].
        peaks: largest values of what is watched.
        n_samples: samples taken.
        status: integer of `Status`.
        watch: of the audit.
    """

    job: Array
    t_end: Array
    t: Array
    t_next: Array
    y: Array
    parameters: Any
    solver_state: Any
    controller_state: Any
    made_jump: Array
    n_accepted: Array
    n_rejected: Array
    n_onsets: Array
    touching: Array
    peaks: Array
    n_samples: Array
    status: Array
    watch: Watch | None


def is_busy(lanes: Lane, n_jobs: int) -> Bool[Array, " n_lanes"]:
    """Which lanes have a run to go on with, of a queue of so many."""
    return (lanes.job < n_jobs) & (lanes.t < lanes.t_end) & (lanes.status == Status.SUCCEEDED)


class Last(NamedTuple):
    """The trial steps that the lanes made last: what states inside them come of.

    Attributes:
        t: where they start [s].
        t_next: where they end [s].
        bend: of the time that they are made in.
        dense_info: of the solver.
    """

    t: Array
    t_next: Array
    bend: Array
    dense_info: Any


class LaneOutcome(NamedTuple):
    """Results of all runs of a queue.

    Attributes:
        ys: states at the sample times; NaN where a run did not come, shape (n_jobs, n, ...).
        t_reached: [s], shape (n_jobs,).
        status: integers of `Status`, shape (n_jobs,).
        n_accepted: steps kept, shape (n_jobs,).
        n_rejected: steps repeated, shape (n_jobs,).
        n_onsets: shape (n_jobs, n_contacts).
        touching: time in contact [s], shape (n_jobs, n_contacts).
        peaks: largest values of what is watched, shape (n_jobs, n_watched).
        y_reached: states at `t_reached`, shape (n_jobs, ...).
        audit: the worst of each of `audit.CHECKS`, as a share of its limit, shape (n_jobs, n_checks).
        n_lane_steps: steps that the block made, those of idle lanes included.
    """

    ys: Float[Array, "n_jobs n ..."]
    t_reached: Float[Array, " n_jobs"]
    status: Int[Array, " n_jobs"]
    n_accepted: Int[Array, " n_jobs"]
    n_rejected: Int[Array, " n_jobs"]
    n_onsets: Int[Array, "n_jobs n_contacts"]
    touching: Float[Array, "n_jobs n_contacts"]
    peaks: Float[Array, "n_jobs n_watched"]
    y_reached: Float[Array, "n_jobs ..."]
    audit: Float[Array, "n_jobs n_checks"]
    n_lane_steps: Int[Array, ""]

    @property
    def lane_efficiency(self) -> Float[Array, ""]:
        """Steps of runs divided by steps of lanes."""
        return jnp.sum(self.n_accepted + self.n_rejected) / self.n_lane_steps

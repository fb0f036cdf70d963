"""A queue of runs, worked off by a block of lanes inside one compiled loop.

Each turn of the loop makes one step of every lane. A lane whose run has ended, well or not, writes its result and
takes the next job. When the queue is empty and most lanes idle, the rest may go on in a narrower block. So the block
does not wait for its slowest lane, and a failing run costs what it costs and disturbs nobody.

The pieces are diffrax's own: solver, step-size controller, interpolation. Arrays have their lanes on the last axis.
"""

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from spherejax.foundations.lanes import in_lanes, with_rows_at
from spherejax.motion.integration.audit import Watch
from spherejax.motion.integration.compiling import is_faster_one_by_one, native_run
from spherejax.motion.integration.lanes.account import AccountLayout, samples_are_finite, written
from spherejax.motion.integration.lanes.control import BlockSteps, Repeating, clipped, told_by
from spherejax.motion.integration.lanes.first_step import N_LOOKS, InitialStepProbe
from spherejax.motion.integration.lanes.landing import BEHIND, Landing
from spherejax.motion.integration.lanes.lane import Block, Lane, LaneOutcome, LaneProblem, Last, StepLog, is_busy
from spherejax.motion.integration.lanes.stages import ExplicitStages, TrialStep, own_time, steps_of
from spherejax.motion.integration.status import Status
from spherejax.physics.forces.remembering import SAME_INSTANT


def run_in_lanes(
    problem: LaneProblem,
    parameters: Any,
    y0: Float[Array, "n_jobs ..."],
    ts: Float[Array, " n"],
    may_run: Array,
    status: Int[Array, " n_jobs"],
    block: Block,
) -> LaneOutcome:
    """Work off a queue of runs.

    Args:
        problem: what is integrated.
        parameters: of each run, with a leading axis of jobs.
        y0: state of each run at the start.
        ts: sample times [s], increasing; every run goes from the first to the last.
        may_run: whether a run is to be made, shape (n_jobs,).
        status: what a run that is not to be made reports.
        block: how wide.
    """
    return _worked_off(problem, parameters, y0, ts, may_run, status, block)[0]


def steps_in_lanes(
    problem: LaneProblem,
    parameters: Any,
    y0: Float[Array, "n_jobs ..."],
    ts: Float[Array, " n"],
    may_run: Array,
    status: Int[Array, " n_jobs"],
    block: Block,
    capacity: int,
    shares: tuple[float, ...],
    log: StepLog | None = None,
) -> tuple[LaneOutcome, StepLog]:
    """As `run_in_lanes`, with a row for each step that was kept.

    Args:
        problem, parameters, y0, ts, may_run, status, block: as there; at least three sample times, for states inside a
            step come of what samples come of.
        capacity: rows of each run; of a run with more steps the rest is not written.
        shares: where inside each step the state is wanted, in (0, 1).
        log: what the rows are written into, of `StepLog.of_nothing`: the result has its shape then, in which the rows
            of each run stand behind those of the one before. XLA copies what is reshaped between two loops.
    """
    outcome, log = _worked_off(problem, parameters, y0, ts, may_run, status, block, capacity, shares, log)
    assert log is not None
    return outcome, log


def _worked_off(
    problem: LaneProblem, parameters, y0, ts, may_run, status, block: Block, *others
) -> tuple[LaneOutcome, StepLog | None]:
    # Array code in machine code is for one run: of many, XLA makes vectors over runs.
    is_native = problem.in_machine_code and (problem.program is not None or len(y0) == 1)
    if is_native and len(y0) > 1 and not others and is_faster_one_by_one(problem.program):
        return _one_by_one(problem, ts, (parameters, y0, may_run, status)), None
    return native_run(
        lambda: Queue(problem, parameters, y0, ts, may_run, status, block, *others).run_queue(), is_native
    )


def _one_by_one(problem: LaneProblem, ts, jobs: Any) -> LaneOutcome:
    """A queue of runs, each in a block of one lane: machine code makes them on all processors."""

    def made(job):
        parameters, y0, may_run, status = jax.tree.map(lambda leaf: leaf[None], job)
        run = Queue(problem, parameters, y0, ts, may_run, status, Block()).run_queue
        outcome, _ = native_run(run, True)
        return jax.tree.map(lambda leaf: leaf[0], outcome._replace(n_lane_steps=outcome.n_lane_steps[None]))

    outcome = jax.vmap(made)(jobs)
    return outcome._replace(n_lane_steps=jnp.sum(outcome.n_lane_steps))


class Queue:
    """The functions of one lane and of a block, with the queue at hand; lives while a program is traced."""

    def __init__(
        self,
        problem: LaneProblem,
        parameters,
        y0,
        ts,
        may_run,
        status,
        block: Block,
        capacity: int = 0,
        shares=(),
        log: StepLog | None = None,
    ):
        self.problem, self.log = problem, log
        self.capacity, self.shares = capacity, tuple(shares)
        self.parameters, self.y0, self.ts, self.may_run, self.status = parameters, y0, ts, may_run, status
        self.t0, self.t_end = ts[0], ts[-1]
        self.n_jobs = y0.shape[0]
        self.width = block.width_for(self.n_jobs)
        self.narrow = self.width if block.narrow is None else min(block.narrow, self.width)
        # Where every run has a lane of its own nothing is fetched from the queue: of an ideal four-bar alone that would
        # be a seventh of the operations, and a quarter of the time that they take to compile.
        self.refills = self.width < self.n_jobs
        self.steps = steps_of(problem.solver, problem.rate, ts.shape[0] > 2, problem.program, problem.moving)
        self.term = diffrax.ODETerm(problem.rate)
        self.order = problem.solver.error_order(self.term)
        if isinstance(self.steps, ExplicitStages) and problem.lands_inside:
            self.control, can_look = Landing(problem, self.order, self.steps), self.steps.can_look
        else:
            self.control, can_look = Repeating(problem, self.order), False
        # Where all runs begin together, and go on, the first turns look at their starts.
        self.looks = can_look and not self.refills and ts.shape[0] > 1
        # A sample time interrupts one run now and then: its samples are written between two loops (dry runs and
        # bushings take 7 % less, stiff ones 11; sampled in every second step up to 5 % more). Many lanes pass one in
        # most turns.
        self.samples_apart = self.n_jobs == 1 and ts.shape[0] > 1
        self.looks_back = self.looks or self.samples_apart
        self.n_contacts = 0 if problem.contacts is None else len(problem.contacts.onset_entries)
        # A correction is as large as the right-hand side. The samples of one run are corrected after its loop, and the
        # start with them: one copy of it less, 14,000 operations of a robot arm's 58,000.
        self.corrects_late = problem.correct is not None and self.n_jobs == 1 and ts.shape[0] > 2 and not capacity

    # A lane ------------------------------------------------------------------------------------------------------

    def started(self, job) -> Lane:
        """The lane at the start of a job; an idle one where there is no such job."""
        at = jnp.minimum(job, self.n_jobs - 1)
        return self._lane(job, jax.tree.map(lambda x: x[at], self._starts))

    @cached_property
    def _starts(self) -> tuple:
        """Of all jobs what a lane takes of one."""
        # The first step of every run, found for all runs at once; by looks where there are some.
        looking = self.control.init_with_looks if self.looks and isinstance(self.control, Landing) else None
        init = looking or partial(self.control.init, self.term)
        first_steps = jax.vmap(partial(init, self.t0, self.t_end))(self.y0, self.parameters)
        # And what the audit and the peaks begin with: a lane that takes a job only fetches it.
        watched = jax.vmap(self._watched_first)(self.y0, self.parameters)
        return self.parameters, self.y0, self.may_run, self.status, first_steps, watched

    def _lane(self, job, start: tuple) -> Lane:
        """The lane at the start of a job, from its part of `_starts`."""
        parameters, y0, may_run, status, (t_next, state), (watch, peaks) = start
        t0 = self.t0
        t_end = jnp.where((job < self.n_jobs) & may_run, self.t_end, t0)
        t_next = jnp.minimum(t_next, t_end)
        none = jnp.zeros((), jnp.int64)
        return Lane(
            job=job,
            t_end=t_end,
            t=t0,
            t_next=t_next,
            y=y0,
            parameters=parameters,
            solver_state=self.steps.init(t0, t_next, y0, parameters),
            controller_state=state,
            made_jump=jnp.array(False),
            n_accepted=none,
            n_rejected=none,
            n_onsets=jnp.zeros(self.n_contacts, jnp.int64),
            touching=jnp.zeros(self.n_contacts),
            peaks=peaks,
            n_samples=jnp.where(may_run, none, self.ts.shape[0]),  # of a run that is not made none is due
            status=jnp.asarray(jnp.where(may_run, Status.SUCCEEDED, status), jnp.int64),
            watch=watch,
        )

    def _watched_first(self, y0, parameters) -> tuple[Watch | None, Array]:
        """The audit and the watched numbers at the start of a run."""
        audit, t0 = self.problem.audit, self.t0
        watch = None
        if audit is not None:
            watch = Watch.of_nothing() if self.looks else audit.begun(parameters, t0, y0)
        return watch, self._watched(t0, y0, parameters)

    def judged(self, lane: Lane, trial: TrialStep, is_look) -> Lane:
        """The lanes after trial steps: corrected, with their contact events, kept or to be repeated.

        A look leaves them as they were.
        """
        problem = self.problem
        # A method that estimates none has a controller that asks for none.
        error = jnp.zeros_like(trial.y) if trial.error is None else trial.error
        error = jnp.where(jnp.isnan(error), jnp.inf, error)
        # Where this loop is differentiated itself (second derivatives), its steps are held fixed: how long they are has
        # derivatives without meaning.
        fixed = jax.lax.stop_gradient
        ends = lane.y, trial.y, fixed(error)
        step = BlockSteps(lane.t, lane.t_next, *ends, trial.dense_info, lane.parameters, trial.stage_defect, lane.t_end)
        keep, t, t_next, y, state, made_jump, verdict, began = self.control.judge(
            step, lane.controller_state, lane.made_jump
        )
        t, t_next, state = fixed((t, t_next, state))
        told = in_lanes(told_by)(keep, trial.result, verdict)
        # Idle lanes and runs that may not be made go through the motions, and count nothing.
        is_running = is_busy(lane, self.n_jobs) & ~is_look
        keep = keep & is_running
        repeats = ~keep & is_running
        t = jnp.where(is_running, jnp.minimum(t, lane.t_end), lane.t)
        n_steps = lane.n_accepted + lane.n_rejected + 1
        ended = jnp.where(n_steps >= problem.max_steps, Status.TOO_MANY_STEPS, Status.SUCCEEDED)
        failed = jnp.where(t < lane.t_end, ended, Status.SUCCEEDED)

        def kept(new, old):
            return jnp.where(keep, new, old)

        watch = lane.watch
        if problem.audit is not None:
            y = jnp.where(is_running, y, lane.y)  # after a look, the start
            begun, seen = in_lanes(problem.audit.update_checks)(fixed(lane.parameters), watch, t, fixed(y))
            watch = jax.tree.map(kept, seen, watch)
            if self.looks:  # which leave the state at the start
                begins = is_look & is_busy(lane, self.n_jobs)
                watch = jax.tree.map(lambda new, old: jnp.where(begins, new, old), begun, watch)
            is_sound = in_lanes(lambda watch: watch.is_sound)(watch)
            told = jnp.where((told == Status.SUCCEEDED) & ~is_sound, Status.AUDIT_FAILED, told)

        return lane._replace(
            t=t,
            t_next=clipped(t, t_next, lane.t_end, keep),
            y=kept(y, lane.y),
            solver_state=jax.tree.map(kept, trial.solver_state, lane.solver_state),
            controller_state=jax.tree.map(lambda new, old: jnp.where(is_look, old, new), state, lane.controller_state),
            made_jump=jnp.asarray(made_jump),
            n_accepted=lane.n_accepted + keep,
            n_rejected=lane.n_rejected + repeats,
            n_onsets=lane.n_onsets + (began & keep),
            touching=lane.touching + self._time_in_contact(lane, t, keep),
            peaks=kept(jnp.maximum(lane.peaks, in_lanes(self._watched)(t, y, lane.parameters)), lane.peaks),
            status=jnp.where(is_running, jnp.where(told == Status.SUCCEEDED, failed, told), lane.status),
            watch=watch,
        )

    def _watched(self, t, y, parameters) -> Float[Array, " n_watched"]:
        return jnp.zeros(0) if self.problem.watch is None else self.problem.watch(t, y, parameters)

    def _time_in_contact(self, lane: Lane, t, keep):
        if self.problem.contacts is None:
            return jnp.zeros((0, *t.shape))
        return jnp.where(keep & self.problem.contacts.is_touching(lane.y), t - lane.t, 0.0)

    def sample(self, t, t_next, bend, dense_info, parameters, at):
        """The state within a step."""
        # Behind its end where a step over a touch was added to it; see `Landing`.
        share = own_time(jnp.clip((at - t) / (t_next - t), 0.0, 1 + BEHIND), bend)
        instant = jnp.where(bend != 0, t + share * (t_next - t), at)
        y = self.problem.solver.interpolation_cls(t0=t, t1=t_next, **dense_info).evaluate(instant)
        correct = None if self.corrects_late else self.problem.correct
        return y if correct is None else correct(parameters, at, y)

    # A block -----------------------------------------------------------------------------------------------------

    def run_queue(self) -> tuple[LaneOutcome, StepLog | None]:
        """Run all jobs."""
        width, narrow = self.width, self.narrow
        lanes = self.begun()
        # Times that go back are the start of nothing; a run that is asked for them is not made.
        is_later = self.ts != self.t0
        # Of two times without a sum along them, which machine code has not.
        is_start = ~is_later if len(self.ts) <= 2 else jnp.cumsum(is_later) == 0
        is_start = is_start.reshape(-1, *(1 for _ in self.y0.shape[1:]))
        correct = None if self.corrects_late else self.problem.correct
        # The start is corrected as all samples are; the integration begins with what it was given.
        first = self.y0 if correct is None else jax.vmap(correct, (0, None, 0))(self.parameters, self.t0, self.y0)
        ys = jnp.where(is_start, first[:, None], jnp.nan)
        account = AccountLayout.of(lanes)
        looks = InitialStepProbe.of_nothing(lanes.y) if self.looks else None
        log = None
        if self.capacity:
            log = self.log
            if log is None:
                log = StepLog.of_nothing(self.n_jobs * self.capacity, len(self.shares), self.y0.shape[1:])
        last = self.nothing_last(lanes)
        rows = account.rows(self.n_jobs)
        carry = lanes, jnp.asarray(width), rows, ys, jnp.zeros((), jnp.int64), log, looks, last

        def busy(carry):
            lanes, waiting, *_, looks, _ = carry
            at_least = narrow if narrow < width else 0
            is_wide = (waiting < self.n_jobs) | (jnp.sum(is_busy(lanes, self.n_jobs)) > at_least)
            # The narrow block goes on, it does not look.
            return is_wide if looks is None else is_wide | looks.is_looking

        carry = self.run_loop(busy, carry)
        if narrow < width:
            lanes, *rest, _, _ = carry
            order = jnp.argsort(~is_busy(lanes, self.n_jobs))[:narrow]
            lanes = jax.tree.map(lambda x: x[..., order], lanes)

            def still_busy(carry):
                return jnp.any(is_busy(carry[0], self.n_jobs))

            carry = self.run_loop(still_busy, (lanes, *rest, None, self.nothing_last(lanes)))
        log = carry[5]
        if log is not None and self.log is None:
            log = jax.tree.map(lambda x: x.reshape(self.n_jobs, self.capacity, *x.shape[1:]), log)
        ys = self._with_corrected_samples(carry[3]) if self.corrects_late else carry[3]
        are_finite = samples_are_finite(ys, self.ts, self.t_end)
        return account.outcome(carry[2], ys, are_finite, carry[4], self.t_end), log

    def begun(self) -> Lane:
        """The block at the start of the first jobs."""
        jobs, starts = jnp.arange(self.width), self._starts
        in_block = partial(jax.vmap, out_axes=-1)
        return in_block(self.started)(jobs) if self.refills else in_block(self._lane)(jobs, starts)

    def _with_corrected_samples(self, ys):
        """The samples of the one run, of which the last is the end of a step, and corrected as such."""
        parameters = jax.tree.map(lambda x: x[0], self.parameters)
        correct: Any = self.problem.correct
        inside = jax.lax.map(lambda row: correct(parameters, *row), (self.ts[:-1], ys[0, :-1]))
        return jnp.concatenate([inside, ys[0, -1:]])[None]

    def run_loop(self, busy: Callable, carry: tuple) -> tuple:
        """Turn after turn while the block is busy; what comes seldom is done between two loops, not asked in each turn.

        XLA copies all lanes where a branch leaves them as they were, and puts so many copies at once on other threads:
        a turn of 24 lanes took 90 us in place of 51.
        """

        def is_quiet(carry):
            lanes, *_, looks, _ = carry
            is_so = busy(carry)
            if self.refills:
                is_so = is_so & ~jnp.any(self._have_ended(lanes))
            if self.samples_apart:
                is_so = is_so & ~jnp.any(self.is_due(lanes))
            return is_so if looks is None else is_so & ~looks.is_new

        def stretch(carry):
            lanes, waiting, account, ys, n_lane_steps, log, looks, last = jax.lax.while_loop(is_quiet, self.turn, carry)
            if looks is not None and last is not None:
                lanes, looks = jax.lax.cond(looks.is_new, self._looked, lambda *same: same[:2], lanes, looks, last)
            if self.samples_apart and last is not None:
                lanes, ys = self._with_samples(lanes, last, ys)
            if self.refills:
                lanes, waiting, account = self.refilled(lanes, waiting, account)
            return lanes, waiting, account, ys, n_lane_steps, log, looks, last

        def goes_on(carry):
            is_so = busy(carry)
            if self.refills:  # a job that may not be made has ended when a lane takes it, and is written down
                is_so = is_so | jnp.any(self._have_ended(carry[0]))
            if self.samples_apart:  # those of a step that reached the end before the last window of samples
                is_so = is_so | jnp.any(self.is_due(carry[0]))
            return is_so

        lanes, waiting, account, *others = jax.lax.while_loop(goes_on, stretch, carry)
        if not self.refills:
            lanes, waiting, account = self.refilled(lanes, waiting, account)
        return lanes, waiting, account, *others

    def _have_ended(self, lanes: Lane) -> Bool[Array, " n_lanes"]:
        """Which lanes hold a run that has ended, and has not been written down."""
        return ~is_busy(lanes, self.n_jobs) & (lanes.job < self.n_jobs)

    def turn(self, carry):
        """One step of every lane."""
        lanes, waiting, account, ys, n_lane_steps, log, looks, _ = carry
        before = lanes
        is_look = jnp.array(False) if looks is None else looks.is_looking
        n_stages = None if looks is None else looks.n_stages(self._n_stages(lanes))
        bend = self.control.time_warp(lanes.controller_state, lanes.t_next - lanes.t)
        trial = self.steps.step(
            lanes.t, lanes.t_next, lanes.y, lanes.parameters, lanes.solver_state, lanes.made_jump, bend, n_stages
        )
        lanes = self.judged(lanes, trial, is_look)
        if looks is not None:
            looks = looks._replace(is_new=is_look)
        if log is not None:
            log = self._with_step(before, lanes, bend, trial.dense_info, log)
        last = Last(before.t, before.t_next, bend, trial.dense_info)
        if self.ts.shape[0] > 1 and not self.samples_apart:
            lanes, ys = self._with_samples(lanes, last, ys)
        n_lane_steps = n_lane_steps + jnp.where(is_look, 0, lanes.t.shape[-1])
        return lanes, waiting, account, ys, n_lane_steps, log, looks, last if self.looks_back else None

    def _n_stages(self, lanes: Lane) -> Any:
        """How many stages the coming step needs: Dopri8 has a fourteenth for what is inside a step alone."""
        steps: Any = self.steps
        if steps.n_used == steps.n_stages or self.shares:
            return steps.n_stages
        n = self.ts.shape[0]
        coming = jnp.maximum(lanes.n_samples, 1)
        # A sample at the end of a step is its end. A step over a touch may be added behind that.
        behind = BEHIND * (lanes.t_next - lanes.t) if getattr(self.control, "has_rates_that_jump", False) else 0.0
        is_inside = (coming < n) & (self.ts[jnp.minimum(coming, n - 1)] < lanes.t_next + behind)
        return jnp.where(jnp.any(is_inside), steps.n_stages, steps.n_used)

    def _looked(self, lanes: Lane, looks: InitialStepProbe, last: Last) -> tuple[Lane, InitialStepProbe]:
        """After a look: the lanes with where the next look or the first step ends."""
        control: Any = self.control
        size, k = last.t_next - last.t, last.dense_info["k"][:2]
        looks, t_next = control.looked(looks, self.t0, self.t_end, lanes.y, size, k, lanes.parameters)
        t_next = jnp.where(looks.turn == N_LOOKS, jnp.minimum(t_next, lanes.t_end), t_next)
        return lanes._replace(t_next=t_next), looks

    def nothing_last(self, lanes: Lane) -> Last | None:
        """The step made last before there was one; None where nobody looks back at it."""
        if not self.looks_back:
            return None
        zero = jnp.zeros_like(lanes.t)
        of_none = self.steps.nothing_made(zero, lanes.y, lanes.parameters, lanes.solver_state, lanes.made_jump)
        return Last(zero, zero, zero, of_none)

    def is_due(self, lanes: Lane) -> Bool[Array, " n_lanes"]:
        """Whether a lane has passed a sample time and has not written it down."""
        n = self.ts.shape[0]
        coming = jnp.maximum(lanes.n_samples, 1)
        return (coming < n) & (self.ts[jnp.minimum(coming, n - 1)] <= lanes.t)

    def _with_samples(self, lanes: Lane, last: Last, ys):
        """Write the samples that lie in the steps made last; the first one is the start."""
        n = self.ts.shape[0]

        def any_due(carry):
            return jnp.any(self.is_due(lanes._replace(n_samples=carry[0])))

        def write(carry):
            n_samples, ys = carry
            is_due = self.is_due(lanes._replace(n_samples=n_samples))
            at = self.ts[jnp.minimum(n_samples, n - 1)]
            # The end of a step is the state itself, with its events; within it there are none.
            is_end = at >= lanes.t
            if self.problem.samples is not None:
                # What is within rounding of the instant of a force's sample is behind it, as the step's end is.
                is_end = at >= lanes.t - SAME_INSTANT * jnp.abs(lanes.t)
            if n > 2:
                inside = in_lanes(self.sample)(last.t, last.t_next, last.bend, last.dense_info, lanes.parameters, at)
                y = jnp.where(is_end, lanes.y, inside)
            else:
                y = lanes.y
            row = jnp.where(is_due, lanes.job * n + n_samples, self.n_jobs * n)
            return n_samples + is_due, with_rows_at(ys, row, jnp.moveaxis(y, -1, 0))

        rows = ys.reshape(-1, *ys.shape[2:])
        n_samples, rows = jax.lax.while_loop(any_due, write, (jnp.maximum(lanes.n_samples, 1), rows))
        ys = rows.reshape(ys.shape)
        return lanes._replace(n_samples=n_samples), ys

    def _with_step(self, before: Lane, lanes: Lane, bend, dense_info, log: StepLog) -> StepLog:
        """Write a row for each step just kept."""
        was_kept = lanes.n_accepted > before.n_accepted
        is_there = was_kept & (before.n_accepted < self.capacity)
        row = jnp.where(is_there, lanes.job * self.capacity + before.n_accepted, self.n_jobs * self.capacity)
        times = [before.t + share * (lanes.t - before.t) for share in self.shares]
        inside = [
            in_lanes(self.sample)(before.t, before.t_next, bend, dense_info, before.parameters, at) for at in times
        ]
        states = jnp.moveaxis(jnp.stack([*inside, lanes.y]), -1, 0)
        trials = jnp.stack([before.t_next - before.t, jnp.broadcast_to(bend, before.t.shape)], axis=-1)
        return StepLog(
            with_rows_at(log.times, row, jnp.stack([*times, lanes.t], axis=-1)),
            with_rows_at(log.states, row, states),
            with_rows_at(log.trials, row, trials),
        )

    def refilled(self, lanes: Lane, waiting, account) -> tuple:
        """Write results of the lanes that have ended, and give them the next jobs."""
        has_ended = self._have_ended(lanes)
        account = written(account, jnp.where(has_ended, lanes.job, self.n_jobs), lanes)
        if not self.refills:
            return lanes._replace(job=jnp.where(has_ended, self.n_jobs, lanes.job)), waiting, account
        jobs = jnp.minimum(waiting + jnp.cumsum(has_ended) - 1, self.n_jobs)
        fresh = jax.vmap(self.started, out_axes=-1)(jnp.where(has_ended, jobs, self.n_jobs))
        lanes = jax.tree.map(lambda new, old: jnp.where(has_ended, new, old), fresh, lanes)
        return lanes, jnp.minimum(waiting + jnp.sum(has_ended), self.n_jobs), account

"""One run whose samples are written down a window after the other: one program for any number of samples.

A program is compiled for arrays of a shape. If it wrote all samples of a run, each number of them would be another
program, seconds of compiling for nothing new. Here it writes those of a window, which is always as long; where there
are more the run pauses when its window is full, in the middle of a step if need be, and goes on with the next one.

A window also ends after a number of steps, for Python hears Ctrl-C between two calls of a program and not within one.
The state of the loop is handed over whole, so a run is the same to the last bit wherever it pauses.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.motion.integration.compiling import native_run
from spherejax.motion.integration.lanes.account import AccountLayout, samples_are_finite, written
from spherejax.motion.integration.lanes.engine import Queue
from spherejax.motion.integration.lanes.first_step import InitialStepProbe
from spherejax.motion.integration.lanes.lane import Block, Lane, LaneOutcome, LaneProblem, Last, is_busy
from spherejax.motion.integration.status import Status

WINDOW = 2048
"""Samples of a window. To begin a run and to pause it take some 0.2 ms each: with windows of 1024, 200,001 samples of a
four-bar with friction cost a tenth more; with windows of 16,384, a run of few samples does."""


class RunUnderWay(NamedTuple):
    """A run between two windows, as the loop knows it.

    Attributes:
        lanes: a block of one.
        n_lane_steps: steps so far.
        looks: at the start, or None where the method does not look.
        last: the step made last.
    """

    lanes: Lane
    n_lane_steps: Array
    looks: InitialStepProbe | None
    last: Last | None


class RunCheckpoint(NamedTuple):
    """A run between two windows, as it is handed over: fifty small arrays cost more than a short motion.

    Attributes:
        vectors: the numbers, one vector of each type.
        forms: a tree of what each array is (static).
    """

    vectors: dict[str, Array]
    forms: Any

    @classmethod
    def of(cls, run: RunUnderWay) -> "RunCheckpoint":
        """A run that is under way."""
        leaves, tree = jax.tree.flatten(run)
        arrays = [jnp.asarray(leaf, jnp.result_type(leaf)) for leaf in leaves]
        forms = [_ArrayForm(array.dtype.name, array.shape) for array in arrays]
        # One vector of each type: handing over an array costs some microseconds, however small it is.
        parts: dict[str, list[Array]] = {}
        for array, form in zip(arrays, forms, strict=True):
            parts.setdefault(form.kind, []).append(array.reshape(-1))
        vectors = {kind: jnp.concatenate(each) for kind, each in parts.items()}
        return cls(vectors, jax.tree.unflatten(tree, forms))

    @property
    def run(self) -> RunUnderWay:
        """The run under way."""
        forms, tree = jax.tree.flatten(self.forms)
        begin, arrays = dict.fromkeys(self.vectors, 0), []
        for form in forms:
            first = begin[form.kind]
            begin[form.kind] = first + math.prod(form.shape)
            arrays.append(self.vectors[form.kind][first : begin[form.kind]].reshape(form.shape))
        return jax.tree.unflatten(tree, arrays)


@dataclass(frozen=True)
class _ArrayForm:
    """What an array is."""

    kind: str
    shape: tuple[int, ...]


def window_at(ts: Float[np.ndarray, " n"], first: int) -> Float[np.ndarray, " w"]:
    """The sample times from one on, as a window. That one has been written before, and is not written again; what is
    left of the last window is infinite, and never comes."""
    # Infinite times never come, so a window that is not full needs no other program.
    window = np.full(WINDOW, np.inf)
    part = ts[first : first + WINDOW]
    window[: len(part)] = part
    return window


class WindowProgress(NamedTuple):
    """Where a run is when a window has ended.

    Attributes:
        n_written: samples of the window that are written, with its first one.
        is_busy: whether the run has not ended.
        n_turns: turns of the loop since the run began.
    """

    n_written: int
    is_busy: bool
    n_turns: int

    @classmethod
    def of(cls, numbers: Array) -> "WindowProgress":
        """From what `run_loop` returns."""
        n_written, is_busy, n_turns = np.asarray(numbers).tolist()
        return cls(n_written, bool(is_busy), n_turns)


class WindowPace:
    """How many turns a call may make so that Ctrl-C is heard soon.

    The time of a turn is taken from calls before, of the same program: it is 2 us for a pendulum and 1 ms for a large
    robot. The first call compiles the program, and its time says nothing.
    """

    def __init__(self) -> None:
        self._n_calls = 0
        self._seconds: float | None = None  # of a turn

    @property
    def n_turns(self) -> int:
        """For the next call."""
        return FIRST_TURNS if self._seconds is None else max(1, math.ceil(HEARD_AFTER / self._seconds))

    def note(self, n_turns: int, seconds: float) -> None:
        """Take the time of a call."""
        self._n_calls += 1
        # The first call has compiled.
        if self._n_calls > 1 and n_turns > 0:
            self._seconds = max(seconds / n_turns, SHORTEST_TURN)


FIRST_TURNS = 1000
"""Of a call whose time is not known: a second where a turn takes 1 ms."""

HEARD_AFTER = 0.25
"""Time between two moments at which Ctrl-C is heard [s]. To pause takes 0.2 ms, a thousandth of it."""

SHORTEST_TURN = 1e-7
"""Time that a turn takes at least [s]: clocks of some systems have ticks of 16 ms."""


def begun(problem: LaneProblem, parameters: Any, y0: Array, ends: Float[Array, "2"], may_run, status) -> RunCheckpoint:
    """A run before its first window.

    Args:
        problem: what is integrated.
        parameters: of the run.
        y0: state at the start.
        ends: of the motion [s].
        may_run: whether it is to be made.
        status: what it reports otherwise.
    """
    parameters, y0, may_run, status = jax.tree.map(lambda x: jnp.asarray(x)[None], (parameters, y0, may_run, status))
    # As many sample times as any window has; what they are is not asked before the run goes on.
    times = jnp.full(WINDOW, ends[1]).at[0].set(ends[0])

    def begin() -> RunUnderWay:
        queue = Queue(problem, parameters, y0, times, may_run, status, Block())
        lanes = queue.begun()
        looks = InitialStepProbe.of_nothing(lanes.y) if queue.looks else None
        return RunUnderWay(lanes, jnp.zeros((), jnp.int64), looks, queue.nothing_last(lanes))

    return RunCheckpoint.of(native_run(begin, problem.in_machine_code))


def run_loop(
    problem: LaneProblem,
    paused: RunCheckpoint,
    ends: Float[Array, "2"],
    window: Float[Array, " w"],
    n_turns: Int[Array, ""],
) -> tuple[LaneOutcome, dict[str, Array], Int[Array, "3"]]:
    """What a run is when its window is full, when it has ended, or after a number of turns; the vectors of how it goes
    on, see `begun`; and the numbers of a `WindowProgress`."""

    def go_on() -> tuple[LaneOutcome, RunUnderWay, Array]:
        run = paused.run
        return _Windows(problem, run.lanes, ends, window).gone_on_from(run, n_turns)

    outcome, run, progress = native_run(go_on, problem.in_machine_code)
    return outcome, RunCheckpoint.of(run).vectors, progress


class _Windows(Queue):
    """A queue of one run that is under way."""

    def __init__(self, problem: LaneProblem, lanes: Lane, ends, window):
        # A queue takes its runs along the first axis; the one run is in the only lane, on the last.
        parameters = jax.tree.map(lambda leaf: leaf[..., 0][None], lanes.parameters)
        y0 = lanes.y[..., 0][None]
        super().__init__(problem, parameters, y0, window, jnp.ones(1, bool), lanes.status, Block())
        self.t0, self.t_end = ends

    def gone_on_from(self, run: RunUnderWay, n_turns: Int[Array, ""]) -> tuple[LaneOutcome, RunUnderWay, Array]:
        """See `run_loop`."""
        # Turns are counted from the start of the run: a call ends at the turn that the caller asks for.
        last_turn = run.n_lane_steps + n_turns
        lanes = run.lanes._replace(n_samples=jnp.zeros_like(run.lanes.n_samples))
        account = AccountLayout.of(lanes)
        ys = jnp.full((1, self.ts.shape[0], *self.y0.shape[1:]), jnp.nan).at[:, 0].set(self.y0)

        def has_not_ended(lanes, looks):
            is_so = jnp.any(is_busy(lanes, self.n_jobs))
            return is_so if looks is None else is_so | looks.is_looking

        def busy(carry):
            lanes, _, _, _, n_lane_steps, _, looks, _ = carry
            has_room = jnp.any(lanes.n_samples < self.ts.shape[0])
            return has_room & (n_lane_steps < last_turn) & has_not_ended(lanes, looks)

        # The queue is empty: its one job is in its lane already.
        carry = lanes, jnp.asarray(1), account.rows(1), ys, run.n_lane_steps, None, run.looks, run.last
        lanes, _, rows, ys, n_lane_steps, _, looks, last = self.run_loop(busy, carry)
        # Samples inside steps are corrected here, once for a window; in the loop each turn would have the code.
        if self.corrects_late:
            ys = self._corrected(lanes, ys)
        outcome = account.outcome(rows, ys, n_lane_steps, self.ts, self.t_end)
        # The windows behind this one do not see its samples: what is wrong with them ends the run here.
        is_sound = samples_are_finite(ys, self.ts, lanes.t) | (lanes.status != Status.SUCCEEDED)
        lanes = lanes._replace(status=jnp.where(is_sound, lanes.status, Status.NOT_FINITE))
        n_written = jnp.maximum(lanes.n_samples[0], 1)
        progress = jnp.stack([n_written, has_not_ended(lanes, looks).astype(jnp.int64), n_lane_steps])
        return outcome, RunUnderWay(lanes, n_lane_steps, looks, last), progress

    def refilled(self, lanes: Lane, waiting, account) -> tuple:
        """Write down how far the one run is, whether it has ended or not."""
        return lanes, waiting, written(account, jnp.zeros(1, jnp.int64), lanes)

    def _corrected(self, lanes: Lane, ys):
        """The samples that were written, corrected but for the end of the motion, which is the end of a step."""
        parameters = jax.tree.map(lambda x: x[0], self.parameters)
        correct: Any = self.problem.correct

        def one_more(carry):
            i, rows = carry
            found = jnp.where(self.ts[i] == self.t_end, rows[i], correct(parameters, self.ts[i], rows[i]))
            return i + 1, jax.lax.dynamic_update_index_in_dim(rows, found, i, 0)

        n = jnp.maximum(lanes.n_samples[0], 1)
        _, rows = jax.lax.while_loop(lambda carry: carry[0] < n, one_more, (jnp.zeros((), jnp.int64), ys[0]))
        return rows[None]

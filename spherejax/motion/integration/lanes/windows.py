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

from spherejax.motion.integration.compiling import uninitialized
from spherejax.motion.integration.lanes.account import AccountLayout, written
from spherejax.motion.integration.lanes.engine import Queue
from spherejax.motion.integration.lanes.first_step import InitialStepProbe
from spherejax.motion.integration.lanes.lane import Block, Lane, LaneOutcome, LaneProblem, Last, is_busy
from spherejax.motion.integration.status import Status

WINDOW = 2048
"""Samples of a window: the rows of an array, of which those are touched that are written."""


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
    def of(cls, run: Any) -> "RunCheckpoint":
        """A pytree of a run that is under way."""
        leaves, tree = jax.tree.flatten(run)
        arrays = [jnp.asarray(leaf, jnp.result_type(leaf)) for leaf in leaves]
        forms = [_ArrayForm(array.dtype.name, array.shape) for array in arrays]
        # One vector of each type: handing over an array costs some microseconds, however small it is.
        parts: dict[str, list[Array]] = {}
        for array, form in zip(arrays, forms, strict=True):
            parts.setdefault(form.kind, []).append(array.reshape(-1))
        vectors = {kind: jnp.concatenate(each) for kind, each in parts.items()}
        return cls(vectors, jax.tree.unflatten(tree, forms))

    def whole(self) -> Any:
        """The pytree."""
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


def begun(problem: LaneProblem, parameters: Any, y0: Array, ends: Float[Array, "2"], may_run, status) -> RunUnderWay:
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
    # More than two, as any window has, so that there are states inside steps; what they are is not asked here.
    times = ends[jnp.array([0, 1, 1])]
    queue = Queue(problem, parameters, y0, times, may_run, status, Block())
    lanes = queue.begun()
    looks = InitialStepProbe.of_nothing(lanes.y) if queue.looks else None
    return RunUnderWay(lanes, jnp.zeros((), jnp.int64), looks, queue.nothing_last(lanes))


def run_loop(
    problem: LaneProblem, run: RunUnderWay, ends: Float[Array, "2"], window: Float[Array, " w"], n_turns: Int[Array, ""]
) -> tuple[LaneOutcome, RunUnderWay, Int[Array, "3"]]:
    """What a run is when its window is full, when it has ended, or after a number of turns; how it goes on; and the
    numbers of a `WindowProgress`. Of the samples those are undetermined that are not written."""
    return _Windows(problem, run.lanes, ends, window).gone_on_from(run, n_turns)


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
        # Not filled: of a run of few samples that would take a tenth of its time.
        room = uninitialized((1, self.ts.shape[0], *self.y0.shape[1:]))
        ys = jax.lax.dynamic_update_slice(room, self.y0[None], (0,) * room.ndim)

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
        n_written = jnp.maximum(lanes.n_samples[0], 1)
        ys, are_finite = self._looked_through(ys, n_written)
        outcome = account.outcome(rows, ys, are_finite, n_lane_steps, self.t_end)
        # The windows behind this one do not see its samples: what is wrong with them ends the run here.
        is_sound = are_finite | (lanes.status != Status.SUCCEEDED)
        lanes = lanes._replace(status=jnp.where(is_sound, lanes.status, Status.NOT_FINITE))
        progress = jnp.stack([n_written, has_not_ended(lanes, looks).astype(jnp.int64), n_lane_steps])
        return outcome, RunUnderWay(lanes, n_lane_steps, looks, last), progress

    def refilled(self, lanes: Lane, waiting, account) -> tuple:
        """Write down how far the one run is, whether it has ended or not."""
        return lanes, waiting, written(account, jnp.zeros(1, jnp.int64), lanes)

    def _looked_through(self, ys, n_written) -> tuple[Array, Array]:
        """The samples that were written, corrected where they are so late, and whether they are finite, shape (1,).

        Samples inside steps are corrected here, once for a window; in the loop each turn would have the code. The end
        of the motion is the end of a step, and not corrected again.
        """
        parameters = jax.tree.map(lambda x: x[0], self.parameters)
        correct: Any = self.problem.correct

        def is_left(carry):
            return carry[0] < n_written

        def finite_so_far(i, are_finite, row):
            return i + 1, are_finite & jnp.all(jnp.isfinite(row))

        def looked_at(carry):
            i, are_finite = carry
            return finite_so_far(i, are_finite, ys[0, i])

        def corrected(carry):
            i, are_finite, ys = carry
            row = jnp.where(self.ts[i] == self.t_end, ys[0, i], correct(parameters, self.ts[i], ys[0, i]))
            ys = jax.lax.dynamic_update_slice(ys, row[None, None], (0, i, 0))
            return *finite_so_far(i, are_finite, row), ys

        begin = jnp.zeros((), jnp.int64), jnp.array(True)
        if self.corrects_late:
            _, are_finite, ys = jax.lax.while_loop(is_left, corrected, (*begin, ys))
        else:
            _, are_finite = jax.lax.while_loop(is_left, looked_at, begin)
        return ys, are_finite[None]

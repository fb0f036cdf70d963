"""The steps of a run: it is made once more, and every step is written down.

Samples are where the user wants them; impacts and peaks lie between them. A run keeps no steps, for it may make
millions and lanes make thousands of runs; whoever asks for them has the run repeated, in a lane, by the same method and
tolerances, from the same start. That the repeated motion is the same is tested at the run's samples.
"""

import warnings
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Flag
from spherejax.model.system import Structure, System, flatten_by_factor
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration.compiling import for_one_run
from spherejax.motion.integration.jobs import JobKind, RunNumbers
from spherejax.motion.integration.lanes import LaneOutcome, StepLog, steps_in_lanes
from spherejax.motion.integration.problem import Parameters, Plan, RunMethod
from spherejax.motion.integration.row_blocks import in_blocks
from spherejax.motion.integration.status import Status
from spherejax.motion.integration.widths import block_for
from spherejax.motion.settings import RunSettings
from spherejax.physics.state import unpack
from spherejax.program_cache import cached_jit

NODES, WEIGHTS = (np.asarray(each) for each in np.polynomial.legendre.leggauss(4))
SHARES = tuple(float(x) for x in (NODES + 1) / 2)
"""Where inside each step the state is looked at: Gauss and Legendre's four nodes, exact for polynomials of degree 7."""
SHARE_WEIGHTS = WEIGHTS / 2

APART = 1e-3
"""Positions of two equal motions differ by less than this share of the smallest clearance, or of `LENGTH`."""

LENGTH = 1e-4
"""As if it were a clearance, where there is none [m]."""

COMPARED = 256
"""Samples at which a repeated run is compared with the first one."""

SEEN_AT_ONCE = 256
"""States that are looked at in one call."""

LARGEST_LOG = 2**31
"""Bytes of steps that are kept."""


class PartingWarning(UserWarning):
    """A repeated run parts from the first one: the motion is chaotic, and what is told from then on is of another."""


class Steps(NamedTuple):
    """The steps of one run.

    Attributes:
        t0: where it starts [s].
        y0: the flat state there.
        ends: where the steps end [s], shape (n,).
        at_ends: the flat states there, with what the events there changed, shape (n, size).
        inside: `SHARES` of each step [s], shape (n, k).
        at_inside: the flat states there, shape (n, k, size).
        states: function of more instants within steps [s], shape (m,), in any order: the flat states there, shape (m,
            size). It makes the run once more for up to `COMPARED - 2` of them.
    """

    t0: float
    y0: np.ndarray
    ends: np.ndarray
    at_ends: np.ndarray
    inside: np.ndarray
    at_inside: np.ndarray
    states: Any = None

    @property
    def lengths(self) -> np.ndarray:
        """Of the steps [s]."""
        return np.diff(self.ends, prepend=self.t0)


def steps_of(
    system: System, settings: RunSettings | None, ts, ys, n_accepted: int, t_reached: float, scalar: bool | None
) -> Steps:
    """The steps of a run.

    Args:
        system: what was run, with concrete numbers.
        settings: how; None where that is not known.
        ts, ys: its samples, the first one the start.
        n_accepted: how many steps it made.
        t_reached: how far it came [s]; steps beyond are not told.
        scalar: whether on scalar programs.

    Raises:
        SceneError: where the run cannot be repeated, or has too many steps to keep.
    """
    if not is_concrete(ys) or np.ndim(ys) != 2:
        raise SceneError(
            "steps are told of a single run, outside of jit and vmap; take one lane, or record peaks by sj.sweep; "
            "within a trace run.impact_rows(joint) has the contacts"
        )
    settings = repeatable(settings)
    structure, theta = flatten_by_factor(system)
    method = RunMethod.of_settings(system, structure, settings)
    plan = for_one_run(Plan(structure, (), scalar), method.rest)
    told, times, places = _compared(np.asarray(ts, float))
    y0 = jnp.asarray(ys[0])
    again = Repetition(method, jnp.asarray(theta), y0, times[jnp.array([0, -1])], jnp.array(True))
    capacity = room_for_steps(n_accepted)
    while True:
        _refuse_too_many(capacity, y0.size)
        outcome, log = repeated_in_steps(plan, capacity, again, times)
        n = int(outcome.n_accepted[0])
        if n <= capacity:
            break
        capacity = room_for_steps(n)
    ends, states = np.asarray(log.times[0, :n]), np.asarray(log.states[0, :n])
    repeated = np.asarray(outcome.ys[0])[places]
    warn_where_they_part(system, np.asarray(ts)[told], np.asarray(ys)[told], repeated)
    is_reached = ends[:, -1] <= t_reached
    ends, states = ends[is_reached], states[is_reached]
    more = partial(_states_within, plan, capacity, again)
    return Steps(float(times[0]), np.asarray(y0), ends[:, -1], states[:, -1], ends[:, :-1], states[:, :-1], more)


def _states_within(plan: Plan, capacity: int, again: "Repetition", times: np.ndarray) -> np.ndarray:
    """The flat states at instants of a run, by the program that has told its steps: of as many samples, always."""
    begin, end = np.asarray(again.ends)
    order = np.argsort(times)
    states = np.empty((len(times), again.y0.size))
    for at in range(0, len(times), COMPARED - 2):
        own = order[at : at + COMPARED - 2]
        sampled = np.full(COMPARED, end)
        sampled[: len(own) + 1] = [begin, *times[own]]
        outcome, _ = repeated_in_steps(plan, capacity, again, sampled)
        states[own] = np.asarray(outcome.ys[0])[1 : len(own) + 1]
    return states


class Repetition(NamedTuple):
    """A run that is made once more.

    Attributes:
        method: as it was made.
        theta: all numbers of its system.
        y0: flat state at its start.
        ends: times of its start and end [s].
        is_made: whether there is a run to repeat.
    """

    method: RunMethod
    theta: Float[Array, " p"]
    y0: Float[Array, " size"]
    ends: Float[Array, "2"]
    is_made: Flag


@cached_jit(what="the steps of a run")
def repeated_in_steps(
    plan: Plan, capacity: int, again: Repetition, ts: Float[Array, " n"]
) -> tuple[LaneOutcome, StepLog]:
    """A run from a state, with a row for each of its first `capacity` steps; its sample times are at least three."""
    method, theta = again.method, again.theta
    rate = program_for(state_rate, plan.structure, plan.scalar)
    numbers = RunNumbers(Parameters(theta, rate.ahead(theta)), None, method.own_tolerances, method.limits(plan, theta))
    problem = JobKind.of(plan, method).problem(ts, method.shared)
    own, first = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], (numbers, again.y0))
    may_run, status = jnp.broadcast_to(again.is_made, (1,)), jnp.full(1, Status.SUCCEEDED, jnp.int64)
    return steps_in_lanes(problem, own, first, ts, may_run, status, block_for(), capacity, SHARES)


def repeatable(settings: RunSettings | None) -> RunSettings:
    """How the run was integrated; `SceneError` where it cannot be repeated so."""
    if settings is None:
        raise SceneError(
            "the steps of this run cannot be told: its tolerances were traced, or a step-size controller of its own "
            "judged them. Simulate it once more with rtol= as a number and without stepsize_controller="
        )
    return settings


def room_for_steps(n: int) -> int:
    """Rows for n steps and a few more, for few different programs."""
    return max(256, 1 << int(np.ceil(np.log2(1.1 * n + 16))))


def _refuse_too_many(capacity: int, size: int) -> None:
    if 8 * capacity * (len(SHARES) + 1) * (size + 1) > LARGEST_LOG:
        raise SceneError(
            f"the run has more than {capacity // 2:,} steps of {size} numbers, too many to keep; simulate a shorter "
            "span, or from a later start"
        )


def _compared(ts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which samples two runs are compared at, the times that are asked for, and where among them those samples are.

    As many times for every run, so that another number of samples needs no other program: of more samples so many are
    compared, and where there are fewer the states between them are asked for, too.
    """
    n = len(ts)
    if n == 1:
        raise SceneError("a run of one instant has no steps; give ts an end")
    if n >= COMPARED:
        told = compared_samples(ts)
        return told, ts[told], np.arange(COMPARED)
    between = np.full(n - 1, (COMPARED - n) // (n - 1))
    between[: (COMPARED - n) % (n - 1)] += 1
    spans = zip(ts[:-1], ts[1:], between + 1, strict=True)
    parts = [np.linspace(begin, end, m, endpoint=False) for begin, end, m in spans]
    places = np.concatenate([[0], np.cumsum(between + 1)])
    return np.arange(n), np.concatenate([*parts, ts[-1:]]), places


def compared_samples(ts: np.ndarray) -> np.ndarray:
    """Indices of the samples at which a repeated run is compared with the first one."""
    n = len(ts)
    return np.arange(n) if n <= COMPARED else np.linspace(0, n - 1, COMPARED).round().astype(int)


def warn_where_they_part(system: System, ts, ys, repeated, why: str = "the run was repeated to see its steps") -> None:
    """Warn where a repeated run is another motion.

    Args:
        system: of both.
        ts, ys: samples of the run.
        repeated: flat states of the repeated run at these times.
        why: what it was repeated for, the beginning of a sentence.
    """
    models: list[Any] = [system.spherical(name).model for name in system.contact_joints]
    gaps = [float(model.clearance) for model in models]
    limit = APART * min([LENGTH, *gaps])
    unpacked = (np.asarray(unpack(system.layout, jnp.asarray(each)).position) for each in (ys, repeated))
    first, second = unpacked
    distance = np.abs(first - second).max(axis=(1, 2))
    parted = np.flatnonzero(~(distance <= limit) & np.isfinite(ys).all(axis=1))
    if parted.size:
        warnings.warn(
            f"{why}, and from t = {ts[parted[0]]:.6g} s on the repeated motion is another one (positions differ by "
            f"more than {limit:.1g} m): the motion is chaotic, and both are equally right. What is told of it from "
            "there on is of the repeated one",
            PartingWarning,
            stacklevel=4,
        )


# What is seen at the steps -------------------------------------------------------------------------------------------


def seen_at(system: System, function, ts: np.ndarray, ys: np.ndarray, scalar: bool | None) -> Any:
    """`function(system, t, y)` at many states, a tree of arrays with a leading axis."""
    structure, theta = flatten_by_factor(system)
    found = in_blocks(_seen, (structure, function, scalar, jnp.asarray(theta)), SEEN_AT_ONCE, ts, ys)
    return jax.tree.map(np.asarray, found)


@cached_jit(what="what is seen at the steps of a run")
def _seen(structure: Structure, function, scalar: bool | None, theta, ts, ys):
    system = structure.system(theta)
    return jax.lax.map(lambda sample: function(system, *sample), (ts, ys), batch_size=64)

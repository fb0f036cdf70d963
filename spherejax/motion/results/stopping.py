"""The first instant of a run at which a quantity passes a level: where a run that is made `until=` a condition ends.

The steps of the repeated run are looked at, at four instants within each and at its end, without derivatives: the first
change of sign of g = (quantity - level) lies between two neighbors of these. The states at eight instants between them
(`between.states_at`) have their derivatives by the numbers of the scene. With the polynomial through these states

    g(t*, y(t*)) = 0,    dt*/dp = -(dg/dp at fixed t*) / (dg/dt),    dy*/dp = (dy/dp at fixed t*) + (dy/dt) dt*/dp,

the instant is a root to rounding, and has the derivative of the implicit function.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete, is_tracing, shown
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import real_number
from spherejax.foundations.types import Flag, Scalar
from spherejax.motion.equations.programs import program_for
from spherejax.motion.equations.quantities import quantity, values_of
from spherejax.motion.integration.problem import Plan
from spherejax.motion.integration.status import Status
from spherejax.motion.results.between import states_at
from spherejax.motion.results.motion_state import MotionState
from spherejax.motion.results.steps import SHARES, Repetition, repeated_in_steps, room_for_steps
from spherejax.motion.results.traced_steps import refusing, repetition_of, seen_at_steps
from spherejax.motion.results.within_steps import COEFFICIENTS, NODES
from spherejax.program_cache import cached_jit

JUMPS = (
    "{name} passes the level of until= where it jumps: at the beginning or the end of a contact, or where a function "
    "of time jumps. The instant is right; its derivative, that of the jump, is not known here. Take differences of runs"
)

TOO_MANY = "the run has more than {steps} steps: where until= ends it is not known; give more, sj.When(..., steps=...)"


class When(eqx.Module):
    """A condition: a quantity passes a level. See `until=` of `sj.simulate`.

        sj.When("position.arm.z", 0.1, rising=True)

    Attributes:
        what: name of a quantity that is a number, as `sj.sweep` records it (static).
        level: in its unit; it may be traced and differentiated.
        rising: True where it passes upwards, False downwards, None either way (static).
        steps: within a trace, the largest number of steps that the run may have (static).
    """

    what: str = eqx.field(static=True)
    level: Any = 0.0
    rising: bool | None = eqx.field(static=True, default=None)
    steps: int = eqx.field(static=True, default=4096)

    def __check_init__(self) -> None:
        if not isinstance(self.what, str):
            raise SceneError(f"what = {shown(self.what)} is no name of a quantity; give e.g. 'position.arm.z'")
        real_number("level", self.level)
        if self.rising not in (True, False, None):
            raise SceneError(f"rising = {shown(self.rising)} must be True (upwards), False (downwards) or None (both)")
        if not isinstance(self.steps, int) or self.steps < 1:
            raise SceneError(f"steps = {shown(self.steps)} must be a whole number, at least 1")


def conditions_of(until: Any) -> tuple[When, ...]:
    """The conditions that a user gives: one, or several of which the first to be met ends the run."""
    conditions = (until,) if isinstance(until, When) else until
    if not isinstance(conditions, Sequence) or not conditions or not all(isinstance(one, When) for one in conditions):
        raise SceneError(
            f"until = {shown(until)} is no condition; give sj.When('position.arm.z', 0.1), or a list of such"
        )
    return tuple(conditions)


class _Bracket(NamedTuple):
    """Between which instants the first condition is met.

    Attributes:
        begin, end: the instants [s].
        which: index of the condition; -1 where none is met.
        n: steps of the run.
    """

    begin: Scalar
    end: Scalar
    which: Array
    n: Array


def stopped(run: Any, conditions: tuple[When, ...]) -> Any:
    """The run up to the first instant at which a condition is met, as a `Trajectory`; see `until=` of `simulate`."""
    for condition in conditions:
        what = quantity(condition.what, run.system)
        if what.dims:
            raise SceneError(
                f"until: {condition.what!r} is a vector; name one of its components, such as '{condition.what}.x'"
            )
    are_known = all(map(is_concrete, (run.ys, run.ended, run.t_reached, *(c.level for c in conditions))))
    are_known = are_known and not is_tracing()
    steps = room_for_steps(int(run.stats.n_accepted)) if are_known else max(c.steps for c in conditions)
    bracket = _bracket(run, conditions, steps, are_known)
    if are_known and int(bracket.which) < 0:
        return replace(run, stopped_by=jnp.asarray(-1))
    t, y = _root(run, conditions, bracket)
    has_met = bracket.which >= 0
    if are_known:
        before = np.asarray(run.ts) < float(t)
        ts = jnp.asarray(np.append(np.asarray(run.ts)[before], float(t)))
        ys = jnp.asarray(np.concatenate([np.asarray(run.ys)[before], np.asarray(y)[None]]))
    else:
        t = eqx.error_if(t, bracket.n > steps, TOO_MANY.format(steps=steps))
        is_behind = has_met & (run.ts >= t)
        ts, ys = jnp.where(is_behind, t, run.ts), jnp.where(is_behind[:, None], y, run.ys)
    return replace(
        run,
        ts=ts,
        ys=ys,
        ended=jnp.where(has_met, int(Status.SUCCEEDED), run.ended),
        t_reached=jnp.where(has_met, t, run.t_reached),
        y_reached=jnp.where(has_met, y, run.y_reached),
        stopped_by=bracket.which,
    )


def _bracket(run: Any, conditions: tuple[When, ...], steps: int, are_known: bool) -> _Bracket:
    """Of a single run; no derivative passes, and `jax.vmap` of it is a loop."""
    plan, again = repetition_of(run)
    names, risings = tuple(c.what for c in conditions), tuple(c.rising for c in conditions)
    levels = jnp.stack([jnp.asarray(c.level, jnp.float64) for c in conditions])
    look: Any = partial(_crossed, plan, names, risings, steps)
    if not are_known:
        look = jax.custom_batching.sequential_vmap(look)
    return look(*jax.lax.stop_gradient(jax.tree.map(jnp.asarray, (again, levels))))


@cached_jit(what="where a run ends")
def _crossed(
    plan: Plan, names: tuple, risings: tuple, steps: int, again: Repetition, levels: Float[Array, " c"]
) -> _Bracket:
    theta, y0, ends = again.theta, again.y0, again.ends
    begin = ends[0]
    times = jnp.stack([begin, (begin + ends[1]) / 2, ends[1]])
    outcome, log = repeated_in_steps(plan, steps, again, times)
    n = outcome.n_accepted[0]
    k = len(SHARES) + 1
    times = jnp.concatenate([begin[None], log.times[0].ravel()])
    states = jnp.concatenate([y0[None], log.states[0].reshape(steps * k, -1)])
    program = program_for(values_of(names), plan.structure, plan.scalar, is_quiet=True)
    seen = seen_at_steps(lambda t, y: program(theta, t, y), len(names), times, states, 1 + n * k)
    above = seen - levels
    is_there = jnp.arange(1, times.shape[0]) < 1 + n * k
    first, which = jnp.asarray(times.shape[0]), jnp.asarray(-1)
    for i, rising in enumerate(risings):
        g = above[:, i]
        up, down = (g[:-1] < 0) & (g[1:] >= 0), (g[:-1] > 0) & (g[1:] <= 0)
        passes = {True: up, False: down, None: up | down}[rising] & is_there
        at = jnp.where(jnp.any(passes), jnp.argmax(passes), times.shape[0])
        first, which = jnp.where(at < first, at, first), jnp.where(at < first, i, which)
    at = jnp.minimum(first, times.shape[0] - 2)
    has_met = which >= 0
    return _Bracket(jnp.where(has_met, times[at], begin), jnp.where(has_met, times[at + 1], begin), which, n)


def _root(run: Any, conditions: tuple[When, ...], bracket: _Bracket) -> tuple[Scalar, Float[Array, " size"]]:
    """The instant at which the condition is met, and the flat state there."""
    middle, half = (bracket.begin + bracket.end) / 2, (bracket.end - bracket.begin) / 2
    states = states_at(run, jnp.append(bracket.begin + jnp.asarray(NODES) * 2 * half, bracket.end))
    which = bracket.which

    def above(states: MotionState) -> Array:
        values = [states.value(c.what) - c.level for c in conditions]
        return jnp.stack(values)[jnp.maximum(which, 0)]

    of_states = jnp.asarray(COEFFICIENTS) @ states.y[:-1]
    coefficients = jax.lax.stop_gradient(jnp.asarray(COEFFICIENTS) @ above(states)[:-1])
    s, has_root = _zero(coefficients)
    t, y = jax.lax.stop_gradient(middle + half * s), jnp.polyval(of_states, s)
    there = replace(_first_of(states), t=t, y=y)
    width = jnp.where(half > 0, half, 1.0)
    slope = jax.lax.stop_gradient(jnp.polyval(jnp.polyder(coefficients), s) / width)
    rate = jax.lax.stop_gradient(jnp.polyval(_derivative(of_states), s) / width)
    delay = -above(there) / jnp.where(slope != 0, slope, 1.0)
    # Newton's step from the root of the polynomial: rounding in its value, the implicit function in its derivative.
    delay = jnp.where(has_root & (slope != 0), delay, 0.0)
    delay = refusing(JUMPS.format(name=" or ".join(c.what for c in conditions)), delay, has_root | (which < 0))
    t_met, y_met = t + delay, y + rate * delay
    return jnp.where(has_root, t_met, bracket.end + delay), jnp.where(has_root, y_met, states.y[-1] + 0 * delay)


def _first_of(states: MotionState) -> MotionState:
    return jax.tree.map(lambda leaf: leaf[0], states)


def _derivative(coefficients: Float[Array, "8 size"]) -> Float[Array, "7 size"]:
    return coefficients[:-1] * jnp.arange(len(NODES) - 1, 0, -1)[:, None]


@cached_jit(what="where a run ends")
def _zero(coefficients: Float[Array, " 8"]) -> tuple[Scalar, Flag]:
    """A zero from -1 to 1 of the polynomial, and whether it has one there: by bisection, and Newton's steps."""
    ends = jnp.polyval(coefficients, jnp.array([-1.0, 1.0]))

    def halved(_, interval):
        low, high = interval
        middle = (low + high) / 2
        is_behind = jnp.sign(jnp.polyval(coefficients, middle)) == jnp.sign(ends[0])
        return jnp.where(is_behind, middle, low), jnp.where(is_behind, high, middle)

    low, high = jax.lax.fori_loop(0, 52, halved, (jnp.asarray(-1.0), jnp.asarray(1.0)))
    return (low + high) / 2, ends[0] * ends[1] <= 0

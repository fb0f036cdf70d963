"""The first instant of a run at which a quantity passes a level: where a run that is made `until=` a condition ends.

The steps of the repeated run are looked at, at four instants within each and at its end, without derivatives: the first
change of sign of g = (quantity - level) lies between two neighbors of these. The states at eight instants between them
(`between.states_at`) have their derivatives by the numbers of the scene. With the polynomial through these states

    g(t*, y(t*)) = 0,    dt*/dp = -(dg/dp at fixed t*) / (dg/dt),    dy*/dp = (dy/dp at fixed t*) + (dy/dt) dt*/dp,

the instant is a root to rounding, and has the derivative of the implicit function.

A condition that is a function of the user's is traced once (`condition_functions`): the arrays that it closes over are
operands from then on, so that they may be traced, mapped and differentiated.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun
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
    """A condition: a quantity, or a function of the state, passes a level. See `until=` of `sj.simulate`.

        sj.When("position.arm.z", 0.1, rising=True)

        f = sj.ode(scene).f
        sj.When(lambda t, y, args: f.unpack(y).bodies["arm"].position[2] - floor(t))

    Attributes:
        what: name of a quantity that is a number, as `sj.sweep` records it; or a function `(t, y, args)` that returns
            a number, with the arguments of `sj.ode(scene).f.observe` and of the conditions of `diffrax.Event`: time
            [s], flat state (a row of `run.ys`), and the numbers of the scene (`run.system`). It may close over arrays,
            traced ones too, and derivatives by these are right (static).
        level: in its unit; it may be traced and differentiated.
        rising: True where it passes upwards, False downwards, None either way (static).
        steps: within a trace, the largest number of steps that the run may have (static).
    """

    what: str | Callable = eqx.field(static=True)
    level: Any = 0.0
    rising: bool | None = eqx.field(static=True, default=None)
    steps: int = eqx.field(static=True, default=4096)

    def __check_init__(self) -> None:
        if not isinstance(self.what, str) and not callable(self.what):
            raise SceneError(
                f"what = {shown(self.what)} is no name of a quantity and no function; give e.g. 'position.arm.z', or a "
                "function (t, y, args) that returns a number"
            )
        real_number("level", self.level)
        if self.rising not in (True, False, None):
            raise SceneError(f"rising = {shown(self.rising)} must be True (upwards), False (downwards) or None (both)")
        if not isinstance(self.steps, int) or self.steps < 1:
            raise SceneError(f"steps = {shown(self.steps)} must be a whole number, at least 1")

    @property
    def name(self) -> str:
        """The quantity, or what the function is called."""
        what: Any = self.what
        return what if isinstance(what, str) else getattr(what, "__qualname__", type(what).__qualname__)


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
        if isinstance(condition.what, str) and quantity(condition.what, run.system).dims:
            raise SceneError(
                f"until: {condition.what!r} is a vector; name one of its components, such as '{condition.what}.x'"
            )
    functions = condition_functions(run, conditions)
    closed_over = [array for function in functions if function is not None for array in function.closed_over]
    numbers = run.ys, run.ended, run.t_reached, *(c.level for c in conditions), *closed_over
    are_known = all(map(is_concrete, numbers)) and not is_tracing()
    steps = room_for_steps(int(run.stats.n_accepted)) if are_known else max(c.steps for c in conditions)
    bracket = _bracket(run, conditions, functions, steps, are_known)
    if are_known and int(bracket.which) < 0:
        return replace(run, stopped_by=jnp.asarray(-1))
    t, y = _root(run, conditions, functions, bracket)
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


class ConditionFunction(NamedTuple):
    """A user's function (t, y, args), traced.

    Attributes:
        program: the same as a function of the arrays that it closes over, and of t, y, and the numbers of the scene.
        closed_over: these arrays.
    """

    program: Callable
    closed_over: tuple


def condition_functions(run: Any, conditions: tuple[When, ...]) -> list[ConditionFunction | None]:
    """The functions among the conditions, traced; None in the places of names.

    Raises:
        SceneError: for a function that fails, or that does not return one real number.
    """
    return [None if isinstance(c.what, str) else _traced_function(run, c) for c in conditions]


def _traced_function(run: Any, condition: When) -> ConditionFunction:
    name, (size,) = condition.name, run.ys.shape[1:]
    expected = (
        f"until: {name} is called with the time, the flat state of shape ({size},) and the numbers of the scene, "
        "(t, y, args), and returns one real number, which passes the level"
    )
    what: Any = condition.what
    try:
        closed, shape = jax.make_jaxpr(what, return_shape=True)(jnp.zeros(()), jnp.zeros(size), run.system)
    except SceneError:
        raise
    except Exception as error:  # whatever a user's function raises
        reason = (str(error).strip().splitlines() or [""])[0]
        raise SceneError(f"{expected}. It raised {type(error).__name__}: {reason}") from error
    leaves = jax.tree.leaves(shape)
    if len(leaves) != 1 or leaves[0].shape or jax.tree.structure(shape) != jax.tree.structure(0):
        shapes = ", ".join(str(leaf.shape) for leaf in leaves) or "nothing"
        raise SceneError(f"{expected}. It returns arrays of the shapes {shapes}; take one entry, or a sum")
    if not jnp.issubdtype(leaves[0].dtype, jnp.floating):
        is_truth = leaves[0].dtype == bool
        remedy = "the difference, e.g. y[2] - 0.1 in place of y[2] < 0.1" if is_truth else "a real number"
        raise SceneError(f"{expected}. It returns a value of type {leaves[0].dtype}; return {remedy}")

    def program(closed_over, t, y, system):
        (value,) = jaxpr_as_fun(ClosedJaxpr(closed.jaxpr, closed_over))(*jax.tree.leaves((t, y, system)))
        return value

    return ConditionFunction(program, tuple(closed.consts))


def _bracket(run: Any, conditions: tuple[When, ...], functions: list, steps: int, are_known: bool) -> _Bracket:
    """Of a single run; no derivative passes, and `jax.vmap` of it is a loop."""
    plan, again = repetition_of(run)
    names, risings = tuple(c.what for c in conditions), tuple(c.rising for c in conditions)
    levels = jnp.stack([jnp.asarray(c.level, jnp.float64) for c in conditions])
    own = [function for function in functions if function is not None]
    look: Any = partial(_crossed_names, plan, names, risings, steps)
    operands: tuple = (again, levels)
    if own:
        # A function of the user's is a new program in each call: what it closes over may have changed.
        look = partial(_crossed, plan, names, risings, steps, [function.program for function in own])
        operands = again, levels, [function.closed_over for function in own], run.system
    if not are_known:
        look = jax.custom_batching.sequential_vmap(look)
    return look(*jax.lax.stop_gradient(jax.tree.map(jnp.asarray, operands)))


@cached_jit(what="where a run ends")
def _crossed_names(plan: Plan, names: tuple, risings: tuple, steps: int, again: Repetition, levels) -> _Bracket:
    return _crossed(plan, names, risings, steps, [], again, levels, [], None)


def _crossed(
    plan: Plan,
    names: tuple,
    risings: tuple,
    steps: int,
    programs: list,
    again: Repetition,
    levels: Float[Array, " c"],
    closed_over: list,
    system: Any,
) -> _Bracket:
    theta, y0, ends = again.theta, again.y0, again.ends
    begin = ends[0]
    times = jnp.stack([begin, (begin + ends[1]) / 2, ends[1]])
    outcome, log = repeated_in_steps(plan, steps, again, times)
    n = outcome.n_accepted[0]
    k = len(SHARES) + 1
    times = jnp.concatenate([begin[None], log.times[0].ravel()])
    states = jnp.concatenate([y0[None], log.states[0].reshape(steps * k, -1)])
    quantities = tuple(name for name in names if isinstance(name, str))
    # By the order of the conditions: values of names come first, then those of functions.
    order = np.argsort(np.argsort([not isinstance(name, str) for name in names], kind="stable"))

    def see(t, y):
        parts = [program(own, t, y, system)[None] for program, own in zip(programs, closed_over, strict=True)]
        if quantities:
            program = program_for(values_of(quantities), plan.structure, plan.scalar, is_quiet=True)
            parts.insert(0, program(theta, t, y))
        return jnp.concatenate(parts)[order]

    seen = seen_at_steps(see, len(names), times, states, 1 + n * k)
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


def _root(run: Any, conditions: tuple[When, ...], functions: list, bracket: _Bracket) -> tuple:
    """The instant at which the condition is met, and the flat state there."""
    middle, half = (bracket.begin + bracket.end) / 2, (bracket.end - bracket.begin) / 2
    states = states_at(run, jnp.append(bracket.begin + jnp.asarray(NODES) * 2 * half, bracket.end))
    which = bracket.which

    def above(states: MotionState) -> Array:
        values = [
            (states.value(str(c.what)) if function is None else _value(run, function, states)) - c.level
            for c, function in zip(conditions, functions, strict=True)
        ]
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
    delay = refusing(JUMPS.format(name=" or ".join(c.name for c in conditions)), delay, has_root | (which < 0))
    t_met, y_met = t + delay, y + rate * delay
    return jnp.where(has_root, t_met, bracket.end + delay), jnp.where(has_root, y_met, states.y[-1] + 0 * delay)


def _value(run: Any, function: ConditionFunction, states: MotionState) -> Array:
    """Of a user's function, at a state or at many."""

    def at(t, y):
        return function.program(function.closed_over, t, y, run.system)

    return (jax.vmap(at) if np.ndim(states.ended) else at)(jnp.asarray(states.t), jnp.asarray(states.y))


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

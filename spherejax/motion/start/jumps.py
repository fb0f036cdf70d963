"""Prescribed motions that jump: no force moves a body by a finite way in no time, so such a driver is refused.

A driver's equation is differentiated twice; a jump of what it prescribes is in none of the derivatives, and only drift
control would follow it: slowly by feedback, by teleport with a correction. A jump of the rate (a kink) is an impact of
the driver. Where the function says where it turns (`distance_to_breakpoint`: tables, pieces) a step ends there, and the
correction of the velocities is that impact. Kinks of a function that does not say so are refused.

Bisection of the whole run finds them: of each interval the half is kept in which the function differs more from what
its derivatives at the ends predict, until the interval is as short as the rounding of time. A difference that remains
is a jump.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from spherejax.foundations.checks import concretely, is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Numeric
from spherejax.model.system import System
from spherejax.physics.functions.base import AbstractFunction
from spherejax.program_cache import cached_jit

N_INTERVALS = 4096
"""Intervals of a run that are bisected; two jumps within one, a pulse, may pass as none."""

N_INTERVALS_TRACED = 256
"""The same within a compiled program, where every run pays for them."""

N_HALVINGS = 34
"""To 1e-14 of a run: below the interval a continuous function cannot be told from one that jumps."""

JUMP = 1e-9
"""Jumps [m, rad] below this, or this share of the largest value, are taken for rounding."""

RATE_JUMP = 1e-6
"""The same of rates [m/s, rad/s]: their rounding is larger, by the derivatives of tables and cubics."""

MOST_MARKS = 512
"""Instants at which a function says that it begins, ends or turns that bound intervals as well."""


class Jumps(NamedTuple):
    """The largest jump of a function and of its rate.

    Attributes:
        values: of the function [m or rad], before and after.
        at: when [s].
        rates: of its rate [m/s or rad/s], before and after.
        rates_at: when [s].
        is_jump, is_kink: whether they are more than rounding.
    """

    values: Float[Array, "2"]
    at: Float[Array, ""]
    rates: Float[Array, "2"]
    rates_at: Float[Array, ""]
    is_jump: Bool[Array, ""]
    is_kink: Bool[Array, ""]


def jump_conditions(system: System, ts: Numeric) -> list:
    """Conditions, traced, that drivers' functions are known and do not jump between the first and the last sample time.

    Args:
        system: the system.
        ts: sample times [s].

    Raises:
        SceneError: for a function whose numbers are known, and which jumps, or is known for a shorter time.
    """
    conditions = []
    if np.shape(ts)[0] < 2:
        return conditions
    for name, joint in system.joints.items():
        for function in joint.functions_of_time:
            if function.domain is not None:
                conditions += _known_all_along(name, function.domain, ts)
            if function.may_jump:
                conditions += _condition(name, function, ts)
    return conditions


def _known_all_along(name: str, domain: tuple, ts: Numeric) -> list:
    """The condition, where it is traced, that the sample times lie within the domain of a function."""
    ends = domain[0], domain[1], ts[0], ts[-1]
    low, high, first, last = concretely(lambda *each: tuple(jnp.asarray(one, jnp.float64) for one in each), *ends)
    slack = 1e-9 * (high - low)  # less than a function's own slack, and more than sample times are rounded
    is_within = (first >= low - slack) & (last <= high + slack)
    if not is_concrete(is_within):
        return [is_within]
    if not is_within:
        raise SceneError(
            f"driver {name!r}: its function of time is known from {float(low):.6g} s to {float(high):.6g} s, and the "
            f"run goes from {float(first):.6g} s to {float(last):.6g} s; give the integral of its rate an "
            f"origin and an end that enclose the run, e.g. sj.functions.Integral(rate, start, until={float(last):.6g})"
        )
    return []


def _condition(name: str, function: AbstractFunction, ts: Numeric) -> list:
    says_where = function.distance_to_breakpoint(jnp.zeros(()), True) is not None
    if is_concrete(ts) and all(map(is_concrete, jax.tree.leaves(function))):
        with jax.ensure_compile_time_eval():
            grid = np.linspace(float(ts[0]), float(ts[-1]), N_INTERVALS + 1)
            jumps = _jumps(function, jnp.asarray(_with_marks(function, grid) if says_where else grid))
        if all(map(is_concrete, jax.tree.leaves(jumps))):  # not of a function that closes over what is traced
            _refuse(name, jumps, says_where)
            return []
    else:
        grid = ts[0] + (ts[-1] - ts[0]) * jnp.linspace(0.0, 1.0, N_INTERVALS_TRACED + 1)
        jumps = _jumps(function, grid)
    return [~(jumps.is_jump | (jumps.is_kink & (not says_where)))]


def _refuse(name: str, jumps: Jumps, says_where: bool) -> None:
    if bool(jumps.is_jump):
        before, after = np.asarray(jumps.values)
        raise SceneError(
            f"driver {name!r}: its function of time jumps at t = {float(jumps.at):.9g} s from {before:.6g} to "
            f"{after:.6g} (m or rad), or changes there at a rate that is not finite, as a square root does at zero. No "
            "force moves a body so: let it change over a finite time, e.g. "
            "sj.functions.SmoothStep(start, end, before, after)"
        )
    if bool(jumps.is_kink) and not says_where:
        before, after = np.asarray(jumps.rates)
        raise SceneError(
            f"driver {name!r}: the rate of its function of time jumps at t = {float(jumps.rates_at):.9g} s from "
            f"{before:.6g} to {after:.6g} (m/s or rad/s), an impact of the driver, and no step ends there. Say where "
            f"it is: sj.functions.Piecewise([{float(jumps.rates_at):.9g}], [f, g]) with a function f before "
            f"and g after that "
            "instant (two functions: one that has the kink itself has no rate there), or "
            "sj.functions.Table(t, values); or give "
            "a smooth function, e.g. sj.functions.SmoothStep"
        )


def _with_marks(function: AbstractFunction, grid: np.ndarray) -> np.ndarray:
    """The grid with the instants at which the function says that it turns, and the middles between them."""
    t, marks = grid[0], [grid[0]]
    while t < grid[-1] and len(marks) < MOST_MARKS:
        t = t + float(np.asarray(function.distance_to_breakpoint(jnp.asarray(t), True)))
        marks.append(min(t, grid[-1]))
    places = np.array(marks)
    between = (places[1:] + places[:-1]) / 2
    every = np.unique(np.concatenate([grid, places, between]))
    # Of one length for up to so many marks: another would be another program.
    return np.concatenate([every, np.full(max(0, N_INTERVALS + 2 * MOST_MARKS - len(every)), grid[-1])])


@cached_jit
def _jumps(function: AbstractFunction, grid: Float[Array, " n"]) -> Jumps:
    def value(t):
        return jnp.ravel(jnp.asarray(function(t), jnp.float64))

    rate = _rate_of(value)
    of_value, of_rate = _largest(value, rate, grid), _largest(rate, _rate_of(rate), grid)
    (values, at, size), (rates, rates_at, rate_size) = of_value, of_rate
    is_jump = jnp.abs(values[1] - values[0]) > JUMP * jnp.maximum(1.0, size)
    is_kink = jnp.abs(rates[1] - rates[0]) > RATE_JUMP * jnp.maximum(1.0, rate_size)
    return Jumps(values, at, rates, rates_at, is_jump, is_kink)


def _rate_of(function: Any) -> Any:
    return lambda t: jax.jvp(function, (t,), (jnp.ones_like(t),))[1]


def _largest(function, slope, grid) -> tuple[Float[Array, "2"], Float[Array, ""], Float[Array, ""]]:
    """Values before and after the largest jump of a function of several components, when, and its largest value."""
    each, slopes = jax.vmap(function), jax.vmap(slope)

    def stray(a, b, f_a, f_b, s_a, s_b):
        """How far the way differs from what the slopes at both ends say; where they are not finite, the way itself."""
        straight = (b - a)[:, None] * (s_a + s_b) / 2
        return jnp.max(jnp.abs(f_b - f_a - jnp.where(jnp.isfinite(straight), straight, 0.0)), axis=1)

    def halve(_, interval):
        a, b, f_a, f_b, s_a, s_b = interval
        m = a + (b - a) / 2
        f_m, s_m = each(m), slopes(m)
        is_first = stray(a, m, f_a, f_m, s_a, s_m) > stray(m, b, f_m, f_b, s_m, s_b)
        first, second = (a, m, f_a, f_m, s_a, s_m), (m, b, f_m, f_b, s_m, s_b)
        return tuple(
            jnp.where(is_first.reshape(-1, *(1,) * (x.ndim - 1)), x, y) for x, y in zip(first, second, strict=True)
        )

    values, derivatives = each(grid), slopes(grid)
    start = grid[:-1], grid[1:], values[:-1], values[1:], derivatives[:-1], derivatives[1:]
    _, at, before, after, *_ = jax.lax.fori_loop(0, N_HALVINGS, halve, start)
    jumps = jnp.where(jnp.isfinite(before) & jnp.isfinite(after), jnp.abs(after - before), 0.0)
    place = jnp.argmax(jumps)
    row, column = place // jumps.shape[1], place % jumps.shape[1]
    size = jnp.max(jnp.where(jnp.isfinite(values), jnp.abs(values), 0.0))
    return jnp.stack([before[row, column], after[row, column]]), at[row], size

"""Derivatives over surfaces at which a force has a kink: stops, tyres, and contacts whose stiffness is there at once.

The force f is continuous there, its slope df/dy jumps by K, and so do the rates of the sensitivities Y. A stage of a
step on the wrong side is an error of K Y times the step, and a step that ends within a window w behind the surface one
of K Y w / speed, with K of 1e10 N/m and w of 1e-9 m ten times the derivative itself. So with sensitivities

1. steps end short of the surface by a share of themselves, again and again, until it is within `TOUCH_WINDOW`
   (`LandingController`);
2. the step from there begins by going over it (`OverKinks`), for a time epsilon in which no method's stages matter, by
   Euler's, and for the time epsilon' that this ends behind the surface with the rates behind it:

       y := y + epsilon f_before,    Y := Y + epsilon Y_rate_before,
       y := y + epsilon' (f_behind - f_before),    Y := Y + epsilon' (Y_rate_behind - Y_rate_before).

Explicit methods in lanes do the same with fewer steps (`integration.lanes.landing`).
"""

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from spherejax.foundations.types import Scalar
from spherejax.motion.solvers.landing import ContactFunctions, is_short_of_kink, windows_of
from spherejax.motion.solvers.wrapping import AbstractForwardingSolver


class OverKinks(AbstractForwardingSolver):
    """A solver whose steps begin by going over a kink that lies just ahead.

    Attributes:
        solver: the solver that makes the rest of the step.
        contacts: the system's contacts and touches, with sensitivities (static).
    """

    solver: diffrax.AbstractSolver
    contacts: ContactFunctions = eqx.field(static=True)

    def init(self, terms, t0, t1, y0, args):
        """As the wrapped solver's."""
        return self.solver.init(terms, t0, t1, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """Over the kink, if there is one, then a step of the wrapped solver."""
        t, y, is_over = over_kink(self.contacts, terms.vf, jnp.asarray(t0), y0, args)
        return self.solver.step(terms, t, t1, y, args, solver_state, made_jump | is_over)


def over_kink(
    contacts: ContactFunctions, rate: Callable, t: Scalar, y: Array, parameters: Any
) -> tuple[Scalar, Array, Bool[Array, ""]]:
    """Time and state behind a kink that lies just ahead of a state, and whether one does; else the same time and state.

    Differentiable with the instants held fixed, which is the derivative: the force is continuous.

    Args:
        contacts: the system's contacts and touches, with sensitivities or without.
        rate: right-hand side (t, y, parameters) of what is integrated.
        t: time [s].
        y: the state, with sensitivities or without.
        parameters: what both are given.
    """
    windows = contacts.at_kinks(windows_of(contacts))
    crossing = jax.lax.stop_gradient(contacts.crossings(parameters, t, y))
    is_short = is_short_of_kink(contacts, crossing, jax.lax.stop_gradient(y), t)
    value = contacts.at_kinks(crossing.value)
    sign = jnp.where(value > 0, -1.0, 1.0)
    speed = jnp.where(is_short, sign * contacts.at_kinks(crossing.rate), 1.0)
    # Over all that lie ahead: stops that are met at the same time are one surface.
    size = jnp.max(jnp.where(is_short, (windows / 2 - sign * value) / speed, 0.0))

    def over(t, y):
        before = rate(t, y, parameters)
        there = y + size * before
        behind = jax.lax.stop_gradient(contacts.crossings(parameters, t + size, there))
        value, speed = sign * contacts.at_kinks(behind.value), sign * contacts.at_kinks(behind.rate)
        is_behind = is_short & (value > 0) & (speed > 0)
        late = jnp.min(jnp.where(is_behind, value / jnp.where(is_behind, speed, 1.0), size))
        there = there + late * (rate(t + size, there, parameters) - before)
        return t + size, contacts.update(parameters, t + size, y, there)

    is_over = jnp.any(is_short)
    t, y = jax.lax.cond(is_over, over, lambda t, y: (t, y), t, y)
    return t, y, is_over

"""Wear of two surfaces: Archard's law at every point, and the pressure of a Winkler foundation on worn surfaces.

    dh/dt = k p |v_s|

h is the depth of one body's surface at one of its points, k its wear coefficient [m^2/N], p the pressure and v_s the
sliding velocity there. A spherical point u (a unit vector from the socket's center) has the gap c + h_i + h_j - e.u
between ball and socket, and a foundation of stiffness k_w [N/m^3] presses where that is negative:

    p = k_w max(0, s n.u - c - h_i - h_j)

along the contact's direction n; the approach s is that whose resultant is the normal force. The points of a journal in
its bearing are those of a circle across the axis, and stand for the whole length. Everything here is of one
contact at one instant, exact to the order of c/R: both surfaces have the socket's radius.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.types import Number, Numeric, Scalar

MOST_NEWTON_STEPS = 40
"""Of the approach: the load is piecewise linear in it and convex, so each step but the last changes who touches."""

_ANGLE_STEPS = 12
"""Of the half angle of a journal's foundation, by Newton's method from a bound above it: convex, at most 1.6 times."""

_SMALL_ANGLE = 0.4
"""Below, 2 theta - sin 2 theta is a series of seven terms, right to rounding there."""

_CUBIC_STEPS = 8
"""Of the depth of a foundation, from a bound that is at most some 25 % away."""


class WearContact(NamedTuple):
    """One contact at one instant, in the axes of the socket's body; of many contacts with a leading axis.

    Attributes:
        force: normal force along n [N], positive.
        direction: n, unit vector from the socket's center to the contact, shape (3,).
        velocity: e_dot - w_j x e, of the ball's material at the socket's center [m/s].
        spin: w_j - w_i, of the ball against the socket [rad/s].
        turned: axes of the ball's body as columns, in those of the socket's, shape (3, 3).
        stiffness: k_w of the foundation [N/m^3].
        across: force across n over that along it, as the run has it on surfaces that are not round, shape (3,).
    """

    force: Numeric
    direction: Numeric
    velocity: Numeric
    spin: Numeric
    turned: Numeric
    stiffness: Numeric
    across: Numeric = np.zeros(3)


def foundation_force(depth: Number, clearance: Number, radius: Number, stiffness: Number) -> Numeric:
    """Force of a Winkler foundation between a ball and an unworn socket [N].

        F = pi k_w R^2 delta^2 (3 c + 2 delta) / (3 (c + delta)^2)

    Args:
        depth: delta = |e| - c [m], not negative.
        clearance: c [m].
        radius: R [m].
        stiffness: k_w [N/m^3].

    Limits: pi k_w R^2 delta^2/c for delta << c; 0 with slope 0 at delta = 0.

    Source: integral of p n.u over the cap n.u > c/(c + delta).
    """
    e = clearance + depth
    return jnp.pi * stiffness * radius**2 * depth**2 * (3 * clearance + 2 * depth) / (3 * e * e)


def foundation_depth(force: Numeric, clearance: Number, radius: Number, stiffness: Number) -> Scalar:
    """The depth delta of `foundation_force` [m], to rounding; 0 without a force.

    Newton's iteration from a bound above the root: the force is convex there.
    """
    f = 3 * force / (jnp.pi * stiffness * radius**2)
    # (3 c + 2 delta)/(c + delta) is at least 2, so that f >= 2 delta^2/(c + delta).
    bound = (f + jnp.sqrt(f * (f + 8 * clearance))) / 4
    floor = jnp.finfo(float).tiny

    def improved(_, depth):
        e = clearance + depth
        value = depth**2 * (3 * clearance + 2 * depth) / (e * e) - f
        slope = 2 * depth * (3 * clearance**2 + 3 * clearance * depth + depth**2) / (e * e * e)
        return jnp.where(slope > 0, depth - value / jnp.maximum(slope, floor), depth)

    return jax.lax.fori_loop(0, _CUBIC_STEPS, improved, bound)


def journal_foundation_force(
    depth: Numeric, clearance: Number, radius: Number, length: Number, stiffness: Numeric
) -> Numeric:
    """Force of a Winkler foundation between a journal and its unworn bearing [N].

        F = k_w R L c (2 theta - sin 2 theta)/(2 cos theta),    cos theta = c/(c + delta)

    Args:
        depth: delta = |e| - c [m], not negative.
        clearance: c [m].
        radius: R [m].
        length: L of the bearing [m].
        stiffness: k_w [N/m^3].

    Limits: (4/3) k_w R L delta sqrt(2 delta/c) for delta << c; 0 with slope 0 at delta = 0.

    Source: integral of p n.u over the arc n.u > c/(c + delta).
    """
    theta = 2 * jnp.arcsin(jnp.sqrt(depth / (2 * (clearance + depth))))
    return stiffness * radius * length * (clearance + depth) * _segment(2 * theta) / 2


def journal_foundation_depth(
    force: Numeric, clearance: Numeric, radius: Number, length: Number, stiffness: Numeric
) -> Numeric:
    """The depth delta of `journal_foundation_force` [m], to rounding; 0 without a force.

    Newton's iteration for the half angle theta from a bound above it, f = F/(k_w R L c) > 2 theta^3/3.
    """
    f = force / (stiffness * radius * length * clearance)
    theta = jnp.minimum(jnp.cbrt(1.5 * f), jnp.pi / 2)
    for _ in range(_ANGLE_STEPS):
        value = _segment(2 * theta) - 2 * f * jnp.cos(theta)
        slope = 4 * jnp.sin(theta) ** 2 + 2 * f * jnp.sin(theta)
        theta = jnp.where(slope > 0, theta - value / jnp.where(slope > 0, slope, 1.0), theta)
    return clearance * 2 * jnp.sin(theta / 2) ** 2 / jnp.cos(theta)


def _segment(x: Numeric) -> Numeric:
    """x - sin x, without the digits that the difference loses at small angles."""
    square = x * x
    series, term = jnp.zeros_like(square), x * square / 6
    for k in range(7):
        series = series + term
        term = -term * square / ((2 * k + 4) * (2 * k + 5))
    return jnp.where(square < _SMALL_ANGLE**2, series, x - jnp.sin(x))


def matched_stiffness(force: Numeric, penetration: Numeric, clearance: Number, radius: Number) -> Scalar:
    """k_w [N/m^3] of the foundation whose patch on unworn surfaces is as wide as Hertz's.

    Hertz's circle has a^2 = R^2 delta/c, the foundation's cap 2 R^2 delta_w/c: the foundation yields half as far as
    the Hertzian bodies approach. Its pressure falls as a parabola, not as a half ellipse: in the middle it is 2, not
    1.5 times the mean.

    Args:
        force: normal force [N], positive.
        penetration: delta of the contact law [m], positive.
        clearance: c [m].
        radius: R [m].
    """
    return force / foundation_force(penetration / 2, clearance, radius, 1.0)


def surface_sliding(u: Float[Array, "q 3"], contact: WearContact, radius: Number) -> Float[Array, "q 3"]:
    """Velocity of the ball's material against the socket's at points of the surface [m/s], in the tangential planes.

        v_s = (I - u u^T) ((I - n n^T) (e_dot - w_j x e) + (w_j - w_i) x R u)

    Both materials are taken at one common place, R u from the socket's center. The term w_j x e is what makes a pair
    that turns as one rigid body slide nowhere. The approach along n is left out: it compresses the surfaces, and bodies
    that are pressed together without sliding in the middle do not slide at the edges (Hertz, like materials).

    Args:
        u: unit vectors.
        contact: the contact.
        radius: R of the socket [m].
    """
    n = contact.direction
    v = contact.velocity - (contact.velocity @ n) * n + jnp.cross(contact.spin, radius * u)
    return v - jnp.sum(v * u, axis=-1, keepdims=True) * u


def approach(
    x: Float[Array, " q"], gap: Float[Array, " q"], areas: Float[Array, " q"], force: Number, stiffness: Number
) -> Scalar:
    """How far the ball goes beyond the clearance, s - c [m], for the foundation to carry the force along n.

        sum_q k_w max(0, (s - c) x_q - gap_q) x_q A_q = F

    Args:
        x: n.u at the points, positive.
        gap: c (1 - n.u) + h_i + h_j there [m], of the ball that just touches its unworn socket: without the digits that
            s n.u - c would lose where the ball goes a billionth of the clearance beyond it.
        areas: of the points' shares of the surface [m^2].
        force: [N], positive.
        stiffness: k_w [N/m^3].

    Limits: the sum is convex and piecewise linear, so Newton's iteration from where every point
    touches ends at the root after finitely many steps.
    """
    weights = stiffness * areas * x

    def load_and_slope(s):
        touching = s * x > gap
        return (
            jnp.sum(jnp.where(touching, weights * (s * x - gap), 0.0)),
            jnp.sum(jnp.where(touching, weights * x, 0.0)),
        )

    def improved(state):
        s, _, count = state
        load, slope = load_and_slope(s)
        new = s - (load - force) / slope
        return new, jnp.abs(new - s), count + 1

    def goes_on(state):
        s, change, count = state
        return (change > 1e-15 * jnp.abs(s)) & (count < MOST_NEWTON_STEPS)

    start = jnp.max(gap / x)
    s, _, _ = jax.lax.while_loop(goes_on, improved, (start * (1 + 1e-12), jnp.full((), jnp.inf), 0))
    return s

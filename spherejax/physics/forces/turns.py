"""Angles about an axis between two bodies, through any number of turns.

With the relative orientation (c, q) since the start, in the first body's axes, and the axis n,

    angle = 2 atan2(s, c) + 2 pi N,    s = n . q
    d angle/dt = g . (w_2 - w_1),    g = (c^2 n + c q x n + s q)/(c^2 + s^2)

and g, which is n while the bodies turn about the axis alone, is what a torque acts along: so it derives from an energy
however the axes tilt.

An orientation does not say how many whole turns N led there. Each element that has an angle therefore has one more
entry of the state for it, `turned`, whose rate is that of the angle, with a correction towards it:

    N = round((turned - 2 atan2(s, c))/(2 pi))
    turned_rate = rate + |rate| (angle - turned)/(2 pi)

Why an integrated angle, and not a count that is advanced at the end of each step: the count needs the angle at the last
step's end, and is wrong in silence where a step turns by more than half a turn; it is an event, which every integrator,
every derivative and every export would have to know. The integrated angle is an ordinary state of them all. Why not the
integrated angle alone: its errors add up. It chooses N and nothing else, so the angle is as exact as the orientation;
its derivative by `turned` is zero, and N is constant between errors of half a turn.

The correction takes out within about a turn what errors have left; its rate is no faster than the motion. Without it a
free rotor at rtol = 1e-3 was off by 1 rad after 5,300 turns. The audit ends a run in which `turned` and angle differ by
more than `LARGEST_DOUBT`, long before N is wrong.

Authors of force elements need not know of this: `attachments_of` searches an element for fields of the type
`TorsionalAttachment`, and `with_turns` puts the integrated angles into them before the element is evaluated.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import concretely
from spherejax.foundations.rotation import conjugate, normalized, quaternion_product
from spherejax.foundations.types import Numeric, Scalar, Vector3
from spherejax.physics.bodies import Body
from spherejax.physics.forces.base import Motions
from spherejax.physics.forces.line import direction_on, start_quaternion
from spherejax.physics.memory import MemoryEntry

SMALLEST_TWIST_SQUARE = 1e-12
"""Of c^2 + s^2, below which the axis is tilted by pi to 2e-6 and no twist is defined; there g is held finite."""

LARGEST_DOUBT = 1.0
"""By how much [rad] the integrated angle may differ from that of the orientation: a third of what changes N."""

LARGEST_TILT = np.radians(170.0)
"""Tilt of the second body's axis against the first's [rad] from which on an angle about it means little: at 180 degrees
there is none, and beside it small motions turn it by whole turns."""

_SQUARE_AT_LARGEST_TILT = float(np.cos(LARGEST_TILT / 2) ** 2)


class Twist(NamedTuple):
    """How far a body has turned against another about an axis.

    Attributes:
        angle: since the start, through any number of turns [rad].
        rate: [rad/s].
        direction: g, world axes.
    """

    angle: Scalar
    rate: Scalar
    direction: Vector3


class TorsionalAttachment(eqx.Module):
    """An axis between two bodies, in body axes.

    Attributes:
        bodies: names of the two bodies.
        axis: n, unit vector in the first body's axes.
        start_quaternion: second body against the first at the start.
        turned: the angle as its rate was integrated [rad], which says how many turns there were; None where it is not
            known. Then the angle is that of the orientation, within one turn to either side of the start.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    axis: Numeric
    start_quaternion: Numeric
    turned: Scalar | None = None

    def twist(self, motions: Motions) -> Twist:
        """Angle, rate and direction of the second body's turn against the first.

        Limits: at a tilt of pi of the two bodies' axes there is no angle; values and derivatives stay finite.
        """
        first, second = (motions[body] for body in self.bodies)
        axis = jnp.asarray(self.axis)
        c, q = self._relative(motions)
        s = axis @ q
        square = c * c + s * s
        defined = square > SMALLEST_TWIST_SQUARE
        angle = 2.0 * jnp.arctan2(jnp.where(defined, s, 0.0), jnp.where(defined, c, 1.0))
        if self.turned is not None:
            angle = continued(angle, self.turned)
        g = (c * c * axis + c * jnp.cross(q, axis) + s * q) / jnp.where(defined, square, SMALLEST_TWIST_SQUARE)
        direction = first.rotation @ g
        return Twist(angle, direction @ (second.angular_velocity - first.angular_velocity), direction)

    def turned_rate(self, motions: Motions) -> Scalar:
        """Rate of `turned` [rad/s]."""
        assert self.turned is not None
        angle, rate, _ = self.twist(motions)
        return rate + jnp.abs(rate) * (angle - self.turned) / (2.0 * np.pi)

    def tilt_share(self, motions: Motions) -> Scalar:
        """How far the axes are tilted against each other: above 1 beyond `LARGEST_TILT`."""
        c, q = self._relative(motions)
        s = jnp.asarray(self.axis) @ q
        return _SQUARE_AT_LARGEST_TILT / jnp.maximum(c * c + s * s, SMALLEST_TWIST_SQUARE)

    def _relative(self, motions: Motions) -> tuple[Scalar, Vector3]:
        """(c, q): the second body's turn against the first since the start, in the first body's axes."""
        first, second = (motions[body] for body in self.bodies)
        now = quaternion_product(conjugate(first.quaternion), second.quaternion)
        relative = quaternion_product(now, conjugate(jnp.asarray(self.start_quaternion)))
        return relative[0], relative[1:]


def continued(angle: Scalar, turned: Scalar) -> Scalar:
    """The angle through any number of turns [rad], from the one within a turn and the one that was integrated."""
    turn = 2.0 * np.pi
    # The count is held still under derivatives: it is a whole number, and so is its derivative zero.
    return angle + turn * jnp.round((turned - angle) / turn)


def attached(bodies: Mapping[str, Body], names: tuple[str, str], axis: Numeric) -> TorsionalAttachment:
    """An axis, world axes at the start, and the two bodies' orientations as geometry in body axes."""
    first, second = (start_quaternion(bodies, name) for name in names)
    return TorsionalAttachment(names, concretely(direction_on, axis, first), concretely(_start_of, first, second))


def _start_of(first, second):
    return quaternion_product(conjugate(normalized(first)), normalized(second))


# The memory of turns ------------------------------------------------------------------------------------------------


def attachments_of(part: Any) -> list[TorsionalAttachment]:
    """All axes about which a placed element has an angle, in the order of its fields."""
    return [leaf for leaf in jax.tree.leaves(part, is_leaf=_is_attachment) if _is_attachment(leaf)]


def turn_entries(part: Any) -> tuple[MemoryEntry, ...]:
    """State entries for the angles of an element, one for each axis: `turned`, or `turned_1`, ... (static)."""
    n = len(attachments_of(part))
    names = ["turned"] if n == 1 else [f"turned_{i + 1}" for i in range(n)]
    return tuple(MemoryEntry(name, "rad", "angle", counts_turns=True) for name in names)


def with_turns(part: Any, turned: Float[Array, " n"]) -> Any:
    """The element with its integrated angles [rad], in the order of `attachments_of`.

    Without any it is the element itself, whose angles are within a turn of the start: a position of rest, which has no
    states of elements, knows of no others.
    """
    if not turned.shape[0]:
        return part
    numbers = iter(range(turned.shape[0]))

    def counted(leaf):
        return eqx.tree_at(lambda at: at.turned, leaf, turned[next(numbers)], is_leaf=lambda x: x is None)

    return jax.tree.map(lambda leaf: counted(leaf) if _is_attachment(leaf) else leaf, part, is_leaf=_is_attachment)


def turns_at_start(part: Any, motions: Motions) -> list[Scalar]:
    """The angles with which a motion begins [rad]: those of the orientations."""
    return [attachment.twist(motions).angle for attachment in attachments_of(part)]


def turn_rates(part: Any, motions: Motions) -> list[Scalar]:
    """Rates of the entries `turned` [rad/s], of an element that has its turns."""
    return [attachment.turned_rate(motions) for attachment in attachments_of(part)]


def turn_doubts(part: Any, motions: Motions) -> list[Scalar]:
    """Error of each integrated angle, as a share of `LARGEST_DOUBT`; from 1 on the number of turns N is in doubt."""
    attachments = attachments_of(part)
    return [
        jnp.abs(one.twist(motions).angle - one.turned) / LARGEST_DOUBT for one in attachments if one.turned is not None
    ]


def _is_attachment(leaf: Any) -> bool:
    return isinstance(leaf, TorsionalAttachment)

"""Alike instants of contact as one: a joint that rests for a million steps of a run wears like one that rests for one.

Instants are alike whose patches lie at the same place of both bodies within a share of their width, and carry the same
force within some percent. One of them stands for all, for as long as gives the same rubbing work. So what a study costs
follows from how far patches travel, and not from how many steps the motion took.
"""

import numpy as np
from jaxtyping import Float

from spherejax.physics.laws.wear import WearContact

PLACE = 0.125
"""Side of a bin, on the socket and on the ball, as a share of half the patch's width."""

TWIST = 0.25
"""Side of a bin of the entries of the rotation matrix: how far a patch may turn about its middle [rad]."""

WAY = 0.5
"""Side of a bin of the entries of t t^T, t the direction of sliding, where the place on the ball does not count."""

FORCE = 1.15
"""Ratio of the largest to the smallest force of a bin; the width of a Hertzian patch differs by 5 %."""

SPIN_ARM = 8 / 15
"""Mean distance from the axis at which a parabolic pressure rubs, as a share of half the patch's width."""


def power(contact: WearContact, half_angle: Float[np.ndarray, " m"], radius: float) -> Float[np.ndarray, " m"]:
    """F_n times a mean sliding speed of the patch [W]: in its middle, and by the spin about the contact's direction.

    sqrt(|v|^2 + (8/15 w_n a)^2) is right for each alone, and within 2 % where both act.
    """
    n = np.asarray(contact.direction)
    middle = middle_sliding(contact, radius)
    spin = np.sum(np.asarray(contact.spin) * n, axis=-1)
    return np.asarray(contact.force) * np.hypot(np.linalg.norm(middle, axis=-1), SPIN_ARM * radius * half_angle * spin)


def middle_sliding(contact: WearContact, radius: float) -> Float[np.ndarray, "m 3"]:
    """Sliding velocity in the middle of each patch [m/s]."""
    n = np.asarray(contact.direction)
    v = np.asarray(contact.velocity) + np.cross(np.asarray(contact.spin), radius * n)
    return v - np.sum(v * n, axis=-1, keepdims=True) * n


def gathered(
    contact: WearContact,
    half_angle: Float[np.ndarray, " m"],
    duration: Float[np.ndarray, " m"],
    radius: float,
    times: float = 1.0,
    ball_counts: bool = True,
) -> tuple[WearContact, np.ndarray, np.ndarray]:
    """Contacts, half angles and durations with one row for alike ones.

    Args:
        contact: with a leading axis.
        half_angle: of their patches on unworn surfaces [rad].
        duration: [s].
        radius: R of the socket [m].
        times: how much wider than usual the bins are.
        ball_counts: whether it matters where on the ball a patch lies: not on a round one that does not wear. A ball
            that turns under a load then has one patch, and not one for each place on its way around.
    """
    work = power(contact, half_angle, radius) * duration
    own = np.flatnonzero(work > 0)
    if not own.size:
        return contact, half_angle, np.zeros_like(duration)
    force = np.log(np.asarray(contact.force)[own]) / (times * np.log(FORCE))
    # All of one level of force have bins of one size, whatever the few percent by which their patches differ.
    size = times * PLACE * FORCE ** np.floor(np.log(half_angle[own]) / np.log(FORCE))
    n, turned = np.asarray(contact.direction)[own], np.asarray(contact.turned)[own]
    if ball_counts:
        place = np.concatenate([n, np.einsum("mij,mi->mj", turned, n)], axis=1) / size[:, None]
        twist = turned.reshape(own.size, 9) / (times * TWIST)
    else:
        place = n / size[:, None]
        v = middle_sliding(WearContact(*(np.asarray(x)[own] for x in contact)), radius)
        t = v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), np.finfo(float).tiny)
        twist = np.einsum("mi,mj->mij", t, t).reshape(own.size, 9) / (times * WAY)
    key = np.concatenate(
        [np.floor(force)[:, None], np.log(size)[:, None].round(6), np.floor(place), np.floor(twist)], axis=1
    )
    _, group = np.unique(key, axis=0, return_inverse=True)
    group = group.ravel()
    total = np.bincount(group, weights=work[own])
    # The one nearest to the middle of its group by force and place stands for it.
    off = np.zeros(own.size)
    for column in (force, *place.T):
        mean = np.bincount(group, weights=work[own] * column) / total
        off += (column - mean[group]) ** 2
    order = np.lexsort((off, group))
    first = own[order[np.unique(group[order], return_index=True)[1]]]
    chosen = WearContact(*(np.asarray(x)[first] for x in contact))
    return chosen, half_angle[first], total / (work[first] / duration[first])

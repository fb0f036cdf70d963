"""From maps of depth to the gap that a motion feels: smooth profiles of both surfaces, by harmonics.

What a motion feels of a worn surface is how much farther the ball goes in each direction under its load, and not how
deep the surface is just there: in a pocket that fits the ball, the ball is stopped by the walls. So the profile is
fitted to the approach s of the foundation on the maps,

    g(n) = s(n; F, h) - s(n; F, 0),

at all contacts of a cycle with their own loads, and, with a small weight, at directions all over each of both surfaces
with the mean load of the cycle, where no contact says anything. A surface that is worn the same everywhere has its own
depth.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.physics.laws.wear import WearContact
from spherejax.studies.wear.deposit import Maps, Told, rubbed
from spherejax.studies.wear.rubbing import RubbingCycle

ELSEWHERE = 0.05
"""Weight of all directions beside that of the contacts: the fit follows the contacts, and stays smooth between them."""


class Profiles(NamedTuple):
    """Coefficients of the depths of socket and ball that a motion feels [m].

    They are those of a `HarmonicDepth`, or of a journal's `FourierDepth`.

    Attributes:
        socket: None for a socket that stays round.
        ball: None for a ball that stays round.
    """

    socket: Float[np.ndarray, " k"] | None
    ball: Float[np.ndarray, " k"] | None


def fitted(cycle: RubbingCycle, depth: Maps, told: Told, degree: int) -> Profiles:
    """The profiles of surfaces that are worn.

    Args:
        cycle: its contacts say where and how loaded the surfaces meet.
        depth: of the wear [m].
        told: of the contacts on surfaces worn that deep.
        degree: L of the harmonics.
    """
    harmonics = cycle.chart.harmonics
    worn = Maps(cycle.shape.socket + depth.socket, cycle.shape.ball + depth.ball)
    sides = [bool(jnp.any(each != 0)) for each in worn]
    directions = _directions(cycle)
    rows = [np.concatenate([harmonics(directions[k], degree) for k in (0, 1) if sides[k]], 1)]
    targets, weights = [gone(cycle, told)], [_weights(cycle, told)]
    u, share = cycle.chart.grid(degree)
    all_over, k = harmonics(u, degree), sum(sides)
    size = all_over.shape[1]
    column = 0
    for side, there in enumerate(sides):
        if not there:
            continue
        block = np.zeros((len(u), k * size))
        block[:, column * size : (column + 1) * size] = all_over
        column += 1
        rows.append(block)
        targets.append(_reach(cycle, worn, side, u))
        weights.append(ELSEWHERE * share)
    root = np.sqrt(np.concatenate(weights))
    matrix, target = np.concatenate(rows), np.concatenate(targets)
    found = np.linalg.lstsq(root[:, None] * matrix, root * target, rcond=None)[0]
    parts = iter(np.split(found, k))
    return Profiles(*(next(parts) if there else None for there in sides))


def misfit(cycle: RubbingCycle, told: Told, profiles: Profiles) -> float:
    """Root mean square over the contacts, by their rubbing work, of how much farther the ball goes on the maps than on
    the profiles [m]."""
    felt = np.zeros(len(told.power))
    for u, coefficients in zip(_directions(cycle), profiles, strict=True):
        if coefficients is not None:
            felt = felt + cycle.chart.harmonics(u, cycle.chart.degree_of(coefficients)) @ coefficients
    return float(np.sqrt(_weights(cycle, told) @ (gone(cycle, told) - felt) ** 2))


def gone(cycle: RubbingCycle, told: Told) -> Float[np.ndarray, " m"]:
    """How much farther the ball goes in each contact than between round surfaces, for the same load [m]."""
    contact, geometry = cycle.contacts.contact, cycle.geometry
    force, stiffness = jnp.asarray(contact.force), jnp.asarray(contact.stiffness)
    return told.approach - np.asarray(cycle.chart.depth(force, geometry.clearance, geometry, stiffness))


def _weights(cycle: RubbingCycle, told: Told) -> Float[np.ndarray, " m"]:
    """Shares of the contacts in the rubbing work."""
    work = told.power * cycle.contacts.duration
    return work / work.sum()


def _directions(cycle: RubbingCycle) -> tuple[np.ndarray, np.ndarray]:
    """Of the contacts, in the axes of socket and ball."""
    contact = cycle.contacts.contact
    n = np.asarray(contact.direction)
    return n, np.einsum("mij,mi->mj", np.asarray(contact.turned), n)


def _reach(cycle: RubbingCycle, worn: Maps, side: int, u: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, " q"]:
    """How much farther the ball goes in each direction for the wear of one side alone, under the cycle's mean load."""
    contact, duration = cycle.contacts.contact, cycle.contacts.duration
    impulse = np.asarray(contact.force) * duration
    force = float(impulse @ np.asarray(contact.force) / impulse.sum())
    stiffness = float(impulse @ np.asarray(contact.stiffness) / impulse.sum())
    q, still = len(u), np.zeros_like(u)
    same = np.broadcast_to(np.eye(3), (q, 3, 3))
    loads = WearContact(np.full(q, force), u, still, still, same, np.full(q, stiffness), still)
    own = Maps(*(each if k == side else jnp.zeros_like(each) for k, each in enumerate(worn)))
    approach = rubbed(own, loads, np.zeros(q), cycle.geometry, cycle.chart)[1].approach
    geometry = cycle.geometry
    return approach - float(cycle.chart.depth(jnp.asarray(force), geometry.clearance, geometry, stiffness))

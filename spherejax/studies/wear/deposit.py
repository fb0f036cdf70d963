"""What contacts rub off: pressure and sliding on worn surfaces, shared out to the maps of both bodies.

Each contact is looked at in points of its patch, on rings about its direction. Their shares of the rubbing work,
p |v_s| dA dt, go to the cells around them, four on a ball and two on a journal, in the socket's map and in the ball's.
So nothing is lost, whether a patch covers half the surface or less than a cell; how well a map resolves a patch is
another question, and is answered.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Numeric, Scalar
from spherejax.physics.laws.wear import WearContact, approach, surface_sliding
from spherejax.program_cache import cached_jit
from spherejax.studies.wear.charts import AbstractChart, Joint, PatchPoints, chart_of

SEARCH_RINGS, SEARCH_PASSES = 8, 2
"""Rings on which the edge of a patch on worn surfaces is looked for, each time within what was found before."""

HEMISPHERE = 0.98
"""1 - cos of the widest patch: almost a right angle."""

AT_ONCE = 32
"""Contacts in one go: enough to keep the processor busy, few enough for its memory."""

FEW = 4
"""Up to so many contacts go as so many: a ball that turns under a constant load has one."""


class Maps(NamedTuple):
    """Two maps, flat: the socket's and the ball's, or the bearing's and the journal's, each in the axes of its body."""

    socket: Float[Array, " n"]
    ball: Float[Array, " n"]


class Told(NamedTuple):
    """What is told of each contact.

    Attributes:
        power: integral of p |v_s| dA over the patch [W].
        approach: s - c, how far beyond the clearance the ball's center has come to carry the force [m].
        balance: resultant along n over the force, less 1.
        aside: by how much the resultant across n differs from that of the run, over the force: on worn surfaces it is
            not balanced.
        radius: root mean square angle of the pressure from the contact's direction, times sqrt 2 [rad].
    """

    power: Numeric
    approach: Numeric
    balance: Numeric
    aside: Numeric
    radius: Numeric


def rubbed(
    wear: Maps, contacts: WearContact, durations: np.ndarray, joint: Joint, chart: AbstractChart
) -> tuple[Maps, Told]:
    """Rubbing work of contacts on worn surfaces [J], by cell.

    Args:
        wear: depths [m].
        contacts: with a leading axis.
        durations: how long each of them acts [s].
        joint: its geometry.
        chart: of the maps.

    Returns:
        The work in each cell of both maps, and what is told of each contact.
    """
    m = len(durations)
    is_worn = any(bool(jnp.any(each != 0)) for each in wear)
    rises = np.asarray(_edges(chart.is_ball, chart.n, is_worn, wear, _padded(contacts, durations)[0], joint))[:m]
    widths = np.arccos(1 - rises)
    enough = np.searchsorted(chart.rings, chart.rings_per_cell * widths / chart.cell_width)
    rings = np.array(chart.rings)[np.minimum(enough, len(chart.rings) - 1)]
    work, told = Maps(jnp.zeros(chart.size), jnp.zeros(chart.size)), Told(*np.zeros((5, m)))
    for count in np.unique(rings):
        own = np.flatnonzero(rings == count)
        chosen, lasting = _padded(jax.tree.map(lambda x, at=own: np.asarray(x)[at], contacts), durations[own])
        wide = np.concatenate([rises[own], np.full(len(lasting) - len(own), rises[own][-1])])
        kind = chart.is_ball, chart.n, int(count)
        work, seen = _shared_out(*kind, work, wear, chosen, jnp.asarray(lasting), jnp.asarray(wide), joint)
        for column, values in zip(told, seen, strict=True):
            column[own] = np.asarray(values)[: len(own)]
    return work, told


def _padded(contacts: WearContact, durations: np.ndarray) -> tuple[WearContact, np.ndarray]:
    """To as many as a power of two, for few different programs; what is added lasts no time."""
    m = len(durations)
    more = max(FEW if m <= FEW else AT_ONCE, 1 << int(np.ceil(np.log2(m)))) - m
    last = np.minimum(np.arange(m + more), m - 1)
    return jax.tree.map(lambda x: jnp.asarray(np.asarray(x)[last]), contacts), np.pad(durations, (0, more))


# One contact ----------------------------------------------------------------------------------------------------------


def _gap(
    chart: AbstractChart, wear: Maps, points: PatchPoints, contact: WearContact, joint: Joint
) -> Float[Array, " q"]:
    """c (1 - n.u) + h_i + h_j at points [m]: of the ball that touches its unworn socket."""
    on_ball = points.u @ contact.turned
    return joint.clearance * points.fall + chart.sampled(wear.socket, points.u) + chart.sampled(wear.ball, on_ball)


def _edge(
    chart: AbstractChart,
    passes: int,
    wear: Maps,
    extremes: tuple[Scalar, Scalar],
    contact: WearContact,
    joint: Joint,
) -> Scalar:
    """1 - cos of the angle at which the patch ends; on worn surfaces, of one that contains it."""
    # No closer can the ball be than where the deepest wear is everywhere, and nowhere is less worn than the least.
    least, deepest = extremes
    gap = joint.clearance + deepest
    depth = chart.depth(contact.force, gap, joint, contact.stiffness)
    rise = jnp.minimum((deepest - least + depth) / (gap + depth), HEMISPHERE)
    rho = np.concatenate([chart.nodes(SEARCH_RINGS)[0], [1.0]])
    for _ in range(passes):
        points = chart.points(contact.direction, rise, SEARCH_RINGS)
        gap = _gap(chart, wear, points, contact, joint)
        s = approach(points.x, gap, points.shares * joint.area, contact.force, contact.stiffness)
        outermost = jnp.max(jnp.where(s * points.x > gap, points.ring, 0))
        rise = rise * jnp.asarray(rho)[outermost + 1] ** 2
    return rise


def _rubbing(chart: AbstractChart, rings: int, wear: Maps, contact: WearContact, rise: Scalar, joint: Joint):
    """Power of each point of a patch [W], cells and shares in both maps, and what is told."""
    points = chart.points(contact.direction, rise, rings)
    gap = _gap(chart, wear, points, contact, joint)
    areas = points.shares * joint.area
    s = approach(points.x, gap, areas, contact.force, contact.stiffness)
    load = contact.stiffness * jnp.maximum(s * points.x - gap, 0.0) * areas
    speed = jax.vmap(safe_norm)(surface_sliding(points.u, contact, joint.radius))
    resultant = load @ points.u
    along = resultant @ contact.direction
    aside = safe_norm(resultant - along * contact.direction - contact.force * contact.across)
    square = jnp.sum(load * points.fall * (1 + points.x)) / jnp.sum(load)
    told = Told(load @ speed, s, along / contact.force - 1, aside / contact.force, jnp.sqrt(2 * square))
    return load * speed, chart.corners(points.u), chart.corners(points.u @ contact.turned), told


# All of them ----------------------------------------------------------------------------------------------------------


@cached_jit(what="the edges of patches")
def _edges(is_ball: bool, n: int, is_worn: bool, wear: Maps, contacts: WearContact, joint: Joint):
    extremes = jnp.min(wear.socket) + jnp.min(wear.ball), jnp.max(wear.socket) + jnp.max(wear.ball)
    chart, passes = chart_of(is_ball, n), SEARCH_PASSES if is_worn else 0
    return jax.lax.map(lambda one: _edge(chart, passes, wear, extremes, one, joint), contacts, batch_size=AT_ONCE)


@cached_jit(what="the wear of a run")
def _shared_out(
    is_ball: bool, n: int, rings: int, work: Maps, wear: Maps, contacts: WearContact, durations, rises, joint: Joint
):
    chart = chart_of(is_ball, n)

    def some(work: Maps, chunk):
        contact, lasting, rise = chunk
        power, on_socket, on_ball, told = jax.vmap(lambda c, r: _rubbing(chart, rings, wear, c, r, joint))(
            contact, rise
        )
        done = power * lasting[:, None]

        def added(to, cells, shares):
            return to.at[cells.ravel()].add((done[..., None] * shares).ravel())

        return Maps(added(work.socket, *on_socket), added(work.ball, *on_ball)), told

    at_once = min(AT_ONCE, len(durations))
    chunked = jax.tree.map(lambda x: x.reshape(-1, at_once, *x.shape[1:]), (contacts, durations, rises))
    work, told = jax.lax.scan(some, work, chunked)
    return work, jax.tree.map(lambda x: x.reshape(-1), told)

"""The contacts of a run, instant by instant, for its wear: seen inside the steps that the integrator made.

A run ends its steps at onsets and releases, so between two ends everything is smooth, and Gauss and Legendre's rule in
each step integrates impacts of microseconds as well as minutes of rest. Where a patch travels far within one step, the
step is cut into parts, and the states there are interpolated: otherwise its track would be a row of dots.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Numeric, Scalar
from spherejax.model.system import System
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.loads import joint_loads
from spherejax.motion.results.steps import SHARE_WEIGHTS, SHARES, Steps, seen_at
from spherejax.physics.joints.contact import direction_of, surface_contact
from spherejax.physics.laws.wear import WearContact
from spherejax.physics.state import unpack
from spherejax.studies.wear.charts import AbstractChart, Joint
from spherejax.studies.wear.gathering import gathered, middle_sliding, power

SPACING = 0.25
"""How far a patch may travel from one instant to the next, as a share of half its width: sums over parabolas that
overlap by that much are even to 1 %."""

MOST_PARTS = 4096
"""Of one step."""

COARSER = 2.0
"""How much wider the bins are in which alike instants are gathered a second time."""

CREEPING = 1e-8
"""Mean speed of sliding [m/s] below which the error of the rubbing work is related to this speed, not to the work: the
rounding of a joint at rest is no error to speak of."""

_NODES = np.array([0.0, *SHARES])
"""Of the polynomial through a step: its beginning, with what the events there changed, and its inside. The end belongs
to what comes after the events there."""


_MIDDLE = (2 * SHARES[2] - 1) ** 2
_END_WEIGHT = (1 / 3 - _MIDDLE) / (1 - _MIDDLE) / 2
"""Of each end of a step in the rule of degree 3 with the two middle ones of `SHARES`."""


class _Seen(NamedTuple):
    """A joint at one instant; vectors in the axes of the socket's body, or of a journal's bearing with z along it."""

    force: Numeric
    penetration: Numeric
    direction: Numeric
    velocity: Numeric
    spin: Numeric
    turned: Numeric
    travel: Numeric
    across: Numeric


class ContactInstants(NamedTuple):
    """The instants of contact, alike ones gathered, with a leading axis.

    Attributes:
        contact: force, place, motion and foundation.
        half_angle: of the patch on unworn surfaces [rad].
        duration: weight of the instant in integrals over time [s].
        coarser: contacts and durations, gathered more coarsely, to compare with.
        slid: integral of F_n |v_s| at the contacts' middles [J].
        expected: the same with the spin of the patches, of all instants [J].
        looked_at: how many instants of contact there were, before alike ones were gathered.
        error: of the rubbing work by the integration over time, as a share; an estimate that is rather too large.
        span: beginning and end of what was looked at [s].
        impulse: integral of the normal force, of all instants [N s]; durations of gathered ones are those of work.
    """

    contact: WearContact
    half_angle: Float[np.ndarray, " m"]
    duration: Float[np.ndarray, " m"]
    coarser: tuple[WearContact, np.ndarray]
    slid: float
    expected: float
    looked_at: int
    error: float
    span: tuple[float, float]
    impulse: float = 0.0


@lru_cache(maxsize=64)
def _seen_of(joint: str):
    """One function for the same joint: programs are kept by function."""

    def see(system: System, t: Scalar, y: Float[Array, " size"]) -> _Seen:
        state = unpack(system.layout, y)
        motions = body_motions(system, state)
        parts = joint_loads(system, motions, state.memory)[joint].response.parts
        placed = system.spherical(joint)
        model: Any = placed.model
        motion = placed.relative_motion(motions)
        socket, ball = motion.socket_rotation, motion.ball_rotation
        assert ball is not None
        e, n = motion.eccentricity, direction_of(motion.eccentricity)
        n_rate = (motion.eccentricity_rate - (motion.eccentricity_rate @ n) * n) / jnp.maximum(safe_norm(e), 1e-300)
        over = [n_rate - jnp.cross(w, n) for w in (motion.socket_angular_velocity, motion.ball_angular_velocity)]
        force, across = parts["normal_force"], jnp.zeros(3)
        if not model.surfaces.are_round:
            normal = surface_contact(motion, model.surfaces).normal
            along = normal @ n
            force, across = force * along, socket.T @ (normal / jnp.where(along > 0, along, 1.0) - n)
        return _Seen(
            force,
            model.penetration(motion),
            socket.T @ n,
            socket.T @ (motion.eccentricity_rate - jnp.cross(motion.ball_angular_velocity, e)),
            socket.T @ (motion.ball_angular_velocity - motion.socket_angular_velocity),
            socket.T @ ball,
            jnp.maximum(safe_norm(over[0]), safe_norm(over[1])),
            across,
        )

    return see


def contacts_of(
    system: System,
    steps: Steps,
    joint: str,
    window: tuple[float, float] | None,
    scalar: bool | None,
    surface: tuple[type[AbstractChart], Joint],
    foundation: float | None,
    ball_counts: bool = True,
) -> ContactInstants:
    """The contacts of a joint.

    Args:
        system: what was run.
        steps: of the run.
        joint: name of a joint with contact.
        window: first and last instant [s]; None for the whole run.
        scalar: whether the run was on scalar programs.
        surface: the kind of its maps, and its geometry.
        foundation: its stiffness [N/m^3]; None: as stiff as makes each patch as wide as Hertz's.
        ball_counts: whether it matters where on the ball a patch lies.

    Raises:
        SceneError: for a patch that travels too far in one step.
    """
    begins = np.concatenate([[steps.t0], steps.ends[:-1]])
    window = (steps.t0, float(steps.ends[-1])) if window is None else window
    own = np.flatnonzero((steps.ends > window[0]) & (begins < window[1]))
    see, press = _seen_of(joint), _Pressing(system.spherical(joint).model, *surface, foundation)
    first = _look(system, see, steps.inside[own], steps.at_inside[own], scalar)
    weights = _weights_within(begins[own], steps.lengths[own], window)

    def rubbing(seen: _Seen) -> np.ndarray:
        return press.power(seen)

    rough = np.sum(weights * rubbing(first), axis=1)
    missed = _missed(steps, own, rubbing(first), lambda ts, ys: rubbing(_look(system, see, ts, ys, scalar)))
    parts = _parts(steps.lengths[own], first, press.patches(first)[1])
    at_begin = np.concatenate([steps.y0[None], steps.at_ends[:-1]])[own]
    known = np.concatenate([at_begin[:, None], steps.at_inside[own]], axis=1)
    pieces = []
    for n in np.unique(parts):
        chosen = np.flatnonzero(parts == n)
        if n == 1:
            pieces.append((chosen, jax.tree.map(lambda x, at=chosen: x[at], first), weights[chosen]))
            continue
        shares = (np.arange(n)[:, None] + np.array(SHARES)).ravel() / n
        states = np.einsum("ij,sjk->sik", _lagrange(shares), known[chosen])
        times = begins[own][chosen, None] + shares * steps.lengths[own][chosen, None]
        seen = _look(system, see, times, states, scalar)
        lengths = np.repeat(steps.lengths[own][chosen, None] / n, n, axis=1)
        starts = begins[own][chosen, None] + lengths * np.arange(n)
        cut = _weights_within(starts.ravel(), lengths.ravel(), window).reshape(len(chosen), -1)
        pieces.append((chosen, seen, cut))
    return _gathered(press, pieces, (rough, missed), window, ball_counts)


def _look(system: System, see, ts: np.ndarray, ys: np.ndarray, scalar: bool | None) -> _Seen:
    """At states with two leading axes: steps and instants inside."""
    m, k = ts.shape
    seen = seen_at(system, see, ts.ravel(), ys.reshape(m * k, -1), scalar)
    return _Seen(*(x.reshape(m, k, *x.shape[1:]) for x in seen))


def _lagrange(shares: np.ndarray) -> np.ndarray:
    """Weights of `_NODES` at shares of a step, shape (len(shares), 5)."""
    columns = []
    for node in _NODES:
        others = _NODES[node != _NODES]
        columns.append(np.prod((shares[:, None] - others) / (node - others), axis=1))
    return np.stack(columns, axis=1)


def _weights_within(begins, lengths, window: tuple[float, float]) -> np.ndarray:
    """Duration of each of the inner instants [s], shape (n, 4); of steps that the window cuts, what is within."""
    full = np.asarray(SHARE_WEIGHTS)[None] * lengths[:, None]
    low = np.clip((window[0] - begins) / lengths, 0.0, 1.0)
    high = np.clip((window[1] - begins) / lengths, 0.0, 1.0)
    cut = np.flatnonzero((low > 0) | (high < 1))
    powers = np.arange(len(SHARES))
    inverse = np.linalg.inv(np.array(SHARES)[None] ** powers[:, None])
    for i in cut:
        moments = (high[i] ** (powers + 1) - low[i] ** (powers + 1)) / (powers + 1)
        share = np.maximum(inverse @ moments, 0.0)
        full[i] = share * ((high[i] - low[i]) / max(share.sum(), 1e-300)) * lengths[i]
    return full


class _Pressing(NamedTuple):
    """How the surfaces of a joint press on each other.

    Attributes:
        model: of the joint.
        kind: of its maps.
        geometry: of the joint.
        foundation: its stiffness [N/m^3]; None: as stiff as makes each patch as wide as that of the contact.
    """

    model: Any
    kind: type[AbstractChart]
    geometry: Joint
    foundation: float | None

    def patches(self, seen: _Seen) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness of the foundation [N/m^3], half angle of the patch on unworn surfaces [rad], 0 without contact."""
        clearance = float(self.geometry.clearance)
        presses = (np.asarray(seen.force) > 0) & (np.asarray(seen.penetration) > 0)
        force, depth = np.where(presses, seen.force, 1.0), np.where(presses, seen.penetration, 1.0)
        if self.foundation is None:
            yields = np.asarray(self.kind.matched_depth(self.model, force, depth))
            stiffness = np.asarray(force / self.kind.force(yields, self.geometry, 1.0))
        else:
            stiffness = np.full(force.shape, self.foundation)
            yields = np.asarray(self.kind.depth(force, clearance, self.geometry, self.foundation))
        return stiffness, np.where(presses, np.arccos(clearance / (clearance + yields)), 0.0)

    def power(self, seen: _Seen) -> np.ndarray:
        """Rubbing power of each contact, in short; see `gathering.power` [W]."""
        _, half_angle = self.patches(seen)
        radius = float(self.geometry.radius)
        return np.where(half_angle > 0, power(_as_contact(seen, seen.force), half_angle, radius), 0.0)


def _parts(lengths: np.ndarray, seen: _Seen, half_angles: np.ndarray) -> np.ndarray:
    """Into how many parts each step is cut: powers of two, for few different programs."""
    widest = half_angles.max(axis=1)
    angle = np.where(widest > 0, lengths * np.asarray(seen.travel).max(axis=1), 0.0)
    needed = angle / (len(SHARES) * SPACING * np.where(widest > 0, widest, 1.0))
    parts = 2 ** np.ceil(np.log2(np.maximum(needed, 1.0))).astype(int)
    if parts.max(initial=1) > MOST_PARTS:
        raise SceneError(
            f"within one step of the run a patch of contact travels {angle[np.argmax(parts)]:.3g} rad over a surface, "
            f"and is {widest[np.argmax(parts)]:.3g} rad wide: too far to be followed. Simulate with a smaller rtol"
        )
    return parts


def _as_contact(seen: _Seen, stiffness) -> WearContact:
    return WearContact(seen.force, seen.direction, seen.velocity, seen.spin, seen.turned, stiffness, seen.across)


def _missed(steps: Steps, own: np.ndarray, rubbing: np.ndarray, see) -> np.ndarray:
    """By how much a rule of half the order, with the ends and the two middle instants, differs in each step [J]."""
    ts, ys = np.concatenate([[steps.t0], steps.ends]), np.concatenate([steps.y0[None], steps.at_ends])
    at_ends = see(ts[None], ys[None])[0]
    ends, middle = at_ends[own] + at_ends[own + 1], rubbing[:, 1] + rubbing[:, 2]
    coarse = _END_WEIGHT * ends + (0.5 - _END_WEIGHT) * middle
    return np.abs(steps.lengths[own] * (coarse - rubbing @ np.asarray(SHARE_WEIGHTS)))


def _gathered(press: _Pressing, pieces, told, window, ball_counts) -> ContactInstants:
    """One row for each instant at which ball and socket press on each other."""
    rough, missed = told
    fine = np.zeros(len(rough))
    columns, stiffnesses, half_angles, durations = [], [], [], []
    for chosen, seen, weights in pieces:
        fine[chosen] = np.sum(weights * press.power(seen), axis=1)
        stiffness, half_angle = press.patches(seen)
        pressing = (half_angle > 0) & (weights > 0)
        columns.append(_Seen(*(np.asarray(x)[pressing] for x in seen)))
        stiffnesses.append(stiffness[pressing])
        half_angles.append(half_angle[pressing])
        durations.append(weights[pressing])
    all_seen = _Seen(*(np.concatenate(each) for each in zip(*columns, strict=True)))
    contact, duration = _as_contact(all_seen, np.concatenate(stiffnesses)), np.concatenate(durations)
    radius = float(press.geometry.radius)
    slid = np.linalg.norm(middle_sliding(contact, radius), axis=-1) @ (all_seen.force * duration)
    # Of steps that were cut into parts, what the parts tell otherwise.
    missed = np.where(fine == rough, missed, np.abs(fine - rough))
    scale = max(float(fine.sum()), CREEPING * float(np.asarray(all_seen.force) @ duration))
    error = float(missed.sum()) / scale if scale > 0 else 0.0
    angles = np.concatenate(half_angles)
    expected = float(power(contact, angles, radius) @ duration)
    rows = gathered(contact, angles, duration, radius, 1.0, ball_counts)
    coarser, _, lasting = gathered(contact, angles, duration, radius, COARSER, ball_counts)
    impulse = float(all_seen.force @ duration)
    return ContactInstants(*rows, (coarser, lasting), float(slid), expected, len(duration), error, window, impulse)

"""Contacts of a joint one by one, and peaks: what lies between the samples of a run."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Scalar, Vector3
from spherejax.model.system import System
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.loads import joint_loads
from spherejax.motion.equations.quantities import magnitudes
from spherejax.motion.results.steps import SHARE_WEIGHTS, SHARES, Steps, seen_at
from spherejax.physics.joints.contact import direction_of, sliding_velocity
from spherejax.physics.state import unpack

COLUMNS = {
    "onset": ("s", "when contact begins; the start of the run for a ball that touches there"),
    "release": ("s", "when it ends; NaN where the run ends first"),
    "approach_speed": ("m/s", "normal velocity at the onset"),
    "sliding_speed": ("m/s", "tangential velocity of the surfaces at the onset"),
    "peak_force": ("N", "largest force on the ball"),
    "peak_penetration": ("m", "largest |e| - c"),
    "impulse": ("N s", "of the force on the ball, world axes"),
    "energy_lost": ("J", "absorbed by the joint, less what it stores"),
    "place": (
        "1",
        "unit vector from the socket's center to the contact at the onset, axes of the socket's body",
    ),
}
"""What is told of each contact: unit, and what it is."""


class _Touch(NamedTuple):
    """A joint at one instant."""

    onset_rate: Scalar
    force: Vector3
    penetration: Scalar
    absorbed_power: Scalar
    elastic_energy: Scalar
    sliding: Vector3
    place: Vector3


@lru_cache(maxsize=64)
def _touch_of(joint: str):
    """One function for the same joint: programs are kept by function."""

    def touch(system: System, t: Scalar, y: Float[Array, " size"]) -> _Touch:
        state = unpack(system.layout, y)
        motions = body_motions(system, state)
        load = joint_loads(system, motions, state.memory)[joint]
        placed = system.spherical(joint)
        motion = placed.relative_motion(motions)
        model: Any = placed.model
        return _Touch(
            state.memory[system.memory_of(joint)][0],
            load.response.force,
            model.penetration(motion),
            load.absorbed_power,
            load.response.elastic_energy,
            sliding_velocity(motion, model.surfaces),
            motion.socket_rotation.T @ direction_of(motion.eccentricity),
        )

    return touch


def impacts(system: System, steps: Steps, joint: str, scalar: bool | None) -> dict[str, np.ndarray]:
    """Every contact of a joint, in the order of their onsets: `COLUMNS` as arrays with a leading axis of contacts.

    Args:
        system: what was run.
        steps: of the run.
        joint: name of a joint with clearance.
        scalar: whether the run was on scalar programs.

    Integrals are by Gauss and Legendre's rule in each step, peaks the largest of four instants inside each step and
    its end, refined by a polynomial within the step.
    """
    if joint not in system.contact_joints:
        known = ", ".join(map(repr, system.contact_joints)) or "none"
        raise SceneError(f"joint {joint!r} has no contact whose onsets are located; those that have: {known}")
    see = _touch_of(joint)
    n, k = steps.inside.shape
    size = steps.at_ends.shape[1]
    ends = seen_at(
        system,
        see,
        np.concatenate([[steps.t0], steps.ends]),
        np.concatenate([steps.y0[None], steps.at_ends]),
        scalar,
    )
    inside = seen_at(system, see, steps.inside.ravel(), steps.at_inside.reshape(n * k, size), scalar)
    inside = _Touch(*(x.reshape(n, k, *x.shape[1:]) for x in inside))
    touching = ends.onset_rate > 0
    times = np.concatenate([[steps.t0], steps.ends])
    # Step i goes from end i to end i + 1; it is in contact where its beginning, with its events, is.
    begins = np.flatnonzero(touching & ~np.concatenate([[False], touching[:-1]]))
    rows = [_contact(int(b), touching, times, steps, ends, inside) for b in begins]
    columns = zip(*rows, strict=True) if rows else ([] for _ in COLUMNS)
    shapes = {"impulse": (0, 3), "place": (0, 3)}
    return {
        name: np.array(column).reshape(len(rows), *shapes.get(name, (0,))[1:])
        for name, column in zip(COLUMNS, columns, strict=True)
    }


def _contact(begin: int, touching, times, steps: Steps, ends: _Touch, inside: _Touch) -> tuple:
    """One contact, from the end of step `begin` on."""
    after = np.flatnonzero(~touching[begin:])
    is_open = after.size == 0
    last = len(touching) - 1 if is_open else begin + int(after[0])
    own = slice(begin, last)  # its steps
    weights = SHARE_WEIGHTS[None] * steps.lengths[own, None]
    force = np.linalg.norm(inside.force[own], axis=-1)
    # At a release the force is that of a ball that flies; at its end the contact's own is not known, and not larger.
    at_ends = np.linalg.norm(ends.force[begin : last + 1], axis=-1)
    until = last + 1 if is_open else last
    ts, forces = (times[begin:until], steps.inside[own]), (at_ends[: until - begin], force)
    depths = ends.penetration[begin:until], inside.penetration[own]
    stored = ends.elastic_energy[last] - ends.elastic_energy[begin]
    return (
        times[begin],
        np.nan if is_open else times[last],
        ends.onset_rate[begin],
        np.linalg.norm(ends.sliding[begin]),
        peak_of(*ts, *forces)[0],
        peak_of(*ts, *depths)[0],
        np.einsum("nk,nki->i", weights, inside.force[own]),
        float(np.sum(weights * inside.absorbed_power[own]) - stored),
        ends.place[begin],
    )


def peak_of(ends: Any, inside: Any, at_ends: Any, at_inside: Any) -> tuple[float, float]:
    """The largest of some values at the ends of steps, and when [s].

    Args:
        ends, at_ends: instants and values, shape (n,).
        inside, at_inside: `steps.SHARES` of each step and the values there, shape (m, k).

    Within a step values are smooth, and the largest is that of the polynomial through the inner ones; at its ends they
    may jump. A polynomial that rises by more than `LARGEST_RISE` meets a kink, and is not believed.
    """
    highest = int(np.argmax(at_ends))
    best = float(at_ends[highest]), float(ends[highest])
    for row in np.argsort(-at_inside.max(axis=1))[:3] if at_inside.size else ():
        seen = at_inside[row]
        rising = FINE_WEIGHTS @ seen
        top = int(np.argmax(rising))
        share, value = float(_FINE[top]), float(rising[top])
        if not seen.max() <= value <= seen.max() + LARGEST_RISE * abs(seen.max()):
            share, value = SHARES[int(np.argmax(seen))], float(seen.max())
        if value > best[0]:
            # The shares are known: two of them tell where the step begins and how long it is.
            length = (inside[row, -1] - inside[row, 0]) / (SHARES[-1] - SHARES[0])
            instant = inside[row, 0] + (share - SHARES[0]) * length
            best = value, float(np.clip(instant, ends[0], ends[-1]))  # rounding: -1e-20 s for a start at 0
    return best


LARGEST_RISE = 0.05
"""Of the polynomial of a step above its highest node, as a share of it: four nodes of a half sine differ by less."""

_FINE = np.linspace(0.0, 1.0, 201)
FINE_WEIGHTS = np.stack(
    [np.prod([(_FINE - other) / (node - other) for other in SHARES if other != node], axis=0) for node in SHARES],
    axis=1,
)
"""Lagrange's polynomials of the inner nodes."""


class Peak(NamedTuple):
    """The largest magnitude of a quantity.

    Attributes:
        value: in the quantity's unit.
        time: when [s].
    """

    value: float
    time: float


def peak(system: System, steps: Steps, name: str, scalar: bool | None) -> Peak:
    """The largest magnitude of a quantity between start and end: norms of vectors, absolute values of numbers."""
    return peaks(system, steps, (name,), scalar)[0]


def peaks(system: System, steps: Steps, names: tuple[str, ...], scalar: bool | None) -> list[Peak]:
    """The same of several quantities by one program, which takes about as long to compile as that of one."""
    n, k = steps.inside.shape
    ends, at_ends = np.concatenate([[steps.t0], steps.ends]), np.concatenate([steps.y0[None], steps.at_ends])
    inside = steps.at_inside.reshape(n * k, steps.at_ends.shape[1])
    see = magnitudes_of(names)
    at_inside = seen_at(system, see, steps.inside.ravel(), inside, scalar).reshape(n, k, len(names))
    at_ends = seen_at(system, see, ends, at_ends, scalar)
    return [Peak(*peak_of(ends, steps.inside, at_ends[:, i], at_inside[:, :, i])) for i in range(len(names))]


@lru_cache(maxsize=64)
def magnitudes_of(names: tuple[str, ...]):
    """The magnitudes of quantities at a state; one function for the same names: programs are kept by function."""

    def seen(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " k"]:
        return magnitudes(system, t, y, names)

    return seen

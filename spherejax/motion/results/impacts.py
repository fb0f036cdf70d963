"""Contacts of a joint one by one, and peaks: what lies between the samples of a run."""

from collections.abc import Callable
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
from spherejax.motion.results.within_steps import COEFFICIENTS, LARGEST_RISE, NODES, place_of_maximum
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
    """A joint at one instant: what `COLUMNS` are made of, and its crossing function (`Crossing.value`)."""

    onset_rate: Scalar
    force: Vector3
    penetration: Scalar
    absorbed_power: Scalar
    elastic_energy: Scalar
    sliding: Vector3
    place: Vector3
    crossing: Scalar


@lru_cache(maxsize=64)
def touch_of(joint: str):
    """What a joint does at a state, as `_Touch`; one function for the same joint: programs are kept by function."""

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
            model.crossing(motion).value,
        )

    return touch


def require_contact(system: System, joint: str) -> None:
    """`SceneError` for a joint without contact."""
    if joint not in system.contact_joints:
        known = ", ".join(map(repr, system.contact_joints)) or "none"
        raise SceneError(f"joint {joint!r} has no contact whose onsets are located; those that have: {known}")


def impacts(system: System, steps: Steps, joint: str, scalar: bool | None) -> dict[str, np.ndarray]:
    """Every contact of a joint, in the order of their onsets: `COLUMNS` as arrays with a leading axis of contacts.

    Args:
        system: what was run.
        steps: of the run.
        joint: name of a joint with clearance.
        scalar: whether the run was on scalar programs.

    Integrals are by Gauss and Legendre's rule in each step. Peaks are looked for at four instants inside each step and
    its end, and taken from the polynomial through eight instants of that step, for which the run is made once more.
    """
    require_contact(system, joint)
    see = touch_of(joint)
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
    curves = [curve for row in rows for curve in row[:2]]

    def seen(ts, ys):
        touch = seen_at(system, see, ts, ys, scalar)
        return np.column_stack([np.linalg.norm(touch.force, axis=-1), touch.penetration])

    peaks = peaks_of(curves, steps, seen) if curves else []
    rows = [(*row[2:6], peaks[2 * i][0], peaks[2 * i + 1][0], *row[6:]) for i, row in enumerate(rows)]
    columns = zip(*rows, strict=True) if rows else ([] for _ in COLUMNS)
    shapes = {"impulse": (0, 3), "place": (0, 3)}
    return {
        name: np.array(column).reshape(len(rows), *shapes.get(name, (0,))[1:])
        for name, column in zip(COLUMNS, columns, strict=True)
    }


def _contact(begin: int, touching, times, steps: Steps, ends: _Touch, inside: _Touch) -> tuple:
    """One contact, from the end of step `begin` on: its force and its penetration over time, and what `COLUMNS` has
    beside their peaks."""
    after = np.flatnonzero(~touching[begin:])
    is_open = after.size == 0
    last = len(touching) - 1 if is_open else begin + int(after[0])
    own = slice(begin, last)  # its steps
    weights = SHARE_WEIGHTS[None] * steps.lengths[own, None]
    force = np.linalg.norm(inside.force[own], axis=-1)
    # At a release the force is that of a ball that flies; at its end the contact's own is not known, and not larger.
    at_ends = np.linalg.norm(ends.force[begin : last + 1], axis=-1)
    until = last + 1 if is_open else last
    stored = ends.elastic_energy[last] - ends.elastic_energy[begin]
    own_ends = times[begin:until]
    return (
        _Curve(own_ends, at_ends[: until - begin], steps.inside[own], force, 0),
        _Curve(own_ends, ends.penetration[begin:until], steps.inside[own], inside.penetration[own], 1),
        times[begin],
        np.nan if is_open else times[last],
        ends.onset_rate[begin],
        np.linalg.norm(ends.sliding[begin]),
        np.einsum("nk,nki->i", weights, inside.force[own]),
        float(np.sum(weights * inside.absorbed_power[own]) - stored),
        ends.place[begin],
    )


class _Curve(NamedTuple):
    """A quantity over some steps of a run, of which the peak is wanted.

    Attributes:
        ends, at_ends: instants at which steps end [s], and the values there, shape (n,).
        inside, at_inside: `SHARES` of each step [s], and the values there, shape (m, k).
        column: which one of the quantities that are seen at an instant.
    """

    ends: np.ndarray
    at_ends: Any
    inside: np.ndarray
    at_inside: Any
    column: int

    @property
    def highest_steps(self) -> np.ndarray:
        """The steps that may have the peak: those with the highest values, at most three."""
        tops = self.at_inside.max(axis=1)
        highest = np.argsort(-tops)[:3]
        return highest[tops[highest] >= tops[highest[:1]] - 2 * LARGEST_RISE * np.abs(tops[highest[:1]])]

    def spans(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Beginnings and lengths of steps [s]."""
        # The shares are known: two of them tell where the step begins and how long it is.
        lengths = (self.inside[rows, -1] - self.inside[rows, 0]) / (SHARES[-1] - SHARES[0])
        return self.inside[rows, 0] - SHARES[0] * lengths, lengths


def peaks_of(curves: list[_Curve], steps: Steps, seen: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> list:
    """The largest value of each curve, and when [s].

    Args:
        curves: the quantities over their steps.
        steps: of the run.
        seen: the quantities, in columns, at instants [s] and the flat states there.

    Five instants of each step say which steps may have the peak; `NODES` of these say how large it is.
    """
    spans = [curve.spans(curve.highest_steps) for curve in curves]
    instants = [begins[:, None] + lengths[:, None] * np.array(NODES) for begins, lengths in spans]
    times = np.concatenate([own.ravel() for own in [*instants, np.zeros(0)]])
    values = seen(times, steps.states(times)) if times.size else np.zeros((0, 0))
    own_values = np.split(values, np.cumsum([own.size for own in instants])[:-1])
    at_nodes = [
        own[:, curve.column].reshape(-1, len(NODES)) if own.size else np.zeros((0, len(NODES)))
        for own, curve in zip(own_values, curves, strict=True)
    ]
    return [
        peak_of(curve.ends, curve.at_ends, *span, own) for curve, span, own in zip(curves, spans, at_nodes, strict=True)
    ]


def peak_of(ends: Any, at_ends: Any, begins: Any, lengths: Any, at_nodes: Any) -> tuple[float, float]:
    """The largest of some values at the ends of steps and within steps, and when [s].

    Args:
        ends, at_ends: instants [s] and values, shape (n,).
        begins, lengths: of some steps [s], shape (m,).
        at_nodes: values at `NODES` of these, shape (m, 8).

    Within a step values are smooth, and the largest is that of the polynomial through the inner ones; at its ends they
    may jump. A polynomial that rises by more than `LARGEST_RISE` meets a kink, and is not believed.
    """
    highest = int(np.argmax(at_ends))
    best = float(at_ends[highest]), float(ends[highest])
    for begin, length, seen in zip(begins, lengths, at_nodes, strict=True):
        coefficients = COEFFICIENTS @ seen
        s = float(place_of_maximum(coefficients, np))
        share, value = (s + 1) / 2, float(np.polyval(coefficients, s))
        if not seen.max() <= value <= seen.max() + LARGEST_RISE * abs(seen.max()):
            share, value = NODES[int(np.argmax(seen))], float(seen.max())
        if value > best[0]:
            best = value, float(np.clip(begin + share * length, ends[0], ends[-1]))  # rounding: -1e-20 s for a start
    return best


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
    curves = [_Curve(ends, at_ends[:, i], steps.inside, at_inside[:, :, i], i) for i in range(len(names))]
    return [Peak(*one) for one in peaks_of(curves, steps, lambda ts, ys: seen_at(system, see, ts, ys, scalar))]


@lru_cache(maxsize=64)
def magnitudes_of(names: tuple[str, ...]):
    """The magnitudes of quantities at a state; one function for the same names: programs are kept by function."""

    def seen(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " k"]:
        return magnitudes(system, t, y, names)

    return seen

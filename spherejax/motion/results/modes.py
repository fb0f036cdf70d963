"""What the ball does in its socket: flight, impact or contact."""

import enum
from functools import lru_cache
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.model.system import System, flatten_system
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import constraint_set, inverse_masses, solve_augmented
from spherejax.motion.equations.programs import program_for
from spherejax.physics.joints.contact import direction_of, stiffness_of
from spherejax.physics.state import unpack

CONTACT_DURATIONS = 3.0
"""An episode of touching longer than this many durations of a free impact counts as contact."""

HERTZIAN_DURATION = 2.943
"""Duration of an elastic Hertzian impact is 2.943 times maximum penetration over impact speed (Johnson, Contact
Mechanics, 1985, section 11.4)."""


class Mode(enum.IntEnum):
    """What the ball does at a sample."""

    FLIGHT = 0
    IMPACT = 1
    CONTACT = 2


def modes(system: System, ts, ys, penetration, joint: str) -> np.ndarray:
    """The mode of a joint with clearance at each sample, integers of `Mode`, shape (n,).

    Flight: the ball does not touch. Impact: from an onset to the release that follows it. Contact (the following
    mode): an onset whose release does not come within `CONTACT_DURATIONS` durations of a free elastic impact of the
    same depth, 2.943 delta_max / v with v^2 = 2 delta_max^(n+1) K / ((n+1) m) and m the effective mass
    along the normal.

    Episodes are recognized from the samples (and, where the joint remembers its onsets, from a change of the
    remembered rate): the samples must be finer than a contact lasts, about 50 us for steel parts of 0.1 kg.

    Args:
        system: the compiled scene, with concrete numbers.
        ts: sample times [s], shape (n,).
        ys: flat states, shape (n, size).
        penetration: of the joint [m], shape (n,).
        joint: name of a joint with clearance.
    """
    penetration = np.asarray(penetration)
    onset_rate = _remembered_rates(system, ys, joint)
    is_touching = penetration > 0 if onset_rate is None else onset_rate > 0
    result = np.where(is_touching, Mode.IMPACT, Mode.FLIGHT)
    times = np.asarray(ts)
    compliance = np.asarray(_effective_compliance(system, ts, ys, joint))
    for begin, end in _episodes(is_touching, onset_rate):
        lasted = times[min(end, times.size - 1)] - times[begin]
        depth = float(np.max(penetration[begin:end], initial=0.0))
        if lasted > CONTACT_DURATIONS * _impact_duration(system, joint, depth, float(np.mean(compliance[begin:end]))):
            result[begin:end] = Mode.CONTACT
    return result


def _episodes(is_touching: np.ndarray, onset_rate: np.ndarray | None) -> list[tuple[int, int]]:
    """Half-open ranges of samples that belong to one onset."""
    label = is_touching.astype(float) if onset_rate is None else np.where(is_touching, onset_rate, 0.0)
    borders = [0, *(np.flatnonzero(np.diff(label)) + 1).tolist(), label.size]
    return [(a, b) for a, b in pairwise(borders) if is_touching[a]]


def _impact_duration(system: System, joint: str, depth: float, inverse_mass: float) -> float:
    model: Any = system.spherical(joint).model
    if depth <= 0:
        return 0.0
    stored = float(model.normal.elastic_energy(depth, stiffness_of(model.normal, model.surfaces)))
    speed = (2 * inverse_mass * stored) ** 0.5
    return HERTZIAN_DURATION * depth / speed


def _remembered_rates(system: System, ys, joint: str) -> np.ndarray | None:
    entries = system.memory_of(joint)
    if entries.start == entries.stop:
        return None
    return np.asarray(unpack(system.layout, ys).memory)[:, entries.start]


def _effective_compliance(system: System, ts, ys, joint: str):
    """n^T (D M^-1 D^T) n for the joint's own three equations [1/kg], at each sample, other constraints held."""
    if joint not in system.force_joints:
        raise SceneError(f"joint {joint!r} is ideal: it has no mode")
    structure, theta = flatten_system(system)
    program = program_for(_mobility_function(joint), structure)
    return jax.jit(jax.vmap(lambda t, y: program(jnp.asarray(theta), t, y)))(jnp.asarray(ts), jnp.asarray(ys))


@lru_cache(maxsize=64)
def _mobility_function(joint: str):
    """The function for one joint; the same object each time, so that its program is found again."""

    def mobility(system: System, t, y):
        return _normal_mobility(system, joint, t, y)

    return mobility


def _normal_mobility(system: System, joint: str, t, y):
    """Acceleration along n of ball against socket per unit of a pair of opposite forces along n [1/kg]."""
    motions = body_motions(system, unpack(system.layout, y))
    placed = system.spherical(joint)
    rows = placed.coincidence(motions)
    n = direction_of(placed.relative_motion(motions).eccentricity)
    pair = {body: block.T @ n for body, block in zip(placed.bodies, rows.jacobians, strict=True)}
    wrenches = jnp.stack([pair.get(body, jnp.zeros(6)) for body in system.bodies])
    constraints = constraint_set(system, t, motions)
    none = jnp.zeros_like(constraints.bias)
    masses = inverse_masses(system, motions)
    moved = solve_augmented(constraints, masses, wrenches, none, False, system.smallest_pivot).accelerations
    return jnp.sum(wrenches * moved)

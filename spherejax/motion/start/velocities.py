"""Velocities that a start cannot keep: what the joints, or a concentric start, remove of them is said aloud."""

from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.types import Scalar
from spherejax.model.system import Structure, System
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import assembly_set, velocity_violation
from spherejax.motion.equations.programs import program_for
from spherejax.motion.start.assembly import Assembly
from spherejax.motion.start.tolerances import length_scale
from spherejax.physics.joints.elementary import PlacedPair
from spherejax.physics.joints.joint import AbstractPlacedJoint
from spherejax.physics.joints.spherical import PlacedSpherical
from spherejax.physics.state import POSITION_SIZE, unpack

NOTICEABLE = 1e-3
"""A change below this share of the largest velocity is taken for the rounding of printed tables."""

MOST_NAMED = 3
"""Joints that a message names, the worst first."""


def removed_velocities(system: System, structure: Structure, numbers, t: float, start: Assembly) -> str:
    """What to say of a start without the velocities that the scene describes; nothing where it has them.

    Bodies that are described at rest may be set in motion, by drivers, without a warning.

    Args:
        system: the system.
        structure, numbers: the system as if its joints were ideal, taken apart; the numbers are known.
        t: time of the start [s].
        start: the consistent start.
    """
    bodies = list(system.bodies.values())
    given = np.array([[*np.asarray(body.velocity), *np.asarray(body.angular_velocity)] for body in bodies])
    places, velocities = np.split(np.asarray(start.y), [POSITION_SIZE * len(bodies)])
    taken = velocities.reshape(given.shape)
    if not given.any():  # as below, where most scenes begin: no speed that could be removed
        return ""
    radius = _length_of(structure, numbers.tobytes())
    if not _largest_speed(taken - given, radius) > NOTICEABLE * _largest_speed(given, radius) > 0:
        return ""
    violations = program_for(velocity_violations, structure).compute(numbers, t, np.append(places, given))
    return _message(system, violations, given, taken, radius)


@lru_cache(maxsize=64)
def _length_of(structure: Structure, numbers: bytes) -> float:
    """The length of a mechanism [m]: not of the system itself, whose clearances may be traced."""
    return float(length_scale(structure.system(np.frombuffer(numbers))))


def velocity_violations(system: System, t: Scalar, y: Float[Array, " n"]) -> dict[str, Float[Array, " n_joint"]]:
    """Phi_dot of each joint that the start must satisfy [m/s or 1/s]."""
    motions = body_motions(system, unpack(system.layout, y))
    constraints = assembly_set(system, t, motions)
    return constraints.split(velocity_violation(constraints, motions))


def _largest_speed(velocities: np.ndarray, radius: float) -> float:
    """Of translations, and of rotations at a radius [m/s]."""
    linear, angular = (np.linalg.norm(part, axis=1).max() for part in (velocities[:, :3], velocities[:, 3:]))
    return max(float(linear), radius * float(angular))


def _described_alone(system: System, given: np.ndarray, taken: np.ndarray) -> tuple[str, float] | None:
    """The only body that was described in motion, and the factor by which its start was slowed down; None where several
    move, where a driver prescribes motions, or where the body starts in another direction.

    The projection is linear, so that velocities times this factor give the start that was described.
    """
    moving = np.flatnonzero(np.any(given != 0, axis=1))
    if len(moving) != 1 or system.is_driven:
        return None
    described, start = given[moving[0]], taken[moving[0]]
    # A crank is described by its spin alone: the velocity of its center follows from the joint.
    for part in (slice(0, 3), slice(3, 6)):
        if not np.any(described[part]):
            described, start = np.delete(described, part), np.delete(start, part)
    along = float(described @ start)
    if along <= 0:
        return None
    times = float(described @ described) / along
    if not np.allclose(times * start, described, rtol=0, atol=1e-3 * float(np.linalg.norm(described))):
        return None
    return list(system.bodies)[moving[0]], times


def _message(system: System, violations: dict[str, np.ndarray], given, taken, radius: float) -> str:
    size_of = {name: float(np.linalg.norm(violation)) for name, violation in violations.items()}
    worst = sorted(size_of, key=lambda name: -size_of[name])
    violated = [name for name in worst if size_of[name] > NOTICEABLE * size_of[worst[0]]]
    speeds = {name: _speed(system.joints[name], violations[name]) for name in violated}
    loose = [name for name in violated if system.joints[name].answers_with_force]
    held = [name for name in violated if name not in loose]
    parts = []
    if loose:
        parts.append(
            f"{_listed(loose, speeds)}: a ball or bushing starts concentric and at relative rest, and the relative "
            "velocity that the bodies were given there was removed. To keep it, give the joint "
            "starts_concentric=False: it then starts where and as fast as the bodies are described"
        )
    if held:
        parts.append(
            f"{_listed(held, speeds)}: the velocities given to the bodies violate the constraint, and what it does not "
            "allow was removed. Give velocities that agree, e.g. those taken: run.velocity(body)[0] and "
            "run.angular_velocity(body)[0]"
        )
    changes = taken - given
    most = int(np.argmax([_largest_speed(change[None], radius) for change in changes]))
    name = list(system.bodies)[most]
    parts.append(f"Body {name!r} starts with {_motion(taken[most])} instead of {_motion(given[most])}")
    alone = _described_alone(system, given, taken)
    if alone is not None:
        body, times = alone
        parts.append(
            f"The other bodies were described at rest, and the momentum of {body!r} was shared with them: described "
            f"{times:.4g} times as fast, it starts as fast as it was described"
        )
    return ". ".join(parts) + "."


def _listed(names: Iterable[str], speeds: dict[str, str]) -> str:
    named = [f"{name!r} ({speeds[name]})" for name in names]
    more = len(named) - MOST_NAMED
    shown = ", ".join(named[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
    return f"{'joint' if len(named) == 1 else 'joints'} {shown}"


def _speed(joint: AbstractPlacedJoint, violation: np.ndarray) -> str:
    """How much a joint's equations are violated, with the units of its equations."""
    joint = joint.ideal if isinstance(joint, PlacedSpherical) and joint.ideal is not None else joint
    if isinstance(joint, PlacedSpherical):
        return f"{np.linalg.norm(violation):.3g} m/s"
    if isinstance(joint, PlacedPair):
        n_lengths = joint.n_rows - len(joint.right_angles)
        sizes = [(np.linalg.norm(violation[:n_lengths]), "m/s"), (np.linalg.norm(violation[n_lengths:]), "rad/s")]
        return " and ".join(f"{size:.3g} {unit}" for size, unit in sizes if size > NOTICEABLE * max(sizes)[0])
    return f"{np.linalg.norm(violation):.3g} in SI units"


def _motion(velocity: np.ndarray) -> str:
    return f"{_vector(velocity[:3])} m/s and {_vector(velocity[3:])} rad/s"


def _vector(numbers: np.ndarray) -> str:
    rounded = np.where(np.abs(numbers) < 1e-9 * max(float(np.max(np.abs(numbers))), 1e-3), 0.0, numbers)
    return f"({', '.join(f'{number:.4g}' for number in rounded)})"

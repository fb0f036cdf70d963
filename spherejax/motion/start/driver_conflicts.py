"""Conflicts of drivers: two that prescribe the same coordinate differently, or motions that the joints do not allow.

Equations that depend on others leave a mechanism no choice: n^T D = 0 for a row n of weights, and so the demands must
agree too, n^T Phi_t = 0 for velocities and n^T gamma = 0 for accelerations. What does not agree has a part along the
dependent equations, and the drivers among these are named.
"""

from collections.abc import Mapping
from itertools import combinations
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Numeric, Scalar
from spherejax.model.system import Structure, System
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import assembly_set, velocity_violation
from spherejax.motion.equations.programs import program_for
from spherejax.motion.start.assembly import UNMET_TOLERANCE, Assembly, described_state
from spherejax.physics.joints.drivers import PlacedRotationDriver
from spherejax.physics.joints.joint import AbstractPlacedJoint
from spherejax.physics.state import unpack

DEPENDENT = 1e-7
"""Singular values below this, relative to the largest, count as zero; as for redundant equations."""

INVOLVED = 1e-2
"""Equations take part in a contradiction whose share of it is larger than this, relative to the largest."""

N_INSTANTS = 257
"""How many instants of a run two drivers of one coordinate are compared at."""

SMALLEST_WAY = 1e-4
"""Ways [m or rad] below this are compared to 1e-5 of it, the closing tolerance, not to 1e-5 of themselves."""

REMEDY = "Remove one of them, or make their functions of time agree."


class Demands(NamedTuple):
    """What the joints ask of the start, joint by joint.

    Attributes:
        rows: D, by all bodies, shape (n, 6 n_bodies).
        residual: Phi [m or 1].
        violation: Phi_dot of the velocities that the bodies have [m/s or 1/s].
        bias: gamma [m/s^2 or 1/s^2].
    """

    rows: dict[str, Float[Array, "n n_v"]]
    residual: dict[str, Float[Array, " n"]]
    violation: dict[str, Float[Array, " n"]]
    bias: dict[str, Float[Array, " n"]]


def refuse_driver_conflicts(structure: Structure, theta: Numeric, ts: Float[np.ndarray, " n"], start: Assembly) -> None:
    """Raise `SceneError` for drivers whose demands contradict each other, or the joints, at the start.

    Two drivers of one coordinate are compared along the whole run; other drivers that part later are not found here.

    Args:
        structure, theta: the system as if its joints were ideal, taken apart; the numbers are known.
        ts: from the start to the end of the run [s].
        start: the consistent start.
    """
    system, t = structure.system(theta), float(ts[0])
    drivers = [name for name, joint in system.joints.items() if joint.is_driven]
    y = np.asarray(start.y)
    found = program_for(demands, structure).compute(theta, t, y)
    _refuse_contradiction(found, y[system.layout.n_position :], drivers, t)
    pairs = _same_coordinate(system, found, drivers)
    if pairs and len(ts) > 1:
        _refuse_parting(structure, theta, ts, y, pairs, found)


def conflicts_at(structure: Structure, theta: Numeric, t: float) -> tuple[str, ...]:
    """Names of the drivers, if there are several, that ask for positions that cannot be had together."""
    system = structure.system(theta)
    drivers = [name for name, joint in system.joints.items() if joint.is_driven]
    if len(drivers) < 2:
        return ()
    found = program_for(demands_described, structure).compute(theta, t, np.zeros(system.layout.size))
    contradiction = _along_dependences(found, found.residual)
    names = [name for name in drivers if contradiction and _is_involved(contradiction, name)]
    return tuple(names) if len(names) > 1 else ()


def demands(system: System, t: Scalar, y: Float[Array, " n"]) -> Demands:
    """What the joints ask of a start, at a state without memory."""
    motions = body_motions(system, unpack(system.layout, y))
    constraints = assembly_set(system, t, motions)
    rows = {}
    for joint, found in constraints.rows.items():
        none = jnp.zeros((found.residual.shape[0], 6))
        rows[joint] = jnp.concatenate([constraints.blocks_of(name).get(joint, none) for name in system.bodies], 1)
    violation = constraints.split(velocity_violation(constraints, motions))
    residual = {name: found.residual for name, found in constraints.rows.items()}
    return Demands(rows, residual, violation, {name: found.bias for name, found in constraints.rows.items()})


def demands_described(system: System, t: Scalar, y: Float[Array, " n"]) -> Demands:
    """The same where the scene puts the bodies."""
    del y
    return demands(system, t, described_state(system))


def _along_dependences(found: Demands, wanted: Mapping[str, Any]) -> dict[str, float]:
    """Sizes, by joint, of the part of some demands that lies along equations that depend on each other."""
    names = [name for name, rows in found.rows.items() for _ in rows]
    D, r = np.concatenate(list(found.rows.values())), np.concatenate(list(wanted.values()))
    lengths = np.linalg.norm(D, axis=1)
    lengths = np.where(lengths > 0, lengths, 1.0)
    left, sizes, _ = np.linalg.svd(D / lengths[:, None], full_matrices=True)
    null = left[:, int(np.sum(sizes > DEPENDENT * sizes[0])) :]
    part = null @ (null.T @ (r / lengths))
    if not np.linalg.norm(part) > UNMET_TOLERANCE * np.linalg.norm(r / lengths):
        return {}
    return {name: float(np.abs(part[[each == name for each in names]]).max()) for name in found.rows}


def _is_involved(contradiction: dict[str, float], name: str) -> bool:
    return contradiction[name] > INVOLVED * max(contradiction.values())


def _refuse_contradiction(found: Demands, velocities: np.ndarray, drivers: list[str], t: float) -> None:
    """Raise `SceneError` where no velocities, or no accelerations, meet all demands; see `assembly.unmet_demands`."""
    rates = {name: found.violation[name] - found.rows[name] @ velocities for name in found.rows}
    asked = {"velocities": rates} | ({"accelerations": found.bias} if len(drivers) > 1 else {})
    for what, wanted in asked.items():
        contradiction = _along_dependences(found, wanted)
        involved = [name for name in contradiction if _is_involved(contradiction, name)]
        named = [name for name in involved if name in drivers]
        if len(named) > 1:
            raise SceneError(
                f"drivers {_listed(named)} fight: at t = {t:.6g} s they ask for {what} that one motion cannot have. "
                f"{REMEDY}"
            )
        if named:
            held = _listed(name for name in involved if name not in drivers)
            raise SceneError(
                f"driver {named[0]!r} asks at t = {t:.6g} s for {what} that {held} do not allow in this configuration "
                "(a dead point, or a motion that is locked). Start elsewhere, at rest, or drive another coordinate."
            )


def _refuse_parting(structure: Structure, theta, ts, y: np.ndarray, pairs, first: Demands) -> None:
    """Compare drivers of one and the same coordinate along the run."""
    system, program = structure.system(theta), program_for(demands, structure)
    # The state stays: of one coordinate all demands change alike, wherever the mechanism is.
    for instant in np.linspace(float(ts[0]), float(ts[-1]), N_INSTANTS)[1:]:
        later = program.compute(theta, float(instant), y)
        for (one, other), sign in pairs.items():
            joint = system.joints[one]
            gone = [_difference(joint, later.residual[name], first.residual[name]) for name in (one, other)]
            parted = _difference(joint, gone[0], sign * gone[1])
            if np.abs(parted).max() > UNMET_TOLERANCE * max(np.abs(gone).max(), SMALLEST_WAY):
                raise SceneError(
                    f"drivers {one!r} and {other!r} fight: they prescribe the same coordinate and part before "
                    f"t = {instant:.6g} s. {REMEDY}"
                )


def _difference(joint: AbstractPlacedJoint, a: Any, b: Any) -> np.ndarray:
    """a - b, of angles between -pi and pi."""
    if isinstance(joint, PlacedRotationDriver):
        return (a - b + np.pi) % (2 * np.pi) - np.pi
    return a - b


def _same_coordinate(system: System, found: Demands, drivers: list[str]) -> dict[tuple[str, str], float]:
    """Pairs of drivers with the same equations in all configurations, but for a sign, and this sign.

    Directions are fixed in the first body, and so the order of the bodies counts, but for angles about a common axis.
    """
    pairs = {}
    for one, other in combinations(drivers, 2):
        a, b = found.rows[one], found.rows[other]
        joints = system.joints[one], system.joints[other]
        is_angle = isinstance(joints[0], PlacedRotationDriver)
        ends, points = [joint.bodies for joint in joints], [joint.points for joint in joints]
        if type(joints[0]) is not type(joints[1]) or not (
            ends[0] == ends[1] or (is_angle and set(ends[0]) == set(ends[1]))
        ):
            continue
        if not is_angle and not np.allclose(points[0], points[1], rtol=0, atol=1e-12):
            continue
        sign = 1.0 if np.sum(a * b) > 0 else -1.0
        if np.abs(a - sign * b).max() < DEPENDENT * np.abs(a).max():
            pairs[one, other] = sign
    return pairs


def _listed(names) -> str:
    return " and ".join(repr(name) for name in names)

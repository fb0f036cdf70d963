"""Poses, velocities and accelerations that satisfy all joints and drivers, and come nearest to what was measured.

With the constraint equations Phi(t, q) = 0, small steps d of the bodies (translations and rotations, world axes), and
h(q) = y for what was measured,

    D d = -Phi,                 H d ~ y - h          steps of Newton, of Gauss and Newton, until the pose stays
    D v = -Phi_t,               H v ~ y'
    D a = gamma,                H a ~ y'' - H' v

"=" holds exactly, "~" in the least squares of lengths over L and of angles. Directions that neither determines (a rod
between two balls spins about itself) do not move.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.rotation import (
    conjugate,
    normalized,
    quaternion_from_rotation_vector,
    quaternion_product,
    rotation_vector,
)
from spherejax.foundations.types import Scalar
from spherejax.physics.forces.coupler import AbstractCoordinate, Turn
from spherejax.physics.state import VELOCITY_SIZE
from spherejax.studies.inverse.least_squares import constrained_least_squares
from spherejax.studies.inverse.mechanism import IdealMechanism
from spherejax.studies.inverse.sampled_motion import SampledMotion
from spherejax.studies.inverse.smoothing import Smoothed, smoothed
from spherejax.studies.inverse.terms import (
    CoordinateTerms,
    closing,
    described_pose,
    evaluated,
    flat_state,
    measures,
    moving,
)

STEPS = 8
"""Newton steps of each pose, from the one before: the digits double with each."""

FIRST_REPEATS = 2
"""How often the first pose is looked for before it counts, from the start that the scene describes."""

LAST_STEPS = 4
"""Steps that carry derivatives. One would do without measurements; with them the error of a derivative falls by the
size of what the joints leave of the measurements, over the mechanism's length, with each."""


class Motion(NamedTuple):
    """The motion of all bodies at one instant, or with a leading axis of instants.

    Attributes:
        pose: centers of mass [m] and quaternions, shape (n_bodies, 7).
        velocities: linear [m/s] and angular [rad/s], world axes, shape (n_bodies, 6).
        accelerations: linear [m/s^2] and angular [rad/s^2], shape (n_bodies, 6).
    """

    pose: Float[Array, "*n b 7"]
    velocities: Float[Array, "*n b 6"]
    accelerations: Float[Array, "*n b 6"]


class MeasuredSignals(NamedTuple):
    """What was measured, smoothed: a column for each signal, in the order of `_missing`.

    Attributes:
        positions: [m], shape (n, bodies, 3), and the first and second derivative.
        quaternions: unit quaternions, shape (n, bodies, 4), and angular velocities and accelerations in world axes,
            shape (n, bodies, 3).
        coordinates: [rad or m], shape (n, coordinates), and the first and second derivative.
    """

    positions: Smoothed
    quaternions: Smoothed
    coordinates: Smoothed

    def rates(self, order: int) -> Float[Array, " m"]:
        """First or second derivatives at one instant, as a vector."""
        return jnp.concatenate([part[order].ravel() for part in self])


def no_wishes(n: int) -> MeasuredSignals:
    """Of a motion that is prescribed by drivers alone."""
    vectors, numbers = jnp.zeros((n, 0, 3)), jnp.zeros((n, 0))
    positions = Smoothed(vectors, vectors, vectors)
    quaternions = Smoothed(jnp.zeros((n, 0, 4)), vectors, vectors)
    return MeasuredSignals(positions, quaternions, Smoothed(numbers, numbers, numbers))


def wishes_of(mechanism: IdealMechanism, measured: SampledMotion) -> MeasuredSignals:
    """The smoothed samples."""
    ts, n = measured.ts, len(measured.ts)

    def filtered(parts: list, width: int) -> Smoothed:
        columns = [jnp.reshape(part, (n, -1)) for part in parts]
        splines = smoothed(ts, jnp.concatenate([jnp.zeros((n, 0)), *columns], 1), measured.cutoff)
        return Smoothed(*(x.reshape(n, -1, width) for x in splines))

    positions = filtered([measured.positions[name] for name in mechanism.positions], 3)
    quaternions = [_of_one_sign(measured.quaternions[name]) for name in mechanism.quaternions]
    turning = _turning(filtered(quaternions, 4))
    coordinates = filtered([measured.coordinates[name][1] for name in mechanism.targets], 1)
    return MeasuredSignals(positions, turning, Smoothed(*(x[..., 0] for x in coordinates)))


def _of_one_sign(quaternions: Float[Array, "n 4"]) -> Float[Array, "n 4"]:
    """q and -q are the same orientation: the one nearer to that of the sample before."""
    flips = jnp.sum(quaternions[1:] * quaternions[:-1], -1) < 0
    signs = jnp.cumprod(jnp.where(flips, -1.0, 1.0))
    return quaternions * jnp.concatenate([jnp.ones(1), signs])[:, None]


def _turning(entries: Smoothed) -> Smoothed:
    """Unit quaternions, angular velocities and accelerations of quaternions that were smoothed entry by entry."""

    def at(q, q_rate, q_second):
        def velocity(q, q_rate):
            # 2 p' p* with p = q/|q|: what |q| changes by is along the scalar, and falls out.
            return 2 * quaternion_product(q_rate, conjugate(q))[1:] / jnp.sum(q * q)

        w, w_rate = jax.jvp(velocity, (q, q_rate), (q_rate, q_second))
        return normalized(q), w, w_rate

    return Smoothed(*jax.vmap(jax.vmap(at))(*entries))


# Poses --------------------------------------------------------------------------------------------------------------


def poses(mechanism: IdealMechanism, ts: Float[Array, " n"], wishes: MeasuredSignals) -> Float[Array, "n b 7"]:
    """The pose at each instant, from that of the instant before."""
    held, held_ts, held_wishes = jax.lax.stop_gradient((mechanism, ts, wishes))

    def follow(pose, sample):
        pose = jax.lax.fori_loop(0, STEPS, lambda _, pose: stepped(held, sample[0], pose, sample[1]), pose)
        return pose, pose

    # The first instant several times over, and not in a loop of its own: the step is compiled once.
    samples = jax.tree.map(lambda x: jnp.concatenate([jnp.repeat(x[:1], FIRST_REPEATS, 0), x]), (held_ts, held_wishes))
    _, followed = jax.lax.scan(follow, described_pose(held.system), samples)
    followed = jax.lax.stop_gradient(followed[FIRST_REPEATS:])

    def carried(pose, t, wished):
        return jax.lax.scan(lambda pose, _: (stepped(mechanism, t, pose, wished), None), pose, length=LAST_STEPS)[0]

    return jax.vmap(carried)(followed, ts, wishes)


def stepped(
    mechanism: IdealMechanism, t: Scalar, pose: Float[Array, "b 7"], wished: MeasuredSignals
) -> Float[Array, "b 7"]:
    """One step towards the pose that closes the joints and comes nearest to what is wished."""
    still = flat_state(pose, jnp.zeros((mechanism.n_bodies, VELOCITY_SIZE)))
    scales, weights = mechanism.scales(), _weights(mechanism)
    constraints = evaluated(closing, mechanism.closed, t, still)
    equations, sizes = _of_size_one(constraints.jacobian / scales)
    looked = evaluated(measures, mechanism.observed, t, still)
    slopes = weights[:, None] * _slopes(mechanism, looked) / scales
    missing = weights * _missing(mechanism, pose, looked.values, wished)
    steps = constrained_least_squares(equations, -constraints.residual / sizes, slopes, missing)
    return displaced(pose, (steps / scales).reshape(-1, VELOCITY_SIZE))


def displaced(pose: Float[Array, "b 7"], steps: Float[Array, "b 6"]) -> Float[Array, "b 7"]:
    """The bodies moved by translations [m] and rotation vectors [rad], world axes."""

    def one(place, step):
        turned = quaternion_product(quaternion_from_rotation_vector(step[3:]), place[3:])
        return jnp.concatenate([place[:3] + step[:3], normalized(turned)])

    return jax.vmap(one)(pose, steps)


def _of_size_one(rows: Float[Array, "n k"]) -> tuple[Float[Array, "n k"], Float[Array, " n"]]:
    """Rows of length 1, and their lengths; a row of zeros stays."""
    sizes = jax.vmap(safe_norm)(rows) if rows.shape[0] else jnp.zeros(0)
    sizes = jnp.where(sizes > 0, sizes, 1.0)
    return rows / sizes[:, None], sizes


# What was measured ---------------------------------------------------------------------------------------------------


def _missing(
    mechanism: IdealMechanism, pose: Float[Array, "b 7"], values, wished: MeasuredSignals
) -> Float[Array, " m"]:
    """What the pose lacks of the measurements [m or rad]."""
    number = {name: i for i, name in enumerate(mechanism.system.bodies)}
    parts = [jnp.zeros(0)]
    for name, position in zip(mechanism.positions, wished.positions[0], strict=True):
        parts.append(position - pose[number[name], :3])
    for name, quaternion in zip(mechanism.quaternions, wished.quaternions[0], strict=True):
        parts.append(rotation_vector(quaternion_product(quaternion, conjugate(pose[number[name], 3:]))))
    for coordinate, wish, value in zip(mechanism.targets.values(), wished.coordinates[0], values, strict=True):
        lack = wish - value
        # Orientations do not say how many whole turns led there.
        turn = _whole_turn(coordinate)
        lack = lack if turn is None else lack - turn * jnp.round(jax.lax.stop_gradient(lack) / turn)
        parts.append(lack[None])
    return jnp.concatenate(parts)


def _whole_turn(coordinate: AbstractCoordinate) -> Scalar | float | None:
    if not isinstance(coordinate, Turn):
        return None
    return 2 * np.pi * (1.0 if coordinate.radius is None else coordinate.radius)


def _weights(mechanism: IdealMechanism) -> Float[Array, " m"]:
    """1/L of lengths, 1 of angles."""
    of_length = 1 / mechanism.length
    parts = [
        jnp.full(3 * len(mechanism.positions), of_length),
        jnp.ones(3 * len(mechanism.quaternions)),
        jnp.stack([jnp.ones(()) if one.is_angle else of_length for one in mechanism.targets.values()])
        if mechanism.targets
        else jnp.zeros(0),
    ]
    return jnp.concatenate(parts)


def _slopes(mechanism: IdealMechanism, looked: CoordinateTerms) -> Float[Array, "m k"]:
    """H of all that was measured, by the velocities of all bodies."""
    number = {name: i for i, name in enumerate(mechanism.system.bodies)}
    unit = np.eye(VELOCITY_SIZE * mechanism.n_bodies).reshape(mechanism.n_bodies, VELOCITY_SIZE, -1)
    rows = [unit[number[name], :3] for name in mechanism.positions]
    rows += [unit[number[name], 3:] for name in mechanism.quaternions]
    return jnp.concatenate([*map(jnp.asarray, rows), looked.slopes])


# Velocities and accelerations ---------------------------------------------------------------------------------------


def motion_at(mechanism: IdealMechanism, t: Scalar, pose: Float[Array, "b 7"], wished: MeasuredSignals) -> Motion:
    """Velocities and accelerations at a pose."""
    scales, weights = mechanism.scales(), _weights(mechanism)
    still = flat_state(pose, jnp.zeros((mechanism.n_bodies, VELOCITY_SIZE)))
    at_rest = evaluated(moving, mechanism.closed, t, still)
    equations, sizes = _of_size_one(at_rest.jacobian / scales)
    slopes = weights[:, None] * _slopes(mechanism, evaluated(measures, mechanism.observed, t, still)) / scales

    def solved(right, values):
        steps = constrained_least_squares(equations, right / sizes, slopes, weights * values)
        return (steps / scales).reshape(-1, VELOCITY_SIZE)

    velocities = solved(-at_rest.rate_at_rest, wished.rates(1))
    y = flat_state(pose, velocities)
    bending = evaluated(measures, mechanism.observed, t, y).bending
    # Of positions and orientations H does not change.
    bending = jnp.concatenate([jnp.zeros(len(weights) - len(bending)), bending])
    bias = evaluated(moving, mechanism.closed, t, y).bias
    return Motion(pose, velocities, solved(bias, wished.rates(2) - bending))


class Misfit(NamedTuple):
    """What a motion lacks.

    Attributes:
        gap: largest constraint residual [m or 1], shape (n,).
        measured: smoothed samples less the motion [m or rad], one column for each signal, shape (n, m).
    """

    gap: Float[Array, " n"]
    measured: Float[Array, "n m"]


def misfit_at(mechanism: IdealMechanism, t: Scalar, pose: Float[Array, "b 7"], wished: MeasuredSignals) -> Misfit:
    """What one pose lacks."""
    still = flat_state(pose, jnp.zeros((mechanism.n_bodies, VELOCITY_SIZE)))
    gap = jnp.max(jnp.abs(evaluated(closing, mechanism.closed, t, still).residual), initial=0.0)
    values = evaluated(measures, mechanism.observed, t, still).values
    return Misfit(gap, _missing(mechanism, pose, values, wished))

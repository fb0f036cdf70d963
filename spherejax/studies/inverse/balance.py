"""The balance of forces of a known motion: efforts of motors and reactions of joints.

    r = M a - g = B u - D^T lambda

M a are the bodies' inertia forces, g all that acts besides joints and motors (weights, gyroscopic moments, force
elements, friction), u the efforts of the motors with the wrenches B, and -D^T lambda what the joints exert. With forces
counted in N and moments over the mechanism's length L,

    Q = 1 - G G^+,    G = D^T C            what no joint can carry
    u = (Q B)^+ Q r                        efforts first, for all that the joints do not carry
    mu = G^+ (B u - r),    lambda = C mu   then reactions
    unbalanced = Q (r - B u)               what neither can carry: zero of a motion that the motors can make

C makes |mu|^2 the sum of the squares of all reactions, |F|^2 + |M|^2/L^2 of each joint on its second body, about its
point. So where efforts are not unique (more motors than degrees of freedom) they are the least ones, whatever the
joints are; and where reactions are not unique (redundant constraints) they are the least ones that go with these
efforts.

Friction in ideal joints depends on the reactions: both are repeated until they agree.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.types import Scalar
from spherejax.physics.state import VELOCITY_SIZE
from spherejax.studies.inverse.kinematics import Motion
from spherejax.studies.inverse.least_squares import pseudoinverse
from spherejax.studies.inverse.mechanism import IdealMechanism
from spherejax.studies.inverse.terms import evaluated, flat_state, forces, joint_rows, measures, rubbing

FRICTION_PASSES = 60
"""Repetitions of friction and reactions; their differences fall by about mu R / (arm of the bodies) each."""

NOT_UNIQUE = 1e-6
"""Share of an effort or a reaction that other solutions may change, from which on it is not unique: rounding leaves
1e-13 of unique ones."""


class Balance(NamedTuple):
    """Forces of one instant, or with a leading axis of instants.

    Attributes:
        efforts: of each motor [N or N m], shape (n_rows,).
        powers: that each motor puts in [W].
        reactions: force [N] and moment [N m] of each joint on its second body, about its point there, shape (6,).
        unbalanced: force [N] and moment about the center of mass [N m] that each body lacks, shape (n_bodies, 6).
        free_efforts: share of each effort that other solutions may change [-].
        free_reactions: the same of each reaction, of force and moment, shape (2,).
        friction_change: change of the reactions by the last repetition with friction, over their size [-].
    """

    efforts: dict[str, Float[Array, "*n k"]]
    powers: dict[str, Float[Array, "*n"]]
    reactions: dict[str, Float[Array, "*n 6"]]
    unbalanced: Float[Array, "*n b 6"]
    free_efforts: dict[str, Float[Array, "*n"]]
    free_reactions: dict[str, Float[Array, "*n 2"]]
    friction_change: Float[Array, "*n"]


def balance_at(mechanism: IdealMechanism, t: Scalar, motion: Motion, memory: Float[Array, " n_memory"]) -> Balance:
    """Efforts and reactions at one instant."""
    system, joints, drivers = mechanism.system, mechanism.joints, mechanism.drivers
    rows = joint_rows(system)
    y = flat_state(motion.pose, motion.velocities, memory)
    known = evaluated(forces, system, t, y)
    motor = evaluated(measures, mechanism.actuated, t, flat_state(motion.pose, motion.velocities))
    # Wrenches count as forces: moments over L.
    counted = mechanism.scales() * mechanism.length
    C = {name: _measure(known.reactions[name], mechanism.length) for name in joints}
    span = {name: C[name].shape[1] for name in joints}
    none = jnp.zeros((len(counted), 0))
    pressed = [known.jacobian[rows[name]].T @ C[name] for name in joints]
    G = counted[:, None] * jnp.concatenate([none, *pressed], 1)
    driven = [known.jacobian[rows[name]].T for name in drivers]
    widths = dict.fromkeys(mechanism.coordinates, 1)
    widths |= {name: rows[name].stop - rows[name].start for name in drivers}
    sizes = _effort_sizes(mechanism, widths)
    B = counted[:, None] * jnp.concatenate([motor.wrenches, *driven], 1) * sizes
    G_inverse = pseudoinverse(G)
    carried = G @ G_inverse
    # As in `constrained_least_squares`: what is rounding in Q B is seen beside the columns of a projector.
    beyond = jnp.concatenate([B - carried @ B, carried], 1)
    B_inverse = pseudoinverse(beyond)[: B.shape[1]]
    required = known.mass @ motion.accelerations.ravel() - known.applied

    def solved(friction):
        right = counted * (required - friction)
        u = B_inverse @ right
        return right, u, G_inverse @ (B @ u - right)

    def multipliers_of(u, mu):
        flat = jnp.zeros(known.jacobian.shape[0])
        for name, part in _split(mu, span).items():
            flat = flat.at[rows[name]].set(C[name] @ part)
        for name, effort in _split(sizes * u, widths).items():
            if name in drivers:
                flat = flat.at[rows[name]].set(-effort)
        return flat

    right, u, mu = solved(jnp.zeros_like(required))
    change, rubbed = jnp.zeros(()), {}
    if system.friction_joints:

        def repeated(_, before_and_now):
            friction = evaluated(rubbing, system, t, (y, multipliers_of(*before_and_now[1])))
            return before_and_now[1], solved(friction.wrenches)[1:]

        before, (u, mu) = jax.lax.fori_loop(0, FRICTION_PASSES, repeated, ((u, mu), (u, mu)))
        size = jnp.max(jnp.abs(mu), initial=0.0)
        change = jnp.max(jnp.abs(mu - before[1]), initial=0.0) / jnp.where(size > 0, size, 1.0)
        friction = evaluated(rubbing, system, t, (y, multipliers_of(u, mu)))
        rubbed = friction.reactions
        right, u, mu = solved(friction.wrenches)
    efforts, multipliers = _split(sizes * u, widths), multipliers_of(u, mu)
    reactions = {name: known.reactions[name] @ multipliers[rows[name]] for name in joints}
    left = right - B @ u
    left = (left - carried @ left) / counted
    rates = _split(motor.rates, dict.fromkeys(mechanism.coordinates, 1))
    rates |= {name: known.jacobian[rows[name]] @ motion.velocities.ravel() for name in drivers}
    return Balance(
        efforts,
        {name: effort @ rates[name] for name, effort in efforts.items()},
        {name: reaction + rubbed.get(name, 0.0) for name, reaction in reactions.items()},
        left.reshape(-1, VELOCITY_SIZE),
        _free_efforts(B_inverse @ beyond[:, : B.shape[1]], widths),
        _free_reactions({name: known.reactions[name] @ C[name] for name in joints}, G_inverse @ G, mechanism.length),
        change,
    )


def _split(values: Float[Array, " n"], widths: dict[str, int]) -> dict[str, Float[Array, " k"]]:
    """A vector by name, from the numbers of entries."""
    ends = np.cumsum([0, *widths.values()])
    return {name: values[ends[i] : ends[i + 1]] for i, name in enumerate(widths)}


def _effort_sizes(mechanism: IdealMechanism, widths: dict[str, int]) -> Float[Array, " k"]:
    """Efforts that count as one newton: 1 N, or L N m."""
    system, length = mechanism.system, mechanism.length
    parts = [jnp.zeros(0)]
    for name, width in widths.items():
        if name in mechanism.coordinates:
            is_moment = mechanism.coordinates[name].is_angle
        else:
            is_moment = system.joints[name].effort_unit == "N m"
        parts.append(jnp.full(width, length) if is_moment else jnp.ones(width))
    return jnp.concatenate(parts)


def _measure(reaction: Float[Array, "6 n"], length: Scalar) -> Float[Array, "n n"]:
    """C of one joint: |mu|^2 = |F|^2 + |M|^2/L^2 for lambda = C mu."""
    counted = jnp.concatenate([jnp.ones(3), jnp.full(3, 1 / length)])
    return jnp.linalg.inv(jnp.linalg.qr(counted[:, None] * reaction)[1])


def _free_efforts(resolution: Float[Array, "k k"], widths: dict[str, int]) -> dict[str, Scalar]:
    """By the resolution (Q B)^+ Q B: an effort that is unique has a row of the identity."""
    free = jnp.max(jnp.abs(jnp.eye(len(resolution)) - resolution), axis=1, initial=0.0)
    return {name: jnp.max(part) for name, part in _split(free, widths).items()}


def _free_reactions(
    reactions: dict[str, Float[Array, "6 n"]], resolution: Float[Array, "m m"], length: Scalar
) -> dict[str, Float[Array, "2"]]:
    """The same of forces, and of moments over L, by each joint's reaction to its entries of mu."""
    null = jnp.eye(len(resolution)) - resolution
    shares, start = {}, 0
    for name, by_entry in reactions.items():
        stop = start + by_entry.shape[1]
        change = jnp.abs(by_entry @ null[start:stop])
        shares[name] = jnp.stack([jnp.max(change[:3]), jnp.max(change[3:]) / length])
        start = stop
    return shares

"""The terms of the equations of motion at a flat state, as arrays over all bodies and all constraint equations.

    [M D^T; D 0] {a; lambda} = {g; gamma - feedback}

Vectors of bodies are flat: for each body, in the order of the state, three entries of translation and three of
rotation, world axes. Vectors of constraint equations have one entry for each equation, in the order of `ConstraintSet`.
Each function is array code `function(system, t, y)`, and reads its values off the functions that make up the right-hand
side: no equation stands here for a second time.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.lanes import over_lanes
from spherejax.foundations.types import Scalar
from spherejax.model.groups import stacks_of
from spherejax.model.system import System
from spherejax.motion.equations.body_motions import BodyMotions, body_motions
from spherejax.motion.equations.constraints import ConstraintSet, constraint_set, velocity_violation
from spherejax.motion.equations.dynamics import evaluate
from spherejax.motion.equations.joint_friction import wrenches_of
from spherejax.motion.equations.loads import applied_wrenches
from spherejax.motion.equations.observables import observe
from spherejax.physics.bodies import Body, inertia_in_world
from spherejax.physics.joints.base import Reaction
from spherejax.physics.kinematics import BodyMotion
from spherejax.physics.state import VELOCITY_SIZE, unpack


class Energies(NamedTuple):
    """Energies at one instant [J].

    Attributes:
        kinetic: of all bodies.
        potential: of weight and force elements.
        elastic: stored in joints: contacts, bushings, bristles.
    """

    kinetic: Scalar
    potential: Scalar
    elastic: Scalar

    @property
    def mechanical(self) -> Scalar:
        """All of them together."""
        return self.kinetic + self.potential + self.elastic


def mass_matrix(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, "k k"]:
    """M: m I and A J A^T of each body on the diagonal [kg, kg m^2]; the kinetic energy is v^T M v / 2."""
    del t
    motions = body_motions(system, unpack(system.layout, y))
    blocks = over_lanes(_mass_block, stacks_of(system).bodies, motions.moving)
    n_bodies = blocks.shape[0]
    spread = blocks[:, :, None, :] * np.eye(n_bodies)[:, None, :, None]
    return spread.reshape(n_bodies * VELOCITY_SIZE, n_bodies * VELOCITY_SIZE)


def _mass_block(body: Body, motion: BodyMotion) -> Float[Array, "6 6"]:
    zeros = jnp.zeros((3, 3))
    inertia = inertia_in_world(body.inertia, motion.rotation)
    return jnp.block([[body.mass * jnp.eye(3), zeros], [zeros, inertia]])


def velocities(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " k"]:
    """v: velocity [m/s] and angular velocity [rad/s] of each body."""
    del t
    return y[system.layout.n_position : system.layout.memory_start]


def constraint_residual(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " n"]:
    """Phi [m or 1]."""
    return _constraints(system, t, y)[0].residual


def constraint_rate(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " n"]:
    """Phi_dot = D v + Phi_t [m/s or 1/s]."""
    return velocity_violation(*_constraints(system, t, y))


def constraint_rate_at_rest(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " n"]:
    """Phi_t: what the residual changes with time alone [m/s or 1/s]; zero for joints that are not driven."""
    return _constraints(system, t, y)[0].rate_at_rest


def constraint_bias(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " n"]:
    """gamma: accelerations satisfy D a = gamma - feedback [m/s^2 or 1/s^2]."""
    return _constraints(system, t, y)[0].bias


def constraint_feedback(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " n"]:
    """The feedback of the drift control [m/s^2 or 1/s^2]: 2 alpha Phi_dot + beta^2 Phi for Baumgarte, else 0."""
    constraints, motions = _constraints(system, t, y)
    return system.drift.acceleration_feedback(constraints.residual, velocity_violation(constraints, motions))


def constraint_jacobian(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, "n k"]:
    """D: Phi_dot = D v + Phi_t."""
    return dense_jacobian(_constraints(system, t, y)[0])


def dense_jacobian(constraints: ConstraintSet) -> Float[Array, "n k"]:
    """D as one array, its rows in the order of the constraint set."""
    n_bodies = len(constraints.names)
    rows = [jnp.zeros((0, n_bodies * VELOCITY_SIZE))]
    for row_group in constraints.groups:
        dense = jnp.zeros(())
        for jacobian, ends in zip(
            row_group.rows.jacobians, (row_group.group.first, row_group.group.second), strict=True
        ):
            # Bodies are counted from 1; the ground, 0, has no column.
            places = np.eye(n_bodies + 1)[np.asarray(ends)][:, 1:]
            dense = dense + jacobian[:, :, None, :] * places[:, None, :, None]
        rows.append(dense.reshape(-1, n_bodies * VELOCITY_SIZE))
    return jnp.concatenate(rows)


def _constraints(system: System, t: Scalar, y: Float[Array, " size"]) -> tuple[ConstraintSet, BodyMotions]:
    motions = body_motions(system, unpack(system.layout, y))
    return constraint_set(system, t, motions), motions


def applied_forces(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " k"]:
    """g [N, N m]: weights, gyroscopic moments, force elements, joints that answer with a force, friction.

    Friction in ideal joints depends on the multipliers; g holds what it is under those that `evaluate` returns.
    """
    evaluation = evaluate(system, t, y)
    wrenches = applied_wrenches(system, t, evaluation.motions, evaluation.state.memory, evaluation.loads)
    if evaluation.friction is not None:
        wrenches = wrenches + wrenches_of(system, evaluation.friction.groups)
    return wrenches.ravel()


def accelerations(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " k"]:
    """a: linear [m/s^2] and angular [rad/s^2] acceleration of each body."""
    return evaluate(system, t, y).solution.accelerations.ravel()


def lagrange_multipliers(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " n"]:
    """lambda: the constraints exert -D^T lambda on the bodies."""
    return evaluate(system, t, y).solution.flat


def joint_reactions(system: System, t: Scalar, y: Float[Array, " size"]) -> dict[str, Reaction]:
    """Force [N] and moment [N m] of each joint on its second body."""
    return observe(system, t, y).reactions


def energies(system: System, t: Scalar, y: Float[Array, " size"]) -> Energies:
    """Kinetic, potential and elastic energy."""
    observation = observe(system, t, y)
    elastic = sum(observation.elastic_energy.values(), jnp.zeros(()))
    return Energies(observation.kinetic_energy, observation.potential_energy, elastic)


def constraint_rows(system: System, t: Scalar, y: Float[Array, " size"]) -> dict[str, slice]:
    """Which entries of a vector of constraint equations belong to each joint (static)."""
    return rows_of_joints(_constraints(system, t, y)[0])


def rows_of_joints(constraints: ConstraintSet) -> dict[str, slice]:
    """The same of a constraint set."""
    places, start = {}, 0
    for row_group in constraints.groups:
        for name in row_group.group.names:
            places[name] = slice(start, start + row_group.shape[1])
            start += row_group.shape[1]
    return places

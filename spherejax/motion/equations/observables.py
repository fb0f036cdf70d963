"""What can be observed of a motion besides the state: accelerations, reactions, energies, constraint violation."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.lanes import over_lanes
from spherejax.foundations.types import Scalar, Vector3
from spherejax.model.groups import JointGroup, stacks_of
from spherejax.model.system import System
from spherejax.motion.equations.body_motions import BodyMotions, between, body_motions
from spherejax.motion.equations.constraints import velocity_violation
from spherejax.motion.equations.dynamics import SolvedEquations, evaluate
from spherejax.motion.equations.joint_friction import constraint_reaction, resistances
from spherejax.motion.equations.loads import memory_of_each
from spherejax.physics.bodies import Body
from spherejax.physics.forces.base import power_on_bodies
from spherejax.physics.forces.remembering import ActingForce
from spherejax.physics.joints.base import Reaction
from spherejax.physics.joints.spherical import PlacedSpherical
from spherejax.physics.kinematics import BodyMotion, RelativeMotion
from spherejax.physics.state import unpack


class Observation(NamedTuple):
    """Observables at one instant.

    Attributes:
        acceleration: of the centers of mass, world axes [m/s^2], shape (n_bodies, 3).
        angular_acceleration: world axes [rad/s^2], shape (n_bodies, 3).
        reactions: by joint.
        driving_effort: torque [N m] or force [N] of each driver on its second body, along what it prescribes, shape
            (n_rows,), by joint.
        driving_power: power that each driver puts into the mechanism [W], by joint.
        eccentricity: socket center to ball center, world axes [m], by spherical joint.
        eccentricity_rate: its time derivative [m/s].
        parts: named contributions of the joints that answer with a force or have friction, by joint.
        elastic_energy: stored in each of these joints [J], by joint.
        forces: named results of the force elements, by element, each with `power` on the bodies [W] and
            `potential_energy` [J].
        kinetic_energy: of all bodies [J].
        potential_energy: of weight and force elements [J].
        constraint_violation: largest entry of |Phi| [m or 1].
        velocity_violation: largest entry of |Phi_dot| [m/s or 1/s].
    """

    acceleration: Float[Array, "b 3"]
    angular_acceleration: Float[Array, "b 3"]
    reactions: dict[str, Reaction]
    driving_effort: dict[str, Array]
    driving_power: dict[str, Scalar]
    eccentricity: dict[str, Vector3]
    eccentricity_rate: dict[str, Vector3]
    parts: dict[str, dict[str, Array]]
    elastic_energy: dict[str, Scalar]
    forces: dict[str, dict[str, Array]]
    kinetic_energy: Scalar
    potential_energy: Scalar
    constraint_violation: Scalar
    velocity_violation: Scalar


def observe(system: System, t: Scalar, y: Float[Array, " size"]) -> Observation:
    """All observables at one state."""
    evaluation = evaluate(system, t, y)
    accelerations = evaluation.solution.accelerations
    relative = _relative_motions(system, evaluation)
    position_violation, velocity_violation = _violations(evaluation)
    driven = [name for name, joint in system.joints.items() if joint.is_driven]
    forces = system.forces_with(evaluation.state.memory)
    return Observation(
        acceleration=accelerations[:, :3],
        angular_acceleration=accelerations[:, 3:],
        reactions=_reactions(evaluation),
        driving_effort={name: -evaluation.solution.multipliers[name] for name in driven},
        driving_power={name: _driving_power(evaluation, name) for name in driven},
        eccentricity={name: motion.eccentricity for name, motion in relative.items()},
        eccentricity_rate={name: motion.eccentricity_rate for name, motion in relative.items()},
        parts=_parts(evaluation),
        elastic_energy=_elastic_energies(system, evaluation),
        kinetic_energy=kinetic_energy(system, evaluation.motions),
        forces={name: _force_results(force, t, evaluation) for name, force in forces.items()},
        potential_energy=potential_energy(system, t, evaluation.motions, evaluation.state.memory),
        constraint_violation=position_violation,
        velocity_violation=velocity_violation,
    )


def _relative_motions(system: System, evaluation: SolvedEquations) -> dict[str, RelativeMotion]:
    """Motion of ball in socket of each spherical joint."""
    found = {}
    for group in stacks_of(system).joints:
        if isinstance(group.joint, PlacedSpherical):
            found |= _by_name(group, over_lanes(_relative_motion, group.joint, *evaluation.motions.of_ends(group)))
    return {name: found[name] for name in system.joints if name in found}


def _relative_motion(joint: PlacedSpherical, first: BodyMotion, second: BodyMotion) -> RelativeMotion:
    return joint.relative_motion(between(first, second))


def looked_up(system: System, y: Float[Array, " size"]) -> dict[str, dict[str, Array]]:
    """Named parts of the spherical joints that are found only where someone looks, by joint; see `observed`."""
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    found = {}
    for group in stacks_of(system).joints:
        if group.joint.answers_with_force:
            memory = memory_of_each(system, group, state.memory)
            found |= _by_name(group, over_lanes(_looked_up, group.joint, *motions.of_ends(group), memory))
    return dict(sorted(found.items()))


def _looked_up(joint: PlacedSpherical, first: BodyMotion, second: BodyMotion, memory) -> dict[str, Array]:
    return joint.model.observed(joint.relative_motion(between(first, second)), memory)


def _reactions(evaluation: SolvedEquations) -> dict[str, Reaction]:
    """What each joint exerts on its second body."""
    constraints = evaluation.constraints
    found = {}
    for rows, multipliers in zip(constraints.groups, constraints.by_group(evaluation.solution.flat), strict=True):
        second = evaluation.motions.at(rows.group.second)
        reaction = over_lanes(constraint_reaction, rows.group.joint, second, rows.rows.jacobians[1], multipliers)
        found |= _by_name(rows.group, reaction)
    for loads in evaluation.loads.groups:
        response = loads.load.response
        for name, reaction in _by_name(loads.group, Reaction(response.force, response.ball_moment)).items():
            # A journal is held by equations along its bearing, and by a force across it.
            held = found.get(name)
            found[name] = reaction if held is None else jax.tree.map(jnp.add, held, reaction)
    for name, each in resistances(() if evaluation.friction is None else evaluation.friction.groups).items():
        force, moment = found[name]
        found[name] = Reaction(force + each.resistance.force, moment + each.resistance.moment)
    return dict(sorted(found.items()))


def _parts(evaluation: SolvedEquations) -> dict[str, dict[str, Array]]:
    parts = {name: load.response.parts for name, load in evaluation.loads.items()}
    return parts if evaluation.friction is None else dict(sorted((parts | evaluation.friction.parts()).items()))


def _elastic_energies(system: System, evaluation: SolvedEquations) -> dict[str, Scalar]:
    stored = {name: load.response.elastic_energy for name, load in evaluation.loads.items()}
    if evaluation.friction is not None:
        rubbing = resistances(evaluation.friction.groups)
        stored |= {name: each.resistance.bristle_energy for name, each in rubbing.items()}
    return {name: stored[name] for name in system.resisting_joints}


def _by_name(group: JointGroup, stacked: Any) -> dict[str, Any]:
    return {name: jax.tree.map(lambda x, i=i: x[i], stacked) for i, name in enumerate(group.names)}


def _driving_power(evaluation: SolvedEquations, name: str) -> Scalar:
    """-(D^T lambda).v = lambda.Phi_t, for D v = -Phi_t."""
    return evaluation.solution.multipliers[name] @ evaluation.constraints.rows[name].rate_at_rest


def kinetic_energy(system: System, motions: BodyMotions) -> Scalar:
    """Kinetic energy of all bodies [J]."""
    return jnp.sum(over_lanes(_kinetic_energy, stacks_of(system).bodies, motions.moving))


def _kinetic_energy(body: Body, motion: BodyMotion) -> Scalar:
    # In body axes: a third of the operations that the inertia in world axes takes, and every step is audited.
    w = motion.rotation.T @ motion.angular_velocity
    rotational = w @ (body.inertia * w if jnp.ndim(body.inertia) == 1 else body.inertia @ w)
    return (body.mass * (motion.velocity @ motion.velocity) + rotational) / 2


def _force_results(force: ActingForce, t: Scalar, evaluation: SolvedEquations) -> dict[str, Array]:
    motions = evaluation.motions
    power = power_on_bodies(force.wrenches(t, motions), motions)
    return {**force.parts(t, motions), "power": power, "potential_energy": force.potential_energy(t, motions)}


def potential_energy(
    system: System, t: Scalar, motions: BodyMotions, memory: Float[Array, " n_memory"], *, of_all: bool = True
) -> Scalar:
    """Potential energy of weight and force elements [J].

    Args:
        system: the system.
        t: time [s].
        motions: motion of each body.
        memory: of joints and force elements.

    Other args:
        of_all: False leaves out elements that may add energy.
    """
    total = weight_energy(system, motions)
    for force in system.forces_with(memory).values():
        if of_all or force.never_adds_energy:
            total = total + force.potential_energy(t, motions)
    return total


def weight_energy(system: System, motions: BodyMotions) -> Scalar:
    """Potential energy of the bodies' weights [J]."""
    return jnp.sum(over_lanes(_weight_energy, stacks_of(system).bodies, motions.moving, shared=(system.gravity,)))


def _weight_energy(gravity: Vector3, body: Body, motion: BodyMotion) -> Scalar:
    return -body.mass * (gravity @ motion.position)


def _violations(evaluation: SolvedEquations) -> tuple[Scalar, Scalar]:
    constraints = evaluation.constraints
    if not constraints.groups:
        return jnp.zeros(()), jnp.zeros(())
    rates = velocity_violation(constraints, evaluation.motions)
    return jnp.max(jnp.abs(constraints.residual)), jnp.max(jnp.abs(rates))

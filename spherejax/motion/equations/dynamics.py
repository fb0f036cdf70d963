"""The right-hand side of the equations of motion, and what else can be read off the same evaluation."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.lanes import over_lanes
from spherejax.foundations.rotation import quaternion_rate
from spherejax.foundations.types import Number, Quaternion, Scalar, Vector3
from spherejax.model.system import System
from spherejax.motion.equations.body_motions import BodyMotions, body_motions
from spherejax.motion.equations.constraints import ConstraintSet, Solution, constrained_accelerations, constraint_set
from spherejax.motion.equations.joint_friction import FrictionGroup, JointFriction, resistances, solution_with_friction
from spherejax.motion.equations.loads import (
    BodyVectors,
    JointLoads,
    applied_wrenches,
    force_memory_rates,
    joint_loads,
    supplied_power,
)
from spherejax.physics.kinematics import BodyMotion
from spherejax.physics.state import State, unpack


class SolvedEquations(NamedTuple):
    """One evaluation of the equations of motion.

    Attributes:
        state: the state by name.
        motions: motion of each body, the ground included.
        loads: joints that answer with a force.
        constraints: constraint equations.
        solution: accelerations and multipliers.
        friction: of the ideal joints; None where none has some.
    """

    state: State
    motions: BodyMotions
    loads: JointLoads
    constraints: ConstraintSet
    solution: Solution
    friction: JointFriction | None = None


def evaluate(system: System, t: Scalar, y: Float[Array, " size"]) -> SolvedEquations:
    """Evaluate the equations of motion at a flat state."""
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    loads = joint_loads(system, motions, state.memory)
    applied = applied_wrenches(system, t, motions, state.memory, loads)
    constraints = constraint_set(system, t, motions)
    if not system.friction_joints:
        solution = constrained_accelerations(system, motions, constraints, applied)
        return SolvedEquations(state, motions, loads, constraints, solution)
    solution, friction = solution_with_friction(system, motions, state.memory, constraints, applied)
    return SolvedEquations(state, motions, loads, constraints, solution, friction)


def state_rate(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " size"]:
    """Time derivative of the flat state: the right-hand side that is integrated."""
    state, motions, loads, constraints, solution, friction = evaluate(system, t, y)
    groups = () if friction is None else friction.groups
    parts = [
        over_lanes(_position_rate, motions.moving, shared=(system.drift.norm_feedback,)).ravel(),
        solution.accelerations.ravel(),
        memory_rates(system, t, motions, state.memory, loads, groups),
    ]
    works = work_rates(system, t, motions, state.memory, loads, groups, constraints, solution.flat, solution.wrenches)
    return jnp.concatenate([*parts, *works])


def memory_rates(
    system: System,
    t: Scalar,
    motions: BodyMotions,
    memory: Float[Array, " n_memory"],
    loads: JointLoads,
    friction: tuple[FrictionGroup, ...],
) -> Float[Array, " n_memory"]:
    """Rates of the memory of joints, then of force elements, in the order of the state."""
    of_joints = _joint_memory_rates(system, loads, friction)
    if not system.force_slots:
        return of_joints
    return jnp.concatenate([of_joints, force_memory_rates(system, t, motions, memory)])


def _joint_memory_rates(system: System, loads: JointLoads, friction: tuple[FrictionGroup, ...]) -> Array:
    if not friction:
        return loads.memory_rates
    rates = {name: load.response.memory_rate for name, load in loads.items()}
    rates |= {name: each.resistance.memory_rate for name, each in resistances(friction).items()}
    return jnp.concatenate([jnp.zeros(0), *(rates[slot.joint] for slot in system.memory_slots)])


def work_rates(
    system: System,
    t: Scalar,
    motions: BodyMotions,
    memory: Float[Array, " n_memory"],
    loads: JointLoads,
    friction: tuple[FrictionGroup, ...],
    constraints: ConstraintSet,
    multipliers: Array,
    wrenches: BodyVectors | None,
) -> list[Array]:
    """Rates of the work entries [W], in the order of the state.

    They are the power that each joint absorbs; that of the constraint forces, -(D^T lambda).v, less what drivers put
    in; and that which parts that may add energy put in. Without `wrenches`, D^T lambda, the second counts as zero.
    """
    if not friction:
        rates = [loads.absorbed_powers] if system.tracks_work else []
    else:
        powers = {name: load.absorbed_power for name, load in loads.items()}
        powers |= {name: each.absorbed_power for name, each in resistances(friction).items()}
        rates = [jnp.stack([powers[name] for name in system.resisting_joints])] if system.tracks_work else []
    # -(D^T lambda).v = lambda.Phi_t in an exact motion, for D v = -Phi_t.
    driving = multipliers @ constraints.rate_at_rest if system.is_driven else jnp.zeros(())
    if system.tracks_constraint_work:
        if wrenches is None:
            rates.append(jnp.zeros(1))
        else:
            velocities = jnp.concatenate([motions.moving.velocity, motions.moving.angular_velocity], 1)
            rates.append((-jnp.sum(wrenches * velocities) - driving)[None])
    if system.tracks_supply:
        for name, each in resistances(friction).items():
            if not system.joints[name].never_adds_energy:
                driving = driving - each.absorbed_power
        rates.append(supplied_power(system, t, motions, memory, loads, driving)[None])
    return rates


def _position_rate(norm_feedback: Scalar, motion: BodyMotion) -> Float[Array, "7"]:
    turning = orientation_rate(norm_feedback, motion.quaternion, motion.angular_velocity)
    return jnp.concatenate([motion.velocity, turning])


def orientation_rate(norm_feedback: Number, quaternion: Quaternion, angular_velocity: Vector3) -> Float[Array, "4"]:
    """Quaternion rate; feedback pulls the quaternion to unit norm like any other constraint."""
    excess = quaternion @ quaternion - 1
    return quaternion_rate(quaternion, angular_velocity) - norm_feedback * excess * quaternion

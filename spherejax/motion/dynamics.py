"""The right-hand side of the equations of motion, and what else can be read off the same evaluation."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.rotation import quaternion_rate
from spherejax.foundations.types import Quaternion, Scalar, Vector3
from spherejax.model.system import System
from spherejax.motion.constraints import ConstraintSet, Solution, constrained_accelerations, constraint_set
from spherejax.motion.loads import JointLoad, applied_wrenches, joint_loads
from spherejax.physics.bodies import GROUND
from spherejax.physics.kinematics import BodyMotion, body_motion, ground_motion
from spherejax.physics.state import State, unpack


class Evaluation(NamedTuple):
    """One evaluation of the equations of motion.

    Attributes:
        state: the state by name.
        motions: motion of each body, the ground included.
        loads: joints that answer with a force.
        constraints: constraint equations.
        solution: accelerations and multipliers.
    """

    state: State
    motions: dict[str, BodyMotion]
    loads: dict[str, JointLoad]
    constraints: ConstraintSet
    solution: Solution


def body_motions(system: System, state: State) -> dict[str, BodyMotion]:
    """Motion of each body by name, the ground included."""
    motions = {
        name: body_motion(state.position[i], state.quaternion[i], state.velocity[i], state.angular_velocity[i])
        for i, name in enumerate(system.bodies)
    }
    return {GROUND: ground_motion(), **motions}


def evaluate(system: System, t: Scalar, y: Float[Array, " size"]) -> Evaluation:
    """Evaluate the equations of motion at a flat state."""
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    loads = joint_loads(system, motions, state.memory)
    applied = applied_wrenches(system, t, motions, loads)
    constraints = constraint_set(system, t, motions)
    solution = constrained_accelerations(system, motions, constraints, applied)
    return Evaluation(state, motions, loads, constraints, solution)


def state_rate(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " size"]:
    """Time derivative of the flat state: the right-hand side that is integrated."""
    evaluation = evaluate(system, t, y)
    return jnp.concatenate(
        [
            *(_position_rate(system, evaluation, name) for name in system.bodies),
            *evaluation.solution.accelerations.values(),
            *(load.response.memory_rate for load in evaluation.loads.values()),
            *([load.absorbed_power[None] for load in evaluation.loads.values()] if system.tracks_work else []),
        ]
    )


def _position_rate(system: System, evaluation: Evaluation, name: str) -> Float[Array, "7"]:
    motion = evaluation.motions[name]
    return jnp.concatenate([motion.velocity, orientation_rate(system, motion.quaternion, motion.angular_velocity)])


def orientation_rate(system: System, quaternion: Quaternion, angular_velocity: Vector3) -> Float[Array, "4"]:
    """Quaternion rate; feedback pulls the quaternion to unit norm like any other constraint."""
    excess = quaternion @ quaternion - 1
    return quaternion_rate(quaternion, angular_velocity) - system.drift.norm_feedback * excess * quaternion

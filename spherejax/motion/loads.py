"""What acts on the bodies besides the constraints: weight, gyroscopic moments, force elements, joints with a force."""

from typing import NamedTuple

import jax.numpy as jnp

from spherejax.foundations.types import Scalar
from spherejax.model.system import System
from spherejax.physics.bodies import inertia_in_world
from spherejax.physics.forces import Wrench
from spherejax.physics.joints import PlacedSpherical, Response
from spherejax.physics.kinematics import BodyMotion

Wrenches = dict[str, Wrench]
"""Wrench on each moving body by name, about its center of mass."""


class JointLoad(NamedTuple):
    """A joint's answer, and the wrenches that it puts on the two bodies.

    Attributes:
        response: the model's answer.
        wrenches: on the socket's and the ball's body.
        absorbed_power: power that the joint takes from the bodies [W].
    """

    response: Response
    wrenches: Wrenches
    absorbed_power: Scalar


def joint_load(joint: PlacedSpherical, motions: dict[str, BodyMotion], memory) -> JointLoad:
    """Move a model's forces from the centers of ball and socket to the bodies' centers of mass."""
    response = joint.respond(motions, memory)
    socket_center, ball_center = joint.centers(motions)
    socket_name, ball_name = joint.bodies
    wrenches = {
        socket_name: Wrench(-response.force, response.socket_moment - jnp.cross(socket_center.arm, response.force)),
        ball_name: Wrench(response.force, response.ball_moment + jnp.cross(ball_center.arm, response.force)),
    }
    absorbed_power = -(
        response.force @ (ball_center.velocity - socket_center.velocity)
        + response.ball_moment @ motions[ball_name].angular_velocity
        + response.socket_moment @ motions[socket_name].angular_velocity
    )
    return JointLoad(response, wrenches, absorbed_power)


def joint_loads(system: System, motions: dict[str, BodyMotion], memory) -> dict[str, JointLoad]:
    """Loads of the joints that answer with a force, by name."""
    return {
        name: joint_load(system.spherical(name), motions, memory[system.memory_of(name)])
        for name in system.force_joints
    }


def applied_wrenches(
    system: System, t: Scalar, motions: dict[str, BodyMotion], loads: dict[str, JointLoad]
) -> Wrenches:
    """Sum of all that acts on each moving body: the vector g of Eq. 1, with the gyroscopic moment -w x (J w)."""
    total = {name: _weight_and_gyroscopic(system, name, motions[name]) for name in system.bodies}
    contributions = [force.wrenches(t, motions) for force in system.forces.values()]
    contributions += [load.wrenches for load in loads.values()]
    for wrenches in contributions:
        for name, wrench in wrenches.items():
            if name in total:
                total[name] = Wrench(total[name].force + wrench.force, total[name].moment + wrench.moment)
    return total


def _weight_and_gyroscopic(system: System, name: str, motion: BodyMotion) -> Wrench:
    body = system.bodies[name]
    angular_momentum = inertia_in_world(body.inertia, motion.rotation) @ motion.angular_velocity
    return Wrench(body.mass * system.gravity, -jnp.cross(motion.angular_velocity, angular_momentum))

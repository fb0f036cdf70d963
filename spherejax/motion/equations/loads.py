"""What acts on the bodies besides the constraints: weight, gyroscopic moments, force elements, joints with a force."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.lanes import over_lanes, rows_at, sums_by_index
from spherejax.foundations.types import Scalar, Vector3
from spherejax.model.groups import FIRST, SECOND, JointGroup, stacks_of
from spherejax.model.system import System
from spherejax.motion.equations.body_motions import BodyMotions, between
from spherejax.physics.bodies import Body, gyroscopic_moment
from spherejax.physics.forces.base import power_on_bodies
from spherejax.physics.joints.base import Response
from spherejax.physics.kinematics import BodyMotion

BodyVectors = Float[Array, "b 6"]
"""A wrench [N, N m], a velocity or an acceleration of each moving body, world axes."""


class JointLoad(NamedTuple):
    """A joint's answer, and the wrenches that it puts on the two bodies.

    Attributes:
        response: the model's answer.
        wrenches: on the socket's and the ball's body, about their centers of mass [N, N m], shape (2, 6).
        absorbed_power: power that the joint takes from the bodies [W].
    """

    response: Response
    wrenches: Float[Array, "2 6"]
    absorbed_power: Scalar


class LoadGroup(NamedTuple):
    """Loads of joints of one kind.

    Attributes:
        group: the joints.
        load: their loads, with a leading axis of joints.
    """

    group: JointGroup
    load: JointLoad


class JointLoads(Mapping[str, JointLoad]):
    """Loads of the joints that answer with a force, by name.

    Attributes:
        groups: the loads by kind of joint.
    """

    def __init__(self, order: tuple[str, ...], groups: tuple[LoadGroup, ...]):
        self._order = order
        self._places = {n: (g, i) for g, found in enumerate(groups) for i, n in enumerate(found.group.names)}
        self.groups = groups

    def __getitem__(self, name: str) -> JointLoad:
        group, i = self._places[name]
        return jax.tree.map(lambda x: x[i], self.groups[group].load)

    def __iter__(self) -> Iterator[str]:
        return iter(self._order)

    def __len__(self) -> int:
        return len(self._order)

    @property
    def memory_rates(self) -> Float[Array, " n_memory"]:
        """Rates of the joints' memory, in the order of the state."""
        return self._in_order([found.load.response.memory_rate for found in self.groups])

    @property
    def absorbed_powers(self) -> Float[Array, " n_joints"]:
        """Power that each joint takes from the bodies [W]."""
        return self._in_order([found.load.absorbed_power[:, None] for found in self.groups])

    def _in_order(self, parts: list[Float[Array, "k m"]]) -> Float[Array, " n"]:
        """Numbers of each joint, given by kind, joint after joint."""
        starts = np.cumsum([0, *(part.size for part in parts)])
        widths = [part.shape[1] for part in parts]
        source = [
            starts[group] + widths[group] * i + np.arange(widths[group])
            for group, i in (self._places[name] for name in self._order)
        ]
        flat = jnp.concatenate([jnp.zeros(0), *(part.ravel() for part in parts)])
        return rows_at(flat, np.concatenate([np.zeros(0, int), *source]))


def _joint_load(joint: Any, first: BodyMotion, second: BodyMotion, memory) -> JointLoad:
    """Move a model's forces from the centers of ball and socket to the bodies' centers of mass."""
    motions = between(first, second)
    response = joint.respond(motions, memory)
    socket, ball = joint.centers(motions)
    on_socket = _wrench(-response.force, response.socket_moment - jnp.cross(socket.arm, response.force))
    on_ball = _wrench(response.force, response.ball_moment + jnp.cross(ball.arm, response.force))
    absorbed_power = -(
        response.force @ (ball.velocity - socket.velocity)
        + response.ball_moment @ motions[SECOND].angular_velocity
        + response.socket_moment @ motions[FIRST].angular_velocity
    )
    return JointLoad(response, jnp.stack([on_socket, on_ball]), absorbed_power)


def _wrench(force: Vector3, moment: Vector3) -> Float[Array, "6"]:
    return jnp.concatenate([force, moment])


def memory_of_each(system: System, group: JointGroup, memory: Float[Array, " n_memory"]) -> Float[Array, "k m"]:
    """What each joint of a group remembers, joint after joint."""
    slots = [system.memory_of(name) for name in group.names]
    entries = np.array([np.arange(slot.start, slot.stop) for slot in slots], int)
    return rows_at(memory, entries.ravel()).reshape(entries.shape)


def joint_loads(system: System, motions: BodyMotions, memory: Float[Array, " n_memory"]) -> JointLoads:
    """Loads of the joints that answer with a force."""
    found = []
    for group in stacks_of(system).joints:
        if group.joint.answers_with_force:
            remembered = memory_of_each(system, group, memory)
            load = over_lanes(_joint_load, group.joint, *motions.of_ends(group), remembered)
            found.append(LoadGroup(group, load))
    return JointLoads(system.force_joints, tuple(found))


def applied_wrenches(
    system: System, t: Scalar, motions: BodyMotions, memory: Float[Array, " n_memory"], loads: JointLoads | None
) -> BodyVectors:
    """Sum of all that acts on each moving body: the vector g of Eq. 1, with the gyroscopic moment -w x (J w)."""
    own = over_lanes(_weight_and_gyroscopic, stacks_of(system).bodies, motions.moving, shared=(system.gravity,))
    number = {name: i for i, name in enumerate(system.bodies)}
    wrenches, targets = [], []
    for force in system.forces_with(memory).values():
        for name, wrench in force.wrenches(t, motions).items():
            if name in number:
                wrenches.append(_wrench(wrench.force, wrench.moment)[None])
                targets.append(number[name])
    for found in loads.groups if loads is not None else ():
        wrenches.append(found.load.wrenches.reshape(-1, 6))
        targets.extend(i - 1 for ends in zip(found.group.first, found.group.second, strict=True) for i in ends)
    if not wrenches:
        return own
    return own + sums_by_index(jnp.concatenate(wrenches), np.array(targets), len(number))


def force_memory_rates(system: System, t: Scalar, motions: BodyMotions, memory: Float[Array, " n_memory"]) -> Array:
    """Rates of the memory of force elements, in the order of the state."""
    forces: Any = system.forces_with(memory)
    rates = (forces[slot.joint].memory_rate(t, motions) for slot in system.force_slots)
    return jnp.concatenate([jnp.zeros(0), *rates])


def supplied_power(
    system: System,
    t: Scalar,
    motions: BodyMotions,
    memory: Float[Array, " n_memory"],
    loads: JointLoads,
    driving: Scalar,
) -> Scalar:
    """Power that all parts that may add energy put into the mechanism [W].

    Args:
        system: the system.
        t: time [s].
        motions: motion of each body.
        memory: of joints and force elements.
        loads: joints that answer with a force.
        driving: power of the drivers [W].
    """
    for force in system.forces_with(memory).values():
        if not force.never_adds_energy:
            driving = driving + power_on_bodies(force.wrenches(t, motions), motions)
    for name in loads:
        if not system.joints[name].never_adds_energy:
            driving = driving - loads[name].absorbed_power
    return driving


def by_body(system: System, vectors: BodyVectors) -> dict[str, Float[Array, "6"]]:
    """Vectors of the bodies by name."""
    return {name: vectors[i] for i, name in enumerate(system.bodies)}


def _weight_and_gyroscopic(gravity: Vector3, body: Body, motion: BodyMotion) -> Float[Array, "6"]:
    turning = gyroscopic_moment(body.inertia, motion.rotation, motion.angular_velocity)
    return _wrench(body.mass * gravity, turning)

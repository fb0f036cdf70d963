"""A mechanism's Jacobian reduced to its joint forces: what is stiff is of low rank.

The state is (q, v) and memory and work: positions q with q_dot = T v, velocities v. A joint that answers with a force
answers through u = (force, ball moment), six numbers that depend on six changes of relative motion: of eccentricity,
of the orientations of socket and ball, and of their rates. With F the fields (e, theta_s, theta_b) and their rates of
a change of the bodies' motion, K = du/dF, and U the accelerations by a unit of u (constraints obeyed),

    J ~ [0, T; U K F_q, U K F_v]

leaves out what is not stiff: gyroscopic moments, weight, geometry of the constraints and their drift control, force
elements, and all of memory and work. A W-method keeps its order with it. The stage (I - gamma h J) k = rhs is then

    (I - gamma h K (F_v + gamma h F_q T) U) du = K (F_q rhs_q + (F_v + gamma h F_q T) rhs_v)
    k_v = rhs_v + gamma h U du,    k_q = rhs_q + gamma h T k_v

with six unknowns for each joint, and fewer where the model leaves structural zeros (three without a moment).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.linear_algebra import general_solve
from spherejax.foundations.rotation import quaternion_rate, skew
from spherejax.foundations.types import Scalar, Vector3
from spherejax.model.system import System
from spherejax.motion.equations.body_motions import BodyMotions, body_motions
from spherejax.motion.equations.constraints import ConstraintSet, constraint_set, inverse_masses, solve_augmented
from spherejax.motion.equations.mobility import InverseMass
from spherejax.physics.bodies import GROUND
from spherejax.physics.joints.spherical import PlacedSpherical
from spherejax.physics.kinematics import RelativeMotion
from spherejax.physics.state import POSITION_SIZE, VELOCITY_SIZE, State, unpack

ANSWER_SIZE = 6
"""Entries of u: force and ball moment."""

FIELD_SIZE = 9
"""Entries of the position-like fields, and of their rates: eccentricity, rotation of the socket, of the ball."""

Vectors = dict[str, Float[Array, "6 *k"]]
"""Displacement and rotation, or the rates of both, of each moving body by name; one or several as columns."""


class Here(NamedTuple):
    """The mechanism at the state where it is linearized.

    Attributes:
        system: the system.
        state: the state by name.
        motions: motion of each body, the ground included.
        constraints: constraint equations.
        masses: inverse mass matrix.
    """

    system: System
    state: State
    motions: BodyMotions
    constraints: ConstraintSet
    masses: InverseMass


def mechanism_at(system: System, t: Scalar, y: Float[Array, " size"]) -> Here:
    """Motions, constraints and masses at a flat state."""
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    return Here(system, state, motions, constraint_set(system, t, motions), inverse_masses(system, motions))


# One joint -----------------------------------------------------------------------------------------------------------


class JointChange(NamedTuple):
    """Change of a joint's relative motion.

    Attributes:
        positions: of eccentricity, and rotations of socket and ball, shape (9, *k).
        rates: of the rates of these, shape (9, *k).
    """

    positions: Float[Array, "9 *k"]
    rates: Float[Array, "9 *k"]


def joint_rates(here: Here, name: str, velocities: Vectors) -> Float[Array, "9 *k"]:
    """F_v: rates of eccentricity and of the rotations of socket and ball, by velocities of the bodies."""
    (socket, ball), (socket_arm, ball_arm) = _bodies_and_arms(here, name)
    socket_part, ball_part = _of(velocities, socket), _of(velocities, ball)
    eccentricity_rate = _point(ball_part, ball_arm) - _point(socket_part, socket_arm)
    return jnp.concatenate([eccentricity_rate, socket_part[3:], ball_part[3:]])


def joint_change(here: Here, name: str, positions: Vectors, velocities: Vectors) -> JointChange:
    """F: change of a joint's relative motion by changes of the positions and velocities of its bodies."""
    (socket, ball), (socket_arm, ball_arm) = _bodies_and_arms(here, name)
    turned = _turned_rate(here, ball, ball_arm, positions) - _turned_rate(here, socket, socket_arm, positions)
    rates = joint_rates(here, name, velocities)
    return JointChange(joint_rates(here, name, positions), jnp.concatenate([rates[:3] + turned, rates[3:]]))


def joint_slopes(here: Here, name: str) -> tuple[Float[Array, "6 9"], Float[Array, "6 9"]]:
    """K: derivatives of u by the position-like fields and by their rates."""
    joint = here.system.spherical(name)
    motion, memory = joint.motion_of_centers(here.motions), here.state.memory[here.system.memory_of(name)]

    def answer(positions, rates):
        response = joint.model.respond(_moved(joint, here.motions, motion, positions, rates), memory)
        return jnp.concatenate([response.force, response.ball_moment])

    return jax.jacfwd(answer, (0, 1))(jnp.zeros(FIELD_SIZE), jnp.zeros(FIELD_SIZE))


def joint_wrenches(here: Here, name: str, answer: Float[Array, "6 *k"]) -> Vectors:
    """The wrenches of u on the moving bodies; the moment on the socket balances the others."""
    (socket, ball), (_, ball_arm) = _bodies_and_arms(here, name)
    force, moment = answer[:3], answer[3:]
    at_ball_center = here.motions[ball].position + ball_arm
    wrenches = {
        body: sign * jnp.concatenate([force, moment + _crossed(at_ball_center - here.motions[body].position, force)])
        for body, sign in ((socket, -1.0), (ball, 1.0))
        if body != GROUND
    }
    return {body: wrenches.get(body, jnp.zeros_like(answer)) for body in here.system.bodies}


def _moved(joint: PlacedSpherical, motions, motion: RelativeMotion, positions, rates) -> RelativeMotion:
    """What the model is told after small changes of the motion of the centers and of its rates."""
    shift, socket_turn, ball_turn = jnp.split(positions, 3)
    faster, socket_spin, ball_spin = jnp.split(rates, 3)
    turned = {
        name: body._replace(quaternion=body.quaternion + quaternion_rate(body.quaternion, turn))
        for name, body, turn in (
            (joint.bodies[0], motions[joint.bodies[0]], socket_turn),
            (joint.bodies[1], motions[joint.bodies[1]], ball_turn),
        )
    }
    ball_axes = motions[joint.bodies[1]].rotation
    moved = RelativeMotion(
        motion.eccentricity + shift,
        motion.eccentricity_rate + faster,
        motion.socket_rotation + skew(socket_turn) @ motion.socket_rotation,
        joint.motion_of_centers(turned).relative_quaternion,
        motion.socket_angular_velocity + socket_spin,
        motion.ball_angular_velocity + ball_spin,
        ball_axes + skew(ball_turn) @ ball_axes,
    )
    return joint.across(moved)


def _bodies_and_arms(here: Here, name: str) -> tuple[tuple[str, str], tuple[Vector3, Vector3]]:
    joint = here.system.spherical(name)
    socket, ball = joint.centers(here.motions)
    return joint.bodies, (socket.arm, ball.arm)


def _of(vectors: Vectors, body: str) -> Float[Array, "6 *k"]:
    """A body's part; the ground does not move."""
    return vectors[body] if body != GROUND else jnp.zeros_like(next(iter(vectors.values())))


def _point(part: Float[Array, "6 *k"], arm: Vector3) -> Float[Array, "3 *k"]:
    """Change of a point at the end of an arm."""
    return part[:3] - skew(arm) @ part[3:]


def _turned_rate(here: Here, body: str, arm: Vector3, positions: Vectors) -> Float[Array, "3 *k"]:
    """Change of w x arm by rotations of the body."""
    return -skew(here.motions[body].angular_velocity) @ (skew(arm) @ _of(positions, body)[3:])


def _crossed(arm: Vector3, force: Float[Array, "3 *k"]) -> Float[Array, "3 *k"]:
    return skew(arm) @ force


# The mechanism -------------------------------------------------------------------------------------------------------


def accelerations_by(here: Here, name: str, answer: Float[Array, "6 k"]) -> Vectors:
    """U: accelerations of all bodies by changes of one joint's answer, given as columns."""
    none = jnp.zeros_like(here.constraints.bias)

    def by_one(column):
        wrenches = jnp.stack(list(joint_wrenches(here, name, column).values()))
        accelerations = solve_augmented(here.constraints, here.masses, wrenches, none).accelerations
        return {name: accelerations[i] for i, name in enumerate(here.system.bodies)}

    return jax.vmap(by_one, 1, 1)(answer)


def inexact_product(system: System, t: Scalar, point) -> Float[Array, " size"]:
    """The approximate Jacobian times a vector: (system, t, (y, vector)) -> J vector."""
    y, vector = point
    here = mechanism_at(system, t, y)
    positions, velocities, rest = _split(here, vector)
    accelerations = {name: jnp.zeros(VELOCITY_SIZE) for name in system.bodies}
    for name in system.force_joints:
        change = joint_change(here, name, positions, velocities)
        by_positions, by_rates = joint_slopes(here, name)
        answer = by_positions @ change.positions + by_rates @ change.rates
        caused = accelerations_by(here, name, answer[:, None])
        accelerations = {body: a + caused[body][:, 0] for body, a in accelerations.items()}
    return jnp.concatenate([*_position_rates(here, velocities), *accelerations.values(), jnp.zeros_like(rest)])


def solve_inexact_stage(system: System, t: Scalar, point) -> Float[Array, " size"]:
    """(system, t, (y, gamma_h, rhs)) -> k with (I - gamma h J) k = rhs for the approximate Jacobian J."""
    y, gamma_h, rhs = point
    h = gamma_h[0]
    here = mechanism_at(system, t, y)
    positions, velocities, rest = _split(here, rhs)
    moved = {body: positions[body] + h * velocities[body] for body in system.bodies}
    slopes = {name: joint_slopes(here, name) for name in system.force_joints}
    caused = {name: accelerations_by(here, name, jnp.eye(ANSWER_SIZE)) for name in system.force_joints}
    answers = _answers(here, slopes, caused, moved, velocities, h)
    for name, answer in answers.items():
        velocities = {body: v + h * (caused[name][body] @ answer) for body, v in velocities.items()}
    rates = _position_rates(here, velocities)
    return jnp.concatenate([rhs[: system.layout.n_position] + h * jnp.concatenate(rates), *velocities.values(), rest])


def _answers(here: Here, slopes, caused, positions: Vectors, velocities: Vectors, h: Scalar):
    """du of each joint."""
    names = list(slopes)

    def answer_to(name: str, positions: Vectors, velocities: Vectors):
        change = joint_change(here, name, positions, velocities)
        by_positions, by_rates = slopes[name]
        return by_positions @ change.positions + by_rates @ change.rates

    def block(row: str, column: str):
        """Answer of one joint to the accelerations by a unit of another's, within gamma h."""
        moved = {body: h * a for body, a in caused[column].items()}
        own = jnp.eye(ANSWER_SIZE) if row == column else 0.0
        return own - h * answer_to(row, moved, caused[column])

    if not names:
        return {}
    matrix = jnp.concatenate([jnp.concatenate([block(row, column) for column in names], 1) for row in names])
    right = jnp.concatenate([answer_to(name, positions, velocities) for name in names])
    return dict(zip(names, general_solve(matrix, right).reshape(-1, ANSWER_SIZE), strict=True))


def _split(here: Here, vector: Float[Array, " size"]) -> tuple[Vectors, Vectors, Float[Array, " n_rest"]]:
    """Displacements and rotations, velocities, and the rest of a vector of the size of the state."""
    layout = here.system.layout
    q = vector[: layout.n_position].reshape(-1, POSITION_SIZE)
    v = vector[layout.n_position : layout.memory_start].reshape(-1, VELOCITY_SIZE)
    positions = {
        name: jnp.concatenate([q[i, :3], _turn(here.motions[name].quaternion, q[i, 3:])])
        for i, name in enumerate(here.system.bodies)
    }
    return positions, dict(zip(here.system.bodies, v, strict=True)), vector[layout.memory_start :]


def _turn(p: Float[Array, "4"], change: Float[Array, "4"]) -> Vector3:
    """Rotation by a change of quaternion: 2 dp p*, vector part, over |p|^2."""
    return 4 / (p @ p) * (_quaternion_rates(p).T @ change)


def _quaternion_rates(p: Float[Array, "4"]) -> Float[Array, "4 3"]:
    return jax.jacfwd(lambda w: quaternion_rate(p, w))(jnp.zeros(3))


def _position_rates(here: Here, velocities: Vectors) -> list[Float[Array, "7"]]:
    """T v, body by body."""
    return [
        jnp.concatenate([v[:3], quaternion_rate(here.motions[name].quaternion, v[3:])])
        for name, v in velocities.items()
    ]

"""What the equations say of a mechanism at one instant, for inverse dynamics: array code, evaluated as programs.

Each function is `function(system, t, y)`, as those of `spherejax.motion.equations.terms`, and reads its values off the
functions that make up the right-hand side: no equation stands here for a second time.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.rotation import normalized, quaternion_rate, rotation_matrix, skew
from spherejax.foundations.types import Scalar
from spherejax.model.system import System, flatten_system
from spherejax.motion.equations.body_motions import BodyMotions, body_motions
from spherejax.motion.equations.constraints import ConstraintSet, assembly_set, constraint_set
from spherejax.motion.equations.joint_friction import friction_under, resistances, wrenches_of
from spherejax.motion.equations.loads import applied_wrenches
from spherejax.motion.equations.programs import program_for
from spherejax.motion.equations.terms import dense_jacobian, mass_matrix, rows_of_joints
from spherejax.motion.start.redundancy import reactions_by_multipliers
from spherejax.physics.forces.actuators import AbstractMotor
from spherejax.physics.forces.coupler import AbstractCoordinate
from spherejax.physics.state import VELOCITY_SIZE, Layout, State, pack, unpack


def evaluated(function: Callable, system: System, t: Scalar, y: Any) -> Any:
    """A function of a system as a scalar program, where it is not too large for one."""
    structure, theta = flatten_system(system)
    sizes = tuple(part.shape[0] for part in y) if isinstance(y, tuple) else None
    program = program_for(function, structure, None, sizes, is_quiet=True)
    with program.native_code():
        return program(theta, t, y)


def flat_state(pose: Float[Array, "b 7"], velocities: Float[Array, "b 6"], memory: Any = None) -> Array:
    """The flat state of a pose, velocities and a memory."""
    none = jnp.zeros(0)
    held = none if memory is None else memory
    return pack(State(pose[:, :3], pose[:, 3:], velocities[:, :3], velocities[:, 3:], held, none))


# Poses ---------------------------------------------------------------------------------------------------------------


def described_pose(system: System) -> Float[Array, "b 7"]:
    """Centers of mass and unit quaternions of the bodies as they are described."""
    bodies = system.bodies.values()
    return jnp.stack(
        [jnp.concatenate([jnp.asarray(b.position), normalized(jnp.asarray(b.quaternion))]) for b in bodies]
    )


def point_of(pose: Float[Array, "7"], place: Any) -> Float[Array, "3"]:
    """A point of a body in the world [m], from its place in the body's axes [m]."""
    return pose[:3] + rotation_matrix(pose[3:]) @ jnp.asarray(place)


def rows_of_point(pose: Float[Array, "b 7"], number: int, place: Any) -> Float[Array, "6 k"]:
    """Velocity of a point of a body, and the body's angular velocity, by the velocities of all bodies."""
    arm = point_of(pose[number], place) - pose[number][:3]
    rows = jnp.block([[jnp.eye(3), -skew(arm)], [jnp.zeros((3, 3)), jnp.eye(3)]])
    own = slice(VELOCITY_SIZE * number, VELOCITY_SIZE * (number + 1))
    return jnp.zeros((6, VELOCITY_SIZE * len(pose))).at[:, own].set(rows)


# Joints and drivers --------------------------------------------------------------------------------------------------


class Closing(NamedTuple):
    """What a pose lacks: Phi [m or 1], with angles of drivers in full, and D, shape (n, 6 b)."""

    residual: Float[Array, " n"]
    jacobian: Float[Array, "n k"]


def closing(system: System, t: Scalar, y: Float[Array, " size"]) -> Closing:
    """Residuals of joints and drivers, from which any pose finds the right one."""
    constraints = assembly_set(system, t, _motions(system, y))
    return Closing(constraints.residual, dense_jacobian(constraints))


class Moving(NamedTuple):
    """Of D v = -Phi_t and D a = gamma: D, Phi_t [m/s or 1/s] and gamma [m/s^2 or 1/s^2]."""

    jacobian: Float[Array, "n k"]
    rate_at_rest: Float[Array, " n"]
    bias: Float[Array, " n"]


def moving(system: System, t: Scalar, y: Float[Array, " size"]) -> Moving:
    """What the constraints ask of velocities and accelerations."""
    constraints = constraint_set(system, t, _motions(system, y))
    return Moving(dense_jacobian(constraints), constraints.rate_at_rest, constraints.bias)


def joint_rows(system: System) -> dict[str, slice]:
    """Which constraint equations belong to each joint (static)."""
    rows: dict[str, slice] = {}

    def seen(y):
        rows.update(rows_of_joints(_constraints(system, jnp.zeros(()), y)))

    jax.eval_shape(seen, jax.ShapeDtypeStruct((system.layout.size,), jnp.float64))
    return rows


# Coordinates --------------------------------------------------------------------------------------------------------


class CoordinateTerms(NamedTuple):
    """Coordinates of motors, or those that were measured.

    Attributes:
        values: since the described start, angles within one turn [rad or m], shape (m,).
        rates: [rad/s or m/s].
        slopes: H, derivatives of the rates by the velocities of all bodies, shape (m, 6 b).
        bending: H' v, shape (m,).
        wrenches: on all bodies of an effort of 1 along each, as columns, shape (6 b, m).
    """

    values: Float[Array, " m"]
    rates: Float[Array, " m"]
    slopes: Float[Array, "m k"]
    bending: Float[Array, " m"]
    wrenches: Float[Array, "k m"]


def measures(system: System, t: Scalar, y: Float[Array, " size"]) -> CoordinateTerms:
    """Of a system whose only force elements are motors: their coordinates, in the order of the names."""
    del t
    coordinates = coordinates_of(system)
    n = VELOCITY_SIZE * len(system.bodies)
    if not coordinates:
        none = jnp.zeros(0)
        return CoordinateTerms(none, none, jnp.zeros((0, n)), none, jnp.zeros((n, 0)))
    bare = Layout(len(system.bodies))
    state = unpack(bare, y)

    def rates(position, velocities):
        at = jnp.concatenate([position, velocities])
        motions = body_motions(system, unpack(bare, at))
        return jnp.stack([coordinate.motion(motions).rate for coordinate in coordinates.values()])

    position, velocities = y[: bare.n_position], y[bare.n_position : bare.memory_start]
    motions = body_motions(system, state)
    spins = jax.vmap(quaternion_rate)(state.quaternion, motions.moving.angular_velocity)
    turning = jnp.concatenate([motions.moving.velocity, spins], 1)
    value, bending = jax.jvp(lambda q: rates(q, velocities), (position,), (turning.ravel(),))
    wrenches = [_flat(system, coordinate.wrenches(motions, jnp.ones(()))) for coordinate in coordinates.values()]
    return CoordinateTerms(
        jnp.stack([coordinate.motion(motions).value for coordinate in coordinates.values()]),
        value,
        jax.jacfwd(rates, 1)(position, velocities),
        bending,
        jnp.stack(wrenches, 1),
    )


def coordinates_of(system: System) -> dict[str, AbstractCoordinate]:
    """Coordinates of a system's motors, by name."""
    return {name: force.coordinate for name, force in system.forces.items() if isinstance(force, AbstractMotor)}


def _flat(system: System, wrenches) -> Float[Array, " k"]:
    none = jnp.zeros(VELOCITY_SIZE)
    parts = [
        jnp.concatenate([wrenches[name].force, wrenches[name].moment]) if name in wrenches else none
        for name in system.bodies
    ]
    return jnp.concatenate(parts)


# Forces -------------------------------------------------------------------------------------------------------------


class BalanceTerms(NamedTuple):
    """What is known of the balance.

    Attributes:
        mass: M, shape (6 b, 6 b).
        applied: g: all that acts besides joints and motors, and gyroscopic moments [N, N m], shape (6 b,).
        jacobian: D.
        reactions: force and moment of each joint on its second body, about its point there, by its multipliers.
    """

    mass: Float[Array, "k k"]
    applied: Float[Array, " k"]
    jacobian: Float[Array, "n k"]
    reactions: dict[str, Float[Array, "6 m"]]


def forces(system: System, t: Scalar, y: Float[Array, " size"]) -> BalanceTerms:
    """Masses, known forces, and what joints may exert."""
    motions = _motions(system, y)
    memory = unpack(system.layout, y).memory
    return BalanceTerms(
        mass_matrix(system, t, y),
        applied_wrenches(system, t, motions, memory, None).ravel(),
        dense_jacobian(constraint_set(system, t, motions)),
        reactions_by_multipliers(system, t, y),
    )


class Rubbing(NamedTuple):
    """Friction in ideal joints: on all bodies, shape (6 b,), and its part in each joint's reaction, shape (6,)."""

    wrenches: Float[Array, " k"]
    reactions: dict[str, Float[Array, "6"]]


def rubbing(system: System, t: Scalar, given: tuple[Array, Array]) -> Rubbing:
    """Friction by the flat state and the multipliers."""
    y, multipliers = given
    motions = _motions(system, y)
    constraints = constraint_set(system, t, motions)
    groups = friction_under(system, motions, unpack(system.layout, y).memory, constraints, multipliers)
    reactions = {
        name: jnp.concatenate([each.resistance.force, each.resistance.moment])
        for name, each in resistances(groups).items()
    }
    return Rubbing(wrenches_of(system, groups).ravel(), reactions)


def _motions(system: System, y) -> BodyMotions:
    return body_motions(system, unpack(system.layout, y))


def _constraints(system: System, t, y) -> ConstraintSet:
    return constraint_set(system, t, _motions(system, y))

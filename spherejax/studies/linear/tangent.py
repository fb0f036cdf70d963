"""Derivatives of the equations of motion along small changes of a state.

A change of the state is a vector of

    dz = (displacement and rotation of each body; change of its velocity and angular velocity; change of memory)

in world axes, of length 12 n + m. Rotations are small turns, three a body: R -> exp(turn) R. Their chart moves with the
body, so that the kinematic rows are d(turn)/dt = d(omega) + omega x turn: from R' = [omega] R, the change of R being
[turn] R. Everything here is array code; what the changes may be, the constraints say (`coordinates`).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.bounded_jit import bounded_jit
from spherejax.foundations.lanes import over_lanes
from spherejax.foundations.rotation import quaternion_from_rotation_vector, quaternion_product
from spherejax.foundations.types import Quaternion, Scalar, Vector3
from spherejax.model.system import Structure, System
from spherejax.motion.body_motions import body_motions
from spherejax.motion.constraints import constraint_set, velocity_violation
from spherejax.motion.dynamics import evaluate, memory_rates
from spherejax.motion.quantities import value_at
from spherejax.physics.bodies import Body, inertia_in_world
from spherejax.physics.kinematics import BodyMotion
from spherejax.physics.state import VELOCITY_SIZE, Layout, State, pack, unpack

Change = Float[Array, " n_z"]


def size_of(layout: Layout) -> int:
    """Length of a change of the state."""
    return 2 * layout.n_velocity + layout.n_memory


def moved(layout: Layout, y: Float[Array, " size"], change: Change) -> Float[Array, " size"]:
    """The state after a change; rotations exactly, whatever their size."""
    n_v = layout.n_velocity
    state = unpack(layout, y)
    steps = change[:n_v].reshape(-1, VELOCITY_SIZE)
    faster = change[n_v : 2 * n_v].reshape(-1, VELOCITY_SIZE)
    return pack(
        State(
            state.position + steps[:, :3],
            over_lanes(_turned, state.quaternion, steps[:, 3:]),
            state.velocity + faster[:, :3],
            state.angular_velocity + faster[:, 3:],
            state.memory + change[2 * n_v :],
            state.work,
        )
    )


def _turned(quaternion: Quaternion, turn: Vector3) -> Quaternion:
    return quaternion_product(quaternion_from_rotation_vector(turn), quaternion)


# What the constraints say -------------------------------------------------------------------------------------------


class Geometry(NamedTuple):
    """Constraints and masses at a state.

    Attributes:
        mass: 6 x 6 mass matrix of each body, world axes, shape (n_bodies, 6, 6).
        residual: Phi [m or 1], shape (c,).
        violation: Phi' = D v + Phi_t [m/s or 1/s], shape (c,).
        by_position: D, the derivative of Phi by displacements and rotations, shape (c, 6 n).
        rate_by_position: derivative of Phi' by the same, shape (c, 6 n).
    """

    mass: Any
    residual: Any
    violation: Any
    by_position: Any
    rate_by_position: Any


def _geometry(structure: Structure, theta, t: Scalar, y) -> Geometry:
    system = structure.system(theta)
    layout = system.layout
    none = jnp.zeros(layout.n_velocity)

    def constraints(step):
        there = moved(layout, y, jnp.concatenate([step, jnp.zeros(size_of(layout) - step.size)]))
        motions = body_motions(system, unpack(layout, there))
        found = constraint_set(system, t, motions)
        if not found.groups:
            return jnp.zeros(0), jnp.zeros(0)
        return found.residual, velocity_violation(found, motions)

    residual, violation = constraints(none)
    by_position, rate_by_position = jax.jacfwd(constraints)(none)
    motions = body_motions(system, unpack(layout, y))
    masses = jnp.stack([_mass_matrix(body, motions[name]) for name, body in system.bodies.items()])
    return Geometry(masses, residual, violation, by_position, rate_by_position)


def _mass_matrix(body: Body, motion: BodyMotion) -> Float[Array, "6 6"]:
    inertia = inertia_in_world(body.inertia, motion.rotation)
    none = jnp.zeros((3, 3))
    return jnp.block([[body.mass * jnp.eye(3), none], [none, inertia]])


# What the equations of motion say -------------------------------------------------------------------------------------


def _rates(system: System, t: Scalar, y, change: Change) -> Float[Array, " n_z"]:
    """Rate of a change of the state: accelerations and memory rates as they are; of positions what follows below."""
    layout = system.layout
    found = evaluate(system, t, moved(layout, y, change))
    groups = () if found.friction is None else found.friction.groups
    remembered = memory_rates(system, found.loads, groups)
    spins = found.motions.moving.angular_velocity - unpack(layout, y).angular_velocity
    speeds = found.motions.moving.velocity - unpack(layout, y).velocity
    steps = change[: layout.n_velocity].reshape(-1, VELOCITY_SIZE)
    turning = spins + jnp.cross(unpack(layout, y).angular_velocity, steps[:, 3:])
    moving = jnp.concatenate([speeds, turning], 1)
    return jnp.concatenate([moving.ravel(), found.solution.accelerations.ravel(), remembered])


def _in_turning_axes(layout: Layout, turning: Vector3, change: Change) -> Change:
    """What the turning of the axes takes from the rate of a change: turning x each of its vectors."""
    vectors = change[: 2 * layout.n_velocity].reshape(-1, 3)
    return jnp.concatenate([jnp.cross(turning, vectors).ravel(), jnp.zeros(layout.n_memory)])


def _values(system: System, t: Scalar, y, names: tuple[str, ...]) -> Float[Array, " k"]:
    values = [jnp.ravel(value_at(system, t, y, name)) for name in names]
    return jnp.concatenate([jnp.zeros(0), *values])


def _along(structure: Structure, names: tuple[str, ...], turning, theta, t: Scalar, y, basis):
    """Rates and quantities along the columns of a basis: shapes (n_z, n_x) and (k, n_x)."""
    system = structure.system(theta)
    layout = system.layout

    def seen(change):
        return _rates(system, t, y, change), _values(system, t, moved(layout, y, change), names)

    def one(direction):
        rates, values = jax.jvp(seen, (jnp.zeros_like(direction),), (direction,))[1]
        return rates - _in_turning_axes(layout, turning, direction), values

    return jax.vmap(one, 1, 1)(basis)


@bounded_jit(what="the constraints of a linearization")
def geometry(structure: Structure, theta, t: Scalar, y) -> Geometry:
    """Constraints and masses at a state, with derivatives."""
    return _geometry(structure, theta, t, y)


@bounded_jit(what="a linearization")
def along(structure: Structure, names: tuple[str, ...], turning, theta, t: Scalar, y, basis):
    """Derivatives of rates (n_z, n_x) and quantities (k, n_x) along the columns of a basis."""
    return _along(structure, names, turning, theta, t, y, basis)


@bounded_jit(what="rates about a linearization")
def rates_at(structure: Structure, theta, t: Scalar, y, changes: Float[Array, "k n_z"]) -> Float[Array, "k n_z"]:
    """Rates at states that differ by finite changes; their first rows are right to first order only."""
    system = structure.system(theta)
    return jax.vmap(lambda change: _rates(system, t, y, change))(changes)


@bounded_jit(what="the inputs of a linearization")
def by_numbers(structure: Structure, names: tuple[str, ...], theta, t: Scalar, y, slopes: Float[Array, "p u"]):
    """Derivatives of rates, quantities and constraints (Phi and Phi') by numbers, the state held.

    Args:
        structure: of the system.
        names: of the quantities.
        theta: numbers of the system.
        t: time [s].
        y: flat state.
        slopes: derivatives of `theta` by each number, as columns.
    """

    def seen(theta):
        system = structure.system(theta)
        motions = body_motions(system, unpack(system.layout, y))
        constraints = constraint_set(system, t, motions)
        held = jnp.zeros(0)
        if constraints.groups:
            held = jnp.concatenate([constraints.residual, velocity_violation(constraints, motions)])
        none = jnp.zeros(size_of(system.layout))
        return _rates(system, t, y, none), _values(system, t, y, names), held

    return jax.vmap(lambda slope: jax.jvp(seen, (theta,), (slope,))[1], 1, 1)(slopes)


@bounded_jit(what="the derivative of a linearization's constraints")
def geometry_along(structure: Structure, theta, t: Scalar, y, theta_slope, y_slope) -> Geometry:
    """Derivative of `geometry` along a change of numbers and of the state that follows them."""

    def seen(theta, y):
        return _geometry(structure, theta, t, y)

    return jax.jvp(seen, (theta, y), (theta_slope, y_slope))[1]


@bounded_jit(what="the derivative of a linearization")
def along_along(structure: Structure, turning, point: tuple, slope: tuple) -> Float[Array, "n_z n_x"]:
    """Derivative of `along`'s rates along a change of numbers, state and basis.

    Args:
        structure: of the system.
        turning: angular velocity of the axes [rad/s].
        point: numbers, time [s], state, basis.
        slope: change of numbers, of the state, of the basis.
    """
    theta, t, y, basis = point

    def seen(theta, y, basis):
        return _along(structure, (), turning, theta, t, y, basis)[0]

    return jax.jvp(seen, (theta, y, basis), slope)[1]

"""Derivatives of the equations of motion along small changes of a state.

A change of the state is a vector of

    dz = (displacement and rotation of each body; change of its velocity and angular velocity; change of memory)

in world axes, of length 12 n + m. Rotations are small turns, three a body: R -> exp(turn) R. Their chart moves with the
body, so that the kinematic rows are d(turn)/dt = d(omega) + omega x turn: from R' = [omega] R, the change of R being
[turn] R. What the changes may be, the constraints say (`coordinates`).
Functions are array code of a system, a time and a point, evaluated as scalar programs, one direction after the other:
that compiles nothing.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.lanes import over_lanes
from spherejax.foundations.rotation import quaternion_from_rotation_vector, quaternion_product
from spherejax.foundations.types import Quaternion, Scalar, Vector3
from spherejax.model.groups import stacks_of
from spherejax.model.system import Structure, System
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import constraint_set, velocity_violation
from spherejax.motion.equations.dynamics import evaluate, memory_rates, state_rate
from spherejax.motion.equations.programs import SystemFunction, program_for
from spherejax.motion.equations.quantities import value_at
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


def held(system: System, t: Scalar, y) -> Float[Array, " 2c"]:
    """Phi and Phi' of all constraints."""
    motions = body_motions(system, unpack(system.layout, y))
    found = constraint_set(system, t, motions)
    if not found.groups:
        return jnp.zeros(0)
    return jnp.concatenate([found.residual, velocity_violation(found, motions)])


def held_along(system: System, t: Scalar, point) -> Float[Array, " 2c"]:
    """Their derivative along a change of the state; `point` is the flat state and the change."""
    y, change = point
    return _derivative(lambda step: held(system, t, moved(system.layout, y, step)), change)


def masses(system: System, t: Scalar, y) -> Float[Array, "b 6 6"]:
    """6 x 6 mass matrix of each body, world axes."""
    del t
    motions = body_motions(system, unpack(system.layout, y))
    return over_lanes(_mass_matrix, stacks_of(system).bodies, motions.moving)


def _derivative(function, change):
    """Of a function of changes, at none, along one."""
    return jax.jvp(function, (jnp.zeros_like(change),), (change,))[1]


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
    remembered = memory_rates(system, t, found.motions, found.state.memory, found.loads, groups)
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


def rates(system: System, t: Scalar, point) -> Change:
    """Rates at a state that differs by a finite change; `point` is the flat state and the change.

    Those of positions are right to first order only.
    """
    return _rates(system, t, *point)


def _rates_along(system: System, t: Scalar, y, turning: Vector3, change: Change) -> Change:
    """Derivative of the rates along a change, in turning axes."""
    found = _derivative(lambda step: _rates(system, t, y, step), change)
    return found - _in_turning_axes(system.layout, turning, change)


def rates_along(system: System, t: Scalar, point) -> Change:
    """The same; `point` is the flat state, the angular velocity of the axes, and the change."""
    y, turning, change = point
    return _rates_along(system, t, y, turning, change)


@lru_cache(maxsize=64)
def values_along(names: tuple[str, ...]) -> SystemFunction:
    """The function that differentiates quantities along a change; its point is the flat state and the change.

    The same object each time, so that its program is found again; so with the following.
    """

    def values(system: System, t: Scalar, point) -> Float[Array, " k"]:
        y, change = point
        return _derivative(lambda step: _values(system, t, moved(system.layout, y, step), names), change)

    return values


@lru_cache(maxsize=64)
def by_number(structure: Structure, names: tuple[str, ...]) -> SystemFunction:
    """The function that differentiates rates, quantities and constraints along a change of numbers, the state held.

    Its point is the flat state, and the change of the flat numbers.
    """

    def slopes(system: System, t: Scalar, point):
        y, change = point
        none = jnp.zeros(size_of(system.layout))

        def seen(system):
            return _rates(system, t, y, none), _values(system, t, y, names), held(system, t, y)

        return jax.jvp(seen, (_bare(system),), (structure.system(change),))[1]

    return slopes


def _bare(system: System) -> System:
    """Without what is stacked ahead, as `Structure.system` makes it."""
    return replace(system, stacks=None)


@lru_cache(maxsize=64)
def geometry_by_number(structure: Structure) -> SystemFunction:
    """The function that differentiates constraints and masses along a change of numbers, time and state.

    Its point is the flat state, the changes of numbers, of time (one entry) and of the flat state, and a change along
    which `held_along` is taken.
    """

    def slopes(system: System, t: Scalar, point):
        y, numbers, time, state, change = point

        def seen(system, t, y):
            return held(system, t, y), masses(system, t, y), held_along(system, t, (y, change))

        return jax.jvp(seen, (_bare(system), t, y), (structure.system(numbers), time[0], state))[1]

    return slopes


@lru_cache(maxsize=64)
def rates_along_by_number(structure: Structure) -> SystemFunction:
    """The function that differentiates `rates_along` along a change of numbers, of the state, and of its direction.

    Its point is the flat state, the angular velocity of the axes, the direction, and the changes of numbers, of the
    flat state and of the direction.
    """

    def slopes(system: System, t: Scalar, point) -> Change:
        y, turning, direction, *slope = point

        def seen(system, y, direction):
            return _rates_along(system, t, y, turning, direction)

        return jax.jvp(seen, (_bare(system), y, direction), (structure.system(slope[0]), *slope[1:]))[1]

    return slopes


def _one_at_least(basis) -> list[np.ndarray]:
    """Columns of a basis; of one without any, as a mechanism without freedom has, no change at all."""
    return list(basis.T) or [np.zeros(len(basis))]


# Evaluated ----------------------------------------------------------------------------------------------------------


class TangentEquations:
    """What is asked of the equations of motion about a state, evaluated by programs that are not compiled.

    Args:
        structure: of the system.
        theta: numbers of the system.
        t: time [s].
        y: flat state.
    """

    def __init__(self, structure: Structure, theta, t: float, y):
        self.structure, self.theta, self.t, self.y = structure, theta, t, y
        self.layout = structure.system(theta).layout

    def _compute(self, function: SystemFunction, *point):
        sizes = tuple(np.size(each) for each in (self.y, *point)) if point else None
        program = program_for(function, self.structure, None, sizes, is_quiet=True)
        return program.compute(self.theta, self.t, (self.y, *point) if point else self.y)

    def _columns(self, function: SystemFunction, *points):
        """Results for each column of the arguments, side by side."""
        found = [self._compute(function, *point) for point in points]
        return jax.tree.map(lambda *each: np.stack(each, -1), *found)

    @property
    def geometry(self) -> Geometry:
        """Constraints and masses."""
        n_v, size = self.layout.n_velocity, size_of(self.layout)
        here, M = self._compute(held), self._compute(masses)
        slopes = self._columns(held_along, *((unit,) for unit in np.eye(size)[:n_v]))
        return Geometry(M, *np.split(here, 2), *np.split(slopes, 2))

    def rates(self, changes) -> np.ndarray:
        """Rates at states that differ by finite changes, the rows."""
        return np.stack([self._compute(rates, change) for change in changes])

    def rates_along(self, turning, basis) -> np.ndarray:
        """Derivatives of the rates along the columns of a basis, in turning axes."""
        return self._columns(rates_along, *((turning, column) for column in _one_at_least(basis)))[:, : basis.shape[1]]

    def values_along(self, names: tuple[str, ...], basis) -> np.ndarray:
        """Derivatives of quantities along the columns of a basis."""
        if not names:
            return np.zeros((0, basis.shape[1]))
        found = self._columns(values_along(names), *((column,) for column in _one_at_least(basis)))
        return found[:, : basis.shape[1]]

    def by_numbers(self, names: tuple[str, ...], slopes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of rates, quantities and constraints by numbers, given those of the flat numbers as columns."""
        return self._columns(by_number(self.structure, names), *((column,) for column in slopes.T))

    @property
    def geometry_rate(self) -> Geometry:
        """Derivative of `geometry` along the motion."""
        return self.geometry_by_number(np.zeros_like(self.theta), self._compute(state_rate), 1.0)

    def geometry_by_number(self, numbers, state, time: float = 0.0) -> Geometry:
        """Derivative of `geometry` along a change of the flat numbers, of the flat state and of time with them."""
        n_v, size = self.layout.n_velocity, size_of(self.layout)
        points = ((numbers, np.array([time]), state, unit) for unit in np.eye(size)[:n_v])
        here, M, slopes = self._columns(geometry_by_number(self.structure), *points)
        return Geometry(M[..., 0], *np.split(here[..., 0], 2), *np.split(slopes, 2))

    def rates_along_by_number(self, turning, basis, numbers, state, basis_slope) -> np.ndarray:
        """Derivative of `rates_along` along a change of the flat numbers, the flat state and the basis."""
        columns = zip(basis.T, basis_slope.T, strict=True)
        points = ((turning, column, numbers, state, slope) for column, slope in columns)
        return self._columns(rates_along_by_number(self.structure), *points)

"""Onto the constraints: the least change of positions and velocities, in the metric of masses and inertias."""

from collections.abc import Callable
from functools import lru_cache

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.lanes import over_lanes
from spherejax.foundations.rotation import normalized, quaternion_rate
from spherejax.foundations.types import Quaternion, Scalar, Vector3
from spherejax.model.system import Structure, System
from spherejax.motion.equations.body_motions import BodyMotions, body_motions
from spherejax.motion.equations.constraints import (
    ConstraintSet,
    constraint_set,
    inverse_masses,
    mobility_of,
    solved,
    velocity_violation,
)
from spherejax.motion.equations.observables import kinetic_energy, weight_energy
from spherejax.motion.equations.programs import program_for
from spherejax.physics.state import VELOCITY_SIZE, State, pack, unpack

REGULARIZATION = 1e-13
"""Relative enlargement of the diagonal of D M^-1 D^T, so that redundant equations do no harm. Being relative to each
entry, it is the same in all units of the equations. It leaves 1e-10 of a violation: nothing in a correction, but in the
accelerations themselves it would be seen (1e-10 m on the four-bar)."""

BodySteps = Float[Array, "b 6"]
"""A change of position [m] and rotation [rad], or of the velocities [m/s, rad/s], of each body, world axes."""


def least_correction(
    system: System, motions: BodyMotions, constraints: ConstraintSet, violation: Float[Array, " n"]
) -> BodySteps:
    """M^-1 D^T (D M^-1 D^T)^-1 times a violation: what to take from the bodies so that it vanishes."""
    if not constraints.groups:
        return jnp.zeros((system.layout.n_bodies, VELOCITY_SIZE))
    masses = inverse_masses(system, motions)
    mobility = mobility_of(constraints, masses).with_larger_diagonal(REGULARIZATION)
    return masses.times(constraints.transposed_times(solved(constraints, mobility, violation, system.smallest_pivot)))


def without_velocities(state: State, steps: BodySteps) -> State:
    """The state with its velocities diminished."""
    return state._replace(
        velocity=state.velocity - steps[:, :3], angular_velocity=state.angular_velocity - steps[:, 3:]
    )


def corrected(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " size"]:
    """Unit quaternions, then one Newton correction of the positions and one of the velocities; memory stays.

    Both corrections use the same S, of the state before: in a scalar program it is factorized once.
    """
    state = unpack(system.layout, y)
    state = state._replace(quaternion=over_lanes(normalized, state.quaternion))
    motions = body_motions(system, state)
    constraints = constraint_set(system, t, motions)
    moved = _moved_back(state, least_correction(system, motions, constraints, constraints.residual))
    motions_moved = body_motions(system, moved)
    violation = velocity_violation(constraint_set(system, t, motions_moved), motions_moved)
    found = without_velocities(moved, least_correction(system, motions, constraints, violation))
    return pack(_with_work(system, state, found) if system.tracks_constraint_work else found)


def _with_work(system: System, before: State, after: State) -> State:
    """The state after a correction, with the energy of motion and weight that it took among the constraints' work."""
    change = _energy(system, after) - _energy(system, before)
    at = system.constraint_work_index % system.layout.n_work
    work = [after.work[:at], after.work[at : at + 1] + change, after.work[at + 1 :]]
    return after._replace(work=jnp.concatenate(work))


def _energy(system: System, state: State) -> Scalar:
    motions = body_motions(system, state)
    return kinetic_energy(system, motions) + weight_energy(system, motions)


def _moved_back(state: State, steps: BodySteps) -> State:
    """Bodies displaced by minus the steps; small rotations need neither sine nor cosine."""
    quaternions = over_lanes(_turned_back, state.quaternion, steps[:, 3:])
    return state._replace(position=state.position - steps[:, :3], quaternion=quaternions)


def _turned_back(p: Quaternion, turn: Vector3) -> Quaternion:
    return normalized(p + quaternion_rate(p, -turn))


@lru_cache(maxsize=64)
def correction_of(structure: Structure, use_scalars: bool | None, n_corrections: int) -> Callable:
    """The drift control's correction of a state, for the integrator: a function of (parameters, t, y)."""
    program = program_for(corrected, structure, use_scalars)

    def correct(parameters, t, y):
        # A loop with a fixed number of turns: reverse mode passes through it, and lanes of a batch stay together.
        return jax.lax.fori_loop(0, n_corrections, lambda _, y: program(parameters.theta, t, y), y)

    return correct

"""Onto the constraints: the least change of positions and velocities, in the metric of masses and inertias."""

from collections.abc import Callable
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
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
    return _correction(system, motions, constraints, violation)[0]


def _correction(
    system: System, motions: BodyMotions, constraints: ConstraintSet, violation: Float[Array, " n"]
) -> tuple[BodySteps, Float[Array, " n"]]:
    """That, and (D M^-1 D^T)^-1 times the violation: of velocities the impulses [N s or N m s] that take it."""
    if not constraints.groups:
        return jnp.zeros((system.layout.n_bodies, VELOCITY_SIZE)), jnp.zeros(0)
    masses = inverse_masses(system, motions)
    mobility = mobility_of(constraints, masses).with_larger_diagonal(REGULARIZATION)
    impulses = solved(constraints, mobility, violation, system.smallest_pivot)
    return masses.times(constraints.transposed_times(impulses)), impulses


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
    there = constraint_set(system, t, motions_moved)
    violation = velocity_violation(there, motions_moved)
    steps, impulses = _correction(system, motions, constraints, violation)
    return pack(_with_works(system, state, without_velocities(moved, steps), there, violation, impulses))


def _with_works(
    system: System, before: State, after: State, constraints: ConstraintSet, violation: Array, impulses: Array
) -> State:
    """The state after a correction, with its works: of drivers whose rate has jumped, and of the other constraints.

    An impulse -D^T L works on the mean of the velocities before and after, L.(Phi_t - violation/2). That of a driver is
    put in; what else changes the energy of motion and weight counts as work of the constraint forces.
    """
    supplied = jnp.zeros(())
    if system.is_driven:
        is_driven = np.concatenate(
            [np.repeat(each.group.joint.is_driven, each.rows.residual.size) for each in constraints.groups]
        )
        supplied = impulses @ jnp.where(is_driven, constraints.rate_at_rest - violation / 2, 0.0)
    work = list(jnp.split(after.work, system.layout.n_work)) if system.layout.n_work else []
    if system.tracks_constraint_work:
        change = _energy(system, after) - _energy(system, before)
        work[system.constraint_work_index] = work[system.constraint_work_index] + (change - supplied)
    if system.tracks_supply and system.is_driven:
        work[-1] = work[-1] + supplied
    return after._replace(work=jnp.concatenate([jnp.zeros(0), *work]))


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
    has_parameters = program.reads_parameters

    def correct(parameters, t, y):
        # In reverse mode a derivative by each of thousands of weights would be an array of zeros, to be added.
        theta = parameters.theta if has_parameters else jax.lax.stop_gradient(parameters.theta)
        # A loop with a fixed number of turns: reverse mode passes through it, and lanes of a batch stay together.
        return jax.lax.fori_loop(0, n_corrections, lambda _, y: program(theta, t, y), y)

    return correct


def correction_reads_parameters(structure: Structure, use_scalars: bool | None) -> bool:
    """Whether the drift control's correction depends on parameters: where nothing is jointed, it makes unit quaternions
    alone."""
    return program_for(corrected, structure, use_scalars).reads_parameters

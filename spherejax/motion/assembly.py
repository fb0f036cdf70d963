"""A consistent start: positions and velocities that satisfy the constraints, and a report of what was moved.

Printed tables carry few digits, and a parameter that changes a length moves its neighbors. Newton steps move the
bodies as little as possible, in the metric of their masses and inertias, until the constraints close; then the
velocities are projected. Joints with clearance or elastomer start concentric, as in the paper, unless the scene says
otherwise.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import SceneError, is_concrete
from spherejax.foundations.rotation import normalized, quaternion_from_rotation_vector, quaternion_product
from spherejax.foundations.symmetric_solve import symmetric_solve
from spherejax.foundations.types import Scalar
from spherejax.model.system import Structure, System
from spherejax.motion.constraints import assembly_set, constraint_mobility, inverse_masses
from spherejax.motion.dynamics import body_motions
from spherejax.physics.state import State, pack

N_NEWTON_STEPS = 8
"""Newton's method doubles the digits each step: eight are ample for a start that is off by a few percent."""

CLOSING_TOLERANCE = 1e-9
"""Largest constraint residual [m or 1] of a start that counts as consistent."""

RELATIVE_REGULARIZATION = 1e-13
"""Added to the diagonal of D M^-1 D^T, relative to its mean, so that redundant equations do no harm."""


class Assembly(NamedTuple):
    """A consistent start and how it was reached.

    Attributes:
        y: flat state without memory and work: positions, then velocities.
        residual_before: largest constraint residual of the start as described [m or 1].
        residual_after: largest constraint residual of the assembled start.
        displacement: how far each body's center of mass was moved [m], shape (n_bodies,).
        rotation: how far each body was turned [rad], shape (n_bodies,).
        velocity_change: change of each body's velocity [m/s], shape (n_bodies,).
    """

    y: Float[Array, " n"]
    residual_before: Scalar
    residual_after: Scalar
    displacement: Float[Array, " b"]
    rotation: Float[Array, " b"]
    velocity_change: Float[Array, " b"]

    def __repr__(self) -> str:
        if not all(is_concrete(field) for field in self):
            return "Assembly(traced)"
        return (
            f"start assembled: residual {self.residual_before:.1e} -> {self.residual_after:.1e}; bodies moved at most "
            f"{np.max(self.displacement):.1e} m and {np.max(self.rotation):.1e} rad, velocities changed at most "
            f"{np.max(self.velocity_change):.1e} m/s"
        )


def assemble(system: System) -> Assembly:
    """Move bodies and velocities to a consistent start; differentiable and traceable."""
    described = _described(system)
    before = _residual(system, described)
    moved = described
    if assembly_set(system, body_motions(system, described)).rows:
        moved = jax.lax.fori_loop(0, N_NEWTON_STEPS, lambda _, state: _newton_step(system, state), described)
        moved = _with_consistent_velocities(system, moved)
    return Assembly(
        pack(moved),
        before,
        _residual(system, moved),
        _norms(moved.position - described.position),
        2 * _norms(_difference(moved.quaternion, described.quaternion)),
        _norms(moved.velocity - described.velocity),
    )


def assemble_now(structure: Structure, theta: np.ndarray) -> Assembly:
    """`assemble` for concrete numbers, compiled once for each mechanism, with a check of the result.

    Raises:
        SceneError: when the mechanism cannot be closed, naming the joint that gapes most.
    """
    with jax.ensure_compile_time_eval():
        assembly, gaps = _assemble_flat(structure, jnp.asarray(theta))
        assembly = jax.tree.map(np.asarray, assembly)
    if not assembly.residual_after < CLOSING_TOLERANCE:
        worst = max(gaps, key=lambda name: float(np.nan_to_num(gaps[name], nan=np.inf)))
        raise SceneError(
            f"joint {worst!r} cannot be closed: from the start as described, with a residual of "
            f"{float(assembly.residual_before):.3g}, the bodies cannot be moved so that all joints hold (remaining residual "
            f"{float(gaps[worst]):.3g} m or rad). Check the joint's points and the bodies' positions and quaternions."
        )
    return assembly


def _assemble_flat_untimed(structure: Structure, theta):
    system = structure.system(theta)
    assembly = assemble(system)
    n = system.layout.n_bodies
    q, v = assembly.y[: 7 * n].reshape(n, 7), assembly.y[7 * n :].reshape(n, 6)
    state = State(q[:, :3], q[:, 3:], v[:, :3], v[:, 3:], jnp.zeros(0), jnp.zeros(0))
    rows = assembly_set(system, body_motions(system, state)).rows
    return assembly, {name: jnp.max(jnp.abs(found.residual)) for name, found in rows.items()}


_assemble_flat = jax.jit(_assemble_flat_untimed, static_argnums=0)


def _described(system: System) -> State:
    bodies = list(system.bodies.values())
    return State(
        jnp.stack([jnp.asarray(body.position) for body in bodies]),
        jnp.stack([normalized(jnp.asarray(body.quaternion)) for body in bodies]),
        jnp.stack([jnp.asarray(body.velocity) for body in bodies]),
        jnp.stack([jnp.asarray(body.angular_velocity) for body in bodies]),
        jnp.zeros(0),
        jnp.zeros(0),
    )


def _residual(system: System, state: State) -> Scalar:
    residual = assembly_set(system, body_motions(system, state)).residual
    return jnp.max(jnp.abs(residual), initial=0.0)


def _newton_step(system: System, state: State) -> State:
    """Move the bodies by -M^-1 D^T (D M^-1 D^T)^-1 Phi."""
    steps = _least_correction(system, state, lambda constraints, motions: constraints.residual)
    position, quaternion = [], []
    for i, step in enumerate(steps.values()):
        position.append(state.position[i] - step[:3])
        turned = quaternion_product(quaternion_from_rotation_vector(-step[3:]), state.quaternion[i])
        quaternion.append(normalized(turned))
    return state._replace(position=jnp.stack(position), quaternion=jnp.stack(quaternion))


def _with_consistent_velocities(system: System, state: State) -> State:
    """Remove the part of the velocities that violates the constraints."""

    def violation(constraints, motions):
        velocities = {
            name: jnp.concatenate([motions[name].velocity, motions[name].angular_velocity]) for name in system.bodies
        }
        return constraints.times(velocities)

    steps = jnp.stack(list(_least_correction(system, state, violation).values()))
    return state._replace(
        velocity=state.velocity - steps[:, :3], angular_velocity=state.angular_velocity - steps[:, 3:]
    )


def _least_correction(system: System, state: State, violation) -> dict[str, Float[Array, "6"]]:
    motions = body_motions(system, state)
    constraints = assembly_set(system, motions)
    masses = inverse_masses(system, motions)
    mobility = constraint_mobility(constraints, masses)
    size = mobility.shape[0]
    mobility = mobility + RELATIVE_REGULARIZATION * jnp.trace(mobility) / size * jnp.eye(size)
    multipliers = symmetric_solve(mobility, violation(constraints, motions))
    return {name: masses[name].times(constraints.transposed_times(name, multipliers)) for name in masses}


def _difference(a: Float[Array, "b 4"], b: Float[Array, "b 4"]) -> Float[Array, "b 4"]:
    """The shorter of a - b and a + b: q and -q are the same rotation."""
    return jnp.where(jnp.sum(a * b, -1, keepdims=True) < 0, a + b, a - b)


def _norms(rows: Float[Array, "b n"]) -> Float[Array, " b"]:
    square = jnp.sum(rows * rows, -1)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)

"""The constraint equations of a system, and the augmented system of Newton and Euler (Eqs 1 and 2).

The augmented system [M D^T; D 0]{a; lambda} = {g; gamma} is reduced to the constraints: with the inverse of the
block-diagonal mass matrix, S lambda = D M^-1 g - gamma for S = D M^-1 D^T, symmetric and positive definite when no
constraint is redundant; then a = M^-1 (g - D^T lambda).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.symmetric_solve import symmetric_solve
from spherejax.foundations.types import Scalar
from spherejax.model.system import System
from spherejax.motion.loads import Wrenches
from spherejax.physics.bodies import GROUND, inverse_inertia_in_world
from spherejax.physics.joints import ConstraintRows, Motions


class InverseMass(NamedTuple):
    """Inverse of a body's 6 x 6 block of the mass matrix.

    Attributes:
        of_translation: 1 / m [1/kg].
        of_rotation: inverse inertia in world axes [1/(kg m^2)], shape (3, 3).
    """

    of_translation: Float[Array, ""]
    of_rotation: Float[Array, "3 3"]

    def times(self, wrench: Float[Array, "6 *k"]) -> Float[Array, "6 *k"]:
        """M^-1 times a wrench, or several wrenches as columns."""
        return jnp.concatenate([self.of_translation * wrench[:3], self.of_rotation @ wrench[3:]])


class ConstraintSet(NamedTuple):
    """The constraint equations of a system, Phi(t, q) = 0.

    Attributes:
        rows: rows of each constraining joint, by name.
        bodies: the two bodies of each joint, by name.
    """

    rows: dict[str, ConstraintRows]
    bodies: dict[str, tuple[str, str]]

    @property
    def residual(self) -> Float[Array, " n"]:
        """Phi [m or 1]."""
        return _joined([rows.residual for rows in self.rows.values()])

    @property
    def bias(self) -> Float[Array, " n"]:
        """gamma [m/s^2 or 1/s^2]."""
        return _joined([rows.bias for rows in self.rows.values()])

    @property
    def rate_at_rest(self) -> Float[Array, " n"]:
        """Phi_t [m/s or 1/s]."""
        return _joined([rows.rate_at_rest for rows in self.rows.values()])

    def blocks_of(self, body: str) -> dict[str, Float[Array, "n 6"]]:
        """The blocks of D that belong to a body, by joint."""
        return {
            joint: rows.jacobians[self.bodies[joint].index(body)]
            for joint, rows in self.rows.items()
            if body in self.bodies[joint]
        }

    def times(self, vectors: dict[str, Float[Array, "6"]]) -> Float[Array, " n"]:
        """D times a vector that is given by body."""
        parts = {joint: jnp.zeros_like(rows.residual) for joint, rows in self.rows.items()}
        for body, vector in vectors.items():
            for joint, block in self.blocks_of(body).items():
                parts[joint] = parts[joint] + block @ vector
        return _joined(list(parts.values()))

    def split(self, values: Float[Array, " n"]) -> dict[str, Float[Array, " n_joint"]]:
        """A vector with one entry an equation, by joint."""
        parts, start = {}, 0
        for joint, rows in self.rows.items():
            size = rows.residual.shape[0]
            parts[joint] = values[start : start + size]
            start += size
        return parts

    def transposed_times(self, body: str, multipliers: Float[Array, " n"]) -> Float[Array, "6"]:
        """The part of D^T lambda that belongs to a body."""
        parts = self.split(multipliers)
        total = jnp.zeros(6)
        for joint, block in self.blocks_of(body).items():
            total = total + block.T @ parts[joint]
        return total


def constraint_set(system: System, t: Scalar, motions: Motions) -> ConstraintSet:
    """The equations of the joints that constrain, at time t [s]."""
    return _collected(system, {name: joint.constraint_rows(t, motions) for name, joint in system.joints.items()})


def assembly_set(system: System, t: Scalar, motions: Motions) -> ConstraintSet:
    """The equations that a consistent start satisfies: joints that start concentric count as ideal."""
    return _collected(system, {name: joint.assembly_rows(t, motions) for name, joint in system.joints.items()})


def _collected(system: System, rows: dict[str, ConstraintRows | None]) -> ConstraintSet:
    kept = {name: found for name, found in rows.items() if found is not None}
    return ConstraintSet(kept, {name: system.joints[name].bodies for name in kept})


def velocity_violation(constraints: ConstraintSet, motions: Motions) -> Float[Array, " n"]:
    """Phi_dot = D v + Phi_t [m/s or 1/s]."""
    velocities = {
        name: jnp.concatenate([motion.velocity, motion.angular_velocity])
        for name, motion in motions.items()
        if name != GROUND
    }
    return constraints.times(velocities) + constraints.rate_at_rest


def inverse_masses(system: System, motions: Motions) -> dict[str, InverseMass]:
    """The inverse mass matrix, body by body."""
    return {
        name: InverseMass(1 / jnp.asarray(body.mass), inverse_inertia_in_world(body.inertia, motions[name].rotation))
        for name, body in system.bodies.items()
    }


def constraint_mobility(constraints: ConstraintSet, masses: dict[str, InverseMass]) -> Float[Array, "n n"]:
    """S = D M^-1 D^T, assembled from the blocks of joints that share a body."""
    sizes = {joint: rows.residual.shape[0] for joint, rows in constraints.rows.items()}
    blocks = {(a, b): jnp.zeros((sizes[a], sizes[b])) for a in sizes for b in sizes}
    for body, mass in masses.items():
        jacobians = constraints.blocks_of(body)
        weighted = {joint: mass.times(block.T) for joint, block in jacobians.items()}
        for a, block in jacobians.items():
            for b, column in weighted.items():
                blocks[a, b] = blocks[a, b] + block @ column
    if not sizes:
        return jnp.zeros((0, 0))
    return jnp.concatenate([jnp.concatenate([blocks[a, b] for b in sizes], 1) for a in sizes])


class Solution(NamedTuple):
    """Accelerations and multipliers.

    Attributes:
        accelerations: linear [m/s^2] and angular [rad/s^2] of each body, world axes, shape (6,), by name.
        multipliers: lambda of each constraining joint, by name; the constraint's wrench on a body is -D^T lambda.
    """

    accelerations: dict[str, Float[Array, "6"]]
    multipliers: dict[str, Float[Array, " n_joint"]]


def constrained_accelerations(
    system: System, motions: Motions, constraints: ConstraintSet, applied: Wrenches
) -> Solution:
    """Solve Eq. 2 for the accelerations and the Lagrange multipliers, with the drift control's feedback."""
    loads = {name: jnp.concatenate([applied[name].force, applied[name].moment]) for name in system.bodies}
    desired = desired_accelerations(system, motions, constraints)
    masses = inverse_masses(system, motions)
    return solve_augmented(constraints, masses, loads, desired, system.refines_constraints)


def desired_accelerations(system: System, motions: Motions, constraints: ConstraintSet) -> Float[Array, " n"]:
    """Right side of D a = gamma - feedback [m/s^2 or 1/s^2]."""
    violation = velocity_violation(constraints, motions)
    return constraints.bias - system.drift.acceleration_feedback(constraints.residual, violation)


def solve_augmented(
    constraints: ConstraintSet,
    masses: dict[str, InverseMass],
    loads: dict[str, Float[Array, "6"]],
    desired: Float[Array, " n"],
    refine: bool = False,
) -> Solution:
    """Solve M a + D^T lambda = g, D a = gamma for a and lambda, given g by body and gamma.

    A second pass (`refine`) removes what rounding left where masses differ: for 1e-6 kg beside 1e3 kg the forces on
    the light body cancel to one part in 1e9, and the noise of its acceleration would cost ten thousand times the
    steps. The factorization is shared; the pass costs a fifth of the right-hand side.
    """
    free = {name: masses[name].times(load) for name, load in loads.items()}
    if not constraints.rows:
        return Solution(free, {})
    mobility = constraint_mobility(constraints, masses)

    def corrected(accelerations, multipliers):
        """Multipliers that make up for what the accelerations lack, and the accelerations with them."""
        more = symmetric_solve(mobility, constraints.times(accelerations) - desired)
        moved = {
            name: accelerations[name] - masses[name].times(constraints.transposed_times(name, more)) for name in masses
        }
        return moved, multipliers + more

    accelerations, multipliers = corrected(free, jnp.zeros_like(desired))
    if refine:
        accelerations, multipliers = corrected(accelerations, multipliers)
    return Solution(accelerations, constraints.split(multipliers))


def _joined(parts: list[Float[Array, " n"]]) -> Float[Array, " total"]:
    return jnp.concatenate(parts) if parts else jnp.zeros(0)

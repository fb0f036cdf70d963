"""The constraint equations of a system, and the augmented system of Newton and Euler (Eqs 1 and 2).

The augmented system [M D^T; D 0]{a; lambda} = {g; gamma} is reduced to the constraints: with the inverse of the
block-diagonal mass matrix, S lambda = D M^-1 g - gamma for S = D M^-1 D^T, symmetric and positive definite when no
constraint is redundant; then a = M^-1 (g - D^T lambda). S has a block for each two joints that share a moving body, and
no others.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.lanes import over_lanes, rows_at, sums_by_index
from spherejax.foundations.linear_algebra import REDUNDANT_PIVOT
from spherejax.foundations.types import Scalar
from spherejax.model.groups import JointGroup, stacks_of
from spherejax.model.system import System
from spherejax.motion.equations.body_motions import BodyMotions, between, with_ground
from spherejax.motion.equations.loads import BodyVectors
from spherejax.motion.equations.mobility import InverseMass, Mobility, constraint_mobility
from spherejax.physics.bodies import Body, inverse_inertia, inverse_inertia_in_world
from spherejax.physics.joints.rows import ConstraintRows
from spherejax.physics.kinematics import BodyMotion


class RowGroup(NamedTuple):
    """Constraint equations of joints of one kind.

    Attributes:
        group: the joints.
        rows: their equations, with a leading axis of joints.
    """

    group: JointGroup
    rows: ConstraintRows

    @property
    def shape(self) -> tuple[int, int]:
        """Number of joints and of equations of each."""
        n_joints, n_rows = self.rows.residual.shape
        return n_joints, n_rows


class ConstraintSet:
    """The constraint equations of a system, Phi(t, q) = 0, kind of joint after kind of joint.

    Attributes:
        groups: the equations by kind of joint.
        names: of the moving bodies.
    """

    def __init__(self, groups: Sequence[RowGroup], names: Sequence[str]):
        self.groups = tuple(groups)
        self.names = tuple(names)

    @cached_property
    def rows(self) -> dict[str, ConstraintRows]:
        """The rows of each constraining joint, by name."""
        return {
            name: jax.tree.map(lambda x, i=i: x[i], found.rows)
            for found in self.groups
            for i, name in enumerate(found.group.names)
        }

    @property
    def residual(self) -> Float[Array, " n"]:
        """Phi [m or 1]."""
        return _joined(found.rows.residual for found in self.groups)

    @property
    def bias(self) -> Float[Array, " n"]:
        """gamma [m/s^2 or 1/s^2]."""
        return _joined(found.rows.bias for found in self.groups)

    @property
    def rate_at_rest(self) -> Float[Array, " n"]:
        """Phi_t [m/s or 1/s]."""
        return _joined(found.rows.rate_at_rest for found in self.groups)

    @property
    def jacobians(self) -> tuple[tuple[Array, Array], ...]:
        """D_i and D_j of each group."""
        return tuple(found.rows.jacobians for found in self.groups)

    def with_jacobians(self, jacobians: Sequence[tuple[Array, Array]]) -> "ConstraintSet":
        """The same equations with other derivatives."""
        groups = zip(self.groups, jacobians, strict=True)
        return ConstraintSet(
            [found._replace(rows=found.rows._replace(jacobians=each)) for found, each in groups], self.names
        )

    @property
    def ends(self) -> tuple[tuple[int, int], ...]:
        """Numbers of the two bodies of each joint, 0 for the ground, in the order of the equations."""
        return tuple(ends for found in self.groups for ends in zip(found.group.first, found.group.second, strict=True))

    def blocks_of(self, body: str) -> dict[str, Float[Array, "n 6"]]:
        """The blocks of D that belong to a body, by joint."""
        number = self.names.index(body) + 1
        joints = zip(self.rows.items(), self.ends, strict=True)
        return {name: rows.jacobians[ends.index(number)] for (name, rows), ends in joints if number in ends}

    def times(self, vectors: BodyVectors) -> Float[Array, " n"]:
        """D times vectors of the bodies."""
        padded = with_ground(vectors)
        return _joined(
            over_lanes(
                _rows_times,
                found.rows.jacobians,
                rows_at(padded, found.group.first),
                rows_at(padded, found.group.second),
            )
            for found in self.groups
        )

    def transposed_times(self, multipliers: Float[Array, " n"]) -> BodyVectors:
        """D^T lambda."""
        parts = [
            over_lanes(_rows_transposed_times, found.rows.jacobians, values)
            for found, values in zip(self.groups, self.by_group(multipliers), strict=True)
        ]
        if not parts:
            return jnp.zeros((len(self.names), 6))
        targets = np.array(self.ends).ravel() - 1
        return sums_by_index(jnp.concatenate(parts).reshape(-1, 6), targets, len(self.names))

    def split(self, values: Float[Array, " n"]) -> dict[str, Float[Array, " n_joint"]]:
        """A vector with one entry an equation, by joint."""
        groups = zip(self.groups, self.by_group(values), strict=True)
        return {name: part[i] for found, part in groups for i, name in enumerate(found.group.names)}

    def padded(self, values: Float[Array, " n"]) -> Float[Array, "n_joints n_rows"]:
        """A vector with one entry an equation as rows of equal length, one for each joint, filled up with zeros."""
        width = max((found.shape[1] for found in self.groups), default=0)
        parts = [jnp.pad(part, ((0, 0), (0, width - part.shape[1]))) for part in self.by_group(values)]
        return jnp.concatenate([jnp.zeros((0, width)), *parts])

    def unpadded(self, rows: Float[Array, "n_joints n_rows"]) -> Float[Array, " n"]:
        """The reverse of `padded`."""
        starts = np.cumsum([0, *(found.shape[0] for found in self.groups)])
        return _joined(
            rows[start : start + found.shape[0], : found.shape[1]]
            for start, found in zip(starts, self.groups, strict=False)
        )

    def by_group(self, values: Float[Array, " n"]) -> list[Float[Array, "n_joints n_rows"]]:
        """A vector with one entry an equation, by kind of joint and joint."""
        starts = np.cumsum([0, *(found.rows.residual.size for found in self.groups)])
        return [
            values[start : start + found.rows.residual.size].reshape(found.shape)
            for start, found in zip(starts, self.groups, strict=False)
        ]


def _rows_times(jacobians, first: Float[Array, "6"], second: Float[Array, "6"]) -> Float[Array, " n"]:
    return jacobians[0] @ first + jacobians[1] @ second


def _rows_transposed_times(jacobians, multipliers: Float[Array, " n"]) -> Float[Array, "2 6"]:
    return jnp.stack([block.T @ multipliers for block in jacobians])


def constraint_set(system: System, t: Scalar, motions: BodyMotions) -> ConstraintSet:
    """The equations of the joints that constrain, at time t [s]."""
    return _collected(system, t, motions, _constraint_rows)


def assembly_set(system: System, t: Scalar, motions: BodyMotions) -> ConstraintSet:
    """The equations that a consistent start satisfies: joints that start concentric count as ideal."""
    return _collected(system, t, motions, _assembly_rows)


def _collected(system: System, t: Scalar, motions: BodyMotions, rows_of) -> ConstraintSet:
    found = [
        (group, over_lanes(rows_of, group.joint, *motions.of_ends(group), shared=(t,)))
        for group in stacks_of(system).joints
    ]
    return ConstraintSet([RowGroup(group, rows) for group, rows in found if rows is not None], tuple(system.bodies))


def _constraint_rows(t: Scalar, joint, first: BodyMotion, second: BodyMotion) -> ConstraintRows | None:
    return joint.constraint_rows(t, between(first, second))


def _assembly_rows(t: Scalar, joint, first: BodyMotion, second: BodyMotion) -> ConstraintRows | None:
    return joint.assembly_rows(t, between(first, second))


def velocity_violation(constraints: ConstraintSet, motions: BodyMotions) -> Float[Array, " n"]:
    """Phi_dot = D v + Phi_t [m/s or 1/s]."""
    velocities = jnp.concatenate([motions.moving.velocity, motions.moving.angular_velocity], 1)
    return constraints.times(velocities) + constraints.rate_at_rest


def inverse_masses(system: System, motions: BodyMotions) -> InverseMass:
    """The inverse mass matrix, body by body, with a leading axis of bodies."""
    return over_lanes(_inverse_mass, stacks_of(system).bodies, motions.moving)


def _inverse_mass(body: Body, motion: BodyMotion) -> InverseMass:
    inertia, rotation = body.inertia, motion.rotation
    in_world = inverse_inertia_in_world(inertia, rotation)
    return InverseMass(1 / jnp.asarray(body.mass), in_world, inverse_inertia(inertia), rotation)


def mobility_of(constraints: ConstraintSet, masses: InverseMass) -> Mobility:
    """S = D M^-1 D^T by its blocks."""
    return constraint_mobility(constraints.jacobians, constraints.ends, masses)


def solved(
    constraints: ConstraintSet,
    mobility: Mobility,
    right: Float[Array, " n"],
    smallest_pivot: float = REDUNDANT_PIVOT,
) -> Float[Array, " n"]:
    """S^-1 times a vector with one entry an equation; redundant equations are left out."""
    return constraints.unpadded(mobility.solve(constraints.padded(right), smallest_pivot))


class Solution(NamedTuple):
    """Accelerations and multipliers.

    Attributes:
        accelerations: linear [m/s^2] and angular [rad/s^2] of each body, world axes, shape (n_bodies, 6).
        multipliers: lambda of each constraining joint, by name; the constraint's wrench on a body is -D^T lambda.
        flat: lambda, one entry an equation.
        wrenches: D^T lambda, minus what the constraints exert on each body.
    """

    accelerations: BodyVectors
    multipliers: dict[str, Float[Array, " n_joint"]]
    flat: Float[Array, " n"]
    wrenches: BodyVectors


def constrained_accelerations(
    system: System, motions: BodyMotions, constraints: ConstraintSet, applied: BodyVectors
) -> Solution:
    """Solve Eq. 2 for the accelerations and the Lagrange multipliers, with the drift control's feedback."""
    desired = desired_accelerations(system, motions, constraints)
    masses = inverse_masses(system, motions)
    return solve_augmented(constraints, masses, applied, desired, system.refines_constraints, system.smallest_pivot)


def desired_accelerations(system: System, motions: BodyMotions, constraints: ConstraintSet) -> Float[Array, " n"]:
    """Right side of D a = gamma - feedback [m/s^2 or 1/s^2]."""
    violation = velocity_violation(constraints, motions)
    return constraints.bias - system.drift.acceleration_feedback(constraints.residual, violation)


def solve_augmented(
    constraints: ConstraintSet,
    masses: InverseMass,
    loads: BodyVectors,
    desired: Float[Array, " n"],
    refine: bool = False,
    smallest_pivot: float = REDUNDANT_PIVOT,
) -> Solution:
    """Solve M a + D^T lambda = g, D a = gamma for a and lambda, given g by body and gamma.

    A second pass (`refine`) removes what rounding left where masses differ: for 1e-6 kg beside 1e3 kg the forces on
    the light body cancel to one part in 1e9, and the noise of its acceleration would cost ten thousand times the
    steps. The factorization is shared; the pass costs a fifth of the right-hand side.
    """
    if not constraints.groups:
        return Solution(masses.turned_times(loads), {}, jnp.zeros(0), jnp.zeros_like(loads))

    def balanced(jacobians, masses: InverseMass, free: BodyVectors, desired: Array):
        """Accelerations with D a = gamma, from those without constraints; the lambda that make them so; D^T lambda."""
        equations = constraints.with_jacobians(jacobians)
        mobility = mobility_of(equations, masses)
        accelerations, multipliers, wrenches = free, jnp.zeros_like(desired), jnp.zeros_like(free)
        for _ in range(1 + refine):
            more = solved(equations, mobility, equations.times(accelerations) - desired, smallest_pivot)
            pressed = equations.transposed_times(more)
            accelerations = accelerations - masses.times(pressed)
            multipliers, wrenches = multipliers + more, wrenches + pressed
        return accelerations, multipliers, wrenches

    def solution(jacobians, masses: InverseMass, loads: BodyVectors, desired: Array):
        return balanced(jacobians, masses, masses.times(loads), desired)

    def along(primals, tangents):
        # With lambda held, a and D a move; what D a then lacks is made up for as in the value. So the derivative is a
        # solution with the same S, whose own derivative would take half of the operations of all.
        (jacobians, masses, *_), (*_, desired_along) = primals, tangents
        found = solution(*primals)
        accelerations, multipliers, _ = found

        def pressing(jacobians):
            return constraints.with_jacobians(jacobians).transposed_times(multipliers)

        def held(jacobians, masses, loads):
            return masses.turned_times(loads - pressing(jacobians))

        def taken(jacobians):
            return constraints.with_jacobians(jacobians).times(accelerations)

        _, held_along = jax.jvp(held, primals[:3], tangents[:3])
        _, taken_along = jax.jvp(taken, primals[:1], tangents[:1])
        accelerations_along, multipliers_along, pressed_along = balanced(
            jacobians, masses, held_along, desired_along - taken_along
        )
        _, turned_along = jax.jvp(pressing, primals[:1], tangents[:1])
        return found, (accelerations_along, multipliers_along, pressed_along + turned_along)

    with_rule = jax.custom_jvp(solution)
    with_rule.defjvp(along)
    accelerations, multipliers, wrenches = with_rule(constraints.jacobians, masses, loads, desired)
    return Solution(accelerations, constraints.split(multipliers), multipliers, wrenches)


def _joined(parts) -> Float[Array, " total"]:
    return jnp.concatenate([jnp.zeros(0), *(part.ravel() for part in parts)])

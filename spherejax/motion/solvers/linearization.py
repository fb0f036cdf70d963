"""The linear systems of a Rosenbrock method, in the structure of a second-order system with constraints.

The state is (q, x): positions q with q_dot = T(q) v, body by body, and x = (v, m, w): velocities, memory, work. A
Rosenbrock method asks for k with (I - gamma h J) k = rhs. Accelerations and multipliers make the residuals

    r = M a + D^T lambda - g,    s = D a - gamma

vanish, so J follows from the derivatives of r and s at frozen a and lambda. With z = (I - gamma h T_q)^-1 rhs_q,
k_q = z + H k_v and H = gamma h (I - gamma h T_q)^-1 T, the velocities solve the saddle-point system

    [M + gamma h (r_v + r_q H), D^T; D + gamma h (s_v + s_q H), 0]{k_v; mu}
        = {M rhs_v - gamma h r_q z; D rhs_v - gamma h s_q z}

to which memory and work add rows of their own. It is sparse where the mechanism is, and eliminated as a scalar
program without exchanging rows: M dominates what is not dissipative or elastic.

Orientations are perturbed by rotations: three directions a body instead of four, and products with a skew matrix
instead of derivatives of a rotation matrix.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from spherejax.foundations.lanes import over_lanes
from spherejax.foundations.linear_algebra import general_solve
from spherejax.foundations.rotation import quaternion_rate, skew
from spherejax.foundations.types import Scalar
from spherejax.model.groups import stacks_of
from spherejax.model.system import Structure, System
from spherejax.motion.equations.body_motions import BodyMotions, body_motions
from spherejax.motion.equations.constraints import constraint_set, desired_accelerations
from spherejax.motion.equations.dynamics import evaluate, memory_rates, orientation_rate, work_rates
from spherejax.motion.equations.joint_friction import friction_under, wrenches_of
from spherejax.motion.equations.loads import BodyVectors, applied_wrenches, joint_loads
from spherejax.motion.equations.programs import Program
from spherejax.physics.bodies import Body, inertia_times
from spherejax.physics.kinematics import BodyMotion
from spherejax.physics.state import POSITION_SIZE, VELOCITY_SIZE, Layout, State, unpack


class Frozen(NamedTuple):
    """What is frozen while residuals are differentiated.

    Attributes:
        accelerations: of all bodies [m/s^2, rad/s^2].
        multipliers: of all constraints.
    """

    accelerations: Float[Array, " n_v"]
    multipliers: Float[Array, " n_c"]


def freeze(system: System, t: Scalar, y: Float[Array, " size"]) -> Frozen:
    """Accelerations and multipliers at a state."""
    solution = evaluate(system, t, y).solution
    return Frozen(solution.accelerations.ravel(), _joined(solution.multipliers.values()))


# Residuals and their derivatives -------------------------------------------------------------------------------------


def residuals(system: System, t: Scalar, y, accelerations, multipliers, direction) -> Float[Array, " n_rows"]:
    """Residuals of velocities (r), memory and work (minus their rates) and constraints (s), one after the other.

    Args:
        system: the system.
        t: time [s].
        y: flat state.
        accelerations: frozen, shape (n_v,).
        multipliers: frozen, shape (n_c,).
        direction: a small change of position (for each body a displacement and a rotation), then of x,
            shape (n_v + n_x,).
    """
    n_v = system.layout.n_velocity
    state = unpack(system.layout, y)
    x_change = direction[n_v:]
    motions = _moved(system, state, direction[:n_v], x_change[:n_v])
    memory = state.memory + x_change[n_v : n_v + system.layout.n_memory]
    loads = joint_loads(system, motions, memory)
    applied = applied_wrenches(system, t, motions, memory, loads)
    constraints = constraint_set(system, t, motions)
    by_body = accelerations.reshape(-1, VELOCITY_SIZE)
    friction = friction_under(system, motions, memory, constraints, multipliers) if system.friction_joints else ()
    if friction:
        applied = applied + wrenches_of(system, friction)
    balance = _masses_times(system, motions, by_body) + constraints.transposed_times(multipliers) - applied
    violation = constraints.times(by_body) - desired_accelerations(system, motions, constraints)
    # The power of the constraint forces depends on all bodies, and nothing on their work: with that row, which is
    # dense, each column would need a color of its own.
    powers = work_rates(system, t, motions, memory, loads, friction, constraints, multipliers, None)
    remembered = memory_rates(system, t, motions, memory, loads, friction)
    return jnp.concatenate([balance.ravel(), -remembered, *(-power for power in powers), violation])


Point = tuple[Float[Array, " size"], Float[Array, " n_v"], Float[Array, " n_c"], Float[Array, " n_v+n_x"]]
"""Flat state, accelerations, multipliers, direction."""


def residual_change(system: System, t: Scalar, point: Point) -> Float[Array, " n_rows"]:
    """Derivative of `residuals` along a direction."""
    y, accelerations, multipliers, direction = point

    def along(direction):
        return residuals(system, t, y, accelerations, multipliers, direction)

    return jax.jvp(along, (jnp.zeros_like(direction),), (direction,))[1]


def _moved(system: System, state: State, position_change, velocity_change) -> BodyMotions:
    """Motions of the bodies after a small displacement, rotation, and change of velocity."""
    changes = [change.reshape(-1, VELOCITY_SIZE) for change in (position_change, velocity_change)]
    return BodyMotions(tuple(system.bodies), over_lanes(_body_moved, body_motions(system, state).moving, *changes))


def _body_moved(motion: BodyMotion, position_change: Float[Array, "6"], velocity_change: Float[Array, "6"]):
    (shift, turn), (faster, spin) = jnp.split(position_change, 2), jnp.split(velocity_change, 2)
    return BodyMotion(
        motion.position + shift,
        motion.quaternion + quaternion_rate(motion.quaternion, turn),
        motion.rotation + skew(turn) @ motion.rotation,
        motion.velocity + faster,
        motion.angular_velocity + spin,
    )


def _masses_times(system: System, motions: BodyMotions, vectors: BodyVectors) -> BodyVectors:
    """M times a vector of each body."""
    return over_lanes(_mass_times, stacks_of(system).bodies, motions.moving, vectors)


def _mass_times(body: Body, motion: BodyMotion, vector: Float[Array, "6"]) -> Float[Array, "6"]:
    turned = inertia_times(body.inertia, motion.rotation, vector[3:])
    return jnp.concatenate([body.mass * vector[:3], turned])


# The pattern of nonzeros ---------------------------------------------------------------------------------------------


class Pattern(NamedTuple):
    """Which residuals depend on what, and which directions can be differentiated together (static).

    Attributes:
        nonzero: (n_rows, n_v + n_x): whether the residual of the row changes along the direction of the column.
        color: (n_v + n_x,): directions of one color share no row.
        n_colors: number of colors.
    """

    nonzero: Bool[np.ndarray, "n_rows n_directions"]
    color: Int[np.ndarray, " n_directions"]
    n_colors: int

    @property
    def seeds(self) -> Float[np.ndarray, "n_colors n_directions"]:
        """Sums of the directions of each color; a direction that changes nothing is in none."""
        return np.eye(self.n_colors)[self.color].T * np.any(self.nonzero, axis=0)

    def expand(self, changes: Float[Array, "n_rows n_colors"]) -> Float[Array, "n_rows n_directions"]:
        """The matrix of derivatives, from those along the seeds."""
        return changes[:, self.color] * self.nonzero


def pattern_of(structure: Structure, change: Program) -> Pattern | None:
    """The pattern of a system, read from the program of `residual_change`; None when that is no scalar program."""
    if change.scalar is None:
        return None
    layout, _ = sizes_of(structure)
    n_v, n_x = layout.n_velocity, layout.size - layout.n_position
    nonzero = change.scalar.dependence(_DIRECTION)
    # Entries of the state whose rate is zero do not move within a step.
    constant = ~np.any(nonzero[n_v:n_x], axis=1)
    nonzero[:, 2 * n_v :][:, constant] = False
    return Pattern(nonzero, *_colored(nonzero))


_DIRECTION = 5
"""Leaf of the arguments (theta, t, (y, accelerations, multipliers, direction)) that is the direction."""


def _colored(nonzero: np.ndarray) -> tuple[np.ndarray, int]:
    """Greedy coloring of columns: each gets the first color none of whose columns shares a row with it."""
    color = np.zeros(nonzero.shape[1], int)
    taken: list[np.ndarray] = []
    for column in range(nonzero.shape[1]):
        rows = nonzero[:, column]
        fits = [i for i, occupied in enumerate(taken) if not np.any(occupied & rows)]
        if not fits:
            taken.append(np.zeros_like(rows))
            fits = [len(taken) - 1]
        color[column] = fits[0]
        taken[fits[0]] |= rows
    return color, len(taken)


def sizes_of(structure: Structure) -> tuple[Layout, int]:
    """Layout of the state and number of constraints."""
    numbers = jax.ShapeDtypeStruct((sum(int(np.prod(shape)) for shape in structure.shapes),), jnp.float64)
    system = jax.eval_shape(structure.system, numbers)
    return system.layout, system.n_constraints


# The stage ----------------------------------------------------------------------------------------------------------


def stage_solver(pattern: Pattern):
    """The function (system, t, (y, gamma_h, changes, rhs)) -> k with (I - gamma h J) k = rhs."""

    def solve_stage(system: System, t: Scalar, point) -> Float[Array, " size"]:
        y, gamma_h, changes, rhs = point
        h = gamma_h[0]
        layout = system.layout
        n_q, n_v, n_x = layout.n_position, layout.n_velocity, layout.size - layout.n_position
        state = unpack(layout, y)
        motions = body_motions(system, state)
        constraints = constraint_set(system, t, motions)
        by_direction = pattern.expand(changes.reshape(-1, pattern.n_colors))
        by_position, by_x = by_direction[:, :n_v], by_direction[:, n_v:]
        positions = [_position_elimination(system, state, i, h) for i in range(layout.n_bodies)]
        slaved = _block_diagonal([p.direction_by_velocity for p in positions])
        D = _constraint_matrix(system, constraints, n_x)
        n_c = D.shape[0]
        by_own = h * (by_x + jnp.concatenate([by_position @ slaved, jnp.zeros((n_x + n_c, n_x - n_v))], 1))
        upper = jnp.concatenate(
            [_generalized_mass(system, motions, n_x) + by_own[:n_x], _by_multipliers(system, t, y, constraints, D)], 1
        )
        lower = jnp.concatenate([D + by_own[n_x:], jnp.zeros((n_c, n_c))], 1)
        moved = [p.free(rhs[POSITION_SIZE * i : POSITION_SIZE * (i + 1)]) for i, p in enumerate(positions)]
        direction = jnp.concatenate([p.direction(z) for p, z in zip(positions, moved, strict=True)])
        right = _right_side(system, motions, D, rhs[n_q:]) - h * (by_position @ direction)
        k_x = general_solve(jnp.concatenate([upper, lower]), right)[:n_x]
        k_q = [
            z + p.by_velocity @ k_x[VELOCITY_SIZE * i : VELOCITY_SIZE * (i + 1)]
            for i, (p, z) in enumerate(zip(positions, moved, strict=True))
        ]
        return jnp.concatenate([*k_q, k_x])

    return solve_stage


class PositionElimination(NamedTuple):
    """How one body's part of k_q follows from its right-hand side and from k_v.

    Attributes:
        inverse: (I - gamma h T_p)^-1 of the quaternion, shape (4, 4).
        by_velocity: H, shape (7, 6).
        turn: rotation by change of quaternion, shape (3, 4).
    """

    inverse: Float[Array, "4 4"]
    by_velocity: Float[Array, "7 6"]
    turn: Float[Array, "3 4"]

    def free(self, rhs: Float[Array, "7"]) -> Float[Array, "7"]:
        """z: k_q without its part by the velocities."""
        return jnp.concatenate([rhs[:3], self.inverse @ rhs[3:]])

    def direction(self, change: Float[Array, "7 *k"]) -> Float[Array, "6 *k"]:
        """Displacement and rotation of a change of position and quaternion."""
        return jnp.concatenate([change[:3], self.turn @ change[3:]])

    @property
    def direction_by_velocity(self) -> Float[Array, "6 6"]:
        """H in displacements and rotations."""
        return self.direction(self.by_velocity)


def _position_elimination(system: System, state: State, i: int, h: Scalar) -> PositionElimination:
    p, w = state.quaternion[i], state.angular_velocity[i]
    by_p, by_w = jax.jacfwd(lambda p, w: orientation_rate(system.drift.norm_feedback, p, w), (0, 1))(p, w)
    inverse = _inverse_4(jnp.eye(4) - h * by_p)
    zero = jnp.zeros((3, 3))
    by_velocity = jnp.concatenate(
        [
            jnp.concatenate([h * jnp.eye(3), zero], 1),
            jnp.concatenate([jnp.zeros((4, 3)), h * (inverse @ by_w)], 1),
        ]
    )
    # The rotation of a change dp is 2 dp p*, vector part, over |p|^2: 4 T^T / |p|^2 for T = dp_dot/dw.
    turn = 4 / (p @ p) * jax.jacfwd(lambda w: quaternion_rate(p, w))(w).T
    return PositionElimination(inverse, by_velocity, turn)


def _inverse_4(matrix: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """Inverse by 2 x 2 blocks: scalar operations only, for a matrix whose upper left block is regular."""
    a, b, c, d = matrix[:2, :2], matrix[:2, 2:], matrix[2:, :2], matrix[2:, 2:]
    a_inverse = _inverse_2(a)
    s_inverse = _inverse_2(d - c @ a_inverse @ b)
    right = a_inverse @ b @ s_inverse
    left = s_inverse @ c @ a_inverse
    return jnp.concatenate(
        [
            jnp.concatenate([a_inverse + right @ c @ a_inverse, -right], 1),
            jnp.concatenate([-left, s_inverse], 1),
        ]
    )


def _inverse_2(m: Float[Array, "2 2"]) -> Float[Array, "2 2"]:
    determinant = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    return jnp.array([[m[1, 1], -m[0, 1]], [-m[1, 0], m[0, 0]]]) / determinant


def _constraint_matrix(system: System, constraints, n_x: int) -> Float[Array, "n_c n_x"]:
    """D, with columns of zeros for memory and work."""
    n_bodies = system.layout.n_bodies
    parts = []
    for rows, ends in zip(constraints.rows.values(), constraints.ends, strict=True):
        nothing = jnp.zeros_like(rows.jacobians[0])
        of_body = {end - 1: block for end, block in zip(ends, rows.jacobians, strict=True)}
        parts.append(jnp.concatenate([of_body.get(i, nothing) for i in range(n_bodies)], 1))
    D = jnp.concatenate([jnp.zeros((0, system.layout.n_velocity)), *parts])
    return jnp.concatenate([D, jnp.zeros((D.shape[0], n_x - system.layout.n_velocity))], 1)


def _by_multipliers(system: System, t: Scalar, y, constraints, D: Float[Array, "n_c n_x"]) -> Float[Array, "n_x n_c"]:
    """D^T; the last row, of the work that is put in, by the drivers' power lambda.Phi_t.

    With friction in ideal joints, which follows the multipliers, less its derivative by them.
    """
    if system.friction_passes:
        n_x = D.shape[1]
        frozen = freeze(system, t, y)
        still = jnp.zeros(system.layout.n_velocity + n_x)

        def balance(multipliers):
            return residuals(system, t, y, frozen.accelerations, multipliers, still)[:n_x]

        return jax.jacfwd(balance)(frozen.multipliers)
    return D.T.at[-1].set(-constraints.rate_at_rest) if system.is_driven and system.tracks_supply else D.T


def _generalized_mass(system: System, motions, n_x: int) -> Float[Array, "n_x n_x"]:
    bodies = stacks_of(system).bodies
    masses = over_lanes(_mass_matrix, bodies, motions.moving)
    return _block_diagonal([*masses, jnp.eye(n_x - system.layout.n_velocity)])


def _mass_matrix(body: Body, motion: BodyMotion) -> Float[Array, "6 6"]:
    return jnp.stack([_mass_times(body, motion, unit) for unit in jnp.eye(VELOCITY_SIZE)], 1)


def _block_diagonal(blocks) -> Float[Array, "n m"]:
    widths = [block.shape[1] for block in blocks]
    rows = []
    for i, block in enumerate(blocks):
        n, before, after = block.shape[0], sum(widths[:i]), sum(widths[i + 1 :])
        rows.append(jnp.concatenate([jnp.zeros((n, before)), block, jnp.zeros((n, after))], 1))
    return jnp.concatenate(rows)


def _right_side(system: System, motions, D, rhs_x) -> Float[Array, " n_rows"]:
    n_v = system.layout.n_velocity
    momenta = _masses_times(system, motions, rhs_x[:n_v].reshape(-1, VELOCITY_SIZE))
    return jnp.concatenate([momenta.ravel(), rhs_x[n_v:], D @ rhs_x])


def _joined(parts) -> Float[Array, " n"]:
    parts = list(parts)
    return jnp.concatenate(parts) if parts else jnp.zeros(0)

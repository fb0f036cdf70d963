"""Constraint equations that depend on others, and configurations in which more of them do.

The rows of W = D M^(-1/2), each divided by its length, are independent where the smallest singular value of W is not
zero. A left null vector of W names the equations that depend on each other, and so the joints. In a singular
configuration the rank is smaller than nearby on the same motion.
"""

import itertools
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.numerics import safe_sqrt
from spherejax.foundations.types import Scalar
from spherejax.model.scene import Scene
from spherejax.model.system import Structure, System, compile_scene, flatten_system
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import constraint_set
from spherejax.motion.equations.joint_friction import constraint_reaction
from spherejax.motion.equations.programs import program_for
from spherejax.motion.start.assembly import as_ideal, assemble_now, consistent_velocities, newton_step
from spherejax.physics.bodies import inertia_in_world
from spherejax.physics.state import POSITION_SIZE, VELOCITY_SIZE, unpack

DEPENDENT = 1e-7
"""Singular values of W below this, relative to the largest, count as zero: a start is closed to 1e-9 at worst, and
independent equations of usual mechanisms keep 1e-3 and more."""

NEARLY_DEPENDENT = 1e-3
"""The same where a run has stopped: it stops before the singular configuration, not in it."""

SHARE = 1e-6
"""A joint takes part in a dependence when its entries of the null vectors are larger than this."""

STEP = 1e-2
"""How far the mechanism is moved to look at its neighborhood, as a share of its size, and in rad."""


class ConstraintReport(NamedTuple):
    """How many of the constraint equations count, and which joints they come from; prints as sentences.

    Attributes:
        n_equations: number of equations.
        rank: how many of them are independent.
        degrees_of_freedom: independent velocities that they leave.
        redundant_joints: names of the joints whose equations depend on each other; empty without redundancy.
        is_singular: whether the rank is smaller than nearby on the same motion.
    """

    n_equations: int
    rank: int
    degrees_of_freedom: int
    redundant_joints: tuple[str, ...]
    is_singular: bool

    @property
    def n_redundant(self) -> int:
        """Equations that could be left out."""
        return self.n_equations - self.rank

    def __str__(self) -> str:
        sentences = [
            f"{self.n_equations} constraint equations of rank {self.rank}; "
            f"{_counted(self.degrees_of_freedom, 'degree')} of freedom."
        ]
        if self.n_redundant:
            names = ", ".join(map(repr, self.redundant_joints))
            sentences.append(
                f"{_counted(self.n_redundant, 'equation')} of joints {names} can be left out: the motion is unique, "
                "the share of each of these joints in the reactions is not."
            )
        if self.is_singular:
            sentences.append(
                "The configuration is singular: nearby fewer equations depend on others. From it the mechanism can go "
                "on in more than one way."
            )
        return " ".join(sentences)


def _counted(n: int, what: str) -> str:
    return f"{n} {what}" if n == 1 else f"{n} {what}s"


def constraint_report(scene: Scene, t: float = 0.0) -> ConstraintReport:
    """Number, rank and redundancy of a scene's constraint equations at its assembled start.

    Args:
        scene: the scene, with concrete numbers.
        t: time of the start [s], for drivers.

    Raises:
        SceneError: for a scene that cannot be simulated, or whose numbers are traced.
    """
    return report_at(*_assembled(scene, t, "constraint_report"))


def _assembled(scene: Scene, t: float, asker: str) -> tuple[System, float, Float[np.ndarray, " size"]]:
    """The system, the time, and the state at which the joints close."""
    system = compile_scene(scene).system
    structure, theta = flatten_system(as_ideal(system))
    if not is_concrete(theta):
        raise SceneError(f"{asker} looks at numbers; call it outside jit, vmap and grad")
    return system, t, np.asarray(assemble_now(structure, theta, t).y)


def undetermined_reactions_of(scene: Scene, t: float = 0.0) -> dict[str, tuple[Literal["force", "moment"], ...]]:
    """As `undetermined_reactions`, of a scene at its assembled start.

    Args:
        scene: the scene, with concrete numbers.
        t: time of the start [s], for drivers.

    Raises:
        SceneError: as `constraint_report`.
    """
    return undetermined_reactions(*_assembled(scene, t, "undetermined_reactions_of"))


def report_at(system: System, t: float, y: Float[np.ndarray, " size"]) -> ConstraintReport:
    """The report at a state (positions and velocities first; what follows is not read)."""
    bare = _without_forces(system)
    structure, theta = flatten_system(bare)
    start = np.asarray(y)[: bare.layout.size]
    rows, names, _ = _rows_at(structure, theta, t, start)
    rank, redundant = _rank(rows, names, DEPENDENT)
    nearby = _nearby(structure, theta, t, start, rows)
    is_singular = nearby is not None and _rank(_rows_at(structure, theta, t, nearby)[0], names, DEPENDENT)[0] > rank
    return ConstraintReport(len(names), rank, bare.layout.n_velocity - rank, redundant, is_singular)


REACTION_PARTS = ("force", "moment")
"""Parts of a joint's reaction, in the order of a wrench."""


def undetermined_reactions(
    system: System, t: float, y: Float[np.ndarray, " size"]
) -> dict[str, tuple[Literal["force", "moment"], ...]]:
    """Joints whose reactions the motion does not determine, with the parts of the reaction that are not unique.

    Where constraint equations depend on each other, multipliers that differ by a left null vector n of the Jacobian D
    (n^T D = 0) give the same motion. A joint's force or moment is not unique where some n changes it:

        -D_j^T n_j,    with D_j, n_j the joint's rows, on its second body, about the joint's point

    Args:
        system: the system.
        t: time [s].
        y: flat state (positions first; the rest is not read).

    Returns:
        By joint: `("force",)`, `("moment",)` or both; joints with unique reactions are
        left out.

    Limits: it holds near the state that is looked at; a configuration with another rank is another answer. A part is
    named as a whole: of a planar linkage, whose forces along the normal of the plane are not unique, those in the plane
    are.
    """
    structure, theta = flatten_system(_without_forces(system))
    start = np.asarray(y)[: structure.system(theta).layout.size]
    rows, names, lengths = _rows_at(structure, theta, t, start)
    if not names or not np.all(np.isfinite(rows)):
        return {}
    left, sizes, _ = np.linalg.svd(rows, full_matrices=True)
    null = left[:, int(np.sum(sizes > DEPENDENT * sizes[0])) :] / np.where(lengths > 0, lengths, 1.0)
    if not null.size:
        return {}
    by_multiplier = program_for(reactions_by_multipliers, structure).compute(theta, float(t), start)
    size = max(_arm(system), SMALLEST_SIZE)  # makes forces comparable with moments
    owners = np.array(names)
    changes = {name: np.asarray(matrix) @ null[owners == name] for name, matrix in by_multiplier.items()}
    parts = {name: (size * np.abs(change[:3]), np.abs(change[3:])) for name, change in changes.items()}
    largest = np.max([[part.max(axis=0) for part in of] for of in parts.values()], axis=(0, 1))
    found: dict[str, tuple[Any, ...]] = {
        name: tuple(
            kind for kind, part in zip(REACTION_PARTS, of, strict=True) if np.any(part.max(axis=0) > SHARE * largest)
        )
        for name, of in parts.items()
    }
    return {name: found[name] for name in system.joints if found.get(name)}


def reactions_by_multipliers(system: System, t: Scalar, y: Float[Array, " size"]) -> dict[str, Float[Array, "6 n"]]:
    """Of each joint the force [N] and the moment about its point [N m] on its second body, by each multiplier."""
    motions = body_motions(system, unpack(system.layout, y))
    constraints = constraint_set(system, t, motions)
    found = {}
    for name, rows in constraints.rows.items():
        joint = system.joints[name]
        second, n = motions[joint.bodies[1]], rows.residual.shape[0]
        each = [constraint_reaction(joint, second, rows.jacobians[1], unit) for unit in np.eye(n)]
        found[name] = jnp.stack([jnp.concatenate([one.force, one.moment]) for one in each], axis=1)
    return found


def singular_joints(
    system: System, t: float, y: Float[np.ndarray, " size"], before: tuple[float, Float[np.ndarray, " size"]]
) -> tuple[str, ...]:
    """Names of the joints whose equations are nearly dependent at a state, and were not at another one before.

    Args:
        system: the system.
        t: time [s].
        y: flat state there.
        before: an earlier time and state.
    """
    structure, theta = flatten_system(_without_forces(system))
    size = structure.system(theta).layout.size
    found = [_rows_at(structure, theta, when, np.asarray(state)[:size]) for when, state in (before, (t, y))]
    if not all(np.all(np.isfinite(rows)) for rows, _, _ in found):
        return ()
    (rank_before, _), (rank, joints) = (_rank(*at[:2], NEARLY_DEPENDENT) for at in found)
    return joints if rank < rank_before else ()


class SingularPass(NamedTuple):
    """A singular configuration that a run has passed.

    Attributes:
        after: the last sample before it [s].
        before: the first sample behind it [s].
        joints: names of the joints whose equations depend on each other there.
    """

    after: float
    before: float
    joints: tuple[str, ...]


class SingularPasses(NamedTuple):
    """The singular configurations that a run has passed, as far as its samples tell; prints as sentences.

    Attributes:
        found: one for each.
        unclear: samples [s] between which the mechanism moved too far to tell.
    """

    found: tuple[SingularPass, ...]
    unclear: tuple[tuple[float, float], ...]

    def __str__(self) -> str:
        sentences = [
            f"Between {each.after:.6g} s and {each.before:.6g} s a singular configuration was passed, where the "
            f"equations of joints {', '.join(map(repr, each.joints))} depend on each other: the mechanism could go on "
            "in more than one way."
            for each in self.found
        ]
        if self.unclear:
            first, last = self.unclear[0][0], self.unclear[-1][1]
            n = len(self.unclear)
            sentences.append(
                f"Between {n} pairs of samples from {first:.6g} s to {last:.6g} s the mechanism moved too far to tell; "
                "sample more densely."
            )
        return " ".join(sentences) or "No singular configuration was passed."


def singular_passes(system: System, ts: Float[np.ndarray, " n"], ys: Float[np.ndarray, "n size"]) -> SingularPasses:
    """The singular configurations that lie between samples of a motion.

    Along a motion W = U diag(s) V^T can be followed smoothly; where a singular value goes through zero, it goes on as a
    negative one. With U_k and V_k of one sample, and W of the next one,

        U_k^T W V_k = O P,    O orthogonal, P positive

    has O near 1 for samples that are close together, and an eigenvalue of -1 for each singular value that has changed
    its sign between them. Its vector x names the joints, by U_k x. Equations that depend on others all along have
    no part in it.

    Args:
        system: the system.
        ts: sample times [s].
        ys: flat states; those that are not finite are left out.

    Limits: a value that touches zero and turns back is not seen, nor are two passes between the same samples. Samples
    between which an eigenvalue turns by more than a radian are `unclear`.
    """
    structure, theta = flatten_system(_without_forces(system))
    size = structure.system(theta).layout.size
    known = [(float(t), *_rows_at(structure, theta, t, y[:size])[:2]) for t, y in zip(ts, ys, strict=True)]
    known = [each for each in known if each[1].size and np.all(np.isfinite(each[1]))]
    factors: list[Any] = [(t, rows, *np.linalg.svd(rows, full_matrices=True)) for t, rows, _ in known]
    if not factors:
        return SingularPasses((), ())
    names = np.array(known[0][2])
    rank = max(int(np.sum(sizes > NEARLY_DEPENDENT * sizes[0])) for _, _, _, sizes, _ in factors)
    # Of a sample in a singular configuration the sign of a value is rounding: its neighbors tell.
    clear = [each for each in factors if rank and each[3][rank - 1] > SHARE * each[3][0]]
    found, unclear = [], []
    for (t, _, left, _, right), (t_next, rows, *_) in itertools.pairwise(clear):
        first, _, second = np.linalg.svd(left[:, :rank].T @ rows @ right[:rank].T)
        values, vectors = np.linalg.eig(first @ second)
        cosines = np.real(values)
        is_turned = cosines < -TURNED
        if np.any(is_turned):
            shares = np.abs(left[:, :rank] @ vectors[:, is_turned]).max(axis=1)
            joints = tuple(dict.fromkeys(names[shares > PART * shares.max()].tolist()))
            found.append(SingularPass(t, t_next, joints))
        if np.any(~is_turned & (cosines < TURNED)):
            unclear.append((t, t_next))
    return SingularPasses(tuple(found), tuple(unclear))


TURNED = 0.5
"""Cosine of the angle up to which eigenvalues count as 1, or as -1."""

PART = 0.05
"""A joint takes part in a pass by this share of the largest entry: between samples the vector is not the exact one."""


def _without_forces(system: System) -> System:
    """Bodies and constraining joints alone."""
    joints = {name: joint for name, joint in system.joints.items() if joint.n_rows}
    return System(system.bodies, joints, {}, system.gravity, system.drift, (), False)


def weighted_rows(system: System, t: Scalar, y: Float[Array, " size"]) -> dict[str, Float[Array, "n n_v"]]:
    """Rows of D M^(-1/2) of each joint, with M^(-1/2) in each body's own axes of inertia (a bound on its size).

    Rotations are weighted by the trace of the inertia: a positive weight is all that ranks need.
    """
    motions = body_motions(system, unpack(system.layout, y))
    constraints = constraint_set(system, t, motions)
    weighted = {}
    for joint, rows in constraints.rows.items():
        columns = []
        for name, body in system.bodies.items():
            block = constraints.blocks_of(name).get(joint, jnp.zeros((rows.residual.shape[0], VELOCITY_SIZE)))
            turning = jnp.trace(inertia_in_world(body.inertia, motions[name].rotation)) / 3
            weights = jnp.concatenate([body.mass * jnp.ones(3), turning * jnp.ones(3)])
            columns.append(block / safe_sqrt(weights))
        weighted[joint] = jnp.concatenate(columns, 1)
    return weighted


def _rows_at(
    structure: Structure, theta, t: float, y
) -> tuple[Float[np.ndarray, "n n_v"], list[str], Float[np.ndarray, "n 1"]]:
    """Rows of unit length, the joint of each, and the lengths that they had."""
    found = program_for(weighted_rows, structure).compute(theta, float(t), np.asarray(y))
    rows = [np.asarray(block) for block in found.values()]
    names = [joint for joint, block in zip(found, rows, strict=True) for _ in block]
    n_v = structure.system(theta).layout.n_velocity
    W = np.concatenate([np.zeros((0, n_v)), *rows])
    lengths = np.linalg.norm(W, axis=1, keepdims=True)
    return W / np.where(lengths > 0, lengths, 1.0), names, lengths


def _rank(rows: np.ndarray, names: list[str], tolerance: float) -> tuple[int, tuple[str, ...]]:
    """Rank, and the joints that take part in dependences."""
    if not names:
        return 0, ()
    left, sizes, _ = np.linalg.svd(rows, full_matrices=True)
    rank = int(np.sum(sizes > tolerance * sizes[0]))
    shares = np.linalg.norm(left[:, rank:], axis=1)
    taking_part = [name for name, share in zip(names, shares, strict=True) if share > SHARE]
    return rank, tuple(dict.fromkeys(taking_part))


def _nearby(structure: Structure, theta, t: float, y: np.ndarray, rows: np.ndarray) -> np.ndarray | None:
    """A state a little further on a motion that the constraints allow; None where they allow none."""
    system = structure.system(theta)
    n, n_q = system.layout.n_bodies, system.layout.n_position
    positions = y[:n_q].reshape(n, POSITION_SIZE)
    size = max(float(np.ptp(positions[:, :3], axis=0).max()), _arm(system), SMALLEST_SIZE)
    velocities = np.random.default_rng(0).normal(size=(n, VELOCITY_SIZE)) * ([size] * 3 + [1.0] * 3)
    trial = np.concatenate([y[:n_q], velocities.ravel()])
    moving = program_for(consistent_velocities, structure).compute(theta, t, trial)[n_q:].reshape(n, VELOCITY_SIZE)
    fastest = max(float(np.abs(moving[:, :3]).max()) / size, float(np.abs(moving[:, 3:]).max()))
    if fastest < DEPENDENT:
        return None
    moved = np.concatenate([_advanced(positions, moving * (STEP / fastest)).ravel(), np.zeros(n * VELOCITY_SIZE)])
    close = program_for(newton_step, structure)
    for _ in range(8):
        moved = close.compute(theta, t, moved)
    return moved if np.all(np.isfinite(moved)) else None


SMALLEST_SIZE = 1e-3
"""Size [m] of a mechanism that shows none."""


def _arm(system: System) -> float:
    return max(
        (float(np.abs(np.asarray(p)).max()) for joint in system.joints.values() for p in joint.points), default=0
    )


def _advanced(positions: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Bodies displaced and turned by small steps."""
    shift, turn = steps[:, :3], steps[:, 3:] / 2
    scalar, vector = positions[:, 3:4], positions[:, 4:]
    quaternion = np.concatenate(
        [
            scalar - np.sum(turn * vector, 1, keepdims=True),
            vector + scalar * turn + np.cross(turn, vector),
        ],
        1,
    )
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    return np.concatenate([positions[:, :3] + shift, quaternion], 1)

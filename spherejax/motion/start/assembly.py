"""A consistent start: positions and velocities that satisfy the constraints, and a report of what was moved.

Printed tables carry few digits, and a parameter that changes a length moves its neighbors. Newton steps move the
bodies as little as possible, in the metric of their masses and inertias, until the constraints close; then the
velocities are projected. Joints with clearance or elastomer start concentric, as in the paper, unless the scene says
otherwise.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from spherejax.foundations.checks import called, is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.lanes import over_lanes
from spherejax.foundations.rotation import normalized, quaternion_from_rotation_vector, quaternion_product
from spherejax.foundations.types import Numeric, Quaternion, Scalar, Vector3
from spherejax.model.drift import NoDriftControl
from spherejax.model.picking import Picked, picked
from spherejax.model.system import Structure, System, example_of, flatten_system
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import assembly_set, velocity_violation
from spherejax.motion.equations.programs import Program, program_for
from spherejax.motion.equations.projection import least_correction, without_velocities
from spherejax.physics.state import POSITION_SIZE, VELOCITY_SIZE, Layout, State, pack, unpack

N_NEWTON_STEPS = 8
"""Newton's method doubles the digits each step: eight are ample for a start that is off by a few percent."""

CLOSING_TOLERANCE = 1e-9
"""Largest constraint residual [m or 1] of a start that counts as consistent."""


UNMET_TOLERANCE = 1e-5
"""Velocities and accelerations that drivers ask for and do not get, as a share of the largest that is asked for, from
which on they count as contradictory; redundant drivers may be written with five digits."""


class Assembly(NamedTuple):
    """A consistent start and how it was reached.

    Attributes:
        y: flat state without memory and work: positions, then velocities; with them where a motion goes on.
        residual_before: largest constraint residual of the start as described [m or 1].
        residual_after: largest constraint residual of the assembled start; where drivers contradict each other or the
            joints, the share of their velocities or accelerations that they do not get.
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


def as_ideal(system: System) -> System:
    """The system for assembly: geometry and inertia without models and forces; one program serves all models."""
    ideal = {name: called(joint, "as_if_ideal") for name, joint in system.joints.items()}
    joints = {name: joint for name, joint in ideal.items() if joint is not None}
    return System(system.bodies, joints, {}, system.gravity, NoDriftControl(), (), False)


def assemble(structure: Structure, theta: Numeric, t: Scalar | float = 0.0) -> Assembly:
    """Move bodies and velocities to a consistent start at time t [s]; for traced numbers, and differentiable."""
    step, project, residual = _programs_of_start(structure)
    described = _described_by(structure, theta)
    t = jnp.asarray(t, jnp.float64)
    moved = jax.lax.fori_loop(0, N_NEWTON_STEPS, lambda _, y: step(theta, t, y), described)
    moved = project(theta, t, moved)
    before, after = (_largest(residual(theta, t, y)) for y in (described, moved))
    if example_of(structure).is_driven:
        unmet = program_for(unmet_demands, structure)(theta, t, moved)
        after = jnp.maximum(after, jnp.where(unmet > UNMET_TOLERANCE, unmet, 0.0))
    return _report(described, moved, before, after)


def _programs_of_start(structure: Structure) -> list[Program]:
    """A Newton step, the projection of the velocities and the residuals, all of them scalar or none."""
    functions = (newton_step, consistent_velocities, assembly_residuals)
    programs = [program_for(function, structure, largest=LARGEST_OF_START) for function in functions]
    if all(program.scalar is not None for program in programs):
        return programs
    # One that is small enough would be numbers among arrays: of 50 bodies thousands, one by one, and with their
    # derivatives XLA takes 20 s for these alone.
    return [program_for(function, structure, False) for function in functions]


def is_assembled_by_arrays(structure: Structure) -> bool:
    """Whether `assemble` is array code, through which derivatives go forward alone; of the structure of an ideal
    system."""
    return _programs_of_start(structure)[0].scalar is None


LARGEST_OF_START = 8_000
"""Scalar operations up to which the programs of a traced start are scalar ones: they are called a few times, and their
derivatives are compiled as well. On array code XLA takes 3 s for them; as machine code, with the gradient of a chain by
one mass, 1 s for two bodies (2,000 operations), 3 s for five, 9 s for ten, 23 s for twenty (23,000)."""


def assemble_now(structure: Structure, theta: Numeric, t: float = 0.0) -> Assembly:
    """`assemble` for concrete numbers, computed at once, with a check of the result.

    Raises:
        SceneError: when the mechanism cannot be closed, naming the joint that gapes most.
    """
    places = _described_by_numbers(structure)
    if places is not None:
        assembly = _as_described(structure, theta[places].tobytes(), float(t))
        if assembly is not None:
            return assembly
    return _assembled(structure, theta.tobytes(), float(t))


@lru_cache(maxsize=64)
def _described_by_numbers(structure: Structure) -> np.ndarray | None:
    """The numbers that a start at rest depends on whose joints are closed: masses are not among them. None where
    drivers have to be asked, and of array code."""
    programs = program_for(_described, structure), program_for(assembly_residuals, structure)
    read = [program.numbers_read for program in programs if program.numbers_read is not None]
    return None if len(read) < len(programs) or example_of(structure).is_driven else np.union1d(*read)


@lru_cache(maxsize=1024)
def _as_described(structure: Structure, numbers: bytes, t: float) -> Assembly | None:
    """The start of a mechanism that is described closed and at rest; None of another one, which has to be moved."""
    theta = np.zeros(structure.starts[-1])
    theta[_described_by_numbers(structure)] = np.frombuffer(numbers)
    described = program_for(_described, structure).compute(theta, 0.0, np.zeros(_n_start(structure)))
    gaps = program_for(assembly_residuals, structure).compute(theta, t, described)
    if np.any(_velocities(described)) or not _are_closed(gaps):
        return None
    residual = _largest(gaps, np)
    return _report(described, described, residual, residual, np)


def _are_closed(gaps: dict[str, Any]) -> bool:
    return all(np.max(np.abs(gap)) <= _ROUNDING for gap in gaps.values())


@lru_cache(maxsize=1024)
def _assembled(structure: Structure, numbers: bytes, t: float) -> Assembly:
    """Kept: studies of joint models start from the same geometry again and again."""
    theta = np.frombuffer(numbers)
    residual = program_for(assembly_residuals, structure)
    described = program_for(_described, structure).compute(theta, 0.0, np.zeros(_n_start(structure)))
    moved = described
    for _ in range(N_NEWTON_STEPS):
        gaps = residual.compute(theta, t, moved)
        if _are_closed(gaps):
            break
        # Made where it is needed: of 50 bodies this program and the next take a second each, and most scenes that are
        # described at rest and closed need neither.
        moved = program_for(newton_step, structure).compute(theta, t, moved)
    if np.any(_velocities(moved)) or example_of(structure).is_driven:
        moved = program_for(consistent_velocities, structure).compute(theta, t, moved)
    before, gaps = residual.compute(theta, t, described), residual.compute(theta, t, moved)
    assembly = _report(described, moved, _largest(before, np), _largest(gaps, np), np)
    if not assembly.residual_after < CLOSING_TOLERANCE:
        size_of = {name: float(np.nan_to_num(np.max(np.abs(gap)), nan=np.inf)) for name, gap in gaps.items()}
        worst = max(size_of, key=lambda name: size_of[name])
        raise SceneError(
            f"joint {worst!r} cannot be closed: from the start as described, with a residual of "
            f"{float(assembly.residual_before):.3g}, the bodies cannot be moved so that all joints hold (remaining "
            f"residual {size_of[worst]:.3g} m or rad). Check the joint's points and the bodies' positions and "
            "quaternions."
        )
    return assembly


def _velocities(start: Float[np.ndarray, " n"]) -> Float[np.ndarray, " v"]:
    """Velocities and angular velocities of all bodies in a start."""
    n_bodies = start.size // (POSITION_SIZE + VELOCITY_SIZE)
    return start[n_bodies * POSITION_SIZE :]


_ROUNDING = 1e-16
"""Residuals [m or 1] below this are rounding: another Newton step cannot make them smaller."""


def _described(system: System, t: Scalar, y: Float[Array, " n"]) -> Float[Array, " n"]:
    del t, y
    return described_state(system)


@lru_cache(maxsize=64)
def _n_start(structure: Structure) -> int:
    """Length of a flat state without memory: the programs of assembly are made for systems that have none."""
    return example_of(structure).layout.size


def _report(described, moved, before, after, xp: Any = jnp) -> Assembly:
    """The report, in JAX, or in NumPy where everything is known: at once, without compiling anything."""
    n = described.shape[0] // (POSITION_SIZE + VELOCITY_SIZE)
    start, end = unpack(Layout(n), described), unpack(Layout(n), moved)
    return Assembly(
        moved,
        before,
        after,
        _norms(end.position - start.position, xp),
        2 * _norms(_difference(end.quaternion, start.quaternion, xp), xp),
        _norms(end.velocity - start.velocity, xp),
    )


def _largest(gaps: dict[str, Float[Array, " n"]], xp: Any = jnp) -> Scalar:
    return xp.max(xp.abs(xp.concatenate([xp.zeros(1), *gaps.values()])))


def described_state(system: System) -> Float[Array, " n"]:
    """The start as the scene describes it, with unit quaternions, as a flat state without memory."""
    return _packed(*(jnp.stack([jnp.asarray(part) for part in parts]) for parts in _motions_described(system)))


def _motions_described(system: System) -> list[list]:
    """Of all bodies the positions, orientations, velocities and angular velocities that the scene gives."""
    names = ("position", "quaternion", "velocity", "angular_velocity")
    return [[getattr(body, name) for body in system.bodies.values()] for name in names]


def _packed(position, quaternion, velocity, angular_velocity) -> Float[Array, " n"]:
    unit = over_lanes(normalized, quaternion)
    return pack(State(position, unit, velocity, angular_velocity, jnp.zeros(0), jnp.zeros(0)))


def _described_by(structure: Structure, theta: Numeric) -> Float[Array, " n"]:
    """`described_state` of a system that is taken apart: of a hundred bodies, one by one, XLA takes a second for it."""
    picks = _described_at(structure)
    if picks is None:
        return described_state(structure.system(theta))
    parts = [pick.within(jnp.asarray(theta)) for pick in picks]
    n_bodies = len(example_of(structure).bodies)
    return _packed(*(part.reshape(n_bodies, -1) for part in parts))


@lru_cache(maxsize=64)
def _described_at(structure: Structure) -> list[Picked] | None:
    """Where these motions are in the numbers of a system; None where they are not there as they are."""
    picks = [picked(lambda system, i=i: _motions_described(system)[i], structure) for i in range(4)]
    there = [pick for pick in picks if pick is not None]
    return there if len(there) == len(picks) else None


def ideal_numbers(structure: Structure, theta: Float[Array, " p"]) -> tuple[Structure, Any]:
    """`flatten_system(as_ideal(system))` of a system that is taken apart, whose numbers are traced."""
    pick = _ideal_at(structure)
    if pick is None or is_concrete(theta):
        return flatten_system(as_ideal(structure.system(theta)))
    return Structure(pick.tree, pick.shapes, ()), pick.within(theta)


def numbers_of_start(structure: Structure) -> Bool[np.ndarray, " p"]:
    """Which numbers of a system its start may depend on."""
    n, pick = structure.starts[-1], _ideal_at(structure)
    return np.ones(n, bool) if pick is None or example_of(structure).all_slots else pick.among(n)


@lru_cache(maxsize=64)
def _ideal_at(structure: Structure) -> Picked | None:
    pick = picked(as_ideal, structure)
    return None if pick is None or pick.has_constants else pick


def assembly_residuals(system: System, t: Scalar, y: Float[Array, " n"]) -> dict[str, Float[Array, " n_joint"]]:
    """Residual Phi of each joint that the start must satisfy [m or 1]."""
    rows = assembly_set(system, t, body_motions(system, unpack(system.layout, y))).rows
    return {name: found.residual for name, found in rows.items()}


def newton_step(system: System, t: Scalar, y: Float[Array, " n"]) -> Float[Array, " n"]:
    """Move the bodies by -M^-1 D^T (D M^-1 D^T)^-1 Phi."""
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    constraints = assembly_set(system, t, motions)
    steps = least_correction(system, motions, constraints, constraints.residual)
    turned = over_lanes(_turned_back, state.quaternion, steps[:, 3:])
    return pack(state._replace(position=state.position - steps[:, :3], quaternion=turned))


def _turned_back(p: Quaternion, turn: Vector3) -> Quaternion:
    return normalized(quaternion_product(quaternion_from_rotation_vector(-turn), p))


def consistent_velocities(system: System, t: Scalar, y: Float[Array, " n"]) -> Float[Array, " n"]:
    """Remove the part of the velocities that violates the constraints."""
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    constraints = assembly_set(system, t, motions)
    violation = velocity_violation(constraints, motions)
    return pack(without_velocities(state, least_correction(system, motions, constraints, violation)))


def unmet_demands(system: System, t: Scalar, y: Float[Array, " n"]) -> Scalar:
    """What drivers ask for and do not get, as a share of the largest velocity or acceleration that is asked for.

    Equations that depend on others are satisfied with them, or contradict them. Accelerations are looked at where there
    are several drivers: with one, a configuration in which the mechanism can go on in two ways would be taken for a
    contradiction.
    """
    motions = body_motions(system, unpack(system.layout, y))
    constraints = assembly_set(system, t, motions)
    share = _share(velocity_violation(constraints, motions), constraints.rate_at_rest)
    if sum(joint.is_driven for joint in system.joints.values()) < 2:
        return share
    found = least_correction(system, motions, constraints, constraints.bias)
    return jnp.maximum(share, _share(constraints.times(found) - constraints.bias, constraints.bias))


def _share(missing: Float[Array, " n"], demanded: Float[Array, " n"]) -> Scalar:
    largest = jnp.max(jnp.abs(demanded))
    return jnp.where(largest > 0, jnp.max(jnp.abs(missing)) / jnp.where(largest > 0, largest, 1.0), 0.0)


def _difference(a: Float[Array, "b 4"], b: Float[Array, "b 4"], xp: Any) -> Float[Array, "b 4"]:
    """The shorter of a - b and a + b: q and -q are the same rotation."""
    return xp.where(xp.sum(a * b, -1, keepdims=True) < 0, a + b, a - b)


def _norms(rows: Float[Array, "b n"], xp: Any) -> Float[Array, " b"]:
    square = xp.sum(rows * rows, -1)
    return xp.where(square > 0, xp.sqrt(xp.where(square > 0, square, 1.0)), 0.0)

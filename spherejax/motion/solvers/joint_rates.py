"""How fast joints act on the bodies that they join, looked at the start: what an explicit method's steps depend on."""

from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Numeric, Scalar, Vector3
from spherejax.model.system import Structure, System
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import (
    ConstraintSet,
    assembly_set,
    constraint_set,
    inverse_masses,
    solve_augmented,
)
from spherejax.motion.equations.loads import applied_wrenches, by_body
from spherejax.motion.equations.programs import program_for
from spherejax.motion.equations.sampling import initial_force_memory
from spherejax.physics.joints.contact import stiffness_of
from spherejax.physics.joints.rows import ConstraintRows
from spherejax.physics.joints.spherical import PlacedSpherical
from spherejax.physics.state import VELOCITY_SIZE, unpack

USUAL_ECCENTRICITY_RATIO = 0.5
"""Where in its clearance a lubricated ball is looked at."""

SMALL_DEFLECTION = 1e-6
"""Deflection [m] at which an elastomer is looked at."""

LOADS_IN_MOTION = 3.0
"""A joint in contact is looked at under this many times its load at the start."""

CREEP = 1e-9
"""Speed [m/s] at which the ball nears the wall when it is looked at: a film that cavitates has a kink at rest."""

SMALLEST = 1e-12


def rates_in_clearance(structure: Structure, theta: np.ndarray) -> np.ndarray:
    """The fastest rate [1/s] of each force joint with its ball free in the socket: decay, or oscillation."""
    return _rates_in_clearance(structure, theta.tobytes())


def rates_under_load(structure: Structure, theta: np.ndarray, patience: float) -> np.ndarray:
    """The fastest decay [1/s] of each force joint with its ball pressed to the socket by the load at the start.

    Zero for a joint without contact, for one whose film keeps the ball from the socket for longer than `patience` [s],
    and where the decay is slower than the contact oscillates: those oscillations are excited by every impact, all
    methods have to follow them, and the explicit ones do it best.
    """
    return _rates_under_load(structure, theta.tobytes(), patience)


def fastest_in_clearance(structure: Structure, scalar: bool | None, theta: Float[Array, " p"]) -> Float[Array, ""]:
    """The fastest of `rates_in_clearance`, of numbers that are traced, to 7 %: eigenvalues by powers of the matrices.

    Args:
        structure: of the system.
        scalar: whether on scalar programs.
        theta: all numbers of the system.
    """
    program = program_for(joint_actions, structure, scalar)
    found = JointActions(*program(theta, 0.0, _described(structure, theta)))
    decay, frequency = jnp.max(_spectral_radius(found.decays)), jnp.sqrt(jnp.max(_spectral_radius(found.squares)))
    fastest = jnp.max(jnp.stack([decay, frequency, jnp.max(found.forgetting)]))
    return jax.lax.stop_gradient(jnp.where(jnp.isnan(fastest), jnp.inf, fastest))


def _spectral_radius(matrices: Float[Array, "n 3 3"]) -> Float[Array, " n"]:
    """Largest magnitude of an eigenvalue: the 16th root of a norm of the 16th power, at most 3^(1/16) too large."""
    size = jnp.max(jnp.abs(matrices), (1, 2)) + SMALLEST
    power = matrices / size[:, None, None]
    for _ in range(4):
        power = power @ power
    return size * jnp.max(jnp.sum(jnp.abs(power), 2), 1) ** (1 / 16)


@lru_cache(maxsize=1024)
def _rates_in_clearance(structure: Structure, numbers: bytes) -> np.ndarray:
    theta = np.frombuffer(numbers)
    start = _described(structure, theta)
    *found, forgetting = program_for(joint_actions, structure, is_computed=True).compute(theta, 0.0, start)
    decay, frequency = (np.max(np.abs(np.linalg.eigvals(matrices)), axis=1) for matrices in found)
    return np.nan_to_num(np.max([decay, np.sqrt(frequency), forgetting], axis=0), nan=np.inf)


@lru_cache(maxsize=1024)
def _rates_under_load(structure: Structure, numbers: bytes, patience: float) -> np.ndarray:
    theta = np.frombuffer(numbers)
    program = program_for(pressed_actions, structure, is_computed=True)
    found = program.compute(theta, 0.0, _described(structure, theta))
    decay = np.max(np.abs(np.linalg.eigvals(np.nan_to_num(found.decays))), axis=-1)
    frequency = np.sqrt(np.max(np.abs(np.linalg.eigvals(np.nan_to_num(found.squares))), axis=-1))
    decay, frequency = decay.max(axis=1), frequency.max(axis=1)
    return np.where((decay > frequency) & (found.sinking_time < patience), decay, 0.0)


def _described(structure: Structure, theta: Numeric) -> Numeric:
    """The flat state of the start as the scene describes it, at rest."""
    places, n_others = _places(structure)
    xp = np if is_concrete(theta) else jnp
    return xp.concatenate([theta[places], xp.zeros(n_others)])


@lru_cache(maxsize=64)
def _places(structure: Structure) -> tuple[np.ndarray, int]:
    """Which numbers of a system are positions and quaternions of bodies; and how long the rest of a state is."""
    n_numbers = sum(int(np.prod(shape)) for shape in structure.shapes)
    system = structure.system(np.arange(n_numbers))
    places = [part for body in system.bodies.values() for part in (body.position, body.quaternion)]
    return np.concatenate(places), system.layout.size - system.layout.n_position


class JointActions(NamedTuple):
    """How each force joint acts on the relative motion of ball and socket.

    Attributes:
        decays: m^-1 C [1/s], with C = -df/d(e_dot), and m^-1 the relative acceleration of ball and socket for a unit
            force between them, under the constraints, shape (n, 3, 3).
        squares: m^-1 K [1/s^2], with K = -df/de, and what the deflections that a bushing or a liner remembers add to it
            at once.
        forgetting: rate [1/s] at which these deflections fade, at most, with the ball as fast as it gets when it is let
            go into the rubber, shape (n,).
    """

    decays: Float[Array, "n 3 3"]
    squares: Float[Array, "n 3 3"]
    forgetting: Float[Array, " n"]


def joint_actions(system: System, t: Scalar, y: Float[Array, " size"]) -> JointActions:
    """How each force joint acts at the start, its ball where the weights of the bodies would press it."""
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    constraints, masses = constraint_set(system, t, motions), inverse_masses(system, motions)
    weights = applied_wrenches(system, t, motions, memory_at_start(system, t, y, state.memory), None)
    falling = by_body(system, solve_augmented(constraints, masses, weights, constraints.bias).accelerations)
    decays, squares, forgetting = [], [], []
    for name in system.force_joints:
        joint = system.spherical(name)
        motion = joint.relative_motion(motions)
        separation = _relative_acceleration(joint, motions, falling)
        distance = USUAL_ECCENTRICITY_RATIO * getattr(joint.model, "clearance", SMALL_DEFLECTION)
        outward = (separation + SMALLEST * jnp.ones(3)) / (safe_norm(separation) + SMALLEST)

        memory = state.memory[system.memory_of(name)]

        def answer(e, rate, memory, joint=joint, motion=motion):
            response = joint.model.respond(motion._replace(eccentricity=e, eccentricity_rate=rate), memory)
            return response.force, response.memory_rate

        place = distance * outward
        fades = joint.model.memory_fades
        mobility = _mobility(system, motions, constraints, masses, joint)
        by = (0, 1, 2) if fades else (0, 1)
        (stiffness, damping, *by_memory), slopes = jax.jacfwd(answer, by)(place, CREEP * outward, memory)
        fastest = jnp.zeros(())
        if fades:
            stiffness = stiffness + by_memory[0] @ slopes[1]
            frequency = jnp.sqrt(_largest_row(mobility @ stiffness) + SMALLEST)
            speed = safe_norm(separation) / frequency
            fastest = _largest_row(jax.jacfwd(answer, 2)(place, speed * outward, memory)[1])
        forgetting.append(fastest)
        decays.append(mobility @ damping)
        squares.append(mobility @ stiffness)
    return JointActions(jnp.stack(decays), jnp.stack(squares), jnp.stack(forgetting))


def _largest_row(matrix: Float[Array, "n m"]) -> Scalar:
    """Largest sum of magnitudes in a row: a bound of the eigenvalues."""
    return jnp.max(jnp.sum(jnp.abs(matrix), 1))


def memory_at_start(system: System, t: Scalar, y: Float[Array, " size"], memory: Float[Array, " n_memory"]):
    """The memory with which force elements begin: a controller's filter that is zero instead sees its error as new,
    and the kick that follows is many times the load of the joints."""
    if not system.force_slots:
        return memory
    return jnp.concatenate([memory[: system.force_slots[0].start], initial_force_memory(system, t, y)])


class PressedActions(NamedTuple):
    """How each force joint acts with its ball pressed to the socket, for two directions of the load.

    Attributes:
        decays: m^-1 C [1/s and mixed units] of translation and rotation together, shape (n, 2, 6, 6).
        squares: m^-1 K [1/s^2] of translation, shape (n, 2, 3, 3).
        sinking_time: how long the load needs to press the ball through its film [s], shape (n,).
    """

    decays: Float[Array, "n 2 6 6"]
    squares: Float[Array, "n 2 3 3"]
    sinking_time: Float[Array, " n"]


def pressed_actions(system: System, t: Scalar, y: Float[Array, " size"]) -> PressedActions:
    """How each joint with contact acts under the load F that an ideal joint would carry at the start.

    The ball is pressed in by delta, K delta^n = F, along the load, and along the direction in which the bodies yield
    most: a mechanism turns, and its loads with it. It has arrived there with the velocity of a fall through the
    clearance, or with that at which the film gives way, whichever is less. All is zero for a joint without contact.
    """
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    free, masses = constraint_set(system, t, motions), inverse_masses(system, motions)
    closed = assembly_set(system, t, motions)
    weights = applied_wrenches(system, t, motions, memory_at_start(system, t, y, state.memory), None)
    falling = by_body(system, solve_augmented(free, masses, weights, free.bias).accelerations)
    multipliers = solve_augmented(closed, masses, weights, closed.bias).multipliers
    decays, squares, times = [], [], []
    for name in system.force_joints:
        joint = system.spherical(name)
        if not (joint.model.has_surfaces and joint.starts_concentric):
            decays.append(jnp.zeros((2, 6, 6)))
            squares.append(jnp.zeros((2, 3, 3)))
            times.append(jnp.zeros(()))
            continue
        mobility = _mobility_with_rotation(system, motions, free, masses, joint)
        force = LOADS_IN_MOTION * _load(joint, motions, closed.rows[name], multipliers[name])
        fall = safe_norm(_relative_acceleration(joint, motions, falling))
        looks = _pressed(joint, motions, force, jnp.stack([force, _yielding(mobility, force)]), fall)
        decays.append(mobility @ looks.damping)
        squares.append(mobility[:3, :3] @ looks.stiffness)
        times.append(looks.sinking_time[0])
    return PressedActions(jnp.stack(decays), jnp.stack(squares), jnp.stack(times))


def _load(joint: PlacedSpherical, motions, rows: ConstraintRows, multipliers) -> Vector3:
    """What presses ball to socket in the ideal joint, on the socket [N]; of a journal, across its axis."""
    force = rows.jacobians[1][:, :3].T @ multipliers
    return joint.across(joint.motion_of_centers(motions)._replace(eccentricity=force)).eccentricity


class _Looks(NamedTuple):
    damping: Float[Array, "k 6 6"]
    stiffness: Float[Array, "k 3 3"]
    sinking_time: Float[Array, " k"]


def _pressed(joint: PlacedSpherical, motions, force: Vector3, alongs: Float[Array, "k 3"], fall: Scalar) -> _Looks:
    """Derivatives of a joint's answer for a ball that the size of `force` presses in along some directions.

    The law is traced for all directions together: in the film, where there is one, and in the contact.
    """
    model: Any = joint.model
    load = safe_norm(force) + SMALLEST
    motion, clearance = joint.relative_motion(motions), model.clearance
    depth = model.normal.depth(load, stiffness_of(model.normal, model.surfaces))
    n_memory = len(model.memory)

    def answer(e, rate, memory):
        moved = motion._replace(
            eccentricity=e,
            eccentricity_rate=rate[:3],
            ball_angular_velocity=rate[3:],
            socket_angular_velocity=jnp.zeros(3),
        )
        response = model.respond(moved, memory)
        return jnp.concatenate([response.force, response.ball_moment])

    def closing(n):
        return jnp.concatenate([CREEP * n, jnp.zeros(3)])

    def film(ratio, n):
        """Damping [N s/m] of the film by itself: without contact, the memory is that of flight."""
        damping = jax.jacfwd(answer, 1)(ratio * clearance * n, closing(n), jnp.zeros(n_memory))
        return -n @ damping[:3, :3] @ n

    def contact(n, film_at_wall):
        arrival = jnp.sqrt(2 * fall * clearance) + SMALLEST
        arrival = 1 / (1 / arrival + film_at_wall / load)
        memory = model.memory_at_onset(arrival) if n_memory else jnp.zeros(0)
        return jax.jacfwd(answer, (0, 1))((clearance + depth) * n, closing(n), memory)

    normals = jax.vmap(lambda along: along / (safe_norm(along) + SMALLEST))(alongs)
    n = len(alongs)
    if model.medium is None:
        films = jnp.zeros(2 * n)
    else:
        ratios = jnp.array([1.0] * n + [USUAL_ECCENTRICITY_RATIO] * n)
        films = jax.vmap(film)(ratios, jnp.concatenate([normals, normals]))
    stiffness, damping = jax.vmap(contact)(normals, films[:n])
    return _Looks(-damping, -stiffness[:, :3], films[n:] * clearance / load)


def _yielding(mobility: Float[Array, "6 6"], force: Vector3) -> Vector3:
    """About the direction in which bodies yield most to a force: a few steps of the power method."""
    direction = force
    for _ in range(6):
        direction = mobility[:3, :3] @ direction
        direction = direction / (safe_norm(direction) + SMALLEST)
    return direction


def _mobility_with_rotation(system: System, motions, constraints: ConstraintSet, masses, joint) -> Float[Array, "6 6"]:
    """Relative acceleration of ball and socket, linear and angular, for unit forces and moments between them."""
    centers = joint.centers(motions)

    def answer(unit):
        pushes = [
            sign * jnp.concatenate([unit[:3], unit[3:] + jnp.cross(c.arm, unit[:3])]) for sign, c in _sides(centers)
        ]
        accelerations = _accelerations(system, constraints, masses, dict(zip(joint.bodies, pushes, strict=True)))
        turning = jnp.zeros(3)
        for body, sign in zip(joint.bodies, (-1.0, 1.0), strict=True):
            if body in accelerations:
                turning = turning + sign * accelerations[body][3:]
        return jnp.concatenate([_relative_acceleration(joint, motions, accelerations), turning])

    return jax.vmap(answer, out_axes=1)(jnp.eye(6))


def _mobility(system: System, motions, constraints, masses, joint: PlacedSpherical) -> Float[Array, "3 3"]:
    """Relative acceleration of ball and socket for unit forces along the axes [1/kg]."""
    centers = joint.centers(motions)

    def answer(unit):
        pushes = [sign * jnp.concatenate([unit, jnp.cross(c.arm, unit)]) for sign, c in _sides(centers)]
        accelerations = _accelerations(system, constraints, masses, dict(zip(joint.bodies, pushes, strict=True)))
        return _relative_acceleration(joint, motions, accelerations)

    return jax.vmap(answer, out_axes=1)(jnp.eye(3))


def _sides(centers):
    """Socket and ball, with the signs of what acts on them."""
    return tuple(zip((-1.0, 1.0), centers, strict=True))


def _accelerations(system: System, constraints, masses, pushes: dict) -> dict:
    """Of the bodies, under the constraints, for loads on some of them."""
    loads = jnp.stack([pushes.get(name, jnp.zeros(VELOCITY_SIZE)) for name in system.bodies])
    found = solve_augmented(constraints, masses, loads, jnp.zeros_like(constraints.bias))
    return by_body(system, found.accelerations)


def _relative_acceleration(joint: PlacedSpherical, motions, accelerations) -> Float[Array, "3"]:
    """Acceleration of the ball's center against the socket's, for bodies at rest [m/s^2]."""
    total = jnp.zeros(3)
    for body, center, sign in zip(joint.bodies, joint.centers(motions), (-1.0, 1.0), strict=True):
        if body in accelerations:
            a = accelerations[body]
            total = total + sign * (a[:3] + jnp.cross(a[3:], center.arm))
    return total

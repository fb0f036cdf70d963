"""Motors and drivers on bodies that cannot move: 0 degrees of freedom, from the constraint equations at the start."""

from collections.abc import Iterable

import jax
import numpy as np

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.types import Numeric
from spherejax.model.drift import NoDriftControl
from spherejax.model.system import System, flatten_system
from spherejax.motion.equations.programs import program_for
from spherejax.motion.start.assembly import Assembly, consistent_velocities
from spherejax.motion.start.tolerances import SMALLEST_LENGTH
from spherejax.physics.bodies import GROUND
from spherejax.physics.joints.joint import AbstractPlacedJoint
from spherejax.physics.state import POSITION_SIZE, VELOCITY_SIZE

REMAINING = 1e-3
"""Bodies are locked where the joints leave less than this share of any velocity. The projection leaves about
REGULARIZATION / s^2 of a velocity that equations of relative singular value s forbid: 1e-3 for s = 1e-5, where the
run itself still takes the equations for independent. A motion that is possible keeps a share of 0.01 to 1."""

N_TRIALS = 3
"""Velocities drawn at random that are projected: a possible motion would have to be nearly orthogonal to all three."""

N_INSTANTS = 9
"""Instants at which a driver's function is compared with its start: one that holds still is a brake, not a motor."""


def locked_motors(system: System, ts: Numeric, start: Assembly) -> tuple[str, ...]:
    """Sentences about motors and drivers on bodies that the other joints lock; empty where there are none.

    A group of bodies is locked where its joints, drivers left out, allow no velocity at the start. Only joints that
    constrain exactly are counted: clearances and bushings give way. A scene without motor is never looked at: a truss,
    a parked mechanism and a support are meant to stand still.

    Args:
        system: the system, with known geometry.
        ts: sample times [s]; read for drivers.
        start: the consistent start.
    """
    motors = {name: force.body_names for name, force in system.forces.items() if force.is_motor}
    motors |= {name: joint.bodies for name, joint in system.joints.items() if _moves(joint, ts)}
    if not motors or not np.all(np.isfinite(start.y)):
        return ()
    ideal = {name: joint.as_if_ideal() for name, joint in system.joints.items() if _constrains(joint)}
    joints = {name: joint for name, joint in ideal.items() if joint is not None}
    said = []
    for group in _groups(joints.values()):
        acting = [name for name, bodies in motors.items() if group & set(bodies)]
        holding = {name: joint for name, joint in joints.items() if group & set(joint.bodies)}
        # Fewer equations than velocities leave a motion: most mechanisms are not looked at any further.
        n_equations, n_velocities = sum(joint.n_rows for joint in holding.values()), VELOCITY_SIZE * len(group)
        if acting and n_equations >= n_velocities and _is_locked(system, group, holding, np.asarray(start.y)):
            said.append(_message(acting, sorted(group), holding, n_equations, n_velocities))
    return tuple(said)


def _moves(joint: AbstractPlacedJoint, ts: Numeric) -> bool:
    """Whether a joint is a driver whose function of time changes within the run; no where its numbers are traced."""
    if not joint.is_driven or not all(map(is_concrete, jax.tree.leaves(joint.functions_of_time))):
        return False
    instants = np.linspace(float(ts[0]), float(ts[-1]), N_INSTANTS)
    with jax.ensure_compile_time_eval():  # sweeps look at the start while they trace the builder
        values = [[np.asarray(function(t)) for t in instants] for function in joint.functions_of_time]
    return any(np.ptp(history, axis=0).max() > 0 for history in values)


def _constrains(joint: AbstractPlacedJoint) -> bool:
    return joint.n_rows > 0 and not joint.is_driven and not joint.answers_with_force


def _groups(joints: Iterable[AbstractPlacedJoint]) -> list[set[str]]:
    """Moving bodies that joints connect, not by way of the ground."""
    groups: list[set[str]] = []
    for joint in joints:
        group = set(joint.bodies) - {GROUND}
        touched = [other for other in groups if other & group]
        groups = [other for other in groups if not other & group] + [group.union(*touched)]
    return groups


def _is_locked(system: System, group: set[str], joints: dict[str, AbstractPlacedJoint], y: np.ndarray) -> bool:
    """Whether joints allow no velocity of some bodies at a state."""
    bodies = {name: body for name, body in system.bodies.items() if name in group}
    # Where the whole mechanism is one group of ideal joints, this is the system of the assembly, whose program exists.
    alone = System(bodies, joints, {}, system.gravity, NoDriftControl(), (), False)
    structure, theta = flatten_system(alone)
    places = y[: POSITION_SIZE * len(system.bodies)].reshape(-1, POSITION_SIZE)
    places = places[[name in group for name in system.bodies]]
    arms = [np.abs(np.asarray(point)).max() for joint in joints.values() for point in joint.points]
    size = max(SMALLEST_LENGTH, *arms)
    units = np.array([size] * 3 + [1.0] * 3)
    draw, program = np.random.default_rng(0), program_for(consistent_velocities, structure)
    for _ in range(N_TRIALS):
        trial = draw.normal(size=(len(bodies), VELOCITY_SIZE))
        trial /= np.abs(trial).max()
        projected = program.compute(theta, 0.0, np.concatenate([places.ravel(), (trial * units).ravel()]))
        left = np.asarray(projected)[places.size :].reshape(trial.shape) / units
        if not np.abs(left).max() < REMAINING:
            return False
    return True


def _message(
    motors: list[str],
    bodies: list[str],
    joints: dict[str, AbstractPlacedJoint],
    n_equations: int,
    n_velocities: int,
) -> str:
    acts = f"motor {motors[0]!r} acts" if len(motors) == 1 else f"motors {_listed(motors)} act"
    are = f"body {bodies[0]!r}, which is" if len(bodies) == 1 else f"bodies {_listed(bodies)}, which are"
    counted = ", ".join(f"{name!r} {joint.n_rows}" for name, joint in joints.items())
    return (
        f"{acts} on {are} locked: 0 degrees of freedom. The joints have {n_equations} constraint equations for the "
        f"{n_velocities} velocities of {len(bodies)} {'body' if len(bodies) == 1 else 'bodies'} ({counted}). Check "
        "that axes that should be parallel are, or take a joint with fewer equations, e.g. a Spherical at one end of a "
        "rod and a Universal at the other, a Cylindrical for a Revolute"
    )


def _listed(names: list[str]) -> str:
    return ", ".join(map(repr, names))

"""Where the search for an equilibrium starts: at the position of the ideal joints, with balls pressed to the wall."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.types import Scalar
from spherejax.model.system import Structure, System, example_of
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import constraint_set
from spherejax.motion.equations.programs import program_for
from spherejax.motion.equations.projection import least_correction
from spherejax.physics.joints.spherical import PlacedSpherical
from spherejax.physics.kinematics import RelativeMotion
from spherejax.physics.state import VELOCITY_SIZE, pack, unpack
from spherejax.program_cache import cached_jit
from spherejax.studies.rig.bench import N_INPUTS, moved, with_inputs
from spherejax.studies.rig.kinematics import Statics, statics_of

UNLOADED = 1e-6
"""Share of the largest reaction below which a joint with clearance counts as unloaded."""

SHALLOW = 1e-9
"""Clearances by which a ball must be pressed in to count as loaded: where nothing is, reactions are rounding alone."""

ONSET = 1.0
"""Velocity with which a contact is said to have begun [m/s]: at rest no law asks how large it was."""

N_BISECTIONS = 60
"""Halvings of the logarithm of a penetration between 1e-12 and 1e2 clearances: to rounding."""

N_DISPLACEMENTS = 4
"""Newton steps that bring balls to the wall: a clearance is a thousandth of the mechanism."""


class RigStart(NamedTuple):
    """Where Newton's method starts.

    Attributes:
        y: flat state with the memory of the joints.
        multipliers: of the constraints that are left.
        is_loaded: whether each ball with a clearance is pressed.
        loose: as of `kinematics.Reading`.
    """

    y: Any
    multipliers: Any
    is_loaded: Any
    loose: Any


def rig_statics(system: System, t: Scalar, numbers) -> Statics:
    """Reactions of ideal joints."""
    y, inputs = numbers
    system = with_inputs(system, inputs)
    return statics_of(system, t, unpack(system.layout, y))


def rig_displaced(system: System, t: Scalar, numbers) -> Float[Array, " size"]:
    """A Newton step to the position in which points of joints lie apart by given offsets [m], and all else closes."""
    y, offsets, inputs = numbers
    system = with_inputs(system, inputs)
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    constraints = constraint_set(system, t, motions)
    step = -least_correction(system, motions, constraints, constraints.residual - offsets)
    position, quaternion = moved(state.position, state.quaternion, step.reshape(-1, VELOCITY_SIZE))
    return pack(state._replace(position=position, quaternion=quaternion))


@cached_jit(what="balls at the wall")
def depths(structure: Structure, names: tuple[str, ...], theta, forces):
    """How far balls with clearance lie off their sockets' centers under forces [m], and by how many clearances they are
    pressed in; two numbers for each joint."""
    system = structure.system(theta)
    return jnp.stack([_depth_for(system.spherical(name), force) for name, force in zip(names, forces, strict=True)])


def _depth_for(joint: PlacedSpherical, force: Scalar) -> Float[Array, "2"]:
    """Distance |e| at which the contact answers with a force [m], by halving, and |e|/c - 1."""
    zero, pressed = jnp.zeros(3), joint.model.memory_at_onset(jnp.asarray(ONSET))
    model: Any = joint.model

    def answer(distance):
        e = jnp.stack([distance, jnp.zeros(()), jnp.zeros(())])
        motion = RelativeMotion(e, zero, jnp.eye(3), jnp.array([1.0, 0.0, 0.0, 0.0]), zero, zero, jnp.eye(3))
        return -joint.model.respond(motion, pressed).force[0]

    def halve(_, ends):
        low, high = ends
        middle = 0.5 * (low + high)
        is_less = answer(model.clearance * (1.0 + jnp.exp(middle))) < force
        return jnp.where(is_less, middle, low), jnp.where(is_less, high, middle)

    ends = jnp.asarray(np.log(1e-12)), jnp.asarray(np.log(1e2))
    low, high = jax.lax.fori_loop(0, N_BISECTIONS, halve, ends)
    share = jnp.exp(0.5 * (low + high))
    return jnp.stack([model.clearance * (1.0 + share), share])


class Starter:
    """Finds starts for a system and the same with ideal joints."""

    def __init__(self, real: Structure, ideal: Structure):
        self.real, self.ideal = real, ideal
        system = example_of(real)
        places, kept = rows_of(example_of(ideal)), rows_of(system)
        self._loose = tuple(n for n in system.force_joints if system.spherical(n).model.has_surfaces)
        self._balls = [places[name] for name in self._loose]
        self._kept = np.concatenate([np.zeros(0, int), *(places[name] for name in kept)])
        self._n_rows = sum(len(rows) for rows in places.values())
        self._memory = _memory_of(system)
        size = example_of(ideal).layout.size
        self._statics = program_for(rig_statics, ideal, True, (size, N_INPUTS))
        self._displace = (
            program_for(rig_displaced, ideal, True, (size, self._n_rows, N_INPUTS)) if self._loose else None
        )

    def at(self, ideal_numbers: Any, real_numbers: Any, y: Any, inputs: Any, xp: Any) -> RigStart:
        """From a position of ideal joints.

        Args:
            ideal_numbers: theta of the system with ideal joints.
            real_numbers: theta of the system as it is.
            y: position.
            inputs: travel, steer and loads.
            xp: NumPy for known numbers, `jax.numpy` for others.
        """
        call = (
            (lambda p, *x: p.compute(ideal_numbers, 0.0, x)) if xp is np else (lambda p, *x: p(ideal_numbers, 0.0, x))
        )
        statics = call(self._statics, y, inputs)
        multipliers = statics.multipliers[self._kept]
        if self._displace is None:
            return RigStart(xp.concatenate([y, self._memory]), multipliers, True, statics.loose)
        # -lambda is the force on the ball; the wall that gives it is on the other side.
        pushes = xp.stack([statics.multipliers[rows] for rows in self._balls])
        sizes = xp.sqrt(xp.sum(pushes * pushes, 1))
        pressed = sizes > UNLOADED * xp.max(xp.abs(statics.multipliers))
        sizes = xp.where(pressed, sizes, 1.0)
        far, share = xp.asarray(depths(self.real, self._loose, xp.asarray(real_numbers), sizes)).T
        pressed = pressed & (share > SHALLOW)
        by_ball = (pushes / sizes[:, None]) * far[:, None]
        chosen = np.zeros((self._n_rows, 3 * len(self._balls)))
        chosen[np.concatenate(self._balls), np.arange(chosen.shape[1])] = 1.0
        offsets = chosen @ by_ball.ravel()
        for _ in range(N_DISPLACEMENTS):
            y = call(self._displace, y, offsets, inputs)
        return RigStart(xp.concatenate([y, self._memory]), multipliers, xp.all(pressed), statics.loose)


def _memory_of(system: System) -> np.ndarray:
    """The memory at rest, and no work: contacts have begun, rubber is relaxed."""
    memory = np.zeros(system.layout.n_memory + system.layout.n_work)
    for slot in system.memory_slots:
        model = system.spherical(slot.joint).model
        if model.has_surfaces:
            with jax.ensure_compile_time_eval():
                memory[slot.entries] = np.asarray(model.memory_at_onset(jnp.asarray(ONSET)))
    return memory


def rows_of(system: System) -> dict[str, np.ndarray]:
    """Where the equations of each joint are among all of a system whose numbers need not be known."""

    def residuals(system):
        motions = body_motions(system, unpack(system.layout, jnp.zeros(system.layout.size)))
        rows = constraint_set(system, jnp.zeros(()), motions).rows
        names.extend(rows)
        return [each.residual for each in rows.values()]

    names: list[str] = []
    sizes = [each.shape[0] for each in jax.eval_shape(residuals, system)]
    starts = np.cumsum([0, *sizes])
    return {name: np.arange(a, a + n) for name, a, n in zip(names, starts, sizes, strict=False)}

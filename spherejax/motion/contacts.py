"""Contacts of a system as functions of the flat state: where contact begins and ends, and what is remembered then."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.types import Scalar
from spherejax.model.system import System
from spherejax.motion.dynamics import body_motions, state_rate
from spherejax.physics.joints.base import Crossing
from spherejax.physics.kinematics import RelativeMotion
from spherejax.physics.state import unpack


def relative_motions(system: System, y: Float[Array, " size"]) -> dict[str, RelativeMotion]:
    """Motion of ball in socket for each joint whose contact onsets are located."""
    motions = body_motions(system, unpack(system.layout, y))
    return {name: system.joints[name].relative_motion(motions) for name in system.contact_joints}


def crossings(system: System, t: Scalar, y: Float[Array, " size"]) -> Crossing:
    """Crossing functions of all contacts and their rates, each of shape (n_contacts,)."""
    del t
    each = [system.joints[name].model.crossing(m) for name, m in relative_motions(system, y).items()]
    return Crossing(jnp.stack([c.value for c in each]), jnp.stack([c.rate for c in each]))


def memory_after_step(system: System, t: Scalar, y_pair: Float[Array, "2 size"]) -> Float[Array, " n_memory"]:
    """The memory at the end of a step, updated where a contact began or ended within it.

    Args:
        system: the system.
        t: time at the end of the step [s].
        y_pair: flat states at the start and at the end of the step, stacked.

    Returns:
        In flight at the start and beyond the surface at the end: the memory of an onset with the normal velocity at
        the end. In contact at the start and off the surface at the end: the memory of a release. Else unchanged.
    """
    return _memory_after_step(system, t, y_pair, is_exact=False)


def exact_memory_after_step(system: System, t: Scalar, y_pair: Float[Array, "2 size"]) -> Float[Array, " n_memory"]:
    """`memory_after_step` with the onset rate at the instant when the surface is crossed, to first order.

    delta_dot - delta_ddot delta / delta_dot at the end of the step: the value differs from delta_dot by less than the
    landing window allows; the derivative differs by how the instant of onset moves with the parameters.
    """
    return _memory_after_step(system, t, y_pair, is_exact=True)


def _memory_after_step(system: System, t, y_pair, is_exact: bool):
    y_start, y_end = y_pair[0], y_pair[1]
    memory_start = unpack(system.layout, y_start).memory
    memory_end = unpack(system.layout, y_end).memory
    motions = relative_motions(system, y_end)
    accelerations = _penetration_accelerations(system, t, y_end) if is_exact else None
    parts = []
    for slot in system.memory_slots:
        now = memory_end[slot.entries]
        if slot.joint in motions:
            model, motion = system.joints[slot.joint].model, motions[slot.joint]
            was_touching = memory_start[slot.start] > 0
            is_beyond = model.crossing(motion).value > 0
            rate = motion.eccentricity_rate @ motion.eccentricity / _length(motion.eccentricity)
            if accelerations is not None:
                # A grazing onset has no first-order correction: its instant moves without bound.
                is_grazing = jnp.abs(rate) < GRAZING_RATE
                correction = accelerations[slot.joint] * model.penetration(motion) / jnp.where(is_grazing, 1.0, rate)
                rate = jnp.where(is_grazing, rate, rate - correction)
            now = jnp.where(~was_touching & is_beyond, model.memory_at_onset(rate), now)
            now = jnp.where(was_touching & ~is_beyond, model.memory_at_release(), now)
        parts.append(now)
    return jnp.concatenate(parts)


GRAZING_RATE = 1e-9
"""Onsets slower than this [m/s] touch the surface within the landing window: they have no instant to speak of."""


def _length(e):
    return jnp.sqrt(jnp.maximum(e @ e, 1e-300))


def _penetration_accelerations(system: System, t, y) -> dict[str, Scalar]:
    """Second time derivative of each penetration [m/s^2]: the rate's derivative along the motion."""
    rate = state_rate(system, t, y)

    def penetration_rates(y):
        motions = relative_motions(system, y)
        return {name: m.eccentricity_rate @ m.eccentricity / _length(m.eccentricity) for name, m in motions.items()}

    return jax.jvp(penetration_rates, (y,), (rate,))[1]


def initial_memory(system: System, y: Float[Array, " size"]) -> Float[Array, " n_memory"]:
    """The memory at the start: flight, or, for a ball that starts beyond the surface, an onset at that instant."""
    motions = relative_motions(system, y)
    parts = []
    for slot in system.memory_slots:
        start = jnp.zeros(len(slot.names))
        if slot.joint in motions:
            model, motion = system.joints[slot.joint].model, motions[slot.joint]
            rate = motion.eccentricity_rate @ motion.eccentricity / _length(motion.eccentricity)
            start = jnp.where(model.crossing(motion).value > 0, model.memory_at_onset(rate), start)
        parts.append(start)
    return jnp.concatenate(parts) if parts else jnp.zeros(0)

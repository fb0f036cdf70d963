"""Force elements that sample, as functions of the flat state: when the next sample is due, and what it changes."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.types import Scalar
from spherejax.model.system import System
from spherejax.motion.equations.body_motions import body_motions
from spherejax.physics.forces.remembering import memory_at_start
from spherejax.physics.state import unpack


def next_samples(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " n_sampled"]:
    """Instant of the coming sample of each force element that samples [s]."""
    del t
    forces: Any = system.forces_with(unpack(system.layout, y).memory)
    return jnp.stack([forces[name].next_sample() for name in system.sampled_forces])


def due_samples(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " n_sampled"]:
    """1 for each force element that samples whose coming sample has come, else 0."""
    forces: Any = system.forces_with(unpack(system.layout, y).memory)
    return jnp.stack([jnp.where(forces[name].is_due(t), 1.0, 0.0) for name in system.sampled_forces])


def memory_after_samples(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " n_memory"]:
    """The memory of all joints and forces behind the samples that are due at t; unchanged where none is.

    Elements that sample at the same instant see the same state: a sample changes its own memory alone.
    """
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    forces: Any = system.forces_with(state.memory)
    parts = [state.memory[: _start_of_forces(system)]]
    for slot in system.force_slots:
        now = state.memory[slot.entries]
        if slot.joint in system.sampled_forces:
            force = forces[slot.joint]
            now = jnp.where(force.is_due(t), force.sampled(t, motions), now)
        parts.append(now)
    return jnp.concatenate(parts)


def initial_force_memory(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " n"]:
    """The memory of the force elements where a motion begins."""
    motions = body_motions(system, unpack(system.layout, y))
    parts = [memory_at_start(system.forces[slot.joint], t, motions) for slot in system.force_slots]
    return jnp.concatenate([jnp.zeros(0), *parts])


def _start_of_forces(system: System) -> int:
    return system.force_slots[0].start if system.force_slots else system.layout.n_memory

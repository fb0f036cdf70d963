"""Contacts of a system as functions of the flat state: where contact begins and ends, and what is remembered then."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.numerics import safe_sqrt
from spherejax.foundations.types import Scalar
from spherejax.model.system import MemorySlot, Structure, System
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.dynamics import state_rate
from spherejax.physics.joints.base import Crossing
from spherejax.physics.kinematics import RelativeMotion
from spherejax.physics.state import unpack


@lru_cache(maxsize=64)
def kinks_of(structure: Structure) -> tuple[int, ...]:
    """Indices of the crossing functions of `crossings` where the slope of the force by the depth may jump.

    All touches, and contacts whose force does not surely grow from a slope of zero; see `stiffens_from_zero`.
    """
    system = _system_as_known(structure)
    contacts = [system.spherical(name).model for name in system.contact_joints]
    n_touches = sum(system.forces[name].n_touches for name in system.touching_forces)
    of_contacts = [i for i, model in enumerate(contacts) if not model.stiffens_from_zero]
    return (*of_contacts, *range(len(contacts), len(contacts) + n_touches))


def _system_as_known(structure: Structure) -> System:
    """The system with the numbers that a program is compiled for, and NaN for the others."""
    numbers = np.full(sum(int(np.prod(shape)) for shape in structure.shapes), np.nan)
    for index, value in structure.special:
        numbers[index] = value
    return structure.system(numbers)


def abrupt_contacts(system: System) -> tuple[str, ...]:
    """Names of the contacts through which derivatives by Rosenbrock methods are not right; see `stiffens_abruptly`."""
    models = {name: system.spherical(name).model for name in system.contact_joints}
    return tuple(name for name, model in models.items() if not model.stiffens_from_zero and model.stiffens_abruptly)


@lru_cache(maxsize=64)
def may_have_abrupt_contacts(structure: Structure) -> bool:
    """Whether a system has any, as far as its structure says: an exponent that is neither 1 nor 1.5 is not known."""
    return bool(abrupt_contacts(_system_as_known(structure)))


def relative_motions(system: System, y: Float[Array, " size"]) -> dict[str, RelativeMotion]:
    """Motion of ball in socket for each joint whose contact onsets are located."""
    motions = body_motions(system, unpack(system.layout, y))
    return {name: system.spherical(name).relative_motion(motions) for name in system.contact_joints}


def crossings(system: System, t: Scalar, y: Float[Array, " size"]) -> Crossing:
    """Crossing functions of all contacts, then of all touches of one-sided forces, with a leading axis.

    A touch is located as a contact is, but remembers nothing; its depth [m] is the crossing function.
    """
    state = unpack(system.layout, y)
    motions, forces = body_motions(system, state), system.forces_with(state.memory)
    each = [
        contact.model.crossing(contact.relative_motion(motions))
        for contact in map(system.spherical, system.contact_joints)
    ]
    for name in system.touching_forces:
        for depth, rate in forces[name].touches(t, motions):
            each.append(Crossing(depth, rate, rate * jnp.array([1.0, 0.0, 0.0])))
    return Crossing(*(jnp.stack(parts) for parts in zip(*each, strict=True)))


def memory_after_step(
    system: System,
    t: Scalar,
    step: tuple[Float[Array, " size"], Float[Array, " size"], Float[Array, " n_contacts"]],
) -> Float[Array, " n_memory"]:
    """The memory at the end of a step, updated where a contact began or ended within it.

    Args:
        system: the system.
        t: time at the end of the step [s].
        step: flat states at the start and at the end of the step, and a slope delta_ddot / delta_dot [1/s] for each
            contact. Not one after the other in one array: for each entry of it XLA would evaluate the slopes again.

    Returns:
        In flight at the start and beyond the surface at the end: the memory of an onset with the normal velocity
        delta_dot - slope delta. In contact at the start and off the surface at the end: the memory of a release. Else
        unchanged.

        With the true slope this is, to first order, the velocity at the instant when the surface was crossed. Its
        value differs from delta_dot by less than the landing window allows, and the slope may be 0; its derivative
        needs the slope, for the instant of the onset moves with the parameters.
    """
    y_start, y_end, slopes = step
    memory_start = unpack(system.layout, y_start).memory

    def event_of(slot: MemorySlot, model: Any, motion: RelativeMotion):
        was_touching = model.is_touching(memory_start[slot.entries])
        is_beyond = model.crossing(motion).value > 0
        slope = slopes[system.contact_joints.index(slot.joint)]
        rate = model.penetration_rate(motion) - slope * model.penetration(motion)
        return rate, ~was_touching & is_beyond, was_touching & ~is_beyond

    return _memory_after_events(system, y_end, event_of)


def _memory_after_events(system: System, y: Float[Array, " size"], event_of: Callable) -> Float[Array, " n_memory"]:
    """The memory of a flat state, with that of each contact which begins or ends there replaced.

    Args:
        system: the system.
        y: flat state.
        event_of: function of a contact's memory slot, its model and its relative motion. It returns the normal velocity
            of an onset [m/s], whether contact begins, and whether it ends.
    """
    memory = unpack(system.layout, y).memory
    motions = relative_motions(system, y)
    parts = []
    for slot in system.memory_slots:
        entries = memory[slot.entries]
        if slot.joint in motions:
            model: Any = system.spherical(slot.joint).model
            onset_rate, begins, ends = event_of(slot, model, motions[slot.joint])
            after = jnp.where(begins, model.memory_at_onset(onset_rate), entries)
            after = jnp.where(ends, model.memory_at_release(), after)
            lasts = np.array([entry.lasts for entry in slot.contents])
            entries = jnp.where(lasts, entries, after) if lasts.any() else after
        parts.append(entries)
    if system.force_slots:
        parts.append(memory[system.force_slots[0].start :])
    return jnp.concatenate(parts) if parts else memory


def state_after_events(
    system: System, t: Scalar, at_event: tuple[Float[Array, " size"], Float[Array, " n_contacts"]]
) -> Float[Array, " size"]:
    """The flat state behind contact events: a contact in flight begins, one that touches ends.

    Args:
        system: the system.
        t: time of the event [s].
        at_event: flat state where the crossing function is zero, and for each contact 1 where it has its event, else 0.
            Here the mode alone decides: on which side of the surface rounding has left a root says nothing.
    """
    y, events = at_event
    layout = system.layout
    memory = unpack(layout, y).memory

    def event_of(slot: MemorySlot, model: Any, motion: RelativeMotion):
        is_touching = model.is_touching(memory[slot.entries])
        happens = events[system.contact_joints.index(slot.joint)] > 0
        return model.penetration_rate(motion), happens & ~is_touching, happens & is_touching

    after = _memory_after_events(system, y, event_of)
    return jnp.concatenate([y[: layout.memory_start], after, y[layout.work_start :]])


def event_values(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " n_contacts"]:
    """For each contact its crossing function in contact, and minus that in flight: it falls through 0 at its event."""
    values = crossings(system, t, y).value
    memory = unpack(system.layout, y).memory
    models: Any = {name: system.spherical(name).model for name in system.contact_joints}
    are_touching = jnp.stack([model.is_touching(memory[system.memory_of(name)]) for name, model in models.items()])
    values = values[: len(models)]
    return jnp.where(are_touching, values, -values)


def onset_slopes(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " n_contacts"]:
    """delta_ddot / delta_dot [1/s] of each contact; 0 for a grazing one, whose instant moves without bound."""
    rate = state_rate(system, t, y)

    def penetration_rates(y):
        motions = relative_motions(system, y)
        return jnp.stack([system.spherical(name).model.penetration_rate(m) for name, m in motions.items()])

    rates, accelerations = jax.jvp(penetration_rates, (y,), (rate,))
    is_grazing = jnp.abs(rates) < GRAZING_RATE
    return jnp.where(is_grazing, 0.0, accelerations / jnp.where(is_grazing, 1.0, rates))


GRAZING_RATE = 1e-9
"""Onsets slower than this [m/s] touch the surface within the landing window: they have no instant to speak of."""


def initial_memory(system: System, y: Float[Array, " size"]) -> Float[Array, " n_memory"]:
    """The joints' memory at the start: flight, or the onset that led a ball there which starts beyond the surface."""
    motions = relative_motions(system, y)
    parts = []
    for slot in system.memory_slots:
        start = jnp.zeros(len(slot.names))
        if slot.joint in motions:
            model, motion = system.spherical(slot.joint).model, motions[slot.joint]
            onset = model.memory_at_onset(earlier_onset_rate(system, slot.joint, motion, start))
            start = jnp.where(model.crossing(motion).value > 0, onset, start)
        parts.append(start)
    return jnp.concatenate(parts) if parts else jnp.zeros(0)


def memory_of_contacts_at(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " n_memory"]:
    """The memory of a state whose clearances may have been changed: contacts that the change made, or took away.

    A ball in flight that is now beyond the surface has the onset that would have led it there (`earlier_onset_rate`); a
    ball in contact that is now off the surface is released. Where nothing was changed, the memory is as it was.
    """
    del t
    memory = unpack(system.layout, y).memory

    def event_of(slot: MemorySlot, model: Any, motion: RelativeMotion):
        is_touching, is_beyond = model.is_touching(memory[slot.entries]), model.crossing(motion).value > 0
        rate = earlier_onset_rate(system, slot.joint, motion, jnp.zeros(len(slot.names)))
        return rate, ~is_touching & is_beyond, is_touching & ~is_beyond

    return _memory_after_events(system, y, event_of)


def earlier_onset_rate(system: System, joint: str, motion: RelativeMotion, memory: Float[Array, " n_memory"]) -> Scalar:
    """The normal velocity [m/s] with which a ball that starts beyond the surface has come there.

        m v^2 / 2 = m delta_dot^2 / 2 + (energy stored at the penetration delta)

    with m the reduced mass of the two bodies: a free impact without losses. A ball that starts at rest in static
    contact would otherwise have an onset of no speed, and the hysteresis damping, which divides by it, no bound.

    Limits: |delta_dot| at delta = 0, with derivative 0 where that vanishes as well.
    """
    model = system.spherical(joint).model
    rate, energy = model.penetration_rate(motion), model.stored_energy(motion, memory)
    masses = [system.bodies[name].mass for name in system.joints[joint].bodies if name in system.bodies]
    return safe_sqrt(rate * rate + 2 * energy * sum(1 / jnp.asarray(mass) for mass in masses))

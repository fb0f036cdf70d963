"""What joints and forces remember: entries of the state beside positions and velocities, with names, units, scales."""

from typing import Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from spherejax.foundations.types import Scalar, Vector3

Scale = Literal["length", "angle", "speed", "angular_speed", "force", "moment", "film"]

SMALLEST_ONSET_RATE = 1e-12
"""Onset rates are at least this [m/s]: a contact that begins without velocity has begun all the same."""


class MemoryEntry(NamedTuple):
    """One number that a joint or a force element remembers (static).

    Attributes:
        name: in tables, files and tests.
        unit: SI unit.
        scale: what its errors are judged against: `"length"`, `"angle"`, `"speed"`, `"angular_speed"`, `"force"` or
            `"moment"` of the mechanism, `"film"` for thicknesses within a clearance, or a number in its unit; see
            `component_tolerances`.
        lasts: whether it goes on through onsets and releases; others take the values of `memory_at_onset` there.
        counts_turns: whether it only says in which turn an angle is, which nothing hangs on besides: no state of a
            linearization, and no part of what has to come back in a cycle.
    """

    name: str
    unit: str
    scale: Scale | float
    lasts: bool = False
    counts_turns: bool = False


ONSET_RATE = MemoryEntry("onset_rate", "m/s", "speed")
"""Normal velocity at the onset of contact, 0 in flight: first entry of every model with contact."""


def vector(name: str, unit: str, scale: Scale) -> tuple[MemoryEntry, ...]:
    """The entries of a vector."""
    return tuple(MemoryEntry(f"{name}_{axis}", unit, scale) for axis in "xyz")


def bristles() -> tuple[MemoryEntry, ...]:
    """Deflections of the bristles of a contact.

    Their scale is that of speeds: they turn into force by a stiffness of 1e5/m and more, and are small against every
    length; the relative tolerance alone judges them.
    """
    return vector("bristle", "m", "speed")


def contact_memory(remembers_bristles: bool) -> tuple[MemoryEntry, ...]:
    """Entries of a contact: the onset rate, and bristles of laws that have them."""
    return (ONSET_RATE, *(bristles() if remembers_bristles else ()))


def onset_rate(memory: Float[Array, " n_memory"]) -> Scalar:
    """Of a contact [m/s]; 0 in flight."""
    return memory[0]


def bristle(memory: Float[Array, " n_memory"]) -> Vector3:
    """Deflection of a contact's bristles, where it has some [m]."""
    return memory[1:4]


def is_touching(memory: Float[Array, " n_memory"]) -> Bool[Array, ""]:
    """Whether a contact has begun and not ended."""
    return onset_rate(memory) > 0


def memory_at_onset(entries: tuple[MemoryEntry, ...], rate: Scalar) -> Float[Array, " n_memory"]:
    """The onset rate is remembered; bristles start undeflected, and what lasts is left to whoever asks."""
    return jnp.concatenate([jnp.maximum(rate, SMALLEST_ONSET_RATE)[None], jnp.zeros(len(entries) - 1)])

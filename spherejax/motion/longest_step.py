"""How long a step may be where something depends on time by itself: a road, a drive, an applied force.

At rest nothing limits a step of a stiff method but its error, which is nothing; it would pass over a bump in the road
without ever looking there. Motion that follows from the state alone needs no such limit.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.model.system import Structure
from spherejax.motion.dynamics import state_rate
from spherejax.motion.programs import program_for

STEPS_AT_LEAST = 100
"""Steps over the whole motion, at least: what lasts for a fiftieth of it is met."""

_TIME = 1
"""Place of t among the arguments of a program."""


def longest_step(
    structure: Structure, ts: Float[Array, " n"], *, scalar: bool | None = None
) -> Float[Array, ""] | None:
    """The longest step [s] for a motion from the first to the last of `ts`; None where time does not enter.

    Args:
        structure: structure of the system.
        ts: sample times [s].
        scalar: whether the run is on the scalar program, which shows whether time enters; array code does not, and
            counts as if it did.
    """
    program = program_for(state_rate, structure, scalar).scalar
    if program is not None and not program.reads(_TIME):
        return None
    return (jnp.asarray(ts)[-1] - jnp.asarray(ts)[0]) / STEPS_AT_LEAST

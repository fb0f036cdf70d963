"""How long a step may be where something depends on time by itself: a road, a drive, an applied force.

At rest nothing limits a step of a stiff method but its error, which is nothing; it would pass over a bump in the road
without ever looking there. Roads and drives that know where they begin, end and turn (`distance_to_breakpoint`) are met
there, however short they are, and so are the instants at which a force element samples; of a function of the user's own
nothing is known, and a hundredth of the motion is the limit. Motion that follows from the state alone needs none.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.types import Scalar
from spherejax.model.system import Structure, System, example_of
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.physics.functions.base import nearest_breakpoint
from spherejax.physics.state import unpack

STEPS_AT_LEAST = 100
"""Steps over the whole motion, at least: what lasts for a fiftieth of it is met."""


def longest_step(
    structure: Structure, ts: Float[Array, " n"], *, scalar: bool | None = None
) -> Float[Array, ""] | None:
    """The longest step [s] for a motion from the first to the last of `ts`; None where time does not enter.

    Args:
        structure: structure of the system.
        ts: sample times [s].
        scalar: whether the run is on the scalar program.
    """
    program = program_for(state_rate, structure, scalar)
    if not program.reads_time:
        return None
    return (jnp.asarray(ts)[-1] - jnp.asarray(ts)[0]) / STEPS_AT_LEAST


def room(system: System, t: Scalar, y: Float[Array, " size"]) -> Scalar | None:
    """How soon [s] something comes that a longer step could pass over; None if nothing is known."""
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    functions = [function for joint in system.joints.values() for function in joint.functions_of_time]
    rooms = [function.distance_to_breakpoint(t, True) for function in functions]
    forces: Any = system.forces_with(state.memory)
    samples = [forces[name].next_sample() - t for name in system.sampled_forces]
    return nearest_breakpoint([*rooms, *(force.time_to_breakpoint(t, motions) for force in forces.values()), *samples])


@lru_cache(maxsize=64)
def room_for(structure: Structure, scalar: bool | None) -> Callable | None:
    """The same as a program (theta, t, y) for the integrator; None for a system of which nothing is known."""
    system = example_of(structure)
    number, state = (jax.ShapeDtypeStruct(shape, jnp.float64) for shape in ((), (system.layout.size,)))
    known = jax.eval_shape(room, system, number, state)
    return None if known is None else program_for(room, structure, scalar, is_quiet=True)

"""What friction and force elements remember along a known motion."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.results.trajectory import Trajectory
from spherejax.physics.forces.turns import attachments_of
from spherejax.physics.state import Layout, unpack
from spherejax.studies.inverse.mechanism import IdealMechanism
from spherejax.studies.inverse.terms import flat_state


def memories(mechanism: IdealMechanism, poses: Float[Array, "n b 7"], run: Trajectory | None) -> Float[Array, "n m"]:
    """The memory at each instant: turns by going on from sample to sample, all else as in the run.

    Raises:
        SceneError: for an element or a friction law with states of its own, of which the motion tells nothing.
    """
    n = poses.shape[0]
    parts = [jnp.zeros((n, 0))]
    for slot in mechanism.system.all_slots:
        counts = [entry.counts_turns for entry in slot.contents]
        turned = iter(_turns(mechanism, slot.joint, poses) if any(counts) else ())
        remembered: Any = None if all(counts) else _of_run(run, slot)
        for i, counted in enumerate(counts):
            column: Any = next(turned) if counted else remembered[:, i]
            parts.append(column[:, None])
    return jnp.concatenate(parts, 1)


def _turns(mechanism: IdealMechanism, name: str, poses) -> list[Float[Array, " n"]]:
    """Angles through any number of turns, counted from within a turn of the described start."""
    attachments = attachments_of(mechanism.system.forces[name])
    still = jnp.zeros((mechanism.n_bodies, 6))

    def at(pose):
        motions = body_motions(mechanism.system, unpack(Layout(mechanism.n_bodies), flat_state(pose, still)))
        return [attachment.twist(motions).angle for attachment in attachments]

    return [jnp.unwrap(angles) for angles in jax.vmap(at)(poses)]


def _of_run(run: Trajectory | None, slot) -> Float[Array, "n m"]:
    if run is not None:
        for other in run.system.all_slots:
            if other.joint == slot.joint and other.names == slot.names:
                return run.state.memory[..., other.entries]
    raise SceneError(
        f"{slot.joint!r} remembers {', '.join(slot.names)}, which positions and velocities do not tell. Give a law or "
        "an element without states of its own, name it among the motors, or give the run of such a scene as motion"
    )

"""Where a motion goes on with another scene: what of its state goes over, and whether the joints hold there.

Positions and velocities stay. So does what parts remember, by their names, but for contacts that a changed clearance
makes or takes away. The joints' equations must hold at once: nothing is moved.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Scalar
from spherejax.model.system import System, flatten_by_factor
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import constraint_set, velocity_violation
from spherejax.motion.equations.contacts import memory_of_contacts_at
from spherejax.motion.equations.programs import program_for
from spherejax.motion.start.assembly import CLOSING_TOLERANCE
from spherejax.physics.state import unpack

RATE_TOLERANCE = 1e-7
"""Jump of the rate of a joint's equation [m/s or 1/s] from which on a driver is said to move otherwise: rounding of
functions of time is a thousandth of it, and an impulse that changes velocities by less is not seen."""


class CarriedState(NamedTuple):
    """A state in the scene that goes on.

    Attributes:
        y: flat state.
        residual: the largest jump of the joints' equations [m or 1]; of their rates where those jump by more than
            `RATE_TOLERANCE`.
    """

    y: Float[Array, " size"]
    residual: Scalar


def carried_state(before: System, after: System, t: Any, y: Any) -> CarriedState:
    """The state y at time t [s] of a system, in another one.

    Raises:
        SceneError: where the systems differ in more than numbers, or a joint would jump; it names the part.
    """
    _refuse_other_parts(before, after)
    start, end = before.layout.memory_start, before.layout.work_start
    work = dict(zip(_work_names(before), y[end:], strict=True))
    works = [jnp.asarray(work.get(name, 0.0))[None] for name in _work_names(after)]
    seen, numbers = flatten_by_factor(after)
    carried: Any = jnp.concatenate([jnp.asarray(y[:end]), *works])
    if after.contact_joints:
        memory = _evaluated(memory_of_contacts_at, seen, numbers, t, carried)
        carried = jnp.concatenate([carried[:start], memory, carried[end:]])
    gaps = _gaps(after, t, carried), _gaps(before, t, y)
    jumps = {name: _jumps(gap, gaps[1].get(name)) for name, gap in gaps[0].items()}
    if all(map(is_concrete, jax.tree.leaves((jumps, t)))):  # of a scene without joints there are none, and t is traced
        _refuse_jumps(jumps, float(t))
    largest = [jnp.zeros(2), *map(jnp.stack, jumps.values())]
    place, rate = jnp.max(jnp.stack(largest), axis=0)
    residual = jnp.maximum(place, jnp.where(rate > RATE_TOLERANCE, rate, 0.0))
    return CarriedState(carried, jax.lax.stop_gradient(residual))


def _refuse_other_parts(before: System, after: System) -> None:
    """Raise `SceneError` for parts that one of two systems has, or that remember otherwise."""
    for kind in ("bodies", "joints", "forces"):
        old, new = getattr(before, kind), getattr(after, kind)
        what = {"bodies": "body", "joints": "joint", "forces": "force element"}[kind]
        for name in [*old, *new]:
            if (name in old) != (name in new):
                has = "the run has" if name in old else "the scene has"
                raise SceneError(
                    f"the run cannot go on with this scene: {has} {what} {name!r}, and the "
                    f"{'scene' if name in old else 'run'} has not. A run goes on with parts of the same names, whose "
                    "numbers may be others; for other parts simulate a new scene from the state of this run"
                )
    old, new = ({slot.joint: slot.names for slot in system.all_slots} for system in (before, after))
    for name in [*old, *new]:
        if old.get(name) != new.get(name):
            had, has = (", ".join(memory.get(name, ())) or "nothing" for memory in (old, new))
            raise SceneError(
                f"the run cannot go on with this scene: {name!r} remembers {had} in the run and {has} in the scene. "
                "Give it a model with the same memory; its numbers may be others"
            )


def _work_names(system: System) -> list[str]:
    """What the entries of the work are, in their order."""
    joints = system.resisting_joints if system.tracks_work else ()
    others = (("constraints", system.tracks_constraint_work), ("supply", system.tracks_supply))
    return [*(f"joint {name}" for name in joints), *(name for name, is_there in others if is_there)]


def joint_equations(system: System, t: Scalar, y: Float[Array, " size"]) -> dict[str, tuple[Array, Array]]:
    """Phi [m or 1] and Phi_dot [m/s or 1/s] of each joint that constrains."""
    motions = body_motions(system, unpack(system.layout, y))
    constraints = constraint_set(system, t, motions)
    rates = constraints.split(velocity_violation(constraints, motions))
    return {name: (rows.residual, rates[name]) for name, rows in constraints.rows.items()}


def _gaps(system: System, t: Any, y: Any) -> dict[str, tuple[Any, Any]]:
    structure, numbers = flatten_by_factor(system)
    return _evaluated(joint_equations, structure, numbers, t, y)


def _evaluated(function: Any, structure: Any, numbers: Any, t: Any, y: Any) -> Any:
    """A function (system, t, y); of known numbers without compiling anything."""
    program = program_for(function, structure, is_quiet=True)
    if all(map(is_concrete, (numbers, t, y))):
        return program.compute(np.asarray(numbers), float(t), np.asarray(y))
    return program(jnp.asarray(numbers), jnp.asarray(t, jnp.float64), y)


def _jumps(now: tuple[Any, Any], before: tuple[Any, Any] | None) -> list:
    """By how much a joint's equations and their rates have changed; of one that had others, what they are now."""
    is_alike = before is not None and np.shape(before[0]) == np.shape(now[0])
    xp: Any = np if all(map(is_concrete, jax.tree.leaves((now, before)))) else jnp
    differences = [a - b for a, b in zip(now, before, strict=True)] if is_alike and before is not None else now
    return [xp.max(xp.abs(difference), initial=0.0) for difference in differences]


def _refuse_jumps(jumps: dict[str, list], t: float) -> None:
    for name, (place, rate) in jumps.items():
        if not place < CLOSING_TOLERANCE:
            raise SceneError(
                f"the run cannot go on with this scene: at t = {t:.9g} s joint {name!r} would jump by {place:.3g} m or "
                "rad. Lengths, points and what drivers prescribe must be as they were there; to assemble the mechanism "
                "anew, simulate the scene"
            )
        if not rate < RATE_TOLERANCE:
            raise SceneError(
                f"the run cannot go on with this scene: at t = {t:.9g} s joint {name!r} prescribes another velocity, "
                f"by {rate:.3g} m/s or rad/s, which takes an impulse. Let its function of time begin with the velocity "
                "that it has there"
            )

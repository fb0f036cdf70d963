"""Whose value is not finite where a run has stopped: found afterwards, part by part, for its diagnosis.

The loop only sees that the errors of ever shorter steps are not finite. Here the parts are evaluated where it stopped,
and a little way on from there: a root whose argument has become negative is finite at the last state.
"""

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.model.system import System, flatten_by_factor
from spherejax.motion.equations.body_motions import BodyMotions, body_motions
from spherejax.motion.equations.constraints import constraint_set
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.loads import joint_loads
from spherejax.motion.equations.programs import program_for
from spherejax.physics.state import unpack

AHEAD = (0.0, 1e-15, 1e-12, 1e-9, 1e-6)
"""Where is looked, as shares of the run's duration behind the time that it reached."""

BEFORE = 1e-3
"""Share of the run's duration before the time reached at which forces are compared with what they are there..."""

MUCH_LARGER = 1e6
"""... and the factor by which one has grown without bound."""


def not_finite_part(system: System, scalar: bool | None, t: float, span: float, y: Float[np.ndarray, " size"]) -> str:
    """The part whose value is not finite where a run has stopped, and when, in words; empty if none is found.

    Args:
        system: the system, of known numbers.
        scalar: whether the run was on scalar programs.
        t: time reached [s].
        span: duration of the run that was asked for [s].
        y: flat state reached. Velocities at the start that are not finite come of a driver, and count as zero.
    """
    y = np.nan_to_num(np.asarray(y), nan=0.0, posinf=0.0, neginf=0.0)
    structure, theta = flatten_by_factor(system)
    rate = np.nan_to_num(program_for(state_rate, structure, scalar).compute(theta, t, y))
    for share in AHEAD:
        ahead = share * span
        for words in _not_finite(system, t + ahead, y + ahead * np.clip(rate, -1e100, 1e100)):
            return f"{words} at t = {t + ahead:.9g} s"
    return _growing_force(system, t, t - BEFORE * span, y)


def _not_finite(system: System, t: float, y: Float[np.ndarray, " size"]) -> Iterator[str]:
    """The parts whose values are not finite at one state."""
    state, now = unpack(system.layout, jnp.asarray(y)), jnp.asarray(t)
    motions = body_motions(system, state)
    for name, rows in constraint_set(system, now, motions).rows.items():
        if not _is_finite(rows):
            joint: Any = system.joints[name]
            yield (
                f"the function of driver {name!r}, or its first or second derivative by time, is not finite"
                if (joint.functions_of_time)
                else f"the equations of joint {name!r} are not finite"
            )
    if system.force_joints:
        for name, load in joint_loads(system, motions, state.memory).items():
            if not _is_finite((load.wrenches, load.response.memory_rate)):
                yield f"the force of joint {name!r} is not finite"
    yield from _not_finite_forces(system, now, motions, state.memory)


def _not_finite_forces(system: System, t: Array, motions: BodyMotions, memory: Float[Array, " n"]) -> Iterator[str]:
    forces: Any = system.forces_with(memory)
    for name, force in forces.items():
        wrenches = force.wrenches(t, motions)
        for body, wrench in wrenches.items():
            if not _is_finite(wrench):
                shown = np.array2string(np.concatenate([np.asarray(each) for each in wrench]), precision=3)
                yield f"force element {name!r} is not finite on body {body!r}, {shown} N and N m about its center,"
        if name in {slot.joint for slot in system.force_slots} and not _is_finite(force.memory_rate(t, motions)):
            yield f"what force element {name!r} remembers changes at a rate that is not finite,"


def _growing_force(system: System, t: float, before: float, y: Float[np.ndarray, " size"]) -> str:
    """The force element that has grown without bound by time alone, in words; empty for none."""
    state = unpack(system.layout, jnp.asarray(y))
    motions = body_motions(system, state)
    forces: Any = system.forces_with(state.memory)
    for name, force in forces.items():
        earlier, now = (_size(force.wrenches(jnp.asarray(at), motions)) for at in (before, t))
        if now > MUCH_LARGER * earlier > 0:
            within = t - before
            return f"force element {name!r} has grown from {earlier:.2g} to {now:.2g} N or N m within {within:.2g} s"
    return ""


def _size(wrenches: Any) -> float:
    """The largest entry of the wrenches of a force [N or N m]."""
    return max(float(np.max(np.abs(np.asarray(leaf)))) for leaf in jax.tree.leaves(wrenches))


def _is_finite(values: Any) -> bool:
    return all(bool(np.all(np.isfinite(np.asarray(leaf)))) for leaf in jax.tree.leaves(values))

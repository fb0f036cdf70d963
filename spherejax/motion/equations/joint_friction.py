"""Friction in ideal joints: it follows the reactions, and these follow it, until both agree.

The multipliers lambda give each joint's loads N(lambda), the loads its friction w(N), and the friction the multipliers
again, with the equations of motion as they are:

    S lambda_0 = D M^-1 (g + w(0)) - gamma,    S (lambda_k - lambda_0) = D M^-1 (w(N(lambda_(k-1))) - w(0))

w(0) is what the preloads do. The matrix is factorized once; a pass is one substitution. As friction is linear in the
loads, the passes contract as a geometric series with a ratio of about mu R / (arm of the bodies about the joint). With
the changes d_k = |N(lambda_k) - N(lambda_(k-1))| of all loads together,

    contraction  largest d_k / d_(k-1)
    remainder    d_n / (1 - contraction), what is still to come by the last pass, over the loads

Where friction is so large that the ratio reaches 1 the equations may have no solution, or several (Painleve): a run
that comes near is ended by its audit, with the joint's name. So is one in which a load is not unique, because equations
depend on each other.
"""

from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.lanes import over_lanes, rows_at, sums_by_index
from spherejax.foundations.numerics import safe_divide, safe_sqrt
from spherejax.foundations.types import Scalar
from spherejax.model.groups import JointGroup
from spherejax.model.system import System
from spherejax.motion.equations.body_motions import BodyMotions
from spherejax.motion.equations.constraints import (
    ConstraintSet,
    Solution,
    constrained_accelerations,
    inverse_masses,
    solve_augmented,
)
from spherejax.motion.equations.loads import BodyVectors
from spherejax.physics.joints.base import Reaction
from spherejax.physics.joints.joint import AbstractPlacedJoint
from spherejax.physics.joints.reaction_friction import Resistance
from spherejax.physics.kinematics import BodyMotion, point_motion

SETTLED = 1e-10
"""Changes below this share of the loads are rounding: their ratios tell nothing."""


LEAST_GAP = 0.5
"""Of contractions nearer to 1 than this a remainder says nothing: they are judged by themselves."""


class JointResistance(NamedTuple):
    """Friction of one joint and what it does to the bodies.

    Attributes:
        resistance: on the second body.
        loads: what presses the surfaces together [N].
        wrenches: on the first and the second body, about their centers of mass [N, N m], shape (2, 6).
        absorbed_power: power that friction takes from the bodies [W].
    """

    resistance: Resistance
    loads: Float[Array, " n"]
    wrenches: Float[Array, "2 6"]
    absorbed_power: Scalar


class FrictionGroup(NamedTuple):
    """Friction of joints of one kind.

    Attributes:
        group: the joints.
        found: their friction, with a leading axis of joints.
    """

    group: JointGroup
    found: JointResistance

    @property
    def follows_reaction(self) -> bool:
        """Whether their friction depends on the reaction (static)."""
        friction = self.group.joint.friction
        return friction is not None and friction.model.follows_reaction


class JointFriction:
    """Friction of all ideal joints that have some.

    Attributes:
        groups: by kind of joint.
        contraction: ratio of successive changes of the loads [-]; 0 where nothing is iterated.
        remainder: what is still to come, as a share of the loads [-].
        last_changes: of the loads of each joint by the last pass [N], one array of joints for each group.
    """

    def __init__(self, groups: tuple[FrictionGroup, ...], contraction, remainder, last_changes=()):
        self.groups = groups
        self.contraction = contraction
        self.remainder = remainder
        self.last_changes = last_changes

    def parts(self) -> dict[str, dict[str, Array]]:
        """What is shown of each joint: see `trajectory.Trajectory.parts`."""
        return {
            name: {
                "friction_moment": each.resistance.moment,
                "friction_force": each.resistance.force,
                "friction_power": each.absorbed_power,
                "bearing_load": _length(each.loads) if len(each.loads) == 3 else jnp.sum(each.loads),
                "friction_contraction": self.contraction,
                "friction_remainder": self.remainder,
            }
            for name, each in resistances(self.groups).items()
        }


def resistances(groups: tuple[FrictionGroup, ...]) -> dict[str, JointResistance]:
    """Friction of each joint, by name."""
    found = {}
    for group, each in groups:
        found |= {name: jax.tree.map(lambda x, i=i, each=each: x[i], each) for i, name in enumerate(group.names)}
    return dict(sorted(found.items()))


def _length(x: Float[Array, " n"]) -> Scalar:
    return safe_sqrt(jnp.sum(x * x))


def solution_with_friction(
    system: System,
    motions: BodyMotions,
    memory: Float[Array, " n_memory"],
    constraints: ConstraintSet,
    applied: BodyVectors,
) -> tuple[Solution, JointFriction]:
    """Accelerations, multipliers and friction that agree with each other.

    Args:
        system: the system; some joint has friction.
        motions: motion of each body.
        memory: the joints' memory.
        constraints: constraint equations.
        applied: what else acts on the bodies.
    """
    preloads = friction_under(system, motions, memory, constraints, None)
    alone = wrenches_of(system, preloads)
    first = constrained_accelerations(system, motions, constraints, applied + alone)
    if not system.friction_passes:
        # The loads are shown; nothing follows them.
        loaded = friction_under(system, motions, memory, constraints, first.flat)
        shown = tuple(
            FrictionGroup(group, found._replace(loads=other.found.loads))
            for (group, found), other in zip(preloads, loaded, strict=True)
        )
        return first, JointFriction(shown, jnp.zeros(()), jnp.zeros(()))
    masses = inverse_masses(system, motions)
    none = jnp.zeros_like(first.flat)
    multipliers, accelerations = first.flat, first.accelerations
    found = friction_under(system, motions, memory, constraints, multipliers)
    history = [_loads(found)]
    for _ in range(system.friction_passes):
        more = solve_augmented(
            constraints,
            masses,
            wrenches_of(system, found) - alone,
            none,
            system.refines_constraints,
            system.smallest_pivot,
        )
        multipliers, accelerations = first.flat + more.flat, first.accelerations + more.accelerations
        acting, found = found, friction_under(system, motions, memory, constraints, multipliers)
        history.append(_loads(found))
    contraction, remainder, last = _judged(history)
    # What acts is the friction of the last pass, under the loads of the one before.
    wrenches = constraints.transposed_times(multipliers)
    solution = Solution(accelerations, constraints.split(multipliers), multipliers, wrenches)
    return solution, JointFriction(acting, contraction, remainder, last)


def friction_under(
    system: System,
    motions: BodyMotions,
    memory: Float[Array, " n_memory"],
    constraints: ConstraintSet,
    multipliers: Float[Array, " n"] | None,
) -> tuple[FrictionGroup, ...]:
    """Friction of all joints for given multipliers; for None that of the preloads alone."""
    found = []
    values = () if multipliers is None else constraints.by_group(multipliers)
    for place, (group, rows) in enumerate(constraints.groups):
        if group.joint.friction is None:
            continue
        slots = [system.memory_of(name) for name in group.names]
        entries = np.array([np.arange(slot.start, slot.stop) for slot in slots], int)
        remembered = rows_at(memory, entries.ravel()).reshape(entries.shape)
        ends = motions.of_ends(group)
        if multipliers is None:
            loads = jnp.zeros((len(group.names), group.joint.friction.n_loads))
        else:
            loads = over_lanes(loads_of, group.joint, *ends, rows.jacobians[1], values[place])
        found.append(FrictionGroup(group, over_lanes(_resistance, group.joint, *ends, loads, remembered)))
    return tuple(found)


def constraint_reaction(joint: AbstractPlacedJoint, second: BodyMotion, jacobian, multipliers) -> Reaction:
    """What a joint's equations exert on its second body: -D^T lambda, about the joint's point."""
    wrench = -jacobian.T @ multipliers
    arm = point_motion(second, jnp.asarray(joint.points[1])).arm
    return Reaction(wrench[:3], wrench[3:] - jnp.cross(arm, wrench[:3]))


def loads_of(joint: AbstractPlacedJoint, first: BodyMotion, second: BodyMotion, jacobian, multipliers):
    """What presses a joint's surfaces together, by its multipliers [N]."""
    assert joint.friction is not None
    return joint.friction.loads(first, second, constraint_reaction(joint, second, jacobian, multipliers))


def _resistance(joint: AbstractPlacedJoint, first: BodyMotion, second: BodyMotion, loads, memory) -> JointResistance:
    assert joint.friction is not None
    place = jnp.asarray(joint.points[1])
    found = joint.friction.resist(first, second, place, loads, memory)
    point = point_motion(second, place)
    on_second = jnp.concatenate([found.force, found.moment + jnp.cross(point.arm, found.force)])
    on_first = -jnp.concatenate([found.force, found.moment + jnp.cross(point.position - first.position, found.force)])
    power = -(
        on_first[:3] @ first.velocity
        + on_first[3:] @ first.angular_velocity
        + on_second[:3] @ second.velocity
        + on_second[3:] @ second.angular_velocity
    )
    return JointResistance(found, loads, jnp.stack([on_first, on_second]), power)


def wrenches_of(system: System, groups: tuple[FrictionGroup, ...]) -> BodyVectors:
    """Friction on each moving body."""
    wrenches = jnp.concatenate([each.found.wrenches.reshape(-1, 6) for each in groups])
    targets = [i - 1 for each in groups for ends in zip(each.group.first, each.group.second, strict=True) for i in ends]
    return sums_by_index(wrenches, np.array(targets), len(system.bodies))


# What is judged ------------------------------------------------------------------------------------------------------


def _loads(groups: tuple[FrictionGroup, ...]) -> list[Float[Array, "n_joints n"]]:
    """Loads of the joints whose friction follows them, by kind."""
    return [each.found.loads for each in groups if each.follows_reaction]


def _judged(history: list[list[Array]]) -> tuple[Scalar, Scalar, tuple[Array, ...]]:
    """Contraction, remainder, and the last changes of each joint."""
    flat = [jnp.concatenate([part.ravel() for part in loads]) for loads in history]
    changes = [_length(after - before) for before, after in pairwise(flat)]
    size = _length(flat[0]) + _length(flat[-1])
    ratios = [
        jnp.where(before > SETTLED * size, safe_divide(after, before), 0.0) for before, after in pairwise(changes)
    ]
    contraction = jnp.max(jnp.stack(ratios))
    remainder = safe_divide(changes[-1], size * jnp.maximum(1.0 - contraction, LEAST_GAP))
    last = [over_lanes(_length, after - before) for before, after in zip(history[-2], history[-1], strict=True)]
    return contraction, remainder, tuple(last)

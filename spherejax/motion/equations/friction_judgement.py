"""Whether friction that follows reactions can be trusted: its fixed point, and the uniqueness of the loads.

Looked at where a run starts, and by its audit at the end of every step.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.lanes import over_lanes
from spherejax.foundations.numerics import safe_divide
from spherejax.foundations.types import Scalar
from spherejax.model.system import System, flatten_system
from spherejax.motion.equations.body_motions import BodyMotions
from spherejax.motion.equations.constraints import ConstraintSet, inverse_masses, mobility_of, solved
from spherejax.motion.equations.dynamics import evaluate
from spherejax.motion.equations.joint_friction import JointFriction, loads_of
from spherejax.motion.equations.programs import program_for

LARGEST_CONTRACTION = 0.5
"""From here on a pass does not halve what is left."""

LARGEST_REMAINDER = 1e-3
"""Of the loads, to come after the last pass; mechanisms with usual friction leave 1e-6."""

LARGEST_AMBIGUITY = 1e-4
"""Of a load, by which it may depend on how the solution is chosen: rounding of masses far apart stays below."""


def load_ambiguity(system: System, motions: BodyMotions, constraints: ConstraintSet) -> dict[str, Scalar]:
    """How far each joint's load depends on how a solution is chosen, as a share of it; 0 where the load is unique.

    Of S x = S r for some r the solution is r, unless equations depend on each other: of those some are left out, and x
    differs from r. What counts is whether the load does: in a plane mechanism reactions out of the plane are not
    unique, and the radial loads are.
    """
    masses = inverse_masses(system, motions)
    n = constraints.residual.shape[0]
    some = 1.0 + 0.5 * np.sin(1.0 + 2.3 * np.arange(n))
    right = constraints.times(masses.times(constraints.transposed_times(jnp.asarray(some))))
    other = solved(constraints, mobility_of(constraints, masses), right, system.smallest_pivot)
    found: dict[str, Scalar] = {}
    pairs = zip(constraints.groups, constraints.by_group(jnp.asarray(some)), constraints.by_group(other), strict=True)
    for (group, rows), one, another in pairs:
        if group.joint.friction is None or not group.joint.friction.model.follows_reaction:
            continue
        ends = motions.of_ends(group)
        a, b = (over_lanes(loads_of, group.joint, *ends, rows.jacobians[1], x) for x in (one, another))
        for i, name in enumerate(group.names):
            found[name] = safe_divide(jnp.max(jnp.abs(a[i] - b[i])), jnp.max(jnp.abs(a[i])))
    return dict(sorted(found.items()))


def friction_share(friction: JointFriction, ambiguity: dict[str, Scalar]) -> Scalar:
    """The worst of contraction, remainder and ambiguity, each as violation over its limit."""
    shares = [friction.contraction / LARGEST_CONTRACTION, friction.remainder / LARGEST_REMAINDER]
    return jnp.max(jnp.stack([*shares, *(each / LARGEST_AMBIGUITY for each in ambiguity.values())]))


def friction_found(system: System, t: Scalar, y: Float[Array, " size"]) -> tuple[JointFriction, dict[str, Scalar]]:
    """Friction at a state, and how far each load is ambiguous."""
    _, motions, _, constraints, _, friction = evaluate(system, t, y)
    assert friction is not None
    return friction, load_ambiguity(system, motions, constraints)


class Judgement(NamedTuple):
    """What is judged at one state.

    Attributes:
        contraction: of the fixed point [-].
        remainder: after the last pass, as a share of the loads [-].
        changes: of each joint's loads by the last pass [N].
        ambiguity: of each joint's loads, as a share of them [-].
    """

    contraction: Scalar
    remainder: Scalar
    changes: dict[str, Scalar]
    ambiguity: dict[str, Scalar]


def judged(system: System, t: Scalar, y: Float[Array, " size"]) -> Judgement:
    """What is judged, at a state."""
    friction, ambiguity = friction_found(system, t, y)
    following = [each.group for each in friction.groups if each.follows_reaction]
    changes = {
        name: part[i]
        for group, part in zip(following, friction.last_changes, strict=True)
        for i, name in enumerate(group.names)
    }
    return Judgement(friction.contraction, friction.remainder, dict(sorted(changes.items())), ambiguity)


def in_words(found: Judgement) -> str:
    """What is wrong with friction at a state, with the joint's name and a remedy; empty where nothing is."""
    unclear = {name: float(share) for name, share in found.ambiguity.items() if not share <= LARGEST_AMBIGUITY}
    if unclear:
        names = ", ".join(map(repr, unclear))
        return (
            f"friction in joint {names} follows a load that is not unique: equations of joints depend on each other "
            "(`spherejax.constraint_report` names them), and how they share the load nobody can say. Replace one of "
            "them by a joint with fewer equations or by a bushing, leave length= out, or take pressure=PreloadAlone()"
        )
    worst = max(found.changes, key=lambda name: float(found.changes[name]))
    contraction, remainder = float(found.contraction), float(found.remainder)
    if not contraction <= LARGEST_CONTRACTION:
        return (
            f"friction in joint {worst!r} and its reaction enlarge each other: a pass of the fixed point leaves "
            f"{contraction:.3g} of the change before it, and {LARGEST_CONTRACTION} is allowed; near 1 the equations of "
            "rigid bodies with friction have no solution or several (Painleve). Lower mu or radius, lengthen the "
            "bearing, or take a joint with clearance or a bushing"
        )
    if not remainder <= LARGEST_REMAINDER:
        return (
            f"friction in joint {worst!r} has not settled: {remainder:.3g} of the loads is still to come after the "
            f"last pass, and {LARGEST_REMAINDER} is allowed. Raise passes= of its model"
        )
    return ""


def friction_trouble(system: System, t: Scalar, y: Float[Array, " size"]) -> str:
    """What is wrong with friction at a state of known numbers, in words; computed at once."""
    return in_words(judged(system, t, y))


def refuse_unsolvable_friction(system: System, t: float, start: Float[np.ndarray, " n"]) -> None:
    """Refuse, where all numbers are known, friction that cannot be solved for at the start.

    Args:
        system: the system.
        t: time of the start [s].
        start: flat state without memory and work.

    Raises:
        SceneError: naming the joint and the remedy.
    """
    if not system.friction_passes:
        return
    structure, theta = flatten_system(system)
    if not is_concrete(theta):
        return
    layout = system.layout
    y = np.concatenate([np.asarray(start), np.zeros(layout.n_memory + layout.n_work)])
    found = program_for(judged, structure, is_quiet=True).compute(theta, t, y)
    if trouble := in_words(found):
        raise SceneError(f"at the start {trouble}")

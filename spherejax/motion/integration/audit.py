"""The audit: invariants are checked after every step; a violation ends the run with its own status.

    energy      never rises by more than drivers, forces and other parts that may add some have put in
    loss        never falls where no part dissipates; constraint forces do no work where some do
    flight      no ball is beyond its socket's surface while it counts as flying
    constraints  the constraint equations hold; friction that follows reactions agrees with them
    quaternions  have unit norm
    rotations    of bushings are within what their laws measure
    turns        the angles that count turns are those of the orientations (`spherejax.physics.forces.turns`)
    conformity   surfaces are pressed in by no more than their elastic law is for, e.g. with the stiffness of Eq. 24 by
                 little against their clearance; beyond that the run goes on, and says so
    film         the offset e_h1 that keeps a film finite at the wall is small against the clearance; above a
                 twentieth of it the run goes on, and says so
    film_range   a film is within what its equations are for: a journal on a liner no further out, the film of a cup
                 with a liner whole, oil that thickens under no more pressure; beyond that the run goes on, and says so
    axes         that an angle is about are not tilted against each other by half a turn, where there is none

Whether it may add energy is asked of each part (`never_adds_energy`). The work of those that may (drivers, applied
forces, roads that move, bristles, parts of a user's own) is integrated beside the state, and what they store does not
count. Balance by the work of the joints alone would not do: a ball that flies through its socket does no work on it,
and gains energy when it is caught outside. Rosenbrock methods account for their drivers' and forces' work too coarsely;
their runs are audited for energy where no part may add any.

Constraint forces do no work on velocities that the constraints allow. At a singular position, where the constraint
equations lose rank, the velocities leave these by little (1e-5 of the speed) while the forces grow without bound, and a
feedback such as Baumgarte's takes the whole energy within a hundredth of a second. Where no part dissipates the energy
itself shows that, at no cost. Where parts dissipate the work of the constraint forces is integrated beside the state
(`System.tracks_constraint_work`), a multiplication and an addition for each velocity; corrections of drift count with
what they take. Only that is judged there: an account of all that dissipates would need each contact's power to the
accuracy of the whole energy, which Rosenbrock methods do not give. A run without constraints has no such forces.

The limits are those of a run that is wrong, far above what the tolerance of a run that is right explains.
"""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from spherejax.foundations.types import Number, Numeric, Scalar
from spherejax.model.system import Structure, System
from spherejax.motion.equations.body_motions import BodyMotions, body_motions
from spherejax.motion.equations.constraints import constraint_set
from spherejax.motion.equations.friction_judgement import friction_found, friction_share, friction_trouble
from spherejax.motion.equations.loads import joint_loads
from spherejax.motion.equations.observables import kinetic_energy, potential_energy
from spherejax.motion.equations.programs import program_for
from spherejax.motion.solvers.traits import is_linearly_implicit
from spherejax.motion.start.tolerances import energy_scale, length_scale
from spherejax.physics.laws.films import LARGEST_OFFSET_RATIO
from spherejax.physics.laws.lined import LinedBearing
from spherejax.physics.laws.lined_socket import LinedSocket
from spherejax.physics.laws.thickening import AbstractThickening
from spherejax.physics.state import unpack

ENERGY_SHARE = 1e-3
"""Energy may rise above its lowest value by this share of what moves, and by..."""

TOLERANCES = 100.0
"""... so many relative tolerances: errors of many steps add up."""

LOST_IN_A_STEP = 1e-5
"""Share of the limit of `loss` that each step may lose without being counted: 1e-8 of the energy, as its error may be.
A pendulum loses 1e-3 in 10,000 periods at an rtol of 1e-6, which are 160,000 steps; at a singular position more than
that is lost in some hundred."""

LARGEST_SHARE = 0.1
"""Loose tolerances allow no more than this."""

ROSENBROCK_SHARE = 10.0
"""Of the limit, for the work of constraint forces by a Rosenbrock method."""

LEAST_ENERGY = 1e-3
"""Of the scale m V^2 of the scene: what moves counts as no less, for in a scene at rest all is rounding."""

CONSTRAINT_SHARE = 1e-2
"""Constraint equations hold to this share of the scene's length, or of 1 where they are of directions."""

NORM = 1e-2
"""| |q|^2 - 1 | of quaternions."""

OUTSIDE = 1e-6
"""(|e|^2 / c^2 - 1) / 2 of a ball in flight; steps end within 1e-9."""

NOT_MADE = -1.0
"""Share that says that a check is not made."""

CHECKS = (
    "energy", "loss", "flight", "constraints", "quaternions", "rotations", "turns",
    "conformity", "tilt", "film", "film_range", "axes",
)  # fmt: skip
"""What is audited, in the order of `run.stats.audit`."""

WARNINGS = ("conformity", "tilt", "film", "film_range", "axes")
"""Checks, the last of them all, that do not fail a run: its equations are solved, but they are used out of range."""

N_FATAL = len(CHECKS) - len(WARNINGS)

FILM_RANGE = "a film was used beyond its range"

FINDINGS = {
    "energy": "the energy rose by more than was put in",
    "loss": "energy vanished that no part took",
    "flight": "a ball was outside its socket without contact",
    "constraints": "the joints' equations were violated",
    "quaternions": "a body's quaternion lost its norm",
    "rotations": "a bushing was turned by more than three quarters of a turn, beyond which the rotation vector of its "
    "law has no meaning: in a joint about an axis take HingeElastomer, and a TorsionalSpring beside the "
    "joint for elastic torsion",
    "turns": "how often an angle about an axis has gone round is in doubt: tighten rtol",
    "conformity": "surfaces were pressed in beyond the range of their elastic law (that of Eq. 24 ends at a tenth of "
    "the clearance): give a ball conformity=sj.laws.SphericalProfile() or sj.laws.WinklerLiner(...), a journal "
    "sj.laws.EsduCylinder(...), or the normal law a stiffness of its own",
    "tilt": "a journal tilted in a rim of its bearing until its circle was an oval there, by more than a tenth of the "
    "clearance: give the bearing its other rim, or a ball in a socket to what turns freely",
    "film": "the offset e_h1 of a film is more than a twentieth of the clearance: the film acts as if it were thicker "
    "by e_h1, and eccentricities under a load are too large by about the share e_h1/c; leave e_h1 and e_h0 out (they "
    "are 0.02 and 0.01 of the clearance then), or give smaller ones",
    "film_range": f"{FILM_RANGE}: {LinedBearing.beyond_range}; or {LinedSocket.beyond_range}; or "
    f"{AbstractThickening.beyond_range}",
    "axes": "the axis that an angle is about was tilted by more than 170 degrees against its start, where there is no "
    "angle (a torsional spring, an actuator, a coupler between bodies that tilt): give the two bodies a joint about "
    "that axis, or the element another axis",
}
"""What a failed check says."""


def findings(shares, suspected: Mapping[str, str] = MappingProxyType({})) -> str:
    """What an audit has found, in words; empty for a sound run.

    Args:
        shares: the worst of each of `CHECKS` as a share of its limit, one each.

    Other args:
        suspected: for a check the part of which it was largest where the run ended.
    """
    fatal = zip(CHECKS[:N_FATAL], np.asarray(shares)[..., :N_FATAL], strict=True)
    found = [(check, share) for check, share in fatal if not share <= 1]
    where = {check: f": {part}" for check, part in suspected.items()}
    # An angle about an axis that has tipped over does not exist, so no tolerance counts its turns: say that instead.
    is_undefined = np.asarray(shares)[..., CHECKS.index("axes")] > 1
    texts = FINDINGS | ({"turns": f"an angle is not defined: {FINDINGS['axes']}"} if is_undefined else {})
    return "; ".join(f"{texts[check]} ({share:.3g} times the limit{where.get(check, '')})" for check, share in found)


def texts_for(system: System) -> dict[str, str]:
    """`FINDINGS` as they are said of a system: a check with several causes says those that its parts can have."""
    joints: list[Any] = [system.spherical(name) for name in system.contact_joints]
    causes = dict.fromkeys(joint.model.beyond_film_range for joint in joints)
    causes.pop("", None)
    return FINDINGS | ({"film_range": f"{FILM_RANGE}: {'; or '.join(causes)}"} if causes else {})


def cautions(
    shares, parts: Mapping[str, Sequence[str]] = MappingProxyType({}), texts: Mapping[str, str] = FINDINGS
) -> str:
    """What a sound run was used for beyond the range of its laws, in words; empty for nothing.

    Args:
        shares: as for `findings`, of one run or of many, shape (..., n_checks).

    Other args:
        parts: for a check the parts that it may be about; see `parts_with_a_range`.
        texts: what a failed check says; see `texts_for`.
    """
    worst = np.asarray(shares)[..., N_FATAL:].reshape(-1, len(WARNINGS)).max(axis=0, initial=NOT_MADE)
    exceeded = [(check, share) for check, share in zip(WARNINGS, worst, strict=True) if share > 1]
    return "; ".join(
        f"{_named(parts.get(check, ()))}{texts[check]} ({share:.3g} times that)" for check, share in exceeded
    )


def _named(parts: Sequence[str]) -> str:
    # A check keeps its worst share of the whole run, not the part where it was.
    return f"{'one of ' if len(parts) > 1 else ''}{', '.join(parts)}: " if parts else ""


def parts_with_a_range(system: System, y: Float[Array, " size"]) -> dict[str, list[str]]:
    """For each of `WARNINGS` the parts whose equations have such a range, in words.

    Args:
        system: the system.
        y: a flat state of the run; its numbers do not matter.
    """
    state = unpack(system.layout, jnp.asarray(y))
    motions = body_motions(system, state)
    parts: dict[str, list[str]] = {check: [] for check in WARNINGS}
    for name in system.contact_joints:
        joint: Any = system.spherical(name)
        limits = {
            "conformity": joint.model.largest_ratio,
            "tilt": joint.share_of_tilt(joint.relative_motion(motions)),
            "film": joint.model.offset_ratio,
            "film_range": joint.model.film_range_share(
                joint.relative_motion(motions), state.memory[system.memory_of(name)]
            ),
        }
        for check, limit in limits.items():
            parts[check] += [] if limit is None else [f"joint {name!r}"]
    forces: Any = system.forces_with(state.memory)
    for slot in system.force_slots:
        parts["axes"] += [f"force element {slot.joint!r}"] if forces[slot.joint].tilts(motions) else []
    return parts


def suspects(system: System, t: float, y: Float[np.ndarray, " size"]) -> dict[str, str]:
    """For each of `CHECKS` the part of which it is largest at one state, in words; computed at once.

    Energy is of the whole scene: named is the joint whose surfaces are pressed into each other deepest, if any are.

    Args:
        system: the system.
        t: time [s].
        y: flat state.
    """
    state = unpack(system.layout, jnp.asarray(y))
    motions = body_motions(system, state)
    found: dict[str, str] = {}
    outside = {}
    for name in system.contact_joints:
        joint: Any = system.spherical(name)
        g = joint.model.crossing(joint.relative_motion(motions)).value
        outside[name] = float(np.sqrt(2 * max(float(g), -0.5) + 1)) - 1
    if outside and max(outside.values()) > 0:
        deepest = max(outside, key=lambda name: outside[name])
        found["energy"] = f"the ball of joint {deepest!r} is {outside[deepest]:.3g} clearances outside"
        memories = {name: state.memory[system.memory_of(name)] for name in outside}
        models: dict[str, Any] = {name: system.spherical(name).model for name in outside}
        flying = [name for name in outside if not models[name].is_touching(memories[name])]
        if flying:
            worst = max(flying, key=lambda name: outside[name])
            found["flight"] = f"the ball of joint {worst!r}, by {outside[worst]:.3g} clearances"
    rows = constraint_set(system, jnp.asarray(t), motions).rows
    gaps = {name: float(jnp.max(jnp.abs(row.residual))) for name, row in rows.items()}
    if gaps:
        worst = max(gaps, key=lambda name: gaps[name])
        found["constraints"] = f"joint {worst!r} gapes by {gaps[worst]:.3g} m or rad"
    if system.friction_passes and (trouble := friction_trouble(system, jnp.asarray(t), jnp.asarray(y))):
        found["constraints"] = trouble
    norms = np.abs(np.sum(np.asarray(state.quaternion) ** 2, axis=-1) - 1)
    found["quaternions"] = f"body {list(system.bodies)[int(np.argmax(norms))]!r}"
    twisted = {name: _rotation_share(system.joints[name], motions) for name in system.force_joints}
    twists = {name: float(share) for name, share in twisted.items() if share is not None}
    if twists:
        found["rotations"] = f"joint {max(twists, key=lambda name: twists[name])!r}"
    forces: Any = system.forces_with(state.memory)
    turned = {slot.joint: forces[slot.joint].doubts(motions) for slot in system.force_slots}
    doubts = {name: max(map(float, own)) for name, own in turned.items() if own}
    if doubts:
        found["turns"] = f"force element {max(doubts, key=lambda name: doubts[name])!r}"
    return found


def _rotation_share(joint: Any, motions: BodyMotions) -> Scalar | None:
    """How far a joint's model is turned, as a share of what it knows; None for any."""
    model = getattr(joint, "model", None)
    return None if model is None else model.rotation_share(joint.relative_motion(motions))


class Vitals(NamedTuple):
    """What is looked at, at one instant.

    Attributes:
        potential: energy of weight and force elements, less the work that has been put in [J].
        agitation: kinetic energy, and what the joints store [J].
        outside: (|e|^2 / c^2 - 1) / 2 of the outermost ball in flight; -1/2 without one.
        violation: largest entry of the constraint equations [m or 1].
        norm: largest | |q|^2 - 1 |.
        pressed: largest penetration of surfaces, as a share of what their elastic law is for; -1 without a limit.
        tilt: largest tilt of a journal in a rim, as a share of what its circles are for; -1 without one.
        rotations: largest rotation of a bushing, as a share of what its law measures; -1 without one.
        turns: largest difference of an angle from what was integrated of it, as a share of what is allowed; -1 where
            nothing has an angle.
        axes: largest tilt of an axis that an angle is about, as a share of the largest; -1 where nothing has an angle.
        friction: how badly friction by reactions is solved for, as a share of what is allowed; None without any.
        offset: largest offset of a film, as a share of what is allowed; None without a film.
        film_range: how far films are used, as a share of what they are for; None without one that says so.
        constraint_work: work of the constraint forces beyond that of drivers [J]; None where it is not integrated.
    """

    potential: Scalar
    agitation: Scalar
    outside: Scalar
    violation: Scalar
    norm: Scalar
    pressed: Scalar
    tilt: Scalar
    rotations: Scalar
    turns: Scalar
    axes: Scalar
    friction: Scalar | None = None
    offset: Scalar | None = None
    film_range: Scalar | None = None
    constraint_work: Scalar | None = None


def vitals(system: System, t: Scalar, y: Float[Array, " size"]) -> Vitals:
    """What is looked at, of one state."""
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    outside, pressed, stored = [jnp.asarray(-0.5)], [jnp.asarray(NOT_MADE)], jnp.zeros(())
    tilts, offsets, ranges = [jnp.asarray(NOT_MADE)], [], []
    if system.force_joints:
        loads = joint_loads(system, motions, state.memory)
        stores = (load.response.elastic_energy for name, load in loads.items() if system.joints[name].never_adds_energy)
        stored = sum(stores, stored)
    put_in = state.work[-1] if system.tracks_supply else jnp.zeros(())
    for slot in system.memory_slots:
        if slot.joint in system.contact_joints:
            joint: Any = system.spherical(slot.joint)
            motion = joint.relative_motion(motions)
            g = joint.model.crossing(motion).value
            tilt = joint.share_of_tilt(motion)
            tilts += [] if tilt is None else [tilt]
            is_touching = joint.model.is_touching(state.memory[slot.entries])
            outside.append(jnp.where(is_touching, -0.5, g))
            if joint.model.offset_ratio is not None:
                offsets.append(joint.model.offset_ratio / LARGEST_OFFSET_RATIO)
            out = joint.model.film_range_share(motion, state.memory[slot.entries])
            ranges += [] if out is None else [out]
            if joint.model.largest_ratio is not None:
                depth = jnp.sqrt(jnp.where(is_touching & (g > 0), 2 * g + 1, 1.0)) - 1
                pressed.append(depth / joint.model.largest_ratio)
    twisted = [jnp.asarray(NOT_MADE)]
    for name in system.force_joints:
        turned = _rotation_share(system.joints[name], motions)
        twisted += [] if turned is None else [turned]
    doubts, leaning = [jnp.asarray(NOT_MADE)], [jnp.asarray(NOT_MADE)]
    forces: Any = system.forces_with(state.memory)
    for slot in system.force_slots:
        doubts += forces[slot.joint].doubts(motions)
        leaning += forces[slot.joint].tilts(motions)
    constraints = constraint_set(system, t, motions)
    residual = jnp.abs(constraints.residual) if constraints.groups else jnp.zeros(1)
    norms = jnp.sum(state.quaternion * state.quaternion, axis=-1)
    friction = None
    if system.friction_passes:
        friction = friction_share(*friction_found(system, t, y))
    return Vitals(
        potential_energy(system, t, motions, state.memory, of_all=False) - put_in,
        kinetic_energy(system, motions) + stored,
        jnp.max(jnp.stack(outside)),
        jnp.max(residual),
        jnp.max(jnp.abs(norms - 1)),
        jnp.max(jnp.stack(pressed)),
        jnp.max(jnp.stack(tilts)),
        jnp.max(jnp.stack(twisted)),
        jnp.max(jnp.stack(doubts)),
        jnp.max(jnp.stack(leaning)),
        friction,
        jnp.max(jnp.stack(offsets)) if offsets else None,
        jnp.max(jnp.stack(ranges)) if ranges else None,
        state.work[system.constraint_work_index] if system.tracks_constraint_work else None,
    )


class Watch(NamedTuple):
    """What an audit keeps of the steps so far.

    Attributes:
        lowest: the lowest energy [J].
        highest: the highest energy, or work of the constraint forces where that is integrated, less what the steps
            since may lose [J].
        bottom, top: the lowest and the highest potential energy [J].
        agitation: the highest agitation [J].
        worst: of each of `CHECKS` the worst, as a share of its limit, one each: above 1 the run is wrong, or what it
            says of the last one is to be read.
    """

    lowest: Array
    highest: Array
    bottom: Array
    top: Array
    agitation: Array
    worst: Float[Array, " n_checks"]

    @classmethod
    def of_nothing(cls) -> "Watch":
        """Of a run of which nothing has been looked at."""
        zero = jnp.zeros(())
        return cls(zero, zero, zero, zero, zero, jnp.full(len(CHECKS), NOT_MADE))

    @property
    def is_sound(self) -> Bool[Array, ""]:
        """Whether all limits are kept that a run must keep."""
        return jnp.all(self.worst[:N_FATAL] <= 1)


class Limits(eqx.Module):
    """From where on a run is wrong.

    Attributes:
        energy: largest share of the energy that may have come from nowhere; infinite where nobody can tell.
        loss: largest share of it that may have vanished; infinite where nobody can tell.
        least: what counts as moving at least [J].
        violation: of the constraint equations.
    """

    energy: Number
    loss: Number
    least: Number
    violation: Number

    def begun(self, now: Vitals) -> Watch:
        """An audit at the start of a run."""
        energy = now.potential + now.agitation
        # A check that is not made says so from the start.
        limits = jnp.stack([jnp.asarray(self.energy), jnp.asarray(self.loss)])
        worst = jnp.zeros(len(CHECKS)).at[:2].set(jnp.where(jnp.isinf(limits), NOT_MADE, 0.0))
        worst = worst.at[N_FATAL:].set(NOT_MADE)
        for check in ("rotations", "turns"):
            worst = worst.at[CHECKS.index(check)].set(NOT_MADE)
        watch = Watch(energy, _without_loss(now), now.potential, now.potential, now.agitation, worst)
        return self.seen(watch, now)

    def seen(self, watch: Watch, now: Vitals) -> Watch:
        """The audit after another step."""
        energy = now.potential + now.agitation
        lowest = jnp.minimum(watch.lowest, energy)
        constant = _without_loss(now)
        bottom, top = jnp.minimum(watch.bottom, now.potential), jnp.maximum(watch.top, now.potential)
        agitation = jnp.maximum(watch.agitation, now.agitation)
        moving = jnp.maximum(agitation + (top - bottom), self.least)
        uncounted = jnp.where(jnp.isinf(self.loss), 0.0, LOST_IN_A_STEP * self.loss * moving)
        highest = jnp.maximum(watch.highest - uncounted, constant)
        equations = now.violation / self.violation
        if now.friction is not None:
            # Friction that follows reactions belongs to the joints' equations.
            equations = jnp.maximum(equations, now.friction)
        shares = [
            jnp.where(jnp.isinf(self.energy), NOT_MADE, (energy - lowest) / (moving * self.energy)),
            jnp.where(jnp.isinf(self.loss), NOT_MADE, (highest - constant) / (moving * self.loss)),
            jnp.maximum(now.outside, 0.0) / OUTSIDE,
            equations,
            now.norm / NORM,
            now.rotations,
            now.turns,
            now.pressed,
            now.tilt,
            jnp.asarray(NOT_MADE if now.offset is None else now.offset),
            jnp.asarray(NOT_MADE if now.film_range is None else now.film_range),
            now.axes,
        ]
        return Watch(lowest, highest, bottom, top, agitation, jnp.maximum(watch.worst, jnp.stack(shares)))


def _without_loss(now: Vitals) -> Scalar:
    """What does not fall in an exact motion [J]: the energy, or, where parts dissipate, the constraint forces' work."""
    return now.potential + now.agitation if now.constraint_work is None else now.constraint_work


class Audit(NamedTuple):
    """How a run is audited (static functions).

    Attributes:
        look: the vitals; takes (parameters, t, y).
        limits: takes the parameters.
    """

    look: Callable
    limits: Callable

    def begun(self, parameters, t, y) -> Watch:
        """The audit at the start of a run."""
        return self.limits(parameters).begun(self.look(parameters, t, y))

    def update_checks(self, parameters, watch: Watch, t, y) -> tuple[Watch, Watch]:
        """The audit if a run begins with the state y, and if a step has ended there."""
        limits, vitals = self.limits(parameters), self.look(parameters, t, y)
        return limits.begun(vitals), limits.seen(watch, vitals)

    def seen(self, parameters, watch: Watch, t, y) -> Watch:
        """The audit after a step to the state y."""
        return self.update_checks(parameters, watch, t, y)[1]

    def of_rows(self) -> "Audit":
        """The same, of the state in the first row of a matrix, with `Linearized` parameters."""

        def look(parameters, t, rows):
            return self.look(parameters.value, t, rows[0])

        return Audit(look, self.limits)


def limits_of(system: System, rtol, solver: Any, scales: tuple[Numeric, Numeric] | None = None) -> Limits:
    """The limits for the scales of a scene.

    Args:
        system: the system; with `scales` its numbers are not read.
        rtol: relative tolerance; None where it is not known.
        solver: the method. Where parts may add energy a Rosenbrock method's account of it is not good enough: it
            evaluates the power of stiff joints at states inside the step, far from the motion.
        scales: its length [m] and energy [J], `length_and_energy`; None to take them from the system.
    """
    share = LARGEST_SHARE if rtol is None else ENERGY_SHARE + TOLERANCES * jnp.max(jnp.asarray(rtol))
    is_known = not (system.tracks_supply and is_linearly_implicit(solver))
    share = jnp.minimum(share, LARGEST_SHARE)
    energy = share if is_known else np.inf
    # A Rosenbrock method evaluates the power at states inside the step, which miss the constraints: in motions that
    # are right its account was off by 0.5e-3 of the energy at an rtol of 1e-6, Runge-Kutta methods' by 2e-7.
    coarse = ROSENBROCK_SHARE if is_linearly_implicit(solver) else 1.0
    loss = energy if system.conserves_energy else share * coarse if system.tracks_constraint_work else np.inf
    length, motion = (length_scale(system), energy_scale(system)) if scales is None else scales
    return Limits(energy, loss, LEAST_ENERGY * motion, CONSTRAINT_SHARE * jnp.minimum(length, 1.0))


def look_of(structure: Structure, scalar: bool | None) -> Callable:
    """The vitals of a system as a program (theta, t, y)."""
    return program_for(vitals, structure, scalar, is_quiet=True)

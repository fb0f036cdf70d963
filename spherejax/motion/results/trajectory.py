"""The result of a run: times, states, observables, statistics, and how it ended."""

import warnings
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.behind_tracers import known_behind
from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.model.system import System, flatten_by_factor
from spherejax.motion.equations.observables import Observation
from spherejax.motion.equations.quantities import quantity
from spherejax.motion.integration.audit import (
    CHECKS,
    NOT_MADE,
    cautions,
    findings,
    parts_with_a_range,
    suspects,
    texts_for,
)
from spherejax.motion.integration.not_finite import not_finite_part
from spherejax.motion.integration.statistics import Statistics
from spherejax.motion.integration.status import STOPPED_IN_MOTION, SimulationError, Status, diagnosis
from spherejax.motion.results.accuracy import POSITIONS, Accuracy
from spherejax.motion.results.between import states_at
from spherejax.motion.results.dataset import table_of, to_dataset
from spherejax.motion.results.energy_parts import EnergyByPart, energy_by_part
from spherejax.motion.results.global_error import GlobalError, floor_of, usual_limit
from spherejax.motion.results.impacts import Peak, impacts, peak
from spherejax.motion.results.modes import modes
from spherejax.motion.results.motion_state import MotionState
from spherejax.motion.results.observed import (
    body_of,
    lengths_of,
    looked_up_of,
    motion_of_body,
    observation_of,
    state_of,
)
from spherejax.motion.results.reported import Reported
from spherejax.motion.results.spectra import spectrum
from spherejax.motion.results.steps import Steps, steps_of
from spherejax.motion.results.traced_impacts import ImpactRows, impact_rows
from spherejax.motion.results.traced_peaks import traced_peak
from spherejax.motion.settings import RunSettings
from spherejax.motion.start.assembly import Assembly
from spherejax.motion.start.redundancy import (
    ConstraintReport,
    SingularPasses,
    report_at,
    singular_joints,
    singular_passes,
    undetermined_reactions,
)
from spherejax.physics.state import State

if TYPE_CHECKING:
    import xarray


N_NAMED = 16
"""Failed runs of many of which the diagnosis looks for singular configurations: each costs about a millisecond."""


class Trajectory(eqx.Module, Reported):
    """A simulated motion.

    It is a pytree: it can be returned from `jax.jit` and `jax.vmap` (its arrays then have a leading axis of lanes; use
    `jax.vmap(lambda run: run.acceleration("rocker"))(runs)` for observables that need an evaluation).

    Attributes:
        ts: sample times [s], shape (n,).
        ys: flat states, shape (n, size); NaN at samples that a failed run did not reach.
        system: the compiled scene.
        stats: what the run cost.
        ended: how it ended, an integer of `Status`; `status` says it in words.
        t_reached: the time that was reached [s].
        y_reached: the flat state there, shape (size,).
        assembly: how the start was made consistent.
        choice: which method was used, and why.
        scalar: whether scalar programs are used; None: those that are not too large.
        settings: with which method and tolerances it was asked for; None where they were traced, or of the user's own.
        accuracy: what `accuracy=` asked for and what came of it; None where it was not given.
        is_continued: whether it began with the end of another motion (static).
        stopped_by: index of the condition of `until=` that ended it, -1 where none was met; None without conditions.
    """

    ts: Float[Array, " n"]
    ys: Float[Array, "n size"]
    system: System
    stats: Statistics
    ended: Int[Array, ""]
    t_reached: Float[Array, ""]
    y_reached: Float[Array, " size"]
    assembly: Assembly
    choice: str = eqx.field(static=True)
    scalar: bool | None = eqx.field(static=True)
    settings: RunSettings | None = eqx.field(static=True, default=None)
    accuracy: Accuracy | None = None
    is_continued: bool = eqx.field(static=True, default=False)
    stopped_by: Int[Array, ""] | None = None

    def __repr__(self) -> str:
        if not is_concrete(self.ended):
            return "Trajectory(traced)"
        bodies, n = ", ".join(self.system.bodies), self.ts.shape[-1]
        ended = "succeeded" if bool(np.all(self.succeeded)) else self.diagnosis
        steps = int(np.sum(self.stats.n_steps))
        return f"Trajectory of {bodies}: {n} samples, {steps} steps, {self.choice}; {ended}"

    # How it ended ------------------------------------------------------------------------------------------------

    @property
    def status(self) -> Any:
        """How it ended: a `Status` of a single run; of many, or traced, the integers."""
        # `eqx.tree_at` asks with marks that are no arrays: it is told by its own error that the leaf is `ended`.
        single = isinstance(self.ended, (int, np.integer, np.ndarray, jax.Array)) and not np.ndim(self.ended)
        return Status(int(self.ended)) if single and is_concrete(self.ended) else self.ended

    @property
    def succeeded(self):
        """Whether the run reached its end."""
        return self.ended == Status.SUCCEEDED

    @property
    def diagnosis(self) -> str:
        """Which lane stopped, when, why, and what to do; empty after success.

        Of a run that its constraints have stopped, it names the joints whose equations become dependent there; of many
        runs, of the first of them.
        """
        behind = self.behind_tracers
        if behind is not None and behind is not self:
            return behind.diagnosis
        if self.accuracy is not None and self.status == Status.INACCURATE:
            return self._inaccurate(self.accuracy)
        text = diagnosis(self.ended, self.t_reached, np.asarray(self.ts)[..., -1], self._cause)
        if not np.ndim(self.ended):
            return f"{text} {said}" if text and (said := self._where_singular) else text
        lanes = [tuple(lane) for lane in np.argwhere(np.asarray(self.ended) != Status.SUCCEEDED)]
        lines = text.splitlines()
        for i, lane in enumerate(lanes[:N_NAMED]):
            if (alone := self._lane(lane)) is not None and (said := alone._where_singular):
                lines[i] = f"{lines[i]} {said}"
        return "\n".join(lines)

    @property
    def _where_singular(self) -> str:
        """Which joints' equations depend on each other where a single run has stopped, and what to do; else empty."""
        if int(self.ended) not in STOPPED_IN_MOTION:
            return ""
        start = (float(self.ts[0]), np.asarray(self.assembly.y))
        joints = singular_joints(self.system, float(self.t_reached), np.asarray(self.y_reached), start)
        if not joints:
            return ""
        there = f"There the equations of joints {', '.join(map(repr, joints))} depend on each other: a singular "
        if self.system.is_driven:
            return (
                f"{there}configuration, which a driver cannot pass where the mechanism reaches no further. Check the "
                "reach of what is driven, or start or drive it otherwise."
            )
        remedy = "" if self.system.drift.n_corrections else "give the scene drift=sj.solvers.PostStabilization(), or "
        return (
            f"{there}configuration, from which the mechanism can go on in more than one way. To pass it, {remedy}"
            "change a length by little, so that it is passed at a distance."
        )

    def _lane(self, lane: tuple[int, ...]) -> "Trajectory | None":
        """One of many runs, where every number has the axes of the runs; None where some have not."""
        shape = np.shape(self.ended)
        leaves, tree = jax.tree.flatten(self)
        if any(np.shape(leaf)[: len(shape)] != shape for leaf in leaves):
            return None
        return jax.tree.unflatten(tree, [leaf[lane] for leaf in leaves])

    @property
    def behind_tracers(self) -> "Trajectory | None":
        """The run as numbers: itself, or what stands behind the tracers of `jax.grad` and `jax.jvp`; else None."""
        if all(map(is_concrete, (self.ended, self.t_reached, self.ys))):
            return self
        known = known_behind(self)
        return known[0] if len(known) == 1 and not np.ndim(known[0].ended) else None

    @property
    def audit(self) -> str:
        """The invariants that were checked after every step, with the largest violation of each relative to its limit.

        In words, with a diagnosis where a limit was exceeded. For one run; `stats.audit` for many.
        """
        if np.ndim(self.ended):
            raise SceneError("audit reports on a single run; take one lane of the batch first")
        shares = np.asarray(self.stats.audit)
        made = {check: share for check, share in zip(CHECKS, shares, strict=True) if share != NOT_MADE}
        worst = ", ".join(f"{check} {share:.1e}" for check, share in made.items())
        text = f"largest violation of any step / its limit: {worst}"
        if self.system.friction_passes:
            text += " (that friction agrees with reactions counts among the constraints)"
        if "energy" not in made:
            text += "; energy is not audited: this method knows too coarsely what drivers, forces or bristles put in"
        beyond = cautions(shares) and cautions(
            shares, parts_with_a_range(self.system, self.y_reached), texts_for(self.system)
        )
        return "; ".join(filter(None, (findings(shares) and self._found(()), beyond, text)))

    @property
    def constraints(self) -> ConstraintReport:
        """Number, rank and redundancy of the constraint equations at the start; prints as sentences. For one run."""
        if np.ndim(self.ended):
            raise SceneError("constraints reports on a single run; take one lane of the batch first")
        return report_at(self.system, float(self.ts[0]), np.asarray(self.assembly.y))

    @cached_property
    def undetermined_reactions(self) -> dict[str, tuple[Literal["force", "moment"], ...]]:
        """Joints whose reactions are not unique at the start, and which part of them: the force, the moment, or both.

        Redundant constraints (a door on two hinges) leave the motion unique but not the share of each joint in the
        reactions. `reaction` and `reaction_moment` of these joints then hold one of many possible answers: equations
        that depend on others are left out, and carry nothing. What all these joints do to a body together is unique.
        Where the share of each matters, give joints fewer equations (a ball that may slide along the axis beside a
        hinge) or an elastic model (`Bushing`). Empty where all reactions are unique. For one run with known numbers.
        """
        if np.ndim(self.ended):
            raise SceneError("undetermined_reactions reports on a single run; take one lane of the batch first")
        return undetermined_reactions(self.system, float(self.ts[0]), np.asarray(self.assembly.y))

    @cached_property
    def singular_passes(self) -> SingularPasses:
        """Singular configurations that the run has passed: between which samples, and which joints; can be printed.

        In a singular configuration (a parallelogram whose bars lie on one line) the constraint equations lose rank, and
        the mechanism can go on in more than one way. A run that passes one follows its momentum, and errors of the
        integration and the tiniest disturbance of a real mechanism may choose another branch. Looked for at the
        samples when it is asked for, about a millisecond each: `.found` has `after` and `before` [s], the samples on
        both sides, and the names of the `joints`; `.unclear` says where samples are too far apart to tell. Redundant
        constraints do not count. For one run with known numbers.

        Limits: a configuration that is only touched, or two between the same samples, are not seen.
        """
        if np.ndim(self.ended):
            raise SceneError("singular_passes reports on a single run; take one lane of the batch first")
        if not all(map(is_concrete, jax.tree.leaves((self.ts, self.ys, self.system)))):
            raise SceneError(
                "singular_passes reports on a run with known numbers; return the run from jit, then ask it"
            )
        return singular_passes(self.system, np.asarray(self.ts), np.asarray(self.ys))

    def require_success(self) -> "Trajectory":
        """The run itself; raises `SimulationError` with the diagnosis when it failed."""
        if not bool(np.all(self.succeeded)):
            raise SimulationError(self.diagnosis)
        return self

    # The state ---------------------------------------------------------------------------------------------------

    @property
    def end(self) -> MotionState:
        """The state at the end, with all that `sj.continue_from` needs to go on; of a failed run where it stopped."""
        t, y = self.t_reached, self.y_reached
        if not is_concrete(self.ended) or np.ndim(self.ended):
            # The last sample has the derivatives on all roads; its value is that of the state at the end.
            last = self.ys[..., -1, :]
            has_failed = (self.ended != Status.SUCCEEDED)[..., None]
            y = jnp.where(has_failed, y, last + jax.lax.stop_gradient(y - last))
            # Known times stay known: runs that share them go on side by side.
            if is_concrete(self.ts) and not np.ndim(self.ended):
                t = np.asarray(self.ts)[-1]
        return MotionState.of(self.system, t, y, self.ended, self.settings, self.scalar)

    @property
    def asked(self) -> RunSettings | None:
        """The earlier name of `settings`."""
        warnings.warn("run.asked is called run.settings now", DeprecationWarning, stacklevel=2)
        return self.settings

    def at(self, t: Float[Array | np.ndarray, "*k"] | float) -> MotionState:
        """The state at any time of the run, or at many, e.g. `run.at(0.123).position("rocker")`.

            states = run.at([0.1, 0.11, 0.12])
            states.position("rocker")  # shape (3, 3)
            states.value("reaction.elbow.z")  # shape (3,)
            other = sj.continue_from(run.at(0.11), ts, other_scene)

        The run is made once more, by the same method and tolerances, and sampled there: the states are those that a run
        with these times in `ts` has, within impacts too. It costs that run; ask for all times in one call. Times that
        are samples cost nothing.

        Args:
            t: a time [s], or many of shape (k,), in any order. It may be traced, and differentiated.

        Returns:
            The state, or the states with a leading axis of times. Under `jit`, `vmap` and `grad` a time outside of the
            run gives a state with the status of a bad value, a time that a failed run has not reached one with the
            run's status, both NaN.

        Raises:
            SceneError: for times outside of the run, for many runs (use `jax.vmap`), for a run that cannot be repeated.
            SimulationError: for a time that a failed run has not reached.

        Limits: `jax.vmap` over times makes one run after the other, with a `SerialRunsWarning`; give them as a vector.
        In a chaotic motion the repeated run may part from this one, where this one was made within `jax.jit`: a
        `PartingWarning` says when. The derivative of a run that `sj.continue_from` made has a row for each entry of its
        start.
        """
        return states_at(self, t)

    @property
    def state(self) -> State:
        """The state by name, with leading axis of samples."""
        return state_of(self.system.layout, self.ys)

    def position(self, body: str) -> Float[Array, "n 3"]:
        """Center of mass of a body, world axes [m]."""
        return motion_of_body(self.system.layout, self.ys, "position", self._body(body))

    def quaternion(self, body: str) -> Float[Array, "n 4"]:
        """Orientation of a body, unit quaternion, scalar first."""
        return motion_of_body(self.system.layout, self.ys, "quaternion", self._body(body))

    def velocity(self, body: str) -> Float[Array, "n 3"]:
        """Velocity of a body's center of mass, world axes [m/s]."""
        return motion_of_body(self.system.layout, self.ys, "velocity", self._body(body))

    def angular_velocity(self, body: str) -> Float[Array, "n 3"]:
        """Angular velocity of a body, world axes [rad/s]."""
        return motion_of_body(self.system.layout, self.ys, "angular_velocity", self._body(body))

    # Observables -------------------------------------------------------------------------------------------------

    @cached_property
    def observation(self) -> Observation:
        """All observables at all samples, evaluated on first use."""
        structure, theta = flatten_by_factor(self.system)
        return observation_of(structure, self.scalar, jnp.asarray(theta), self.ts, self.ys)

    def acceleration(self, body: str) -> Float[Array, "n 3"]:
        """Acceleration of a body's center of mass, world axes [m/s^2]."""
        return body_of(self.observation.acceleration, self._body(body))

    def angular_acceleration(self, body: str) -> Float[Array, "n 3"]:
        """Angular acceleration of a body, world axes [rad/s^2]."""
        return body_of(self.observation.angular_acceleration, self._body(body))

    def reaction(self, joint: str) -> Float[Array, "n 3"]:
        """Force of a joint on its second body (of a spherical joint: the ball's), world axes [N].

        Of joints in `undetermined_reactions` it is one of many possible answers.
        """
        return self.observation.reactions[self._joint(joint)].force

    def reaction_moment(self, joint: str) -> Float[Array, "n 3"]:
        """Moment of a joint on its second body about the joint's point, world axes [N m].

        Of joints in `undetermined_reactions` it is one of many possible answers.
        """
        return self.observation.reactions[self._joint(joint)].moment

    def driving_effort(self, joint: str) -> Float[Array, "n ..."]:
        """What a driver exerts on its second body to keep to what it prescribes.

        Torque about the axis [N m] of a rotation, force along the axis or the line of points [N], shape (n,); force in
        world axes [N] of a position, shape (n, 3).
        """
        effort = self._of_driver(self.observation.driving_effort, joint)
        return effort[:, 0] if effort.shape[-1] == 1 else effort

    def driving_power(self, joint: str) -> Float[Array, " n"]:
        """Power that a driver puts into the mechanism [W]."""
        return self._of_driver(self.observation.driving_power, joint)

    def eccentricity(self, joint: str) -> Float[Array, "n 3"]:
        """From the socket's center to the ball's center, world axes [m]."""
        return self._of_spherical(self.observation.eccentricity, joint)

    def eccentricity_rate(self, joint: str) -> Float[Array, "n 3"]:
        """Time derivative of the eccentricity in world axes [m/s]."""
        return self._of_spherical(self.observation.eccentricity_rate, joint)

    def penetration(self, joint: str) -> Float[Array, " n"]:
        """Penetration |e| - c of ball and socket [m]; negative where they do not touch.

        On surfaces that are not round it is less by their depths in the direction of e.
        """
        model: Any = getattr(self.system.joints[self._joint(joint)], "model", None)
        if getattr(model, "has_surfaces", False) and not model.surfaces.are_round:
            return self.part(joint, "penetration")
        return lengths_of(self.eccentricity(joint)) - self.clearance(joint)

    def eccentricity_ratio(self, joint: str) -> Float[Array, " n"]:
        """|e| / c, above 1 in contact."""
        return lengths_of(self.eccentricity(joint)) / self.clearance(joint)

    def clearance(self, joint: str):
        """Radial clearance of a joint [m]."""
        model = getattr(self.system.joints[self._joint(joint)], "model", None)
        clearance = getattr(model, "clearance", None)
        if clearance is None:
            raise SceneError(f"joint {joint!r} has no clearance: its model is {type(model).__name__}")
        return clearance

    def memory(self, name: str) -> dict[str, Float[Array, " n"]]:
        """What a joint or a force element remembers, e.g. a contact's `onset_rate` [m/s], a controller's `integral`."""
        _ = name in self.system.forces or self._joint(name)
        slots = [slot for slot in self.system.all_slots if slot.joint == name]
        return {entry: self.state.memory[:, slot.start + i] for slot in slots for i, entry in enumerate(slot.names)}

    def part(self, joint: str, name: str) -> Float[Array, "n ..."]:
        """A named contribution of a joint that resists, e.g. `"normal_force"`, `"film_force"` [N]."""
        parts = self.parts(joint)
        if name not in parts:
            raise SceneError(f"joint {joint!r} has no part {name!r}; it has {sorted(parts) or 'none'}")
        return parts[name]

    def parts(self, joint: str) -> dict[str, Float[Array, "n ..."]]:
        """All named contributions of a joint that answers with a force or has friction; of other joints none.

        Every contact has `penetration` [m], `normal_force` (a number), `friction_force` and `sliding_velocity` [m/s];
        films have `film_force` on the ball, `film_moment` [N m] about its center, `film_power` and `shear_power`
        that they absorb [W], `film_thickness` at the thinnest [m], `film_pressure`, the largest [Pa], and
        `film_pressure_place`, the unit vector from the socket's center to it; with warm oil `oil_temperature` [K],
        `hottest_oil` [K] where it is resolved, and `heat_to_socket`, `heat_to_ball`, `heat_to_flow` [W]; bushings have
        `deflection` [m] and `rotation` [rad]; ideal joints with friction `friction_moment` [N m] and `friction_force`
        on the second body, `friction_power` [W] that it takes, `bearing_load` [N], and of its fixed point
        `friction_contraction` and `friction_remainder`; a user's own model what it returns. Vectors in world axes.
        """
        return self.observation.parts.get(self._joint(joint), {}) | self._looked_up.get(joint, {})

    @cached_property
    def _looked_up(self) -> dict[str, dict[str, Array]]:
        structure, theta = flatten_by_factor(self.system)
        return looked_up_of(structure, jnp.asarray(theta), self.ys)

    def force(self, name: str) -> dict[str, Float[Array, "n ..."]]:
        """Named results of a force element, e.g. `run.force("shock")["length"]` [m].

        Every element has `power`, which it puts into the bodies [W], and `potential_energy` [J]. Elements along a line
        have `length`, `rate`, `force` (the tension) and `dissipated_power`; torsion springs `angle`, `angular_rate`,
        `torque`; tyres `load`, `compression` and what the road does; a user's own what its `parts` returns.
        """
        if name not in self.system.forces:
            known = ", ".join(map(repr, self.system.forces)) or "none"
            raise SceneError(f"there is no force element {name!r}; the run has {known}")
        return self.observation.forces[name]

    def mode(self, joint: str) -> np.ndarray:
        """What the ball does at each sample, integers of `Mode` (flight, impact, contact); see `motion.modes`.

        For a concrete run whose samples are finer than a contact lasts.
        """
        return modes(self.system, self.ts, self.ys, self.penetration(joint), joint)

    # How exact it is ---------------------------------------------------------------------------------------------

    @cached_property
    def global_error(self) -> GlobalError:
        """What is known of the error of the whole run; prints as a sentence with what it cost. See `error`."""
        return GlobalError.of_run(self)

    def error(self, name: str) -> np.ndarray:
        """Estimated error of a quantity at the samples, e.g. `run.error("position.rocker")` [m], of its shape.

        `rtol` bounds the error of each step; this is what has become of it. The motion is made once more, from the same
        start at a hundredth of the tolerance, which takes about 1.7 times the steps of the run (Rosenbrock methods: 1.7
        to 3 times), when the first error is asked for; all quantities share it. On ten scenes
        (`benchmarks/global_error.py`) the largest estimate is within a factor of three of the largest error. Where the
        motion is lost (see `determined_until`) it is the largest difference so far: as large as the motion.

        Args:
            name: a quantity as `sj.sweep` records it.

        Returns:
            The estimate, NaN at samples that the run, or its companion, did not reach.

        Raises:
            SceneError: for a batched or traced run, or one that cannot be repeated.

        Limits:
            What both runs have in common is no part of the estimate: the start, the numbers of the scene, a pulse of a
            user's function that is shorter than all steps.
        """
        return self.global_error.of(quantity(name, self.system).name)

    @property
    def determined_until(self) -> float:
        """The time until which the motion is determined to the accuracy asked for [s]; the last sample's if all is.

        Where `accuracy=` was not given: until which the positions of all bodies are known to a hundredth of the
        smallest clearance, or to a thousandth of the mechanism's length where there is none. Later the motion at the
        samples is one of many that are equally right. Told to 1/200 of the run or better, also between samples. Costs
        what `error` costs, and up to two runs more where samples are coarse.
        """
        if self.accuracy is not None and is_concrete(self.accuracy.until) and not np.ndim(self.ended):
            return float(self.accuracy.until)
        return self.global_error.until(((POSITIONS, usual_limit(self.system)),))

    def _inaccurate(self, accuracy: Accuracy) -> str:
        """Why no tolerance gives the accuracy that was asked for, and until when it holds."""
        rows = zip(accuracy.names, accuracy.units, accuracy.limits, accuracy.errors, strict=True)
        missed = [
            f"{name} within {float(limit):.3g} {unit} (estimated error {float(error):.2g} {unit})"
            for name, unit, limit, error in rows
            if not error <= limit
        ]
        is_tightest = float(accuracy.rtol) <= 1.01 * floor_of(self.system)
        why = (
            "The motion multiplies even the errors of rounding, by impacts, chaos or many periods"
            if is_tightest
            else "Runs at tighter tolerances fail or need more than max_steps"
        )
        return (
            f"no tolerance gives {', '.join(missed) or 'what accuracy= asks for with a margin of two'}: at rtol "
            f"{float(accuracy.rtol):.1e}, the best, it holds until t = {float(accuracy.until):.6g} s of "
            f"{float(np.asarray(self.ts)[-1]):.6g} s. {why}. Shorten the run, allow larger errors, "
            f"{'' if is_tightest else 'raise max_steps, '}or ask for statistics of many runs in place of one history."
        )

    # Between the samples -----------------------------------------------------------------------------------------

    @cached_property
    def _steps(self) -> Steps:
        n = np.asarray(self.stats.n_accepted) if is_concrete(self.stats.n_accepted) else 0
        reached = float(self.t_reached) if is_concrete(self.t_reached) and not np.ndim(self.t_reached) else np.nan
        return steps_of(self.system, self.settings, self.ts, self.ys, int(np.max(n)), reached, self.scalar)

    def impacts(self, joint: str) -> "xarray.Dataset":
        """Each contact of a joint: onset, release, approach speed, peaks, impulse, energy lost, place.

        A table with the dimension `contact`, in the order of the onsets; `.to_dataframe()` prints it, `.to_csv()` of
        that writes it. The vectors have the dimension `axis`. Units and words are in the attributes.

        | column | |
        |---|---|
        | `onset`, `release` [s] | a ball that touches at the start has its onset there; NaN where the run ends first |
        | `approach_speed`, `sliding_speed` [m/s] | normal and tangential velocity at the onset |
        | `peak_force` [N], `peak_penetration` [m] | the largest between onset and release |
        | `impulse` [N s] | of the force on the ball, world axes |
        | `energy_lost` [J] | what the joint absorbed, less what it stores |
        | `place` | unit vector to the contact at the onset, in the axes of the socket's body |

        The run is made once more to see its steps, so its samples need not be fine; where the motion is chaotic and the
        repeated run parts from this one, a `PartingWarning` says when. Peaks and integrals are as exact as the states
        of the run, to about its tolerance.

        Raises:
            SceneError: for a joint without contact, a batched or traced run (see `impact_rows`), or a run that cannot
                be repeated.
        """
        steps = self._steps
        return table_of(impacts(self.system, steps, joint, self.scalar), joint)

    def impact_rows(
        self, joint: str, *, rows: int = 32, steps: int = 4096, contact_steps: int | None = None
    ) -> ImpactRows:
        """Each contact of a joint as arrays of a fixed length, within `jit`, `vmap` and `grad` too: `impacts` in rows.

            def hardest(clearance):
                contacts = sj.simulate(scene(clearance), ts).impact_rows("elbow", rows=16)
                return jnp.max(jnp.where(contacts.is_contact, contacts.peak_force, 0.0))

            jax.grad(hardest)(1e-4)

        Rows are in the order of the onsets. `is_contact` says which rows are contacts; the others are zeros. The
        instants of onset and release, the peaks, the impulse, the energy lost, the velocities and the place have the
        derivatives of the run: instants by the implicit function, peaks by the partial derivative at their instants,
        integrals with their limits (energies to some 1e-6 of the energy itself). The run is made twice more, once for
        its steps and once, with derivatives, at the instants that are needed.

        Args:
            joint: with contact.

        Other args:
            rows: the largest number of contacts.
            steps: within a trace, the largest number of steps that the run may have.
            contact_steps: the largest number of steps in contact, of all rows together; None: 32 for each row, enough
                for impacts. A ball that stays pressed to its wall may need more.

        Returns:
            The rows. Where the run has more contacts, steps or steps in contact than there is room for, all numbers are
            NaN and `is_contact` is true everywhere, so that no sum passes over it; `n_contacts`, `n_steps` and
            `n_contact_steps` say how many there are. NaN, too, where the motion with derivatives parts from the run
            (chaos).

        Raises:
            SceneError: for a joint without contact, for many runs (use `jax.vmap`), and for a run that cannot be
                repeated.

        Limits: a contact without a normal velocity at its onset or release has no derivative of that instant, and a
        peak where the force jumps none of its value: to differentiate it raises an error while the program runs.
        `jax.vmap` looks at one run after the other, with a `SerialRunsWarning`.
        """
        return impact_rows(self, joint, rows, steps, contact_steps)

    def spectrum(self, name: str, frequencies: Float[np.ndarray, " m"] | None = None) -> "xarray.Dataset":
        """Amplitude and phase by frequency [Hz], e.g. of "reaction.elbow.z", from all steps: see `motion.spectra`."""
        return spectrum(self.system, self._steps, quantity(name, self.system).name, frequencies, self.scalar)

    def peak(self, name: str, *, steps: int = 4096) -> Peak:
        """Largest magnitude of a quantity over the whole run and when, e.g. `run.peak("reaction.elbow").value` [N].

        Seen at five instants of each step, so that no impact is missed, however coarse the samples are, and taken from
        the polynomial through eight instants of the step with the peak; the names are those of `sj.sweep`. The run is
        made once more, see `impacts`.

        Under `jit`, `vmap` and `grad` it is a number that a program may go on with, an objective for instance:

            jax.grad(lambda mass: sj.simulate(scene(mass), ts).peak("reaction.elbow").value)(0.2)

        Its derivative is the partial one at the instant of the peak, for there a shift of that instant changes nothing;
        the time has none. The run is then made twice more, once for its steps and once, with derivatives, at eight
        instants of the step with the peak.

        Args:
            name: of the quantity.

        Other args:
            steps: within a trace, the largest number of steps that the run may have: their states are kept (1.6 MB for
                4,096 steps of one body). A run with more raises an error while the program runs.

        Raises:
            SceneError: for a run that cannot be repeated.

        Limits: a peak where the quantity jumps, or has a kink, moves along it; to differentiate it raises an error
        while the program runs. `jax.vmap` looks at one run after the other, with a `SerialRunsWarning`.
        """
        if self._is_traced:
            return traced_peak(self, quantity(name, self.system).name, steps)
        return peak(self.system, self._steps, quantity(name, self.system).name, self.scalar)

    @property
    def _is_traced(self) -> bool:
        """Whether it is a single run of which a trace hides a number."""
        return not np.ndim(self.ended) and not all(map(is_concrete, (self.ys, self.ended, self.t_reached)))

    @property
    def kinetic_energy(self) -> Float[Array, " n"]:
        """Kinetic energy of all bodies [J]."""
        return self.observation.kinetic_energy

    @property
    def potential_energy(self) -> Float[Array, " n"]:
        """Potential energy of weight and force elements [J]."""
        return self.observation.potential_energy

    @property
    def elastic_energy(self) -> Float[Array, " n"]:
        """Energy stored in all joints [J]."""
        return sum(self.observation.elastic_energy.values(), jnp.zeros(self.ts.shape))

    @property
    def mechanical_energy(self) -> Float[Array, " n"]:
        """Kinetic, potential and elastic energy together [J]."""
        return self.kinetic_energy + self.potential_energy + self.elastic_energy

    def absorbed_work(self, joint: str) -> Float[Array, " n"]:
        """Work that a joint has taken from the bodies since the start [J]; needs `track_work=True`."""
        names = self.system.resisting_joints
        if joint not in names:
            raise SceneError(f"joint {self._joint(joint)!r} is ideal, without friction: it absorbs no work")
        if not self.system.tracks_work:
            raise SceneError(
                "the work absorbed by each joint was not integrated; pass track_work=True to simulate, or read the "
                "total loss from mechanical_energy"
            )
        return self.state.work[..., names.index(joint)]

    @property
    def supplied_work(self) -> Float[Array, " n"]:
        """Work put in since the start by all parts that may add energy [J]; zeros where there are none.

        Drivers, applied forces, forces and joints of your own, tyres on roads that move, bristles (`LuGre`), all of
        them together; negative where they take more than they give. What such a part stores counts as taken. Explicit
        and diffrax's implicit methods integrate it to about the tolerance, Rosenbrock methods more coarsely.
        """
        if not self.system.tracks_supply:
            return jnp.zeros(self.ts.shape)
        return self.state.work[..., -1]

    def dissipated_energy(self, joint: str) -> Float[Array, " n"]:
        """Energy that a joint has dissipated since the start [J]; needs `track_work=True`.

        Absorbed work minus the change of the energy stored in the joint.
        """
        work = self.absorbed_work(joint)
        stored = self.observation.elastic_energy[joint]
        return work - (stored - stored[:1])

    @cached_property
    def energy_by_part(self) -> EnergyByPart:
        """What each part put in, stores and lost since the start [J], at five instants of each step.

        The fields `put_in`, `stored` and `lost` have a history for each part by its name, `ts` the times [s], and
        `unaccounted` what is left over of their sum, as small as the errors of the run. The powers are integrated over
        the steps, so that impacts between samples count; the run is made once more for it, see `impacts`. It needs no
        `track_work=True`.

        Raises:
            SceneError: for a batched or traced run, or one that cannot be repeated.
        """
        return energy_by_part(self.system, self._steps, self.scalar)

    @property
    def constraint_violation(self) -> Float[Array, " n"]:
        """Largest entry of |Phi| [m or 1]."""
        return self.observation.constraint_violation

    @property
    def velocity_violation(self) -> Float[Array, " n"]:
        """Largest entry of |Phi_dot| [m/s or 1/s]."""
        return self.observation.velocity_violation

    def to_xarray(self, *, every: int = 1) -> "xarray.Dataset":
        """The run as a labelled `xarray.Dataset`, units in the attributes, one of `every` samples; see `to_dataset`."""
        return to_dataset(self, every=every)

    def _cause(self, lane: tuple) -> str:
        """Why a lane ended, as far as it can be found: what the audit saw, the part that is not finite, bad times."""
        lane = lane if np.ndim(self.ended) else ()
        ended = Status(int(np.asarray(self.ended)[lane]))
        if ended == Status.AUDIT_FAILED:
            return self._found(lane)
        ts = np.asarray(self.ts)[lane]
        if ended == Status.BAD_VALUE:
            is_sound = np.all(np.isfinite(ts)) and np.all(np.diff(ts) >= 0)
            return "" if is_sound else "the sample times ts do not increase, or are not finite"
        run = jax.tree.map(lambda leaf: leaf[lane], self) if lane else self
        if not all(map(is_concrete, jax.tree.leaves((run.system, run.t_reached, run.y_reached)))):
            return ""
        reached = float(run.t_reached)
        return not_finite_part(run.system, self.scalar, reached, float(ts[-1] - ts[0]), np.asarray(run.y_reached))

    def _found(self, lane: tuple) -> str:
        """What the audit of a lane has found; of a single run it names the joint or the body."""
        shares = np.asarray(self.stats.audit)[lane if np.ndim(self.ended) else ()]
        if np.ndim(self.ended) or not findings(shares):
            return findings(shares)
        return findings(shares, suspects(self.system, float(self.t_reached), np.asarray(self.y_reached)))

    # Names -------------------------------------------------------------------------------------------------------

    def _body(self, name: str) -> int:
        names = list(self.system.bodies)
        if name not in names:
            raise SceneError(f"there is no body {name!r}; the run has {', '.join(map(repr, names))}")
        return names.index(name)

    def _joint(self, name: str) -> str:
        if name not in self.system.joints:
            raise SceneError(f"there is no joint {name!r}; the run has {', '.join(map(repr, self.system.joints))}")
        return name

    def _of_driver(self, values: dict, joint: str):
        if self._joint(joint) not in values:
            raise SceneError(f"joint {joint!r} is no driver; the run has {', '.join(map(repr, values)) or 'none'}")
        return values[joint]

    def _of_spherical(self, values: dict, joint: str):
        if self._joint(joint) not in values:
            raise SceneError(f"joint {joint!r} is not spherical: it has no eccentricity")
        return values[joint]

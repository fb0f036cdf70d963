"""The result of a run: times, states, observables, statistics, and how it ended."""

from dataclasses import fields
from functools import cached_property
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from spherejax.foundations.bounded_jit import bounded_jit
from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.numerics import safe_norm
from spherejax.model.system import System, flatten_system
from spherejax.motion.assembly import Assembly
from spherejax.motion.audit import CHECKS, NOT_MADE, findings, suspects
from spherejax.motion.dataset import to_dataset
from spherejax.motion.modes import modes
from spherejax.motion.observables import Observation, observe
from spherejax.motion.programs import program_for
from spherejax.motion.redundancy import ConstraintReport, report_at, singular_joints
from spherejax.motion.status import STOPPED_IN_MOTION, SimulationError, Status, diagnosis
from spherejax.physics.state import Layout, State, unpack

if TYPE_CHECKING:
    import xarray


class Statistics(eqx.Module):
    """What a run cost.

    Attributes:
        n_steps: steps tried.
        n_accepted: steps kept.
        n_rejected: steps repeated, for their error or to land on a contact onset or release.
        n_evaluations: evaluations of the right-hand side; for an implicit method without its Newton iterations.
        n_onsets: contact onsets of each joint in the system's `contact_joints`, shape (n_contacts,).
        audit: of each of `audit.CHECKS` the worst that was found, as a share of what is allowed, shape (4,): above 1
            the run has failed. `run.audit` says it in words.
        explanation: which method and which tolerances were used, and why (static).
    """

    n_steps: Int[Array, ""]
    n_accepted: Int[Array, ""]
    n_rejected: Int[Array, ""]
    n_evaluations: Int[Array, ""]
    n_onsets: Int[Array, " n_contacts"]
    audit: Float[Array, "4"]
    explanation: str = eqx.field(static=True, default="")

    def __repr__(self) -> str:
        """The numbers, where they are known."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        if not all(is_concrete(value) for value in values.values()):
            return super().__repr__()
        said = {name: repr(np.asarray(x).tolist()) for name, x in values.items() if not isinstance(x, str)}
        said["audit"] = "[" + ", ".join(f"{x:.2g}" for x in np.ravel(self.audit)) + "]"
        words = [*(f"{name}={value}" for name, value in said.items()), f"explanation={self.explanation!r}"]
        return f"Statistics({', '.join(words)})"


class Trajectory(eqx.Module):
    """A simulated motion.

    It is a pytree: it can be returned from `jax.jit` and `jax.vmap` (its arrays then have a leading axis of lanes; use
    `jax.vmap(lambda run: run.acceleration("rocker"))(runs)` for observables that need an evaluation).

    Attributes:
        ts: sample times [s], shape (n,).
        ys: flat states, shape (n, size); NaN at samples that a failed run did not reach.
        system: the compiled scene.
        stats: what the run cost.
        status: how it ended, an integer of `Status`.
        t_reached: the time that was reached [s].
        y_reached: the flat state there, shape (size,).
        assembly: how the start was made consistent.
        choice: which method was used, and why.
        scalar: whether scalar programs are used; None: those that are not too large.
    """

    ts: Float[Array, " n"]
    ys: Float[Array, "n size"]
    system: System
    stats: Statistics
    status: Int[Array, ""]
    t_reached: Float[Array, ""]
    y_reached: Float[Array, " size"]
    assembly: Assembly
    choice: str = eqx.field(static=True)
    scalar: bool | None = eqx.field(static=True)

    def __repr__(self) -> str:
        if not is_concrete(self.status):
            return "Trajectory(traced)"
        bodies, n = ", ".join(self.system.bodies), self.ts.shape[-1]
        ended = "succeeded" if bool(np.all(self.succeeded)) else self.diagnosis
        steps = int(np.sum(self.stats.n_steps))
        return f"Trajectory of {bodies}: {n} samples, {steps} steps, {self.choice}; {ended}"

    # How it ended ------------------------------------------------------------------------------------------------

    @property
    def succeeded(self):
        """Whether the run reached its end."""
        return self.status == Status.SUCCEEDED

    @property
    def diagnosis(self) -> str:
        """Which lane stopped, when, why, and what to do; empty after success.

        Of a single run that its constraints have stopped, it names the joints whose equations become dependent there.
        """
        text = diagnosis(self.status, self.t_reached, np.asarray(self.ts)[..., -1], self._found)
        if np.ndim(self.status) or not text or int(self.status) not in STOPPED_IN_MOTION:
            return text
        start = (float(self.ts[0]), np.asarray(self.assembly.y))
        joints = singular_joints(self.system, float(self.t_reached), np.asarray(self.y_reached), start)
        if not joints:
            return text
        return (
            f"{text} There the equations of joints {', '.join(map(repr, joints))} depend on each other: a singular "
            "configuration, which a driver cannot pass where the mechanism reaches no further. Check the reach of what "
            "is driven, or start or drive it otherwise."
        )

    @property
    def audit(self) -> str:
        """What the run's audit of itself has looked at and found, in words. For one run; `stats.audit` for many."""
        if np.ndim(self.status):
            raise SceneError("audit reports on a single run; take one lane of the batch first")
        shares = np.asarray(self.stats.audit)
        made = {check: share for check, share in zip(CHECKS, shares, strict=True) if share != NOT_MADE}
        worst = ", ".join(f"{check} {share:.1e}" for check, share in made.items())
        text = f"at every step, as shares of what is allowed: {worst}"
        if "energy" not in made:
            text += "; energy is not audited: this method knows too coarsely what drivers, forces or bristles put in"
        return f"{self._found(())}; {text}" if findings(shares) else text

    @property
    def constraints(self) -> ConstraintReport:
        """Number, rank and redundancy of the constraint equations at the start; prints as sentences. For one run."""
        if np.ndim(self.status):
            raise SceneError("constraints reports on a single run; take one lane of the batch first")
        return report_at(self.system, float(self.ts[0]), np.asarray(self.assembly.y))

    def require_success(self) -> "Trajectory":
        """The run itself; raises `SimulationError` with the diagnosis when it failed."""
        if not bool(np.all(self.succeeded)):
            raise SimulationError(self.diagnosis)
        return self

    # The state ---------------------------------------------------------------------------------------------------

    @property
    def state(self) -> State:
        """The state by name, with leading axis of samples."""
        return _unpacked(self.system.layout, self.ys)

    def position(self, body: str) -> Float[Array, "n 3"]:
        """Center of mass of a body, world axes [m]."""
        return _of_body(self.state.position, self._body(body))

    def quaternion(self, body: str) -> Float[Array, "n 4"]:
        """Orientation of a body, unit quaternion, scalar first."""
        return _of_body(self.state.quaternion, self._body(body))

    def velocity(self, body: str) -> Float[Array, "n 3"]:
        """Velocity of a body's center of mass, world axes [m/s]."""
        return _of_body(self.state.velocity, self._body(body))

    def angular_velocity(self, body: str) -> Float[Array, "n 3"]:
        """Angular velocity of a body, world axes [rad/s]."""
        return _of_body(self.state.angular_velocity, self._body(body))

    # Observables -------------------------------------------------------------------------------------------------

    @cached_property
    def observation(self) -> Observation:
        """All observables at all samples, evaluated on first use."""
        structure, theta = flatten_system(self.system)
        return _observed(structure, self.scalar, jnp.asarray(theta), self.ts, self.ys)

    def acceleration(self, body: str) -> Float[Array, "n 3"]:
        """Acceleration of a body's center of mass, world axes [m/s^2]."""
        return self.observation.acceleration[:, self._body(body), :]

    def angular_acceleration(self, body: str) -> Float[Array, "n 3"]:
        """Angular acceleration of a body, world axes [rad/s^2]."""
        return self.observation.angular_acceleration[:, self._body(body), :]

    def reaction(self, joint: str) -> Float[Array, "n 3"]:
        """Force of a joint on its second body (of a spherical joint: the ball's), world axes [N]."""
        return self.observation.reactions[self._joint(joint)].force

    def reaction_moment(self, joint: str) -> Float[Array, "n 3"]:
        """Moment of a joint on its second body about the joint's point, world axes [N m]."""
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
        """Penetration |e| - c of ball and socket [m]; negative where they do not touch."""
        return jax.vmap(safe_norm)(self.eccentricity(joint)) - self.clearance(joint)

    def eccentricity_ratio(self, joint: str) -> Float[Array, " n"]:
        """|e| / c, above 1 in contact."""
        return jax.vmap(safe_norm)(self.eccentricity(joint)) / self.clearance(joint)

    def clearance(self, joint: str):
        """Radial clearance of a joint [m]."""
        model = getattr(self.system.joints[self._joint(joint)], "model", None)
        clearance = getattr(model, "clearance", None)
        if clearance is None:
            raise SceneError(f"joint {joint!r} has no clearance: its model is {type(model).__name__}")
        return clearance

    def part(self, joint: str, name: str) -> Float[Array, "n ..."]:
        """A named contribution of a joint that answers with a force, e.g. `"normal_force"`, `"film_force"` [N]."""
        parts = self.observation.parts.get(self._joint(joint), {})
        if name not in parts:
            raise SceneError(f"joint {joint!r} has no part {name!r}; it has {sorted(parts) or 'none'}")
        return parts[name]

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
        names = self.system.force_joints
        if joint not in names:
            raise SceneError(f"joint {self._joint(joint)!r} is ideal: it absorbs no work")
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

    @property
    def constraint_violation(self) -> Float[Array, " n"]:
        """Largest entry of |Phi| [m or 1]."""
        return self.observation.constraint_violation

    @property
    def velocity_violation(self) -> Float[Array, " n"]:
        """Largest entry of |Phi_dot| [m/s or 1/s]."""
        return self.observation.velocity_violation

    def to_xarray(self, *, every: int = 1) -> "xarray.Dataset":
        """The run as a labelled `xarray.Dataset`, with units in the attributes; see `motion.dataset.to_dataset`.

        Args:
            every: keep every so many samples.
        """
        return to_dataset(self, every=every)

    def _found(self, lane: tuple) -> str:
        """What the audit of a lane has found; of a single run it names the joint or the body."""
        if np.ndim(self.status):
            return findings(np.asarray(self.stats.audit)[lane])
        shares = np.asarray(self.stats.audit)
        if not findings(shares):
            return ""
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


# Compiled, though it is little: by themselves a dozen kernels would be kept for each number of samples, 1.5 MB each.
@bounded_jit(what="the state of a run")
def _unpacked(layout: Layout, ys) -> State:
    return unpack(layout, ys)


@bounded_jit(what="the state of a body")
def _of_body(quantity, body: int):
    return quantity[..., body, :]


@bounded_jit(what="the quantities of a run")
def _observed(structure, use_scalars: bool | None, theta, ts, ys) -> Observation:
    """Observe sample after sample: one scalar program in one loop that writes one row a sample."""
    program = program_for(observe, structure, use_scalars)
    ahead = program.ahead(theta)

    def flat(t, y):
        return ravel_pytree(program.inside(theta, ahead, t, y))[0]

    rows = jax.lax.map(lambda sample: flat(*sample), (ts, ys))
    example = jax.eval_shape(program, theta, ts[0], ys[0])
    leaves, tree = jax.tree.flatten(example)
    sizes = [int(np.prod(leaf.shape)) for leaf in leaves]
    columns = jnp.split(rows, np.cumsum(sizes)[:-1].tolist(), axis=1)
    return jax.tree.unflatten(tree, [c.reshape(-1, *leaf.shape) for c, leaf in zip(columns, leaves, strict=True)])

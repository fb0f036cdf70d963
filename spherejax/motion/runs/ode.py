"""The equations of motion of a scene as pure functions, for diffrax and other solvers."""

import dataclasses
import warnings
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete, shown
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import real_number, whole_number
from spherejax.foundations.types import Number, Scalar
from spherejax.model.captured import captures_explained
from spherejax.model.scene import Scene
from spherejax.model.system import Structure, System, compile_scene, example_of, flatten_system
from spherejax.motion.equations import terms
from spherejax.motion.equations.contacts import crossings, event_values, state_after_events
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.observables import Observation, observe
from spherejax.motion.equations.programs import path_of, program_for
from spherejax.motion.equations.projection import corrected
from spherejax.motion.equations.sampling import memory_after_samples, next_samples
from spherejax.motion.equations.terms import Energies
from spherejax.motion.integration.problem import initial_state
from spherejax.motion.integration.status import Status, start_status
from spherejax.motion.start.assembly import Assembly, as_ideal, assemble
from spherejax.motion.start.doubts import doubts_of
from spherejax.motion.start.start_now import StartWarning, known_start
from spherejax.physics.joints.base import Crossing, Reaction
from spherejax.physics.state import State, pack, unpack
from spherejax.runtime import require_float64

N_CORRECTIONS = 3
"""Newton corrections of `EquationsOfMotion.project`, as many as `Projection` makes: to rounding."""


class BodyState(NamedTuple):
    """State of one body, world axes; leading axes are allowed.

    Attributes:
        position: of the center of mass [m], shape (3,).
        quaternion: unit quaternion, scalar first, shape (4,).
        velocity: of the center of mass [m/s], shape (3,).
        angular_velocity: [rad/s], shape (3,).
    """

    position: Float[Array, "*n 3"]
    quaternion: Float[Array, "*n 4"]
    velocity: Float[Array, "*n 3"]
    angular_velocity: Float[Array, "*n 3"]


class NamedState(NamedTuple):
    """A state by names.

    Attributes:
        bodies: by name.
        memory: of joints and force elements that remember, by name: `onset_rate` [m/s] of contacts (0 in flight),
            integrals of controllers, and so on.
        work: entries that are integrated beside the motion [J], for the balance of energy; nothing depends on them.
    """

    bodies: dict[str, BodyState]
    memory: dict[str, dict[str, Array]]
    work: Float[Array, "*n w"]


class ContactEvent(eqx.Module):
    """Condition of a `diffrax.Event`: positive between the events of a contact, and zero at each, where it falls.

    Attributes:
        equations: of the scene.
        index: number of the contact.
    """

    equations: "EquationsOfMotion"
    index: int = eqx.field(static=True)

    def __call__(self, t: Number, y: Float[Array, " size"], args: System, **kwargs: Any) -> Scalar:
        """Minus the crossing function in flight, the crossing function in contact [-]."""
        del kwargs
        return _evaluated(event_values, self.equations, t, y, args)[self.index]


class EquationsOfMotion(eqx.Module):
    """The equations of motion of a scene: `f(t, y, args)`, and by name what they consist of.

        [M D^T; D 0] {a; lambda} = {g; gamma - feedback}

    All methods with the arguments `(t, y, args)` are pure functions: time [s], flat state (that of `run.ys`), and the
    numbers of the scene, a pytree (`sj.equations.System`) as `sj.ode` returns it. They work under `jit`, `vmap`, `jvp`
    and `grad`, which differentiates by all three arguments. Each is a scalar program, compiled when it is first called.
    The object itself is static: it has no leaves, and may be closed over.

    Vectors of bodies have 6 entries for each body in the order of `bodies` (three of translation, three of rotation,
    world axes); vectors of constraint equations one for each equation, see `constraint_rows`.

    No number of `args` is a constant of the programs, zeros and ones included: derivatives by all are right, and `args`
    of another scene of the same structure may take their place. That costs up to half as many operations again as a
    run of `sj.simulate`, where known zeros fall out.

    Attributes:
        structure: what the programs are compiled for.
        scalar: None for scalar programs that are not too large, True for scalar programs, False for array code.
        refines_constraints, smallest_pivot: how the constraint equations are solved, see `System`.
    """

    structure: Structure = eqx.field(static=True)
    scalar: bool | None = eqx.field(static=True)
    refines_constraints: bool = eqx.field(static=True)
    smallest_pivot: float = eqx.field(static=True)

    def __call__(self, t: Number, y: Float[Array, " size"], args: System) -> Float[Array, " size"]:
        """Time derivative of the flat state: the right-hand side that `sj.simulate` integrates."""
        return _evaluated(state_rate, self, t, y, args)

    def __repr__(self) -> str:
        return f"EquationsOfMotion of {', '.join(self.bodies)}: {self.size} states"

    # Names --------------------------------------------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Length of the flat state."""
        return self._example.layout.size

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies, in the order of the state."""
        return tuple(self._example.bodies)

    @property
    def constraint_rows(self) -> dict[str, slice]:
        """Entries of each joint in vectors of constraint equations, by name."""
        return dict(_constraint_rows(self.structure))

    @property
    def contacts(self) -> tuple[str, ...]:
        """Joints whose contact begins and ends at instants, in the order of the crossing functions."""
        return self._example.contact_joints

    @property
    def samplers(self) -> tuple[str, ...]:
        """Force elements that sample, in the order of `next_samples`."""
        return self._example.sampled_forces

    @property
    def has_events(self) -> bool:
        """Whether the state jumps at instants (contacts, samples), where an integration has to stop and go on."""
        return bool(self.contacts or self.samplers)

    @property
    def left_to_the_integrator(self) -> tuple[str, ...]:
        """Sentences: the tasks beside the integration of `f` that `sj.simulate` does, and your integrator has to do.

        Empty for a scene that is integrated as it is.
        """
        system = self._example
        said = []
        if self.contacts:
            said.append(
                f"contact of {_listed(self.contacts)} begins and ends at instants: stop there (`contact_events`), go "
                "on from `after_contact`. Without, a ball in flight passes through its socket"
            )
        if self.samplers:
            said.append(f"{_listed(self.samplers)} sample: stop at `next_samples`, go on from `after_samples`")
        if system.touching_forces:
            said.append(
                f"the slope of {_listed(system.touching_forces)} jumps where they touch (`crossings`): steps are small "
                "there, and a step that passes over a touch does not see it"
            )
        if system.drift.n_corrections:
            said.append(
                "nothing holds constraints and norms of quaternions: they drift by the errors of the steps. `project` "
                "corrects a state; drift=sj.solvers.Baumgarte() of a scene puts feedback into `f`"
            )
        if program_for(state_rate, self.structure, self.scalar).reads_time:
            said.append("f depends on time by itself: limit the steps (`dtmax`), or a step passes over a pulse")
        return tuple(said)

    @property
    def _example(self) -> System:
        return example_of(self.structure)

    # States -------------------------------------------------------------------------------------------------------

    def unpack(self, y: Float[Array, "*n size"]) -> NamedState:
        """A flat state by names; leading axes are allowed."""
        system = self._example
        _check_state(self, jnp.shape(y)[-1:])
        state = unpack(system.layout, jnp.asarray(y))
        parts = state.position, state.quaternion, state.velocity, state.angular_velocity
        bodies = {name: BodyState(*(part[..., i, :] for part in parts)) for i, name in enumerate(system.bodies)}
        memory = {}
        for slot in system.all_slots:
            entries = {name: state.memory[..., slot.start + i] for i, name in enumerate(slot.names)}
            memory[slot.joint] = memory.get(slot.joint, {}) | entries
        return NamedState(bodies, memory, state.work)

    def pack(self, state: NamedState) -> Float[Array, "*n size"]:
        """The flat state of a state by names."""
        system = self._example
        bodies = [state.bodies[name] for name in system.bodies]
        leading = jnp.shape(bodies[0].position)[:-1]
        position, quaternion, velocity, angular_velocity = (
            jnp.stack([jnp.asarray(part) for part in parts], -2) for parts in zip(*bodies, strict=True)
        )
        memory = [jnp.asarray(state.memory[slot.joint][name]) for slot in system.all_slots for name in slot.names]
        flat = jnp.stack(memory, -1) if memory else jnp.zeros((*leading, 0))
        work = jnp.asarray(state.work)
        return pack(State(position, quaternion, velocity, angular_velocity, flat, work))

    def start(self, t: Number, args: System) -> Float[Array, " size"]:
        """The flat state in which a motion begins at time t [s], by the numbers in `args`, and differentiable by them.

        Joints are closed and velocities projected as by `sj.simulate`; contacts and controllers have the memory of a
        beginning. NaN where the joints cannot be closed.
        """
        return _started(self, jnp.asarray(t, jnp.float64), args)

    def project(
        self, t: Number, y: Float[Array, " size"], args: System, n_corrections: int = N_CORRECTIONS
    ) -> Float[Array, " size"]:
        """The nearest state on the constraints, in the metric of masses: positions, then velocities; unit quaternions.

        Args:
            t: time [s].
            y: flat state.
            args: numbers of the scene.
            n_corrections: Newton corrections; one is what `PostStabilization` makes behind each step.
        """
        n_corrections = whole_number("n_corrections", n_corrections, f"Leave it out for {N_CORRECTIONS}.")
        _check_state(self, jnp.shape(y))
        return _projected(self, t, y, args, n_corrections)

    # Terms of the equations ---------------------------------------------------------------------------------------

    def mass_matrix(self, t: Number, y: Float[Array, " size"], args: System) -> Float[Array, "k k"]:
        """M: m I and A J A^T of each body on the diagonal [kg, kg m^2]; shape (6 n_bodies, 6 n_bodies)."""
        return _evaluated(terms.mass_matrix, self, t, y, args)

    def velocities(self, t: Number, y: Float[Array, " size"], args: System) -> Float[Array, " k"]:
        """v: velocity [m/s] and angular velocity [rad/s] of each body."""
        return _evaluated(terms.velocities, self, t, y, args)

    def applied_forces(self, t: Number, y: Float[Array, " size"], args: System) -> Float[Array, " k"]:
        """g: forces [N] and moments about the center of mass [N m] of all but the constraints.

        Weights, gyroscopic moments -w x (J w), force elements, joints that answer with a force, and friction in ideal
        joints, under the multipliers that are returned.
        """
        return _evaluated(terms.applied_forces, self, t, y, args)

    def constraint_residual(self, t: Number, y: Float[Array, " size"], args: System) -> Float[Array, " n"]:
        """Phi [m or 1] of the joints that constrain; zero in a motion."""
        return _evaluated(terms.constraint_residual, self, t, y, args)

    def constraint_jacobian(self, t: Number, y: Float[Array, " size"], args: System) -> Float[Array, "n k"]:
        """D: Phi_dot = D v + Phi_t; shape (n equations, 6 n_bodies)."""
        return _evaluated(terms.constraint_jacobian, self, t, y, args)

    def constraint_rate(self, t: Number, y: Float[Array, " size"], args: System) -> Float[Array, " n"]:
        """Phi_dot = D v + Phi_t [m/s or 1/s]; zero in a motion."""
        return _evaluated(terms.constraint_rate, self, t, y, args)

    def constraint_rate_at_rest(self, t: Number, y: Float[Array, " size"], args: System) -> Float[Array, " n"]:
        """Phi_t [m/s or 1/s]: what drivers prescribe."""
        return _evaluated(terms.constraint_rate_at_rest, self, t, y, args)

    def constraint_bias(self, t: Number, y: Float[Array, " size"], args: System) -> Float[Array, " n"]:
        """gamma [m/s^2 or 1/s^2], the right side that is quadratic in velocities: D a = gamma - feedback."""
        return _evaluated(terms.constraint_bias, self, t, y, args)

    def constraint_feedback(self, t: Number, y: Float[Array, " size"], args: System) -> Float[Array, " n"]:
        """2 alpha Phi_dot + beta^2 Phi of `sj.solvers.Baumgarte` [m/s^2 or 1/s^2]; zero for other drift controls."""
        return _evaluated(terms.constraint_feedback, self, t, y, args)

    def accelerations(self, t: Number, y: Float[Array, " size"], args: System) -> Float[Array, " k"]:
        """a: linear [m/s^2] and angular [rad/s^2] acceleration of each body."""
        return _evaluated(terms.accelerations, self, t, y, args)

    def lagrange_multipliers(self, t: Number, y: Float[Array, " size"], args: System) -> Float[Array, " n"]:
        """lambda: the constraints exert -D^T lambda. Where equations depend on others, these have zero."""
        return _evaluated(terms.lagrange_multipliers, self, t, y, args)

    def joint_reactions(self, t: Number, y: Float[Array, " size"], args: System) -> dict[str, Reaction]:
        """`force` [N] and `moment` [N m] of each joint on its second body, about the joint's point there, by name."""
        return _evaluated(terms.joint_reactions, self, t, y, args)

    def energies(self, t: Number, y: Float[Array, " size"], args: System) -> Energies:
        """`kinetic`, `potential`, `elastic` energy [J], and the sum, `mechanical`."""
        return _evaluated(terms.energies, self, t, y, args)

    def observe(self, t: Number, y: Float[Array, " size"], args: System) -> Observation:
        """All that a run answers at an instant.

        Fields: `acceleration`, `angular_acceleration` (of each body), `reactions`, `eccentricity`,
        `eccentricity_rate`, `parts` (of joints, such as `penetration` and `friction_force`), `elastic_energy`, `forces`
        (results of force elements), `driving_effort`, `driving_power`, `kinetic_energy`, `potential_energy`,
        `constraint_violation`, `velocity_violation`. Dictionaries are by name.
        """
        return _evaluated(observe, self, t, y, args)

    # Events -------------------------------------------------------------------------------------------------------

    def crossings(self, t: Number, y: Float[Array, " size"], args: System) -> Crossing:
        """Crossing functions of all contacts, in the order of `contacts`, then of stops, tyres and the like.

        Of a contact g = (|e|^2 / c^2 - 1) / 2: negative off the surface, zero where contact begins and ends, about
        penetration / clearance beyond; of the others their depth [m]. `value`, its `rate`, and e_dot / c as `velocity`.
        """
        self._require(bool(self.contacts or self._example.touching_forces), "has no contacts")
        return _evaluated(crossings, self, t, y, args)

    @property
    def contact_events(self) -> dict[str, ContactEvent]:
        """Conditions for `diffrax.Event(f.contact_events, root_finder, direction=False)`, by joint.

        Each is positive in flight and in contact, and falls through zero where the one ends and the other begins.
        `diffrax` looks at the ends of steps alone: limit the steps (`dtmax`) so that no contact lies within one.
        """
        return {name: ContactEvent(self, i) for i, name in enumerate(self.contacts)}

    def after_contact(self, t: Number, y: Float[Array, " size"], args: System, events: Any) -> Float[Array, " size"]:
        """The flat state behind contact events: a flight becomes contact with the normal velocity it has, and reverse.

        Args:
            t: time of the event [s].
            y: flat state there, where the crossing function is zero.
            args: numbers of the scene.
            events: whether each contact has its event, by joint; `solution.event_mask` of diffrax is this.
        """
        self._require(bool(self.contacts), "has no contacts")
        if not isinstance(events, Mapping):
            raise SceneError(
                f"events = {shown(events)} is no dictionary by joint; write e.g. {{{self.contacts[0]!r}: True}}, or "
                "give solution.event_mask of diffrax"
            )
        if unknown := set(events) - set(self.contacts):
            raise SceneError(
                f"events: {_listed(sorted(unknown))} have no contact; the contacts are {_listed(self.contacts)}"
            )
        happen = [jnp.asarray(events.get(name, False), jnp.float64) for name in self.contacts]
        return _evaluated(state_after_events, self, t, (y, jnp.stack(happen)), args)

    def next_samples(self, t: Number, y: Float[Array, " size"], args: System) -> Float[Array, " n_sampled"]:
        """Instant of the coming sample of each force element that samples [s], in the order of `samplers`."""
        self._require(bool(self.samplers), "has no element that samples")
        return _evaluated(next_samples, self, t, y, args)

    def after_samples(self, t: Number, y: Float[Array, " size"], args: System) -> Float[Array, " size"]:
        """The flat state behind all samples that are due at t; unchanged where none is."""
        self._require(bool(self.samplers), "has no element that samples")
        layout = self._example.layout
        memory = _evaluated(memory_after_samples, self, t, y, args)
        return jnp.concatenate([y[: layout.memory_start], memory, y[layout.work_start :]])

    def _require(self, has: bool, lack: str) -> None:
        if not has:
            raise SceneError(f"the scene of {_listed(self.bodies)} {lack}")

    def numbers(self, args: System) -> Float[Array, " p"]:
        """All numbers of a scene as one vector.

        Raises:
            SceneError: for numbers of a scene of another structure.
        """
        if not isinstance(args, System):
            raise SceneError(
                f"args must be the numbers of a scene, as sj.ode(scene).args has them; it is a {type(args).__name__}"
            )
        # Traced masses are taken for far apart; that is how the equations are solved, no other scene.
        alike: Any = dataclasses.replace(
            args, refines_constraints=self.refines_constraints, smallest_pivot=self.smallest_pivot
        )
        leaves, tree = jax.tree.flatten(alike)
        shapes = tuple(jnp.shape(leaf) for leaf in leaves)
        if tree != self.structure.tree:
            raise SceneError(
                "args are the numbers of a scene of another structure than f was made of: other bodies, joints, laws, "
                "or functions. Make both by one call, f, y0, args = sj.ode(scene)"
            )
        if shapes != self.structure.shapes:
            raise SceneError(
                "args have arrays of other shapes than f was made of; numbers of many scenes go through jax.vmap(f)"
            )
        return jnp.concatenate([jnp.zeros(0), *(jnp.asarray(leaf, jnp.float64).ravel() for leaf in leaves)])


class Ode(NamedTuple):
    """An ordinary differential equation dy/dt = f(t, y, args), y(t0) = y0.

    Attributes:
        f: the right-hand side, with the terms of the equations as methods.
        y0: flat state at the start.
        args: numbers of the scene, a pytree of arrays.
    """

    f: EquationsOfMotion
    y0: Float[Array, " size"]
    args: System


def ode(scene: Scene, *, t0: Number = 0.0, track_work: bool = False, scalar: bool | None = None) -> Ode:
    """The equations of motion of a scene, as what diffrax and other solvers take: `f, y0, args = sj.ode(scene)`.

        diffrax.diffeqsolve(diffrax.ODETerm(f), diffrax.Kvaerno5(), t0, t1, dt0, y0, args, ...)

    What `sj.simulate` does beside the integration is left to you: contact events and samples, where the state jumps
    (`f.has_events`), and correction of drift. `f.left_to_the_integrator` says what there is in this scene, and
    `EquationsOfMotion` has the functions for it. A scene without contacts and samples is integrated as it is.

    Args:
        scene: the mechanism; its numbers may be traced.

    Other args:
        t0: time at which the motion starts [s]; drivers prescribe positions there.
        track_work: integrate the work that each non-ideal joint absorbs as well.
        scalar: True makes scalar programs, False array code; None scalar programs up to a size that compiles in
            seconds.

    Returns:
        `f(t, y, args)`, the consistent start `y0`, and the numbers `args` that they have. Derivatives of `y0` by traced
        numbers go through the closing of the joints; `f.start(t0, args)` is y0 as a function of `args`. Where traced
        numbers are ones that the scene refuses, or leave a joint open, y0 is NaN.

    Raises:
        SceneError: for a scene that cannot be simulated.
    """
    require_float64()
    real_number("t0", t0)
    with captures_explained([scene]):
        compiled = compile_scene(scene, track_work=track_work)
        system = compiled.system
        structure, _ = flatten_system(system)
        # Derivatives by numbers that are constants of a program would be zero.
        structure = dataclasses.replace(structure, special=())
        path = path_of(structure, scalar)
        f = EquationsOfMotion(structure, path.scalar, system.refines_constraints, system.smallest_pivot)
        args = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), system)
        start = known_start(system, np.array([t0], np.float64) if is_concrete(t0) else jnp.asarray(t0)[None])
        if start is None:
            y0 = f.start(t0, args)
        else:
            for said in (*start.warnings, *doubts_of(scene, system)):
                warnings.warn(said, StartWarning, stacklevel=2)
            y0 = _completed(f, jnp.asarray(t0, jnp.float64), args, start.assembly)
    if compiled.conditions:
        y0 = jnp.where(jnp.all(jnp.stack(compiled.conditions)), y0, jnp.nan)
    return Ode(f, y0, args)


@partial(jax.jit, static_argnums=0, inline=True)
def _evaluated(function: Callable, equations: EquationsOfMotion, t, y, args: System) -> Any:
    """A function of a system as a program; inlined where it is part of another program."""
    y = y if isinstance(y, tuple) else jnp.asarray(y, jnp.float64)
    _check_state(equations, jnp.shape(y[0] if isinstance(y, tuple) else y))
    sizes = tuple(part.shape[0] for part in y) if isinstance(y, tuple) else None
    program = program_for(function, equations.structure, equations.scalar, sizes, is_quiet=function is not state_rate)
    # Straight lines of thousands of operations, and their derivatives: XLA takes 15 times as long to compile them.
    with program.native_code():
        return program(equations.numbers(args), jnp.asarray(t, jnp.float64), y)


def _check_state(equations: EquationsOfMotion, shape: tuple[int, ...]) -> None:
    """Raise `SceneError` for a state of another length than the scene's."""
    if shape != (equations.size,):
        raise SceneError(
            f"the state of {equations!r} must have the shape ({equations.size},); it has {shape}. The arguments are "
            "(t, y, args); many states go through jax.vmap"
        )


@partial(jax.jit, static_argnums=4, inline=True)
def _projected(equations: EquationsOfMotion, t, y, args: System, n_corrections: int) -> Float[Array, " size"]:
    program = program_for(corrected, equations.structure, equations.scalar)
    theta, t = equations.numbers(args), jnp.asarray(t, jnp.float64)
    with program.native_code():
        return jax.lax.fori_loop(0, n_corrections, lambda _, y: program(theta, t, y), y)


@jax.jit
def _started(equations: EquationsOfMotion, t: Scalar, args: System) -> Float[Array, " size"]:
    system = equations.structure.system(equations.numbers(args))
    assembly = assemble(*flatten_system(as_ideal(system)), t)
    y0 = initial_state(system, assembly, t)
    is_ready = start_status(jnp.array(True), assembly.residual_after, y0) == Status.SUCCEEDED
    return jnp.where(is_ready, y0, jnp.nan)


@jax.jit
def _completed(equations: EquationsOfMotion, t: Scalar, args: System, assembly: Assembly) -> Float[Array, " size"]:
    return initial_state(equations.structure.system(equations.numbers(args)), assembly, t)


@lru_cache(maxsize=64)
def _constraint_rows(structure: Structure) -> dict[str, slice]:
    rows = {}

    def seen(t, y):
        system = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), example_of(structure))
        rows.update(terms.constraint_rows(system, t, y))

    jax.eval_shape(seen, jnp.zeros(()), jnp.zeros(example_of(structure).layout.size))
    return rows


def _listed(names) -> str:
    return ", ".join(map(repr, names))

"""The state of a motion at one instant, with all that it takes to go on from there."""

from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError, one_of
from spherejax.model.system import System, flatten_by_factor
from spherejax.motion.equations.observables import Observation
from spherejax.motion.equations.quantities import at_instant, quantity
from spherejax.motion.integration.status import REMEDIES, Status
from spherejax.motion.results.observed import observation_of
from spherejax.motion.settings import RunSettings
from spherejax.physics.state import State, unpack


@dataclass(frozen=True)
class KnownNumbers:
    """The numbers of a system that are known, as something static: it is hashed and compared by value.

    They stay known within programs that a state goes through (`jax.jit`, `jax.lax.scan`): the equations are then those
    of the run before, and derivatives are taken by no more numbers than are traced.

    Attributes:
        key: type and bits of each known number; None in the places of those that are traced.
        tree: the structure of the system.
        leaves: the known numbers; None in the places of the others.
    """

    key: tuple
    tree: Any
    leaves: tuple = field(compare=False)

    def __repr__(self) -> str:
        # JAX shows what is static where two structures differ.
        places = ", ".join(str(i) for i, leaf in enumerate(self.leaves) if leaf is None) or "none"
        return f"KnownNumbers({len(self.leaves)} arrays, of which traced: {places})"

    @classmethod
    def of(cls, system: System) -> "KnownNumbers":
        """Those of a system."""
        leaves, tree = jax.tree.flatten(system)
        known = tuple(leaf if is_concrete(leaf) else None for leaf in leaves)
        keys = tuple(None if leaf is None else _key_of(leaf) for leaf in known)
        return cls(keys, tree, known)


def _key_of(leaf: Any) -> tuple:
    """A number or an array by its type and its bits: NaN is equal to itself, and 0.0 is not -0.0."""
    array = np.asarray(leaf)
    return type(leaf), array.dtype.str, array.shape, array.tobytes()


class MotionState(eqx.Module):
    """A mechanism at one instant: where a run has ended, or a step of `sj.advance`; see `sj.continue_from`.

    It is a pytree whose leaves are arrays, and can be carried by `jax.lax.scan`, mapped by `jax.vmap` and returned from
    `jax.jit`. Numbers of the scene that were known when it was made are static; those that were traced are leaves.

    Attributes:
        t: time [s].
        y: flat state with the memory of joints and forces and with the works, shape (size,).
        ended: how the motion that led here ended, an integer of `Status`; from a motion that has failed none goes on.
        traced: the system's numbers that are traced, in its structure.
        known: the system's other numbers (static).
        settings: method and tolerances (static); None where they were traced, or of the user's own.
        scalar: whether scalar programs are used (static); None: those that are not too large.
    """

    t: Float[Array, ""]
    y: Float[Array, " size"]
    ended: Int[Array, ""]
    traced: Any
    known: KnownNumbers = eqx.field(static=True)
    settings: RunSettings | None = eqx.field(static=True)
    scalar: bool | None = eqx.field(static=True)

    @classmethod
    def of(
        cls, system: System, t: Any, y: Any, ended: Any, settings: RunSettings | None, scalar: bool | None
    ) -> "MotionState":
        """The state of a system.

        Args:
            system: with all numbers.
            t: time [s].
            y: flat state.
            ended: integer of `Status`.
            settings: method and tolerances.
            scalar: whether scalar programs are used.
        """
        known = KnownNumbers.of(system)
        traced = [None if is_concrete(leaf) else leaf for leaf in jax.tree.leaves(system)]
        return cls(t, y, ended, jax.tree.unflatten(known.tree, traced), known, settings, scalar)

    @property
    def system(self) -> System:
        """The compiled scene, with all its numbers."""
        traced = iter(jax.tree.leaves(self.traced))
        leaves = [next(traced) if leaf is None else leaf for leaf in self.known.leaves]
        return jax.tree.unflatten(self.known.tree, leaves)

    def __repr__(self) -> str:
        if not all(map(is_concrete, (self.t, self.y, self.ended))):
            return "MotionState(traced)"
        names = ", ".join(self.known_system.bodies)
        if np.ndim(self.ended):
            return f"{np.size(self.ended)} states of {names}"
        return f"State of {names} at t = {float(self.t):.9g} s" + (f"; {self.diagnosis}" if self.diagnosis else "")

    @property
    def known_system(self) -> System:
        """The system without the numbers that are traced: its names and its layout."""
        return jax.tree.unflatten(self.known.tree, [np.nan if leaf is None else leaf for leaf in self.known.leaves])

    @property
    def succeeded(self):
        """Whether the motion has come here without a failure."""
        return self.ended == Status.SUCCEEDED

    @property
    def diagnosis(self) -> str:
        """Why the motion that led here has failed, and what to do; empty where it has not. Of one state of numbers."""
        if np.ndim(self.ended) or not is_concrete(self.ended):
            raise SceneError("diagnosis is of a single state outside of jit, vmap and grad; see `ended` of many")
        if int(self.ended) == Status.SUCCEEDED:
            return ""
        return f"stopped at t = {float(self.t):.9g} s: {REMEDIES[Status(int(self.ended))]}."

    @property
    def state(self) -> State:
        """The state by name."""
        return unpack(self.known_system.layout, self.y)

    def position(self, body: str) -> Float[Array, " 3"]:
        """Center of mass of a body, world axes [m]."""
        return self.state.position[..., self._body(body), :]

    def quaternion(self, body: str) -> Float[Array, " 4"]:
        """Orientation of a body, unit quaternion, scalar first."""
        return self.state.quaternion[..., self._body(body), :]

    def velocity(self, body: str) -> Float[Array, " 3"]:
        """Velocity of a body's center of mass, world axes [m/s]."""
        return self.state.velocity[..., self._body(body), :]

    def angular_velocity(self, body: str) -> Float[Array, " 3"]:
        """Angular velocity of a body, world axes [rad/s]."""
        return self.state.angular_velocity[..., self._body(body), :]

    def memory(self, name: str) -> dict[str, Float[Array, ""]]:
        """What a joint or a force element remembers, by name of the entry; see `Trajectory.memory`."""
        system = self.known_system
        if name not in system.joints and name not in system.forces:
            raise SceneError(
                f"there is no joint or force element {name!r}; {one_of([*system.joints, *system.forces], name)}"
            )
        slots = [slot for slot in system.all_slots if slot.joint == name]
        memory = self.state.memory
        return {entry: memory[..., slot.start + i] for slot in slots for i, entry in enumerate(slot.names)}

    @property
    def observation(self) -> Observation:
        """All observables at this instant: accelerations, reactions, parts of joints and forces, energies.

        As of a run (`Trajectory.observation`), without the axis of samples; of many states with that of the states.
        """
        if self._are_many_systems:
            return jax.vmap(lambda state: state.observation)(self)
        structure, theta = flatten_by_factor(self.system)
        ts, ys = jnp.atleast_1d(jnp.asarray(self.t)), jnp.atleast_2d(jnp.asarray(self.y))
        observed = observation_of(structure, self.scalar, jnp.asarray(theta), ts, ys)
        return observed if np.ndim(self.ended) else jax.tree.map(lambda leaf: leaf[0], observed)

    def value(self, name: str) -> Float[Array, "..."]:
        """A quantity by its name, as `sj.sweep` records it, e.g. `state.value("reaction.elbow.z")` [N].

        Args:
            name: such as "position.rocker", "acceleration.rocker.x", "penetration.elbow", "kinetic_energy",
                "shock.length".

        Raises:
            SceneError: for an unknown name, and for a quantity that counts from the start of a run.
        """
        if self._are_many_systems:
            return jax.vmap(lambda state: state.value(name))(self)
        system, what = self.system, quantity(name, self.known_system)

        def taken(observation, y):
            return at_instant(system, observation, y, what)

        return (jax.vmap(taken) if np.ndim(self.ended) else taken)(self.observation, jnp.asarray(self.y))

    @property
    def _are_many_systems(self) -> bool:
        """Whether the states have more axes than one, or numbers of the scene of their own."""
        return np.ndim(self.ended) > 1 or bool(np.ndim(self.ended) and jax.tree.leaves(self.traced))

    def _body(self, name: str) -> int:
        names = list(self.known_system.bodies)
        if name not in names:
            raise SceneError(f"there is no body {name!r}; {one_of(names, name)}")
        return names.index(name)

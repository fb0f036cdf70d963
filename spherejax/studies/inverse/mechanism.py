"""The mechanism as inverse dynamics sees it: every joint ideal, motors taken out."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError, one_of
from spherejax.model.drift import NoDriftControl
from spherejax.model.scene import Scene
from spherejax.model.system import MemorySlot, System, compile_scene
from spherejax.motion.start.assembly import as_ideal
from spherejax.motion.start.tolerances import length_scale
from spherejax.physics.forces.actuators import AbstractMotor, Actuator
from spherejax.physics.forces.base import AbstractForce
from spherejax.physics.forces.coupler import AbstractCoordinate
from spherejax.physics.forces.remembering import memory_entries
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.joint import AbstractPlacedJoint
from spherejax.physics.joints.spherical import PlacedSpherical
from spherejax.studies.inverse.terms import coordinates_of

Motors = Sequence[str] | Mapping[str, AbstractCoordinate] | str | None


class IdealMechanism(eqx.Module):
    """A scene whose reactions and motors are to be found.

    Attributes:
        system: with ideal joints and drivers, and the force elements that are no motors.
        closed: the same without force elements and memory.
        actuated: the bodies with the motors that are force elements or coordinates.
        observed: the bodies with the coordinates that were measured.
        motors: names of all motors: those of `actuated`, then drivers (static).
        positions: bodies whose positions were measured (static).
        quaternions: bodies whose orientations were measured (static).
        length: L [m], by which moments count beside forces, and lengths beside angles.
    """

    system: System
    closed: System
    actuated: System
    observed: System
    motors: tuple[str, ...] = eqx.field(static=True)
    positions: tuple[str, ...] = eqx.field(static=True)
    quaternions: tuple[str, ...] = eqx.field(static=True)
    length: Any

    @property
    def coordinates(self) -> dict[str, AbstractCoordinate]:
        """Of the motors that are no drivers, by name."""
        return coordinates_of(self.actuated)

    @property
    def drivers(self) -> tuple[str, ...]:
        """Names of the drivers whose efforts are to be found."""
        return tuple(name for name in self.motors if name in self.system.joints)

    @property
    def targets(self) -> dict[str, AbstractCoordinate]:
        """Coordinates that were measured, by name."""
        return coordinates_of(self.observed)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that are no drivers."""
        return tuple(name for name, joint in self.system.joints.items() if not joint.is_driven and joint.n_rows)

    @property
    def n_bodies(self) -> int:
        """Number of moving bodies."""
        return len(self.system.bodies)

    def scales(self) -> Float[Array, " k"]:
        """What makes the steps of all bodies comparable: 1/L of translations, 1 of rotations."""
        kinds = jnp.concatenate([jnp.full(3, 1 / self.length), jnp.ones(3)])
        return jnp.tile(kinds, self.n_bodies)


def mechanism_of(scene: Scene, motors: Motors, friction: bool, measured: Any = None) -> tuple[IdealMechanism, list]:
    """The mechanism, and conditions on traced values that could not be judged.

    Raises:
        SceneError: for motors that the scene does not have, and for what a motion does not tell.
    """
    given, targets = _with_coordinates(scene, motors, measured)
    compiled = compile_scene(given)
    system = compiled.system
    names = _motor_names(system, motors)
    motors_here = {name: system.forces[name] for name in sorted(names) if name in system.forces}
    targets_here = {name: system.forces[_TARGET + name] for name in sorted(targets)}
    drivers = tuple(name for name in names if name in system.joints)
    left = {
        name: force for name, force in system.forces.items() if name not in motors_here and not name.startswith(_TARGET)
    }
    joints = {name: ideal_joint(joint, friction) for name, joint in system.joints.items()}
    slots, end = _slots({name: joint.memory for name, joint in joints.items()}, 0)
    force_slots, _ = _slots({name: memory_entries(force) for name, force in left.items()}, end)

    def reduced(joints, forces, slots=(), force_slots=()) -> System:
        return System(
            system.bodies, joints, forces, system.gravity, NoDriftControl(), slots, False, force_slots=force_slots
        )

    whole = reduced(joints, left, slots, force_slots)
    mechanism = IdealMechanism(
        whole,
        as_ideal(whole),
        reduced({}, motors_here),
        reduced({}, targets_here),
        (*motors_here, *drivers),
        () if measured is None else tuple(sorted(measured.positions)),
        () if measured is None else tuple(sorted(measured.quaternions)),
        jax.lax.stop_gradient(jnp.asarray(length_scale(whole), jnp.float64)),
    )
    return mechanism, compiled.conditions


_TARGET = "measured: "
"""Begins the names of coordinates that are placed in the scene to be looked at."""


def _with_coordinates(scene: Scene, motors: Motors, measured: Any) -> tuple[Scene, dict[str, AbstractCoordinate]]:
    """The scene with the coordinates of motors and of measurements, so that they are checked and placed with it."""
    more: dict[str, AbstractForce] = {}
    if isinstance(motors, Mapping):
        taken = {*scene.joints, *scene.forces}
        for name, coordinate in motors.items():
            if name in taken:
                raise SceneError(f"motor {name!r} has the name of a joint or force element; give it another")
            if not isinstance(coordinate, AbstractCoordinate):
                raise SceneError(f"motor {name!r} must be a Turn, a Travel or an Extension; it is {coordinate!r}")
            more[name] = Actuator(coordinate)
    targets = {} if measured is None else {name: pair[0] for name, pair in measured.coordinates.items()}
    more |= {_TARGET + name: Actuator(coordinate) for name, coordinate in targets.items()}
    if measured is not None:
        for name in measured.body_names:
            if name not in scene.bodies:
                raise SceneError(f"the sampled motion has no body {name!r} to move: {one_of(scene.bodies, name)}")
    return eqx.tree_at(lambda s: s.forces, scene, {**scene.forces, **more}), targets


def _motor_names(system: System, motors: Motors) -> tuple[str, ...]:
    drivers = tuple(name for name, joint in system.joints.items() if joint.is_driven)
    elements = tuple(
        name for name, force in system.forces.items() if isinstance(force, AbstractMotor) and _TARGET not in name
    )
    if motors is None:
        return drivers or elements
    names = (motors,) if isinstance(motors, str) else tuple(motors)
    for name in names:
        if name not in drivers and name not in elements:
            raise SceneError(
                f"there is no motor {name!r}: {one_of((*drivers, *elements), name)}. A motor is a driver, an Actuator "
                'or a controller of the scene; others are given by motors={"name": sj.Turn(...)}'
            )
    return names


def ideal_joint(joint: AbstractPlacedJoint, friction: bool) -> AbstractPlacedJoint:
    """The joint by its constraint equations alone, with its friction where it is ideal already and has some."""
    if isinstance(joint, PlacedSpherical) and not joint.model.is_ideal:
        return joint.ideal if joint.ideal is not None else eqx.tree_at(lambda j: j.model, joint, Ideal())
    if friction or joint.friction is None:
        return joint
    ideal = joint.as_if_ideal()
    assert ideal is not None, type(joint).__name__
    return ideal


def _slots(entries: dict[str, tuple], start: int) -> tuple[tuple[MemorySlot, ...], int]:
    slots = []
    for name, contents in entries.items():
        if contents:
            slots.append(MemorySlot(name, start, tuple(contents)))
            start += len(contents)
    return tuple(slots), start

"""Bodies, and joints of one kind, side by side: what is written for one is mapped over all.

Two joints are of one kind when their placed forms differ in numbers and in the names of their bodies only. How many
there are of each kind then changes the length of the arrays, and not the program.
"""

import copy
import dataclasses
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.linear_algebra import rows_at
from spherejax.model.system import Structure, System, example_of
from spherejax.physics.bodies import Body
from spherejax.physics.joints.joint import AbstractPlacedJoint

FIRST, SECOND = "first", "second"
"""Names of the two bodies of a joint that stands for all of its kind."""


class JointGroup(eqx.Module):
    """Joints of one kind.

    Attributes:
        names: of the joints.
        first: number of each joint's first body: 0 for the ground, then the bodies in the order of the state.
        second: number of each joint's second body.
        joint: their numbers as one joint between the bodies `FIRST` and `SECOND`; arrays have a leading axis of joints.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    first: tuple[int, ...] = eqx.field(static=True)
    second: tuple[int, ...] = eqx.field(static=True)
    joint: AbstractPlacedJoint


class Stacks(eqx.Module):
    """A system's bodies and joints as arrays.

    Attributes:
        bodies: all bodies as one, arrays with a leading axis of bodies.
        joints: the joints by kind.
    """

    bodies: Body
    joints: tuple[JointGroup, ...]


def stacks_of(system: System) -> Stacks:
    """The system's numbers, stacked; those that it brings along, where it does."""
    if system.stacks is not None:
        return system.stacks
    return Stacks(_stacked_bodies(system), _joint_groups(system))


def stacks_from(structure: Structure, theta) -> Stacks:
    """The stacked numbers, picked from the flat vector: a few operations, however many bodies there are."""
    places = _places_of(structure)
    if places is None:
        return stacks_of(structure.system(theta))
    return jax.tree.map(lambda place: rows_at(jnp.asarray(theta), place.ravel()).reshape(place.shape), places)


@lru_cache(maxsize=256)
def joints_by_kind(structure: Structure) -> tuple[tuple[str, ...], ...]:
    """The names of a system's joints, those of one kind together."""
    return tuple(map(tuple, _by_kind(example_of(structure))))


@lru_cache(maxsize=256)
def _places_of(structure: Structure) -> Stacks | None:
    """Where in the flat vector each of the stacked numbers is; None where stacking converts some."""
    size = sum(int(np.prod(shape)) for shape in structure.shapes)
    with jax.ensure_compile_time_eval():
        system = structure.system(np.arange(size, dtype=np.float64))
        if len({np.shape(body.inertia) for body in system.bodies.values()}) > 1:
            return None
        return jax.tree.map(lambda place: np.asarray(place, np.int64), stacks_of(system))


def _stacked_bodies(system: System) -> Body:
    bodies = list(system.bodies.values())
    if len({np.shape(body.inertia) for body in bodies}) > 1:  # principal moments beside full matrices
        bodies = [eqx.tree_at(lambda b: b.inertia, body, _full(body.inertia)) for body in bodies]
    return _stacked(bodies)


def _full(inertia):
    return jnp.asarray(inertia) if np.ndim(inertia) == 2 else jnp.asarray(inertia)[:, None] * np.eye(3)


def _by_kind(system: System) -> list[list[str]]:
    """The names of a system's joints, those of one kind together."""
    kinds: dict[Any, list[str]] = {}
    for name, joint in system.joints.items():
        leaves, tree = jax.tree.flatten(_anonymous(joint))
        kinds.setdefault((tree, tuple(np.shape(leaf) for leaf in leaves)), []).append(name)
    return list(kinds.values())


def _joint_groups(system: System) -> tuple[JointGroup, ...]:
    number = {name: i for i, name in enumerate(system.bodies, 1)}
    groups = []
    for names in _by_kind(system):
        joints = [system.joints[name] for name in names]
        ends = [tuple(number.get(body, 0) for body in joint.bodies) for joint in joints]
        stacked = _stacked([_anonymous(joint) for joint in joints])
        groups.append(JointGroup(tuple(names), tuple(i for i, _ in ends), tuple(j for _, j in ends), stacked))
    return tuple(groups)


def _stacked(alike: list) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf, jnp.float64) for leaf in leaves]), *alike)


def _anonymous(joint: AbstractPlacedJoint) -> AbstractPlacedJoint:
    """The joint between the bodies `FIRST` and `SECOND`, with the joints that it carries along."""
    renamed = copy.copy(joint)
    object.__setattr__(renamed, "bodies", (FIRST, SECOND))
    for field in dataclasses.fields(joint):
        inner = getattr(joint, field.name)
        if isinstance(inner, AbstractPlacedJoint):
            object.__setattr__(renamed, field.name, _anonymous(inner))
    return renamed

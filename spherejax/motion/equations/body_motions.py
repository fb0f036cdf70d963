"""Motions of all bodies, as arrays and by name."""

from collections.abc import Iterator, Mapping, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.lanes import over_lanes, rows_at
from spherejax.model.groups import FIRST, SECOND
from spherejax.physics.bodies import GROUND
from spherejax.physics.kinematics import BodyMotion, body_motion, ground_motion
from spherejax.physics.state import State


class BodyMotions(Mapping[str, BodyMotion]):
    """Motion of each body by name, the ground first.

    Attributes:
        stacked: the same with a leading axis of bodies.
    """

    def __init__(self, names: Sequence[str], moving: BodyMotion):
        """The ground, and the moving bodies of these names, with a leading axis of bodies."""
        self._numbers = {name: i for i, name in enumerate((GROUND, *names))}
        self.moving = moving
        self.stacked = jax.tree.map(lambda one, all: jnp.concatenate([one[None], all]), ground_motion(), moving)

    def __getitem__(self, name: str) -> BodyMotion:
        number = self._numbers[name]
        return jax.tree.map(lambda x: x[number], self.stacked)

    def __iter__(self) -> Iterator[str]:
        return iter(self._numbers)

    def __len__(self) -> int:
        return len(self._numbers)

    def at(self, numbers: Sequence[int]) -> BodyMotion:
        """Motions of the bodies of these numbers (0: the ground), with a leading axis."""
        return jax.tree.map(lambda x: rows_at(x, numbers), self.stacked)

    def of_ends(self, group) -> tuple[BodyMotion, BodyMotion]:
        """Motions of the first and second bodies of a group of joints."""
        return self.at(group.first), self.at(group.second)


def between(first: BodyMotion, second: BodyMotion) -> dict[str, BodyMotion]:
    """The motions that a joint which stands for its kind asks for."""
    return {FIRST: first, SECOND: second}


def body_motions(system, state: State) -> BodyMotions:
    """Motion of each body by name, the ground included."""
    moving = over_lanes(body_motion, state.position, state.quaternion, state.velocity, state.angular_velocity)
    return BodyMotions(tuple(system.bodies), moving)


def with_ground(vectors: Float[Array, "b ..."]) -> Float[Array, "b+1 ..."]:
    """Vectors of the moving bodies, and before them that of the ground: zero."""
    return jnp.concatenate([jnp.zeros((1, *vectors.shape[1:])), vectors])

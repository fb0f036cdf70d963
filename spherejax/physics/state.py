"""The state as a flat vector and as names: positions, orientations, velocities, and the joints' memory.

Layout of the flat vector y: for each body center of mass (3) and quaternion (4); then for each body velocity (3)
and angular velocity (3); then the memory of the joints that have one; then, where asked for, the work that each
joint has absorbed; the work of the constraint forces, where parts dissipate; and last the work that parts which may add
energy have put in. Memory and work are empty where no law or part needs them.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

POSITION_SIZE = 7
VELOCITY_SIZE = 6


class Layout(NamedTuple):
    """Where things are in the flat state (static).

    Attributes:
        n_bodies: number of moving bodies.
        n_memory: number of memory entries.
        n_work: number of work entries.
    """

    n_bodies: int
    n_memory: int = 0
    n_work: int = 0

    @property
    def n_position(self) -> int:
        """Number of position coordinates."""
        return POSITION_SIZE * self.n_bodies

    @property
    def n_velocity(self) -> int:
        """Number of velocity coordinates."""
        return VELOCITY_SIZE * self.n_bodies

    @property
    def memory_start(self) -> int:
        """Index of the first memory entry."""
        return self.n_position + self.n_velocity

    @property
    def work_start(self) -> int:
        """Index of the first work entry."""
        return self.memory_start + self.n_memory

    @property
    def size(self) -> int:
        """Length of the flat state."""
        return self.work_start + self.n_work

    def columns(self, name: str, body: int) -> tuple[int, int]:
        """Where the position, quaternion, velocity or angular velocity of a body begins, and where it ends."""
        first, last = {"position": (0, 3), "quaternion": (3, 7), "velocity": (0, 3), "angular_velocity": (3, 6)}[name]
        is_place = name in ("position", "quaternion")
        start = POSITION_SIZE * body if is_place else self.n_position + VELOCITY_SIZE * body
        return start + first, start + last


class State(NamedTuple):
    """The state by name; leading axes (samples, lanes) are allowed.

    Attributes:
        position: centers of mass, world axes [m], shape (..., n_bodies, 3).
        quaternion: unit quaternions, scalar first, shape (..., n_bodies, 4).
        velocity: of the centers of mass, world axes [m/s], shape (..., n_bodies, 3).
        angular_velocity: world axes [rad/s], shape (..., n_bodies, 3).
        memory: the joints' memory, shape (..., n_memory).
        work: work absorbed by each non-ideal joint [J], where asked for; the work of the constraint forces beyond that
            of drivers, where parts dissipate; the work put in by drivers and other parts that may add energy, where
            there are any; shape (..., n_work).
    """

    position: Float[Array, "*n b 3"]
    quaternion: Float[Array, "*n b 4"]
    velocity: Float[Array, "*n b 3"]
    angular_velocity: Float[Array, "*n b 3"]
    memory: Float[Array, "*n m"]
    work: Float[Array, "*n w"]


def unpack(layout: Layout, y: Float[Array, "*n size"]) -> State:
    """The flat state by name."""
    leading = y.shape[:-1]
    q = y[..., : layout.n_position].reshape(*leading, layout.n_bodies, POSITION_SIZE)
    v = y[..., layout.n_position : layout.memory_start].reshape(*leading, layout.n_bodies, VELOCITY_SIZE)
    memory = y[..., layout.memory_start : layout.work_start]
    return State(q[..., :3], q[..., 3:], v[..., :3], v[..., 3:], memory, y[..., layout.work_start :])


def pack(state: State) -> Float[Array, "*n size"]:
    """The named state as a flat vector."""
    leading = state.position.shape[:-2]
    q = jnp.concatenate([state.position, state.quaternion], -1).reshape(*leading, -1)
    v = jnp.concatenate([state.velocity, state.angular_velocity], -1).reshape(*leading, -1)
    return jnp.concatenate([q, v, state.memory, state.work], -1)

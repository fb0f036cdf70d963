"""Small changes of a flat state, and what lies between two states, in the coordinates of `linear.tangent`.

A change is a vector of displacements and rotations of the bodies, changes of their velocities, and of the memory, world
axes, of length 12 n + m. Rotations differ by the shorter turn, so that a wheel after a whole turn is where it was.
"""

import numpy as np
from jaxtyping import Float

from spherejax.physics.state import POSITION_SIZE, VELOCITY_SIZE, Layout

Flat = Float[np.ndarray, "*n size"]
Change = Float[np.ndarray, "*n n_z"]


def displaced(layout: Layout, y: Flat, change: Change) -> Flat:
    """The state after a change; rotations exactly."""
    y, n_v = np.array(y, float), layout.n_velocity
    steps = change[:n_v].reshape(-1, VELOCITY_SIZE)
    q = y[: layout.n_position].reshape(-1, POSITION_SIZE)
    q[:, :3] += steps[:, :3]
    angle = np.linalg.norm(steps[:, 3:], axis=1, keepdims=True)
    half = np.concatenate([np.cos(angle / 2), np.sinc(angle / (2 * np.pi)) / 2 * steps[:, 3:]], 1)
    q[:, 3:] = _product(half, q[:, 3:])
    y[layout.n_position : layout.work_start] += change[n_v:]
    return y


def between(layout: Layout, first: Flat, second: Flat) -> Change:
    """The change that leads from one state to others, shape (n_z,) or (n, n_z)."""
    second = np.asarray(second)
    q0, q1 = (_placed(layout, each) for each in (first, second))
    inverse = q0[..., 3:] * np.array([1.0, -1.0, -1.0, -1.0])
    turn = _product(q1[..., 3:], np.broadcast_to(inverse, q1[..., 3:].shape))
    turn = np.where(turn[..., :1] < 0, -turn, turn)
    sine = np.linalg.norm(turn[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, turn[..., :1])
    vector = np.where(sine > 1e-150, angle / np.where(sine > 1e-150, sine, 1.0), 2.0) * turn[..., 1:]
    moved = np.concatenate([q1[..., :3] - q0[..., :3], vector], -1).reshape(*second.shape[:-1], -1)
    rest = slice(layout.n_position, layout.work_start)
    return np.concatenate([moved, second[..., rest] - first[..., rest]], -1)


def slopes_of(layout: Layout, y: Flat, changes: Float[np.ndarray, "n_z k"]) -> Float[np.ndarray, "k size"]:
    """Derivatives of the flat state along changes, the columns; work is left out."""
    n_v = layout.n_velocity
    steps = changes[:n_v].T.reshape(-1, layout.n_bodies, VELOCITY_SIZE)
    p = y[: layout.n_position].reshape(-1, POSITION_SIZE)[:, 3:]
    turns = np.concatenate([np.zeros_like(steps[..., :1]), 0.5 * steps[..., 3:]], -1)
    q = np.concatenate([steps[..., :3], _product(turns, np.broadcast_to(p, turns.shape))], -1)
    rows = np.zeros((changes.shape[1], layout.size))
    rows[:, : layout.n_position] = q.reshape(len(rows), layout.n_position)
    rows[:, layout.n_position : layout.work_start] = changes[n_v:].T
    return rows


def changes_of(layout: Layout, y: Flat, slopes: Float[np.ndarray, "k size"]) -> Float[np.ndarray, "n_z k"]:
    """Changes, as columns, from derivatives of the flat state."""
    rates = slopes[:, : layout.n_position].reshape(-1, layout.n_bodies, POSITION_SIZE)
    p = y[: layout.n_position].reshape(-1, POSITION_SIZE)[:, 3:] * np.array([1.0, -1.0, -1.0, -1.0])
    turns = 2 * _product(rates[..., 3:], np.broadcast_to(p, rates[..., 3:].shape))[..., 1:]
    moved = np.concatenate([rates[..., :3], turns], -1).reshape(len(slopes), layout.n_velocity)
    return np.concatenate([moved, slopes[:, layout.n_position : layout.work_start]], 1).T


def _placed(layout: Layout, y: Flat) -> Float[np.ndarray, "*n b 7"]:
    return y[..., : layout.n_position].reshape(*y.shape[:-1], layout.n_bodies, POSITION_SIZE)


def _product(p: Float[np.ndarray, "*n 4"], q: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 4"]:
    """Of quaternions."""
    scalar = p[..., :1] * q[..., :1] - np.sum(p[..., 1:] * q[..., 1:], -1, keepdims=True)
    vector = p[..., :1] * q[..., 1:] + q[..., :1] * p[..., 1:] + np.cross(p[..., 1:], q[..., 1:])
    return np.concatenate([scalar, vector], -1)

"""How fast friction in ideal joints, and forces with states of their own, act: what an explicit method must follow.

With the velocities v and the bristles and other states z, a small change of both decays or vibrates with the
eigenvalues of the derivative of (v_dot, z_dot) by (v, z). It is looked at twice: at rest, where friction by the
velocity is as steep as it gets, and at the mechanism's usual speeds, where bristles forget within micrometers.
"""

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import concretely
from spherejax.foundations.types import Scalar
from spherejax.model.system import Structure, System
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.solvers.force_rates import Rates
from spherejax.motion.start.tolerances import length_scale, time_scale
from spherejax.physics.state import VELOCITY_SIZE

LARGEST_MATRIX = 200
"""Velocities and bristles up to which eigenvalues are looked for; larger systems run on array code, explicitly."""

OWN_SHARE = 0.25
"""Participation of a force element's states in a motion from which on that motion counts as theirs. In one that a
controller's filter and a body make together both have halves; what a film or a bristle damps has none."""


class StateRates(NamedTuple):
    """The fastest rates of velocities and states.

    Attributes:
        by_force: of the motions in which states of a force element take part, by its name.
        others: of all others, which joints and dampers make.
    """

    by_force: dict[str, Rates]
    others: Rates


def friction_rates(system: System, structure: Structure, theta: np.ndarray) -> StateRates:
    """The fastest decays and vibrations, at rest and in motion, where bodies are where the scene puts them."""
    names = [slot.joint for slot in system.force_slots]
    if system.layout.n_velocity + system.layout.n_memory > LARGEST_MATRIX:
        return StateRates({name: Rates(0.0, 0.0) for name in names}, Rates(0.0, 0.0))
    looks = [_rates_at(structure, theta.tobytes(), is_moving) for is_moving in (False, True)]
    rates = [Rates(*(float(x) for x in np.max(both, axis=0))) for both in zip(*looks, strict=True)]
    return StateRates(dict(zip(names, rates, strict=False)), rates[-1])


@lru_cache(maxsize=1024)
def _rates_at(structure: Structure, numbers: bytes, is_moving: bool) -> list[Rates]:
    theta = np.frombuffer(numbers)
    system = structure.system(theta)
    layout = system.layout
    places = [[*np.asarray(body.position), *np.asarray(body.quaternion)] for body in system.bodies.values()]
    y = np.zeros(layout.size)
    y[: layout.n_position] = np.concatenate(places)
    if is_moving:
        spin = 1 / float(time_scale(system))
        speed = spin * float(length_scale(system))
        directions = np.random.default_rng(0).normal(size=(layout.n_bodies, VELOCITY_SIZE))
        y[layout.n_position : layout.memory_start] = (directions * ([speed] * 3 + [spin] * 3)).ravel()
    n = layout.n_velocity + layout.n_memory
    program = program_for(change_of_rates, structure, None, (layout.size, n), is_quiet=True)
    compiled = jax.jit(program) if program.scalar is None else None

    def column(direction):
        if compiled is None:
            return program.compute(theta, 0.0, (y, direction))
        return concretely(compiled, theta, 0.0, (y, direction))

    matrix = np.nan_to_num(np.stack([np.asarray(column(direction)) for direction in np.eye(n)], 1))
    eigenvalues, shares = eigenvalues_and_participation(matrix)
    start = layout.n_velocity
    owner = np.full(n, len(system.force_slots))
    for i, slot in enumerate(system.force_slots):
        entries = slice(start + slot.entries.start, start + slot.entries.stop)
        owner[np.sum(shares[entries], axis=0) >= OWN_SHARE] = i
    return [_fastest(eigenvalues[owner == i]) for i in range(len(system.force_slots) + 1)]


def eigenvalues_and_participation(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues of a matrix, and how much each state (row) takes part in the motion of each (column).

    The participation is |l_k r_k| of left and right eigenvectors, over its sum. Limits: of a matrix without a full set
    of eigenvectors it is that of the least-squares inverse.

    Source: Perez-Arriaga, Verghese and Schweppe (1982), IEEE Trans. PAS-101, Eq. 11.
    """
    values, right = np.linalg.eig(matrix)
    shares = np.abs(right * np.linalg.pinv(right).T)
    return values, shares / np.maximum(np.sum(shares, axis=0), np.finfo(float).tiny)


def _fastest(eigenvalues: np.ndarray) -> Rates:
    decay, frequency = np.max(-np.real(eigenvalues), initial=0.0), np.max(np.abs(np.imag(eigenvalues)), initial=0.0)
    return Rates(float(decay), float(frequency))


def change_of_rates(system: System, t: Scalar, point) -> Float[Array, " n"]:
    """Change of the rates of velocities and memory along a direction of both."""
    y, direction = point
    layout = system.layout
    entries = slice(layout.n_position, layout.work_start)

    def rates(y):
        return state_rate(system, t, y)[entries]

    along = jnp.concatenate([jnp.zeros(layout.n_position), direction, jnp.zeros(layout.size - layout.work_start)])
    return jax.jvp(rates, (y,), (along,))[1]

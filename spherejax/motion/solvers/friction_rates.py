"""How fast friction in ideal joints, and forces with states of their own, act: what an explicit method must follow.

With the velocities v and the bristles and other states z, a small change of both decays or vibrates with the
eigenvalues of the derivative of (v_dot, z_dot) by (v, z). It is looked at twice: at rest, where friction by the
velocity is as steep as it gets, and at the mechanism's usual speeds, where bristles forget within micrometers.
"""

from functools import lru_cache

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


def friction_rates(system: System, structure: Structure, theta: np.ndarray) -> Rates:
    """The fastest decay and vibration, at rest and in motion, where bodies are where the scene puts them."""
    if system.layout.n_velocity + system.layout.n_memory > LARGEST_MATRIX:
        return Rates(0.0, 0.0)
    found = [_rates_at(structure, theta.tobytes(), is_moving) for is_moving in (False, True)]
    return Rates(max(each.decay for each in found), max(each.frequency for each in found))


@lru_cache(maxsize=1024)
def _rates_at(structure: Structure, numbers: bytes, is_moving: bool) -> Rates:
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
    found = np.linalg.eigvals(matrix)
    return Rates(float(np.max(-found.real, initial=0.0)), float(np.max(np.abs(found.imag), initial=0.0)))


def change_of_rates(system: System, t: Scalar, point) -> Float[Array, " n"]:
    """Change of the rates of velocities and memory along a direction of both."""
    y, direction = point
    layout = system.layout
    entries = slice(layout.n_position, layout.work_start)

    def rates(y):
        return state_rate(system, t, y)[entries]

    along = jnp.concatenate([jnp.zeros(layout.n_position), direction, jnp.zeros(layout.size - layout.work_start)])
    return jax.jvp(rates, (y,), (along,))[1]

"""How fast friction in ideal joints acts on the bodies: what an explicit method's steps must follow.

With the velocities v and the bristles z, a small change of both at rest decays or vibrates with the eigenvalues of the
derivative of (v_dot, z_dot) by (v, z): at rest friction is as steep as it gets.
"""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import concretely
from spherejax.foundations.types import Scalar
from spherejax.model.system import Structure, System
from spherejax.motion.dynamics import state_rate
from spherejax.motion.programs import program_for
from spherejax.motion.solvers.force_rates import Rates

LARGEST_MATRIX = 200
"""Velocities and bristles up to which eigenvalues are looked for; larger systems run on array code, explicitly."""


def friction_rates(system: System, structure: Structure, theta: np.ndarray) -> Rates:
    """The fastest decay and vibration at the start, at rest, where bodies are where the scene puts them."""
    if system.layout.n_velocity + system.layout.n_memory > LARGEST_MATRIX:
        return Rates(0.0, 0.0)
    return _rates_at(structure, theta.tobytes())


@lru_cache(maxsize=1024)
def _rates_at(structure: Structure, numbers: bytes) -> Rates:
    theta = np.frombuffer(numbers)
    system = structure.system(theta)
    layout = system.layout
    places = [[*np.asarray(body.position), *np.asarray(body.quaternion)] for body in system.bodies.values()]
    y = np.zeros(layout.size)
    y[: layout.n_position] = np.concatenate(places)
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

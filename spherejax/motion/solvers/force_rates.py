"""How fast force elements act on the bodies: what an explicit method's steps must follow.

With the accelerations a that the elements cause, constraints obeyed, the largest eigenvalue of -da/dv is the fastest
decay and the root of that of -da/dq the fastest vibration. Both are found by power iteration with products, so that the
cost grows with the size of the system as that of its equations does.
"""

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import concretely
from spherejax.foundations.rotation import quaternion_rate
from spherejax.foundations.types import Scalar
from spherejax.model.system import Structure, System
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import constraint_set, inverse_masses, solve_augmented
from spherejax.motion.equations.programs import program_for
from spherejax.physics.state import VELOCITY_SIZE, unpack

N_PRODUCTS = 12
"""Products of the power iteration: the estimate is from below, and within a tenth unless many elements are alike."""


LITTLE_DAMPING = 0.02
"""Ratio of decay to frequency (twice the damping ratio) below which a vibration is there to stay."""


class Rates(NamedTuple):
    """The fastest rates of the force elements at the start.

    Attributes:
        decay: [1/s].
        frequency: [rad/s].
    """

    decay: float
    frequency: float

    @property
    def fastest(self) -> float:
        """The rate that an explicit method must follow and a stiff one need not.

        A vibration without damping goes on for ever, and any method has to follow it: it does not count.
        """
        return max(self.decay, self.frequency if self.decay > LITTLE_DAMPING * self.frequency else 0.0)


def force_rates(system: System, structure: Structure, theta: np.ndarray, constrained: bool = True) -> Rates:
    """The fastest decay and vibration by force elements at the start, where bodies are where the scene puts them.

    Elements that do not act there, such as a stop that is not reached, are not seen.

    Args:
        system: the system.
        structure: its structure.
        theta: its numbers.
        constrained: obey the constraints. Without them rates are higher, and found at once in a large system.
    """
    places = [[*np.asarray(body.position), *np.asarray(body.quaternion)] for body in system.bodies.values()]
    y = np.zeros(system.layout.size)
    y[: system.layout.n_position] = np.concatenate(places)
    return _rates_at(structure, theta.tobytes(), y.tobytes(), caused_changes if constrained else free_changes)


@lru_cache(maxsize=1024)
def _rates_at(structure: Structure, numbers: bytes, start: bytes, changes) -> Rates:
    theta, y = np.frombuffer(numbers), np.frombuffer(start)
    n_v = jax.eval_shape(structure.system, jax.ShapeDtypeStruct(theta.shape, jnp.float64)).layout.n_velocity
    # Quiet: of a law without a scalar program one is warned where the motion is integrated, or the user knows.
    program = program_for(changes, structure, None, (len(y), n_v), is_quiet=True)
    compiled = jax.jit(program) if program.scalar is None else None

    def products(x):
        if compiled is None:
            return program.compute(theta, 0.0, (y, x))
        return concretely(compiled, theta, 0.0, (y, x))

    decay, square = (_largest(lambda x, k=k: np.asarray(products(x)[k]), n_v) for k in (0, 1))
    return Rates(decay, float(np.sqrt(square)))


def _largest(product, n: int) -> float:
    """Magnitude of the largest eigenvalue, by power iteration."""
    x = np.random.default_rng(0).normal(size=n)
    size = 0.0
    for _ in range(N_PRODUCTS):
        x = product(x / np.linalg.norm(x))
        size = float(np.linalg.norm(x))
        if not 0 < size < np.inf:
            break
    return float(np.nan_to_num(size, nan=np.inf))


Point = tuple[Float[Array, " size"], Float[Array, " n_v"]]
"""Flat state, and a direction: displacement and rotation, or their rates, of each body."""


def caused_changes(system: System, t: Scalar, point: Point) -> tuple[Float[Array, " n_v"], Float[Array, " n_v"]]:
    """Changes of the accelerations by force elements along a direction of the velocities, and of the positions."""
    motions = body_motions(system, unpack(system.layout, point[0]))
    constraints, masses = constraint_set(system, t, motions), inverse_masses(system, motions)

    def accelerations(loads):
        found = solve_augmented(constraints, masses, _stacked(loads), jnp.zeros_like(constraints.bias))
        return found.accelerations.ravel()

    by_velocity, by_position = _load_changes(system, t, point)
    return accelerations(by_velocity), accelerations(by_position)


def free_changes(system: System, t: Scalar, point: Point) -> tuple[Float[Array, " n_v"], Float[Array, " n_v"]]:
    """As `caused_changes`, without constraints."""
    masses = inverse_masses(system, body_motions(system, unpack(system.layout, point[0])))

    def accelerations(loads):
        return masses.times(_stacked(loads)).ravel()

    by_velocity, by_position = _load_changes(system, t, point)
    return accelerations(by_velocity), accelerations(by_position)


def _load_changes(system: System, t: Scalar, point: Point):
    """Changes of the loads by force elements, by body, along a direction of the velocities, and of the positions."""
    y, direction = point
    layout, state = system.layout, unpack(system.layout, y)
    rest = jnp.zeros(layout.size - layout.memory_start)
    by_body = direction.reshape(-1, VELOCITY_SIZE)
    moved = [
        jnp.concatenate([part[:3], quaternion_rate(state.quaternion[i], part[3:])]) for i, part in enumerate(by_body)
    ]
    faster = jnp.concatenate([jnp.zeros(layout.n_position), direction, rest])
    further = jnp.concatenate([*moved, jnp.zeros(layout.n_velocity), rest])

    def loads(y):
        state = unpack(layout, y)
        motions = body_motions(system, state)
        total = {name: jnp.zeros(VELOCITY_SIZE) for name in system.bodies}
        for force in system.forces_with(state.memory).values():
            for name, wrench in force.wrenches(t, motions).items():
                if name in total:
                    total[name] = total[name] + jnp.concatenate([wrench.force, wrench.moment])
        return total

    return tuple(jax.jvp(loads, (y,), (change,))[1] for change in (faster, further))


def _stacked(loads):
    return jnp.stack(list(loads.values()))

"""How the numbers of a system and the state about which it is linearized follow a number of the scene.

A start is assembled: bodies keep to where they are described, and yield to the constraints by the least change in the
metric of the masses. With the number p and least = M^-1 D^T (D M^-1 D^T)^+ of the constraints that a start keeps to,

    dq = dq_described - least (D dq_described + Phi_p),  dv = dv_described - least (N dq + D dv_described + Phi'_p).

A rest position yields to the constraints likewise, and then along the free directions P until no force is left,
P^T M (a_p + a_q dq) = 0. The state of a run is held.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.model.numbers import Number
from spherejax.model.scene import Scene
from spherejax.model.system import System, compile_scene, flatten_system
from spherejax.motion.integration.problem import initial_state
from spherejax.motion.start.assembly import as_ideal, assemble, described_state
from spherejax.motion.start.equilibrium import SINGULAR, resting_at
from spherejax.motion.start.start_now import known_start
from spherejax.studies.linear.coordinates import coordinates_of
from spherejax.studies.linear.point import OperatingPoint
from spherejax.studies.linear.tangent import TangentEquations, moved

AS_DESCRIBED = 1e-8
"""A start whose constraints are described to this [m or 1] yields to them as the formula says; one that is moved
further is assembled again, with derivatives."""

Slopes = tuple[Float[np.ndarray, " p"], Float[np.ndarray, " size"]]


def slopes_of(point: OperatingPoint, number: Number) -> Slopes:
    """Derivatives of the flat numbers of the system and of the flat state by a number."""
    if point.origin == "start":
        return _of_start(point, number)
    if point.origin == "rest":
        return _of_rest(point, number)
    return theta_slope(point, number), np.zeros_like(point.y)


def theta_slope(point: OperatingPoint, number: Number) -> Float[np.ndarray, " p"]:
    """Derivative of the flat numbers of the system by a number."""

    def theta(value):
        return jnp.asarray(flatten_system(_system_of(point, number.changed(point.whole, value)))[1])

    return _slope(theta, number.value(point.whole))


def _system_of(point: OperatingPoint, whole: Any) -> System:
    """The system of a scene that is changed, its bodies at rest where the point's are."""
    if not isinstance(whole, Scene):
        return whole
    if point.origin == "rest":
        whole = resting_at(whole, point.system, jnp.asarray(point.y))
    return compile_scene(whole).system


def _slope(function, value: float) -> np.ndarray:
    return np.asarray(jax.jvp(function, (jnp.asarray(value),), (jnp.asarray(1.0),))[1])


def _of_rest(point: OperatingPoint, number: Number) -> Slopes:
    equations, theta = point.equations, theta_slope(point, number)
    found, n_v = equations.geometry, point.system.layout.n_velocity
    at = coordinates_of(found, point.system.layout.n_memory)
    rates, _, held = (each[..., 0] for each in equations.by_numbers((), theta[:, None]))
    dq, dv = yielding(found, at.least, held, np.zeros(n_v), np.zeros(n_v))
    change = np.concatenate([dq, dv, np.zeros(at.n_memory)])
    free = at.basis[:, : at.degrees_of_freedom]
    slopes = equations.rates_along(np.zeros(3), np.concatenate([free, change[:, None]], 1))
    forces = at.free.T @ at.mass @ np.concatenate([slopes, rates[:, None]], 1)[n_v : 2 * n_v]
    yields = -np.linalg.pinv(forces[:, :-2], rcond=SINGULAR) @ (forces[:, -2] + forces[:, -1])
    return theta, _state_slope(point, change + free @ yields)


def _of_start(point: OperatingPoint, number: Number) -> Slopes:
    theta = theta_slope(point, number)
    start = known_start(point.system, np.array([point.t]))
    as_described = start is not None and float(start.assembly.residual_before) < AS_DESCRIBED
    if not as_described or np.any(point.y[point.system.layout.memory_start :]):
        return theta, _assembled(point, number)
    structure, ideal = flatten_system(as_ideal(point.system))

    def described(value):
        system = as_ideal(_system_of(point, number.changed(point.whole, value)))
        return jnp.concatenate([jnp.asarray(flatten_system(system)[1]), described_state(system)])

    slope, described_slope = np.split(_slope(described, number.value(point.whole)), [ideal.size])
    equations = TangentEquations(structure, ideal, point.t, point.y[: point.system.layout.memory_start])
    found = equations.geometry
    least = coordinates_of(found, 0).least
    held = equations.by_numbers((), slope[:, None])[2][..., 0]
    dq, dv = yielding(found, least, held, *_change_of(point, described_slope))
    return theta, _state_slope(point, np.concatenate([dq, dv, np.zeros(point.system.layout.n_memory)]))


def yielding(found, least, held, dq, dv) -> tuple[np.ndarray, np.ndarray]:
    """Changes of positions and velocities that keep to the constraints when these change."""
    by_number, rate_by_number = np.split(held, 2)
    dq = dq - least @ (found.by_position @ dq + by_number)
    return dq, dv - least @ (found.rate_by_position @ dq + found.by_position @ dv + rate_by_number)


def _change_of(point: OperatingPoint, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacements and turns, and changes of velocities, from a change of the flat state."""
    layout = point.system.layout
    rates = slope[: layout.n_position].reshape(-1, 7)
    p = point.y[: layout.n_position].reshape(-1, 7)[:, 3:]
    # The turn of a change dp is 2 dp p*, its vector part.
    turn = 2 * (p[:, :1] * rates[:, 4:] - rates[:, 3:4] * p[:, 1:] - np.cross(rates[:, 4:], p[:, 1:]))
    return np.concatenate([rates[:, :3], turn], 1).ravel(), slope[layout.n_position : layout.memory_start]


def _state_slope(point: OperatingPoint, change: np.ndarray) -> Float[np.ndarray, " size"]:
    layout, y = point.system.layout, jnp.asarray(point.y)
    along = jnp.asarray(change)
    return np.asarray(jax.jvp(lambda step: moved(layout, y, step), (jnp.zeros_like(along),), (along,))[1])


def _assembled(point: OperatingPoint, number: Number) -> Float[np.ndarray, " size"]:
    """Through the assembly of the start. Compiled: it is thousands of operations."""

    def start(value):
        system = _system_of(point, number.changed(point.whole, value))
        return initial_state(system, assemble(*flatten_system(as_ideal(system)), point.t), point.t)

    def slope(value):
        return jax.jvp(start, (value,), (jnp.ones_like(value),))[1]

    return np.asarray(jax.jit(slope)(jnp.asarray(number.value(point.whole))))

"""References for linearizations: central differences of the constrained flow, and states to take them at."""

from dataclasses import replace

import cases
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from scipy.spatial.transform import Rotation

import spherejax as sj
from spherejax.foundations.rotation import conjugate, quaternion_product, rotation_vector
from spherejax.model.system import flatten_system
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.equations.projection import corrected
from spherejax.motion.start.start_now import start_now
from spherejax.physics.state import unpack
from spherejax.studies.linear.coordinates import coordinates_of
from spherejax.studies.linear.tangent import TangentEquations


def moment(scene: sj.Scene, *, seed: int = 0, distance: float = 1e-3) -> sj.Trajectory:
    """A run of one sample, at a state that is displaced, moves, and keeps to the constraints."""
    system = sj.equations.compile_scene(scene).system
    structure, theta = flatten_system(system)
    start = start_now(system, np.zeros(1))
    y = cases.displaced_state(system, start, seed, distance)
    y = closed(structure, theta, 0.0, y)
    run = a_run()
    return replace(run, ts=jnp.zeros(1), ys=jnp.asarray(y)[None], system=system)


def a_run() -> sj.Trajectory:
    body = sj.Body(1.0, (1.0, 1.0, 1.0))
    return sj.simulate(sj.Scene({"body": body}), jnp.array([0.0, 1e-3]))


def closed(structure, theta, t, y):
    """Onto the constraints, by Newton steps."""
    correct = program_for(corrected, structure, is_quiet=True)
    for _ in range(6):
        y = np.asarray(correct.compute(theta, t, y))
    return y


def displaced(layout, y, change):
    """The state after a change, with SciPy's rotations."""
    y, n_v = np.array(y, float), layout.n_velocity
    q = y[: layout.n_position].reshape(-1, 7)
    steps = change[:n_v].reshape(-1, 6)
    q[:, :3] += steps[:, :3]
    turned = Rotation.from_rotvec(steps[:, 3:]) * Rotation.from_quat(q[:, 3:], scalar_first=True)
    q[:, 3:] = turned.as_quat(scalar_first=True)
    y[layout.n_position : layout.work_start] += change[n_v:]
    return y


def deviation_rate(layout, y, rate, y0, rate0):
    """Rate of the deviation of one state from another: of its rotations by their quaternions, whatever the chart is."""
    here, there, here_rate, there_rate = (unpack(layout, jnp.asarray(each)) for each in (y, y0, rate, rate0))

    def turn(p, p0):
        return rotation_vector(quaternion_product(p, conjugate(p0)))

    found = []
    for i in range(layout.n_bodies):
        p, dp = here.quaternion[i], here_rate.quaternion[i]
        p0, dp0 = there.quaternion[i], there_rate.quaternion[i]
        found += [here_rate.position[i] - there_rate.position[i], jax.jvp(turn, (p, p0), (dp, dp0))[1]]
    rest = np.asarray(rate - rate0)[layout.n_position : layout.work_start]
    return np.concatenate([np.concatenate(found), rest])


def by_differences(lin: sj.studies.Linearization, step: float) -> np.ndarray:
    """A by central differences of fourth order of the flow: states are moved, closed again, and let go."""
    point, layout = lin.point, lin.point.system.layout
    rate = program_for(state_rate, point.structure, is_quiet=True)
    f0 = np.asarray(rate.compute(point.theta, point.t, point.y))
    n_v = layout.n_velocity
    # A step of 1e-5 m is one of 1 mm/s, and of 0.1 um for bristles, which bend by micrometers.
    weights = np.concatenate([np.ones(n_v), 1e-2 * np.ones(n_v), 1e2 * np.ones(layout.n_memory)])
    columns = []
    for direction in lin.basis.T:
        size = step / np.max(np.abs(direction) * weights)
        slopes = []
        for h in (size, 2 * size):
            found = []
            for sign in (1, -1):
                y = displaced(layout, point.y, sign * h * direction)
                y = closed(point.structure, point.theta, point.t, y)
                f = np.asarray(rate.compute(point.theta, point.t, y))
                found.append(deviation_rate(layout, y, f, point.y, f0))
            slopes.append((found[0] - found[1]) / (2 * h))
        columns.append(lin.inverse @ (4 * slopes[0] - slopes[1]) / 3)
    return np.stack(columns, 1) - lin.inverse @ basis_rate(lin, f0)[:, lin.kept]


def basis_rate(lin: sj.studies.Linearization, f0, step: float = 1e-5) -> np.ndarray:
    """How the basis follows the motion: found anew at both sides, and laid as close to the one between as can be."""
    point, layout, here = lin.point, lin.point.system.layout, lin.coordinates
    state, rate = unpack(layout, point.y), unpack(layout, f0)
    motion = np.concatenate([state.velocity, state.angular_velocity], 1).ravel()
    change = np.concatenate([motion, np.ravel(np.concatenate([rate.velocity, rate.angular_velocity], 1)), rate.memory])
    found = []
    for h in (step, -step, 2 * step, -2 * step):
        y = closed(point.structure, point.theta, point.t + h, displaced(layout, point.y, h * change))
        there = coordinates_of(TangentEquations(point.structure, point.theta, point.t + h, y).geometry, layout.n_memory)
        turn = scipy.linalg.polar(there.free.T @ (here.mass + there.mass) / 2 @ here.free)[0]
        found.append(there.basis @ scipy.linalg.block_diag(turn, turn, np.eye(layout.n_memory)))
    near, far = (found[0] - found[1]) / (2 * step), (found[2] - found[3]) / (4 * step)
    return (4 * near - far) / 3

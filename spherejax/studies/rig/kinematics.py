"""Positions of a corner with ideal joints, along a path of travel and steer, and what is read off them.

From one point of the path to the next in parts, each closed by Newton's method (`motion/start/assembly.py`); what
closes no more, or in another branch, has not been reached, and the next point is tried from the last good one.

Derivatives: at a position two more steps of Newton's method are made whose derivatives are followed. A step squares the
error, so that derivatives of the position up to the third are exact, of which the characteristics themselves take one.
"""

from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.types import Scalar
from spherejax.model.system import Structure, System, example_of, flatten_system
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import constraint_set, inverse_masses, mobility_of, solved
from spherejax.motion.equations.loads import applied_wrenches
from spherejax.motion.equations.programs import Program, program_for
from spherejax.motion.start.assembly import as_ideal, assemble_now, described_state, newton_step
from spherejax.physics.state import POSITION_SIZE, VELOCITY_SIZE, Layout, State, unpack
from spherejax.studies.rig.bench import N_INPUTS, PLATFORM, moved, platform_of, with_inputs
from spherejax.studies.rig.characteristics import Holding, RigCurves, curves_of

N_NEWTON = 5
"""Newton steps for a part of the path: a part of a fiftieth of the mechanism is closed to rounding by three to four."""

N_FOLLOWED = 2
"""Newton steps whose derivatives are followed."""

ROUNDING = 1e-14
"""A residual [m or 1] from which another Newton step leads to rounding."""

CLOSED = 1e-7
"""Largest residual [m or 1] from which the last Newton step, which squares it, leads to a closed position."""

LARGEST_TURN = 0.35
"""Angle [rad] by which no body turns within a part of the path: what turns further has closed in another branch."""


class Reach(NamedTuple):
    """Positions along a path.

    Attributes:
        y: flat states, shape (n, size).
        is_reached: whether the joints close there, on a way without a jump.
    """

    y: Any
    is_reached: Any


class RigPrograms:
    """The functions of a system with ideal joints that the rig calls."""

    def __init__(self, structure: Structure):
        self.structure = structure
        self.layout = example_of(structure).layout
        self._close = program_for(rig_closing, structure, y_size=(self.layout.size, N_INPUTS))

    @cached_property
    def _read(self) -> Program:
        return program_for(rig_reading, self.structure, y_size=(self.layout.size, N_INPUTS))

    def closed(self, theta, y, inputs) -> tuple[Any, Any]:
        """The state after a Newton step, and the largest residual before it."""
        return self._close(theta, 0.0, (y, inputs))

    def read(self, theta, y, inputs) -> "Reading":
        """The characteristics at a position."""
        return self._read(theta, 0.0, (y, inputs))

    def closed_now(self, theta, y, inputs) -> tuple[Any, Any]:
        """As `closed`, for known numbers, without compiling."""
        return self._close.compute(theta, 0.0, (y, inputs))

    def read_now(self, theta, y, inputs) -> "Reading":
        """As `read`, for known numbers, without compiling."""
        return self._read.compute(theta, 0.0, (y, inputs))


def rig_closing(system: System, t: Scalar, numbers) -> tuple[Float[Array, " n"], Scalar]:
    """A Newton step, and the largest residual before it."""
    y, inputs = numbers
    system = with_inputs(system, inputs)
    residual = constraint_set(system, t, body_motions(system, unpack(system.layout, y))).residual
    return newton_step(system, t, y), jnp.max(jnp.abs(residual))


class Reading(NamedTuple):
    """What the rig reads at a position of ideal joints.

    Attributes:
        curves: the characteristics.
        loose: as of `Statics`.
    """

    curves: RigCurves
    loose: Scalar


def rig_reading(system: System, t: Scalar, numbers) -> Reading:
    """Characteristics, from one evaluation of the constraints.

    With v, the derivative of the bodies' places by travel (D v = 1 in the platform's row), the applied wrenches g and
    the multipliers lambda that hold them, virtual work gives wheel load and wheel rate:

        F = -g . v,    dF/dtravel = -(dg/dtravel . v + lambda . gamma(v))

    where gamma is the bias of the constraints for velocities v: D (dv/dtravel) = gamma, and g = D^T lambda.
    """
    y, inputs = numbers
    system = with_inputs(system, inputs)
    corner, state = platform_of(system).corner, unpack(system.layout, y)
    motions = body_motions(system, state)
    constraints = constraint_set(system, t, motions)
    masses = inverse_masses(system, motions)
    mobility = mobility_of(constraints, masses)

    def by(joint: str):
        """Derivatives of the bodies' places by what a joint prescribes: D v = 1 in its row, 0 in all others."""
        rows = {name: jnp.zeros_like(each.residual) for name, each in constraints.rows.items()}
        asked = jnp.concatenate(list((rows | {joint: jnp.ones_like(rows[joint])}).values()))
        return masses.times(constraints.transposed_times(solved(constraints, mobility, asked, system.smallest_pivot)))

    by_travel = by(PLATFORM)
    by_steer = jnp.zeros_like(by_travel) if corner.steering is None else by(corner.steering)
    statics = statics_of(system, t, state)
    wrenches, change = jax.jvp(partial(_applied, system, t, state), (jnp.zeros_like(by_travel),), (by_travel,))
    moving = state._replace(velocity=by_travel[:, :3], angular_velocity=by_travel[:, 3:])
    bias = constraint_set(system, t, body_motions(system, moving)).bias
    effort = None if corner.steering is None else -jnp.sum(wrenches * by_steer)
    holding = Holding(-jnp.sum(wrenches * by_travel), effort)
    rate = -(jnp.sum(change * by_travel) + statics.multipliers @ bias)
    curves = curves_of(system, state, jnp.stack([by_travel, by_steer]), holding, rate)
    return Reading(curves, statics.loose)


class Statics(NamedTuple):
    """What ideal joints hold at rest.

    Attributes:
        multipliers: of the joints, in the order of the equations.
        loose: square of the accelerations that remain, as a share of those of the applied loads: what nothing holds.
    """

    multipliers: Float[Array, " m"]
    loose: Scalar


def statics_of(system: System, t: Scalar, state: State) -> Statics:
    """The multipliers with g = D^T lambda, where the joints hold everything."""
    motions = body_motions(system, state)
    constraints = constraint_set(system, t, motions)
    masses = inverse_masses(system, motions)
    free = masses.times(applied_wrenches(system, t, motions, state.memory, None))
    mobility = mobility_of(constraints, masses)
    multipliers = solved(constraints, mobility, constraints.times(free), system.smallest_pivot)
    left = free - masses.times(constraints.transposed_times(multipliers))
    size = jnp.sum(free[:, :3] ** 2)
    return Statics(multipliers, jnp.sum(left[:, :3] ** 2) / jnp.where(size > 0, size, 1.0))


def _applied(system: System, t: Scalar, state: State, step: Float[Array, "b 6"]) -> Float[Array, "b 6"]:
    """What acts on the bodies after small motions of them."""
    position, quaternion = moved(state.position, state.quaternion, step)
    there = body_motions(system, state._replace(position=position, quaternion=quaternion))
    return applied_wrenches(system, t, there, state.memory, None)


def along_path(programs: RigPrograms, theta: Array, path: Float[Array, "m 6"], ends: tuple[int, ...]) -> Reach:
    """Positions along a path from the design position, for traced numbers.

    Args:
        programs: of the system with ideal joints.
        theta: its numbers.
        path: travel, steer and loads, part after part.
        ends: the parts whose ends are wanted.
    """

    def part(start, inputs):
        def newton(_, found):
            return programs.closed(theta, found[0], inputs)

        y, residual = jax.lax.fori_loop(0, N_NEWTON, newton, (start, jnp.zeros(())))
        good = (residual < CLOSED) & (_turn(programs.layout, start, y) < LARGEST_TURN)
        y = jnp.where(good, y, start)
        return y, (y, good)

    described = described_state(programs.structure.system(theta))
    start, closes = part(described, jnp.zeros(N_INPUTS))
    _, (ys, reached) = jax.lax.scan(part, start, path)
    at = np.asarray(ends)
    return Reach(ys[at], reached[at] & closes[1])


def along_path_now(
    programs: RigPrograms, theta: np.ndarray, path: Float[np.ndarray, "m 6"], ends: tuple[int, ...]
) -> Reach:
    """The same for known numbers, at once, without compiling anything.

    Raises:
        SceneError: where the joints do not close at the design position, naming the joint that gapes most.
    """
    start = _closed_now(programs, theta, described_state_now(programs.structure, theta), np.zeros(N_INPUTS))
    if start is None:
        # The usual assembly fails likewise, and says where.
        structure, numbers = flatten_system(as_ideal(programs.structure.system(theta)))
        start = np.asarray(assemble_now(structure, numbers).y)
    ys, reached = [], []
    for inputs in path:
        end = _closed_now(programs, theta, start, inputs)
        good = end is not None and bool(_turn(programs.layout, start, end, np) < LARGEST_TURN)
        start = end if good else start
        ys.append(start)
        reached.append(good)
    at = np.asarray(ends)
    return Reach(np.array(ys)[at], np.array(reached)[at])


def _closed_now(programs: RigPrograms, theta: np.ndarray, y: Any, inputs: Any) -> Any:
    """The closed position near a state; None where there is none."""
    residual = np.inf
    for _ in range(N_NEWTON):
        y, residual = programs.closed_now(theta, y, inputs)
        if residual < ROUNDING:
            break
    return y if residual < CLOSED else None


def described_state_now(structure: Structure, theta: np.ndarray) -> np.ndarray:
    """As `described_state`, for known numbers."""
    bodies = list(structure.system(theta).bodies.values())
    places = [np.concatenate([body.position, body.quaternion / np.linalg.norm(body.quaternion)]) for body in bodies]
    return np.concatenate([*places, np.zeros(VELOCITY_SIZE * len(bodies))])


def _turn(layout: Layout, first: Any, second: Any, xp: Any = jnp) -> Scalar:
    """The largest angle [rad] by which a body turns from one state to the other."""
    p, q = (y[: layout.n_position].reshape(-1, POSITION_SIZE)[:, 3:] for y in (first, second))
    return xp.max(2.0 * xp.arccos(xp.clip(xp.abs(xp.sum(p * q, -1)), 0.0, 1.0)))


def followed(programs: RigPrograms, theta: Array, y: Array, inputs: Array) -> Array:
    """A position whose derivatives by all numbers are those of the closed mechanism."""

    # Reverse mode keeps the state alone, not the thousands of numbers that a step's derivative needs: these are cheap,
    # and as arrays over all steps they would compile for minutes.
    @partial(jax.checkpoint, prevent_cse=False)
    def step(y, _):
        return programs.closed(theta, y, inputs)[0], None

    return jax.lax.scan(step, y, length=N_FOLLOWED)[0]

"""Static equilibrium: where a mechanism stays at rest under its weights and force elements.

At rest the equations of motion ask that the accelerations a(q) vanish on the constraints, Phi(q) = 0. Both are brought
to zero together by the method of Levenberg and Marquardt, from the start that the scene describes: a step is damped
until it helps, so that a far start does no harm, and directions in which nothing resists (an idle spin, a body on a
free hinge) are left as they are. Accelerations count as the lengths that they lead to in the time scale of the scene,
rotations as the lengths that they lead to at its size, so that nothing depends on units.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Quaternion, Scalar, Vector3
from spherejax.model.scene import Scene
from spherejax.model.system import Structure, System, compile_scene, flatten_system
from spherejax.motion.equations.dynamics import evaluate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.start.tolerances import length_scale, time_scale
from spherejax.physics.bodies import Body
from spherejax.physics.joints.joint import AbstractJoint
from spherejax.physics.state import POSITION_SIZE, VELOCITY_SIZE, Layout, unpack

N_STEPS = 60
"""Steps of the damped method; five to ten bring a suspension to rounding."""

FIRST_DAMPING = 1e-3
"""Damping of the first step; it falls tenfold with each step that helps, and rises fivefold with each that does not."""

SINGULAR = 1e-9
"""Directions that resist less than this share of the stiffest one are taken for free."""

ROUNDING = 1e-30
"""A sum of squares below this is rounding."""

LARGEST_RESIDUAL = 1e-9
"""A rest position is found when what remains is below this share of the scene's length and gravity."""


class Equilibrium(NamedTuple):
    """A rest position.

    Attributes:
        scene: the scene, starting there at rest: loaded bushings are as they are, and points, axes and rest angles
            that joints and forces give in world axes belong to the position that was described (the bodies'
            reference position).
        residual: what remains of accelerations and constraints, as a share of the scene's length [-].
    """

    scene: Scene
    residual: Scalar


def equilibrium(scene: Scene, *, t: float = 0.0) -> Equilibrium:
    """The rest position near the start that a scene describes.

    Velocities of the scene are left out of account. A position of rest need not be stable: a pendulum that starts
    upright stays there. The result follows traced numbers, and can be differentiated by them, up to three times.

    Args:
        scene: the mechanism, with ideal joints and bushings.
        t: the time at which forces and roads are taken [s].

    Returns:
        The scene with its bodies at rest in equilibrium, and what remains.

    Raises:
        SceneError: for a joint with a clearance, in which a ball has no place of its own; for a force with states of
            its own; where no rest position is found near the start.
    """
    system = compile_scene(scene).system
    loose = [name for name in system.force_joints if system.spherical(name).model.has_surfaces]
    if loose:
        raise SceneError(
            f"joint {loose[0]!r} has a clearance, in which the ball has no place of its own at rest. Take Ideal() for "
            "the joint, find the equilibrium, and start the motion there"
        )
    if system.force_states:
        raise SceneError(
            f"force {system.force_states[0].joint!r} has states of its own, whose rest is not looked for here. Replace "
            "it by what it exerts at rest, or let a damped motion come to rest first"
        )
    # Rest has no history: angles are those of the orientations, within one turn to either side of the described start.
    system = dataclasses.replace(system, force_slots=())
    y, residual = _found(system, t)
    if is_concrete(residual) and not float(residual) < LARGEST_RESIDUAL:
        raise SceneError(
            f"no rest position was found near the start: {float(residual):.1e} of the scene's length remains. Start "
            "nearer to it, or let a damped motion come to rest first"
        )
    return Equilibrium(resting_at(scene, system, y), residual)


def resting_at(scene: Scene, system: System, y: Float[Array, " n"]) -> Scene:
    """The scene with its bodies at rest in the positions of a state, and joints that are as loaded there.

    Args:
        scene: the scene.
        system: of it, for the order of the state.
        y: flat state, of which positions are read.
    """
    state = unpack(Layout(len(system.bodies)), y[: (POSITION_SIZE + VELOCITY_SIZE) * len(system.bodies)])
    bodies = dict(scene.bodies)
    for index, name in enumerate(system.bodies):
        bodies[name] = _resting(bodies[name], state.position[index], state.quaternion[index])
    joints = {name: _loaded(joint) for name, joint in scene.joints.items()}
    return eqx.tree_at(lambda s: (s.bodies, s.joints), scene, (bodies, joints))


def _loaded(joint: AbstractJoint) -> AbstractJoint:
    """The joint, with a bushing that starts where the load has pressed it, and is not relieved."""
    model = getattr(joint, "model", None)
    return joint if model is None or model.is_ideal else joint.as_described()


def _resting(body: Body, position: Vector3, quaternion: Quaternion) -> Body:
    """The body at rest at a place; points and axes of its joints mean what they meant where they were drawn."""
    drawn = body.in_reference
    return Body(
        body.mass,
        body.inertia,
        position,
        quaternion,
        points=body.points,
        reference_position=drawn.position,
        reference_quaternion=drawn.quaternion,
    )


def _found(system: System, t: float) -> tuple[Any, Any]:
    """The state at rest, and what remains: at once where all numbers are known, else in JAX."""
    structure, theta = flatten_system(system)
    values, slopes = (program_for(function, structure) for function in (rest_conditions, rest_slopes))
    if is_concrete(theta):
        scales = _scales(system, np)
        y = _at_rest(structure, theta)
        descent = _Descent(lambda y: _scaled(values.compute(theta, t, y), scales), y, scales, np)
        for _ in range(N_STEPS):
            descent = descent.stepped(_scaled_slopes(slopes.compute(theta, t, descent.y), scales))
            if descent.cost < ROUNDING:
                break
        return descent.y, np.sqrt(descent.cost)
    return _found_in_jax(structure, values, slopes, theta, t)


def _found_in_jax(structure: Structure, values, slopes, theta, t: float) -> tuple[Any, Any]:
    """The same for traced numbers; the last steps carry the derivatives by them.

    They are Newton's with the inverse held fast: each makes one more order of derivatives right.
    """
    frozen = jax.lax.stop_gradient(theta)
    scales = _scales(structure.system(frozen), jnp)

    def conditions(numbers, y):
        return _scaled(values(numbers, t, y), scales)

    def step(_, found):
        y, damping, cost = found
        descent = _Descent(lambda y: conditions(frozen, y), y, scales, jnp, damping, cost)
        descent = descent.stepped(_scaled_slopes(slopes(frozen, t, y), scales))
        return descent.y, descent.damping, descent.cost

    y = _at_rest(structure, frozen)
    cost = jnp.sum(conditions(frozen, y) ** 2)
    y = jax.lax.fori_loop(0, N_STEPS, step, (y, jnp.asarray(FIRST_DAMPING), cost))[0]
    inverse = jnp.linalg.pinv(_scaled_slopes(slopes(frozen, t, y), scales), rtol=SINGULAR)
    y, inverse = jax.lax.stop_gradient((y, inverse))
    y = jax.lax.scan(
        lambda y, _: (_moved(y, -(inverse @ conditions(theta, y)) / scales.steps, jnp), None), y, length=N_DERIVATIVES
    )[0]
    return y, jnp.sqrt(jnp.sum(conditions(frozen, jax.lax.stop_gradient(y)) ** 2))


N_DERIVATIVES = 3
"""Orders of derivatives that are right; a fourth one is that of a polynomial of the third degree."""


class _Scales(NamedTuple):
    """What makes lengths of steps and conditions, as shares of the scene's length."""

    steps: Any
    accelerations: Any
    constraints: Any


class _Descent:
    """A state on its way down, in NumPy or JAX."""

    def __init__(self, conditions, y, scales: _Scales, xp: Any, damping=1e-3, cost=None):
        self.conditions, self.y, self.scales, self.xp, self.damping = conditions, y, scales, xp, damping
        self.value = conditions(y)
        self.cost = xp.sum(self.value**2) if cost is None else cost

    def stepped(self, matrix) -> "_Descent":
        """One damped step, taken if it helps."""
        xp, n = self.xp, matrix.shape[1]
        augmented = xp.concatenate([matrix, xp.sqrt(self.damping) * xp.eye(n)])
        move = xp.linalg.lstsq(augmented, -xp.concatenate([self.value, xp.zeros(n)]), rcond=None)[0]
        trial = _moved(self.y, move / self.scales.steps, xp)
        then = xp.sum(self.conditions(trial) ** 2)
        helps = then < self.cost
        y, cost = xp.where(helps, trial, self.y), xp.where(helps, then, self.cost)
        damping = xp.where(helps, self.damping / 10, self.damping * 5)
        return _Descent(self.conditions, y, self.scales, xp, damping, cost)


def rest_conditions(system: System, t: Scalar, y: Float[Array, " n"]) -> tuple[Float[Array, " k"], Float[Array, " m"]]:
    """What vanishes at rest: accelerations [m/s^2, rad/s^2] and constraint residuals [m or 1]."""
    found = evaluate(system, t, y)
    return found.solution.accelerations.ravel(), found.constraints.residual


def rest_slopes(system: System, t: Scalar, y: Float[Array, " n"]) -> tuple[Float[Array, "k k"], Float[Array, "m k"]]:
    """Derivatives of `rest_conditions` by translations [m] and rotations [rad] of the bodies."""

    def moved(step):
        return rest_conditions(system, t, _moved(y, step, jnp))

    return jax.jacfwd(moved)(jnp.zeros(VELOCITY_SIZE * len(system.bodies)))


def _scaled(conditions, scales: _Scales):
    accelerations, residuals = conditions
    xp: Any = np if isinstance(accelerations, np.ndarray) else jnp
    return xp.concatenate([accelerations * scales.accelerations, residuals * scales.constraints])


def _scaled_slopes(slopes, scales: _Scales):
    accelerations, residuals = slopes
    xp: Any = np if isinstance(accelerations, np.ndarray) else jnp
    rows = [accelerations * scales.accelerations[:, None], residuals * scales.constraints]
    return xp.concatenate(rows) / scales.steps


def _scales(system: System, xp: Any) -> _Scales:
    """By the length L and the time T of the scene: steps 1/L and 1, accelerations T^2/L and T^2, constraints 1/L."""
    time, length = time_scale(system), length_scale(system)
    kinds = xp.concatenate([xp.ones(3) / length, xp.ones(3)])
    steps = xp.tile(kinds, len(system.bodies))
    return _Scales(steps, time * time * steps, 1 / length)


def _at_rest(structure: Structure, theta) -> Any:
    """The described start without velocities."""
    system = structure.system(theta)
    bodies = list(system.bodies.values())
    xp: Any = np if is_concrete(theta) else jnp
    quaternions = [body.quaternion / xp.sqrt(xp.sum(xp.asarray(body.quaternion) ** 2)) for body in bodies]
    places = [xp.concatenate([xp.asarray(b.position), q]) for b, q in zip(bodies, quaternions, strict=True)]
    return xp.concatenate([*places, xp.zeros(VELOCITY_SIZE * len(bodies) + system.layout.n_memory)])


def _moved(y, step, xp: Any):
    """The state with its bodies moved by translations [m] and small rotations [rad]."""
    n = step.shape[0] // VELOCITY_SIZE
    places, steps = y[: POSITION_SIZE * n].reshape(n, POSITION_SIZE), step.reshape(n, VELOCITY_SIZE)
    found = []
    for place, move in zip(places, steps, strict=True):
        p, half = place[3:], move[3:] / 2
        scalar = p[:1] - xp.sum(half * p[1:])
        vector = p[1:] + p[0] * half + xp.cross(half, p[1:])
        turned = xp.concatenate([scalar, vector])
        found += [place[:3] + move[:3], turned / xp.sqrt(xp.sum(turned**2))]
    return xp.concatenate([*found, y[POSITION_SIZE * n :]])

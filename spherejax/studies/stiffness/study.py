"""`sj.studies.end_compliance`: the 6 x 6 compliance and stiffness of a point at rest."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Scalar
from spherejax.model.drift import NoDriftControl
from spherejax.model.scene import Scene
from spherejax.model.system import System, compile_scene, flatten_system
from spherejax.motion.equations.programs import program_for
from spherejax.motion.start.equilibrium import LARGEST_RESIDUAL, equilibrium, rest_conditions, rest_slopes
from spherejax.motion.start.tolerances import length_scale, time_scale
from spherejax.physics.forces.applied import AppliedWrench
from spherejax.physics.state import VELOCITY_SIZE
from spherejax.runtime import require_float64
from spherejax.studies.inverse.least_squares import RANK, pseudoinverse
from spherejax.studies.inverse.terms import described_pose, evaluated, flat_state, point_of, rows_of_point

LOAD = "end load"
"""Name of the wrench that is put on the point."""

LOOSE = 1e-6
"""Motion of the point by a direction that nothing resists, from which on it counts."""

RIGID = 1e-12
"""Singular values of the compliance below this share of the largest are those of directions that do not give way."""


class EndCompliance(eqx.Module):
    """How the pose of a point at rest follows a small load on it.

    Attributes:
        compliance: of (translation [m], rotation [rad]) by (force [N], moment [N m]), world axes, shape (6, 6).
        rest: the scene in equilibrium.
        point: the place in the world [m], shape (3,).
    """

    compliance: Float[Array, "6 6"]
    rest: Scene
    point: Float[Array, "3"]
    length: Scalar

    @property
    def stiffness(self) -> Float[Array, "6 6"]:
        """The inverse of the compliance: force [N] and moment [N m] by translation [m] and rotation [rad].

        Raises:
            SceneError: where some directions do not give way at all, as those that ideal joints hold.
        """
        C = self._counted()
        if is_concrete(C):
            sizes = np.linalg.svd(np.asarray(C), compute_uv=False)
            rigid = int(np.sum(sizes <= RIGID * sizes[0]))
            if rigid:
                raise SceneError(
                    f"the point does not give way in {rigid} of 6 directions, where its stiffness is infinite; take "
                    "`compliance`, or give joints that hold it a Bushing"
                )
        return jnp.linalg.inv(self.compliance)

    def _counted(self) -> Array:
        """The compliance with rotations as lengths and moments as forces, so that its entries can be compared."""
        by = jnp.concatenate([jnp.ones(3), jnp.full(3, self.length)])
        return by[:, None] * self.compliance * by


def end_compliance(scene: Scene, point: str, *, t: float = 0.0) -> EndCompliance:
    """How a point of a mechanism in equilibrium gives way to a small force and moment.

        result = sj.studies.end_compliance(scene, "hand.tool")
        result.compliance, result.stiffness      # 6 x 6: three translations or forces, three rotations or moments

    The rest position is found first (`sj.equilibrium`), so that weights, preloads of springs and bushings, and what
    they add or take by their directions are in it. With the accelerations a(q, w) of the constrained equations, which
    vanish at rest, and the residuals Phi(q),

        (da/dq; D) dq = -(da/dw; 0) dw,    C = E dq/dw

    with E the rows of the point's body. The load keeps its direction in the world, and its force acts on the point.

    Args:
        scene: the mechanism, with ideal joints and bushings; motors that stand are drivers, springs or stiff joints.
        point: `"body.point"` or `"body"`, its center of mass.

    Other args:
        t: time at which drivers and forces are taken [s].

    Returns:
        The compliance, the stiffness, and the scene at rest. Differentiable by the numbers of the scene, to first order
        also by what moves the rest position; where numbers are traced, NaN in place of the errors below.

    Raises:
        SceneError: where the point can move without resistance; as `sj.equilibrium` for clearances, and for scenes
            without a rest position.

    Limits: symmetric where all forces derive from an energy, and about a loaded point for translations alone: moments
    that keep their direction derive from none. Friction does not count: it holds nothing here.
    """
    require_float64()
    conditions = compile_scene(scene).conditions
    at_rest = equilibrium(scene, t=t)
    rest = at_rest.scene
    if LOAD in rest.forces:
        raise SceneError(f"a force element is named {LOAD!r}, which is taken; give it another name")

    def loaded(w) -> System:
        load = AppliedWrench(point, force=w[:3], moment=w[3:])
        system = compile_scene(eqx.tree_at(lambda s: s.forces, rest, {**rest.forces, LOAD: load})).system
        # Rest has no history, as in `equilibrium`.
        return System(system.bodies, system.joints, system.forces, system.gravity, NoDriftControl(), (), False)

    system = loaded(np.zeros(6))
    number = list(system.bodies).index(point.partition(".")[0])
    place = rest.find(point)[1] if "." in point else np.zeros(3)
    pose = described_pose(system)
    y = flat_state(pose, jnp.zeros((len(pose), VELOCITY_SIZE)))
    time = jnp.asarray(t, jnp.float64)
    slopes, residual_slopes = _terms(rest_slopes, system, time, y)
    # Accelerations are linear in the load: differences by unit loads are exact.
    unloaded = _terms(rest_conditions, system, time, y)[0]
    pushed = jnp.stack([_terms(rest_conditions, loaded(unit), time, y)[0] - unloaded for unit in np.eye(6)], 1)
    length, seconds = (jax.lax.stop_gradient(jnp.asarray(f(system))) for f in (length_scale, time_scale))
    kinds = jnp.tile(jnp.concatenate([jnp.full(3, 1 / length), jnp.ones(3)]), len(pose))
    weights = seconds**2 * kinds
    S = jnp.concatenate([weights[:, None] * slopes, residual_slopes / length]) / kinds
    right = jnp.concatenate([weights[:, None] * pushed, jnp.zeros((residual_slopes.shape[0], 6))])
    end = rows_of_point(pose, number, place) / kinds
    inverse = pseudoinverse(S)
    _check_held(S, end, point)
    is_right = jnp.all(jnp.stack([*conditions, at_rest.residual < LARGEST_RESIDUAL, _is_held(S, inverse, end)]))
    compliance = jnp.where(is_right, -end @ inverse @ right, jnp.nan)
    return EndCompliance(compliance, rest, point_of(pose[number], place), length)


def _terms(function: Any, system: System, t: Scalar, y: Float[Array, " size"]) -> Any:
    """A function of a system; of known numbers at once: to compile the slopes of a linkage takes a minute."""
    structure, theta = flatten_system(system)
    # One program for all loads, whose zeros and ones are no constants of it.
    structure = dataclasses.replace(structure, special=())
    program = program_for(function, structure, None, is_quiet=True)
    if all(map(is_concrete, (theta, t, y))):
        return program.compute(np.asarray(theta), float(t), np.asarray(y))
    return evaluated(function, system, t, y)


def _is_held(S: Any, inverse: Any, end: Any) -> Any:
    """Whether no direction that nothing resists moves the point."""
    return jnp.max(jnp.abs(end @ (jnp.eye(S.shape[1]) - inverse @ S))) <= LOOSE


def _check_held(S: Any, end: Any, point: str) -> None:
    """Raise `SceneError` where a direction that nothing resists moves the point, and numbers are known."""
    if not all(map(is_concrete, (S, end))):
        return
    _, sizes, directions = np.linalg.svd(np.asarray(S))
    free = directions[int(np.sum(sizes > RANK * sizes[0])) :]
    if free.size and np.max(np.abs(np.asarray(end) @ free.T)) > LOOSE:
        raise SceneError(
            f"point {point!r} can move without resistance: its compliance is infinite. Hold what its motors hold by "
            "drivers, or give it springs"
        )

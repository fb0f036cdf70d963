"""`sj.inverse_dynamics`: motor moments and joint reactions from a motion."""

import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete, shown
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Scalar
from spherejax.model.scene import Scene
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.start.assembly import CLOSING_TOLERANCE
from spherejax.program_cache import cached_jit
from spherejax.runtime import require_float64
from spherejax.studies.inverse.balance import Balance, balance_at
from spherejax.studies.inverse.inverse_result import InverseDynamics, InverseWarning
from spherejax.studies.inverse.kinematics import (
    MeasuredSignals,
    Misfit,
    Motion,
    misfit_at,
    motion_at,
    no_wishes,
    poses,
    wishes_of,
)
from spherejax.studies.inverse.mechanism import IdealMechanism, Motors, mechanism_of
from spherejax.studies.inverse.memories import memories
from spherejax.studies.inverse.sampled_motion import SampledMotion

UNBALANCED = 1e-6
"""Share of the largest force, from which on what neither motors nor joints carry is no rounding."""

SETTLED = 1e-9
"""Largest change of the reactions by the last repetition with friction, as a share of them."""


def inverse_dynamics(scene: Scene, motion: Any, *, motors: Motors = None, friction: bool = True) -> InverseDynamics:
    """Efforts of motors and reactions of joints that make a prescribed or measured motion.

        result = sj.inverse_dynamics(scene, ts)                            # the scene's drivers prescribe the motion
        result = sj.inverse_dynamics(scene, run)                           # a motion that was simulated
        result = sj.inverse_dynamics(scene, sj.studies.SampledMotion(...)) # a motion that was measured
        result.effort("knee"), result.reaction("hip")

    Every joint is ideal here, whatever its model: its reaction is what the motion asks for. The motion may be that of a
    mechanism with loops; nothing is integrated. At each instant

        M a - g = B u - D^T lambda

    is solved for the efforts u and the multipliers lambda.

    Args:
        scene: the mechanism. Weights, force elements and friction of `Ideal(friction=...)` joints act as they are.
        motion: instants [s], shape (n,), at which drivers of the scene prescribe the motion; or a `Trajectory` of
            the same bodies, whose poses, velocities and accelerations are taken; or a `SampledMotion`, which says how
            samples are smoothed.

    Other args:
        motors: names of drivers, `Actuator`s and controllers of the scene, whose efforts are to be result, or
            coordinates by name, `{"knee": sj.Turn(...)}`; what a motor of the scene exerts by itself is left out.
            None: all drivers, or where there is none all actuators and controllers. Drivers that are no motors
            prescribe the motion without a force.
        friction: False leaves friction in ideal joints out.

    Returns:
        Efforts, powers, reactions, the motion, and what they leave unbalanced.

    Where there are more motors than degrees of freedom the efforts are the least ones, in the sum of squares of forces
    and of moments over the length L of the scene; where constraints are redundant, of the reactions that go with these
    efforts those with the least sum of |F|^2 + |M|^2/L^2. `result.not_unique` names them. Differentiable by the numbers
    of the scene and by the samples, under `jit` and `vmap`; L counts as a constant.

    Raises:
        SceneError: for a request that makes no sense; for drivers that the mechanism cannot follow. Where numbers are
            traced, forces are NaN at the instants that cannot be closed.

    Warns:
        InverseWarning: where forces are left that neither motors nor joints carry: the motors cannot make this motion,
            or it was measured with errors; where friction and reactions do not settle (they may have no solution).

    Limits: samples of a motion that drivers prescribe must be so close that Newton's method finds the pose from the one
    before. A joint with a clearance counts as ideal, with its reaction at the two centers: what contact friction does
    besides, a moment of mu R |F|, is left to the motors. Directions that nothing determines (the spin of a rod between
    two balls) do not move. In a singular configuration, velocities and reactions are the least ones.

    Source: the constrained equations in maximal coordinates with M a - g on the right, projected as by Udwadia and
    Kalaba (1992), Proc. R. Soc. Lond. A 439:407-410, onto what no joint can carry.
    """
    require_float64()
    measured = motion if isinstance(motion, SampledMotion) else None
    mechanism, conditions = mechanism_of(scene, motors, friction, measured)
    if isinstance(motion, Trajectory):
        ts, moved, misfit = _of_run(mechanism, motion)
        remembered = memories(mechanism, moved.pose, motion)
    else:
        ts = _instants(motion, mechanism) if measured is None else jnp.asarray(measured.ts)
        wishes = no_wishes(len(ts)) if measured is None else wishes_of(mechanism, measured)
        moved, misfit = _followed(mechanism, ts, wishes)
        remembered = memories(mechanism, moved.pose, None)
    must_close = not isinstance(motion, Trajectory)
    balance = _balances(mechanism, ts, moved, remembered)
    # Of numbers that are traced an error can say nothing.
    is_right = jnp.all(jnp.stack([jnp.array(True), *conditions]))
    if must_close:
        is_right = is_right & (misfit.gap < _largest_gap(mechanism.length))
    is_right = jnp.broadcast_to(is_right, ts.shape)
    balance = jax.tree.map(lambda x: jnp.where(is_right.reshape(-1, *[1] * (x.ndim - 1)), x, jnp.nan), balance)
    result = InverseDynamics(ts, moved, balance, misfit, mechanism)
    _judge(result, must_close)
    return result


def _largest_gap(length: Scalar) -> Scalar:
    """What joints and drivers may lack where they count as closed [m or rad]."""
    return CLOSING_TOLERANCE * jnp.maximum(length, 1.0)


@cached_jit(what="the poses of a motion")
def _followed(mechanism: IdealMechanism, ts: Float[Array, " n"], wishes: MeasuredSignals) -> tuple[Motion, Misfit]:
    pose = poses(mechanism, ts, wishes)
    motion = jax.vmap(motion_at, (None, 0, 0, 0))(mechanism, ts, pose, wishes)
    return motion, jax.vmap(misfit_at, (None, 0, 0, 0))(mechanism, ts, pose, wishes)


@cached_jit(what="the balance of forces")
def _balances(mechanism: IdealMechanism, ts, motion: Motion, memory) -> Balance:
    return jax.vmap(balance_at, (None, 0, 0, 0))(mechanism, ts, motion, memory)


@cached_jit(what="the gaps of a motion")
def _misfits(mechanism: IdealMechanism, ts, pose, wishes: MeasuredSignals) -> Misfit:
    return jax.vmap(misfit_at, (None, 0, 0, 0))(mechanism, ts, pose, wishes)


def _instants(motion: Any, mechanism: IdealMechanism) -> Float[Array, " n"]:
    if isinstance(motion, Scene | str) or callable(motion):
        raise SceneError(f"motion = {shown(motion)} must be instants [s], a Trajectory or a SampledMotion")
    ts = jnp.asarray(motion, jnp.float64)
    if ts.ndim != 1 or not ts.shape[0]:
        raise SceneError(f"the instants must have the shape (n,); they have {ts.shape}")
    if not mechanism.system.is_driven:
        raise SceneError(
            "instants alone say no motion: the scene has no driver. Add drivers, e.g. sj.RotationDriver, or give a "
            "Trajectory or a SampledMotion"
        )
    return ts


def _of_run(mechanism: IdealMechanism, run: Trajectory) -> tuple[Any, Motion, Misfit]:
    names = tuple(mechanism.system.bodies)
    if tuple(run.system.bodies) != names:
        raise SceneError(
            f"the run moves {', '.join(run.system.bodies)}, the scene {', '.join(names)}; the bodies must be the same"
        )
    if np.ndim(run.ended):
        raise SceneError("inverse_dynamics takes a single run; use jax.vmap for many")
    if is_concrete(run.ended):
        run.require_success()
    state, seen = run.state, run.observation
    motion = Motion(
        jnp.concatenate([state.position, state.quaternion], -1),
        jnp.concatenate([state.velocity, state.angular_velocity], -1),
        jnp.concatenate([seen.acceleration, seen.angular_acceleration], -1),
    )
    ts = jnp.asarray(run.ts)
    return ts, motion, _misfits(mechanism, ts, motion.pose, no_wishes(len(ts)))


def _judge(result: InverseDynamics, must_close: bool) -> None:
    """Errors and warnings, where numbers are known."""
    balance, misfit = result.balance, result.misfit
    if not all(map(is_concrete, jax.tree.leaves((balance, misfit)))):
        return
    gaps = np.asarray(misfit.gap)
    worst = int(np.argmax(np.where(np.isfinite(gaps), gaps, np.inf))) if gaps.size else 0
    if must_close and gaps.size and not gaps[worst] < float(_largest_gap(result.mechanism.length)):
        raise SceneError(
            f"at t = {float(result.ts[worst]):.6g} s the joints and drivers cannot be closed: {gaps[worst]:.3g} m or "
            "rad remain. The motion leads out of the mechanism's reach, its samples are too far apart for Newton's "
            "method, or drivers contradict each other"
        )
    largest = _largest_force(result)
    left = result.largest_unbalanced
    if left > UNBALANCED * largest:
        warnings.warn(
            f"inverse dynamics: forces of up to {left:.3g} N (moments over {result.length:.3g} m) are carried by "
            f"neither motors nor joints, beside {largest:.3g} N of all others. The motors "
            f"({', '.join(result.motors) or 'none'}) cannot make this motion exactly: a degree of freedom has no "
            "motor, the motion was measured with errors, or the scene lacks a force. result.unbalanced(body) shows "
            "them",
            InverseWarning,
            stacklevel=3,
        )
    if np.max(np.asarray(balance.friction_change), initial=0.0) > SETTLED:
        warnings.warn(
            "inverse dynamics: friction and reactions do not settle; where friction is this large they may have no "
            "solution, or several. Give friction=False, or a smaller coefficient",
            InverseWarning,
            stacklevel=3,
        )


def _largest_force(result: InverseDynamics) -> float:
    """Of weights, inertia, reactions and efforts [N], moments over L."""
    length = result.length
    sizes = [
        np.abs(np.asarray(reaction)) / ([1.0] * 3 + [length] * 3) for reaction in result.balance.reactions.values()
    ]
    for name, effort in result.balance.efforts.items():
        sizes.append(np.abs(np.asarray(effort)) / (length if result.unit(name) == "N m" else 1.0))
    masses = np.array([float(np.max(body.mass)) for body in result.mechanism.system.bodies.values()])
    sizes.append(masses[:, None] * np.abs(np.asarray(result.motion.accelerations)[..., :3]))
    return max(float(np.max(size, initial=0.0)) for size in sizes)

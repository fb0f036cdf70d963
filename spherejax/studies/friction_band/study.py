"""`sj.studies.friction_band`: equilibrium with friction at its limits, along one coordinate."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import is_concrete, shown
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import real_number
from spherejax.model.scene import Scene
from spherejax.motion.start.assembly import CLOSING_TOLERANCE
from spherejax.physics.forces.coupler import AbstractCoordinate
from spherejax.program_cache import cached_jit
from spherejax.runtime import require_float64
from spherejax.studies.friction_band.band_result import FrictionBand
from spherejax.studies.friction_band.slipping import EFFORT, efforts_at, slipping, wished
from spherejax.studies.inverse.kinematics import misfit_at, poses
from spherejax.studies.inverse.mechanism import IdealMechanism, mechanism_of
from spherejax.studies.inverse.memories import memories
from spherejax.studies.inverse.sampled_motion import SampledMotion
from spherejax.studies.inverse.terms import described_pose, evaluated, flat_state, measures

UNBALANCED = 1e-6
"""Share of the largest reaction, from which on what neither the effort nor the joints carry is no rounding."""


def friction_band(
    scene: Scene,
    along: AbstractCoordinate,
    between: tuple[float, float],
    *,
    samples: int = 101,
    t: float = 0.0,
) -> FrictionBand:
    """The positions at which dry friction holds a mechanism at rest, and the efforts that it takes to move it.

        found = sj.studies.friction_band(scene, sj.Turn(("ground", "crank"), axis=(0, 1, 0)), (-1.0, 1.0))
        found.bands                       # between which positions it stays when it is let go
        found.forward, found.backward     # efforts from which on it moves, at `found.positions`
        found.band(0.0)                   # one band, differentiable

    The mechanism has one degree of freedom, along a coordinate. At each position two equilibria are solved, that of a
    motion about to begin forward and that of one backward. In each, every joint with friction exerts its limit
    against that motion, of what presses it: a shaft of radius R the moment mu_s R F_r (times 4/pi, by the pressure of a
    journal), a slider the force mu_s F, a ball mu_s R F. What presses follows from the reactions, so both are repeated
    until they agree. Between the two efforts lie the equilibria with friction within its limits.

    Args:
        scene: the mechanism, with `Ideal(friction=...)` in its joints. Weights, springs, preloads and motors act as
            they are. Of each law the static coefficient counts, mu_static where it has one, else mu.
        along: the coordinate, a `Turn`, `Travel` or `Extension`.
        between: first and last position [rad or m].

    Other args:
        samples: number of positions, at least 2. So close that Newton's method finds each pose from the one before.
        t: time at which forces are taken [s].

    Returns:
        Efforts at the positions, and the bands. Differentiable by the numbers of the scene, under `jit` and `vmap`.

    Raises:
        SceneError: for a scene without friction, with drivers (hold what they hold by a `Fixed` joint), with friction
            in joints with a clearance; where neither the effort nor the joints carry a force, because the mechanism
            has another degree of freedom.

    Limits: at a dead point, where a joint does not slide, its friction turns around, and the efforts jump; at that very
    position it may be anywhere between. Where constraints are redundant, reactions with the least sum of squares press
    the joints; misalignment may press them harder. Very large friction, mu R of the size of the links, lets a mechanism
    jam: then no finite effort is found, and NaN is returned. Friction in force elements counts as in a motion that is
    infinitely slow, which is none for laws that begin at zero.

    Source: the impending motion of statics with friction, e.g. Beer and Johnston, Vector Mechanics for Engineers:
    Statics, chapter 8; in the form of inverse dynamics of a mechanism (`sj.inverse_dynamics`).
    """
    require_float64()
    if not isinstance(along, AbstractCoordinate):
        raise SceneError(f"along = {shown(along)} must be a Turn, a Travel or an Extension")
    first, last = _ends(between)
    if not isinstance(samples, int) or isinstance(samples, bool) or samples < 2:
        raise SceneError(f"samples = {shown(samples)} must be a whole number, at least 2")
    positions = np.linspace(first, last, samples)
    limited = slipping(scene)
    # Says which coordinate is prescribed; of its samples nothing is used.
    measured = SampledMotion(np.arange(16.0), coordinates={EFFORT: (along, np.zeros(16))}, cutoff=0.1)
    mechanism, conditions = mechanism_of(limited, {EFFORT: along}, True, measured)
    driven = [name for name, joint in mechanism.system.joints.items() if joint.is_driven]
    if driven:
        raise SceneError(
            f"joint {driven[0]!r} is a driver, which moves the mechanism whatever friction does; hold what it holds by "
            "a Fixed joint, or leave it out"
        )
    time = jnp.asarray(t, jnp.float64)
    pose, gaps = _followed(mechanism, time, jnp.asarray(positions))
    remembered = memories(mechanism, pose, None)
    efforts = _efforts(mechanism, time, pose, jnp.asarray(positions), remembered)
    is_closed = gaps < CLOSING_TOLERANCE * jnp.maximum(mechanism.length, 1.0)
    _check_balance(efforts.unbalanced, is_closed & efforts.is_settled)
    is_right = is_closed & efforts.is_settled & (efforts.unbalanced < UNBALANCED)
    is_right = is_right & jnp.all(jnp.stack([jnp.array(True), *conditions]))
    forward, backward = (jnp.where(is_right, effort, jnp.nan) for effort in (efforts.forward, efforts.backward))
    units = ("N m", "rad") if along.is_angle else ("N", "m")
    return FrictionBand(jnp.asarray(positions), forward, backward, *units, pose, remembered, mechanism, time)


def _ends(between: Any) -> tuple[float, float]:
    try:
        first, last = between
    except (TypeError, ValueError):
        raise SceneError(f"between = {shown(between)} must be two positions, the first and the last") from None
    for name, value in (("between[0]", first), ("between[1]", last)):
        real_number(name, value)
        if not is_concrete(value):
            raise SceneError(f"{name} is traced; the positions that are looked at must be known")
    if not first < last:
        raise SceneError(f"between = {shown(between)} must be two positions, the first below the last")
    return float(first), float(last)


@cached_jit(what="the poses along a coordinate")
def _followed(mechanism: IdealMechanism, t, positions):
    """The pose at each position, and the gap that remains; by way of the described pose to the first position."""
    n = positions.shape[0]
    still = flat_state(described_pose(mechanism.system), jnp.zeros((mechanism.n_bodies, 6)))
    described = evaluated(measures, mechanism.observed, t, still).values[0]
    described = jax.lax.stop_gradient(described)
    there = described + (positions[0] - described) * jnp.arange(n) / n
    wishes, ts = wished(jnp.concatenate([there, positions]), 0.0), jnp.full(2 * n, t)
    pose = poses(mechanism, ts, wishes)[n:]
    own = jax.tree.map(lambda x: x[n:], wishes)
    gaps = jax.vmap(lambda pose, wish: _gap(mechanism, t, pose, wish))(pose, own)
    return pose, gaps


def _gap(mechanism: IdealMechanism, t, pose, wish):
    """What the joints and the coordinate lack [m, 1 or rad]."""
    misfit = misfit_at(mechanism, t, pose, wish)
    return jnp.maximum(misfit.gap, jnp.max(jnp.abs(misfit.measured)))


@cached_jit(what="efforts at the limits of friction")
def _efforts(mechanism: IdealMechanism, t, pose, positions, memory):
    return jax.vmap(efforts_at, (None, None, 0, 0, 0))(mechanism, t, pose, positions, memory)


def _check_balance(unbalanced: Any, is_settled: Any) -> None:
    """Raise `SceneError` where a force is left, and numbers are known."""
    if not all(map(is_concrete, (unbalanced, is_settled))):
        return
    left = np.where(np.asarray(is_settled), np.asarray(unbalanced), 0.0)
    if np.max(left, initial=0.0) >= UNBALANCED:
        raise SceneError(
            f"a share of {np.max(left):.2g} of the largest reaction is carried neither by an effort along the "
            "coordinate nor by the joints: the mechanism has another degree of freedom. Hold it by a joint or a spring"
        )

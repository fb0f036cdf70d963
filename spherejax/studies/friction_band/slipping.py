"""Friction at its limit: what a joint exerts that is about to slide, and the efforts that bring a mechanism there."""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Flag, Number, Scalar
from spherejax.model.scene import Scene
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.laws.friction import AbstractStaticFriction
from spherejax.studies.inverse.balance import balance_at
from spherejax.studies.inverse.kinematics import MeasuredSignals, Motion, motion_at, no_wishes
from spherejax.studies.inverse.mechanism import IdealMechanism
from spherejax.studies.inverse.smoothing import Smoothed

EFFORT = "effort along the coordinate"
"""Name of the motor whose effort is looked for."""

SLOW = 1e-12
"""Rate of the coordinate [1/s]: so slow that dampers and centrifugal forces do nothing, and the surfaces slide."""

STILL = 1e-9 * SLOW
"""Sliding velocities [m/s] below which a joint counts as one that does not slide, and may exert anything up to its
limit: rounding leaves 1e-16 of `SLOW`."""


class Slipping(AbstractStaticFriction):
    """Friction at its limit mu_s F_n, however slowly the surfaces slide.

    Attributes:
        mu: coefficient of static friction [-].
        sliding: that of fast sliding, which measures a preload.
    """

    never_adds_energy: ClassVar[bool] = True
    simulable: ClassVar[bool] = True

    mu: Number
    sliding: Number

    @property
    def sliding_coefficient(self):
        """As of the law in the scene."""
        return self.sliding

    def secant(self, speed):
        """mu/v [s/m]; mu/`STILL` at v = 0."""
        return self.mu / jnp.sqrt(speed * speed + STILL * STILL)

    def requirements(self):
        """None: the numbers are those of a law that has been checked."""
        return []


def slipping(scene: Scene) -> Scene:
    """The scene with every friction at its limit.

    Raises:
        SceneError: for friction whose limit is not known, and where there is none.
    """
    joints = {}
    for name, joint in scene.joints.items():
        model: Any = getattr(joint, "model", None)
        law: Any = getattr(model, "friction", None)
        if law is None:
            continue
        if not isinstance(model, Ideal):
            raise SceneError(
                f"joint {name!r} has friction in a {type(model).__name__} model, whose surfaces meet in one point of "
                "many; give it Ideal(friction=..., radius=...), which has the same friction about a center"
            )
        sliding = law.sliding_coefficient
        if sliding is None:
            raise SceneError(
                f"joint {name!r}: {type(law).__name__} has no coefficient of friction by itself; give it a law with "
                "one, such as Threlfall or BrownMcPhee"
            )
        limit = Slipping(getattr(law, "mu_static", sliding), sliding)
        joints[name] = eqx.tree_at(lambda joint: joint.model.friction, joint, limit)
    if not joints:
        raise SceneError("no joint has friction; give one Ideal(friction=sj.Threlfall(mu=...), radius=...)")
    return eqx.tree_at(lambda s: s.joints, scene, {**scene.joints, **joints})


def wished(value: Any, rate: float) -> MeasuredSignals:
    """The coordinate's value, and its rate, of one instant or with a leading axis."""
    column = jnp.asarray(value, jnp.float64)[..., None]
    coordinates = Smoothed(column, jnp.full_like(column, rate), jnp.zeros_like(column))
    nothing = no_wishes(len(column)) if column.ndim > 1 else jax.tree.map(lambda x: x[0], no_wishes(1))
    return nothing._replace(coordinates=coordinates)


class Efforts(NamedTuple):
    """Efforts along the coordinate at one pose [N or N m].

    Attributes:
        forward: from which on the mechanism moves forward.
        backward: below which it moves backward.
        unbalanced: the largest force that neither effort nor joints carry [N], over the largest of all.
        is_settled: whether friction and reactions agree.
    """

    forward: Scalar
    backward: Scalar
    unbalanced: Scalar
    is_settled: Flag


SETTLED = 1e-9
"""Largest change of the reactions by the last repetition with friction, as a share of them."""


def efforts_at(
    mechanism: IdealMechanism, t: Scalar, pose: Float[Array, "b 7"], value: Scalar, memory: Float[Array, " m"]
) -> Efforts:
    """The efforts of both impending motions: all joints slide, and all friction is at its limit, against them."""
    moves = motion_at(mechanism, t, pose, wished(value, 1.0)).velocities
    # Drivers stand, whatever their rates at this instant.
    moves = moves - motion_at(mechanism, t, pose, wished(value, 0.0)).velocities

    def one(sign):
        balance = balance_at(mechanism, t, Motion(pose, sign * SLOW * moves, jnp.zeros_like(moves)), memory)
        size = jnp.max(jnp.stack([jnp.max(jnp.abs(x)) for x in balance.reactions.values()]))
        left = jnp.max(jnp.abs(balance.unbalanced[:, :3])) / jnp.where(size > 0, size, 1.0)
        return balance.efforts[EFFORT][0], left, balance.friction_change

    efforts, left, changes = jax.vmap(one)(jnp.array([1.0, -1.0]))
    return Efforts(efforts[0], efforts[1], jnp.max(left), jnp.max(changes) < SETTLED)

"""The set of poses that clearances allow."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.rotation import conjugate, quaternion_product, rotation_vector
from spherejax.foundations.types import Number, Scalar
from spherejax.model.system import System
from spherejax.physics.state import VELOCITY_SIZE
from spherejax.studies.inverse.kinematics import displaced
from spherejax.studies.inverse.least_squares import pseudoinverse
from spherejax.studies.inverse.terms import closing, evaluated, flat_state, point_of

NEWTON_STEPS = 8
"""From the pose without play, at most some clearances away: three are enough, eight are safe near singular poses."""


SHOWN = 1e-9
"""Sizes [mm or mrad] above this are shown: a thousandth of an atom is rounding."""


class PosePlay(eqx.Module):
    """What the clearances of joints make of the pose of a point; see `pose_play`.

    To first order in the clearances the change of the pose is

        (translation, rotation) = sum_i J_i e_i,    |e_i| <= c_i

    over the joints with clearance: a sum of ellipsoids, whose extent along a direction d is h(d) = sum_i c_i |J_i^T d|.

    Attributes:
        influence: J_i by joint, shape (6, 3): translation of the point [m/m] and rotation of its body [rad/m], world
            axes, by the eccentricity of the ball in its socket, world axes.
        clearances: c_i [m].
        pose: of all bodies without play, shape (n_bodies, 7).
    """

    influence: dict[str, Float[Array, "6 3"]]
    clearances: dict[str, Number]
    pose: Float[Array, "b 7"]
    _system: System
    _rows: dict[str, int] = eqx.field(static=True)
    _body: int = eqx.field(static=True)
    _place: Any
    _t: Scalar
    _scales: Float[Array, " k"]

    def __repr__(self) -> str:
        if not all(map(is_concrete, jax.tree.leaves(self.influence))):
            return "PosePlay(traced)"
        reach = [_without_rounding(1e3 * float(self.reach(axis))) for axis in np.eye(3)]
        turn = [_without_rounding(1e3 * float(self.tilt(axis))) for axis in np.eye(3)]
        return (
            f"play of {len(self.influence)} joints: at most ±{reach[0]:.3g}, ±{reach[1]:.3g}, ±{reach[2]:.3g} mm along "
            f"x, y, z and ±{turn[0]:.3g}, ±{turn[1]:.3g}, ±{turn[2]:.3g} mrad about them"
        )

    def reach(self, direction: Any) -> Scalar:
        """How far the point can go along a direction, to either side [m]: h(d) of the unit vector, world axes."""
        return sum(self.shares(_wrench(direction, None)).values(), jnp.zeros(()))

    def tilt(self, axis: Any) -> Scalar:
        """How far the body can turn about an axis, to either side [rad]."""
        return sum(self.shares(_wrench(None, axis)).values(), jnp.zeros(()))

    def shares(self, direction: Any) -> dict[str, Scalar]:
        """What each joint adds to h(d) of a direction in the six coordinates of the pose, shape (6,)."""
        d = jnp.asarray(direction, jnp.float64)
        return {name: self.clearances[name] * safe_norm(J.T @ d) for name, J in self.influence.items()}

    def worst(self, direction: Any) -> dict[str, Float[Array, "3"]]:
        """The eccentricities that reach farthest along a direction of the six coordinates [m]: all on their walls.

        Zero for a joint that does not matter.
        """
        d = jnp.asarray(direction, jnp.float64)
        eccentricities = {}
        for name, J in self.influence.items():
            along = J.T @ d
            size = safe_norm(along)
            eccentricities[name] = self.clearances[name] * along / jnp.where(size > 0, size, 1.0)
        return eccentricities

    def change(self, eccentricities: Mapping[str, Any]) -> Float[Array, "6"]:
        """Translation of the point [m] and rotation vector of its body [rad] for given eccentricities, exact.

        All joints are closed with their balls displaced by these, by Newton's method; for checks of the first order,
        and for samples: `jax.vmap(play.change)({"elbow": samples, ...})`.

        Args:
            eccentricities: by joint, socket to ball, world axes [m]; joints that are left out have none.
        """
        offsets = jnp.zeros(())
        for name, e in eccentricities.items():
            if name not in self._rows:
                raise SceneError(f"there is no joint with clearance {name!r}: {one_of(self._rows, name)}")
            offsets = offsets + _offset(self._n_rows, self._rows[name], jnp.asarray(e, jnp.float64))

        def step(_, pose):
            constraints = evaluated(closing, self._system, self._t, _still(pose))
            move = pseudoinverse(constraints.jacobian / self._scales) @ (offsets - constraints.residual)
            return displaced(pose, (move / self._scales).reshape(-1, VELOCITY_SIZE))

        moved = jax.lax.fori_loop(0, NEWTON_STEPS, step, self.pose)
        before, after = self.pose[self._body], moved[self._body]
        turned = rotation_vector(quaternion_product(after[3:], conjugate(before[3:])))
        return jnp.concatenate([point_of(after, self._place) - point_of(before, self._place), turned])

    @property
    def _n_rows(self) -> int:
        return sum(joint.n_rows for joint in self._system.joints.values())


def _without_rounding(size: float) -> float:
    """Zero for what is rounding of a size in mm or mrad."""
    return size if size > SHOWN else 0.0


def _offset(n_rows: int, start: int, eccentricity: Float[Array, "3"]) -> Float[Array, " n"]:
    return jnp.zeros(n_rows).at[start : start + 3].set(eccentricity)


def _still(pose: Float[Array, "b 7"]) -> Array:
    return flat_state(pose, jnp.zeros((pose.shape[0], VELOCITY_SIZE)))


def _wrench(direction: Any, axis: Any) -> Float[Array, "6"]:
    parts = []
    for part in (direction, axis):
        vector = jnp.zeros(3) if part is None else jnp.asarray(part, jnp.float64)
        size = safe_norm(vector)
        parts.append(vector / jnp.where(size > 0, size, 1.0))
    return jnp.concatenate(parts)

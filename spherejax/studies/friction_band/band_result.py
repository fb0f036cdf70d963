"""What `sj.studies.friction_band` returns."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Number, Scalar
from spherejax.program_cache import cached_jit
from spherejax.studies.friction_band.slipping import efforts_at, wished
from spherejax.studies.inverse.kinematics import LAST_STEPS, STEPS, stepped
from spherejax.studies.inverse.mechanism import IdealMechanism

HALVINGS = 45
"""Of the interval between two samples, after which a secant step leaves rounding."""


class FrictionBand(eqx.Module):
    """Where friction holds a mechanism of one degree of freedom at rest, and against which efforts.

    Attributes:
        positions: samples of the coordinate [m or rad], shape (n,).
        forward: effort along the coordinate from which on the mechanism moves forward [N or N m], shape (n,).
        backward: effort below which it moves backward. Between the two it stays. Both are NaN where the mechanism
            does not reach, and where friction and reactions do not settle.
        unit: of the efforts (static).
        coordinate_unit: of the positions (static).
    """

    positions: Float[Array, " n"]
    forward: Float[Array, " n"]
    backward: Float[Array, " n"]
    unit: str = eqx.field(static=True)
    coordinate_unit: str = eqx.field(static=True)
    poses: Float[Array, "n b 7"]
    memories: Float[Array, "n m"]
    mechanism: IdealMechanism
    t: Scalar

    @property
    def stays(self) -> Array:
        """Whether the mechanism, let go at rest, stays: backward <= 0 <= forward; shape (n,)."""
        return (self.backward <= 0) & (self.forward >= 0)

    def band(self, near: Number) -> tuple[Scalar, Scalar]:
        """The ends of the band around a position at which the mechanism stays [m or rad].

        Each is the root of the effort of one impending motion, and has the derivative of the implicit function.

        Args:
            near: a position within the band.

        Returns:
            The two ends; -inf or inf where the band goes on beyond the samples; NaN where it goes on to a position that
            the mechanism does not reach, or where it jams.

        Raises:
            SceneError: for a position where it does not stay; NaN where numbers are traced.
        """
        stays, n = self.stays, self.positions.shape[0]
        i = jnp.argmin(jnp.abs(self.positions - near))
        if all(map(is_concrete, (stays, near))) and not bool(stays[i]):
            raise SceneError(
                f"the mechanism does not stay at {float(near):.6g} {self.coordinate_unit}; it stays "
                f"{self._in_words() or 'nowhere among the samples'}"
            )
        index = jnp.arange(n)
        above = jnp.min(jnp.where((index > i) & ~stays, index, n))
        below = jnp.max(jnp.where((index < i) & ~stays, index, -1))
        ends = [
            jnp.where(outside == limit, infinity, self._end(inside, outside))
            for inside, outside, limit, infinity in (
                (below + 1, below, -1, -jnp.inf),
                (above - 1, above, n, jnp.inf),
            )
        ]
        first, last = (jnp.where(stays[i], end, jnp.nan) for end in ends)
        return first, last

    @property
    def bands(self) -> list[tuple[float, float]]:
        """All bands of positions among the samples; of known numbers."""
        if not is_concrete(self.forward):
            raise SceneError("bands are counted where numbers are known; within jit and grad ask band(near)")
        stays = np.asarray(self.stays)
        begins = np.flatnonzero(stays & ~np.concatenate([[False], stays[:-1]]))
        found = []
        for begin in begins:
            first, last = self.band(float(self.positions[begin]))
            found.append((float(first), float(last)))
        return found

    def __repr__(self) -> str:
        if not is_concrete(self.forward):
            return "FrictionBand(traced)"
        return f"stays {self._in_words() or 'nowhere'}, of {len(self.positions)} positions from " + (
            f"{float(self.positions[0]):.4g} to {float(self.positions[-1]):.4g} {self.coordinate_unit}"
        )

    def _in_words(self) -> str:
        return ", ".join(f"from {a:.4g} to {b:.4g} {self.coordinate_unit}" for a, b in self.bands)

    def _end(self, inside: Array, outside: Array) -> Scalar:
        """The position between two samples at which the mechanism ceases to stay."""
        n = self.positions.shape[0]
        inside, outside = jnp.clip(inside, 0, n - 1), jnp.clip(outside, 0, n - 1)
        # Where it slips by itself: forward, if no effort is needed for that, else backward.
        is_forward = self.forward[outside] < 0
        is_known = ~jnp.isnan(self.forward[outside] + self.backward[outside])
        pose, memory = self.poses[inside], self.memories[inside]
        ends = self.positions[inside], self.positions[outside]
        return jnp.where(is_known, _root(self.mechanism, self.t, pose, memory, is_forward, *ends), jnp.nan)


@cached_jit(what="the end of a band of friction")
def _root(mechanism: IdealMechanism, t, pose, memory, is_forward, inside, outside) -> Scalar:
    held = jax.lax.stop_gradient((mechanism, t, pose, memory))

    def missing(mechanism, t, pose, memory, value):
        efforts = efforts_at(mechanism, t, _closed(mechanism, t, pose, value), value, memory)
        return jnp.where(is_forward, efforts.forward, -efforts.backward)

    def halved(_, ends):
        stays, slips = ends
        middle = (stays + slips) / 2
        does_stay = missing(*held, middle) >= 0
        return jnp.where(does_stay, middle, stays), jnp.where(does_stay, slips, middle)

    stays, slips = jax.lax.fori_loop(0, HALVINGS, halved, (inside, outside))
    root = jax.lax.stop_gradient((stays + slips) / 2)
    _, slope = jax.jvp(lambda value: missing(*held, value), (root,), (jnp.ones(()),))
    slope = jax.lax.stop_gradient(slope)
    # Zero to rounding; its derivative is that of the implicit function.
    return root - missing(mechanism, *held[1:], root) / jnp.where(slope != 0, slope, 1.0)


def _closed(mechanism: IdealMechanism, t: Scalar, pose: Any, value: Scalar) -> Any:
    """The pose at a value of the coordinate, from one nearby."""
    near = jax.lax.stop_gradient((mechanism, t, pose, value))
    wish = wished(near[3], 0.0)
    pose = jax.lax.fori_loop(0, STEPS, lambda _, pose: stepped(near[0], near[1], pose, wish), near[2])
    pose, wish = jax.lax.stop_gradient(pose), wished(value, 0.0)
    return jax.lax.scan(lambda pose, _: (stepped(mechanism, t, pose, wish), None), pose, length=LAST_STEPS)[0]

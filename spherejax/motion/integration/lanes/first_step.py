"""The first step by Hairer's trial, from the stages of a block's own steps.

Two evaluations of the right-hand side tell how long the first step may be: at the start, and a little way along its
slope. They are what the first two stages of any explicit Runge-Kutta method evaluate. So where all runs of a block
begin together, its first two turns are looks that keep nothing: the program holds the right-hand side once, not twice,
and the first call of a four-bar takes 4.4 s instead of 6.4 (ideal), 6.5 instead of 9.2 (dry). The sizes are those of
diffrax's `PIDController` to rounding.

Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, section II.4.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

N_LOOKS = 2
"""Turns that are looks."""

_FIRST_LOOK = 1e-6
"""Size of the first look as a share of the run; only its slope at the start is read."""


class InitialStepProbe(NamedTuple):
    """What the looks have found.

    Attributes:
        turn: how many turns there were.
        slope: at the start (lanes on the last axis).
        is_new: whether the last turn was one, of which nothing has been read yet.
    """

    turn: Int[Array, ""]
    slope: Float[Array, "... n_lanes"]
    is_new: Bool[Array, ""]

    @classmethod
    def of_nothing(cls, y: Float[Array, "... n_lanes"]) -> "InitialStepProbe":
        """Before the first one."""
        return cls(jnp.zeros((), jnp.int64), jnp.zeros_like(y), jnp.array(False))

    @property
    def is_looking(self) -> Array:
        """Whether the coming turn is a look."""
        return self.turn < N_LOOKS

    def n_stages(self, n: int) -> Array:
        """How many stages the coming turn has to evaluate, of n."""
        return jnp.where(self.is_looking, self.turn + 1, n)


def can_look(coefficients: Float[np.ndarray, "n n"], instants: Float[np.ndarray, " n"]) -> bool:
    """Whether the second stage of a method lies on the slope at the start, as that of all methods of use does."""
    return len(instants) > 1 and bool(instants[1] > 0) and bool(abs(coefficients[1, 0] - instants[1]) < 1e-12)


def first_look(t0, t_end, shortest) -> Float[Array, ""]:
    """Where the first look ends [s]."""
    return t0 + jnp.maximum(_FIRST_LOOK * (t_end - t0), shortest)


def looked_along(controller: Any, y0: Float[Array, " ..."], slope: Float[Array, " ..."]) -> Float[Array, ""]:
    """How far along the slope the second evaluation is [s], for one lane."""
    scale = controller.atol + jnp.abs(y0) * controller.rtol
    size, rate = controller.norm(y0 / scale), controller.norm(slope / scale)
    is_tiny = (size < 1e-5) | (rate < 1e-5)
    return jnp.where(is_tiny, 1e-6, 0.01 * (size / jnp.where(is_tiny, 1.0, rate)))


def first_size(
    controller: Any, order: Any, y0: Float[Array, " ..."], slope: Float[Array, " ..."], along: Float[Array, ""],
    slope_along: Float[Array, " ..."],
) -> Float[Array, ""]:  # fmt: skip
    """The size of the first step [s], for one lane.

    Args:
        controller: diffrax's `PIDController`, for its tolerances and its norm.
        order: of the error estimate.
        y0: state at the start.
        slope: rate there.
        along: how far along the slope the second evaluation was [s].
        slope_along: rate there.
    """
    scale = controller.atol + jnp.abs(y0) * controller.rtol
    bend = controller.norm((slope_along - slope) / scale) / along
    largest = jnp.maximum(controller.norm(slope / scale), bend)
    size = jnp.where(largest <= 1e-15, jnp.maximum(1e-6, along * 1e-3), (0.01 / largest) ** (1 / order))
    return jnp.minimum(100 * along, size)

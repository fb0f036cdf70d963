"""A bushing in steady harmonic motion: its complex stiffness along one direction.

The deflection is x = x_m + x_0 sin(w t) along a line, or the rotation about an axis. The first harmonic of the force
that resists is K' x_0 sin(w t) + K'' x_0 cos(w t), and K = K' + i K'' the complex stiffness: |K| is the dynamic
stiffness, arg K the loss angle, and pi K'' x_0^2 what is lost in a cycle, whatever the law.

What branches add is known in closed form, and so is the steady loop of the friction, which depends on the path alone.
The elastomer has no memory: it is sampled over one cycle. Nothing is integrated in time, and no start has to fade.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex

from spherejax.foundations.numerics import safe_divide
from spherejax.foundations.rotation import quaternion_from_rotation_vector
from spherejax.foundations.types import Number, Scalar, Vector3
from spherejax.physics.joints.bushing import Bushing
from spherejax.physics.laws.elastomer import AbstractElastomer
from spherejax.physics.laws.viscoelastic import Berg, Maxwell

N_PHASES = 256
"""Samples of the elastomer over a cycle: exact for what is smooth, 1e-4 for a curve with kinks."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
"""Of the loop of friction over a half cycle; 1e-9 up to amplitudes of a thousand half lengths."""


def complex_stiffness(
    model: Bushing, frequency: Number, amplitude: Number, direction: Vector3, mean: Number = 0.0, *, rotation: bool
) -> Complex[Array, ""]:
    """K' + i K'' of a bushing [N/m], or [N m/rad].

    Args:
        model: the bushing.
        frequency: w/(2 pi) [Hz].
        amplitude: x_0, half of what lies between the ends [m], or [rad].
        direction: of length one, in the socket's axes.
        mean: x_m, about which it moves [m], or [rad]; branches and friction have forgotten how it came there.

    Other args:
        rotation: about the direction instead of along it.
    """
    w = 2 * np.pi * frequency
    total = _of_elastomer(model.law, w, amplitude, direction, mean, rotation)
    along = direction
    if rotation:
        at_rest = model.law.measure_of_rotation(jnp.array([1.0, 0.0, 0.0, 0.0]))
        along = model.law.resisted_rotation(at_rest) @ direction
    if model.branches is not None:
        total = total + _of_branches(model.branches, w, along, rotation)
    if model.friction is not None:
        total = total + _of_friction(model.friction, amplitude, along, rotation)
    return total


def _of_elastomer(law: AbstractElastomer, w, amplitude, direction, mean, rotation: bool) -> Complex[Array, ""]:
    """(2/x_0) times the means of F sin and F cos over a cycle."""
    phases = 2 * np.pi * (np.arange(N_PHASES) + 0.5) / N_PHASES
    sine, cosine = np.sin(phases), np.cos(phases)

    def resistance(x, rate):
        if rotation:
            turned = law.measure_of_rotation(quaternion_from_rotation_vector(x * direction))
            return -law.moment(turned, rate * direction) @ direction
        return -law.force(x * direction, rate * direction) @ direction

    x, rate = mean + amplitude * sine, w * amplitude * cosine
    forces = jnp.vectorize(resistance)(x, rate)
    return 2 * (jnp.mean(forces * sine) + 1j * jnp.mean(forces * cosine)) / amplitude


def _of_branches(branches: Maxwell, w, along: Vector3, rotation: bool) -> Complex[Array, ""]:
    """sum_k k_k i w tau_k/(1 + i w tau_k)."""
    given = branches.rotational_stiffness if rotation else branches.stiffness
    if given is None:
        return jnp.zeros((), complex)
    stiffness = jnp.asarray(given)
    stiffness = stiffness if stiffness.ndim == 2 else stiffness[:, None]
    k, wt = jnp.sum(stiffness * along * along, 1), w * jnp.asarray(branches.time)
    return jnp.sum(k * wt * (wt + 1j) / (1 + wt * wt))


def _of_friction(friction: Berg, amplitude, along: Vector3, rotation: bool) -> Complex[Array, ""]:
    """Of the steady loop: with u = (x + x_0)/x_2 from its lower end, F/F_max = 1 - 1/(1/(1 + f_0) + u) as x rises."""
    limit = friction.rotational_limit if rotation else friction.limit
    half = friction.half_angle if rotation else friction.half_length
    if limit is None:
        return jnp.zeros((), complex)
    # Only what rubs moves the bristle: by a share of the deflection, in the direction of that share.
    rubbing = jnp.where(jnp.asarray(limit) > 0, along, 0.0)
    share = jnp.sqrt(jnp.maximum(rubbing @ rubbing, 1e-300))
    largest = safe_divide(jnp.sum(limit * rubbing * along), share)
    r = share * amplitude / half
    angles, weights = np.pi / 2 * (1 + _NODES), np.pi / 2 * _WEIGHTS
    force = _rising(r, r * (1 - np.cos(angles)))
    stored, lost = jnp.sum(weights * force * -np.cos(angles)), jnp.sum(weights * force * np.sin(angles))
    return largest * 2 / np.pi * (stored + 1j * lost) / amplitude


def _rising(r: Scalar, u: Array) -> Array:
    """F/F_max in a steady loop of the amplitude r x_2, at u x_2 from its lower end."""
    end = 2 * r / (1 + jnp.sqrt(1 + 4 * r * r))  # F/F_max at the ends: f_0
    return (u - end / (1 + end)) / (1 / (1 + end) + u)

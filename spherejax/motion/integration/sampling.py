"""Samples of force elements at the ends of steps: the state jumps, and so do its derivatives.

A step ends on the instant tau of a sample, for `longest_step.room` says how far away it is. There the memory x of the
element becomes G(tau, y-). The instant may follow the numbers itself (its period is one of them), so that

    dx+ = dG (dy- + f- dtau) - f+ dtau,    dz+ = dz- + (f- - f+) dtau of all that does not jump,

with the rates f- before and f+ behind the sample. The rule stands here once, at the update of the state: rows of
sensitivities, the reverse sweep and differentiated steps all go through it.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from spherejax.foundations.lanes import in_lanes
from spherejax.model.system import Structure, example_of
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import Program, program_for
from spherejax.motion.equations.sampling import due_samples, memory_after_samples, next_samples
from spherejax.motion.integration.sensitivity_rows import rows_of


class SampledElements(NamedTuple):
    """What the integrator must know of force elements that sample; functions take (parameters, t, y).

    Attributes:
        update: the flat state behind the samples that are due at t; unchanged where none is.
        is_due: whether one is.
        counts: index in the last axis of what is integrated of each element's number of samples (static).
        n_axes: number of axes of what is integrated, before those of lanes (static).
    """

    update: Callable
    is_due: Callable
    counts: tuple[int, ...]
    n_axes: int = 1

    def were_taken(self, start: Array, end: Array) -> Bool[Array, " *lanes"]:
        """Whether a state differs from another by samples."""
        first = (0,) * (self.n_axes - 1)
        taken = [start[(*first, count)] != end[(*first, count)] for count in self.counts]
        return jnp.any(jnp.stack(taken), axis=0)

    def update_lanes(self, parameters: Any, t: Array, y: Array) -> Array:
        """`update` of a block of lanes, with their lanes on the last axis; most of its steps end on no sample."""
        is_due = jnp.any(in_lanes(self.is_due)(parameters, t, y))
        return jax.lax.cond(is_due, in_lanes(self.update), lambda parameters, t, y: y, parameters, t, y)

    def of_rows(self) -> "SampledElements":
        """The same for a state and its sensitivities as rows, with `Linearized` parameters."""

        def update(parameters, t, rows):
            def of_state(numbers, y):
                return self.update(numbers, t, y)

            return rows_of(of_state, (parameters.value, rows[0]), (parameters.slopes, rows[1:]))

        def is_due(parameters, t, rows):
            return self.is_due(parameters.value, t, rows[0])

        return SampledElements(update, is_due, self.counts, 2)


@lru_cache(maxsize=64)
def samples_of(structure: Structure, scalar: bool | None) -> SampledElements | None:
    """The samples of a system as programs, for the integrator; None for a system without."""
    system = example_of(structure)
    if not system.sampled_forces:
        return None
    due, after = (program_for(each, structure, scalar, is_quiet=True) for each in (due_samples, memory_after_samples))
    start, end = system.layout.memory_start, system.layout.work_start
    slots = {slot.joint: slot for slot in system.force_slots}

    def sampled(theta, t, y):
        return jnp.concatenate([y[:start], after(theta, t, y), y[end:]])

    update = jax.custom_jvp(sampled)
    rate = program_for(state_rate, structure, scalar)
    instants = program_for(next_samples, structure, scalar, is_quiet=True)
    blocks = tuple(slice(start + slots[n].entries.start, start + slots[n].entries.stop) for n in system.sampled_forces)

    @update.defjvp
    def update_jvp(primals, tangents):
        theta, t, y = primals
        along = _SampleSlopes(sampled, rate, instants, blocks)
        is_due = due(theta, t, y) > 0
        still = (tangents[0], jnp.zeros_like(t), tangents[2])

        def jumping(primals, tangents):
            return along(is_due, primals, tangents)

        slope = jax.lax.cond(jnp.any(is_due), jumping, lambda primals, tangents: tangents[2], primals, still)
        return sampled(*primals), slope

    return SampledElements(
        lambda parameters, t, y: update(parameters.theta, jnp.asarray(t, jnp.float64), y),
        lambda parameters, t, y: jnp.any(due(parameters.theta, t, y) > 0),
        tuple(block.start for block in blocks),
    )


class _SampleSlopes(NamedTuple):
    """The derivative of the state behind samples along a direction; see the module's docstring."""

    sampled: Callable
    rate: Program
    instants: Program
    blocks: tuple[slice, ...]

    def __call__(self, is_due: Bool[Array, " n_sampled"], primals, tangents) -> Float[Array, " size"]:
        theta, t, y = primals
        theta_dot, _, y_dot = tangents
        after = self.sampled(theta, t, y)
        delays = jax.jvp(lambda theta: self.instants(theta, t, y), (theta,), (theta_dot,))[1]
        delays = jnp.where(is_due, delays, 0.0)
        before = self.rate(theta, t, y)
        slope = y_dot
        for i, block in enumerate(self.blocks):
            own = jnp.zeros(y.shape, bool).at[block].set(True)
            behind = self.rate(theta, t, jnp.where(own, after, y))
            # The instant at which the element samples follows the numbers by itself.
            direction = theta_dot, jnp.zeros_like(t), y_dot + before * delays[i]
            jumped = jax.jvp(self.sampled, primals, direction)[1] - behind * delays[i]
            slope = slope + jnp.where(own, jnp.where(is_due[i], jumped - y_dot, 0.0), (before - behind) * delays[i])
        return slope

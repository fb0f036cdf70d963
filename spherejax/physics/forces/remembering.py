"""Force elements with states of their own: continuous ones, which have a rate, and sampled ones, which jump.

An element lists what it remembers by `memory` and brings wrenches and rates in one `ForceAction`. One that samples
says when by `sampling`; its held entries have no rate, and change only at the instants t_k, where the integrator ends
a step:

    x(t_k+) = sampled(t_k, motions, x(t_k-))

The number of the coming sample stands in the state in front of its memory, as `samples`: so an instant is never missed
or taken twice, whatever the steps are, and the same holds in lanes and under derivatives. At an instant the value is
the one behind it.

Any element that has an angle about an axis has entries for its turns besides, behind the number of samples and in front
of what it remembers itself: see the module `turns`. So the state of an element is

    samples, turned, own memory

and `Recalling` is the one place that knows.
"""

import abc
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import positive
from spherejax.foundations.types import Number, Numeric, Scalar
from spherejax.physics.forces.base import AbstractForce, Motions, Wrench, all_of, is_users_own
from spherejax.physics.forces.turns import (
    attachments_of,
    turn_doubts,
    turn_entries,
    turn_rates,
    turns_at_start,
    with_turns,
)
from spherejax.physics.functions.shapes import finite
from spherejax.physics.memory import MemoryEntry

SAMPLES = MemoryEntry("samples", "1", 1.0)
"""Number of the coming sample: samples up to now, where the motion begins before the first one."""

SAME_INSTANT = 16 * float(np.finfo(np.float64).eps)
"""An instant has come when less than this share of the time is missing: what rounding leaves of a step that ends on it.
The shortest steps are a quarter as long."""


class ForceAction(NamedTuple):
    """What an element with memory does at one instant.

    Attributes:
        wrenches: on each body that it acts on, by name; see `AbstractForce.wrenches`.
        memory_rate: time derivative of its memory, in the order of its entries, shape (n_memory,); zero for what is
            held between samples.
        potential_energy: stored in the element [J].
        parts: named results for inspection, see `AbstractForce.parts`.
    """

    wrenches: dict[str, Wrench]
    memory_rate: Float[Array, " n_memory"]
    potential_energy: Any = 0.0
    parts: Mapping[str, Array] = {}


class Sampling(NamedTuple):
    """Instants at equal intervals: t_k = first + k period.

    Attributes:
        period: [s].
        first: instant of the first sample [s].
    """

    period: Number
    first: Number = 0.0

    def instant(self, number: Scalar) -> Scalar:
        """t_k of k = `number` [s]."""
        return jnp.asarray(self.first + number * self.period)

    def number_at(self, t: Scalar) -> Scalar:
        """The first k with t_k at t or behind it."""
        periods = (t - self.first) / self.period
        before = jnp.maximum(jnp.floor(periods) - 1.0, 0.0)
        # Counted up from below by the instants themselves: what division rounds is not what they are.
        return before + sum(_is_past(self.instant(before + i), t) for i in range(3))

    def requirements(self) -> list[Requirement]:
        """A positive period, a finite first instant."""
        return [positive("period", self.period, "s"), finite("first_sample", self.first)]


class Instants(NamedTuple):
    """Given instants; none behind the last.

    Attributes:
        times: increasing [s], shape (n,).
    """

    times: Numeric

    def instant(self, number: Scalar) -> Scalar:
        """The instant of a number [s]; infinite behind the last."""
        times = jnp.asarray(self.times)
        is_it = number == np.arange(times.shape[0])
        return jnp.where(number < times.shape[0], jnp.sum(jnp.where(is_it, times, 0.0)), jnp.inf)

    def number_at(self, t: Scalar) -> Scalar:
        """The first number whose instant is at t or behind it."""
        return jnp.sum(jnp.where(_is_past(jnp.asarray(self.times), t), 1.0, 0.0))


def _is_past(instant: Array, t: Scalar) -> Array:
    """1 where an instant is before t, and not t itself; 0 else."""
    return jnp.where(t - instant > _nearness(t, instant), 1.0, 0.0)


def _nearness(t: Scalar, instant: Scalar) -> Scalar:
    finite_one = jnp.where(jnp.abs(instant) < jnp.inf, instant, 0.0)
    return SAME_INSTANT * jnp.maximum(jnp.abs(t), jnp.abs(finite_one))


class AbstractForceWithMemory(AbstractForce):
    """A force element with states of its own: `memory` and `action`; and `sampled`, where it samples.

        class Lag(sj.forces.AbstractForceWithMemory):
            '''A thrust of `strength` that builds up with a time constant.'''

            strength: float  # N
            time: float  # s

            @property
            def body_names(self):
                return ("ball",)

            @property
            def memory(self):
                return (sj.forces.MemoryEntry("thrust", "N", "force"),)

            def action(self, t, motions, memory):
                (thrust,) = memory
                wrench = sj.forces.Wrench(thrust * jnp.array([0.0, 0.0, 1.0]), jnp.zeros(3))
                rate = (self.strength - thrust) / self.time
                return sj.forces.ForceAction({"ball": wrench}, jnp.stack([rate]), parts={"force": thrust})

    What is remembered is read by `run.memory(name)`. All else is as of an `AbstractForce`: numbers are leaves, and the
    power that it puts in counts as supplied work unless it `never_adds_energy`.
    """

    @property
    @abc.abstractmethod
    def memory(self) -> tuple[MemoryEntry, ...]:
        """What the element remembers: names, units, and the scales by which errors are judged (static)."""

    @abc.abstractmethod
    def action(self, t: Scalar, motions: Motions, memory: Float[Array, " n_memory"]) -> ForceAction:
        """Wrenches and rates of the memory.

        Args:
            t: time [s].
            motions: motion of every body, the ground included.
            memory: in the order of the entries.
        """

    def memory_at_start(self, t: Scalar, motions: Motions) -> Float[Array, " n_memory"]:
        """The memory with which a motion begins, before a sample that is due there; zeros unless told otherwise."""
        del t, motions
        return jnp.zeros(len(self.memory))

    @property
    def sampling(self) -> Sampling | Instants | None:
        """When the element samples; None for one that does not."""
        return None

    def sampled(self, t: Scalar, motions: Motions, memory: Float[Array, " n_memory"]) -> Float[Array, " n_memory"]:
        """The memory just behind a sample at t, from the one just before it."""
        raise TypeError(f"{type(self).__name__} says when it samples, but not what: write the method sampled")

    def wrenches(self, t, motions):
        """Those of `action`, of an element whose `memory` is empty, as of a PID without integral and filter.

        Raises:
            TypeError: for an element with a memory, whose wrenches follow from it.
        """
        return self._action_without_memory(t, motions).wrenches

    def potential_energy(self, t, motions):
        """That of `action`, of an element whose `memory` is empty [J]."""
        return jnp.asarray(self._action_without_memory(t, motions).potential_energy, jnp.float64)

    def parts(self, t, motions):
        """Those of `action`, of an element whose `memory` is empty."""
        return dict(self._action_without_memory(t, motions).parts)

    def _action_without_memory(self, t: Scalar, motions: Motions) -> ForceAction:
        if self.memory or self.sampling is not None:
            raise TypeError(f"{type(self).__name__} remembers; ask for its action")
        return self.action(t, motions, jnp.zeros(0))


class Recalling(eqx.Module):
    """An element together with its entries of the state: it answers as an element without memory does.

    Attributes:
        force: the element.
        recalled: its entries of the state: the number of samples, its turns, what it remembers itself.
    """

    force: AbstractForce
    recalled: Array

    @property
    def never_adds_energy(self) -> bool:
        """As the element."""
        return self.force.never_adds_energy

    @property
    def body_names(self):
        """As the element."""
        return self.force.body_names

    @property
    def n_touches(self) -> int:
        """As the element."""
        return self.force.n_touches

    @property
    def force_at_touch(self) -> Scalar | None:
        """As the element."""
        return self.force.force_at_touch

    def touches(self, t, motions):
        """As the element, with its turns."""
        return self._counted.touches(t, motions)

    def action(self, t: Scalar, motions: Motions) -> ForceAction:
        """What an element with a memory of its own does."""
        element = self._counted
        assert isinstance(element, AbstractForceWithMemory), type(element).__name__
        return element.action(t, motions, self._own)

    def wrenches(self, t, motions):
        """Of the element with its turns, or of its action."""
        return self.action(t, motions).wrenches if self._acts else self._counted.wrenches(t, motions)

    def potential_energy(self, t, motions):
        """Of the element with its turns, or of its action [J]."""
        if not self._acts:
            return self._counted.potential_energy(t, motions)
        return jnp.asarray(self.action(t, motions).potential_energy, jnp.float64)

    def parts(self, t, motions):
        """Of the element with its turns, or of its action."""
        return dict(self.action(t, motions).parts) if self._acts else self._counted.parts(t, motions)

    def time_to_breakpoint(self, t, motions):
        """As the element's; the coming sample is another thing, see `next_sample`."""
        return self._counted.time_to_breakpoint(t, motions)

    def unknown_in_time(self, t, motions):
        """As the element's; of one of the user's own all wrenches."""
        if is_users_own(self.force):
            return all_of(self.wrenches(t, motions))
        return self._counted.unknown_in_time(t, motions)

    def memory_rate(self, t: Scalar, motions: Motions) -> Array:
        """Of all its entries of the state."""
        rates = [*([jnp.zeros(())] if is_sampled(self.force) else []), *turn_rates(self._counted, motions)]
        front = jnp.stack([jnp.asarray(rate, jnp.float64) for rate in rates]) if rates else jnp.zeros(0)
        if not self._acts:
            return front
        return jnp.concatenate([front, jnp.asarray(self.action(t, motions).memory_rate, jnp.float64)])

    def doubts(self, motions: Motions) -> list[Scalar]:
        """How much the number of turns of each angle is in doubt; see `turns.turn_doubts`."""
        return turn_doubts(self._counted, motions)

    def tilts(self, motions: Motions) -> list[Scalar]:
        """How far the axis of each angle is tilted; see `TorsionalAttachment.tilt_share`."""
        return [attachment.tilt_share(motions) for attachment in attachments_of(self.force)]

    def next_sample(self) -> Scalar:
        """The instant of the coming sample [s]."""
        return _sampling_of(self.force).instant(self._number)

    def is_due(self, t: Scalar) -> Bool[Array, ""]:
        """Whether the coming sample has come."""
        instant = self.next_sample()
        return instant - t <= _nearness(t, instant)

    def sampled(self, t: Scalar, motions: Motions) -> Array:
        """Its entries of the state behind the coming sample; one behind the last is taken at t."""
        element = self._counted
        assert isinstance(element, AbstractForceWithMemory), type(element).__name__
        # The instant itself, not the end of a step that rounding has put beside it: derivatives by it come along.
        instant = self.next_sample()
        instant = jnp.where(jnp.abs(instant) < jnp.inf, instant, t)
        after = jnp.asarray(element.sampled(instant, motions, self._own), jnp.float64)
        return jnp.concatenate([(self._number + 1.0)[None], self._turned, after])

    @property
    def _acts(self) -> bool:
        return isinstance(self.force, AbstractForceWithMemory)

    @property
    def _counted(self) -> Any:
        """The element whose angles know their turns."""
        return with_turns(self.force, self._turned)

    @property
    def _number(self) -> Scalar:
        # States inside a step are sums of many products, which need not give a whole number back.
        return jnp.round(self.recalled[0])

    @property
    def _turned(self) -> Array:
        start = int(is_sampled(self.force))
        return self.recalled[start : start + len(attachments_of(self.force))]

    @property
    def _own(self) -> Array:
        return self.recalled[int(is_sampled(self.force)) + len(attachments_of(self.force)) :]


ActingForce = AbstractForce | Recalling
"""An element without memory, or one with its entries of the state."""


def _sampling_of(force: AbstractForce) -> Sampling | Instants:
    sampling = force.sampling if isinstance(force, AbstractForceWithMemory) else None
    assert sampling is not None, type(force).__name__
    return sampling


def is_sampled(force: AbstractForce) -> bool:
    """Whether the element samples (static)."""
    return isinstance(force, AbstractForceWithMemory) and force.sampling is not None


def memory_entries(force: AbstractForce) -> tuple[MemoryEntry, ...]:
    """Entries of the state of a placed element: the number of samples, its turns, what it remembers itself."""
    samples = (SAMPLES,) if is_sampled(force) else ()
    own = tuple(force.memory) if isinstance(force, AbstractForceWithMemory) else ()
    return (*samples, *turn_entries(force), *own)


def recalling(force: AbstractForce, recalled: Array) -> Recalling:
    """The element with its entries of the state."""
    return Recalling(force, recalled)


def memory_at_start(force: AbstractForce, t: Scalar, motions: Motions) -> Array:
    """Its entries of the state where a motion begins; with the sample that is due there."""
    turned = [jnp.asarray(angle, jnp.float64) for angle in turns_at_start(force, motions)]
    front = jnp.stack(turned) if turned else jnp.zeros(0)
    if not isinstance(force, AbstractForceWithMemory):
        return front
    own = jnp.asarray(with_turns(force, front).memory_at_start(t, motions), jnp.float64)
    found = jnp.concatenate([front, own])
    if not is_sampled(force):
        return found
    t = jnp.asarray(t, jnp.float64)
    before = Recalling(force, jnp.concatenate([_sampling_of(force).number_at(t)[None], found]))
    return jnp.where(before.is_due(t), before.sampled(t, motions), before.recalled)

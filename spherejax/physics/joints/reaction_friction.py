"""Friction in ideal joints: what the reaction, and a preload, resist the joint's own motion with.

A joint slides on surfaces of radius R, with the sliding velocity v that its relative motion has there, and is pressed
by loads N that follow from its reaction. All friction is linear in what presses: with the traction tau(v) of one newton
(`law.traction(v, 1)`, about -mu v/|v|, and 0 at v = 0),

    ball        v = R w,  M = (R N (k_perp (I - n n^T) + k_par n n^T) + (M_0/mu_k) I) tau,  N n the reaction force
    shaft       v = (R w.a, s),  f = (k_perp N + N_0) tau: the moment R f_1 about the axis a, the force f_2 along it
    cross       two shafts: one pin in the first body, one in the second

A shaft's N is its radial load: |F_r| of the reaction force F, or, in a bearing of length L that carries the moment
M across the axis at its ends, |F_r/2 + a x M/L| + |F_r/2 - a x M/L|. A slider that does not turn adds |M.a|/R where R
is given. N_0 is the load that makes the preload: M_0/(mu_k R), or the preload's force over mu_k.

What is left out: the thrust of a shaft against a collar. Give it as a `TorsionalSpring` with a damper, or a preload.
"""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.numerics import safe_divide, safe_norm
from spherejax.foundations.types import Number, Numeric, Scalar, Vector3
from spherejax.physics.joints.base import Reaction
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.kinematics import BodyMotion, point_motion
from spherejax.physics.memory import MemoryEntry


class Resistance(NamedTuple):
    """Friction of one joint.

    Attributes:
        force: on the second body, at the joint's point on it, world axes [N]; the first body receives its opposite
            at the same place.
        moment: on the second body, world axes [N m]; the first receives its opposite.
        memory_rate: of the bristles [m/s], shape (n_memory,).
        bristle_energy: stored in them [J].
    """

    force: Vector3
    moment: Vector3
    memory_rate: Float[Array, " n_memory"]
    bristle_energy: Scalar


class AbstractJointFriction(eqx.Module):
    """Friction of one kind of joint.

    Attributes:
        model: law, radius, pressure and preload.
    """

    model: eqx.AbstractVar[Ideal]

    @property
    @abc.abstractmethod
    def directions(self) -> tuple[str, ...]:
        """Names of the directions in which the surfaces slide: bristles deflect in them (static)."""

    @property
    def memory(self) -> tuple[MemoryEntry, ...]:
        """Bristles of laws that have them (static), judged as those of a contact."""
        return tuple(MemoryEntry(name, "m", "speed") for name in self.directions) if self._law.bristle_size else ()

    @property
    @abc.abstractmethod
    def n_loads(self) -> int:
        """Length of the vector of loads (static)."""

    @abc.abstractmethod
    def loads(self, first: BodyMotion, second: BodyMotion, reaction: Reaction) -> Float[Array, " n"]:
        """What presses the surfaces together, by the reaction on the second body [N]."""

    @abc.abstractmethod
    def resist(
        self,
        first: BodyMotion,
        second: BodyMotion,
        place: Vector3,
        loads: Float[Array, " n"],
        memory: Float[Array, " n_memory"],
    ) -> Resistance:
        """Friction under loads.

        Args:
            first: motion of the first body.
            second: motion of the second body.
            place: the joint's point on the second body, body axes [m].
            loads: as `loads` gives them; zeros leave the preload [N].
            memory: deflections of the bristles [m].
        """

    @property
    def _law(self) -> Any:
        assert self.model.friction is not None
        return self.model.friction

    @property
    def _radius(self) -> Number:
        assert self.model.radius is not None
        return self.model.radius

    @property
    def _preload(self) -> Scalar:
        """The load that makes the preload [N]."""
        total, mu = jnp.zeros(()), self._law.sliding_coefficient
        if self.model.preload is not None:
            assert mu is not None
            total = total + self.model.preload / (mu * self._radius)
        if self.model.preload_force is not None:
            assert mu is not None
            total = total + self.model.preload_force / mu
        return total

    def _tractions(self, sliding: Vector3, bristle: Vector3) -> tuple[Vector3, Vector3]:
        """Friction force by one newton of normal force [-], and the rate of the bristles [m/s]."""
        law = self._law
        if law.bristle_size:
            return law.bristle_traction(bristle, sliding, 1.0), law.bristle_rate(bristle, sliding)
        return law.traction(sliding, 1.0), jnp.zeros(3)


class BallFriction(AbstractJointFriction):
    """Friction of a ball that turns in its socket.

    Attributes:
        model: law, radius, pressure and preload.

    The loads are the reaction force itself. Bristles are a vector in world axes, carried by the socket.

    Limits: a reaction that vanishes has no direction; M is 0 there, and its derivative by the force is taken as 0.
    """

    model: Ideal

    @property
    def directions(self):
        """World axes."""
        return ("bristle_x", "bristle_y", "bristle_z")

    @property
    def n_loads(self):
        """The three components of the reaction."""
        return 3

    def loads(self, first, second, reaction):
        """The reaction force, world axes."""
        return reaction.force

    def resist(self, first, second, place, loads, memory):
        """A moment alone."""
        radius = self._radius
        bristle = memory if self._law.bristle_size else jnp.zeros(3)
        traction, rate = self._tractions(radius * (second.angular_velocity - first.angular_velocity), bristle)
        size, pressure = safe_norm(loads), self.model.distribution
        always, about = pressure.across * size + self._preload, (pressure.about - pressure.across) * size
        moment = radius * (always * traction + about * loads * safe_divide(loads @ traction, loads @ loads))
        energy = jnp.zeros(())
        if self._law.bristle_size:
            rate = rate + jnp.cross(first.angular_velocity, bristle)
            along = loads * safe_divide(loads @ bristle, loads @ loads)
            energy = self._law.bristle_energy(bristle, always) + self._law.bristle_energy(along, about)
        return Resistance(jnp.zeros(3), moment, rate[: len(self.memory)], energy)


class ShaftFriction(AbstractJointFriction):
    """Friction of a shaft in its bearing: it turns about its axis, slides along it, or both.

    Attributes:
        model: law, radius, length, pressure and preload.
        axis: on the second body, body axes, unit length.
        turns: whether it turns (static).
        slides: whether it slides (static).
    """

    model: Ideal
    axis: Numeric
    turns: bool = eqx.field(static=True)
    slides: bool = eqx.field(static=True)

    @property
    def directions(self):
        """Around the shaft, along it."""
        return (*(("bristle_around",) if self.turns else ()), *(("bristle_along",) if self.slides else ()))

    @property
    def n_loads(self):
        """The radial load."""
        return 1

    def loads(self, first, second, reaction):
        """The radial load; of a slider also what holds it from turning, at the radius."""
        a = second.rotation @ self.axis
        radial = radial_load(self.model, a, reaction)
        if not self.turns and self.model.radius is not None:
            radial = radial + jnp.abs(reaction.moment @ a) / self.model.radius
        return radial[None]

    def resist(self, first, second, place, loads, memory):
        """A moment about the axis, and a force along it."""
        a = second.rotation @ self.axis
        velocities = []
        if self.turns:
            velocities.append(self._radius * ((second.angular_velocity - first.angular_velocity) @ a))
        if self.slides:
            velocities.append(self._sliding(first, second, place, a))
        n = len(velocities)
        rest = [jnp.zeros(())] * (3 - n)
        bristle = jnp.stack([*memory, *rest]) if self._law.bristle_size else jnp.zeros(3)
        traction, rate = self._tractions(jnp.stack([*velocities, *rest]), bristle)
        normal = self.model.distribution.across * loads[0] + self._preload
        around = self._radius * normal * traction[0] if self.turns else jnp.zeros(())
        along = normal * traction[n - 1] if self.slides else jnp.zeros(())
        energy = self._law.bristle_energy(bristle, normal)
        return Resistance(along * a, around * a, rate[: len(self.memory)], energy)

    def _sliding(self, first, second, place, a) -> Scalar:
        """Velocity of the second body's point against the first body, along the axis [m/s]."""
        point = point_motion(second, place)
        arm = point.position - first.position
        return (point.velocity - first.velocity - jnp.cross(first.angular_velocity, arm)) @ a


class CrossFriction(AbstractJointFriction):
    """Friction of a cross: a pin in the first body and one in the second, each with the radius and the preload.

    Attributes:
        model: law, radius, length, pressure and preload.
        first_axis: on the first body, body axes, unit length.
        second_axis: on the second body, body axes, unit length.
    """

    model: Ideal
    first_axis: Numeric
    second_axis: Numeric

    @property
    def directions(self):
        """Around each pin."""
        return ("bristle_first", "bristle_second")

    @property
    def n_loads(self):
        """The radial load of each pin."""
        return 2

    def _axes(self, first, second) -> tuple[Vector3, Vector3]:
        return first.rotation @ self.first_axis, second.rotation @ self.second_axis

    def loads(self, first, second, reaction):
        """The radial loads of the two pins."""
        return jnp.stack([radial_load(self.model, a, reaction) for a in self._axes(first, second)])

    def resist(self, first, second, place, loads, memory):
        """A moment about each pin."""
        radius, spin = self._radius, second.angular_velocity - first.angular_velocity
        moment, rates, energy, zero = jnp.zeros(3), [], jnp.zeros(()), jnp.zeros(())
        for i, a in enumerate(self._axes(first, second)):
            bristle = jnp.stack([memory[i], zero, zero]) if self._law.bristle_size else jnp.zeros(3)
            traction, rate = self._tractions(jnp.stack([radius * (spin @ a), zero, zero]), bristle)
            normal = self.model.distribution.across * loads[i] + self._preload
            moment = moment + radius * normal * traction[0] * a
            energy = energy + self._law.bristle_energy(bristle, normal)
            rates.append(rate[0])
        memory_rate = jnp.stack(rates) if self._law.bristle_size else jnp.zeros(0)
        return Resistance(jnp.zeros(3), moment, memory_rate, energy)


def radial_load(model: Ideal, axis: Vector3, reaction: Reaction) -> Scalar:
    """Sum of the loads at the two ends of a bearing, or of one without a length [N].

    Limits: 0 without a load, where the derivative is taken as 0.
    """
    radial = reaction.force - (reaction.force @ axis) * axis
    if model.length is None:
        return safe_norm(radial)
    couple = jnp.cross(axis, reaction.moment) / model.length
    return safe_norm(radial / 2 + couple) + safe_norm(radial / 2 - couple)


def friction_requirements(model: Ideal, *, turns: bool, slides: bool, is_ball: bool = False) -> list[Requirement]:
    """What a kind of joint asks of the friction in it."""
    if model.friction is None:
        return []
    found = []
    if turns and model.radius is None:
        remedy = "Give radius= [m]: of the ball, or of the shaft in its bearing; the law needs a sliding velocity."
        found.append(Requirement("radius", model.radius, False, "be given", remedy))
    if model.preload is not None and slides:
        remedy = "Give preload_force= [N]: the joint slides along its axis."
        found.append(Requirement("preload", model.preload, False, "be left out", remedy))
    if model.preload_force is not None and not slides:
        remedy = "Give preload= [N m]: the joint turns, and does not slide along an axis."
        found.append(Requirement("preload_force", model.preload_force, False, "be left out", remedy))
    if model.length is not None and is_ball:
        remedy = "A ball joint carries no moment; leave it out."
        found.append(Requirement("length", model.length, False, "be left out", remedy))
    return found

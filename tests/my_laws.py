"""Laws as a user writes them, in a file of their own, for the tests of scene files."""

from collections.abc import Callable
from typing import Annotated, ClassVar

import equinox as eqx
import jax.numpy as jnp

import spherejax as sj


class Magnet(sj.forces.AbstractForce):
    """Pulls a body towards a height."""

    body: str = eqx.field(static=True)
    stiffness: Annotated[float, sj.Unit("N/m")]
    height: Annotated[float, sj.Unit("m")] = 0.0
    is_on: bool = eqx.field(static=True, default=True)

    def wrenches(self, t, motions):
        lift = self.stiffness * (self.height - motions[self.body].position[2])
        force = jnp.stack([jnp.zeros(()), jnp.zeros(()), lift if self.is_on else 0.0 * lift])
        return {self.body: sj.forces.Wrench(force, jnp.zeros(3))}


class Viscous(sj.laws.AbstractStaticFriction):
    """Friction that grows with speed; its number is in any unit."""

    rate: float
    simulable: ClassVar[bool] = True

    def secant(self, speed):
        return self.rate + 0.0 * speed

    def requirements(self):
        return []


class WarmingFilm(sj.laws.AbstractFilm):
    """The full film of an oil that warms by what it absorbs, cools at a rate, and thins: nu exp(-thinning w)."""

    capacity: Annotated[float, sj.Unit("J/K")]
    cooling: Annotated[float, sj.Unit("1/s")] = 0.0
    thinning: Annotated[float, sj.Unit("1/K")] = 0.0

    @property
    def memory(self):
        return (sj.forces.MemoryEntry("warmth", "K", 1.0),)

    def action(self, motion, gap):
        warmth = motion.memory[0]
        found = sj.laws.FullFilm().action(
            motion, gap._replace(viscosity=gap.viscosity * jnp.exp(-self.thinning * warmth))
        )
        rate = (found.pressure_power + found.shear_power) / self.capacity - self.cooling * warmth
        return found._replace(memory_rate=rate[None])


def gust(t):
    """A force by time."""
    return jnp.stack([jnp.sin(t), 0.0 * t, 0.0 * t])


def hat(x):
    """A function of one number."""
    return 1.0 - x * x


def helix(place):
    """Two functions that vanish on a curve."""
    return jnp.stack([place[0] - jnp.cos(place[2]), place[1] - jnp.sin(place[2])])


class Motor(sj.forces.AbstractForce):
    """A torque by a function of time that is given to it."""

    body: str = eqx.field(static=True)
    torque: Callable

    def wrenches(self, t, motions):
        about = jnp.stack([jnp.zeros(()), jnp.zeros(()), self.torque(t)])
        return {self.body: sj.forces.Wrench(jnp.zeros(3), about)}


class Growth(eqx.Module):
    """A function with a number in it, of any arguments."""

    rate: Annotated[float, sj.Unit("N/m")]

    def __call__(self, x, *others):
        return self.rate * x


class Renamed(sj.forces.AbstractForce):
    """Keeps its argument under another name, so that nothing gives it back."""

    inner: float

    def __init__(self, outer):
        self.inner = 2.0 * outer

    def wrenches(self, t, motions):
        return {}

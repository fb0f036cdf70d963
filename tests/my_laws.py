"""Laws as a user writes them, in a file of their own, for the tests of scene files."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

import spherejax as sj


class Magnet(sj.AbstractForce):
    """Pulls a body towards a height."""

    units: ClassVar = {"stiffness": "N/m", "height": "m"}
    body: str = eqx.field(static=True)
    stiffness: float
    height: float = 0.0
    is_on: bool = eqx.field(static=True, default=True)

    def wrenches(self, t, motions):
        lift = self.stiffness * (self.height - motions[self.body].position[2])
        force = jnp.stack([jnp.zeros(()), jnp.zeros(()), lift if self.is_on else 0.0 * lift])
        return {self.body: sj.Wrench(force, jnp.zeros(3))}


class Viscous(sj.AbstractStaticFriction):
    """Friction that grows with speed; its number is in any unit."""

    rate: float
    simulable: ClassVar[bool] = True

    def secant(self, speed):
        return self.rate + 0.0 * speed

    def requirements(self):
        return []


class Renamed(sj.AbstractForce):
    """Keeps its argument under another name, so that nothing gives it back."""

    inner: float

    def __init__(self, outer):
        self.inner = 2.0 * outer

    def wrenches(self, t, motions):
        return {}

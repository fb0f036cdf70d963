"""The right front suspension of a car that passes over a bump, the paper's second mechanism (section 5.2)."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.types import Scalar, Vector3
from spherejax.model.drift import AbstractDriftControl
from spherejax.model.scene import Scene
from spherejax.physics.bodies import Body
from spherejax.physics.forces import AbstractForce, Wrench
from spherejax.physics.joints import AbstractSphericalModel, Ideal, Revolute, Spherical
from spherejax.physics.kinematics import point_motion


class Shock(AbstractForce):
    place: Vector3
    ground_point: Vector3

    def _line(self, motions):
        end = point_motion(motions["a_arm"], self.place)
        d = end.position - self.ground_point
        x = jnp.sqrt(d @ d)
        return end, d / x, x, d @ end.velocity / x

    def wrenches(self, t, motions):
        end, u, x, rate = self._line(motions)
        f = -4.0092e6 + x * (2.8397e7 + x * (-6.7061e7 + x * 5.2796e7))
        low = -416.42 + 1844.3 * rate
        high = 1919.1638 + 1634.727 * rate
        mid = rate * (9945.627 + rate * (33955.72 + rate * (-59832.25 + rate * -395651.0)))
        f = f + jnp.where(rate < -0.2, low, jnp.where(rate > 0.21, high, mid))
        F = -f * u
        return {"a_arm": Wrench(F, jnp.cross(end.arm, F))}

    def potential_energy(self, t, motions):
        _, _, x, _ = self._line(motions)
        return x * (-4.0092e6 + x * (2.8397e7 / 2 + x * (-6.7061e7 / 3 + x * 5.2796e7 / 4)))


class Leaf(AbstractForce):
    body: str = eqx.field(static=True)
    place: Vector3
    z0: Scalar

    def wrenches(self, t, motions):
        end = point_motion(motions[self.body], self.place)
        u = end.position[2] - self.z0
        f = 35900.0 * (0.076 + u) + jnp.where(u > 0.145, 1e7 * (u - 0.145), 0.0)
        F = jnp.array([0.0, 0.0, -1.0]) * f
        return {self.body: Wrench(F, jnp.cross(end.arm, F))}

    def potential_energy(self, t, motions):
        end = point_motion(motions[self.body], self.place)
        u = end.position[2] - self.z0
        over = jnp.where(u > 0.145, u - 0.145, 0.0)
        return 0.5 * 35900.0 * (0.076 + u) ** 2 + 0.5e7 * over**2


class Tyre(AbstractForce):
    def wrenches(self, t, motions):
        wheel = motions["wheel"]
        x = wheel.position[0] + 5.0 * t
        s = (x - 15.0) / 5.0
        road = jnp.where((s > 0) & (s < 1), 0.1 * (1 - jnp.cos(2 * jnp.pi * s)), 0.0)
        h = 0.36325 - (wheel.position[2] - road)
        f = 460e3 * jnp.where(h > 0, h, 0.0)
        return {"wheel": Wrench(jnp.array([0.0, 0.0, 1.0]) * f, jnp.zeros(3))}


def suspension(
    model: AbstractSphericalModel | None = None, *, drift: AbstractDriftControl | None = None, small=1e-2
) -> Scene:
    bodies = {
        "wheel": Body(57.35, (1.2402, 1.908, 1.2402), (0.0, -0.615, 0.356),
                      points=dict(a_arm=(0.0, 0.043, -0.127), leaf=(0.0, 0.127, 0.175), tie_rod=(-0.14, 0.167, 0.175))),
        "a_arm": Body(6.0, (0.052099, 0.023235, 0.068864), (0.0, -0.4155, 0.2655), (0.993445, 0.114315, 0.0, 0.0),
                      points=dict(pivot=(0.0, 0.16070003, 0.0), wheel=(0.0, -0.16070003, 0.0), shock=(0.075, -0.087856, -0.004667))),
        "leaf_spring": Body(small, small * np.array([0.0095, 0.0005, 0.0095]), (0.0, -0.32325, 0.5655), (0.994678, 0.103030, 0.0, 0.0),
                     points=dict(pivot=(0.0, 0.16832354, 0.0), tip=(0.0, -0.16832354, 0.0))),
        "tie_rod": Body(small, small * np.array([0.0123, 0.0005, 0.0123]), (-0.14, -0.259, 0.5655), (0.995928, 0.090153, 0.0, 0.0),
                     points=dict(ground=(0.0, 0.19212301, 0.0), wheel=(0.0, -0.19212301, 0.0))),
    }
    return Scene(
        bodies,
        {
            "a_arm_pivot": Revolute(("ground", "a_arm"), (0.0, -0.259, 0.302), (1.0, 0, 0)),
            "leaf_pivot": Revolute(("ground", "leaf_spring"), (0.0, -0.1585, 0.600), (1.0, 0, 0)),
            "wheel_a_arm": Spherical("a_arm.wheel", "wheel.a_arm", Ideal() if model is None else model),
            "wheel_leaf": Spherical("leaf_spring.tip", "wheel.leaf"),
            "wheel_tie_rod": Spherical("tie_rod.wheel", "wheel.tie_rod"),
            "tie_rod_ground": Spherical("ground.tie_rod", "tie_rod.ground"),
        },
        {
            "shock": Shock(np.array([0.075, -0.087856, -0.004667]), np.array([0.075, -0.297, 0.632])),
            "leaf": Leaf("wheel", np.array([0.0, 0.127, 0.175]), np.array(0.531)),
            "tyre": Tyre(),
        },
        ground_points={"tie_rod": (-0.140, -0.070, 0.600)},
        drift=drift,
    )

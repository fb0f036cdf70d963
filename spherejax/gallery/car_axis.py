"""The car axis problem of the test set for initial value problems: constraints that depend on time."""

import equinox as eqx
import jax.numpy as jnp

from spherejax.foundations.types import Number, Scalar
from spherejax.model.drift import AbstractDriftControl, PostStabilization
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.forces.spring_damper import SpringDamper
from spherejax.physics.joints.axial import Revolute
from spherejax.physics.joints.distance import Distance
from spherejax.physics.joints.drivers import RotationDriver
from spherejax.physics.joints.pairs import PointOnPlane

MASS, EPSILON, LENGTH, REST = 10.0, 1e-2, 1.0, 0.5
"""M, epsilon, L and L_0 of the problem; it has no units, and is read as if in SI."""


class AxleAngle(eqx.Module):
    """Slope of an axle of length L whose right end goes up and down: sin(angle) = (r / L) sin(w t).

    Attributes:
        amplitude: r [m], below L.
        frequency: w [rad/s].
        length: L [m].
    """

    amplitude: Number
    frequency: Number
    length: Number

    def __call__(self, t: Scalar) -> Scalar:
        """The angle [rad]."""
        height = self.amplitude * jnp.sin(self.frequency * t)
        return jnp.arctan2(height, jnp.sqrt(self.length * self.length - height * height))


def car_axis(*, amplitude: Number = 0.1, frequency: Number = 10.0, drift: AbstractDriftControl | None = None) -> Scene:
    """A car's axle on a bumpy road: the chassis, two point masses on a rigid bar, stands on two stiff springs.

    The left wheel stays at the origin, the right one, at the end of the axle of length 1, rises by r sin(w t). The left
    spring stays across the axle. All is in the x-y plane. Three degrees of freedom less one driven. What is hard: the
    constraints depend on time, and the springs (1e4 N/m under 5 kg, 7 Hz) are stiffer than the road is fast.

    The masses are `"left"` and `"right"`; the axle's own motion is prescribed, and its mass does not matter.

    Args:
        amplitude: r, amplitude of the road [m].
        frequency: w of the road [rad/s].
        drift: drift control; `PostStabilization()` by default.

    Source: Mazzia and Magherini, Test Set for IVP Solvers (release 2.4), Car Axis problem: M = 10, g = 1, L = 1,
    L_0 = 0.5, epsilon = 0.01, half the mass at each spring, spring constant 1 / epsilon^2, over 3 s.
    """
    speed = -REST / LENGTH * amplitude * frequency
    half, stiffness = MASS / 2, 1 / EPSILON**2
    bodies = {
        "left": _point_mass(half, (0.0, REST, 0.0), speed),
        "right": _point_mass(half, (LENGTH, REST, 0.0), speed),
        "axle": Body(
            1.0,
            (1.0, 1.0, 1.0),
            angular_velocity=(0.0, 0.0, amplitude * frequency / LENGTH),
            points={"wheel": (LENGTH, 0.0, 0.0)},
        ),
    }
    origin, z = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    joints = {
        "axle_pivot": Revolute((GROUND, "axle"), origin, z),
        "road": RotationDriver((GROUND, "axle"), z, AxleAngle(amplitude, frequency, LENGTH)),
        "bar": Distance("left.center", "right.center", LENGTH),
        "across": PointOnPlane("left.center", origin, (1.0, 0.0, 0.0), body="axle"),
        "left_in_plane": PointOnPlane("left.center", origin, z),
        "right_in_plane": PointOnPlane("right.center", origin, z),
    }
    springs = {
        "left_spring": SpringDamper(("ground.wheel", "left.center"), stiffness, free_length=REST),
        "right_spring": SpringDamper(("axle.wheel", "right.center"), stiffness, free_length=REST),
    }
    return Scene(
        bodies,
        joints,
        springs,
        gravity=(0.0, -1.0, 0.0),
        ground_points={"wheel": origin},
        drift=PostStabilization() if drift is None else drift,
    )


def _point_mass(mass: Number, position, speed: Number) -> Body:
    """A point mass: it does not turn, so that its moments do not matter."""
    points = {"center": (0.0, 0.0, 0.0)}
    return Body(mass, (1.0, 1.0, 1.0), position, velocity=(speed, 0.0, 0.0), points=points)

"""The planar slider-crank whose piston's pin has clearance: the case on which joints with play are mostly studied."""

import math

from spherejax.foundations.types import Number
from spherejax.model.drift import AbstractDriftControl
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.functions.shapes import Linear
from spherejax.physics.joints.axial import Prismatic, Revolute
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.drivers import RotationDriver
from spherejax.physics.joints.ideal import Ideal

CRANK, ROD = 0.05, 0.12
"""Lengths [m]."""

AXIS = (0.0, 1.0, 0.0)
"""About which crank and rod turn."""


def piston(
    model: AbstractSphericalModel | None = None,
    *,
    speed: Number = 5000 * 2 * math.pi / 60,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """A crank that a motor turns steadily, a rod, and a piston that slides along x; its pin may have clearance.

    The studied joint is `"pin"`, revolute, between rod and piston: ideal, a bushing, or a journal in a bearing with
    clearance, e.g. `Dry(5e-4, conformity=sj.laws.JohnsonCylinder(0.02))`. The motion begins with crank and rod in line,
    the piston at its outer dead center, with the velocities of the ideal mechanism. Other joints `"crank_pivot"`,
    `"crank_rod"`, `"guide"`, and the driver `"motor"`; bodies `"crank"`, `"rod"`, `"piston"`. Gravity along -z.

    Args:
        model: model of the studied joint; ideal by default.

    Other args:
        speed: angular velocity of the crank [rad/s].
        drift: drift control; `PostStabilization()` by default.

    Source: lengths, masses and speed as in Flores, Ambrosio and Claro (2004), Multibody Syst. Dyn. 12:47-74; moments of
    inertia that a motion in the plane does not feel are chosen.
    """
    end = CRANK + ROD
    bodies = {
        "crank": Body(
            0.30,
            (1e-5, 1e-4, 1e-4),
            (CRANK / 2, 0, 0),
            velocity=(0, 0, -speed * CRANK / 2),
            angular_velocity=(0, speed, 0),
        ),
        "rod": Body(
            0.21,
            (2.5e-5, 2.5e-4, 2.5e-4),
            (CRANK + ROD / 2, 0, 0),
            velocity=(0, 0, -speed * CRANK / 2),
            angular_velocity=(0, -speed * CRANK / ROD, 0),
        ),
        "piston": Body(0.14, (2e-5, 2e-5, 2e-5), (end, 0, 0)),
    }
    joints = {
        "crank_pivot": Revolute((GROUND, "crank"), (0, 0, 0), AXIS),
        "crank_rod": Revolute(("crank", "rod"), (CRANK, 0, 0), AXIS),
        "pin": Revolute(("rod", "piston"), (end, 0, 0), AXIS, Ideal() if model is None else model),
        "guide": Prismatic((GROUND, "piston"), (end, 0, 0), (1, 0, 0)),
        "motor": RotationDriver((GROUND, "crank"), AXIS, Linear(speed)),
    }
    return Scene(bodies, joints, drift=drift)

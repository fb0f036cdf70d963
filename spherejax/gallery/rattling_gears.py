"""A pair of gears that rattles: an idle wheel behind a shaft that does not turn evenly."""

import numpy as np

from spherejax.foundations.types import Number
from spherejax.model.drift import AbstractDriftControl, PostStabilization
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.forces.coupler import Turn
from spherejax.physics.forces.gear import Gear
from spherejax.physics.forces.torsional import TorsionalSpring
from spherejax.physics.functions.pieces import Sum
from spherejax.physics.functions.shapes import Linear, Sine
from spherejax.physics.joints.axial import Revolute
from spherejax.physics.joints.drivers import RotationDriver

PINION, WHEEL = 0.02, 0.05
"""Pitch radii [m]."""

MASSES, WIDTH = (0.25, 1.5), 0.02
"""Masses of pinion and wheel [kg], solid disks, and their width [m]."""


def rattling_gears(
    *,
    backlash: Number = 2e-4,
    stiffness: Number = 1e7,
    restitution: Number = 0.8,
    drag: Number = 2e-3,
    speed: Number = 10.0,
    amplitude: Number = 0.02,
    frequency: Number = 20.0,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """A pinion that is driven unevenly, and a wheel that idles in its mesh and rattles between the flanks.

    The pinion turns about z at `speed`, with a vibration on top, as a shaft of a gearbox behind an engine does. The
    wheel carries nothing but a drag. Where the vibration's acceleration throws the wheel off its flank, it crosses the
    backlash and hits the other one. Bodies `"pinion"` and `"wheel"`, force elements `"mesh"` and `"drag"`.

    Args:
        backlash: on the pitch circle [m].
        stiffness: of the mesh [N/m].
        restitution: of a meeting of flanks [-].
        drag: of the wheel [N m s/rad].
        speed: mean of the pinion [rad/s].
        amplitude: of the pinion's vibration [rad].
        frequency: of it [Hz].
        drift: drift control; `PostStabilization()` by default.

    Numbers are of no particular gearbox; the model is that of Pfeiffer and Kunert (1990), Nonlinear Dyn. 1:63-74, for
    one stage, with flanks of a stiffness.
    """
    axis, center = (0.0, 0.0, 1.0), (PINION + WHEEL, 0.0, 0.0)
    pinion, wheel = (
        Body(mass, _disk(mass, radius), place, points={"center": (0.0, 0.0, 0.0), "rim": (radius, 0.0, 0.0)})
        for mass, radius, place in zip(MASSES, (PINION, WHEEL), ((0.0, 0.0, 0.0), center), strict=True)
    )
    turns = Turn((GROUND, "pinion"), axis, PINION), Turn((GROUND, "wheel"), axis, WHEEL)
    return Scene(
        {
            "pinion": _turning(pinion, speed + amplitude * 2 * np.pi * frequency),
            "wheel": _turning(wheel, -speed * PINION / WHEEL),
        },
        {
            "pinion_bearing": Revolute((GROUND, "pinion"), (0.0, 0.0, 0.0), axis),
            "wheel_bearing": Revolute((GROUND, "wheel"), center, axis),
            "engine": RotationDriver((GROUND, "pinion"), axis, Sum(Linear(speed), Sine(amplitude, frequency))),
        },
        {
            "mesh": Gear(*turns, -1.0, backlash, stiffness, restitution=restitution),
            "drag": TorsionalSpring((GROUND, "wheel"), axis, damping=drag),
        },
        drift=PostStabilization() if drift is None else drift,
    )


def _disk(mass: float, radius: float) -> tuple[float, float, float]:
    across = mass * (radius**2 / 4 + WIDTH**2 / 12)
    return across, across, mass * radius**2 / 2


def _turning(body: Body, speed: Number) -> Body:
    return Body(body.mass, body.inertia, body.position, angular_velocity=(0.0, 0.0, speed), points=body.points)

"""The spatial slider-crank mechanism of Haug's textbook."""

import math

import numpy as np

from spherejax.foundations.types import Number
from spherejax.model.drift import AbstractDriftControl, PostStabilization
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.joints.axial import Prismatic, Revolute
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.pairs import Universal
from spherejax.physics.joints.spherical import Spherical

PIVOT, CRANK, ROD = (0.0, 0.1, 0.12), 0.08, 0.3
"""The crank's pivot [m], the crank's length and the connecting rod's length [m]."""

GUIDE = (1.0, 0.0, 0.0)
"""Direction of the slider's guide and of the crank's axis."""


def slider_crank(
    model: AbstractSphericalModel | None = None,
    *,
    speed: Number = 2 * math.pi,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """A crank that turns about x, above and beside the line on which a slider moves along x, and a rod between them.

    The studied joint is `"crank_rod"`, a ball in a socket on the crank; a universal joint holds the rod on the slider.
    One degree of freedom with ideal joints, none of the 23 equations redundant. The crank starts upright, with the
    slider at x = 0.2 m, and runs freely under gravity -z. Bodies `"crank"`, `"rod"`, `"slider"`.

    Args:
        model: model of the studied joint; ideal by default.

    Other args:
        speed: angular velocity of the crank at the start [rad/s]; the other bodies follow it.
        drift: drift control; `PostStabilization()` by default.

    Source: Haug (1989), Computer Aided Kinematics and Dynamics of Mechanical Systems, section 12.2. The composite
    revolute-cylindrical joint between rod and slider is a universal joint with its center on the slider.
    """
    pin = np.array([PIVOT[0], PIVOT[1], PIVOT[2] + CRANK])
    slider = np.array([math.sqrt(ROD**2 - pin[1] ** 2 - pin[2] ** 2), 0.0, 0.0])
    along = (slider - pin) / ROD
    across = _unit(np.cross(along, GUIDE))
    # Velocities per angular velocity of the crank: of pin and slider, and of the rod, whose cross keeps to the guide.
    pin_rate = np.array([0.0, -CRANK, 0.0])
    slider_rate = -pin @ pin_rate / slider[0] * np.array(GUIDE)
    tilting = np.cross(along, slider_rate - pin_rate) / ROD
    turning = tilting - np.cross(tilting, across)[0] / np.cross(along, across)[0] * along
    bodies = {
        "crank": Body(
            0.12,
            (1e-4, 1e-4, 1e-5),
            PIVOT,
            angular_velocity=(speed, 0.0, 0.0),
            points={"pin": (0.0, 0.0, CRANK)},
        ),
        "rod": Body(
            0.5,
            (4e-4, 4e-3, 4e-3),
            (pin + slider) / 2,
            _quaternion(along, across),
            velocity=speed * (pin_rate + slider_rate) / 2,
            angular_velocity=speed * turning,
            points={"pin": (-ROD / 2, 0.0, 0.0), "slider": (ROD / 2, 0.0, 0.0)},
        ),
        "slider": Body(2.0, (1e-4, 1e-4, 1e-4), slider, velocity=speed * slider_rate),
    }
    joints = {
        "crank_pivot": Revolute((GROUND, "crank"), PIVOT, GUIDE),
        "crank_rod": Spherical("crank.pin", "rod.pin", Ideal() if model is None else model),
        "rod_slider": Universal(("slider", "rod"), slider, GUIDE, across),
        "guide": Prismatic((GROUND, "slider"), slider, GUIDE),
    }
    return Scene(bodies, joints, drift=PostStabilization() if drift is None else drift)


def _unit(vector):
    return vector / np.linalg.norm(vector)


def _quaternion(first, second):
    """Unit quaternion of the axes with x along `first` and y along `second`; for a turn by less than a half."""
    matrix = np.column_stack([first, second, np.cross(first, second)])
    scalar = 0.5 * math.sqrt(1 + np.trace(matrix))
    skew = matrix - matrix.T
    return (scalar, *(np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / (4 * scalar)))

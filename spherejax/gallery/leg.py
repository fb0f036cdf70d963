"""A robot's leg whose knee is driven from the hip by a four-bar linkage."""

import math

import numpy as np

from spherejax.foundations.types import Number
from spherejax.gallery.rods import rod_inertia
from spherejax.model.drift import AbstractDriftControl, PostStabilization
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.functions.shapes import Sine
from spherejax.physics.joints.axial import Revolute
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.drivers import TranslationDriver
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.spherical import Spherical

THIGH, SHANK, CRANK, LEVER, ROD = 0.25, 0.25, 0.06, 0.05, 0.25
"""Lengths [m]: hip to knee, knee to foot, hip to the crank's pin, knee to the rod on the shank, and the rod."""

WIDTH = 0.02
"""Side of the sections [m]."""

MASSES = {"thigh": 1.2, "shank": 0.3, "crank": 0.08, "rod": 0.06}
"""[kg]"""

HIP, BEND = math.radians(35.0), math.radians(-80.0)
"""Start: the thigh's angle from the vertical, forward, and that of the shank against the thigh [rad]."""


def leg(
    model: AbstractSphericalModel | None = None,
    *,
    stride: Number = 0.08,
    lift: Number = 0.05,
    frequency: Number = 1.5,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """A leg in the plane of x and z: thigh, shank, and a crank at the hip that turns the knee by a rod.

    Both motors sit at the hip, one on the thigh, one on the crank, and the shank is carried by a closed loop: thigh,
    crank, rod and the shank's lever beyond the knee. The foot is guided along an ellipse by two drivers, so that
    `sj.inverse_dynamics` tells what the motors have to do:

        hip, knee = (sj.Turn(("ground", body), (0, 1, 0)) for body in ("thigh", "crank"))
        sj.inverse_dynamics(sj.gallery.leg(), ts, motors={"hip": hip, "knee": knee})

    Bodies `"thigh"`, `"shank"`, `"crank"`, `"rod"`, uniform rods; joints `"hip"`, `"knee"`, `"crank_pivot"`,
    `"crank_rod"` and the studied one, `"rod_shank"`. The trunk stands still.

    Args:
        model: model of the studied joint; ideal by default.
        stride: half length of the foot's path [m].
        lift: half height of it [m].
        frequency: steps in a second [Hz].
        drift: drift control; `PostStabilization()` by default.

    Numbers are of no particular robot.
    """
    hip = np.zeros(3)
    knee = hip + THIGH * _down(HIP)
    foot = knee + SHANK * _down(HIP + BEND)
    on_shank = knee - LEVER * _down(HIP + BEND)
    pin = _meeting(hip, CRANK, on_shank, ROD)
    ends = {"thigh": (hip, knee), "shank": (on_shank, foot), "crank": (hip, pin), "rod": (pin, on_shank)}
    names = {"thigh": ("hip", "knee"), "shank": ("lever", "foot"), "crank": ("pivot", "pin"), "rod": ("pin", "lever")}
    others = {"shank": {"knee": knee}}
    bodies = {name: _uniform(MASSES[name], ends[name], names[name], others.get(name, {})) for name in ends}
    axis = (0.0, 1.0, 0.0)
    return Scene(
        bodies,
        {
            "hip": Revolute((GROUND, "thigh"), hip, axis),
            "knee": Revolute(("thigh", "shank"), "thigh.knee", axis),
            "crank_pivot": Revolute((GROUND, "crank"), hip, axis),
            "crank_rod": Spherical("crank.pin", "rod.pin"),
            "rod_shank": Spherical("rod.lever", "shank.lever", Ideal() if model is None else model),
            "foot_x": TranslationDriver((GROUND, "shank"), "shank.foot", (1.0, 0.0, 0.0), Sine(stride, frequency)),
            "foot_z": TranslationDriver(
                (GROUND, "shank"), "shank.foot", (0.0, 0.0, 1.0), Sine(lift, frequency, -math.pi / 2, lift)
            ),
        },
        drift=PostStabilization() if drift is None else drift,
    )


def _down(angle: float) -> np.ndarray:
    """Down, turned forward by an angle."""
    return np.array([math.sin(angle), 0.0, -math.cos(angle)])


def _meeting(first, first_radius: float, second, second_radius: float) -> np.ndarray:
    """Where two circles in the plane meet, on the left of the way from the first center to the second."""
    way = second - first
    distance = float(np.linalg.norm(way))
    along = (distance**2 + first_radius**2 - second_radius**2) / (2 * distance)
    across = math.sqrt(first_radius**2 - along**2)
    left = np.array([-way[2], 0.0, way[0]]) / distance
    return first + along * way / distance + across * left


def _uniform(mass: float, ends, names: tuple[str, str], others) -> Body:
    """A rod whose axis is z of its body."""
    start, end = ends
    middle, way = (start + end) / 2, end - start
    length = float(np.linalg.norm(way))
    half = math.atan2(way[0], way[2]) / 2
    quaternion = (math.cos(half), 0.0, math.sin(half), 0.0)
    along = way / length

    def on_rod(place):
        return (0.0, 0.0, float((place - middle) @ along))

    points = {names[0]: on_rod(start), names[1]: on_rod(end), **{name: on_rod(x) for name, x in others.items()}}
    return Body(mass, rod_inertia(mass, length, WIDTH, 2), tuple(middle), quaternion, points=points)

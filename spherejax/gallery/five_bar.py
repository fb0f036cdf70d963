"""A planar parallel robot with two motors on the frame: five bars, the frame included."""

import math

import numpy as np

from spherejax.gallery.rods import rod_inertia
from spherejax.model.drift import AbstractDriftControl, PostStabilization
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.joints.axial import Revolute
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.drivers import RotationDriver
from spherejax.physics.joints.ideal import Ideal

BASE, CRANK, ROD = 0.12, 0.10, 0.16
"""Distance of the motors' axes, length of the cranks, and of the rods [m]."""

LEFT, RIGHT = math.radians(120.0), math.radians(60.0)
"""Angles of the two cranks from x at the start [rad]."""

MASSES, WIDTH = {"crank": 0.15, "rod": 0.12}, 0.012
"""[kg], [m]"""


def five_bar(model: AbstractSphericalModel | None = None, *, drift: AbstractDriftControl | None = None) -> Scene:
    """A planar robot of two cranks and two rods, whose tip is where the rods meet; both motors stand.

    In the plane of x and z. Bodies `"left_crank"`, `"left_rod"`, `"right_crank"`, `"right_rod"`; the joints of
    the cranks on the frame, `"left"` and `"right"`, are ideal, those of the rods, `"left_elbow"`, `"right_elbow"` and
    `"tip"`, have the model. Two drivers hold the motors, `"left_motor"` and `"right_motor"`.

    Args:
        model: model of the three joints of the rods, of a journal; ideal by default.
        drift: drift control; `PostStabilization()` by default.

    Numbers are of no particular robot.
    """
    axis = (0.0, 1.0, 0.0)
    feet = np.array([[-BASE / 2, 0.0, 0.0], [BASE / 2, 0.0, 0.0]])
    elbows = feet + CRANK * np.array([[math.cos(a), 0.0, math.sin(a)] for a in (LEFT, RIGHT)])
    middle, way = elbows.mean(axis=0), elbows[1] - elbows[0]
    half = float(np.linalg.norm(way)) / 2
    tip = middle + math.sqrt(ROD**2 - half**2) * np.array([-way[2], 0.0, way[0]]) / (2 * half)
    model = Ideal() if model is None else model
    bodies, joints = {}, {}
    for side, foot, elbow in zip(("left", "right"), feet, elbows, strict=True):
        bodies[f"{side}_crank"] = _bar(MASSES["crank"], foot, elbow, "elbow")
        bodies[f"{side}_rod"] = _bar(MASSES["rod"], elbow, tip, "tip")
        joints[side] = Revolute((GROUND, f"{side}_crank"), tuple(foot), axis)
        joints[f"{side}_elbow"] = Revolute((f"{side}_crank", f"{side}_rod"), tuple(elbow), axis, model)
        joints[f"{side}_motor"] = RotationDriver((GROUND, f"{side}_crank"), axis, rate=0.0)
    joints["tip"] = Revolute(("left_rod", "right_rod"), tuple(tip), axis, model)
    return Scene(bodies, joints, drift=PostStabilization() if drift is None else drift)


def _bar(mass: float, start, end, name: str) -> Body:
    """A uniform bar whose axis is x of its body, with a point at its end."""
    way = end - start
    length, half = float(np.linalg.norm(way)), -math.atan2(way[2], way[0]) / 2
    return Body(
        mass,
        rod_inertia(mass, length, WIDTH, 0),
        tuple((start + end) / 2),
        (math.cos(half), 0.0, math.sin(half), 0.0),
        points={"foot": (-length / 2, 0.0, 0.0), name: (length / 2, 0.0, 0.0)},
    )

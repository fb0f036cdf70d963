"""How the rig's answers are shown: labels, units, and why a position has none."""

import enum
from typing import NamedTuple

import numpy as np


class RigWarning(UserWarning):
    """A position of the rig has no result, or rests on what does not hold; the message says which, and what to do."""


class RigStatus(enum.IntEnum):
    """Whether a position on the rig was found; zero where it was."""

    FOUND = 0
    OUT_OF_REACH = 1
    NO_EQUILIBRIUM = 2
    UNLOADED = 3
    LOOSE = 4


REASONS = {
    RigStatus.OUT_OF_REACH: (
        "the joints do not close there: the suspension cannot reach this travel and steer. Ask for less"
    ),
    RigStatus.NO_EQUILIBRIUM: (
        "no equilibrium was found: what is elastic gives way too far under these loads. Check the stiffnesses, or go "
        "there with smaller loads"
    ),
    RigStatus.UNLOADED: (
        "a joint with clearance carries no load there, so that its ball has no place of its own. Load the wheel, or "
        "take sj.Ideal() for the joint"
    ),
    RigStatus.LOOSE: (
        "something is free to move under the loads: nothing holds it. Hold the steering (sj.Corner(steering=...)), or "
        "add the joint that is missing"
    ),
}
"""Why a position has no result."""


class Shown(NamedTuple):
    """How a characteristic is shown.

    Attributes:
        label: what it is called.
        si: its unit.
        unit: that of tables and figures.
        factor: from the one to the other.
    """

    label: str
    si: str
    unit: str
    factor: float


DEGREES = 180.0 / np.pi

SHOWN = {
    "toe": Shown("toe (toe-in positive)", "rad", "deg", DEGREES),
    "camber": Shown("camber (top outward positive)", "rad", "deg", DEGREES),
    "caster": Shown("caster", "rad", "deg", DEGREES),
    "kingpin_inclination": Shown("kingpin inclination", "rad", "deg", DEGREES),
    "scrub_radius": Shown("scrub radius", "m", "mm", 1e3),
    "caster_trail": Shown("caster trail", "m", "mm", 1e3),
    "track_change": Shown("half-track change", "m", "mm", 1e3),
    "recession": Shown("recession of the wheel's center", "m", "mm", 1e3),
    "center_travel": Shown("travel of the wheel's center", "m", "mm", 1e3),
    "wheel_load": Shown("wheel load", "N", "kN", 1e-3),
    "wheel_rate": Shown("wheel rate", "N/m", "N/mm", 1e-3),
    "motion_ratio": Shown("motion ratio (spring by wheel)", "1", "-", 1.0),
    "roll_center_height": Shown("roll center height", "m", "mm", 1e3),
    "braking_angle": Shown("anti-dive angle (braking)", "rad", "deg", DEGREES),
    "driving_angle": Shown("anti-lift angle (driving)", "rad", "deg", DEGREES),
    "toe_gradient": Shown("bump steer", "rad/m", "deg/m", DEGREES),
    "camber_gradient": Shown("camber gain", "rad/m", "deg/m", DEGREES),
    "steer_gradient": Shown("steer by rack", "rad/m", "deg/mm", DEGREES * 1e-3),
    "steering_effort": Shown("steering effort", "N", "N", 1.0),
}
"""The characteristics in the order of tables."""

COMPLIANCE_UNITS = {"toe": ("rad", "deg", DEGREES), "camber": ("rad", "deg", DEGREES)}
LOAD_UNITS = {"aligning": ("N m", "100 N m", 100.0)}


def compliance_shown(gives: str, load: str) -> Shown:
    """How a compliance coefficient is shown: deg or mm for a kN, or for 100 N m."""
    si, unit, factor = COMPLIANCE_UNITS.get(gives, ("m", "mm", 1e3))
    load_si, load_unit, load_factor = LOAD_UNITS.get(load, ("N", "kN", 1e3))
    return Shown(f"{gives} by {load} load", f"{si}/({load_si})", f"{unit}/({load_unit})", factor * load_factor)

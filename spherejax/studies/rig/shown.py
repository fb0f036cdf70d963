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
        "something is free to move under the loads: nothing holds it. Hold the steering "
        "(sj.vehicle.Corner(steering=...)), or "
        "add the joint that is missing"
    ),
}
"""Why a position has no result."""


class ShownCharacteristic(NamedTuple):
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
    "toe": ShownCharacteristic("toe (toe-in positive)", "rad", "deg", DEGREES),
    "camber": ShownCharacteristic("camber (top outward positive)", "rad", "deg", DEGREES),
    "caster": ShownCharacteristic("caster", "rad", "deg", DEGREES),
    "kingpin_inclination": ShownCharacteristic("kingpin inclination", "rad", "deg", DEGREES),
    "scrub_radius": ShownCharacteristic("scrub radius", "m", "mm", 1e3),
    "caster_trail": ShownCharacteristic("caster trail", "m", "mm", 1e3),
    "track_change": ShownCharacteristic("half-track change", "m", "mm", 1e3),
    "recession": ShownCharacteristic("recession of the wheel's center", "m", "mm", 1e3),
    "center_travel": ShownCharacteristic("travel of the wheel's center", "m", "mm", 1e3),
    "wheel_load": ShownCharacteristic("wheel load", "N", "kN", 1e-3),
    "wheel_rate": ShownCharacteristic("wheel rate", "N/m", "N/mm", 1e-3),
    "motion_ratio": ShownCharacteristic("motion ratio (spring by wheel)", "1", "-", 1.0),
    "roll_center_height": ShownCharacteristic("roll center height", "m", "mm", 1e3),
    "braking_angle": ShownCharacteristic("anti-dive angle (braking)", "rad", "deg", DEGREES),
    "driving_angle": ShownCharacteristic("anti-lift angle (driving)", "rad", "deg", DEGREES),
    "toe_gradient": ShownCharacteristic("bump steer", "rad/m", "deg/m", DEGREES),
    "camber_gradient": ShownCharacteristic("camber gain", "rad/m", "deg/m", DEGREES),
    "steer_gradient": ShownCharacteristic("steer by rack", "rad/m", "deg/mm", DEGREES * 1e-3),
    "steering_effort": ShownCharacteristic("steering effort", "N", "N", 1.0),
}
"""The characteristics in the order of tables."""

COMPLIANCE_UNITS = {"toe": ("rad", "deg", DEGREES), "camber": ("rad", "deg", DEGREES)}
LOAD_UNITS = {"aligning": ("N m", "100 N m", 100.0)}


def compliance_shown(gives: str, load: str) -> ShownCharacteristic:
    """How a compliance coefficient is shown: deg or mm for a kN, or for 100 N m."""
    si, unit, factor = COMPLIANCE_UNITS.get(gives, ("m", "mm", 1e3))
    load_si, load_unit, load_factor = LOAD_UNITS.get(load, ("N", "kN", 1e3))
    return ShownCharacteristic(
        f"{gives} by {load} load", f"{si}/({load_si})", f"{unit}/({load_unit})", factor * load_factor
    )

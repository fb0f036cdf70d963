"""Orientations as people state them: an axis and an angle, or three angles about named axes, as a quaternion."""

from typing import Any

import numpy as np

from spherejax.files.fields.fields import Context
from spherejax.files.fields.location import FilePlace
from spherejax.files.fields.quantities import listed, number, vector
from spherejax.physics.orientations import SEQUENCE, orientation

FORMS = '{ axis = [0, 0, 1], angle = "30 deg" } or { sequence = "ZXZ", angles = ["10 deg", "20 deg", 0] }'


UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])
"""The quaternion of no turn."""


def read_rotation(value: Any, place: FilePlace, context: Context) -> np.ndarray:
    """The quaternion, scalar first, that turns body axes into world axes.

    Two forms:

    * `{ axis, angle }`: the body is turned about the axis by the angle, by the right-hand rule; the axis is the same
      in body and world axes, and may have any length but zero.
    * `{ sequence, angles }`: turns one after another about coordinate axes. Capital letters, "ZXZ", mean the body's own
      axes, each where the turns before have brought it; small letters, "xyz", the axes of the world, which stay.
    """
    if not isinstance(value, dict) or set(value) not in ({"axis", "angle"}, {"sequence", "angles"}):
        place.fail(f"a rotation is written {FORMS}")
    if "axis" in value:
        axis = vector("1").read(value["axis"], place / "axis", context)
        angle = number("rad").read(value["angle"], place / "angle", context)
        length = float(np.linalg.norm(axis))
        if not 0 < length < np.inf:
            (place / "axis").fail("must be a direction; give a vector that is not zero")
        return orientation(axis=axis, angle=float(angle))
    return _sequence(value, place, context)


def product(p, q) -> np.ndarray:
    """The product of two quaternions, scalar first: the turn q, then the turn p."""
    return np.array([p[0] * q[0] - p[1:] @ q[1:], *(p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:]))])


def turned(quaternion, v) -> np.ndarray:
    """A vector in body axes in world axes."""
    p0, p = quaternion[0], np.asarray(quaternion[1:])
    return v + 2 * np.cross(p, np.cross(p, v) + p0 * np.asarray(v))


def turn_about(axis, angle: float) -> np.ndarray:
    """The quaternion of a turn about a unit vector [rad]."""
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * np.asarray(axis))])


def _sequence(value: Any, place: FilePlace, context: Context) -> np.ndarray:
    letters = value["sequence"]
    if not isinstance(letters, str) or not SEQUENCE.fullmatch(letters):
        (place / "sequence").fail(
            f'{letters!r} is no sequence of axes; write one to three of X, Y, Z, e.g. "ZXZ" for the body\'s own axes, '
            'or of x, y, z, e.g. "xyz" for those of the world, neighbors different'
        )
    angles = np.asarray(listed("rad").read(value["angles"], place / "angles", context))
    if len(angles) != len(letters):
        (place / "angles").fail(f"{len(angles)} angles for the {len(letters)} axes of {letters!r}; give one for each")
    return orientation(sequence=letters, angles=angles)

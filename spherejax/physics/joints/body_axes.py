"""From world axes at the start to body axes: where a joint described in the world meets its bodies."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement, concretely, is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.rotation import (
    conjugate,
    normalized,
    quaternion_product,
    rotation_matrix,
)
from spherejax.foundations.types import Numeric
from spherejax.physics.bodies import GROUND, Body, numbers

_ROUNDING = 1e-14
"""Entries of turned unit vectors below this are rounding, not geometry: they are made exact zeros when concrete."""


# Compiled once: scenes are built again and again, and a handful of single operations costs milliseconds.
@jax.jit
def _relative_start(socket: Numeric, ball: Numeric):
    return quaternion_product(conjugate(normalized(socket)), normalized(ball))


@jax.jit
def _in_turned_axes(quaternion: Numeric, vector: Numeric):
    return rotation_matrix(normalized(quaternion)).T @ vector


@jax.jit
def _out_of_turned_axes(quaternion: Numeric, vector: Numeric):
    return rotation_matrix(normalized(quaternion)) @ vector


def _found(function: Any, *arguments: Numeric) -> Numeric:
    """What a compiled function finds; by NumPy where all is NumPy's, for to load a compiled one takes 20 ms."""
    if all(isinstance(each, np.ndarray) for each in arguments):
        return function.__wrapped__(*arguments)
    return concretely(function, *arguments)


def start_quaternion(bodies: Mapping[str, Body], name: str):
    """Orientation of a body at the start, as described; the ground's is the identity."""
    return np.array([1.0, 0.0, 0.0, 0.0]) if name == GROUND else bodies[name].quaternion


def relative_start(bodies: Mapping[str, Body], first: str, second: str):
    """Orientation of the second body against the first at the start."""
    return _found(_relative_start, start_quaternion(bodies, first), start_quaternion(bodies, second))


def turned(bodies: Mapping[str, Body], name: str, vector):
    """A world vector in the axes that the body has at the start."""
    if name == GROUND:
        return vector
    return without_rounding(_found(_in_turned_axes, start_quaternion(bodies, name), vector))


def in_body(bodies: Mapping[str, Body], name: str, point):
    """A world point in the axes that the body has at the start, from its center of mass [m]."""
    if name == GROUND:
        return point
    return turned(bodies, name, point - bodies[name].position)


def in_world(bodies: Mapping[str, Body], name: str, place):
    """A place on a body as a world point at the start [m]."""
    if name == GROUND:
        return place
    return bodies[name].position + _found(_out_of_turned_axes, start_quaternion(bodies, name), place)


def world_at_start(bodies: Mapping[str, Body], name: str):
    """The world's origin [m] and its three axes, in the axes that a body has at the start."""
    x, y, z = np.eye(3)
    axes = turned(bodies, name, x), turned(bodies, name, y), turned(bodies, name, z)
    return in_body(bodies, name, np.zeros(3)), axes


def split_point(point) -> tuple[str | None, Numeric | None]:
    """A point as its name, if it is given by `"body.point"`, or as its numbers: one of the two is None.

    Raises:
        SceneError: for None, which would stand for the name.
    """
    if point is None:
        raise SceneError('None is no point; give three numbers in world axes at the start [m], or a name, "arm.tip"')
    return (point, None) if isinstance(point, str) else (None, numbers(point))


def places_of(bodies: Mapping[str, Body], find, pair: tuple[str, str], name: str | None, point):
    """A point, by its name or in world axes at the start, on each of two bodies, body axes [m]."""
    first, second = pair
    if name is None:
        return in_body(bodies, first, point), in_body(bodies, second, point)
    owner, place = find(name)
    world = in_world(bodies, owner, place)

    def on(body: str):
        # On the body that the point belongs to its numbers are taken as they are, without rounding.
        return place if body == owner else in_body(bodies, body, world)

    return on(first), on(second)


def split_second(point) -> tuple[str | None, Numeric | None]:
    """As `split_point`, of a second point that may be left out (None): then both are None."""
    return (None, None) if point is None else split_point(point)


def places_of_two(bodies: Mapping[str, Body], find, joint: Any):
    """A joint's point on each of its two bodies, body axes [m]: one point for both, or a second one for the second.

    Args:
        bodies: the scene's bodies.
        find: resolves `"body.point"`.
        joint: with `bodies`, `point`, `point_name`, `second_point` and `second_point_name`.
    """
    places = places_of(bodies, find, joint.bodies, joint.point_name, joint.point)
    if joint.second_point is None and joint.second_point_name is None:
        return places
    return places[0], places_of(bodies, find, joint.bodies, joint.second_point_name, joint.second_point)[1]


def unit(vector):
    """A vector divided by its length."""
    return vector / (vector**2).sum() ** 0.5


def perpendicular(axis):
    """A unit vector perpendicular to `axis` and to the coordinate direction that is farthest from it.

    Of directions that are equally far, to a millionth, it is the first one in the order x, y, z: an axis along z that
    has been computed, (1e-17, 0, 1), has the vector of (0, 0, 1). So the jumps, which there have to be, are a millionth
    beside the axes and diagonals, and not at them.
    """
    xp = np if is_concrete(axis) else jnp
    a = abs(axis)
    equal = _EQUALLY_FAR * a.sum()
    # Nested choices instead of argmin: they work on traced values.
    x, y, z = xp.eye(3)
    is_x = (a[0] <= a[1] + equal) & (a[0] <= a[2] + equal)
    helper = xp.where(is_x, x, xp.where(a[1] <= a[2] + equal, y, z))
    return unit(cross(axis, helper))


_EQUALLY_FAR = 1e-6
"""Share of an axis by which two coordinates may differ and still count as equal."""


def cross(a, b):
    """The vector product, in NumPy where both are known."""
    return np.cross(a, b) if is_concrete(a) and is_concrete(b) else jnp.cross(a, b)


def without_rounding(vector):
    """The vector with its rounding made exact zeros; traced ones pass."""
    if not is_concrete(vector):
        return vector
    array = np.array(vector)
    array[np.abs(array) < _ROUNDING] = 0.0
    return array


RIGHT_ANGLE_TOLERANCE = 1e-3
"""Cosine of the angle between two axes that still counts as a right one: printed tables carry few digits; the start is
assembled to the right angle."""

_UNDERFLOW = 1e-300
"""Keeps the cosine of a zero vector finite; the vector itself is refused."""


def right_angle_requirement(first, second, remedy: str) -> Requirement:
    """Two directions that are perpendicular, `first_axis` and `second_axis`."""
    cosine_squared = (first * second).sum() ** 2 / ((first**2).sum() * (second**2).sum() + _UNDERFLOW)
    is_right = cosine_squared < RIGHT_ANGLE_TOLERANCE**2
    return Requirement("second_axis", second, is_right, "be perpendicular to first_axis", remedy)


def point_requirements(point, field: str = "point") -> list[Requirement]:
    """A finite point; one given by name is checked with the scene's names."""
    if point is None:
        return []
    return [Requirement(field, point, abs(point) < np.inf, "be finite [m]", "Give three numbers.")]


def direction_requirement(axis, field: str = "axis") -> Requirement:
    """A direction: finite and not zero."""
    length = (axis**2).sum()
    return Requirement(field, axis, (length > 0) & (length < np.inf), "be a direction", "Give a non-zero vector.")


def frame_along(bodies: Mapping[str, Body], name: str, axis, second=None):
    """Axes with z along `axis`, as columns in the axes that a body has at the start, shape (3, 3).

    Args:
        bodies: the scene's bodies.
        name: the body.
        axis: a world direction at the start, any length.
        second: where x points, as nearly as it can; any direction across the axis where it is None.
    """
    z = unit(axis)
    x = perpendicular(z) if second is None else unit(cross(cross(z, second), z))
    columns = [turned(bodies, name, direction) for direction in (x, cross(z, x), z)]
    xp = np if all(is_concrete(column) for column in columns) else jnp
    return xp.stack([xp.asarray(column) for column in columns], 1)

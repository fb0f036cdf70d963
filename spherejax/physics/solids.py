"""Mass, moments and axes of homogeneous solids.

Source: integrals of the squared distances over the volume; any handbook has them.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement, concretely, enforce, is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import shape_of
from spherejax.foundations.rotation import normalized, quaternion_product
from spherejax.foundations.types import Number, Numeric, Quaternion, Triple, Vector3

HALF_TURN = (0.0, 0.0, 0.0, 1.0)
"""About z, as a quaternion: it takes x to -x."""


LETTERS = "xyz"
"""Names of the body's axes."""


class Solid(NamedTuple):
    """A body of one material.

    Attributes:
        mass: [kg].
        inertia: about the center of mass, body axes [kg m^2]: principal moments, shape (3,), or a matrix (3, 3).
    """

    mass: Number
    inertia: Numeric


def box(size: Triple, mass: Number | None, density: Number | None) -> Solid:
    """Edges along the axes: I_x = m (b^2 + c^2) / 12, and so on."""
    a, b, c = _sizes("Body.box", size=size)["size"]
    mass = mass_of("Body.box", mass, density, a * b * c)
    return _solid(mass, (a, b, c), mass / 12 * _row(b**2 + c**2, c**2 + a**2, a**2 + b**2))


def cylinder(
    radius: Number, length: Number, mass: Number | None, density: Number | None, axis: str | Triple = "x"
) -> Solid:
    """Along the x axis: I_x = m r^2 / 2, I_y = I_z = m (3 r^2 + l^2) / 12; along y and z with the moments exchanged.

    Along a unit vector n the inertia is the matrix I_y (1 - n n^T) + I_x n n^T.

    Raises:
        SceneError: for an axis that is no direction, and for sizes and masses that no cylinder has.
    """
    found = _sizes("Body.cylinder", radius=radius, length=length)
    r, l = found["radius"], found["length"]  # noqa: E741
    mass = mass_of("Body.cylinder", mass, density, math.pi * r**2 * l)
    across = (3 * r**2 + l**2) / 12
    along = r**2 / 2
    if isinstance(axis, str):
        if axis not in LETTERS:
            raise SceneError(f"Body.cylinder: axis = {axis!r} must be 'x', 'y', 'z', or a vector in body axes")
        return _solid(mass, (r, l), mass * _row(*(along if letter == axis else across for letter in LETTERS)))
    return _solid(mass, (r, l), mass * _about(_direction(axis), along, across))


def sphere(radius: Number, mass: Number | None, density: Number | None) -> Solid:
    """I = 2 m r^2 / 5."""
    r = _sizes("Body.sphere", radius=radius)["radius"]
    mass = mass_of("Body.sphere", mass, density, 4 / 3 * math.pi * r**3)
    moment = 2 / 5 * r**2
    return _solid(mass, (r,), mass * _row(moment, moment, moment))


class Between(NamedTuple):
    """Where a straight part lies that joins two places.

    Attributes:
        position: halfway [m].
        quaternion: turns the x axis to the second place.
        length: [m].
        names: of the two ends.
    """

    position: Vector3
    quaternion: Quaternion
    length: Float[Array, ""]
    names: tuple[str, str]


def between(ends: Mapping[str, Triple]) -> Between:
    """The straight line between two places.

    Raises:
        SceneError: for other than two ends, or two that coincide.
    """
    if not isinstance(ends, Mapping) or len(ends) != 2 or any(shape_of(place) != (3,) for place in ends.values()):
        raise SceneError(
            'Body.rod: ends must be two places by name. Write ends={"pin": (0.0, 0.0, 0.0), "tip": (0.1, 0.0, 0.0)}, '
            "world axes [m]."
        )
    first, second = ends.values()
    names = (*ends,)
    length, position, quaternion = concretely(_line, first, second)
    if is_concrete(length) and not length > 0:
        raise SceneError(f"Body.rod: the ends {names[0]!r} and {names[1]!r} coincide; a rod needs a length")
    return Between(position, quaternion, length, (names[0], names[1]))


def _line(first: Triple, second: Triple):
    """Length, middle, and the turn of the x axis: the shortest one, or that of -x after half a turn about z."""
    start, end = jnp.asarray(first, jnp.float64), jnp.asarray(second, jnp.float64)
    length = jnp.sqrt((end - start) @ (end - start))
    x, y, z = (end - start) / length
    ahead = normalized(jnp.stack([1 + jnp.maximum(x, 0.0), 0.0 * x, -z, y]))
    behind = quaternion_product(
        normalized(jnp.stack([1 - jnp.minimum(x, 0.0), 0.0 * x, z, -y])), jnp.asarray(HALF_TURN)
    )
    return length, (start + end) / 2, jnp.where(x >= 0, ahead, behind)


def _sizes(what: str, **sizes) -> dict:
    """Lengths as arrays, of NumPy where nothing is traced; those that are known must be positive."""
    found = {}
    for name, value in sizes.items():
        shape = (3,) if name == "size" else ()
        if shape_of(value) != shape:
            words = "three numbers, the edges" if shape else "one number"
            raise SceneError(f"{what}: {name} must be {words} [m]")
        is_known = all(is_concrete(leaf) for leaf in jax.tree.leaves(value))
        found[name] = np.asarray(value, np.float64) if is_known else jnp.asarray(value, jnp.float64)
    remedy = "Give lengths above zero [m]."
    enforce(
        what,
        [
            Requirement(name, value, (value > 0) & (value < np.inf), "be positive and finite", remedy)
            for name, value in found.items()
        ],
    )
    return found


def mass_of(what: str, mass: Number | None, density: Number | None, volume) -> Number:
    """The mass, given or from a density [kg/m^3] and a volume [m^3].

    Raises:
        SceneError: for both or neither, and for what is not one number.
    """
    if (mass is None) == (density is None):
        given = "neither" if mass is None else "both"
        raise SceneError(f"{what}: give mass= [kg] or density= [kg/m^3], not {given}")
    for name, value in (("mass", mass), ("density", density)):
        if value is not None and shape_of(value) != ():
            raise SceneError(f"{what}: {name} must be one number")
    return volume * density if mass is None else mass


def _direction(axis: Triple):
    """A unit vector, of NumPy where it is concrete; a traced one is not judged."""
    if shape_of(axis) != (3,):
        raise SceneError(f"Body.cylinder: axis = {axis!r} must be 'x', 'y', 'z', or three numbers in body axes")
    vector = concretely(lambda vector: jnp.asarray(vector, jnp.float64), axis)
    square = vector @ vector
    if is_concrete(square) and not 0 < square < np.inf:
        raise SceneError(f"Body.cylinder: axis = {axis!r} has no direction; give a finite vector other than zero")
    return vector / square**0.5


def _about(direction, along, across):
    """The inertia by unit mass of a body of revolution about a direction [m^2]."""
    projector = direction[:, None] * direction
    return across * (np.eye(3) - projector) + along * projector


def _row(*moments):
    return np.stack(moments) if all(is_concrete(moment) for moment in moments) else jnp.stack(moments)


def _solid(mass: Number, sizes: tuple, inertia) -> Solid:
    """Traced lengths cannot be refused here: where one is not positive no moment is, and the scene's check says so."""
    if not all(is_concrete(size) for size in sizes):
        is_solid = jnp.all(jnp.stack([size > 0 for size in sizes]))
        inertia = jnp.where(is_solid, inertia, -1.0)
    return Solid(mass, inertia)

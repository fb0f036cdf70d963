"""Orientations as people state them, as the quaternion that bodies have: scalar first, body axes to world axes."""

import re
from typing import Any

import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import visible
from spherejax.foundations.types import Number, Numeric

ORTHONORMAL = 1e-3
"""How far the columns of a rotation matrix may be from unit length and right angles: tables carry four digits."""

SEQUENCE = re.compile(r"(?:([XYZ])(?!\1)){1,3}|(?:([xyz])(?!\2)){1,3}")
_FORMS = (
    'orientation(axis=(0, 0, 1), angle=0.5), orientation(sequence="ZXZ", angles=(0.1, 0.2, 0.3)), '
    "orientation(matrix=A) or orientation(rotation=R)"
)


def orientation(
    *,
    axis: Numeric | None = None,
    angle: Number | None = None,
    sequence: str | None = None,
    angles: Numeric | None = None,
    matrix: Numeric | None = None,
    rotation: Any = None,
) -> Any:
    """The unit quaternion of an orientation, scalar first, shape (4,), for `Body(quaternion=...)`.

    Args:
        axis, angle: the body is turned about the axis by the angle [rad], by the right-hand rule; the axis has any
            length but zero.
        sequence, angles: turns one after the other about coordinate axes [rad]. Capital letters, "ZXZ", mean the body's
            own axes, each where the turns before have brought it; small letters, "xyz", the axes of the world. As
            `scipy.spatial.transform.Rotation.from_euler`.
        matrix: rotation matrix A, body axes to world axes, shape (3, 3).
        rotation: a `Rotation` of `scipy.spatial.transform`, or of `jax.scipy.spatial.transform`.

    Raises:
        SceneError: for none or several of the four forms, an axis of no length, or a matrix that is no rotation.
    """
    given = [axis is not None or angle is not None, sequence is not None or angles is not None]
    given += [matrix is not None, rotation is not None]
    if sum(given) != 1:
        raise SceneError(f"an orientation is stated in one way; write {_FORMS}")
    if given[0]:
        if axis is None or angle is None:
            raise SceneError("an axis and an angle belong together; write orientation(axis=(0, 0, 1), angle=0.5)")
        return _about(_as_vector("axis", axis), angle)
    if given[1]:
        if sequence is None or angles is None:
            raise SceneError('a sequence and its angles belong together; write orientation(sequence="ZXZ", angles=...)')
        return _in_turn(sequence, angles)
    return as_quaternion(matrix if given[2] else rotation)


def as_quaternion(given: Any) -> Any:
    """A quaternion, a rotation matrix or a `Rotation` as a quaternion, scalar first.

    Raises:
        SceneError: for a matrix that is no rotation.
    """
    if hasattr(given, "as_quat"):
        return _namespace(given.as_quat()).roll(given.as_quat(), 1)
    return _of_matrix(given) if np.shape(given) == (3, 3) else given


def _namespace(*numbers: Any) -> Any:
    """NumPy for numbers that are known, so that they stay so; JAX's for those that are traced."""
    return np if all(is_concrete(each) for each in numbers) else jnp


def _as_vector(name: str, given: Any) -> Any:
    given = visible(given)
    if np.shape(given) != (3,):
        raise SceneError(f"{name} = {given!r} must be three numbers")
    return jnp.asarray(given) if _namespace(*given) is jnp else np.asarray(given, float)


def _about(axis: Any, angle: Number) -> Any:
    length = _namespace(axis).sqrt(axis @ axis)
    if is_concrete(axis) and not 0 < float(length) < np.inf:
        raise SceneError(f"axis = {np.asarray(axis)} must be a direction; give a vector that is not zero")
    xp = _namespace(axis, angle)
    half = xp.asarray(angle) / 2
    return xp.concatenate([xp.cos(half)[None], xp.sin(half) * axis / length])


def _in_turn(sequence: str, angles: Any) -> Any:
    if not isinstance(sequence, str) or not SEQUENCE.fullmatch(sequence):
        raise SceneError(
            f'{sequence!r} is no sequence of axes; write one to three of X, Y, Z, e.g. "ZXZ" for the body\'s own axes, '
            'or of x, y, z, e.g. "xyz" for those of the world, neighbors different'
        )
    if np.ndim(angles) == 0 if hasattr(angles, "ndim") else not isinstance(angles, (tuple, list)):
        angles = [angles]
    if len(angles) != len(sequence):
        raise SceneError(f"{sequence!r} needs {len(sequence)} angles [rad]; given: {angles!r}")
    xp = _namespace(*angles)
    found = np.array([1.0, 0.0, 0.0, 0.0])
    for letter, angle in zip(sequence, angles, strict=True):
        turn = _about(np.eye(3)["xyz".index(letter.lower())], angle)
        found = _product(xp, found, turn) if sequence.isupper() else _product(xp, turn, found)
    return found


def _product(xp: Any, p: Any, q: Any) -> Any:
    """The turn q, then the turn p."""
    vector = p[0] * q[1:] + q[0] * p[1:] + xp.cross(p[1:], q[1:])
    return xp.concatenate([(p[0] * q[0] - p[1:] @ q[1:])[None], vector])


def _of_matrix(matrix: Any) -> Any:
    """By the largest of the four entries, so that nothing is divided by a small one (Shepperd, 1978)."""
    xp = _namespace(matrix)
    a = xp.asarray(matrix, float)
    if xp is np and not (np.abs(a.T @ a - np.eye(3)).max() < ORTHONORMAL and np.linalg.det(a) > 0):
        raise SceneError(
            f"the matrix\n{a}\nis no rotation: its columns must be the body's axes in world axes, of unit length, at "
            "right angles, right-handed"
        )
    squares = xp.stack(
        [
            1 + a[0, 0] + a[1, 1] + a[2, 2],
            1 + a[0, 0] - a[1, 1] - a[2, 2],
            1 - a[0, 0] + a[1, 1] - a[2, 2],
            1 - a[0, 0] - a[1, 1] + a[2, 2],
        ]
    )
    x, y, z = a[2, 1] - a[1, 2], a[0, 2] - a[2, 0], a[1, 0] - a[0, 1]
    xy, xz, yz = a[1, 0] + a[0, 1], a[0, 2] + a[2, 0], a[2, 1] + a[1, 2]
    rows = xp.stack(
        [
            xp.stack([squares[0], x, y, z]),
            xp.stack([x, squares[1], xy, xz]),
            xp.stack([y, xy, squares[2], yz]),
            xp.stack([z, xz, yz, squares[3]]),
        ]
    )
    largest = rows[xp.argmax(squares)]
    return largest / xp.sqrt(largest @ largest)

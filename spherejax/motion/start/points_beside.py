"""Joints with one point that stand beside a named point: most likely the body is not where its joint is."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

import numpy as np

from spherejax.foundations.checks import is_concrete
from spherejax.model.scene import Scene
from spherejax.model.system import System
from spherejax.motion.start.positions import FAR_SHARE
from spherejax.physics.bodies import GROUND
from spherejax.physics.joints.axial import Revolute
from spherejax.physics.joints.pairs import Universal

NEAR_SHARE = 0.3
"""A named point nearer than this share of the body's size may have been meant; one farther off is another place."""


def points_beside(scene: Scene, system: System) -> tuple[str, ...]:
    """Sentences about revolute and universal joints near a point of a body that was probably meant; mostly empty.

    A joint with one point takes that point on both bodies, wherever they are described: a body that is described 5 cm
    off keeps these 5 cm, and nothing is left to be closed. Its sign is a named point of the body that no joint and
    no force element uses, near the joint but not at it, while the joint is at a point of the other body.

    Args:
        scene: the scene as it is described.
        system: the system compiled from it; geometry that is traced is not looked at.
    """
    one_point = {
        name: joint
        for name, joint in scene.joints.items()
        if isinstance(joint, Revolute | Universal) and joint.second_point is None and joint.second_point_name is None
    }
    if not one_point or not any(body.points for body in scene.bodies.values()):
        return ()
    named = _named_points(scene)
    # Looked up where a point is near: most joints are at the points that they name, and to walk through all parts takes
    # longer than all else here.
    used = cache(lambda: {text for part in (*scene.joints.values(), *scene.forces.values()) for text in _texts(part)})
    said = []
    for name, joint in one_point.items():
        places = tuple(zip(joint.bodies, system.joints[name].points, strict=True))
        if not all(is_concrete(place) for _, place in places):
            continue
        for (body, place), (other, other_place) in (places, places[::-1]):
            if body == GROUND or not named.get(body):
                continue
            size = _size(body, named[body].values(), system)
            gaps = {point: _distance(at, place) for point, at in named[body].items()}
            if min(gaps.values()) <= FAR_SHARE * size:
                continue
            nearest = min(gaps, key=lambda point: gaps[point])
            if not (gaps[nearest] < NEAR_SHARE * size and _is_at_a_point(other, other_place, named)):
                continue
            if f"{body}.{nearest}" not in used() and not _is_met(body, named[body][nearest], system):
                said.append(_message(name, joint, body, nearest, gaps[nearest]))
    return tuple(said)


def _named_points(scene: Scene) -> dict[str, dict[str, np.ndarray]]:
    """Known points by body and name, the ground's among them, body axes [m]."""
    of_body = {name: body.points for name, body in scene.bodies.items()} | {GROUND: scene.ground_points}
    return {
        name: {point: np.asarray(place) for point, place in points.items() if is_concrete(place)}
        for name, points in of_body.items()
    }


def _texts(part: Any) -> Iterator[str]:
    """All texts in the fields of a joint or force element, of its coordinates and models too."""
    if isinstance(part, str):
        yield part
    elif isinstance(part, tuple | list):
        for item in part:
            yield from _texts(item)
    elif is_dataclass(part):
        for field in fields(part):
            yield from _texts(getattr(part, field.name, None))


def _met(body: str, system: System) -> list[np.ndarray]:
    """Places of joints on a body, body axes [m]."""
    joints = [joint for joint in system.joints.values() if body in joint.bodies]
    places = [joint.points[joint.bodies.index(body)] for joint in joints]
    return [np.asarray(place) for place in places if is_concrete(place)]


def _is_met(body: str, place: np.ndarray, system: System) -> bool:
    return any(_distance(place, met) < 1e-9 for met in _met(body, system))


def _size(body: str, points: Any, system: System) -> float:
    """The largest distance between the named points, the places of joints and the center of mass [m]."""
    places = np.array([np.zeros(3), *points, *_met(body, system)])
    return float(np.linalg.norm(places[:, None] - places, axis=-1).max())


def _is_at_a_point(body: str, place: Any, named: dict[str, dict[str, np.ndarray]]) -> bool:
    """Whether a place is one of a body's named points, or the ground's, on which nobody needs to name points."""
    points = named.get(body, {}).values()
    return body == GROUND or any(_distance(place, point) < 1e-9 for point in points)


def _distance(a: Any, b: Any) -> float:
    return float(np.linalg.norm(np.asarray(a) - np.asarray(b)))


def _message(name: str, joint: Revolute | Universal, body: str, point: str, gap: float) -> str:
    meant = repr(f"{body}.{point}")
    remedy = f"give the joint second_point={meant}"
    if joint.bodies[0] == body:
        present = repr(joint.point_name) if joint.point_name is not None else "its present point"
        remedy = f"give the joint point={meant} and second_point={present}"
    return (
        f"joint {name!r} ({type(joint).__name__}) is {gap:.3g} m beside point {meant}, which nothing else uses. A "
        "joint with one point takes that point on both bodies, wherever they are described. If "
        f"{meant} belongs in the joint, {remedy}: the start is then closed. If not, "
        "second_point= the same as point= says so"
    )

"""A scene: bodies, joints and forces by name, as the user describes it, and the checks of it."""

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool

from spherejax.foundations.behind_tracers import known_behind
from spherejax.foundations.checks import Requirement, called, enforce, is_tracing, shown
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import malformed, mapping_of, of_form
from spherejax.foundations.types import Numeric, Triple
from spherejax.model.drift import AbstractDriftControl, PostStabilization
from spherejax.physics.bodies import GROUND, Body, in_arrays, numbers
from spherejax.physics.forces.base import AbstractForce
from spherejax.physics.joints.joint import AbstractJoint
from spherejax.program_cache.keys import KeyedTree, LruCache, lru_get


class Scene(eqx.Module):
    """A mechanism, described by names.

    Attributes:
        bodies: moving bodies by name; the name `"ground"` is taken.
        joints: joints by name.
        forces: force elements by name.
        gravity: acceleration of gravity, world axes [m/s^2], shape (3,).
        ground_points: points fixed in the world by name, world axes [m].
        drift: how drift off the constraints is held back: `PostStabilization()` (default), `Projection()`,
            `Baumgarte()` or `NoDriftControl()`.

    Scenes are pytrees: every physical number in them is a leaf that can be swept, batched and differentiated. Numbers
    are arrays of NumPy from here on (`np.float64`, which is a `float` too): transformations that look for arrays, such
    as `equinox.filter_grad` and `equinox.filter_jit`, take all of them. What is put into the dictionaries later stays
    as it is given.
    """

    bodies: Mapping[str, Body]
    joints: Mapping[str, AbstractJoint]
    forces: Mapping[str, AbstractForce]
    gravity: Triple
    ground_points: Mapping[str, Triple]
    drift: AbstractDriftControl

    def __init__(
        self,
        bodies: Mapping[str, Body],
        joints: Mapping[str, AbstractJoint] | None = None,
        forces: Mapping[str, AbstractForce] | None = None,
        *,
        gravity: Sequence[float] = (0.0, 0.0, -9.81),
        ground_points: Mapping[str, Numeric] | None = None,
        drift: AbstractDriftControl | None = None,
    ):
        self.bodies = mapping_of("bodies", bodies, '{"arm": sj.Body(...)}')
        joints = mapping_of("joints", {} if joints is None else joints, '{"elbow": sj.Spherical(...)}')
        forces = mapping_of("forces", {} if forces is None else forces, '{"spring": sj.SpringDamper(...)}')
        # Bodies have arrays of their own; a part at a time, for JAX sorts the keys of a dictionary.
        self.joints = {name: in_arrays(part) for name, part in joints.items()}
        self.forces = {name: in_arrays(part) for name, part in forces.items()}
        self.gravity = numbers(gravity)
        places = mapping_of(
            "ground_points", {} if ground_points is None else ground_points, '{"hook": (0.0, 0.0, 1.0)}'
        )
        self.ground_points = {name: numbers(place) for name, place in places.items()}
        self.drift = in_arrays(PostStabilization() if drift is None else drift)

    def find(self, name: str) -> tuple[str, Numeric]:
        """Resolve `"body.point"` to the body's name and the point in its axes [m].

        Raises:
            SceneError: for an unknown body or point, naming those that exist.
        """
        body, dot, point = name.partition(".")
        if not dot:
            raise SceneError(f"{name!r} is no point: write 'body.point', e.g. 'rocker.pivot'")
        called(self, "require_body", body, f"point {name!r}")
        places = self.ground_points if body == GROUND else self.bodies[body].points
        if point not in places:
            remedy = "Give it in ground_points=." if body == GROUND else "Add it to the body's points."
            raise SceneError(f"body {body!r} has no point {point!r}; it has {_listed(places)}. {remedy}")
        return body, places[point]

    def require_body(self, body: str, where: str) -> None:
        """Raise `SceneError` when no body has this name."""
        if body != GROUND and body not in self.bodies:
            raise SceneError(f"{where}: there is no body {body!r}; the scene has {_listed([*self.bodies, GROUND])}")


def check_scene(scene: Scene) -> list:
    """Check names, connections and values.

    Returns:
        Boolean scalars, one for each condition on a traced value; they decide the status of that lane.

    Raises:
        SceneError: naming the joint, body or force, the value and the remedy.
    """
    if not isinstance(scene, Scene):
        raise SceneError(
            f"a {type(scene).__name__} is no scene: {shown(scene)}. Give an sj.Scene; sj.load_scene reads a file"
        )
    new = [each for each in _parts(scene) if each.values is None or each.values not in _right]
    _check_forms(scene, new)
    _check_drift(scene)
    _check_names(scene)
    _check_connected(scene)
    conditions = [condition for place, required in scene_requirements(scene) for condition in enforce(place, required)]
    for kind, name, part, values, is_own in new:
        place = f"{kind} {name!r}"
        found = conditions_of(place, part) if is_own else enforce(place, called(part, "requirements"))
        conditions += found
        if not found and values is not None:
            lru_get(_right, values, lambda: True)
    return conditions


def conditions_of(place: str, part: Any) -> list[Bool[Array, ""]]:
    """Raise `SceneError` where a part of this package's code is not legal; return the conditions that nobody can look
    at now.

    Outside of `jax.jit` its numbers are looked at by NumPy, those behind the tracers of `jax.grad` and `jax.jvp` too:
    as operations of JAX they took a sixth of what a call of a gradient does besides its run.

    Args:
        place: where the part is, for the error.
        part: with `requirements`.
    """
    behind = known_behind(part)
    if len(behind) == 1 and (behind[0] is part or not is_tracing()):
        numbers = jax.tree.map(lambda leaf: np.asarray(leaf) if isinstance(leaf, jax.Array) else leaf, behind[0])
        if all_hold(called(numbers, "requirements")):
            return []
    return enforce(place, called(part, "requirements"))


def all_hold(requirements: Iterable[Requirement]) -> bool:
    """Whether all of these hold, of known numbers."""
    # NumPy's `all` takes 3 us of a number by itself, and there are dozens.
    conditions: list[Any] = [requirement.satisfied for requirement in requirements]
    return all(bool(x) if isinstance(x, bool | np.bool_) else bool(np.all(x)) for x in conditions)


class _Part(NamedTuple):
    """A body, a joint or a force element; its kind, all that is in it, to be compared, None where it cannot be, and
    whether no code of a user's is in it."""

    kind: str
    name: str
    part: Any
    values: Hashable | None
    is_own: bool


def _parts(scene: Scene) -> Iterator[_Part]:
    for kind, parts in (("body", scene.bodies), ("joint", scene.joints), ("force", scene.forces)):
        for name, part in parts.items():
            reading = KeyedTree(part)
            values = None if reading.key is None else (kind, reading.key)
            yield _Part(kind, name, part, values, reading.user_code == "")


N_PARTS = 1024
"""Parts that are remembered: who changes one number of a scene need not have all others looked at again."""

_right = LruCache(N_PARTS)
"""Parts that were found to be as they must be."""


def scene_requirements(scene: Scene) -> Iterator[tuple[str, list[Requirement]]]:
    """What the numbers of a scene that belong to no part must satisfy, with what they belong to."""
    gravity = Requirement(
        "gravity", scene.gravity, abs(scene.gravity) < np.inf, "be finite [m/s^2]", "Give three numbers."
    )
    yield "scene", [gravity]
    yield "drift control", called(scene.drift, "requirements")
    yield (
        "ground points",
        [
            Requirement(name, place, abs(place) < np.inf, "be finite [m]", "Give three numbers.")
            for name, place in scene.ground_points.items()
        ],
    )


_KINDS: dict[str, tuple[type, str]] = {
    "body": (Body, "sj.Body(mass, inertia)"),
    "joint": (AbstractJoint, 'sj.Spherical("arm.tip", "rod.top", model) or sj.Revolute(...)'),
    "force": (AbstractForce, "sj.SpringDamper(...)"),
}
"""What each kind of part is, and an example."""


def _check_forms(scene: Scene, parts: Iterable[_Part]) -> None:
    """Every part is what its place is for, and holds numbers, names and objects where they belong."""
    for kind, name, part, *_ in parts:
        family, example = _KINDS[kind]
        if not isinstance(part, family):
            raise SceneError(f"{kind} {name!r} = {shown(part)} is no {kind}; give an object, e.g. {example}")
        enforce(f"{kind} {name!r}", malformed(part))
    for name in ("gravity", "ground_points"):
        enforce("scene", of_form(name, getattr(scene, name), type(scene).__annotations__[name]))


def _check_drift(scene: Scene) -> None:
    if not isinstance(scene.drift, AbstractDriftControl):
        raise SceneError(
            f"drift = {scene.drift!r} is no drift control; give PostStabilization(), Projection(), Baumgarte(), "
            "NoDriftControl(), or an AbstractDriftControl of your own"
        )
    enforce("drift control", malformed(scene.drift))


def _check_names(scene: Scene) -> None:
    if not scene.bodies:
        raise SceneError("the scene has no body; give bodies={'name': Body(...)}")
    if GROUND in scene.bodies:
        raise SceneError(f"the body name {GROUND!r} is taken by the world; give the body another name")
    for name, joint in scene.joints.items():
        first, second = joint_bodies(scene, joint)
        for body in (first, second):
            called(scene, "require_body", body, f"joint {name!r}")
        if first == second:
            raise SceneError(f"joint {name!r} joins body {first!r} to itself; name two different bodies")
    for name, force in scene.forces.items():
        for body in force.body_names:
            called(scene, "require_body", body, f"force {name!r}")


def joint_bodies(scene: Scene, joint: AbstractJoint) -> tuple[str, str]:
    """Names of the two bodies that a joint joins."""
    return called(joint, "joined", partial(called, scene, "find"))


def _check_connected(scene: Scene) -> None:
    """Refuse what is most likely a mistake: a body left out, or a mechanism in two parts that do not act on each other.

    Force elements connect the bodies that they name; one that names none may act on any body, and nothing is refused.
    A scene without joints is a scene of free bodies.
    """
    named = [force.body_names for force in scene.forces.values()]
    if not scene.joints or not all(named):
        return
    links = [joint_bodies(scene, joint) for joint in scene.joints.values()]
    jointed = [name for name in scene.bodies if any(name in link for link in links)]
    touched = {name for names in [*links, *named] for name in names}
    loose = [name for name in scene.bodies if name not in touched]
    if loose:
        raise SceneError(
            f"body {loose[0]!r} is joined to nothing, and no force element names it, while the others form a "
            "mechanism; add a joint, remove the body, or simulate it in a scene of its own"
        )
    # Two mechanisms that both stand on the ground are connected through it.
    reached = _connected_with(jointed[0], [*links, *named])
    apart = [name for name in jointed if name not in reached]
    if apart:
        raise SceneError(
            f"body {apart[0]!r} is not connected to body {jointed[0]!r}; add a joint between the two groups, a force "
            "element, or simulate them in scenes of their own"
        )


def _connected_with(start: str, links: Sequence[tuple[str, ...]]) -> set[str]:
    """Names that can be reached from one by links."""
    reached, grows = {start}, True
    while grows:
        more = {name for link in links if reached & set(link) for name in link} - reached
        reached, grows = reached | more, bool(more)
    return reached


def _listed(names) -> str:
    return ", ".join(repr(name) for name in names) or "none"

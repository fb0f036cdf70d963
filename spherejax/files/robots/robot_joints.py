"""What the joints of a robot description become: joints, dampers, friction, stops, and couplers of those that mimic."""

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from spherejax.files.fields.rotations import turned
from spherejax.files.robots.robot import SLIDING, TURNING, Edge, Robot
from spherejax.files.robots.robot_bodies import FOOT, LinkGroups, three_feet
from spherejax.foundations.errors import SceneError, one_of
from spherejax.physics.forces.base import AbstractForce
from spherejax.physics.forces.bump_stop import BumpStop
from spherejax.physics.forces.coupler import Coupler, Travel, Turn
from spherejax.physics.forces.spring_damper import SpringDamper
from spherejax.physics.forces.torsional import TorsionalSpring
from spherejax.physics.forces.torsional_stop import TorsionalStop
from spherejax.physics.functions.pieces import Piecewise
from spherejax.physics.functions.shapes import Constant, Linear
from spherejax.physics.joints.axial import Cylindrical, Prismatic, Revolute
from spherejax.physics.joints.distance import Distance
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.joint import AbstractJoint
from spherejax.physics.joints.orientation import ParallelAxes, PerpendicularAxes, SameOrientation
from spherejax.physics.joints.pairs import PointOnPlane, Universal
from spherejax.physics.joints.spherical import Spherical
from spherejax.physics.laws.friction import AbstractFrictionLaw
from spherejax.physics.laws.pressure import PreloadAlone

_RADIUS = 1.0
"""Of the shaft in a joint with friction [m]: with 1 the law's sliding velocity is the joint's rate in rad/s."""


_STOP = ("stiffness", "damping", "onset", "restitution", "transition")
"""What a stop of a joint may be given, besides its limits."""


def _is_stop(value: Any) -> bool:
    """Whether this says how a stop resists: a stiffness, or a mapping with one."""
    if isinstance(value, Mapping):
        return set(value) <= set(_STOP) and _is_stop(value.get("stiffness"))
    return isinstance(value, int | float | np.number) and bool(0 < value < np.inf)


class Ways(NamedTuple):
    """What a description leaves open.

    Attributes:
        friction: law by which friction changes with the rate, or None.
        mimic: arguments of couplers, by "turning", "sliding" or a joint's name.
        stops: stiffness beyond the limits [N m/rad or N/m], or arguments of `TorsionalStop` or `BumpStop`, or None, by
            the same words.
        ignore: what is left out.
    """

    friction: AbstractFrictionLaw | None
    mimic: Mapping[str, Any]
    stops: Mapping[str, Any]
    ignore: Collection[str]

    def check(self, robot: Robot) -> None:
        """Names and numbers.

        Raises:
            SceneError: for a word that is no joint, and for what is no stiffness.
        """
        movable = [name for name, edge in robot.edges.items() if edge.kind in (*TURNING, *SLIDING)]
        for what, given in (("mimic", self.mimic), ("stops", self.stops)):
            for name, value in given.items():
                known = ["turning", "sliding", *movable]
                if name not in known:
                    raise SceneError(f"{robot.path}: {what}: no joint {name!r} turns or slides; {one_of(known, name)}")
                if what == "stops" and value is not None and not _is_stop(value):
                    raise SceneError(
                        f"{robot.path}: stops[{name!r}] = {value!r} must be a stiffness above zero [N m/rad] or "
                        "[N/m], None for no stop, or a stiffness and what else a stop has, as "
                        f'stops={{{name!r}: {{"stiffness": 500.0, "restitution": 0.5}}}}; it may have '
                        f"{', '.join(_STOP)}"
                    )
                if what == "mimic" and not (isinstance(value, Mapping) and set(value) <= {"stiffness", "damping"}):
                    raise SceneError(
                        f"{robot.path}: mimic[{name!r}] = {value!r} must hold a stiffness and, if wanted, a damping; "
                        f'write mimic={{{name!r}: {{"stiffness": 50.0, "damping": 0.1}}}}'
                    )

    def of(self, given: Mapping[str, Any], name: str, edge: Edge) -> Any:
        """What is given for a joint: by its name, or by how it moves."""
        return given.get(name, given.get("turning" if edge.kind in TURNING else "sliding"))


def stack_joints(
    name: str, edge: Edge, groups: LinkGroups, slides: np.ndarray, turns: np.ndarray | None
) -> dict[str, AbstractJoint]:
    """The joints of a body that slides along some axes and turns about others, at one point, nothing between.

    The point stays in planes along the axes of the slides, on the body that carries them; directions that stay hold the
    bodies' turns. Named by the joint with _1, _2, ... where there are several.

    Args:
        name: of the joint.
        edge: as described.
        groups: which links are one body.
        slides: axes of slides, world axes at the start, as rows.
        turns: axes of turns, world axes at the start: the first stays on the parent, a second one, perpendicular to it,
            on the child; None: it turns freely.
    """
    parent, hand, foot = groups.heads[edge.parent], groups.hands[name], groups.feet[name]
    owner, point, through = (edge.child, foot, hand) if edge.slides_on_child else (parent, hand, foot)
    # The rows behind the rank of the slides are what they leave out.
    normals = np.linalg.svd(slides)[2][len(slides) :]
    found: list[AbstractJoint] = [PointOnPlane(point, through, normal, owner) for normal in normals]
    bodies = (parent, edge.child)
    if turns is not None:
        match len(turns):
            case 0:
                found.append(SameOrientation(bodies, hand))
            case 1:
                found.append(ParallelAxes(bodies, hand, turns[0]))
            case _:
                found.append(PerpendicularAxes(bodies, hand, turns[0], turns[1]))
    if len(found) == 1:
        return {name: found[0]}
    return {f"{name}_{k}": joint for k, joint in enumerate(found, start=1)}


def hinge_joints(name: str, edge: Edge, groups: LinkGroups, axes: np.ndarray) -> dict[str, AbstractJoint]:
    """The joints of two hinges with a link without mass between them, which keeps its shape.

    It keeps the distance of the axes where they are nearest, what each end may do along its axis, and the angle of the
    axes: by the distance of two points on them. Named by the first hinge with _1, _2, ...

    Args:
        name: of the first hinge.
        edge: as described; its anchors are where the axes are nearest.
        groups: which links are one body.
        axes: of the hinges, world axes at the start: the first stays on the parent, the second on the child.
    """
    parent, places, turns = groups.heads[edge.parent], edge.anchors, np.asarray(edge.turns)

    def on_parent(label: str, place: np.ndarray) -> str:
        return groups.add_point(edge.parent, f"{name}_{label}", edge.place + turned(edge.quaternion, place))

    def on_child(label: str, place: np.ndarray) -> str:
        return groups.add_point(edge.child, f"{name}_{label}", place)

    first, second = on_parent("first", places[0]), on_child("second", places[1])
    are_parallel = np.linalg.norm(np.cross(turns[0], turns[1])) < _PARALLEL
    found: list[AbstractJoint] = []
    if are_parallel:
        feet = [on_child(f"foot_{k}", places[1] + foot) for k, foot in enumerate(three_feet(turns[1]), start=1)]
        found += [PointOnPlane(foot, first, axes[0], parent) for foot in feet]
    elif np.array_equal(places[0], places[1]):
        found.append(Spherical(first, second))
    else:
        found += [PointOnPlane(second, first, axes[0], parent), PointOnPlane(first, second, axes[1], edge.child)]
    if not np.array_equal(places[0], places[1]):
        found.append(Distance(first, second))
    if not are_parallel:
        ends = [places[k] + FOOT * turns[k] for k in (0, 1)]
        found.append(Distance(on_parent("along_first", ends[0]), on_child("along_second", ends[1])))
    return {f"{name}_{k}": joint for k, joint in enumerate(found, start=1)}


_PARALLEL = 1e-9
"""Sine of the angle of two axes below which they are parallel."""


def joints_of(
    name: str, edge: Edge, groups: LinkGroups, axis: np.ndarray, ways: Ways, second: np.ndarray | None = None
) -> dict[str, AbstractJoint]:
    """The joints that a joint of the description becomes; friction of constant size is a preload.

    Args:
        name: of the joint.
        edge: as described.
        groups: which links are one body.
        axis: world axes at the start.
        ways: what the description leaves open.
        second: of a universal joint, the axis that stays on the child, world axes at the start.
    """
    parent = groups.heads[edge.parent]
    bodies = (parent, edge.child)
    rubs = edge.friction != 0 and "friction" not in ways.ignore
    model = None
    if edge.kind in TURNING:
        if rubs:
            model = Ideal(friction=ways.friction, radius=_RADIUS, pressure=PreloadAlone(), preload=edge.friction)
        return {name: Revolute(bodies, groups.hands[name], axis, model)}
    if edge.kind in SLIDING:
        if rubs:
            model = Ideal(friction=ways.friction, pressure=PreloadAlone(), preload_force=edge.friction)
        return {name: Prismatic(bodies, groups.hands[name], axis, model)}
    if edge.kind == "planar":
        names = [f"{name}_{k}" for k in (1, 2, 3)]
        return {one: PointOnPlane(f"{edge.child}.{one}", groups.feet[name], axis, parent) for one in names}
    if edge.kind == "spherical":
        return {name: Spherical(groups.feet[name], groups.hands[name])}
    if edge.kind == "cylindrical":
        return {name: Cylindrical(bodies, groups.hands[name], axis)}
    if edge.kind == "universal":
        return {name: Universal(bodies, groups.hands[name], axis, second)}
    return {}


def forces_of(
    name: str,
    robot: Robot,
    groups: LinkGroups,
    axes: Mapping[str, np.ndarray],
    ways: Ways,
    positions: Mapping[str, float],
) -> dict[str, AbstractForce]:
    """The force elements of a joint: spring, damper, stops, actuators, and what couples it to the joint it mimics."""
    edge, axis = robot.edges[name], axes[name]
    if edge.kind not in (*TURNING, *SLIDING):
        return {}
    found: dict[str, AbstractForce] = {}
    if (edge.damping or edge.stiffness) and edge.kind in TURNING:
        pair, slack = (groups.heads[edge.parent], edge.child), edge.rest - positions.get(name, 0.0)
        slack = slack if edge.stiffness else 0.0
        found[name] = TorsionalSpring(pair, axis, edge.stiffness, edge.damping, slack)
    elif edge.damping or edge.stiffness:
        slack = edge.rest if edge.stiffness else 0.0
        found[name] = SpringDamper(_ends(name, groups), edge.stiffness, edge.damping, slack, direction=axis)
    resisting = ways.of(ways.stops, name, edge)
    has_limits = np.isfinite(edge.lower) or np.isfinite(edge.upper)
    if resisting is not None and has_limits:
        found[f"{name}_stop"] = _stop(name, robot, groups, axis, resisting, positions.get(name, 0.0))
    if edge.follows is not None and "mimic" not in ways.ignore:
        how = ways.of(ways.mimic, name, edge)
        if how is None:
            word = "turning" if edge.kind in TURNING else "sliding"
            raise SceneError(
                f"{robot.path}: mimic: joint {name!r} mimics {edge.follows!r}, and nothing says how stiff; "
                f'give mimic={{"{word}": {{"stiffness": ...}}}}'
            )
        found[f"{name}_mimic"] = _coupler(name, robot, groups, axes, how)
    for drive in edge.actuators:
        taken = {*found, *(f"{joint}{ending}" for joint in robot.edges for ending in ("", "_stop", "_mimic"))}
        own = f"{drive.name}_actuator" if drive.name in taken else drive.name
        found[own] = drive.force(_coordinate(name, robot, groups, axes), positions.get(name, 0.0))
    return found


def _coordinate(name: str, robot: Robot, groups: LinkGroups, axes: Mapping[str, np.ndarray]) -> Turn | Travel:
    """How far a joint that turns or slides has moved since the start."""
    edge = robot.edges[name]
    if edge.kind in TURNING:
        return Turn((groups.heads[edge.parent], edge.child), axes[name])
    return Travel(_ends(name, groups), axes[name])


def _ends(name: str, groups: LinkGroups) -> tuple[str, str]:
    return groups.feet[name], groups.hands[name]


def _stop(name: str, robot: Robot, groups: LinkGroups, axis: np.ndarray, resisting, position: float) -> AbstractForce:
    """A stop at each limit, in a coordinate that is counted from the start (an angle) or from 0 (a length)."""
    edge = robot.edges[name]
    if not edge.lower < edge.upper:
        raise SceneError(
            f"{robot.path}: joint {name!r} has limits {edge.lower!r} and {edge.upper!r}, between which nothing is; "
            f"leave its stops out with stops={{..., {name!r}: None}}, or hold it with fixed=({name!r},)"
        )
    if not edge.lower <= position <= edge.upper:
        raise SceneError(
            f"{robot.path}: joint {name!r} starts at {position!r}, beyond its limits {edge.lower!r} and "
            f"{edge.upper!r}; start it between them with positions={{{name!r}: ...}}, or leave its stops out with "
            f"stops={{..., {name!r}: None}}"
        )
    given = dict(resisting) if isinstance(resisting, Mapping) else {"stiffness": resisting}
    if edge.kind in SLIDING:
        return BumpStop(_ends(name, groups), edge.lower, edge.upper, direction=axis, **given)
    bodies = (groups.heads[edge.parent], edge.child)
    lower, upper = edge.lower - position, edge.upper - position
    if isinstance(resisting, Mapping):
        return TorsionalStop(bodies, axis, lower, upper, **given)
    # The torque turns the joint back: positive beyond the upper limit.
    beyond = [Linear(resisting, -resisting * limit) for limit in (lower, upper)]
    return TorsionalSpring(bodies, axis, spring=Piecewise([lower, upper], [beyond[0], Constant(0.0), beyond[1]]))


def _coupler(
    name: str, robot: Robot, groups: LinkGroups, axes: Mapping[str, np.ndarray], how: Mapping
) -> AbstractForce:
    follower = robot.edges[name]
    assert follower.follows is not None
    coordinates = []
    for one in (follower.follows, name):
        edge = robot.edges[one]
        if edge.kind not in (*TURNING, *SLIDING):
            raise SceneError(
                f"{robot.path}: joint {name!r} mimics {one!r}, which is {edge.kind}; hold it too, with "
                f'fixed=({name!r},), or leave mimicry out with ignore=("mimic",)'
            )
        coordinates.append(_coordinate(one, robot, groups, axes))
    return Coupler(*coordinates, ratio=follower.multiplier, **how)

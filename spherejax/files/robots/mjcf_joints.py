"""What equalities and stacks of joints in a MuJoCo model become."""

from collections.abc import Collection, Iterator, Mapping

import numpy as np

from spherejax.files.fields.rotations import UNTURNED, product, turned
from spherejax.files.robots.mjcf_model import WORLD, CompiledFile, library
from spherejax.files.robots.robot import SLIDING, TURNING, Edge, LinkPose, Robot, undotted
from spherejax.files.robots.robot_bodies import LinkGroups
from spherejax.files.robots.robot_joints import Ways
from spherejax.foundations.errors import SceneError
from spherejax.physics.joints.joint import AbstractJoint
from spherejax.physics.joints.pairs import Fixed
from spherejax.physics.joints.spherical import Spherical

_ALIGNED = 1e-9
"""Cosines and sines up to which axes are perpendicular or parallel: what MuJoCo's normalization rounds."""

_FAR = 1e-3
"""How far apart [m], or how far turned [sine of the angle], two axes of hinges must be that are not one, nor meet."""

_CLOSED = 1e-6
"""How far apart [m, rad] a weld may hold its bodies at the start: it would keep what is off for good."""


# Joints that follow others ------------------------------------------------------------------------------------------


def followed(file: CompiledFile) -> dict[str, tuple[str, float, float]]:
    """Leader, multiplier and offset of each joint that an equality makes follow another.

    Raises:
        SceneError: for what is no straight line between two joints.
    """
    found: dict[str, tuple[str, float, float]] = {}
    for name, number in _active(file, "JOINT"):
        follower, leader = int(file.model.eq_obj1id[number]), int(file.model.eq_obj2id[number])
        offset, multiplier, *bends = (float(one) for one in file.model.eq_data[number][:5])
        own = file.joints[follower]
        if leader < 0:
            raise SceneError(
                f"{file.path}: equality {name!r} holds joint {own!r} by itself; hold it with fixed=({own!r},), or "
                'leave it out with ignore=("mimic",)'
            )
        if any(bends):
            raise SceneError(
                f"{file.path}: equality {name!r}: joint {own!r} follows {file.joints[leader]!r} along a curve, and a "
                'Coupler along a straight line; leave it out with ignore=("mimic",)'
            )
        if own in found:
            raise SceneError(f"{file.path}: joint {own!r} follows two others; leave one equality out")
        found[own] = (file.joints[leader], multiplier, offset)
    return found


def _active(file: CompiledFile, kind: str) -> Iterator[tuple[str, int]]:
    """Name and number of each equality of a kind that is switched on."""
    mujoco = library()
    if not file.has_constraints("EQUALITY"):
        return
    wanted = int(getattr(mujoco.mjtEq, f"mjEQ_{kind}"))
    for number in range(file.model.neq):
        if int(file.model.eq_type[number]) == wanted and file.model.eq_active0[number]:
            name = mujoco.mj_id2name(file.model, mujoco.mjtObj.mjOBJ_EQUALITY, number)
            yield undotted(name or f"{kind.lower()}_{number + 1}"), number


# Loops --------------------------------------------------------------------------------------------------------------


def loops_of(
    file: CompiledFile, groups: LinkGroups, start: Mapping[str, LinkPose], taken: Collection[str]
) -> dict[str, AbstractJoint]:
    """The joints that close loops: `connect` a ball in a socket, `weld` a fixed one.

    Raises:
        SceneError: for a weld that the start does not close.
    """
    found: dict[str, AbstractJoint] = {}
    for kind in ("CONNECT", "WELD"):
        for name, number in _active(file, kind):
            while name in taken or name in found:
                name += "_"
            bodies, places, turns = _ends(file, kind, number)
            for body in bodies:
                if body not in groups.heads:
                    raise SceneError(f"{file.path}: equality {name!r}: body {body!r} is not in the scene")
            points = [groups.add_point(body, name, place) for body, place in zip(bodies, places, strict=True)]
            if kind == "CONNECT":
                found[name] = Spherical(points[0], points[1])
                continue
            _check_weld(file, name, [start[body] for body in bodies], places, turns)
            first, second = (groups.heads[body] for body in bodies)
            found[name] = Fixed((first, second), points[1])
    return found


def _ends(file: CompiledFile, kind: str, number: int) -> tuple[list[str], list[np.ndarray], list[np.ndarray]]:
    """The bodies of an equality, the place on each [m], and of a weld the quaternion of each that shall agree."""
    mujoco = library()
    model = file.model
    data = np.array(model.eq_data[number], np.float64)
    ids = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])]
    if int(model.eq_objtype[number]) == int(mujoco.mjtObj.mjOBJ_SITE):
        bodies = [int(model.site_bodyid[site]) for site in ids]
        places = [np.array(model.site_pos[site], np.float64) for site in ids]
        turns = [np.array(model.site_quat[site], np.float64) for site in ids]
    elif kind == "CONNECT":
        bodies, places, turns = ids, [data[:3], data[3:6]], [UNTURNED, UNTURNED]
    else:
        # The anchor is on the second body; the pose is that of the second against the first.
        bodies, turns = ids, [data[6:10] / np.linalg.norm(data[6:10]), UNTURNED]
        places = [data[3:6] + turned(turns[0], data[:3]), data[:3]]
    return [file.bodies[body] for body in bodies], places, turns


def _check_weld(file: CompiledFile, name: str, start: list[LinkPose], places: list, turns: list) -> None:
    first, second = start
    gap = first.place + turned(first.quaternion, places[0]) - second.place - turned(second.quaternion, places[1])
    inverse = product(first.quaternion, turns[0]) * np.array([1.0, -1.0, -1.0, -1.0])
    twist = 2 * np.linalg.norm(product(inverse, product(second.quaternion, turns[1]))[1:])
    if np.linalg.norm(gap) > _CLOSED or twist > _CLOSED:
        raise SceneError(
            f"{file.path}: weld {name!r} holds its bodies otherwise than they are at the start, by "
            f"{np.linalg.norm(gap):.3g} m and {twist:.3g} rad; give positions= or keyframe= that close it"
        )


# Several joints of one body -----------------------------------------------------------------------------------------


def put_together(robot: Robot, file: CompiledFile, ways: Ways, fixed: Collection[str]) -> Robot:
    """The robot with one joint for each stack of joints without inertia between them, where there is such a joint.

    Two hinges that meet at right angles are a universal joint; others two keep what the link between them keeps, the
    distance and the angle of their axes. Three that meet are a ball in a socket, a hinge and a slide along
    one axis a cylindrical one, a hinge and two slides across it a planar one. Any slides before or behind such
    turns at one point, or behind or before a ball, are a stack of planes and directions that stay; three slides and a
    ball are a free body. Springs, dampers, stops and actuators act along slides that are perpendicular to each other,
    and about a hinge that is the only one. Friction, couplings, and what acts about one of several hinges are those of
    single joints: a stack with one of them stays as it is, and its links need mass.
    """
    edges = dict(robot.edges)
    links = dict(robot.links)
    leaders = {edge.follows for edge in edges.values()}
    for body in range(1, file.model.nbody):
        first, n = int(file.model.body_jntadr[body]), int(file.model.body_jntnum[body])
        names = file.joints[first : first + n] if n > 1 else []
        stack = [edges[name] for name in names]
        is_free = names and not any(
            name in fixed or name in leaders or _is_coupled(edge, ways) for name, edge in zip(names, stack, strict=True)
        )
        made = _one_joint(stack) if is_free else None
        parts = {name: edge for name, edge in zip(names, stack, strict=True) if _has_force(name, edge, ways)}
        if made is not None and all(_acts_alone(edge, stack) for edge in parts.values()):
            ends = {"parent": stack[0].parent, "child": stack[-1].child}
            parts = {name: edge._replace(**ends) for name, edge in parts.items()}
            made = made._replace(parts=parts, slides_on_child=_carrier(stack) == "child")
            for edge in stack[:-1]:
                del links[edge.child]
            edges = {name: made if name == names[0] else edge for name, edge in edges.items() if name not in names[1:]}
    return robot._replace(links=links, edges=edges)


def _has_force(name: str, edge: Edge, ways: Ways) -> bool:
    has_stop = np.isfinite(edge.lower) and ways.of(ways.stops, name, edge) is not None
    return bool(edge.damping or edge.stiffness or has_stop or edge.actuators)


def _is_coupled(edge: Edge, ways: Ways) -> bool:
    """Whether a joint rubs, or follows another: what only a joint of its own does."""
    rubs = bool(edge.friction) and "friction" not in ways.ignore
    return rubs or (edge.follows is not None and "mimic" not in ways.ignore)


def _acts_alone(edge: Edge, stack: list[Edge]) -> bool:
    """Whether a joint's coordinate can be read between the two ends of its stack."""
    if edge.kind in TURNING:
        return sum(one.kind in (*TURNING, "spherical") for one in stack) == 1
    others = [one.axis for one in stack if one.kind in SLIDING and one is not edge]
    return _carrier(stack) is not None and all(abs(edge.axis @ axis) < _ALIGNED for axis in others)


def _carrier(stack: list[Edge]) -> str | None:
    """Which body carries the axes of all slides: the parent, where they come before all turns, or the child."""
    is_turn = [edge.kind not in SLIDING for edge in stack]
    if is_turn == sorted(is_turn):
        return "parent"
    return "child" if is_turn == sorted(is_turn, reverse=True) else None


def _one_joint(stack: list[Edge]) -> Edge | None:
    """The joint that a stack is, or None. Axes are those in the body's axes where all positions are 0."""
    turning = [edge for edge in stack if edge.kind in TURNING]
    sliding = [edge for edge in stack if edge.kind in SLIDING]
    balls = [edge for edge in stack if edge.kind == "spherical"]
    if len(turning) + len(sliding) + len(balls) < len(stack):
        return None
    turns = [*turning, *balls]
    no_force = {"damping": 0.0, "friction": 0.0, "stiffness": 0.0, "actuators": ()}
    bare = {**no_force, "lower": -np.inf, "upper": np.inf, "follows": None}
    anchor = (turns or stack)[0].anchor
    whole = stack[0]._replace(child=stack[-1].child, anchor=anchor, **bare)
    if balls or not turning:
        return _stack(whole, stack, slides=sliding, turns=turns)
    meet = all(np.allclose(edge.anchor, whole.anchor, rtol=0, atol=1e-12) for edge in turning)
    axes = np.array([edge.axis for edge in turning])
    slides = np.array([edge.axis for edge in sliding]).reshape(-1, 3)
    match len(turning), len(sliding):
        case (2, 0):
            return _two_hinges(whole, axes, np.array([edge.anchor for edge in turning]))
        case (3, 0) if meet and abs(np.linalg.det(axes)) > 1e-3:
            return whole._replace(kind="spherical")
        case (1, 1) if np.linalg.norm(np.cross(axes[0], slides[0])) < _ALIGNED:
            return whole._replace(kind="cylindrical", axis=axes[0])
        case (1, 2) if np.abs(slides @ axes[0]).max() < _ALIGNED and np.linalg.matrix_rank(slides, 1e-3) == 2:
            return whole._replace(kind="planar", axis=axes[0])
    return _stack(whole, stack, slides=sliding, turns=turns)


def _two_hinges(whole: Edge, axes: np.ndarray, anchors: np.ndarray) -> Edge | None:
    """Two hinges with a link without mass between, or None where they turn about one axis, or nearly do."""
    apart = anchors[1] - anchors[0]
    sine = np.linalg.norm(np.cross(axes[0], axes[1]))
    if sine < _ALIGNED:
        places = np.array([anchors[0], anchors[1] - (apart @ axes[0]) * axes[0]])
    else:
        # The ends of the common normal: what is between them is along neither axis.
        along = np.linalg.lstsq(np.stack([axes[0], -axes[1]], axis=1), apart, rcond=None)[0]
        places = anchors + along[:, None] * axes
    gap = np.linalg.norm(places[1] - places[0])
    if gap < _ALIGNED and abs(axes[0] @ axes[1]) < _ALIGNED:
        return whole._replace(kind="universal", axis=axes[0], second=axes[1], anchor=places[0])
    # A short rod between the axes, or a small angle of them, would hold badly.
    if _ALIGNED <= gap < _FAR or (sine < _FAR and (sine >= _ALIGNED or gap < _ALIGNED)):
        return None
    places = places if gap >= _ALIGNED else np.array([places[0], places[0]])
    return whole._replace(kind="hinges", turns=axes, anchors=places)


def _stack(whole: Edge, stack: list[Edge], slides: list[Edge], turns: list[Edge]) -> Edge | None:
    """Slides on one side of turns at one point, or None."""
    carrier = _carrier(stack)
    if not slides or carrier is None:
        return None
    axes = np.array([edge.axis for edge in slides])
    if np.linalg.matrix_rank(axes, 1e-3) < len(slides):
        return None
    if not all(np.allclose(edge.anchor, whole.anchor, rtol=0, atol=1e-12) for edge in turns):
        return None
    about = np.array([edge.axis for edge in turns]).reshape(-1, 3)
    match [edge.kind for edge in turns]:
        case ["spherical"]:
            about = None
        case [_, _, _] if abs(np.linalg.det(about)) > 1e-3:
            about = None
        case [_, _] if abs(about[0] @ about[1]) < _ALIGNED:
            pass
        case [] | ["revolute"]:
            pass
        case _:
            return None
    if about is None and len(slides) == 3:
        return whole._replace(kind="floating")
    return whole._replace(kind="stack", slides=axes, turns=about, slides_on_child=carrier == "child")


def _moved(robot: Robot, link: str) -> str:
    """The body at the end of a stack that a link without mass is in."""
    behind = {edge.parent: edge.child for edge in robot.edges.values()}
    while robot.links[link].mass == 0 and link in behind:
        link = behind[link]
    return link


def check_stacks(robot: Robot, file: CompiledFile, ways_to_mass: bool) -> None:
    """Raise `SceneError` for links without inertia between joints, unless they are given a little."""
    links = set(robot.links) - set(file.bodies) - {WORLD}
    loose = [edge for edge in robot.edges.values() if edge.child in links and edge.kind != "fixed"]
    if not loose or ways_to_mass:
        return
    child = loose[0].child
    names = [name for name, edge in robot.edges.items() if child in (edge.parent, edge.child)]
    raise SceneError(
        f"{robot.path}: joints {', '.join(names)} move one body, {_moved(robot, child)!r}, with nothing between them "
        "that has mass, and together they are no joint here: two hinges about different axes, three or a ball at one "
        "point; slides before or behind turns at one point, of a hinge, two at right angles, three, or a ball; without "
        "friction, and with springs, dampers, stops and actuators only along slides at right angles and about a single "
        "hinge. "
        "Give the links between them a little with load_mjcf(..., least_mass=1e-3, least_moment=1e-6), or hold one "
        f"with fixed=({names[-1]!r},)"
    )

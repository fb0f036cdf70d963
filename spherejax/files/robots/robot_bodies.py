"""What the links of a robot description become: bodies, of all links that fixed joints hold together."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from spherejax.files.fields.rotations import UNTURNED, product, turn_about, turned
from spherejax.files.robots.robot import LinkPose, Robot, in_other_axes
from spherejax.foundations.errors import SceneError
from spherejax.physics.bodies import GROUND, TRIANGLE_TOLERANCE, Body

_ROUNDING = 1e-15
"""Products of inertia below this share of the largest moment are rounding: the axes are principal."""

_SMALL = 1e-6
"""A radius of gyration below this [m] is none: tables of zeros leave rounding where links are put together."""


FOOT = 0.1
"""Distance [m] of the three points on which a planar joint stands; of the size of a robot's parts."""


class LinkGroups(NamedTuple):
    """Which links are one body.

    Attributes:
        heads: name of the body of each link: the link of the group nearest to the base, or the ground.
        quaternions: of each link's axes in those of its body's head.
        origins: of each link in the axes of its head [m].
        places: points of each body by name, from the head's origin, in its axes [m].
        feet: name of the point of each joint on the parent's body, "body.point".
        hands: the same on the child's body.
    """

    heads: dict[str, str]
    quaternions: dict[str, np.ndarray]
    origins: dict[str, np.ndarray]
    places: dict[str, dict[str, np.ndarray]]
    feet: dict[str, str]
    hands: dict[str, str]

    def add_point(self, link: str, name: str, place: np.ndarray) -> str:
        """Name a place that is given in a link's axes [m]; "body.point", with underscores where the name is taken."""
        head = self.heads[link]
        while name in self.places[head]:
            name += "_"
        self.places[head][name] = self.origins[link] + turned(self.quaternions[link], place)
        return f"{head}.{name}"


def groups_of(robot: Robot, base: str, first_pose: LinkPose) -> LinkGroups:
    """Links that fixed joints hold together, and the points on them; the ground's axes are those of the world."""
    zero = np.zeros(3)
    first, turn, place = robot.base, UNTURNED, zero
    if base == GROUND:
        first, turn, place = GROUND, first_pose.quaternion, first_pose.place
    found = LinkGroups(
        {robot.base: first}, {robot.base: turn}, {robot.base: place}, {first: {robot.base: place}}, {}, {}
    )
    for name, edge in robot.edges.items():
        head, turn = found.heads[edge.parent], found.quaternions[edge.parent]
        place = found.origins[edge.parent] + turned(turn, edge.place)
        if edge.kind == "fixed":
            found.heads[edge.child] = head
            found.quaternions[edge.child] = product(turn, edge.quaternion)
            found.origins[edge.child] = place
            found.places[head][edge.child] = place
            continue
        found.heads[edge.child], found.quaternions[edge.child], found.origins[edge.child] = edge.child, UNTURNED, zero
        found.places[edge.child] = {edge.child: zero}
        point = name if name not in robot.links else f"{name}_joint"
        found.places[head][point] = place + turned(turn, turned(edge.quaternion, edge.anchor))
        found.feet[name] = f"{head}.{point}"
        found.hands[name] = f"{edge.child}.{edge.child}"
        if np.any(edge.anchor):
            found.places[edge.child][point] = edge.anchor
            found.hands[name] = f"{edge.child}.{point}"
        for part in edge.parts:
            found.feet[part], found.hands[part] = found.feet[name], found.hands[name]
        if edge.kind == "planar":
            feet = {f"{name}_{k + 1}": edge.anchor + foot for k, foot in enumerate(three_feet(edge.axis))}
            found.places[edge.child] |= feet
    return found


def three_feet(axis: np.ndarray) -> list[np.ndarray]:
    """Three points around the origin in the plane across an axis."""
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across = FOOT * across / np.linalg.norm(across)
    return [turned(turn_about(axis, k * 2 * np.pi / 3), across) for k in range(3)]


class Least(NamedTuple):
    """What a body is given where a description leaves it without.

    Attributes:
        mass: [kg]; 0 for none.
        moment: principal moment of inertia [kg m^2]; 0 for none.
        balanced: whether moments that no body has are replaced by their mean.
    """

    mass: float
    moment: float
    balanced: bool


class LinkInertia(NamedTuple):
    """Inertia of a body.

    Attributes:
        mass: [kg].
        center: center of mass from the head's origin, in its axes [m].
        inertia: about the center of mass, in the head's axes [kg m^2], shape (3, 3).
    """

    mass: float
    center: np.ndarray
    inertia: np.ndarray

    def with_least(self, least: Least) -> "LinkInertia":
        """With no less than that: mass at the center, and the same moment about all axes added, as of a ball."""
        mass, inertia = max(self.mass, least.mass), self.inertia
        low, middle, high = np.linalg.eigvalsh(inertia)
        if low < least.moment and least.moment > 0:
            added = least.moment - low
            inertia = inertia + added * np.eye(3)
            low, middle, high = low + added, middle + added, high + added
        if least.balanced and high - low - middle > TRIANGLE_TOLERANCE * high:
            inertia = np.trace(inertia) / 3 * np.eye(3)
        return LinkInertia(mass, self.center, inertia)


def solid_of(robot: Robot, groups: LinkGroups, head: str) -> LinkInertia:
    """Mass, center and inertia of a group, by the parallel axes theorem."""
    links = {name: robot.links[name] for name, one in groups.heads.items() if one == head}
    mass = sum(link.mass for link in links.values())
    if not mass > 0:
        return LinkInertia(0.0, np.zeros(3), np.zeros((3, 3)))
    centers = {
        name: groups.origins[name] + turned(groups.quaternions[name], link.center) for name, link in links.items()
    }
    center = np.asarray(sum(link.mass * centers[name] for name, link in links.items()) / mass)
    inertia = np.zeros((3, 3))
    for name, link in links.items():
        arm = centers[name] - center
        inertia += in_other_axes(groups.quaternions[name], link.inertia)
        inertia += link.mass * ((arm @ arm) * np.eye(3) - np.outer(arm, arm))
    return LinkInertia(mass, center, inertia)


def body_of(solid: LinkInertia, places: Mapping[str, np.ndarray], start: LinkPose) -> Body:
    """The body where its head is."""
    arm = turned(start.quaternion, solid.center)
    return Body(
        solid.mass,
        _principal_where_it_is(solid.inertia),
        start.place + arm,
        start.quaternion,
        start.velocity + np.cross(start.angular_velocity, arm),
        start.angular_velocity,
        {name: place - solid.center for name, place in places.items()},
    )


def _principal_where_it_is(inertia: np.ndarray) -> np.ndarray:
    """Three moments where the axes are principal, else the matrix."""
    products = inertia - np.diag(np.diag(inertia))
    return np.diag(inertia) if np.abs(products).max() <= _ROUNDING * np.abs(inertia).max() else inertia


def check_all_have_mass(robot: Robot, groups: LinkGroups, solids: Mapping[str, LinkInertia]) -> None:
    """Every body that moves has mass and moments.

    Raises:
        SceneError: naming the first that does not, and what to do; of those that carry nothing, which joints to hold.
    """
    for head, solid in solids.items():
        lacks_mass = not solid.mass > 0
        if not lacks_mass and abs(np.linalg.eigvalsh(solid.inertia)[0]) > _SMALL**2 * solid.mass:
            continue
        joint = next((name for name, edge in robot.edges.items() if edge.child == head), None)
        how = "as a free base" if joint is None else f"by joint {joint!r}"
        what = "mass" if lacks_mass else "moments of inertia"
        give = (
            f"{robot.path}: link {head!r} moves {how} and has no {what}; give it <inertial> with mass and inertia, or "
        )
        if joint is None:
            raise SceneError(f"{give}leave the base on the ground")
        carried = {name: one.mass for name, one in solids.items()}
        for edge in reversed(robot.edges.values()):
            parent = groups.heads[edge.parent]
            if edge.kind != "fixed" and parent != GROUND:
                carried[parent] += carried[edge.child]
        loose = [name for name, edge in robot.edges.items() if edge.kind != "fixed" and carried[edge.child] == 0]
        if joint in loose:
            names = ", ".join(repr(name) for name in loose)
            raise SceneError(
                f"{give}make the joint fixed: {robot.loader}(..., fixed=[{names}]) holds all that carry no mass"
            )
        least = "least_mass=1e-3, least_moment=1e-6" if lacks_mass else "least_moment=1e-6"
        raise SceneError(
            f"{give}make the joint fixed with {robot.loader}(..., fixed=[{joint!r}]), or give all that lack it a "
            f"little with {robot.loader}(..., {least})"
        )

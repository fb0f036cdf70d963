"""What the links of a robot description become: bodies, of all links that fixed joints hold together."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from spherejax.files.robot import Pose, Robot, in_other_axes
from spherejax.files.rotations import turned
from spherejax.foundations.errors import SceneError
from spherejax.physics.bodies import GROUND, TRIANGLE_TOLERANCE, Body

_ROUNDING = 1e-15
"""Products of inertia below this share of the largest moment are rounding: the axes are principal."""

_SMALL = 1e-6
"""A radius of gyration below this [m] is none: tables of zeros leave rounding where links are put together."""


class Groups(NamedTuple):
    """Which links are one body.

    Attributes:
        heads: name of the body of each link: the link of the group nearest to the base, or the ground.
        quaternions: of each link's axes in those of its body's head.
        origins: of each link in the axes of its head [m].
        places: points of each body by name, from the head's origin, in its axes [m].
        feet: name of the point of each joint on the parent's body, "body.point".
    """

    heads: dict[str, str]
    quaternions: dict[str, np.ndarray]
    origins: dict[str, np.ndarray]
    places: dict[str, dict[str, np.ndarray]]
    feet: dict[str, str]


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


class Solid(NamedTuple):
    """Inertia of a body.

    Attributes:
        mass: [kg].
        center: center of mass from the head's origin, in its axes [m].
        inertia: about the center of mass, in the head's axes [kg m^2], shape (3, 3).
    """

    mass: float
    center: np.ndarray
    inertia: np.ndarray

    def with_least(self, least: Least) -> "Solid":
        """With no less than that: mass at the center, and the same moment about all axes added, as of a ball."""
        mass, inertia = max(self.mass, least.mass), self.inertia
        low, middle, high = np.linalg.eigvalsh(inertia)
        if low < least.moment and least.moment > 0:
            added = least.moment - low
            inertia = inertia + added * np.eye(3)
            low, middle, high = low + added, middle + added, high + added
        if least.balanced and high - low - middle > TRIANGLE_TOLERANCE * high:
            inertia = np.trace(inertia) / 3 * np.eye(3)
        return Solid(mass, self.center, inertia)


def solid_of(robot: Robot, groups: Groups, head: str) -> Solid:
    """Mass, center and inertia of a group, by the parallel axes theorem."""
    links = {name: robot.links[name] for name, one in groups.heads.items() if one == head}
    mass = sum(link.mass for link in links.values())
    if not mass > 0:
        return Solid(0.0, np.zeros(3), np.zeros((3, 3)))
    centers = {
        name: groups.origins[name] + turned(groups.quaternions[name], link.center) for name, link in links.items()
    }
    center = np.asarray(sum(link.mass * centers[name] for name, link in links.items()) / mass)
    inertia = np.zeros((3, 3))
    for name, link in links.items():
        arm = centers[name] - center
        inertia += in_other_axes(groups.quaternions[name], link.inertia)
        inertia += link.mass * ((arm @ arm) * np.eye(3) - np.outer(arm, arm))
    return Solid(mass, center, inertia)


def body_of(solid: Solid, places: Mapping[str, np.ndarray], start: Pose) -> Body:
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


def check_all_have_mass(robot: Robot, groups: Groups, solids: Mapping[str, Solid]) -> None:
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
                f"{give}make the joint fixed: load_urdf(..., fixed=[{names}]) holds all that carry no mass"
            )
        least = "least_mass=1e-3, least_moment=1e-6" if lacks_mass else "least_moment=1e-6"
        raise SceneError(
            f"{give}make the joint fixed with load_urdf(..., fixed=[{joint!r}]), or give all that lack it a little "
            f"with load_urdf(..., {least})"
        )

"""An open chain of rods: the pendulum of n links."""

from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Number
from spherejax.gallery.rods import rod_inertia
from spherejax.model.drift import AbstractDriftControl, PostStabilization
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.joints.axial import Revolute

WIDTH = 0.1
"""Side of the rods' square section, as a fraction of their length; the motion, being plane, does not depend on it."""


def chain(
    n_links: int = 10, *, length: Number = 1.0, mass: Number = 1.0, drift: AbstractDriftControl | None = None
) -> Scene:
    """A pendulum of n equal rods, released from rest in the horizontal.

    The rods `"link_01"` (from the ground on), `"link_02"`, ... hang by revolutes about z and move in the x-y plane
    under gravity -y; n degrees of freedom, 5 n equations, none of them redundant. From two links on the motion is
    chaotic: compare histories over short times only.

    Args:
        n_links: number of rods n (static).

    Other args:
        length: length of every rod [m].
        mass: mass of every rod [kg].
        drift: drift control; `PostStabilization()` by default.

    Raises:
        SceneError: for less than one rod.
    """
    if n_links < 1:
        raise SceneError(f"n_links = {n_links} must be at least 1; a chain has one rod or more")
    inertia = rod_inertia(mass, length, WIDTH * length, along=0)
    names = [f"link_{i:02}" for i in range(1, n_links + 1)]
    bodies = {name: Body(mass, inertia, ((i + 0.5) * length, 0.0, 0.0)) for i, name in enumerate(names)}
    joints = {
        f"hinge_{i + 1:02}": Revolute((before, name), point=(i * length, 0.0, 0.0), axis=(0.0, 0.0, 1.0))
        for i, (before, name) in enumerate(zip([GROUND, *names], names, strict=False))
    }
    return Scene(bodies, joints, gravity=(0.0, -9.81, 0.0), drift=PostStabilization() if drift is None else drift)

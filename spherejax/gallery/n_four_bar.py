"""The N-four-bar mechanism of the IFToMM library of benchmark problems (A02)."""

from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Number
from spherejax.gallery.rods import rod_inertia
from spherejax.model.drift import AbstractDriftControl, PostStabilization
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.joints.axial import Revolute

WIDTH = 0.1
"""Side of the rods' square section, as a fraction of their length; the motion, being plane, does not depend on it."""


def n_four_bar(
    n_loops: int = 2,
    *,
    length: Number = 1.0,
    mass: Number = 1.0,
    speed: Number = 1.0,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """N parallelograms side by side: n + 1 rods stand on the ground, n rods join their tips.

    All rods move in the x-y plane under gravity -y; every joint is a revolute about z. At the start the standing rods
    `"rod_00"`, `"rod_01"`, ... are upright and their tips move with `speed` along x; the others are `"bar_01"`, ...
    One degree of freedom. Two things are hard: 3 n of the 15 n + 5 equations are redundant, and where all rods lie on
    one line, twice each turn, n more degrees of freedom open for an instant.

    The parallelograms stay such: with the angle theta of the standing rods from upright,

        ((n + 1) / 3 + n) m l^2 theta'' = ((n + 1) / 2 + n) m g l sin(theta),

    a pendulum that turns over.

    Args:
        n_loops: number of loops n (static).

    Other args:
        length: length of every rod [m].
        mass: mass of every rod [kg].
        speed: velocity of the tips at the start [m/s].
        drift: drift control; `PostStabilization()` by default.

    Raises:
        SceneError: for less than one loop.

    Source: IFToMM library of computational benchmark problems, A02 (two loops, 10 s); Gonzalez, Dopico, Pastorino,
    Cuadrado (2006), Nonlinear Dyn. 46:333-352, for the mechanism with many loops.
    """
    if n_loops < 1:
        raise SceneError(f"n_loops = {n_loops} must be at least 1: a mechanism without a loop is a chain")
    upright = rod_inertia(mass, length, WIDTH * length, along=1)
    lying = rod_inertia(mass, length, WIDTH * length, along=0)
    turning = (0.0, 0.0, -speed / length)
    bodies, joints = {}, {}
    for i in range(n_loops + 1):
        bodies[f"rod_{i:02}"] = Body(
            mass, upright, (i * length, length / 2, 0.0), velocity=(speed / 2, 0.0, 0.0), angular_velocity=turning
        )
        joints[f"foot_{i:02}"] = _hinge(GROUND, f"rod_{i:02}", (i * length, 0.0, 0.0))
    for i in range(1, n_loops + 1):
        bar, before, behind = f"bar_{i:02}", f"rod_{i - 1:02}", f"rod_{i:02}"
        bodies[bar] = Body(mass, lying, ((i - 0.5) * length, length, 0.0), velocity=(speed, 0.0, 0.0))
        joints[f"tip_{i:02}_left"] = _hinge(before, bar, ((i - 1) * length, length, 0.0))
        joints[f"tip_{i:02}_right"] = _hinge(bar, behind, (i * length, length, 0.0))
    return Scene(bodies, joints, gravity=(0.0, -9.81, 0.0), drift=PostStabilization() if drift is None else drift)


def _hinge(first: str, second: str, point) -> Revolute:
    return Revolute((first, second), point, axis=(0.0, 0.0, 1.0))

"""The stiff flyball governor of the IFToMM library of benchmark problems (A05)."""

import math

from spherejax.foundations.types import Number
from spherejax.gallery.rods import box_inertia
from spherejax.model.drift import AbstractDriftControl, PostStabilization
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.forces.spring_damper import SpringDamper
from spherejax.physics.joints.axial import Prismatic, Revolute

DENSITY, LENGTH, WIDTH, CUBE = 3000.0, 1.0, 0.01, 0.1
"""Density [kg/m^3], length of shaft and rods, side of their sections, and side of the slider [m]."""

BALL = 5.0
"""Mass of each ball [kg], a point at the end of its rod."""

HEIGHT, BELOW_HORIZONTAL = 0.5, math.pi / 6
"""Height of the slider's center above the shaft's foot [m] and inclination of the rods [rad] at the start."""

ROD = DENSITY * LENGTH * WIDTH * WIDTH
"""Mass of a rod or the shaft [kg]."""

CENTER = (ROD * LENGTH / 2 + BALL * LENGTH) / (ROD + BALL)
"""Distance of the center of mass of rod and ball from the hinge [m]."""


def governor(
    *,
    stiffness: Number = 8e5,
    damping: Number = 4e4,
    speed: Number = 2 * math.pi,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """Watt's governor with spring-dampers for coupler rods: stiff, between a slow and a very fast motion.

    The shaft turns freely about z. The two rods hang from its top by hinges, 0.1 m apart, each with a ball at its end;
    a spring-damper joins the middle of each rod to the slider, a cube on the shaft. Bodies `"shaft"`, `"slider"`,
    `"rod_right"`, `"rod_left"`. Four degrees of freedom. The spring-dampers tie rods and slider together within
    0.1 ms, while the shaft turns once in a second.

    Args:
        stiffness: of each spring-damper [N/m].
        damping: of each spring-damper [N s/m].
        speed: angular velocity of the whole at the start [rad/s].
        drift: drift control; `PostStabilization()` by default.

    Source: IFToMM library of computational benchmark problems, A05 (free length 0.5 m, 10 s). The shaft is taken as
    free to turn, not driven, and rods and shaft have the moments of uniform boxes.
    """
    c, s = math.cos(BELOW_HORIZONTAL), math.sin(BELOW_HORIZONTAL)
    turning = (0.0, 0.0, speed)
    bodies = {
        "shaft": Body(ROD, box_inertia(ROD, (WIDTH, WIDTH, LENGTH)), (0.0, 0.0, LENGTH / 2), angular_velocity=turning),
        "slider": Body(
            DENSITY * CUBE**3,
            box_inertia(DENSITY * CUBE**3, (CUBE, CUBE, CUBE)),
            (0.0, 0.0, HEIGHT),
            angular_velocity=turning,
            points={"right": (CUBE / 2, 0.0, 0.0), "left": (-CUBE / 2, 0.0, 0.0)},
        ),
    }
    joints = {
        "foot": Revolute((GROUND, "shaft"), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        "guide": Prismatic(("shaft", "slider"), (0.0, 0.0, HEIGHT), (0.0, 0.0, 1.0)),
    }
    forces = {}
    for side, sign in (("right", 1.0), ("left", -1.0)):
        hinge = (sign * CUBE / 2, 0.0, LENGTH)
        bodies[f"rod_{side}"] = _rod_with_ball(hinge, sign, c, s, speed)
        joints[f"hinge_{side}"] = Revolute(("shaft", f"rod_{side}"), hinge, (0.0, 1.0, 0.0))
        forces[f"coupler_{side}"] = SpringDamper(
            (f"slider.{side}", f"rod_{side}.middle"), stiffness, damping, free_length=0.5
        )
    return Scene(bodies, joints, forces, drift=PostStabilization() if drift is None else drift)


def _rod_with_ball(hinge, sign: float, c: float, s: float, speed: Number) -> Body:
    """Rod and ball as one body, with x from the hinge to the ball; it goes down to the right (sign 1) or left (-1)."""
    x = hinge[0] + sign * CENTER * c
    center = (x, 0.0, hinge[2] - CENTER * s)
    axial = box_inertia(ROD, (LENGTH, WIDTH, WIDTH))
    # Steiner: the rod's own center and the ball lie on the x axis.
    offset = ROD * (LENGTH / 2 - CENTER) ** 2 + BALL * (LENGTH - CENTER) ** 2
    half = BELOW_HORIZONTAL / 2
    down, up = math.sin(half), math.cos(half)
    # To the left: turned about z by pi, then about y by minus the inclination.
    quaternion = (up, 0.0, down, 0.0) if sign > 0 else (0.0, -down, 0.0, up)
    return Body(
        ROD + BALL,
        (axial[0], axial[1] + offset, axial[2] + offset),
        center,
        quaternion,
        velocity=(0.0, speed * x, 0.0),
        angular_velocity=(0.0, 0.0, speed),
        points={"middle": (LENGTH / 2 - CENTER, 0.0, 0.0), "ball": (LENGTH - CENTER, 0.0, 0.0)},
    )

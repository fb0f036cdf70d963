"""A lamp on a dry hinge that stays where it is put, balanced by a spring."""

from spherejax.foundations.types import Number
from spherejax.model.drift import AbstractDriftControl
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.forces.spring_damper import SpringDamper
from spherejax.physics.joints.axial import Revolute
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.laws.friction import BrownMcPhee

KINETIC_SHARE = 0.8
"""Coefficient of sliding friction over that of rest."""


def lamp(
    mu: Number = 0.3,
    *,
    stiffness: Number = 160.0,
    hinge_radius: Number = 0.03,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """A lamp's arm on a dry hinge, balanced by a spring: friction lets it stay in a band of positions.

    The arm turns about y from where it lies level, along x; a spring from a mast above the hinge pulls at a hook on it.
    Body `"arm"`, joint `"hinge"`, force element `"spring"`. `sj.studies.friction_band` with the coordinate
    `sj.Turn(("ground", "arm"), axis=(0, -1, 0))`, which counts upwards, gives the band.

    Args:
        mu: coefficient of static friction in the hinge; sliding takes 0.8 of it.

    Other args:
        stiffness: of the spring [N/m].
        hinge_radius: at which friction acts [m].
        drift: drift control; `PostStabilization()` by default.

    Numbers are of no particular lamp.
    """
    arm = Body(1.5, (0.001, 0.03, 0.03), position=(0.2, 0, 0), points={"hook": (-0.05, 0, 0), "shade": (0.1, 0, 0)})
    friction = BrownMcPhee(mu_kinetic=KINETIC_SHARE * mu, mu_static=mu)
    hinge = Revolute(
        (GROUND, "arm"), point=(0, 0, 0), axis=(0, 1, 0), model=Ideal(friction=friction, radius=hinge_radius)
    )
    spring = SpringDamper(("ground.mast", "arm.hook"), stiffness, free_length=0.03)
    return Scene({"arm": arm}, {"hinge": hinge}, {"spring": spring}, drift=drift, ground_points={"mast": (0, 0, 0.15)})

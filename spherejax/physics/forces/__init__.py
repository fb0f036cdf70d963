"""Force elements."""

from spherejax.physics.forces.applied import AppliedWrench
from spherejax.physics.forces.base import UNITS, AbstractForce, Wrench, power_on_bodies
from spherejax.physics.forces.bump_stop import BumpStop
from spherejax.physics.forces.coupler import AbstractCoordinate, Coupler, Travel, Turn
from spherejax.physics.forces.spring_damper import ShockAbsorber, SpringDamper
from spherejax.physics.forces.torsional import TorsionalSpring
from spherejax.physics.forces.tyre import Tyre

__all__ = [
    "UNITS",
    "AbstractCoordinate",
    "AbstractForce",
    "AppliedWrench",
    "BumpStop",
    "Coupler",
    "ShockAbsorber",
    "SpringDamper",
    "TorsionalSpring",
    "Travel",
    "Turn",
    "Tyre",
    "Wrench",
    "power_on_bodies",
]

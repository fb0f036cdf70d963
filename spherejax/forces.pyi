from .foundations.checks import Requirement
from .physics.forces.actuators import Actuator, Extension, SampledActuator
from .physics.forces.applied import AppliedWrench
from .physics.forces.base import AbstractForce, Wrench
from .physics.forces.bump_stop import BumpStop
from .physics.forces.controllers import PID
from .physics.forces.coupler import AbstractCoordinate, Coupler, Travel, Turn
from .physics.forces.gear import Gear
from .physics.forces.remembering import AbstractForceWithMemory, ForceAction, Instants, Sampling
from .physics.forces.sampled_pid import SampledPID
from .physics.forces.spring_damper import ShockAbsorber, SpringDamper
from .physics.forces.torsional import TorsionalSpring
from .physics.forces.torsional_stop import TorsionalStop
from .physics.forces.tyre import Tyre
from .physics.memory import MemoryEntry

__all__ = [
    "PID",
    "AbstractCoordinate",
    "AbstractForce",
    "AbstractForceWithMemory",
    "Actuator",
    "AppliedWrench",
    "BumpStop",
    "Coupler",
    "Extension",
    "ForceAction",
    "Gear",
    "Instants",
    "MemoryEntry",
    "Requirement",
    "SampledActuator",
    "SampledPID",
    "Sampling",
    "ShockAbsorber",
    "SpringDamper",
    "TorsionalSpring",
    "TorsionalStop",
    "Travel",
    "Turn",
    "Tyre",
    "Wrench",
]

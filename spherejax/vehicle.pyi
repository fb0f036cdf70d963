from .gallery.wheel_suspensions import DOUBLE_WISHBONE, MCPHERSON
from .physics.forces.tyre import Tyre
from .physics.functions.roads import RandomRoad
from .studies.rig import Corner, Rig, RigStatus, RigWarning, Vehicle, WheelLoads, rig, rig_samples
from .studies.roads import load_road

__all__ = [
    "DOUBLE_WISHBONE",
    "MCPHERSON",
    "Corner",
    "RandomRoad",
    "Rig",
    "RigStatus",
    "RigWarning",
    "Tyre",
    "Vehicle",
    "WheelLoads",
    "load_road",
    "rig",
    "rig_samples",
]

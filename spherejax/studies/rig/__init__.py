"""The suspension rig: kinematics and compliance of one corner of a car.

`bench.py` puts a scene on the rig, `kinematics.py` finds the positions of ideal joints, `equilibria.py` those of joints
that give way, `characteristics.py` reads toe, camber and the rest off them; users call `study.py`,
and `samples.py` for many corners at once.
"""

from spherejax.studies.rig.bench import Corner
from spherejax.studies.rig.rig_result import Rig, Vehicle
from spherejax.studies.rig.samples import rig_samples
from spherejax.studies.rig.shown import RigStatus, RigWarning
from spherejax.studies.rig.study import WheelLoads, rig

__all__ = ["Corner", "Rig", "RigStatus", "RigWarning", "Vehicle", "WheelLoads", "rig", "rig_samples"]

from .compiler import NotScalarizable
from .files.robots.urdf_left_out import RobotWarning
from .foundations.errors import SceneError
from .motion.equations.programs import ArrayPathWarning
from .motion.integration.lanes.operation import SerialRunsWarning
from .motion.integration.status import OutOfRangeWarning, SimulationError, SimulationWarning, Status
from .motion.results.global_error import AccuracyWarning
from .motion.results.spectra import SpectrumWarning
from .motion.results.steps import PartingWarning
from .motion.start.start_now import StartWarning
from .studies.cycles import CycleWarning
from .studies.inverse import InverseWarning
from .studies.linear import LinearizationWarning
from .studies.rig import RigWarning
from .studies.sweep import StoreWarning, SweepError
from .studies.uncertainty import UncertaintyWarning
from .studies.wear import WearWarning

__all__ = [
    "AccuracyWarning",
    "ArrayPathWarning",
    "CycleWarning",
    "InverseWarning",
    "LinearizationWarning",
    "NotScalarizable",
    "OutOfRangeWarning",
    "PartingWarning",
    "RigWarning",
    "RobotWarning",
    "SceneError",
    "SerialRunsWarning",
    "SimulationError",
    "SimulationWarning",
    "SpectrumWarning",
    "StartWarning",
    "Status",
    "StoreWarning",
    "SweepError",
    "UncertaintyWarning",
    "WearWarning",
]

from .motion.results.accuracy import Accuracy
from .motion.results.global_error import GlobalError
from .motion.results.impacts import Peak
from .motion.results.modes import Mode
from .motion.results.motion_state import MotionState
from .motion.results.traced_impacts import ImpactRows
from .motion.results.trajectory import Trajectory
from .motion.runs.many import Runs
from .motion.start.assembly import Assembly
from .motion.start.equilibrium import Equilibrium
from .motion.start.redundancy import ConstraintReport

__all__ = [
    "Accuracy",
    "Assembly",
    "ConstraintReport",
    "Equilibrium",
    "GlobalError",
    "ImpactRows",
    "Mode",
    "MotionState",
    "Peak",
    "Runs",
    "Trajectory",
]
